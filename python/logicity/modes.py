"""The modes of Safe Path Following and the ids of their environments."""

from __future__ import annotations

import os
from pathlib import Path

from . import _logicity
from .errors import checked_path, did_you_mean

__all__ = ["ENVIRONMENTS", "MODES", "checked_mode"]

MODES = {
    "Easy": "easy",
    "Medium": "medium",
    "Hard": "hard",
    "Expert": "expert",
    "TransferEasy": "transfer-easy",
    "TransferMedium": "transfer-medium",
    "TransferHard": "transfer-hard",
    "Town": "town",
}
"""The configuration of each mode, keyed by its spelling in environment ids (`Easy` in `logicity/SPF-Easy-v0`)."""

ENVIRONMENTS = {config: f"logicity/SPF-{mode}-v0" for mode, config in MODES.items()}
"""The gymnasium id of each mode, keyed by its configuration: `logicity/SPF-Expert-v0` for `expert`."""


def checked_mode(mode: str | os.PathLike[str]) -> str:
    """Return the name of a mode or the path of a configuration file. Raise `ValueError` if it is neither."""
    name = checked_path("mode", mode)
    if name not in ENVIRONMENTS and not Path(name).suffix and not Path(name).exists():
        files = map(str, sorted(Path(name).parent.glob("*.yaml")))
        near = _logicity.did_you_mean(name, [*ENVIRONMENTS, *files])
        help = did_you_mean(name, ENVIRONMENTS) if near is None else f"; did you mean `{near}`?"
        raise ValueError(f"unknown mode `{name}`, and no file has this name{help}")
    return name
