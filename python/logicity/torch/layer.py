"""The layer: its inputs and outputs, and the semantics of its clauses."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np

from .. import _logicity
from ..errors import as_integer, checked_path, did_you_mean, extra
from ..rules import Program
from .clauses import Atom, Clause, Clauses, Past
from .derivatives import once
from .exact import Circuits, Proof

with extra("learn"):
    import torch
    from torch import Tensor, nn
    from torch.autograd.function import FunctionCtx

__all__ = ["DEFAULT", "PRIORITY", "RuleLayer", "Semantics"]

Semantics: TypeAlias = Literal["godel", "product", "lukasiewicz", "exact", "top-k"]
"""The meaning of conjunction, disjunction and negation, or how probabilities are computed."""

#: The order of actions and the default in `configs/common.yaml`.
PRIORITY = ("Stop", "Slow", "Fast", "Normal")
DEFAULT = "Normal"


class _Tick:
    """The degrees in one tick.

    Attributes:
        count: The number of entities.
        values: Those of derived predicates: (B, N, ..., N), or (B, E, N, ...) if only those of the egos are needed.
        selected: Those of predicates in which a dimension has the egos only, by predicate and dimension.
        blocks: Those of all binary inputs, with the egos only in a dimension, 1 or 2, or with all entities in both.
    """

    def __init__(self, unary: Tensor, binary: Tensor, mask: Tensor | None) -> None:
        self.count, self.binary = unary.shape[1], binary
        self.mask = None if mask is None else mask.to(unary.dtype)
        self.unary = unary if self.mask is None else unary * self.mask[..., None]
        self.values: dict[int, Tensor] = {}
        self.selected: dict[tuple[int, int], Tensor] = {}
        self.blocks: dict[int, tuple[Tensor, ...]] = {}

    def zeros(self, arity: int) -> Tensor:
        """Return degrees 0 of a predicate."""
        return self.unary.new_zeros(self.unary.shape[0], *[self.count] * arity)

    def eye(self) -> Tensor:
        """Return which entities are the same, (1, N, N)."""
        return torch.eye(self.count, dtype=self.unary.dtype, device=self.unary.device)[None]

    def unary_input(self, column: int) -> Tensor:
        """Return the degrees of a unary input."""
        if -1 not in self.blocks:
            self.blocks[-1] = self.unary.movedim(-1, 0).contiguous().unbind(0)
        return self.blocks[-1][column]

    def binary_input(self, column: int, axis: int, egos: Tensor | None) -> Tensor:
        """Return the degrees of a binary input, with the egos alone in the dimension `axis`; in none if it is 0."""
        if not axis and egos is not None:
            # Few inputs are needed for all entities.
            return self._masked(self.binary[..., column], self.mask, self.mask)
        if axis not in self.blocks:
            block, first, second = self.binary, self.mask, self.mask
            if axis and egos is not None:
                block = block.index_select(axis, egos)
                chosen = None if self.mask is None else self.mask.index_select(1, egos)
                first, second = (chosen, second) if axis == 1 else (first, chosen)
            block = self._masked(block.movedim(-1, 0).contiguous(), first, second)
            self.blocks[axis] = block.unbind(0)
        return self.blocks[axis][column]

    @staticmethod
    def _masked(values: Tensor, first: Tensor | None, second: Tensor | None) -> Tensor:
        return values if first is None or second is None else values * (first[:, :, None] * second[:, None, :])


class RuleLayer(nn.Module):
    """The rules of a file on degrees from 0 to 1, differentiable with respect to them.

    The rules may negate, recur to a bounded depth, have probabilities, and read earlier ticks. Their predicates relate
    entities; clauses that compare or count values are refused.

    Args:
        rules: A rule file, which may be a built-in one such as `expert`, or a program.
        semantics: `godel`, `product`, `lukasiewicz`, `exact` or `top-k`; see the module.
        queries: Further derived predicates to compute. `degrees` returns them.
        priority: The actions in the order of `actions.priority` of a configuration: the first that is derived is
            taken. By default that of `configs/common.yaml`. The rules need not declare these four and `default`; they
            must declare any other action.
        default: The action of an entity for which none is derived. A name that the rules do not declare must not
            resemble an action.
        depth: How often the clauses of recursive predicates are applied. Atoms whose derivation needs more are 0.
        learn_weights: Whether each clause of the source that the layer uses has a weight, from 0 to 1, which is a
            conjunct of its body. `weight_logits` is its parameter, with one element for each of `clauses`.
        k: The number of proofs that `top-k`, and the method `proofs` of every semantics, keep for each atom.
        nodes_max: The largest number of decisions in the diagram of a scene, for `exact`, `top-k` and `proofs`.

    Attributes:
        unary: The names of the U input predicates over one entity, in the order of the input.
        binary: The names of the R input predicates over two entities, in the same order.
        actions: The names of the actions: `priority`, and the default if it is not among them.
        clauses: The labels of the clauses of the source that the layer uses.
        temporal: Whether the rules read earlier ticks. Inputs then have a dimension of time.
        weight_logits: (clauses,): the logits of the weights, initially 3, a weight of 0.95. `None` without
            `learn_weights`.

    Raises:
        InputError: If the rules are invalid.
        OSError: If the file cannot be read.
        TypeError: If an argument has another type.
        ValueError: If an action or a query needs a clause that has no degree, if no clause derives a query, if the
            rules do not declare an action of `priority`, or if an argument is out of range.
    """

    weight_logits: nn.Parameter | None

    def __init__(
        self,
        rules: str | os.PathLike[str] | Program,
        semantics: Semantics = "product",
        *,
        queries: Iterable[str] = (),
        priority: Sequence[str] = PRIORITY,
        default: str = DEFAULT,
        depth: int | None = None,
        learn_weights: bool = False,
        k: int = 10,
        nodes_max: int = 1 << 20,
    ) -> None:
        """Read the clauses."""
        super().__init__()
        if semantics not in get_args(Semantics):
            raise ValueError(f"semantics: expected one of {', '.join(get_args(Semantics))}, not {semantics!r}")
        sizes = {"k": k, "nodes_max": nodes_max} | ({} if depth is None else {"depth": depth})
        for name, value in sizes.items():
            if as_integer(name, value) < 1:
                raise ValueError(f"{name}: expected at least 1, not {value}")
        self.semantics, self.depth, self.k, self.nodes_max = semantics, depth, k, nodes_max
        is_exact = semantics in ("exact", "top-k")
        self.queries, order = _names("queries", "predicates", queries), _names("priority", "actions", priority)
        if not isinstance(default, str):
            raise TypeError(f"default: expected str, not {type(default).__name__}")
        self.program = rules if isinstance(rules, Program) else Program.load(checked_path("rules", rules))
        self.default = default
        self.actions = tuple(dict.fromkeys([*order, default]))
        self._rules = Clauses(self.program, self.queries, self.actions, default, depth, by_engine=is_exact)
        declared = [name for name, place in self._rules.places.items() if place not in self._rules.inputs]
        known = dict.fromkeys([*PRIORITY, *declared])
        if default not in known and _logicity.did_you_mean(default, [*known]) is not None:
            raise ValueError(f"default: the rules declare no action `{default}`{did_you_mean(default, known)}")
        for name in self.actions:
            argument = "default" if name == default else "priority"
            if self._rules.places.get(name) in self._rules.inputs:
                raise ValueError(f"{argument}: `{name}` is an input, not an action")
            if name not in known and name != default:
                raise ValueError(f"priority: the rules declare no action `{name}`{did_you_mean(name, known)}")
        self.unary, self.binary, self.clauses = self._rules.unary, self._rules.binary, self._rules.labels
        self.temporal = bool(self._rules.pasts)
        self.weight_logits = nn.Parameter(torch.full((len(self.clauses),), 3.0)) if learn_weights else None
        self._circuits = self._compiled(k if semantics == "top-k" else None) if is_exact else None
        #: Those of `proofs`, made when it is called.
        self._by_proofs = self._circuits if semantics == "top-k" else None

    def _compiled(self, proofs: int | None) -> Circuits:
        weighted = self.weight_logits is not None
        return Circuits(self.program, self._rules, self.queries, (proofs, self.nodes_max), weighted)

    def extra_repr(self) -> str:
        """Return what `repr` shows."""
        return f"{self.program._program.files()[0][0]}, {self.semantics}, {len(self.clauses)} clauses"

    def forward(
        self, unary: Tensor, binary: Tensor, mask: Tensor | None = None, egos: Sequence[int] | None = None
    ) -> Tensor:
        """Return the degree to which each action is the answer, (B, E, A) in the order of `actions`.

        An action is the answer if it is derived, and none that comes before it in the order of priority. The answer
        with the greatest degree is the decision. With degrees 0 and 1, exactly one action has the degree 1.

        Args:
            unary: (B, N, U), the degrees of the atoms of `self.unary`; with temporal operators (B, T, N, U). They must
                be from 0 to 1. Only `exact` and `top-k` check it, since a check waits for the device.
            binary: (B, N, N, R), those of `self.binary`, or (B, T, N, N, R).
            mask: (B, N) or (B, T, N): 1 or true for the entities that are present; by default all are. No atom holds of
                the others.
            egos: The E entities that decide, from 0 to N - 1; -1 is the last one. By default all N.

        Returns:
            (B, E, A), or (B, T, E, A) with temporal operators.

        Raises:
            TypeError: If an argument has another type.
            ValueError: If a shape is wrong, an ego does not exist, or `exact` or `top-k` gets a degree that is not from
                0 to 1.
        """
        return self.degrees(unary, binary, mask, egos)[0]

    def degrees(
        self, unary: Tensor, binary: Tensor, mask: Tensor | None = None, egos: Sequence[int] | None = None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Variant of `forward` that also returns the degrees of derived actions and of `queries` by name.

        Those of an action are (B, E) and do not depend on the order of priority; those of a query are (B, N) for a
        predicate over one entity, (B, N, N) for one over two, and so on. With temporal operators, T follows B.
        """
        self._check(unary, binary, mask)
        count = unary.shape[-2]
        numbers = None if egos is None else _checked_egos(egos, count)
        if self._circuits is not None:
            each = range(count) if numbers is None else numbers
            found = self._exactly(self._circuits, (unary, binary, mask), each)
            return cast("tuple[Tensor, dict[str, Tensor]]", found)
        chosen = None if numbers is None else torch.tensor(numbers, device=unary.device)
        if not self.temporal:
            return self._answer(self._tick(unary, binary, mask, chosen, []), chosen)
        history: list[_Tick] = []
        answers, derived = [], []
        for tick in range(unary.shape[1]):
            now = (unary[:, tick], binary[:, tick], None if mask is None else mask[:, tick])
            history.append(self._tick(*now, chosen, history))
            answer, names = self._answer(history[-1], chosen)
            answers.append(answer)
            derived.append(names)
        return torch.stack(answers, 1), {name: torch.stack([each[name] for each in derived], 1) for name in derived[0]}

    @torch.compiler.disable  # type: ignore[untyped-decorator]
    def _exactly(
        self, circuits: Circuits, inputs: tuple[Tensor, Tensor, Tensor | None], egos: Sequence[int]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        _check_probabilities(inputs[0], inputs[1])
        return circuits.degrees(inputs, egos, self.weights(), self.actions, self.default)

    def proofs(
        self, unary: Tensor, binary: Tensor, mask: Tensor | None = None, *, ego: int = 0, action: str
    ) -> list[Proof]:
        """Return the `k` most probable proofs that an ego of one scene decides for an action, the best one first.

        A proof is a set of facts that hold or do not hold, whose probabilities are taken as independent. With temporal
        operators, the decision is that of the last tick.

        Args:
            unary: (N, U), or (T, N, U) with temporal operators: probabilities.
            binary: (N, N, R), or (T, N, N, R).
            mask: (N,) or (T, N).
            ego: The entity that decides, as in `egos` of `forward`.
            action: One of `actions`.

        Raises:
            TypeError: If an argument has another type.
            ValueError: If a shape is wrong, a probability is not from 0 to 1, there is no such ego or action, or the
                proofs need too many steps.
        """
        _check_types(unary, binary, mask)
        shape = "(T, N" if self.temporal else "(N"
        if unary.ndim != (3 if self.temporal else 2):
            shape += f", {len(self.unary)})"
            raise ValueError(f"unary: proofs concern one scene: expected the shape {shape}, not {tuple(unary.shape)}")
        self._check(unary[None], binary[None], None if mask is None else mask[None])
        number = _checked_ego("ego", ego, unary.shape[-2])
        if action not in self.actions:
            raise ValueError(f"action: expected one of {', '.join(self.actions)}, not {action!r}")
        _check_probabilities(unary, binary)
        if self._by_proofs is None:
            self._by_proofs = self._compiled(self.k)
        return self._by_proofs.proofs((unary, binary, mask), number, action, self.default, self.weights())

    def weights(self) -> Tensor | None:
        """Return the weights of `clauses`, (clauses,) from 0 to 1; `None` without `learn_weights`."""
        return None if self.weight_logits is None else self.weight_logits.sigmoid()

    # --- evaluation

    def _check(self, unary: Tensor, binary: Tensor, mask: Tensor | None) -> None:
        _check_types(unary, binary, mask)
        leading = "(B, T, N" if self.temporal else "(B, N"
        dimensions = 4 if self.temporal else 3
        if unary.ndim != dimensions or unary.shape[-1] != len(self.unary):
            raise ValueError(f"unary: expected the shape {leading}, {len(self.unary)}), not {tuple(unary.shape)}")
        shape = (*unary.shape[:-1], unary.shape[-2], len(self.binary))
        if binary.shape != shape:
            raise ValueError(f"binary: expected the shape {shape}, not {tuple(binary.shape)}")
        if mask is not None and mask.shape != unary.shape[:-1]:
            raise ValueError(f"mask: expected the shape {tuple(unary.shape[:-1])}, not {tuple(mask.shape)}")
        if self.temporal and not unary.shape[1]:
            raise ValueError(f"unary: expected at least one tick, not the shape {tuple(unary.shape)}")
        for name, values in (("unary", unary), ("binary", binary)):
            if not values.is_floating_point():
                raise ValueError(f"{name}: expected degrees of a floating-point type, not {values.dtype}")

    def _tick(
        self, unary: Tensor, binary: Tensor, mask: Tensor | None, egos: Tensor | None, history: list[_Tick]
    ) -> _Tick:
        """Compute all predicates in one tick, after those of earlier ticks."""
        tick = _Tick(unary, binary, mask)
        for past in self._rules.pasts:
            tick.values[past.predicate] = self._remembered(past, history, tick)
        for stratum in self._rules.strata:
            rounds = (self.depth or 1) if stratum.recursive else 1
            for _ in range(rounds):
                found = {place: self._derive(clauses, tick, egos) for place, clauses in stratum.clauses.items()}
                tick.values.update(found)
                # What recursive clauses read has changed.
                tick.selected = {key: value for key, value in tick.selected.items() if key[0] not in found}
        return tick

    def _value(self, place: int, tick: _Tick, egos: Tensor | None = None) -> Tensor:
        """Return the degrees of a predicate; 0 if nothing derives it, or nothing has yet."""
        if place in tick.values:
            return tick.values[place]
        arity = self._rules.arities[place]
        if place not in self._rules.inputs:
            return tick.zeros(arity)
        column = self._rules.inputs[place]
        return tick.unary_input(column) if arity == 1 else tick.binary_input(column, 0, egos)

    def _remembered(self, past: Past, history: list[_Tick], now: _Tick) -> Tensor:
        """Return the degrees of what a temporal operator reads. Before the first tick nothing held."""

        def ago(place: int, ticks: int) -> Tensor:
            return self._value(place, history[-ticks])

        last = len(history) if past.last is None else past.last
        ticks = range(past.first, min(last, len(history)) + 1)
        if not ticks or (past.operator == "always" and last > len(history)):
            return now.zeros(self._rules.arities[past.operand])
        if past.operator == "always":
            return self._all([ago(past.operand, tick) for tick in ticks])
        degrees, held = [], None
        for tick in range(1, ticks.stop):
            if tick in ticks:
                degree = ago(past.operand, tick)
                degrees.append(degree if held is None else self._both(degree, held))
            if past.held is not None:
                # What stands before `since` must hold in all ticks after the one in which the operand held.
                place, columns = past.held
                degree = _aligned(ago(place, tick), columns, self._rules.arities[past.operand])
                held = degree if held is None else self._both(held, degree)
        return self._any(torch.stack(degrees, -1), 1)

    def _derive(self, clauses: list[Clause], tick: _Tick, egos: Tensor | None) -> Tensor:
        """Return the degrees of a predicate from those of the predicates in the bodies of its clauses."""
        found = [self._degree(clause, tick, egos) for clause in clauses]
        return found[0] if len(found) == 1 else self._any(torch.stack(torch.broadcast_tensors(*found), -1), 1)

    def _degree(self, clause: Clause, tick: _Tick, egos: Tensor | None) -> Tensor:
        """Return the degrees of the head of a clause."""
        narrowed = egos if clause.head.predicate in self._rules.alone else None
        # The degrees of the literals over the same variables.
        groups: dict[frozenset[int], Tensor] = {}

        def add(axes: Sequence[int], value: Tensor, holds: bool) -> None:
            value = _aligned(value, axes, clause.count)
            value = value if holds else 1 - value
            key = frozenset(axes)
            groups[key] = self._both(groups[key], value) if key in groups else value

        for atom, holds in clause.literals:
            value = self._selected(atom, tick, egos, narrowed)
            add([term for term in atom.terms if term is not None], value, holds)
        for one, other, holds in clause.same:
            eye = tick.eye()
            if narrowed is not None and 0 in (one, other):
                eye = eye[:, narrowed]
                one, other = (one, other) if one == 0 else (other, one)
            add((one, other), eye, holds)
        # Literals over few variables are combined with those over more, whose degrees are large.
        left = sorted(groups, key=len)
        for place, key in enumerate(left[:-1]):
            larger = next((other for other in left[place + 1 :] if key <= other), left[-1])
            groups[larger] = self._both(groups[larger], groups.pop(key))
        total = groups[left[-1]]
        weights = self.weights()
        if weights is not None and clause.number >= 0:
            total = self._both(total, weights[clause.number])
        if clause.probability != 1:
            total = self._both(total, total.new_tensor(clause.probability))
        heads = list(dict.fromkeys(cast("tuple[int, ...]", clause.head.terms)))
        total = self._any(total, clause.count - len(heads))
        if len(heads) == len(clause.head.terms):
            return total
        # P(X, X) holds of equal entities only.
        terms = clause.head.terms
        total = _aligned(total, [terms.index(head) for head in heads], len(terms))
        for place, term in enumerate(terms):
            if (first := terms.index(term)) < place:
                total = total * _aligned(tick.eye(), (first, place), len(terms))
        return total

    def _selected(self, atom: Atom, tick: _Tick, egos: Tensor | None, narrowed: Tensor | None) -> Tensor:
        """Return the degrees of an atom: (B, ...) with a dimension for each variable, E long for variable 0 of egos."""
        axes = [axis + 1 for axis, term in enumerate(atom.terms) if narrowed is not None and term == 0]
        if axes and atom.predicate in self._rules.inputs and len(atom.terms) == 2:
            value = tick.binary_input(self._rules.inputs[atom.predicate], axes.pop(0), narrowed)
        else:
            value = self._value(atom.predicate, tick, egos)
            if atom.predicate in self._rules.alone:
                axes = axes[1:]
        for axis in axes:
            key = (atom.predicate, axis)
            if len(atom.terms) > 1 or key not in tick.selected:
                tick.selected[key] = value.index_select(axis, cast(Tensor, narrowed))
            value = tick.selected[key]
        free = [axis + 1 for axis, term in enumerate(atom.terms) if term is None]
        if free:
            kept = [axis + 1 for axis, term in enumerate(atom.terms) if term is not None]
            value = self._any(value.permute(0, *kept, *free), len(free))
        return value

    def _answer(self, tick: _Tick, egos: Tensor | None) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the degrees of the answers, and those of derived actions and queries by name."""
        derived: dict[str, Tensor] = {}
        for name in self._rules.derived:
            place = self._rules.places[name]
            if place in tick.values:
                value = tick.values[place]
                derived[name] = value if egos is None or place in self._rules.alone else value.index_select(1, egos)
        shape = (tick.unary.shape[0], tick.count if egos is None else len(egos))
        left, answers = tick.unary.new_ones(shape), dict.fromkeys(self.actions, tick.unary.new_zeros(shape))
        for name in self.actions:
            if name in derived:
                answers[name] = self._both(left, derived[name])
                left = self._both(left, 1 - derived[name])
        rest = torch.stack([answers[self.default], left], -1)
        answers[self.default] = rest.sum(-1) if self.semantics == "product" else self._any(rest, 1)
        queries = {name: self._value(self._rules.places[name], tick) for name in self.queries}
        return torch.stack([answers[name] for name in self.actions], -1), derived | queries

    # --- semantics

    def _both(self, first: Tensor, second: Tensor) -> Tensor:
        if self.semantics == "product":
            return first * second
        if self.semantics == "godel":
            return cast(Tensor, _Minimum.apply(first, second))
        return (first + second - 1).clamp(min=0)

    def _all(self, values: Sequence[Tensor]) -> Tensor:
        total = values[0]
        for value in values[1:]:
            total = self._both(total, value)
        return total

    def _any(self, values: Tensor, dimensions: int) -> Tensor:
        """Return the disjunction over the last dimensions."""
        if not dimensions:
            return values
        flat = values.flatten(values.ndim - dimensions)
        if self.semantics == "product":
            return cast(Tensor, _NoisyOr.apply(flat))
        # Without entities, there is no maximum, and the sum is 0.
        if self.semantics == "godel" and flat.shape[-1]:
            return flat.max(-1).values
        return flat.sum(-1).clamp(max=1)


class _Minimum(torch.autograd.Function):
    """The minimum of two tensors, with the whole gradient for one of them: half the time of that of `torch.minimum`."""

    @staticmethod
    def forward(ctx: FunctionCtx, first: Tensor, second: Tensor) -> Tensor:
        ctx.save_for_backward(first, second)
        return torch.minimum(first, second)

    @staticmethod
    @once
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor]:
        first, second = ctx.saved_tensors
        chosen = gradient * (first < second).to(gradient.dtype)
        return chosen.sum_to_size(first.shape), (gradient - chosen).sum_to_size(second.shape)


class _NoisyOr(torch.autograd.Function):
    """1 - (1 - a)(1 - b)... over the last dimension, whose gradient is right and fast where some are 1."""

    @staticmethod
    def forward(ctx: FunctionCtx, values: Tensor) -> Tensor:
        others = 1 - values
        product = others.prod(-1)
        ctx.save_for_backward(others, product)
        return 1 - product

    @staticmethod
    @once
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        others, product = ctx.saved_tensors
        # The derivative is the product of the other factors. With one factor 0, all others have the derivative 0.
        zero = others == 0
        zeros = zero.sum(-1, keepdim=True)
        rest = torch.where(zero, 1, others).prod(-1, keepdim=True)
        alone = torch.where(zeros == 1, zero * rest, torch.zeros_like(others))
        derivative = torch.where(zeros == 0, product[..., None] / others.masked_fill(zero, 1), alone)
        return cast(Tensor, gradient[..., None] * derivative)


def _names(argument: str, what: str, names: Iterable[str]) -> tuple[str, ...]:
    """Return distinct names. Raise an exception that names the argument if they are something else."""
    if isinstance(names, str):
        raise ValueError(f"{argument}: expected a sequence of {what}, not the string {names!r}")
    if not isinstance(names, Iterable):
        raise TypeError(f"{argument}: expected a sequence of {what}, not {type(names).__name__}")
    found = tuple(names)
    for name in found:
        if not isinstance(name, str):
            raise TypeError(f"{argument}: expected str, not {type(name).__name__}")
    return tuple(dict.fromkeys(found))


def _checked_ego(argument: str, ego: int, count: int) -> int:
    """Return the number of an entity, from 0."""
    if isinstance(ego, bool):
        raise TypeError(f"{argument}: expected an integer, not bool")
    number = as_integer(argument, ego)
    if not -count <= number < count:
        known = f": expected {-count} to {count - 1}" if count else ""
        raise ValueError(f"{argument}: there are {count} entities, so {number} does not exist{known}")
    return number % count


def _checked_egos(egos: Sequence[int], count: int) -> list[int]:
    """Return the numbers of entities that decide, from 0."""
    given = egos.tolist() if isinstance(egos, (Tensor, np.ndarray)) else egos
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise TypeError(f"egos: expected a sequence of integers, not {type(given).__name__}")
    numbers = [_checked_ego("egos", ego, count) for ego in given]
    if not numbers:
        raise ValueError("egos: expected at least one entity; `None` means all")
    return numbers


def _check_types(unary: Tensor, binary: Tensor, mask: Tensor | None) -> None:
    for name, values in (("unary", unary), ("binary", binary), ("mask", mask)):
        if not isinstance(values, Tensor) and not (name == "mask" and values is None):
            raise TypeError(f"{name}: expected torch.Tensor, not {type(values).__name__}")


def _check_probabilities(unary: Tensor, binary: Tensor) -> None:
    for name, values in (("unary", unary), ("binary", binary)):
        # NaN is not in the range either.
        wrong = values.detach()[~((values >= 0) & (values <= 1))]
        if len(wrong):
            raise ValueError(f"{name}: expected probabilities from 0 to 1, not {float(wrong[0]):g}")


def _aligned(value: Tensor, axes: Sequence[int], count: int) -> Tensor:
    """Return degrees with a dimension for each of `count` variables after the first dimension.

    `axes` has the variable of each dimension of `value` after the first. A variable with two of them selects equal
    ones.
    """
    left = list(axes)
    for axis in sorted({axis for axis in left if left.count(axis) > 1}):
        while left.count(axis) > 1:
            first = left.index(axis)
            second = left.index(axis, first + 1)
            value = value.diagonal(dim1=first + 1, dim2=second + 1)
            left = [each for place, each in enumerate(left) if place not in (first, second)] + [axis]
    order = sorted(range(len(left)), key=left.__getitem__)
    if order != list(range(len(left))):
        value = value.permute(0, *(place + 1 for place in order))
    present = set(left)
    shape, sizes = [value.shape[0]], iter(value.shape[1:])
    shape += [next(sizes) if axis in present else 1 for axis in range(count)]
    return value.reshape(shape)
