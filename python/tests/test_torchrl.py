"""The batched environments for TorchRL."""

from __future__ import annotations

import copy
import os
import pickle
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs
from gymnasium.error import ResetNeeded

from logicity.envs import SPFEnv

with warnings.catch_warnings():
    # Those of the packages' own imports, which are errors otherwise.
    warnings.simplefilter("ignore")
    torch = needs("torch", "torchrl")
    envs = needs("torchrl.envs", "torchrl")
    from logicity.envs.torchrl import SPFTorchRLEnv


@pytest.fixture(autouse=True)
def foreign_warnings() -> Iterator[None]:
    """Ignore the warnings of other packages, which are errors otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


KINDS: list[dict[str, Any]] = [
    {},
    {"observation": "state", "split": "test"},
    {"observation": "relational", "overrides": {"task": {"route_length": True}}},
    {"observation": "graph"},
    {"oracle": False, "action_masks": True, "num_threads": 2, "device": None},
]


@pytest.mark.parametrize("options", KINDS)
def test_the_checker_passes(options: dict[str, Any]) -> None:
    env = SPFTorchRLEnv(3, "medium", **options)
    envs.check_env_specs(env)
    steps = env.rollout(50, break_when_any_done=False)
    assert steps.shape == (3, 50)
    assert ("oracle_action" in steps.keys()) == options.get("oracle", True)
    assert ("action_mask" in steps.keys()) == options.get("action_masks", False)


def entries(observation: Any, info: dict[str, Any]) -> dict[str, Any]:
    """Return what a tensordict has of one environment."""
    parts = observation if isinstance(observation, dict) else {"observation": observation}
    names = ("success", "progress", "violations", "oracle_action", "action_mask")
    return {**parts, **{name: np.reshape(info[name], -1) for name in names if name in info}}


def equal(found: Any, expected: dict[str, Any]) -> bool:
    return all(np.array_equal(found[name].numpy(), np.float32(value)) for name, value in expected.items())


@pytest.mark.parametrize("options", [{}, {"observation": "relational", "action_masks": True}])
def test_rollouts_equal_single_environments(options: dict[str, Any]) -> None:
    count, length, ends = 4, 200, 0
    env = SPFTorchRLEnv(count, "hard", **options)
    env.set_seed(11)
    steps = env.rollout(length, break_when_any_done=False)
    for at in range(count):
        single = SPFEnv("hard", **options)
        begun = entries(*single.reset(seed=11 + at))
        for step in steps[at]:
            assert equal(step, begun)
            observation, reward, terminated, truncated, info = single.step(int(step["action"]))
            after, following = step["next"], entries(observation, info)
            assert equal(after, {**following, "reward": [reward]})
            assert [bool(after[name]) for name in ("terminated", "truncated")] == [terminated, truncated]
            assert bool(after["done"]) == (terminated or truncated)
            begun = following
            if terminated or truncated:
                begun, ends = entries(*single.reset()), ends + 1
    assert ends > 10


def test_partial_resets_leave_the_other_environments() -> None:
    env = SPFTorchRLEnv(3, "easy")
    env.set_seed(5)
    state = env.reset()
    for _ in range(4):
        state = env.step_mdp(env.step(state.set("action", torch.full((3,), 3))))
    before = state.clone()
    mask = torch.tensor([False, True, False])[:, None]
    # A seed applies at the next reset of each environment.
    env.set_seed(90)
    after = env.reset(state.set("_reset", mask))
    single = SPFEnv("easy")
    assert equal(after[1], entries(*single.reset(seed=91)))
    names = env.observation_spec.keys()
    assert (after.select(*names)[::2] == before.select(*names)[::2]).all()
    # The other environments continue, and the next reset gives them their seeds, but not this one.
    after = env.reset()
    for at, seed in ((0, 90), (2, 92)):
        assert equal(after[at], entries(*SPFEnv("easy").reset(seed=seed)))
    assert equal(after[1], entries(*single.reset()))


def test_a_rollout_ends_when_all_episodes_have_ended() -> None:
    env = SPFTorchRLEnv(5, "hard")
    env.set_seed(2)
    steps = env.rollout(1000, break_when_any_done=False, break_when_all_done=True)
    assert steps["next", "done"][:, -1].all()
    lengths = (~steps["next", "done"][..., 0]).sum(1) + 1
    assert len(set(lengths.tolist())) > 2
    singles = [SPFEnv("hard") for _ in range(5)]
    for at, single in enumerate(singles):
        assert equal(steps[at, 0], entries(*single.reset(seed=2 + at)))
        for step in steps[at, : lengths[at]]:
            *_, terminated, truncated, _ = single.step(int(step["action"]))
            assert bool(step["next", "done"]) == (terminated or truncated)
        # The last step fills the rest of the rollout.
        assert (
            steps[at, lengths[at] :]["next", "observation"] == steps[at, lengths[at] - 1]["next", "observation"]
        ).all()
    # The skipped steps have not used up episodes.
    after = env.reset()
    for at, single in enumerate(singles):
        assert equal(after[at], entries(*single.reset()))


def test_recorded_episodes_can_be_chosen() -> None:
    env = SPFTorchRLEnv(3, "easy", split="test")
    state = env.reset(options={"episodes": [4, 7, 1]})
    for at, episode in enumerate((4, 7, 1)):
        assert equal(state[at], entries(*SPFEnv("easy", split="test").reset(options={"episode": episode})))


def test_invalid_use_raises() -> None:
    env = SPFTorchRLEnv(2, "easy")
    steps = env.rollout(1000, break_when_any_done=True)
    with pytest.raises(ResetNeeded):
        env.step(steps[:, -1].select("action"))
    with pytest.raises(TypeError, match="unexpected keyword argument 'option'; known: options"):
        env.reset(option={})
    with pytest.raises(ValueError, match="unknown option `map`"):
        env.reset(options={"map": "small"})
    state = env.reset()
    skip = torch.tensor([True, False])[:, None]
    with pytest.raises(ValueError, match="only environments whose episode has ended"):
        env.step(state.set("action", torch.zeros(2, dtype=torch.int64)).set("_step", skip))
    with pytest.raises(TypeError, match="'autoreset_mode': TorchRL resets episodes"):
        SPFTorchRLEnv(2, "easy", autoreset_mode="SameStep")
    with pytest.raises(TypeError, match="did you mean `split`"):
        SPFTorchRLEnv(2, "easy", splits="val")


def test_changes_of_tensors_do_not_affect_the_environments() -> None:
    env, twin = SPFTorchRLEnv(3, "easy"), SPFTorchRLEnv(3, "easy")
    for each in (env, twin):
        each.set_seed(1)
    state, other = env.reset(), twin.reset()
    for _ in range(100):
        action = torch.randint(4, (3,))
        state, other = env.step(state.set("action", action)), twin.step(other.set("action", action))
        assert (state["next"] == other["next"]).all()
        following = env.step_mdp(state)
        done = following["done"].clone()
        for name in ("observation", "done", "terminated", "truncated", "success"):
            state["next", name].fill_(1)
        other = twin.step_mdp(other)
        if done.any():
            other = twin.reset(other.set("_reset", done))
            state = env.reset(other.clone().set("_reset", done))
        else:
            state = other.clone()


@pytest.mark.parametrize("again", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_continues_identically(again: Any) -> None:
    env = SPFTorchRLEnv(3, "hard")
    env.set_seed(3)
    state = env.rollout(30, break_when_any_done=False)[:, -1].clone()
    twin = again(env)
    for each in (env, twin):
        torch.manual_seed(0)
        last = each.step_mdp(state.clone())
        last = each.maybe_reset(last)
        each.steps = each.rollout(60, auto_reset=False, tensordict=last, break_when_any_done=False)
    assert (env.steps == twin.steps).all()


def test_several_batches_run_in_series() -> None:
    both = envs.SerialEnv(2, lambda: SPFTorchRLEnv(3, "easy", split="val"))
    assert both.rollout(30, break_when_any_done=False)["observation"].shape == (2, 3, 30, 85)


def test_the_example_learns(tmp_path: Path) -> None:
    path = Path(__file__).parents[1] / "examples" / "torchrl_ppo.py"
    done = subprocess.run(
        [sys.executable, str(path), "400000"],
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    before, after = map(float, re.findall(r"^\w+ training: .* TSR ([\d.]+)", done.stdout, re.MULTILINE))
    # No constant action reaches more than 0.3.
    assert before <= 0.4 and after >= 0.6, done.stdout
