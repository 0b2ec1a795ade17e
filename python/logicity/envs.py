"""Safe Path Following as environments of gymnasium: `SPFEnv`, and `SPFVectorEnv`, many of them in one call.

`import logicity` registers them, so that `gymnasium.make("logicity/SPF-Expert-v0")` and
`gymnasium.make_vec("logicity/SPF-Expert-v0", num_envs=256)` make them.

A car drives a route and must break no rule. Actions are 0 Slow, 1 Normal, 2 Fast and 3 Stop. An episode terminates at
the goal or with the first rule broken, and is truncated at the horizon of the configuration.
"""

from __future__ import annotations

import json
import operator
import os
from collections.abc import Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, cast

import gymnasium
import numpy as np
from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
from gymnasium.spaces import Box, Discrete, Space
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from . import _logicity
from .city import ACTIONS
from .errors import did_you_mean
from .files import write_new
from .rules import rule_file
from .types import Split

if TYPE_CHECKING:
    from typing_extensions import Unpack  # Python 3.11; only annotations use it

__all__ = ["EpisodeAgent", "EpisodeStart", "Kind", "Observations", "OracleRun", "SPFEnv", "SPFVectorEnv"]

Observations = NDArray[np.float32]
Kind = Literal["atoms", "points"]


class EpisodeAgent(TypedDict):
    """An agent as an episode begins; `start` and `goal` are [row, column] in cells."""

    id: str
    concepts: list[str]
    priority: int
    start: tuple[int, int]
    goal: tuple[int, int]


#: An episode under the oracle: its steps, the sum of its rewards, and by action in how many steps rules ask it.
OracleRun = TypedDict("OracleRun", {"steps": int, "return": float, "constrained": dict[str, int]})


class EpisodeStart(TypedDict):
    """How an episode begins: its seed, the agents in list order, the oracle's run if it is known.

    A seed is a whole number less than 2**64. Those of recorded episodes need all 64 bits: what keeps numbers as
    floats, as JavaScript does, does not keep them.
    """

    seed: int
    agents: list[EpisodeAgent]
    oracle: OracleRun | None


class Options(TypedDict, total=False):
    """What every kind of environment takes by keyword; `SPFEnv` tells what it means."""

    split: Split
    rules: str | os.PathLike[str] | None
    overrides: Mapping[str, Any] | None
    observation: Kind


class World:
    """What an environment is of: a configuration and what is changed of it, whose agents, and what is observed."""

    def __init__(
        self,
        config: str | os.PathLike[str],
        of: type | None = None,
        *,
        split: Split = "train",
        rules: str | os.PathLike[str] | None = None,
        overrides: Mapping[str, Any] | None = None,
        observation: Kind = "atoms",
        **unknown: Any,
    ) -> None:
        """Keep the arguments, see `SPFEnv`; `of` is the class of the environments, whose options are told beside."""
        if unknown:
            name = next(iter(unknown))
            own = signature(of).parameters.values() if of else ()
            known = [*Options.__annotations__, *(each.name for each in own if each.kind is each.KEYWORD_ONLY)]
            raise TypeError(f"environments have no option `{name}`{did_you_mean(name, known)}")
        self.config, self.split, self.observation = os.fspath(config), split, observation
        self.rules = rule_file(rules)
        self.overrides = dict(overrides or {})
        if "base" in self.overrides:
            raise ValueError("overrides have no `base`: that is `config`")

    def task(self, **more: Any) -> _logicity.Task:
        """Load the task, with more overrides."""
        return _logicity.Task(self.config, self.rules, self._changed(more))

    def _changed(self, more: Mapping[str, Any], *, anywhere: bool = False) -> str | None:
        """Return the configuration as JSON if it is not that of the file; with a base that is found from anywhere."""
        over = {**self.overrides, **more}
        if not over:
            return None
        base = Path(self.config)
        if len(base.parts) == 1 and not base.suffix and not base.exists():
            base = Path("configs") / f"{base}.yaml"
        if anywhere and base.exists():
            base = base.resolve()
        return json.dumps({"base": base.as_posix(), **over}, default=_plain)

    def written_config(self, path: Path, **more: Any) -> str:
        """Return the file that traces name as their configuration: `path`, where it is written, if it was changed.

        Raises `FileExistsError` if something else is there.
        """
        text = self._changed(more, anywhere=True)
        if text is None:
            return self.config
        write_new(path, text + "\n")
        return str(path)

    def space(self, task: _logicity.Task) -> Box:
        """Make the space of observations."""
        shape = tuple(task.shape(self.observation))
        return Box(0.0 if self.observation == "atoms" else -1.0, 1.0, shape, np.float32)


