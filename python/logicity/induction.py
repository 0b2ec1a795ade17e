"""Rules learned from demonstrations and questions. Needs the extra `gym` for `demonstrations`.

`induce` finds clauses that explain the action of every demonstrated step, and can ask an oracle about scenes that no
demonstration shows. The result is a rule file, a policy, and a report about what demonstrations and answers show and
leave open.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import zip_longest
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, SupportsIndex, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _logicity
from .city import ACTIONS
from .envs.layout import atoms_of
from .errors import checked_integer, checked_path, checked_threads
from .files import write_text
from .minari_files import StoredEpisode, load_minari, stored_episodes
from .modes import ENVIRONMENTS, checked_mode
from .offline import Demonstrations
from .rules import Program
from .tasks import load_task
from .types import Atom, SymbolicScene

if TYPE_CHECKING:
    from minari import MinariDataset

__all__ = ["Episode", "InducedClause", "InducedRules", "Oracle", "induce"]


@runtime_checkable
class Episode(Protocol):
    """A demonstrated episode of T steps: a `Trajectory`, or an episode of a Minari dataset."""

    @property
    def observations(self) -> Any:
        """The `groundings` before each step and possibly after the last: numbers (T, width) or (T + 1, width)."""

    @property
    def actions(self) -> Any:
        """Integers of shape (T,): 0 Slow, 1 Normal, 2 Fast, 3 Stop."""


@dataclass(frozen=True)
class InducedClause:
    """A learned clause.

    Attributes:
        body: The literals of the body, without those that give precedence to other actions.
        examples: The number of steps with this action in which the body holds.
        alone: The number of these steps in which no other clause of the action holds.
        undecided: Literals that also hold in all steps that this clause alone explains. With such a literal, the clause
            fits as well. Literals that follow from the clause or from another one of them by the constraints of the
            rules are left out.
        alternatives: Pairs of a literal of the body and another literal that fits as well in its place.
        notes: Sentences about what the demonstrations leave open, as the comments of the rule file have them.
    """

    action: str
    body: tuple[str, ...]
    examples: int
    alone: int
    undecided: tuple[str, ...]
    alternatives: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Format the clause without the literals that give precedence to other actions."""
        return f"{self.action}(X) :- {', '.join(self.body)}."


def _with_tuples(value: Any) -> Any:
    """Return a value of JSON with tuples in place of lists."""
    return tuple(map(_with_tuples, value)) if isinstance(value, list) else value


