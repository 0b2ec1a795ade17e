"""Measure policies on recorded episodes with the metrics of the paper: success rates and score.

`evaluate` measures one policy. A `Benchmark` measures several on the same episodes, and runs the random policy, which
is the baseline of the score, only once.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from . import _logicity
from .city import ACTIONS
from .envs.config import EnvConfig, array_kind, checked_kind
from .envs.views import Actions, Observations, View, views_of
from .errors import InputError, checked_path, did_you_mean
from .files import check_writable
from .modes import checked_mode
from .predicates import PythonPredicate
from .terminal import aligned, neutral
from .types import Diagnostic, Limits, ObservationKind

__all__ = ["Benchmark", "EpisodeRecord", "Evaluation", "Interval", "Policy", "evaluate"]


#: The shape of an observation, or the shape of each array of an observation that is a dictionary.
Shape: TypeAlias = tuple[int, ...] | dict[str, tuple[int, ...]]


class Predictor(Protocol):
    """A model of Stable-Baselines3, or an object with the same `predict`."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]: ...


Policy: TypeAlias = Literal["oracle", "random"] | Predictor | Callable[[Any], Any]


@dataclass(frozen=True)
class Interval:
    """A measured value with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of_share(cls, successes: int, trials: int) -> Interval:
        """Return the share of successes with its Wilson score interval (1927). For no trials, 0 and [0, 1]."""
        if trials == 0:
            return cls(0.0, 0.0, 1.0)
        z = 1.959963984540054
        share = successes / trials
        center = (share + z * z / (2 * trials)) / (1 + z * z / trials)
        spread = z / (1 + z * z / trials) * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
        # Rounding errors must not exclude a share of 0 or 1.
        return cls(share, min(share, max(0.0, center - spread)), max(share, min(1.0, center + spread)))

    def __str__(self) -> str:
        """Format the value and, in brackets, the interval; `-` for the share of no trials."""
        if (self.value, self.low, self.high) == (0, 0, 1):
            return "-"
        # Adding 0.0 turns a rounded -0.0 into 0.0.
        value, low, high = (f"{round(number, 2) + 0.0:.2f}" for number in (self.value, self.low, self.high))
        return f"{value} [{low}, {high}]"


@dataclass(frozen=True)
class EpisodeRecord:
    """The result of one run of an episode. The random policy has ten records per episode.

    Attributes:
        episode: The number of the episode in the set, from 0.
        total: The return: the undiscounted sum of rewards.
        success: Whether the car reached the goal in time without violating a rule.
        truncated: Whether the run reached the step limit.
        actions: The number of steps in which the policy chose an action, by the name of the action.
        constrained: The number of steps in which the rules required an action, by the name of the action.
        violations: The names of the clauses that the last action violated.
        ego: The number of the ego, from 0, if the configuration has several (`task.egos`). Each has its own record.
        observed_clauses: With `task.sensors.share`, the numbers of clauses that applied to the car, which are those
            that some action would have violated, summed over the steps: those that it observed fully, partly and not at
            all. A clause is observed fully if it also applies by what the car observes, and partly if the car observes
            one of the facts that the clause needs. Otherwise, and for the random policy, `None`.
    """

    episode: int
    steps: int
    total: float
    success: bool
    truncated: bool
    actions: Mapping[str, int]
    constrained: Mapping[str, int]
    violations: tuple[str, ...]
    ego: int = 0
    observed_clauses: tuple[int, int, int] | None = None


@dataclass(frozen=True)
class Evaluation:
    """The measures of a policy on a set of episodes. Rates are from 0 to 1, with Wilson intervals.

    With several egos (`task.egos` of the configuration), a rate counts every ego of every episode, its interval
    accounts for the correlation between the egos of an episode, and returns are means over the egos.

    Attributes:
        mode: The mode, or the path of the configuration file.
        episodes_hash: SHA-256 of the set of episodes. Only results with the same hash are comparable.
        compliance: Rule compliance rate: of the episodes in which the rules require an action at least once, the share
            in which the car never violates a rule. The episode may end in any way. If the rules require nothing, 0 with
            the interval [0, 1].
        tsr: Trajectory success rate: the share of episodes in which the car reaches the goal in time without violating
            a rule.
        dsr: Decision success rate of the paper: the numerator of `compliance` over the number of all episodes.
        dsr_by_action: By action, the share of the episodes that require the action in which the car violates no
            clause that requires it.
        score: The mean difference between the return and the mean return of the random policy on the same episode.
        mean_return: The mean return (undiscounted sum of rewards).
        joint_tsr: With several egos, the share of episodes in which all of them reach their goals in time without
            violating a rule; `None` with one.
        joint_dsr: With several egos, the share of episodes in which the rules require an action of an ego at least once
            and no ego violates a rule; `None` with one.
    """

    policy: str
    mode: str
    split: str
    episodes_hash: str
    compliance: Interval
    tsr: Interval
    dsr: Interval
    dsr_by_action: Mapping[str, Interval]
    score: Interval
    mean_return: Interval
    mean_steps: float
    episodes: tuple[EpisodeRecord, ...]
    joint_tsr: Interval | None = None
    joint_dsr: Interval | None = None

    def __repr__(self) -> str:
        """Show the main measures and the number of runs."""
        egos = 1 + max((record.ego for record in self.episodes), default=0)
        of = "" if egos == 1 else f" of {egos} egos"
        return (
            f"<Evaluation of {self.policy} in {self.mode}, {self.split}: {self.summary()}, "
            f"{len(self.episodes) // egos} episodes{of}>"
        )

    def summary(self) -> str:
        """Return the main measures in one line."""
        joint = "" if self.joint_tsr is None else f", joint TSR {self.joint_tsr}"
        return f"compliance {self.compliance}, TSR {self.tsr}, DSR {self.dsr}, Score {self.score}{joint}"

    def chosen(self) -> dict[str, float]:
        """Return the share of all steps in which the policy chose each action."""
        return self._share(lambda record: record.actions)

    def observed(self) -> tuple[float, float, float] | None:
        """Return the shares of the applying clauses that were observed fully, partly and not at all.

        Return `None` if the evaluation did not count clauses, which needs `task.sensors.share`, or none applied.
        """
        counts = [record.observed_clauses for record in self.episodes if record.observed_clauses is not None]
        sums = [sum(each) for each in zip(*counts, strict=True)]
        if not sum(sums):
            return None
        fully, partly, unobserved = (each / sum(sums) for each in sums)
        return fully, partly, unobserved

    def required(self) -> dict[str, float]:
        """Return the share of all steps in which the rules required each action."""
        return self._share(lambda record: record.constrained)

    def _share(self, counts: Callable[[EpisodeRecord], Mapping[str, int]]) -> dict[str, float]:
        steps = sum(record.steps for record in self.episodes)
        names = dict.fromkeys((*ACTIONS, *(name for record in self.episodes for name in counts(record))))
        return {
            action: sum(counts(record).get(action, 0) for record in self.episodes) / max(steps, 1) for action in names
        }

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON, without the keys of features that were not used."""
        values = asdict(self)
        if self.joint_tsr is None:
            del values["joint_tsr"], values["joint_dsr"]
        for record in values["episodes"]:
            if self.joint_tsr is None:
                del record["ego"]
            if record["observed_clauses"] is None:
                del record["observed_clauses"]
        return values


