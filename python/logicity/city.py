"""What the rules decide: in single scenes, and in a city that runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import index
from typing import Any, NoReturn, SupportsIndex, TypeAlias, TypeVar, cast

import numpy as np
import numpy.typing as npt

from . import _logicity
from .errors import did_you_mean
from .rules import rule_file
from .types import Action, Answer, Executor, Heading, Scene, Split, SymbolicScene

__all__ = ["ACTIONS", "HEADINGS", "REASONS", "AgentInfo", "Decision", "Inference", "Simulation", "Tick", "infer"]

ACTIONS: tuple[Action, ...] = cast("tuple[Action, ...]", tuple(_logicity.ACTIONS))
"""The actions; arrays hold their positions, 0 to 3."""

HEADINGS: tuple[Heading, ...] = cast("tuple[Heading, ...]", tuple(_logicity.HEADINGS))
"""The headings; arrays hold their positions, 0 to 3, and -1 for an agent that has not moved on its route yet."""

REASONS: tuple[str, ...] = tuple(_logicity.REASONS)
"""Why an agent moved as it did; arrays hold their positions.

It was decided so; the route allowed no other move; several moves were possible, none of the decided speed, and one
was drawn; it rests at its goal."""


#: What an action is given by: its name, or its position in `ACTIONS`.
_Act: TypeAlias = str | SupportsIndex

#: What agents are named by in one mapping. Mappings are not covariant in their keys: this lets each have its own.
_Named = TypeVar("_Named", bound=str | SupportsIndex)


class Inference:
    """Answers what the rules decide in scenes.

    Can be pickled and copied: it is made again from the texts that were read, without reading a file. One thread at a
    time: a second one gets a `RuntimeError`.

    Parameters
    ----------
    config
        A run configuration: a path, or a built-in one such as `configs/expert.yaml` or `expert`.
    rules
        A rule file instead of the configuration's.
    seed
        From 0 to 2**64 - 1, for predicates that hold with a probability and are not given.
    executor
        What evaluates the rules. Answers are the same.

    Raises
    ------
    InputError
        For a faulty configuration or rule file; `LimitError` for rules that `executor="dense"` cannot evaluate.
    OSError
        For a file that cannot be read.
    OverflowError
        For a seed out of range.
    ValueError
        For an unknown executor.

    """

    def __init__(
        self,
        config: str | os.PathLike[str] = "configs/expert.yaml",
        rules: str | os.PathLike[str] | None = None,
        seed: int = 0,
        executor: Executor = "auto",
    ) -> None:
        """Load the configuration and the rules."""
        self._made_of: tuple[str, str | None, int, str]
        self._made_of = (os.fspath(config), rule_file(rules), seed, executor)
        self._inference = _logicity.Inference(*self._made_of, None)

    @classmethod
    def _restore(cls, made_of: tuple[str, str | None, int, str], files: dict[Any, str]) -> Inference:
        inference = cls.__new__(cls)
        inference._made_of = made_of
        inference._inference = _logicity.Inference(*made_of, files)
        return inference

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the texts."""
        return type(self)._restore, (self._made_of, dict(self._inference.files()))

    def answer(self, scene: Scene | SymbolicScene) -> Answer:
        """Decide a scene.

        Raises `InputError` if it is faulty, `LimitError` if it is too large or the rules derive too much from it, and
        `TypeError` if it holds what JSON has no form for.
        """
        return cast(Answer, self._inference.answer(json.dumps(scene)))


def infer(
    scene: Scene | SymbolicScene,
    config: str | os.PathLike[str] = "configs/expert.yaml",
    rules: str | os.PathLike[str] | None = None,
    seed: int = 0,
    executor: Executor = "auto",
) -> Answer:
    """Decide one scene. For many, make an `Inference`, which reads its files once and raises the same."""
    return Inference(config, rules, seed, executor).answer(scene)


@dataclass(frozen=True)
class AgentInfo:
    """What does not change of an agent; a smaller priority goes first."""

    name: str
    type: str
    concepts: tuple[str, ...]
    priority: int


