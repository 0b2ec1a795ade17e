"""Experiments of Safe Path Following: learners in modes, measured on recorded or new episodes."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from .. import _logicity
from .._logicity import __version__
from ..errors import InputError, did_you_mean
from ..evaluation import Benchmark, Interval
from ..files import read_json
from ..learn.config import TrainConfig, unused
from ..learn.faults import Fault, contains, merged
from ..learn.learner import LearnedPolicy
from ..learn.policies import load_policy
from ..learn.run import config_faults, train
from ..learn.settings import Count, Seed, StrictModel
from ..learn.storage import policy_hash
from ..modes import ENVIRONMENTS, checked_mode
from ..tasks import load_task, task_hashes
from .experiment import Experiment, Row, Selection, changes_of, fault_error, read_experiment
from .statistics import pooled
from .task import Cell, CellKey, Running, Task

__all__ = ["EvaluationSpec", "SafePathFollowing", "SpfExperiment", "per_episode", "violation_rates"]

#: The version of what determines a cell.
FORMAT = 1

#: The settings of a short run of a learner in environments, and of another learner.
QUICK = {True: {"steps": 512, "validate_every": 256}, False: {"steps": 8, "validate_every": 4}}

#: The evaluation that a training ends with.
TEST: dict[str, Any] = {"split": "test", "fresh": None, "seed": 0}


class SpfRow(Row):
    """A row of the table: a learner with its training configuration."""

    config: str | None = None
    """The training configuration, in the form of `config` of the experiment, which it replaces."""


class EvaluationSpec(StrictModel):
    """The episodes of an evaluation."""

    split: Literal["train", "val", "test"] = "test"
    """The split whose agents and episodes are used."""
    fresh: Count | None = None
    """The number of new episodes to generate, with the overrides. By default the recorded episodes of the split are
    used."""
    seed: Seed = 1000
    """The seed of the new episodes."""
    overrides: dict[str, Any] | None = None
    """Changes to the configuration of the mode, such as sensors and a shield."""


class SpfExperiment(Experiment):
    """An experiment of Safe Path Following."""

    task: Literal["spf"] = "spf"
    """The task, Safe Path Following. `changes` are changes to training configurations."""
    paper: Literal["spf", "transfer", "composition", "observations"] | None = None
    """The table of the paper whose figures are shown beside the results."""
    learners: Annotated[Mapping[str, SpfRow], Field(min_length=1)]
    """The rows of the table, by name: learners with their settings."""
    config: str = "{row}-{mode}"
    """The training configuration of each row: the name of a file in `configs/baselines`, or a path relative to this
    file. `{row}` and `{mode}` stand for the row and the mode."""
    evaluations: Annotated[dict[str, EvaluationSpec], Field(min_length=1)] = Field(
        default_factory=lambda: {"test": EvaluationSpec()}
    )
    """The evaluations of every policy, by name. By default one on the recorded test episodes."""


class SafePathFollowing(Task):
    """Learners of Safe Path Following, see `Task`."""

    name = "spf"
    title = "Safe Path Following"
    experiment = SpfExperiment
    measures: ClassVar[Mapping[str, str]] = {
        "tsr": "TSR",
        "dsr": "DSR",
        "score": "Score",
        "joint_tsr": "joint TSR",
        "observed": "observed",
    }
    main_measures = 3
    headline = "tsr"
    measured_on = "test episodes"
    sampled = "samples"
    more_measures = ("compliance",)
    interval_note = (
        "Intervals (95 %): over episodes for one seed (Wilson, or 1.96 standard errors for the score), over seeds "
        "and episodes for several (bootstrap; Wilson for rates of 0 or 1)."
    )
    details_title = "Share of episodes that end with a violation, by clause"
    paper = "spf"
    reusable = True
    sends_curves = True

    def mode_fault(self, folder: Path, path: list[str], mode: str) -> Fault | None:
        """Return the error of an unknown mode or a missing file, which may be in the folder, or `None`."""
        try:
            checked_mode(mode)
            if mode not in ENVIRONMENTS and not (folder / mode).exists():
                _logicity.ConfigFile(mode, "configs")
        except FileNotFoundError:
            return "missing-file", path, f"cannot read `{folder / mode}`: no such file", ""
        except InputError:
            # The file exists, and the message has its own location.
            return None
        except ValueError as error:
            return "invalid-value", path, str(error), ""
        return None

    def located_mode(self, mode: str, folder: Path) -> str:
        """Return the absolute path of a file, or the name of a mode."""
        is_file = mode not in ENVIRONMENTS and (folder / mode).is_file()
        return str((folder / mode).resolve()) if is_file else mode

    def faults(self, experiment: SpfExperiment, file: Path) -> Iterator[Fault]:
        """Yield the unknown placeholders in `config`."""
        known = ("{row}", "{mode}")
        configs: list[tuple[list[str], str]] = [(["config"], experiment.config)]
        configs += [(["learners", row, "config"], spec.config or "") for row, spec in experiment.learners.items()]
        for path, name in configs:
            for placeholder in re.findall(r"\{[^{}]*\}", name):
                if placeholder not in known:
                    message = f"unknown placeholder `{placeholder}`{did_you_mean(placeholder, known)}"
                    yield "invalid-value", path, message, ""

    def settings(
        self, experiment: SpfExperiment, file: Path, key: CellKey, selection: Selection, *, started: bool, check: bool
    ) -> TrainConfig:
        """Return the training configuration of a cell, without `start`."""
        spec = experiment.learners[key.row]
        name = (spec.config or experiment.config).replace("{row}", key.row).replace("{mode}", Path(key.mode).stem)
        path, in_file = _training_file(file, name), read_experiment(file)[1]
        places = experiment.places(key.row, key.variant, False)

        def rejected(wrong: list[Fault]) -> BaseException:
            return fault_error(in_file, wrong, selection.changes, places)

        def loaded() -> TrainConfig:
            changes = {"mode": key.mode, **changes_of(places, selection.changes)}
            return TrainConfig.load(path, seed=key.seed, changes=changes, rejected=rejected)

        try:
            config = loaded()
        except FileNotFoundError as error:
            at = ["learners", key.row, *(["config"] if spec.config else [])]
            help = "the key `config` names the training configuration"
            raise in_file.error([("missing-file", at, str(error), help)]) from None
        if selection.quick:
            places = experiment.places(key.row, key.variant, True, QUICK[config.learner.interacts])
            config = loaded()
        if started and (reason := unused(config.algorithm).get("start")):
            message = f"`{config.algorithm}` does not use the key `start`: {reason}"
            variant = experiment.variants[key.variant]
            of = ["variants", key.variant] if variant.start is not None else ["learners", key.row]
            raise in_file.error([("invalid-value", [*of, "start"], message, "")])
        if check and (wrong := config_faults(config, selection.trust)):
            everywhere = [*(values for _, values in places), selection.changes]
            written = [fault for fault in wrong if any(contains(values, fault[1]) for values in everywhere)]
            # The other faults are in the training configuration.
            raise rejected(written) if written else _logicity.ConfigFile(path, "configs/baselines").error(wrong)
        return config

    def evaluations(self, experiment: SpfExperiment) -> dict[str, dict[str, Any]]:
        """Return the splits, the numbers of new episodes or `None` for the recorded ones, their seeds and overrides."""
        return {
            # The seed has no effect on recorded episodes.
            name: each.model_dump(exclude=None if each.overrides else {"overrides"})
            | ({"seed": TEST["seed"]} if each.fresh is None else {})
            for name, each in experiment.evaluations.items()
        }

    def spec(self, cell: Cell) -> dict[str, Any]:
        """Return the settings, rules, episodes, evaluations and version."""
        config = cell.settings.to_dict()
        mode = config.pop("mode")
        return {
            "format": FORMAT,
            "version": __version__,
            "mode": Path(mode).name,
            "config": config,
            "hashes": _hashes(mode),
            "evaluations": {name: dict(each) for name, each in cell.evaluations.items()},
            "start": None if cell.start is None else cell.start.identity,
        }

    def document(self, cell: Cell, root: Path) -> dict[str, Any]:
        """Return the training configuration."""
        return {"config": cell.settings.to_dict()}

    def steps(self, cell: Cell) -> int:
        """Return the number of training steps."""
        return int(cell.settings.steps)

    def model(self, folder: Path) -> Path:
        """Return the file of the best policy."""
        return load_policy(folder).path

    def run(self, running: Running) -> dict[str, Any]:
        """Train, and evaluate the best policy."""
        folder, spec, values = running.folder, running.document["spec"], dict(running.document["config"])
        for start in folder.glob("start.*"):
            values["start"] = str(start)
        config = TrainConfig.model_validate(values)
        changed = [name for name, value in task_hashes(config.mode).items() if spec["hashes"].get(name) != value]
        if changed:
            raise ValueError(
                f"`{config.mode}` has another content of {', '.join(changed)} than when the experiment began: run the "
                "same command again"
            )
        options = {name: getattr(running, name) for name in ("progress", "report", "wandb", "trust")}
        result = _trained(folder) or train(config, folder, **options)
        evaluations = _evaluated(folder, config, spec["evaluations"], load_policy(folder).policy, result["test"])
        if config.start is not None:
            # The path depends on the machine; the hash of the file is in the result.
            result["config"]["start"] = Path(config.start).name
        return {"result": {key: result[key] for key in result if key != "test"}, "evaluations": evaluations}

    def measure_again(self, cell: Cell, root: Path) -> dict[str, dict[str, Any]]:
        """Evaluate the best policy."""
        # As in `run`. Several threads would wait for each other at every step.
        torch.set_num_threads(cell.settings.threads)
        folder = cell.folder(root)
        try:
            policy = load_policy(folder).policy
        except ValueError as error:
            raise ValueError(f"{error}: delete `{folder}` and train the cell again") from None
        return _evaluated(folder, cell.settings, cell.evaluations, policy)

    def hashed(self, cell: Cell, root: Path) -> tuple[str, str]:
        """Return the hash of the weights of the best policy, or of its rules."""
        return policy_hash(load_policy(cell.folder(root)).policy)

    def intervals(self, evaluations: Sequence[Mapping[str, Any]]) -> dict[str, Interval]:
        """Return the measures with 95 % intervals: those of the evaluation of one run, or of several, see `pooled`."""
        if len(evaluations) == 1:
            known = {name: Interval(**evaluations[0][name]) for name in self.measures if name in evaluations[0]}
            more = {name: values for name, values in per_episode(evaluations[0]).items() if name not in known}
            return known | (pooled([more]) if more else {})
        return pooled([per_episode(each) for each in evaluations], rates=("tsr", "dsr", "joint_tsr"))

    def samples(self, evaluation: Mapping[str, Any]) -> dict[str, list[float]]:
        """Return success, decision success and score of each episode."""
        values = per_episode(evaluation)
        return {name: [round(float(value), 4) for value in values[name]] for name in self.measures if name in values}

    def evaluation_of(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return the measures and the values of the episodes."""
        return {**row["measures"], **super().evaluation_of(row)}

    def details(self, measured: Mapping[str, Any], name: str) -> dict[str, float]:
        """Return the share of episodes that end because the policy violates a clause, by clause."""
        mode = measured["result"]["config"]["mode"]
        return violation_rates([measured["evaluations"][name]], clauses_of(mode))

    def curve(self, measured: Mapping[str, Any]) -> list[tuple[int, float]]:
        """Return the TSR of the validations by step."""
        return [(point["steps"], point["tsr"]["value"]) for point in measured["result"]["validations"]]

    def row_faults(self, row: Mapping[str, Any], experiment: SpfExperiment) -> Iterator[str]:
        """Yield the names of hashes that are not those of this version."""
        if row["mode"] not in ENVIRONMENTS:
            yield "published results are of built-in modes"
            return
        if different := [name for name, value in _hashes(row["mode"]).items() if row["hashes"].get(name) != value]:
            yield f"other {', '.join(different)}"


