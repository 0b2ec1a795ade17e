from __future__ import annotations

import json
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from logicity.vap import VapDataset

ROOT = Path(__file__).parents[2]

Interrupt = Callable[[Callable[[], object]], None]

#: Rules that count for minutes if a car stops.
COUNTING = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
Stop(X) :- IsCar(X), IsOld(X).
n(0) :- Stop(X).
n(x + 1) :- n(x), x < 90000000.
Slow(X) :- IsCar(X), n(90000000).
"""
#: Rules whose decisions are slow, but each is too short for a check for signals during it.
SLOW = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
n(0) :- IsCar(X).
n(x + 1) :- n(x), x < 15000.
Slow(X) :- IsCar(X), n(90000000).
"""


def needs(module: str, extra: str) -> Any:
    """Return a module that an extra of the package installs. Skip the test, or the whole file, if it is missing."""
    return pytest.importorskip(
        module, reason=f"needs {module.split('.')[0]}: pip install 'logicity[{extra}]', or `make python-all`"
    )


def timeless(value: Any) -> Any:
    """Return results without times."""
    if isinstance(value, dict):
        return {
            key: timeless(each) for key, each in value.items() if key not in ("cpu_seconds", "minutes", "cpu_hours")
        }
    if isinstance(value, (list, tuple)):
        return [timeless(each) for each in value if not (isinstance(each, str) and each.startswith("CPU time"))]
    return value


def wait_for(condition: Callable[[], object]) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < deadline, "waited for 300 seconds"
        time.sleep(0.05)


#: Runs the cells of an experiment on a local Ray cluster of two workers, and kills the first worker that is seen.
ON_RAY = """
import os, signal, sys
from pathlib import Path
from logicity.experiments import jobs
from logicity.experiments.experiment import Selection
from logicity.experiments.registry import load_experiment

def watch(line):
    if not killed:
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            # The arguments of this process contain this text, too.
            if path.read_bytes().startswith(b"ray::_in_worker"):
                killed.append(int(path.parent.name))
                os.kill(killed[0], signal.SIGKILL)
                break

killed, jobs.SECONDS = [], 0.0
failed = jobs.run(load_experiment(sys.argv[1]).cells(Selection()), Path(sys.argv[2]), 2, watch, "local")
assert killed and not failed, (killed, failed)
"""


def run_with_a_lost_worker(file: Path, root: Path) -> None:
    """Run all cells of an experiment on Ray. One worker is killed."""
    needs("ray", "ray")
    words = [sys.executable, "-c", ON_RAY, str(file), str(root)]
    done = subprocess.run(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def ctrl_c() -> Interrupt:
    """Return a function that runs long work, interrupts it as Ctrl-C does, and checks that it stops promptly."""
    if sys.platform == "win32":
        pytest.skip("needs POSIX signals, which Windows does not have")

    def interrupt(work: Callable[[], object]) -> None:
        previous = signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        start = time.monotonic()
        try:
            with pytest.raises(KeyboardInterrupt):
                work()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, previous)
        # The goal is one second. The tolerance allows for other processes.
        assert time.monotonic() - start < 10

    return interrupt


@pytest.fixture
def own_city(tmp_path: Path) -> Path:
    """A custom configuration file: easy mode with the first five of its episodes in a file beside it."""
    recorded = Path(__file__).parents[2] / "configs" / "episodes" / "easy-val.jsonl"
    header_and_five = recorded.read_text(encoding="utf-8").splitlines(keepends=True)[:6]
    (tmp_path / "five.jsonl").write_text("".join(header_and_five), encoding="utf-8")
    city = tmp_path / "own.yaml"
    city.write_text("base: configs/easy.yaml\ntask:\n  episodes: {val: five.jsonl}\n", encoding="utf-8")
    return city


#: The data sets that `logicity vap make` creates for the tests.
SETS = {
    "hard": ["--mode", "hard", "--split", "test", "--worlds", "2"],
    "random": ["--mode", "easy", "--split", "val", "--worlds", "3", "--agents", "random"],
}


