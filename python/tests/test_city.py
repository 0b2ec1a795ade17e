"""Scenes and simulations: decisions, arrays, controls, reasons, traces, and cancellation."""

from __future__ import annotations

import copy
import itertools
import json
import pickle
import random
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
from conftest import Interrupt

import logicity
from logicity import (
    ACTIONS,
    HEADINGS,
    REASONS,
    Inference,
    InputError,
    LimitError,
    Limits,
    Scene,
    Simulation,
    SymbolicScene,
    UnsupportedError,
    infer,
)


def scene() -> Scene:
    return {
        "map": "square-5x5",
        "agents": [
            {"id": "Car_1", "type": "Car", "at": [102, 20], "heading": "Up", "concepts": ["tiro"], "priority": 1},
            {"id": "Pedestrian_1", "type": "Pedestrian", "at": [98, 20], "priority": 0},
        ],
        "egos": ["Car_1"],
    }


@pytest.mark.parametrize("executor", ["auto", "dense", "relational"])
def test_expert_rules_stop_a_car_in_front_of_a_pedestrian(executor: Any) -> None:
    answer = infer(scene(), executor=executor)["egos"]["Car_1"]
    assert answer["sees"] == ["Car_1", "Pedestrian_1"]
    assert answer["true"]["CollidingClose"] == [["Car_1", "Pedestrian_1"]]
    assert answer["derived"] == ["Stop"]
    assert answer["action"] == "Stop"


def test_given_atoms_replace_computed_atoms() -> None:
    given = scene()
    given["given"] = {"CollidingClose": []}
    answer = Inference().answer(given)["egos"]["Car_1"]
    assert "CollidingClose" not in answer["true"]
    assert answer["action"] == "Normal"


def test_a_symbolic_scene_skips_grounding() -> None:
    answer = infer({"entities": ["a", "b"], "ego": "a", "facts": {"IsAtInter": ["a"], "IsInInter": ["b"]}}, "easy")
    assert answer["egos"]["a"]["action"] == "Stop"


def test_an_answer_says_why_the_dense_executor_gave_up(tmp_path: Path) -> None:
    people = [f"P{index}" for index in range(1, 10)]
    chain = [f"NextTo({one}, {other})" for one, other in itertools.pairwise(people)]
    clique = [f"IsClose({one}, {other})" for one, other in itertools.combinations("ABCDEFGH", 2)]
    body = ", ".join(["IsCar(X)", "IsCar(P1)", "IsPedestrian(P1)", *chain, *clique])
    rules = tmp_path / "clique.dl"
    rules.write_text(f'.include "vocabulary.dl"\nStop(X) :- {body}.\n')
    entities = [f"e{index}" for index in range(14)]
    close = [[entities[x], entities[y]] for x in range(14) for y in range(14) if x % 7 != y % 7]
    crowd: SymbolicScene = {
        "entities": entities,
        "ego": "e0",
        "facts": {
            "IsCar": ["e0", "e1"],
            "IsPedestrian": ["e2"],
            "IsClose": close,
            "NextTo": [["e0", "e1"], ["e1", "e0"]],
        },
    }
    answer = infer(crowd, rules=rules)
    assert "gave up" in answer["fallback"] and "steps" in answer["fallback"]
    relational = infer(crowd, rules=rules, executor="relational")
    assert "fallback" not in relational
    assert answer["egos"] == relational["egos"]


def test_invalid_scenes_raise_input_errors() -> None:
    faulty = scene()
    faulty["agents"][0]["concepts"] = ["ambulence"]
    with pytest.raises(InputError) as caught:
        Inference().answer(faulty)
    (fault,) = caught.value.diagnostics
    assert fault["code"] == "invalid-scene"
    assert fault["help"] == ["did you mean `ambulance`?"]
    with pytest.raises(TypeError, match="not JSON serializable"):
        Inference().answer({"entities": {1}})  # type: ignore[arg-type]
    with pytest.raises(LimitError):
        infer({"entities": [f"e{n}" for n in range(5000)], "ego": "e0"})


