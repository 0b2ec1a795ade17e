"""How well a policy follows its path: the measures of the paper on recorded episodes.

`evaluate` measures one policy once; a `Benchmark` measures many on the same episodes and drives the random policy,
which every score is compared with, only once.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from . import _logicity
from .envs import World
from .errors import InputError
from .modes import checked_mode
from .types import Diagnostic

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["Benchmark", "EpisodeRecord", "Evaluation", "Interval", "Policy", "evaluate"]

Observations: TypeAlias = NDArray[np.float32]
Actions: TypeAlias = NDArray[np.int64]


class Predictor(Protocol):
    """A model of Stable-Baselines3, or anything that predicts as one."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Actions for a batch of observations, and the next state."""
        ...


Policy: TypeAlias = Literal["oracle", "random"] | Predictor | Callable[[Any], Any]


@dataclass(frozen=True)
class Interval:
    """A measured value with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """The value, and the interval in brackets."""
        # Adding 0 makes a rounded -0.001 print as 0.
        value, low, high = (f"{round(number, 2) + 0.0:.2f}" for number in (self.value, self.low, self.high))
        return f"{value} [{low}, {high}]"


@dataclass(frozen=True)
class EpisodeRecord:
    """How one episode went.

    `episode` is its number in the set, from 0. `constrained` says in how many steps the rules asked an action, by the
    name of the action; `violations` names the clauses that the last action broke. The random policy has ten records for
    each episode.
    """

    episode: int
    steps: int
    total: float
    success: bool
    truncated: bool
    constrained: Mapping[str, int]
    violations: tuple[str, ...]


@dataclass(frozen=True)
class Evaluation:
    """How well a policy did on a set of episodes. Rates are shares, 0 to 1; their intervals are Wilson's.

    - `mode`: the mode, or the configuration file as it was given.
    - `tsr`: of all episodes, those that reach the goal in time without a rule broken.
    - `dsr`: of all episodes, those in which the rules asked something at least once and were never broken, however they
      ended.
    - `dsr_by_action`: of the episodes in which the rules asked the action, those in which no clause that asks it was
      broken.
    - `mean_return`: the undiscounted sum of rewards.
    - `score`: `mean_return` less that of the random policy on the same episodes, compared episode by episode.
    - `episodes_hash`: SHA-256 of the set of episodes. Only results with the same hash can be compared.
    """

    policy: str
    mode: str
    split: str
    episodes_hash: str
    tsr: Interval
    dsr: Interval
    dsr_by_action: Mapping[str, Interval]
    score: Interval
    mean_return: Interval
    mean_steps: float
    episodes: tuple[EpisodeRecord, ...]

    def __repr__(self) -> str:
        """The three measures; `episodes` has the rest."""
        return (
            f"<Evaluation of {self.policy} in {self.mode}, {self.split}: TSR {self.tsr}, DSR {self.dsr}, "
            f"Score {self.score}, {len(self.episodes)} episodes>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as they are written to JSON."""
        return asdict(self)


