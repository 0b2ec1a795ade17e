"""Programs and sessions: conversion of rows, errors, explanations, and cancellation."""

from __future__ import annotations

import copy
import pickle
import random
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Interrupt, needs

import logicity
from logicity import InputError, LimitError, Program, Session

PATH = """
.decl edge(x: symbol, y: symbol)
.input edge
/// Where one can go.
.decl path(x: symbol, y: symbol)
.output path
/// P1: a step
path(x, y) :- edge(x, y).
/// P2: a step more
path(x, z) :- path(x, y), edge(y, z).
"""

ALL = """
.decl all(s: symbol, n: number, u: unsigned, f: float)
.input all
.decl flag()
.input flag
.decl copy(s: symbol, n: number, u: unsigned, f: float)
copy(s, n, u, f) :- all(s, n, u, f), flag().
"""

ENDLESS = (
    ".decl n(x: number)\n.decl seed(x: number)\n.input seed\nn(x) :- seed(x).\nn((x + 1) band 2147483647) :- n(x).\n"
)


def session(text: str, **options: int) -> Session:
    return Session(Program(text, "test.dl"), **options)


def test_valid_rules_have_no_diagnostics() -> None:
    assert logicity.check('.include "vocabulary.dl"\nStop(X) :- IsCar(X), IsInInter(X).\n') == []


def test_check_takes_text_not_a_path(tmp_path: Path) -> None:
    for path in ("/path/my.dl", "my.dl", "a b.yaml", tmp_path / "my.dl"):
        with pytest.raises(ValueError, match="looks like a path: read the file"):
            logicity.check(path)  # type: ignore[arg-type]
    for text in ("", "// my.dl", '.include "vocabulary.dl"', "p(1).dl"):
        logicity.check(text)


def test_errors_are_reported_with_their_location() -> None:
    (fault,) = logicity.check('.include "vocabulary.dl"\nStop(X) :- IsCarr(X).\n', "mine.dl")
    assert fault["code"] == "unknown-predicate"
    label = fault["labels"][0]
    assert (label["file"], label["line"], label["column"]) == ("mine.dl", 2, 12)


def test_an_invalid_program_raises_all_its_errors() -> None:
    with pytest.raises(InputError, match=r"mine\.dl:2:") as caught:
        Program(".decl a(x: number)\na(x) :- b(x).\n.decl c(x: number)\n.input c\na(x) :- !c(x).\n", "mine.dl")
    assert [fault["code"] for fault in caught.value.diagnostics] == ["unknown-predicate", "unbound-variable"]
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.diagnostics) == (str(caught.value), caught.value.diagnostics)


def test_a_program_lists_its_predicates_and_clauses() -> None:
    program = Program(PATH + ".decl lonely(x: number)\nlonely(x) :- edge(x2, y), x = 1.\n", "test.dl")
    path = program.predicates["path"]
    assert [(column.name, column.type, column.base) for column in path.columns] == [
        ("x", "symbol", "symbol"),
        ("y", "symbol", "symbol"),
    ]
    assert (path.input, path.output, path.derived, path.doc) == (False, True, True, "Where one can go.")
    assert (path.file, path.line) == ("test.dl", 5)
    assert program.predicates["edge"].input
    assert program.strata == [["path"], ["lonely"]]
    assert [(clause["label"], clause["line"], clause["column"]) for clause in program.clauses] == [
        ("P1", 8, 1),
        ("P2", 10, 1),
        ("test.dl:12", 12, 1),
    ]
    assert program.clauses[1]["text"] == "path(x, z) :- path(x, y), edge(y, z)."
    assert {warning["code"] for warning in program.warnings} == {"singleton-variable"}
    assert "path(x, z)" in program.plan()
    assert "3 clauses" in repr(program)


def test_programs_are_loaded_from_files_and_built_in_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "decls.dl").write_text(".decl a(x: number)\n.input a\n")
    (tmp_path / "main.dl").write_text('.include "decls.dl"\n.decl b(x: number)\nb(x) :- a(x).\n')
    program = Program.load(tmp_path / "main.dl")
    assert list(program.predicates) == ["a", "b"]
    assert "Stop" in Program.load("rules/expert.dl").predicates
    monkeypatch.chdir(tmp_path)
    assert Program.load("expert").clauses == Program.load("rules/expert.dl").clauses
    (tmp_path / "expert").write_text(".decl mine(x: number)\n")
    assert list(Program.load("expert").predicates) == ["mine"]
    with pytest.raises(FileNotFoundError, match="cannot read `exprt`"):
        Program.load("exprt")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        Program.load("nowhere.dl")
    with pytest.raises(OSError, match="folder"):
        Program.load(tmp_path)
    (tmp_path / "latin.dl").write_bytes(b"\xe9")
    with pytest.raises(InputError) as caught:
        Program.load(tmp_path / "latin.dl")
    assert caught.value.diagnostics[0]["code"] == "not-text"


