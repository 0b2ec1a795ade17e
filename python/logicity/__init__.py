"""A city of cars and pedestrians governed by Datalog rules, for neuro-symbolic research.

`check` finds the faults of a rule text; `Inference` answers what the rules decide in a scene.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, TypedDict, cast

import gymnasium

from . import _logicity
from ._logicity import __version__

if TYPE_CHECKING:
    from typing import NotRequired  # Python 3.11; only annotations use it

    from .parallel import SPFParallelEnv

__all__ = [
    "ENVIRONMENTS",
    "MODES",
    "Agent",
    "Answer",
    "Benchmark",
    "Demonstrations",
    "Diagnostic",
    "EgoAnswer",
    "EpisodeRecord",
    "Evaluation",
    "Inference",
    "InputError",
    "Interval",
    "Label",
    "Policy",
    "Scene",
    "SymbolicScene",
    "Trajectory",
    "__version__",
    "check",
    "demonstrations",
    "evaluate",
    "parallel_env",
]

#: The modes of Safe Path Following as environments are named, and their configurations.
MODES = {
    "Easy": "easy",
    "Medium": "medium",
    "Hard": "hard",
    "Expert": "expert",
    "TransferEasy": "transfer-easy",
    "TransferMedium": "transfer-medium",
    "TransferHard": "transfer-hard",
}

Action = Literal["Slow", "Normal", "Fast", "Stop"]


class Label(TypedDict):
    """A place in a text and what to say there. Lines and columns count from 1."""

    file: str
    line: int
    column: int
    end_line: int
    end_column: int
    message: str
    primary: bool


class Diagnostic(TypedDict):
    """One fault: `code` is its stable name, the first of `labels` its place."""

    code: str
    severity: Literal["error", "warning"]
    message: str
    labels: list[Label]
    notes: list[str]
    help: list[str]


class Agent(TypedDict):
    """An agent of a scene; `at` is [row, column] in cells."""

    id: str
    type: Literal["Car", "Pedestrian"]
    at: tuple[int, int] | list[int]
    heading: NotRequired[Literal["Left", "Right", "Up", "Down"] | None]
    concepts: NotRequired[list[str]]
    priority: NotRequired[int]


class Scene(TypedDict):
    """Agents on a map.

    `egos` are the agents to decide for (default: all); `given` replaces the computed atoms of a predicate; `tick`
    (default 0) tells apart the random draws of one seed.
    """

    map: str
    agents: list[Agent]
    egos: NotRequired[list[str]]
    given: NotRequired[dict[str, list[Any]]]
    tick: NotRequired[int]


class SymbolicScene(TypedDict):
    """Entities and the facts that are true of them."""

    entities: list[str]
    ego: str
    facts: NotRequired[dict[str, list[Any]]]


class EgoAnswer(TypedDict):
    """What an ego sees (itself first), the true atoms over that, the actions derived before the default, the action."""

    sees: list[str]
    true: dict[str, list[Any]]
    derived: list[Action]
    action: Action


class Answer(TypedDict):
    """What the rules decide, by ego."""

    egos: dict[str, EgoAnswer]


class InputError(ValueError):
    """Faulty input. `diagnostics` holds every fault with its place."""

    def __init__(self, message: str, diagnostics: list[Diagnostic]) -> None:
        """Keep the drawn message and the diagnostics."""
        super().__init__(message)
        self.diagnostics = diagnostics


def _input_error(error: _logicity.InputError) -> InputError:
    message, diagnostics = error.args
    return InputError(message, json.loads(diagnostics))


@contextmanager
def _told() -> Iterator[None]:
    """Raise faults of the input as `InputError`."""
    try:
        yield
    except _logicity.InputError as error:
        raise _input_error(error) from None


def check(text: str, name: str = "<text>") -> list[Diagnostic]:
    """Find all faults and warnings of a rule text.

    `name` is the file name shown in the diagnostics; `.include` is relative to its folder. An empty list means that
    there is nothing to say against the rules.
    """
    return cast(list[Diagnostic], json.loads(_logicity.check(text, name)))


class Inference:
    """Answers what the rules decide in scenes.

    `config` is a run configuration: a path, or a built-in one such as `configs/expert.yaml`. `rules` is a rule file
    instead of the configuration's. `seed`, from 0 to 2**64 - 1, is for predicates that hold with a probability and are
    not given.

    Raises `InputError` for a faulty configuration or rule file and `OSError` for one that cannot be read.
    """

    def __init__(
        self,
        config: str | os.PathLike[str] = "configs/expert.yaml",
        rules: str | os.PathLike[str] | None = None,
        seed: int = 0,
    ) -> None:
        """Load the configuration and the rules."""
        try:
            self._inference = _logicity.Inference(config, rules, seed)
        except _logicity.InputError as error:
            raise _input_error(error) from None

    def answer(self, scene: Scene | SymbolicScene) -> Answer:
        """Decide a scene. Raises `InputError` if it is faulty or too large, or the rules derive too much from it."""
        try:
            return cast(Answer, json.loads(self._inference.answer(json.dumps(scene))))
        except _logicity.InputError as error:
            raise _input_error(error) from None


def parallel_env(config: str | os.PathLike[str] = "expert", **arguments: Any) -> SPFParallelEnv:
    """Make a `ParallelEnv` of PettingZoo in which every car is driven: a `logicity.parallel.SPFParallelEnv`.

    `arguments` are its other parameters. Needs `pip install 'logicity[pettingzoo]'`.
    """
    from .parallel import SPFParallelEnv

    return SPFParallelEnv(config, **arguments)


def _register() -> None:
    for mode, config in MODES.items():
        gymnasium.register(
            f"logicity/SPF-{mode}-v0",
            entry_point="logicity.envs:SPFEnv",
            vector_entry_point="logicity.envs:SPFVectorEnv",
            kwargs={"config": config},
        )


_register()

# They use what is above, and environments that are registered.
from .evaluation import ENVIRONMENTS, Benchmark, EpisodeRecord, Evaluation, Interval, Policy, evaluate  # noqa: E402
from .offline import Demonstrations, Trajectory, demonstrations  # noqa: E402
