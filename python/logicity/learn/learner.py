"""The interface of the learners."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias

from .. import _logicity
from ..envs.views import Actions, Observations
from ..errors import extra
from ..files import read_tensors
from ..tasks import load_task
from ..types import ArrayKind
from .curves import Curves
from .settings import LearnerSettings, Training

with extra("learn"):
    import torch
    from torch import Tensor, nn

__all__ = ["LearnedPolicy", "Learner", "Progress", "check_shape", "minimize"]

#: The version of the files of checkpoints.
CHECKPOINT = 2

#: A learner calls it after each step. It validates the learner and writes checkpoints at intervals.
Progress: TypeAlias = Callable[[], None]


def check_shape(observation: Observations, width: int, mode: str) -> None:
    """Raise `ValueError` if observations do not have the shape (batch, width), as in the training in `mode`."""
    if observation.ndim != 2 or observation.shape[1] != width:
        raise ValueError(
            f"expected observations of shape (batch, {width}), not {observation.shape}: the policy was trained in "
            f"`{mode}`"
        )


def minimize(loss: Tensor, optimizer: torch.optim.Optimizer, gradient_clip: float | None = None) -> None:
    """Run one update of an optimizer on a loss.

    Gradients with a norm above `gradient_clip` are scaled to it; `None` does not clip.
    """
    optimizer.zero_grad()
    loss.backward()
    if gradient_clip is not None:
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        nn.utils.clip_grad_norm_(parameters, gradient_clip)
    optimizer.step()


class LearnedPolicy(ABC):
    """A trained policy, which maps batches of observations to actions."""

    def predict(
        self, observation: Observations, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Any]:
        """Return one action per observation, int64 of shape (batch,), and the next state.

        Args:
            observation: float32 of shape (batch, ...).
            state: The state that the last call returned; `None` at the start. A policy without memory returns `None`.
            episode_start: bool of shape (batch,): where an episode starts. The state is reset there.
            deterministic: Whether to take the most probable action.

        Raises:
            ValueError: If the observations do not fit those of the training.
        """
        return self._decide(observation, deterministic), None

    def _decide(self, observation: Observations, deterministic: bool) -> Actions:
        """Return the actions of a policy without memory."""
        raise NotImplementedError

    @abstractmethod
    def save(self, path: Path) -> None:
        """Write the policy to a file with the suffix `Learner.suffix`."""

    def rules(self) -> str | None:
        """Return the source of a rule file that makes the same decisions; `None` if the policy is not made of rules."""
        return None

    def weights(self) -> Mapping[str, Any]:
        """Return the tensors that determine the policy, by name, or mappings of such tensors.

        A policy made of rules has none.
        """
        return {}

    @classmethod
    @abstractmethod
    def load(cls, path: Path) -> LearnedPolicy:
        """Read a policy that `save` wrote. The file is data: nothing in it runs as code.

        Raises:
            OSError: If the file cannot be read.
            ValueError: If the file is not such a policy.
        """


class Learner(ABC):
    """A learner in training.

    `logicity.learn.run.train` creates a learner, restores its last checkpoint if there is one, and calls `fit`. `fit`
    calls `progress` after each step. During that call `policy`, `save` and `steps` must be valid. A restored learner
    continues exactly: the result of an interrupted run equals that of an uninterrupted one.

    A subclass implements `_step` or `fit`, and `state` and `load_state`, or `save` and `restore`.
    """

    #: The class of the values under `settings` in a training file.
    settings_class: ClassVar[type[LearnerSettings]]
    #: The unit of `steps`.
    unit: ClassVar[Literal["environment steps", "updates"]]
    #: The only possible number of steps, or `None` if there is a choice.
    only_steps: ClassVar[int | None] = None
    #: Whether the learner steps environments. Otherwise it learns from demonstrations. The keys `envs`,
    #: `episodes` and `overrides` need the former, the key `demonstrations` needs the latter; elsewhere they are errors.
    interacts: ClassVar[bool]
    #: The kinds of observations that the learner can use.
    observations: ClassVar[tuple[ArrayKind, ...]] = ("groundings",)
    #: Whether observations may have numbers besides truth values: quantities and probabilities.
    takes_numbers: ClassVar[bool] = True
    #: Whether the learner can drive several egos. It needs `interacts`.
    drives_egos: ClassVar[bool] = False
    #: The suffix of the files of its policies.
    suffix: ClassVar[str] = ".pt"
    #: The class of its policies.
    policy_class: ClassVar[type[LearnedPolicy]]
    #: Whether training can start from the weights of the policy that the key `start` names, see `start_from`.
    starts: ClassVar[bool] = False

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Prepare the training.

        Args:
            config: The configuration. `config.settings` is an instance of `settings_class`.
            log: The folder of the training curves (TensorBoard), if there is one.

        Raises:
            InputError: If the configuration of the mode or an override is invalid, or no episodes are recorded.
            OSError: If a file cannot be read.
            ValueError: If the mode is unknown, or the learner rejects the settings or the observations.
        """
        self.config, self.log = config, log
        layout = _logicity.layout(load_task(config.mode, overrides=config.overrides))
        if self.interacts and layout["shield"] == "mask":
            raise ValueError(
                f"`{config.algorithm}` reads no masks: set `mode: override` in the shield of {config.mode}"
            )
        if self.interacts and (layout["egos"] or 1) > 1 and not self.drives_egos:
            raise ValueError(
                f"`{config.algorithm}` drives one car in training, not the {layout['egos']} egos of the configuration: "
                "train it with one, and evaluate its policy with several"
            )
        if not self.takes_numbers:
            columns = layout["columns"]
            if layout["sensors"] not in (None, "facts"):
                raise ValueError(
                    f"`{config.algorithm}` learns from truth values, but the sensors of {config.mode} output "
                    f"{layout['sensors']}: set `output: facts`"
                )
            if quantities := [column["predicate"].partition("=")[0] for column in columns if "quantity" in column]:
                raise ValueError(
                    f"`{config.algorithm}` learns from truth values, but observations in {config.mode} have the "
                    f"quantity `{quantities[0]}`"
                )
        self._settings: Any = config.settings
        #: Shows a line about a long step to the user. `train` replaces it.
        self.say: Callable[[str], None] = lambda line: None
        self._curves = Curves(log)

    def start_from(self, policy: LearnedPolicy) -> None:
        """Copy the weights of a policy of the same learner before the training begins.

        Raises:
            ValueError: If the policy does not fit the configuration.
        """
        raise NotImplementedError

    @property
    @abstractmethod
    def steps(self) -> int:
        """The number of steps so far, in `unit`."""

    def fit(self, steps: int, progress: Progress) -> None:
        """Train until `self.steps` is at least `steps`.

        Raises:
            ValueError: If the settings are invalid in a way that only the training shows.
        """
        while self.steps < steps:
            self._step(steps)
            progress()

    def _step(self, steps: int) -> None:
        """Train until `self.steps` is larger, in a training of `steps` steps."""
        raise NotImplementedError

    @abstractmethod
    def policy(self) -> LearnedPolicy:
        """Return the current policy. Its actions may change when training continues."""

    def outcome(self) -> dict[str, Any]:
        """Return what `result.json` says about the training besides its measures, for JSON."""
        return {}

    def state(self) -> dict[str, Any]:
        """Return what `load_state` needs, as plain data: weights, optimizers, buffers, environments, random states."""
        raise NotImplementedError

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned.

        Raises:
            ValueError: If the state does not fit the configuration.
        """
        raise NotImplementedError

    def save(self, folder: Path) -> None:
        """Write everything that `restore` needs. The files are plain data."""
        state = {"checkpoint": CHECKPOINT, "algorithm": self.config.algorithm, **self.state()}
        torch.save(state, folder / "learner.pt")

    def restore(self, folder: Path) -> None:
        """Restore what `save` wrote. Nothing in the files runs as code.

        Raises:
            InputError: If an episode is invalid.
            OSError: If a file cannot be read.
            ValueError: If the files do not fit the configuration.
        """
        path, algorithm = folder / "learner.pt", self.config.algorithm
        state = read_tensors(path, "a checkpoint")
        if not isinstance(state, dict) or (state.get("checkpoint"), state.get("algorithm")) != (CHECKPOINT, algorithm):
            raise ValueError(f"{path} is not a checkpoint of `{algorithm}` that this version can read")
        self.load_state(state)
        self._curves.begin(self.steps)

    def close(self) -> None:
        """Close the training curves and what subclasses open."""
        self._curves.close()
