"""Train DQN, PPO or A2C of Stable-Baselines3 as a configuration says. Needs the extra `train`.

A run has a folder. `checkpoint-STEPS` holds all that it takes to go on after a kill: the model, the replay buffer,
the model that did best on the validation episodes so far, and what validation said. `tensorboard` has the curves. At
the end there is the best model as `best.zip`, and `result.json` says how it does on the test episodes.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from inspect import signature
from math import isfinite
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin
from zipfile import BadZipFile, ZipFile

import gymnasium

from .errors import missing_extra

try:
    import stable_baselines3
    import torch
    import yaml
except ImportError as error:
    raise missing_extra("train", error) from error
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ProgressBarCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv

from . import _logicity
from ._logicity import __version__
from .errors import did_you_mean
from .evaluation import Benchmark, Evaluation
from .files import write_json
from .modes import ENVIRONMENTS
from .sb3 import make_vec_env

__all__ = ["ALGORITHMS", "FeatureLayers", "TrainConfig", "load_model", "new_model", "train"]

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"dqn": DQN, "ppo": PPO, "a2c": A2C}


class FeatureLayers(BaseFeaturesExtractor):
    """Linear layers with ReLU after each, shared by all heads."""

    def __init__(self, observation_space: gymnasium.Space[Any], widths: tuple[int, ...]) -> None:
        """Layers of these widths after the flattened observation."""
        super().__init__(observation_space, widths[-1])
        ends = [gymnasium.spaces.flatdim(observation_space), *widths]
        layers: list[torch.nn.Module] = [torch.nn.Flatten()]
        for inputs, outputs in zip(ends[:-1], ends[1:], strict=True):
            layers += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU()]
        self._layers = torch.nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features, shape (batch, last width)."""
        features: torch.Tensor = self._layers(observations)
        return features


@dataclass(frozen=True)
class TrainConfig:
    """What a training run is.

    - `algorithm`: `dqn`, `ppo` or `a2c`; `settings` are arguments of its class in Stable-Baselines3 that JSON can say.
    - `mode`: whose rules and episodes; `overrides` change the task in training only: validation and test are the mode's
      own.
    - `network`: widths of the feature layers, each with ReLU, between the observation and the heads.
    - `envs`: how many environments are stepped together. `steps` counts the steps of all.
    - `seed`: of networks, exploration and episodes.
    - `validate_every`: so many steps lie between two validations, each followed by a checkpoint.
    - `threads`: of torch.
    """

    algorithm: str
    mode: str
    network: tuple[int, ...]
    settings: Mapping[str, Any]
    overrides: Mapping[str, Any] = field(default_factory=dict)
    steps: int = 200_000
    envs: int = 1
    seed: int = 0
    validate_every: int = 10_000
    threads: int = 1

    def __post_init__(self) -> None:
        """Find what cannot be meant."""
        if self.algorithm not in ALGORITHMS:
            raise ValueError(f"unknown algorithm `{self.algorithm}`: it is one of {', '.join(ALGORITHMS)}")
        if self.mode not in ENVIRONMENTS:
            raise ValueError(f"unknown mode `{self.mode}`: it is one of {', '.join(ENVIRONMENTS)}")
        for name in ("steps", "envs", "validate_every", "threads"):
            if not _is_count(getattr(self, name)):
                raise ValueError(f"`{name}` is a number from 1 on, not {getattr(self, name)!r}")
        if not isinstance(self.seed, int) or not 0 <= self.seed < 2**32:
            raise ValueError(f"`seed` is a number from 0 to 2**32 - 1, not {self.seed!r}")
        if (
            not isinstance(self.network, tuple)
            or not self.network
            or not all(_is_count(width) for width in self.network)
        ):
            raise ValueError(f"`network` is a list of widths from 1 on, not {self.network!r}")
        for name in ("settings", "overrides"):
            if not isinstance(getattr(self, name), Mapping):
                raise ValueError(f"`{name}` is a mapping, not {getattr(self, name)!r}")
        hints = _settings_of(self.algorithm)
        for name, value in self.settings.items():
            if name not in hints:
                raise ValueError(f"`settings`: {self.algorithm.upper()} has no `{name}`{did_you_mean(name, hints)}")
            if not _fits(value, hints[name]):
                raise ValueError(f"`settings`: `{name}` cannot be {value!r}")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> TrainConfig:
        """Read a YAML file. `base` names another one, relative to it, that it changes; mappings are merged.

        Raises:
            OSError: a file cannot be read.
            ValueError: it is not YAML, has an unknown key or lacks one, or a value cannot be meant.
        """
        tree = _load_tree(Path(path), ())
        known = {each.name for each in fields(TrainConfig)}
        if unknown := sorted(set(tree) - known):
            raise ValueError(f"{path}: unknown key `{unknown[0]}`: known are {', '.join(sorted(known))}")
        if isinstance(tree.get("network"), list):
            tree["network"] = tuple(tree["network"])
        try:
            return TrainConfig(**tree)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: {error}") from None


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1