def per_episode(evaluation: Mapping[str, Any]) -> dict[str, NDArray[np.float64]]:
    """Return the measures of each episode.

    TSR and DSR are 0 or 1, and Score is the return minus the random policy's mean return. With several egos they are
    means over the egos, and there is the joint TSR. If others may tell the ego facts, there is also the share of
    applying clauses that it observed fully, or 1 if none applied.
    """
    if "samples" in evaluation:
        return {name: np.array(values, np.float64) for name, values in evaluation["samples"].items()}
    records = sorted(evaluation["episodes"], key=lambda record: record["episode"])
    kept = [any(record["constrained"].values()) and not record["violations"] for record in records]
    random = np.array(evaluation["random_returns"])

    def by_episode(values: Iterable[float]) -> NDArray[np.float64]:
        return np.array(list(values), np.float64).reshape(len(random), -1)

    success = by_episode(record["success"] for record in records)
    measures = {
        "tsr": success.mean(1),
        "dsr": by_episode(kept).mean(1),
        "score": by_episode(record["total"] for record in records).mean(1) - random,
    }
    if success.shape[1] > 1:
        measures["joint_tsr"] = success.min(1)
    if records and "observed_clauses" in records[0]:
        counts = (
            np.array([record["observed_clauses"] for record in records], np.float64).reshape(len(random), -1, 3).sum(1)
        )
        measures["observed"] = np.where(counts.sum(1) > 0, counts[:, 0] / np.maximum(counts.sum(1), 1), 1.0)
    return measures