@dataclass(frozen=True, eq=False)
class Tick:
    """What happened in a tick; rows are agents, in the order of `Simulation.agents`.

    Attributes
    ----------
    tick
        Number of the tick, from 0.
    at
        int32 (n, 2): row and column in cells where each was when it decided.
    heading
        int8 (n,): its heading then, a position in `HEADINGS`, or -1.
    derived
        bool (n, 4): the actions that the rules derived, before the default, in the order of `ACTIONS`.
    action
        int8 (n,): what it did, a position in `ACTIONS`: by the rules, or from outside.
    next
        int32 (n, 2): where it went.
    reason
        int8 (n,): why it went there, a position in `REASONS`.
    replanned
        bool (n,): whether it set out for a new goal.

    """

    tick: int
    at: npt.NDArray[np.int32]
    heading: npt.NDArray[np.int8]
    derived: npt.NDArray[np.bool_]
    action: npt.NDArray[np.int8]
    next: npt.NDArray[np.int32]
    reason: npt.NDArray[np.int8]
    replanned: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Decision:
    """Why an agent did what it did in a tick, or why another action was not derived.

    `text` (and `str()`) is for readers. `derived` are the actions derived before the default; `explanations` has an
    entry for each action that is spoken of, with its `action` and, unless the rules do not mention it, its `nodes`,
    which are those of `Explanation`.
    """

    tick: int
    agent: str
    at: tuple[int, int]
    heading: Heading | None
    derived: tuple[Action, ...]
    action: Action
    explanations: list[dict[str, Any]]
    text: str

    def __str__(self) -> str:
        """Tell it for readers."""
        return self.text


