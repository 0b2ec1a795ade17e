"""What a task adds to experiments: what a cell is, how it runs and is measured, and what the paper reports."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel

from ..errors import did_you_mean
from ..evaluation import Interval
from ..learn.faults import Fault
from ..terminal import print_message
from .experiment import Experiment, Place, Selection
from .paper import paper_table

__all__ = ["Cell", "CellKey", "Running", "Task"]


@dataclass(frozen=True)
class CellKey:
    """The row, the mode of the column, the variant (or an empty text) and the seed of a cell of an experiment."""

    row: str
    mode: str
    variant: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Cell(CellKey):
    """A cell of an experiment: one run, with its measures.

    Attributes:
        settings: The settings, as `Task.settings` returns them.
        evaluations: The evaluations by name, for tasks that have several.
        start: The cell from whose model the training starts.
        optional: Whether the learner may be missing on this machine.
        hidden: Whether tables omit the cell.
    """

    task: Task
    settings: Any
    evaluations: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    start: Cell | None = None
    optional: bool = False
    hidden: bool = False

    @property
    def name(self) -> str:
        """A name for people, such as `dqn, easy, seed 0`."""
        return ", ".join(filter(None, (self.row, self.variant, Path(self.mode).stem, f"seed {self.seed}")))

    @cached_property
    def spec(self) -> dict[str, Any]:
        """What determines the result of the cell, for JSON."""
        return self.task.spec(self)

    @cached_property
    def identity(self) -> str:
        """The SHA-256 of `spec`."""
        return hashlib.sha256(json.dumps(self.spec, sort_keys=True).encode()).hexdigest()

    def folder(self, root: Path) -> Path:
        """Return the folder of the cell in that of an experiment. Another identity has another folder."""
        parts = (self.row, Path(self.mode).stem, self.variant, str(self.seed), self.identity[:12])
        name = "-".join(filter(None, parts))
        return root / "cells" / "".join(each if each.isalnum() or each in "-._" else "_" for each in name)


@dataclass(frozen=True)
class Running:
    """A running cell.

    Attributes:
        folder: The folder of the cell, with its files of the run.
        document: The content of `cell.json`, with the `spec` of the cell.
        report: Receives the number of finished steps.
        progress: Whether to write lines of progress to standard error.
        wandb: The project of Weights & Biases.
        trust: Whether the policy that a training configuration names under `start` may run code.
        note: Receives what users should know before the cell ends.
    """

    folder: Path
    document: Mapping[str, Any]
    report: Callable[[int], None] = lambda steps: None
    progress: bool = False
    wandb: str | None = None
    trust: bool = False
    note: Callable[[str], None] = print_message


class Task(ABC):
    """A task of experiments. An evaluation is the content of one of the `evaluations` in `measured.json`."""

    #: The value of the key `task`.
    name: ClassVar[str]
    #: The title of the task.
    title: ClassVar[str]
    #: The class of the experiments.
    experiment: ClassVar[type[Experiment]]
    #: The class of the settings in `changes`, for the schema; `None` if another schema has them.
    settings_class: ClassVar[type[BaseModel] | None] = None
    #: The measures with their headings, in the order of the paper's figures.
    measures: ClassVar[Mapping[str, str]]
    #: How many of the measures tables always have. The others appear if a run has them.
    main_measures: ClassVar[int] = 6
    #: The headings of modes, if they are not their names.
    mode_titles: ClassVar[Mapping[str, str]] = {}
    #: What messages call a mode.
    mode_word: ClassVar[str] = "mode"
    #: The measure that figures show.
    headline: ClassVar[str]
    #: What the headline is measured on, for the axes of figures.
    measured_on: ClassVar[str]
    #: The name of the file of the model, unless it differs between cells.
    model_file: ClassVar[str] = ""
    #: The key of evaluations with what `intervals` needs.
    sampled: ClassVar[str]
    #: Other measures, which published rows have and tables do not show.
    more_measures: ClassVar[Sequence[str]] = ()
    #: A sentence on the intervals.
    interval_note: ClassVar[str]
    #: The title of the details of an evaluation.
    details_title: ClassVar[str] = ""
    #: The table of the paper that has the rows.
    paper: ClassVar[str]
    #: Whether finished trainings can be reused, see `logicity.experiments.cells.reuse`.
    reusable: ClassVar[bool] = False
    #: Whether cells send curves to Weights & Biases.
    sends_curves: ClassVar[bool] = False
    #: The headline of guessing, if it is known.
    chance: ClassVar[float | None] = None

    # --- what a cell is

    def mode_fault(self, folder: Path, path: list[str], mode: str) -> Fault | None:
        """Return the error of a mode that a file in a folder names, or `None`. By default modes have `mode_titles`."""
        if mode in self.mode_titles:
            return None
        return "invalid-value", path, f"unknown {self.mode_word} `{mode}`{did_you_mean(mode, self.mode_titles)}", ""

    def located_mode(self, mode: str, folder: Path) -> str:
        """Return a mode that a file in a folder names, as it can be used from any folder."""
        return mode

    def faults(self, experiment: Any, file: Path) -> Iterable[Fault]:
        """Return the errors in the keys of the task. By default those in settings, see `setting_faults`."""
        # A value of the experiment is part of many cells.
        first: dict[tuple[str, ...], Fault] = {}
        for quick, (row, spec) in product((False, True), experiment.learners.items()):
            for variant in spec.variants or experiment.variants:
                places = experiment.places(row, variant, quick)
                for fault in self.setting_faults(experiment, file, row, variant, places):
                    first.setdefault(tuple(fault[1]), fault)
        return first.values()

    def setting_faults(
        self, experiment: Any, file: Path, row: str, variant: str, places: Sequence[Place]
    ) -> Iterable[Fault]:
        """Return the errors in the settings of a row and a variant, which may be unknown, where they are written."""
        return ()

    @abstractmethod
    def settings(
        self, experiment: Any, file: Path, key: CellKey, selection: Selection, *, started: bool, check: bool
    ) -> BaseModel:
        """Return the settings of a cell of an experiment with a file, with the changes of a selection.

        `started` is whether the cell starts from another one, and `check` whether to check what otherwise appears when
        the cell runs, which does not depend on the seed.

        Raises:
            InputError: If the file has an invalid setting.
            ValueError: If the changes of the selection are invalid.
        """

    def evaluations(self, experiment: Any) -> dict[str, dict[str, Any]]:
        """Return the evaluations of each cell, by name, if a task has several."""
        return {}

    @abstractmethod
    def spec(self, cell: Cell) -> dict[str, Any]:
        """Return what determines the result of a cell, for JSON. It has the `version` of the package."""

    def document(self, cell: Cell, root: Path) -> dict[str, Any]:
        """Return what `run` needs besides the spec of a cell, for JSON."""
        return {}

    def environment(self, cell: Cell) -> dict[str, str]:
        """Return environment variables for `run`, such as those with secrets, which no file has."""
        return {}

    @staticmethod
    def check_unchanged(spec: Mapping[str, Any], today: Mapping[str, Any]) -> None:
        """Raise `ValueError` if this process has other rules or other parts than the specification of a cell."""
        for name, value in today.items():
            if value != spec.get(name):
                raise ValueError(f"the {name} changed after the experiment had begun: run the same command again")

    @abstractmethod
    def steps(self, cell: Cell) -> int:
        """Return the number of steps of a cell, for estimates."""

    def model(self, folder: Path) -> Path:
        """Return the file of the model in the folder of a finished cell, from which other cells start."""
        return folder / self.model_file

    # --- how it runs and is measured

    @abstractmethod
    def run(self, running: Running) -> dict[str, Any]:
        """Run a cell, or resume it, and return the content of `measured.json` without the identity.

        `result` has `cpu_seconds`, `versions` and `hashes`, and `evaluations` the evaluations by name.

        Raises:
            ValueError: If this process has other rules or episodes than the cell.
        """

    @abstractmethod
    def measure_again(self, cell: Cell, root: Path) -> Mapping[str, Mapping[str, Any]]:
        """Return the evaluations of the model of a finished cell, measured now.

        Raises:
            ValueError: If the file of the model is damaged.
        """

    @abstractmethod
    def hashed(self, cell: Cell, root: Path) -> tuple[str, str]:
        """Return what identifies the model of a finished cell, `rules` or `weights`, and its SHA-256."""

    # --- what was measured

    @abstractmethod
    def intervals(self, evaluations: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
        """Return the measures of runs with 95 % intervals, from their evaluations."""

    def samples(self, evaluation: Mapping[str, Any]) -> Any:
        """Return what `intervals` needs of an evaluation, for the published rows. By default the value of `sampled`."""
        return evaluation[self.sampled]

    def evaluation_of(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return an evaluation that has what `intervals` needs, from a published row."""
        return {self.sampled: row["samples"]}

    def details(self, measured: Mapping[str, Any], name: str) -> dict[str, float]:
        """Return more figures of an evaluation with a name: one column of the table `details_title`."""
        return {}

    def remarks(self, evaluations: Sequence[Mapping[str, Any]]) -> Iterable[str]:
        """Return whole sentences on how `intervals` counts the evaluations of the runs of a row."""
        return ()

    def summary(self, measured: Mapping[str, Any]) -> str:
        """Return the headline of the first evaluation as text, such as `TSR 0.75 (test)`."""
        name, evaluation = next(iter(measured["evaluations"].items()))
        value = self.intervals([evaluation])[self.headline].value
        return f"{self.measures[self.headline]} {value:.2f}" + f" ({name})" * bool(name)

    def curve(self, measured: Mapping[str, Any]) -> list[tuple[int, float]]:
        """Return the headline on the validation data by step."""
        return []

    def row_faults(self, row: Mapping[str, Any], experiment: Any) -> Iterable[str]:
        """Return the faults of a published row that only this task knows."""
        return ()

    # --- what the paper reports

    def paper_value(self, table: str | None, row: str, variant: str, mode: str) -> dict[str, float] | str | None:
        """Return the paper's figures of a cell by measure, a remark instead, or `None` if it has no such cell."""
        values = paper_table(table).get("rows", {}).get(row, {}).get(variant, {}).get(Path(mode).stem)
        if not isinstance(values, list):
            return values  # type: ignore[no-any-return]
        return {name: value for name, value in zip(self.measures, values, strict=False) if value is not None}

    def paper_details(self, table: str | None, mode: str) -> tuple[dict[str, dict[str, float]], str]:
        """Return the paper's figures for the table `details_title` in a mode, by their heading, and where they stand.

        The heading says what the paper measured.
        """
        return {}, ""
