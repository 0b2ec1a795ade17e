from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from numpy.typing import NDArray

import logicity
from logicity import _logicity
from logicity.envs.layout import Layout, atoms_of
from logicity.envs.single import SPFEnv
from logicity.envs.vector import SPFVectorEnv
from logicity.envs.views import View, Views, views_of
from logicity.envs.wrappers import (
    GraphObservation,
    RelationalObservation,
    VectorGraphObservation,
    VectorRelationalObservation,
)
from logicity.tasks import load_task
from logicity.types import ViewKind

MODES = list(logicity.ENVIRONMENTS)
KINDS: list[ViewKind] = ["relational", "graph"]
HARD = "logicity/SPF-Hard-v0"
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


@pytest.mark.parametrize("wrapped", [False, True], ids=["made", "wrapped"])
@pytest.mark.parametrize("autoreset", ["NEXT_STEP", "SAME_STEP"])
@pytest.mark.parametrize(("single", "vector"), WRAPPERS)
def test_vectorized_views_equal_those_of_single_environments(
    single: type[Any], vector: type[Any], autoreset: str, wrapped: bool
) -> None:
    count, random, ends = 4, np.random.default_rng(2), 0
    envs: Any
    if wrapped:
        envs = vector(SPFVectorEnv(count, "hard", autoreset_mode=autoreset, copy=False))
    else:
        envs = gymnasium.make_vec(HARD, num_envs=count, observation=single._kind, autoreset_mode=autoreset)
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


@pytest.mark.parametrize("overrides", [None, {"task": {"route_length": True}}])
@pytest.mark.parametrize("single", [RelationalObservation, GraphObservation])
def test_made_views_equal_those_of_the_wrapper(single: type[Any], overrides: dict[str, Any] | None) -> None:
    env = gymnasium.make(HARD, observation=single._kind, overrides=overrides)
    wrapped = single(gymnasium.make(HARD, overrides=overrides))
    assert env.observation_space == wrapped.observation_space
    random, over = np.random.default_rng(3), True
    for _ in range(200):
        if over:
            view, expected = env.reset(seed=7)[0], wrapped.reset(seed=7)[0]
            assert same(view, expected)
        action = random.integers(4)
        view, reward, terminated, truncated, info = env.step(action)
        expected, *rest = wrapped.step(action)
        assert same(view, expected)
        assert data_equivalence([reward, terminated, truncated, info], rest, exact=True)
        assert view in env.observation_space
        over = terminated or truncated


@pytest.mark.parametrize("kind", KINDS)
def test_made_environments_pass_the_checker_and_remake_from_their_specs(kind: ViewKind) -> None:
    env = gymnasium.make(HARD, observation=kind)
    check_env(env.unwrapped, skip_render_check=True)
    assert env.spec is not None
    for spec in (env.spec, EnvSpec.from_json(env.spec.to_json())):
        again = gymnasium.make(spec)
        assert again.observation_space == env.observation_space
        assert same(again.reset(seed=3)[0], env.reset(seed=3)[0])
    envs = gymnasium.make_vec(HARD, num_envs=2, observation=kind)
    assert envs.spec is not None and envs.spec.kwargs["observation"] == kind
    again_envs = gymnasium.make_vec(envs.spec)
    assert again_envs.observation_space == envs.observation_space and again_envs.spec == envs.spec


@pytest.mark.parametrize("kind", KINDS)
def test_made_environments_can_be_pickled_and_copied(kind: ViewKind) -> None:
    actions = np.random.default_rng(4).integers(4, size=(60, 3))
    env, envs = SPFEnv("hard", observation=kind), SPFVectorEnv(3, "hard", observation=kind, autoreset_mode="SameStep")
    env.reset(seed=1)
    envs.reset(seed=1)
    env.step(1)
    for row in actions[:20]:
        envs.step(row)
    ways: list[Any] = [lambda each: pickle.loads(pickle.dumps(each)), copy.deepcopy]
    for again in ways:
        twin, twins = again(env), again(envs)
        assert same(twin.step(3)[0], copy.deepcopy(env).step(3)[0])
        one = copy.deepcopy(envs)
        for row in actions[20:]:
            assert same(twins.step(row)[0], one.step(row)[0])


@pytest.mark.parametrize("kind", KINDS)
def test_native_views_equal_those_of_gymnasiums_vector_environment(kind: ViewKind) -> None:
    native = gymnasium.make_vec(HARD, num_envs=3, observation=kind)
    other = gymnasium.make_vec(HARD, num_envs=3, observation=kind, vectorization_mode="sync")
    assert native.observation_space == other.observation_space
    assert same(native.reset(seed=2)[0], other.reset(seed=2)[0])
    for actions in np.random.default_rng(5).integers(4, size=(60, 3)):
        assert same(native.step(actions)[0], other.step(actions)[0])


