"""PyTorch data sets and batches. Needs the extra `vap`: `pip install 'logicity[vap]'`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from ..errors import checked_threads, extra
from .data import PICTURE_SIDE, VapDataset, VapSample

with extra("vap"):
    import torch
    import torch.utils.data

__all__ = ["TorchVapDataset", "padded_batch"]

#: The number of leading axes over entities of each field, and its padding value.
PADDED: dict[str, tuple[int, float]] = {
    "boxes": (1, float("nan")),
    "visible": (1, float("nan")),
    "h": (1, 0),
    "unary": (1, 0),
    "binary": (2, 0),
    "sees": (2, 0),
    "actions": (1, -1),
    "mask": (1, 0),
}


class TorchVapDataset(torch.utils.data.Dataset[dict[str, Any]]):
    """A data set for PyTorch, see `torch_dataset`."""

    def __init__(self, samples: VapDataset, threads: int = 1) -> None:
        """Wrap a data set."""
        self.samples, self.threads = samples, checked_threads(threads, 1)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read a sample."""
        return self.__getitems__([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Read samples. Their pictures share one allocation, so collating does not copy them."""
        samples = [as_tensors(self.samples.facts(index)) for index in indices]
        if self.samples.images:
            images = _allocate((len(indices), PICTURE_SIDE, PICTURE_SIDE, 3))
            with ThreadPoolExecutor(self.threads) as pool:
                # `map` raises exceptions only when its results are consumed.
                list(pool.map(self.samples.read_picture, indices, (image.numpy() for image in images)))
            for image, sample in zip(images, samples, strict=True):
                sample["image"] = image.permute(2, 0, 1)
        return samples


def _allocate(shape: tuple[int, ...]) -> torch.Tensor:
    """Allocate a uint8 tensor. In a worker it is in shared memory, as in `default_collate`."""
    if torch.utils.data.get_worker_info() is None:
        return torch.empty(shape, dtype=torch.uint8)
    storage = torch.UntypedStorage._new_shared(math.prod(shape))
    return torch.empty(0, dtype=torch.uint8).set_(storage, 0, shape)


def as_tensors(sample: VapSample) -> dict[str, Any]:
    """Convert the arrays of a sample to tensors, without its picture."""
    values = {name: value for name, value in vars(sample).items() if name != "image"}
    return {name: torch.from_numpy(value) if name in PADDED else value for name, value in values.items()}


def padded_batch(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Make a batch, see `collate`."""
    if not samples:
        raise ValueError("expected at least one sample")
    counts = torch.tensor([len(sample["mask"]) for sample in samples])
    most = int(counts.max())
    batch: dict[str, Any] = {name: [sample[name] for sample in samples] for name in ("names", "concepts")}
    batch |= {name: torch.tensor([sample[name] for sample in samples]) for name in ("world", "tick")}
    batch["valid"] = torch.arange(most) < counts[:, None]
    for name, (axes, padding) in PADDED.items():
        tensors = [sample[name] for sample in samples]
        batch[name] = tensors[0].new_full((len(tensors), *(most,) * axes, *tensors[0].shape[axes:]), padding)
        for row, tensor in zip(batch[name], tensors, strict=True):
            row[tuple(slice(count) for count in tensor.shape[:axes])] = tensor
    if "image" in samples[0]:
        batch["image"] = _stacked([sample["image"] for sample in samples])
    return batch


def _stacked(images: list[torch.Tensor]) -> torch.Tensor:
    """Stack pictures, without a copy if they are all the rows of one allocation of `__getitems__`."""
    whole = images[0]._base
    if whole is not None and whole.dim() == 4 and len(whole) == len(images):
        batch = whole.permute(0, 3, 1, 2)
        if all(image.dtype == row.dtype and image.is_set_to(row) for image, row in zip(images, batch, strict=True)):
            return batch
    return torch.stack(images)
