"""Lines of text for people: progress, and the first lines of error messages."""

from __future__ import annotations

import os
import sys

__all__ = ["first_line", "print_progress"]


def first_line(message: str, default: str = "no message") -> str:
    """Return the first line of a message, or the default if the message is empty."""
    return next(iter(message.splitlines()), default)


def print_progress(line: str) -> None:
    """Print a line to standard error. If its reader has closed it, later lines are dropped, and the work continues."""
    try:
        print(line, file=sys.stderr, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
