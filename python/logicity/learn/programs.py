"""Other programs, which end when this process ends, however it ends."""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from . import supervise

__all__ = ["Ended", "Running", "run_program"]

#: The number of bytes at the end of the output and of the log that count.
OUTPUT_BYTES = 16 << 20

#: Seconds in which the output of an ended program is read.
DRAIN = 1.0

#: The interval in seconds in which a program is observed.
POLL = 0.05

#: Seconds that a supervisor has to end the processes of its program.
ENDING = 2.0

#: The maximum length of the last line of a running program.
LINE = 100


class Ended(NamedTuple):
    """A program that has ended: its exit code, and the ends of standard output and standard error.

    The code is `None` if the program did not end in time and was killed.
    """

    code: int | None
    output: str
    log: str


class Running(NamedTuple):
    """A program that runs: the time since its start, and the last whole line with a word that it printed.

    The line is shortened to `LINE` characters, and empty if there is none.
    """

    seconds: float
    line: str


def run_program(
    command: Sequence[str],
    timeout: float | None = None,
    environment: Mapping[str, str] = {},
    watch: Callable[[Running], None] = lambda running: None,
) -> Ended:
    """Run a program to its end, without standard input.

    No process of it remains, also after an exception such as that of Ctrl-C, and if this process is killed. What a
    process in another session writes to its output after its end is ignored.

    After `timeout` seconds the program is killed. `environment` changes its environment variables. `watch` receives its
    state every `POLL` seconds or more often.
    """
    # The pipe closes when this process ends, however it ends.
    reader, writer = os.pipe()
    with (
        open(reader) as stdin,
        open(writer, "w") as alive,
        subprocess.Popen(
            [sys.executable, str(Path(supervise.__file__)), *command],
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **environment},
            start_new_session=True,
        ) as process,
    ):
        try:
            return _observed(process, timeout, watch)
        finally:
            # The supervisor also ends what has left its group.
            alive.close()
            with suppress(subprocess.TimeoutExpired):
                process.wait(ENDING)
            _kill(process)


def _observed(process: subprocess.Popen[bytes], timeout: float | None, watch: Callable[[Running], None]) -> Ended:
    """Read the output of a process until it ends or its time is over."""
    assert process.stdout is not None and process.stderr is not None
    output, log = bytearray(), bytearray()
    begun = time.monotonic()
    end, has_ended = None if timeout is None else begun + timeout, False
    last = ""
    with selectors.DefaultSelector() as pipes:
        pipes.register(process.stdout, selectors.EVENT_READ, output)
        pipes.register(process.stderr, selectors.EVENT_READ, log)
        while pipes.get_map() or not has_ended:
            if not has_ended and process.poll() is not None:
                end, has_ended = time.monotonic() + DRAIN, True
            if end is not None and time.monotonic() > end:
                break
            # Without pipes, this only waits.
            for key, _ in pipes.select(POLL):
                chunk = os.read(key.fd, 1 << 16)
                key.data.extend(chunk)
                if len(key.data) > 2 * OUTPUT_BYTES:
                    del key.data[:-OUTPUT_BYTES]
                if not chunk:
                    pipes.unregister(key.fileobj)
                if b"\n" in chunk:
                    # The beginning of the line may have come before.
                    last = _last_line(key.data[-(len(chunk) + LINE) :]) or last
            watch(Running(time.monotonic() - begun, last))
    code = process.returncode if has_ended else None
    return Ended(code, output.decode(errors="replace"), log.decode(errors="replace"))


def _last_line(output: bytearray) -> str:
    """Return the last complete line of an output that has a word of three letters, shortened."""
    lines = output.decode(errors="replace").split("\n")[:-1]
    return next((line.strip()[:LINE] for line in reversed(lines) if re.search("[A-Za-z]{3}", line)), "")


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a supervisor with its program and those that it started."""
    if hasattr(os, "killpg"):
        # macOS refuses to signal a group of ended processes.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
