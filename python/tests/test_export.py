"""Programs for other engines: the SQL of random programs derives the same rows in DuckDB."""

from __future__ import annotations

import random
from typing import Any

import pytest
from conftest import needs

from logicity import InputError, Program, Session

duckdb = needs("duckdb", "frames")

NUMBERS = (-(2**31), 2**31 - 1, -1, 0, 1, 2, 3)
TEXTS = ("a", "b", "it's", "", "é")


def body(rng: random.Random, known: list[tuple[str, list[str]]]) -> tuple[list[str], dict[str, str]]:
    """Return literals over known predicates, and the variables that they bind, with their types."""
    literals, bound = [], {}
    for _ in range(rng.randint(1, 3)):
        name, types = rng.choice(known)
        terms = []
        for kind in types:
            variable = rng.choice("xyz") + kind[0]
            roll = rng.random()
            if roll < 0.7:
                terms.append(variable)
                bound[variable] = kind
            elif roll < 0.85:
                terms.append(constant(rng, kind))
            else:
                terms.append("_")
        literals.append(f"{name}({', '.join(terms)})")
    for _ in range(rng.randint(0, 2)):
        name, types = rng.choice(known)
        terms = [pick(rng, bound, kind) if rng.random() < 0.7 else "_" for kind in types]
        literals.append(f"!{name}({', '.join(terms)})")
    for _ in range(rng.randint(0, 2)):
        kind = rng.choice(("number", "symbol"))
        operator = rng.choice(("<", "<=", ">", ">=", "=", "!="))
        literals.append(f"{pick(rng, bound, kind)} {operator} {pick(rng, bound, kind)}")
    if rng.random() < 0.3:
        literals.append(f"contains({pick(rng, bound, 'symbol')}, {pick(rng, bound, 'symbol')})")
    for made in ("fn", "gn"):
        if rng.random() < 0.4:
            one, other = pick(rng, bound, "number"), pick(rng, bound, "number")
            functor = rng.choice(("({} + {})", "({} - {})", "({} * {})", "min({}, {})", "max({}, {})", "({} bxor {})"))
            literals.append(f"{made} = {functor.format(one, other)}")
            bound[made] = "number"
    if rng.random() < 0.3:
        literals.append(f"fs = cat({pick(rng, bound, 'symbol')}, to_string({pick(rng, bound, 'number')}))")
        bound["fs"] = "symbol"
    if rng.random() < 0.4:
        name, types = rng.choice(known)
        numbers = [at for at, kind in enumerate(types) if kind == "number"]
        terms = [pick(rng, bound, kind) if rng.random() < 0.4 else "_" for kind in types]
        if numbers and rng.random() < 0.7:
            terms[rng.choice(numbers)] = "v"
            literals.append(f"an = {rng.choice(('sum', 'min', 'max'))} v : {{ {name}({', '.join(terms)}) }}")
        else:
            literals.append(f"an = count : {{ {name}({', '.join(terms)}) }}")
        bound["an"] = "number"
    return literals, bound


def constant(rng: random.Random, kind: str) -> str:
    return str(rng.choice(NUMBERS)) if kind == "number" else f'"{rng.choice(TEXTS)}"'


def pick(rng: random.Random, bound: dict[str, str], kind: str) -> str:
    """Return a bound variable of a type, or a constant."""
    names = [name for name, of in bound.items() if of == kind]
    return rng.choice(names) if names and rng.random() < 0.8 else constant(rng, kind)


def random_program(rng: random.Random) -> tuple[str, list[tuple[str, list[str]]]]:
    """Return a program, and its base predicates with their types."""
    base = [(f"e{at}", [rng.choice(("number", "symbol")) for _ in range(rng.randint(1, 3))]) for at in range(3)]
    known, text = list(base), []

    def declare(name: str, types: list[str]) -> None:
        text.append(f".decl {name}({', '.join(f'c{at}: {kind}' for at, kind in enumerate(types))})")

    for name, types in base:
        declare(name, types)
        text.append(f".input {name}")
        if rng.random() < 0.3:
            text.append(f"{name}({', '.join(constant(rng, kind) for kind in types)}).")
    for at in range(rng.randint(2, 5)):
        name, types = f"p{at}", [rng.choice(("number", "symbol")) for _ in range(rng.randint(0, 3))]
        declare(name, types)
        for _ in range(rng.randint(1, 3)):
            literals, bound = body(rng, known)
            rng.shuffle(literals)
            text.append(f"{name}({', '.join(pick(rng, bound, kind) for kind in types)}) :- {', '.join(literals)}.")
        if types and rng.random() < 0.6:
            # Linear recursion without new values, so that it ends.
            literals, bound = body(rng, known)
            terms = [rng.choice("xyz") + kind[0] for kind in types]
            old = {term: kind for term, kind in zip(terms, types, strict=True)}
            plain = {name: kind for name, kind in {**bound, **old}.items() if name[0] in "xyz"}
            literals.append(f"{name}({', '.join(terms)})")
            rng.shuffle(literals)
            text.append(f"{name}({', '.join(pick(rng, plain, kind) for kind in types)}) :- {', '.join(literals)}.")
        known.append((name, types))
    return "\n".join(text) + "\n", base


