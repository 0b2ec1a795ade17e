"""Files of policies of all learners."""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UntrustedError, extra
from ..files import read_json, read_tensors
from ..rule_policy import policy_files, saved_by
from ..terminal import neutral
from .learner import LearnedPolicy
from .registry import LEARNERS, learner_class

if TYPE_CHECKING:
    from ..types import ArrayKind

__all__ = ["SavedPolicy", "load_policy"]


@dataclass(frozen=True)
class SavedPolicy:
    """A policy from a file, with what the file and the run around it record.

    Attributes:
        policy: The policy.
        path: The file.
        algorithm: The name of the learner.
        mode: The mode of the training, or the path of its configuration file; `None` if nothing records it.
        observation: The kind of observation of the training; `None` if nothing records it.
        egos: The number of egos that the run trained (`task.egos` in its overrides); `None` if it records none.
    """

    policy: LearnedPolicy
    path: Path
    algorithm: str
    mode: str | None
    observation: ArrayKind | None
    egos: int | None = None


def load_policy(path: str | os.PathLike[str], *, trust: bool = False) -> SavedPolicy:
    """Load a policy of any learner.

    A file that `LearnedPolicy.save` wrote is data. A DQN, PPO or A2C model that Stable-Baselines3 saved is a pickle:
    loading it can run any code in it, so this needs `trust`.

    Args:
        path: A file that `LearnedPolicy.save` wrote, the folder of a finished run of `logicity train`, the file or the
            folder of a policy of a release, or a model of Stable-Baselines3, whose suffix is `.zip`.
        trust: Whether the file may run code.

    Raises:
        OSError: If the file cannot be read, or the folder has no policy.
        UntrustedError: If the file is a model of Stable-Baselines3, and `trust` is false.
        ValueError: If the file is not a policy of a known learner.
    """
    file = Path(path)
    if file.is_dir():
        best = policy_files(file)
        if not best:
            what = "a folder without a file `best.*`, which `logicity train` writes at the end of a run"
            raise FileNotFoundError(f"`{file}` is {what}\nhelp: name the file of a policy")
        file = best[0]
    if not file.is_file():
        raise FileNotFoundError(errno.ENOENT, "no such file", os.fspath(path))
    recorded = _recorded(file)
    saved: dict[str, Any]
    if file.suffix == ".zip":
        with extra("learn"):
            from .stable_baselines import algorithm_of, from_stable_baselines

        saved = {"algorithm": algorithm_of(file)}
        if not trust:
            what = "a model of Stable-Baselines3, which is a pickle: loading it can run any code in it"
            remedy = "if you trust its origin, pass `--trust` (Python: `trust=True`)"
            raise UntrustedError(f"{file} is {what}; {remedy}")
        policy: LearnedPolicy = from_stable_baselines(file)
    elif file.suffix in (".pt", ".safetensors"):
        content = read_tensors(file, "a policy")
        saved = content if isinstance(content, dict) else {}
    elif file.suffix == ".dl":
        saved = dict(saved_by(file))
    else:
        raise ValueError(f"{file} is not a policy: its suffix must be .dl, .pt, .safetensors or .zip")
    algorithm = saved.get("algorithm")
    if not isinstance(algorithm, str) or algorithm not in LEARNERS:
        what = f"has the unknown learner `{neutral(algorithm)}`" if isinstance(algorithm, str) else "names no learner"
        raise ValueError(f"{file} is not a policy: it {what}; known: {', '.join(LEARNERS)}")
    if file.suffix != ".zip":
        policy = learner_class(algorithm).policy_class.load(file)
    mode, observation = (recorded.get(key, saved.get(key)) for key in ("mode", "observation"))
    return SavedPolicy(policy, file, algorithm, mode, observation, recorded.get("egos"))


def _recorded(file: Path) -> dict[str, Any]:
    """Return the configuration that a run records for one of its policies; empty without a record."""
    run = file.parent.parent if file.parent.name.startswith("checkpoint-") else file.parent
    config = None
    with suppress(OSError, RecursionError, ValueError):
        config = read_json(run / "config.json")
    known = config if isinstance(config, dict) else {}
    found: dict[str, Any] = {key: known[key] for key in ("mode", "observation") if isinstance(known.get(key), str)}
    task = overrides.get("task") if isinstance(overrides := known.get("overrides"), dict) else None
    if isinstance(task, dict) and isinstance(task.get("egos"), int):
        found["egos"] = task["egos"]
    return found
