"""Files of policies, states of optimizers, and hashes. Files are plain data, so loading one runs no code from it."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ..errors import extra

with extra("learn"):
    import torch

from ..files import read_tensors
from ..terminal import first_line, neutral
from .learner import LearnedPolicy

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["StoredPolicy", "policy_hash", "processor", "restore_optimizer", "weights_hash"]

#: The version of the files of policies.
FORMAT = 1


class StoredPolicy(LearnedPolicy):
    """A policy whose file has a configuration and weights."""

    #: The name of its learner.
    algorithm: str
    #: The learners whose policies `load` can read.
    algorithms: ClassVar[tuple[str, ...]]

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """Return what `build` needs besides the weights, as plain data. `mode` is the mode of the training."""

    @classmethod
    @abstractmethod
    def build(cls, config: dict[str, Any], weights: dict[str, Any]) -> Any:
        """Create the policy of a file. The configuration also has the keys `algorithm` and `observation`."""

    def save(self, path: Path) -> None:
        """Write the policy to a file."""
        config: dict[str, Any] = {"observation": "groundings", **self.config()}
        header = {"format": FORMAT, "algorithm": self.algorithm, "mode": config["mode"]}
        header["observation"] = config.pop("observation")
        torch.save({**header, "config": config, "weights": dict(self.weights())}, path)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a policy that `save` wrote."""
        saved = read_tensors(path, "a policy")
        if not isinstance(saved, dict) or not {"format", "algorithm", "config", "weights"} <= saved.keys():
            raise ValueError(f"{path} is not a policy")
        algorithm = saved["algorithm"]
        if not isinstance(algorithm, str) or algorithm not in cls.algorithms:
            raise ValueError(f"{path} is a policy of {neutral(str(algorithm))}, not of {' or '.join(cls.algorithms)}")
        if saved["format"] != FORMAT:
            raise ValueError(f"{path} has version {saved['format']} of the format, and only {FORMAT} can be read")
        try:
            header = {key: saved.get(key) for key in ("algorithm", "observation")}
            policy: Self = cls.build({**saved["config"], **header}, saved["weights"])
            return policy
        except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
            reason = first_line(str(error), repr(error))
            raise ValueError(f"{path} is not a complete policy of {algorithm}: {reason}") from None


def restore_optimizer(optimizer: torch.optim.Optimizer, state: dict[str, Any]) -> None:
    """Restore an optimizer from what its `state_dict` returned. Raise `ValueError` if it does not fit.

    PyTorch checks neither settings nor shapes of tensors, so that a faulty state would fail in a later update.
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
    """Return what identifies a policy, `rules` or `weights`, and its SHA-256, which does not depend on its file."""
    rules = policy.rules()
    if rules is not None:
        return "rules", hashlib.sha256(rules.encode()).hexdigest()
    return "weights", weights_hash(policy.weights())


def processor() -> str:
    """Return the vendor of the processor and the vector instructions that PyTorch uses, such as `GenuineIntel AVX512`.

    PyTorch adds numbers in an order that depends on both, so trainings on different ones have different weights. The
    order also depends on the environment variable MKL_CBWR; if it is set, the result ends with it.
    """
    information = Path("/proc/cpuinfo")
    lines = information.read_text(encoding="utf-8").splitlines() if information.exists() else []
    vendor = next((line.partition(":")[2].strip() for line in lines if line.startswith("vendor_id")), "")
    name = f"{vendor or platform.processor() or platform.machine()} {torch.backends.cpu.get_cpu_capability()}"
    branch = os.environ.get("MKL_CBWR")
    return f"{name} MKL_CBWR={branch}" if branch else name


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
