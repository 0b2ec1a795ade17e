"""The experiment of language questions: solvers of this package and language models, beside the paper's models.

`logicity questions` generates the questions. They are the same for each prompt: with solved examples only, with the
rules in words, and with a request for the rule that requires the action. Solvers answer them here, models over HTTP.
All answers are files that `logicity grade` reads.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, Strict, ValidationError, field_validator

from ... import _logicity
from ...city import ACTIONS, Inference
from ...errors import did_you_mean
from ...files import check_readable, write_text
from ...learn.faults import Fault, contains, faults, merged
from ...learn.settings import Count, StrictModel
from ...questions import Endpoint, Question, ask, key_from, load_questions
from ...rules import Program
from ...terminal import print_message, print_text
from ..jobs import exclusive
from ..spf.experiment import option_error, read_experiment, repeated
from .report import LanguageReport
from .solvers import SOLVERS, run_command

__all__ = ["LanguageExperiment", "ModelSpec", "Unit", "is_language", "run"]

#: What the instructions of a question state and request: the values of `logicity questions --prompt`.
Prompt = Literal["examples", "rules", "why"]

#: The interval between two lines of progress, in seconds.
SECONDS = 30.0

#: Changes for `--quick`.
QUICK: dict[str, Any] = {"count": 8}

#: A seed of `logicity questions`.
_QuestionSeed = Annotated[int, Field(strict=True, ge=0, lt=2**64)]
_Names = Annotated[tuple[str, ...], Strict(False)]
_Solver = Literal["majority", "nearest", "induced", "oracle"]


class ModelSpec(StrictModel):
    """A language model with an OpenAI-compatible endpoint."""

    url: str
    """The base URL, such as `http://localhost:8000/v1`."""
    model: str
    """The name of the model on the server."""
    key_from: str | None = None
    """The environment variable with the API key. By default no key is sent."""
    settings: dict[str, Any] = Field(default_factory=lambda: {"temperature": 0})
    """More fields of the request. By default `temperature: 0`."""
    logprobs: bool = False
    """Whether to request log-probabilities of the 20 most probable tokens, for the measures of calibration."""
    timeout: Annotated[float, Field(strict=False, gt=0)] = 120.0
    """The time for an attempt, in seconds: from the name of the server to the end of the reply."""
    tries: Count = 6
    """The largest number of attempts per request."""

    def endpoint(self) -> Endpoint:
        """Return the endpoint.

        Raises:
            ValueError: If a setting is invalid, or the environment variable of the key is not set.
        """
        try:
            key = key_from(self.key_from)
        except ValueError as error:
            raise ValueError(f"`key_from`: {error}") from None
        settings = {**self.settings, **({"logprobs": True, "top_logprobs": 20} if self.logprobs else {})}
        return Endpoint(self.url, self.model, key, settings, self.timeout, self.tries)


class LanguageExperiment(StrictModel):
    """An experiment of language questions: what `logicity experiment` runs."""

    task: Literal["language"]
    """The task, language questions."""
    title: str
    """The title of the table."""
    paper: Literal["language"] | None = None
    """The table of the paper whose figures are shown beside the results."""
    config: str = "vap-hard"
    """The configuration: the name of a built-in one, or a path relative to this file."""
    count: Annotated[int, Field(strict=True, ge=1, le=20_000)] = 117
    """The number of questions of a set."""
    about: _Names = ()
    """The concepts of the cars in the questions: each car has at least one of them. Empty for all cars."""
    shots: Annotated[int, Field(strict=True, ge=0, le=100)] = 5
    """The number of solved examples before each question."""
    style: Literal["atoms", "words"] = "atoms"
    """The form of the facts: ground atoms, or English sentences."""
    entities: Literal["view", "city"] = "view"
    """The entities of a question: those that the car sees, or all of the city."""
    seeds: Annotated[tuple[_QuestionSeed, ...], Strict(False), Field(min_length=1)] = (0,)
    """The seeds of the sets of questions. Each set has other questions and other solved examples."""
    prompts: Annotated[tuple[Prompt, ...], Strict(False), Field(min_length=1)] = ("examples", "rules", "why")
    """What the instructions state and request: solved examples only, also the rules in words, or also a request for the
    rule of the action. The questions are the same."""
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

    @field_validator("prompts", "seeds", "solvers")
    @classmethod
    def _check_repeated(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        if message := repeated(values):
            raise ValueError(message)
        return values

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
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key; or if the
                configuration that it names is invalid.
            OSError: If the file cannot be read.
            ValueError: If the changes have an unknown key or invalid value.
        """
        path, file, written = read_experiment(name)
        values = written
        if quick:
            values = merged(values, QUICK)
            if isinstance(values.get("seeds"), list):
                values["seeds"] = values["seeds"][:1]
        values = merged(values, changes or {})
        try:
            experiment = cls.model_validate(values)
            wrong = list(experiment._faults(path))
        except ValidationError as error:
            wrong = faults(error, _unknown, depth=3)
        if not wrong:
            return experiment, path
        of_changes = [fault for fault in wrong if _is_changed(fault, written, changes or {})]
        if len(of_changes) < len(wrong):
            raise file.error([fault for fault in wrong if fault not in of_changes])
        # A misspelled key may also cause a missing one.
        first = min(wrong, key=lambda fault: fault[0] == "missing-key")
        raise option_error(first)

    def _faults(self, file: Path) -> Iterator[Fault]:
        """Yield the errors that types do not exclude: no rows, and values that do not fit the configuration.

        Raises:
            InputError: If the configuration is invalid.
        """
        if not self.solvers and not self.models:
            yield "invalid-value", ["solvers"], "no solver and no model answers the questions: name one", ""
        config = self.config_path(file)
        try:
            # Checks the configuration, its predicates and its rules.
            Inference(config)
            found = _logicity.ConfigFile(config, "configs")
        except FileNotFoundError as error:
            message, _, help = str(error).partition("; ")
            yield "missing-file", ["config"], message, help
            return
        concepts, actions = _car_concepts(found), _actions(found)
        for at, name in enumerate(self.about):
            if concepts is not None and name not in concepts:
                message = f"`{self.config}` has no car concept `{name}`"
                yield "invalid-value", ["about", str(at)], message, did_you_mean(name, concepts).removeprefix("; ")
        if 0 < self.shots < len(actions):
            message = f"{self.shots} solved examples cannot cover all actions of the rules: {', '.join(actions)}"
            yield "invalid-value", ["shots"], message, "use 0, or at least one per action"

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
            for prompt in self.prompts
            for row in rows
            if not only or (row, None) in only or (row, prompt) in only
            for seed in seeds or self.seeds
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


