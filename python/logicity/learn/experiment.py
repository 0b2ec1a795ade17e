"""Experiments: learners x modes x variants x seeds, from a YAML file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from .. import _logicity
from ..errors import InputError, did_you_mean
from .cells import TEST, Cell
from .config import TrainConfig, faults, merged
from .learner import Count

__all__ = ["Experiment", "Selection"]

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


class Experiment(_Model):
    """An experiment: what `logicity experiment` runs."""

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
        path = Path(name)
        if not path.suffix and len(path.parts) == 1:
            path = Path("configs") / "experiments" / f"{path}.yaml"
        file = _logicity.ConfigFile(path, "configs/experiments")
        values = file.value()
        if not isinstance(values, dict):
            raise file.error([("invalid-value", [], "an experiment must be a mapping", "")])
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
            used = spec.variants or ()
            for name in used:
                start = experiment.variants[name].start if name in experiment.variants else name
                if start is not None and start not in (used if name in experiment.variants else ()):
                    unknown = f"unknown variant `{name}`{did_you_mean(name, experiment.variants)}"
                    message = f"`{name}` starts from `{start}`" if name in experiment.variants else unknown
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
