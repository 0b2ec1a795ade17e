"""Experiments of Visual Action Prediction, from a YAML file with `task: vap`. Needs the extras `learn` and `vap`.

A cell makes its data, trains one model, and measures it on the fixed test worlds. The reference of experiment files
describes the stages.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
from pydantic import BaseModel, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from ... import _logicity
from ..._logicity import __version__
from ...city import ACTIONS, Inference
from ...errors import did_you_mean, missing_extra
from ...files import file_hash, read_json, read_tensors, write_json
from ...learn.faults import Fault, contains, faults, merged
from ...learn.settings import Seed, StrictModel
from ...learn.storage import weights_hash
from ...rules import Program
from ...vap.data import BINARY, UNARY, symbolic_facts
from ...vap.features import Backbone, DataSpec, Kind, prepared, weights_file
from ...vap.metrics import vap_metrics
from ..cells import Job
from ..spf.experiment import (
    Selection,
    paper_faults,
    read_experiment,
    repeated,
    selected,
    start_faults,
    unknown_key,
    validated,
)

try:
    import torch
    from torch import Tensor
except ImportError as error:
    raise missing_extra("vap", error) from error

from ...vap.concepts import RELATIONS, ConceptModel, ConceptSettings
from ...vap.reasoners import make_reasoner
from ...vap.soft_rules import SoftRules
from ...vap.training import (
    Samples,
    TrainingSettings,
    concept_loss,
    concept_measures,
    end_to_end_loss,
    fit,
    groundings,
    predict_actions,
    reasoning_loss,
    save,
)

if TYPE_CHECKING:
    from .report import VapReport

__all__ = ["VapCell", "VapExperiment", "VapSettings", "run_cell"]

#: The version of the format of the files of a cell.
FORMAT = 1

#: The message about a row that needs the concepts of another one.
NO_CONCEPTS = "`groundings: predicted` needs the concepts of another row: set its `start`"

_Worlds = Annotated[int, Field(ge=1, le=100_000)]


class Worlds(StrictModel):
    """The numbers of worlds, of 89 pictures each."""

    train: _Worlds = 30
    """The number of worlds for training."""
    val: _Worlds = 5
    """The number of worlds for validation, which chooses the best epoch."""
    test: _Worlds = 20
    """The number of test worlds, which always have the fixed agents. The paper has 20."""


class VapSettings(StrictModel):
    """The settings of a cell."""

    stage: Literal["concepts", "reasoning", "end-to-end", "induction", "bound"] = "concepts"
    """Which parts are trained, and what predicts the actions."""
    agents: Literal["fixed", "random"] = "random"
    """The agents of the worlds for training and validation."""
    worlds: Worlds = Worlds()
    """The numbers of worlds."""
    difficulty: Annotated[int, Field(ge=0, le=100)] = 50
    """The difficulty of the pictures for training and validation, in percent."""
    test_difficulty: Annotated[int, Field(ge=0, le=100)] | None = None
    """The difficulty of the test pictures. By default that of training."""
    drawing_version: Literal[1, 2] = 2
    """The version of the drawing code, see `logicity.vap.make_dataset`."""
    data_seed: Seed = 0
    """The seed of the worlds."""
    fraction: Annotated[float, Field(gt=0, le=1)] = 1.0
    """The share of the training samples to use. The seed of the cell selects them."""
    concepts: ConceptSettings = ConceptSettings()
    """The architecture of the perception."""
    weights: str | None = None
    """For `perception: features`, the file of the backbone's weights. A path is relative to the working directory. By
    default torchvision's cache has the file."""
    reasoner: Literal["gnn", "nlm"] = "gnn"
    """A graph network (`gnn`) or a Neural Logic Machine (`nlm`), for the stages `reasoning` and `end-to-end`."""
    groundings: Literal["predicted", "exact"] = "predicted"
    """The truth values on which a reasoner is trained and tested, or from which rules are learned."""
    training: TrainingSettings = TrainingSettings()
    """The hyperparameters of training."""

    @model_validator(mode="after")
    def _consistent(self) -> VapSettings:
        key = fault = ""
        if self.groundings == "exact" and self.stage in ("concepts", "end-to-end"):
            key = "groundings"
            fault = f"`groundings: exact` cannot be combined with the stage `{self.stage}`, which predicts the concepts"
        elif self.groundings == "predicted" and self.stage == "bound":
            key, fault = "stage", "the stage `bound` needs `groundings: exact`"
        elif self.weights is not None and self.concepts.perception != "features":
            key = "weights"
            fault = "`weights` are those of a backbone: they need `concepts.perception: features`"
        elif self.concepts.perception == "features" and self.concepts.features != Backbone.shape[0]:
            key = "concepts.features"
            fault = f"the backbone has {Backbone.shape[0]} features: `concepts.features` cannot change this"
        if fault:
            # Errors of a whole model have no path, so the context has the key.
            raise PydanticCustomError("custom", "{message}", {"message": fault, "key": key})
        return self

    @property
    def needs_concepts(self) -> bool:
        """Whether the concepts are those of the model from which the training starts."""
        return self.groundings == "predicted" and self.stage in ("reasoning", "induction")

    @property
    def kind(self) -> Kind | None:
        """The kind of stored features that the model sees, or `None`."""
        if self.groundings == "exact":
            return None
        kinds: dict[str, Kind | None] = {"crops": "crops", "features": "resnet50", "sides": None}
        return kinds[self.concepts.perception]

    @property
    def weights_hash(self) -> str | None:
        """The SHA-256 of the file of the backbone's weights, or `None` without a backbone."""
        return _weights_hash(weights_file(self.weights)) if self.kind == "resnet50" else None