class Simulation:
    """A city in motion. The same configuration, rules, split, seed and controls give the same ticks.

    One thread at a time: a second one gets a `RuntimeError`. Long work lets other threads of Python run, and `run`
    ends on Ctrl-C after the tick at hand. Simulations cannot be pickled or copied; make another with the same
    arguments, which goes the same way.

    Parameters
    ----------
    config
        A run configuration: a path, or a built-in one such as `configs/expert.yaml` or `expert`.
    rules
        A rule file instead of the configuration's.
    split
        Whose agents: `"train"`, `"val"` or `"test"`.
    seed
        From 0 to 2**64 - 1.
    threads
        How many a city of more than 256 agents uses; 0 is one for each core. Ticks are the same.
    executor
        What evaluates the rules. Ticks are the same.
    count_firings
        Whether it is counted which clauses fire; see `firings`, and `run` for traces.

    Raises
    ------
    InputError
        For a faulty configuration or rule file, a split that the configuration does not have, or agents that have no
        room on the map; `LimitError` for more agents or threads, or other rules, than can be.
    OSError
        For a file that cannot be read.
    OverflowError
        For a seed or number of threads out of range.
    ValueError
        For an unknown split or executor.

    """

    def __init__(
        self,
        config: str | os.PathLike[str] = "configs/expert.yaml",
        rules: str | os.PathLike[str] | None = None,
        split: Split = "test",
        seed: int = 0,
        threads: int = 1,
        executor: Executor = "auto",
        *,
        count_firings: bool = False,
    ) -> None:
        """Place the agents."""
        self._config, self._split, self._seed = os.fspath(config), split, seed
        self._counts = count_firings
        self._city = _logicity.Simulation(config, rule_file(rules), split, seed, threads, executor, count_firings)

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied."""
        raise TypeError(
            "a Simulation cannot be pickled or copied: make another with the same arguments, "
            "and give it the same controls in as many ticks"
        )

    def __repr__(self) -> str:
        """Tell configuration, split, seed and time."""
        return f"<Simulation {self._config}, split {self._split}, seed {self._seed}, after {self.now} ticks>"

    @property
    def now(self) -> int:
        """How many ticks have passed."""
        return self._city.now()

    @property
    def executor(self) -> Executor:
        """What evaluates the rules: `"dense"` or `"relational"`."""
        return cast(Executor, self._city.executor())

    @property
    def map_name(self) -> str:
        """Name of the map."""
        return self._city.map()[0]

    @property
    def map_shape(self) -> tuple[int, int]:
        """Rows and columns of the map, in cells."""
        _, rows, columns = self._city.map()
        return rows, columns

    @cached_property
    def agents(self) -> tuple[AgentInfo, ...]:
        """The agents; the rows of arrays are in this order."""
        return tuple(
            AgentInfo(name, kind, tuple(concepts), priority) for name, kind, concepts, priority in self._city.agents()
        )

    @cached_property
    def _index(self) -> dict[str, int]:
        return {agent.name: position for position, agent in enumerate(self.agents)}

    @property
    def positions(self) -> npt.NDArray[np.int32]:
        """Where the agents are now: int32 (n, 2), row and column in cells. A copy."""
        return self._city.positions()

    @property
    def goals(self) -> npt.NDArray[np.int32]:
        """Where the agents are going: int32 (n, 2), row and column in cells. A copy."""
        return self._city.goals()

    @property
    def headings(self) -> npt.NDArray[np.int8]:
        """The directions of their last moves: int8 (n,), positions in `HEADINGS`; a copy.

        -1 stands for an agent that has not moved on its route yet.
        """
        return self._city.headings()

    @property
    def actions(self) -> npt.NDArray[np.int8]:
        """What they did in the last tick: int8 (n,), positions in `ACTIONS`; a copy. Before the first all stop."""
        return self.last.action

    @property
    def last(self) -> Tick:
        """The last tick; before the first, agents that rest."""
        return Tick(*self._city.last())

    def tick(self, controls: Mapping[str | SupportsIndex, _Act] | Mapping[_Named, _Act] | None = None) -> Tick:
        """Let every agent decide, then all move.

        Parameters
        ----------
        controls
            Agents, by name or by position in `agents`, that do not do what the rules say but this action, given by
            name or by position in `ACTIONS`: `{"Car_1": "Stop"}`, `{0: 3}`.

        Raises
        ------
        KeyError
            For an unknown agent.
        ValueError
            For an unknown action.
        TypeError
            For an agent or action that is neither str nor int.
        LimitError
            If the rules derive too much, or too many agents are in one place. The city is then as before.

        """
        given: Mapping[Any, _Act] = {} if controls is None else controls
        return Tick(*self._city.tick([(self._agent(agent), _action(action)) for agent, action in given.items()]))

    def run(self, ticks: int, *, trace: str | os.PathLike[str] | None = None) -> None:
        """Go on for so many ticks, in one call.

        Parameters
        ----------
        ticks
            How many, from 0 on.
        trace
            A file for the trace of these ticks, which `logicity explain` and `logicity check --coverage` read. It
            appears when it is complete; what was run before an exception is in it. A trace tells which clauses fired,
            so `count_firings` must have been set.

        Raises
        ------
        ValueError
            For a trace without counted firings.
        OSError
            For a trace that cannot be written.
        LimitError
            As `tick`; or if there are too many agents for a trace.
        OverflowError
            For a negative number of ticks.
        KeyboardInterrupt
            On Ctrl-C. The city stays as it is after the last tick that was complete.

        """
        if trace is not None and not self._counts:
            raise ValueError("a trace tells which clauses fired: make the Simulation with count_firings=True")
        self._city.run(ticks, trace)

    def semantic_map(self) -> npt.NDArray[np.float32]:
        """Draw the present state as float32 (rows, columns, 8 + n), each value 0 or 1.

        Layers 0 to 7 are walking street, traffic street, crossing, house, office, garage, store and gas station, of
        which a cell has at most one; layer 8 + i is 1 in the cell of agent i.
        """
        return self._city.semantic_map()

    def facts(self) -> dict[str, list[tuple[str, ...]]]:
        """Tell the base facts on which the last tick was decided (before the first: those of now), as names of agents.

        Raises `LimitError` if there are too many agents for facts about pairs of them.
        """
        names = [agent.name for agent in self.agents]
        return {
            predicate: [tuple(names[agent] for agent in row) for row in rows.tolist()]
            for predicate, rows in self.fact_indices().items()
        }

    def fact_indices(self) -> dict[str, npt.NDArray[np.int32]]:
        """Tell the same as positions of agents: int32 of shape (rows, columns of the predicate)."""
        return self._city.facts()

    @property
    def firings(self) -> list[tuple[str, int]]:
        """The clauses by their labels, and how many rows each derived in the last tick.

        Empty unless `count_firings` was set.
        """
        return self._city.firings()

    def explain(self, agent: str | int) -> Decision:
        """Tell why an agent did what it did in the last tick; before the first, why the rules want what they want now.

        Raises `KeyError` for an unknown agent, and `LimitError` if there are too many agents or the search for an
        explanation takes too many steps.
        """
        return self._decision(agent, None)

    def why_not(self, agent: str | int, action: Action | int) -> Decision:
        """Tell why an action was not derived for an agent in the last tick, or why it was.

        Raises what `explain` raises, and `ValueError` for an unknown action.
        """
        return self._decision(agent, _action(action))

    def _decision(self, agent: str | int, why_not: int | None) -> Decision:
        text, told = self._city.explain(self._agent(agent), why_not)
        told["at"], told["derived"] = tuple(told["at"]), tuple(told["derived"])
        return Decision(text=text, **told)

    def _agent(self, agent: str | SupportsIndex) -> int:
        if isinstance(agent, str):
            if (position := self._index.get(agent)) is not None:
                return position
            raise KeyError(f"there is no agent `{agent}`{did_you_mean(agent, self._index)}")
        if not 0 <= index(agent) < len(self.agents):
            raise KeyError(f"there is no agent {agent}; there are {len(self.agents)}, from 0 on")
        return index(agent)


def _action(action: _Act) -> int:
    if isinstance(action, str):
        if action in ACTIONS:
            return ACTIONS.index(action)
    elif not isinstance(action, bool) and 0 <= index(action) < len(ACTIONS):
        return index(action)
    raise ValueError(f"{action!r} is no action{did_you_mean(action, ACTIONS)}")
