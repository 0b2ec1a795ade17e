"""Apply the rules to single scenes and to a running city."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import index
from typing import Any, SupportsIndex, TypeAlias, TypeVar, cast, overload

import numpy as np
import numpy.typing as npt

from . import _logicity
from .errors import checked_integer, checked_limits, checked_path, checked_threads, did_you_mean
from .predicates import PythonPredicate, functions_of
from .rules import Explanation, rule_file
from .types import Action, Answer, Executor, Heading, Limits, MarginalAnswer, Scene, Split, SymbolicScene

__all__ = ["ACTIONS", "HEADINGS", "REASONS", "AgentInfo", "Decision", "Inference", "Simulation", "Tick", "infer"]

ACTIONS: tuple[Action, ...] = cast("tuple[Action, ...]", tuple(_logicity.ACTIONS))
"""The standard actions, which come first in every city. Arrays store an action as its index, 0 to 3."""

HEADINGS: tuple[Heading, ...] = cast("tuple[Heading, ...]", tuple(_logicity.HEADINGS))
"""The headings. Arrays store a heading as its index, 0 to 3, or -1 before the first move of the agent on its route."""

REASONS: tuple[str, ...] = tuple(_logicity.REASONS)
"""The reasons for an agent's move. Arrays store a reason as its index.

In order: the rules decided the move; the route allowed no other move; no possible move had the decided speed, so one
was drawn at random; the agent rests at its goal; the agent is parked.
"""


#: An action: its name, or its index in `Simulation.action_names`.
_ActionLike: TypeAlias = str | SupportsIndex

#: The keys of one mapping: names or indices of agents. Mappings are invariant in their keys, hence a type variable.
_AgentKey = TypeVar("_AgentKey", bound=str | SupportsIndex)


class Inference:
    """Applies the rules to scenes.

    Pickling and copying store the loaded sources, so a copy reads no file. Not thread-safe: concurrent use raises
    `RuntimeError`.

    Args:
        config: A run configuration: a path, or a built-in one such as `configs/expert.yaml` or `expert`.
        rules: A rule file that replaces the configuration's.
        seed: The seed of probabilistic predicates that a scene does not specify, from 0 to 2**64 - 1.
        executor: The executor of the rules. It does not affect the answers.
        limits: The limits of the evaluation of each scene.

    Raises:
        InputError: If the configuration or rule file is invalid.
        UnsupportedError: If `executor="dense"` cannot evaluate the rules.
        OSError: If a file cannot be read.
        ValueError: If the executor or a limit is unknown, or a number is out of range.
    """

    def __init__(
        self,
        config: str | os.PathLike[str] = "configs/expert.yaml",
        rules: str | os.PathLike[str] | None = None,
        seed: int = 0,
        executor: Executor = "auto",
        *,
        limits: Limits | None = None,
    ) -> None:
        """Load the configuration and the rules."""
        name, seed = checked_path("config", config), checked_integer("seed", seed)
        self._args = (name, rule_file(rules), seed, executor, checked_limits(limits))
        self._inference = _logicity.Inference(*self._args, None)

    def __getstate__(self) -> tuple[Any, ...]:
        """Return the arguments and the loaded sources."""
        return self._args, self._inference.files()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Load the sources again."""
        self._args, files = state
        self._inference = _logicity.Inference(*self._args, files)

    def answer(self, scene: Scene | SymbolicScene) -> Answer:
        """Return the actions that the rules derive in a scene.

        Args:
            scene: Agents on a map (`Scene`), or entities and facts (`SymbolicScene`).

        Raises:
            InputError: If the scene is invalid.
            LimitError: If the scene is too large, or its evaluation exceeds a limit.
            TypeError: If the scene holds a value that JSON cannot represent.
        """
        return cast(Answer, self._inference.answer(json.dumps(scene)))

    def marginals(self, scene: Scene | SymbolicScene, *, samples: int = 10_000, seed: int = 0) -> MarginalAnswer:
        """Return the probabilities of the actions in a scene.

        Clauses with probabilities count with all their alternatives, and rows of the scene may be uncertain:
        `{"row": ["me", "you"], "probability": 0.7}` in place of `["me", "you"]`. All of these are independent.

        Args:
            scene: As for `answer`.
            samples: The number of sampled worlds where exact probabilities take too long, at least 1.
            seed: The seed of these samples.

        Raises:
            InputError: If the scene is invalid.
            LimitError: If the scene is too large, or its evaluation exceeds a limit.
            ValueError: If a number is out of range.
        """
        samples = checked_integer("samples", samples, low=1, high=2**32 - 1)
        found = self._inference.marginals(json.dumps(scene), samples, checked_integer("seed", seed))
        return cast(MarginalAnswer, found)


