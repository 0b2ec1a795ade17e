"""Requests over HTTP that end: each has a total time and a largest reply."""

from __future__ import annotations

import http.client
import os
import socket
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import Any

__all__ = ["RequestError", "post"]

#: The largest number of bytes of the body of an error that is read.
ERROR_BYTES = 1 << 16
LATE = "no complete reply in {:.3g} s"
#: The time for a thread to end after its connections are closed, in seconds.
GRACE = 0.5
#: The largest pause that a server can request, in seconds: a day.
PAUSE_MAX = 86_400.0


class RequestError(Exception):
    """A failed request. `wait` is the pause in seconds that the server requests.

    `retry` is whether the request may succeed later; otherwise the server rejects it.
    """

    def __init__(self, reason: str, wait: float | None = None, *, retry: bool = True) -> None:
        """Store the reason, the pause and whether to try again."""
        super().__init__(reason)
        self.wait, self.retry = wait, retry


class _Handler(urllib.request.HTTPHandler, urllib.request.HTTPSHandler):
    """Sends requests of both schemes. Another thread can close the connections, which ends the request."""

    def __init__(self) -> None:
        super().__init__()
        self._sockets: list[socket.socket] = []
        self.closed = False

    def do_open(self, http_class: Any, req: urllib.request.Request, **options: Any) -> http.client.HTTPResponse:
        def connection(host: str, **given: Any) -> http.client.HTTPConnection:
            made: http.client.HTTPConnection = http_class(host, **given)
            made._create_connection = self._connect  # type: ignore[attr-defined]
            return made

        return super().do_open(connection, req, **options)

    def _connect(self, *arguments: Any, **options: Any) -> socket.socket:
        connected = socket.create_connection(*arguments, **options)
        # TLS moves the descriptor to another object.
        self._sockets.append(socket.socket(fileno=os.dup(connected.fileno())))
        if self.closed:
            self.shut_down()
        return connected

    def shut_down(self) -> None:
        """Shut all connections down, also those that are in use or begin later."""
        self.closed = True
        while self._sockets:
            # The server, or the other thread, may have closed it.
            with suppress(OSError, IndexError), self._sockets.pop() as each:
                each.shutdown(socket.SHUT_RDWR)


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Rejects redirects, because a redirect would send the key to another server."""

    def redirect_request(self, *arguments: Any, **options: Any) -> None:
        return None


def post(url: str, body: bytes, headers: dict[str, str], seconds: float, most: int) -> bytes:
    """Send a POST request, and return the body of the reply, of at most `most` bytes.

    The time in seconds is that for the whole request: names, connection, TLS, headers and body.

    Raises:
        RequestError: If the server rejects the request, or the request fails, takes too long, or has a larger reply.
            The message contains text of the server.
    """
    end = time.monotonic() + seconds
    request = urllib.request.Request(url, body, headers, method="POST")
    handler = _Handler()
    outcome: Future[bytes] = Future()

    def work() -> None:
        try:
            outcome.set_result(_exchange(request, handler, seconds, most))
        except Exception as error:
            outcome.set_exception(error)

    # A thread, because looking up a name has no timeout. A daemon does not delay the end of the process.
    threading.Thread(target=work, name="request", daemon=True).start()
    try:
        wait([outcome], end - time.monotonic())
    finally:
        handler.shut_down()
    if not wait([outcome], GRACE).done:
        raise RequestError(LATE.format(seconds))
    return outcome.result()


def _exchange(request: urllib.request.Request, handler: _Handler, seconds: float, most: int) -> bytes:
    """Send a request, and return the body of the reply. The exceptions are those of `post`."""
    opener = urllib.request.build_opener(_NoRedirect, handler)
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
        retry = error.code in (408, 409, 425, 429) or error.code >= 500
        raise RequestError(reason, _seconds(error.headers.get("Retry-After")), retry=retry) from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        late = handler.closed or isinstance(getattr(error, "reason", error), TimeoutError)
        reason = str(getattr(error, "reason", None) or error) or type(error).__name__
        raise RequestError(LATE.format(seconds) if late else reason) from None
    if handler.closed:
        # Without a length, a reply that is cut looks complete.
        raise RequestError(LATE.format(seconds))
    if len(text) > most:
        raise RequestError(f"the reply is longer than {most >> 20} MiB")
    return text


def _seconds(header: str | None) -> float | None:
    """Parse a Retry-After header as seconds. Return `None` for a date, or if it is not a number."""
    try:
        wait = float(header or "")
    except ValueError:
        return None
    return min(wait, PAUSE_MAX) if wait >= 0 else None
