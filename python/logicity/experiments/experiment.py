"""The YAML files of experiments: rows x modes x variants x seeds, and changes to the settings of each."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args

from pydantic import BaseModel, Field, Strict

from .. import _logicity
from ..errors import did_you_mean
from ..learn.faults import Fault, contains, merged
from ..learn.settings import Seed, StrictModel
from .paper import paper_table

__all__ = [
    *("Experiment", "Names", "Place", "Row", "Seeds", "Selection", "Variant"),
    *("changes_of", "experiment_faults", "fault_error", "option_error", "place_of"),
    *("read_experiment", "unknown_in"),
]

Seeds = Annotated[tuple[Seed, ...], Strict(False), Field(min_length=1)]
Names = Annotated[tuple[str, ...], Strict(False), Field(min_length=1)]

#: A mapping of changes, and the path of keys to it in the file.
Place: TypeAlias = tuple[list[str], Mapping[str, Any]]

#: The keys that changes cannot have, and where to write them instead.
OWN_KEYS = {"seed": "write the seeds under `seeds`", "mode": "write it under `modes`, or as the `mode` of a variant"}

#: What `--set` cannot change, and which option does.
OPTIONS = {"seed": "use `--seeds`", "mode": "use `--only LEARNER,MODE`", "algorithm": "write another experiment"}


class Row(StrictModel):
    """A row of the table: a learner with its settings."""

    paper: str | None = None
    """The row of the paper's table whose figures are shown beside this row. By default the row of the same name."""
    modes: Names | None = None
    """The modes; by default those of the experiment."""
    variants: Names | None = None
    """The variants; by default all."""
    seeds: Seeds | None = None
    """The seeds; by default those of the experiment."""
    start: str | None = None
    """The row from whose model, of the same mode, variant and seed, the training starts."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings, after those of the experiment."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """More changes to the settings for `--quick`, which runs only a few steps."""
    optional: bool = False
    """Whether the row needs a program that may be missing. Without it, the row has only the figures of the paper."""
    hidden: bool = False
    """Whether tables and figures omit the row, for example because it only provides a start for others."""


class Variant(StrictModel):
    """A variant of every row."""

    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings, after those of the experiment and the row."""
    paper: str | None = None
    """The variant of the paper's table whose figures are shown beside this one. By default that of the same name."""
    mode: str | None = None
    """The mode instead of that of the column."""
    start: str | None = None
    """The variant from whose models, of the same row and seed, the training starts."""
    hidden: bool = False
    """Whether tables and figures omit the variant, for example because it only provides a start for others."""
    group: str | None = None
    """The line of the figure over `x` to which the variant belongs: variants of a row with the same group form one."""
    x: float | None = None
    """The position on the horizontal axis of that figure, which omits variants without it."""


class Experiment(StrictModel):
    """An experiment of any task: what `logicity experiment` runs."""

    task: str
    """The task, which determines the settings."""
    title: str
    """The title of the table."""
    paper: str | None = None
    """The table of the paper whose figures are shown beside the results."""
    learners: Annotated[Mapping[str, Row], Field(min_length=1)]
    """The rows of the table, by name."""
    modes: Names
    """The modes, which are the columns of the table."""
    seeds: Seeds = (0,)
    """The seeds. Each row, mode and variant is run once with each seed."""
    variants: Annotated[dict[str, Variant], Field(min_length=1)] = Field(default_factory=lambda: {"": Variant()})
    """The variants of every row, by name: changes that multiply the rows. By default one without changes."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings of every row."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """More changes to the settings of every row for `--quick`."""
    x: str = "x"
    """The label of the horizontal axis of the figure over the `x` of variants."""

    def columns(self, row: str) -> tuple[Names, Names]:
        """Return the modes and the variants of a row."""
        spec = self.learners[row]
        return spec.modes or self.modes, spec.variants or tuple(self.variants)

    def of_paper(self, row: str, variant: str) -> tuple[str, str]:
        """Return the row and the variant of the paper's table that are shown beside a row and a variant."""
        return self.learners[row].paper or row, self.variants[variant].paper or variant

    def places(self, row: str, variant: str, quick: bool, usual: Mapping[str, Any] | None = None) -> list[Place]:
        """Return the changes to the settings of a row and a variant. Later ones override earlier ones.

        `quick` includes those for `--quick`, and `usual` are those of every experiment of the task.
        """
        spec = self.learners[row]
        places: list[Place] = [
            (["changes"], self.changes),
            (["learners", row, "changes"], spec.changes),
            (["variants", variant, "changes"], self.variants[variant].changes if variant in self.variants else {}),
        ]
        return places + [([], usual or {}), (["quick"], self.quick), (["learners", row, "quick"], spec.quick)] * quick


