"""Learners of Safe Path Following, and their training. Needs the extra `learn`.

`logicity train` trains a learner from a YAML file, see `TrainConfig` and `train`. `registry.LEARNERS` lists the
learners. Each one is a `Learner`, whose result is a `Policy`. `load_policy` reads a policy from a file or a run.
"""

from .config import TrainConfig
from .learner import Learner, Policy
from .policies import SavedPolicy, load_policy
from .registry import LEARNERS as LEARNERS
from .registry import learner_class
from .run import train
from .settings import LearnerSettings

__all__ = [
    "Learner",
    "LearnerSettings",
    "Policy",
    "SavedPolicy",
    "TrainConfig",
    "learner_class",
    "load_policy",
    "train",
]
