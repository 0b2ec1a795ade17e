"""The documents of a release for people: cards with the front matter of model and data hubs, datasheets, license."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from .croissant import About, Column, Records

__all__ = ["LICENSE", "card", "data_sheet", "front_matter"]

LICENSE = """MIT License

Copyright (c) 2026 the logicity developers

Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated documentation
files (the "Software"), to deal in the Software without restriction, including without limitation the rights to use, copy,
modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit persons to whom the
Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE,
ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
"""  # noqa: E501


def front_matter(values: Mapping[str, Any]) -> str:
    """Return the front matter of a card. Every value is JSON, which is YAML."""
    lines = (f"{key}: {json.dumps(value)}" for key, value in values.items())
    return "---\n" + "".join(f"{line}\n" for line in lines) + "---\n"


def card(about: About, records: Sequence[Records], sizes: str, usage: str, configs: Sequence[Mapping[str, Any]]) -> str:
    """Return the card of a data set. `configs` are the tables that a hub shows, `usage` is a block of code."""
    matter: dict[str, Any] = {
        "license": "mit",
        "pretty_name": about.title,
        "language": ["en"],
        "tags": ["logicity", "croissant", *about.keywords],
    }
    if configs:
        matter["configs"] = list(configs)
    parts = [
        f"# {about.title}",
        about.description,
        f"{sizes} Version {about.version}, {about.date}, MIT license.",
        f"This command makes it:\n\n```sh\n{about.command}\n```",
        usage,
        "`croissant.json` describes the files and their columns for machines, `DATASHEET.md` how the data was made and "
        "what it is for, and `sha256sum --check SHA256SUMS` checks the files.",
    ]
    by_columns: dict[tuple[Column, ...], list[Records]] = {}
    for each in records:
        by_columns.setdefault(tuple(each.columns), []).append(each)
    for columns, alike in by_columns.items():
        rows = [
            f"| `{column.name}` | {_kind(column.kind, column.length)} | {column.description} |" for column in columns
        ]
        table = "\n".join(["| column | type | meaning |", "|---|---|---|", *rows])
        listed = "\n".join(f"- `{each.name}`: {each.description}" for each in alike)
        parts.append(f"## {alike[0].name}{' and others' * (len(alike) > 1)}\n\n{listed}\n\n{table}")
    return front_matter(matter) + "\n" + "\n\n".join(parts) + "\n"


def _kind(kind: str, length: int | None) -> str:
    name = {"Boolean": "bool", "Float": "float", "ImageObject": "picture", "Integer": "int", "Text": "text"}[kind]
    return name if length is None else f"list of {name}" if length == 0 else f"list of {length} {name}"


#: The sections of a datasheet, and the fields of responsible AI in each.
_SECTIONS = {
    "Motivation": {"For what the data was made": "dataUseCases"},
    "Composition": {
        "Whether it is synthetic": "hasSyntheticData",
        "Personal and sensitive information": "personalSensitiveInformation",
        "Known limits": "dataLimitations",
        "Known biases": "dataBiases",
    },
    "Collection": {
        "How": "dataCollection",
        "Kind": "dataCollectionType",
        "Missing data": "dataCollectionMissingData",
    },
    "Preprocessing and labels": {
        "Processing": "dataPreprocessingProtocol",
        "How labels are made": "dataAnnotationProtocol",
        "What makes them": "machineAnnotationTools",
    },
    "Uses and effects": {"Social impact": "dataSocialImpact"},
    "Maintenance": {"Plan": "dataReleaseMaintenancePlan"},
}


def data_sheet(about: About, sizes: str) -> str:
    """Return the datasheet of a data set: the questions of Gebru et al. (2021) that apply to simulated data."""
    parts = [f"# Data sheet: {about.title}", about.description, sizes]
    for section, questions in _SECTIONS.items():
        answers = []
        for question, name in questions.items():
            value = about.responsible[name]
            text = "; ".join(value) if isinstance(value, list) else {True: "yes", False: "no"}.get(value, value)
            answers.append(f"- **{question}**: {text}")
        parts.append(f"## {section}\n\n" + "\n".join(answers))
    parts.append(
        f"## Distribution\n\nMIT license, see `LICENSE`. The command `{about.command}` of logicity "
        f"{about.version} makes the same files."
    )
    return "\n\n".join(parts) + "\n"
