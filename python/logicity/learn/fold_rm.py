"""FOLD-RM: default rules with exceptions over a table, learned by the package `foldrm`.

FOLD-RM [1] learns from rows of attributes, not from relations. The attributes of an observation are the truth values of
these patterns, where X is the ego, and Y and Z are any observed entities, X included:

1. `P(X)` for each unary predicate P;
2. "there is a Y with A1, ..., Ak" for each set of 1 to `atoms` atoms of the forms `P(Y)`, `B(X, Y)` and `B(Y, X)`, for
   unary P and binary B;
3. "there are Y and Z with P(Y), B(Y, Z), Q(Z)" for unary P and Q and binary B, if `pairs` is set.

Patterns that hold in no or in all rows, or in the same rows as an earlier one, are left out. The learned list of rules
becomes a rule file with auxiliary predicates: `Pattern` for patterns, `Rule` for rules, `Exception` for exceptions. The
first rule of the list that holds decides, so an action needs that no earlier rule of another action holds.

[1] Wang, Shakerin, Gupta: FOLD-RM: a scalable, efficient, and explainable inductive learning algorithm for
multi-category classification of mixed data. Theory and Practice of Logic Programming 22, 2022.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..city import ACTIONS
from ..envs.layout import Layout
from ..errors import extra
from ..offline import Demonstrations
from ..rule_policy import RulePolicy
from ..types import Atom
from .settings import LearnerSettings, Positive
from .symbolic import BodyLiteral, SymbolicLearner, arities, clause

__all__ = ["FoldRMLearner", "FoldRMSettings", "Pattern", "Relations", "patterns", "rule_file"]

#: A predicate and its variables: 0 is the ego, 1 and 2 are any observed entities.
PatternAtom: TypeAlias = tuple[str, tuple[int, ...]]

#: A rule of `foldrm`: its class, its conditions, its exceptions, and a flag that is always 0 here.
FoldRule: TypeAlias = tuple[Any, list[tuple[int, str, str]], list[Any], int]


class FoldRMSettings(LearnerSettings):
    """The settings of FOLD-RM."""

    ratio: Positive = 0.5
    """The largest ratio of false to true positives of a rule without exceptions, the default of the package."""
    atoms: Annotated[int, Field(ge=1, le=3)] = 2
    """The largest number of atoms about one entity in a pattern."""
    pairs: bool = False
    """Whether there are patterns of two entities besides the ego."""


@dataclass(frozen=True)
class Pattern:
    """A conjunction of atoms, whose variables other than the ego are existential."""

    atoms: tuple[PatternAtom, ...]


@dataclass(frozen=True)
class Relations:
    """The facts of N observations of E entities: for each predicate, bool (N, E) or (N, E, E)."""

    facts: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, atoms: Sequence[Atom], observations: NDArray[np.float32]) -> Relations:
        """Split observations by predicate."""
        true, layout = observations > 0.5, Layout.of_atoms(atoms)
        unary = {name: true[:, layout.unary_at[:, at]] for at, name in enumerate(layout.unary)}
        return cls(unary | {name: true[:, layout.binary_at[:, :, at]] for at, name in enumerate(layout.binary)})

    def holds(self, pattern: Pattern) -> NDArray[np.bool_]:
        """Return the truth values of a pattern, bool (N,)."""
        # The axes are the observations and the variables 1 and 2.
        found = np.ones((1, 1, 1), np.bool_)
        for predicate, variables in pattern.atoms:
            values = self.facts[predicate]
            for axis, variable in enumerate(variables, 1):
                if variable == 0:
                    values = np.asarray(values.take(0, axis))
            found = found & np.expand_dims(values, [axis for axis in (1, 2) if axis not in variables])
        return np.asarray(found.any((1, 2)))


def patterns(atoms: Sequence[Atom], settings: FoldRMSettings) -> list[Pattern]:
    """Return all patterns over the predicates of an observation, in the order of the module's description."""
    known = arities(tuple(atoms))
    unary, binary = ([name for name, arity in known.items() if arity == wanted] for wanted in (1, 2))
    result = [Pattern(((name, (0,)),)) for name in unary]
    about: list[PatternAtom] = [(name, (1,)) for name in unary]
    about += [(name, variables) for name in binary for variables in ((0, 1), (1, 0))]
    for size in range(1, settings.atoms + 1):
        result += [Pattern(chosen) for chosen in combinations(about, size)]
    if settings.pairs:
        triples = ((first, link, second) for first in unary for link in binary for second in unary)
        result += [Pattern(((one, (1,)), (link, (1, 2)), (two, (2,)))) for one, link, two in triples]
    return result


