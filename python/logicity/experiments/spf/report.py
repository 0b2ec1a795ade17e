"""The report of an experiment of Safe Path Following: measures beside the paper's, and violated clauses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import _logicity
from ...evaluation import Interval
from ...tasks import load_task
from ..cells import Cell
from ..report import (
    CellEntry,
    CellReport,
    Runs,
    aligned,
    bootstrap_weights,
    draw_bars,
    draw_lines,
    draw_panels,
    escaped,
    markdown_table,
    paper_table,
)
from .experiment import Experiment

__all__ = ["Entry", "Report", "paper_value", "per_episode", "pooled", "violation_rates"]

#: The measures of the paper's tables.
MEASURES = ("tsr", "dsr", "score")
_HEADS = {"tsr": "TSR", "dsr": "DSR", "score": "Score"}


def paper_value(table: str | None, row: str, variant: str, mode: str) -> dict[str, float] | str | None:
    """Return the paper's TSR, DSR and Score of a cell, a remark instead of them, or `None` if it has no such cell."""
    value = paper_table(table).get("rows", {}).get(row, {}).get(variant, {}).get(Path(mode).stem)
    return dict(zip(MEASURES, value, strict=True)) if isinstance(value, list) else value


@dataclass(frozen=True, kw_only=True)
class Entry(CellEntry):
    """One cell of a table: the runs of a row in a mode, on one set of episodes.

    `measures` are TSR, DSR and Score.

    Attributes:
        evaluation: The name of the evaluation.
        violations: By clause of the mode, the share of episodes that end because the policy violates the clause.
        paper: The paper's figures, a remark, or `None`.
        curve: The validations: steps and the mean TSR over the seeds.
    """

    evaluation: str
    violations: Mapping[str, float]
    paper: dict[str, float] | str | None
    curve: tuple[tuple[int, float], ...]

    @property
    def label(self) -> str:
        """The row with its variant."""
        return f"{self.row}, {self.variant}" if self.variant else self.row


