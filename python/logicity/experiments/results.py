"""The published results: the files `results/EXPERIMENT.json`, with one row of JSON per line.

A row has the measures of one evaluation of one run, with its settings and the hash of its model.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from ..evaluation import Interval
from ..files import file_hash, read_json, reserved
from .cells import finished
from .paper import paper_table
from .registry import Loaded, load_experiment
from .report import Figures, Line, detail_table, mean_details, measure_table, paper_rows
from .statistics import grouped
from .tables import markdown_table
from .task import Cell, Task

__all__ = ["Headline", "as_text", "check_rows", "compare", "leaderboard", "read_results", "submit"]

#: The version of the format.
FORMAT = 4

#: The keys of a row. `command` runs and measures it again. `sha256` is the hash of what `sha256_of` says. `samples` is
#: what the intervals need. `training` has the steps of a training, their unit, and after how many the best model came.
KEYS = (
    *("learner", "variant", "paper", "mode", "evaluation", "seed", "settings", "command", "note", "versions", "hashes"),
    *("sha256_of", "sha256", "cpu_seconds", "training", "measures", "details", "samples"),
)

#: The keys that identify a row.
KEY = ("mode", "learner", "variant", "evaluation", "seed")

#: What the hash of a row covers: the `weights` of a network, the text of `rules`, the `replies` of a language model or
#: solver, or the `file` of the model, which depends on its format and can have times. `logicity experiment --rehash`
#: replaces hashes of files.
HASHED = ("weights", "rules", "replies", "file")

#: The keys of a row that may differ when its model is trained again, besides that of the hash.
_CHANGING = ("command", "cpu_seconds", "note", "sha256_of", "sha256", "versions")

Row = Mapping[str, Any]


def read_results(path: str | os.PathLike[str], experiment: str | None = None) -> dict[str, Any]:
    """Return the `format`, the `experiment` and the `rows` of a file of results.

    If the name of the experiment is given, the file may be absent.

    Raises:
        ValueError: If the file does not have this format, or is that of another experiment.
    """
    file = Path(path)
    if experiment is not None and not file.exists():
        return {"format": FORMAT, "experiment": experiment, "rows": []}
    try:
        results = read_json(file)
    except ValueError as error:
        raise ValueError(f"{file}: not JSON: {error}") from None
    if not isinstance(results, dict) or results.get("format") != FORMAT or not isinstance(results.get("rows"), list):
        raise ValueError(f"{file}: expected results of the format {FORMAT}")
    if not isinstance(results.get("experiment"), str):
        raise ValueError(f"{file}: expected the key `experiment`")
    if experiment is not None and results["experiment"] != experiment:
        raise ValueError(f"{file}: expected results of `{experiment}`, not of `{results['experiment']}`")
    for at, row in enumerate(results["rows"]):
        if not isinstance(row, dict):
            raise ValueError(f"{file}: row {at} is not a mapping")
        if missing := [key for key in KEYS if key not in row]:
            raise ValueError(f"{file}: row {at} has no `{missing[0]}`")
        invalid = ["sha256_of"] * (row["sha256_of"] not in HASHED)
        invalid += [key for key in KEY if not isinstance(row[key], int if key == "seed" else str)]
        if invalid:
            raise ValueError(f"{file}: row {at} has an invalid `{invalid[0]}`")
    return results


def as_text(results: Mapping[str, Any]) -> str:
    """Return the text of a file of results: JSON with one line per row."""
    head = {key: value for key, value in results.items() if key != "rows"}
    lines = ",\n".join(json.dumps(row, allow_nan=False) for row in results["rows"])
    return f'{json.dumps(head)[:-1]}, "rows": [\n{lines}\n]}}\n'


def check_rows(results: Mapping[str, Any], loaded: Loaded | None = None) -> list[str]:
    """Check published rows against the experiment, today's rules and episodes, and their own samples.

    The experiment is by default the built-in one with the name.

    Returns:
        A line for each fault: a row that occurs twice or that the experiment does not have; other keys, rules, episodes
        or settings than today's; or measures that do not follow from the samples.
    """
    loaded = loaded or load_experiment(results["experiment"])
    keys = [tuple(row[key] for key in KEY) for row in results["rows"]]
    found = []
    for row, key in zip(results["rows"], keys, strict=True):
        faults = ["it occurs twice"] if keys.count(key) > 1 else []
        faults += _row_faults(row, loaded)
        place = ", ".join(filter(None, (row["learner"], row["evaluation"], row["variant"])))
        found += [f"{place}, {row['mode']}, seed {row['seed']}: {fault}" for fault in faults]
    return found


def _row_faults(row: Row, loaded: Loaded) -> Iterator[str]:
    experiment = loaded.experiment
    if row.keys() != set(KEYS):
        yield "other keys"
        return
    spec, variant = experiment.learners.get(row["learner"]), experiment.variants.get(row["variant"])
    if spec is None or variant is None or row["variant"] not in (spec.variants or experiment.variants):
        yield "no such learner or variant"
        return
    if row["mode"] not in ((variant.mode,) if variant.mode else spec.modes or experiment.modes):
        yield "no such mode"
    if row["paper"] != (spec.paper or row["learner"]):
        yield "another row of the paper"
    yield from loaded.task.row_faults(row, experiment)


def submit(
    loaded: Loaded, cells: Sequence[Cell], root: Path, results: Path, *, only_hashes: bool = False
) -> Iterator[str]:
    """Measure the models of finished cells again, and write a row for each evaluation.

    A row replaces that of the same learner, variant, mode, evaluation and seed, and keeps its note. Rows of other seeds
    with other settings or hashes of rules are removed. Cells that tables omit have no row.

    Unfinished cells are skipped. `only_hashes` writes only the hashes of published rows that have the same figures.

    Yields:
        A line for each evaluation.

    Raises:
        OSError: If a file cannot be read or written, or another process writes the file of results.
        ValueError: If a model does not give the recorded measures, the file has results of another experiment, or the
            mode of a cell is not a built-in one.
    """
    shown_cells = [cell for cell in cells if not cell.hidden]
    if own := next((cell for cell in shown_cells if Path(cell.mode).suffix), None):
        raise ValueError(f"{own.name}: published results are of built-in modes, not of `{own.mode}`")
    results.parent.mkdir(parents=True, exist_ok=True)
    # No other process can add rows meanwhile.
    with reserved(results, by=None) as output:
        document = read_results(results, loaded.file.stem)
        rows = {tuple(row[key] for key in KEY): row for row in document["rows"]}
        for cell in shown_cells:
            yield from _update(rows, loaded, cell, root, only_hashes)
        document["rows"] = sorted(rows.values(), key=lambda row: _place_of(row, loaded))
        Path(output.temporary).write_text(as_text(document), encoding="utf-8", newline="\n")
        output.finish()
    yield f"{len(rows)} rows in {results}"


def compare(loaded: Loaded, cells: Sequence[Cell], root: Path, results: Path) -> Iterator[tuple[bool, str]]:
    """Compare finished cells with the published rows of the same names, without measuring again.

    Cells that tables omit are skipped.

    Yields:
        For each evaluation, whether its model and its figures are the published ones, and a line.

    Raises:
        OSError: If a file cannot be read.
        ValueError: If the file has results of another experiment.
    """
    if not results.exists():
        raise FileNotFoundError(f"{results}: no such file")
    rows = {tuple(row[key] for key in KEY): row for row in read_results(results, loaded.file.stem)["rows"]}
    for cell in cells:
        if cell.hidden:
            continue
        if (measured := finished(cell, root)) is None:
            yield False, f"{cell.name}: not finished"
            continue
        for name, evaluation in measured["evaluations"].items():
            published = rows.get((cell.mode, cell.row, cell.variant, name, cell.seed))
            place = ", ".join(filter(None, (cell.name, name)))
            if published is None:
                yield False, f"{place}: not published"
                continue
            row = json.loads(json.dumps(_row(loaded, cell, root, measured, name, evaluation)))
            if published["sha256_of"] == "file":
                row["sha256"] = file_hash(loaded.task.model(cell.folder(root)))
            yield _compared(loaded, place, published, row)


def _compared(loaded: Loaded, place: str, published: Row, row: Row) -> tuple[bool, str]:
    """Return whether a row equals the published one, and a line that says what differs."""
    kind, same_model = published["sha256_of"], published["sha256"] == row["sha256"]
    different = _different(published, row)
    if same_model and not different:
        return True, f"{place}: equal, {kind} {row['sha256'][:12]}"
    made = (
        f"{kind} {each['sha256'][:12]} on {each['versions'].get('processor', 'an unnamed processor')}"
        for each in (row, published)
    )
    models = f"the same {kind}" if same_model else f"{next(made)}, published {next(made)}"
    if not different:
        return False, f"{place}: equal figures, {models}"
    headline = loaded.task.headline
    figures = [each["measures"][headline]["value"] for each in (row, published)]
    shown = f"{loaded.task.measures[headline]} {figures[0]:.3f}, published {figures[1]:.3f}"
    return False, f"{place}: other {', '.join(different)}: {shown}; {models}"


def _different(published: Row, row: Row) -> list[str]:
    """Return the keys in which rows differ, apart from those that may change when a model is trained again."""
    return [key for key in published if key not in _CHANGING and published[key] != row.get(key)]


def _place_of(row: Row, loaded: Loaded) -> tuple[Any, ...]:
    """Return the place of a row: those of its names in the experiment. Unknown names come last."""
    experiment = loaded.experiment
    known = (experiment.modes, experiment.learners, experiment.variants, loaded.task.evaluations(experiment))
    orders = zip(KEY, map(list, known), strict=False)
    return (*(names.index(row[key]) if row[key] in names else len(names) for key, names in orders), row["seed"])


def _update(
    rows: dict[tuple[Any, ...], Row], loaded: Loaded, cell: Cell, root: Path, only_hashes: bool
) -> Iterator[str]:
    measured, task = finished(cell, root), loaded.task
    if measured is None:
        yield f"{cell.name}: not finished"
        return
    keys = {name: (cell.mode, cell.row, cell.variant, name, cell.seed) for name in measured["evaluations"]}
    if only_hashes:
        model = task.model(cell.folder(root))
        for name, key in list(keys.items()):
            if key not in rows:
                yield f"{cell.name}, {name}: not published"
                del keys[name]
            elif rows[key]["sha256_of"] == "file" and rows[key]["sha256"] == file_hash(model):
                # Nothing needs to be measured again.
                hashed, sha256 = task.hashed(cell, root)
                rows[key] = {**rows[key], "sha256_of": hashed, "sha256": sha256}
                yield f"{cell.name}, {name}: {hashed} {sha256[:12]}, from the published file"
                del keys[name]
    if not keys:
        return
    try:
        again = task.measure_again(cell, root)
    except ValueError as error:
        raise ValueError(f"{cell.name}: {error}") from None
    for name, key in keys.items():
        row = _row(loaded, cell, root, measured, name, again[name])
        if only_hashes:
            row = _rehashed(f"{cell.name}, {name}: the published row", rows[key], row)
        row["note"] = rows.get(key, row)["note"]
        for other in [other for other in rows if other[:-1] == key[:-1]]:
            if _trained_as(rows[other]) != _trained_as(row):
                del rows[other]
        rows[key] = row
        figure = row["measures"][task.headline]["value"]
        yield f"{cell.name}, {name}: {task.measures[task.headline]} {figure:.2f}, as recorded"


def _trained_as(row: Row) -> Any:
    """Return the settings of a row and its hashes, without those that depend on the seed."""
    return [{**row[name], "seed": None, "start": None} for name in ("settings", "hashes")]


def _row(
    loaded: Loaded, cell: Cell, root: Path, measured: Mapping[str, Any], name: str, again: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the row of an evaluation of a cell. Raises `ValueError` if the one made again has other measures."""
    task, recorded, result = loaded.task, measured["evaluations"][name], measured["result"]
    measures = task.intervals([recorded])
    for measure, interval in task.intervals([again]).items():
        if interval != measures.get(measure):
            old = measures[measure].value if measure in measures else None
            raise ValueError(
                f"{cell.name}, {name}: the model {task.model(cell.folder(root))} has {task.measures[measure]} "
                f"{interval.value}, not the recorded {old}: delete the folder of the cell and run it again"
            )
    hashed, sha256 = task.hashed(cell, root)
    modes, variants = loaded.experiment.columns(cell.row)
    # A variant that sets a mode is in every column.
    column = modes[0] if loaded.experiment.variants[cell.variant].mode else cell.mode
    only = shlex.quote(",".join((cell.row, column, *([cell.variant] if len(variants) > 1 else []))))
    file, best = loaded.file, result.get("best", {}).get("steps")
    built_in = file == Path("configs") / "experiments" / f"{file.stem}.yaml"
    experiment = file.stem if built_in else shlex.quote(file.as_posix())
    return {
        "learner": cell.row,
        "variant": cell.variant,
        "paper": loaded.experiment.learners[cell.row].paper or cell.row,
        "mode": cell.mode,
        "evaluation": name,
        "seed": cell.seed,
        "settings": result["settings"] if "settings" in result else result["config"],
        "command": f"logicity experiment {experiment} --only {only} --seeds {cell.seed}",
        "note": "",
        "versions": result["versions"],
        "hashes": result["hashes"],
        "sha256_of": hashed,
        "sha256": sha256,
        "cpu_seconds": result["cpu_seconds"],
        "training": {} if best is None else {"steps": result["steps"], "unit": result["unit"], "best_after": best},
        "measures": {
            **{measure: vars(each) for measure, each in measures.items()},
            **{measure: recorded[measure] for measure in task.more_measures},
        },
        "details": task.details(measured, name),
        "samples": task.samples(recorded),
    }


