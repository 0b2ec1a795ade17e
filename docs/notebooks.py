"""Makes notebooks of pages, with their output, that open without the site."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import nbformat

#: The first lines of a page that is a notebook.
HEAD = "---\nfile_format: mystnb\n"
#: A link to another page or to a heading, which leads nowhere without the site.
INNER = re.compile(r"\[([^\]]+)\]\((?!https?:)[^)]*\)")
#: The first heading of a page.
HEADING = re.compile(r"^# .*$", re.MULTILINE)
#: A folder of the site.
FOLDER = "notebooks"


def with_link(text: str, page: str) -> str:
    """Return the text of a tutorial with a link to its notebook below the heading, if it is one."""
    if not text.startswith(HEAD) or not page.startswith("tutorials/"):
        return text
    address = f"../{FOLDER}/{Path(page).name}.ipynb"
    link = f'```{{raw}} html\n<p><a class="button" href="{address}" download>Download the notebook</a></p>\n```'
    return HEADING.sub(lambda match: f"{match[0]}\n\n{link}", text, count=1)


def write(executed: Path, site: Path, pages: Iterable[str]) -> None:
    """Write the notebooks of the tutorials to a site, from those that the build has executed.

    Raises:
        nbformat.ValidationError: If one does not have the format of notebooks.
    """
    (site / FOLDER).mkdir(exist_ok=True)
    # An earlier build may have left others.
    for path in sorted(executed / f"{page}.ipynb" for page in pages if page.startswith("tutorials/")):
        if not path.is_file():
            continue
        notebook = portable(nbformat.reads(path.read_text(encoding="utf-8"), as_version=4))  # type: ignore[no-untyped-call]
        nbformat.validate(notebook)
        text = nbformat.writes(notebook)  # type: ignore[no-untyped-call]
        (site / FOLDER / path.name).write_text(f"{text}\n", encoding="utf-8", newline="\n")


def portable(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Return a notebook whose text has no links into the site, with a line about what it needs."""
    cells = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            lines = [line for line in cell.source.split("\n") if not line.startswith("<p><a class=")]
            text = "\n".join(lines).replace("```{raw} html\n```", "").strip()
            cell.source = re.sub(r"\n{3,}", "\n\n", INNER.sub(r"*\1*", text))
        cells.append(cell)
    needed = "This notebook needs the Python package `logicity`; its page *Install* says how to get it."
    cells.insert(1, nbformat.v4.new_markdown_cell(needed, id="needed"))  # type: ignore[no-untyped-call]
    notebook.cells = [cell for cell in cells if cell.source]
    return notebook
