from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import needs

from logicity.__main__ import main
from logicity.shards import make_shards, run_command

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
    make_shards([*command, f"--out={tmp_path / 'joined'}"], 2, jobs=1)
    assert filled(tmp_path / "joined") == filled(tmp_path / "whole")


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


def test_the_message_of_a_failed_shard_is_shown(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"(?s)`logicity questions .* --shard ./2 .*has no car concept `train`"):
        make_shards(["questions", "--about", "train", "-o", str(tmp_path / "x")], 2)


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
    failing = ["questions", "--about", "train", "-o", str(tmp_path / "x")]
    with pytest.raises(ValueError, match="has no car concept `train`"):
        make_shards(failing, 1, slurm={"cluster": "local"})
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
