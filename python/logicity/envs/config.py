"""The configuration shared by all environment classes. This module does not need gymnasium."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np

from .. import _logicity
from ..errors import checked_limits, checked_path, did_you_mean
from ..predicates import PythonPredicate, functions_of
from ..rules import rule_file
from ..types import ArrayKind, EnvOptions, Limits, ObservationKind, Split

__all__ = ["EnvConfig", "array_kind", "checked_kind", "to_json"]


class EnvConfig:
    """A run configuration with its overrides, a split, and a kind of observation. `SPFEnv` documents the options.

    Errors about unknown options list those of `env_class`.

    Raises:
        TypeError: If an option is unknown, or has a wrong type.
        ValueError: If the kind of observation is unknown, `rules` is source text instead of a path, the overrides
            contain the key `base`, or a limit is unknown or out of range.
    """

    def __init__(
        self,
        config: str | os.PathLike[str],
        env_class: type | None = None,
        *,
        split: Split = "train",
        rules: str | os.PathLike[str] | None = None,
        overrides: Mapping[str, Any] | None = None,
        observation: ObservationKind = "groundings",
        limits: Limits | None = None,
        oracle: bool = True,
        action_masks: bool = False,
        predicates: Iterable[PythonPredicate] | None = None,
        **unknown: Any,
    ) -> None:
        """Check and store the arguments."""
        if unknown:
            name = next(iter(unknown))
            parameters = signature(env_class).parameters.values() if env_class else ()
            known = [*EnvOptions.__annotations__, *(each.name for each in parameters if each.kind is each.KEYWORD_ONLY)]
            # Libraries such as TorchRL look for Python's own words to learn which arguments exist.
            of = f"{env_class.__name__}() " if env_class else ""
            raise TypeError(f"{of}got an unexpected keyword argument '{name}'{did_you_mean(name, known)}")
        self.config, self.split, self.observation = checked_path("config", config), split, checked_kind(observation)
        for name, value in {"oracle": oracle, "action_masks": action_masks}.items():
            if not isinstance(value, (bool, np.bool_)):
                raise TypeError(f"{name}: expected bool, not {type(value).__name__}")
        if not isinstance(split, str):
            raise TypeError(f"split: expected str, not {type(split).__name__}")
        self.oracle, self.action_masks = bool(oracle), bool(action_masks)
        self.rules, self.limits = rule_file(rules), checked_limits(limits)
        self.predicates = functions_of(predicates)
        if overrides is not None and not isinstance(overrides, Mapping):
            raise TypeError(f"overrides: expected a mapping, not {type(overrides).__name__}")
        self.overrides = dict(overrides or {})
        if "base" in self.overrides:
            raise ValueError("`overrides` must not contain `base`: the argument `config` is the base")

    def task(self, rules: str | os.PathLike[str] | None = None, **more: Any) -> _logicity.Task:
        """Load the task, with another rule file or overrides. Raise `InputError` if any of its sources is invalid."""
        chosen = self.rules if rules is None else rule_file(rules)
        return _logicity.Task(self.config, chosen, self._as_json(more), self.limits, None, self.predicates)

    def shield_task(self, rules: str | os.PathLike[str]) -> _logicity.Task:
        """Load the task with the rules of a shield. Raise `InputError` if any of its sources is invalid."""
        task = dict(self.overrides.get("task") or {})
        # Clauses have other labels, and the rules need not fit the shield of the configuration.
        task |= {"reward": {**(task.get("reward") or {}), "clauses": None}, "shield": None}
        return self.task(rules, task=task)

    def _as_json(self, more: Mapping[str, Any]) -> str | None:
        """Return the configuration with its overrides as JSON, or `None` without overrides."""
        overrides, base = {**self.overrides, **more}, Path(self.config)
        if len(base.parts) == 1 and not base.suffix and not base.exists():
            base = Path("configs") / f"{base}.yaml"
        return json.dumps({"base": base.as_posix(), **overrides}, default=to_json) if overrides else None


def checked_kind(kind: str) -> ObservationKind:
    """Return a kind of observation. Raise `ValueError` if it is unknown."""
    if kind not in (known := get_args(ObservationKind)):
        names = ", ".join(f'"{name}"' for name in known)
        raise ValueError(f"observation must be one of {names}, not {kind!r}")
    return cast(ObservationKind, kind)


def array_kind(kind: ObservationKind) -> ArrayKind:
    """Return the kind of array from which observations are made: `groundings` for views, else the kind itself."""
    return "state" if kind == "state" else "groundings"


def to_json(value: Any) -> Any:
    """Convert numpy scalars, numpy arrays and paths to JSON values."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a configuration cannot hold a {type(value).__name__}: {value!r}")
