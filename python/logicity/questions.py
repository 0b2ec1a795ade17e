"""Multiple-choice questions for language models: query a model over HTTP, parse its replies, and grade them.

`logicity questions` generates the questions. `ask` sends them to a chat endpoint and stores the replies. `grade`
compares replies from any source with the actions that the rules derive, and the rules that replies name with the
clauses that derive these actions.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import time
import urllib.parse
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from .city import ACTIONS
from .errors import checked_path
from .evaluation import Interval
from .files import check_readable, reserved
from .redaction import Redactor, shown_url
from .terminal import aligned, neutral
from .transport import RequestError, post

__all__ = [
    "Calibration",
    "Demonstration",
    "Endpoint",
    "Grade",
    "Question",
    "Recall",
    "Reply",
    "ask",
    "calibrate",
    "fingerprint",
    "grade",
    "load_answers",
    "load_logprobs",
    "load_questions",
    "read_letter",
    "read_rule",
]

LETTERS = "ABCD"
OPTIONS = tuple(zip(LETTERS, ACTIONS, strict=True))
UNREAD, MISSING = "unread", "missing"
#: The name in place of a rule, for an action that no rule requires.
NO_RULE = "none"
#: The versions of files of questions. Version 1 has no clauses, and no scenes of demonstrations. Only version 3 has
#: pictures and the layout of the paper.
VERSIONS = (1, 2, 3)
#: The largest response, in bytes: more text than a model writes. With log-probabilities, each token needs some kB.
RESPONSE_BYTES = 4 << 20
RESPONSE_BYTES_WITH_LOGPROBS = 32 << 20
#: The number of characters of a server's text that a message shows.
SHOWN = 300
#: The largest line of a file of questions or answers, in bytes.
LINE_BYTES = 64 << 20
#: The largest picture, in bytes, and how its file begins.
PICTURE_BYTES = 16 << 20
PNG = b"\x89PNG\r\n\x1a\n"
#: The largest timeout of a request, in seconds: a day.
TIMEOUT_MAX = 86_400.0

#: Waits before another attempt of a request. Receives the delay in seconds, and why the last attempt failed.
Wait = Callable[[float, str], None]


@dataclass(frozen=True)
class Demonstration:
    """A solved example.

    Attributes:
        text: The question.
        answer: The letter of the correct action.
        clauses: The labels of the clauses that derive the action, in source order; `None` in a file of version 1.
        scene: The facts, as `infer` takes them; `None` in a file of version 1.
        picture: The file with the picture of the scene, if the questions have pictures.
    """

    text: str
    answer: str
    clauses: tuple[str, ...] | None = None
    scene: Mapping[str, Any] | None = None
    picture: Path | None = None


@dataclass(frozen=True)
class Question:
    """A question from the output of `logicity questions`.

    `text`, `answer`, `clauses` and `picture` are as for `Demonstration`, and so is `scene`, which is `None` if the file
    has none.

    Attributes:
        id: The unique name of the question.
        system: The system message: the instructions.
        demonstrations: The few-shot examples.
        options: The actions by letter.
        labels: The labels of all rules of actions, if the question requests a rule; otherwise empty.
        source: The configuration, the rules and the decision behind the question.
        closing: What the paper's prompt says between examples and question. `None` unless the question has its layout.
    """

    id: str
    system: str
    demonstrations: tuple[Demonstration, ...]
    text: str
    options: Mapping[str, str]
    answer: str
    clauses: tuple[str, ...] | None = None
    labels: tuple[str, ...] = ()
    scene: Mapping[str, Any] | None = None
    source: Mapping[str, Any] = field(default_factory=dict)
    picture: Path | None = None
    closing: str | None = None

    def messages(self) -> list[dict[str, Any]]:
        """Return the messages for a chat model: the instructions, then the examples and the question.

        A question with a picture has content parts: texts, and pictures as PNG in data URLs. In the layout of the paper
        everything is one message.

        Raises:
            OSError: If a picture cannot be read.
            ValueError: If the file of a picture is not PNG, or too large.
        """
        if self.closing is not None:
            line = "Option: " + " ".join(f"({letter}) {action}" for letter, action in self.options.items())
            examples = [f'Question: "{each.text}"\n{line}\nAnswer: {each.answer}' for each in self.demonstrations]
            prompt = [self.system, *examples, self.closing, f'Question: "{self.text}"\n{line}']
            return [{"role": "user", "content": "\n\n".join(prompt)}]
        options = "\n".join(f"({letter}) {action}" for letter, action in self.options.items())
        parts: list[tuple[str, Demonstration | Question, str]] = [
            (f"Example {number}", shown, f"\n{self.reply(shown.answer, shown.clauses or ())}")
            for number, shown in enumerate(self.demonstrations, 1)
        ]
        parts.append(("Question", self, ""))
        content: Any = "\n\n".join(f"{head}\n{each.text}\n{options}{end}" for head, each, end in parts)
        if any(each.picture is not None for _, each, _ in parts):
            content = []
            for head, each, end in parts:
                picture = [] if each.picture is None else [("image_url", {"url": _data_url(each.picture)})]
                pieces = [("text", f"{head}\n"), *picture, ("text", f"{each.text}\n{options}{end}\n\n")]
                content += ({"type": kind, kind: value} for kind, value in pieces)
        return [{"role": "system", "content": self.system}, {"role": "user", "content": content}]

    def reply(self, answer: str, clauses: Sequence[str] = ()) -> str:
        """Return a reply in the form that the instructions request: the first of the clauses, and a letter."""
        rule = f"Rule: {clauses[0] if clauses else NO_RULE}\n" if self.labels else ""
        return f"{rule}Answer: {answer}"


def picture_bytes(path: Path) -> bytes:
    """Return the content of the picture of a question.

    Raises:
        OSError: If it cannot be read.
        ValueError: If it is not PNG, or too large.
    """
    check_readable(path)
    with open(path, "rb") as file:
        data = file.read(PICTURE_BYTES + 1)
    if not data.startswith(PNG) or len(data) > PICTURE_BYTES:
        raise ValueError(f"{path}: expected a PNG picture of at most {PICTURE_BYTES >> 20} MiB")
    return data


def _data_url(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture_bytes(path)).decode()}"


def fingerprint(scene: Mapping[str, Any]) -> str:
    """Return a hash of a scene that does not depend on the names and the order of its entities.

    Method: color refinement (1-dimensional Weisfeiler-Leman). Each entity has a class, at first only whether it is the
    ego. A round divides the classes by the facts about their entities and the classes of the others in these facts.
    Different scenes that refinement cannot tell apart have the same hash.
    """
    classes = {entity: str(entity == scene["ego"]) for entity in scene["entities"]}
    while True:
        known = len(set(classes.values()))
        signs: dict[str, list[tuple[str, int, tuple[str, ...]]]] = {entity: [] for entity in classes}
        for predicate, arguments in facts_of(scene):
            others = tuple(classes[entity] for entity in arguments)
            for place, entity in enumerate(arguments):
                signs[entity].append((predicate, place, others))
        classes = {entity: _hash([classes[entity], sorted(signs[entity])]) for entity in classes}
        if len(set(classes.values())) == known:
            return _hash(sorted(classes.values()))


def facts_of(scene: Mapping[str, Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the predicate and the arguments of each fact of a scene."""
    for predicate, rows in scene["facts"].items():
        for row in rows:
            yield predicate, (row,) if isinstance(row, str) else tuple(row)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()[:16]


