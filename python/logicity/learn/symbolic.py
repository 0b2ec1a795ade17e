"""Learners of rules: what they share, and the learner of `logicity induce`.

A learner of rules reads the recorded demonstrations once, so it trains in one update. Its policy is a rule file.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal, TypeAlias, cast

from pydantic import Field

from .._logicity import NOISE_MAX, VARIABLES_MAX
from ..files import read_text
from ..induction import induce
from ..offline import Demonstrations
from ..rule_policy import RulePolicy, header, saved_by
from ..types import Atom
from .demonstrations import first_demonstrations
from .learner import LearnedPolicy, Learner, Progress
from .settings import LearnerSettings, Training

__all__ = ["InduceLearner", "InduceSettings", "SymbolicLearner", "SymbolicPolicy", "arities", "clause"]

#: A literal of a body: whether it is negated, its predicate, and its variables. Variable 0 is the ego.
BodyLiteral: TypeAlias = tuple[bool, str, tuple[int, ...]]

#: The variables of printed clauses. Further ones are `V3`, `V4`, ...
VARIABLES = ("X", "Y", "Z")


class SymbolicPolicy(RulePolicy, LearnedPolicy):
    """Rules that a learner found."""

    @classmethod
    def load(cls, path: Path) -> SymbolicPolicy:
        """Read the policy of a learner, whose file names the mode. Raise `InputError` if the rules are invalid."""
        return cls(path, saved_by(path)["mode"])

    def rules(self) -> str:
        """Return the source of the rule file."""
        return self.text


class SymbolicLearner(Learner):
    """A learner of rules, in one step. The result depends on the demonstrations, the settings and the seed only."""

    unit: ClassVar = "updates"
    only_steps = 1
    interacts = False
    suffix = ".dl"
    policy_class = SymbolicPolicy

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Start without rules."""
        super().__init__(config, log)
        self._text: str | None = None

    @abstractmethod
    def rules(self, data: Demonstrations) -> str:
        """Learn from demonstrations, and return the source of a rule file.

        Raises:
            OSError: If another program is missing or fails.
            ValueError: If the settings do not fit the demonstrations.
        """

    @property
    def steps(self) -> int:
        """The number of steps so far: 1 after training."""
        return int(self._text is not None)

    def fit(self, steps: int, progress: Progress) -> None:
        """Learn, unless the rules are known."""
        if self._text is None and steps > 0:
            data = first_demonstrations(self.config.mode, self.config.demonstrations)
            self._text = f"{header(self.config.algorithm, self.config.mode)}\n{self.rules(data)}"
            progress()

    def policy(self) -> SymbolicPolicy:
        """Return the rules. Before training there are none, and the car takes the default action."""
        empty = f'{header(self.config.algorithm, self.config.mode)}\n.include "vocabulary.dl"\n'
        return cast(SymbolicPolicy, SymbolicPolicy.from_text(self._text or empty, self.config.mode))

    def save(self, folder: Path) -> None:
        """Write the rules, if training is over."""
        if self._text is not None:
            (folder / "rules.dl").write_text(self._text, encoding="utf-8", newline="\n")

    def restore(self, folder: Path) -> None:
        """Read the rules. There is no file if training had not ended."""
        self._text, path = None, folder / "rules.dl"
        if not path.exists():
            return
        saved = saved_by(path)
        found, expected = (saved["algorithm"], saved["mode"]), (self.config.algorithm, self.config.mode)
        if found != expected:
            texts = [f"`{algorithm}` for {mode}" for algorithm, mode in (found, expected)]
            raise ValueError(f"{path} has rules of {texts[0]}, not of {texts[1]}")
        self._text = read_text(path)


class InduceSettings(LearnerSettings):
    """The settings of `logicity.induce`, with its defaults."""

    variables: int = Field(default=3, ge=2, le=VARIABLES_MAX)
    """The largest number of variables of a clause."""
    effort: int = Field(default=20_000, ge=1, lt=2**32)
    """The largest number of steps of the search for one clause."""
    noise: Annotated[float, Field(ge=0, le=NOISE_MAX)] | Literal["auto"] | None = None
    """The share of demonstrated actions that may be wrong, from 0 to 0.4, or `auto` to estimate it. By default (null)
    all are right."""


class InduceLearner(SymbolicLearner):
    """`logicity.induce` on the demonstrations."""

    settings_class = InduceSettings

    def rules(self, data: Demonstrations) -> str:
        """Return the induced rules."""
        config = self.config
        return induce(data, config.mode, **config.settings.model_dump(), seed=config.seed, threads=config.threads).text


def clause(head: str, body: Sequence[BodyLiteral]) -> str:
    """Return a clause about the ego in the syntax of rule files.

    A variable that no positive literal binds ranges over what the ego sees, so `Sees` binds it.
    """

    def name(variable: int) -> str:
        return VARIABLES[variable] if variable < len(VARIABLES) else f"V{variable}"

    positive = {variable for negated, _, variables in body if not negated for variable in variables}
    unbound = sorted({0, *(variable for _, _, variables in body for variable in variables)} - positive)
    literals = [f"Sees(X, {name(variable)})" for variable in unbound]
    for negated, predicate, variables in body:
        atom = f"{predicate}({', '.join(map(name, variables))})"
        literals.append(f"Not({atom})" if negated else atom)
    return f"{head}(X) :- {', '.join(literals)}."


def arities(atoms: tuple[Atom, ...]) -> dict[str, int]:
    """Return the predicates of an observation with their arities, in order."""
    return {name: len(entities) for name, entities in atoms}
