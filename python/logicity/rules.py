"""The Datalog engine: programs, sessions that maintain facts incrementally, and explanations."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, Protocol, cast, overload

import numpy.typing as npt

from . import _logicity
from .errors import checked_integer, checked_limits, checked_path, checked_threads
from .types import Clause, Diagnostic, StratumStats

__all__ = ["Change", "Column", "Explanation", "Marginals", "Predicate", "Program", "Rows", "Session", "check"]

Row = tuple[str | int | float | tuple[Any, ...] | None, ...]
"""A row: str for symbols, int for numbers and unsigned numbers, and float for floats.

A record is a tuple of its fields, behind the name of its branch if its type has branches; `nil` is None.
"""

Functors = Mapping[str, Callable[..., Iterable[Any]]]
"""The functions for functors, by name."""


class ArrowStream(Protocol):
    """What exports Arrow data as a stream."""

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return a capsule with a stream of Arrow arrays."""


class ArrowArray(Protocol):
    """What exports Arrow data as one array."""

    def __arrow_c_array__(self, requested_schema: object | None = None) -> tuple[object, object]:
        """Return capsules with a schema and an Arrow array."""


RowsLike = Iterable[Sequence[object]] | npt.NDArray[Any] | Mapping[str, npt.ArrayLike] | ArrowStream | ArrowArray
"""Rows in the forms that `Session.insert` accepts."""


def check(text: str, name: str = "<text>") -> list[Diagnostic]:
    """Return the errors and warnings of rules.

    Args:
        text: The source of the rules.
        name: The file name in the diagnostics. `.include` paths are relative to its folder.

    Raises:
        ValueError: If `text` is the path of a file.
    """
    path = isinstance(text, str) and re.fullmatch(r"(?!//)[^\n\"():%]+\.(dl|ya?ml)", text.strip())
    if path or isinstance(text, os.PathLike):
        remedy = "read the file, as in `check(Path(path).read_text(), path)`"
        raise ValueError(f"text: `{os.fspath(text)}` looks like a path: {remedy}")
    return cast(list[Diagnostic], _logicity.check(text, name))


def rule_file(rules: str | os.PathLike[str] | None) -> str | None:
    """Return the path of a rule file as a string. Raise `ValueError` if it is source text or a configuration."""
    if isinstance(rules, str) and ("\n" in rules or ":-" in rules):
        remedy = "write it to a file (`check` accepts source text)"
        raise ValueError(f"`rules` must be the path of a rule file, not source text: {remedy}")
    return None if rules is None else rule_path("rules", rules)


def rule_path(name: str, value: str | os.PathLike[str]) -> str:
    """Return an argument that names a rule file as a string. Raise `ValueError` if it is a configuration."""
    path = checked_path(name, value)
    if path.endswith((".yaml", ".yml")):
        remedy = "pass the rule file that its key `rules` names"
        raise ValueError(f"{name}: `{path}` is a configuration, not a rule file; {remedy}")
    return path


@dataclass(frozen=True)
class Column:
    """A column of a predicate: its declared type, and the base type of its values."""

    name: str
    type: str
    base: Literal["symbol", "number", "unsigned", "float"]


@dataclass(frozen=True)
class Predicate:
    """A declared predicate.

    `input` and `output` say whether it is declared `.input` and `.output`, and `derived` whether it is the head of a
    clause with a body. `doc` is the doc comment. `file` and `line` (from 1) are the place of the
    declaration.
    """

    name: str
    columns: tuple[Column, ...]
    input: bool
    output: bool
    derived: bool
    doc: str
    file: str
    line: int


