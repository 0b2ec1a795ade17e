"""A transformer over the entities of an observation."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .demonstrations import Layout, RelationalView

__all__ = ["TransformerNetwork"]


class TransformerLayer(nn.Module):
    """Attention between tokens and a perceptron. Both normalize first, and add to their input."""

    def __init__(self, heads: int, head_width: int, feedforward: int, relations: int) -> None:
        """Create the layer. Tokens have heads * head_width features."""
        super().__init__()
        self.heads, width = heads, heads * head_width
        self.norm, self.inputs, self.output = nn.LayerNorm(width), nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.relations = nn.Linear(relations, heads, bias=False)
        self.perceptron = nn.Sequential(
            nn.LayerNorm(width), nn.Linear(width, feedforward), nn.ReLU(), nn.Linear(feedforward, width)
        )

    def forward(self, tokens: Tensor, binary: Tensor, absent: Tensor) -> Tensor:
        """Return tokens, (batch, N, width). `absent` is added to the scores, (batch, 1, 1, N)."""
        batch, count, width = tokens.shape
        parts = self.inputs(self.norm(tokens)).view(batch, count, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        scores = self.relations(binary).permute(0, 3, 1, 2) + absent
        attended = nn.functional.scaled_dot_product_attention(*parts, attn_mask=scores)
        tokens = tokens + self.output(attended.transpose(1, 2).reshape(batch, count, width))
        return tokens + self.perceptron(tokens)


class TransformerNetwork(nn.Module):
    """An encoder (Vaswani et al. 2017) with a token for each entity, and a linear layer on the token of the ego.

    A token embeds the unary truth values of an entity and the binary ones between it and the ego, in both directions. A
    linear function of the binary truth values of entities i and j, one for each layer and head, is added to the score
    with which i attends to j (Ying et al. 2021, "Do Transformers Really Perform Bad for Graph Representation?"). Absent
    entities are masked. Tokens have no positions: the order of the other entities does not matter. There is no dropout.
    """

    def __init__(
        self, layout: Layout, outputs: int, layers: int, heads: int, head_width: int, feedforward: int
    ) -> None:
        """Create the layers. Tokens have heads * head_width features."""
        super().__init__()
        self.view = RelationalView(layout)
        width, relations = heads * head_width, len(layout.binary)
        self.embedding = nn.Linear(len(layout.unary) + 2 * relations, width)
        # Distinguishes the ego.
        self.ego = nn.Parameter(torch.zeros(width))
        self.layers = nn.ModuleList(TransformerLayer(heads, head_width, feedforward, relations) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.readout = nn.Linear(width + (layout.route_length is not None), outputs)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the outputs, (batch, outputs), of observations of shape (batch, width of the observation)."""
        unary, binary, mask = self.view(observations)
        tokens = self.embedding(torch.cat([unary, binary[:, 0], binary[:, :, 0]], -1))
        tokens = torch.cat([tokens[:, :1] + self.ego, tokens[:, 1:]], 1)
        absent = torch.zeros_like(mask, dtype=tokens.dtype).masked_fill(~mask, -torch.inf)
        for layer in self.layers:
            tokens = layer(tokens, binary, absent[:, None, None])
        ego = self.norm(tokens[:, 0])
        route_length = self.view.route_length(observations)
        return self.readout(ego if route_length is None else torch.cat([ego, route_length], 1))
