"""Policies made of rules, and the learners that find rules."""

from __future__ import annotations

import copy
import pickle
import stat
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, needs
from numpy.typing import NDArray

import logicity
from logicity import ACTIONS, MODES, Benchmark, InputError
from logicity._logicity import ConfigFile, describe
from logicity.envs.layout import atoms_of
from logicity.offline import popper_names
from logicity.rule_policy import RulePolicy, rule_policies, saved_by
from logicity.tasks import load_task
from logicity.types import Atom

PLAIN = ["easy", "medium", "hard", "expert"]


def atoms_in(mode: str) -> tuple[Atom, ...]:
    return tuple(atoms_of(describe(load_task(mode))))


def mode_rules(mode: str) -> Path:
    return ROOT / "rules" / f"{mode}.dl"


def random_observations(mode: str, count: int, seed: int) -> NDArray[np.float32]:
    """Return observations that satisfy the constraints that rules may rely on: each entity is of one kind."""
    random = np.random.default_rng(seed)
    atoms = atoms_in(mode)
    result = np.zeros((count, len(atoms)), np.float32)
    for row in result:
        present = random.integers(1, 6)
        density = random.choice([0.05, 0.2, 0.5])
        cars = random.random(present) < 0.6
        for at, (name, entities) in enumerate(atoms):
            if max(entities) >= present or (len(entities) == 2 and entities[0] == entities[1]):
                continue
            if name in ("IsCar", "IsPedestrian"):
                row[at] = cars[entities[0]] == (name == "IsCar")
            else:
                row[at] = random.random() < density
    return result


def inferred(mode: str, observations: NDArray[np.float32], rules: Path) -> list[int]:
    """Decide with one scene per observation: the slow and obvious way."""
    atoms = atoms_in(mode)
    inference = logicity.Inference(mode, rules=rules)
    decided = []
    for observation in observations:
        facts: dict[str, list[Any]] = {}
        present = 1
        for (name, entities), value in zip(atoms, observation, strict=True):
            if value > 0.5:
                present = max(present, 1 + max(entities))
                names = [f"e{entity}" for entity in entities]
                facts.setdefault(name, []).append(names[0] if len(names) == 1 else names)
        present_names = [f"e{number}" for number in range(present)]
        answer = inference.answer({"entities": present_names, "ego": "e0", "facts": facts})
        decided.append(ACTIONS.index(answer["egos"]["e0"]["action"]))
    return decided


#: Rules that are not those of any mode: negation over others, auxiliary predicates, and several derived actions.
OTHERS = """
.include "vocabulary.dl"
.decl Calm(x: agent)
Calm(X) :- Sees(X, X), Not(IsAtInter(X)).
.decl Old(x: agent)
Old(X) :- Sees(X, Y), IsOld(Y), Not(CollidingClose(X, Y)).
Stop(X) :- Sees(X, Y), Not(IsCar(Y)), HigherPri(X, Y).
Slow(X) :- Calm(X), Not(Old(X)), Not(Stop(X)).
Fast(X) :- IsAmbulance(X).
Fast(X) :- HigherPri(Y, Z), HigherPri(Z, X).
"""