@dataclass(frozen=True, kw_only=True)
class VapCell(Job):
    """A cell of an experiment of Visual Action Prediction.

    Attributes:
        settings: The settings.
    """

    settings: VapSettings

    @property
    def steps(self) -> int:
        """The number of epochs."""
        return 1 if self.settings.stage in ("induction", "bound") else self.settings.training.epochs

    def spec(self) -> dict[str, Any]:
        """Return what determines the result of the cell."""
        return {
            "format": FORMAT,
            "version": __version__,
            "mode": self.mode,
            "seed": self.seed,
            "settings": self.settings.model_dump(mode="json"),
            "rules": rules_hash(self.mode),
            "start": None if self.start is None else self.start.identity,
            **({} if self.settings.weights_hash is None else {"backbone": self.settings.weights_hash}),
        }

    def document(self, root: Path) -> dict[str, Any]:
        """Return the content of `cell.json`. Experiments beside each other share their data."""
        return {"task": "vap", "spec": self.spec(), "data": str(root.resolve().parent / "vap-data")}

    def model(self, root: Path) -> Path:
        """Return the file of the model."""
        return self.folder(root) / "model.pt"

    def headline(self, measured: Mapping[str, Any]) -> str:
        """Return the weighted accuracy of the first predictor."""
        name, evaluation = next(iter(measured["evaluations"].items()))
        return f"wAcc {evaluation['w_acc']:.3f}{f' ({name})' if name else ''}"


class Row(StrictModel):
    """A row of the table: a model with its settings."""

    settings: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings, after those of the experiment."""
    start: str | None = None
    """The row from whose model, of the same mode, variant and seed, the training starts."""
    modes: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] | None = None
    """The modes; by default those of the experiment."""
    variants: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] | None = None
    """The variants; by default all."""
    paper: str | None = None
    """The row of the paper's table whose figures are shown beside this row. By default the row of the same name."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings for `--quick`."""
    hidden: bool = False
    """Whether tables and figures omit the row, for example because it only provides a start for others."""


