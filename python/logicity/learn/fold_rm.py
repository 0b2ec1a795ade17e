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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Annotated, Any, TypeAlias, cast

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

    def body(self) -> list[BodyLiteral]:
        """Return the literals of a clause that defines the pattern."""
        return [(False, predicate, variables) for predicate, variables in self.atoms]


@dataclass(frozen=True)
class Relations:
    """The facts of N observations of E entities.

    Attributes:
        unary: For each unary predicate, bool (N, E).
        binary: For each binary predicate, bool (N, E, E).
    """

    unary: dict[str, NDArray[np.bool_]]
    binary: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, atoms: Sequence[Atom], observations: NDArray[np.float32]) -> Relations:
        """Split observations by predicate."""
        true, layout = observations > 0.5, Layout.of_atoms(atoms)
        return cls(
            {name: true[:, layout.unary_at[:, at]] for at, name in enumerate(layout.unary)},
            {name: true[:, layout.binary_at[:, :, at]] for at, name in enumerate(layout.binary)},
        )

    def about(self, atom: PatternAtom) -> NDArray[np.bool_]:
        """Return the truth values of an atom about variable 1, and possibly the ego, bool (N, E)."""
        predicate, variables = atom
        if variables == (1,):
            return self.unary[predicate]
        return self.binary[predicate][:, 0, :] if variables == (0, 1) else self.binary[predicate][:, :, 0]

    def holds(self, pattern: Pattern) -> NDArray[np.bool_]:
        """Return the truth values of a pattern, bool (N,)."""
        (predicate, variables), *rest = pattern.atoms
        if variables == (0,):
            return self.unary[predicate][:, 0]
        if any(2 in of for _, of in pattern.atoms):
            (first, _), (link, _), (second, _) = pattern.atoms
            pairs = self.unary[first][:, :, None] & self.binary[link] & self.unary[second][:, None, :]
            return np.asarray(pairs.any((1, 2)))
        found = self.about(pattern.atoms[0])
        for atom in rest:
            found = found & self.about(atom)
        return np.asarray(found.any(1))


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

    def rules(self, data: Demonstrations) -> str:
        """Return the default rules as a rule file.

        Raises:
            ImportError: If the package `foldrm` is not installed.
        """
        with extra("learn"):
            from foldrm.algo import foldrm
        settings = cast(FoldRMSettings, self.config.settings)
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
    seen: set[bytes] = set()
    chosen, columns = [], []
    for pattern in candidates:
        values = relations.holds(pattern)
        key = np.packbits(values).tobytes()
        if key not in seen and values.any() and not values.all():
            seen.add(key)
            chosen.append(pattern)
            columns.append(values)
    return chosen, np.array(columns, np.bool_).reshape(len(chosen), -1)


def rule_file(learned: Sequence[FoldRule], known: Sequence[Pattern], default: str) -> str:
    """Return a list of rules of `foldrm` over patterns as a rule file.

    Args:
        learned: The rules. The first one that holds decides.
        known: The pattern of each attribute.
        default: The action that an ego takes if no rule derives one.
    """
    printer = _Printer(known)
    classes = []
    for (_, _, action), conditions, exceptions, _ in learned:
        classes.append((action, printer.rule("Rule", conditions, exceptions)))
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
        self._patterns: dict[int, str] = {}
        self._counts: dict[str, int] = {}
        self._exceptions: dict[tuple[BodyLiteral, ...], str] = {}

    def rule(self, kind: str, conditions: Sequence[tuple[int, str, str]], exceptions: Sequence[Any]) -> str:
        """Print a rule after its exceptions, and return its predicate."""
        body = [self._literal(condition) for condition in conditions]
        body += [(True, self.rule("Exception", of, but), (0,)) for _, of, but, _ in exceptions]
        if kind != "Exception":
            return self._define(kind, body)
        key = tuple(body)
        if key not in self._exceptions:
            self._exceptions[key] = self._define(kind, body)
        return self._exceptions[key]

    def _literal(self, condition: tuple[int, str, str]) -> BodyLiteral:
        column, relation, value = condition
        negated = (relation == "!=") == (value == "1")
        atoms = self._known[column].atoms
        if len(atoms) == 1 and atoms[0][1] == (0,):
            return negated, atoms[0][0], (0,)
        if column not in self._patterns:
            self._patterns[column] = self._define("Pattern", self._known[column].body())
        return negated, self._patterns[column], (0,)

    def _define(self, kind: str, body: list[BodyLiteral]) -> str:
        """Print the declaration and the clause of a new predicate, and return its name."""
        number = self._counts[kind] = self._counts.get(kind, 0) + 1
        name = f"{kind}{number}"
        self.lines += ["", f".decl {name}(x: agent)", clause(name, body)]
        return name