def _rehashed(place: str, old: Row, new: Row) -> dict[str, Any]:
    """Return a published row with the hash of the model that was trained again. Its figures must be the same."""
    again = json.loads(json.dumps(new))
    if different := _different(old, again):
        raise ValueError(f"{place} differs in {', '.join(f'`{key}`' for key in different)}")
    if old["sha256_of"] == again["sha256_of"] and old["sha256"] != again["sha256"]:
        raise ValueError(f"{place} has the {old['sha256_of']} {old['sha256']}, not {again['sha256']}")
    return {**old, **{key: again[key] for key in ("versions", "sha256_of", "sha256")}}


def leaderboard(
    results: Mapping[str, Any], level: int = 2, loaded: Loaded | None = None, draw: Draw = lambda measure, modes: ""
) -> str:
    """Return the results as Markdown: a table per mode, beside the figures of the paper, and notes.

    Headings have a level, 2 for `##`. The experiment is by default the built-in one with the name. `draw` returns the
    beginning, a figure, from the heading of the main measure and its values by mode.
    """
    rows = results["rows"]
    if not rows:
        return f"The file `results/{results['experiment']}.json` has no row yet.\n"
    loaded = loaded or load_experiment(results["experiment"])
    task = loaded.task
    lines = {mode: _pooled(loaded, mode, own) for mode, own in grouped((row["mode"], row) for row in rows).items()}
    headlines = {mode: [_headline(task, line) for line in own] for mode, own in lines.items()}
    parts = [*filter(None, [draw(task.measures[task.headline], headlines)])]
    parts += (
        f"{'#' * level} {mode.capitalize()}\n\n{markdown_table(_mode_table(loaded, mode, own))}"
        for mode, own in lines.items()
    )
    for mode, own in grouped((row["mode"], row) for row in rows if row["details"]).items():
        columns = grouped((", ".join(filter(None, (row["learner"], row["variant"]))), row["details"]) for row in own)
        means = {name: mean_details(each) for name, each in columns.items()}
        details = detail_table({**means, **loaded.task.paper_details(loaded.experiment.paper, mode)[0]})
        title = f"{mode.capitalize()}: {loaded.task.details_title}"
        parts.append(f"{'#' * level} {title}\n\n{markdown_table(details)}")
    notes = sorted({f"- `{row['learner']}`, {row['mode']}: {row['note']}" for row in rows if row["note"]})
    pooled = grouped((tuple(row[key] for key in KEY if key != "seed"), row) for row in rows).values()
    evaluations = ([loaded.task.evaluation_of(row) for row in group] for group in pooled)
    remarks = dict.fromkeys(remark for each in evaluations for remark in loaded.task.remarks(each))
    notes += (f"- {remark}" for remark in remarks)
    return "\n".join([*parts, _sources(loaded, rows), *(["\n".join(notes) + "\n"] if notes else [])])


