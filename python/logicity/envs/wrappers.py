"""Wrappers that replace `groundings` observations by relational tensors or graphs.

`RelationalObservation` and `GraphObservation` wrap an `SPFEnv`, and `VectorRelationalObservation` and
`VectorGraphObservation` wrap an `SPFVectorEnv`. The observations equal those of environments that are made with
`observation="relational"` or `"graph"`, which need no wrapper. A wrapper is for environments whose `groundings`
something else needs, too. This module needs the extra `gym`.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

with extra("gym"):
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorObservationWrapper, VectorWrapper
    from gymnasium.vector.utils import batch_space

from .. import _logicity
from ..types import ViewKind
from .layout import Layout
from .single import SPFEnv
from .vector import SPFVectorEnv
from .views import Observations, View, Views

__all__ = ["GraphObservation", "RelationalObservation", "VectorGraphObservation", "VectorRelationalObservation"]


def _views(env: Any, of: type[SPFEnv | SPFVectorEnv], kind: ViewKind) -> Views:
    inner = env.unwrapped
    if not isinstance(inner, of):
        raise TypeError(f"expected an environment of the class {of.__name__}, not {type(inner).__name__}")
    if inner._config.observation != "groundings":
        raise ValueError(
            f'views need `observation="groundings"`, and the environment has `{inner._config.observation}`'
        )
    return Views(Layout.of_description(_logicity.layout(inner._task)), kind)


class _ViewObservation(gymnasium.ObservationWrapper[View, np.int64, Observations]):
    _kind: ViewKind

    def __init__(self, env: gymnasium.Env[Observations, np.int64]) -> None:
        super().__init__(env)
        self._views = _views(env, SPFEnv, self._kind)
        self.observation_space = cast(gymnasium.Space[View], self._views.space())

    def observation(self, observation: Observations) -> View:
        return self._views(observation)

    # Two environments cannot share a city.
    __copy__ = deepcopy


class RelationalObservation(_ViewObservation):
    """Replaces the observations of an `SPFEnv` by tensors of truth values.

    An observation is a dictionary, for N entities, of which entity 0 is the ego:

    - `unary`: float32 (N, U), the truth value of the u-th unary predicate for entity i;
    - `binary`: float32 (N, N, B), the truth value of the b-th binary predicate for the entities i and j;
    - `mask`: int8 (N,), 1 for the ego and for every entity in a true atom, which are those that are present, else 0;
    - `route_length`: float32 (1,), if the task observes the route length.

    The predicates have the order in which `logicity describe` lists them.

    Raises:
        TypeError: If the environment is not an `SPFEnv`.
        ValueError: If its observations are of another kind than `groundings`.
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
    Geometric. The exceptions are those of `RelationalObservation`.
    """

    _kind = "graph"


# The type parameters exist only in later versions of gymnasium.
class _VectorViewObservation(VectorObservationWrapper):
    _kind: ViewKind

    def __init__(self, env: VectorEnv[Observations, NDArray[np.int64], NDArray[Any]]) -> None:
        # Not that of `VectorObservationWrapper`, which rejects the autoreset mode SameStep: `step` supports it.
        VectorWrapper.__init__(self, env)
        self._views = _views(env, SPFVectorEnv, self._kind)
        self.single_observation_space = self._views.space()
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Observations) -> View:
        return self._views(observations)

    # Two environments cannot share a city.
    __copy__ = deepcopy

    def step(self, actions: NDArray[np.int64]) -> tuple[View, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Run one tick in every environment, and return views instead of observations, also in `final_obs`."""
        observations, rewards, terminated, truncated, infos = super().step(actions)
        if self.env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP and "final_obs" in infos:
            infos["final_obs"] = self._views.of_ended(infos["final_obs"], infos["_final_obs"])
        return observations, rewards, terminated, truncated, infos


class VectorRelationalObservation(_VectorViewObservation):
    """Variant of `RelationalObservation` for an `SPFVectorEnv`.

    Each array has a first axis for the environments. In the autoreset mode SameStep, `final_obs` has dictionaries, too.
    The exceptions are the same, with `SPFVectorEnv` in place of `SPFEnv`.
    """

    _kind = "relational"


class VectorGraphObservation(_VectorViewObservation):
    """Variant of `GraphObservation` for an `SPFVectorEnv`. Arrays change as in `VectorRelationalObservation`."""

    _kind = "graph"
