"""The experiment of language questions: prompts, rules in replies, calibration, solvers, models and tables."""

from __future__ import annotations

import base64
import itertools
import json
import math
import random
import re
from collections.abc import Mapping
from dataclasses import replace
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, Serve, needs, say, send

from logicity import InputError
from logicity.__main__ import main
from logicity.city import ACTIONS
from logicity.questions import (
    Calibration,
    Demonstration,
    Endpoint,
    Question,
    Reply,
    ask,
    calibrate,
    fingerprint,
    grade,
    load_logprobs,
    load_questions,
    read_rule,
)

needs("torch", "learn")
from logicity.experiments.cells import finished, prepare, run_cell  # noqa: E402
from logicity.experiments.experiment import Selection  # noqa: E402
from logicity.experiments.jobs import exclusive  # noqa: E402
from logicity.experiments.language.solvers import SOLVERS, features, similarity  # noqa: E402
from logicity.experiments.language.task import LanguageQuestions, LanguageSettings, graded  # noqa: E402
from logicity.experiments.paper import paper_table  # noqa: E402
from logicity.experiments.registry import load_experiment  # noqa: E402
from logicity.experiments.results import check_rows, read_results  # noqa: E402
from logicity.experiments.task import Cell  # noqa: E402

FIXTURE = ROOT / "tests" / "fixtures" / "questions.jsonl"
LABELS = ("N", "VS1", "VS7", "my_rules.dl:5", "my_rules.dl:50")
OPTIONS = dict(zip("ABCD", ACTIONS, strict=True))


