"""The gymnasium environment of Safe Path Following (SPF). Needs the extra `gym`.

The agent drives a car along a route without violating a rule. The actions are 0 Slow, 1 Normal, 2 Fast and 3 Stop. An
episode terminates when the car reaches the goal or violates a rule. It is truncated at the horizon of the
configuration.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import checked_path, extra

with extra("gym"):
    import gymnasium
    from gymnasium.spaces import Discrete

from ..types import EnvOptions, Episodes, EpisodeStart
from .config import EnvConfig
from .interface import BaseEnv, HorizonSpec, checked_action, checked_options, checked_seed, parse_episode
from .views import Observations

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["SPFEnv"]


class SPFEnv(BaseEnv, gymnasium.Env[Any, np.int64]):
    """Safe Path Following with one controlled car.

    Observations are float32 arrays, or dictionaries of arrays:

    - `observation="groundings"` (default): the truth values, 0 or 1, of the ground atoms over the ego and the first 4
      other agents in its view. The shape is (85,), (140,) or (205,), depending on the predicates of the mode. With
      `task: {route_length: true}` in the configuration, the array has one more number, from 0 to 1.
    - `observation="state"`: the exact state, values from -1 to 1, of shape (20, 15), (20, 16) or (20, 19). The first
      row is the ego. The other rows are the other agents in its field of view, up to the number of rows.
    - `observation="relational"`: the truth values of `groundings` as tensors over the entities, see
      `logicity.envs.wrappers.RelationalObservation`.
    - `observation="graph"`: the same as a complete graph over the entities, see
      `logicity.envs.wrappers.GraphObservation`.

    `logicity describe` prints the meaning of each number of the first two kinds.

    The environment truncates episodes itself. `spec.max_episode_steps` is the horizon of the configuration, or the
    largest step limit of the recorded episodes.

    `info` has these keys:

    - `oracle_action` (int): the action that the rules derive in the current state.
    - `violations` (bool array, one value per clause): whether the last action violated the clause. `clauses` has the
      names of the clauses in the same order.
    - `progress` (float, 0 to 1): the completed share of the route.
    - `success` (bool): whether the car has reached the goal without violating a rule.
    - `steps` (int): the number of steps of the episode.
    - `seed` (int64): the 64 bits of the seed of the episode. `episode["seed"]` is `int(seed) % 2**64`.
    - `action_mask` (int8 array, one value per action), with `action_masks=True`: 1 if the action violates no clause in
      the current state, else 0, as `action_space.sample(mask)` expects.
    - `true_atoms` (tuple of strings), with `atoms=True`: the true atoms about the agents that the car observes, such as
      `IsTiro(Car_1)`, whatever sensors read.
    - `shield_mask` (int8 array, one value per action), with a shield (`logicity.shield`): 1 if the shield permits the
      action in the current state, else 0.
    - `shield_probabilities` (float64 array, one value per action), with a shield: the probability, 0 to 1, that the
      action is appropriate or safe; 0 or 1 in the modes `mask` and `override`.
    - `replaced_action` (int), with a shield: the action that it replaced in the last step, or -1.
    - `shield_violations` (bool array, one value per clause of the shield), with a shield: whether the replaced action
      violated the clause. `shield_clauses` has the names of the clauses.
    - `shield_reason` (string), with a shield, but not in vectors and environments with every car: the explanation of
      the replaced action, empty if there is none.

    Args:
        config: A run configuration: a built-in name such as `expert`, or a path.
        split: The set of agents: `train`, `val` or `test`.
        rules: A rule file that replaces the configuration's.
        overrides: A mapping that is merged into the configuration, such as `{"task": {"horizon": 100}}`.
        observation: The kind of observation: `groundings`, `state`, `relational` or `graph`.
        limits: The limits of each evaluation of the rules, such as `{"max_rows": 50_000_000}`.
        oracle: Whether `info` has `oracle_action`.
        action_masks: Whether `info` has `action_mask`. Enables `action_masks()`.
        predicates: The functions of external predicates, see `logicity.predicate`. Each environment calls them in every
            reset and step; those of a `SPFVectorEnv` wait for each other, since Python runs one function at a time.
        episodes: `drawn` generates new episodes. `drawn-demanding` does so, too, and omits the episodes in which the
            oracle's run, up to the horizon, has fewer constrained steps than `task.constrained_steps` of the
            configuration (default: 1). It raises `InputError` (`limit-exceeded`) if 1,000 draws in a row are omitted.
            `recorded` samples the recorded episodes of the split with replacement. The seed determines all three.
        atoms: Whether `info` has `true_atoms`. Wrappers that convert infos to tensors reject strings.
        render_mode: `human`, which shows every state in a window and needs the extra `human`, `rgb_array` or `ansi`.

    Raises:
        InputError: If the configuration, the rule file or an episode is invalid.
        OSError: If a file cannot be read.
        PredicateError: In a reset or step, if the function of a predicate fails. The environment then needs a reset.
        TypeError: If an option is unknown.
        ValueError: If `episodes`, the split or the kind of observation is unknown.
    """

    spec = HorizonSpec()

    def __init__(
        self,
        config: str | os.PathLike[str] = "expert",
        *,
        episodes: Episodes = "drawn",
        atoms: bool = False,
        render_mode: str | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Load the configuration and the rules."""
        self._load(EnvConfig(config, SPFEnv, **options), render_mode, episodes)
        self._atoms, self.observation_space, self.action_space = atoms, self._space(), Discrete(len(self._actions))
        self._core = self._make_core(self._task)
        self._overrides: dict[str, Any] = {}
        self._seeded = self._begun = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode, and return the observation and `info`.

        Args:
            seed: The seed of a new sequence of episodes, from 0 to 2**64 - 1. `None` continues the sequence.
            options: `episode` is the number of a recorded episode of the split, or a mapping such as `SPFEnv.episode`;
                the sequence then does not advance. `map` and `agents` replace these parts of the configuration for this
                episode.

        Raises:
            IndexError: If the recorded episode does not exist.
            InputError: If the mapping is not a valid episode of this environment (`invalid-episode`).
            TypeError: If `options` is not a mapping.
            ValueError: If an option is unknown, or its value is invalid.
        """
        super().reset(seed=seed)
        options = dict(checked_options(options, ("episode", "map", "agents")))
        if seed is not None or not self._seeded:
            self._core.seed(0, checked_seed(seed, self.np_random), 0)
            self._seeded = True
        self._apply_overrides({key: options[key] for key in ("map", "agents") if options.get(key) is not None})
        observation = np.empty(self._shape, np.float32)
        self._begun = False
        self._core.reset([parse_episode(options.get("episode"))], observation)
        self._begun = True
        return self._result(observation, self._core.info(0))

    def _result(self, observation: Observations, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Return what the caller of a reset or step gets, and show it in the window."""
        self._info(info)
        if self._atoms:
            info["true_atoms"] = self._core.atoms(0)
        if self._window is not None:
            self.render()
        return self._output(observation), info

    def _apply_overrides(self, overrides: dict[str, Any]) -> None:
        """Switch to the configuration with these overrides, and continue the sequence of episodes."""
        if overrides == self._overrides:
            return
        task = self._config.task(**overrides) if overrides else self._task
        if tuple(task.shape(self._kind)) != self._shape:
            raise ValueError("`map` and `agents` must not change the shape of observations")
        core = self._make_core(task)
        core.seed(0, *self._core.source(0))
        self._core, self._core_task, self._overrides = core, task, overrides

    def step(self, action: np.int64 | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run one tick, and return the observation, the reward, `terminated`, `truncated` and `info`.

        Args:
            action: 0 Slow, 1 Normal, 2 Fast or 3 Stop.

        Raises:
            gymnasium.error.ResetNeeded: If no episode has started, or the episode has ended.
            gymnasium.error.InvalidAction: If the action is not 0, 1, 2 or 3, or a shield in the mode `mask` does not
                permit it.
        """
        self._check_begun()
        array, number = np.empty(self._shape, np.float32), checked_action(action, self._actions)
        reward, terminated, truncated, info = self._core.step_one(number, array)
        observation, info = self._result(array, info)
        return observation, reward, terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Return the actions that the shield permits. Without a shield: those that violate no clause.

        The shape is (number of actions,). Without a shield, all values are `False` if every action violates a clause,
        which the rules of the modes do not allow.

        Raises:
            gymnasium.error.Error: If the environment has no shield and was made without `action_masks=True`.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_masks()
        self._check_begun()
        return cast("NDArray[np.bool_]", self._permitted()[0])

    def explain_shield(self) -> str:
        """Return which actions the shield permits now, and what its rules choose.

        The text lists the permitted actions and the others with the clauses that they violate. A proof follows of the
        action that the rules choose on the observed facts: with probabilities, those above 0.5.

        Raises:
            gymnasium.error.Error: If the environment has no shield.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_shield()
        self._check_begun()
        return self._core.explain_shield(0)

    @property
    def episode(self) -> EpisodeStart:
        """The start of the current episode. Pass it to `reset(options={"episode": ...})` to restart it."""
        self._check_begun()
        return cast(EpisodeStart, self._core.episode(0))

    def explain(self, fact: str | None = None) -> str:
        """Return proofs of the oracle's action as text, from the facts in the current view of the car.

        Args:
            fact: Explain instead why this fact holds or does not hold there: the name of any predicate, about the car,
                or a fact such as `IsClose(Car_1, Car_2)`.

        Raises:
            InputError: If the fact is invalid.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_begun()
        return self._core.explain(0, fact)

    def write_trace(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the trace of the episode so far, in the format of `logicity run`.

        `logicity view` converts a trace to an HTML page. For every step, the trace records the observed entities, the
        required action, and the clauses that the action violated. The trace contains the rules and the configuration,
        with `overrides` and with `map` and `agents` of a reset.

        Raises:
            FileExistsError: If this function did not write the file, or it has changed since, without `overwrite`.
            OSError: If the file cannot be written, or another process writes it.
            ValueError: If the episode has no steps yet.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_begun()
        taken = self._core.taken(0)
        if not taken:
            raise ValueError("the episode has no steps yet: call `step` before `write_trace`")
        target = (checked_path("path", path), "write_trace", overwrite)
        self._core_task.write_trace(self._config.split, self._core.episode(0), taken, target)

    def render(self) -> Any:
        """Return a picture of the city, a uint8 array of shape (height, width, 3), or text in the mode `ansi`.

        The picture has a frame around the controlled car, a line for its route, and a square for its goal. The mode
        `human` shows it in a window, also after every reset and step, and returns `None`.
        """
        if self.render_mode is None:
            raise gymnasium.error.Error("the environment has no `render_mode`: pass one to `gymnasium.make`")
        self._check_begun()
        return self._rendered()[0]

    close = BaseEnv.close_extras
