"""The Neural Logic Machine of Dong et al. (2019), "Neural Logic Machines", ICLR, section 2.

A Neural Logic Machine is a network over the truth values of predicates. Its values are *groups*: the group of arity r
is a tensor of shape (batch, N, ..., N, C) with r axes for the N entities. It holds the truth values of C predicates for
every tuple of entities. Each layer computes the group of arity r from the groups of arities r - 1, r and r + 1 of the
layer before: it expands the first, reduces the last by "exists" and "for all", permutes the entities in every way, and
applies the same perceptron with a sigmoid to every tuple.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations, permutations

from ..errors import missing_extra

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise missing_extra("learn", error) from error

__all__ = ["LogicLayer", "NeuralLogicMachine"]

#: The groups by arity, from 0. `None` is a group without predicates.
Groups = list[Tensor | None]


class LogicLayer(nn.Module):
    """One layer: expansion, reduction, permutation, and a perceptron for each arity (section 2.3 of the paper).

    Args:
        inputs: The number of predicates of each input arity, from 0 to the breadth.
        outputs: The number of predicates of each output arity. Arities with 0 are not computed.
        hidden: The width of a hidden layer with ReLU in each perceptron, or `None` for a single linear layer.
        exclude_self: Whether reductions omit tuples that contain an entity twice.
    """

    def __init__(
        self, inputs: Sequence[int], outputs: Sequence[int], hidden: int | None = None, exclude_self: bool = True
    ) -> None:
        """Create the perceptrons with PyTorch's initialization of linear layers."""
        super().__init__()
        self.exclude_self = exclude_self
        self.features = [_feature_count(inputs, arity) for arity in range(len(inputs))]
        #: The number of predicates of each output arity. An arity without features has none.
        self.outputs = [count if features else 0 for count, features in zip(outputs, self.features, strict=True)]
        self.linear = nn.ModuleDict()
        self.last = nn.ModuleDict()
        for arity, (features, count) in enumerate(zip(self.features, self.outputs, strict=True)):
            if count:
                ways = len(_permutations(arity))
                self.linear[str(arity)] = nn.Linear(ways * features, hidden or count)
                if hidden:
                    self.last[str(arity)] = nn.Linear(hidden, count)

    def forward(self, groups: Groups, mask: Tensor) -> Groups:
        """Return the groups of the next layer.

        Args:
            groups: The groups of this layer, with truth values from 0 to 1.
            mask: bool (batch, N): the entities that are present. Reductions omit the others.
        """
        return [self._group(arity, groups, mask) if count else None for arity, count in enumerate(self.outputs)]

    def _group(self, arity: int, groups: Groups, mask: Tensor) -> Tensor:
        below = groups[arity - 1] if arity else None
        above = groups[arity + 1] if arity + 1 < len(groups) else None
        same = [group for group in (groups[arity],) if group is not None]
        if above is not None:
            same += self._reduced(above, arity + 1, mask)
        linear, ways = self.linear[str(arity)], len(_permutations(arity))
        expanded = 0 if below is None else below.shape[-1]
        # The perceptron's first layer is linear in each permutation of the features: W [x; p(x); ...] equals
        # W_1 x + p(W_2 x) + ..., and the features that are expanded have fewer tuples before the expansion. Computing
        # the products first therefore avoids tensors with all permutations of all features.
        weight = linear.weight.view(linear.out_features, ways, self.features[arity])
        products: Tensor | None = None
        if same:
            features = same[0] if len(same) == 1 else torch.cat(same, -1)
            products = features @ weight[..., expanded:].permute(2, 1, 0).flatten(1)
        if below is not None:
            expansion = (below @ weight[..., :expanded].permute(2, 1, 0).flatten(1)).unsqueeze(-2)
            if products is None:
                products = expansion.expand(*mask.shape, *[mask.shape[1]] * (arity - 1), -1)
            else:
                products = products + expansion
        assert products is not None  # an arity without features has no outputs
        result = linear.bias + _sum_of_permutations(products.unflatten(-1, (ways, -1)), arity)
        if self.last:
            result = self.last[str(arity)](torch.relu(result))
        return torch.sigmoid(result)

    def _reduced(self, group: Tensor, arity: int, mask: Tensor) -> list[Tensor]:
        """Return "exists" and "for all" over the last entity: the maximum and the minimum of the truth values."""
        omitted = ~mask.view(len(mask), *[1] * (arity - 1), mask.shape[1], 1)
        if self.exclude_self and arity > 1:
            omitted = omitted | _repeats(mask.shape[1], arity)
        return [group.masked_fill(omitted, 0.0).amax(-2), group.masked_fill(omitted, 1.0).amin(-2)]


