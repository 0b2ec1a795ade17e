"""Hierarchical Rule Induction (HRI): symbolic rules by gradient descent, by cloning the oracle's behavior.

The model is that of Glanois et al., "Neuro-Symbolic Hierarchical Rule Induction", ICML 2022 (arXiv 2112.13418). It
consists of layers of templates (the paper's *proto-rules*). A template is a clause whose body has *slots* instead of
predicates. A slot can hold any predicate of the observation or of a lower layer. Slots and predicates have embeddings,
and the softmax of their cosine similarities says to which degree a slot holds a predicate. After training, each slot
holds its most similar predicate, so the model is a set of Datalog rules: `HriPolicy.rules` prints them, and
`HriPolicy.predict` evaluates them.

Each action that the rules can require has its own model. An action is chosen if its rules derive it. If several are
derived, the first one in `HriSettings.order` is chosen; if none is, `DEFAULT`. Both repeat `actions.priority` and
`actions.default` of `configs/common.yaml`, because the description of a task lacks them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby, product
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, field_validator
from torch import Tensor

from .. import _logicity
from ..city import ACTIONS
from ..envs.layout import Layout
from ..envs.views import Actions, Observations
from ..files import read_tensors
from ..tasks import load_task
from .demonstrations import DemonstrationData
from .learner import LearnedPolicy, Learner, check_shape, minimize
from .settings import LearnerSettings, NonNegative, Positive, Training
from .storage import restore_optimizer

__all__ = ["HRI", "Hypothesis", "HriPolicy", "HriSettings", "InventedPredicate", "ProgramTemplate"]

Bools: TypeAlias = NDArray[np.bool_]

#: The number of slots of each template.
SLOTS = {"A00+": 3, "B00+": 3, "C00+": 3, "Inv": 1}
#: The format of policy files.
FORMAT = "logicity hri policy 1"

#: The action if the rules derive none: `actions.default` of `configs/common.yaml`.
DEFAULT = "Normal"

#: Two values. YAML has lists, which strict validation does not accept as tuples.
Ends: TypeAlias = Annotated[tuple[Positive, Positive], Field(strict=False)]
Name: TypeAlias = Literal["Stop", "Slow", "Fast", "Normal"]


class HriSettings(LearnerSettings):
    """The settings of HRI. Values that change during training do so exponentially from the first to the second."""

    unary: Annotated[list[Literal["A00+"]], Field(min_length=1)] = ["A00+"]
    """The templates of unary predicates in each layer. The target has the first of them."""
    binary: list[Literal["B00+", "C00+", "Inv"]] = ["C00+", "B00+", "Inv"]
    """The templates of binary predicates in each layer."""
    copies: Annotated[int, Field(ge=1, le=64)] = 1
    """The number of predicates of each template in a layer."""
    depth: Annotated[int, Field(ge=1, le=16)] = 3
    """The number of layers, including that of the target."""
    depth_of: dict[Name, Annotated[int, Field(ge=1, le=16)]] = {}
    """The number of layers for individual actions."""
    negation: bool = False
    """Whether slots can hold negations of observed predicates."""
    order: list[Name] = ["Stop", "Slow", "Fast"]
    """The actions in the order of precedence, in case the rules derive several. An action that is not in the list is
    never chosen."""
    dimension: Annotated[int, Field(ge=2, le=4096)] | None = None
    """The dimension of embeddings. The default is the number of predicates of the model."""
    embedding_rates: Ends = (2.9e-3, 2.5e-4)
    """The learning rate of the embeddings of predicates."""
    rule_rates: Ends = (2.4e-4, 1.4e-6)
    """The learning rate of the embeddings of slots."""
    temperatures: Ends = (0.1, 0.01)
    """The temperature of the softmax."""
    noise: Ends = (0.3, 0.01)
    """The scale of the Gumbel noise that is added to similarities."""
    conjunction: Literal["min", "product"] = "min"
    """The soft conjunction."""
    regularization: NonNegative = 0.01
    """The weight of the paper's interpretability term, the mean of p (1 - p) over the degrees p."""
    batch: Annotated[int, Field(ge=2)] = 256
    """The number of examples of an update: half of them positive, half of them negative."""
    restarts: Annotated[int, Field(ge=1, le=1024)] = 16
    """The number of models per action, which train at the same time. The best one on the demonstrations counts."""
    generation: Annotated[int, Field(ge=1)] | None = None
    """The number of updates after which all models start again with new weights, schedules and rules. The default is
    the number of all updates. Validation chooses among the best rules of each generation."""
    extract_every: Annotated[int, Field(ge=1)] = 50
    """The number of updates between two extractions of rules."""

    @field_validator("order")
    @classmethod
    def _each_once(cls, order: list[str]) -> list[str]:
        repeated = [name for at, name in enumerate(order) if name in order[:at]]
        if repeated:
            raise ValueError(f"`{repeated[0]}` occurs twice")
        return order


