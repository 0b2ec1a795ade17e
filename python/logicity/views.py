"""Relational and graph views of `groundings` observations, and the environments with such observations.

An observation of the kind `groundings` is a vector of truth values of ground atoms. `Layout` maps it to two other
views, without a loop over observations:

- *relational*: for N entities, the unary truth values (N, U), the binary truth values (N, N, B) and the mask of the
  entities that are present (N,);
- *graph*: the complete graph over the N entities, with a loop at each. Node features are the unary truth values, and
  edge features the binary ones.

`RelationalObservation` and `GraphObservation` wrap an `SPFEnv`, and `VectorRelationalObservation` and
`VectorGraphObservation` wrap an `SPFVectorEnv`, so that their observations are these views. This module needs the extra
`gym`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from . import _logicity
from .describe import Atom, atoms_of
from .errors import missing_extra

try:
    import gymnasium
    from gymnasium.spaces import Box, Dict, MultiBinary
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorObservationWrapper, VectorWrapper
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise missing_extra("gym", error) from error

from .envs import Observations, SPFEnv, SPFVectorEnv

__all__ = [
    "GraphObservation",
    "Layout",
    "RelationalObservation",
    "VectorGraphObservation",
    "VectorRelationalObservation",
    "View",
]

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

    Args:
        layout: The layout.
        kind: The kind of view.
    """

    def __init__(self, layout: Layout, kind: Literal["relational", "graph"]) -> None:
        """Precompute what does not depend on the observations."""
        self.layout, self.kind = layout, kind
        self._occurrences, self._links = layout.occurrences(), layout.edge_links()

    def space(self) -> Dict:
        """Return the space of the view of one observation."""
        layout = self.layout
        count, unary, binary = layout.entities, len(layout.unary), len(layout.binary)
        spaces: dict[str, gymnasium.Space[Any]]
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

    def __call__(self, observations: Observations) -> View:
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


def _views(env: Any, of: type[SPFEnv | SPFVectorEnv], kind: Literal["relational", "graph"]) -> Views:
    """Return the views of an environment's observations."""
    inner = env.unwrapped
    if not isinstance(inner, of):
        raise TypeError(f"expected an environment of the class {of.__name__}, not {type(inner).__name__}")
    if inner._config.observation != "groundings":
        raise ValueError(
            f'views need `observation="groundings"`, and the environment has `{inner._config.observation}`'
        )
    return Views(Layout.of_description(_logicity.describe(inner._task)), kind)


class _ViewObservation(gymnasium.ObservationWrapper[View, np.int64, Observations]):
    """Replaces the observations of an `SPFEnv` by views."""

    _kind: Literal["relational", "graph"]

    def __init__(self, env: gymnasium.Env[Observations, np.int64]) -> None:
        """Wrap the environment.

        Raises:
            TypeError: If it is not an `SPFEnv`.
            ValueError: If its observations are not of the kind `groundings`.
        """
        super().__init__(env)
        self._views = _views(env, SPFEnv, self._kind)
        self.observation_space = cast(gymnasium.Space[View], self._views.space())

    def observation(self, observation: Observations) -> View:
        """Return the view of an observation."""
        return self._views(observation)


class RelationalObservation(_ViewObservation):
    """Replaces the observations of an `SPFEnv` by tensors of truth values.

    An observation is a dictionary, for N entities, of which entity 0 is the ego:

    - `unary`: float32 (N, U), the truth value of the u-th unary predicate for entity i;
    - `binary`: float32 (N, N, B), the truth value of the b-th binary predicate for the entities i and j;
    - `mask`: int8 (N,), 1 for the ego and for every entity in a true atom, which are those that are present, else 0;
    - `route_length`: float32 (1,), if the task observes the route length.

    The predicates have the order in which `logicity describe` lists them.

    Args:
        env: An `SPFEnv` with `observation="groundings"`.

    Raises:
        TypeError: If the environment is not an `SPFEnv`.
        ValueError: If its observations are of another kind.
    """

    _kind = "relational"


