"""The types of inputs and outputs: diagnostics, scenes, answers, clauses, commits, environments and episodes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypedDict

if TYPE_CHECKING:
    from typing import NotRequired  # Python 3.11; only annotations use it

Action = Literal["Slow", "Normal", "Fast", "Stop"]
"""The actions of an agent. Cars move 1, 2, 3 or 0 cells per tick, respectively."""

Heading = Literal["Left", "Right", "Up", "Down"]
"""A direction on the map. Up is toward row 0, and left is toward column 0."""

Split = Literal["train", "val", "test"]
"""The sets of agents of a configuration."""

Executor = Literal["auto", "dense", "relational"]
"""The executor of the rules, which does not affect the results. `auto` is `dense` (bit sets) if the dense executor can
evaluate the rules, and `relational` otherwise. In a city, it evaluates clauses that `dense` does not support with
`relational`, and the others with `dense`.
"""


class Limits(TypedDict, total=False):
    """Limits of an evaluation. Missing keys have defaults, which are far more than a city needs.

    The relational executor applies them to each tick or scene. A step limit of an episode is another thing; see
    `patience` in the configuration.
    """

    max_rows: int
    """The number of derived rows. Default: 10,000,000."""
    max_steps: int
    """The number of rows that the evaluation reads. Default: 1,000,000,000."""
    max_bytes: int
    """The memory for rows, indexes, symbols and buffers, in bytes. Default: 4 GiB."""


class Label(TypedDict):
    """A span of a source with a message. Lines and columns start at 1."""

    file: str
    line: int
    column: int
    end_line: int
    end_column: int
    message: str
    primary: bool


class Diagnostic(TypedDict):
    """An error or a warning. `code` is its stable name, and the first of `labels` is its location."""

    code: str
    severity: Literal["error", "warning"]
    message: str
    labels: list[Label]
    notes: list[str]
    help: list[str]


class Agent(TypedDict):
    """An agent of a scene. `at` is [row, column] in cells. A smaller priority has the right of way."""

    id: str
    type: Literal["Car", "Pedestrian"]
    at: tuple[int, int] | list[int]
    heading: NotRequired[Heading | None]
    concepts: NotRequired[list[str]]
    priority: NotRequired[int]


class Scene(TypedDict):
    """Agents on a map.

    Attributes:
        map: The name of the map.
        egos: The names of the agents to decide for. Default: all.
        given: Atoms by predicate, which replace the computed atoms of that predicate.
        tick: The tick, which selects the random numbers of probabilistic predicates. Default: 0.
    """

    map: str
    agents: list[Agent]
    egos: NotRequired[list[str]]
    given: NotRequired[dict[str, list[Any]]]
    tick: NotRequired[int]


class SymbolicScene(TypedDict):
    """Entities, and the facts about them by predicate."""

    entities: list[str]
    ego: str
    facts: NotRequired[dict[str, list[Any]]]
    actions: NotRequired[dict[str, Action]]
    """The actions that entities took, for learners."""
    reason: NotRequired[str]
    """Why a learner asked for the scene."""


class EgoAnswer(TypedDict):
    """The answer for one ego.

    Attributes:
        sees: The entities in the view of the ego, starting with the ego.
        true: The true atoms over these entities, by predicate.
        derived: The derived actions, without the default action.
        action: The selected action.
    """

    sees: list[str]
    true: dict[str, list[Any]]
    derived: list[Action]
    action: Action


class Answer(TypedDict):
    """The answers by ego.

    Attributes:
        fallback: Why the relational executor decided after the dense one gave up; missing if it did not. The answers
            are the same.
    """

    egos: dict[str, EgoAnswer]
    fallback: NotRequired[str]


class Estimate(TypedDict):
    """An estimated probability with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


class EgoMarginals(TypedDict):
    """Probabilities of actions. Impossible ones are absent.

    Attributes:
        derived: The probability that the rules derive each action.
        action: The probability that the ego takes each action; they add up to 1.
    """

    derived: dict[Action, float | Estimate]
    action: dict[Action, float | Estimate]


