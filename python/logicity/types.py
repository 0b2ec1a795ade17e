"""The types of inputs and outputs: diagnostics, scenes, answers, clauses, statistics of commits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypedDict

if TYPE_CHECKING:
    from typing import NotRequired  # Python 3.11; only annotations use it

__all__ = [
    "Action",
    "Agent",
    "Answer",
    "Clause",
    "Diagnostic",
    "EgoAnswer",
    "Executor",
    "Heading",
    "Label",
    "RuleStats",
    "Scene",
    "Split",
    "StratumStats",
    "SymbolicScene",
]

Action = Literal["Slow", "Normal", "Fast", "Stop"]
"""The actions of an agent. Cars move 1, 2, 3 or 0 cells in a tick."""

Heading = Literal["Left", "Right", "Up", "Down"]
"""A direction on the map. Up is towards row 0, left towards column 0."""

Split = Literal["train", "val", "test"]
"""The sets of agents of a configuration."""

Executor = Literal["auto", "dense", "relational"]
"""The executor of the rules. Answers are the same. `auto` is `dense` (bits) if it can evaluate the rules, or else
`relational`.
"""


class Label(TypedDict):
    """A place in a text, with a message. Lines and columns count from 1."""

    file: str
    line: int
    column: int
    end_line: int
    end_column: int
    message: str
    primary: bool


class Diagnostic(TypedDict):
    """One fault or warning. `code` is its stable name, the first of `labels` its place."""

    code: str
    severity: Literal["error", "warning"]
    message: str
    labels: list[Label]
    notes: list[str]
    help: list[str]


class Agent(TypedDict):
    """An agent of a scene. `at` is [row, column] in cells."""

    id: str
    type: Literal["Car", "Pedestrian"]
    at: tuple[int, int] | list[int]
    heading: NotRequired[Heading | None]
    concepts: NotRequired[list[str]]
    priority: NotRequired[int]


class Scene(TypedDict):
    """Agents on a map.

    Attributes:
        egos: The agents to decide for (default: all).
        given: Atoms that replace the computed atoms of a predicate, by predicate.
        tick: The tick, which selects the random draws (default 0).
    """

    map: str
    agents: list[Agent]
    egos: NotRequired[list[str]]
    given: NotRequired[dict[str, list[Any]]]
    tick: NotRequired[int]


class SymbolicScene(TypedDict):
    """Entities and the facts that hold."""

    entities: list[str]
    ego: str
    facts: NotRequired[dict[str, list[Any]]]


class EgoAnswer(TypedDict):
    """The answer for one ego.

    Attributes:
        sees: The entities in its view, itself first.
        true: The true atoms over these entities, by predicate.
        derived: The derived actions, before the default.
        action: The action taken.
    """

    sees: list[str]
    true: dict[str, list[Any]]
    derived: list[Action]
    action: Action


class Answer(TypedDict):
    """The decisions of the rules, by ego."""

    egos: dict[str, EgoAnswer]


class Clause(TypedDict):
    """A clause or fact of a program.

    Attributes:
        label: The text before the colon of its doc comment, such as `S2`, or else `file:line`.
        head: The predicate of its head.
    """

    label: str
    head: str
    text: str
    doc: str
    file: str
    line: int
    column: int


class RuleStats(TypedDict):
    """The work of a clause in a commit.

    Attributes:
        delta_rows: Changed rows it was evaluated from (0: one evaluation over all rows).
        rows_scanned: Rows that its scans and tests read.
        derived: Rows it derived, including repeated ones.
    """

    clause: str
    delta_rows: int
    rows_scanned: int
    derived: int


class StratumStats(TypedDict):
    """The work of a commit on a stratum. `rounds` is 1 if the stratum is not recursive."""

    relations: list[str]
    how: Literal["skipped", "maintained", "recomputed"]
    rounds: int
    rows_scanned: int
    clauses: list[RuleStats]
