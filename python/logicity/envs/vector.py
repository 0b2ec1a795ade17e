"""The vectorized gymnasium environment of Safe Path Following, and what it shares with that of several egos.

Needs the extra `gym`.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Mapping, Sequence
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
from . import interface
from .config import EnvConfig
from .interface import BaseEnv, HorizonSpec

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["BaseVectorEnv", "SPFVectorEnv"]


class BaseVectorEnv(BaseEnv):
    """The common base of vectorized environments, whose arrays differ in their leading shape.

    Attributes:
        num_envs: The number of environments.
        autoreset_mode: When the next episode begins.
        copy: Whether every call returns a new array of observations.
    """

    num_envs: int
    autoreset_mode: AutoresetMode
    copy: bool
    #: The leading shape of all arrays: the environments, and the egos if there are several.
    _lead: tuple[int, ...]

    def _begin(
        self,
        config: EnvConfig,
        batch: tuple[int, AutoresetMode | str, int],
        episodes: Episodes,
        atoms: bool,
        render_mode: str | None,
        several: bool = False,
    ) -> None:
        """Load the configuration and the rules, and make the environments.

        `batch` is the number of environments, their autoreset mode and the number of threads.
        """
        num_envs, mode, num_threads = batch
        self.num_envs = checked_integer("num_envs", num_envs, 1, _logicity.ENVS_MAX)
        threads = checked_integer("num_threads", num_threads, 1, _logicity.THREADS_MAX)
        self.autoreset_mode = _autoreset_mode(mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._load(config, render_mode, episodes, (self.num_envs, self.autoreset_mode.value, threads), several)
        self._atoms = atoms
        self._core = self._make_core(self._task)
        self._lead = (self.num_envs, self._core.egos()) if several else (self.num_envs,)
        self._observations = np.zeros((*self._lead, *self._shape), np.float32)
        self._seeded = np.zeros(self.num_envs, np.bool_)

    def _make_core(self, task: _logicity.Task) -> _logicity.VectorEnv:
        core = super()._make_core(task)
        if self._atoms:
            core.keep_last_atoms()
        return core

    def _generator(self, seed: int | None) -> np.random.Generator:
        """Return the generator of the seeds of environments; `seed` reseeds it."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes, and return the observations and the infos.

        Args:
            seed: The seeds of new sequences of episodes. A number s gives environment i the seed s + i. A list has one
                seed per environment, where `None` continues the sequence.
            options: `reset_mask`, bool of shape (num_envs,), selects the environments to reset (default: all).
                `episode` sets the episode of all of them, as in `SPFEnv.reset`. `episodes` is a list of such values,
                one per environment.

        Raises:
            gymnasium.error.Error: If a seed has a wrong type or is out of range.
            IndexError, InputError, TypeError, ValueError: As for `SPFEnv.reset`.
        """
        options = dict(interface.checked_options(options, ("reset_mask", "episode", "episodes")))
        if options.get("episode") is not None and options.get("episodes") is not None:
            raise ValueError("`episode` and `episodes` are mutually exclusive: give one of them")
        mask, count = self._mask(options), self.num_envs
        generator = self._generator(None)
        if isinstance(seed, (int, np.integer)):
            generator = self._generator(int(seed))
            seed = [int(seed) + at for at in range(count)]
        if seed is not None and not _is_list(seed):
            raise gymnasium.error.Error(f"seed: expected an integer or a list, not {type(seed).__name__}")
        seeds = [None] * count if seed is None else list(seed)
        chosen = options.get("episodes")
        if chosen is None:
            chosen = [options.get("episode")] * count
        if not _is_list(chosen):
            raise TypeError(f"episodes: expected a list, not {type(chosen).__name__}")
        for name, values in {"seeds": seeds, "episodes": chosen}.items():
            if len(values) != count:
                raise ValueError(f"{len(values)} {name} for {count} environments")
        begin = [bool(begins) and interface.parse_episode(each) for begins, each in zip(mask, chosen, strict=True)]
        places = np.flatnonzero(mask).tolist()
        for at in places:
            given = seeds[at]
            if given is not None or not self._seeded[at]:
                self._core.seed(at, interface.checked_seed(given, generator), 0)
                self._seeded[at] = True
        self._core.reset(begin, self._observations)
        columns = self._columns()
        self._core.infos(columns, places)
        infos = self._infos(columns, mask)
        for key, values in infos.items():
            if not key.startswith("_") and values.dtype != object:
                # As in gymnasium's vectors.
                values[~mask] = 0
        if self._window is not None and all(self._core.has_begun(at) for at in range(count)):
            self.render()
        return self._observed(), infos

    def _observed(self) -> Any:
        return self._output(self._observations.copy() if self.copy and self._views is None else self._observations)

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
        """Run one tick, and return the observations, the rewards, `terminated`, `truncated` and the infos.

        Raises:
            gymnasium.error.ResetNeeded: If an episode has not started, or has ended.
            gymnasium.error.InvalidAction: If the actions are not integers from 0 to 3, of the shape of the action
                space, or a shield in the mode `mask` does not permit one. Then no car moves.
        """
        given = np.asarray(actions)
        if given.shape != self._lead or given.dtype.kind not in "iu":
            raise InvalidAction(f"expected integers of shape {self._lead}, not {given.dtype} of {given.shape}")
        rewards = np.empty(self._rows, np.float64)
        terminated, truncated = np.empty(self._rows, np.bool_), np.empty(self._rows, np.bool_)
        columns = self._columns()
        numbers = np.ascontiguousarray(given, np.int64).reshape(-1)
        self._core.step(numbers, self._observations, (rewards, terminated, truncated), columns)
        infos = self._infos(columns, np.ones(self.num_envs, np.bool_))
        if self.autoreset_mode is AutoresetMode.SAME_STEP and (terminated.any() or truncated.any()):
            self._add_ends(infos)
        if self._window is not None:
            self.render()
        lead = self._lead
        return self._observed(), rewards.reshape(lead), terminated.reshape(lead), truncated.reshape(lead), infos

    def _collected(
        self, networks: list[_logicity.PolicyNetwork], random: NDArray[np.float32]
    ) -> list[dict[str, NDArray[Any]]]:
        """Run every environment under the stochastic policies of networks: one for all egos, or one for each."""
        if random.shape[:-1] != self._lead:
            shape = ", ".join(map(str, (*self._lead, "steps")))
            raise ValueError(f"expected random numbers of shape ({shape}), not {random.shape}")
        return self._core.collect(networks, random.reshape(self._rows, -1), self._observations)

    def _columns(self) -> Any:
        return interface.infos_of(self._rows, self._clauses)

    def _infos(self, columns: Any, mask: NDArray[np.bool_], ended: bool = False) -> dict[str, Any]:
        """Return the infos of the environments in the mask, or those of the episodes that ended in the last step."""
        infos: dict[str, Any] = dict(zip(interface.INFOS, columns, strict=True))
        if not self._config.oracle:
            del infos["oracle_action"]
        if self._config.action_masks:
            infos["action_mask"] = self._masks(ended)
        if (clauses := self.shield_clauses) is not None:
            infos.update(self._shield_infos(len(clauses), ended))
        if self._atoms:
            infos["true_atoms"] = np.empty(self._rows, object)
            egos = self._rows // self.num_envs
            for row in np.flatnonzero(np.repeat(mask, egos)).tolist():
                atoms = self._core.ended_atoms if ended else self._core.atoms
                infos["true_atoms"][row] = atoms(*divmod(row, egos))
        shaped = {key: values.reshape(*self._lead, *values.shape[1:]) for key, values in infos.items()}
        return shaped | {f"_{key}": mask.copy() for key in infos}

    def _add_ends(self, infos: dict[str, Any]) -> None:
        """Add the last observations and infos of the episodes that ended in this step, for SameStep autoreset."""
        columns, observations = self._columns(), np.empty(self.num_envs, object)
        mask = np.zeros(self.num_envs, np.bool_)
        for at, observation in self._core.ended(columns):
            observations[at], mask[at] = observation.reshape(*self._lead[1:], *self._shape), True
        if not mask.any():
            return
        infos["final_obs"] = observations if self._views is None else self._views.of_ended(observations, mask)
        infos["final_info"] = self._infos(columns, mask, ended=True)
        infos["_final_info"], infos["_final_obs"] = mask.copy(), mask

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the masks of `SPFEnv.action_masks`, for every environment and, if there are several, every ego.

        Rows of environments without an episode are `False`.

        Raises:
            gymnasium.error.Error: If the environments have no shield and were made without `action_masks=True`.
        """
        return self._permitted().reshape(*self._lead, -1)

    def episode(self, at: int) -> EpisodeStart:
        """Return the start of the current episode of an environment.

        Raises:
            IndexError: If the environment does not exist.
            gymnasium.error.ResetNeeded: If its episode has not started.
        """
        return cast(EpisodeStart, self._core.episode(self._checked_index(at)))

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
            raise gymnasium.error.Error("the environments have no `render_mode`: pass one when you make them")
        return tuple(self._rendered())

    def state(self) -> list[dict[str, Any]]:
        """Return the state of each environment as plain data, which JSON can store.

        It has the seed of the episodes with the number of episodes started, and, if an episode has started, its start
        and the actions taken.
        """
        egos = {} if len(self._lead) == 1 else {"egos": self._lead[1]}
        return [
            {
                **egos,
                "source": source,
                "episode": None if begun is None else begun[0],
                "actions": (begun or ({}, b""))[1].hex(),
            }
            for source, begun in self._states()
        ]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Restore what `state` of environments with the same arguments returned, and write their observations.

        Raises:
            InputError: If an episode is not valid in these environments (`invalid-episode`).
            ValueError: If the state is that of another number of environments, or not a state.
        """
        if len(state) != self.num_envs:
            raise ValueError(f"a state of {len(state)} environments, not of {self.num_envs}")
        states: interface.States = []
        egos = self._rows // self.num_envs
        for each in state:
            if isinstance(each, Mapping) and (other := each.get("egos", 1)) != egos:
                raise ValueError(f"a state of {other} egos, not of {egos}")
        try:
            for each in state:
                seed, begun = (checked_integer("source", number) for number in each["source"])
                actions = bytes.fromhex(each["actions"])
                states.append(([seed, begun], None if each["episode"] is None else (dict(each["episode"]), actions)))
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError("state: expected what `state` of such environments returned") from error
        core = self._make_core(self._task)
        interface.restore_states(core, states, self._observations)
        self._core = core
        self._seeded[:] = True


class SPFVectorEnv(BaseVectorEnv, VectorEnv[Any, NDArray[np.int64], NDArray[Any]]):
    """A vectorized environment of Safe Path Following: one call steps all environments.

    Vectorized results equal those of individual `SPFEnv` environments with the same seeds. `reset(seed=s)` gives
    environment i the seed s + i. Not thread-safe: concurrent use raises `RuntimeError`.

    `infos` have no `shield_reason`; `explain_shield` explains what a shield says. Observations have shape (num_envs,
    ...), or are dictionaries of such arrays, computed for all environments at once.
    Rewards (float64), `terminated` (bool) and `truncated` (bool) have shape (num_envs,). `infos` has one array per key
    of `SPFEnv`'s `info`, and its mask under `_key`. In the autoreset mode SameStep, `final_obs` and `final_info` have
    the last observations and infos of the episodes that ended.

    Args:
        num_envs: The number of environments, at most 65536.
        config, episodes, atoms, render_mode, options: As for `SPFEnv`.
        autoreset_mode: An `AutoresetMode`, or its name or value in any case: `"SAME_STEP"`, `"SameStep"`.
        num_threads: The number of threads of a step.
        copy: Whether every call returns a new array of observations. `False` is faster: every call overwrites and
            returns the same array. Observations of the kinds `relational` and `graph` are always new.
        max_episode_steps: The horizon, which `gymnasium.make_vec` passes if it gets the `spec` of such environments. It
            cannot change the horizon: `overrides={"task": {"horizon": 100}}` does.

    Raises:
        InputError, OSError, TypeError: As for `SPFEnv`.
        ValueError: If a name is unknown, the number of environments or threads is out of range, or `max_episode_steps`
            is not the horizon.
    """

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
        VectorEnv.__init__(self)
        batch = num_envs, autoreset_mode, num_threads
        self._begin(EnvConfig(config, SPFVectorEnv, **options), batch, episodes, atoms, render_mode)
        self.copy = copy
        self.single_observation_space, self.single_action_space = self._space(), Discrete(len(self._actions))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        horizon = self._task.max_steps(self._config.split, self._recorded)
        if max_episode_steps is not None and max_episode_steps != horizon:
            raise interface.wrong_limit(max_episode_steps, horizon)

    def _generator(self, seed: int | None) -> np.random.Generator:
        if seed is not None:
            self._np_random, self._np_random_seed = np_random(seed)
        return self.np_random

    def collect(self, network: _logicity.PolicyNetwork, random: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        """Run every environment under the stochastic policy of a network. The autoreset mode must be SameStep.

        Uniform random numbers from 0 to 1, float32 of shape (num_envs, steps), select the actions.

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
        return self._collected([network], random)[0]

    def explain(self, at: int, fact: str | None = None) -> str:
        """Variant of `SPFEnv.explain` for an environment. The exceptions include those of `episode`."""
        return self._core.explain(self._checked_index(at), fact)

    def explain_shield(self, at: int) -> str:
        """Variant of `SPFEnv.explain_shield` for an environment. The exceptions include those of `episode`."""
        self._check_shield()
        return self._core.explain_shield(self._checked_index(at))


def _is_list(values: object) -> bool:
    """Return whether values are a sequence or an array with one axis, and no text."""
    if isinstance(values, np.ndarray):
        return values.ndim == 1
    return isinstance(values, Sequence) and not isinstance(values, (str, bytes))


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the autoreset mode of a name or value, in any case and with or without underscores."""
    plain = mode.rpartition(".")[2].replace("_", "").casefold() if isinstance(mode, str) else None
    for known in AutoresetMode:
        if mode is known or plain == known.name.replace("_", "").casefold():
            return known
    known_modes = ", ".join(f'"{known.value}"' for known in AutoresetMode)
    raise ValueError(f"autoreset_mode must be one of {known_modes}, not {mode!r}")
