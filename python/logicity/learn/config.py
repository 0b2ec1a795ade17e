"""Training configurations: YAML files that name a learner, a mode and settings."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from .. import _logicity
from ..env_config import ArrayKind, EnvOptions, Episodes
from ..errors import did_you_mean, missing_extra

try:
    from pydantic import (
        BaseModel,
        ConfigDict,
        Field,
        SerializeAsAny,
        ValidationError,
        ValidationInfo,
        field_validator,
    )
    from pydantic_core import PydanticCustomError
except ImportError as error:
    raise missing_extra("learn", error) from error

from ..modes import ENVIRONMENTS, checked_mode
from .learner import Count, Learner, LearnerSettings, Seed
from .registry import LEARNERS, learner_class

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

__all__ = ["TrainConfig", "faults", "merged"]


class TrainingOptions(EnvOptions):
    """The options of training environments."""

    episodes: Episodes


class TrainConfig(BaseModel):
    """The configuration of a training run. `logicity schema training` prints the schema of its YAML files.

    Keys that the learner does not use are errors.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    algorithm: str
    """The name of the learner."""
    mode: str
    """The mode, or the path of a configuration file, which determines the rules and the episodes. In a YAML file, a
    path is relative to the folder of that file."""
    observation: ArrayKind = "groundings"
    """The kind of observation: `groundings` or `state`, as in `gymnasium.make`. Learners over entities compute their
    tensors and graphs from `groundings`."""
    settings: SerializeAsAny[LearnerSettings] = Field(default_factory=LearnerSettings, validate_default=True)
    """The settings of the learner."""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """Changes to the configuration for training. Validation and test use the mode without overrides. For learners that
    step environments."""
    steps: Count = 200_000
    """The number of training steps: steps of all environments together, or updates of a learner from demonstrations.
    Only `steps` may change when a run resumes."""
    envs: Count = 1
    """The number of parallel environments. For learners that step environments."""
    episodes: Episodes = "drawn"
    """The training episodes, as in `gymnasium.make`. For learners that step environments."""
    demonstrations: Annotated[float, Field(strict=True, gt=0, le=1)] = 1.0
    """The share of the recorded training episodes whose demonstrations are used. For learners from demonstrations."""
    start: str | None = None
    """The file of a policy of the same learner. Training starts from its weights. In a YAML file, a path is relative to
    the folder of that file. For neural learners."""
    seed: Seed = 0
    """The seed of networks, exploration and episodes."""
    validate_every: Count = 10_000
    """The number of steps between validations. Each validation writes a checkpoint."""
    threads: Count = 1
    """The number of PyTorch threads."""

    def env_options(self) -> TrainingOptions:
        """Return the options of the training environments."""
        return TrainingOptions(
            split="train", episodes=self.episodes, overrides=self.overrides, observation=self.observation
        )

    @field_validator("algorithm")
    @classmethod
    def _known_algorithm(cls, name: str) -> str:
        if name not in LEARNERS:
            raise _custom(f"unknown learner `{name}`{did_you_mean(name, LEARNERS)}")
        return name

    @field_validator("mode")
    @classmethod
    def _known_mode(cls, name: str) -> str:
        try:
            return checked_mode(name)
        except ValueError as error:
            raise _custom(str(error)) from None

    @field_validator("settings", mode="before")
    @classmethod
    def _valid_settings(cls, settings: Any, info: ValidationInfo) -> Any:
        algorithm = info.data.get("algorithm")
        if algorithm is None:
            # The validation of `algorithm` has reported an error already.
            return LearnerSettings()
        expected = learner_class(algorithm).settings_class
        if isinstance(settings, LearnerSettings) and not isinstance(settings, expected):
            settings = settings.model_dump()
        return expected.model_validate(settings)

    @field_validator("observation")
    @classmethod
    def _usable_observation(cls, kind: ArrayKind, info: ValidationInfo) -> ArrayKind:
        algorithm = info.data.get("algorithm")
        usable = (kind,) if algorithm is None else learner_class(algorithm).observations
        if kind not in usable:
            names = " or ".join(f"`{name}`" for name in usable)
            raise _custom(f"`{algorithm}` takes observations of the kind {names}, not `{kind}`")
        return kind

    @field_validator("overrides", "envs", "episodes", "demonstrations", "start")
    @classmethod
    def _used_key(cls, value: Any, info: ValidationInfo) -> Any:
        algorithm, key = info.data.get("algorithm"), str(info.field_name)
        if algorithm is not None and value is not None and (reason := _unused(algorithm).get(key)):
            raise _custom(f"`{algorithm}` does not use the key `{key}`: {reason}")
        return value

    @property
    def learner(self) -> type[Learner]:
        """The class of the learner."""
        return learner_class(self.algorithm)

    def to_dict(self) -> dict[str, Any]:
        """Return the keys that the learner uses, for JSON. `TrainConfig(**config.to_dict())` equals `config`."""
        unused = _unused(self.algorithm)
        return {key: value for key, value in self.model_dump(mode="json").items() if key not in unused}

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON Schema of YAML files. No key is required, since the file that `base` names may contain it."""
        keys = {key: _tidy(value) for key, value in cls.model_json_schema()["properties"].items()}
        keys["algorithm"] = {"enum": list(LEARNERS), "description": keys["algorithm"]["description"]}
        keys["settings"] = {"type": "object", "default": {}, "description": keys["settings"]["description"]}
        learners = {name: learner_class(name) for name in LEARNERS}
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": "A training configuration",
            "type": "object",
            "additionalProperties": False,
            "properties": {
                "base": {
                    "type": "string",
                    "description": "Path of a file to start from. Mappings merge key by key; any other value replaces "
                    "that of the base.",
                },
                **keys,
            },
            "allOf": [
                {
                    "if": {"properties": {"algorithm": {"const": name}}, "required": ["algorithm"]},
                    "then": {
                        "properties": {
                            "settings": {"$ref": f"#/$defs/{name}"},
                            "observation": {"enum": list(learner.observations)},
                            **{key: False for key in _unused(name)},
                        }
                    },
                }
                for name, learner in learners.items()
            ],
            "$defs": {name: _settings_schema(name, learner.settings_class) for name, learner in learners.items()},
        }

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        seed: int | None = None,
        changes: Mapping[str, Any] | None = None,
    ) -> TrainConfig:
        """Read a YAML file.

        The key `base` names another file, relative to this file. Its mappings are merged with those of this file. A
        bare name such as `dqn-easy` is a built-in configuration.

        Args:
            path: The file.
            seed: A seed that replaces the seed in the file.
            changes: Values that replace those in the file. Mappings merge key by key.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key. The diagnostics
                list all errors.
            OSError: If a file cannot be read.
        """
        file = _logicity.ConfigFile(path, "configs/baselines")
        values = file.value()
        if not isinstance(values, dict):
            raise file.error([("invalid-value", [], "a training configuration must be a mapping", "")])
        for key in ("mode", "start"):
            name = values.get(key)
            if isinstance(name, str) and not (key == "mode" and name in ENVIRONMENTS):
                values[key] = _named_file(file, key, name, Path(file.file_of([key]) or path).parent)
        values = merged(values, changes or {})
        if seed is not None:
            values["seed"] = seed
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise file.error(faults(error, _unknown_key(values.get("algorithm")))) from None


def merged(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with changes. Mappings merge key by key; any other value replaces the old one."""
    result = dict(values)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return result


