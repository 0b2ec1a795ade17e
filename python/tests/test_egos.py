"""Environments, evaluations and training with several egos."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs
from gymnasium.error import Error, InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import data_equivalence

import logicity
from logicity.envs.parallel_vector import SPFParallelVectorEnv
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv

THREE = {"task": {"egos": 3, "horizon": 40}}


def obedient(infos: dict[str, Any], generator: np.random.Generator) -> Any:
    """Return the actions of the oracle, a few of them replaced by random ones."""
    wanted = infos["oracle_action"]
    return np.where(generator.random(wanted.shape) < 0.9, wanted, generator.integers(0, 4, wanted.shape))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("observation", ["groundings", "graph"])
def test_a_vector_equals_parallel_environments(mode: str, observation: Any) -> None:
    needs("pettingzoo", "pettingzoo")
    options: dict[str, Any] = {"overrides": THREE, "observation": observation, "action_masks": True}
    envs = SPFParallelVectorEnv(4, "expert", autoreset_mode=mode, num_threads=2, atoms=True, **options)
    alone = [logicity.parallel_env("expert", **options) for _ in range(4)]
    names = envs.possible_agents
    assert names == alone[0].possible_agents == ["Car_1", "Car_2", "Car_3"]
    assert envs.single_observation_space == alone[0].observation_space("Car_1")
    observations, infos = envs.reset(seed=5)
    assert envs.observation_space.contains(observations) and envs.action_space.contains(envs.action_space.sample())
    starts = [env.reset(seed=5 + at) for at, env in enumerate(alone)]

    def row(values: Any, at: int, ego: int) -> Any:
        return {key: each[at, ego] for key, each in values.items()} if isinstance(values, dict) else values[at, ego]

    def check(at: int, shown: dict[str, Any], known: dict[str, dict[str, Any]]) -> None:
        for ego, name in enumerate(names):
            assert infos["active"][at, ego] == (name in alone[at].agents)
            if name in known:
                assert data_equivalence(row(observations, at, ego), shown[name], exact=True)
                for key, value in known[name].items():
                    assert np.array_equal(infos[key][at, ego], value), key

    for at, (shown, known) in enumerate(starts):
        check(at, shown, known)
    generator, ended = np.random.default_rng(0), 0
    for _ in range(150):
        if mode == "Disabled" and (over := ~infos["active"].any(1)).any():
            observations, infos = envs.reset(options={"reset_mask": over})
            for at in np.flatnonzero(over).tolist():
                check(at, *alone[at].reset())
            # The others keep their infos, which the reset does not repeat.
            infos = {**infos, "active": np.array([[name in env.agents for name in names] for env in alone])}
            infos["oracle_action"] = generator.integers(0, 4, (4, 3))
        actions = obedient(infos, generator)
        before = [list(env.agents) for env in alone]
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        assert rewards.shape == terminated.shape == truncated.shape == (4, 3)
        for at, env in enumerate(alone):
            if not before[at]:
                assert not rewards[at].any() and not terminated[at].any() and not truncated[at].any()
                check(at, *env.reset())
                continue
            shown, reward, end, cut, known = env.step(dict(zip(names, actions[at].tolist(), strict=True)))
            for ego, name in enumerate(names):
                expected = (reward.get(name, 0.0), end.get(name, False), cut.get(name, False))
                assert (rewards[at, ego], terminated[at, ego], truncated[at, ego]) == expected
            if not env.agents and mode == "SameStep":
                ended += 1
                assert infos["_final_obs"][at]
                for name in known:
                    ego = names.index(name)
                    assert np.array_equal(infos["final_info"]["violations"][at, ego], known[name]["violations"])
                    final = infos["final_obs"][at]
                    last = {key: each[ego] for key, each in final.items()} if isinstance(final, dict) else final[ego]
                    assert data_equivalence(last, shown[name], exact=True)
                shown, known = env.reset()
            elif not env.agents:
                ended += 1
            check(at, shown, known)
    assert ended > 10
    state = envs.state()
    twin = SPFParallelVectorEnv(4, "expert", autoreset_mode=mode, atoms=True, **options)
    twin.restore(state)
    with pytest.raises(ValueError, match="a state of 3 egos, not of 2"):
        SPFParallelVectorEnv(4, "expert", overrides={"task": {"egos": 2}}).restore(state)
    if mode != "Disabled":
        for _ in range(20):
            actions = generator.integers(0, 4, (4, 3))
            assert data_equivalence(envs.step(actions), twin.step(actions), exact=True)


def test_invalid_use_raises() -> None:
    with pytest.raises(ValueError, match="has 3 egos .*`SPFEnv` controls one car: use `SPFParallelEnv` or"):
        SPFEnv("easy", overrides=THREE)
    with pytest.raises(ValueError, match="`SPFVectorEnv` controls one car"):
        SPFVectorEnv(2, "easy", overrides=THREE)
    with pytest.raises(logicity.InputError, match="the split `train` has 6 cars, not 7"):
        SPFParallelVectorEnv(2, "easy", overrides={"task": {"egos": 7}})
    envs = SPFParallelVectorEnv(2, "easy", overrides=THREE)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 3), np.int64))
    with pytest.raises(Error, match="make it with `action_masks=True`, or add a shield"):
        envs.action_masks()
    with pytest.raises(Error, match="the environment has no shield"):
        envs.explain_shield(0, "Car_1")
    with pytest.raises(Error, match="seed: expected an integer or a list, not str"):
        envs.reset(seed="x")  # type: ignore[arg-type]
    envs.reset(seed=1)
    with pytest.raises(InvalidAction, match=r"expected integers of shape \(2, 3\)"):
        envs.step([0, 1])
    with pytest.raises(InvalidAction, match="of Car_3 in environment 1"):
        envs.step(np.array([[0, 0, 0], [0, 0, 9]]))
    with pytest.raises(ValueError, match="unknown car `Car_4`; did you mean"):
        envs.explain(0, "Car_4")
    with pytest.raises(IndexError, match="no environment 2"):
        envs.explain(2, "Car_1")
    assert envs.explain(1, "Car_2").startswith("tick 0: Car_2 at [")


def test_shields_judge_every_ego() -> None:
    envs = SPFParallelVectorEnv(3, "expert", overrides=THREE, autoreset_mode="SameStep")
    logicity.shield(envs)
    infos, generator = envs.reset(seed=0)[1], np.random.default_rng(1)
    assert infos["shield_mask"].shape == envs.action_masks().shape == (3, 3, 4)
    replaced = 0
    for _ in range(100):
        masks = infos["shield_mask"]
        assert np.array_equal(masks.argmax(-1), infos["oracle_action"])
        *_, infos = envs.step(generator.integers(0, 4, (3, 3)))
        assert not infos["violations"].any()
        replaced += (infos["replaced_action"] >= 0).sum()
    assert replaced > 100
    assert "by the shield" in envs.explain_shield(0, "Car_2")
    logicity.shield(envs, mode="mask", query="safe")
    envs.reset(seed=0)
    with pytest.raises(InvalidAction, match="of Car_[123] in environment"):
        for _ in range(100):
            envs.step(generator.integers(0, 4, (3, 3)))


def test_joint_shields_read_the_actions_of_others(tmp_path: Path) -> None:
    rules = tmp_path / "coupled.dl"
    rules.write_text('.include "vocabulary.dl"\nSlow(X) :- Fast(Y), IsClose(X, Y), IsCar(X).\n')
    envs = SPFParallelVectorEnv(8, "expert", overrides={"task": {"egos": 4}}, autoreset_mode="SameStep", atoms=True)
    logicity.shield(envs, rules=rules, mode="joint")
    infos, generator = envs.reset(seed=0)[1], np.random.default_rng(2)
    changed = yielded = 0
    for _ in range(240):
        atoms, acts, before = infos["true_atoms"], infos["active"], generator.integers(0, 4, (8, 4))
        *_, infos = envs.step(before)
        replaced = infos["replaced_action"]
        # In the steps in which no episode ended, infos are of the same episode.
        for at in np.flatnonzero(~infos.get("_final_info", np.zeros(8, np.bool_))):
            proposed, taken = before[at], envs._core.taken(int(at))[-4:]
            for (one, x), (two, y) in itertools.permutations(enumerate(envs.possible_agents), 2):
                # The view of a car decides whether it observes the other.
                if acts[at, one] and acts[at, two] and f"IsClose({x}, {y})" in atoms[at, one] and taken[two] == 2:
                    assert taken[one] == 0
                    yielded += 1
            for ego in np.flatnonzero(acts[at]):
                assert (replaced[at, ego] >= 0) == (taken[ego] != proposed[ego])
                changed += taken[ego] != proposed[ego]
    assert changed > 20 and yielded > 0
    for query, message in (("appropriate", 'use `query="safe"`'), ("sae", "query must be one of")):
        with pytest.raises(ValueError, match=message):
            logicity.shield(envs, mode="joint", query=query)  # type: ignore[arg-type]
    # The environments keep their shield.
    assert envs.shield_clauses is not None and len(envs.shield_clauses) == 1


def test_evaluations_count_egos_alone_and_together(tmp_path: Path) -> None:
    overrides = {"task": {"egos": 3}}
    benchmark = logicity.Benchmark("expert", "val", overrides=overrides)
    oracle, random = benchmark.evaluate("oracle"), benchmark.evaluate("random")
    count = len(benchmark)
    assert len(oracle.episodes) == 3 * count and len(random.episodes) == 30 * count
    for ego, record in zip(itertools.cycle(range(3)), oracle.episodes):  # noqa: B905 endless
        assert record.ego == ego
    assert oracle.joint_tsr is not None and oracle.joint_tsr.value > 0.8
    assert random.joint_tsr is not None and random.joint_tsr.value < 0.1
    by_episode = [[r.success for r in oracle.episodes[at : at + 3]] for at in range(0, 3 * count, 3)]
    assert oracle.joint_tsr.value == pytest.approx(np.mean([all(each) for each in by_episode]))
    assert oracle.tsr.value == pytest.approx(np.mean(by_episode))
    assert "joint TSR" in oracle.summary() and "joint_tsr" in oracle.to_dict()
    # Results of one ego have no joint measures.
    first = logicity.evaluate("oracle", "expert", "val")
    assert "joint_tsr" not in first.to_dict() and "ego" not in first.to_dict()["episodes"][0]
    # Each ego can have its own policy.
    slow = benchmark.evaluate(["oracle", lambda observation: 3, "oracle"], traces=tmp_path)
    stood = [record for record in slow.episodes if record.ego == 1]
    assert all(record.actions.keys() == {"Stop"} for record in stood)
    assert not any(record.success for record in stood) and slow.joint_tsr is not None and slow.joint_tsr.value == 0
    for policies, message in (
        (["oracle", "oracle"], "2 policies for 3 egos: set `task.egos` to 2"),
        ([], "0 policies for 3 egos: pass one for each ego"),
        (["oracle", "oracle", "random"], "the random policy runs every episode ten times"),
    ):
        with pytest.raises(ValueError, match=message):
            benchmark.evaluate(policies)  # type: ignore[arg-type]
    # A trace has the executed actions.
    for mode in ("override", "joint"):
        shield = {"mode": mode, "query": "safe"}
        options: dict[str, Any] = {"overrides": {"task": {"egos": 3, "shield": shield}}, "traces": tmp_path / mode}
        shielded = logicity.evaluate(lambda observation: 2, "expert", "val", **options)
        assert shielded.tsr.value > 0.9 and len(list((tmp_path / mode).glob("*.jsonl"))) == count
        _, *ticks = map(json.loads, (tmp_path / mode / "episode-0.jsonl").read_text(encoding="utf-8").splitlines())
        assert not any(agent["driven"]["broken"] for tick in ticks for agent in tick["agents"] if "driven" in agent)
    assert len(list(tmp_path.glob("episode-*.jsonl"))) == count
    # In a trace, an ego is driven until its episode ends.
    for episode in range(3):
        header, *ticks = map(
            json.loads, (tmp_path / f"episode-{episode}.jsonl").read_text(encoding="utf-8").splitlines()
        )
        names = [agent["id"] for agent in header["agents"]]
        pairs = [zip(names, tick["agents"], strict=True) for tick in ticks]
        driven = [name for each in pairs for name, agent in each if "driven" in agent]
        steps = [record.steps for record in slow.episodes[3 * episode : 3 * episode + 3]]
        assert [driven.count(f"Car_{ego}") for ego in (1, 2, 3)] == steps and len(driven) == sum(steps)


@pytest.mark.parametrize("policies", ["shared", "separate"])
def test_egos_learn(policies: str, tmp_path: Path) -> None:
    needs("torch", "learn")
    from logicity.learn.config import TrainConfig
    from logicity.learn.fast_ppo import FastPPOPolicy
    from logicity.learn.policies import load_policy
    from logicity.learn.run import train

    values: dict[str, Any] = {
        "algorithm": "ppo-fast",
        "mode": "easy",
        "overrides": {"task": {"egos": 3}},
        "steps": 6000,
        "validate_every": 3000,
        "envs": 8,
        "settings": {"policies": policies, "network": [8]},
    }
    config = TrainConfig.model_validate(values)
    result = train(config, tmp_path / "one")
    assert 0 <= result["test"]["joint_tsr"]["value"] <= result["test"]["tsr"]["value"]
    policy = load_policy(tmp_path / "one").policy
    assert isinstance(policy, FastPPOPolicy)
    assert len(policy._networks) == (1 if policies == "shared" else 3)
    if policies == "separate":
        with pytest.raises(ValueError, match="3 policies for 1 ego: set `task.egos` to 3, or pass one policy"):
            logicity.evaluate(policy, "easy", "val")

    def interrupt(steps: int) -> None:
        if steps > 3000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "two", report=interrupt)
    resumed = train(config, tmp_path / "two")
    assert resumed["test"] == result["test"]


def test_learners_of_one_car_refuse_several(tmp_path: Path) -> None:
    needs("torch", "learn")
    from logicity.learn.config import TrainConfig
    from logicity.learn.run import train

    config = TrainConfig.load("dqn-easy", changes={"overrides": {"task": {"egos": 2}}, "steps": 100})
    with pytest.raises(ValueError, match="`dqn` drives one car in training, not the 2 egos"):
        train(config, tmp_path / "run")
