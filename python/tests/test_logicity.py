"""The package as a whole: its door, its documentation, its stubs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import logicity


def test_the_door_only_re_exports() -> None:
    assert set(logicity.__all__) <= set(dir(logicity))
    for name in logicity.__all__:
        home = getattr(getattr(logicity, name), "__module__", "logicity")
        assert home.startswith(("logicity", "typing")), name


def test_everything_public_is_documented() -> None:
    for name in logicity.__all__:
        thing = getattr(logicity, name)
        if isinstance(thing, type):
            assert thing.__doc__, name
            for member, value in vars(thing).items():
                if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                    assert value.__doc__, f"{name}.{member}"


def test_the_stubs_are_those_of_the_module(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "logicity._logicity"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
