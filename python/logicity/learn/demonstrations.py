"""The recorded demonstrations as tensors, and views of batches of observations as tensors."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor, nn

from .. import _logicity
from ..city import ACTIONS
from ..envs.layout import Layout
from ..offline import Demonstrations, demonstrations
from ..tasks import load_task

__all__ = ["DemonstrationData", "GraphView", "Layout", "RelationalView", "Sampler", "first_demonstrations", "layout_of"]


def layout_of(mode: str | os.PathLike[str]) -> Layout:
    """Return the layout of `groundings` observations. The exceptions are those of `load_task` and `Layout.of_atoms`."""
    return Layout.of_description(_logicity.layout(load_task(mode)))


def first_demonstrations(mode: str | os.PathLike[str], share: float = 1.0, split: str = "train") -> Demonstrations:
    """Run the oracle on the first recorded episodes of a mode or of a configuration file.

    The share of the recorded episodes, 0 < share <= 1, is rounded to the nearest number of at least 1. The exceptions
    are those of `logicity.demonstrations`.
    """
    if not 0 < share <= 1:
        raise ValueError(f"the share of the demonstrations must be above 0 and at most 1, not {share}")
    return demonstrations(mode, max(1, round(share * load_task(mode).recorded(split))), split)


@dataclass(frozen=True, eq=False)
class DemonstrationData:
    """Steps of the oracle in the recorded training episodes.

    Attributes:
        layout: The layout of the observations.
        observations: float32 (S, width).
        actions: int64 (S,).
        trajectories: int64 (S,): the number of the trajectory of each step, from 0.
    """

    layout: Layout
    observations: Tensor
    actions: Tensor
    trajectories: Tensor

    @classmethod
    def load(cls, mode: str | os.PathLike[str], share: float = 1.0, split: str = "train") -> DemonstrationData:
        """Run the oracle on recorded episodes, as `first_demonstrations` does."""
        chosen = first_demonstrations(mode, share, split)
        lengths = torch.tensor([len(trajectory) for trajectory in chosen])
        return cls(
            layout_of(mode),
            torch.from_numpy(np.concatenate([trajectory.observations[:-1] for trajectory in chosen])),
            torch.from_numpy(np.concatenate([trajectory.actions for trajectory in chosen])),
            torch.repeat_interleave(torch.arange(len(lengths)), lengths),
        )

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.actions)

    @cached_property
    def counts(self) -> Tensor:
        """The number of steps with each action, int64 (4,)."""
        return torch.bincount(self.actions, minlength=len(ACTIONS))

    def distinct(self) -> DemonstrationData:
        """Return the steps without those that repeat the observation and the action of an earlier step."""
        both = torch.cat([self.observations, self.actions[:, None].float()], 1)
        _, first = np.unique(both.numpy(), axis=0, return_index=True)
        return self[torch.from_numpy(np.sort(first))]

    def __getitem__(self, steps: Tensor) -> DemonstrationData:
        """Return the steps at these indices."""
        return DemonstrationData(self.layout, self.observations[steps], self.actions[steps], self.trajectories[steps])

    def class_weights(self, power: float) -> Tensor:
        """Return weights of the actions for a loss, float32 (4,): the power of (mean count / count of the action).

        With the power 1, every action that occurs has the same total weight. One that never occurs has weight 0.
        """
        occurs = self.counts > 0
        mean = self.counts[occurs].float().mean()
        return torch.where(occurs, (mean / self.counts.clamp(min=1)).pow(power), 0.0)


class Sampler:
    """Draws batches of steps, and goes through all steps before it repeats one.

    A larger batch than the number of steps counts as that number. With `balanced`, each action that occurs has the same
    probability, and steps are drawn with replacement.
    """

    def __init__(self, data: DemonstrationData, batch: int, seed: int, balanced: bool = False) -> None:
        """Seed the generator."""
        self._batch, self._count = min(batch, len(data)), len(data)
        self._generator = torch.Generator().manual_seed(seed)
        self._weights = data.class_weights(1.0)[data.actions] if balanced else None
        self._order = torch.empty(0, dtype=torch.int64)

    def next(self) -> Tensor:
        """Return the indices of the next batch, int64 (batch,)."""
        if self._weights is not None:
            return torch.multinomial(self._weights, self._batch, replacement=True, generator=self._generator)
        while len(self._order) < self._batch:
            self._order = torch.cat([self._order, torch.randperm(self._count, generator=self._generator)])
        chosen, self._order = self._order[: self._batch], self._order[self._batch :]
        return chosen

    def state_dict(self) -> dict[str, Tensor]:
        """Return the state, from which `load_state_dict` continues exactly."""
        return {"generator": self._generator.get_state(), "order": self._order}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore a state. Raise `ValueError` if it was saved for other data."""
        order = state["order"]
        is_flat = order.dtype == torch.int64 and order.ndim == 1
        if not is_flat or (len(order) and not 0 <= order.min() <= order.max() < self._count):
            raise ValueError("this sampler state was saved for different demonstrations")
        self._generator.set_state(state["generator"])
        self._order = state["order"]


