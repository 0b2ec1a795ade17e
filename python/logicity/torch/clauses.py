"""The clauses of a program as `RuleLayer` evaluates them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from .. import _logicity
from ..errors import did_you_mean
from ..rules import Program

__all__ = ["Atom", "Clause", "Clauses", "Past", "Stratum"]

#: A negated literal of one atom, and a variable over which a probability is not drawn.
NEGATED, UNNAMED = re.compile(r"\bNot\(\s*\w+\([^()]*\)\s*\)|!\s*\w+\([^()]*\)"), re.compile(r"\b_\w*")

#: The largest number of variables of a clause.
VARIABLES_MAX = 6


@dataclass(frozen=True)
class Atom:
    """A predicate, by its position, and its variables. `None` is `_`."""

    predicate: int
    terms: tuple[int | None, ...]


@dataclass(frozen=True)
class Clause:
    """A clause whose variables are those of the head, in order, and then the others.

    Attributes:
        head: The head.
        literals: The atoms of the body, and whether each holds.
        same: Pairs of variables, and whether they are the same entity.
        count: The number of variables.
        probability: That of the head, 1 without one.
        label: The label, such as `S1`.
        source: The position among the clauses of the program.
        location: Its place in the source, such as `rules/expert.dl:5:1`.
        drawn: Whether its source has a probability.
        unnamed: Whether positive literals have variables without a name, or whose names begin with `_`.
        number: The position among the written clauses of the layer, -1 for a part of one.
    """

    head: Atom
    literals: tuple[tuple[Atom, bool], ...]
    same: tuple[tuple[int, int, bool], ...]
    count: int
    probability: float
    label: str
    source: int
    location: str
    drawn: bool = False
    unnamed: bool = False
    number: int = -1


@dataclass
class Stratum:
    """The clauses of predicates that are computed together, by the position of the predicate."""

    clauses: dict[int, list[Clause]]
    recursive: bool


@dataclass(frozen=True)
class Past:
    """What a temporal operator reads; see `_logicity.checked`."""

    predicate: int
    operand: int
    operator: str
    held: tuple[int, tuple[int, ...]] | None
    first: int
    last: int | None


class Clauses:
    """The clauses on which actions and queries depend, in the order of evaluation.

    Attributes:
        unary, binary: The names of the input predicates over one entity and over two.
        inputs: The column of each of them, by the position of the predicate that has its facts.
        arities: The number of columns of each predicate, by position.
        places: The positions of declared predicates by name.
        derived: The actions that clauses derive.
        strata: The clauses.
        pasts: What their temporal operators read.
        written: Those of the source, by `Clause.number`; the others are parts of them, such as operands of `once`.
        labels: The labels of the written clauses.
        body_predicates: The predicates in bodies and under temporal operators.
        alone: The derived predicates of which only the atoms that begin with an ego are read.
    """

    def __init__(
        self,
        program: Program,
        queries: Iterable[str],
        actions: Sequence[str],
        default: str,
        depth: int | None,
        *,
        by_engine: bool = False,
    ) -> None:
        """Read the clauses. The exceptions are those of `RuleLayer`.

        `by_engine` says that the engine evaluates them: any depth of recursion and any number of variables.
        """
        checked = _logicity.checked(program._program)
        self._predicates: list[dict[str, Any]] = checked["predicates"]
        self._queries, self._actions, self._default, self._depth = tuple(queries), tuple(actions), default, depth
        self._by_engine = by_engine
        self.arities = [len(each["symbols"]) for each in self._predicates]
        self.places = {each["name"]: place for place, each in enumerate(self._predicates) if not each["hidden"]}
        inputs = [(name, self._predicates[place]) for name, place in self.places.items()]
        inputs = [(name, each) for name, each in inputs if each["input"] and all(each["symbols"])]
        self.unary = tuple(name for name, each in inputs if len(each["symbols"]) == 1)
        self.binary = tuple(name for name, each in inputs if len(each["symbols"]) == 2)
        self.inputs: dict[int, int] = {}
        for names in (self.unary, self.binary):
            for column, name in enumerate(names):
                place = self.places[name]
                edb = self._predicates[place]["edb"]
                self.inputs[place if edb is None else edb] = column
        self.pasts = [
            Past(
                each["predicate"],
                each["operand"],
                each["operator"],
                None if each["held"] is None else (each["held"][0], tuple(each["held"][1])),
                each["first"],
                each["last"],
            )
            for each in checked["pasts"]
        ]
        given = (clause for stratum in checked["strata"] for clause in stratum["clauses"])
        self._heads = {clause["head"]["predicate"] for clause in given}
        self.derived = tuple(name for name in self._actions if self._is_derived(name))
        for name in self._queries:
            if name not in self.places:
                near = did_you_mean(name, (each for each, at in self.places.items() if self._predicates[at]["derived"]))
                raise ValueError(f"queries: the rules declare no predicate `{name}`{near}")
            if not self._predicates[self.places[name]]["derived"]:
                raise ValueError(f"queries: no clause derives `{name}`")
        self.strata = self._needed(checked["strata"])
        used: list[Clause] = []
        written: list[Clause] = []
        for stratum in self.strata:
            for place, clauses in stratum.clauses.items():
                for at, clause in enumerate(clauses):
                    if not self._is_part(place, clause):
                        clauses[at] = replace(clause, number=len(written))
                        written.append(clauses[at])
                used += clauses
        self.written = tuple(written)
        self.labels = tuple(clause.label for clause in written)
        needed = {atom.predicate for clause in used for atom, _ in clause.literals}
        self.pasts = [past for past in self.pasts if past.predicate in needed]
        operands = {place for past in self.pasts for place in (past.operand, *(past.held or ())[:1])}
        self.body_predicates = needed | operands
        self.alone = self._read_by_egos(used)

    def _is_part(self, place: int, clause: Clause) -> bool:
        """Return whether the engine made a clause of a predicate: a part of others, or the one that reads the facts."""
        edb = self._predicates[place]["edb"]
        return bool(self._predicates[place]["hidden"]) or (
            edb is not None and [atom.predicate for atom, _ in clause.literals] == [edb]
        )

    def _is_derived(self, action: str) -> bool:
        place = self.places.get(action)
        if place is None:
            return False
        each = self._predicates[place]
        if each["symbols"] != [True]:
            argument = "default" if action == self._default else "priority"
            raise ValueError(f"{argument}: `{action}` is not a predicate over one entity")
        # A fact in the source derives it, too.
        return bool(each["derived"]) or place in self._heads

    def _needed(self, strata: list[dict[str, Any]]) -> list[Stratum]:
        """Return the strata of the predicates on which actions and queries depend, in order."""
        actions = {self.places[name] for name in self.derived}
        declared = {self.places[name] for name in self._actions if name in self.places}
        given = [
            clause for stratum in strata for clause in stratum["clauses"] if not self._is_default(clause, declared)
        ]
        clauses: dict[int, list[Clause]] = {}
        open_ = [*actions, *(self.places[name] for name in self._queries)]
        while open_:
            place = open_.pop()
            if place in clauses:
                continue
            clauses[place] = [self._clause(each) for each in given if each["head"]["predicate"] == place]
            open_ += [atom.predicate for clause in clauses[place] for atom, _ in clause.literals]
            for past in self.pasts:
                if past.predicate == place:
                    open_ += [past.operand, *([past.held[0]] if past.held else [])]
        chosen = []
        for stratum in strata:
            found = {place: clauses[place] for place in stratum["predicates"] if clauses.get(place)}
            if not found:
                continue
            if stratum["recursive"] and self._depth is None and not self._by_engine:
                name = self._predicates[stratum["predicates"][0]]["name"]
                raise ValueError(f"`{name}` is recursive: give the `depth` to which its clauses are applied")
            chosen.append(Stratum(found, stratum["recursive"]))
        return chosen

    def _is_default(self, clause: dict[str, Any], actions: set[int]) -> bool:
        """Return whether a clause says that the default is taken if no other action is derived."""
        if clause["head"]["predicate"] != self.places.get(self._default) or not clause["body"]:
            return False
        terms = clause["head"]["terms"]
        for literal in clause["body"]:
            if "atom" not in literal:
                return False
            atom = literal["atom"]
            negates = not literal["holds"] and atom["predicate"] in actions and atom["terms"] == terms
            reflexive = (
                literal["holds"] and atom["terms"] == [*terms, *terms] and self._predicates[atom["predicate"]]["input"]
            )
            if not negates and not reflexive:
                return False
        return True

    def _clause(self, given: dict[str, Any]) -> Clause:
        def refuse(reason: str) -> ValueError:
            return ValueError(f"{given['place']}: the clause has no degree, since it {reason}: `{given['text']}`")

        if not given["body"]:
            raise refuse("is a fact about constants" if given["head"]["terms"] else "is a fact")
        literals: list[tuple[Atom, bool]] = []
        same: list[tuple[int, int, bool]] = []
        numbers: dict[int, int] = {}
        fresh = iter(range(-1, -1000, -1))

        def atom(plain: dict[str, Any], holds: bool) -> Atom:
            predicate = self._predicates[plain["predicate"]]
            if not all(predicate["symbols"]):
                raise refuse(f"reads values of `{predicate['name']}`")
            if predicate["input"] and len(predicate["symbols"]) not in (1, 2):
                raise refuse(f"reads `{predicate['name']}`, an input over {len(predicate['symbols'])} entities")
            if "constant" in plain["terms"]:
                raise refuse("names a constant")
            terms = [term if term is not None or not holds else next(fresh) for term in plain["terms"]]
            return Atom(plain["predicate"], tuple(None if term is None else number(term) for term in terms))

        def number(term: int) -> int:
            return numbers.setdefault(term, len(numbers))

        head = atom(given["head"], True)
        for literal in given["body"]:
            if "other" in literal:
                raise refuse(literal["other"])
            if "same" in literal:
                if "constant" in literal["same"]:
                    raise refuse("names a constant")
                one, other = (number(term) for term in literal["same"])
                same.append((one, other, literal["holds"]))
            else:
                literals.append((atom(literal["atom"], literal["holds"]), literal["holds"]))
        if len(numbers) > VARIABLES_MAX and not self._by_engine:
            raise refuse(f"has more than {VARIABLES_MAX} variables")
        probability = 1.0
        if given["probabilities"] is not None:
            if None in given["probabilities"]:
                raise refuse("has a probability that is not a constant")
            chosen = given["alternative"]
            probability = given["probabilities"][chosen]
        unnamed = UNNAMED.search(NEGATED.sub("", given["text"])) is not None
        origin = (given["label"], given["clause"], given["place"], given["probabilities"] is not None, unnamed)
        return Clause(head, tuple(literals), tuple(same), len(numbers), probability, *origin)

    def _read_by_egos(self, clauses: list[Clause]) -> set[int]:
        """Return the derived predicates of which only the atoms that begin with an ego are read."""
        remembered = {past.operand for past in self.pasts} | {past.held[0] for past in self.pasts if past.held}
        repeated = {clause.head.predicate for clause in clauses if len(set(clause.head.terms)) < len(clause.head.terms)}
        alone = {clause.head.predicate for clause in clauses if clause.head.terms}
        alone -= remembered | repeated | {self.places[name] for name in self._queries}
        while True:
            others = {
                atom.predicate
                for clause in clauses
                for atom, _ in clause.literals
                if clause.head.predicate not in alone or not atom.terms or atom.terms[0] != 0
            }
            if not alone & others:
                return alone
            alone -= others
