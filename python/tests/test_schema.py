"""Validates configuration files with the JSON Schema that `logicity schema` prints.

`tests/city/schema.rs` compares the keys, words, ranges and defaults of the schema with the reader. `test_learn.py` and
`test_experiment_schema.py` compare the schemas of training configurations and experiments with the classes that read
them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures" / "diagnostics"

#: The part of a configuration in each folder of `configs`.
PARTS = {
    "configs": "run",
    "maps": "map",
    "agents": "agents",
    "predicates": "predicates",
    "tasks": "task",
    "baselines": "training",
    "experiments": "experiment",
}
#: The places of the faults in fixtures that the schema sees. It does not know the concepts that predicates define, and
#: that a split has agents.
FAULTY = {
    "invalid-value": {
        "actions/priority",
        "agents/test/cars/2/priority",
        "agents/test/cars/3/count",
        "agents/test/cars/4/concepts",
        "map/blocks/1",
        "map/widths/street",
        "region",
        "routing",
        "ticks",
        "view",
    },
    "unknown-key": {
        "veiw",
        "region/testing",
        "actions/prioritty",
        "agents/train/cars/0/concept",
        "predicates/define/IsFar/distance/over",
        "predicates/define/IsNear/close",
    },
}
FILES = [path for folder in PARTS for path in sorted((ROOT / "configs").rglob("*.yaml")) if path.parent.name == folder]


def validator(part: str) -> jsonschema.Draft202012Validator:
    printed = subprocess.run(
        [sys.executable, "-m", "logicity", "schema", part], capture_output=True, text=True, check=True
    ).stdout
    schema = json.loads(printed)
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


VALIDATORS = {part: validator(part) for part in PARTS.values()}


def load(text: str) -> Any:
    """Parse YAML 1.2, where `3.0e-5` and `1e9` are numbers."""
    return yaml.safe_load(text)


@pytest.mark.parametrize("path", FILES, ids=[str(path.relative_to(ROOT)) for path in FILES])
def test_shipped_files_are_valid(path: Path) -> None:
    errors = VALIDATORS[PARTS[path.parent.name]].iter_errors(load(path.read_text(encoding="utf-8")))
    assert [error.message for error in errors] == []


def test_all_shipped_files_are_validated() -> None:
    assert set((ROOT / "configs").rglob("*.yaml")) == set(FILES)
    assert len(FILES) >= 40


@pytest.mark.parametrize("name", FAULTY)
def test_each_fault_of_a_file_is_an_error(name: str) -> None:
    document = load((FIXTURES / f"{name}.yaml").read_text(encoding="utf-8"))
    errors = leaves(VALIDATORS["run"].iter_errors(document))
    # An alternative that does not apply fails with `type` or `enum` at a mapping; the others are the faults.
    found = {"/".join(map(str, error.absolute_path)) for error in errors if not isinstance(error.instance, dict)}
    found |= {
        "/".join([*map(str, error.absolute_path), key])
        for error in leaves(VALIDATORS["run"].iter_errors(document))
        if error.validator == "additionalProperties"
        for key in error.instance
        if key not in error.schema["properties"]
    }
    assert found == FAULTY[name]


def leaves(errors: Any) -> Any:
    """Yield the innermost errors; those of `anyOf` are in its context."""
    for error in errors:
        if error.context:
            yield from leaves(error.context)
        else:
            yield error


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ("run", "base: expert\nview: 0"),
        ("run", "base: expert\nveiw: 40"),
        ("run", "base: expert\nrouting: fastest"),
        ("run", "base: expert\nactions: {priority: [Stop, Slow]}"),
        ("run", "base: expert\nmap: {blocks: [1]}"),
        ("run", "base: expert\nmap: {base: square-5x5, widths: {street: wide}}"),
        ("run", "base: expert\ntask: {reward: {violation: -1e7}}"),
        ("map", "buildings: {rows: [HX]}"),
        ("agents", "test: {cars: [{concepts: [bus]}]}"),
        ("agents", "test: {cars: [{priority: 1, count: 0}]}"),
        ("predicates", "define: {IsTaxi: {concept: taxi, off: Car}}"),
        ("predicates", "define: {Sees: {kind: Car}}"),
        ("predicates", "define: {Stop: {kind: Car}}"),
        ("predicates", "define: {IsNear: {distance: {at_most: -1}}}"),
        ("task", "ego: {concepts: [{concepts: [tiro]}]}"),
        ("training", "base: dqn-easy\nstep: 100"),
        ("training", "base: dqn-easy\nsteps: 0"),
        ("training", "algorithm: sac"),
        ("training", "algorithm: ppo\nsettings: {buffer_size: 100}"),
        ("training", "algorithm: dqn\nsettings: {train_freq: often}"),
        ("experiment", "title: A\nmodes: [easy]\nlearners: {dqn: {optinal: true}}"),
        ("experiment", "title: A\nmodes: [easy]\nlearners: {dqn: {settings: {}}}"),
        ("experiment", "title: A\nmodes: [easy]"),
        ("experiment", "title: A\nmodes: []\nlearners: {dqn: {}}"),
        ("experiment", "task: spf\ntitle: A\nmodes: [easy]\nlearners: {dqn: {}}\nevaluations: {test: {fresh: 0}}"),
        ("experiment", "task: vap\ntitle: A\nmodes: [medium]\nlearners: {rules: {}}"),
        ("experiment", "task: vap\ntitle: A\nmodes: [hard]\nlearners: {rules: {changes: {stages: bound}}}"),
        ("experiment", "task: vap\ntitle: A\nmodes: [hard]\nlearners: {rules: {quick: {worlds: {train: 0}}}}"),
        ("experiment", "task: language\ntitle: A\nlearners: {oracle: {changes: {style: words, sort: ~}}}"),
        ("experiment", "task: vpa\ntitle: A\nmodes: [hard]\nlearners: {rules: {}}"),
    ],
)
def test_faulty_files_are_invalid(part: str, text: str) -> None:
    assert not VALIDATORS[part].is_valid(load(text))


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ("run", "base: expert\nregion: 100\nmap: ~"),
        ("run", "base: expert\nregion: {test: 100}"),
        ("run", "base: expert\npredicates: {define: {IsClose: {distance: {at_most: 15}}}}"),
        ("map", "base: square-5x5\nbuildings: {rows: ~, random: {seed: 1, weights: {House: 1}}}"),
        ("agents", "base: expert\ntest: {repeat: 55556, trip: 80}"),
        ("task", "base: expert\nego: {priority: 3}"),
        ("training", "base: dqn-easy\nsettings: {gamma: 0.9}"),
        ("training", "algorithm: dqn\nsettings: {train_freq: [1, episode]}"),
        ("experiment", "task: spf\ntitle: A\nmodes: [my.yaml]\nlearners: {dqn: {paper: ~, changes: {steps: 9}}}"),
        ("experiment", "task: vap\ntitle: A\nmodes: [hard]\nlearners: {rules: {}}\nquick: {worlds: {train: 1}}"),
    ],
)
def test_files_with_some_of_the_keys_are_valid(part: str, text: str) -> None:
    assert [error.message for error in VALIDATORS[part].iter_errors(load(text))] == []
