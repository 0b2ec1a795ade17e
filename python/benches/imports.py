"""Measures the import of each room of the package: CPU time in new processes, and the packages it imports.

python python/benches/imports.py [--runs 5]
"""

from __future__ import annotations

import argparse
import subprocess
import sys

#: Modules that are imported first by their users. Those of `learn` need the extra `learn`.
MODULES = (
    "logicity",
    "logicity.rules",
    "logicity.city",
    "logicity.evaluation",
    "logicity.envs.single",
    "logicity.learn",
)

CODE = """
import sys, time
before, begun = set(sys.modules), time.process_time()
import {module}
seconds = time.process_time() - begun
new = {{name.partition(".")[0] for name in set(sys.modules) - before}} - set(sys.stdlib_module_names)
print(seconds, ",".join(sorted(name for name in new if not name.startswith("_"))))
"""


def main() -> None:
    """Print a line per module: the fewest milliseconds, and the packages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    runs = parser.parse_args().runs
    for module in MODULES:
        measured = []
        for _ in range(runs):
            command = [sys.executable, "-c", CODE.format(module=module)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            seconds, _, packages = done.stdout.strip().partition(" ")
            measured.append((float(seconds), packages))
        least, packages = min(measured)
        print(f"{module:22} {1000 * least:7.0f} ms  {packages}")


if __name__ == "__main__":
    main()