def relations(layout: Layout, observations: Observations) -> tuple[Bools, Bools]:
    """Return the truth values of unary (batch, N, U) and of binary (batch, N, N, B) predicates."""
    true = observations > 0.5
    return true[:, layout.unary_at], true[:, layout.binary_at]


def present(unary: Bools, binary: Bools) -> Bools:
    """Return which entities exist, (batch, N): those with a true atom. The ego always exists."""
    some = np.asarray(unary.any(-1) | binary.any((1, 3)) | binary.any((2, 3)))
    some[:, 0] = True
    return some


@dataclass(frozen=True)
class InventedPredicate:
    """A predicate that a model invents, with its rule template.

    With the slots P, Q and R, the templates are as follows. A unary predicate in a slot ignores its second argument.

        A00+  H(X)    :- P(X, Y), Q(Y, X); R(X, Y).
        B00+  H(X, Y) :- P(X, Z), Q(Z, Y); R(X, Y).
        C00+  H(X, Y) :- P(X, Y), Q(Y, X); R(X, Y).
        Inv   H(X, Y) :- P(Y, X).

    They are the paper's templates A, B, C and its inversion. 00 means that they are not recursive, and + that they have
    the disjunction.

    Attributes:
        template: The template.
        slot: The index of its first slot.
        visible: The number of predicates that its slots can hold. They are the first ones.
    """

    template: str
    slot: int
    visible: int

    @property
    def slots(self) -> slice:
        """The indices of its slots."""
        return slice(self.slot, self.slot + SLOTS[self.template])


