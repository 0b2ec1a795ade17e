"""Deep Q-learning and PPO with a Neural Logic Machine as features."""

from __future__ import annotations

from typing import Any

from stable_baselines3 import DQN, PPO

from .cloning import LogicSettings
from .demonstrations import layout_of
from .extractor import LogicFeatures
from .settings import Training
from .stable_baselines import StableBaselinesLearner, settings_model

__all__ = ["NlmDqnLearner", "NlmDqnSettings", "NlmPpoLearner", "NlmPpoSettings"]

_DqnSettings: Any = settings_model(DQN)
_PpoSettings: Any = settings_model(PPO)


class NlmDqnSettings(_DqnSettings, LogicSettings):
    """The settings of `nlm-dqn`: those of DQN, and those of the Neural Logic Machine.

    `network` lists the widths of the layers with ReLU between the predicates of the ego and the values of the actions.
    """


class NlmPpoSettings(_PpoSettings, LogicSettings):
    """The settings of `nlm-ppo`: those of PPO, and those of the Neural Logic Machine.

    `network` lists the widths of the layers with ReLU after the predicates of the ego. The policy and the value have
    layers of their own.
    """


class LogicLearner(StableBaselinesLearner):
    """An algorithm whose features are the predicates that a Neural Logic Machine invents for the ego."""

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


class NlmDqnLearner(LogicLearner):
    """Deep Q-learning: NLM-DQN of the paper."""

    settings_class = NlmDqnSettings


class NlmPpoLearner(LogicLearner):
    """Proximal policy optimization, which the paper's program also has."""

    settings_class = NlmPpoSettings
