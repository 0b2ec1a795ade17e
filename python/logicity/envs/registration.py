"""The environments by name: their registration with gymnasium, and a function for PettingZoo. Imports neither."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ..modes import ENVIRONMENTS

if TYPE_CHECKING:
    from .parallel import SPFParallelEnv

__all__ = ["parallel_env", "register_environments", "register_with_gymnasium"]


def register_with_gymnasium() -> None:
    """Register the environments now if gymnasium is imported, or otherwise when it is imported."""
    if sys.modules.get("gymnasium") is not None:
        register_environments()
    else:
        sys.meta_path.insert(0, _RegisterOnImport())


def register_environments() -> None:
    """Import gymnasium and register the environments."""
    import gymnasium

    for config, name in ENVIRONMENTS.items():
        gymnasium.register(
            name,
            entry_point="logicity.envs:SPFEnv",
            vector_entry_point="logicity.envs:SPFVectorEnv",
            kwargs={"config": config},
        )


def parallel_env(config: str | os.PathLike[str] = "expert", **arguments: Any) -> SPFParallelEnv:
    """Make a PettingZoo `ParallelEnv` in which several cars are controlled agents. Needs the extra `pettingzoo`.

    The arguments and exceptions are those of `logicity.envs.SPFParallelEnv`.
    """
    from .parallel import SPFParallelEnv

    return SPFParallelEnv(config, **arguments)


class _RegisterOnImport(MetaPathFinder):
    """Finds gymnasium through the other finders, and registers the environments after its import."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            # A later import may find gymnasium.
            sys.meta_path.insert(0, self)
            return spec
        loader, load = spec.loader, spec.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            delattr(loader, "exec_module")
            load(module)
            register_environments()

        # Patching the loader instead of wrapping it keeps its type and its other attributes.
        setattr(loader, "exec_module", exec_module)  # noqa: B010
        return spec