def test_a_step_computes_all_views_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    envs = SPFVectorEnv(64, "easy", observation="relational", autoreset_mode="SameStep")
    envs.reset(seed=0)
    shapes, call = [], Views.__call__

    def count(self: Views, observations: NDArray[np.float32]) -> View:
        shapes.append(observations.shape)
        return call(self, observations)

    monkeypatch.setattr(Views, "__call__", count)
    ended = 0
    for _ in range(60):
        shapes.clear()
        _, _, terminated, truncated, _ = envs.step(np.full(64, 2))
        over = int((terminated | truncated).sum())
        ended += over
        assert sorted(shapes) == sorted([(64, 85), (over, 85)] if over else [(64, 85)])
    assert ended > 64


def test_every_car_has_views() -> None:
    cars = logicity.parallel_env("easy", observation="graph")
    plain = logicity.parallel_env("easy")
    layout = Layout.of_description(_logicity.describe(load_task("easy")))
    views = Views(layout, "graph")
    observations, arrays = cars.reset(seed=1)[0], plain.reset(seed=1)[0]
    for _ in range(5):
        for name, observation in observations.items():
            assert same(observation, views(arrays[name])) and observation in cars.observation_space(name)
        observations, arrays = (env.step(dict.fromkeys(env.agents, 3))[0] for env in (cars, plain))


def test_policies_are_measured_on_views() -> None:
    def by_array(observation: Any) -> int:
        return int(observation.sum()) % 4

    def by_view(view: Any) -> int:
        names = ("unary", "binary") if "unary" in view else ("nodes", "edges")
        return int(sum(view[name].sum() for name in names)) % 4

    def by_batch(view: Any) -> Any:
        return (view["unary"].sum((1, 2)) + view["binary"].sum((1, 2, 3))).astype(int) % 4

    expected = logicity.evaluate(by_array, "expert", "val")
    assert len({record.steps for record in expected.episodes}) > 5
    for kind in KINDS:
        assert logicity.evaluate(by_view, "expert", "val", observation=kind).episodes == expected.episodes
    found = logicity.evaluate(by_batch, "expert", "val", observation="relational", batched=True)
    assert found.episodes == expected.episodes


def test_measures_check_that_a_model_takes_views() -> None:
    class Model:
        observation_space = SPFEnv("easy", observation="relational").observation_space

        def predict(
            self, observation: View, state: Any = None, episode_start: Any = None, deterministic: bool = False
        ) -> tuple[Any, None]:
            return np.ones(len(observation["mask"]), int), None

    benchmark = logicity.Benchmark("easy", "val", observation="relational")
    assert benchmark.evaluate(Model()).episodes == benchmark.evaluate(lambda _: 1).episodes
    with pytest.raises(ValueError, match="'unary': .*and those of `hard` have shape .*'unary'"):
        logicity.evaluate(Model(), "hard", "val", observation="relational")
    for kind in ("groundings", "graph"):
        with pytest.raises(ValueError, match="name the mode and the observation of its training"):
            logicity.evaluate(Model(), "easy", "val", observation=kind)
    with pytest.raises(ValueError, match="RulePolicy has no `observation_space`.*`relational`: use `groundings`"):
        benchmark.evaluate(logicity.RulePolicy("rules/easy.dl", "easy"))


def test_demonstrations_are_arrays() -> None:
    for kind in KINDS:
        with pytest.raises(ValueError, match=f"`groundings` or `state`, not `{kind}`: use `groundings`"):
            logicity.demonstrations("easy", 1, observation=kind)  # type: ignore[arg-type]


def test_unknown_kinds_of_observations_are_rejected() -> None:
    kinds = '"groundings", "state", "relational", "graph", not \'points\''
    made: Any
    for made in (SPFEnv, SPFVectorEnv, logicity.parallel_env, logicity.Benchmark, logicity.demonstrations):
        with pytest.raises(ValueError, match=kinds):
            made(**({"num_envs": 1} if made is SPFVectorEnv else {}), **named(made), observation="points")


def named(made: Any) -> dict[str, str]:
    return {"mode" if made in (logicity.Benchmark, logicity.demonstrations) else "config": "easy"}


def test_only_views_have_layouts() -> None:
    task = load_task("easy")
    assert views_of(task, "groundings") is None and views_of(task, "state") is None
    views = views_of(task, "graph")
    assert views is not None and views.kind == "graph"
    assert views.shapes() == {name: space.shape for name, space in views.space().items()}


