"""Datalog without a city: programs, sessions that maintain facts, and explanations."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, cast, overload

import numpy.typing as npt

from . import _logicity
from .types import Clause, Diagnostic, StratumStats

__all__ = ["Change", "Column", "Explanation", "Program", "Relation", "Rows", "Session", "check"]

Row = tuple[str | int | float, ...]
"""A row: str for symbols, int for numbers and unsigned numbers, float for floats."""

RowsLike = Iterable[Sequence[object]] | npt.NDArray[Any] | Mapping[str, npt.ArrayLike]
"""Rows in the forms that `Session.insert` accepts."""


def check(text: str, name: str = "<text>") -> list[Diagnostic]:
    """Return the faults and warnings of a rule text; an empty list if there are none.

    Args:
        text: The rules.
        name: The file name in the diagnostics. `.include` is relative to its folder.
    """
    return cast(list[Diagnostic], _logicity.check(text, name))


def rule_file(rules: str | os.PathLike[str] | None) -> str | None:
    """Return the path of a rule file.

    Raises:
        ValueError: If `rules` is source text.
    """
    if isinstance(rules, str) and ("\n" in rules or ":-" in rules):
        raise ValueError(
            "`rules` must be the path of a rule file, not a text of rules: write them to a file; `check` accepts texts"
        )
    return None if rules is None else os.fspath(rules)


@dataclass(frozen=True)
class Column:
    """A column of a predicate: its declared type, and the base type of its values."""

    name: str
    type: str
    base: Literal["symbol", "number", "unsigned", "float"]


@dataclass(frozen=True)
class Relation:
    """A declared predicate, its place, and whether it is input, output, or head of a clause with a body."""

    name: str
    columns: tuple[Column, ...]
    input: bool
    output: bool
    derived: bool
    doc: str
    file: str
    line: int


class Program:
    """Checked and planned rules. Immutable: several sessions and threads can share one program.

    An `.input` predicate may have rules, too, as in `logicity query`. It then holds both the inserted and the derived
    rows.

    Pickling and copying store the texts, so a copy reads no file.

    Args:
        text: The rules.
        name: The file name in messages. `.include` is relative to its folder.

    Raises:
        InputError: If the rules are invalid. The diagnostics list the errors of all files.
    """

    def __init__(self, text: str, name: str = "<text>") -> None:
        """Check and plan the rules."""
        self._program = _logicity.Program([(name, text)])

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Program:
        """Read a rule file and its includes.

        A path that does not exist may name a built-in file, for example `rules/expert.dl`.

        Raises:
            InputError: If the rules are invalid.
            OSError: If a file cannot be read (`FileNotFoundError` if it does not exist).
        """
        return cls(_logicity.read_file(path), os.fspath(path))

    @classmethod
    def _restore(cls, files: list[tuple[str, str]]) -> Program:
        program = cls.__new__(cls)
        program._program = _logicity.Program(files)
        return program

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the texts."""
        return type(self)._restore, (self._program.files(),)

    def __repr__(self) -> str:
        """Show name and size."""
        return f"<Program {self._program.files()[0][0]}: {len(self.relations)} predicates, {len(self.clauses)} clauses>"

    @property
    def relations(self) -> dict[str, Relation]:
        """The declared predicates by name, in the order of the text."""
        relations = {}
        for relation in self._program.relations():
            columns = tuple(Column(**column) for column in relation.pop("columns"))
            relations[relation["name"]] = Relation(columns=columns, **relation)
        return relations

    @property
    def strata(self) -> list[list[str]]:
        """The derived predicates in order of evaluation; those of one list depend on each other."""
        return self._program.strata()

    @property
    def clauses(self) -> list[Clause]:
        """The clauses and facts of the text, in its order."""
        return cast(list[Clause], self._program.clauses())

    @property
    def warnings(self) -> list[Diagnostic]:
        """The warnings about the rules."""
        return cast(list[Diagnostic], self._program.warnings())

    def plan(self) -> str:
        """Return the initial plan of every clause, for few rows; see `Session.plan`."""
        return self._program.plan()