class Variant(StrictModel):
    """A variant of every row."""

    settings: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings, after those of the experiment and the row."""
    mode: Literal["easy", "hard"] | None = None
    """The mode of the worlds and rules, instead of that of the column."""
    start: str | None = None
    """The variant from whose models, of the same row and seed, the training starts, with the concepts and the reasoner
    of that model."""
    hidden: bool = False
    """Whether tables and figures omit the variant, for example because it only provides a start for others."""
    group: str | None = None
    """The line of the figure over `x` to which the variant belongs: variants of a row with the same group form one."""
    x: float | None = None
    """The position on the horizontal axis of that figure, which omits variants without it."""


class VapExperiment(StrictModel):
    """An experiment of Visual Action Prediction: what `logicity experiment` runs."""

    task: Literal["vap"]
    """The task, Visual Action Prediction."""
    title: str
    """The title of the table."""
    paper: Literal["vap", "vap-continual", "vap-concepts"] | None = None
    """The table of the paper whose figures are shown beside the results."""
    learners: Annotated[dict[str, Row], Field(min_length=1)]
    """The rows of the table, by name, each after the row that it starts from: models with their settings."""
    modes: Annotated[tuple[Literal["easy", "hard"], ...], Field(strict=False, min_length=1)]
    """The modes: the rules and the agents."""
    seeds: Annotated[tuple[Seed, ...], Field(strict=False, min_length=1)] = (0,)
    """The seeds of training. Each row, mode and variant is trained once with each seed."""
    variants: Annotated[dict[str, Variant], Field(min_length=1)] = Field(default_factory=lambda: {"": Variant()})
    """The variants of every row, by name: changes that multiply the rows. By default one without changes."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings of every row."""
    quick: dict[str, Any] = Field(default_factory=dict)
    """Changes to the settings of every row for `--quick`."""
    x: str = "x"
    """The label of the horizontal axis of the figure over the `x` of variants."""

    @classmethod
    def load(cls, name: str | os.PathLike[str]) -> tuple[VapExperiment, Path]:
        """Read a YAML file.

        Args:
            name: The file, or the bare name of a built-in experiment such as `vap`.

        Returns:
            The experiment, and the path of its file.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key.
            OSError: If the file cannot be read.
        """
        path, file, values = read_experiment(name)
        experiment = validated(cls, file, values, _unknown)
        wrong = [*experiment._faults()]
        if wrong:
            raise file.error(wrong)
        return experiment, path

    def _faults(self) -> Iterator[Fault]:
        """Yield the errors in the names of rows, modes and variants, in seeds, and in settings."""
        lists: list[tuple[list[str], Sequence[object]]] = [(["modes"], self.modes), (["seeds"], self.seeds)]
        for row, spec in self.learners.items():
            lists += [(["learners", row, "modes"], spec.modes or ())]
            lists += [(["learners", row, "variants"], spec.variants or ())]
        for path, values in lists:
            if message := repeated(values):
                yield "invalid-value", path, message, ""
        known: list[str] = []
        for row, spec in self.learners.items():
            if spec.start is not None and spec.start not in known:
                # A row that exists may be in the wrong place; another name may be misspelled.
                move = spec.start in self.learners and spec.start != row
                others = known if spec.start == row else [name for name in self.learners if name != row]
                help = f": move `{row}` below it" if move else did_you_mean(spec.start, others)
                message = f"`{row}` starts from `{spec.start}`, but no earlier row has this name{help}"
                yield "invalid-value", ["learners", row, "start"], message, ""
            for at, mode in enumerate(spec.modes or ()):
                if mode not in self.modes:
                    message = f"unknown mode `{mode}`{did_you_mean(mode, self.modes)}"
                    yield "invalid-value", ["learners", row, "modes", str(at)], message, ""
            for name in spec.variants or ():
                if name not in self.variants:
                    message = f"unknown variant `{name}`{did_you_mean(name, self.variants)}"
                    yield "invalid-value", ["learners", row, "variants"], message, ""
            known.append(row)
        yield from start_faults(self.variants)
        yield from paper_faults(self.paper, self.learners, "vap")
        yield from self._settings_faults()

    def _settings_faults(self) -> Iterator[Fault]:
        """Yield the errors in settings, each once, where its value is written, and rows that lack a `start`."""
        # A value of the experiment is part of many cells.
        seen: set[tuple[str, ...]] = set()
        for quick in (False, True):
            for row, spec in self.learners.items():
                for name in spec.variants or self.variants:
                    for fault in self._cell_faults(row, name, quick):
                        if tuple(fault[1]) not in seen:
                            seen.add(tuple(fault[1]))
                            yield fault

    def _cell_faults(self, row: str, name: str, quick: bool) -> Iterator[Fault]:
        """Yield the errors in the settings of a row and the variant with a name."""
        spec, variant = self.learners[row], self.variants.get(name, Variant())
        try:
            settings = self.settings_of(row, variant, Selection(quick=quick))
        except ValidationError as error:
            for code, path, message, help in faults(error, _unknown_setting):
                at = self._written(row, name, path or _key_of(error), quick)
                cell = f"settings of `{row}`: " if not path or at[:2] == ["learners", row] else ""
                yield code, at, f"{cell}{message}", help
            return
        if settings.needs_concepts and spec.start is None and variant.start is None:
            yield "invalid-value", ["learners", row], f"`{row}`: {NO_CONCEPTS}", ""

    def _written(self, row: str, name: str, path: Sequence[str], quick: bool) -> list[str]:
        """Return the path in the file of the setting with a path, or the path of the row if no key has it."""
        spec, variant = self.learners[row], self.variants.get(name, Variant())
        parts: list[tuple[list[str], Mapping[str, Any]]] = [
            (["settings"], self.settings),
            (["learners", row, "settings"], spec.settings),
            (["variants", name, "settings"], variant.settings),
        ]
        if quick:
            parts += [(["quick"], self.quick), (["learners", row, "quick"], spec.quick)]
        written = [[*prefix, *path] for prefix, values in parts if contains(values, path)]
        # The last one overrides the others.
        return written[-1] if written else ["learners", row]

    def settings_of(self, row: str, variant: Variant, selection: Selection | None = None) -> VapSettings:
        """Return the settings of a row and a variant.

        Args:
            row: The name of the row.
            variant: The variant.
            selection: Changes to the settings.

        Raises:
            ValidationError: If a setting is invalid.
        """
        spec = self.learners[row]
        selection = selection or Selection()
        parts: list[Mapping[str, Any]] = [self.settings, spec.settings, variant.settings]
        if selection.quick:
            parts += [self.quick, spec.quick]
        values: dict[str, Any] = {}
        for part in (*parts, selection.changes):
            values = merged(values, part)
        return VapSettings.model_validate(values)

    def cells(self, file: Path, selection: Selection) -> list[VapCell]:
        """Return the selected cells, and those that they start from, each after the cell that it starts from.

        Args:
            file: The file of the experiment.
            selection: The cells to return, and changes to them.

        Raises:
            FileNotFoundError: If a backbone has no file of weights.
            InputError: If two rows or variants have the same settings.
            ValueError: If the selection names an unknown row or mode, or its changes are invalid.
        """
        seeds = selection.seeds or (self.seeds[:1] if selection.quick else self.seeds)
        found: dict[tuple[str, str, str, int], VapCell] = {}
        modes = {row: spec.modes or self.modes for row, spec in self.learners.items()}
        for row, mode in selected(selection.only, modes):
            for variant in self.learners[row].variants or self.variants:
                for seed in seeds:
                    self._add(found, (row, mode, variant, seed), selection)
        # A variant that sets a mode has the same cell in each column.
        unique: dict[str, VapCell] = {}
        for cell in found.values():
            same = unique.setdefault(cell.identity, cell)
            if (same.row, same.variant) == (cell.row, cell.variant):
                continue
            message = f"`{same.name}` and `{cell.name}` have the same settings: change or omit one of them"
            if selection.changes:
                raise ValueError(f"--set: {message}")
            raise read_experiment(file)[1].error([("invalid-value", ["learners", cell.row], message, "")])
        return list(unique.values())

    def _add(
        self, found: dict[tuple[str, str, str, int], VapCell], key: tuple[str, str, str, int], selection: Selection
    ) -> VapCell:
        """Add a cell after the one that it starts from."""
        if key in found:
            return found[key]
        row, mode, name, seed = key
        spec, variant = self.learners[row], self.variants[name]
        start: VapCell | None = None
        if variant.start is not None:
            start = self._add(found, (row, mode, variant.start, seed), selection)
        elif spec.start is not None:
            start = self._add(found, (spec.start, mode, name, seed), selection)
        try:
            settings = self.settings_of(row, variant, selection)
        except ValidationError as error:
            raise ValueError(f"--set: settings of `{row}`: {_first_message(error)}") from None
        if settings.needs_concepts and start is None:
            raise ValueError(f"--set: `{row}`: {NO_CONCEPTS}")
        found[key] = VapCell(
            row=row,
            mode=variant.mode or mode,
            variant=name,
            seed=seed,
            settings=settings,
            start=start,
            hidden=spec.hidden or variant.hidden,
        )
        return found[key]

    def report(self, cells: Sequence[Job], root: Path, failed: Mapping[str, str]) -> VapReport:
        """Return the results of cells, see `VapReport`."""
        from .report import VapReport

        return VapReport(self, cast(Sequence[VapCell], cells), root, failed)

    def submit(
        self, file: Path, cells: Sequence[Job], root: Path, results: Path, *, only_hashes: bool = False
    ) -> Iterator[str]:
        """Write rows of the published results, see `report.submit`."""
        from .report import submit

        return submit(self, file, cast(Sequence[VapCell], cells), root, results, only_hashes=only_hashes)


