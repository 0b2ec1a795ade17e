"""Atomic writes: a file is either complete or absent."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["replacing", "write_json", "write_new"]


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[str]:
    """Yield a temporary path to write to. On success, the file replaces `path`."""
    temporary = f"{os.fspath(path)}.{os.getpid()}.tmp"
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write JSON, replacing an existing file."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8") as out:
        json.dump(value, out, indent=1, allow_nan=False)
        out.write("\n")


def write_new(path: Path, text: str) -> None:
    """Write text to a file unless it already exists with the same content.

    Raises:
        FileExistsError: If the file has different content.
    """
    content = text.encode()
    if path.exists():
        if path.read_bytes() != content:
            raise FileExistsError(f"`{path}` exists with different content: remove it, or choose another path")
        return
    with replacing(path) as temporary:
        Path(temporary).write_bytes(content)
