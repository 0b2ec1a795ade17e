"""Draws the main measure of the rows of an experiment, with intervals and beside the paper's figures, as an SVG.

An experiment whose rows differ in a number, such as the noise of sensors, has lines over this number.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, NamedTuple

from logicity.experiments.results import Headline

#: The width of a character of a name, that of the scale from 0 to 1, and the height of a line.
CHARACTER, SCALE, LINE = 7.2, 360, 17
#: The height of the head of a mode, which has its name and the axis.
HEAD = 44
#: A drawing has no mode with more lines: it would be longer than the table is useful.
LINES_MAX = 50

#: The size of a panel with lines over a number, and the place of its axes: left, right, top and bottom.
WIDTH, HEIGHT = 220, 163
LEFT, RIGHT, TOP, BOTTOM = 28, 208, 28, 128
#: The width of a character on an axis, and the space between two numbers.
DIGIT, GAP = 6.0, 5.0
#: The marks of lines, which have different shapes for readers who do not see their colors.
MARKS = (
    "M-3 0a3 3 0 1 0 6 0a3 3 0 1 0 -6 0z",
    "M-2.7 -2.7h5.4v5.4h-5.4z",
    "M0 -3.6L3.4 2.6H-3.4z",
    "M0 -3.8L3.4 0L0 3.8L-3.4 0z",
    "M-2.6 -2.6L2.6 2.6M2.6 -2.6L-2.6 2.6",
    "M-3.4 0H3.4M0 -3.4V3.4",
)


@dataclass(frozen=True)
class Axis:
    """The number in the names of rows over which lines are drawn.

    The other words of a name are the learner, which comes first, and its circumstances. One of them has a panel for
    each of its values, and the other one a line.
    """

    #: A pattern whose first group is the number.
    number: str
    label: str
    panels: Literal["learners", "circumstances"]
    #: The name of the circumstances of rows that name none.
    plain: str = ""


#: The axes of the experiments that have lines.
AXES = {
    "noise": Axis(r"\bnoise ([\d.]+)", "noise of the sensors", "circumstances"),
    "communication": Axis(r"\bk (\d+)", "told facts in each step, k", "circumstances"),
    "transfer": Axis(r"\b(\d+) %", "share of the demonstrations, %", "learners"),
    "vap-continual": Axis(r"\b(\d+) %", "share of the pictures, %", "learners", plain="from easy"),
    "vap-steps": Axis(r"\b(\d+) %", "share of the pictures, %", "learners"),
}


def draw(measure: str, modes: Mapping[str, Sequence[Headline]], axis: Axis | None = None) -> str:
    """Return the drawing in Markdown, with a part for each mode.

    Without an axis, each row has a line, and the text is empty if a mode has too many.
    """
    has_paper = any(line.paper is not None for lines in modes.values() for line in lines)
    if axis is not None:
        legend = "Shades are intervals of 95 %" + (", bars the paper's values." if has_paper else ".")
        drawing = "".join(_lines(measure, mode, lines, axis) for mode, lines in modes.items())
        return f"{legend}\n\n```{{raw}} html\n{drawing}\n```\n"
    if any(len(lines) > LINES_MAX for lines in modes.values()):
        return ""
    zero = max(len(line.name) for lines in modes.values() for line in lines) * CHARACTER + 14
    parts, top = [], 0
    for mode, lines in modes.items():
        parts += _mode(measure, mode, lines, top, zero)
        top += HEAD + LINE * len(lines) + 12
    title = f"The measure {measure} of each row, with its interval of 95 %"
    legend = "A dot is the value here, a line its interval of 95 %" + (
        ", a bar the paper's value." if has_paper else "."
    )
    width = zero + SCALE + 12
    size = f'viewBox="0 0 {width:.0f} {top}" style="max-width: {1.15 * width:.0f}px"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">'
    drawing = f'<div class="drawing chart">{svg}<title>{title}</title>{"".join(parts)}</svg></div>'
    return f"{legend}\n\n```{{raw}} html\n{drawing}\n```\n"


def _mode(measure: str, mode: str, lines: Sequence[Headline], top: int, zero: float) -> list[str]:
    def x(value: float) -> str:
        return f"{zero + SCALE * min(max(value, 0.0), 1.0):.1f}"

    bottom = top + HEAD + LINE * len(lines)
    parts = [f'<text x="0" y="{top + 20}">{escape(mode.capitalize())}: {escape(measure)}</text>']
    for tenth in range(0, 11, 2):
        at = x(tenth / 10)
        parts.append(f'<path class="grid" d="M{at} {top + HEAD - 8} V{bottom}"/>')
        parts.append(f'<text class="quiet" x="{at}" y="{top + HEAD - 12}" text-anchor="middle">{tenth / 10:g}</text>')
    for number, line in enumerate(lines):
        y = top + HEAD + LINE * number + LINE // 2
        parts.append(
            f'<text class="quiet" x="{zero - 12:.1f}" y="{y + 4}" text-anchor="end">{escape(line.name)}</text>'
        )
        parts.append(f'<path d="M{x(line.measured.low)} {y} H{x(line.measured.high)}"/>')
        if line.paper is not None:
            parts.append(f'<path class="paper" d="M{x(line.paper)} {y - 6} v12"/>')
        title = f"<title>{escape(_figures(line))}</title>"
        parts.append(f'<circle class="dot" cx="{x(line.measured.value)}" cy="{y}" r="4">{title}</circle>')
    return parts


def _figures(line: Headline) -> str:
    """Return the name of a row with its value, its interval and the paper's value."""
    value, low, high = line.measured.value, line.measured.low, line.measured.high
    paper = "" if line.paper is None else f"; the paper's: {line.paper:.2f}"
    return f"{line.name}: {value:.2f} [{low:.2f}, {high:.2f}]{paper}"