@pytest.mark.parametrize("kind", [Inference, Simulation])
def test_dense_executor_raises_unsupported_error(kind: Any, tmp_path: Path) -> None:
    rules = tmp_path / "reach.dl"
    rules.write_text(
        '.include "vocabulary.dl"\n.decl Reach(x: agent, y: agent)\nReach(X, Y) :- NextTo(X, Y).\n'
        "Reach(X, Z) :- Reach(X, Y), NextTo(Y, Z).\nStop(X) :- Reach(X, Y), IsBus(Y).\n"
    )
    with pytest.raises(UnsupportedError, match="`Reach` depends on itself") as caught:
        kind(rules=rules, executor="dense")
    assert not isinstance(caught.value, LimitError) and isinstance(caught.value, InputError)
    assert [fault["code"] for fault in caught.value.diagnostics] == ["dense-unsupported"]
    kind(rules=rules)


@pytest.mark.parametrize("kind", [Inference, Simulation])
def test_invalid_files_and_options_raise(kind: Any, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml"):
        kind("nowhere.yaml")
    with pytest.raises(FileNotFoundError, match=r"nowhere\.dl"):
        kind(rules="nowhere.dl")
    for option in ("config", "rules"):
        with pytest.raises(OSError, match="cannot read `/dev/null`") as refused:
            kind(**{option: "/dev/null"})
        assert not isinstance(refused.value, FileNotFoundError)
    with pytest.raises(ValueError, match=r'"auto", "dense", "relational", not "quick"'):
        kind(executor="quick")
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=rf"^seed: expected 0 to 2\*\*64 - 1, not {seed}$"):
            kind(seed=seed)
    with pytest.raises(TypeError, match="^seed: expected an integer, not float$"):
        kind(seed=1.5)
    rules = tmp_path / "mine.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsCarr(X).\n')
    with pytest.raises(InputError) as caught:
        kind(rules=rules)
    assert caught.value.diagnostics[0]["labels"][0]["file"] == str(rules)
    rules.write_text(
        '.include "vocabulary.dl"\n.decl Waited(x: agent, n: number)\n.input Waited\nStop(X) :- Waited(X, 3).\n'
    )
    with pytest.raises(InputError, match="against the configuration `configs/expert.yaml`; name another one") as caught:
        kind(rules=rules)
    assert caught.value.diagnostics[0]["code"] == "rule-mismatch"
    config = tmp_path / "mine.yaml"
    config.write_text("mapp: square-5x5\n")
    with pytest.raises(InputError) as caught:
        kind(config)
    assert "unknown-key" in {fault["code"] for fault in caught.value.diagnostics}


def test_pickled_inference_keeps_its_source_text(tmp_path: Path) -> None:
    rules = tmp_path / "mine.dl"
    rules.write_text('.include "vocabulary.dl"\nFast(X) :- IsCar(X).\n')
    inference = Inference("easy", rules, seed=3)
    rules.unlink()
    symbolic: logicity.SymbolicScene = {"entities": ["a"], "ego": "a", "facts": {"IsCar": ["a"]}}
    for again in (pickle.loads(pickle.dumps(inference)), copy.deepcopy(inference), copy.copy(inference)):
        assert again.answer(symbolic) == inference.answer(symbolic)
        assert again.answer(symbolic)["egos"]["a"]["action"] == "Fast"


