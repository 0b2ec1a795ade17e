"""Experiments: learners x modes x variants x seeds, from a YAML file.

`load_experiment` reads an experiment of any task. `Experiment` is one of Safe Path Following.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, TypeVar, cast

from pydantic import BaseModel, Field, Strict, ValidationError

from ... import _logicity
from ...errors import InputError, did_you_mean
from ...learn.config import TrainConfig, fault_of_override, unused
from ...learn.faults import Fault, contains, faults, merged
from ...learn.run import check_overrides, check_start
from ...learn.settings import Count, Seed, StrictModel
from ...modes import ENVIRONMENTS, checked_mode
from ..cells import TEST, Cell, Job
from ..report import paper_table

__all__ = [
    *("AnyExperiment", "AnyReport", "Experiment", "Selection"),
    *("load_experiment", "name_of", "option_error", "paper_faults", "read_experiment", "repeated", "selected"),
    *("start_faults", "unknown_key", "validated"),
]

#: The module and the class of the experiments of each task, the value of the key `task`.
TASKS = {
    "spf": ("logicity.experiments.spf.experiment", "Experiment"),
    "vap": ("logicity.experiments.vap.experiment", "VapExperiment"),
}

#: The placeholders in the key `config`.
PLACEHOLDERS = ("{row}", "{mode}")

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
    """The training configuration, in the form of `config` of the experiment, which it replaces."""
    paper: str | None = None
    """The row of the paper's table whose figures are shown beside this row. By default the row of the same name."""
    modes: _Names | None = None
    """The modes; by default those of the experiment."""
    variants: _Names | None = None
    """The variants; by default all."""
    seeds: _Seeds | None = None
    """The seeds; by default those of the experiment."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration, except `seed`, after those of the experiment."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """More changes to the training configuration for `--quick`, which runs only a few steps."""
    optional: bool = False
    """Whether the learner needs a program that may be missing. Without it, the row has only the figures of the
    paper."""


class Variant(StrictModel):
    """A variant of every row."""

    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the training configuration, after those of the experiment and the row."""
    start: str | None = None
    """The variant from whose policies, of the same row, mode and seed, the training starts."""
    hidden: bool = False
    """Whether tables and figures omit the variant, for example because it only provides a start for others."""
    group: str | None = None
    """The line of the figure over `x` to which the variant belongs: variants of a row with the same group form one."""
    x: float | None = None
    """The position on the horizontal axis of that figure, which omits variants without it."""


class EvaluationSpec(StrictModel):
    """The episodes of an evaluation."""

    split: Literal["train", "val", "test"] = "test"
    """The split whose agents and episodes are used."""
    fresh: Count | None = None
    """The number of new episodes to generate. By default the recorded episodes of the split are used."""
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

    def submit(
        self, file: Path, cells: Sequence[Job], root: Path, results: Path, *, only_hashes: bool = False
    ) -> Iterator[str]:
        """Write rows of the published results, and yield lines of progress."""


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
        # `logicity.experiments.language.experiment` reads the files with the task `language`.
        shown = task if isinstance(task, str) else "~" if task is None else json.dumps(task)
        suggestion = did_you_mean(shown, [*TASKS, "language"])
        raise file.error([("invalid-value", ["task"], f"unknown task `{shown}`{suggestion}", "")])
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


def repeated(values: Sequence[object]) -> str | None:
    """Return a message about the first value that occurs twice, or `None`."""
    twice = next((value for at, value in enumerate(values) if value in values[:at]), None)
    return None if twice is None else f"`{twice}` occurs twice"


class Startable(Protocol):
    """A variant of an experiment."""

    @property
    def start(self) -> str | None:
        """The variant from which training starts."""


def start_faults(variants: Mapping[str, Startable]) -> Iterator[Fault]:
    """Yield the errors in the key `start` of variants: unknown names, and chains of more than two variants."""
    for name, variant in variants.items():
        path = ["variants", name, "start"]
        if variant.start is not None and variant.start not in variants:
            message = f"unknown variant `{variant.start}`{did_you_mean(variant.start, variants)}"
            yield "invalid-value", path, message, ""
        elif variant.start is not None and variants[variant.start].start is not None:
            message = f"`{variant.start}` itself starts from another variant: name a variant without `start`"
            yield "invalid-value", path, message, ""


