"""Folders of packed policies, which `logicity release` writes, and the policies that the package contains.

`shipped_policies` lists the policies of the package, whose folder has the form that `logicity release` writes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any, Final

from .files import read_json

__all__ = ["INDEX", "SHIPPED", "ShippedPolicy", "packed_policies", "shipped_policies"]

#: The file that lists the policies in a folder.
INDEX: Final = "policies.json"

#: The folder of the policies that the package contains. `make policies` writes it.
SHIPPED: Final = Path(__file__).parent / "policies"


@dataclass(frozen=True)
class ShippedPolicy:
    """A trained policy that the package contains.

    Attributes:
        name: The name, which `logicity evaluate --policy` accepts.
        path: The file: rules (`.dl`), which `RulePolicy` reads, or weights (`.safetensors`), which
            `logicity.learn.load_policy` reads.
        mode: The mode of the training.
        learner: The name of the learner.
        seed: The seed of the training.
        sha256: SHA-256 of the rules or weights, as in the published results.
        command: The command that trains and measures it.
        extra: The extra that the policy needs, or `None` if it needs only numpy.
        measures: Published means by the set of episodes, `test` or the name of a town, and the measure, such as `tsr`.
    """

    name: str
    path: Path
    mode: str
    learner: str
    seed: int
    sha256: str
    command: str
    extra: str | None
    measures: Mapping[str, Mapping[str, float]]


def shipped_policies() -> dict[str, ShippedPolicy]:
    """Return the trained policies that the package contains, keyed by name."""
    found = {}
    for entry in packed_policies(SHIPPED) or []:
        path = SHIPPED / entry["file"]
        found[entry["name"]] = ShippedPolicy(
            path=path,
            **{key: entry[key] for key in ("name", "mode", "learner", "seed", "sha256", "command")},
            extra=None if path.suffix == ".dl" else "learn",
            measures={
                row["evaluation"]: {name: of["value"] for name, of in row["measures"].items() if isinstance(of, dict)}
                for row in read_json(path.parent / "rows.json")["rows"]
            },
        )
    return found


def packed_policies(folder: Path) -> list[dict[str, Any]] | None:
    """Return the entries of the index of a folder of policies, or `None` if the folder has no index.

    Raises:
        ValueError: If the index is faulty.
    """
    file = folder / INDEX
    if not file.is_file():
        return None
    try:
        index = read_json(file)
        entries = index["policies"]
        valid = index["format"] == 1 and all(
            _is_folder_name(entry["name"])
            and isinstance(entry["mode"], str)
            and isinstance(entry["file"], str)
            and (folder / entry["file"]).resolve().is_relative_to(folder.resolve())
            for entry in entries
        )
        valid &= len({entry["name"] for entry in entries}) == len(entries)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file} is not an index of policies: {error!r}") from None
    if not valid:
        faults = "or has a name twice, or one that is no name of a folder, or a file outside of its folder"
        raise ValueError(f"{file} is not an index of policies of format 1, {faults}")
    return list(entries)


def _is_folder_name(name: object) -> bool:
    """Return whether a name is that of a folder in any other folder, on every system."""
    # Both `/` and `\` separate the parts of such paths, which may begin with a drive.
    return isinstance(name, str) and "\0" not in name and name != ".." and PureWindowsPath(name).parts == (name,)
