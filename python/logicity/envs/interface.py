"""What the environments of Safe Path Following share: spaces, seeds, options, actions, infos, rendering and states."""

from __future__ import annotations

import operator
import sys
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from types import FrameType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..city import ACTIONS
from ..errors import checked_integer, extra

with extra("gym"):
    import gymnasium
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.error import InvalidAction, UnsupportedMode
    from gymnasium.spaces import Box, Space

from ..types import ArrayKind
from .config import EnvConfig
from .views import Observations, Views
from .window import Window

__all__ = [
    *("RENDER_FPS", "RENDER_MODES", "HorizonSpec"),
    *("States", "check_masks", "check_options", "checked_action", "checked_render_mode", "checked_seed"),
    *("config_overrides", "env_info", "info_dict", "masks_of", "observation_space", "parse_episode", "parsed_state"),
    *("rendered", "restore_states", "states_of", "wrong_limit"),
]

RENDER_MODES = ["human", "rgb_array", "ansi"]
RENDER_FPS = 10


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


class _Limited(Protocol):
    """An environment whose episodes have a step limit."""

    _task: _logicity.Task
    _config: EnvConfig
    _recorded: bool


class HorizonSpec:
    """Sets `max_episode_steps` of the spec that `gymnasium.make` assigns to an environment.

    The environments truncate episodes themselves, so the registered spec has no `max_episode_steps`: gymnasium would
    add a `TimeLimit`, which knows neither the horizons of recorded episodes nor those of overrides.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        """Store the name of the attribute."""
        self._name = f"_{name}"

    def __get__(self, env: Any, owner: type | None = None) -> EnvSpec | None:
        """Return the spec, or `None` before it is assigned."""
        return getattr(env, self._name, None)

    def __set__(self, env: _Limited, spec: EnvSpec | None) -> None:
        """Store the spec with the horizon of the environment."""
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


#: The states of environments: the seed of the episodes and the number of episodes started, and, if an episode has
#: started, its start and the actions taken.
States = list[tuple[list[int], tuple[dict[str, Any], bytes] | None]]


def states_of(core: _logicity.VectorEnv, count: int = 1) -> States:
    """Return the states of all environments."""
    return [
        (core.source(at), (core.episode(at), core.taken(at)) if core.has_begun(at) else None) for at in range(count)
    ]


def parsed_state(state: Mapping[str, Any]) -> tuple[list[int], tuple[dict[str, Any], bytes] | None]:
    """Return the state of an environment from the plain data of `SPFVectorEnv.state`.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: If it is something else.
    """
    seed, begun = (checked_integer("source", number) for number in state["source"])
    actions = bytes.fromhex(state["actions"])
    return [seed, begun], None if state["episode"] is None else (dict(state["episode"]), actions)


def restore_states(core: _logicity.VectorEnv, states: States, observations: Observations) -> None:
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


def env_info(
    info: dict[str, Any], config: EnvConfig, core: _logicity.VectorEnv, at: int, atoms: bool
) -> dict[str, Any]:
    """Convert the `info` of one environment. With `atoms`, add its true atoms."""
    info_dict(info, config)
    if atoms:
        info["true_atoms"] = core.atoms(at)
    return info


def masks_of(core: _logicity.VectorEnv, count: int, ended: bool = False) -> NDArray[np.int8]:
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