def _lines(path: str | os.PathLike[str]) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield the objects of a JSON Lines file, each with its location."""
    name = checked_path("path", path)
    check_readable(name, whole=False, named=True)
    with open(name, "rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(LINE_BYTES), b""), 1):
            if not line.strip():
                continue
            place = f"{name}:{number}"
            if len(line) == LINE_BYTES:
                raise ValueError(f"{place}: the line is longer than {LINE_BYTES >> 20} MiB")
            try:
                value = json.loads(line.decode())
            except (ValueError, RecursionError) as error:
                raise ValueError(f"{place}: not JSON: {error}") from None
            if not isinstance(value, dict) or not isinstance(value.get("id"), str):
                raise ValueError(f"{place}: expected an object with a string `id`")
            yield place, value


def load_questions(path: str | os.PathLike[str]) -> list[Question]:
    """Read a file of questions.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not an output of `logicity questions`. The message names the line.
    """
    questions: dict[str, Question] = {}
    folder = Path(checked_path("path", path)).parent
    for place, line in _lines(path):
        if line.get("version", 1) not in VERSIONS:
            raise ValueError(
                f"{place}: questions of version {line['version']}; this program reads the versions "
                f"{VERSIONS[0]} to {VERSIONS[-1]}: write them again with `logicity questions`"
            )
        try:
            question = Question(
                id=line["id"],
                system=_text(line, "system"),
                demonstrations=tuple(Demonstration(**_solved(shown, folder)) for shown in line["demonstrations"]),
                options=dict(line["options"]),
                labels=_labels(line, "labels") or (),
                source=line.get("source", {}),
                closing=_text(line, "closing") if "closing" in line else None,
                **_solved(line, folder),
            )
        except (KeyError, TypeError, ValueError) as error:
            what = f"the key {error} is missing" if isinstance(error, KeyError) else str(error)
            raise ValueError(f"{place}: not a question of `logicity questions`: {what}") from None
        if tuple(question.options.items()) != OPTIONS:
            raise ValueError(f"{place}: the options are not {', '.join(ACTIONS)}")
        if question.answer not in question.options:
            raise ValueError(f"{place}: the answer {question.answer!r} is not an option")
        if question.id in questions:
            raise ValueError(f"{place}: duplicate id {question.id!r}")
        questions[question.id] = question
    if not questions:
        raise ValueError(f"{os.fspath(path)} has no questions")
    return list(questions.values())


def _solved(line: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return what a question and an example in a file of a folder have in common."""
    return {
        "text": _text(line, "question"),
        "answer": _text(line, "answer"),
        "clauses": _labels(line, "clauses"),
        "scene": line.get("scene"),
        "picture": _picture(line, folder),
    }


