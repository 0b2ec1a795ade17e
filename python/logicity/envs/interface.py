"""What the environments of Safe Path Following share: spaces, seeds, options, actions, infos, rendering and states."""

from __future__ import annotations

import math
import operator
import os
import sys
from collections.abc import Mapping, Sequence
from copy import copy, deepcopy
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..errors import checked_integer, extra
from ..types import ShieldMode, ShieldQuery

with extra("gym"):
    import gymnasium
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.error import InvalidAction, ResetNeeded, UnsupportedMode
    from gymnasium.spaces import Box, Space

from .config import EnvConfig, array_kind
from .layout import Layout
from .views import Observations, View, views_of

RENDER_MODES = ["human", "rgb_array", "ansi"]
#: The largest number of pictures per second in the window.
RENDER_FPS = 10


#: The types of the infos that the core computes, in its order.
INFOS = {
    "oracle_action": np.int64,
    "progress": np.float64,
    "success": np.bool_,
    "steps": np.int64,
    "seed": np.int64,
    "violations": np.bool_,
}


def infos_of(rows: int, clauses: Sequence[str]) -> tuple[Any, ...]:
    """Return the arrays of infos that the core fills, in the order of `INFOS`, for this number of egos."""
    shapes = {"violations": (rows, len(clauses))}
    return tuple(np.zeros(shapes.get(name, (rows,)), kind) for name, kind in INFOS.items())


