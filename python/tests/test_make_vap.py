from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, SETS, Interrupt

from logicity import ACTIONS, InputError
from logicity.vap import Drawing, VapDataset, check_dataset, make_dataset

#: A simple icon, which is faster to render than the built-in icons.
ICON = "<svg xmlns='http://www.w3.org/2000/svg' width='30' height='50'><ellipse cx='15' cy='25' rx='14' ry='20'/></svg>"

#: Takes arguments of any type.
DRAWING: Any = Drawing


def command(*arguments: str) -> str:
    run = subprocess.run(
        [sys.executable, "-m", "logicity", "vap", *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return run.stdout


def contents(folder: Path) -> dict[str, bytes]:
    """Return the contents of all files in a folder, except temporary ones."""
    paths = {path.relative_to(folder): path for path in folder.rglob("*") if path.is_file()}
    return {str(name): path.read_bytes() for name, path in paths.items() if not name.parts[0].startswith(".")}


def make_random(folder: Path, **options: Any) -> VapDataset:
    """Create the data set `random` of `SETS`."""
    return make_dataset(folder, "easy", "val", agents="random", worlds=3, images=False, **options)


@pytest.mark.parametrize("threads", [0, 1])
def test_tables_equal_those_of_the_command(threads: int, sets: Path, tmp_path: Path) -> None:
    assert SETS["random"] == ["--mode", "easy", "--split", "val", "--worlds", "3", "--agents", "random"]
    calls: list[tuple[int, int]] = []
    made = make_random(tmp_path / "new" / "set", threads=threads, progress=lambda *call: calls.append(call))
    assert contents(made.folder) == contents(sets / "random")
    assert repr(made) == "<VapDataset easy, random agents, val: 267 samples>" and not made.images
    assert calls == sorted(set(calls)) and calls[0] == (0, 267) and calls[-1] == (267, 267)


def test_pictures_equal_those_of_the_command(tmp_path: Path) -> None:
    for name in ("car", "ambulance", "bus", "police", "reckless", "tiro", "old", "young", "pedestrian", "house"):
        (tmp_path / "pack" / name).mkdir(parents=True)
        (tmp_path / "pack" / name / "1.svg").write_text(ICON)
    options = "--mode hard --split train --worlds 1 --first-world 7 --seed 5 --difficulty 20".split()
    options += ["--pack-mode", "replace"]
    command("make", *options, "--pack", str(tmp_path / "pack"), "--out", str(tmp_path / "command"))
    made = make_dataset(
        tmp_path / "python",
        "hard",
        "train",
        worlds=1,
        first_world=7,
        seed=5,
        drawing=Drawing(difficulty=20, pack=tmp_path / "pack", pack_mode="replace"),
    )
    expected = contents(tmp_path / "command")
    assert len(expected) == 89 + 3 + 2 and contents(tmp_path / "python") == expected
    assert made[0].world == 7 and made[0].image is not None


def test_the_drawing_version_is_that_of_the_command(tmp_path: Path) -> None:
    options = "--mode hard --split test --worlds 1 --no-pictures --drawing-version 1".split()
    command("make", *options, "--out", str(tmp_path / "command"))
    made = make_dataset(tmp_path / "python", "hard", "test", worlds=1, images=False, drawing=Drawing(version=1))
    assert contents(made.folder) == contents(tmp_path / "command")
    newest = make_dataset(tmp_path / "newest", "hard", "test", worlds=1, images=False)
    sides = [{tuple(box[2:]) for sample in samples for box in sample.boxes.tolist()} for samples in (made, newest)]
    assert len(sides[1]) > 2 * len(sides[0])


def test_an_exception_in_progress_cancels(sets: Path, tmp_path: Path) -> None:
    expected = contents(sets / "random")

    def fail(done: int, total: int) -> None:
        if done == 178:
            raise LookupError(f"{done} of {total}")

    with pytest.raises(LookupError, match="178 of 267"):
        make_random(tmp_path, threads=1, progress=fail)
    kept = contents(tmp_path)
    assert kept == {name: content for name, content in expected.items() if name.startswith("world-00000")}
    frames: list[int] = []
    make_random(tmp_path, progress=lambda done, total: frames.append(total))
    assert set(frames) == {178} and contents(tmp_path) == expected
    make_random(tmp_path, progress=lambda done, total: frames.append(total))
    assert frames[-1] == 0 and contents(tmp_path) == expected


@pytest.mark.parametrize("threads", [1, 2])
def test_ctrl_c_cancels(threads: int, ctrl_c: Interrupt, sets: Path, tmp_path: Path) -> None:
    ctrl_c(lambda: make_dataset(tmp_path / "set", "hard", "train", images=False, threads=threads))
    assert "manifest.json" not in contents(tmp_path / "set")

    def check_again_and_again() -> None:
        for _ in itertools.count():
            check_dataset(sets / "hard", threads=threads)

    ctrl_c(check_again_and_again)


def test_check_returns_the_counts_of_the_command(sets: Path) -> None:
    calls: list[tuple[int, int]] = []
    counts = check_dataset(sets / "hard", threads=1, progress=lambda *call: calls.append(call))
    assert calls == [(0, 2), (1, 2), (2, 2)]
    printed = json.loads(command("check", str(sets / "hard"), "--json"))
    assert list(counts.actions) == list(counts.published_actions) == list(ACTIONS)
    assert [list(counts.actions.values()), list(counts.published_actions.values())] == [
        printed.pop("actions"),
        printed.pop("published"),
    ]
    assert {name: getattr(counts, name) for name in printed} == printed


def test_all_errors_of_a_data_set_are_listed(sets: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(sets / "random", tmp_path / "set"))
    table = folder / "world-00001" / "pairs.parquet"
    table.write_bytes(table.read_bytes()[:-1])
    (folder / "notes.txt").touch()
    with pytest.raises(InputError) as refused:
        check_dataset(folder)
    messages = [fault["message"] for fault in refused.value.diagnostics]
    assert len(messages) == 2 and {fault["code"] for fault in refused.value.diagnostics} == {"invalid-data-set"}
    assert "belongs to no data set" in messages[0] and "has changed since it was made" in messages[1]


def test_folders_with_other_content_are_refused(sets: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(sets / "random", tmp_path / "set"))
    expected = contents(folder)
    for options in ({"seed": 1}, {"drawing": Drawing(difficulty=0)}):
        with pytest.raises(FileExistsError, match=r"manifest\.json`: it belongs to a data set with other settings"):
            make_random(folder, **options)
    for name, always, message in [
        ("README.md", False, r"logicity did not write it .*; choose another folder, or replace .* `overwrite`$"),
        ("manifest.json", False, "not a file of a data set: .*, or replace the file with `overwrite`$"),
        ("notes.txt", True, "it belongs to no data set; choose another folder, or move it elsewhere$"),
        ("world-00007", True, "it has the name of a world, but is not a folder; choose another folder, or move"),
    ]:
        (folder / name).write_text("foreign")
        with pytest.raises(FileExistsError, match=message):
            make_random(folder)
        assert (folder / name).read_text() == "foreign"
        if always:
            with pytest.raises(FileExistsError, match=message):
                make_random(folder, overwrite=True)
            with pytest.raises(InputError, match=name):
                check_dataset(folder)
            (folder / name).unlink()
        else:
            make_random(folder, overwrite=True)
        assert contents(folder) == expected


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"mode": "medium"}, ValueError, 'mode must be one of "easy", "hard", not "medium"'),
        ({"split": "all"}, ValueError, "split must be one of"),
        ({"agents": "few"}, ValueError, "agents must be one of"),
        ({"drawing": DRAWING(pack_mode="both")}, ValueError, "pack_mode must be one of"),
        ({"worlds": 0}, ValueError, "worlds: expected 1 to 100000, not 0"),
        ({"first_world": 100_000}, ValueError, "first_world: expected 0 to 99999"),
        ({"drawing": Drawing(difficulty=101)}, ValueError, "difficulty: expected 0 to 100, not 101"),
        ({"drawing": DRAWING(version=3)}, ValueError, "version: expected 1 to 2, not 3"),
        ({"threads": 1025}, ValueError, "threads: expected 0 to 1024"),
        ({"seed": -1}, ValueError, r"seed: expected 0 to 2\*\*64 - 1, not -1"),
        ({"worlds": -1}, ValueError, "worlds: expected 1 to 100000, not -1"),
        ({"worlds": 2**40}, ValueError, f"worlds: expected 1 to 100000, not {2**40}"),
        ({"first_world": -1}, ValueError, "first_world: expected 0 to 99999, not -1"),
        ({"drawing": Drawing(difficulty=300)}, ValueError, "difficulty: expected 0 to 100, not 300"),
        ({"drawing": Drawing(difficulty=-1)}, ValueError, "difficulty: expected 0 to 100, not -1"),
        ({"threads": -1}, ValueError, "threads: expected 0 to 1024, not -1"),
        ({"worlds": 1.5}, TypeError, "worlds: expected an integer, not float"),
        ({"drawing": Drawing(pack="no/such/folder")}, OSError, "no such folder"),
        ({"folder": __file__}, FileExistsError, "a file has this name"),
    ],
)
def test_invalid_arguments_raise(wrong: dict[str, Any], error: type[Exception], message: str, tmp_path: Path) -> None:
    given: dict[str, Any] = {"folder": tmp_path / "set", "mode": "easy", "split": "val", "worlds": 1, "images": False}
    make: Callable[..., VapDataset] = make_dataset
    with pytest.raises(error, match=message):
        make(**(given | wrong))
    assert not (tmp_path / "set").exists()


def test_invalid_packs_raise(tmp_path: Path) -> None:
    (tmp_path / "pack" / "tram").mkdir(parents=True)
    (tmp_path / "pack" / "tram" / "1.svg").write_text(ICON)
    with pytest.raises(ValueError, match="unknown class `tram`"):
        make_dataset(tmp_path / "set", "easy", "val", drawing=Drawing(pack=tmp_path / "pack"))


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"missing/manifest\.json"):
        check_dataset(tmp_path / "missing")
    with pytest.raises(ValueError, match="threads"):
        check_dataset(tmp_path, threads=1025)
