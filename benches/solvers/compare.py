"""Time one ego's decision by logicity, z3 and clingo on the same facts, after checking that all decide the same.

`make solvers` runs it. Every figure is CPU time on one thread. The facts are prepared in each solver's own form.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import rules as rule_files
from rules import Refused
from scenes import TOGETHER, Logicity, Scene, invent, record, together, write

try:
    import clingo
    import z3  # type: ignore[import-untyped]

    from deciders import DECIDERS, Decider
except ImportError as error:
    sys.exit(f"error: {error}; `make solvers` installs the packages of benches/solvers/requirements.txt")

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = 5
BATCH = 20
"""Decisions between checks of the clock."""


@dataclass
class Row:
    """The measurements of one decider."""

    name: str
    scenes: int
    """The number of scenes that it repeats; less than all if one decision takes long."""
    decisions: int = 0
    rounds: list[float] = field(default_factory=list)
    """Microseconds per decision."""

    @property
    def microseconds(self) -> float:
        """The median of the rounds."""
        return median(self.rounds)


class Timer:
    """Runs one decider over the scenes."""

    def __init__(self, decider: Decider[Any], scenes: Sequence[Scene]) -> None:
        self.decider = decider
        self.facts = decider.prepare(scenes[:: decider.every])
        self.row = Row(decider.name, len(self.facts))
        self.next = 0

    def round(self, seconds: float) -> None:
        """Decide for about this CPU time."""
        decide, facts, done = self.decider.decide, self.facts, 0
        start = time.process_time()
        while (spent := time.process_time() - start) < seconds:
            for _ in range(BATCH):
                decide(facts[self.next])
                self.next = (self.next + 1) % len(facts)
            done += BATCH
        self.row.decisions += done
        self.row.rounds.append(spent / done * 1e6)


class OwnTimer:
    """Runs `logicity bench infer` over scenes."""

    def __init__(self, logicity: Logicity, row: Row, path: Path, written: Sequence[dict[str, Any]]) -> None:
        self.logicity = logicity
        self.row = row
        self.path = path
        self.decisions_each = row.scenes / len(written)
        write(path, written)

    def round(self, seconds: float) -> None:
        """Decide for about this CPU time."""
        asked = ("--scenes", self.path, "--seconds", str(seconds), "--json")
        result = json.loads(self.logicity.call("bench", "infer", "--config", self.logicity.config, *asked))
        self.row.decisions += round(result["evaluations"] * self.decisions_each)
        self.row.rounds.append(result["ns_per_evaluation"] / 1000 / self.decisions_each)


def check(logicity: Logicity, rules: rule_files.Rules, folder: Path, scenes: Sequence[Scene]) -> Counter[str]:
    """Check that all deciders derive the same in every scene. Return how often each action is derived."""
    single, packed = folder / "checked.jsonl", folder / "checked-together.jsonl"
    write(single, [scene.to_json() for scene in scenes])
    write(packed, [scene for group in together(scenes, rules.scope) for scene in group])

    def ours(path: Path, executor: str) -> list[set[str]]:
        answers = [answer for egos in logicity.answers(path, "--executor", executor) for answer in egos.values()]
        # `derived` omits the default.
        return [set(answer["derived"]) or {answer["action"]} for answer in answers]

    expected = ours(single, "relational")
    _compare("logicity, dense", scenes, expected, ours(single, "dense"))
    _compare("logicity, dense, scenes side by side", scenes, expected, ours(packed, "dense"))
    for make in DECIDERS:
        decider = make(rules)
        _compare(decider.name, scenes, expected, [decider.decide(facts) for facts in decider.prepare(scenes)])
    return Counter(" and ".join(sorted(actions)) for actions in expected)


def _compare(name: str, scenes: Sequence[Scene], expected: list[set[str]], found: list[set[str]]) -> None:
    if len(found) != len(scenes):
        raise Refused(f"{name} answers {len(found)} of {len(scenes)} scenes")
    for scene, right, wrong in zip(scenes, expected, found, strict=True):
        if right != wrong:
            message = f"{name} derives {sorted(wrong)}, logicity {sorted(right)}; nothing is timed. The scene:"
            raise Refused(f"{message}\n{json.dumps(scene.to_json())}")


def measure(
    logicity: Logicity, rules: rule_files.Rules, folder: Path, scenes: Sequence[Scene], seconds: float
) -> list[Row]:
    """Measure the deciders in interleaved rounds, so that other load affects all. The first two rows are logicity's."""
    single, packed = Row("logicity", len(scenes)), Row(f"logicity, {TOGETHER} scenes side by side", len(scenes))
    groups = [group[0] for group in together(scenes, rules.scope)]
    timers: list[OwnTimer | Timer] = [
        OwnTimer(logicity, single, folder / "timed.jsonl", [scene.to_json() for scene in scenes]),
        OwnTimer(logicity, packed, folder / "timed-together.jsonl", groups),
        *(Timer(make(rules), scenes) for make in DECIDERS),
    ]
    for done in range(ROUNDS):
        _progress(f"timing, round {done + 1} of {ROUNDS}")
        for timer in timers:
            timer.round(seconds / ROUNDS)
    return [timer.row for timer in timers]


