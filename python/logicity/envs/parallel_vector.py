"""The vectorized environment of Safe Path Following with several egos. Needs the extra `gym`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..errors import did_you_mean, extra

with extra("gym"):
    from gymnasium.spaces import Discrete
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space
from ..types import EnvOptions, Episodes
from .config import EnvConfig
from .vector import BaseVectorEnv

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["SPFParallelVectorEnv"]


class SPFParallelVectorEnv(BaseVectorEnv):
    """Many environments of Safe Path Following with several egos each: one call steps all of them.

    The egos are the first cars, as many as `task.egos` of the configuration says, or every car without that key. Each
    has its own observation, reward and end, as in `SPFParallelEnv`. When the episode of an ego ends, the rules drive it
    until the episodes of all egos of its environment have ended; then the next episode begins. Until then its action
    has no effect, its reward is 0, and it neither terminates nor is truncated.

    Arrays begin with the shape (num_envs, egos): observations, rewards (float64), `terminated` (bool), `truncated`
    (bool), actions and the values of `infos`, which have the keys of `SPFVectorEnv` and `active` (bool): whether the
    action of the ego has an effect in the next step. The masks of `infos` under `_key` have the shape (num_envs,). In
    the autoreset mode SameStep, `final_obs` and `final_info` describe the episodes that ended for all egos: `success`
    in `final_info` says which egos have succeeded, so `final_info["success"].all(1)` is the joint success.

    It is not a `gymnasium.vector.VectorEnv`, whose rewards have the shape (num_envs,).

    Attributes:
        possible_agents: The names of the egos, in the order of the axis.
        single_observation_space: The observation space of an ego.
        single_action_space: The action space of an ego.
        observation_space: The observation space of all egos of all environments.
        action_space: The action space of all egos of all environments.

    Args:
        num_envs, config, episodes, atoms, render_mode, autoreset_mode, num_threads, copy, options: As for
            `SPFVectorEnv`.

    Raises:
        InputError, OSError, TypeError: As for `SPFEnv`.
        ValueError: If a name is unknown, or the number of environments or threads is out of range.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: str | os.PathLike[str] = "expert",
        *,
        episodes: Episodes = "drawn",
        atoms: bool = False,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int = 1,
        copy: bool = True,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Load the configuration and the rules."""
        batch = num_envs, autoreset_mode, num_threads
        self._begin(EnvConfig(config, SPFParallelVectorEnv, **options), batch, episodes, atoms, render_mode, True)
        self.copy = copy
        self.possible_agents = self._core.names()
        self.single_observation_space, self.single_action_space = self._space(), Discrete(len(self._actions))
        egos = len(self.possible_agents)
        self.observation_space = batch_space(batch_space(self.single_observation_space, egos), num_envs)
        self.action_space = batch_space(batch_space(self.single_action_space, egos), num_envs)
        self._seeds: np.random.Generator | None = None

    def _generator(self, seed: int | None) -> np.random.Generator:
        if seed is not None or self._seeds is None:
            self._seeds = np_random(seed)[0]
        return self._seeds

    def _infos(self, columns: Any, mask: NDArray[np.bool_], ended: bool = False) -> dict[str, Any]:
        infos = super()._infos(columns, mask, ended)
        infos["active"] = np.zeros(self._lead, np.bool_)
        if not ended:
            self._core.active(infos["active"])
        infos["_active"] = mask.copy()
        return infos

    def collect(
        self, networks: Sequence[_logicity.PolicyNetwork], random: NDArray[np.float32]
    ) -> list[dict[str, NDArray[Any]]]:
        """Run every environment under the stochastic policies of networks. The autoreset mode must be SameStep.

        Args:
            networks: One network for all egos, or one for each, in the order of `possible_agents`.
            random: Uniform random numbers from 0 to 1, float32 of shape (num_envs, egos, steps), which select the
                actions.

        Returns:
            The arrays of `SPFVectorEnv.collect` for each network. Those with a row per environment have one for each
            ego that the network drives: of shape (num_envs, steps), or (num_envs x egos, steps) for a network of all
            egos, with the egos of an environment one after the other. `endings` is 4 in the steps of an ego whose
            episode had ended before: ignore these steps.

        Raises:
            gymnasium.error.ResetNeeded: If an episode has not started.
            ValueError: If a network, their number or the shape of `random` does not fit.
        """
        return self._collected(list(networks), random)

    def _ego(self, agent: str) -> int:
        if agent not in self.possible_agents:
            raise ValueError(f"unknown car `{agent}`{did_you_mean(agent, self.possible_agents)}")
        return self.possible_agents.index(agent)

    def explain(self, at: int, agent: str, fact: str | None = None) -> str:
        """Variant of `SPFEnv.explain` for an ego of an environment.

        Raises:
            IndexError: If the environment does not exist.
            InputError: If the fact is invalid.
            ValueError: If the car is unknown.
            gymnasium.error.ResetNeeded: If its episode has not started.
        """
        return self._core.explain(self._checked_index(at), fact, self._ego(agent))

    def explain_shield(self, at: int, agent: str) -> str:
        """Variant of `SPFEnv.explain_shield` for an ego of an environment.

        The exceptions are those of `explain`, and `gymnasium.error.Error` if the environments have no shield.
        """
        self._check_shield()
        return self._core.explain_shield(self._checked_index(at), self._ego(agent))

    def close(self) -> None:
        """Close the window of the render mode `human`."""
        self.close_extras()
