"""Measure rules learned from demonstrations: `python python/benches/induction.py [--subsets COUNT] [MODE...]`.

The first table learns from all 100 recorded training episodes of each mode. It measures TSR and DSR on the 100 test
episodes, and the CPU seconds of the learner alone. The second table learns from subsets of the training episodes, drawn
with the seeds 0, 1, ....
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np

import logicity

#: The numbers of training episodes in a subset.
SIZES = (5, 10, 25, 50, 75)


def learned(mode: str, episodes: Sequence[logicity.Trajectory]) -> tuple[logicity.InducedRules, float]:
    """Return rules learned from some episodes, and the CPU seconds that the learner took."""
    begin = time.process_time()
    rules = logicity.induce(episodes, mode)
    return rules, time.process_time() - begin


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modes", nargs="*", metavar="MODE", help="modes [default: all]")
    parser.add_argument("--subsets", type=int, default=10, help="subsets of each size [default: 10]")
    arguments = parser.parse_args()
    modes = arguments.modes or list(logicity.ENVIRONMENTS)
    print("mode              examples  clauses   TSR   DSR  CPU s")
    benchmarks = {}
    for mode in modes:
        demonstrations = logicity.demonstrations(mode)
        benchmarks[mode] = (demonstrations, logicity.Benchmark(mode))
        rules, seconds = learned(mode, demonstrations)
        result = benchmarks[mode][1].evaluate(rules, batched=True)
        examples = rules.report["examples"]
        print(
            f"{mode:<17} {examples:>8} {len(rules.clauses):>8}  {result.tsr.value:.2f}  {result.dsr.value:.2f} "
            f"{seconds:>6.2f}",
            flush=True,
        )
    print(f"\nmean (worst) TSR over {arguments.subsets} subsets of the training episodes")
    print(f"{'mode':<17}" + "".join(f"{size:>14}" for size in SIZES))
    for mode, (demonstrations, benchmark) in benchmarks.items():
        cells = []
        for size in SIZES:
            rates = []
            for seed in range(arguments.subsets):
                chosen = np.random.default_rng(seed).choice(len(demonstrations), size, replace=False)
                rules, _ = learned(mode, [demonstrations[int(episode)] for episode in sorted(chosen)])
                rates.append(benchmark.evaluate(rules, batched=True).tsr.value)
            cells.append(f"{np.mean(rates):.2f} ({min(rates):.2f})")
        print(f"{mode:<17}" + "".join(f"{cell:>14}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
