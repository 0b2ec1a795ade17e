"""The vectorized gymnasium environment of Safe Path Following. Needs the extra `gym`."""

from __future__ import annotations

import operator
import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _logicity
from ..errors import checked_integer, extra

with extra("gym"):
    import gymnasium
    from gymnasium.error import InvalidAction
    from gymnasium.spaces import Discrete
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
from ..types import EnvOptions, Episodes, EpisodeStart
from .config import EnvConfig
from .interface import (
    RENDER_FPS,
    RENDER_MODES,
    HorizonSpec,
    check_masks,
    check_options,
    checked_render_mode,
    checked_seed,
    env_info,
    masks_of,
    observation_space,
    parse_episode,
    parsed_state,
    rendered,
    restore_states,
    states_of,
    wrong_limit,
)
from .views import Observations, View, views_of

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["SPFVectorEnv"]


class SPFVectorEnv(VectorEnv[Any, NDArray[np.int64], NDArray[Any]]):
    """A vectorized environment of Safe Path Following: one call steps all environments.

    Vectorized results equal those of individual `SPFEnv` environments with the same seeds. `reset(seed=s)` gives
    environment i the seed s + i. Not thread-safe: concurrent use raises `RuntimeError`.

    Observations have shape (num_envs, ...), or are dictionaries of such arrays, computed for all environments at once.
    Rewards (float64), `terminated` (bool) and `truncated` (bool) have shape
    (num_envs,). `infos` has one array per key of `SPFEnv`'s `info`, and its mask under `_key`. In the autoreset mode
    SameStep, `final_obs` and `final_info` have the last observations and infos of the episodes that ended.

    Args:
        num_envs: The number of environments, at most 65536.
        config: As for `SPFEnv`.
        episodes: As for `SPFEnv`.
        atoms: As for `SPFEnv`.
        render_mode: As for `SPFEnv`.
        autoreset_mode: An `AutoresetMode`, or its name or value in any case: `"SAME_STEP"`, `"SameStep"`.
        num_threads: The number of threads of a step.
        copy: Whether every call returns a new array of observations. `False` is faster: every call overwrites and
            returns the same array. Observations of the kinds `relational` and `graph` are always new.
        max_episode_steps: The horizon, which `gymnasium.make_vec` passes if it gets the `spec` of such environments. It
            cannot change the horizon: `overrides={"task": {"horizon": 100}}` does.
        options: As for `SPFEnv`.

    Raises:
        InputError: If the configuration, the rule file or an episode is invalid.
        OSError: If a file cannot be read.
        TypeError: If an option is unknown.
        ValueError: If a name is unknown, the number of environments or threads is out of range, or `max_episode_steps`
            is not the horizon.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": RENDER_FPS}
    spec = HorizonSpec()

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
        max_episode_steps: int | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Load the configuration and the rules."""
        super().__init__()
        self.num_envs = checked_integer("num_envs", num_envs, 1, _logicity.ENVS_MAX)
        self._num_threads = checked_integer("num_threads", num_threads, 1, _logicity.THREADS_MAX)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode, self._window = checked_render_mode(render_mode)
        self._atoms, self.copy = atoms, copy
        self._config = EnvConfig(config, SPFVectorEnv, **options)
        self._kind, self._task = self._config.array_kind, self._config.task()
        self._clauses = self._task.clauses()
        self._views, self._shape = views_of(self._task, self._config.observation), tuple(self._task.shape(self._kind))
        self.single_observation_space = observation_space(self._task, self._kind, self._views)
        self.single_action_space = Discrete(4)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes, self._recorded = episodes, episodes == "recorded"
        self._core = self._make_core()
        horizon = self._task.max_steps(self._config.split, self._recorded)
        if max_episode_steps is not None and max_episode_steps != horizon:
            raise wrong_limit(max_episode_steps, horizon)
        self._observations = np.zeros((num_envs, *self._shape), np.float32)
        self._seeded = np.zeros(num_envs, np.bool_)

    def _make_core(self) -> _logicity.VectorEnv:
        config, mode = self._config, self.autoreset_mode.value
        core = _logicity.VectorEnv(
            self._task, config.split, self.num_envs, mode, self._kind, self._episodes, self._num_threads
        )
        if config.action_masks:
            core.judge_actions()
        if self._atoms:
            core.keep_last_atoms()
        return core

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: The seeds of new sequences of episodes. A number s gives environment i the seed s + i. A list has one
                seed per environment, where `None` continues the sequence.
            options: `reset_mask`, bool of shape (num_envs,), selects the environments to reset (default: all).
                `episode` sets the episode of all of them, as in `SPFEnv.reset`. `episodes` is a list of such values,
                one per environment.

        Returns:
            The observations, and the infos.

        Raises:
            IndexError: If the recorded episode does not exist.
            InputError: If the mapping is not a valid episode of this environment (`invalid-episode`).
            ValueError: If an option is unknown, or its value is invalid.
        """
        options = dict(options or {})
        check_options(options, ("reset_mask", "episode", "episodes"))
        if options.get("episode") is not None and options.get("episodes") is not None:
            raise ValueError("`episode` and `episodes` are mutually exclusive: give one of them")
        mask = self._mask(options)
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, (int, np.integer)):
            self._np_random, self._np_random_seed = np_random(int(seed))
            seeds = [int(seed) + at for at in range(self.num_envs)]
        else:
            seeds = list(seed)
            if len(seeds) != self.num_envs:
                raise ValueError(f"{len(seeds)} seeds for {self.num_envs} environments")
        chosen = options.get("episodes")
        if chosen is None:
            chosen = [options.get("episode")] * self.num_envs
        if len(chosen) != self.num_envs:
            raise ValueError(f"{len(chosen)} episodes for {self.num_envs} environments")
        begin = [bool(begins) and parse_episode(episode) for begins, episode in zip(mask, chosen, strict=True)]
        for at in np.flatnonzero(mask):
            given = seeds[at]
            if given is not None or not self._seeded[at]:
                self._core.seed(int(at), checked_seed(given, self.np_random), 0)
                self._seeded[at] = True
        self._core.reset(begin, self._observations)
        infos: dict[str, Any] = {}
        for at in np.flatnonzero(mask):
            info = env_info(self._core.info(int(at)), self._config, self._core, int(at), self._atoms)
            infos = self._add_info(infos, info, int(at))
        if self._window is not None and all(self._core.has_begun(at) for at in range(self.num_envs)):
            self.render()
        return self._output(), infos

    def _output(self) -> Observations | View:
        if self._views is not None:
            return self._views(self._observations)
        return self._observations.copy() if self.copy else self._observations

    def _mask(self, options: Mapping[str, Any]) -> NDArray[np.bool_]:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError("`reset_mask` must be an array of bool")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"`reset_mask` must have shape ({self.num_envs},) and select at least one environment")
        return mask

    def step(
        self, actions: ArrayLike
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Run one tick in every environment.

        Args:
            actions: Integers of shape (num_envs,).

        Returns:
            The observations, the rewards, `terminated`, `truncated` and the infos.

        Raises:
            gymnasium.error.ResetNeeded: If an episode has not started, or has ended.
            gymnasium.error.InvalidAction: If an action is not 0, 1, 2 or 3. Then no car moves.
        """
        count = self.num_envs
        given = np.asarray(actions)
        if given.shape != (count,) or given.dtype.kind not in "iu":
            raise InvalidAction(f"expected integers of shape ({count},), not {given.dtype} of {given.shape}")
        rewards = np.empty(count, np.float64)
        terminated, truncated = np.empty(count, np.bool_), np.empty(count, np.bool_)
        columns = _columns(count, len(self._clauses))
        numbers = np.ascontiguousarray(given, np.int64)
        self._core.step(numbers, self._observations, (rewards, terminated, truncated), columns)
        infos = self._infos(columns)
        if self._atoms:
            infos["true_atoms"] = atoms = np.empty(count, object)
            for at in range(count):
                atoms[at] = self._core.atoms(at)
            infos["_true_atoms"] = np.ones(count, np.bool_)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and (terminated.any() or truncated.any()):
            self._add_ends(infos)
        if self._window is not None:
            self.render()
        return self._output(), rewards, terminated, truncated, infos

    def collect(self, network: _logicity.PolicyNetwork, random: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Run every environment under the stochastic policy of a network. The autoreset mode must be SameStep.

        Args:
            network: The network.
            random: Uniform random numbers from 0 to 1, float32 of shape (num_envs, steps), that select the actions.

        Returns:
            Arrays by name. `states` (uint32, the position of the observation among the distinct ones), `actions`
            (uint8), `rewards` (float32), `endings` (uint8: 0 none, 1 violation, 2 success, 3 horizon) and `next_values`
            (float32, the value of the state after the step, 0 if it is terminal), each of shape (num_envs, steps). The
            distinct observations: `inputs` (float32 of shape (observations, slots, inputs)) and `outputs` (float32 of
            shape (observations, 5): a logit per action, and the value).

        Raises:
            gymnasium.error.ResetNeeded: If an episode has not started.
            ValueError: If the network or the shape of `random` does not fit.
        """
        return self._core.collect(network, random, self._observations)

    def _infos(self, columns: _Columns) -> dict[str, Any]:
        infos = self._by_key(columns)
        if self._config.action_masks:
            infos["action_mask"] = masks_of(self._core, self.num_envs)
        for key in tuple(infos):
            infos["_" + key] = np.ones(self.num_envs, np.bool_)
        return infos

    def _by_key(self, columns: _Columns) -> dict[str, Any]:
        infos: dict[str, Any] = dict(zip(_COLUMNS, columns, strict=True))
        if not self._config.oracle:
            del infos["oracle_action"]
        return infos

    def _add_ends(self, infos: dict[str, Any]) -> None:
        """Add the last observations and infos of the episodes that ended in this step, for SameStep autoreset."""
        count = self.num_envs
        columns = _columns(count, len(self._clauses))
        ends = self._core.ended(columns)
        info = self._by_key(columns)
        if self._config.action_masks:
            info["action_mask"] = masks_of(self._core, count, ended=True)
        infos["final_obs"] = observations = np.empty(count, object)
        if self._atoms:
            info["true_atoms"] = np.empty(count, object)
        mask = np.zeros(count, np.bool_)
        for at, observation in ends:
            observations[at], mask[at] = observation.reshape(self._shape), True
            if self._atoms:
                info["true_atoms"][at] = self._core.ended_atoms(at)
        if self._views is not None:
            infos["final_obs"] = self._views.of_ended(observations, mask)
        for key in tuple(info):
            info["_" + key] = mask.copy()
        infos["final_info"], infos["_final_info"], infos["_final_obs"] = info, mask.copy(), mask

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the masks of `SPFEnv.action_masks`. The shape is (num_envs, 4).

        Rows of environments without an episode are `False`.

        Raises:
            gymnasium.error.Error: If the environments were made without `action_masks=True`.
        """
        check_masks(self._config)
        return masks_of(self._core, self.num_envs).astype(np.bool_)

    @property
    def clauses(self) -> tuple[str, ...]:
        """The names of the clauses that actions can violate, such as `S1`, in the order of `infos["violations"]`."""
        return self._clauses

    def episode(self, at: int) -> EpisodeStart:
        """Return the start of the current episode of an environment.

        Raises:
            IndexError: If the environment does not exist.
            gymnasium.error.ResetNeeded: If its episode has not started.
        """
        return cast(EpisodeStart, self._core.episode(self._checked_index(at)))

    def explain(self, at: int, fact: str | None = None) -> str:
        """Return proofs of the oracle's action in an environment, or of a fact, as `SPFEnv.explain` does.

        Raises:
            IndexError: If the environment does not exist.
            gymnasium.error.ResetNeeded: If its episode has not started.
        """
        return self._core.explain(self._checked_index(at), fact)

    def _checked_index(self, at: int) -> int:
        if not 0 <= operator.index(at) < self.num_envs:
            raise IndexError(f"no environment {at}: expected 0 to {self.num_envs - 1}")
        return at

    def render(self) -> tuple[Any, ...] | None:
        """Return one picture or text per environment, as `SPFEnv.render` does.

        The mode `human` shows all pictures in one window.

        Raises:
            gymnasium.error.ResetNeeded: If an episode has not started.
        """
        if self.render_mode is None:
            raise gymnasium.error.Error("the environments have no `render_mode`: pass one to `gymnasium.make_vec`")
        places = range(self.num_envs)
        return tuple(rendered(self._core.picture, self._core.text, places, self.render_mode, self._window))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window of the render mode `human`."""
        if self._window is not None:
            self._window.close()

    def state(self) -> list[dict[str, Any]]:
        """Return the state of each environment as plain data, which JSON can store.

        It has the seed of the episodes with the number of episodes started, and, if an episode has started, its start
        and the actions taken.
        """
        return [
            {"source": source, "episode": None if begun is None else begun[0], "actions": (begun or ({}, b""))[1].hex()}
            for source, begun in states_of(self._core, self.num_envs)
        ]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Restore what `state` of environments with the same arguments returned, and write their observations.

        Raises:
            InputError: If an episode is not valid in these environments (`invalid-episode`).
            ValueError: If the state is that of another number of environments, or not a state.
        """
        if len(state) != self.num_envs:
            raise ValueError(f"a state of {len(state)} environments, not of {self.num_envs}")
        try:
            states = [parsed_state(each) for each in state]
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError("state: expected what `state` of such environments returned") from error
        core = self._make_core()
        restore_states(core, states, self._observations)
        self._core = core
        self._seeded[:] = True

    def __getstate__(self) -> dict[str, Any]:
        """Return the task, the episodes and the actions taken, which determine the state."""
        state = {key: value for key, value in self.__dict__.items() if key != "_core"}
        return {**state, "_states": states_of(self._core, self.num_envs)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start the same episodes and take the same actions."""
        states = state.pop("_states")
        self.__dict__.update(state)
        self._core = self._make_core()
        restore_states(self._core, states, self._observations)

    def __copy__(self) -> SPFVectorEnv:
        """Return a deep copy, because two environments cannot share a city."""
        return deepcopy(self)


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the autoreset mode of a name or value, in any case and with or without underscores.

    Raises:
        ValueError: If the mode is unknown.
    """

    def plain(text: str) -> str:
        return text.rpartition(".")[2].replace("_", "").casefold()

    for known in AutoresetMode:
        if mode is known or isinstance(mode, str) and plain(mode) == plain(known.name):
            return known
    known_modes = ", ".join(f'"{known.value}"' for known in AutoresetMode)
    raise ValueError(f"autoreset_mode must be one of {known_modes}, not {mode!r}")


_Columns = tuple[
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.bool_],
    NDArray[np.int64],
    NDArray[np.int64],
    NDArray[np.bool_],
]


def _columns(count: int, clauses: int) -> _Columns:
    return (
        np.zeros(count, np.int64),
        np.zeros(count, np.float64),
        np.zeros(count, np.bool_),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
        np.zeros((count, clauses), np.bool_),
    )


_COLUMNS = ("oracle_action", "progress", "success", "steps", "seed", "violations")
