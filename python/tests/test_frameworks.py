"""The environments in other frameworks for reinforcement learning, which `make python-all` installs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs

import logicity
from logicity.envs import SPFEnv

ID = "logicity/SPF-Easy-v0"
SHORT = {"task": {"horizon": 20}}


@pytest.fixture
def foreign_warnings() -> Iterator[None]:
    """Ignore the warnings of other packages, which are errors otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@pytest.mark.usefixtures("foreign_warnings")
class TestTorchRL:
    @pytest.fixture(autouse=True)
    def torchrl(self) -> Any:
        return needs("torchrl.envs", "torchrl")

    @pytest.mark.parametrize("options", [{}, {"observation": "state", "split": "test"}])
    def test_an_environment_by_its_id(self, torchrl: Any, options: dict[str, Any]) -> None:
        env = torchrl.GymEnv(ID, **options)
        torchrl.check_env_specs(env)
        steps = env.rollout(50, break_when_any_done=False)
        expected: Any = SPFEnv("easy", **options).observation_space.shape
        assert steps["observation"].shape == (50, *expected)

    def test_frame_skip_repeats_actions(self, torchrl: Any) -> None:
        env = torchrl.GymEnv(ID, frame_skip=4)
        env.set_seed(0)
        assert env.rollout(10).shape[0] <= 10

    def test_rewards_equal_those_of_the_environment(self, torchrl: Any) -> None:
        env = torchrl.GymEnv(ID, categorical_action_encoding=True)
        steps = env.rollout(400, policy=lambda observation: env.action_spec.zero() + 3)
        rewards = steps["next", "reward"].flatten()
        assert len(rewards) == 400 and steps["next", "truncated"][-1] and not steps["next", "terminated"].any()
        # Waiting costs the same in every step; the last step also costs the overtime value.
        assert (rewards[:-1] == rewards[0]).all() and rewards[-1] < rewards[0] - 2

    def test_vector_environments(self, torchrl: Any) -> None:
        env = torchrl.GymWrapper(gymnasium.make_vec(ID, num_envs=4, autoreset_mode="Disabled"))
        env.set_seed(0)
        steps = env.rollout(100, break_when_any_done=False)
        assert steps["observation"].shape == (4, 100, 85) and steps["next", "done"].sum() > 5
        # The observation after each step is the last one of the episode, not the first one of the next episode.
        done = steps["next", "done"][:, :-1, 0]
        following = steps["observation"][:, 1:] == steps["next", "observation"][:, :-1]
        assert following.all(-1)[~done].all() and not following.all(-1)[done].all()

    def test_several_processes(self, torchrl: Any) -> None:
        # The part before the colon is a module, which gymnasium imports in every process.
        env = torchrl.GymEnv(f"logicity:{ID}", num_workers=2)
        try:
            assert env.rollout(20, break_when_any_done=False)["observation"].shape == (2, 20, 85)
        finally:
            env.close()


@pytest.mark.usefixtures("foreign_warnings")
class TestSuperSuit:
    @pytest.fixture(autouse=True)
    def supersuit(self) -> Any:
        return needs("supersuit", "test-all")

    @pytest.mark.parametrize("processes", [0, 2])
    def test_vector_environments(self, supersuit: Any, processes: int) -> None:
        cars = supersuit.black_death_v3(logicity.parallel_env("easy", overrides=SHORT))
        single = supersuit.pettingzoo_env_to_vec_env_v1(cars)
        envs = supersuit.concat_vec_envs_v1(single, 2, num_cpus=processes, base_class="gymnasium")
        try:
            observations, _ = envs.reset(seed=0)
            count = 2 * len(cars.possible_agents)
            assert observations.shape == (count, 85)
            generator, ends = np.random.default_rng(0), 0
            for _ in range(50):
                observations, rewards, terminated, truncated, _ = envs.step(generator.integers(4, size=count))
                assert observations.shape == (count, 85) and rewards.shape == (count,)
                ends += int(np.sum(np.logical_or(terminated, truncated)))
            # With `black_death`, the cars of a city end together, at the horizon.
            assert ends == 2 * count
        finally:
            envs.close()

    def test_stable_baselines(self, supersuit: Any) -> None:
        needs("stable_baselines3", "learn")
        cars = supersuit.black_death_v3(logicity.parallel_env("easy", observation="state", overrides=SHORT))
        single = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.flatten_v0(cars))
        envs = supersuit.concat_vec_envs_v1(single, 2, base_class="stable_baselines3")
        from stable_baselines3 import PPO

        model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=1)
        assert model.learn(512).num_timesteps >= 512


def test_gymnasium_records_videos(tmp_path: Any) -> None:
    needs("moviepy", "video")
    from gymnasium.wrappers import RecordVideo

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env: Any = RecordVideo(gymnasium.make(ID, render_mode="rgb_array"), str(tmp_path), disable_logger=True)
        env.reset(seed=0)
        for _ in range(3):
            env.step(3)
        env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 10_000
