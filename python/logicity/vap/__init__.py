"""Visual Action Prediction: what does every car do next, given a picture of the city?

`logicity vap make` makes data sets. What to reach for:

- the samples of one as numpy arrays: `VapDataset`;
- the same for a `DataLoader` of PyTorch: `torch_dataset` with `collate`, which need the extra `vap`;
- how good predictions are, as the paper measures it: `vap_metrics`;
- what simple predictors reach: `measure_baselines`, or `python -m logicity vap baselines`;
- the data set in another format: `to_webdataset`, `to_coco`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .baselines import BaselineResult, baseline_table, measure_baselines
from .data import BINARY, PICTURE_SIDE, UNARY, VapDataset, VapSample
from .export import to_coco, to_webdataset
from .metrics import VapMetrics, vap_metrics

if TYPE_CHECKING:
    from .loader import TorchVapDataset

__all__ = [
    "BINARY",
    "PICTURE_SIDE",
    "UNARY",
    "BaselineResult",
    "VapDataset",
    "VapMetrics",
    "VapSample",
    "baseline_table",
    "collate",
    "measure_baselines",
    "to_coco",
    "to_webdataset",
    "torch_dataset",
    "vap_metrics",
]


def torch_dataset(
    folder: str | os.PathLike[str], images: bool = True, *, cached_worlds: int = 128, threads: int = 1
) -> TorchVapDataset:
    """Make a `torch.utils.data.Dataset` of a data set; its arguments are those of `VapDataset`, and `threads`.

    A sample is a dictionary with the fields of `VapSample`, arrays as tensors; `image` has the shape (3, 1024, 1024),
    in the memory format `channels_last`, and is left out with `images=False`. Worker processes can be forked or
    spawned; `threads`, from 1 on, is how many threads of each process decode the pictures of a batch.

    Raises:
        ImportError: PyTorch is not installed; the extra `vap` has it: `pip install './python[vap]'`.
        OSError, ValueError: as `VapDataset`.
    """
    from .loader import TorchVapDataset

    return TorchVapDataset(VapDataset(folder, images, cached_worlds=cached_worlds), threads)


def collate(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Make a batch of samples of `torch_dataset`, for the argument `collate_fn` of a `DataLoader`.

    With B samples, the largest of N entities: `image` uint8 (B, 3, 1024, 1024), `boxes` (B, N, 4), `h` (B, N, 9),
    `unary` (B, N, 11), `binary` (B, N, N, 6), `sees` (B, N, N), `actions` and `mask` (B, N), `world` and `tick` int64
    (B,); `names` and `concepts` are lists of B tuples. `valid`, bool (B, N), is the padding mask: true for entities;
    behind the last entity of a sample boxes are NaN, actions -1 and all else 0 or false.

    Raises:
        ImportError: PyTorch is not installed; the extra `vap` has it.
        ValueError: there are no samples.
    """
    from .loader import padded_batch

    return padded_batch(samples)
