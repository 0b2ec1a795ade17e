"""Installation of the wheel in a fresh virtual environment."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


class Environment:
    """A fresh virtual environment and a working directory."""

    def __init__(self, folder: Path) -> None:
        subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
        self.scripts = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
        self.work = folder / "work"
        self.work.mkdir()

    def run(self, *command: str, code: int = 0) -> str:
        program, *arguments = command
        env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        done = subprocess.run(
            [self.scripts / program, *arguments], cwd=self.work, env=env, capture_output=True, text=True
        )
        assert done.returncode == code, (command, done.stdout, done.stderr)
        return done.stdout if code == 0 else done.stderr

    def install(self, package: str) -> set[str]:
        self.run("python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", package)
        listed = self.run("python", "-m", "pip", "list", "--format", "json", "--disable-pip-version-check")
        return {each["name"] for each in json.loads(listed)} - {"pip", "setuptools"}


@pytest.fixture(scope="module")
def wheel() -> Path:
    given = os.environ.get("LOGICITY_WHEEL")
    if given is None:
        pytest.skip("needs the path of a wheel in LOGICITY_WHEEL: `make python` builds it and sets that")
    return Path(given).resolve()


@pytest.fixture(scope="module")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    environment = Environment(tmp_path_factory.mktemp("fresh"))
    assert environment.install(str(wheel)) == {"logicity", "numpy"}
    return environment


def test_one_wheel_serves_every_python(wheel: Path) -> None:
    assert "-cp310-abi3-" in wheel.name


def test_the_wheel_installs_the_command(fresh: Environment) -> None:
    assert fresh.run("logicity", "--version") == fresh.run("python", "-m", "logicity", "--version")
    summary = fresh.run("logicity", "run", "expert", "--seed", "4", "--ticks", "20")
    assert "dense executor" in summary and (fresh.work / "out" / "city.gif").is_file()
    assert "usage: logicity train" in fresh.run("logicity", "train", "--help")
    assert "pip install 'logicity[learn]'" in fresh.run("logicity", "train", "dqn-easy", code=2)
    assert "TSR" in fresh.run("logicity", "evaluate", "--policy", "oracle", "--modes", "easy", "--split", "val")


def test_the_wheel_contains_trained_policies(fresh: Environment) -> None:
    lines = fresh.run("logicity", "policies").splitlines()[1:-2]
    rules = [line.split()[0] for line in lines if line.split()[3] == "-"]
    assert {"spf-induce-easy-0", "spf-induce-expert-0"} <= set(rules)
    for name in rules:
        assert name in fresh.run("logicity", "evaluate", "--policy", name, "--split", "val")
    (network,) = {line.split()[0] for line in lines if line.split()[3] != "-"}
    assert "pip install 'logicity[learn]'" in fresh.run("logicity", "evaluate", "--policy", network, code=2)


def test_datalog_needs_numpy_only(fresh: Environment) -> None:
    text = """
from logicity import Program, Session
session = Session(Program('.decl p(x: symbol) .input p .decl q(x: symbol) q(x) :- p(x).'))
session.insert("p", [("a",)])
session.commit()
print(session.rows("q"))
"""
    assert fresh.run("python", "-c", text) == "[('a',)]\n"
    message = fresh.run("python", "-c", "import logicity; logicity.envs.single", code=1)
    assert "pip install 'logicity[gym]'" in message


def test_the_gym_extra_installs_environments(fresh: Environment, wheel: Path) -> None:
    assert "gymnasium" in fresh.install(f"{wheel}[gym]")
    text = "import logicity, gymnasium; print(gymnasium.make('logicity/SPF-Easy-v0').reset(seed=1)[0].shape)"
    assert fresh.run("python", "-c", text) == "(85,)\n"
