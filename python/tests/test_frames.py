"""Data frames in and out of sessions, against the same rows as tuples."""

from __future__ import annotations

import random
from typing import Any

import pytest
from conftest import needs

from logicity import LimitError, Program, Session

pa = needs("pyarrow", "frames")

TYPES = ("number", "unsigned", "float", "symbol")
INTEGERS = {
    "number": ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
    "unsigned": ("uint8", "uint16", "uint32", "uint64", "int64"),
}


def program(types: list[str]) -> Program:
    columns = ", ".join(f"c{at}: {kind}" for at, kind in enumerate(types))
    return Program(f".decl r({columns})\n.input r\n")


def session(types: list[str], **options: int) -> Session:
    return Session(program(types), **options)


def column(rng: random.Random, kind: str, rows: int) -> Any:
    """Return a random Arrow array of some type for a column."""
    if kind == "float":
        return pa.array(
            [rng.choice((-1.5, 0.25, 3.0, 1e30, float("inf"))) for _ in range(rows)],
            rng.choice((pa.float32(), pa.float64())),
        )
    if kind == "symbol":
        words = [
            rng.choice(("a", "b", "", "ä\n", "a longer symbol than views hold", f"s{rng.random()}"))
            for _ in range(rows)
        ]
        array = pa.array(words, rng.choice((pa.string(), pa.large_string(), pa.string_view())))
        return array.cast(pa.string()).dictionary_encode() if rng.random() < 0.3 else array
    name = rng.choice(INTEGERS[kind])
    bits = int(name.lstrip("uint"))
    # The least and the greatest numbers of both types.
    low = 0 if kind == "unsigned" or name.startswith("u") else -(2 ** (min(bits, 32) - 1))
    high = min(
        2**bits - 1 if name.startswith("u") else 2 ** (bits - 1) - 1, 2**32 - 1 if kind == "unsigned" else 2**31 - 1
    )
    return pa.array([rng.choice((low, high, rng.randint(low, high))) for _ in range(rows)], getattr(pa, name)())


def chunked(rng: random.Random, table: Any) -> Any:
    """Divide a table into batches at random places, of slices that do not begin at their buffers' start."""
    cuts = sorted(rng.randint(0, len(table)) for _ in range(rng.randint(0, 3)))
    parts = [table.slice(a, b - a) for a, b in zip([0, *cuts], [*cuts, len(table)], strict=True)]
    return pa.concat_tables(parts)


