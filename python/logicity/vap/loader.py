"""Samples for PyTorch. Needs the extra `vap`: `pip install './python[vap]'`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    def __init__(self, samples: VapDataset) -> None:
        """Take the samples of a data set."""
        self.samples = samples

    def __len__(self) -> int:
        """How many samples there are."""
        return len(self.samples)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read a sample."""
        sample = as_tensors(self.samples.facts(index))
        if self.samples.images:
            image = torch.empty((3, PICTURE_SIDE, PICTURE_SIDE), dtype=torch.uint8)
            self.samples.read_picture(index, image.numpy())
            sample["image"] = image
        return sample


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
    batch["there"] = torch.arange(int(counts.max())) < counts[:, None]
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
    """Pictures side by side; in a worker, where the process that trains finds them without a copy."""
    out = torch.empty((len(images), *images[0].shape), dtype=torch.uint8)
    if torch.utils.data.get_worker_info() is not None:
        out.share_memory_()
    return torch.stack(images, out=out)