class ProgramTemplate:
    """The predicates and rule templates of a model, without its weights.

    The predicates are, in this order: the unary symbols, the binary symbols, and the invented ones. Symbols are
    observed predicates, their negations, and the constants true and false, which count as unary. The last predicate is
    the target.

    Attributes:
        unary, binary: The names of the symbols, with their signs.
        layers, invented: The invented predicates, by layer and in one list.
        limits: For each slot, the number of predicates that it can hold, which are the first ones.
        slots, predicates: Their numbers.
    """

    def __init__(self, layout: Layout, settings: HriSettings, depth: int) -> None:
        """List the predicates."""
        signs = (True, False) if settings.negation else (True,)
        self.unary = [(name, sign) for sign in signs for name in layout.unary] + [("", True), ("", False)]
        self.binary = [(name, sign) for sign in signs for name in layout.binary]
        self.negation = settings.negation
        self.layers: list[list[InventedPredicate]] = []
        self.limits: list[int] = []
        visible = len(self.unary) + len(self.binary)
        hidden: list[str] = [each for each in (*settings.unary, *settings.binary) for _ in range(settings.copies)]
        layers: list[list[str]] = [*[hidden] * (depth - 1), [settings.unary[0]]]
        for templates in layers:
            self.layers.append([])
            for template in templates:
                self.layers[-1].append(InventedPredicate(template, len(self.limits), visible))
                self.limits += [visible] * SLOTS[template]
            visible += len(templates)
        self.invented = [invented for layer in self.layers for invented in layer]
        self.slots, self.predicates = len(self.limits), visible

    def is_unary(self, predicate: int) -> bool:
        """Return whether a predicate is unary."""
        at = predicate - len(self.unary) - len(self.binary)
        return predicate < len(self.unary) or (at >= 0 and self.invented[at].template == "A00+")

    def visible(self) -> Tensor:
        """Return which predicates each slot can hold, bool of shape (slots, predicates)."""
        return torch.arange(self.predicates) < torch.tensor(self.limits)[:, None]

    def facts(self, unary: Bools, binary: Bools) -> tuple[Bools, Bools]:
        """Return the truth values of the unary (U, batch, N) and binary (B, batch, N, N) symbols."""
        one, two = np.moveaxis(unary, -1, 0), np.moveaxis(binary, -1, 0)
        if self.negation:
            one, two = np.concatenate([one, ~one]), np.concatenate([two, ~two])
        true = np.ones((1, *one.shape[1:]), np.bool_)
        return np.concatenate([one, true, ~true]), np.ascontiguousarray(two)

    def values(self, unary: Bools, binary: Bools) -> tuple[Tensor, Tensor, Tensor]:
        """Return the arguments `unary`, `binary` and `exist` of `infer` as float32."""
        one, two = self.facts(unary, binary)
        exist = present(unary, binary)
        return torch.from_numpy(one).float(), torch.from_numpy(two).float(), torch.from_numpy(exist).float()

    def infer(
        self, degrees: Tensor, unary: Tensor, binary: Tensor, exist: Tensor, conjunction: Literal["min", "product"]
    ) -> Tensor:
        """Return the soft truth value of the target for the ego, by the paper's inference without recursion.

        The value of a slot is the sum of the values of all predicates, weighted by the degrees to which it holds them.
        The disjunction and the existential quantifier are maxima. Variables range over the entities that exist.

        Args:
            degrees: Numbers of shape (models, slots, predicates). The sum over the predicates is 1.
            unary: The values of the unary symbols, (U, batch, N).
            binary: The values of the binary symbols, (B, batch, N, N).
            exist: Which entities exist, as numbers, (batch, N).
            conjunction: The soft conjunction.

        Returns:
            The values, (models, batch).
        """
        both = torch.minimum if conjunction == "min" else torch.mul
        n, parts = exist.shape[1], (len(self.unary), len(self.binary))
        # The predicates of lower layers, with their values (models, predicates, batch, N) and the same with N x N.
        ones: list[int] = []
        twos: list[int] = []
        one_values: list[Tensor] = []
        two_values: list[Tensor] = []

        def held(slots: Tensor, rows: slice = slice(None), columns: slice = slice(None)) -> Tensor:
            """Return the values of slots for pairs of entities, (models, slots, batch, rows, columns)."""
            degrees_one, degrees_two = slots[..., : sum(parts)].split(parts, -1)
            one = _weighted(degrees_one, unary[:, :, rows])
            if ones:
                one = one + _weighted(slots[..., ones], torch.cat(one_values, 1)[:, :, :, rows], True)
            total = one.unsqueeze(-1)
            if parts[1]:
                total = total + _weighted(degrees_two, binary[:, :, rows, columns])
            if twos:
                total = total + _weighted(slots[..., twos], torch.cat(two_values, 1)[:, :, :, rows, columns], True)
            return total.expand(-1, -1, -1, -1, len(range(n)[columns]))

        number = sum(parts)
        for layer in self.layers[:-1]:
            kinds = [(template, len(list(group))) for template, group in groupby(each.template for each in layer)]
            sizes = [SLOTS[template] * size for template, size in kinds]
            values = held(degrees[:, layer[0].slot : layer[0].slot + sum(sizes)]).split(sizes, 1)
            for (template, size), value in zip(kinds, values, strict=True):
                if template == "Inv":
                    value = value.transpose(-1, -2)
                else:
                    p, q, r = value.unflatten(1, (size, 3)).unbind(2)
                    if template == "B00+":
                        body = (both(p.unsqueeze(-1), q.unsqueeze(-3)) * exist[:, None, :, None]).amax(-2)
                    else:
                        body = both(p, q.transpose(-1, -2))
                    value = torch.maximum(body, r)
                if template == "A00+":
                    ones += range(number, number + size)
                    one_values.append((value * exist[:, None, :]).amax(-1))
                else:
                    twos += range(number, number + size)
                    two_values.append(value)
                number += size
        # The target is computed for the ego only.
        ego, everyone = slice(1), slice(None)
        p, q, r = degrees[:, self.invented[-1].slots].split(1, 1)
        p, q, r = held(p, ego), held(q, everyone, ego).transpose(-1, -2), held(r, ego)
        return (torch.maximum(both(p, q), r)[:, 0, :, 0] * exist).amax(-1)


def _weighted(degrees: Tensor, values: Tensor, models: bool = False) -> Tensor:
    """Return the sums of values weighted by degrees (models, slots, predicates): (models, slots, ...).

    Values have the shape (predicates, ...), or with `models` (models, predicates, ...).
    """
    first = 2 if models else 1
    return (degrees @ values.flatten(first)).unflatten(-1, values.shape[first:])


