"""Exceptions for invalid input. Their `diagnostics` list every error with its location."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, SupportsIndex, TypeAlias

from . import _logicity
from .types import Diagnostic

__all__ = ["InputError", "LimitError", "PredicateError", "UnsupportedError", "UntrustedError"]

#: The keys of `Limits`.
_LIMITS = ("max_rows", "max_steps", "max_bytes")

#: The values of `Limits`, in the order of its keys.
LimitArguments: TypeAlias = tuple[int | None, int | None, int | None]


class InputError(ValueError):
    """Invalid rules, configurations, scenes, facts, episodes or data sets.

    The message shows every error under its source line, as the command line does.

    Attributes:
        diagnostics: The same errors as data. `code` is the stable name of an error. The first of its `labels` is its
            location (file, line, column).
    """

    def __init__(self, message: str, diagnostics: list[Diagnostic]) -> None:
        """Store the rendered message and the diagnostics."""
        super().__init__(message)
        self.diagnostics = diagnostics

    def __reduce__(self) -> tuple[type[InputError], tuple[str, list[Diagnostic]]]:
        """Pickle the message and the diagnostics."""
        return type(self), (str(self), self.diagnostics)


class LimitError(InputError):
    """Input or work that exceeds a limit. One of the diagnostics has the code `limit-exceeded`."""


class UnsupportedError(InputError):
    """Rules that the dense executor cannot evaluate. One of the diagnostics has the code `dense-unsupported`."""


class PredicateError(RuntimeError):
    """The function of a predicate that fails, or returns something else than its facts. See `logicity.predicate`.

    The message names the predicate and the tick. `__cause__` is the exception of the function, if it raised one.
    """


class CommandError(ValueError):
    """A command in another process that fails.

    Attributes:
        code: The exit code of the command; after a signal, 128 and its number, as in shells.
    """

    def __init__(self, message: str, code: int) -> None:
        """Store the message, usually that of the command, and the exit code."""
        # Pickles of exceptions have these arguments.
        super().__init__(message, code)
        self.code = code if code >= 0 else 128 - code

    def __str__(self) -> str:
        """Return the message."""
        return str(self.args[0])


class UntrustedError(ValueError):
    """A file that can run any code when it is loaded, without the caller's trust in it."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return a suffix for error messages: the known name closest to `name`, or all known names if they are few.

    Ignores empty names. Without known names, the suffix is empty.
    """
    names = [each for each in known if each]
    near = _logicity.did_you_mean(str(name), names)
    if near is not None:
        return f"; did you mean `{near}`?"
    return f"; known: {', '.join(names)}" if 0 < len(names) <= 30 else ""


def checked_path(name: str, value: str | os.PathLike[str]) -> str:
    """Return an argument that names a file or folder as a string. Raise `TypeError` for others and for bytes."""
    path = os.fspath(value) if isinstance(value, (str, os.PathLike)) else None
    if not isinstance(path, str):
        raise TypeError(f"{name}: expected str or os.PathLike[str], not {type(value).__name__}")
    return path


def as_integer(name: str, value: SupportsIndex) -> int:
    """Return an integer argument as an int. Raise `TypeError` for other types."""
    try:
        return operator.index(value)
    except TypeError:
        raise TypeError(f"{name}: expected an integer, not {type(value).__name__}") from None


def checked_integer(name: str, value: SupportsIndex, low: int = 0, high: int = 2**64 - 1) -> int:
    """Variant of `as_integer` that raises `ValueError` if the value is less than `low` or greater than `high`."""
    number = as_integer(name, value)
    if not low <= number <= high:
        largest = f"2**{high.bit_length()} - 1" if high == 2 ** high.bit_length() - 1 > 2**16 else f"{high}"
        raise ValueError(f"{name}: expected {low} to {largest}, not {number}")
    return number


def checked_threads(value: SupportsIndex, low: int = 0) -> int:
    """Variant of `checked_integer` for the argument `threads`."""
    return checked_integer("threads", value, low, _logicity.THREADS_MAX)


def checked_limits(limits: Mapping[str, Any] | None) -> LimitArguments:
    """Check the limits of an evaluation and return them in the order of `_LIMITS`; `None` for the default."""
    if limits is None:
        return None, None, None
    if not isinstance(limits, Mapping):
        raise TypeError(f"limits: expected a mapping, not {type(limits).__name__}")
    for name in limits:
        if name not in _LIMITS:
            raise ValueError(f"limits: unknown key {name!r}; known: {', '.join(_LIMITS)}")
    rows, steps, size = (None if limits.get(name) is None else checked_integer(name, limits[name]) for name in _LIMITS)
    return rows, steps, size


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Name the extra to install in the message of an import that fails."""
    try:
        yield
    except ImportError as error:
        message = f"{error}; install the extra `{name}`: pip install 'logicity[{name}]'"
        raise type(error)(message, name=error.name) from error
