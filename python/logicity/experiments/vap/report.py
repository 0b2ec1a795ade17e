"""Reports and published results of experiments of Visual Action Prediction: tables beside the paper's, and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...city import ACTIONS
from ...evaluation import Interval
from ...files import read_tensors
from ...learn.storage import weights_hash
from ..cells import finished
from ..report import (
    CellEntry,
    CellReport,
    Runs,
    aligned,
    bootstrap_weights,
    draw_bars,
    draw_lines,
    draw_panels,
    latex_table,
    markdown_table,
    paper_table,
)
from ..result_files import is_published, place_of, read_file, rehashed, row_key, updating
from ..spf.experiment import name_of
from .experiment import VapCell, VapExperiment, measure_again, rules_hash

__all__ = ["VapEntry", "VapReport", "check_rows", "leaderboard", "pooled", "read_results", "submit"]

#: The measures of the paper's table: the recalls of actions, aAcc and wAcc.
MEASURES = (*ACTIONS, "aAcc", "wAcc")

#: The version of the format of the published results.
FORMAT = 2

#: The keys of a published row. `command` trains and measures it again. `model_sha256` is the hash of what `sha256_of`
#: says; the `weights` of a model without a network are its rules, or the predicates of the bound.
KEYS = (
    *("experiment", "learner", "predictor", "paper", "mode", "variant", "seed", "settings", "command", "note"),
    *("versions", "hashes", "sha256_of", "model_sha256", "cpu_seconds", "recall", "a_acc", "w_acc", "worlds"),
    "concepts",
)

#: The keys of each world of a row, see `evaluation`.
WORLD_KEYS = ("world", "frames", "a_acc", "counts", "correct")

#: The keys that identify a row.
_KEY = ("experiment", "mode", "learner", "variant", "predictor", "seed")


@dataclass(frozen=True, kw_only=True)
class VapEntry(CellEntry):
    """One line of a table: the runs of a row and variant in a mode, with one predictor.

    Attributes:
        predictor: The name of the predictor, or an empty text if the row has only one.
        worlds: The number of test worlds of each run, or 0 without a finished run.
        concepts: The mean recall of each concept over the runs; empty if the row does not train concepts.
        paper: The paper's figures by measure, or `None`.
    """

    predictor: str
    worlds: int
    concepts: Mapping[str, float]
    paper: Mapping[str, float] | None

    @property
    def label(self) -> str:
        """The row with its predictor and variant."""
        return ", ".join(part for part in (self.row, self.predictor, self.variant) if part)

    def figures(self) -> list[str]:
        """Return the texts of `MEASURES`."""
        return [_figure(self.measures.get(name), len(self.seeds), self.worlds, "-") for name in MEASURES]


class VapReport(CellReport):
    """The results of the cells of an experiment.

    Args:
        experiment: The experiment.
        cells: The cells.
        root: The folder of the experiment.
        failed: The messages of the cells that failed, by identity.
    """

    def __init__(
        self,
        experiment: VapExperiment,
        cells: Sequence[VapCell],
        root: Path,
        failed: Mapping[str, str] | None = None,
    ) -> None:
        """Read the results."""
        self.experiment, self.title, self.paper = experiment, experiment.title, experiment.paper
        runs = Runs(cells, root)
        self.entries: list[VapEntry] = [
            entry for group in runs.grouped("mode", "row", "variant") for entry in self._entries(group, failed or {})
        ]
        self.cpu_hours = runs.cpu_hours

    def _entries(self, runs: Runs[VapCell], failed: Mapping[str, str]) -> Iterator[VapEntry]:
        first = runs.cells[0]
        spec, variant = self.experiment.learners[first.row], self.experiment.variants[first.variant]
        predictors = list(runs.measured[0]["evaluations"]) if runs.measured else [""]
        for predictor in predictors:
            results = [measured["evaluations"][predictor] for measured in runs.measured]
            recalls = [measured["concepts"] for measured in runs.measured] if predictor == predictors[0] else []
            yield VapEntry(
                **runs.fields(variant, failed),
                predictor=predictor,
                worlds=len(results[0]["worlds"]) if results else 0,
                measures=pooled([each["worlds"] for each in results]) if results else {},
                concepts=mean_recalls(recalls),
                paper=paper_figures(self.experiment.paper, spec.paper or first.row, first.variant, first.mode),
            )

    def table(self, mode: str) -> list[list[str]]:
        """Return the table of a mode: a head, then for each entry its measures, and the paper's below if it has any."""
        lines = [["learner", *MEASURES, "seeds"]]
        for entry in self.entries:
            if entry.mode == mode:
                lines.append([entry.label, *entry.figures(), ",".join(map(str, entry.seeds)) or entry.missing[:60]])
                if entry.paper is not None:
                    paper = [f"{entry.paper[name]:.2f}" if name in entry.paper else "-" for name in MEASURES]
                    lines.append(["  the paper's", *paper, ""])
        return lines

    def concept_table(self) -> list[list[str]]:
        """Return the recalls of concepts: a head, then a line for each predicate. Only a head without concepts.

        The last column has the paper's recalls if the experiment names a table of the paper.
        """
        shown = [entry for entry in self.entries if entry.concepts]
        paper = paper_table("vap-concepts")["concepts"] if self.paper else None
        names = [", ".join(part for part in (entry.mode, entry.row, entry.variant) if part) for entry in shown]
        lines = [["predicate", *names, *([] if paper is None else ["the paper's"])]]
        for name in dict.fromkeys(name for entry in shown for name in entry.concepts):
            recalls = [f"{entry.concepts[name]:.3f}" if name in entry.concepts else "-" for entry in shown]
            if paper is not None:
                recalls.append(f"{paper[name]:.3f}" if name in paper else "-")
            lines.append([name, *recalls])
        return lines

    def notes(self) -> list[str]:
        """Return sentences on intervals, missing cells, the paper and the CPU time."""
        notes = []
        if any(_repeated(len(entry.seeds), entry.worlds) for entry in self.entries):
            notes.append("Intervals (95 %): bootstrap over seeds and, independently, over test worlds.")
        if any(entry.seeds and not _repeated(len(entry.seeds), entry.worlds) for entry in self.entries):
            notes.append("Values of one seed and one test world have no interval.")
        if table := paper_table(self.experiment.paper):
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        if self.paper and any(entry.concepts for entry in self.entries):
            table = paper_table("vap-concepts")
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        for entry in self.entries:
            if entry.missing:
                notes.append(f"{entry.label}, {entry.mode}: {entry.missing}.")
        notes.append(f"CPU time: {self.cpu_hours:.2f} hours, without the making of data.")
        return list(dict.fromkeys(notes))

    def text(self) -> str:
        """Return everything for a terminal: a table per mode, the recalls of concepts, and notes."""
        parts = [self.experiment.title]
        for mode in self.modes:
            parts += [f"\n{mode}", aligned(self.table(mode))]
        if len(concepts := self.concept_table()) > 1:
            parts += ["\nrecall of concepts at the threshold 0.5", aligned(concepts)]
        return "\n".join([*parts, "", *self.notes()])

    def markdown(self) -> str:
        """Return the report as Markdown."""
        parts = [f"# {self.experiment.title}\n"]
        for mode in self.modes:
            parts += [f"## {mode.capitalize()}\n", markdown_table(self.table(mode))]
        if len(concepts := self.concept_table()) > 1:
            parts += ["## Recall of concepts at the threshold 0.5\n", markdown_table(concepts)]
        parts += ["## Notes\n", *(f"- {note}" for note in self.notes())]
        return "\n".join(parts) + "\n"

    def latex(self) -> str:
        """Return the tables of the modes as LaTeX, with the rules of the package booktabs."""
        lines = [f"% {self.title}"]
        for mode in self.modes:
            lines += [f"% {mode}", *latex_table(self.table(mode))]
        return "\n".join(lines) + "\n"

    def _figures(self, root: Path) -> list[Path]:
        rows = max(sum(entry.mode == mode for entry in self.entries) for mode in self.modes)
        drawings = {"bars": (self._bars, max(4.2, 0.22 * rows))}
        if any(entry.x is not None for entry in self.entries):
            drawings["lines"] = (self._lines, 4.2)
        titles = {mode: f"{self.title}: {mode}" for mode in self.modes}
        written = []
        for name, (draw, height) in drawings.items():
            written += draw_panels(root, name, titles, draw, columns=len(titles), size=(7.2, height))
        return written

    def _bars(self, axes: Any, mode: str) -> None:
        """Draw the wAcc of each entry with its interval, and the paper's."""
        bars = [
            (entry.label, entry.measures.get("wAcc"), None if entry.paper is None else entry.paper["wAcc"])
            for entry in self.entries
            if entry.mode == mode
        ]
        draw_bars(axes, bars, "wAcc on test worlds")

    def _lines(self, axes: Any, mode: str) -> None:
        """Draw the wAcc over `x`, one line for each row, predictor and group."""
        lines: dict[str, list[tuple[float, Interval]]] = {}
        for entry in self.entries:
            if entry.mode == mode and entry.x is not None and entry.measures:
                name = ", ".join(part for part in (entry.row, entry.predictor, entry.group) if part)
                lines.setdefault(name, []).append((entry.x, entry.measures["wAcc"]))
        draw_lines(axes, lines, (self.experiment.x, "wAcc on test worlds"))