class Progress:
    """A line on a terminal that says how far something is; elsewhere nothing is written."""

    def __init__(self, label: str, total: int) -> None:
        """So much there is to do; `label` says of what."""
        self._label, self._total = label, total
        self._shown = sys.stderr.isatty()

    def __enter__(self) -> Progress:
        """Begin with nothing done."""
        self.tell(0)
        return self

    def tell(self, done: int) -> None:
        """So much is done."""
        if self._shown:
            print(f"\r{self._label}: {done} of {self._total}", end="", file=sys.stderr, flush=True)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the line empty."""
        if self._shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def load_task(
    mode: str | os.PathLike[str],
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> _logicity.Task:
    """The task of a mode or configuration file; what is raised is as for `Benchmark`."""
    return World(checked_mode(mode), rules=rules, overrides=overrides).task()


@contextmanager
def episodes_that_fit() -> Iterator[None]:
    """Where recorded episodes are driven: of those that do not fit the agents or the map, say what helps."""
    try:
        yield
    except InputError as error:
        if not any(fault["code"] == "invalid-episode" for fault in error.diagnostics):
            raise
        more = "make episodes with `logicity episodes make` and name them under `task.episodes`"
        faults = [{**fault, "help": [*fault["help"], more]} for fault in error.diagnostics]
        raise InputError(f"{str(error).rstrip()}\n |\n = help: {more}", cast(list[Diagnostic], faults)) from error


class Benchmark:
    """Recorded episodes of a mode, or of a city of one's own, on which policies are measured.

    An episode has at most so many times the oracle's steps as the task says under `patience`, twice in the modes. All
    go on side by side, and what a policy says for one that has ended counts for nothing.

    Args:
        mode: one of `logicity.ENVIRONMENTS`, such as `"expert"`, or the path of a configuration file, whose recorded
            episodes `logicity episodes make` makes.
        split: `"train"`, `"val"` or `"test"`: whose agents and which episodes.
        rules: a rule file instead of the mode's. The recorded episodes stay, so the oracle need not reach the goal.
        overrides: changes to the task, as `gymnasium.make` takes them.
        observation: `"atoms"` or `"points"`, as `gymnasium.make` takes it.

    Raises:
        ValueError: an unknown mode, split or observation.
        InputError: a faulty configuration, rules file or override, or no recorded episodes.
        OSError: a file cannot be read.
    """

    def __init__(
        self,
        mode: str | os.PathLike[str],
        split: str = "test",
        *,
        rules: str | os.PathLike[str] | None = None,
        overrides: Mapping[str, Any] | None = None,
        observation: str = "atoms",
    ) -> None:
        """Load the task and its episodes."""
        self.mode, self.split = checked_mode(mode), split
        self._observation = observation
        self._world = World(self.mode, rules=rules, overrides=overrides)
        self._task = self._world.task()
        self._random = _logicity.Baseline(self._task, split)
        self.episodes_hash = self._random.hash()
        self._driven = 0

    def __len__(self) -> int:
        """How many episodes there are."""
        return len(self._random)

    def _baseline(self) -> _logicity.Baseline:
        """How the random policy does; found out once."""
        if self._driven < len(self):
            with Progress(f"{self.mode} {self.split}, random policy", len(self)) as progress:
                while self._driven < len(self):
                    self._random.add()
                    self._driven += 1
                    progress.tell(self._driven)
        return self._random

    def evaluate(
        self,
        policy: Policy,
        *,
        batched: bool = False,
        name: str | None = None,
        traces: str | os.PathLike[str] | None = None,
    ) -> Evaluation:
        """Let a policy drive every episode once, or the random policy ten times.

        Args:
            policy: `"oracle"`, `"random"`, a model of Stable-Baselines3, or a function. A model predicts
                deterministically. A function is given one observation and returns one action, 0 to 3.
            batched: the function is given all observations, float32 of shape (episodes, ...), and returns an integer
                for each.
            name: what to call the policy in the result.
            traces: a folder, made if it does not exist, for the trace of every episode: `episode-7.jsonl` is that of
                number 7, which `logicity view` makes a page of; see `SPFEnv.write_trace`. If overrides have changed the
                configuration, what it became stands there as `config.yaml`. Nothing is replaced: the folder must have
                no traces of episodes and no other `config.yaml`, which is told before the policy drives. Not of the
                random policy, which drives every episode ten times.

        Raises:
            TypeError: the policy is nothing that can act, or its actions are not integers.
            ValueError: an unknown name, not one action for each observation, or traces of the random policy.
            FileExistsError: the folder has traces already, or another configuration.
            OSError: a trace cannot be written.
            gymnasium.error.InvalidAction: an action that is not 0, 1, 2 or 3.
            InputError: the episodes do not fit the agents, as overrides can bring about.
        """
        with episodes_that_fit():
            return self._evaluate(policy, batched, name, None if traces is None else Path(traces))

    def _evaluate(self, policy: Policy, batched: bool, name: str | None, traces: Path | None) -> Evaluation:
        named = name or (policy if isinstance(policy, str) else type(policy).__name__)
        if policy == "random":
            if traces is not None:
                raise ValueError("the random policy drives every episode ten times: give a function for traces")
            return self._result(named, self._baseline().report())
        exam = _logicity.Exam(self._random, self._observation)
        observations = np.zeros((len(exam), *self._task.shape(self._observation)), np.float32)
        running = np.ones(len(exam), np.bool_)
        act = _actor(policy, batched, exam)
        write_traces = None if traces is None else self._traces_into(traces)
        taken: list[list[int]] = [[] for _ in range(len(exam))]
        with Progress(f"{self.mode} {self.split}, {named}", len(exam)) as progress:
            while running.any():
                exam.observe(observations)
                actions = _checked(act(observations, running), len(exam))
                exam.step(actions)
                if write_traces is not None:
                    for at in np.flatnonzero(running):
                        taken[at].append(int(actions[at]))
                exam.running(running)
                progress.tell(len(exam) - int(running.sum()))
        if write_traces is not None:
            write_traces(exam, taken)
        return self._result(named, exam.report(self._baseline()))

    def _traces_into(self, folder: Path) -> Callable[[_logicity.Exam, list[list[int]]], None]:
        """Prepare a folder, and return what writes the traces of the episodes into it, given the actions taken."""
        check_no_traces(folder)
        _make_writable(folder)
        return partial(self._write_traces, folder, self._world.written_config(folder / "config.yaml"))

    def _write_traces(self, folder: Path, config: str, exam: _logicity.Exam, taken: list[list[int]]) -> None:
        with Progress(f"{self.mode} {self.split}, traces", len(exam)) as progress:
            for at, actions in enumerate(taken):
                path = folder / f"episode-{at}.jsonl"
                self._task.write_trace(self.split, exam.episode(at), actions, path, config)
                progress.tell(at + 1)

    def _result(self, policy: str, told: Mapping[str, Any]) -> Evaluation:
        summary = told["summary"]

        def interval(of: Mapping[str, Any]) -> Interval:
            return Interval(of["value"], of["low"], of["high"])

        return Evaluation(
            policy=policy,
            mode=self.mode,
            split=self.split,
            episodes_hash=self.episodes_hash,
            tsr=interval(summary["tsr"]),
            dsr=interval(summary["dsr"]),
            dsr_by_action={rate["action"]: interval(rate) for rate in summary["dsr_by_action"]},
            score=interval(summary["score"]),
            mean_return=interval(summary["mean_return"]),
            mean_steps=summary["mean_steps"],
            episodes=tuple(
                EpisodeRecord(**{**record, "violations": tuple(record["violations"])}) for record in told["episodes"]
            ),
        )


def check_no_traces(folder: Path) -> None:
    """See that a folder has no traces: those of more episodes would stand among new ones as if they were of them."""
    earlier = min((path.name for path in folder.glob("episode-*.jsonl")), default=None)
    if earlier is not None:
        raise FileExistsError(f"`{folder}` has traces already, such as {earlier}: remove them, or give another folder")


def _make_writable(folder: Path) -> None:
    """Make a folder, or see that it can be written to."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


