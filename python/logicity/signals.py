"""The signals that ask a process to end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["ending_on_signals", "kept_handlers"]

#: The signals that end a command. Windows has no SIGHUP.
_ENDING: list[signal.Signals] = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into `SystemExit` with the exit code 128 and the number of the signal, as in shells.

    So blocks with `finally` and `with` are left in order, and end the processes that they have started. The second
    signal ends the process at once. Ignored signals, as after `nohup`, stay ignored.
    """
    received: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        received.append(number)
        for each in _ENDING:
            signal.signal(each, signal.SIG_DFL)
        raise SystemExit(128 + number)

    with kept_handlers() as kept:
        for each in kept:
            if signal.getsignal(each) is signal.SIG_DFL:
                signal.signal(each, end)
        try:
            yield
        except BaseException:
            # Ray replaces the exception of a handler by one of its own.
            if received:
                raise SystemExit(128 + received[0]) from None
            raise


@contextmanager
def kept_handlers(*more: signal.Signals) -> Iterator[list[signal.Signals]]:
    """Restore the handlers of these signals, and of more, at the end of a block.

    Yields the signals whose handlers the block can set: none outside of the main thread.
    """
    kept = [*_ENDING, *more] if threading.current_thread() is threading.main_thread() else []
    handlers = {each: signal.getsignal(each) for each in kept}
    try:
        yield kept
    finally:
        for each, handler in handlers.items():
            # `None` means that Python did not install the handler and cannot restore it.
            if handler is not None:
                signal.signal(each, handler)
