"""Training of the models of Visual Action Prediction. Needs the extra `vap`.

`fit` trains for a number of epochs or updates and writes checkpoints. An interrupted run continues from its last
checkpoint, and ends with the same weights as an uninterrupted one. The order of samples and every random number of an
epoch follow from the seed and the number of the epoch.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..city import ACTIONS
from ..errors import extra
from ..files import read_tensors
from ..terminal import first_line
from .data import UNARY, VapDataset

with extra("vap"):
    import torch
    from pydantic import SerializerFunctionWrapHandler, model_serializer, model_validator
    from pydantic_core import PydanticCustomError
    from torch import Tensor, nn
    from torch.func import functional_call

from ..learn.settings import Count, LearningRate, NonNegative, Share, StrictModel
from ..learn.storage import restore_optimizer
from .bilevel import BilevelSettings, surrogate
from .concepts import RELATIONS, ConceptModel, pairs_of
from .loader import as_tensors, padded_batch
from .reasoners import GraphReasoner

__all__ = ["Samples", "TrainingSettings", "concept_loss", "end_to_end_loss", "fit", "groundings", "predict_actions"]

#: The number of samples that models predict at once.
BATCH = 64

#: The loss of some samples, a scalar. Its arguments are their positions, int64 (B,), and a generator of random numbers,
#: which chooses how crops are turned and mirrored.
Loss: TypeAlias = Callable[[Tensor, torch.Generator], Tensor]


class TrainingSettings(StrictModel):
    """The hyperparameters of training."""

    epochs: Count = 10
    """The number of passes over the samples. After each, the model is validated; the best one is kept."""
    steps: Count | None = None
    """The number of updates, however many samples there are, in `epochs` equal parts instead of passes. By default that
    of the passes."""
    batch: Count = 16
    """The number of pictures of an update."""
    learning_rate: LearningRate = 1e-3
    """The learning rate, which falls to 0 along a half cosine."""
    optimizer: Literal["adam", "adamw"] = "adam"
    """Adam, or AdamW with decoupled weight decay."""
    weight_decay: NonNegative = 0.01
    """The weight decay of `adamw`."""
    class_power: Share = 0.5
    """The exponent p of the class weights. An action with n examples has a weight proportional to n^-p. A true atom of
    a predicate has the weight (false atoms / true atoms)^p, with the ratio limited to 1 to 10,000, and a false atom the
    weight 1. With 0, all examples weigh alike."""

    @model_validator(mode="after")
    def _enough(self) -> TrainingSettings:
        if self.steps is not None and self.steps < self.epochs:
            fault = f"{self.steps} steps have no {self.epochs} parts: set `steps` to at least `epochs`"
            raise PydanticCustomError("custom", "{message}", {"message": fault, "key": "training.steps"})
        return self

    @model_serializer(mode="wrap")
    def _short(self, serialized: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the steps by default, as cells and published rows do."""
        values: dict[str, Any] = serialized(self)
        return {name: value for name, value in values.items() if name != "steps" or value is not None}

    def updates(self, epoch: int, count: int) -> int:
        """Return the number of updates before an epoch, for a number of samples."""
        if self.steps is None:
            return epoch * -(-count // self.batch)
        return self.steps * epoch // self.epochs


@dataclass
class Samples:
    """All samples of a data set in memory.

    Attributes:
        facts: Tensors in the format of `collate`, without names and concepts.
        inputs: What the appearance part sees of the E entities, in the order of samples and entities: `crops` uint8
            (E, side, side, 3) or `features` float (E, F). Empty for models that see only the sides of boxes.

    Raises:
        ValueError: If the inputs are not those of E entities.
    """

    facts: dict[str, Tensor]
    inputs: dict[str, Tensor] = field(default_factory=dict)

    @classmethod
    def load(cls, samples: VapDataset, inputs: dict[str, Tensor] | None = None) -> Samples:
        """Read the tables of a data set."""
        facts = padded_batch([as_tensors(samples.facts(at)) for at in range(len(samples))])
        return cls({name: each for name, each in facts.items() if isinstance(each, Tensor)}, inputs or {})

    def __post_init__(self) -> None:
        """Count the entities."""
        counts = self.facts["valid"].sum(1)
        self._starts = counts.cumsum(0) - counts
        entities = int(counts.sum())
        for name, values in self.inputs.items():
            if len(values) != entities:
                raise ValueError(f"{len(values)} {name} do not fit {entities} entities")

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.facts["valid"])

    @property
    def relations(self) -> Tensor:
        """The truth values of `RELATIONS`, bool (B, N, N, 7)."""
        return torch.cat([self.facts["binary"], self.facts["sees"][..., None]], -1)

    def batch(self, chosen: Tensor) -> dict[str, Tensor]:
        """Return the facts of the samples at B positions, int64 (B,), and the inputs of their valid entities."""
        batch = {name: values[chosen] for name, values in self.facts.items()}
        if self.inputs:
            # The valid entities of a sample come first.
            places = (self._starts[chosen][:, None] + torch.arange(batch["valid"].shape[1]))[batch["valid"]]
            batch |= {name: values[places] for name, values in self.inputs.items()}
        return batch

    def subset(self, fraction: float, seed: int) -> Samples:
        """Return a random part of the samples, in their order.

        `fraction` is above 0 and at most 1; at least one sample stays. The seed determines the part.
        """
        count = max(1, round(fraction * len(self)))
        order = torch.randperm(len(self), generator=torch.Generator().manual_seed(seed))
        chosen = order[:count].sort().values
        return self.part(chosen)

    def split(self, share: float, seed: int) -> tuple[Samples, Samples]:
        """Return two random parts, in their order, of which the second has the share, and each at least one sample.

        Raises:
            ValueError: If there are fewer than two samples.
        """
        if len(self) < 2:
            raise ValueError("one sample cannot be split")
        count = min(max(1, round(share * len(self))), len(self) - 1)
        order = torch.randperm(len(self), generator=torch.Generator().manual_seed(seed))
        return self.part(order[count:].sort().values), self.part(order[:count].sort().values)

    def part(self, chosen: Tensor) -> Samples:
        """Return the samples at B positions, int64 (B,)."""
        batch = self.batch(chosen)
        return Samples(*({name: batch[name] for name in names} for names in (self.facts, self.inputs)))