#: A literal of a body: whether it is positive, its predicate, and its variables. 0 and 1 are the arguments of the head.
#: (`symbolic.BodyLiteral` says whether it is negated.)
SignedLiteral: TypeAlias = tuple[bool, str, tuple[int, ...]]
#: The literals of a body.
Body: TypeAlias = frozenset[SignedLiteral]


@dataclass(frozen=True)
class Hypothesis:
    """A model in which each slot holds one predicate: that of `choices`."""

    program: ProgramTemplate
    choices: tuple[int, ...]

    def is_valid(self) -> bool:
        """Return whether each slot holds a predicate that it can hold."""
        limits = self.program.limits
        return len(self.choices) == len(limits) and all(
            isinstance(choice, int) and 0 <= choice < limit for choice, limit in zip(self.choices, limits, strict=True)
        )

    def holds(self, unary: Bools, binary: Bools) -> Bools:
        """Return whether the rules derive the target for the ego, bool (batch,), from the result of `relations`."""
        exist = present(unary, binary)
        one, two = self.program.facts(unary, binary)
        symbols = [*one[..., None], *two]

        @cache
        def pairs(predicate: int) -> Bools:
            """Return the truth values for all pairs, (batch, N, N), or (batch, N, 1) for a unary predicate."""
            if predicate < len(symbols):
                return np.asarray(symbols[predicate])
            invented = self.program.invented[predicate - len(symbols)]
            p, *more = map(pairs, self.choices[invented.slots])
            if invented.template == "Inv":
                return p.swapaxes(1, 2)
            q, r = more
            if invented.template == "B00+":
                return np.asarray((p[..., None] & q[:, None] & exist[:, None, :, None]).any(2) | r)
            either = np.asarray((p & q.swapaxes(1, 2)) | r)
            return (
                either if invented.template == "C00+" else np.asarray((either & exist[:, None]).any(2, keepdims=True))
            )

        return np.broadcast_to(pairs(self.program.predicates - 1), (len(exist), exist.shape[1], 1))[:, 0, 0]

    def bodies(self) -> tuple[list[Body], list[tuple[str, int, list[Body]]]]:
        """Unfold the layers into clauses over observed predicates.

        A predicate with more than `CLAUSES` clauses, or with more than `LITERALS` literals in one of them, keeps its
        definition. The ego is its additional first argument, because variables range over the entities that the ego
        sees.

        Returns:
            The bodies of the target, and the kept definitions: the name, the number of arguments, and the bodies.
        """
        definitions: list[tuple[str, int, list[Body]]] = []
        symbols = [*self.program.unary, *self.program.binary]

        def unfold(predicate: int, first: int, second: int) -> list[Body]:
            """Return the bodies of a predicate for two variables."""
            return [_renamed(body, {0: first, 1: second}) for body in define(predicate)]

        @cache
        def define(predicate: int) -> list[Body]:
            unary = self.program.is_unary(predicate)
            if predicate < len(symbols):
                name, sign = symbols[predicate]
                if not name:
                    return [frozenset()] if sign else []
                return [frozenset({(sign, name, (0,) if unary else (0, 1))})]
            invented = self.program.invented[predicate - len(symbols)]
            held = self.choices[invented.slots]
            if invented.template == "Inv":
                return unfold(held[0], 1, 0)
            # The additional variable of B is 2, before it gets a unique name.
            one, two = ((0, 2), (2, 1)) if invented.template == "B00+" else ((0, 1), (1, 0))
            bodies = [_joined(a, b) for a in unfold(held[0], *one) for b in unfold(held[1], *two)]
            bodies = _pruned(bodies + unfold(held[2], 0, 1), 1 if unary else 2)
            small = len(bodies) <= CLAUSES and all(len(body) <= LITERALS for body in bodies)
            if small or predicate == self.program.predicates - 1:
                return bodies
            name = f"Part{len(definitions) + 1}"
            definitions.append((name, 2 if unary else 3, bodies))
            return [frozenset({(True, name, (EGO, 0) if unary else (EGO, 0, 1))})]

        return unfold(self.program.predicates - 1, 0, 1), definitions