class Report(CellReport):
    """The results of the cells of an experiment.

    Args:
        experiment: The experiment.
        cells: The cells.
        root: The folder of the experiment.
        failed: The messages of the cells that failed, by identity.
    """

    def __init__(
        self, experiment: Experiment, cells: Sequence[Cell], root: Path, failed: Mapping[str, str] | None = None
    ) -> None:
        """Read the results."""
        self.experiment, self.title, self.paper = experiment, experiment.title, experiment.paper
        runs = Runs(cells, root)
        self.entries: list[Entry] = [
            self._entry(evaluation, group, failed or {})
            for group in runs.grouped("row", "variant", "mode")
            for evaluation in experiment.evaluations
        ]
        self.cpu_hours = runs.cpu_hours

    def _entry(self, evaluation: str, runs: Runs[Cell], failed: Mapping[str, str]) -> Entry:
        first = runs.cells[0]
        results = [measured["evaluations"][evaluation] for measured in runs.measured]
        spec, variant = self.experiment.learners[first.row], self.experiment.variants[first.variant]
        return Entry(
            **runs.fields(variant, failed),
            evaluation=evaluation,
            measures=intervals(results) if results else {},
            violations=violation_rates(results, clauses_of(first.mode)) if results else {},
            paper=paper_value(self.experiment.paper, spec.paper or first.row, first.variant, first.mode),
            curve=_curve([each["result"]["validations"] for each in runs.measured]),
        )

    @property
    def rows(self) -> dict[tuple[str, str], dict[str, Entry]]:
        """The entries by label and evaluation, then by mode."""
        rows: dict[tuple[str, str], dict[str, Entry]] = {}
        for entry in self.entries:
            rows.setdefault((entry.label, entry.evaluation), {})[entry.mode] = entry
        return rows

    def _names(self) -> Iterator[tuple[str, dict[str, Entry]]]:
        """Yield the name of each row of a table, and its entries by mode."""
        several = len(self.experiment.evaluations) > 1
        for (label, evaluation), entries in self.rows.items():
            yield f"{label}, {evaluation}" if several else label, entries

    def table(self) -> list[list[str]]:
        """Return the table as text: a head, then a row with its intervals and a row of the paper's figures if any."""
        head = ["learner"]
        for mode in self.modes:
            head += [f"{Path(mode).stem} {_HEADS[name]}" for name in MEASURES]
        lines = [head]
        for name, entries in self._names():
            lines.append([name, *self._line(entries)])
            if any(entry.paper is not None for entry in entries.values()):
                paper = [_paper_cells(entries[mode].paper if mode in entries else None) for mode in self.modes]
                lines.append(["  the paper's", *(cell for cells in paper for cell in cells)])
        return lines

    def _line(self, entries: Mapping[str, Entry]) -> Iterator[str]:
        for mode in self.modes:
            entry = entries.get(mode)
            for name in MEASURES:
                yield str(entry.measures[name]) if entry is not None and entry.measures else "-"

    def text(self) -> str:
        """Return everything for a terminal: one table per mode, the clauses that learners violate, and CPU hours."""
        parts = [self.experiment.title]
        for mode in self.modes:
            of_paper = ["paper: TSR", "DSR", "Score"] if self.experiment.paper else []
            lines = [["learner", *(_HEADS[name] for name in MEASURES), *of_paper, "seeds", "CPU h"]]
            for name, entries in self._names():
                if mode in entries:
                    entry = entries[mode]
                    figures = [str(entry.measures[each]) if entry.measures else "-" for each in MEASURES]
                    seeds = ",".join(map(str, entry.seeds)) or entry.missing[:60]
                    paper = _paper_cells(entry.paper) if of_paper else []
                    lines.append([name, *figures, *paper, seeds, f"{entry.cpu_hours:.2f}"])
            parts += [f"\n{Path(mode).stem}", aligned(lines)]
        violations = self._violation_lines()
        if len(violations) > 1:
            parts += ["\nshare of episodes that end with a violation, by clause", aligned(violations)]
        parts += ["", *self.notes()]
        return "\n".join(parts)

    def notes(self) -> list[str]:
        """Return sentences on intervals, missing cells, the paper and the CPU time."""
        table = paper_table(self.experiment.paper)
        notes = [
            "Intervals (95 %): over episodes for one seed (Wilson, or 1.96 standard errors for the score), over seeds "
            "and episodes for several (bootstrap; Wilson for rates of 0 or 1)."
        ]
        if table:
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        for entry in self.entries:
            if entry.missing:
                only = " The figures are the paper's." if not entry.seeds and entry.paper is not None else ""
                notes.append(f"{entry.label}, {Path(entry.mode).stem}: {entry.missing}.{only}")
        notes.append(f"CPU time: {self.cpu_hours:.2f} hours.")
        return list(dict.fromkeys(notes))

    def _violation_lines(self) -> list[list[str]]:
        clauses = sorted({clause for entry in self.entries for clause in entry.violations}, key=_by_name)
        lines = [["learner", "mode", *clauses]]
        for name, entries in self._names():
            for mode, entry in entries.items():
                if entry.measures:
                    shares = [entry.violations.get(clause) for clause in clauses]
                    rates = ["-" if share is None else f"{share:.2f}" for share in shares]
                    lines.append([name, Path(mode).stem, *rates])
        return lines if clauses else lines[:1]

    def markdown(self) -> str:
        """Return the report as Markdown."""
        parts = [f"# {self.experiment.title}\n", markdown_table(self.table())]
        violations = self._violation_lines()
        if len(violations) > 1:
            parts += ["## Violated clauses\n", "The share of episodes that end with a violation of the clause.\n"]
            parts.append(markdown_table(violations))
        parts += ["## Notes\n", *(f"- {note}" for note in self.notes())]
        return "\n".join(parts) + "\n"

    def latex(self) -> str:
        """Return the table as LaTeX, with the rules of the package booktabs."""
        groups = " & ".join(f"\\multicolumn{{3}}{{c}}{{{escaped(Path(mode).stem)}}}" for mode in self.modes)
        rules = "".join(f"\\cmidrule(lr){{{2 + 3 * at}-{4 + 3 * at}}}" for at in range(len(self.modes)))
        heads = " & ".join(["learner"] + [_HEADS[name] for _ in self.modes for name in MEASURES])
        lines = [f"% {self.experiment.title}", f"\\begin{{tabular}}{{l{'ccc' * len(self.modes)}}}", "\\toprule"]
        lines += [f" & {groups} \\\\", rules, f"{heads} \\\\", "\\midrule"]
        for row in self.table()[1:]:
            lines.append(" & ".join(escaped(cell.strip()) for cell in row) + " \\\\")
        return "\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n"

    def _figures(self, root: Path) -> list[Path]:
        drawings = {"bars": self._bars, "curves": self._curves}
        if any(entry.x is not None for entry in self.entries):
            drawings["lines"] = self._lines
        titles = {mode: f"{self.title}: {Path(mode).stem}" for mode in self.modes}
        columns = min(len(titles), 2)
        written = []
        for name, draw in drawings.items():
            written += draw_panels(root, name, titles, draw, columns=columns, size=(6.4, 4.2))
        return written

    def _bars(self, axes: Any, mode: str) -> None:
        """Draw the TSR of each row with its interval, and the paper's."""
        shown = [(name, entries[mode]) for name, entries in self._names() if mode in entries]
        bars = [
            (name, entry.measures.get("tsr"), entry.paper["tsr"] if isinstance(entry.paper, dict) else None)
            for name, entry in shown
        ]
        draw_bars(axes, bars, "TSR on test episodes" if len(self.experiment.evaluations) == 1 else "TSR")

    def _curves(self, axes: Any, mode: str) -> None:
        """Draw the TSR of the validations over the share of the training steps."""
        shown = [entry for entry in self.entries if entry.mode == mode and entry.curve]
        first = next(iter(self.experiment.evaluations))
        for entry in shown:
            if entry.evaluation == first:
                last = entry.curve[-1][0] or 1
                xs, ys = [steps / last for steps, _ in entry.curve], [tsr for _, tsr in entry.curve]
                axes.plot(xs, ys, marker="o", markersize=2, linewidth=1, label=entry.label)
        axes.set_xlabel("share of the training steps")
        axes.set_ylabel("TSR on validation episodes")
        axes.set_ylim(-0.02, 1.02)
        if shown:
            axes.legend(fontsize=7)

    def _lines(self, axes: Any, mode: str) -> None:
        """Draw the TSR over `x`, one line for each row and group."""
        lines: dict[str, list[tuple[float, Interval]]] = {}
        for entry in self.entries:
            if entry.mode == mode and entry.x is not None and entry.measures:
                name = f"{entry.row}, {entry.group}" if entry.group else entry.row
                lines.setdefault(name, []).append((entry.x, entry.measures["tsr"]))
        draw_lines(axes, lines, ("demonstrations (%)", "TSR on test episodes"))


