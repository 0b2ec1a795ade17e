"""The tasks of modes and configuration files, and what identifies them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from . import _logicity
from .envs.config import EnvConfig
from .modes import checked_mode

__all__ = ["load_task", "task_hashes"]


def load_task(
    mode: str | os.PathLike[str],
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> _logicity.Task:
    """Load the task of a mode or configuration file. The exceptions are those of `Benchmark`."""
    return EnvConfig(checked_mode(mode), rules=rules, overrides=overrides).task()


def task_hashes(mode: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what identifies a task and its recorded episodes, as SHA-256.

    `config` and `rules` are the hashes in the headers of traces: that of the configuration with its bases, and that of
    the rule files. `episodes` has the hash of each split with recorded episodes. The exceptions are those of
    `Benchmark`.
    """
    task = _logicity.describe(load_task(mode))
    episodes = {split: each["hash"] for split, each in task["splits"].items() if each["episodes"]}
    return {"config": task["config_hash"], "rules": task["rules_hash"], "episodes": episodes}
