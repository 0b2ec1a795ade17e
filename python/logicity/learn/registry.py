"""The learners by name. A learner's module is imported on first use."""

from __future__ import annotations

import importlib

from ..errors import extra
from .learner import Learner

__all__ = ["LEARNERS", "learner_class"]

LEARNERS: dict[str, str] = {
    "dqn": "stable_baselines:DQNLearner",
    "ppo": "stable_baselines:PPOLearner",
    "a2c": "stable_baselines:A2CLearner",
    "nlm-dqn": "nlm_rl:NlmDqnLearner",
    "nlm-ppo": "nlm_rl:NlmPpoLearner",
    "mb-shooting": "shooting:Shooting",
    "dreamer": "dreamer:Dreamer",
    "ppo-fast": "fast_ppo:FastPPO",
    "mlp": "cloning:MlpLearner",
    "gnn": "cloning:GnnLearner",
    "nlm": "cloning:NlmLearner",
    "transformer": "cloning:TransformerLearner",
    "hri": "hri:HRI",
    "popper": "popper:PopperLearner",
    "maxsynth": "popper:MaxSynthLearner",
    "foldrm": "fold_rm:FoldRMLearner",
    "induce": "symbolic:InduceLearner",
    "planner": "planner:PlannerLearner",
}
"""The module and the class of each learner, keyed by its name in training files."""


def learner_class(name: str) -> type[Learner]:
    """Return the class of the learner with a name in `LEARNERS`.

    Raises:
        ImportError: If a package is missing.
        KeyError: If the name is unknown.
    """
    module, _, cls = LEARNERS[name].partition(":")
    with extra("learn"):
        learner: type[Learner] = getattr(importlib.import_module(f".{module}", __package__), cls)
    return learner
