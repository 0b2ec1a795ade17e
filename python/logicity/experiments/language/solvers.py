"""Solvers of language questions that need no language model."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ...city import ACTIONS, Inference
from ...files import write_text
from ...learn.programs import run_program
from ...questions import LETTERS, NO_RULE, Demonstration, Question
from ...rules import Program, Session

__all__ = ["SOLVERS", "Solver", "features", "run_command", "similarity"]

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


#: What the words for a driver suggest, without any rule: the action by the predicate.
SHORTCUTS = {"IsTiro": "Slow", "IsReckless": "Fast"}


def _shortcut(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Choose what the concept of the car suggests: Slow for a beginner, Fast for the reckless; else as `majority`."""
    replies = _majority(questions, config, path)
    for question in questions:
        scene = _scene(question)
        suggested = [action for name, action in SHORTCUTS.items() if scene["ego"] in scene["facts"].get(name, ())]
        if len(suggested) == 1:
            # The words suggest no rule, so the reply names none.
            replies[question.id] = f"Answer: {_letter(suggested[0])}"
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
        shown = [(_scene(each), question.options[each.answer]) for each in question.demonstrations]
        if not shown:
            raise ValueError("the solver `induced` needs solved examples: set `shots`, or leave it out of `solvers`")
        text = "".join(json.dumps({**scene, "actions": {scene["ego"]: action}}) + "\n" for scene, action in shown)
        if text not in learned:
            learned[text] = Inference(config, _learn(text, config, path.with_name(f"{path.stem}-{len(learned)}")))
        # The learned clauses have no names in the rules, so the reply names none.
        replies[question.id] = f"Answer: {_letter(_action(learned[text], _scene(question)))}"
    return replies


def _learn(scenes: str, config: str, path: Path) -> Path:
    """Learn rules from labeled scenes, and return the rule file."""
    examples, rules = path.with_suffix(".scenes"), path.with_suffix(".dl")
    write_text(examples, scenes)
    run_command("induce", str(examples), "--config", config, "--threads", "1", "--output", str(rules), "--force")
    return rules


def _oracle(questions: Sequence[Question], config: str, path: Path) -> dict[str, str]:
    """Apply the rules, and name the clause at the root of a shortest proof of the action."""
    inference = Inference(config)
    program = Program.load(questions[0].source["rules"])
    labels = {(Path(clause["file"]).name, clause["line"]): clause["label"] for clause in program.clauses}
    replies = {}
    for question in questions:
        scene, rules = _scene(question), []
        action = _action(inference, scene)
        if question.labels and action in program.predicates:
            session = Session(program)
            for name, rows in scene["facts"].items():
                if name in program.predicates:
                    session.insert(name, [(row,) if isinstance(row, str) else tuple(row) for row in rows])
            session.commit()
            if (proof := session.explain(action, [scene["ego"]])).holds:
                clause = proof.nodes[0]["clause"]
                rules = [labels[Path(clause["file"]).name, clause["line"]]]
        replies[question.id] = question.reply(_letter(action), rules)
    return replies


#: The solvers by name.
SOLVERS: dict[str, Solver] = {
    "majority": _majority,
    "shortcut": _shortcut,
    "nearest": _nearest,
    "induced": _induced,
    "oracle": _oracle,
}


def _action(inference: Inference, scene: Mapping[str, Any]) -> str:
    return inference.answer(cast("Any", scene))["egos"][scene["ego"]]["action"]


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
    for predicate, rows in sorted(scene["facts"].items()):
        for row in rows:
            if isinstance(row, str) or len(row) == 1:
                first[row if isinstance(row, str) else row[0]].append(predicate)
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


def run_command(*arguments: str) -> None:
    """Run a command of this program.

    Raises:
        ValueError: If the command fails. The message is that of the command.
    """
    done = run_program([sys.executable, "-m", "logicity", *arguments])
    if done.code != 0:
        raise ValueError(f"`logicity {' '.join(arguments)}` failed:\n{done.log.strip()}")
