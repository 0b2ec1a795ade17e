"""Deep Q-learning with a Neural Logic Machine as features: NLM-DQN of the paper."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import DQN

from .cloning import LogicSettings
from .demonstrations import layout_of
from .extractor import LogicFeatures
from .settings import Training
from .stable_baselines import StableBaselinesLearner, settings_model

__all__ = ["NlmDqnLearner", "NlmDqnSettings"]

_DqnSettings: Any = settings_model(DQN)


class NlmDqnSettings(_DqnSettings, LogicSettings):
    """The settings of `nlm-dqn`: those of DQN, and those of the Neural Logic Machine.

    `network` lists the widths of the layers with ReLU between the predicates of the ego and the values of the actions.
    """


class NlmDqnLearner(StableBaselinesLearner):
    """Deep Q-learning whose features are the predicates that a Neural Logic Machine invents for the ego."""

    settings_class = NlmDqnSettings
    observations = ("groundings",)

    @classmethod
    def features(cls, config: Training) -> dict[str, Any]:
        """Return the atoms of the observations."""
        layout = layout_of(config.mode)
        return {"atoms": layout.atoms(), "route_length": layout.route_length is not None}

    @classmethod
    def policy_arguments(cls, settings: dict[str, Any], features: dict[str, Any]) -> dict[str, Any]:
        """Return the Neural Logic Machine as features, and the layers after it."""
        options = {name: settings.pop(name) for name in LogicSettings.model_fields}
        return {
            "features_extractor_class": LogicFeatures,
            "features_extractor_kwargs": {**features, **options},
            "net_arch": list(settings.pop("network")),
        }
