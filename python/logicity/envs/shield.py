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
    query: ShieldQuery | None = None,
    threshold: float | None = None,
) -> _Env:
    """Shield an environment: rules judge every action by what the car observes. Return the environment.

    An action is *appropriate* if the rules choose it. It is *safe* if it violates no clause. With sensors, the shield
    reads their output; violations and rewards use the true facts. `info` describes its decisions, see
    `logicity.envs.SPFEnv`. A shield in a configuration (`task: {shield: {mode: override}}`) uses the rules of the city.

    Args:
        env: An `SPFEnv`, `SPFVectorEnv`, `SPFParallelEnv`, `SPFParallelVectorEnv` or `SPFVecEnv`, also in wrappers.
            The shield replaces an earlier one.
        rules: The rule file; `None` for the rules of the city. Rules may not draw or read earlier ticks.
        mode: What happens to an action that is not permitted. `override`: the car takes the action that the rules
            choose, or, if that one is not permitted either, the permitted one of highest priority. `mask`: a step with
            it raises `gymnasium.error.InvalidAction`; `info["shield_mask"]` has the permitted actions, and, except in
            `SPFParallelEnv`, `action_masks()`, too. `probabilistic`: the car takes the most probable action. An action
            is permitted if the probability that it is appropriate or safe is at least `threshold`; the most probable
            action is always permitted. Facts have the probabilities that the sensors output, and count as independent.
            The rules may not read quantities, name agents, or aggregate over facts. `joint`: the egos of an environment
            take the safe joint action that changes the fewest proposed actions. A joint action is safe if, given the
            actions of all egos, no clause demands a different action of any of them; so rules can read the actions of
            other egos. Among several, the first car decides first: it keeps its action if it can, and otherwise takes
            the one that the rules choose; then the second car decides, and so on. If no joint action is safe, the egos
            take what the rules choose. `shield_mask` and `explain_shield` are then about each ego alone. With one ego,
            the mode equals `override` with the query `safe`.
        query: `appropriate` (default) or `safe`, which is the only one of the mode `joint` and its default. If no
            action is safe, the shield permits the one that the rules choose.
        threshold: The threshold of the mode `probabilistic`, 0 to 1 (default: 0.5).

    Raises:
        InputError: If the rules are invalid or need more than the mode allows (`rule-mismatch`), or a probabilistic
            shield has sensors that output facts.
        LimitError: If the probabilities of a probabilistic shield are too complex, or a joint shield tries too many
            joint actions, also in a reset or step. On an error
            here, the environment keeps its shield.
        TypeError: If `env` is no such environment, or an argument has a wrong type.
        ValueError: If an argument is unknown or out of range.
    """
    base: Any = getattr(env, "unwrapped", env)
    # `SPFVecEnv` wraps a vector.
    shielded: Any = base if hasattr(base, "set_shield") else getattr(base, "envs", None)
    if not hasattr(shielded, "set_shield"):
        raise TypeError(f"expected an environment of Safe Path Following, not {type(base).__name__}")
    shielded.set_shield(rules, mode, query, threshold)
    return env