def _unused(algorithm: str) -> dict[str, str]:
    """Return the keys that a learner does not use, with the reason."""
    learner = learner_class(algorithm)
    unused = {}
    if learner.interacts:
        unused["demonstrations"] = "it learns in environments, not from demonstrations"
    else:
        unused |= dict.fromkeys(("overrides", "envs", "episodes"), "it learns from demonstrations, not in environments")
    if not learner.starts:
        unused["start"] = "its training cannot start from a policy"
    return unused


def _named_file(file: _logicity.ConfigFile, key: str, name: str, folder: Path) -> str:
    """Return the absolute path of a file that a key names, or the name if it is that of a built-in mode or of no file.

    As in run configurations, a path is relative to the folder of the file that contains it, or names a built-in file.

    Raises:
        InputError: If the path names no file.
    """
    at = folder / name
    if at.exists():
        return str(at.resolve())
    if key == "start" or (at.suffix and name not in _BUILTIN_MODES):
        raise file.error([("missing-file", [key], f"cannot read `{at}`: no such file", "")])
    return name


#: The paths of the modes among the built-in files.
_BUILTIN_MODES = {f"configs/{name}.yaml" for name in ENVIRONMENTS}


def _settings_schema(name: str, settings: type[LearnerSettings]) -> dict[str, Any]:
    """Return the schema of the settings of a learner."""
    schema = settings.model_json_schema()
    # Models within the settings become part of the schema, so it needs no definitions.
    properties = _inlined(schema.get("properties", {}), schema.get("$defs", {}))
    return {
        "title": f"Settings of `{name}`",
        "type": "object",
        "additionalProperties": False,
        "properties": {key: _tidy(value) for key, value in properties.items()},
    }


