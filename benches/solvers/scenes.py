"""Scenes to decide: an ego and four others, with all base facts about them.

Some are recorded: egos of a run of the city that see four others or more. Recorded scenes have few combinations of
facts, so the check also uses random scenes, which are not timed.
"""

from __future__ import annotations

import json
import random
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from rules import Refused, Rules

ENTITIES = ("e0", "e1", "e2", "e3", "e4")
EGO = ENTITIES[0]

Atom = tuple[str, tuple[str, ...]]


@dataclass(frozen=True)
class Scene:
    """The facts about `ENTITIES`, the first of which is the ego."""

    facts: frozenset[Atom]

    def to_json(self) -> dict[str, Any]:
        """Return the scene in the format of `logicity infer`."""
        return _to_json(ENTITIES, EGO, self.facts)


def _to_json(entities: Sequence[str], ego: str, atoms: Iterable[Atom]) -> dict[str, Any]:
    facts: dict[str, list[Any]] = {}
    for predicate, row in sorted(atoms):
        facts.setdefault(predicate, []).append(row[0] if len(row) == 1 else list(row))
    return {"entities": list(entities), "ego": ego, "facts": facts}


TOGETHER = 64 // len(ENTITIES)
"""The number of scenes whose entities fit a word of 64 bits."""


def together(scenes: Sequence[Scene], scope: str) -> list[list[dict[str, Any]]]:
    """Combine scenes to large ones, where no entity sees one of another scene. Return one copy for each ego in it."""
    in_view = {(scope, row) for row in product(ENTITIES, repeat=2)}
    groups = []
    for start in range(0, len(scenes), TOGETHER):
        part = scenes[start : start + TOGETHER]
        entities = [f"{name}_{at}" for at in range(len(part)) for name in ENTITIES]
        atoms = [
            (predicate, tuple(f"{name}_{at}" for name in row))
            for at, scene in enumerate(part)
            for predicate, row in scene.facts | in_view
        ]
        groups.append([_to_json(entities, f"{EGO}_{at}", atoms) for at in range(len(part))])
    return groups


class Logicity:
    """The binary of logicity."""

    def __init__(self, program: Path, config: Path) -> None:
        self.program = program.resolve()
        self.config = config

    def call(self, *arguments: str | Path) -> str:
        """Run the program and return its output."""
        command = [str(self.program), *map(str, arguments)]
        try:
            return subprocess.run(command, check=True, capture_output=True, text=True).stdout
        except OSError as error:
            raise Refused(f"cannot run {self.program}: {error.strerror}") from None
        except subprocess.CalledProcessError as error:
            raise Refused(f"`{' '.join(command)}` failed:\n{error.stderr or error.stdout}") from None

    def answers(self, scenes: Path, *options: str) -> Iterator[dict[str, dict[str, Any]]]:
        """Return the answers of `infer` about each ego, for every scene of a file."""
        for line in self.call("infer", "--config", self.config, *options, scenes).splitlines():
            yield json.loads(line)["egos"]


def write(path: Path, scenes: Sequence[dict[str, Any]]) -> None:
    """Write one scene per line."""
    path.write_text("".join(json.dumps(scene, separators=(",", ":")) + "\n" for scene in scenes), encoding="utf-8")


def record(logicity: Logicity, folder: Path, seed: int, ticks: int, count: int) -> list[Scene]:
    """Return this number of different scenes, drawn from a run of the city."""
    logicity.call("run", logicity.config, "--no-pictures", "--seed", str(seed), "--ticks", str(ticks), "--out", folder)
    header, *states = map(json.loads, (folder / "trace.jsonl").read_text(encoding="utf-8").splitlines())
    moments = folder / "moments.jsonl"
    write(moments, [_moment(header, state) for state in states])
    found = dict.fromkeys(
        _scene(answer, answer["sees"][: len(ENTITIES)])
        for egos in logicity.answers(moments)
        for answer in egos.values()
        if len(answer["sees"]) >= len(ENTITIES)
    )
    if len(found) < count:
        raise Refused(f"{ticks} ticks have {len(found)} different scenes, not {count}: raise --ticks or lower --scenes")
    return random.Random(seed).sample(list(found), count)


def _moment(header: dict[str, Any], state: dict[str, Any]) -> dict[str, Any]:
    agents = [
        {**agent, "at": now["at"], "heading": now.get("heading")}
        for agent, now in zip(header["agents"], state["agents"], strict=True)
    ]
    return {"map": header["map"], "tick": state["tick"], "agents": agents, "given": state["given"]}


def _scene(answer: dict[str, Any], entities: Sequence[str]) -> Scene:
    names = dict(zip(entities, ENTITIES, strict=True))
    rows = (
        (predicate, (row,) if isinstance(row, str) else tuple(row))
        for predicate, found in answer["true"].items()
        for row in found
    )
    return Scene(
        frozenset(
            (predicate, tuple(names[name] for name in row)) for predicate, row in rows if names.keys() >= set(row)
        )
    )


def invent(rules: Rules, seed: int, count: int) -> list[Scene]:
    """Return random scenes over the predicates of the rules, with few to many facts, possible in a city or not."""
    draw = random.Random(seed)
    asked = {literal.predicate for group in rules.clauses.values() for clause in group for literal in clause.body}
    atoms = [atom for atom in all_atoms(rules) if atom[0] in asked]
    scenes = []
    for _ in range(count):
        share = draw.uniform(0.02, 0.5)
        scenes.append(Scene(frozenset(atom for atom in atoms if draw.random() < share)))
    return scenes


def all_atoms(rules: Rules) -> list[Atom]:
    """Return every base atom about `ENTITIES`."""
    return [(predicate, row) for predicate in rules.base for row in product(ENTITIES, repeat=rules.arities[predicate])]
