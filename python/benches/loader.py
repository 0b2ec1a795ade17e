"""Measure a `DataLoader` on a shuffled data set with pictures: `python python/benches/loader.py FOLDER`.

The output has the throughput of the loader and of each part of its work. Needs the extra `vap`.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable

import numpy as np
import torch.utils.data

from logicity.vap import PICTURE_SIDE, VapDataset, collate, torch_dataset

#: The minimum duration of each measurement, in seconds.
SECONDS = 5.0

BATCH = 8


def cpu_seconds() -> float:
    """Return the CPU time of this process, its threads, and its terminated child processes, in seconds."""
    own, workers = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + workers.ru_utime + workers.ru_stime


def rates(epoch: Callable[[], int]) -> tuple[float, float]:
    """Return samples per second and per CPU second. `epoch` returns the number of samples that it read."""
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
        ("reading one picture file", lambda: each(lambda at: samples.picture_path(at).read_bytes())),
        ("decoding one picture", lambda: each(lambda at: samples.read_picture(at, pixels))),
        ("reading a sample without its picture", lambda: each(samples.facts)),
        ("collating a batch", lambda: BATCH * each(lambda at: collate(batch))),
    ]
    print("| | samples per second | samples per CPU second |\n|---|---|---|")
    for name, epoch in rows:
        per_second, per_cpu_second = rates(epoch)
        print(f"| {name} | {per_second:,.0f} | {per_cpu_second:,.0f} |", flush=True)


if __name__ == "__main__":
    main()
