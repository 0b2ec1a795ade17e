"""Relational and graph views of `groundings` observations.

An observation of the kind `groundings` is a vector of truth values of ground atoms. `Layout` knows the position of each
atom. `Views` maps batches of observations to two other views, without a loop over observations:

- *relational*: for N entities, the unary truth values (N, U), the binary truth values (N, N, B) and the mask of the
  entities that are present (N,);
- *graph*: the complete graph over the N entities, with a loop at each. Node features are the unary truth values, and
  edge features the binary ones.

`logicity.envs.SPFEnv` makes environments with such observations, and `logicity.views` has wrappers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _logicity
from .describe import Atom, atoms_of
from .env_config import ObservationKind, ViewKind
from .errors import missing_extra

if TYPE_CHECKING:
    from gymnasium.spaces import Dict, Space

__all__ = ["Layout", "View", "Views"]

View = dict[str, NDArray[Any]]
"""An observation with named arrays."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The positions of the truth values in a `groundings` observation.

    Attributes:
        entities: The number N of observed entities. Entity 0 is the ego.
        unary: The names of the U unary predicates, in the order of the observation.
        binary: The names of the B binary predicates, in the same order.
        unary_at: int64 (N, U): the position of P(i).
        binary_at: int64 (N, N, B): the position of P(i, j).
        route_length: The position of the route length, if the task observes it.
        width: The length of an observation.
    """

    entities: int
    unary: tuple[str, ...]
    binary: tuple[str, ...]
    unary_at: NDArray[np.int64]
    binary_at: NDArray[np.int64]
    route_length: int | None
    width: int

    @classmethod
    def of_description(cls, description: Mapping[str, Any]) -> Layout:
        """Return the layout of a task from its description."""
        return cls.of_atoms(tuple(atoms_of(description)), bool(description["route_length"]))

    @classmethod
    def of_atoms(cls, atoms: Sequence[Atom], route_length: bool = False) -> Layout:
        """Return the layout of observations of these atoms, such as `Demonstrations.atoms`.

        Args:
            atoms: The atoms in the order of the observation: all ground atoms of each predicate.
            route_length: Whether a number follows the atoms.

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
        """Return float32 (width, N): 1 where an entity occurs in an atom, else 0."""
        each, marks = np.arange(self.entities), np.zeros((self.width, self.entities), np.float32)
        marks[self.unary_at, each[:, None]] = 1.0
        marks[self.binary_at, each[:, None, None]] = 1.0
        marks[self.binary_at, each[None, :, None]] = 1.0
        return marks

    def edge_links(self) -> NDArray[np.int64]:
        """Return int64 (N * N, 2): the source i and the target j of the edge N * i + j."""
        return np.stack(np.divmod(np.arange(self.entities**2), self.entities), 1)


class Views:
    """Maps observations of one layout to views.

    `logicity.views.RelationalObservation` and `GraphObservation` describe the arrays of the views.

    Args:
        layout: The layout.
        kind: The kind of view.
    """

    def __init__(self, layout: Layout, kind: ViewKind) -> None:
        """Precompute what does not depend on the observations."""
        self.layout, self.kind = layout, kind
        self._occurrences, self._links = layout.occurrences(), layout.edge_links()

    def space(self) -> Dict:
        """Return the space of the view of one observation.

        Raises:
            ImportError: If gymnasium is not installed. The extra `gym` installs it: `pip install './python[gym]'`.
        """
        try:
            from gymnasium.spaces import Box, Dict, MultiBinary
        except ImportError as error:
            raise missing_extra("gym", error) from error

        layout = self.layout
        count, unary, binary = layout.entities, len(layout.unary), len(layout.binary)
        spaces: dict[str, Space[Any]]
        if self.kind == "relational":
            spaces = {
                "unary": Box(0.0, 1.0, (count, unary), np.float32),
                "binary": Box(0.0, 1.0, (count, count, binary), np.float32),
                "mask": MultiBinary(count),
            }
        else:
            spaces = {
                "nodes": Box(0.0, 1.0, (count, unary), np.float32),
                "edges": Box(0.0, 1.0, (count**2, binary), np.float32),
                "edge_links": Box(0, count - 1, (count**2, 2), np.int64),
                "node_mask": MultiBinary(count),
                "edge_mask": MultiBinary(count**2),
            }
        if layout.route_length is not None:
            spaces["route_length"] = Box(0.0, 1.0, (1,), np.float32)
        return Dict(spaces)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array of the view of one observation."""
        return {name: values.shape for name, values in self(np.zeros(self.layout.width, np.float32)).items()}

    def __call__(self, observations: NDArray[np.float32]) -> View:
        """Return the views of observations of shape (..., width), as new arrays."""
        layout, before = self.layout, observations.shape[:-1]
        mask = (observations @ self._occurrences > 0).astype(np.int8)
        mask[..., 0] = 1
        unary, binary = observations[..., layout.unary_at], observations[..., layout.binary_at]
        view: View
        if self.kind == "relational":
            view = {"unary": unary, "binary": binary, "mask": mask}
        else:
            view = {
                "nodes": unary,
                "edges": binary.reshape(*before, layout.entities**2, len(layout.binary)),
                "edge_links": np.broadcast_to(self._links, (*before, *self._links.shape)).copy(),
                "node_mask": mask,
                "edge_mask": (mask[..., :, None] & mask[..., None, :]).reshape(*before, layout.entities**2),
            }
        if layout.route_length is not None:
            view["route_length"] = observations[..., layout.route_length : layout.route_length + 1].copy()
        return view

    def of_ended(self, final: NDArray[Any], ended: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the views of the last observations of episodes, computed in one batch.

        Args:
            final: An array of objects of shape (num_envs,), which has an observation where an episode ended.
            ended: Where an episode ended, at least once; bool of shape (num_envs,).

        Returns:
            An array of objects of shape (num_envs,), which has a view where an episode ended, and `None` elsewhere.
        """
        views = np.empty(len(final), object)
        batch = self(np.stack(list(final[ended])))
        for row, at in enumerate(np.flatnonzero(ended)):
            views[at] = {name: values[row] for name, values in batch.items()}
        return views


def views_of(task: _logicity.Task, kind: ObservationKind) -> Views | None:
    """Return the views of a kind of observation of a task, or `None` if its observations are arrays.

    Raises:
        ValueError: If the kind is a view, and the task has a predicate of three or more entities.
    """
    if kind == "groundings" or kind == "state":
        return None
    return Views(Layout.of_description(_logicity.describe(task)), kind)