def _plain(value: Any) -> Any:
    """What JSON has for numbers and arrays of numpy, and for paths."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a {type(value).__name__} cannot be in a configuration: {value!r}")


def checked_seed(seed: int | None, generator: np.random.Generator) -> int:
    """Return the seed of a sequence of episodes: the given one if it can be, or one from the generator."""
    if seed is None:
        return int(generator.integers(2**53))
    if not 0 <= seed < 2**64:
        raise gymnasium.error.Error(f"a seed is from 0 to 2**64 - 1, not {seed}")
    return int(seed)


def _elsewhere(options: Mapping[str, Any]) -> dict[str, Any]:
    """What options of a reset change in the configuration."""
    return {key: options[key] for key in ("map", "agents") if options.get(key) is not None}


class SPFEnv(gymnasium.Env[Observations, np.int64]):
    """Safe Path Following: one car is driven.

    Observations are arrays of float32. `observation="atoms"` (default): 1 for each true atom about the car and the
    first 4 others that it sees, shape (85,), (140,) or (205,) as the mode has predicates, and one more number from 0 to
    1 if the configuration sets `task: {route_length: true}`. `observation="points"`: the exact state, shape
    (20, 15), (20, 16) or (20, 19): a row for the ego and for each other agent in its field of view, as long as there
    are rows, numbers from -1 to 1. `python -m logicity describe` prints what each number of both is.

    Parameters: `config` is a run configuration, a built-in name such as `expert` or a path; `split` the set of agents;
    `rules` a rule file instead of the configuration's; `overrides` a mapping that is merged over the configuration,
    for example `{"task": {"reward": {"overtime": -6}}}`. `episodes="recorded"` takes episodes of the split's set, by
    the seed and with replacement, instead of drawing new ones. `atoms=True` puts `true_atoms` into `info`, texts such
    as `IsTiro(Car_1)`. `render_mode` is `rgb_array` or `ansi`.

    `info` has `oracle_action` (what the rules want now), `violations` (names of the clauses that the last action
    broke, such as `S1`), `progress` (share of the route gone, 0 to 1), `success`, `steps` and `seed` (of the episode, a
    numpy.uint64).

    Raises `InputError` for a faulty configuration, rule file or episode, `OSError` for one that cannot be read,
    `ValueError` for an unknown name.
    """

    metadata = {"render_modes": ["rgb_array", "ansi"], "render_fps": 10}

    def __init__(
        self,
        config: str | os.PathLike[str] = "expert",
        *,
        episodes: Literal["drawn", "recorded"] = "drawn",
        atoms: bool = False,
        render_mode: str | None = None,
        **options: Unpack[Options],
    ) -> None:
        """Load the configuration and the rules."""
        self._world = World(config, SPFEnv, **options)
        self._atoms = atoms
        self._recorded = _is_recorded(episodes)
        self.render_mode = checked_render_mode(render_mode, self.metadata)
        self._task = self._world.task()
        space = self._world.space(self._task)
        self.observation_space, self._shape = cast(Space[Observations], space), space.shape
        self.action_space = Discrete(4)
        self._home = self._environments(self._task)
        self._core = self._home
        self._elsewhere: dict[str, Any] = {}
        self._seeded = False
        self._taken: list[int] | None = None

    def _environments(self, task: _logicity.Task) -> _logicity.Environments:
        world = self._world
        return _logicity.Environments(task, world.split, 1, "Disabled", world.observation, self._recorded, 1)

    def _look(self) -> Observations:
        return np.empty(self._shape, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode.

        `seed`, from 0 to 2**64 - 1, begins a new sequence of episodes; without one the next of the sequence follows.
        `options`: `episode` is the number of a recorded episode of the split or a mapping such as `SPFEnv.episode`, and
        then the sequence does not go on; `map` and `agents` replace those parts of the configuration for this episode.

        Raises `IndexError` if there is no recorded episode of that number, `InputError` (`invalid-episode`) for a
        mapping that is no episode here, `ValueError` for an option that cannot be meant.
        """
        super().reset(seed=seed)
        options = options or {}
        check_options(options, ("episode", "map", "agents"))
        if seed is not None or not self._seeded:
            self._home.seed(0, checked_seed(seed, self.np_random), 0)
            self._seeded = True
        self._move(_elsewhere(options))
        observation = self._look()
        self._taken = None
        self._core.reset([begin_of(options.get("episode"))], observation)
        if self._core is not self._home:
            self._home.seed(0, *self._core.source(0))
        self._taken = []
        return observation, _told(self._core.info(0), self._core, 0, self._atoms)

    def _move(self, elsewhere: dict[str, Any]) -> None:
        """Go where the configuration is changed like this; the sequence of episodes comes along."""
        if not elsewhere:
            self._core, self._elsewhere = self._home, {}
            return
        if self._core is self._home or elsewhere != self._elsewhere:
            task = self._world.task(**elsewhere)
            if self._world.space(task) != self.observation_space:
                raise ValueError("there, observations have another shape")
            self._core, self._elsewhere = self._environments(task), elsewhere
        self._core.seed(0, *self._home.source(0))

    def step(self, action: np.int64 | int) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """Drive for a tick.

        Raises `gymnasium.error.ResetNeeded` if no episode goes on, and `gymnasium.error.InvalidAction`.
        """
        if self._taken is None:
            raise ResetNeeded("no episode has begun: `reset` begins one")
        observation = self._look()
        number = checked_action(action)
        reward, terminated, truncated, info = self._core.step_one(number, observation)
        self._taken.append(number)
        return observation, reward, terminated, truncated, _told(info, self._core, 0, self._atoms)

    @property
    def episode(self) -> EpisodeStart:
        """How the episode began; `reset(options={"episode": ...})` begins it again."""
        self._check_begun()
        return cast(EpisodeStart, self._core.episode(0))

    def _check_begun(self) -> None:
        if self._taken is None:
            raise ResetNeeded("no episode has begun: `reset` begins one")

    def explain(self) -> str:
        """Tell why the oracle would act as it would: proofs on the facts that the car observes now, in words."""
        self._check_begun()
        return self._core.explain(0)

    def write_trace(self, path: str | os.PathLike[str]) -> None:
        """Write the trace of the episode so far, as `logicity run` would: `logicity view` makes a page of it.

        It tells of every step what the car observed, what the rules wanted of it and which clauses its action broke. If
        the configuration was changed, by overrides or by `map` or `agents` of a reset, what it became is written beside
        the trace, to `episode.jsonl.yaml` for `episode.jsonl`, which the trace names. A trace that is there is
        replaced, another configuration is not.

        Raises `ResetNeeded` if no episode has begun, `ValueError` before its first step, `FileExistsError` if another
        configuration is there, `OSError` if a file cannot be written.
        """
        self._check_begun()
        if not self._taken:
            raise ValueError("the episode has no steps yet: a trace tells what was done")
        path = Path(path)
        if path.suffix == ".yaml":
            raise ValueError(f"`{path}` is named as configurations are: give the trace another ending, such as .jsonl")
        world = self._world
        config = world.written_config(path.with_name(f"{path.name}.yaml"), **self._elsewhere)
        task = world.task(**self._elsewhere) if self._elsewhere else self._task
        task.write_trace(world.split, self._core.episode(0), self._taken, path, config)

    def render(self) -> Any:
        """Draw the city: an array of uint8, shape (height, width, 3), or text in the mode `ansi`.

        In the picture the driven car stands in a frame, with a line along its way and a square around its goal.
        """
        if self.render_mode is None:
            raise gymnasium.error.Error("no `render_mode` was chosen when the environment was made")
        self._check_begun()
        return _rendered(self._core, 0, self.render_mode)

    def __getstate__(self) -> dict[str, Any]:
        """Arguments, and the episode with the actions taken: with them everything is as it was."""
        state = {key: value for key, value in self.__dict__.items() if key not in ("_task", "_home", "_core")}
        state["_source"] = self._home.source(0)
        # A step that was interrupted has ended the episode for good.
        goes_on = self._taken is not None and self._core.has_begun(0)
        state["_start"] = self._core.episode(0) if goes_on else None
        state["_taken"] = self._taken if goes_on else None
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin the same episode and take the same actions."""
        source, start, elsewhere = state.pop("_source"), state.pop("_start"), state.pop("_elsewhere")
        self.__dict__.update(state)
        self._task = self._world.task()
        self._home = self._core = self._environments(self._task)
        self._elsewhere = {}
        self._home.seed(0, *source)
        self._move(elsewhere)
        if start is not None:
            observation = self._look()
            self._core.reset([start], observation)
            for action in self._taken or []:
                self._core.step_one(action, observation)


def told_of(info: dict[str, Any]) -> dict[str, Any]:
    """Return what is told of an episode as gymnasium takes it."""
    # A type that holds any seed where gymnasium puts it into an array, which a whole number of Python would not.
    info["seed"] = np.uint64(info["seed"])
    return info


def _told(info: dict[str, Any], core: _logicity.Environments, at: int, atoms: bool) -> dict[str, Any]:
    """Return what is told of an environment; with atoms, what is true there."""
    told_of(info)
    if atoms:
        info["true_atoms"] = core.atoms(at)
    return info


def _is_recorded(episodes: str) -> bool:
    if episodes not in ("drawn", "recorded"):
        raise ValueError(f"episodes are `drawn` or `recorded`, not `{episodes}`")
    return episodes == "recorded"


def checked_render_mode(mode: str | None, metadata: Mapping[str, Any]) -> str | None:
    """Return the mode if there is one of this name."""
    if mode is not None and mode not in metadata["render_modes"]:
        raise UnsupportedMode(f"unknown render mode `{mode}`: it is one of {', '.join(metadata['render_modes'])}")
    return mode


def check_options(options: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Refuse options of a reset that are not known."""
    for option in options:
        if option not in known:
            raise ValueError(f"unknown option `{option}`: they are {', '.join(known)}")


