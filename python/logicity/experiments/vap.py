"""Experiments of Visual Action Prediction. Needs the extras `learn` and `vap`."""

from __future__ import annotations

import platform
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

with extra("vap"):
    import torch
    from pydantic import Field, ValidationError

from .._logicity import __version__
from ..city import ACTIONS
from ..evaluation import Interval
from ..files import read_tensors
from ..learn.faults import Fault, faults
from ..learn.storage import processor, weights_hash
from ..vap.stages import NO_CONCEPTS, VapSettings, VapWork, measure, rules_hash, train_stage
from ..vap.training import save
from .experiment import Experiment, Place, Selection, changes_of, place_of, unknown_in
from .paper import paper_table
from .statistics import bootstrap_weights
from .task import Cell, CellKey, Running, Task

__all__ = ["VapExperiment", "VisualActionPrediction", "measures_of_worlds"]

#: The version of what determines a cell.
FORMAT = 1

#: Describes an unknown setting.
UNKNOWN = unknown_in(VapSettings, whole=True)

_Mode = Literal["easy", "hard"]


class VapExperiment(Experiment):
    """An experiment of Visual Action Prediction."""

    task: Literal["vap"]
    """The task, Visual Action Prediction."""
    paper: Literal["vap", "vap-continual", "vap-concepts"] | None = None
    """The table of the paper whose figures are shown beside the results."""
    modes: Annotated[tuple[_Mode, ...], Field(strict=False, min_length=1)]
    """The modes: the rules and the agents."""


