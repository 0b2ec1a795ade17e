"""Parse rule files in the part of the language that the solvers' encodings can express.

That part has base and derived predicates, clauses for one agent each, atoms over variables, negation and scope. All
other rules raise `Refused`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

TOKEN = re.compile(
    r"""(?P<skip>\s+|//[^\n]*|/\*.*?\*/)
      | (?P<text>"[^"\n]*")
      | (?P<directive>\.[a-z]+)
      | (?P<name>[A-Za-z_?][A-Za-z0-9_?]*)
      | (?P<symbol>:-|<:|[(),:!.])""",
    re.VERBOSE | re.DOTALL,
)
NEGATIONS = {"Not", "not", "!"}


class Refused(Exception):
    """The encodings cannot express the rules, or a file or program cannot be used."""


@dataclass(frozen=True)
class Literal:
    """An atom over variables, or its negation."""

    predicate: str
    variables: tuple[str, ...]
    positive: bool


@dataclass(frozen=True)
class Clause:
    """`head(ego) :- body`. The body's other variables range over the entities that the ego sees."""

    head: str
    ego: str
    body: tuple[Literal, ...]

    def others(self) -> list[str]:
        """Return the variables other than the ego, in the order of the body."""
        return list(dict.fromkeys(v for literal in self.body for v in literal.variables if v != self.ego))


@dataclass
class Rules:
    """The rules of a file and its includes."""

    arities: dict[str, int] = field(default_factory=dict)
    base: list[str] = field(default_factory=list)
    """The base predicates, without the scope."""
    actions: list[str] = field(default_factory=list)
    scope: str = ""
    """The predicate of the field of view."""
    clauses: dict[str, list[Clause]] = field(default_factory=dict)
    """The clauses of every derived predicate, dependencies first."""


@dataclass(frozen=True)
class Token:
    """A token of a rule file with its place."""

    kind: str
    text: str
    place: str


def read(path: Path) -> Rules:
    """Return the rules of a file and its includes."""
    rules = Rules()
    clauses: list[tuple[Clause, str]] = []
    _read_file(path, rules, clauses, set())
    if rules.scope not in rules.base:
        raise Refused(f"{path}: rules need a `.scope` over a base predicate here")
    rules.base.remove(rules.scope)
    grouped: dict[str, list[Clause]] = {action: [] for action in rules.actions}
    for clause, place in clauses:
        grouped.setdefault(clause.head, []).append(_in_view(clause, rules, place))
    needs = {
        head: {literal.predicate for clause in group for literal in clause.body if literal.predicate in grouped}
        for head, group in grouped.items()
    }
    try:
        rules.clauses = {head: grouped[head] for head in TopologicalSorter(needs).static_order()}
    except CycleError as error:
        raise Refused(f"{path}: recursion has no encoding here: {' -> '.join(error.args[1])}") from None
    for head, group in grouped.items():
        for literal in (literal for clause in group for literal in clause.body):
            if literal.predicate in grouped and len(literal.variables) != 1:
                raise Refused(f"{path}: {head} needs {literal.predicate}, a derived predicate of several agents")
    return rules


def _in_view(clause: Clause, rules: Rules, place: str) -> Clause:
    """Simplify a clause for scenes where all entities see each other: atoms of the scope are true."""
    body = []
    for literal in clause.body:
        arity = rules.arities.get(literal.predicate)
        if arity != len(literal.variables):
            raise Refused(f"{place}: {literal.predicate} is not declared with {len(literal.variables)} columns")
        if literal.predicate == rules.scope:
            if not literal.positive:
                raise Refused(f"{place}: a negated {rules.scope} has no encoding: all entities see each other")
            continue
        if literal.predicate not in rules.base and literal.variables != (clause.ego,):
            raise Refused(
                f"{place}: {literal.predicate} of another agent than the one to decide for has no encoding here"
            )
        body.append(literal)
    return Clause(clause.head, clause.ego, tuple(body))


def _read_file(path: Path, rules: Rules, clauses: list[tuple[Clause, str]], seen: set[Path]) -> None:
    if path.resolve() in seen:
        return
    seen.add(path.resolve())
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise Refused(f"cannot read {path}: {error.strerror}") from None
    tokens = _Tokens(list(_tokens(path, text)), f"{path}: end of file")
    while not tokens.at_end():
        if tokens.peek().kind != "directive":
            clauses.append(_clause(tokens))
            continue
        directive = tokens.take()
        match directive.text:
            case ".include":
                _read_file(path.parent / tokens.take("text").text.strip('"'), rules, clauses, seen)
            case ".decl":
                names = tokens.names()
                columns = tokens.columns()
                rules.arities.update(dict.fromkeys(names, columns))
            case ".input":
                rules.base.extend(tokens.names())
            case ".output":
                rules.actions.extend(tokens.names())
            case ".scope":
                rules.scope = tokens.take("name").text
            case ".type":
                tokens.take("name"), tokens.take("symbol"), tokens.take("name")
            case ".disjoint" | ".implies" | ".covering" | ".reflexive" | ".irreflexive" | ".symmetric" | ".asymmetric":
                tokens.names()
            case other:
                raise Refused(f"{directive.place}: {other} has no encoding here")


def _tokens(path: Path, text: str) -> Iterator[Token]:
    position, line = 0, 1
    while position < len(text):
        found = TOKEN.match(text, position)
        if found is None or found.lastgroup is None:
            raise Refused(f"{path}:{line}: `{text[position]}` has no encoding here")
        if found.lastgroup != "skip":
            yield Token(found.lastgroup, found.group(), f"{path}:{line}")
        line += found.group().count("\n")
        position = found.end()


class _Tokens:
    """The remaining tokens of a file."""

    def __init__(self, tokens: list[Token], end: str) -> None:
        self.tokens = tokens[::-1]
        self.end = Token("end", "the end", end)

    def at_end(self) -> bool:
        return not self.tokens

    def peek(self) -> Token:
        return self.tokens[-1] if self.tokens else self.end

    def take(self, kind: str | None = None, text: str | None = None) -> Token:
        token = self.peek()
        if token is self.end or (kind is not None and token.kind != kind) or (text is not None and token.text != text):
            raise Refused(f"{token.place}: `{token.text}` instead of {text or kind} has no encoding here")
        return self.tokens.pop()

    def takes(self, text: str) -> bool:
        """Take the next token if it is this one."""
        found = self.peek().text == text
        if found:
            self.take()
        return found

    def names(self) -> list[str]:
        names = [self.take("name").text]
        while self.takes(","):
            names.append(self.take("name").text)
        return names

    def columns(self) -> int:
        self.take(text="(")
        count = 0
        while not self.takes(")"):
            if count:
                self.take(text=",")
            self.take("name"), self.take(text=":"), self.take("name")
            count += 1
        return count


def _clause(tokens: _Tokens) -> tuple[Clause, str]:
    start = tokens.peek().place
    head, arguments = _atom(tokens)
    if len(arguments) != 1:
        raise Refused(f"{start}: a head without exactly one agent has no encoding here")
    tokens.take(text=":-")
    body = [_literal(tokens)]
    while tokens.takes(","):
        body.append(_literal(tokens))
    tokens.take(text=".")
    return Clause(head, arguments[0], tuple(body)), start


def _literal(tokens: _Tokens) -> Literal:
    if tokens.peek().text not in NEGATIONS:
        return Literal(*_atom(tokens), positive=True)
    word = tokens.take().text
    grouped = word != "!" and tokens.takes("(")
    predicate, variables = _atom(tokens)
    if grouped:
        tokens.take(text=")")
    return Literal(predicate, variables, positive=False)


def _atom(tokens: _Tokens) -> tuple[str, tuple[str, ...]]:
    predicate = tokens.take("name").text
    tokens.take(text="(")
    variables = tokens.names()
    if "_" in variables:
        raise Refused(f"{tokens.peek().place}: `_` has no encoding here")
    tokens.take(text=")")
    return predicate, tuple(variables)
