"""The Neural Logic Machine of Dong et al. (2019), "Neural Logic Machines", ICLR, section 2.

A Neural Logic Machine (NLM) is a network over the truth values of predicates. Its values are *groups*: the group of
arity r holds the truth values of C predicates for every tuple of r entities. Each layer computes the group of arity r
from the groups of arities r - 1, r and r + 1 of the layer before. It expands the first, and reduces the last by
"exists" and "for all". Then it permutes the entities in every way, and applies the same perceptron with a sigmoid to
every tuple.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import permutations, product
from math import factorial
from typing import NamedTuple

from ..errors import extra

with extra("learn"):
    import torch
    from torch import Tensor, nn

__all__ = ["LogicLayer", "NeuralLogicMachine"]

#: The groups by arity, from 0. `None` is a group without predicates. In a layer, a group has the shape (predicates,
#: tuples, batch), with the tuples of `_tuples` in their order: products of matrices then have a long side, and
#: expansions, reductions and permutations combine contiguous rows.
Groups = list[Tensor | None]


class LogicLayer(nn.Module):
    """One layer: expansion, reduction, permutation, and a perceptron for each arity (section 2.3 of the paper).

    Args:
        inputs: The number of predicates of each input arity, from 0 to the breadth.
        outputs: The number of predicates of each output arity. Arities with 0 are not computed.
        hidden: The width of a hidden layer with ReLU in each perceptron, or `None` for a single linear layer.
        exclude_self: Whether only tuples of different entities exist.
        center: The truth value of features that initially results in the truth value 0.5.

    Attributes:
        inputs: The argument.
        outputs: The argument, but 0 for an arity without features.
    """

    def __init__(
        self,
        inputs: Sequence[int],
        outputs: Sequence[int],
        hidden: int | None = None,
        exclude_self: bool = True,
        center: float = 0.5,
    ) -> None:
        """Create the perceptrons with random weights."""
        super().__init__()
        self.inputs, self.exclude_self = tuple(inputs), exclude_self
        # A tuple has expanded features, its own, and two reductions of each one with a further entity.
        counts = zip([0, *inputs], inputs, [*inputs[1:], 0], strict=False)
        self.features = [below + same + 2 * above for below, same, above in counts]
        self.outputs = [count if features else 0 for count, features in zip(outputs, self.features, strict=True)]
        self.linear = nn.ModuleDict()
        self.last = nn.ModuleDict()
        for arity, (features, count) in enumerate(zip(self.features, self.outputs, strict=True)):
            if count:
                ways = factorial(arity)
                self.linear[str(arity)] = _linear(ways * features, hidden or count, center, bool(hidden))
                if hidden:
                    self.last[str(arity)] = _linear(hidden, count, 0.0, False)

    def forward(self, groups: Groups, mask: Tensor) -> Groups:
        """Return the groups of the next layer.

        Args:
            groups: The groups of this layer, with truth values from 0 to 1.
            mask: (N, batch), of the type of the groups: 1 for the entities that are present, else 0. Reductions omit
                the others.
        """
        return [self._group(arity, groups, mask) if count else None for arity, count in enumerate(self.outputs)]

    def _group(self, arity: int, groups: Groups, mask: Tensor) -> Tensor:
        linear, ways = self.linear[str(arity)], factorial(arity)
        below = groups[arity - 1] if arity else None
        above = groups[arity + 1] if arity + 1 < len(groups) else None
        same = [] if groups[arity] is None else [groups[arity]]
        tuples = _tuples(len(mask), arity, linear.out_features, self.exclude_self)
        if above is not None:
            same += self._reduced(above, arity + 1, mask)
        expanded = 0 if below is None else len(below)
        # The features of a tuple are those of its permutations one after the other. The perceptron's first layer is
        # linear in them: it is the sum over permutations p of W_p x(p(tuple)). Computing W_p x for all p before the
        # permutation needs less memory, and features that are expanded have fewer tuples.
        weight = linear.weight.view(linear.out_features, ways, self.features[arity]).transpose(0, 1).flatten(0, 1)
        products: Tensor | None = None
        if same:
            products = _products(weight[:, expanded:], same[0] if len(same) == 1 else torch.cat(same))
        if below is not None:
            expansion = _products(weight[:, :expanded], below).unsqueeze(2)
            # Tuples that differ only in the last entity follow each other.
            shape = (*expansion.shape[:2], tuples.extensions, expansion.shape[3])
            expansion = expansion.expand(shape) if products is None else products.view(shape) + expansion
            products = expansion.flatten(1, 2)
        assert products is not None  # an arity without features has no outputs
        if ways > 1:
            sums = nn.functional.embedding_bag(tuples.permuted, products.flatten(0, 1), mode="sum")
            products = sums.view(linear.out_features, *products.shape[1:])
        result: Tensor = products + linear.bias[:, None, None]
        if self.last:
            last = self.last[str(arity)]
            result = _products(last.weight, torch.relu(result)) + last.bias[:, None, None]
        return torch.sigmoid(result)

    def _reduced(self, group: Tensor, arity: int, mask: Tensor) -> list[Tensor]:
        """Return "exists" and "for all" over the last entity: the maximum and the minimum of the truth values."""
        tuples = _tuples(len(mask), arity, 1, self.exclude_self)
        count = len(_tuples(len(mask), arity - 1, 1, self.exclude_self).last)
        shape = (len(group), count, tuples.extensions, group.shape[2])
        if not tuples.extensions:
            none = group.new_zeros(len(group), count, group.shape[2])
            return [none, none + 1.0]
        present = mask.index_select(0, tuples.last)
        false_if_absent = group * present
        true_if_absent = false_if_absent + (1.0 - present)
        return [false_if_absent.view(shape).max(2).values, true_if_absent.view(shape).min(2).values]


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
            raise ValueError(f"an NLM of breadth {breadth} has only the arities 0 to {breadth}")
        arities = range(breadth + 1)
        needed = [set(returned)]
        for _ in range(depth - 1):
            needed.append({near for arity in needed[-1] for near in (arity - 1, arity, arity + 1) if near in arities})
        counts = [*inputs, *[0] * (breadth + 1 - len(inputs))]
        self.residual, self.exclude_self = residual, exclude_self
        self.layers = nn.ModuleList()
        for arities_needed in reversed(needed):
            widths = [outputs if arity in arities_needed else 0 for arity in arities]
            # Most atoms of a scene are false.
            layer = LogicLayer(counts, widths, hidden, exclude_self, 0.5 if self.layers else 0.0)
            self.layers.append(layer)
            counts = [new + (old if residual and new else 0) for old, new in zip(counts, layer.outputs, strict=True)]
        self.counts = counts

    def forward(self, groups: Sequence[Tensor | None], mask: Tensor) -> Groups:
        """Return the groups of the last layer, `None` for arities without predicates.

        Args:
            groups: The input groups of the arities 0, 1, ..., with truth values from 0 to 1. The group of arity r has
                the shape (batch, N, ..., N, predicates) with r axes for entities, as the results have.
            mask: bool (batch, N): the entities that are present. With `exclude_self`, the results are 0 for tuples that
                contain an entity twice.
        """
        count = mask.shape[1]
        current: Groups = []
        for arity, group in enumerate(groups):
            if group is not None:
                group = group.reshape(len(mask), -1, group.shape[-1]).permute(2, 1, 0)
                group = group.index_select(1, _tuples(count, arity, 1, self.exclude_self).place)
            current.append(group)
        current += [None] * (len(self.counts) - len(current))
        present = mask.T.to(next(group.dtype for group in current if group is not None))
        for layer in self.layers:
            old, current = current, layer(current, present)
            if self.residual:
                both = zip(old, current, strict=True)
                current = [new if one is None or new is None else torch.cat([one, new]) for one, new in both]
        for arity, group in enumerate(current):
            if group is not None:
                dense = group.new_zeros(len(group), count**arity, len(mask))
                dense = dense.index_copy(1, _tuples(count, arity, 1, self.exclude_self).place, group).permute(2, 1, 0)
                current[arity] = dense.unflatten(1, [count] * arity) if arity else dense[:, 0]
        return current


def _products(weight: Tensor, features: Tensor) -> Tensor:
    """Return the products of weights (width, F) and features (F, tuples, batch): (width, tuples, batch)."""
    return (weight @ features.flatten(1)).view(len(weight), *features.shape[1:])


def _linear(inputs: int, outputs: int, center: float, relu: bool) -> nn.Linear:
    """Create a linear layer whose outputs vary as much as its inputs after the activation function.

    The weights are those of Glorot and Bengio (2010), "Understanding the difficulty of training deep feedforward neural
    networks", equation 16, times a gain. The gain of a sigmoid, whose slope is at most 1/4, is 4. With smaller weights,
    the layers of a deep NLM are nearly constant, and it does not learn.
    """
    linear = nn.Linear(inputs, outputs)
    nn.init.xavier_uniform_(linear.weight, 2**0.5 if relu else 4.0)
    with torch.no_grad():
        linear.bias.copy_(-center * linear.weight.sum(1))
    return linear


class _Tuples(NamedTuple):
    """The T tuples of a group in lexicographic order, and their permutations.

    Attributes:
        place: int64 (T,): the index of each tuple among all tuples of entities.
        last: int64 (T,): the last entity of each tuple; of no meaning for the empty tuple.
        extensions: The number of tuples for each tuple that is shorter by one.
        permuted: int64 (width * T, P): for the output o, the tuple t and the permutation p, at (T o + t, p): the index
            of the product of p and o at the permuted tuple, if products have the shape (P, width, T).
    """

    place: Tensor
    last: Tensor
    extensions: int
    permuted: Tensor


@cache
def _tuples(count: int, arity: int, width: int, distinct: bool) -> _Tuples:
    """Return the tuples of a number of entities, or those of different entities, for a number of outputs."""
    entities = range(count)
    tuples = list(permutations(entities, arity) if distinct else product(entities, repeat=arity))
    index = {each: at for at, each in enumerate(tuples)}
    ways = list(permutations(range(arity)))
    places = [sum(entity * count ** (arity - 1 - at) for at, entity in enumerate(each)) for each in tuples]
    # Training may use the result even if the first call is for inference.
    with torch.inference_mode(False):
        permuted = torch.tensor(
            [[index[tuple(each[at] for at in way)] for way in ways] for each in tuples], dtype=torch.int64
        ).view(len(tuples), len(ways))
        output, way = torch.arange(width)[:, None, None], torch.arange(len(ways))
        permuted = (permuted + len(tuples) * (output + width * way)).view(-1, len(ways))
        return _Tuples(
            place=torch.tensor(places, dtype=torch.int64),
            last=torch.tensor([each[-1] if each else 0 for each in tuples], dtype=torch.int64),
            extensions=max(count - arity + 1, 0) if distinct else count,
            permuted=permuted,
        )
