"""Draws the main measure of the rows of an experiment, with intervals and beside the paper's figures, as an SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from logicity.experiments.results import Headline

#: The places of a line: where its name ends, where 0 and 1 of the measure are, and its height.
NAME, ZERO, ONE, LINE = 250, 262, 640, 17
#: The height of the head of a mode, which has its name and the axis.
HEAD = 44
#: A drawing has no mode with more lines: it would be longer than the table is useful.
LINES_MAX = 50


def draw(measure: str, modes: Mapping[str, Sequence[Headline]]) -> str:
    """Return the drawing in Markdown, with a part for each mode; an empty text if a mode has too many lines."""
    if any(len(lines) > LINES_MAX for lines in modes.values()):
        return ""
    parts, top = [], 0
    for mode, lines in modes.items():
        parts += _mode(measure, mode, lines, top)
        top += HEAD + LINE * len(lines) + 12
    title = f"The measure {measure} of each row, with its interval of 95 %"
    has_paper = any(line.paper is not None for lines in modes.values() for line in lines)
    legend = "A dot is the value here, a line its interval of 95 %" + (
        ", a bar the paper's value." if has_paper else "."
    )
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {ONE + 20} {top}" role="img"><title>{title}</title>'
    drawing = f'<div class="drawing chart">{svg}{"".join(parts)}</svg></div>'
    return f"{legend}\n\n```{{raw}} html\n{drawing}\n```\n"


def _mode(measure: str, mode: str, lines: Sequence[Headline], top: int) -> list[str]:
    bottom = top + HEAD + LINE * len(lines)
    parts = [f'<text x="0" y="{top + 20}">{escape(mode.capitalize())}: {escape(measure)}</text>']
    for tenth in range(0, 11, 2):
        x = _x(tenth / 10)
        parts.append(f'<path class="grid" d="M{x} {top + HEAD - 8} V{bottom}"/>')
        parts.append(f'<text class="quiet" x="{x}" y="{top + HEAD - 12}" text-anchor="middle">{tenth / 10:g}</text>')
    for number, line in enumerate(lines):
        y = top + HEAD + LINE * number + LINE // 2
        parts.append(f'<text class="quiet" x="{NAME}" y="{y + 4}" text-anchor="end">{escape(line.name)}</text>')
        parts.append(f'<path d="M{_x(line.measured.low)} {y} H{_x(line.measured.high)}"/>')
        if line.paper is not None:
            parts.append(f'<path class="paper" d="M{_x(line.paper)} {y - 6} v12"/>')
        parts.append(f'<circle class="dot" cx="{_x(line.measured.value)}" cy="{y}" r="4"/>')
    return parts


def _x(value: float) -> str:
    """Return the horizontal place of a value, from 0 to 1."""
    return f"{ZERO + (ONE - ZERO) * min(max(value, 0.0), 1.0):.1f}"
