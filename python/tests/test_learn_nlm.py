from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import pytest
from conftest import needs

torch = needs("torch", "learn")
from logicity.learn.nlm import LogicLayer, NeuralLogicMachine  # noqa: E402

#: The truth values of the predicates of one scene by tuple of entities: `values[(2, 0)]` is a list.
Values = dict[tuple[int, ...], list[float]]


def slow_layer(layer: LogicLayer, groups: list[Values], present: list[bool]) -> list[Values]:
    """Compute a layer for one scene, one tuple of entities after the other, as section 2.3 of the paper defines it."""
    entities = range(len(present))
    result: list[Values] = []
    for arity, count in enumerate(layer.outputs):
        result.append({})
        if not count:
            continue
        for entity_tuple in itertools.product(entities, repeat=arity):
            if layer.exclude_self and len(set(entity_tuple)) < arity:
                continue
            features: list[float] = []
            for order in itertools.permutations(range(arity)):
                permuted = tuple(entity_tuple[at] for at in order)
                if arity:
                    features += groups[arity - 1].get(permuted[:-1], [])
                features += groups[arity].get(permuted, [])
                if arity + 1 < len(groups):
                    others = [permuted + (last,) for last in entities if present[last]]
                    if layer.exclude_self:
                        others = [one for one in others if len(set(one)) == len(one)]
                    predicates = range(layer.inputs[arity + 1])
                    features += [max([0.0, *(groups[arity + 1][one][at] for one in others)]) for at in predicates]
                    features += [min([1.0, *(groups[arity + 1][one][at] for one in others)]) for at in predicates]
            values = perceptron(layer.linear[str(arity)], features)
            if layer.last:
                values = perceptron(layer.last[str(arity)], [max(value, 0.0) for value in values])
            result[arity][entity_tuple] = [1 / (1 + pow(2.718281828459045, -value)) for value in values]
    return result


def count_of(group: Values) -> int:
    return len(next(iter(group.values()), []))


def perceptron(linear: Any, features: Sequence[float]) -> list[float]:
    weight, bias = linear.weight.tolist(), linear.bias.tolist()
    return [sum(w * x for w, x in zip(row, features, strict=True)) + b for row, b in zip(weight, bias, strict=True)]


def slow_machine(machine: NeuralLogicMachine, groups: list[Values], present: list[bool]) -> list[Values]:
    groups = groups + [{}] * (len(machine.counts) - len(groups))
    for layer in machine.layers:
        new = slow_layer(layer, groups, present)
        if machine.residual:
            new = [
                {one: [*before.get(one, []), *values] for one, values in after.items()} if before else after
                for before, after in zip(groups, new, strict=True)
            ]
        groups = new
    return groups


def scenes(inputs: Sequence[int], entities: int, batch: int, seed: int) -> tuple[list[Any], Any]:
    """Return random input groups and masks in float64. The first scene has no entity but one, the last one has all."""
    generator = torch.Generator().manual_seed(seed)
    groups = [
        torch.rand(batch, *[entities] * arity, count, generator=generator, dtype=torch.float64) if count else None
        for arity, count in enumerate(inputs)
    ]
    mask = torch.rand(batch, entities, generator=generator) < 0.6
    mask[0], mask[-1] = False, True
    mask[:, 0] = True
    return groups, mask


def as_values(group: Any, scene: int) -> Values:
    if group is None:
        return {}
    tuples = itertools.product(range(group.shape[1]) if group.dim() > 2 else (), repeat=group.dim() - 2)
    return {one: group[(scene, *one)].tolist() for one in tuples}


@pytest.mark.parametrize(
    ("inputs", "options"),
    [
        ([0, 3, 2], {}),
        ([0, 3, 2], {"exclude_self": False}),
        ([0, 3, 2], {"residual": True}),
        ([0, 2, 1], {"hidden": 5, "residual": True, "exclude_self": False}),
        ([2, 2, 1, 1], {"returned": (0, 1, 2, 3)}),
        ([2, 0, 1], {"breadth": 2, "depth": 1, "returned": (0, 1, 2)}),
        ([0, 2], {"breadth": 1, "depth": 2, "hidden": 4}),
        ([0, 2, 1], {"breadth": 4, "depth": 2, "entities": 3, "returned": (1, 3)}),
        ([0, 2, 1], {"breadth": 3, "depth": 3, "entities": 1, "returned": (0, 1, 2)}),
        ([0, 2, 1], {"breadth": 3, "depth": 3, "entities": 2, "exclude_self": False}),
    ],
)
def test_the_machine_equals_explicit_loops_over_tuples(inputs: list[int], options: dict[str, Any]) -> None:
    torch.manual_seed(sum(inputs) + len(options))
    entities = options.pop("entities", 4)
    machine = NeuralLogicMachine(inputs, **{"depth": 3, "breadth": 3, "outputs": 3, **options}).double()
    for parameter in machine.parameters():
        torch.nn.init.normal_(parameter)
    groups, mask = scenes(inputs, entities, 3, seed=4)
    fast = machine(groups, mask)
    for scene in range(3):
        slow = slow_machine(machine, [as_values(group, scene) for group in groups], mask[scene].tolist())
        for arity, values in enumerate(slow):
            assert not values or machine.counts[arity] == count_of(values)
            for one, expected in as_values(fast[arity], scene).items():
                assert expected == pytest.approx(values.get(one, [0.0] * len(expected)), abs=1e-12)


