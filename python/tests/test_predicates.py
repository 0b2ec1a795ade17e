"""Base predicates that Python functions compute."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from conftest import needs
from numpy.typing import NDArray

import logicity
from logicity import CityState, PredicateError, PythonPredicate, Simulation
from logicity.predicates import Function

CONFIG = """
base: expert
rules: lights.dl
predicates:
  define:
    IsGreen: {external: agent}
    IsRival: {external: pair}
"""
RULES = """
.include "vocabulary.dl"
.decl IsGreen(x: agent)
.decl IsRival(x: agent, y: agent)
.input IsGreen, IsRival
Stop(X) :- IsCar(X), Not(IsGreen(X)).
Slow(X) :- IsRival(X, Y), Not(Stop(X)).
"""


@logicity.predicate("IsGreen")
def is_green(state: CityState) -> NDArray[np.bool_]:
    """Each agent has two phases."""
    return cast(NDArray[np.bool_], (state.positions.sum(axis=1) + state.tick // 4) % 3 > 0)


@logicity.predicate("IsRival")
def is_rival(state: CityState) -> NDArray[np.bool_]:
    return state.distances() < 30.0


BOTH = [is_green, is_rival]


def always(state: CityState) -> NDArray[np.bool_]:
    return np.ones(len(state), np.bool_)


@pytest.fixture
def config(tmp_path: Path) -> str:
    (tmp_path / "lights.dl").write_text(RULES)
    (tmp_path / "lights.yaml").write_text(CONFIG)
    return str(tmp_path / "lights.yaml")


def of(function: Function) -> list[PythonPredicate]:
    return [logicity.predicate("IsGreen")(function), is_rival]


def test_a_predicate_is_a_decorated_function() -> None:
    assert isinstance(is_green, PythonPredicate)
    assert (is_green.name, is_green.__doc__) == ("IsGreen", "Each agent has two phases.")
    assert repr(is_green) == "<PythonPredicate IsGreen: is_green>"
    made = logicity.predicate("IsGreen")(always)
    assert made.function is always
    with pytest.raises(TypeError, match=r'expected a name, as in `@predicate\("IsGreen"\)`, not function'):
        logicity.predicate(cast(Any, always))
    with pytest.raises(TypeError, match="predicate\\(`IsGreen`\\): expected a function, not int"):
        logicity.predicate("IsGreen")(cast(Any, 3))


def test_a_function_gets_the_state_of_the_tick(config: str) -> None:
    states: list[CityState] = []

    def note(state: CityState) -> NDArray[np.bool_]:
        states.append(state)
        return always(state)

    city = Simulation(config, predicates=of(note))
    positions, headings, goals = [], [], []
    for _ in range(30):
        positions.append(city.positions)
        headings.append(city.headings)
        goals.append(city.goals)
        city.tick()
    # Once per tick.
    assert [state.tick for state in states] == list(range(30))
    n = len(city.agents)
    expected = {
        "kinds": (np.int8, (n,)),
        "positions": (np.int32, (n, 2)),
        "headings": (np.int8, (n,)),
        "goals": (np.int32, (n, 2)),
        "priorities": (np.int32, (n,)),
        "speeds": (np.int32, (n,)),
        "waited": (np.int32, (n,)),
        "remaining": (np.int32, (n,)),
        "concepts": (np.bool_, (n, len(states[0].concept_names))),
    }
    for state in states:
        assert (len(state), state.map_shape) == (n, city.map_shape)
        for name, (dtype, shape) in expected.items():
            array = getattr(state, name)
            assert (array.dtype, array.shape) == (dtype, shape), name
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
    for state, at, heading, goal in zip(states, positions, headings, goals, strict=True):
        assert np.array_equal(state.positions, at)
        assert np.array_equal(state.headings, heading)
        assert np.array_equal(state.goals, goal)
    for before, after in zip(states, states[1:], strict=False):
        moved = np.abs(after.positions - before.positions).sum(axis=1)
        assert np.array_equal(after.speeds, moved)
        assert np.array_equal(after.waited, np.where(moved > 0, 0, before.waited + 1))
    state = states[0]
    assert [logicity.KINDS[kind] for kind in state.kinds] == [agent.type for agent in city.agents]
    assert state.priorities.tolist() == [agent.priority for agent in city.agents]
    assert state.has("tiro").tolist() == ["tiro" in agent.concepts for agent in city.agents]
    assert state.remaining.min() >= 0
    with pytest.raises(KeyError, match="unknown concept `tyro`; did you mean `tiro`"):
        state.has("tyro")
    assert state.distances()[0, 1] == np.hypot(*(state.positions[0] - state.positions[1]))


def test_rules_read_the_facts(config: str) -> None:
    city = Simulation(config, predicates=BOTH)
    actions = set()
    for _ in range(40):
        at, now = city.positions, city.now
        done = city.tick()
        green = (at.sum(axis=1) + now // 4) % 3 > 0
        facts = city.fact_indices()
        assert facts["IsGreen"][:, 0].tolist() == np.flatnonzero(green).tolist()
        rivals = np.zeros((len(at), len(at)), np.bool_)
        rivals[tuple(facts["IsRival"].T)] = True
        apart = np.hypot(*np.moveaxis(at[:, None] - at[None], 2, 0))
        assert np.array_equal(rivals, (apart < 30) & ~np.eye(len(at), dtype=np.bool_))
        cars = np.array([agent.type == "Car" for agent in city.agents])
        assert np.array_equal(done.derived[:, logicity.ACTIONS.index("Stop")], cars & ~green)
        actions.update(done.action.tolist())
    assert len(actions) > 2
    waiting = int(np.flatnonzero(cars & ~green)[0])
    assert "IsGreen" in str(city.explain(waiting))
    assert city.explain(waiting, "IsGreen").holds is False


@pytest.mark.parametrize("executor", ["dense", "relational"])
def test_executors_and_threads_agree(tmp_path: Path, executor: logicity.Executor) -> None:
    (tmp_path / "lights.dl").write_text(RULES.replace("IsRival(X, Y), Not", "Sees(X, Y), IsRival(X, Y), Not"))
    (tmp_path / "lights.yaml").write_text(CONFIG + "agents: {test: {repeat: 20}}\n")
    config = str(tmp_path / "lights.yaml")
    cities = [
        Simulation(config, threads=threads, executor=executor, predicates=BOTH)
        for threads in ([1, 2] if executor == "dense" else [1])
    ]
    reference = Simulation(config, executor="auto", predicates=BOTH)
    for _ in range(5):
        wanted = reference.tick()
        for city in cities:
            assert np.array_equal(city.tick().next, wanted.next)


def fails(state: CityState) -> NDArray[np.bool_]:
    raise ZeroDivisionError("no light")


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (
            lambda state: np.ones(3, np.bool_),
            "expected a bool array of shape ({n},), not an array of type bool and shape (3,)",
        ),
        (lambda state: np.ones(len(state)), "expected a bool array of shape ({n},), not an array of type float64"),
        (lambda state: [True] * len(state), "expected a bool array of shape ({n},), not list"),
        (lambda state: None, "expected a bool array of shape ({n},), not NoneType"),
        (fails, "ZeroDivisionError: no light"),
    ],
)
def test_a_function_that_fails_leaves_the_city_unchanged(config: str, result: Function, message: str) -> None:
    bad = [False]
    city = Simulation(config, predicates=of(lambda state: result(state) if bad[0] else always(state)))
    city.run(3)
    before, last = city.positions, city.last
    bad[0] = True
    with pytest.raises(PredicateError) as caught:
        city.tick()
    expected = "the predicate `IsGreen` failed in tick 3: " + message.replace("{n}", str(len(city.agents)))
    assert str(caught.value).startswith(expected)
    assert isinstance(caught.value.__cause__, ZeroDivisionError) == (result is fails)
    assert (city.now, city.positions.tolist()) == (3, before.tolist())
    assert city.last.action.tolist() == last.action.tolist()
    with pytest.raises(PredicateError):
        city.run(2)
    bad[0] = False
    city.run(2)
    assert city.now == 5


def test_a_matrix_has_a_row_and_a_column_per_agent(config: str) -> None:
    rival = logicity.predicate("IsRival")(always)
    city = Simulation(config, predicates=[is_green, rival])
    n = len(city.agents)
    with pytest.raises(
        PredicateError, match=rf"`IsRival` failed in tick 0: expected a bool array of shape \({n}, {n}\)"
    ):
        city.tick()


def test_ctrl_c_in_a_function_ends_the_run(config: str) -> None:
    def interrupted(state: CityState) -> NDArray[np.bool_]:
        if state.tick == 2:
            raise KeyboardInterrupt
        return always(state)

    city = Simulation(config, predicates=of(interrupted))
    with pytest.raises(KeyboardInterrupt):
        city.run(5)
    assert city.now == 2


def test_a_function_cannot_use_its_city(config: str) -> None:
    def nested(state: CityState) -> NDArray[np.bool_]:
        city.tick()
        return always(state)

    city = Simulation(config, predicates=of(nested))
    with pytest.raises(PredicateError, match="RuntimeError"):
        city.tick()


def test_predicates_and_configuration_must_fit(config: str) -> None:
    with pytest.raises(logicity.InputError, match=r"no function computes `IsGreen`, `IsRival`") as missing:
        Simulation(config)
    assert missing.value.diagnostics[0]["code"] == "external-predicate"
    assert "predicates=[...]" in str(missing.value)
    with pytest.raises(logicity.InputError, match=r"no function computes `IsRival`"):
        Simulation(config, predicates=[is_green])
    with pytest.raises(logicity.InputError, match="did you mean `IsGreen`"):
        Simulation(config, predicates=[logicity.predicate("IsGren")(always), is_rival])
    with pytest.raises(logicity.InputError, match="`IsGreen` is no external predicate of the configuration `expert`"):
        Simulation("expert", predicates=[is_green])
    with pytest.raises(logicity.InputError, match="two functions are given for the predicate `IsGreen`"):
        Simulation(config, predicates=[is_green, *BOTH])
    with pytest.raises(TypeError, match="expected a list of predicates, not PythonPredicate"):
        Simulation(config, predicates=cast(Any, is_green))
    with pytest.raises(TypeError, match=r"made with `logicity.predicate\(NAME\)`, not function"):
        Simulation(config, predicates=cast(Any, [always]))


def test_traces_replay_without_python(config: str, tmp_path: Path) -> None:
    city = Simulation(config, predicates=BOTH, count_firings=True)
    trace = tmp_path / "trace.jsonl"
    city.run(12, trace=trace)
    assert '"IsGreen":[["' in trace.read_text()
    # The functions are gone, with the configuration.
    (tmp_path / "lights.yaml").unlink()
    (tmp_path / "lights.dl").unlink()
    command = [sys.executable, "-m", "logicity", "explain", str(trace), "--agent", "Car_1"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert 'IsGreen("Car_1")' in found.stdout
    viewed = subprocess.run(
        [sys.executable, "-m", "logicity", "view", str(trace), "--output", str(tmp_path / "run.html")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert viewed.returncode == 0, viewed.stderr
    assert (tmp_path / "run.html").stat().st_size > 10_000


def test_commands_name_what_they_lack(config: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "logicity", "run", config, "--ticks", "1", "--out", str(tmp_path / "run")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 1
    assert "error[external-predicate]: no function computes `IsGreen`, `IsRival`" in found.stderr
    checked = subprocess.run(
        [sys.executable, "-m", "logicity", "check", config], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stderr + checked.stdout


def test_predicates_are_copied_and_pickled(config: str) -> None:
    city = Simulation(config, predicates=BOTH)
    city.run(5)
    for other in (copy.deepcopy(city), pickle.loads(pickle.dumps(city))):
        assert other.positions.tolist() == city.positions.tolist()
        other.tick()
    assert pickle.loads(pickle.dumps(is_green)) is is_green
    again = pickle.loads(pickle.dumps(logicity.predicate("IsGreen")(always)))
    assert (again.name, again.function) == ("IsGreen", always)
    local = Simulation(config, predicates=of(lambda state: always(state)))
    copy.deepcopy(local)
    with pytest.raises(pickle.PicklingError, match="the predicate `IsGreen` cannot be pickled: define its function at"):
        pickle.dumps(local)


@pytest.fixture
def gymnasium() -> Any:
    return needs("gymnasium", "gym")


def made(gymnasium: Any, config: str, **options: Any) -> Any:
    return gymnasium.make("logicity/SPF-Expert-v0", config=config, predicates=BOTH, **options)


def test_environments_call_the_functions(config: str, gymnasium: Any) -> None:
    env = made(gymnasium, config, atoms=True).unwrapped
    names = logicity.observation_names(config)
    green = [at for at, name in enumerate(names) if str(name).startswith("IsGreen")]
    assert len(green) == 5
    assert sum(str(name).startswith("IsRival") for name in names) == 25
    observation, info = env.reset(seed=3)
    held, wanted = 0, set()
    for _ in range(60):
        true = {atom for atom in info["true_atoms"] if atom.startswith("IsGreen")}
        assert len(true) == observation[green].sum()
        held += len(true)
        wanted.add(info["oracle_action"])
        observation, _, terminated, truncated, info = env.step(info["oracle_action"])
        if terminated or truncated:
            observation, info = env.reset()
    assert held > 20
    assert len(wanted) > 1
    assert "IsGreen" in env.explain("IsGreen")
    with pytest.raises(logicity.InputError, match="no function computes `IsGreen`, `IsRival`"):
        gymnasium.make("logicity/SPF-Expert-v0", config=config)


@pytest.mark.parametrize("threads", [1, 2])
def test_vectors_equal_single_environments(config: str, gymnasium: Any, threads: int) -> None:
    from logicity.envs import SPFVectorEnv

    vector = SPFVectorEnv(20, config, predicates=BOTH, num_threads=threads, autoreset_mode="SameStep")
    singles = [made(gymnasium, config).unwrapped for _ in range(3)]
    observations, _ = vector.reset(seed=5)
    for at, single in enumerate(singles):
        assert np.array_equal(single.reset(seed=5 + at)[0], observations[at])
    random = np.random.default_rng(0)
    for _ in range(25):
        actions = random.integers(4, size=20)
        observations, rewards, terminated, truncated, _ = vector.step(actions)
        for at, single in enumerate(singles):
            observation, reward, *ends, _ = single.step(actions[at])
            assert (reward, ends) == (rewards[at], [terminated[at], truncated[at]])
            if any(ends):
                observation, _ = single.reset()
            assert np.array_equal(observation, observations[at])


@pytest.mark.parametrize("threads", [1, 2])
def test_a_vector_raises_the_error_of_a_function(config: str, gymnasium: Any, threads: int) -> None:
    from logicity.envs import SPFVectorEnv

    bad = [False]
    flaky = of(lambda state: fails(state) if bad[0] else always(state))
    vector = SPFVectorEnv(40, config, predicates=flaky, num_threads=threads)
    vector.reset(seed=1)
    bad[0] = True
    with pytest.raises(PredicateError, match="the predicate `IsGreen` failed in tick 1: ZeroDivisionError") as caught:
        vector.step(np.zeros(40, np.int64))
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    bad[0] = False
    vector.reset(seed=1)
    vector.step(np.zeros(40, np.int64))


def test_environments_are_pickled_and_run_in_processes(config: str, gymnasium: Any) -> None:
    env = made(gymnasium, config).unwrapped
    env.reset(seed=1)
    env.step(0)
    other = pickle.loads(pickle.dumps(env))
    assert np.array_equal(env.step(1)[0], other.step(1)[0])
    made_here = of(lambda state: always(state))
    local = gymnasium.make("logicity/SPF-Expert-v0", config=config, predicates=made_here).unwrapped
    with pytest.raises(pickle.PicklingError, match="cannot be pickled"):
        pickle.dumps(local)


def test_every_car_of_a_parallel_environment_observes(config: str) -> None:
    needs("pettingzoo", "pettingzoo")
    env = logicity.parallel_env(config, predicates=BOTH)
    env.reset(seed=1)
    for _ in range(5):
        if not env.agents:
            break
        observations, *_ = env.step({name: np.int64(0) for name in env.agents})
        assert all(np.isfinite(observation).all() for observation in observations.values())


def test_demonstrations_evaluations_and_learners_read_them(config: str, gymnasium: Any) -> None:
    shown = logicity.demonstrations(config, 2, predicates=BOTH)
    atoms = [name for name, _ in shown.atoms]
    assert "IsGreen" in atoms
    place = atoms.index("IsGreen")
    assert {0.0, 1.0} <= {float(value) for each in shown for value in each.observations[:, place]}
    with pytest.raises(ValueError, match="a Minari dataset cannot store the functions of `predicates`"):
        shown.to_minari()
    measured = logicity.evaluate("oracle", config, "val", predicates=BOTH)
    assert measured.compliance.value > 0.5
    induced = logicity.induce(shown)
    assert "IsGreen" in induced.text


TRICKY: list[tuple[Callable[[NDArray[np.bool_]], Any], bool]] = [
    (lambda matrix: matrix.T, True),
    (lambda matrix: np.asfortranarray(matrix), True),
    (lambda matrix: np.repeat(matrix, 2, axis=1)[:, ::2], True),
    (lambda matrix: matrix.astype(np.uint8), False),
    (lambda matrix: np.ma.masked_array(matrix, mask=False), True),
]


@pytest.mark.parametrize(("change", "fits"), TRICKY)
def test_arrays_of_any_memory_layout(config: str, change: Callable[[NDArray[np.bool_]], Any], fits: bool) -> None:
    rival = logicity.predicate("IsRival")(lambda state: change(state.distances() < 30.0))
    city, usual = Simulation(config, predicates=[is_green, rival]), Simulation(config, predicates=BOTH)
    if not fits:
        with pytest.raises(PredicateError, match="an array of type uint8"):
            city.tick()
        return
    city.run(10)
    usual.run(10)
    assert city.positions.tolist() == usual.positions.tolist()
