"""Learners of Safe Path Following, and their training. Needs the extra `learn`.

`logicity train` trains a learner from a YAML file, see `TrainConfig` and `train`. `registry.LEARNERS` lists the
learners. Each one is a `Learner`, whose result is a `LearnedPolicy`. `load_policy` reads a policy from a file or a run.
Modules are imported on first use.
"""

from typing import TYPE_CHECKING

from ..lazily import exports

if TYPE_CHECKING:
    from .config import TrainConfig
    from .learner import LearnedPolicy, Learner
    from .policies import SavedPolicy, load_policy
    from .registry import LEARNERS as LEARNERS
    from .registry import learner_class
    from .run import train
    from .settings import LearnerSettings, Training

_HOMES = {
    "LEARNERS": "registry",
    "LearnedPolicy": "learner",
    "Learner": "learner",
    "LearnerSettings": "settings",
    "SavedPolicy": "policies",
    "TrainConfig": "config",
    "Training": "settings",
    "learner_class": "registry",
    "load_policy": "policies",
    "train": "run",
}

__all__ = [
    "LearnedPolicy",
    "Learner",
    "LearnerSettings",
    "SavedPolicy",
    "TrainConfig",
    "Training",
    "learner_class",
    "load_policy",
    "train",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = exports(globals(), _HOMES)
