"""The settings of learners, and what a learner gets besides them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

from ..errors import extra

with extra("learn"):
    from pydantic import BaseModel, ConfigDict, Field, SerializeAsAny, Strict

from ..types import ArrayKind, EnvOptions, Episodes

__all__ = [
    *("Count", "LearnerSettings", "LearningRate", "NonNegative", "Positive", "Seed", "Share", "StrictModel"),
    *("Training", "TrainingOptions", "Widths"),
]

#: A positive integer. Booleans and strings are invalid.
Count: TypeAlias = Annotated[int, Field(strict=True, ge=1)]

#: A seed of random generators. Booleans and strings are invalid.
Seed: TypeAlias = Annotated[int, Field(strict=True, ge=0, lt=2**32)]

#: A number from 0 to 1.
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]

#: A number above 0.
Positive: TypeAlias = Annotated[float, Field(gt=0)]

#: A learning rate.
LearningRate: TypeAlias = Annotated[float, Field(gt=0, le=1)]

#: A number of at least 0.
NonNegative: TypeAlias = Annotated[float, Field(ge=0)]

#: The widths of one or more layers. YAML has lists, which strict validation does not accept as tuples.
Widths: TypeAlias = Annotated[tuple[Count, ...], Field(min_length=1), Strict(False)]


class StrictModel(BaseModel):
    """A part of a YAML file. Unknown keys and values of other types are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class LearnerSettings(StrictModel):
    """The settings of a learner: the values under `settings` in a training file."""

    model_config = ConfigDict(allow_inf_nan=False)


class TrainingOptions(EnvOptions):
    """The options of training environments."""

    episodes: Episodes


class Training(BaseModel):
    """What a learner gets: its settings, the options of its environments or demonstrations, and a seed."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    algorithm: str
    """The name of the learner."""
    mode: str
    """The mode, or the path of a configuration file, which determines the rules and the episodes. In a YAML file, a
    path is relative to the folder of that file."""
    observation: ArrayKind = "groundings"
    """The kind of observation: `groundings` or `state`, as in `gymnasium.make`. Learners over entities compute their
    tensors and graphs from `groundings`."""
    settings: SerializeAsAny[LearnerSettings] = Field(default_factory=LearnerSettings, validate_default=True)
    """The settings of the learner."""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """Changes to the configuration for training. Validation and test use the mode without overrides, except for the
    number of egos, `task.egos`. For learners that step environments."""
    steps: Count = Field(default=200_000, validate_default=True)
    """The number of training steps: steps of all environments together, or updates of a learner from demonstrations.
    Only `steps` may change when a run resumes."""
    envs: Count = 1
    """The number of parallel environments. For learners that step environments."""
    episodes: Episodes = "drawn"
    """The training episodes, as in `gymnasium.make`. For learners that step environments."""
    demonstrations: Annotated[float, Field(strict=True, gt=0, le=1)] = 1.0
    """The share of the recorded training episodes whose demonstrations are used. For learners from demonstrations."""
    start: str | None = None
    """The file of a policy of the same learner. Training starts from its weights. In a YAML file, a path is relative to
    the folder of that file. For neural learners."""
    seed: Seed = 0
    """The seed of networks, exploration and episodes."""
    validate_every: Count = 10_000
    """The number of steps between validations. Each validation writes a checkpoint."""
    threads: Count = 1
    """The number of PyTorch threads."""

    def evaluation_overrides(self) -> dict[str, Any] | None:
        """Return the part of the overrides that validation and test use: the number of egos."""
        task = self.overrides.get("task")
        egos = task.get("egos") if isinstance(task, Mapping) else None
        return None if egos is None else {"task": {"egos": egos}}

    def env_options(self) -> TrainingOptions:
        """Return the options of the training environments."""
        return TrainingOptions(
            split="train", episodes=self.episodes, overrides=self.overrides, observation=self.observation
        )