def _picture(line: Mapping[str, Any], folder: Path) -> Path | None:
    """Return the path of a picture. A file of others must not name any file, since its content goes to a server."""
    if "picture" not in line:
        return None
    name = _text(line, "picture")
    if not re.fullmatch(r"(?!\.\./)[^/\\\0]+/[^/\\\0]+\.png", name):
        raise ValueError(f"`picture` is not a PNG file in a folder beside the file: {name!r}")
    return folder / name


def _text(line: Mapping[str, Any], key: str) -> str:
    if not isinstance(line[key], str):
        raise TypeError(f"`{key}` is not text")
    return str(line[key])


def _labels(line: Mapping[str, Any], key: str) -> tuple[str, ...] | None:
    labels = line.get(key)
    if labels is not None and not (isinstance(labels, list) and all(isinstance(label, str) for label in labels)):
        raise TypeError(f"`{key}` is not a list of texts")
    return None if labels is None else tuple(labels)


def load_answers(path: str | os.PathLike[str]) -> dict[str, str]:
    """Read a file with one `{"id": .., "answer": ..}` per line, and return the answers by id.

    An answer is a letter or any text.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If a line is invalid, or an id is repeated. The message names the line.
    """
    answers: dict[str, str] = {}
    for place, line in _lines(path):
        if "options" in line:
            raise ValueError(f"{place}: expected an answer, found a question of `logicity questions`")
        if not isinstance(line.get("answer"), str):
            raise ValueError(f"{place}: expected a string `answer`")
        if line["id"] in answers:
            raise ValueError(f"{place}: second answer to the question {line['id']!r}")
        answers[line["id"]] = line["answer"]
    return answers


def load_logprobs(path: str | os.PathLike[str]) -> dict[str, dict[str, float]]:
    """Return the log-probabilities of the options by the ids of the replies that have them.

    The file is an output of `ask`. Options without a log-probability are missing.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If a line is invalid. The message names the line.
    """
    found: dict[str, dict[str, float]] = {}
    for place, line in _lines(path):
        if (values := line.get("logprobs")) is None:
            continue
        if not isinstance(values, dict) or not all(
            letter in LETTERS and isinstance(value, (int, float)) and -math.inf < value <= 0
            for letter, value in values.items()
        ):
            raise ValueError(f"{place}: `logprobs` is not a mapping from letters to finite numbers of at most 0")
        found[line["id"]] = {letter: float(value) for letter, value in values.items()}
    return found


