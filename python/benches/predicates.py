"""Measure the price of a Python predicate per tick: `python python/benches/predicates.py`.

Prints milliseconds of wall-clock time per tick, without predicates, with one over an agent, and with one over a pair of
agents. The rules read no predicate of Python, so that all cities do the same.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

import logicity

#: The minimum duration of each measurement, in seconds.
SECONDS = 2.0
#: The number of times that the agents of expert mode are in the city.
REPEATS = (1, 4, 16)
#: The number of alternating measurements, of which the fastest counts.
ROUNDS = 3


@logicity.predicate("IsGreen")
def is_green(state: logicity.CityState) -> npt.NDArray[np.bool_]:
    """Return the agents whose row and tick are even."""
    green: npt.NDArray[np.bool_] = (state.positions[:, 0] + state.tick) % 2 == 0
    return green


@logicity.predicate("IsRival")
def is_rival(state: logicity.CityState) -> npt.NDArray[np.bool_]:
    """Return the pairs of agents of equal priority."""
    rivals: npt.NDArray[np.bool_] = state.priorities[:, None] == state.priorities[None, :]
    return rivals


CASES = {
    "none": ("", []),
    "one agent": ("IsGreen: {external: agent}", [is_green]),
    "two agents": ("IsRival: {external: pair}", [is_rival]),
}


def milliseconds(city: logicity.Simulation) -> float:
    """Return the time of a tick."""
    city.run(50)
    begin, ticks = time.perf_counter(), 0
    while (spent := time.perf_counter() - begin) < SECONDS:
        city.run(20)
        ticks += 20
    return spent / ticks * 1000


def main() -> None:
    """Print a row per number of agents."""
    print("agents  " + "  ".join(f"{name:>12}" for name in CASES) + "   (ms per tick)")
    with tempfile.TemporaryDirectory() as folder:
        for repeat in REPEATS:
            cities = []
            for position, (define, predicates) in enumerate(CASES.values()):
                path = Path(folder) / f"{position}-{repeat}.yaml"
                path.write_text(
                    f"base: expert\npredicates: {{define: {{{define}}}}}\nagents: {{test: {{repeat: {repeat}}}}}\n"
                )
                cities.append(logicity.Simulation(path, predicates=predicates))
            best = [min(milliseconds(city) for _ in range(ROUNDS)) for city in cities]
            print(f"{len(cities[0].agents):6}  " + "  ".join(f"{time:12.4f}" for time in best))


if __name__ == "__main__":
    main()
