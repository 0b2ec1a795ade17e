"""Decisions of the rules, in single scenes and in a running city."""

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
"""The actions. Arrays hold their positions, 0 to 3."""

HEADINGS: tuple[Heading, ...] = cast("tuple[Heading, ...]", tuple(_logicity.HEADINGS))
"""The headings. Arrays hold their positions, 0 to 3, and -1 for an agent that has not moved on its route yet."""

REASONS: tuple[str, ...] = tuple(_logicity.REASONS)
"""The reasons for an agent's move. Arrays hold their positions.

The rules decided it; the route allowed no other move; none of several possible moves had the decided speed, and one was
drawn; the agent rests at its goal.
"""


#: An action: its name, or its position in `ACTIONS`.
_Act: TypeAlias = str | SupportsIndex

#: The keys of one mapping: names or positions of agents. Mappings are invariant in their keys, hence a type variable.
_Named = TypeVar("_Named", bound=str | SupportsIndex)


class Inference:
    """Decides scenes by the rules.

    Pickling and copying store the texts that were read, so a copy reads no file. Not thread-safe: concurrent use raises
    `RuntimeError`.

    Args:
        config: A run configuration: a path, or a built-in one such as `configs/expert.yaml` or `expert`.
        rules: A rule file that replaces the configuration's.
        seed: From 0 to 2**64 - 1, for predicates that hold with a probability and are not given.
        executor: The executor of the rules. Answers are the same.

    Raises:
        InputError: A faulty configuration or rule file. `UnsupportedError`: `executor="dense"` cannot evaluate the
            rules.
        OSError: A file cannot be read.
        OverflowError: A seed out of range.
        ValueError: An unknown executor.
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
        """Pickle the texts."""
        return type(self)._restore, (self._made_of, dict(self._inference.files()))

    def answer(self, scene: Scene | SymbolicScene) -> Answer:
        """Decide a scene.

        Args:
            scene: Agents on a map, or entities and facts.

        Raises:
            InputError: A faulty scene. `LimitError`: a scene that is too large, or rules that derive too much from it.
            TypeError: The scene holds a value that JSON cannot represent.
        """
        return cast(Answer, self._inference.answer(json.dumps(scene)))


def infer(
    scene: Scene | SymbolicScene,
    config: str | os.PathLike[str] = "configs/expert.yaml",
    rules: str | os.PathLike[str] | None = None,
    seed: int = 0,
    executor: Executor = "auto",
) -> Answer:
    """Decide one scene. For several scenes make an `Inference`, which reads its files once.

    Args:
        scene: As for `Inference.answer`.
        config: As for `Inference`.
        rules: As for `Inference`.
        seed: As for `Inference`.
        executor: As for `Inference`.

    Raises:
        InputError: As for `Inference` and `Inference.answer`.
        OSError: As for `Inference`.
        OverflowError: As for `Inference`.
        TypeError: As for `Inference.answer`.
        ValueError: As for `Inference`.
    """
    return Inference(config, rules, seed, executor).answer(scene)


@dataclass(frozen=True)
class AgentInfo:
    """The constant properties of an agent. A smaller priority has the right of way."""

    name: str
    type: str
    concepts: tuple[str, ...]
    priority: int


@dataclass(frozen=True, eq=False)
class Tick:
    """The events of a tick. Rows are agents, in the order of `Simulation.agents`.

    Attributes:
        tick: Number of the tick, from 0.
        at: int32 (n, 2): row and column in cells when the agents decided.
        heading: int8 (n,): heading then, a position in `HEADINGS`, or -1.
        derived: bool (n, 4): the actions that the rules derived, before the default, in the order of `ACTIONS`.
        action: int8 (n,): the action taken, by the rules or by control, a position in `ACTIONS`.
        next: int32 (n, 2): row and column after the move.
        reason: int8 (n,): the reason for the move, a position in `REASONS`.
        replanned: bool (n,): whether the agent set out for a new goal.
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
    """An explanation of an agent's action in a tick, or of why another action was not derived.

    Attributes:
        derived: The derived actions, before the default.
        explanations: An entry for each explained action, with its `action` and, if a rule mentions it, its `nodes`,
            which are those of `Explanation`.
        text: The explanation for readers, also `str()`.
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
        """Return the text."""
        return self.text


class Simulation:
    """A running city. The same configuration, rules, split, seed and controls give the same ticks.

    Not thread-safe: concurrent use raises `RuntimeError`. Long calls release the GIL. Ctrl-C ends `run` after the
    current tick. A simulation cannot be pickled or copied; one made with the same arguments gives the same ticks.

    Args:
        config: A run configuration: a path, or a built-in one such as `configs/expert.yaml` or `expert`.
        rules: A rule file that replaces the configuration's.
        split: The agents: `"train"`, `"val"` or `"test"`.
        seed: From 0 to 2**64 - 1.
        threads: Threads for a city of more than 256 agents; 0 means one for each core. Ticks are the same.
        executor: The executor of the rules. Ticks are the same.
        count_firings: Whether to count the firings of clauses; see `firings`, and `run` for traces.

    Raises:
        InputError: A faulty configuration or rule file, a split that the configuration does not have, or agents that
            have no room on the map. `LimitError`: too many agents or threads. `UnsupportedError`: `executor="dense"`
            cannot evaluate the rules.
        OSError: A file cannot be read.
        OverflowError: A seed or number of threads out of range.
        ValueError: An unknown split or executor.
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
        """Refuse to pickle and to copy."""
        raise TypeError(
            "a Simulation cannot be pickled or copied: make another with the same arguments, "
            "and give it the same controls in as many ticks"
        )

    def __repr__(self) -> str:
        """Show configuration, split, seed and time."""
        return f"<Simulation {self._config}, split {self._split}, seed {self._seed}, after {self.now} ticks>"

    @property
    def now(self) -> int:
        """Ticks since the start of the run."""
        return self._city.now()

    @property
    def executor(self) -> Executor:
        """The executor in use: `"dense"` or `"relational"`."""
        return cast(Executor, self._city.executor())

    @property
    def map_name(self) -> str:
        """The name of the map."""
        return self._city.map()[0]

    @property
    def map_shape(self) -> tuple[int, int]:
        """Rows and columns of the map, in cells."""
        _, rows, columns = self._city.map()
        return rows, columns

    @cached_property
    def agents(self) -> tuple[AgentInfo, ...]:
        """The agents, in the order of rows of arrays."""
        return tuple(
            AgentInfo(name, kind, tuple(concepts), priority) for name, kind, concepts, priority in self._city.agents()
        )

    @cached_property
    def _index(self) -> dict[str, int]:
        return {agent.name: position for position, agent in enumerate(self.agents)}

    @property
    def positions(self) -> npt.NDArray[np.int32]:
        """The current positions: int32 (n, 2), row and column in cells. A copy."""
        return self._city.positions()

    @property
    def goals(self) -> npt.NDArray[np.int32]:
        """The current goals: int32 (n, 2), row and column in cells. A copy."""
        return self._city.goals()

    @property
    def headings(self) -> npt.NDArray[np.int8]:
        """The directions of the last moves: int8 (n,), positions in `HEADINGS`, or -1 before the first. A copy."""
        return self._city.headings()

    @property
    def actions(self) -> npt.NDArray[np.int8]:
        """The actions of the last tick: int8 (n,), positions in `ACTIONS`; Stop before the first. A copy."""
        return self.last.action

    @property
    def last(self) -> Tick:
        """The last tick; before the first one, agents that rest."""
        return Tick(*self._city.last())

    def tick(self, controls: Mapping[str | SupportsIndex, _Act] | Mapping[_Named, _Act] | None = None) -> Tick:
        """Let every agent decide, then move all agents.

        Args:
            controls: Actions that replace those of the rules, by agent. Agents are names or positions in `agents`,
                actions are names or positions in `ACTIONS`: `{"Car_1": "Stop"}`, `{0: 3}`.

        Raises:
            KeyError: An unknown agent.
            LimitError: The rules derive too much, or too many agents are in one place. The city is unchanged.
            TypeError: An agent or action that is neither str nor int.
            ValueError: An unknown action.
        """
        given: Mapping[Any, _Act] = {} if controls is None else controls
        return Tick(*self._city.tick([(self._agent(agent), _action(action)) for agent, action in given.items()]))

    def run(self, ticks: int, *, trace: str | os.PathLike[str] | None = None) -> None:
        """Run a number of ticks in one call.

        Args:
            ticks: The number of ticks, from 0.
            trace: A file for the trace of these ticks, which `logicity explain` and `logicity check --coverage` read.
                It appears when it is complete, also after an exception. A trace records firings, so it needs
                `count_firings`.

        Raises:
            KeyboardInterrupt: Ctrl-C. The city is as after the last complete tick.
            LimitError: As for `tick`, or too many agents for a trace.
            OSError: The trace cannot be written.
            OverflowError: A negative number of ticks.
            ValueError: A trace without counted firings.
        """
        if trace is not None and not self._counts:
            raise ValueError("a trace records which clauses fired: make the Simulation with count_firings=True")
        self._city.run(ticks, trace)

    def semantic_map(self) -> npt.NDArray[np.float32]:
        """Return the current state as float32 (rows, columns, 8 + n), each value 0 or 1.

        Layers 0 to 7 are walking street, traffic street, crossing, house, office, garage, store and gas station; a cell
        has at most one. Layer 8 + i is 1 in the cell of agent i.

        Raises:
            LimitError: The array would have too many values.
        """
        return self._city.semantic_map()

    def facts(self) -> dict[str, list[tuple[str, ...]]]:
        """Return the base facts of the last tick (before the first: the current ones), as names of agents.

        Raises:
            LimitError: Too many agents for facts about pairs.
        """
        names = [agent.name for agent in self.agents]
        return {
            predicate: [tuple(names[agent] for agent in row) for row in rows.tolist()]
            for predicate, rows in self.fact_indices().items()
        }

    def fact_indices(self) -> dict[str, npt.NDArray[np.int32]]:
        """Return the same facts as positions of agents: int32 of shape (rows, columns of the predicate).

        Raises:
            LimitError: Too many agents for facts about pairs.
        """
        return self._city.facts()

    @property
    def firings(self) -> list[tuple[str, int]]:
        """The clauses by label, with the rows each derived in the last tick. Empty without `count_firings`."""
        return self._city.firings()

    def explain(self, agent: str | int) -> Decision:
        """Explain an agent's action in the last tick; before the first, the action that the rules derive now.

        Raises:
            KeyError: An unknown agent.
            LimitError: Too many agents, or the search for an explanation takes too many steps.
        """
        return self._decision(agent, None)

    def why_not(self, agent: str | int, action: Action | int) -> Decision:
        """Explain why an action was not derived for an agent in the last tick, or why it was.

        Raises:
            KeyError: An unknown agent.
            LimitError: As for `explain`.
            ValueError: An unknown action.
        """
        return self._decision(agent, _action(action))

    def _decision(self, agent: str | int, why_not: int | None) -> Decision:
        text, data = self._city.explain(self._agent(agent), why_not)
        data["at"], data["derived"] = tuple(data["at"]), tuple(data["derived"])
        return Decision(text=text, **data)

    def _agent(self, agent: str | SupportsIndex) -> int:
        if isinstance(agent, str):
            if (position := self._index.get(agent)) is not None:
                return position
            raise KeyError(f"unknown agent `{agent}`{did_you_mean(agent, self._index)}")
        if not 0 <= index(agent) < len(self.agents):
            raise KeyError(f"unknown agent {agent}: expected 0 to {len(self.agents) - 1}")
        return index(agent)


def _action(action: _Act) -> int:
    if isinstance(action, str):
        if action in ACTIONS:
            return ACTIONS.index(action)
    elif not isinstance(action, bool) and 0 <= index(action) < len(ACTIONS):
        return index(action)
    raise ValueError(f"{action!r} is no action{did_you_mean(action, ACTIONS)}")
