"""Files of policies of all learners."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UntrustedError
from ..files import read_json, read_tensors
from ..rule_policy import saved_by
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
    """

    policy: LearnedPolicy
    path: Path
    algorithm: str
    mode: str | None
    observation: ArrayKind | None


def load_policy(path: str | os.PathLike[str], *, trust: bool = False) -> SavedPolicy:
    """Load a policy of any learner.

    A file that `LearnedPolicy.save` wrote is data. A DQN, PPO or A2C model that Stable-Baselines3 saved is a pickle:
    loading it can run any code in it, so this needs `trust`.

    Args:
        path: A file that `LearnedPolicy.save` wrote, the folder of a finished run of `logicity train`, or a model of
            Stable-Baselines3, whose suffix is `.zip`.
        trust: Whether the file may run code.

    Raises:
        OSError: If the file cannot be read, or the folder has no policy.
        UntrustedError: If the file is a model of Stable-Baselines3, and `trust` is false.
        ValueError: If the file is not a policy of a known learner.
    """
    file = Path(path)
    if file.is_dir():
        best = sorted(file.glob("best.*"))
        if not best:
            raise FileNotFoundError(
                f"`{file}` is a folder without a file `best.*`, which `logicity train` writes at the end of a run\n"
                "help: name the file of a policy"
            )
        file = best[0]
    if not file.is_file():
        raise FileNotFoundError(errno.ENOENT, "no such file", os.fspath(path))
    recorded = _recorded(file)
    if file.suffix == ".zip":
        from .stable_baselines import algorithm_of, from_stable_baselines

        saved = {"algorithm": algorithm_of(file)}
        if not trust:
            raise UntrustedError(
                f"{file} is a model of Stable-Baselines3, which is a pickle: loading it can run any code in it; "
                "if you trust its origin, pass `--trust` (Python: `trust=True`)"
            )
        policy: LearnedPolicy = from_stable_baselines(file)
    elif file.suffix == ".pt":
        saved = _header(file)
    elif file.suffix == ".dl":
        saved = saved_by(file)
        _check_learner(file, saved["algorithm"])
    else:
        raise ValueError(f"{file} is not a policy: its suffix must be .dl, .pt or .zip")
    algorithm = str(saved["algorithm"])
    if file.suffix != ".zip":
        policy = learner_class(algorithm).policy_class.load(file)
    return SavedPolicy(
        policy=policy,
        path=file,
        algorithm=algorithm,
        mode=recorded.get("mode", saved.get("mode")),
        observation=recorded.get("observation", saved.get("observation")),
    )


def _header(file: Path) -> dict[str, Any]:
    """Return the content of a file of `torch.save`, which must name its learner.

    Raises:
        ValueError: If the file is not a policy of a known learner.
    """
    saved = read_tensors(file, "a policy")
    header: dict[str, Any] = saved if isinstance(saved, dict) else {}
    name = header.get("algorithm")
    _check_learner(file, name)
    return header


def _check_learner(file: Path, name: object) -> None:
    """Raise `ValueError` if a file of a policy names no known learner."""
    if not isinstance(name, str) or name not in LEARNERS:
        what = f"has the unknown learner `{neutral(name)}`" if isinstance(name, str) else "names no learner"
        raise ValueError(f"{file} is not a policy: it {what}; known: {', '.join(LEARNERS)}")


def _recorded(file: Path) -> dict[str, Any]:
    """Return the configuration that a run records for one of its policies; empty without a record."""
    run = file.parent.parent if file.parent.name.startswith("checkpoint-") else file.parent
    try:
        config = read_json(run / "config.json")
    except (OSError, RecursionError, ValueError):
        return {}
    if not isinstance(config, dict):
        return {}
    return {key: config[key] for key in ("mode", "observation") if isinstance(config.get(key), str)}