class BaseEnv:
    """The parts that the environments with one, several and many cars share."""

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES, "render_fps": RENDER_FPS}
    render_mode: str | None
    _begun: bool
    _core: _logicity.VectorEnv
    _shield: tuple[_logicity.Task | None, tuple[str, str | None, float | None]] | None = None
    _spec: EnvSpec | None
    #: The number of egos of all environments.
    _rows: int

    def _load(
        self,
        config: EnvConfig,
        render_mode: str | None,
        episodes: str = "drawn",
        batch: tuple[int, str, int] = (1, "Disabled", 1),
        several: bool = False,
    ) -> None:
        """Load the task, and make the window of the render mode.

        `batch` is the number of environments, their autoreset mode and the number of threads. `several` says whether
        the environments control several egos.
        """
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise UnsupportedMode(f"unknown render mode `{render_mode}`; known: {', '.join(RENDER_MODES)}")
        self.render_mode, self._window = render_mode, _Window() if render_mode == "human" else None
        self._episodes, self._recorded = episodes, episodes == "recorded"
        self._config, self._kind, self._batch = config, array_kind(config.observation), batch
        self._several = several
        self._task = self._core_task = config.task()
        self._clauses, self._shape = self._task.clauses(), tuple(self._task.shape(self._kind))
        self._views = views_of(self._task, config.observation)
        self._actions = self._task.actions()
        egos = _logicity.layout(self._task)["egos"] or 1
        if egos > 1 and not several:
            raise ValueError(
                f"the configuration has {egos} egos (`task.egos`), but `{type(self).__name__}` controls one car: use "
                "`SPFParallelEnv` or `SPFParallelVectorEnv`"
            )

    def _make_core(self, task: _logicity.Task) -> _logicity.VectorEnv:
        count, autoreset, threads = self._batch
        split, episodes = self._config.split, self._episodes
        core = _logicity.VectorEnv(task, split, count, autoreset, self._kind, episodes, threads, self._several)
        self._rows = count * core.egos()
        if self._config.action_masks:
            core.judge_actions()
        if self._shield is not None:
            core.set_shield(*self._shield)
        return core

    def set_shield(
        self,
        rules: str | os.PathLike[str] | None = None,
        mode: ShieldMode = "override",
        query: ShieldQuery | None = None,
        threshold: float | None = None,
    ) -> None:
        """Set the shield of the environment, see `logicity.shield`."""
        for name, value in {"mode": mode, "query": query}.items():
            if not isinstance(value, str) and not (name == "query" and value is None):
                raise TypeError(f"{name}: expected str, not {type(value).__name__}")
        if threshold is not None:
            if isinstance(threshold, bool) or not isinstance(threshold, (int, float, np.number)):
                raise TypeError(f"threshold: expected float, not {type(threshold).__name__}")
            if mode != "probabilistic":
                raise ValueError('`threshold` needs `mode="probabilistic"`')
            if not 0 <= threshold <= 1:
                raise ValueError(f"`threshold` must be from 0 to 1, not {threshold}")
        settings = (mode, query, None if threshold is None else float(threshold))
        task = None if rules is None else self._config.shield_task(rules)
        self._core.set_shield(task, settings)
        self._shield = task, settings

    @property
    def shield_clauses(self) -> tuple[str, ...] | None:
        """The names of the clauses of the shield's rules, in the order of `shield_violations`; `None` without one."""
        return self._core.shield_clauses()

    def _space(self) -> Space[Any]:
        if self._views is not None:
            return self._views.space()
        described = _logicity.layout(self._task)
        if self._kind == "groundings":
            return Box(*Layout.of_description(described).bounds(), dtype=np.float32)
        high = np.ones(self._shape, np.float32)
        about_one = [column for column in described["columns"] if "quantity" in column and column["arity"] == 1]
        if about_one:
            high[:, -len(about_one) :] = [np.inf if "scale" in column else 1.0 for column in about_one]
        return Box(-high, high, dtype=np.float32)

    def _output(self, observations: Observations) -> Observations | View:
        """Return the views of observations, or the observations without views."""
        return observations if self._views is None else self._views(observations)

    def _info(self, info: dict[str, Any]) -> dict[str, Any]:
        """Convert an `info` to the types that gymnasium expects, and remove what the options exclude."""
        info["seed"] = np.int64(info["seed"])
        if not self._config.oracle:
            del info["oracle_action"]
        return info

    def _rendered(self) -> list[Any]:
        """Return the pictures or texts of environments. With a window, show the pictures and return `None` for each."""
        if self.render_mode == "ansi":
            return [self._core.text(at) for at in range(self._batch[0])]
        return self._shown([self._core.picture(at) for at in range(self._batch[0])])

    def _shown(self, pictures: list[NDArray[np.uint8]]) -> list[Any]:
        if self._window is None:
            return pictures
        self._window.show(pictures)
        return [None for _ in pictures]

    @property
    def action_names(self) -> tuple[str, ...]:
        """The names of the actions, in the order of the action space: `ACTIONS`, then those of the configuration."""
        return self._actions

    @property
    def sensors(self) -> dict[str, Any] | None:
        """The sensors through which the ego observes facts; `None` if it observes them exactly.

        `output` and `ego` are those of the configuration. `predicates` has the sensor of each predicate. If the output
        is not `facts`, a sensor also has `chains`: the probabilities of the Markov chains of its facts, for those whose
        only or first agent is the ego, those about one other agent or with the ego second, and those about two others.
        `base` is the share of ticks in which the fact holds. `initial` is that share in the first tick that observes
        its agents. `stays` and `appears` are the shares of ticks in which it holds after it did and did not hold. They
        are counted in up to 512 episodes and 32,768 steps of the oracle.
        """
        return self._task.sensors()

    @property
    def clauses(self) -> tuple[str, ...]:
        """The names of the clauses that actions can violate, such as `S1`, in the order of `violations`."""
        return self._clauses

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window of the render mode `human`."""
        if self._window is not None:
            self._window.close()

    def _check_masks(self) -> None:
        if not self._config.action_masks and self.shield_clauses is None:
            raise gymnasium.error.Error(
                "the environment has no action masks: make it with `action_masks=True`, or add a shield"
            )

    def _check_shield(self) -> None:
        if self.shield_clauses is None:
            raise gymnasium.error.Error("the environment has no shield: add one with `logicity.shield`")

    def _check_begun(self) -> None:
        if not self._begun:
            raise ResetNeeded("no episode has started: call `reset`")

    def _states(self) -> States:
        core = self._core
        return [
            (core.source(at), (core.episode(at), core.taken(at)) if core.has_begun(at) else None)
            for at in range(self._batch[0])
        ]

    def _masks(self, ended: bool = False) -> NDArray[np.int8]:
        """Return the allowed actions of all egos, or those of the episodes that ended in the last step."""
        masks = np.zeros((self._rows, len(self._actions)), np.int8)
        self._core.action_masks(masks, ended)
        return masks

    def _permitted(self) -> NDArray[np.bool_]:
        """Return the actions that the shield permits all egos; without one, those that violate no clause."""
        self._check_masks()
        clauses = self.shield_clauses
        masks = self._masks() if clauses is None else self._shield_infos(len(clauses))["shield_mask"]
        return masks.astype(np.bool_)

    def _shield_infos(self, clauses: int, ended: bool = False) -> dict[str, NDArray[Any]]:
        """Return the infos of the shields of all egos, or those of the episodes that just ended."""
        count, actions = self._rows, len(self._actions)
        infos: dict[str, NDArray[Any]] = {
            "shield_mask": np.zeros((count, actions), np.int8),
            "shield_probabilities": np.zeros((count, actions), np.float64),
            "replaced_action": np.full(count, -1, np.int64),
            "shield_violations": np.zeros((count, clauses), np.bool_),
        }
        self._core.shield_infos(tuple(infos.values()), ended)
        return infos

    def __getstate__(self) -> dict[str, Any]:
        """Return the tasks, the episodes and the actions taken, which determine the state."""
        state = {key: value for key, value in self.__dict__.items() if key != "_core"}
        return {**state, "_states": self._states()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start the same episodes and take the same actions."""
        states = state.pop("_states")
        self.__dict__.update(state)
        self._core = self._make_core(self._core_task)
        restore_states(self._core, states, np.empty((self._rows, *self._shape), np.float32))

    # Two environments cannot share a city.
    __copy__ = deepcopy


