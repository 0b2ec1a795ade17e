"""The figures of the paper."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

__all__ = ["paper_table"]


@cache
def paper_table(name: str | None) -> dict[str, Any]:
    """Return the figures of a table of the paper: `source`, `note` and `rows`. Empty without such a table."""
    text = files(__package__).joinpath("paper.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text).get(name, {})
    return table
