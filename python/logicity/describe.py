"""Names of the numbers of an observation, and Markdown pages of the environments, both generated from the tasks."""

from __future__ import annotations

import inspect
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from . import _logicity
from .city import ACTIONS, HEADINGS
from .envs.config import EnvConfig
from .envs.layout import atoms_of
from .errors import did_you_mean
from .modes import ENVIRONMENTS
from .rules import Program
from .tasks import load_task

__all__ = ["describe", "environment_page", "observation_names", "parallel_page"]


SPLITS = ("train", "val", "test")
_Rows = Iterable[Sequence[object]]


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


def environment_page(mode: str) -> str:
    """Return the description of the environment of a mode as Markdown, in the order that gymnasium's pages have.

    This function needs the extra `gym`. It raises `ValueError` if the mode is not one of `logicity.ENVIRONMENTS`.
    """
    from .envs.single import SPFEnv

    if mode not in ENVIRONMENTS:
        raise ValueError(f"unknown mode `{mode}`{did_you_mean(mode, ENVIRONMENTS)}")
    task = _logicity.describe(load_task(mode))
    # The first line of the file, as in `# Safe Path Following, easy mode: give way at intersections.`
    about = _logicity.read_file(f"configs/{mode}.yaml").partition("\n")[0].partition(": ")[2]
    overview = [
        ("import", f'`gymnasium.make("{ENVIRONMENTS[mode]}")` after `import logicity`'),
        ("action space", "`Discrete(4)`"),
        ("observation space", f"`Box(0.0, 1.0, ({task['width']},), float32)`"),
        ("agents in `train` / `val` / `test`", _by_split(task, "agents")),
        ("recorded episodes in `train` / `val` / `test`", _by_split(task, "episodes")),
    ]
    meanings = {
        clause["label"]: clause["doc"].partition(": ")[2] for clause in Program.load(f"rules/{mode}.dl").clauses
    }
    clauses = [
        (at, f"`{each['clause']}`", each["action"], f"{each['reward']:g}", " ".join(meanings[each["clause"]].split()))
        for at, each in enumerate(task["constraints"])
    ]
    description = (
        "The agent drives the first car of a city, the ego, along a given route among cars and pedestrians that "
        f"follow the rules. It must reach the end of the route without violating a rule. In this mode: {about}\n\n"
        "The rules forbid an action if a clause derives another one in the current state:\n\n"
        + _table(("index in `violations`", "clause", "it requires", "reward for violating it", "meaning"), clauses)
        + "\n`env.unwrapped.clauses` has the names of the clauses, and `env.unwrapped.explain()` proves the action "
        "that the rules derive.\n"
    )
    start = (
        "`reset(seed=s)` begins a sequence of drawn episodes: the seed determines the start and the goal of every "
        "agent, the concepts of the ego, and all later random draws. Further calls of `reset()` continue the "
        'sequence. `reset(options={"episode": n})` starts a recorded episode, and `env.unwrapped.episode` has the '
        "start of any episode in a form that the same option accepts. All agents rest at first.\n"
    )
    end = (
        "- *Termination*: the car reaches its goal, or its action violates a clause.\n"
        f"- *Truncation*: a drawn episode has {task['horizon']} steps. A recorded one has {task['patience']} times the "
        "number of steps that the oracle needs.\n"
    )
    more = "\n`gymnasium.make_vec` takes the same arguments for environments that step together.\n"
    return _page(SPFEnv, {mode: task}, overview, description, start, end, more)


def _cars(task: _logicity.Task, split: str) -> int:
    """Return the number of cars that an environment of several egos controls."""
    return _logicity.VectorEnv(task, split, 1, "Disabled", "groundings", "drawn", 1, True).egos()