@pytest.mark.parametrize("again", [lambda it: pickle.loads(pickle.dumps(it)), copy.deepcopy, copy.copy])
def test_pickled_programs_keep_their_source_text(tmp_path: Path, again: Callable[[Program], Program]) -> None:
    (tmp_path / "decls.dl").write_text(".decl a(x: number)\n.input a\n")
    (tmp_path / "main.dl").write_text(
        '.include "decls.dl"\n.include "vocabulary.dl"\n.decl b(x: number)\nb(x) :- a(x).\n'
    )
    program = Program.load(tmp_path / "main.dl")
    (tmp_path / "decls.dl").unlink()
    other = again(program)
    assert (other.predicates, other.clauses) == (program.predicates, program.clauses)
    held = Session(other)
    held.insert("a", [(1,)])
    assert held.commit()["b"].added == [(1,)]


def test_a_commit_reports_exactly_what_changed() -> None:
    held = session(PATH)
    assert held.insert("edge", [("a", "b"), ["b", "c"]]) == 2
    assert held.rows("path") == []
    delta = held.commit()
    assert delta["edge"].added == [("a", "b"), ("b", "c")]
    assert delta["path"].added == [("a", "b"), ("a", "c"), ("b", "c")]
    assert delta["path"].removed == []
    assert held.rows("path") == list(delta["path"].added)
    assert held.retract("edge", [("b", "c"), ("no", "such")]) == 2
    delta = held.commit()
    assert delta["path"].removed == [("a", "c"), ("b", "c")]
    assert held.commit() == {}
    assert (held.count("path"), held.contains("path", ("a", "b")), held.contains("path", ("a", "q"))) == (
        1,
        True,
        False,
    )
    held.insert("edge", [("x", "y")])
    held.rollback()
    assert held.commit() == {}


def test_ticks_move_what_rules_remember() -> None:
    held = session(".decl button, light(x: symbol) .input button light(x) :- once[0,2] button(x).")
    held.insert("button", [("hall",)])
    held.commit()
    held.retract("button", [("hall",)])
    assert held.advance()["button"].removed == [("hall",)]
    assert held.advance() == {}
    assert held.rows("light") == [("hall",)]
    changes = held.advance()
    assert (held.tick, list(changes), list(held.rows("light"))) == (3, ["light"], [])


def test_temporal_operators_agree_with_rtamt() -> None:
    rtamt = needs("rtamt", "test-all")
    rng = random.Random(1)
    for _ in range(40):
        first, last = sorted((rng.randrange(5), rng.randrange(9)))
        operator = rng.choice(["once", "historically", "since"])
        before = "q() " if operator == "since" else ""
        held = session(f".decl p, q, out() .input p, q out() :- {before}{operator}[{first},{last}] p().")
        trace = [(rng.random() < 0.5, rng.random() < 0.8) for _ in range(30)]
        found = []
        for tick, values in enumerate(trace):
            for name, value in zip(("p", "q"), values, strict=True):
                (held.insert if value else held.retract)(name, [()])
            held.advance() if tick else held.commit()
            found.append(held.count("out") == 1)
        spec = rtamt.StlDiscreteTimeSpecification()
        for name in ("p", "q", "out"):
            spec.declare_var(name, "float")
        before = "(q > 0) " if operator == "since" else ""
        spec.spec = f"out = {before}{operator}[{first}:{last}](p > 0)"
        spec.parse()
        # Before the first tick nothing held; rtamt has no ticks there.
        padded = [(False, False)] * last + trace
        columns = {name: [1.0 if row[at] else -1.0 for row in padded] for at, name in enumerate(("p", "q"))}
        robustness = spec.evaluate({"time": list(range(len(padded))), **columns})
        assert [value > 0 for _, value in robustness[last:]] == found, (operator, first, last)


def test_rows_of_a_commit_are_a_sequence() -> None:
    held = session(PATH)
    held.insert("edge", [(str(n), str(n + 1)) for n in range(10)])
    rows = held.commit()["edge"].added
    assert len(rows) == 10
    assert (rows[0], rows[-1], rows[2:4]) == (("0", "1"), ("9", "10"), [("2", "3"), ("3", "4")])
    assert (rows[::3], rows[20:], rows[4:1]) == ([(str(n), str(n + 1)) for n in (0, 3, 6, 9)], [], [])
    assert list(rows) == rows
    assert ("3", "4") in rows
    assert rows != [("0", "1")]
    assert repr(rows).endswith("...]")
    assert rows.columns()["y"].tolist() == [str(n + 1) for n in range(10)]
    with pytest.raises(IndexError):
        rows[10]


