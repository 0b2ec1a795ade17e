"""Read the samples of a data set of `logicity vap make` as numpy arrays."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import accumulate, pairwise
from operator import index as as_index
from pathlib import Path
from typing import Any, SupportsIndex, cast

import numpy as np
from numpy.typing import NDArray

from .. import _logicity
from ..errors import as_integer, checked_integer, checked_path
from ..files import read_json
from ..terminal import neutral
from ..types import Split

__all__ = ["BINARY", "PICTURE_SIDE", "UNARY", "VapDataset", "VapSample"]

UNARY = (
    "IsPedestrian",
    "IsCar",
    "IsAmbulance",
    "IsBus",
    "IsPolice",
    "IsTiro",
    "IsReckless",
    "IsOld",
    "IsYoung",
    "IsAtInter",
    "IsInInter",
)
"""The unary predicates, in the order of the paper and of the columns of `VapSample.unary`."""

BINARY = ("IsClose", "HigherPri", "CollidingClose", "LeftOf", "RightOf", "NextTo")
"""The binary predicates, in the order of the paper and of the last axis of `VapSample.binary`."""

PICTURE_SIDE = _logicity.PICTURE_SIDE
"""The side length of a picture in pixels, 1024."""

#: The supported versions of the data set format. From version 4 on, boxes may be larger than icons.
VERSIONS = (3, 4)


@dataclass(frozen=True, eq=False)
class VapSample:
    """A state of a city with N entities, and the labels: the actions that the rules derive.

    Entities are in the order of the agent list.

    Attributes:
        world: The number of the world. World and tick identify the sample.
        tick: The number of the tick.
        names: The names of the entities, such as `"Car_1"`.
        concepts: The concepts of the entities, such as `"ambulance"`, joined by `+`. Empty strings for entities without
            concepts.
        image: uint8 (1024, 1024, 3): rows, columns, and RGB channels. `None` if pictures are not read.
        boxes: float32 (N, 4): left edge, upper edge, width and height in pixels. NaN for entities outside the picture.
        visible: float32 (N,): the fraction of the pixels of an entity's icon in the picture that no other icon covers,
            from 0 to 1. NaN for entities outside the picture.
        h: float32 (N, 9), the node vectors of the paper. Columns 0 to 3 are the box divided by the side of the picture,
            from 0 to 1, or 0 for entities outside the picture. Columns 4 to 7 are the one-hot heading (left, right, up,
            down), or 0 before the first move. Column 8 is the priority divided by the largest priority of the sample. A
            smaller priority has the right of way.
        unary: bool (N, 11): whether predicate k of `UNARY` holds for entity i, at [i, k].
        binary: bool (N, N, 6): whether predicate k of `BINARY` holds for entities i and j, at [i, j, k].
        sees: bool (N, N): whether entity j is in the view of entity i, at [i, j].
        actions: int64 (N,): the action that the rules derive for each car, an index into `logicity.ACTIONS`, or -1 for
            pedestrians.
        mask: bool (N,): whether the entity is a car. Metrics count cars only.
    """

    world: int
    tick: int
    names: tuple[str, ...]
    concepts: tuple[str, ...]
    image: NDArray[np.uint8] | None
    boxes: NDArray[np.float32]
    visible: NDArray[np.float32]
    h: NDArray[np.float32]
    unary: NDArray[np.bool_]
    binary: NDArray[np.bool_]
    sees: NDArray[np.bool_]
    actions: NDArray[np.int64]
    mask: NDArray[np.bool_]


class VapDataset(Sequence[VapSample]):
    """The samples of a data set, ordered by world and tick.

    The tables of a world are read once and cached. A picture is read when its sample is accessed. Thread-safe: threads
    may read concurrently, and decoding pictures releases the GIL. Pickling and copying store the folder, not the data.

    Args:
        folder: A folder made by `logicity vap make`.
        images: Whether to read pictures.
        cached_worlds: The number of worlds whose tables are cached, at about 0.5 MB each. For random access, cache all
            worlds.

    Attributes:
        folder: The path of the folder.
        mode: The rules: `"easy"` or `"hard"`.
        split: The split: `"train"`, `"val"` or `"test"`.
        agents: The sets of agents: `"fixed"` or `"random"`.
        images: Whether pictures are read.
        has_pictures: Whether the data set has pictures, according to the manifest.
        has_masks: Whether it has masks.

    Raises:
        OSError: If a file cannot be read.
        TypeError: If the folder is not a path, or the number of worlds not an integer.
        ValueError: If the folder is not a data set of this version, `images=True` and the data set has no pictures, or
            the number of cached worlds is negative.
        InputError: On access to a sample whose table or picture is invalid.
    """

    def __init__(self, folder: str | os.PathLike[str], images: bool = True, *, cached_worlds: int = 128) -> None:
        """Read the manifest."""
        self.folder, self.images = Path(checked_path("folder", folder)), images
        settings, counts = _read_manifest(self.folder)
        self.has_pictures: bool = settings["pictures"]
        self.has_masks: bool = settings["masks"]
        if images and not self.has_pictures:
            raise ValueError(f"`{self.folder}` has no pictures: pass images=False (command line: `--no-pictures`)")
        self.mode: str = settings["mode"]
        self.agents: str = settings["agents"]
        self.split = cast(Split, settings["split"])
        self._cached_worlds = checked_integer("cached_worlds", cached_worlds, 0, 2**63 - 1)
        self._worlds = list(counts)
        #: The position of the first sample of each world, and the number of samples.
        self._begins = list(accumulate(counts.values(), initial=0))
        self._tables = lru_cache(maxsize=self._cached_worlds)(self._read_tables)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the folder."""
        return partial(VapDataset, cached_worlds=self._cached_worlds), (self.folder, self.images)

    def __repr__(self) -> str:
        """Show the mode, the agents, the split and the number of samples."""
        return f"<VapDataset {self.mode}, {self.agents} agents, {self.split}: {len(self)} samples>"

    def __len__(self) -> int:
        """Return the number of samples."""
        return self._begins[-1]

    def __getitem__(self, index: SupportsIndex) -> VapSample:  # type: ignore[override]
        """Read a sample. Its arrays are copies."""
        sample = self.facts(index)
        if not self.images:
            return sample
        image = np.empty((PICTURE_SIDE, PICTURE_SIDE, 3), np.uint8)
        self.read_picture(index, image)
        return replace(sample, image=image)

    def facts(self, index: SupportsIndex) -> VapSample:
        """Read a sample without its picture."""
        return deepcopy(self._cached(index))

    def worlds(self) -> dict[int, range]:
        """Return the positions of the samples of each world, by the number of the world."""
        return {world: range(*ends) for world, ends in zip(self._worlds, pairwise(self._begins), strict=True)}

    def picture_path(self, index: SupportsIndex) -> Path:
        """Return the path of a sample's picture, a PNG file."""
        sample = self._cached(index)
        return self._world_folder(sample.world) / f"frame-{sample.tick:03}.png"

    def read_picture(self, index: SupportsIndex, out: NDArray[np.uint8]) -> None:
        """Read the picture of a sample into an array of shape (1024, 1024, 3).

        Raises:
            InputError: If the picture is invalid.
            OSError: If the file cannot be read.
            ValueError: If the array has another shape, or is not C-contiguous.
        """
        if out.shape != (PICTURE_SIDE, PICTURE_SIDE, 3):
            raise ValueError(f"expected an array of shape (1024, 1024, 3), not {out.shape}")
        _logicity.read_picture(self.picture_path(index), out)

    def entity_mask(self, index: SupportsIndex) -> NDArray[np.uint8]:
        """Return which entity each pixel of a sample's picture shows, as uint8 (1024, 1024).

        A pixel is 0 where no entity shows, and otherwise one more than the position of the entity in the sample. Pixels
        count as in `VapSample.visible`.

        Raises:
            InputError: If the mask is invalid.
            OSError: If the file cannot be read.
            ValueError: If the data set has no masks.
        """
        if not self.has_masks:
            raise ValueError(f"`{self.folder}` has no masks: make it with masks=True (command line: `--masks`)")
        mask = np.empty((PICTURE_SIDE, PICTURE_SIDE), np.uint8)
        sample = self._cached(index)
        _logicity.read_mask(self._world_folder(sample.world) / f"mask-{sample.tick:03}.png", mask)
        return mask

    def iterate(self, seed: int = 0, *, shuffle: bool = True, shard: tuple[int, int] = (0, 1)) -> Iterator[VapSample]:
        """Iterate over the samples once, in an order that the seed determines.

        Args:
            seed: The seed, at least 0. Use a different seed for each epoch to change the order.
            shuffle: Whether to shuffle. Otherwise the order is by world and tick.
            shard: A pair (i, n) that selects every n-th sample of that order, starting at sample i. The shards 0 to
                n - 1 partition the samples.

        Raises:
            TypeError: If the seed is not an integer, or the shard not a pair of integers.
            ValueError: If the seed is negative, or the shard index is not from 0 to n - 1.
        """
        try:
            part, parts = (as_integer("shard", number) for number in shard)
        except (TypeError, ValueError):
            raise TypeError(f"shard: expected a pair of integers, not {shard!r}") from None
        if not 0 <= part < parts:
            raise ValueError(f"`shard` must be a pair (i, n) with 0 <= i < n, not ({part}, {parts})")
        random = np.random.default_rng(checked_integer("seed", seed))
        order = random.permutation(len(self)) if shuffle else np.arange(len(self))
        return (self[position] for position in order[part::parts])

    def _cached(self, index: SupportsIndex) -> VapSample:
        try:
            # Negative indices count from the end.
            position = range(len(self))[as_index(index)]
        except IndexError:
            raise IndexError(f"no sample {as_index(index)}: the data set has {len(self)} samples") from None
        which = bisect_right(self._begins, position) - 1
        return self._tables(which)[position - self._begins[which]]

    def _read_tables(self, which: int) -> list[VapSample]:
        world, listed = self._worlds[which], self._begins[which + 1] - self._begins[which]
        folder = self._world_folder(world)
        # Rows are entities or pairs of entities, concatenated over all samples.
        tables = _logicity.read_world(folder, world, list(UNARY), list(BINARY))
        ticks, starts, names, concepts, numbers, boxes, visible, unary, binary, sees = tables
        if len(ticks) != listed:
            raise ValueError(f"`{folder}` has {len(ticks)} frames, the manifest lists {listed}")
        samples, end_of_pairs = [], 0
        for tick, ends in zip(ticks.tolist(), pairwise(starts.tolist()), strict=True):
            own, count = slice(*ends), ends[1] - ends[0]
            pairs = slice(end_of_pairs, end_of_pairs + count**2)
            end_of_pairs = pairs.stop
            priorities, headings, actions = (each[own] for each in numbers)
            sample = VapSample(
                world=world,
                tick=tick,
                names=tuple(names[own]),
                concepts=tuple(concepts[own]),
                image=None,
                boxes=boxes[own],
                visible=visible[own],
                h=_node_vectors(boxes[own], headings, priorities),
                unary=unary[own],
                binary=binary[pairs].reshape(count, count, len(BINARY)),
                sees=sees[pairs].reshape(count, count),
                actions=actions,
                mask=actions >= 0,
            )
            samples.append(sample)
        return samples

    def _world_folder(self, world: int) -> Path:
        return self.folder / f"world-{world:05}"


