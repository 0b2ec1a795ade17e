"""The modes of Safe Path Following, registered as environments of gymnasium when the package is imported."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium

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
"""The modes as environments are named, `logicity/SPF-Easy-v0` and so on, and their configurations."""

ENVIRONMENTS = {config: f"logicity/SPF-{mode}-v0" for mode, config in MODES.items()}
"""What environments are registered as, by configuration: `logicity/SPF-Expert-v0` for `expert`."""


def checked_mode(mode: str | os.PathLike[str]) -> str:
    """Return the name of a mode, or the path of a configuration file, if it can be one."""
    name = os.fspath(mode)
    if name not in ENVIRONMENTS and not Path(name).suffix and not Path(name).exists():
        raise ValueError(f"unknown mode `{name}`, and no such file{did_you_mean(name, ENVIRONMENTS)}")
    return name


def parallel_env(config: str | os.PathLike[str] = "expert", **arguments: Any) -> SPFParallelEnv:
    """Make a `ParallelEnv` of PettingZoo in which every car is driven: a `logicity.parallel.SPFParallelEnv`.

    `arguments` are its other parameters. Needs the extra `pettingzoo`: `pip install './python[pettingzoo]'`.
    """
    from .parallel import SPFParallelEnv

    return SPFParallelEnv(config, **arguments)


for _config, _name in ENVIRONMENTS.items():
    gymnasium.register(
        _name,
        entry_point="logicity.envs:SPFEnv",
        vector_entry_point="logicity.envs:SPFVectorEnv",
        kwargs={"config": _config},
    )
