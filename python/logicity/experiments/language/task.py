"""Experiments of language questions: solvers of this package and language models, beside the paper's models.

`logicity questions` generates the questions. They are the same for each mode, which is a prompt. Solvers answer them
here, models over HTTP. All replies are files that `logicity grade` reads.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict, ValidationError

from ... import _logicity
from ..._logicity import __version__
from ...city import ACTIONS, Inference
from ...errors import did_you_mean
from ...evaluation import Interval
from ...files import write_text
from ...learn.faults import Fault, faults
from ...learn.settings import Count, StrictModel
from ...questions import (
    LETTERS,
    NO_RULE,
    UNREAD,
    Endpoint,
    Question,
    ask,
    calibrate,
    fingerprint,
    key_from,
    load_answers,
    load_logprobs,
    load_questions,
    read_letter,
    read_rule,
)
from ...redaction import masked, shown_url
from ...rules import Program
from ...tasks import files_hash
from ..experiment import Experiment, Place, Selection, changes_of, option_error, place_of, unknown_in
from ..statistics import grouped, pooled_shares
from ..task import Cell, CellKey, Running, Task
from .solvers import SOLVERS, run_command

__all__ = ["EndpointSettings", "LanguageExperiment", "LanguageQuestions", "LanguageSettings", "graded"]

#: The version of what determines a cell.
FORMAT = 2

#: The environment variable with the endpoint, whose address and settings may have secrets.
ENDPOINT = "LOGICITY_ENDPOINT"

#: What the instructions of a question state and request: the values of `logicity questions --prompt`.
PROMPTS = {
    "examples": "only solved examples show the rules",
    "rules": "the instructions state the rules in words",
    "why": "the instructions state the rules and request the rule that requires the action",
}


class EndpointSettings(StrictModel):
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
        """Return the endpoint. Raises `ValueError` for an invalid setting, or if the variable of the key is not set."""
        try:
            key = key_from(self.key_from)
        except ValueError as error:
            raise ValueError(f"`key_from`: {error}") from None
        settings = {**self.settings, **({"logprobs": True, "top_logprobs": 20} if self.logprobs else {})}
        return Endpoint(self.url, self.model, key, settings, self.timeout, self.tries)


class LanguageSettings(StrictModel):
    """The questions of a set, and who answers them."""

    config: str = "vap-hard"
    """The configuration: the name of a built-in one, or a path relative to the file of the experiment."""
    count: Annotated[int, Field(strict=True, ge=1, le=20_000)] = 117
    """The number of questions of a set."""
    about: Annotated[tuple[str, ...], Strict(False)] = ()
    """The concepts of the cars in the questions: each car has at least one of them. Empty for all cars."""
    shots: Annotated[int, Field(strict=True, ge=0, le=100)] = 5
    """The number of solved examples before each question."""
    mix: Literal["equal", "paper", "by-concept"] = "equal"
    """How often each answer is correct: all equally often, in the proportions of the paper, or equally often among the
    cars with the same concepts."""
    style: Literal["atoms", "words", "paper", "picture"] = "atoms"
    """The form of the facts: ground atoms, English sentences, the paper's prompt, or a picture."""
    entities: Literal["view", "city"] = "view"
    """The entities of a question: those that the car sees, or all of the city."""
    solver: Literal["majority", "shortcut", "nearest", "induced", "oracle"] | None = None
    """The solver of this package that answers. By default the one with the name of the row."""
    endpoint: EndpointSettings | None = None
    """The language model that answers instead of a solver."""


class LanguageExperiment(Experiment):
    """An experiment of language questions."""

    task: Literal["language"]
    """The task, language questions."""
    paper: Literal["language"] | None = None
    """The table of the paper whose figures are shown beside the results."""
    modes: Annotated[
        tuple[Literal["examples", "rules", "why"], ...], Field(strict=False, min_length=1, validate_default=True)
    ] = ("examples", "rules", "why")
    """The prompts: what the instructions state and request. Only solved examples, also the rules in words, or also a
    request for the rule of the action. The questions are the same."""


