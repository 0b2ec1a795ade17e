from __future__ import annotations

import json
import random
import threading
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from conftest import Serve, say, send

from logicity import infer
from logicity.__main__ import main
from logicity.questions import Endpoint, Question, Recall, Reply, ask, grade, load_answers, load_questions, read_letter

QUESTIONS = Path(__file__).parents[2] / "tests" / "fixtures" / "questions.jsonl"
ACTIONS = {"A": "Slow", "B": "Normal", "C": "Fast", "D": "Stop"}


def changed(**values: Any) -> str:
    """The first question of the fixture with other values."""
    return json.dumps({**json.loads(QUESTIONS.read_text(encoding="utf-8").splitlines()[0]), **values})


def made_up(count: int) -> list[Question]:
    return [Question(str(n), "Decide.", (), f"Scene {n}?", ACTIONS, "ABCD"[n % 4]) for n in range(count)]


def test_loaded_questions_agree_with_the_rules() -> None:
    questions = load_questions(QUESTIONS)
    lines = [json.loads(line) for line in QUESTIONS.read_text(encoding="utf-8").splitlines()]
    assert len(questions) == len(lines) == 8
    for question, line in zip(questions, lines, strict=True):
        answer = infer(line["scene"], "vap-hard")["egos"][line["scene"]["ego"]]["action"]
        assert question.options[question.answer] == answer == line["action"]
        system, user = question.messages()
        assert (system["role"], user["role"]) == ("system", "user") and "Answer: " in system["content"]
        assert user["content"].count("(A) Slow\n(B) Normal\n(C) Fast\n(D) Stop") == 5
        assert [user["content"].count(f"\nAnswer: {letter}") for letter in "ABCD"] == [1, 1, 1, 1]
        assert user["content"].rfind(line["question"]) > user["content"].rfind("Answer: ")


def test_questions_in_words_are_graded_like_others(tmp_path: Path) -> None:
    file = tmp_path / "words.jsonl"
    assert main(["questions", "--count", "8", "--shots", "4", "--style", "words", "--output", str(file)]) == 0
    in_words, in_atoms = load_questions(file), load_questions(QUESTIONS)
    assert [question.answer for question in in_words] == [question.answer for question in in_atoms]
    assert not {question.id for question in in_words} & {question.id for question in in_atoms}
    for words, atoms in zip(in_words, in_atoms, strict=True):
        assert "What is not stated is false." in words.text and "Predicates and their arities" in atoms.text
        assert words.messages()[0] == atoms.messages()[0]
    answers = {question.id: f"Answer: {question.answer}" for question in in_words}
    assert grade(in_words, answers).overall.correct == 8


@pytest.mark.parametrize(
    ("reply", "letter"),
    [
        ("B", "B"),
        ("b", "B"),
        (" (C) ", "C"),
        ("D.", "D"),
        ("D) Stop", "D"),
        ("Stop", "D"),
        ("normal.", "B"),
        ("Answer: A", "A"),
        ("answer: a", "A"),
        ("**Answer: D**", "D"),
        ("Answer:\n\nC", "C"),
        ("The answer is B.", "B"),
        ("The correct answer would be (C), since it is a bus.", "C"),
        ("Answer: B. Because nothing holds it.", "B"),
        ("Answer: B because nothing holds it.", "B"),
        ("Final answer: $\\boxed{C}$", "C"),
        ("\\boxed{\\text{Stop}}", "D"),
        ('{"answer": "C"}', "C"),
        ("<answer>D</answer>", "D"),
        ("Answer: Fast", "C"),
        ("Answer: C Fast", "C"),
        ("Answer: option D", "D"),
        ("At first I thought the answer is A.\nIt is at an intersection.\nAnswer: D", "D"),
        ("Answer: D\n\nThis answer is based on the second example.", "D"),
        ("Let me see.\nIt is a bus.\n(C) Fast", "C"),
        ("", None),
        ("I do not know.", None),
        ("A car ahead stops it.", None),
        ("Answer: A car ahead stops it.", None),
        ("Answer: A stop sign is there.", None),
        ("Stop signs are nowhere.", None),
        ("Answer: A or B", None),
        ("Answer: A, B", None),
        ("Answer: (A) or (B)", None),
        ("Answer: A-D", None),
        ("Answer: A Stop", None),
        ("Answer: E", None),
        ("Answer: _", None),
        ("The answer is not B", None),
        ("(A) Slow\n(B) Normal\nI cannot decide.", None),
        ("Answer: Entity_3", None),
        ("Answer: Bus", None),
    ],
)
def test_letters_are_read_from_replies(reply: str, letter: str | None) -> None:
    assert read_letter(reply) == letter


