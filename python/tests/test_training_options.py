"""Options of the environments for training: reward terms, demanding episodes, curricula, masks, and the oracle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import logicity
from logicity import _logicity
from logicity.describe import _rewards, describe
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv
from logicity.evaluation import Benchmark
from logicity.tasks import load_task

SHAPED = {"task": {"reward": {"progress": 5, "goal": 3, "potential": {"weight": 2, "of": "progress", "gamma": 0.9}}}}


def test_reward_terms_agree_with_their_definitions() -> None:
    shaped, plain = SPFEnv("easy", overrides=SHAPED), SPFEnv("easy")
    generator = np.random.default_rng(0)
    ends = {"goal": 0, "violation": 0}
    for seed in range(40):
        _, info = shaped.reset(seed=seed)
        plain.reset(seed=seed)
        done = False
        while not done:
            before = info["progress"]
            obeys = seed % 2 or generator.random() < 0.9
            action = int(info["oracle_action"] if obeys else generator.integers(4))
            _, reward, terminated, truncated, info = shaped.step(action)
            _, task_reward, *_ = plain.step(action)
            following = 0 if terminated else 2 * info["progress"]
            expected = task_reward + 5 * (info["progress"] - before) + 3 * info["success"]
            expected += 0.9 * following - 2 * before
            assert abs(reward - expected) < 1e-12
            done = terminated or truncated
            ends["goal"] += info["success"]
            ends["violation"] += bool(info["violations"].any())
    assert min(ends.values()) > 5


def test_evaluations_have_no_reward_terms() -> None:
    def play(overrides: dict[str, Any] | None, split: Any) -> list[float]:
        env = SPFEnv("easy", split=split, episodes="recorded", overrides=overrides)
        env.reset(seed=1)
        return [env.step(3)[1] for _ in range(20)]

    waiting = {"task": {"reward": {"potential": {"weight": 2}}}}
    assert play(waiting, "val") == play(None, "val") and play(waiting, "test") == play(None, "test")
    # With the potential of the remaining share, waiting has a reward of 2 - 0.99 x 2.
    expected = [reward + 0.02 for reward in play(None, "train")]
    assert play(waiting, "train") == pytest.approx(expected, abs=1e-12)
    results = [Benchmark("easy", "val", overrides=overrides).evaluate("oracle") for overrides in (None, SHAPED)]
    assert results[0].mean_return == results[1].mean_return and results[0].score == results[1].score


def test_the_description_names_reward_terms() -> None:
    assert "add terms in the split `train`" in describe() and "These modes have none." in describe()
    text = _rewards({"easy": _logicity.describe(load_task("easy", None, SHAPED))})
    assert "| easy | 5 | 3 | 2 x progress, gamma 0.9 |" in text and "none." not in text


def test_the_rules_constrain_demanding_episodes() -> None:
    # In easy mode the rules require only Stop.
    demanding = SPFEnv("easy", episodes="drawn-demanding", overrides={"task": {"constrained_steps": 4}})
    drawn = SPFEnv("easy")
    demanding.reset(seed=1)
    drawn.reset(seed=1)
    counts: dict[str, list[int]] = {"demanding": [], "drawn": []}
    for _ in range(12):
        for name, env in (("demanding", demanding), ("drawn", drawn)):
            _, info = env.reset()
            assert info["steps"] == 0
            counts[name].append(oracle_stops(env))
    assert min(counts["demanding"]) >= 4 > min(counts["drawn"])


def oracle_stops(env: SPFEnv) -> int:
    """Run the oracle from the start of the current episode, and count the steps in which it stops."""
    _, info = env.reset(options={"episode": env.episode})
    count, done = 0, False
    while not done:
        count += info["oracle_action"] == 3
        _, _, terminated, truncated, info = env.step(info["oracle_action"])
        done = terminated or truncated
    return count


def test_a_search_for_demanding_episodes_ends() -> None:
    overrides = {"task": {"horizon": 2, "curriculum": [{"until": 1, "agents": 1}]}}
    env = SPFEnv("easy", episodes="drawn-demanding", overrides=overrides)
    with pytest.raises(logicity.InputError, match="in none of 1000 drawn episodes") as caught:
        env.reset(seed=0)
    assert caught.value.diagnostics[0]["code"] == "limit-exceeded"


def test_a_curriculum_adds_agents(tmp_path: Path) -> None:
    overrides = {"task": {"curriculum": [{"until": 2, "agents": 3}, {"until": 4, "agents": 5}]}}
    env, envs = SPFEnv("easy", overrides=overrides), SPFVectorEnv(2, "easy", overrides=overrides)
    counts = []
    for number in range(6):
        env.reset(seed=4 if number == 0 else None)
        envs.reset(seed=[3, 4] if number == 0 else None)
        assert envs.episode(1) == env.episode
        agents = [agent["id"] for agent in env.episode["agents"]]
        assert agents[0] == "Car_1"
        counts.append(len(agents))
    assert counts == [3, 3, 5, 5, 8, 8]
    env.reset(seed=4)
    start = env.episode
    for _ in range(3):
        env.step(1)
    env.write_trace(tmp_path / "trace.jsonl")
    header = json.loads((tmp_path / "trace.jsonl").read_text().splitlines()[0])
    assert [agent["id"] for agent in start["agents"]] == [agent["id"] for agent in header["agents"]]
    with pytest.raises(logicity.InputError, match="3 agents, the split has 8"):
        SPFEnv("easy").reset(options={"episode": start})
    with pytest.raises(logicity.InputError, match="the split `train` has 8 agents, not 9"):
        SPFEnv("easy", overrides={"task": {"curriculum": [{"until": 2, "agents": 9}]}})


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_masked_actions_violate_clauses(mode: AutoresetMode) -> None:
    count = 32
    envs = SPFVectorEnv(count, "expert", action_masks=True, autoreset_mode=mode)
    _, infos = envs.reset(seed=0)
    generator, refused = np.random.default_rng(0), 0
    restarts = np.zeros(count, np.bool_)
    for _ in range(300):
        masks = envs.action_masks()
        assert masks.shape == (count, 4) and masks.dtype == np.bool_ and (masks == infos["action_mask"]).all()
        assert masks[np.arange(count), infos["oracle_action"]].all()
        actions = generator.integers(4, size=count)
        allowed = masks[np.arange(count), actions]
        _, _, terminated, truncated, infos = envs.step(actions)
        ended = infos["final_info"] if "final_info" in infos else None
        for at in np.flatnonzero(~restarts):
            last = ended if ended is not None and ended["_violations"][at] else infos
            assert last["violations"][at].any() != allowed[at]
            if ended is not None and ended["_action_mask"][at]:
                assert ended["action_mask"][at].any()
        refused += int((~allowed & ~restarts).sum())
        restarts = (terminated | truncated) & (mode is AutoresetMode.NEXT_STEP)
    assert refused > 100


def test_one_environment_has_a_mask() -> None:
    env = SPFEnv("easy", action_masks=True)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.action_masks()
    for seed in range(20):
        _, info = env.reset(seed=seed)
        done = False
        while not done:
            mask = env.action_masks()
            assert mask.shape == (4,) and (mask == info["action_mask"]).all() and mask[info["oracle_action"]]
            action = int(env.action_space.sample(mask.astype(np.int8)))
            _, _, terminated, truncated, info = env.step(action)
            assert not info["violations"].any(), "masked actions are a shield"
            done = terminated or truncated
    for plain in (SPFEnv("easy"), SPFVectorEnv(1, "easy")):
        _, info = plain.reset(seed=1)
        assert "action_mask" not in info
        with pytest.raises(gymnasium.error.Error, match="action_masks=True"):
            plain.action_masks()


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_oracle_can_be_switched_off(mode: AutoresetMode) -> None:
    env, envs = SPFEnv("easy", oracle=False), SPFVectorEnv(4, "easy", oracle=False, autoreset_mode=mode)
    for each in (env, envs):
        assert "oracle_action" not in each.reset(seed=1)[1]
    assert "oracle_action" not in env.step(1)[4]
    for _ in range(30):
        _, _, terminated, truncated, infos = envs.step(np.zeros(4, np.int64))
        assert "oracle_action" not in infos and "oracle_action" not in infos.get("final_info", {})
        if mode is AutoresetMode.DISABLED and (terminated | truncated).any():
            envs.reset()


def test_the_nearest_entities_come_first() -> None:
    env = SPFEnv("hard", observation="state", overrides={"task": {"order": "nearest"}})
    for seed in range(5):
        observation, info = env.reset(seed=seed)
        for _ in range(20):
            rows = observation[1:][observation[1:, 0] == 1]
            distances = np.round(25**2 * (rows[:, 1:3] ** 2).sum(1))
            assert (np.diff(distances) >= 0).all()
            observation, _, terminated, truncated, info = env.step(info["oracle_action"])
            if terminated or truncated:
                break
