"""Bilevel training: a perception whose reasoner is fitted to it. Needs the extra `vap`.

The lower level fits the weights w of a reasoner to the groundings x of training samples: w*(x) = argmin over w of the
inner loss g(w, x). The upper level trains the perception so that the fitted reasoner is right about held-out samples:
it descends the outer loss f(w*(x), y) of their groundings y. The gradient of f by x through w* is the hypergradient:

- *Unrolled*: w* is the result of a number of gradient steps, through which the gradient flows (Franceschi et al., 2017,
  "Forward and Reverse Gradient-Based Hyperparameter Optimization", ICML). It is exact for these steps. Its memory grows
  with their number.
- *Implicit*: at a minimum, dw*/dx follows from the implicit function theorem, so that df/dx is -(d2g/dw dx)' v with
  (H + damping I) v = df/dw and the Hessian H of g by w (Pedregosa, 2016, "Hyperparameter Optimization with Approximate
  Gradient", ICML). Conjugate gradients solve this with products of H and vectors. Its memory does not depend on the
  number of steps, but it is only as exact as the minimum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

from ..errors import extra

with extra("vap"):
    import torch
    from pydantic import Field
    from torch import Tensor, nn

from ..learn.settings import Count, LearningRate, NonNegative, StrictModel

__all__ = ["BilevelSettings", "Hypergradient", "Objective", "fitted", "implicit", "surrogate", "unrolled"]

#: The weights of the lower level by name.
Weights: TypeAlias = dict[str, Tensor]

#: A loss, a scalar, of the weights of the lower level. It may depend on the tensors of the upper level.
Objective: TypeAlias = Callable[[Mapping[str, Tensor]], Tensor]


class BilevelSettings(StrictModel):
    """The hyperparameters of the stage `bilevel`."""

    method: Literal["unrolled", "implicit"] = "unrolled"
    """How the gradient of the perception through the fitted reasoner is computed: through all inner steps, or with the
    implicit function theorem."""
    inner_steps: Count = 5
    """The number of gradient steps that fit the reasoner to a batch. They begin with the weights of the last batch."""
    inner_rate: LearningRate = 0.05
    """The learning rate of these steps."""
    cg_steps: Count = 10
    """The largest number of steps of conjugate gradients, for the method `implicit`."""
    damping: NonNegative = 10.0
    """What the method `implicit` adds to the eigenvalues of the Hessian, which must become positive."""
    held_out: Annotated[float, Field(gt=0, lt=1)] = 0.5
    """The share of the training samples on which the perception is trained. The reasoner is fitted to the others."""


@dataclass(frozen=True)
class Hypergradient:
    """The result of an evaluation of both levels.

    Attributes:
        value: The outer loss at the fitted weights, a scalar without gradient.
        gradients: Its total derivative by each tensor of the upper level.
        weights: The fitted weights, without gradients.
    """

    value: Tensor
    gradients: tuple[Tensor, ...]
    weights: Weights


def fitted(inner: Objective, weights: Mapping[str, Tensor], steps: int, rate: float, differentiable: bool) -> Weights:
    """Return the weights after gradient steps on the inner loss.

    If they are differentiable, they depend on the tensors of the upper level, and otherwise on nothing.
    """
    found = {name: each.detach().requires_grad_() for name, each in weights.items()}
    for _ in range(steps):
        slopes = torch.autograd.grad(
            inner(found), list(found.values()), create_graph=differentiable, materialize_grads=True
        )
        found = {name: each - rate * slope for (name, each), slope in zip(found.items(), slopes, strict=True)}
        if not differentiable:
            found = {name: each.detach().requires_grad_() for name, each in found.items()}
    return found


def unrolled(
    inner: Objective,
    outer: Objective,
    upper: Sequence[Tensor],
    weights: Mapping[str, Tensor],
    settings: BilevelSettings,
) -> Hypergradient:
    """Return the hypergradient through the steps of the lower level.

    Args:
        inner: The inner loss.
        outer: The outer loss.
        upper: The tensors of the upper level, which require gradients.
        weights: The weights with which the lower level begins. They stay as they are.
        settings: The number of inner steps and their learning rate.
    """
    found = fitted(inner, weights, settings.inner_steps, settings.inner_rate, differentiable=True)
    value = outer(found)
    gradients = torch.autograd.grad(value, list(upper), materialize_grads=True)
    return Hypergradient(value.detach(), gradients, {name: each.detach() for name, each in found.items()})


def implicit(
    inner: Objective,
    outer: Objective,
    upper: Sequence[Tensor],
    weights: Mapping[str, Tensor],
    settings: BilevelSettings,
) -> Hypergradient:
    """Return the hypergradient by the implicit function theorem, at the result of the steps of the lower level.

    The arguments are those of `unrolled`. Conjugate gradients end early if a direction has no positive curvature, which
    more damping prevents, or at a relative residual of 1e-10.
    """
    found = fitted(inner, weights, settings.inner_steps, settings.inner_rate, differentiable=False)
    own = list(found.values())
    value = outer(found)
    slopes = torch.autograd.grad(value, [*own, *upper], materialize_grads=True)
    of_weights, direct = slopes[: len(own)], slopes[len(own) :]
    # The graph of the gradient of g gives products with its Hessian and with its mixed derivatives.
    flow = torch.autograd.grad(inner(found), own, create_graph=True, materialize_grads=True)

    def products(by: Sequence[Tensor], vector: Sequence[Tensor]) -> Sequence[Tensor]:
        """Return the derivative of the product of the gradient with a vector."""
        # A weight on which g does not depend has a gradient without a graph.
        total = torch.stack([(each * one).sum() for each, one in zip(flow, vector, strict=True)]).sum()
        if not total.requires_grad:
            return [torch.zeros_like(each) for each in by]
        return list(torch.autograd.grad(total, list(by), retain_graph=True, materialize_grads=True))

    def damped(vector: Sequence[Tensor]) -> list[Tensor]:
        return [each + settings.damping * one for each, one in zip(products(own, vector), vector, strict=True)]

    solved = _conjugate_gradients(damped, of_weights, settings.cg_steps)
    gradients = tuple(one - each for one, each in zip(direct, products(upper, solved), strict=True))
    return Hypergradient(value.detach(), gradients, {name: each.detach() for name, each in found.items()})


def _conjugate_gradients(
    product: Callable[[Sequence[Tensor]], list[Tensor]], right: Sequence[Tensor], steps: int
) -> list[Tensor]:
    """Solve A x = b for a symmetric positive matrix A, given by its product with vectors (Hestenes and Stiefel, 1952).

    Vectors are lists of tensors.
    """

    def dot(first: Sequence[Tensor], second: Sequence[Tensor]) -> Tensor:
        return torch.stack([(one * other).sum() for one, other in zip(first, second, strict=True)]).sum()

    found = [torch.zeros_like(each) for each in right]
    residual = direction = [each.clone() for each in right]
    first = size = dot(residual, residual)
    for _ in range(steps):
        if size <= 1e-20 * first:
            break
        along = product(direction)
        curvature = dot(direction, along)
        if curvature <= 0:
            break
        far = size / curvature
        found = [one + far * other for one, other in zip(found, direction, strict=True)]
        residual = [one - far * other for one, other in zip(residual, along, strict=True)]
        before, size = size, dot(residual, residual)
        direction = [one + size / before * other for one, other in zip(residual, direction, strict=True)]
    return found


def surrogate(
    inner: Callable[[Mapping[str, Tensor], Sequence[Tensor]], Tensor],
    outer: Callable[[Mapping[str, Tensor], Sequence[Tensor]], Tensor],
    inputs: tuple[Sequence[Tensor], Sequence[Tensor]],
    module: nn.Module,
    settings: BilevelSettings,
) -> Tensor:
    """Fit a module, and return a scalar with the value of the outer loss and the hypergradient as its gradient.

    Only the graph of the inputs is used, so that a perception needs no second derivatives.

    Args:
        inner: The inner loss of the weights and of the inputs of the lower level.
        outer: The outer loss of the weights and of the inputs of the upper level.
        inputs: Those of the lower and of the upper level.
        module: The module of the lower level, whose weights become the fitted ones.
        settings: The hyperparameters.
    """
    cut = [[each.detach().requires_grad_() for each in part] for part in inputs]
    weights = dict(module.named_parameters())
    method = unrolled if settings.method == "unrolled" else implicit
    found = method(
        lambda weights: inner(weights, cut[0]), lambda weights: outer(weights, cut[1]), sum(cut, []), weights, settings
    )
    with torch.no_grad():
        for name, each in weights.items():
            each.copy_(found.weights[name])
    result = found.value
    for one, gradient in zip([*inputs[0], *inputs[1]], found.gradients, strict=True):
        result = result + ((one - one.detach()) * gradient).sum()
    return result