@dataclass(frozen=True)
class Selection:
    """A selection of cells, and changes to them.

    Attributes:
        only: Rows, each with a mode, and with a mode and a variant, or without them for all. Empty for all cells.
        seeds: Seeds that replace those of the experiment.
        changes: Changes to the settings of every cell.
        quick: Whether to use tiny budgets, and only the first seed.
        trust: Whether policies that training configurations name under `start` may run code, as for `train`.
    """

    only: Sequence[tuple[str, ...]] = ()
    seeds: tuple[int, ...] | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)
    quick: bool = False
    trust: bool = False

    def __post_init__(self) -> None:
        for key, help in OPTIONS.items():
            if key in self.changes:
                raise ValueError(f"--set: each cell has its own `{key}`: {help}")

    def chosen(self, rows: Mapping[str, tuple[Sequence[str], Sequence[str]]]) -> Iterator[tuple[str, str, list[str]]]:
        """Yield the selected rows, each with one of its modes and the variants to run in it, in the order of the rows.

        `rows` has the modes and the variants of each row. Raises `ValueError` for an unknown name in the selection.
        """
        for row, *names in self.only:
            if row not in rows:
                raise ValueError(f"--only: unknown learner `{row}`{did_you_mean(row, rows)}")
            for kind, name, known in zip(("mode", "variant"), names, rows[row], strict=False):
                if name not in known:
                    raise ValueError(f"--only: `{row}` has no {kind} `{name}`{did_you_mean(name, known)}")
        for row, (modes, variants) in rows.items():
            for mode in modes:
                named = [(row, mode, name) for name in variants]
                own = [each for each in named if not self.only or any(each[: len(only)] == only for only in self.only)]
                if own:
                    yield row, mode, [name for _, _, name in own]


