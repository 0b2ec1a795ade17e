"""Create and check data sets, as `logicity vap make` and `logicity vap check` do."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from .. import _logicity
from ..errors import checked_integer, checked_path, checked_threads
from ..types import Action, Split
from .data import VapDataset

__all__ = ["Drawing", "VapCounts", "check_dataset", "make_dataset"]


@dataclass(frozen=True)
class Drawing:
    """How pictures and their boxes are drawn.

    Attributes:
        difficulty: The difficulty of the pictures, from 0 (clean) to 100: how much colors, light, sharpness, weather,
            markings and surroundings vary. From 50 on, the sides of boxes are independent of the agents. Above 50,
            icons of the test split increasingly have a style that the other splits lack.
        version: The version of the drawing code: 2, or 1 for boxes that fit the icons, one style for all splits and no
            weather, as in data sets of format 3.
        pack: A folder of icons, such as `logicity.icons.fill` creates. Built-in icons represent classes that it lacks.
        pack_mode: `"extend"` adds the icons of the pack to the built-in icons. `"replace"` uses only the icons of the
            pack for its classes.
    """

    difficulty: int = 50
    version: Literal[1, 2] = 2
    pack: str | os.PathLike[str] | None = None
    pack_mode: Literal["extend", "replace"] = "extend"


@dataclass(frozen=True)
class VapCounts:
    """The counts of a data set.

    Attributes:
        worlds: The number of worlds.
        frames: The number of frames in all worlds.
        pictures: The number of pictures: one per frame, or 0.
        agents: The number of agents, summed over all frames.
        actions: The number of cars by label.
        published_actions: The number of cars by label in the paper's fixed test set.
        concepts: The number of agents by concept. Agents without concepts count by type.
        atoms: The number of true atoms by predicate. A binary atom counts if its first agent sees its second.
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
    masks: bool = False,
    drawing: Drawing = Drawing(),
    threads: int = 0,
    progress: Callable[[int, int], object] | None = None,
    overwrite: bool = False,
) -> VapDataset:
    """Create a data set, or resume an interrupted call. The files equal those of `logicity vap make`.

    World k depends only on the arguments and k. Worlds that already exist in the folder are kept. After Ctrl-C or an
    exception in `progress`, complete worlds stay in the folder, and another call with the same arguments creates the
    others. Releases the GIL. A second process that writes the same folder fails at once.

    Args:
        folder: The folder to write, which is created if it does not exist.
        mode: The rules: those of `configs/vap-easy.yaml` or `configs/vap-hard.yaml`.
        split: The split.
        agents: `"fixed"` takes the agents of the configuration. `"random"` draws the agents of each world.
        worlds: The number of worlds, from 1 to 100000. Default: 100 for `"train"`, 20 otherwise.
        first_world: The number of the first world, from 0 to 99999.
        seed: The seed, from 0 to 2**64 - 1.
        images: Whether to write pictures. This does not affect the tables.
        masks: Whether to write masks, which say what agent each pixel shows. This does not affect the other files.
        drawing: How pictures and their boxes are drawn.
        threads: The number of threads, up to 1024; 0 means one per core. It does not affect the files.
        progress: A function that receives the number of finished frames and the total, on the calling thread.
        overwrite: Whether to replace a `README.md` or `manifest.json` that is not of a data set with these arguments.
            Other files and other worlds are never replaced.

    Returns:
        The data set with all worlds in the folder.

    Raises:
        FileExistsError: If the folder has worlds with other settings, rules or pictures, files that must not be
            replaced, or files that belong to no data set. Then nothing changes.
        KeyboardInterrupt: On Ctrl-C.
        OSError: If a file cannot be read or written.
        TypeError: If an argument has a wrong type.
        ValueError: If a name is unknown, a number is out of range, or an icon is invalid.

    Example:
        >>> from logicity.vap import make_dataset
        >>> make_dataset("vap-test", "hard", "test", worlds=2)  # doctest: +SKIP
        <VapDataset hard, fixed agents, test: 178 samples>
    """
    _logicity.make_dataset(
        checked_path("folder", folder),
        mode,
        split,
        agents,
        None if worlds is None else checked_integer("worlds", worlds, 1, _logicity.WORLDS_MAX),
        checked_integer("first_world", first_world, 0, _logicity.WORLDS_MAX - 1),
        checked_integer("seed", seed),
        images,
        masks,
        None if drawing.pack is None else checked_path("pack", drawing.pack),
        drawing.pack_mode,
        checked_integer("difficulty", drawing.difficulty, 0, 100),
        checked_integer("version", drawing.version, 1, 2),
        checked_threads(threads),
        progress,
        overwrite,
    )
    return VapDataset(folder, images)


def check_dataset(
    folder: str | os.PathLike[str], *, threads: int = 0, progress: Callable[[int, int], object] | None = None
) -> VapCounts:
    """Check a data set as `logicity vap check` does.

    The check covers files, hashes, order, pictures and boxes. It derives every label again from the facts. `progress`
    receives the number of checked worlds and the total, on the calling thread. Releases the GIL.

    Raises:
        InputError: If the data set has errors. `diagnostics` lists all of them.
        KeyboardInterrupt: On Ctrl-C.
        OSError: If the folder or its manifest cannot be read.
        ValueError: If the number of threads is not from 0 to 1024.
    """
    return VapCounts(**_logicity.check_dataset(checked_path("folder", folder), checked_threads(threads), progress))
