"""The report of an experiment of language questions: accuracy, calibration and named rules, beside the paper's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...city import ACTIONS
from ...questions import Grade, grade, load_answers, load_logprobs
from ...redaction import masked
from ...terminal import first_line
from ..report import aligned, draw_panels, latex_table, markdown_table, paper_table, write_tables

if TYPE_CHECKING:
    from .experiment import LanguageExperiment, Work

__all__ = ["Entry", "LanguageReport"]

#: The headings of the tables.
TITLES: dict[str, str] = {
    "examples": "Only solved examples show the rules",
    "rules": "The instructions state the rules in words",
    "why": "The instructions state the rules and request the rule that requires the action",
}


@dataclass(frozen=True)
class Entry:
    """A row of a table.

    Attributes:
        row: The name of the solver or model.
        prompt: The prompt.
        seeds: The seeds of the sets of questions.
        grade: The measures over all sets; `None` if replies are missing.
        missing: Why there are no measures; empty if there are.
    """

    row: str
    prompt: str
    seeds: tuple[int, ...]
    grade: Grade | None
    missing: str


class LanguageReport:
    """The results of an experiment of language questions.

    Args:
        experiment: The experiment.
        work: The units, finished or not.
        failed: The messages of the models that failed, by row.
    """

    def __init__(
        self, experiment: LanguageExperiment, work: Sequence[Work], failed: Mapping[str, str] | None = None
    ) -> None:
        """Grade the replies. A row has measures if the replies to all its questions are stored."""
        self.experiment = experiment
        groups: dict[tuple[str, str], list[Work]] = {}
        for each in work:
            groups.setdefault((each.unit.prompt, each.unit.row), []).append(each)
        self.entries = [self._entry(group, failed or {}) for group in groups.values()]

    @staticmethod
    def _entry(group: Sequence[Work], failed: Mapping[str, str]) -> Entry:
        unit, seeds = group[0].unit, tuple(each.unit.seed for each in group)
        stored, total = sum(each.stored() for each in group), sum(len(each.questions) for each in group)
        if stored < total:
            reason = first_line(failed[unit.row]) + "; " if unit.row in failed else ""
            return Entry(unit.row, unit.prompt, seeds, None, f"{reason}{stored} of {total} replies are stored")
        answers: dict[str, str] = {}
        logprobs: dict[str, dict[str, float]] = {}
        for each in group:
            answers |= load_answers(each.path)
            logprobs |= load_logprobs(each.path)
        questions = [question for each in group for question in each.questions]
        return Entry(unit.row, unit.prompt, seeds, grade(questions, answers, logprobs), "")

    @property
    def prompts(self) -> list[str]:
        """The prompts with an entry."""
        return list(dict.fromkeys(entry.prompt for entry in self.entries))

    def _paper(self, prompt: str) -> dict[str, list[float]]:
        """Return the rows of the paper. Its prompts have only solved examples."""
        rows: dict[str, list[float]] = paper_table(self.experiment.paper).get("rows", {})
        return rows if prompt == "examples" else {}

    def table(self, prompt: str) -> list[list[str]]:
        """Return the table of a prompt as text: a head, the rows of the experiment, and those of the paper."""
        entries = [entry for entry in self.entries if entry.prompt == prompt]
        grades = [entry.grade for entry in entries if entry.grade is not None]
        is_why = any(each.rules is not None for each in grades)
        is_calibrated = any(each.calibration is not None for each in grades)
        head = ["solver", *ACTIONS, "overall"]
        head += ["rule", "action and rule"] if is_why else []
        head += ["ECE", "Brier"] if is_calibrated else []
        lines = [[*head, "unread", "questions"]]
        for entry in entries:
            lines.append([entry.row, *_cells(entry.grade, is_why, is_calibrated)])
        for row, values in self._paper(prompt).items():
            shares = [f"{value / 100:.2f}" for value in values]
            lines.append([f"{row} (paper)", *shares, *[""] * (len(lines[0]) - 1 - len(shares))])
        return lines

    def text(self) -> str:
        """Return everything for a terminal."""
        parts = [self.experiment.title]
        for prompt in self.prompts:
            parts += [f"\n{TITLES[prompt]}", aligned(self.table(prompt))]
        return "\n".join([*parts, "", *self.notes()])

    def notes(self) -> list[str]:
        """Return sentences on the measures, missing rows and the paper."""
        sets = max((len(entry.seeds) for entry in self.entries), default=1)
        notes = [
            "Accuracy by correct action, with 95 % Wilson intervals over questions. Unread replies count as wrong."
            + (
                f" The questions of {sets} sets are pooled; sets have other solved examples, and the intervals do not "
                "account for differences between sets."
                if sets > 1
                else ""
            )
        ]
        if "why" in self.prompts:
            notes.append(
                "rule: the reply names a clause that derives the action, or `none` if the action is the default. "
                "A solver that names none has no figure."
            )
        if any(entry.grade is not None and entry.grade.calibration for entry in self.entries):
            notes.append(
                "ECE: expected calibration error in ten bins. Brier: mean squared distance of the probabilities of the "
                "options from the correct one, 0.75 for uniform ones. Both from log-probabilities."
            )
        table = paper_table(self.experiment.paper)
        if table and "examples" in self.prompts:
            notes.append(f"The paper's figures: {table['source']}. {table['note']}")
        notes += [f"{entry.row}, {entry.prompt}: {entry.missing}." for entry in self.entries if entry.missing]
        return notes

    def markdown(self) -> str:
        """Return the report as Markdown."""
        parts = [f"# {self.experiment.title}\n"]
        for prompt in self.prompts:
            parts += [f"## {TITLES[prompt]}\n", markdown_table(self.table(prompt))]
        parts += ["## Notes\n", *(f"- {note}" for note in self.notes())]
        return "\n".join(parts) + "\n"

    def latex(self) -> str:
        """Return one table per prompt as LaTeX, with the rules of the package booktabs."""
        tables = []
        for prompt in self.prompts:
            lines = [f"% {self.experiment.title}: {TITLES[prompt]}", *latex_table(self.table(prompt))]
            tables.append("\n".join(lines) + "\n")
        return "\n".join(tables)

    def to_dict(self) -> dict[str, Any]:
        """Return the entries for JSON."""
        values = self.experiment.model_dump(mode="json", exclude={"models"})
        models = {
            name: masked(spec.model_dump(mode="json", include={"model", "settings", "logprobs"}))
            for name, spec in self.experiment.models.items()
        }
        return {
            "title": self.experiment.title,
            "experiment": {**values, "models": models},
            "entries": [
                {
                    "row": entry.row,
                    "prompt": entry.prompt,
                    "seeds": list(entry.seeds),
                    "grade": None if entry.grade is None else entry.grade.to_dict(),
                    "missing": entry.missing,
                }
                for entry in self.entries
            ],
            "paper": paper_table(self.experiment.paper),
            "notes": self.notes(),
        }

    def write(self, root: Path) -> list[Path]:
        """Write the tables, and the figure if matplotlib is installed.

        Raises:
            OSError: If a file cannot be written.
        """
        written = write_tables(root, self.markdown(), self.latex(), self.to_dict())
        if any(entry.grade is not None for entry in self.entries):
            written += self._figure(root)
        return written

    def _figure(self, root: Path) -> list[Path]:
        """Draw the accuracy of each row by prompt, and the paper's."""
        if find_spec("matplotlib") is None:
            return []
        tallest = max(len(list(self._bars(prompt))) for prompt in self.prompts)
        titles = {prompt: f"prompt: {prompt}" for prompt in self.prompts}

        def draw(axes: Any, prompt: str) -> None:
            bars = list(self._bars(prompt))
            for place, (_, value, low, high, color) in enumerate(bars):
                reach = None if low is None or high is None else [[value - low], [high - value]]
                axes.barh(place, value, xerr=reach, color=color, error_kw={"linewidth": 1})
            axes.axvline(0.25, color="#888888", linewidth=1, linestyle=":")
            axes.set_yticks(range(len(bars)), [name for name, *_ in bars], fontsize=8)
            axes.set_ylim(tallest - 0.5, -0.5)
            axes.set_xlim(0, 1.02)
            axes.set_xlabel("accuracy (dotted: chance)")

        return draw_panels(root, "accuracy", titles, draw, columns=len(titles), size=(4.6, 1.2 + 0.32 * tallest))

    def _bars(self, prompt: str) -> Iterator[tuple[str, float, float | None, float | None, str]]:
        """Yield the name, the accuracy, its interval if any, and the color of each bar."""
        for entry in self.entries:
            if entry.prompt == prompt and entry.grade is not None:
                accuracy = entry.grade.overall.accuracy
                yield entry.row, accuracy.value, accuracy.low, accuracy.high, "#4878a8"
        for row, values in self._paper(prompt).items():
            yield f"{row} (paper)", values[-1] / 100, None, None, "#c44e52"


def _cells(measured: Grade | None, is_why: bool, is_calibrated: bool) -> list[str]:
    """Return the cells of a row after its name."""
    if measured is None:
        return ["-"] * (len(ACTIONS) + 3 + 2 * is_why + 2 * is_calibrated)
    by_action = [measured.by_action.get(action) for action in ACTIONS]
    cells = ["-" if recall is None else str(recall.accuracy) for recall in by_action]
    cells.append(str(measured.overall.accuracy))
    if is_why:
        named = [None if measured.named == 0 else each for each in (measured.rules, measured.both)]
        cells += ["-" if each is None else str(each.accuracy) for each in named]
    if is_calibrated:
        calibration = measured.calibration
        cells += ["-", "-"] if calibration is None else [f"{calibration.ece:.3f}", f"{calibration.brier:.3f}"]
    return [*cells, str(len(measured.unread)), str(measured.overall.total)]
