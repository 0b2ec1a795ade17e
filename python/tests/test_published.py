from __future__ import annotations

import json
import os
import pickle
import pickletools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logicity import _logicity
from logicity.__main__ import main
from logicity.evaluation import Benchmark
from logicity.published import import_episodes, read_published


def recorded(count: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the header and the first of the recorded episodes."""
    header, *lines = map(json.loads, _logicity.read_file("configs/episodes/easy-test.jsonl").splitlines())
    return header, lines[:count]


def content(count: int = 3, grid: Any = None) -> dict[int, Any]:
    """Return recorded episodes in the form of the published program."""
    header, lines = recorded(count)
    episodes: dict[int, Any] = {}
    for number, line in enumerate(lines):
        agents = {}
        for layer, (usual, trip) in enumerate(zip(header["agents"], line["trips"], strict=True), start=3):
            agent = {**usual, **line["changes"].get(usual["id"], {})}
            kind, _, of_kind = usual["id"].partition("_")
            concepts = {"type": kind, "priority": agent["priority"], **dict.fromkeys(agent["concepts"], 1.0)}
            agents[usual["id"]] = {
                "start": np.array(trip[:2]),
                "goal": np.array(trip[2:]),
                "concepts": concepts,
                "type": kind,
                "priority": agent["priority"],
                "pos": np.array(trip[:2]),
                "layer_id": layer,
                "id": int(of_kind),
            }
        label = {"concept": "normal", "action": np.int64(3), "oracle_step": line["oracle"]["steps"]}
        episodes[number] = {"city_grid": grid, "agents": agents, "label_info": label}
    return episodes


def dumped(folder: Path, value: object, protocol: int = 4) -> Path:
    path = folder / "episodes.pkl"
    path.write_bytes(pickle.dumps(value, protocol))
    return path


def renamed(whole: bytes, name: str) -> bytes:
    """Return a pickle of this version of NumPy as one whose functions are in a package of this name."""
    instructions = list(pickletools.genops(whole))
    ends = [*(at for _, _, at in instructions[1:]), len(whole)]
    parts = []
    for (opcode, argument, start), end in zip(instructions, ends, strict=True):
        text, count = re.subn(r"^numpy\._?core\.", f"{name}.", argument if isinstance(argument, str) else "")
        if count == 0:
            # Frames get other lengths, and need not be there.
            parts.append(b"" if opcode.name == "FRAME" else whole[start:end])
        elif opcode.name == "GLOBAL":
            parts.append(pickle.GLOBAL + text.replace(" ", "\n").encode() + b"\n")
        else:
            assert opcode.name == "SHORT_BINUNICODE"
            parts.append(pickle.SHORT_BINUNICODE + bytes([len(text)]) + text.encode())
    return b"".join(parts)


@pytest.mark.parametrize("protocol", range(2, 6))
@pytest.mark.parametrize("name", ["numpy.core", "numpy._core"])
def test_pickles_of_all_protocols_and_versions_of_numpy(protocol: int, name: str, tmp_path: Path) -> None:
    path = dumped(tmp_path, content(2), protocol)
    path.write_bytes(renamed(path.read_bytes(), name))
    named = [text for _, text, _ in pickletools.genops(path.read_bytes()) if isinstance(text, str) and "core." in text]
    assert named and all(text.startswith(f"{name}.") for text in named)
    episodes = read_published(path)
    _, lines = recorded(2)
    assert [each.number for each in episodes] == [0, 1]
    for episode, line in zip(episodes, lines, strict=True):
        assert [[*agent.start, *agent.goal] for agent in episode.agents] == line["trips"]
        assert episode.oracle_steps == line["oracle"]["steps"]


def test_grids_of_tensors_are_skipped(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    grid = torch.zeros(6, 241, 241)
    with_grids = read_published(dumped(tmp_path, content(2, grid)))
    assert with_grids == read_published(dumped(tmp_path, content(2)))
    assert with_grids == read_published(dumped(tmp_path, content(2, grid.numpy())))


def test_imported_episodes_can_be_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, output = dumped(tmp_path, content()), tmp_path / "published.jsonl"
    assert main(["import-episodes", str(path), "--mode", "easy", "-o", str(output)]) == 0
    assert capsys.readouterr().out.startswith("3 episodes, 3 solved by the oracle; as many steps as recorded in ")
    _, expected = recorded(3)
    header, *lines = map(json.loads, output.read_text().splitlines())
    assert (header["config"], header["split"], header["seed"]) == ("easy", "test", 0)
    assert [line["trips"] for line in lines] == [line["trips"] for line in expected]
    assert [line["changes"] for line in lines] != [{}] * 3
    city = tmp_path / "city.yaml"
    city.write_text("base: easy\ntask:\n  episodes: {test: published.jsonl}\n")
    # The records of the oracle are reproduced.
    assert main(["episodes", "check", str(city)]) == 0
    found = Benchmark(city).evaluate("oracle")
    assert found.tsr.value == 1.0
    assert [record.steps for record in found.episodes] == [line["oracle"]["steps"] for line in lines]
    # Without random events, the steps would be those of the record; the seed determines them.
    again = tmp_path / "again.jsonl"
    import_episodes(path, "easy", "test", again)
    assert again.read_text() == output.read_text()
    import_episodes(path, "easy", "test", again, seed=1)
    assert again.read_text() != output.read_text()
    # Concepts can be numbers of NumPy.
    value = content(1)
    for agent in value[0]["agents"].values():
        true = {concept: np.float32(1.0) for concept in agent["concepts"] if concept not in ("type", "priority")}
        agent["concepts"] |= {**true, "Other": np.array([0]), "Another": False}
    assert read_published(dumped(tmp_path, value)) == read_published(dumped(tmp_path, content(1)))
    # A file of another program is kept, which shows before the work.
    output.write_text("mine")
    path.write_text("not a pickle")
    assert main(["import-episodes", str(path), "--mode", "easy", "-o", str(output)]) == 2
    assert output.read_text() == "mine"


def test_episodes_of_another_mode_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = dumped(tmp_path, content())
    assert main(["import-episodes", str(path), "--mode", "hard", "-o", str(tmp_path / "x")]) == 1
    assert "episode 0 has no agent `Car_10`" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["import-episodes", str(path), "--mode", "all", "-o", str(tmp_path / "x")])
    assert "expected one mode, found `all`" in capsys.readouterr().err
    assert main(["import-episodes", str(tmp_path / "none.pkl"), "--mode", "easy", "-o", str(tmp_path / "x")]) == 2


class Runs:
    """Runs a command when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.file}",)


