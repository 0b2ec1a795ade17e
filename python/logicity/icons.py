"""Generate an icon pack with a diffusion model. Needs the extra `icons`: `pip install './python[icons]'`.

`logicity icons sheet --pack` and `logicity run --pack` read a pack, which has one folder of PNG files per class. The
prompts come from templates. A function from text to text, such as a language model, can rewrite them.

Example:
    >>> pipeline = load_pipeline("stabilityai/sd-turbo")  # doctest: +SKIP
    >>> files = fill("pack", ["ambulance", "bus+tiro"], 20, pipeline)  # doctest: +SKIP
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .errors import extra

__all__ = ["SUBJECTS", "cut_out", "fill", "load_pipeline", "prompts"]

#: Descriptions by concept, type of agent and type of building.
SUBJECTS = {
    "car": ["a saloon car", "a hatchback", "an estate car", "a pickup"],
    "ambulance": ["an ambulance van with a light bar and a large cross on its roof"],
    "bus": ["a long city bus with hatches on its roof"],
    "police": ["a police car with red and blue lights"],
    "tiro": ["a driving school car with a large L plate on its roof"],
    "reckless": ["a sports car with racing stripes and a spoiler"],
    "pedestrian": ["a woman walking", "a man walking", "a man in a coat", "a woman with a bag"],
    "old": ["an old man with a walking stick", "an old woman with gray hair and a cane"],
    "young": ["a child with a school bag", "a small girl with a cap", "a small boy with a balloon"],
    "house": ["a family house with a pitched roof and a garden"],
    "office": ["an office tower with many windows"],
    "garage": ["a car repair shop with roller doors"],
    "store": ["a shop with a striped awning"],
    "gas-station": ["a gas station with pumps under a canopy"],
}
_CARS = {"car", "ambulance", "bus", "police", "tiro", "reckless"}
_BUILDINGS = {"house", "office", "garage", "store", "gas-station"}
_COLORS = ["white", "silver", "black", "red", "blue", "green", "yellow", "orange", "brown"]
_STYLES = ["flat vector icon", "clean 3D render", "hand-painted game sprite", "photo"]


def prompts(name: str, count: int, *, seed: int = 0, write: Callable[[str], str] | None = None) -> list[str]:
    """Return prompts for different icons of a class. The same seed gives the same prompts.

    Args:
        name: A class name of `logicity icons`, such as `bus`, `bus+tiro` or `car+taxi`.
        count: The number of prompts.
        seed: The seed.
        write: A function that rewrites each prompt, such as a language model.

    Raises:
        ValueError: If the class is unknown, or the count is negative.
    """
    parts = name.split("+")
    if any(not part or {"/", "\\"} & set(part) for part in parts):
        raise ValueError(f"`{name}` is not a class name")
    if parts[0] not in SUBJECTS:
        raise ValueError(f"unknown class `{name}`: it must start with one of {', '.join(SUBJECTS)}")
    if count < 0:
        raise ValueError(f"`count` must not be negative, but it is {count}")
    draw = random.Random(f"{seed} {name}")
    if parts[0] in _BUILDINGS:
        view = "seen from the front"
    elif parts[0] in _CARS:
        view = "seen from exactly above, front at the top of the picture"
    else:
        view = "full figure from head to feet"
    texts = []
    for _ in range(count):
        subject = " that is also ".join(draw.choice(SUBJECTS.get(part, [f"a {part}"])) for part in parts)
        text = (
            f"{draw.choice(_STYLES)} of {subject}, {draw.choice(_COLORS)}, {view}, one object, centered, "
            "plain white background, no text, no shadow"
        )
        texts.append(text if write is None else write(text))
    return texts


def cut_out(image: Any, tolerance: int = 24) -> Any:
    """Make the background of a picture transparent, and crop the picture to the foreground.

    The background is connected to the border of the picture. In every channel it differs from the mean color of the
    corners by at most `tolerance`.

    Args:
        image: A `PIL.Image.Image`.
        tolerance: The largest difference of a channel, from 0 to 255.

    Returns:
        A `PIL.Image.Image`.

    Raises:
        ValueError: If the whole picture is background.
    """
    from PIL import Image

    pixels = np.asarray(image.convert("RGB")).astype(np.int16)
    corners = pixels[[0, 0, -1, -1], [0, -1, 0, -1]]
    near = (np.abs(pixels - corners.mean(axis=0)) <= tolerance).all(axis=2)
    outside = np.zeros_like(near)
    outside[[0, -1], :] = near[[0, -1], :]
    outside[:, [0, -1]] = near[:, [0, -1]]
    while True:
        grown = outside.copy()
        grown[1:] |= outside[:-1]
        grown[:-1] |= outside[1:]
        grown[:, 1:] |= outside[:, :-1]
        grown[:, :-1] |= outside[:, 1:]
        grown &= near
        if (grown == outside).all():
            break
        outside = grown
    if outside.all():
        raise ValueError("the whole picture is background: there is nothing to cut out")
    rows, columns = (np.flatnonzero((~outside).any(axis=axis)) for axis in (1, 0))
    rgba = np.dstack([pixels.astype(np.uint8), np.where(outside, 0, 255).astype(np.uint8)])
    return Image.fromarray(rgba[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])


def load_pipeline(model: str | Path, *, device: str | None = None, **options: Any) -> Any:
    """Load a text-to-image pipeline of `diffusers` from the Hugging Face Hub or a folder.

    Args:
        model: The name on the hub, or the path of the folder.
        device: The device, such as `cuda`. Defaults to a GPU if one is available.
        options: Arguments of `AutoPipelineForText2Image.from_pretrained`, such as `torch_dtype`.

    Raises:
        ImportError: If diffusers is not installed. The extra `icons` installs it.
    """
    with extra("icons"):
        import torch
        from diffusers import AutoPipelineForText2Image
    pipeline = AutoPipelineForText2Image.from_pretrained(str(model), **options)
    pipeline.set_progress_bar_config(disable=True)
    return pipeline.to(device or ("cuda" if torch.cuda.is_available() else "cpu"))


def fill(
    folder: str | Path,
    names: Iterable[str],
    count: int,
    pipeline: Any,
    *,
    seed: int = 0,
    side: int = 256,
    tolerance: int = 24,
    write: Callable[[str], str] | None = None,
    **options: Any,
) -> list[Path]:
    """Draw icons of several classes into a pack, and return their paths.

    Icon `k` of a class uses prompt `k` and a generator with the seed `seed + k`. Existing files are kept, so another
    call resumes an interrupted one.

    Args:
        folder: The folder of the pack.
        names: The classes.
        count: The number of icons per class.
        pipeline: The result of `load_pipeline`, or a callable that takes `prompt`, `generator` and `options` and
            returns an object whose `images` are PIL images.
        seed: The seed.
        side: The longest side of an icon in pixels, from 1 to 2048. Icons are scaled down from the size at which the
            model draws.
        tolerance: As for `cut_out`. Buildings keep their background.
        write: As for `prompts`.
        options: Arguments of the pipeline, such as `num_inference_steps` and `guidance_scale`.

    Raises:
        OSError: If a file cannot be written.
        ValueError: If the side is out of range, a class is unknown, or the count is negative.
    """
    if not 1 <= side <= 2048:
        raise ValueError(f"expected a side of 1 to 2048 pixels, not {side}")
    texts = {name: prompts(name, count, seed=seed, write=write) for name in names}
    files = []
    for name, wanted in texts.items():
        class_folder = Path(folder) / name
        class_folder.mkdir(parents=True, exist_ok=True)
        for number, text in enumerate(wanted):
            file = class_folder / f"{number:04}.png"
            files.append(file)
            if not file.exists():
                image = _draw(pipeline, text, seed + number, options)
                icon = image.convert("RGB") if name in _BUILDINGS else cut_out(image, tolerance)
                icon.thumbnail((side, side))
                icon.save(file)
    return files


def _draw(pipeline: Any, text: str, seed: int, options: dict[str, Any]) -> Any:
    import torch

    # A generator on the CPU makes the noise independent of the device of the pipeline.
    generator = torch.Generator("cpu").manual_seed(seed)
    images: Sequence[Any] = pipeline(prompt=text, generator=generator, **options).images
    return images[0]
