"""Tables as text, Markdown and LaTeX, and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..evaluation import Interval
from ..files import reserved

__all__ = ["draw_bars", "draw_lines", "draw_panels", "escaped", "latex_table", "markdown_table"]


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
        written = {root / f"{name}.png": {"Software": None}, root / f"{name}.svg": {"Date": None}}
        for path, metadata in written.items():
            with reserved(path, by=None) as output:
                figure.savefig(output.temporary, format=path.suffix[1:], dpi=150, metadata=metadata)
                output.finish()
    return list(written)


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
        low, high = [each.low for each in values], [each.high for each in values]
        axes.fill_between(xs, low, high, color=line.get_color(), alpha=0.12)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    axes.set_ylim(-0.02, 1.02)
    if lines:
        axes.legend(fontsize=7)


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