MIXED = [("a", -1, 0, 0.5), ("b", 2**31 - 1, 2**32 - 1, float("inf")), ("", -(2**31), 7, -1e-30)]
FIELDS = {"s": ["a", "b", ""], "n": [-1, 2**31 - 1, -(2**31)], "u": [0, 2**32 - 1, 7], "f": [0.5, np.inf, -1e-30]}


@pytest.mark.parametrize(
    "rows",
    [
        MIXED,
        (list(row) for row in MIXED),
        [(np.str_(s), np.int64(n), np.uint64(u), np.float64(f)) for s, n, u, f in MIXED],
        np.array(MIXED, dtype=[("s", "U3"), ("n", "i8"), ("u", "u4"), ("f", "f4")]),
        np.array(MIXED, dtype=[("s", "U3"), ("n", "i8"), ("u", "u4"), ("f", "f4")])[["f", "u", "n", "s"]],
        np.array([(0, *row) for row in MIXED], dtype=[("x", "u1"), ("s", "O"), ("n", ">i4"), ("u", "i8"), ("f", "f8")])[
            ["s", "n", "u", "f"]
        ],
        FIELDS,
        {name: np.array(values, dtype=object if name == "s" else None)[::-1] for name, values in FIELDS.items()},
    ],
    ids=["tuples", "iterator", "numpy scalars", "structured", "reordered", "unaligned", "mapping", "strided"],
)
def test_insert_accepts_many_forms_of_rows(rows: Any) -> None:
    held = session(ALL)
    assert held.insert("all", rows) == 3
    held.insert("flag", [()])
    held.commit()
    expected = {(s, n, u, float(np.float32(f))) for s, n, u, f in MIXED}
    assert set(held.rows("copy")) == expected
    columns = held.columns("copy")
    assert [columns[name].dtype for name in "snuf"] == [np.dtype(object), np.int32, np.uint32, np.float32]
    assert set(zip(*(columns[name].tolist() for name in "snuf"), strict=True)) == expected
    # `retract` accepts the output of `columns`.
    held.retract("all", columns)
    held.commit()
    assert held.rows("copy") == []


RECORDS = """
.type List = [head: number, tail: List]
.type Shape = Circle {r: float} | Dot {} | Both {name: symbol, list: List, shape: Shape}
.decl list(l: List)
.decl shape(s: Shape)
.input list, shape
.decl part(l: List)
part(l) :- list(l). part(t) :- part([_, t]).
.decl inner(s: Shape)
inner(s) :- shape($Both(_, _, s)).
"""


def test_records_are_tuples() -> None:
    session = Session(Program(RECORDS))
    shared = (2, (1, None))
    session.insert("list", [((3, shared),), (shared,), ([7, None],), ("[9, [8, nil]]",)])
    circle = ("Circle", 1.5)
    session.insert("shape", [(circle,), (("Both", "a, b", shared, ("Dot",)),), ("$Both(c, nil, $Circle(2))",)])
    session.commit()
    assert set(session.rows("part")) == {
        (None,),
        ((1, None),),
        (shared,),
        ((3, shared),),
        ((7, None),),
        ((8, None),),
        ((9, (8, None)),),
    }
    assert set(session.rows("inner")) == {(("Dot",),), (("Circle", 2.0),)}
    assert (circle,) in session.rows("shape")
    assert session.contains("part", ((1, None),)) and not session.contains("part", ((4, None),))
    assert "inner($Dot)" in str(session.explain("inner", (("Dot",),)))
    # What a session returns can be inserted into another one: as rows, and as arrays of objects.
    again = Session(Program(RECORDS))
    again.insert("list", session.columns("list"))
    again.insert("shape", session.rows("shape"))
    again.commit()
    assert again.rows("part") == session.rows("part") and again.rows("inner") == session.rows("inner")
    session.retract("list", [((3, shared),)])
    change = session.commit()["part"]
    assert list(change.removed) == [((3, shared),)]


