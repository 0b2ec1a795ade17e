"""The tasks of modes and configuration files, and what identifies them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import cache
from typing import Any

from . import _logicity
from .city import Inference
from .envs.config import EnvConfig
from .modes import checked_mode

__all__ = ["files_hash", "load_task", "task_hashes"]


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


@cache
def files_hash(config: str) -> str:
    """Return the SHA-256 of a configuration and its rules, with all their files.

    The names of the files depend on the working directory, and are left out.
    """
    files = Inference(config)._inference.files()
    return hashlib.sha256(json.dumps(sorted(files.values())).encode()).hexdigest()
