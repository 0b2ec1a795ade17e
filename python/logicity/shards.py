"""Shards of a command on many processors or machines: processes, a Ray cluster, or an array of jobs of Slurm.

Each shard is a command with `--shard I/N`, and `logicity merge` joins them to what one process would write.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .cluster import ONE_THREAD, RETRIES, check_jobs, connect
from .errors import CommandError, extra
from .files import json_text, read_json, write_text

__all__ = ["make_shards"]

#: The commands that have shards, with the options that name their output.
_COMMANDS = {
    ("episodes", "make"): ("--output", "-o"),
    ("questions",): ("--output", "-o"),
    ("vap", "make"): ("--out", "-o"),
}

#: The interval between two looks at the jobs of Slurm, in seconds.
_SECONDS = 2.0

Say = Callable[[str], object]


@dataclass(frozen=True)
class _Plan:
    """What to make: the arguments of each shard, its path, and those of the command that joins them."""

    folder: Path
    shards: dict[Path, list[str]]
    merge: list[str]
    #: Whether a shard is a folder, which its command completes if it exists.
    folders: bool


class _Processes:
    """Processes that threads start and another one stops."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._started: list[subprocess.Popen[str]] = []
        self._stopped = False

    def start(self, command: Sequence[str], cwd: str | None, environment: Mapping[str, str]) -> subprocess.Popen[str]:
        """Start a process. Raise `CancelledError` after `stop`."""
        # A process must not start between the end of the others and the note that it runs.
        with self._lock:
            if self._stopped:
                raise CancelledError
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                encoding="utf-8",
                cwd=cwd,
                env=environment,
            )
            self._started.append(process)
        return process

    def stop(self) -> None:
        """End all processes, and start no more."""
        with self._lock:
            self._stopped = True
            for process in self._started:
                process.terminate()


def run_command(
    arguments: Sequence[str],
    cwd: str | None = None,
    one_thread: bool = False,
    processes: _Processes | None = None,
) -> str:
    """Run a command of logicity in another process, and return what it printed.

    The process ends if this call is interrupted. It is one of `processes`, if given.

    Raises:
        CommandError: If it fails; the message is that of the command.
    """
    command = [sys.executable, "-m", "logicity", *arguments]
    environment = {**os.environ, **(ONE_THREAD if one_thread else {})}
    with (processes or _Processes()).start(command, cwd, environment) as process:
        try:
            printed, said = process.communicate()
        except BaseException:
            process.terminate()
            raise
    if process.returncode != 0:
        reason = said.strip() or f"it ended with the code {process.returncode}"
        raise CommandError(f"`logicity {' '.join(arguments)}` failed:\n{reason}", process.returncode)
    return printed


def _tried(arguments: Sequence[str], cwd: str) -> str | CommandError:
    """Variant of `run_command` in one thread that returns the error, of which submitit would keep only the text."""
    try:
        return run_command(arguments, cwd, True)
    except CommandError as error:
        return error


def make_shards(
    command: Sequence[str],
    count: int,
    *,
    jobs: int | None = None,
    ray: str | None = None,
    slurm: Mapping[str, Any] | None = None,
    progress: Say = lambda line: None,
) -> str:
    """Make the shards of a command, and join them.

    The shards lie in the folder `OUTPUT-shards`. Those of an interrupted call are kept.

    Args:
        command: `episodes make`, `questions` or `vap make` with their options, of which one names the output.
        count: The number of shards.
        jobs: The number of processes, of workers of a new Ray cluster, or of simultaneous jobs of Slurm. An existing
            Ray cluster and other clusters of submitit determine it by themselves.
        ray: The address of a Ray cluster whose machines share the folder, or `local` for a new one.
        slurm: Parameters of submitit for an array of jobs; `{"cluster": "local"}` runs them on this machine.
        progress: Receives lines of progress.

    Returns:
        What the command that joins the shards printed.

    Raises:
        ConnectionError: If the Ray cluster does not answer.
        ImportError: If Ray or submitit is requested and not installed.
        OSError: If a file cannot be read or written.
        ValueError: If the command has no shards, the folder has shards of another command, or `jobs` has no effect; and
            if a shard or the command that joins them fails, with the exit code of the command as `code`.
    """
    check_jobs(jobs, ray)
    _check_slurm(jobs, slurm)
    plan = _plan(list(command), count)
    plan.folder.mkdir(parents=True, exist_ok=True)
    _check_same(plan.folder, {"command": list(command), "count": count})
    pending = {path: arguments for path, arguments in plan.shards.items() if plan.folders or not path.exists()}
    if len(pending) < len(plan.shards):
        progress(f"{len(plan.shards) - len(pending)} of {len(plan.shards)} shards are made already")
    if ray is not None:
        ended = _on_ray(pending, ray, jobs)
    elif slurm is not None:
        ended = _on_slurm(pending, plan.folder, jobs, slurm)
    else:
        ended = _in_processes(pending, jobs or os.cpu_count() or 1)
    for number, path in enumerate(ended, start=len(plan.shards) - len(pending) + 1):
        progress(f"[{number}/{len(plan.shards)}] {path}")
    return run_command(plan.merge)


