from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import CancelledError
from pathlib import Path

import pytest
from conftest import needs

from logicity.__main__ import main
from logicity.errors import CommandError
from logicity.shards import _plan, _Processes, make_shards, run_command

EPISODES = ["episodes", "make", "easy", "--count", "4"]


def filled(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_shards_in_processes_equal_one_run(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    whole, joined = tmp_path / "whole.jsonl", tmp_path / "joined.jsonl"
    run_command([*EPISODES, "--output", str(whole)])
    assert main(["shards", "3", "--jobs", "2", "--", *EPISODES, "-o", str(joined)]) == 0
    shown = capfd.readouterr()
    assert joined.read_bytes() == whole.read_bytes()
    assert "wrote 4 episodes" in shown.out and "[3/3]" in shown.err
    # An interrupted call is resumed.
    joined.unlink()
    (tmp_path / "joined.jsonl-shards" / "shard-2").unlink()
    lines: list[str] = []
    make_shards([*EPISODES, "-o", str(joined)], 3, progress=lines.append)
    assert joined.read_bytes() == whole.read_bytes()
    assert lines == ["2 of 3 shards are made already", f"[3/3] {tmp_path / 'joined.jsonl-shards' / 'shard-2'}"]


def test_shards_of_worlds_are_folders(tmp_path: Path) -> None:
    command = ["vap", "make", "--mode", "easy", "--split", "test", "--worlds", "2", "--no-pictures"]
    run_command([*command, "--out", str(tmp_path / "whole")])
    # As shells complete the name of a folder.
    make_shards([*command, f"--out={tmp_path / 'joined'}{os.sep}"], 2, jobs=1)
    assert filled(tmp_path / "joined") == filled(tmp_path / "whole")
    assert {path.name for path in tmp_path.iterdir() if path.name[0] != "."} == {"joined", "joined-shards", "whole"}


def test_outputs_without_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    for folder, output in (("a", "."), ("a/b", "..")):
        monkeypatch.chdir(tmp_path / folder)
        assert _plan([*EPISODES, "-o", output], 1).folder == Path.cwd().resolve().parents[output == ".."] / "a-shards"
    with pytest.raises(ValueError, match="cannot be an output with shards"):
        _plan([*EPISODES, "-o", os.sep], 1)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["run", "easy", "-o", "x"], "`run easy` has no shards; the commands with shards are: episodes make, "),
        ([*EPISODES], "name the output of `episodes make` with `--output`"),
        ([*EPISODES, "-o", "-"], "name the output of `episodes make` with `--output`"),
        ([*EPISODES, "-o", "x", "--shard", "1/2"], "leave out `--shard`"),
    ],
)
def test_faulty_commands_are_refused(command: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["shards", "2", "--", *command]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ray", "10.0.0.1:6379"], "--jobs: the Ray cluster at `10.0.0.1:6379` determines the number of workers"),
        (["--slurm", "cluster=local"], "--jobs: the cluster `local` of `--slurm` runs all shards at once"),
        (["--slurm", "slurm_array_parallelism=3"], "--jobs: `--slurm` has `slurm_array_parallelism`"),
    ],
)
def test_jobs_without_effect_are_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["shards", "2", "--jobs", "1", *options, "--", *EPISODES, "-o", str(tmp_path / "x")]) == 2
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())
    if options[0] == "--ray":
        assert main(["experiment", "spf", "--jobs", "1", *options, "--run", str(tmp_path / "x")]) == 2
        assert message in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_other_folders_are_refused(tmp_path: Path) -> None:
    output = tmp_path / "x"
    folder = tmp_path / "x-shards"
    folder.mkdir()
    (folder / "mine").touch()
    with pytest.raises(ValueError, match="has files that are not shards"):
        make_shards([*EPISODES, "-o", str(output)], 2)
    (folder / "mine").unlink()
    make_shards([*EPISODES, "-o", str(output)], 2)
    with pytest.raises(ValueError, match="has the shards of another command"):
        make_shards([*EPISODES, "-o", str(output)], 3)


def test_a_command_that_made_no_shard_can_be_corrected(tmp_path: Path) -> None:
    output, folder = tmp_path / "x", tmp_path / "x-shards"
    with pytest.raises(CommandError):
        make_shards(["episodes", "make", "easy", "--cuont", "4", "-o", str(output)], 2)
    assert [path.name for path in folder.iterdir() if path.name[0] != "."] == ["command.json"]
    (folder / "command.json").write_text("{")
    make_shards([*EPISODES, "-o", str(output)], 2)
    assert output.exists()
    (folder / "command.json").write_text("{")
    with pytest.raises(ValueError, match="has the shards of another command"):
        make_shards([*EPISODES, "-o", str(output)], 2)