_NAMES = "|".join(ACTIONS)
# Markup of emphasis, code and TeX.
_MARKUP = re.compile(r"\\boxed|\\text|[*_`${}\"']")
_MARKER = re.compile(r"\banswer\b(?:\s+(?:is|would\s+be|should\s+be))?\s*[:=-]?\s*(?:option\s+)?", flags=re.IGNORECASE)
# Groups: a letter, or nothing if a name follows; a separator; an optional name; the rest.
_OPTION = re.compile(
    rf"[(\[]?\s*(?:([A-D])\b\s*[)\]]?|(?=(?:{_NAMES})\b))([\s.:)\-–—]*)((?:{_NAMES})\b)?(.*)", flags=re.IGNORECASE
)
_ALTERNATIVE = re.compile(r"\s*(?:(?:,|/|&|\bor\b|\band\b)\s*\(?[A-D]\b|[A-D]\W*$)", flags=re.IGNORECASE)
#: The number of characters at the end of a reply in which its answer is read.
TAIL = 100_000
#: The number of characters after "answer" in which an option is read, so that long replies are read in linear time.
_REACH = 1000
# Anything else cannot begin an option, such as the next "answer".
_BEGINNING = re.compile(rf"\s*[(\[]?\s*(?:[A-D]\b|(?:{_NAMES})\b)", flags=re.IGNORECASE)
_REMARK = re.compile(r"\s*(?:$|[.,;:!)\]]|\(|because\b|since\b)", flags=re.IGNORECASE)


def read_letter(reply: str) -> str | None:
    """Read the option that a reply chooses: `"A"` to `"D"`, or `None` if it chooses no option or several.

    The option after the last "answer:" or "answer is" counts. Otherwise the last line counts if it is only an option.
    Only the last 100,000 characters are read.
    """
    text = _plain(reply)
    for marker in reversed(list(_MARKER.finditer(text))):
        if _BEGINNING.match(text, marker.end()):
            line = text[marker.end() : marker.end() + _REACH].lstrip().split("\n", 1)[0]
            if letter := _option(line):
                return letter
    lines = [line for line in text.splitlines() if line.strip()]
    return _option(lines[-1]) if lines else None


def _plain(reply: str) -> str:
    text = re.sub(r"<(\w+)>", r"\1: ", re.sub(r"</\w+>", "\n", reply[-TAIL:]))
    return _MARKUP.sub("", text)


def _option(text: str) -> str | None:
    """Return the letter of the option at the start of a text: a letter, a name or both, then the end or a remark."""
    if (found := _OPTION.match(text.strip())) is None:
        return None
    letter, gap, name, rest = found.groups()
    named = _chosen(name) if name else None
    if (letter and named and letter.upper() != named) or _ALTERNATIVE.match(rest):
        return None
    # "A car" and "Stop signs" are the start of a sentence, but "B. The car" is an option and a remark.
    separated = name is None and any(mark in gap for mark in ".:)-–—")
    if not separated and not _REMARK.match(rest):
        return None
    return letter.upper() if letter else named


_RULE = re.compile(r"\brule\b(?:\s+is)?\s*[:=]\s*([^\n]*)", flags=re.IGNORECASE)


def read_rule(reply: str, labels: Sequence[str]) -> str | None:
    """Read the rule that a reply names after its last "Rule:". Remarks may follow the name.

    The result is one of the labels, or `"none"`, or `None` if the reply names no rule or several. Only the last 100,000
    characters are read.
    """
    # Labels may contain characters of markup.
    known = {_MARKUP.sub("", label).casefold(): label for label in [*labels, NO_RULE]}
    names = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    first = re.compile(rf"[(\[\s]*({names})(?!\w)(.*)", flags=re.IGNORECASE)
    another = re.compile(rf"\s*(?:,|/|&|\bor\b|\band\b)\s*\(?(?:{names})(?!\w)", flags=re.IGNORECASE)
    for line in reversed(_RULE.findall(_plain(reply))):
        if found := first.match(line):
            return None if another.match(found[2]) else known[found[1].casefold()]
    return None


@dataclass(frozen=True)
class Recall:
    """The number of correct answers out of `total`, and their share with its confidence interval."""

    correct: int
    total: int
    accuracy: Interval

    @classmethod
    def of(cls, correct: int, total: int) -> Recall:
        """Compute the share and its 95 % Wilson score interval (1927). For a total of 0, they are 0 and [0, 1]."""
        return cls(correct, total, Interval.of_share(correct, total))


