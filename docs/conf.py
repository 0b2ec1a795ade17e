"""Configuration of Sphinx. `make docs` builds the site offline into target/docs.

The pages are Markdown (MyST). A line `<!-- generated: NAME -->` stands for text that `generated.py` makes from the
installed package when the site is built.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.util
import re
import shutil
import sys
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive, directives
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.domains import Domain, ObjType
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError

sys.path.insert(0, str(Path(__file__).parent))

import logicity
import notebooks
from dark import darkened
from generated import ADDED, GENERATORS, OPTIONAL, public_names
from lexer import RuleLexer

project = "LogiCity"
author = "the authors of LogiCity"
release = version = logicity.__version__
copyright = author  # noqa: A001

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
# A separate program with its README, and an article for a journal.
exclude_patterns = ["playground", "paper"]
templates_path: list[str] = []
nitpicky = True
# Texts contain options such as `--json`.
smartquotes = False

# Notebooks run when the site is built. A cell that fails is a warning, and so an error.
nb_execution_in_temp = True
nb_execution_mode = "force"
nb_execution_show_tb = True
nb_execution_timeout = 600
# These train a network. Without PyTorch, which is a large package, the pages have no output.
TRAINING = ["tutorials/pixels-to-proof*", "tutorials/rules-as-a-layer*"]
nb_execution_excludepatterns = [] if importlib.util.find_spec("torch") else TRAINING

myst_enable_extensions = ["attrs_block", "attrs_inline", "colon_fence", "deflist"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

# Docstrings write code in single backquotes.
default_role = "code"
autodoc_mock_imports = OPTIONAL
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_use_ivar = True
napoleon_numpy_docstring = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
add_module_names = False
# Types of other packages, whose documentation is elsewhere: the build reads no network. And types that annotations name
# and that the package does not export.
nitpick_ignore_regex = [
    (r"py:.*", r"(.*\.)?(AutoresetMode|MinariDataset|Tensor|nn\.Parameter)"),
    (
        r"py:.*",
        r"(.*\.)?(_AgentKey|_Env|Actions|ArrayKind|ArrowArray|ArrowStream|Annotated\[.*|Atom|Count|EnvOptions|Episode"
        r"|Episodes|Field|LearnedRules|ObservationKind|Observations|Path|PolicyNetwork|Predictor|Progress|Seed|ShieldMode|ShieldQuery|SerializeAsAny.*|TorchVapDataset|TrainingOptions|dict\[.*)",
    ),
    (r"py:.*", r"(collections|gymnasium|gym|np|numpy|os|pathlib|pydantic|stable_baselines3|torch|typing)\..*"),
]

html_theme = "furo"
html_title = f"LogiCity {release}"
html_favicon = "_static/logo.svg"
# The second folder is for files that the build makes.
MADE = Path(__file__).parents[1] / "target" / "docs-made"
MADE.mkdir(parents=True, exist_ok=True)
html_static_path = ["_static", str(MADE)]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_theme_options: dict[str, Any] = {
    "light_logo": "logo.svg",
    "dark_logo": "logo.svg",
    "top_of_page_buttons": [],
}
# Blocks without a language, and outputs, have no button.
copybutton_selector = "div:not(.highlight-text, .highlight-none) > div.highlight > pre"
pygments_style = "tango"
pygments_dark_style = "monokai"

#: A line that stands for generated text.
GENERATED = re.compile(r"^<!-- generated: ([\w-]+) -->$", re.MULTILINE)
#: The first line of a block with a file name, such as ```` ```dl my.dl ````.
NAMED_BLOCK = re.compile(r"^```(\w+) ([\w./-]+\.\w+)$", re.MULTILINE)
#: The first line of a block with words for the tests.
MARKED_BLOCK = re.compile(r"^```(\w+) (?:exit=\d+|cargo|illustration|scene|answer)$", re.MULTILINE)


def read_source(app: Sphinx, docname: str, source: list[str]) -> None:
    """Insert generated text, and show file names as captions."""
    text = notebooks.with_link(GENERATED.sub(lambda match: GENERATORS[match[1]](), source[0]), docname)
    text = NAMED_BLOCK.sub(r"```{code-block} \1\n:caption: \2\n", text)
    source[0] = MARKED_BLOCK.sub(r"```\1", text)


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.TextElement) -> nodes.Element | None:
    """Resolve the name of a public class or type that an annotation or a docstring writes without its module."""
    last = node["reftarget"].rpartition(".")[2]
    for name in (name for names in public_names().values() for name in names):
        if name.rpartition(".")[2] == last and name != node["reftarget"]:
            domain = env.domains.python_domain
            return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, content)
    return None


def make_files(app: Sphinx) -> None:
    """Make the files that pages show and that follow from others: the dark version of the first picture."""
    animation = (Path(app.srcdir) / "images" / "city.gif").read_bytes()
    (MADE / "city-dark.gif").write_bytes(darkened(animation))


def hide_colons(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Hide colons in the docstring of a property: napoleon would read the text before the first one as a type."""
    if what in ("attribute", "data", "property") and lines:
        lines[0] = lines[0].replace(":", "\x01")


