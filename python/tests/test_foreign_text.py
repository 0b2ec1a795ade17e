"""Text and time of others: secrets stay secret, terminals stay in order, and every request ends."""

from __future__ import annotations

import base64
import html
import json
import random
import re
import socket
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Serve, needs, say, send

from logicity.__main__ import main
from logicity.commands import SUMMARIES
from logicity.questions import Endpoint, Question, ask, grade, load_answers, read_letter, read_rule
from logicity.redaction import Redactor, masked, shown_url
from logicity.terminal import neutral

QUESTIONS = ROOT / "tests" / "fixtures" / "questions.jsonl"
KEY = "sk-test-9Zq/4+Lm=7&W\"x\\Hd<3>vT~pRk2'Yb8"
#: A sequence of each kind: the title of a window, colors, C1 controls, reordered text, an overwritten line, a rubout.
HOSTILE = "\x1b]0;owned\x07\x1b[31m\x9b2J\u202egnp.\u2066\rok\x7f\x08"
ACTIVE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def contains_key(text: str, key: str = KEY) -> bool:
    """Return whether a text has at least 8 characters of a key in a row, in a usual encoding."""
    views = [text, urllib.parse.unquote(text), html.unescape(text), text.replace("\\", "")]
    for word in re.findall(r"[A-Za-z0-9_+/-]{8,}", text):
        for start in range(4):
            usual = word[start:].replace("-", "+").replace("_", "/")
            views.append(base64.b64decode(usual[: len(usual) // 4 * 4]).decode("latin-1"))
        if re.fullmatch(r"(?:[0-9a-fA-F]{2})+", word):
            views.append(bytes.fromhex(word).decode("latin-1"))
    parts = [key[at : at + 8].lower() for at in range(max(1, len(key) - 7))]
    return any(part in view.lower() for view in views for part in parts)


def percent(text: str) -> str:
    return "".join(f"%{byte:02x}" for byte in text.encode())


ENCODINGS: dict[str, Callable[[str], str]] = {
    "itself": str,
    "upper case": str.upper,
    "part of JSON": lambda key: json.dumps({"error": {"headers": {"Authorization": f"Bearer {key}"}}}),
    "JSON in JSON": lambda key: json.dumps(json.dumps({"key": key})),
    "escapes of JSON": lambda key: "".join(f"\\u{ord(each):04X}" for each in key),
    "slashes of JSON": lambda key: json.dumps(key).replace("/", "\\/"),
    "repr": repr,
    "bytes": lambda key: "".join(f"\\x{byte:02x}" for byte in key.encode()),
    "URL": lambda key: urllib.parse.quote(key, safe=""),
    "whole URL": percent,
    "URL twice": lambda key: urllib.parse.quote(percent(key)),
    "HTML": html.escape,
    "numbers of HTML": lambda key: "".join(f"&#{ord(each)};" for each in key),
    "base64": lambda key: base64.b64encode(key.encode()).decode(),
    "base64 of the header": lambda key: base64.b64encode(f"Bearer {key}".encode()).decode(),
    "base64 of headers": lambda key: base64.b64encode(f"Host: a\r\nAuthorization: Bearer {key}\r\n".encode()).decode(),
    "base64 of a password": lambda key: base64.b64encode(f":{key}".encode()).decode(),
    "base64 for URLs": lambda key: base64.urlsafe_b64encode(f"x{key}".encode()).decode(),
    "hex": lambda key: key.encode().hex(),
    "beginning": lambda key: key[:20] + "***",
    "end": lambda key: "***" + key[-9:],
}


@pytest.mark.parametrize("name", ENCODINGS)
def test_a_key_is_removed_from_any_text(name: str) -> None:
    for key in (KEY, "9f86d081884c7d659a2feaa0c55ad015", "sk-" + "aZ09_-" * 8):
        text = f"before {ENCODINGS[name](key)} after"
        shown = Redactor(key, "http://localhost/v1", {})(text)
        assert shown.startswith("before ") and shown.endswith(" after") and "[secret]" in shown
        assert contains_key(text, key) or "escapes" in name or "twice" in name or "in JSON" in name or name == "bytes"
        assert not contains_key(shown, key), shown


def test_other_text_is_kept() -> None:
    redact = Redactor(KEY, "http://localhost/v1?api-version=2024-10-21&api_key=hush-hush", {"user": "someone"})
    text = "Answer: B, 2024-10-21, someone; 100 % \\u0041 &amp; {}"
    assert redact(text) == text
    assert redact("with hush-hush") == "with [secret]"
    # What the questions contain is no secret: servers without authentication take any key.
    assert Redactor("A", "http://localhost/v1", {}, "(A) Slow")("Answer: A") == "Answer: A"
    assert Redactor("sesame", "http://localhost/v1", {}, "(A) Slow")("open sesame") == "open [secret]"
    settings = {"temperature": 0, "extra": [{"api_key": "hush-hush", "max_tokens": 5, "stop_token": "</s>"}]}
    assert Redactor(None, "http://localhost/v1", settings)("hush-hush </s>") == "[secret] </s>"
    assert masked(settings) == {
        "temperature": 0,
        "extra": [{"api_key": "[secret]", "max_tokens": 5, "stop_token": "</s>"}],
    }


def test_random_text_keeps_all_but_the_key() -> None:
    draws = random.Random(1)
    redact = Redactor(KEY, "http://localhost/v1", {})
    pieces = ["%", "%4", "\\", "\\u00", "&#", "&amp;", "a", " ", "é", "%20", "\\x41", "😀", "\n"]
    for _ in range(300):
        before, after = ("".join(draws.choices(pieces, k=draws.randrange(8))) for _ in range(2))
        assert redact(before) == before
        assert redact(f"{before} {KEY} {after}") == f"{before} [secret] {after}"


def test_urls_are_shown_without_secrets() -> None:
    assert shown_url("https://host:1/v1?key=hush#hush") == "https://host:1/v1"
    assert shown_url("https://user:hush@host/v1") == "https://host/v1"
    for url in ("https://user:hush@host", "https:/user:hush@host", "user:hush@host", "https://user:hu/hush@host"):
        with pytest.raises(ValueError) as error:
            Endpoint(url, "stub")
        assert "hush" not in str(error.value)


def ask_all(url: str, folder: Path, *options: str) -> int:
    arguments = ["--questions", str(QUESTIONS), "--url", url, "--model", "stub", "-o", str(folder / "replies.jsonl")]
    return main(["ask", *arguments, "--key-from", "CITY_KEY", "--tries", "1", *options])


@pytest.mark.parametrize("place", ["reply", "body", "reason", "status line", "header", "location", "chunk", "not JSON"])
def test_what_a_server_returns_is_shown_without_the_key(
    place: str, serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CITY_KEY", KEY)

    def act(handler: BaseHTTPRequestHandler, number: int, body: dict[str, Any]) -> None:
        echo = f"{HOSTILE} {handler.headers['Authorization']} {percent(KEY)}"
        raw = echo.replace("\r", "").encode()
        match place:
            case "reply":
                say(handler, f"{echo}\nAnswer: B")
            case "body":
                # The body is cut in the middle of a key.
                send(handler, 401, b"x" * 250 + raw * 2000)
            case "reason":
                handler.wfile.write(b"HTTP/1.1 418 " + raw + b"\r\nContent-Length: 0\r\n\r\n")
            case "status line":
                handler.wfile.write(raw + b"\r\n\r\n")
            case "header":
                handler.wfile.write(
                    b"HTTP/1.1 500 Oops\r\nContent-Length: " + raw + b"\r\nX: " + raw * 3000 + b"\r\n\r\n"
                )
            case "location":
                send(handler, 302, raw, Location=f"http://{KEY}/")
            case "chunk":
                handler.wfile.write(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + raw + b"\r\n")
            case _:
                send(handler, 200, raw)
        handler.close_connection = True

    code = ask_all(serve(act).url, tmp_path)
    printed = capsys.readouterr()
    written = "".join(path.read_text(encoding="utf-8") for path in tmp_path.iterdir())
    answers = "".join(load_answers(tmp_path / "replies.jsonl").values())
    assert code == (0 if place == "reply" else 2)
    for text in (printed.out, printed.err, written, answers):
        assert not contains_key(text), text
    for text in (printed.out, printed.err, written):
        assert not ACTIVE.search(text), text
    assert ("[secret]" in answers) == (place == "reply")
    assert printed.err.startswith("wrote ") == (place == "reply") and len(printed.err) < 600


def test_keys_do_not_leave_by_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = Endpoint("http://localhost/v1", "stub", KEY, {"api_key": KEY})
    assert not contains_key(repr(endpoint)) and not contains_key(str(endpoint))
    # The key instead of the name of its variable, or in the URL.
    assert ask_all("http://localhost/v1", tmp_path, "--key-from", KEY) == 2
    assert ask_all("http://localhost/v1", tmp_path, "--key-from", "sesamesesame") == 2
    monkeypatch.setenv("CITY_KEY", "sesamesesame")
    assert ask_all("https://user:sesamesesame@localhost/v1", tmp_path) == 1
    assert ask_all("http://127.0.0.1:1/v1?key=sesamesesame", tmp_path) == 2
    printed = capsys.readouterr()
    assert "environment variable" in printed.err and "127.0.0.1:1" in printed.err
    assert not contains_key(printed.out + printed.err) and "sesame" not in printed.out + printed.err


#: What a server sends after a request, in pieces, forever.
ENDLESS: dict[str, tuple[bytes, bytes]] = {
    "silence": (b"", b""),
    "100 Continue": (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
    "103 Early Hints": (b"HTTP/1.1 100 Continue\r\n", b"Link: x\r\n"),
    "a status line": (b"", b"H"),
    "a header": (b"HTTP/1.1 200 OK\r\nX: ", b"x"),
    "headers": (b"HTTP/1.1 200 OK\r\n", b"X: x\r\n"),
    "a body": (b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\n\r\n", b" "),
    "a body without length": (b"HTTP/1.1 200 OK\r\n\r\n", b" "),
    "chunks": (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"1\r\n \r\n"),
    "trailers": (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n", b"X: x\r\n"),
    "the body of an error": (b"HTTP/1.1 500 Oops\r\nContent-Length: 1000000\r\n\r\n", b"x"),
}


@pytest.fixture
def drip() -> Iterator[Callable[[bytes, bytes], int]]:
    """Return a function that starts a server, which sends a text and then another one every 10 ms."""
    stopped = threading.Event()
    listeners = []

    def start(begin: bytes, again: bytes) -> int:
        listener = socket.create_server(("127.0.0.1", 0))
        listeners.append(listener)

        def serve(connection: socket.socket) -> None:
            try:
                connection.sendall(begin)
                while not stopped.wait(0.01):
                    connection.sendall(again)
            except OSError:
                pass
            connection.close()

        def accept() -> None:
            while True:
                try:
                    connection, _ = listener.accept()
                except OSError:
                    return
                threading.Thread(target=serve, args=(connection,), daemon=True).start()

        threading.Thread(target=accept, daemon=True).start()
        return int(listener.getsockname()[1])

    yield start
    stopped.set()
    for listener in listeners:
        listener.close()


def fails_soon(endpoint: Endpoint, message: str) -> None:
    begun = time.monotonic()
    with pytest.raises(ConnectionError, match=message):
        endpoint.reply([])
    assert time.monotonic() - begun < 5.0
    until = time.monotonic() + 3.0
    while any(thread.name == "request" for thread in threading.enumerate()):
        assert time.monotonic() < until, "a thread still reads"
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("scheme", "name"), [*(("http", name) for name in ENDLESS), ("https", "silence"), ("https", "a status line")]
)
def test_no_server_delays_an_attempt(name: str, scheme: str, drip: Callable[[bytes, bytes], int]) -> None:
    endpoint = Endpoint(f"{scheme}://127.0.0.1:{drip(*ENDLESS[name])}/v1", "stub", timeout=0.2, tries=2, pause=0.01)
    fails_soon(endpoint, "in 2 attempts: (no complete reply in 0.[12]|500 Oops|got more than 100 headers|.*SSL)")


def test_names_and_pauses_are_part_of_the_time(monkeypatch: pytest.MonkeyPatch, serve: Serve) -> None:
    ends = threading.Event()
    with monkeypatch.context() as patch:
        patch.setattr(socket, "getaddrinfo", lambda *arguments, **options: ends.wait(5) and [])
        begun = time.monotonic()
        with pytest.raises(ConnectionError, match="in 2 attempts: no complete reply in 0"):
            Endpoint("http://never.example/v1", "stub", timeout=0.2, tries=2, pause=0.01).reply([])
        assert time.monotonic() - begun < 4.0
        ends.set()
        time.sleep(0.05)
    for after in ("600", "1e9", "inf"):
        server = serve(lambda handler, *_, after=after: send(handler, 429, b"later", Retry_After=after))
        fails_soon(Endpoint(server.url, "stub", timeout=1, tries=3), "requests a pause of .* s, but .* are left")
    server = serve(lambda handler, *_: send(handler, 302, b"", Location=server.url))
    fails_soon(Endpoint(server.url, "stub", timeout=1, tries=3), "rejects the request: 302")


def test_long_replies_are_read_soon(serve: Serve, tmp_path: Path) -> None:
    begun = time.monotonic()
    long = "answer: " * 1_000_000
    assert read_letter(long) is None and read_letter(long + "C") == "C"
    assert read_rule("rule: " * 1_000_000, ["VS1"]) is None
    assert read_rule("Rule: x\n" * 1_000_000 + "Rule: VS1", ["VS1"]) == "VS1"
    for unit in (
        "answer ",
        "answer is\n",
        "<answer>",
        "<a",
        "rule ",
        "rule is ",
        "A",
        "**",
        "answer:(",
        "Answer: A or ",
    ):
        read_letter(unit * 200_000)
        read_rule(unit * 200_000, ["VS1", "VS2"])
    question = Question("a", "Decide.", (), "Scene?", {"A": "Slow", "B": "Normal", "C": "Fast", "D": "Stop"}, "B")
    assert grade([question], {"a": long + "B"}).overall.correct == 1
    server = serve(lambda handler, *_: say(handler, long))
    with pytest.raises(ConnectionError, match="the reply is longer than 4 MiB"):
        ask([question], Endpoint(server.url, "stub", "sesame", tries=1), tmp_path / "replies.jsonl")
    server = serve(lambda handler, *_: say(handler, "answer: " * 50_000 + "B"))
    assert ask([question], Endpoint(server.url, "stub", KEY), tmp_path / "replies.jsonl")["a"].endswith("B")
    assert time.monotonic() - begun < 20.0


def test_lines_without_end_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logicity.questions.LINE_BYTES", 1000)
    path = tmp_path / "answers.jsonl"
    path.write_text('{"id": "a", "answer": "A"}\n{"id": "b", "answer": "' + "B" * 2000)
    with pytest.raises(ValueError, match=r"answers\.jsonl:2: the line is longer"):
        load_answers(path)


def test_every_active_character_is_neutral() -> None:
    assert neutral("a\tb\nc\x1b[31m\u202e\x9b") == "a\tb\nc\\u001b[31m\\u202e\\u009b"
    assert neutral("a\nb", lines=False) == "a\\nb"
    everything = "".join(map(chr, range(0x11_0000)))
    shown = neutral(everything)
    assert not ACTIVE.search(shown)
    shown.encode()
    assert len(shown) - len(everything) == 5 * (sum(neutral(each) != each for each in map(chr, range(0x10_000))))


Run = Callable[..., str]


@pytest.fixture
def run(capfdbinary: pytest.CaptureFixture[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Return a function that runs a command, and checks that what it prints is neutral."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> str:
        try:
            code: object = main(arguments)
        except SystemExit as end:
            code = end.code
        printed = capfdbinary.readouterr()
        text = (printed.out + printed.err).decode()
        assert not ACTIVE.search(text) and "Traceback" not in text, text
        assert code in (0, 1, 2), text
        return text

    return call


@pytest.mark.parametrize("words", SUMMARIES, ids=" ".join)
def test_arguments_and_names_of_files_are_neutral(words: tuple[str, ...], run: Run, tmp_path: Path) -> None:
    """Each command, with a hostile option, and names that are missing, a folder, or files with hostile content."""
    name = HOSTILE.replace("/", "")
    (tmp_path / f"{name}.jsonl").write_text(json.dumps({"id": HOSTILE}) + "\n", encoding="utf-8")
    (tmp_path / f"{name}.yaml").write_text(f'"{HOSTILE!r}": 1\n"\\e[31m": 2\n', encoding="utf-8")
    (tmp_path / f"{name}.dl").write_text(f"{HOSTILE}(x) :- y.\n", encoding="utf-8")
    (tmp_path / name).mkdir()
    by_command: dict[tuple[str, ...], list[list[str]]] = {
        ("evaluate",): [["--policy", "{}"], ["--policy", "oracle", "--modes", "{}"]],
        ("policies",): [["--json", "{}"]],
        ("train",): [["{}"]],
        ("experiment",): [
            ["{}"],
            ["language", "--set", "{}=1"],
            ["language", "--only", "{}"],
            ["spf", "--list", "--only", "{}"],
        ],
        ("release",): [["{}-out", "--only", "{}"], ["{}-out", "--only", "policies", "--results", "{}"]],
        ("import-episodes",): [["{}", "--mode", "easy", "-o", "{}-out"], ["{}", "--mode", "{}", "-o", "{}-out"]],
        ("shards",): [["1", "--", "episodes", "make", "{}", "-o", "{}-out"], ["1", "--", "{}"]],
        ("ask",): [["--url", "http://{}", "--model", "{}", "-o", "{}", "--questions", "{}"]],
        ("grade",): [["{}"], [str(QUESTIONS), "--questions", "{}"]],
        ("study",): [["{}"], ["{}", "-o", "{}.html", "--answers", "{}.csv"]],
        ("describe",): [[]],
        ("vap", "webdataset"): [["{}", "{}-out"]],
        ("vap", "coco"): [["{}", "{}-out"]],
        ("vap", "baselines"): [["--train", "{}", "--test", "{}"]],
        ("vap", "features"): [["{}"]],
        ("distill",): [["{}", "-o", "{}-out"], ["{}", "--map", "{}", "--columns", "{}", "-o", "{}-out"]],
        ("map", "export"): [["{}", "-o", "{}.net.xml"]],
    }
    options = by_command[words]
    commands = [[*words, f"--{name}"], [*words, *options[0], name]]
    endings = ("", ".jsonl", ".yaml", ".dl") if options[0] else ("",)
    commands += [
        [*words, *(each.replace("{}", name + end) for each in option)] for option in options for end in endings
    ]
    commands += [[*words, *(each.replace("{}", f"missing{name}") for each in options[-1])]]
    for command in commands:
        run(*command)


def test_ids_and_answers_are_neutral(run: Run, tmp_path: Path) -> None:
    first = json.loads(QUESTIONS.read_text(encoding="utf-8").splitlines()[0])
    questions, answers = tmp_path / "questions.jsonl", tmp_path / "answers.jsonl"
    other = {**first, "id": f"{HOSTILE}\nerror: other"}
    questions.write_text("".join(json.dumps(each) + "\n" for each in ({**first, "id": HOSTILE}, other)))
    answers.write_text(json.dumps({"id": HOSTILE, "answer": HOSTILE}) + "\n" + '{"id": "\\u009b", "answer": "A"}\n')
    shown = run("grade", str(answers), "--questions", str(questions))
    assert "\\u009b" in shown and "\nerror: other" not in shown
    answers.write_text((json.dumps({"id": HOSTILE, "model": HOSTILE, "answer": "A"}) + "\n") * 2)
    run("grade", str(answers), "--questions", str(questions))
    arguments = ["--url", "http://127.0.0.1:1", "-o", str(answers), "--questions", str(questions)]
    run("ask", *arguments, "--model", HOSTILE)
    run("ask", *arguments, "--model", "stub")


def test_experiments_keep_the_key(serve: Serve, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In lines of progress, tables, figures and stored replies, also after a failure."""
    needs("torch", "learn")
    monkeypatch.setenv("CITY_KEY", KEY)
    echo = f"{HOSTILE} {KEY} {percent(KEY)}"
    acts = {
        "answers": lambda handler, *_: say(handler, f"{echo}\nAnswer: B"),
        "rejects": lambda handler, *_: send(handler, 401, echo.encode()),
        "fails": lambda handler, *_: send(handler, 500, echo.encode()),
    }
    spec = {"model": "stub", "key_from": "CITY_KEY", "settings": {"api_key": KEY}, "tries": 2, "timeout": 5}
    rows = {name: {"changes": {"endpoint": {**spec, "url": serve(act).url}}} for name, act in acts.items()}
    changes = [f"learners={json.dumps(rows)}", "count=4", "shots=4"]
    options = [word for change in changes for word in ("--set", change)]
    options += [word for name in rows for word in ("--only", f"{name},examples")]
    text = run("experiment", "language", "--quick", "--run", "run", "--jobs", "3", *options)
    assert "401" in text and "500" in text and "next attempt in 1 s" in text
    written = [path for path in (tmp_path / "run").rglob("*") if path.is_file() and path.suffix not in (".png", ".svg")]
    assert {path.name for path in written} > {"table.md", "table.tex", "table.json"}
    for path in written:
        content = path.read_text(encoding="utf-8")
        assert not contains_key(content) and not ACTIVE.search(content), path
    assert not contains_key(text)
    # The key instead of the name of its variable.
    text = run(
        "experiment",
        "language",
        "--run",
        "other",
        *options,
        *["--set", f"learners.fails.changes.endpoint.key_from={json.dumps(KEY)}"],
    )
    assert "is not set" in text and not contains_key(text)


def test_programs_beside_training_stay_in_bounds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """They flood their outputs, never end, or leave processes that hold a pipe."""
    needs("torch", "learn")
    from logicity.learn import programs

    monkeypatch.setattr(programs, "OUTPUT_BYTES", 1000)
    monkeypatch.setattr(programs, "DRAIN", 0.2)
    cases = {
        "yes; echo": None,
        "yes >&2": None,
        "sleep 60": None,
        "head -c 100000 /dev/zero; head -c 100000 /dev/zero >&2; echo end": "end",
        "sleep 60 & echo end": "end",
        "setsid sleep 5 & echo end": "end",
        "exec >&- 2>&-; sleep 0.3": "",
    }
    for code, ends in cases.items():
        begun = time.monotonic()
        ended, output, log = programs.run_program(["sh", "-c", code], 1.0)
        assert ended == (None if ends is None else 0), code
        assert output.rstrip().endswith(ends or "") and len(output) <= 70_000 and len(log) <= 70_000, code
        assert time.monotonic() - begun < 5.0, code
    marker = str(tmp_path / "alive")
    programs.run_program(["sh", "-c", f"(sleep 0.5; touch {marker}) & exit 0"], 1.0)
    time.sleep(0.8)
    assert not Path(marker).exists()


def test_only_one_module_prints() -> None:
    """Other modules call its functions, which no text of others can get around."""
    package = ROOT / "python" / "logicity"
    found = {
        f"{path.relative_to(package)}: {line.strip()}"
        for path in package.rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(r"(?<![\w.])print\(|sys\.std(out|err)\.write|print_exc\(", line)
    }
    allowed = (
        "evaluation.py: print(",
        "terminal.py: print(neutral(",
        "experiments/cells.py: print(json",
    )
    assert not [each for each in found if not each.startswith(allowed)]