@dataclass(frozen=True)
class Calibration:
    """How well the probabilities of the options agree with the correct answers.

    Attributes:
        count: The number of replies with log-probabilities, to which the measures refer.
        ece: The expected calibration error, from 0 to 1. Replies are sorted into ten bins of equal width by the
            probability of their most probable option. The error is the mean over the replies of the absolute difference
            between the mean of these probabilities and the accuracy in their bin (Naeini et al., 2015; Guo et al.,
            2017).
        brier: The Brier score, from 0 to 2: the mean of the squared distance between the probabilities of the options
            and the indicator of the correct one (Brier, 1950). 0.75 for uniform probabilities over four options.
    """

    count: int
    ece: float
    brier: float


#: The number of bins of the expected calibration error.
BINS = 10


def calibrate(questions: Sequence[Question], logprobs: Mapping[str, Mapping[str, float]]) -> Calibration | None:
    """Measure the calibration of the replies with log-probabilities.

    The probabilities of the options are normalized to a sum of 1. An option without a log-probability has probability
    0. The result of `load_logprobs` has them by question and letter. If there are none, the calibration is `None`.
    """
    asked = [question for question in questions if logprobs.get(question.id)]
    if not asked:
        return None
    values = np.array([[logprobs[each.id].get(letter, -np.inf) for letter in LETTERS] for each in asked])
    shares = np.exp(values - values.max(1, keepdims=True))
    shares /= shares.sum(1, keepdims=True)
    right = np.array([[letter == each.answer for letter in LETTERS] for each in asked])
    highest, best = shares.max(1), np.eye(len(LETTERS), dtype=bool)[shares.argmax(1)]
    bins = np.minimum((highest * BINS).astype(np.int64), BINS - 1)
    gaps = np.abs(np.bincount(bins, highest - right[best], BINS))
    return Calibration(len(asked), float(gaps.sum() / len(asked)), float(((shares - right) ** 2).sum(1).mean()))


@dataclass(frozen=True)
class Grade:
    """The result of grading.

    Attributes:
        overall: Recall over all questions. Missing and unreadable answers count as wrong.
        by_action: Recall by correct action, for the actions that occur.
        confusion: The confusion matrix: by correct letter, the counts of the chosen letters, of `"unread"` replies that
            choose no option, and of `"missing"` replies.
        missing: The ids of questions without a reply.
        unread: The ids of questions whose reply chooses no option or several.
        unknown: The ids of answers without a question.
        rules: The share of replies that name a rule that derives the correct action, or `none` if no rule does. `None`
            if the questions request no rule.
        both: The share of replies with the correct action and such a rule. `None` if the questions request no rule.
        named: The number of replies that name a rule or `none`.
        calibration: The calibration, if replies have log-probabilities.
    """

    overall: Recall
    by_action: Mapping[str, Recall]
    confusion: Mapping[str, Mapping[str, int]]
    missing: tuple[str, ...]
    unread: tuple[str, ...]
    unknown: tuple[str, ...]
    rules: Recall | None = None
    both: Recall | None = None
    named: int = 0
    calibration: Calibration | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        """Format the accuracies and the confusion matrix as a text table."""
        columns = [*LETTERS, UNREAD, MISSING]
        head = ["correct answer", "questions", "accuracy", *columns]
        rows = [
            [f"{letter} {action}", str(recall.total), str(recall.accuracy)]
            + [str(self.confusion[letter][column]) for column in columns]
            for letter, action in OPTIONS
            if (recall := self.by_action.get(action)) is not None
        ]
        chosen = [str(sum(row[column] for row in self.confusion.values())) for column in columns]
        rows.append(["all", str(self.overall.total), str(self.overall.accuracy), *chosen])
        lines = [aligned([head, *rows])]
        if self.rules is not None and self.both is not None:
            lines.append(f"rule correct: {self.rules.accuracy}; action and rule correct: {self.both.accuracy}")
        if self.calibration is not None:
            ece, brier, count = self.calibration.ece, self.calibration.brier, self.calibration.count
            lines.append(f"expected calibration error {ece:.3f}, Brier score {brier:.3f}, of {count} replies")
        return "\n".join(lines)