@cache
def clauses_of(mode: str) -> tuple[str, ...]:
    """Return the names of the clauses of a mode that actions can violate."""
    return tuple(each["clause"] for each in _logicity.describe(load_task(mode))["constraints"])


def violation_rates(evaluations: Sequence[Mapping[str, Any]], clauses: Iterable[str]) -> dict[str, float]:
    """Return, for each of the clauses, the share of the episodes of all runs whose last action violates it."""
    records = [record for evaluation in evaluations for record in evaluation["episodes"]]
    counts = Counter(clause for record in records for clause in record["violations"])
    return {clause: counts[clause] / len(records) for clause in sorted(clauses, key=_by_name)}


def _by_name(clause: str) -> tuple[str, int, str]:
    """Order clauses by their letter and number: `S2` before `S10`."""
    letters = clause.rstrip("0123456789")
    return letters, int(clause[len(letters) :] or 0), clause


_hashes = cache(task_hashes)


def _training_file(file: Path, name: str) -> Path:
    """Return the path of a training configuration that an experiment names."""
    if Path(name).suffix:
        return file.parent / name
    beside = file.parent.parent / "baselines" / f"{name}.yaml"
    return beside if beside.exists() else Path("configs") / "baselines" / f"{name}.yaml"


def _trained(folder: Path) -> dict[str, Any] | None:
    """Return the result of a finished training in the folder of a cell that was reused or lost its `measured.json`."""
    try:
        result = read_json(folder / "result.json")
    except (FileNotFoundError, ValueError):
        return None
    complete = isinstance(result, dict) and "test" in result and any(folder.glob("best.*"))
    return result if complete else None


