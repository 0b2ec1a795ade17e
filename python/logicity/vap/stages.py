"""Training of models of Visual Action Prediction in stages, and their measures. Needs the extras `learn` and `vap`.

`train_stage` makes the data and trains one model, and `measure` measures it on the fixed test worlds. The reference of
experiment files describes the stages.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from ..errors import extra

with extra("vap"):
    import torch
    from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator
    from pydantic_core import PydanticCustomError
    from torch import Tensor

from .. import _logicity
from .._logicity import __version__
from ..city import ACTIONS
from ..files import read_tensors
from ..learn.settings import Seed, StrictModel
from ..rules import Program
from ..tasks import files_hash
from .bilevel import BilevelSettings
from .concepts import RELATIONS, ConceptModel, ConceptSettings
from .data import BINARY, UNARY, symbolic_facts
from .features import Backbone, DataSpec, Kind, prepared, weights_file, weights_file_hash
from .metrics import vap_metrics
from .reasoners import make_reasoner, rule_degrees
from .training import (
    Samples,
    TrainingSettings,
    bilevel_loss,
    concept_loss,
    concept_measures,
    end_to_end_loss,
    fit,
    groundings,
    predict_actions,
    reasoning_loss,
)

__all__ = [*("NO_CONCEPTS", "VapSettings", "VapWork", "facts_of", "measure", "rules_hash", "scenes_of", "train_stage")]

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
    """What is trained on which data."""

    stage: Literal["concepts", "reasoning", "end-to-end", "bilevel", "induction", "bound"] = "concepts"
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
    """The share of the training samples to use. The seed selects them."""
    concepts: ConceptSettings = ConceptSettings()
    """The architecture of the perception."""
    weights: str | None = None
    """For `perception: features`, the file of the backbone's weights. A path is relative to the working directory. By
    default torchvision's cache has the file."""
    reasoner: Literal["gnn", "nlm", "rules"] = "gnn"
    """A graph network (`gnn`) or a Neural Logic Machine (`nlm`), for the stages `reasoning`, `end-to-end` and
    `bilevel`; or the rules of the mode (`rules`), for the stage `end-to-end`, so that concepts are learned from actions
    through them."""
    groundings: Literal["predicted", "exact"] = "predicted"
    """The truth values on which a reasoner is trained and tested, or from which rules are learned."""
    training: TrainingSettings = TrainingSettings()
    """The hyperparameters of training."""
    bilevel: BilevelSettings | None = None
    """The hyperparameters of the stage `bilevel`. Other stages have none."""

    @model_validator(mode="before")
    @classmethod
    def _with_bilevel(cls, given: Any) -> Any:
        """Write out the defaults of the stage `bilevel`."""
        if isinstance(given, Mapping) and given.get("stage") == "bilevel" and given.get("bilevel") is None:
            return {**given, "bilevel": {}}
        return given

    @model_serializer(mode="wrap")
    def _short(self, serialized: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the hyperparameters of another stage, as cells and published rows do."""
        values: dict[str, Any] = serialized(self)
        return {name: value for name, value in values.items() if name != "bilevel" or value is not None}

    @model_validator(mode="after")
    def _consistent(self) -> VapSettings:
        stage, exact, features = self.stage, self.groundings == "exact", self.concepts.perception == "features"
        if self.bilevel is not None and stage != "bilevel":
            raise _fault("bilevel", "`bilevel` has hyperparameters of the stage `bilevel`")
        if exact and stage in ("concepts", "end-to-end", "bilevel"):
            fault = f"`groundings: exact` cannot be combined with the stage `{stage}`, which predicts the concepts"
            raise _fault("groundings", fault)
        if not exact and stage == "bound":
            raise _fault("stage", "the stage `bound` needs `groundings: exact`")
        if self.reasoner == "rules" and stage != "end-to-end":
            raise _fault("reasoner", "the reasoner `rules` has nothing to train: use the stage `end-to-end`")
        if self.weights is not None and not features:
            raise _fault("weights", "`weights` are those of a backbone: they need `concepts.perception: features`")
        if features and self.concepts.features != (count := Backbone.shape[0]):
            fault = f"the backbone has {count} features: `concepts.features` cannot change this"
            raise _fault("concepts.features", fault)
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
        kinds: dict[str, Kind] = {"crops": "crops", "features": "resnet50"}
        return kinds.get(self.concepts.perception)

    @property
    def weights_hash(self) -> str | None:
        """The SHA-256 of the backbone's weights, or `None` without a backbone."""
        return _weights_file_hash(weights_file(self.weights)) if self.kind == "resnet50" else None


def _fault(key: str, message: str) -> PydanticCustomError:
    """Return the error of a setting. Errors of a whole model have no path, so the context has the key."""
    return PydanticCustomError("custom", "{message}", {"message": message, "key": key})


_weights_file_hash = cache(weights_file_hash)


def rules_hash(mode: str) -> str:
    """Return the SHA-256 of the configuration of a mode and its rules."""
    return files_hash(f"configs/vap-{mode}.yaml")


@dataclass
class VapWork:
    """The inputs of a training, its folder, which has the model to start from in `start.pt`, and that for data sets.

    The seed is that of the weights and of the training. `report` receives the number of finished epochs.
    """

    mode: Literal["easy", "hard"]
    seed: int
    settings: VapSettings
    folder: Path
    data: Path
    report: Callable[[int], None] = lambda epochs: None

    def samples(self, split: Literal["train", "val", "test"]) -> Samples:
        """Return the samples of a split, made if they do not exist."""
        settings, difficulty = self.settings, self.settings.difficulty
        if split == "test" and settings.test_difficulty is not None:
            difficulty = settings.test_difficulty
        spec = DataSpec(
            mode=self.mode,
            split=split,
            agents="fixed" if split == "test" else settings.agents,
            worlds=getattr(settings.worlds, split),
            difficulty=difficulty,
            drawing_version=settings.drawing_version,
            seed=settings.data_seed,
            kind=settings.kind,
            weights=settings.weights,
        )
        tables, features = prepared(spec, self.data, f"{__version__} {rules_hash(self.mode)}")
        samples = Samples.load(tables, {} if features is None else {settings.concepts.perception: features})
        return samples.subset(settings.fraction, self.seed) if split == "train" and settings.fraction < 1 else samples

    def rules(self) -> Program:
        """Return the rules of the mode."""
        return Program.load(f"rules/vap-{self.mode}.dl")

    def part(self, name: str, model: Mapping[str, Any]) -> torch.nn.Module:
        """Return `concepts` or `reasoner` with the weights in a model. An empty model gives random ones of the seed."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            settings = self.settings
            if name == "concepts":
                part: torch.nn.Module = ConceptModel(settings.concepts)
            else:
                part = make_reasoner(settings.reasoner, self.rules())
        if not model:
            return part
        if name not in model:
            raise ValueError(f"the model to start from has no part `{name}`: start from a row that trains it")
        try:
            part.load_state_dict(model[name])
        except RuntimeError:
            raise ValueError(
                f"the part `{name}` of the model to start from has another architecture: give both rows the same "
                "`concepts` and `reasoner`"
            ) from None
        return part

    def started(self) -> dict[str, Any]:
        """Return the model that the training starts from, or an empty one."""
        path = self.folder / "start.pt"
        return read_tensors(path, "a model") if path.exists() else {}


#: The model and its training history.
Trained = tuple[dict[str, Any], list[dict[str, float]]]


def train_stage(work: VapWork) -> Trained:
    """Train the model of the stage that the settings name, or resume from the checkpoint.

    Raises `ValueError` if the model to start from does not fit.
    """
    model, history = {"induction": _induce, "bound": _bound}.get(work.settings.stage, _train)(work)
    if not history:
        work.report(1)
    return model, history


def measure(work: VapWork, model: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the measures of each predictor on the test worlds, and the recalls of concepts that were trained.

    `model` is the content of `model.pt`.
    """
    stage, test = work.settings.stage, work.samples("test")
    unary, binary = _groundings(work, model, test)
    if stage == "concepts":
        actions = _by_rules(work.rules(), unary, binary, test)
    elif stage == "induction":
        actions = _by_rules(Program(model["rules"]), unary, binary, test)
    elif stage == "bound":
        shown = torch.tensor([name not in model["absent"] for name in UNARY])
        degrees = rule_degrees(work.rules(), "godel", unary * shown, binary, test.facts["valid"])
        actions = {"": degrees.argmax(-1)}
    else:
        actions = {"": predict_actions(work.part("reasoner", model), unary, binary, test.facts["valid"])}
    # Rules name their concepts, so the measures show which ones actions teach; the concepts of networks have no names.
    named = stage == "concepts" or (stage == "end-to-end" and work.settings.reasoner == "rules")
    concepts = concept_measures(unary, binary, test) if named else {}
    return {name: evaluation(predicted, test) for name, predicted in actions.items()}, concepts


def evaluation(predicted: Tensor, samples: Samples) -> dict[str, Any]:
    """Return the measures of predicted actions, int64 (B, N): the paper's, and for each world what intervals need."""
    cars = samples.facts["mask"].numpy()
    actual, chosen = samples.facts["actions"].numpy(), predicted.numpy()
    frames = np.broadcast_to(np.arange(len(cars))[:, None], cars.shape)
    metrics = vap_metrics(actual[cars], chosen[cars], frames[cars])
    worlds = []
    of_frame = samples.facts["world"].numpy()
    hits = (actual == chosen) & cars
    share = hits.sum(1) / np.maximum(cars.sum(1), 1)
    for world in np.unique(of_frame):
        own = of_frame == world
        with_cars = own & cars.any(1)
        worlds.append(
            {
                "world": int(world),
                "frames": int(with_cars.sum()),
                "a_acc": round(float(share[with_cars].sum()), 6),
                "counts": np.bincount(actual[own][cars[own]], minlength=len(ACTIONS)).tolist(),
                "correct": np.bincount(actual[own][hits[own]], minlength=len(ACTIONS)).tolist(),
            }
        )
    return {"recall": dict(metrics.recall), "a_acc": metrics.a_acc, "w_acc": metrics.w_acc, "worlds": worlds}


def _by_rules(rules: Program, unary: Tensor, binary: Tensor, samples: Samples) -> dict[str, Tensor]:
    """Return the actions of the rules on thresholded facts, and on probabilities."""
    valid = samples.facts["valid"]
    facts = ((unary > 0.5).float(), (binary > 0.5).float())
    return {
        "threshold": rule_degrees(rules, "godel", *facts, valid).argmax(-1),
        "product": rule_degrees(rules, "product", unary, binary, valid).argmax(-1),
    }


def _groundings(work: VapWork, model: dict[str, Any], samples: Samples) -> tuple[Tensor, Tensor]:
    """Return the true groundings, or those that the concept model predicts from which the training starts."""
    if work.settings.groundings == "exact":
        return samples.facts["unary"].float(), samples.relations.float()
    if "concepts" not in model:
        raise ValueError(NO_CONCEPTS)
    return groundings(work.part("concepts", model), samples)


def _train(work: VapWork) -> Trained:
    """Train the parts of a stage. The stage `reasoning` trains on given concepts, which stay as they are.

    The best epoch is that with the largest mean recall over the actions that occur in the validation samples.
    """
    train, val, start = work.samples("train"), work.samples("val"), work.started()
    stage, settings = work.settings.stage, work.settings.training
    names = {"concepts": ["concepts"], "reasoning": ["reasoner"]}.get(stage, ["concepts", "reasoner"])
    # The stage `reasoning` may start from a model that has only concepts.
    parts = {name: work.part(name, start if stage != "reasoning" or name in start else {}) for name in names}
    kept, count = {}, len(train)
    if stage == "concepts":
        rules, loss = work.rules(), concept_loss(parts["concepts"], train, settings.class_power)
    elif stage == "reasoning":
        kept = {name: start[name] for name in start if name == "concepts"}
        of_train, of_val = (_groundings(work, start, samples) for samples in (train, val))
        loss = reasoning_loss(parts["reasoner"], *of_train, train, settings.class_power)
    elif work.settings.bilevel is not None:
        bilevel = work.settings.bilevel
        lower, upper = train.split(bilevel.held_out, work.seed)
        loss = bilevel_loss(parts["concepts"], parts["reasoner"], lower, upper, bilevel, settings.class_power)
        count = len(lower)
    else:
        loss = end_to_end_loss(parts["concepts"], parts["reasoner"], train, settings.class_power)

    def score() -> float:
        facts = of_val if stage == "reasoning" else groundings(parts["concepts"], val)
        if stage == "concepts":
            predicted = _by_rules(rules, *facts, val)["threshold"]
        else:
            predicted = predict_actions(parts["reasoner"], *facts, val.facts["valid"])
        return float(np.mean(list(evaluation(predicted, val)["recall"].values())))

    network = torch.nn.ModuleDict(parts) if len(parts) > 1 else parts[names[0]]
    history = fit(network, loss, count, settings, work.seed, score, work.folder / "checkpoint.pt", work.report)
    return {**kept, **{name: part.state_dict() for name, part in parts.items()}}, history


def _induce(work: VapWork) -> Trained:
    """Learn rules from thresholded concepts and actions, with wrong examples."""
    start, train = work.started(), work.samples("train")
    unary, binary = _groundings(work, start, train)
    scenes, learned = work.folder / "scenes.jsonl", work.folder / "learned.dl"
    with open(scenes, "w", encoding="utf-8", newline="\n") as out:
        out.writelines(f"{json.dumps(scene)}\n" for scene in scenes_of(unary > 0.5, binary > 0.5, train))
    options = ["--config", f"configs/vap-{work.mode}.yaml", "--noise", "auto", "--threads", "1", "--force"]
    command = ["induce", str(scenes), *options, "--seed", str(work.seed), "-o", str(learned)]
    code, _, _ = _logicity.run_command_line(command)
    if code:
        raise ValueError(f"`logicity {' '.join(command)}` failed")
    scenes.unlink()
    kept = {"concepts": start["concepts"]} if "concepts" in start else {}
    return {**kept, "rules": learned.read_text(encoding="utf-8")}, []


def _bound(work: VapWork) -> Trained:
    """Find the unary predicates that hold for no agent of the training samples."""
    shown = work.samples("train").facts["unary"].flatten(0, 1).any(0)
    return {"absent": [name for name, each in zip(UNARY, shown.tolist(), strict=True) if not each]}, []


def scenes_of(unary: Tensor, binary: Tensor, samples: Samples) -> Iterator[dict[str, Any]]:
    """Yield a labeled scene for each car: the entities in its view, their facts, and its action in the samples.

    The facts are bool (B, N, 11) of `UNARY`, and bool (B, N, N, 7) of `RELATIONS`.
    """
    truths, pairs = unary.numpy(), binary.numpy()
    valid, actions = samples.facts["valid"].numpy(), samples.facts["actions"].numpy()
    for frame, car in np.argwhere(samples.facts["mask"].numpy()).tolist():
        others = np.flatnonzero(valid[frame] & pairs[frame, car, :, RELATIONS.index("Sees")]).tolist()
        seen = [car, *(other for other in others if other != car)]
        yield {
            "entities": [f"e{entity}" for entity in seen],
            "ego": f"e{car}",
            "facts": facts_of(truths[frame], pairs[frame], seen),
            "actions": {f"e{car}": ACTIONS[actions[frame, car]]},
        }


def facts_of(unary: np.ndarray[Any, Any], binary: np.ndarray[Any, Any], seen: Sequence[int]) -> dict[str, list[Any]]:
    """Return the facts of the entities in the view of one of them, as scenes have them.

    The facts of a sample are bool (N, 11) of `UNARY`, and bool (N, N, 7) of `RELATIONS`. `seen` has the numbers of the
    entities, each once, beginning with the viewer. Entity i has the name `ei`. `Sees` has only the pairs of the viewer
    with each of the entities, itself included, whatever `binary` has.
    """
    chosen = np.array(seen, np.int64)
    # An entity has no relation to itself, but a model can predict one.
    apart = ~np.eye(len(chosen), dtype=bool)
    pairs = binary[np.ix_(chosen, chosen)][..., : len(BINARY)] & apart[..., None]
    sees = np.zeros_like(apart)
    sees[0] = True
    return symbolic_facts([f"e{entity}" for entity in seen], unary[chosen], pairs, sees)
