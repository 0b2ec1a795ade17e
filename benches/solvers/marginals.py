"""Time exact probabilities of one ego's actions by logicity and ProbLog, after checking that both agree.

`make solvers-marginals` runs it. Scenes are those of `compare.py`: an ego and four others under the rules of a
configuration. In each, some of the base atoms are uncertain. Every figure is CPU time on one thread: that of
`logicity infer --marginals` contains reading and printing JSON, that of ProbLog (Fierens et al. 2015) parsing,
grounding and compiling its program, without which it has no answer.

With `--layer`, `logicity.torch.RuleLayer` computes them, too, forward and backward: of scenes that it sees for the
first time, and of the same ones again. It needs the Python package with its extra `learn`.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

from scenes import EGO, ENTITIES, Atom, Logicity, Scene, all_atoms, record, write

import rules as rule_files
from rules import Refused

try:
    from problog import get_evaluatable
    from problog.program import PrologString
except ImportError as error:
    sys.exit(f"error: {error}; `make solvers-marginals` installs the packages of benches/solvers/requirements.txt")

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = 5

Uncertain = dict[Atom, float]


def with_doubts(rules: rule_files.Rules, scene: Scene, count: int, draw: random.Random) -> Uncertain:
    """Return this many base atoms with probabilities: half of them hold in the scene, as far as it has so many."""
    asked = {literal.predicate for group in rules.clauses.values() for clause in group for literal in clause.body}
    atoms = [atom for atom in all_atoms(rules) if atom[0] in asked]
    hold = [atom for atom in atoms if atom in scene.facts]
    chosen = draw.sample(hold, min(count // 2, len(hold)))
    chosen += draw.sample([atom for atom in atoms if atom not in scene.facts], count - len(chosen))
    return {atom: round(draw.uniform(0.05, 0.95), 2) for atom in chosen}


def to_json(scene: Scene, doubts: Uncertain) -> dict[str, Any]:
    """Return the scene with its uncertain rows in the format of `logicity infer`."""
    facts: dict[str, list[Any]] = {}
    for predicate, row in sorted(scene.facts - doubts.keys()):
        facts.setdefault(predicate, []).append(list(row))
    for (predicate, row), p in sorted(doubts.items()):
        facts.setdefault(predicate, []).append({"row": list(row), "probability": p})
    return {"entities": list(ENTITIES), "ego": EGO, "facts": facts}


class Problog:
    """The rules as a ProbLog program."""

    def __init__(self, rules: rule_files.Rules) -> None:
        self.rules = rules
        lines = []
        for clauses in rules.clauses.values():
            for clause in clauses:
                body = [self._atom(rules.scope, (clause.ego, other)) for other in clause.others()]
                # ProbLog tests a negated atom where it stands, so positive ones come first.
                for literal in sorted(clause.body, key=lambda literal: not literal.positive):
                    body.append(("" if literal.positive else "\\+ ") + self._atom(literal.predicate, literal.variables))
                lines.append(f"{self._atom(clause.head, (clause.ego,))} :- {', '.join(body)}.")
        self.program = "\n".join(lines)

    def _atom(self, predicate: str, row: Sequence[str]) -> str:
        return f"p_{predicate.lower()}({', '.join(row)})"

    def text(self, scene: Scene, doubts: Uncertain) -> str:
        """Return the program with the facts of a scene and a query for each action."""
        seen = {(self.rules.scope, (x, y)) for x in ENTITIES for y in ENTITIES}
        # Without a clause, ProbLog calls a predicate unknown.
        lines = [f"0.0::{self._atom(name, ['none'] * self.rules.arities[name])}." for name in self.rules.arities]
        lines += [f"{self._atom(*atom)}." for atom in sorted((scene.facts - doubts.keys()) | seen)]
        lines += [f"{p}::{self._atom(*atom)}." for atom, p in sorted(doubts.items())]
        lines += [self.program, *(f"query({self._atom(action, (EGO,))})." for action in self.rules.actions)]
        return "\n".join(lines)

    def marginals(self, text: str) -> dict[str, float]:
        """Return the probability of each action."""
        found = get_evaluatable().create_from(PrologString(text)).evaluate()
        by_name = {str(term).split("(")[0]: float(p) for term, p in found.items()}
        return {action: by_name.get(f"p_{action.lower()}", 0.0) for action in self.rules.actions}


def ours(logicity: Logicity, path: Path) -> tuple[list[dict[str, float]], float]:
    """Return the probabilities of the actions in each scene of a file, and the CPU time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    output = logicity.call("infer", "--marginals", "--config", logicity.config, path)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    answers = [json.loads(line) for line in output.splitlines()]
    if not all(answer["exact"] for answer in answers):
        raise Refused("logicity estimates")
    return [answer["egos"][EGO]["derived"] for answer in answers], spent


