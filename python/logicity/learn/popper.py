"""Popper and MaxSynth: adapters to an installed Popper, a learner of logic programs.

Popper [1] searches for a program that derives all positive examples and no negative one. MaxSynth [2] is Popper's noisy
mode: it minimizes the description length of the program and of its errors. As in the LogiCity paper (appendix "Detailed
Baseline Configurations"), each action is a separate task, the time limit is 300 seconds, and other parameters have
their defaults.

Popper has no negated literals. For rules with `Not`, each false observed atom is a fact of a predicate with `not_`
before its name (`Demonstrations.to_popper`). That doubles the predicates of a task, so by default the first search has
positive literals only, and half of the time limit. A second one follows if the first has no exact program.

After its time limit, Popper prints its best program with counts that it has not tested. So the learner counts the
examples that a program explains itself.

[1] Cropper, Morel: Learning programs by learning from failures. Machine Learning 110, 2021.
[2] Hocquette, Niskanen, Jarvisalo, Cropper: Learning MDL logic programs from noisy data. AAAI 2024.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import takewhile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

import numpy as np
from pydantic import Field

from ..city import ACTIONS
from ..files import read_json, write_json
from ..offline import Demonstrations, popper_names
from ..rule_policy import RulePolicy
from .programs import Running, run_program
from .settings import Count, LearnerSettings, Positive
from .symbolic import SymbolicLearner, arities, clause

__all__ = ["MaxSynthLearner", "Outcome", "PopperLearner", "PopperSettings", "Printed", "read_output", "run_popper"]

#: The versions that Popper needs.
NEEDS = "Popper 5 needs Python >= 3.14 and SWI-Prolog >= 9.2"

#: Seconds that Popper has to end after its time limit.
GRACE = 30.0

#: The interval of lines about a running search, in seconds.
INTERVAL = 10.0

_ATOM = r"\w+\(\s*[A-Z]\w*(?:\s*,\s*[A-Z]\w*)*\s*\)"
#: A clause as Popper prints it, also behind the time of a line of its log.
_CLAUSE = re.compile(rf"{_ATOM}\s*:-\s*(?:{_ATOM}(?:\s*,\s*{_ATOM})*)?\s*\.?\s*$")


class PopperSettings(LearnerSettings):
    """The settings of Popper and MaxSynth."""

    program: Annotated[list[str], Field(strict=False)] = []
    """The words of the command that runs Popper, such as `[python3.14, /opt/Popper/popper.py]`. By default the command
    `popper-ilp` or `popper`."""
    timeout: Positive = 300.0
    """The time limit of each action in seconds, that of the paper."""
    negated: Literal["auto"] | bool = "auto"
    """Whether rules may have negated literals, whose predicates double those of a task. `auto` searches with positive
    literals first, for half of the time limit, and with negated ones if that gives no exact program."""
    max_vars: Count | None = None
    """The largest number of variables of a rule. By default (null) Popper's, 6. With fewer, the search is much shorter:
    the rules of easy mode have 2."""
    distinct: bool = True
    """Whether demonstrated steps with the same observation and action are one example."""
    arguments: list[str] = []
    """Further arguments of the command."""


class Printed(NamedTuple):
    """What Popper printed.

    Attributes:
        clauses: The clauses of its program, in the syntax of rule files.
        timed_out: Whether it stopped at its time limit, so that there may be a better program.
    """

    clauses: tuple[str, ...]
    timed_out: bool


@dataclass(frozen=True)
class Outcome:
    """What the searches for the rules of an action found.

    Attributes:
        clauses: The clauses of the action, in the syntax of rule files.
        negated: Whether the search that found them, or the last one, had negated literals.
        optimal: Whether Popper has ruled out a better program with these literals.
        timed_out: Whether a search stopped at the time limit.
        seconds: The wall time of all searches.
        positive: The number of examples of the action.
        true_positives: How many of them the clauses derive, counted here.
        negative: The number of other examples.
        false_positives: How many of them the clauses derive.
        failure: Why a search failed, or an empty text.
    """

    action: str
    clauses: tuple[str, ...]
    negated: bool
    optimal: bool
    timed_out: bool
    seconds: float
    positive: int
    true_positives: int
    negative: int
    false_positives: int
    failure: str

    @property
    def errors(self) -> int:
        """The number of examples for which the clauses are wrong."""
        return self.positive - self.true_positives + self.false_positives

    def text(self) -> str:
        """Say in a line what was found."""
        if self.failure and not self.clauses:
            return f"failed after {self.seconds:.0f} s: {self.failure}"
        if not self.clauses:
            return f"{'time-out' if self.timed_out else 'no program exists'}: no rules after {self.seconds:.0f} s"
        ended = "optimal" if self.optimal else "time-out" if self.timed_out else "a further search failed"
        counts = f"{self.true_positives} of {self.positive} examples of the action"
        counts += f" and {self.false_positives} of {self.negative} others"
        return f"{len(self.clauses)} clauses derive {counts}; {ended} after {self.seconds:.0f} s"


class PopperLearner(SymbolicLearner):
    """Popper, run for each action."""

    settings_class = PopperSettings
    takes_numbers = False
    #: The arguments that select the algorithm.
    selection: ClassVar[tuple[str, ...]] = ()
    _outcomes: Sequence[dict[str, Any]] = ()

    def rules(self, data: Demonstrations) -> str:
        """Return the rules that Popper finds. An action for which it finds none has a comment instead.

        Raises:
            ChildProcessError: If Popper fails for all actions, or its output is not understood.
            FileNotFoundError: If Popper is not installed.
            ValueError: If it finds no rule for any action.
        """
        settings = cast(PopperSettings, self.config.settings)
        program = find_popper(settings.program)
        outcomes = [self._learned(program, data, action) for action in data.asked]
        if not any(outcome.clauses for outcome in outcomes):
            raise _no_rules(self.config.algorithm, outcomes, settings.timeout)
        # Lists, as JSON has them.
        self._outcomes = [{**asdict(outcome), "clauses": list(outcome.clauses)} for outcome in outcomes]
        lines = ['.include "vocabulary.dl"']
        for outcome in outcomes:
            lines += ["", f"// {outcome.action}: {outcome.text()}.", *outcome.clauses]
        return "\n".join(lines) + "\n"

    def _learned(self, program: Sequence[str], data: Demonstrations, action: str) -> Outcome:
        """Search for the rules of an action. A failure of a search does not lose what an earlier one found."""
        settings = cast(PopperSettings, self.config.settings)
        signs = [False, True] if settings.negated == "auto" else [settings.negated]
        begun, best = time.monotonic(), None
        for at, negated in enumerate(signs):
            left = settings.timeout - (time.monotonic() - begun)
            limit = left if at == len(signs) - 1 else left / 2
            found, failure = Printed((), timed_out=False), ""
            try:
                found = self._search(program, data, action, negated, max(limit, 1.0))
            except ChildProcessError as error:
                failure = str(error)
            clauses, timed_out = found
            is_optimal, counts = bool(clauses) and not timed_out, self._counts(data, action, clauses)
            seconds = round(time.monotonic() - begun, 2)
            outcome = Outcome(action, clauses, negated, is_optimal, timed_out, seconds, **counts, failure=failure)
            best = outcome if best is None else _better(best, outcome)
            if best.clauses and best.errors == 0:
                break
        assert best is not None
        self.say(f"{self.config.algorithm}, {action}: {best.text()}")
        return best

    def _search(self, words: Sequence[str], data: Demonstrations, action: str, negated: bool, limit: float) -> Printed:
        """Run Popper for an action, with a time limit, and print a line about it every `INTERVAL` seconds."""
        settings = cast(PopperSettings, self.config.settings)
        shown = 0.0

        def watch(running: Running) -> None:
            nonlocal shown
            if running.seconds - shown >= INTERVAL:
                shown = running.seconds
                literals = "with negated literals" if negated else "positive literals"
                last = f"; {running.line}" if running.line else ""
                self.say(f"{self.config.algorithm}, {action}, {literals}: {running.seconds:.0f} of {limit:.0f} s{last}")

        with TemporaryDirectory() as folder:
            tasks = data.to_popper(folder, distinct=settings.distinct, negated=negated, max_vars=settings.max_vars)
            task = tasks[data.asked.index(action)]
            command = [*words, os.fspath(task), "--timeout", f"{limit:g}", *self.selection, *settings.arguments]
            return read_output(run_popper(command, limit, watch), action, arities(data.atoms))

    def _counts(self, data: Demonstrations, action: str, clauses: Sequence[str]) -> dict[str, int]:
        """Count the examples of an action and the others, and those of both that clauses derive."""
        settings = cast(PopperSettings, self.config.settings)
        examples = list(data.examples(distinct=settings.distinct))
        number = ACTIONS.index(action)
        taken = np.array([done for _, done in examples]) == number
        derived = np.zeros(len(examples), bool)
        if clauses:
            # Without rules of other actions, an ego takes the action exactly if a clause holds.
            policy = RulePolicy.from_text("\n".join(['.include "vocabulary.dl"', *clauses]), self.config.mode)
            derived = policy(np.stack([observation for observation, _ in examples])) == number
        parts = {"positive": taken, "true_positives": taken & derived}
        parts |= {"negative": ~taken, "false_positives": ~taken & derived}
        return {name: int(part.sum()) for name, part in parts.items()}

    def outcome(self) -> dict[str, Any]:
        """Return the searches of the actions."""
        return {"searches": self._outcomes} if self._outcomes else {}

    def save(self, folder: Path) -> None:
        """Write the rules and the searches, if training is over."""
        super().save(folder)
        if self._outcomes:
            write_json(folder / "searches.json", self._outcomes)

    def restore(self, folder: Path) -> None:
        """Read the rules and the searches."""
        super().restore(folder)
        path = folder / "searches.json"
        self._outcomes = read_json(path) if path.exists() else []


class MaxSynthLearner(PopperLearner):
    """MaxSynth: Popper's noisy mode."""

    selection: ClassVar[tuple[str, ...]] = ("--noisy",)


