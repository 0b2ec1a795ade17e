"""A small graph neural network that predicts actions from facts. Needs the extra `vap`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..city import ACTIONS
from ..errors import missing_extra
from .data import BINARY, UNARY, VapDataset

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise missing_extra("vap", error) from error

from .loader import as_tensors, padded_batch

__all__ = ["FactNetwork", "train_network"]

WIDTH = 64
ROUNDS = 2
BATCH = 64
LEARNING_RATE = 3e-3


#: The sample, the receiver and the sender of each edge, as indices.
Edges: TypeAlias = tuple[Tensor, Tensor, Tensor]


class MessagePassing(nn.Module):
    """A layer in which every entity receives messages from the entities in its view, including itself."""

    def __init__(self) -> None:
        """Initialize the weights."""
        super().__init__()
        self.receiver, self.sender = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH, bias=False)
        self.edge = nn.Linear(2 * len(BINARY), WIDTH, bias=False)
        self.update = nn.Linear(3 * WIDTH, WIDTH)

    def forward(self, nodes: Tensor, edge_features: Tensor, edges: Edges) -> Tensor:
        """Return the new node embeddings, of shape (batch, entities, width)."""
        batch, receiver, sender = edges
        messages = self.receiver(nodes)[batch, receiver] + self.sender(nodes)[batch, sender] + self.edge(edge_features)
        # Messages are not negative, so 0 can represent the maximum of an empty set.
        messages = torch.relu(messages)
        place = batch * nodes.shape[1] + receiver
        none = messages.new_zeros(nodes.shape[0] * nodes.shape[1], WIDTH)
        largest = none.scatter_reduce(0, place[:, None].expand_as(messages), messages, "amax")
        total = none.index_add(0, place, messages)
        return torch.relu(self.update(torch.cat([nodes, largest.view_as(nodes), total.view_as(nodes)], -1)))


class FactNetwork(nn.Module):
    """A network with two rounds of message passing between entities in view, on unary and binary facts."""

    def __init__(self) -> None:
        """Initialize the weights."""
        super().__init__()
        self.encoder = nn.Linear(len(UNARY), WIDTH)
        self.rounds = nn.ModuleList(MessagePassing() for _ in range(ROUNDS))
        self.readout = nn.Linear(WIDTH, len(ACTIONS))

    def forward(self, unary: Tensor, binary: Tensor, sees: Tensor) -> Tensor:
        """Return action logits of shape (batch, entities, 4) from truth values in the format of `collate`."""
        edges: Edges = sees.nonzero(as_tuple=True)
        edge_features = torch.cat([binary, binary.transpose(1, 2)], -1)[edges].float()
        nodes = torch.relu(self.encoder(unary.float()))
        for message_passing in self.rounds:
            nodes = message_passing(nodes, edge_features, edges)
        scores: Tensor = self.readout(nodes)
        return scores


def train_network(
    train: VapDataset, test: VapDataset, seed: int, epochs: int, progress: Callable[[int], None]
) -> NDArray[np.int64]:
    """Train a network on one data set, and predict the actions of the cars in another.

    The same seed gives the same predictions on the same machine.

    Args:
        train: The data set to train on, which must have cars.
        test: The data set to predict on.
        seed: The seed.
        epochs: The number of epochs.
        progress: A function that receives the number of finished epochs after each epoch.

    Returns:
        The predicted actions, int64 of shape (M,) for M cars in all samples of `test`.
    """
    facts, queries = (
        padded_batch([as_tensors(samples.facts(at)) for at in range(len(samples))]) for samples in (train, test)
    )
    threads = torch.get_num_threads()
    # The tensors are so small that synchronizing several threads costs more than it saves.
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = _trained(facts, epochs, progress)
        with torch.no_grad():
            best = [network(*_inputs(queries, chosen)).argmax(-1) for chosen in torch.arange(len(test)).split(BATCH)]
    finally:
        torch.set_num_threads(threads)
    predicted: NDArray[np.int64] = torch.cat(best)[queries["mask"]].numpy()
    return predicted


def _trained(facts: dict[str, Tensor], epochs: int, progress: Callable[[int], None]) -> FactNetwork:
    """Train a network on the samples with cars. Random numbers come from the default generator."""
    network, with_cars = FactNetwork(), facts["mask"].any(1).nonzero()[:, 0]
    count = len(with_cars)
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    steps = epochs * math.ceil(count / BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(steps, 1))
    for epoch in range(epochs):
        for chosen in with_cars[torch.randperm(count)].split(BATCH):
            scores, cars = network(*_inputs(facts, chosen)), facts["mask"][chosen]
            loss = nn.functional.cross_entropy(scores[cars], facts["actions"][chosen][cars])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
        progress(epoch + 1)
    return network


def _inputs(facts: dict[str, Tensor], chosen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return facts["unary"][chosen], facts["binary"][chosen], facts["sees"][chosen]
