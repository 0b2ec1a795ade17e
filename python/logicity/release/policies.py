"""Trained policies of a release: weights as safetensors or rules, with model cards."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._logicity import __version__
from ..files import file_hash, json_text, read_json, write_text
from ..packed import INDEX, packed_policies
from .cards import LICENSE, front_matter

if TYPE_CHECKING:
    from ..experiments.task import Cell

__all__ = ["LARGEST", "ResultsFile", "pack_policies"]

#: Files of weights must be smaller, in bytes.
LARGEST = 5_000_000

#: The files that the folder of a policy can have.
_FILES = ("policy.dl", "policy.safetensors", "config.json", "README.md", "rows.json", "LICENSE")

Row = Mapping[str, Any]


@dataclass(frozen=True)
class ResultsFile:
    """Published results, and the folder of the experiment in which their policies were trained."""

    results: Path
    runs: Path


def pack_policies(
    folder: Path, results: Sequence[ResultsFile], say: Callable[[str], object]
) -> tuple[list[str], dict[str, str]]:
    """Pack the trained policies of published results, and return their names, and why others are left out, by name.

    A policy is packed if its run is finished, its file is smaller than 5 MB, and its hash is the published one. Packed
    policies of an earlier call are replaced. One that is now left out is removed, unless only its run is missing and
    its published rows are the same as then.

    Raises:
        FileExistsError: If the folder has files that are not of such a call.
        OSError: If a file cannot be read or written.
        ValueError: If a file has no results of Safe Path Following.
    """
    from ..experiments.cells import finished
    from ..experiments.experiment import Selection
    from ..experiments.registry import load_experiment
    from ..experiments.results import read_results

    if folder.is_dir() and any(folder.iterdir()) and not (folder / INDEX).is_file():
        raise FileExistsError(f"`{folder}` has files that are not packed policies\nhelp: name another folder")
    known = {entry["name"]: entry for entry in packed_policies(folder) or []}
    folder.mkdir(parents=True, exist_ok=True)
    # An interrupted call leaves a folder that the next one recognizes.
    _index(folder, known)
    left_out: dict[str, str] = {}
    packed: list[str] = []
    for source in results:
        document = read_results(source.results)
        loaded = load_experiment(document["experiment"])
        if not loaded.task.reusable:
            raise ValueError(f"{source.results}: only results of Safe Path Following have policies to pack")
        rows: dict[tuple[Any, ...], list[Row]] = {}
        for row in document["rows"]:
            rows.setdefault((row["mode"], row["learner"], row["variant"], row["seed"]), []).append(row)
        seeds = tuple(sorted({row["seed"] for row in document["rows"]}))
        for cell in loaded.cells(Selection(seeds=seeds)):
            published = rows.get((cell.mode, cell.row, cell.variant, cell.seed))
            if cell.hidden or published is None:
                continue
            name = _name(document["experiment"], cell)
            reason = _pack(folder / name, name, document["experiment"], cell, source.runs, published, known)
            if reason is None:
                packed.append(name)
                _index(folder, known)
                say(f"{name}: packed")
            else:
                if name in known and not (finished(cell, source.runs) is None and _has_rows(folder / name, published)):
                    del known[name]
                    _index(folder, known)
                    _remove(folder / name)
                left_out[name] = reason
                say(f"{name}: left out: {reason}")
    _sums(folder)
    return packed, left_out


def _name(experiment: str, cell: Cell) -> str:
    parts = (experiment, cell.row, Path(cell.mode).stem, cell.variant, str(cell.seed))
    name = "-".join(filter(None, parts))
    return "".join(each if each.isalnum() or each in "-._" else "_" for each in name)


def _has_rows(folder: Path, rows: Sequence[Row]) -> bool:
    """Return whether a policy was packed for these published rows."""
    try:
        return bool(read_json(folder / "rows.json")["rows"] == [dict(row) for row in rows])
    except (KeyError, OSError, TypeError, ValueError):
        return False


def _remove(folder: Path) -> None:
    """Remove a packed policy. Other files in its folder stay."""
    for name in _FILES:
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()


def _pack(
    folder: Path, name: str, experiment: str, cell: Cell, runs: Path, rows: Sequence[Row], known: dict[str, Any]
) -> str | None:
    """Pack the policy of a cell and note it among the known ones, or return why it is left out."""
    from ..experiments.cells import finished
    from ..files import read_tensors, write_safetensors
    from ..learn import load_policy
    from ..learn.storage import policy_hash

    if finished(cell, runs) is None:
        return f"not trained in {runs}"
    run = cell.folder(runs)
    file = cell.task.model(run)
    if file.suffix not in (".dl", ".pt"):
        return f"its file {file.name} is neither plain data nor rules"
    if (size := file.stat().st_size) >= LARGEST:
        return f"its file has {size / 1e6:.1f} MB"
    kind, sha256 = policy_hash(load_policy(file).policy)
    other = [row for row in rows if row["sha256"] != (file_hash(file) if row["sha256_of"] == "file" else sha256)]
    if other:
        return (
            f"its {other[0]['sha256_of']} differ from the published ones: {sha256[:12]}, not {other[0]['sha256'][:12]}"
        )
    folder.mkdir(exist_ok=True)
    packed = folder / ("policy.dl" if file.suffix == ".dl" else "policy.safetensors")
    if file.suffix == ".dl":
        shutil.copyfile(file, packed)
    else:
        write_safetensors(packed, read_tensors(file, "a policy"))
    if (run / "config.json").is_file():
        # The mode, the observation and the egos of the training.
        shutil.copyfile(run / "config.json", folder / "config.json")
    if policy_hash(load_policy(packed).policy) != (kind, sha256):
        raise ValueError(f"{packed} is not the policy of {file}: report this as a fault of logicity")
    write_text(folder / "README.md", _model_card(name, experiment, rows, packed.name, kind, sha256))
    write_text(folder / "rows.json", json_text({"experiment": experiment, "rows": [dict(row) for row in rows]}))
    write_text(folder / "LICENSE", LICENSE)
    first = rows[0]
    known[name] = {
        "name": name,
        "file": f"{name}/{packed.name}",
        "mode": cell.mode,
        "learner": first["learner"],
        "variant": first["variant"],
        "seed": first["seed"],
        "sha256_of": kind,
        "sha256": sha256,
        "command": first["command"],
    }
    return None


def _model_card(name: str, experiment: str, rows: Sequence[Row], file: str, kind: str, sha256: str) -> str:
    first = rows[0]
    matter = {
        "license": "mit",
        "library_name": "logicity",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["logicity", "neuro-symbolic", first["learner"]],
        "model-index": [{"name": name, "results": [_result(row) for row in rows]}],
    }
    names = list(
        dict.fromkeys(measure for row in rows for measure, value in row["measures"].items() if isinstance(value, dict))
    )
    table = [f"| evaluation | {' | '.join(names)} |", f"|---|{'---|' * len(names)}"]
    for row in rows:
        values = (row["measures"].get(measure) for measure in names)
        shown = (
            "-" if value is None else f"{value['value']:.2f} [{value['low']:.2f}, {value['high']:.2f}]"
            for value in values
        )
        table.append(f"| {row['evaluation']} | {' | '.join(shown)} |")
    hashes = "\n".join(f"- {key}: `{value}`" for key, value in _flat(first["hashes"]))
    versions = ", ".join(f"{key} {value}" for key, value in first["versions"].items())
    parts = [
        f"# {name}",
        f"A policy of the learner `{first['learner']}` for Safe Path Following in {first['mode']} mode of LogiCity, "
        f"trained with the seed {first['seed']} in the experiment `{experiment}`. Rates are from 0 to 1, with 95 % "
        "intervals over the recorded test episodes.",
        "\n".join(table),
        f"This command trains it and measures it again:\n\n```sh\n{first['command']}\n```",
        f"This one measures the file:\n\n```sh\nlogicity evaluate --policy {file} --modes {first['mode']}\n```",
        f"SHA-256 of its {kind}: `{sha256}`. It was trained with {versions}, and measured with these hashes:",
        hashes,
        "It decides for a simulated car by rules that are for study only, and must not control vehicles. "
        f"`rows.json` has the published results with all settings. Packed by logicity {__version__}; MIT license.",
    ]
    return front_matter(matter) + "\n" + "\n\n".join(parts) + "\n"


def _result(row: Row) -> dict[str, Any]:
    metrics = [
        {"type": name, "value": value["value"]} for name, value in row["measures"].items() if isinstance(value, dict)
    ]
    return {
        "task": {"type": "reinforcement-learning", "name": "Safe Path Following"},
        "dataset": {"type": "spf-episodes", "name": f"{row['mode']}, {row['evaluation']}"},
        "metrics": metrics,
    }


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found = []
    for name, value in values.items():
        found += _flat(value, f"{prefix}{name} ") if isinstance(value, Mapping) else [(f"{prefix}{name}", value)]
    return found


def _index(folder: Path, known: Mapping[str, Any]) -> None:
    """Write the index of the policies."""
    entries = [known[name] for name in sorted(known)]
    write_text(folder / INDEX, json_text({"format": 1, "version": __version__, "policies": entries}))


def _sums(folder: Path) -> None:
    """Write the checksums of all files."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    lines = sorted((path.relative_to(folder).as_posix(), path) for path in paths if not path.name.startswith("."))
    write_text(folder / "SHA256SUMS", "".join(f"{file_hash(path)}  {name}\n" for name, path in lines))