#: The names of the main measures.
MEASURES = ("compliance", "tsr", "dsr", "score")


class Progress:
    """A progress line on the terminal. Prints nothing if standard error is not a terminal."""

    def __init__(self, label: str, total: int) -> None:
        self._label, self._total = neutral(label, lines=False), total
        self._enabled = sys.stderr is not None and sys.stderr.isatty()

    def __enter__(self) -> Progress:
        self.update(0)
        return self

    def update(self, done: int) -> None:
        if self._enabled:
            print(f"\r{self._label}: {done} of {self._total}", end="", file=sys.stderr, flush=True)

    def __exit__(self, *error: object) -> None:
        if self._enabled:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


@contextmanager
def episodes_that_fit() -> Iterator[None]:
    """Add a hint to errors about recorded episodes that do not fit the agents or the map."""
    try:
        yield
    except InputError as error:
        named = any("logicity episodes make" in help for fault in error.diagnostics for help in fault["help"])
        if named or not any(fault["code"] == "invalid-episode" for fault in error.diagnostics):
            raise
        more = "record episodes with `logicity episodes make`, and name the file under `task.episodes`"
        faults = [{**fault, "help": [*fault["help"], more]} for fault in error.diagnostics]
        raise InputError(f"{str(error).rstrip()}\n |\n = help: {more}", cast(list[Diagnostic], faults)) from error