class Headline(NamedTuple):
    """The main measure of a line of a table: its name, its value with an interval, and the paper's value if known."""

    name: str
    measured: Interval
    paper: float | None


def _headline(task: Task, line: _Pooled) -> Headline:
    paper = line.paper.get(task.headline) if isinstance(line.paper, Mapping) else None
    return Headline(line.name.replace("`", ""), line.measures[task.headline], paper)


#: Draws the main measures of modes.
Draw: TypeAlias = Callable[[str, Mapping[str, Sequence[Headline]]], str]


class _Pooled(NamedTuple):
    """The rows of a line of a table: those with several seeds of a learner."""

    name: str
    key: tuple[str, str, str]
    rows: Sequence[Row]
    measures: Mapping[str, Interval]
    paper: Figures | None


def _pooled(loaded: Loaded, mode: str, rows: Sequence[Row]) -> list[_Pooled]:
    """Return the lines of the table of a mode. Lines without variants are sorted by the headline."""
    task = loaded.task
    groups = grouped(((row["learner"], row["variant"], row["evaluation"]), row) for row in rows)
    several = len({evaluation for _, _, evaluation in groups}) > 1
    lines = [
        _Pooled(
            ", ".join([f"`{key[0]}`", *filter(None, (key[1], key[2] if several else ""))]),
            key,
            group,
            task.intervals([task.evaluation_of(row) for row in group]),
            task.paper_value(loaded.experiment.paper, *loaded.experiment.of_paper(*key[:2]), mode),
        )
        for key, group in groups.items()
    ]
    if not several and not any(variant for _, variant, _ in groups):
        lines.sort(key=lambda line: -line.measures[task.headline].value)
    return lines


