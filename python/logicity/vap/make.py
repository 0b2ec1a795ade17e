"""Making and checking data sets, as `logicity vap make` and `logicity vap check` do."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from .. import _logicity
from ..types import Action, Split
from .data import VapDataset

__all__ = ["VapCounts", "check_dataset", "make_dataset"]


@dataclass(frozen=True)
class VapCounts:
    """The counts of a data set.

    Attributes:
        worlds: The number of worlds.
        frames: The number of frames in all worlds.
        pictures: The number of pictures: one for each frame, or 0.
        agents: The number of agents in all frames.
        actions: The number of cars with each label.
        published_actions: The same for the fixed test set of the paper.
        concepts: The number of agents with each concept. Agents without concepts count by type.
        atoms: The number of true atoms by predicate. An atom over two agents counts if the first sees the second.
    """

    worlds: int
    frames: int
    pictures: int
    agents: int
    actions: Mapping[Action, int]
    published_actions: Mapping[Action, int]
    concepts: Mapping[str, int]
    atoms: Mapping[str, int]


def make_dataset(
    folder: str | os.PathLike[str],
    mode: Literal["easy", "hard"],
    split: Split,
    *,
    agents: Literal["fixed", "random"] = "fixed",
    worlds: int | None = None,
    first_world: int = 0,
    seed: int = 0,
    images: bool = True,
    pack: str | os.PathLike[str] | None = None,
    pack_mode: Literal["extend", "replace"] = "extend",
    difficulty: int = 50,
    threads: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> VapDataset:
    """Make a data set, or resume an interrupted one. The files are those of `logicity vap make`.

    World k is a function of seed, split and k. Worlds in the folder stay as they are; the others are made. Releases the
    GIL. After Ctrl-C or an exception in `progress`, the complete worlds stay in the folder, and another call with the
    same arguments makes the others. Only one process at a time may write to a folder.

    Args:
        folder: The folder to write. It is made if it does not exist.
        mode: The rules: those of `configs/vap-easy.yaml` or `configs/vap-hard.yaml`.
        split: The split.
        agents: The agents: those of the configuration, or drawn for each world.
        worlds: The number of worlds, 1 to 100000 (default: 100 for `"train"`, else 20).
        first_world: The number of the first world, 0 to 99999.
        seed: The seed of all draws, from 0 to 2**64 - 1.
        images: Whether to draw pictures. Without pictures the tables are the same.
        pack: A folder of icons, as `logicity.icons.fill` makes it. Classes that it lacks are drawn.
        pack_mode: `"extend"` adds the icons of the pack to the drawn ones, `"replace"` shows only the icons of the pack
            for its classes.
        difficulty: From 0, clean, to 100, noisy: how much colors, light, sharpness, markings and surroundings vary.
        threads: The number of threads, up to 1024; 0 means one for each core. The files are the same.
        progress: A function that receives the numbers of frames made and to make. It is called on the calling thread.

    Returns:
        The data set with all worlds in the folder.

    Raises:
        InputError: If the folder has worlds with other settings, rules or pictures.
        LimitError: If there are too many threads.
        KeyboardInterrupt: On Ctrl-C.
        OSError: If a file cannot be read or written.
        OverflowError: If a number is negative, or does not fit its integer type.
        ValueError: If a name is unknown, a number is out of range, or an icon is invalid.

    Example:
        >>> from logicity.vap import make_dataset
        >>> make_dataset("vap-test", "hard", "test", worlds=2)  # doctest: +SKIP
        <VapDataset hard, fixed agents, test: 178 samples>
    """
    _logicity.make_dataset(
        folder,
        mode,
        split,
        agents,
        worlds,
        first_world,
        seed,
        images,
        pack,
        pack_mode,
        difficulty,
        threads,
        progress,
    )
    return VapDataset(folder, images)


def check_dataset(
    folder: str | os.PathLike[str], *, threads: int = 0, progress: Callable[[int, int], object] | None = None
) -> VapCounts:
    """Check a data set as `logicity vap check` does.

    Checks files, hashes, order, pictures and boxes, and derives every label from the facts. Releases the GIL.

    Args:
        folder: A folder made by `make_dataset` or `logicity vap make`.
        threads: As for `make_dataset`.
        progress: A function that receives the numbers of worlds checked and to check. It is called on the calling
            thread.

    Returns:
        The counts of the data set.

    Raises:
        InputError: If the data set has errors. `diagnostics` lists all of them.
        KeyboardInterrupt: On Ctrl-C.
        OSError: If the folder or its manifest cannot be read.
        OverflowError: If the number of threads is negative.
        ValueError: If there are too many threads.
    """
    return VapCounts(**_logicity.check_dataset(folder, threads, progress))
