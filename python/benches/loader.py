"""Throughput of a `DataLoader` on a shuffled data set with pictures: `python python/benches/loader.py FOLDER`.

The rest of the output splits the time by its causes. Needs the extra `vap`.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable

import numpy as np
import torch.utils.data

from logicity.vap import PICTURE_SIDE, VapDataset, collate, torch_dataset

#: Seconds that each figure is measured for, at least.
SECONDS = 5.0

BATCH = 8


def cpu_seconds() -> float:
    """Return the CPU seconds of this process, its threads, and the child processes that have ended."""
    own, workers = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + workers.ru_utime + workers.ru_stime


def rates(epoch: Callable[[], int]) -> tuple[float, float]:
    """Return samples per second and per CPU second; `epoch` returns the number of samples it has read."""
    epoch()
    begin, spent, done = time.perf_counter(), cpu_seconds(), 0
    while (passed := time.perf_counter() - begin) < SECONDS:
        done += epoch()
    return done / passed, done / (cpu_seconds() - spent)


def main() -> None:
    """Print the table."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = sys.argv[1]
    samples, tensors = VapDataset(folder), torch_dataset(folder)
    order = np.random.default_rng(0).permutation(len(samples)).tolist()
    pixels = np.empty((PICTURE_SIDE, PICTURE_SIDE, 3), np.uint8)
    batch = tensors.__getitems__(order[:BATCH])

    def loader(workers: int, threads: int = 1) -> int:
        read = torch_dataset(folder, threads=threads)
        batches = torch.utils.data.DataLoader(read, BATCH, shuffle=True, num_workers=workers, collate_fn=collate)
        return sum(len(batch["tick"]) for batch in batches)

    def each(read: Callable[[int], object]) -> int:
        for at in order:
            read(at)
        return len(order)

    rows: list[tuple[str, Callable[[], int]]] = [
        ("`DataLoader`, 2 workers", lambda: loader(2)),
        ("`DataLoader`, 1 worker", lambda: loader(1)),
        ("`DataLoader`, no worker", lambda: loader(0)),
        ("`DataLoader`, no worker, 2 threads", lambda: loader(0, 2)),
        ("the file of a picture", lambda: each(lambda at: samples.picture_path(at).read_bytes())),
        ("a picture decoded", lambda: each(lambda at: samples.read_picture(at, pixels))),
        ("all but the picture", lambda: each(samples.facts)),
        ("samples made a batch", lambda: BATCH * each(lambda at: collate(batch))),
    ]
    print("| | samples a second | a CPU second |\n|---|---|---|")
    for name, epoch in rows:
        a_second, a_cpu_second = rates(epoch)
        print(f"| {name} | {a_second:,.0f} | {a_cpu_second:,.0f} |", flush=True)


if __name__ == "__main__":
    main()
