"""Model-based reinforcement learning with an ensemble and random shooting (Nagabandi et al., 2018 and 2020).

The learner fits a model of the environment to all transitions so far, and plans with it by random shooting [1, section
IV-C]. At every step it draws random action sequences, and predicts their returns with every member of the ensemble. It
takes the first action of the sequence with the best mean return. The ensemble is that of [2].

A member predicts, for each bit of the observation, whether it falls, stays or rises; the reward; and the probability
that the episode terminates, since no rewards follow a violation or the goal. It takes the most probable change of every
bit, so a state has one successor per action. The planner expands every state that a member reaches only once.

[1] Nagabandi et al.: Neural Network Dynamics for Model-Based Deep Reinforcement Learning with Model-Free Fine-Tuning.
ICRA 2018.
[2] Nagabandi et al.: Deep Dynamics Models for Learning Dexterous Manipulation. CoRL 2020.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from ..city import ACTIONS
from ..envs.views import Actions, Observations
from .interaction import Bits, Ring, TransitionLearner, Transitions, as_bits, random_actions, step_generator
from .learner import check_shape, minimize
from .settings import Count, LearnerSettings, LearningRate, Share, Training
from .storage import StoredPolicy, restore_optimizer

__all__ = ["Ensemble", "Shooting", "ShootingPolicy", "ShootingSettings", "WorldModel", "predicted_returns"]

#: The initial log odds that a bit stays rather than falls or rises: ln(.98 / .01).
STAYS_LOGIT = 4.6


class ShootingSettings(LearnerSettings):
    """Settings of model-based shooting."""

    members: Count = 50
    """The number of members of the ensemble."""
    width: Count = 64
    """The width of the two hidden layers of each network."""
    model_learning_rate: LearningRate = 1e-5
    """The learning rate of the networks that predict changes of bits."""
    reward_learning_rate: LearningRate = 1e-4
    """The learning rate of the networks that predict rewards and terminations."""
    sequences: Count = 100
    """The number of random action sequences per decision."""
    horizon: Count = 10
    """The length of the action sequences."""
    discount: Share = 0.9
    """The discount per step in planning. Below 1, a later violation costs less than an earlier one."""
    random_steps: Annotated[int, Field(ge=0)] = 5000
    """The number of steps with random actions at the start."""
    exploration: Share = 0.05
    """The probability of a random action after the start."""
    buffer_size: Count = 200_000
    """The number of transitions that the learner stores."""
    batch_size: Count = 128
    """The number of transitions of an update. Every member draws its own."""
    model_interval: Count = 16
    """The number of environment steps per update of the networks that predict changes of bits. An update takes several
    times as long as one of the other networks, which decide about violations."""
    reward_interval: Count = 4
    """The number of environment steps per update of the networks that predict rewards and terminations."""


class Ensemble(nn.Module):
    """Networks of the same shape with two hidden layers and ReLU, evaluated as one batch.

    The input is a vector of bits and an action. A member has the initial weights that `torch.nn.Linear` would have.
    """

    def __init__(self, members: int, bits: int, width: int, outputs: int, generator: torch.Generator) -> None:
        """Draw the weights."""
        super().__init__()
        ends = [bits + len(ACTIONS), width, width, outputs]
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for inputs, units in pairwise(ends):
            bound = inputs**-0.5
            for shape, parameters in (((members, inputs, units), self.weights), ((members, 1, units), self.biases)):
                values = torch.rand(shape, generator=generator) * (2 * bound) - bound
                parameters.append(nn.Parameter(values))

    def forward(self, bits: Tensor, actions: Tensor) -> Tensor:
        """Evaluate each member on its own inputs: floats (members, batch, bits) and integers (members, batch).

        The outputs have the shape (members, batch, outputs).
        """
        inputs = torch.cat([bits, functional.one_hot(actions, len(ACTIONS)).to(bits.dtype)], -1)
        return self._upper(torch.baddbmm(self.biases[0], inputs, self.weights[0]))

    def all_actions(self, bits: Tensor) -> Tensor:
        """Evaluate each member on its own bits with every action: (members, batch, actions, outputs)."""
        members, batch, width = bits.shape
        # The layer is linear, so its values for the bits are computed once for all actions.
        of_bits = torch.baddbmm(self.biases[0], bits, self.weights[0][:, :width])
        hidden = of_bits[:, :, None] + self.weights[0][:, None, width:]
        outputs = self._upper(hidden.view(members, batch * len(ACTIONS), -1))
        return outputs.view(members, batch, len(ACTIONS), -1)

    def _upper(self, hidden: Tensor) -> Tensor:
        hidden = torch.baddbmm(self.biases[1], hidden.relu(), self.weights[1])
        return torch.baddbmm(self.biases[2], hidden.relu(), self.weights[2])


class WorldModel(nn.Module):
    """The ensemble's model of the environment, over observations of `bits` bits."""

    #: The classes of a change of a bit, from which its difference follows by subtracting 1.
    FALLS, STAYS, RISES = 0, 1, 2

    def __init__(self, bits: int, settings: ShootingSettings, generator: torch.Generator) -> None:
        """Draw the weights."""
        super().__init__()
        self.members, self.bits = settings.members, bits
        self.changes = Ensemble(settings.members, bits, settings.width, 3 * bits, generator)
        with torch.no_grad():
            # Few bits change in a step. Learning this prior would take most of the updates at the paper's learning
            # rate, and meanwhile the planner would search through random states.
            self.changes.biases[-1].view(settings.members, 3, bits)[:, self.STAYS] += STAYS_LOGIT
        self.outcomes = Ensemble(settings.members, bits, settings.width, 2, generator)

    def outcomes_of(self, states: Tensor) -> tuple[Tensor, Tensor]:
        """Predict rewards, and the probabilities that the episode continues, both of shape (members, batch, actions).

        The states are bits as floats, of shape (members, batch, bits).
        """
        rewards, terminates = self.outcomes.all_actions(states).unbind(-1)
        return rewards, torch.sigmoid(-terminates)

    def flips_of(self, states: Tensor) -> Tensor:
        """Predict which bits change in states of the shape for `outcomes_of`, bool (members, batch, actions, bits).

        A bit changes if the change is more probable than none.
        """
        logits = self.changes.all_actions(states)
        falls, stays, rises = logits.unflatten(-1, (3, self.bits)).unbind(-2)
        return torch.where(states[:, :, None] > 0, falls, rises) > stays

    def changes_loss(self, bits: Tensor, actions: Tensor, next_bits: Tensor) -> Tensor:
        """Return the mean cross entropy of the changes of bits, summed over the members, of shape ().

        The arguments are those of `Ensemble.forward`, and the bits after the actions.
        """
        members, batch, width = bits.shape
        logits = self.changes(bits, actions).view(members * batch, 3, width)
        targets = (next_bits - bits).to(torch.int64).view(members * batch, width) + self.STAYS
        return functional.cross_entropy(logits, targets) * members

    def outcomes_loss(
        self, bits: Tensor, actions: Tensor, rewards: Tensor, terminated: Tensor, truncated: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the mean squared error of the rewards and the mean cross entropy of terminations, summed over members.

        The observation has no clock, so the overtime cost of a truncated episode cannot be predicted. The error leaves
        its reward out. Both values have the shape (). The first arguments are those of `Ensemble.forward`; `rewards`,
        `terminated` (0 or 1) and `truncated` (bool) have the shape of `actions`.
        """
        predicted, terminates = self.outcomes(bits, actions).unbind(-1)
        errors = torch.where(truncated, 0.0, (predicted - rewards) ** 2)
        cross_entropy = functional.binary_cross_entropy_with_logits(terminates, terminated)
        return errors.mean() * self.members, cross_entropy * self.members


class _Graph:
    """The states that members of the ensemble reach in a search, each expanded at most once per member.

    A node is a state of a member. Its edges, one per action, end in the node itself until a change is predicted. States
    are equal if their Zobrist hashes are, the sums of a random number of 64 bits per bit that is 1. With n nodes, the
    probability that two states have the same hash is below n^2 / 2^64: about 1 in 10^10 for 50,000 nodes.
    """

    #: The number of states per member in a batch, which limits the memory.
    BATCH = 64

    def __init__(self, model: WorldModel, states: Tensor) -> None:
        """Add a node per member and state, uint8 (states, bits)."""
        self._model = model
        generator = torch.Generator().manual_seed(0)
        low, high = torch.iinfo(torch.int64).min, torch.iinfo(torch.int64).max
        self._of_bits = torch.randint(low, high, (model.bits,), generator=generator)
        self._of_members = torch.randint(low, high, (model.members,), generator=generator)
        count = len(states) * model.members
        self.member = torch.arange(model.members).repeat_interleave(len(states))
        self.states = states.repeat(model.members, 1)
        self.hashes = self._hashes(self.states, self.member)
        self.expanded = torch.zeros(count, dtype=torch.bool)
        self.next = torch.arange(count)[:, None].repeat(1, len(ACTIONS))
        self.rewards, self.continues = torch.zeros(2, count, len(ACTIONS))

    def _hashes(self, states: Tensor, members: Tensor) -> Tensor:
        return (states * self._of_bits).sum(1) + self._of_members[members]

    def expand(self, nodes: Tensor, last: bool) -> None:
        """Predict the edges of nodes. With `last`, only rewards are needed."""
        reached = torch.zeros(len(self.states), dtype=torch.bool)
        reached[nodes.reshape(-1)] = True
        new = (reached & ~self.expanded).nonzero()[:, 0]
        if not len(new):
            return
        new = new[torch.argsort(self.member[new], stable=True)]
        members = self.member[new]
        counts = torch.bincount(members, minlength=self._model.members)
        place = torch.arange(len(new)) - (counts.cumsum(0) - counts)[members]
        for start in range(0, int(counts.max()), self.BATCH):
            chosen = (place >= start) & (place < start + self.BATCH)
            width = min(self.BATCH, int(counts.max()) - start)
            self._expand(new[chosen], members[chosen] * width + place[chosen] - start, width, last)
        self.expanded[new] = not last

    def _expand(self, nodes: Tensor, rows: Tensor, width: int, last: bool) -> None:
        """Expand nodes, each in its row of a batch for all members."""
        model = self._model
        batch = torch.zeros(model.members * width, model.bits)
        batch[rows] = self.states[nodes].float()
        batch = batch.view(model.members, width, model.bits)
        self.rewards[nodes], self.continues[nodes] = (each.flatten(0, 1)[rows] for each in model.outcomes_of(batch))
        if last:
            return
        flips = model.flips_of(batch).flatten(0, 1)[rows]
        at, actions = flips.any(-1).nonzero(as_tuple=True)
        if len(at):
            self._link(nodes[at], actions, self.states[nodes[at]] ^ flips[at, actions])

    def _link(self, parents: Tensor, actions: Tensor, states: Tensor) -> None:
        """Let edges end in these states, which are added if they are new."""
        known, members = len(self.hashes), self.member[parents]
        every = torch.cat([self.hashes, self._hashes(states, members)])
        _, *found = np.unique(every.numpy(), return_index=True, return_inverse=True)
        first, number = map(torch.from_numpy, found)
        added = first[first >= known].sort().values
        node = torch.arange(len(every))
        node[added] = torch.arange(len(added)) + known
        self.next[parents, actions] = node[first[number[known:]]]
        self.states = torch.cat([self.states, states[added - known]])
        self.member = torch.cat([self.member, members[added - known]])
        self.hashes = torch.cat([self.hashes, every[added]])
        self.expanded = torch.cat([self.expanded, torch.zeros(len(added), dtype=torch.bool)])
        self.next = torch.cat([self.next, node[added][:, None].expand(-1, len(ACTIONS))])
        none = torch.zeros(len(added), len(ACTIONS))
        self.rewards, self.continues = torch.cat([self.rewards, none]), torch.cat([self.continues, none])


def predicted_returns(model: WorldModel, states: Tensor, sequences: Tensor, discount: float) -> Tensor:
    """Predict returns, averaged over the members of the ensemble, float32 (states, sequences).

    The return of a member is the sum over steps t of discount^t times the predicted reward, times the probability that
    the episode has not terminated before. The states are uint8 (states, bits), the sequences of actions (sequences,
    horizon).
    """
    horizon = sequences.shape[1]
    with torch.inference_mode():
        graph = _Graph(model, states)
        nodes = torch.arange(model.members * len(states))[:, None].expand(-1, len(sequences))
        totals = torch.zeros(nodes.shape)
        weights = torch.ones(nodes.shape)
        for step in range(horizon):
            graph.expand(nodes, step + 1 == horizon)
            edges = (nodes, sequences[:, step])
            totals += weights * graph.rewards[edges]
            weights *= discount * graph.continues[edges]
            nodes = graph.next[edges]
    return totals.view(model.members, len(states), len(sequences)).mean(0)


def planned_actions(
    model: WorldModel, observations: Bits, settings: ShootingSettings, generator: torch.Generator
) -> Actions:
    """Return the first action of the best random sequence, int64 (batch,), for observations of shape (batch, bits).

    All observations share the sequences, so equal observations get the same action and are evaluated once.
    """
    shape = (settings.sequences, settings.horizon)
    sequences = torch.randint(len(ACTIONS), shape, generator=generator)
    distinct, number = np.unique(observations, axis=0, return_inverse=True)
    returns = predicted_returns(model, torch.from_numpy(distinct), sequences, settings.discount)
    return np.asarray(sequences[returns.argmax(1), 0])[number.reshape(-1)]


class ShootingPolicy(StoredPolicy):
    """Plans with a model. Its state is the number of steps so far, which determines the sequences besides the seed."""

    algorithm = "mb-shooting"
    algorithms = (algorithm,)

    def __init__(self, model: WorldModel, settings: ShootingSettings, mode: str, seed: int) -> None:
        """Store the arguments."""
        self.model, self.settings, self.mode, self.seed = model, settings, mode, seed

    def predict(
        self, observation: Observations, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Any]:
        """Plan one action per observation. `episode_start` and `deterministic` have no effect."""
        check_shape(observation, self.model.bits, self.mode)
        step = 0 if state is None else int(state)
        generator = step_generator(self.seed, step)
        return planned_actions(self.model, as_bits(observation), self.settings, generator), step + 1

    def config(self) -> dict[str, Any]:
        """Return the arguments, and the number of bits of an observation."""
        settings = self.settings.model_dump(mode="json")
        return {"mode": self.mode, "seed": self.seed, "bits": self.model.bits, "settings": settings}

    def weights(self) -> Mapping[str, Any]:
        """Return the weights of the model of the environment."""
        return dict(self.model.state_dict())

    @classmethod
    def build(cls, config: dict[str, Any], weights: dict[str, Any]) -> ShootingPolicy:
        """Create the policy of a file."""
        settings = ShootingSettings.model_validate(config["settings"])
        model = WorldModel(config["bits"], settings, torch.Generator())
        model.load_state_dict(weights)
        return cls(model, settings, config["mode"], config["seed"])


class Replay(Ring):
    """The last transitions."""

    def __init__(self, capacity: int, bits: int) -> None:
        """Allocate the memory for `capacity` transitions between observations of `bits` bits."""
        plain = {"actions": torch.uint8, "rewards": torch.float32, "terminated": torch.bool, "truncated": torch.bool}
        super().__init__((capacity,), {"observations": bits, "next_observations": bits}, **plain)
        self.added = 0

    def __len__(self) -> int:
        """Return the number of stored transitions."""
        return min(int(self.added), *self._shape)

    def add(self, transitions: Transitions) -> None:
        """Store transitions in place of the oldest ones."""
        at = (torch.arange(len(transitions.actions)) + self.added) % self._shape[0]
        self._store(at, vars(transitions))
        self.added += len(at)


class Shooting(TransitionLearner):
    """Learns a model of the environment from transitions, and plans with it."""

    settings_class = ShootingSettings
    takes_numbers = False
    policy_class = ShootingPolicy
    _settings: ShootingSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Make the environments and the networks."""
        super().__init__(config, log)
        settings = self._settings
        self._model = WorldModel(self._interaction.width, settings, self._generator)
        self._replay = Replay(settings.buffer_size, self._interaction.width)
        changes, outcomes = self._model.changes.parameters(), self._model.outcomes.parameters()
        self._changes_optimizer = torch.optim.Adam(changes, settings.model_learning_rate, fused=True)
        self._outcomes_optimizer = torch.optim.Adam(outcomes, settings.reward_learning_rate, fused=True)

    def _learn(self, transitions: Transitions, before: int) -> None:
        self._replay.add(transitions)
        for _ in range(self._due(before, self._settings.model_interval)):
            self._update_changes()
        for _ in range(self._due(before, self._settings.reward_interval)):
            self._update_outcomes()

    def _actions(self) -> Actions:
        observations = self._interaction.observations
        drawn = random_actions(len(observations), self._generator)
        if self.steps < self._settings.random_steps:
            return drawn
        explores = torch.rand(len(observations), generator=self._generator).numpy() < self._settings.exploration
        planned = planned_actions(self._model, observations, self._settings, self._generator)
        return np.where(explores, drawn, planned)

    def _batch(self) -> Tensor:
        shape = (self._settings.members, self._settings.batch_size)
        return torch.randint(len(self._replay), shape, generator=self._generator)

    def _update_changes(self) -> None:
        stored, at = self._replay.buffers, self._batch()
        bits, next_bits = stored["observations"][at].float(), stored["next_observations"][at].float()
        loss = self._model.changes_loss(bits, stored["actions"][at].long(), next_bits)
        minimize(loss, self._changes_optimizer)
        self._curves.add({"loss/changes": loss.item() / self._settings.members})

    def _update_outcomes(self) -> None:
        stored, at = self._replay.buffers, self._batch()
        bits, actions = stored["observations"][at].float(), stored["actions"][at].long()
        rewards, terminated, truncated = (stored[name][at] for name in ("rewards", "terminated", "truncated"))
        errors, cross_entropy = self._model.outcomes_loss(bits, actions, rewards, terminated.float(), truncated)
        minimize(errors + cross_entropy, self._outcomes_optimizer)
        members = self._settings.members
        self._curves.add({"loss/rewards": errors.item() / members, "loss/terminations": cross_entropy.item() / members})

    def policy(self) -> ShootingPolicy:
        """Return the current policy."""
        return ShootingPolicy(self._model, self._settings, self.config.mode, self.config.seed)

    def state(self) -> dict[str, Any]:
        """Return the environments, the networks, the optimizers, the transitions and the random state."""
        return {
            **super().state(),
            "model": self._model.state_dict(),
            "changes_optimizer": self._changes_optimizer.state_dict(),
            "outcomes_optimizer": self._outcomes_optimizer.state_dict(),
            "replay": self._replay.state(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        super().load_state(state)
        self._model.load_state_dict(state["model"])
        restore_optimizer(self._changes_optimizer, state["changes_optimizer"])
        restore_optimizer(self._outcomes_optimizer, state["outcomes_optimizer"])
        self._replay.restore(state["replay"])
