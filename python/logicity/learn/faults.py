"""Errors of YAML files that pydantic validates, with their places, and the schemas of such files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

from ..errors import extra

with extra("learn"):
    from pydantic import ValidationError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

__all__ = ["Fault", "contains", "faults", "merged", "tidy"]

#: An error in a YAML file: its code, the path of keys to the value, the message, and the help, which may be empty.
Fault: TypeAlias = tuple[str, list[str], str, str]

#: Returns the message and the help for the path of an unknown key.
Unknown: TypeAlias = Callable[[tuple[str, ...]], tuple[str, str]]


def contains(values: Mapping[str, Any], path: Sequence[str]) -> bool:
    """Return whether values have a path of keys, or a value other than a mapping on the way to it."""
    for key in path:
        if not isinstance(values, Mapping):
            return True
        if key not in values:
            return False
        values = values[key]
    return bool(path)


def merged(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with changes. Mappings merge key by key; any other value replaces the old one."""
    result = dict(values)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def tidy(schema: Any, definitions: Mapping[str, Any]) -> Any:
    """Return a part of a schema without line breaks, references and the titles that pydantic makes from names.

    The definitions take the place of references to them.
    """
    if isinstance(schema, dict):
        if "$ref" in schema:
            rest = {key: value for key, value in schema.items() if key != "$ref"}
            return tidy({**definitions[schema["$ref"].rpartition("/")[2]], **rest}, definitions)
        kept = {key: value for key, value in schema.items() if key != "title" or not isinstance(value, str)}
        return {key: tidy(value, definitions) for key, value in kept.items()}
    if isinstance(schema, str):
        return " ".join(schema.split())
    return [tidy(value, definitions) for value in schema] if isinstance(schema, list) else schema


def faults(error: ValidationError, unknown: Unknown, depth: int = 2) -> list[Fault]:
    """Return all errors of pydantic, which may append the name of an alternative to a path after `depth` keys."""
    by_key: dict[tuple[str, ...], list[ErrorDetails]] = {}
    found = error.errors(include_url=False)
    # The paths of values with an error in an element. Pydantic counts only their valid elements.
    faulty = {each["loc"][:end] for each in found for end in range(len(each["loc"]))}
    for each in found:
        if each["type"] == "too_short" and each["loc"] in faulty:
            continue
        # The alternatives of a union report errors about the value, not the key, and append their names to the path.
        where, about_key = each["loc"], each["type"] in ("extra_forbidden", "missing")
        more = len(where) > depth and (isinstance(where[depth], int) or about_key)
        by_key.setdefault(tuple(map(str, where[: depth + more])), []).append(each)
    return [_fault(path, errors, unknown) for path, errors in by_key.items()]


def _fault(path: tuple[str, ...], errors: Sequence[ErrorDetails], unknown: Unknown) -> Fault:
    first, name, kind = errors[0], ".".join(path), errors[0]["type"]
    if kind == "extra_forbidden":
        return "unknown-key", list(path), *unknown(path)
    if kind == "missing":
        return "missing-key", list(path), f"the key `{name}` is missing", ""
    if kind == "custom":
        message = first["msg"]
    elif kind in ("value_error", "assertion_error"):
        message = f"`{name}`: {first['ctx']['error']}"
    else:
        expected = " or ".join(dict.fromkeys(map(_expected, errors)))
        message = f"`{name}` must be {expected}, not `{_shown(first['input']):.40}`"
    return "invalid-value", list(path), message, ""


def _shown(value: object) -> str:
    """Return a value as a YAML file can contain it. Only strings that YAML reads as other values have quotes."""
    if not isinstance(value, str):
        return json.dumps(value, default=repr)
    try:
        float(value)
    except ValueError:
        return json.dumps(value) if value.lower() in ("", "~", "null", "true", "false") else value
    return json.dumps(value)


#: What a value must be, by the type of pydantic's error, with the bounds of the error.
_EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a mapping",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_from_float": "an integer",
    "int_type": "an integer",
    "list_type": "a list",
    "model_type": "a mapping",
    "none_required": "null (~)",
    "string_type": "text",
    "tuple_type": "a list",
    "greater_than": "greater than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "too_short": "a list of {min_length} or more values",
    "too_long": "a list of at most {max_length} values",
}


def _expected(error: ErrorDetails) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind == "too_short" and context["field_type"] == "Dictionary":
        return f"a mapping with {context['min_length']} or more keys"
    if kind in _EXPECTED:
        return _EXPECTED[kind].format(**context)
    if kind == "literal_error":
        return str(context["expected"]).replace("'", "`")
    return f"valid ({error['msg']})"
