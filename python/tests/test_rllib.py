"""RLlib, which pins a version of gymnasium: `make rllib` runs this file in a virtual environment of its own."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import gymnasium
import pytest
from conftest import needs

import logicity

needs("pettingzoo", "pettingzoo")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    ray: Any = needs("ray", "rllib")
    needs("tree", "rllib")
    ppo: Any = needs("ray.rllib.algorithms.ppo", "rllib")

#: The part before the colon is a module, which gymnasium imports in every process.
ID = "logicity:logicity/SPF-Easy-v0"


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """Start a local cluster, and ignore the warnings of other packages, which are errors otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
        yield
        ray.shutdown()


@pytest.fixture(autouse=True)
def foreign_warnings() -> Iterator[None]:
    """Ignore those warnings in each test, too: pytest resets the filters."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def config_of(env: Any, **arguments: Any) -> Any:
    config = ppo.PPOConfig().environment(env, env_config=arguments)
    return config.training(train_batch_size=256, minibatch_size=64, num_epochs=1).learners(num_learners=0)


def trained(config: Any) -> dict[str, Any]:
    """Train until episodes have ended, and return the results."""
    algorithm = config.build_algo()
    try:
        for _ in range(4):
            results: dict[str, Any] = algorithm.train()["env_runners"]
        assert results["num_episodes_lifetime"] > 0 and results["episode_len_mean"] > 0
        return results
    finally:
        algorithm.stop()


@pytest.mark.parametrize(
    "runners",
    [
        {"num_env_runners": 0},
        {"num_env_runners": 1},
        {"num_env_runners": 0, "num_envs_per_env_runner": 4},
        {
            "num_env_runners": 0,
            "num_envs_per_env_runner": 2,
            "gym_env_vectorize_mode": gymnasium.VectorizeMode.ASYNC,
        },
    ],
    ids=["local", "remote", "vector", "processes"],
)
def test_rllib_trains(runners: dict[str, Any]) -> None:
    trained(config_of(ID, split="train", overrides={"task": {"horizon": 60}}).env_runners(**runners))


def test_rllib_trains_every_car() -> None:
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune.registry import register_env

    def make(arguments: Any) -> Any:
        return ParallelPettingZooEnv(logicity.parallel_env("easy", **arguments))

    register_env("cars", make)
    config = config_of("cars", overrides={"task": {"horizon": 20, "egos": 3}}).env_runners(num_env_runners=0)
    config = config.training(train_batch_size=40, minibatch_size=40)
    trained(config.multi_agent(policies={"car"}, policy_mapping_fn=lambda agent, *_, **__: "car"))


def test_the_environments_work_with_this_version_of_gymnasium() -> None:
    env = gymnasium.make(ID)
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space and info["violations"].shape == (len(env.unwrapped.clauses),)  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="the horizon is 400, not 50"):
        gymnasium.make(ID, max_episode_steps=50)