def show_colons(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Show the hidden colons again."""
    lines[:] = [line.replace("\x01", ":") for line in lines]


class Names(Domain):
    """The names of predicates and messages, which the search of the site finds first."""

    name = "logicity"
    label = "LogiCity"
    object_types = {"predicate": ObjType("predicate"), "message": ObjType("message")}  # noqa: RUF012
    initial_data = {"objects": []}  # noqa: RUF012
    #: The kind of the names on a page. Each is the heading of a section.
    pages = {"reference/predicates": "predicate", "reference/errors": "message", "reference/warnings": "message"}  # noqa: RUF012

    def process_doc(self, env: BuildEnvironment, docname: str, document: nodes.document) -> None:
        """Collect the names of a page."""
        if docname not in self.pages:
            return
        for section in document.findall(nodes.section):
            title = section.next_node(nodes.title)
            if title is not None and [type(part) for part in title.children] == [nodes.literal]:
                self.data["objects"].append((title.astext(), self.pages[docname], docname, section["ids"][0]))

    def clear_doc(self, docname: str) -> None:
        """Forget the names of a page."""
        self.data["objects"] = [each for each in self.data["objects"] if each[2] != docname]

    def merge_domaindata(self, docnames: Set[str], otherdata: dict[str, Any]) -> None:
        """Add the names that another process has collected on pages."""
        self.data["objects"] += [each for each in otherdata["objects"] if each[2] in docnames]

    def resolve_any_xref(self, *arguments: Any) -> list[tuple[str, nodes.reference]]:
        """Resolve no link: pages link to the targets of the headings."""
        return []

    def get_objects(self) -> Iterator[tuple[str, str, str, str, str, int]]:
        """Yield each name with its kind and place, as important for the search."""
        for name, kind, docname, anchor in self.data["objects"]:
            yield name, name, kind, docname, anchor, 0


class Drawing(Directive):
    """Insert an SVG file into the page, where it has the colors of the theme."""

    required_arguments = 1
    option_spec = {"alt": directives.unchanged_required}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        """Return the text of the file, with the alternative text for readers who do not see it."""
        environment = self.state.document.settings.env
        name, path = environment.relfn2path(self.arguments[0])
        environment.note_dependency(name)
        label = self.options["alt"].replace('"', "&quot;")
        svg = Path(path).read_text(encoding="utf-8").replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
        return [nodes.raw("", f'<div class="drawing">{svg}</div>', format="html")]


#: An inline script: its attributes and its text.
INLINE = re.compile(r"<script(?![^>]*\bsrc=)([^>]*)>(.*?)</script>", re.DOTALL)
#: The element that a policy follows.
CHARSET = re.compile(r'<meta charset="utf-8" ?/?>')


def add_policies(app: Sphinx, error: Exception | None) -> None:
    """Add a Content-Security-Policy to every page: it may load only from the site, and run only its own scripts."""
    if error is not None or app.builder.name != "html":
        return
    site = Path(app.outdir)
    for page in sorted(site.rglob("*.html")):
        # What an earlier build has added is copied again.
        if page.relative_to(site).parts[0] in ADDED:
            continue
        text = page.read_text(encoding="utf-8")
        hashes = {
            f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
            for attributes, script in INLINE.findall(text)
            if "type=" not in attributes or "javascript" in attributes
        }
        policy = "; ".join(
            [
                "default-src 'self'",
                " ".join(["script-src 'self'", *sorted(hashes)]),
                "style-src 'self' 'unsafe-inline'",
                "img-src 'self' data:",
                "object-src 'none'",
                "base-uri 'none'",
                "form-action 'self'",
            ]
        )
        element = f'<meta http-equiv="Content-Security-Policy" content="{policy}" />'
        start = CHARSET.search(text)
        if start is None:
            raise ExtensionError(f"{page.name} has no place for its Content-Security-Policy")
        page.write_text(text[: start.end()] + element + text[start.end() :], encoding="utf-8")


def add_folders(app: Sphinx, error: Exception | None) -> None:
    """Copy what other targets of the Makefile have built: the playground, and the documentation of the crate."""
    if error is not None or app.builder.name != "html":
        return
    for name, folder in ADDED.items():
        shutil.rmtree(Path(app.outdir) / name, ignore_errors=True)
        if folder.is_dir():
            shutil.copytree(folder, Path(app.outdir) / name)


def add_notebooks(app: Sphinx, error: Exception | None) -> None:
    """Add the tutorials that are notebooks, as files."""
    if error is None and app.builder.name == "html":
        # MyST-NB writes what it has executed there.
        notebooks.write(Path(app.outdir).parent / "jupyter_execute", Path(app.outdir), app.env.found_docs)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the parts above."""
    app.add_lexer("dl", RuleLexer)
    app.add_domain(Names)
    app.add_directive("drawing", Drawing)
    app.connect("builder-inited", make_files)
    app.connect("source-read", read_source)
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-docstring", hide_colons, priority=400)
    app.connect("autodoc-process-docstring", show_colons, priority=600)
    app.connect("build-finished", add_policies)
    app.connect("build-finished", add_folders)
    app.connect("build-finished", add_notebooks)
    return {"parallel_read_safe": True}