#: Rules that the dense executor cannot evaluate, because they count.
COUNTING = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
n(0) :- IsOld(X).
n(x + 1) :- n(x), x < 3.
Slow(X) :- IsCar(X), n(3).
Stop(X) :- IsCar(X), IsAtInter(X).
"""


@pytest.mark.parametrize("mode", PLAIN)
@pytest.mark.parametrize("rules", ["mode", "others", "counting"])
def test_decisions_equal_those_of_scenes(mode: str, rules: str, tmp_path: Path) -> None:
    path = mode_rules(mode)
    if rules != "mode":
        path = tmp_path / "rules.dl"
        path.write_text({"others": OTHERS, "counting": COUNTING}[rules])
    observations = random_observations(mode, 120, seed=3)
    decided = RulePolicy(path, mode)(observations)
    assert decided.dtype == np.int64
    assert decided.tolist() == inferred(mode, observations, path)
    assert len(set(decided.tolist())) > 1


@pytest.mark.parametrize("mode", MODES.values())
def test_rules_of_a_mode_repeat_its_demonstrations(mode: str) -> None:
    needs("gymnasium", "gym")
    policy = RulePolicy(mode_rules(mode), mode)
    for trajectory in logicity.demonstrations(mode, 4):
        assert policy(trajectory.observations[:-1]).tolist() == trajectory.actions.tolist()


def test_rules_of_a_mode_are_the_oracle() -> None:
    (policy,) = rule_policies(mode_rules("expert"), ["expert"])
    benchmark = Benchmark("expert", "val")
    own, oracle = benchmark.evaluate(policy), benchmark.evaluate("oracle")
    assert own.episodes == oracle.episodes
    assert own.tsr.value == 1.0


def test_batches_of_any_layout_are_the_same() -> None:
    policy = RulePolicy(mode_rules("medium"), "medium")
    observations = random_observations("medium", 50, seed=4)
    expected = policy(observations)
    assert (policy(np.asfortranarray(observations)) == expected).all()
    assert (policy(observations.astype(np.float64)[::-1])[::-1] == expected).all()
    assert policy(np.zeros((0, policy.width))).shape == (0,)
    actions, state = policy.predict(observations)
    assert (actions == expected).all() and state is None
    for twin in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert (twin(observations) == expected).all()


def test_faulty_rules_and_shapes_are_errors(tmp_path: Path) -> None:
    path = tmp_path / "rules.dl"
    path.write_text('.include "vocabulary.dl"\nStop(X) :- IsCar(X), IsPolice(Y).\n')
    assert RulePolicy(path, "hard").width == 205
    with pytest.raises(InputError, match="IsPolice"):
        RulePolicy(path, "easy")
    path.write_text('.include "vocabulary.dl"\nStop(X) :- IsCra(X).\n')
    with pytest.raises(InputError, match=r"IsCra[^$]*IsCar"):
        RulePolicy(path, "hard")
    with pytest.raises(FileNotFoundError, match=r"none\.dl"):
        RulePolicy(tmp_path / "none.dl", "hard")
    with pytest.raises(ValueError, match="unknown mode `hrad`"):
        RulePolicy(mode_rules("hard"), "hrad")
    policy = RulePolicy(mode_rules("easy"), "easy")
    for shape in [(85,), (3, 84), (2, 3, 85)]:
        with pytest.raises(ValueError, match=r"expected a batch of observations of `easy`, of shape \(N, 85\)"):
            policy(np.zeros(shape))


def test_only_files_of_learners_name_their_mode(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"first line is not `// logicity policy 1: LEARNER, MODE`"):
        rule_policies(mode_rules("easy"))
    path = tmp_path / "best.dl"
    path.write_text(f"// logicity policy 1: induce, easy\n{mode_rules('easy').read_text()}")
    assert saved_by(path) == {"algorithm": "induce", "mode": "easy"}
    (policy,) = rule_policies(path)
    assert policy.mode == "easy"
    policy.save(tmp_path / "copy.dl")
    assert (tmp_path / "copy.dl").read_text() == policy.text == path.read_text()


# --- learners


def learner(algorithm: str, mode: str = "easy", share: float = 1.0, **settings: Any) -> Any:
    """Return a learner of rules."""
    needs("torch", "learn")
    needs("gymnasium", "gym")
    from logicity.learn import fold_rm, popper, symbolic

    cls: Any = {
        "induce": symbolic.InduceLearner,
        "popper": popper.PopperLearner,
        "maxsynth": popper.MaxSynthLearner,
        "foldrm": fold_rm.FoldRMLearner,
    }[algorithm]
    config = SimpleNamespace(
        algorithm=algorithm,
        mode=mode,
        settings=cls.settings_class(**settings),
        steps=1,
        seed=0,
        threads=1,
        demonstrations=share,
        overrides={},
    )
    return cls(config)


def trained(*arguments: Any, **settings: Any) -> Any:
    result = learner(*arguments, **settings)
    calls: list[int] = []
    result.fit(1, lambda: calls.append(result.steps))
    assert calls == [1]
    return result


def test_induced_rules_are_a_policy(tmp_path: Path) -> None:
    first = learner("induce")
    assert first.steps == 0
    width = first.policy().width
    assert first.policy()(np.zeros((2, width))).tolist() == [1, 1]
    first.save(tmp_path)
    first.restore(tmp_path)
    assert first.steps == 0
    first = trained("induce")
    first.save(tmp_path)
    again = learner("induce")
    again.restore(tmp_path)
    assert again.steps == 1
    again.fit(1, lambda: pytest.fail("it has learned"))
    policy = again.policy()
    policy.save(tmp_path / "best.dl")
    loaded = type(policy).load(tmp_path / "best.dl")
    assert loaded.text == first.policy().text == trained("induce").policy().text
    induced = logicity.induce(logicity.demonstrations("easy"))
    observations = random_observations("easy", 200, seed=5)
    assert (loaded(observations) == induced(observations)).all()
    assert Benchmark("easy", "val").evaluate(loaded).tsr.value == 1.0
    with pytest.raises(ValueError, match="has rules of `induce` for easy, not of `foldrm` for easy"):
        learner("foldrm").restore(tmp_path)


@pytest.mark.parametrize("algorithm", ["induce", "popper", "maxsynth", "foldrm"])
@pytest.mark.parametrize("mode", PLAIN)
def test_training_files_have_valid_settings(algorithm: str, mode: str) -> None:
    path = ROOT / "configs" / "baselines" / f"{algorithm}-{mode}.yaml"
    values = ConfigFile(path, "configs/baselines").value()
    assert (values["algorithm"], values["mode"], values["steps"]) == (algorithm, mode, 1)
    learner(algorithm, mode, **values["settings"])


@pytest.mark.parametrize(
    ("name", "low", "high", "outside"),
    [("variables", 2, 7, (1, 8)), ("effort", 1, 2**32 - 1, (0, 2**32)), ("noise", 0.0, 0.4, (-0.1, 0.5, "outo"))],
)
def test_settings_of_induce_have_the_bounds_of_the_command(
    name: str, low: float, high: float, outside: tuple[Any, ...]
) -> None:
    def check(value: Any) -> None:
        settings: dict[str, Any] = {name: value}
        learner("induce", **settings)

    for value in (low, high):
        check(value)
    for value in outside:
        with pytest.raises(ValueError, match=name):
            check(value)
    assert learner("induce", noise="auto").config.settings.noise == "auto"


# --- FOLD-RM


def slow_pattern(pattern: Any, atoms: Sequence[Atom], observation: NDArray[np.float32]) -> bool:
    """Evaluate a pattern with loops over all assignments of its variables."""
    facts = {atom for atom, value in zip(atoms, observation, strict=True) if value > 0.5}
    entities = range(5)
    return any(
        all((name, tuple((0, y, z)[variable] for variable in variables)) in facts for name, variables in pattern.atoms)
        for y in entities
        for z in entities
    )


def test_patterns_equal_loops_over_entities() -> None:
    needs("torch", "learn")
    from logicity.learn.fold_rm import FoldRMSettings, Relations, patterns

    atoms = atoms_in("hard")
    observations = random_observations("hard", 12, seed=6)
    relations = Relations.of(atoms, observations)
    known = patterns(atoms, FoldRMSettings(atoms=3, pairs=True))
    unary, directed = 11, 11 + 2 * 6
    sizes = directed + directed * (directed - 1) // 2 + directed * (directed - 1) * (directed - 2) // 6
    assert len(known) == unary + sizes + unary * 6 * unary
    for pattern in known[::17]:
        expected = [slow_pattern(pattern, atoms, observation) for observation in observations]
        assert relations.holds(pattern).tolist() == expected, pattern


def test_rules_of_foldrm_decide_as_the_package() -> None:
    needs("foldrm", "learn")
    from foldrm.algo import classify, foldrm

    from logicity.learn.fold_rm import FoldRMSettings, Relations, patterns, rule_file

    atoms = atoms_in("expert")
    observations = random_observations("expert", 260, seed=7)
    known = patterns(atoms, FoldRMSettings(atoms=1, pairs=False))
    relations = Relations.of(atoms, observations)
    columns = np.array([relations.holds(pattern) for pattern in known])
    labels = RulePolicy(mode_rules("expert"), "expert")(observations)
    rows = [
        [*("1" if value else "0" for value in row), ACTIONS[label]]
        for row, label in zip(columns.T.tolist(), labels, strict=True)
    ]
    learned = foldrm(rows[:200], ratio=0.5)
    assert len(learned) > 4 and any(exceptions for _, _, exceptions, _ in learned)
    text = rule_file(learned, known, "Normal")
    assert [fault for fault in logicity.check(text) if fault["severity"] == "error"] == []
    expected = [ACTIONS.index(classify(learned, row) or "Normal") for row in rows]
    assert RulePolicy.from_text(text, "expert")(observations).tolist() == expected


def test_foldrm_learns_easy_rules() -> None:
    needs("foldrm", "learn")
    result = trained("foldrm", share=0.6)
    assert result.policy().text.startswith("// logicity policy 1: foldrm, easy\n")
    assert Benchmark("easy", "val").evaluate(result.policy()).tsr.value == 1.0


# --- Popper


def fake_popper(folder: Path, code: str) -> list[str]:
    """Write a program in place of Popper: Python code that knows the folder of the task and the other arguments."""
    if sys.platform == "win32":
        pytest.skip("Windows does not run scripts by their first line")
    path = folder / "popper"
    path.write_text(f"#!{sys.executable}\nimport os, sys, time\ntask, *rest = sys.argv[1:]\n{textwrap.dedent(code)}")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return [str(path)]


#: What Popper prints, with the rules of easy mode.
EASY = """
    print("0.1s Generating programs of size: 3", file=sys.stderr)
    print("*" * 10 + " SOLUTION " + "*" * 10)
    print("Precision:1.00 Recall:1.00 TP:401 FN:0 TN:748 FP:0 Size:12")
    print("stop(V0):- colliding_close(V0,V1).")
    print("stop(V0):- is_at_inter(V0),is_in_inter(V1),sees(V0,V1).")
    print("stop(V0):- is_at_inter(V0),is_at_inter(V1),higher_pri(V1,V0).")
    print("*" * 30)
