"""Training runs: the loop that all learners share.

Each run has a folder. `config.json` is the configuration. `checkpoint-STEPS` holds the state to resume from: the
learner, the best policy so far, and the validation results. `tensorboard` has the training curves. At the end,
`best.pt` (or another suffix) is the best policy, and `result.json` has its measures on the test episodes. If the
policy is made of rules but is not a rule file, `rules.dl` has the rules.
"""

from __future__ import annotations

import hashlib
import json
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
from ..files import check_readable, file_hash, read_json, reserved, write_json
from ..tasks import load_task, task_hashes
from ..terminal import first_line, neutral, print_message
from . import random_state
from .config import TrainConfig, fault_of_override
from .faults import Fault
from .learner import Learner
from .policies import SavedPolicy, load_policy

__all__ = ["FolderError", "check_overrides", "check_start", "train"]

#: The packages whose versions `result.json` records, besides logicity, if they are installed.
PACKAGES = ("torch", "stable-baselines3", "torch-geometric", "numpy")

#: The memory of an environment without its observation, in bytes: a lower bound.
ENV_BYTES = 6 * 1024

#: The entries that a failed run may leave in a folder that it did not create.
_REMAINS = re.compile(r"\..*|tensorboard|wandb")

#: The inputs of a cell of an experiment, which are in the folder before its run.
_CELL = re.compile(r"cell\.json|log\.txt|start\..*")


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
    """Train a learner, or resume from the last checkpoint of the same configuration.

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

    Returns:
        The content of `result.json`.

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
        _check_hashes(run, state, hashes)
        state.hashes = hashes
        torch.set_num_threads(config.threads)
        # Load the test episodes now: an error in them must not surface after hours of training.
        val, test = (Benchmark(config.mode, split, observation=config.observation) for split in ("val", "test"))
        check_overrides(config)
        log = run / "tensorboard" if tensorboard else None
        curves = _ValidationCurves(run, config, log, wandb)
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
        display = files.enter_context(_Display(config, learner, progress))
        learner.say = display.say
        begun = f"resumed after {state.steps:,} of" if checkpoints else "started:"
        display.say(f"{config.algorithm} in {config.mode}, {begun} {config.steps:,} steps; folder {run}")
        files.enter_context(curves)
        training = _Training(run, learner, state, val, display, curves)

        def progress_and_report() -> None:
            training.progress()
            if report is not None:
                report(learner.steps)

        learner.fit(config.steps, progress_and_report)
        training.finish()
        suffix = learner.suffix
        shutil.copyfile(_checkpoints(run)[-1] / f"best{suffix}", run / f"best{suffix}")
        best = learner.policy_class.load(run / f"best{suffix}")
        rules = best.rules()
        if rules is not None and suffix != ".dl":
            (run / "rules.dl").write_text(rules, encoding="utf-8")
        result = _result(config, learner, state, test.evaluate(best, name=config.algorithm))
        curves.finish(result)
        write_json(run / "result.json", result, output=output)
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
        for folder in missing:
            try:
                folder.rmdir()
            except FileNotFoundError:
                continue
            except OSError:
                break
        raise


def _read_json(path: Path, remedy: str) -> dict[str, Any]:
    """Read a JSON object of a run."""
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
    """Return what to do about a damaged checkpoint."""
    return f"remove the folder {checkpoint} to train from the beginning, or choose another folder for the run"


def _state(checkpoint: Path) -> State:
    """Read the progress of a run."""
    path = checkpoint / "state.json"
    values = _read_json(path, _remedy(checkpoint))
    if not values.keys() <= asdict(State()).keys() or not isinstance(values.get("steps"), int):
        raise FolderError(f"{path} is damaged: it is not the state of a run; {_remedy(checkpoint)}")
    return State(**values)


def _restore(learner: Learner, checkpoint: Path) -> None:
    """Restore a learner, and check that the best policy of the checkpoint can be loaded."""
    pickled = next((path for path in sorted(checkpoint.iterdir()) if path.suffix in (".pkl", ".zip")), None)
    if pickled is not None:
        raise FolderError(
            f"{pickled} is a pickle of an earlier version, which could run any code when it is loaded, so this version "
            f"does not read it; {_remedy(checkpoint)}"
        )
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
        if damaged is None:
            raise FolderError(f"cannot resume from {checkpoint}: {reason}; {_remedy(checkpoint)}") from error
        raise FolderError(f"{damaged} is damaged: {reason}; {_remedy(checkpoint)}") from error


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
        expected = [_REMAINS, _CELL] if (run / "cell.json").exists() else [_REMAINS]
        names = sorted(path.name for path in run.iterdir())
        foreign = [name for name in names if not any(each.fullmatch(name) for each in expected)]
        if foreign:
            raise FolderError(f"{run} is not empty (`{foreign[0]}`) and has no run: choose another folder")
        return
    old, new = _read_json(stored, f"remove {run} or choose another folder"), config.to_dict()
    changed = [name for name in {**old, **new} if name != "steps" and new.get(name) != old.get(name)]
    if changed:
        raise FolderError(
            f"{run} has a run of another configuration ({', '.join(f'`{name}`' for name in changed)} differ); "
            "remove it or choose another folder"
        )
    if new["steps"] < state.steps and new["steps"] < old.get("steps", 0):
        raise FolderError(
            f"{run} has a run of {state.steps} steps: `steps` can be raised, not lowered to {new['steps']}"
        )


def _check_hashes(run: Path, state: State, hashes: Mapping[str, Any]) -> None:
    """Check that a run began with the same rules and episodes."""
    different = [name for name in hashes if state.hashes and state.hashes.get(name) != hashes[name]]
    if different:
        raise FolderError(
            f"{run} has a run with another content of {', '.join(different)}; remove it or choose another folder"
        )


def check_start(config: TrainConfig, *, trust: bool = False) -> SavedPolicy | None:
    """Return the policy of `start`, if there is one. `trust` is that of `load_policy`.

    Raises:
        OSError: If the file cannot be read.
        UntrustedError: As for `load_policy`.
        ValueError: If the file is not a policy of the learner.
    """
    if config.start is None:
        return None
    try:
        with random_state.keep():
            saved = load_policy(config.start, trust=trust)
    except UntrustedError as error:
        raise UntrustedError(f"`start`: {error}") from None
    except ValueError as error:
        raise ValueError(f"`start`: {error}") from None
    if saved.algorithm != config.algorithm:
        raise ValueError(f"`start`: {saved.path} is a policy of `{saved.algorithm}`, not of `{config.algorithm}`")
    return saved


@contextmanager
def _enough_memory(config: TrainConfig) -> Iterator[None]:
    """Raise an error that names the largest setting if the block runs out of memory."""
    if config.learner.interacts and hasattr(os, "sysconf"):
        needed, total = config.envs * ENV_BYTES, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if needed > total:
            raise ValueError(
                f"`envs`: {config.envs} environments need more than {_gib(needed)} of memory, and this machine has "
                f"{_gib(total)}"
            )
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        # PyTorch raises a plain `RuntimeError`.
        asked = re.search(r"allocate (\d+) bytes", str(error))
        if not isinstance(error, MemoryError) and asked is None:
            raise
        reason = f"it asks for {_gib(int(asked[1]))}" if asked else first_line(str(error), "the system has none left")
        name, value = max(_sizes(config).items(), key=lambda item: item[1])
        raise ValueError(f"`{name}`: {value} needs too much memory: {reason}") from error


def _gib(size: int) -> str:
    return f"{size / 2**30:,.1f} GiB"


def _sizes(config: TrainConfig) -> dict[str, int]:
    """Return the integers of a configuration that may determine its use of memory."""
    sizes = {"envs": config.envs}
    for name, value in config.settings.model_dump().items():
        numbers = [each for each in (value if isinstance(value, tuple) else [value]) if type(each) is int]
        if numbers:
            sizes[f"settings.{name}"] = max(numbers)
    return sizes


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


class _Training:
    """Validates a learner at intervals, keeps the best policy, and writes checkpoints."""

    def __init__(
        self, run: Path, learner: Learner, state: State, val: Benchmark, display: _Display, curves: _ValidationCurves
    ) -> None:
        """Start from a state."""
        self._run, self._config, self._learner, self._state = run, learner.config, learner, state
        self._benchmark, self._display, self._curves = val, display, curves
        self._cpu_before, self._wall_before = _cpu_seconds() - state.cpu_seconds, time.monotonic() - state.wall_seconds

    def progress(self) -> None:
        """Show the progress. Validate at the first call at or after each multiple of `validate_every` steps."""
        steps, every = self._learner.steps, self._config.validate_every
        self._display.update(steps)
        if steps // every > self._state.steps // every:
            self._validate()

    def finish(self) -> None:
        """Validate the trained learner, unless its last step is validated already."""
        self._display.update(self._learner.steps)
        if self._state.steps < self._learner.steps or not self._state.validations:
            self._validate()

    def _validate(self) -> None:
        """Validate the learner and write a checkpoint."""
        policy = self._learner.policy()
        with random_state.keep():
            measured = self._benchmark.evaluate(policy, name=self._config.algorithm)
        state = self._state
        state.steps = self._learner.steps
        state.cpu_seconds = _cpu_seconds() - self._cpu_before
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
        (temporary / "state.json").write_text(json.dumps(asdict(self._state), indent=1, allow_nan=False) + "\n")
        temporary.rename(self._run / name)
        for folder in old:
            shutil.rmtree(folder)


def _cpu_seconds() -> float:
    """Return the CPU time of this process and of the processes that it has waited for."""
    return sum(os.times()[:4])


def _rank(point: Mapping[str, Any]) -> tuple[float, float]:
    return point["tsr"]["value"], point["score"]["value"]


class _ValidationCurves:
    """The measures of validations as training curves, for TensorBoard and Weights & Biases."""

    def __init__(self, run: Path, config: TrainConfig, log: Path | None, project: str | None) -> None:
        """Store the folder of TensorBoard, and import Weights & Biases if a project is given."""
        self._run, self._config, self._log, self._project, self._wandb = run, config, log, project, None
        if project is not None:
            try:
                import wandb
            except ImportError as error:
                raise ImportError("`wandb` needs the package wandb: pip install wandb") from error
            self._start = wandb.init

    def __enter__(self) -> None:
        """Start or resume the run of Weights & Biases."""
        if self._project is not None:
            identity = hashlib.sha256(str(self._run.resolve()).encode()).hexdigest()[:16]
            about = {"project": self._project, "name": self._run.name, "dir": str(self._run)}
            self._wandb = self._start(**about, id=identity, resume="allow", config=self._config.to_dict())

    def __exit__(self, *error: object) -> None:
        if self._wandb is not None:
            self._wandb.finish()

    def add(self, point: Mapping[str, Any]) -> None:
        """Append the measures of a validation."""
        values = {f"validation/{name}": point[name]["value"] for name in MEASURES}
        if self._wandb is not None:
            self._wandb.log(values, step=point["steps"])
        if self._log is not None:
            from torch.utils.tensorboard.writer import SummaryWriter

            # A run that was interrupted before the checkpoint repeats its last validation.
            with SummaryWriter(str(self._log / "validation"), purge_step=point["steps"]) as writer:
                for name, value in values.items():
                    writer.add_scalar(name, value, point["steps"])

    def finish(self, result: Mapping[str, Any]) -> None:
        """Send the measures on the test episodes."""
        if self._wandb is not None:
            self._wandb.summary.update({f"test/{name}": result["test"][name]["value"] for name in MEASURES})


class _Display:
    """Shows progress on standard error: a bar on a terminal, and lines otherwise."""

    #: The interval between two lines.
    SECONDS = 10.0

    def __init__(self, config: TrainConfig, learner: Learner, enabled: bool) -> None:
        """Start at the number of steps of the learner."""
        self._total, self._before, self._enabled = config.steps, learner.steps, enabled
        self._begun = self._shown = time.monotonic()
        bar = enabled and sys.stderr is not None and sys.stderr.isatty()
        self._bar = tqdm(total=self._total, initial=self._before, unit=" steps", dynamic_ncols=True) if bar else None

    def __enter__(self) -> _Display:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, line: str) -> None:
        """Print a line."""
        if self._bar is not None:
            self._bar.write(neutral(line), file=sys.stderr)
        elif self._enabled:
            print_message(line)

    def update(self, steps: int) -> None:
        """Show the number of steps; as a line only if the last line is at least `SECONDS` old."""
        if self._bar is not None:
            self._bar.update(steps - self._bar.n)
            return
        now = time.monotonic()
        if self._enabled and now - self._shown >= self.SECONDS and steps > self._before:
            self._shown = now
            speed = (steps - self._before) / (now - self._begun)
            left = max(0, self._total - steps) / speed / 60
            share = min(1.0, steps / self._total)
            self.say(f"{steps:,} of {self._total:,} steps ({share:.0%}), {speed:,.0f} steps/s, {left:.1f} min left")


def _checkpoints(run: Path) -> list[Path]:
    return sorted(run.glob("checkpoint-*"))


def _result(config: TrainConfig, learner: Learner, state: State, measured: Evaluation) -> dict[str, Any]:
    return {
        "config": config.to_dict(),
        "versions": {"logicity": __version__, "python": sys.version.split()[0], **_versions()},
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


def _versions() -> dict[str, str]:
    """Return the versions of the installed packages among `PACKAGES`."""
    found = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


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
        known = [fault for each in error.diagnostics if (fault := fault_of_override(config, each)) is not None]
        if len(known) < len(error.diagnostics):
            raise
        found += known
    except ValueError as error:
        found.append(("invalid-value", ["overrides"], str(error), ""))
    return found
