"""Removal of secrets from the text of others: whole ones, parts of them, and their usual encodings."""

from __future__ import annotations

import base64
import html
import re
from array import array
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import parse_qsl, urlsplit

__all__ = ["Redactor", "is_secret_name", "masked", "shown_url"]

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

_NAMES = re.compile(r"key|token|secret|password|passwd|auth|credential|signature|^sig$|^code$", flags=re.IGNORECASE)
#: An escape of JSON, of source code, of URLs or of HTML.
_ESCAPE = re.compile(
    r"%[0-9a-f]{2}|\\u\{?[0-9a-f]{1,6}\}?|\\x[0-9a-f]{2}|\\[\"'/\\]|&#x?[0-9a-f]{1,6};|&(?:amp|quot|apos|lt|gt);",
    flags=re.IGNORECASE,
)
_LOWER = {upper: upper + 32 for upper in range(ord("A"), ord("Z") + 1)}
#: The alphabet of base64 for URLs as the usual one.
_USUAL = {ord("-"): "+", ord("_"): "/"}


def is_secret_name(name: str) -> bool:
    """Return whether the name of a setting or parameter says that its value is a secret."""
    return _NAMES.search(name) is not None


def _secret_settings(settings: object, named: bool = False) -> Iterable[str]:
    """Yield the texts in settings whose names say that they are secrets."""
    if isinstance(settings, Mapping):
        for name, value in settings.items():
            yield from _secret_settings(value, named or is_secret_name(str(name)))
    elif isinstance(settings, (list, tuple)):
        for value in settings:
            yield from _secret_settings(value, named)
    elif named and isinstance(settings, str) and len(settings) >= SETTING:
        yield settings


def masked(settings: Any, named: bool = False) -> Any:
    """Return a copy of settings for results: a mark stands in place of each secret."""
    if isinstance(settings, Mapping):
        return {name: masked(value, named or is_secret_name(str(name))) for name, value in settings.items()}
    if isinstance(settings, (list, tuple)):
        return [masked(value, named) for value in settings]
    return MARK if named and isinstance(settings, str) and len(settings) >= SETTING else settings


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

    Args:
        key: The bearer token.
        url: The URL. The values of parameters such as `api_key` are secrets.
        settings: The settings of the request. The values of names such as `api_key` are secrets.
        known: Text that is no secret, such as the questions. Parts of secrets that occur in it stay.
    """

    def __init__(self, key: str | None, url: str, settings: Mapping[str, Any], known: str = "") -> None:
        """Compute the parts of all secrets."""
        query = parse_qsl(urlsplit(url).query)
        secrets = {key} if key else set()
        secrets |= {value for name, value in query if is_secret_name(name) and len(value) >= SETTING}
        secrets |= set(_secret_settings(settings))
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
        found: list[tuple[int, int]] = []
        for view, places in views:
            for parts, searched in ((self._plain, view.translate(_LOWER)), (self._base64, view.translate(_USUAL))):
                found += [(places[start], places[end]) for start, end in _occurrences(parts, searched)]
        shown: list[str] = []
        end = 0
        for start, stop in sorted(found):
            if start > end or not shown:
                shown += [text[end:start], MARK]
            end = max(end, stop)
        return "".join([*shown, text[end:]])


def _parts(secret: str, size: int) -> Iterable[str]:
    """Yield the parts of a secret with a length, or the secret if it is shorter."""
    size = min(size, len(secret))
    return (secret[at : at + size] for at in range(len(secret) - size + 1))


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


def _by_size(parts: Iterable[str]) -> dict[int, set[str]]:
    sizes: dict[int, set[str]] = {}
    for part in parts:
        sizes.setdefault(len(part), set()).add(part)
    return sizes


def _occurrences(parts: Mapping[int, set[str]], text: str) -> Iterable[tuple[int, int]]:
    """Yield where parts, which are given by their length, occur in a text."""
    for size, known in parts.items():
        for at in range(len(text) - size + 1):
            if text[at : at + size] in known:
                yield at, at + size


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
