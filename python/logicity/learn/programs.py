"""Other programs, which end when this process ends, however it ends."""

from __future__ import annotations

import os
import queue
import re
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import IO, NamedTuple, Protocol

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

#: The maximum number of bytes that are read at once.
CHUNK = 1 << 16

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
            creationflags=supervise.NEW_GROUP,
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
    ends = bytearray(), bytearray()
    begun = time.monotonic()
    end, has_ended = None if timeout is None else begun + timeout, False
    last = ""
    with closing(_READ([process.stdout, process.stderr])) as pipes:
        while pipes.left or not has_ended:
            if not has_ended and process.poll() is not None:
                end, has_ended = time.monotonic() + DRAIN, True
            if end is not None and time.monotonic() > end:
                break
            for number, chunk in pipes.read(POLL):
                end_of = ends[number]
                end_of.extend(chunk)
                if len(end_of) > 2 * OUTPUT_BYTES:
                    del end_of[:-OUTPUT_BYTES]
                if b"\n" in chunk:
                    # The beginning of the line may have come before.
                    last = _last_line(end_of[-(len(chunk) + LINE) :]) or last
            watch(Running(time.monotonic() - begun, last))
    code = process.returncode if has_ended else None
    output, log = (each.decode(errors="replace") for each in ends)
    return Ended(code, output, log)


class _Pipes(Protocol):
    """Pipes that are read as data arrives. Each has a number, its position."""

    @property
    def left(self) -> int:
        """The number of pipes that have not ended."""

    def read(self, timeout: float) -> Iterator[tuple[int, bytes]]:
        """Wait for data, and yield the number of each pipe that has some, with its data. Without pipes, only wait."""

    def close(self) -> None:
        """Stop reading."""


class _Selected:
    """Pipes that the system selects."""

    def __init__(self, pipes: Sequence[IO[bytes]]) -> None:
        """Register the pipes."""
        self._selector = selectors.DefaultSelector()
        for number, pipe in enumerate(pipes):
            self._selector.register(pipe, selectors.EVENT_READ, number)
        self.close = self._selector.close

    @property
    def left(self) -> int:
        return len(self._selector.get_map())

    def read(self, timeout: float) -> Iterator[tuple[int, bytes]]:
        for key, _ in self._selector.select(timeout):
            chunk = os.read(key.fd, CHUNK)
            if not chunk:
                self._selector.unregister(key.fileobj)
            yield key.data, chunk


class _Threaded:
    """Pipes with a thread each, for Windows, which selects only sockets.

    A thread ends with its pipe. On Windows, a job ends the processes that could hold the pipe open.
    """

    def __init__(self, pipes: Sequence[IO[bytes]]) -> None:
        """Start the threads."""
        self.left = len(pipes)
        self._chunks: queue.Queue[tuple[int, bytes]] = queue.Queue(maxsize=64)
        self._closed = False
        for number, pipe in enumerate(pipes):
            threading.Thread(target=self._forward, args=(number, pipe.fileno()), daemon=True).start()

    def _forward(self, number: int, pipe: int) -> None:
        chunk = b"begun"
        while chunk and not self._closed:
            chunk = os.read(pipe, CHUNK)
            self._chunks.put((number, chunk))

    def read(self, timeout: float) -> Iterator[tuple[int, bytes]]:
        with suppress(queue.Empty):
            number, chunk = self._chunks.get(timeout=timeout)
            self.left -= not chunk
            yield number, chunk

    def close(self) -> None:
        self._closed = True
        # A thread may wait for space.
        with suppress(queue.Empty):
            while True:
                self._chunks.get_nowait()


#: The way to read several pipes on this system.
_READ: Callable[[Sequence[IO[bytes]]], _Pipes] = _Threaded if sys.platform == "win32" else _Selected


def _last_line(output: bytearray) -> str:
    """Return the last complete line of an output that has a word of three letters, shortened."""
    lines = output.decode(errors="replace").split("\n")[:-1]
    return next((line.strip()[:LINE] for line in reversed(lines) if re.search("[A-Za-z]{3}", line)), "")


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a supervisor with its program and those that it started."""
    if sys.platform != "win32":
        # macOS refuses to signal a group of ended processes.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
