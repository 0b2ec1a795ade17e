"""The JSON Schema of experiments, which `logicity schema experiment` prints."""

from __future__ import annotations

import importlib
from typing import Any

from pydantic import BaseModel

from ..learn.faults import inlined, tidy
from .spf.experiment import TASKS

__all__ = ["experiment_schema"]

#: The name of each task in text.
TITLES = {"spf": "Safe Path Following", "vap": "Visual Action Prediction", "language": "Language questions"}


def experiment_schema() -> dict[str, Any]:
    """Return the JSON Schema of the YAML files of experiments of all tasks.

    Raises:
        ImportError: If a package that a task needs is not installed.
    """
    models = {**TASKS, "language": ("logicity.experiments.language.experiment", "LanguageExperiment")}
    definitions: dict[str, Any] = {}
    for task, (module, name) in models.items():
        definitions[task] = {"title": TITLES[task], **_schema(getattr(importlib.import_module(module), name))}
    vap = importlib.import_module("logicity.experiments.vap.experiment")
    # Every mapping of settings changes some of the keys of one class.
    definitions["vap-settings"] = {"title": f"Settings of {TITLES['vap']}", **_schema(vap.VapSettings)}
    properties = definitions["vap"]["properties"]
    row, variant = (properties[key]["additionalProperties"]["properties"] for key in ("learners", "variants"))
    for keys, key in ((properties, "settings"), (properties, "quick"), (row, "settings"), (row, "quick")):
        keys[key] = _reference("vap-settings", keys[key]["description"])
    variant["settings"] = _reference("vap-settings", variant["settings"]["description"])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "An experiment",
        "type": "object",
        "properties": {
            "task": {
                "enum": list(models),
                "default": "spf",
                "description": "The task, which determines the other keys.",
            }
        },
        "allOf": [
            {
                "if": {
                    "properties": {"task": {"const": task}},
                    # Without the key, the task is Safe Path Following.
                    **({} if task == "spf" else {"required": ["task"]}),
                },
                "then": {"$ref": f"#/$defs/{task}"},
            }
            for task in models
        ],
        "$defs": definitions,
    }


def _schema(model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of a model without definitions."""
    schema = model.model_json_schema()
    return dict(tidy(inlined({key: schema[key] for key in schema if key != "$defs"}, schema.get("$defs", {}))))


def _reference(name: str, description: str) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{name}", "description": description}