def grade(
    questions: Sequence[Question],
    answers: Mapping[str, str],
    logprobs: Mapping[str, Mapping[str, float]] | None = None,
) -> Grade:
    """Grade answers, which are letters or whole replies, by the ids of their questions.

    Either all questions request a rule or none. `load_logprobs` returns the log-probabilities.
    """
    confusion = {letter: dict.fromkeys([*LETTERS, UNREAD, MISSING], 0) for letter in LETTERS}
    chosen = {each.id: read_letter(answers[each.id]) or UNREAD if each.id in answers else MISSING for each in questions}
    for question in questions:
        confusion[question.answer][chosen[question.id]] += 1
    totals = Counter(question.answer for question in questions)
    why = [question for question in questions if question.labels]
    named = {question.id: read_rule(answers.get(question.id, ""), question.labels) for question in why}
    derived = [question for question in why if named[question.id] in (question.clauses or (NO_RULE,))]
    both = [question for question in derived if chosen[question.id] == question.answer]
    return Grade(
        overall=Recall.of(sum(confusion[letter][letter] for letter in LETTERS), len(questions)),
        by_action={
            action: Recall.of(confusion[letter][letter], totals[letter]) for letter, action in OPTIONS if totals[letter]
        },
        confusion={letter: row for letter, row in confusion.items() if totals[letter]},
        missing=tuple(name for name, letter in chosen.items() if letter == MISSING),
        unread=tuple(name for name, letter in chosen.items() if letter == UNREAD),
        unknown=tuple(name for name in answers if name not in chosen),
        rules=Recall.of(len(derived), len(why)) if why else None,
        both=Recall.of(len(both), len(why)) if why else None,
        named=sum(label is not None for label in named.values()),
        calibration=calibrate(questions, logprobs or {}),
    )


