"""Runs the blocks of the documentation site. `docs/how-to/add-a-page.md` describes the kinds of blocks.

The blocks of a page run in order, in a folder of their own. Tests in Rust load the blocks of rules and configurations
that have no file name (`tests/datalog/lang.rs`, `tests/city/config.rs`), decide scenes (`tests/program/diagnostics.rs`)
and run cargo (`tests/program/readme.rs`).
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from conftest import needs

DOCS = Path(__file__).parents[2] / "docs"

#: A block: the language, the words after it, and the text. Blocks of directives, such as ```{toctree}, do not match.
BLOCK = re.compile(r"^```(\w+)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: The languages and words of blocks without a file name, which tests in Rust load or run.
LOADED = [
    ("dl", ""),
    ("yaml", ""),
    ("json", "scene"),
    ("json", "marginals"),
    ("json", "answer"),
    ("sh", "cargo"),
    ("text", "cargo"),
]


@dataclass(frozen=True)
class Block:
    """A block of a page."""

    place: str
    language: str
    words: str
    text: str


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(
            f"{page.relative_to(DOCS)}:{text.count(chr(10), 0, match.start()) + 1}", match[1], match[2] or "", match[3]
        )
        for match in BLOCK.finditer(text)
        if match[2] != "illustration"
    ]


#: The playground is a program with a README of its own, not a page of the site.
PAGES = [page for page in sorted(DOCS.rglob("*.md")) if DOCS / "playground" not in page.parents and blocks(page)]


def matches(expected: str, found: str) -> bool:
    """Return whether a text is as expected, where `...` stands for any text."""
    pattern = ".*".join(re.escape(part) for part in expected.rstrip().split("..."))
    return re.fullmatch(pattern, found.rstrip(), re.DOTALL) is not None


class Runner:
    """Runs the blocks of a page."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names: dict[str, Any] = {"__name__": "page"}
        self.output: str | None = None

    def run(self, block: Block) -> None:
        if re.fullmatch(r"[\w./-]+\.\w+", block.words):
            path = self.folder / block.words
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, encoding="utf-8")
        elif (block.language, block.words) in LOADED:
            pass
        elif block.language == "sh":
            self.shell(block)
        elif block.language == "python" and not block.words:
            written = io.StringIO()
            with contextlib.redirect_stdout(written):
                exec(compile(block.text, block.place, "exec"), self.names)
            self.output = written.getvalue()
        elif block.language in ("text", "json") and not block.words:
            assert self.output is not None, f"{block.place}: no command before this output"
            assert matches(block.text, self.output), f"{block.place}: expected\n{block.text}\nfound\n{self.output}"
        else:
            raise AssertionError(f"{block.place}: an unknown kind of block")

    def shell(self, block: Block) -> None:
        wanted = re.fullmatch(r"(?:exit=(\d+))?", block.words)
        assert wanted is not None, f"{block.place}: `sh` with `{block.words}`"
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        done = subprocess.run(
            ["sh", "-e", "-c", block.text],
            cwd=self.folder,
            env={**os.environ, "PATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            check=False,
        )
        self.output = done.stdout
        assert done.returncode == int(wanted[1] or 0), f"{block.place}: exit code {done.returncode}\n{done.stdout}"


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(DOCS)) for page in PAGES])
def test_blocks_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page.name == "rule-layer.md":
        needs("torch", "learn")
    if page.name in ("exchange-data.md", "other-engines.md"):
        needs("duckdb", "frames")
        needs("polars", "frames")
    monkeypatch.chdir(tmp_path)
    runner = Runner(tmp_path)
    for block in blocks(page):
        runner.run(block)


def test_number_of_blocks(capsys: pytest.CaptureFixture[str]) -> None:
    run = [block for page in PAGES for block in blocks(page) if (block.language, block.words) not in LOADED]
    kinds = {
        language: sum(block.language == language for block in run) for language in ("sh", "python", "text", "json")
    }
    assert kinds["sh"] >= 10 and kinds["python"] >= 4 and kinds["text"] >= 10
    with capsys.disabled():
        pages = len({block.place.partition(":")[0] for block in run})
        counts = ", ".join(f"{count} {language}" for language, count in kinds.items())
        print(f"\ndocumentation: {len(run)} blocks of {pages} pages run ({counts})")


