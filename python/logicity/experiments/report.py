"""The report of an experiment: tables of measures beside the paper's, and figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from ..evaluation import Interval
from ..files import write_json, write_text
from ..terminal import aligned, first_line
from .cells import finished
from .paper import paper_table
from .registry import Loaded
from .tables import draw_bars, draw_lines, draw_panels, latex_table, markdown_table
from .task import Cell, Task

__all__ = ["Entry", "Report", "detail_table", "grouped", "mean_details", "paper_rows", "shown"]

Key = TypeVar("Key")
Value = TypeVar("Value")

#: The line below a row that has the paper's figures.
PAPER = "  the paper's"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A line of a table: the runs of a row and variant in a mode, with one evaluation. Empty texts stand for no name.

    Attributes:
        row: The row.
        mode: The mode of the column.
        variant: The variant.
        evaluation: The evaluation, if there are several.
        seeds: The seeds of the finished runs.
        measures: The measures with their intervals; empty without a finished run.
        details: More figures, see `Task.details`: their means over the runs that have them.
        paper: The paper's figures by measure, a remark, or `None`.
        remarks: Sentences on how the runs count, see `Task.remarks`.
        curve: The headline on the validation data by step: means over the runs.
        cpu_hours: The CPU time of all runs.
        missing: Why there is no result; empty if there is one.
        identities: The identities of the runs.
        group: The line of the figure over `x` to which the variant belongs.
        x: The place on that line.
    """

    row: str
    mode: str
    variant: str
    evaluation: str
    seeds: tuple[int, ...]
    measures: Mapping[str, Interval]
    details: Mapping[str, float]
    paper: Mapping[str, float] | str | None
    remarks: tuple[str, ...]
    curve: tuple[tuple[int, float], ...]
    cpu_hours: float
    missing: str
    identities: tuple[str, ...]
    group: str | None
    x: float | None

    @property
    def label(self) -> str:
        """The row with its evaluation and variant."""
        return ", ".join(filter(None, (self.row, self.evaluation, self.variant)))