def checked_action(action: Any) -> int:
    """Return the number of an action if it is one."""
    try:
        number = operator.index(action)
    except TypeError:
        number = -1
    if not 0 <= number < len(ACTIONS):
        known = ", ".join(f"{number} {name}" for number, name in enumerate(ACTIONS))
        raise InvalidAction(f"{action!r} is no action: they are {known}")
    return number


def begin_of(episode: Any) -> Any:
    """Return what begins: the next episode (`True`), that of a number, or one that is given."""
    if episode is None:
        return True
    if isinstance(episode, Mapping):
        return dict(episode)
    try:
        number = operator.index(episode)
    except TypeError:
        number = -1
    if isinstance(episode, bool) or number < 0:
        raise ValueError(f"an episode is a number from 0 or a mapping, not {episode!r}")
    return number


def _rendered(core: _logicity.Environments, at: int, mode: str) -> Any:
    return core.picture(at) if mode == "rgb_array" else core.text(at)


class SPFVectorEnv(VectorEnv[Observations, NDArray[np.int64], NDArray[Any]]):
    """Many environments of Safe Path Following that take a step in one call.

    Environment i goes as an `SPFEnv` with its seed would. With `reset(seed=s)` its seed is s + i. One thread of Python
    at a time may use it; a second one is told so by a `RuntimeError`.

    Parameters are those of `SPFEnv`, and: `num_envs`; `autoreset_mode`, an `AutoresetMode` or its name; `num_threads`
    that share the work of a step; `copy=False` gives the same array of observations again and again, which is faster,
    but what was kept of the last step is overwritten.

    Observations have shape (num_envs, ...), rewards are float64, `terminated` and `truncated` bool, each of shape
    (num_envs,). `infos` has an array for each key of `SPFEnv`'s `info`, and its mask under `_key`. In the mode SameStep
    `final_obs` and `final_info` tell how episodes ended.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "ansi"], "render_fps": 10}

    def __init__(
        self,
        num_envs: int = 1,
        config: str | os.PathLike[str] = "expert",
        *,
        episodes: Literal["drawn", "recorded"] = "drawn",
        atoms: bool = False,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int = 1,
        copy: bool = True,
        **options: Unpack[Options],
    ) -> None:
        """Load the configuration and the rules."""
        super().__init__()
        if num_envs < 1 or num_threads < 1:
            raise ValueError(f"{num_envs} environments on {num_threads} threads: both are at least 1")
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = checked_render_mode(render_mode, self.metadata)
        self._atoms, self.copy = atoms, copy
        world = World(config, SPFVectorEnv, **options)
        task = world.task()
        self.single_observation_space = world.space(task)
        self.single_action_space = Discrete(4)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        recorded = _is_recorded(episodes)
        self._core = _logicity.Environments(
            task, world.split, num_envs, self.autoreset_mode.value, world.observation, recorded, num_threads
        )
        if atoms:
            self._core.keep_last_atoms()
        self._observations = np.zeros((num_envs, *(self.single_observation_space.shape or ())), np.float32)
        self._seeded = np.zeros(num_envs, np.bool_)
        self._unbroken = np.empty(num_envs, object)
        self._unbroken.fill(())

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin episodes.

        `seed` begins new sequences of episodes: one number s gives environment i the seed s + i; a list has one for
        each, where `None` goes on with the sequence. `options`: `reset_mask`, an array of bool, which environments
        begin (default: all); `episode`, as for `SPFEnv`, for all of them, or `episodes`, a list with one for each.

        Raises what `SPFEnv.reset` does.
        """
        options = dict(options or {})
        check_options(options, ("reset_mask", "episode", "episodes"))
        if options.get("episode") is not None and options.get("episodes") is not None:
            raise ValueError("`episode` is for all environments, `episodes` has one for each: give one of them")
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
        begin = [bool(begins) and begin_of(episode) for begins, episode in zip(mask, chosen, strict=True)]
        for at in np.flatnonzero(mask):
            given = seeds[at]
            if given is not None or not self._seeded[at]:
                self._core.seed(int(at), checked_seed(given, self.np_random), 0)
                self._seeded[at] = True
        self._core.reset(begin, self._observations)
        infos: dict[str, Any] = {}
        for at in np.flatnonzero(mask):
            info = _told(self._core.info(int(at)), self._core, int(at), self._atoms)
            infos = self._add_info(infos, info, int(at))
        return self._shown(), infos

    def _shown(self) -> Observations:
        return self._observations.copy() if self.copy else self._observations

    def _mask(self, options: Mapping[str, Any]) -> NDArray[np.bool_]:
        mask = options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError("`reset_mask` is an array of bool")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"`reset_mask` has shape ({self.num_envs},) and names at least one environment")
        return mask

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive all cars for a tick; `actions` are whole numbers, shape (num_envs,).

        Raises `gymnasium.error.ResetNeeded` if an environment has no episode that goes on, and
        `gymnasium.error.InvalidAction`; then nobody has moved.
        """
        count = self.num_envs
        given = np.asarray(actions)
        if given.shape != (count,) or given.dtype.kind not in "iu":
            raise InvalidAction(f"actions are whole numbers of shape ({count},), not {given.dtype} of {given.shape}")
        rewards = np.empty(count, np.float64)
        terminated, truncated = np.empty(count, np.bool_), np.empty(count, np.bool_)
        columns = _columns(count)
        numbers = np.ascontiguousarray(given, np.int64)
        broken = self._core.step(numbers, self._observations, (rewards, terminated, truncated), columns)
        infos = self._infos(columns, broken)
        if self._atoms:
            infos["true_atoms"] = atoms = np.empty(count, object)
            for at in range(count):
                atoms[at] = self._core.atoms(at)
            infos["_true_atoms"] = np.ones(count, np.bool_)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and (terminated.any() or truncated.any()):
            self._tell_ends(infos)
        return self._shown(), rewards, terminated, truncated, infos

    def _infos(self, columns: _Columns, broken: list[tuple[int, tuple[str, ...]]]) -> dict[str, Any]:
        infos: dict[str, Any] = dict(zip(_COLUMNS, columns, strict=True))
        infos["violations"] = violations = self._unbroken.copy()
        for at, labels in broken:
            violations[at] = labels
        for key in tuple(infos):
            infos["_" + key] = np.ones(self.num_envs, np.bool_)
        return infos

    def _tell_ends(self, infos: dict[str, Any]) -> None:
        """Put in how episodes ended whose environments have gone on."""
        count = self.num_envs
        columns = _columns(count)
        ends = self._core.ended(columns)
        info: dict[str, Any] = dict(zip(_COLUMNS, columns, strict=True))
        info["violations"] = violations = np.empty(count, object)
        infos["final_obs"] = observations = np.empty(count, object)
        if self._atoms:
            info["true_atoms"] = np.empty(count, object)
        mask = np.zeros(count, np.bool_)
        shape = self.single_observation_space.shape
        for at, observation, labels in ends:
            observations[at], violations[at], mask[at] = observation.reshape(shape), labels, True
            if self._atoms:
                info["true_atoms"][at] = self._core.ended_atoms(at)
        for key in tuple(info):
            info["_" + key] = mask.copy()
        infos["final_info"], infos["_final_info"], infos["_final_obs"] = info, mask.copy(), mask

    def episode(self, at: int) -> EpisodeStart:
        """How the episode of an environment began.

        Raises `IndexError` if there is no such environment, `gymnasium.error.ResetNeeded` if it has no episode.
        """
        return cast(EpisodeStart, self._core.episode(self._place(at)))

    def explain(self, at: int) -> str:
        """Tell why the oracle of an environment would act as it would, as `SPFEnv.explain` does.

        Raises what `episode` does.
        """
        return self._core.explain(self._place(at))

    def _place(self, at: int) -> int:
        if not 0 <= operator.index(at) < self.num_envs:
            raise IndexError(f"there is no environment {at}: they are 0 to {self.num_envs - 1}")
        return at

    def render(self) -> tuple[Any, ...] | None:
        """Draw all cities, see `SPFEnv.render`. Raises `gymnasium.error.ResetNeeded` if one has no episode."""
        if self.render_mode is None:
            raise gymnasium.error.Error("no `render_mode` was chosen when the environments were made")
        return tuple(_rendered(self._core, at, self.render_mode) for at in range(self.num_envs))

    def __getstate__(self) -> dict[str, Any]:
        """Refuse: what goes to another process are the arguments."""
        raise TypeError("an SPFVectorEnv cannot be pickled or copied: make another with the same arguments")


_Columns = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64], NDArray[np.uint64]]
_COLUMNS = ("oracle_action", "progress", "success", "steps", "seed")


def _columns(count: int) -> _Columns:
    return (
        np.zeros(count, np.int64),
        np.zeros(count, np.float64),
        np.zeros(count, np.bool_),
        np.zeros(count, np.int64),
        np.zeros(count, np.uint64),
    )