def _better(first: Outcome, second: Outcome) -> Outcome:
    """Return the outcome with fewer errors, with what both searches say about the time and failures."""
    best = second if second.clauses and (not first.clauses or second.errors < first.errors) else first
    is_optimal = best.optimal and not second.failure and not second.timed_out
    timed_out, failure = first.timed_out or second.timed_out, first.failure or second.failure
    return replace(best, optimal=is_optimal, timed_out=timed_out, seconds=second.seconds, failure=failure)


def _no_rules(algorithm: str, outcomes: Sequence[Outcome], timeout: float) -> Exception:
    """Return the error of a learner that found no rule: failed, out of time, or without a program."""
    if all(outcome.failure for outcome in outcomes):
        return ChildProcessError(outcomes[0].failure)
    late = ", ".join(outcome.action for outcome in outcomes if outcome.timed_out)
    if late:
        within = f"within {timeout:g} seconds: raise `timeout`, or lower `max_vars`"
        return ValueError(f"time-out: {algorithm} found no rules for {late} {within}")
    names, remedy = ", ".join(outcome.action for outcome in outcomes), "raise `max_vars`, or set `negated: true`"
    return ValueError(f"{algorithm} says that no rules within its limits explain {names}: {remedy}")


def find_popper(program: Sequence[str] = ()) -> list[str]:
    """Return the words of the command that runs Popper.

    Raises:
        FileNotFoundError: If there is no such command.
    """
    names = program[:1] or ("popper-ilp", "popper")
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        listed = " or ".join(f"`{name}`" for name in names)
        remedy = "install it, or name its command under `settings.program`"
        raise FileNotFoundError(f"Popper is not installed: there is no command {listed}; {NEEDS}; {remedy}")
    return [found, *program[1:]]


