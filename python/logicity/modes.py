"""The modes of Safe Path Following, and the ids of their environments."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import did_you_mean

if TYPE_CHECKING:
    from .parallel import SPFParallelEnv

__all__ = ["ENVIRONMENTS", "MODES", "checked_mode", "parallel_env"]

MODES = {
    "Easy": "easy",
    "Medium": "medium",
    "Hard": "hard",
    "Expert": "expert",
    "TransferEasy": "transfer-easy",
    "TransferMedium": "transfer-medium",
    "TransferHard": "transfer-hard",
}
"""The modes as the ids of environments spell them (`Easy` in `logicity/SPF-Easy-v0`), and their configurations."""

ENVIRONMENTS = {config: f"logicity/SPF-{mode}-v0" for mode, config in MODES.items()}
"""The ids of environments in gymnasium by configuration: `logicity/SPF-Expert-v0` for `expert`."""


def checked_mode(mode: str | os.PathLike[str]) -> str:
    """Return the name of a mode or the path of a configuration file.

    Raises:
        ValueError: If `mode` is neither.
    """
    name = os.fspath(mode)
    if name not in ENVIRONMENTS and not Path(name).suffix and not Path(name).exists():
        raise ValueError(f"unknown mode `{name}`, and no such file{did_you_mean(name, ENVIRONMENTS)}")
    return name


def parallel_env(config: str | os.PathLike[str] = "expert", **arguments: Any) -> SPFParallelEnv:
    """Make a `ParallelEnv` of PettingZoo in which the policy controls every car.

    Args:
        config: A run configuration: a built-in name such as `expert`, or a path.
        arguments: The other parameters of `logicity.parallel.SPFParallelEnv`.

    Raises:
        ImportError: If PettingZoo is not installed. The extra `pettingzoo` installs it: `pip install
            './python[pettingzoo]'`.
    """
    from .parallel import SPFParallelEnv

    return SPFParallelEnv(config, **arguments)
