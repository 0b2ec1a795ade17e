"""Perception: the truth values of predicates from pictures, boxes and headings. Needs the extra `vap`.

A `ConceptModel` has three parts. The *appearance* part predicts unary predicates from what is inside a box. The
*places* part predicts `IsAtInter` and `IsInInter` from a position: all worlds have the same map. The *pairs* part
predicts binary predicates from two node vectors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from ..errors import extra
from .data import BINARY, PICTURE_SIDE, UNARY

with extra("vap"):
    import pydantic  # noqa: F401  # which the settings need
    import torch
    from torch import Tensor, nn

from ..learn.settings import Count, StrictModel
from .crops import has_bfloat16

__all__ = ["RELATIONS", "ConceptModel", "ConceptSettings"]

#: The binary predicates of the models: those of the paper and the field of view.
RELATIONS = (*BINARY, "Sees")

#: The unary predicates that a position determines; the others are classes.
PLACES = ("IsAtInter", "IsInInter")
CLASSES = tuple(name for name in UNARY if name not in PLACES)

#: The number of pixels per cell of the map.
CELL = 8

#: The wavelengths of the Fourier features of positions in the picture and of relative ones, in cells.
POSITION_WAVES = (128.0, 64.0, 32.0, 16.0, 8.0, 4.0, 2.0)
RELATIVE_WAVES = (64.0, 32.0, 16.0, 8.0, 4.0, 2.0)

#: The unit vectors (x, y) of the headings left, right, up and down. y points down.
DIRECTIONS = ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))


class ConceptSettings(StrictModel):
    """The architecture of a `ConceptModel`."""

    perception: Literal["crops", "features", "sides", "centers"] = "crops"
    """What the appearance part sees: `crops` of the boxes, stored `features` of a backbone, or no pixels: the width and
    the height of the box with the heading (`sides`), or its center with the heading (`centers`)."""
    spatial: Literal["geometric", "plain"] = "geometric"
    """The spatial parts: perceptrons on Fourier features and on relative positions in the frames of headings; or, as in
    the paper, one of the widths 128 and 128 on concatenated node vectors, with all unary predicates from the appearance
    part."""
    priority: bool = False
    """Whether all parts of `spatial: geometric` see priorities, as in the paper. With fixed agents, a priority
    identifies an agent and so its class. By default, only `HigherPri` sees them. The pairs of `spatial: plain` always
    see them."""
    width: Count = 16
    """The number of channels of the first convolutions."""
    features: Count = 512
    """The number of stored features of a box."""


class ConceptModel(nn.Module):
    """Predicts the logits of all predicates of all entities."""

    def __init__(self, settings: ConceptSettings) -> None:
        """Create the parts."""
        super().__init__()
        self.settings = settings
        plain = settings.spatial == "plain"
        classes = len(UNARY) if plain else len(CLASSES)
        self.appearance: nn.Module
        if settings.perception == "crops":
            self.appearance = CropNetwork(settings.width, classes)
        elif settings.perception == "features":
            self.appearance = feature_network(settings.features, classes)
        elif settings.perception == "sides":
            self.appearance = perceptron(6, (64, 64), classes)
        else:
            self.appearance = perceptron(4 * len(POSITION_WAVES) + 4, (128, 128), classes)
        if plain:
            # HigherPri needs priorities, so they are not left out.
            self.pairs = perceptron(18, (128, 128), len(RELATIONS))
        else:
            # The heading, perhaps the priority, and two types.
            node = 4 + settings.priority + 2
            self.places = perceptron(4 * len(POSITION_WAVES) + node, (128, 128), len(PLACES))
            self.pairs = perceptron(10 * len(RELATIVE_WAVES) + 9 + 2 * node, (128, 64), len(RELATIONS) - 1)
            self.higher = perceptron(1, (8,), 1)

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Return the logits of predicates, (B, N, 11) and (B, N, N, 7), in the orders of `UNARY` and `RELATIONS`.

        The batch has `h` (B, N, 9) and `valid` (B, N) as in `collate`, and for the entities with `valid`, in their
        order, `crops` uint8 (E, side, side, 3), or `features` (E, F), or neither, as the settings need.
        """
        nodes, valid = batch["h"], batch["valid"]
        seen = self._appearance(batch)
        logits = seen.new_zeros(*valid.shape, seen.shape[-1]).masked_scatter(valid[..., None], seen)
        if self.settings.spatial == "plain":
            return logits, self.pairs(_concatenated(nodes))
        types = torch.sigmoid(logits[..., :2])
        own = torch.cat([nodes[..., 4:] if self.settings.priority else nodes[..., 4:8], types], -1)
        centers = _centers(nodes)
        places = self.places(torch.cat([waves(centers, POSITION_WAVES), own], -1))
        pairs = self.pairs(_pair_features(centers, nodes[..., 4:8], own))
        priority = nodes[..., 8]
        # A sharp step: the smallest difference of two normalized priorities is about 1 / 14.
        higher = self.higher((priority[:, None, :] - priority[:, :, None])[..., None] * 10)
        at = RELATIONS.index("HigherPri")
        return torch.cat([logits, places], -1), torch.cat([pairs[..., :at], higher, pairs[..., at:]], -1)

    def _appearance(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Return the logits of the classes, (E, classes)."""
        if self.settings.perception in ("crops", "features"):
            return self.appearance(batch[self.settings.perception])
        nodes = batch["h"][batch["valid"]]
        if self.settings.perception == "centers":
            return self.appearance(torch.cat([waves(_centers(nodes), POSITION_WAVES), nodes[:, 4:8]], -1))
        # Sides of 48 pixels are 1. The heading says which side is the length.
        return self.appearance(torch.cat([nodes[:, 2:4] * (PICTURE_SIDE / 48), nodes[:, 4:8]], -1))


class CropNetwork(nn.Module):
    """Six convolutions on crops of boxes, in bfloat16 if the device computes in it, and otherwise in float32.

    The last convolutions have four times as many channels as the first ones, whose number is `width`.
    """

    def __init__(self, width: int, outputs: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = 3
        for after, stride in ((width, 2), (width, 1), (2 * width, 2), (2 * width, 1), (4 * width, 2), (4 * width, 1)):
            layers += [nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after), nn.ReLU()]
            before = after
        self.layers = nn.Sequential(*layers).to(memory_format=torch.channels_last)
        self.readout = nn.Linear(2 * before, outputs)

    def forward(self, crops: Tensor) -> Tensor:
        """Return logits of crops, uint8 (E, side, side, 3)."""
        # Floats around 0, in the memory format channels_last.
        images = (crops.permute(0, 3, 1, 2).float() - 127.5) / 64.0
        with torch.autocast(images.device.type, torch.bfloat16, has_bfloat16(images.device)):
            maps = self.layers(images)
        maps = maps.float()
        return self.readout(torch.cat([maps.mean((2, 3)), maps.amax((2, 3))], -1))


def feature_network(inputs: int, outputs: int) -> nn.Sequential:
    """Return the paper's head of region features: 512-256-128 with batch normalization and dropout."""
    layers: list[nn.Module] = []
    for before, after in ((inputs, 512), (512, 256), (256, 128)):
        layers += [nn.Linear(before, after), nn.BatchNorm1d(after), nn.ReLU(), nn.Dropout(0.1)]
    return nn.Sequential(*layers, nn.Linear(128, outputs))


def perceptron(inputs: int, widths: Sequence[int], outputs: int) -> nn.Sequential:
    """Return a perceptron with ReLU."""
    layers: list[nn.Module] = []
    for before, after in zip((inputs, *widths), widths, strict=False):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


def _centers(nodes: Tensor) -> Tensor:
    """Return the centers of boxes from node vectors, in cells: (..., 2)."""
    return (nodes[..., :2] + nodes[..., 2:4] / 2) * (PICTURE_SIDE / CELL)


def waves(values: Tensor, wavelengths: Sequence[float]) -> Tensor:
    """Return sines and cosines of values, (..., C), at each wavelength: (..., 2 C W)."""
    phases = values[..., None] * (2 * math.pi / values.new_tensor(wavelengths))
    return torch.cat([phases.sin(), phases.cos()], -1).flatten(-2)


def _pair_features(centers: Tensor, headings: Tensor, own: Tensor) -> Tensor:
    """Return the features of each pair: the relative position in both frames, the distance, headings and types.

    The centers are (B, N, 2), in cells, the headings (B, N, 4), and the own features of entities (B, N, C).
    """
    relative = centers[:, None, :, :] - centers[:, :, None, :]
    directions = headings @ headings.new_tensor(DIRECTIONS)
    # Forward and sideways parts of the other's position in the frame of the first and of the second entity. Both are 0
    # for an entity that has not moved yet.
    frames = _in_frame(relative, directions[:, :, None]), _in_frame(-relative, directions[:, None, :])
    angles = torch.cat([torch.atan2(each[..., 1:], each[..., :1]) for each in frames], -1)
    parts = torch.cat([*frames, relative.norm(dim=-1, keepdim=True)], -1)
    scaled = [waves(parts, RELATIVE_WAVES), torch.tanh(parts / 25), angles, torch.tanh(10 * angles)]
    return torch.cat([*scaled, _concatenated(own)], -1)


def _in_frame(relative: Tensor, directions: Tensor) -> Tensor:
    """Return the parts of positions along directions and at right angles to them, to the right."""
    forward = (relative * directions).sum(-1)
    sideways = relative[..., 1] * directions[..., 0] - relative[..., 0] * directions[..., 1]
    return torch.stack([forward, sideways], -1)


def _concatenated(nodes: Tensor) -> Tensor:
    """Return the vectors, (B, N, C), of both entities of each pair, (B, N, N, 2 C)."""
    count = nodes.shape[1]
    shape = (len(nodes), count, count, nodes.shape[-1])
    return torch.cat([nodes[:, :, None].expand(shape), nodes[:, None].expand(shape)], -1)


def pairs_of(valid: Tensor) -> Tensor:
    """Return which pairs of entities are present, bool (B, N, N), from the entities that are, bool (B, N)."""
    return valid[:, :, None] & valid[:, None, :]


def in_view(binary: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Return the degrees to which present entities see each other, (B, N, N), and the diagonal, bool (N, N).

    An entity sees itself. `binary` is (B, N, N, 7) in the order of `RELATIONS`.
    """
    eye = torch.eye(valid.shape[1], dtype=torch.bool, device=valid.device)
    return binary[..., RELATIONS.index("Sees")].masked_fill(eye, 1.0) * pairs_of(valid), eye
