"""The experiment of language questions: prompts, rules in replies, calibration, solvers, models and tables."""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Mapping
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
    grade,
    load_logprobs,
    load_questions,
    read_rule,
)

needs("torch", "learn")
from logicity.experiments.jobs import exclusive  # noqa: E402
from logicity.experiments.language.experiment import LanguageExperiment, ModelSpec, Unit, Work, answer  # noqa: E402
from logicity.experiments.language.report import LanguageReport  # noqa: E402
from logicity.experiments.language.solvers import SOLVERS, features, similarity  # noqa: E402
from logicity.experiments.report import paper_table  # noqa: E402

FIXTURE = ROOT / "tests" / "fixtures" / "questions.jsonl"
LABELS = ("N", "VS1", "VS7", "my_rules.dl:5", "my_rules.dl:50")
OPTIONS = dict(zip("ABCD", ACTIONS, strict=True))


def made_up(count: int, labels: tuple[str, ...] = ()) -> list[Question]:
    clauses = (("VS1", "VS7"), (), ("N",), ("VS7",))
    return [
        Question(str(n), "Decide.", (), f"Scene {n}?", OPTIONS, "ABCD"[n % 4], clauses[n % 4], labels)
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
    path.write_text(json.dumps({**lines[0], "version": 3}), encoding="utf-8")
    with pytest.raises(ValueError, match=r":1: questions of version 3; this program reads the versions 1 and 2"):
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


# --- the experiment


def experiment(folder: Path, *options: str) -> int:
    return main(["experiment", "language", "--quick", "--run", str(folder), "--jobs", "2", *options])


def entries(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    table = json.loads((folder / "table.json").read_text(encoding="utf-8"))
    return {(entry["row"], entry["prompt"]): entry for entry in table["entries"]}


def by_text(folder: Path) -> dict[str, Question]:
    """The questions of an experiment by their messages."""
    found = [each for path in (folder / "questions").glob("*.jsonl") for each in load_questions(path)]
    return {json.dumps(question.messages()): question for question in found}


def test_solvers_and_a_stub_give_a_table(serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    size = ["--set", "count=16"]
    assert experiment(folder, *size) == 0
    printed = capsys.readouterr().out
    assert "GPT-4o (paper)" in printed and "written: " in printed
    solved = entries(folder)
    assert set(solved) == {(row, prompt) for row in SOLVERS for prompt in ("examples", "rules", "why")}
    # The oracle names the root of a proof by the engine, which is one of the clauses in the file.
    for prompt in ("examples", "rules", "why"):
        assert solved["oracle", prompt]["grade"]["overall"]["correct"] == 16
        assert solved["majority", prompt]["grade"]["overall"]["correct"] == 4
        assert solved["induced", prompt]["grade"] is not None
    assert solved["oracle", "why"]["grade"]["both"]["correct"] == 16
    assert solved["induced", "why"]["grade"]["named"] == 0 < solved["nearest", "why"]["grade"]["named"]
    assert "GPT-4o & " not in (folder / "table.tex").read_text() and "| GPT-4o (paper) | 0.20" in (
        folder / "table.md"
    ).read_text(encoding="utf-8")

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
    model = json.dumps({"stub": {"url": server.url, "model": "scripted", "logprobs": True, "tries": 1}})
    stub = [*size, "--set", f"models={model}"]
    assert experiment(folder, *stub) == 1
    assert "closed" in capsys.readouterr().out
    stored = sum(len(path.read_text().splitlines()) for path in (folder / "replies" / "stub").glob("*.jsonl"))
    assert stored == 20 < len(server.requests)
    assert experiment(folder, *stub, "--list", "--only", "stub") == 0
    listed = capsys.readouterr().out.splitlines()
    assert len(listed) == 3 and sum(int(line.split()[0]) for line in listed) == 20

    down, before = False, len(server.requests)
    assert experiment(folder, *stub) == 0
    assert len(server.requests) == before + 28
    assert {(request["temperature"], request["logprobs"], request["top_logprobs"]) for request in server.requests} == {
        (0, True, 20)
    }
    found = entries(folder)
    assert {key: value for key, value in found.items() if key[0] != "stub"} == solved
    for prompt in ("examples", "rules", "why"):
        measured = found["stub", prompt]["grade"]
        assert measured["overall"]["correct"] == 12 and measured["overall"]["total"] == 16
        assert measured["calibration"]["count"] == 16
        # The confidence is 0.7 and the accuracy 0.75; a right reply has the distance 0.12, a wrong one 1.32.
        assert measured["calibration"]["ece"] == pytest.approx(0.05)
        assert measured["calibration"]["brier"] == pytest.approx((12 * 0.12 + 4 * 1.32) / 16)
    asked = [question for question in questions.values() if question.labels]
    proven = [question for question in asked if question.clauses != ("N",)]
    both = [question for question in proven if int(question.id.rsplit("-", 1)[1]) % 4]
    measured = found["stub", "why"]["grade"]
    assert 0 < len(both) < len(proven) < len(asked) == 16
    assert (measured["rules"]["correct"], measured["both"]["correct"]) == (len(proven), len(both))
    assert found["stub", "examples"]["grade"]["rules"] is None

    # Nothing remains to ask, and the report is the same, byte for byte.
    files = sorted(path for path in folder.iterdir() if path.is_file() and path.name.startswith(("table", "accuracy")))
    assert {path.suffix for path in files} >= {".json", ".md", ".tex"}
    first = [path.read_bytes() for path in files]
    assert experiment(folder, *stub) == 0 and experiment(folder, *stub, "--report") == 0
    assert [path.read_bytes() for path in files] == first and len(server.requests) == before + 28
    # Other settings are other replies.
    assert experiment(folder, *stub, "--set", "models.stub.settings.seed=1", "--only", "stub,rules") == 0
    assert len(server.requests) == before + 44 and server.requests[-1]["seed"] == 1


def test_ctrl_c_stops_after_the_running_requests(serve: Serve, tmp_path: Path) -> None:
    questions = made_up(8)
    spec = LanguageExperiment(
        task="language",
        title="Own",
        models={"m": ModelSpec(url=serve(lambda handler, *_: say(handler, "A")).url, model="m")},
    )
    work = [Work(Unit("m", "examples", seed), questions, tmp_path / "m" / f"{seed}.jsonl") for seed in range(3)]

    def say_and_stop(line: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(spec, tmp_path / "own.yaml", work, 1, say_and_stop)
    # The first unit was complete when the interrupt came; the others stop, on a busy machine after some requests.
    assert work[0].stored() == 8 and work[1].stored() < 8 and work[2].stored() == 0
    lines: list[str] = []
    assert answer(spec, tmp_path / "own.yaml", work, 1, lines.append) == {}
    assert [each.stored() for each in work] == [8] * 3
    assert lines[-1] == "[3/3] m, examples, seed 2"


def test_an_interrupt_does_not_wait_for_the_next_attempt(serve: Serve, tmp_path: Path) -> None:
    server = serve(lambda handler, *_: send(handler, 503, b"full\nindeed", Retry_After="600"))
    spec = LanguageExperiment(task="language", title="Own", models={"m": ModelSpec(url=server.url, model="m")})
    work = [Work(Unit("m", "examples", seed), made_up(2), tmp_path / "m" / f"{seed}.jsonl") for seed in range(2)]
    lines: list[str] = []

    def say_and_stop(line: str) -> None:
        lines.append(line)
        if len(lines) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer(spec, tmp_path / "own.yaml", work, 2, say_and_stop)
    assert sorted(lines[:2]) == [
        f"m, examples, seed {seed}: 503 Service Unavailable: full indeed; next attempt in 600 s" for seed in range(2)
    ]


def test_a_selection_has_each_unit_once() -> None:
    spec = LanguageExperiment(task="language", title="Own", seeds=(1,), prompts=("why",), solvers=("oracle",))
    assert spec.units([("oracle", "why"), ("oracle", None)]) == spec.units() == [Unit("oracle", "why", 1)]
    for key, values in {"seeds": (1, 1), "prompts": ("why", "why"), "solvers": ("oracle", "oracle")}.items():
        with pytest.raises(ValueError, match=f"{key}(.|\n)*`{values[0]}` occurs twice"):
            LanguageExperiment.model_validate({"task": "language", "title": "Own", key: values})


def test_other_content_of_a_file_of_replies_is_reported(serve: Serve, tmp_path: Path) -> None:
    server = serve(lambda handler, *_: say(handler, "A"))
    spec = LanguageExperiment(task="language", title="Own", models={"m": ModelSpec(url=server.url, model="m")})
    work = Work(Unit("m", "examples", 0), made_up(2), tmp_path / "0.jsonl")
    for text in ("{}", "[]", "rubbish", '{"id": []}', "[" * 100_000):
        work.path.write_text(text + "\n", encoding="utf-8")
        with pytest.raises(ValueError, match=r"0\.jsonl:1: not a reply\nhelp: remove `.*0\.jsonl`"):
            work.stored()
        with pytest.raises(ValueError, match=r"0\.jsonl:1: (.|\n)*help: remove `.*0\.jsonl`"):
            answer(spec, tmp_path / "own.yaml", [work], 1, print)
    work.path.unlink()
    assert work.stored() == 0 and answer(spec, tmp_path / "own.yaml", [work], 1, print) == {}
    assert work.stored() == 2


def test_a_running_experiment_can_be_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with exclusive(tmp_path / "run"):
        assert experiment(tmp_path / "run", "--only", "majority,why") == 2
        assert "one process at a time runs an experiment" in capsys.readouterr().err
        assert experiment(tmp_path / "run", "--only", "majority,why", "--list") == 0
        assert experiment(tmp_path / "run", "--only", "majority,why", "--report") == 0
        assert "0 of 8 replies are stored" in capsys.readouterr().out


def test_a_perfect_row_of_any_size_is_drawn(tmp_path: Path) -> None:
    """Rounding errors must not make an error bar negative."""
    needs("matplotlib", "learn")
    questions = made_up(10)
    work = Work(Unit("oracle", "examples", 0), questions, tmp_path / "0.jsonl")
    spec = LanguageExperiment(task="language", title="Own")
    work.path.write_text(
        "".join(json.dumps({"id": each.id, "answer": each.answer}) + "\n" for each in questions), encoding="utf-8"
    )
    report = LanguageReport(spec, [work])
    assert report.entries[0].grade is not None and report.entries[0].grade.overall.correct == 10
    assert "accuracy.svg" in {path.name for path in report.write(tmp_path)}


def test_the_shipped_experiment_asks_the_papers_questions() -> None:
    spec, file = LanguageExperiment.load("language")
    assert (spec.count, spec.about, spec.shots) == (117, ("tiro", "reckless"), 5) and spec.paper == "language"
    assert len(spec.units()) == 4 * 3 * 3 and file.stem == "language"
    assert spec.units([("oracle", "why")], [7]) == [Unit("oracle", "why", 7)]
    quick, _ = LanguageExperiment.load(ROOT / "configs" / "experiments" / "language.yaml", quick=True)
    assert quick.count == 8 and quick.seeds == (0,)
    rows = paper_table("language")["rows"]
    assert rows["GPT-4o"] == [20.0, 84.1, 80.0, 32.2, 59.0]
    # The overall accuracy is between those of the actions.
    assert all(len(row) == 5 and min(row[:4]) < row[4] < max(row[:4]) for row in rows.values())


def test_the_documented_tables_are_those_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "how-to" / "ask-language-models.md").read_text(encoding="utf-8")
    (tables,) = re.findall(r"^```text illustration\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert main(["experiment", "language", "--run", str(tmp_path / "run"), "--jobs", "2"]) == 0
    printed = capsys.readouterr().out
    for table in tables.strip().split("\n\n"):
        assert len(table.splitlines()) >= 6 and table in printed


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds: []", "`seeds` must be"),
        ("count: 0", "`count` must be"),
        ("counts: 3", "did you mean `count`"),
        ("solvers: [oracel]", "`solvers"),
        ("prompts: [hints]", "`prompts"),
        ("paper: spf", "`paper` must be `language`, not `spf`"),
        ("models: {gpt: {url: x}}", "the key `models.gpt.model` is missing"),
        ("models: {gpt: {url: x, model: y, key: z}}", "unknown key `key`"),
        ("models: {oracle: {url: x, model: y}}", "is the name of a solver"),
        ("models: {a/b: {url: x, model: y}}", "cannot be the name of a folder"),
        ("count: 20001", "`count` must be at most 20000, not `20001`"),
        ("shots: 101", "`shots` must be at most 100, not `101`"),
        ("shots: 3", "3 solved examples cannot cover all actions of the rules: Slow, Normal, Fast, Stop"),
        ("config: vap-hrd", "did you mean `vap-hard`?"),
        ("config: nowhere.yaml", "nowhere.yaml`: no such file"),
        ("about: [tirro]", "`vap-hard` has no car concept `tirro`"),
        ("about: [old]", "known: ambulance, bus, police, tiro, reckless"),
        ("solvers: []", "no solver and no model answers the questions: name one"),
    ],
)
def test_faulty_files_are_reported(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(f"task: language\ntitle: Own\n{text}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"own\.yaml:3:") as error:
        LanguageExperiment.load(path)
    assert message in str(error.value)


def test_values_are_checked_against_the_named_configuration(tmp_path: Path) -> None:
    (tmp_path / "few.dl").write_text('.include "vocabulary.dl"\nStop(X) :- IsTiro(X).\n', encoding="utf-8")
    (tmp_path / "few.yaml").write_text("base: configs/vap-hard.yaml\nrules: few.dl\n", encoding="utf-8")
    path = tmp_path / "own.yaml"
    path.write_text("task: language\ntitle: Own\nconfig: few.yaml\nabout: [bus]\nshots: 2\n", encoding="utf-8")
    assert LanguageExperiment.load(path)[0].shots == 2
    path.write_text("task: language\ntitle: Own\nconfig: few.yaml\nshots: 1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"cover all actions of the rules: Normal, Stop(.|\n)*own\.yaml:4:8"):
        LanguageExperiment.load(path)
    (tmp_path / "few.dl").write_text("Stop(X) :- IsTiro(X, Y).\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"few\.dl:1:"):
        LanguageExperiment.load(path)


def test_wrong_options_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    for options, code, message in [
        (["--ray"], 2, "--ray: an experiment of language questions does not support"),
        (["--submit", "rows.json"], 2, "--submit"),
        (["--only", "orcale"], 2, "did you mean `oracle`"),
        (["--only", "oracle,hints"], 2, "unknown prompt `hints`"),
        (["--set", "config=nowhere.yaml", "--only", "oracle"], 2, "nowhere.yaml`: no such file"),
        (["--set", "count=0"], 2, "error: --set count: `count` must be at least 1, not `0`"),
        (["--set", "cuont=3"], 2, "--set cuont: unknown key `cuont`\nhelp: did you mean `count`?"),
        (["--set", "models.m.urll=x"], 2, "--set models.m.urll: unknown key `urll`\nhelp: did you mean `url`?"),
        (["--set", "models.m.url=x"], 2, "--set models.m.model: the key `models.m.model` is missing"),
        (["--set", "solvers=[]"], 2, "--set solvers: no solver and no model answers the questions"),
        (
            ["--set", 'models={"m": {"url": "ftp://x", "model": "y"}}', "--only", "m,rules"],
            1,
            "models.m: expected a URL",
        ),
    ]:
        assert experiment(folder, *options) == code
        assert message in capsys.readouterr().err
    monkeypatch.delenv("CITY_KEY", raising=False)
    keyed = json.dumps({"m": {"url": "http://localhost/v1", "model": "y", "key_from": "CITY_KEY"}})
    assert experiment(folder, "--set", f"models={keyed}", "--only", "m,rules") == 1
    assert "`CITY_KEY` is not set" in capsys.readouterr().err