class _Point(NamedTuple):
    """A row of a panel; its number is `None` if the row has no number, and holds at all of them."""

    line: str
    number: float | None
    row: Headline


def _lines(measure: str, mode: str, rows: Sequence[Headline], axis: Axis) -> str:
    """Return the panels of a mode as HTML."""
    panels = _panels(rows, axis)
    names = list(dict.fromkeys(point.line for points in panels.values() for point in points))
    numbers = sorted({point.number for points in panels.values() for point in points if point.number is not None})
    swatches = "".join(f"<span>{_swatch(at)}{escape(name)}</span>" for at, name in enumerate(names))
    title = f"{escape(mode.capitalize())}: {escape(measure)} by {escape(axis.label)}"
    drawn = "".join(_panel(measure, axis, name, points, names, numbers) for name, points in panels.items())
    return (
        f'<figure class="drawing chart lines"><figcaption><b>{title}</b> {swatches}</figcaption>'
        f'<div class="panels">{drawn}</div></figure>'
    )


def _panels(rows: Iterable[Headline], axis: Axis) -> dict[str, list[_Point]]:
    """Return the points of each panel.

    A row whose circumstances are the beginning of others, such as `range 12` of `range 12, distance`, belongs to these.
    """
    known: dict[str, list[tuple[str, float | None, Headline]]] = {}
    for row in rows:
        learner, _, rest = row.name.partition(", ")
        found = re.search(axis.number, rest)
        words = rest if found is None else rest[: found.start()] + rest[found.end() :]
        circumstances = ", ".join(filter(None, (word.strip() for word in words.split(",")))) or axis.plain
        known.setdefault(circumstances, []).append((learner, None if found is None else float(found[1]), row))
    panels: dict[str, list[_Point]] = {}
    for name, points in known.items():
        longer = [other for other in known if other.startswith(f"{name}, ")]
        for learner, number, row in points:
            for circumstances in longer or [name]:
                panel, line = (learner, circumstances) if axis.panels == "learners" else (circumstances, learner)
                panels.setdefault(panel, []).append(_Point(line, number, row))
    return panels


