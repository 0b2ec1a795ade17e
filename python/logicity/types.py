"""The shapes of what goes in and comes out: diagnostics, scenes, answers, clauses, work logs, explanations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypedDict

if TYPE_CHECKING:
    from typing import NotRequired  # Python 3.11; only annotations use it

__all__ = [
    "Action",
    "Agent",
    "Answer",
    "Clause",
    "ClauseWork",
    "Diagnostic",
    "EgoAnswer",
    "Executor",
    "Heading",
    "Label",
    "Scene",
    "Split",
    "StratumWork",
    "SymbolicScene",
]

Action = Literal["Slow", "Normal", "Fast", "Stop"]
"""What an agent can do: cars go 1, 2, 3 or 0 cells a tick."""

Heading = Literal["Left", "Right", "Up", "Down"]
"""A direction on the map; up is towards row 0, left towards column 0."""

Split = Literal["train", "val", "test"]
"""The sets of agents of a configuration."""

Executor = Literal["auto", "dense", "relational"]
"""What evaluates the rules; answers are the same. `auto` is `dense` (bits) where that can take the rules, else
`relational`."""


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
    heading: NotRequired[Heading | None]
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


class Clause(TypedDict):
    """A clause or fact of a program.

    `label` is what stands before the colon of its doc comment, such as `S2`, else `file:line`; `head` is its predicate.
    """

    label: str
    head: str
    text: str
    doc: str
    file: str
    line: int
    column: int


class ClauseWork(TypedDict):
    """What a clause did in a commit.

    `given` is the number of changed rows it was evaluated from (0: once over all rows), `looked_at` the rows its
    scans and tests looked at, `derived` the rows it derived, repetitions included.
    """

    clause: str
    given: int
    looked_at: int
    derived: int


class StratumWork(TypedDict):
    """What a commit did with predicates that are computed together; `rounds` is 1 if they are not recursive."""

    relations: list[str]
    how: Literal["skipped", "maintained", "recomputed"]
    rounds: int
    looked_at: int
    clauses: list[ClauseWork]