def infer(
    scene: Scene | SymbolicScene,
    config: str | os.PathLike[str] = "configs/expert.yaml",
    rules: str | os.PathLike[str] | None = None,
    seed: int = 0,
    executor: Executor = "auto",
    *,
    limits: Limits | None = None,
) -> Answer:
    """Return the actions that the rules derive in one scene.

    For several scenes make an `Inference`, which reads its files once. The arguments and exceptions are those of
    `Inference` and `Inference.answer`.
    """
    return Inference(config, rules, seed, executor, limits=limits).answer(scene)


@dataclass(frozen=True)
class AgentInfo:
    """The constant properties of an agent. A smaller priority has the right of way."""

    name: str
    type: str
    concepts: tuple[str, ...]
    priority: int


@dataclass(frozen=True, eq=False)
class Tick:
    """The events of one tick. Array rows are agents, in the order of `Simulation.agents`.

    Attributes:
        tick: The number of the tick, from 0.
        at: int32 (n, 2): row and column before the move, in cells.
        heading: int8 (n,): the heading before the move, an index into `HEADINGS`, or -1.
        derived: bool (n, k): whether the rules derived each of the k actions of the city, without the default action.
        action: int8 (n,): the action taken, by the rules or by `controls`, an index into `Simulation.action_names`.
        next: int32 (n, 2): row and column after the move, in cells.
        reason: int8 (n,): the reason for the move, an index into `REASONS`.
        replanned: bool (n,): whether the agent received a new goal.
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
    """An explanation of an agent's action in a tick, or of why the rules did not derive another action.

    Attributes:
        at: Row and column before the move, in cells.
        derived: The derived actions, without the default action.
        explanations: One entry per explained action, with the key `action`. If a rule mentions the action, the entry
            also has `nodes`, as in `Explanation`.
        text: The explanation as text, also `str()`.
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
    current tick. A copy continues identically. Pickling and copying store the loaded sources and the controls, so a
    copy reads no file but repeats the ticks, which takes as long as the run so far.

    Args:
        config, rules, executor: As for `Inference`.
        split: The set of agents: `"train"`, `"val"` or `"test"`.
        seed: The seed, from 0 to 2**64 - 1.
        threads: The number of threads for a city of more than 256 agents; 0 means one per core. It does not affect the
            ticks.
        count_firings: Whether to count the firings of clauses, for `firings` and for traces of `run`.
        limits: The limits of the evaluation of each tick.
        predicates: The functions of external predicates, see `logicity.predicate`. Pickling needs functions at the top
            level of a module.

    Raises:
        InputError: As for `Inference`, or if the configuration lacks the split, or the agents do not fit on the map, or
            an external predicate lacks its function (`external-predicate`).
        LimitError: If there are too many agents.
        OSError, UnsupportedError: As for `Inference`.
        ValueError: As for `Inference`, or if the split is unknown, or there are more than 1024 threads.
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
        limits: Limits | None = None,
        predicates: Iterable[PythonPredicate] | None = None,
    ) -> None:
        """Place the agents."""
        name, seed, threads = checked_path("config", config), checked_integer("seed", seed), checked_threads(threads)
        arguments = (name, rule_file(rules), split, seed, threads, executor, count_firings, checked_limits(limits))
        self._args = (*arguments, functions_of(predicates))
        self._city = _logicity.Simulation(*self._args, None)
        #: The controls by tick, for ticks that had any.
        self._controls: dict[int, list[tuple[int, int]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments, the loaded sources, the number of ticks, and the controls."""
        return {"args": self._args, "files": self._city.files(), "now": self.now, "controls": self._controls}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Repeat the ticks with the same controls."""
        self._args, self._controls = state["args"], dict(state["controls"])
        self._city = _logicity.Simulation(*self._args, state["files"])
        for tick, controls in self._controls.items():
            self._city.run(tick - self.now, None, False)
            self._city.tick(controls)
        self._city.run(state["now"] - self.now, None, False)

    def __repr__(self) -> str:
        """Show the configuration, the split, the seed and the number of ticks."""
        config, _, split, seed, *_ = self._args
        return f"<Simulation {config}, split {split}, seed {seed}, after {self.now} ticks>"

    @property
    def now(self) -> int:
        """Ticks since the start of the run."""
        return self._city.now()

    @property
    def executor(self) -> Executor:
        """The executor in use: `"relational"`, or `"dense"`, for which the relational one may evaluate some clauses."""
        return cast(Executor, self._city.executor())

    @property
    def map_name(self) -> str:
        """The name of the map."""
        return self._city.map()[0]

    @property
    def map_shape(self) -> tuple[int, int]:
        """The number of rows and columns of the map, in cells."""
        _, rows, columns = self._city.map()
        return rows, columns

    @cached_property
    def agents(self) -> tuple[AgentInfo, ...]:
        """The agents, in the order of array rows."""
        return tuple(AgentInfo(name, kind, tuple(concepts), rank) for name, kind, concepts, rank in self._city.agents())

    @cached_property
    def action_names(self) -> tuple[str, ...]:
        """The actions: those of `ACTIONS`, then those that the configuration defines."""
        return tuple(self._city.action_names())

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
        """The directions of the last moves: int8 (n,), indices into `HEADINGS`, or -1 before the first. A copy."""
        return self._city.headings()

    @property
    def actions(self) -> npt.NDArray[np.int8]:
        """The actions of the last tick: int8 (n,), indices into `action_names`; Stop before the first tick. A copy."""
        return self.last.action

    @property
    def last(self) -> Tick:
        """The last tick. Before the first tick, all agents rest."""
        return Tick(*self._city.last())

    def tick(
        self, controls: Mapping[str | SupportsIndex, _ActionLike] | Mapping[_AgentKey, _ActionLike] | None = None
    ) -> Tick:
        """Decide the actions of all agents, then move all agents.

        Args:
            controls: Actions that replace those of the rules, by agent. Agents are names or indices into `agents`.
                Actions are names or indices into `action_names`. Examples: `{"Car_1": "Stop"}`, `{0: 3}`.

        Raises:
            KeyError: If the agent is unknown.
            LimitError: If the evaluation exceeds a limit, or too many agents are close together. The city is unchanged.
            PredicateError: If the function of a predicate fails. The city is unchanged.
            TypeError: If `controls` is not a mapping, or an agent or action is neither str nor int.
            ValueError: If the action is unknown.
        """
        actions: Mapping[Any, _ActionLike] = {} if controls is None else controls
        if not isinstance(actions, Mapping):
            raise TypeError(f"controls: expected a mapping, not {type(controls).__name__}")
        numbers = [(self._agent(agent), self._action(action)) for agent, action in actions.items()]
        done = Tick(*self._city.tick(numbers))
        if numbers:
            self._controls[done.tick] = numbers
        return done

    def run(self, ticks: int, *, trace: str | os.PathLike[str] | None = None, overwrite: bool = False) -> None:
        """Run several ticks.

        Args:
            ticks: The number of ticks, at least 0.
            trace: A file for the trace of these ticks, which `logicity explain` and `logicity check --coverage` read.
                The file appears at the end of the call, also after an exception. A trace records firings, so it
                requires `count_firings`. It contains the configuration and the rules.
            overwrite: Whether to replace a file that this function did not write, or that has changed since.

        Raises:
            FileExistsError: If the file of the trace must not be replaced. Then no tick runs.
            KeyboardInterrupt: On Ctrl-C. The city keeps the state after the last complete tick.
            LimitError: As for `tick`, or if there are too many agents for a trace.
            OSError: If the trace cannot be written, or another process writes it. Then no tick runs.
            PredicateError: As for `tick`.
            ValueError: If the number of ticks is negative, or `trace` is set without `count_firings`.
        """
        if trace is not None and not self._args[6]:
            raise ValueError("a trace records which clauses fired: make the Simulation with count_firings=True")
        file = None if trace is None else checked_path("trace", trace)
        self._city.run(checked_integer("ticks", ticks), file, overwrite)

    def semantic_map(self) -> npt.NDArray[np.float32]:
        """Return the current state as a float32 array of shape (rows, columns, 8 + n) with values 0 and 1.

        Layers 0 to 7 are walking street, traffic street, crossing, house, office, garage, store and gas station. A cell
        is 1 in at most one of them. Layer 8 + i is 1 in the cell of agent i.

        Raises:
            LimitError: If the array would have too many values.
        """
        return self._city.semantic_map()

    def facts(self) -> dict[str, list[tuple[str, ...]]]:
        """Return the facts of `fact_indices` as tuples of agent names."""
        names, facts = [agent.name for agent in self.agents], self.fact_indices()
        return {name: [tuple(names[agent] for agent in row) for row in rows.tolist()] for name, rows in facts.items()}

    def fact_indices(self) -> dict[str, npt.NDArray[np.int32]]:
        """Return the base facts of the last tick by predicate, as arrays of agent indices: int32 (rows, arity).

        Before the first tick, these are the current facts.

        Raises:
            LimitError: If there are too many agents for binary facts.
        """
        return self._city.facts()

    @property
    def firings(self) -> list[tuple[str, int]]:
        """The label of each clause and the rows it derived in the last tick. Empty without `count_firings`."""
        return self._city.firings()

    @overload
    def explain(self, agent: str | int) -> Decision: ...

    @overload
    def explain(self, agent: str | int, fact: str) -> Explanation: ...

    def explain(self, agent: str | int, fact: str | None = None) -> Decision | Explanation:
        """Explain an agent's action in the last tick, or why a fact holds or does not hold on its state.

        Before the first tick, explain what the rules derive now.

        Args:
            agent: The name or the position of the agent.
            fact: The name of any predicate, about the agent, or a fact such as `IsClose(Car_1, Car_2)`. `_` matches any
                value.

        Raises:
            InputError: If the fact is invalid.
            KeyError: If the agent is unknown.
            LimitError: If there are too many agents, or the search for a proof takes too many steps.
        """
        if fact is None:
            return self._decision(agent, None)
        return Explanation(*self._city.explain_fact(self._agent(agent), fact))

    @overload
    def why_not(self, agent: str | int, action: Action | int) -> Decision: ...

    @overload
    def why_not(self, agent: str | int, action: str) -> Decision | Explanation: ...

    def why_not(self, agent: str | int, action: str | int) -> Decision | Explanation:
        """Explain why the rules did not derive an action for an agent in the last tick, or why they did.

        Explains another fact than an action as `explain` does, whose arguments and exceptions this method has.

        Raises:
            ValueError: If the number of the action is unknown.
        """
        if isinstance(action, str) and action not in self.action_names:
            return self.explain(agent, action)
        return self._decision(agent, self._action(action))

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

    def _action(self, action: _ActionLike) -> int:
        names = self.action_names
        if isinstance(action, str):
            if action in names:
                return names.index(action)
        elif not isinstance(action, bool) and 0 <= index(action) < len(names):
            return index(action)
        raise ValueError(f"{action!r} is not an action{did_you_mean(action, names)}")