def concept_weights(samples: Samples, power: float) -> tuple[Tensor, Tensor]:
    """Return the weights of true atoms, float (11,) and (7,), see `TrainingSettings.class_power`.

    A predicate without true atoms has the weight 1.
    """
    valid = samples.facts["valid"]
    weights = []
    for truths in (samples.facts["unary"][valid], samples.relations[pairs_of(valid)]):
        true = truths.sum(0).double()
        false = len(truths) - true
        weights.append(torch.where(true > 0, (false / true.clamp(min=1)).clamp(1, 1e4) ** power, 1.0).float())
    return weights[0], weights[1]


def action_weights(actions: Tensor, power: float) -> Tensor:
    """Return the weights of actions, float (4,), with the mean 1 over the examples, int64 (M,).

    Actions without examples have the weight 0. `power` is `TrainingSettings.class_power`.
    """
    counts = torch.bincount(actions, minlength=len(ACTIONS)).double()
    weights = torch.where(counts > 0, counts.clamp(min=1) ** -power, 0.0)
    return (weights * counts.sum() / (weights * counts).sum()).float()


def concept_loss(model: ConceptModel, samples: Samples, power: float) -> Loss:
    """Return the loss of concepts: the means of the weighted binary cross entropy over unary and binary atoms, added.

    The weights are those of `concept_weights`.
    """
    unary_weights, binary_weights = concept_weights(samples, power)

    def loss(chosen: Tensor, generator: torch.Generator) -> Tensor:
        batch = _augmented(samples.batch(chosen), generator)
        unary, binary = model(batch)
        valid, pairs = batch["valid"], pairs_of(batch["valid"])
        truths = torch.cat([batch["binary"], batch["sees"][..., None]], -1)
        cross_entropy = nn.functional.binary_cross_entropy_with_logits
        of_unary = cross_entropy(unary[valid], batch["unary"][valid].float(), pos_weight=unary_weights)
        return of_unary + cross_entropy(binary[pairs], truths[pairs].float(), pos_weight=binary_weights)

    return loss


