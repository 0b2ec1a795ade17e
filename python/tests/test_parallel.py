from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded

import logicity

pytest.importorskip("pettingzoo", reason="needs the extra `pettingzoo`")
from pettingzoo.test import parallel_api_test, parallel_seed_test  # noqa: E402


@pytest.mark.parametrize("mode", list(logicity.MODES.values()))
def test_pettingzoo_checks_pass(mode: str) -> None:
    parallel_api_test(logicity.parallel_env(mode), num_cycles=300)
    parallel_seed_test(lambda: logicity.parallel_env(mode), num_cycles=100)


def test_unknown_options_raise() -> None:
    with pytest.raises(TypeError, match="no option `episodes`; known: split, .*, render_mode$"):
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
            assert infos["Car_1"]["violations"]
    assert ended == set(env.possible_agents)
    assert "Car_7 at [" in env.render()
    env.reset(options={"episode": start})
    assert env.episode == start
    assert env.explain("Car_2").startswith("tick 0: Car_2 at [")


def test_invalid_use_raises() -> None:
    env = logicity.parallel_env("easy")
    with pytest.raises(ResetNeeded):
        env.step({})
    env.reset(seed=0)
    for actions in ({"Car_1": 0}, dict.fromkeys(env.agents, 4), dict.fromkeys(env.agents, 0.5), {"Car_99": 1}):
        with pytest.raises(InvalidAction):
            env.step(actions)  # type: ignore[arg-type]
    infos = env.step(dict.fromkeys(env.agents, 1))[4]
    assert isinstance(env.reset(seed=0)[1]["Car_1"]["seed"], np.uint64)
    assert isinstance(infos["Car_1"]["seed"], np.uint64)
    with pytest.raises(ValueError, match="unknown car `Car_77`; (did you mean|there are)"):
        env.explain("Car_77")
    with pytest.raises(ValueError, match="mapping"):
        env.reset(options={"episode": 1})
    with pytest.raises(TypeError, match="cannot be pickled"):
        pickle.dumps(env)