class InducedRules:
    """Learned rules. Calling them with a batch of observations returns actions, so they are a policy.

    Attributes:
        text: The rules as the source of a rule file, with comments about their support.
        clauses: The clauses, by action in the order of precedence.
        report: All figures, as `logicity induce --report` writes them.
    """

    def __init__(self, rules: _logicity.LearnedRules) -> None:
        """Store the rules."""
        self._rules = rules
        self.text = rules.text
        self.report: Mapping[str, Any] = rules.report()
        names = [each.name for each in fields(InducedClause)]
        found = ({name: _with_tuples(clause[name]) for name in names} for clause in self.report["clauses"])
        self.clauses = tuple(InducedClause(**clause) for clause in found)

    def __reduce__(self) -> tuple[type[InducedRules], tuple[_logicity.LearnedRules]]:
        """Pickle the rules without learning again."""
        return type(self), (self._rules,)

    def __repr__(self) -> str:
        """Show the numbers of clauses and examples."""
        clauses, examples = len(self.clauses), self.report["examples"]
        return f"<InducedRules: {clauses} clause{'s' * (clauses != 1)} from {examples} example{'s' * (examples != 1)}>"

    def __call__(self, observations: ArrayLike) -> NDArray[np.int64]:
        """Return the actions that the rules choose, as `RulePolicy` does. An entity without facts counts as absent."""
        array = np.ascontiguousarray(observations, np.float32)
        if array.ndim != 2:
            found = f"an array of shape {array.shape}"
            remedy = "pass `batched=True` to `evaluate`"
            raise ValueError(f"expected a batch of observations (N, width), not {found}: {remedy}")
        return self._rules.decide(array)

    def policy(self) -> InducedRules:
        """Return the rules as a policy for `evaluate(..., batched=True)`."""
        return self

    def program(self) -> Program:
        """Return the rules as a program of the engine."""
        return Program(self.text, "learned.dl")

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the rule file, as `RulePolicy.save` does."""
        write_text(path, self.text, by="induce", overwrite=overwrite)


@dataclass
class _Source:
    """Episodes, and what is known about them."""

    episodes: Iterable[Episode]
    #: Words that follow "from 3 episodes" in the rule file.
    title: str = ""
    mode: str | None = None
    #: The options `rules` and `overrides` of the environment.
    options: Mapping[str, Any] = field(default_factory=dict)
    #: Further sentences about the source.
    lines: Sequence[str] = ()
    #: The atom of each number of an observation.
    atoms: Sequence[str] = ()


@dataclass(frozen=True)
class Oracle:
    """An oracle, which `induce` asks for the actions of scenes.

    Args:
        decide: A function that takes a scene, as `infer` does, and returns the name of the ego's action, or the path of
            a rule file whose clauses the learner does not see.
        questions: The largest number of questions, including those of an earlier run in the log.
        agreements: The questions end when the rules agree with the oracle on this many random scenes in a row.
        sweep: Then ask all scenes of at most this many facts and entities, for example `(3, 2)`: a certificate.
            Facts that follow from others and facts of `.covering` predicates do not count.
        log: A file to which each question is added at once with its answer. The same call with an existing log
            continues where it stopped. A log of other questions is an error. It identifies a function by its name, and
            an object by its class, so another function of the same name needs another log.

    Raises:
        TypeError: If an argument has a wrong type.
        ValueError: If a number is out of range.
    """

    decide: Callable[[SymbolicScene], str] | str | os.PathLike[str]
    questions: SupportsIndex = 10_000_000
    agreements: SupportsIndex = 400
    sweep: tuple[SupportsIndex, SupportsIndex] | None = None
    log: str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        self._checked()

    def _checked(self) -> tuple[int, int, tuple[int, int] | None, str | None]:
        sweep = self.sweep
        if sweep is not None and (not isinstance(sweep, Sequence) or len(sweep) != 2):
            raise TypeError(f"sweep: expected the numbers of facts and entities, such as `(3, 2)`, not {sweep!r}")
        questions, agreements = (checked_integer(name, getattr(self, name)) for name in ("questions", "agreements"))
        sizes = sweep and (checked_integer("sweep", sweep[0], 0, 1000), checked_integer("sweep", sweep[1], 1, 5))
        return questions, agreements, sizes, None if self.log is None else checked_path("log", self.log)

    def _arguments(self, mode: str | os.PathLike[str], overrides: Mapping[str, Any] | None) -> tuple[Any, ...]:
        """Return the oracle, what identifies it in a log, its name in reports, and the other arguments."""
        if callable(self.decide):
            kind = self.decide if hasattr(self.decide, "__qualname__") else type(self.decide)
            named: tuple[Any, str, str] = (self.decide, f"function {kind.__module__}.{kind.__qualname__}", "a function")
        else:
            path = checked_path("decide", self.decide)
            named = (load_task(mode, path, overrides), "", f"the rules in {os.path.basename(path)}")
        return (*named, *self._checked())


def induce(
    demonstrations: Demonstrations | MinariDataset | str | os.PathLike[str] | Iterable[Episode] = (),
    mode: str | os.PathLike[str] | None = None,
    *,
    order: Sequence[str] = ("Stop", "Slow", "Fast"),
    variables: SupportsIndex = 3,
    effort: SupportsIndex = 20_000,
    noise: float | Literal["auto"] | None = None,
    seed: SupportsIndex = 0,
    threads: SupportsIndex = 0,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    oracle: Oracle | None = None,
) -> InducedRules:
    """Learn rules from demonstrations, from questions to an oracle, or from both.

    The learner sees the observations and the actions, but no clause of the rules. The same arguments and the same
    answers give the same rules on any number of threads. `report["questions"]` of the result describes the questions
    and the certificate.

    Args:
        demonstrations: `Demonstrations`; a Minari dataset, its name, or its folder; a Parquet table of
            `Demonstrations.to_parquet`; or other objects with `observations` of the kind `groundings` and `actions`,
            such as a slice of `Demonstrations`.
        mode: One of `logicity.ENVIRONMENTS` or the path of a configuration file, which names the predicates
            and the default action. The default is that of the demonstrations, if they name one.
        order: The actions in the order in which the learned rules try them. The default action of the configuration
            comes last.
        variables: The largest number of variables of a clause, from 2 on.
        effort: The largest number of steps of the search for one clause. Without effect on examples with wrong actions.
        noise: The share of examples that may have a wrong action, from 0 to 0.4, or "auto" to estimate it by
            cross-validation. None means that all are right: then two examples with the same facts and different actions
            are an error.
        seed: The seed of the order in which the learner tries examples.
        threads: The number of threads, 0 for one per core.
        rules: A rule file to use instead of the configuration's, for its declarations. The default is that of the
            demonstrations, if they name one.
        overrides: Changes of the configuration, as in `gymnasium.make`. The default is that of the demonstrations.
        oracle: Whom to ask, and how often. `noise` must be None.

    Raises:
        BaseException: Any exception of the oracle. Its attribute `rules` has the rules learned so far, as have
            `KeyboardInterrupt` and the exceptions for a faulty oracle.
        ImportError: If Minari is not installed. The extra `offline` installs it: `pip install 'logicity[offline]'`.
        InputError: If the configuration or an option is invalid, two examples have the same facts and different
            actions, the oracle contradicts itself or an example, or no rules agree with all its answers.
        OSError: If a file cannot be read or written.
        TypeError: If an argument or an answer has a wrong type.
        ValueError: If an argument is out of range, an answer is not an action, the shapes of demonstrations do not fit,
            there are neither demonstrations nor an oracle, `demonstrations` is the name of a mode, a Minari dataset is
            damaged or too large, or the log has other questions.
    """
    variables = checked_integer("variables", variables, 2, _logicity.VARIABLES_MAX)
    effort = checked_integer("effort", effort, 1, 2**32 - 1)
    numbers = (variables, effort, checked_integer("seed", seed), checked_threads(threads))
    if oracle is not None and not isinstance(oracle, Oracle):
        raise TypeError(f"oracle: expected an Oracle, not {type(oracle).__name__}")
    names = _checked_order(order)
    if oracle is not None and noise is not None:
        raise ValueError("noise: expected None, because the answers of an oracle are exact")
    if noise is not None and noise != "auto":
        message = f"noise: expected a number from 0 to {_logicity.NOISE_MAX}, auto or None, not {noise!r}"
        if not isinstance(noise, (Real, str)) or isinstance(noise, bool):
            raise TypeError(message)
        if isinstance(noise, str) or not 0 <= noise <= _logicity.NOISE_MAX:
            raise ValueError(message)
    rate = float("nan") if noise == "auto" else None if noise is None else float(noise)
    if isinstance(demonstrations, str) and demonstrations in ENVIRONMENTS and not os.path.exists(demonstrations):
        remedy = f'pass `logicity.demonstrations("{demonstrations}")`, or `mode="{demonstrations}"` with an `oracle`'
        raise ValueError(f"demonstrations: `{demonstrations}` is a mode, not a dataset: {remedy}")
    source = _source(demonstrations)
    mode = source.mode if mode is None else mode
    if mode is None:
        raise TypeError("mode: expected the mode or the configuration file of the demonstrations")
    name = checked_mode(mode)
    if source.mode == name:
        rules = source.options.get("rules") if rules is None else rules
        overrides = source.options.get("overrides") if overrides is None else overrides
    task = load_task(mode, rules, overrides)
    expected = _atom_texts(atoms_of(_logicity.describe(task))) if source.atoms else []
    for one, other in zip_longest(source.atoms, expected):
        if one != other:
            reason = f"they have the atom {one} instead of {other}"
            raise ValueError(f"the demonstrations of {source.mode} do not fit {name}: {reason}")
    width = None if oracle is None else task.shape("groundings")[0]
    observations, actions, parts = _stacked(source.episodes, width)
    count = "1 episode" if len(parts) == 1 else f"{len(parts)} episodes"
    origin = f"{count} {source.title or f'for {name}'}" if parts else f"questions about scenes of {name}"
    lines = [f"Rules learned by logicity {_logicity.__version__} from {origin}.", *source.lines]
    if rules is not None:
        lines.append(f"The configuration has the rules in {os.path.basename(checked_path('rules', rules))}.")
    asking = None if oracle is None else oracle._arguments(mode, overrides)
    learned, fault = _logicity.induce(task, observations, actions, parts, lines, names, *numbers, rate, asking)
    induced = InducedRules(learned)
    if fault is not None:
        vars(fault)["rules"] = induced
        if hasattr(fault, "add_note"):
            fault.add_note("The rules learned before are in the attribute `rules` of this exception.")
        raise fault
    return induced


def _checked_order(order: object) -> list[str]:
    if isinstance(order, str) or not isinstance(order, Iterable):
        raise TypeError(f"order: expected names of actions, not {type(order).__name__}")
    names = list(order)
    for at, name in enumerate(names):
        if not isinstance(name, str):
            raise TypeError(f"order: expected names of actions, not {type(name).__name__}")
        if name in names[:at]:
            raise ValueError(f"order: `{name}` occurs twice")
    return names


def _source(demonstrations: Any) -> _Source:
    """Return the episodes of demonstrations, and what is known about them."""
    if isinstance(demonstrations, Demonstrations):
        _check_observation("groundings" if demonstrations.atoms else "state")
        mode, title = demonstrations.mode, f"of {demonstrations.mode} ({demonstrations.split})"
        lines, atoms = [f"Episodes {demonstrations.episodes_hash}."], _atom_texts(demonstrations.atoms)
        return _Source(demonstrations, title, mode, demonstrations.env.kwargs, lines, atoms)
    if isinstance(demonstrations, (str, os.PathLike)):
        path = Path(demonstrations)
        if path.suffix != ".parquet" and not path.is_file():
            return _minari(load_minari(demonstrations))
        mode, split, episodes_hash, atoms, (observations, actions, episodes, _) = _logicity.read_steps(path)
        cuts = np.flatnonzero(np.diff(episodes)) + 1
        parts = zip(np.split(observations, cuts), np.split(actions, cuts), strict=True)
        title, lines = f"of {mode} ({split}) in {path.name}", [f"Episodes {episodes_hash}."]
        return _Source([StoredEpisode(*part) for part in parts], title, mode, lines=lines, atoms=atoms)
    if hasattr(demonstrations, "iterate_episodes") and hasattr(demonstrations, "env_spec"):
        return _minari(demonstrations)
    if not isinstance(demonstrations, Iterable):
        raise TypeError(f"demonstrations: expected episodes, not {type(demonstrations).__name__}")
    return _Source(demonstrations)


def _check_observation(kind: str) -> None:
    if kind != "groundings":
        raise ValueError(f"expected observations of the kind `groundings`, not `{kind}`")


def _minari(dataset: MinariDataset) -> _Source:
    """Return the episodes of a Minari dataset. Its environment is known if Minari recorded one of this package."""
    episodes, title = stored_episodes(dataset), f"of {dataset.id}"
    spec = dataset.env_spec
    if spec is None or spec.namespace != "logicity":
        return _Source(episodes, title)
    if not isinstance(spec.kwargs, Mapping):
        raise ValueError(f"cannot read the Minari dataset `{dataset.id}`: its environment has no mapping of arguments")
    _check_observation(spec.kwargs.get("observation", "groundings"))
    return _Source(episodes, title, spec.kwargs.get("config"), spec.kwargs)


def _atom_texts(atoms: Iterable[Atom]) -> list[str]:
    """Return atoms as a Parquet table names them, such as `IsCar(0)`."""
    return [f"{name}({','.join(map(str, entities))})" for name, entities in atoms]


def _stacked(
    episodes: Iterable[Episode], width: int | None
) -> tuple[NDArray[np.float32], NDArray[np.int64], list[tuple[int, str]]]:
    """Return the steps of all episodes in one array, and the first step of each.

    There may be no steps if the width of observations is known.
    """
    observations: list[NDArray[np.float32]] = []
    actions: list[NDArray[np.int64]] = []
    parts: list[tuple[int, str]] = []
    count = 0
    for number, episode in enumerate(episodes):
        if not isinstance(episode, Episode):
            raise TypeError(f"expected episodes with `observations` and `actions`, not {type(episode).__name__}")
        taken = np.asarray(episode.actions)
        seen = np.asarray(episode.observations, np.float32)
        if taken.ndim != 1 or seen.ndim != 2 or len(seen) not in (len(taken), len(taken) + 1):
            reason = f"observations of shape {seen.shape} do not fit actions of shape {taken.shape}"
            raise ValueError(f"episode {number}: {reason}")
        if not np.isfinite(seen).all():
            raise ValueError(f"episode {number}: observations that are not finite")
        if not np.issubdtype(taken.dtype, np.integer):
            raise TypeError(f"episode {number}: expected integer actions, not {taken.dtype}")
        if len(taken) and not 0 <= taken.min() <= taken.max() < len(ACTIONS):
            known = ", ".join(ACTIONS)
            raise ValueError(f"episode {number}: expected the actions 0 to {len(ACTIONS) - 1} ({known})")
        parts.append((count, f"episode {number}"))
        observations.append(seen[: len(taken)])
        actions.append(taken.astype(np.int64))
        count += len(taken)
    if count == 0:
        if width is None:
            raise ValueError("no demonstrations: expected at least one step")
        return np.zeros((0, width), np.float32), np.zeros(0, np.int64), []
    if len({array.shape[1] for array in observations}) > 1:
        raise ValueError("the observations of the episodes have different lengths")
    return np.concatenate(observations), np.concatenate(actions), parts
