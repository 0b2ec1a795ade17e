"""Groups of runs, and intervals of measures over several runs, by a bootstrap.

`pooled` is for runs on the same samples: it draws runs and, independently, samples. `pooled_shares` is for runs on
different samples, which come in clusters: it draws runs and, in each of them, clusters.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..evaluation import Interval

__all__ = ["bootstrap_weights", "grouped", "pooled", "pooled_shares"]

Key = TypeVar("Key")
Value = TypeVar("Value")

#: The number of samples of a bootstrap interval.
SAMPLES = 2000


def grouped(pairs: Iterable[tuple[Key, Value]]) -> dict[Key, list[Value]]:
    """Return the values of each key, in their order."""
    groups: dict[Key, list[Value]] = {}
    for key, value in pairs:
        groups.setdefault(key, []).append(value)
    return groups


def bootstrap_weights(generator: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Return bootstrap weights, float64 (`SAMPLES`, count). Each row sums to 1."""
    drawn = generator.multinomial(count, np.full(count, 1 / count), SAMPLES)
    weights: NDArray[np.float64] = drawn / count
    return weights


def pooled(tables: Sequence[Mapping[str, NDArray[np.float64]]], rates: Collection[str] = ()) -> dict[str, Interval]:
    """Return the means of measures over runs with 95 % intervals, which are percentiles of a bootstrap.

    A rate of 0 or 1, of which a bootstrap says nothing, has the Wilson interval over the episodes of one run. Each run
    has a table of the values of each measure by episode, float64 (E,); those of rates are 0 or 1.
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


def pooled_shares(runs: Sequence[Mapping[str, NDArray[np.float64]]]) -> dict[str, Interval]:
    """Return shares over runs on different samples with 95 % intervals.

    A share is that of the successes among the trials of all runs. The intervals are percentiles of a two-stage
    bootstrap (Davison and Hinkley, 1997, section 3.8), which draws runs and, in each drawn run, clusters of samples. A
    share of 0 or 1, of which a bootstrap says nothing, has the Wilson interval over the clusters with trials. A share
    without trials is missing. Each run has the number of successes and of trials of each share by cluster, float64
    (C, 2).
    """
    generator = np.random.default_rng(0)
    names = list(runs[0])
    counts = {name: np.zeros((SAMPLES, 2)) for name in names}
    for drawn in generator.integers(len(runs), size=(len(runs), SAMPLES)):
        for at, run in enumerate(runs):
            clusters = len(run[names[0]])
            weights = bootstrap_weights(generator, clusters) * clusters * (drawn == at)[:, None]
            for name in names:
                counts[name] += weights @ run[name]
    result = {}
    for name in names:
        successes, trials = sum(run[name].sum(0) for run in runs)
        if trials == 0:
            continue
        with np.errstate(invalid="ignore"):
            samples = counts[name][:, 0] / counts[name][:, 1]
        low, high = np.percentile(samples[~np.isnan(samples)], [2.5, 97.5])
        result[name] = Interval(float(successes / trials), float(low), float(high))
        if successes in (0, trials):
            clusters = sum(int((run[name][:, 1] > 0).sum()) for run in runs)
            result[name] = Interval.of_share(clusters if successes else 0, clusters)
    return result
