"""A graph neural network of GINE convolutions over the entities of an observation.

The convolution is that of Hu et al. (2020), "Strategies for Pre-training Graph Neural Networks", ICLR: with node
features x and edge features e, the new features of node i are h((1 + eps) x_i + sum over j of ReLU(x_j + W e_ji)).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import torch
from stable_baselines3.common.torch_layers import create_mlp
from torch import Tensor, nn

from .demonstrations import GraphView, Layout

with warnings.catch_warnings():
    # PyTorch Geometric compiles functions on import.
    for category in (FutureWarning, DeprecationWarning):
        warnings.filterwarnings("ignore", "`torch.jit.script` is deprecated", category)
    from torch_geometric.nn import GINEConv

__all__ = ["GraphNetwork"]


class GraphNetwork(nn.Module):
    """GINE convolutions over the complete graph with loops, and a linear layer on the features of the ego.

    The options are those of `cloning.GnnSettings`; `widths` are those of the perceptron h. The ego receives messages
    along the edges (j, ego), so without `reverse` a single convolution ignores the truth values of P(ego, j). The
    features of absent entities are zeros. Without `learned_eps`, eps is 0. Because of the loops, a single convolution
    then sees 2 x_ego plus the sum over the others, which does not determine x_ego.
    """

    def __init__(
        self,
        layout: Layout,
        outputs: int,
        widths: Sequence[int] = (64, 64),
        layers: int = 1,
        reverse: bool = False,
        present_only: bool = False,
        learned_eps: bool = False,
    ) -> None:
        """Create the layers."""
        super().__init__()
        self.view, self.present_only = GraphView(layout, reverse), present_only
        self.convolutions = nn.ModuleList()
        width = len(layout.unary)
        for _ in range(layers):
            perceptron = nn.Sequential(*create_mlp(width, -1, list(widths)))
            self.convolutions.append(GINEConv(perceptron, train_eps=learned_eps, edge_dim=self.view.edge_width))
            width = widths[-1]
        self.readout = nn.Linear(width + (layout.route_length is not None), outputs)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the outputs, (batch, outputs), of observations of shape (batch, width)."""
        nodes, index, edges, mask = self.view(observations)
        if self.present_only:
            kept = mask[index].all(0)
            index, edges = index[:, kept], edges[kept]
        for convolution in self.convolutions:
            nodes = convolution(nodes, index, edges)
        ego = nodes.view(len(observations), -1, nodes.shape[-1])[:, 0]
        route_length = self.view.relational.route_length(observations)
        return self.readout(ego if route_length is None else torch.cat([ego, route_length], 1))
