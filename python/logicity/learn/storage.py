"""Files of policies and of checkpoints. They are plain data, so loading one runs no code from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import missing_extra

try:
    import torch
except ImportError as error:
    raise missing_extra("learn", error) from error

from ..files import read_tensors
from ..terminal import first_line, neutral

if TYPE_CHECKING:
    from ..types import ArrayKind
    from .learner import (
        LearnedPolicy,
    )

__all__ = [
    "build_policy",
    "policy_hash",
    "read_checkpoint",
    "restore_optimizer",
    "save_checkpoint",
    "save_policy",
    "weights_hash",
]

#: The class of the policy that `build_policy` returns.
Built = TypeVar("Built")

#: The version of the files of policies.
FORMAT = 1

#: The version of the files of checkpoints.
CHECKPOINT = 2

#: What the file of a policy says about its training.
_HEADER = ("algorithm", "observation")

#: The file of a learner in a checkpoint.
LEARNER = "learner.pt"


def save_policy(
    path: Path,
    algorithm: str,
    config: Mapping[str, Any],
    weights: Mapping[str, Any],
    observation: ArrayKind = "groundings",
) -> None:
    """Write a policy.

    Args:
        path: The file.
        algorithm: The name of the learner.
        config: The arguments from which to build the policy, as plain data. `mode` is the mode of the training.
        weights: The weights.
        observation: The kind of observation of the training.
    """
    header = {"format": FORMAT, "algorithm": algorithm, "mode": config["mode"], "observation": observation}
    torch.save({**header, "config": dict(config), "weights": dict(weights)}, path)


def build_policy(
    path: Path, algorithms: Collection[str], build: Callable[[dict[str, Any], dict[str, Any]], Built]
) -> Built:
    """Return the result of `build` for the configuration and the weights that `save_policy` wrote.

    The configuration has two more keys: `algorithm` and `observation`.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not a policy of one of the algorithms.
    """
    saved = read_tensors(path, "a policy")
    if not isinstance(saved, dict) or not {"format", "algorithm", "config", "weights"} <= saved.keys():
        raise ValueError(f"{path} is not a policy")
    algorithm = saved["algorithm"]
    if not isinstance(algorithm, str) or algorithm not in algorithms:
        raise ValueError(f"{path} is a policy of {neutral(str(algorithm))}, not of {' or '.join(algorithms)}")
    if saved["format"] != FORMAT:
        raise ValueError(f"{path} has version {saved['format']} of the format, and only {FORMAT} can be read")
    try:
        return build({**saved["config"], **{key: saved.get(key) for key in _HEADER}}, saved["weights"])
    except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
        reason = first_line(str(error), repr(error))
        raise ValueError(f"{path} is not a complete policy of {algorithm}: {reason}") from None


def save_checkpoint(folder: Path, algorithm: str, state: Mapping[str, Any]) -> None:
    """Write the state of a learner, tensors and plain data, to a checkpoint."""
    torch.save({"checkpoint": CHECKPOINT, "algorithm": algorithm, **state}, folder / LEARNER)


def read_checkpoint(folder: Path, algorithm: str) -> dict[str, Any]:
    """Return the state that `save_checkpoint` wrote.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is not a checkpoint of the learner.
    """
    path = folder / LEARNER
    state = read_tensors(path, "a checkpoint")
    if not isinstance(state, dict) or state.get("checkpoint") != CHECKPOINT or state.get("algorithm") != algorithm:
        raise ValueError(f"{path} is not a checkpoint of `{algorithm}` that this version can read")
    return state


def restore_optimizer(optimizer: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Restore an optimizer from what its `state_dict` returned.

    PyTorch checks neither the settings nor the shapes of the tensors, so that a faulty state would fail in a later
    update.

    Raises:
        ValueError: If the state does not fit the optimizer.
    """
    settings = [{name: type(value) for name, value in group.items()} for group in optimizer.param_groups]
    optimizer.load_state_dict(state)
    groups = zip(optimizer.param_groups, settings, strict=True)
    fits = all(type(group.get(name)) is kind for group, kinds in groups for name, kind in kinds.items())
    for parameter, values in optimizer.state.items():
        for value in values.values():
            shape = value.shape if isinstance(value, torch.Tensor) else () if isinstance(value, (int, float)) else None
            fits &= shape == parameter.shape or (shape == () and float(value) >= 0)
    if not fits:
        raise ValueError("the state of the optimizer does not fit")


def policy_hash(policy: LearnedPolicy) -> tuple[str, str]:
    """Return what identifies a policy, `rules` or `weights`, and its SHA-256.

    It does not depend on the file of the policy.
    """
    rules = policy.rules()
    if rules is not None:
        return "rules", hashlib.sha256(rules.encode()).hexdigest()
    return "weights", weights_hash(policy.weights())


def weights_hash(weights: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the names, types, shapes and values of tensors, in the order of the names.

    Args:
        weights: The tensors by name. Values can be mappings of tensors, too. Any other value, such as the text of
            rules, counts as JSON.
    """
    digest = hashlib.sha256()
    for name, value in sorted(_leaves(weights), key=lambda leaf: leaf[0]):
        if isinstance(value, torch.Tensor):
            tensor = value.detach().cpu().contiguous()
            digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}\n".encode())
            digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
        else:
            digest.update(f"{name} {json.dumps(value, sort_keys=True)}\n".encode())
    return digest.hexdigest()


def _leaves(weights: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values that are no mappings, with the paths of their names."""
    for name, value in weights.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