def faulty(folder: Path) -> list[str]:
    """Return a command whose configuration has a mistake."""
    city = folder / "city.yaml"
    city.write_text("base: easy\ntask: {horizon: long}\n")
    return ["episodes", "make", str(city), "-o", str(folder / "x")]


def test_the_message_and_the_code_of_a_failed_shard(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(CommandError, match=r"(?s)`logicity questions .* --shard ./2 .*no car concept `train`") as error:
        make_shards(["questions", "--about", "train", "-o", str(tmp_path / "x")], 2)
    again = pickle.loads(pickle.dumps(error.value))
    assert (str(again), again.code) == (str(error.value), 2)
    # Faulty input, usage, and shards that do not fit.
    assert main(["shards", "2", "--", *faulty(tmp_path)]) == 1
    assert "city.yaml:2:" in capfd.readouterr().err
    assert main(["shards", "2", "--", *EPISODES, "--no-such-option", "-o", str(tmp_path / "y")]) == 2
    assert "--no-such-option" in capfd.readouterr().err
    assert main(["shards", "2", "--", *EPISODES, "-o", str(tmp_path / "z")]) == 0
    (tmp_path / "z").unlink()
    (tmp_path / "z-shards" / "shard-1").write_text("{}\n")
    assert main(["shards", "2", "--", *EPISODES, "-o", str(tmp_path / "z")]) == 1
    assert "`logicity merge " in capfd.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_an_interrupted_command_ends_its_shards(tmp_path: Path) -> None:
    assert CommandError("interrupted", -signal.SIGINT).code == 130
    command = ["questions", "--count", "100000", "-o", str(tmp_path / "x")]
    arguments = [sys.executable, "-m", "logicity", "shards", "4", "--jobs", "2", "--", *command]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, encoding="utf-8") as process:
        while not (tmp_path / "x-shards" / "command.json").exists() and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        # Its pipe closes when no other process has it.
        _, said = process.communicate()
    assert process.returncode == 130 and "interrupted" in said


def test_no_process_starts_after_the_end() -> None:
    processes = _Processes()
    processes.stop()
    with pytest.raises(CancelledError):
        run_command(["--version"], processes=processes)


def test_what_a_command_prints_is_read_as_utf_8(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Python decodes with the encoding of this locale by default.
    for name, value in {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "a.dl").write_text("Stop(X) :- \u00fc.\n", encoding="utf-8")
    code = "from logicity.shards import run_command\n"
    code += "try:\n    run_command(['check', 'a.dl'])\nexcept ValueError as error:\n    print(ascii(error))\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", cwd=tmp_path)
    assert done.stdout.startswith("CommandError(") and "Stop(X) :- \\xfc." in done.stdout, done


def test_slurm_arrays(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    needs("submitit", "slurm")
    whole, joined = tmp_path / "whole.jsonl", tmp_path / "joined.jsonl"
    run_command([*EPISODES, "--output", str(whole)])
    # In its own process, since the executor changes handlers of signals.
    command = ["shards", "2", "--slurm", "cluster=local,timeout_min=5", "--", *EPISODES, "-o", str(joined)]
    done = subprocess.run([sys.executable, "-m", "logicity", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert joined.read_bytes() == whole.read_bytes()
    assert (tmp_path / "joined.jsonl-shards" / "logs").is_dir()
    with pytest.raises(CommandError, match="city.yaml:2:") as error:
        make_shards(faulty(tmp_path), 1, slurm={"cluster": "local"})
    assert error.value.code == 1
    with pytest.raises(ValueError, match="--slurm: "):
        make_shards([*EPISODES, "-o", str(tmp_path / "y")], 1, slurm={"cluster": "local", "no_such_parameter": 1})
    assert main(["shards", "2", "--ray", "--slurm", "--", *EPISODES, "-o", "x"]) == 2


def test_shards_on_ray(tmp_path: Path) -> None:
    needs("ray", "ray")
    whole, joined = tmp_path / "whole.jsonl", tmp_path / "joined.jsonl"
    run_command([*EPISODES, "--output", str(whole)])
    command = ["shards", "2", "--jobs", "2", "--ray", "local", "--", *EPISODES, "-o", str(joined)]
    done = subprocess.run([sys.executable, "-m", "logicity", *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert joined.read_bytes() == whole.read_bytes()
    command = ["shards", "2", "--ray", "--", *faulty(tmp_path)]
    done = subprocess.run([sys.executable, "-m", "logicity", *command], capture_output=True, text=True)
    assert done.returncode == 1 and "city.yaml:2:" in done.stderr
