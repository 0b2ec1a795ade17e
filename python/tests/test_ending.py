"""Commands end on signals, and with them the programs and processes that they have started."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from conftest import needs, wait_for

needs("stable_baselines3", "learn")

from logicity.learn import programs  # noqa: E402
from logicity.learn.programs import Running, run_program  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")

#: A program that starts two others, notes all three, and does not end.
PROGRAM = """
import os, subprocess, sys, time
child = subprocess.Popen(["sleep", "600"])
# One has a session of its own, and its parent has ended.
away = subprocess.Popen(["sh", "-c", "sleep 600 & echo $!"], stdout=subprocess.PIPE, text=True, start_new_session=True)
with open(sys.argv[1], "w") as out:
    out.write(f"{os.getpid()} {child.pid} {away.stdout.readline()}")
os.rename(sys.argv[1], sys.argv[1] + ".started")
time.sleep(600)
"""


def lives(pid: int) -> bool:
    """Return whether a process runs. A zombie has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def started(folder: Path) -> list[int]:
    """Return the processes of the program when it has started."""
    noted = folder / "pids.started"
    wait_for(noted.exists)
    return [int(pid) for pid in noted.read_text().split()]


def command(folder: Path, options: Sequence[str]) -> subprocess.Popen[str]:
    """Start a command that runs the program, in a session of its own."""
    folder.mkdir()
    (folder / "program.py").write_text(PROGRAM)
    words = [sys.executable, str(folder / "program.py"), str(folder / "pids"), "--"]
    config = {"algorithm": "popper", "mode": "easy", "steps": 1, "demonstrations": 0.02, "settings": {"program": words}}
    (folder / "config.json").write_text(json.dumps(config))
    (folder / "tiny.yaml").write_text("title: Tiny\nconfig: config.json\nlearners: {popper: {}}\nmodes: [easy]\n")
    return subprocess.Popen(
        [sys.executable, "-m", "logicity", *options, "--run", str(folder / "run")],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


TRAIN = ["train", "config.json"]
EXPERIMENT = ["experiment", "tiny.yaml", "--jobs", "2"]


def ends(cases: Sequence[tuple[list[str], signal.Signals, int]], root: Path) -> None:
    """Start commands at the same time, send each its signal, and check that nothing is left."""
    running = [command(root / str(number), options) for number, (options, _, _) in enumerate(cases)]
    try:
        for number, (process, (_, sent, code)) in enumerate(zip(running, cases, strict=True)):
            pids = started(root / str(number))
            assert all(map(lives, pids))
            process.send_signal(sent)
            _, said = process.communicate(timeout=120)
            assert process.returncode == code, said
            assert "Traceback" not in said, said
            wait_for(lambda: not any(map(lives, pids)))  # noqa: B023
    finally:
        for process in running:
            process.kill()


def test_training_ends_its_program_on_every_signal(tmp_path: Path) -> None:
    ends(
        [
            (TRAIN, signal.SIGTERM, 143),
            (TRAIN, signal.SIGHUP, 129),
            (TRAIN, signal.SIGINT, 130),
            # The program also ends if nothing can end it.
            (TRAIN, signal.SIGKILL, -signal.SIGKILL),
        ],
        tmp_path,
    )


def test_an_experiment_ends_the_programs_of_its_processes(tmp_path: Path) -> None:
    ends([(EXPERIMENT, signal.SIGTERM, 143), (EXPERIMENT, signal.SIGKILL, -signal.SIGKILL)], tmp_path)


def test_an_experiment_ends_its_workers_on_ray(tmp_path: Path) -> None:
    needs("ray", "ray")
    ends([([*EXPERIMENT, "--ray"], signal.SIGTERM, 143)], tmp_path)


def test_ignored_signals_stay_ignored(tmp_path: Path) -> None:
    code = (
        "import os, signal\nfrom logicity.signals import ending_on_signals\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "with ending_on_signals():\n    os.kill(os.getpid(), signal.SIGHUP)\n    print('continues')\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (143, "continues\n")


# The second way is that of Windows.
@pytest.mark.parametrize("read", [programs._Selected, programs._Threaded])
def test_programs_have_an_exit_code_and_their_output(read: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "_READ", read)
    said = run_program([sys.executable, "-c", "import sys; print('out'); print('log', file=sys.stderr); sys.exit(3)"])
    assert said == (3, "out\n", "log\n")
    assert run_program([sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]).code == 128 + 9
    missing = run_program(["/no/such/program"])
    assert missing.code == 127 and missing.log.startswith("cannot run `/no/such/program`: ")
    assert run_program([sys.executable, "-c", "print(input())"]).code == 1  # standard input is empty
    states: list[Running] = []
    words = [sys.executable, "-c", "import time; print('begun\\n\\n***\\nhal', end='', flush=True); time.sleep(600)"]
    late = run_program(words, timeout=3.0, watch=states.append)
    assert late.code is None and late.output == "begun\n\n***\nhal"
    assert states[-1].line == "begun" and 2.5 < states[-1].seconds < 60
    assert [state.seconds for state in states] == sorted(state.seconds for state in states)


def test_no_process_of_an_ended_program_is_left(tmp_path: Path) -> None:
    code = PROGRAM.replace("time.sleep(600)\n", "")
    assert run_program([sys.executable, "-c", code, str(tmp_path / "pids")]).code == 0
    _, *children = started(tmp_path)
    wait_for(lambda: not any(map(lives, children)))
