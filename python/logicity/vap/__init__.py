"""Visual Action Prediction (VAP): predict the next action of every car from a picture of the city.

- `make_dataset` and `check_dataset` create and check data sets, as `logicity vap make` and `logicity vap check` do.
- `VapDataset` reads samples as numpy arrays.
- `torch_dataset` and `collate` work with a PyTorch `DataLoader`. They need the extra `vap`.
- `vap_metrics` computes the metrics of the paper.
- `measure_baselines`, also `logicity vap baselines`, measures simple predictors.
- `to_webdataset` and `to_coco` convert data sets.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .baselines import BaselineResult, baseline_table, measure_baselines
from .data import BINARY, PICTURE_SIDE, UNARY, VapDataset, VapSample
from .export import to_coco, to_webdataset
from .make import Drawing, VapCounts, check_dataset, make_dataset
from .metrics import VapMetrics, vap_metrics

if TYPE_CHECKING:
    from .loader import TorchVapDataset

__all__ = [
    "BINARY",
    "PICTURE_SIDE",
    "UNARY",
    "BaselineResult",
    "Drawing",
    "VapCounts",
    "VapDataset",
    "VapMetrics",
    "VapSample",
    "baseline_table",
    "check_dataset",
    "collate",
    "make_dataset",
    "measure_baselines",
    "to_coco",
    "to_webdataset",
    "torch_dataset",
    "vap_metrics",
]


def torch_dataset(
    folder: str | os.PathLike[str], images: bool = True, *, cached_worlds: int = 128, threads: int = 1
) -> TorchVapDataset:
    """Return a data set as a `torch.utils.data.Dataset`.

    A sample is a dictionary with the fields of `VapSample`. Arrays are tensors. `image` is uint8 (3, 1024, 1024) in the
    memory format `channels_last`, and is absent with `images=False`. Worker processes may be forked or spawned. In each
    process, 1 to 1024 `threads` decode the pictures of a batch. The other arguments are those of `VapDataset`.

    Raises:
        ImportError: If PyTorch is not installed. The extra `vap` installs it: `pip install 'logicity[vap]'`.
        OSError, ValueError: As for `VapDataset`.
    """
    from .loader import TorchVapDataset

    return TorchVapDataset(VapDataset(folder, images, cached_worlds=cached_worlds), threads)


def collate(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Collate samples of `torch_dataset` into a batch. Pass it to a `DataLoader` as `collate_fn`.

    For B samples with at most N entities, the batch has these tensors: `image` uint8 (B, 3, 1024, 1024), `boxes`
    (B, N, 4), `h` (B, N, 9), `unary` (B, N, 11), `binary` (B, N, N, 6), `sees` (B, N, N), `actions` and `mask` (B, N),
    and `world` and `tick` int64 (B,). `names` and `concepts` are lists of B tuples. The padding mask `valid`, bool
    (B, N), is true for entities. Padding values are NaN for boxes, -1 for actions, and 0 or false for other tensors.

    Raises:
        ImportError: If PyTorch is not installed. The extra `vap` installs it.
        ValueError: If there are no samples.
    """
    from .loader import padded_batch

    return padded_batch(samples)