class FoldRMLearner(SymbolicLearner):
    """FOLD-RM on the distinct steps of the demonstrations."""

    settings_class = FoldRMSettings
    takes_numbers = False
    _settings: FoldRMSettings

    def rules(self, data: Demonstrations) -> str:
        """Return the default rules as a rule file. Raise `ImportError` if the package `foldrm` is not installed."""
        with extra("learn"):
            from foldrm.algo import foldrm
        settings = self._settings
        observations = np.concatenate([trajectory.observations[:-1] for trajectory in data])
        actions = np.concatenate([trajectory.actions for trajectory in data])
        relations = Relations.of(data.atoms, observations[:, : len(data.atoms)])
        chosen, columns = _informative(patterns(data.atoms, settings), relations)
        values = np.where(columns.T, "1", "0").tolist()
        rows = ((*row, ACTIONS[action]) for row, action in zip(values, actions, strict=True))
        # The same list for the same rows: `foldrm` breaks ties by the order of rows.
        distinct = list(map(list, dict.fromkeys(rows)))
        learned: list[FoldRule] = foldrm(distinct, ratio=settings.ratio)
        return rule_file(learned, chosen, _default_action(self.config.mode))


def _default_action(mode: str) -> str:
    """Return the action that an ego without a derived action takes."""
    policy = RulePolicy.from_text('.include "vocabulary.dl"\n', mode)
    return ACTIONS[int(policy(np.zeros((1, policy.width), np.float32))[0])]


def _informative(candidates: Iterable[Pattern], relations: Relations) -> tuple[list[Pattern], NDArray[np.bool_]]:
    """Return the patterns that separate some rows, and their truth values, bool (patterns, N)."""
    found: dict[bytes, tuple[Pattern, NDArray[np.bool_]]] = {}
    for pattern in candidates:
        values = relations.holds(pattern)
        if values.any() and not values.all():
            found.setdefault(np.packbits(values).tobytes(), (pattern, values))
    columns = [values for _, values in found.values()]
    return [pattern for pattern, _ in found.values()], np.array(columns, np.bool_).reshape(len(found), -1)


def rule_file(learned: Sequence[FoldRule], known: Sequence[Pattern], default: str) -> str:
    """Return rules of `foldrm` over the known patterns as a rule file.

    The first rule that holds decides. An ego without one takes the action `default`.
    """
    printer = _Printer(known)
    classes = [(action, printer.rule("Rule", *conditions)) for (_, _, action), *conditions, _ in learned]
    lines = ['.include "vocabulary.dl"', *printer.lines]
    for number, (action, name) in enumerate(classes):
        if action != default:
            body: list[BodyLiteral] = [(False, name, (0,))]
            body += [(True, earlier, (0,)) for other, earlier in classes[:number] if other != action]
            lines += ["", clause(action, body)]
    return "\n".join(lines) + "\n"


class _Printer:
    """Prints rules with auxiliary predicates. Equal patterns share one predicate, and so do equal exceptions."""

    def __init__(self, known: Sequence[Pattern]) -> None:
        self.lines: list[str] = []
        self._known = known
        self._counts: Counter[str] = Counter()
        self._names: dict[tuple[str, tuple[BodyLiteral, ...]], str] = {}

    def rule(self, kind: str, conditions: Sequence[tuple[int, str, str]], exceptions: Sequence[Any]) -> str:
        """Print a rule after its exceptions, and return its predicate."""
        body = [self._literal(condition) for condition in conditions]
        body += [(True, self.rule("Exception", of, but), (0,)) for _, of, but, _ in exceptions]
        return self._define(kind, body)

    def _literal(self, condition: tuple[int, str, str]) -> BodyLiteral:
        column, relation, value = condition
        negated = (relation == "!=") == (value == "1")
        atoms = self._known[column].atoms
        if len(atoms) == 1 and atoms[0][1] == (0,):
            return negated, atoms[0][0], (0,)
        return negated, self._define("Pattern", [(False, *atom) for atom in atoms]), (0,)

    def _define(self, kind: str, body: list[BodyLiteral]) -> str:
        """Print the declaration and the clause of a new predicate, and return its name."""
        key = kind, tuple(body)
        if kind != "Rule" and key in self._names:
            return self._names[key]
        self._counts[kind] += 1
        name = self._names[key] = f"{kind}{self._counts[kind]}"
        self.lines += ["", f".decl {name}(x: agent)", clause(name, body)]
        return name
