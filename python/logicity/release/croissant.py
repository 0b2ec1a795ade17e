"""Metadata of data sets in the format Croissant 1.1, with the fields of its extension for responsible AI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

__all__ = ["About", "Column", "DataFile", "FilePattern", "Records", "metadata"]

#: The names that the documents use, as the specification lists them.
CONTEXT: Mapping[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "containedIn": "cr:containedIn",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "description": {"@container": "@language"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "name": {"@container": "@language"},
    "parentField": "cr:parentField",
    "path": "cr:path",
    "prov": "http://www.w3.org/ns/prov#",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}

CONFORMS_TO = ("http://mlcommons.org/croissant/1.1", "http://mlcommons.org/croissant/RAI/1.0")

#: The types of columns.
Kind = Literal["Boolean", "Float", "ImageObject", "Integer", "Text"]


@dataclass(frozen=True)
class About:
    """What a data set is.

    Attributes:
        name: The name, which is that of its folder.
        title: The title of its card.
        description: A paragraph.
        version: The version of the program that made it.
        date: The day of the release, `YYYY-MM-DD`.
        url: The address of the data set or of the project, if there is one.
        keywords: Keywords, without those of the project.
        responsible: The fields of responsible AI without their prefix, such as `dataLimitations`.
        command: The command that makes it.
    """

    name: str
    title: str
    description: str
    version: str
    date: str
    url: str | None
    keywords: tuple[str, ...]
    responsible: Mapping[str, Any]
    command: str


@dataclass(frozen=True)
class DataFile:
    """A file. `path` is relative to the folder of the data set."""

    path: str
    media_type: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class FilePattern:
    """Many files of the same kind, which a pattern selects. `name` identifies them."""

    name: str
    includes: str
    media_type: str


@dataclass(frozen=True)
class Column:
    """A column of records. `length` is that of arrays: 0 if it varies, and `None` for single values."""

    name: str
    kind: Kind
    description: str
    length: int | None = None


@dataclass(frozen=True)
class Records:
    """Records in a file, or in the files of a pattern. An image is the content of a file, others are columns."""

    name: str
    description: str
    source: DataFile | FilePattern
    columns: Sequence[Column] = field(default_factory=tuple)


def metadata(
    about: About, files: Sequence[DataFile], patterns: Sequence[FilePattern], records: Sequence[Records]
) -> dict[str, Any]:
    """Return the document of a data set."""
    document: dict[str, Any] = {
        "@context": dict(CONTEXT),
        "@type": "sc:Dataset",
        "name": about.name,
        "alternateName": about.title,
        "description": about.description,
        "conformsTo": list(CONFORMS_TO),
        "license": "https://spdx.org/licenses/MIT.html",
        "version": about.version,
        "datePublished": about.date,
        "creator": {"@type": "Organization", "name": "the logicity developers"},
        "keywords": ["logicity", "neuro-symbolic", "Datalog", *about.keywords],
        "citeAs": CITATION,
        "isLiveDataset": False,
        **({} if about.url is None else {"url": about.url}),
        **{f"rai:{name}": value for name, value in about.responsible.items()},
        "prov:wasGeneratedBy": f"logicity {about.version}: {about.command}",
        "distribution": [
            *(
                {
                    "@type": "cr:FileObject",
                    "@id": file.path,
                    "name": file.path,
                    "contentUrl": file.path,
                    "contentSize": f"{file.bytes} B",
                    "encodingFormat": file.media_type,
                    "sha256": file.sha256,
                }
                for file in files
            ),
            *(
                {
                    "@type": "cr:FileSet",
                    "@id": pattern.name,
                    "name": pattern.name,
                    "encodingFormat": pattern.media_type,
                    "includes": pattern.includes,
                }
                for pattern in patterns
            ),
        ],
        "recordSet": [_record_set(each) for each in records],
    }
    return document


#: How to cite the benchmark.
CITATION = (
    "@inproceedings{li2024logicity, title={LogiCity: Advancing Neuro-Symbolic AI with Abstract Urban Simulation}, "
    "author={Li, Bowen and Li, Zhaoyu and Du, Qiwei and Luo, Jinqi and Wang, Wenshan and Xie, Yaqi and Stepputtis, "
    "Simon and Wang, Chen and Sycara, Katia and Ravikumar, Pradeep and Gray, Alexander and Si, Xujie and Scherer, "
    "Sebastian}, booktitle={Advances in Neural Information Processing Systems, Datasets and Benchmarks}, year={2024}}"
)


def _record_set(records: Records) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": records.name,
        "name": records.name,
        "description": records.description,
        "field": [_field(records, column) for column in records.columns],
    }


def _field(records: Records, column: Column) -> dict[str, Any]:
    is_file = isinstance(records.source, DataFile)
    source = records.source.path if isinstance(records.source, DataFile) else records.source.name
    extract = {"fileProperty": "content"} if column.kind == "ImageObject" else {"column": column.name}
    document: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": f"{records.name}/{column.name}",
        "name": column.name,
        "description": column.description,
        "dataType": f"sc:{column.kind}",
        "source": {"fileObject" if is_file else "fileSet": {"@id": source}, "extract": extract},
    }
    if column.length is not None:
        document |= {"isArray": True, "arrayShape": str(column.length or -1)}
    return document
