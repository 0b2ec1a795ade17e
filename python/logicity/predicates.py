"""Base predicates that Python functions compute.

A configuration declares such a predicate as external, over one agent or over two::

    predicates:
      define:
        IsGreen: {external: agent}
        IsRival: {external: pair}

`predicate` makes one of a function, and `predicates=[...]` passes it to a `Simulation`, an environment, `evaluate` or
`demonstrations`.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _logicity
from .errors import PredicateError, did_you_mean

__all__ = ["KINDS", "CityState", "PythonPredicate", "predicate"]

#: The kinds of agents. Arrays store indices into this tuple.
KINDS: tuple[str, ...] = tuple(_logicity.KINDS)


@dataclass(frozen=True, eq=False)
class CityState:
    """The state of a city on which a tick is decided. Rows of arrays are agents, in the order of `Simulation.agents`.

    All arrays are read-only and belong to this state: later ticks do not change them.

    Attributes:
        tick: The number of the tick, from 0.
        map_shape: The number of rows and columns of the map, in cells.
        kinds: int8 (n,): indices into `KINDS`.
        positions: int32 (n, 2): row and column, in cells.
        headings: int8 (n,): the directions of the last moves, indices into `HEADINGS`, or -1 before the first move.
        goals: int32 (n, 2): row and column of the goal, in cells.
        priorities: int32 (n,): a smaller number goes first.
        speeds: int32 (n,): the cells that the agent moved in the last tick; 0 in the first.
        waited: int32 (n,): the ticks since its last move, or since the start of the run.
        remaining: int32 (n,): the cells to its goal along its route.
        concept_names: The C concepts of the configuration.
        concepts: bool (n, C): whether the agent carries each of `concept_names`.
    """

    tick: int
    map_shape: tuple[int, int]
    kinds: npt.NDArray[np.int8]
    positions: npt.NDArray[np.int32]
    headings: npt.NDArray[np.int8]
    goals: npt.NDArray[np.int32]
    priorities: npt.NDArray[np.int32]
    speeds: npt.NDArray[np.int32]
    waited: npt.NDArray[np.int32]
    remaining: npt.NDArray[np.int32]
    concept_names: tuple[str, ...]
    concepts: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of agents."""
        return len(self.kinds)

    def has(self, concept: str) -> npt.NDArray[np.bool_]:
        """Return which agents carry a concept: bool (n,).

        Raises:
            KeyError: If the configuration has no such concept.
        """
        if concept not in self.concept_names:
            raise KeyError(f"unknown concept `{concept}`{did_you_mean(concept, self.concept_names)}")
        return self.concepts[:, self.concept_names.index(concept)]

    def distances(self) -> npt.NDArray[np.float64]:
        """Return the Euclidean distances of all pairs of agents in cells: float64 (n, n)."""
        apart = self.positions[:, None, :] - self.positions[None, :, :]
        rows, columns = np.moveaxis(apart, 2, 0)
        distances: npt.NDArray[np.float64] = np.hypot(rows, columns)
        return distances


Function: TypeAlias = Callable[[CityState], npt.NDArray[np.bool_]]


class PythonPredicate:
    """A base predicate that a Python function computes. A call calls the function.

    It is picklable if its function is: defined at the top level of a module. `predicate` makes one.

    Attributes:
        name: The name in the configuration and in rules.
        function: Takes the `CityState` of a tick, and returns a bool array: of shape (n,) for a predicate over one
            agent, and of shape (n, n) for one over two, with the value for the agents i and j at [i, j]. No agent is
            related to itself: the diagonal has no effect.
    """

    def __init__(self, name: str, function: Function) -> None:
        """Store the arguments."""
        if not isinstance(name, str):
            raise TypeError(f"predicate: expected the name of a predicate, not {type(name).__name__}")
        if not callable(function):
            raise TypeError(f"predicate(`{name}`): expected a function, not {type(function).__name__}")
        self.name, self.function = name, function
        self.__doc__ = getattr(function, "__doc__", None)

    def __call__(self, state: CityState) -> npt.NDArray[np.bool_]:
        """Return what the function returns for this state."""
        return self.function(state)

    def __repr__(self) -> str:
        """Show the name and the function."""
        return f"<PythonPredicate {self.name}: {getattr(self.function, '__qualname__', self.function)!s}>"

    def __deepcopy__(self, _memo: Any) -> PythonPredicate:
        """Return the predicate itself, because it is immutable."""
        return self

    def __copy__(self) -> PythonPredicate:
        """Return the predicate itself."""
        return self

    def __reduce__(self) -> Any:
        """Pickle a reference to the module of the function.

        A decorator has replaced the function of this name by the predicate.
        """
        module = sys.modules.get(getattr(self.function, "__module__", None) or "")
        place = getattr(self.function, "__qualname__", None)
        found: Any = module
        for part in (place or "").split("."):
            found = getattr(found, part, None)
        if found is self:
            return _at, (self.function.__module__, place)
        if found is self.function:
            return PythonPredicate, (self.name, self.function)
        raise pickle.PicklingError(
            f"the predicate `{self.name}` cannot be pickled: define its function at the top level of a module"
        )


