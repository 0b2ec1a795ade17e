from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

Interrupt = Callable[[Callable[[], object]], None]

#: Whoever stops makes the rules count for minutes.
COUNTING = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
Stop(X) :- IsCar(X), IsOld(X).
n(0) :- Stop(X).
n(x + 1) :- n(x), x < 90000000.
Slow(X) :- IsCar(X), n(90000000).
"""
#: Decisions take their time, but none is so long that anybody looks for signals in it.
SLOW = """
.include "vocabulary.dl"
.scope
.decl n(x: number)
n(0) :- IsCar(X).
n(x + 1) :- n(x), x < 15000.
Slow(X) :- IsCar(X), n(90000000).
"""


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
