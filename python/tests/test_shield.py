"""Sensors and shields of Safe Path Following in Python."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs
from gymnasium.error import Error, InvalidAction
from gymnasium.utils.env_checker import data_equivalence

import logicity
from logicity import InputError
from logicity.envs import SPFEnv, SPFParallelEnv, SPFVectorEnv

NOISE: dict[str, Any] = {"true_positive_rate": 0.9, "false_positive_rate": 0.1}


def sensed(**sensors: Any) -> dict[str, Any]:
    return {"task": {"sensors": {**NOISE, **sensors}}}


def test_sensors_are_described() -> None:
    assert SPFEnv("easy").sensors is None
    facts = SPFEnv("easy", overrides=sensed(predicates={"IsAtInter": {"range": 9}})).sensors
    assert facts is not None and facts["output"] == "facts" and facts["ego"] == "sensed"
    assert facts["predicates"]["IsAtInter"]["range"] == 9 and "chains" not in facts["predicates"]["IsAtInter"]
    belief = SPFEnv("easy", overrides=sensed(output="belief", occluded_by="buildings")).sensors
    assert belief is not None and "Sees" not in belief["predicates"]
    for sensor in belief["predicates"].values():
        assert sensor["occluded_by"] == ["buildings"] and len(sensor["chains"]) == 3
        assert all(0 <= probability <= 1 for chain in sensor["chains"] for probability in chain.values())


@pytest.mark.parametrize("output", ["facts", "probabilities", "belief"])
def test_observations_through_sensors_fit_their_space_and_repeat(output: str) -> None:
    def run() -> list[Any]:
        env = gymnasium.make("logicity/SPF-Expert-v0", overrides=sensed(output=output, correlation=0.5))
        observation, info = env.reset(seed=3)
        seen = [observation]
        while len(seen) < 40:
            observation, _, terminated, truncated, info = env.step(info["oracle_action"])
            seen.append(observation)
            assert observation in env.observation_space
            if terminated or truncated:
                observation, info = env.reset()
        return seen

    one, two = run(), run()
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    values = np.unique(np.concatenate(one))
    assert (set(values) <= {0.0, 1.0}) == (output == "facts")


def test_copies_of_sensed_and_shielded_environments_continue_alike() -> None:
    env = logicity.shield(SPFEnv("expert", overrides=sensed(output="belief", delay=1, correlation=0.3)), query="safe")
    env.reset(seed=4)
    for action in (1, 1, 3, 0):
        env.step(action)
    twins = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    for action in (2, 3, 1):
        results = [each.step(action) for each in (env, *twins)]
        for result in results[1:]:
            assert np.array_equal(result[0], results[0][0]) and result[1:4] == results[0][1:4]
            assert result[4]["replaced_action"] == results[0][4]["replaced_action"]
        if results[0][2] or results[0][3]:
            break


def test_the_exact_state_has_no_sensors() -> None:
    with pytest.raises(InputError, match="the observation `state` is exact, but this task has sensors"):
        SPFEnv("easy", overrides=sensed(), observation="state")
    with pytest.raises(InputError, match="`state` is exact"):
        SPFParallelEnv("easy", overrides=sensed(), observation="state")


def test_a_shield_overrides_and_says_why() -> None:
    env = logicity.shield(gymnasium.make("logicity/SPF-Expert-v0", split="test"))
    base: Any = env.unwrapped
    _, info = env.reset(seed=1)
    replaced = 0
    terminated = truncated = False
    while not (terminated or truncated):
        assert info["shield_mask"].tolist() == [int(info["oracle_action"] == action) for action in range(4)]
        assert info["shield_probabilities"].tolist() == info["shield_mask"].tolist()
        wanted = info["oracle_action"]
        _, _, terminated, truncated, info = env.step(3)
        assert info["replaced_action"] == (3 if wanted != 3 else -1)
        assert bool(info["shield_reason"]) == (wanted != 3)
        assert not info["violations"].any()
        if wanted != 3:
            replaced += 1
            name = logicity.ACTIONS[wanted]
            assert info["shield_reason"].startswith(f"{name} replaces Stop\nappropriate by the shield: {name}\n")
    assert replaced and info["success"]
    assert base.shield_clauses == base.clauses
    assert info["shield_mask"].sum() == 1


def test_a_shield_may_come_during_an_episode(tmp_path: Path) -> None:
    rules = tmp_path / "halt.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- Sees(X, X), IsCar(X).\n')
    for arguments in ({"mode": "override"}, {"mode": "mask"}):
        env = SPFEnv("easy", split="test")
        env.reset(seed=1)
        env.step(1)
        logicity.shield(env, rules, **arguments)  # type: ignore[arg-type]
        twin = copy.deepcopy(env)
        assert twin.explain() == env.explain()
        for each in (env, twin):
            if arguments["mode"] == "mask":
                with pytest.raises(InvalidAction):
                    each.step(1)
            else:
                info = each.step(1)[4]
                assert info["replaced_action"] == 1 and info["shield_reason"].startswith("Stop replaces Normal\n")
    cars = SPFParallelEnv("easy")
    cars.reset(seed=1)
    cars.step(dict.fromkeys(cars.agents, 1))
    logicity.shield(cars, rules, mode="mask")
    with pytest.raises(InvalidAction, match="the shield does not permit Normal of Car_1 now; it permits Stop"):
        copy.deepcopy(cars).step(dict.fromkeys(cars.agents, 1))


def test_a_mask_forbids_actions_before_anything_moves() -> None:
    env = logicity.shield(SPFEnv("easy", split="test"), mode="mask")
    _, info = env.reset(seed=2)
    allowed = int(np.flatnonzero(env.action_masks())[0])
    assert info["shield_mask"][allowed] == 1 and info["shield_mask"].sum() == 1
    with pytest.raises(InvalidAction, match="the shield does not permit (Slow|Normal|Fast|Stop) now"):
        env.step((allowed + 1) % 4)
    assert env.step(allowed)[4]["steps"] == 1
    envs = logicity.shield(SPFVectorEnv(3, "easy"), mode="mask")
    envs.reset(seed=2)
    masks = envs.action_masks()
    with pytest.raises(InvalidAction, match="of environment 0"):
        envs.step((masks.argmax(1) + 1) % 4)
    infos = envs.step(masks.argmax(1))[4]
    assert infos["steps"].tolist() == [1, 1, 1] and infos["shield_mask"].shape == (3, 4)


def test_vectors_are_shielded_as_single_environments() -> None:
    overrides = sensed(output="probabilities", ego="exact")
    arguments: dict[str, Any] = {"mode": "probabilistic", "threshold": 0.3}
    envs = logicity.shield(SPFVectorEnv(2, "easy", overrides=overrides, autoreset_mode="SameStep"), **arguments)
    single = logicity.shield(SPFEnv("easy", overrides=overrides), **arguments)
    _, infos = envs.reset(seed=7)
    _, info = single.reset(seed=8)
    rng = np.random.default_rng(0)
    for _ in range(60):
        for key in ("shield_mask", "shield_probabilities", "replaced_action"):
            assert np.array_equal(infos[key][1], info[key]), key
        assert info["shield_probabilities"].sum() == pytest.approx(1)
        action = int(rng.integers(4))
        _, _, _, _, infos = envs.step(np.array([1, action]))
        _, _, terminated, truncated, info = single.step(action)
        if terminated or truncated:
            assert np.array_equal(infos["final_info"]["shield_violations"][1], info["shield_violations"])
            _, info = single.reset()


def test_a_shield_may_have_other_rules(tmp_path: Path) -> None:
    rules = tmp_path / "halt.dl"
    rules.write_text('.include "vocabulary.dl"\n/// H1: always\nStop(X) :- Sees(X, X), IsCar(X).\n')
    env = logicity.shield(SPFEnv("easy"), rules)
    env.reset(seed=1)
    _, _, _, _, info = env.step(1)
    assert env.shield_clauses == ("H1",) and info["shield_violations"].tolist() == [True]
    assert (
        "not appropriate: Slow (violates H1), Normal (violates H1)" in info["shield_reason"]
        and info["replaced_action"] == 1
    )
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsCar(X), previous IsAtInter(X).\n')
    with pytest.raises(InputError, match="shields have no earlier ticks"):
        logicity.shield(SPFEnv("easy"), rules)


def test_every_car_of_a_city_is_shielded() -> None:
    env = logicity.shield(SPFParallelEnv("easy"), query="safe")
    env.reset(seed=1)
    replaced = 0
    for _ in range(20):
        if not env.agents:
            break
        _, _, _, _, infos = env.step(dict.fromkeys(env.agents, 2))
        for info in infos.values():
            assert not info["violations"].any()
            replaced += info["replaced_action"] == 2
        if env.agents:
            assert env.explain_shield(env.agents[0]).startswith("safe by the shield: ")
    assert replaced


def test_a_configured_shield_holds_in_evaluations() -> None:
    def always(observation: Any) -> int:
        return 1

    free = logicity.evaluate(always, "easy", split="val")
    overrides = {"task": {"shield": {"mode": "override"}}}
    shielded = logicity.evaluate(always, "easy", split="val", overrides=overrides)
    assert free.tsr.value < 1 and shielded.tsr.value == 1
    # The oracle has no shield.
    noisy = {"task": {"shield": {"mode": "override"}, "sensors": {"true_positive_rate": 0.5}}}
    assert logicity.evaluate("oracle", "easy", split="val", overrides=noisy).tsr.value == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mode": "guard"}, "mode must be one of"),
        ({"query": "nice"}, "query must be one of"),
        ({"threshold": 0.5}, "needs `mode"),
        ({"mode": "probabilistic", "threshold": 2}, "from 0 to 1"),
        ({"mode": None}, "mode: expected str"),
        ({"mode": "probabilistic", "threshold": True}, "threshold: expected float"),
    ],
)
def test_faulty_shields_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        logicity.shield(SPFEnv("easy"), **arguments)


def test_an_environment_keeps_its_shield_on_an_error(tmp_path: Path) -> None:
    rules = tmp_path / "count.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- Sees(X, X), 1 = count : { IsAtInter(Y) }.\n')
    for env in (SPFEnv("easy"), SPFVectorEnv(2, "easy"), SPFParallelEnv("easy")):
        logicity.shield(env, query="safe")
        before = env.shield_clauses
        with pytest.raises(InputError, match="aggregate"):
            logicity.shield(env, rules, mode="probabilistic")
        env.reset(seed=1)
        assert env.shield_clauses == before


def test_only_shields_are_explained() -> None:
    single, vector, cars = SPFEnv("easy"), SPFVectorEnv(2, "easy"), SPFParallelEnv("easy")
    for explain in (single.explain_shield, lambda: vector.explain_shield(0), lambda: cars.explain_shield("Car_1")):
        with pytest.raises(Error, match="the environment has no shield: add one with `logicity.shield`"):
            explain()


def test_a_joint_shield_of_one_ego_overrides_unsafe_actions() -> None:
    joint, override = (logicity.shield(SPFEnv("expert"), mode=mode, query="safe") for mode in ("joint", "override"))
    chance, changed = np.random.default_rng(1), 0
    for seed in range(3):
        for env in (joint, override):
            env.reset(seed=seed)
        ended = False
        while not ended:
            action = int(chance.integers(4))
            given, expected = joint.step(action), override.step(action)
            assert data_equivalence(given, expected, exact=True)
            changed += given[4]["replaced_action"] >= 0
            ended = given[2] or given[3]
    assert changed


def test_only_environments_have_shields() -> None:
    with pytest.raises(TypeError, match="expected an environment of Safe Path Following, not list"):
        logicity.shield([])
    with pytest.raises(InputError, match="these sensors output facts"):
        logicity.shield(SPFEnv("easy", overrides=sensed()), mode="probabilistic")


def test_learners_of_stable_baselines3_are_shielded() -> None:
    needs("stable_baselines3", "learn")
    from logicity.envs.sb3 import make_vec_env

    envs = logicity.shield(make_vec_env("easy", 2, seed=1), query="safe")
    envs.reset()
    _, _, _, infos = envs.step(np.array([2, 2]))
    assert "shield_mask" in infos[0] and envs.env_method("action_masks")[0].shape == (4,)
    assert envs.env_method("explain_shield")[0].startswith("safe by the shield: ")


def test_learners_without_masks_refuse_them() -> None:
    needs("stable_baselines3", "learn")
    from logicity.learn import TrainConfig
    from logicity.learn.registry import learner_class

    changes = {"overrides": {"task": {"shield": {"mode": "mask"}}}}
    config = TrainConfig.load("configs/baselines/ppo-easy.yaml", changes=changes)
    with pytest.raises(ValueError, match="`ppo` reads no masks: set `mode: override`"):
        learner_class("ppo")(config)