@pytest.fixture(scope="session")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data sets without pictures, created by the installed command."""
    folder = tmp_path_factory.mktemp("sets")
    for name, options in SETS.items():
        command = [sys.executable, "-m", "logicity", "vap", "make", "--no-pictures"]
        command += ["--out", str(folder / name), *options]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return folder


def png(pixels: NDArray[np.uint8], *, interlaced: int = 0, rows: int | None = None) -> bytes:
    """Encode a picture as PNG. The rows alternate between the filters None, Sub and Up."""
    height, width, _ = pixels.shape
    lines = []
    above = np.zeros(3 * width, np.uint8)
    for number, line in enumerate(pixels.reshape(height, -1)):
        left = np.concatenate([np.zeros(3, np.uint8), line[:-3]])
        lines.append(bytes([number % 3]) + (line - (0, left, above)[number % 3]).tobytes())
        above = line
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, interlaced)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(b"".join(lines[:rows]), 1)), (b"IEND", b"")]
    packed = [struct.pack(">I", len(data)) + name + data + _crc(name + data) for name, data in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)


def _crc(data: bytes) -> bytes:
    return struct.pack(">I", zlib.crc32(data))


def picture(world: int, tick: int) -> NDArray[np.uint8]:
    """Return the picture of a sample in these tests: squares of 64 pixels with colors that are unique to the sample."""
    colors = np.random.default_rng([world, tick]).integers(0, 256, (16, 16, 3), np.uint8)
    return np.repeat(np.repeat(colors, 64, 0), 64, 1)


@pytest.fixture(scope="session")
def shown(sets: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set `random` with pictures."""
    folder = Path(shutil.copytree(sets / "random", tmp_path_factory.mktemp("shown") / "set"))
    manifest = folder / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"pictures": false', '"pictures": true'))
    samples = VapDataset(folder, images=False)
    for index, sample in enumerate(samples):
        samples.picture_path(index).write_bytes(png(picture(sample.world, sample.tick)))
    return folder


#: Replies to a request, given its number and its body.
Act = Callable[[BaseHTTPRequestHandler, int, dict[str, Any]], None]


@dataclass
class Server:
    """A local chat endpoint. `act` replies to each request."""

    act: Act
    requests: list[dict[str, Any]] = field(default_factory=list)
    keys: list[str | None] = field(default_factory=list)
    url: str = ""


Serve = Callable[[Act], Server]


def send(handler: BaseHTTPRequestHandler, code: int, body: bytes, **headers: str) -> None:
    """Send a response."""
    handler.send_response(code)
    for name, value in {"Content-Length": str(len(body)), **headers}.items():
        handler.send_header(name.replace("_", "-"), value)
    handler.end_headers()
    handler.wfile.write(body)


def say(handler: BaseHTTPRequestHandler, text: object, **choice: Any) -> None:
    """Send a reply of a chat endpoint, with more fields of its choice."""
    message = {"role": "assistant", "content": text}
    send(handler, 200, json.dumps({"choices": [{"message": message, **choice}]}).encode())


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Return a function that starts a server."""
    running: list[ThreadingHTTPServer] = []

    def start(act: Act) -> Server:
        server = Server(act)
        lock = threading.Lock()

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                with lock:
                    server.requests.append({"path": self.path, **body})
                    server.keys.append(self.headers.get("Authorization"))
                    number = len(server.requests) - 1
                server.act(self, number, body)

            def log_message(self, *message: Any) -> None:
                pass

        http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        running.append(http)
        threading.Thread(target=http.serve_forever, daemon=True).start()
        server.url = f"http://127.0.0.1:{http.server_port}/v1"
        return server

    yield start
    for http in running:
        http.shutdown()
        http.server_close()


QUANTITIES = """
base: expert
rules: patience.dl
predicates:
  define:
    Waited: {quantity: waited}
    Heading: {quantity: heading}
    Priority: {quantity: priority}
    Distance: {quantity: distance}
    Tick: {quantity: tick}
"""
PATIENCE = """
.include "vocabulary.dl"
.decl Waited, Priority(x: agent, n: number)
.decl Heading(x: agent, h: symbol)
.decl Distance(x: agent, y: agent, d: float)
.decl Tick(t: number)
.input Waited, Heading, Priority, Distance, Tick
/// P1
Stop(X) :- IsInInter(Y), IsAtInter(X), Waited(X, n), n < 9.
/// P2
Slow(X) :- Distance(X, Y, d), d < 40.0, Heading(X, h), Heading(Y, h), Not(Stop(X)).
/// P3
Fast(X) :- Tick(t), t % 5 = 4, Priority(X, n), Priority(Y, m), n < m, Not(Stop(X)), Not(Slow(X)).
"""


@pytest.fixture
def patience(tmp_path: Path) -> str:
    """Return a configuration whose rules read quantities."""
    (tmp_path / "patience.dl").write_text(PATIENCE)
    (tmp_path / "patience.yaml").write_text(QUANTITIES)
    return str(tmp_path / "patience.yaml")
