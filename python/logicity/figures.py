"""Figures in files: panels of matplotlib. The same content gives the same bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from .errors import extra
from .evaluation import Evaluation
from .files import reserved

__all__ = ["ENDINGS", "plot_returns", "write_panels"]

#: The endings of files that `write_panels` writes, with metadata that omits what changes from run to run.
ENDINGS: dict[str, dict[str, None]] = {".png": {"Software": None}, ".svg": {"Date": None}}


def write_panels(
    paths: Iterable[Path],
    titles: Sequence[str],
    draw: Callable[[Any, int], None],
    height: float = 4.2,
    *,
    by: str | None = None,
    overwrite: bool = False,
) -> None:
    """Draw a panel for each title in two columns, and write them to files, as `reserved` permits.

    Args:
        paths: The files, with an ending of `ENDINGS`.
        titles: The titles of the panels.
        draw: A function that draws a panel, given its axes and its number from 0.
        height: The height of a panel in inches.
        by: The command or function that writes, as for `reserved`.
        overwrite: Whether to replace files that `by` did not write, or that have changed since.

    Raises:
        FileExistsError: If a file must not be replaced.
        ImportError: If matplotlib is missing.
        OSError: If a file cannot be written.
    """
    with extra("learn"):
        import matplotlib
        from matplotlib.figure import Figure

    columns = min(len(titles), 2)
    rows = -(-len(titles) // columns)
    with matplotlib.rc_context({"svg.hashsalt": "logicity"}):
        figure = Figure(figsize=(7.2 * columns, height * rows), layout="constrained")
        for at, title in enumerate(titles):
            axes = figure.add_subplot(rows, columns, at + 1)
            axes.set_title(title, fontsize=10)
            draw(axes, at)
        for path in paths:
            with reserved(path, by=by, overwrite=overwrite) as output:
                figure.savefig(output.temporary, format=path.suffix[1:], dpi=150, metadata=ENDINGS[path.suffix])
                output.finish()


#: How an episode ended, with its color.
_ENDS = {"success": "#55a868", "rule violated": "#c44e52", "step limit": "#8c8c8c"}


def plot_returns(path: Path, results: Sequence[Evaluation], *, by: str | None = None, overwrite: bool = False) -> None:
    """Draw the return of each episode, colored by how it ended, and the mean as a line. A panel for each result.

    The exceptions are those of `write_panels`.
    """

    def draw(axes: Any, at: int) -> None:
        records = results[at].episodes
        ended = [
            "success" if record.success else "step limit" if record.truncated else "rule violated" for record in records
        ]
        for end, color in _ENDS.items():
            points = [(record.episode, record.total) for record, its in zip(records, ended, strict=True) if its == end]
            axes.plot(*zip(*points, strict=True) if points else ([], []), "o", color=color, markersize=4, label=end)
        mean = sum(record.total for record in records) / len(records)
        axes.axhline(mean, color="#4878a8", linewidth=1, linestyle="--", label=f"mean {mean:.2f}")
        axes.set_xlabel("episode")
        axes.set_ylabel("return")
        axes.legend(fontsize=7)

    titles = [f"{result.policy}: {Path(result.mode).stem}, {result.split}" for result in results]
    write_panels([path], titles, draw, by=by, overwrite=overwrite)