class VisualActionPrediction(Task):
    """Models of Visual Action Prediction, see `Task`."""

    name = "vap"
    title = "Visual Action Prediction"
    experiment = VapExperiment
    settings_class = VapSettings
    measures: ClassVar[Mapping[str, str]] = {name: name for name in (*ACTIONS, "aAcc", "wAcc")}
    headline = "wAcc"
    measured_on = "test worlds"
    model_file = "model.pt"
    sampled = "worlds"
    interval_note = (
        "Intervals (95 %): bootstrap over seeds and, independently, over test worlds. Values of one seed and one "
        "test world have no interval."
    )
    details_title = "Recall of concepts at the threshold 0.5"
    paper = "vap"
    mode_titles: ClassVar[Mapping[str, str]] = {"easy": "easy", "hard": "hard"}

    def setting_faults(
        self, experiment: VapExperiment, file: Path, row: str, variant: str, places: Sequence[Place]
    ) -> Iterator[Fault]:
        """Yield the errors in settings, and rows that lack a `start`."""
        try:
            settings = VapSettings.model_validate(changes_of(places))
        except ValidationError as error:
            for code, path, message, help in faults(error, UNKNOWN):
                # An error of a whole model names its setting in the context.
                at = place_of(places, path or error.errors()[0]["ctx"]["key"].split(".")) or ["learners", row]
                cell = f"settings of `{row}`: " if not path or at[:2] == ["learners", row] else ""
                yield code, at, f"{cell}{message}", help
            return
        specs = (experiment.learners[row], experiment.variants.get(variant))
        starts = [spec.start for spec in specs if spec is not None]
        if settings.needs_concepts and all(start is None for start in starts):
            yield "invalid-value", ["learners", row], f"`{row}`: {NO_CONCEPTS}", ""

    def settings(
        self, experiment: VapExperiment, file: Path, key: CellKey, selection: Selection, *, started: bool, check: bool
    ) -> VapSettings:
        """Return the settings of a cell."""
        places = experiment.places(key.row, key.variant, selection.quick)
        try:
            settings = VapSettings.model_validate(changes_of(places, selection.changes))
        except ValidationError as error:
            _, _, message, help = faults(error, UNKNOWN)[0]
            raise ValueError(f"--set: settings of `{key.row}`: {message}" + f"; {help}" * bool(help)) from None
        if settings.needs_concepts and not started:
            raise ValueError(f"--set: `{key.row}`: {NO_CONCEPTS}")
        return settings

    def spec(self, cell: Cell) -> dict[str, Any]:
        """Return the settings, rules, weights of the backbone and version."""
        backbone = cell.settings.weights_hash
        return {
            "format": FORMAT,
            "version": __version__,
            "mode": cell.mode,
            "seed": cell.seed,
            "settings": cell.settings.model_dump(mode="json"),
            "rules": rules_hash(cell.mode),
            "start": None if cell.start is None else cell.start.identity,
            **({} if backbone is None else {"backbone": backbone}),
        }

    def document(self, cell: Cell, root: Path) -> dict[str, Any]:
        """Return the folder of the data, which experiments beside each other share."""
        return {"data": str(root.resolve().parent / "vap-data")}

    def steps(self, cell: Cell) -> int:
        """Return the number of epochs."""
        return 1 if cell.settings.stage in ("induction", "bound") else cell.settings.training.epochs

    def run(self, running: Running) -> dict[str, Any]:
        """Make the data, train the model, and measure it."""
        document, spec = running.document, running.document["spec"]
        data = Path(document["data"])
        if not data.parent.is_dir():
            # Another machine of a cluster makes its own data.
            data = Path(tempfile.gettempdir()) / "logicity-vap-data"
        settings = VapSettings.model_validate(spec["settings"])
        self.check_unchanged(spec, {"rules": rules_hash(spec["mode"]), "backbone": settings.weights_hash})
        work = VapWork(spec["mode"], spec["seed"], settings, running.folder, data, running.report)
        torch.set_num_threads(1)
        begun = time.process_time()
        model, history = train_stage(work)
        save(model, self.model(running.folder))
        evaluations, concepts = measure(work, model)
        trained = sum(each["cpu_seconds"] for each in history)
        result = {
            "settings": spec["settings"],
            "seed": spec["seed"],
            # Epochs before an interruption took their time in another process.
            "cpu_seconds": round(max(time.process_time() - begun, trained), 1),
            "versions": {
                "logicity": __version__,
                "torch": torch.__version__,
                "python": platform.python_version(),
                "processor": processor(),
            },
            "hashes": {name: spec[name] for name in ("rules", "backbone") if name in spec},
            "model_sha256": weights_hash(model),
            "history": [{name: each[name] for name in ("loss", "score")} for each in history],
        }
        return {"result": result, "evaluations": evaluations, "concepts": concepts}

    def measure_again(self, cell: Cell, root: Path) -> dict[str, dict[str, Any]]:
        """Measure the model on the test worlds."""
        # One thread, as in `run`: with several, measures could differ.
        torch.set_num_threads(1)
        folder, data = cell.folder(root), Path(self.document(cell, root)["data"])
        work = VapWork(cast(_Mode, cell.mode), cell.seed, cell.settings, folder, data)
        return measure(work, read_tensors(self.model(folder), "a model"))[0]

    def hashed(self, cell: Cell, root: Path) -> tuple[str, str]:
        """Return the hash of the weights. Those of a model without a network are its rules, or the absent classes."""
        return "weights", weights_hash(read_tensors(self.model(cell.folder(root)), "a model"))

    def intervals(self, evaluations: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
        """Return the means over the runs with 95 % intervals, see `measures_of_worlds`."""
        measures = measures_of_worlds([each["worlds"] for each in evaluations])
        if len(evaluations) > 1:
            return measures
        # The sums of a world are rounded.
        (one,) = evaluations
        values = one.get("values") or {**one["recall"], "aAcc": one["a_acc"], "wAcc": one["w_acc"]}
        return {name: Interval(values[name], each.low, each.high) for name, each in measures.items()}

    def evaluation_of(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return the measures and the counts of each world."""
        values = {name: each["value"] for name, each in row["measures"].items()}
        return {**super().evaluation_of(row), "values": values}

    def details(self, measured: Mapping[str, Any], name: str) -> dict[str, float]:
        """Return the recall of each concept that occurs, for the first predictor."""
        if name != next(iter(measured["evaluations"])):
            return {}
        return {concept: each["recall"] for concept, each in measured["concepts"].items() if each["count"]}

    def row_faults(self, row: Mapping[str, Any], experiment: VapExperiment) -> Iterator[str]:
        """Yield the differences from the rules, the settings and the counts of the worlds."""
        keys = {"world", "frames", "a_acc", "counts", "correct"}
        if any(each.keys() != keys for each in row["samples"]):
            yield "other keys"
            return
        if row["hashes"].get("rules") != rules_hash(row["mode"]):
            yield "other rules"
        settings = VapSettings.model_validate(changes_of(experiment.places(row["learner"], row["variant"], False)))
        if row["settings"] != settings.model_dump(mode="json"):
            yield "other settings"
        if [each["world"] for each in row["samples"]] != list(range(settings.worlds.test)):
            yield "other worlds"
        if row["samples"]:
            for name, (value,) in _means(_tables([row["samples"]])).items():
                recorded = row["measures"].get(name, {}).get("value", np.nan)
                # The sums over the frames of a world have six decimals. An action that does not occur has no recall.
                if not np.isclose(recorded, value, rtol=0, atol=1e-6, equal_nan=True):
                    yield f"another {name}"
        for name, recall in row["details"].items():
            if not 0 <= recall <= 1:
                yield f"an impossible recall of {name}"

    def paper_details(self, table: str | None, mode: str) -> tuple[dict[str, dict[str, float]], str]:
        """Return the paper's recalls of concepts in the mode in which it measured them."""
        concepts = paper_table("vap-concepts")
        if table is None or mode != concepts["mode"]:
            return {}, ""
        heading, source = f"the paper's, {concepts['measured']}", f"{concepts['source']}. {concepts['note']}"
        return {heading: concepts["concepts"]}, source


def measures_of_worlds(runs: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, Interval]:
    """Return the measures of several runs on the same worlds, with 95 % intervals.

    The values are means over the runs. The intervals are percentiles of a bootstrap that draws runs and, independently,
    worlds, because the pictures of a world are alike. Actions that do not occur have no recall. Each run has the
    `worlds` of its evaluation.
    """
    generator = np.random.default_rng(0)
    tables = _tables(runs)
    of_runs, of_worlds = bootstrap_weights(generator, len(runs)), bootstrap_weights(generator, len(runs[0]))
    plain = _means(tables)
    samples = _measures(tables, of_runs, of_worlds)
    result = {}
    for name, values in samples.items():
        known, (mean,) = values[~np.isnan(values)], plain[name]
        if not np.isnan(mean) and len(known):
            low, high = np.percentile(known, [2.5, 97.5])
            result[name] = Interval(float(mean), float(low), float(high))
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

    The tables are `counts` and `correct` (R, W, 4), `a_acc` and `frames` (R, W). The weights are (S, R) and (S, W).
    """
    counts, correct = (np.einsum("sw,rwa->sra", of_worlds, tables[name]) for name in ("counts", "correct"))
    with np.errstate(invalid="ignore", divide="ignore"):
        recall = correct / counts
        inverse = np.where(counts > 0, 1 / counts, 0.0)
        w_acc = (np.nan_to_num(recall) * inverse).sum(2) / inverse.sum(2)
        a_acc = (of_worlds @ tables["a_acc"].T) / (of_worlds @ tables["frames"].T)
    values = {"aAcc": a_acc, "wAcc": w_acc} | {name: recall[:, :, at] for at, name in enumerate(ACTIONS)}
    return {name: (of_runs * each).sum(1) for name, each in values.items()}
