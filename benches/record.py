"""Measures the engine and the city against a fixed peer, and appends the ratios to a history.

`python3 benches/record.py PROGRAM HISTORY` runs PROGRAM, the built benches/peers, and appends a line to HISTORY. Each
ratio is CPU time over that of hand-written datafrog in the same run, so it depends little on the machine: less is
better. The entries `infer` and `tick` are `logicity bench` with the expert rules; they compare the decisions for as
many agents as the case `city` has with datafrog on that case.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

#: The peer never changes: benches/peers/Cargo.toml pins its version.
PEER = "datafrog"
REPEATS = 5
#: The agents of the case `city`.
AGENTS = 10_000
#: Wall-clock seconds of each measurement of the city.
SECONDS = 3


def git(*arguments: str) -> str:
    """Return what git prints."""
    return subprocess.check_output(["git", *arguments], text=True).strip()


def machine() -> str:
    """Return the model of the processor and the number of usable cores."""
    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.exists():
        lines = information.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(": ")[2] for line in lines if line.startswith("model name")), model)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{' '.join(model.split())}, {cores} cores"


def engine(program: Path) -> tuple[dict[str, float], float]:
    """Return the ratio of each case, and the nanoseconds of CPU time of the peer for the case `city`."""
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results.json"
        command: list[str | Path] = [program, "--peers", PEER, "--repeats", str(REPEATS), "--json", results]
        subprocess.run(command, check=True, stdout=sys.stderr)
        medians: list[dict[str, Any]] = json.loads(results.read_text(encoding="utf-8"))["medians"]
    found = {entry["case"]: entry for entry in medians if entry["peer"] == PEER}
    ratios = {case: 1 / entry["cpu_ratio"] for case, entry in found.items()}
    return ratios, found["city"]["cpu_ms"] * 1e6


def city(program: Path, what: str) -> float:
    """Return the nanoseconds of CPU time for the decision of one agent."""
    command: list[str | Path] = [program, "bench", what, "--seconds", str(SECONDS), "--json"]
    environment = os.environ | {"LOGICITY_PEERS_AS_LOGICITY": "1"}
    printed = subprocess.check_output(command, text=True, env=environment)
    return float(json.loads(printed)["ns_per_decision"])


def record(program: Path, history: Path) -> None:
    """Append a line to the history."""
    changes = git("status", "--porcelain", "--untracked-files=no", "--", ".", f":!{history}")
    if changes:
        sys.exit(f"error: the working tree has changes, so no commit has these figures\n{changes}")
    ratios, peer = engine(program)
    ratios |= {what: city(program, what) * AGENTS / peer for what in ("infer", "tick")}
    entry = {
        "commit": git("rev-parse", "--short=8", "HEAD"),
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "machine": machine(),
        "ratios": {name: float(f"{ratio:.3g}") for name, ratio in ratios.items()},
    }
    line = json.dumps(entry)
    with history.open("a", encoding="utf-8") as out:
        out.write(line + "\n")
    print(line)


if __name__ == "__main__":
    record(Path(sys.argv[1]).resolve(), Path(sys.argv[2]))
