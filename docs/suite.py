"""Draws the measurements of the suite, `benches/suite.json`, as an SVG and tables."""

from __future__ import annotations

import json
import math
from html import escape
from typing import Any

#: The name of a peer in the tables, and its letter in the drawing.
PEERS = {
    "engine": ("LogiCity", "L"),
    "query": ("`logicity query`*", "q"),
    "ascent": ("ascent", "a"),
    "differential": ("differential-dataflow", "d"),
    "souffle": ("Soufflé interpreted*", "i"),
    "souffle-compiled": ("Soufflé compiled*", "c"),
    "datatoad": ("datatoad*", "t"),
    "flowlog": ("FlowLog compiled*", "f"),
}
#: The places of a line: where its name ends, where the axis begins and ends, its height, and the height of the head.
NAME, LEFT, RIGHT, LINE, HEAD = 230, 250, 660, 24, 34


def page(text: str) -> str:
    """Return the drawing and the tables in Markdown."""
    measured = json.loads(text)
    medians: list[dict[str, Any]] = measured["medians"]
    by_case: dict[str, dict[str, dict[str, Any]]] = {}
    for entry in medians:
        by_case.setdefault(entry["title"], {})[entry["peer"]] = entry
    peers = [peer for peer in PEERS if any(peer in found for found in by_case.values())]
    return "\n".join(
        [
            f"Each letter is the CPU time of an engine as a multiple of LogiCity's: {legend(peers)}\n",
            f'```{{raw}} html\n<div class="drawing">{drawing(by_case, peers)}</div>\n```\n',
            times(by_case, peers),
            "",
            changes(by_case, peers, measured["changes"]),
        ]
    )


def drawing(by_case: dict[str, dict[str, dict[str, Any]]], peers: list[str]) -> str:
    """Return an SVG with a line for each program: the CPU time of each peer over LogiCity's, on a logarithmic axis."""
    ratios = [entry["cpu_ratio"] for found in by_case.values() for entry in found.values() if "cpu_ratio" in entry]
    low = min(math.floor(math.log10(min(ratios))), 0)
    high = max(math.ceil(math.log10(max(ratios))), 1)

    def x(ratio: float) -> float:
        return LEFT + (RIGHT - LEFT) * (math.log10(ratio) - low) / (high - low)

    bottom = HEAD + LINE * len(by_case)
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {RIGHT + 30} {bottom + 6}" role="img">']
    parts.append("<title>The CPU time of each engine on each program as a multiple of LogiCity's</title>")
    for power in range(low, high + 1):
        at = x(10.0**power)
        parts.append(f'<path class="grid" d="M{at:.1f} {HEAD - 6} V{bottom}"/>')
        parts.append(f'<text class="quiet" x="{at:.1f}" y="{HEAD - 12}" text-anchor="middle">{10.0**power:g}</text>')
    for row, (title, found) in enumerate(by_case.items()):
        y = HEAD + LINE * row + LINE // 2
        parts.append(f'<text class="quiet" x="{NAME}" y="{y + 4}" text-anchor="end">{escape(title)}</text>')
        parts.append(f'<path class="grid" d="M{LEFT} {y} H{RIGHT}"/>')
        for peer in peers:
            entry = found.get(peer, {})
            if peer == "query" or "cpu_ratio" not in entry:
                continue
            at = x(entry["cpu_ratio"])
            parts.append(f'<text x="{at:.1f}" y="{y + 5}" text-anchor="middle">{PEERS[peer][1]}</text>')
    parts.append("</svg>")
    return "".join(parts)


def legend(peers: list[str]) -> str:
    """Return which letter of the drawing is which engine."""
    return ", ".join(f"{PEERS[peer][1]} {PEERS[peer][0].rstrip('*')}" for peer in peers if peer != "query") + "."


def times(by_case: dict[str, dict[str, dict[str, Any]]], peers: list[str]) -> str:
    """Return a table of CPU seconds and peak memory."""
    lines = [
        f"| program | rows | {' | '.join(PEERS[peer][0] for peer in peers)} |",
        f"|---|---:|{'---:|' * len(peers)}",
    ]
    for title, found in by_case.items():
        rows = next((sum(entry["counts"]) for entry in found.values() if "counts" in entry), None)
        cells = [_cell(found.get(peer)) for peer in peers]
        lines.append(f"| {title} | {'' if rows is None else f'{rows:,}'} | {' | '.join(cells)} |")
    return "\n".join(lines)


def changes(by_case: dict[str, dict[str, dict[str, Any]]], peers: list[str], shares: list[float]) -> str:
    """Return a table of the CPU seconds of changes, and of the first result beside them."""
    updating = [peer for peer in peers if any(found.get(peer, {}).get("change_ms") for found in by_case.values())]
    heads = [f"{PEERS[peer][0]}: all | {' | '.join(f'{share:.2%}' for share in shares)}" for peer in updating]
    lines = [f"| program | {' | '.join(heads)} |", f"|---|{'---:|' * len(updating) * (1 + len(shares))}"]
    for title, found in by_case.items():
        cells = []
        for peer in updating:
            entry = found.get(peer, {})
            figures = [entry.get("cpu_ms"), *entry.get("change_ms", [])]
            figures += [None] * (1 + len(shares) - len(figures))
            cells += ["" if figure is None else _seconds(figure / 1000) for figure in figures]
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(entry: dict[str, Any] | None) -> str:
    if entry is None:
        return ""
    if "exceeded" in entry:
        return f"> {entry['exceeded']}"
    return f"{_seconds(entry['cpu_ms'] / 1000)}, {entry['peak_mib']:,.0f} MiB"


def _seconds(time: float) -> str:
    digits = 0 if time >= 100 else 1 if time >= 10 else 2 if time >= 1 else 3
    return f"{time:.{digits}f} s"
