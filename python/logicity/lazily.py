"""Names of a package that are imported on first use (PEP 562)."""

import importlib
from collections.abc import Callable, Collection, Mapping
from typing import Any

__all__ = ["exports"]


def exports(
    names: dict[str, Any], homes: Mapping[str, str], modules: Collection[str] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions `__getattr__` and `__dir__` of a package, from its `globals()`.

    `homes` has the modules that define the exported names, relative to the package.
    """
    package = names["__name__"]

    def __getattr__(name: str) -> Any:
        if name in modules:
            return importlib.import_module(f".{name}", package)
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        names[name] = getattr(importlib.import_module(f".{homes[name]}", package), name)
        return names[name]

    def __dir__() -> list[str]:
        return sorted({*names, *homes, *modules})

    return __getattr__, __dir__