def made_up(count: int, labels: tuple[str, ...] = ()) -> list[Question]:
    clauses = (("VS1", "VS7"), (), ("N",), ("VS7",))
    return [
        Question(
            str(n),
            "Decide.",
            (),
            f"Scene {n}?",
            OPTIONS,
            "ABCD"[n % 4],
            clauses[n % 4],
            labels,
            {"entities": ["E"], "ego": "E", "facts": {f"Is{n}": ["E"]}},
            {"world": n // 2},
        )
        for n in range(count)
    ]


# --- files and replies


def test_files_of_version_1_are_read(tmp_path: Path) -> None:
    lines = [json.loads(line) for line in FIXTURE.read_text(encoding="utf-8").splitlines()]
    path = tmp_path / "questions.jsonl"
    for line in lines:
        for key in ("version", "prompt", "clauses"):
            del line[key]
        for shown in line["demonstrations"]:
            del shown["clauses"], shown["scene"]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    old, new = load_questions(path), load_questions(FIXTURE)
    assert [question.messages() for question in old] == [question.messages() for question in new]
    assert {question.clauses for question in old} == {None} and not any(question.labels for question in new)
    assert all(question.clauses and question.scene for question in new)
    assert all(shown.clauses and shown.scene for question in new for shown in question.demonstrations)
    with pytest.raises(ValueError, match="lack scenes: write them again"):
        SOLVERS["nearest"](old, "vap-hard", tmp_path)
    path.write_text(json.dumps({**lines[0], "version": 4}), encoding="utf-8")
    with pytest.raises(ValueError, match=r":1: questions of version 4; this program reads the versions 1 to 3"):
        load_questions(path)


def test_why_requests_a_rule_in_the_form_of_the_examples() -> None:
    shown = (Demonstration("Scene a?", "D", ("VS7", "VS1")), Demonstration("Scene b?", "B", ()))
    question = Question("q", "Decide.", shown, "Scene?", OPTIONS, "A", ("VS1",), LABELS)
    text = question.messages()[1]["content"]
    assert "(D) Stop\nRule: VS7\nAnswer: D" in text and "(D) Stop\nRule: none\nAnswer: B" in text
    assert "Rule:" not in Question("q", "Decide.", shown, "Scene?", OPTIONS, "A").messages()[1]["content"]
    assert read_rule(question.reply("A", ["VS1"]), LABELS) == "VS1" and read_rule(question.reply("A"), LABELS) == "none"


@pytest.mark.parametrize(
    ("reply", "rule"),
    [
        ("Rule: VS1\nAnswer: D", "VS1"),
        ("rule: vs1", "VS1"),
        ("**Rule:** VS7", "VS7"),
        ("Rule: `my_rules.dl:5`\nAnswer: D", "my_rules.dl:5"),
        ("Rule: my_rules.dl:50", "my_rules.dl:50"),
        ("Rule: (VS1)", "VS1"),
        ("Rule: VS7: it is about to run into something.", "VS7"),
        ("The rule is: N", "N"),
        ("Rule: VS1 fails.\nRule: VS7\nAnswer: D", "VS7"),
        ("<rule>VS7</rule><answer>D</answer>", "VS7"),
        ("Rule: none\nAnswer: B", "none"),
        ("Rule: None.", "none"),
        ("Rule: VS1 or VS7", None),
        ("Rule: VS1, VS7", None),
        ("Rule: VS9", None),
        ("Rule: VS12", None),
        ("Rule: Nothing requires it", None),
        ("VS1", None),
        ("", None),
    ],
)
def test_rules_are_read_from_replies(reply: str, rule: str | None) -> None:
    assert read_rule(reply, LABELS) == rule


def test_a_named_rule_must_derive_the_correct_action() -> None:
    questions = made_up(4, LABELS)
    replies = {
        "0": "Rule: VS7\nAnswer: A",  # one of two clauses
        "1": "Rule: none\nAnswer: B",  # the default without a clause
        "2": "Rule: VS1\nAnswer: C",  # the right action by a wrong rule
        "3": "Rule: VS7\nAnswer: A",  # the rule of the right action, and a wrong action
    }
    graded = grade(questions, replies)
    assert graded.rules is not None and graded.both is not None
    assert (graded.overall.correct, graded.rules.correct, graded.both.correct, graded.named) == (3, 3, 2, 4)
    assert "rule correct: 0.75" in str(graded) and "action and rule correct: 0.50" in str(graded)
    silent = grade(questions, {"0": "Answer: A"})
    assert silent.rules is not None and (silent.rules.correct, silent.rules.total, silent.named) == (0, 4, 0)
    assert grade(made_up(4), replies).rules is None


# --- the paper's prompt and pictures


def test_the_papers_prompt_has_its_layout(tmp_path: Path) -> None:
    path = tmp_path / "paper.jsonl"
    options = ["--mini", "--mix", "paper", "--style", "paper", "--entities", "city", "--output", str(path)]
    assert main(["questions", *options]) == 0
    questions = load_questions(path)
    assert [sum(each.answer == letter for each in questions) for letter in "ABCD"] == [20, 42, 25, 30]
    for question in questions[:3]:
        (message,) = question.messages()
        shown = question.demonstrations
        solved = "\n\n".join(
            f'Question: "{each.text}"\nOption: (A) Slow (B) Normal (C) Fast (D) Stop\nAnswer: {each.answer}'
            for each in shown
        )
        assert message == {
            "role": "user",
            "content": f"{question.system}\n\n{solved}\n\n{question.closing}\n\n"
            f'Question: "{question.text}"\nOption: (A) Slow (B) Normal (C) Fast (D) Stop',
        }
        assert len(shown) == 5 and question.system.endswith("Here are 5 demonstrations:")
    # The form that the prompt requests.
    replies = {question.id: f"IsTiro slows.\nAnswer: {question.answer}." for question in questions}
    assert grade(questions, replies).overall.correct == 117


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of questions with pictures."""
    path = tmp_path_factory.mktemp("pictured") / "seen.jsonl"
    arguments = ["questions", "--count", "4", "--shots", "4", "--style", "picture", "--output", str(path)]
    assert main(arguments) == 0
    return path


def test_pictures_go_to_the_endpoint(pictured: Path, serve: Serve, tmp_path: Path) -> None:
    questions = load_questions(pictured)

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        system, user = body["messages"]
        assert isinstance(system["content"], str)
        say(handler, f"Answer: {'ABCD'[len(user['content']) % 4]}")

    server = serve(act)
    asked = [
        "--questions",
        str(pictured),
        "--url",
        server.url,
        "--model",
        "seer",
        "--output",
        str(tmp_path / "r.jsonl"),
    ]
    assert main(["ask", *asked]) == 0
    assert len(server.requests) == len(questions) == 4
    for question, request in zip(questions, server.requests, strict=True):
        parts = request["messages"][1]["content"]
        scenes: list[Demonstration | Question] = [*question.demonstrations, question]
        # For each scene a heading, its picture and its text.
        assert [part["type"] for part in parts] == ["text", "image_url", "text"] * 5
        for at, scene in enumerate(scenes):
            head, picture, text = parts[3 * at : 3 * at + 3]
            assert head["text"] == (f"Example {at + 1}\n" if at < 4 else "Question\n")
            start, _, data = picture["image_url"]["url"].partition(",")
            assert start == "data:image/png;base64" and scene.picture is not None
            assert base64.b64decode(data, validate=True) == scene.picture.read_bytes()
            assert text["text"].startswith(scene.text + "\n(A) Slow") and ("Answer: " in text["text"]) == (at < 4)
            assert "IsAtInter" not in text["text"] and "is at the edge of an intersection." not in text["text"]


def test_pictures_that_cannot_be_sent_are_reported(pictured: Path, tmp_path: Path) -> None:
    line = json.loads(pictured.read_text(encoding="utf-8").splitlines()[0])
    path = tmp_path / "seen.jsonl"
    for name in ("../secret/key.png", "/etc/passwd", "passwd.png", "a/b/c.png", "a/key.txt", "a/..", 7, None):
        path.write_text(json.dumps({**line, "picture": name}), encoding="utf-8")
        with pytest.raises(
            ValueError, match=r"seen\.jsonl:1: not a question of `logicity questions`: `picture` is not"
        ):
            load_questions(path)
    path.write_text(json.dumps(line), encoding="utf-8")
    (question,) = load_questions(path)
    with pytest.raises(FileNotFoundError, match=r"seen-pictures/vap-hard-test-0-picture-example-1\.png"):
        question.messages()
    (tmp_path / "seen-pictures").mkdir()
    scenes: list[Demonstration | Question] = [*question.demonstrations, question]
    for shown in scenes:
        assert shown.picture is not None
        shown.picture.write_bytes(b"GIF89a")
    with pytest.raises(ValueError, match=r"example-1\.png: expected a PNG picture of at most 16 MiB"):
        question.messages()


# --- calibration


def logs(*shares: float) -> dict[str, float]:
    return {letter: math.log(share) for letter, share in zip("ABCD", shares, strict=True) if share > 0}


def test_calibration_of_known_probabilities() -> None:
    questions = made_up(4)
    assert calibrate(questions, {}) is None
    perfect = {str(n): logs(*(float(n == m) for m in range(4))) for n in range(4)}
    assert calibrate(questions, perfect) == Calibration(4, 0.0, 0.0)
    uniform = calibrate(questions, {str(n): logs(0.25, 0.25, 0.25, 0.25) for n in range(4)})
    assert uniform is not None and uniform.brier == pytest.approx(0.75) and uniform.ece == pytest.approx(0.0)
    # Always sure of A, right once: the confidence is 1, the accuracy 1/4, and each wrong reply has distance 2.
    sure = calibrate(questions, {str(n): logs(1, 0, 0, 0) for n in range(4)})
    assert sure is not None and sure.ece == pytest.approx(0.75) and sure.brier == pytest.approx(1.5)
    # Only relative probabilities of the options count.
    halved = {name: {letter: value - 3 for letter, value in values.items()} for name, values in perfect.items()}
    assert calibrate(questions, halved) == Calibration(4, 0.0, 0.0)


def test_calibration_equals_that_of_arrays() -> None:
    draws = np.random.default_rng(3)
    shares = draws.dirichlet(np.full(4, 0.7), size=500)
    right = np.array([draws.choice(4, p=0.6 * row + 0.1) for row in shares])
    questions = [Question(str(n), "", (), "", OPTIONS, "ABCD"[right[n]]) for n in range(500)]
    measured = calibrate(questions, {str(n): logs(*row) for n, row in enumerate(shares)})
    confidence, hits = shares.max(1), shares.argmax(1) == right
    bins = np.minimum((confidence * 10).astype(int), 9)
    ece = sum((bins == b).mean() * abs(confidence[bins == b].mean() - hits[bins == b].mean()) for b in set(bins))
    brier = ((shares - np.eye(4)[right]) ** 2).sum(1).mean()
    assert measured is not None and measured.count == 500
    assert measured.ece == pytest.approx(ece) and measured.brier == pytest.approx(brier)
    assert 0.05 < ece < 0.5


def tokens(text: list[str], at: int, top: Mapping[str, float]) -> dict[str, Any]:
    """The field `logprobs` of a choice: each token has probability 1, except the one at a place."""
    content: list[dict[str, Any]] = [{"token": token, "logprob": 0.0, "top_logprobs": []} for token in text]
    ranked = [{"token": token, "logprob": math.log(share)} for token, share in top.items()]
    content[at] = {"token": text[at], "logprob": math.log(top[text[at]]), "top_logprobs": ranked}
    return {"content": content}


@pytest.mark.parametrize(
    ("text", "at", "top", "expected"),
    [
        (
            ["So", ".\n", "Answer", ":", " B"],
            4,
            {" B": 0.5, " A": 0.25, "B": 0.125, " x": 0.1},
            {"A": 0.25, "B": 0.625},
        ),
        (
            ["Answer", ":", " D", "\n", "This", " answer", " is", " short"],
            2,
            {" D": 0.75, " C": 0.25},
            {"C": 0.25, "D": 0.75},
        ),
        (["A", " car", ".\n", "Answer", ": ", "**", "A", "**"], 6, {"A": 0.5, "Stop": 0.25}, {"A": 0.5, "D": 0.25}),
        (["Answer", ":", " Stop"], 2, {" Stop": 0.5, " Slow": 0.5}, {"A": 0.5, "D": 0.5}),
        (["It", " waits", ".\n", "C"], 3, {"C": 1.0}, {"C": 1.0}),
    ],
)
def test_log_probabilities_are_those_of_the_answer(
    text: list[str], at: int, top: dict[str, float], expected: dict[str, float], serve: Serve, tmp_path: Path
) -> None:
    server = serve(lambda handler, *_: say(handler, "".join(text), logprobs=tokens(text, at, top)))
    path = tmp_path / "replies.jsonl"
    ask(made_up(1), Endpoint(server.url, "stub"), path)
    found = load_logprobs(path)["0"]
    assert {letter: math.exp(value) for letter, value in found.items()} == pytest.approx(expected)


def test_unusual_log_probabilities_do_not_lose_a_reply(serve: Serve) -> None:
    fields: list[Any] = [None, {}, {"content": None}, {"content": [{"token": " B"}]}, {"content": "B"}, [1], 7]
    server = serve(lambda handler, number, _: say(handler, "Answer: B", logprobs=fields[number]))
    endpoint = Endpoint(server.url, "stub", tries=1)
    assert [endpoint.reply([]) for _ in fields] == [Reply("Answer: B")] * len(fields)
    server = serve(lambda handler, *_: say(handler, "I do not know.", logprobs=tokens(["A"], 0, {"A": 1.0})))
    assert Endpoint(server.url, "stub", tries=1).reply([]) == Reply("I do not know.")


def test_log_probabilities_of_long_replies_are_read(serve: Serve) -> None:
    """In linear time: a quadratic one would take minutes."""
    text = ["answer "] * 40_000 + ["x B."]
    server = serve(
        lambda handler, *_: say(handler, "".join(text) + "\nAnswer: B", logprobs=tokens(text, 0, {"answer ": 1}))
    )
    assert Endpoint(server.url, "stub", tries=1).reply([]).logprobs is None


def test_invalid_log_probabilities_are_reported_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "replies.jsonl"
    for value in ([1], {"E": -1.0}, {"A": "x"}, {"A": 0.5}, {"A": -math.inf}, {"A": math.nan}):
        path.write_text(json.dumps({"id": "0", "answer": "A", "logprobs": value}) + "\n", encoding="utf-8")
        with pytest.raises(ValueError, match=":1: `logprobs` is not"):
            load_logprobs(path)


# --- solvers


def test_features_do_not_depend_on_names() -> None:
    scenes = [question.scene for question in load_questions(FIXTURE)]
    draws = random.Random(5)
    for scene in scenes:
        assert scene is not None
        names = [f"E{n}" for n in range(len(scene["entities"]))]
        draws.shuffle(names)
        new = dict(zip(scene["entities"], names, strict=True))
        facts = {
            name: [new[row] if isinstance(row, str) else [new[each] for each in row] for row in reversed(rows)]
            for name, rows in scene["facts"].items()
        }
        renamed = {"entities": sorted(names), "ego": new[scene["ego"]], "facts": facts}
        assert features(renamed) == features(scene)
        assert similarity(features(renamed), features(scene)) == pytest.approx(1.0)
        for other in set(scene["entities"]) - {scene["ego"]}:
            assert features({**scene, "ego": other}) != features(scene)
    first, second = scenes[:2]
    assert first is not None and second is not None
    assert 0 <= similarity(features(first), features(second)) < 1


def test_the_nearest_example_is_the_scene_itself(tmp_path: Path) -> None:
    questions = load_questions(FIXTURE)
    shown = tuple(Demonstration(each.text, each.answer, each.clauses, each.scene) for each in questions)
    labels = tuple(label for each in questions for label in each.clauses or ())
    same = [
        Question(each.id, "", shown, each.text, OPTIONS, each.answer, each.clauses, labels, each.scene)
        for each in questions
    ]
    graded = grade(same, SOLVERS["nearest"](same, "vap-hard", tmp_path))
    assert graded.overall.correct == len(same) and graded.both is not None and graded.both.correct == len(same)


def test_the_majority_is_the_most_frequent_answer(tmp_path: Path) -> None:
    shown = [Demonstration("", "B", ("N",)), Demonstration("", "D", ("VS1",)), Demonstration("", "D", ("VS7",))]
    shown.append(Demonstration("", "D", ("VS7",)))
    questions = [Question("0", "", tuple(shown), "", OPTIONS, "A", labels=LABELS)]
    assert SOLVERS["majority"](questions, "vap-hard", tmp_path) == {"0": "Rule: VS7\nAnswer: D"}


def test_rules_from_the_examples_explain_the_examples(tmp_path: Path) -> None:
    (first, *_) = load_questions(FIXTURE)
    asked = [
        Question(str(n), "", first.demonstrations, each.text, OPTIONS, each.answer, each.clauses, (), each.scene)
        for n, each in enumerate(first.demonstrations)
    ]
    assert grade(asked, SOLVERS["induced"](asked, "vap-hard", tmp_path / "own")).overall.correct == len(asked)
    rules = tmp_path / "own-0.dl"
    assert "Stop(X) :-" in rules.read_text(encoding="utf-8")
    none = [Question("0", "", (), "", OPTIONS, "A", scene=first.scene)]
    with pytest.raises(ValueError, match="set `shots`"):
        SOLVERS["induced"](none, "vap-hard", tmp_path)


def fingerprint_of_all_renamings(scene: Mapping[str, Any]) -> str:
    """The smallest text of a scene under all orders of its entities."""
    texts = []
    for order in itertools.permutations(range(len(scene["entities"]))):
        place = dict(zip(scene["entities"], order, strict=True))
        rows = [
            (name, [place[each] for each in ((row,) if isinstance(row, str) else row)])
            for name, all_rows in scene["facts"].items()
            for row in all_rows
        ]
        texts.append(json.dumps([len(order), place[scene["ego"]], sorted(rows)]))
    return min(texts)


def test_fingerprints_are_equal_exactly_for_renamed_scenes() -> None:
    draws = random.Random(9)
    scenes = []
    for _ in range(300):
        entities = [f"E{n}" for n in range(draws.randint(1, 4))]
        pairs = [[one, other] for one in entities for other in entities if one != other]
        facts = {
            "IsCar": draws.sample(entities, draws.randint(0, len(entities))),
            "LeftOf": draws.sample(pairs, min(len(pairs), draws.randint(0, 2))),
        }
        scenes.append({"entities": entities, "ego": draws.choice(entities), "facts": facts})
    exact = [fingerprint_of_all_renamings(scene) for scene in scenes]
    fast = [fingerprint(scene) for scene in scenes]
    assert len(set(exact)) < 200 and len(set(zip(exact, fast, strict=True))) == len(set(exact)) == len(set(fast))


def test_the_shortcut_is_right_about_slow_and_fast(tmp_path: Path) -> None:
    """A beginner slows, and the reckless race: 59 of 117 questions, 45 in the paper's mix, 38 in the mix by concept."""
    for mix, right in (("equal", 59), ("paper", 45), ("by-concept", 38)):
        path = tmp_path / f"{mix}.jsonl"
        assert main(["questions", "--mini", "--mix", mix, "--output", str(path)]) == 0
        questions = load_questions(path)
        found = grade(questions, SOLVERS["shortcut"](questions, "vap-hard", tmp_path))
        assert found.overall.correct == right
        assert found.by_action["Slow"].accuracy.value == found.by_action["Fast"].accuracy.value == 1.0
        assert found.by_action["Normal"].correct == found.by_action["Stop"].correct == 0
    # Other cars have no such words.
    (other,) = [each for each in load_questions(FIXTURE) if each.id.endswith("-0")]
    assert other.scene is not None
    facts = {**other.scene["facts"], "IsTiro": [], "IsReckless": []}
    plain = [replace(other, scene={**other.scene, "facts": facts})]
    assert SOLVERS["shortcut"](plain, "", tmp_path) == SOLVERS["majority"](plain, "", tmp_path)


# --- the experiment


def experiment(folder: Path, *options: str) -> int:
    return run("language", folder, *options)


def run(name: str, folder: Path, *options: str) -> int:
    return main(["experiment", name, "--quick", "--run", str(folder), "--jobs", "2", *options])


def entries(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    table = json.loads((folder / "table.json").read_text(encoding="utf-8"))
    return {(entry["row"], entry["mode"]): entry for entry in table["entries"]}


def replies(folder: Path) -> dict[tuple[str, str], list[dict[str, Any]]]:
    """The graded replies of the finished cells of an experiment."""
    found = {}
    for path in folder.glob("cells/*/measured.json"):
        document = json.loads((path.parent / "cell.json").read_text(encoding="utf-8"))
        measured = json.loads(path.read_text(encoding="utf-8"))
        found[document["row"], document["spec"]["prompt"]] = measured["evaluations"][""]["replies"]
    return found


def by_text(folder: Path) -> dict[str, Question]:
    """The questions of an experiment by their messages."""
    found = [each for path in folder.glob("cells/*/questions.jsonl") for each in load_questions(path)]
    return {json.dumps(question.messages()): question for question in found}


def right(given: list[dict[str, Any]]) -> int:
    return sum(reply["chosen"] == reply["answer"] for reply in given)


def write(folder: Path, text: str) -> Path:
    path = folder / "own.yaml"
    path.write_text(f"task: language\ntitle: Own\n{text}\n", encoding="utf-8")
    return path


def asking(serve: Serve, act: Any, folder: Path, count: int = 4) -> Path:
    """The file of an experiment that asks a stub."""
    endpoint = {"url": serve(act).url, "model": "m", "tries": 2}
    changes = {"count": count, "shots": 4, "endpoint": endpoint}
    return write(folder, f"modes: [examples]\nlearners: {{m: {{changes: {json.dumps(changes)}}}}}")


def test_solvers_and_a_stub_give_a_table(serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = ", ".join(f"{row}: {{}}" for row in SOLVERS)
    own = str(write(tmp_path, f"paper: language\nchanges: {{about: [tiro, reckless]}}\nlearners: {{{rows}}}"))
    folder = tmp_path / "run"
    size = ["--set", "count=16"]
    assert run(own, folder, *size) == 0
    printed = capsys.readouterr().out
    assert "GPT-4o, paper-set, the paper's" in printed and "written: " in printed
    solved = replies(folder)
    assert set(solved) == {(row, prompt) for row in SOLVERS for prompt in ("examples", "rules", "why")}
    # The oracle names the root of a proof by the engine, which is one of the clauses in the file.
    for prompt in ("examples", "rules", "why"):
        assert right(solved["oracle", prompt]) == 16 and right(solved["majority", prompt]) == 4
    assert all(reply["derived"] for reply in solved["oracle", "why"])
    assert {reply["rule"] for reply in solved["induced", "why"]} == {None}
    assert any(reply["rule"] for reply in solved["nearest", "why"])
    table = entries(folder)
    assert "both" in table["oracle", "why"]["measures"] and "both" not in table["induced", "why"]["measures"]
    assert table["oracle", "examples"]["measures"]["overall"]["value"] == 1.0
    paper = "| GPT-4o, paper-set, the paper's | 0.20 | 0.84 | 0.80 | 0.32 | 0.59 |"
    assert paper in (folder / "table.md").read_text("utf-8")
    assert {"table.tex", "bars.svg"} <= {path.name for path in folder.iterdir()}

    # The stub is right about all questions but every fourth, with probability 0.7, and names a wrong rule for N.
    questions = by_text(folder)
    assert len(questions) == 48
    down = True

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        if down and number >= 20:
            send(handler, 400, b"closed")
            return
        question = questions[json.dumps(body["messages"])]
        letter = (
            question.answer
            if int(question.id.rsplit("-", 1)[1]) % 4
            else "ABCD"[("ABCD".index(question.answer) + 1) % 4]
        )
        rule = "VS1" if question.clauses == ("N",) else (question.clauses or ("none",))[-1]
        text = [f"Rule: {rule}\n" if question.labels else "So.\n", "Answer:", f" {letter}"]
        rest = {f" {each}": 0.1 for each in "ABCD" if each != letter}
        say(handler, "".join(text), logprobs=tokens(text, 2, {f" {letter}": 0.7, **rest}))

    server = serve(act)
    endpoint = json.dumps({"url": server.url, "model": "scripted", "logprobs": True, "tries": 1})
    stub = [*size, "--set", f"learners.stub.changes.endpoint={endpoint}"]
    assert run(own, folder, *stub, "--jobs", "1") == 1
    output = capsys.readouterr()
    assert "closed" in output.out and "stub, examples, seed 0: overall 0.75" in output.err
    stored = sum(len(path.read_text().splitlines()) for path in folder.glob("cells/stub-*/replies.jsonl"))
    assert stored == 20 < len(server.requests)
    assert run(own, folder, *stub, "--list", "--only", "stub") == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert sorted(listed) == ["finished", "not", "not"]

    down, before = False, len(server.requests)
    assert run(own, folder, *stub) == 0
    assert len(server.requests) == before + 28
    assert {(request["temperature"], request["logprobs"], request["top_logprobs"]) for request in server.requests} == {
        (0, True, 20)
    }
    found = entries(folder)
    assert {key: value["measures"] for key, value in found.items() if key[0] != "stub"} == {
        key: value["measures"] for key, value in table.items()
    }
    for prompt in ("examples", "rules", "why"):
        measures = found["stub", prompt]["measures"]
        assert measures["overall"]["value"] == 12 / 16
        # The confidence is 0.7 and the accuracy 0.75; a right reply has the distance 0.12, a wrong one 1.32.
        assert measures["ece"]["value"] == pytest.approx(0.05)
        assert measures["brier"]["value"] == pytest.approx((12 * 0.12 + 4 * 1.32) / 16)
    asked = [question for question in questions.values() if question.labels]
    proven = [question for question in asked if question.clauses != ("N",)]
    both = [question for question in proven if int(question.id.rsplit("-", 1)[1]) % 4]
    measures = found["stub", "why"]["measures"]
    assert 0 < len(both) < len(proven) < len(asked) == 16
    assert (measures["rule"]["value"], measures["both"]["value"]) == (len(proven) / 16, len(both) / 16)
    assert "rule" not in found["stub", "examples"]["measures"]

    # Nothing remains to ask, and the report is the same, byte for byte.
    files = sorted(path for path in folder.iterdir() if path.is_file() and path.name.startswith(("table", "bars")))
    assert {path.suffix for path in files} >= {".json", ".md", ".tex"}
    first = [path.read_bytes() for path in files]
    assert run(own, folder, *stub) == 0 and run(own, folder, *stub, "--report") == 0
    assert [path.read_bytes() for path in files] == first and len(server.requests) == before + 28
    # Other settings are other replies.
    more = ["--set", "learners.stub.changes.endpoint.settings.seed=1", "--only", "stub,rules"]
    assert run(own, folder, *stub, *more) == 0
    assert len(server.requests) == before + 44 and server.requests[-1]["seed"] == 1


def test_rows_of_solvers_are_published(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, results = tmp_path / "run", tmp_path / "language.json"
    base = ["experiment", "language", "--only", "majority,why", "--only", "oracle,why", "--seeds", "0"]
    assert main([*base, "--run", str(root), "--jobs", "2"]) == 0
    assert main([*base, "--run", str(root), "--submit", str(results)]) == 0
    assert "oracle, why, seed 0, : overall 1.00, as recorded" in capsys.readouterr().out
    rows = read_results(results, "language")
    # The other variants have their own prompt.
    assert [(row["mode"], row["learner"], row["variant"]) for row in rows["rows"]] == [
        *(
            ("examples", learner, variant)
            for learner in ("majority", "oracle")
            for variant in ("by-concept", "paper-set")
        ),
        ("why", "majority", ""),
        ("why", "oracle", ""),
    ]
    assert {(row["sha256_of"], len(row["samples"])) for row in rows["rows"]} == {("replies", 117)}
    assert check_rows(rows) == []
    first = rows["rows"][0]
    assert check_rows({**rows, "rows": [{**first, "hashes": {}}]})[0].endswith("other rules")
    wrong = [{**sample, "chosen": "unread"} for sample in first["samples"]]
    assert any(
        fault.endswith("another overall") for fault in check_rows({**rows, "rows": [{**first, "samples": wrong}]})
    )


def test_an_interrupted_cell_asks_only_the_rest(serve: Serve, tmp_path: Path) -> None:
    closed = True

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        if closed and number >= 2:
            send(handler, 503, b"full\nindeed")
        else:
            say(handler, "A")

    (cell,) = load_experiment(asking(serve, act, tmp_path)).cells(Selection())
    folder, notes = prepare(cell, tmp_path / "run"), list[str]()
    with pytest.raises(ConnectionError, match="503 Service Unavailable"):
        run_cell(folder, note=notes.append)
    assert notes == ["503 Service Unavailable: full indeed; next attempt in 1 s"]
    assert len((folder / "replies.jsonl").read_text().splitlines()) == 2 and finished(cell, tmp_path / "run") is None
    closed = False
    measured = run_cell(folder)
    assert len(measured["evaluations"][""]["replies"]) == 4 and finished(cell, tmp_path / "run") == measured


def test_other_content_of_a_file_of_replies_is_reported(serve: Serve, tmp_path: Path) -> None:
    (cell,) = load_experiment(asking(serve, lambda handler, *_: say(handler, "A"), tmp_path)).cells(Selection())
    folder = prepare(cell, tmp_path / "run")
    for text in ("{}", "[]", "rubbish", '{"id": []}', "[" * 100_000):
        (folder / "replies.jsonl").write_text(text + "\n", encoding="utf-8")
        with pytest.raises(ValueError, match=r"replies\.jsonl:1: (.|\n)*help: remove `.*replies\.jsonl`"):
            run_cell(folder)
    (folder / "replies.jsonl").unlink()
    assert len(run_cell(folder)["evaluations"][""]["replies"]) == 4


def test_a_running_experiment_can_be_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run" / "cells").mkdir(parents=True)
    with exclusive(tmp_path / "run"):
        assert experiment(tmp_path / "run", "--only", "majority,why") == 2
        assert "one process at a time runs an experiment" in capsys.readouterr().err
        assert experiment(tmp_path / "run", "--only", "majority,why", "--list") == 0
        assert experiment(tmp_path / "run", "--only", "majority,why", "--report") == 0
        assert "majority, why: not run" in capsys.readouterr().out


def test_measures_are_those_of_the_questions_of_all_sets(tmp_path: Path) -> None:
    """The replies count like in `logicity grade`."""
    task, path = LanguageQuestions(), tmp_path / "replies.jsonl"
    runs, asked = list[dict[str, Any]](), list[Question]()
    answers: dict[str, str] = {}
    for first in (0, 10):
        questions = made_up(first + 10, LABELS)[first:]
        texts = {each.id: f"Rule: VS1\nAnswer: {'ABCD'[int(each.id) % 3]}" for each in questions}
        path.write_text("".join(json.dumps({"id": name, "answer": each}) + "\n" for name, each in texts.items()))
        runs.append({"replies": graded(questions, path)})
        asked += questions
        answers |= texts
    slow, fast = grade(asked, answers), task.intervals(runs)
    assert slow.rules is not None and slow.both is not None
    shares = {"overall": slow.overall, "rule": slow.rules, "both": slow.both, **slow.by_action}
    assert {name: interval.value for name, interval in fast.items()} == {
        name: share.accuracy.value for name, share in shares.items()
    }
    assert all(0 <= interval.low <= interval.value <= interval.high <= 1 for interval in fast.values())
    # A question in several sets counts once.
    assert list(task.remarks(runs)) == []
    again = [*runs, {"replies": [*runs[0]["replies"][:3], *runs[1]["replies"][:1]]}]
    assert task.intervals(again)["overall"].value == fast["overall"].value
    assert list(task.remarks(again)) == [
        "4 of the 24 questions of a row are also in an earlier of its sets and count once."
    ]


def test_pooled_sets_have_no_question_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Small scenes repeat between sets, and the table says how many."""
    own = write(tmp_path, "modes: [examples]\nseeds: [0, 1, 2]\nlearners: {majority: {}, oracle: {}}")
    assert main(["experiment", str(own), "--run", str(tmp_path / "run"), "--set", "count=400"]) == 0
    files = sorted((tmp_path / "run").glob("cells/oracle-*/questions.jsonl"))
    asked = [fingerprint(each.scene or {}) for file in files for each in load_questions(file)]
    repeated = len(asked) - len(set(asked))
    assert len(asked) == 1200 and repeated > 0
    note = f"{repeated} of the 1200 questions of a row are also in an earlier of its sets and count once.\n"
    assert capsys.readouterr().out.count(note) == 1
    replies = [
        json.loads(file.with_name("measured.json").read_text(encoding="utf-8"))["evaluations"][""] for file in files
    ]
    task = LanguageQuestions()
    counted = {reply["scene"]: reply for each in replies for reply in each["replies"]}
    share = sum(reply["answer"] == "B" for reply in counted.values()) / len(counted)
    guess = [{"replies": [{**reply, "chosen": "B"} for reply in each["replies"]]} for each in replies]
    assert task.intervals(guess)["overall"].value == pytest.approx(share)


def settings_of(cell: Cell) -> LanguageSettings:
    assert isinstance(cell.settings, LanguageSettings)
    return cell.settings


def test_the_shipped_experiment_asks_the_papers_questions() -> None:
    loaded = load_experiment("language")
    cells = loaded.cells(Selection())
    # Each solver and seed with three prompts, and two more variants.
    assert len(cells) == 5 * 3 * (3 + 2) and loaded.file.stem == "language" and loaded.experiment.paper == "language"
    assert {(each.mode, each.variant, settings_of(each).mix) for each in cells} == {
        *((mode, "", "equal") for mode in ("examples", "rules", "why")),
        ("examples", "by-concept", "by-concept"),
        ("examples", "paper-set", "paper"),
    }
    assert {(each.count, each.about, each.shots) for each in map(settings_of, cells)} == {
        (117, ("tiro", "reckless"), 5)
    }
    (one, *more) = loaded.cells(Selection(only=[("oracle", "why"), ("oracle", "why")], seeds=(7,)))
    assert (one.row, one.mode, one.variant, one.seed) == ("oracle", "why", "", 7)
    # They have a prompt of their own.
    assert [cell.variant for cell in more] == ["by-concept", "paper-set"]
    quick = loaded.cells(Selection(quick=True))
    assert {settings_of(cell).count for cell in quick} == {8} and {cell.seed for cell in quick} == {0}
    rows = paper_table("language")["rows"]
    assert rows["GPT-4o"]["paper-set"]["examples"] == [0.2, 0.841, 0.8, 0.322, 0.59]
    # The paper's figures stand only beside sets with its mix, which is that of their overall accuracy.
    for row in rows.values():
        assert row.keys() == {"paper-set"}
        *actions, overall = row["paper-set"]["examples"]
        mixed = sum(n * share for n, share in zip((20, 42, 25, 30), actions, strict=True)) / 117
        assert mixed == pytest.approx(overall, abs=0.002)


def test_the_documented_tables_are_those_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "how-to" / "ask-language-models.md").read_text(encoding="utf-8")
    (tables,) = re.findall(r"^```text illustration\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert main(["experiment", "language", "--run", str(tmp_path / "run"), "--jobs", "2"]) == 0
    # The CPU time is the last column.
    printed = re.sub(r"  +\d+\.\d\d$", "", capsys.readouterr().out, flags=re.MULTILINE)
    for table in tables.strip().split("\n\n"):
        assert len(table.splitlines()) >= 6 and re.sub(r"  +\d+\.\d\d$", "", table, flags=re.MULTILINE) in printed


ORACLE = "learners: {oracle: {}}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds: []\n" + ORACLE, "`seeds` must be"),
        ("changes: {count: 0}\n" + ORACLE, "`count` must be"),
        ("changes: {counts: 3}\n" + ORACLE, "did you mean `count`"),
        ("learners: {oracel: {}}", "`oracel` is no solver; did you mean `oracle`?: set `endpoint` for a model"),
        ("learners: {a: {changes: {solver: oracel}}}", "`solver` must be `majority`"),
        ("modes: [hints]\n" + ORACLE, "`modes.0` must be `examples`, `rules` or `why`, not `hints`"),
        ("paper: spf\n" + ORACLE, "`paper` must be `language`, not `spf`"),
        ("learners: {gpt: {changes: {endpoint: {url: x}}}}", "the key `endpoint.model` is missing"),
        ("learners: {gpt: {changes: {endpoint: {url: x, model: y, key: z}}}}", "unknown key `key`"),
        ("changes: {count: 20001}\n" + ORACLE, "`count` must be at most 20000, not `20001`"),
        ("changes: {shots: 101}\n" + ORACLE, "`shots` must be at most 100, not `101`"),
        ("changes: {mix: fair}\n" + ORACLE, "`mix` must be `equal`, `paper` or `by-concept`, not `fair`"),
        ("changes: {mix: paper, config: vap-easy}\n" + ORACLE, "the rules never require Fast, but the paper's mix"),
        ("changes: {style: paper}\n" + ORACLE, "use the mode `examples` with at least one example per action"),
        (
            "changes: {shots: 3}\n" + ORACLE,
            "3 solved examples cannot cover all actions of the rules: Slow, Normal, Fast, Stop",
        ),
        ("changes: {config: vap-hrd}\n" + ORACLE, "did you mean `vap-hard`?"),
        ("changes: {config: nowhere.yaml}\n" + ORACLE, "nowhere.yaml`: no such file"),
        ("changes: {about: [tirro]}\n" + ORACLE, "`vap-hard` has no car concept `tirro`"),
        ("changes: {about: [old]}\n" + ORACLE, "known: ambulance, bus, police, tiro, reckless"),
        ("learners: {}", "`learners` must be a mapping with 1 or more keys"),
    ],
)
def test_faulty_files_are_reported(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own\.yaml:3:") as error:
        load_experiment(write(tmp_path, text))
    assert message in str(error.value)


def test_values_are_checked_against_the_named_configuration(tmp_path: Path) -> None:
    (tmp_path / "few.dl").write_text('.include "vocabulary.dl"\nStop(X) :- IsTiro(X).\n', encoding="utf-8")
    (tmp_path / "few.yaml").write_text("base: configs/vap-hard.yaml\nrules: few.dl\n", encoding="utf-8")
    loaded = load_experiment(write(tmp_path, "changes: {config: few.yaml, about: [bus], shots: 2}\n" + ORACLE))
    assert {settings_of(cell).config for cell in loaded.cells(Selection())} == {str(tmp_path / "few.yaml")}
    with pytest.raises(InputError, match=r"cover all actions of the rules: Normal, Stop(.|\n)*own\.yaml:3:36"):
        load_experiment(write(tmp_path, "changes: {config: few.yaml, shots: 1}\n" + ORACLE))
    (tmp_path / "few.dl").write_text("Stop(X) :- IsTiro(X, Y).\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"few\.dl:1:"):
        load_experiment(write(tmp_path, "changes: {config: few.yaml}\n" + ORACLE))


def test_wrong_options_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    monkeypatch.delenv("CITY_KEY", raising=False)
    model = "learners.m.changes.endpoint"
    for options, code, message in [
        (["--reuse", "runs"], 2, "--reuse: only experiments of Safe Path Following"),
        (["--submit", "rows.json"], 2, "--submit"),
        (["--only", "orcale"], 2, "did you mean `oracle`"),
        (["--only", "oracle,hints"], 2, "`oracle` has no mode `hints`"),
        (["--set", "config=nowhere.yaml", "--only", "oracle"], 2, "nowhere.yaml`: no such file"),
        (["--set", "count=0"], 2, "--set count: `count` must be at least 1, not `0`"),
        (["--set", "cuont=3"], 2, "--set cuont: unknown key `cuont`\nhelp: did you mean `count`?"),
        (["--set", f"{model}.urll=x"], 2, f"--set {model}.urll: unknown key `urll`\nhelp: did you mean `url`?"),
        (["--set", "learners.m.chages.x=1"], 2, "--set learners.m.chages: unknown key `chages`"),
        (["--set", f'{model}={{"url": "ftp://x", "model": "y"}}', "--only", "m,rules"], 1, "expected a URL"),
        (
            ["--set", f'{model}={{"url": "http://localhost/v1", "model": "y", "key_from": "CITY_KEY"}}'],
            1,
            "`CITY_KEY` is not set",
        ),
    ]:
        only = [] if "--only" in options else ["--only", "m,rules"] * (model in options[1])
        assert experiment(folder, *options, *only) == code, options
        output = capsys.readouterr()
        assert message in output.err + output.out, options
