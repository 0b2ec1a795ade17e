"""Makes the dark version of an animation: a dim map on a dark page, as on the page of a run."""

from __future__ import annotations

import io
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageSequence

Pixels = NDArray[np.uint8]

#: The colors of the margin of a picture, paper and two inks, and those that replace them.
MARGIN = {(250, 249, 246): (19, 20, 22), (35, 42, 51): (214, 217, 222), (115, 122, 132): (148, 154, 163)}
#: The brightness of the map and of icons, as a share of the original's.
DIM = 0.7
#: The number of colors of a palette without the last one, which is transparent.
COLORS = 255


def darkened(animation: bytes) -> bytes:
    """Return a GIF of the same frames with a dim map and a dark margin.

    Raises:
        ValueError: If the animation does not have the paper of LogiCity's pictures in its first corner.
    """
    with Image.open(io.BytesIO(animation)) as image:
        frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]
        duration = image.info.get("duration", 100)
    inside = _map(frames[0])
    dark = [_dark(frame, inside) for frame in frames]
    palette = _palette(dark)
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in dark]
    out = io.BytesIO()
    # A pixel that a frame leaves unchanged is transparent in it, which makes the file smaller.
    options: dict[str, Any] = {"duration": duration, "loop": 0, "transparency": 255, "disposal": 1}
    pictures[0].save(out, "GIF", save_all=True, append_images=pictures[1:], optimize=True, **options)
    return out.getvalue()


def _map(frame: Pixels) -> tuple[slice, slice]:
    """Return the rows and columns of the map: those that are not mostly paper."""
    if tuple(frame[0, 0]) not in MARGIN:
        raise ValueError("expected a picture of LogiCity, with paper in its first corner")
    drawn = (frame != frame[0, 0]).any(axis=2)
    rows, columns = (np.flatnonzero(drawn.mean(axis=axis) > 0.5) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _dark(frame: Pixels, inside: tuple[slice, slice]) -> Pixels:
    dark = (frame * DIM).astype(np.uint8)
    margin = np.ones(frame.shape[:2], dtype=bool)
    margin[inside] = False
    for color, other in MARGIN.items():
        dark[margin & (frame == color).all(axis=2)] = other
    return dark


def _palette(frames: list[Pixels]) -> Image.Image:
    """Return a picture with the most frequent colors of all frames as its palette."""
    counts: Counter[int] = Counter()
    for frame in frames:
        numbers, found = np.unique(
            frame.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32), return_counts=True
        )
        counts.update(dict(zip(numbers.tolist(), found.tolist(), strict=True)))
    colors: list[Any] = [number >> shift & 255 for number, _ in counts.most_common(COLORS) for shift in (16, 8, 0)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors + [0] * (768 - len(colors)))
    return palette