class PaperRow(Protocol):
    """A row of an experiment."""

    @property
    def paper(self) -> str | None:
        """The row of the paper's table."""


def paper_faults(table: str | None, rows: Mapping[str, PaperRow], usual: str) -> Iterator[Fault]:
    """Yield the rows whose key `paper` names no row of the paper's table.

    Args:
        table: The table that the experiment names.
        rows: The rows of the experiment.
        usual: The table whose rows are known if that of the experiment has none, because the paper shows a figure.
    """
    known = paper_table(table).get("rows") or paper_table(usual)["rows"]
    for name, row in rows.items():
        if row.paper is not None and row.paper not in known:
            message = f"the paper's table has no row `{row.paper}`{did_you_mean(row.paper, known)}"
            yield "invalid-value", ["learners", name, "paper"], message, ""


def option_error(fault: Fault) -> ValueError:
    """Return the error for a fault in the changes of `--set`."""
    _, path, message, help = fault
    return ValueError(f"--set {'.'.join(path)}: {message}" + f"\nhelp: {help}" * bool(help))


def selected(only: Sequence[tuple[str, str | None]], modes: Mapping[str, Sequence[str]]) -> list[tuple[str, str]]:
    """Return the selected pairs of a row and a mode, in the order of the rows.

    Args:
        only: `Selection.only`.
        modes: The modes of each row.

    Raises:
        ValueError: If the selection names an unknown row or mode.
    """
    for row, mode in only:
        if row not in modes:
            raise ValueError(f"--only: unknown learner `{row}`{did_you_mean(row, modes)}")
        if mode is not None and mode not in modes[row]:
            raise ValueError(f"--only: `{row}` has no mode `{mode}`{did_you_mean(mode, modes[row])}")
    return [
        (row, mode)
        for row, known in modes.items()
        for mode in known
        if not only or (row, None) in only or (row, mode) in only
    ]


