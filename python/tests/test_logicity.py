from __future__ import annotations

import inspect

import pytest

import logicity
from logicity import Inference, InputError, Scene


def scene() -> Scene:
    return {
        "map": "square-5x5",
        "agents": [
            {"id": "Car_1", "type": "Car", "at": [102, 20], "heading": "Up", "concepts": ["tiro"], "priority": 1},
            {"id": "Pedestrian_1", "type": "Pedestrian", "at": [98, 20], "priority": 0},
        ],
        "egos": ["Car_1"],
    }


def test_a_clean_text_has_no_diagnostics() -> None:
    assert logicity.check('.include "vocabulary.dl"\nStop(X) :- IsCar(X), IsInInter(X).\n') == []


def test_a_fault_is_told_with_its_place() -> None:
    (fault,) = logicity.check('.include "vocabulary.dl"\nStop(X) :- IsCarr(X).\n', "mine.dl")
    assert fault["code"] == "unknown-predicate"
    label = fault["labels"][0]
    assert (label["file"], label["line"], label["column"]) == ("mine.dl", 2, 12)


def test_the_expert_rules_stop_a_car_in_front_of_a_pedestrian() -> None:
    answer = Inference().answer(scene())["egos"]["Car_1"]
    assert answer["sees"] == ["Car_1", "Pedestrian_1"]
    assert answer["true"]["CollidingClose"] == [["Car_1", "Pedestrian_1"]]
    assert answer["derived"] == ["Stop"]
    assert answer["action"] == "Stop"


def test_given_atoms_replace_computed_ones() -> None:
    given = scene()
    given["given"] = {"CollidingClose": []}
    answer = Inference().answer(given)["egos"]["Car_1"]
    assert "CollidingClose" not in answer["true"]
    assert answer["action"] == "Normal"


def test_a_symbolic_scene_skips_grounding() -> None:
    answer = Inference("configs/easy.yaml").answer(
        {"entities": ["a", "b"], "ego": "a", "facts": {"IsAtInter": ["a"], "IsInInter": ["b"]}}
    )
    assert answer["egos"]["a"]["action"] == "Stop"


def test_a_faulty_scene_says_what_is_wrong() -> None:
    faulty = scene()
    faulty["agents"][0]["concepts"] = ["ambulence"]
    with pytest.raises(InputError) as caught:
        Inference().answer(faulty)
    (fault,) = caught.value.diagnostics
    assert fault["code"] == "invalid-scene"
    assert fault["help"] == ["did you mean `ambulance`?"]


def test_a_missing_file_is_an_os_error() -> None:
    with pytest.raises(FileNotFoundError, match="nowhere.yaml"):
        Inference("nowhere.yaml")


def test_the_stubs_name_what_the_module_has() -> None:
    public = {name for name, _ in inspect.getmembers(logicity._logicity) if not name.startswith("__")}
    assert public == {"Cars", "Environments", "Inference", "InputError", "Task", "check"}
