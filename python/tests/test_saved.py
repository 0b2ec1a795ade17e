"""Sessions in files."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from logicity import LimitError, Program, Session

RULES = """
.decl edge(x: symbol, y: symbol)
.input edge
.decl path(x: symbol, y: symbol)
path(x, y) :- edge(x, y).
path(x, z) :- path(x, y), edge(y, z).
.decl lately(x: symbol)
lately(x) :- once[1,2] edge(x, _).
"""


def play(held: Session, rng: random.Random) -> object:
    """Make random changes, and return what they change."""
    held.insert("edge", [(rng.choice("abcdef"), rng.choice("abcdef")) for _ in range(3)])
    held.retract("edge", [(rng.choice("abcdef"), rng.choice("abcdef")) for _ in range(3)])
    changes = held.advance() if rng.random() < 0.5 else held.commit()
    return {predicate: (list(change.added), list(change.removed)) for predicate, change in changes.items()}


def test_a_loaded_session_continues(tmp_path: Path) -> None:
    program = Program(RULES)
    held, rng = Session(program), random.Random(1)
    for step in range(10):
        play(held, rng)
        held.insert("edge", [("pending", str(step))])
        held.save(tmp_path / "session")
        copy = Session.load(program, tmp_path / "session", threads=2)
        assert (copy.tick, copy.program) == (held.tick, program)
        for predicate in program.predicates:
            assert copy.rows(predicate) == held.rows(predicate)
        state = rng.getstate()
        changes = play(held, rng)
        rng.setstate(state)
        assert play(copy, rng) == changes
        assert copy.explain("path", held.rows("path")[0]).holds


def test_files_that_cannot_be_loaded(tmp_path: Path) -> None:
    program, path = Program(RULES), tmp_path / "session"
    held = Session(program)
    held.insert("edge", [(str(n), str(n + 1)) for n in range(50)])
    held.commit()
    held.save(path)
    good = path.read_bytes()
    with pytest.raises(ValueError, match=r"cannot load `.*session`: the saved session is one of another program$"):
        Session.load(Program(RULES.replace("edge(x, _)", "edge(_, x)")), path)
    with pytest.raises(LimitError, match="while loading `.*session`"):
        Session.load(program, path, max_bytes=5000)
    bad = tmp_path / "bad"
    for content, message in (
        (b"", "it is no saved session"),
        (b"name,value\n", "it is no saved session"),
        (good[:-1], "the saved session is incomplete"),
        (good[:60] + b"!" + good[61:], "the saved session is (damaged|incomplete)"),
        (good[:16] + b"\x07\0\0\0" + good[20:], "has format 7; this version reads format 1"),
    ):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            Session.load(program, bad)
    with pytest.raises(FileNotFoundError, match="no such file"):
        Session.load(program, tmp_path / "missing")
    with pytest.raises(TypeError, match="expected a Program, not str"):
        Session.load(RULES, path)  # type: ignore[arg-type]


def test_files_of_others_are_kept(tmp_path: Path) -> None:
    held = Session(Program(RULES))
    held.commit()
    path = tmp_path / "session"
    held.save(path)
    held.save(path)
    path.write_text("mine")
    with pytest.raises(FileExistsError, match="overwrite"):
        held.save(path)
    assert path.read_text() == "mine"
    held.save(path, overwrite=True)
    assert Session.load(held.program, path).rows("edge") == []
    assert [each.name for each in tmp_path.iterdir() if each.suffix == ".tmp"] == []
