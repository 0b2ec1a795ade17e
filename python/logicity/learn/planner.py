"""The planner: a search in the environment itself, with a receding horizon.

It learns nothing. At every step it searches for the best actions of the next `horizon` steps in a copy of the city,
takes the first of them, and searches again. The search is exact: it knows the true state, the rules that drive the
others, and the seed of the episode, from which all random draws follow. A way may violate no clause. The rest of a way
that does not reach the goal counts as if the cheapest action moved the ego along it.

So its row beside the oracle shows what foresight is worth: the oracle follows the rules, and the planner chooses among
all actions that they permit.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ..envs.views import Actions, Observations
from .learner import LearnedPolicy, Learner, Progress
from .settings import Count, LearnerSettings, Training
from .storage import StoredPolicy

if TYPE_CHECKING:
    from .. import _logicity

__all__ = ["PlannerLearner", "PlannerPolicy", "PlannerSettings"]


class PlannerSettings(LearnerSettings):
    """The bounds of a search."""

    horizon: Count = 16
    """The number of steps that the planner looks ahead."""
    expansions: Count = 4000
    """The largest number of states that it expands for a decision. A search that reaches it ends with the last step
    that it explores completely."""


class PlannerPolicy(StoredPolicy):
    """A planner with its bounds."""

    algorithm = "planner"
    algorithms = ("planner",)

    def __init__(self, mode: str, settings: PlannerSettings) -> None:
        """Keep the mode and the bounds."""
        self.mode, self.settings = mode, settings
        #: The number of states that all searches have expanded.
        self.expanded = 0

    def plan(self, evaluator: _logicity.BatchEvaluator) -> Actions:
        """Return the actions in the present states of all episodes, int64 of shape (episodes,).

        Raises:
            InputError: If the rules have temporal operators.
            ValueError: If the episodes have several egos.
        """
        actions, expanded = evaluator.planned_actions(self.settings.horizon, self.settings.expansions)
        self.expanded += expanded
        return actions

    def _decide(self, observation: Observations, deterministic: bool) -> Actions:
        raise ValueError("the planner decides on states of the city, not on observations: evaluate it with `evaluate`")

    def config(self) -> dict[str, Any]:
        """Return the mode and the bounds."""
        return {"mode": self.mode, "settings": self.settings.model_dump()}

    @classmethod
    def build(cls, config: dict[str, Any], weights: dict[str, Any]) -> PlannerPolicy:
        """Create the planner of a file."""
        return cls(config["mode"], PlannerSettings.model_validate(config["settings"]))


class PlannerLearner(Learner):
    """The planner as a learner, which is done after one step. The result depends on the settings only."""

    settings_class = PlannerSettings
    unit: ClassVar = "updates"
    only_steps = 1
    interacts = False
    policy_class: ClassVar[type[LearnedPolicy]] = PlannerPolicy
    _settings: PlannerSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Start."""
        super().__init__(config, log)
        self._steps = 0

    @property
    def steps(self) -> int:
        """The number of steps so far: 1 after training."""
        return self._steps

    def fit(self, steps: int, progress: Progress) -> None:
        """Do nothing, once."""
        if self._steps == 0 and steps > 0:
            self._steps = 1
            progress()

    def policy(self) -> PlannerPolicy:
        """Return the planner."""
        return PlannerPolicy(self.config.mode, self._settings)

    def outcome(self) -> dict[str, Any]:
        """Return the bounds."""
        return {"planner": self._settings.model_dump()}

    def state(self) -> dict[str, Any]:
        """Return the number of steps."""
        return {"steps": self._steps}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore the number of steps."""
        self._steps = int(state["steps"])