_unknown = unknown_key(VapExperiment, {"learners": Row, "variants": Variant})


def _first_message(error: ValidationError) -> str:
    """Return the message of the first error in settings."""
    _, _, message, help = faults(error, _unknown_setting)[0]
    return f"{message}; {help}" if help else message


def _key_of(error: ValidationError) -> list[str]:
    """Return the path of the setting that an error of a whole model names."""
    return str(error.errors()[0]["ctx"]["key"]).split(".")


def _unknown_setting(path: tuple[str, ...]) -> tuple[str, str]:
    """Return the message and the help for an unknown setting."""
    model: type[BaseModel] = VapSettings
    for name in path[:-1]:
        model = cast(type[BaseModel], model.model_fields[name].annotation)
    return f"unknown key `{'.'.join(path)}`", did_you_mean(path[-1], model.model_fields).removeprefix("; ")


@cache
def _weights_hash(path: Path) -> str:
    return file_hash(path)


@cache
def rules_hash(mode: str) -> str:
    """Return the SHA-256 of the configuration of a mode and its rules, with all their files.

    The names of the files depend on the working directory, and are left out.
    """
    files = Inference(f"configs/vap-{mode}.yaml")._inference.files()
    return hashlib.sha256(json.dumps(sorted(files.values())).encode()).hexdigest()