class NeuralLogicMachine(nn.Module):
    """A stack of logic layers (figure 2 of the paper).

    It computes only the groups on which the groups of the arities `returned` of the last layer depend.

    Args:
        inputs: The number of input predicates of the arities 0, 1, ...
        depth: The number of layers.
        breadth: The largest arity in the layers. Larger input arities are not allowed.
        outputs: The number of predicates that each layer has per arity.
        hidden: As for `LogicLayer`.
        exclude_self: As for `LogicLayer`.
        residual: Whether the groups of a layer also contain its input groups.
        returned: The arities to compute in the last layer.

    Attributes:
        counts: The number of predicates of each arity from 0 to the breadth in the result.
    """

    def __init__(
        self,
        inputs: Sequence[int],
        *,
        depth: int = 4,
        breadth: int = 3,
        outputs: int = 8,
        hidden: int | None = None,
        exclude_self: bool = True,
        residual: bool = False,
        returned: Sequence[int] = (1,),
    ) -> None:
        """Create the layers."""
        super().__init__()
        if depth < 1 or outputs < 1 or (hidden is not None and hidden < 1):
            raise ValueError("the depth, the number of outputs and the hidden width must be at least 1")
        if len(inputs) > breadth + 1 or not all(0 <= arity <= breadth for arity in returned):
            raise ValueError(f"a machine of breadth {breadth} has only the arities 0 to {breadth}")
        arities = range(breadth + 1)
        needed = [set(returned)]
        for _ in range(depth - 1):
            needed.append({near for arity in needed[-1] for near in (arity - 1, arity, arity + 1) if near in arities})
        counts = [*inputs, *[0] * (breadth + 1 - len(inputs))]
        self.residual = residual
        self.layers = nn.ModuleList()
        for arities_needed in reversed(needed):
            widths = [outputs if arity in arities_needed else 0 for arity in arities]
            layer = LogicLayer(counts, widths, hidden, exclude_self)
            self.layers.append(layer)
            counts = [
                new + (old if residual and arity in arities_needed else 0)
                for arity, (old, new) in enumerate(zip(counts, layer.outputs, strict=True))
            ]
        self.counts = counts

    def forward(self, groups: Sequence[Tensor | None], mask: Tensor) -> Groups:
        """Return the groups of the last layer, `None` for arities without predicates.

        Args:
            groups: The input groups of the arities 0, 1, ..., with truth values from 0 to 1.
            mask: bool (batch, N): the entities that are present.
        """
        current: Groups = [*groups]
        for layer in self.layers:
            current += [None] * (len(layer.outputs) - len(current))
            new = layer(current, mask)
            current = [_joined(*pair) for pair in zip(current, new, strict=True)] if self.residual else new
        return current


def _joined(old: Tensor | None, new: Tensor | None) -> Tensor | None:
    """Return the predicates of both groups. A group that is not needed has no new predicates."""
    return new if old is None or new is None else torch.cat([old, new], -1)


def _feature_count(inputs: Sequence[int], arity: int) -> int:
    """Return the number of features of one tuple of entities, without permutations."""
    below = inputs[arity - 1] if arity else 0
    above = inputs[arity + 1] if arity + 1 < len(inputs) else 0
    return below + inputs[arity] + 2 * above


@cache
def _permutations(arity: int) -> tuple[tuple[int, ...], ...]:
    """Return the permutations of the axes of a group. The first one is the identity."""
    return tuple(permutations(range(arity)))


@cache
def _repeats(count: int, arity: int) -> Tensor:
    """Return bool (N, ..., N, 1): the tuples that contain an entity twice."""
    index = torch.cartesian_prod(*[torch.arange(count)] * arity)
    repeats = torch.zeros(len(index), dtype=torch.bool)
    for one, other in combinations(range(arity), 2):
        repeats |= index[:, one] == index[:, other]
    return repeats.view(*[count] * arity, 1)


def _sum_of_permutations(products: Tensor, arity: int) -> Tensor:
    """Return the sum over permutations p of the p-th products at the permuted tuple.

    Args:
        products: (batch, N, ..., N, permutations, width).
        arity: The number of axes for entities.
    """
    total, *others = products.unbind(-2)
    for order, product in zip(_permutations(arity)[1:], others, strict=True):
        # The value at (i_0, i_1, ...) comes from (i_p(0), i_p(1), ...), so axis p(k) of the result is axis k before.
        total = total + product.permute(0, *(1 + order.index(axis) for axis in range(arity)), arity + 1)
    return total