#: The largest number of clauses of a predicate that is unfolded.
CLAUSES = 16
#: The largest number of literals of one of these clauses.
LITERALS = 8
#: The variable of the ego in the definitions of predicates that are not unfolded.
EGO = -1


def _renamed(body: Body, names: Mapping[int, int]) -> Body:
    """Rename variables, all at once."""
    return frozenset(
        (sign, name, tuple(names.get(variable, variable) for variable in arguments)) for sign, name, arguments in body
    )


def _joined(one: Body, other: Body) -> Body:
    """Return the conjunction of two bodies, whose local variables are different ones."""
    first = 100 + max((variable for _, _, arguments in one for variable in arguments), default=0)
    return one | _numbered(other, LOCAL, first)


#: The first number of local variables. Smaller numbers are arguments of the head, and the variable of template B.
LOCAL = 10


def _pruned(bodies: Iterable[Body], arity: int) -> list[Body]:
    """Remove contradictions, and what other literals or bodies imply. Number local variables from `LOCAL` on."""
    kept: list[Body] = []
    for body in dict.fromkeys(bodies):
        if any((not sign, name, arguments) in body for sign, name, arguments in body):
            continue
        for literal in sorted(body):
            # The others imply it if a variable can have the value of another one.
            if _subsumes(body, body - {literal}, arity):
                body = body - {literal}
        reduced = _numbered(body, arity, LOCAL)
        if any(_subsumes(other, reduced, arity) for other in kept):
            continue
        kept = [other for other in kept if not _subsumes(reduced, other, arity)]
        kept.append(reduced)
    return kept


def _numbered(body: Body, least: int, first: int) -> Body:
    """Number the variables from `least` on in the order of the literals, with numbers from `first` on."""
    variables = (variable for _, _, arguments in sorted(body) for variable in arguments if variable >= least)
    return _renamed(body, {variable: first + at for at, variable in enumerate(dict.fromkeys(variables))})


def _subsumes(general: Body, special: Body, arity: int) -> bool:
    """Return whether some values of the local variables turn all literals of one body into literals of another."""

    def match(literals: Sequence[SignedLiteral], names: Mapping[int, int]) -> bool:
        if not literals:
            return True
        sign, name, arguments = literals[0]
        for other_sign, other_name, others in special:
            if (sign, name) != (other_sign, other_name):
                continue
            bound = dict(names)
            if all(
                bound.setdefault(one, other if one >= arity else one) == other
                for one, other in zip(arguments, others, strict=True)
            ) and match(literals[1:], bound):
                return True
        return False

    return {literal[:2] for literal in general} <= {literal[:2] for literal in special} and match(sorted(general), {})


VARIABLES = ("X", "Y", "Z", "W", "V", "U", "T", "S")


def _clause(
    head: str, arguments: tuple[int, ...], body: Body, more: Sequence[str] = (), names: Mapping[str, str] = {}
) -> str:
    """Format a clause with new names of predicates. If no positive literal binds a variable, `Sees` does."""
    ego = arguments[0]
    body = frozenset((sign, names.get(name, name), literal) for sign, name, literal in body)
    bound = {v for sign, _, literal in body for v in literal if sign}
    used = [*arguments, *sorted({v for _, _, literal in body for v in literal} - {*arguments, EGO})]
    texts = {variable: VARIABLES[at] if at < len(VARIABLES) else f"V{at}" for at, variable in enumerate(used)}
    texts[EGO] = texts[ego]

    def atom(name: str, variables: Iterable[int]) -> str:
        return f"{name}({', '.join(texts[variable] for variable in variables)})"

    # Literals about the ego come first, positive ones before negative ones.
    ordered = sorted(body, key=lambda literal: (max(literal[2]), not literal[0], literal[1:]))
    atoms = ((sign, atom(name, variables)) for sign, name, variables in ordered)
    literals = [*more, *(text if sign else f"Not({text})" for sign, text in atoms)]
    unbound = [variable for variable in used if variable not in (*bound, ego)]
    literals += [atom("Sees", (ego, variable)) for variable in unbound]
    if not unbound and not bound & {ego, EGO}:
        literals.append(atom("Sees", (ego, ego)))
    return f"{atom(head, arguments)} :- {', '.join(literals)}."