def test_the_tables_of_traces_list_every_key(tmp_path: Path) -> None:
    gymnasium = needs("gymnasium", "gym")
    # An action that changes routes.
    rules = '.include "vocabulary.dl"\n.decl Turn(x: agent)\n.output Turn\nTurn(X) :- IsCar(X).\n'
    (tmp_path / "turn.dl").write_text(rules, encoding="utf-8")
    actions = "{define: {Turn: {cells: {Car: 1}, turn: right}}, priority: [Turn, Stop, Slow, Fast, Normal]}"
    config = f"base: expert\nrules: turn.dl\nactions: {actions}\n"
    (tmp_path / "turn.yaml").write_text(config, encoding="utf-8")
    env = gymnasium.make("logicity/SPF-Expert-v0", config=str(tmp_path / "turn.yaml"))
    _, info = env.reset(seed=0)
    env.step(info["oracle_action"])
    env.unwrapped.write_trace(tmp_path / "trace.jsonl")
    header, tick = map(json.loads, (tmp_path / "trace.jsonl").read_text(encoding="utf-8").splitlines())
    found = {
        "Header": [header],
        "Header: `agents`": header["agents"],
        "Header: `clauses`": header["clauses"],
        "Header: `rule_files`": header["rule_files"],
        "Tick": [tick],
        "Tick: `agents`": tick["agents"],
        "Tick: `agents`, `driven`": [agent["driven"] for agent in tick["agents"] if "driven" in agent],
    }
    _, *sections = (DOCS / "reference" / "traces.md").read_text(encoding="utf-8").split("\n## ")
    listed = {
        section.partition("\n")[0]: {
            key for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE) for key in re.findall(r"`(\w+)`", row)
        }
        for section in sections
    }
    assert {name: set().union(*entries) for name, entries in found.items()} == {
        name: keys for name, keys in listed.items() if keys
    }


def test_the_page_of_safe_path_following_lists_the_keys_of_episodes() -> None:
    page = (DOCS / "reference" / "spf.md").read_text(encoding="utf-8")
    lines = (DOCS.parent / "configs" / "episodes" / "expert-test.jsonl").read_text(encoding="utf-8").splitlines()
    keys = {key for line in lines for key in json.loads(line)}
    assert len(keys) >= 8 and {key for key in keys if f"`{key}`" not in page} == set()


def test_broken_links_of_a_site_are_found(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text('<p id="here"><a href="#here"><a href="other.html#end"><img src="a.png">')
    (tmp_path / "other.html").write_text('<a href="page.html#there"><a href="http://nowhere.test"><a href="none.html">')
    done = subprocess.run([sys.executable, DOCS / "links.py", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout == "5 links inside the site, 4 broken\n"
    assert done.stderr.splitlines() == [
        "other.html: page.html#there: no such anchor",
        "other.html: none.html: no such file",
        "page.html: other.html#end: no such anchor",
        "page.html: a.png: no such file",
    ]


def test_the_history_of_benchmarks_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS)
    history = importlib.import_module("history")
    lines = [
        {"commit": "1" * 8, "date": "2024-01-01", "machine": "A, 2 cores", "ratios": {"chain": 0.5}},
        {"commit": "2" * 8, "date": "2024-01-02", "machine": "B, 4 cores", "ratios": {"chain": 0.25, "tick": 0.031}},
    ]
    page = history.page("\n".join(map(json.dumps, lines)))
    # The curve of `chain` falls to the half of its height; that of `tick` is one point.
    assert '<path d="M12.0 34.0 L120.0 69.0"/>' in page and page.count("<circle") == 3
    assert page.endswith(
        "| commit | date | chain | tick | machine |\n"
        "|---|---|---:|---:|---|\n"
        "| `22222222` | 2024-01-02 | 0.25 | 0.031 | B, 4 cores |\n"
        "| `11111111` | 2024-01-01 | 0.5 |  | A, 2 cores |\n"
    )
    recorded = history.entries((DOCS.parent / "benches" / "history.jsonl").read_text(encoding="utf-8"))
    assert recorded and all(ratio > 0 for entry in recorded for ratio in entry.ratios.values())


@pytest.mark.parametrize(
    ("expected", "found", "same"),
    [("a\n", "a\n", True), ("a...c", "a\nb\nc", True), ("a...c", "a\nb", False), ("a.c", "abc", False)],
)
def test_dots_stand_for_any_text(expected: str, found: str, same: bool) -> None:
    assert matches(expected, found) is same


def test_a_wrong_block_fails(tmp_path: Path) -> None:
    wrong = [
        [Block("page:1", "sh", "", "exit 3\n")],
        [Block("page:1", "sh", "", "echo a\n"), Block("page:2", "text", "", "b\n")],
        [Block("page:1", "text", "", "b\n")],
        [Block("page:1", "python", "", "assert False\n")],
        [Block("page:1", "python", "later", "pass\n")],
        [Block("page:1", "haskell", "", "main\n")],
    ]
    for page in wrong:
        runner = Runner(tmp_path)
        for block in page[:-1]:
            runner.run(block)
        with pytest.raises(AssertionError):
            runner.run(page[-1])