def _progress(what: str) -> None:
    print(f"{what} ..", file=sys.stderr, flush=True)


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table."""
    lines: list[tuple[str, ...]] = [
        ("one ego's decision", "microseconds", "to the first", "to the second", "scenes", "decisions")
    ]
    for row in rows:
        ratios = [row.microseconds / ours.microseconds for ours in rows[:2]]
        places = 3 if row.microseconds < 1 else 1 if row.microseconds < 100 else 0
        ratio_cells = [f"{ratio:,.{0 if ratio >= 10 else 2}f}" for ratio in ratios]
        lines.append((row.name, f"{row.microseconds:,.{places}f}", *ratio_cells, f"{row.scenes}", f"{row.decisions:,}"))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]

    def format_row(cells: Sequence[str]) -> str:
        return f"| {cells[0]:<{widths[0]}} | " + " | ".join(map(str.rjust, cells[1:], widths[1:])) + " |"

    rule = format_row(["-" * widths[0], *("-" * (width - 1) + ":" for width in widths[1:])])
    return "\n".join([format_row(lines[0]), rule, *map(format_row, lines[1:])])


def rules_of(config: Path) -> Path:
    """Return the rule file that a configuration names."""
    try:
        found = re.search(r"^rules:\s*(\S+)\s*$", config.read_text(encoding="utf-8"), re.MULTILINE)
    except OSError as error:
        raise Refused(f"cannot read {config}: {error.strerror}") from None
    if found is None:
        raise Refused(f"{config} itself names no rule file (`rules: FILE`)")
    return config.parent / found.group(1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--config", type=Path, default=ROOT / "configs/expert.yaml", help="city configuration, which names the rules"
    )
    parser.add_argument(
        "--program", type=Path, default=ROOT / "target/release/logicity", help="release build of logicity"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the city and of random scenes")
    parser.add_argument("--ticks", type=_positive, default=300, help="ticks of the city, from which scenes are drawn")
    parser.add_argument("--scenes", type=_positive, default=300, help="scenes to time; checks as many random ones")
    parser.add_argument("--seconds", type=_seconds, default=10, help="CPU seconds for each decider, 0.5 or more")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="folder for the trace and the scenes")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    return parser.parse_args()


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError("not a whole number from 1")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.5 <= seconds <= 3600:
        raise argparse.ArgumentTypeError("not from 0.5 to 3600")
    return seconds


def _run(arguments: argparse.Namespace, folder: Path) -> None:
    logicity = Logicity(arguments.program, arguments.config)
    rules = rule_files.read(rules_of(arguments.config))
    _progress("recording scenes")
    recorded = record(logicity, folder, arguments.seed, arguments.ticks, arguments.scenes)
    invented = invent(rules, arguments.seed, arguments.scenes)
    _progress("checking that all decide the same")
    decisions = check(logicity, rules, folder, [*recorded, *invented])
    rows = measure(logicity, rules, folder, recorded, arguments.seconds)
    versions = {"z3": z3.get_version_string(), "clingo": clingo.__version__}
    if arguments.json:
        result: dict[str, Any] = {
            "config": str(arguments.config),
            "versions": versions,
            "checked": len(recorded) + len(invented),
            "derived": dict(decisions),
            "rows": [
                {
                    "name": row.name,
                    "us_per_decision": row.microseconds,
                    "times_first": row.microseconds / rows[0].microseconds,
                    "times_second": row.microseconds / rows[1].microseconds,
                    "scenes": row.scenes,
                    "decisions": row.decisions,
                    "rounds_us": row.rounds,
                }
                for row in rows
            ],
        }
        print(json.dumps(result))
        return
    counts = ", ".join(f"{count} {actions}" for actions, count in decisions.most_common())
    print(f"all decide the same in {len(recorded)} scenes of a city and {len(invented)} random ones ({counts})")
    print(f"z3 {versions['z3']}, clingo {versions['clingo']}; CPU time, median of {ROUNDS} rounds\n")
    print(table(rows))


def main() -> None:
    """Run the comparison. On failure, exit with 1 and a message."""
    arguments = _arguments()
    try:
        if arguments.keep is not None:
            arguments.keep.mkdir(parents=True, exist_ok=True)
            _run(arguments, arguments.keep)
            return
        with tempfile.TemporaryDirectory(prefix="logicity-solvers-") as folder:
            _run(arguments, Path(folder))
    except (Refused, OSError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
