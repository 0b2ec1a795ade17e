"""The experiment of language questions: solvers of this package and language models, beside the paper's models.

`logicity questions` generates the questions. They are the same for each prompt: with solved examples only, with the
rules in words, and with a request for the rule that requires the action. Solvers answer them here, models over HTTP.
All answers are files that `logicity grade` reads.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, field_validator

from .. import _logicity
from ..city import ACTIONS, Inference
from ..errors import did_you_mean
from ..files import reserved
from ..questions import (
    LETTERS,
    NO_RULE,
    Demonstration,
    Endpoint,
    Grade,
    Question,
    ask,
    grade,
    load_answers,
    load_logprobs,
    load_questions,
)
from ..rules import Program, Session
from .config import faults, merged
from .experiment import read_experiment
from .jobs import exclusive
from .report import aligned, escaped, markdown_table, paper_table, save_figure, write_tables

__all__ = ["SOLVERS", "LanguageExperiment", "LanguageReport", "ModelSpec", "Unit", "is_language", "run"]

#: What the instructions of a question state and request: the values of `logicity questions --prompt`.
Prompt = Literal["examples", "rules", "why"]

#: The headings of the tables.
TITLES: dict[str, str] = {
    "examples": "Only solved examples show the rules",
    "rules": "The instructions state the rules in words",
    "why": "The instructions state the rules and request the rule that requires the action",
}

#: The interval between two lines of progress, in seconds.
SECONDS = 30.0

#: Changes for `--quick`.
QUICK: dict[str, Any] = {"count": 8}

_Seed = Annotated[int, Field(strict=True, ge=0, lt=2**64)]
_Positive = Annotated[int, Field(strict=True, ge=1)]
_Names = Annotated[tuple[str, ...], Strict(False)]
_Solver = Literal["majority", "nearest", "induced", "oracle"]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, use_attribute_docstrings=True)


class ModelSpec(_Model):
    """A language model with an OpenAI-compatible endpoint."""

    url: str
    """The base URL, such as `http://localhost:8000/v1`."""
    model: str
    """The name of the model on the server."""
    key_from: str | None = None
    """The environment variable with the API key. By default no key is sent."""
    settings: dict[str, Any] = Field(default_factory=lambda: {"temperature": 0})
    """More fields of the request."""
    logprobs: bool = False
    """Whether to request log-probabilities of the 20 most probable tokens, for the measures of calibration."""
    timeout: Annotated[float, Field(strict=False, gt=0)] = 120.0
    """The timeout of a request, in seconds without data."""
    tries: _Positive = 6
    """The number of attempts of a request."""

    def endpoint(self) -> Endpoint:
        """Return the endpoint.

        Raises:
            ValueError: If a setting is invalid, or the environment variable of the key is not set.
        """
        key = None
        if self.key_from is not None:
            key = os.environ.get(self.key_from, "").strip()
            if not key:
                raise ValueError(f"`key_from`: the environment variable `{self.key_from}` is not set")
        settings = {**self.settings, **({"logprobs": True, "top_logprobs": 20} if self.logprobs else {})}
        return Endpoint(self.url, self.model, key, settings, self.timeout, self.tries)


class LanguageExperiment(_Model):
    """The experiment: what `logicity experiment` runs for a file with `task: language`."""

    task: Literal["language"]
    """Distinguishes this experiment from those of other tasks."""
    title: str
    """The title of the table."""
    paper: Literal["language"] | None = None
    """The table of the paper beside which the results are shown."""
    config: str = "vap-hard"
    """The configuration: the name of a built-in one, or a path relative to this file."""
    count: _Positive = 117
    """The number of questions of a set."""
    about: _Names = ()
    """Restricts the questions to cars with one of these concepts, unless empty."""
    shots: Annotated[int, Field(strict=True, ge=0)] = 5
    """The number of solved examples before each question."""
    style: Literal["atoms", "words"] = "atoms"
    """The form of the facts."""
    entities: Literal["view", "city"] = "view"
    """The entities of a question."""
    seeds: Annotated[tuple[_Seed, ...], Strict(False), Field(min_length=1)] = (0,)
    """The seeds. Each is a set with other questions and other solved examples."""
    prompts: Annotated[tuple[Prompt, ...], Strict(False), Field(min_length=1)] = ("examples", "rules", "why")
    """What the instructions state and request. The questions are the same."""
    solvers: Annotated[tuple[_Solver, ...], Strict(False)] = ("majority", "nearest", "induced", "oracle")
    """The solvers of this package."""
    models: dict[str, ModelSpec] = Field(default_factory=dict)
    """The language models by the name of their row."""

    @field_validator("models")
    @classmethod
    def _check_names(cls, models: dict[str, ModelSpec]) -> dict[str, ModelSpec]:
        for name in models:
            if name in SOLVERS:
                raise ValueError(f"`{name}` is the name of a solver: choose another name")
            if not name or name.startswith(".") or "/" in name or "\\" in name:
                raise ValueError(f"`{name}` cannot be the name of a folder: choose another name")
        return models

    @classmethod
    def load(
        cls, name: str | os.PathLike[str], changes: Mapping[str, Any] | None = None, *, quick: bool = False
    ) -> tuple[LanguageExperiment, Path]:
        """Read a YAML file.

        Args:
            name: The file, or the bare name of a built-in experiment.
            changes: Changes to the values, as `--set` makes them.
            quick: Whether to ask 8 questions of the first seed.

        Returns:
            The experiment, and the path of its file.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key.
            OSError: If the file cannot be read.
        """
        path, file, values = read_experiment(name)
        if quick:
            values = merged(values, QUICK)
            if isinstance(values.get("seeds"), list):
                values["seeds"] = values["seeds"][:1]
        values = merged(values, changes or {})
        try:
            return cls.model_validate(values), path
        except ValidationError as error:
            raise file.error(faults(error, _unknown, depth=3)) from None

    def config_path(self, file: Path) -> str:
        """Return the configuration as commands take it."""
        return str(file.parent / self.config) if Path(self.config).suffix else self.config

    def units(self, only: Sequence[tuple[str, str | None]] = (), seeds: Sequence[int] | None = None) -> list[Unit]:
        """Return the selected units, by prompt, row and seed.

        Args:
            only: Pairs of a row and a prompt, or of a row and `None` for all prompts. Empty for all units.
            seeds: Seeds that replace those of the experiment.

        Raises:
            ValueError: If the selection names an unknown row or prompt.
        """
        rows = dict.fromkeys([*self.solvers, *self.models])
        for row, prompt in only:
            if row not in rows:
                raise ValueError(f"--only: unknown row `{row}`{did_you_mean(row, rows)}")
            if prompt is not None and prompt not in self.prompts:
                raise ValueError(f"--only: unknown prompt `{prompt}`{did_you_mean(prompt, self.prompts)}")
        return [
            Unit(row, prompt, seed)
            for prompt in dict.fromkeys(self.prompts)
            for row in rows
            if not only or (row, None) in only or (row, prompt) in only
            for seed in dict.fromkeys(seeds or self.seeds)
        ]


@dataclass(frozen=True)
class Unit:
    """The answers of a solver or model to one set of questions."""

    row: str
    prompt: str
    seed: int

    def __str__(self) -> str:
        """Format the unit for messages."""
        return f"{self.row}, {self.prompt}, seed {self.seed}"


def is_language(name: str | os.PathLike[str]) -> bool:
    """Return whether the file of an experiment has `task: language`.

    Raises:
        InputError: If the file is not YAML, or not a mapping.
        OSError: If the file cannot be read.
    """
    return read_experiment(name)[2].get("task") == "language"


def _unknown(path: tuple[str, ...]) -> tuple[str, str]:
    """Return the message and the help for an unknown key."""
    model: type[BaseModel] = ModelSpec if path[0] == "models" and len(path) > 1 else LanguageExperiment
    return f"unknown key `{path[-1]}`", did_you_mean(path[-1], model.model_fields).removeprefix("; ")


# --- questions


def _command(*arguments: str) -> None:
    """Run a command of this program.

    Raises:
        ValueError: If the command fails. The message is that of the command.
    """
    done = subprocess.run([sys.executable, "-m", "logicity", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValueError(f"`logicity {' '.join(arguments)}` failed:\n{done.stderr.strip()}")


def write_questions(experiment: LanguageExperiment, file: Path, prompt: str, seed: int, path: Path) -> list[Question]:
    """Write a set of questions with `logicity questions`, and return it.

    Raises:
        OSError: If the file cannot be written.
        ValueError: If `logicity questions` fails.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    values = {
        "count": experiment.count,
        "shots": experiment.shots,
        "style": experiment.style,
        "entities": experiment.entities,
        "prompt": prompt,
        "seed": seed,
    }
    options = [text for name, value in values.items() for text in (f"--{name}", str(value))]
    about = ["--about", ",".join(experiment.about)] if experiment.about else []
    _command("questions", experiment.config_path(file), *options, *about, "--output", str(path), "--force")
    return load_questions(path)


