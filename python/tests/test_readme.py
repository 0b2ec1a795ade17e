from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BLOCKS = {
    f"{name}-{number}": block
    for name in ("README.md", "python/README.md")
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", (ROOT / name).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    )
}


@pytest.mark.parametrize("block", BLOCKS)
def test_python_blocks_of_readmes_run(block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[block], block, "exec"), {})


def test_both_readmes_have_python_blocks() -> None:
    assert len({name.split("-")[0] for name in BLOCKS}) == 2