def test_records_that_do_not_fit_raise() -> None:
    session = Session(Program(RECORDS))
    cyclic: list[Any] = [1]
    cyclic.append(cyclic)
    deep: Any = None
    for _ in range(20_000):
        deep = (1, deep)
    for predicate, value, message in [
        ("list", 1, "a `List` is a tuple of its fields or None, not 1"),
        ("list", (1,), r"a `List` is \(head, tail\) with 2 fields, not 1"),
        ("list", ("a", None), "a field holds numbers .*, not 'a'"),
        ("list", (1 << 40, None), "a field holds numbers .*, not 1099511627776, which is out of range"),
        ("list", "[1, 2]", "expected `\\[` or `nil`"),
        ("list", cyclic, "records are nested more than 10000 deep"),
        ("list", deep, "records are nested more than 10000 deep"),
        ("shape", None, "a `Shape` is"),
        ("shape", ("Square", 1), r'a `Shape` is \("Circle", r\) or \("Dot",\) or \("Both", name, list, shape\)'),
        ("shape", ("Circle",), r'a `Shape` is \("Circle", r\) with 1 fields, not 0'),
    ]:
        with pytest.raises(ValueError, match=message):
            session.insert(predicate, [(value,)])
    # A tuple that occurs often is converted once.
    tree: Any = ("Dot",)
    program = Program(".type T = Dot {} | Pair {a: T, b: T}\n.decl t(t: T)\n.input t\n")
    for _ in range(200):
        tree = ("Pair", tree, tree)
    session = Session(program)
    session.insert("t", [(tree,)])
    session.commit()
    [(found,)] = session.rows("t")
    assert isinstance(found, tuple) and found[1] is found[2]


FUNCTORS = """
.type List = [head: number, tail: List]
.functor double(x: number): number
.functor upper(symbol): symbol
.functor half(x: number): number
.functor push(n: number, l: List): List
.functor pi(): float
.decl n(x: number)
.input n
.decl d(x: number, y: number)
d(x, @double(x)) :- n(x).
.decl h(y: number)
h(@half(x)) :- n(x).
.decl s(s: symbol)
s(@upper(to_string(x))) :- n(x), x < 2.
.decl l(l: List)
l(@push(x, [7, nil])) :- n(x), x < 2.
.decl f(x: float)
f(@pi()).
"""


def double(x: Any) -> Any:
    return 2 * x


def upper(words: Any) -> Any:
    return [f"<{word}>" for word in words]


