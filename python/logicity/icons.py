"""Generate an icon pack with a diffusion model. Needs the extra `icons`: `pip install 'logicity[icons]'`.

`logicity icons sheet --pack` and `logicity run --pack` read a pack, which has one folder of PNG files per class. The
prompts come from templates. A function from text to text, such as a language model, can rewrite them.

Example:
    >>> pipeline = load_pipeline("stabilityai/sd-turbo")  # doctest: +SKIP
    >>> files = fill("pack", ["ambulance", "bus+tiro"], 20, pipeline)  # doctest: +SKIP
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
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

    The name is that of a class of `logicity icons`, such as `bus`, `bus+tiro` or `car+taxi`. `write` rewrites each
    prompt; it can be a language model.

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
    view = "full figure from head to feet"
    if parts[0] in _BUILDINGS:
        view = "seen from the front"
    elif parts[0] in _CARS:
        view = "seen from exactly above, front at the top of the picture"
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

    The picture and the result are objects of `PIL.Image.Image`, and the tolerance is from 0 to 255.

    Raises:
        ValueError: If the whole picture is background.
    """
    from PIL import Image, ImageDraw, ImageOps

    icon = image.convert("RGB")
    pixels = np.asarray(icon).astype(np.int16)
    corners = pixels[[0, 0, -1, -1], [0, -1, 0, -1]]
    near = (np.abs(pixels - corners.mean(axis=0)) <= tolerance).all(axis=2)
    # A frame of background connects all parts of it.
    filled = ImageOps.expand(Image.fromarray(near.astype(np.uint8)), 1, fill=1)
    ImageDraw.floodfill(filled, (0, 0), 2)
    icon.putalpha(filled.point(lambda value: 0 if value == 2 else 255).crop((1, 1, icon.width + 1, icon.height + 1)))
    box = icon.getchannel("A").getbbox()
    if box is None:
        raise ValueError("the whole picture is background: there is nothing to cut out")
    return icon.crop(box)


def load_pipeline(model: str | Path, *, device: str | None = None, **options: Any) -> Any:
    """Load a text-to-image pipeline of `diffusers` from the Hugging Face Hub or a folder.

    The device is by default a GPU if one is available. The options are arguments of
    `AutoPipelineForText2Image.from_pretrained`, such as `torch_dtype`.

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

    The pipeline is the result of `load_pipeline`, or a callable that takes `prompt`, `generator` and the options, such
    as `num_inference_steps` and `guidance_scale`, and returns an object whose `images` are PIL images. Icons are scaled
    down from the size at which the model draws; their longest side is `side` pixels, from 1 to 2048. The tolerance is
    as for `cut_out`, but buildings keep their background. `write` is as for `prompts`.

    Raises:
        OSError: If a file cannot be written.
        ValueError: If the side is out of range, a class is unknown, or the count is negative.
    """
    import torch

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
                # A generator on the CPU makes the noise independent of the device of the pipeline.
                generator = torch.Generator("cpu").manual_seed(seed + number)
                image = pipeline(prompt=text, generator=generator, **options).images[0]
                icon = image.convert("RGB") if name in _BUILDINGS else cut_out(image, tolerance)
                icon.thumbnail((side, side))
                icon.save(file)
    return files