def test_simulation_state_is_arrays() -> None:
    city = Simulation()
    n = len(city.agents)
    assert (n, city.now, city.executor, city.map_name) == (18, 0, "dense", "square-5x5")
    assert city.agents[0].name.endswith("_1")
    assert {agent.type for agent in city.agents} == {"Car", "Pedestrian"}
    before = city.positions
    assert (before.shape, before.dtype) == ((n, 2), np.dtype(np.int32))
    assert city.headings.tolist() == [-1] * n
    assert (city.actions == ACTIONS.index("Stop")).all()
    tick = city.tick()
    assert (tick.tick, city.now) == (0, 1)
    assert np.array_equal(tick.at, before)
    assert np.array_equal(tick.next, city.positions)
    assert np.array_equal(tick.action, city.actions)
    assert (tick.derived.shape, tick.derived.dtype) == ((n, 4), np.dtype(bool))
    assert tick.heading.dtype == tick.action.dtype == tick.reason.dtype == np.dtype(np.int8)
    # Here the rules derive at most one action per agent. Agents take that action, or otherwise the default.
    for derived, action in zip(tick.derived, tick.action, strict=True):
        assert derived[action] if derived.any() else ACTIONS[action] == "Normal"
    moved = (tick.at != tick.next).any(axis=1)
    step = (tick.next - tick.at)[moved]
    names = [HEADINGS[code] for code in city.headings[moved]]
    signs = {"Left": (0, -1), "Right": (0, 1), "Up": (-1, 0), "Down": (1, 0)}
    assert [tuple(np.sign(way)) for way in step] == [signs[name] for name in names]
    assert len(REASONS) == 5
    assert city.goals.shape == (n, 2)
    # Later ticks do not change arrays that were returned before.
    city.run(20)
    assert np.array_equal(tick.at, before)
    assert repr(city) == "<Simulation configs/expert.yaml, split test, seed 0, after 21 ticks>"


def test_equal_arguments_give_equal_simulations() -> None:
    cities = [Simulation("hard", split="val", seed=9, executor=executor) for executor in ("dense", "relational")]
    cities.append(Simulation("hard", split="val", seed=9))
    for city in cities[:2]:
        for _ in range(30):
            city.tick()
    cities[2].run(30)
    assert all(np.array_equal(city.positions, cities[0].positions) for city in cities)
    assert not np.array_equal(
        Simulation("hard", split="val", seed=10).positions, Simulation("hard", split="val", seed=9).positions
    )


def test_controls_replace_decisions() -> None:
    city, free = Simulation(seed=4), Simulation(seed=4)
    name = city.agents[2].name
    for _ in range(20):
        held, went = city.tick({name: "Stop", 3: ACTIONS.index("Stop"), int(np.int64(4)): 3}), free.tick()
        assert (held.action[2:5] == ACTIONS.index("Stop")).all()
        assert np.array_equal(held.at[2:5], held.next[2:5]) or (held.reason[2:5] != 0).any()
        assert held.tick == went.tick
    with pytest.raises(KeyError, match="did you mean `Car_1`"):
        city.tick({"Car_l": "Stop"})
    for agent in (-1, 18, 2**70):
        with pytest.raises(KeyError, match="expected 0 to 17"):
            city.tick({agent: "Stop"})
    for action in ("Halt", "Stopp", -1, 4, 1.0, True, float("nan"), None):
        with pytest.raises((ValueError, TypeError)):
            city.tick({0: action})  # type: ignore[dict-item]
    with pytest.raises(TypeError):
        city.tick({1.5: "Stop"})  # type: ignore[type-var]
    assert city.now == 20


def test_the_semantic_map_shows_the_agents() -> None:
    city = Simulation()
    city.run(3)
    layers = city.semantic_map()
    rows, columns = city.map_shape
    assert (layers.shape, layers.dtype) == ((rows, columns, 8 + len(city.agents)), np.dtype(np.float32))
    assert set(np.unique(layers)) == {0.0, 1.0}
    for index, (row, column) in enumerate(city.positions):
        assert layers[row, column, 8 + index] == 1.0
        assert layers[:, :, 8 + index].sum() == 1.0


def test_facts_are_the_inputs_of_the_decisions() -> None:
    city = Simulation("easy", seed=2)
    city.run(40)
    facts, indices = city.facts(), city.fact_indices()
    assert facts.keys() == indices.keys()
    assert {name for (name,) in facts["IsPedestrian"]} == {
        agent.name for agent in city.agents if agent.type == "Pedestrian"
    }
    assert indices["IsPedestrian"].shape[1:] == (1,)
    assert indices["Sees"].dtype == np.dtype(np.int32)
    # The Datalog engine derives the same actions from these facts.
    session = logicity.Session(logicity.Program.load("rules/easy.dl"))
    for predicate, rows in facts.items():
        if predicate in session.program.predicates:
            session.insert(predicate, rows)
    session.commit()
    stopped = {name for (name,) in session.rows("Stop")}
    derived = city.last.derived[:, ACTIONS.index("Stop")]
    assert stopped == {agent.name for agent, stop in zip(city.agents, derived, strict=True) if stop}
    assert stopped