# --- running a cell


@dataclass
class Work:
    """The inputs and folders of a running cell.

    Attributes:
        mode: The mode.
        seed: The seed.
        settings: The settings.
        folder: The folder of the cell.
        data: The folder for data sets.
        report: Receives the number of finished epochs.
    """

    mode: Literal["easy", "hard"]
    seed: int
    settings: VapSettings
    folder: Path
    data: Path
    report: Callable[[int], None] | None

    @property
    def checkpoint(self) -> Path:
        """The file of the checkpoint."""
        return self.folder / "checkpoint.pt"

    def samples(self, split: Literal["train", "val", "test"]) -> Samples:
        """Return the samples of a split, made if they do not exist."""
        settings = self.settings
        test = split == "test" and settings.test_difficulty is not None
        spec = DataSpec(
            mode=self.mode,
            split=split,
            agents="fixed" if split == "test" else settings.agents,
            worlds=getattr(settings.worlds, split),
            difficulty=cast(int, settings.test_difficulty) if test else settings.difficulty,
            drawing_version=settings.drawing_version,
            seed=settings.data_seed,
            kind=settings.kind,
            weights=settings.weights,
        )
        tables, features = prepared(spec, self.data, f"{__version__} {rules_hash(self.mode)}")
        name = settings.concepts.perception
        samples = Samples.load(tables, {} if features is None else {name: features})
        return samples.subset(settings.fraction, self.seed) if split == "train" and settings.fraction < 1 else samples

    def rules(self) -> SoftRules:
        """Return the rules of the mode."""
        return SoftRules(Program.load(f"rules/vap-{self.mode}.dl"))

    def concepts(self) -> ConceptModel:
        """Return a concept model with random weights, which the seed determines."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            return ConceptModel(self.settings.concepts)

    def reasoner(self) -> torch.nn.Module:
        """Return a reasoner with random weights, which the seed determines."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            return make_reasoner(self.settings.reasoner)

    def started(self) -> dict[str, Any]:
        """Return the model that the cell starts from, or an empty one."""
        path = self.folder / "start.pt"
        model: dict[str, Any] = read_tensors(path, "a model") if path.exists() else {}
        return model


#: The model and its training history.
Trained = tuple[dict[str, Any], list[dict[str, float]]]