def paper_figures(table: str | None, row: str, variant: str, mode: str) -> dict[str, float] | None:
    """Return the paper's figures of a cell by measure, or `None` if it has no such cell."""
    values = paper_table(table).get("rows", {}).get(row, {}).get(variant, {}).get(mode)
    if values is None:
        return None
    return {name: value for name, value in zip(MEASURES, values, strict=True) if value is not None}


def _repeated(runs: int, worlds: int) -> bool:
    """Return whether there is a spread from which an interval follows."""
    return runs > 1 or worlds > 1


def _figure(measure: Interval | None, runs: int, worlds: int, missing: str) -> str:
    """Format a measure, with its interval unless it is that of one run on one world."""
    if measure is None:
        return missing
    return str(measure) if _repeated(runs, worlds) else f"{measure.value:.2f}"


def mean_recalls(runs: Sequence[Mapping[str, Mapping[str, Any]]]) -> dict[str, float]:
    """Return the mean recall of each concept that occurs over runs."""
    names = dict.fromkeys(name for run in runs for name, each in run.items() if each["count"])
    return {name: float(np.mean([run[name]["recall"] for run in runs])) for name in names}


def pooled(runs: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, Interval]:
    """Return the measures of several runs on the same worlds, with 95 % intervals.

    The values are means over the runs. The intervals are percentiles of a bootstrap that draws runs and, independently,
    worlds, because the pictures of a world are alike. Actions that do not occur have no recall.

    Args:
        runs: For each run, the `worlds` of its evaluation.
    """
    generator = np.random.default_rng(0)
    tables = _tables(runs)
    of_runs, of_worlds = bootstrap_weights(generator, len(runs)), bootstrap_weights(generator, len(runs[0]))
    plain = _means(tables)
    samples = _measures(tables, of_runs, of_worlds)
    result = {}
    for name, values in samples.items():
        known = values[~np.isnan(values)]
        if not np.isnan(plain[name][0]) and len(known):
            low, high = np.percentile(known, [2.5, 97.5])
            result[name] = Interval(float(plain[name][0]), float(low), float(high))
    return result