def parallel_page() -> str:
    """Variant of `environment_page` for `logicity.parallel_env`, in all modes. Needs the extra `pettingzoo`."""
    from .envs.parallel import SPFParallelEnv

    loaded = {mode: load_task(mode) for mode in ENVIRONMENTS}
    tasks = {mode: _logicity.describe(task) for mode, task in loaded.items()}
    cars = [
        (
            f"`{mode}`",
            " / ".join(str(_cars(task, split)) for split in SPLITS),
            f"`Box(0.0, 1.0, ({tasks[mode]['width']},), float32)`",
            tasks[mode]["horizon"],
        )
        for mode, task in loaded.items()
    ]
    overview = [
        ("import", '`logicity.parallel_env("expert")`, or another mode or configuration file'),
        ("agents", "`Car_1`, `Car_2`, ...: the first cars, as many as `task.egos` says, or all, in `possible_agents`"),
        ("action spaces", "`Discrete(4)`"),
        ("observation spaces", "one for each car, all alike; see the table of modes"),
    ]
    description = (
        "Each of several cars is an agent of its own, which must reach the end of its route without violating a rule. "
        "The rules drive the other cars and the pedestrians. `step` takes one action for each car in `agents`. "
        "When the episode of a car "
        "ends, the car leaves `agents` and from then on follows the rules, so that the others still meet it.\n\n"
        + _table(("mode", "cars in `train` / `val` / `test`", "observation space of a car", "horizon"), cars)
        + "\n`env.clauses` has the names of the clauses that a car can violate, which the page of each mode explains. "
        '`env.explain("Car_2")` proves the action that the rules derive for a car.\n'
    )
    start = (
        "`reset(seed=s)` begins a sequence of drawn episodes, and further calls of `reset()` continue it. The seed "
        "determines the start and the goal of every agent and all later random draws. "
        "With `task.egos`, it also determines the priority and the concepts of each ego, otherwise those of the first. "
        '`reset(options={"episode": env.episode})` starts the same episode again, and `reset(options={"episode": 7})` '
        "a recorded one, with the horizon of the configuration. All agents rest at first.\n"
    )
    end = (
        "- *Termination* of a car: it reaches its goal, or its action violates a clause.\n"
        "- *Truncation* of a car: the episode has as many steps as the horizon.\n\n"
        "The episode of the environment ends when `agents` is empty.\n"
    )
    return _page(SPFParallelEnv, tasks, overview, description, start, end, of=" for each car,")


def _page(
    env_class: type,
    tasks: dict[str, Any],
    overview: _Rows,
    description: str,
    start: str,
    end: str,
    more: str = "",
    of: str = "",
) -> str:
    actions = zip(range(len(ACTIONS)), ACTIONS, (1, 2, 3, 0), strict=True)
    sections = {
        "Description": description,
        "Action space": _table(("number", "action", "cells that the car moves"), actions),
        "Observation space": _groundings(tasks),
        "Observations of the kind `state`": _state(tasks),
        "Rewards": _rewards(tasks),
        "Information": f"`reset` and `step` return an `info`{of} with these keys; a shield adds others:\n\n"
        + _infos(env_class),
        "Starting state": start,
        "Episode end": end,
        "Arguments": _arguments(env_class) + more,
        "Version history": "- v0: the first version.\n",
    }
    text = "\n".join(f"## {title}\n\n{section}" for title, section in sections.items())
    return _table(("property", "value"), overview) + "\n" + text


def _parameters(env_class: type) -> dict[str, inspect.Parameter]:
    """Return the keyword arguments of a class of environments, in the order of the docstring of `SPFEnv`."""
    own = {**inspect.signature(env_class.__init__).parameters, **inspect.signature(EnvConfig).parameters}  # type: ignore[misc]
    return {name: own[name] for name in _documented() if name in own and name != "config"}


def _arguments(env_class: type) -> str:
    """Return a table of the keyword arguments of a class of environments, with the meanings that `SPFEnv` documents."""
    rows = [
        (f"`{name}`", f"`{parameter.default!r}`", _documented()[name])
        for name, parameter in _parameters(env_class).items()
    ]
    return _table(("argument", "default", "meaning"), rows)


def _infos(env_class: type) -> str:
    """Return a table of the keys of `info` without a shield, from the docstring of `SPFEnv`."""
    keys = re.findall(r"^- `(\w+)` \((.*?)\)(, with .*?)?: (.*)", _docstring(), re.MULTILINE)
    rows = [
        (f"`{key}`", kind + needs, meaning)
        for key, kind, needs, meaning in keys
        if "with a shield" not in needs
        and all(name in _parameters(env_class) for name in re.findall(r"`(\w+)=True`", needs))
    ]
    return _table(("key", "type", "value"), rows)


def _documented() -> dict[str, str]:
    """Return the arguments that the docstring of `SPFEnv` documents, with their meanings."""
    entries = _docstring().partition("\nArgs:\n")[2].partition("\n\n")[0]
    return dict(re.findall(r"^    (\w+): (.*)", entries, re.MULTILINE))


def _docstring() -> str:
    """Return the docstring of `SPFEnv` with one line for each argument and each key of `info`."""
    from .envs.single import SPFEnv

    return re.sub(r"\n(?:  |        )(?=\S)", " ", inspect.cleandoc(SPFEnv.__doc__ or ""))