def reasoning_loss(reasoner: nn.Module, unary: Tensor, binary: Tensor, samples: Samples, power: float) -> Loss:
    """Return the loss of a reasoner: the mean cross entropy of the actions of cars, weighted by `action_weights`.

    Its arguments are the groundings of all samples, see `make_reasoner`.
    """

    def logits(chosen: Tensor, generator: torch.Generator) -> Tensor:
        return reasoner(unary[chosen], binary[chosen], samples.facts["valid"][chosen])

    return _action_loss(logits, samples, power)


def end_to_end_loss(concepts: ConceptModel, reasoner: nn.Module, samples: Samples, power: float) -> Loss:
    """Variant of `reasoning_loss` on the predictions of a concept model, which is trained as well."""

    def logits(chosen: Tensor, generator: torch.Generator) -> Tensor:
        batch = _augmented(samples.batch(chosen), generator)
        unary, binary = concepts(batch)
        return reasoner(torch.sigmoid(unary), torch.sigmoid(binary), batch["valid"])

    return _action_loss(logits, samples, power)


def bilevel_loss(
    concepts: ConceptModel,
    reasoner: nn.Module,
    samples: Samples,
    held_out: Samples,
    settings: BilevelSettings,
    power: float,
) -> Loss:
    """Return the loss of bilevel training, see `logicity.vap.bilevel`.

    The lower level fits the reasoner to the predicted concepts of some samples, and its weights become the fitted ones.
    The loss is that of the fitted reasoner on as many held-out samples, drawn at random, and trains the concepts.
    """
    lower, upper = _Level(concepts, reasoner, samples, power), _Level(concepts, reasoner, held_out, power)

    def loss(chosen: Tensor, generator: torch.Generator) -> Tensor:
        others = torch.randperm(len(held_out), generator=generator)[: len(chosen)]
        inputs = lower.predicted(chosen, generator), upper.predicted(others, generator)
        return surrogate(lower.objective(chosen), upper.objective(others), inputs, reasoner, settings)

    return loss


@dataclass(frozen=True)
class _Level:
    """A level of bilevel training: the samples of its loss."""

    concepts: ConceptModel
    reasoner: nn.Module
    samples: Samples
    power: float

    def predicted(self, chosen: Tensor, generator: torch.Generator) -> list[Tensor]:
        """Return the groundings of the samples at some positions."""
        return [torch.sigmoid(each) for each in self.concepts(_augmented(self.samples.batch(chosen), generator))]

    def objective(self, chosen: Tensor) -> Callable[[Mapping[str, Tensor], Sequence[Tensor]], Tensor]:
        """Return the loss of weights of the reasoner, for the groundings of the samples at these positions."""
        valid, weighted = self.samples.facts["valid"][chosen], _weighted(self.samples, self.power)
        return lambda weights, inputs: weighted(functional_call(self.reasoner, dict(weights), (*inputs, valid)), chosen)


def _action_loss(logits: Callable[[Tensor, torch.Generator], Tensor], samples: Samples, power: float) -> Loss:
    """Return the weighted cross entropy of the actions of cars, 0 if there are none, from a function to logits."""
    weighted = _weighted(samples, power)
    return lambda chosen, generator: weighted(logits(chosen, generator), chosen)


def _weighted(samples: Samples, power: float) -> Callable[[Tensor, Tensor], Tensor]:
    """Return the loss of logits for the samples at some positions."""
    facts = samples.facts
    weights = action_weights(facts["actions"][facts["mask"]], power)

    def loss(logits: Tensor, chosen: Tensor) -> Tensor:
        cars = facts["mask"][chosen]
        actions = facts["actions"][chosen][cars]
        each = nn.functional.cross_entropy(logits[cars], actions, weights, reduction="sum")
        return each / weights[actions].sum().clamp(min=1e-6)

    return loss


