"""Exact probabilities: sessions and inference against ProbLog, by hand, and with faulty arguments."""

from __future__ import annotations

import random

import pytest

import logicity
from logicity.rules import Row

problog = pytest.importorskip("problog")
from problog import get_evaluatable  # noqa: E402
from problog.eval_nodes import NegativeCycle  # noqa: E402
from problog.program import PrologString  # noqa: E402

DECLARED = """.decl n(x: symbol) .input n
.decl e(x: symbol, y: symbol) .input e
.decl a(x: symbol)
.decl b(x: symbol)
.decl c(x: symbol, y: symbol)
.decl d(x: symbol)
"""
SYMBOLS = ("u", "v", "w")
PROGRAMS = 300


def clause(random: random.Random, heads: list[str], literals: list[str]) -> str:
    """Return a clause in the notation that both systems share, except that `~` is negation."""
    chosen = [random.choice(heads)]
    numbers = [random.choice(["0.3", "0.5", "0.9"])]
    if random.random() < 0.25:
        chosen.append(random.choice(heads))
        numbers = ["0.2", "0.5"]
    drawn = random.random() < 0.7 or len(chosen) > 1
    head = "; ".join(f"{p} :: {name}" for p, name in zip(numbers, chosen, strict=True)) if drawn else chosen[0]
    body = [random.choice(["n(X)", "e(X, Y)", "e(Y, X)"]), *random.sample(literals, random.randrange(3))]
    if "Y" in head + "".join(body) and not any(atom in body for atom in ("e(X, Y)", "e(Y, X)")):
        body.append("n(Y)")
    # ProbLog tests negated atoms where they stand.
    return f"{head} :- {', '.join(sorted(body, key=lambda atom: atom.startswith('~')))}."


def program(random: random.Random) -> str:
    """Return clauses in two strata, with recursion in each and negation between them."""
    low = [clause(random, ["a(X)", "c(X, Y)"], ["a(Y)", "c(X, Y)", "c(Y, X)"]) for _ in range(random.randint(1, 3))]
    high = [
        clause(random, ["b(X)", "d(X)"], ["~a(X)", "~c(X, Y)", "b(Y)", "d(X)", "a(Y)"])
        for _ in range(random.randint(1, 3))
    ]
    return "\n".join(low + high) + "\n"


def facts(random: random.Random) -> dict[str, list[tuple[tuple[str, ...], float]]]:
    """Return random facts, each certain or not."""
    chosen: dict[str, list[tuple[tuple[str, ...], float]]] = {"n": [], "e": []}
    for x in SYMBOLS:
        if random.random() < 0.7:
            chosen["n"].append(((x,), random.choice([1.0, 0.4])))
        for y in SYMBOLS:
            if random.random() < 0.3:
                chosen["e"].append(((x, y), random.choice([1.0, 0.75])))
    return chosen


def by_problog(text: str, given: dict[str, list[tuple[tuple[str, ...], float]]]) -> dict[str, float]:
    """Return the probabilities of all derived atoms by ProbLog."""
    # Without a clause, ProbLog calls a predicate unknown.
    lines = ["0.0::a(none). 0.0::b(none). 0.0::c(none, none). 0.0::d(none). 0.0::n(none). 0.0::e(none, none)."]
    for name, rows in given.items():
        lines += [f"{p}::{name}({', '.join(row)})." for row, p in rows]
    lines += [text.replace("~", "\\+ "), "query(a(X)). query(b(X)). query(c(X, Y)). query(d(X))."]
    found = get_evaluatable().create_from(PrologString("\n".join(lines))).evaluate()
    return {str(term).replace(" ", ""): p for term, p in found.items() if "none" not in str(term)}


def test_probabilities_are_those_of_problog() -> None:
    """The probabilities of 300 random programs with negation, recursion and alternatives equal those of ProbLog."""
    positive, seed, compared = 0, 0, 0
    while compared < PROGRAMS:
        seed += 1
        draw = random.Random(seed)
        text, given = program(draw), facts(draw)
        session = logicity.Session(logicity.Program(DECLARED + text.replace("~", "not ")))
        session.commit()
        found = session.marginals("a", "b", "c", "d", uncertain=given)
        assert found.because is None
        ours = {f"{name}({','.join(map(str, row))})": p for name, rows in found.rows.items() for row, p in rows.items()}
        try:
            theirs = by_problog(text, given)
        except NegativeCycle:
            # ProbLog looks for these among goals, and finds some in stratified programs.
            continue
        compared += 1
        for atom in ours.keys() | theirs.keys():
            assert ours.get(atom, 0.0) == pytest.approx(theirs.get(atom, 0.0), abs=1e-9), (seed, atom, text, given)
        positive += sum(0 < p < 1 for p in ours.values())
    assert positive > PROGRAMS
    assert compared > seed // 2


def test_marginals_are_exact_or_say_why_not() -> None:
    """Small formulas are exact. An aggregate over uncertain rows gives estimates with intervals."""
    program = logicity.Program(
        """.decl coin(x: symbol) .input coin
        .decl heads(x: symbol)
        .decl count(n: number)
        0.5 :: heads(x) :- coin(x).
        count(n) :- n = count : { heads(_) }.
        """
    )
    session = logicity.Session(program, seed=3)
    session.insert("coin", [("penny",), ("dime",)])
    session.commit()
    exact = session.marginals("heads", uncertain={"coin": [(("dime",), 0.5)]})
    assert exact == logicity.Marginals({"heads": {("penny",): 0.5, ("dime",): 0.25}}, None, None)
    estimate = session.marginals("count", samples=4000)
    assert estimate.because is not None and estimate.intervals is not None
    for count, expected in [(0, 0.25), (1, 0.5), (2, 0.25)]:
        low, high = estimate.intervals["count"][(count,)]
        assert low <= estimate.rows["count"][(count,)] <= high
        assert low - 0.02 < expected < high + 0.02
    with pytest.raises(ValueError, match="expected 0 to 1"):
        session.marginals("heads", uncertain={"coin": [(("dime",), 1.5)]})
    with pytest.raises(KeyError, match="head"):
        session.marginals("head")


def test_draws_follow_the_seed_and_the_tick() -> None:
    """Equal seeds and ticks draw equally, and other ticks otherwise."""
    program = logicity.Program(".decl n(x: number) .input n .decl a(x: number) 0.5 :: a(x) :- n(x).")

    def run(seed: int) -> list[list[Row]]:
        session = logicity.Session(program, seed=seed)
        session.insert("n", [(x,) for x in range(64)])
        session.commit()
        drawn = [list(session.rows("a"))]
        for _ in range(3):
            session.advance()
            drawn.append(list(session.rows("a")))
        return drawn

    assert run(1) == run(1) != run(2)
    assert len({tuple(rows) for rows in run(1)}) == 4


def test_scenes_may_be_uncertain() -> None:
    """`Inference.marginals` gives what the rules derive, and what the ego does."""
    inference = logicity.Inference("configs/easy.yaml")
    facts = {
        "IsCar": ["me", "you"],
        "IsAtInter": [{"row": "me", "probability": 0.7}],
        "IsInInter": [{"row": ["you"], "probability": 0.5}],
    }
    scene = {"entities": ["me", "you"], "ego": "me", "facts": facts}
    answer = inference.marginals(scene)  # type: ignore[arg-type]
    assert answer["exact"] and answer["egos"]["me"]["action"] == pytest.approx({"Stop": 0.35, "Normal": 0.65})
    with pytest.raises(logicity.InputError, match="ask for probabilities"):
        inference.answer(scene)  # type: ignore[arg-type]