def _evaluated(
    folder: Path,
    config: TrainConfig,
    evaluations: Mapping[str, Mapping[str, Any]],
    policy: LearnedPolicy,
    tested: Mapping[str, Any] | None = None,
) -> dict[str, dict[str, Any]]:
    """Return the evaluations of a policy. `tested` is that of `TEST`, if there is one already.

    New episodes are made in the folder of the cell, once.
    """
    done = {}
    for name, each in evaluations.items():
        overrides = merged(config.evaluation_overrides() or {}, each.get("overrides") or {}) or None
        mode = config.mode if each["fresh"] is None else _fresh(folder, config.mode, each, overrides or {})
        benchmark = Benchmark(mode, each["split"], observation=config.observation, overrides=overrides)
        if tested is not None and each == TEST:
            result = dict(tested)
        else:
            result = benchmark.evaluate(policy, name=config.algorithm).to_dict()
            # Not the path of the file of new episodes, which depends on the machine.
            result["mode"] = Path(config.mode).name
        done[name] = {**result, "random_returns": benchmark.random_returns()}
    return done


def _fresh(folder: Path, mode: str, evaluation: Mapping[str, Any], overrides: Mapping[str, Any]) -> str:
    """Make new episodes of a split in a folder, and return a configuration file that names them.

    Overrides apply, except for those of `task`: episodes that differ only in sensors, shields and egos are the same.
    """
    split, count, seed = evaluation["split"], evaluation["fresh"], evaluation["seed"]
    city = {key: value for key, value in overrides.items() if key != "task"}
    changed = "-" + hashlib.sha256(json.dumps(city, sort_keys=True).encode()).hexdigest()[:12] if city else ""
    episodes = folder / f"fresh-{split}-{count}-{seed}{changed}.jsonl"
    config = episodes.with_suffix(".yaml")
    if mode in ENVIRONMENTS:
        base = f"configs/{mode}.yaml"
    else:
        base = str(Path(mode).resolve()) if Path(mode).is_file() else mode
    if not episodes.exists():
        drawn = mode
        if city:
            drawn = str(config)
            config.write_text(json.dumps({"base": base, **city}), encoding="utf-8", newline="\n")
        options = ["--split", split, "--count", str(count), "--seed", str(seed), "-o", str(episodes)]
        code, _, _ = _logicity.run_command_line(["episodes", "make", drawn, *options])
        if code:
            raise OSError(f"`logicity episodes make {drawn} {' '.join(options)}` failed")
    task = f"task: {{episodes: {{{split}: {episodes.name}}}}}\n"
    config.write_text(f"base: {json.dumps(base)}\n{task}", encoding="utf-8", newline="\n")
    return str(config)
