"""Write releases: data sets with their documents, and trained policies."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date as Date
from pathlib import Path
from typing import Any

from .._logicity import __version__
from ..errors import checked_path, did_you_mean
from ..files import file_hash, json_text, read_json, write_text
from .cards import LICENSE, card, data_sheet
from .croissant import About, DataFile, metadata
from .datasets import DataSet, DataSetOptions, data_sets
from .policies import ResultsFile, pack_policies

__all__ = ["Release", "release", "selected_sets", "write_documents"]

#: The file that says of which release a folder is.
STAMP = "release.json"
SUMS = "SHA256SUMS"

_MEDIA_TYPES = {
    ".jsonl": "application/jsonlines",
    ".json": "application/json",
    ".parquet": "application/x-parquet",
    ".md": "text/markdown",
}

#: The documents of a data set, which its metadata does not list.
_DOCUMENTS = ("README.md", "DATASHEET.md", "LICENSE", SUMS, STAMP, "croissant.json")


@dataclass(frozen=True)
class Release:
    """What a call of `release` wrote.

    Attributes:
        made: The names of the data sets that it wrote.
        kept: The names of those that were complete already.
        policies: The names of the packed policies.
        left_out: Why other published policies were not packed, by their names.
    """

    made: tuple[str, ...]
    kept: tuple[str, ...]
    policies: tuple[str, ...]
    left_out: Mapping[str, str]


def release(
    folder: str | os.PathLike[str],
    options: DataSetOptions | None = None,
    *,
    only: Sequence[str] | None = None,
    results: Sequence[ResultsFile] = (),
    date: str | None = None,
    url: str | None = None,
    progress: Callable[[str], object] = lambda line: None,
) -> Release:
    """Write a release, or resume an interrupted call.

    A data set has a card, a datasheet, Croissant metadata, a license and checksums beside its data. Its data depends
    only on `options`. Complete data sets are kept, and files of an interrupted call too.

    Args:
        folder: The folder to write. Each data set has a folder in it, and all policies the folder `policies`.
        options: The sizes of the data sets; default: those of the published ones.
        only: The names of the data sets; `vap` stands for all with pictures, `policies` for none. Default: all.
        results: The published results whose trained policies to pack.
        date: The day of the release, `YYYY-MM-DD`; default: that of an earlier call, or today.
        url: The address of the release or of the project; default: that of an earlier call, if any.
        progress: Receives lines of progress.

    Raises:
        FileExistsError: If the folder of a data set has other files, or a release with other settings.
        ImportError: If pyarrow, which the extra `release` installs, is missing.
        OSError: If a file cannot be read or written.
        ValueError: If a name is unknown, or a command of a data set fails.
    """
    root = Path(checked_path("folder", folder))
    day = Date.today().isoformat() if date is None else Date.fromisoformat(date).isoformat()
    selected = selected_sets(only, options)
    root.mkdir(parents=True, exist_ok=True)
    made, kept = [], []
    for each in selected:
        if _write_data_set(root / each.name, each, day, date is not None, url, progress):
            made.append(each.name)
        else:
            kept.append(each.name)
    packed, left_out = pack_policies(root / "policies", results, progress) if results else ((), {})
    return Release(tuple(made), tuple(kept), tuple(packed), left_out)


def selected_sets(only: Sequence[str] | None, options: DataSetOptions | None = None) -> list[DataSet]:
    """Return the data sets that `release` writes. Raise `ValueError` for unknown names."""
    known = {each.name: each for each in data_sets(options)}
    if only is None:
        return list(known.values())
    found: list[str] = []
    for name in only:
        if name == "vap":
            found += (each for each in known if each.startswith("vap-"))
        elif name in known:
            found.append(name)
        elif name != "policies":
            raise ValueError(f"unknown data set `{name}`{did_you_mean(name, [*known, 'vap', 'policies'])}")
    return [known[name] for name in dict.fromkeys(found)]


def _write_data_set(
    folder: Path, each: DataSet, day: str, is_given: bool, url: str | None, say: Callable[[str], object]
) -> bool:
    """Write a data set. Return `False` if it is complete already."""
    stamp: dict[str, Any] = {
        "release": "logicity",
        "version": __version__,
        "name": each.name,
        "settings": dict(each.settings),
    }
    found = _stamp(folder)
    if found is not None:
        day = day if is_given else found.get("date", day)
        url = found.get("url") if url is None else url
    if found is not None and {**found, "date": None, "url": None} != {**stamp, "date": None, "url": None}:
        help = "name another folder, or use the options and the version of the interrupted command"
        raise FileExistsError(f"`{folder}` has another release, with other settings\nhelp: {help}")
    if found is None and folder.is_dir() and any(folder.iterdir()):
        raise FileExistsError(f"`{folder}` has files that are not of a release\nhelp: name another folder")
    stamp |= {"date": day, "url": url}
    if found == stamp and (folder / SUMS).exists():
        say(f"{each.name}: complete")
        return False
    folder.mkdir(exist_ok=True)
    (folder / SUMS).unlink(missing_ok=True)
    write_text(folder / STAMP, json_text(stamp))
    say(f"{each.name}: begins")
    each.make(folder, say)
    write_documents(folder, each, day, url)
    say(f"{each.name}: written")
    return True


def _stamp(folder: Path) -> dict[str, Any] | None:
    try:
        found = read_json(folder / STAMP)
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise FileExistsError(f"`{folder / STAMP}` is not of a release: {error}") from None
    return found if isinstance(found, dict) else {}


def write_documents(folder: Path, each: DataSet, day: str, url: str | None) -> None:
    """Write the documents of a data set, at last the checksums, which mark it as complete."""
    about = About(
        each.name, each.title, each.description, __version__, day, url, each.keywords, each.responsible, each.command
    )
    paths = [path for path in _files(folder) if path not in _DOCUMENTS]
    hashes = {path: file_hash(folder / path) for path in paths}
    sizes = {path: (folder / path).stat().st_size for path in paths}
    files = {
        path: DataFile(path, _MEDIA_TYPES[Path(path).suffix], sizes[path], hashes[path])
        for path in paths
        if Path(path).suffix in _MEDIA_TYPES
    }
    patterns, records = each.records(folder, files)
    # One pattern describes many files.
    singles = [file for path, file in files.items() if not (patterns and "/world-" in path)]
    total = sum(sizes.values())
    text = f"It has {len(paths)} files with {_megabytes(total)}."
    write_text(folder / "croissant.json", json_text(metadata(about, singles, patterns, records)))
    write_text(folder / "README.md", card(about, records, text, each.usage, each.configs))
    write_text(folder / "DATASHEET.md", data_sheet(about, text))
    write_text(folder / "LICENSE", LICENSE)
    hashes |= {path: file_hash(folder / path) for path in _DOCUMENTS if path != SUMS}
    write_text(folder / SUMS, "".join(f"{hashes[path]}  {path}\n" for path in sorted(hashes)))


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.1f} MB" if size >= 100_000 else f"{size:,} bytes"


def _files(folder: Path) -> Iterable[str]:
    """Return the paths of all files in a folder, relative to it."""
    found = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return sorted(path.relative_to(folder).as_posix() for path in found)