class _Window:
    """A window that opens with the first picture.

    A process has at most one, which shows the latest picture of all objects of this class. `close` of one closes it for
    all, and the next picture opens it again.
    """

    def __init__(self) -> None:
        with extra("human"):
            import pygame
        self._pygame = pygame
        self._clock: Any = None

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), ()

    def show(self, pictures: Sequence[NDArray[np.uint8]]) -> None:
        """Show pictures of shape (height, width, 3) and of equal size in a grid that is as large as one of them."""
        pygame, (height, width, _) = self._pygame, pictures[0].shape
        if self._clock is None:
            self._clock = pygame.time.Clock()
        # Another object may have closed the window or changed its size.
        screen = pygame.display.get_surface() if pygame.display.get_init() else None
        if screen is None or screen.get_size() != (width, height):
            pygame.display.init()
            screen = pygame.display.set_mode((width, height))
            pygame.display.set_caption("LogiCity")
        side = math.ceil(math.sqrt(len(pictures)))
        size = width // side, height // side
        for number, picture in enumerate(pictures):
            surface = pygame.surfarray.make_surface(picture.swapaxes(0, 1))
            if side > 1:
                surface = pygame.transform.smoothscale(surface, size)
            row, column = divmod(number, side)
            screen.blit(surface, (column * size[0], row * size[1]))
        pygame.event.pump()
        self._clock.tick(RENDER_FPS)
        pygame.display.flip()

    def close(self) -> None:
        if self._clock is not None:
            self._pygame.display.quit()
            self._clock = None


def checked_seed(seed: int | None, generator: np.random.Generator) -> int:
    """Return the seed of a sequence of episodes: `seed`, or a number from the generator if `seed` is `None`."""
    if seed is None:
        return int(generator.integers(2**53))
    try:
        return checked_integer("seed", seed)
    except (TypeError, ValueError) as error:
        # As gymnasium itself does for negative seeds.
        raise gymnasium.error.Error(str(error)) from None


class HorizonSpec:
    """Sets `max_episode_steps` of the spec that `gymnasium.make` assigns to an environment.

    The environments truncate episodes themselves, so the registered spec has no `max_episode_steps`: gymnasium would
    add a `TimeLimit`, which knows neither the horizons of recorded episodes nor those of overrides.
    """

    def __get__(self, env: Any, owner: type | None = None) -> EnvSpec | None:
        """Return the spec, or `None` before it is assigned."""
        return getattr(env, "_spec", None)

    def __set__(self, env: BaseEnv, spec: EnvSpec | None) -> None:
        """Store the spec with the horizon of the environment."""
        if spec is not None:
            horizon = env._task.max_steps(env._config.split, env._recorded)
            _check_limit_of_make(sys._getframe(1), horizon)
            spec = copy(spec)
            spec.max_episode_steps = horizon
            # `make_vec` adds it to the arguments if it gets such a spec.
            spec.kwargs = {name: value for name, value in spec.kwargs.items() if name != "max_episode_steps"}
        env._spec = spec


def _check_limit_of_make(frame: FrameType, horizon: int) -> None:
    """Check the `max_episode_steps` that `gymnasium.make` is about to apply, if `frame` is a call of it.

    `gymnasium.make` passes it to no environment: after this check, it adds a `TimeLimit`, which would cut off episodes
    without the rewards of their ends.
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


#: The states of environments: the seed of the episodes and the number of episodes started, and, if an episode has
#: started, its start and the actions taken.
States = list[tuple[list[int], tuple[dict[str, Any], bytes] | None]]


def restore_states(core: _logicity.VectorEnv, states: States, observations: Observations) -> None:
    """Restore the states of all environments."""
    for at, (source, _) in enumerate(states):
        core.seed(at, *source)
    core.replay([episode for _, episode in states], observations)


def checked_options(options: Mapping[str, Any] | None, known: tuple[str, ...] | None = None) -> Mapping[str, Any]:
    """Return the options of a reset. Raise `TypeError` for another type, and `ValueError` for one not in `known`."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise TypeError(f"options: expected dict, not {type(options).__name__}")
    for option in options:
        if known is not None and option not in known:
            raise ValueError(f"unknown option `{option}`; known: {', '.join(known)}")
    return options


def checked_action(action: Any, names: Sequence[str]) -> int:
    """Return an action as an int. Raise `gymnasium.error.InvalidAction` if it is no index of a name."""
    try:
        number = -1 if isinstance(action, bool) else operator.index(action)
    except TypeError:
        number = -1
    if not 0 <= number < len(names):
        known = ", ".join(f"{number} {name}" for number, name in enumerate(names))
        raise InvalidAction(f"{action!r} is not an action; known: {known}")
    return number


def parse_episode(episode: Any) -> Any:
    """Return the option `episode` of a reset: a mapping or the number of a recorded episode; `True` for the next one.

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
