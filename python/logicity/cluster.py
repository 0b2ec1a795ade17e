"""Connections to Ray clusters. Needs the extra `ray`."""

from __future__ import annotations

import socket
from types import ModuleType
from typing import Any, cast

from .errors import extra
from .signals import kept_handlers

__all__ = ["ONE_THREAD", "RETRIES", "check_jobs", "connect"]

#: The largest number of times that a cell runs again because its worker is lost.
RETRIES = 20
#: The environment variables that give a process one thread. Cells and worlds run in parallel.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def check_jobs(jobs: int | None, address: str | None) -> None:
    """Raise `ValueError` if a number of jobs would have no effect: an existing Ray cluster has its own workers."""
    if jobs is not None and address not in (None, "local"):
        help = f"omit it, or give `--ray` without `{address}` for a new cluster"
        raise ValueError(f"--jobs: the Ray cluster at `{address}` determines the number of workers\nhelp: {help}")


def connect(address: str, workers: int | None = None) -> ModuleType:
    """Connect to a Ray cluster, and return the module `ray`, whose `shutdown` ends the connection.

    The address `local` starts a new cluster on this machine with `workers` CPUs, by default all. Each worker has one
    thread.

    Raises:
        ConnectionError: If the cluster does not answer.
        ImportError: If Ray is not installed.
        ValueError: If there is a number of workers for another address.
    """
    check_jobs(workers, address)
    with extra("ray"):
        import ray
    _check_listening(address)
    options: dict[str, Any] = {"num_cpus": workers, "include_dashboard": False} if address == "local" else {}
    try:
        # Ray installs a handler of SIGTERM that ends the process with another code, without cleaning up.
        with kept_handlers():
            ray.init(address=address, log_to_driver=False, runtime_env={"env_vars": ONE_THREAD}, **options)
    except Exception as error:
        # Ray raises a plain `Exception` if a local cluster takes too long to start.
        raise ConnectionError(f"--ray: no cluster at `{address}`: {error}") from error
    return cast(ModuleType, ray)


def _check_listening(address: str) -> None:
    """Check that a program listens at an address of the form `HOST:PORT` or `ray://HOST:PORT`.

    Without this check, Ray retries for minutes.
    """
    host, separator, port = address.removeprefix("ray://").rpartition(":")
    if not separator or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10.0).close()
    except (OSError, OverflowError) as error:
        help = "start a cluster with `ray start --head`, or give `--ray` without an address for one on this machine"
        raise ConnectionError(f"--ray: no cluster at `{address}`: {error}\nhelp: {help}") from None
