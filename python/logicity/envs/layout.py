"""The layout of observations: the position of each number in an observation of the kind `groundings`."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Atom

__all__ = ["Layout", "atoms_of"]


def atoms_of(description: Mapping[str, Any]) -> Iterator[Atom]:
    """Yield the atom of each number of a `groundings` observation in order, from the description of the task.

    The atom of a value of a quantity has the name of its column and the entities, such as `("Waited", (0,))`.
    """
    for column in description["columns"]:
        for entities in itertools.product(range(description["entities"]), repeat=column["arity"]):
            yield column["predicate"], entities


@dataclass(frozen=True, eq=False)
class Layout:
    """The positions of the truth values and of the values of quantities in a `groundings` observation.

    Attributes:
        entities: The number N of observed entities. Entity 0 is the ego.
        unary: The names of the U unary predicates and columns of quantities, in the order of the observation.
        binary: The names of the B binary ones, in the same order.
        unary_at: int64 (N, U): the position of P(i).
        binary_at: int64 (N, N, B): the position of P(i, j).
        route_length: The position of the route length, if the task observes it.
        width: The length of an observation.
        unbounded: Which of the numbers are values of quantities, divided by the scales of their columns; the others are
            from 0 to 1. Bool (width,).
    """

    entities: int
    unary: tuple[str, ...]
    binary: tuple[str, ...]
    unary_at: NDArray[np.int64]
    binary_at: NDArray[np.int64]
    route_length: int | None
    width: int
    unbounded: NDArray[np.bool_]

    @classmethod
    def of_description(cls, description: Mapping[str, Any]) -> Layout:
        """Return the layout of a task from what `_logicity.layout` or `_logicity.describe` returns."""
        scaled = {column["predicate"] for column in description["columns"] if "scale" in column}
        return cls.of_atoms(tuple(atoms_of(description)), bool(description["route_length"]), scaled)

    @classmethod
    def of_atoms(cls, atoms: Sequence[Atom], route_length: bool = False, scaled: Collection[str] = ()) -> Layout:
        """Return the layout of observations of these atoms, such as `Demonstrations.atoms`.

        They are all ground atoms of each predicate, in the order of the observation. A route length may follow them.
        `scaled` has the names of the columns whose numbers are not truth values.

        Raises:
            ValueError: If a predicate is neither unary nor binary, or a ground atom is missing or repeated.
        """
        arities = {name: len(entities) for name, entities in atoms}
        if set(arities.values()) - {1, 2}:
            name = next(name for name, arity in arities.items() if arity not in (1, 2))
            raise ValueError(f"`{name}` has {arities[name]} arguments: views exist for unary and binary predicates")
        count = 1 + max((entity for _, entities in atoms for entity in entities), default=0)
        unary = tuple(name for name, arity in arities.items() if arity == 1)
        binary = tuple(name for name, arity in arities.items() if arity == 2)
        if len(atoms) != count * len(unary) + count**2 * len(binary) or len(set(atoms)) != len(atoms):
            raise ValueError("the atoms are not all ground atoms of their predicates, each once")
        positions = {atom: at for at, atom in enumerate(atoms)}
        each = range(count)
        unary_at = [[positions[name, (i,)] for name in unary] for i in each]
        binary_at = [[[positions[name, (i, j)] for name in binary] for j in each] for i in each]
        return cls(
            count,
            unary,
            binary,
            np.array(unary_at, np.int64).reshape(count, len(unary)),
            np.array(binary_at, np.int64).reshape(count, count, len(binary)),
            len(atoms) if route_length else None,
            len(atoms) + route_length,
            np.array([*(name in scaled for name, _ in atoms), *[False] * route_length], np.bool_),
        )

    def atoms(self) -> tuple[Atom, ...]:
        """Return the atoms in the order of the observation."""
        atoms: dict[int, Atom] = {}
        for (i, column), at in np.ndenumerate(self.unary_at):
            atoms[int(at)] = (self.unary[column], (i,))
        for (i, j, column), at in np.ndenumerate(self.binary_at):
            atoms[int(at)] = (self.binary[column], (i, j))
        return tuple(atom for _, atom in sorted(atoms.items()))

    def occurrences(self) -> NDArray[np.float32]:
        """Return float32 (width, N): 1 where a number is about an entity, else 0."""
        each, marks = np.arange(self.entities), np.zeros((self.width, self.entities), np.float32)
        marks[self.unary_at, each[:, None]] = 1.0
        marks[self.binary_at, each[:, None, None]] = 1.0
        marks[self.binary_at, each[None, :, None]] = 1.0
        return marks

    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the smallest and the greatest possible observation, float32 (width,)."""
        high = np.where(self.unbounded, np.inf, 1.0).astype(np.float32)
        return np.where(self.unbounded, -high, 0.0).astype(np.float32), high

    def edge_links(self) -> NDArray[np.int64]:
        """Return int64 (N * N, 2): the source i and the target j of the edge N * i + j."""
        return np.stack(np.divmod(np.arange(self.entities**2), self.entities), 1)
