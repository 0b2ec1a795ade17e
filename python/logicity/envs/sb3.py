"""Vectorized environments for Stable-Baselines3. Needs the extra `learn`: `pip install 'logicity[learn]'`."""

from __future__ import annotations

import inspect
import os
from collections.abc import Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

with extra("learn"):
    from gymnasium.vector import AutoresetMode
    from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from .interface import checked_options
from .vector import SPFVectorEnv

__all__ = ["SPFVecEnv", "make_vec_env"]

#: The environments that a method of `VecEnv` selects: one, several, or all (`None`).
Indices = None | int | Sequence[int]


class SPFVecEnv(VecEnv):
    """A vectorized environment of Safe Path Following as a Stable-Baselines3 `VecEnv`.

    Rewards are float32. The `infos` of a step are dictionaries with the keys of `SPFEnv`'s `info`. When an episode
    ends, the environment starts the next one in the same step. The info then describes the end of the episode, with the
    additional keys `terminal_observation`, `TimeLimit.truncated` and `is_success`. `set_options` accepts the option
    `episode` of `SPFEnv.reset`. Observations of the kinds `relational` and `graph` are dictionaries, which need the
    policy `MultiInputPolicy`.

    Raises:
        ValueError: If the environments have another autoreset mode than SameStep.
    """

    def __init__(self, envs: SPFVectorEnv) -> None:
        """Wrap the environments."""
        if envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"expected the autoreset mode SameStep, not {envs.autoreset_mode.value}")
        self.envs = envs
        self._actions: NDArray[Any] | None = None
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Start episodes, with the seeds of `seed` and the options of `set_options` if these were called before."""
        episodes = [checked_options(options, ("episode",)).get("episode") for options in self._options]
        observations, infos = self.envs.reset(seed=self._seeds, options={"episodes": episodes})
        self.reset_infos = self._dictionaries(infos)
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions, of shape (num_envs,), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step with the stored actions.

        Raises:
            RuntimeError: If `step_async` was not called before.
            gymnasium.error.InvalidAction: If an action is not 0, 1, 2 or 3.
        """
        if self._actions is None:
            raise RuntimeError("call `step_async` before `step_wait`")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, infos = self.envs.step(actions)
        dones = terminated | truncated
        step_infos = self._dictionaries(infos)
        ended = np.flatnonzero(dones)
        if len(ended):
            last = self._dictionaries(infos["final_info"])
            for at in ended.tolist():
                step_infos[at] = {
                    **last[at],
                    "terminal_observation": infos["final_obs"][at],
                    "TimeLimit.truncated": bool(truncated[at]),
                    "is_success": last[at]["success"],
                }
        return observations, rewards.astype(np.float32), dones, step_infos

    @staticmethod
    def _dictionaries(infos: dict[str, Any]) -> list[dict[str, Any]]:
        """Convert arrays by key to one dictionary per environment."""
        keys = [key for key in infos if not key.startswith(("_", "final_"))]
        columns = (infos[key].tolist() if infos[key].ndim == 1 and key != "seed" else list(infos[key]) for key in keys)
        return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute, which all environments share, or `episode` of each environment."""
        if attr_name == "episode":
            return self.env_method("episode", indices=indices)
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Raise `AttributeError`, because individual environments have no attributes."""
        raise AttributeError(f"`{attr_name}` cannot be set: make environments with other arguments")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call `episode`, `explain`, `explain_shield`, `action_masks` or `render` of the selected environments."""
        if method_name in ("action_masks", "render"):
            results = getattr(self.envs, method_name)()
            return [results[at] for at in self._get_indices(indices)]
        if method_name not in ("episode", "explain", "explain_shield"):
            known = "`action_masks`, `episode`, `explain`, `explain_shield`, `render`"
            raise AttributeError(f"individual environments have no method `{method_name}`; known: {known}")
        method = getattr(self.envs, method_name)
        return [method(at, *method_args, **method_kwargs) for at in self._get_indices(indices)]

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the permitted actions for `MaskablePPO`, as `SPFVectorEnv.action_masks` does."""
        return self.envs.action_masks()

    @property
    def clauses(self) -> tuple[str, ...]:
        """The names of the clauses that actions can violate, such as `S1`, in the order of `info["violations"]`."""
        return self.envs.clauses

    # Two environments cannot share a city.
    __copy__ = deepcopy

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Return `False` for each environment."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of each environment."""
        return self.envs.render() or ()


class _Monitor(VecMonitor):
    """A `VecMonitor` that can be pickled and copied."""

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the members of the class, some of which cannot be pickled."""
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Add the members of the class, as `VecEnvWrapper` does."""
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    # Two environments cannot share a city.
    __copy__ = deepcopy


def make_vec_env(
    config: str | os.PathLike[str] = "expert",
    n_envs: int = 1,
    seed: int | None = None,
    *,
    monitor: bool = True,
    **arguments: Any,
) -> VecEnv:
    """Make environments for Stable-Baselines3.

    Args:
        config: As for `SPFEnv`.
        n_envs: The number of environments.
        seed: The seed of the first environment. Environment i gets the seed `seed + i`.
        monitor: Whether to wrap the environments in a `VecMonitor`, which logs episode returns and lengths.
        arguments: Other parameters of `SPFVectorEnv`, such as `split`, `overrides` or `num_threads`.

    Raises the exceptions of `SPFVectorEnv`.
    """
    envs = SPFVecEnv(SPFVectorEnv(n_envs, config, autoreset_mode=AutoresetMode.SAME_STEP, **arguments))
    if seed is not None:
        envs.seed(seed)
    return _Monitor(envs) if monitor else envs