def _tables(runs: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, NDArray[np.float64]]:
    """Return what `_measures` needs of the `worlds` of runs."""
    return {
        name: np.array([[world[name] for world in run] for run in runs], np.float64)
        for name in ("counts", "correct", "a_acc", "frames")
    }


def _means(tables: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return each measure with equal weights of all runs and worlds, (1,)."""
    runs, worlds = tables["frames"].shape
    return _measures(tables, np.full((1, runs), 1 / runs), np.full((1, worlds), 1 / worlds))


def _measures(
    tables: Mapping[str, NDArray[np.float64]], of_runs: NDArray[np.float64], of_worlds: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return each measure for each sample (S,), NaN where an action does not occur.

    Args:
        tables: `counts` and `correct` (R, W, 4), `a_acc` and `frames` (R, W).
        of_runs: The weights of runs (S, R).
        of_worlds: The weights of worlds (S, W).
    """
    counts, correct = (np.einsum("sw,rwa->sra", of_worlds, tables[name]) for name in ("counts", "correct"))
    with np.errstate(invalid="ignore", divide="ignore"):
        recall = correct / counts
        inverse = np.where(counts > 0, 1 / counts, 0.0)
        w_acc = (np.nan_to_num(recall) * inverse).sum(2) / inverse.sum(2)
        a_acc = (of_worlds @ tables["a_acc"].T) / (of_worlds @ tables["frames"].T)
    values: dict[str, NDArray[np.float64]] = {"aAcc": (of_runs * a_acc).sum(1), "wAcc": (of_runs * w_acc).sum(1)}
    for at, name in enumerate(ACTIONS):
        values[name] = (of_runs * recall[:, :, at]).sum(1)
    return values


# --- published results


def read_results(path: Path) -> dict[str, Any]:
    """Read the published results.

    Returns:
        `format` and `rows`; a file that does not exist has no rows.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not such a file.
    """
    return read_file(path, FORMAT, KEYS, _KEY) or {"format": FORMAT, "rows": []}


def check_rows(results: Mapping[str, Any], experiments: Mapping[str, VapExperiment] | None = None) -> list[str]:
    """Check published rows against the experiments, the rules and their own counts.

    Args:
        results: The results, as `read_results` returns them.
        experiments: Experiments by name. The names of other rows are those of built-in experiments.

    Returns:
        A line for each fault: a row that occurs twice or that its experiment does not have; other keys, rules or
        settings than today's; other worlds than those of the settings; or measures that do not follow from the counts
        of the worlds.

    Raises:
        InputError: If the file of an experiment is invalid.
        OSError: If the file of an experiment cannot be read.
    """
    known = dict(experiments or {})
    keys = [row_key(row, _KEY) for row in results["rows"]]
    found = []
    for row, key in zip(results["rows"], keys, strict=True):
        name = row["experiment"]
        if name not in known:
            known[name], _ = VapExperiment.load(name)
        faults = ["it occurs twice"] if keys.count(key) > 1 else []
        faults += _row_faults(row, known[name])
        place = ", ".join(part for part in (row["learner"], row["predictor"], row["variant"]) if part)
        found += [f"{name}: {place}, {row['mode']}, seed {row['seed']}: {fault}" for fault in faults]
    return found


def _row_faults(row: Mapping[str, Any], experiment: VapExperiment) -> Iterator[str]:
    """Yield the faults of a published row, see `check_rows`."""
    if row.keys() != set(KEYS) or any(each.keys() != set(WORLD_KEYS) for each in row["worlds"]):
        yield "other keys"
        return
    if row["hashes"].get("rules") != rules_hash(row["mode"]):
        yield "other rules"
    yield from _experiment_faults(row, experiment)
    if row["worlds"]:
        yield from _measure_faults(row)


def _experiment_faults(row: Mapping[str, Any], experiment: VapExperiment) -> Iterator[str]:
    """Yield what differs between a row and its experiment."""
    spec, variant = experiment.learners.get(row["learner"]), experiment.variants.get(row["variant"])
    if spec is None or variant is None or row["variant"] not in (spec.variants or experiment.variants):
        yield "no such learner or variant"
        return
    if row["mode"] not in ((variant.mode,) if variant.mode else spec.modes or experiment.modes):
        yield "no such mode"
    settings = experiment.settings_of(row["learner"], variant)
    if row["settings"] != settings.model_dump(mode="json"):
        yield "other settings"
    if [each["world"] for each in row["worlds"]] != list(range(settings.worlds.test)):
        yield "other worlds"
    if row["paper"] != (spec.paper or row["learner"]):
        yield "another row of the paper"


def _measure_faults(row: Mapping[str, Any]) -> Iterator[str]:
    """Yield the measures that do not follow from the counts of the worlds, and impossible recalls of concepts."""
    means = {name: float(each[0]) for name, each in _means(_tables([row["worlds"]])).items()}
    recorded = {**row["recall"], "aAcc": row["a_acc"], "wAcc": row["w_acc"]}
    for name, value in means.items():
        # The sums over the frames of a world have six decimals. An action that does not occur has no recall.
        if not np.isclose(recorded.get(name, np.nan), value, rtol=0, atol=1e-6, equal_nan=True):
            yield f"another {name}"
    for name, each in row["concepts"].items():
        if (each["recall"] is None) != (each["count"] == 0) or not 0 <= (each["recall"] or 0) <= 1:
            yield f"an impossible recall of {name}"


def submit(
    experiment: VapExperiment,
    file: Path,
    cells: Sequence[VapCell],
    root: Path,
    results: Path,
    *,
    only_hashes: bool = False,
) -> Iterator[str]:
    """Measure the models of finished cells again, and write a row for each predictor.

    A row replaces that of the same experiment, learner, predictor, mode, variant and seed, and keeps its note. Rows
    of other seeds with other settings or rules are removed. Cells that tables omit have no row.

    Args:
        experiment: The experiment.
        file: The file of the experiment.
        cells: The cells. Those that are not finished are skipped.
        root: The folder of the experiment.
        results: The file of results.
        only_hashes: Whether to write only the hashes of rows that are published and have the same figures.

    Yields:
        A line for each cell.

    Raises:
        OSError: If a file cannot be read or written, or another process writes the file of results.
        ValueError: If a model does not give the recorded measures, or the file of results is invalid.
    """
    with updating(results, lambda: read_results(results)) as document:
        rows = {row_key(row, _KEY): row for row in document["rows"]}
        for cell in cells:
            if not cell.hidden:
                yield from _update(rows, experiment, file, cell, root, only_hashes)
        order: dict[str, list[str]] = {
            "mode": list(experiment.modes),
            "learner": list(experiment.learners),
            "variant": list(experiment.variants),
        }

        def place(row: Mapping[str, Any]) -> tuple[Any, ...]:
            """Sort by experiment; the rows of this one have its order."""
            own = row["experiment"] == file.stem
            return row["experiment"], *(place_of(row, order) if own else ())

        document["rows"] = sorted(rows.values(), key=place)
    yield f"{len(rows)} rows in {results}"


def _update(
    rows: dict[tuple[Any, ...], Mapping[str, Any]],
    experiment: VapExperiment,
    file: Path,
    cell: VapCell,
    root: Path,
    only_hashes: bool,
) -> Iterator[str]:
    """Add the rows of a cell if it is finished, and yield a line."""
    measured = finished(cell, root)
    if measured is None:
        yield f"{cell.name}: not finished"
        return
    model = read_tensors(cell.model(root), "a model")
    if only_hashes:
        own = [key for key, row in rows.items() if _is_of(row, file, cell)]
        if not own:
            yield f"{cell.name}: not published"
            return
        if all(is_published(rows[key], "model_sha256", cell.model(root)) for key in own):
            for key in own:
                rows[key] = {**rows[key], "sha256_of": "weights", "model_sha256": weights_hash(model)}
            yield f"{cell.name}: weights {weights_hash(model)[:12]}, from the published file"
            return
    again, _ = measure_again(cell, root)
    for predictor, recorded in measured["evaluations"].items():
        if again[predictor] != recorded:
            raise ValueError(
                f"{cell.name}: the model {cell.model(root)} has wAcc {again[predictor]['w_acc']}, not the recorded "
                f"{recorded['w_acc']}"
            )
        row = _row(experiment, file, cell, predictor, measured, model)
        if only_hashes:
            old = rows.get(row_key(row, _KEY))
            if old is None:
                yield f"{cell.name}, {predictor}: not published"
                continue
            try:
                row = rehashed(old, row, "model_sha256")
            except ValueError as error:
                raise ValueError(f"{cell.name}, {predictor}: {error}") from None
        row["note"] = rows.get(row_key(row, _KEY), row)["note"]
        group = [key for key in rows if key[:-1] == row_key(row, _KEY)[:-1]]
        for key in group:
            if any(rows[key][name] != row[name] for name in ("settings", "hashes")):
                del rows[key]
        rows[row_key(row, _KEY)] = row
    yield f"{cell.name}: {cell.headline(measured)}, as recorded"


def _is_of(row: Mapping[str, Any], file: Path, cell: VapCell) -> bool:
    """Return whether a row belongs to a cell of the experiment file, whatever its predictor."""
    names = {"experiment": file.stem, "learner": cell.row, "mode": cell.mode, "variant": cell.variant}
    return row["seed"] == cell.seed and all(row[name] == value for name, value in names.items())


def _row(
    experiment: VapExperiment,
    file: Path,
    cell: VapCell,
    predictor: str,
    measured: Mapping[str, Any],
    model: Mapping[str, Any],
) -> dict[str, Any]:
    recorded, result = measured["evaluations"][predictor], measured["result"]
    first = predictor == next(iter(measured["evaluations"]))
    # A variant that sets a mode is in every column.
    column = cell.row if experiment.variants[cell.variant].mode else f"{cell.row},{cell.mode}"
    return {
        "experiment": file.stem,
        "learner": cell.row,
        "predictor": predictor,
        "paper": experiment.learners[cell.row].paper or cell.row,
        "mode": cell.mode,
        "variant": cell.variant,
        "seed": cell.seed,
        "settings": result["settings"],
        "command": f"logicity experiment {name_of(file)} --only {column} --seeds {cell.seed}",
        "note": "",
        "versions": result["versions"],
        "hashes": result["hashes"],
        "sha256_of": "weights",
        "model_sha256": weights_hash(model),
        "cpu_seconds": result["cpu_seconds"],
        **{name: recorded[name] for name in ("recall", "a_acc", "w_acc", "worlds")},
        "concepts": measured["concepts"] if first else {},
    }


def leaderboard(results: Mapping[str, Any]) -> str:
    """Return the published results as Markdown: for each experiment and mode, a table beside the paper's figures."""
    rows = results["rows"]
    if not rows:
        return "The file `results/vap.json` has no row yet.\n"
    parts = []
    recalls = any(row["concepts"] for row in rows)
    for experiment, mode in dict.fromkeys((row["experiment"], row["mode"]) for row in rows):
        own = [row for row in rows if (row["experiment"], row["mode"]) == (experiment, mode)]
        groups: dict[tuple[str, str, str], list[Mapping[str, Any]]] = {}
        for row in own:
            groups.setdefault((row["learner"], row["predictor"], row["variant"]), []).append(row)
        lines = [["learner", "predictor", "variant", *MEASURES, "paper: wAcc", "seeds", "CPU min"]]
        for (learner, predictor, variant), group in groups.items():
            measures = pooled([row["worlds"] for row in group])
            paper = paper_figures(experiment, group[0]["paper"], variant, mode)
            lines.append(
                [
                    f"`{learner}`",
                    predictor,
                    variant,
                    *(_figure(measures.get(name), len(group), len(group[0]["worlds"]), "") for name in MEASURES),
                    "" if paper is None else f"{paper['wAcc']:.2f}",
                    ", ".join(str(row["seed"]) for row in group),
                    f"{sum(row['cpu_seconds'] for row in group) / len(group) / 60:.1f}",
                ]
            )
        parts.append(f"## `{experiment}`, {mode}\n\n{markdown_table(lines)}")
        parts += _concepts(own)
        parts.append(f"`logicity experiment {experiment}` makes these rows.\n")
    notes = sorted({f"- `{row['learner']}`, {row['mode']}: {row['note']}" for row in rows if row["note"]})
    tables = dict.fromkeys([*(row["experiment"] for row in rows), *(["vap-concepts"] if recalls else [])])
    sources = [f"- {table['source']}. {table['note']}" for name in tables if (table := paper_table(name))]
    if sources:
        parts.append("The paper's figures:\n\n" + "\n".join(sources) + "\n")
    return "\n".join([*parts, *(["\n".join(notes) + "\n"] if notes else [])])


def _concepts(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the table of the recalls of concepts, if rows have any."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["concepts"]:
            name = ", ".join(part for part in (row["learner"], row["variant"]) if part)
            groups.setdefault(name, []).append(row["concepts"])
    if not groups:
        return
    means = {name: mean_recalls(group) for name, group in groups.items()}
    paper = paper_table("vap-concepts")["concepts"]
    lines = [["recall of", *means, "the paper's"]]
    for predicate in dict.fromkeys(name for each in means.values() for name in each):
        figures = [f"{each[predicate]:.3f}" if predicate in each else "" for each in means.values()]
        lines.append([f"`{predicate}`", *figures, f"{paper[predicate]:.3f}" if predicate in paper else ""])
    yield markdown_table(lines)