class Layer:
    """The scenes as tensors of `RuleLayer`."""

    def __init__(self, rules: Path, scenes: Sequence[Scene], doubts: Sequence[Uncertain], scope: str) -> None:
        import torch

        from logicity.torch import RuleLayer

        torch.set_num_threads(1)
        self.make = lambda: RuleLayer(rules, "exact")
        layer = self.make()
        size = len(ENTITIES)
        unary = torch.zeros(len(scenes), size, len(layer.unary), dtype=torch.float64)
        binary = torch.zeros(len(scenes), size, size, len(layer.binary), dtype=torch.float64)
        binary[..., layer.binary.index(scope)] = 1
        for at, (scene, uncertain) in enumerate(zip(scenes, doubts, strict=True)):
            known = dict.fromkeys(scene.facts, 1.0) | uncertain
            for (predicate, row), probability in known.items():
                places = [ENTITIES.index(entity) for entity in row]
                if len(places) == 1:
                    unary[at, places[0], layer.unary.index(predicate)] = probability
                else:
                    binary[at, places[0], places[1], layer.binary.index(predicate)] = probability
        self.inputs = unary.requires_grad_(), binary.requires_grad_()
        self.egos = [ENTITIES.index(EGO)]

    def derived(self) -> list[dict[str, float]]:
        """Return the probability of each action in each scene."""
        layer = self.make()
        answers, found = layer.degrees(*(each.detach() for each in self.inputs), egos=self.egos)
        # The rules derive the default exactly if they derive no other action.
        found[layer.default] = answers[..., layer.actions.index(layer.default)]
        return [{name: float(each[at, 0]) for name, each in found.items()} for at in range(len(answers))]

    def times(self) -> tuple[float, float]:
        """Return the CPU time of a decision, in microseconds: of new scenes, and of known ones."""
        layer, spent = self.make(), []
        # The first scene, for which the layer prepares the rules, does not count.
        layer(*(each[:1] for each in self.inputs), egos=self.egos)
        for _ in range(2):
            start = time.process_time()
            answers = layer(*(each[1:] for each in self.inputs), egos=self.egos)
            answers.sum().backward()
            spent.append((time.process_time() - start) / len(answers) * 1e6)
        return spent[0], spent[1]


def main() -> None:
    """Check, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/logicity")
    parser.add_argument("--config", type=Path, default=ROOT / "configs/expert.yaml")
    parser.add_argument("--rules", type=Path, default=ROOT / "rules/expert.dl")
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--doubts", type=int, default=10, help="uncertain atoms in each scene")
    parser.add_argument("--copies", type=int, default=50, help="how often logicity repeats all scenes in a round")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--layer", action="store_true", help="also measure logicity.torch.RuleLayer")
    arguments = parser.parse_args()
    rules, logicity = rule_files.read(arguments.rules), Logicity(arguments.program, arguments.config)
    problog, draw = Problog(rules), random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenes = record(logicity, folder / "run", arguments.seed, 300, arguments.scenes)
        doubts = [with_doubts(rules, scene, arguments.doubts, draw) for scene in scenes]
        written = [to_json(scene, uncertain) for scene, uncertain in zip(scenes, doubts, strict=True)]
        texts = [problog.text(scene, uncertain) for scene, uncertain in zip(scenes, doubts, strict=True)]
        one, all_scenes, many = folder / "one.jsonl", folder / "scenes.jsonl", folder / "many.jsonl"
        write(one, written[:1])
        write(all_scenes, written)
        write(many, written * arguments.copies)
        layer = Layer(arguments.rules, scenes, doubts, rules.scope) if arguments.layer else None
        answers = [ours(logicity, all_scenes)[0], *([layer.derived()] if layer else [])]
        open_cases = 0
        for *found, text in zip(*answers, texts, strict=True):
            for action, expected in problog.marginals(text).items():
                for each in found:
                    if abs(each.get(action, 0.0) - expected) > 1e-9:
                        raise Refused(f"{action}: logicity {each.get(action, 0.0)}, ProbLog {expected}, in\n{text}")
                open_cases += 0.0 < expected < 1.0
        fast, slow = [], []
        layers: list[tuple[float, float]] = []
        for _ in range(ROUNDS):
            start = time.process_time()
            for text in texts:
                problog.marginals(text)
            slow.append((time.process_time() - start) / len(texts) * 1e6)
            # The start of the program, with the first scene, does not count.
            repeated, first = ours(logicity, many)[1], ours(logicity, one)[1]
            fast.append((repeated - first) / (len(written) * arguments.copies - 1) * 1e6)
            if layer:
                layers.append(layer.times())
    what = f"{open_cases} probabilities between 0 and 1, all equal"
    print(f"{len(scenes)} scenes with {arguments.doubts} uncertain atoms; {what}")
    print(f"logicity  {median(fast):10.1f} us a decision ({min(fast):.1f} to {max(fast):.1f})")
    print(f"ProbLog   {median(slow):10.1f} us a decision ({min(slow):.1f} to {max(slow):.1f})")
    print(f"ratio     {median(slow) / median(fast):10.0f}")
    for name, times in zip(("new", "known"), zip(*layers, strict=True), strict=False):
        print(f"RuleLayer {median(times):10.1f} us a decision, forward and backward, of {name} scenes")
        print(f"ratio     {median(slow) / median(times):10.0f}")


if __name__ == "__main__":
    try:
        main()
    except Refused as error:
        sys.exit(f"error: {error}")
