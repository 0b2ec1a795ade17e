"""The text of error messages."""

from __future__ import annotations

__all__ = ["first_line"]


def first_line(message: str, default: str = "no message") -> str:
    """Return the first line of a message, or the default if the message is empty."""
    return next(iter(message.splitlines()), default)
