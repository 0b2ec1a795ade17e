"""Probabilities of clauses from demonstrations: rules that fit drivers who do not always follow them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from ..city import ACTIONS
from ..envs.layout import Layout
from ..errors import as_integer, extra
from ..files import write_text
from ..offline import Demonstrations, Trajectory
from ..rules import Program
from .layer import DEFAULT, PRIORITY, RuleLayer
from .source import DIGITS, labels_of, written_as_one

with extra("learn"):
    import torch
    from torch import Tensor

__all__ = ["WeightedRules", "learn_weights"]

#: The predicate that relates entities in view.
SCOPE = "Sees"


@dataclass(frozen=True, eq=False)
class WeightedRules:
    """Rules whose clauses have learned probabilities.

    Attributes:
        text: The rules as one file, with the probabilities as in `0.82 :: Stop(X) :- ...`. The simulator runs it.
        weights: The probability of each clause, by its label. A clause that never applies in the demonstrations, or has
            a probability in the given rules, has none.
        slip: The probability that a driver takes an action at random, of all actions with equal probability.
        crisp_slip: The same for the given rules, without learned probabilities.
        steps: The number of demonstrated steps.
    """

    text: str
    weights: Mapping[str, float]
    slip: float
    crisp_slip: float
    steps: int
    _soft: RuleLayer
    _crisp: RuleLayer

    def __repr__(self) -> str:
        """Show the number of clauses and steps."""
        return f"<WeightedRules: {len(self.weights)} weights from {self.steps} steps>"

    @property
    def program(self) -> Program:
        """The rules as a program."""
        return Program(self.text)

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write `text` to a file. `overwrite` also replaces a file that this method did not write.

        Raises:
            OSError: If the file cannot be written, or must not be replaced.
        """
        write_text(path, self.text, by="learn_weights", overwrite=overwrite)

    def log_likelihood(self, demonstrations: Demonstrations, *, crisp: bool = False) -> float:
        """Return the mean logarithm of the probabilities of the demonstrated actions, in nats per step.

        Args:
            demonstrations: Demonstrations with the same predicates; use held-out ones for a fair figure.
            crisp: Whether to score the given rules, with `crisp_slip`, instead of the learned ones.

        Raises:
            ValueError: As for `learn_weights`.
        """
        layer, slip = (self._crisp, self.crisp_slip) if crisp else (self._soft, self.slip)
        examples = _Examples.of(demonstrations, layer)
        with torch.no_grad():
            return float(examples.log_likelihood(layer, torch.tensor(slip, dtype=torch.float64)))


