"""Measure the time of a shield's decision: `python python/benches/shields.py [MODE]`.

It is the difference in CPU time per step between 64 environments with noisy sensors and the same with a shield. The
oracle proposes the actions; a shield replaces some of them, so that the states differ. A probabilistic shield also
compiles its circuits once for each number of observed entities.

A second table has the time per decision of shields for four egos, whose proposals are random: each ego alone
(`override`), and all of them together (`joint`), by the rules of the mode, which do not read the actions of others, and
by rules that do.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import logicity
from logicity.envs import SPFParallelVectorEnv

#: The number of environments.
COUNT = 64

#: The minimum duration of each measurement, in CPU seconds, and the number of repetitions, of which the fastest counts.
SECONDS, REPETITIONS = 1.0, 3

#: The rates of the sensors, which output beliefs.
SENSORS = {"output": "belief", "true_positive_rate": 0.95, "false_positive_rate": 0.05}


#: The number of egos of the second table.
EGOS = 4

#: Rules in which the actions of other cars matter.
COUPLED = """.include "vocabulary.dl"

Fast(X) :- IsAmbulance(X).
Slow(X) :- Fast(Y), HigherPri(Y, X), IsCar(X).
Stop(X) :- Slow(Y), CollidingClose(X, Y), IsCar(X).
Stop(X) :- IsAtInter(X), IsInInter(Y), X != Y.
"""


def together(mode: str, shield: Mapping[str, Any] | None) -> float:
    """Return the CPU seconds of a step of an ego in environments with several egos."""
    envs = SPFParallelVectorEnv(COUNT, logicity.MODES[mode], overrides={"task": {"egos": EGOS}})
    if shield is not None:
        logicity.shield(envs, **shield)
    envs.reset(seed=0)
    actions = np.random.default_rng(0).integers(0, 4, (64, COUNT, EGOS))
    best = float("inf")
    for _ in range(REPETITIONS):
        begin, calls = time.process_time(), 0
        while (spent := time.process_time() - begin) < SECONDS:
            envs.step(actions[calls % 64])
            calls += 1
        best = min(best, spent / (calls * COUNT * EGOS))
    return best


class Steps:
    """Environments in which the oracle proposes the actions."""

    def __init__(self, mode: str, shield: Mapping[str, Any] | None) -> None:
        """Make the environments, and take some steps."""
        begin = time.process_time()
        self.envs = gymnasium.make_vec(
            f"logicity/SPF-{mode}-v0", num_envs=COUNT, overrides={"task": {"sensors": SENSORS}}
        )
        if shield is not None:
            logicity.shield(self.envs, **shield)
        self._infos = self.envs.reset(seed=0)[1]
        for _ in range(20):
            self._step()
        #: The CPU time until here, in seconds.
        self.start = time.process_time() - begin

    def _step(self) -> None:
        self._infos = self.envs.step(self._infos["oracle_action"])[4]

    def seconds(self) -> float:
        """Return the CPU seconds of a step of one environment."""
        best = float("inf")
        for _ in range(REPETITIONS):
            begin, calls = time.process_time(), 0
            while (spent := time.process_time() - begin) < SECONDS:
                self._step()
                calls += 1
            best = min(best, spent / (calls * COUNT))
        return best


def main() -> None:
    """Print the table."""
    modes = sys.argv[1:] or ["Easy", "Medium", "Hard", "Expert"]
    if unknown := [mode for mode in modes if mode not in logicity.MODES]:
        sys.exit(f"unknown mode `{unknown[0]}`; known: {', '.join(logicity.MODES)}")
    print("| mode | shield | query | microseconds per decision | extra seconds to start |\n|---|---|---|---|---|")
    for mode in modes:
        free = Steps(mode, None)
        base = free.seconds()
        for how in ("override", "probabilistic"):
            for query in ("appropriate", "safe"):
                shielded = Steps(mode, {"mode": how, "query": query})
                price = 1e6 * (shielded.seconds() - base)
                start = shielded.start - free.start
                print(f"| {mode} | {how} | {query} | {price:.2f} | {start:.2f} |", flush=True)
    print(f"\n| mode, {EGOS} egos | shield | rules | microseconds per decision of an ego |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        rules = Path(folder) / "coupled.dl"
        rules.write_text(COUPLED)
        for mode in modes:
            base = together(mode, None)
            for how, of, given in (
                ("override", "of the mode", None),
                ("joint", "of the mode", None),
                ("joint", "that read actions", rules),
            ):
                price = 1e6 * (together(mode, {"mode": how, "query": "safe", "rules": given}) - base)
                print(f"| {mode} | {how} | {of} | {price:.2f} |", flush=True)


if __name__ == "__main__":
    main()