@dataclass(frozen=True)
class Reply:
    """A reply of a model.

    Attributes:
        text: The text; empty if the reply has none.
        logprobs: The log-probabilities of the options by letter, at the token with the letter or name of the chosen
            option; `None` if the server returns none, or the reply chooses no option. Options outside the most
            probable tokens that the server lists are missing.
    """

    text: str
    logprobs: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Endpoint:
    """A chat endpoint with an OpenAI-compatible interface.

    Args:
        url: The base URL, such as `http://localhost:8000/v1`. `/chat/completions` is appended to its path if it is
            missing.
        model: The name of the model on the server.
        key: The bearer token, if the server requires one.
        settings: More fields of the request, such as a temperature. `{"logprobs": true, "top_logprobs": 20}` requests
            log-probabilities.
        timeout: The time for an attempt, in seconds, at most a day: from the name of the server to the end of the
            reply.
        tries: The number of attempts.
        pause: The delay before the second attempt, in seconds. It doubles for each later attempt, up to 60 seconds,
            unless the server requests another delay. A question fails if the delay that the server requests exceeds
            what is left of the time for all attempts and their delays.

    Raises:
        ValueError: If the URL is invalid, not http or https, or contains a password, the key has invalid characters,
            `settings` is not JSON or contains `model`, `messages` or `stream`, or a number is out of range.
    """

    url: str
    model: str
    key: str | None = field(default=None, repr=False)
    settings: Mapping[str, Any] | None = field(default=None, repr=False)
    timeout: float = 120.0
    tries: int = 6
    pause: float = 1.0

    def __post_init__(self) -> None:
        """Check the arguments."""
        # The messages must not reveal a password.
        if "@" in self.url.partition("//")[2].partition("/")[0]:
            raise ValueError("the URL contains a user name or password: send the key as a bearer token instead")
        shown = shown_url(self.url)
        try:
            parts = urllib.parse.urlsplit(self.url)
            host, _ = (parts.hostname or "").encode("idna"), parts.port
        except ValueError:
            host = b""
        if not host or parts.scheme not in ("http", "https"):
            found = "" if "@" in self.url else f", not `{shown}`"
            raise ValueError(f"expected a URL of http or https, such as http://localhost:8000/v1{found}")
        if not re.fullmatch(r"[\x21-\x7e]+", self.url):
            raise ValueError(f"the URL `{shown}` has characters other than printable ASCII: percent-encode them")
        # The message must not reveal the key.
        if self.key is not None and not re.fullmatch(r"[\x21-\x7e]+", self.key):
            raise ValueError("the key is empty, or has characters other than printable ASCII")
        if set(self.settings or ()) & {"model", "messages", "stream"}:
            raise ValueError("`settings` must not contain `model`, `messages` or `stream`")
        try:
            json.dumps(dict(self.settings or {}), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"`settings` is not JSON: {error}") from None
        if not 0 < self.timeout <= TIMEOUT_MAX:
            raise ValueError(f"`timeout` must be positive and at most {TIMEOUT_MAX:,.0f} seconds, not {self.timeout}")
        if not (self.tries >= 1 and 0 <= self.pause < math.inf):
            raise ValueError("`tries` must be positive, and `pause` must be finite and not negative")

    def reply(self, messages: list[dict[str, Any]], wait: Wait = lambda seconds, reason: time.sleep(seconds)) -> Reply:
        """Send messages, such as `Question.messages`, and return the reply of the model.

        Raises:
            ConnectionError: If the server rejects the request, or every attempt fails.
        """
        redact = Redactor(self.key, self.url, self.settings or {}, "\n".join(_texts(messages)))
        # Later delays are equal.
        delays = [min(self.pause * 2.0**before, 60.0) for before in range(61)]
        all_delays = sum(delays[: self.tries - 1]) + max(self.tries - 62, 0) * delays[-1]
        shown, end = shown_url(self.url), time.monotonic() + self.tries * self.timeout + all_delays
        for attempt in range(1, self.tries + 1):
            try:
                reply = self._once(messages, max(min(self.timeout, end - time.monotonic()), 0.001))
                return Reply(redact(reply.text), reply.logprobs)
            except RequestError as error:
                reason, requested, retry = _shown(error, redact), error.wait, error.retry
            if not retry:
                raise ConnectionError(f"{shown} rejects the request: {reason}")
            if attempt == self.tries:
                raise ConnectionError(f"no reply from {shown} in {attempt} attempts: {reason}")
            left = end - time.monotonic()
            if requested is not None and requested > left:
                raise ConnectionError(
                    f"no reply from {shown} in {attempt} attempts: {reason}; the server requests a pause of "
                    f"{requested:.0f} s, but {max(left, 0):.0f} s are left for this question: try again later, or "
                    "raise the number of attempts or their timeout"
                )
            wait(delays[min(attempt, 61) - 1] if requested is None else requested, reason)
        raise AssertionError("`tries` is at least 1")

    def _once(self, messages: list[dict[str, Any]], seconds: float) -> Reply:
        """Send a request, and return the reply of the model as it is. The exceptions are those of `post`."""
        parts = urllib.parse.urlsplit(self.url)
        path = parts.path.rstrip("/").removesuffix("/chat/completions") + "/chat/completions"
        url = urllib.parse.urlunsplit(parts._replace(path=path, fragment=""))
        settings = dict(self.settings or {})
        request_body = json.dumps({"model": self.model, "messages": messages, **settings}).encode()
        headers = {"Content-Type": "application/json", "Accept": "application/json"}
        headers |= {} if self.key is None else {"Authorization": f"Bearer {self.key}"}
        most = RESPONSE_BYTES_WITH_LOGPROBS if settings.get("logprobs") else RESPONSE_BYTES
        text = post(url, request_body, headers, seconds, most)
        try:
            choice = json.loads(text)["choices"][0]
            content = choice["message"].get("content")
            if not isinstance(content, str | None):
                raise TypeError
        except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError):
            beginning = text[: 1 << 16].decode(errors="replace")
            raise RequestError(f"not a reply of a chat endpoint: {beginning}") from None
        return Reply(content or "", _option_logprobs(content or "", choice.get("logprobs")))