def changes_of(places: Sequence[Place], *more: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changes of all places and then more changes, merged."""
    return reduce(merged, (*(values for _, values in places), *more), {})


def place_of(places: Sequence[Place], path: Sequence[str]) -> list[str] | None:
    """Return where a path of settings is written in the file, or `None` if no place has it."""
    # The last one overrides the others.
    return next(([*prefix, *path] for prefix, values in reversed(places) if contains(values, path)), None)


def read_experiment(name: str | os.PathLike[str]) -> tuple[Path, _logicity.ConfigFile, dict[str, Any]]:
    """Return the path, the file and the content of an experiment. The exceptions are those of `load_experiment`."""
    path = Path(name)
    if not path.suffix and len(path.parts) == 1:
        path = Path("configs") / "experiments" / f"{path}.yaml"
    file = _logicity.ConfigFile(path, "configs/experiments")
    values = file.value()
    if not isinstance(values, dict):
        raise file.error([("invalid-value", [], "an experiment must be a mapping", "")])
    return path, file, values


def option_error(fault: Fault) -> ValueError:
    """Return the error for a fault in the changes of `--set`."""
    _, path, message, help = fault
    return ValueError(f"--set {'.'.join(path)}: {message}" + f"\nhelp: {help}" * bool(help))


def fault_error(
    file: _logicity.ConfigFile, wrong: list[Fault], changes: Mapping[str, Any], places: Sequence[Place] = ()
) -> BaseException:
    """Return the error for faults in a file, or for the first one in changes to it.

    A missing key is missing in a changed mapping. A misspelled key may also cause a missing one. Paths of settings lead
    to where `places` have them.
    """
    for fault in sorted(wrong, key=lambda fault: fault[0] == "missing-key"):
        if contains(changes, fault[1][:-1] if fault[0] == "missing-key" else fault[1]):
            return option_error(fault)
    return file.error([(code, place_of(places, path) or path, message, help) for code, path, message, help in wrong])


def unknown_in(model: type[BaseModel], *, whole: bool = False) -> Callable[[tuple[str, ...]], tuple[str, str]]:
    """Return a function that gives the message and the help for an unknown key, see `faults`.

    Fields of the model can be models, too, or mappings of models. `whole` is whether the message has the whole path.
    """

    def unknown(path: tuple[str, ...]) -> tuple[str, str]:
        known: Any = model
        if len(path) > 1:
            annotation = model.model_fields[path[0]].annotation
            known = next(each for each in (annotation, *get_args(annotation)) if hasattr(each, "model_fields"))
        help = did_you_mean(path[-1], known.model_fields).removeprefix("; ")
        return f"unknown key `{'.'.join(path) if whole else path[-1]}`", help

    return unknown


def experiment_faults(
    experiment: Experiment, usual: str, mode_fault: Callable[[list[str], str], Fault | None]
) -> Iterator[Fault]:
    """Yield the errors that types do not exclude: unknown and repeated names, and changes of seeds and modes.

    `usual` is the table whose rows are known if that of the experiment has none, because the paper shows a figure.
    `mode_fault` returns the error of a mode at a path, or `None`.
    """

    def unknown(path: list[str], kind: str, name: str | None, known: Iterable[str]) -> Iterator[Fault]:
        if name is not None and name not in known:
            yield "invalid-value", path, f"{kind} `{name}`{did_you_mean(name, known)}", ""

    lists: list[tuple[list[str], Sequence[object]]] = [(["modes"], experiment.modes), (["seeds"], experiment.seeds)]
    modes = [(["modes", str(at)], mode) for at, mode in enumerate(experiment.modes)]
    known: list[str] = []
    for row, spec in experiment.learners.items():
        path = ["learners", row]
        lists += [([*path, key], getattr(spec, key) or ()) for key in ("modes", "seeds", "variants")]
        modes += [([*path, "modes", str(at)], mode) for at, mode in enumerate(spec.modes or ())]
        if spec.start is not None and spec.start not in known:
            # A row that exists may be in the wrong place; another name may be misspelled.
            move = spec.start in experiment.learners and spec.start != row
            others = known if spec.start == row else [name for name in experiment.learners if name != row]
            help = f": move `{row}` below it" if move else did_you_mean(spec.start, others)
            message = f"`{row}` starts from `{spec.start}`, but no earlier row has this name{help}"
            yield "invalid-value", [*path, "start"], message, ""
        for name in spec.variants or ():
            yield from unknown([*path, "variants"], "unknown variant", name, experiment.variants)
        known.append(row)
    for path, values in lists:
        for twice in [value for at, value in enumerate(values) if value in values[:at]][:1]:
            yield "invalid-value", path, f"`{twice}` occurs twice", ""
    for name, variant in experiment.variants.items():
        path, start = ["variants", name], variant.start
        modes += [([*path, "mode"], variant.mode)] if variant.mode is not None else []
        yield from unknown([*path, "start"], "unknown variant", start, experiment.variants)
        if start is not None and start in experiment.variants and experiment.variants[start].start is not None:
            message = f"`{start}` itself starts from another variant: name a variant without `start`"
            yield "invalid-value", [*path, "start"], message, ""
    yield from filter(None, (mode_fault(path, mode) for path, mode in modes))
    rows = paper_table(experiment.paper).get("rows") or paper_table(usual)["rows"]
    for row, spec in experiment.learners.items():
        yield from unknown(["learners", row, "paper"], "the paper's table has no row", spec.paper, rows)
    columns = [variant for values in rows.values() for variant in values]
    for name, variant in experiment.variants.items():
        yield from unknown(["variants", name, "paper"], "the paper's table has no variant", variant.paper, columns)
    places = (experiment.places(row, name, True) for row in experiment.learners for name in experiment.variants)
    for prefix, changes in {tuple(path): values for each in places for path, values in each}.items():
        for key in OWN_KEYS.keys() & changes.keys():
            yield "invalid-value", [*prefix, key], f"each cell has its own {key}: {OWN_KEYS[key]}", ""
