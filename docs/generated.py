"""The generated parts of the reference, as Markdown.

Each generator asks the installed package: `logicity reference` for the commands, `logicity codes` for the messages,
`logicity schema` for the configuration files, and `logicity.describe` for the environments. Pages of the project are
files of the repository.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import chart
import history
import logicity
import suite
from logicity.commands import SUMMARIES, parser_of
from logicity.describe import describe, environment_page, parallel_page
from logicity.modes import ENVIRONMENTS
from sphinx.ext.autodoc.mock import mock  # type: ignore[attr-defined]

ROOT = Path(__file__).parents[1]
#: The folders that other targets of the Makefile build, by the folder of the site that gets a copy.
ADDED = {
    name: ROOT / "target" / folder
    for name, folder in [("playground", "playground"), ("rust", "doc"), ("versions", "versions")]
}
#: The files of the repository that have a page in `project`.
REPOSITORY_FILES = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md")
#: A link in Markdown.
LINK = re.compile(r"\[([^\]\n]*)\]\(([^)\s]+)\)")
#: The names of files in examples begin with this comment.
FILE = re.compile(r"^(?://|#) file: (\S+)$")


def run(*arguments: str, folder: str | None = None) -> str:
    """Return the standard output of a `logicity` command."""
    command = [sys.executable, "-m", "logicity", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=True, cwd=folder).stdout


# --- commands


def commands() -> str:
    """Return a section for each command, with an entry for each option."""
    root = json.loads(run("reference"))
    return "\n".join(part for command in root["commands"] for part in command_sections(command, ("logicity",)))


def command_sections(command: dict[str, Any], parents: tuple[str, ...]) -> Iterator[str]:
    """Yield the section of a command and those of its subcommands."""
    path = (*parents, command["name"])
    name = " ".join(path)
    yield f"\n{'#' * len(path)} {name}\n"
    yield f"{sentence(command['about'])}\n"
    if path[1:] in SUMMARIES:
        yield from python_command(path[1:], name)
        return
    if not command["commands"]:
        yield f"```text\n{command['usage'].removeprefix('Usage: ')}\n```\n"
    yield f"```{{program}} {name}\n```\n"
    for argument in command["arguments"]:
        values = " ".join(f"<{value}>" for value in argument["values"])
        if argument["positional"]:
            forms = [values]
        else:
            flags = [f"-{argument['short']}"] if argument["short"] else []
            flags += [f"--{argument['long']}"] if argument["long"] else []
            forms = [f"{flag} {values}".strip() for flag in flags]
        text = argument["help"] or ""
        text, stated = re.subn(r" ?\[default: (.*)\]$", r". Default: \1", text, flags=re.DOTALL)
        parts = [sentence(text)]
        if argument["possible"]:
            parts.append(f"One of {', '.join(f'`{value}`' for value in argument['possible'])}.")
        if argument["default"] and not stated:
            parts.append(f"Default: `{' '.join(argument['default'])}`.")
        if argument["required"]:
            parts.append("Required.")
        yield option(", ".join(forms), parts)
    for inner in command["commands"]:
        yield from command_sections(inner, path)


def python_command(words: tuple[str, ...], name: str) -> Iterator[str]:
    """Yield the parts of the section of a command that Python implements."""
    parser, _ = parser_of(words)
    usage = " ".join(parser.format_usage().removeprefix("usage: ").replace("[-h] ", "").replace("[-h]", "").split())
    yield f"Needs the Python package.\n\n```text\n{usage}\n```\n"
    yield f"```{{program}} {name}\n```\n"
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        values = "" if action.nargs == 0 else f"<{action.metavar or action.dest.upper()}>"
        forms = [f"{flag} {values}".strip() for flag in action.option_strings] or [values]
        text, stated = re.subn(r"[;,]? ?default: (.*)$", r". Default: \1", action.help or "")
        parts = [sentence(text.removeprefix(". "))]
        if action.choices:
            parts.append(f"One of {', '.join(f'`{value}`' for value in action.choices)}.")
        if action.required and action.option_strings:
            parts.append("Required.")
        if action.default not in (None, False, argparse.SUPPRESS) and not stated and "default" not in text:
            parts.append(f"Default: `{action.default}`.")
        yield option(", ".join(forms), parts)


def option(forms: str, parts: list[str]) -> str:
    """Return the entry of an option."""
    return f"```{{option}} {forms}\n{' '.join(part for part in parts if part)}\n```\n"


def sentence(text: str) -> str:
    """Return a text with a full stop, and with placeholders and patterns as Markdown shows them."""
    text = re.sub(r"\s+", " ", text).strip()
    # Outside of code, Markdown would read these characters as markup.
    parts = text.split("`")
    parts[::2] = [re.sub(r"([<>*_\[\]{}$])", r"\\\1", part) for part in parts[::2]]
    text = "`".join(parts)
    return f"{text}." if text and text[-1] not in ".:!?" else text


# --- messages


def explanations() -> list[dict[str, Any]]:
    """Return the explanations of all codes."""
    return [json.loads(line) for line in run("codes", "--json").splitlines()]


def messages(severity: str) -> str:
    """Return a section for each code of a severity: what it means, why it matters, and an example with its message."""
    parts: list[str] = []
    topic = ""
    for code in explanations():
        if code["severity"] != severity:
            continue
        if code["topic"] != topic:
            topic = code["topic"]
            parts.append(f"\n## {topic[0].upper()}{topic[1:]}\n")
        # A target with the name of the code, for links from other pages.
        parts.append(f"(code-{code['code']})=\n### `{code['code']}`\n")
        parts.append(f"{code['meaning']}\n\n{code['reason']}\n")
        parts.append(f"Wrong:\n\n{example_blocks(code['wrong'])}")
        said = said_about(code["wrong"], code["command"])
        if said:
            parts.append(f"The message:\n\n````text\n{said}\n````\n")
        parts.append(f"Right:\n\n{example_blocks(code['right'])}")
        if code["command"] and code["command"].startswith("logicity"):
            parts.append(f"Reported by `{code['command']}`.\n")
    return "\n".join(parts)


#: A heading of the vocabulary, a comment of documentation, a declaration with its name and its arguments.
VOCABULARY = re.compile(r"^(?:// --- (?P<title>.*)|/// (?P<about>.*)|\.decl (?P<name>\w+)(?P<arguments>\(.*\)))$")
#: The definition of a predicate in the standard configuration, on its line or on the next one.
DEFINITION = re.compile(r"^  (\w+):\s+(\S.*)$", re.MULTILINE)


def predicates() -> str:
    """Return a section for each predicate of the vocabulary: what it says, and its standard definition."""
    standard = (ROOT / "configs" / "predicates" / "standard.yaml").read_text(encoding="utf-8")
    definitions = dict(DEFINITION.findall(standard))
    parts: list[str] = []
    about: list[str] = []
    title = ""
    for line in (ROOT / "rules" / "vocabulary.dl").read_text(encoding="utf-8").splitlines():
        match = VOCABULARY.match(line)
        if match is None:
            about = []
        elif match["title"]:
            title = match["title"].partition(" (")[0]
        elif match["about"]:
            about.append(match["about"])
        else:
            if title:
                parts.append(f"\n## {title[0].upper()}{title[1:]}\n")
                title = ""
            name = match["name"]
            parts.append(f"(predicate-{name})=\n### `{name}`\n")
            parts.append(f"`{name}{match['arguments']}`: {' '.join(about)}\n")
            if name in definitions:
                parts.append(f"Definition: `{definitions[name]}`.\n")
            about = []
    return "\n".join(parts)


def files_of(example: dict[str, str]) -> dict[str, str]:
    """Return the files of an example by name."""
    extension = {"json": "jsonl"}.get(example["language"], example["language"])
    name = f"main.{extension}"
    files: dict[str, list[str]] = {}
    for line in example["text"].splitlines():
        if match := FILE.match(line):
            name = match[1]
        else:
            files.setdefault(name, []).append(line)
    return {name: "\n".join(lines) + "\n" for name, lines in files.items()}


def example_blocks(example: dict[str, str]) -> str:
    """Return a block for each file of an example."""
    files = files_of(example)
    blocks = []
    for name, text in files.items():
        extension = name.rpartition(".")[2]
        language = {"jsonl": "json", "facts": "text", "pl": "prolog", "rs": "rust"}.get(extension, extension)
        caption = f":caption: {name}\n\n" if len(files) > 1 else ""
        blocks.append(f"```{{code-block}} {language}\n{caption}{text}```\n")
    return "\n".join(blocks)


def said_about(example: dict[str, str], command: str | None) -> str:
    """Run the command of an example in a folder with its files, and return the diagnostics."""
    if example["language"] == "rust":
        return ""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files_of(example).items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = command or f"logicity check {next(iter(files_of(example)))}"
        search = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        environment = {**os.environ, "PATH": search}
        done = subprocess.run(
            ["sh", "-c", command], cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False
        )
    return (done.stderr or done.stdout).strip()


# --- configuration files


def configuration() -> str:
    """Return a section for each mapping of a configuration."""
    schema = json.loads(run("schema"))
    parts = []
    for name in ("run", "map", "agents", "predicates", "task"):
        definition = schema["$defs"][name]
        parts.append(f"\n(schema-{name})=\n## {definition['title']}\n\n{definition['description']}\n")
        parts += mapping(schema, definition, "")
    return "\n".join(parts)


def mapping(schema: dict[str, Any], definition: dict[str, Any], path: str) -> Iterator[str]:
    """Yield the keys of a mapping, and the sections of the mappings inside it."""
    entries = []
    inner: list[tuple[str, dict[str, Any]]] = []
    for key, value in definition.get("properties", {}).items():
        required = key in definition.get("required", [])
        values = f"*{values_of(schema, value)}*"
        if required:
            values += ", required"
        elif value.get("default") is not None:
            values += f", default {code(value['default'])}"
        entries.append(f"`{key}`\n: {values}. {value['description']}\n")
        for suffix, found in mappings_of(schema, value):
            # The splits have the same keys.
            name = "SPLIT" if found.get("from") == "split" else key
            if (f"{path}{name}{suffix}", found) not in inner:
                inner.append((f"{path}{name}{suffix}", found))
    yield "\n".join(entries)
    for name, found in inner:
        yield f"\n### `{name}`\n\n{found['description']}\n"
        yield from mapping(schema, found, f"{name}.")


def alternatives(schema: dict[str, Any], value: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the alternatives of a value, without references to parts that have a section of their own."""
    if "$ref" in value:
        value = {**schema["$defs"][value["$ref"].rpartition("/")[2]], "from": value["$ref"].rpartition("/")[2]}
    if "anyOf" in value:
        for one in value["anyOf"]:
            yield from alternatives(schema, one)
    else:
        yield value