def test_any_text_is_a_reply() -> None:
    draws = random.Random(1)
    parts = [
        "answer",
        "Answer: ",
        "A",
        "b",
        " ",
        "(",
        ")",
        "\n",
        "**",
        "Stop",
        "or",
        "\\boxed{",
        ".",
        "-",
        "é",
        "<",
        ">",
    ]
    for _ in range(3000):
        reply = "".join(draws.choices(parts, k=draws.randrange(12)))
        assert read_letter(reply) in (None, "A", "B", "C", "D")


def test_long_replies_are_read() -> None:
    """In linear time: a quadratic one would take minutes."""
    assert read_letter("answer " * 300_000) is None
    assert read_letter("answer " * 300_000 + "is (C)") == "C"


def test_an_interval_contains_its_share() -> None:
    for total in range(1, 130):
        for correct in range(total + 1):
            accuracy = Recall.of(correct, total).accuracy
            assert 0 <= accuracy.low <= accuracy.value == correct / total <= accuracy.high <= 1


def test_the_oracle_scores_one_and_guessing_a_quarter() -> None:
    questions = made_up(2000)
    oracle = grade(questions, {question.id: question.answer for question in questions})
    assert oracle.overall.correct == 2000 and oracle.overall.accuracy.value == 1.0
    assert all(recall.accuracy.value == 1.0 for recall in oracle.by_action.values())
    draws = random.Random(7)
    guesser = grade(questions, {question.id: f"Answer: {draws.choice('ABCD')}" for question in questions})
    # Four standard deviations of the binomial distribution with p = 1/4 are 77.
    assert abs(guesser.overall.correct - 500) < 77
    assert guesser.overall.accuracy.low < 0.25 < guesser.overall.accuracy.high
    for letter in "ABCD":
        always = grade(questions, {question.id: letter for question in questions})
        assert always.overall.correct == 500 and always.by_action[ACTIONS[letter]].correct == 500


def test_a_grade_counts_every_question_once() -> None:
    questions = made_up(6)
    graded = grade(questions, {"0": "A", "1": "Answer: C", "2": "who knows", "4": "A", "9": "A"})
    assert graded.overall.correct == 2 and graded.overall.total == 6
    assert (graded.missing, graded.unread, graded.unknown) == (("3", "5"), ("2",), ("9",))
    assert graded.confusion["B"] == {"A": 0, "B": 0, "C": 1, "D": 0, "unread": 0, "missing": 1}
    assert sum(sum(row.values()) for row in graded.confusion.values()) == 6
    # The Wilson interval of 2 of 6, computed independently: its center is (1/3 + z²/12) / (1 + z²/6).
    assert (round(graded.overall.accuracy.low, 4), round(graded.overall.accuracy.high, 4)) == (0.0968, 0.7000)
    assert json.loads(json.dumps(graded.to_dict()))["by_action"]["Slow"]["correct"] == 2
    assert list(grade(questions[:2], {}).by_action) == ["Slow", "Normal"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no questions"),
        ("{", ":1: not JSON"),
        ("[]", ":1: expected an object"),
        ("[" * 100_000, ":1: not JSON"),
        ('{"id": ' + "1" * 5000 + "}", ":1: not JSON"),
        ('{"id": "x"}', ":1: not a question of `logicity questions`: the key 'system' is missing"),
        (changed(answer=[]), ":1: not a question of `logicity questions`: `answer` is not text"),
        (changed(system=3), "`system` is not text"),
        (changed(labels=[1]), "`labels` is not a list of texts"),
        (changed(clauses="abc"), "`clauses` is not a list of texts"),
        (changed(demonstrations=[1]), ":1: not a question"),
        (
            json.dumps({"id": "x", "system": "", "demonstrations": [], "question": "", "options": {}, "answer": "A"}),
            "options",
        ),
        (
            QUESTIONS.read_text(encoding="utf-8").splitlines()[0] + "\n" + QUESTIONS.read_text(encoding="utf-8"),
            ":2: duplicate id",
        ),
    ],
    ids=lambda value: repr(value)[:60],
)
def test_invalid_questions_are_reported_with_their_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "questions.jsonl"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        load_questions(path)


def test_invalid_answers_are_reported_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "answers.jsonl"
    for text, message in [
        ('{"id": "a"}', ":1: expected a string `answer`"),
        ('{"id": "a", "answer": "A"}\n\n{"id": "a", "answer": "B"}', ":3: second answer to the question 'a'"),
    ]:
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            load_answers(path)
    path.write_bytes(b'{"id": "a", "answer": "A"}\n{"id": "\xff", "answer": "A"}\n')
    with pytest.raises(ValueError, match="answers.jsonl:2: not JSON: .* can't decode"):
        load_answers(path)