@pytest.mark.parametrize("seed", range(60))
def test_duckdb_derives_the_same_rows(seed: int) -> None:
    rng = random.Random(seed)
    text, base = random_program(rng)
    program = Program(text)
    session = Session(program)
    with duckdb.connect() as database:
        for name, types in base:
            values = {"number": NUMBERS, "symbol": TEXTS}
            rows = [tuple(rng.choice(values[kind]) for kind in types) for _ in range(rng.randint(0, 12))]
            session.insert(name, rows)
            columns = ", ".join(
                f"c{at} {'integer' if kind == 'number' else 'varchar'}" for at, kind in enumerate(types)
            )
            database.execute(f"create table {name}({columns})")
            for row in set(rows):
                database.execute(f"insert into {name} values ({', '.join('?' * len(row))})", row)
        session.commit()
        database.execute(program.to_sql())
        check(database, session, text)
        # A second run replaces the tables.
        database.execute(program.to_sql())
        check(database, session, text)


def check(database: Any, session: Session, text: str) -> None:
    for name, predicate in session.program.predicates.items():
        found = database.execute(f'select * from "{name}"').fetchall()
        expected = set(session.rows(name)) if predicate.columns else {(True,)} & {(session.count(name) > 0,)}
        assert set(found) == expected and len(found) == len(expected), f"{name}\n{text}\n{session.program.to_sql()}"


def test_recursion_over_a_larger_graph() -> None:
    program = Program("""
        .decl edge(x: number, y: number)
        .input edge
        .decl path(x: number, y: number)
        path(x, y) :- edge(x, y).
        path(x, z) :- path(x, y), edge(y, z).
        path(x, z) :- edge(x, y), path(y, z).
    """)
    rng = random.Random(0)
    rows = [(rng.randrange(200), rng.randrange(200)) for _ in range(300)]
    session = Session(program)
    session.insert("edge", rows)
    session.commit()
    with duckdb.connect() as database:
        edges = session.rows("edge")
        database.register("edges", edges)
        database.execute("create table edge as select * from edges")
        database.execute(program.to_sql())
        assert set(database.execute("select * from path").fetchall()) == set(session.rows("path"))


def test_errors_have_places() -> None:
    text = ".decl e(x: number, y: number)\n.input e\n.decl p(x: number, y: number)\n"
    program = Program(text + "p(x, y) :- e(x, y).\np(x, z) :- p(x, y), p(y, z).\n", "test.dl")
    assert "p(x, z) :- p(x, y), p(y, z)." in program.to_souffle()
    with pytest.raises(InputError, match=r"test\.dl:5:21") as raised:
        program.to_sql()
    (fault,) = raised.value.diagnostics
    assert fault["code"] == "unsupported" and "reads `p` twice" in fault["message"]


def test_duplicates_and_nulls_of_input_tables_do_not_count() -> None:
    program = Program(
        ".decl e(x: number, y: number) .input e .decl n(c: number) n(c) :- c = count : { e(_, _) }."
        " .decl r(x: number) r(x) :- e(x, _)."
    )
    database = duckdb.connect()
    database.execute("create table e(x integer, y integer); insert into e values (1, 2), (1, 2), (null, 3)")
    database.execute(program.to_sql())
    assert (database.sql("from n").fetchall(), database.sql("from r").fetchall()) == ([(1,)], [(1,)])


def test_floats_that_are_no_numbers_have_no_order() -> None:
    program = Program(".decl e(x: float, y: float) .input e .decl r(x: float) r(x) :- e(x, y), x < y.")
    database = duckdb.connect()
    database.execute("create table e(x float, y float); insert into e values (1, 'nan'), (2, 3), ('nan', 1)")
    database.execute(program.to_sql())
    assert database.sql("from r").fetchall() == [(2.0,)]
