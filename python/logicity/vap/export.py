"""Conversion of data sets to the formats WebDataset and COCO."""

from __future__ import annotations

import io
import json
import os
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..city import ACTIONS
from ..errors import checked_integer, checked_path
from ..evaluation import Progress
from ..files import check_readable, check_writable, write_json
from .data import BINARY, PICTURE_SIDE, UNARY, VapDataset, VapSample

__all__ = ["to_coco", "to_webdataset"]

#: The types of the categories, in order. Combinations of concepts follow.
CATEGORIES = {
    **dict.fromkeys(("car", "ambulance", "bus", "police", "tiro", "reckless"), "Car"),
    **dict.fromkeys(("pedestrian", "old", "young"), "Pedestrian"),
}


def to_webdataset(
    folder: str | os.PathLike[str], out_dir: str | os.PathLike[str], shard_size: int = 1000, *, images: bool = True
) -> list[Path]:
    """Write a data set as tar files in the format of the package `webdataset`.

    A sample such as `world-00000-frame-011` has three files. `.png` is the picture. `.npz` has the arrays of
    `VapSample`. `.json` has `world`, `tick`, `names`, `concepts`, `mode`, `split`, and the predicate names `unary` and
    `binary`. Equal data sets give identical bytes.

    Args:
        folder: A folder made by `logicity vap make`.
        out_dir: The folder to create, atomically, with `shard-000000.tar` and so on.
        shard_size: The number of samples per file, at least 1. The last file may have fewer.
        images: Whether to include pictures.

    Returns:
        The paths of the tar files.

    Raises:
        FileExistsError: If `out_dir` exists.
        OSError: If a file cannot be read or written.
        ValueError: As for `VapDataset`, or if `shard_size` is below 1.
    """
    shard_size = checked_integer("shard_size", shard_size, 1)
    target = Path(checked_path("out_dir", out_dir))
    samples = VapDataset(folder, images)
    if target.exists():
        raise FileExistsError(f"`{target}` already exists")
    target.parent.mkdir(parents=True, exist_ok=True)
    name = f".{target.name}-"
    with tempfile.TemporaryDirectory(prefix=name, dir=target.parent, ignore_cleanup_errors=True) as partial:
        with Progress("sample", len(samples)) as progress:
            for first in range(0, len(samples), shard_size):
                with tarfile.open(Path(partial, f"shard-{first // shard_size:06}.tar"), "w") as tar:
                    for index in range(first, min(first + shard_size, len(samples))):
                        _add_sample(tar, samples, index)
                        progress.update(index + 1)
        os.chmod(partial, 0o755)
        os.rename(partial, target)
    return sorted(target.iterdir())


def _add_sample(tar: tarfile.TarFile, samples: VapDataset, index: int) -> None:
    sample = samples.facts(index)
    record = {name: getattr(sample, name) for name in ("world", "tick", "names", "concepts")}
    record |= {"mode": samples.mode, "split": samples.split, "unary": UNARY, "binary": BINARY}
    arrays = io.BytesIO()
    named: dict[str, Any] = {name: value for name, value in vars(sample).items() if isinstance(value, np.ndarray)}
    np.savez_compressed(arrays, **named)
    contents = {"json": json.dumps(record).encode(), "npz": arrays.getvalue()}
    if samples.images:
        picture = samples.picture_path(index)
        check_readable(picture)
        contents["png"] = picture.read_bytes()
    for ending, content in contents.items():
        # The name up to the first dot identifies the sample. Owner and time remain zero, so the bytes are reproducible.
        entry = tarfile.TarInfo(f"world-{sample.world:05}-frame-{sample.tick:03}.{ending}")
        entry.size = len(content)
        tar.addfile(entry, io.BytesIO(content))


