"""The command `logicity`, also `python -m logicity`: the Rust commands and those of `logicity.commands`."""

from __future__ import annotations

import importlib
import io
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType

from . import _logicity
from .signals import kept_handlers
from .terminal import print_message

__all__ = ["main"]

if hasattr(os, "register_at_fork"):
    # A command off the main thread leaves its handlers of signals, which need a thread of Rust.
    os.register_at_fork(after_in_child=_logicity.end_forked)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line without the program name. Defaults to that of the process.

    Returns:
        The exit code: 0 for success, 1 for invalid input, 2 for wrong usage, for a file that cannot be read or written,
        or for a server that gives no reply, 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.
    """
    if sys.excepthook is sys.__excepthook__:
        sys.excepthook = _print_exception
    _open_standard_streams()
    argv = list(sys.argv[1:] if arguments is None else arguments)
    if any(argument == "--video" or argument.startswith("--video=") for argument in argv):
        _offer_encoder()
    # Rust writes to the same streams through separate buffers. A process may have no such streams.
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and not stream.closed:
            stream.flush()
            # A pipe or a file has the encoding and the line breaks of Rust, too.
            if sys.platform == "win32" and isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(encoding="utf-8", newline="\n")
    # Rust handles the signals by itself.
    with kept_handlers(signal.SIGINT) as kept:
        # Python runs its handler of Ctrl-C only between bytecode instructions. An ignored signal stays ignored.
        if kept and signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        code, words, rest = _logicity.run_command_line(argv)
    if not words:
        return code
    from .commands import run

    return run(tuple(words), rest)


def _offer_encoder() -> None:
    """Name the program ffmpeg that the extra `video` installs, unless there is another one."""
    if os.environ.get("LOGICITY_FFMPEG") or shutil.which("ffmpeg"):
        return
    with suppress(ImportError, RuntimeError):
        os.environ["LOGICITY_FFMPEG"] = str(importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe())


def _open_standard_streams() -> None:
    """Open the null device in place of a closed standard stream, as programs in Rust do.

    Otherwise the next file that is opened would get its number, and with it what Rust prints.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            # The system gives the lowest free number.
            os.open(os.devnull, os.O_RDWR)


def _print_exception(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print an exception that no command expects. Its message may contain text of others."""
    print_message("".join(traceback.format_exception(kind, error, trace)).rstrip())


if __name__ == "__main__":
    sys.exit(main())