class Benchmark:
    """The recorded episodes of a mode or of a configuration file, to measure policies on.

    The step limit of an episode is a multiple of the oracle's number of steps. The factor is `patience` in the task, 2
    in the modes. All episodes run in one batch. Actions for episodes that have ended have no effect.

    With `task.egos` in the configuration, the policy drives that many cars of every episode, each by its own
    observation. The step limit is a multiple of the number of steps in which the oracle brings all of them to their
    goals. If it does not, because cars block each other, the limit is `horizon` of the task.

    Args:
        mode: One of `logicity.ENVIRONMENTS`, such as `"expert"`, or the path of a configuration file. `logicity
            episodes make` records episodes for a configuration file.
        split: The set of agents and episodes: `"train"`, `"val"` or `"test"`.
        rules: A rule file that replaces the mode's. The recorded episodes do not change, so the oracle may not reach
            the goal.
        overrides, observation, limits, predicates: As in `gymnasium.make`.

    Raises:
        InputError: If the configuration, the rule file or an override is invalid, no episodes are recorded, or they are
            for another map.
        OSError: If a file cannot be read.
        ValueError: If the mode, the split or the kind of observation is unknown.
    """

    def __init__(
        self,
        mode: str | os.PathLike[str],
        split: str = "test",
        *,
        rules: str | os.PathLike[str] | None = None,
        overrides: Mapping[str, Any] | None = None,
        observation: ObservationKind = "groundings",
        limits: Limits | None = None,
        predicates: Iterable[PythonPredicate] | None = None,
    ) -> None:
        """Load the task and its episodes."""
        self.mode, self.split = checked_mode(mode), split
        self._kind = array_kind(checked_kind(observation))
        self._config = EnvConfig(self.mode, rules=rules, overrides=overrides, limits=limits, predicates=predicates)
        self._task = self._config.task()
        self._views = views_of(self._task, observation)
        self._random = _logicity.RandomBaseline(self._task, split)
        self.episodes_hash = self._random.hash()
        self._baseline_episodes = 0

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self._random)

    @property
    def observation_shape(self) -> Shape:
        """The shape of an observation, or that of each of its arrays by name."""
        return tuple(self._task.shape(self._kind)) if self._views is None else self._views.shapes()

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments. A copy runs the random policy again."""
        return {key: value for key, value in self.__dict__.items() if key not in ("_random", "_baseline_episodes")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Load the episodes."""
        self.__dict__.update(state)
        self._random, self._baseline_episodes = _logicity.RandomBaseline(self._task, self.split), 0

    def _baseline(self) -> _logicity.RandomBaseline:
        """Return the results of the random policy. The first call runs it."""
        if self._baseline_episodes < len(self):
            with Progress(f"{self.mode} {self.split}, random policy", len(self)) as progress:
                while self._baseline_episodes < len(self):
                    self._random.add()
                    self._baseline_episodes += 1
                    progress.update(self._baseline_episodes)
        return self._random

    def random_returns(self) -> list[float]:
        """Return the mean return of the random policy on each episode, the baseline of the score."""
        totals: dict[int, list[float]] = {}
        for record in self._baseline().report()["episodes"]:
            totals.setdefault(record["episode"], []).append(record["total"])
        return [sum(runs) / len(runs) for _, runs in sorted(totals.items())]

    @episodes_that_fit()
    def evaluate(
        self,
        policy: Policy | Sequence[Policy],
        *,
        batched: bool = False,
        name: str | None = None,
        traces: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
    ) -> Evaluation:
        """Run a policy once on every episode, or the random policy ten times.

        Args:
            policy: `"oracle"`, `"random"`, a model of Stable-Baselines3, or a function. A model predicts
                deterministically. A function maps one observation to one action, 0 to 3. If the kind of observation is
                `relational` or `graph`, a model needs an `observation_space` with these arrays. With several egos, a
                list has the policy of each.
            batched: Whether the function takes all observations, float32 of shape (episodes, ...) or a dictionary of
                such arrays, and returns integers of shape (episodes,). With several egos, there is a row for each ego
                of each episode, those of an episode one after the other.
            name: The name of the policy in the result.
            traces: A folder for one trace per episode, which is created if it does not exist. `episode-7.jsonl` is the
                trace of episode 7, see `SPFEnv.write_trace`. They replace traces that `evaluate` wrote and that
                have not changed since. The folder must not have a trace of another episode. The random policy does not
                support traces.
            overwrite: Whether to replace any file with the name of a trace.

        Raises:
            FileExistsError: If a file must not be replaced, or the folder has a trace of another episode. Then no
                episode runs.
            InputError: If the episodes do not fit the agents, for example because of overrides.
            OSError: If a trace cannot be written.
            TypeError: If the policy has an unsupported type, its actions are not integers, or `traces` is not a path.
            ValueError: If the policy name is unknown, a model takes observations of another shape, an action is not 0,
                1, 2 or 3, the number of actions differs from the number of observations, or `traces` is set for the
                random policy.
        """
        folder = None if traces is None else Path(checked_path("traces", traces))
        named = name or (policy if isinstance(policy, str) else type(policy).__name__)
        if policy == "random":
            if folder is not None:
                raise ValueError(
                    "the random policy runs every episode ten times and supports no traces: pass a function instead"
                )
            return self._result(named, self._baseline().report())
        policies = list(policy) if isinstance(policy, (list, tuple)) else [cast(Policy, policy)]
        for each in policies:
            self._check_model(each)
        shielded = not (isinstance(policy, str) and policy == "oracle")
        evaluator = _logicity.BatchEvaluator(self._random, self._kind, shielded)
        egos = evaluator.egos()
        self._check_egos(policy, egos)
        count = len(evaluator) * egos
        observations = np.zeros((count, *self._task.shape(self._kind)), np.float32)
        running = np.ones(count, np.bool_)
        names = self._task.actions()
        acts = [_actor(each, batched, evaluator, names) for each in policies]
        act = acts[0] if len(acts) == 1 else _one_for_each(acts)
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            self.check_traces(folder, overwrite)
        with Progress(f"{self.mode} {self.split}, {named}", len(evaluator)) as progress:
            while running.any():
                evaluator.observe(observations)
                given = observations if self._views is None else self._views(observations)
                actions = _checked(act(given, running), count, names)
                evaluator.step(actions)
                evaluator.running(running)
                progress.update(int((~running.reshape(-1, egos).any(1)).sum()))
        if folder is not None:
            with Progress(f"{self.mode} {self.split}, traces", len(evaluator)) as progress:
                for episode in range(len(evaluator)):
                    target = (folder / _trace_name(episode), "evaluate", overwrite)
                    self._task.write_trace(self.split, evaluator.episode(episode), evaluator.taken(episode), target)
                    progress.update(episode + 1)
        return self._result(named, evaluator.report(self._baseline()))

    def check_traces(self, folder: Path, overwrite: bool = False) -> None:
        """Check that the traces of all episodes can be written to a folder, with the exceptions of `evaluate`."""
        if not folder.exists():
            return
        names = {_trace_name(episode) for episode in range(len(self))}
        other = min((path.name for path in folder.glob("episode-*.jsonl") if path.name not in names), default=None)
        if other is not None:
            raise FileExistsError(
                f"`{folder / other}` is a trace of another episode than 0 to {len(self) - 1}: remove it, or choose "
                "another folder"
            )
        for name in sorted(names):
            check_writable(folder / name, by="evaluate", overwrite=overwrite)

    def _check_egos(self, policy: Policy | Sequence[Policy], egos: int) -> None:
        count = len(policy) if isinstance(policy, (list, tuple)) else getattr(policy, "egos", None)
        if count not in (None, egos):
            help = f"set `task.egos` to {count}, or pass one policy for all egos" if count else "pass one for each ego"
            raise ValueError(
                f"{count} {'policy' if count == 1 else 'policies'} for {egos} ego{'' if egos == 1 else 's'}: {help}"
            )
        if isinstance(policy, (list, tuple)) and "random" in [each for each in policy if isinstance(each, str)]:
            raise ValueError("the random policy runs every episode ten times, so it cannot be one of a list")

    def _check_model(self, policy: Policy) -> None:
        shape = model_shape(policy)
        if shape not in (None, self.observation_shape):
            raise ValueError(
                f"the model takes observations of shape {shape}, and those of `{self.mode}` have shape "
                f"{self.observation_shape}: name the mode and the observation of its training"
            )
        if shape is None and self._views is not None and hasattr(policy, "predict"):
            raise ValueError(
                f"{type(policy).__name__} has no `observation_space`, so it does not say that it takes observations of "
                f"the kind `{self._views.kind}`: use `groundings`, or pass a function"
            )

    def _result(self, policy: str, report: Mapping[str, Any]) -> Evaluation:
        summary = report["summary"]

        def interval(of: Mapping[str, Any]) -> Interval:
            return Interval(of["value"], of["low"], of["high"])

        return Evaluation(
            policy=policy,
            mode=self.mode,
            split=self.split,
            episodes_hash=self.episodes_hash,
            dsr_by_action={rate["action"]: interval(rate) for rate in summary["dsr_by_action"]},
            **{name: interval(summary[name]) for name in (*MEASURES, "mean_return")},
            **{f"joint_{name}": interval(rate) for name, rate in summary.get("joint", {}).items()},
            mean_steps=summary["mean_steps"],
            episodes=tuple(
                EpisodeRecord(
                    **{
                        **record,
                        "violations": tuple(record["violations"]),
                        "observed_clauses": tuple(record["observed_clauses"]) if "observed_clauses" in record else None,
                    }
                )
                for record in report["episodes"]
            ),
        )


