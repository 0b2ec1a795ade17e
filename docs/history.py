"""Draws the history of benchmarks, the lines of `benches/history.jsonl`, as an SVG and a table."""

from __future__ import annotations

import json
from dataclasses import dataclass

#: The width and the height of the part of the drawing for one benchmark, and the number of parts side by side.
WIDTH, HEIGHT, COLUMNS = 180, 120, 4
#: The place of the curve in its part: left, right, top and bottom.
LEFT, RIGHT, TOP, BOTTOM = 12, 120, 34, 104


@dataclass(frozen=True)
class Entry:
    """The measurement of one commit."""

    commit: str
    date: str
    machine: str
    #: CPU time over that of the fixed peer, by benchmark.
    ratios: dict[str, float]


def entries(lines: str) -> list[Entry]:
    """Return the measurements in the order of the file."""
    return [Entry(**json.loads(line)) for line in lines.splitlines()]


def names(history: list[Entry]) -> list[str]:
    """Return the benchmarks in the order in which they first appear."""
    return list(dict.fromkeys(name for entry in history for name in entry.ratios))


def drawing(history: list[Entry]) -> str:
    """Return an SVG with one curve for each benchmark, from 0 to its largest ratio."""
    found = names(history)
    rows = -(-len(found) // COLUMNS)
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH * COLUMNS} {HEIGHT * rows}" role="img">']
    parts.append("<title>The ratio of each benchmark by commit</title>")
    step = (RIGHT - LEFT) / max(len(history) - 1, 1)
    for index, name in enumerate(found):
        row, column = divmod(index, COLUMNS)
        ratios = [(at, entry.ratios[name]) for at, entry in enumerate(history) if name in entry.ratios]
        largest = max(ratio for _, ratio in ratios)
        points = [(LEFT + step * at, BOTTOM - (BOTTOM - TOP) * ratio / largest) for at, ratio in ratios]
        parts.append(f'<g transform="translate({WIDTH * column} {HEIGHT * row})">')
        parts.append(f'<text x="{LEFT}" y="20">{name}</text>')
        parts.append(f'<path d="M{LEFT} {BOTTOM} H{RIGHT}" stroke-dasharray="2 3"/>')
        parts.append(f'<path d="M{" L".join(f"{x:.1f} {y:.1f}" for x, y in points)}"/>')
        parts.extend(f'<circle class="dot" cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>' for x, y in points)
        x, y = points[-1]
        parts.append(f'<text x="{x + 8:.1f}" y="{y + 4:.1f}" class="quiet">{ratios[-1][1]:g}</text></g>')
    parts.append("</svg>")
    return "".join(parts)


def table(history: list[Entry]) -> str:
    """Return a table in Markdown, the newest commit first."""
    found = names(history)
    lines = [f"| commit | date | {' | '.join(found)} | machine |", f"|---|---|{'---:|' * len(found)}---|"]
    for entry in reversed(history):
        cells = [f"{entry.ratios[name]:g}" if name in entry.ratios else "" for name in found]
        lines.append(f"| `{entry.commit}` | {entry.date} | {' | '.join(cells)} | {entry.machine} |")
    return "\n".join(lines)


def page(lines: str) -> str:
    """Return the drawing and the table in Markdown."""
    history = entries(lines)
    return f'```{{raw}} html\n<div class="drawing">{drawing(history)}</div>\n```\n\n{table(history)}\n'
