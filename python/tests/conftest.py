from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable

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
