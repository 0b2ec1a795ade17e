"""Crops of the boxes of agents, the default input of the perception. Needs the extra `vap`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

with extra("vap"):
    import torch
    from torch import nn

__all__ = ["CROP_SIDE", "crop_boxes"]

CROP_SIDE = 48
"""The side length of a crop in pixels."""


def crop_boxes(image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Cut the boxes out of a picture, and scale each to a square: uint8 (N, 48, 48, 3), zeros for boxes outside.

    Boxes are cut at whole pixels that contain them, and at the edges of the picture. Scaling interpolates linearly and
    averages over the pixels that a smaller crop merges.

    Args:
        image: uint8 (rows, columns, 3).
        boxes: float (N, 4): left edge, upper edge, width and height in pixels, as in `VapSample.boxes`. Boxes with NaN
            are outside the picture.
    """
    crops = np.zeros((len(boxes), CROP_SIDE, CROP_SIDE, 3), np.uint8)
    rows, columns = image.shape[:2]
    pixels = torch.from_numpy(image).permute(2, 0, 1)
    for crop, (left, top, width, height) in zip(crops, boxes.tolist(), strict=True):
        if math.isnan(left):
            continue
        first_row, first_column = max(0, math.floor(top)), max(0, math.floor(left))
        last_row, last_column = min(rows, math.ceil(top + height)), min(columns, math.ceil(left + width))
        if first_row >= last_row or first_column >= last_column:
            continue
        part = pixels[None, :, first_row:last_row, first_column:last_column]
        scaled = nn.functional.interpolate(part, (CROP_SIDE, CROP_SIDE), mode="bilinear", antialias=True)
        crop[:] = scaled[0].permute(1, 2, 0).numpy()
    return crops


def has_bfloat16(device: torch.device) -> bool:
    """Return whether a device computes convolutions in bfloat16.

    Processors without it emulate it: training then takes nine times as long as in float32.
    """
    return device.type != "cpu" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
