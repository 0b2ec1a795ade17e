"""A PettingZoo `ParallelEnv` that controls several cars of a city. Needs the extra `pettingzoo`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..errors import extra

with extra("pettingzoo"):
    import gymnasium
    from gymnasium.error import InvalidAction
    from gymnasium.spaces import Discrete, Space
    from gymnasium.utils.seeding import np_random
    from pettingzoo import ParallelEnv

from ..errors import did_you_mean
from ..types import EnvOptions, EpisodeStart
from .config import EnvConfig
from .interface import BaseEnv, checked_action, checked_options, checked_seed, infos_of, parse_episode
from .views import Observations, View

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["SPFParallelEnv"]


class SPFParallelEnv(BaseEnv, ParallelEnv[str, Any, "np.int64 | int"]):
    """Safe Path Following in which several cars are controlled agents, named `Car_1`, `Car_2`, ...

    These are the first cars, as many as `task.egos` of the configuration says, or every car without that key.
    Observations, actions, rewards and `info` of a car are those of `SPFEnv`. When the episode of a car ends, the car
    leaves `agents` and follows the rules. A curriculum of the configuration has no effect.

    Args:
        config, render_mode, options: As for `SPFEnv`.
    """

    metadata = {"name": "logicity_spf_v0", **BaseEnv.metadata}

    def __init__(
        self,
        config: str | os.PathLike[str] = "expert",
        *,
        render_mode: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Load the configuration and the rules."""
        self._load(EnvConfig(config, SPFParallelEnv, **options), render_mode, several=True)
        self._core = self._make_core(self._task)
        self.possible_agents = self._core.names()
        self.agents: list[str] = []
        self._index = {name: car for car, name in enumerate(self.possible_agents)}
        # Each car has its own space, so that seeding one does not affect the others.
        self.observation_spaces = {name: self._space() for name in self.possible_agents}
        self.action_spaces = {name: Discrete(len(self._actions)) for name in self.possible_agents}
        self._seeded = self._begun = False

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space of a car. Every call returns the same object.

        Raises:
            KeyError: If the car is unknown.
        """
        self._check_known(agent)
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        """Return the action space of a car. Every call returns the same object.

        Raises:
            KeyError: If the car is unknown.
        """
        self._check_known(agent)
        return self.action_spaces[agent]

    def _check_known(self, agent: str) -> None:
        if agent not in self._index:
            raise KeyError(self._unknown(agent))

    def _unknown(self, agent: object) -> str:
        return f"unknown car `{agent}`{did_you_mean(agent, self.possible_agents)}"

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start an episode, and return the observations and the infos by car, see `SPFEnv.reset`.

        Args:
            seed: The seed of a new sequence of episodes, from 0 to 2**64 - 1. `None` continues the sequence.
            options: `episode` is the number of a recorded episode of the split, whose horizon is then that of the
                configuration, or a mapping such as the property `episode`. Other keys have no effect, as PettingZoo
                requires.

        Raises:
            IndexError: If the recorded episode does not exist.
            InputError: If the mapping is not a valid episode of this environment (`invalid-episode`).
            TypeError: If `options` is not a mapping.
            ValueError: If the option is neither a number nor a mapping.
        """
        options = dict(checked_options(options))
        if seed is not None or not self._seeded:
            self._core.seed(0, checked_seed(seed, np_random(seed)[0]), 0)
            self._seeded = True
        episode = parse_episode(options.get("episode"))
        self.agents, self._begun = [], False
        observations = np.empty((len(self.possible_agents), *self._shape), np.float32)
        self._core.reset([episode], observations)
        self.agents, self._begun = list(self.possible_agents), True
        if self._window is not None:
            self.render()
        return self._by_car(observations), self._infos_by_car()

    def _by_car(self, observations: Observations) -> dict[str, Observations | View]:
        """Return the observations of the cars in `agents`."""
        return {name: self._output(observations[self._index[name]].copy()) for name in self.agents}

    def _infos_by_car(self) -> dict[str, dict[str, Any]]:
        """Return the infos of the cars in `agents`."""
        return {name: self._info(self._core.info(0, self._index[name])) for name in self.agents}

    def step(
        self, actions: dict[str, np.int64 | int]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Run one tick, and return observations, rewards, `terminated`, `truncated` and infos, each by car.

        Args:
            actions: One action per car in `agents`: 0 Slow, 1 Normal, 2 Fast or 3 Stop.

        Raises:
            gymnasium.error.ResetNeeded: If no episode has started.
            gymnasium.error.InvalidAction: If an action is missing, an action is not 0, 1, 2 or 3, a car is unknown, or
                a shield in the mode `mask` does not permit an action.
        """
        self._check_begun()
        live = self.agents
        if not isinstance(actions, Mapping):
            raise InvalidAction(f"expected a mapping from cars to actions, not {type(actions).__name__}")
        for name in actions:
            if name not in self._index:
                raise InvalidAction(self._unknown(name))
        if missing := [name for name in live if name not in actions]:
            raise InvalidAction(f"missing action of {', '.join(missing)}")
        count = len(self.possible_agents)
        numbers = np.zeros(count, np.int64)
        for name in live:
            numbers[self._index[name]] = checked_action(actions[name], self._actions)
        observations = np.empty((count, *self._shape), np.float32)
        rewards = np.empty(count, np.float64)
        terminated, truncated = np.empty(count, np.bool_), np.empty(count, np.bool_)
        if live:
            self._core.step(numbers, observations, (rewards, terminated, truncated), infos_of(count, self._clauses))
        places = {name: self._index[name] for name in live}
        shown, infos = self._by_car(observations), self._infos_by_car()
        self.agents = [name for name, at in places.items() if not (terminated[at] or truncated[at])]
        if self._window is not None:
            self.render()
        return (
            shown,
            {name: float(rewards[at]) for name, at in places.items()},
            {name: bool(terminated[at]) for name, at in places.items()},
            {name: bool(truncated[at]) for name, at in places.items()},
            infos,
        )

    @property
    def episode(self) -> EpisodeStart:
        """The start of the current episode. Pass it to `reset(options={"episode": ...})` to restart it."""
        self._check_begun()
        return cast(EpisodeStart, self._core.episode(0))

    def explain(self, agent: str, fact: str | None = None) -> str:
        """Return proofs of the action that the rules derive for a car, or of a fact, as `SPFEnv.explain` does.

        Raises:
            InputError: If the fact is invalid.
            ValueError: If the car is unknown.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_begun()
        if agent not in self._index:
            raise ValueError(self._unknown(agent))
        return self._core.explain(0, fact, self._index[agent])

    def explain_shield(self, agent: str) -> str:
        """Return which actions the shield permits a car now, as `SPFEnv.explain_shield` does.

        Raises:
            ValueError: If the car is unknown.
            gymnasium.error.Error: If the environment has no shield.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_shield()
        self._check_begun()
        if agent not in self._index:
            raise ValueError(self._unknown(agent))
        return self._core.explain_shield(0, self._index[agent])

    def render(self) -> Any:
        """Return a picture of the city, a uint8 array of shape (height, width, 3), or text in the mode `ansi`.

        The mode `human` shows it in a window, also after every reset and step, and returns `None`.
        """
        if self.render_mode is None:
            raise gymnasium.error.Error("the environment has no `render_mode`: pass one to `parallel_env`")
        self._check_begun()
        return self._rendered()[0]

    close = BaseEnv.close_extras
