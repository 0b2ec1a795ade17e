"""Datalog without a city: programs, sessions that keep facts, and why a fact holds or does not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, cast, overload

import numpy.typing as npt

from . import _logicity
from .types import Clause, Diagnostic, StratumWork

__all__ = ["Change", "Column", "Explanation", "Program", "Relation", "Rows", "Session", "check"]

Row = tuple[str | int | float, ...]
"""A row: str for symbols, int for numbers and unsigned numbers, float for floats."""

RowsLike = Iterable[Sequence[object]] | npt.NDArray[Any] | Mapping[str, npt.ArrayLike]
"""Rows as :meth:`Session.insert` takes them."""


def check(text: str, name: str = "<text>") -> list[Diagnostic]:
    """Find all faults and warnings of a rule text.

    `name` is the file name shown in the diagnostics; `.include` is relative to its folder. An empty list means that
    there is nothing to say against the rules.
    """
    return cast(list[Diagnostic], _logicity.check(text, name))


def rule_file(rules: str | os.PathLike[str] | None) -> str | None:
    """Return the path of a rule file, unless it is a text of rules."""
    if isinstance(rules, str) and ("\n" in rules or ":-" in rules):
        raise ValueError(
            "`rules` is the path of a rule file, not a text of rules: write it to a file; `check` takes it as it is"
        )
    return None if rules is None else os.fspath(rules)


@dataclass(frozen=True)
class Column:
    """A column of a predicate: its declared type, and what values of that type are made of."""

    name: str
    type: str
    base: Literal["symbol", "number", "unsigned", "float"]


@dataclass(frozen=True)
class Relation:
    """A declared predicate, where it is declared, and whether it is input, output, or head of a clause with a body."""

    name: str
    columns: tuple[Column, ...]
    input: bool
    output: bool
    derived: bool
    doc: str
    file: str
    line: int


class Program:
    """Rules, checked and planned. Immutable; any number of sessions can run it, also in several threads.

    An `.input` predicate may have rules as well, as for `logicity query`: it then holds what is inserted and what
    follows.

    Programs can be pickled and copied: they are made again from their texts, without reading a file.

    Parameters
    ----------
    text
        The rules.
    name
        The file name shown in messages; `.include` is relative to its folder.

    Raises
    ------
    InputError
        For faulty rules, with all faults of all files.

    """

    def __init__(self, text: str, name: str = "<text>") -> None:
        """Check and plan the rules."""
        self._program = _logicity.Program([(name, text)])

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Program:
        """Read a rule file and all it includes.

        If there is no such file, the built-in one of that name is taken, for example `rules/expert.dl`.

        Raises `InputError` for faulty rules and `OSError` (`FileNotFoundError`) for a file that cannot be read.
        """
        return cls(_logicity.read_file(path), os.fspath(path))

    @classmethod
    def _restore(cls, files: list[tuple[str, str]]) -> Program:
        program = cls.__new__(cls)
        program._program = _logicity.Program(files)
        return program

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the texts."""
        return type(self)._restore, (self._program.files(),)

    def __repr__(self) -> str:
        """Tell name and size."""
        return f"<Program {self._program.files()[0][0]}: {len(self.relations)} predicates, {len(self.clauses)} clauses>"

    @property
    def relations(self) -> dict[str, Relation]:
        """The declared predicates by name, in the order of the text."""
        relations = {}
        for told in self._program.relations():
            columns = tuple(Column(**column) for column in told.pop("columns"))
            relations[told["name"]] = Relation(columns=columns, **told)
        return relations

    @property
    def strata(self) -> list[list[str]]:
        """Predicates with clauses, in the order they are computed; those of one list depend on each other."""
        return self._program.strata()

    @property
    def clauses(self) -> list[Clause]:
        """The clauses and facts of the text, in its order."""
        return cast(list[Clause], self._program.clauses())

    @property
    def warnings(self) -> list[Diagnostic]:
        """What is probably not meant so."""
        return cast(list[Diagnostic], self._program.warnings())

    def plan(self) -> str:
        """Tell how every clause is evaluated as long as there are few rows; see `Session.plan`."""
        return self._program.plan()