def observation_names(
    mode: str | os.PathLike[str],
    *,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> tuple[str, ...]:
    """Return the name of each number of a `groundings` observation, such as `IsTiro(0)` or `CollidingClose(0, 3)`.

    Entity 0 is the ego. Entities 1, 2, ... are the other entities in its view. If the task observes the route length,
    the last name is `route length`.

    The arguments and the exceptions for them are those of `Benchmark`.
    """
    description = _logicity.layout(load_task(mode, rules, overrides))
    atoms = (f"{predicate}({', '.join(map(str, entities))})" for predicate, entities in atoms_of(description))
    return (*atoms, "route length") if description["route_length"] else tuple(atoms)


def _by_split(task: Mapping[str, Any], key: str) -> str:
    return " / ".join(str(task["splits"][split][key]) for split in SPLITS)


def _by_value(values: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the names of the modes, in one text, by a value that they share."""
    modes: dict[str, list[str]] = {}
    for mode, value in values:
        modes.setdefault(value, []).append(mode)
    return {value: ", ".join(names) for value, names in modes.items()}


def _table(head: Sequence[str], rows: _Rows) -> str:
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
    rows = [
        (
            f"`{ENVIRONMENTS[mode]}`",
            _by_split(task, "agents"),
            task["horizon"],
            f"({task['width']},)",
            f"({', '.join(map(str, task['state']))})",
            _by_split(task, "episodes"),
            f"`{task['splits']['test']['hash'][:12]}`",
        )
        for mode, task in tasks.items()
    ]
    factors = " or ".join(map(str, sorted({task["patience"] for task in tasks.values()})))
    return (
        _table(head, rows)
        + f"\nThe step limit of a recorded episode is {factors} times the number of steps of the oracle. The last "
        "column is the start of the SHA-256 of the set of test episodes.\n"
    )


def _rewards(tasks: dict[str, Any]) -> str:
    head = ("mode", *ACTIONS, "overtime", "broken clause")
    rows = []
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
    rows = []
    for mode, task in tasks.items():
        terms, potential = task["shaping"], task["shaping"]["potential"]
        if terms["progress"] or terms["goal"] or potential["weight"]:
            shape = f"{potential['weight']:g} x {potential['of'].lower()}, gamma {potential['gamma']:g}"
            shape = shape if potential["weight"] else "none"
            rows.append((mode, f"{terms['progress']:g}", f"{terms['goal']:g}", shape))
    text = (
        "\nThe keys `progress`, `goal` and `potential` of `task.reward` add terms in the split `train`. Evaluations "
        "never have them."
    )
    if not rows:
        return text + " These modes have none.\n"
    return text + "\n\n" + _table(("mode", "`progress`", "`goal`", "`potential`"), rows)


def _groundings(tasks: dict[str, Any]) -> str:
    layouts = _by_value((mode, json.dumps([task["columns"], task["entities"]])) for mode, task in tasks.items())
    sections = []
    for layout, modes in layouts.items():
        columns, entities = json.loads(layout)
        rows, base = [], 0
        for column in columns:
            where, variables = ("i", "(i)") if column["arity"] == 1 else (f"{entities} i + j", "(i, j)")
            numbers = f"{base} to {base + column['width'] - 1}"
            rows.append((numbers, f"`{column['predicate']}{variables}`", f"{base} + {where}"))
            base += column["width"]
        sections.append(f"{modes}:\n\n" + _table(("numbers", "atom", "at"), rows))
    return (
        "Each number is the truth value of a ground atom: 1 if it is true, else 0. Entity 0 is the ego. The others are "
        "the entities in its view. Indices i and j start at 0. Atoms over absent entities are false.\n\n"
        + "\n".join(sections)
    )


def _state(tasks: dict[str, Any]) -> str:
    def each(key: str) -> str:
        """Format the values of a key by mode, or a single value if all modes agree."""
        by_value = _by_value((mode, f"{task[key]:g}") for mode, task in tasks.items())
        values = [f"{value} in {modes}" for value, modes in by_value.items()]
        return next(iter(by_value)) if len(by_value) == 1 else "; ".join(values)

    rows: list[tuple[object, str, str]] = [
        (0, "1: the row is in use", "0, 1"),
        (1, "row of the agent minus row of the ego, divided by the half-width of the field of view", "-1 to 1"),
        (2, "column of the agent minus column of the ego, divided by the same", "-1 to 1"),
        ("3 to 6", f"one-hot heading: {', '.join(HEADINGS)}; all 0 before the first move", "0, 1"),
        (7, "priority divided by the largest priority; a smaller number has the right of way", "-1 to 1"),
    ]
    predicates = _by_value(
        (mode, ", ".join(f"`{column['predicate']}`" for column in task["columns"] if column["arity"] == 1))
        for mode, task in tasks.items()
    )
    for names, modes in predicates.items():
        rows.append((f"8 to {8 + names.count(',')}", f"truth values in {modes}: {names}", "0, 1"))
    return (
        "Each row is an agent: the ego first, then the other agents in its field of view, in the order of the agent "
        "list (see `episode`), not by distance. Agents beyond the number of rows are omitted. Unused rows are 0. "
        f"Half-width of the field of view in cells: {each('view')}. "
        f"Largest priority: {each('priority_scale')}.\n\n" + _table(("column", "meaning", "values"), rows)
    )