class LanguageQuestions(Task):
    """Solvers and language models that answer questions, see `Task`."""

    name = "language"
    title = "Language questions"
    experiment = LanguageExperiment
    settings_class = LanguageSettings
    measures: ClassVar[Mapping[str, str]] = {
        **{action: action for action in ACTIONS},
        **{"overall": "overall", "rule": "rule", "both": "action and rule", "ece": "ECE", "brier": "Brier"},
    }
    main_measures = len(ACTIONS) + 1
    mode_titles = PROMPTS
    mode_word = "prompt"
    headline = "overall"
    measured_on = "questions"
    model_file = "replies.jsonl"
    sampled = "replies"
    interval_note = (
        "Accuracy by correct action. The 95 % intervals are percentiles of a bootstrap that draws sets and, in each, "
        "worlds: sets differ in their examples, and questions about one world are alike. Shares of 0 and 1 have Wilson "
        "intervals over the worlds. Unread replies count as wrong. rule: the reply names a "
        f"clause that derives the action, or `{NO_RULE}` if the action is the default. ECE: expected calibration "
        "error in ten bins. Brier: mean squared distance of the probabilities of the options from the correct one, "
        "0.75 for uniform ones."
    )
    details_title = "Share of replies that choose no option or several"
    paper = "language"
    chance = 1 / len(LETTERS)

    def setting_faults(
        self, experiment: LanguageExperiment, file: Path, row: str, variant: str, places: Sequence[Place]
    ) -> Iterator[Fault]:
        """Yield the errors in settings."""
        own = experiment.variants[variant].mode if variant in experiment.variants else None
        modes = (own,) if own else experiment.learners[row].modes or experiment.modes
        for code, path, message, help in _faults(row, changes_of(places), file, modes):
            missing = path[-1:] * (code == "missing-key")
            at = place_of(places, path[: -len(missing) or None]) or ["learners", row]
            yield code, [*at, *missing], message, help

    def settings(
        self, experiment: Any, file: Path, key: CellKey, selection: Selection, *, started: bool, check: bool
    ) -> LanguageSettings:
        """Return the settings of a cell, with its solver if it has no endpoint."""
        values = changes_of(experiment.places(key.row, key.variant, selection.quick, {"count": 8}), selection.changes)
        for fault in _faults(key.row, values, file, (key.mode,)):
            raise option_error(fault)
        settings = LanguageSettings.model_validate(values)
        solver = key.row if settings.endpoint is None and settings.solver is None else settings.solver
        return settings.model_copy(update={"solver": solver, "config": _config_path(settings.config, file)})

    def spec(self, cell: Cell) -> dict[str, Any]:
        """Return the settings, rules and version. Those of a request have no secrets, and no address."""
        settings = cell.settings.model_dump(mode="json")
        config = settings.pop("config")
        if settings["endpoint"] is not None:
            shown = masked({key: settings["endpoint"][key] for key in ("model", "settings", "logprobs")})
            # Another row can ask the same model on another server.
            settings["endpoint"] = {"row": cell.row, **shown}
        return {
            "format": FORMAT,
            "version": __version__,
            "prompt": cell.mode,
            "seed": cell.seed,
            "settings": {"config": Path(config).name, **settings},
            "rules": files_hash(config),
        }

    def document(self, cell: Cell, root: Path) -> dict[str, Any]:
        """Return the path of the configuration, and the endpoint without what may be a secret."""
        settings: dict[str, Any] = cell.settings.model_dump(mode="json", include={"config", "endpoint"})
        if (endpoint := settings["endpoint"]) is not None:
            # The key can stand in place of its variable by mistake.
            endpoint |= {"url": shown_url(endpoint["url"]), "settings": masked(endpoint["settings"]), "key_from": None}
        return settings

    def environment(self, cell: Cell) -> dict[str, str]:
        """Return the endpoint."""
        endpoint = cell.settings.endpoint
        return {} if endpoint is None else {ENDPOINT: endpoint.model_dump_json()}

    def steps(self, cell: Cell) -> int:
        """Return the number of questions."""
        return int(cell.settings.count)

    def run(self, running: Running) -> dict[str, Any]:
        """Write the questions, have them answered, and grade the replies."""
        spec, document, folder = running.document["spec"], running.document, running.folder
        config, settings = document["config"], spec["settings"]
        self.check_unchanged(spec, {"rules": files_hash(config)})
        begun = sum(os.times()[:4])
        keys = ("count", "shots", "mix", "style", "entities")
        options = [text for key in keys for text in (f"--{key}", str(settings[key]))]
        about = ["--about", ",".join(settings["about"])] if settings["about"] else []
        path, replies = folder / "questions.jsonl", self.model(folder)
        asked = ["--prompt", spec["prompt"], "--seed", str(spec["seed"]), "--output", str(path), "--force"]
        run_command("questions", config, *options, *about, *asked)
        questions = load_questions(path)
        if document["endpoint"] is not None:
            given = os.environ.get(ENDPOINT, json.dumps(document["endpoint"]))
            _ask(questions, EndpointSettings.model_validate_json(given), replies, running)
        elif not replies.exists():
            answers = SOLVERS[settings["solver"]](questions, config, folder / "solved")
            lines = ({"id": each.id, "model": settings["solver"], "answer": answers[each.id]} for each in questions)
            write_text(replies, "".join(json.dumps(line) + "\n" for line in lines))
        running.report(len(questions))
        result = {
            "settings": settings,
            "seed": spec["seed"],
            # With the programs that it ran.
            "cpu_seconds": round(sum(os.times()[:4]) - begun, 1),
            "versions": {"logicity": __version__, "python": platform.python_version()},
            "hashes": {"rules": spec["rules"]},
        }
        return {"result": result, "evaluations": {"": {"replies": graded(questions, replies)}}}

    def measure_again(self, cell: Cell, root: Path) -> dict[str, dict[str, Any]]:
        """Grade the replies."""
        folder = cell.folder(root)
        return {"": {"replies": graded(load_questions(folder / "questions.jsonl"), self.model(folder))}}

    def hashed(self, cell: Cell, root: Path) -> tuple[str, str]:
        """Return the hash of the replies by question."""
        answers = sorted(load_answers(self.model(cell.folder(root))).items())
        return "replies", hashlib.sha256(json.dumps(answers).encode()).hexdigest()

    def intervals(self, evaluations: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
        """Return the measures over the questions of all sets, each question once."""
        sets = _without_repetition(evaluations)
        replies = [reply for each in sets for reply in each]
        named = any(reply.get("rule") is not None for reply in replies)
        result = pooled_shares([_by_world(each, named) for each in sets])
        questions = [Question(str(at), "", (), "", {}, reply["answer"]) for at, reply in enumerate(replies)]
        logprobs = {str(at): reply["logprobs"] for at, reply in enumerate(replies) if "logprobs" in reply}
        if (calibration := calibrate(questions, logprobs)) is not None:
            for name, value in (("ece", calibration.ece), ("brier", calibration.brier)):
                result[name] = Interval(value, value, value)
        return result

    def remarks(self, evaluations: Sequence[Mapping[str, Any]]) -> Iterator[str]:
        """Yield the number of questions that several sets have."""
        count = sum(len(each["replies"]) for each in evaluations)
        if repeated := count - sum(map(len, _without_repetition(evaluations))):
            yield f"{repeated} of the {count} questions of a row are also in an earlier of its sets and count once."

    def details(self, measured: Mapping[str, Any], name: str) -> dict[str, float]:
        """Return the share of unread replies, if there are any."""
        replies = measured["evaluations"][name]["replies"]
        unread = sum(reply["chosen"] == UNREAD for reply in replies)
        return {"unread": unread / len(replies)} if unread else {}

    def row_faults(self, row: Mapping[str, Any], experiment: LanguageExperiment) -> Iterator[str]:
        """Yield other rules than today's, and measures that do not follow from the samples."""
        if row["hashes"].get("rules") != files_hash(row["settings"]["config"]):
            yield "other rules"
        measures, recorded = self.intervals([self.evaluation_of(row)]), row["measures"]
        if measures.keys() != recorded.keys():
            yield "other measures"
            return
        for name, each in measures.items():
            if not np.allclose([recorded[name][key] for key in vars(each)], [*vars(each).values()], rtol=0, atol=1e-6):
                yield f"another {name}"


def _without_repetition(evaluations: Sequence[Mapping[str, Any]]) -> list[list[dict[str, Any]]]:
    """Return the replies of each set that has any to questions that did not come before."""
    first: dict[str, tuple[int, dict[str, Any]]] = {}
    for at, each in enumerate(evaluations):
        for reply in each["replies"]:
            first.setdefault(reply["scene"], (at, reply))
    return list(grouped(first.values()).values())


def _by_world(replies: Sequence[Mapping[str, Any]], named: bool) -> dict[str, NDArray[np.float64]]:
    """Return the number of right replies and of all replies for each measure by world, (W, 2).

    `named` is whether to measure rules, too.
    """
    worlds = list(dict.fromkeys(reply["world"] for reply in replies))
    tables = {name: np.zeros((len(worlds), 2)) for name in (*ACTIONS, "overall", *(("rule", "both") if named else ()))}
    for reply in replies:
        right = reply["chosen"] == reply["answer"]
        counted = {ACTIONS[LETTERS.index(reply["answer"])]: right, "overall": right}
        if named:
            counted |= {"rule": reply["derived"], "both": right and reply["derived"]}
        for name, success in counted.items():
            tables[name][worlds.index(reply["world"])] += (success, 1)
    return tables


def graded(questions: Sequence[Question], path: Path) -> list[dict[str, Any]]:
    """Return the replies in a file as they count.

    Each has the letters of the correct and of the chosen option, or `unread`, and the world and the fingerprint of the
    question. If the question requests a rule, it has the name of the rule, or `None` without one, and whether it
    derives the action. If there are log-probabilities of options, it has them.
    """
    answers, logprobs, replies = load_answers(path), load_logprobs(path), []
    for question in questions:
        if question.scene is None:
            raise ValueError(f"the question `{question.id}` has no scene: write it again with `logicity questions`")
        chosen = read_letter(answers[question.id]) or UNREAD
        world, scene = question.source["world"], fingerprint(question.scene)
        reply: dict[str, Any] = {"answer": question.answer, "chosen": chosen, "world": world, "scene": scene}
        if question.labels:
            rule = read_rule(answers[question.id], question.labels)
            reply |= {"rule": rule, "derived": rule in (question.clauses or (NO_RULE,))}
        if question.id in logprobs:
            reply["logprobs"] = logprobs[question.id]
        replies.append(reply)
    return replies


def _ask(questions: Sequence[Question], spec: EndpointSettings, path: Path, running: Running) -> None:
    def wait(seconds: float, reason: str) -> None:
        running.note(f"{reason}; next attempt in {seconds:.0f} s")
        time.sleep(seconds)

    try:
        ask(questions, spec.endpoint(), path, running.report, wait)
    except ValueError as error:
        raise ValueError(f"{error}\nhelp: remove `{path}`; the same command asks its questions again") from None


def _faults(row: str, values: Mapping[str, Any], file: Path, modes: Sequence[str]) -> Iterator[Fault]:
    """Yield the errors in the settings of a row with some prompts, by their paths."""
    try:
        settings = LanguageSettings.model_validate(values)
    except ValidationError as error:
        yield from faults(error, unknown_in(LanguageSettings))
        return
    if settings.endpoint is None and settings.solver is None and row not in SOLVERS:
        message = f"`{row}` is no solver{did_you_mean(row, SOLVERS)}: set `endpoint` for a model, or `solver`"
        yield "missing-key", ["solver"], message, ""
    config = _config_path(settings.config, file)
    try:
        # Checks the configuration, its predicates and its rules.
        Inference(config)
        found = _logicity.ConfigFile(config, "configs")
    except FileNotFoundError as error:
        message, _, help = str(error).partition("; ")
        yield "missing-file", ["config"], message, help
        return
    concepts, actions = _car_concepts(found), _actions(found)
    for at, name in enumerate(settings.about):
        if concepts is not None and name not in concepts:
            message = f"`{settings.config}` has no car concept `{name}`"
            yield "invalid-value", ["about", str(at)], message, did_you_mean(name, concepts).removeprefix("; ")
    if 0 < settings.shots < len(actions):
        message = f"{settings.shots} solved examples cannot cover all actions of the rules: {', '.join(actions)}"
        yield "invalid-value", ["shots"], message, "use 0, or at least one per action"
    if settings.mix == "paper" and (lacking := [action for action in ACTIONS if actions and action not in actions]):
        message = f"the rules never require {' or '.join(lacking)}, but the paper's mix has all four answers"
        yield "invalid-value", ["mix"], message, "use the mix `equal`"
    if settings.style == "paper" and (settings.shots == 0 or any(mode != "examples" for mode in modes)):
        message = "the paper's prompt has solved examples and does not state the rules"
        yield "invalid-value", ["style"], message, "use the mode `examples` with at least one example per action"


def _config_path(config: str, file: Path) -> str:
    """Return the configuration as commands take it."""
    return str((file.parent / config).resolve()) if Path(config).suffix else config


def _part(file: _logicity.ConfigFile, key: str) -> Path | None:
    """Return the path of the file that a key of a configuration names, or `None` if it has another value."""
    name = file.value().get(key)
    if not isinstance(name, str):
        return None
    folder = Path(file.file_of([key]) or "").parent
    return Path(os.path.normpath(folder / name)) if Path(name).suffix else Path(name)


def _car_concepts(file: _logicity.ConfigFile) -> list[str] | None:
    """Return the concepts of cars in a configuration, or `None` if its predicates are not in a separate file."""
    # `logicity questions` reports unknown concepts in other files.
    if (path := _part(file, "predicates")) is None:
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
    return [action for action in ACTIONS if action in heads | {file.value()["actions"]["default"]}]