class Rows(Sequence[Row]):
    """Rows that a commit added or removed, in the order of their words (symbols: the order they were first seen).

    Converted when they are looked at, so that nothing is paid for those that are not; while the session is at work in
    another thread that is a `RuntimeError`. Equal to a list of the same tuples.
    """

    def __init__(self, rows: _logicity.Rows) -> None:
        """Wrap rows of a session."""
        self._rows = rows

    def __len__(self) -> int:
        """Count them."""
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        """Get one as a tuple, or a list of some."""
        if isinstance(index, slice):
            start, stop, step = index.indices(len(self))
            if step == 1:
                return cast(list[Row], self._rows.tuples(start, stop))
            return cast(list[Row], self._rows.tuples(0, len(self))[index])
        position = range(len(self))[index]
        return cast(Row, self._rows.tuples(position, position + 1)[0])

    def __iter__(self) -> Iterator[Row]:
        """Go through all, as tuples."""
        return iter(self[:])

    def __eq__(self, other: object) -> bool:
        """Compare with a sequence of tuples."""
        if isinstance(other, (list, tuple, Rows)):
            return len(self) == len(other) and self[:] == list(other)
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Show the first few."""
        shown = [repr(row) for row in self[:5]] + ["..."] * (len(self) > 5)
        return f"[{', '.join(shown)}]"

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Get an array for each column, as `Session.columns` does."""
        return self._rows.columns()


@dataclass(frozen=True)
class Change:
    """What a commit changed in a predicate: rows that hold now and did not, and rows that held and do not now."""

    added: Rows
    removed: Rows


@dataclass(frozen=True)
class Explanation:
    """Why a fact holds, or why it does not.

    `text` (and `str()`) is a tree of lines for readers. `nodes` is the same as data, the first being what was asked;
    nodes refer to each other by position. A node is

    - `{"holds", "height", "by": "input" | "text" | "clause" | "range", "clause", "binding", "premises"}`, or
    - `{"absent", "because": "not-a-fact" | "no-clause" | "not-looked-into" | "range", "clauses"}`, where each of
      `clauses` has a `clause`, the nearest `binding`, and under `fails` the literals that fail.

    An entry of `premises` and `fails` has the `literal` as it reads under the binding, its `kind` (`fact`, `in-view`,
    `not`, `comparison`, `expression`, `aggregate`) and, but for the last three, the `node` that tells why it holds or
    does not.
    """

    fact: str
    holds: bool
    text: str
    nodes: list[dict[str, Any]]

    def __str__(self) -> str:
        """Tell it as a tree of lines."""
        return self.text