def to_coco(
    folder: str | os.PathLike[str], out: str | os.PathLike[str], *, images: bool = True, overwrite: bool = False
) -> None:
    """Write the boxes, and the masks if there are some, of a data set as COCO JSON, atomically.

    Beyond the keys of COCO, the file has these:

    - `info` has `pictures`, which is false if the data set has no pictures.
    - `images` have `world` and `tick`. Each `file_name` is relative to the folder of the data set.
    - `annotations` have `name`, `concepts`, `visible` (the fraction of the icon that no other icon covers) and, for
      cars, `action`. Each entity in the picture has an annotation. Its `bbox` is the left edge, upper edge, width and
      height in pixels, and its `area` is that of the box. With masks, `segmentation` has the run lengths of the pixels
      that the entity shows, without compression, and `area` is their number.
    - `categories` are `car`, `ambulance`, `bus`, `police`, `tiro`, `reckless`, `pedestrian`, `old` and `young`, with
      ids from 1, followed by the combinations of concepts that occur, such as `bus+tiro`. The `supercategory` is `Car`
      or `Pedestrian`.

    With `images`, the data set must have pictures, which are not read.

    Raises:
        FileExistsError: If this function did not write the file, or it has changed since, without `overwrite`.
        OSError: If a file cannot be read or written.
        ValueError: As for `VapDataset`.
    """
    target = checked_path("out", out)
    samples = VapDataset(folder, images)
    check_writable(target, by="vap coco", overwrite=overwrite)
    pictures: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    kinds: dict[str, str] = {}
    with Progress("sample", len(samples)) as progress:
        for index in range(len(samples)):
            sample = samples.facts(index)
            place = samples.picture_path(index).relative_to(samples.folder).as_posix()
            picture = {"id": index, "file_name": place, "width": PICTURE_SIDE, "height": PICTURE_SIDE}
            pictures.append({**picture, "world": sample.world, "tick": sample.tick})
            mask = samples.entity_mask(index) if samples.has_masks else None
            for annotation in _annotations(sample, mask):
                kinds[annotation["category"]] = annotation.pop("type")
                annotations.append({"id": len(annotations) + 1, "image_id": index, **annotation})
            progress.update(index + 1)
    several = sorted(set(kinds) - set(CATEGORIES))
    categories = [
        {"id": number, "name": name, "supercategory": CATEGORIES.get(name) or kinds[name]}
        for number, name in enumerate([*CATEGORIES, *several], 1)
    ]
    numbers = {category["name"]: category["id"] for category in categories}
    for annotation in annotations:
        annotation["category_id"] = numbers[annotation.pop("category")]
    title = f"LogiCity, Visual Action Prediction, {samples.mode}, {samples.split}"
    info = {"description": title, "pictures": samples.has_pictures}
    content = {"info": info, "images": pictures, "annotations": annotations, "categories": categories}
    write_json(target, content, by="vap coco", overwrite=overwrite)


def _run_lengths(shown: NDArray[np.bool_]) -> list[int]:
    """Return the lengths of the runs of a mask in columns, in turn of 0 and of 1, as COCO has them."""
    column = shown.T.ravel()
    changes = np.flatnonzero(np.diff(column)) + 1
    lengths = np.diff([0, *changes.tolist(), column.size]).tolist()
    return [0, *lengths] if column[0] else list(lengths)


def _annotations(sample: VapSample, mask: NDArray[np.uint8] | None = None) -> Iterator[dict[str, Any]]:
    """Yield the annotations of the entities in a picture, with the names of their types and categories."""
    for entity in np.flatnonzero(~np.isnan(sample.boxes[:, 0])).tolist():
        box, concepts = sample.boxes[entity].tolist(), sample.concepts[entity]
        kind = "Car" if sample.mask[entity] else "Pedestrian"
        annotation: dict[str, Any] = {
            "category": concepts or kind.lower(),
            "type": kind,
            "bbox": box,
            "area": box[2] * box[3],
            "iscrowd": 0,
            "name": sample.names[entity],
            "concepts": concepts,
            "visible": float(sample.visible[entity]),
        }
        if mask is not None:
            shown = mask == entity + 1
            annotation["area"] = int(shown.sum())
            annotation["segmentation"] = {"size": list(mask.shape), "counts": _run_lengths(shown)}
        if sample.mask[entity]:
            annotation["action"] = ACTIONS[sample.actions[entity]]
        yield annotation
