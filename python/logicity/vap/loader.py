"""Samples for PyTorch. Needs the extra `vap`: `pip install './python[vap]'`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from typing import Any

from ..errors import missing_extra
from .data import PICTURE_SIDE, VapDataset, VapSample

try:
    import torch
    import torch.utils.data
except ImportError as error:
    raise missing_extra("vap", error) from error

__all__ = ["TorchVapDataset", "padded_batch"]

#: How many of the first axes of a field count entities, and what stands where there are none.
PADDED: dict[str, tuple[int, float]] = {
    "boxes": (1, float("nan")),
    "h": (1, 0),
    "unary": (1, 0),
    "binary": (2, 0),
    "sees": (2, 0),
    "actions": (1, -1),
    "mask": (1, 0),
}


class TorchVapDataset(torch.utils.data.Dataset[dict[str, Any]]):
    """A data set as `torch_dataset` tells."""

    def __init__(self, samples: VapDataset, threads: int = 1) -> None:
        """Take the samples of a data set, and how many threads decode the pictures of a batch."""
        if threads < 1:
            raise ValueError(f"{threads} threads: 1 or more decode pictures")
        self.samples, self.threads = samples, threads

    def __len__(self) -> int:
        """How many samples there are."""
        return len(self.samples)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read a sample."""
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Read samples. Their pictures lie side by side, so that a batch of them is made without a copy."""
        samples = [as_tensors(self.samples.facts(index)) for index in indices]
        if self.samples.images:
            images = _room((len(indices), PICTURE_SIDE, PICTURE_SIDE, 3))
            self._read_pictures(indices, images)
            for image, sample in zip(images, samples, strict=True):
                sample["image"] = image.permute(2, 0, 1)
        return samples

    def _read_pictures(self, indices: Sequence[int], images: torch.Tensor) -> None:
        arrays = [image.numpy() for image in images]
        if self.threads == 1 or len(arrays) == 1:
            for index, array in zip(indices, arrays, strict=True):
                self.samples.read_picture(index, array)
            return
        with ThreadPoolExecutor(self.threads) as pool:
            # A list, since a fault is raised where its result is asked for.
            list(pool.map(self.samples.read_picture, indices, arrays))


def _room(shape: tuple[int, ...]) -> torch.Tensor:
    """Bytes to be written; in a worker, where the process that trains finds them, as `default_collate` has them."""
    if torch.utils.data.get_worker_info() is None:
        return torch.empty(shape, dtype=torch.uint8)
    storage = torch.UntypedStorage._new_shared(math.prod(shape))
    return torch.empty(0, dtype=torch.uint8).set_(storage, 0, shape)


def as_tensors(sample: VapSample) -> dict[str, Any]:
    """All of a sample but its picture."""
    told = {field.name: getattr(sample, field.name) for field in fields(sample) if field.name != "image"}
    return {name: torch.from_numpy(value) if name in PADDED else value for name, value in told.items()}


def padded_batch(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Make a batch as `collate` tells."""
    if not samples:
        raise ValueError("there are no samples")
    counts = torch.tensor([len(sample["mask"]) for sample in samples])
    batch: dict[str, Any] = {name: [sample[name] for sample in samples] for name in ("names", "concepts")}
    batch |= {name: torch.tensor([sample[name] for sample in samples]) for name in ("world", "tick")}
    batch["valid"] = torch.arange(int(counts.max())) < counts[:, None]
    for name, (axes, filler) in PADDED.items():
        batch[name] = _padded([sample[name] for sample in samples], axes, int(counts.max()), filler)
    if "image" in samples[0]:
        batch["image"] = _stacked([sample["image"] for sample in samples])
    return batch


def _padded(tensors: list[torch.Tensor], axes: int, most: int, filler: float) -> torch.Tensor:
    all_of_them = tensors[0].new_full((len(tensors), *(most,) * axes, *tensors[0].shape[axes:]), filler)
    for row, tensor in zip(all_of_them, tensors, strict=True):
        row[tuple(slice(count) for count in tensor.shape[:axes])] = tensor
    return all_of_them


def _stacked(images: list[torch.Tensor]) -> torch.Tensor:
    """Pictures as a batch: that of `__getitems__`, if they are its rows as they were."""
    whole = images[0]._base
    if whole is not None and whole.dim() == 4 and len(whole) == len(images):
        batch = whole.permute(0, 3, 1, 2)
        if all(_same_view(image, row) for image, row in zip(images, batch, strict=True)):
            return batch
    return torch.stack(images)


def _same_view(one: torch.Tensor, other: torch.Tensor) -> bool:
    """Whether two tensors are the same bytes, read alike."""
    first, second = ((tensor.data_ptr(), tensor.shape, tensor.stride(), tensor.dtype) for tensor in (one, other))
    return bool(first == second)