def symbolic_facts(
    names: Sequence[str], unary: NDArray[np.bool_], binary: NDArray[np.bool_], sees: NDArray[np.bool_]
) -> dict[str, list[Any]]:
    """Return the facts of n entities in the format of `SymbolicScene`, in the order of the entities.

    The truth values are those of `UNARY`, (n, 11), of `BINARY`, (n, n, 6), and of `Sees`, (n, n).
    """
    facts: dict[str, list[Any]] = {
        predicate: [names[entity] for entity in np.flatnonzero(holds).tolist()]
        for predicate, holds in zip(UNARY, unary.T, strict=True)
    }
    matrices = [*np.moveaxis(binary, -1, 0), sees]
    for predicate, holds in zip((*BINARY, "Sees"), matrices, strict=True):
        facts[predicate] = [[names[first], names[second]] for first, second in np.argwhere(holds).tolist()]
    return facts


def _read_manifest(folder: Path) -> tuple[dict[str, Any], dict[int, int]]:
    """Return the settings of a data set, and the number of frames by world."""
    with reading_manifest(folder / "manifest.json") as path:
        manifest = read_json(path)
        settings = manifest["settings"]
        data, version = settings["data"], settings["version"]
    if data != "logicity vap" or version not in VERSIONS:
        raise ValueError(
            f"`{path}` belongs to a data set `{neutral(str(data))}` of version {neutral(str(version))}; "
            f"this package reads versions {VERSIONS[0]} and {VERSIONS[1]}; make the data set again with "
            "`logicity vap make`"
        )
    with reading_manifest(path):
        counts = {count_in(world, "world"): count_in(world, "frames") for world in manifest["worlds"]}
        found = {name: settings[name] for name in ("mode", "agents", "split", "pictures")}
        return {**found, "masks": settings.get("masks", False)}, counts


def count_in(world: Mapping[str, Any], key: str) -> int:
    number = world[key]
    if type(number) is not int or not 0 <= number < 2**31:
        raise ValueError(f"`{key}` is not an integer from 0 to 2**31 - 1")
    return number


@contextmanager
def reading_manifest(path: Path) -> Iterator[Path]:
    """Name the manifest in the exceptions of its reader."""
    try:
        yield path
    except FileNotFoundError as error:
        reason = "no data set is here; `logicity vap make` makes one"
        raise FileNotFoundError(error.errno, reason, os.fspath(path)) from None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        reason = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)
        raise ValueError(f"`{path}` is not a manifest of `logicity vap make`: {reason}") from None


def _node_vectors(
    boxes: NDArray[np.float32], headings: NDArray[np.int64], priorities: NDArray[np.int64]
) -> NDArray[np.float32]:
    vectors = np.zeros((len(boxes), 9), np.float32)
    vectors[:, :4] = np.nan_to_num(boxes / PICTURE_SIDE)
    headed = np.flatnonzero(headings >= 0)
    vectors[headed, 4 + headings[headed]] = 1
    vectors[:, 8] = priorities / max(1, priorities.max(initial=1))
    return vectors
