"""Tables as Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["escaped", "latex_table", "markdown_table"]


def markdown_table(lines: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown. The first line is the head."""
    rows = ["| " + " | ".join(cell.strip().replace("|", "\\|") for cell in line) + " |" for line in lines]
    return "\n".join([rows[0], "|" + "---|" * len(lines[0]), *rows[1:]]) + "\n"


def latex_table(lines: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table as LaTeX. The first line is the head."""
    head, *rows = [" & ".join(escaped(cell.strip()) for cell in line) + " \\\\" for line in lines]
    begin = f"\\begin{{tabular}}{{l{'c' * (len(lines[0]) - 1)}}}"
    return [begin, "\\toprule", head, "\\midrule", *rows, "\\bottomrule", "\\end{tabular}"]


def escaped(text: str) -> str:
    """Escape text for LaTeX."""
    return "".join(f"\\{each}" if each in "&%$#_{}" else _LATEX.get(each, each) for each in text)


#: The commands of LaTeX for characters that a backslash does not escape.
_LATEX = {"\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}"}
