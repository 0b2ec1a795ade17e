"""Requests over HTTP that end: each has a total time and a largest reply."""

from __future__ import annotations

import http.client
import math
import os
import queue
import socket
import threading
import urllib.error
import urllib.request
from contextlib import suppress
from typing import Any

__all__ = ["RejectedError", "RetryableError", "post"]

#: The largest number of bytes of the body of an error that is read.
ERROR_BYTES = 1 << 16
#: The time for a thread to end after its connections are closed, in seconds.
GRACE = 0.5
#: The largest pause that a server can request, in seconds: a day.
PAUSE_MAX = 86_400.0


class RetryableError(Exception):
    """A failed request that may succeed later.

    Attributes:
        wait: The pause that the server requests, in seconds.
    """

    def __init__(self, reason: str, wait: float | None = None) -> None:
        """Store the reason and the pause."""
        super().__init__(reason)
        self.wait = wait


class RejectedError(Exception):
    """A request that the server rejects."""


class _Connections:
    """The connections of a request. Another thread can close them, which ends the request."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sockets: list[socket.socket] = []
        self.closed = False

    def create(self, *arguments: Any, **options: Any) -> socket.socket:
        """Connect a socket, as `socket.create_connection`."""
        connected = socket.create_connection(*arguments, **options)
        with self._lock:
            if self.closed:
                connected.close()
                raise TimeoutError
            # TLS moves the descriptor to another object.
            self._sockets.append(socket.socket(fileno=os.dup(connected.fileno())))
        return connected

    def close(self) -> None:
        """Shut all connections down, also those that are in use or begin later."""
        with self._lock:
            self.closed = True
            for each in self._sockets:
                # The server may have closed it.
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
                each.close()
            self._sockets.clear()


class _Handler(urllib.request.HTTPHandler, urllib.request.HTTPSHandler):
    """Sends requests of both schemes over connections that another thread can close."""

    def __init__(self, connections: _Connections) -> None:
        urllib.request.HTTPSHandler.__init__(self)
        self._connections = connections

    def do_open(self, http_class: Any, req: urllib.request.Request, **options: Any) -> http.client.HTTPResponse:
        def connection(host: str, **given: Any) -> http.client.HTTPConnection:
            made: http.client.HTTPConnection = http_class(host, **given)
            made._create_connection = self._connections.create  # type: ignore[attr-defined]
            return made

        return super().do_open(connection, req, **options)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Rejects redirects, because a redirect would send the key to another server."""

    def redirect_request(self, *arguments: Any, **options: Any) -> None:
        return None


def post(url: str, body: bytes, headers: dict[str, str], seconds: float, most: int) -> bytes:
    """Send a POST request, and return the body of the reply, of at most `most` bytes.

    The time in seconds is that for the whole request: names, connection, TLS, headers and body.

    Raises:
        RejectedError: If the server rejects the request. The message contains text of the server.
        RetryableError: If the request fails, takes too long, or has a larger reply. The message contains text of the
            server.
    """
    request = urllib.request.Request(url, body, headers, method="POST")
    connections = _Connections()
    outcome: queue.SimpleQueue[bytes | Exception] = queue.SimpleQueue()

    def work() -> None:
        try:
            outcome.put(_exchange(request, connections, seconds, most))
        except Exception as error:
            outcome.put(error)

    # A thread, because looking up a name has no timeout. A daemon does not delay the end of the process.
    threading.Thread(target=work, name="request", daemon=True).start()
    try:
        result = outcome.get(timeout=seconds)
    except queue.Empty:
        connections.close()
        try:
            result = outcome.get(timeout=GRACE)
        except queue.Empty:
            raise RetryableError(_late(seconds)) from None
    finally:
        connections.close()
    if isinstance(result, Exception):
        raise result from None
    return result


def _late(seconds: float) -> str:
    return f"no complete reply in {seconds:.3g} s"


def _exchange(request: urllib.request.Request, connections: _Connections, seconds: float, most: int) -> bytes:
    """Send a request, and return the body of the reply. The exceptions are those of `post`."""
    opener = urllib.request.build_opener(_NoRedirect, _Handler(connections))
    try:
        with opener.open(request, timeout=seconds) as response:
            text: bytes = response.read(most + 1)
    except urllib.error.HTTPError as error:
        received = b""
        # The server may not send it all: what came before a timeout is kept.
        with error, suppress(OSError, http.client.HTTPException, ValueError):
            while part := error.read1(ERROR_BYTES - len(received)):
                received += part
        body = received.decode(errors="replace").strip()
        reason = f"{error.code} {error.reason}" + (f": {body}" if body else "")
        if error.code in (408, 409, 425, 429) or error.code >= 500:
            raise RetryableError(reason, _seconds(error.headers.get("Retry-After"))) from None
        raise RejectedError(reason) from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        late = connections.closed or isinstance(getattr(error, "reason", error), TimeoutError)
        reason = str(getattr(error, "reason", None) or error) or type(error).__name__
        raise RetryableError(_late(seconds) if late else reason) from None
    if connections.closed:
        # Without a length, a reply that is cut looks complete.
        raise RetryableError(_late(seconds))
    if len(text) > most:
        raise RetryableError(f"the reply is longer than {most >> 20} MiB")
    return text


def _seconds(header: str | None) -> float | None:
    """Parse a Retry-After header as seconds. Return `None` for a date."""
    try:
        wait = float(header or "")
    except ValueError:
        return None
    return min(wait, PAUSE_MAX) if wait >= 0 and not math.isnan(wait) else None