def learn_weights(
    rules: str | os.PathLike[str] | Program,
    demonstrations: Demonstrations,
    *,
    priority: Sequence[str] = PRIORITY,
    default: str = DEFAULT,
    iterations: int = 300,
    learning_rate: float = 0.1,
    progress: Callable[[int, float], None] | None = None,
) -> WeightedRules:
    """Learn a probability for each clause that maximizes the likelihood of the demonstrated actions.

    The probabilities are those of the file format: a clause derives its head for each combination of values with its
    probability, independently. Likelihoods are exact. `slip`, the probability of a random action, is fitted too, so
    that every action has a positive probability. The method is gradient ascent on the logits by Adam over all
    demonstrations. It has no random choices.

    Args:
        rules: A rule file, or a program.
        demonstrations: Steps of drivers, with observations of the kind `groundings`. Their first entity is the driver.
        priority: As for `RuleLayer`.
        default: As for `RuleLayer`.
        iterations: The number of updates.
        learning_rate: That of Adam.
        progress: Called after each update with its number, from 1, and the mean log-likelihood before it.

    Raises:
        InputError: If the rules are invalid.
        OSError: If the file cannot be read.
        ValueError: As for `RuleLayer`. Or if the demonstrations have no steps, take an action that the rules lack, lack
            a predicate that the rules read, have quantities, or are not of the kind `groundings`. Or if `iterations` or
            `learning_rate` is out of range. Or if no clause is left to weigh, or a file cannot give one a probability:
            it has several heads or alternatives, an inline predicate, or variables without names.
        TypeError: If an argument has another type.
    """
    if as_integer("iterations", iterations) < 1:
        raise ValueError(f"iterations: expected at least 1, not {iterations}")
    if not (learning_rate > 0 and math.isfinite(learning_rate)):
        raise ValueError(f"learning_rate: expected a positive number, not {learning_rate}")
    soft, crisp = (
        RuleLayer(rules, "exact", priority=priority, default=default, learn_weights=learn).double()
        for learn in (True, False)
    )
    examples = _Examples.of(demonstrations, soft)
    logits = cast("torch.nn.Parameter", soft.weight_logits)
    slip_logit = torch.nn.Parameter(torch.tensor(-3.0, dtype=torch.float64))
    given = {clause.number for clause in soft._rules.written if clause.drawn}
    examples.log_likelihood(soft, slip_logit.sigmoid()).backward()
    # Clauses that never apply keep the weight 1, as do those with a probability of their own.
    unused = cast(Tensor, logits.grad) == 0
    fixed = [number for number in range(len(logits)) if number in given or bool(unused[number])]
    labels = labels_of(soft._rules.written, [number for number in range(len(logits)) if number not in fixed])
    if not labels:
        raise ValueError("rules: no clause without a probability applies in the demonstrations: there is none to weigh")
    # Fails now if a file cannot have the probabilities.
    written_as_one(soft, dict.fromkeys(labels, 0.5))
    logits.data[fixed] = math.inf
    optimizer = torch.optim.Adam([logits, slip_logit], lr=learning_rate)
    for iteration in range(iterations):
        optimizer.zero_grad()
        likelihood = examples.log_likelihood(soft, slip_logit.sigmoid())
        (-likelihood).backward()
        logits.grad = torch.where(torch.isinf(logits), 0.0, cast(Tensor, logits.grad))
        optimizer.step()
        if progress is not None:
            progress(iteration + 1, float(likelihood.detach()))
    with torch.no_grad():
        # The likelihood is that of the written probabilities.
        learned = logits.sigmoid().clamp(10**-DIGITS, 1).mul(10**DIGITS).round().div(10**DIGITS)
        logits.copy_(torch.logit(learned))
    numbers = {at: float(learned[at]) for at in range(len(logits)) if at not in fixed}
    return WeightedRules(
        written_as_one(soft, numbers),
        {labels[at]: weight for at, weight in numbers.items()},
        float(slip_logit.detach().sigmoid()),
        examples.best_slip(crisp),
        examples.steps,
        soft,
        crisp,
    )


