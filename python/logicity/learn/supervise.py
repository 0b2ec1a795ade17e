"""Runs a program that ends when the process that started it ends, also if that process is killed.

`python supervise.py COMMAND...` runs a command. When its standard input is closed, it kills the command with all
processes that the command has started. It imports only the standard library, so that it starts quickly.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

__all__ = ["end_with_parent"]


def end_with_parent(kill: Callable[[], None] = lambda: None) -> None:
    """End this process and those that it started when standard input is closed.

    Args:
        kill: Ends the started processes where there are no process groups. Otherwise this process must lead its group.
    """

    def watch() -> None:
        while os.read(0, 1024):
            pass
        if os.name == "posix" and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        kill()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _main() -> int:
    try:
        # The parent's pipe is not the standard input of the program.
        program = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    except OSError as error:
        os.write(2, f"cannot run `{sys.argv[1]}`: {error.strerror}\n".encode(errors="replace"))
        return 127
    end_with_parent(program.kill)
    code = program.wait()
    # As in shells, a signal is 128 and its number.
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(_main())
