"""What observations are made of, and tables of the environments as Markdown, both as the tasks say of themselves."""

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

#: A predicate, and the observed entities it is about: 0 is the ego.
Atom: TypeAlias = tuple[str, tuple[int, ...]]

SPLITS = ("train", "val", "test")


def describe() -> str:
    """Environments, rewards and the layout of observations of every mode."""
    tasks = {mode: _logicity.describe(load_task(mode)) for mode in ENVIRONMENTS}
    sections = [
        ("Environments", _environments(tasks)),
        ("Rewards", _rewards(tasks)),
        ("Observations", _observations(tasks)),
        ("Exact observations", _points(tasks)),
    ]
    return "\n".join(f"### {title}\n\n{text}" for title, text in sections)


def observation_names(
    mode: str | os.PathLike[str],
    *,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """What each number of an observation of atoms stands for, such as `IsTiro(0)` or `CollidingClose(0, 3)`.

    Entity 0 is the ego, 1, 2, ... are what it sees. The last is `route length` if the task observes it, too.

    Args:
        mode: one of `logicity.ENVIRONMENTS`, such as `"expert"`, or the path of a configuration file.
        rules: a rule file instead of the configuration's.
        overrides: changes to the configuration, as `gymnasium.make` takes them.

    Raises:
        ValueError: an unknown mode.
        InputError: a faulty configuration, rule file or override.
        OSError: a file cannot be read.
    """
    told = _logicity.describe(load_task(mode, rules, overrides))
    atoms = (f"{predicate}({', '.join(map(str, entities))})" for predicate, entities in atoms_of(told))
    return (*atoms, "route length") if told["route_length"] else tuple(atoms)


def atoms_of(told: Mapping[str, Any]) -> Iterator[Atom]:
    """The atoms of an observation, in order, of a task as it says of itself; the length of the route is no atom."""
    for column in told["columns"]:
        for entities in itertools.product(range(told["entities"]), repeat=column["arity"]):
            yield column["predicate"], entities


def _table(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in [head, *rows]]
    lines.insert(1, "|" + "---|" * len(head))
    return "\n".join(lines) + "\n"


def _environments(tasks: dict[str, Any]) -> str:
    head = (
        "id",
        "agents train / val / test",
        "steps at most",
        "`atoms`",
        "`points`",
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
                f"({', '.join(map(str, task['points']))})",
                " / ".join(str(split["episodes"]) for split in splits),
                f"`{splits[2]['hash'][:12]}`",
            )
        )
    patience = {task["patience"] for task in tasks.values()}
    told = " or ".join(str(number) for number in sorted(patience))
    return (
        _table(head, rows)
        + f"\nRecorded episodes have at most {told} times the oracle's steps. The last column begins the SHA-256 "
        "of the set of test episodes.\n"
    )


def _rewards(tasks: dict[str, Any]) -> str:
    head = ("mode", *ACTIONS, "overtime", "a clause broken")
    rows: list[tuple[object, ...]] = []
    for mode, task in tasks.items():
        by_action: dict[str, dict[float, list[str]]] = {}
        for demand in task["demands"]:
            clauses = by_action.setdefault(demand["action"], {})
            clauses.setdefault(demand["reward"], []).append(demand["clause"])
        broken = "; ".join(
            f"{action} ({', '.join(clauses)}) {reward:g}"
            for action, rewards in by_action.items()
            for reward, clauses in rewards.items()
        )
        rows.append((mode, *(f"{task['actions'][action]:g}" for action in ACTIONS), f"{task['overtime']:g}", broken))
    return (
        "The four numbers of the actions are divided by four times the cells of the route. A step that breaks clauses "
        "is worth, instead of that, the sum over the actions they ask of the worst of each, and ends the episode; so "
        "does the goal. Overtime is added to the last step at the horizon.\n\n" + _table(head, rows)
    )


def _observations(tasks: dict[str, Any]) -> str:
    layouts: dict[str, list[str]] = {}
    for mode, task in tasks.items():
        layouts.setdefault(json.dumps([task["columns"], task["entities"]]), []).append(mode)
    told = []
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
        told.append(f"{', '.join(modes)}:\n\n" + _table(("numbers", "atom", "at"), rows))
    return (
        "Each number of `atoms` is 1 if an atom is true and else 0. Entity 0 is the ego, the others are what it sees; "
        "i and j count from 0. Of entities that are not there nothing is true.\n\n" + "\n".join(told)
    )


def _points(tasks: dict[str, Any]) -> str:
    def each(key: str) -> str:
        """What modes have of something: said once if they agree."""
        by_value: dict[str, list[str]] = {}
        for mode, task in tasks.items():
            by_value.setdefault(f"{task[key]:g}", []).append(mode)
        told = [f"{value} in {', '.join(modes)}" for value, modes in by_value.items()]
        return next(iter(by_value)) if len(by_value) == 1 else "; ".join(told)

    rows: list[tuple[object, ...]] = [
        (0, "1: there is an agent", "0, 1"),
        (1, "rows from the ego down to it, as a share of the half-width of the field of view", "-1 to 1"),
        (2, "columns from the ego right to it, as that share", "-1 to 1"),
        ("3 to 6", f"1 for its heading: {', '.join(HEADINGS)}; all 0 before its first move", "0, 1"),
        (7, "its priority as a share of the greatest; a smaller one goes first", "-1 to 1"),
    ]
    predicates: dict[str, list[str]] = {}
    for mode, task in tasks.items():
        names = ", ".join(f"`{column['predicate']}`" for column in task["columns"] if column["arity"] == 1)
        predicates.setdefault(names, []).append(mode)
    for names, modes in predicates.items():
        last = 7 + names.count(",") + 1
        rows.append((f"8 to {last}", f"1 for each that it is, in {', '.join(modes)}: {names}", "0, 1"))
    return (
        "`points` has a row for each agent: the ego first, then the others in its field of view in the order of the "
        "list of agents (`episode` tells it), not of their distance. Those for which there is no row left are not "
        "seen at all; rows that are left are 0. The field of view goes so many cells from the ego to each side: "
        f"{each('view')}. The greatest priority: {each('priority_scale')}.\n\n"
        + _table(("column", "meaning", "values"), rows)
    )
