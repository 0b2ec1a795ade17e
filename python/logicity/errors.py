"""Exceptions for faulty input. Their `diagnostics` hold every fault with its place."""

from __future__ import annotations

from collections.abc import Iterable

from . import _logicity
from .types import Diagnostic

__all__ = ["InputError", "LimitError", "UnsupportedError"]


class InputError(ValueError):
    """Faulty rules, configurations, scenes or facts.

    The message shows every fault under its line, as the command line does.

    Attributes:
        diagnostics: The same faults as data. `code` is the stable name of a fault. The first of its `labels` is its
            place (file, line, column).
    """

    diagnostics: list[Diagnostic]

    def __init__(self, message: str, diagnostics: list[Diagnostic]) -> None:
        """Store the rendered message and the diagnostics."""
        super().__init__(message)
        self.diagnostics = diagnostics

    def __reduce__(self) -> tuple[type[InputError], tuple[str, list[Diagnostic]]]:
        """Pickle the message and the diagnostics."""
        return type(self), (str(self), self.diagnostics)


class LimitError(InputError):
    """Input or work beyond a limit. One of the diagnostics has the code `limit-exceeded`."""


class UnsupportedError(InputError):
    """Rules that the requested dense executor cannot evaluate. One diagnostic has the code `dense-unsupported`."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the end of a message: the known name nearest to `name`, or else all known names if they are few."""
    names = list(known)
    near = _logicity.did_you_mean(str(name), names)
    if near is not None:
        return f"; did you mean `{near}`?"
    return f"; known: {', '.join(names)}" if len(names) <= 30 else ""


def missing_extra(extra: str, error: ImportError) -> ImportError:
    """Return a copy of an import error that names the extra of this package to install."""
    return type(error)(f"{error}; install the extra `{extra}`: pip install './python[{extra}]'", name=error.name)