def test_explanations_of_actions() -> None:
    city = Simulation()
    city.run(6)
    stopped = next(index for index, derived in enumerate(city.last.derived) if derived[ACTIONS.index("Stop")])
    why = city.explain(stopped)
    name = city.agents[stopped].name
    assert (why.tick, why.agent, why.action, why.derived) == (5, name, "Stop", ("Stop",))
    assert why.at == tuple(city.last.at[stopped])
    assert str(why).startswith(
        f'tick 5: {name} at [{why.at[0]}, {why.at[1]}], heading {why.heading}: Stop\n\nStop("{name}")  by S'
    )
    assert why.explanations[0]["nodes"][0]["holds"] == f"Stop({name})"
    other = city.why_not(name, "Fast")
    assert other.explanations[0]["action"] == "Fast"
    assert f'Not(Fast("{name}"))' in str(other)
    city.tick({stopped: "Fast"})
    assert "the action came from outside" in str(city.explain(stopped))
    with pytest.raises(KeyError, match="Absent"):
        city.explain("Absent")
    with pytest.raises(ValueError, match="is not an action"):
        city.why_not(stopped, 4)


def test_explanations_of_facts() -> None:
    city = Simulation()
    city.run(6)
    first, second = city.facts()["NextTo"][0]
    near = city.explain(first, f"NextTo({first}, {second})")
    assert near.holds and near.fact == f'NextTo("{first}", "{second}")'
    assert city.explain(first, "NextTo").holds
    walks = city.why_not("Car_1", "IsPedestrian")
    assert isinstance(walks, logicity.Explanation)
    assert not walks.holds and walks.text.startswith('IsPedestrian("Car_1") does not hold: it is a base fact, ')
    assert walks.nodes[0]["because"] == "not-a-fact"
    for fact, said in [
        ("Fly", "no predicate `Fly` is declared"),
        ("IsBuss", "did you mean `IsBus`?"),
        ("IsClose(Car_1)", "`IsClose` has 2 columns, but 1 value is given"),
        ("IsClose(Car_1, Car_99)", "there is no agent `Car_99`"),
        ("IsClose(Car_1", "expected a predicate"),
    ]:
        with pytest.raises(logicity.InputError, match=re.escape(said)):
            city.explain("Car_1", fact)


def test_the_command_line_reads_the_trace(tmp_path: Path) -> None:
    path = tmp_path / "trace.jsonl"
    city = Simulation(seed=1, count_firings=True)
    city.run(10, trace=path)
    header, *ticks = map(json.loads, path.read_text().splitlines())
    assert (header["trace"], header["seed"], len(header["agents"])) == ("logicity", 1, len(city.agents))
    assert [tick["tick"] for tick in ticks] == list(range(10))
    assert [agent["next"] for agent in ticks[-1]["agents"]] == city.positions.tolist()
    fired = sum(1 for label, count in city.firings if count)
    assert fired and any(agent["clauses"] for agent in ticks[-1]["agents"])
    with pytest.raises(ValueError, match="count_firings=True"):
        Simulation().run(1, trace=path)
    with pytest.raises(OSError, match="cannot write"):
        city.run(1, trace=tmp_path / "missing" / "trace.jsonl")
    assert Simulation().firings == []


