"""A Neural Logic Machine as the features of Stable-Baselines3's algorithms."""

from __future__ import annotations

from typing import Any

import gymnasium
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor

from ..types import Atom
from .cloning import LogicNetwork
from .demonstrations import Layout

__all__ = ["LogicFeatures"]


class LogicFeatures(BaseFeaturesExtractor):
    """The predicates that a Neural Logic Machine invents for the ego.

    Use it as `policy_kwargs={"features_extractor_class": LogicFeatures, "features_extractor_kwargs": {...}}`. The
    arguments are plain data, which Stable-Baselines3 can save.

    Args:
        observation_space: The space of the `groundings` observations.
        atoms: The atoms of an observation in their order, such as those of `Layout.atoms`.
        route_length: Whether the task observes the route length.
        options: The arguments of `NeuralLogicMachine`, such as `depth`.

    Raises:
        ValueError: If the atoms do not fit the space.
    """

    def __init__(
        self,
        observation_space: gymnasium.Space[Any],
        atoms: tuple[Atom, ...],
        route_length: bool = False,
        **options: Any,
    ) -> None:
        """Create the Neural Logic Machine."""
        layout = Layout.of_atoms(atoms, route_length)
        if observation_space.shape != (layout.width,):
            raise ValueError(
                f"the atoms describe observations of shape ({layout.width},), not {observation_space.shape}"
            )
        network = LogicNetwork(layout, **options)
        super().__init__(observation_space, network.width)
        self.network = network

    def forward(self, observations: Tensor) -> Tensor:
        """Return truth values of shape (batch, features)."""
        features: Tensor = self.network(observations)
        return features