def _identity(questions: Sequence[Question], more: Mapping[str, Any]) -> str:
    """Return a name of questions and of what else determines the replies to them."""
    content = [[question.id, question.messages()] for question in questions]
    text = json.dumps([content, more], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


# --- solvers


#: Answers questions by a configuration: replies by id. The path, without its ending, is that of files to write.
Solver = Callable[[Sequence[Question], str, Path], dict[str, str]]


def _majority(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Choose the most frequent answer of the examples; of equally frequent ones, the first option."""
    replies = {}
    for question in questions:
        shown = question.demonstrations
        counts = Counter(each.answer for each in shown)
        answer = max(LETTERS, key=lambda letter: counts[letter])
        rules = Counter(each.clauses[0] if each.clauses else NO_RULE for each in shown if each.answer == answer)
        replies[question.id] = question.reply(answer, [rule for rule, _ in rules.most_common(1)])
    return replies


def _nearest(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Choose the answer of the example with the most similar scene; of equally similar ones, the first."""
    replies = {}
    for question in questions:
        if not question.demonstrations:
            replies[question.id] = question.reply(LETTERS[0])
            continue
        asked = features(_scene(question))
        best = max(question.demonstrations, key=lambda shown: similarity(asked, features(_scene(shown))))
        replies[question.id] = question.reply(best.answer, best.clauses or ())
    return replies


def _induced(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Learn rules from the examples with `logicity induce`, and apply them."""
    learned: dict[str, Inference] = {}
    replies = {}
    for question in questions:
        scenes = [
            {**_scene(shown), "actions": {_scene(shown)["ego"]: question.options[shown.answer]}}
            for shown in question.demonstrations
        ]
        if not scenes:
            raise ValueError("the solver `induced` needs solved examples: set `shots`, or leave it out of `solvers`")
        text = "".join(json.dumps(scene) + "\n" for scene in scenes)
        if text not in learned:
            learned[text] = Inference(config, _learn(text, config, path.with_name(f"{path.stem}-{len(learned)}")))
        answer = learned[text].answer(cast("Any", _scene(question)))
        # The learned clauses have no names in the rules, so the reply names none.
        replies[question.id] = f"Answer: {_letter(answer['egos'][_scene(question)['ego']]['action'])}"
    return replies


def _learn(scenes: str, config: str, path: Path) -> Path:
    """Learn rules from labeled scenes, and return the rule file."""
    examples, rules = path.with_suffix(".scenes"), path.with_suffix(".dl")
    with reserved(examples, record=False) as output:
        Path(output.temporary).write_text(scenes, encoding="utf-8")
        output.finish()
    _command("induce", str(examples), "--config", config, "--threads", "1", "--output", str(rules), "--force")
    return rules


def _oracle(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Apply the rules, and name the clause at the root of a shortest proof of the action."""
    inference = Inference(config)
    program = Program.load(questions[0].source["rules"])
    labels = {(Path(clause["file"]).name, clause["line"]): clause["label"] for clause in program.clauses}
    replies = {}
    for question in questions:
        scene = _scene(question)
        action = inference.answer(cast("Any", scene))["egos"][scene["ego"]]["action"]
        rules = []
        if question.labels and action in program.relations:
            session = Session(program)
            for name, rows in scene["facts"].items():
                if name in program.relations:
                    session.insert(name, [(row,) if isinstance(row, str) else tuple(row) for row in rows])
            session.commit()
            proof = session.explain(action, [scene["ego"]])
            if proof.holds:
                clause = proof.nodes[0]["clause"]
                rules = [labels[Path(clause["file"]).name, clause["line"]]]
        replies[question.id] = question.reply(_letter(action), rules)
    return replies


#: The solvers by name.
SOLVERS: dict[str, Solver] = {"majority": _majority, "nearest": _nearest, "induced": _induced, "oracle": _oracle}


def _letter(action: str) -> str:
    return LETTERS[ACTIONS.index(cast("Any", action))]


def _scene(question: Question | Demonstration) -> Mapping[str, Any]:
    """Return the facts of a question or an example."""
    if question.scene is None:
        raise ValueError("the questions lack scenes: write them again with `logicity questions`")
    return question.scene


def features(scene: Mapping[str, Any]) -> Counter[Any]:
    """Return the features of a scene: the number of entities with each label.

    The labels are those of the Weisfeiler-Lehman subtree kernel with one iteration (Shervashidze et al., 2011): first
    whether the entity is the ego, and its unary predicates; then also the labels of the entities to which a binary
    predicate relates it. They do not depend on the names of entities.
    """
    first: dict[str, list[str]] = {entity: ["ego"] if entity == scene["ego"] else [] for entity in scene["entities"]}
    pairs: list[tuple[str, str, str]] = []
    for predicate in sorted(scene["facts"]):
        for row in scene["facts"][predicate]:
            if isinstance(row, str):
                first[row].append(predicate)
            elif len(row) == 1:
                first[row[0]].append(predicate)
            else:
                pairs.append((predicate, *row))
    labels = {entity: tuple(sorted(names)) for entity, names in first.items()}
    around: dict[str, list[tuple[str, bool, tuple[str, ...]]]] = {entity: [] for entity in labels}
    for predicate, one, other in pairs:
        around[one].append((predicate, True, labels[other]))
        around[other].append((predicate, False, labels[one]))
    return Counter([*labels.values(), *((labels[entity], tuple(sorted(around[entity]))) for entity in labels)])


def similarity(one: Counter[Any], other: Counter[Any]) -> float:
    """Return the cosine of two vectors of features, from 0 to 1."""
    product = sum(count * other[label] for label, count in one.items())
    return product / math.sqrt(sum(n * n for n in one.values()) * sum(n * n for n in other.values()))


# --- runs


@dataclass(frozen=True)
class Work:
    """A unit with its questions and the file of its replies."""

    unit: Unit
    questions: Sequence[Question]
    path: Path

    def stored(self) -> int:
        """Return the number of stored replies.

        Raises:
            OSError: If the file cannot be read.
            ValueError: If a line is no reply.
        """
        if not self.path.exists():
            return 0
        found = set()
        # An interrupted process may leave an incomplete last line, which `ask` removes.
        for number, line in enumerate(self.path.read_bytes().split(b"\n")[:-1], 1):
            try:
                found.add(json.loads(line)["id"])
            except (ValueError, TypeError, KeyError, RecursionError):
                raise ValueError(f"{self.path}:{number}: not a reply\n{_remedy(self.path)}") from None
        return len(found & {question.id for question in self.questions})


def _remedy(path: Path) -> str:
    """Return the help for a file of replies with other content."""
    return f"help: remove `{path}`; the same command answers its questions again"


def prepare(experiment: LanguageExperiment, file: Path, units: Sequence[Unit], root: Path, jobs: int) -> list[Work]:
    """Write the questions of the units, which depend only on the experiment, and name the files of the replies.

    Raises:
        OSError: If a file cannot be written.
        ValueError: If `logicity questions` fails.
    """
    sets = list(dict.fromkeys((unit.prompt, unit.seed) for unit in units))

    def write(each: tuple[str, int]) -> list[Question]:
        prompt, seed = each
        return write_questions(experiment, file, prompt, seed, root / "questions" / f"{prompt}-{seed}.jsonl")

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        questions = dict(zip(sets, pool.map(write, sets), strict=True))
    work = []
    for unit in units:
        asked = questions[unit.prompt, unit.seed]
        spec = experiment.models.get(unit.row)
        if spec is None:
            source = asked[0].source
            more = {"version": _logicity.__version__, "config": source["config_hash"], "rules": source["rules_hash"]}
        else:
            more = {"model": spec.model, "settings": spec.settings, "logprobs": spec.logprobs}
        name = f"{unit.prompt}-{unit.seed}-{_identity(asked, more)}.jsonl"
        work.append(Work(unit, asked, root / "replies" / unit.row / name))
    return work


def answer(
    experiment: LanguageExperiment, file: Path, work: Sequence[Work], jobs: int, say: Callable[[str], None]
) -> dict[str, str]:
    """Answer the questions of all units that have no replies yet. Replies of models are stored one by one.

    Args:
        experiment: The experiment.
        file: Its file.
        work: The units.
        jobs: The number of units whose questions are answered at the same time.
        say: Receives lines of progress.

    Returns:
        The messages of the models that failed, by row.

    Raises:
        OSError: If a file cannot be written.
        ValueError: If a solver fails, or the settings of a model are invalid.
    """
    endpoints = {}
    for row, spec in experiment.models.items():
        if any(each.unit.row == row for each in work):
            try:
                endpoints[row] = spec.endpoint()
            except ValueError as error:
                raise ValueError(f"models.{row}: {error}") from None
    config = experiment.config_path(file)
    failed: dict[str, str] = {}
    lock, stop = threading.Lock(), threading.Event()
    done, shown = 0, time.monotonic()

    def watch(each: Work, answered: int) -> None:
        """Report the progress every `SECONDS`, and stop between two requests."""
        nonlocal shown
        if stop.is_set():
            raise InterruptedError
        with lock:
            if time.monotonic() - shown >= SECONDS:
                shown = time.monotonic()
                say(f"[{done}/{len(work)}] {each.unit}: {answered} of {len(each.questions)} replies")

    def wait(each: Work, seconds: float, reason: str) -> None:
        """Report a failed attempt, and wait before the next one."""
        if not stop.is_set():
            say(f"{each.unit}: {next(iter(reason.splitlines()), '')}; next attempt in {seconds:.0f} s")
        if stop.wait(seconds):
            raise InterruptedError

    def run_one(each: Work) -> None:
        nonlocal done
        unit, note = each.unit, ""
        if unit.row in endpoints:
            if unit.row in failed:
                return
            each.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                ask(each.questions, endpoints[unit.row], each.path, partial(watch, each), partial(wait, each))
            except ConnectionError as error:
                failed[unit.row] = str(error)
                note = f": failed: {error}"
            except ValueError as error:
                raise ValueError(f"{error}\n{_remedy(each.path)}") from None
        elif each.stored() < len(each.questions):
            each.path.parent.mkdir(parents=True, exist_ok=True)
            replies = SOLVERS[unit.row](each.questions, config, each.path.with_suffix(""))
            lines = [
                json.dumps({"id": question.id, "model": unit.row, "answer": replies[question.id]}) + "\n"
                for question in each.questions
            ]
            with reserved(each.path, record=False) as output:
                Path(output.temporary).write_text("".join(lines), encoding="utf-8")
                output.finish()
        with lock:
            done += 1
            say(f"[{done}/{len(work)}] {unit}{note}")

    with ThreadPoolExecutor(max_workers=jobs) as pool:
        try:
            for future in as_completed([pool.submit(run_one, each) for each in work]):
                future.result()
        except BaseException:
            # The stored replies remain.
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            say("stopping after the running requests")
            raise
    return failed


def run(
    experiment: LanguageExperiment,
    file: Path,
    units: Sequence[Unit],
    root: Path,
    jobs: int,
    action: Literal["run", "list", "report"] = "run",
) -> int:
    """Run the experiment for `logicity experiment`, and print its table.

    Args:
        experiment: The experiment.
        file: Its file.
        units: The units.
        root: The folder of the results.
        jobs: The number of units whose questions are answered at the same time.
        action: Whether to run the units, to list them, or to print the table of the stored replies.

    Returns:
        The exit code: 1 if a model failed.

    Raises:
        OSError: If a file cannot be read or written, or another process runs the experiment.
        ValueError: If the settings of a model are invalid, a solver fails, or a file of replies has other content.
    """
    failed: dict[str, str] = {}
    with exclusive(root) if action == "run" else nullcontext():
        work = prepare(experiment, file, units, root, jobs)
        if action == "list":
            for each in work:
                print(f"{each.stored():4} of {len(each.questions)} replies  {each.unit}  {each.path}")
            return 0
        if action == "run":
            failed = answer(experiment, file, work, jobs, lambda line: print(line, file=sys.stderr, flush=True))
        report = LanguageReport(experiment, work, failed)
        written = report.write(root)
    print(report.text())
    print(f"written: {', '.join(map(str, written))}")
    return int(bool(failed))


# --- report


@dataclass(frozen=True)
class Entry:
    """A row of a table.

    Attributes:
        row: The name of the solver or model.
        prompt: The prompt.
        seeds: The seeds of the sets of questions.
        grade: The measures over all sets; `None` if replies are missing.
        missing: Why there are no measures; empty if there are.
    """

    row: str
    prompt: str
    seeds: tuple[int, ...]
    grade: Grade | None
    missing: str


class LanguageReport:
    """The results of an experiment of language questions.

    Args:
        experiment: The experiment.
        work: The units, finished or not.
        failed: The messages of the models that failed, by row.
    """

    def __init__(
        self, experiment: LanguageExperiment, work: Sequence[Work], failed: Mapping[str, str] | None = None
    ) -> None:
        """Grade the replies. A row has measures if the replies to all its questions are stored."""
        self.experiment = experiment
        groups: dict[tuple[str, str], list[Work]] = {}
        for each in work:
            groups.setdefault((each.unit.prompt, each.unit.row), []).append(each)
        self.entries = [self._entry(group, failed or {}) for group in groups.values()]

    @staticmethod
    def _entry(group: Sequence[Work], failed: Mapping[str, str]) -> Entry:
        unit, seeds = group[0].unit, tuple(each.unit.seed for each in group)
        stored, total = sum(each.stored() for each in group), sum(len(each.questions) for each in group)
        if stored < total:
            reason = failed[unit.row].splitlines()[0] + "; " if unit.row in failed else ""
            return Entry(unit.row, unit.prompt, seeds, None, f"{reason}{stored} of {total} replies are stored")
        answers: dict[str, str] = {}
        logprobs: dict[str, dict[str, float]] = {}
        for each in group:
            answers |= load_answers(each.path)
            logprobs |= load_logprobs(each.path)
        questions = [question for each in group for question in each.questions]
        return Entry(unit.row, unit.prompt, seeds, grade(questions, answers, logprobs), "")

    @property
    def prompts(self) -> list[str]:
        """The prompts with an entry."""
        return list(dict.fromkeys(entry.prompt for entry in self.entries))

    def _paper(self, prompt: str) -> dict[str, list[float]]:
        """Return the rows of the paper. Its prompts have only solved examples."""
        rows: dict[str, list[float]] = paper_table(self.experiment.paper).get("rows", {})
        return rows if prompt == "examples" else {}

    def table(self, prompt: str) -> list[list[str]]:
        """Return the table of a prompt as text: a head, the rows of the experiment, and those of the paper."""
        entries = [entry for entry in self.entries if entry.prompt == prompt]
        grades = [entry.grade for entry in entries if entry.grade is not None]
        is_why = any(each.rules is not None for each in grades)
        is_calibrated = any(each.calibration is not None for each in grades)
        head = ["solver", *ACTIONS, "overall"]
        head += ["rule", "action and rule"] if is_why else []
        head += ["ECE", "Brier"] if is_calibrated else []
        lines = [[*head, "unread", "questions"]]
        for entry in entries:
            lines.append([entry.row, *_cells(entry.grade, is_why, is_calibrated)])
        for row, values in self._paper(prompt).items():
            shares = [f"{value / 100:.2f}" for value in values]
            lines.append([f"{row} (paper)", *shares, *[""] * (len(lines[0]) - 1 - len(shares))])
        return lines

    def text(self) -> str:
        """Return everything for a terminal."""
        parts = [self.experiment.title]
        for prompt in self.prompts:
            parts += [f"\n{TITLES[prompt]}", aligned(self.table(prompt))]
        return "\n".join([*parts, "", *self.notes()])

    def notes(self) -> list[str]:
        """Return sentences on the measures, missing rows and the paper."""
        sets = max((len(entry.seeds) for entry in self.entries), default=1)
        notes = [
            "Accuracy by correct action, with 95 % Wilson intervals over questions. Unread replies count as wrong."
            + (
                f" The questions of {sets} sets are pooled; sets have other solved examples, and the intervals do not "
                "account for differences between sets."
                if sets > 1
                else ""
            )
        ]
        if "why" in self.prompts:
            notes.append(
                "rule: the reply names a clause that derives the action, or `none` if the action is the default. "
                "A solver that names none has no figure."
            )
        if any(entry.grade is not None and entry.grade.calibration for entry in self.entries):
            notes.append(
                "ECE: expected calibration error in ten bins. Brier: mean squared distance of the probabilities of the "
                "options from the correct one, 0.75 for uniform ones. Both from log-probabilities."
            )
        table = paper_table(self.experiment.paper)
        if table and "examples" in self.prompts:
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        notes += [f"{entry.row}, {entry.prompt}: {entry.missing}." for entry in self.entries if entry.missing]
        return notes

    def markdown(self) -> str:
        """Return the report as Markdown."""
        parts = [f"# {self.experiment.title}\n"]
        for prompt in self.prompts:
            parts += [f"## {TITLES[prompt]}\n", markdown_table(self.table(prompt))]
        parts += ["## Notes\n", *(f"- {note}" for note in self.notes())]
        return "\n".join(parts) + "\n"

    def latex(self) -> str:
        """Return one table per prompt as LaTeX, with the rules of the package booktabs."""
        tables = []
        for prompt in self.prompts:
            head, *rows = self.table(prompt)
            columns = "l" + "c" * (len(head) - 1)
            lines = [f"% {self.experiment.title}: {TITLES[prompt]}", f"\\begin{{tabular}}{{{columns}}}", "\\toprule"]
            lines += [" & ".join(map(escaped, head)) + " \\\\", "\\midrule"]
            lines += [" & ".join(map(escaped, row)) + " \\\\" for row in rows]
            tables.append("\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n")
        return "\n".join(tables)

    def to_dict(self) -> dict[str, Any]:
        """Return the entries for JSON."""
        values = self.experiment.model_dump(mode="json", exclude={"models"})
        models = {
            name: spec.model_dump(mode="json", include={"model", "settings", "logprobs"})
            for name, spec in self.experiment.models.items()
        }
        return {
            "title": self.experiment.title,
            "experiment": {**values, "models": models},
            "entries": [
                {
                    "row": entry.row,
                    "prompt": entry.prompt,
                    "seeds": list(entry.seeds),
                    "grade": None if entry.grade is None else entry.grade.to_dict(),
                    "missing": entry.missing,
                }
                for entry in self.entries
            ],
            "paper": paper_table(self.experiment.paper),
            "notes": self.notes(),
        }

    def write(self, root: Path) -> list[Path]:
        """Write the tables, and the figure if matplotlib is installed.

        Raises:
            OSError: If a file cannot be written.
        """
        written = write_tables(root, self.markdown(), self.latex(), self.to_dict())
        if any(entry.grade is not None for entry in self.entries):
            written += self._figure(root)
        return written

    def _figure(self, root: Path) -> list[Path]:
        """Draw the accuracy of each row by prompt, and the paper's."""
        try:
            import matplotlib
            from matplotlib.figure import Figure
        except ImportError:
            return []
        with matplotlib.rc_context({"svg.hashsalt": "logicity"}):
            shown = [(prompt, list(self._bars(prompt))) for prompt in self.prompts]
            tallest = max(len(bars) for _, bars in shown)
            figure = Figure(figsize=(4.6 * len(shown), 1.2 + 0.32 * tallest), layout="constrained")
            for at, (prompt, bars) in enumerate(shown, 1):
                axes = figure.add_subplot(1, len(shown), at)
                axes.set_title(f"prompt: {prompt}", fontsize=10)
                for place, (_, value, low, high, color) in enumerate(bars):
                    reach = None if low is None or high is None else [[value - low], [high - value]]
                    axes.barh(place, value, xerr=reach, color=color, error_kw={"linewidth": 1})
                axes.axvline(0.25, color="#888888", linewidth=1, linestyle=":")
                axes.set_yticks(range(len(bars)), [name for name, *_ in bars], fontsize=8)
                axes.set_ylim(tallest - 0.5, -0.5)
                axes.set_xlim(0, 1.02)
                axes.set_xlabel("accuracy (dotted: chance)")
            return save_figure(figure, root, "accuracy")

    def _bars(self, prompt: str) -> Iterator[tuple[str, float, float | None, float | None, str]]:
        """Yield the name, the accuracy, its interval if any, and the color of each bar."""
        for entry in self.entries:
            if entry.prompt == prompt and entry.grade is not None:
                accuracy = entry.grade.overall.accuracy
                yield entry.row, accuracy.value, accuracy.low, accuracy.high, "#4878a8"
        for row, values in self._paper(prompt).items():
            yield f"{row} (paper)", values[-1] / 100, None, None, "#c44e52"


def _cells(measured: Grade | None, is_why: bool, is_calibrated: bool) -> list[str]:
    """Return the cells of a row after its name."""
    if measured is None:
        return ["-"] * (len(ACTIONS) + 3 + 2 * is_why + 2 * is_calibrated)
    by_action = [measured.by_action.get(action) for action in ACTIONS]
    cells = ["-" if recall is None else str(recall.accuracy) for recall in by_action]
    cells.append(str(measured.overall.accuracy))
    if is_why:
        named = [None if measured.named == 0 else each for each in (measured.rules, measured.both)]
        cells += ["-" if each is None else str(each.accuracy) for each in named]
    if is_calibrated:
        calibration = measured.calibration
        cells += ["-", "-"] if calibration is None else [f"{calibration.ece:.3f}", f"{calibration.brier:.3f}"]
    return [*cells, str(len(measured.unread)), str(measured.overall.total)]
