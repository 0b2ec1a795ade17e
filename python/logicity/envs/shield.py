"""Shields: rules that judge the actions of a learner before a car takes them."""

from __future__ import annotations

import os
from typing import Any, TypeVar

from ..types import ShieldMode, ShieldQuery

__all__ = ["shield"]

_Env = TypeVar("_Env")


def shield(
    env: _Env,
    rules: str | os.PathLike[str] | None = None,
    mode: ShieldMode = "override",
    query: ShieldQuery = "appropriate",
    threshold: float | None = None,
) -> _Env:
    """Shield an environment: rules judge every action by what the car observes. Return the environment.

    An action is *appropriate* if the rules choose it, and *safe* if it violates no clause. With sensors in the
    configuration, the shield knows only what they read; the environment judges the car by the truth. `infos` say what the
    shield permits and did, see `logicity.envs.SPFEnv`. `task: {shield: {mode: ..., query: ...}}` in a configuration does
    the same by the rules of the city, also in training and evaluation.

    Args:
        env: An `SPFEnv`, `SPFVectorEnv`, `SPFParallelEnv` or `SPFVecEnv`, also in wrappers. A shield that it has is
            replaced.
        rules: The rule file; `None` for the rules of the city.
        mode: What happens to an action that is not permitted. `override`: the car takes the action that the rules choose.
            `mask`: a step with it raises `gymnasium.error.InvalidAction`, and `action_masks()` returns what is permitted.
            `probabilistic`: an action is permitted if it is appropriate or safe with a probability of at least
            `threshold`, given the probabilities that the sensors output, which count as independent; the car takes the
            most probable action instead. The most probable action is always permitted.
        query: `appropriate` or `safe`.
        threshold: The threshold of the mode `probabilistic`, 0 to 1 (default: 0.5).

    Raises:
        InputError: If the rules are invalid or need more than facts about the present (`rule-mismatch`), or a
            probabilistic shield has sensors that output facts.
        TypeError: If the environment is none of these.
        ValueError: If an argument is unknown or out of range.
    """
    base: Any = getattr(env, "unwrapped", env)
    if not hasattr(base, "set_shield"):
        raise TypeError(f"expected an environment of Safe Path Following, not {type(base).__name__}")
    base.set_shield(rules, mode, query, threshold)
    return env
