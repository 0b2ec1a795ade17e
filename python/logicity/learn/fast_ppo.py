"""A fast PPO (proximal policy optimization, Schulman et al., 2017) for the observation `groundings`.

Three properties of Safe Path Following make it fast:

- The rollouts run in Rust, see `logicity._logicity.PolicyNetwork`. Python makes one call per batch of steps.
- Most entries of an observation are 0. The first layer of the rollouts adds the rows of the other entries only.
- Many observations occur repeatedly. The network evaluates each distinct observation of a batch once, in the rollouts
  and in the update. The update groups the steps by observation and action; its gradient is that of the ungrouped loss.

The first layer of the network is shared by *slots*: a slot has the atoms about the ego and a few other entities. The
maximum over the slots makes the policy independent of the order of entities, as the rules are: "there is an entity Y
such that ...". With one slot for all entities the network is a multilayer perceptron.

Several egos (`task.egos`) are independent learners (de Witt et al., 2020): each has its own observation, reward and
return, and they share one policy or have one each.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from pydantic import SerializerFunctionWrapHandler, model_serializer
from torch import Tensor, nn

from .. import _logicity
from ..city import ACTIONS
from ..envs.layout import atoms_of
from ..envs.parallel_vector import SPFParallelVectorEnv
from ..envs.vector import SPFVectorEnv
from ..envs.views import Actions, Observations
from ..files import read_tensors
from ..tasks import load_task
from .learner import LearnedPolicy, Learner, check_shape
from .settings import Count, LearnerSettings, LearningRate, NonNegative, Positive, Share, Training, Widths

__all__ = ["FastPPO", "FastPPOPolicy", "FastPPOSettings"]

Floats: TypeAlias = NDArray[np.float32]

#: The name of the learner in training files and policy files.
NAME = "ppo-fast"
#: The version of the format of policy files.
FORMAT = 1
#: The number of updates between two points of the training curves.
LOG_EVERY = 50

#: The endings of episodes in the training curves, by their number in `SPFVectorEnv.collect`.
ENDINGS = {1: "violation", 2: "success", 3: "horizon"}
#: The ending of a step of an ego whose episode had ended before.
INACTIVE = 4


class FastPPOSettings(LearnerSettings):
    """The settings of `ppo-fast`."""

    network: Widths = (64, 64)
    """The widths of the hidden layers. The policy and the value share them."""
    entities_per_slot: Count = 1
    """The number of entities besides the ego in a slot of the first layer. With all entities, the network is a
    multilayer perceptron."""
    rollout_steps: Count = 16
    """The number of steps of each environment in a batch."""
    epochs: Count = 1
    """The number of passes over a batch in an update."""
    minibatches: Count = 4
    """The number of gradient steps per epoch. Each one uses a share of the distinct observations."""
    learning_rate: LearningRate = 2e-3
    """The learning rate of Adam at the start."""
    final_learning_rate: NonNegative = 0.0
    """The learning rate at the end. It changes linearly with the number of steps."""
    gamma: Share = 0.9
    """The discount factor."""
    gae_lambda: Share = 0.95
    """The weight of longer returns in the generalized advantage estimation."""
    clip_range: Positive = 0.2
    """The clip range c: an update clips the ratio of new to old probabilities to 1 - c and 1 + c."""
    ent_coef: NonNegative = 0.01
    """The coefficient of the entropy in the loss at the start."""
    final_ent_coef: NonNegative = 0.0
    """The coefficient of the entropy at the end. It changes linearly with the number of steps."""
    vf_coef: NonNegative = 0.1
    """The coefficient of the value's squared error in the loss."""
    max_grad_norm: Positive = 0.5
    """The norm to which larger gradients are clipped."""
    policies: Literal["shared", "separate"] = "shared"
    """Whether several egos (`task.egos`) share one policy or have one each."""

    @model_serializer(mode="wrap")
    def _without_default(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Omit the default of `policies`, so that hashes of settings stay the same."""
        values: dict[str, Any] = serialize(self)
        if values.get("policies") == "shared":
            del values["policies"]
        return values


def slots(description: Mapping[str, Any], others: int) -> NDArray[np.int64]:
    """Return the positions of the entries that each slot of the first layer selects, int64 (slots, inputs).

    There is a slot for every set of `others` entities besides the ego (fewer if fewer are observed). Its inputs are the
    atoms about these entities and the ego, and the route length if it is observed. Binary predicates are irreflexive,
    so atoms such as IsClose(1, 1) are left out. The description is that of `_logicity.describe`.
    """
    atoms = list(atoms_of(description))
    positions = {atom: position for position, atom in enumerate(atoms)}
    others = min(others, description["entities"] - 1)
    inputs = [(name, of) for name, of in atoms if max(of) <= others and len(set(of)) == len(of)]
    chosen = itertools.combinations(range(1, description["entities"]), others)
    rows = [[positions[name, tuple((0, *slot)[at] for at in of)] for name, of in inputs] for slot in chosen]
    if description["route_length"]:
        rows = [[*row, len(atoms)] for row in rows]
    return np.array(rows, np.int64)


class Network:
    """The network of the policy and the value, with its gradient and Adam (Kingma and Ba, 2015).

    It computes the same as `_logicity.PolicyNetwork`. The input has shape (batch, slots, inputs). The output has shape
    (batch, 5): a logit per action, and the value. It avoids automatic differentiation, whose overhead is large for
    small layers.

    Attributes:
        parameters: All weights and biases in one vector.
        gradient: The gradient of the last `backward`, in the same order.
        layers: The weights, of shape (inputs, outputs), and the biases of each layer. They are views of `parameters`.
    """

    def __init__(self, inputs: int, widths: Sequence[int]) -> None:
        """Initialize orthogonally: gain sqrt(2) in the hidden layers, 0.01 for the logits and 1 for the value."""
        shapes = list(itertools.pairwise([inputs, *widths, len(ACTIONS) + 1]))
        self.parameters = torch.zeros(sum((before + 1) * after for before, after in shapes))
        self.gradient = torch.zeros_like(self.parameters)
        self.moments = torch.zeros(2, len(self.parameters))
        self.updates = 0
        self.layers = _layers(self.parameters, shapes)
        self._gradients = _layers(self.gradient, shapes)
        for weights, _ in self.layers:
            nn.init.orthogonal_(weights.T, math.sqrt(2))
        last, _ = self.layers[-1]
        last[:, :-1] *= 0.01 / math.sqrt(2)
        last[:, -1] /= math.sqrt(2)
        self._values: list[Tensor] = []
        self._first = torch.empty(0)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the logits and the value, and keep the values of all layers for `backward`."""
        (weights, bias), *others = self.layers
        batch, slots, width = inputs.shape
        self._first = torch.addmm(bias, inputs.view(-1, width), weights).view(batch, slots, -1)
        values = self._first.amax(1)
        self._values = [inputs, values]
        for weights, bias in others:
            # The values are kept after the rectified linear units.
            values = torch.addmm(bias, values.relu_(), weights)
            self._values.append(values)
        return values

    def backward(self, derivative: Tensor) -> None:
        """Compute the gradient from the derivative with respect to the output of the last `forward`."""
        inputs, *values = self._values
        for at in range(len(self.layers) - 1, 0, -1):
            weights, bias = self._gradients[at]
            torch.mm(values[at - 1].T, derivative, out=weights)
            torch.sum(derivative, 0, out=bias)
            derivative = derivative @ self.layers[at][0].T
            derivative *= torch.gt(values[at - 1], 0, out=torch.empty_like(derivative))
        weights, bias = self._gradients[0]
        torch.sum(derivative, 0, out=bias)
        # Slots with the same maximum share the derivative.
        highest = torch.eq(self._first, values[0].unsqueeze(1), out=torch.empty_like(self._first))
        if highest.shape[1] > 1:
            derivative /= highest.sum(1).clamp_(min=1)
        highest *= derivative.unsqueeze(1)
        torch.mm(inputs.view(-1, inputs.shape[2]).T, highest.view(-1, highest.shape[2]), out=weights)

    def step(self, learning_rate: float, max_grad_norm: float) -> None:
        """Take a step of Adam along the gradient, which is shortened to `max_grad_norm`."""
        decays, (mean, square) = (0.9, 0.999), self.moments
        self.gradient *= min(1.0, max_grad_norm / (float(self.gradient.norm()) + 1e-6))
        self.updates += 1
        mean.lerp_(self.gradient, 1 - decays[0])
        square.mul_(decays[1]).addcmul_(self.gradient, self.gradient, value=1 - decays[1])
        scale, rate = (1 - decay**self.updates for decay in reversed(decays))
        self.parameters.addcdiv_(mean, square.div(scale).sqrt_().add_(1e-5), value=-learning_rate / rate)

    def native(self, width: int, slots: NDArray[np.int64]) -> _logicity.PolicyNetwork:
        """Return the network for rollouts in Rust, with a copy of the weights."""
        return _logicity.PolicyNetwork(width, slots, [(weights.numpy(), bias.numpy()) for weights, bias in self.layers])


def _layers(vector: Tensor, shapes: list[tuple[int, int]]) -> list[tuple[Tensor, Tensor]]:
    """Return views of a vector as weights and biases."""
    parts = vector.split([(before + 1) * after for before, after in shapes])
    rows = [part.view(-1, after) for part, (_, after) in zip(parts, shapes, strict=True)]
    return [(each[:-1], each[-1]) for each in rows]


def advantages(
    rewards: Floats, values: Floats, next_values: Floats, ended: NDArray[np.bool_], gamma: float, lam: float
) -> Floats:
    """Return the generalized advantage estimates (Schulman et al., 2016, equation 16).

    All arrays have shape (environments, steps). `next_values` are those after each step, 0 if the state is terminal;
    `ended` says whether the episode ends with the step; `lam` is the weight of longer returns.
    """
    deltas = (rewards + gamma * next_values - values).T
    continues = np.where(ended.T, np.float32(0), np.float32(gamma * lam))
    result = np.empty_like(deltas)
    following = np.zeros_like(deltas[0])
    for step in reversed(range(len(deltas))):
        following = result[step] = deltas[step] + continues[step] * following
    return result.T


class Batch(NamedTuple):
    """The steps of a batch, grouped by observation. Sums are over the steps with that observation."""

    inputs: Tensor
    """The inputs of the network for each distinct observation, of shape (observations, slots, inputs)."""
    log_probs: Tensor
    """The logarithms of the probabilities of the actions in the rollouts, of shape (observations, 4)."""
    positive_advantages: Tensor
    """The sum of the positive advantages of each action, of shape (observations, 4)."""
    negative_advantages: Tensor
    """The sum of the negative advantages of each action, of shape (observations, 4)."""
    counts: Tensor
    """The number of steps, of shape (observations,)."""
    returns: Tensor
    """The mean return, of shape (observations,)."""

    def part(self, chosen: Tensor) -> Batch:
        """Return the observations at these positions."""
        return Batch(*(tensor[chosen] for tensor in self))


def grouped(
    inputs: Floats,
    outputs: Floats,
    states: NDArray[Any],
    actions: NDArray[Any],
    step_advantages: Floats,
    returns: Floats,
) -> Batch:
    """Group steps by observation.

    `inputs` and `outputs`, (observations, 5), are those of the network in the rollouts for each distinct observation.
    The others have the shape (steps,); `states` are the positions of observations.
    """
    observations = len(outputs)
    pairs = states.astype(np.int64) * len(ACTIONS) + actions

    def sums(at: NDArray[Any], of: Floats | None, count: int) -> Tensor:
        return torch.from_numpy(np.bincount(at, of, count).astype(np.float32))

    counts = sums(states, None, observations)
    shape = (observations, len(ACTIONS))
    return Batch(
        torch.from_numpy(inputs),
        torch.log_softmax(torch.from_numpy(outputs)[:, :-1], 1),
        sums(pairs, np.maximum(step_advantages, 0), math.prod(shape)).view(shape),
        sums(pairs, np.minimum(step_advantages, 0), math.prod(shape)).view(shape),
        counts,
        sums(states, returns, observations) / counts,
    )


class Losses(NamedTuple):
    """The parts of the loss, each a sum over steps."""

    policy: float
    """The negative clipped surrogate objective."""
    value: float
    """Half the squared error of the value, without the variance of the returns of an observation."""
    entropy: float
    """The entropy of the policy."""


def losses(outputs: Tensor, batch: Batch, clip_range: float, vf_coef: float, ent_coef: float) -> tuple[Losses, Tensor]:
    """Return the parts of PPO's loss, and the derivative of their weighted sum with respect to the outputs.

    The loss is that of Schulman et al. (2017, equations 7 and 9). For a ratio r and an advantage A,
    min(r A, clip(r, 1 - c, 1 + c) A) is min(r, 1 + c) A if A is positive, and max(r, 1 - c) A otherwise. All steps with
    the same observation and action have the same ratio, so the sums of positive and of negative advantages determine
    the sum over the steps.
    """
    low, high, counts = 1 - clip_range, 1 + clip_range, batch.counts.unsqueeze(1)
    log_probs = torch.log_softmax(outputs[:, :-1], 1)
    probs = log_probs.exp()
    ratio = torch.exp(log_probs - batch.log_probs)
    positive, negative = batch.positive_advantages, batch.negative_advantages
    objective = ratio.clamp(max=high) * positive + ratio.clamp(min=low) * negative
    by_log_prob = ratio * ((ratio < high) * positive + (ratio > low) * negative)
    entropy = -(probs * log_probs).sum(1, keepdim=True)
    error = outputs[:, -1] - batch.returns
    derivative = torch.empty_like(outputs)
    # The derivative of the logarithm of the probability i with respect to the logit k is [i = k] - probability k.
    derivative[:, :-1] = probs * by_log_prob.sum(1, keepdim=True) - by_log_prob
    derivative[:, :-1] += ent_coef * counts * probs * (log_probs + entropy)
    derivative[:, -1] = vf_coef * batch.counts * error
    value = 0.5 * torch.dot(batch.counts, error * error)
    parts = Losses(-float(objective.sum()), float(value), float(torch.dot(batch.counts, entropy.squeeze(1))))
    return parts, derivative


class FastPPOPolicy(LearnedPolicy):
    """A policy of `ppo-fast`.

    With separate policies of several egos, observations have a row for each ego of each episode, those of an episode
    one after the other.
    """

    def __init__(
        self,
        networks: Sequence[Network],
        slots: NDArray[np.int64],
        width: int,
        mode: str,
        settings: FastPPOSettings,
    ) -> None:
        """Store the network of all egos or those of each, the entries that slots select, and the observation's size."""
        self.mode, self.settings = mode, settings
        self._networks, self._slots, self._width = list(networks), slots, width
        #: The number of egos that have a policy each; `None` for one policy of any number.
        self.egos = None if settings.policies == "shared" else len(self._networks)
        self._random = np.random.default_rng(0)

    def _decide(self, observation: Observations, deterministic: bool) -> Actions:
        check_shape(observation, self._width, self.mode)
        rows, count = len(observation), len(self._networks)
        if rows % count:
            raise ValueError(f"{rows} observations for the policies of {count} egos")
        logits = np.empty((rows, len(ACTIONS)), np.float32)
        for ego, network in enumerate(self._networks):
            native = network.native(self._width, self._slots)
            logits[ego::count] = native.evaluate(np.ascontiguousarray(observation[ego::count], np.float32))[:, :-1]
        if not deterministic:
            # The Gumbel-max trick.
            logits += self._random.gumbel(size=logits.shape).astype(np.float32)
        return np.asarray(logits.argmax(1))

    def save(self, path: Path) -> None:
        """Write the policy."""
        content = {
            "algorithm": NAME,
            "format": FORMAT,
            "mode": self.mode,
            "observation": "groundings",
            "settings": self.settings.model_dump(mode="json"),
            "slots": torch.from_numpy(self._slots),
            "width": self._width,
            "weights": self._parameters(),
        }
        torch.save(content, path)

    def _parameters(self) -> Tensor:
        """Return the weights and biases of the network in one vector, or with separate policies one row for each."""
        parameters = [network.parameters for network in self._networks]
        return parameters[0] if self.settings.policies == "shared" else torch.stack(parameters)

    def weights(self) -> Mapping[str, Any]:
        """Return all weights and biases in one vector."""
        return {"parameters": self._parameters()}

    @classmethod
    def load(cls, path: Path) -> FastPPOPolicy:
        """Read a policy that `save` wrote."""
        content = read_tensors(path, f"a policy of `{NAME}`")
        if not isinstance(content, dict) or content.get("algorithm") != NAME:
            raise ValueError(f"{path} is not a policy of `{NAME}`")
        if (version := content.get("format")) != FORMAT:
            raise ValueError(f"{path} has the format {version!r}, but this version reads {FORMAT}")
        try:
            settings = FastPPOSettings.model_validate(content["settings"])
            positions = content["slots"].numpy()
            weights = content["weights"]
            if weights.ndim != (1 if settings.policies == "shared" else 2) or not len(weights):
                raise ValueError("the shape of the weights does not match the settings")
            networks = []
            for parameters in weights.unsqueeze(0) if weights.ndim == 1 else weights:
                network = Network(positions.shape[1], settings.network)
                if parameters.shape != network.parameters.shape:
                    raise ValueError("the number of weights does not match the settings")
                network.parameters.copy_(parameters)
                network.native(content["width"], positions)
                networks.append(network)
            policy = cls(networks, positions, content["width"], content["mode"], settings)
        except (AttributeError, IndexError, KeyError, OverflowError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is a damaged policy of `{NAME}`: {error}") from None
        return policy


class FastPPO(Learner):
    """PPO with rollouts in Rust and an update over distinct observations.

    Attributes:
        seconds: The CPU seconds since the start or the last `restore`, by phase.
    """

    settings_class = FastPPOSettings
    unit: ClassVar = "environment steps"
    interacts = True
    policy_class = FastPPOPolicy
    starts = True
    drives_egos = True
    steps = 0
    _settings: FastPPOSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Create the environments and the network."""
        super().__init__(config, None if log is None else log / NAME)
        description = _logicity.describe(load_task(config.mode, overrides=config.overrides))
        self._slots = slots(description, self._settings.entities_per_slot)
        self._width: int = description["width"]
        self._egos: int = description["egos"] or 1
        count = 1 if self._settings.policies == "shared" else self._egos
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self._networks = [Network(self._slots.shape[1], self._settings.network) for _ in range(count)]
        self._random = np.random.default_rng(config.seed)
        self._updates = 0
        options: dict[str, Any] = {**config.env_options(), "num_threads": config.threads, "copy": False}
        kind: Any = SPFVectorEnv if self._egos == 1 else SPFParallelVectorEnv
        self._envs: SPFVectorEnv | SPFParallelVectorEnv = kind(
            config.envs, config.mode, autoreset_mode=AutoresetMode.SAME_STEP, **options
        )
        self._envs.reset(seed=config.seed)
        self._ended = np.zeros(len(ENDINGS) + 1, np.int64)
        self.seconds = dict.fromkeys(("rollouts", "grouping", "updates"), 0.0)

    def start_from(self, policy: LearnedPolicy) -> None:
        """Copy the weights of a policy."""
        assert isinstance(policy, FastPPOPolicy)
        if policy.settings.network != self._settings.network or not np.array_equal(policy._slots, self._slots):
            raise ValueError("its layers do not fit the observations and the settings")
        if len(policy._networks) not in (1, len(self._networks)):
            raise ValueError(f"it has the policies of {len(policy._networks)} egos, not of {len(self._networks)}")
        for at, network in enumerate(self._networks):
            network.parameters.copy_(policy._networks[min(at, len(policy._networks) - 1)].parameters)

    def _step(self, steps: int) -> None:
        """Collect a batch, and update the network with it. Schedules end at the steps of the configuration."""
        settings, begun = self._settings, time.process_time()
        egos = () if self._egos == 1 else (self._egos,)
        random = self._random.random((self.config.envs, *egos, settings.rollout_steps), np.float32)
        natives = [network.native(self._width, self._slots) for network in self._networks]
        if isinstance(self._envs, SPFParallelVectorEnv):
            collected = self._envs.collect(natives, random)
        else:
            collected = [self._envs.collect(natives[0], random)]
        self.seconds["rollouts"] += time.process_time() - begun
        for network, done in zip(self._networks, collected, strict=True):
            self._learn(network, done)
        self.steps += self.config.envs * settings.rollout_steps
        self._updates += 1
        if self.log is not None and self._updates % LOG_EVERY == 0:
            self._write_curves()

    def _learn(self, network: Network, done: Mapping[str, NDArray[Any]]) -> None:
        """Update a network with the steps that it collected."""
        settings, begun = self._settings, time.process_time()
        values, ended = done["outputs"][done["states"], -1], done["endings"] > 0
        estimates = advantages(done["rewards"], values, done["next_values"], ended, settings.gamma, settings.gae_lambda)
        returns, acts = estimates + values, done["endings"] != INACTIVE
        columns = [done["states"], done["actions"], estimates, returns]
        if not acts.all():
            if not acts.any():
                return
            columns = [each[acts] for each in columns]
        estimates = columns[2]
        columns[2] = (estimates - estimates.mean()) / (estimates.std() + np.float32(1e-8))
        batch, size = grouped(done["inputs"], done["outputs"], *(each.ravel() for each in columns)), int(acts.sum())
        prepared = time.process_time()
        last = self._update(network, batch, size)
        self.seconds["grouping"] += prepared - begun
        self.seconds["updates"] += time.process_time() - prepared
        if self.log is not None:
            self._add_to_curves(done["rewards"][acts], done["endings"][acts], batch, last)

    def _update(self, network: Network, batch: Batch, size: int) -> Losses:
        """Take the gradient steps of a batch of `size` steps. Return the loss of the last one."""
        settings = self._settings
        learning_rate = self._scheduled(settings.learning_rate, settings.final_learning_rate)
        ent_coef = self._scheduled(settings.ent_coef, settings.final_ent_coef)
        scale = settings.minibatches / size
        for _ in range(settings.epochs):
            parts = [batch]
            if settings.minibatches > 1:
                order = torch.from_numpy(self._random.permutation(len(batch.counts)))
                parts = [batch.part(chosen) for chosen in order.chunk(settings.minibatches)]
            for part in parts:
                outputs = network.forward(part.inputs)
                loss, derivative = losses(outputs, part, settings.clip_range, settings.vf_coef, ent_coef)
                network.backward(scale * derivative)
                network.step(learning_rate, settings.max_grad_norm)
        return loss

    def _scheduled(self, first: float, last: float) -> float:
        return first + (last - first) * min(1.0, self.steps / self.config.steps)

    def _add_to_curves(self, rewards: Floats, endings: NDArray[Any], batch: Batch, loss: Losses) -> None:
        """Add a batch to the training curves."""
        size = rewards.size
        part = self._settings.minibatches / size
        self._ended += np.bincount(endings.ravel(), minlength=len(self._ended))
        self._curves.add(
            {
                "batches/reward": rewards.mean(),
                "batches/distinct": len(batch.counts) / size,
                "batches/value_loss": loss.value * part,
                "batches/entropy": loss.entropy * part,
            }
        )

    def _write_curves(self) -> None:
        """Write the training curves."""
        episodes = max(self._ended[1:].sum(), 1)
        self._curves.add({f"episodes/{name}": self._ended[ending] / episodes for ending, name in ENDINGS.items()})
        self._curves.add({f"cpu_seconds/{phase}": seconds for phase, seconds in self.seconds.items()})
        self._curves.write(self.steps)
        self._ended[:] = 0

    def policy(self) -> FastPPOPolicy:
        """Return the current policy."""
        return FastPPOPolicy(self._networks, self._slots, self._width, self.config.mode, self._settings)

    def state(self) -> dict[str, Any]:
        """Return the weights, the optimizer, the environments and the random state."""
        networks = [(network.parameters, network.moments, network.updates) for network in self._networks]
        return {
            "network": networks[0] if len(networks) == 1 else networks,
            "environments": self._envs.state(),
            "random": self._random.bit_generator.state,
            "counts": (self.steps, self._updates),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        saved = state["network"]
        networks = [saved] if isinstance(saved, tuple) else saved
        for network, (parameters, moments, updates) in zip(self._networks, networks, strict=True):
            network.parameters.copy_(parameters)
            network.moments.copy_(moments)
            network.updates = updates
        self._random.bit_generator.state = state["random"]
        self.steps, self._updates = state["counts"]
        self._envs.restore(state["environments"])
        self._ended[:] = 0

    def close(self) -> None:
        """Close the environments and the training curves."""
        self._envs.close()
        super().close()
