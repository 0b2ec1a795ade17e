"""Documents for studies with people."""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from conftest import picture, png

from logicity import ACTIONS
from logicity.__main__ import main
from logicity.questions import Demonstration, Question, load_questions
from logicity.study import COLORS, _names, write_study

W = "{http://schemas.openxmlformats.org/wordprocessingml/2006/main}"
#: In words, every question begins with this.
MEANING = "A city is a grid of cells. "
#: Instead of an image, the text of a document has this.
PICTURE = "[picture]"


@pytest.fixture(scope="module", params=["atoms", "words", "paper"])
def asked(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("study") / "questions.jsonl"
    words = ["questions", "vap-hard", "--count", "8", "--style", request.param, "--output", str(file)]
    assert main(words) == 0
    return file


class Page(HTMLParser):
    """The paragraphs of an HTML document, and its colored texts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.paragraphs: list[str] = []
        self.colored: list[tuple[str, str]] = []
        self.tags: Counter[str] = Counter()
        self.color: str | None = None
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        if tag in ("p", "h1", "h2"):
            self.paragraphs.append("")
        if tag == "span":
            self.color = str(dict(attributes)["style"]).removeprefix("color:#")
        if tag == "img":
            self.paragraphs[-1] += PICTURE

    def handle_endtag(self, tag: str) -> None:
        if tag == "span":
            self.color = None

    def handle_data(self, data: str) -> None:
        if self.paragraphs:
            self.paragraphs[-1] += data.rstrip("\n")
        if self.color is not None:
            self.colored.append((data, self.color))


def word(path: Path) -> tuple[list[str], list[tuple[str, str]]]:
    """Return the paragraphs of a Word document, and its colored texts. All parts are well-formed and referred to."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    for name, content in parts.items():
        if not name.endswith(".png"):
            ElementTree.fromstring(content)
    related = re.findall(rb'Target="([^"]*)"', parts["word/_rels/document.xml.rels"])
    assert {f"word/{target.decode()}" for target in related} | {
        "[Content_Types].xml",
        "_rels/.rels",
        "word/document.xml",
        "word/_rels/document.xml.rels",
    } == set(parts)
    paragraphs, colored = [], []
    for paragraph in ElementTree.fromstring(parts["word/document.xml"]).iter(f"{W}p"):
        text = ""
        for run in paragraph.iter(f"{W}r"):
            piece = "".join(each.text or "" for each in run.iter(f"{W}t"))
            text += piece + PICTURE * len(list(run.iter(f"{W}drawing")))
            color = run.find(f"{W}rPr/{W}color")
            if color is not None:
                colored.append((piece, color.attrib[f"{W}val"]))
        paragraphs.append(text)
    return paragraphs, colored


def lines_of(questions: list[Question], ids: tuple[str, ...]) -> list[str]:
    """Return what a sheet must say about each question, after its heading, in order."""
    by_id = {each.id: each for each in questions}
    options = "☐ Slow   ☐ Normal   ☐ Fast   ☐ Stop"
    lines = [line for each in ids for line in (*by_id[each].text.split("\n"), options)]
    # The introduction states once what words mean.
    return [line for line in lines if not line.startswith(MEANING)]


def test_a_sheet_has_the_questions_without_answers(asked: Path, tmp_path: Path) -> None:
    questions = load_questions(asked)
    html, docx = tmp_path / "sheet.html", tmp_path / "sheet.docx"
    done = write_study(questions, html, tmp_path / "key.csv", seed=5)
    assert done == write_study(questions, docx, tmp_path / "key.html", seed=5)
    assert set(done.ids) == {each.id for each in questions}
    page = Page(html.read_text(encoding="utf-8"))
    paragraphs, colored = word(docx)
    # Both formats say the same, in the same colors. The document has an empty paragraph where a line is empty.
    assert page.paragraphs == paragraphs and page.colored == colored
    begin = paragraphs.index("Questions") + 1
    asked_lines = [line for line in paragraphs[begin:] if not re.fullmatch(r"Question \d+", line)]
    assert asked_lines == lines_of(questions, done.ids)
    assert sum(line.startswith(MEANING) for line in paragraphs) == questions[0].text.startswith(MEANING)
    assert not any(line.startswith("Answer") for line in paragraphs[begin:])
    solved = paragraphs[paragraphs.index("Solved examples") : begin]
    examples = {(each.text, each.answer) for question in questions for each in question.demonstrations}
    assert done.examples == len(examples) == sum(line.startswith("Answer: ") for line in solved)
    # Nothing else is loaded, and nothing runs.
    text = html.read_text(encoding="utf-8")
    assert not page.tags["script"] and not page.tags["link"] and "http" not in text
    # Names of questions tell the number of the world, and no more than the key needs.
    assert not any(each.id in text for each in questions)


def test_concepts_have_their_colors(asked: Path, tmp_path: Path) -> None:
    questions = load_questions(asked)
    write_study(questions, tmp_path / "sheet.html", tmp_path / "key.csv")
    page = Page((tmp_path / "sheet.html").read_text(encoding="utf-8"))
    shown = {(each.text, json.dumps(each.scene)): each for question in questions for each in question.demonstrations}
    expected: Counter[str] = Counter()
    scenes: list[Demonstration | Question] = [*shown.values(), *questions]
    for each in scenes:
        assert each.scene is not None
        for concept in COLORS:
            expected[concept] += len(each.scene["facts"][f"Is{concept.capitalize()}"])
    statements = Counter(
        concept
        for text, color in page.colored
        for concept in COLORS
        if color == COLORS[concept] and (f"Is{concept.capitalize()}(" in text or not re.search(r"\d", text))
    )
    legend = {text for text, color in page.colored if text in COLORS and color == COLORS[text]}
    assert legend == {concept for concept, count in expected.items() if count}
    assert statements - Counter(legend) == +expected


def test_names_have_the_color_of_their_concept(asked: Path) -> None:
    for question in load_questions(asked):
        scene = question.scene
        assert scene is not None
        having = {
            entity: COLORS[concept]
            for concept in reversed(COLORS)
            for entity in scene["facts"][f"Is{concept.capitalize()}"]
        }
        names = dict(_names(question.text))
        if "Car 1" in question.text:
            assert Counter(names.values()) == Counter(having.values())
        else:
            assert names == having


def test_colors_are_legible() -> None:
    """The contrast to white of the Web Content Accessibility Guidelines."""
    for color in COLORS.values():
        parts = [int(color[at : at + 2], 16) / 255 for at in (0, 2, 4)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        assert 1.05 / (0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] + 0.05) >= 4.5
    assert len(set(COLORS.values())) == len(COLORS)


def test_the_key_has_the_answers(asked: Path, tmp_path: Path) -> None:
    questions = {each.id: each for each in load_questions(asked)}
    done = write_study(list(questions.values()), tmp_path / "sheet.docx", tmp_path / "key.csv", seed=1)
    with open(tmp_path / "key.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["number"], row["id"]) for row in rows] == [(str(at), id) for at, id in enumerate(done.ids, 1)]
    for row in rows:
        each = questions[row["id"]]
        assert (row["answer"], row["action"]) == (each.answer, each.options[each.answer])
        assert tuple(row["rules"].split()) == each.clauses
    write_study(list(questions.values()), tmp_path / "sheet.docx", tmp_path / "key.docx", seed=1)
    cells, _ = word(tmp_path / "key.docx")
    assert cells[: 2 + 4] == ["Answers", "number", "id", "answer", "action", "rules"]
    assert [cell for cell in cells if cell in questions] == list(done.ids)


def test_the_order_depends_on_the_seed_only(asked: Path, tmp_path: Path) -> None:
    questions = load_questions(asked)

    def made(seed: int, given: list[Question]) -> tuple[tuple[str, ...], bytes]:
        done = write_study(given, tmp_path / "a.docx", tmp_path / "a.csv", seed=seed)
        return done.ids, (tmp_path / "a.docx").read_bytes()

    assert made(3, questions) == made(3, questions[::-1])
    assert len({made(seed, questions)[0] for seed in range(5)}) > 1


@pytest.mark.parametrize("count", [0, 1, 4, 9, 1000])
def test_examples_are_spread_over_the_actions(asked: Path, tmp_path: Path, count: int) -> None:
    questions = load_questions(asked)
    everything = {each.text: each.answer for question in questions for each in question.demonstrations}
    done = write_study(questions, tmp_path / "a.html", tmp_path / "a.csv", examples=count)
    assert done.examples == min(count, len(everything))
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    taken = Counter(line.removeprefix("Answer: ") for line in page.paragraphs if line.startswith("Answer: "))
    available = Counter(ACTIONS["ABCD".index(answer)] for answer in everything.values())
    # Taking one more of any action would make the numbers less equal, or there is no more.
    most = max(taken.values(), default=0)
    assert all(taken[action] >= min(most - 1, available[action]) for action in available)


def test_rules_and_pictures_are_shown(tmp_path: Path) -> None:
    file = tmp_path / "why.jsonl"
    assert main(["questions", "vap-hard", "--count", "4", "--prompt", "why", "--output", str(file)]) == 0
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "0.png").write_bytes(png(picture(0, 0)[:512]))
    lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    lines[0]["picture"] = "pictures/0.png"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    questions = load_questions(file)
    write_study(questions, tmp_path / "a.docx", tmp_path / "a.csv")
    write_study(questions, tmp_path / "a.html", tmp_path / "a.csv")
    paragraphs, _ = word(tmp_path / "a.docx")
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    assert page.paragraphs == paragraphs
    assert paragraphs.count(PICTURE) == 1 and any(line.startswith("VS1 requires Stop of X") for line in paragraphs)
    assert not any("reply" in line for line in paragraphs)
    assert sum(line.startswith("Rule that requires it, or none: ") for line in paragraphs) == 4
    with zipfile.ZipFile(tmp_path / "a.docx") as archive:
        assert archive.read("word/media/1.png") == (tmp_path / "pictures" / "0.png").read_bytes()
        assert b'cx="5700000" cy="2850000"' in archive.read("word/document.xml")
    (tmp_path / "pictures" / "0.png").write_bytes(b"GIF89a")
    with pytest.raises(ValueError, match="expected a PNG picture"):
        write_study(questions, tmp_path / "a.html", tmp_path / "a.csv")


def test_foreign_text_is_neutral(asked: Path, tmp_path: Path) -> None:
    lines = [json.loads(line) for line in asked.read_text(encoding="utf-8").splitlines()]
    for line in lines:
        line["question"] = "<script>alert(1)</script> & \x1b[31m\u202e IsOld(<b>)\n" + line["question"]
        line["id"] += "<img>\x00"
    file = tmp_path / "foreign.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    questions = load_questions(file)
    for ending in ("html", "docx"):
        write_study(questions, tmp_path / f"a.{ending}", tmp_path / f"key.{ending}")
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    paragraphs, _ = word(tmp_path / "a.docx")
    assert not page.tags["script"] and page.paragraphs == paragraphs
    assert any(line.startswith("<script>alert(1)</script> & \\u001b[31m") for line in paragraphs)
    assert not Page((tmp_path / "key.html").read_text(encoding="utf-8")).tags["img"]
    word(tmp_path / "key.docx")


def test_the_command_protects_files(asked: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet, key = str(tmp_path / "sheet.html"), str(tmp_path / "key.csv")
    assert main(["study", str(asked), "-o", sheet, "--answers", key, "--examples", "4"]) == 0
    assert capsys.readouterr().out == f"questions: 8, solved examples: 4, in {sheet}\nanswers: {key}\n"
    for words, code, message in [
        ([str(asked), "-o", str(tmp_path / "a.pdf")], 2, "expected a file that ends in .html or .docx"),
        ([str(asked), "-o", sheet, "--answers", sheet], 2, "name two files"),
        ([str(tmp_path / "no.jsonl")], 2, "no such file"),
    ]:
        try:
            ended = main(["study", *words])
        except SystemExit as error:
            ended = error.code  # type: ignore[assignment]
        assert ended == code and message in capsys.readouterr().err
    Path(sheet).write_text("mine")
    assert main(["study", str(asked), "-o", sheet, "--answers", key]) == 2
    assert Path(sheet).read_text() == "mine"
    assert main(["study", str(asked), "-o", sheet, "--answers", key, "--force"]) == 0
    with pytest.raises(ValueError, match="the same file"):
        write_study(load_questions(asked), sheet, sheet)
    with pytest.raises(ValueError, match="there are no questions"):
        write_study([], sheet, key)
