"""The published results: rows of `results/spf.json`, each with the settings and the hash of its policy."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..evaluation import Benchmark, task_hashes
from ..files import write_json
from .cells import TEST, Cell, finished
from .experiment import Experiment
from .registry import load_policy
from .report import MEASURES, clauses_of, paper_table, paper_value, per_episode, pooled, violation_rates

__all__ = ["check_rows", "leaderboard", "read_results", "submit"]

#: The version of the format.
FORMAT = 1

#: The keys of a row. `command` trains and evaluates it again.
KEYS = (
    *(
        "learner",
        "paper",
        "mode",
        "seed",
        "config",
        "command",
        "note",
        "versions",
        "hashes",
        "policy_sha256",
        "steps",
        "unit",
    ),
    *("cpu_seconds", "best_after", "compliance", *MEASURES, "violations", "episodes"),
)


def read_results(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a file of results.

    Returns:
        `format` and `rows`; a file that does not exist has no rows.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not such a file.
    """
    file = Path(path)
    if not file.exists():
        return {"format": FORMAT, "rows": []}
    try:
        results = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file}: not JSON: {error}") from None
    if not isinstance(results, dict) or results.get("format") != FORMAT or not isinstance(results.get("rows"), list):
        raise ValueError(f"{file}: expected results of the format {FORMAT}")
    for at, row in enumerate(results["rows"]):
        missing = [key for key in KEYS if key not in row]
        if missing:
            raise ValueError(f"{file}: row {at} has no `{missing[0]}`")
    return results


def check_rows(results: Mapping[str, Any]) -> list[str]:
    """Return the rows whose rules or episodes are not those of this version, as lines of text."""
    today: dict[str, Any] = {}
    wrong = []
    for row in results["rows"]:
        mode = row["mode"]
        today.setdefault(mode, task_hashes(mode))
        different = [name for name, value in today[mode].items() if row["hashes"].get(name) != value]
        if different:
            wrong.append(f"{row['learner']} in {mode}, seed {row['seed']}: other {', '.join(different)}")
    return wrong


def submit(experiment: Experiment, file: Path, cells: Sequence[Cell], root: Path, results: Path) -> Iterator[str]:
    """Evaluate the policies of finished cells again, and write a row for each.

    A row replaces that of the same learner, mode and seed.

    Args:
        experiment: The experiment.
        file: The file of the experiment.
        cells: The cells. Those that are not finished are skipped.
        root: The folder of the experiment.
        results: The file of results.

    Yields:
        A line for each cell.

    Raises:
        OSError: If a file cannot be read or written.
        ValueError: If a policy does not give the recorded measures, or a cell is not one of the main table.
    """
    document = read_results(results)
    rows = {(row["learner"], row["mode"], row["seed"]): row for row in document["rows"]}
    for cell in cells:
        measured = finished(cell, root)
        if measured is None:
            yield f"{cell.name}: not finished"
            continue
        paper = experiment.learners[cell.row].paper or cell.row
        row = {"learner": cell.row, "paper": paper, **_row(file, cell, root, measured)}
        rows[cell.row, cell.mode, cell.seed] = row
        yield f"{cell.name}: TSR {row['tsr']['value']:.2f}, as recorded"
    ordered = sorted(rows.values(), key=lambda row: (row["mode"], row["learner"], row["seed"]))
    results.parent.mkdir(parents=True, exist_ok=True)
    write_json(results, {"format": FORMAT, "rows": ordered}, overwrite=True)
    yield f"{len(ordered)} rows in {results}"