"""


def test_popper_rules_become_a_policy(tmp_path: Path) -> None:
    check = """
        files = {name: open(os.path.join(task, name)).read() for name in ("bk.pl", "exs.pl", "bias.pl")}
        assert "head_pred(stop,1)." in files["bias.pl"] and "body_pred(is_car,1)." in files["bias.pl"]
        assert "pos(stop(s" in files["exs.pl"] and "neg(stop(s" in files["exs.pl"]
        assert ("not_is_old(s0_e0)." in files["bk.pl"]) == ("body_pred(not_is_car,1)." in files["bias.pl"]) == NEGATED
        assert ("max_vars(4)." in files["bias.pl"]) == NEGATED
        assert rest == EXPECTED, rest
    """
    for algorithm, extra, settings in (
        ("popper", [], {}),
        ("maxsynth", ["--noisy"], {"negated": True, "max_vars": 4}),
    ):
        # By default half of the time is for positive literals.
        expected = ["--timeout", "300" if settings else "150", *extra, "--max-body", "4"]
        code = textwrap.dedent(check).replace("EXPECTED", repr(expected)).replace("NEGATED", repr(bool(settings)))
        program = fake_popper(tmp_path, code + textwrap.dedent(EASY))
        result = trained(algorithm, share=0.2, program=program, arguments=["--max-body", "4"], **settings)
        policy = result.policy()
        assert "Stop(X) :- Sees(X, X)" not in policy.text
        assert "Stop(X) :- IsAtInter(X), IsAtInter(Y), HigherPri(Y, X)." in policy.text
        observations = random_observations("easy", 200, seed=8)
        assert (policy(observations) == RulePolicy(mode_rules("easy"), "easy")(observations)).all()
        assert Benchmark("easy", "val").evaluate(policy).tsr.value == 1.0
        (search,) = result.outcome()["searches"]
        assert search["negated"] == bool(settings)
        assert (search["optimal"], search["timed_out"], search["failure"]) == (True, False, "")
        assert search["true_positives"] == search["positive"] > 0 == search["false_positives"] < search["negative"]


#: Prints a program after the time limit, with counts that are not true.
LATE = """
    print("TIMEOUT OF 150 SECONDS EXCEEDED", file=sys.stderr)
    print("*" * 10 + " SOLUTION " + "*" * 10)
    print("Precision:1.00 Recall:1.00 TP:706 FN:0 TN:985 FP:0 Size:3")
    print("stop(V0):- is_at_inter(V0),sees(V0,V1),is_at_inter(V1).")
    print("*" * 30)
