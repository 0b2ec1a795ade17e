"""Removal of secrets from the text of others: whole ones, parts of them, and their usual encodings."""

from __future__ import annotations

import base64
import html
import re
from array import array
from collections.abc import Callable, Iterable, Mapping
from itertools import groupby
from typing import Any
from urllib.parse import parse_qsl, urlsplit

__all__ = ["Redactor", "masked", "shown_url"]

#: What stands in place of a secret.
MARK = "[secret]"
#: The length of the shortest part of a secret that is removed, in characters. A shorter secret is removed as a whole.
PART = 8
#: The length of the shortest part of an encoded secret that is removed: as many characters encode `PART` bytes.
BASE64_PART, HEX_PART = 10, 16
#: How often an encoded text can be encoded again.
DEPTH = 3
#: The length of the shortest value of a setting or a query that counts as a secret, in characters.
SETTING = 6

#: The names of settings and parameters whose values are secrets.
_NAMES = re.compile(r"key|token|secret|password|passwd|auth|credential|signature|^sig$|^code$", flags=re.IGNORECASE)
#: An escape of JSON, of source code, of URLs or of HTML.
_ESCAPE = re.compile(
    r"%[0-9a-f]{2}|\\u\{?[0-9a-f]{1,6}\}?|\\x[0-9a-f]{2}|\\[\"'/\\]|&#x?[0-9a-f]{1,6};|&(?:amp|quot|apos|lt|gt);",
    flags=re.IGNORECASE,
)
_LOWER = {upper: upper + 32 for upper in range(ord("A"), ord("Z") + 1)}
#: The alphabet of base64 for URLs as the usual one.
_USUAL = {ord("-"): "+", ord("_"): "/"}


def masked(settings: Any, named: bool = False, found: Callable[[str], object] = lambda secret: None) -> Any:
    """Return a copy of settings for results: a mark stands in place of each secret, which `found` receives."""
    if isinstance(settings, Mapping):
        return {name: masked(value, named or bool(_NAMES.search(str(name))), found) for name, value in settings.items()}
    if isinstance(settings, (list, tuple)):
        return [masked(value, named, found) for value in settings]
    if not named or not isinstance(settings, str) or len(settings) < SETTING:
        return settings
    found(settings)
    return MARK


def shown_url(url: str) -> str:
    """Return a URL for messages: without a user name, password, query and fragment, which may be secrets."""
    scheme, slashes, rest = re.split(r"[?#]", url, maxsplit=1)[0].partition("://")
    if not slashes:
        return MARK if "@" in url else scheme
    authority, slash, path = rest.partition("/")
    return f"{scheme}://{authority.rpartition('@')[2]}{slash}{path}"


class Redactor:
    """Removes the secrets of a request from what its server returns.

    A server can return a key in a message, in a header, or encoded. Each part of a secret of at least `PART` characters
    is removed, also if case differs, and if it is escaped as in JSON, URLs and HTML, or encoded as base64 or hex.

    The key is a secret, and so are the values of parameters of the URL and of settings with names such as `api_key`.
    Parts of secrets that occur in `known`, such as in the questions, stay.
    """

    def __init__(self, key: str | None, url: str, settings: Mapping[str, Any], known: str = "") -> None:
        """Compute the parts of all secrets."""
        secrets = {key} if key else set()
        masked([{name: value} for name, value in parse_qsl(urlsplit(url).query)], found=secrets.add)
        masked(settings, found=secrets.add)
        public = known.translate(_LOWER)
        plain = {part for each in secrets for part in _parts(each.translate(_LOWER), PART) if part not in public}
        plain |= {part for each in secrets if len(each) >= PART // 2 for part in _parts(each.encode().hex(), HEX_PART)}
        self._plain = _by_size(plain)
        self._base64 = _by_size({part for each in secrets for part in _base64_parts(each)})

    def __call__(self, text: str) -> str:
        """Return a text with a mark in place of each secret."""
        views = [(text, array("q", range(len(text) + 1)))]
        while len(views) <= DEPTH and _ESCAPE.search(views[-1][0]):
            views.append(_decoded(*views[-1]))
        secret = bytearray(len(text))
        for view, places in views:
            for parts, searched in ((self._plain, view.translate(_LOWER)), (self._base64, view.translate(_USUAL))):
                for size, known in parts.items():
                    for at in range(len(searched) - size + 1):
                        if searched[at : at + size] in known:
                            start, end = places[at], places[at + size]
                            secret[start:end] = b"x" * (end - start)
        shown: list[str] = []
        end = 0
        for found in re.finditer(b"x+", secret):
            shown += [text[end : found.start()], MARK]
            end = found.end()
        return "".join([*shown, text[end:]])


def _parts(secret: str, size: int) -> Iterable[str]:
    """Yield the parts of a secret with a length, or the secret if it is shorter."""
    size = min(size, len(secret))
    return (secret[at : at + size] for at in range(len(secret) - size + 1))


def _by_size(parts: Iterable[str]) -> dict[int, set[str]]:
    return {size: set(group) for size, group in groupby(sorted(parts, key=len), len)}


def _base64_parts(secret: str) -> Iterable[str]:
    """Yield the parts of the base64 encodings of all texts that contain a secret, and those of headers with it."""
    for text in (secret, f"Bearer {secret}"):
        yield base64.b64encode(text.encode()).decode().rstrip("=")
    for before in range(3):
        encoded = base64.b64encode(b"\0" * before + secret.encode()).decode()
        # Only characters all of whose bits are bits of the secret.
        inside = encoded[-(-before * 8 // 6) : (before + len(secret.encode())) * 8 // 6]
        if len(inside) >= BASE64_PART // 2:
            yield from _parts(inside, BASE64_PART)


def _decoded(text: str, places: array[int]) -> tuple[str, array[int]]:
    """Return a text with characters in place of escapes, and where each of its characters begins in the original."""
    shown: list[str] = []
    begins = array("q")
    end = 0
    for escape in _ESCAPE.finditer(text):
        shown += [text[end : escape.start()], _character(escape[0])]
        begins.extend(places[end : escape.start() + 1])
        end = escape.end()
    begins.extend(places[end:])
    return "".join([*shown, text[end:]]), begins


def _character(escape: str) -> str:
    """Return the character of an escape; secrets are ASCII, so any other character has a placeholder."""
    if escape[0] == "&":
        decoded = html.unescape(escape)
        return decoded if len(decoded) == 1 else "\0"
    if escape[0] == "\\" and escape[1] in "\"'/\\":
        return escape[1]
    code = int(escape.strip("%\\uxUX{}") or "0", 16)
    return chr(code) if code < 0x80 else "\0"
