"""Rules that recorded traffic follows: from trajectories to a city with learned rules and a report.

The engine computes all facts from the cells of agents, and all decisions of the learned rules. This module says what
the moments and their actions are, and counts.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from . import _logicity
from .errors import did_you_mean
from .files import check_writable, json_text, write_text
from .placement import Moment, Placement, Roads, Streets, Thresholds, place
from .terminal import neutral
from .trajectories import Recording

__all__ = ["Distilled", "Settings", "config_for", "distill"]

#: The files that `distill` writes.
FILES = ("city.yaml", "map.yaml", "words.dl", "rules.dl", "report.md", "report.json", "wrong.jsonl")

#: An entry of `wrong.jsonl` and of the lists in the report.
WRONG_MAX = 200


@dataclass(frozen=True)
class Settings:
    """How `distill` learns.

    Attributes:
        config: The configuration that defines the base predicates. Its rules define the words of the learned clauses.
            See `config_for`.
        map: A map file, or `None` for the map of the configuration.
        use: The predicates that clauses may use; by default those that the rules of the configuration derive, its base
            predicates about one agent, and `SameInter`.
        moments: Which moments to learn from: those in which a car decides at a line, or all of all cars.
        reaction: The ticks before a start that are no moments at a line: the driver may have been free to go already.
        test: The share of the recording that is held out.
        split: Whether the last part of the time is held out, or agents drawn by a hash of the seed and their ids.
        noise: The share of moments that may have a wrong action, or `"auto"` to estimate it.
        variables: The largest number of variables of a clause.
        seed: The seed of the learner and of the split by agents.
        thresholds: The thresholds of actions and lines.
    """

    config: str = "right-of-way"
    map: str | None = None
    use: tuple[str, ...] | None = None
    moments: Literal["junctions", "all"] = "junctions"
    reaction: int = 2
    test: float = 0.3
    split: Literal["time", "agents"] = "time"
    noise: float | Literal["auto"] = "auto"
    variables: int = 2
    seed: int = 0
    thresholds: Thresholds = field(default_factory=Thresholds)


def config_for(map: Streets) -> str:
    """Return the built-in configuration with the words of right of way on such a map."""
    return "right-of-way-roads" if isinstance(map, Roads) else "right-of-way"


@dataclass
class Tally:
    """Decisions of drivers and of rules.

    Attributes:
        counts: The number of moments by the action of the driver and that of the rules.
    """

    counts: dict[tuple[str, str], int] = field(default_factory=dict)

    def add(self, driver: str, rules: str) -> None:
        """Add a moment."""
        self.counts[driver, rules] = self.counts.get((driver, rules), 0) + 1

    @property
    def total(self) -> int:
        """The number of moments."""
        return sum(self.counts.values())

    @property
    def share(self) -> float | None:
        """The share of moments in which the rules act as the driver did; `None` without moments."""
        right = sum(count for (driver, rules), count in self.counts.items() if driver == rules)
        return right / self.total if self.total else None

    @property
    def most_frequent(self) -> float | None:
        """The share that the most frequent action of drivers alone explains; `None` without moments."""
        by_driver: dict[str, int] = {}
        for (driver, _), count in self.counts.items():
            by_driver[driver] = by_driver.get(driver, 0) + count
        return max(by_driver.values()) / self.total if self.total else None

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers for a report."""
        confusion: dict[str, dict[str, int]] = {}
        for (driver, rules), count in sorted(self.counts.items()):
            confusion.setdefault(driver, {})[rules] = count
        return {
            "moments": self.total,
            "explained": self.share,
            "most_frequent_action": self.most_frequent,
            "by_driver_and_rules": confusion,
        }


@dataclass(frozen=True)
class Distilled:
    """The result of `distill`.

    Attributes:
        folder: The folder with the city.
        clauses: The learned clauses, in the notation of rule files.
        report: The content of `report.json`.
    """

    folder: Path
    clauses: tuple[str, ...]
    report: dict[str, Any]


