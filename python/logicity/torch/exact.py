"""Exact probabilities of decisions, and those of the most probable proofs, by the decision diagrams of the engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from .. import _logicity
from ..errors import extra
from ..rules import Program
from .clauses import Clauses
from .derivatives import once

with extra("learn"):
    import torch
    from torch import Tensor
    from torch.autograd.function import FunctionCtx

__all__ = ["Circuits", "Proof"]


#: The largest number of rows of a query.
ROWS_MAX = 1 << 20


@dataclass(frozen=True)
class Proof:
    """Facts from which a decision follows, if no atom that it depends on has more than `k` proofs.

    Attributes:
        probability: The probability that all of them are as they say.
        literals: The facts, such as `CollidingClose(e0, e3)` or `not IsBus(e0)`, in which `e0` is the first entity;
            `in tick 2` follows if the rules read earlier ticks. A draw is `draw`, and the weight of a clause
            `weight of S1`; each may occur several times.
    """

    probability: float
    literals: tuple[str, ...]


class Circuits:
    """The decisions and queries of a program as functions of the probabilities of facts."""

    def __init__(
        self, program: Program, clauses: Clauses, queries: Sequence[str], limits: tuple[int | None, int], weighted: bool
    ) -> None:
        """Prepare the clauses. `limits` are the number of proofs, if any, and that of the decisions of a diagram."""
        self._clauses, self._queries = clauses, tuple(queries)
        with_clauses = {place for stratum in clauses.strata for place in stratum.clauses}
        self.order = [name for name in clauses.derived if clauses.places[name] in with_clauses]
        sources = [each.source for each in clauses.written]
        places = clauses.places
        self._core = _logicity.Circuits(
            program._program,
            [[places[name] for name in clauses.unary], [places[name] for name in clauses.binary]],
            [places[name] for name in self.order],
            [places[name] for name in queries],
            sources if weighted else [],
            limits,
        )
        self._temporal = bool(clauses.pasts)
        self._given = (program, clauses, self._queries, limits, weighted)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies have circuits of their own."""
        return Circuits, self._given

    def degrees(
        self,
        inputs: tuple[Tensor, Tensor, Tensor | None],
        egos: Sequence[int],
        weights: Tensor | None,
        actions: Sequence[str],
        default: str,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the probabilities of the answers, and those of derived actions and queries by name."""
        unary, binary, mask = inputs
        count = unary.shape[-2]
        for name in self._queries:
            rows = count ** self._clauses.arities[self._clauses.places[name]]
            if rows > ROWS_MAX:
                raise ValueError(f"queries: `{name}` has {rows} rows over {count} entities, more than {ROWS_MAX}")
        weight = unary.new_zeros(0) if weights is None else weights.to(unary.device)
        outputs: Tensor = _Outputs.apply(unary, binary, weight, self._core, mask, list(egos), self._temporal)
        # For each ego, the decisions by each action and by none, and each action.
        width = 2 * len(self.order) + 1
        each = outputs[..., : len(egos) * width].unflatten(-1, (len(egos), width))
        found = dict(zip(self.order, each.unbind(-1)[: len(self.order)], strict=True))
        none = each[..., len(self.order)]
        found[default] = found[default] + none if default in found else none
        answers = torch.stack([found.get(name, torch.zeros_like(none)) for name in actions], -1)
        derived = {name: each[..., len(self.order) + 1 + place] for place, name in enumerate(self.order)}
        start = len(egos) * width
        for name in self._queries:
            shape = (count,) * self._clauses.arities[self._clauses.places[name]]
            rows = outputs[..., start : start + count ** len(shape)]
            derived[name] = rows.unflatten(-1, shape) if shape else rows[..., 0]
            start += count ** len(shape)
        return answers, derived

    def proofs(
        self, inputs: tuple[Tensor, Tensor, Tensor | None], ego: int, action: str, default: str, weights: Tensor | None
    ) -> list[Proof]:
        """Return the most probable proofs that an ego of one scene decides for an action."""
        first, second, mask = inputs
        unary, binary = (_array(each[None] if self._temporal else each[None, None]) for each in (first, second))
        if mask is not None:
            mask = mask[None] if self._temporal else mask[None, None]
        chosen = None if mask is None else _mask(mask)
        weight = np.zeros(0) if weights is None else _array(weights)
        places = [place for place, name in enumerate(self.order) if name == action]
        places += [len(self.order)] if action == default else []
        found: list[Proof] = []
        for place in places:
            for probability, literals in self._core.proofs(unary, binary, chosen, (ego, place), weight):
                found.append(Proof(probability, tuple(self._literal(*literal) for literal in literals)))
        return sorted(found, key=lambda proof: -proof.probability)[: self._given[3][0]]

    def _literal(self, holds: bool, kind: str, positions: list[int]) -> str:
        if kind == "draw":
            text = "draw"
        elif kind == "weight":
            text = f"weight of {self._clauses.labels[positions[0]]}"
        else:
            tick, *entities, column = positions
            names = self._clauses.unary if kind == "unary" else self._clauses.binary
            text = f"{names[column]}({', '.join(f'e{entity}' for entity in entities)})"
            text += f" in tick {tick}" if self._temporal else ""
        return text if holds else f"not {text}"


class _Outputs(torch.autograd.Function):
    """The outputs of circuits: (B, outputs), or (B, T, outputs)."""

    @staticmethod
    def forward(
        ctx: Any,
        unary: Tensor,
        binary: Tensor,
        weights: Tensor,
        core: _logicity.Circuits,
        mask: Tensor | None,
        egos: list[int],
        temporal: bool,
    ) -> Tensor:
        ticks = (unary, binary) if temporal else (unary[:, None], binary[:, None])
        given = None if mask is None else _mask(mask if temporal else mask[:, None])
        outputs, ctx.circuits = core.forward(_array(ticks[0]), _array(ticks[1]), given, egos, _array(weights))
        ctx.temporal, ctx.like = temporal, (unary.new_empty(0), binary.new_empty(0), weights.new_empty(0))
        found = torch.from_numpy(outputs).to(unary)
        return found if temporal else found[:, 0]

    @staticmethod
    @once
    def backward(ctx: FunctionCtx, gradient: Tensor) -> tuple[Tensor | None, ...]:
        context = cast(Any, ctx)
        given = gradient if context.temporal else gradient[:, None]
        unary, binary, weights = context.circuits.backward(_array(given))
        found = [torch.from_numpy(unary), torch.from_numpy(binary)]
        found = found if context.temporal else [each[:, 0] for each in found]
        of = [each.to(like) for each, like in zip([*found, torch.from_numpy(weights)], context.like, strict=True)]
        return (*of, None, None, None, None)


def _array(tensor: Tensor) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the values with double precision."""
    return cast("np.ndarray[Any, np.dtype[np.float64]]", tensor.detach().to("cpu", torch.float64).contiguous().numpy())


def _mask(tensor: Tensor) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return the values as booleans."""
    return cast("np.ndarray[Any, np.dtype[np.bool_]]", tensor.detach().to("cpu", torch.bool).contiguous().numpy())
