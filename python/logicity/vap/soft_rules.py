"""Rules on truth degrees from 0 to 1, as t-norm fuzzy logic defines them. Needs the extra `vap`.

A clause `Stop(X) :- IsAtInter(X), HigherPri(Y, X).` has the degree of the conjunction of its literals, and an
existential variable the disjunction over the entities in the view of X:

| semantics | conjunction | disjunction | negation |
|---|---|---|---|
| `product` | a b | 1 - (1 - a)(1 - b) | 1 - a |
| `max-min` | min(a, b) | max(a, b) | 1 - a |

With the degrees 0 and 1, both are the rules themselves. With probabilities of independent facts, `product` is the
probability of a clause whose literals are independent (noisy-or); it counts a fact that several clauses share several
times. `max-min` (Gödel's t-norm) does not. Its degree is above 0.5 exactly if the facts above 0.5 derive the atom, so
its answers are those of the rules on thresholded facts.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from itertools import count
from typing import Literal

from ..city import ACTIONS
from ..errors import extra
from ..rules import Program
from .data import UNARY

with extra("vap"):
    import torch
    from torch import Tensor

from .concepts import RELATIONS, in_view

__all__ = ["Semantics", "SoftRules"]

Semantics = Literal["product", "max-min"]

#: A literal of a clause that is free of syntax errors: its negation, predicate and arguments.
_LITERAL = re.compile(r"\s*(Not\(|not\s|!)?\s*([\w?]+)\(\s*([\w?]+)\s*(?:,\s*([\w?]+)\s*)?\)\s*\)?\s*(?:,|$)")
_VARIABLE = re.compile(r"[\w?]+")
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)


@dataclass(frozen=True)
class BodyLiteral:
    """A literal of a clause body."""

    predicate: str
    variables: tuple[str, ...]
    negated: bool


@dataclass(frozen=True)
class Rule:
    """A clause for an action. The first variable is the agent."""

    body: tuple[BodyLiteral, ...]
    variables: tuple[str, ...]


class SoftRules:
    """The clauses of a program that derive actions, on truth degrees.

    Args:
        program: The rules: clauses for actions, whose bodies have literals of unary and binary predicates and of other
            actions of the same agent, without recursion.
        precedence: The order of actions if several are derived. The default is that of `actions.priority` in
            `configs/vap-easy.yaml`, on which `configs/vap-hard.yaml` is based; the file is not read.
        default: The action of an agent for which no clause holds. The default is `actions.default` of
            `configs/common.yaml`. Clauses for this action may only say that no other action holds.

    Raises:
        ValueError: If a clause has another form.
    """

    def __init__(self, program: Program, precedence: tuple[str, ...] = ACTIONS, default: str = "Normal") -> None:
        """Read the clauses."""
        self.precedence, self.default = precedence, default
        strata = [[name for name in stratum if name in ACTIONS and name != default] for stratum in program.strata]
        # Actions without clauses are false.
        known = set(ACTIONS).difference([default], *strata)
        clauses = [(each["head"], each["text"]) for each in program.clauses]
        self.rules: dict[str, list[Rule]] = {}
        for stratum in strata:
            for action in stratum:
                self.rules[action] = [_rule(text, known) for head, text in clauses if head == action]
            known |= set(stratum)
        for head, text in clauses:
            if head != default:
                continue
            rule = _rule(text, known)
            if not all(each.predicate in ("Sees", *ACTIONS) and len(rule.variables) == 1 for each in rule.body):
                raise ValueError(f"`{default}` holds if no other action does: `{text}` has no truth degree")

    def degrees(self, unary: Tensor, binary: Tensor, valid: Tensor, semantics: Semantics = "product") -> Tensor:
        """Return the degree to which each action is the answer.

        Args:
            unary: (B, N, 11), the degrees of the atoms of `UNARY`.
            binary: (B, N, N, 7), those of `RELATIONS`: the six binary predicates and `Sees`.
            valid: bool (B, N): the entities that are present.
            semantics: The t-norm.

        Returns:
            (B, N, 4) in the order of `logicity.ACTIONS`. The action with the largest degree is the answer. With degrees
            0 and 1, exactly one action has the degree 1.
        """
        sees, eye = in_view(binary, valid)
        values = {name: unary[..., at] for at, name in enumerate(UNARY)}
        # Binary predicates other than Sees are irreflexive.
        values |= {name: binary[..., at].masked_fill(eye, 0.0) for at, name in enumerate(RELATIONS)}
        values["Sees"] = sees
        answers = dict.fromkeys(ACTIONS, torch.zeros_like(unary[..., 0]))
        values |= answers
        for head, rules in self.rules.items():
            values[head] = _any(torch.stack([_degree(rule, values, sees, semantics) for rule in rules], -1), semantics)
        # An action is the answer if it is derived, and none that comes before it.
        left = torch.ones_like(unary[..., 0])
        for action in self.precedence:
            if action in self.rules:
                answers[action] = _both(left, values[action], semantics)
                left = _both(left, 1 - values[action], semantics)
        answers[self.default] = left
        return torch.stack([answers[action] for action in ACTIONS], -1)


def _rule(text: str, actions: Collection[str]) -> Rule:
    """Parse the text of a clause, whose body may contain some actions."""
    beginning, _, body_text = _COMMENT.sub("", text).partition(":-")
    body_text = body_text.strip().removesuffix(".")
    ego = beginning.partition("(")[2].partition(")")[0].strip()
    if not body_text or not _VARIABLE.fullmatch(ego):
        raise ValueError(f"only clauses with a body have truth degrees, not `{text}`")
    body: list[BodyLiteral] = []
    anonymous, end = count(), 0
    while end < len(body_text):
        if (match := _LITERAL.match(body_text, end)) is None:
            rest = body_text[end:].strip()
            raise ValueError(f"only literals of predicates can have truth degrees, not `{rest}` in `{text}`")
        end = match.end()
        # Each `_` is a variable that occurs nowhere else.
        names = [each if each != "_" else f"_ {next(anonymous)}" for each in (match[3], match[4]) if each]
        literal = BodyLiteral(match[2], tuple(names), bool(match[1]))
        known = literal.predicate in (*UNARY, *RELATIONS) or (literal.predicate in actions and names == [ego])
        if not known or (literal.negated and "_" in match.group(3, 4)):
            raise ValueError(f"`{match[0].strip(' ,')}` has no truth degree, in `{text}`")
        body.append(literal)
    others = sorted({name for literal in body for name in literal.variables} - {ego})
    return Rule(tuple(body), (ego, *others))


def _degree(rule: Rule, values: dict[str, Tensor], sees: Tensor, semantics: Semantics) -> Tensor:
    """Return the degree of a body, (B, N): the disjunction over the entities in view of the conjunction of literals."""
    places = {name: at for at, name in enumerate(rule.variables)}
    seen = [BodyLiteral("Sees", (rule.variables[0], name), False) for name in rule.variables[1:]]
    total: Tensor | None = None
    for literal in (*rule.body, *seen):
        value = sees if literal.predicate == "Sees" else values[literal.predicate]
        value = 1 - value if literal.negated else value
        axes = [places[name] for name in literal.variables]
        if len(axes) == 2 and axes[0] == axes[1]:
            value = value.diagonal(dim1=1, dim2=2)
        elif len(axes) == 2 and axes[0] > axes[1]:
            value = value.transpose(1, 2)
        for axis in range(len(rule.variables)):
            if axis not in axes:
                value = value.unsqueeze(axis + 1)
        total = value if total is None else _both(total, value, semantics)
    assert total is not None  # a body has at least one literal
    for _ in rule.variables[1:]:
        total = _any(total, semantics)
    return total


def _both(first: Tensor, second: Tensor, semantics: Semantics) -> Tensor:
    return first * second if semantics == "product" else torch.minimum(first, second)


def _any(values: Tensor, semantics: Semantics) -> Tensor:
    return 1 - (1 - values).prod(-1) if semantics == "product" else values.amax(-1)