class HriPolicy(LearnedPolicy):
    """A policy that evaluates learned rules. `models` has the rules of each action, in the order of precedence."""

    def __init__(self, mode: str, layout: Layout, settings: HriSettings, models: Mapping[str, Hypothesis]) -> None:
        """Store the arguments."""
        self.mode, self.layout, self.settings, self.models = mode, layout, settings, dict(models)

    def _decide(self, observation: Observations, deterministic: bool) -> Actions:
        check_shape(observation, self.layout.width, self.mode)
        values = relations(self.layout, observation)
        actions = np.full(len(observation), ACTIONS.index(DEFAULT), np.int64)
        for name, hypothesis in reversed(self.models.items()):
            actions[hypothesis.holds(*values)] = ACTIONS.index(name)
        return actions

    def rules(self) -> str:
        """Return the source of a rule file whose clauses derive the same actions as `predict`.

        The file includes the vocabulary of the modes. If several actions are derived, those with precedence exclude the
        others by negated literals.
        """
        title = f"// Rules learned by hierarchical rule induction from demonstrations of {self.mode}."
        lines = [title, '.include "vocabulary.dl"']
        earlier: list[str] = []
        for action, hypothesis in self.models.items():
            bodies, definitions = hypothesis.bodies()
            names = {name: f"{action}{name}" for name, _, _ in definitions}
            for name, arguments, parts in definitions:
                columns = ", ".join(f"{column}: agent" for column in ("e", "x", "y")[:arguments])
                lines += ["", f"/// A part of the rules for {action}; e is the agent that decides."]
                lines.append(f".decl {names[name]}({columns})")
                head = (EGO, 0, 1)[:arguments]
                lines += [_clause(names[name], head, body, names=names) for body in parts]
            guards = [f"Not({name}(X))" for name in earlier]
            if bodies:
                lines += ["", *(_clause(action, (0,), body, guards, names) for body in bodies)]
                earlier.append(action)
        return "\n".join(lines) + "\n"

    def save(self, path: Path) -> None:
        """Write the policy to a file."""
        # The dictionary has one atom of each predicate, which tells the arity.
        predicates = [(name, len(entities)) for name, entities in dict(self.layout.atoms()).items()]
        models = [(action, len(each.program.layers), list(each.choices)) for action, each in self.models.items()]
        plain = {
            "format": FORMAT,
            "algorithm": "hri",
            "mode": self.mode,
            "layout": (self.layout.entities, predicates, self.layout.route_length is not None),
            "settings": self.settings.model_dump(),
            "models": models,
        }
        torch.save(plain, path)

    @classmethod
    def load(cls, path: Path) -> HriPolicy:
        """Read a policy that `save` wrote."""
        plain = read_tensors(path, "a file of hri")
        found = plain.get("format") if isinstance(plain, dict) else None
        if found != FORMAT:
            raise ValueError(f"{path} is not a file of hri: expected the format `{FORMAT}`, not `{found}`")
        try:
            entities, predicates, route_length = plain["layout"]
            atoms = [(name, at) for name, arity in predicates for at in product(range(entities), repeat=arity)]
            layout = Layout.of_atoms(atoms, route_length)
            settings = HriSettings.model_validate(plain["settings"])
            models = {}
            for action, depth, choices in plain["models"]:
                if depth not in range(1, 17):
                    raise ValueError(f"expected 1 to 16 layers, not {depth}")
                program = ProgramTemplate(layout, settings, depth)
                models[action] = Hypothesis(program, tuple(choices))
                if action not in ACTIONS or not models[action].is_valid():
                    raise ValueError(f"invalid rules for {action}")
            return cls(plain["mode"], layout, settings, models)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is not a policy of hri: {error}") from error


class Quality(NamedTuple):
    """How well rules agree with the oracle about one action. Better rules are larger.

    Attributes:
        reproduced: The share of trajectories in which they agree in every step. A wrong step can end an episode, or
            stop the car until the horizon. So this share estimates the success rate better than the accuracy.
        accuracy: The mean of the shares of positive and of negative examples that they decide right.
    """

    reproduced: float
    accuracy: float


