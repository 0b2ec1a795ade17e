"""Measure what demanding episodes cost: `python python/benches/demanding.py [MODE...]`.

For each mode: the share of drawn episodes that are demanding, the share of constrained steps of the oracle in both
kinds of episodes, and the CPU time of a reset and of a step under random actions.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

import logicity
from logicity.envs import SPFVectorEnv

#: The number of environments.
COUNT = 64

#: The number of episodes of each measurement.
EPISODES = 512


def oracle_runs(config: str, episodes: Any) -> tuple[float, float]:
    """Return the shares of episodes and of steps that the rules constrain, under the oracle."""
    # The rules derive an action where the set of allowed actions is smaller than all.
    envs = SPFVectorEnv(COUNT, config, episodes=episodes, autoreset_mode="SameStep", action_masks=True)
    _, infos = envs.reset(seed=0)
    demanding = np.zeros(COUNT, np.bool_)
    ended = [0, 0]
    steps = [0, 0]
    while ended[0] < EPISODES:
        constrained = ~infos["action_mask"].all(axis=1)
        steps = [steps[0] + COUNT, steps[1] + int(constrained.sum())]
        demanding |= constrained
        _, _, terminated, truncated, infos = envs.step(infos["oracle_action"])
        done = terminated | truncated
        ended = [ended[0] + int(done.sum()), ended[1] + int((demanding & done).sum())]
        demanding &= ~done
    return ended[1] / ended[0], steps[1] / steps[0]


def reset_time(config: str, episodes: Any) -> float:
    """Return the CPU time to start an episode, in seconds."""
    envs = SPFVectorEnv(COUNT, config, episodes=episodes)
    envs.reset(seed=0)
    begin = time.process_time()
    for _ in range(EPISODES // COUNT):
        envs.reset()
    return (time.process_time() - begin) / EPISODES


def step_rate(config: str, episodes: Any) -> float:
    """Return steps per CPU second under random actions, resets included."""
    envs = SPFVectorEnv(COUNT, config, episodes=episodes, autoreset_mode="SameStep")
    envs.reset(seed=0)
    actions = np.random.default_rng(0).integers(4, size=(1000, COUNT))
    begin = time.process_time()
    for row in actions:
        envs.step(row)
    return actions.size / (time.process_time() - begin)


def main() -> None:
    """Print the table."""
    head = ("mode", "episodes", "demanding", "constrained steps", "reset (ms)", "steps per CPU second")
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for config in sys.argv[1:] or ("easy", "medium", "hard", "expert"):
        if config not in logicity.ENVIRONMENTS:
            sys.exit(f"unknown mode `{config}`; known: {', '.join(logicity.ENVIRONMENTS)}")
        for episodes in ("drawn", "drawn-demanding"):
            share, steps = oracle_runs(config, episodes)
            time_of_reset, rate = reset_time(config, episodes), step_rate(config, episodes)
            cells = (
                config,
                f"`{episodes}`",
                f"{share:.0%}",
                f"{steps:.1%}",
                f"{1000 * time_of_reset:.3f}",
                f"{rate:,.0f}",
            )
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
