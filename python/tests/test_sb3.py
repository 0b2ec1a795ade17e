from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs
from gymnasium.utils.env_checker import data_equivalence

import logicity
from logicity.__main__ import main
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv

needs("stable_baselines3", "learn")
from stable_baselines3 import DQN  # noqa: E402
from stable_baselines3.common.buffers import DictReplayBuffer  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor  # noqa: E402

from logicity.envs.sb3 import SPFVecEnv, make_vec_env  # noqa: E402


@pytest.mark.parametrize("mode", list(logicity.MODES))
def test_stable_baselines_checker_passes(mode: str) -> None:
    check_env(gymnasium.make(f"logicity/SPF-{mode}-v0").unwrapped)


def test_results_equal_those_of_dummy_vec_env() -> None:
    count = 5
    ours = make_vec_env("hard", count, seed=3, monitor=False, atoms=True)
    theirs = DummyVecEnv([lambda: SPFEnv("hard", atoms=True)] * count)
    theirs.seed(3)
    assert (ours.reset() == theirs.reset()).all()
    generator, ends = np.random.default_rng(0), 0
    for _ in range(400):
        actions = generator.integers(4, size=count)
        one, other = ours.step(actions), theirs.step(actions)
        for a, b in zip(one[:3], other[:3], strict=True):
            assert isinstance(a, np.ndarray) and isinstance(b, np.ndarray)
            assert (a == b).all() and a.dtype == b.dtype
        for info, expected, done in zip(one[3], other[3], one[2], strict=True):
            if done:
                assert (info.pop("terminal_observation") == expected.pop("terminal_observation")).all()
                assert info.pop("is_success") == expected["success"]
                ends += 1
            else:
                # `DummyVecEnv` writes this key in every step.
                expected.pop("TimeLimit.truncated")
            assert data_equivalence(info, expected, exact=True)
    assert ends > 50


def test_episodes_can_be_chosen() -> None:
    envs = make_vec_env("easy", 2, monitor=False, split="test")
    envs.set_options([{"episode": 3}, {"episode": 4}])
    envs.reset()
    single = SPFEnv("easy", split="test")
    single.reset(options={"episode": 4})
    assert envs.get_attr("episode", 1) == [single.episode]
    assert len(envs.env_method("explain")) == 2


def test_dqn_trains() -> None:
    envs = logicity.envs.sb3.make_vec_env("easy", 4, seed=0)
    assert isinstance(envs, VecMonitor)
    model = DQN("MlpPolicy", envs, learning_starts=100, seed=0)
    model.learn(400)
    assert model.ep_info_buffer


@pytest.mark.parametrize("kind", ["relational", "graph"])
def test_a_model_trains_on_views(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    envs = make_vec_env("easy", 4, seed=0, observation=kind)
    model = DQN("MultiInputPolicy", envs, learning_starts=100, buffer_size=500, seed=0)
    model.learn(400)
    assert isinstance(model.replay_buffer, DictReplayBuffer)
    assert "easy" in repr(logicity.evaluate(model, "easy", "val", observation=kind))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="name the mode and the observation of its training"):
        logicity.evaluate(model, "easy", "val")
    model.save(tmp_path / "model.zip")
    command = ["evaluate", "--trust", "--policy", str(tmp_path / "model.zip"), "--split", "val", "--modes"]
    assert main([*command, "easy,hard"]) == 2 and "help: name `--modes easy`" in capsys.readouterr().err
    assert main([*command, "easy"]) == 0 and "easy" in capsys.readouterr().out
    with pytest.raises(ValueError, match="MultiInputPolicy"):
        DQN("MlpPolicy", envs)


def test_infos_have_the_last_views_of_episodes() -> None:
    ours = make_vec_env("hard", 3, seed=3, monitor=False, observation="relational")
    theirs = DummyVecEnv([lambda: SPFEnv("hard", observation="relational")] * 3)
    theirs.seed(3)
    first, expected_first = ours.reset(), theirs.reset()
    assert isinstance(first, dict) and isinstance(expected_first, dict)
    assert all((first[name] == expected_first[name]).all() for name in first)
    generator, ends = np.random.default_rng(0), 0
    for _ in range(200):
        actions = generator.integers(4, size=3)
        one, other = ours.step(actions), theirs.step(actions)
        assert isinstance(one[0], dict) and isinstance(other[0], dict) and one[0].keys() == other[0].keys()
        assert all((one[0][name] == other[0][name]).all() for name in one[0])
        for info, expected, done in zip(one[3], other[3], one[2], strict=True):
            if done:
                last, expected_last = info["terminal_observation"], expected["terminal_observation"]
                assert all((last[name] == expected_last[name]).all() for name in expected_last)
                ends += 1
    assert ends > 10


def test_maskable_ppo_trains() -> None:
    contrib = needs_masks()
    envs = make_vec_env("expert", 4, seed=0, action_masks=True)
    model = contrib.MaskablePPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=1, seed=0)
    model.learn(512)
    observations = envs.reset()
    masks = np.stack(envs.env_method("action_masks"))
    assert masks.shape == (4, 4) and envs.get_attr("action_masks")
    assert (masks[0] == envs.env_method("action_masks", indices=0)[0]).all()
    for _ in range(100):
        actions, _ = model.predict(observations, action_masks=masks)
        observations, _, _, infos = envs.step(actions)
        assert not any(info["violations"].any() for info in infos), "masked actions are a shield"
        masks = np.stack(envs.env_method("action_masks"))
        for info, mask in zip(infos, masks, strict=True):
            assert "terminal_observation" in info or (info["action_mask"] == mask).all()
    with pytest.raises(gymnasium.error.Error, match="action_masks=True"):
        make_vec_env("expert", 1).env_method("action_masks")


def needs_masks() -> Any:
    """Import sb3-contrib, which is not part of the extra."""
    return pytest.importorskip("sb3_contrib")


@pytest.mark.parametrize("monitor", [False, True])
def test_a_copy_continues_identically(monitor: bool) -> None:
    envs = make_vec_env("easy", 3, seed=1, monitor=monitor)
    envs.reset()
    generator = np.random.default_rng(0)
    for _ in range(20):
        envs.step(generator.integers(4, size=3))
    twins = [copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))]
    for _ in range(100):
        actions = generator.integers(4, size=3)
        expected = envs.step(actions)
        for twin in twins:
            for one, other in zip(expected[:3], twin.step(actions)[:3], strict=True):
                assert np.array_equal(one, other)


def test_other_autoreset_modes_raise() -> None:
    with pytest.raises(ValueError, match="SameStep"):
        SPFVecEnv(SPFVectorEnv(2, "easy"))