@pytest.mark.parametrize("seed", range(25))
def test_frames_insert_what_their_tuples_do(seed: int) -> None:
    rng = random.Random(seed)
    types = [rng.choice(TYPES) for _ in range(rng.randint(1, 5))]
    rows = rng.choice((0, 1, 7, 500))
    table = chunked(rng, pa.table({f"c{at}": column(rng, kind, rows) for at, kind in enumerate(types)}))
    tuples = list(zip(*(each.to_pylist() for each in table.columns), strict=True))
    slow, fast = session(types), session(types)
    assert slow.insert("r", tuples) == fast.insert("r", table) == rows
    slow.commit()
    fast.commit()
    expected = set(slow.rows("r"))
    assert set(fast.rows("r")) == expected and len(fast.rows("r")) == len(expected)
    # Out and in again.
    out = pa.table(fast.rows("r"))
    assert out.column_names == [f"c{at}" for at in range(len(types))]
    assert list(zip(*(each.to_pylist() for each in out.columns), strict=True)) == list(fast.rows("r"))
    again = session(types)
    assert again.insert("r", fast.rows("r")) == len(expected)
    again.commit()
    assert set(again.rows("r")) == expected
    # Both ways of retracting.
    assert fast.retract("r", table.slice(0, rows // 2)) == rows // 2
    slow.retract("r", tuples[: rows // 2])
    fast.commit()
    slow.commit()
    assert set(fast.rows("r")) == set(slow.rows("r"))


EDGES = """
.decl edge(x: number, y: symbol)
.input edge
.decl twice(x: number, y: symbol)
twice(2 * x, y) :- edge(x, y).
"""
ROWS = [(-1, "a"), (2, "b"), (3, "a")]
TWICE = {(-2, "a"), (4, "b"), (6, "a")}


def derived(frame: Any) -> Session:
    held = Session(Program(EDGES))
    assert held.insert("edge", frame) == 3
    held.commit()
    assert set(held.rows("twice")) == TWICE
    return held


def test_polars() -> None:
    polars = needs("polars", "frames")
    frame = polars.DataFrame(ROWS, schema=["x", "y"], orient="row")
    held = derived(frame)
    derived(frame.with_columns(polars.col("y").cast(polars.Categorical)))
    found = polars.DataFrame(held.rows("twice"))
    assert found.schema == {"x": polars.Int32, "y": polars.String} and set(found.rows()) == TWICE
    # One column is a series.
    one = session(["number"])
    assert one.insert("r", frame["x"]) == 3
    assert set(polars.DataFrame(one.commit()["r"].added).rows()) == {(-1,), (2,), (3,)}


def test_pandas() -> None:
    pandas = needs("pandas", "frames")
    frame = pandas.DataFrame(ROWS, columns=["x", "y"])
    held = derived(frame)
    derived(frame.astype({"y": "category"}))
    # A part of a frame and a sorted one have an index, which is no column.
    assert len(frame[frame.x > 2]) == 1 and Session(Program(EDGES)).insert("edge", frame[frame.x > 2]) == 1
    derived(frame.sort_values("x", ascending=False).set_index(frame.y))
    found = pa.table(held.rows("twice")).to_pandas()
    assert set(found.itertuples(index=False, name=None)) == TWICE
    if hasattr(pandas.DataFrame, "from_arrow"):
        assert pandas.DataFrame.from_arrow(held.rows("twice")).equals(found)


def test_duckdb() -> None:
    duckdb = needs("duckdb", "frames")
    with duckdb.connect() as database:
        database.execute("create table edge(x integer, y varchar)")
        database.executemany("insert into edge values (?, ?)", ROWS)
        held = derived(database.sql("select * from edge"))
        found = held.rows("twice")
        assert found is not None
        assert set(database.sql("select x, y from found where x > 0").fetchall()) == {(4, "b"), (6, "a")}
        # Sums have 128 bits.
        sums = Session(Program(".decl total(y: symbol, n: number)\n.input total\n"))
        assert sums.insert("total", database.sql("select y, sum(x) from found group by y")) == 2
        sums.commit()
        assert set(sums.rows("total")) == {("a", 4), ("b", 4)}
        # A query that reads Python objects on threads of the database, which need the interpreter.
        frame = needs("pandas", "frames").DataFrame({"x": range(200_000), "y": ["s"] * 200_000}, dtype=object)
        database.register("objects", frame)
        assert (
            held.insert("edge", database.sql("select x::integer, y from objects where x::integer >= 100000")) == 100_000
        )


def test_batches_are_complete() -> None:
    """More rows than a batch of results has."""
    count = 600_000
    held = session(["number", "symbol"])
    held.insert("r", pa.table({"n": pa.array(range(count)), "s": pa.array([f"s{n % 7}" for n in range(count)])}))
    held.commit()
    out = pa.table(held.rows("r"))
    assert out.num_rows == count and out["c0"].num_chunks > 1
    assert out["c0"].to_pylist() == list(range(count))
    assert out["c1"].to_pylist() == [f"s{n % 7}" for n in range(count)]


def test_columns_match_by_name_or_by_position() -> None:
    rules = Program(".decl e(x: number, y: number)\n.input e\n")
    for names, expected in ((["x", "y"], (1, 2)), (["y", "x"], (2, 1)), (["a", "b"], (1, 2)), (["x", "x"], (1, 2))):
        held = Session(rules)
        held.insert("e", pa.Table.from_arrays([pa.array([1]), pa.array([2])], names))
        held.commit()
        assert held.rows("e") == [expected], names


def test_rows_stay_as_they_are() -> None:
    held = session(["number"])
    held.insert("r", [(1,)])
    held.commit()
    before = held.rows("r")
    held.retract("r", [(1,)])
    held.insert("r", [(2,)])
    held.commit()
    assert before == [(1,)] and held.rows("r") == [(2,)]
    assert pa.table(before).to_pylist() == [{"c0": 1}]
    assert pa.schema(before) == pa.schema([("c0", pa.int32())])


def test_a_requested_schema_casts() -> None:
    held = session(["number", "symbol"])
    held.insert("r", [(1, "a")])
    held.commit()
    schema = pa.schema([("c0", pa.int64()), ("c1", pa.string())])
    assert pa.table(held.rows("r"), schema=schema).schema == schema


def test_predicates_without_columns_and_records() -> None:
    rules = Program(".decl on()\n.input on\n.type P = [x: number, y: symbol]\n.decl p(a: P)\n.input p\n")
    held = Session(rules)
    held.insert("on", [()])
    held.insert("p", pa.table({"a": ["[1, a]", "nil", '[2, "b, c"]']}))
    held.commit()
    assert set(held.rows("p")) == {((1, "a"),), (None,), ((2, "b, c"),)}
    other = Session(rules)
    assert (other.insert("on", held.rows("on")), other.insert("p", held.rows("p"))) == (1, 3)
    other.commit()
    assert set(other.rows("p")) == set(held.rows("p")) and other.count("on") == 1
    with pytest.raises(ValueError, match=r"row 1: column `a` of `p` .*: expected .* in \"\[1\]\""):
        held.insert("p", pa.table({"a": ["[1, a]", "[1]"]}))


def test_faults_name_predicate_column_and_row() -> None:
    held = session(["number", "symbol", "float"])
    good = {"c0": pa.array([1, 2, 3]), "c1": pa.array(["a", "b", "c"]), "c2": pa.array([0.5, 1.5, 2.5])}

    def refused(name: str, array: Any, error: type[Exception], match: str) -> None:
        with pytest.raises(error, match=match):
            held.insert("r", pa.table({**good, name: array}))

    refused("c0", pa.array([1, None, 3]), TypeError, "row 1: column `c0` of `r` holds numbers .*, not null$")
    refused("c0", pa.array([1, 2, 2**31]), ValueError, "row 2: column `c0` of `r` .*; 2147483648 is out of range$")
    refused("c0", pa.array(["1", "2", "3"]), TypeError, "^column `c0` of `r` .*, not values of the Arrow type Utf8$")
    refused("c0", pa.array([1.0, 2.0, 3.0]), TypeError, "the Arrow type Float64")
    refused("c0", pa.array([True, False, True]), TypeError, "the Arrow type Boolean")
    refused("c1", pa.array(["a", "b", None]), TypeError, "row 2: column `c1` of `r` holds symbols .*, not null$")
    refused("c1", pa.array(["a", "b", None]).dictionary_encode(), TypeError, "row 2: column `c1` .*, not null$")
    refused("c1", pa.array([1, 2, 3]), TypeError, "the Arrow type Int64")
    refused("c1", pa.array([b"a", b"b", b"c"]), TypeError, "the Arrow type Binary")
    refused("c2", pa.array([0.5, 1e300, 2.5]), ValueError, "row 1: column `c2` of `r` holds floats .*; 1e300 is out of")
    refused("c2", pa.nulls(3), TypeError, "row 0: column `c2` of `r` holds floats .*, not null$")
    # The row counts from the first batch on.
    table = pa.table({**good, "c0": pa.chunked_array([[1], [2, 2**40]])})
    with pytest.raises(ValueError, match="row 2: .*; 1099511627776 is out of range"):
        held.insert("r", table)
    with pytest.raises(ValueError, match=r"the columns \[c0, c1, c2\] of `r`, not \[c0, c1\]$"):
        held.insert("r", pa.table(good).select(["c0", "c1"]))
    with pytest.raises(ValueError, match=r"the columns \[c0, c1, c2\] of `r`, not \[c1, c0, other\]$"):
        held.insert("r", pa.table([good["c1"], good["c0"], good["c2"]], names=["c1", "c0", "other"]))
    # Columns without values have types of no use.
    empty = pa.array([], pa.string()).dictionary_encode()
    assert held.insert("r", pa.table({"c0": pa.nulls(0), "c1": empty, "c2": pa.nulls(0)})) == 0
    # A value that no row has is no fault.
    unused = pa.DictionaryArray.from_arrays(pa.array([0, 0, 0]), pa.array([1, 2**40, None]))
    assert held.insert("r", pa.table({**good, "c0": unused})) == 3
    # Nothing of the refused frames is pending.
    assert set(held.commit()["r"].added) == {(1, "a", 0.5), (1, "b", 1.5), (1, "c", 2.5)}


def test_a_stream_that_fails_inserts_nothing() -> None:
    def batches() -> Any:
        yield pa.record_batch({"c0": [1]})
        raise OSError("the disk is gone")

    held = session(["number"])
    with pytest.raises(ValueError, match="the disk is gone"):
        held.insert("r", pa.RecordBatchReader.from_batches(pa.schema([("c0", pa.int64())]), batches()))
    assert held.commit() == {}


def test_frames_obey_the_memory_limit() -> None:
    held = session(["number"], max_bytes=1 << 20)
    with pytest.raises(LimitError):
        held.insert("r", pa.table({"c0": pa.array(range(200_000))}))
    names = session(["symbol"], max_bytes=1 << 20)
    with pytest.raises(LimitError):
        names.insert("r", pa.table({"c0": [f"{n:0100}" for n in range(20_000)]}))
    assert (held.commit(), names.commit()) == ({}, {})
