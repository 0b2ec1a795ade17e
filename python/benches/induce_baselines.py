"""Learn the rules of the modes of Safe Path Following with FOLD-RM, a baseline of the rule learner.

FOLD-RM learns default rules over one table. Its attributes are the groundings of the observation, and its classes are
the actions. It learns from the distinct steps of the recorded training episodes. The accuracy is that on all steps of
the test episodes, and the time is the CPU time of the process. Print a table:

    pip install './python[gym]' foldrm
    python python/benches/induce_baselines.py [MODE...]

`cargo bench --bench induce_baselines -- demonstrations` prints the lines of FOIL and of the learner.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from typing import Any

from foldrm import Classifier

import logicity
from logicity import ACTIONS

MODES = ("easy", "medium", "hard", "expert")


def table(mode: str, split: str) -> tuple[list[str], list[list[str]]]:
    """Return the names of the attributes and one row per step, with its action at the end."""
    demonstrations = logicity.demonstrations(mode, split=split)
    names = [f"{name}({', '.join(map(str, entities))})" for name, entities in demonstrations.atoms]
    rows = [
        [*("1" if value > 0.5 else "0" for value in observation[: len(names)]), ACTIONS[action]]
        for trajectory in demonstrations
        for observation, action in zip(trajectory.observations[:-1], trajectory.actions, strict=True)
    ]
    return names, rows


def distinct(rows: Iterable[list[str]]) -> list[list[str]]:
    """Return the rows without repetitions, in the order of their first occurrence."""
    return [list(row) for row in dict.fromkeys(map(tuple, rows))]


def main() -> None:
    """Print a table."""
    print("| mode | learner | accuracy on test steps | CPU seconds | rules | literals |")
    print("|---|---|---|---|---|---|")
    for mode in sys.argv[1:] or MODES:
        names, rows = table(mode, "train")
        _, test = table(mode, "test")
        learner = Classifier(attrs=names, numeric=[], label="action")
        begin = time.process_time()
        learner.fit(distinct(rows))
        seconds = time.process_time() - begin
        right = sum(learner.classify(row) == row[-1] for row in test)
        rules = learner.rules
        print(f"| {mode} | FOLD-RM | {right / len(test):.4f} | {seconds:.2f} | {len(rules)} | {size(rules)} |")


def size(rules: Iterable[tuple[Any, ...]]) -> int:
    """Return the number of literals of rules and of their exceptions."""
    return sum(len(body) + size(exceptions) for _, body, exceptions, _ in rules)


if __name__ == "__main__":
    main()
