"""Arguments and files that claim far more memory than there is: each is refused, and none ends the interpreter."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import needs

import logicity
from logicity import LimitError, Program, Session

#: The address space of a child process, in bytes. Less than what the inputs claim.
SPACE = 3 << 30

EDGES = """.decl edge(x: number, y: number)
.input edge
.decl name(x: symbol)
.input name
.decl on()
.input on
"""


def in_child(code: str, *arguments: object) -> str:
    """Run Python code in a process with a limited address space, and return what it prints."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({SPACE}, {SPACE}))\n"
    command = [sys.executable, "-c", limit + code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


#: Rows that take more than a MiB, or have no end.
LARGE: dict[str, Callable[[], tuple[str, Any]]] = {
    "endless": lambda: ("edge", ((x % 2**31, 0) for x in itertools.count())),
    # All rows are the same memory.
    "strides": lambda: ("edge", np.broadcast_to(np.int32(1), (2**40, 2))),
    "columns": lambda: ("edge", {"x": np.broadcast_to(np.int8(1), 2**50), "y": np.broadcast_to(np.int8(1), 2**50)}),
    "texts": lambda: ("name", ((str(x),) for x in itertools.count())),
    "long texts": lambda: ("name", (("x" * 2**18 + str(x),) for x in itertools.count())),
    "array of texts": lambda: ("name", np.broadcast_to(np.array("x" * 2**10), (2**40, 1))),
}


@pytest.mark.parametrize("name", LARGE)
def test_rows_beyond_the_limit_are_not_inserted(name: str) -> None:
    session = Session(Program(EDGES), max_bytes=1 << 20)
    relation, rows = LARGE[name]()
    with pytest.raises(LimitError, match="(?s)the inserted rows take more than 1 MiB.*raise the limit `max_bytes`"):
        session.insert(relation, rows)
    session.insert("on", [()])
    session.commit()
    assert session.count(relation) == 0 and session.count("on") == 1


def test_rows_of_another_length_are_refused() -> None:
    session = Session(Program(EDGES))
    rows: list[tuple[Any, str]] = [((1, 2, 3), "3"), ((1,), "1"), (itertools.count(), "more")]
    for row, count in rows:
        with pytest.raises(ValueError, match=f"row 0: a row of `edge` must have 2 values, not {count}$"):
            session.insert("edge", [row])
    # A predicate without columns has one row at most.
    assert session.insert("on", np.empty((2**40, 0))) == 2**40
    session.commit()
    assert session.count("on") == 1


def test_rows_of_arrays_are_converted_in_parts() -> None:
    """More rows than are converted together."""
    count = 200_000
    rng = np.random.default_rng(0)
    numbers = rng.integers(-(2**31), 2**31, (count, 2))
    session = Session(Program(EDGES))
    assert session.insert("edge", numbers.astype(">i8")) == count
    names = np.char.add("n", numbers[:, 0].astype(str))
    session.insert("name", {"x": names})
    session.commit()
    assert set(session.rows("edge")) == set(map(tuple, numbers.tolist()))
    assert {name for (name,) in session.rows("name")} == set(names.tolist())
    numbers[150_000, 1] = 2**31
    with pytest.raises(ValueError, match="row 150000: .*; 2147483648 is out of range"):
        session.insert("edge", numbers)
    objects = names.astype(object)
    objects[150_001] = 3
    with pytest.raises(TypeError, match="row 150001: .*, not 3"):
        session.insert("name", {"x": objects})


def test_a_search_for_a_reason_obeys_the_limits() -> None:
    rules = """.decl q(x: symbol, n: number)
    .input q
    .decl r(x: symbol)
    r("A") :- q("A", 0).
    r(x) :- r(cat(x, x)), q(x, n).
    """
    for limits in ({"max_bytes": 1 << 20}, {"max_steps": 1000}):
        session = Session(Program(rules), **limits)
        session.commit()
        with pytest.raises(LimitError):
            session.why_not("r", ("A",))
        # The session works as before.
        assert session.count("r") == 0


@pytest.mark.parametrize("count", [2**16 + 1, 10**12, 2**64])
def test_too_many_environments_are_refused(count: int) -> None:
    message = f"num_envs: expected 1 to 65536, not {count}"
    makers: list[Callable[[], object]] = [
        lambda: logicity.envs.SPFVectorEnv(count, "easy"),
        lambda: gymnasium.make_vec("logicity/SPF-Easy-v0", num_envs=count),
    ]
    for make in makers:
        with pytest.raises(ValueError, match=message):
            make()


def test_too_many_steps_are_not_collected() -> None:
    envs = logicity.envs.SPFVectorEnv(4, "easy", autoreset_mode="SameStep")
    envs.reset(seed=0)
    width = len(logicity.observation_names("easy"))
    layers = [(np.zeros((width, 5), np.float32), np.zeros(5, np.float32))]
    network = logicity._logicity.PolicyNetwork(width, np.arange(width)[None], layers)
    with pytest.raises(ValueError, match="expected at most 4194304 steps in all environments, not 4 x 1099511627776"):
        envs.collect(network, np.broadcast_to(np.float32(0), (4, 2**40)))


def _change(state: Any, key: str, value: Any) -> Any:
    state[0][key] = value
    return state


#: What others could put in place of the states of two environments.
STATES: dict[str, Callable[[Any], Any]] = {
    "nothing": lambda _: [{}, {}],
    "text": lambda _: "ab",
    "negative": lambda state: _change(state, "source", [-1, 0]),
    "large": lambda state: _change(state, "source", [0, 2**64]),
    "short": lambda state: _change(state, "source", [0]),
    "no digits": lambda state: _change(state, "actions", "xy"),
    "no actions": lambda state: _change(state, "actions", "ff"),
    "too many actions": lambda state: _change(state, "actions", "01" * 100_000),
    "no episode": lambda state: _change(state, "episode", {"agents": 3}),
    "no mapping": lambda state: _change(state, "episode", 3),
}


@pytest.mark.parametrize("name", STATES)
def test_states_of_others_are_refused(name: str) -> None:
    envs = logicity.envs.SPFVectorEnv(2, "easy")
    envs.reset(seed=0)
    before = envs.state()
    with pytest.raises((ValueError, gymnasium.error.InvalidAction)) as caught:
        envs.restore(STATES[name](envs.state()))
    assert name != "too many actions" or "actions follow the end of the episode" in str(caught.value)
    assert envs.state() == before


def test_a_table_that_claims_many_steps_is_refused(tmp_path: Path) -> None:
    pyarrow = needs("pyarrow", "offline")
    parquet = needs("pyarrow.parquet", "offline")
    examples, small = tmp_path / "steps.parquet", tmp_path / "small.parquet"
    logicity.demonstrations("easy", 40, "val").to_parquet(examples)
    table = parquet.read_table(examples)
    # Steps without a bit set take few bytes.
    zeros = pyarrow.array(np.zeros(table.num_rows * 85, np.float32))
    table = table.set_column(2, table.schema.field(2), pyarrow.FixedSizeListArray.from_arrays(zeros, 85))
    parquet.write_table(table, small)
    content = small.read_bytes()
    data = content[: -8 - int.from_bytes(content[-8:-4], "little")]
    # A footer that names the same rows again and again.
    claimed = parquet.read_metadata(small)
    for _ in range(13):
        claimed.append_row_groups(claimed)
    claimed.write_metadata_file(tmp_path / "footer")
    path = tmp_path / "large.parquet"
    path.write_bytes(data + (tmp_path / "footer").read_bytes()[4:])
    assert path.stat().st_size < 2**25 and claimed.num_rows * 85 * 4 > 2**32
    said = in_child(
        "import sys, logicity\ntry: logicity.induce(sys.argv[1])\nexcept logicity.LimitError as error: print(error)",
        path,
    )
    assert "error[limit-exceeded]: the steps take" in said and "split the table" in said, said
