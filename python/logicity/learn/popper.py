"""Popper and MaxSynth: adapters to an installed Popper, a learner of logic programs.

Popper [1] searches for a program that derives all positive examples and no negative one. MaxSynth [2] is Popper's noisy
mode: it minimizes the description length of the program and of its errors. As in the LogiCity paper (appendix "Detailed
Baseline Configurations"), each action is a separate task, the time limit is 300 seconds, and other parameters have
their defaults. Popper has no negated literals, so each false observed atom is a fact of a predicate with `not_` before
its name (`Demonstrations.to_popper`).

[1] Cropper, Morel: Learning programs by learning from failures. Machine Learning 110, 2021.
[2] Hocquette, Niskanen, Jarvisalo, Cropper: Learning MDL logic programs from noisy data. AAAI 2024.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping, Sequence
from itertools import takewhile
from tempfile import TemporaryDirectory
from typing import Annotated, ClassVar, cast

from pydantic import Field

from ..offline import Demonstrations, popper_names
from .programs import run_program
from .settings import LearnerSettings, Positive
from .symbolic import SymbolicLearner, arities, clause

__all__ = ["MaxSynthLearner", "PopperLearner", "PopperSettings", "read_output", "run_popper"]

#: The names under which installations of Popper are commands.
COMMANDS = ("popper-ilp", "popper")

#: The versions that Popper needs.
NEEDS = "Popper 5 needs Python >= 3.14 and SWI-Prolog >= 9.2"

#: Seconds that Popper has to end after its time limit.
GRACE = 30.0

_ATOM = r"\w+\(\s*[A-Z]\w*(?:\s*,\s*[A-Z]\w*)*\s*\)"
#: A clause as Popper prints it, also behind the time of a line of its log.
_CLAUSE = re.compile(rf"(?P<head>{_ATOM})\s*:-\s*(?P<body>{_ATOM}(?:\s*,\s*{_ATOM})*)?\s*\.?\s*$")
_STARS = re.compile(r"\*{20,}\s*$")


class PopperSettings(LearnerSettings):
    """The settings of Popper and MaxSynth."""

    program: Annotated[list[str], Field(strict=False)] = []
    """The words of the command that runs Popper, such as `[python3.14, /opt/Popper/popper.py]`. By default the command
    `popper-ilp` or `popper`."""
    timeout: Positive = 300.0
    """The time limit of each action in seconds, that of the paper."""
    distinct: bool = True
    """Whether demonstrated steps with the same observation and action are one example."""
    arguments: list[str] = []
    """Further arguments of the command."""


class PopperLearner(SymbolicLearner):
    """Popper, run once for each action."""

    settings_class = PopperSettings
    #: The arguments that select the algorithm.
    selection: ClassVar[tuple[str, ...]] = ()

    def rules(self, data: Demonstrations) -> str:
        """Return the rules that Popper finds. An action for which it finds none has a comment instead.

        Raises:
            ChildProcessError: If Popper fails, or its output is not understood.
            FileNotFoundError: If Popper is not installed.
        """
        settings = cast(PopperSettings, self.config.settings)
        program = find_popper(settings.program)
        lines = ['.include "vocabulary.dl"']
        with TemporaryDirectory() as folder:
            tasks = data.to_popper(folder, distinct=settings.distinct)
            for action, task in zip(data.asked, tasks, strict=True):
                command = [*program, os.fspath(task), "--timeout", f"{settings.timeout:g}"]
                command += [*self.selection, *settings.arguments]
                found = run_popper(command, settings.timeout)
                clauses = read_output(found, action, arities(data.atoms))
                lines += ["", f"// {action}"]
                lines += clauses or [f"// {self.config.algorithm} found no rules within {settings.timeout:g} seconds."]
        return "\n".join(lines) + "\n"


class MaxSynthLearner(PopperLearner):
    """MaxSynth: Popper's noisy mode."""

    selection: ClassVar[tuple[str, ...]] = ("--noisy",)


def find_popper(program: Sequence[str] = ()) -> list[str]:
    """Return the words of the command that runs Popper.

    Raises:
        FileNotFoundError: If there is no such command.
    """
    names = program[:1] or COMMANDS
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        listed = " or ".join(f"`{name}`" for name in names)
        raise FileNotFoundError(
            f"Popper is not installed: there is no command {listed}; {NEEDS}; "
            "install it, or name its command under `settings.program`"
        )
    return [found, *program[1:]]


def run_popper(command: Sequence[str], timeout: float) -> str:
    """Run Popper, and return what it printed.

    Popper stops at its own time limit and prints its best rules. If it does not within `GRACE` seconds, it is killed
    with all its processes. Then the last hypothesis of its log counts. Only the last 16 MiB of its output count.

    Raises:
        ChildProcessError: If it fails.
    """
    ended = run_program(command, timeout + GRACE, {"PYTHONUNBUFFERED": "1"})
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


def read_output(text: str, action: str, predicates: Mapping[str, int]) -> list[str]:
    """Return the clauses in the output of Popper, in the syntax of rule files.

    The solution is a block between lines of stars. Without one, the last `New best hypothesis` of the log counts.

    A literal `sees(A,B)` holds for the ego A and any B, so A becomes the ego and the literal vanishes: in rule files,
    variables range over what the ego sees.

    Args:
        text: The output and the log.
        action: The action, whose name in snake case is the predicate of the heads.
        predicates: The predicates of observations with their arities.

    Returns:
        The clauses; none if Popper says that it found none, or that it ran out of time.

    Raises:
        ChildProcessError: If the output is not understood.
    """
    lines = text.splitlines()
    starts = [at + 1 for at, line in enumerate(lines) if re.search(r"\*{5,} SOLUTION \*{5,}", line)]
    if not starts:
        starts = [at + 1 for at, line in enumerate(lines) if line.rstrip().endswith("New best hypothesis:")]
    if not starts:
        if re.search(r"NO SOLUTION|TIMEOUT", text):
            return []
        raise ChildProcessError(f"the output of Popper has no solution: {_last(text)}; {_needs()}")
    names = popper_names(predicates)
    head = next(iter(popper_names({action: 1})))
    clauses = []
    for line in takewhile(lambda line: not _STARS.search(line), lines[starts[-1] :]):
        match = _CLAUSE.search(line)
        if match is not None:
            clauses.append(_clause(match, head, action, names))
        elif ":-" in line:
            raise ChildProcessError(f"the output of Popper has a clause that is not understood: {line.strip()[:200]}")
    if not clauses:
        raise ChildProcessError(f"the solution of Popper has no clause: {_last(text)}; {_needs()}")
    return clauses


def _clause(match: re.Match[str], head: str, action: str, names: Mapping[str, tuple[bool, str, int]]) -> str:
    """Return a clause in the syntax of rule files."""
    name, (ego, *more) = _atom(match["head"])
    literals = [_atom(text) for text in re.findall(_ATOM, match["body"] or "")]
    known = {**{key: arity for key, (_, _, arity) in names.items()}, "sees": 2}
    wrong = [name for name, arguments in literals if known.get(name) != len(arguments)]
    if name != head or more or wrong:
        raise ChildProcessError(f"Popper printed a clause that is not of this task: {match[0].strip()[:200]}")
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


def _atom(text: str) -> tuple[str, list[str]]:
    """Split an atom into its predicate and its arguments."""
    name, _, rest = text.strip().partition("(")
    return name, [argument.strip() for argument in rest.rstrip(") \t").split(",")]
