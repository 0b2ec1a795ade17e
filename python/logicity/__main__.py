"""The command `logicity`, and `python -m logicity`: the commands of Rust and those of `logicity.commands`."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from . import _logicity

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line without the name of the program; that of the process by default.

    Returns:
        The exit code: 0 for success, 1 for faulty input, 2 for wrong usage or a file that cannot be read or written,
        130 after Ctrl-C.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Rust writes to the same streams, with buffers of its own. Unlike `flush`, `print` accepts closed ones.
    for stream in (sys.stdout, sys.stderr):
        print(end="", file=stream, flush=True)
    with _default_sigint():
        code, words, rest = _logicity.run_command_line(given)
    if not words:
        return code
    from .commands import run

    return run(tuple(words), rest)


@contextmanager
def _default_sigint() -> Iterator[None]:
    """Let Ctrl-C end the process, since Python runs its own handler only between instructions of Python."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        # `None` stands for a handler that Python did not install and cannot restore.
        if previous is not None:
            signal.signal(signal.SIGINT, previous)


if __name__ == "__main__":
    sys.exit(main())