def half(numbers: Any) -> Any:
    return [number // 2 if number % 2 == 0 else None for number in numbers.tolist()]


def push(heads: Any, tails: Any) -> Any:
    return list(zip(heads, tails, strict=True))


def pi() -> Any:
    return [3.5]


DEFINED: dict[str, Callable[..., Any]] = {"double": double, "upper": upper, "half": half, "push": push, "pi": pi}


def test_functors_are_functions() -> None:
    sizes = []

    def counted(x: Any) -> Any:
        sizes.append(len(x))
        assert x.dtype == np.int32
        return double(x)

    program = Program(FUNCTORS, functors={**DEFINED, "double": counted})
    session = Session(program)
    session.insert("n", [(x,) for x in range(5000)])
    session.commit()
    assert session.rows("d") == [(x, 2 * x) for x in range(5000)]
    assert session.count("h") == 2500 and session.rows("f") == [(3.5,)]
    assert sorted(session.rows("s")) == [("<0>",), ("<1>",)]
    assert set(session.rows("l")) == {((x, (7, None)),) for x in (0, 1)}
    assert sum(sizes) == 5000 and len(sizes) == 2
    # Sessions maintain what follows.
    session.retract("n", [(3,)])
    session.insert("n", [(10_000,)])
    change = session.commit()["d"]
    assert list(change.added) == [(10_000, 20_000)] and list(change.removed) == [(3, 6)]
    assert session.query("n(x), @double(x) = 8").columns()["x"].tolist() == [4]
    assert "8 = @double(4)" in str(session.explain("d", (4, 8)))


ROUNDS = """
.decl edge(x: number, y: number, w: number)
.input edge
.decl seat(place: number, person: symbol) choice-domain place
.input seat
.decl far(x: number, w: number)
far(0, 0). far(y, v + w) :- far(x, v), edge(x, y, w).
far(x, v) <= far(x, w) :- w < v.
"""


def test_keys_and_subsumptions_decide_which_rows_hold() -> None:
    session = Session(Program(ROUNDS))
    session.insert("edge", [(0, 1, 4), (0, 2, 1), (2, 1, 2), (1, 0, 1)])
    session.insert("seat", [(1, "bob"), (1, "ann"), (2, "bob")])
    session.commit()
    assert sorted(session.rows("far")) == [(0, 0), (1, 3), (2, 1)]
    assert sorted(session.rows("seat")) == [(1, "ann"), (2, "bob")]
    why_not = session.why_not("far", (1, 4))
    [clause] = [clause for clause in why_not.nodes[0]["clauses"] if "excluded-by" in clause]
    assert why_not.nodes[clause["excluded-by"]]["holds"] == "far(1, 3)"
    session.retract("edge", [(2, 1, 2)])
    session.retract("seat", [(1, "ann")])
    changes = session.commit()
    assert list(changes["far"].added) == [(1, 4)] and list(changes["far"].removed) == [(1, 3)]
    assert list(changes["seat"].added) == [(1, "bob")]


def test_programs_with_functors_are_pickled() -> None:
    program = pickle.loads(pickle.dumps(Program(FUNCTORS, functors=DEFINED)))
    session = Session(program)
    session.insert("n", [(21,)])
    session.commit()
    assert session.rows("d") == [(21, 42)]


def test_explanations_pass_on_what_functors_raise() -> None:
    class Once:
        def __init__(self) -> None:
            self.fails = False

        def __call__(self, x: list[int]) -> list[int]:
            if self.fails:
                raise KeyError("gone")
            return [2 * each for each in x]

    double = Once()
    text = ".functor double(x: number): number\n.decl n, d(x: number)\n.input n\nd(@double(x)) :- n(x).\n"
    session = Session(Program(text, functors={"double": double}))
    session.insert("n", [(1,)])
    session.commit()
    double.fails = True
    with pytest.raises(KeyError, match="gone"):
        session.explain("d(3)")
    double.fails = False
    assert not session.explain("d(3)").holds and session.explain("d(2)").holds


@pytest.mark.parametrize(
    ("function", "kind", "message"),
    [
        (lambda x: x[:1], ValueError, "the functor `double` must return 2 values, one for each call, not 1"),
        (lambda x: [*x, 1], ValueError, "must return 2 values, one for each call, not more"),
        (lambda x: ["a"] * len(x), TypeError, "the functor `double` returns numbers .*, not 'a'"),
        (
            lambda x: [1 << 40] * len(x),
            ValueError,
            "the functor `double` returns numbers .*1099511627776 is out of range",
        ),
        (lambda x: 1, TypeError, "expected a sequence of them, not 1"),
        (lambda x: "ab", TypeError, "expected a sequence of them, not 'ab'"),
        (lambda x: {2, 4}, TypeError, r"expected a sequence of them, not \{2, 4\}"),
        (lambda x: {2: 4, 4: 8}, TypeError, r"expected a sequence of them, not \{2: 4, 4: 8\}"),
        (lambda x: 1 / 0, ZeroDivisionError, "division by zero"),
        (lambda: [1], TypeError, "argument"),
    ],
)
def test_what_functions_of_functors_raise_is_passed_on(
    function: Callable[..., Any], kind: type[Exception], message: str
) -> None:
    text = ".functor double(x: number): number\n.decl n, d(x: number)\n.input n\nd(@double(x)) :- n(x).\n"
    session = Session(Program(text, functors={"double": function}))
    session.commit()
    session.insert("n", [(1,), (2,)])
    with pytest.raises(kind, match=message):
        session.commit()
    assert session.rows("n") == []
    with pytest.raises(kind, match=message):
        session.commit()
    session.rollback()
    session.commit()


def test_missing_functions_of_functors() -> None:
    with pytest.raises(ValueError, match="the program declares no functor `dubble`; did you mean `double`?"):
        Program(FUNCTORS, functors={"dubble": double})
    session = Session(Program(FUNCTORS))
    with pytest.raises(InputError, match="the functor `double` has no definition") as raised:
        session.commit()
    assert "functors={" in str(raised.value)


def test_functions_of_functors_cannot_use_their_session() -> None:
    text = ".functor f(x: number): number\n.decl n(x: number)\n.input n\n.decl d(y: number)\nd(@f(x)) :- n(x).\n"
    sessions: list[Session] = []

    def function(x: Any) -> Any:
        return sessions[0].rows("n")

    sessions.append(Session(Program(text, functors={"f": function})))
    sessions[0].insert("n", [(1,)])
    with pytest.raises(RuntimeError):
        sessions[0].commit()


def test_homogeneous_arrays_of_rows() -> None:
    held = session(".decl e(x: number, y: number)\n.input e\n.decl s(x: symbol, y: symbol)\n.input s\n")
    grid = np.arange(12, dtype=np.int16).reshape(6, 2)
    assert held.insert("e", grid[::2]) == 3
    assert held.insert("e", np.empty((0, 2), dtype=int)) == 0
    assert held.insert("s", np.array([["a", "b"], ["c", "d"]])) == 2
    held.commit()
    assert held.rows("e") == [(0, 1), (4, 5), (8, 9)]
    assert held.rows("s") == [("a", "b"), ("c", "d")]


def test_floats_are_rounded_and_all_nans_are_equal() -> None:
    held = session(".decl f(x: float)\n.input f\n")
    held.insert("f", [(0.1,), (float("nan"),), (-float("nan"),), (0.0,), (-0.0,), (3,)])
    held.insert("f", np.array([[np.nan], [1e-60]]))
    held.commit()
    found = held.columns("f")["x"]
    assert np.isnan(found).sum() == 1
    assert sorted(found[~np.isnan(found)].tolist()) == [0.0, float(np.float32(0.1)), 3.0]


BAD = [
    ("edje", [("a", "b")], KeyError, "did you mean `edge`"),
    ("path", [("a", "b")], ValueError, "derived by rules"),
    ("edge", [("a",)], ValueError, "row 0: a row of `edge` must have 2 values, not 1"),
    ("edge", [("a", "b"), ("a", "b", "c")], ValueError, "row 1: a row of `edge` must have 2 values, not 3"),
    ("edge", [("a", 1)], TypeError, "column `y` of `edge` holds symbols"),
    ("edge", ["ab"], TypeError, "not a str"),
    ("edge", [{"x": 1, "y": 2}], TypeError, "must be a tuple of its values, not a dict"),
    ("edge", [{1, 2}], TypeError, "must be a tuple of its values, not a set"),
    ("edge", "ab", TypeError, "not a str"),
    ("edge", [1], TypeError, "not iterable|cannot be|int"),
    ("edge", 1, TypeError, "not iterable|cannot be|int"),
    ("edge", {"x": ["a"]}, ValueError, r"expected the columns \[x, y\] of `edge`, not \[x\]"),
    ("edge", {"x": ["a"], "z": ["b"]}, ValueError, "expected the columns"),
    ("edge", {"x": ["a", "b"], "y": ["b"]}, ValueError, r"expected an array of shape \(2,\), not \(1,\)"),
    ("edge", np.array([[1, 2]]), TypeError, "dtype int64"),
    ("edge", np.array([["a", 1]], dtype=object), TypeError, "row 0"),
    ("edge", np.array(["a", "b"]), ValueError, r"shape \(n, 2\)"),
    ("edge", np.array([["a", "b", "c"]]), ValueError, r"shape \(n, 2\)"),
    ("edge", np.array([[b"a", b"b"]]), TypeError, "dtype"),
    ("n", [(2**31,)], ValueError, "out of range"),
    ("n", [(10**50,)], ValueError, "out of range"),
    ("n", [(True,)], TypeError, "not True"),
    ("n", [(1.0,)], TypeError, "not 1.0"),
    ("n", [("1",)], TypeError, "not '1'"),
    ("n", np.array([[1], [2**31]]), ValueError, "row 1.*2147483648 is out of range"),
    ("n", np.array([[2**63]], dtype=np.uint64), ValueError, "out of range"),
    ("n", np.array([[1.0]]), TypeError, "dtype float64"),
    ("n", np.array([[True]]), TypeError, "dtype bool"),
    ("u", [(-1,)], ValueError, "out of range"),
    ("u", np.array([[-1]]), ValueError, "out of range"),
    ("f", [(1e39,)], ValueError, "out of range"),
    ("f", [(10**400,)], ValueError, "out of range"),
    ("f", [("1",)], TypeError, "not '1'"),
    ("f", [(None,)], TypeError, "not None"),
    ("f", np.array([[1e39]]), ValueError, "out of range"),
]


@pytest.mark.parametrize(("relation", "rows", "kind", "message"), BAD)
def test_invalid_rows_raise(relation: str, rows: Any, kind: type[Exception], message: str) -> None:
    text = PATH + ".decl n(x: number)\n.input n\n.decl u(x: unsigned)\n.input u\n.decl f(x: float)\n.input f\n"
    held = session(text)
    for change in (held.insert, held.retract):
        with pytest.raises(kind, match=message) as caught:
            change(relation, rows)
        assert type(caught.value) is kind
    assert held.commit() == {}


def test_exceptions_of_iterators_propagate() -> None:
    def rows() -> Any:
        yield ("a", "b")
        raise LookupError("mine")

    held = session(PATH)
    with pytest.raises(LookupError, match="mine"):
        held.insert("edge", rows())
    assert held.commit() == {}
    # The iterator may query the same session.
    held.insert("edge", (("a", str(held.count("path"))) for _ in range(3)))
    assert held.commit()["path"].added == [("a", "0")]


@pytest.mark.parametrize("ask", [Session.rows, Session.columns, Session.count])
def test_unknown_predicates_are_key_errors(ask: Callable[[Session, str], object]) -> None:
    with pytest.raises(KeyError, match="did you mean `path`"):
        ask(session(PATH), "pth")


def test_queries_have_a_column_for_each_variable() -> None:
    held = session(PATH)
    assert held.query('path("a", X)') == []
    held.insert("edge", [("a", "b"), ("b", "c"), ("c", "a")])
    assert held.query("edge(x, y)") == []  # not committed
    held.commit()
    assert held.query('path("a", X)') == [("a",), ("b",), ("c",)]
    assert held.query("?- edge(from, _via), edge(_via, to).")[:] == [("a", "c"), ("b", "a"), ("c", "b")]
    assert held.query('edge("a", to)').columns()["to"].tolist() == ["b"]
    assert held.query('edge("a", "b")') == [()]
    assert held.query('edge("a", "unknown"), path(_, _)') == []
    assert held.commit() == {}
    answer = held.query("edge(x, y)")
    held.retract("edge", [("a", "b")])
    held.commit()
    assert len(answer) == 3  # answers keep the rows


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("pth(1, X)", "did you mean `path`"),
        ("path(1, X)", "symbol"),
        ("path(X)", "2"),
        ("!edge(X, Y)", "X"),
        ("edge(X,", "<query>:1"),
        ("", "<query>:1"),
    ],
)
def test_faults_of_queries_have_a_place(query: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        session(PATH).query(query)
    assert message in str(caught.value)
    assert "<query>:1:" in str(caught.value)


def test_queries_stay_within_the_limits() -> None:
    held = session(PATH, max_rows=5000, max_bytes=20_000_000)
    held.insert("edge", [(f"a{n}", "b") for n in range(2000)])
    held.commit()
    with pytest.raises(LimitError, match="more than 5000 rows"):
        held.query("edge(x, z), edge(y, z)")
    assert len(held.query("edge(x, _)")) == 2000
    held = session(PATH, max_bytes=1_000_000)
    held.insert("edge", [(f"a{n}", "b") for n in range(4500)])
    held.commit()
    with pytest.raises(LimitError, match="the inserted rows take more than"):
        held.query("edge(x, y), path(x, y)")


def test_ctrl_c_ends_a_query_at_once(ctrl_c: Interrupt) -> None:
    held = session(PATH)
    held.insert("edge", [(f"a{n}", "b") for n in range(5000)])
    held.commit()
    ctrl_c(lambda: held.query("edge(a, z), edge(b, z), edge(c, z), a != b, b != c"))
    assert held.count("edge") == 5000


def test_explanations_of_facts() -> None:
    held = session(PATH)
    held.insert("edge", [("a", "b"), ("b", "c")])
    held.commit()
    why = held.explain('path("a", "c")')
    assert why == held.explain("path", ("a", "c"))
    assert (why.fact, why.holds) == ('path("a", "c")', True)
    assert str(why).splitlines()[0] == 'path("a", "c")  by P2: a step more  [test.dl:10]'
    assert why.nodes[0]["clause"]["line"] == 10
    assert why.nodes[0]["height"] == 2
    not_so = held.why_not("path", ("c", None))
    assert not not_so.holds
    assert not_so.nodes[0]["because"] == "no-clause"
    assert held.explain('path("c", _)').text == 'path("c", _) does not hold, because:\n' + not_so.text
    assert held.why_not('path("a", "c")').text == 'path("a", "c") holds, because:\n' + why.text
    for fact, code in [("path(1, 2)", "type-mismatch"), ("pth(_, _)", "unknown-predicate"), ("path(", "syntax")]:
        with pytest.raises(InputError) as caught:
            held.explain(fact)
        assert caught.value.diagnostics[0]["code"] == code
        assert caught.value.diagnostics[0]["labels"][0]["file"] == "<fact>"
    with pytest.raises(TypeError, match="column `y`"):
        held.explain("path", ("a", 1))
    with pytest.raises(KeyError, match="pth"):
        held.explain("pth", ("a", "b"))


def test_commit_statistics_count_rows() -> None:
    held = session(PATH)
    assert held.work == []
    held.insert("edge", [(str(n), str(n + 1)) for n in range(50)])
    held.commit()
    (first,) = held.work
    assert (first["predicates"], first["how"]) == (["path"], "recomputed")
    assert first["rounds"] > 1
    held.insert("edge", [("50", "51")])
    held.commit()
    (second,) = held.work
    assert second["how"] == "maintained"
    assert second["rows_scanned"] < first["rows_scanned"]
    assert {work["clause"] for work in second["clauses"]} <= {"P1", "P2"}
    held.commit()
    assert held.work[0]["how"] == "skipped"
    assert "edge" in held.plan()


def test_threads_do_not_affect_results() -> None:
    edges = np.random.default_rng(7).integers(0, 300, (900, 2))
    text = PATH.replace("symbol", "number")
    one, three = session(text), session(text, threads=3)
    for held in (one, three):
        held.insert("edge", edges)
        held.commit()
    assert one.rows("path") == three.rows("path")


@pytest.mark.parametrize("limit", ["max_rows", "max_steps", "max_bytes"])
def test_limits_name_the_clause_and_leave_the_session_as_it_was(limit: str) -> None:
    held = session(ENDLESS, **{limit: 100_000})
    held.commit()
    held.insert("seed", [(0,)])
    with pytest.raises(LimitError) as caught:
        held.commit()
    (fault,) = caught.value.diagnostics
    assert fault["code"] == "limit-exceeded"
    assert fault["labels"][0]["line"] == 5
    assert held.count("n") == 0
    held.rollback()
    assert held.commit() == {}


def test_options_out_of_range() -> None:
    for name, value in [("threads", -1), ("threads", 1025), ("max_rows", -1), ("max_steps", 2**64), ("max_bytes", -5)]:
        largest = "1024" if name == "threads" else r"2\*\*64 - 1"
        with pytest.raises(ValueError, match=f"^{name}: expected 0 to {largest}, not {value}$"):
            session(PATH, **{name: value})


def test_sessions_cannot_be_pickled() -> None:
    for copied in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="because its rows .*: pickle its program"):
            copied(session(PATH))