class _ActionTrainer:
    """Trains `restarts` models of one action, which differ in their first weights and in the noise.

    Attributes:
        best: The best rules of this generation on the demonstrations; at its start, those of the last one.
        quality: The quality of `best`; negative at the start of a generation.
    """

    def __init__(self, program: ProgramTemplate, settings: HriSettings, generator: torch.Generator) -> None:
        """Draw the embeddings."""
        self.program, self.settings = program, settings
        self.hidden = ~program.visible()
        self.start(generator)
        self.best = Hypothesis(program, self._extract()[0])

    def start(self, generator: torch.Generator) -> None:
        """Start a generation: draw the embeddings."""
        restarts, program = self.settings.restarts, self.program
        dimension = self.settings.dimension or program.predicates
        self.predicates, self.rules = (
            torch.randn(restarts, count, dimension, generator=generator, requires_grad=True)
            for count in (program.predicates, program.slots)
        )
        self.optimizer = torch.optim.Adam([{"params": [self.predicates]}, {"params": [self.rules]}], lr=1.0)
        self.quality = Quality(-1.0, -1.0)

    def similarities(self) -> Tensor:
        """Return the cosine similarities of slots and predicates, (restarts, slots, predicates)."""
        rules = torch.nn.functional.normalize(self.rules, dim=-1)
        predicates = torch.nn.functional.normalize(self.predicates, dim=-1)
        return (rules @ predicates.transpose(-1, -2)).masked_fill(self.hidden, -torch.inf)

    def _extract(self) -> list[tuple[int, ...]]:
        return list(map(tuple, self.similarities().argmax(-1).tolist()))

    def extract(self, examples: Examples) -> None:
        """Discretize all models, and keep the best one if it improves on `best`."""
        for choices in dict.fromkeys(self._extract()):
            hypothesis = Hypothesis(self.program, choices)
            quality = examples.quality(hypothesis)
            if quality > self.quality:
                self.best, self.quality = hypothesis, quality

    def state(self) -> dict[str, Any]:
        """Return the weights, the state of the optimizer, and the best rules as plain data."""
        return {
            "predicates": self.predicates.detach(),
            "rules": self.rules.detach(),
            "optimizer": self.optimizer.state_dict(),
            "choices": list(self.best.choices),
            "quality": list(self.quality),
        }

    def restore(self, state: Mapping[str, Any], action: str) -> None:
        """Restore what `state` returned."""
        best = Hypothesis(self.program, tuple(state["choices"]))
        weights = {"predicates": self.predicates, "rules": self.rules}
        if not best.is_valid() or any(state[name].shape != weight.shape for name, weight in weights.items()):
            raise ValueError(f"the sizes of the models of {action} are those of other settings")
        with torch.no_grad():
            for name, weight in weights.items():
                weight.copy_(state[name])
        restore_optimizer(self.optimizer, state["optimizer"])
        self.best, self.quality = best, Quality(*state["quality"])

    def update(self, examples: Examples, progress: float, generator: torch.Generator) -> float:
        """Run one update after a share `progress` of all. Return the mean cross entropy without the regularization."""
        settings = self.settings
        rates = (settings.embedding_rates, settings.rule_rates)
        for group, rate in zip(self.optimizer.param_groups, rates, strict=True):
            group["lr"] = _between(rate, progress)
        unary, binary, exist, wanted = examples.sample(settings.batch, generator)
        similarities = self.similarities()
        uniform = torch.rand(similarities.shape, generator=generator).clamp_(1e-10, 1 - 1e-7)
        noise = -torch.log(-torch.log(uniform)) * _between(settings.noise, progress)
        degrees = torch.softmax((similarities + noise) / _between(settings.temperatures, progress), -1)
        values = self.program.infer(degrees, unary, binary, exist, settings.conjunction)
        fit = torch.nn.functional.binary_cross_entropy(
            values.clamp(1e-6, 1 - 1e-6), wanted.expand_as(values), reduction="none"
        ).mean(1)
        loss = fit + settings.regularization * (degrees * (1 - degrees)).mean((1, 2))
        # The models share no weights: the gradient of the sum has the gradient of each.
        minimize(loss.sum(), self.optimizer)
        return float(fit.detach().mean())


def _between(ends: tuple[float, float], progress: float) -> float:
    """Interpolate exponentially."""
    return float(ends[0] * (ends[1] / ends[0]) ** progress)