@dataclass
class _Example:
    """A moment of a car with what it sees."""

    tick: int
    moment: Moment
    is_test: bool
    #: Whether no other agent is in the intersection at which the car is; `None` elsewhere.
    is_free: bool | None
    #: The line of the file that the learner reads.
    line: str


def distill(
    recording: Recording,
    grid: Streets,
    out: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    overwrite: bool = False,
    source: str = "",
    progress: Callable[[str], object] = lambda line: None,
) -> Distilled:
    """Learn the rules that recorded traffic follows, and write a city with them and a report.

    The same arguments give the same bytes.

    Args:
        recording: The tracks, from `read_trajectories`.
        grid: The map in the plane of the recording.
        out: The folder to write: `city.yaml`, `rules.dl`, `report.md`, `report.json`, `wrong.jsonl`, and the map and
            the words if they are no built-in files.
        settings: How to learn.
        overwrite: Whether to replace files that `distill` did not write, or that have changed since.
        source: What was recorded, in words, for the report.
        progress: Called with a line about each step.

    Raises:
        InputError: If the configuration, its rules or the map is invalid.
        OSError: If a file cannot be read or written.
        ValueError: If the recording has no moment to learn from, or the learner fails.
    """
    chosen = settings or Settings()
    folder = Path(out)
    for name in FILES if folder.exists() else ():
        check_writable(folder / name, by="distill", overwrite=overwrite)
    placement = place(recording, grid, chosen.thresholds)
    count = sum(map(len, placement.moments.values()))
    progress(f"{len(recording.tracks)} tracks, {count} states on the map, {placement.outside} off it")
    words = _Words(chosen)
    left_out = _without_reaction(placement, chosen)
    examples = list(_examples(placement, left_out, words, chosen, progress))
    train = [example for example in examples if not example.is_test]
    test = [example for example in examples if example.is_test]
    if not train or not test:
        what = "to learn from" if not train else "held out"
        where = " at the line of an intersection" if chosen.moments == "junctions" else ""
        help = _why_empty(recording, grid, placement)
        raise ValueError(f"the recording has no moment {what}{where}\nhelp: {help}")
    progress(f"{len(train)} moments to learn from, {len(test)} held out")
    learned = _learn(train, words, chosen)
    progress(f"{len(learned['clauses'])} clauses learned")
    files = _city(words, chosen, learned, folder)
    with tempfile.TemporaryDirectory() as place_of:
        for name, text in files.items():
            Path(place_of, name).write_text(text, encoding="utf-8", newline="\n")
        measured = _Measured(words, chosen, learned, placement, examples, Path(place_of), folder, progress)
    rules = _rules(words, learned, measured, chosen, source)
    report = _report(words, chosen, learned, measured, placement, left_out, recording, grid, source)
    files |= {
        "rules.dl": rules,
        "report.json": json_text(report),
        "report.md": _markdown(report),
        "wrong.jsonl": "".join(line + "\n" for line in measured.scenes),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_text(folder / name, text, by="distill", overwrite=overwrite)
    return Distilled(folder, tuple(clause["rule"] for clause in report["clauses"]), report)


def _why_empty(recording: Recording, grid: Streets, placement: Placement) -> str:
    """Return what to check about a recording without moments to learn from, or to hold out."""
    states = sum(map(len, placement.moments.values()))
    if not recording.tracks:
        return "no state is read: check the times against `--begin` (0 by default) and `--end`, and the classes"
    if all(len(track) == 1 for track in recording.tracks):
        return "each agent has one state, or states farther apart than a gap: are the times in seconds?"
    if placement.outside > states:
        plane = "the units of x and y" if isinstance(grid, Roads) else "`--cell`, `--origin` and `--y`"
        return f"{placement.outside} of {placement.outside + states} states are off the map: check {plane}"
    return (
        "no car drives over the end of a lane that leads to an intersection, in the part of the time that is needed: "
        "check the map, `--line`, `--length` and `--test`"
    )


class _Words:
    """The predicates of a configuration and of its rules."""

    def __init__(self, settings: Settings) -> None:
        self.config = settings.config
        self.inference = _logicity.Inference(settings.config, None, settings.seed, "auto", (None, None, None), None)
        known = {name: (columns, derived) for name, columns, derived in self.inference.agent_predicates()}
        base = [name for name, (columns, derived) in known.items() if not derived and columns == 1]
        own = [name for name, (_, derived) in known.items() if derived]
        if settings.use is not None:
            for name in settings.use:
                if name not in known:
                    raise ValueError(_not_a_word(settings.config, name, known))
            self.names = list(dict.fromkeys(settings.use))
        elif own:
            self.names = [*base, *({"SameInter"} & known.keys()), *own]
        else:
            self.names = list(known)
        self.columns = {name: known[name][0] for name in self.names}
        self.derived = [name for name in self.names if known[name][1]]
        #: Whether the words can say that an intersection is free.
        self.sees_intersections = {"IsInInter", "SameInter"} <= known.keys()
        self.asked = list(dict.fromkeys([*self.names, "Sees", *(["IsInInter", "SameInter"] * self.sees_intersections)]))

    def rows(self, scene: str) -> dict[str, list[list[str]]]:
        """Return the rows of the words in a scene."""
        return dict(zip(self.asked, self.inference.rows(scene, self.asked), strict=True))


def _not_a_word(config: str, name: str, known: Iterable[str]) -> str:
    """Return why a name is no word, as the message of an error."""
    file = _logicity.ConfigFile(config, "configs").value()
    if "quantity" in (file.get("predicates", {}).get("define", {}).get(name) or {}):
        help = f"use a predicate about agents alone that reads it, in the rules of `{config}`"
        return f"`{name}` of `{config}` has a value, which no clause of the learner reads\nhelp: {help}"
    return f"`{config}` has no predicate `{name}`{did_you_mean(name, known)}"


def _map_of(settings: Settings) -> Any:
    return {"config": settings.config} if settings.map is None else settings.map


def _scene(moments: Sequence[Moment], tick: int, map: Any) -> dict[str, Any]:
    agents = []
    for moment in moments:
        agent: dict[str, Any] = {"id": moment.id, "type": moment.kind, "at": list(moment.at), "heading": moment.heading}
        agent |= {"speed": moment.moved, "waited": moment.waited}
        if moment.exit is not None:
            agent["exit"] = moment.exit
        agents.append(agent)
    return {"map": map, "tick": tick, "agents": agents}


def _chosen(moments: Sequence[Moment], settings: Settings) -> list[Moment]:
    """Return the moments of a tick to learn from."""
    known = [moment for moment in moments if moment.kind == "Car" and moment.action is not None]
    if settings.moments == "junctions":
        return [moment for moment in known if moment.is_decision]
    return known


def _without_reaction(placement: Placement, settings: Settings) -> set[tuple[int, str]]:
    """Return the ticks and ids of cars that stand at a line and start within the reaction time."""
    left_out: set[tuple[int, str]] = set()
    starts: dict[str, int] = {}
    for tick, moments in reversed(placement.moments.items()):
        for moment in moments:
            if not moment.is_decision:
                continue
            if moment.action != "Stop":
                starts[moment.id] = tick
            elif starts.get(moment.id, math.inf) - tick <= settings.reaction:
                left_out.add((tick, moment.id))
    return left_out


def _examples(
    placement: Placement,
    left_out: set[tuple[int, str]],
    words: _Words,
    settings: Settings,
    progress: Callable[[str], object],
) -> Iterator[_Example]:
    ticks = list(placement.moments)
    begin_test = ticks[0] + (1 - settings.test) * (ticks[-1] + 1 - ticks[0]) if ticks else 0
    for number, tick in enumerate(ticks):
        if number and number % 500 == 0:
            progress(f"{number} of {len(ticks)} ticks")
        moments = placement.moments[tick]
        chosen = [each for each in _chosen(moments, settings) if (tick, each.id) not in left_out]
        if not chosen:
            continue
        rows = words.rows(json.dumps(_scene(moments, tick, _map_of(settings))))
        seen: dict[str, set[str]] = {}
        for one, other in rows["Sees"]:
            seen.setdefault(one, {one}).add(other)
        inside = {row[0] for row in rows["IsInInter"]} if words.sees_intersections else set()
        for moment in chosen:
            view = seen.get(moment.id, {moment.id})
            others = {y for x, y in rows["SameInter"] if x == moment.id} if words.sees_intersections else set()
            is_free = not (others & inside) if moment.is_decision and words.sees_intersections else None
            facts = {}
            for name in words.names:
                kept = [row for row in rows[name] if view.issuperset(row)]
                if kept:
                    facts[name] = kept
            entities = [moment.id, *sorted(view - {moment.id})]
            line = json.dumps(
                {"entities": entities, "ego": moment.id, "facts": facts, "actions": {moment.id: moment.action}}
            )
            yield _Example(tick, moment, _is_test(moment, tick, begin_test, settings), is_free, line)


def _is_test(moment: Moment, tick: int, begin_test: float, settings: Settings) -> bool:
    if settings.split == "time":
        return tick >= begin_test
    digest = hashlib.sha256(f"{settings.seed} {moment.id}".encode()).digest()
    return int.from_bytes(digest[:8], "big") < settings.test * 2**64


def _learn(train: Sequence[_Example], words: _Words, settings: Settings) -> dict[str, Any]:
    """Return the report of `logicity induce` on the examples."""
    declared = {each["name"] for each in _vocabulary()}
    more = [f".decl {name}({_columns(words.columns[name])})" for name in words.names if name not in declared]
    inputs = [name for name in words.names if name not in declared]
    rules = ['.include "vocabulary.dl"', *more, *([f".input {', '.join(inputs)}"] if inputs else []), ""]
    # The scenes state all facts, so only the names and the numbers of columns matter.
    standard = _logicity.ConfigFile("standard", "configs/predicates").value()["define"]
    own = [name for name in words.names if name not in standard]
    define = {name: {"external": "agent" if words.columns[name] == 1 else "pair"} for name in own}
    config = {
        "base": "configs/common.yaml",
        "rules": "words.dl",
        "predicates": {"use": words.names, "define": define},
        "agents": {"test": {"cars": [{"priority": 1}]}},
    }
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "words.dl").write_text("\n".join(rules), encoding="utf-8", newline="\n")
        Path(folder, "words.yaml").write_text(json.dumps(config), encoding="utf-8", newline="\n")
        Path(folder, "train.jsonl").write_text(
            "".join(each.line + "\n" for each in train), encoding="utf-8", newline="\n"
        )
        arguments = ["induce", "train.jsonl", "--config", "words.yaml", "-o", "learned.dl", "--report", "report.json"]
        arguments += ["--noise", str(settings.noise), "--variables", str(settings.variables)]
        arguments += ["--seed", str(settings.seed)]
        # The command limits the memory of its process, which must not be this one.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        command = [sys.executable, "-m", "logicity", *arguments]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False)
        if done.returncode != 0:
            raise ValueError(f"the learner failed: {neutral(done.stderr.strip())}")
        learned: dict[str, Any] = json.loads(Path(folder, "report.json").read_text(encoding="utf-8"))
    return learned