@pytest.mark.parametrize("protocol", range(6))
def test_a_pickle_that_would_run_code_is_refused(
    protocol: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran = tmp_path / "ran"
    for value in ({0: Runs(ran)}, {0: {"agents": {"Car_1": Runs(ran)}}}, [Runs(ran)]):
        path = dumped(tmp_path, value, protocol)
        assert main(["import-episodes", str(path), "--mode", "easy", "-o", str(tmp_path / "x")]) == 1
        said = capsys.readouterr().err
        assert "system`, which the files of the published program do not need" in said and "nothing of it ran" in said
        assert not ran.exists() and not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "code",
    [
        b"cbuiltins\neval\n(S'1'\ntR.",
        b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93.",
        b"(ibuiltins\neval\n.",
        b"(cbuiltins\neval\nS'1'\no.",
        b"\x80\x02cnumpy\nndarray\n)\x81.",
        # Known functions with unknown arguments.
        b"\x80\x02cnumpy\ndtype\n(X\x01\x00\x00\x00OK\x00tR.",
        b"\x80\x02cnumpy\nndarray\n(K\x01tR.",
        b"\x80\x02c_codecs\nencode\n(X\x01\x00\x00\x00aX\x06\x00\x00\x00base64tR.",
        # A value that is called.
        b"\x80\x02K\x01)R.",
        b"\x80\x02P1\n.",
    ],
)
def test_other_instructions_are_refused(code: bytes, tmp_path: Path) -> None:
    path = tmp_path / "episodes.pkl"
    path.write_bytes(code)
    with pytest.raises(ValueError, match=r"episodes\.pkl: .*byte \d+"):
        read_published(path)


def nested(create: bytes, add: bytes, levels: int = 60) -> bytes:
    """Return instructions for a value that contains the one below twice, and so on: it is small, but long as text."""
    parts = [create + b"q\x00"]
    for level in range(levels):
        # Only the outermost value stays on the stack.
        parts.append(b"0" + add.replace(b"BELOW", b"h" + bytes([level])) + b"q" + bytes([level + 1]))
    return b"".join(parts)


