"""Experiments: learners x modes x variants x seeds, from a YAML file.

`load_experiment` reads an experiment of any task. `Experiment` is one of Safe Path Following.
"""

from __future__ import annotations

import importlib
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeVar, cast

from pydantic import BaseModel, Field, Strict, ValidationError

from .. import _logicity
from ..errors import InputError, did_you_mean
from ..modes import ENVIRONMENTS, checked_mode
from .cells import TEST, Cell, Job
from .config import TrainConfig, faults, merged
from .learner import Count, Seed, StrictModel

__all__ = [
    *("AnyExperiment", "AnyReport", "Experiment", "Selection"),
    *("load_experiment", "name_of", "read_experiment", "validated"),
]

#: The module and the class of the experiments of each task, the value of the key `task`.
TASKS = {
    "spf": ("logicity.learn.experiment", "Experiment"),
    "vap": ("logicity.vap.experiment", "VapExperiment"),
}

#: The keys of a short run of a learner in environments, and of another learner.
QUICK: dict[bool, dict[str, Any]] = {
    True: {"steps": 512, "validate_every": 256},
    False: {"steps": 8, "validate_every": 4},
}

_Seeds = Annotated[tuple[Seed, ...], Strict(False), Field(min_length=1)]
_Names = Annotated[tuple[str, ...], Strict(False), Field(min_length=1)]


class Row(StrictModel):
    """A row of the table: a learner with its settings."""

    config: str | None = None
    """The training configuration; `{mode}` stands for the mode. By default that of the experiment."""
    paper: str | None = None
    """The name of the paper's row. By default that of the row."""
    modes: _Names | None = None
    """The modes; by default those of the experiment."""
    variants: _Names | None = None
    """The variants; by default all."""
    seeds: _Seeds | None = None
    """The seeds; by default those of the experiment."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration, except `seed`."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration for `--quick`."""
    optional: bool = False
    """Whether the learner needs a program that may be missing. Then the row has only the figures of the paper."""


class Variant(StrictModel):
    """A variant of every row."""

    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration."""
    start: str | None = None
    """The variant from whose policies, of the same row and seed, the training starts."""
    hidden: bool = False
    """Whether tables omit the variant."""
    group: str | None = None
    """The line of the figure to which the variant belongs."""
    x: float | None = None
    """The place on that line."""


class EvaluationSpec(StrictModel):
    """The episodes of an evaluation."""

    split: Literal["train", "val", "test"] = "test"
    """The set of agents."""
    fresh: Count | None = None
    """The number of new episodes; by default the recorded ones."""
    seed: Seed = 1000
    """The seed of the new episodes."""


class AnyReport(Protocol):
    """The results of the cells of an experiment, as tables."""

    def text(self) -> str:
        """Return everything for a terminal."""

    def write(self, root: Path) -> list[Path]:
        """Write the tables and the figures to a folder, and return their paths."""


class AnyExperiment(Protocol):
    """An experiment of any task: what `logicity experiment` runs."""

    def cells(self, file: Path, selection: Selection) -> Sequence[Job]:
        """Return the selected cells, each after the cell that it starts from. See `Experiment.cells`."""

    def report(self, cells: Sequence[Job], root: Path, failed: Mapping[str, str]) -> AnyReport:
        """Return the results of cells in a folder, with the messages of those that failed, by identity."""

    def submit(self, file: Path, cells: Sequence[Job], root: Path, results: Path) -> Iterator[str]:
        """Write rows of the published results, and yield a line for each cell."""


def load_experiment(name: str | os.PathLike[str]) -> tuple[AnyExperiment, Path]:
    """Read the YAML file of an experiment of any task of `TASKS`.

    Args:
        name: The file, or the bare name of a built-in experiment such as `spf`.

    Returns:
        The experiment, and the path of its file.

    Raises:
        ImportError: If a package that the task needs is not installed.
        InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key.
        OSError: If the file cannot be read.
    """
    path, file, values = read_experiment(name)
    task = values.get("task", "spf")
    if not isinstance(task, str) or task not in TASKS:
        # `logicity.learn.language` reads the files with the task `language`.
        suggestion = did_you_mean(str(task), [*TASKS, "language"])
        raise file.error([("invalid-value", ["task"], f"unknown task `{task}`{suggestion}", "")])
    module, kind = TASKS[task]
    loaded = getattr(importlib.import_module(module), kind).load(path)
    return cast(tuple[AnyExperiment, Path], loaded)


def read_experiment(name: str | os.PathLike[str]) -> tuple[Path, _logicity.ConfigFile, dict[str, Any]]:
    """Return the path, the file and the content of an experiment.

    Raises:
        InputError: If the file is not YAML, or not a mapping.
        OSError: If the file cannot be read.
    """
    path = Path(name)
    if not path.suffix and len(path.parts) == 1:
        path = Path("configs") / "experiments" / f"{path}.yaml"
    file = _logicity.ConfigFile(path, "configs/experiments")
    values = file.value()
    if not isinstance(values, dict):
        raise file.error([("invalid-value", [], "an experiment must be a mapping", "")])
    return path, file, values


def name_of(file: Path) -> str:
    """Return what a command names to run the experiment of a file: its bare name if it is built in, or the file."""
    return file.stem if file == Path("configs") / "experiments" / f"{file.stem}.yaml" else shlex.quote(file.as_posix())


M = TypeVar("M", bound=BaseModel)


def validated(
    model: type[M],
    file: _logicity.ConfigFile,
    values: Mapping[str, Any],
    unknown: Callable[[tuple[str, ...]], tuple[str, str]],
) -> M:
    """Return the experiment with the content of a file. `unknown` is that of `faults`.

    Raises:
        InputError: If the content has an unknown key or invalid value, or lacks a key.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise file.error(faults(error, unknown, depth=3)) from None


