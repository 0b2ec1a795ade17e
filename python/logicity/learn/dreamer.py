"""DreamerV2 for binary observations (Hafner et al., "Mastering Atari with Discrete World Models", ICLR 2021).

The world model is a recurrent state-space model (RSSM). Its state has a deterministic part h, the state of a GRU, and a
stochastic part z, a vector of categorical variables. The prior p(z | h) predicts z without the observation, and the
posterior q(z | h, x) infers it from the observation x. The actor and the critic learn from states that the world model
imagines.

A state includes the reward and the discount on arrival in it: action a_t leads from state s_t to s_t+1, and the reward
r_t+1 and the discount are predicted from s_t+1. The names of equations refer to the paper.

The package sheeprl (0.8.4) has a DreamerV2 of these sizes too. It is not used, because it decodes vectors as Gaussians
instead of bits, owns the training loop, steps individual environments in Python, and depends on Lightning, Hydra and
OpenCV.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from pydantic import Field
from stable_baselines3.common.torch_layers import create_mlp
from torch import Tensor, nn
from torch.nn import functional

from ..city import ACTIONS
from ..envs.views import Actions, Observations
from .interaction import Ring, TransitionLearner, Transitions, as_bits, random_actions, step_generator
from .learner import check_shape, minimize
from .settings import Count, LearnerSettings, LearningRate, NonNegative, Positive, Share, Training
from .storage import StoredPolicy, restore_optimizer

__all__ = ["Dreamer", "DreamerPolicy", "DreamerSettings", "EpisodeReplay", "State", "WorldModel"]


class DreamerSettings(LearnerSettings):
    """Settings of DreamerV2."""

    deterministic: Count = 100
    """The number of values of the deterministic part of a state."""
    variables: Count = 16
    """The number of categorical variables of the stochastic part of a state."""
    classes: Count = 16
    """The number of classes of each categorical variable."""
    layers: Count = 3
    """The number of hidden layers of the encoder, of the decoder and of each head."""
    width: Count = 100
    """The width of hidden layers."""
    model_learning_rate: LearningRate = 2e-4
    """The learning rate of the world model."""
    actor_learning_rate: LearningRate = 4e-5
    """The learning rate of the actor."""
    critic_learning_rate: LearningRate = 1e-4
    """The learning rate of the critic."""
    batch_size: Count = 50
    """The number of sequences of an update."""
    sequence_length: Count = 5
    """The number of observations of a sequence."""
    imagination: Count = 8
    """The number of imagined actions."""
    discount: Share = 0.99
    """The discount per step."""
    trace_decay: Share = 0.95
    """The weight lambda of longer returns in the targets of the critic."""
    kl_scale: NonNegative = 0.1
    """The weight of the divergence between posterior and prior in the loss of the world model."""
    kl_balance: Share = 0.8
    """The share of the divergence that trains the prior."""
    entropy_scale: NonNegative = 1e-3
    """The weight of the entropy of the actor in its loss."""
    target_interval: Count = 100
    """The number of updates after which the slow target critic becomes a copy of the critic."""
    gradient_clip: Positive = 100.0
    """The largest norm of the gradients of the world model, of the actor and of the critic."""
    random_steps: Annotated[int, Field(ge=0)] = 5000
    """The number of steps with random actions at the start."""
    train_interval: Count = 50
    """The number of environment steps between trainings."""
    updates: Count = 10
    """The number of updates of a training."""
    buffer_size: Count = 220_000
    """The number of observations that the learner stores. The first observation of an episode needs a place too."""


class State(NamedTuple):
    """States of the world model.

    Attributes:
        deterministic: The part h, of shape (..., deterministic).
        stochastic: The part z, one-hot vectors of shape (..., variables * classes).
    """

    deterministic: Tensor
    stochastic: Tensor

    def features(self) -> Tensor:
        """Return both parts in one vector."""
        return torch.cat(self, -1)

    def flat(self) -> State:
        """Return the states without gradients, as one batch."""
        return State(*(part.detach().flatten(0, -2) for part in self))


class Elu(nn.Module):
    """The activation ELU. PyTorch's `ELU` is slower on one core, because it computes `expm1`."""

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the inputs, or exp(x) - 1 where they are negative."""
        # The gradient at 0 is 1.
        positive = inputs.relu()
        return ((inputs - positive).exp() - 1) + positive


def mlp(inputs: int, settings: DreamerSettings, outputs: int) -> nn.Sequential:
    """Create hidden layers with ELU and a linear output."""
    return nn.Sequential(*create_mlp(inputs, outputs, [settings.width] * settings.layers, Elu))


def one_hot_samples(logits: Tensor, generator: torch.Generator | None) -> Tensor:
    """Sample one-hot vectors of the shape of the logits, (..., classes), with straight-through gradients (algorithm 1).

    Without a generator, return the most probable classes.
    """
    probabilities = logits.softmax(-1)
    if generator is None:
        chosen = logits.argmax(-1)
    else:
        # The inverse of the distribution function. Rounding can leave the last sum below 1.
        sums = probabilities.detach().cumsum(-1)
        uniform = torch.rand(logits.shape[:-1], generator=generator)[..., None]
        chosen = (sums <= uniform).sum(-1).clamp(max=logits.shape[-1] - 1)
    sample = functional.one_hot(chosen, logits.shape[-1]).to(logits.dtype)
    return sample + probabilities - probabilities.detach()


def balanced_kl(posterior: Tensor, prior: Tensor, balance: float) -> Tensor:
    """Return the KL divergence of the posterior from the prior, with KL balancing (algorithm 2).

    The share `balance` of it, from 0 to 1, trains the prior, and the rest the posterior. The logits have the shape
    (..., variables, classes), and the sums over the variables the shape (...).
    """

    def divergence(of: Tensor, to: Tensor) -> Tensor:
        of, to = of.log_softmax(-1), to.log_softmax(-1)
        return (of.exp() * (of - to)).sum((-2, -1))

    return balance * divergence(posterior.detach(), prior) + (1 - balance) * divergence(posterior, prior.detach())


def lambda_returns(rewards: Tensor, discounts: Tensor, values: Tensor, trace_decay: float) -> Tensor:
    """Return the targets of the critic for the states before H actions, of shape (H, ...) (equation 4).

    The rewards, and the discounts and values after the actions, have this shape, too. `trace_decay` is lambda.
    """
    following = values[-1]
    returns = []
    for step in reversed(range(len(rewards))):
        mixed = (1 - trace_decay) * values[step] + trace_decay * following
        following = rewards[step] + discounts[step] * mixed
        returns.append(following)
    return torch.stack(returns[::-1])


class Losses(NamedTuple):
    """The parts of the loss of the world model, each a mean over the observations of a batch."""

    observations: Tensor
    rewards: Tensor
    discounts: Tensor
    divergence: Tensor


class WorldModel(nn.Module):
    """The recurrent state-space model with its encoder, decoder and predictors, over `bits` bits (equation 1)."""

    def __init__(self, bits: int, settings: DreamerSettings) -> None:
        """Initialize the weights."""
        super().__init__()
        self.bits, self._settings = bits, settings
        width, deterministic = settings.width, settings.deterministic
        stochastic = settings.variables * settings.classes
        self.encoder = mlp(bits, settings, width)
        self.input = nn.Sequential(nn.Linear(stochastic + len(ACTIONS), width), Elu())
        self.gru = nn.GRUCell(width, deterministic)
        self.prior = nn.Sequential(nn.Linear(deterministic, width), Elu(), nn.Linear(width, stochastic))
        self.posterior = nn.Sequential(nn.Linear(deterministic + width, width), Elu(), nn.Linear(width, stochastic))
        self.decoder = mlp(deterministic + stochastic, settings, bits)
        self.reward = mlp(deterministic + stochastic, settings, 1)
        self.discount = mlp(deterministic + stochastic, settings, 1)

    def start(self, count: int) -> State:
        """Return the states before the first observation: zeros for a batch of `count` environments."""
        stochastic = self._settings.variables * self._settings.classes
        return State(torch.zeros(count, self._settings.deterministic), torch.zeros(count, stochastic))

    def start_memory(self, count: int) -> Memory:
        """Return the memory of a policy before the first observation."""
        return Memory(self.start(count), torch.zeros(count, len(ACTIONS)), 0)

    def advance(self, state: State, actions: Tensor) -> Tensor:
        """Return the deterministic part, (batch, deterministic), after one-hot actions, (batch, actions)."""
        return self.gru(self.input(torch.cat([state.stochastic, actions], -1)), state.deterministic)

    def _inferred(
        self, deterministic: Tensor, outputs: Tensor, generator: torch.Generator | None
    ) -> tuple[State, Tensor]:
        logits = outputs.unflatten(-1, (self._settings.variables, self._settings.classes))
        return State(deterministic, one_hot_samples(logits, generator).flatten(-2)), logits

    def observe(
        self, state: State, actions: Tensor, embedded: Tensor, first: Tensor, generator: torch.Generator | None
    ) -> tuple[State, Tensor]:
        """Infer the states of one step from observations.

        Args:
            state: The states of the step before.
            actions: The one-hot actions that led to the observations, of shape (batch, actions).
            embedded: The encoded observations, of shape (batch, width).
            first: Whether the observations are the first of their episodes, as floats of shape (batch, 1).
            generator: The source of samples. Without it, the most probable states are returned.

        Returns:
            The states, and the logits of the posterior, of shape (batch, variables, classes).
        """
        kept = 1 - first
        state, actions = State(state.deterministic * kept, state.stochastic * kept), actions * kept
        deterministic = self.advance(state, actions)
        return self._inferred(deterministic, self.posterior(torch.cat([deterministic, embedded], -1)), generator)

    def imagine(self, state: State, actions: Tensor, generator: torch.Generator | None) -> State:
        """Predict the states after one-hot actions, of shape (batch, actions). The arguments are those of `observe`."""
        deterministic = self.advance(state, actions)
        return self._inferred(deterministic, self.prior(deterministic), generator)[0]

    def loss(self, batch: Batch, generator: torch.Generator) -> tuple[State, Losses]:
        """Return the states of sequences, of shape (length, batch, ...), and the loss (equation 2)."""
        settings = self._settings
        embedded = self.encoder(batch.observations)
        state = self.start(batch.observations.shape[1])
        states, logits = [], []
        for step in range(len(embedded)):
            state, posterior = self.observe(state, batch.actions[step], embedded[step], batch.first[step], generator)
            states.append(state)
            logits.append(posterior)
        sequence = State(*(torch.stack(parts) for parts in zip(*states, strict=True)))
        posteriors, features = torch.stack(logits), sequence.features()
        cross_entropy = functional.binary_cross_entropy_with_logits
        # The observation has no clock, so the overtime cost of a truncated episode cannot be predicted.
        errors = torch.where(batch.truncated, 0.0, (self.reward(features)[..., 0] - batch.rewards) ** 2 / 2)
        return sequence, Losses(
            cross_entropy(self.decoder(features), batch.observations, reduction="none").sum(-1).mean(),
            errors.mean(),
            cross_entropy(self.discount(features)[..., 0], settings.discount * (1 - batch.terminated)),
            balanced_kl(posteriors, self.prior(sequence.deterministic).view_as(posteriors), settings.kl_balance).mean(),
        )


@dataclass(frozen=True)
class Batch:
    """Sequences of observations, with the actions and rewards that led to them.

    Attributes:
        observations: Bits as floats, of shape (length, batch, bits).
        actions: The one-hot actions before the observations, of shape (length, batch, actions).
        rewards: The rewards of the actions, of shape (length, batch).
        terminated: Whether the observation is the last of an episode that terminated, as floats of this shape.
        truncated: Whether the observation is the last of a truncated episode, of this shape.
        first: Whether the observation is the first of an episode, as floats of shape (length, batch, 1).
    """

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    terminated: Tensor
    truncated: Tensor
    first: Tensor


class EpisodeReplay(Ring):
    """The last observations of each environment, in ring buffers. Every episode has its last observation too."""

    #: The bits of a flag.
    TERMINATED, TRUNCATED, FIRST = 1, 2, 4

    def __init__(self, capacity: int, bits: int, observations: Tensor) -> None:
        """Allocate the memory for `capacity` observations of all environments, and add the first ones."""
        envs = len(observations)
        plain = {"actions": torch.uint8, "rewards": torch.float32, "flags": torch.uint8}
        super().__init__((envs, max(1, capacity // envs)), {"observations": bits}, **plain)
        self.added = torch.zeros(envs, dtype=torch.int64)
        self._add(torch.arange(envs), observations=observations, flags=self.FIRST)

    def _add(self, envs: Tensor, **values: Any) -> None:
        self._store((envs, self.added[envs] % self._shape[1]), values)
        self.added[envs] += 1

    def add(self, transitions: Transitions, observations: Tensor) -> None:
        """Add the observations after a step, and the first ones of new episodes, with which the next step starts."""
        after, actions, rewards = transitions.next_observations, transitions.actions, transitions.rewards
        flags = transitions.terminated * self.TERMINATED + transitions.truncated * self.TRUNCATED
        self._add(torch.arange(len(self.added)), observations=after, actions=actions, rewards=rewards, flags=flags)
        begun = torch.from_numpy(flags).nonzero()[:, 0]
        if len(begun):
            self._add(begun, observations=observations[begun], flags=self.FIRST)

    def sample(self, count: int, length: int, generator: torch.Generator) -> Batch:
        """Draw sequences of consecutive observations, which can contain the ends of episodes.

        Every environment must have `length` observations, see `ready`. The result has `count` sequences.
        """
        size = self._shape[1]
        envs = torch.randint(len(self.added), (count,), generator=generator)
        stored = self.added[envs].clamp(max=size)
        # Products of floats below 1 with integers can round up to the integer.
        starts = (torch.rand(count, generator=generator, dtype=torch.float64) * (stored - length + 1)).long()
        starts = torch.minimum(starts, stored - length) + self.added[envs] - stored
        at = (starts + torch.arange(length)[:, None]) % size
        observations, actions, rewards, flags = (buffer[envs, at] for buffer in self.buffers.values())
        first = flags & self.FIRST > 0
        return Batch(
            observations.float(),
            functional.one_hot(actions.long(), len(ACTIONS)).float() * ~first[..., None],
            rewards,
            (flags & self.TERMINATED > 0).float(),
            flags & self.TRUNCATED > 0,
            first[..., None].float(),
        )

    def ready(self, length: int) -> bool:
        """Return whether `sample` can draw sequences of this length."""
        return int(self.added.min()) >= length


class Memory(NamedTuple):
    """The memory of a policy.

    Attributes:
        state: The last states, one per environment.
        actions: The last actions, one-hot, of shape (environments, actions).
        steps: The number of steps, which determines the random samples.
    """

    state: State
    actions: Tensor
    steps: int


class DreamerPolicy(StoredPolicy):
    """The world model, which infers states from observations, and the actor. Its state is a `Memory`."""

    algorithm = "dreamer"
    algorithms = (algorithm,)

    def __init__(self, model: WorldModel, actor: nn.Module, settings: DreamerSettings, mode: str, seed: int) -> None:
        """Store the arguments."""
        self.model, self.actor, self.settings, self.mode, self.seed = model, actor, settings, mode, seed

    def predict(
        self, observation: Observations, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Any]:
        """Return the most probable actions in the most probable states, or sample both."""
        check_shape(observation, self.model.bits, self.mode)
        memory = self.model.start_memory(len(observation)) if state is None else state
        starts = np.full(len(observation), state is None) if episode_start is None else np.asarray(episode_start)
        first = torch.from_numpy(starts).float()[:, None]
        generator = None if deterministic else step_generator(self.seed, memory.steps)
        actions, after = self.act(torch.from_numpy(as_bits(observation)).float(), memory, first, generator)
        return actions.numpy(), after

    def act(
        self, observations: Tensor, memory: Memory, first: Tensor, generator: torch.Generator | None
    ) -> tuple[Tensor, Memory]:
        """Return actions, int64 of shape (batch,), and the next memory.

        The observations are bits as floats, of shape (batch, bits). `first` and `generator` are those of
        `WorldModel.observe`.
        """
        with torch.no_grad():
            embedded = self.model.encoder(observations)
            state, _ = self.model.observe(memory.state, memory.actions, embedded, first, generator)
            chosen = one_hot_samples(self.actor(state.features()), generator)
        return chosen.argmax(-1), Memory(state, chosen, memory.steps + 1)

    def config(self) -> dict[str, Any]:
        """Return the arguments, and the number of bits of an observation."""
        settings = self.settings.model_dump(mode="json")
        return {"mode": self.mode, "seed": self.seed, "bits": self.model.bits, "settings": settings}

    def weights(self) -> Mapping[str, Any]:
        """Return the weights of the world model and of the actor."""
        return {"model": self.model.state_dict(), "actor": self.actor.state_dict()}

    @classmethod
    def build(cls, config: dict[str, Any], weights: dict[str, Any]) -> DreamerPolicy:
        """Create the policy of a file."""
        settings = DreamerSettings.model_validate(config["settings"])
        model, actor = WorldModel(config["bits"], settings), head(settings, len(ACTIONS))
        model.load_state_dict(weights["model"])
        actor.load_state_dict(weights["actor"])
        return cls(model, actor, settings, config["mode"], config["seed"])


def head(settings: DreamerSettings, outputs: int) -> nn.Sequential:
    """Create a network on the features of states."""
    return mlp(settings.deterministic + settings.variables * settings.classes, settings, outputs)


class Dreamer(TransitionLearner):
    """Learns a world model from sequences of observations, and the actor and the critic in imagination."""

    settings_class = DreamerSettings
    takes_numbers = False
    policy_class = DreamerPolicy
    _settings: DreamerSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Make the environments and the networks."""
        settings: Any = config.settings
        if settings.buffer_size < config.envs * settings.sequence_length:
            raise ValueError(
                f"`buffer_size` {settings.buffer_size} is too small for {config.envs} environments with sequences of "
                f"{settings.sequence_length} observations: use at least {config.envs * settings.sequence_length}"
            )
        super().__init__(config, log)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self._model = WorldModel(self._interaction.width, settings)
            self._actor, self._critic = head(settings, len(ACTIONS)), head(settings, 1)
        self._target = deepcopy(self._critic).requires_grad_(False)
        self._networks = (self._model, self._actor, self._critic, self._target)
        # The epsilon and the decoupled weight decay of the paper (appendix D).
        self._optimizers = {
            name: torch.optim.AdamW(
                module.parameters(), getattr(settings, f"{name}_learning_rate"), eps=1e-5, weight_decay=1e-6, fused=True
            )
            for name, module in {"model": self._model, "actor": self._actor, "critic": self._critic}.items()
        }
        observations = torch.from_numpy(self._interaction.observations)
        self._replay = EpisodeReplay(settings.buffer_size, self._interaction.width, observations)
        self._memory = self._model.start_memory(config.envs)
        self._first = torch.ones(config.envs, 1)
        self._updates = 0

    def _learn(self, transitions: Transitions, before: int) -> None:
        settings = self._settings
        self._replay.add(transitions, torch.from_numpy(self._interaction.observations))
        self._first = torch.from_numpy(transitions.terminated | transitions.truncated).float()[:, None]
        if self.steps >= settings.random_steps and self._replay.ready(settings.sequence_length):
            for _ in range(self._due(before, settings.train_interval) * settings.updates):
                self._update()

    def _actions(self) -> Actions:
        observations = torch.from_numpy(self._interaction.observations).float()
        is_random = self.steps < self._settings.random_steps
        drawn = random_actions(len(observations), self._generator) if is_random else None
        chosen, self._memory = self.policy().act(observations, self._memory, self._first, self._generator)
        if drawn is None:
            return np.asarray(chosen.numpy())
        # The states follow the random actions, so the first actions of the actor have a memory.
        one_hot = functional.one_hot(torch.from_numpy(drawn), len(ACTIONS)).float()
        self._memory = self._memory._replace(actions=one_hot)
        return drawn

    def _update(self) -> None:
        """Train the world model on sequences, and the actor and the critic on what it imagines from their states."""
        settings = self._settings
        batch = self._replay.sample(settings.batch_size, settings.sequence_length, self._generator)
        states, losses = self._model.loss(batch, self._generator)
        total = losses.observations + losses.rewards + losses.discounts + settings.kl_scale * losses.divergence
        minimize(total, self._optimizers["model"], settings.gradient_clip)
        self._curves.add({f"loss/{name}": value.item() for name, value in losses._asdict().items()})
        self._behave(states.flat(), (1 - batch.terminated).flatten())
        self._updates += 1
        if self._updates % settings.target_interval == 0:
            self._target.load_state_dict(self._critic.state_dict())

    def _behave(self, state: State, continues: Tensor) -> None:
        """Train the actor and the critic from states, of shape (batch, ...).

        Only continuing states have a future. The weight of an imagined state is the probability that the episode
        reaches it, discounted.
        """
        settings = self._settings
        features, actions, logits = [state.features()], [], []
        for _ in range(settings.imagination):
            # Reinforce needs no gradients through the world model, only those of the actor.
            logits.append(self._actor(features[-1]))
            with torch.no_grad():
                actions.append(one_hot_samples(logits[-1], self._generator))
                state = self._model.imagine(state, actions[-1], self._generator)
            features.append(state.features())
        with torch.no_grad():
            every = torch.stack(features)
            rewards = self._model.reward(every[1:])[..., 0]
            discounts = torch.sigmoid(self._model.discount(every[1:])[..., 0])
            values = self._target(every)[..., 0]
            targets = lambda_returns(rewards, discounts, values[1:], settings.trace_decay)
            weights = torch.cat([continues[None], continues * discounts[:-1].cumprod(0)])
            advantages = targets - values[:-1]
        # Reinforce gradients and entropy, equation 6 with rho = 1, as for all discrete actions.
        log_probabilities = torch.stack(logits).log_softmax(-1)
        entropy = -(log_probabilities.exp() * log_probabilities).sum(-1)
        gain = (log_probabilities * torch.stack(actions)).sum(-1) * advantages + settings.entropy_scale * entropy
        minimize(-(weights * gain).mean(), self._optimizers["actor"], settings.gradient_clip)
        # Equation 5.
        errors = (self._critic(every[:-1])[..., 0] - targets) ** 2 / 2
        critic_loss = (weights * errors).mean()
        minimize(critic_loss, self._optimizers["critic"], settings.gradient_clip)
        figures = {"actor/entropy": entropy.mean(), "actor/return": targets.mean(), "loss/critic": critic_loss}
        self._curves.add({name: value.item() for name, value in figures.items()})

    def policy(self) -> DreamerPolicy:
        """Return the current policy."""
        return DreamerPolicy(self._model, self._actor, self._settings, self.config.mode, self.config.seed)

    def state(self) -> dict[str, Any]:
        """Return the environments, the networks, the optimizers, the observations, the memory and the random state."""
        return {
            **super().state(),
            "networks": [module.state_dict() for module in self._networks],
            "optimizers": {name: optimizer.state_dict() for name, optimizer in self._optimizers.items()},
            "replay": self._replay.state(),
            "memory": ([part.clone() for part in self._memory.state], self._memory.actions, self._memory.steps),
            "first": self._first,
            "updates": self._updates,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        super().load_state(state)
        for module, weights in zip(self._networks, state["networks"], strict=True):
            module.load_state_dict(weights)
        for name, optimizer in self._optimizers.items():
            restore_optimizer(optimizer, state["optimizers"][name])
        self._replay.restore(state["replay"])
        parts, actions, steps = state["memory"]
        self._memory = Memory(State(*parts), actions, steps)
        self._first, self._updates = state["first"], state["updates"]