class GraphObservation(_ViewObservation):
    """Replaces the observations of an `SPFEnv` by complete graphs over the entities.

    An observation is a dictionary, for N nodes, of which node 0 is the ego. The graph has an edge from every node to
    every node, including itself, so that observations have a fixed shape. The masks mark the nodes and edges of
    entities that are present:

    - `nodes`: float32 (N, U), the truth values of the unary predicates;
    - `edges`: float32 (N * N, B), the truth values P(i, j) of the binary predicates, for the edge from i to j;
    - `edge_links`: int64 (N * N, 2), the source and the target of each edge;
    - `node_mask`: int8 (N,), 1 for nodes that are present;
    - `edge_mask`: int8 (N * N,), 1 for edges between such nodes;
    - `route_length`: float32 (1,), if the task observes the route length.

    The names are those of `gymnasium.spaces.GraphInstance`. The transposed `edge_links` are the `edge_index` of PyTorch
    Geometric.

    Args:
        env: An `SPFEnv` with `observation="groundings"`.

    Raises:
        TypeError: If the environment is not an `SPFEnv`.
        ValueError: If its observations are of another kind.
    """

    _kind = "graph"


class _VectorViewObservation(VectorObservationWrapper[View, NDArray[np.int64], Observations, NDArray[Any]]):
    """Replaces the observations of an `SPFVectorEnv` by views."""

    _kind: Literal["relational", "graph"]

    def __init__(self, env: VectorEnv[Observations, NDArray[np.int64], NDArray[Any]]) -> None:
        """Wrap the environments.

        Raises:
            TypeError: If they are not an `SPFVectorEnv`.
            ValueError: If their observations are not of the kind `groundings`.
        """
        # Not that of `VectorObservationWrapper`, which rejects the autoreset mode SameStep: `step` supports it.
        VectorWrapper.__init__(self, env)
        self._views = _views(env, SPFVectorEnv, self._kind)
        self.single_observation_space = self._views.space()
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Observations) -> View:
        """Return the views of the observations of all environments."""
        return self._views(observations)

    def step(self, actions: NDArray[np.int64]) -> tuple[View, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Run one tick in every environment, and return views instead of observations, also in `final_obs`."""
        observations, rewards, terminated, truncated, infos = super().step(actions)
        if self.env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP and "final_obs" in infos:
            infos["final_obs"] = self._final_views(infos["final_obs"], infos["_final_obs"])
        return observations, rewards, terminated, truncated, infos

    def _final_views(self, final: NDArray[Any], ended: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the array of the last views of episodes. Computes all views at once."""
        views = np.empty(len(final), object)
        all_views = self._views(np.stack(list(final[ended])))
        for row, at in enumerate(np.flatnonzero(ended)):
            views[at] = {name: values[row] for name, values in all_views.items()}
        return views


class VectorRelationalObservation(_VectorViewObservation):
    """Replaces the observations of an `SPFVectorEnv` by tensors of truth values.

    The arrays are those of `RelationalObservation`, each with a first axis for the environments. In the autoreset mode
    SameStep, `final_obs` has such dictionaries, too.

    Args:
        env: An `SPFVectorEnv` with `observation="groundings"`.

    Raises:
        TypeError: If the environment is not an `SPFVectorEnv`.
        ValueError: If its observations are of another kind.
    """

    _kind = "relational"


class VectorGraphObservation(_VectorViewObservation):
    """Replaces the observations of an `SPFVectorEnv` by complete graphs over the entities.

    The arrays are those of `GraphObservation`, each with a first axis for the environments. In the autoreset mode
    SameStep, `final_obs` has such dictionaries, too.

    Args:
        env: An `SPFVectorEnv` with `observation="groundings"`.

    Raises:
        TypeError: If the environment is not an `SPFVectorEnv`.
        ValueError: If its observations are of another kind.
    """

    _kind = "graph"
