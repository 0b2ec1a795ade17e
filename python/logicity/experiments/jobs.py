"""Run the cells of an experiment in processes or on Ray. Finished cells are kept, unfinished ones resume."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, TypeVar

from ..cluster import ONE_THREAD, RETRIES, connect
from ..files import reserved
from ..learn.supervise import NEW_GROUP
from ..terminal import first_line
from .cells import finished, inputs, prepare, reuse, run_cell
from .task import Cell

__all__ = ["exclusive", "run", "run_in_processes"]

#: Receives a line of progress.
Say = Callable[[str], None]
T = TypeVar("T")

#: The interval between two lines of progress, in seconds.
SECONDS = 30.0


class Watch:
    """The state of a run: which cells are done, and how long the others will take."""

    def __init__(self, cells: Sequence[Cell], root: Path, jobs: int, say: Say) -> None:
        self.cells, self.root, self.jobs, self.say = cells, root, jobs, say
        self.failed: dict[str, str] = {}
        self._durations: dict[str, list[float]] = {}
        self._running: dict[str, tuple[Cell, float, int, int]] = {}
        self._shown = time.monotonic()
        #: The cells that have not started.
        self.pending = [cell for cell in self.cells if finished(cell, self.root) is None]
        known = {cell.identity for cell in self.cells}
        for cell in self.pending:
            if cell.start is not None and cell.start.identity not in known and finished(cell.start, self.root) is None:
                raise ValueError(f"{cell.name} starts from {cell.start.name}, which is not among the cells")
        self._done = len(self.cells) - len(self.pending)
        if self._done:
            self.say(f"{self._done} of {len(self.cells)} cells are finished already")

    def run(
        self, start: Callable[[Cell, Path], Future[T]], message: Callable[[Cell, Future[T]], str], most: int
    ) -> dict[str, str]:
        """Run all cells, at most some at a time, and return the messages of those that failed.

        `start` begins a cell in its folder. `message` says why an ended one has no measures, if it has none.
        """
        running: dict[Future[T], Cell] = {}
        while self.pending or running:
            startable = self._startable()
            while len(running) < most and (cell := next(startable, None)) is not None:
                folder = prepare(cell, self.root)
                self._running[cell.identity] = (cell, time.monotonic(), 0, 0)
                running[start(cell, folder)] = cell
            for ended in wait(running, timeout=1.0, return_when=FIRST_COMPLETED).done:
                cell = running.pop(ended)
                self._ended(cell, message(cell, ended))
            self._tick()
        return self.failed

    def reported(self, cell: Cell, steps: int) -> None:
        """Note the number of training steps of a cell."""
        _, begun, first, _ = self._running[cell.identity]
        self._running[cell.identity] = (cell, begun, first or steps, steps)

    def _startable(self) -> Iterator[Cell]:
        """Yield and remove pending cells whose start is finished. Report those whose start has failed."""
        for cell in list(self.pending):
            if cell.start is not None and cell.start.identity in self.failed:
                self.pending.remove(cell)
                self._failure(cell, f"it starts from {cell.start.name}, which failed")
            elif cell.start is None or finished(cell.start, self.root) is not None:
                self.pending.remove(cell)
                yield cell

    def _ended(self, cell: Cell, message: str) -> None:
        if (measured := finished(cell, self.root)) is None:
            self._failure(cell, message)
            return
        begun = self._running.pop(cell.identity)[1]
        self._durations.setdefault(cell.row, []).append(time.monotonic() - begun)
        self._done += 1
        cpu = measured["result"]["cpu_seconds"] / 60
        self.say(f"{self._count()} {cell.name}: {cell.task.summary(measured)}, {cpu:.1f} CPU min; {self._left()}")

    def _failure(self, cell: Cell, message: str) -> None:
        self._running.pop(cell.identity, None)
        self._done += 1
        self.failed[cell.identity] = message
        self.say(f"{self._count()} {cell.name}: {'not run' if cell.optional else 'failed'}: {first_line(message)}")

    def _tick(self) -> None:
        now = time.monotonic()
        if now - self._shown < SECONDS:
            return
        self._shown = now
        cells = ((cell, steps / cell.task.steps(cell)) for cell, _, _, steps in self._running.values())
        parts = [f"{cell.name} {min(1.0, done):.0%}" for cell, done in cells]
        self.say(f"{self._count()} running: {'; '.join(parts) or 'none'}; {self._left()}")

    def _count(self) -> str:
        return f"[{self._done}/{len(self.cells)}]"

    def _left(self) -> str:
        """Estimate the remaining time from the finished and the running cells."""
        now = time.monotonic()
        known = {row: sum(each) / len(each) for row, each in self._durations.items()}
        for cell, begun, first, steps in self._running.values():
            if steps > first:
                known.setdefault(cell.row, (now - begun) * (cell.task.steps(cell) - first) / (steps - first))
        if not known:
            return "no estimate yet"
        mean = sum(known.values()) / len(known)
        left = sum(max(0.0, known.get(cell.row, mean) - (now - begun)) for cell, begun, *_ in self._running.values())
        left += sum(known.get(cell.row, mean) for cell in self.pending)
        hours, rest = divmod(round(left / max(1, self.jobs) / 60), 60)
        return f"about {f'{hours} h ' if hours else ''}{rest} min left"


@contextmanager
def exclusive(root: Path) -> Iterator[None]:
    """Create the folder of an experiment, and keep other processes from running it there.

    Raises:
        OSError: If another process runs the experiment, or the folder cannot be written.
    """
    root.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            # The reservation ends with this process, even if it is killed.
            stack.enter_context(reserved(root / "running", by=None))
        except OSError as error:
            help = "\nhelp: one process at a time runs an experiment in a folder; `--run` names another folder"
            raise type(error)(f"{error}{help * ('process' in str(error))}") from None
        yield


def run(
    cells: Sequence[Cell],
    root: Path,
    jobs: int,
    say: Say,
    address: str | None = None,
    wandb: str | None = None,
    other: Path | None = None,
    trust: bool = False,
) -> dict[str, str]:
    """Run cells as the only process that runs the experiment: in processes, or on Ray if an address is given.

    The cells have different identities. `jobs` is the number of processes or, for the address `local`, of the workers
    of a new Ray cluster on this machine. This process and the workers exchange pickles through Ray, so they trust each
    other. `wandb` and `trust` are as for `train`, and `other` as for `reuse`.

    Returns:
        The messages of the cells that failed, by identity.

    Raises:
        ConnectionError: If the cluster does not answer.
        ImportError: If Ray or Weights & Biases is requested and not installed.
        OSError: If a folder cannot be written.
        ValueError: If a cell starts from one that is neither finished nor among the cells.
    """
    with exclusive(root):
        if other is not None:
            for line in reuse(cells, root, other):
                say(line)
        if address is None:
            return run_in_processes(cells, root, jobs, say, wandb, trust)
        return _run_on_ray(cells, root, jobs, say, wandb, trust, address)


def run_in_processes(
    cells: Sequence[Cell], root: Path, jobs: int, say: Say, wandb: str | None = None, trust: bool = False
) -> dict[str, str]:
    """Run cells, each in a process with one thread. All is as for `run`."""
    if wandb is not None and find_spec("wandb") is None:
        raise ImportError("--wandb: the package wandb is not installed: pip install wandb")
    watch = Watch(cells, root, jobs, say)
    with ThreadPoolExecutor(jobs) as threads, ExitStack() as processes:

        def start(cell: Cell, folder: Path) -> Future[str]:
            with open(folder / "log.txt", "a", encoding="utf-8") as log:
                process = _start(folder, log, wandb, trust, cell.task.environment(cell))
            processes.callback(_end, process)
            return threads.submit(_follow, process, cell, watch)

        return watch.run(start, lambda cell, ended: ended.result(), jobs)


def _start(
    folder: Path, log: IO[str], wandb: str | None, trust: bool, environment: Mapping[str, str]
) -> subprocess.Popen[str]:
    options = [*([f"--wandb={wandb}"] if wandb else []), *(["--trust"] if trust else [])]
    command = [sys.executable, "-m", "logicity.experiments.cells", *options, "--", str(folder)]
    return subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=log,
        encoding="utf-8",
        env={**os.environ, **ONE_THREAD, **environment},
        # Ctrl-C reaches only this process, which then ends the others.
        start_new_session=True,
        creationflags=NEW_GROUP,
    )


def _follow(process: subprocess.Popen[str], cell: Cell, watch: Watch) -> str:
    """Forward the lines of a process until it ends, and return its error."""
    error = None
    assert process.stdout is not None
    with process.stdout:
        for line in process.stdout:
            with suppress(ValueError):
                message = json.loads(line)
                error = message.get("error", error)
                if "steps" in message:
                    watch.reported(cell, message["steps"])
                elif "note" in message:
                    watch.say(f"{cell.name}: {message['note']}")
    code = _end(process)
    return error or f"its process ended with the code {code}; see {cell.folder(watch.root) / 'log.txt'}"


def _end(process: subprocess.Popen[str]) -> int:
    """Close the standard input of a process, which ends it and what it started, and return its exit code."""
    assert process.stdin is not None
    with suppress(OSError):
        process.stdin.close()
    return process.wait()


def _run_on_ray(
    cells: Sequence[Cell], root: Path, jobs: int, say: Say, wandb: str | None, trust: bool, address: str
) -> dict[str, str]:
    """Run cells on Ray, each as a task with one CPU. If a worker is lost, its cell runs again."""
    ray = connect(address, jobs if address == "local" else None)
    # A new process for each cell, as in `run_in_processes`. Only the loss of a worker repeats a cell.
    task = ray.remote(num_cpus=1, max_calls=1, max_retries=RETRIES)(_in_worker)

    def start(cell: Cell, folder: Path) -> Any:
        files = {path.name: path.read_bytes() for path in inputs(folder)}
        # The same folder if the cell runs again, and another one for each experiment.
        name = hashlib.sha256(f"{socket.gethostname()}:{folder.resolve()}".encode()).hexdigest()[:16]
        return task.remote(f"logicity-{name}", files, wandb, trust, cell.task.environment(cell)).future()

    def message(cell: Cell, ended: Future[bytes]) -> str:
        try:
            _unpack(ended.result(), cell.folder(root))
        except (ValueError, ray.exceptions.RayError) as error:
            # An error of the cell itself is the cause.
            return str(getattr(error, "cause", None) or error)
        return "its worker returned no measures"

    try:
        return Watch(cells, root, jobs, say).run(start, message, len(cells))
    finally:
        ray.shutdown()


def _in_worker(
    name: str, files: dict[str, bytes], wandb: str | None, trust: bool, environment: Mapping[str, str]
) -> bytes:
    """Run a cell in a worker, and return its files as a zip archive.

    The folder is temporary, but stays if the worker is lost. Then the cell resumes if it runs again on this machine.
    """
    folder = Path(tempfile.gettempdir()) / name
    folder.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid") and (folder.is_symlink() or folder.stat().st_uid != os.getuid()):
        raise PermissionError(f"{folder} belongs to another user: remove it")
    for name, content in files.items():
        _write(folder / name, content)
    os.environ.update(environment)
    run_cell(folder, wandb=wandb, trust=trust)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.relative_to(folder).parts[0].startswith(("checkpoint-", ".")):
                out.write(path, path.relative_to(folder))
    shutil.rmtree(folder, ignore_errors=True)
    return archive.getvalue()


def _unpack(archive: bytes, folder: Path) -> None:
    """Write the files of a cell, the last one `measured.json`, which marks it as finished.

    Raises:
        ValueError: If a name leads out of the folder. Then no file is written.
    """
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        names = sorted(files.namelist(), key=lambda name: name == "measured.json")
        for name in names:
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                raise ValueError(f"the worker returned a file outside of the folder of its cell: {name!r}")
        for name in names:
            _write(folder / name, files.read(name))


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}")
    temporary.write_bytes(content)
    temporary.replace(path)
