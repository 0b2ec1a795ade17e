"""Measures of predicted actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..city import ACTIONS

__all__ = ["VapMetrics", "vap_metrics"]


@dataclass(frozen=True)
class VapMetrics:
    """The measures of predicted actions of cars. Rates are shares, 0 to 1.

    Attributes:
        recall: By occurring action, the share of the cars with this label whose prediction is right.
        counts: By action, the number of cars with this label.
        a_acc: The mean over frames of the share of the frame's cars with a right prediction.
        w_acc: The sum of recall / count over the sum of 1 / count, over the occurring actions. Rare actions weigh most.
    """

    recall: Mapping[str, float]
    counts: Mapping[str, int]
    a_acc: float
    w_acc: float

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def vap_metrics(labels: ArrayLike, predictions: ArrayLike, frames: ArrayLike) -> VapMetrics:
    """Measure predictions as the paper does (LogiCity, NeurIPS 2024, Datasets and Benchmarks).

    M is the number of cars of all frames, in any order.

    Args:
        labels: Integers (M,), the actions that the rules derive, positions in `logicity.ACTIONS`.
        predictions: Integers (M,), the predicted actions.
        frames: Integers (M,), equal for cars of the same frame.

    Raises:
        TypeError: If an argument is not an array of integers.
        ValueError: If there are no cars, the lengths differ, or a number is not an action.
    """
    wanted, predicted, of_frame = (
        _integers(name, values)
        for name, values in [("labels", labels), ("predictions", predictions), ("frames", frames)]
    )
    if not len(wanted) == len(predicted) == len(of_frame):
        raise ValueError(f"{len(wanted)} labels, {len(predicted)} predictions and {len(of_frame)} frames")
    if len(wanted) == 0:
        raise ValueError("expected at least one car")
    for name, values in [("labels", wanted), ("predictions", predicted)]:
        if values.min() < 0 or values.max() >= len(ACTIONS):
            wrong = values[(values < 0) | (values >= len(ACTIONS))][0]
            raise ValueError(f"expected {name} from 0 to {len(ACTIONS) - 1}, not {wrong}; leave pedestrians out")
    right = wanted == predicted
    counts = np.bincount(wanted, minlength=len(ACTIONS))
    occurs = np.flatnonzero(counts)
    recall = np.bincount(wanted[right], minlength=len(ACTIONS))[occurs] / counts[occurs]
    weights = 1 / counts[occurs]
    _, frame = np.unique(of_frame, return_inverse=True)
    return VapMetrics(
        recall={ACTIONS[action]: float(share) for action, share in zip(occurs, recall, strict=True)},
        counts={ACTIONS[action]: int(counts[action]) for action in occurs},
        a_acc=float(np.mean(np.bincount(frame, right) / np.bincount(frame))),
        w_acc=float((recall * weights).sum() / weights.sum()),
    )


def _integers(name: str, values: ArrayLike) -> NDArray[np.int64]:
    array = np.asarray(values)
    if array.ndim != 1:
        raise ValueError(f"expected {name} of shape (M,), not {array.shape}")
    # The dtype of an empty list means nothing.
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise TypeError(f"expected integers as {name}, not {array.dtype}")
    return array.astype(np.int64)
