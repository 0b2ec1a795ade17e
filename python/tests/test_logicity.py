"""The package as a whole: its door, its documentation, its stubs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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


def test_what_an_extra_would_bring_is_told_with_its_name() -> None:
    # As if none of them were installed, wherever this runs.
    text = """
import sys
for name in ("stable_baselines3", "pettingzoo", "minari", "pyarrow"):
    sys.modules[name] = None

import logicity
few = logicity.demonstrations("easy", 1)
for use in (
    lambda: logicity.sb3.make_vec_env,
    lambda: logicity.train,
    lambda: logicity.parallel,
    logicity.parallel_env,
    few.to_minari,
    lambda: few.to_parquet("steps.parquet"),
):
    try:
        use()
    except ImportError as error:
        print(str(error).partition("install ")[2])
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    extras = ["train", "train", "pettingzoo", "pettingzoo", "offline", "offline"]
    expected = [f"the extra `{extra}`: pip install './python[{extra}]'" for extra in extras]
    assert (done.stdout.splitlines(), done.stderr) == (expected, "")


def test_there_is_no_more_than_there_is() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'sb4'"):
        getattr(logicity, "sb4")  # noqa: B009


def test_the_stubs_are_those_of_the_module(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "logicity._logicity"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_controls_are_typed_as_one_writes_them(tmp_path: Path) -> None:
    text = """
from logicity import Action, Simulation

city = Simulation("easy")
by_name: dict[str, str] = {"Car_1": "Stop"}
by_action: dict[str, Action] = {"Car_1": "Stop"}
by_number: dict[int, int] = {0: 3}
by_either: dict[str | int, str | int] = {"Car_1": 3, 1: "Stop"}
for controls in (by_name, by_action):
    city.tick(controls)
city.tick(by_number)
city.tick(by_either)
city.tick({"Car_1": "Stop", 1: 3})
city.tick({})
city.tick(None)
city.tick({1.5: "Stop"})  # type: ignore[type-var]
city.tick({"Car_1": 1.5})  # type: ignore[dict-item]
"""
    (tmp_path / "use.py").write_text(text)
    checked = [sys.executable, "-m", "mypy", "--strict", "--warn-unused-ignores", "use.py"]
    done = subprocess.run(checked, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
