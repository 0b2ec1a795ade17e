"""Measure environment steps per CPU second with random actions: `python python/benches/throughput.py [MODE]`.

Sensors and shields alternate with the same environments without them. Their rows have medians over the turns: steps,
and the ratio to those without, which other work on the machine changes less. On Linux, the output also has the memory
that an environment of a vector takes. With Stable-Baselines3 installed, it has the environment's share of the CPU time
of training.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

import gymnasium
import numpy as np

import logicity
from logicity.envs import SPFParallelVectorEnv

#: The minimum duration of each measurement, over all its turns, in CPU seconds.
SECONDS = 3.0

#: How often `compare` measures each environment.
TURNS = 7

#: The number of training steps to measure.
TRAINING_STEPS = 8000

#: The number of environments whose memory is measured, and of their steps.
MANY, MANY_STEPS = 8192, 100

#: The resident memory of this process in pages is the second number of this file.
MEMORY = Path("/proc/self/statm")


#: A function that steps environments. Its argument counts the calls.
Step: TypeAlias = Callable[[int], None]


def rate(steps: int, step: Step, seconds: float = SECONDS) -> float:
    """Return steps per CPU second of all threads. Each call of `step` takes `steps` steps."""
    for call in range(20):
        step(call)
    begin, call = time.process_time(), 0
    while (spent := time.process_time() - begin) < seconds:
        for _ in range(20):
            step(call)
            call += 1
    return call * steps / spent


def single(mode: str) -> float:
    """Measure one environment of `gymnasium.make`, without the wrapper that checks every call."""
    env = gymnasium.make(f"logicity/SPF-{mode}-v0", disable_env_checker=True).unwrapped
    actions = np.random.default_rng(0).integers(4, size=4096)
    env.reset(seed=0)

    def step(call: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[call % 4096])
        if terminated or truncated:
            env.reset()

    return rate(1, step)


def compare(base: Step, others: Mapping[str, Step]) -> dict[str, str]:
    """Return by name the median of the steps per CPU second, and of their ratio to those of `base`.

    Each call of a function steps 256 environments.
    """
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in others}
    for _ in range(TURNS):
        first = rate(256, base, SECONDS / TURNS)
        for name, step in others.items():
            steps = rate(256, step, SECONDS / TURNS)
            found[name].append((steps, steps / first))
    medians = {name: [median(each) for each in zip(*turns, strict=True)] for name, turns in found.items()}
    return {name: f"{steps:,.0f}; {ratio:.2f}" for name, (steps, ratio) in medians.items()}


def vector(mode: str, count: int, threads: int, **options: Any) -> float:
    """Measure a vectorized environment."""
    return rate(count, random_steps(mode, count, threads, **options))


def random_steps(mode: str, count: int, threads: int, **options: Any) -> Step:
    """Return a function that steps a vectorized environment with random actions."""
    envs = gymnasium.make_vec(f"logicity/SPF-{mode}-v0", num_envs=count, num_threads=threads, **options)
    actions = np.random.default_rng(0).integers(4, size=(64, count))
    envs.reset(seed=0)

    def step(call: int) -> None:
        envs.step(actions[call % 64])

    return step


def oracle_steps(mode: str, shield: Mapping[str, Any] | None = None) -> Step:
    """Return a function that steps 256 environments with the oracle's actions, which exact shields permit."""
    envs = gymnasium.make_vec(f"logicity/SPF-{mode}-v0", num_envs=256)
    if shield is not None:
        logicity.shield(envs, **shield)
    infos = envs.reset(seed=0)[1]

    def step(call: int) -> None:
        nonlocal infos
        infos = envs.step(infos["oracle_action"])[4]

    return step


def several(mode: str, egos: int, told: int | None = None) -> float:
    """Measure 64 environments with several egos and told facts under the oracle's actions. Count the steps of egos."""
    task: dict[str, Any] = {"egos": egos}
    if told is not None:
        task["sensors"] = {"range": 12, "share": {"facts": told, "by": "relevance"}}
    envs = SPFParallelVectorEnv(64, logicity.MODES[mode], overrides={"task": task})
    infos = envs.reset(seed=0)[1]

    def step(call: int) -> None:
        nonlocal infos
        infos = envs.step(infos["oracle_action"])[4]

    return rate(64 * egos, step)