def model_shape(policy: Any) -> Shape | None:
    """Return the shape of the observations that a model takes, or `None` if the policy has no such shape."""
    space = getattr(policy, "observation_space", None)
    parts = getattr(space, "spaces", None)
    if isinstance(parts, Mapping):
        return {name: tuple(part.shape) for name, part in parts.items()}
    shape = getattr(space, "shape", None)
    return None if shape is None else tuple(shape)


def _trace_name(episode: int) -> str:
    return f"episode-{episode}.jsonl"


def _actor(policy: Policy, batched: bool, evaluator: _logicity.BatchEvaluator, names: tuple[str, ...]) -> _Actor:
    """Return a function from all observations and the mask of running episodes to actions."""
    if isinstance(policy, str):
        if policy != "oracle":
            expected = f"expected a name, a model or a function{did_you_mean(policy, ('oracle', 'random'))}"
            raise ValueError(f"unknown policy `{policy}`: {expected}")
        return lambda observations, running: evaluator.oracle_actions()
    plan: Any = getattr(policy, "plan", None)
    if plan is not None:
        # It decides on the states of the episodes.
        return lambda observations, running: plan(evaluator)
    predict: Any = getattr(policy, "predict", None)
    if predict is not None:
        # A recurrent model has a state.
        state: Any = None
        first_step = True

        def act(observations: Observations | View, running: NDArray[np.bool_]) -> Any:
            nonlocal state, first_step
            starts, first_step = np.full(len(running), first_step), False
            actions, state = predict(observations, state=state, episode_start=starts, deterministic=True)
            return actions

        return act
    if not callable(policy):
        raise TypeError(
            f"expected a policy: oracle, random, a model with `predict` or a function, not {type(policy).__name__}"
        )
    function = policy
    if batched:
        return lambda observations, running: function(observations)

    def one_by_one(observations: Observations | View, running: NDArray[np.bool_]) -> Any:
        actions = np.zeros(len(running), np.int64)
        for at in np.flatnonzero(running):
            if isinstance(observations, dict):
                row: Any = {name: values[at].copy() for name, values in observations.items()}
            else:
                row = observations[at].copy()
            action = np.asarray(function(row))
            if action.size != 1:
                raise ValueError(f"expected one action per observation, not an array of shape {action.shape}")
            actions[at] = _checked(action.reshape(1), 1, names)[0]
        return actions

    return one_by_one


