"""Experiments: learners x modes x variants x seeds, from a YAML file.

`load_experiment` reads an experiment of any task. `Experiment` is one of Safe Path Following.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, cast

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from .. import _logicity
from ..errors import InputError, did_you_mean
from .cells import TEST, Cell, Job
from .config import TrainConfig, faults, merged
from .learner import Count

__all__ = ["AnyExperiment", "AnyReport", "Experiment", "Selection", "load_experiment", "read_experiment"]

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

_Seed = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
_Seeds = Annotated[tuple[_Seed, ...], Strict(False), Field(min_length=1)]
_Names = Annotated[tuple[str, ...], Strict(False), Field(min_length=1)]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class Row(_Model):
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
    """Changes to the training configuration."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration for `--quick`."""
    optional: bool = False
    """Whether the learner needs a program that may be missing. Then the row has only the figures of the paper."""


class Variant(_Model):
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


class EvaluationSpec(_Model):
    """The episodes of an evaluation."""

    split: Literal["train", "val", "test"] = "test"
    """The set of agents."""
    fresh: Count | None = None
    """The number of new episodes; by default the recorded ones."""
    seed: _Seed = 1000
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
    """Read the YAML file of an experiment of any task.

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
        suggestion = did_you_mean(str(task), TASKS)
        raise file.error([("invalid-value", ["task"], f"unknown task `{task}`{suggestion}", "")])
    module, kind = TASKS[task]
    loaded = getattr(importlib.import_module(module), kind).load(path)
    return cast(tuple[AnyExperiment, Path], loaded)


def read_experiment(name: str | os.PathLike[str]) -> tuple[Path, _logicity.ConfigFile, dict[str, Any]]:
    """Return the path, the file and the content of an experiment."""
    path = Path(name)
    if not path.suffix and len(path.parts) == 1:
        path = Path("configs") / "experiments" / f"{path}.yaml"
    file = _logicity.ConfigFile(path, "configs/experiments")
    values = file.value()
    if not isinstance(values, dict):
        raise file.error([("invalid-value", [], "an experiment must be a mapping", "")])
    return path, file, values


class Experiment(_Model):
    """An experiment of Safe Path Following: what `logicity experiment` runs."""

    task: Literal["spf"] = "spf"
    """The task, Safe Path Following."""
    title: str
    """The title of the table."""
    paper: str | None = None
    """The table of the paper beside which the results are shown."""
    config: str = "{row}-{mode}"
    """The training configuration of each row: the name of a file in `configs/baselines`, or a path relative to this
    file. `{row}` and `{mode}` stand for the row and the mode."""
    learners: Annotated[dict[str, Row], Field(min_length=1)]
    """The rows."""
    modes: _Names
    """The modes."""
    seeds: _Seeds = (0,)
    """The seeds."""
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
        try:
            experiment = cls.model_validate(values)
        except ValidationError as error:
            raise file.error(faults(error, _unknown, depth=3)) from None
        wrong = [
            ("invalid-value", ["variants", variant, "start"], f"unknown variant `{each.start}`", "")
            for variant, each in experiment.variants.items()
            if each.start is not None
            and (each.start not in experiment.variants or experiment.variants[each.start].start is not None)
        ]
        for row, spec in experiment.learners.items():
            chosen = spec.variants or ()
            for name in chosen:
                if name not in experiment.variants:
                    message = f"unknown variant `{name}`{did_you_mean(name, experiment.variants)}"
                    wrong.append(("invalid-value", ["learners", row, "variants"], message, ""))
                elif (start := experiment.variants[name].start) is not None and start not in chosen:
                    message = f"`{name}` starts from `{start}`, which is not among the variants"
                    wrong.append(("invalid-value", ["learners", row, "variants"], message, ""))
        if wrong:
            raise file.error(wrong)
        return experiment, path

    def cells(self, file: Path, selection: Selection) -> list[Cell]:
        """Return the selected cells, each after the cell that it starts from.

        Args:
            file: The file of the experiment.
            selection: The cells to return, and changes to them.

        Raises:
            InputError: If a training configuration is invalid.
            OSError: If a training configuration cannot be read.
            ValueError: If the selection names an unknown row, mode or variant.
        """
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
                        note = f"with the changes of `{row}` in {file}"
                        raise InputError(f"{str(error).rstrip()}\n |\n = note: {note}", error.diagnostics) from None
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
        return list(found.values())

    def report(self, cells: Sequence[Job], root: Path, failed: Mapping[str, str]) -> AnyReport:
        """Return the results of cells, see `Report`."""
        from .report import Report

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
        path = _training_file(file, (spec.config or self.config).format(row=row, mode=Path(mode).stem))
        changes = merged({"mode": mode}, self.changes)
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
