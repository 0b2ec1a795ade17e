from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

#: Scripts that train for about a minute. Tests of their frameworks run them.
TRAINED = {"cleanrl_dqn", "cleanrl_ppo", "torchrl_ppo"}
EXAMPLES = sorted(path for path in (Path(__file__).parents[1] / "examples").glob("*.py") if path.stem not in TRAINED)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_print_what_their_docstrings_show(path: Path, tmp_path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") < 60
    shown = re.search(r"^```text\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    arguments = []
    if "stable_baselines3" in text:
        pytest.importorskip("stable_baselines3", reason="needs the extra `learn`: `make python-all` installs it")
        arguments = ["1100"]  # fewer steps than the example shows
    warnings = [] if arguments else ["-W", "error"]
    command = [sys.executable, *warnings, "-X", "utf8", str(path), *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    printed = [line.rstrip() for line in done.stdout.splitlines()]
    if arguments:
        # What a trained model does depends on the version of PyTorch.
        assert [line.split()[0] for line in printed[:3]] == ["dqn", "oracle", "random"]
        assert printed[-1].startswith("shape of the last picture: ")
    else:
        assert shown, f"{path.name} shows no output"
        assert printed == shown[1].splitlines()


def test_there_are_five_examples_that_need_no_training() -> None:
    assert sum("```text" in path.read_text(encoding="utf-8") for path in EXAMPLES) >= 5
