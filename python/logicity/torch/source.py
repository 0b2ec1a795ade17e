"""Rules with learned probabilities as the source of one file."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Mapping, Sequence

import numpy as np

from ..rules import Program
from .clauses import Clause, Clauses
from .layer import RuleLayer

__all__ = ["DIGITS", "labels_of", "written_as_one"]

#: A line that includes a file.
INCLUDE = re.compile(r'^[ \t]*\.include[ \t]+"([^"]*)"[ \t\r]*(?://.*)?$', re.MULTILINE)

#: The folder of built-in files in the names of sources.
BUILTIN = "<builtin>"

#: The built-in declarations, with the clause of the default. They need not be copied.
VOCABULARY = ("rules/vocabulary.dl", f"{BUILTIN}/vocabulary.dl")

#: The digits of a written probability after the point.
DIGITS = 4


def labels_of(written: Sequence[Clause], numbers: Sequence[int]) -> dict[int, str]:
    """Return the labels of clauses by their numbers, with the location of each whose label others have, too.

    Raises:
        ValueError: If a file cannot have a probability for each of them.
    """
    locations = [clause.location for clause in written]
    clauses = [written[number] for number in numbers]
    for clause in clauses:
        if locations.count(clause.location) > 1:
            raise ValueError(
                f"{clause.location}: the clause has several heads or alternatives: write a clause for each"
            )
        if clause.unnamed:
            raise ValueError(
                f"{clause.location}: name all variables of the clause, without `_` before the name: a probability is "
                "drawn for each combination of their values"
            )
    labels = [clause.label for clause in clauses]
    return {
        clause.number: clause.label if labels.count(clause.label) == 1 else f"{clause.label} ({clause.location})"
        for clause in clauses
    }


def written_as_one(layer: RuleLayer, learned: Mapping[int, float]) -> str:
    """Return the rules of a layer as one file, with probabilities by the number of the clause."""
    files = {name: text.removeprefix("\ufeff") for name, text in layer.program._program.files()}
    inserted: dict[str, list[tuple[int, int, str]]] = {}
    for clause in layer._rules.written:
        if clause.number in learned and learned[clause.number] < 1:
            name, line, column = clause.location.rsplit(":", 2)
            inserted.setdefault(name, []).append((int(line), int(column), f"{learned[clause.number]:.{DIGITS}f} :: "))
    written: set[str] = set()

    def expanded(name: str) -> str:
        """Return the text of a file in which included files replace their names."""
        written.add(name)
        lines = files[name].split("\n")
        for line, column, text in sorted(inserted.get(name, []), reverse=True):
            before = lines[line - 1]
            lines[line - 1] = before[: column - 1] + text + before[column - 1 :]

        def included(match: re.Match[str]) -> str:
            beside = posixpath.normpath(posixpath.join(posixpath.dirname(name), match[1]))
            # As the engine, also among the built-in files.
            wanted = (beside, posixpath.normpath(posixpath.join(BUILTIN, match[1])))
            found = next((each for want in wanted for each in files if posixpath.normpath(each) == want), None)
            if found is None:
                return match[0]
            if found in VOCABULARY and found not in inserted:
                return '.include "vocabulary.dl"'
            return "" if found in written else expanded(found)

        return INCLUDE.sub(included, "\n".join(lines))

    text = expanded(layer.program._program.files()[0][0])
    # A file may write its includes in other ways than the pattern knows.
    try:
        clauses = Clauses(Program(text), (), layer.actions, layer.default, layer.depth, by_engine=True).written
    except ValueError as error:
        raise ValueError(f"rules: they cannot be written as one file: {error}") from None
    found = sorted(clause.probability for clause in clauses)
    wanted = sorted(learned.get(clause.number, clause.probability) for clause in layer._rules.written)
    if len(found) != len(wanted) or not np.allclose(found, wanted, rtol=0, atol=1e-6):
        raise ValueError("rules: they cannot be written as one file: write each `.include` on a line of its own")
    return text
