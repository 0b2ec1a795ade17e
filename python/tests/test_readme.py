from __future__ import annotations

import re
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS)
def test_the_python_of_readme_runs(block: str) -> None:
    exec(compile(block, str(README), "exec"), {})


def test_readme_shows_python() -> None:
    assert BLOCKS
