"""Training configurations: YAML files that name a learner, a mode and settings."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, cast

from .. import _logicity
from ..envs.config import EnvConfig
from ..errors import InputError, did_you_mean, extra

with extra("learn"):
    from pydantic import ValidationError, ValidationInfo, field_validator
    from pydantic_core import PydanticCustomError

from ..modes import ENVIRONMENTS, checked_mode
from .faults import Fault, contains, faults, merged, tidy
from .learner import Learner
from .registry import LEARNERS, learner_class
from .settings import LearnerSettings, Training

__all__ = ["TrainConfig", "faults_of_overrides", "located", "unused"]


class TrainConfig(Training):
    """The configuration of a training run. `logicity schema training` prints the schema of its YAML files.

    Keys that the learner does not use are errors.
    """

    @field_validator("algorithm", "mode")
    @classmethod
    def _known(cls, name: str, info: ValidationInfo) -> str:
        if info.field_name == "algorithm" and name not in LEARNERS:
            raise _custom(f"unknown learner `{name}`{did_you_mean(name, LEARNERS)}")
        try:
            return checked_mode(name) if info.field_name == "mode" else name
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

    @field_validator("observation", "steps", "overrides", "envs", "episodes", "demonstrations", "start")
    @classmethod
    def _fits_learner(cls, value: Any, info: ValidationInfo) -> Any:
        algorithm, key = info.data.get("algorithm"), str(info.field_name)
        if algorithm is None or value is None:
            return value
        learner = learner_class(algorithm)
        if key == "observation" and value not in learner.observations:
            names = " or ".join(f"`{name}`" for name in learner.observations)
            raise _custom(f"`{algorithm}` takes observations of the kind {names}, not `{value}`")
        if key == "steps" and learner.only_steps not in (None, value):
            raise _custom(f"`steps` must be {learner.only_steps} for `{algorithm}`, not `{value}`")
        if reason := unused(algorithm).get(key):
            raise _custom(f"`{algorithm}` does not use the key `{key}`: {reason}")
        return value

    @property
    def learner(self) -> type[Learner]:
        """The class of the learner."""
        return learner_class(self.algorithm)

    def to_dict(self) -> dict[str, Any]:
        """Return the keys that the learner uses, for JSON. `TrainConfig(**config.to_dict())` equals `config`."""
        return self.model_dump(mode="json", exclude=set(unused(self.algorithm)))

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON Schema of YAML files. No key is required, since the file that `base` names may contain it."""
        schema = cls.model_json_schema()
        keys = tidy(schema["properties"], schema["$defs"])
        keys["algorithm"] = {"enum": list(LEARNERS), "description": keys["algorithm"]["description"]}
        keys["settings"] = {"type": "object", "default": {}, "description": keys["settings"]["description"]}
        learners = {name: learner_class(name) for name in LEARNERS}
        rule = "Path of a file to start from. Mappings merge key by key; any other value replaces that of the base."
        base = {"type": "string", "description": rule}
        return {
            "$schema": "https://json-schema.org/draft/2020-12/schema",
            "title": "A training configuration",
            "type": "object",
            "additionalProperties": False,
            "properties": {"base": base, **keys},
            "allOf": [
                {
                    "if": {"properties": {"algorithm": {"const": name}}, "required": ["algorithm"]},
                    "then": {
                        "properties": {
                            "settings": {"$ref": f"#/$defs/{name}"},
                            "observation": {"enum": list(learner.observations)},
                            **({} if learner.only_steps is None else {"steps": {"const": learner.only_steps}}),
                            **{key: False for key in unused(name)},
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
        rejected: Callable[[list[Fault]], BaseException] | None = None,
    ) -> TrainConfig:
        """Read a YAML file.

        The key `base` names another file, relative to this file. Its mappings are merged with those of this file. A
        bare name such as `dqn-easy` is a built-in configuration.

        Args:
            path: The file.
            seed: A seed that replaces the seed in the file.
            changes: Values that replace those in the file. Mappings merge key by key.
            rejected: Receives the errors in `changes` and returns the exception to raise, which can name the origin of
                the changes. By default, they are errors of the file.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key. The diagnostics
                list all errors.
            Exception: The result of `rejected`.
            OSError: If a file cannot be read.
        """
        file = _logicity.ConfigFile(path, "configs/baselines")
        values = file.value()
        if not isinstance(values, dict):
            raise file.error([("invalid-value", [], "a training configuration must be a mapping", "")])
        for key in ("mode", "start"):
            name = values.get(key)
            if isinstance(name, str) and not (key == "mode" and name in ENVIRONMENTS):
                # As in run configurations, a path is relative to its file, or names a built-in file.
                at = Path(file.file_of([key]) or path).parent / name
                if at.exists():
                    values[key] = str(at.resolve())
                elif key == "start" or (at.suffix and name not in {f"configs/{mode}.yaml" for mode in ENVIRONMENTS}):
                    raise file.error([("missing-file", [key], f"cannot read `{at}`: no such file", "")])
        values = merged(values, changes or {})
        if seed is not None:
            values["seed"] = seed
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            wrong = faults(error, partial(_unknown_key, values.get("algorithm")))
            changed = [each for each in wrong if contains(changes or {}, each[1])]
            raise (rejected(changed) if rejected is not None and changed else file.error(wrong)) from None


def located(path: str | os.PathLike[str], config: TrainConfig, error: ValueError) -> ValueError:
    """Return an error of a training run as an `InputError` with its location in the YAML file of the configuration.

    The location is the first key that the message names between backticks or before a colon. An error in `overrides` is
    at the overridden key. If the message names no key of the file, the error names the file.
    """
    file = _logicity.ConfigFile(path, "configs/baselines")
    if isinstance(error, InputError):
        known = faults_of_overrides(config, error)
        # Other errors are in other files, and have a location there.
        return error if known is None else cast(InputError, file.error(known))
    message = str(error)
    named = [(quoted or first).split(".") for quoted, first in re.findall(r"`([\w.]+)`|^(\w+)(?=:)", message)]
    key = next((each for each in named if each[0] in TrainConfig.model_fields), None)
    if key is None:
        return ValueError(f"{os.fspath(path)}: {message}")
    if key == ["settings"]:
        key += next((each for each in named if each[0] in type(config.settings).model_fields), [])
    return cast(InputError, file.error([("invalid-value", key, message, "")]))


def faults_of_overrides(config: TrainConfig, error: InputError) -> list[Fault] | None:
    """Return the faults of an error in `overrides`, or `None` if a fault is elsewhere."""
    document = json.loads(EnvConfig(config.mode, overrides=config.overrides)._as_json({}) or "{}")
    found: list[Fault] = []
    for fault in error.diagnostics:
        label = next(iter(fault["labels"]), None)
        if label is None or label["file"] != "<overrides>":
            return None
        path = ["overrides", *_path_at(document, label["column"] - 1)]
        found.append((fault["code"], path, fault["message"], "; ".join([*fault["notes"], *fault["help"]])))
    return found


def _path_at(value: Any, column: int, start: int = 0) -> list[str]:
    """Return the path of the key or value at a column of `json.dumps(value)`, which starts at the column `start`."""
    at = start + 1
    for key, each in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        begin = at + len(f"{json.dumps(key)}: ") * isinstance(value, dict)
        end = begin + len(json.dumps(each))
        if column < end:
            return [str(key), *(_path_at(each, column, begin) if column >= begin else [])]
        at = end + len(", ")
    return []


def unused(algorithm: str) -> dict[str, str]:
    """Return the keys that a learner does not use, with the reason."""
    learner = learner_class(algorithm)
    if learner.interacts:
        keys = {"demonstrations": "it learns in environments, not from demonstrations"}
    else:
        keys = dict.fromkeys(("overrides", "envs", "episodes"), "it learns from demonstrations, not in environments")
    return keys if learner.starts else {**keys, "start": "its training cannot start from a policy"}


def _settings_schema(name: str, settings: type[LearnerSettings]) -> dict[str, Any]:
    schema = settings.model_json_schema()
    return {
        "title": f"Settings of `{name}`",
        "type": "object",
        "additionalProperties": False,
        "properties": tidy(schema.get("properties", {}), schema.get("$defs", {})),
    }


def _custom(message: str) -> PydanticCustomError:
    return PydanticCustomError("custom", "{message}", {"message": message})


def _unknown_key(algorithm: object, path: tuple[str, ...]) -> tuple[str, str]:
    """Return the message and the help for the path of an unknown key."""
    # The settings are checked only for a known learner.
    is_known = isinstance(algorithm, str) and algorithm in LEARNERS
    settings = list(learner_class(str(algorithm)).settings_class.model_fields) if is_known else []
    name = path[-1]
    if len(path) == 1:
        known, message = list(TrainConfig.model_fields), f"unknown key `{name}`"
        elsewhere = f"`{name}` is a setting of `{algorithm}`: write it under `settings`" * (name in settings)
    else:
        known, message = settings, f"`{algorithm}` has no setting `{name}`"
        elsewhere = f"`{name}` is a key beside `settings`, not in it" * (name in TrainConfig.model_fields)
    return message, elsewhere or did_you_mean(name, known).removeprefix("; ")
