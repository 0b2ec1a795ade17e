"""Training environments, random numbers and files of policies, for learners that store transitions."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import missing_extra

try:
    import torch
    from gymnasium.vector import AutoresetMode
except ImportError as error:
    raise missing_extra("learn", error) from error

from ..city import ACTIONS
from ..envs import SPFVectorEnv
from ..files import read_tensors
from ..terminal import first_line
from .learner import Actions, Observations

if TYPE_CHECKING:
    from .config import TrainConfig

__all__ = [
    "Bits",
    "Interaction",
    "Transitions",
    "as_bits",
    "build_policy",
    "random_actions",
    "read_checkpoint",
    "save_policy",
    "step_generator",
]

Bits = NDArray[np.uint8]

#: The class of the policy that `load_policy` returns.
Built = TypeVar("Built")

#: The version of the files of policies.
FORMAT = 1


@dataclass(frozen=True)
class Transitions:
    """One step of all environments. Every array has one row per environment.

    Attributes:
        observations: The observations before the step.
        actions: The actions.
        rewards: The rewards.
        next_observations: The observations after the step, also where the episode ended.
        terminated: Whether the car reached the goal or violated a rule.
        truncated: Whether the episode reached the horizon.
    """

    observations: Bits
    actions: Actions
    rewards: NDArray[np.float32]
    next_observations: Bits
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Interaction:
    """Training environments with binary observations, and the mean return and length of their last episodes.

    Args:
        config: The configuration of the run.

    Raises:
        InputError: If the configuration of the mode or an override is invalid.
        OSError: If a file cannot be read.
        ValueError: If the observations are not binary.
    """

    def __init__(self, config: TrainConfig) -> None:
        """Make the environments and start their first episodes."""
        self.envs = SPFVectorEnv(
            config.envs,
            config.mode,
            autoreset_mode=AutoresetMode.SAME_STEP,
            copy=False,
            **config.env_options(),
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
        """Return what `restore` needs."""
        names = ("observations", "steps", "_returns", "_lengths", "_ended")
        return {"envs": pickle.dumps(self.envs), **{name: getattr(self, name) for name in names}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned.

        Raises:
            ValueError: If the state is that of other environments.
        """
        if state["observations"].shape != self.observations.shape:
            raise ValueError(
                f"the checkpoint has observations of shape {state['observations'].shape}, and the environments "
                f"{self.observations.shape}"
            )
        self.envs.close()
        for name, value in state.items():
            setattr(self, name, pickle.loads(value) if name == "envs" else value)

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()


def as_bits(observations: Observations) -> Bits:
    """Convert binary observations to uint8.

    Raises:
        ValueError: If a value is neither 0 nor 1.
    """
    bits = observations.astype(np.uint8)
    if not np.array_equal(bits, observations) or bits.max(initial=0) > 1:
        raise ValueError(
            "the learner needs binary observations: use `observation: groundings`, and do not set `route_length` in "
            "the task"
        )
    return bits


def save_policy(path: Path, algorithm: str, config: Mapping[str, Any], weights: Mapping[str, Any]) -> None:
    """Write a policy of groundings.

    Args:
        path: The file.
        algorithm: The name of the learner.
        config: The arguments from which to build the policy, as plain data. `mode` is the mode of the training.
        weights: The weights.
    """
    header = {"format": FORMAT, "algorithm": algorithm, "mode": config["mode"], "observation": "groundings"}
    torch.save({**header, "config": dict(config), "weights": dict(weights)}, path)


def build_policy(path: Path, algorithm: str, build: Callable[[dict[str, Any], dict[str, Any]], Built]) -> Built:
    """Return the result of `build` for the configuration and the weights that `save_policy` wrote.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not a policy of the algorithm.
    """
    saved = read_tensors(path, "a policy")
    if not isinstance(saved, dict) or not {"format", "algorithm", "config", "weights"} <= saved.keys():
        raise ValueError(f"{path} is not a policy")
    if saved["algorithm"] != algorithm:
        raise ValueError(f"{path} is a policy of {saved['algorithm']}, not of {algorithm}")
    if saved["format"] != FORMAT:
        raise ValueError(f"{path} has version {saved['format']} of the format, and only {FORMAT} can be read")
    try:
        return build(saved["config"], saved["weights"])
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = first_line(str(error), repr(error))
        raise ValueError(f"{path} is not a complete policy of {algorithm}: {reason}") from None


def read_checkpoint(folder: Path, algorithm: str) -> dict[str, Any]:
    """Return the content of `learner.pt`. It is a pickle, since it has environments: read only checkpoints you trust.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is a checkpoint of another learner.
    """
    state: dict[str, Any] = torch.load(folder / "learner.pt", weights_only=False)
    if state.get("algorithm") != algorithm:
        raise ValueError(f"{folder} has no checkpoint of {algorithm}")
    return state


def random_actions(count: int, generator: torch.Generator) -> Actions:
    """Return uniformly distributed actions."""
    actions: Actions = torch.randint(len(ACTIONS), (count,), generator=generator).numpy()
    return actions


def step_generator(seed: int, step: int) -> torch.Generator:
    """Return the source of the random numbers of a policy in a step of the episode.

    Args:
        seed: The seed of the policy.
        step: The number of steps before.
    """
    # Consecutive steps of a run must not have the seeds of consecutive runs.
    return torch.Generator().manual_seed(int(np.random.SeedSequence([seed, step]).generate_state(1)[0]))