LISTS = nested(b"]", b"](BELOWBELOWe")
TUPLES = nested(b")", b"BELOWBELOW\x86")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (LISTS + b"\x8c\x04eval\x93.", "it names a function by a list and `eval`, not by two strings"),
        (b"\x8c\x05numpy" + LISTS + b"\x93.", "it names a function by `numpy` and a list"),
        (b"]" * 100_000 + b"a" * 99_999 + b"\x8c\x04eval\x93.", "it names a function by a list and `eval`"),
        (b"K\x01K\x02\x93.", "it names a function by `1` and `2`"),
        (b"}" + TUPLES + b"Ns.", "string as a key of a dictionary, not a tuple"),
        (b"}(" + TUPLES + b"Nu.", "string as a key of a dictionary, not a tuple"),
        (b"(" + TUPLES + b"Nd.", "string as a key of a dictionary, not a tuple"),
        (b"})" + b"\x85" * 100_000 + b"Ns.", "string as a key of a dictionary, not a tuple"),
        (b"}(NK\x01K\x02Nu.", "string as a key of a dictionary, not None"),
        (b"}G\x00\x00\x00\x00\x00\x00\x00\x00Ns.", "string as a key of a dictionary, not `0.0`"),
    ],
)
def test_nested_values_in_place_of_names_and_keys_are_refused(code: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "episodes.pkl"
    path.write_bytes(b"\x80\x04" + code)
    with pytest.raises(ValueError, match=r"episodes\.pkl: .*, at byte \d+$") as caught:
        read_published(path)
    assert message in str(caught.value)


@pytest.mark.parametrize("protocol", range(2, 6))
def test_arrays_can_occur_several_times(protocol: int, tmp_path: Path) -> None:
    value = content(1)
    grid = np.zeros((6, 241, 241), np.float32)
    for agent in value[0]["agents"].values():
        agent["goal"] = agent["pos"] = agent["start"]
        agent["view"] = grid
    value[0]["city_grid"] = value[0]["copy"] = grid
    (episode,) = read_published(dumped(tmp_path, value, protocol))
    _, (line,) = recorded(1)
    assert [agent.start for agent in episode.agents] == [tuple(trip[:2]) for trip in line["trips"]]
    assert all(agent.goal == agent.start for agent in episode.agents)


def test_cut_and_changed_files_are_refused(tmp_path: Path) -> None:
    whole = pickletools.optimize(pickle.dumps(content(1), 2))
    path = tmp_path / "episodes.pkl"
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"byte \d+"):
            read_published(path)
    random = np.random.default_rng(0)
    for _ in range(300):
        changed = bytearray(whole)
        changed[random.integers(len(changed))] = random.integers(256)
        path.write_bytes(changed)
        try:
            read_published(path)
        except ValueError as error:
            assert str(path) in str(error)


def test_claimed_sizes_take_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "episodes.pkl"
    for code in (
        b"\x80\x04B\xff\xff\xff\x7f.",  # BINBYTES
        b"\x80\x04\x8e" + b"\xff" * 7 + b"\x7f.",  # BINBYTES8
        b"\x80\x04X\xff\xff\xff\xff.",  # BINUNICODE
        b"\x80\x02\x8b\xff\xff\xff\x7f.",  # LONG4
        b"\x80\x02]r\xff\xff\xff\x7f.",  # LONG_BINPUT
    ):
        path.write_bytes(code)
        with pytest.raises(ValueError):
            read_published(path)


def without(path: str) -> dict[int, Any]:
    """Return episodes that lack an entry."""
    value = content(1)
    *keys, last = path.split("/")
    place: Any = value[0]
    for key in keys:
        place = place[key]
    del place[last]
    return value


def with_value(path: str, new: object) -> dict[int, Any]:
    value = content(1)
    *keys, last = path.split("/")
    place: Any = value[0]
    for key in keys:
        place = place[key]
    place[last] = new
    return value


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({}, "it has no episodes"),
        ([], "expected a dictionary of episodes, not a list"),
        ({"a": 1}, "expected the number of an episode as key, not `a`"),
        ({0: 1}, "episode 0 has no `agents`"),
        ({0: {"agents": {}}}, "episode 0 has no agents"),
        (without("agents/Car_1/start"), "episode 0, agent `Car_1` has no `start`"),
        (with_value("agents/Car_1/start", np.array([1.5, 2.0])), "`start`: expected an integer"),
        (with_value("agents/Car_1/start", np.array([1, 2, 3])), "`start`: expected row and column of a cell"),
        (with_value("agents/Car_1/priority", True), "`priority`: expected an integer, not `True`"),
        (with_value("agents/Car_1/concepts", 3), "expected a dictionary as `concepts`, not `3`"),
        (with_value("agents/Car_1/concepts", {1: 1.0}), "expected the names of concepts as keys"),
        (
            with_value("agents/Car_1/concepts/IsTiro", np.array([1.0, 0.0])),
            "agent `Car_1`, concept `IsTiro`: expected a truth value or a number, not a value of the type ndarray",
        ),
        (with_value("agents/Car_1/concepts/IsTiro", [0]), "`IsTiro`: expected a truth value or a number, not a list"),
        (with_value("agents/Car_1/concepts/IsTiro", None), "`IsTiro`: expected a truth value or a number, not None"),
        (with_value("label_info/oracle_step", "many"), "`oracle_step`: expected an integer, not `many`"),
    ],
)
def test_other_content_is_refused(value: object, message: str, tmp_path: Path) -> None:
    path = dumped(tmp_path, value)
    with pytest.raises(ValueError, match=f"^{path}: ") as caught:
        read_published(path)
    assert message in str(caught.value)


def test_cells_outside_of_streets_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = dumped(tmp_path, with_value("agents/Car_1/start", np.array([20, 20])))
    assert main(["import-episodes", str(path), "--mode", "easy", "-o", str(tmp_path / "x")]) == 1
    assert "Car_1 cannot go from [20, 20]" in capsys.readouterr().err