class Experiment(StrictModel):
    """An experiment of Safe Path Following: what `logicity experiment` runs."""

    task: Literal["spf"] = "spf"
    """The task, Safe Path Following."""
    title: str
    """The title of the table."""
    paper: Literal["spf", "transfer", "composition", "observations"] | None = None
    """The table of the paper beside which the results are shown."""
    config: str = "{row}-{mode}"
    """The training configuration of each row: the name of a file in `configs/baselines`, or a path relative to this
    file. `{row}` and `{mode}` stand for the row and the mode."""
    learners: Annotated[dict[str, Row], Field(min_length=1)]
    """The rows."""
    modes: _Names
    """The modes: names, or paths relative to this file."""
    seeds: _Seeds = (0,)
    """One run per seed."""
    variants: Annotated[dict[str, Variant], Field(min_length=1)] = Field(default_factory=lambda: {"": Variant()})
    """The variants of every row."""
    evaluations: Annotated[dict[str, EvaluationSpec], Field(min_length=1)] = Field(
        default_factory=lambda: {"test": EvaluationSpec()}
    )
    """The evaluations of every policy; by default the recorded test episodes."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to every training configuration."""

    @classmethod
    def load(cls, name: str | os.PathLike[str]) -> tuple[Experiment, Path]:
        """Read a YAML file.

        Args:
            name: The file, or the bare name of a built-in experiment such as `spf`.

        Returns:
            The experiment, and the path of its file.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key.
            OSError: If the file cannot be read.
        """
        path, file, values = read_experiment(name)
        experiment = validated(cls, file, values, _unknown)
        wrong = [("invalid-value", path, message, "") for path, message in experiment._faults()]
        if wrong:
            raise file.error(wrong)
        return experiment, path

    def _faults(self) -> Iterator[tuple[list[str], str]]:
        """Yield the paths and the messages of unknown modes and variants, and of changes that have no effect."""
        modes = [(["modes"], mode) for mode in self.modes]
        for row, spec in self.learners.items():
            modes += [(["learners", row, "modes"], mode) for mode in spec.modes or ()]
        for where, mode in modes:
            try:
                checked_mode(mode)
            except ValueError as error:
                yield where, str(error)
        changes: dict[tuple[str, ...], Mapping[str, Any]] = {("changes",): self.changes}
        for name, variant in self.variants.items():
            changes["variants", name, "changes"] = variant.changes
            if variant.start is None:
                continue
            if variant.start not in self.variants:
                message = f"unknown variant `{variant.start}`{did_you_mean(variant.start, self.variants)}"
                yield ["variants", name, "start"], message
            elif self.variants[variant.start].start is not None:
                yield (
                    ["variants", name, "start"],
                    f"`{variant.start}` itself starts from another variant: name a variant without `start`",
                )
        for row, spec in self.learners.items():
            changes["learners", row, "changes"] = spec.changes
            changes["learners", row, "quick"] = spec.quick
            chosen = spec.variants or ()
            for name in chosen:
                if name not in self.variants:
                    message = f"unknown variant `{name}`{did_you_mean(name, self.variants)}"
                    yield ["learners", row, "variants"], message
                elif (start := self.variants[name].start) is not None and start not in chosen:
                    yield (
                        ["learners", row, "variants"],
                        f"`{name}` starts from `{start}`, which is not among the variants",
                    )
        for path, values in changes.items():
            if "seed" in values:
                yield [*path, "seed"], "each cell has its own seed: write the seeds under `seeds`"

    def cells(self, file: Path, selection: Selection) -> list[Cell]:
        """Return the selected cells, each after the cell that it starts from.

        Args:
            file: The file of the experiment.
            selection: The cells to return, and changes to them.

        Raises:
            InputError: If a training configuration is invalid.
            OSError: If a training configuration cannot be read.
            ValueError: If the selection names an unknown row or mode, its changes contain the seed or the mode, or two
                rows or variants have the same settings.
        """
        for key, option in {"seed": "--seeds", "mode": "--only LEARNER,MODE"}.items():
            if key in selection.changes:
                raise ValueError(f"--set: each cell has its own `{key}`: use `{option}`")
        found: dict[tuple[str, str, str, int], Cell] = {}
        for row, mode in self._columns(selection):
            spec = self.learners[row]
            seeds = selection.seeds or spec.seeds or self.seeds
            for seed in seeds[:1] if selection.quick and selection.seeds is None else seeds:
                # Variants without a start come first.
                for name in sorted(spec.variants or self.variants, key=lambda name: bool(self.variants[name].start)):
                    variant = self.variants[name]
                    start = None if variant.start is None else found[row, mode, variant.start, seed]
                    try:
                        config = self._config(file, row, mode, variant, seed, selection)
                    except InputError as error:
                        note = f"with the changes of `{row}` in {file}{' and of `--set`' if selection.changes else ''}"
                        raise InputError(f"{str(error).rstrip()}\n |\n = note: {note}", error.diagnostics) from None
                    except FileNotFoundError as error:
                        help = f"the key `config` of the row `{row}` in {file} names its training configuration"
                        raise FileNotFoundError(f"{error}\nhelp: {help}") from None
                    found[row, mode, name, seed] = Cell(
                        row=row,
                        mode=config.mode,
                        variant=name,
                        seed=seed,
                        config=config,
                        start=start,
                        evaluations={label: _evaluation(each) for label, each in self.evaluations.items()},
                        optional=spec.optional,
                        hidden=variant.hidden,
                    )
        unique: dict[str, Cell] = {}
        for cell in found.values():
            same = unique.setdefault(cell.identity, cell)
            if same is not cell:
                raise ValueError(f"`{same.name}` and `{cell.name}` have the same settings: change or omit one of them")
        return list(found.values())

    def report(self, cells: Sequence[Job], root: Path, failed: Mapping[str, str]) -> AnyReport:
        """Return the results of cells, see `Report`."""
        from .spf_report import Report

        return Report(self, cast(Sequence[Cell], cells), root, failed)

    def submit(self, file: Path, cells: Sequence[Job], root: Path, results: Path) -> Iterator[str]:
        """Write rows of the published results, see `results.submit`."""
        from .results import submit

        return submit(self, file, cast(Sequence[Cell], cells), root, results)

    def _columns(self, selection: Selection) -> list[tuple[str, str]]:
        """Return the selected pairs of a row and a mode."""
        for row, mode in selection.only:
            if row not in self.learners:
                raise ValueError(f"--only: unknown learner `{row}`{did_you_mean(row, self.learners)}")
            known = self.learners[row].modes or self.modes
            if mode is not None and mode not in known:
                raise ValueError(f"--only: `{row}` has no mode `{mode}`{did_you_mean(mode, known)}")
        return [
            (row, mode)
            for row, spec in self.learners.items()
            for mode in spec.modes or self.modes
            if not selection.only or (row, None) in selection.only or (row, mode) in selection.only
        ]

    def _config(
        self, file: Path, row: str, mode: str, variant: Variant, seed: int, selection: Selection
    ) -> TrainConfig:
        """Return the training configuration of a cell."""
        spec = self.learners[row]
        name = (spec.config or self.config).replace("{row}", row).replace("{mode}", Path(mode).stem)
        path, city = _training_file(file, name), file.parent / mode
        is_file = mode not in ENVIRONMENTS and city.is_file()
        changes = merged({"mode": str(city.resolve()) if is_file else mode}, self.changes)
        for more in (spec.changes, variant.changes):
            changes = merged(changes, more)
        config = TrainConfig.load(path, seed=seed, changes=merged(changes, selection.changes))
        if not selection.quick:
            return config
        short = merged(QUICK[config.learner.interacts], spec.quick)
        changes = merged(merged(changes, short), selection.changes)
        return TrainConfig.load(path, seed=seed, changes=changes)