class Report:
    """The results of the cells of an experiment.

    Args:
        loaded: The experiment.
        cells: The cells. Results of other settings, rules, episodes or versions have another identity.
        root: The folder of the experiment.
        failed: The messages of the cells that failed, by identity.
    """

    def __init__(
        self, loaded: Loaded, cells: Sequence[Cell], root: Path, failed: Mapping[str, str] | None = None
    ) -> None:
        """Read the results."""
        self.task, self.experiment = loaded.task, loaded.experiment
        results = {cell.identity: finished(cell, root) for cell in cells}
        groups = grouped(((cell.mode, cell.row, cell.variant), cell) for cell in cells if not cell.hidden)
        self.entries = [entry for group in groups.values() for entry in self._entries(group, results, failed or {})]
        #: The CPU time of all finished cells.
        self.cpu_hours = sum(each["result"]["cpu_seconds"] for each in results.values() if each is not None) / 3600

    def _entries(self, cells: Sequence[Cell], results: Mapping[str, Any], failed: Mapping[str, str]) -> Iterator[Entry]:
        """Yield an entry for each evaluation of the runs of a row and variant in a mode."""
        first, task = cells[0], self.task
        done = [cell for cell in cells if results[cell.identity] is not None]
        runs = [results[cell.identity] for cell in done]
        variant = self.experiment.variants[first.variant]
        paper = task.paper_value(self.experiment.paper, *self.experiment.of_paper(first.row, first.variant), first.mode)
        names = list(runs[0]["evaluations"] if runs else first.evaluations or [""])
        several = len(names) > 1 or len(first.evaluations) > 1
        for name in names:
            evaluations = [run["evaluations"][name] for run in runs]
            yield Entry(
                row=first.row,
                mode=first.mode,
                variant=first.variant,
                evaluation=name if several else "",
                seeds=tuple(cell.seed for cell in done),
                measures=task.intervals(evaluations) if runs else {},
                details=mean_details([task.details(run, name) for run in runs]),
                paper=paper,
                remarks=tuple(task.remarks(evaluations)),
                curve=_mean_curve([task.curve(run) for run in runs]) if name == names[0] else (),
                cpu_hours=sum(run["result"]["cpu_seconds"] for run in runs) / 3600,
                missing=_why_missing(cells, done, failed),
                identities=tuple(cell.identity for cell in done),
                group=variant.group,
                x=variant.x,
            )

    @property
    def complete(self) -> bool:
        """Whether all runs are finished."""
        return all(not entry.missing for entry in self.entries)

    @property
    def modes(self) -> list[str]:
        """The modes with an entry."""
        return list(dict.fromkeys(entry.mode for entry in self.entries))

    def of_mode(self, mode: str) -> list[Entry]:
        """Return the entries of a mode."""
        return [entry for entry in self.entries if entry.mode == mode]

    def measures(self, mode: str) -> dict[str, str]:
        """Return the measures that some entry of a mode has, and the main ones, with their headings."""
        known = {name for entry in self.of_mode(mode) for name in entry.measures}
        known |= set(list(self.task.measures)[: self.task.main_measures])
        return {name: head for name, head in self.task.measures.items() if name in known}

    def table(self, mode: str) -> list[list[str]]:
        """Return the table of a mode: a head, then for each entry its measures, and the paper's below if it has any.

        Rows of the paper that the experiment does not have come last.
        """
        measures = self.measures(mode)
        lines = [["learner", *measures.values(), "seeds", "CPU h"]]
        for entry in self.of_mode(mode):
            figures = [shown(entry.measures.get(name)) for name in measures]
            seeds = ",".join(map(str, entry.seeds)) or entry.missing[:60]
            lines.append([entry.label, *figures, seeds, f"{entry.cpu_hours:.2f}"])
            if entry.paper is not None:
                lines.append([PAPER, *paper_cells(entry.paper, measures), "", ""])
        for label, paper in paper_rows(self.task, self.experiment.paper, mode, self._named()):
            lines.append([label, *paper_cells(paper, measures), "", ""])
        return lines

    def _named(self) -> set[tuple[str, str]]:
        """Return the rows of the paper's table that rows of the experiment name, with their variants."""
        experiment = self.experiment
        return {experiment.of_paper(row, name) for row in experiment.learners for name in experiment.variants}

    def details(self, mode: str) -> list[list[str]]:
        """Return the table of the details in a mode, beside the paper's; empty if no entry has any."""
        columns = {entry.label: entry.details for entry in self.of_mode(mode) if entry.details}
        return detail_table({**columns, **self.task.paper_details(self.experiment.paper, mode)[0]} if columns else {})

    def notes(self) -> list[str]:
        """Return sentences on intervals, missing cells, the paper and the CPU time."""
        notes = [self.task.interval_note]
        if table := paper_table(self.experiment.paper):
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        for entry in self.entries:
            _, source = self.task.paper_details(self.experiment.paper, entry.mode)
            if source and entry.details:
                notes.append(f"The paper's figures: {source}")
        for entry in self.entries:
            notes += entry.remarks
            if entry.missing:
                only = " The figures are the paper's." if not entry.seeds and entry.paper is not None else ""
                notes.append(f"{entry.label}, {Path(entry.mode).stem}: {entry.missing}.{only}")
        notes.append(f"CPU time: {self.cpu_hours:.2f} hours.")
        return list(dict.fromkeys(notes))

    def text(self) -> str:
        """Return everything for a terminal: a table per mode, the details, and notes."""
        tables = (f"\n{heading}\n{aligned(table)}" for heading, table in self._tables())
        return "\n".join([self.experiment.title, *tables, "", *self.notes()])

    def markdown(self) -> str:
        """Return the report as Markdown."""
        tables = (f"## {heading}\n\n{markdown_table(table)}" for heading, table in self._tables())
        notes = (f"- {note}" for note in self.notes())
        return "\n".join([f"# {self.experiment.title}\n", *tables, "## Notes\n", *notes]) + "\n"

    def _tables(self) -> Iterator[tuple[str, list[list[str]]]]:
        """Yield the heading and the table of each mode, and then of the details of each mode that has any."""
        for mode in self.modes:
            yield self._heading(mode), self.table(mode)
        for mode in self.modes:
            if details := self.details(mode):
                yield f"{self._heading(mode)}: {self.task.details_title}", details

    def _heading(self, mode: str) -> str:
        name = self.task.mode_titles.get(mode, Path(mode).stem)
        return name[0].upper() + name[1:]

    def latex(self) -> str:
        """Return the tables of the modes as LaTeX, with the rules of the package booktabs."""
        lines = [f"% {self.experiment.title}"]
        for mode in self.modes:
            lines += [f"% {self._heading(mode)}", *latex_table(self.table(mode))]
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the entries for JSON."""
        return {
            "task": self.task.name,
            "title": self.experiment.title,
            "paper": paper_table(self.experiment.paper).get("source"),
            "entries": [asdict(entry) for entry in self.entries],
            "cpu_hours": round(self.cpu_hours, 4),
            "notes": self.notes(),
        }

    def write(self, root: Path) -> list[Path]:
        """Write the tables and the figures to a folder, and return their paths.

        Raises:
            OSError: If a file cannot be written.
        """
        written = [root / f"table.{ending}" for ending in ("md", "tex", "json")]
        write_text(written[0], self.markdown())
        write_text(written[1], self.latex())
        write_json(written[2], self.to_dict())
        if not any(entry.measures for entry in self.entries):
            return written
        drawings = {"bars": self._bars}
        if any(entry.curve for entry in self.entries):
            drawings["curves"] = self._curves
        if any(entry.x is not None for entry in self.entries):
            drawings["lines"] = self._lines
        titles = {mode: f"{self.experiment.title}: {Path(mode).stem}" for mode in self.modes}
        tallest = max(len(self.table(mode)) for mode in self.modes)
        for name, draw in drawings.items():
            height = max(4.2, 0.22 * tallest) if name == "bars" else 4.2
            written += draw_panels(root, name, titles, draw, columns=min(len(titles), 2), size=(7.2, height))
        return written

    def _axis(self) -> str:
        return f"{self.task.measures[self.task.headline]} on {self.task.measured_on}"

    def _bars(self, axes: Any, mode: str) -> None:
        """Draw the headline of each entry with its interval, and the paper's."""
        name = self.task.headline
        bars = [(entry.label, entry.measures.get(name), headline_of(entry.paper, name)) for entry in self.of_mode(mode)]
        for label, paper in paper_rows(self.task, self.experiment.paper, mode, self._named()):
            bars.append((label, None, headline_of(paper, name)))
        draw_bars(axes, bars, self._axis())
        if self.task.chance is not None:
            axes.axvline(self.task.chance, color="#888888", linewidth=1, linestyle=":")

    def _curves(self, axes: Any, mode: str) -> None:
        """Draw the headline of the validations over the share of the training steps."""
        shares = {
            entry.label: [(step / (entry.curve[-1][0] or 1), value) for step, value in entry.curve]
            for entry in self.of_mode(mode)
            if entry.curve
        }
        for label, points in shares.items():
            axes.plot(*zip(*points, strict=True), marker="o", markersize=2, linewidth=1, label=label)
        axes.set_xlabel("share of the training steps")
        axes.set_ylabel(f"{self.task.measures[self.task.headline]} on validation data")
        axes.set_ylim(-0.02, 1.02)
        if shares:
            axes.legend(fontsize=7)

    def _lines(self, axes: Any, mode: str) -> None:
        """Draw the headline over `x`, one line for each row, evaluation and group."""
        lines: dict[str, list[tuple[float, Interval]]] = {}
        for entry in self.of_mode(mode):
            if entry.x is not None and entry.measures:
                name = ", ".join(filter(None, (entry.row, entry.evaluation, entry.group)))
                lines.setdefault(name, []).append((entry.x, entry.measures[self.task.headline]))
        draw_lines(axes, lines, (self.experiment.x, self._axis()))


