"""Training runs: the loop that all learners share.

Each run has a folder. `config.json` is the configuration. `checkpoint-STEPS` holds the state to resume from: the
learner, the best policy so far, and the validation results. `tensorboard` has the training curves. At the end,
`best.pt` (or another suffix) is the best policy, and `result.json` has its measures on the test episodes. If the
policy is made of rules but is not a rule file, `rules.dl` has the rules.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from .. import _logicity
from .._logicity import __version__
from ..errors import InputError, UntrustedError
from ..evaluation import MEASURES, Benchmark, Evaluation
from ..files import check_readable, file_hash, json_text, read_json, reserved, write_json
from ..tasks import load_task, task_hashes
from ..terminal import first_line, neutral, print_message
from . import random_state
from .config import TrainConfig, faults_of_overrides
from .curves import Curves
from .faults import Fault
from .learner import Learner
from .policies import SavedPolicy, load_policy
from .storage import processor

__all__ = ["FolderError", "check_overrides", "check_start", "train"]

#: The memory of an environment without its observation, in bytes: a lower bound.
ENV_BYTES = 6 * 1024


class FolderError(ValueError):
    """The folder of a run has another run, other files or damaged files. The configuration may be valid."""


@dataclass
class State:
    """The progress of a run, without the learner."""

    steps: int = 0
    cpu_seconds: float = 0.0
    wall_seconds: float = 0.0
    best: dict[str, Any] | None = None
    validations: list[dict[str, Any]] = field(default_factory=list)
    hashes: dict[str, Any] = field(default_factory=dict)


def train(
    config: TrainConfig,
    run: str | os.PathLike[str],
    *,
    progress: bool = False,
    tensorboard: bool = True,
    report: Callable[[int], None] | None = None,
    wandb: str | None = None,
    trust: bool = False,
) -> dict[str, Any]:
    """Train a learner, or resume from the last checkpoint of the same configuration. Return what `result.json` has.

    The learner is validated every `validate_every` steps on the recorded validation episodes. The policy with the
    largest TSR, and of these the largest score, is kept, and measured on the test episodes at the end.

    A resumed run continues from the last validation. Its result equals that of an uninterrupted run bit for bit, except
    for the times. If `steps` is larger than that of a finished run, training continues. Schedules that depend on the
    total number of steps, such as DQN's exploration rate, then follow the new total.

    Args:
        config: The configuration.
        run: The folder of the run, which is created if it does not exist.
        progress: Whether to show the progress on standard error: as a bar if it is a terminal, and otherwise as lines,
            at the start, every 10 seconds and after each validation.
        tensorboard: Whether to write training curves.
        report: Receives the number of steps after each step of the learner.
        wandb: The project of Weights & Biases to which the validations and the result are sent. The package `wandb`
            must be installed.
        trust: Whether the policy of `start` may run code when it is loaded, as for `load_policy`. Other files of the
            run are data.

    Raises:
        ImportError: If a package is missing.
        InputError: If the configuration of the mode or an override is invalid, or no episodes are recorded.
        OSError: If another process trains in the folder, or a file cannot be written.
        UntrustedError: As for `load_policy`.
        ValueError: If the folder has another run, files of no run, or damaged files; the rules or episodes of the run
            have changed; the overrides change the shape of observations; the learner rejects the settings; or the
            memory does not suffice. A run that fails before its first checkpoint leaves no files.
    """
    run = Path(run)
    with ExitStack() as files:
        output = files.enter_context(_claimed(run))
        checkpoints = _checkpoints(run)
        state = _state(checkpoints[-1]) if checkpoints else State()
        _check_folder(run, config, state)
        start = check_start(config, trust=trust)
        hashes = task_hashes(config.mode)
        if config.start is not None:
            hashes["start"] = file_hash(config.start)
        different = [name for name in hashes if state.hashes and state.hashes.get(name) != hashes[name]]
        if different:
            names = ", ".join(different)
            raise FolderError(f"{run} has a run with another content of {names}; remove it or choose another folder")
        state.hashes = hashes
        torch.set_num_threads(config.threads)
        # Load the test episodes now: an error in them must not surface after hours of training.
        kind, overrides = config.observation, config.evaluation_overrides()
        val, test = (Benchmark(config.mode, split, observation=kind, overrides=overrides) for split in ("val", "test"))
        check_overrides(config)
        log = run / "tensorboard" if tensorboard else None
        files.enter_context(_enough_memory(config))
        learner = config.learner(config, log)
        files.callback(learner.close)
        if checkpoints:
            _restore(learner, checkpoints[-1])
        elif start is not None:
            try:
                learner.start_from(start.policy)
            except ValueError as error:
                raise ValueError(f"`start`: {start.path}: {error}") from None
        write_json(run / "config.json", config.to_dict())
        display = _Display(config, learner, progress)
        files.callback(display.bar.close)
        learner.say = display.say
        begun = f"resumed after {state.steps:,} of" if checkpoints else "started:"
        display.say(f"{config.algorithm} in {config.mode}, {begun} {config.steps:,} steps; folder {run}")
        curves = _ValidationCurves(run, config, log, wandb)
        files.callback(curves.close)
        training = _Training(run, learner, state, val, display, curves, report)
        learner.fit(config.steps, training.progress)
        training.finish()
        suffix = learner.suffix
        shutil.copyfile(_checkpoints(run)[-1] / f"best{suffix}", run / f"best{suffix}")
        best = learner.policy_class.load(run / f"best{suffix}")
        rules = best.rules()
        if rules is not None and suffix != ".dl":
            (run / "rules.dl").write_text(rules, encoding="utf-8", newline="\n")
        result = _result(config, learner, state, test.evaluate(best, name=config.algorithm))
        curves.finish(result)
        Path(output.temporary).write_text(json_text(result), encoding="utf-8", newline="\n")
        output.finish()
    return result


@contextmanager
def _claimed(run: Path) -> Iterator[_logicity.OutputFile]:
    """Create the folder of a run, and keep other processes from it.

    Yields the output file `result.json`. If the run fails before its first checkpoint, the new folders, or the new
    `config.json`, are removed.
    """
    missing = [folder for folder in (run, *run.parents) if not folder.exists()]
    try:
        run.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise type(error)(f"cannot create the folder `{run}`: {str(error.strerror).lower()}") from None
    stored = run / "config.json"
    is_new = not stored.exists()
    claimed = False
    try:
        with reserved(run / "result.json", by=None) as output:
            claimed = True
            yield output
    except BaseException as error:
        # An interrupted run can resume, also without a checkpoint.
        stopped = not isinstance(error, Exception) and stored.exists()
        if claimed and is_new and not stopped and not _checkpoints(run):
            stored.unlink(missing_ok=True)
            if missing:
                shutil.rmtree(run, ignore_errors=True)
        with suppress(OSError):
            for folder in missing:
                with suppress(FileNotFoundError):
                    folder.rmdir()
        raise


def _read_json(path: Path, remedy: str) -> dict[str, Any]:
    try:
        value = read_json(path)
    except FileNotFoundError:
        raise FolderError(f"{path.parent} has no file `{path.name}`; {remedy}") from None
    except (RecursionError, ValueError) as error:
        raise FolderError(f"{path} is damaged: {error}; {remedy}") from None
    if not isinstance(value, dict):
        raise FolderError(f"{path} is damaged: it is not a JSON object; {remedy}")
    return value


def _remedy(checkpoint: Path) -> str:
    return f"remove the folder {checkpoint} to train from the beginning, or choose another folder for the run"


def _state(checkpoint: Path) -> State:
    path = checkpoint / "state.json"
    values = _read_json(path, _remedy(checkpoint))
    if not values.keys() <= asdict(State()).keys() or not isinstance(values.get("steps"), int):
        raise FolderError(f"{path} is damaged: it is not the state of a run; {_remedy(checkpoint)}")
    return State(**values)


def _restore(learner: Learner, checkpoint: Path) -> None:
    """Restore a learner, and check that the best policy of the checkpoint can be loaded."""
    pickled = next((path for path in sorted(checkpoint.iterdir()) if path.suffix in (".pkl", ".zip")), None)
    if pickled is not None:
        why = "which could run any code when it is loaded, so this version does not read it"
        raise FolderError(f"{pickled} is a pickle of an earlier version, {why}; {_remedy(checkpoint)}")
    best = checkpoint / f"best{learner.suffix}"
    try:
        with random_state.keep():
            learner.policy_class.load(best)
        learner.restore(checkpoint)
    except FileNotFoundError as error:
        name = Path(str(error.filename)).name
        raise FolderError(f"{checkpoint} has no file `{name}`; {_remedy(checkpoint)}") from error
    except Exception as error:
        damaged = next((path for path in sorted(checkpoint.iterdir()) if not _readable(path)), None)
        if damaged is None and isinstance(error, (OSError, MemoryError)):
            raise
        reason = first_line(str(error), type(error).__name__)
        what = f"cannot resume from {checkpoint}" if damaged is None else f"{damaged} is damaged"
        raise FolderError(f"{what}: {reason}; {_remedy(checkpoint)}") from error


def _readable(path: Path) -> bool:
    """Return whether a file of a checkpoint is complete, as far as its format shows."""
    try:
        if path.suffix == ".pt":
            check_readable(path)
            with zipfile.ZipFile(path) as archive:
                return archive.testzip() is None
    except OSError:
        raise
    except Exception:
        # Depending on the bytes, the decompression raises almost any exception.
        return False
    return True


def _check_folder(run: Path, config: TrainConfig, state: State) -> None:
    """Check that a folder has no run and no other files, or a run of this configuration with no more steps."""
    stored = run / "config.json"
    if not stored.exists():
        # A failed run may leave some entries, and the inputs of a cell of an experiment are there before its run.
        cell = r"|cell\.json|log\.txt|start\..*" if (run / "cell.json").exists() else ""
        expected = re.compile(rf"\..*|tensorboard|wandb{cell}")
        foreign = sorted(path.name for path in run.iterdir() if not expected.fullmatch(path.name))
        if foreign:
            raise FolderError(f"{run} is not empty (`{foreign[0]}`) and has no run: choose another folder")
        return
    old, new = _read_json(stored, f"remove {run} or choose another folder"), config.to_dict()
    changed = [f"`{name}`" for name in {**old, **new} if name != "steps" and new.get(name) != old.get(name)]
    if changed:
        what = f"another configuration ({', '.join(changed)} differ)"
        raise FolderError(f"{run} has a run of {what}; remove it or choose another folder")
    if new["steps"] < state.steps and new["steps"] < old.get("steps", 0):
        rule = f"`steps` can be raised, not lowered to {new['steps']}"
        raise FolderError(f"{run} has a run of {state.steps} steps: {rule}")


def check_start(config: TrainConfig, *, trust: bool = False) -> SavedPolicy | None:
    """Return the policy of `start`, if there is one. `trust` and the exceptions are those of `load_policy`.

    A policy of another learner is a `ValueError`.
    """
    if config.start is None:
        return None
    try:
        with random_state.keep():
            saved = load_policy(config.start, trust=trust)
    except ValueError as error:
        kind = UntrustedError if isinstance(error, UntrustedError) else ValueError
        raise kind(f"`start`: {error}") from None
    if saved.algorithm != config.algorithm:
        raise ValueError(f"`start`: {saved.path} is a policy of `{saved.algorithm}`, not of `{config.algorithm}`")
    return saved


@contextmanager
def _enough_memory(config: TrainConfig) -> Iterator[None]:
    """Raise an error that names the largest setting if the block runs out of memory."""
    if config.learner.interacts and hasattr(os, "sysconf"):
        needed, total = config.envs * ENV_BYTES, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if needed > total:
            what = f"{config.envs} environments need more than {_gib(needed)} of memory"
            raise ValueError(f"`envs`: {what}, and this machine has {_gib(total)}")
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        # PyTorch raises a plain `RuntimeError`.
        asked = re.search(r"allocate (\d+) bytes", str(error))
        if not isinstance(error, MemoryError) and asked is None:
            raise
        reason = f"it asks for {_gib(int(asked[1]))}" if asked else first_line(str(error), "the system has none left")
        sizes = {"envs": config.envs}
        for name, setting in config.settings.model_dump().items():
            numbers = [each for each in (setting if isinstance(setting, tuple) else [setting]) if type(each) is int]
            sizes |= {f"settings.{name}": max(numbers)} if numbers else {}
        name, value = max(sizes.items(), key=lambda item: item[1])
        raise ValueError(f"`{name}`: {value} needs too much memory: {reason}") from error


def _gib(size: int) -> str:
    return f"{size / 2**30:,.1f} GiB"


def check_overrides(config: TrainConfig) -> None:
    """Check that the overrides keep the observations.

    Raises:
        InputError: If an override is invalid.
        ValueError: If the overrides change the shape of observations or the order of entities in them.
    """
    if not config.overrides:
        return
    tasks = (load_task(config.mode), load_task(config.mode, overrides=config.overrides))
    shapes = [tuple(task.shape(config.observation)) for task in tasks]
    orders = [_logicity.describe(task)["order"] for task in tasks]
    for what, (usual, changed) in {"shape of observations": shapes, "order of entities": orders}.items():
        if usual != changed:
            raise ValueError(
                f"the `overrides` change the {what} from {usual} to {changed}, but validation and test use the mode "
                "without overrides: write a configuration file with these changes, and name it under `mode`"
            )


@dataclass
class _Training:
    """Validates a learner at intervals, keeps the best policy, and writes checkpoints."""

    _run: Path
    _learner: Learner
    _state: State
    _benchmark: Benchmark
    _display: _Display
    _curves: _ValidationCurves
    _report: Callable[[int], None] | None

    def __post_init__(self) -> None:
        self._config, state = self._learner.config, self._state
        # The CPU time is that of this process and of the processes that it has waited for.
        self._cpu_before = sum(os.times()[:4]) - state.cpu_seconds
        self._wall_before = time.monotonic() - state.wall_seconds

    def progress(self) -> None:
        """Show and report the steps. Validate at the first call at or after each multiple of `validate_every` steps."""
        steps, every = self._learner.steps, self._config.validate_every
        self._display.update(steps)
        if steps // every > self._state.steps // every:
            self._validate()
        if self._report is not None:
            self._report(self._learner.steps)

    def finish(self) -> None:
        """Validate the trained learner, unless its last step is validated already."""
        self._display.update(self._learner.steps)
        if self._state.steps < self._learner.steps or not self._state.validations:
            self._validate()

    def _validate(self) -> None:
        policy = self._learner.policy()
        with random_state.keep():
            measured = self._benchmark.evaluate(policy, name=self._config.algorithm)
        state = self._state
        state.steps = self._learner.steps
        state.cpu_seconds = sum(os.times()[:4]) - self._cpu_before
        state.wall_seconds = time.monotonic() - self._wall_before
        point = {"steps": state.steps, "cpu_seconds": round(state.cpu_seconds, 2)}
        measures = measured.to_dict()
        point |= {name: measures[name] for name in (*MEASURES, "dsr_by_action", "mean_return", "mean_steps")}
        state.validations.append(point)
        self._curves.add(point)
        self._display.say(f"validation after {state.steps:,} steps: {measured.summary()}")
        if state.best is None or _rank(point) > _rank(state.best):
            state.best = point
        self._checkpoint()

    def _checkpoint(self) -> None:
        """Write a checkpoint atomically, then remove the older ones."""
        name = f"checkpoint-{self._state.steps:010}"
        temporary = self._run / f".{name}"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir()
        self._learner.save(temporary)
        old, best = _checkpoints(self._run), f"best{self._learner.suffix}"
        if self._state.best is self._state.validations[-1]:
            self._learner.policy().save(temporary / best)
        else:
            shutil.copyfile(old[-1] / best, temporary / best)
        (temporary / "state.json").write_text(json_text(asdict(self._state)), encoding="utf-8", newline="\n")
        temporary.rename(self._run / name)
        for folder in old:
            shutil.rmtree(folder)


def _rank(point: Mapping[str, Any]) -> tuple[float, float]:
    return point["tsr"]["value"], point["score"]["value"]


class _ValidationCurves:
    """The measures of validations as training curves, for TensorBoard and Weights & Biases."""

    def __init__(self, run: Path, config: TrainConfig, log: Path | None, project: str | None) -> None:
        """Start or resume the run of Weights & Biases if a project is given."""
        self._curves, self._wandb = Curves(log and log / "validation"), None
        if project is not None:
            try:
                import wandb
            except ImportError as error:
                raise ImportError("`wandb` needs the package wandb: pip install wandb") from error
            identity = hashlib.sha256(str(run.resolve()).encode()).hexdigest()[:16]
            about = {"project": project, "name": run.name, "dir": str(run), "config": config.to_dict()}
            self._wandb = wandb.init(**about, id=identity, resume="allow")

    def close(self) -> None:
        if self._wandb is not None:
            self._wandb.finish()

    def add(self, point: Mapping[str, Any]) -> None:
        values = {f"validation/{name}": point[name]["value"] for name in MEASURES}
        if self._wandb is not None:
            self._wandb.log(values, step=point["steps"])
        self._curves.add(values)
        self._curves.write(point["steps"])
        # The point is in the file before the checkpoint is.
        self._curves.close()

    def finish(self, result: Mapping[str, Any]) -> None:
        """Send the measures on the test episodes."""
        if self._wandb is not None:
            self._wandb.summary.update({f"test/{name}": result["test"][name]["value"] for name in MEASURES})


class _Display:
    """Shows progress on standard error: a bar on a terminal, and lines otherwise."""

    #: The interval between two lines.
    SECONDS = 10.0

    def __init__(self, config: TrainConfig, learner: Learner, enabled: bool) -> None:
        self._total, self._before = config.steps, learner.steps
        self._begun = self._shown = time.monotonic()
        bar = enabled and sys.stderr is not None and sys.stderr.isatty()
        self._has_lines = enabled and not bar
        self.bar = tqdm(total=self._total, initial=self._before, unit=" steps", dynamic_ncols=True, disable=not bar)

    def say(self, line: str) -> None:
        if self._has_lines:
            print_message(line)
        elif not self.bar.disable:
            self.bar.write(neutral(line), file=sys.stderr)

    def update(self, steps: int) -> None:
        """Show the number of steps; as a line only if the last line is at least `SECONDS` old."""
        self.bar.update(steps - self.bar.n)
        now = time.monotonic()
        if self._has_lines and now - self._shown >= self.SECONDS and steps > self._before:
            self._shown = now
            speed = (steps - self._before) / (now - self._begun)
            left = max(0, self._total - steps) / speed / 60
            share = min(1.0, steps / self._total)
            self.say(f"{steps:,} of {self._total:,} steps ({share:.0%}), {speed:,.0f} steps/s, {left:.1f} min left")


def _checkpoints(run: Path) -> list[Path]:
    return sorted(run.glob("checkpoint-*"))


def _result(config: TrainConfig, learner: Learner, state: State, measured: Evaluation) -> dict[str, Any]:
    versions = {"logicity": __version__, "python": sys.version.split()[0], "processor": processor()}
    for name in ("torch", "stable-baselines3", "torch-geometric", "numpy"):
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return {
        "config": config.to_dict(),
        "versions": versions,
        "hashes": state.hashes,
        "steps": state.steps,
        "unit": learner.unit,
        "cpu_seconds": round(state.cpu_seconds, 2),
        "minutes": round(state.wall_seconds / 60, 2),
        "best": state.best,
        **learner.outcome(),
        "test": measured.to_dict(),
        "validations": state.validations,
    }


def config_faults(config: TrainConfig, trust: bool) -> list[Fault]:
    """Return the faults in `mode`, `start` and `overrides`, which `train` reports only when it runs.

    Raises:
        InputError: If the configuration of the mode is invalid.
    """
    found: list[Fault] = []
    try:
        check_start(config, trust=trust)
    except OSError as error:
        reason = f"cannot read `{config.start}`: {error.strerror.lower()}" if error.strerror else str(error)
        found.append(("missing-file", ["start"], reason, ""))
    except ValueError as error:
        found.append(("invalid-value", ["start"], str(error), ""))
    try:
        check_overrides(config)
    except InputError as error:
        if (known := faults_of_overrides(config, error)) is None:
            raise
        found += known
    except ValueError as error:
        found.append(("invalid-value", ["overrides"], str(error), ""))
    return found
