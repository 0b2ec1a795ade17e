"""Files that are there whole or not at all."""

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
    """A temporary name to write under, which is renamed to `path` in the end: nobody finds half a file there."""
    temporary = f"{os.fspath(path)}.{os.getpid()}.tmp"
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write JSON, in place of what was there."""
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8") as out:
        json.dump(value, out, indent=1, allow_nan=False)
        out.write("\n")


def write_new(path: Path, text: str) -> None:
    """Write a text where there is nothing yet, or the same text; raises `FileExistsError` for anything else."""
    content = text.encode()
    if path.exists():
        if path.read_bytes() != content:
            raise FileExistsError(f"`{path}` is there already and is another: remove it, or write elsewhere")
        return
    with replacing(path) as temporary:
        Path(temporary).write_bytes(content)