def unknown_key(
    model: type[BaseModel], parts: Mapping[str, type[BaseModel]]
) -> Callable[[tuple[str, ...]], tuple[str, str]]:
    """Return a function that gives the message and the help for an unknown key, see `faults`.

    Args:
        model: The class of the experiment.
        parts: The classes of the values of its mappings, such as `learners`, by key.
    """

    def unknown(path: tuple[str, ...]) -> tuple[str, str]:
        known = model if len(path) == 1 else parts[path[0]]
        return f"unknown key `{path[-1]}`", did_you_mean(path[-1], known.model_fields).removeprefix("; ")

    return unknown


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
    """The table of the paper whose figures are shown beside the results."""
    config: str = "{row}-{mode}"
    """The training configuration of each row: the name of a file in `configs/baselines`, or a path relative to this
    file. `{row}` and `{mode}` stand for the row and the mode."""
    learners: Annotated[dict[str, Row], Field(min_length=1)]
    """The rows of the table, by name: learners with their settings."""
    modes: _Names
    """The modes: names, or paths relative to this file."""
    seeds: _Seeds = (0,)
    """The seeds of training. Each row, mode and variant is trained once with each seed."""
    variants: Annotated[dict[str, Variant], Field(min_length=1)] = Field(default_factory=lambda: {"": Variant()})
    """The variants of every row, by name: changes that multiply the rows. By default one without changes."""
    evaluations: Annotated[dict[str, EvaluationSpec], Field(min_length=1)] = Field(
        default_factory=lambda: {"test": EvaluationSpec()}
    )
    """The evaluations of every policy, by name. By default one on the recorded test episodes."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to every training configuration, except `seed`."""

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
        wrong = [*start_faults(experiment.variants), *paper_faults(experiment.paper, experiment.learners, "spf")]
        wrong += [("invalid-value", at, message, "") for at, message in experiment._faults()]
        wrong += experiment._file_faults(path)
        if wrong:
            raise file.error(wrong)
        return experiment, path

    def _faults(self) -> Iterator[tuple[list[str], str]]:
        """Yield the paths and messages of errors: unknown variants, repeated values, changes of `seed`."""
        lists: dict[tuple[str, ...], Sequence[object]] = {("modes",): self.modes, ("seeds",): self.seeds}
        for row, spec in self.learners.items():
            for key in ("modes", "seeds", "variants"):
                lists["learners", row, key] = getattr(spec, key) or ()
        for path, values in lists.items():
            if message := repeated(values):
                yield list(path), message
        changes: dict[tuple[str, ...], Mapping[str, Any]] = {("changes",): self.changes}
        for name, variant in self.variants.items():
            changes["variants", name, "changes"] = variant.changes
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
        for path, changed in changes.items():
            if "seed" in changed:
                yield [*path, "seed"], "each cell has its own seed: write the seeds under `seeds`"

    def _file_faults(self, file: Path) -> Iterator[Fault]:
        """Yield the errors in the names of files: unknown and missing modes, and unknown placeholders in `config`."""
        modes: list[tuple[list[str], Sequence[str]]] = [(["modes"], self.modes)]
        configs: list[tuple[list[str], str]] = [(["config"], self.config)]
        for row, spec in self.learners.items():
            modes.append((["learners", row, "modes"], spec.modes or ()))
            configs.append((["learners", row, "config"], spec.config or ""))
        for path, names in modes:
            for at, mode in enumerate(names):
                if fault := _mode_fault([*path, str(at)], mode, file.parent):
                    yield fault
        for path, name in configs:
            for placeholder in re.findall(r"\{[^{}]*\}", name):
                if placeholder not in PLACEHOLDERS:
                    message = f"unknown placeholder `{placeholder}`{did_you_mean(placeholder, PLACEHOLDERS)}"
                    yield "invalid-value", path, message, ""

    def cells(self, file: Path, selection: Selection) -> list[Cell]:
        """Return the selected cells, each after the cell that it starts from.

        Args:
            file: The file of the experiment.
            selection: The cells to return, and changes to them.

        Raises:
            InputError: If a training configuration is missing or invalid, or two cells have the same settings.
            OSError: If a training configuration cannot be read.
            ValueError: If the selection names an unknown row or mode, or its changes are invalid.
        """
        instead = {
            "seed": "use `--seeds`",
            "mode": "use `--only LEARNER,MODE`",
            "algorithm": "write another experiment",
        }
        for key, help in instead.items():
            if key in selection.changes:
                raise ValueError(f"--set: each cell has its own `{key}`: {help}")
        found: dict[tuple[str, str, str, int], Cell] = {}
        modes = {row: spec.modes or self.modes for row, spec in self.learners.items()}
        for row, mode in selected(selection.only, modes):
            spec = self.learners[row]
            seeds = selection.seeds or spec.seeds or self.seeds
            for seed in seeds[:1] if selection.quick and selection.seeds is None else seeds:
                # Variants without a start come first.
                for name in sorted(spec.variants or self.variants, key=lambda name: bool(self.variants[name].start)):
                    variant = self.variants[name]
                    start = None if variant.start is None else found[row, mode, variant.start, seed]
                    try:
                        config = self._config(file, row, mode, name, seed, selection, check=seed == seeds[0])
                    except FileNotFoundError as error:
                        at = ["learners", row, *(["config"] if spec.config else [])]
                        help = "the key `config` names the training configuration"
                        raise read_experiment(file)[1].error([("missing-file", at, str(error), help)]) from None
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
            if same is cell:
                continue
            message = f"`{same.name}` and `{cell.name}` have the same settings: change or omit one of them"
            if selection.changes:
                raise ValueError(f"--set: {message}")
            raise read_experiment(file)[1].error([("invalid-value", ["learners", cell.row], message, "")])
        return list(found.values())

    def report(self, cells: Sequence[Job], root: Path, failed: Mapping[str, str]) -> AnyReport:
        """Return the results of cells, see `Report`."""
        from .report import Report

        return Report(self, cast(Sequence[Cell], cells), root, failed)

    def submit(
        self, file: Path, cells: Sequence[Job], root: Path, results: Path, *, only_hashes: bool = False
    ) -> Iterator[str]:
        """Write rows of the published results, see `results.submit`."""
        from .results import submit

        return submit(self, file, cast(Sequence[Cell], cells), root, results, only_hashes=only_hashes)

    def _config(
        self, file: Path, row: str, mode: str, name: str, seed: int, selection: Selection, *, check: bool
    ) -> TrainConfig:
        """Return the training configuration of a cell.

        Args:
            file: The file of the experiment.
            row: The row.
            mode: The mode.
            name: The name of the variant.
            seed: The seed.
            selection: Changes to the configuration.
            check: Whether to check what `train` reports only when it runs.
        """
        spec = self.learners[row]
        training = (spec.config or self.config).replace("{row}", row).replace("{mode}", Path(mode).stem)
        path, city = _training_file(file, training), file.parent / mode
        is_file = mode not in ENVIRONMENTS and city.is_file()
        changes: dict[str, Any] = {"mode": str(city.resolve()) if is_file else mode}
        sources: dict[tuple[str, ...], Mapping[str, Any]] = {
            ("changes",): self.changes,
            ("learners", row, "changes"): spec.changes,
            ("variants", name, "changes"): self.variants[name].changes,
        }
        for more in sources.values():
            changes = merged(changes, more)

        def rejected(wrong: list[Fault]) -> BaseException:
            for fault in wrong:
                if contains(selection.changes, fault[1]):
                    return option_error(fault)
            located = []
            for code, at, message, help in wrong:
                # Later changes replace earlier ones.
                where = [place for place, values in sources.items() if contains(values, at)]
                located.append((code, [*(where[-1] if where else ()), *at], message, help))
            return read_experiment(file)[1].error(located)

        config = TrainConfig.load(path, seed=seed, changes=merged(changes, selection.changes), rejected=rejected)
        if selection.quick:
            sources["learners", row, "quick"] = spec.quick
            short = merged(QUICK[config.learner.interacts], spec.quick)
            changes = merged(merged(changes, short), selection.changes)
            config = TrainConfig.load(path, seed=seed, changes=changes, rejected=rejected)
        start = self.variants[name].start
        if start is not None and (reason := unused(config.algorithm).get("start")):
            message = f"`{config.algorithm}` does not use the key `start`: {reason}"
            fault = ("invalid-value", ["variants", name, "start"], message, "")
            raise read_experiment(file)[1].error([fault])
        # The faults do not depend on the seed.
        if check and (wrong := _config_faults(config, selection.trust)):
            places = [*sources.values(), selection.changes]
            written = [fault for fault in wrong if any(contains(place, fault[1]) for place in places)]
            # The other faults are in the training configuration.
            raise rejected(written) if written else _logicity.ConfigFile(path, "configs/baselines").error(wrong)
        return config


