"""Gymnasium environments for Safe Path Following (SPF): `SPFEnv` and the vectorized `SPFVectorEnv`.

`import logicity` registers them: `gymnasium.make("logicity/SPF-Expert-v0")` makes an `SPFEnv`, and
`gymnasium.make_vec("logicity/SPF-Expert-v0", num_envs=256)` makes an `SPFVectorEnv`. This module needs the extra `gym`.

The agent drives a car along a route without violating a rule. The actions are 0 Slow, 1 Normal, 2 Fast and 3 Stop. An
episode terminates when the car reaches the goal or violates a rule. It is truncated at the horizon of the
configuration.
"""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from copy import copy, deepcopy
from types import FrameType
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _logicity
from .city import ACTIONS
from .errors import checked_integer, checked_path, missing_extra

try:
    import gymnasium
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
    from gymnasium.spaces import Box, Discrete, Space
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise missing_extra("gym", error) from error

from .env_config import ArrayKind, EnvConfig, EnvOptions, Episodes
from .layout import View, Views, views_of
from .window import Window

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["EpisodeAgent", "EpisodeStart", "Observations", "OracleRun", "SPFEnv", "SPFVectorEnv"]

RENDER_MODES = ["human", "rgb_array", "ansi"]
RENDER_FPS = 10

Observations = NDArray[np.float32]
"""Observations: float32, one row per environment if there are several."""


class EpisodeAgent(TypedDict):
    """An agent at the start of an episode. `start` and `goal` are (row, column) in cells."""

    id: str
    concepts: list[str]
    priority: int
    start: tuple[int, int]
    goal: tuple[int, int]


#: The oracle's run of an episode: steps, return, and the number of steps in which the rules require each action.
OracleRun = TypedDict("OracleRun", {"steps": int, "return": float, "constrained": dict[str, int]})


class EpisodeStart(TypedDict):
    """The start of an episode: its seed, its agents in list order, and the oracle's run if it is known.

    A seed is an integer from 0 to 2**64 - 1. The seeds of recorded episodes use all 64 bits, so formats that store
    numbers as 64-bit floats, such as JavaScript's, lose precision.
    """

    seed: int
    agents: list[EpisodeAgent]
    oracle: OracleRun | None


def observation_space(task: _logicity.Task, kind: ArrayKind, views: Views | None) -> Space[Any]:
    """Return the observation space of a task: that of the views if there are any."""
    if views is not None:
        return views.space()
    return Box(0.0 if kind == "groundings" else -1.0, 1.0, tuple(task.shape(kind)), np.float32)


def checked_seed(seed: int | None, generator: np.random.Generator) -> int:
    """Return the seed of a sequence of episodes: `seed`, or a number from the generator if `seed` is `None`.

    Raises:
        gymnasium.error.Error: If the seed is out of range, or not an integer.
    """
    if seed is None:
        return int(generator.integers(2**53))
    try:
        return checked_integer("seed", seed)
    except (TypeError, ValueError) as error:
        # As gymnasium itself does for negative seeds.
        raise gymnasium.error.Error(str(error)) from None


