"""The published results: the files `results/EXPERIMENT.json`. A row has its settings and the hash of its policy."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation import Interval
from ...learn.policies import load_policy
from ...learn.storage import policy_hash
from ...modes import ENVIRONMENTS
from ...tasks import task_hashes
from ..cells import Cell, benchmark_of, finished
from ..report import markdown_table, paper_table
from ..result_files import is_published, place_of, read_file, rehashed, row_key, updating
from .experiment import Experiment, name_of
from .report import MEASURES, clauses_of, paper_value, per_episode, pooled, violation_rates

__all__ = ["check_rows", "leaderboard", "read_results", "submit"]

#: The version of the format.
FORMAT = 3

#: The keys of a row. `command` trains and evaluates it again. `policy_sha256` is the hash of what `sha256_of` says.
KEYS = (
    *("learner", "variant", "paper", "mode", "evaluation", "seed", "config", "command", "note", "versions", "hashes"),
    *("sha256_of", "policy_sha256", "steps", "unit", "cpu_seconds", "best_after", "compliance", *MEASURES),
    *("violations", "episodes"),
)

#: The keys that identify a row.
_KEY = ("learner", "variant", "mode", "evaluation", "seed")


def read_results(path: str | os.PathLike[str], experiment: str | None = None) -> dict[str, Any]:
    """Read a file of results.

    Args:
        path: The file.
        experiment: The name of the experiment. If given, the file may be absent.

    Returns:
        `format`, `experiment`, `paper` (the name of the paper's table) and `rows`.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file does not have this format, or is that of another experiment.
    """
    results = read_file(path, FORMAT, KEYS, _KEY)
    if results is None:
        if experiment is None:
            raise FileNotFoundError(f"{path}: the file does not exist")
        return {"format": FORMAT, "experiment": experiment, "paper": None, "rows": []}
    for key in ("experiment", "paper"):
        if key not in results:
            raise ValueError(f"{path}: expected the key `{key}`")
    if experiment is not None and results["experiment"] != experiment:
        raise ValueError(f"{path}: expected results of `{experiment}`, not of `{results['experiment']}`")
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


def submit(
    experiment: Experiment, file: Path, cells: Sequence[Cell], root: Path, results: Path, *, only_hashes: bool = False
) -> Iterator[str]:
    """Evaluate the policies of finished cells again, and write a row for each evaluation.

    A row replaces that of the same learner, variant, mode, evaluation and seed, and keeps its note. Cells that tables
    omit have no row.

    Args:
        experiment: The experiment.
        file: The file of the experiment.
        cells: The cells. Those that are not finished are skipped.
        root: The folder of the experiment.
        results: The file of results.
        only_hashes: Whether to write only the hashes of rows that are published and have the same figures.

    Yields:
        A line for each evaluation.

    Raises:
        OSError: If a file cannot be read or written, or another process writes the file of results.
        ValueError: If a policy does not give the recorded measures, the file has results of another experiment, or the
            mode of a cell is not a built-in one.
    """
    shown = [cell for cell in cells if not cell.hidden]
    for cell in shown:
        if cell.mode not in ENVIRONMENTS:
            raise ValueError(f"{cell.name}: published results are of built-in modes, not of `{cell.mode}`")
    with updating(results, lambda: read_results(results, file.stem)) as document:
        rows = {row_key(row, _KEY): row for row in document["rows"]}
        for cell in shown:
            yield from _update(rows, experiment, file, cell, root, only_hashes)
        order = {
            "mode": list(experiment.modes),
            "learner": list(experiment.learners),
            "variant": list(experiment.variants),
            "evaluation": list(experiment.evaluations),
        }
        document |= {"paper": experiment.paper, "rows": sorted(rows.values(), key=lambda row: place_of(row, order))}
    yield f"{len(rows)} rows in {results}"


def _update(
    rows: dict[tuple[Any, ...], Mapping[str, Any]],
    experiment: Experiment,
    file: Path,
    cell: Cell,
    root: Path,
    only_hashes: bool,
) -> Iterator[str]:
    """Add the rows of a cell if it is finished, and yield a line for each evaluation."""
    measured = finished(cell, root)
    if measured is None:
        yield f"{cell.name}: not finished"
        return
    for name in cell.evaluations:
        names = {"learner": cell.row, "variant": cell.variant, "mode": cell.mode, "evaluation": name, "seed": cell.seed}
        old = rows.get(row_key(names, _KEY))
        if only_hashes:
            if old is None:
                yield f"{cell.name}, {name}: not published"
                continue
            saved = load_policy(cell.folder(root))
            if is_published(old, "policy_sha256", saved.path):
                hashed, sha256 = policy_hash(saved.policy)
                rows[row_key(names, _KEY)] = {**old, "sha256_of": hashed, "policy_sha256": sha256}
                yield f"{cell.name}, {name}: {hashed} {sha256[:12]}, from the published file"
                continue
        row = {
            "learner": cell.row,
            "variant": cell.variant,
            "paper": experiment.learners[cell.row].paper or cell.row,
            **_row(file, cell, root, measured, name),
        }
        if only_hashes:
            assert old is not None
            try:
                row = rehashed(old, row, "policy_sha256")
            except ValueError as error:
                raise ValueError(f"{cell.name}, {name}: {error}") from None
        row["note"] = (old or row)["note"]
        rows[row_key(row, _KEY)] = row
        yield f"{cell.name}, {name}: TSR {row['tsr']['value']:.2f}, as recorded"


def _row(file: Path, cell: Cell, root: Path, measured: Mapping[str, Any], evaluation: str) -> dict[str, Any]:
    """Evaluate the policy of a cell, and return its row."""
    folder = cell.folder(root)
    try:
        saved = load_policy(folder)
    except ValueError as error:
        raise ValueError(f"{cell.name}: {error}: delete `{folder}` and train the cell again") from None
    recorded = measured["evaluations"][evaluation]
    benchmark = benchmark_of(folder, cell.config, cell.evaluations[evaluation])
    again = benchmark.evaluate(saved.policy, name=cell.config.algorithm).to_dict()
    for name in MEASURES:
        if again[name]["value"] != recorded[name]["value"]:
            raise ValueError(
                f"{cell.name}, {evaluation}: the policy {saved.path} has {name} {again[name]['value']}, not the "
                f"recorded {recorded[name]['value']}: delete the folder of the cell and train it again"
            )
    result, (hashed, sha256) = measured["result"], policy_hash(saved.policy)
    values = per_episode(recorded)
    return {
        "mode": cell.mode,
        "evaluation": evaluation,
        "seed": cell.seed,
        "config": result["config"],
        "command": f"logicity experiment {name_of(file)} --only {cell.row},{cell.mode} --seeds {cell.seed}",
        "note": "",
        "versions": result["versions"],
        "hashes": result["hashes"],
        "sha256_of": hashed,
        "policy_sha256": sha256,
        "steps": result["steps"],
        "unit": result["unit"],
        "cpu_seconds": result["cpu_seconds"],
        "best_after": result["best"]["steps"],
        "compliance": again["compliance"],
        **{name: again[name] for name in MEASURES},
        "violations": violation_rates([recorded], clauses_of(cell.mode)),
        # What intervals over several seeds need: success, decision success and score of each episode.
        "episodes": {name: [round(float(value), 4) for value in values[name]] for name in MEASURES},
    }


def leaderboard(results: Mapping[str, Any], level: int = 2) -> str:
    """Return the results as Markdown: a table per mode, beside the figures of the paper, and notes.

    Args:
        results: The results.
        level: The level of the headings, 2 for `##`.
    """
    rows = results["rows"]
    if not rows:
        return f"The file `results/{results['experiment']}.json` has no row yet.\n"
    parts = []
    paper = paper_table(results["paper"])
    several = len({row["evaluation"] for row in rows}) > 1
    for mode in dict.fromkeys(row["mode"] for row in rows):
        groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
        for row in rows:
            if row["mode"] == mode:
                groups.setdefault((row["learner"], row["variant"], row["evaluation"]), []).append(row)
        shown = list(groups.items())
        if not several and all(not variant for _, variant, _ in groups):
            shown.sort(key=lambda item: -_mean(item[1], "tsr"))
        heads = ["learner", "TSR", "DSR", "Score", "paper: TSR", "seeds", "steps", "CPU min", "command"]
        lines = [heads]
        for (learner, variant, evaluation), group in shown:
            measures = _pooled(group)
            published = paper_value(results["paper"], group[0]["paper"], variant, mode)
            figure = f"{published['tsr']:.2f}" if isinstance(published, dict) else published or ""
            seeds = ", ".join(str(row["seed"]) for row in group)
            command = group[0]["command"].partition(" --seeds")[0] + f" --seeds {seeds.replace(' ', '')}"
            minutes = sum(row["cpu_seconds"] for row in group) / len(group) / 60
            name = ", ".join([f"`{learner}`", *([variant] if variant else []), *([evaluation] if several else [])])
            cells = [name, *(measures[each] for each in MEASURES), figure, seeds, f"{group[0]['steps']:,}"]
            lines.append([*cells, f"{minutes:.1f}", f"`{command}`"])
        found = {(group[0]["paper"], variant) for (_, variant, _), group in groups.items()}
        lines += _only_in_paper(results["paper"], mode, found)
        parts.append(f"{'#' * level} {mode.capitalize()}\n\n{markdown_table(lines)}")
    notes = sorted({f"- `{row['learner']}`, {row['mode']}: {row['note']}" for row in rows if row["note"]})
    versions = ", ".join(sorted({row["versions"]["logicity"] for row in rows}))
    # The evaluations of a cell share its training.
    seconds = {(row["learner"], row["variant"], row["mode"], row["seed"]): row["cpu_seconds"] for row in rows}
    sources = f"The paper's figures: {paper['source']}. {paper['note']} " if paper else ""
    hours = sum(seconds.values()) / 3600
    parts.append(f"{sources}Version {versions} of logicity; {hours:.2f} CPU hours in all.\n")
    return "\n".join([*parts, *(["\n".join(notes) + "\n"] if notes else [])])


def _only_in_paper(table: str | None, mode: str, found: Collection[tuple[str, str]]) -> Iterator[list[str]]:
    """Yield the cells of each row of the paper that is not among the names and variants of the published rows."""
    for learner, variants in paper_table(table).get("rows", {}).items():
        for variant in variants:
            value = paper_value(table, learner, variant, mode)
            if value is not None and (learner, variant) not in found:
                figures = [f"{value[name]:.2f}" for name in MEASURES] if isinstance(value, dict) else [value, "", ""]
                name = ", ".join([f"`{learner}`", *([variant] if variant else []), "the paper's figures"])
                yield [name, *figures, figures[0], "", "", "", ""]


def _pooled(group: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the measures over the seeds as text."""
    if len(group) == 1:
        return {name: str(Interval(**group[0][name])) for name in MEASURES}
    tables = [{name: np.array(row["episodes"][name], np.float64) for name in MEASURES} for row in group]
    return {name: str(each) for name, each in pooled(tables).items()}


def _mean(group: Sequence[Mapping[str, Any]], name: str) -> float:
    return sum(float(row[name]["value"]) for row in group) / len(group)
