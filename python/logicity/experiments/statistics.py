"""Intervals of measures over several runs on the same samples: a bootstrap over runs and, independently, samples."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..evaluation import Interval

__all__ = ["bootstrap_weights", "pooled"]

#: The number of samples of a bootstrap interval.
SAMPLES = 2000


def bootstrap_weights(generator: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return bootstrap weights, float64 (`SAMPLES`, count). Each row sums to 1."""
    drawn = generator.multinomial(count, np.full(count, 1 / count), SAMPLES)
    weights: NDArray[np.float64] = drawn / count
    return weights


def pooled(tables: Sequence[Mapping[str, NDArray[np.float64]]], rates: Collection[str] = ()) -> dict[str, Interval]:
    """Return the means of measures over runs with 95 % intervals, which are percentiles of a bootstrap.

    A rate of 0 or 1, of which a bootstrap says nothing, has the Wilson interval over the episodes of one run.

    Args:
        tables: For each run, the values of each measure by episode, float64 (E,).
        rates: The measures whose values are 0 or 1.
    """
    generator = np.random.default_rng(0)
    result = {}
    for name in tables[0]:
        values = np.stack([table[name] for table in tables])
        runs, episodes = values.shape
        of_runs, of_episodes = bootstrap_weights(generator, runs), bootstrap_weights(generator, episodes)
        samples = np.einsum("sr,re,se->s", of_runs, values, of_episodes, optimize=True)
        low, high = np.percentile(samples, [2.5, 97.5])
        result[name] = Interval(float(values.mean()), float(low), float(high))
        if name in rates and values.min() == values.max():
            # The runs share their episodes, so their number does not count.
            result[name] = Interval.of_share(int(values[0].sum()), episodes)
    return result