class RelationalView(nn.Module):
    """Maps observations to padded relational tensors, see `logicity.envs.wrappers.RelationalObservation`."""

    def __init__(self, layout: Layout) -> None:
        """Store the positions as tensors. A saved state omits them."""
        super().__init__()
        self.layout = layout
        buffers = {"_unary": layout.unary_at.ravel(), "_binary": layout.binary_at.ravel()}
        for name, values in {**buffers, "_occurrences": layout.occurrences()}.items():
            self.register_buffer(name, torch.from_numpy(values), persistent=False)

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the unary (batch, N, U) and binary (batch, N, N, B) truth values of observations (batch, width).

        Also returns the mask of entities, bool (batch, N).
        """
        count, batch = self.layout.entities, len(observations)
        unary = observations.index_select(1, self._unary).view(batch, count, -1)
        binary = observations.index_select(1, self._binary).view(batch, count, count, -1)
        mask = observations.abs() @ self._occurrences.to(observations.dtype) > 0
        mask[:, 0] = True
        return unary, binary, mask

    def route_length(self, observations: Tensor) -> Tensor | None:
        """Return the route lengths, (batch, 1), if the task observes them."""
        at = self.layout.route_length
        return None if at is None else observations[:, at : at + 1]


class GraphView(nn.Module):
    """Maps observations to one disjoint union of complete graphs, in the format of PyTorch Geometric.

    The graph of each observation has N nodes and N * N edges, including a loop at each node. With `reverse`, the edge
    from j to i also has the features of the edge from i to j.
    """

    def __init__(self, layout: Layout, reverse: bool = False) -> None:
        """Create the index of one graph."""
        super().__init__()
        self.relational, self.reverse = RelationalView(layout), reverse
        self.register_buffer("_links", torch.from_numpy(layout.edge_links()).T.contiguous(), persistent=False)

    @property
    def edge_width(self) -> int:
        """The number of features of an edge."""
        return len(self.relational.layout.binary) * (2 if self.reverse else 1)

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the graphs of observations of shape (batch, width).

        Returns:
            The node features (batch * N, U); the edge index, int64 (2, batch * N * N), whose first row has the sources;
            the edge features (batch * N * N, B), twice as many with `reverse`; and the mask, bool (batch * N,).
        """
        unary, binary, mask = self.relational(observations)
        if self.reverse:
            binary = torch.cat([binary, binary.transpose(1, 2)], -1)
        first = torch.arange(len(observations), device=self._links.device) * self.relational.layout.entities
        index = (first[:, None] + self._links[:, None]).flatten(1)
        return unary.flatten(0, 1), index, binary.flatten(0, 2), mask.flatten()
