"""The cells of experiments: each is one training run and its evaluations, in a separate folder.

A `Job` is a cell of any task, `Cell` one of Safe Path Following.

`python -m logicity.experiments.cells FOLDER` runs the cell in a folder. It ends when its standard input is closed. So
it does not outlive the process that started it. Everything in the folder is data, except for a model that `--trust`
permits.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import shutil
import sys
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any, cast

from .. import _logicity
from .._logicity import __version__
from ..evaluation import Benchmark
from ..files import check_readable, read_json, write_json
from ..learn.config import TrainConfig
from ..learn.policies import load_policy
from ..learn.run import train
from ..learn.supervise import end_with_parent
from ..modes import ENVIRONMENTS
from ..tasks import task_hashes
from ..terminal import print_message

__all__ = ["Cell", "Job", "benchmark_of", "finished", "inputs", "prepare", "reuse", "run_cell"]

#: The version of the format of `cell.json` and `measured.json`. Cells of another version are run again.
FORMAT = 1

#: The evaluation on the recorded test episodes, which every training run makes at its end.
TEST = {"split": "test", "fresh": None, "seed": 0}

#: The modules whose function `run_cell` runs the cells of tasks other than `spf`. Its arguments are those of `run_cell`
#: here, except for `trust`.
RUNNERS = {"vap": "logicity.experiments.vap.experiment"}


@dataclass(frozen=True, kw_only=True)
class Job(ABC):
    """A unit of work of an experiment, whose result depends on nothing but `spec`.

    Attributes:
        row: The name of the row: a learner with its settings.
        mode: The mode of the column.
        variant: The name of the variant, or an empty text.
        seed: The seed.
        start: The cell from whose model the training starts.
        optional: Whether the learner may be missing on this machine.
        hidden: Whether tables omit the cell.
    """

    row: str
    mode: str
    variant: str
    seed: int
    start: Job | None = None
    optional: bool = False
    hidden: bool = False

    @property
    def name(self) -> str:
        """A name for people, such as `dqn, easy, seed 0`."""
        return ", ".join(part for part in (self.row, self.variant, Path(self.mode).stem, f"seed {self.seed}") if part)

    @property
    @abstractmethod
    def steps(self) -> int:
        """The number of training steps."""

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Return what determines the result of the cell, for JSON."""

    @abstractmethod
    def document(self, root: Path) -> dict[str, Any]:
        """Return the content of `cell.json`: everything that `run_cell` needs. `task` is `spf` or a key of `RUNNERS`.

        Args:
            root: The folder of the experiment.
        """

    @abstractmethod
    def model(self, root: Path) -> Path:
        """Return the file of the trained model in the folder of the experiment, from which other cells start."""

    @abstractmethod
    def headline(self, measured: Mapping[str, Any]) -> str:
        """Return the most important measure as text, such as `TSR 0.75 (test)`."""

    @cached_property
    def identity(self) -> str:
        """The SHA-256 of `spec`."""
        return hashlib.sha256(json.dumps(self.spec(), sort_keys=True).encode()).hexdigest()

    def folder(self, root: Path) -> Path:
        """Return the folder of the cell in that of an experiment. Another identity has another folder."""
        parts = (self.row, Path(self.mode).stem, self.variant, str(self.seed), self.identity[:12])
        name = "-".join(part for part in parts if part)
        return root / "cells" / "".join(each if each.isalnum() or each in "-._" else "_" for each in name)


@dataclass(frozen=True, kw_only=True)
class Cell(Job):
    """A training run of a learner of Safe Path Following, and the evaluations of its policy.

    Attributes:
        config: The training configuration, without `start`.
        evaluations: The evaluations by name: the split of the agents, the number of new episodes or `None` for the
            recorded ones, and the seed of the new episodes.
    """

    config: TrainConfig
    evaluations: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: {"test": TEST})

    @property
    def steps(self) -> int:
        """The number of training steps."""
        return self.config.steps

    def spec(self) -> dict[str, Any]:
        """Return what determines the result of the cell: settings, rules, episodes, evaluations and version."""
        config = self.config.to_dict()
        mode = config.pop("mode")
        return {
            "format": FORMAT,
            "version": __version__,
            "mode": Path(mode).name,
            "config": config,
            "hashes": _hashes(mode),
            "evaluations": {name: dict(each) for name, each in self.evaluations.items()},
            "start": None if self.start is None else self.start.identity,
        }

    def document(self, root: Path) -> dict[str, Any]:
        """Return the content of `cell.json`."""
        return {"task": "spf", "spec": self.spec(), "config": self.config.to_dict()}

    def model(self, root: Path) -> Path:
        """Return the file of the best policy."""
        return load_policy(self.folder(root)).path

    def headline(self, measured: Mapping[str, Any]) -> str:
        """Return the TSR of the first evaluation."""
        name, evaluation = next(iter(measured["evaluations"].items()))
        return f"TSR {evaluation['tsr']['value']:.2f} ({name})"


