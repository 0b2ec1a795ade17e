"""Runs a program that ends when the process that started it ends, also if that process is killed.

`python supervise.py COMMAND...` runs a command. When the command ends, or its own standard input is closed, it kills
all processes that the command has started. On Linux these include those in other sessions and those whose parent has
ended. It imports only the standard library, so that it starts quickly.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

__all__ = ["NEW_GROUP", "end_with_parent"]

#: The flag of Windows that keeps Ctrl-C in a terminal from a process that is started; 0 elsewhere.
NEW_GROUP: int = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)


def end_with_parent(kill: Callable[[], None] = lambda: None) -> None:
    """End this process and those that it started when standard input is closed.

    First, `kill` ends the started processes that are not in the group of this process. Where there are process groups,
    this process must lead its own. On Windows it leads a job instead.
    """
    _lead_job()

    def watch() -> None:
        while os.read(0, 1024):
            pass
        kill()
        if sys.platform != "win32" and os.getpgrp() == os.getpid():
            os.killpg(0, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _descendants() -> list[int]:
    """Return the running processes that this one has started, directly or not. None where there is no `/proc`."""
    parents = {}
    with suppress(OSError):
        for name in filter(str.isdigit, os.listdir("/proc")):
            with suppress(OSError), open(f"/proc/{name}/stat", encoding="utf-8", errors="replace") as file:
                # The name of the program, in parentheses, can have any character.
                state, parent = file.read().rpartition(")")[2].split()[:2]
                if state != "Z":
                    parents[int(name)] = int(parent)
    found, newest = [], [os.getpid()]
    while newest:
        newest = [child for child, parent in parents.items() if parent in newest]
        found += newest
    return found


def _end_descendants() -> None:
    """Kill what this process has started, until nothing is left: a process can start another one meanwhile."""
    # The job of this process does it.
    if sys.platform == "win32":
        return
    for _ in range(100):
        left = _descendants()
        for process in left:
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)
        if not left:
            break


def _lead_job() -> None:
    """Let Windows end the processes that this one starts from now on when this one ends, however it ends."""
    if sys.platform != "win32":
        return
    import ctypes
    from ctypes import wintypes

    class Limits(ctypes.Structure):
        """The structure `JOBOBJECT_EXTENDED_LIMIT_INFORMATION`."""

        _fields_ = [
            *[(name, ctypes.c_int64) for name in ("process_time", "job_time")],
            ("flags", wintypes.DWORD),
            *[(name, ctypes.c_size_t) for name in ("least_working_set", "most_working_set")],
            ("processes", wintypes.DWORD),
            ("affinity", ctypes.c_size_t),
            *[(name, wintypes.DWORD) for name in ("priority", "scheduling")],
            ("transfers", ctypes.c_uint64 * 6),
            ("memory", ctypes.c_size_t * 4),
        ]

    kill_on_job_close, extended_limits = 0x2000, 9
    kernel = ctypes.WinDLL("kernel32", use_last_error=True)
    kernel.CreateJobObjectW.restype = kernel.GetCurrentProcess.restype = wintypes.HANDLE
    kernel.SetInformationJobObject.argtypes = [wintypes.HANDLE, ctypes.c_int, ctypes.c_void_p, wintypes.DWORD]
    kernel.AssignProcessToJobObject.argtypes = [wintypes.HANDLE, wintypes.HANDLE]
    # The only handle of the job stays open until this process ends.
    job = kernel.CreateJobObjectW(None, None)
    limits = Limits(flags=kill_on_job_close)
    if not (
        job
        and kernel.SetInformationJobObject(job, extended_limits, ctypes.byref(limits), ctypes.sizeof(limits))
        and kernel.AssignProcessToJobObject(job, kernel.GetCurrentProcess())
    ):
        raise ctypes.WinError(ctypes.get_last_error())


def _main() -> int:
    if sys.platform == "linux":
        # Ray kills the direct children of an ending worker. As a grandchild, the supervisor survives and ends the rest.
        supervisor = os.fork()
        if supervisor:
            _, status = os.waitpid(supervisor, 0)
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code
        # Become the parent of all descendants whose own parent ends, so that none can leave this process.
        import ctypes

        set_child_subreaper = 36
        ctypes.CDLL(None, use_errno=True).prctl(set_child_subreaper, 1, 0, 0, 0)
    _lead_job()
    try:
        # The parent's pipe is not the standard input of the program.
        program = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    except OSError as error:
        os.write(2, f"cannot run `{sys.argv[1]}`: {error.strerror}\n".encode(errors="replace"))
        return 127

    def end() -> None:
        program.kill()
        _end_descendants()

    end_with_parent(end)
    code = program.wait()
    _end_descendants()
    # As in shells, a signal is 128 and its number.
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(_main())