@dataclass(frozen=True, eq=False)
class _Examples:
    """Demonstrated steps as inputs of a layer: B of them, or B trajectories of T steps.

    Attributes:
        actions: The position of the taken action among those of the layer, (B,) or (B, T).
        counts: How often each step was demonstrated, (B,) or (B, T): 0 for steps after the end of a trajectory.
        steps: The sum of `counts`.
    """

    unary: Tensor
    binary: Tensor
    mask: Tensor
    actions: Tensor
    counts: Tensor
    steps: int

    @classmethod
    def of(cls, demonstrations: Demonstrations, layer: RuleLayer) -> _Examples:
        """Convert demonstrations."""
        if not isinstance(demonstrations, Demonstrations):
            found = type(demonstrations).__name__
            raise TypeError(f"demonstrations: expected those of `logicity.demonstrations`, not {found}")
        if not demonstrations.atoms:
            raise ValueError("demonstrations: rules need observations of the kind `groundings`")
        if demonstrations.quantities:
            name = demonstrations.quantities[0]
            raise ValueError(f"demonstrations: the observations have values of `{name}`, which no layer of rules reads")
        if not any(len(trajectory) for trajectory in demonstrations):
            raise ValueError("demonstrations: there are no steps")
        layout = Layout.of_atoms(demonstrations.atoms)
        rules = layer._rules
        read = rules.body_predicates & rules.inputs.keys()
        names = {(layer.unary if rules.arities[each] == 1 else layer.binary)[rules.inputs[each]] for each in read}
        lacking = names - {*layout.unary, *layout.binary, SCOPE}
        if lacking:
            raise ValueError(f"demonstrations: the observations lack `{min(lacking)}`, which the rules read")
        each = [cls._of(trajectory, layout, layer) for trajectory in demonstrations if len(trajectory)]
        if layer.temporal:
            unary, binary, mask, actions, counts = (
                torch.nn.utils.rnn.pad_sequence(list(some), batch_first=True) for some in zip(*each, strict=True)
            )
        else:
            unary, binary, mask, actions, counts = (torch.cat(some) for some in zip(*each, strict=True))
            # Equal steps count together.
            rows = torch.cat([unary.flatten(1), binary.flatten(1), mask.double(), actions.double()[:, None]], 1)
            _, places, found = np.unique(rows.numpy(), axis=0, return_index=True, return_counts=True)
            chosen = torch.from_numpy(places)
            unary, binary, mask, actions = (some[chosen] for some in (unary, binary, mask, actions))
            counts = torch.from_numpy(found).double()
        return cls(unary, binary, mask, actions, counts, int(counts.sum()))

    @staticmethod
    def _of(trajectory: Trajectory, layout: Layout, layer: RuleLayer) -> tuple[Tensor, ...]:
        """Convert a trajectory of T steps: unary, binary, mask, actions, and counts."""
        facts = torch.from_numpy(trajectory.observations[: len(trajectory)].astype(np.float64))
        steps, count = len(facts), layout.entities
        unary, binary = facts[:, layout.unary_at], facts[:, layout.binary_at]
        # The driver, those with a fact, and those before them.
        known = unary.any(2) | binary.flatten(2).any(2) | binary.transpose(1, 2).flatten(2).any(2)
        known[:, 0] = True
        mask = known.flip(1).cummax(1).values.flip(1)
        binary_by_name = {name: binary[..., at] for at, name in enumerate(layout.binary)}
        binary_by_name.setdefault(SCOPE, torch.ones(steps, count, count, dtype=torch.float64))
        unary_by_name = {name: unary[..., at] for at, name in enumerate(layout.unary)}
        none = torch.zeros(steps, count, count, dtype=torch.float64)
        actions = torch.tensor([_position(layer, int(action)) for action in trajectory.actions])
        return (
            _stacked([unary_by_name.get(name, none[..., 0]) for name in layer.unary], none[..., 0]),
            _stacked([binary_by_name.get(name, none) for name in layer.binary], none),
            mask,
            actions,
            torch.ones(steps, dtype=torch.float64),
        )

    def _probabilities(self, layer: RuleLayer) -> Tensor:
        """Return the probability by the rules of each action that was taken."""
        answers = layer(self.unary, self.binary, self.mask, egos=[0])[..., 0, :]
        return cast(Tensor, answers.gather(-1, self.actions[..., None])[..., 0])

    def log_likelihood(self, layer: RuleLayer, slip: Tensor) -> Tensor:
        """Return the mean log-likelihood of a step."""
        return self._mean(self._probabilities(layer), slip, len(layer.actions))

    def _mean(self, by_rules: Tensor, slip: Tensor, actions: int) -> Tensor:
        mixed = (1 - slip) * by_rules + slip / actions
        return (self.counts * mixed.clamp(min=1e-300).log()).sum() / self.steps

    def best_slip(self, layer: RuleLayer) -> float:
        """Return the most likely slip of rules with these probabilities, by golden-section search."""
        with torch.no_grad():
            by_rules = self._probabilities(layer)
            low, high = 0.0, 1.0
            ratio = (math.sqrt(5) - 1) / 2
            while high - low > 1e-9:
                one, other = high - ratio * (high - low), low + ratio * (high - low)
                values = [
                    self._mean(by_rules, torch.tensor(slip, dtype=torch.float64), len(layer.actions))
                    for slip in (one, other)
                ]
                low, high = (low, other) if values[0] >= values[1] else (one, high)
        return (low + high) / 2


def _stacked(columns: Sequence[Tensor], like: Tensor) -> Tensor:
    """Return columns as the last dimension of a tensor, which may have none."""
    return torch.stack(list(columns), -1) if columns else like.new_zeros(*like.shape, 0)


def _position(layer: RuleLayer, action: int) -> int:
    """Return the position of an action of an environment among those of a layer."""
    name = ACTIONS[action] if action < len(ACTIONS) else f"action {action}"
    if name not in layer.actions:
        raise ValueError(
            f"demonstrations: the action {name} is not among those of the rules: {', '.join(layer.actions)}"
        )
    return layer.actions.index(name)
