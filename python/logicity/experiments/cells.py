"""The cells of experiments: each is one run and its measures, in a separate folder.

`python -m logicity.experiments.cells FOLDER` runs the cell in a folder. It ends when its standard input is closed. So
it does not outlive the process that started it. Everything in the folder is data, except for a model that `--trust`
permits.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._logicity import __version__
from ..files import check_readable, read_json, write_json
from ..learn.supervise import end_with_parent
from ..terminal import print_message
from .registry import task_named
from .task import Cell, Running

__all__ = ["finished", "inputs", "prepare", "reuse", "run_cell", "sampled"]

#: A file in the folder of a cell that names the cell of another experiment whose training it has.
_REUSED = "reused.json"


def prepare(cell: Cell, root: Path) -> Path:
    """Create the folder of a cell, whose file `cell.json` contains everything that `run_cell` needs."""
    folder = cell.folder(root)
    folder.mkdir(parents=True, exist_ok=True)
    if cell.start is not None and not list(folder.glob("start.*")):
        best = cell.task.model(cell.start.folder(root))
        temporary = folder / f".start{best.suffix}"
        shutil.copyfile(best, temporary)
        temporary.replace(folder / f"start{best.suffix}")
    names = {"identity": cell.identity, "task": cell.task.name, "row": cell.row, "variant": cell.variant}
    write_json(folder / "cell.json", {**names, "spec": cell.spec, **cell.task.document(cell, root)})
    return folder


def sampled(cells: Sequence[Cell], count: int, seed: int) -> list[Cell]:
    """Draw cells that tables show, and return them with those that they start from, in the order of `cells`."""
    shown = [cell for cell in cells if not cell.hidden]
    drawn = random.Random(seed).sample(shown, min(count, len(shown)))
    wanted: set[str] = set()
    for cell in drawn:
        start: Cell | None = cell
        while start is not None:
            wanted.add(start.identity)
            start = start.start
    return [cell for cell in cells if cell.identity in wanted]


def inputs(folder: Path) -> list[Path]:
    """Return the files in the folder of a cell that `run_cell` needs, apart from checkpoints."""
    patterns = ["cell.json", "start.*"]
    if (folder / _REUSED).exists():
        patterns += [_REUSED, "config.json", "result.json", "best.*", "rules.dl"]
    return [path for pattern in patterns for path in folder.glob(pattern)]


def reuse(cells: Sequence[Cell], root: Path, other: Path) -> list[str]:
    """Copy the trainings of finished cells of another experiment to the cells that have not begun and train the same.

    Only their evaluations can differ, so the result is that of training again, except for the times. `root` and `other`
    are the folders of the experiments.

    Returns:
        A line for each copied training.
    """
    if not (other / "cells").is_dir():
        raise FileNotFoundError(f"{other}: not the folder of an experiment: it has no folder `cells`")
    trained = {}
    for path in sorted(other.glob("cells/*/cell.json")):
        try:
            document = read_json(path)
            if _measured(path.parent, document["identity"]) is not None:
                trained[_training(document["task"], document["spec"])] = path.parent
        except (ValueError, KeyError, TypeError):
            continue  # of another version, or of another program
    lines = []
    for cell in cells:
        folder = cell.folder(root)
        source = trained.get(_training(cell.task.name, cell.spec))
        if source is None or folder.exists():
            continue
        temporary = folder.with_name(f".{folder.name}")
        shutil.rmtree(temporary, ignore_errors=True)
        left_out = shutil.ignore_patterns("cell.json", "measured.json", "log.txt", "fresh-*", "start.*")
        shutil.copytree(source, temporary, ignore=left_out, copy_function=_copy)
        write_json(temporary / _REUSED, {"cell": source.name})
        temporary.rename(folder)
        lines.append(f"{cell.name}: the training of {source}")
    return lines


def _copy(source: str, target: str) -> None:
    check_readable(source, whole=False)
    shutil.copy2(source, target)


def _training(task: str, spec: Mapping[str, Any]) -> str:
    return task + json.dumps({key: value for key, value in spec.items() if key != "evaluations"}, sort_keys=True)


def finished(cell: Cell, root: Path) -> dict[str, Any] | None:
    """Return the content of `measured.json` of a cell, or `None` if the cell is not finished or has no model."""
    return _measured(cell.folder(root), cell.identity)


def _measured(folder: Path, identity: str) -> dict[str, Any] | None:
    """Return the content of `measured.json` in a folder with a model, if it is that of the cell with an identity."""
    try:
        measured = read_json(folder / "measured.json")
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return None
    if not any(path for pattern in ("best.*", "model.pt", "replies.jsonl") for path in folder.glob(pattern)):
        return None
    return measured if isinstance(measured, dict) and measured.get("identity") == identity else None


def run_cell(folder: Path, **options: Any) -> dict[str, Any]:
    """Run the cell that `prepare` wrote to a folder, or resume it from its last checkpoint.

    The options are attributes of `Running`.

    Returns:
        The content of `measured.json`: the identity, the result of the run, and the evaluations by name.

    Raises:
        ValueError: If this process has another version of the package, rules or episodes than the cell.
        Exception: Those of the training and of the evaluations.
    """
    document = read_json(folder / "cell.json")
    # The process that ran the cell may have been lost after its last file.
    if (measured := _measured(folder, document["identity"])) is not None:
        return measured
    if (version := document["spec"]["version"]) != __version__:
        raise ValueError(
            f"the cell is of version {version} of logicity, this process of {__version__}: install one version on all "
            "machines"
        )
    running = Running(folder, document, **options)
    measured = {"identity": document["identity"], **task_named(document["task"]).run(running)}
    write_json(folder / "measured.json", measured)
    for checkpoint in folder.glob("checkpoint[.-]*"):
        if checkpoint.is_dir():
            shutil.rmtree(checkpoint)
        else:
            checkpoint.unlink()
    return measured


def _main() -> int:
    end_with_parent()
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--trust", action="store_true")
    parser.add_argument("--wandb")
    given = parser.parse_args()
    # The process that started this one reads lines of JSON. Other output goes to the standard error.
    lines = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    reported = -1.0

    def write(**line: Any) -> None:
        print(json.dumps(line), file=lines, flush=True)

    def report(steps: int) -> None:
        nonlocal reported
        # At most twice a second.
        if time.monotonic() - reported >= 0.5:
            reported = time.monotonic()
            write(steps=steps)

    try:
        run_cell(report=report, note=lambda text: write(note=text), progress=True, **vars(given))
    except Exception as error:
        print_message(traceback.format_exc().rstrip())
        write(error=str(error) or type(error).__name__)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main())