def _settings_of(algorithm: str) -> dict[str, Any]:
    """The arguments of an algorithm that a configuration may give, with their types."""
    ours = {"policy", "env", "policy_kwargs", "seed", "tensorboard_log", "device"}
    known = signature(ALGORITHMS[algorithm]).parameters.values()
    return {each.name: each.annotation for each in known if each.name not in ours and not each.name.startswith("_")}


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type. Of what a file cannot say, such as functions, nothing is."""
    if get_origin(hint) in (Union, UnionType):
        return any(_fits(value, each) for each in get_args(hint))
    if get_origin(hint) is tuple:
        parts = get_args(hint)
        return isinstance(value, (list, tuple)) and len(value) == len(parts) and all(map(_fits, value, parts))
    if get_origin(hint) is dict:
        return isinstance(value, dict)
    if hint in (int, float):
        # A truth value is an `int` to Python, and no number to whoever writes it.
        allowed = (int, float) if hint is float else int
        return isinstance(value, allowed) and not isinstance(value, bool) and isfinite(value)
    return hint in (bool, str, NoneType) and isinstance(value, hint)


class _Loader(yaml.SafeLoader):
    """Reads `3e-5` as the number that YAML 1.2 says it is; 1.1 wants a point in it."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+\Z"), list("-+.0123456789")
)


def _load_tree(path: Path, users: tuple[Path, ...]) -> dict[str, Any]:
    if path.resolve() in users:
        raise ValueError(f"{path}: its `base` leads back to it")
    text = _logicity.read_file(path)
    try:
        tree = yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: {error}") from None
    if not isinstance(tree, dict):
        raise ValueError(f"{path}: it is no mapping")
    base = tree.pop("base", None)
    if base is None:
        return tree
    return _merged(_load_tree(path.parent / str(base), (*users, path.resolve())), tree)


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in changes.items():
        both = isinstance(merged.get(key), dict) and isinstance(value, dict)
        merged[key] = _merged(merged[key], value) if both else value
    return merged


@dataclass
class State:
    """How far a run is, beside the model."""

    steps: int = 0
    seconds: float = 0.0
    best: dict[str, Any] | None = None
    validations: list[dict[str, Any]] = field(default_factory=list)


class Validation(BaseCallback):
    """Validates the model every so many steps, keeps the best one, and writes a checkpoint."""

    def __init__(self, run: Path, config: TrainConfig, state: State) -> None:
        """A run goes on from a state."""
        super().__init__()
        self._run, self._config, self._state = run, config, state
        self._benchmark = Benchmark(config.mode, "val")
        self._since = time.monotonic() - state.seconds

    def _on_step(self) -> bool:
        # The first step at or after each multiple: several environments may step over it.
        if self.num_timesteps // self._config.validate_every > self._state.steps // self._config.validate_every:
            self.validate()
        return True

    def _on_training_end(self) -> None:
        if self._state.steps < self.num_timesteps:
            self.validate()

    def validate(self) -> None:
        """Measure, and write a checkpoint."""
        measured = self._benchmark.evaluate(self.model)
        self._state.steps = self.num_timesteps
        self._state.seconds = time.monotonic() - self._since
        point = {"steps": self.num_timesteps, "seconds": round(self._state.seconds, 1), **_figures(measured)}
        self._state.validations.append(point)
        for name in ("tsr", "dsr", "score"):
            self.logger.record(f"validation/{name}", point[name]["value"])
        best = self._state.best
        if best is None or _rank(point) > _rank(best):
            self._state.best = point
        self._checkpoint()

    def _checkpoint(self) -> None:
        """Write all that it takes to go on, under a temporary name; then the older ones are not needed."""
        name = f"checkpoint-{self._state.steps:010}"
        temporary = self._run / f".{name}"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir()
        self.model.save(temporary / "model.zip")
        if isinstance(self.model, OffPolicyAlgorithm):
            self.model.save_replay_buffer(temporary / "replay.pkl")
        old = _checkpoints(self._run)
        is_best = self._state.best is self._state.validations[-1]
        shutil.copyfile(temporary / "model.zip" if is_best else old[-1] / "best.zip", temporary / "best.zip")
        write_json(temporary / "state.json", asdict(self._state))
        temporary.rename(self._run / name)
        for folder in old:
            shutil.rmtree(folder)


def _rank(point: Mapping[str, Any]) -> tuple[float, float]:
    return point["tsr"]["value"], point["score"]["value"]


def _figures(measured: Evaluation) -> dict[str, Any]:
    told = measured.to_dict()
    return {name: told[name] for name in ("tsr", "dsr", "dsr_by_action", "score", "mean_return", "mean_steps")}


def _checkpoints(run: Path) -> list[Path]:
    return sorted(run.glob("checkpoint-*"))


