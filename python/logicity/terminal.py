"""Text on the terminal. What others wrote cannot control it: every command prints through this module."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

__all__ = ["aligned", "first_line", "flush", "neutral", "print_message", "print_text"]

# Controls but tabs and line breaks, marks that reorder or break lines, and bytes of file names that are not UTF-8. The
# function of the same name in Rust replaces the same characters.
_ACTIVE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u206f\ufff9-\ufffb\ud800-\udfff]"
)


def neutral(text: str, *, lines: bool = True) -> str:
    r"""Return a text with escapes such as `\u001b` in place of characters on which a terminal acts.

    With `lines`, line breaks stay.
    """
    shown = _ACTIVE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
    return shown if lines else shown.replace("\n", "\\n")


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells as a text table."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def first_line(message: str, default: str = "no message") -> str:
    """Return the first line of a message, or the default if the message is empty."""
    return next(iter(message.splitlines()), default)


def print_text(text: object, *, end: str = "\n", flush: bool = False) -> None:
    """Print a text to standard output. Raise `BrokenPipeError` if the reader has closed the pipe."""
    with _writing():
        print(neutral(str(text)), end=end, flush=flush)


def flush() -> None:
    """Write what standard output has buffered. The exceptions are those of `print_text`."""
    # A process may have no standard output.
    if sys.stdout is not None and not sys.stdout.closed:
        with _writing():
            sys.stdout.flush()


@contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        # So Windows reports that the reader has closed the pipe.
        if sys.platform == "win32" and error.errno == errno.EINVAL:
            raise BrokenPipeError from None
        # Python writes the rest at exit, which must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(f"cannot write to standard output: {(error.strerror or str(error)).lower()}") from None


def print_message(text: object) -> None:
    """Print a line to standard error. If it cannot be written, later lines are dropped, and the work continues."""
    # Python would print to standard output if the process has no standard error.
    if sys.stderr is None or sys.stderr.closed:
        return
    try:
        print(neutral(str(text)), file=sys.stderr, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
