"""Reports of experiments: tables beside the paper's figures, intervals, violated clauses, CPU hours, and figures."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..evaluation import Interval, load_task
from ..files import reserved, write_json
from .cells import Cell, finished
from .experiment import Experiment

__all__ = [
    "Entry",
    "Report",
    "aligned",
    "escaped",
    "markdown_table",
    "paper_table",
    "paper_value",
    "save_figure",
    "write_tables",
]

#: The measures of the paper's tables.
MEASURES = ("tsr", "dsr", "score")
_HEADS = {"tsr": "TSR", "dsr": "DSR", "score": "Score"}

#: The number of samples of a bootstrap interval.
SAMPLES = 2000


@cache
def paper_table(name: str | None) -> dict[str, Any]:
    """Return the figures of a table of the paper: `source`, `note` and `rows`. Empty without such a table."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text).get(name, {})
    return table


def paper_value(table: str | None, row: str, variant: str, mode: str) -> dict[str, float] | str | None:
    """Return the paper's TSR, DSR and Score of a cell, a remark instead of them, or `None` if it has no such cell."""
    value = paper_table(table).get("rows", {}).get(row, {}).get(variant, {}).get(Path(mode).stem)
    return dict(zip(MEASURES, value, strict=True)) if isinstance(value, list) else value


@dataclass(frozen=True)
class Entry:
    """One cell of a table: the runs of a row in a mode, on one set of episodes.

    Attributes:
        row: The name of the row.
        mode: The mode.
        variant: The name of the variant, or an empty text.
        evaluation: The name of the evaluation.
        seeds: The seeds of the finished runs.
        measures: TSR, DSR and Score with their intervals; empty without a finished run.
        violations: By clause of the mode, the share of episodes that end because the policy violates the clause.
        cpu_hours: The CPU time of all runs.
        paper: The paper's figures, a remark, or `None`.
        missing: Why there is no result; empty if there is one.
        identities: The identities of the runs.
        curve: The validations: steps and the mean TSR over the seeds.
        group: The line of the figure to which the variant belongs.
        x: The place on that line.
    """

    row: str
    mode: str
    variant: str
    evaluation: str
    seeds: tuple[int, ...]
    measures: Mapping[str, Interval]
    violations: Mapping[str, float]
    cpu_hours: float
    paper: dict[str, float] | str | None
    missing: str
    identities: tuple[str, ...]
    curve: tuple[tuple[int, float], ...]
    group: str | None = None
    x: float | None = None

    @property
    def label(self) -> str:
        """The row with its variant."""
        return f"{self.row}, {self.variant}" if self.variant else self.row


