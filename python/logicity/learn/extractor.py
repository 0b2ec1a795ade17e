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

    The options are the arguments of `NeuralLogicMachine`, such as `depth`. The atoms are those of `Layout.atoms`. If
    they do not fit the space, it raises `ValueError`.
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
        return self.network(observations)