#: Maps all observations and the mask of running episodes to actions.
_Actor: TypeAlias = Callable[[Any, NDArray[np.bool_]], Any]


def _one_for_each(acts: Sequence[_Actor]) -> _Actor:
    """Return a function from the observations of all egos to actions. Each ego has its own function."""

    def act(observations: Any, running: NDArray[np.bool_]) -> Any:
        actions = np.zeros(len(running), np.int64)
        for ego, of_ego in enumerate(acts):
            rows = slice(ego, None, len(acts))
            if isinstance(observations, dict):
                given: Any = {name: values[rows] for name, values in observations.items()}
            else:
                given = observations[rows]
            chosen = np.asarray(of_ego(given, running[rows]))
            actions[rows] = chosen[rows] if len(chosen) == len(running) else chosen
        return actions

    return act


def _checked(actions: Any, count: int, names: tuple[str, ...]) -> Actions:
    array = np.asarray(actions)
    if array.shape != (count,):
        raise ValueError(f"expected one action for each of {count} observations, not an array of shape {array.shape}")
    known = ", ".join(f"{number} {name}" for number, name in enumerate(names))
    if not np.issubdtype(array.dtype, np.integer):
        raise TypeError(f"expected integer actions, not {array.tolist()[0]!r}; known: {known}")
    numbers = array.astype(np.int64)
    wrong = np.flatnonzero((numbers < 0) | (numbers >= len(names)))
    if len(wrong):
        raise ValueError(f"{numbers[wrong[0]]} is not an action; known: {known}")
    return numbers


