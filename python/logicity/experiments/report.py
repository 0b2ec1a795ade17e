"""Parts that the reports of all experiments share: tables, figures, the figures of the paper, bootstrap samples."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from operator import attrgetter
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..evaluation import Interval
from ..files import reserved, write_json, write_text
from ..terminal import first_line
from .cells import Job, finished

__all__ = [
    "CellEntry",
    "CellReport",
    "Runs",
    "aligned",
    "bootstrap_weights",
    "draw_bars",
    "draw_lines",
    "draw_panels",
    "escaped",
    "latex_table",
    "markdown_table",
    "paper_table",
    "write_tables",
]

#: The number of samples of a bootstrap interval.
SAMPLES = 2000


@cache
def paper_table(name: str | None) -> dict[str, Any]:
    """Return the figures of a table of the paper: `source`, `note` and `rows`. Empty without such a table."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text).get(name, {})
    return table


@dataclass(frozen=True, kw_only=True)
class CellEntry:
    """The runs of a row and variant in a mode, with one kind of evaluation.

    Attributes:
        row: The name of the row.
        mode: The mode of the column.
        variant: The name of the variant, or an empty text.
        seeds: The seeds of the finished runs.
        measures: The measures with their intervals; empty without a finished run.
        cpu_hours: The CPU time of all runs.
        missing: Why there is no result; empty if there is one.
        identities: The identities of the runs.
        group: The line of the figure to which the variant belongs.
        x: The place on that line.
    """

    row: str
    mode: str
    variant: str
    seeds: tuple[int, ...]
    measures: Mapping[str, Interval]
    cpu_hours: float
    missing: str
    identities: tuple[str, ...]
    group: str | None = None
    x: float | None = None


C = TypeVar("C", bound=Job)


class _Variant(Protocol):
    """The part of a variant that figures need."""

    @property
    def group(self) -> str | None: ...
    @property
    def x(self) -> float | None: ...


class Runs(Generic[C]):
    """The cells of an experiment that belong together, and what was measured in those that are finished.

    Args:
        cells: The cells.
        root: The folder of the experiment.

    Attributes:
        cells: The cells.
        measured: For each finished cell, the content of `measured.json`.
    """

    def __init__(self, cells: Sequence[C], root: Path) -> None:
        """Read the results. Those of other settings, rules, episodes or versions have another identity."""
        self._root = root
        self.cells = cells
        found = [(cell, measured) for cell in cells if (measured := finished(cell, root)) is not None]
        self._finished = [cell for cell, _ in found]
        self.measured = [measured for _, measured in found]

    @property
    def cpu_hours(self) -> float:
        """The CPU time of the finished cells."""
        return float(sum(each["result"]["cpu_seconds"] for each in self.measured)) / 3600

    def grouped(self, *names: str) -> list[Runs[C]]:
        """Return the runs that tables show, by their values of attributes such as `row` and `mode`."""
        groups: dict[Any, list[C]] = {}
        for cell in self.cells:
            if not cell.hidden:
                groups.setdefault(attrgetter(*names)(cell), []).append(cell)
        return [Runs(group, self._root) for group in groups.values()]

    def fields(self, variant: _Variant, failed: Mapping[str, str]) -> dict[str, Any]:
        """Return the fields of the entry of a row, variant and mode, except its measures.

        Args:
            variant: The variant.
            failed: The messages of the cells that failed, by identity.
        """
        first = self.cells[0]
        identities = tuple(cell.identity for cell in self._finished)
        return {
            "row": first.row,
            "mode": first.mode,
            "variant": first.variant,
            "seeds": tuple(cell.seed for cell in self._finished),
            "cpu_hours": self.cpu_hours,
            "missing": _why_missing(self.cells, identities, failed),
            "identities": identities,
            "group": variant.group,
            "x": variant.x,
        }


class CellReport(ABC):
    """The results of the cells of an experiment.

    Attributes:
        title: The title of the experiment.
        paper: The name of the paper's table.
        entries: The entries, in the order of the experiment.
        cpu_hours: The CPU time of all runs.
    """

    title: str
    paper: str | None
    entries: Sequence[CellEntry]
    cpu_hours: float

    @property
    def complete(self) -> bool:
        """Whether all runs are finished."""
        return all(not entry.missing for entry in self.entries)

    @property
    def modes(self) -> list[str]:
        """The modes with an entry."""
        return list(dict.fromkeys(entry.mode for entry in self.entries))

    @abstractmethod
    def notes(self) -> list[str]:
        """Return sentences on intervals, missing cells, the paper and the CPU time."""

    @abstractmethod
    def markdown(self) -> str:
        """Return the report as Markdown."""

    @abstractmethod
    def latex(self) -> str:
        """Return the tables as LaTeX, with the rules of the package booktabs."""

    @abstractmethod
    def _figures(self, root: Path) -> list[Path]:
        """Write the figures to a folder, and return their paths."""

    def to_dict(self) -> dict[str, Any]:
        """Return the entries for JSON."""
        return {
            "title": self.title,
            "paper": paper_table(self.paper).get("source"),
            "entries": [asdict(entry) for entry in self.entries],
            "cpu_hours": round(self.cpu_hours, 4),
            "notes": self.notes(),
        }

    def write(self, root: Path) -> list[Path]:
        """Write the tables and the figures to a folder, and return their paths.

        Raises:
            OSError: If a file cannot be written.
        """
        written = write_tables(root, self.markdown(), self.latex(), self.to_dict())
        if any(entry.measures for entry in self.entries):
            written += self._figures(root)
        return written