def _texts(messages: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    """Yield the texts of messages, without pictures."""
    for each in messages:
        content = each["content"]
        yield from [content] if isinstance(content, str) else [part["text"] for part in content if "text" in part]


def _shown(error: Exception, redact: Redactor) -> str:
    """Return the text of a server for a message: one line without secrets, of bounded length."""
    text = " ".join(redact(str(error)).split())
    return neutral(text if len(text) <= SHOWN else f"{text[:SHOWN]} ...")


def _option_logprobs(reply: str, logprobs: Any) -> dict[str, float] | None:
    """Return the log-probabilities of the options at the token of the chosen option.

    In the field `logprobs`, `content` lists the tokens, each with `token`, `logprob` and `top_logprobs`, the most
    probable tokens in its place.
    """
    if (letter := read_letter(reply)) is None:
        return None
    try:
        tokens = [(str(token["token"]), token) for token in logprobs["content"]]
        ends = accumulate(len(token) for token, _ in tokens)
        chosen = [(end, values) for end, (token, values) in zip(ends, tokens, strict=True) if _chosen(token) == letter]
        # The token after the last "answer:", or in the last line.
        text = "".join(token for token, _ in tokens)
        starts = {text.rstrip().rfind("\n") + 1, *(found.end() for found in _MARKER.finditer(text))}
        for start in sorted(starts, reverse=True):
            at = bisect_right(chosen, start, key=lambda each: each[0])
            if at < len(chosen):
                values = chosen[at][1]
                return _by_letter([values, *values.get("top_logprobs", [])])
    except (KeyError, TypeError, ValueError, AttributeError):
        # Servers differ in this field. A reply without log-probabilities is still a reply.
        pass
    return None


def _chosen(token: str) -> str | None:
    """Return the option that a token names alone, by its letter or its action."""
    name = token.strip(" \t\r\n()[]{}*_`$.,:;\"'").casefold()
    return next((letter for letter, action in OPTIONS if name in (letter.casefold(), action.casefold())), None)


def _by_letter(tokens: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Add the probabilities of the different tokens that name the same option."""
    shares: dict[str, dict[str, float]] = {}
    for each in tokens:
        letter, value = _chosen(str(each["token"])), float(each["logprob"])
        if letter is not None and math.isfinite(value):
            # The chosen token is also among the most probable ones.
            shares.setdefault(letter, {})[str(each["token"])] = math.exp(min(value, 0.0))
    return {letter: min(0.0, math.log(total)) for letter in LETTERS if (total := sum(shares.get(letter, {}).values()))}


def ask(
    questions: Sequence[Question],
    endpoint: Endpoint,
    path: str | os.PathLike[str],
    watch: Callable[[int], None] = lambda answered: None,
    wait: Wait = lambda seconds, reason: time.sleep(seconds),
) -> dict[str, str]:
    """Send every question that has no reply in a file to an endpoint, append each reply, and return all by id.

    Each line of the file is `{"id": .., "model": .., "answer": ..}`, and `"logprobs": {LETTER: ..}` if the endpoint
    returns log-probabilities. After an interruption, the next call resumes.

    `watch` receives the number of answered questions at the start and after each reply. `wait` waits before another
    attempt of a request.

    Raises:
        ConnectionError: As for `Endpoint.reply`. The file keeps the earlier replies.
        OSError: If the file cannot be read or written, another process writes it, or a picture cannot be read.
        ValueError: If the file has answers to other questions or from another model, or other content, or a picture is
            not PNG.
    """
    known = {question.id for question in questions}
    # The reservation keeps other processes from the file; it writes nothing.
    with reserved(path, by=None), _without_torn_line(Path(path)).open("a", encoding="utf-8", newline="\n") as file:
        for place, line in _lines(path):
            name, model = line["id"], line.get("model")
            if name not in known or model != endpoint.model:
                unknown = f"belongs to the unknown question {name!r}"
                origin = f"comes from the model {model!r}" if name in known else unknown
                raise ValueError(f"{place}: the answer {origin}: choose another output file")
        answers = load_answers(path)
        watch(len(answers))
        for question in [each for each in questions if each.id not in answers]:
            reply = endpoint.reply(question.messages(), wait)
            answers[question.id] = reply.text
            record: dict[str, Any] = {"id": question.id, "model": endpoint.model, "answer": reply.text}
            record |= {} if reply.logprobs is None else {"logprobs": reply.logprobs}
            file.write(f"{json.dumps(record)}\n")
            file.flush()
            watch(len(answers))
    return answers


def _without_torn_line(path: Path) -> Path:
    """Remove the incomplete last line that an interrupted `ask` has left in a file, and return the path."""
    text = path.read_bytes() if path.exists() else b""
    torn, begin = text[text.rfind(b"\n") + 1 :], b'{"id": "'
    if torn and torn[: len(begin)] != begin[: len(torn)]:
        raise ValueError(f"{path}: the last line is not a reply: choose another output file")
    if torn:
        os.truncate(path, len(text) - len(torn))
    return path


def key_from(variable: str | None) -> str | None:
    """Return the API key in an environment variable, or `None` without one. Raise `ValueError` if it is not set."""
    if variable is None:
        return None
    key = os.environ.get(variable, "").strip()
    if not key:
        # Who gives the key instead of the name must not find it in a log.
        named = f"`{variable}`" if re.fullmatch(r"[A-Z][A-Z_]*[0-9]*", variable) else "with the given name"
        raise ValueError(f"the environment variable {named} is not set: name the variable that contains the key")
    return key