class Program:
    """A checked and planned Datalog program. Immutable: several sessions and threads can share one program.

    An `.input` predicate may also have rules, as in `logicity query`. It then holds both the inserted and the derived
    rows.

    Pickling and copying store the sources, so a copy reads no file.

    Args:
        text: The source of the rules.
        name: The file name in messages. `.include` paths are relative to its folder.
        functors: The functions for the functors that `.functor` declares, by name. A function takes an array for each
            argument, with the dtypes of `Session.columns`, and returns a sequence or array with one value for each
            element, or None where there is none (`nil` for records). Without arguments it returns one value in a list.
            It must return the same value for the same arguments, and may be called often.

    Raises:
        InputError: If the rules are invalid. The diagnostics list the errors of all files.
        ValueError: If the program declares no functor of a given name.
    """

    def __init__(self, text: str, name: str = "<text>", *, functors: Functors | None = None) -> None:
        """Check and plan the rules."""
        self._program = _logicity.Program([(name, text)], list((functors or {}).items()))

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, functors: Functors | None = None) -> Program:
        """Read a rule file and its includes.

        If the path does not exist, it may name a built-in file: `expert`, or `rules/expert.dl`. `functors` has the
        functions for the functors of the program.

        Raises:
            InputError: If the rules are invalid.
            OSError: If a file cannot be read (`FileNotFoundError` if it does not exist).
            ValueError: If the program declares no functor of a given name.
        """
        name, text = _logicity.read_rules(rule_path("path", path))
        return cls(text, name, functors=functors)

    def __getstate__(self) -> tuple[list[tuple[str, str]], list[tuple[str, Any]]]:
        """Return the sources and the functions of functors, which must be picklable."""
        return self._program.files(), self._program.functors()

    def __setstate__(self, state: tuple[list[tuple[str, str]], list[tuple[str, Any]]]) -> None:
        """Check and plan the rules again."""
        self._program = _logicity.Program(*state)

    def __repr__(self) -> str:
        """Show the name, and the numbers of predicates and clauses."""
        name, _ = self._program.files()[0]
        return f"<Program {name}: {len(self.predicates)} predicates, {len(self.clauses)} clauses>"

    @property
    def predicates(self) -> dict[str, Predicate]:
        """The declared predicates by name, in source order."""
        predicates = {}
        for predicate in self._program.predicates():
            columns = tuple(Column(**column) for column in predicate.pop("columns"))
            predicates[predicate["name"]] = Predicate(columns=columns, **predicate)
        return predicates

    @property
    def strata(self) -> list[list[str]]:
        """The strata: derived predicates in order of evaluation. Predicates in one list are mutually recursive."""
        return self._program.strata()

    @property
    def clauses(self) -> list[Clause]:
        """The clauses and facts of the program, in source order."""
        return cast(list[Clause], self._program.clauses())

    @property
    def warnings(self) -> list[Diagnostic]:
        """The warnings about the rules."""
        return cast(list[Diagnostic], self._program.warnings())

    def plan(self) -> str:
        """Return the initial plan of every clause, which assumes few rows. See `Session.plan`."""
        return self._program.plan()

    def to_souffle(self) -> str:
        """Return a plain program for Soufflé: declarations, facts, rules and directives in one text.

        Components, macros and includes are written out, so engines with a part of the language can take it. A name
        that only this language permits gets `_` in place of other characters.

        Raises:
            InputError: If plain Soufflé cannot express a part of the program, with all places.
        """
        return self._program.export(False)

    def to_sql(self) -> str:
        """Return statements for DuckDB that make a table with the rows of each predicate.

        The tables of `.input` predicates may exist before. Recursion becomes `with recursive`.

        Raises:
            InputError: If SQL cannot express a part of the program, with all places: recursion through several
                predicates or that is not linear, some functors, and what `to_souffle` refuses.
        """
        return self._program.export(True)