def _vocabulary() -> list[dict[str, Any]]:
    name, text = "vocabulary.dl", _logicity.read_file("rules/vocabulary.dl")
    return _logicity.Program([(name, text)], []).predicates()


def _columns(count: int) -> str:
    return ", ".join(f"{name}: agent" for name in "xyz"[:count])


def _builtin_config(name: str) -> str:
    return name if "/" in name or name.endswith(".yaml") else f"configs/{name}.yaml"


#: What holds in all moments at a line.
_AT_LINE = "IsAtInter(X)"


def _clause(clause: dict[str, Any], before: Sequence[str], always: Sequence[str]) -> str:
    """Return a learned clause as rule files write it. `before` are the actions with precedence."""
    # Who is at a line sees itself; the learner writes so where nothing else binds X.
    learned = [literal for literal in clause["body"] if not (always and literal == "Sees(X, X)")]
    body = [*(literal for literal in always if literal not in learned), *learned]
    literals = [*(f"Not({action}(X))" for action in before), *body]
    return f"{clause['action']}(X) :- {', '.join(literals)}."


def _clauses(learned: dict[str, Any], words: _Words, settings: Settings) -> list[str]:
    order = [action["action"] for action in learned["actions"]]
    # Clauses that were learned at lines say nothing about cars elsewhere.
    always = [_AT_LINE] if settings.moments == "junctions" and "IsAtInter" in words.names else []
    return [_clause(clause, order[: order.index(clause["action"])], always) for clause in learned["clauses"]]


