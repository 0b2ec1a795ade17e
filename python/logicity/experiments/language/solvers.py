"""Solvers of language questions that need no language model."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ...city import ACTIONS, Inference
from ...files import write_text
from ...learn.programs import run_program
from ...questions import LETTERS, NO_RULE, Demonstration, Question, facts_of
from ...rules import Program, Session

__all__ = ["SOLVERS", "Solver", "features", "run_command", "similarity"]

#: Answers questions by a configuration: replies by id. The path, without its ending, is that of files to write.
Solver = Callable[[Sequence[Question], str, Path], dict[str, str]]


def _majority(questions: Sequence[Question], config: str, path: Path) -> Iterator[str]:
    """Choose the most frequent answer of the examples; of equally frequent ones, the first option."""
    for question in questions:
        shown = question.demonstrations
        counts = Counter(each.answer for each in shown)
        answer = max(LETTERS, key=lambda letter: counts[letter])
        rules = Counter(each.clauses[0] if each.clauses else NO_RULE for each in shown if each.answer == answer)
        yield question.reply(answer, [rule for rule, _ in rules.most_common(1)])


#: What the words for a driver suggest, without any rule: the action by the predicate.
SHORTCUTS = {"IsTiro": "Slow", "IsReckless": "Fast"}


def _shortcut(questions: Sequence[Question], config: str, path: Path) -> Iterator[str]:
    """Choose what the concept of the car suggests: Slow for a beginner, Fast for the reckless; else as `majority`."""
    for question, usual in zip(questions, _majority(questions, config, path), strict=True):
        scene = _scene(question)
        suggested = [action for name, action in SHORTCUTS.items() if scene["ego"] in scene["facts"].get(name, ())]
        # The words suggest no rule, so the reply names none.
        yield f"Answer: {_letter(suggested[0])}" if len(suggested) == 1 else usual


def _nearest(questions: Sequence[Question], config: str, path: Path) -> Iterator[str]:
    """Choose the answer of the example with the most similar scene; of equally similar ones, the first."""
    for question in questions:
        asked, first = features(_scene(question)), Demonstration("", LETTERS[0])
        best = max(question.demonstrations, key=lambda shown: similarity(asked, features(_scene(shown))), default=first)
        yield question.reply(best.answer, best.clauses or ())


def _induced(questions: Sequence[Question], config: str, path: Path) -> Iterator[str]:
    """Learn rules from the examples with `logicity induce`, and apply them."""
    learned: dict[str, Inference] = {}
    for question in questions:
        shown = [(_scene(each), question.options[each.answer]) for each in question.demonstrations]
        if not shown:
            raise ValueError("the solver `induced` needs solved examples: set `shots`, or leave it out of `solvers`")
        text = "".join(json.dumps({**scene, "actions": {scene["ego"]: action}}) + "\n" for scene, action in shown)
        if text not in learned:
            stem = f"{path.stem}-{len(learned)}"
            examples, rules = path.with_name(f"{stem}.scenes"), path.with_name(f"{stem}.dl")
            write_text(examples, text)
            options = ["--config", config, "--threads", "1", "--output", str(rules), "--force"]
            run_command("induce", str(examples), *options)
            learned[text] = Inference(config, rules)
        # The learned clauses have no names in the rules, so the reply names none.
        yield f"Answer: {_letter(_action(learned[text], _scene(question)))}"


def _oracle(questions: Sequence[Question], config: str, path: Path) -> Iterator[str]:
    """Apply the rules, and name the clause at the root of a shortest proof of the action."""
    inference = Inference(config)
    program = Program.load(questions[0].source["rules"])
    labels = {(Path(clause["file"]).name, clause["line"]): clause["label"] for clause in program.clauses}
    for question in questions:
        scene, rules = _scene(question), []
        action = _action(inference, scene)
        if question.labels and action in program.predicates:
            session = Session(program)
            for name, arguments in facts_of(scene):
                if name in program.predicates:
                    session.insert(name, [arguments])
            session.commit()
            if (proof := session.explain(action, [scene["ego"]])).holds:
                clause = proof.nodes[0]["clause"]
                rules = [labels[Path(clause["file"]).name, clause["line"]]]
        yield question.reply(_letter(action), rules)


def _by_id(replies: Callable[[Sequence[Question], str, Path], Iterator[str]]) -> Solver:
    return lambda questions, *given: {
        question.id: reply for question, reply in zip(questions, replies(questions, *given), strict=True)
    }


#: The solvers by name.
SOLVERS = {
    "majority": _by_id(_majority),
    "shortcut": _by_id(_shortcut),
    "nearest": _by_id(_nearest),
    "induced": _by_id(_induced),
    "oracle": _by_id(_oracle),
}


def _action(inference: Inference, scene: Mapping[str, Any]) -> str:
    return inference.answer(cast("Any", scene))["egos"][scene["ego"]]["action"]


def _letter(action: str) -> str:
    return LETTERS[ACTIONS.index(cast("Any", action))]


def _scene(question: Question | Demonstration) -> Mapping[str, Any]:
    if question.scene is None:
        raise ValueError("the questions lack scenes: write them again with `logicity questions`")
    return question.scene


def features(scene: Mapping[str, Any]) -> Counter[Any]:
    """Return the features of a scene: the number of entities with each label.

    The labels are those of the Weisfeiler-Lehman subtree kernel with one iteration (Shervashidze et al., 2011): first
    whether the entity is the ego, and its unary predicates; then also the labels of the entities to which a binary
    predicate relates it. They do not depend on the names of entities.
    """
    first: dict[str, list[str]] = {entity: ["ego"] * (entity == scene["ego"]) for entity in scene["entities"]}
    facts = list(facts_of(scene))
    for predicate, arguments in facts:
        if len(arguments) == 1:
            first[arguments[0]].append(predicate)
    labels = {entity: tuple(sorted(names)) for entity, names in first.items()}
    around: dict[str, list[tuple[str, bool, tuple[str, ...]]]] = {entity: [] for entity in labels}
    for predicate, arguments in facts:
        if len(arguments) == 2:
            one, other = arguments
            around[one].append((predicate, True, labels[other]))
            around[other].append((predicate, False, labels[one]))
    return Counter([*labels.values(), *((labels[entity], tuple(sorted(around[entity]))) for entity in labels)])


def similarity(one: Counter[Any], other: Counter[Any]) -> float:
    """Return the cosine of two vectors of features, from 0 to 1."""
    product = sum(count * other[label] for label, count in one.items())
    return product / math.sqrt(sum(n * n for n in one.values()) * sum(n * n for n in other.values()))


def run_command(*arguments: str) -> None:
    """Run a command of this program. Raises `ValueError` with its message if it fails."""
    done = run_program([sys.executable, "-m", "logicity", *arguments])
    if done.code != 0:
        raise ValueError(f"`logicity {' '.join(arguments)}` failed:\n{done.log.strip()}")