class Session:
    """Facts, and what follows from them.

    `insert` and `retract` note changes, which nobody sees before `commit`; all questions are answered as of the last
    commit. A commit follows the change where that is cheaper than recomputing. The facts in the text of the program
    hold from the first commit on.

    One thread at a time: a second one gets a `RuntimeError`. Long work lets other threads of Python run and ends at
    once on Ctrl-C. Sessions cannot be pickled or copied; pickle the program, and the facts.

    Parameters
    ----------
    program
        What follows from the facts.
    threads
        How many evaluate; 0 is one for each core. Answers are the same.
    max_rows
        No more rows than this are derived; by default 100,000,000.
    max_steps
        No more rows than this are looked at in a commit; by default 100,000,000,000, which takes some minutes.
    max_bytes
        Rows, indexes and texts take no more than this; by default 4 GiB. The process may need about three times as
        much.

    Raises
    ------
    RuntimeError
        If so many threads cannot be started.
    OverflowError
        For a negative number.

    """

    def __init__(
        self,
        program: Program,
        threads: int = 1,
        *,
        max_rows: int | None = None,
        max_steps: int | None = None,
        max_bytes: int | None = None,
    ) -> None:
        """Begin without inserted facts and without a commit."""
        self._program = program
        self._session = _logicity.Session(program._program, threads, max_rows, max_steps, max_bytes)

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied."""
        raise TypeError("a Session cannot be pickled or copied: pickle its program and insert the facts again")

    @property
    def program(self) -> Program:
        """The program."""
        return self._program

    def insert(self, relation: str, rows: RowsLike) -> int:
        """Note that rows hold from the next commit on; of several notes about a row the last one counts.

        Parameters
        ----------
        relation
            A predicate that no rule derives, or one that is `.input`.
        rows
            One of

            - an iterable of tuples or lists, with a value for each column: str for a symbol, int for a number (32
              bits, signed) or an unsigned number (32 bits), float or int for a float, which is rounded to 32 bits.
              NaN and infinities are floats.
            - an array of shape (n, columns), if one dtype suits all columns;
            - a structured array of shape (n,), whose fields are named as the columns are, in any order;
            - a mapping from the names of all columns to arrays of shape (n,).

            In arrays, symbols are str (dtype `U`, `StringDType`, or `object` with str in it), numbers and unsigned
            numbers any integers, floats any floats or integers.

        Returns
        -------
        int
            How many rows there were.

        Raises
        ------
        KeyError
            For a predicate that is not declared.
        TypeError
            For a value or dtype of the wrong kind; bool is no number.
        ValueError
            For a number out of range, a row or array of the wrong shape, or a predicate that rules derive. If
            anything is raised, none of the rows is noted.

        """
        return self._session.insert(relation, rows)

    def retract(self, relation: str, rows: RowsLike) -> int:
        """Note that rows do not hold from the next commit on, unless they stand in the text or follow from others.

        Takes, returns and raises what `insert` does. Rows that do not hold are no fault.
        """
        return self._session.retract(relation, rows)

    def rollback(self) -> None:
        """Forget what was noted since the last commit."""
        self._session.rollback()

    def commit(self) -> dict[str, Change]:
        """Make true what was noted, and derive what follows.

        Returns
        -------
        dict
            By predicate, base or derived, exactly what became true and what stopped being true; predicates that did
            not change are left out.

        Raises
        ------
        LimitError
            If that takes more than the limits allow; the diagnostic names the clause.
        KeyboardInterrupt
            On Ctrl-C.

        If it raises, the session is as before, with the same changes noted; `rollback` forgets them.

        """
        changes = self._session.commit()
        return {name: Change(Rows(added), Rows(removed)) for name, (added, removed) in changes.items()}

    def rows(self, relation: str) -> list[Row]:
        """Get the rows that hold, as tuples, in the order of their words (symbols: the order they were first seen).

        Raises `KeyError` for a predicate that is not declared.
        """
        return cast(list[Row], self._session.tuples(relation))

    def columns(self, relation: str) -> dict[str, npt.NDArray[Any]]:
        """Get the rows that hold as an array of shape (n,) for each column, in the order of `rows`.

        The dtype is int32 for numbers, uint32 for unsigned numbers, float32 for floats, and object (str) for symbols.
        The arrays are copies.

        Raises `KeyError` for a predicate that is not declared.
        """
        return self._session.columns(relation)

    def count(self, relation: str) -> int:
        """Count the rows that hold. Raises `KeyError` for a predicate that is not declared."""
        return self._session.count(relation)

    def contains(self, relation: str, row: Sequence[object]) -> bool:
        """Tell whether a row holds. Raises what `insert` raises for a row that cannot be one of the predicate."""
        return self._session.contains(relation, row)

    @overload
    def explain(self, fact: str) -> Explanation: ...
    @overload
    def explain(self, fact: str, row: Sequence[object]) -> Explanation: ...
    def explain(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Tell why a fact holds: a shortest proof, down to inserted facts and facts of the text.

        If it does not hold, the explanation tells why not; `holds` says which of the two it is.

        Parameters
        ----------
        fact
            A fact as in a rule file, such as `path("a", _)`, where `_` is any value; or the name of a predicate.
        row
            In the latter case its values, where `None` is any value.

        Raises
        ------
        InputError
            For a text that is no fact of the program, or (`LimitError`) if the search takes too many steps.
        KeyError, TypeError, ValueError
            As `insert`.

        """
        return Explanation(*self._session.explain(fact, row, False))

    @overload
    def why_not(self, fact: str) -> Explanation: ...
    @overload
    def why_not(self, fact: str, row: Sequence[object]) -> Explanation: ...
    def why_not(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Tell why a fact does not hold: for every clause, which literals fail under the nearest binding.

        If it does hold, the explanation tells why. Otherwise as `explain`.
        """
        return Explanation(*self._session.explain(fact, row, True))

    @property
    def work(self) -> list[StratumWork]:
        """What the last successful commit did, stratum by stratum; empty before the first."""
        return cast(list[StratumWork], self._session.work())

    def plan(self) -> str:
        """Tell how every clause is evaluated, for relations of the sizes they have now."""
        return self._session.plan()