def run_popper(command: Sequence[str], timeout: float, watch: Callable[[Running], None] = lambda running: None) -> str:
    """Run Popper, and return what it printed.

    Popper stops at its own time limit and prints its best rules. If it does not within `GRACE` seconds, it is killed
    with all its processes. Then the last hypothesis of its log counts. Only the last 16 MiB of its output count.
    `timeout` is the time limit in seconds; the other arguments are those of `run_program`.

    Raises:
        ChildProcessError: If it fails.
    """
    ended = run_program(command, timeout + GRACE, {"PYTHONUNBUFFERED": "1"}, watch)
    text = f"{ended.log}\n{ended.output}"
    if ended.code is None:
        return f"{text}\nTIMEOUT: killed"
    if ended.code != 0:
        reason = _last(ended.log or ended.output)
        raise ChildProcessError(f"Popper ended with exit code {ended.code}: {reason}; {_needs()}")
    return text


def _last(text: str) -> str:
    """Return the last line of a text that is not empty."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "it printed nothing"


def _needs() -> str:
    """Say which versions Popper needs, and which SWI-Prolog is installed."""
    swipl = shutil.which("swipl")
    if swipl is None:
        return f"{NEEDS}; there is no command `swipl`"
    ended = run_program([swipl, "--version"], 10.0)
    return f"{NEEDS}; found {_last(ended.output)}" if ended.code == 0 else NEEDS


def read_output(text: str, action: str, predicates: Mapping[str, int]) -> Printed:
    """Return the clauses in the output of Popper, in the syntax of rule files; none if it says that it found none.

    The solution is a block between lines of stars. Without one, the last `New best hypothesis` of the log counts.

    A literal `sees(A,B)` holds for the ego A and any B, so A becomes the ego and the literal vanishes: in rule files,
    variables range over what the ego sees.

    Args:
        text: The output and the log.
        action: The action, whose name in snake case is the predicate of the heads.
        predicates: The predicates of observations with their arities.

    Raises:
        ChildProcessError: If the output is not understood.
    """
    lines = text.splitlines()
    starts = [at + 1 for at, line in enumerate(lines) if re.search(r"\*{5,} SOLUTION \*{5,}", line)]
    if not starts:
        starts = [at + 1 for at, line in enumerate(lines) if line.rstrip().endswith("New best hypothesis:")]
    # Popper prints this word when it stops at its time limit, and `run_popper` adds it to the output of a killed one.
    timed_out = "TIMEOUT" in text
    if not starts:
        if timed_out or "NO SOLUTION" in text:
            return Printed((), timed_out)
        raise ChildProcessError(f"the output of Popper has no solution: {_last(text)}; {_needs()}")
    names = popper_names(predicates)
    head = next(iter(popper_names({action: 1})))
    clauses = []
    for line in takewhile(lambda line: not re.search(r"\*{20,}\s*$", line), lines[starts[-1] :]):
        match = _CLAUSE.search(line)
        if match is not None:
            clauses.append(_clause(match[0], head, action, names))
        elif ":-" in line:
            raise ChildProcessError(f"the output of Popper has a clause that is not understood: {line.strip()[:200]}")
    if not clauses:
        raise ChildProcessError(f"the solution of Popper has no clause: {_last(text)}; {_needs()}")
    return Printed(tuple(clauses), timed_out)


def _clause(printed: str, head: str, action: str, names: Mapping[str, tuple[bool, str, int]]) -> str:
    atoms = re.findall(r"(\w+)\((.*?)\)", printed)
    (name, (ego, *more)), *literals = [(name, re.findall(r"\w+", arguments)) for name, arguments in atoms]
    known = {**{key: arity for key, (_, _, arity) in names.items()}, "sees": 2}
    wrong = [name for name, arguments in literals if known.get(name) != len(arguments)]
    if name != head or more or wrong:
        raise ChildProcessError(f"Popper printed a clause that is not of this task: {printed.strip()[:200]}")
    numbers = dict.fromkeys([ego, *(arguments[0] for name, arguments in literals if name == "sees")], 0)
    body = []
    for name, arguments in literals:
        if name == "sees":
            continue
        for argument in arguments:
            numbers.setdefault(argument, 1 + max(numbers.values()))
        negated, predicate, _ = names[name]
        body.append((negated, predicate, tuple(numbers[argument] for argument in arguments)))
    return clause(action, body)