def test_all_questions_are_asked_and_graded(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    right = {question.messages()[1]["content"]: question.answer for question in load_questions(QUESTIONS)}
    server = serve(lambda handler, _, body: say(handler, f"So.\nAnswer: {right[body['messages'][1]['content']]}"))
    monkeypatch.setenv("CITY_KEY", "sesame\n")
    replies, figures = tmp_path / "replies.jsonl", tmp_path / "figures.json"
    questions = ["--questions", str(QUESTIONS)]
    arguments = ["--url", server.url, "--model", "oracle", "-o", str(replies), "--key-from", "CITY_KEY"]
    assert main(["ask", *questions, *arguments]) == 0
    asked = capsys.readouterr().out
    assert "1.00 [0.68, 1.00]" in asked
    assert {request["path"] for request in server.requests} == {"/v1/chat/completions"}
    assert {(request["model"], request["temperature"]) for request in server.requests} == {("oracle", 0)}
    assert set(server.keys) == {"Bearer sesame"} and len(server.keys) == 8
    assert main(["grade", str(replies), *questions, "--json", str(figures)]) == 0
    assert capsys.readouterr().out == asked
    assert json.loads(figures.read_text())["overall"]["correct"] == 8
    # A second call sends no request.
    assert main(["ask", *questions, *arguments]) == 0 and len(server.requests) == 8
    # Another model, or other questions, need another file.
    assert main(["ask", *questions, *arguments[:3], "other", *arguments[4:]]) == 1
    with pytest.raises(ValueError, match="belongs to the unknown question"):
        ask(made_up(2), Endpoint(server.url, "oracle"), replies)
    assert len(server.requests) == 8


def test_transient_failures_are_retried(serve: Serve, tmp_path: Path) -> None:
    stalled = threading.Event()

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        match number:
            case 0:
                send(handler, 429, b"slow down", Retry_After="0")
            case 1:
                send(handler, 500, b"oops")
            case 2:
                send(handler, 200, b"not JSON")
            case 3:
                send(handler, 200, b'{"choices": []}')
            case 4:
                handler.connection.close()
            case 5:
                stalled.wait(10)
            case 6:
                handler.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n{")
            case _:
                say(handler, None if number == 8 else "B")

    server = serve(act)
    endpoint = Endpoint(server.url, "stub", timeout=1, tries=8, pause=0.01)
    watched: list[int] = []
    answers = ask(made_up(3), endpoint, tmp_path / "replies.jsonl", watched.append)
    stalled.set()
    assert answers == {"0": "B", "1": "", "2": "B"} == load_answers(tmp_path / "replies.jsonl")
    assert len(server.requests) == 10 and watched == [0, 1, 2, 3]
    assert server.keys == [None] * 10


@pytest.mark.parametrize(
    ("response", "message"),
    [
        (b"hello", "BadStatusLine|hello"),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nab", "IncompleteRead"),
        (b"HTTP/1.1 200 OK\r\n\r\n" + b"[" * 100_000, "not a reply of a chat endpoint: \\["),
        (b'HTTP/1.1 200 OK\r\n\r\n{"choices": ["B"]}', "not a reply of a chat endpoint"),
        (b'HTTP/1.1 200 OK\r\n\r\n{"choices": [{"message": "B"}]}', "not a reply of a chat endpoint"),
        (b'HTTP/1.1 200 OK\r\n\r\n{"choices": [{"message": {"content": ["B"]}}]}', "not a reply of a chat endpoint"),
        (b"HTTP/1.1 500 Oops\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", "500 Oops$"),
        (b"HTTP/1.1 429 Slow down\r\nRetry-After: nan\r\nContent-Length: 0\r\n\r\n", "429 Slow down$"),
    ],
    ids=lambda value: repr(value)[:60],
)
def test_invalid_responses_are_retried(response: bytes, message: str, serve: Serve) -> None:
    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        if number > 2:
            say(handler, "Answer: B")
        else:
            handler.wfile.write(response)
            handler.close_connection = True

    server = serve(act)
    waits: list[tuple[float, str]] = []
    endpoint = Endpoint(server.url, "stub", tries=2)
    with pytest.raises(ConnectionError, match=f"no reply from .* in 2 attempts: .*({message})"):
        endpoint.reply([], lambda seconds, reason: waits.append((seconds, reason)))
    assert endpoint.reply([], lambda seconds, reason: waits.append((seconds, reason))) == Reply("Answer: B")
    assert [seconds for seconds, _ in waits] == [1.0, 1.0] and len(server.requests) == 4


def test_the_body_of_an_error_may_stall(serve: Serve) -> None:
    ended = threading.Event()

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        handler.wfile.write(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 100\r\n\r\n{")
        handler.wfile.flush()
        ended.wait(60)

    try:
        with pytest.raises(ConnectionError, match=r"rejects the request: 400 Bad Request: \{$"):
            Endpoint(serve(act).url, "stub", timeout=1).reply([])
    finally:
        ended.set()


def test_the_query_of_a_url_is_kept(serve: Serve) -> None:
    server = serve(lambda handler, *_: say(handler, "B"))
    for url in (server.url, f"{server.url}/", f"{server.url}/chat/completions/"):
        for query in ("", "?api-version=1"):
            Endpoint(url + query, "stub").reply([])
            assert server.requests[-1]["path"] == f"/v1/chat/completions{query}"


def test_earlier_replies_are_kept_when_the_server_fails(
    serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "replies.jsonl"
    server = serve(lambda handler, number, _: say(handler, "A") if number < 2 else send(handler, 503, b"full"))
    endpoint = Endpoint(server.url, "stub", tries=3, pause=0.01)
    with pytest.raises(ConnectionError, match="in 3 attempts: 503 .*: full"):
        ask(made_up(4), endpoint, path)
    assert len(server.requests) == 5 and list(load_answers(path)) == ["0", "1"]
    # A kill during a write leaves an incomplete line.
    with path.open("a", encoding="utf-8") as file:
        file.write('{"id": "2", "ans')
    server.act = lambda handler, number, _: say(handler, "D")
    assert ask(made_up(4), endpoint, path) == {"0": "A", "1": "A", "2": "D", "3": "D"}
    assert len(server.requests) == 7 and len(load_answers(path)) == 4


def test_rejected_requests_are_not_retried(serve: Serve, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = serve(lambda handler, number, _: say(handler, "A"))
    for code, message in [(401, "401 .*: who are you"), (404, "404"), (302, "302"), (307, "307")]:
        server = serve(lambda handler, _, __, code=code: send(handler, code, b"who are you", Location=other.url))  # type: ignore[misc]
        with pytest.raises(ConnectionError, match=message):
            ask(made_up(1), Endpoint(server.url, "stub", key="sesame"), tmp_path / "replies.jsonl")
        assert len(server.requests) == 1
    # The key is not sent to the target of a redirect.
    assert other.requests == []
    arguments = [
        "--questions",
        str(QUESTIONS),
        "--url",
        server.url,
        "--model",
        "stub",
        "-o",
        str(tmp_path / "of.jsonl"),
    ]
    assert main(["ask", *arguments]) == 2 and "rejects the request: 307" in capsys.readouterr().err


def test_errors_of_endpoints_do_not_show_the_key(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for faulty in (
        {"url": "file:///etc/passwd"},
        {"url": "localhost:8000"},
        {"url": "http://localhost:port/v1"},
        {"url": "http://[::1"},
        {"url": "http://.../v1"},
        {"url": "http://localhost/a b"},
        {"url": "http://localhost/\u00e9"},
        {"url": "http://user:two words@localhost/v1"},
        {"timeout": 1e9},
        {"timeout": float("nan")},
        {"pause": float("inf")},
        {"settings": {"temperature": float("nan")}},
        {"settings": {"stop": {"a", "b"}}},
        {"key": "two words"},
        {"settings": {"model": "another"}},
        {"tries": 0},
    ):
        with pytest.raises(ValueError) as error:
            Endpoint(**{"url": "http://localhost/v1", "model": "stub", **faulty})  # type: ignore[arg-type]
        assert "two words" not in str(error.value)
    arguments = ["ask", "--questions", str(QUESTIONS), "--url", "http://localhost/v1", "--model", "m"]
    arguments += ["-o", str(tmp_path / "replies.jsonl")]
    monkeypatch.delenv("CITY_KEY", raising=False)
    assert main([*arguments, "--key-from", "CITY_KEY"]) == 2
    assert "`CITY_KEY` is not set" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*arguments, "--settings", "[1]"])


def test_missing_and_unreadable_answers_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    questions = load_questions(QUESTIONS)
    answers = tmp_path / "answers.jsonl"
    replies = {questions[0].id: questions[0].answer, questions[1].id: "hm", "another": "A"}
    answers.write_text("".join(json.dumps({"id": name, "answer": text}) + "\n" for name, text in replies.items()))
    assert main(["grade", str(answers), "--questions", str(QUESTIONS)]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[-1].startswith("all             8          0.12 [0.02, 0.47]")
    left = ", ".join(question.id for question in questions[2:7])
    assert printed.err.splitlines() == [
        f"counted as wrong, no answer: 6: {left}, ...",
        f"counted as wrong, the answer chooses no option: 1: {questions[1].id}",
        "ignored, unknown question: 1: another",
    ]
    # Questions are not replies, although they have the key `answer`.
    assert main(["grade", str(QUESTIONS), "--questions", str(QUESTIONS)]) == 1
    assert f"{QUESTIONS}:1: expected an answer, found a question" in capsys.readouterr().err
    answers.write_text("")
    assert main(["grade", str(answers), "--questions", str(QUESTIONS)]) == 1
    assert capsys.readouterr().err == f"error: {answers} has no answers\n"
    assert main(["grade", str(tmp_path / "nowhere.jsonl")]) == 2
