"""Bilevel training: hypergradients against finite differences, and the stage of experiments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest
from conftest import needs

needs("pydantic", "vap")
torch = needs("torch", "vap")

from torch import Tensor, nn  # noqa: E402
from torch.func import functional_call  # noqa: E402

from logicity.vap.bilevel import BilevelSettings, fitted, implicit, surrogate, unrolled  # noqa: E402
from logicity.vap.reasoners import GraphReasoner  # noqa: E402
from logicity.vap.training import Samples  # noqa: E402

Method = Callable[..., Any]
Inputs = Sequence[Tensor]


@pytest.fixture(autouse=True)
def exact() -> Any:
    """Compute in double precision, on one thread."""
    kind, threads = torch.get_default_dtype(), torch.get_num_threads()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    yield
    torch.set_default_dtype(kind)
    torch.set_num_threads(threads)


class Problem:
    """Ridge regression with nonlinear features: the features are the upper level, the regression the lower one."""

    def __init__(self, seed: int, ridge: float = 0.5) -> None:
        generator = torch.Generator().manual_seed(seed)
        self.upper = [torch.randn(6, 3, generator=generator), torch.randn(5, 3, generator=generator)]
        self.targets = [torch.randn(6, generator=generator), torch.randn(5, generator=generator)]
        self.weights = {
            "w": torch.randn(3, generator=generator),
            "b": torch.randn((), generator=generator),
            "unused": torch.randn(2, generator=generator),
        }
        self.ridge = ridge

    def error(self, weights: Mapping[str, Tensor], inputs: Tensor, targets: Tensor) -> Tensor:
        return ((torch.tanh(inputs) @ weights["w"] + weights["b"] - targets) ** 2).mean()

    def inner(self, weights: Mapping[str, Tensor], upper: Inputs) -> Tensor:
        decay = (weights["w"] ** 2).sum() + weights["b"] ** 2
        return self.error(weights, upper[0], self.targets[0]) + self.ridge * decay / 2

    def outer(self, weights: Mapping[str, Tensor], upper: Inputs) -> Tensor:
        return self.error(weights, upper[1], self.targets[1]) + 0.01 * (upper[0] ** 2).sum()

    def gradient(self, method: Method, settings: BilevelSettings) -> tuple[Tensor, ...]:
        upper = [each.clone().requires_grad_() for each in self.upper]
        before = {name: each.clone() for name, each in self.weights.items()}
        found = method(
            lambda weights: self.inner(weights, upper),
            lambda weights: self.outer(weights, upper),
            upper,
            self.weights,
            settings,
        )
        assert not found.value.requires_grad and not any(each.requires_grad for each in found.weights.values())
        assert all(torch.equal(each, before[name]) for name, each in self.weights.items())
        assert torch.equal(found.weights["unused"], before["unused"])
        gradients: tuple[Tensor, ...] = found.gradients
        return gradients

    def value(self, upper: Inputs, settings: BilevelSettings) -> float:
        """Return the outer loss after the steps of the lower level, which hypergradients differentiate."""
        found = fitted(
            lambda weights: self.inner(weights, upper),
            self.weights,
            settings.inner_steps,
            settings.inner_rate,
            differentiable=False,
        )
        return float(self.outer(found, upper).detach())


def differences(value: Callable[[Inputs], float], at: Inputs, step: float = 1e-5) -> list[Tensor]:
    """Return central finite differences of a function of tensors."""
    result = []
    for number, each in enumerate(at):
        slopes = torch.zeros_like(each)
        for place in range(each.numel()):
            ends = []
            for sign in (1, -1):
                moved = [one.clone() for one in at]
                moved[number].view(-1)[place] += sign * step
                ends.append(value(moved))
            slopes.view(-1)[place] = (ends[0] - ends[1]) / (2 * step)
        result.append(slopes)
    return result


def settings(**changes: Any) -> BilevelSettings:
    return BilevelSettings(**{"inner_rate": 0.1, "damping": 0.0, "cg_steps": 50, **changes})


@pytest.mark.parametrize("steps", [1, 2, 7])
@pytest.mark.parametrize("seed", range(3))
def test_unrolled_hypergradients_are_exact_for_any_number_of_steps(seed: int, steps: int) -> None:
    problem, given = Problem(seed), settings(inner_steps=steps)
    expected = differences(lambda upper: problem.value(upper, given), problem.upper)
    for found, wanted in zip(problem.gradient(unrolled, given), expected, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("method", [unrolled, implicit])
@pytest.mark.parametrize("seed", range(3))
def test_both_hypergradients_agree_with_finite_differences_at_the_minimum(seed: int, method: Method) -> None:
    problem, given = Problem(seed), settings(inner_steps=200, inner_rate=0.2)
    expected = differences(lambda upper: problem.value(upper, given), problem.upper)
    for found, wanted in zip(problem.gradient(method, given), expected, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-7)
    # Not all of it is the direct part, which ignores that the weights are fitted.
    direct = [each.clone().requires_grad_() for each in problem.upper]
    weights = fitted(lambda weights: problem.inner(weights, direct), problem.weights, 200, 0.2, differentiable=False)
    problem.outer(weights, direct).backward()
    assert (direct[0].grad - expected[0]).abs().max() > 1e-3


def test_implicit_hypergradients_of_a_quadratic_are_the_formula() -> None:
    """With damping and few steps of conjugate gradients, too: for H = A + damping I, dw/dx solves H dw/dx = B."""
    generator = torch.Generator().manual_seed(5)
    root = torch.randn(4, 4, generator=generator)
    matrix, mixed = root @ root.T + torch.eye(4), torch.randn(4, 2, generator=generator)
    target = torch.randn(4, generator=generator)
    upper = [torch.randn(2, generator=generator).requires_grad_()]
    start = {"w": torch.zeros(4)}

    def inner(weights: Mapping[str, Tensor]) -> Tensor:
        return weights["w"] @ matrix @ weights["w"] / 2 - weights["w"] @ mixed @ upper[0]

    def outer(weights: Mapping[str, Tensor]) -> Tensor:
        return ((weights["w"] - target) ** 2).sum() / 2

    for damping in (0.0, 0.7):
        given = settings(inner_steps=3, inner_rate=0.01, damping=damping)
        found = implicit(inner, outer, upper, start, given)
        solved = torch.linalg.solve(matrix + damping * torch.eye(4), found.weights["w"] - target)
        torch.testing.assert_close(found.gradients[0], mixed.T @ solved)
        # After one step, conjugate gradients are the best multiple of the right side.
        right = found.weights["w"] - target
        far = right @ right / (right @ (matrix + damping * torch.eye(4)) @ right)
        short = implicit(inner, outer, upper, start, settings(**{**given.model_dump(), "cg_steps": 1}))
        torch.testing.assert_close(short.gradients[0], mixed.T @ (far * right))


def test_directions_without_positive_curvature_end_the_search() -> None:
    upper = [torch.ones(2, requires_grad=True)]

    def inner(weights: Mapping[str, Tensor]) -> Tensor:
        return -(weights["w"] ** 2).sum() + (weights["w"] * upper[0]).sum()

    def outer(weights: Mapping[str, Tensor]) -> Tensor:
        return (weights["w"] * torch.tensor([1.0, 2.0])).sum() + (upper[0] ** 2).sum()

    start = {"w": torch.zeros(2)}
    found = implicit(inner, outer, upper, start, settings(inner_steps=1, damping=0.0))
    assert found.gradients[0].tolist() == [2.0, 2.0]
    damped = implicit(inner, outer, upper, start, settings(inner_steps=1, damping=3.0))
    assert damped.gradients[0].tolist() == [1.0, 0.0]


def scenes(count: int, seed: int) -> tuple[list[Tensor], Tensor, Tensor]:
    """Return random groundings of three entities, which of them are present, and an action of each."""
    generator = torch.Generator().manual_seed(seed)
    groundings = [torch.rand(count, 3, 11, generator=generator), torch.rand(count, 3, 3, 7, generator=generator)]
    valid = torch.tensor([True, True, False]).expand(count, 3)
    return groundings, valid, torch.randint(4, (count, 3), generator=generator)


@pytest.mark.parametrize("method", ["unrolled", "implicit"])
def test_hypergradients_of_a_reasoner_agree_with_finite_differences(method: Any) -> None:
    """For a graph network with a smooth update, so that its loss has second derivatives."""
    torch.manual_seed(3)
    reasoner = GraphReasoner(width=4)
    for update in reasoner.updates:
        assert isinstance(update, nn.Sequential)
        update[1] = update[3] = nn.Softplus()
    levels = [scenes(4, 1), scenes(3, 2)]

    def objective(level: int) -> Callable[[Mapping[str, Tensor], Inputs], Tensor]:
        _, valid, actions = levels[level]

        def loss(weights: Mapping[str, Tensor], inputs: Inputs) -> Tensor:
            logits = functional_call(reasoner, dict(weights), (*inputs, valid))
            decay = sum((each**2).sum() for each in weights.values()) * (1 - level)
            return nn.functional.cross_entropy(logits[valid], actions[valid]) + 0.5 * decay

        return loss

    start = {name: each.detach().clone() for name, each in reasoner.named_parameters()}
    # Strong decay makes the inner loss convex, and the steps end at its minimum.
    given = settings(method=method, inner_steps=120, inner_rate=0.1, cg_steps=200)

    def value(inputs: Inputs) -> float:
        found = fitted(
            lambda weights: objective(0)(weights, inputs[:2]),
            start,
            given.inner_steps,
            given.inner_rate,
            differentiable=False,
        )
        return float(objective(1)(found, inputs[2:]).detach())

    # The network that predicts the groundings is a factor of each, so that all inputs depend on four numbers.
    factors = [torch.tensor(each, requires_grad=True) for each in (0.9, 1.1, 0.8, 1.2)]
    inputs = [factor * each for factor, each in zip(factors, [*levels[0][0], *levels[1][0]], strict=True)]
    result = surrogate(objective(0), objective(1), (inputs[:2], inputs[2:]), reasoner, given)
    result.backward()
    assert float(result.detach()) == pytest.approx(value([each.detach() for each in inputs]))
    whole = [*levels[0][0], *levels[1][0]]
    expected = differences(
        lambda of: value([factor * each for factor, each in zip(of, whole, strict=True)]),
        [factor.detach() for factor in factors],
    )
    for factor, wanted in zip(factors, expected, strict=True):
        torch.testing.assert_close(factor.grad, wanted, rtol=1e-4, atol=1e-8)
    # The reasoner has the fitted weights, and no gradients of its own.
    changed = dict(reasoner.named_parameters())
    assert any(not torch.equal(changed[name], each) for name, each in start.items())
    assert all(each.grad is None for each in changed.values())
    refitted = float(objective(1)(changed, [each.detach() for each in inputs[2:]]).detach())
    assert refitted == pytest.approx(float(result.detach()))


@pytest.mark.parametrize(("count", "share", "second"), [(2, 0.01, 1), (2, 0.99, 1), (5, 0.5, 2), (10, 0.3, 3)])
def test_samples_are_split_into_two_parts(count: int, share: float, second: int) -> None:
    valid = torch.tensor([[True, at % 2 == 0] for at in range(count)])
    numbers = torch.arange(int(valid.sum()))[:, None]
    samples = Samples({"valid": valid, "world": torch.arange(count)}, {"features": numbers})
    parts = samples.split(share, seed=1)
    assert [len(part) for part in parts] == [count - second, second]
    assert sorted(torch.cat([part.facts["world"] for part in parts]).tolist()) == list(range(count))
    for part in parts:
        # The features of the entities stay with their samples.
        owners = torch.arange(count)[:, None].expand(count, 2)[valid]
        of_parts = part.facts["world"][:, None].expand(-1, 2)[part.facts["valid"]]
        assert torch.equal(owners[part.inputs["features"][:, 0]], of_parts)
    assert torch.equal(samples.split(share, seed=1)[0].facts["world"], parts[0].facts["world"])
    with pytest.raises(ValueError, match="one sample cannot be split"):
        samples.part(torch.tensor([0])).split(0.5, seed=0)