class Rows(Sequence[Row]):
    """Rows that a commit added or removed, sorted by their words (for symbols: the order of interning).

    Rows are converted on access; access while the session works in another thread raises `RuntimeError`. Equal to a
    list of the same tuples.
    """

    def __init__(self, rows: _logicity.Rows) -> None:
        """Wrap rows of a session."""
        self._rows = rows

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> list[Row]: ...
    def __getitem__(self, index: int | slice) -> Row | list[Row]:
        """Return a row as a tuple, or a list of rows."""
        if isinstance(index, slice):
            start, stop, step = index.indices(len(self))
            if step == 1:
                return cast(list[Row], self._rows.tuples(start, stop))
            return cast(list[Row], self._rows.tuples(0, len(self))[index])
        position = range(len(self))[index]
        return cast(Row, self._rows.tuples(position, position + 1)[0])

    def __iter__(self) -> Iterator[Row]:
        """Iterate over tuples."""
        return iter(self[:])

    def __eq__(self, other: object) -> bool:
        """Compare with a sequence of tuples."""
        if isinstance(other, (list, tuple, Rows)):
            return len(self) == len(other) and self[:] == list(other)
        return NotImplemented

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Show the first rows."""
        shown = [repr(row) for row in self[:5]] + ["..."] * (len(self) > 5)
        return f"[{', '.join(shown)}]"

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return an array for each column, as `Session.columns` does."""
        return self._rows.columns()


@dataclass(frozen=True)
class Change:
    """The change of a predicate in a commit: rows that began to hold, and rows that ceased to hold."""

    added: Rows
    removed: Rows


@dataclass(frozen=True)
class Explanation:
    """An explanation of why a fact holds, or why it does not.

    Attributes:
        text: A tree of lines for readers, also `str()`.
        nodes: The same as data. The first node is the fact in question; nodes refer to each other by position. A node
            that holds is `{"holds", "height", "by": "input" | "text" | "clause" | "range", "clause", "binding",
            "premises"}`. Another is `{"absent", "because": "not-a-fact" | "no-clause" | "not-looked-into" | "range",
            "clauses"}`, where each of `clauses` has a `clause`, the nearest `binding`, and under `fails` the literals
            that fail. An entry of `premises` and `fails` has the `literal` under the binding, its `kind` (`fact`,
            `in-view`, `not`, `comparison`, `expression`, `aggregate`) and, except for the last three kinds, the `node`
            that explains it.
    """

    fact: str
    holds: bool
    text: str
    nodes: list[dict[str, Any]]

    def __str__(self) -> str:
        """Return the tree of lines."""
        return self.text


