"""Metrics of predicted actions."""

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
    """The metrics of the predicted actions of cars. Rates are from 0 to 1.

    Attributes:
        recall: By label, the share of cars with a correct prediction. Only labels that occur.
        counts: By label, the number of cars. Only labels that occur.
        a_acc: The mean over frames of the share of the frame's cars with a correct prediction.
        w_acc: The mean of the recalls, weighted by 1 / count, so rare actions have the largest weights.
    """

    recall: Mapping[str, float]
    counts: Mapping[str, int]
    a_acc: float
    w_acc: float

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        return asdict(self)


def vap_metrics(labels: ArrayLike, predictions: ArrayLike, frames: ArrayLike) -> VapMetrics:
    """Compute the metrics of the paper (LogiCity, NeurIPS 2024, Datasets and Benchmarks).

    The arguments have one entry per car, in any order. M is the number of cars in all frames.

    Args:
        labels: Integers (M,): the actions that the rules derive, as indices into `logicity.ACTIONS`.
        predictions: Integers (M,): the predicted actions.
        frames: Integers (M,): a number for each frame, equal for cars of the same frame.

    Raises:
        TypeError: If an argument is not an array of integers.
        ValueError: If there are no cars, the lengths differ, or a number is not an action.
    """
    actual, predicted = _integers("labels", labels), _integers("predictions", predictions)
    frame_ids = _integers("frames", frames)
    if not len(actual) == len(predicted) == len(frame_ids):
        raise ValueError(
            f"the lengths differ: {len(actual)} labels, {len(predicted)} predictions and {len(frame_ids)} frames"
        )
    if len(actual) == 0:
        raise ValueError("expected at least one car")
    for name, values in [("labels", actual), ("predictions", predicted)]:
        if values.min() < 0 or values.max() >= len(ACTIONS):
            invalid = values[(values < 0) | (values >= len(ACTIONS))][0]
            raise ValueError(f"expected {name} from 0 to {len(ACTIONS) - 1}, not {invalid}; omit pedestrians")
    correct = actual == predicted
    counts = np.bincount(actual, minlength=len(ACTIONS))
    occurs = np.flatnonzero(counts)
    recall = np.bincount(actual[correct], minlength=len(ACTIONS))[occurs] / counts[occurs]
    weights = 1 / counts[occurs]
    _, frame = np.unique(frame_ids, return_inverse=True)
    return VapMetrics(
        recall={ACTIONS[action]: float(share) for action, share in zip(occurs, recall, strict=True)},
        counts={ACTIONS[action]: int(counts[action]) for action in occurs},
        a_acc=float(np.mean(np.bincount(frame, correct) / np.bincount(frame))),
        w_acc=float((recall * weights).sum() / weights.sum()),
    )


def _integers(name: str, values: ArrayLike) -> NDArray[np.int64]:
    array = np.asarray(values)
    if array.ndim != 1:
        raise ValueError(f"expected {name} of shape (M,), not {array.shape}")
    # An empty list has the default dtype float64.
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise TypeError(f"expected integer {name}, not {array.dtype}")
    return array.astype(np.int64)