class MarginalAnswer(TypedDict):
    """The probabilities by ego.

    Attributes:
        because: Why the probabilities are estimates; missing if they are exact.
    """

    egos: dict[str, EgoMarginals]
    exact: bool
    because: NotRequired[str]


class Clause(TypedDict):
    """A clause or fact of a program.

    Attributes:
        label: The text before the colon in the doc comment, such as `S2`, or `file:line` if there is none.
        head: The predicate of the head.
    """

    label: str
    head: str
    text: str
    doc: str
    file: str
    line: int
    column: int


class RuleStats(TypedDict):
    """Statistics of a clause in a commit.

    Attributes:
        clause: The label of the clause.
        delta_rows: The number of changed rows that drove the evaluation; 0 for one evaluation over all rows.
        rows_scanned: The number of rows that scans and tests read.
        derived: The number of derived rows, including duplicates.
    """

    clause: str
    delta_rows: int
    rows_scanned: int
    derived: int


class StratumStats(TypedDict):
    """Statistics of a stratum in a commit.

    Attributes:
        predicates: The predicates of the stratum.
        how: Whether the commit skipped, incrementally maintained or recomputed the stratum.
        rounds: The number of semi-naive rounds: 1 for a stratum without recursion, and 0 if it was skipped.
        rows_scanned: As for `RuleStats`.
    """

    predicates: list[str]
    how: Literal["skipped", "maintained", "recomputed"]
    rounds: int
    rows_scanned: int
    clauses: list[RuleStats]


ArrayKind: TypeAlias = Literal["groundings", "state"]
"""A kind of observation that is one array: truth values of ground atoms, or the exact state."""

ViewKind: TypeAlias = Literal["relational", "graph"]
"""A kind of observation that is a dictionary of arrays, computed from `groundings`. See `logicity.envs.layout`."""

ObservationKind: TypeAlias = Literal[ArrayKind, ViewKind]
"""The kind of observation. See `logicity.envs.SPFEnv`."""

ShieldMode: TypeAlias = Literal["mask", "override", "probabilistic", "joint"]
"""What a shield does with an action that it does not permit. See `logicity.shield`."""

ShieldQuery: TypeAlias = Literal["appropriate", "safe"]
"""What a shield asks about an action. See `logicity.shield`."""

Episodes: TypeAlias = Literal["drawn", "drawn-demanding", "recorded"]
"""The episodes of an environment. See `logicity.envs.SPFEnv`."""


class EnvOptions(TypedDict, total=False):
    """The keyword arguments shared by all environment classes. `SPFEnv` documents them."""

    split: Split
    rules: str | os.PathLike[str] | None
    overrides: Mapping[str, Any] | None
    observation: ObservationKind
    limits: Limits | None
    oracle: bool
    action_masks: bool
    #: `PythonPredicate` objects, whose module needs this one.
    predicates: Iterable[Any] | None


class EpisodeAgent(TypedDict):
    """An agent at the start of an episode. `start` and `goal` are (row, column) in cells."""

    id: str
    concepts: list[str]
    priority: int
    start: tuple[int, int]
    goal: tuple[int, int]


#: The oracle's run of an episode: steps, return, and the number of steps in which the rules require each action.
OracleRun = TypedDict("OracleRun", {"steps": int, "return": float, "constrained": dict[str, int]})


class EpisodeStart(TypedDict):
    """The start of an episode: its seed, its agents in list order, and the oracle's run if it is known.

    A seed is an integer from 0 to 2**64 - 1. The seeds of recorded episodes use all 64 bits, so formats that store
    numbers as 64-bit floats, such as JavaScript's, lose precision.
    """

    seed: int
    agents: list[EpisodeAgent]
    oracle: OracleRun | None


#: A predicate and its arguments, which are numbers of observed entities. Entity 0 is the ego.
Atom: TypeAlias = tuple[str, tuple[int, ...]]
