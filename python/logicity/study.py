"""Documents for studies with people: questions of `logicity questions` as HTML or Word, with the answers apart.

The sheet has instructions, solved examples and numbered questions with boxes to mark. Concepts have colors: the fact
that states a concept, and the names of the agents that have it. The key lists the answer of each number.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Final

from .errors import checked_path
from .files import reserved, write_text
from .questions import LETTERS, NO_RULE, Demonstration, Question, picture_bytes
from .terminal import neutral

__all__ = ["COLORS", "Study", "write_study"]

SHEETS: Final = (".html", ".docx")
KEYS: Final = (*SHEETS, ".csv")

#: The color of each concept. All have a contrast of at least 4.5 to white.
COLORS: Final = {
    "ambulance": "b00020",
    "bus": "8a4b00",
    "police": "0b4fb3",
    "tiro": "1b6e35",
    "reckless": "8e24aa",
    "old": "37474f",
    "young": "c2185b",
}

#: How questions state each concept, as an atom and in words.
_STATEMENTS: Final = {
    concept: re.compile(rf"\bIs{concept.capitalize()}\([^()]*\)|\b(?:{words})\b")
    for concept, words in {
        "ambulance": "an ambulance",
        "bus": "a bus",
        "police": "a police car",
        "tiro": "a beginner at the wheel",
        "reckless": "driven recklessly",
        "old": "is old",
        "young": "is young",
    }.items()
}
#: The sentence in words that states the concepts of an agent, and its name.
_SENTENCE: Final = re.compile(r"(?m)^(\w+ \d+) is an? [^.]*\.")

_INTRODUCTION: Final = (
    "Cars in a simulated city follow rules that are not shown to you. What a car does next depends only on facts about "
    "itself and about the agents that it sees. The solved examples show what cars do under these rules."
)
_TASK: Final = "Mark one action for each question, by yourself, in the order of the sheet. Guess if you do not know."

#: The largest width of a picture in a Word document, in English metric units (914,400 per inch).
_WIDTH: Final = 5_700_000


@dataclass(frozen=True)
class Study:
    """What `write_study` wrote.

    Attributes:
        ids: The ids of the questions in the order of the sheet: number 1 first.
        examples: The number of solved examples.
    """

    ids: tuple[str, ...]
    examples: int


@dataclass(frozen=True)
class _Run:
    """A piece of text. Without a color it is black."""

    text: str
    color: str | None = None
    bold: bool = False


@dataclass(frozen=True)
class _Block:
    """A paragraph, a heading of level 1 or 2, a picture, or a table, whose first row is its head."""

    runs: tuple[_Run, ...] = ()
    level: int = 0
    picture: bytes | None = None
    rows: tuple[tuple[str, ...], ...] = ()


def write_study(
    questions: Sequence[Question],
    sheet: str | os.PathLike[str],
    key: str | os.PathLike[str],
    *,
    seed: int = 0,
    examples: int | None = None,
    overwrite: bool = False,
) -> Study:
    """Write questions as a sheet for people, and the key with the answers.

    The order of questions and examples depends only on `seed` and on what they are, not on their order in the file. The
    same arguments give the same bytes. Questions share their examples: the sheet has each one once.

    Args:
        questions: Questions of `load_questions`.
        sheet: The sheet: `.html`, one file that needs no other, or `.docx`, for word processors.
        key: The key with the answers: `.html`, `.docx` or `.csv`.
        seed: The seed of the order.
        examples: The largest number of solved examples, spread over the actions; by default all.
        overwrite: Whether to replace files that this function did not write, or that have changed since.

    Raises:
        FileExistsError: If a file must not be replaced.
        OSError: If a file cannot be read or written.
        ValueError: If a file name has another ending, both are the same file, there are no questions, or a picture is
            not PNG.
    """
    paths = Path(checked_path("sheet", sheet)), Path(checked_path("key", key))
    for path, endings in zip(paths, (SHEETS, KEYS), strict=True):
        if path.suffix not in endings:
            raise ValueError(f"{path}: expected a file that ends in {' or '.join(endings)}")
    if paths[0].resolve() == paths[1].resolve():
        raise ValueError(f"{paths[0]}: sheet and key are the same file")
    if not questions:
        raise ValueError("there are no questions")
    ordered = sorted(questions, key=lambda each: _place(seed, each.id))
    shown = _examples(questions, seed, examples)
    _write(paths[0], "Study sheet", list(_sheet(ordered, shown)), overwrite)
    _write(paths[1], "Answers", [_Block((_Run("Answers"),), 1), _Block(rows=tuple(_key(ordered)))], overwrite)
    return Study(tuple(each.id for each in ordered), len(shown))


def _place(seed: int, name: str) -> bytes:
    return hashlib.sha256(f"{seed}\n{name}".encode()).digest()


def _examples(questions: Sequence[Question], seed: int, count: int | None) -> list[Demonstration]:
    """Return the solved examples of questions without repetitions. A part of them has actions as equal as possible."""
    distinct = {(each.text, each.picture): each for question in questions for each in question.demonstrations}
    ordered = [distinct[at] for at in sorted(distinct, key=lambda at: _place(seed, f"{at[0]}\n{at[1] and at[1].name}"))]
    if count is None:
        return ordered
    by_action = [[each for each in ordered if each.answer == letter] for letter in LETTERS]
    taken = [each for turn in zip_longest(*by_action) for each in turn if each is not None][:count]
    return sorted(taken, key=ordered.index)


def _sheet(questions: Sequence[Question], examples: Sequence[Demonstration]) -> Iterator[_Block]:
    """Yield the blocks of the sheet."""
    yield _Block((_Run("What does the car do next?"),), 1)
    # Only instructions with rules have several lines. The last one is for language models.
    stated, _, _ = questions[0].system.rpartition("\n")
    for line in (stated if stated and questions[0].closing is None else _INTRODUCTION).split("\n"):
        yield _Block(tuple(_colored(line)))
    yield _Block((_Run(_TASK),))
    texts = [each.text for each in examples] + [each.text for each in questions]
    # In words, each text begins with the meaning of the words. People need it once.
    shared = os.path.commonprefix([text.split("\n")[:-1] for text in texts]) if len(texts) > 1 else []
    for line in shared:
        yield _Block(tuple(_colored(line)))
    present = [concept for concept, stated in _STATEMENTS.items() if any(map(stated.search, texts))]
    if present:
        legend = [piece for concept in present for piece in (_Run(concept, COLORS[concept], True), _Run(" "))]
        yield _Block((_Run("Colors of concepts: "), *legend[:-1]))
    if examples:
        yield _Block((_Run("Solved examples"),), 1)
    for number, example in enumerate(examples, 1):
        yield _Block((_Run(f"Example {number}"),), 2)
        yield from _scene(example, len(shared))
        yield _Block((_Run(f"Answer: {questions[0].options[example.answer]}", bold=True),))
    yield _Block((_Run("Questions"),), 1)
    for number, question in enumerate(questions, 1):
        yield _Block((_Run(f"Question {number}"),), 2)
        yield from _scene(question, len(shared))
        yield _Block((_Run("   ".join(f"\N{BALLOT BOX} {action}" for action in question.options.values())),))
        if question.labels:
            yield _Block((_Run(f"Rule that requires it, or {NO_RULE}: ____________"),))


def _scene(of: Demonstration | Question, omitted: int) -> Iterator[_Block]:
    """Yield the picture and the text of a scene without its first lines."""
    if of.picture is not None:
        yield _Block(picture=picture_bytes(of.picture))
    colors = dict(_names(of.text))
    for line in of.text.split("\n")[omitted:]:
        yield _Block(tuple(_colored(line, colors)))


def _names(text: str) -> Iterator[tuple[str, str]]:
    """Yield the name of each agent with a concept, and the color of its first concept."""
    found: dict[str, str] = {}
    for concept, statement in _STATEMENTS.items():
        for atom in re.finditer(rf"\bIs{concept.capitalize()}\((\w+)\)", text):
            found.setdefault(atom[1], COLORS[concept])
        for sentence in _SENTENCE.finditer(text):
            if statement.search(sentence[0]):
                found.setdefault(sentence[1], COLORS[concept])
    yield from found.items()


def _colored(line: str, names: Mapping[str, str] = MappingProxyType({})) -> Iterator[_Run]:
    """Yield the runs of a line: statements of concepts and the given names with their colors."""
    spans = [
        (match.start(), match.end(), COLORS[concept])
        for concept, statement in _STATEMENTS.items()
        for match in statement.finditer(line)
    ]
    if names:
        of_names = re.compile(rf"\b(?:{'|'.join(map(re.escape, sorted(names)))})\b")
        spans += [(match.start(), match.end(), names[match[0]]) for match in of_names.finditer(line)]
    end = 0
    # A statement contains the names in it.
    for begin, stop, color in sorted(spans, key=lambda span: (span[0], -span[1])):
        if begin >= end:
            if begin > end:
                yield _Run(line[end:begin])
            yield _Run(line[begin:stop], color, True)
            end = stop
    if end < len(line):
        yield _Run(line[end:])


def _key(questions: Sequence[Question]) -> Iterator[tuple[str, ...]]:
    yield ("number", "id", "answer", "action", "rules")
    for number, each in enumerate(questions, 1):
        rules = " ".join(each.clauses or ())
        yield (str(number), each.id, each.answer, each.options[each.answer], rules)


def _write(path: Path, title: str, blocks: Sequence[_Block], overwrite: bool) -> None:
    """Write a document in the format of its ending."""
    if path.suffix == ".docx":
        with reserved(path, by="study", overwrite=overwrite) as output:
            Path(output.temporary).write_bytes(_docx(blocks))
            output.finish()
        return
    if path.suffix == ".html":
        text = _html(title, blocks)
    else:
        lines = io.StringIO()
        writer = csv.writer(lines, lineterminator="\n")
        writer.writerows(row for block in blocks for row in block.rows)
        text = lines.getvalue()
    write_text(path, text, by="study", overwrite=overwrite)


_STYLE: Final = """
body { font: 1rem/1.45 system-ui, sans-serif; max-width: 46rem; margin: 2rem auto; padding: 0 1rem; color: #000;
  background: #fff; }
h2 { font-size: 1.05rem; margin: 1.6rem 0 0.3rem; break-after: avoid; }
p { margin: 0.3rem 0; overflow-wrap: anywhere; break-inside: avoid; }
img { max-width: 100%; }
td, th { text-align: left; padding: 0.15rem 0.8rem 0.15rem 0; }
@media print { body { margin: 0; max-width: none; } }
"""


def _html(title: str, blocks: Sequence[_Block]) -> str:
    """Return an HTML document that needs no other file and no script."""
    lines = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>",
    ]
    for block in blocks:
        if block.picture is not None:
            data = base64.b64encode(block.picture).decode()
            lines.append(f'<p><img alt="The scene from above" src="data:image/png;base64,{data}"></p>')
        elif block.rows:
            cells = ("".join(f"<td>{_text_of(cell)}</td>" for cell in row) for row in block.rows[1:])
            head = "".join(f"<th>{_text_of(cell)}</th>" for cell in block.rows[0])
            lines += ["<table>", f"<tr>{head}</tr>", *(f"<tr>{row}</tr>" for row in cells), "</table>"]
        else:
            tag = f"h{block.level}" if block.level else "p"
            lines.append(f"<{tag}>{''.join(map(_html_run, block.runs))}</{tag}>")
    return "\n".join([*lines, "</body>\n</html>\n"])


def _html_run(run: _Run) -> str:
    text = _text_of(run.text)
    if run.color is not None:
        text = f'<span style="color:#{run.color}">{text}</span>'
    return f"<b>{text}</b>" if run.bold else text


def _text_of(text: str) -> str:
    """Return a text for HTML and XML, which permit few control characters."""
    return escape(neutral(text))


_NAMESPACES: Final = " ".join(
    f'xmlns:{name}="http://schemas.openxmlformats.org/{path}"'
    for name, path in {
        "w": "wordprocessingml/2006/main",
        "r": "officeDocument/2006/relationships",
        "wp": "drawingml/2006/wordprocessingDrawing",
        "a": "drawingml/2006/main",
        "pic": "drawingml/2006/picture",
    }.items()
)
_XML: Final = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
_PACKAGE: Final = "http://schemas.openxmlformats.org/package/2006"
_OFFICE: Final = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_WORD: Final = "application/vnd.openxmlformats-officedocument.wordprocessingml"


def _docx(blocks: Sequence[_Block]) -> bytes:
    """Return a Word document: Office Open XML (ECMA-376) with the parts that word processors need."""
    pictures: list[bytes] = []
    body: list[str] = []
    for block in blocks:
        if block.picture is not None:
            pictures.append(block.picture)
            body.append(f"<w:p><w:r>{_drawing(block.picture, len(pictures))}</w:r></w:p>")
        elif block.rows:
            rows = (
                "<w:tr>" + "".join(f"<w:tc><w:p>{_word_run(_Run(cell))}</w:p></w:tc>" for cell in row) + "</w:tr>"
                for row in block.rows
            )
            grid = "<w:gridCol/>" * len(block.rows[0])
            body.append(f"<w:tbl><w:tblPr/><w:tblGrid>{grid}</w:tblGrid>{''.join(rows)}</w:tbl><w:p/>")
        else:
            style = f'<w:pPr><w:pStyle w:val="Heading{block.level}"/></w:pPr>' if block.level else ""
            body.append(f"<w:p>{style}{''.join(map(_word_run, block.runs))}</w:p>")
    page = '<w:sectPr><w:pgSz w:w="11906" w:h="16838"/><w:pgMar w:top="1134" w:right="1134" w:bottom="1134" '
    page += 'w:left="1134" w:header="0" w:footer="0" w:gutter="0"/></w:sectPr>'
    relations = "".join(
        f'<Relationship Id="p{number}" Type="{_OFFICE}/image" Target="media/{number}.png"/>'
        for number in range(1, len(pictures) + 1)
    )
    parts: dict[str, str | bytes] = {
        "[Content_Types].xml": f'<Types xmlns="{_PACKAGE}/content-types">'
        '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="png" ContentType="image/png"/>'
        f'<Override PartName="/word/document.xml" ContentType="{_WORD}.document.main+xml"/>'
        f'<Override PartName="/word/styles.xml" ContentType="{_WORD}.styles+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{_PACKAGE}/relationships">'
        f'<Relationship Id="d" Type="{_OFFICE}/officeDocument" Target="word/document.xml"/></Relationships>',
        "word/document.xml": f"<w:document {_NAMESPACES}><w:body>{''.join(body)}{page}</w:body></w:document>",
        "word/styles.xml": f"<w:styles {_NAMESPACES}>{''.join(map(_heading, (1, 2)))}</w:styles>",
        "word/_rels/document.xml.rels": f'<Relationships xmlns="{_PACKAGE}/relationships">'
        f'<Relationship Id="s" Type="{_OFFICE}/styles" Target="styles.xml"/>{relations}</Relationships>',
        **{f"word/media/{number}.png": picture for number, picture in enumerate(pictures, 1)},
    }
    file = io.BytesIO()
    # Without compression and with a fixed date, the bytes depend on nothing else.
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, content in parts.items():
            archive.writestr(zipfile.ZipInfo(name), content if isinstance(content, bytes) else _XML + content)
    return file.getvalue()


def _heading(level: int) -> str:
    size, before = {1: (32, 360), 2: (24, 240)}[level]
    return (
        f'<w:style w:type="paragraph" w:styleId="Heading{level}"><w:name w:val="heading {level}"/><w:pPr><w:keepNext/>'
        f'<w:spacing w:before="{before}"/><w:outlineLvl w:val="{level - 1}"/></w:pPr>'
        f'<w:rPr><w:b/><w:sz w:val="{size}"/></w:rPr></w:style>'
    )


def _word_run(run: _Run) -> str:
    looks = "<w:b/>" * run.bold + (f'<w:color w:val="{run.color}"/>' if run.color is not None else "")
    looks = f"<w:rPr>{looks}</w:rPr>" if looks else ""
    return f'<w:r>{looks}<w:t xml:space="preserve">{_text_of(run.text)}</w:t></w:r>'


def _drawing(picture: bytes, number: int) -> str:
    """Return a picture in a line, as wide as the text. A PNG file has its size at byte 16."""
    width, height = (int.from_bytes(picture[at : at + 4], "big") for at in (16, 20))
    size = f'cx="{_WIDTH}" cy="{_WIDTH * height // max(width, 1)}"'
    return (
        f'<w:drawing><wp:inline><wp:extent {size}/><wp:docPr id="{number}" name="Scene {number}" '
        'descr="The scene from above"/><a:graphic><a:graphicData '
        'uri="http://schemas.openxmlformats.org/drawingml/2006/picture"><pic:pic><pic:nvPicPr>'
        f'<pic:cNvPr id="{number}" name="{number}.png"/><pic:cNvPicPr/></pic:nvPicPr><pic:blipFill>'
        f'<a:blip r:embed="p{number}"/><a:stretch><a:fillRect/></a:stretch></pic:blipFill><pic:spPr><a:xfrm>'
        f'<a:off x="0" y="0"/><a:ext {size}/></a:xfrm><a:prstGeom prst="rect"><a:avLst/></a:prstGeom></pic:spPr>'
        "</pic:pic></a:graphicData></a:graphic></wp:inline></w:drawing>"
    )
