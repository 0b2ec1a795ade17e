"""The layout of observations, and Markdown tables of the environments, both generated from the tasks."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from . import _logicity
from .city import ACTIONS, HEADINGS
from .evaluation import load_task
from .modes import ENVIRONMENTS

__all__ = ["Atom", "atoms_of", "describe", "observation_names"]

#: A predicate and its arguments, which are numbers of observed entities. Entity 0 is the ego.
Atom: TypeAlias = tuple[str, tuple[int, ...]]

SPLITS = ("train", "val", "test")


def describe() -> str:
    """Return Markdown tables of the environments, the rewards and the observations of every mode."""
    tasks = {mode: _logicity.describe(load_task(mode)) for mode in ENVIRONMENTS}
    sections = [
        ("Environments", _environments(tasks)),
        ("Rewards", _rewards(tasks)),
        ("Observations of the kind `groundings`", _groundings(tasks)),
        ("Observations of the kind `state`", _state(tasks)),
    ]
    return "\n".join(f"### {title}\n\n{text}" for title, text in sections)


def observation_names(
    mode: str | os.PathLike[str],
    *,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Return the name of each number of a `groundings` observation, such as `IsTiro(0)` or `CollidingClose(0, 3)`.

    Entity 0 is the ego. Entities 1, 2, ... are the other entities in its view. If the task observes the route length,
    the last name is `route length`.

    Args:
        mode: One of `logicity.ENVIRONMENTS`, such as `"expert"`, or the path of a configuration file.
        rules: A rule file that replaces the configuration's.
        overrides: Changes to the configuration, as in `gymnasium.make`.

    Raises:
        InputError: If the configuration, the rule file or an override is invalid.
        OSError: If a file cannot be read.
        ValueError: If the mode is unknown.
    """
    description = _logicity.describe(load_task(mode, rules, overrides))
    atoms = (f"{predicate}({', '.join(map(str, entities))})" for predicate, entities in atoms_of(description))
    return (*atoms, "route length") if description["route_length"] else tuple(atoms)


def atoms_of(description: Mapping[str, Any]) -> Iterator[Atom]:
    """Yield the atoms of a `groundings` observation in order, from the description of the task."""
    for column in description["columns"]:
        for entities in itertools.product(range(description["entities"]), repeat=column["arity"]):
            yield column["predicate"], entities


def _table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in [head, *rows]]
    lines.insert(1, "|" + "---|" * len(head))
    return "\n".join(lines) + "\n"


def _environments(tasks: dict[str, Any]) -> str:
    head = (
        "id",
        "agents train / val / test",
        "horizon (steps)",
        "`groundings`",
        "`state`",
        "recorded train / val / test",
        "test set",
    )
    rows: list[tuple[object, ...]] = []
    for mode, task in tasks.items():
        splits = [task["splits"][split] for split in SPLITS]
        rows.append(
            (
                f"`{ENVIRONMENTS[mode]}`",
                " / ".join(str(split["agents"]) for split in splits),
                task["horizon"],
                f"({task['width']},)",
                f"({', '.join(map(str, task['state']))})",
                " / ".join(str(split["episodes"]) for split in splits),
                f"`{splits[2]['hash'][:12]}`",
            )
        )
    patience = {task["patience"] for task in tasks.values()}
    factors = " or ".join(str(number) for number in sorted(patience))
    return (
        _table(head, rows)
        + f"\nThe step limit of a recorded episode is {factors} times the number of steps of the oracle. The last "
        "column is the start of the SHA-256 of the set of test episodes.\n"
    )


def _rewards(tasks: dict[str, Any]) -> str:
    head = ("mode", *ACTIONS, "overtime", "broken clause")
    rows: list[tuple[object, ...]] = []
    for mode, task in tasks.items():
        by_action: dict[str, dict[float, list[str]]] = {}
        for constraint in task["constraints"]:
            clauses = by_action.setdefault(constraint["action"], {})
            clauses.setdefault(constraint["reward"], []).append(constraint["clause"])
        broken = "; ".join(
            f"{action} ({', '.join(clauses)}) {reward:g}"
            for action, rewards in by_action.items()
            for reward, clauses in rewards.items()
        )
        rows.append((mode, *(f"{task['actions'][action]:g}" for action in ACTIONS), f"{task['overtime']:g}", broken))
    return (
        "The reward of a step is the value of its action in this table, divided by four times the number of route "
        "cells. A step that breaks clauses ends the episode. Its reward is a sum over the actions that these clauses "
        "require: for each action, the lowest value of its broken clauses. Reaching the goal also ends the episode. At "
        "the horizon, the last step also gets the overtime value.\n\n" + _table(head, rows) + _shaping(tasks)
    )