def _actor(policy: Policy, batched: bool, exam: _logicity.Exam) -> Callable[[Observations, NDArray[np.bool_]], Any]:
    """A function from all observations, and which episodes go on, to an action for each episode."""
    if isinstance(policy, str):
        if policy != "oracle":
            raise ValueError(f"unknown policy `{policy}`: give oracle, random, a model or a function")
        return lambda observations, running: exam.oracle_actions()
    predict = getattr(policy, "predict", None)
    if predict is not None:
        return _predicting(cast(Predictor, policy))
    if not callable(policy):
        raise TypeError(
            f"a policy is oracle, random, a model with `predict` or a function, not {type(policy).__name__}"
        )
    function = policy
    if batched:
        return lambda observations, running: function(observations)

    def one_by_one(observations: Observations, running: NDArray[np.bool_]) -> Any:
        actions = np.zeros(len(observations), np.int64)
        for at in np.flatnonzero(running):
            action = np.asarray(function(observations[at].copy()))
            if action.size != 1:
                raise ValueError(
                    f"a policy returns one action for an observation, not an array of shape {action.shape}"
                )
            actions[at] = _checked(action.reshape(1), 1)[0]
        return actions

    return one_by_one


def _predicting(model: Predictor) -> Callable[[Observations, NDArray[np.bool_]], Any]:
    """A model keeps a state between the steps if it is recurrent."""
    state: Any = None
    begins = True

    def act(observations: Observations, running: NDArray[np.bool_]) -> Any:
        nonlocal state, begins
        starts = np.full(len(observations), begins)
        begins = False
        actions, state = model.predict(observations, state=state, episode_start=starts, deterministic=True)
        return actions

    return act


def _checked(actions: Any, count: int) -> Actions:
    array = np.asarray(actions)
    if array.shape != (count,):
        raise ValueError(
            f"a policy returns an action for each of {count} observations, not an array of shape {array.shape}"
        )
    if not np.issubdtype(array.dtype, np.integer):
        raise TypeError(f"actions are integers, not {array.dtype}")
    return array.astype(np.int64)


def evaluate(
    policy: Policy,
    mode: str | os.PathLike[str],
    split: str = "test",
    *,
    batched: bool = False,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    observation: str = "atoms",
    traces: str | os.PathLike[str] | None = None,
) -> Evaluation:
    """Measure a policy on the recorded episodes of a mode or of a configuration file.

    What is given and raised is as for `Benchmark` and `Benchmark.evaluate`.
    """
    benchmark = Benchmark(mode, split, rules=rules, overrides=overrides, observation=observation)
    return benchmark.evaluate(policy, batched=batched, traces=traces)


def table(results: list[Evaluation]) -> str:
    """Rows as in the paper, one for each result."""
    head = ("policy", "mode", "TSR", "DSR", "Score", "return", "steps")
    rows = [
        (r.policy, r.mode, str(r.tsr), str(r.dsr), str(r.score), str(r.mean_return), f"{r.mean_steps:.1f}")
        for r in results
    ]
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in [head, *rows]]
    return "\n".join(line.rstrip() for line in lines)