def test_rows_of_a_commit_cannot_be_pickled() -> None:
    held = session(PATH)
    held.insert("edge", [("a", "b")])
    change = held.commit()["path"]
    for copied in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match=r"belong to a session: use `list\(rows\)`"):
            copied(change.added)
    assert pickle.loads(pickle.dumps(list(change.added))) == change.added


@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_ends_a_commit_at_once(threads: int, ctrl_c: Interrupt) -> None:
    held = session(ENDLESS, threads=threads)
    held.commit()
    held.insert("seed", [(0,)])
    ctrl_c(held.commit)
    assert held.count("n") == 0
    held.rollback()
    assert held.commit() == {}


def test_concurrent_use_of_a_session_raises_and_commits_release_the_gil() -> None:
    held = session(ENDLESS, max_steps=400_000)
    held.insert("seed", [(0,)])
    raised: list[BaseException] = []

    def commit() -> None:
        try:
            held.commit()
        except BaseException as error:
            raised.append(error)

    worker = threading.Thread(target=commit)
    worker.start()
    refused = 0
    while worker.is_alive():
        try:
            held.count("n")
        except RuntimeError as error:
            assert "another thread is using" in str(error)
            refused += 1
        time.sleep(0.001)
    worker.join()
    assert refused > 0
    assert isinstance(raised[0], LimitError)
    assert held.count("n") == 0