@cache
def _hashes(mode: str) -> dict[str, Any]:
    return task_hashes(mode)


def prepare(cell: Job, root: Path) -> Path:
    """Create the folder of a cell, whose file `cell.json` contains everything that `run_cell` needs.

    Raises:
        OSError: If the folder cannot be written, or the model to start from cannot be read.
    """
    folder = cell.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    if cell.start is not None and not list(folder.glob("start.*")):
        best = cell.start.model(root)
        temporary = folder / f".start{best.suffix}"
        shutil.copyfile(best, temporary)
        temporary.rename(folder / f"start{best.suffix}")
    document = {"identity": cell.identity, "row": cell.row, "variant": cell.variant, **cell.document(root)}
    write_json(folder / "cell.json", document)
    return folder


#: A file in the folder of a cell that names the cell of another experiment whose training it has.
_REUSED = "reused.json"


def inputs(folder: Path) -> list[Path]:
    """Return the files in the folder of a cell that `run_cell` needs, apart from checkpoints."""
    patterns = ["cell.json", "start.*"]
    if (folder / _REUSED).exists():
        patterns += [_REUSED, "config.json", "result.json", "best.*", "rules.dl"]
    return [path for pattern in patterns for path in folder.glob(pattern)]


def reuse(cells: Sequence[Job], root: Path, other: Path) -> list[str]:
    """Copy the trainings of finished cells of another experiment to the cells that have not begun and train the same.

    Only their evaluations can differ, so the result is that of training again, except for the times.

    Args:
        cells: The cells.
        root: The folder of the experiment.
        other: The folder of the other experiment.

    Returns:
        A line for each copied training.

    Raises:
        OSError: If the other folder has no cells, or a file cannot be read or written.
    """
    trained = {}
    if not (other / "cells").is_dir():
        raise FileNotFoundError(f"{other}: not the folder of an experiment: it has no folder `cells`")
    for path in sorted(other.glob("cells/*/cell.json")):
        try:
            document = read_json(path)
            if document["task"] == "spf" and _measured(path.parent, document["identity"]) is not None:
                trained[_training(document["spec"])] = path.parent
        except (ValueError, KeyError, RecursionError, TypeError):
            continue  # of another version, or of another program
    lines = []
    for cell in cells:
        folder = cell.folder(root)
        source = trained.get(_training(cell.spec())) if isinstance(cell, Cell) else None
        if source is None or folder.exists():
            continue
        temporary = folder.with_name(f".{folder.name}")
        shutil.rmtree(temporary, ignore_errors=True)
        left_out = shutil.ignore_patterns("cell.json", "measured.json", "log.txt", "fresh-*", "start.*")
        shutil.copytree(source, temporary, ignore=left_out, copy_function=_copy)
        write_json(temporary / _REUSED, {"cell": source.name})
        temporary.rename(folder)
        lines.append(f"{cell.name}: the training of {source}")
    return lines


def _copy(source: str, target: str) -> None:
    """Copy a regular file."""
    check_readable(source, whole=False)
    shutil.copy2(source, target)


def _training(spec: Mapping[str, Any]) -> str:
    """Return what determines the training of a cell of Safe Path Following."""
    return json.dumps({key: value for key, value in spec.items() if key != "evaluations"}, sort_keys=True)


def finished(cell: Job, root: Path) -> dict[str, Any] | None:
    """Return the content of `measured.json` of a cell, or `None` if the cell is not finished or has no model.

    Raises:
        OSError: If the file cannot be read.
    """
    return _measured(cell.folder(root), cell.identity)


def _measured(folder: Path, identity: str) -> dict[str, Any] | None:
    """Return the content of `measured.json` in a folder with a model, if it is that of the cell with an identity."""
    try:
        measured = read_json(folder / "measured.json")
    except (FileNotFoundError, NotADirectoryError, RecursionError, ValueError):
        return None
    if not any(folder.glob("best.*")) and not (folder / "model.pt").exists():
        return None
    return measured if isinstance(measured, dict) and measured.get("identity") == identity else None