class Session:
    """A database: facts, and the facts that follow from them.

    `insert` and `retract` collect changes, which `commit` applies. All queries answer as of the last commit. A commit
    updates derived facts incrementally if that is cheaper than recomputing them. The facts in the text of the program
    hold from the first commit.

    Not thread-safe: concurrent use raises `RuntimeError`. Long calls release the GIL, and Ctrl-C cancels them. A
    session cannot be pickled or copied; pickle its program and the facts instead.

    Args:
        program: The rules.
        threads: The number of threads; 0 means one for each core. Answers are the same.
        max_rows: The limit of derived rows; by default 100,000,000.
        max_steps: The limit of rows that a commit reads; by default 100,000,000,000, which take some minutes.
        max_bytes: The limit of memory for rows, indexes and texts; by default 4 GiB. The process may need about three
            times as much.

    Raises:
        OverflowError: If a number is negative.
        RuntimeError: If the threads cannot be started.
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
        """Refuse to pickle and to copy."""
        raise TypeError("a Session cannot be pickled or copied: pickle its program and insert the facts again")

    @property
    def program(self) -> Program:
        """The program."""
        return self._program

    def insert(self, relation: str, rows: RowsLike) -> int:
        """Insert rows, from the next commit. The last change of a row counts.

        Args:
            relation: A predicate that no rule derives, or one that is `.input`.
            rows: One of the following. In arrays, symbols are str (dtype `U`, `StringDType`, or `object` with str),
                numbers and unsigned numbers are any integers, floats are any floats or integers.

                - an iterable of tuples or lists, with a value for each column: str for a symbol, int for a number (32
                  bits, signed) or an unsigned number (32 bits), float or int for a float, which is rounded to 32 bits.
                  NaN and infinities are floats;
                - an array of shape (n, columns), if one dtype fits all columns;
                - a structured array of shape (n,), whose fields have the names of the columns, in any order;
                - a mapping from the names of all columns to arrays of shape (n,).

        Returns:
            The number of given rows.

        Raises:
            KeyError: If the predicate is not declared.
            TypeError: If a value or dtype does not match its column; bool is not a number.
            ValueError: If a number is out of range, a row or array has the wrong shape, or rules derive the predicate.
                No row is inserted then.
        """
        return self._session.insert(relation, rows)

    def retract(self, relation: str, rows: RowsLike) -> int:
        """Retract rows, from the next commit. A row still holds if it is in the text or follows from other rows.

        Rows that do not hold are accepted. Arguments, return value and exceptions are those of `insert`.
        """
        return self._session.retract(relation, rows)

    def rollback(self) -> None:
        """Discard the changes since the last commit."""
        self._session.rollback()

    def commit(self) -> dict[str, Change]:
        """Apply the changes, and derive what follows.

        After an exception the session is as before, with the same pending changes; `rollback` discards them.

        Returns:
            The exact changes by predicate, base or derived. Predicates without changes are absent.

        Raises:
            KeyboardInterrupt: On Ctrl-C.
            LimitError: If the evaluation exceeds a limit. The diagnostic names the clause.
        """
        changes = self._session.commit()
        return {name: Change(Rows(added), Rows(removed)) for name, (added, removed) in changes.items()}

    def rows(self, relation: str) -> list[Row]:
        """Return the rows of a predicate as tuples, sorted by their words (for symbols: the order of interning).

        Raises:
            KeyError: If the predicate is not declared.
        """
        return cast(list[Row], self._session.tuples(relation))

    def columns(self, relation: str) -> dict[str, npt.NDArray[Any]]:
        """Return the rows of a predicate as an array of shape (n,) for each column, in the order of `rows`.

        The dtype is int32 for numbers, uint32 for unsigned numbers, float32 for floats, and object (str) for symbols.
        The arrays are copies.

        Raises:
            KeyError: If the predicate is not declared.
        """
        return self._session.columns(relation)

    def count(self, relation: str) -> int:
        """Return the number of rows of a predicate.

        Raises:
            KeyError: If the predicate is not declared.
        """
        return self._session.count(relation)

    def contains(self, relation: str, row: Sequence[object]) -> bool:
        """Return whether a row holds.

        Raises:
            KeyError: If the predicate is not declared.
            TypeError: As for `insert`.
            ValueError: As for `insert`.
        """
        return self._session.contains(relation, row)

    @overload
    def explain(self, fact: str) -> Explanation: ...
    @overload
    def explain(self, fact: str, row: Sequence[object]) -> Explanation: ...
    def explain(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Explain why a fact holds: a shortest proof, down to inserted facts and facts of the text.

        If the fact does not hold, the explanation is that of `why_not`; `holds` distinguishes the two.

        Args:
            fact: A fact in the syntax of rules, such as `path("a", _)`, where `_` matches any value; or the name of a
                predicate.
            row: With the name of a predicate, its values, where `None` is any value.

        Raises:
            InputError: If the text is not a fact of the program.
            LimitError: If the search takes too many steps.
            KeyError: As for `insert`.
            TypeError: As for `insert`.
            ValueError: As for `insert`.
        """
        return Explanation(*self._session.explain(fact, row, False))

    @overload
    def why_not(self, fact: str) -> Explanation: ...
    @overload
    def why_not(self, fact: str, row: Sequence[object]) -> Explanation: ...
    def why_not(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Explain why a fact does not hold: for every clause, the literals that fail under the nearest binding.

        If the fact holds, the explanation is that of `explain`.

        Args:
            fact: As for `explain`.
            row: As for `explain`.

        Raises:
            InputError: As for `explain`.
            KeyError: As for `insert`.
            TypeError: As for `insert`.
            ValueError: As for `insert`.
        """
        return Explanation(*self._session.explain(fact, row, True))

    @property
    def work(self) -> list[StratumStats]:
        """The work of the last successful commit, by stratum; empty before the first."""
        return cast(list[StratumStats], self._session.work())

    def plan(self) -> str:
        """Return the plan of every clause, for relations of their current sizes."""
        return self._session.plan()