def grouped(pairs: Iterable[tuple[Key, Value]]) -> dict[Key, list[Value]]:
    """Return the values of each key, in their order."""
    groups: dict[Key, list[Value]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def shown(measure: Interval | None) -> str:
    """Format a measure, with its interval if it has one."""
    if measure is None:
        return "-"
    return f"{measure.value:.2f}" if measure.low == measure.high else str(measure)


def headline_of(paper: Mapping[str, float] | str | None, name: str) -> float | None:
    """Return the paper's figure of a measure, or `None`."""
    return paper.get(name) if isinstance(paper, Mapping) else None


def paper_cells(paper: Mapping[str, float] | str | None, measures: Mapping[str, str]) -> list[str]:
    """Return the paper's figures of measures as text. A remark stands in the first cell."""
    if not isinstance(paper, Mapping):
        return [paper or "", *[""] * (len(measures) - 1)]
    return [f"{paper[name]:.2f}" if name in paper else "-" for name in measures]


def paper_rows(
    task: Task, table: str | None, mode: str, found: set[tuple[str, str]]
) -> Iterator[tuple[str, Mapping[str, float] | str]]:
    """Yield the name and the figures of each row of the paper in a mode that is not among names and variants."""
    for row, variants in paper_table(table).get("rows", {}).items():
        for variant in variants:
            paper = task.paper_value(table, row, variant, mode)
            if paper is not None and (row, variant) not in found:
                yield ", ".join(filter(None, (row, variant, "the paper's"))), paper


def mean_details(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of details over the runs that have them."""
    values = grouped(item for run in runs for item in run.items())
    return {name: sum(each) / len(each) for name, each in values.items()}


def detail_table(columns: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Return a table of details by their heading. The longer side of the table is that of its rows."""
    if not columns:
        return []
    keys = list(dict.fromkeys(key for values in columns.values() for key in values))
    table = [["", *keys]]
    for name, values in columns.items():
        table.append([name, *(f"{values[key]:.3f}" if key in values else "-" for key in keys)])
    return [list(row) for row in zip(*table, strict=True)] if len(keys) >= len(table) - 1 else table


def _mean_curve(runs: Sequence[Sequence[tuple[int, float]]]) -> tuple[tuple[int, float], ...]:
    """Return the means over the runs at the steps that all of them have."""
    by_step = sorted(grouped(chain(*runs)).items())
    return tuple((step, sum(each) / len(each)) for step, each in by_step if len(each) == len(runs))


def _why_missing(cells: Sequence[Cell], done: Sequence[Cell], failed: Mapping[str, str]) -> str:
    """Return why runs of an entry are missing: the first message that failed, and the seeds if others are done."""
    left = [cell for cell in cells if cell not in done]
    if not left:
        return ""
    messages = [failed[cell.identity] for cell in left if cell.identity in failed]
    missing = first_line(messages[0], "failed") if messages else "not run"
    if done:
        missing += f" (seed{'s' * (len(left) > 1)} {', '.join(str(cell.seed) for cell in left)})"
    return missing