@dataclass(frozen=True)
class Selection:
    """A selection of cells, and changes to them.

    Attributes:
        only: Pairs of a row and a mode, or of a row and `None` for all its modes. Empty for all cells.
        seeds: Seeds that replace those of the experiment.
        changes: Changes to every training configuration.
        quick: Whether to use tiny budgets, and only the first seed.
    """

    only: Sequence[tuple[str, str | None]] = ()
    seeds: tuple[int, ...] | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    quick: bool = False


def _evaluation(spec: EvaluationSpec) -> dict[str, Any]:
    values = spec.model_dump()
    # The seed has no effect on recorded episodes.
    return {**values, "seed": TEST["seed"]} if spec.fresh is None else values


def _training_file(file: Path, name: str) -> Path:
    """Return the path of a training configuration that an experiment names."""
    if Path(name).suffix:
        return file.parent / name
    beside = file.parent.parent / "baselines" / f"{name}.yaml"
    return beside if beside.exists() else Path("configs") / "baselines" / f"{name}.yaml"


def _unknown(path: tuple[str, ...]) -> tuple[str, str]:
    """Return the message and the help for an unknown key."""
    models: dict[str, type[BaseModel]] = {"learners": Row, "variants": Variant, "evaluations": EvaluationSpec}
    model = Experiment if len(path) == 1 else models[path[0]]
    return f"unknown key `{path[-1]}`", did_you_mean(path[-1], model.model_fields).removeprefix("; ")
