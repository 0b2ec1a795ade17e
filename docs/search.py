"""Check that the search of a built site knows every predicate, message and option by its name.

`python docs/search.py target/docs` prints the names that are missing, then the number of names, and exits with 1 if one
is missing.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]


def known(site: Path) -> set[str]:
    """Return the full names of the objects in the index of the search."""
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    return {
        f"{prefix}.{entry[4]}" if prefix else entry[4] for prefix, found in index["objects"].items() for entry in found
    }


def expected() -> Iterator[str]:
    """Yield the names of predicates, messages and options, as `logicity` and its vocabulary have them."""
    vocabulary = (ROOT / "rules" / "vocabulary.dl").read_text(encoding="utf-8")
    yield from re.findall(r"^\.decl (\w+)", vocabulary, re.MULTILINE)
    for line in output("codes", "--json").splitlines():
        yield json.loads(line)["code"]
    yield from options(json.loads(output("reference")), "")


def options(command: dict[str, Any], path: str) -> Iterator[str]:
    """Yield the long options of a command and of its subcommands, as the index has them: `logicity-run.--seed`."""
    path = f"{path} {command['name']}".strip()
    for argument in command["arguments"] if not command["commands"] else []:
        if argument["long"]:
            yield f"{path.replace(' ', '-')}.--{argument['long']}"
    for inner in command["commands"]:
        yield from options(inner, path)


def output(*arguments: str) -> str:
    """Return what the command prints."""
    command = [sys.executable, "-m", "logicity", *arguments]
    return subprocess.run(command, stdout=subprocess.PIPE, encoding="utf-8", check=True).stdout


def main(site: Path) -> int:
    """Print what the search does not know, then the number of names."""
    found, names = known(site), list(expected())
    missing = [name for name in names if name not in found]
    for name in missing:
        print(f"the search does not know `{name}`", file=sys.stderr)
    print(f"{len(names)} names for the search, {len(missing)} missing")
    return 1 if missing or not names else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