def _panel(
    measure: str, axis: Axis, name: str, points: Sequence[_Point], names: Sequence[str], numbers: Sequence[float]
) -> str:
    """Return a panel as SVG: one line with marks for each name."""

    def x(number: float) -> float:
        return LEFT + (RIGHT - LEFT) * (number - numbers[0]) / ((numbers[-1] - numbers[0]) or 1)

    def y(value: float) -> float:
        return BOTTOM - (BOTTOM - TOP) * min(max(value, 0.0), 1.0)

    parts = [f'<text x="{LEFT}" y="16">{escape(name)}</text>']
    for value in (0.0, 0.5, 1.0):
        parts.append(f'<path class="grid" d="M{LEFT} {y(value):.1f} H{RIGHT}"/>')
        parts.append(f'<text class="quiet" x="{LEFT - 6}" y="{y(value) + 4:.1f}" text-anchor="end">{value:g}</text>')
    # A number that would touch the one before has a tick only.
    free = float("-inf")
    for number in numbers:
        text, place = f"{number:g}", x(number)
        parts.append(f'<path class="grid" d="M{place:.1f} {BOTTOM} v4"/>')
        if place - len(text) * DIGIT / 2 >= free:
            parts.append(f'<text class="quiet" x="{place:.1f}" y="{BOTTOM + 16}" text-anchor="middle">{text}</text>')
            free = place + len(text) * DIGIT / 2 + GAP
    middle = (LEFT + RIGHT) / 2
    parts.append(f'<text class="quiet" x="{middle}" y="{BOTTOM + 29}" text-anchor="middle">{escape(axis.label)}</text>')
    said = []
    bands, curves = [], []
    for line in dict.fromkeys(point.line for point in points):
        series = names.index(line)
        own = [point for point in points if point.line == line]
        over = sorted((point.number, point.row) for point in own if point.number is not None)
        for row in (point.row for point in own if point.number is None):
            curves.append(f'<path class="level s{series}" d="M{LEFT} {y(row.measured.value):.1f} H{RIGHT}"/>')
            said.append(f"{line} {row.measured.value:.2f}")
        if not over:
            continue
        edge = [f"{x(number):.1f} {y(row.measured.high):.1f}" for number, row in over]
        edge += [f"{x(number):.1f} {y(row.measured.low):.1f}" for number, row in reversed(over)]
        bands.append(f'<path class="band s{series}" d="M{" L".join(edge)}z"/>')
        curve = " L".join(f"{x(number):.1f} {y(row.measured.value):.1f}" for number, row in over)
        curves.append(f'<path class="line s{series}" d="M{curve}"/>')
        for number, row in over:
            at = f"{x(number):.1f} {y(row.measured.value):.1f}"
            curves.append(
                f'<path class="mark s{series}" transform="translate({at})" d="{MARKS[series % len(MARKS)]}">'
                f"<title>{escape(_figures(row))}</title></path>"
            )
            if row.paper is not None:
                curves.append(f'<path class="paper s{series}" d="M{x(number) - 5:.1f} {y(row.paper):.1f} h10"/>')
        said.append(f"{line} {', '.join(f'{row.measured.value:.2f}' for _, row in over)}")
    all_numbers = ", ".join(f"{number:g}" for number in numbers)
    label = escape(f"{name}: {measure} by {axis.label} ({all_numbers}). {'; '.join(said)}", quote=True)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">'
        f"{''.join([*parts, *bands, *curves])}</svg>"
    )


def _swatch(series: int) -> str:
    """Return the mark of a line for the legend."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 12" aria-hidden="true">'
        f'<path class="line s{series}" d="M1 6H23"/>'
        f'<path class="mark s{series}" transform="translate(12 6)" d="{MARKS[series % len(MARKS)]}"/></svg>'
    )
