"""The signals that ask a process to end."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["ending_on_signals", "kept_handlers"]

#: The signals that end a command. Windows has no SIGHUP.
_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


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

    with kept_handlers():
        if threading.current_thread() is threading.main_thread():
            for each in _ENDING:
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
def kept_handlers() -> Iterator[None]:
    """Restore the handlers of these signals at the end of a block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {each: signal.getsignal(each) for each in _ENDING}
    try:
        yield
    finally:
        for each, handler in handlers.items():
            # `None` means that Python did not install the handler and cannot restore it.
            if handler is not None:
                signal.signal(each, handler)
