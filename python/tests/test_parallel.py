from __future__ import annotations

import copy
import inspect
import itertools
import pickle
import re
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import needs
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import data_equivalence

import logicity
from logicity.describe import environment_page, parallel_page
from logicity.types import EnvOptions

needs("pettingzoo", "pettingzoo")
with warnings.catch_warnings():
    # With pygame installed, the import loads deprecated environments.
    warnings.simplefilter("ignore")
    from pettingzoo.test import parallel_api_test, parallel_seed_test


@pytest.mark.parametrize("mode", list(logicity.MODES.values()))
def test_pettingzoo_checks_pass(mode: str) -> None:
    parallel_api_test(logicity.parallel_env(mode), num_cycles=300)
    parallel_seed_test(lambda: logicity.parallel_env(mode), num_cycles=100)


def test_unknown_options_raise() -> None:
    with pytest.raises(
        TypeError, match="got an unexpected keyword argument 'episodes'; known: split, .*, render_mode$"
    ):
        logicity.parallel_env("easy", episodes="recorded")


def test_finished_cars_follow_the_rules() -> None:
    env = logicity.parallel_env("expert", observation="state", render_mode="ansi")
    observations, infos = env.reset(seed=3)
    assert list(observations) == env.agents == env.possible_agents == [f"Car_{number}" for number in range(1, 8)]
    start = env.episode
    ended: set[str] = set()
    while env.agents:
        wanted: dict[str, Any] = {name: infos[name]["oracle_action"] for name in env.agents}
        # Car_1 disobeys the oracle.
        wanted.update({name: 3 - wanted[name] for name in ("Car_1",) if name in wanted})
        observations, rewards, terminated, truncated, infos = env.step(wanted)
        assert observations.keys() == rewards.keys() == terminated.keys() == truncated.keys() == infos.keys()
        assert not ended & observations.keys()
        ended |= {name for name in terminated if terminated[name] or truncated[name]}
        if "Car_1" in infos and terminated["Car_1"]:
            assert set(itertools.compress(env.clauses, infos["Car_1"]["violations"])) <= set(env.clauses)
            assert infos["Car_1"]["violations"].any()
    assert ended == set(env.possible_agents)
    assert "Car_7 at [" in env.render()
    env.reset(options={"episode": start})
    assert env.episode == start
    assert env.explain("Car_2").startswith("tick 0: Car_2 at [")


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "deepcopy", "pickle"]
)
def test_a_copy_continues_identically(again: Callable[[Any], Any]) -> None:
    env = logicity.parallel_env("hard", observation="state")
    assert again(env).agents == []
    with pytest.raises(ResetNeeded):
        again(env).step({})
    env.reset(seed=4)
    generator, ended = np.random.default_rng(0), 0

    def proceed(envs: list[Any]) -> None:
        nonlocal ended
        if not envs[0].agents:
            starts = [each.reset() for each in envs]
            assert all(data_equivalence(starts[0], start, exact=True) for start in starts)
        actions = {name: int(generator.integers(4)) for name in envs[0].agents}
        results = [each.step(actions) for each in envs]
        ended += sum(results[0][2].values())
        assert all(data_equivalence(results[0], result, exact=True) for result in results)

    for rounds in (0, 3, 40):
        for _ in range(rounds):
            proceed([env])
        twin = again(env)
        assert twin.agents == env.agents and twin.episode == env.episode
        for _ in range(40):
            proceed([env, twin])
    assert ended > 10


def test_invalid_use_raises() -> None:
    env = logicity.parallel_env("easy")
    with pytest.raises(ResetNeeded):
        env.step({})
    env.reset(seed=0)
    for actions, message in [
        ({"Car_1": 0}, "missing action of Car_2"),
        (dict.fromkeys(env.agents, 4), "4 is not an action"),
        (dict.fromkeys(env.agents, 0.5), "0.5 is not an action"),
        (dict.fromkeys(env.agents, True), "True is not an action"),
        ({"Car_99": 1}, "unknown car `Car_99`; did you mean"),
    ]:
        with pytest.raises(InvalidAction, match=message):
            env.step(actions)  # type: ignore[arg-type]
    for space in (env.observation_space, env.action_space):
        with pytest.raises(
            KeyError, match="unknown car `car 1`; did you mean `Car_1`|unknown car `car 1`; known: Car_1"
        ):
            space("car 1")
    infos = env.step(dict.fromkeys(env.agents, 1))[4]
    assert isinstance(env.reset(seed=0)[1]["Car_1"]["seed"], np.int64)
    assert isinstance(infos["Car_1"]["seed"], np.int64)
    with pytest.raises(ValueError, match="unknown car `Car_77`; (did you mean|there are)"):
        env.explain("Car_77")
    with pytest.raises(InvalidAction, match="expected a mapping"):
        env.step(None)  # type: ignore[arg-type]
    for options in (5, 0):
        with pytest.raises(TypeError, match="^options: expected dict, not int"):
            env.reset(options=options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="mapping"):
        env.reset(options={"episode": -1})
    with pytest.raises(IndexError, match="no episode 1000"):
        env.reset(options={"episode": 1000})


def test_the_page_describes_the_environment() -> None:
    page = parallel_page()
    sections = dict(part.split("\n", 1) for part in page.split("\n## ")[1:])
    # The sections of the pages of the other environments, in the same order.
    assert list(sections) == re.findall(r"^## (.*)$", environment_page("easy"), re.MULTILINE)

    def column(section: str, number: int = 0) -> list[str]:
        rows = [line.strip("| ").split(" | ") for line in sections[section].splitlines() if line.startswith("| ")]
        return [row[number].strip("`") for row in rows[1:]]

    for mode, cars, space, horizon in zip(*(column("Description", at) for at in range(4)), strict=True):
        counts = []
        for split in ("train", "val", "test"):
            env = logicity.parallel_env(mode, split=split, action_masks=True)
            counts.append(len(env.possible_agents))
        assert cars == " / ".join(map(str, counts)) and space == repr(env.observation_space("Car_1"))
        env.reset(seed=0)
        # Some cars stand until the horizon without violating a rule.
        steps = 0
        while env.agents:
            *_, truncated, infos = env.step(dict.fromkeys(env.agents, 3))
            steps += 1
        assert all(truncated.values()) and str(steps) == horizon
    assert column("Description") == list(logicity.ENVIRONMENTS)
    parameters = inspect.signature(type(env)).parameters.values()
    named = {each.name for each in parameters if each.kind is each.KEYWORD_ONLY} | set(EnvOptions.__annotations__)
    assert set(column("Arguments")) == named
    assert set(column("Information")) == set(next(iter(infos.values())))