def _augmented(batch: dict[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Turn and mirror all crops of a batch alike: an agent looks the same from all sides."""
    if "crops" not in batch:
        return batch
    turn, mirrored = torch.randint(4, (), generator=generator), torch.randint(2, (), generator=generator)
    crops = torch.rot90(batch["crops"], int(turn), (1, 2))
    return {**batch, "crops": crops.flip(2) if mirrored else crops}


def fit(
    network: nn.Module,
    loss: Loss,
    count: int,
    settings: TrainingSettings,
    seed: int,
    score: Callable[[], float],
    checkpoint: Path | None = None,
    report: Callable[[int], None] = lambda epochs: None,
) -> list[dict[str, float]]:
    """Train a network, and keep the weights of the epoch with the best score. Return the measures of each epoch.

    These are `loss`, `score` and `cpu_seconds`. `count` is the number of samples. `score` returns the score of the
    current weights on the validation samples; larger is better. `checkpoint` is a file from which to resume, and to
    which to write after each epoch. `report` receives the number of finished epochs.

    Raises:
        OSError: If the checkpoint cannot be read.
        ValueError: If it is not one of this training.
    """
    if settings.optimizer == "adamw":
        optimizer = torch.optim.AdamW(network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay)
    else:
        optimizer = torch.optim.Adam(network.parameters(), settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.updates(settings.epochs, count))
    parts = {"network": network, "optimizer": optimizer, "schedule": schedule}
    history: list[dict[str, float]] = []
    best = deepcopy(network.state_dict())
    if checkpoint is not None and checkpoint.exists():
        saved = read_tensors(checkpoint, "a checkpoint")
        try:
            # Loads the best weights only to check their names and shapes.
            for weights in ("best", "network"):
                network.load_state_dict(saved[weights])
            restore_optimizer(optimizer, saved["optimizer"])
            if _constants(saved["schedule"]) != _constants(schedule.state_dict()):
                raise ValueError("its learning rate follows another schedule")
            schedule.load_state_dict(saved["schedule"])
            best = saved["best"]
            names = ("loss", "score", "cpu_seconds")
            history = [{name: float(epoch[name]) for name in names} for epoch in saved["history"]]
            done = len(history)
            if not 0 < done <= settings.epochs or schedule.last_epoch != settings.updates(done, count):
                raise ValueError("the number of epochs does not fit")
        except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
            reason = first_line(str(error), repr(error))
            raise ValueError(
                f"{checkpoint} is not a checkpoint of this training: {reason}; remove it to train from the beginning"
            ) from None
    for epoch in range(len(history), settings.epochs):
        generator = torch.Generator().manual_seed(seed * 100_003 + epoch)
        torch.manual_seed(seed * 100_003 + epoch)
        begun = time.process_time()
        order: list[Tensor] = []
        network.train()
        total, seen = 0.0, 0
        for _ in range(settings.updates(epoch, count), settings.updates(epoch + 1, count)):
            if not order:
                order = list(torch.randperm(count, generator=generator).split(settings.batch))
            chosen = order.pop(0)
            value = loss(chosen, generator)
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
            schedule.step()
            total += float(value.detach()) * len(chosen)
            seen += len(chosen)
        network.eval()
        with torch.no_grad():
            reached = score()
        if not history or reached >= max(each["score"] for each in history):
            best = deepcopy(network.state_dict())
        history.append({"loss": total / seen, "score": reached, "cpu_seconds": time.process_time() - begun})
        if checkpoint is not None:
            states = {name: part.state_dict() for name, part in parts.items()}
            save({**states, "history": history, "best": best}, checkpoint)
        report(epoch + 1)
    network.load_state_dict(best)
    network.eval()
    return history


def _constants(schedule: dict[str, Any]) -> dict[str, Any]:
    """Return what does not change in the state of a schedule, and the types of the rest."""
    constants = ("T_max", "base_lrs", "eta_min")
    return {name: value if name in constants else type(value) for name, value in schedule.items()}


def save(state: dict[str, Any], path: Path) -> None:
    """Write a state to a file, which is replaced only when it is complete."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    torch.save(state, temporary)
    temporary.replace(path)


def groundings(model: ConceptModel, samples: Samples) -> tuple[Tensor, Tensor]:
    """Return the probabilities of all atoms that a model predicts. Sets the model to evaluation mode.

    They are float (S, N, 11) and (S, N, N, 7) for S samples, in the orders of `UNARY` and `RELATIONS`.
    """
    model.eval()
    with torch.no_grad():
        batches = (samples.batch(chosen) for chosen in torch.arange(len(samples)).split(BATCH))
        parts = [[torch.sigmoid(logits) for logits in model(batch)] for batch in batches]
    unary, binary = zip(*parts, strict=True)
    return torch.cat(unary), torch.cat(binary)


def predict_actions(reasoner: nn.Module, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
    """Return the actions of all entities that a reasoner predicts. Sets the reasoner to evaluation mode.

    The other arguments are those of the reasoner, see `make_reasoner`. The actions are int64 (S, N), indices into
    `ACTIONS`. Those of pedestrians and of absent entities have no meaning.
    """
    reasoner.eval()
    with torch.no_grad():
        parts = [
            reasoner(unary[chosen], binary[chosen], valid[chosen]).argmax(-1)
            for chosen in torch.arange(len(valid)).split(BATCH)
        ]
    return torch.cat(parts)


def concept_measures(unary: Tensor, binary: Tensor, samples: Samples) -> dict[str, dict[str, float | None]]:
    """Return `recall` and `precision` at the threshold 0.5, and `count`, the number of true atoms, by predicate.

    As in the paper, the pairs of a binary predicate are those whose first entity sees the second. `CollidingClose
    (cars)` has only the pairs whose first entity is a car: that of a pedestrian is drawn at random. A ratio without
    atoms is `None`. The predicted probabilities are those of `groundings`.
    """
    facts, relations = samples.facts, samples.relations
    valid, sees = facts["valid"], facts["sees"]
    result = {name: _measures(unary[..., at], facts["unary"][..., at], valid) for at, name in enumerate(UNARY)}
    for at, name in enumerate(RELATIONS):
        predicted, truth = binary[..., at], relations[..., at]
        result[name] = _measures(predicted, truth, pairs_of(valid) if name == "Sees" else sees)
        if name == "CollidingClose":
            result[f"{name} (cars)"] = _measures(predicted, truth, facts["mask"][:, :, None] & sees)
    return result


def _measures(probabilities: Tensor, truth: Tensor, chosen: Tensor) -> dict[str, float | None]:
    predicted, truth = probabilities[chosen] > 0.5, truth[chosen]
    hits, true, positive = int((predicted & truth).sum()), int(truth.sum()), int(predicted.sum())
    precision = hits / positive if positive else None
    return {"recall": hits / true if true else None, "precision": precision, "count": true}


def train_on_facts(
    train: VapDataset, test: VapDataset, seed: int, epochs: int, progress: Callable[[int], None]
) -> NDArray[np.int64]:
    """Train a graph network on the facts of a data set with cars, and predict the actions of the cars in another.

    `progress` receives the number of finished epochs. The actions are int64 (M,) for the M cars in all samples.
    """
    facts, queries = Samples.load(train), Samples.load(test)
    settings = TrainingSettings(epochs=epochs, batch=64, learning_rate=3e-3, optimizer="adamw", class_power=0.0)
    threads = torch.get_num_threads()
    # The tensors are so small that synchronizing several threads costs more than it saves.
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            reasoner = GraphReasoner(width=64)
            inputs = [(each.facts["unary"].float(), each.relations.float()) for each in (facts, queries)]
            loss = reasoning_loss(reasoner, *inputs[0], facts, settings.class_power)
            # Without validation, the last epoch counts.
            fit(reasoner, loss, len(facts), settings, seed, lambda: 0.0, report=progress)
        predicted = predict_actions(reasoner, *inputs[1], queries.facts["valid"])
    finally:
        torch.set_num_threads(threads)
    chosen: NDArray[np.int64] = predicted[queries.facts["mask"]].numpy()
    return chosen