def config_overrides(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of the configuration that the options of a reset replace."""
    return {key: options[key] for key in ("map", "agents") if options.get(key) is not None}


class _HorizonSpec:
    """Sets `max_episode_steps` of the spec that `gymnasium.make` assigns to an environment.

    The environments truncate episodes themselves, so the registered spec has no `max_episode_steps`: gymnasium would
    add a `TimeLimit`, which knows neither the horizons of recorded episodes nor those of overrides.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    def __get__(self, env: Any, owner: type | None = None) -> EnvSpec | None:
        return getattr(env, self._name, None)

    def __set__(self, env: SPFEnv | SPFVectorEnv, spec: EnvSpec | None) -> None:
        if spec is not None:
            horizon = env._task.max_steps(env._config.split, env._recorded)
            _check_limit_of_make(sys._getframe(1), horizon)
            spec = copy(spec)
            spec.max_episode_steps = horizon
            # `make_vec` adds it to the arguments if it gets such a spec.
            spec.kwargs = {name: value for name, value in spec.kwargs.items() if name != "max_episode_steps"}
        setattr(env, self._name, spec)


def _check_limit_of_make(frame: FrameType, horizon: int) -> None:
    """Check the `max_episode_steps` that `gymnasium.make` is about to apply, if `frame` is a call of it.

    `gymnasium.make` passes it to no environment: after this check, it adds a `TimeLimit`, which would cut off episodes
    without the rewards of their ends.

    Raises:
        ValueError: If the limit is not the horizon.
    """
    if (frame.f_globals.get("__name__"), frame.f_code.co_name) != ("gymnasium.envs.registration", "make"):
        return
    limit = frame.f_locals.get("max_episode_steps")
    # -1 means no `TimeLimit`.
    if limit not in (None, -1, horizon):
        raise wrong_limit(limit, horizon)
    stored = getattr(frame.f_locals.get("env_spec"), "max_episode_steps", None)
    if limit is None and stored is not None and stored < horizon:
        raise wrong_limit(stored, horizon)


def wrong_limit(limit: int, horizon: int) -> ValueError:
    """Return the exception for a `max_episode_steps` that is not the horizon."""
    return ValueError(
        f"max_episode_steps: the horizon is {horizon}, not {limit}: set it with "
        f'`overrides={{"task": {{"horizon": {limit}}}}}`'
    )


class SPFEnv(gymnasium.Env[Any, np.int64]):
    """Safe Path Following with one controlled car.

    Observations are float32 arrays, or dictionaries of arrays:

    - `observation="groundings"` (default): the truth values, 0 or 1, of the ground atoms over the ego and the first 4
      other agents in its view. The shape is (85,), (140,) or (205,), depending on the predicates of the mode. With
      `task: {route_length: true}` in the configuration, the array has one more number, from 0 to 1.
    - `observation="state"`: the exact state, values from -1 to 1, of shape (20, 15), (20, 16) or (20, 19). The first
      row is the ego. The other rows are the other agents in its field of view, up to the number of rows.
    - `observation="relational"`: the truth values of `groundings` as tensors over the entities, see
      `logicity.views.RelationalObservation`.
    - `observation="graph"`: the same as a complete graph over the entities, see `logicity.views.GraphObservation`.

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
    - `true_atoms` (tuple of strings), with `atoms=True`: the true atoms that the car observes, such as `IsTiro(Car_1)`.

    Args:
        config: A run configuration: a built-in name such as `expert`, or a path.
        split: The set of agents: `train`, `val` or `test`.
        rules: A rule file that replaces the configuration's.
        overrides: A mapping that is merged into the configuration, such as `{"task": {"horizon": 100}}`.
        observation: The kind of observation: `groundings`, `state`, `relational` or `graph`.
        limits: The limits of each evaluation of the rules, such as `{"max_rows": 50_000_000}`.
        oracle: Whether `info` has `oracle_action`.
        action_masks: Whether `info` has `action_mask`. Enables `action_masks()`.
        episodes: `drawn` generates new episodes. `drawn-demanding` does so, too, and omits the episodes in which the
            oracle's run, up to the horizon, has fewer constrained steps than `task.constrained_steps` of the
            configuration (default: 1). It raises `InputError` (`limit-exceeded`) if 1,000 draws in a row are omitted.
            `recorded` samples the recorded episodes of the split with replacement. The seed determines all three.
        atoms: Whether `info` has `true_atoms`. Wrappers that convert infos to tensors reject strings.
        render_mode: `human`, which shows every state in a window and needs the extra `human`, `rgb_array` or `ansi`.

    Raises:
        InputError: If the configuration, the rule file or an episode is invalid.
        OSError: If a file cannot be read.
        TypeError: If an option is unknown.
        ValueError: If `episodes`, the split or the kind of observation is unknown.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": RENDER_FPS}
    spec = _HorizonSpec()

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
        self._config = EnvConfig(config, SPFEnv, **options)
        self._kind, self._atoms = self._config.array_kind, atoms
        self._episodes, self._recorded = episodes, episodes == "recorded"
        self.render_mode, self._window = checked_render_mode(render_mode)
        self._task = self._config.task()
        self._clauses = self._task.clauses()
        self._views, self._shape = views_of(self._task, self._config.observation), tuple(self._task.shape(self._kind))
        self.observation_space = observation_space(self._task, self._kind, self._views)
        self.action_space = Discrete(4)
        self._base = self._make_core(self._task)
        self._core, self._core_task = self._base, self._task
        self._overrides: dict[str, Any] = {}
        self._seeded = self._begun = False

    def _make_core(self, task: _logicity.Task) -> _logicity.VectorEnv:
        config = self._config
        core = _logicity.VectorEnv(task, config.split, 1, "Disabled", self._kind, self._episodes, 1)
        if config.action_masks:
            core.judge_actions()
        return core

    def _new_observation(self) -> Observations:
        return np.empty(self._shape, np.float32)

    def _output(self, observation: Observations) -> Observations | View:
        return observation if self._views is None else self._views(observation)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: The seed of a new sequence of episodes, from 0 to 2**64 - 1. `None` continues the sequence.
            options: `episode` is the number of a recorded episode of the split, or a mapping such as `SPFEnv.episode`;
                the sequence then does not advance. `map` and `agents` replace these parts of the configuration for this
                episode.

        Returns:
            The observation, and `info`.

        Raises:
            IndexError: If the recorded episode does not exist.
            InputError: If the mapping is not a valid episode of this environment (`invalid-episode`).
            ValueError: If an option is unknown, or its value is invalid.
        """
        super().reset(seed=seed)
        options = options or {}
        check_options(options, ("episode", "map", "agents"))
        if seed is not None or not self._seeded:
            self._base.seed(0, checked_seed(seed, self.np_random), 0)
            self._seeded = True
        self._apply_overrides(config_overrides(options))
        observation = self._new_observation()
        self._begun = False
        self._core.reset([parse_episode(options.get("episode"))], observation)
        if self._core is not self._base:
            self._base.seed(0, *self._core.source(0))
        self._begun = True
        if self._window is not None:
            self.render()
        return self._output(observation), _env_info(self._core.info(0), self._config, self._core, 0, self._atoms)

    def _apply_overrides(self, overrides: dict[str, Any]) -> None:
        """Switch to the configuration with these overrides, and continue the sequence of episodes."""
        if not overrides:
            self._core, self._core_task, self._overrides = self._base, self._task, {}
            return
        if self._core is self._base or overrides != self._overrides:
            task = self._config.task(**overrides)
            if tuple(task.shape(self._kind)) != self._shape:
                raise ValueError("`map` and `agents` must not change the shape of observations")
            self._core, self._core_task, self._overrides = self._make_core(task), task, overrides
        self._core.seed(0, *self._base.source(0))

    def step(self, action: np.int64 | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Run one tick with an action of the controlled car.

        Args:
            action: 0 Slow, 1 Normal, 2 Fast or 3 Stop.

        Returns:
            The observation, the reward, `terminated`, `truncated` and `info`.

        Raises:
            gymnasium.error.ResetNeeded: If no episode has started, or the episode has ended.
            gymnasium.error.InvalidAction: If the action is not 0, 1, 2 or 3.
        """
        self._check_begun()
        observation = self._new_observation()
        reward, terminated, truncated, info = self._core.step_one(checked_action(action), observation)
        info = _env_info(info, self._config, self._core, 0, self._atoms)
        if self._window is not None:
            self.render()
        return self._output(observation), reward, terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """Return for each action whether it violates no clause in the current state. The shape is (4,).

        If every action violates a clause, which the rules of the modes do not allow, all values are `False`.

        Raises:
            gymnasium.error.Error: If the environment was made without `action_masks=True`.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        check_masks(self._config)
        self._check_begun()
        return cast("NDArray[np.bool_]", _action_masks(self._core, 1)[0].astype(np.bool_))

    @property
    def clauses(self) -> tuple[str, ...]:
        """The names of the clauses that actions can violate, such as `S1`, in the order of `info["violations"]`."""
        return self._clauses

    @property
    def episode(self) -> EpisodeStart:
        """The start of the current episode. Pass it to `reset(options={"episode": ...})` to restart it."""
        self._check_begun()
        return cast(EpisodeStart, self._core.episode(0))

    def _check_begun(self) -> None:
        if not self._begun:
            raise ResetNeeded("no episode has started: call `reset`")

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

        Args:
            path: The file of the trace.
            overwrite: Whether to replace a file that this function did not write, or that has changed since.

        Raises:
            FileExistsError: If the file must not be replaced.
            OSError: If the file cannot be written, or another process writes it.
            TypeError: If the path is not a string or an `os.PathLike[str]`.
            ValueError: If the episode has no steps yet.
            gymnasium.error.ResetNeeded: If no episode has started.
        """
        self._check_begun()
        taken = self._core.taken(0)
        if not taken:
            raise ValueError("the episode has no steps yet: call `step` before `write_trace`")
        task = self._config.task(**self._overrides) if self._overrides else self._core_task
        name = checked_path("path", path)
        task.write_trace(self._config.split, self._core.episode(0), taken, (name, "write_trace", overwrite))

    def render(self) -> Any:
        """Return a picture of the city, a uint8 array of shape (height, width, 3), or text in the mode `ansi`.

        The picture has a frame around the controlled car, a line for its route, and a square for its goal. The mode
        `human` shows it in a window, also after every reset and step, and returns `None`.
        """
        if self.render_mode is None:
            raise gymnasium.error.Error("the environment has no `render_mode`: pass one to `gymnasium.make`")
        self._check_begun()
        return rendered(self._core.picture, self._core.text, range(1), self.render_mode, self._window)[0]

    def close(self) -> None:
        """Close the window of the render mode `human`."""
        if self._window is not None:
            self._window.close()

    def __getstate__(self) -> dict[str, Any]:
        """Return the tasks, the episode and the actions taken, which determine the state."""
        state = {key: value for key, value in self.__dict__.items() if key not in ("_base", "_core")}
        return {**state, "_states": _states(self._core), "_source": self._base.source(0)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start the same episode and take the same actions."""
        states, source = state.pop("_states"), state.pop("_source")
        self.__dict__.update(state)
        self._base = self._core = self._make_core(self._task)
        if self._core_task is not self._task:
            self._core = self._make_core(self._core_task)
        _restore(self._core, states, self._new_observation())
        self._base.seed(0, *source)

    def __copy__(self) -> SPFEnv:
        """Return a deep copy, because two environments cannot share a city."""
        return deepcopy(self)


#: The states of environments: the seed of the episodes and the number of episodes started, and, if an episode has
#: started, its start and the actions taken.
_States = list[tuple[list[int], tuple[dict[str, Any], bytes] | None]]


def _states(core: _logicity.VectorEnv, count: int = 1) -> _States:
    """Return the states of all environments."""
    return [
        (core.source(at), (core.episode(at), core.taken(at)) if core.has_begun(at) else None) for at in range(count)
    ]


def _parsed_state(state: Mapping[str, Any]) -> tuple[list[int], tuple[dict[str, Any], bytes] | None]:
    """Return the state of an environment from the plain data of `SPFVectorEnv.state`.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: If it is something else.
    """
    seed, begun = (checked_integer("source", number) for number in state["source"])
    actions = bytes.fromhex(state["actions"])
    return [seed, begun], None if state["episode"] is None else (dict(state["episode"]), actions)


def _restore(core: _logicity.VectorEnv, states: _States, observations: Observations) -> None:
    """Restore the states of all environments."""
    for at, (source, _) in enumerate(states):
        core.seed(at, *source)
    core.replay([episode for _, episode in states], observations)


def info_dict(info: dict[str, Any], config: EnvConfig) -> dict[str, Any]:
    """Convert the `info` of an episode to the types that gymnasium expects, and remove what the options exclude."""
    info["seed"] = np.int64(info["seed"])
    if not config.oracle:
        del info["oracle_action"]
    return info


def _env_info(
    info: dict[str, Any], config: EnvConfig, core: _logicity.VectorEnv, at: int, atoms: bool
) -> dict[str, Any]:
    """Convert the `info` of one environment. With `atoms`, add its true atoms."""
    info_dict(info, config)
    if atoms:
        info["true_atoms"] = core.atoms(at)
    return info


def _action_masks(core: _logicity.VectorEnv, count: int, ended: bool = False) -> NDArray[np.int8]:
    """Return the allowed actions of all environments, or those of the episodes that ended in the last step."""
    masks = np.zeros((count, len(ACTIONS)), np.int8)
    core.action_masks(masks, ended)
    return masks


def check_masks(config: EnvConfig) -> None:
    """Check that the environments compute the allowed actions.

    Raises:
        gymnasium.error.Error: If they do not.
    """
    if not config.action_masks:
        raise gymnasium.error.Error("the environment has no action masks: make it with `action_masks=True`")


def checked_render_mode(mode: str | None) -> tuple[str | None, Window | None]:
    """Check a render mode, and return it with the window that it needs.

    Raises:
        ImportError: If the mode is `human`, and pygame is not installed.
        gymnasium.error.UnsupportedMode: If the mode is unknown.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise UnsupportedMode(f"unknown render mode `{mode}`; known: {', '.join(RENDER_MODES)}")
    return mode, Window(RENDER_FPS) if mode == "human" else None


def check_options(options: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Check the names of the options of a reset.

    Raises:
        ValueError: If an option is unknown.
    """
    for option in options:
        if option not in known:
            raise ValueError(f"unknown option `{option}`; known: {', '.join(known)}")


def checked_action(action: Any) -> int:
    """Check an action and return it as an int.

    Raises:
        gymnasium.error.InvalidAction: If the action is not 0, 1, 2 or 3.
    """
    try:
        number = operator.index(action)
    except TypeError:
        number = -1
    if not 0 <= number < len(ACTIONS):
        known = ", ".join(f"{number} {name}" for number, name in enumerate(ACTIONS))
        raise InvalidAction(f"{action!r} is not an action; known: {known}")
    return number


def parse_episode(episode: Any) -> Any:
    """Parse the option `episode` of a reset.

    Returns:
        `True` for the next episode of the sequence, the number of a recorded episode, or a mapping that describes an
        episode.

    Raises:
        ValueError: If the option has another type, or the number is negative.
    """
    if episode is None:
        return True
    if isinstance(episode, Mapping):
        return dict(episode)
    try:
        number = operator.index(episode)
    except TypeError:
        number = -1
    if isinstance(episode, bool) or number < 0:
        raise ValueError(f"expected an episode number, at least 0, or a mapping, not {episode!r}")
    return number


def rendered(
    picture: Callable[[int], NDArray[np.uint8]],
    text: Callable[[int], str],
    places: Sequence[int],
    mode: str,
    window: Window | None,
) -> list[Any]:
    """Return the pictures or texts of some places. With a window, show their pictures and return `None` for each."""
    if mode == "ansi":
        return [text(at) for at in places]
    pictures = [picture(at) for at in places]
    if window is None:
        return pictures
    window.show(pictures)
    return [None for _ in places]


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
    spec = _HorizonSpec()

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
            info = _env_info(self._core.info(int(at)), self._config, self._core, int(at), self._atoms)
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
            infos["action_mask"] = _action_masks(self._core, self.num_envs)
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
            info["action_mask"] = _action_masks(self._core, count, ended=True)
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
        return _action_masks(self._core, self.num_envs).astype(np.bool_)

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
            for source, begun in _states(self._core, self.num_envs)
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
            states = [_parsed_state(each) for each in state]
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError("state: expected what `state` of such environments returned") from error
        core = self._make_core()
        _restore(core, states, self._observations)
        self._core = core
        self._seeded[:] = True

    def __getstate__(self) -> dict[str, Any]:
        """Return the task, the episodes and the actions taken, which determine the state."""
        state = {key: value for key, value in self.__dict__.items() if key != "_core"}
        return {**state, "_states": _states(self._core, self.num_envs)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start the same episodes and take the same actions."""
        states = state.pop("_states")
        self.__dict__.update(state)
        self._core = self._make_core()
        _restore(self._core, states, self._observations)

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
_COLUMNS = ("oracle_action", "progress", "success", "steps", "seed", "violations")


def _columns(count: int, clauses: int) -> _Columns:
    return (
        np.zeros(count, np.int64),
        np.zeros(count, np.float64),
        np.zeros(count, np.bool_),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
        np.zeros((count, clauses), np.bool_),
    )
