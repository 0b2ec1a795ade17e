"""Reasoners: networks and rules that predict actions from the degrees of predicates. Needs the extra `vap`."""

from __future__ import annotations

from typing import Literal

from ..city import ACTIONS
from ..errors import extra
from ..rules import Program
from ..torch import RuleLayer, Semantics
from .data import UNARY

with extra("vap"):
    import torch
    from torch import Tensor, nn

from .concepts import RELATIONS, in_view

__all__ = ["GraphReasoner", "LogicReasoner", "RuleReasoner", "make_reasoner", "rule_degrees"]


def rule_degrees(rules: Program, semantics: Semantics, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
    """Return the degree to which each action is the answer of rules, (B, N, 4) in the order of `ACTIONS`.

    The order is also that of precedence, as in `configs/vap-easy.yaml`. The other arguments are those of the networks,
    see `make_reasoner`. An entity sees itself, and no other binary predicate relates it to itself.
    """
    return _degrees(RuleLayer(rules, semantics, priority=ACTIONS), unary, binary, valid)


def _degrees(layer: RuleLayer, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
    sees, eye = in_view(binary, valid)
    values = {name: binary[..., at].masked_fill(eye, 0.0) for at, name in enumerate(RELATIONS)} | {"Sees": sees}
    known = unary[..., [UNARY.index(name) for name in layer.unary]]
    degrees: Tensor = layer(known, torch.stack([values[name] for name in layer.binary], -1), valid)
    return degrees


def make_reasoner(name: Literal["gnn", "nlm", "rules"], rules: Program | None = None) -> nn.Module:
    """Create a reasoner: a network with random weights, or the rules, which have none.

    It maps groundings and the mask of entities to logits of actions. Its arguments are truth degrees of the shapes
    (B, N, 11) and (B, N, N, 7), in the orders of `UNARY` and `RELATIONS`, and the mask bool (B, N) of the entities that
    are present. The result has the shape (B, N, 4).
    """
    if name == "rules":
        if rules is None:
            raise ValueError("rules: the reasoner `rules` needs a program, such as `Program.load(...)`")
        return RuleReasoner(rules)
    return GraphReasoner() if name == "gnn" else LogicReasoner()


class RuleReasoner(nn.Module):
    """The rules as a layer with the semantics `product`, without parameters."""

    def __init__(self, rules: Program) -> None:
        """Prepare the rules."""
        super().__init__()
        self.layer = RuleLayer(rules, "product", priority=ACTIONS)

    def forward(self, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
        """Return the logarithms of the degrees of the actions, see `make_reasoner`."""
        # The constant keeps the logarithm and its gradient finite.
        return torch.log(_degrees(self.layer, unary, binary, valid) + 1e-12)


class GraphReasoner(nn.Module):
    """GINE convolutions over all pairs of entities, with loops, and a linear layer.

    A convolution computes h((1 + eps) x_i + sum over j of m_ij, max over j of m_ij) with the messages m_ij =
    s_ij ReLU(x_j + W e_ij), from node features x and edge features e, both directions of the binary predicates. With
    the sum alone and s_ij = 1, this is GINE of Hu et al. (2020), "Strategies for Pre-training Graph Neural Networks",
    ICLR. Here s_ij is the degree to which i sees j, and the maximum stands for "there is": a sum of many small
    probabilities looks like one certain fact. Two convolutions have `width` node features.
    """

    def __init__(self, width: int = 128) -> None:
        """Create the layers."""
        super().__init__()
        self.encoder = nn.Linear(len(UNARY), width)
        self.edges = nn.ModuleList(nn.Linear(2 * len(RELATIONS), width) for _ in range(2))
        self.updates = nn.ModuleList(
            nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()) for _ in range(2)
        )
        self.eps = nn.Parameter(torch.zeros(2))
        self.readout = nn.Linear(width, len(ACTIONS))

    def forward(self, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
        """Return the logits of the actions, see `make_reasoner`."""
        sees = in_view(binary, valid)[0][..., None]
        features = torch.cat([binary, binary.transpose(1, 2)], -1)
        nodes = self.encoder(unary)
        for layer, (edge, update) in enumerate(zip(self.edges, self.updates, strict=True)):
            messages = sees * torch.relu(nodes[:, None] + edge(features))
            # Messages are not negative, so 0 is the maximum of none.
            total = (1 + self.eps[layer]) * nodes + messages.sum(2)
            nodes = update(torch.cat([total, messages.amax(2)], -1))
        return self.readout(nodes)


class LogicReasoner(nn.Module):
    """A Neural Logic Machine (NLM) of depth 4, breadth 3 and 8 outputs, and a linear layer.

    The existential variables of the rules range over the entities in view. The NLM learns this from `Sees`, which is
    one of the binary predicates.
    """

    def __init__(self) -> None:
        """Create the layers."""
        super().__init__()
        # `logicity.learn` needs more packages than a graph network.
        from ..learn.nlm import NeuralLogicMachine

        self.machine = NeuralLogicMachine([0, len(UNARY), len(RELATIONS)], depth=4, breadth=3, outputs=8)
        self.readout = nn.Linear(self.machine.counts[1], len(ACTIONS))

    def forward(self, unary: Tensor, binary: Tensor, valid: Tensor) -> Tensor:
        """Return the logits of the actions, see `make_reasoner`."""
        return self.readout(self.machine([None, unary, binary], valid)[1])