PARTS = ("map", "agents", "predicates", "task")


def mappings_of(schema: dict[str, Any], value: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the mappings that a value can be or contain, with what to append to its name."""
    for one in alternatives(schema, value):
        if one.get("from") in PARTS:
            continue
        if one.get("properties"):
            # One table suffices for the three splits.
            if set(one["properties"]) != {"train", "val", "test"} or "base" in one["properties"]:
                yield "", one
        elif isinstance(one.get("additionalProperties"), dict):
            yield from ((f".NAME{suffix}", found) for suffix, found in mappings_of(schema, one["additionalProperties"]))
        elif "items" in one:
            yield from ((f"[]{suffix}", found) for suffix, found in mappings_of(schema, one["items"]))


def values_of(schema: dict[str, Any], value: dict[str, Any]) -> str:
    """Describe the values of a key in a few words."""
    found: list[str] = []
    for one in alternatives(schema, value):
        text = value_of(schema, one)
        if text and text not in found:
            found.append(text)
    return " or ".join(found)


def value_of(schema: dict[str, Any], value: dict[str, Any]) -> str:
    """Describe one alternative of the values of a key."""
    if "enum" in value:
        return " or ".join(f"`{word}`" for word in value["enum"] if word is not None)
    kinds = value.get("type", [])
    kind = next((kind for kind in ([kinds] if isinstance(kinds, str) else kinds) if kind != "null"), "")
    if kind in ("integer", "number"):
        return f"{kind} {number(value['minimum'])} to {number(value['maximum'])}"
    if kind == "array":
        count = f"{value['minItems']} x " if "minItems" in value else ""
        return f"list of {count}{values_of(schema, value['items'])}"
    if kind == "object":
        if value.get("from") in PARTS:
            return f"[{value['title'].lower()}](#schema-{value['from']})"
        if set(value.get("properties", {})) == {"train", "val", "test"} and "base" not in value["properties"]:
            return "one per split: `train`, `val`, `test`"
        return "mapping"
    return {"string": "text", "boolean": "`true` or `false`"}.get(kind, "")


def number(value: float) -> str:
    """Format a bound."""
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


def code(value: Any) -> str:
    """Format a default."""
    text = json.dumps(value) if not isinstance(value, str) else value
    return f"`{text.replace(chr(34), '')}`"


# --- training files


def training() -> str:
    """Return the keys of training files, and a section with the settings of each algorithm."""
    schema = json.loads(run("schema", "training"))
    parts = [f"## Keys\n\n{keys_of(schema)}"]
    for definition in schema["$defs"].values():
        described = any("description" in value for value in definition["properties"].values())
        columns = ["setting", "values", "default", *["meaning"] * described]
        parts.append(f"## {definition['title']}\n\n| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
        for key, value in definition["properties"].items():
            default = code(value["default"]) if "default" in value else "required"
            cells = [f"`{key}`", kinds(value), default, *[value.get("description", "")] * described]
            parts[-1] += f"\n| {' | '.join(cells)} |"
        parts[-1] += "\n"
    return "\n".join(parts)


def keys_of(schema: dict[str, Any]) -> str:
    """Return an entry for each key of a mapping, in the schema of training files or experiment files."""
    entries = []
    for key, value in schema["properties"].items():
        required = ", required" if key in schema.get("required", []) else ""
        # The section of a mapping shows the defaults of its keys.
        default = value.get("default")
        stated = "" if default is None or isinstance(default, dict) else f", default {code(default)}"
        entries.append(f"`{key}`\n: *{kinds(value)}*{required}{stated}. {value['description']}\n")
    return "\n".join(entries)


def experiment_files(task: str) -> str:
    """Return the keys of experiment files of a task, with a section for each mapping inside them."""
    schema = json.loads(run("schema", "experiment"))
    parts = [keys_of(schema["$defs"][task])]
    for key, value in schema["$defs"][task]["properties"].items():
        for one in value.get("anyOf", [value]):
            inner = one.get("additionalProperties")
            if isinstance(inner, dict):
                parts.append(f"### `{key}.NAME`\n\n{inner['description']}\n\n{keys_of(inner)}")
            elif "properties" in one:
                parts.append(f"### `{key}`\n\n{value['description']}\n\n{keys_of(one)}")
    return "\n".join(parts)


def kinds(value: dict[str, Any]) -> str:
    """Describe the values that a part of the schema of training files or experiment files accepts."""
    if "$ref" in value:
        # Only mappings are references.
        return "mapping"
    if "anyOf" in value:
        return " or ".join(dict.fromkeys(kinds(one) for one in value["anyOf"]))
    if "enum" in value:
        return " or ".join(f"`{word}`" for word in value["enum"])
    if "const" in value:
        return f"`{value['const']}`"
    if value["type"] in ("integer", "number"):
        words = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
        bounds = "".join(f" {word} {value[key]:,}" for key, word in words.items() if key in value)
        return f"{value['type']}{bounds}"
    if value["type"] == "array":
        items = value.get("prefixItems") or [value["items"]]
        return "list of " + ", ".join(kinds(item) for item in items)
    words = {"string": "text", "boolean": "`true` or `false`", "object": "mapping", "null": "`~`"}
    return words[value["type"]]


#: The definitions of the schema of experiment files: three tasks, and the settings of two of them.
EXPERIMENT_PARTS = ("spf", "vap", "vap-settings", "language", "language-settings")


# --- results


#: The files of `results`.
RESULTS = (
    "spf",
    "transfer",
    "composition",
    "town",
    "observations",
    "noise",
    "communication",
    "egos",
    "vap",
    "vap-50",
    "vap-backbone",
    "vap-continual",
    "vap-steps",
    "vap-concepts",
    "language",
)


def results(name: str) -> str:
    """Return the tables of a file of results."""
    module = imported("logicity.experiments.results")
    draw = functools.partial(chart.draw, axis=chart.AXES.get(name))
    with mock(OPTIONAL):
        text: str = module.leaderboard(module.read_results(ROOT / "results" / f"{name}.json", name), 3, draw=draw)
    return TABLE.sub(folded, text)


def chart_of(name: str) -> str:
    """Return the chart of a file of results."""
    return results(name).partition("### ")[0]


#: A table in Markdown, and the number of rows up to which it is open.
TABLE = re.compile(r"(?:^\|.*\n)+", re.MULTILINE)
ROWS_OPEN = 40


def folded(match: re.Match[str]) -> str:
    """Return a table of results; a long one is closed until the reader opens it."""
    rows = match[0].count("\n") - 2
    element = "div" if rows <= ROWS_OPEN else "details"
    summary = f"<summary>{rows} rows</summary>" if element == "details" else ""
    tags = (f'<{element} class="results">{summary}', f"</{element}>")
    opening, closing = (f"```{{raw}} html\n{tag}\n```\n" for tag in tags)
    return f"{opening}\n{match[0]}\n{closing}"


# --- environments


def environments() -> str:
    """Return a table of the modes, and the tables of environments, rewards and observations."""
    rows = ["| id | mode | its rules |", "|---|---|---|"]
    for mode, name in ENVIRONMENTS.items():
        # The first line describes the mode, as in `# Safe Path Following, easy mode: give way at intersections.`
        comment = (ROOT / "configs" / f"{mode}.yaml").read_text(encoding="utf-8").partition("\n")[0]
        about = sentence(comment.partition(": ")[2])
        rows.append(f"| [`{name}`](environments/{mode}.md) | {mode} | {about[0].upper()}{about[1:]} |")
    tables = describe().replace("### ", "## ")
    # Short lists of numbers stay on one line.
    tables = re.sub(r"\(?\d+(?: /|,) \d+(?: / \d+)?\)?", lambda match: match[0].replace(" ", "\u00a0"), tables)
    return "## Modes\n\n" + "\n".join(rows) + f"\n\n{tables}"


def parallel() -> str:
    """Return the page of the environment in which several cars are controlled."""
    imported("logicity.envs.parallel")
    return parallel_page()


# --- files of the repository, and what other builds add to the site


def repository_file(name: str) -> str:
    """Return a Markdown file of the repository, with links that work on the site."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return LINK.sub(lambda match: f"[{match[1]}]({link})" if (link := site_link(match[2])) else match[1], text)


def site_link(target: str) -> str | None:
    """Return the address of a link of a file of the repository, for a page in `project`; `None` if it has no page."""
    if target.startswith(("http:", "https:", "#")):
        return target
    if target.startswith("docs/"):
        return f"../{target.removeprefix('docs/')}"
    return f"{Path(target).stem.lower()}.md" if target in REPOSITORY_FILES else None


def playground() -> str:
    """Return a link to the playground, or the commands that build it."""
    if ADDED["playground"].is_dir():
        return '```{raw} html\n<p><a class="button" href="../playground/index.html">Open the playground</a></p>\n```\n'
    return (
        "This copy of the site was built without the playground. In a copy of the repository, these commands build it, "
        "and the site with a link to it:\n\n"
        "```sh\nrustup target add wasm32-unknown-unknown\nmake playground docs\n"
        "python3 -m http.server --directory target/docs\n```\n"
    )


def versions() -> str:
    """Return a table of the versions in the changelog, with links to the sites of those that `make versions` found."""
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    rows = ["| version | date | its site |", "|---|---|---|"]
    for number, date in re.findall(r"^## (\S+) - (.+)$", changes, re.MULTILINE):
        page = ADDED["versions"] / f"v{number}" / "index.html"
        if number == logicity.__version__:
            site = "this one"
        else:
            site = f'<a href="../versions/v{number}/index.html">{number}</a>' if page.is_file() else "not kept"
        rows.append(f"| {number} | {date} | {site} |")
    return "\n".join(rows)


def rust() -> str:
    """Return a link to the documentation of the crate, or the command that builds it."""
    if ADDED["rust"].is_dir():
        return (
            '```{raw} html\n<p>The <a href="../rust/logicity/index.html">documentation of the crate</a> describes '
            "every module, type and function.</p>\n```\n"
        )
    return "`make doc` builds the documentation of the crate, `target/doc/logicity/index.html`.\n"


# --- Python

#: The modules of the package, with a heading for each.
MODULES = {
    "logicity.rules": "Rules and programs",
    "logicity.city": "Scenes and cities",
    "logicity.predicates": "Predicates of Python functions",
    "logicity.modes": "Modes",
    "logicity.evaluation": "Measures of policies",
    "logicity.rule_policy": "Policies made of rules",
    "logicity.packed": "Policies in the package",
    "logicity.describe": "Observations",
    "logicity.offline": "Demonstrations",
    "logicity.induction": "Learned rules",
    "logicity.torch": "Rules as a layer",
    "logicity.envs": "Environments",
    "logicity.envs.registration": "Environments by name",
    "logicity.envs.shield": "Shields",
    "logicity.envs.layout": "Layouts of observations",
    "logicity.envs.views": "Views of observations",
    "logicity.envs.wrappers": "Wrappers with views",
    "logicity.envs.sb3": "Stable-Baselines3",
    "logicity.envs.torchrl": "TorchRL",
    "logicity.learn": "Learners",
    "logicity.vap": "Visual Action Prediction",
    "logicity.questions": "Questions for language models",
    "logicity.study": "Questions for people",
    "logicity.icons": "Icon packs",
    "logicity.release": "Releases",
    "logicity.shards": "Shards",
    "logicity.published": "Episodes of the published program",
    "logicity.errors": "Exceptions",
    "logicity.types": "Types",
}


#: Optional dependencies of the package, which need not be installed to read its docstrings.
OPTIONAL = [
    *["PIL", "diffusers", "minari", "pettingzoo", "pyarrow", "stable_baselines3", "tensordict", "torch", "torchrl"],
    "tqdm",
]


@functools.cache
def public_names() -> dict[str, list[str]]:
    """Return the public names by module. Names that `logicity` exports count as its own."""
    names: dict[str, list[str]] = {}
    for module in MODULES:
        exported = logicity._NAMES.get(module.removeprefix("logicity."))
        home = "logicity" if exported else module
        names[module] = [f"{home}.{name}" for name in exported or imported(module).__all__]
    missing = {f"logicity.{name}" for name in logicity.__all__} - {name for found in names.values() for name in found}
    if missing != {"logicity.__version__"}:
        raise ValueError(f"no section of the reference has {missing}")
    return names


def imported(module: str) -> Any:
    """Import a module; optional dependencies are replaced by stand-ins."""
    with mock(OPTIONAL):
        return importlib.import_module(module)


def python() -> str:
    """Return a section for each module, with the documentation of its public names."""
    parts = []
    for module, names in public_names().items():
        parts.append(f"\n## {MODULES[module]}\n")
        if not names[0].startswith(f"{module}."):
            parts.append("Import these names from `logicity`.\n")
        else:
            parts.append(f"```{{eval-rst}}\n.. automodule:: {module}\n   :no-members:\n   :no-index:\n```\n")
        for name in names:
            home, _, last = name.rpartition(".")
            with mock(OPTIONAL):
                value = getattr(importlib.import_module(home), last)
            if inspect.isclass(value):
                kind = "autoexception" if issubclass(value, BaseException) else "autoclass"
            else:
                kind = "autofunction" if callable(value) and inspect.isroutine(value) else "autodata"
            # The comment of a value is in the module that defines it.
            path = f"{module}.{last}" if kind == "autodata" else name
            parts.append(f"```{{eval-rst}}\n.. {kind}:: {path}\n```\n")
    return "\n".join(parts)


GENERATORS: dict[str, Callable[[], str]] = {
    "commands": commands,
    "errors": lambda: messages("error"),
    "warnings": lambda: messages("warning"),
    "predicates": predicates,
    "configuration": configuration,
    "training": training,
    **{f"experiment-files-{name}": functools.partial(experiment_files, name) for name in EXPERIMENT_PARTS},
    "environments": environments,
    **{f"environment-{mode}": functools.partial(environment_page, mode) for mode in ENVIRONMENTS},
    "environment-parallel": parallel,
    "python": python,
    "playground": playground,
    "rust": rust,
    "versions": versions,
    **{f"chart-{name}": functools.partial(chart_of, name) for name in ("observations", "noise")},
    "chart-history": lambda: history.page((ROOT / "benches" / "history.jsonl").read_text(encoding="utf-8")).partition(
        "\n\n|"
    )[0],
    "history": lambda: history.page((ROOT / "benches" / "history.jsonl").read_text(encoding="utf-8")),
    "suite": lambda: suite.page((ROOT / "benches" / "suite.json").read_text(encoding="utf-8")),
    **{f"results-{name}": functools.partial(results, name) for name in RESULTS},
    **{Path(name).stem.lower(): functools.partial(repository_file, name) for name in REPOSITORY_FILES},
}
