"""Files of published results: JSON with one row per line."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..files import file_hash, read_json, reserved

__all__ = ["HASHED", "as_text", "is_published", "place_of", "read_file", "rehashed", "row_key", "updating"]

#: What the hash of a row covers: the `weights` of a network, the text of `rules`, or the `file` of the policy, which
#: depends on its format and can have times. `logicity experiment --rehash` replaces hashes of files.
HASHED = ("weights", "rules", "file")

#: The keys of a row that may differ when its policy is trained again, besides that of the hash.
_CHANGING = ("command", "cpu_seconds", "note", "sha256_of", "versions")


def read_file(
    path: str | os.PathLike[str], version: int, keys: Sequence[str], identity: Sequence[str]
) -> dict[str, Any] | None:
    """Read a file of results; return `None` if it does not exist.

    Args:
        path: The file.
        version: The version of its format.
        keys: The keys that each row must have.
        identity: The keys that identify a row. `seed` must be an integer, the others strings.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not such a file.
    """
    file = Path(path)
    if not file.exists():
        return None
    try:
        results = read_json(file)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{file}: not JSON: {error}") from None
    if not isinstance(results, dict) or results.get("format") != version or not isinstance(results.get("rows"), list):
        raise ValueError(f"{file}: expected results of the format {version}")
    for at, row in enumerate(results["rows"]):
        if not isinstance(row, dict):
            raise ValueError(f"{file}: row {at} is not a mapping")
        missing = [key for key in keys if key not in row]
        if missing:
            raise ValueError(f"{file}: row {at} has no `{missing[0]}`")
        if row.get("sha256_of") not in HASHED:
            raise ValueError(f"{file}: row {at} has an invalid `sha256_of`")
        for key in identity:
            if not isinstance(row[key], int if key == "seed" else str):
                raise ValueError(f"{file}: row {at} has an invalid `{key}`")
    return results


def as_text(results: Mapping[str, Any]) -> str:
    """Return the text of a file of results: JSON with one line per row."""
    head = {key: value for key, value in results.items() if key != "rows"}
    lines = ",\n".join(json.dumps(row, allow_nan=False) for row in results["rows"])
    return f'{json.dumps(head)[:-1]}, "rows": [\n{lines}\n]}}\n'


@contextmanager
def updating(path: Path, read: Callable[[], dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the results that `read` returns, and write them back at the end. No other process can add rows meanwhile.

    Raises:
        OSError: If the file cannot be written, or another process writes it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with reserved(path, by=None) as output:
        results = read()
        yield results
        Path(output.temporary).write_text(as_text(results), encoding="utf-8")
        output.finish()


def is_published(row: Mapping[str, Any], sha256: str, file: Path) -> bool:
    """Return whether a published row has the hash of a file, so that nothing needs to be measured again.

    Args:
        row: The row.
        sha256: The key of the hash.
        file: The file of the policy or model.
    """
    return bool(row["sha256_of"] == "file" and row[sha256] == file_hash(file))


def rehashed(old: Mapping[str, Any], new: Mapping[str, Any], sha256: str) -> dict[str, Any]:
    """Return a published row with the hash of the policy that was trained again. Its figures stay as they are.

    Args:
        old: The row.
        new: The row of the policy that was trained again.
        sha256: The key of the hash.

    Raises:
        ValueError: If the rows have other figures, settings, rules or episodes.
    """
    again = json.loads(json.dumps(new))
    different = [key for key in old if key not in (*_CHANGING, sha256) and old[key] != again.get(key)]
    if different:
        raise ValueError(f"the published row differs in {', '.join(f'`{key}`' for key in different)}")
    if old["sha256_of"] == again["sha256_of"] and old[sha256] != again[sha256]:
        raise ValueError(f"the published row has the {old['sha256_of']} {old[sha256]}, not {again[sha256]}")
    return {**old, **{key: again[key] for key in ("versions", "sha256_of", sha256)}}


def row_key(row: Mapping[str, Any], identity: Sequence[str]) -> tuple[Any, ...]:
    """Return the values of the keys that identify a row."""
    return tuple(row[key] for key in identity)


def place_of(row: Mapping[str, Any], order: Mapping[str, Sequence[str]]) -> tuple[int, ...]:
    """Return the place of a row: that of each of its names in `order`, and its seed. Unknown names come last."""
    places = [list(names).index(row[key]) if row[key] in names else len(names) for key, names in order.items()]
    return (*places, row["seed"])
