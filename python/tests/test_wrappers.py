"""Wrappers and collectors of gymnasium and Minari, and copies of everything that has a city."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs
from gymnasium import wrappers
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import logicity
from logicity.envs.parallel_vector import SPFParallelVectorEnv
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv

ID = "logicity/SPF-Easy-v0"


@pytest.fixture(autouse=True)
def foreign_warnings(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Ignore the warnings of other packages, which are errors otherwise, and open windows nowhere."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


Wrap = Callable[[Any], Any]


def needs_tensors() -> Any:
    needs("array_api_compat", "test-all")
    return needs("torch", "learn")


def tensors_of(kind: Any) -> Wrap:
    def wrap(env: Any) -> Any:
        needs_tensors()
        return kind.NumpyToTorch(env)

    return wrap


def whole(shape: tuple[int, ...]) -> Box:
    return Box(-np.inf, np.inf, shape, np.float64)


WRAPPERS: dict[str, Wrap] = {
    "Autoreset": wrappers.Autoreset,
    "ClipReward": lambda env: wrappers.ClipReward(env, -1, 1),
    "DelayObservation": lambda env: wrappers.DelayObservation(env, 2),
    "DiscretizeObservation": lambda env: wrappers.DiscretizeObservation(
        wrappers.TransformObservation(env, lambda seen: seen[:2], Box(0, 1, (2,), np.float32)), 2
    ),
    "DtypeObservation": lambda env: wrappers.DtypeObservation(env, np.float64),
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
    "MaxAndSkipObservation": lambda env: wrappers.MaxAndSkipObservation(env, 2),
    "NormalizeObservation": wrappers.NormalizeObservation,
    "NormalizeReward": wrappers.NormalizeReward,
    "NumpyToTorch": tensors_of(wrappers),
    "OrderEnforcing": wrappers.OrderEnforcing,
    "PassiveEnvChecker": wrappers.PassiveEnvChecker,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "RepeatAction": lambda env: wrappers.RepeatAction(env, 2),
    "RescaleObservation": lambda env: wrappers.RescaleObservation(env, np.float32(-1), np.float32(1)),
    "ReshapeObservation": lambda env: wrappers.ReshapeObservation(env, (17, 5)),
    "StickyAction": lambda env: wrappers.StickyAction(env, 0.3),
    "TimeAwareObservation": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 30)),
    "TimeLimit": lambda env: wrappers.TimeLimit(env, 30),
    "TransformAction": lambda env: wrappers.TransformAction(env, lambda action: 3 - action, env.action_space),
    "TransformObservation": lambda env: wrappers.TransformObservation(env, lambda seen: 2 * seen, whole((85,))),
    "TransformReward": lambda env: wrappers.TransformReward(env, lambda reward: -float(reward)),
    # These need pictures.
    "AddRenderObservation": wrappers.AddRenderObservation,
    "AddWhiteNoise": lambda env: wrappers.AddWhiteNoise(env, 0.1),
    "HumanRendering": wrappers.HumanRendering,
    "ObstructView": lambda env: wrappers.ObstructView(env, 0.1, 20),
    "RenderCollection": wrappers.RenderCollection,
}
#: Wrappers for other spaces of actions or observations, and those that other tests try.
ELSEWHERE = {
    "ClipAction": "continuous actions",
    "DiscretizeAction": "continuous actions",
    "RescaleAction": "continuous actions",
    "AtariPreprocessing": "games of Atari",
    "GrayscaleObservation": "observations that are pictures",
    "ResizeObservation": "observations that are pictures",
    "FilterObservation": "observations that are dictionaries",
    "ArrayConversion": "`NumpyToTorch` is one",
    "JaxToNumpy": "environments of JAX",
    "JaxToTorch": "environments of JAX",
    "RecordVideo": "`test_frameworks.py`",
    "vector": "a module",
}
PICTURES = ("AddRenderObservation", "AddWhiteNoise", "HumanRendering", "ObstructView", "RenderCollection")


def test_every_wrapper_of_gymnasium_is_tried() -> None:
    known = {*WRAPPERS, *ELSEWHERE}
    assert set(wrappers.__all__) <= known, "a new wrapper"
    assert {name for name in wrappers.vector.__all__ if not name.startswith("Vectorize")} <= {
        *VECTOR_WRAPPERS,
        *ELSEWHERE,
        "HumanRendering",
    }


@pytest.mark.parametrize("name", WRAPPERS)
def test_wrappers_of_gymnasium(name: str) -> None:
    if name not in wrappers.__all__:
        pytest.skip("a later version of gymnasium has it")
    if name == "HumanRendering":
        needs("pygame", "human")
    pictures, steps = (name in PICTURES), 200
    if pictures:
        steps = 4
    env = WRAPPERS[name](gymnasium.make(ID, action_masks=True, render_mode="rgb_array" if pictures else None))
    observation, info = env.reset(seed=0)
    env.action_space.seed(0)
    ends = 0
    for _ in range(steps):
        assert name == "NumpyToTorch" or observation in env.observation_space
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert len(info["violations"]) == len(env.unwrapped.clauses)
        if (terminated or truncated) and name != "Autoreset":
            ends += 1
            observation, info = env.reset()
    assert pictures or name == "Autoreset" or ends >= 2
    env.close()


VECTOR_WRAPPERS: dict[str, Wrap] = {
    "ClipReward": lambda envs: wrappers.vector.ClipReward(envs, -1, 1),
    "DictInfoToList": wrappers.vector.DictInfoToList,
    "DtypeObservation": lambda envs: wrappers.vector.DtypeObservation(envs, np.float64),
    "FlattenObservation": wrappers.vector.FlattenObservation,
    "NormalizeObservation": wrappers.vector.NormalizeObservation,
    "NormalizeReward": wrappers.vector.NormalizeReward,
    "NumpyToTorch": tensors_of(wrappers.vector),
    "RecordEpisodeStatistics": wrappers.vector.RecordEpisodeStatistics,
    "RescaleObservation": lambda envs: wrappers.vector.RescaleObservation(envs, -1, 1),
    "ReshapeObservation": lambda envs: wrappers.vector.ReshapeObservation(envs, (17, 5)),
    "TransformAction": lambda envs: wrappers.vector.TransformAction(
        envs, lambda actions: 3 - actions, envs.action_space, envs.single_action_space
    ),
    "TransformObservation": lambda envs: wrappers.vector.TransformObservation(
        envs, lambda seen: 2 * seen, whole((3, 85)), whole((85,))
    ),
    "TransformReward": lambda envs: wrappers.vector.TransformReward(envs, lambda rewards: 2 * rewards),
}


@pytest.mark.parametrize("name", VECTOR_WRAPPERS)
def test_wrappers_of_vector_environments(name: str) -> None:
    envs = VECTOR_WRAPPERS[name](gymnasium.make_vec(ID, num_envs=3, action_masks=True))
    envs.reset(seed=0)
    for _ in range(60):
        observations, _, _, _, infos = envs.step(envs.action_space.sample())
        assert len(observations) == 3
        if name != "DictInfoToList":
            assert infos["violations"].shape == (3, len(envs.unwrapped.clauses))
    envs.close()


def test_tensors_have_the_values_of_arrays() -> None:
    torch = needs_tensors()
    plain, envs = (gymnasium.make_vec(ID, num_envs=3, action_masks=True) for _ in range(2))
    tensors = wrappers.vector.NumpyToTorch(envs)
    plain.reset(seed=0)
    tensors.reset(seed=0)
    violated = 0
    for _ in range(60):
        actions = plain.action_space.sample()
        infos, found = plain.step(actions)[4], tensors.step(torch.from_numpy(actions))[4]
        types = {"violations": torch.bool, "seed": torch.int64, "action_mask": torch.int8}
        assert {key: found[key].dtype for key in types} == types
        assert all((found[key].numpy() == infos[key]).all() for key in types)
        violated += int(found["violations"].sum())
    assert violated > 2


@pytest.mark.parametrize("observation", ["groundings", "relational"])
@pytest.mark.parametrize("shared", [True, False])
def test_vector_environments_in_processes(shared: bool, observation: Any) -> None:
    def make() -> Any:
        return gymnasium.make(ID, observation=observation, action_masks=True)

    kinds: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    batch = SPFVectorEnv(2, "easy", observation=observation, action_masks=True, **kinds)
    several: list[Any] = [
        AsyncVectorEnv([make] * 2, shared_memory=shared, **kinds),
        SyncVectorEnv([make] * 2, **kinds),
        batch,
    ]
    results: list[Any] = [envs.reset(seed=4) for envs in several]
    for _ in range(60):
        assert data_equivalence(results[0], results[1], exact=True)
        assert data_equivalence(results[1], results[2], exact=True)
        actions = batch.action_space.sample()
        results = [envs.step(actions) for envs in several]
    assert several[0].call("clauses") == (batch.clauses, batch.clauses)
    for envs in several:
        envs.close()


def test_masks_select_actions() -> None:
    env = gymnasium.make("logicity/SPF-Expert-v0", action_masks=True)
    envs = gymnasium.make_vec("logicity/SPF-Expert-v0", num_envs=4, action_masks=True)
    cars: Any = logicity.parallel_env("easy", action_masks=True)
    _, info = env.reset(seed=0)
    _, infos = envs.reset(seed=0)
    _, by_car = cars.reset(seed=0)
    for _ in range(40):
        assert info["action_mask"].dtype == infos["action_mask"].dtype == np.int8
        action = env.action_space.sample(info["action_mask"])
        *_, terminated, truncated, info = env.step(action)
        assert not info["violations"].any()
        if terminated or truncated:
            _, info = env.reset()
        *_, infos = envs.step(envs.action_space.sample(tuple(infos["action_mask"])))
        assert not infos["violations"].any()
        actions = {car: cars.action_space(car).sample(by_car[car]["action_mask"]) for car in cars.agents}
        *_, by_car = cars.step(actions)
        if not cars.agents:
            _, by_car = cars.reset()


def test_a_limit_that_is_not_the_horizon_raises() -> None:
    message = 'the horizon is 400, not 50: set it with `overrides={"task": {"horizon": 50}}`'
    spec = copy.deepcopy(gymnasium.make(ID).spec)
    assert spec is not None and spec.max_episode_steps == 400
    spec.max_episode_steps = 50
    for make in (
        lambda: gymnasium.make(ID, max_episode_steps=50),
        lambda: gymnasium.make(spec),
        lambda: gymnasium.make_vec(ID, num_envs=2, max_episode_steps=50),
        lambda: gymnasium.make_vec(ID, num_envs=2, max_episode_steps=50, vectorization_mode="sync"),
    ):
        with pytest.raises(ValueError, match="max_episode_steps: ") as caught:
            make()
        assert message in str(caught.value)
    with pytest.raises(ValueError, match="the horizon is 400, not 1000"):
        gymnasium.make(ID, max_episode_steps=1000)
    short = gymnasium.make(ID, overrides={"task": {"horizon": 50}})
    assert short.spec is not None and short.spec.max_episode_steps == 50
    for limit in (None, -1, 400):
        gymnasium.make(ID, max_episode_steps=limit)
    # A wrapper that the caller adds is the caller's choice.
    wrappers.TimeLimit(gymnasium.make(ID), 50)


def test_a_window_shows_every_state() -> None:
    needs("pygame", "human")
    import pygame

    assert "human" in SPFEnv.metadata["render_modes"]
    check_env(gymnasium.make(ID).unwrapped)
    picture = SPFEnv("easy", render_mode="rgb_array")
    picture.reset(seed=0)
    size = picture.render().shape[1::-1]

    def shown() -> bytes:
        screen = pygame.display.get_surface()
        assert screen is not None and screen.get_size() == size
        return bytes(pygame.surfarray.array3d(screen).tobytes())

    env = gymnasium.make(ID, render_mode="human")
    assert "HumanRendering" not in str(env)
    env.reset(seed=0)
    assert shown() == picture.render().swapaxes(0, 1).tobytes()
    picture.step(1)
    env.step(1)
    assert shown() == picture.render().swapaxes(0, 1).tobytes() and env.render() is None
    pickle.loads(pickle.dumps(env)).step(1)
    env.close()
    assert pygame.display.get_surface() is None
    env.close()
    envs: Any = gymnasium.make_vec(ID, num_envs=3, render_mode="human")
    envs.reset(seed=0)
    before = shown()
    envs.step(np.full(3, 1))
    assert shown() != before and envs.render() == (None,) * 3
    envs.close()
    cars = logicity.parallel_env("easy", render_mode="human")
    cars.reset(seed=0)
    before = shown()
    cars.step(dict.fromkeys(cars.agents, 1))
    assert shown() != before and cars.render() is None
    # Another environment closes the window. The next picture opens it again.
    other = SPFEnv("easy", render_mode="human")
    other.reset(seed=0)
    other.close()
    assert pygame.display.get_surface() is None
    cars.step(dict.fromkeys(cars.agents, 1))
    other_view = shown()
    cars.render()
    assert shown() == other_view
    cars.close()
    assert pygame.display.get_surface() is None


def test_a_window_needs_pygame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'logicity\[human\]'"):
        SPFEnv("easy", render_mode="human")


def test_minari_collects_all_infos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = needs("minari", "offline")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gymnasium.make(ID, action_masks=True), record_infos=True)
    for seed in range(3):
        env.reset(seed=seed)
        ended = False
        while not ended:
            *_, terminated, truncated, _ = env.step(2)
            ended = terminated or truncated
    dataset = env.create_dataset("test/easy-v0", algorithm_name="fast")
    inner: Any = env.unwrapped
    violated = 0
    for episode in dataset:
        length = len(episode.actions) + 1
        assert episode.infos["violations"].shape == (length, len(inner.clauses))
        assert episode.infos["violations"].dtype == np.bool_ and episode.infos["action_mask"].shape == (length, 4)
        violated += int(episode.infos["violations"].sum())
    assert violated > 0


def vector_state(envs: Any) -> Any:
    return [envs.episode(0), envs._core.taken(0)]


def advance_vector(envs: Any) -> None:
    envs.step(np.ones(envs.num_envs, np.int64))


def stable_baselines(monitor: bool) -> Any:
    needs("stable_baselines3", "learn")
    from logicity.envs.sb3 import make_vec_env

    envs = make_vec_env("easy", 2, seed=0, monitor=monitor)
    envs.reset()
    return envs


def torchrl() -> Any:
    needs("torchrl.envs", "torchrl")
    from logicity.envs.torchrl import SPFTorchRLEnv

    envs = SPFTorchRLEnv(2, "easy")
    envs.set_seed(0)
    envs.reset()
    return envs


def viewed(single: bool) -> Any:
    from logicity.envs.wrappers import GraphObservation, VectorGraphObservation

    env: Any = GraphObservation(SPFEnv("easy")) if single else VectorGraphObservation(SPFVectorEnv(2, "easy"))
    env.reset(seed=0)
    return env


def reset(env: Any) -> Any:
    env.reset(seed=0)
    return env


def parallel_cars() -> Any:
    needs("pettingzoo", "pettingzoo")
    return reset(logicity.parallel_env("easy"))


#: How to make an object that has a city or rules in Rust, how to change it, and what a change changes.
WITH_RUST: dict[str, tuple[Callable[[], Any], Callable[[Any], Any], Callable[[Any], Any]]] = {
    "SPFEnv": (lambda: reset(SPFEnv("easy")), lambda env: env.step(1), lambda env: env._core.taken(0)),
    "SPFVectorEnv": (lambda: reset(SPFVectorEnv(2, "easy")), advance_vector, vector_state),
    "SPFParallelEnv": (
        parallel_cars,
        lambda cars: cars.step(dict.fromkeys(cars.agents, 1)),
        lambda cars: cars._core.taken(0),
    ),
    "SPFParallelVectorEnv": (
        lambda: reset(SPFParallelVectorEnv(2, "easy")),
        lambda envs: envs.step(np.ones((2, 6), np.int64)),
        vector_state,
    ),
    "GraphObservation": (
        lambda: viewed(True),
        lambda env: env.step(1),
        lambda env: env.unwrapped._core.taken(0),
    ),
    "VectorGraphObservation": (lambda: viewed(False), advance_vector, lambda env: vector_state(env.unwrapped)),
    "SPFVecEnv": (lambda: stable_baselines(False), advance_vector, lambda envs: vector_state(envs.envs)),
    "VecMonitor": (lambda: stable_baselines(True), advance_vector, lambda envs: vector_state(envs.venv.envs)),
    "SPFTorchRLEnv": (
        torchrl,
        lambda env: env.step(env.fake_tensordict().select("action").zero_()),
        lambda env: vector_state(env.envs),
    ),
    "Simulation": (lambda: logicity.Simulation("easy"), lambda city: city.run(3), lambda city: city.now),
    "Benchmark": (
        lambda: logicity.Benchmark("easy", "val"),
        lambda benchmark: benchmark._random.add(),
        lambda benchmark: benchmark._baseline_episodes,
    ),
}


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
@pytest.mark.parametrize("name", WITH_RUST)
def test_a_copy_shares_no_city(name: str, again: Callable[[Any], Any]) -> None:
    make, change, state = WITH_RUST[name]
    one = make()
    change(one)
    before = copy.deepcopy(state(one))
    twin = again(one)
    assert state(twin) == before
    change(twin)
    assert state(one) == before, "the copy has its own city"
    change(one)
    assert state(one) == state(twin), "both continue in the same way"