class Report:
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
        """Read the results. Those of other settings, rules, episodes or versions have another identity."""
        self.experiment = experiment
        columns: dict[tuple[str, str, str], list[Cell]] = {}
        for cell in cells:
            if not cell.hidden:
                columns.setdefault((cell.row, cell.variant, cell.mode), []).append(cell)
        self.entries = [
            self._entry(evaluation, group, root, failed or {})
            for group in columns.values()
            for evaluation in experiment.evaluations
        ]
        found = [measured for cell in cells if (measured := finished(cell, root)) is not None]
        self.cpu_hours = sum(each["result"]["cpu_seconds"] for each in found) / 3600
        self.complete = all(not entry.missing for entry in self.entries)

    def _entry(self, evaluation: str, cells: Sequence[Cell], root: Path, failed: Mapping[str, str]) -> Entry:
        first = cells[0]
        found = [(cell, measured) for cell in cells if (measured := finished(cell, root)) is not None]
        results = [measured["evaluations"][evaluation] for _, measured in found]
        spec, variant = self.experiment.learners[first.row], self.experiment.variants[first.variant]
        done = {cell.identity for cell, _ in found}
        missing, left = "", [cell for cell in cells if cell.identity not in done]
        if left:
            messages = [failed[cell.identity] for cell in left if cell.identity in failed]
            missing = next(iter(messages[0].splitlines()), "failed") if messages else "not run"
            if found:
                missing += f" (seed{'s' * (len(left) > 1)} {', '.join(str(cell.seed) for cell in left)})"
        return Entry(
            row=first.row,
            mode=first.mode,
            variant=first.variant,
            evaluation=evaluation,
            seeds=tuple(cell.seed for cell, _ in found),
            measures=intervals(results) if results else {},
            violations=violation_rates(results, clauses_of(first.mode)) if results else {},
            cpu_hours=sum(each["result"]["cpu_seconds"] for _, each in found) / 3600,
            paper=paper_value(self.experiment.paper, spec.paper or first.row, first.variant, first.mode),
            missing=missing,
            identities=tuple(cell.identity for cell, _ in found),
            curve=_curve([each["result"]["validations"] for _, each in found]),
            group=variant.group,
            x=variant.x,
        )

    @property
    def modes(self) -> list[str]:
        """The modes with an entry."""
        return list(dict.fromkeys(entry.mode for entry in self.entries))

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
            lines = [["learner", *(_HEADS[name] for name in MEASURES), "paper: TSR", "DSR", "Score", "seeds", "CPU h"]]
            for name, entries in self._names():
                if mode in entries:
                    entry = entries[mode]
                    figures = [str(entry.measures[each]) if entry.measures else "-" for each in MEASURES]
                    seeds = ",".join(map(str, entry.seeds)) or entry.missing[:60]
                    lines.append([name, *figures, *_paper_cells(entry.paper), seeds, f"{entry.cpu_hours:.2f}"])
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
            "and episodes for several (bootstrap)."
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

    def to_dict(self) -> dict[str, Any]:
        """Return the entries for JSON."""
        return {
            "title": self.experiment.title,
            "paper": paper_table(self.experiment.paper).get("source"),
            "entries": [asdict(entry) for entry in self.entries],
            "cpu_hours": round(self.cpu_hours, 4),
            "notes": self.notes(),
        }

    def write(self, root: Path) -> list[Path]:
        """Write the tables and the figures to a folder.

        Raises:
            OSError: If a file cannot be written.
        """
        written = write_tables(root, self.markdown(), self.latex(), self.to_dict())
        if any(entry.measures for entry in self.entries):
            written += self._figures(root)
        return written

    def _figures(self, root: Path) -> list[Path]:
        import matplotlib

        # Figures are files: no display is needed.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        written = []
        drawings = {"bars": self._bars, "curves": self._curves}
        if any(entry.x is not None for entry in self.entries):
            drawings["lines"] = self._lines
        # The same results give the same bytes.
        with matplotlib.rc_context({"svg.hashsalt": "logicity"}):
            for name, draw in drawings.items():
                count = len(self.modes)
                figure = Figure(figsize=(6.4 * min(count, 2), 4.2 * ((count + 1) // 2)), layout="constrained")
                FigureCanvasAgg(figure)
                for at, mode in enumerate(self.modes):
                    axes = figure.add_subplot((count + 1) // 2, min(count, 2), at + 1)
                    axes.set_title(f"{self.experiment.title}: {Path(mode).stem}", fontsize=10)
                    draw(axes, mode)
                written += save_figure(figure, root, name)
        return written

    def _bars(self, axes: Any, mode: str) -> None:
        """Draw the TSR of each row with its interval, and the paper's as a diamond."""
        shown = [(name, entries[mode]) for name, entries in self._names() if mode in entries]
        for at, (_, entry) in enumerate(shown):
            if entry.measures:
                tsr = entry.measures["tsr"]
                reach = [[max(0.0, tsr.value - tsr.low)], [max(0.0, tsr.high - tsr.value)]]
                axes.barh(at, tsr.value, xerr=reach, color="#4878a8", error_kw={"linewidth": 1})
            if isinstance(entry.paper, dict):
                axes.plot(entry.paper["tsr"], at, "D", color="#c44e52", markersize=5)
        axes.plot([], [], "D", color="#c44e52", markersize=5, label="paper")
        axes.set_yticks(range(len(shown)), [name for name, _ in shown], fontsize=8)
        axes.invert_yaxis()
        axes.set_xlim(0, 1.02)
        axes.set_xlabel("TSR on test episodes" if len(self.experiment.evaluations) == 1 else "TSR")
        axes.legend(fontsize=8, loc="lower right")

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
        lines: dict[str, list[Entry]] = {}
        for entry in self.entries:
            if entry.mode == mode and entry.x is not None and entry.measures:
                lines.setdefault(f"{entry.row}, {entry.group}" if entry.group else entry.row, []).append(entry)
        for name, entries in lines.items():
            entries.sort(key=lambda entry: entry.x or 0.0)
            xs = [entry.x for entry in entries]
            tsr = [entry.measures["tsr"] for entry in entries]
            (line,) = axes.plot(xs, [each.value for each in tsr], marker="o", markersize=3, linewidth=1, label=name)
            axes.fill_between(
                xs, [each.low for each in tsr], [each.high for each in tsr], color=line.get_color(), alpha=0.12
            )
        axes.set_xlabel("demonstrations (%)")
        axes.set_ylabel("TSR on test episodes")
        axes.set_ylim(-0.02, 1.02)
        if lines:
            axes.legend(fontsize=7)


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
    the runs, and the intervals are percentiles of a bootstrap that draws runs and, independently, episodes.
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
        # The weight of a run or an episode is how often a sample draws it.
        of_runs = generator.multinomial(runs, np.full(runs, 1 / runs), SAMPLES) / runs
        of_episodes = generator.multinomial(episodes, np.full(episodes, 1 / episodes), SAMPLES) / episodes
        samples = np.einsum("sr,re,se->s", of_runs, values, of_episodes, optimize=True)
        low, high = np.percentile(samples, [2.5, 97.5])
        result[name] = Interval(float(values.mean()), float(low), float(high))
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


def write_tables(root: Path, markdown: str, latex: str, values: Mapping[str, Any]) -> list[Path]:
    """Write `table.md`, `table.tex` and `table.json` to a folder, and return their paths.

    Raises:
        OSError: If a file cannot be written.
    """
    texts = {root / "table.md": markdown, root / "table.tex": latex}
    for path, text in texts.items():
        with reserved(path, record=False) as output:
            Path(output.temporary).write_text(text, encoding="utf-8")
            output.finish()
    write_json(root / "table.json", values, overwrite=True)
    return [*texts, root / "table.json"]


def save_figure(figure: Any, root: Path, name: str) -> list[Path]:
    """Write a figure of matplotlib to a folder as PNG and SVG, without dates, and return the paths.

    Raises:
        OSError: If a file cannot be written.
    """
    written = []
    for ending, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        path = root / f"{name}.{ending}"
        with reserved(path, record=False) as output:
            figure.savefig(output.temporary, format=ending, dpi=150, metadata=metadata)
            output.finish()
        written.append(path)
    return written


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Return a table as text with aligned columns."""
    widths = [max(len(line[at]) for line in lines) for at in range(len(lines[0]))]
    rows = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join(row.rstrip() for row in rows)


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown. The first line is the head."""
    rows = ["| " + " | ".join(cell.strip().replace("|", "\\|") for cell in line) + " |" for line in lines]
    return "\n".join([rows[0], "|" + "---|" * len(lines[0]), *rows[1:]]) + "\n"


def escaped(text: str) -> str:
    """Escape text for LaTeX."""
    return "".join(f"\\{each}" if each in "&%$#_{}" else _LATEX.get(each, each) for each in text)


#: The commands of LaTeX for characters that a backslash does not escape.
_LATEX = {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}"}
