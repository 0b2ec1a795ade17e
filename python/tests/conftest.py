from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

Interrupt = Callable[[Callable[[], object]], None]


@pytest.fixture
def ctrl_c() -> Interrupt:
    """Do what takes long; it is interrupted as by Ctrl-C, and gives up at once."""
    if sys.platform == "win32":
        pytest.skip("signals are sent as POSIX has them")

    def interrupt(work: Callable[[], object]) -> None:
        previous = signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        begun = time.monotonic()
        try:
            with pytest.raises(KeyboardInterrupt):
                work()
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, previous)
        # A second is promised; other processes may take some, too.
        assert time.monotonic() - begun < 3

    return interrupt


@pytest.fixture
def own_city(tmp_path: Path) -> Path:
    """A configuration file of somebody's own: easy mode with the first five of its episodes, as a file beside it."""
    recorded = Path(__file__).parents[2] / "configs" / "episodes" / "easy-val.jsonl"
    header_and_five = recorded.read_text(encoding="utf-8").splitlines(keepends=True)[:6]
    (tmp_path / "five.jsonl").write_text("".join(header_and_five), encoding="utf-8")
    city = tmp_path / "own.yaml"
    city.write_text("base: configs/easy.yaml\ntask:\n  episodes: {val: five.jsonl}\n", encoding="utf-8")
    return city