def _plan(command: list[str], count: int) -> _Plan:
    words = next((words for words in _COMMANDS if tuple(command[: len(words)]) == words), None)
    if words is None:
        known = ", ".join(" ".join(words) for words in _COMMANDS)
        raise ValueError(f"`{' '.join(command[:2])}` has no shards; the commands with shards are: {known}")
    if any(each == "--shard" or each.startswith("--shard=") for each in command):
        raise ValueError("leave out `--shard`: each shard gets its own")
    output, others = _output(command, _COMMANDS[words])
    if output is None or output == "-":
        raise ValueError(f"name the output of `{' '.join(words)}` with `{_COMMANDS[words][0]}`")
    folders = words == ("vap", "make")
    if folders and not any(each.split("=")[0] == "--threads" for each in others):
        others += ["--threads", "1"]
    folder = _beside(Path(output))
    width = len(str(count))
    shards = {
        folder / f"shard-{number:0{width}}": [*others, "--shard", f"{number}/{count}"] for number in range(1, count + 1)
    }
    option = _COMMANDS[words][0]
    shards = {path: [*arguments, option, os.fspath(path)] for path, arguments in shards.items()}
    force = ["--force"] * ("--force" in others)
    merge = ["merge", *map(os.fspath, shards), "--output", output, *force]
    return _Plan(folder, shards, merge, folders)


def _beside(output: Path) -> Path:
    """Return the folder of the shards of an output, which may end in a separator."""
    # `.` and `..` have no names of their own.
    path = output if output.name not in ("", "..") else output.resolve()
    if not path.name:
        raise ValueError(f"`{output}` cannot be an output with shards, which lie beside it: choose another one")
    return path.with_name(f"{path.name}-shards")


def _output(command: Sequence[str], options: tuple[str, str]) -> tuple[str | None, list[str]]:
    """Return the output of a command, and its other arguments."""
    long, short = options
    found, others, arguments = None, [], iter(command)
    for each in arguments:
        if each in options:
            found = next(arguments, None)
        elif each.startswith(f"{long}="):
            found = each.partition("=")[2]
        elif each.startswith(short) and not each.startswith("--"):
            found = each.removeprefix(short).removeprefix("=")
        else:
            others.append(each)
    return found, others


def _check_same(folder: Path, wanted: Mapping[str, Any]) -> None:
    """Note the command whose shards a folder has, or raise `ValueError` if it has those of another.

    The note of a command that made no shard, perhaps because it had a mistake, is replaced.
    """
    file = folder / "command.json"
    if file.exists():
        if _noted(file) == wanted:
            return
        if any(folder.glob("shard-*")):
            raise ValueError(f"`{folder}` has the shards of another command: remove it, or choose another output")
    elif any(folder.iterdir()):
        raise ValueError(f"`{folder}` has files that are not shards: move them, or choose another output")
    write_text(file, json_text(dict(wanted)))


def _noted(file: Path) -> Any:
    """Return the command that a file notes; `None` if it is damaged."""
    try:
        return read_json(file)
    except ValueError:
        return None


def _in_processes(pending: Mapping[Path, list[str]], jobs: int) -> Iterator[Path]:
    processes = _Processes()
    with ThreadPoolExecutor(jobs) as threads:
        try:
            futures = {
                threads.submit(run_command, arguments, None, True, processes): path
                for path, arguments in pending.items()
            }
            for ended in as_completed(futures):
                ended.result()
                yield futures[ended]
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            processes.stop()
            raise


def _on_ray(pending: Mapping[Path, list[str]], address: str, jobs: int | None) -> Iterator[Path]:
    ray = connect(address, jobs)
    try:
        # Only the loss of a worker repeats a shard.
        task = ray.remote(num_cpus=1, max_retries=RETRIES)(run_command)
        here = os.getcwd()
        futures = {task.remote(arguments, here, True): path for path, arguments in pending.items()}
        while futures:
            (ended,), _ = ray.wait(list(futures), num_returns=1)
            try:
                ray.get(ended)
            except ray.exceptions.RayError as error:
                # An error of the command itself is the cause; others are those of the cluster.
                cause = getattr(error, "cause", None)
                raise (cause if isinstance(cause, CommandError) else OSError(f"--ray: {cause or error}")) from None
            yield futures.pop(ended)
    finally:
        ray.shutdown()


def _check_slurm(jobs: int | None, parameters: Mapping[str, Any] | None) -> None:
    """Raise `ValueError` if a number of jobs would have no effect on Slurm."""
    if jobs is None or parameters is None:
        return
    cluster = parameters.get("cluster", "slurm")
    if cluster != "slurm":
        raise ValueError(f"--jobs: the cluster `{cluster}` of `--slurm` runs all shards at once; omit the option")
    if "slurm_array_parallelism" in parameters:
        raise ValueError("--jobs: `--slurm` has `slurm_array_parallelism`, which means the same; omit one of them")


def _on_slurm(
    pending: Mapping[Path, list[str]], folder: Path, jobs: int | None, parameters: Mapping[str, Any]
) -> Iterator[Path]:
    with extra("slurm"):
        import submitit

    options = dict(parameters)
    cluster = options.pop("cluster", "slurm")
    try:
        executor = submitit.AutoExecutor(folder=folder / "logs", cluster=cluster)
        if jobs is not None:
            options["slurm_array_parallelism"] = jobs
        executor.update_parameters(name="logicity-shards", **options)
    except (NameError, RuntimeError, TypeError, ValueError) as error:
        # submitit raises these for an unknown parameter or cluster, and if there is no Slurm.
        raise ValueError(f"--slurm: {error}") from None
    here, arguments = os.getcwd(), list(pending.values())
    submitted = executor.map_array(_tried, arguments, [here] * len(arguments))
    running = dict(zip(submitted, pending, strict=True))
    try:
        while running:
            for job in [job for job in running if job.done()]:
                if (failure := job.exception()) is not None:
                    raise OSError(f"shard `{running[job]}` failed: {failure}\nhelp: its log is {job.paths.stderr}")
                if isinstance(result := job.result(), CommandError):
                    raise result
                yield running.pop(job)
            if running:
                time.sleep(_SECONDS)
    finally:
        for job in running:
            job.cancel()