def test_random_changes_agree_with_python_sets() -> None:
    rng = random.Random(5)
    held = session(
        ".decl e(x: number, y: number)\n.input e\n.decl p(x: number, y: number)\np(x, y) :- e(x, z), e(z, y).\n"
    )
    facts: set[tuple[int, int]] = set()
    paths: set[tuple[int, int]] = set()
    for _ in range(60):
        rows = [(rng.randrange(8), rng.randrange(8)) for _ in range(rng.randrange(6))]
        if rng.random() < 0.5:
            held.insert("e", rows if rng.random() < 0.5 else np.array(rows, dtype=int).reshape(-1, 2))
            facts |= set(rows)
        else:
            held.retract("e", rows)
            facts -= set(rows)
        delta = held.commit()
        now = {(x, y) for x, z in facts for w, y in facts if w == z}
        change = delta.get("p")
        assert (set(change.added) if change else set()) == now - paths
        assert (set(change.removed) if change else set()) == paths - now
        assert set(held.rows("p")) == now
        paths = now
        queries: dict[str, set[Any]] = {
            "p(3, y)": {(y,) for x, y in now if x == 3},
            "e(x, x)": {(x,) for x, y in facts if x == y},
            "e(2, y), !p(2, y)": {(y,) for x, y in facts if x == 2} - {(y,) for x, y in now if x == 2},
            "e(y, 4), e(4, x), x < y": {(y, x) for y, z in facts for w, x in facts if z == w == 4 and x < y},
            "n = count : { e(5, _) }": {(sum(x == 5 for x, _ in facts),)},
        }
        for query, expected in queries.items():
            answer = held.query(query)
            assert (len(answer), set(answer)) == (len(expected), expected)
