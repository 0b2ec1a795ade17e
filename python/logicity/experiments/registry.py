"""The table of tasks, and what follows from it: experiments of any task, their cells and their schema."""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from ..errors import did_you_mean
from ..learn.faults import faults, merged, tidy
from .experiment import Experiment, Selection, experiment_faults, fault_error, read_experiment, unknown_in
from .task import Cell, CellKey, Task

__all__ = ["TASKS", "Loaded", "experiment_schema", "load_experiment", "task_named"]

#: The module and the class of each task, the value of the key `task`. The first one is the default.
TASKS = {
    "spf": ("spf", "SafePathFollowing"),
    "vap": ("vap", "VisualActionPrediction"),
    "language": ("language.task", "LanguageQuestions"),
}


def task_named(name: str) -> Task:
    """Return a task of `TASKS`. Raises `ImportError` if a package that it needs is not installed."""
    module, kind = TASKS[name]
    task: Task = getattr(importlib.import_module(f".{module}", __package__), kind)()
    return task


def load_experiment(name: str | os.PathLike[str], changes: Mapping[str, Any] | None = None) -> Loaded:
    """Read the YAML file of an experiment.

    Args:
        name: The file, or the bare name of a built-in experiment such as `spf`.
        changes: Changes to the content of the file, such as more `learners`.

    Raises:
        ImportError: If a package that the task needs is not installed.
        InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key.
        OSError: If the file cannot be read.
        ValueError: If the changes have an unknown key or invalid value.
    """
    path, file, values = read_experiment(name)
    kind = values.setdefault("task", next(iter(TASKS)))
    if not isinstance(kind, str) or kind not in TASKS:
        shown = kind if isinstance(kind, str) else "~" if kind is None else json.dumps(kind)
        raise file.error([("invalid-value", ["task"], f"unknown task `{shown}`{did_you_mean(shown, TASKS)}", "")])
    task = task_named(kind)
    try:
        experiment = task.experiment.model_validate(merged(values, changes or {}))
    except ValidationError as error:
        raise fault_error(file, faults(error, unknown_in(task.experiment), depth=3), changes or {}) from None
    mode_fault = partial(task.mode_fault, path.parent)
    if wrong := [*experiment_faults(experiment, task.paper, mode_fault), *task.faults(experiment, path)]:
        raise fault_error(file, wrong, changes or {})
    return Loaded(task, experiment, path)


@dataclass(frozen=True)
class Loaded:
    """An experiment, its task and its file."""

    task: Task
    experiment: Experiment
    file: Path

    def cells(self, selection: Selection) -> list[Cell]:
        """Return the selected cells, and those that they start from, each after the cell that it starts from.

        Raises:
            FileNotFoundError: If a file that a setting names is missing.
            InputError: If a setting is invalid, or two cells have the same settings.
            ValueError: If the selection names an unknown row, mode or variant, or its changes are invalid.
        """
        found: dict[CellKey, Cell] = {}
        learners = self.experiment.learners
        rows = {row: self.experiment.columns(row) for row in learners}
        for row, mode, variants in selection.chosen(rows):
            own = learners[row].seeds or self.experiment.seeds
            seeds = selection.seeds or (own[:1] if selection.quick else own)
            for seed in seeds:
                for variant in variants:
                    self._add(found, CellKey(row, mode, variant, seed), selection, check=seed == seeds[0])
        # A variant that sets a mode has the same cell in each column.
        unique: dict[str, Cell] = {}
        for cell in found.values():
            same = unique.setdefault(cell.identity, cell)
            if (same.row, same.variant) == (cell.row, cell.variant):
                continue
            message = f"`{same.name}` and `{cell.name}` have the same settings: change or omit one of them"
            if selection.changes:
                raise ValueError(f"--set: {message}")
            raise read_experiment(self.file)[1].error([("invalid-value", ["learners", cell.row], message, "")])
        return list(unique.values())

    def _add(self, found: dict[CellKey, Cell], key: CellKey, selection: Selection, *, check: bool) -> Cell:
        """Add a cell after the one that it starts from."""
        if key in found:
            return found[key]
        spec, variant = self.experiment.learners[key.row], self.experiment.variants[key.variant]
        start = None
        if variant.start is not None or spec.start is not None:
            first: dict[str, Any] = {"row": spec.start} if variant.start is None else {"variant": variant.start}
            start = self._add(found, replace(key, **first), selection, check=check)
        own = replace(key, mode=self.task.located_mode(variant.mode or key.mode, self.file.parent))
        started = start is not None
        found[key] = Cell(
            task=self.task,
            **vars(own),
            settings=self.task.settings(self.experiment, self.file, own, selection, started=started, check=check),
            evaluations=self.task.evaluations(self.experiment),
            start=start,
            optional=spec.optional,
            hidden=spec.hidden or variant.hidden,
        )
        return found[key]


def experiment_schema() -> dict[str, Any]:
    """Return the JSON Schema of the YAML files of experiments of all tasks. Exceptions are those of `task_named`."""
    definitions: dict[str, Any] = {}
    for name in TASKS:
        task = task_named(name)
        definitions[name] = {"title": task.title, **_schema(task.experiment)}
        if task.settings_class is None:
            continue
        # Every mapping of settings changes some of the keys of one class.
        settings = f"{name}-settings"
        definitions[settings] = {"title": f"Settings of {task.title}", **_schema(task.settings_class)}
        definitions[settings].pop("required", None)
        properties = definitions[name]["properties"]
        rows = (properties[key]["additionalProperties"]["properties"] for key in ("learners", "variants"))
        for keys in (properties, *rows):
            for key in keys.keys() & {"changes", "quick"}:
                keys[key] = {"$ref": f"#/$defs/{settings}", "description": keys[key]["description"]}
    first, *others = TASKS
    # Without the key, the task is the first one.
    required: dict[str, Any] = {first: {}, **dict.fromkeys(others, {"required": ["task"]})}
    help = "The task, which determines the other keys."
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "An experiment",
        "type": "object",
        "properties": {"task": {"enum": list(TASKS), "default": first, "description": help}},
        "allOf": [
            {"if": {"properties": {"task": {"const": name}}, **more}, "then": {"$ref": f"#/$defs/{name}"}}
            for name, more in required.items()
        ],
        "$defs": definitions,
    }


def _schema(model: type[BaseModel]) -> dict[str, Any]:
    schema = model.model_json_schema()
    return dict(tidy({key: schema[key] for key in schema if key != "$defs"}, schema.get("$defs", {})))