def test_simulation_rejects_invalid_use() -> None:
    with pytest.raises(ValueError, match='"train", "val", "test", not "tset"'):
        Simulation(split="tset")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^ticks: expected 0 to 2\*\*64 - 1, not -1$"):
        Simulation().run(-1)
    for threads in (-1, 1025, 2**64):
        with pytest.raises(ValueError, match=f"^threads: expected 0 to 1024, not {threads}$"):
            Simulation(threads=threads)
    with pytest.raises(TypeError, match="^controls: expected a mapping, not list$"):
        Simulation().tick([(0, 3)])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "again",
    [copy.copy, copy.deepcopy, lambda city: pickle.loads(pickle.dumps(city))],
    ids=["copy", "deepcopy", "pickle"],
)
def test_a_copied_simulation_continues_identically(again: Callable[[Simulation], Simulation], tmp_path: Path) -> None:
    rules = tmp_path / "mine.dl"
    rules.write_text('.include "medium.dl"\nFast(X) :- IsBus(X).\n')
    city = Simulation("medium", rules, seed=4, count_firings=True)
    rules.unlink()
    for ticks in (0, 7, 30):
        city.run(ticks)
        city.tick({"Car_1": "Stop", "Car_2": 2})
        twin = again(city)
        assert (twin.now, repr(twin), twin.firings) == (city.now, repr(city), city.firings)
        for _ in range(20):
            one, other = city.tick({0: 3}), twin.tick({0: 3})
            assert all(np.array_equal(getattr(one, key), getattr(other, key)) for key in one.__dataclass_fields__)
        assert twin.explain("Car_1") == city.explain("Car_1")


def test_ctrl_c_ends_a_run_and_keeps_its_trace(tmp_path: Path, ctrl_c: Interrupt) -> None:
    city, path = Simulation("easy", count_firings=True), tmp_path / "trace.jsonl"
    ctrl_c(lambda: city.run(10**9, trace=path))
    ticks = path.read_text().count("\n") - 1
    assert ticks == city.now > 0
    assert city.tick().tick == ticks


