"""Actions and kinds of agents that a configuration defines."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import needs

import logicity
from logicity import InputError, Simulation
from logicity.evaluation import action_table

CONFIG = """
base: expert
rules: turning.dl
kinds:
  Cyclist: {of: Car, cells: {Normal: 1, Fast: 2}}
predicates:
  define:
    IsCyclist: {kind: Cyclist}
agents:
  test:
    Cyclist:
      - {priority: 30, count: 2}
actions:
  define:
    TurnRight: {cells: {Car: 1}, turn: right}
    Halt: {cells: {Pedestrian: 0}}
  priority: [Stop, TurnRight, Halt, Slow, Fast, Normal]
task:
  reward: {actions: {TurnRight: -2}}
"""
RULES = """
.include "vocabulary.dl"
.decl TurnRight, Halt(x: agent)
.output TurnRight, Halt
.decl IsCyclist(x: agent)
.input IsCyclist
/// R1: right before an intersection, away from a walker
TurnRight(X) :- IsCar(X), IsAtInter(X), Not(IsCyclist(X)), IsPedestrian(Y), NextTo(X, Y).
Halt(X) :- IsPedestrian(X), IsOld(X).
"""
NAMES = ("Slow", "Normal", "Fast", "Stop", "TurnRight", "Halt")


@pytest.fixture
def config(tmp_path: Path) -> str:
    (tmp_path / "turning.dl").write_text(RULES)
    (tmp_path / "turning.yaml").write_text(CONFIG)
    return str(tmp_path / "turning.yaml")


def test_a_simulation_has_own_actions_and_kinds(config: str) -> None:
    city = Simulation(config, split="test")
    assert city.action_names == NAMES
    assert [agent.type for agent in city.agents][-2:] == ["Cyclist", "Cyclist"]
    assert city.agents[-1].name == "Cyclist_2" and city.agents[-1].concepts == ("Cyclist",)
    old = next(row for row, agent in enumerate(city.agents) if "old" in agent.concepts)
    done = city.tick({"Car_2": "TurnRight", 0: 4})
    assert done.derived.shape == (len(city.agents), 6)
    assert done.action[old] == NAMES.index("Halt") and done.derived[old, 5]
    assert done.action[[agent.name for agent in city.agents].index("Car_2")] == 4
    assert "Halt" in str(city.explain(old)) and "Halt" in str(city.why_not(0, "Halt"))
    # A pedestrian takes no action of cars.
    with pytest.raises(InputError, match="cannot take the action `TurnRight`"):
        city.tick({old: "TurnRight"})
    with pytest.raises(ValueError, match="'TurnLeft' is not an action.*TurnRight"):
        city.tick({"Car_2": "TurnLeft"})
    with pytest.raises(ValueError, match="6 is not an action"):
        city.tick({"Car_2": 6})
    assert copy.deepcopy(city).tick().action.tolist() == city.tick().action.tolist()


def test_environments_have_own_actions(config: str) -> None:
    gymnasium = needs("gymnasium", "gym")
    env: Any = gymnasium.make("logicity/SPF-Expert-v0", config=config, action_masks=True)
    assert env.action_space.n == 6 and env.unwrapped.action_names == NAMES
    turned = 0
    for seed in range(8):
        _, info = env.reset(seed=seed)
        ended = False
        while not ended:
            # A car cannot take the last action.
            assert info["action_mask"].shape == (6,) and info["action_mask"][5] == 0
            assert info["action_mask"][info["oracle_action"]] == 1
            turned += info["oracle_action"] == 4
            _, reward, terminated, truncated, info = env.step(info["oracle_action"])
            ended = terminated or truncated
    assert turned > 0
    env.reset(seed=0)
    with pytest.raises(gymnasium.error.InvalidAction, match="Halt is an action that a car cannot take"):
        env.step(5)
    with pytest.raises(gymnasium.error.InvalidAction, match="6 is not an action; known: 0 Slow.*5 Halt"):
        env.step(6)
    vector: Any = logicity.envs.SPFVectorEnv(3, config, action_masks=True)
    assert vector.single_action_space.n == 6
    _, infos = vector.reset(seed=0)
    assert infos["action_mask"].shape == (3, 6)
    vector.step(infos["oracle_action"])


def test_parallel_environments_have_own_actions(config: str) -> None:
    needs("pettingzoo", "multi")
    env = logicity.parallel_env(config)
    _, infos = env.reset(seed=0)
    assert env.action_space("Car_1").n == 6
    # Cyclists are no egos.
    assert all(name.startswith("Car_") for name in env.possible_agents)
    env.step({name: infos[name]["oracle_action"] for name in env.agents})


@pytest.fixture
def recorded(config: str) -> str:
    """The configuration with recorded episodes."""
    made = str(Path(config).parent / "made.jsonl")
    options = ["--split", "test", "--count", "4", "--output", made]
    subprocess.run([sys.executable, "-m", "logicity", "episodes", "make", config, *options], check=True)
    with Path(config).open("a") as file:
        file.write("  episodes: {test: made.jsonl}\n")
    return config


def test_evaluations_have_own_actions(recorded: str) -> None:
    result = logicity.evaluate("oracle", recorded, "test")
    assert result.tsr.value == 1.0 and result.chosen()["TurnRight"] > 0.0 and result.required()["TurnRight"] > 0.0
    assert "TurnRight" in action_table([result]) and "TurnRight" in result.dsr_by_action
    never = logicity.evaluate(lambda observation: 1, recorded, "test")
    assert never.dsr_by_action["TurnRight"].value == 0.0
    with pytest.raises(ValueError, match="6 is not an action; known: 0 Slow.*5 Halt"):
        logicity.evaluate(lambda observation: 6, recorded, "test")


def test_learners_that_have_standard_actions_only_say_so(recorded: str) -> None:
    demonstrated = logicity.demonstrations(recorded, split="test")
    with pytest.raises(ValueError, match=r"expected the actions 0 to 3 \(Slow, Normal, Fast, Stop\)"):
        logicity.induce(demonstrated)
    oracle = logicity.Oracle(lambda scene: "Stop", questions=1)
    with pytest.raises(InputError, match="learned rules have the four standard actions only, not `TurnRight`"):
        logicity.induce(mode=recorded, oracle=oracle)