def _mode_table(loaded: Loaded, mode: str, pooled: Sequence[_Pooled]) -> list[list[str]]:
    """Return the table of a mode."""
    task = loaded.task
    trained = any(row["training"] for line in pooled for row in line.rows)
    lines: list[Line] = []
    for line in pooled:
        group = line.rows
        seeds = ", ".join(str(row["seed"]) for row in group)
        command = group[0]["command"].partition(" --seeds")[0] + f" --seeds {seeds.replace(' ', '')}"
        minutes = sum(row["cpu_seconds"] for row in group) / len(group) / 60
        steps = [f"{group[0]['training']['steps']:,}"] if trained else []
        lines.append((line.name, line.measures, line.paper, [seeds, *steps, f"{minutes:.1f}", f"`{command}`"]))
    found = {loaded.experiment.of_paper(*line.key[:2]) for line in pooled}
    others = paper_rows(task, loaded.experiment.paper, mode, found)
    return measure_table(task, ["seeds", *["steps"] * trained, "CPU min", "command"], lines, others)


def _sources(loaded: Loaded, rows: Sequence[Row]) -> str:
    paper = paper_table(loaded.experiment.paper)
    sources = [f"The paper's figures: {paper['source']}. {paper['note']}"] if paper else []
    details = {loaded.task.paper_details(loaded.experiment.paper, row["mode"])[1] for row in rows if row["details"]}
    sources += [f"The paper's figures of details: {source}" for source in sorted(details - {""})]
    versions = ", ".join(sorted({row["versions"]["logicity"] for row in rows}))
    # The evaluations of a cell share its training.
    seconds = {tuple(row[key] for key in KEY if key != "evaluation"): row["cpu_seconds"] for row in rows}
    hours = sum(seconds.values()) / 3600
    return " ".join([*sources, f"Version {versions} of logicity; {hours:.2f} CPU hours in all.\n"])
