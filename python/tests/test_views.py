from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import logicity
from logicity import _logicity
from logicity.describe import atoms_of
from logicity.envs import SPFEnv, SPFVectorEnv
from logicity.evaluation import load_task
from logicity.views import (
    GraphObservation,
    Layout,
    RelationalObservation,
    VectorGraphObservation,
    VectorRelationalObservation,
    View,
    Views,
)

MODES = list(logicity.ENVIRONMENTS)
WRAPPERS = [
    pytest.param(RelationalObservation, VectorRelationalObservation, id="relational"),
    pytest.param(GraphObservation, VectorGraphObservation, id="graph"),
]


def slow_view(mode: str, observation: NDArray[np.float32]) -> View:
    """Return both views of an observation, atom by atom."""
    names = logicity.observation_names(mode)
    parsed = [(name.partition("(")[0], tuple(map(int, name.partition("(")[2][:-1].split(",")))) for name in names]
    unary = list(dict.fromkeys(name for name, entities in parsed if len(entities) == 1))
    binary = list(dict.fromkeys(name for name, entities in parsed if len(entities) == 2))
    view: View = {
        "unary": np.zeros((5, len(unary)), np.float32),
        "binary": np.zeros((5, 5, len(binary)), np.float32),
        "mask": np.array([1, 0, 0, 0, 0], np.int8),
        "nodes": np.zeros((5, len(unary)), np.float32),
        "edges": np.zeros((25, len(binary)), np.float32),
        "edge_links": np.array([(i, j) for i in range(5) for j in range(5)]),
        "node_mask": np.array([1, 0, 0, 0, 0], np.int8),
        "edge_mask": np.zeros(25, np.int8),
    }
    for (name, entities), value in zip(parsed, observation, strict=True):
        for entity in entities:
            if value > 0:
                view["mask"][entity] = view["node_mask"][entity] = 1
        if len(entities) == 1:
            view["unary"][entities[0], unary.index(name)] = value
            view["nodes"][entities[0], unary.index(name)] = value
        else:
            i, j = entities
            view["binary"][i, j, binary.index(name)] = value
            view["edges"][5 * i + j, binary.index(name)] = value
    for edge, (i, j) in enumerate(view["edge_links"]):
        view["edge_mask"][edge] = view["mask"][i] and view["mask"][j]
    return view


def same(one: View, other: View) -> bool:
    return one.keys() == other.keys() and all(
        one[name].dtype == other[name].dtype and np.array_equal(one[name], other[name]) for name in one
    )


@pytest.mark.parametrize("mode", MODES)
def test_views_equal_a_loop_over_the_atoms(mode: str) -> None:
    layout = Layout.of_description(_logicity.describe(load_task(mode)))
    random = np.random.default_rng(1)
    observations = (random.random((40, layout.width)) < random.random((40, 1)) ** 4).astype(np.float32)
    observations[3] = 0.0
    for kind in ("relational", "graph"):
        views = Views(layout, kind)
        batch = views(observations)
        for at, observation in enumerate(observations):
            slow = slow_view(mode, observation)
            view = {name: slow[name] for name in batch}
            assert same({name: values[at] for name, values in batch.items()}, view)
            assert same(views(observation), view)
            assert views.space().contains(view)


def test_every_present_entity_is_masked_as_present() -> None:
    for mode in ("easy", "expert"):
        trajectories = logicity.demonstrations(mode, n=3)
        layout = Layout.of_atoms(trajectories.atoms)
        for trajectory in trajectories:
            view = Views(layout, "relational")(trajectory.observations)
            kinds = [layout.unary.index("IsCar"), layout.unary.index("IsPedestrian")]
            assert np.array_equal(view["unary"][:, :, kinds].sum(-1), view["mask"])
            # Entities fill the first places.
            assert (np.diff(view["mask"], axis=1) <= 0).all()


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
@pytest.mark.parametrize("single", [RelationalObservation, GraphObservation])
def test_wrapped_environments_pass_the_checker(single: type[Any]) -> None:
    check_env(single(SPFEnv("medium")), skip_render_check=True)


@pytest.mark.parametrize("autoreset", ["NEXT_STEP", "SAME_STEP"])
@pytest.mark.parametrize(("single", "vector"), WRAPPERS)
def test_vectorized_views_equal_those_of_single_environments(
    single: type[Any], vector: type[Any], autoreset: str
) -> None:
    count, random, ends = 4, np.random.default_rng(2), 0
    envs = vector(SPFVectorEnv(count, "hard", autoreset_mode=autoreset, copy=False))
    singles = [single(SPFEnv("hard")) for _ in range(count)]
    observations, _ = envs.reset(seed=5)
    expected = [env.reset(seed=5 + at)[0] for at, env in enumerate(singles)]
    over = [False] * count
    for _ in range(150):
        assert observations in envs.observation_space
        for at in range(count):
            assert same({name: values[at] for name, values in observations.items()}, expected[at])
            assert expected[at] in envs.single_observation_space
        actions = random.integers(4, size=count)
        observations, _, terminated, truncated, infos = envs.step(actions)
        for at, env in enumerate(singles):
            if over[at]:
                expected[at], over[at] = env.reset()[0], False
                continue
            expected[at], _, done, cut, _ = env.step(actions[at])
            over[at] = done or cut
            assert over[at] == terminated[at] | truncated[at]
            if over[at] and autoreset == "SAME_STEP":
                ends += 1
                assert same(infos["final_obs"][at], expected[at])
                expected[at], over[at] = env.reset()[0], False
    assert ends > 10 or autoreset == "NEXT_STEP"


def test_the_route_length_is_a_view_of_its_own() -> None:
    overrides = {"task": {"route_length": True}}
    env = RelationalObservation(SPFEnv("easy", overrides=overrides))
    plain, _ = SPFEnv("easy", overrides=overrides).reset(seed=1)
    view, _ = env.reset(seed=1)
    assert view in env.observation_space
    assert view["route_length"] == plain[-1:] and 0 < plain[-1] <= 1


def test_views_do_not_change_later() -> None:
    envs = VectorGraphObservation(SPFVectorEnv(3, "easy", copy=False))
    before, _ = envs.reset(seed=0)
    kept = {name: values.copy() for name, values in before.items()}
    for _ in range(30):
        envs.step(np.ones(3, np.int64))
    assert same(before, kept)


def test_unsuitable_environments_are_rejected() -> None:
    with pytest.raises(ValueError, match="groundings"):
        RelationalObservation(SPFEnv("easy", observation="state"))
    with pytest.raises(TypeError, match="SPFVectorEnv"):
        VectorGraphObservation(gymnasium.make_vec("CartPole-v1", num_envs=2))
    with pytest.raises(TypeError, match="SPFEnv"):
        GraphObservation(gymnasium.make("CartPole-v1"))


@pytest.mark.parametrize("mode", MODES)
def test_a_layout_knows_its_atoms(mode: str) -> None:
    atoms = tuple(atoms_of(_logicity.describe(load_task(mode))))
    assert Layout.of_atoms(atoms).atoms() == atoms


def test_layouts_need_all_ground_atoms_once() -> None:
    atoms = [("P", (0,)), ("P", (1,))]
    assert Layout.of_atoms(atoms).unary == ("P",)
    for wrong in (atoms[1:], [*atoms, atoms[0]]):
        with pytest.raises(ValueError, match="all ground atoms"):
            Layout.of_atoms(wrong)
    with pytest.raises(ValueError, match="`Q` has 3 arguments"):
        Layout.of_atoms([*atoms, ("Q", (0, 0, 1))])