class Examples:
    """The distinct observations of demonstrations, and in which of them the oracle takes an action."""

    def __init__(
        self, program: ProgramTemplate, layout: Layout, observations: Observations, taken: Bools, of: NDArray[Any]
    ) -> None:
        """Prepare the truth values. The last three arguments have a row per step; `of` is its trajectory, from 0 on."""
        rows, first, inverse = np.unique(observations, axis=0, return_index=True, return_inverse=True)
        # NumPy 2.0 returns a column.
        self._at = inverse.reshape(-1)
        self.unary, self.binary = relations(layout, rows)
        self.taken, self._trajectories = taken[first], of
        self._unary, self._binary, self._exist = program.values(self.unary, self.binary)
        self._parts = [torch.from_numpy(np.flatnonzero(self.taken == sign)) for sign in (True, False)]

    def sample(self, batch: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Draw examples, half of them positive, or fewer if there are only positive or only negative ones.

        Return `ProgramTemplate.values` of them, and whether each example is positive, float32 (batch,).
        """
        sizes = (batch // 2, batch - batch // 2)
        draws = [
            part[torch.randint(len(part), (size,), generator=generator)] if len(part) else part
            for part, size in zip(self._parts, sizes, strict=True)
        ]
        at = torch.cat(draws)
        wanted = torch.cat([torch.ones(len(draws[0])), torch.zeros(len(draws[1]))])
        return self._unary[:, at], self._binary[:, at], self._exist[at], wanted

    def quality(self, hypothesis: Hypothesis) -> Quality:
        """Measure rules on the demonstrations."""
        right = hypothesis.holds(self.unary, self.binary) == self.taken
        rates = [float(right[self.taken == sign].mean()) for sign in (True, False) if (self.taken == sign).any()]
        wrong = np.bincount(self._trajectories, ~right[self._at])
        return Quality(float((wrong == 0).mean()), sum(rates) / len(rates))


class HRI(Learner):
    """Hierarchical Rule Induction. One step updates the models of all actions once."""

    settings_class = HriSettings
    unit: ClassVar = "updates"
    interacts = False
    takes_numbers = False
    policy_class = HriPolicy
    steps = 0
    _settings: HriSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Run the oracle on the recorded training episodes, and draw the first weights."""
        super().__init__(config, log)
        settings = self._settings
        asked = {constraint["action"] for constraint in _logicity.describe(load_task(config.mode))["constraints"]}
        data = DemonstrationData.load(config.mode, config.demonstrations)
        self._layout = data.layout
        self._generator = torch.Generator().manual_seed(config.seed)
        self._trainers: dict[str, _ActionTrainer] = {}
        self._examples: dict[str, Examples] = {}
        observations, actions, trajectories = (
            each.numpy() for each in (data.observations, data.actions, data.trajectories)
        )
        for action in (each for each in settings.order if each in asked):
            program = ProgramTemplate(self._layout, settings, settings.depth_of.get(action, settings.depth))
            taken = actions == ACTIONS.index(action)
            self._examples[action] = Examples(program, self._layout, observations, taken, trajectories)
            self._trainers[action] = _ActionTrainer(program, settings, self._generator)

    def _step(self, steps: int) -> None:
        length = self._settings.generation or self.config.steps
        if self.steps and self.steps % length == 0:
            for trainer in self._trainers.values():
                trainer.start(self._generator)
        done, losses = self.steps % length / length, {}
        for action, trainer in self._trainers.items():
            losses[action] = trainer.update(self._examples[action], done, self._generator)
        self.steps += 1
        if self.steps % self._settings.extract_every == 0 or self.steps == self.config.steps:
            for action, trainer in self._trainers.items():
                trainer.extract(self._examples[action])
                values = {"loss": losses[action], **trainer.quality._asdict()}
                self._curves.add({f"{name}/{action}": value for name, value in values.items()})
            self._curves.write(self.steps)

    def policy(self) -> HriPolicy:
        """Return the best rules so far."""
        best = {action: trainer.best for action, trainer in self._trainers.items()}
        return HriPolicy(self.config.mode, self._layout, self._settings, best)

    def state(self) -> dict[str, Any]:
        """Return the weights, the best rules, and the states of the optimizers and of the generator."""
        models = {action: trainer.state() for action, trainer in self._trainers.items()}
        return {"steps": self.steps, "generator": self._generator.get_state(), "models": models}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        if list(state["models"]) != list(self._trainers):
            raise ValueError(f"the checkpoint has models of other actions: {', '.join(state['models'])}")
        for action, trainer in self._trainers.items():
            trainer.restore(state["models"][action], action)
        self._generator.set_state(state["generator"])
        self.steps = state["steps"]