def _part(file: _logicity.ConfigFile, key: str) -> Path | None:
    """Return the path of the file that a key of a configuration names, or `None` if it has another value."""
    name = file.value().get(key)
    if not isinstance(name, str):
        return None
    folder = Path(file.file_of([key]) or "").parent
    return Path(os.path.normpath(folder / name)) if Path(name).suffix else Path(name)


def _car_concepts(file: _logicity.ConfigFile) -> list[str] | None:
    """Return the concepts of cars in a configuration, or `None` if its predicates are not in a separate file."""
    path = _part(file, "predicates")
    if path is None:
        # `logicity questions` reports unknown concepts.
        return None
    try:
        predicates = _logicity.ConfigFile(path, "configs/predicates").value()
    except FileNotFoundError:
        return None
    defined = predicates.get("define") or {}
    used = predicates.get("use") or defined
    definitions = [each for name, each in defined.items() if name in used and isinstance(each, dict)]
    return [each["concept"] for each in definitions if each.get("concept") and each.get("of") == "Car"]


def _actions(file: _logicity.ConfigFile) -> list[str]:
    """Return the actions that the rules of a configuration derive, and the default action."""
    path = _part(file, "rules")
    try:
        heads = set() if path is None else {clause["head"] for clause in Program.load(path).clauses}
    except FileNotFoundError:
        return []
    default = file.value()["actions"]["default"]
    return [action for action in ACTIONS if action in heads or action == default]


def _is_changed(fault: Fault, written: Mapping[str, Any], changes: Mapping[str, Any]) -> bool:
    """Return whether changes cause a fault, not the written values. A missing key is missing in a changed mapping."""
    code, path, _, _ = fault
    if code == "missing-key":
        return contains(changes, path[:-1]) and not contains(written, path[:-1])
    return contains(changes, path)


def _unknown(path: tuple[str, ...]) -> tuple[str, str]:
    """Return the message and the help for an unknown key."""
    model: type[BaseModel] = ModelSpec if path[0] == "models" and len(path) > 1 else LanguageExperiment
    return f"unknown key `{path[-1]}`", did_you_mean(path[-1], model.model_fields).removeprefix("; ")


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
    run_command("questions", experiment.config_path(file), *options, *about, "--output", str(path), "--force")
    return load_questions(path)


def _identity(questions: Sequence[Question], more: Mapping[str, Any]) -> str:
    """Return a name of questions and of what else determines the replies to them."""
    content = [[question.id, question.messages()] for question in questions]
    text = json.dumps([content, more], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


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
            ValueError: If a line is not a reply.
        """
        if not self.path.exists():
            return 0
        found = set()
        check_readable(self.path)
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
            say(f"{each.unit}: {reason}; next attempt in {seconds:.0f} s")
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
            write_text(each.path, "".join(lines))
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
                print_text(f"{each.stored():4} of {len(each.questions)} replies  {each.unit}  {each.path}")
            return 0
        if action == "run":
            failed = answer(experiment, file, work, jobs, print_message)
        report = LanguageReport(experiment, work, failed)
        written = report.write(root)
    print_text(report.text())
    print_text(f"written: {', '.join(map(str, written))}")
    return int(bool(failed))
