from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import needs

ROOT = Path(__file__).parents[2]
BLOCKS = {
    f"{name}-{number}": block
    for name in ("README.md", "python/README.md")
    for number, block in enumerate(
        re.findall(r"^```python\n(.*?)^```", (ROOT / name).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    )
}


@pytest.mark.parametrize("block", BLOCKS)
def test_python_blocks_of_readmes_run(
    block: str, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = BLOCKS[block]
    if "import torch" in text:
        needs("torch", "vap")
    if "vap-test" in text:
        # A shell command in the README creates this data set.
        (tmp_path / "vap-test").symlink_to(request.getfixturevalue("shown"))
    monkeypatch.chdir(tmp_path)
    exec(compile(text, block, "exec"), {})


def test_both_readmes_have_python_blocks() -> None:
    assert len({name.split("-")[0] for name in BLOCKS}) == 2
