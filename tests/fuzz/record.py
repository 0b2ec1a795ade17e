"""Runs a fuzzer, and appends what it did to a table.

`python3 record.py TABLE TARGET COMMAND...` runs a command of libFuzzer that prints its final statistics
(`-print_final_stats=1`). The exit code is that of the command.
"""

from __future__ import annotations

import datetime
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

#: `corpus` is the number of inputs at the beginning, and `longest` the bound of an input in bytes.
COLUMNS = "commit,date,target,corpus,longest,executions,seconds,result"
PRINTED = {
    "corpus": r"INFO: seed corpus: files: (\d+)",
    "longest": r"INFO: -max_len is not provided; libFuzzer will not generate inputs larger than (\d+)",
    "executions": r"stat::number_of_executed_units:\s*(\d+)",
}

#: The results by exit code. After Ctrl-C, libFuzzer ends with 72.
RESULTS = {0: "passed", 72: "interrupted"}


def record(table: Path, target: str, command: Sequence[str]) -> int:
    """Run a command, append a row to the table if it executed anything, and return the exit code."""
    begin = time.monotonic()
    found = {"corpus": "0", "executions": "0"}
    for option in command:
        if option.startswith("-max_len="):
            found["longest"] = option.removeprefix("-max_len=")
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, errors="replace") as fuzzer:
        assert fuzzer.stderr is not None
        for line in fuzzer.stderr:
            sys.stderr.write(line)
            found |= {name: match[1] for name, pattern in PRINTED.items() if (match := re.match(pattern, line))}
    if found["executions"] != "0":
        found["commit"] = subprocess.check_output(["git", "rev-parse", "--short=8", "HEAD"], text=True).strip()
        found["date"] = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
        found |= {"target": target, "seconds": f"{time.monotonic() - begin:.0f}"}
        found["result"] = RESULTS.get(fuzzer.returncode, "failed")
        is_new = not table.exists()
        with table.open("a", encoding="utf-8") as out:
            if is_new:
                out.write(COLUMNS + "\n")
            out.write(",".join(found[column] for column in COLUMNS.split(",")) + "\n")
    return fuzzer.returncode


if __name__ == "__main__":
    sys.exit(record(Path(sys.argv[1]), sys.argv[2], sys.argv[3:]))