#: Rules that count for minutes if there is a car.
COUNTING = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
n(0) :- IsCar(X).
n(x + 1) :- n(x), x < 90000000.
Stop(X) :- IsCar(X), n(90000000).
"""


#: A search for a cycle that does not exist, which takes minutes for many agents.
CIRCLE = """
.include "vocabulary.dl"
Stop(X) :- HigherPri(X, Y), HigherPri(Y, Z), HigherPri(Z, W), HigherPri(W, V), HigherPri(V, U), HigherPri(U, X).
"""


def test_ctrl_c_ends_a_tick(tmp_path: Path, ctrl_c: Interrupt) -> None:
    (tmp_path / "counting.dl").write_text(COUNTING)
    city = Simulation("easy", tmp_path / "counting.dl", seed=1)
    positions = city.positions
    ctrl_c(city.tick)
    ctrl_c(lambda: city.run(3))
    ctrl_c(lambda: city.explain("Car_1"))
    assert city.now == 0 and (city.positions == positions).all()
    assert Simulation("easy", seed=1).tick().tick == 0


def test_ctrl_c_ends_an_answer(tmp_path: Path, ctrl_c: Interrupt) -> None:
    (tmp_path / "counting.dl").write_text(COUNTING)
    (tmp_path / "circle.dl").write_text(CIRCLE)
    names = [f"e{number}" for number in range(1600)]
    above = [[one, other] for at, one in enumerate(names) for other in names[at + 1 :]]
    dense = Inference("easy", tmp_path / "circle.dl", executor="dense")
    ctrl_c(lambda: dense.answer({"entities": names, "ego": names[0], "facts": {"HigherPri": above}}))
    few: SymbolicScene = {"entities": names[:4], "ego": "e0", "facts": {"HigherPri": [["e0", "e1"], ["e1", "e0"]]}}
    assert dense.answer(few)["egos"]["e0"]["action"] == "Stop"
    inference = Inference("easy", tmp_path / "counting.dl")
    scene: SymbolicScene = {"entities": ["me"], "ego": "me", "facts": {"IsPedestrian": ["me"]}}
    long: SymbolicScene = {"entities": ["me"], "ego": "me", "facts": {"IsCar": ["me"]}}
    expected = inference.answer(scene)
    ctrl_c(lambda: inference.answer(long))
    assert inference.answer(scene) == expected


def test_ctrl_c_ends_loading(tmp_path: Path, ctrl_c: Interrupt) -> None:
    ctrl_c(lambda: Simulation("metropolis"))
    chooser = random.Random(0)
    atoms = [f"{name}({a}, {b})" for name in ("IsClose", "LeftOf", "RightOf", "NextTo") for a in "XYZ" for b in "XYZ"]
    clauses = [f"Stop(X) :- IsCar(X), {', '.join(chooser.sample(atoms, 6))}." for _ in range(20_000)]
    text = "\n".join(['.include "vocabulary.dl"', *clauses])
    (tmp_path / "many.dl").write_text(text)
    for load in (
        lambda: Simulation("expert", tmp_path / "many.dl"),
        lambda: Inference("expert", tmp_path / "many.dl"),
        lambda: gymnasium.make("logicity/SPF-Expert-v0", rules=tmp_path / "many.dl"),
        lambda: logicity.check(text),
    ):
        ctrl_c(load)
    assert Simulation("easy").tick().tick == 0


def test_concurrent_use_of_a_simulation_raises_and_ticks_release_the_gil() -> None:
    city = Simulation("easy")

    def run() -> None:
        done = False
        while not done:
            # The call raises while the other thread uses the simulation.
            with suppress(RuntimeError):
                city.run(300_000)
                done = True

    worker = threading.Thread(target=run)
    worker.start()
    refused = 0
    while worker.is_alive():
        try:
            city.tick()
        except RuntimeError as error:
            assert "another thread is using" in str(error)
            refused += 1
        time.sleep(0)
    worker.join()
    assert refused > 0


def test_explain_before_the_first_tick_shows_what_the_rules_derive() -> None:
    city = logicity.Simulation("expert", seed=1)
    names = [agent.name for agent in city.agents]
    before = [city.explain(name) for name in names]
    tick = city.tick()
    assert [why.action for why in before] == [logicity.ACTIONS[action] for action in tick.action]
    assert not any("came from outside" in str(why) for why in before)


def test_too_many_threads_raise() -> None:
    program = logicity.Program(".decl a(x: number)")
    with pytest.raises(ValueError, match="expected 0 to 1024, not 1025"):
        logicity.Session(program, threads=1025)
    with pytest.raises(ValueError, match="expected 0 to 1024, not 100000"):
        logicity.Simulation("expert", threads=100_000)


def test_a_session_of_something_else_than_a_program_raises() -> None:
    with pytest.raises(TypeError, match="expected a Program, not str"):
        logicity.Session("a(1).")  # type: ignore[arg-type]


COUNTED = """.include "vocabulary.dl"
.decl N(x: number)
N(0).
N(X + 1) :- N(X), X < 5000.
Stop(X) :- IsCar(X), CollidingClose(X, Y), N(6000).
"""


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("max_rows", "the rules derive more than 100 rows"),
        ("max_steps", "the rules scan more than 100 rows"),
        ("max_bytes", "take more than 100 bytes"),
    ],
)
def test_limits_of_ticks_and_scenes(tmp_path: Path, limit: str, message: str) -> None:
    rules = tmp_path / "rules.dl"
    rules.write_text(COUNTED)
    little = cast(Limits, {limit: 100})
    single: SymbolicScene = {"entities": ["a"], "ego": "a", "facts": {"IsCar": ["a"]}}
    city = Simulation("easy", rules, limits=little)
    inference = Inference("easy", rules, limits=little)
    calls: list[Callable[[], object]] = [
        city.tick,
        copy.deepcopy(city).tick,
        lambda: inference.answer(single),
        lambda: copy.deepcopy(inference).answer(single),
        lambda: infer(single, "easy", rules, limits=little),
    ]
    for call in calls:
        with pytest.raises(LimitError, match=message) as caught:
            call()
        (fault,) = caught.value.diagnostics
        assert fault["help"][-1] == f"raise the limit `{limit}`"
        assert "--max" not in str(caught.value)
    enough = cast(Limits, {limit: 10**8})
    Simulation("easy", rules, limits=enough).tick()
    assert infer(single, "easy", rules, limits=enough)["egos"]["a"]["action"] == "Normal"


def test_unknown_limits_are_errors() -> None:
    with pytest.raises(ValueError, match="limits: unknown key 'rows'; known: max_rows, max_steps, max_bytes"):
        Simulation(limits=cast(Limits, {"rows": 5}))
    with pytest.raises(ValueError, match="max_rows: expected 0 to"):
        Simulation(limits={"max_rows": -1})
    with pytest.raises(TypeError, match="limits: expected a mapping, not int"):
        Inference(limits=cast(Limits, 5))
