"""Samples a second that a `DataLoader` reads of a data set with pictures: `python python/benches/loader.py FOLDER`.

Two workers, a batch of 8 shuffled samples; and where the time of one process goes. Needs the extra `vap`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from itertools import cycle

import numpy as np
import torch.utils.data

from logicity.vap import PICTURE_SIDE, VapDataset, collate, torch_dataset

#: Seconds that each figure is measured for, at least.
SECONDS = 5.0

BATCH = 8


def rate(turns: Iterator[object], each: int) -> float:
    """Samples a second; a turn gives so many. The first turns, in which workers start, are not counted."""
    for _ in range(8):
        next(turns)
    begin, done = time.perf_counter(), 0
    while (spent := time.perf_counter() - begin) < SECONDS:
        next(turns)
        done += each
    return done / spent


def main() -> None:
    """Print the table."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    folder = sys.argv[1]
    samples, tensors = VapDataset(folder), torch_dataset(folder)
    order = np.random.default_rng(0).permutation(len(samples)).tolist()
    pixels = np.empty((PICTURE_SIDE, PICTURE_SIDE, 3), np.uint8)
    planes = np.empty((3, PICTURE_SIDE, PICTURE_SIDE), np.uint8)
    batch = [tensors[at] for at in order[:BATCH]]

    def loader(workers: int) -> Iterator[object]:
        batches = torch.utils.data.DataLoader(
            tensors,
            BATCH,
            shuffle=True,
            num_workers=workers,
            collate_fn=collate,
            drop_last=True,
            persistent_workers=workers > 0,
        )
        while True:
            yield from batches

    def calls(read: Callable[[int], object]) -> Iterator[None]:
        for at in cycle(order):
            read(at)
            yield

    rows: list[tuple[str, Iterator[object], int]] = [
        ("`DataLoader`, 2 workers", loader(2), BATCH),
        ("`DataLoader`, 1 worker", loader(1), BATCH),
        ("`DataLoader`, no worker", loader(0), BATCH),
        ("the file of a picture", calls(lambda at: samples.picture_path(at).read_bytes()), 1),
        ("a picture decoded", calls(lambda at: samples.read_picture(at, pixels)), 1),
        ("the same in planes", calls(lambda at: samples.read_picture(at, planes)), 1),
        ("all but the picture", calls(samples.facts), 1),
        ("samples made a batch", calls(lambda at: collate(batch)), BATCH),
    ]
    print("| | samples a second |\n|---|---|")
    for name, turns, each in rows:
        print(f"| {name} | {rate(turns, each):,.0f} |", flush=True)


if __name__ == "__main__":
    main()