def memory(mode: str) -> float:
    """Return the growth of resident memory per environment of a vector, without the arrays of observations."""

    def make(count: int) -> gymnasium.vector.VectorEnv:
        envs = gymnasium.make_vec(f"logicity/SPF-{mode}-v0", num_envs=count, num_threads=1, copy=False)
        envs.reset(seed=0)
        return envs

    def resident() -> int:
        return int(MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGESIZE")

    # The first environments load what all share.
    few = make(64)
    before = resident()
    envs = make(MANY)
    actions = np.random.default_rng(0).integers(4, size=(MANY_STEPS, MANY))
    before += actions.nbytes
    for row in actions:
        observations, *_ = envs.step(row)
    few.close()
    return float(resident() - before - observations.nbytes) / MANY


def stable_baselines(mode: str, count: int) -> float:
    """Measure the adapter for Stable-Baselines3."""
    from logicity.envs.sb3 import make_vec_env

    envs = make_vec_env(logicity.MODES[mode], count, seed=0, monitor=False)
    actions = np.random.default_rng(0).integers(4, size=(64, count))
    envs.reset()

    def step(call: int) -> None:
        envs.step(actions[call % 64])

    return rate(count, step)


def training_share(mode: str) -> float:
    """Return the fraction of the CPU time of DQN training that environments and their adapter take."""
    from logicity.envs.sb3 import make_vec_env
    from logicity.learn import TrainConfig
    from logicity.learn.stable_baselines import new_model

    config = TrainConfig.load(f"configs/baselines/dqn-{logicity.MODES[mode]}-tuned.yaml")
    envs = make_vec_env(config.mode, config.envs, config.seed)
    model = new_model(config, envs)
    model.learn(config.settings.model_dump()["learning_starts"])
    core, spent = envs.venv, 0.0
    step_wait = core.step_wait

    def timed() -> object:
        nonlocal spent
        begin = time.process_time()
        result = step_wait()
        spent += time.process_time() - begin
        return result

    core.step_wait = timed
    begin = time.process_time()
    model.learn(TRAINING_STEPS, reset_num_timesteps=False)
    return spent / (time.process_time() - begin)


def noisy(output: str) -> dict[str, Any]:
    """Return options of environments with noisy sensors."""
    sensors = {"output": output, "true_positive_rate": 0.95, "false_positive_rate": 0.05}
    return {"overrides": {"task": {"sensors": sensors}}}


def main() -> None:
    """Print the table."""
    mode = sys.argv[1] if len(sys.argv) > 1 else "Expert"
    if mode not in logicity.MODES:
        sys.exit(f"unknown mode `{mode}`; known: {', '.join(logicity.MODES)}")
    print(f"| {mode}, random actions unless the row says otherwise | steps per CPU second |\n|---|---|")
    rows: list[tuple[str, Callable[[], float]]] = [
        ("`make`, one environment", lambda: single(mode)),
        ("`make_vec`, 64 environments, 1 thread", lambda: vector(mode, 64, 1)),
        ("`make_vec`, 256 environments, 1 thread", lambda: vector(mode, 256, 1)),
        ("`make_vec`, 1,024 environments, 1 thread", lambda: vector(mode, 1024, 1)),
        ("256, `copy=False`", lambda: vector(mode, 256, 1, copy=False)),
        ("256, autoreset mode SameStep", lambda: vector(mode, 256, 1, autoreset_mode="SameStep")),
        ('256, `observation="relational"`', lambda: vector(mode, 256, 1, observation="relational")),
        ("64 environments, 4 egos each, oracle's actions, steps of egos", lambda: several(mode, 4)),
        ("the same, range 12", lambda: several(mode, 4, 0)),
        ("the same, 4 told facts by relevance", lambda: several(mode, 4, 4)),
        ('256, `observation="graph"`', lambda: vector(mode, 256, 1, observation="graph")),
        ("`make_vec`, 256 environments, 2 threads", lambda: vector(mode, 256, 2)),
        ("256, the oracle's actions", lambda: rate(256, oracle_steps(mode))),
    ]
    if importlib.util.find_spec("stable_baselines3"):
        rows.append(("`sb3.make_vec_env`, 256 environments", lambda: stable_baselines(mode, 256)))
    for name, measure in rows:
        print(f"| {name} | {measure():,.0f} |", flush=True)
    outputs = {output: random_steps(mode, 256, 1, **noisy(output)) for output in ("facts", "probabilities", "belief")}
    print("\n| 256 environments | steps per CPU second; ratio to the same without |\n|---|---|")
    for name, found in compare(random_steps(mode, 256, 1), outputs).items():
        print(f"| noisy sensors, `output: {name}` | {found} |", flush=True)
    ways = [(how, query) for how in ("mask", "override") for query in ("appropriate", "safe")]
    shields = {f"`{how}`, `{query}`": oracle_steps(mode, {"mode": how, "query": query}) for how, query in ways}
    for name, found in compare(oracle_steps(mode), shields).items():
        print(f"| the oracle's actions, shield {name} | {found} |", flush=True)
    if MEMORY.exists():
        print(f"\nThe memory of an environment of a vector: {memory(mode):,.0f} bytes")
    if not importlib.util.find_spec("stable_baselines3"):
        print("\nInstall Stable-Baselines3 (`pip install './python[learn]'`) to measure the share of training time.")
    elif mode in ("Easy", "Medium", "Hard", "Expert"):
        print(f"\nThe environment's share of the CPU time of training DQN: {training_share(mode):.1%}")


if __name__ == "__main__":
    main()
