"""Exceptions for faulty input; `diagnostics` holds every fault with its place."""

from __future__ import annotations

from collections.abc import Iterable

from . import _logicity
from .types import Diagnostic

__all__ = ["InputError", "LimitError"]


class InputError(ValueError):
    """Faulty rules, configurations, scenes or facts.

    The message draws every fault under its line, as the command line does. `diagnostics` are the same as data: `code`
    is the stable name of a fault, and the first of its `labels` its place (file, line, column).
    """

    diagnostics: list[Diagnostic]

    def __init__(self, message: str, diagnostics: list[Diagnostic]) -> None:
        """Keep the drawn message and the diagnostics."""
        super().__init__(message)
        self.diagnostics = diagnostics

    def __reduce__(self) -> tuple[type[InputError], tuple[str, list[Diagnostic]]]:
        """Pickle with the diagnostics."""
        return type(self), (str(self), self.diagnostics)


class LimitError(InputError):
    """Input that is too large, or rules that derive too much from it; one of the faults has the code
    `limit-exceeded`."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Tell which of the known names was probably meant; else all of them, if they are few."""
    names = list(known)
    near = _logicity.did_you_mean(str(name), names)
    if near is not None:
        return f"; did you mean `{near}`?"
    return f"; there are: {', '.join(names)}" if len(names) <= 30 else ""


def missing_extra(extra: str, error: ImportError) -> ImportError:
    """The error of an import that an extra of the package would have made possible, told with what installs it."""
    return type(error)(f"{error}; install the extra `{extra}`: pip install './python[{extra}]'", name=error.name)
