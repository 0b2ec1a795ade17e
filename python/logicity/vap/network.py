"""A small network that learns actions from what is true. Needs the extra `vap`: `pip install './python[vap]'`."""

from __future__ import annotations

from collections.abc import Callable

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


class Round(nn.Module):
    """Every entity hears from all that it sees, itself among them, and changes its mind."""

    def __init__(self) -> None:
        """Draw the weights."""
        super().__init__()
        self.of_hearer, self.of_heard = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH, bias=False)
        self.of_pair = nn.Linear(2 * len(BINARY), WIDTH, bias=False)
        self.change = nn.Linear(3 * WIDTH, WIDTH)

    def forward(self, minds: Tensor, pairs: Tensor, sees: Tensor) -> Tensor:
        """Minds after it, (batch, entities, width)."""
        heard = self.of_hearer(minds)[:, :, None] + self.of_heard(minds)[:, None] + self.of_pair(pairs)
        # What is heard is not negative, so that 0 is the largest of nothing.
        heard = torch.relu(heard) * sees[..., None]
        return torch.relu(self.change(torch.cat([minds, heard.amax(2), heard.sum(2)], -1)))


class FactNetwork(nn.Module):
    """Two rounds of messages over the entities that each sees, on what is true of them and between them."""

    def __init__(self) -> None:
        """Draw the weights."""
        super().__init__()
        self.begin = nn.Linear(len(UNARY), WIDTH)
        self.rounds = nn.ModuleList(Round() for _ in range(ROUNDS))
        self.end = nn.Linear(WIDTH, len(ACTIONS))

    def forward(self, unary: Tensor, binary: Tensor, sees: Tensor) -> Tensor:
        """Scores of actions, (batch, entities, 4), from truth values as `collate` has them."""
        pairs = torch.cat([binary, binary.transpose(1, 2)], -1).float()
        minds = torch.relu(self.begin(unary.float()))
        for round_ in self.rounds:
            minds = round_(minds, pairs, sees.float())
        scores: Tensor = self.end(minds)
        return scores


def train_network(
    train: VapDataset, test: VapDataset, seed: int, epochs: int, progress: Callable[[int], None]
) -> NDArray[np.int64]:
    """Train on the samples of one data set, and predict the actions of the cars of another, one after the other.

    The same seed learns the same on the same machine. `progress` is told after each epoch how many are done.
    """
    facts, asked = (
        padded_batch([as_tensors(samples.facts(at)) for at in range(len(samples))]) for samples in (train, test)
    )
    inputs = ("unary", "binary", "sees")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = FactNetwork()
        optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
        steps = epochs * -(-len(train) // BATCH)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(steps, 1))
        for epoch in range(epochs):
            for chosen in torch.randperm(len(train)).split(BATCH):
                scores = network(*(facts[name][chosen] for name in inputs))
                cars = facts["mask"][chosen]
                loss = nn.functional.cross_entropy(scores[cars], facts["actions"][chosen][cars])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
            progress(epoch + 1)
    with torch.no_grad():
        best = [
            network(*(asked[name][chosen] for name in inputs)).argmax(-1)
            for chosen in torch.arange(len(test)).split(BATCH)
        ]
    predicted: NDArray[np.int64] = torch.cat(best)[asked["mask"]].numpy()
    return predicted
