"""Planners solve the problems that `logicity pddl` writes, and the city drives their plans."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest import needs

from logicity.__main__ import main

PLAIN = ("easy", "medium", "hard", "expert")


def written(capfd: pytest.CaptureFixture[str], folder: Path, *options: str) -> Any:
    """Write a problem, and return what the command reports."""
    capfd.readouterr()
    assert main(["pddl", *options, "--out", str(folder), "--json", "--force"]) == 0
    return json.loads(capfd.readouterr().out)


def driven(capfd: pytest.CaptureFixture[str], plan: Path, *options: str) -> Any:
    """Drive a plan, which must break no rule, and return what the command reports."""
    capfd.readouterr()
    code = main(["pddl", *options, "--replay", str(plan), "--json"])
    printed = capfd.readouterr()
    assert code == 0, printed.err
    return json.loads(printed.out)


def fast_downward(folder: Path) -> int:
    """Solve a problem optimally, write the plan to `plan`, and return its cost."""
    package = needs("up_fast_downward", "planning")
    program = Path(package.__path__[0]) / "downward" / "fast-downward.py"
    words = [program, "--plan-file", "plan", "domain.pddl", "problem.pddl", "--search", "astar(blind())"]
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    last = (folder / "plan").read_text().splitlines()[-1]
    return int(last.partition("=")[2].split()[0])


@pytest.mark.parametrize("mode", PLAIN)
def test_fast_downward_finds_the_cheapest_way_for_one_agent(
    mode: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for episode, start in [("0", "6"), ("5", "12"), ("9", "0")]:
        state = [mode, "--episode", episode, "--start", start]
        report = written(capfd, tmp_path, *state, "--horizon", "14")
        cost = fast_downward(tmp_path)
        result = driven(capfd, tmp_path / "plan", *state)
        assert cost == result["cost"] == report["cheapest"]
        assert result["return"] == pytest.approx(-cost / report["cost_per_return"], abs=1e-12)
        assert not any(step["violations"] for step in result["steps"])


@pytest.mark.parametrize("mode", PLAIN)
def test_fast_downward_solves_problems_of_several_agents(
    mode: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for episode, start in [("1", "8"), ("4", "15")]:
        state = [mode, "--episode", episode, "--start", start]
        report = written(capfd, tmp_path, *state, "--encoding", "multi-agent", "--horizon", "4")
        known = written(capfd, tmp_path / "one", *state, "--horizon", "4")
        cost = fast_downward(tmp_path)
        result = driven(capfd, tmp_path / "plan", *state)
        assert cost == result["cost"] <= known["cheapest"]
        assert result["return"] == pytest.approx(-cost / report["cost_per_return"], abs=1e-12)


@pytest.mark.parametrize("mode", PLAIN)
def test_pyperplan_solves_problems_without_axioms(mode: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs("pyperplan", "planning")
    from pyperplan.planner import SEARCHES, search_plan

    state = [mode, "--episode", "3", "--start", "5"]
    written(capfd, tmp_path, *state, "--encoding", "strips", "--horizon", "12")
    files = [str(tmp_path / name) for name in ("domain.pddl", "problem.pddl")]
    plan = search_plan(*files, SEARCHES["bfs"], None)
    assert plan is not None
    (tmp_path / "plan").write_text("".join(f"{step.name}\n" for step in plan))
    result = driven(capfd, tmp_path / "plan", *state)
    assert len(result["steps"]) == len(plan) - 1
    assert not any(step["violations"] for step in result["steps"])


def test_unified_planning_reads_problems_without_axioms(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs("unified_planning", "planning")
    from unified_planning.io import PDDLReader

    written(capfd, tmp_path, "easy", "--episode", "3", "--encoding", "strips", "--horizon", "6")
    problem = PDDLReader().parse_problem(str(tmp_path / "domain.pddl"), str(tmp_path / "problem.pddl"))
    assert {action.name for action in problem.actions} == {"go-slow", "go-normal", "go-fast", "go-stop", "arrive"}


def test_a_plan_that_breaks_a_rule_is_an_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    report = written(capfd, tmp_path, "easy", "--episode", "0")
    assert report["reaches_goal"] and report["horizon"] > 5
    # A car that never stops drives into what is ahead.
    (tmp_path / "plan").write_text("(choose-fast)\n" * report["horizon"])
    assert main(["pddl", "easy", "--episode", "0", "--replay", str(tmp_path / "plan")]) == 1
    printed = capfd.readouterr()
    assert "error[invalid-plan]: the plan violates S" in printed.err and "violates S" in printed.out