def evaluate(
    policy: Policy | Sequence[Policy],
    mode: str | os.PathLike[str],
    split: str = "test",
    *,
    batched: bool = False,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    observation: ObservationKind = "groundings",
    traces: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    limits: Limits | None = None,
    predicates: Iterable[PythonPredicate] | None = None,
) -> Evaluation:
    """Measure a policy on the recorded episodes of a mode or of a configuration file.

    The arguments and exceptions are those of `Benchmark` and `Benchmark.evaluate`.
    """
    benchmark = Benchmark(
        mode, split, rules=rules, overrides=overrides, observation=observation, limits=limits, predicates=predicates
    )
    return benchmark.evaluate(policy, batched=batched, traces=traces, overwrite=overwrite)


def table(results: list[Evaluation]) -> str:
    """Format a text table like that of the paper, with one row per result."""
    joint = any(r.joint_tsr is not None for r in results)
    head = ("policy", "mode", "compliance", "TSR", *["joint TSR"] * joint, "DSR", "Score", "return", "steps")
    rows = [
        (
            *(r.policy, r.mode, str(r.compliance), str(r.tsr)),
            *["-" if r.joint_tsr is None else str(r.joint_tsr)] * joint,
            *(str(r.dsr), str(r.score), str(r.mean_return), f"{r.mean_steps:.1f}"),
        )
        for r in results
    ]
    return aligned([head, *rows])


def action_table(results: list[Evaluation]) -> str:
    """Format a text table with one row per result and action: how often it is chosen and required, and its DSR."""
    rows: list[tuple[str, ...]] = [("policy", "mode", "action", "chosen", "required", "DSR")]
    for each in results:
        chosen, required = each.chosen(), each.required()
        for action in dict.fromkeys((*chosen, *required)):
            rate = str(each.dsr_by_action.get(action, ""))
            shares = (f"{share.get(action, 0.0):.3f}" for share in (chosen, required))
            rows.append((each.policy, each.mode, action, *shares, rate))
    return aligned(rows)