def load_model(path: str | os.PathLike[str]) -> BaseAlgorithm:
    """Load a model of DQN, PPO or A2C that Stable-Baselines3 saved.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such model.
    """
    try:
        with ZipFile(path) as archive:
            saved = json.loads(archive.read("data"))
    except (BadZipFile, KeyError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)} is no model of Stable-Baselines3: {error}") from None
    # The archive does not name its algorithm; each has a setting that the others lack.
    telling = {"dqn": "exploration_fraction", "ppo": "clip_range", "a2c": "normalize_advantage"}
    found = [name for name, setting in telling.items() if setting in saved]
    if not found:
        raise ValueError(f"{os.fspath(path)} is no model of {', '.join(ALGORITHMS)}")
    name = "ppo" if "ppo" in found else found[0]
    return ALGORITHMS[name].load(path, device="cpu")


def train(
    config: TrainConfig, run: str | os.PathLike[str], *, progress: bool = False, tensorboard: bool = True
) -> dict[str, Any]:
    """Train, or go on from the last checkpoint of the same configuration; return what `result.json` has.

    After a kill it goes on from the last validation: weights, optimizer, replay buffer, number of steps and with it the
    rate of exploration, and the best model so far are as they were then. Lost are the episodes that went on, a rollout
    of PPO or A2C that was not full, and the states of the random streams; new episodes and draws follow from the sum of
    the seed and the number of steps. So a run that was killed does not end as one that was not, bit for bit, but as any
    other that was killed there.

    Args:
        config: what to train.
        run: the folder of the run; made if it is not there.
        progress: whether to show a bar on the terminal.
        tensorboard: whether to write curves.

    Raises:
        ValueError: the folder has another run, or the algorithm cannot be made with the settings. No run begins then.
        InputError: a faulty override.
    """
    run = Path(run)
    claimed = _is_claimed(run, config)
    torch.set_num_threads(config.threads)
    checkpoints = _checkpoints(run)
    state = State(**json.loads((checkpoints[-1] / "state.json").read_text())) if checkpoints else State()
    # The model seeds it.
    env = make_vec_env(config.mode, config.envs, split="train", overrides=config.overrides)
    log = str(run / "tensorboard") if tensorboard else None
    try:
        if checkpoints:
            model = ALGORITHMS[config.algorithm].load(
                checkpoints[-1] / "model.zip", env=env, device="cpu", tensorboard_log=log
            )
            if isinstance(model, OffPolicyAlgorithm):
                model.load_replay_buffer(checkpoints[-1] / "replay.pkl")
            # Loading has seeded everything as at the beginning, which would bring the same episodes again.
            model.set_random_seed((config.seed + state.steps) % 2**32)
        else:
            model = new_model(config, env, log)
        if not claimed:
            run.mkdir(parents=True, exist_ok=True)
            write_json(run / "config.json", asdict(config))
        validation = Validation(run, config, state)
        bar = [ProgressBarCallback()] if progress else []
        model.learn(
            max(0, config.steps - state.steps),
            callback=CallbackList([validation, *bar]),
            reset_num_timesteps=not checkpoints,
            tb_log_name=config.algorithm,
        )
    finally:
        env.close()
    shutil.copyfile(_checkpoints(run)[-1] / "best.zip", run / "best.zip")
    result = _result(config, state, load_model(run / "best.zip"))
    write_json(run / "result.json", result)
    return result


def _is_claimed(run: Path, config: TrainConfig) -> bool:
    """Whether a folder has this run, of which a note is there; another run is refused."""
    note = run / "config.json"
    if not note.exists():
        return False
    if json.loads(note.read_text(encoding="utf-8")) != json.loads(json.dumps(asdict(config))):
        raise ValueError(f"{run} has a run of another configuration; remove it or name another folder")
    return True


def new_model(config: TrainConfig, env: VecEnv, log: str | None = None) -> BaseAlgorithm:
    """Make an untrained model; `log` is the folder of the curves.

    Raises:
        ValueError: the algorithm cannot be made with the settings.
    """
    policy = {
        "features_extractor_class": FeatureLayers,
        "features_extractor_kwargs": {"widths": config.network},
        "net_arch": [],
    }
    # Files have lists where the algorithms want tuples, as in `train_freq: [4, step]`.
    settings = {name: tuple(value) if isinstance(value, list) else value for name, value in config.settings.items()}
    try:
        return ALGORITHMS[config.algorithm](
            "MlpPolicy",
            env,
            policy_kwargs=policy,
            seed=config.seed,
            tensorboard_log=log,
            device="cpu",
            **settings,
        )
    except (AssertionError, TypeError, ValueError) as error:
        raise ValueError(f"`settings`: {config.algorithm.upper()} cannot be made with them: {error}") from error


def _result(config: TrainConfig, state: State, best: BaseAlgorithm) -> dict[str, Any]:
    measured = Benchmark(config.mode, "test").evaluate(best, name=config.algorithm)
    return {
        "config": asdict(config),
        "versions": {
            "logicity": __version__,
            "stable_baselines3": stable_baselines3.__version__,
            "torch": torch.__version__,
        },
        "steps": state.steps,
        "minutes": round(state.seconds / 60, 2),
        "best": state.best,
        "test": measured.to_dict(),
        "validations": state.validations,
    }
