"""Training environments and random numbers, for learners that store transitions, and what these learners share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from ..city import ACTIONS
from ..envs.vector import SPFVectorEnv
from ..envs.views import Actions, Observations
from .learner import Learner
from .settings import Training

__all__ = [
    "Bits",
    "Interaction",
    "Ring",
    "TransitionLearner",
    "Transitions",
    "as_bits",
    "random_actions",
    "step_generator",
]

Bits = NDArray[np.uint8]


@dataclass(frozen=True)
class Transitions:
    """One step of all environments. Every array has one row per environment.

    `next_observations` are those after the step, also where the episode ended. `terminated` says whether the car
    reached the goal or violated a rule, and `truncated` whether the episode reached the horizon.
    """

    observations: Bits
    actions: Actions
    rewards: NDArray[np.float32]
    next_observations: Bits
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Interaction:
    """Training environments with binary observations, and the mean return and length of their last episodes."""

    def __init__(self, config: Training) -> None:
        """Make the environments and start their first episodes."""
        options = config.env_options()
        self.envs = SPFVectorEnv(
            config.envs, config.mode, autoreset_mode=AutoresetMode.SAME_STEP, copy=False, **options
        )
        self.observations: Bits = as_bits(self.envs.reset(seed=config.seed)[0])
        self.steps = 0
        self._returns = np.zeros(config.envs)
        self._lengths = np.zeros(config.envs, np.int64)
        self._ended: list[tuple[float, int, bool]] = []

    @property
    def width(self) -> int:
        """The number of bits of an observation."""
        return int(self.observations.shape[1])

    def step(self, actions: Actions) -> Transitions:
        """Take one step in every environment. An episode that ends is followed by the next one."""
        before = self.observations
        observations, rewards, terminated, truncated, infos = self.envs.step(actions)
        self.observations = as_bits(observations)
        after = self.observations
        ended = np.flatnonzero(terminated | truncated)
        self._returns += rewards
        self._lengths += 1
        if len(ended):
            after = after.copy()
            success = infos["final_info"]["success"]
            for at in ended:
                after[at] = as_bits(infos["final_obs"][at])
                self._ended.append((float(self._returns[at]), int(self._lengths[at]), bool(success[at])))
            self._returns[ended] = 0
            self._lengths[ended] = 0
        self.steps += len(actions)
        return Transitions(before, actions, rewards.astype(np.float32), after, terminated, truncated)

    def episodes(self) -> dict[str, float]:
        """Return the means over the episodes that ended since the last call. No episodes give no means."""
        if not self._ended:
            return {}
        returns, lengths, success = np.array(self._ended, float).mean(0)
        self._ended.clear()
        return {"episode/return": returns, "episode/length": lengths, "episode/success": success}

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs, as plain data."""
        return {
            "environments": self.envs.state(),
            "observations": torch.from_numpy(self.observations),
            "steps": self.steps,
            "returns": torch.from_numpy(self._returns),
            "lengths": torch.from_numpy(self._lengths),
            "ended": list(self._ended),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned. Raise `ValueError` if it is that of other environments."""
        expected: dict[str, NDArray[Any]]
        expected = {"observations": self.observations, "returns": self._returns, "lengths": self._lengths}
        arrays = {name: state[name].numpy() for name in expected}
        for name, array in arrays.items():
            if array.shape != expected[name].shape or array.dtype != expected[name].dtype:
                raise ValueError(
                    f"the checkpoint has `{name}` of shape {array.shape}, and the environments {expected[name].shape}"
                )
        self.envs.restore(state["environments"])
        self.observations, self._returns, self._lengths = (array.copy() for array in arrays.values())
        self.steps = int(state["steps"])
        self._ended = [(float(total), int(length), bool(success)) for total, length, success in state["ended"]]


class Ring:
    """Steps of environments in ring buffers.

    Attributes:
        buffers: The buffers by name, of shape (..., capacity); those of bits are uint8 (..., capacity, bits).
        added: The number of steps so far, an integer or a tensor of shape (...).
    """

    added: Any

    def __init__(self, shape: tuple[int, ...], bits: Mapping[str, int], **plain: torch.dtype) -> None:
        """Allocate the memory. The last number of the shape is the capacity; `plain` are the types of other buffers."""
        self._shape = shape
        self.buffers = {name: torch.zeros(*shape, count, dtype=torch.uint8) for name, count in bits.items()}
        self.buffers |= {name: torch.zeros(shape, dtype=dtype) for name, dtype in plain.items()}

    def _store(self, at: Any, values: Mapping[str, Any]) -> None:
        for name, buffer in self.buffers.items():
            buffer[at] = torch.as_tensor(values.get(name, 0)).to(buffer.dtype)

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs, with eight bits of observations in a byte."""
        count = min(int(torch.as_tensor(self.added).max()), self._shape[-1])
        state = {"added": deepcopy(self.added)}
        for name, buffer in self.buffers.items():
            kept = buffer.narrow(len(self._shape) - 1, 0, count)
            are_bits = kept.ndim > len(self._shape)
            state[name] = torch.from_numpy(np.packbits(kept.numpy(), axis=-1)) if are_bits else kept.clone()
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self.added, axis = deepcopy(state["added"]), len(self._shape) - 1
        for name, buffer in self.buffers.items():
            kept = state[name]
            if kept.ndim > len(self._shape):
                kept = torch.from_numpy(np.unpackbits(kept.numpy(), axis=-1, count=buffer.shape[-1]))
            buffer.narrow(axis, 0, kept.shape[axis]).copy_(kept)


class TransitionLearner(Learner):
    """A learner that stores the transitions of its environments, and learns from them after each step."""

    unit: ClassVar = "environment steps"
    interacts = True

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Make the environments."""
        super().__init__(config, log)
        self._interaction = Interaction(config)
        self._generator = torch.Generator().manual_seed(config.seed)

    @property
    def steps(self) -> int:
        """The number of steps of all environments."""
        return self._interaction.steps

    def _step(self, steps: int) -> None:
        before = self.steps
        self._learn(self._interaction.step(self._actions()), before)
        if self._curves.due(self.steps):
            self._curves.add(self._interaction.episodes())
            self._curves.write(self.steps)

    @abstractmethod
    def _actions(self) -> Actions:
        """Choose the actions of the next step."""

    @abstractmethod
    def _learn(self, transitions: Transitions, before: int) -> None:
        """Store a step, and train. The value of `steps` was `before`."""

    def _due(self, before: int, interval: int) -> int:
        """Return how many multiples of an interval the number of steps has reached since it was `before`."""
        return self.steps // interval - before // interval

    def state(self) -> dict[str, Any]:
        """Return the state of the environments and of the random generator."""
        return {"interaction": self._interaction.state(), "generator": self._generator.get_state()}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        self._interaction.restore(state["interaction"])
        self._generator.set_state(state["generator"])

    def close(self) -> None:
        """Close the environments and the training curves."""
        self._interaction.envs.close()
        super().close()


def as_bits(observations: Observations) -> Bits:
    """Convert observations to uint8. Raise `ValueError` if a value is neither 0 nor 1."""
    bits = observations.astype(np.uint8)
    if not np.array_equal(bits, observations) or bits.max(initial=0) > 1:
        raise ValueError(
            "the learner needs binary observations: use `observation: groundings`, and a configuration without "
            "`route_length` in the task and without quantities"
        )
    return bits


def random_actions(count: int, generator: torch.Generator) -> Actions:
    """Return uniformly distributed actions."""
    return np.asarray(torch.randint(len(ACTIONS), (count,), generator=generator))


def step_generator(seed: int, step: int) -> torch.Generator:
    """Return the source of the random numbers of a policy with a seed, after a number of steps of the episode."""
    # Consecutive steps of a run must not have the seeds of consecutive runs.
    return torch.Generator().manual_seed(int(np.random.SeedSequence([seed, step]).generate_state(1)[0]))