def test_unsuitable_environments_are_rejected() -> None:
    with pytest.raises(ValueError, match="`relational`"):
        RelationalObservation(SPFEnv("easy", observation="relational"))
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


def _made(config: str, **options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make("logicity/SPF-Expert-v0", config=config, **options)


def test_observations_have_quantities(patience: str) -> None:
    names = logicity.observation_names(patience)
    assert names[-10:-5] == tuple(f"Distance(4, {entity})" for entity in range(5))
    assert names[-5:] == tuple(f"Tick({entity})" for entity in range(5))
    assert "Heading=Up(3)" in names and "Waited(4)" in names
    columns = {column["predicate"]: column for column in _logicity.describe(load_task(patience))["columns"]}
    assert columns["Heading=Left"]["quantity"] == "heading" and "scale" not in columns["Heading=Left"]
    assert "quantity" not in columns["IsClose"]
    env = _made(patience)
    judge = logicity.RulePolicy(str(Path(patience).with_suffix(".dl")), patience)
    taken = set()
    for seed in range(8):
        (observation, info), step, over = env.reset(seed=seed), 0, False
        while not over and step < 60:
            assert env.observation_space.contains(observation)
            value = dict(zip(names, observation, strict=True))
            assert value["Tick(0)"] * columns["Tick"]["scale"] == pytest.approx(step)
            assert value["Distance(0, 1)"] == value["Distance(1, 0)"]
            # The rules decide on the numbers as they did in the city.
            assert judge.predict(observation[None])[0][0] == info["oracle_action"]
            taken.add(info["oracle_action"])
            observation, _, terminated, truncated, info = env.step(info["oracle_action"])
            over, step = terminated or truncated, step + 1
    assert taken == {0, 1, 2, 3}


@pytest.mark.parametrize("kind", ["relational", "graph", "state"])
def test_views_have_quantities(patience: str, kind: Any) -> None:
    plain, env = _made(patience), _made(patience, observation=kind)
    (observation, _), (view, _) = plain.reset(seed=3), env.reset(seed=3)
    for _ in range(20):
        assert env.observation_space.contains(view)
        value = dict(zip(logicity.observation_names(patience), observation, strict=True))
        if kind == "state":
            # The ego's row ends with Waited, four headings, Priority and Tick.
            headings = [value[f"Heading={name}(0)"] for name in ("Left", "Right", "Up", "Down")]
            assert view[0, -7:].tolist() == [value["Waited(0)"], *headings, value["Priority(0)"], value["Tick(0)"]]
            assert view[0, 3:7].tolist() == headings
        else:
            parts = ("unary", "binary", "mask") if kind == "relational" else ("nodes", "edges", "node_mask")
            unary, binary, mask = (view[name] for name in parts)
            binary = binary.reshape(5, 5, -1)
            assert unary[:, -1].tolist() == [value[f"Tick({entity})"] for entity in range(5)]
            assert binary[2, 1, -1] == value["Distance(2, 1)"]
            kinds = [max(value[f"IsCar({entity})"], value[f"IsPedestrian({entity})"]) for entity in range(5)]
            assert mask.tolist() == kinds
        observation, _, over, _, _ = plain.step(1)
        view, *_ = env.step(1)
        if over:
            break


def test_who_needs_truth_values_refuses_quantities(patience: str, tmp_path: Path) -> None:
    found = logicity.demonstrations(patience, 1)
    assert found.quantities == (
        "Waited",
        *(f"Heading={name}" for name in ("Left", "Right", "Up", "Down")),
        "Priority",
        "Distance",
        "Tick",
    )
    with pytest.raises(ValueError, match="truth values only, but the observations have `Waited`"):
        found.to_popper(tmp_path / "popper")


@pytest.mark.parametrize("kind", ["groundings", "relational", "graph", "state"])
def test_spaces_need_no_recorded_episodes(kind: Any, tmp_path: Path) -> None:
    # The episodes of expert mode are for another map.
    weights = "{House: 2, Office: 1, Garage: 1, Store: 1, GasStation: 1}"
    buildings = f"{{rows: ~, random: {{seed: 7, weights: {weights}}}}}"
    (tmp_path / "town.yaml").write_text(f"base: expert\nregion: ~\nmap: {{blocks: [2, 3], buildings: {buildings}}}\n")
    env = _made(str(tmp_path / "town.yaml"), observation=kind)
    assert env.observation_space.contains(env.reset(seed=0)[0])