def _at(module: str, place: str) -> PythonPredicate:
    """Return the predicate that a decorator has put at this place of a module."""
    __import__(module)
    found: Any = sys.modules[module]
    for part in place.split("."):
        found = getattr(found, part)
    if not isinstance(found, PythonPredicate):
        raise pickle.UnpicklingError(f"`{module}.{place}` is no `PythonPredicate`")
    return found


def predicate(name: str) -> Callable[[Function], PythonPredicate]:
    """Return a decorator that makes a base predicate of a function, see `PythonPredicate`.

    The configuration declares it: `IsGreen: {external: agent}` or `{external: pair}`. The function is called once per
    tick with a `CityState`, before the rules decide. Its result must depend only on the state; otherwise runs with the
    same seed differ. It must not use the simulation or the environment that calls it. A trace records the facts, so it
    replays and explains itself without the function. For example::

        @logicity.predicate("IsGreen")
        def is_green(state):
            return (state.positions[:, 0] + state.tick) % 2 == 0

        city = logicity.Simulation("crossing.yaml", predicates=[is_green])

    Raises:
        TypeError: If the name is not a string, or a call of the decorator does not get a function.
    """
    if not isinstance(name, str):
        raise TypeError(f'predicate: expected a name, as in `@predicate("IsGreen")`, not {type(name).__name__}')
    return lambda function: PythonPredicate(name, function)


class Functions:
    """The predicates of a city, as the core calls them: once per tick, while it holds the GIL."""

    def __init__(self, predicates: tuple[PythonPredicate, ...]) -> None:
        """Store the predicates."""
        self.predicates = predicates
        self.names = [each.name for each in predicates]

    def __deepcopy__(self, _memo: Any) -> Functions:
        """Return the object itself, because it is immutable."""
        return self

    def __call__(
        self, wanted: list[tuple[int, int]], tick: int, map_shape: tuple[int, int], *values: Any
    ) -> list[npt.NDArray[np.bool_]]:
        """Return the array of each wanted predicate: its position in `predicates`, and its number of agents.

        Raises:
            PredicateError: If a function raises an exception, or returns another array.
        """
        *arrays, (concept_names, concepts) = values
        for array in (*arrays, concepts):
            array.setflags(write=False)
        kinds, positions, headings, goals, priorities, speeds, waited, remaining = arrays
        state = CityState(
            tick,
            map_shape,
            kinds=kinds,
            positions=positions,
            headings=headings,
            goals=goals,
            priorities=priorities,
            speeds=speeds,
            waited=waited,
            remaining=remaining,
            concept_names=concept_names,
            concepts=concepts,
        )
        return [_result(self.predicates[at], state, (len(state),) * arity) for at, arity in wanted]


def _result(known: PythonPredicate, state: CityState, shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    try:
        result = known.function(state)
    except Exception as error:
        text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise PredicateError(f"the predicate `{known.name}` failed in tick {state.tick}: {text}") from error
    if isinstance(result, np.ndarray) and result.dtype == np.bool_ and result.shape == shape:
        return np.ascontiguousarray(result)
    expected = f"a bool array of shape ({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
    found = (
        f"an array of type {result.dtype} and shape {result.shape}"
        if isinstance(result, np.ndarray)
        else f"{type(result).__name__}"
    )
    raise PredicateError(f"the predicate `{known.name}` failed in tick {state.tick}: expected {expected}, not {found}")


def functions_of(predicates: Iterable[PythonPredicate] | None) -> Functions | None:
    """Check the argument `predicates`, and return its functions; `None` without any.

    Raises:
        TypeError: If it is not a list of predicates.
    """
    if predicates is None:
        return None
    if isinstance(predicates, (str, PythonPredicate)) or not isinstance(predicates, Iterable):
        raise TypeError(f"predicates: expected a list of predicates, not {type(predicates).__name__}")
    given = tuple(predicates)
    for each in given:
        if not isinstance(each, PythonPredicate):
            raise TypeError(
                f"predicates: expected predicates, made with `logicity.predicate(NAME)`, not {type(each).__name__}"
            )
    return Functions(given) if given else None