class Rows:
    """The rows of a predicate, those that a commit added or removed, or those that answer a query.

    They are a sequence of tuples in the order of `Session.rows`, and stay as they are when the session changes. Tuples
    are made when they are accessed. Access while another thread uses the session raises `RuntimeError`. An instance
    equals a list of the same tuples.

    Rows also export Arrow data, so `polars.DataFrame(rows)`, `pyarrow.table(rows)`, `pandas.DataFrame.from_arrow(rows)`
    and `duckdb.sql("from rows")` read them without a Python object for each value.
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
        chosen = range(len(self))[index]
        if isinstance(chosen, int):
            return cast(Row, self._rows.tuples(chosen, chosen + 1)[0])
        if chosen.step == 1:
            return cast(list[Row], self._rows.tuples(chosen.start, chosen.stop))
        return cast(list[Row], self._rows.tuples(0, len(self))[index])

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

    def __reduce__(self) -> NoReturn:
        """Refuse to pickle and to copy."""
        remedy = "use `list(rows)` or `rows.columns()`"
        raise TypeError(f"Rows cannot be pickled or copied, because they belong to a session: {remedy}")

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Return one array per column, as `Session.columns` does."""
        return self._rows.columns()

    def __arrow_c_schema__(self) -> object:
        """Return a capsule with the Arrow schema, for libraries that read Arrow data."""
        return self._rows.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Return a capsule with a stream of Arrow data, for libraries that read it.

        The columns have the names of the predicate's, and the types int32 for numbers, uint32 for unsigned numbers,
        float32 for floats, and large_utf8 for symbols. A record is its text as in files of rows.

        Args:
            requested_schema: A capsule with a schema, to which the values are cast if they can be.

        Raises:
            KeyboardInterrupt: On Ctrl-C.
            ValueError: If the text of a record is longer than 16 MiB.
        """
        return self._rows.__arrow_c_stream__(requested_schema)


def checked_program(program: Program) -> Program:
    """Return a program. Raise `TypeError` if it is none."""
    if not isinstance(program, Program):
        raise TypeError(f"expected a Program, not {type(program).__name__}")
    return program


@dataclass(frozen=True)
class Change:
    """The rows of a predicate that a commit added and removed."""

    added: Rows
    removed: Rows


@dataclass(frozen=True)
class Explanation:
    """An explanation of why a fact holds or does not hold.

    Attributes:
        text: The explanation as a text tree, also `str()`.
        nodes: The same tree as data. The first node is the fact. Nodes refer to each other by index. A node that holds
            is `{"holds", "height", "by": "input" | "text" | "clause" | "range" | "past" | "removed-rows", "clause",
            "binding", "premises"}`. A node that follows from earlier ticks also has `tick`, the nearest one, and
            `when`, the ticks in words. A node that does not hold is `{"absent", "because": "not-a-fact" | "no-clause" |
            "not-looked-into" | "range", "clauses"}`. Each of its `clauses` has a `clause`, the nearest `binding`, and
            the failing literals under `fails`. A clause whose body holds has `excluded-by`: the node of the row
            that holds instead, or None where a limit ended the recursion or that row no longer holds. An entry of
            `premises` or `fails` has the `literal` under the binding, and its `kind`: `fact`, `in-view`, `not`,
            `comparison`, `expression` or `aggregate`. The first three kinds also have the `node` that explains the
            literal.
    """

    fact: str
    holds: bool
    text: str
    nodes: list[dict[str, Any]]

    def __str__(self) -> str:
        """Return the text tree."""
        return self.text


@dataclass(frozen=True)
class Marginals:
    """Probabilities of rows, by predicate. Rows that cannot follow are absent."""

    rows: dict[str, dict[Row, float]]
    intervals: dict[str, dict[Row, tuple[float, float]]] | None
    """The 95 % intervals of estimates (Wilson 1927); `None` if the probabilities are exact."""
    because: str | None
    """Why the probabilities are estimates."""


class Session:
    """A database of facts and the facts that a program derives from them.

    `insert` and `retract` collect changes, and `commit` applies them. Queries see the state of the last commit. A
    commit updates derived facts incrementally if that is cheaper than recomputing them. Facts in the program hold from
    the first commit.

    Not thread-safe: concurrent use raises `RuntimeError`. Long calls release the GIL, and Ctrl-C cancels them. A
    session cannot be pickled or copied. Pickle its program, and `save` the session to a file. Methods raise `KeyError`
    for a predicate that is not declared.

    Args:
        program: The program.
        threads: The number of threads; 0 means one per core. It does not affect the results.
        seed: The seed of the draws of clauses with probabilities, from 0 to 2**64 - 1. A draw depends on it, the tick,
            the clause and the values of its variables.
        max_rows: The limit of derived rows. Default: 100,000,000.
        max_steps: The limit of rows that a commit reads. Default: 100,000,000,000, which takes some minutes.
        max_bytes: The limit of memory for rows, indexes, symbols and buffers, in bytes. Default: 4 GiB.

    Raises:
        RuntimeError: If the threads cannot be started.
        ValueError: If a number is negative, or there are more than 1024 threads.
    """

    def __init__(
        self,
        program: Program,
        threads: int = 1,
        *,
        seed: int = 0,
        max_rows: int | None = None,
        max_steps: int | None = None,
        max_bytes: int | None = None,
    ) -> None:
        """Start without inserted facts and without a commit."""
        self._program = checked_program(program)
        limits = checked_limits({"max_rows": max_rows, "max_steps": max_steps, "max_bytes": max_bytes})
        self._session = _logicity.Session(program._program, checked_threads(threads), limits)
        self.reseed(seed)

    @classmethod
    def load(
        cls,
        program: Program,
        path: str | os.PathLike[str],
        threads: int = 1,
        *,
        max_rows: int | None = None,
        max_steps: int | None = None,
        max_bytes: int | None = None,
    ) -> Session:
        """Read a session that `save` wrote, without deriving anything again.

        The arguments are those of a new session. The seed of draws is the saved one.

        Args:
            program: The program of the saved session. Layout, comments and names of variables may differ.
            path: The file.
            threads: The number of threads; 0 means one per core.
            max_rows: The limit of derived rows.
            max_steps: The limit of rows that a commit reads.
            max_bytes: The limit of memory, also for loading.

        Raises:
            LimitError: If the session takes more memory than `max_bytes`.
            OSError: If the file cannot be read (`FileNotFoundError` if it does not exist).
            ValueError: If the file is no saved session of the program, has another version, or is damaged.
        """
        limits = checked_limits({"max_rows": max_rows, "max_steps": max_steps, "max_bytes": max_bytes})
        session = cls.__new__(cls)
        session._program = checked_program(program)
        file = checked_path("path", path)
        session._session = _logicity.Session.load(program._program, file, checked_threads(threads), limits)
        return session

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the session to a file, from which `load` continues.

        The file holds all facts and derived facts, the pending changes, the seed, and what temporal operators read of
        earlier ticks. It appears when it is complete. Its checksum finds accidental changes only: a
        program that writes such files can store rows that the rules do not derive, so load files only from sources
        that you trust.

        Args:
            path: The file.
            overwrite: Whether to replace a file that this method did not write, or that has changed since.

        Raises:
            OSError: If the file cannot be written (`FileExistsError` if it may not be replaced).
        """
        self._session.save(checked_path("path", path), overwrite)

    def __reduce__(self) -> NoReturn:
        """Refuse to pickle and to copy."""
        why = "its rows and indexes exist only in the memory of the engine"
        remedy = "pickle its program, and write the session to a file with `save`"
        raise TypeError(f"a Session cannot be pickled or copied, because {why}: {remedy}")

    @property
    def program(self) -> Program:
        """The program."""
        return self._program

    def __repr__(self) -> str:
        """Return the numbers of predicates and of rows at the last commit."""
        predicates = self._program.predicates
        return f"<Session of {len(predicates)} predicates: {sum(map(self.count, predicates)):,} rows>"

    def insert(self, predicate: str, rows: RowsLike) -> int:
        """Insert rows at the next commit, and return their number. The last change of each row counts.

        Args:
            predicate: A predicate that no rule derives, or an `.input` predicate.
            rows: The rows, in one of these forms:

                - an iterable of tuples or lists with one value per column: str for a symbol, int for a 32-bit signed or
                  unsigned number, float or int for a float. Floats are rounded to 32 bits; NaN and infinities are
                  valid. A record `[1, "a"]` is `(1, "a")`, `$Circle(3)` is `("Circle", 3)`, and `nil` is None; or a str
                  has the text of the record as in files of rows;
                - an array of shape (n, columns), if one dtype fits all columns;
                - a structured array of shape (n,), whose fields have the names of the columns, in any order;
                - a mapping from the names of all columns to arrays of shape (n,);
                - a data frame or anything else that exports Arrow data: frames of pandas and Polars, tables and record
                  batches of pyarrow, relations of DuckDB, `Rows` of another session. If its columns have exactly the
                  names of the predicate's, they match by name, otherwise by position; a name of the predicate's at
                  another position is then an error. The index of a pandas frame is not a column. Nulls are errors.

                In arrays, symbols have the dtype `U`, `StringDType`, or `object` with str, and records `object`.
                Numbers and unsigned numbers have any integer dtype. Floats have any float or integer dtype. The same
                holds for Arrow types; symbols are strings there, and so are records. Dictionaries (categories) of these
                are also accepted, and decimals without fraction, which DuckDB returns for sums.

        Raises:
            LimitError: If the rows would take more memory than `max_bytes`. No row is inserted then.
            TypeError: If a value, dtype or Arrow type does not match its column; bool is not a number.
            ValueError: If a number is out of range, a row or array has the wrong shape, a record does not fit its type
                or is nested more than 10,000 deep, or rules derive the predicate. No row is inserted then.
        """
        return self._session.insert(predicate, rows)

    def retract(self, predicate: str, rows: RowsLike) -> int:
        """Retract rows at the next commit.

        A row still holds if it is a fact of the program, or if rules derive it. Rows that do not hold are accepted.
        Arguments, return value and exceptions are those of `insert`.
        """
        return self._session.retract(predicate, rows)

    def rollback(self) -> None:
        """Discard the changes since the last commit."""
        self._session.rollback()

    def commit(self) -> dict[str, Change]:
        """Apply the pending changes, and update the derived facts.

        After an exception the session is unchanged and keeps the pending changes. `rollback` discards them.

        Returns:
            The changes by predicate, for base and derived predicates. Predicates without changes are absent.

        Raises:
            InputError: If a functor has no function. What a function raises is passed on.
            KeyboardInterrupt: On Ctrl-C.
            LimitError: If the evaluation exceeds a limit. The diagnostic names the clause.
        """
        return self._commit(advance=False)

    def advance(self) -> dict[str, Change]:
        """Begin the next tick, and commit as `commit` does.

        Temporal operators such as `once[0,5]` count from the new tick. Pending changes belong to it; all other facts
        stay as they are. Before the first tick, no fact held.

        Returns:
            The changes by predicate, as `commit` does.

        Raises:
            KeyboardInterrupt: On Ctrl-C.
            LimitError: If the evaluation exceeds a limit. The tick has begun nevertheless; its changes are pending.
        """
        return self._commit(advance=True)

    def reseed(self, seed: int) -> None:
        """Set the seed of draws from the next commit on."""
        self._session.set_seed(checked_integer("seed", seed))

    def marginals(
        self,
        *predicates: str,
        uncertain: Mapping[str, Sequence[tuple[Row, float]]] | None = None,
        samples: int = 10_000,
        seed: int = 0,
    ) -> Marginals:
        """Return the probabilities of the rows of predicates, for the facts of the last commit.

        Each draw of a clause with probabilities, and each uncertain fact, is an independent random variable. A row has
        the probability of the worlds in which it follows: the distribution semantics (Sato 1995), as in ProbLog.

        Args:
            *predicates: The predicates.
            uncertain: Further facts by predicate: rows, each with its probability from 0 to 1.
            samples: The number of sampled worlds where exact probabilities take too long, at least 1.
            seed: The seed of these samples.

        Raises:
            KeyboardInterrupt: On Ctrl-C.
            LimitError: If the evaluation exceeds a limit.
            TypeError: If a value does not match its column.
            ValueError: If a number is out of range, or rules derive a predicate with uncertain facts.
        """
        given = [(name, [row for row, _ in rows], [p for _, p in rows]) for name, rows in (uncertain or {}).items()]
        samples = checked_integer("samples", samples, low=1, high=2**32 - 1)
        found, because = self._session.marginals(list(predicates), given, samples, checked_integer("seed", seed))
        rows = {
            name: {row: value for row, (value, _, _) in zip(tuples, values, strict=True)}
            for name, (tuples, values) in zip(predicates, found, strict=True)
        }
        intervals = {
            name: {row: (low, high) for row, (_, low, high) in zip(tuples, values, strict=True)}
            for name, (tuples, values) in zip(predicates, found, strict=True)
        }
        return Marginals(rows, None if because is None else intervals, because)

    @property
    def tick(self) -> int:
        """The number of the present tick, from 0: how often `advance` was called."""
        return self._session.tick()

    def _commit(self, *, advance: bool) -> dict[str, Change]:
        changes = self._session.commit(advance)
        return {name: Change(Rows(added), Rows(removed)) for name, (added, removed) in changes.items()}

    def rows(self, predicate: str) -> Rows:
        """Return the rows of a predicate.

        The result shares them with the session without a copy, and later commits do not change it. The rows are sorted
        by the unsigned 32-bit words of their values: negative numbers follow positive ones, and symbols have the order
        in which the session interned them.
        """
        return Rows(self._session.rows(predicate))

    def columns(self, predicate: str) -> dict[str, npt.NDArray[Any]]:
        """Return the rows of a predicate as one array of shape (n,) per column, in the order of `rows`.

        The dtype is int32 for numbers, uint32 for unsigned numbers, float32 for floats, and object (str) for symbols.
        The arrays are copies.
        """
        return self._session.columns(predicate)

    def count(self, predicate: str) -> int:
        """Return the number of rows of a predicate."""
        return self._session.count(predicate)

    def contains(self, predicate: str, row: Sequence[object]) -> bool:
        """Return whether a row holds. The exceptions are those of `insert`."""
        return self._session.contains(predicate, row)

    def query(self, body: str) -> Rows:
        """Return the answers of a query to the facts of the last commit.

        Args:
            body: The body of a rule, such as `path(1, X), !edge(1, X)`. All names are variables, in lower case too.

        Returns:
            The distinct rows of values, with a column for each variable in the order of occurrence. Variables within
            aggregates, and those whose name begins with `_`, have no column. Without columns, the answer is one empty
            row if the body holds, and no row otherwise.

        Raises:
            InputError: If the query is invalid.
            KeyboardInterrupt: On Ctrl-C.
            LimitError: If the evaluation exceeds a limit of the session. Memory counts the rows of both.
        """
        return Rows(self._session.query(body))

    def explain(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Explain why a fact holds, by a shortest proof from inserted facts and facts of the program.

        If the fact does not hold, return the explanation of `why_not`. The attribute `holds` distinguishes the two.

        Args:
            fact: A fact in the syntax of rules, such as `path("a", _)`, where `_` matches any value. With `row`, the
                name of a predicate.
            row: The values of the fact, where `None` matches any value.

        Raises:
            InputError: If the text is not a fact of the program.
            LimitError: If the search takes too many steps.
            TypeError, ValueError: As for `insert`.
        """
        return Explanation(*self._session.explain(fact, row, False))

    def why_not(self, fact: str, row: Sequence[object] | None = None) -> Explanation:
        """Explain why a fact does not hold, by the failing literals of each clause under its nearest binding.

        If the fact holds, return the explanation of `explain`, whose arguments and exceptions this method has.
        """
        return Explanation(*self._session.explain(fact, row, True))

    @property
    def work(self) -> list[StratumStats]:
        """The statistics of the last successful commit, by stratum. Empty before the first commit."""
        return cast(list[StratumStats], self._session.work())

    def plan(self) -> str:
        """Return the plan of every clause for the current sizes of the predicates."""
        return self._session.plan()
