"""Policies made of rules: a rule file decides on observations of the kind `groundings`."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _logicity
from .envs.config import EnvConfig
from .errors import checked_path
from .files import write_text
from .modes import checked_mode
from .rules import rule_path
from .types import Limits

__all__ = ["RulePolicy", "rule_policies"]

#: The first line of the file of a saved policy: its format version, the learner and the mode.
HEADER: Final = re.compile(r"// logicity policy 1: (?P<algorithm>[\w-]+), (?P<mode>.+)")


class RulePolicy:
    """Rules as a policy for `evaluate` and for batches of observations.

    The rules see the facts of an observation: a fact holds if its number exceeds 0.5. Observations contain neither the
    number of entities nor the predicate `Sees`. The entities are the ego, those with a fact, and those before them, and
    each of them sees all of them. In the built-in modes every entity has a fact, so that the decisions equal those of
    `Inference` for the same scene. The configuration of the mode says which of several derived actions counts, and
    which action an ego without a derived action takes.

    A policy is picklable. It has no random choices and no memory.

    Args:
        path: The rule file, which may be a built-in one such as `expert`.
        mode: As for `Benchmark`. It determines the order of the numbers in an observation.
        overrides, limits: As for `Benchmark`.

    Raises:
        InputError: If the rules are invalid, use a predicate that the mode does not define, have probabilities, or read
            earlier ticks.
        OSError: If a file cannot be read.
        ValueError: If the mode is unknown.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        mode: str | os.PathLike[str],
        *,
        overrides: Mapping[str, Any] | None = None,
        limits: Limits | None = None,
    ) -> None:
        """Compile the rules."""
        self.mode = checked_mode(mode)
        name, text = _logicity.read_rules(rule_path("path", path))
        #: The text of the rule file.
        self.text = text
        self._task = EnvConfig(self.mode, rules=name, overrides=overrides, limits=limits).task()
        #: The number of numbers in an observation.
        self.width: int = self._task.shape("groundings")[0]
        # Rules that observations cannot decide are an error now, not at the first decision.
        self(np.empty((0, self.width), np.float32))

    @classmethod
    def from_text(
        cls,
        text: str,
        mode: str | os.PathLike[str],
        *,
        overrides: Mapping[str, Any] | None = None,
        limits: Limits | None = None,
    ) -> RulePolicy:
        """Return the policy of rules that are not in a file. They can include built-in rule files only.

        The arguments and exceptions are those of the class.
        """
        with TemporaryDirectory() as folder:
            path = Path(folder) / "rules.dl"
            path.write_text(text, encoding="utf-8", newline="\n")
            return cls(path, mode, overrides=overrides, limits=limits)

    def __repr__(self) -> str:
        """Show the mode."""
        return f"<{type(self).__name__} of {self.mode}>"

    def __call__(self, observations: ArrayLike) -> NDArray[np.int64]:
        """Return the actions that the rules choose, int64 (N,): 0 Slow, 1 Normal, 2 Fast, 3 Stop.

        Observations are numbers of shape (N, width), of the kind `groundings`.

        Raises:
            LimitError: If the rules derive too many rows.
            ValueError: If the shape is wrong.
        """
        array = np.ascontiguousarray(observations, np.float32)
        if array.ndim != 2 or array.shape[1] != self.width:
            expected = f"a batch of observations of `{self.mode}`, of shape (N, {self.width})"
            raise ValueError(f"expected {expected}, not an array of shape {array.shape}")
        return _logicity.decide(self._task, array)

    def predict(
        self, observation: ArrayLike, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.int64], None]:
        """Return the actions that the rules choose, and no state, as `logicity.learn.learner.Policy` does.

        The exceptions are those of a call.
        """
        return self(observation), None

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the rule file, atomically.

        Args:
            path: The file to write.
            overwrite: Whether to replace a file that this function did not write, or that has changed since.

        Raises:
            FileExistsError: If the file must not be replaced.
            OSError: If the file cannot be written.
        """
        write_text(path, self.text, by="RulePolicy.save", overwrite=overwrite)


def header(algorithm: str, mode: str) -> str:
    """Return the first line of the file of a learner's policy."""
    return f"// logicity policy 1: {algorithm}, {mode}"


def policy_files(folder: Path) -> list[Path]:
    """Return the files of the policy of a run, or of a policy of a release."""
    return sorted([*folder.glob("best.*"), *folder.glob("policy.dl"), *folder.glob("policy.safetensors")])


def saved_by(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the `algorithm` and the `mode` in the file of a learner's policy. Raise `ValueError` if it lacks them."""
    first = _logicity.read_file(checked_path("path", path)).partition("\n")[0]
    match = HEADER.fullmatch(first.rstrip("\r"))
    if match is None:
        what = f"its first line is not `{header('LEARNER', 'MODE')}`, which learners write"
        raise ValueError(f"{os.fspath(path)} does not name a mode: {what}; name the modes with `--modes`")
    return match.groupdict()


def rule_policies(
    path: str | os.PathLike[str], modes: Sequence[str | os.PathLike[str]] | None = None
) -> list[RulePolicy]:
    """Return the policies of a rule file in several modes, for `logicity evaluate --policy FILE.dl`.

    By default, `modes` is the mode that the file of a learner's policy names. The exceptions are those of `RulePolicy`
    and `saved_by`.
    """
    return [RulePolicy(path, mode) for mode in ([saved_by(path)["mode"]] if modes is None else modes)]