def _inlined(schema: Any, definitions: Mapping[str, Any]) -> Any:
    """Return a schema with the definitions in place of references to them."""
    if isinstance(schema, dict):
        if "$ref" in schema:
            rest = {key: value for key, value in schema.items() if key != "$ref"}
            return _inlined({**definitions[schema["$ref"].rpartition("/")[2]], **rest}, definitions)
        return {key: _inlined(value, definitions) for key, value in schema.items()}
    return [_inlined(value, definitions) for value in schema] if isinstance(schema, list) else schema


def _tidy(schema: Any) -> Any:
    """Return a part of a schema without the titles that pydantic makes from names and without line breaks."""
    if isinstance(schema, dict):
        return {key: _tidy(value) for key, value in schema.items() if key != "title" or not isinstance(value, str)}
    if isinstance(schema, str):
        return " ".join(schema.split())
    return [_tidy(value) for value in schema] if isinstance(schema, list) else schema


def _custom(message: str) -> PydanticCustomError:
    return PydanticCustomError("custom", "{message}", {"message": message})


def faults(
    error: ValidationError, unknown: Callable[[tuple[str, ...]], tuple[str, str]], depth: int = 2
) -> list[tuple[str, list[str], str, str]]:
    """Return the code, path, message and help of each error.

    Args:
        error: The errors of pydantic.
        unknown: Returns the message and the help for the path of an unknown key.
        depth: The number of keys after which pydantic may append the name of an alternative to a path.
    """
    by_key: dict[tuple[str, ...], list[ErrorDetails]] = {}
    for each in error.errors(include_url=False):
        # For a union, every alternative reports an error and appends its name to the path.
        where = each["loc"]
        more = len(where) > depth and (isinstance(where[depth], int) or each["type"] in _AT_KEYS)
        by_key.setdefault(tuple(map(str, where[: depth + more])), []).append(each)
    return [_fault(path, errors, unknown) for path, errors in by_key.items()]


#: The types of errors about a key, not about its value. They have no alternatives.
_AT_KEYS = ("extra_forbidden", "missing")


def _fault(
    path: tuple[str, ...], errors: Sequence[ErrorDetails], unknown: Callable[[tuple[str, ...]], tuple[str, str]]
) -> tuple[str, list[str], str, str]:
    first, name = errors[0], ".".join(path)
    if first["type"] == "extra_forbidden":
        return "unknown-key", list(path), *unknown(path)
    if first["type"] == "missing":
        return "missing-key", list(path), f"the key `{name}` is missing", ""
    if first["type"] == "custom":
        return "invalid-value", list(path), first["msg"], ""
    if first["type"] in ("value_error", "assertion_error"):
        return "invalid-value", list(path), f"`{name}`: {first['ctx']['error']}", ""
    expected = " or ".join(dict.fromkeys(map(_expected, errors)))
    shown = first["input"] if isinstance(first["input"], str) else json.dumps(first["input"], default=repr)
    return "invalid-value", list(path), f"`{name}` must be {expected}, not `{shown:.40}`", ""


def _unknown_key(algorithm: object) -> Callable[[tuple[str, ...]], tuple[str, str]]:
    """Return a function from the path of an unknown key to its message and help."""
    settings: list[str] = []
    # The settings are checked only for a known learner.
    if isinstance(algorithm, str) and algorithm in LEARNERS:
        settings = list(learner_class(algorithm).settings_class.model_fields)

    def unknown(path: tuple[str, ...]) -> tuple[str, str]:
        name = path[-1]
        if len(path) == 1:
            known, message = list(TrainConfig.model_fields), f"unknown key `{name}`"
            elsewhere = f"`{name}` is a setting of `{algorithm}`: write it under `settings`" * (name in settings)
        else:
            known, message = settings, f"`{algorithm}` has no setting `{name}`"
            elsewhere = f"`{name}` is a key beside `settings`, not in it" * (name in TrainConfig.model_fields)
        return message, elsewhere or did_you_mean(name, known).removeprefix("; ")

    return unknown


#: What a value must be, by the type of pydantic's error.
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
}

#: As `_EXPECTED`, with the bound of the error.
_BOUNDS = {
    "greater_than": "greater than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "too_short": "a list of {min_length} or more values",
    "too_long": "a list of at most {max_length} values",
}


def _expected(error: ErrorDetails) -> str:
    """Describe the values that a key accepts."""
    kind, context = error["type"], error.get("ctx", {})
    if kind in _EXPECTED:
        return _EXPECTED[kind]
    if kind in _BOUNDS:
        return _BOUNDS[kind].format(**context)
    if kind == "literal_error":
        return str(context["expected"]).replace("'", "`")
    return f"valid ({error['msg']})"
