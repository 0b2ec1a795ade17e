"""Compares the schema that `logicity schema experiment` prints with the classes that read experiments."""

from __future__ import annotations

import json
import subprocess
import sys

from conftest import ROOT, needs

needs("stable_baselines3", "learn")
needs("torch", "vap")

from logicity.experiments.registry import experiment_schema  # noqa: E402


def test_the_schema_is_that_of_the_classes() -> None:
    text = json.dumps(experiment_schema(), indent=2) + "\n"
    shipped = (ROOT / "configs" / "experiments" / "schema.json").read_text(encoding="utf-8")
    assert shipped == text, "write `experiment_schema()` to configs/experiments/schema.json"
    printed = subprocess.run(
        [sys.executable, "-m", "logicity", "schema", "experiment"], capture_output=True, text=True, check=True
    ).stdout
    assert printed == text


def test_every_key_has_a_description() -> None:
    def missing(value: object, path: str) -> list[str]:
        if not isinstance(value, dict):
            return []
        found = []
        for key, each in value.get("properties", {}).items():
            found += [f"{path}.{key}"] * ("description" not in each) + missing(each, f"{path}.{key}")
        return found + missing(value.get("additionalProperties"), f"{path}.NAME")

    assert [name for task, each in experiment_schema()["$defs"].items() for name in missing(each, task)] == []
