"""Probabilities of clauses from demonstrations, compared with the drivers who gave them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

import logicity
from logicity import Inference

torch = needs("torch", "learn")
from logicity.torch import learn_weights  # noqa: E402

#: The rules of easy mode, which drivers follow only sometimes.
DRIVER = """
.include "vocabulary.dl"
0.9 :: Stop(X) :- IsAtInter(X), IsInInter(Y).
0.6 :: Stop(X) :- IsAtInter(X), IsAtInter(Y), HigherPri(Y, X).
0.95 :: Stop(X) :- CollidingClose(X, Y).
"""


def demonstrated(folder: Path, text: str, split: str, n: int = 40) -> logicity.Demonstrations:
    """Return demonstrations of drivers with these rules."""
    path = folder / "driver.dl"
    path.write_text(text, encoding="utf-8")
    return logicity.demonstrations("easy", n, split, overrides={"rules": str(path)})


def test_weights_are_those_of_the_driver(tmp_path: Path) -> None:
    train, held_out = (demonstrated(tmp_path, DRIVER, split) for split in ("train", "val"))
    told: list[tuple[int, float]] = []
    rules = learn_weights("rules/easy.dl", train, progress=lambda number, value: told.append((number, value)))
    expected = {"S1": 0.9, "S2": 0.6, "S7": 0.95}
    assert rules.weights.keys() == expected.keys()
    assert all(abs(rules.weights[name] - expected[name]) < 0.1 for name in expected), rules.weights
    assert rules.slip < 0.02 < rules.crisp_slip
    assert rules.steps == sum(map(len, train))
    assert [number for number, _ in told] == list(range(1, 301)) and told[-1][1] > told[0][1]
    soft, crisp = (rules.log_likelihood(held_out, crisp=crisp) for crisp in (False, True))
    assert soft > crisp + 0.03
    # The training did not end before its maximum.
    again = learn_weights("rules/easy.dl", train, iterations=900)
    assert abs(again.log_likelihood(train) - rules.log_likelihood(train)) < 1e-3


def test_likelihoods_are_those_of_the_written_rules(tmp_path: Path) -> None:
    train = demonstrated(tmp_path, DRIVER, "train", 10)
    rules = learn_weights("rules/easy.dl", train, iterations=40)
    path = tmp_path / "learned.dl"
    path.write_text("// mine\n", encoding="utf-8")
    with pytest.raises(OSError, match=re.escape("learned.dl")):
        rules.save(path)
    rules.save(path, overwrite=True)
    rules.save(path)
    inference = Inference("easy", rules=path)
    for trajectory in train[:3]:
        total = 0.0
        one = replace(train, trajectories=(trajectory,))
        for observation, action in zip(trajectory.observations, trajectory.actions, strict=False):
            facts: dict[str, Any] = {}
            for number, (name, row) in zip(observation, train.atoms, strict=False):
                if number:
                    facts.setdefault(name, []).append([f"e{entity}" for entity in row])
            count = 1 + max(int(name[1:]) for rows in facts.values() for row in rows for name in row)
            scene: Any = {"entities": [f"e{each}" for each in range(count)], "ego": "e0", "facts": facts}
            found: Any = inference.marginals(scene)["egos"]["e0"]["action"]
            by_rules = found.get(logicity.ACTIONS[action], 0.0)
            total += np.log((1 - rules.slip) * by_rules + rules.slip / 4)
        assert rules.log_likelihood(one) == pytest.approx(total / len(trajectory), abs=1e-9)


def test_given_and_unused_probabilities_stay(tmp_path: Path) -> None:
    train = demonstrated(tmp_path, DRIVER, "train", 10)
    given = tmp_path / "given.dl"
    given.write_text(
        '.include "other.dl"\n.include "vocabulary.dl"\n'
        "/// G: given\n0.5 :: Stop(X) :- IsAtInter(X), IsInInter(Y).\n"
        "/// U: no driver is one\nStop(X) :- IsPedestrian(X). /// T: two on a line\nStop(X) :- CollidingClose(X, Y).\n",
        encoding="utf-8",
    )
    other = '.include "vocabulary.dl"\n/// N: new\nStop(X) :- IsAtInter(X), IsAtInter(Y), HigherPri(Y, X).\n'
    (tmp_path / "other.dl").write_text(other, encoding="utf-8")
    rules = learn_weights(given, train, iterations=30)
    assert rules.weights.keys() == {"N", "T"}
    assert "\n0.5 :: Stop(X) :- IsAtInter(X), IsInInter(Y)." in rules.text
    assert "\nStop(X) :- IsPedestrian(X)." in rules.text
    assert f"\n{rules.weights['N']:.4f} :: Stop(X) :- IsAtInter(X), IsAtInter(Y)" in rules.text
    assert f"\n{rules.weights['T']:.4f} :: Stop(X) :- CollidingClose(X, Y)." in rules.text
    # All in one file, except for the vocabulary.
    assert "other.dl" not in rules.text and '.include "vocabulary.dl"' in rules.text
    assert rules.program.predicates


def test_probabilities_reach_every_form_of_include(tmp_path: Path) -> None:
    train = demonstrated(tmp_path, DRIVER, "train", 10)
    (tmp_path / "mine.dl").write_bytes(
        '\ufeff.include "easy.dl"\r\n/// E: one more\r\nStop(X) :- IsInInter(X), IsAtInter(Y).\r\n'.encode()
    )
    rules = learn_weights(tmp_path / "mine.dl", train, iterations=30)
    assert rules.weights.keys() == {"S1", "S2", "S7", "E"}
    assert rules.text.count(" :: Stop(X)") == 4 and "easy.dl" not in rules.text
    mine = tmp_path / "blocks.dl"
    mine.write_text('/* .include "easy.dl" */ .include "easy.dl"\n', encoding="utf-8")
    with pytest.raises(ValueError, match="on a line of its own"):
        learn_weights(mine, train, iterations=1)


def test_clauses_that_a_file_cannot_weigh_are_refused(tmp_path: Path) -> None:
    train = demonstrated(tmp_path, DRIVER, "train", 10)
    for clause, message in (
        ("Stop(X) :- IsAtInter(X), (IsInInter(X) ; CollidingClose(X, Y)).", "several heads or alternatives"),
        ("Stop(X), Slow(X) :- CollidingClose(X, Y).", "several heads or alternatives"),
        ("Stop(X) :- CollidingClose(X, _).", "name all variables"),
        ("Stop(X) :- CollidingClose(X, _Y).", "name all variables"),
    ):
        path = tmp_path / "refused.dl"
        path.write_text(f'.include "vocabulary.dl"\n{clause}\n', encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            learn_weights(path, train, iterations=1)
    path.write_text('.include "vocabulary.dl"\nStop(X) :- IsAtInter(X), Not(HigherPri(X, _)).\n', encoding="utf-8")
    learn_weights(path, train, iterations=1)
    busy = "Busy(x: agent) inline\nBusy(X) :- IsAtInter(X), IsInInter(Y).\nStop(X) :- Busy(X).\n"
    for text, message in (
        (f'.include "vocabulary.dl"\n.decl {busy}', "cannot be written as one file: .*inline"),
        ('.include "vocabulary.dl"\nStop("Car_1").\n', "is a fact about constants"),
        ('.include "vocabulary.dl"\n0.5 :: Stop(X) :- IsInInter(X).\n', "there is none to weigh"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            learn_weights(path, train, iterations=1)
    alone = ".type agent <: symbol\n.decl IsAtInter, Stop, Normal(x: agent)\n.input IsAtInter\n"
    path.write_text(f"{alone}/// A: alone\nStop(X) :- IsAtInter(X).\n", encoding="utf-8")
    assert learn_weights(path, train, iterations=1).weights.keys() == {"A"}
    path.write_text('.include "vocabulary.dl"\nStop(X) :- IsInInter(X).\n', encoding="utf-8")
    # The default of the vocabulary is then a clause like others.
    assert "N" in learn_weights(path, train, iterations=1, default="Slow").weights
    with pytest.raises(TypeError, match="expected those of `logicity.demonstrations`"):
        learn_weights(path, [])  # type: ignore[arg-type]
    one = tmp_path / "one.dl"
    text = '.include "vocabulary.dl"\n/// A: same\n1.0 :: Stop(X) :- IsAtInter(X), IsInInter(Y).\n'
    same = "/// B: same\nStop(X) :- CollidingClose(X, Y).\n/// B: same\nStop(X) :- IsInInter(X), IsInInter(Y).\n"
    one.write_text(text + same, encoding="utf-8")
    rules = learn_weights(one, train, iterations=5)
    assert [name.partition(" (")[0] for name in rules.weights] == ["B", "B"]
    assert "\n1.0 :: Stop(X) :- IsAtInter(X), IsInInter(Y)." in rules.text


def test_rules_may_read_earlier_ticks(tmp_path: Path) -> None:
    text = '.include "vocabulary.dl"\n/// P: just came\n0.7 :: Stop(X) :- IsInInter(X), once[1,3] IsAtInter(X).\n'
    train = demonstrated(tmp_path, text, "train")
    crisp = tmp_path / "crisp.dl"
    crisp.write_text(text.replace("0.7 :: ", ""), encoding="utf-8")
    rules = learn_weights(crisp, train, iterations=120)
    assert rules.weights.keys() == {"P"} and abs(rules.weights["P"] - 0.7) < 0.1
    assert rules.log_likelihood(train) > rules.log_likelihood(train, crisp=True)


def test_faulty_arguments_are_reported(tmp_path: Path) -> None:
    train = demonstrated(tmp_path, DRIVER, "train", 2)
    with pytest.raises(ValueError, match="iterations: expected at least 1"):
        learn_weights("rules/easy.dl", train, iterations=0)
    with pytest.raises(ValueError, match="learning_rate: expected a positive number"):
        learn_weights("rules/easy.dl", train, learning_rate=-1)
    with pytest.raises(ValueError, match="there are no steps"):
        learn_weights("rules/easy.dl", replace(train, trajectories=()))
    with pytest.raises(ValueError, match="the observations lack `IsBus`"):
        learn_weights("rules/expert.dl", train)
    with pytest.raises(ValueError, match="the action Normal is not among those of the rules"):
        learn_weights("rules/easy.dl", train, priority=["Stop"], default="Slow")
    states = logicity.demonstrations("easy", 1, observation="state")
    with pytest.raises(ValueError, match="observations of the kind `groundings`"):
        learn_weights("rules/easy.dl", states)