"""


def test_examples_are_counted_and_negated_literals_follow_where_needed(tmp_path: Path) -> None:
    by_sign = (
        'if "not_is_car" not in open(os.path.join(task, "bias.pl")).read():'
        f"{textwrap.indent(textwrap.dedent(LATE), '    ')}else:{textwrap.indent(textwrap.dedent(EASY), '    ')}"
    )
    result = trained("popper", share=0.1, program=fake_popper(tmp_path, by_sign))
    (search,) = result.outcome()["searches"]
    assert (search["negated"], search["timed_out"], search["optimal"]) == (True, True, True)
    assert (search["true_positives"], search["false_positives"]) == (search["positive"], 0)
    # The same wrong program, with literals that a setting fixes.
    result = trained("popper", share=0.1, program=fake_popper(tmp_path, LATE), negated=False)
    (search,) = result.outcome()["searches"]
    assert (search["negated"], search["timed_out"], search["optimal"]) == (False, True, False)
    data = logicity.demonstrations("easy", 10)
    seen = {(observation.tobytes(), int(action)): observation for observation, action in data.examples()}
    rule = tmp_path / "rule.dl"
    rule.write_text('.include "vocabulary.dl"\nStop(X) :- IsAtInter(X), IsAtInter(Y).\n')
    decided = inferred("easy", np.stack(list(seen.values())), rule)
    stop = ACTIONS.index("Stop")
    derived = [taken == stop for (_, taken), action in zip(seen, decided, strict=True) if action == stop]
    counts = {"true_positives": sum(derived), "false_positives": len(derived) - sum(derived)}
    assert counts["true_positives"] > 0 and counts["false_positives"] > 0
    assert {name: search[name] for name in counts} == counts
    assert search["positive"] + search["negative"] == len(seen)
    text = result.policy().text
    assert f"1 clauses derive {counts['true_positives']} of {search['positive']} examples" in text
    assert "; time-out after " in text
    # The searches are part of a checkpoint.
    result.save(tmp_path)
    again = learner("popper", share=0.1)
    again.restore(tmp_path)
    assert again.outcome() == result.outcome()


def test_a_failing_search_does_not_lose_the_others(tmp_path: Path) -> None:
    code = """
        if os.path.basename(task) == "slow":
            sys.exit("no memory is left")
        if os.path.basename(task) == "fast":
            print("TIMEOUT OF 300 SECONDS EXCEEDED")
        else:
            print("*" * 10 + " SOLUTION " + "*" * 10, "stop(V0):- is_at_inter(V0),is_old(V0).", "*" * 30, sep="\\n")
    """
    result = learner("popper", "expert", share=0.05, program=fake_popper(tmp_path, code), negated=True)
    said: list[str] = []
    result.say = said.append
    result.fit(1, lambda: None)
    text = result.policy().text
    assert "Stop(X) :- IsAtInter(X), IsOld(X)." in text
    by_action = {search["action"]: search for search in result.outcome()["searches"]}
    assert "exit code 1: no memory is left" in by_action["Slow"]["failure"]
    assert by_action["Fast"]["timed_out"] and not by_action["Fast"]["clauses"]
    for part in ("Slow: failed after ", "Fast: time-out: no rules after ", "Stop: 1 clauses derive "):
        assert sum(part in line for line in said) == 1, said
        assert f"// {part}" in text


def test_a_running_search_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    needs("torch", "learn")
    from logicity.learn import popper

    monkeypatch.setattr(popper, "INTERVAL", 0.2)
    # The program goes on when a line has told what it printed.
    told = tmp_path / "told"
    log = f"""
        print("0.1s Generating partial hypotheses of size: 3", file=sys.stderr, flush=True)
        while not os.path.exists({str(told)!r}):
            time.sleep(0.05)
    """
    result = learner("popper", share=0.1, program=fake_popper(tmp_path, textwrap.dedent(log) + textwrap.dedent(EASY)))
    said: list[str] = []

    def say(line: str) -> None:
        said.append(line)
        if line.endswith("; 0.1s Generating partial hypotheses of size: 3"):
            told.touch()

    result.say = say
    result.fit(1, lambda: None)
    *running, ended = said
    assert running and all(line.startswith("popper, Stop, positive literals: ") for line in running)
    assert all(" of 150 s" in line for line in running)
    assert "; optimal after " in ended


def test_written_tasks_of_popper_have_the_rules_as_solution(tmp_path: Path) -> None:
    """Our reader of Popper's format learns from the files, and our reader of Popper's output reads what it learns."""
    needs("gymnasium", "gym")
    needs("torch", "learn")
    from logicity.learn.popper import read_output

    logicity.demonstrations("easy", 40).to_popper(tmp_path, distinct=True)
    solution = tmp_path / "solution.pl"
    arguments = ["induce", "--popper", str(tmp_path / "stop"), "--variables", "2", "-o", str(solution)]
    code, words, _ = logicity._logicity.run_command_line(arguments)
    assert (code, words) == (0, [])
    clauses = [line for line in solution.read_text().splitlines() if ":-" in line]
    printed = "\n".join(["*" * 10 + " SOLUTION " + "*" * 10, *clauses, "*" * 30])
    predicates = {name: len(entities) for name, entities in atoms_in("easy")}
    text = "\n".join(['.include "vocabulary.dl"', *read_output(printed, "Stop", predicates).clauses])
    policy = RulePolicy.from_text(text, "easy")
    for trajectory in logicity.demonstrations("easy", 40):
        assert policy(trajectory.observations[:-1]).tolist() == trajectory.actions.tolist()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("stop(A):- is_car(A).", "Stop(X) :- IsCar(X)."),
        ("stop(V0):- not_is_car(V0),higher_pri(V2,V0),not_is_old(V2).",
         "Stop(X) :- Not(IsCar(X)), HigherPri(Y, X), Not(IsOld(Y))."),
        ("stop(V0):-not_is_car(V0)", "Stop(X) :- Sees(X, X), Not(IsCar(X))."),
        ("stop(V0):- sees(V0,V1),not_is_car(V1).", "Stop(X) :- Sees(X, X), Sees(X, Y), Not(IsCar(Y))."),
        # `sees(V1,V2)` holds only for the ego V1.
        ("stop(V0):- is_old(V0),sees(V1,V2),higher_pri(V1,V2).", "Stop(X) :- IsOld(X), HigherPri(X, Y)."),
        ("stop(V0):- is_old(V0),higher_pri(V3,V9),higher_pri(V9,V0),is_car(V5),higher_pri(V5,V0).",
         "Stop(X) :- IsOld(X), HigherPri(Y, Z), HigherPri(Z, X), IsCar(V3), HigherPri(V3, X)."),
        ("stop(V0):- sees(V0,V1).", "Stop(X) :- Sees(X, X)."),
    ],
)  # fmt: skip
def test_clauses_of_popper_are_translated(line: str, expected: str) -> None:
    needs("torch", "learn")
    from logicity.learn.popper import read_output

    predicates = {name: len(entities) for name, entities in atoms_in("easy")}
    printed = (
        f"*** SOLUTION ***\n********** SOLUTION **********\nPrecision:n/a\n{line}\n{'*' * 30}\nstop(V0):- x(V0).\n"
    )
    assert read_output(printed, "Stop", predicates) == ((expected,), False)
    errors = [
        fault for fault in logicity.check(f'.include "vocabulary.dl"\n{expected}') if fault["severity"] == "error"
    ]
    assert errors == []


def test_names_in_popper_files_are_reversible() -> None:
    predicates = {name: len(entities) for name, entities in atoms_in("expert")}
    names = popper_names(predicates)
    assert len(names) == 2 * len(predicates)
    assert names["not_is_at_inter"] == (True, "IsAtInter", 1)
    assert names["next_to"] == (False, "NextTo", 2)


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("NO SOLUTION\n", "popper says that no rules within its limits explain Stop: raise `max_vars`"),
        (
            "12:00:01 TIMEOUT OF 300 SECONDS EXCEEDED\n",
            "time-out: popper found no rules for Stop within 300 seconds: raise `timeout`, or lower `max_vars`",
        ),
    ],
)
def test_no_solution_is_no_row_of_zeros(output: str, message: str, tmp_path: Path) -> None:
    result = learner("popper", share=0.02, program=fake_popper(tmp_path, f"print({output!r})"))
    with pytest.raises(ValueError, match=message):
        result.fit(1, lambda: None)
    assert result.steps == 0


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "sys.exit(\"ModuleNotFoundError: No module named 'janus_swi'\")",
            "exit code 1: ModuleNotFoundError: No module",
        ),
        ('print("hello")', "has no solution: hello; Popper 5 needs Python >= 3.14 and SWI-Prolog >= 9.2"),
        ("pass", "has no solution: it printed nothing"),
        ("os.kill(os.getpid(), 9)", "exit code 137: it printed nothing"),
        ('print("****** SOLUTION ******\\nnothing\\n" + "*" * 30)', "has no clause"),
        ('print("****** SOLUTION ******\\nstop(V0):- is_bus(V0).\\n" + "*" * 30)', "not of this task"),
        ('print("****** SOLUTION ******\\nslow(V0):- is_car(V0).\\n" + "*" * 30)', "not of this task"),
        ('print("****** SOLUTION ******\\nstop(V0):- is_car(V0,V1).\\n" + "*" * 30)', "not of this task"),
        ('print("****** SOLUTION ******\\nstop(V0):- is_car([V0|V1]).\\n" + "*" * 30)', "not understood"),
        ('print("****** SOLUTION ******\\nstop(V0):- f(g(V0)).\\n" + "*" * 30)', "not understood"),
    ],
)
def test_failures_of_popper_are_clear(code: str, message: str, tmp_path: Path) -> None:
    result = learner("popper", share=0.02, program=fake_popper(tmp_path, code))
    with pytest.raises(ChildProcessError) as raised:
        result.fit(1, lambda: None)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert result.steps == 0


def test_missing_popper_names_the_versions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    expected = (
        "there is no command `popper-ilp` or `popper`; Popper 5 needs Python >= 3.14 and SWI-Prolog >= 9.2; "
        "install it, or name its command under `settings.program`"
    )
    with pytest.raises(FileNotFoundError, match=expected):
        learner("maxsynth").rules(None)
    with pytest.raises(FileNotFoundError, match="there is no command `/none/popper`"):
        learner("popper", program=["/none/popper"]).rules(None)


def test_popper_that_does_not_stop_is_killed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    needs("torch", "learn")
    from logicity.learn import popper

    monkeypatch.setattr(popper, "GRACE", 1.5)
    child = "import os, subprocess\nsubprocess.Popen(['sleep', '100'])\n"
    log = """
        print("********************", "New best hypothesis:", "stop(V0):- is_old(V0).", sep="\\n", file=sys.stderr)
        print("********************", "0.2s New best hypothesis:", "tp:1 fn:0 size:2", sep="\\n", file=sys.stderr)
        print("0.2s stop(V0):- is_car(V0).", "0.2s ********************", sep="\\n", file=sys.stderr, flush=True)
        time.sleep(100)
    """
    program = fake_popper(tmp_path, child + textwrap.dedent(log))
    result = trained("popper", share=0.02, program=program, timeout=0.5, negated=False)
    assert "Stop(X) :- IsCar(X)." in result.policy().text
    assert result.outcome()["searches"][0]["timed_out"]
    program = fake_popper(tmp_path, f"{child}time.sleep(100)")
    with pytest.raises(ValueError, match=r"time-out: popper found no rules for Stop within 0\.5 seconds"):
        trained("popper", share=0.02, program=program, timeout=0.5, negated=False)


@pytest.mark.parametrize("algorithm", ["popper", "maxsynth", "foldrm"])
def test_learners_of_rules_refuse_quantities(algorithm: str, patience: str) -> None:
    with pytest.raises(ValueError, match=f"`{algorithm}` learns from truth values, but .* the quantity `Waited`"):
        learner(algorithm, patience)