def _city(words: _Words, settings: Settings, learned: dict[str, Any], folder: Path) -> dict[str, str]:
    """Return the texts of the files of the city, without comments on the clauses."""
    files: dict[str, str] = {}
    config = settings.config
    base = os.path.relpath(config, folder) if os.path.exists(config) else _builtin_config(config)
    lines = ["# A city with the rules of recorded traffic, written by logicity distill.", f"base: {json.dumps(base)}"]
    if settings.map is not None:
        map = settings.map
        if os.path.exists(map):
            files["map.yaml"] = json_text(_logicity.ConfigFile(map, "maps").value())
            map = "map.yaml"
        lines.append(f"map: {json.dumps(map)}")
    lines.append("rules: rules.dl")
    files["city.yaml"] = "\n".join(lines) + "\n"
    included, own = _rules_of(config)
    if own is not None:
        files["words.dl"] = _inlined(own, set())
    files["rules.dl"] = "\n".join([f'.include "{included}"', *_clauses(learned, words, settings), ""])
    return files


def _inlined(path: Path, seen: set[Path]) -> str:
    """Return a rule file with the text of the files on disk that it includes. Built-in ones stay included."""
    seen.add(path.resolve())
    lines = []
    # Other line breaks can occur in comments and strings.
    for line in path.read_text(encoding="utf-8").removesuffix("\n").split("\n"):
        found = re.match(r'\s*\.include\s+"([^"]+)"\s*(//.*)?$', line)
        included = None if found is None else path.parent / found[1]
        if included is None or not included.is_file():
            lines.append(line)
        elif included.resolve() not in seen:
            lines.append(_inlined(included, seen))
    return "\n".join(lines) + "\n"