def _why_missing(cells: Sequence[Job], done: Iterable[str], failed: Mapping[str, str]) -> str:
    """Return why runs are missing: the first message of those that failed, and the seeds if others are finished.

    Args:
        cells: The cells of an entry.
        done: The identities of the finished ones.
        failed: The messages of the cells that failed, by identity.
    """
    finished = set(done)
    left = [cell for cell in cells if cell.identity not in finished]
    if not left:
        return ""
    messages = [failed[cell.identity] for cell in left if cell.identity in failed]
    missing = first_line(messages[0], "failed") if messages else "not run"
    if len(left) < len(cells):
        missing += f" (seed{'s' * (len(left) > 1)} {', '.join(str(cell.seed) for cell in left)})"
    return missing


def bootstrap_weights(generator: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return bootstrap weights, float64 (`SAMPLES`, count). Each row sums to 1."""
    drawn = generator.multinomial(count, np.full(count, 1 / count), SAMPLES)
    weights: NDArray[np.float64] = drawn / count
    return weights


def write_tables(root: Path, markdown: str, latex: str, values: Mapping[str, Any]) -> list[Path]:
    """Write `table.md`, `table.tex` and `table.json` to a folder, and return their paths.

    Raises:
        OSError: If a file cannot be written.
    """
    texts = {root / "table.md": markdown, root / "table.tex": latex}
    for path, text in texts.items():
        write_text(path, text)
    write_json(root / "table.json", values)
    return [*texts, root / "table.json"]


def _save_figure(figure: Any, root: Path, name: str) -> list[Path]:
    """Write a figure of matplotlib to a folder as PNG and SVG, without dates, and return the paths.

    Raises:
        OSError: If a file cannot be written.
    """
    written = []
    for ending, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        path = root / f"{name}.{ending}"
        with reserved(path, by=None) as output:
            figure.savefig(output.temporary, format=ending, dpi=150, metadata=metadata)
            output.finish()
        written.append(path)
    return written


def draw_panels(
    root: Path,
    name: str,
    titles: Mapping[str, str],
    draw: Callable[[Any, str], None],
    *,
    columns: int,
    size: tuple[float, float],
) -> list[Path]:
    """Draw a figure of several panels with matplotlib, and write it as PNG and SVG.

    Args:
        root: The folder.
        name: The name of the files, without ending.
        titles: The titles of the panels by key.
        draw: Draws the panel of a key on its axes.
        columns: The number of panels side by side.
        size: The width and height of a panel, in inches.

    Returns:
        The paths of the files. The same results give the same bytes.

    Raises:
        OSError: If a file cannot be written.
    """
    import matplotlib
    from matplotlib.figure import Figure

    rows = -(-len(titles) // columns)
    with matplotlib.rc_context({"svg.hashsalt": "logicity"}):
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        for at, (key, title) in enumerate(titles.items(), 1):
            axes = figure.add_subplot(rows, columns, at)
            axes.set_title(title, fontsize=10)
            draw(axes, key)
        return _save_figure(figure, root, name)


def draw_bars(axes: Any, bars: Sequence[tuple[str, Interval | None, float | None]], label: str) -> None:
    """Draw a bar with its interval for each name, and the paper's figure as a diamond. `label` is that of the axis."""
    for at, (_, value, paper) in enumerate(bars):
        if value is not None:
            reach = [[max(0.0, value.value - value.low)], [max(0.0, value.high - value.value)]]
            axes.barh(at, value.value, xerr=reach, color="#4878a8", error_kw={"linewidth": 1})
        if paper is not None:
            axes.plot(paper, at, "D", color="#c44e52", markersize=5)
    axes.set_yticks(range(len(bars)), [name for name, *_ in bars], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.02)
    axes.set_xlabel(label)
    if any(paper is not None for _, _, paper in bars):
        axes.plot([], [], "D", color="#c44e52", markersize=5, label="paper")
        axes.legend(fontsize=8, loc="lower right")


def draw_lines(axes: Any, lines: Mapping[str, Sequence[tuple[float, Interval]]], labels: tuple[str, str]) -> None:
    """Draw a line through the points of each name, with a band for the intervals. `labels` are those of the axes."""
    for name, points in lines.items():
        xs, values = zip(*sorted(points, key=lambda point: point[0]), strict=True)
        (line,) = axes.plot(xs, [each.value for each in values], marker="o", markersize=3, linewidth=1, label=name)
        axes.fill_between(
            xs, [each.low for each in values], [each.high for each in values], color=line.get_color(), alpha=0.12
        )
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_ylim(-0.02, 1.02)
    if lines:
        axes.legend(fontsize=7)


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Return a table as text with aligned columns."""
    widths = [max(len(line[at]) for line in lines) for at in range(len(lines[0]))]
    rows = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
    return "\n".join(row.rstrip() for row in rows)


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown. The first line is the head."""
    rows = ["| " + " | ".join(cell.strip().replace("|", "\\|") for cell in line) + " |" for line in lines]
    return "\n".join([rows[0], "|" + "---|" * len(lines[0]), *rows[1:]]) + "\n"


def latex_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table as LaTeX. The first line is the head."""
    head, *rows = [" & ".join(escaped(cell.strip()) for cell in line) + " \\\\" for line in lines]
    begin = f"\\begin{{tabular}}{{l{'c' * (len(lines[0]) - 1)}}}"
    return [begin, "\\toprule", head, "\\midrule", *rows, "\\bottomrule", "\\end{tabular}"]


def escaped(text: str) -> str:
    """Escape text for LaTeX."""
    return "".join(f"\\{each}" if each in "&%$#_{}" else _LATEX.get(each, each) for each in text)


#: The commands of LaTeX for characters that a backslash does not escape.
_LATEX = {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}"}