def _shaping(tasks: dict[str, Any]) -> str:
    """Describe the reward terms that only training has."""
    rows: list[tuple[object, ...]] = []
    for mode, task in tasks.items():
        terms, potential = task["shaping"], task["shaping"]["potential"]
        if terms["progress"] or terms["goal"] or potential["weight"]:
            shape = f"{potential['weight']:g} x {potential['of'].lower()}, gamma {potential['gamma']:g}"
            rows.append(
                (mode, f"{terms['progress']:g}", f"{terms['goal']:g}", shape if potential["weight"] else "none")
            )
    text = (
        "\nThe keys `progress`, `goal` and `potential` of `task.reward` add terms in the split `train`. Evaluations "
        "never have them."
    )
    if not rows:
        return text + " These modes have none.\n"
    return text + "\n\n" + _table(("mode", "`progress`", "`goal`", "`potential`"), rows)


def _groundings(tasks: dict[str, Any]) -> str:
    layouts: dict[str, list[str]] = {}
    for mode, task in tasks.items():
        layouts.setdefault(json.dumps([task["columns"], task["entities"]]), []).append(mode)
    sections = []
    for layout, modes in layouts.items():
        columns, entities = json.loads(layout)
        rows: list[tuple[object, ...]] = []
        base = 0
        for column in columns:
            unary = column["arity"] == 1
            where = f"{base} + i" if unary else f"{base} + {entities} i + j"
            variables = "(i)" if unary else "(i, j)"
            rows.append((f"{base} to {base + column['width'] - 1}", f"`{column['predicate']}{variables}`", where))
            base += column["width"]
        sections.append(f"{', '.join(modes)}:\n\n" + _table(("numbers", "atom", "at"), rows))
    return (
        "Each number is the truth value of a ground atom: 1 if it is true, else 0. Entity 0 is the ego. The others are "
        "the entities in its view. Indices i and j start at 0. Atoms over absent entities are false.\n\n"
        + "\n".join(sections)
    )


def _state(tasks: dict[str, Any]) -> str:
    def each(key: str) -> str:
        """Format the values of a key by mode, or a single value if all modes agree."""
        by_value: dict[str, list[str]] = {}
        for mode, task in tasks.items():
            by_value.setdefault(f"{task[key]:g}", []).append(mode)
        values = [f"{value} in {', '.join(modes)}" for value, modes in by_value.items()]
        return next(iter(by_value)) if len(by_value) == 1 else "; ".join(values)

    rows: list[tuple[object, ...]] = [
        (0, "1: the row is in use", "0, 1"),
        (1, "row of the agent minus row of the ego, divided by the half-width of the field of view", "-1 to 1"),
        (2, "column of the agent minus column of the ego, divided by the same", "-1 to 1"),
        ("3 to 6", f"one-hot heading: {', '.join(HEADINGS)}; all 0 before the first move", "0, 1"),
        (7, "priority divided by the largest priority; a smaller number has the right of way", "-1 to 1"),
    ]
    predicates: dict[str, list[str]] = {}
    for mode, task in tasks.items():
        names = ", ".join(f"`{column['predicate']}`" for column in task["columns"] if column["arity"] == 1)
        predicates.setdefault(names, []).append(mode)
    for names, modes in predicates.items():
        last = 7 + names.count(",") + 1
        rows.append((f"8 to {last}", f"truth values in {', '.join(modes)}: {names}", "0, 1"))
    return (
        "Each row is an agent: the ego first, then the other agents in its field of view, in the order of the agent "
        "list (see `episode`), not by distance. Agents beyond the number of rows are omitted. Unused rows are 0. "
        f"Half-width of the field of view in cells: {each('view')}. "
        f"Largest priority: {each('priority_scale')}.\n\n" + _table(("column", "meaning", "values"), rows)
    )
