"""Relational and graph views of `groundings` observations.

An observation of the kind `groundings` is a vector of truth values of ground atoms and of values of quantities, whose
positions `Layout` knows.
`Views` maps batches of observations to two other views, without a loop over observations.
`logicity.envs.wrappers.RelationalObservation` and `GraphObservation` describe the arrays of the views, and wrap
environments. `logicity.envs.SPFEnv` makes environments with such observations.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..errors import extra
from ..types import ObservationKind, ViewKind
from .layout import Layout

if TYPE_CHECKING:
    from gymnasium.spaces import Dict, Space

__all__ = ["Actions", "Observations", "View", "Views"]

Observations: TypeAlias = NDArray[np.float32]
"""Observations: float32, one row per environment if there are several."""

Actions: TypeAlias = NDArray[np.int64]
"""Actions: int64, one per environment."""

View: TypeAlias = dict[str, NDArray[Any]]
"""An observation with named arrays."""


class Views:
    """Maps observations of one layout to views of one kind."""

    def __init__(self, layout: Layout, kind: ViewKind) -> None:
        """Precompute what does not depend on the observations."""
        self.layout, self.kind = layout, kind
        self._occurrences, self._links = layout.occurrences(), layout.edge_links()

    def space(self) -> Dict:
        """Return the space of the view of one observation. This method needs the extra `gym`."""
        with extra("gym"):
            from gymnasium.spaces import Box, Dict, MultiBinary

        spaces: dict[str, Space[Any]] = {}
        with np.errstate(invalid="ignore"):  # masks of unbounded numbers are not used
            low, high = map(self, self.layout.bounds())
        for name, values in self(np.zeros(self.layout.width, np.float32)).items():
            if values.dtype == np.int8:
                spaces[name] = MultiBinary(len(values))
            elif name == "edge_links":
                spaces[name] = Box(0, self.layout.entities - 1, values.shape, values.dtype.type)
            else:
                spaces[name] = Box(low[name], high[name], dtype=np.float32)
        return Dict(spaces)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array of the view of one observation."""
        return {name: values.shape for name, values in self(np.zeros(self.layout.width, np.float32)).items()}

    def __call__(self, observations: NDArray[np.float32]) -> View:
        """Return the views of observations of shape (..., width), as new arrays."""
        layout, before = self.layout, observations.shape[:-1]
        mask = (np.abs(observations) @ self._occurrences > 0).astype(np.int8)
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

        `final` and the result are arrays of objects of shape (num_envs,), `None` where no episode `ended`. At least one
        episode ended.
        """
        views = np.empty(len(final), object)
        batch = self(np.stack(list(final[ended])))
        for row, at in enumerate(np.flatnonzero(ended)):
            views[at] = {name: values[row] for name, values in batch.items()}
        return views


def views_of(task: _logicity.Task, kind: ObservationKind) -> Views | None:
    """Return the views of a kind of observation of a task, or `None` if its observations are arrays."""
    if kind == "groundings" or kind == "state":
        return None
    return Views(Layout.of_description(_logicity.layout(task)), kind)