def run_cell(
    folder: Path, report: Callable[[int], None] | None = None, *, progress: bool = False, wandb: str | None = None
) -> dict[str, Any]:
    """Run the cell that `prepare` wrote to a folder, or resume it from its last checkpoint.

    The arguments are those of `logicity.experiments.cells.run_cell`, except that `wandb` must be `None`.

    Returns:
        The content of `measured.json`: the identity, the result of the training, the measures of each predictor, and
        the recalls of concepts.

    Raises:
        OSError: If a file cannot be read or written.
        ValueError: If `wandb` is given, the model to start from does not fit, or this process has other rules or
            weights of a backbone than the cell.
    """
    if wandb is not None:
        raise ValueError("--wandb: experiments of Visual Action Prediction send no curves: remove the option")
    document = read_json(folder / "cell.json")
    spec = document["spec"]
    data = Path(document["data"])
    if not data.parent.is_dir():
        # Another machine of a cluster makes its own data.
        data = Path(tempfile.gettempdir()) / "logicity-vap-data"
    settings = VapSettings.model_validate(spec["settings"])
    for name, today in {"rules": rules_hash(spec["mode"]), "backbone": settings.weights_hash}.items():
        if today != spec.get(name):
            raise ValueError(f"the {name} changed after the experiment had begun: run the same command again")
    work = Work(spec["mode"], spec["seed"], settings, folder, data, report)
    torch.set_num_threads(1)
    begun = time.process_time()
    stages = {
        "concepts": _train_concepts,
        "reasoning": _train_reasoner,
        "end-to-end": _train_end_to_end,
        "induction": _induce,
        "bound": _bound,
    }
    model, history = stages[work.settings.stage](work)
    save(model, folder / "model.pt")
    evaluations, concepts = _measured(work, model)
    trained = sum(each["cpu_seconds"] for each in history)
    measured = {
        "identity": document["identity"],
        "result": {
            "settings": spec["settings"],
            "seed": spec["seed"],
            # Epochs before an interruption took their time in another process.
            "cpu_seconds": round(max(time.process_time() - begun, trained), 1),
            "versions": {"logicity": __version__, "torch": torch.__version__, "python": platform.python_version()},
            "hashes": {name: spec[name] for name in ("rules", "backbone") if name in spec},
            "model_sha256": weights_hash(model),
            "history": [{name: each[name] for name in ("loss", "score")} for each in history],
        },
        "evaluations": evaluations,
        "concepts": concepts,
    }
    write_json(folder / "measured.json", measured)
    work.checkpoint.unlink(missing_ok=True)
    return measured