def per_episode(evaluation: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return TSR, DSR and Score of each episode: 0 or 1, and the return minus the random policy's mean return."""
    records = sorted(evaluation["episodes"], key=lambda record: record["episode"])
    kept = [any(record["constrained"].values()) and not record["violations"] for record in records]
    returns = np.array([record["total"] for record in records]) - np.array(evaluation["random_returns"])
    return {
        "tsr": np.array([record["success"] for record in records], np.float64),
        "dsr": np.array(kept, np.float64),
        "score": returns,
    }


def intervals(evaluations: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
    """Return the measures of the runs with 95 % intervals.

    For one run, the intervals are those of the evaluation, over its episodes. For several, the values are means over
    the runs, and the intervals are percentiles of a bootstrap that draws runs and, independently, episodes. A rate of 0
    or 1, of which a bootstrap says nothing, has the Wilson interval over the episodes of one run.
    """
    if len(evaluations) == 1:
        return {name: Interval(**evaluations[0][name]) for name in MEASURES}
    return pooled([per_episode(each) for each in evaluations])


def pooled(tables: Sequence[Mapping[str, NDArray[np.float64]]]) -> dict[str, Interval]:
    """Return the measures of several runs with 95 % intervals, from the values of `per_episode` of each run."""
    generator = np.random.default_rng(0)
    result = {}
    for name in MEASURES:
        values = np.stack([table[name] for table in tables])
        runs, episodes = values.shape
        of_runs, of_episodes = bootstrap_weights(generator, runs), bootstrap_weights(generator, episodes)
        samples = np.einsum("sr,re,se->s", of_runs, values, of_episodes, optimize=True)
        low, high = np.percentile(samples, [2.5, 97.5])
        result[name] = Interval(float(values.mean()), float(low), float(high))
        if name != "score" and values.min() == values.max():
            # The runs share their episodes, so their number does not count.
            result[name] = Interval.of_share(int(values[0].sum()), episodes)
    return result


@cache
def clauses_of(mode: str) -> tuple[str, ...]:
    """Return the names of the clauses of a mode that actions can violate."""
    return tuple(each["clause"] for each in _logicity.describe(load_task(mode))["constraints"])


def violation_rates(evaluations: Sequence[Mapping[str, Any]], clauses: Iterable[str]) -> dict[str, float]:
    """Return, for each of the clauses, the share of the episodes of all runs whose last action violates it."""
    counts = dict.fromkeys(clauses, 0)
    total = 0
    for evaluation in evaluations:
        for record in evaluation["episodes"]:
            total += 1
            for clause in record["violations"]:
                counts[clause] += 1
    return {clause: counts[clause] / total for clause in sorted(counts, key=_by_name)}


def _by_name(clause: str) -> tuple[str, int, str]:
    """Order clauses by their letter and number: `S2` before `S10`."""
    letters = clause.rstrip("0123456789")
    return letters, int(clause[len(letters) :] or 0), clause


def _curve(runs: Sequence[Sequence[Mapping[str, Any]]]) -> tuple[tuple[int, float], ...]:
    """Return the mean TSR over the runs at the steps that all of them validate."""
    by_step: dict[int, list[float]] = {}
    for validations in runs:
        for point in validations:
            by_step.setdefault(point["steps"], []).append(point["tsr"]["value"])
    return tuple((step, sum(each) / len(each)) for step, each in sorted(by_step.items()) if len(each) == len(runs))


def _paper_cells(paper: dict[str, float] | str | None) -> list[str]:
    if paper is None:
        return ["", "", ""]
    return [paper, "", ""] if isinstance(paper, str) else [f"{paper[name]:.2f}" for name in MEASURES]