def _row(file: Path, cell: Cell, root: Path, measured: Mapping[str, Any]) -> dict[str, Any]:
    """Evaluate the policy of a cell, and return its row."""
    recorded = measured["evaluations"].get("test")
    if recorded is None or cell.evaluations["test"] != TEST or cell.variant or cell.start is not None:
        raise ValueError(f"{cell.name} has no evaluation on the recorded test episodes alone, as the results need it")
    saved = load_policy(cell.folder(root))
    benchmark = Benchmark(cell.mode, "test", observation=cell.config.observation)
    again = benchmark.evaluate(saved.policy, name=cell.config.algorithm).to_dict()
    for name in MEASURES:
        if again[name] != recorded[name]:
            raise ValueError(
                f"{cell.name}: the policy {saved.path} has {name} {again[name]['value']}, not the recorded "
                f"{recorded[name]['value']}"
            )
    result = measured["result"]
    values = per_episode(recorded)
    return {
        "mode": cell.mode,
        "seed": cell.seed,
        "config": result["config"],
        "command": f"logicity experiment {file.stem} --only {cell.row},{cell.mode} --seeds {cell.seed}",
        "note": "",
        "versions": result["versions"],
        "hashes": result["hashes"],
        "policy_sha256": hashlib.sha256(saved.path.read_bytes()).hexdigest(),
        "steps": result["steps"],
        "unit": result["unit"],
        "cpu_seconds": result["cpu_seconds"],
        "best_after": result["best"]["steps"],
        "compliance": recorded["compliance"],
        **{name: recorded[name] for name in MEASURES},
        "violations": violation_rates([recorded], clauses_of(cell.mode)),
        # What intervals over several seeds need: success, decision success and score of each episode.
        "episodes": {name: [round(float(value), 4) for value in values[name]] for name in MEASURES},
    }


def leaderboard(results: Mapping[str, Any]) -> str:
    """Return the leaderboard as Markdown: a table per mode, beside the figures of the paper, and notes."""
    rows = results["rows"]
    if not rows:
        return "The file `results/spf.json` has no row yet.\n"
    parts = []
    paper = paper_table("spf")
    for mode in dict.fromkeys(sorted((row["mode"] for row in rows), key=_mode_order)):
        groups: dict[str, list[Mapping[str, Any]]] = {}
        for row in rows:
            if row["mode"] == mode:
                groups.setdefault(row["learner"], []).append(row)
        best = sorted(groups.items(), key=lambda item: -_mean(item[1], "tsr"))
        lines = ["| learner | TSR | DSR | Score | paper: TSR | seeds | steps | CPU min | command |", "|" + "---|" * 9]
        for learner, group in best:
            measures = _pooled(group)
            published = paper_value("spf", group[0]["paper"], "", mode)
            figure = f"{published['tsr']:.2f}" if isinstance(published, dict) else published or ""
            seeds = ", ".join(str(row["seed"]) for row in group)
            command = group[0]["command"].partition(" --seeds")[0] + f" --seeds {seeds.replace(' ', '')}"
            minutes = sum(row["cpu_seconds"] for row in group) / len(group) / 60
            cells = [f"`{learner}`", *(measures[name] for name in MEASURES), figure, seeds, f"{group[0]['steps']:,}"]
            lines.append("| " + " | ".join([*cells, f"{minutes:.1f}", f"`{command}`"]) + " |")
        parts.append(f"## {mode.capitalize()}\n\n" + "\n".join(lines) + "\n")
    notes = sorted({f"- `{row['learner']}`, {row['mode']}: {row['note']}" for row in rows if row["note"]})
    versions = ", ".join(sorted({row["versions"]["logicity"] for row in rows}))
    hours = sum(row["cpu_seconds"] for row in rows) / 3600
    parts.append(
        f"The paper's figures: {paper['source']}. {paper['note']} Version {versions} of logicity; {hours:.2f} CPU "
        "hours in all.\n"
    )
    return "\n".join([*parts, *(["\n".join(notes) + "\n"] if notes else [])])


def _pooled(group: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the measures over the seeds as text."""
    if len(group) == 1:
        return {name: _shown(group[0][name]) for name in MEASURES}
    tables = [{name: np.array(row["episodes"][name], np.float64) for name in MEASURES} for row in group]
    return {name: str(each) for name, each in pooled(tables).items()}


def _shown(interval: Mapping[str, float]) -> str:
    return f"{interval['value']:.2f} [{interval['low']:.2f}, {interval['high']:.2f}]"


def _mean(group: Sequence[Mapping[str, Any]], name: str) -> float:
    return sum(float(row[name]["value"]) for row in group) / len(group)


def _mode_order(mode: str) -> int:
    modes = ("easy", "medium", "hard", "expert")
    return modes.index(mode) if mode in modes else len(modes)