def measure_again(cell: VapCell, root: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the measures of the model of a finished cell on the test worlds, as `measured.json` has them.

    Raises:
        OSError: If a file cannot be read or written.
    """
    # One thread, as in `run_cell`: with several, measures could differ.
    torch.set_num_threads(1)
    data = Path(cell.document(root)["data"])
    work = Work(cast(Literal["easy", "hard"], cell.mode), cell.seed, cell.settings, cell.folder(root), data, None)
    return _measured(work, read_tensors(cell.model(root), "a model"))


def _measured(work: Work, model: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the measures of each predictor, and the recalls of concepts."""
    test = work.samples("test")
    actions, atoms = predict(work, model, test)
    concepts = {} if atoms is None else concept_measures(*atoms, test)
    return {name: evaluation(predicted, test) for name, predicted in actions.items()}, concepts


def predict(
    work: Work, model: dict[str, Any], samples: Samples
) -> tuple[dict[str, Tensor], tuple[Tensor, Tensor] | None]:
    """Return the predicted actions, int64 (B, N), by predictor, and the probabilities of concepts that were trained.

    Args:
        work: The inputs and folders of the cell.
        model: The content of `model.pt`.
        samples: The samples.
    """
    stage, valid = work.settings.stage, samples.facts["valid"]
    atoms = _groundings(work, model, samples)
    if stage == "concepts":
        return _by_rules(work.rules(), *atoms, samples), atoms
    if stage == "bound":
        shown = torch.tensor([name not in model["absent"] for name in UNARY])
        return {"": work.rules().degrees(atoms[0] * shown, atoms[1], valid, "max-min").argmax(-1)}, None
    if stage == "induction":
        return _by_rules(SoftRules(Program(model["rules"])), *atoms, samples), None
    reasoner = work.reasoner()
    reasoner.load_state_dict(model["reasoner"])
    return {"": predict_actions(reasoner, *atoms, valid)}, None


def evaluation(predicted: Tensor, samples: Samples) -> dict[str, Any]:
    """Return the measures of predicted actions, int64 (B, N): the paper's, and for each world what intervals need."""
    cars = samples.facts["mask"].numpy()
    actual, chosen = samples.facts["actions"].numpy(), predicted.numpy()
    frames = np.broadcast_to(np.arange(len(cars))[:, None], cars.shape)
    metrics = vap_metrics(actual[cars], chosen[cars], frames[cars])
    worlds = []
    of_frame = samples.facts["world"].numpy()
    hits = (actual == chosen) & cars
    with_cars = cars.any(1)
    share = hits.sum(1) / np.maximum(cars.sum(1), 1)
    for world in np.unique(of_frame):
        own = of_frame == world
        worlds.append(
            {
                "world": int(world),
                "frames": int((own & with_cars).sum()),
                "a_acc": round(float(share[own & with_cars].sum()), 6),
                "counts": np.bincount(actual[own][cars[own]], minlength=len(ACTIONS)).tolist(),
                "correct": np.bincount(actual[own][hits[own]], minlength=len(ACTIONS)).tolist(),
            }
        )
    return {"recall": dict(metrics.recall), "a_acc": metrics.a_acc, "w_acc": metrics.w_acc, "worlds": worlds}


def _score(predicted: Tensor, samples: Samples) -> float:
    """Return the mean recall over the actions that occur, which chooses the best epoch."""
    recall = evaluation(predicted, samples)["recall"]
    return float(np.mean(list(recall.values())))


def _by_rules(rules: SoftRules, unary: Tensor, binary: Tensor, samples: Samples) -> dict[str, Tensor]:
    """Return the actions of the rules on thresholded facts, and on probabilities."""
    valid = samples.facts["valid"]
    facts = ((unary > 0.5).float(), (binary > 0.5).float())
    return {
        "threshold": rules.degrees(*facts, valid, "max-min").argmax(-1),
        "product": rules.degrees(unary, binary, valid, "product").argmax(-1),
    }


def _train_concepts(work: Work) -> Trained:
    """Train a concept model."""
    train, val, settings = work.samples("train"), work.samples("val"), work.settings.training
    model = work.concepts()
    if start := work.started():
        _restore(model, start, "concepts")
    rules = work.rules()

    def score() -> float:
        return _score(_by_rules(rules, *groundings(model, val), val)["threshold"], val)

    loss = concept_loss(model, train, settings.class_power)
    history = fit(model, loss, len(train), settings, work.seed, score, work.checkpoint, work.report)
    return {"concepts": model.state_dict()}, history


def _groundings(work: Work, model: dict[str, Any], samples: Samples) -> tuple[Tensor, Tensor]:
    """Return the true groundings, or those that the concept model predicts from which a cell starts."""
    if work.settings.groundings == "exact":
        return samples.facts["unary"].float(), samples.relations.float()
    if "concepts" not in model:
        raise ValueError(NO_CONCEPTS)
    concepts = work.concepts()
    _restore(concepts, model, "concepts")
    return groundings(concepts, samples)


def _restore(part: torch.nn.Module, model: Mapping[str, Any], name: str) -> None:
    """Load the weights of a part of a model.

    Raises:
        ValueError: If the model has no such part, or one of another architecture.
    """
    if name not in model:
        raise ValueError(f"the model to start from has no part `{name}`: start from a row that trains it")
    try:
        part.load_state_dict(model[name])
    except RuntimeError:
        raise ValueError(
            f"the part `{name}` of the model to start from has another architecture: give both rows the same "
            "`concepts` and `reasoner`"
        ) from None


def _kept(start: Mapping[str, Any]) -> dict[str, Any]:
    """Return the concepts of the model to start from, if it has any."""
    return {name: start[name] for name in start if name == "concepts"}


def _train_reasoner(work: Work) -> Trained:
    """Train a reasoner on given concepts, which stay as they are."""
    train, val, settings = work.samples("train"), work.samples("val"), work.settings.training
    start = work.started()
    reasoner = work.reasoner()
    if "reasoner" in start:
        _restore(reasoner, start, "reasoner")
    unary, binary = _groundings(work, start, train)
    of_val = _groundings(work, start, val)

    def score() -> float:
        return _score(predict_actions(reasoner, *of_val, val.facts["valid"]), val)

    loss = reasoning_loss(reasoner, unary, binary, train, settings.class_power)
    history = fit(reasoner, loss, len(train), settings, work.seed, score, work.checkpoint, work.report)
    return {**_kept(start), "reasoner": reasoner.state_dict()}, history


def _train_end_to_end(work: Work) -> Trained:
    """Train a concept model and a reasoner together, on actions only."""
    train, val, settings = work.samples("train"), work.samples("val"), work.settings.training
    both = torch.nn.ModuleDict({"concepts": work.concepts(), "reasoner": work.reasoner()})
    concepts, reasoner = cast(ConceptModel, both["concepts"]), both["reasoner"]
    if start := work.started():
        for name, part in both.items():
            _restore(part, start, name)

    def score() -> float:
        return _score(predict_actions(reasoner, *groundings(concepts, val), val.facts["valid"]), val)

    loss = end_to_end_loss(concepts, reasoner, train, settings.class_power)
    history = fit(both, loss, len(train), settings, work.seed, score, work.checkpoint, work.report)
    return {name: part.state_dict() for name, part in both.items()}, history


def _induce(work: Work) -> Trained:
    """Learn rules from thresholded concepts and actions, with wrong examples."""
    start = work.started()
    train = work.samples("train")
    unary, binary = _groundings(work, start, train)
    scenes, learned = work.folder / "scenes.jsonl", work.folder / "learned.dl"
    with open(scenes, "w", encoding="utf-8") as out:
        for scene in scenes_of(unary > 0.5, binary > 0.5, train):
            out.write(json.dumps(scene) + "\n")
    options = ["--config", f"configs/vap-{work.mode}.yaml", "--noise", "auto", "--threads", "1", "--force"]
    command = ["induce", str(scenes), *options, "--seed", str(work.seed), "-o", str(learned)]
    code, _, _ = _logicity.run_command_line(command)
    if code:
        raise ValueError(f"`logicity {' '.join(command)}` failed")
    scenes.unlink()
    if work.report is not None:
        work.report(1)
    return {**_kept(start), "rules": learned.read_text(encoding="utf-8")}, []


def _bound(work: Work) -> Trained:
    """Find the unary predicates that hold for no agent of the training samples."""
    shown = work.samples("train").facts["unary"].flatten(0, 1).any(0)
    if work.report is not None:
        work.report(1)
    return {"absent": [name for name, each in zip(UNARY, shown.tolist(), strict=True) if not each]}, []


def scenes_of(unary: Tensor, binary: Tensor, samples: Samples) -> Iterator[dict[str, Any]]:
    """Yield a labeled scene for each car: the entities in its view, their facts, and its action.

    Args:
        unary: bool (B, N, 11), the facts of `UNARY`.
        binary: bool (B, N, N, 7), those of `RELATIONS`.
        samples: The samples, which have the actions.
    """
    truths, pairs = unary.numpy(), binary.numpy()
    at = RELATIONS.index("Sees")
    for frame, (cars, valid, actions) in enumerate(
        zip(
            samples.facts["mask"].numpy(), samples.facts["valid"].numpy(), samples.facts["actions"].numpy(), strict=True
        )
    ):
        for car in np.flatnonzero(cars):
            others = np.flatnonzero(valid & pairs[frame, car, :, at])
            seen = [int(car), *(int(other) for other in others if other != car)]
            yield {
                "entities": [f"e{entity}" for entity in seen],
                "ego": f"e{car}",
                "facts": facts_of(truths[frame], pairs[frame], seen),
                "actions": {f"e{car}": ACTIONS[actions[car]]},
            }


def facts_of(unary: np.ndarray[Any, Any], binary: np.ndarray[Any, Any], seen: Sequence[int]) -> dict[str, list[Any]]:
    """Return the facts of the entities in the view of one of them, as scenes have them.

    `Sees` has only the pairs of the viewer with each of the entities, itself included, whatever `binary` has.

    Args:
        unary: bool (N, 11), the facts of `UNARY` of a sample.
        binary: bool (N, N, 7), those of `RELATIONS`.
        seen: The numbers of the entities, each once, beginning with the viewer. Entity i has the name `ei`.
    """
    chosen = np.array(seen, np.int64)
    # An entity has no relation to itself, but a model can predict one.
    apart = ~np.eye(len(chosen), dtype=bool)
    pairs = binary[np.ix_(chosen, chosen)][..., : len(BINARY)] & apart[..., None]
    sees = np.zeros_like(apart)
    sees[0] = True
    return symbolic_facts([f"e{entity}" for entity in seen], unary[chosen], pairs, sees)