def test_only_the_needed_groups_are_computed() -> None:
    machine = NeuralLogicMachine([0, 3, 2], depth=4, breadth=3, outputs=8)
    arities = [[arity for arity, count in enumerate(layer.outputs) if count] for layer in machine.layers]
    # The first layer has no arity 0 features but those reduced from arity 1.
    assert arities == [[0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2], [1]]
    whole = NeuralLogicMachine([0, 3, 2], depth=4, breadth=3, outputs=8, returned=(0, 1, 2, 3))
    # Each needed weight has the same meaning in the larger machine.
    whole.load_state_dict(machine.state_dict(), strict=False)
    groups, mask = scenes([0, 3, 2], 5, 6, seed=1)
    one, other = machine.double()(groups, mask)[1], whole.double()(groups, mask)[1]
    assert torch.equal(one, other)


@pytest.mark.parametrize("residual", [False, True])
def test_a_machine_knows_no_order_of_entities(residual: bool) -> None:
    torch.manual_seed(2)
    machine = NeuralLogicMachine([0, 3, 2], depth=4, residual=residual).double()
    groups, mask = scenes([0, 3, 2], 5, 8, seed=3)
    order = torch.tensor([3, 0, 4, 1, 2])
    permuted = [None, groups[1][:, order], groups[2][:, order][:, :, order]]
    one, other = machine(groups, mask)[1], machine(permuted, mask[:, order])[1]
    assert torch.allclose(one[:, order], other, atol=1e-12)


def test_absent_entities_change_nothing() -> None:
    torch.manual_seed(5)
    machine = NeuralLogicMachine([0, 3, 2], depth=4).double()
    groups, mask = scenes([0, 3, 2], 5, 16, seed=6)
    mask[:, 3:] = False
    result = machine(groups, mask)[1][:, :3]
    fewer = machine([None, groups[1][:, :3], groups[2][:, :3, :3]], mask[:, :3])[1]
    assert torch.allclose(result, fewer, atol=1e-12)
    groups[1][:, 3:], groups[2][:, 3:], groups[2][:, :, 3:] = 0.5, 0.5, 0.5
    assert torch.equal(machine(groups, mask)[1][:, :3], result)


def test_reductions_of_no_tuple_are_false_and_true() -> None:
    layer = LogicLayer([0, 1, 1], [0, 2, 0])
    torch.nn.init.zeros_(layer.linear["1"].weight)
    torch.nn.init.zeros_(layer.linear["1"].bias)
    with torch.no_grad():
        # Features of arity 1: those of arity 0 (none), its own, exists, for all.
        layer.linear["1"].weight.copy_(torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
        mask = torch.tensor([[1.0], [0.0], [0.0]])
        result = layer([None, torch.rand(1, 3, 1), torch.rand(1, 6, 1)], mask)[1]
    assert torch.allclose(result[:, 0, 0], torch.sigmoid(torch.tensor([0.0, 1.0])))


@pytest.mark.parametrize("exclude_self", [False, True])
def test_gradients_equal_finite_differences(exclude_self: bool) -> None:
    torch.manual_seed(7)
    machine = NeuralLogicMachine([0, 2, 1], depth=3, outputs=2, exclude_self=exclude_self).double()
    (_, unary, binary), mask = scenes([0, 2, 1], 3, 2, seed=8)
    unary.requires_grad_()
    binary.requires_grad_()
    assert torch.autograd.gradcheck(lambda one, two: machine([None, one, two], mask)[1], (unary, binary))


def test_a_machine_that_was_used_for_inference_can_be_trained() -> None:
    machine = NeuralLogicMachine([0, 1, 1], outputs=7)
    groups, mask = [None, torch.rand(2, 6, 1), torch.rand(2, 6, 6, 1)], torch.ones(2, 6, dtype=torch.bool)
    with torch.inference_mode():
        machine(groups, mask)
    machine(groups, mask)[1].sum().backward()


def test_invalid_sizes_are_rejected() -> None:
    with pytest.raises(ValueError, match="breadth 1"):
        NeuralLogicMachine([0, 1, 1], breadth=1)
    with pytest.raises(ValueError, match="breadth 2"):
        NeuralLogicMachine([0, 1, 1], breadth=2, returned=(3,))
    with pytest.raises(ValueError, match="at least 1"):
        NeuralLogicMachine([0, 1, 1], depth=0)