@dataclass(frozen=True)
class Selection:
    """A selection of cells, and changes to them.

    Attributes:
        only: Pairs of a row and a mode, or of a row and `None` for all its modes. Empty for all cells.
        seeds: Seeds that replace those of the experiment.
        changes: Changes to every training configuration.
        quick: Whether to use tiny budgets, and only the first seed.
        trust: Whether policies that training configurations name under `start` may run code, as for `train`.
    """

    only: Sequence[tuple[str, str | None]] = ()
    seeds: tuple[int, ...] | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    quick: bool = False
    trust: bool = False


def _mode_fault(path: list[str], mode: str, folder: Path) -> Fault | None:
    """Return the fault of an unknown mode or a missing file, which may be in a folder, or `None`."""
    try:
        checked_mode(mode)
        if mode not in ENVIRONMENTS and not (folder / mode).exists():
            _logicity.ConfigFile(mode, "configs")
    except FileNotFoundError:
        return "missing-file", path, f"cannot read `{folder / mode}`: no such file", ""
    except InputError:
        # The file exists, and the message has its own location.
        return None
    except ValueError as error:
        return "invalid-value", path, str(error), ""
    return None


def _config_faults(config: TrainConfig, trust: bool) -> list[Fault]:
    """Return the faults in `mode`, `start` and `overrides`, which `train` reports only when it runs.

    Args:
        config: The configuration.
        trust: As for `train`.

    Raises:
        InputError: If the configuration of the mode is invalid.
    """
    if fault := _mode_fault(["mode"], config.mode, Path()):
        return [fault]
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


_unknown = unknown_key(Experiment, {"learners": Row, "variants": Variant, "evaluations": EvaluationSpec})