def run_cell(
    folder: Path,
    report: Callable[[int], None] | None = None,
    *,
    progress: bool = False,
    wandb: str | None = None,
    trust: bool = False,
) -> dict[str, Any]:
    """Run the cell that `prepare` wrote to a folder, or resume it from its last checkpoint.

    Args:
        folder: The folder.
        report: Receives the number of training steps.
        progress: Whether to write lines of progress to standard error.
        wandb: The project of Weights & Biases, as for `train`.
        trust: Whether the policy that a training configuration names under `start` may run code, as for `train`.

    Returns:
        The content of `measured.json`: the identity, the result of the training, and the evaluations by name.

    Raises:
        ValueError: If this process has another version of the package, rules or episodes than the cell.
        Exception: Those of the training and of the evaluations.
    """
    document = read_json(folder / "cell.json")
    spec = document["spec"]
    # The process that ran the cell may have been lost after its last file.
    measured = _measured(folder, document["identity"])
    if measured is not None:
        return measured
    if spec["version"] != __version__:
        raise ValueError(
            f"the cell is of version {spec['version']} of logicity, this process of {__version__}: install one version "
            "on all machines"
        )
    if document["task"] != "spf":
        runner = importlib.import_module(RUNNERS[document["task"]])
        # Cells of other tasks load only data.
        measured = runner.run_cell(folder, report, progress=progress, wandb=wandb)
        return cast("dict[str, Any]", measured)
    values = document["config"]
    for start in folder.glob("start.*"):
        values["start"] = str(start)
    config = TrainConfig.model_validate(values)
    changed = [name for name, value in task_hashes(config.mode).items() if spec["hashes"].get(name) != value]
    if changed:
        raise ValueError(
            f"`{config.mode}` has another content of {', '.join(changed)} than when the experiment began: run the same "
            "command again"
        )
    result = _trained(folder) or train(config, folder, progress=progress, report=report, wandb=wandb, trust=trust)
    policy = load_policy(folder).policy
    evaluations = {}
    for name, each in spec["evaluations"].items():
        benchmark = benchmark_of(folder, config, each)
        if each == TEST:
            evaluations[name] = dict(result["test"])
        else:
            evaluations[name] = benchmark.evaluate(policy, name=config.algorithm).to_dict()
            # Not the path of the file of new episodes, which depends on the machine.
            evaluations[name]["mode"] = spec["mode"]
        evaluations[name]["random_returns"] = benchmark.random_returns()
    if config.start is not None:
        # The path depends on the machine; the hash of the file is in the result.
        result["config"]["start"] = Path(config.start).name
    measured = {
        "identity": document["identity"],
        "result": {key: value for key, value in result.items() if key != "test"},
        "evaluations": evaluations,
    }
    write_json(folder / "measured.json", measured)
    for checkpoint in folder.glob("checkpoint-*"):
        shutil.rmtree(checkpoint)
    return measured


def _trained(folder: Path) -> dict[str, Any] | None:
    """Return the result of a finished training in the folder of a cell, or `None`.

    A cell with one was reused or has lost its `measured.json`.
    """
    try:
        result = read_json(folder / "result.json")
    except (FileNotFoundError, RecursionError, ValueError):
        return None
    complete = isinstance(result, dict) and "test" in result and any(folder.glob("best.*"))
    return result if complete else None


def benchmark_of(folder: Path, config: TrainConfig, evaluation: Mapping[str, Any]) -> Benchmark:
    """Return the benchmark of an evaluation. New episodes are made in the folder of the cell, once."""
    mode = config.mode if evaluation["fresh"] is None else _fresh(folder, config.mode, evaluation)
    return Benchmark(mode, evaluation["split"], observation=config.observation)


def _fresh(folder: Path, mode: str, evaluation: Mapping[str, Any]) -> str:
    """Make new episodes of a split in a folder, and return a configuration file that names them."""
    split, count, seed = evaluation["split"], evaluation["fresh"], evaluation["seed"]
    episodes = folder / f"fresh-{split}-{count}-{seed}.jsonl"
    if not episodes.exists():
        options = ["--split", split, "--count", str(count), "--seed", str(seed), "-o", str(episodes)]
        code, _, _ = _logicity.run_command_line(["episodes", "make", mode, *options])
        if code:
            raise OSError(f"`logicity episodes make {mode} {' '.join(options)}` failed")
    config = episodes.with_suffix(".yaml")
    if mode in ENVIRONMENTS:
        base = f"configs/{mode}.yaml"
    else:
        base = str(Path(mode).resolve()) if Path(mode).is_file() else mode
    config.write_text(f"base: {json.dumps(base)}\ntask: {{episodes: {{{split}: {episodes.name}}}}}\n", encoding="utf-8")
    return str(config)


class _Reporter:
    """Writes lines of JSON to the process that reads the standard output: the number of steps, at most twice a second.

    The standard output of everything else becomes the standard error.
    """

    def __init__(self) -> None:
        self._last = -1.0
        self._out = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)

    def __call__(self, steps: int) -> None:
        now = time.monotonic()
        if now - self._last >= 0.5:
            self._last = now
            self.write({"steps": steps})

    def write(self, line: dict[str, Any]) -> None:
        print(json.dumps(line), file=self._out, flush=True)


def _main() -> int:
    end_with_parent()
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trust", action="store_true")
    parser.add_argument("--wandb")
    given = parser.parse_args()
    reporter = _Reporter()
    try:
        run_cell(given.folder, reporter, progress=True, wandb=given.wandb, trust=given.trust)
    except Exception as error:
        print_message(traceback.format_exc().rstrip())
        reporter.write({"error": str(error) or type(error).__name__})
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