def _rules_of(config: str) -> tuple[str, Path | None]:
    """Return the name by which the city includes the rules of a configuration, and their file if it is on disk."""
    file = _logicity.ConfigFile(config, "configs")
    rules = str(file.value()["rules"])
    by = file.file_of(["rules"]) or ""
    beside = Path(by).parent / rules
    if not by.startswith("<builtin>") and beside.is_file():
        return "words.dl", beside
    return Path(rules).with_suffix(".dl").name, None


class _Measured:
    """What the learned rules decide in all moments, as the engine computes it."""

    def __init__(
        self,
        words: _Words,
        settings: Settings,
        learned: dict[str, Any],
        placement: Placement,
        examples: Sequence[_Example],
        city: Path,
        folder: Path,
        progress: Callable[[str], object],
    ) -> None:
        clauses = _clauses(learned, words, settings)
        #: The rules with a predicate for each clause.
        text = (city / "rules.dl").read_text(encoding="utf-8")
        for number, clause in enumerate(clauses):
            text += f".decl Clause{number}(x: agent)\nClause{number}{clause[clause.index('(') :]}\n"
        (city / "counted.dl").write_text(text, encoding="utf-8", newline="\n")
        limits = (None, None, None)
        config = settings.config
        # The words of the configuration are at its place.
        if os.path.exists(config):
            base = os.path.abspath(config)
            lines = (city / "city.yaml").read_text(encoding="utf-8").splitlines()
            lines = [f"base: {json.dumps(base)}" if line.startswith("base:") else line for line in lines]
            (city / "city.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
        rules = str(city / "counted.dl")
        inference = _logicity.Inference(str(city / "city.yaml"), rules, settings.seed, "auto", limits, None)
        names = [f"Clause{number}" for number in range(len(clauses))]
        self.tallies = {part: {what: Tally() for what in ("all", "line", "free")} for part in ("train", "test")}
        self.fired = [{"train": [0, 0], "test": [0, 0]} for _ in clauses]
        self.wrong: list[dict[str, Any]] = []
        self.scenes: list[str] = []
        by_tick: dict[int, list[_Example]] = {}
        for example in examples:
            by_tick.setdefault(example.tick, []).append(example)
        shown = str(folder / "map.yaml") if settings.map is not None and os.path.exists(settings.map) else None
        for number, (tick, moments) in enumerate(by_tick.items()):
            if number and number % 500 == 0:
                progress(f"decided {number} of {len(by_tick)} ticks")
            scene = _scene(placement.moments[tick], tick, _map_of(settings))
            egos = [example.moment.id for example in moments]
            text = json.dumps({**scene, "egos": egos})
            answer = inference.answer(text)["egos"]
            holds = [{row[0] for row in rows} for rows in inference.rows(text, names)]
            wrong = []
            for example in moments:
                moment = example.moment
                part = "test" if example.is_test else "train"
                driver, rules_ = str(moment.action), answer[moment.id]["action"]
                self.tallies[part]["all"].add(driver, rules_)
                if moment.is_decision:
                    self.tallies[part]["line"].add(driver, rules_)
                if example.is_free:
                    self.tallies[part]["free"].add(driver, rules_)
                for at, rows in enumerate(holds):
                    if moment.id in rows:
                        self.fired[at][part][0] += 1
                        self.fired[at][part][1] += driver == learned["clauses"][at]["action"]
                if example.is_test and driver != rules_:
                    wrong.append(moment)
                    self.wrong.append(
                        {
                            "tick": tick,
                            "id": moment.id,
                            "at": list(moment.at),
                            "heading": moment.heading,
                            "driver": driver,
                            "rules": rules_,
                            "at_line": moment.is_decision,
                            "free": example.is_free,
                        }
                    )
            if wrong and len(self.scenes) < WRONG_MAX:
                map = _map_of(settings) if shown is None else shown
                scene = _scene(placement.moments[tick], tick, map)
                labels = {moment.id: moment.action for moment in wrong}
                self.scenes.append(json.dumps({**scene, "egos": list(labels), "actions": labels}))


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _rules(words: _Words, learned: dict[str, Any], measured: _Measured, settings: Settings, source: str) -> str:
    """Return the rule file with the coverage of each clause."""
    test = measured.tallies["test"]
    about = f" from {source}" if source else ""
    lines = [
        f"// Rules learned by logicity distill {_logicity.__version__}{about}.",
        f"// They explain {_percent(test['line'].share)} of {test['line'].total} held-out moments at lines,",
        f"// and {_percent(test['free'].share)} of the {test['free'].total} of them in which the intersection is free.",
    ]
    lines.append(f'.include "{_rules_of(settings.config)[0]}"')
    for clause, text, fired in zip(learned["clauses"], _clauses(learned, words, settings), measured.fired, strict=True):
        (holds, right), (holds_test, right_test) = fired["train"], fired["test"]
        lines += [
            "",
            f"/// {clause['label']}: right in {right} of {holds} moments, {right_test} of {holds_test} held-out ones",
            f"/// It alone explains {clause['alone']}.",
            text,
        ]
    if not learned["clauses"]:
        lines += ["", "// No clause: all moments have the default action."]
    return "\n".join(lines) + "\n"


def _report(
    words: _Words,
    settings: Settings,
    learned: dict[str, Any],
    measured: _Measured,
    placement: Placement,
    left_out: set[tuple[int, str]],
    recording: Recording,
    grid: Streets,
    source: str,
) -> dict[str, Any]:
    thresholds = settings.thresholds
    clauses = []
    for clause, text, fired in zip(learned["clauses"], _clauses(learned, words, settings), measured.fired, strict=True):
        clauses.append(
            {
                "label": clause["label"],
                "rule": text,
                "train": {"holds": fired["train"][0], "right": fired["train"][1]},
                "test": {"holds": fired["test"][0], "right": fired["test"][1]},
                "alone": clause["alone"],
                "notes": clause["notes"],
            }
        )
    wrong = measured.wrong
    return {
        "source": source,
        "version": _logicity.__version__,
        "recording": {
            "tracks": len(recording.tracks),
            "samples": recording.samples,
            "left_out": recording.left_out,
            "states": sum(map(len, placement.moments.values())),
            "off_map": placement.outside,
            "left_out_before_starts": len(left_out),
        },
        "settings": {
            "config": settings.config,
            "map": settings.map,
            "words": words.names,
            "tick_seconds": recording.tick,
            "cell_meters": grid.cell,
            "origin_meters": list(grid.origin),
            "y_up": grid.y_up,
            "stop_below": thresholds.stop,
            "halt_below": thresholds.halt,
            "slow_below": thresholds.slow,
            "fast_above": thresholds.fast,
            "line_meters": thresholds.line,
            "length_meters": thresholds.length,
            "positions": "front" if thresholds.front else "center",
            "moments": settings.moments,
            "reaction_ticks": settings.reaction,
            "held_out": settings.test,
            "split": settings.split,
            "noise": learned["noise"],
            "variables": settings.variables,
            "seed": settings.seed,
        },
        "train": {what: tally.to_dict() for what, tally in measured.tallies["train"].items()},
        "test": {what: tally.to_dict() for what, tally in measured.tallies["test"].items()},
        "clauses": clauses,
        "wrong_count": len(wrong),
        "wrong": wrong[:WRONG_MAX],
    }


#: The parts of the report, in the order of its table.
_PARTS = {
    "all": "all moments",
    "line": "at the line of an intersection",
    "free": "of these, the intersection is free",
}


def _markdown(report: dict[str, Any]) -> str:
    settings, recording = report["settings"], report["recording"]
    origin = f" of {report['source']}" if report["source"] else ""
    lines = [
        f"# What the rules explain{origin}",
        "",
        f"{recording['tracks']} tracks with {recording['states']} states on the map, one every "
        f"{settings['tick_seconds']:g} s.",
        f"{recording['left_out_before_starts']} moments just before a start are left out.",
        "",
        "| held-out moments | number | explained by the rules | by the most frequent action |",
        "|---|---|---|---|",
    ]
    for part, words in _PARTS.items():
        row = report["test"][part]
        shares = f"{_percent(row['explained'])} | {_percent(row['most_frequent_action'])}"
        lines.append(f"| {words} | {row['moments']} | {shares} |")
    lines += ["", "## Rules", ""]
    for clause in report["clauses"]:
        holds, right = clause["test"]["holds"], clause["test"]["right"]
        lines += ["```dl illustration", clause["rule"], "```", "", f"Right in {right} of {holds} held-out moments.", ""]
    if not report["clauses"]:
        lines += ["None: all moments have the default action.", ""]
    lines += ["## What they get wrong", "", "| driver | rules | held-out moments |", "|---|---|---|"]
    for driver, row in report["test"]["all"]["by_driver_and_rules"].items():
        lines += [f"| {driver} | {rules} | {count} |" for rules, count in row.items() if rules != driver]
    lines += ["", "`wrong.jsonl` has the scenes, for `logicity infer` from where `distill` ran. The first moments:", ""]
    lines += ["| tick | id | cell | heading | driver | rules |", "|---|---|---|---|---|---|"]
    for wrong in report["wrong"][:40]:
        id = neutral(wrong["id"], lines=False).replace("|", "\\|")
        row, column = wrong["at"]
        heading = wrong["heading"]
        lines.append(f"| {wrong['tick']} | {id} | {row}, {column} | {heading} | {wrong['driver']} | {wrong['rules']} |")
    lines += ["", "## Settings", "", "| setting | value |", "|---|---|"]
    for name, value in settings.items():
        shown = ", ".join(map(str, value)) if isinstance(value, list) else value
        lines.append(f"| {name.replace('_', ' ')} | {shown} |")
    return "\n".join(lines) + "\n"
