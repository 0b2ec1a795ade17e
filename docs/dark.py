"""Makes the dark version of an animation: dark where it is light, with the hues of the original."""

from __future__ import annotations

import colorsys

#: The lightness of what is white in the original, and of what is black.
DARK, LIGHT = 0.09, 0.92


def darkened(animation: bytes) -> bytes:
    """Return a GIF with the colors of its global table darkened. The pictures themselves are unchanged.

    Raises:
        ValueError: If the file is no GIF with a global table of colors, as LogiCity writes it.
    """
    # The first bit of the byte after the size of the picture says that a table follows; the last three are its size.
    if animation[:6] != b"GIF89a" or not animation[10] & 0x80:
        raise ValueError("expected a GIF with a global table of colors")
    start, count = 13, 2 << (animation[10] & 7)
    table = animation[start : start + 3 * count]
    colors = (darker(*table[at : at + 3]) for at in range(0, len(table), 3))
    return animation[:start] + b"".join(map(bytes, colors)) + animation[start + len(table) :]


def darker(red: int, green: int, blue: int) -> tuple[int, int, int]:
    """Return a color with the opposite lightness. Colors of agents, which are vivid, stay nearly as they are."""
    hue, lightness, saturation = colorsys.rgb_to_hls(red / 255, green / 255, blue / 255)
    opposite = LIGHT + (DARK - LIGHT) * lightness
    # A gray or pale color, of little chroma, is a part of the map.
    chroma = saturation * (1 - abs(2 * lightness - 1))
    share = min(1.0, chroma / 0.5)
    lightness = opposite + (lightness - opposite) * share
    mixed = colorsys.hls_to_rgb(hue, lightness, min(1.0, chroma / max(1 - abs(2 * lightness - 1), 0.01)))
    red, green, blue = (round(255 * part) for part in mixed)
    return red, green, blue
