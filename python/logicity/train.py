"""Train DQN, PPO or A2C of Stable-Baselines3 from a configuration file. Needs the extra `train`.

Each run has a folder. `checkpoint-STEPS` holds the state to resume from: the model, the replay buffer, the best model
so far, and the validation results. `tensorboard` has the training curves. At the end, `best.zip` is the best model, and
`result.json` has its measures on the test episodes.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from functools import cache
from inspect import signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, TypeAlias, Union, get_args, get_origin
from zipfile import BadZipFile, ZipFile

from .errors import missing_extra

try:
    import gymnasium
    import stable_baselines3
    import torch
    from pydantic import (
        BaseModel,
        ConfigDict,
        Field,
        Strict,
        ValidationError,
        ValidationInfo,
        create_model,
        field_validator,
    )
    from pydantic_core import ErrorDetails, PydanticCustomError
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
from .files import reserved, write_json
from .modes import ENVIRONMENTS
from .sb3 import make_vec_env

__all__ = ["ALGORITHMS", "FeatureLayers", "TrainConfig", "load_model", "new_model", "train"]

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"dqn": DQN, "ppo": PPO, "a2c": A2C}


class FeatureLayers(BaseFeaturesExtractor):
    """Linear layers, each followed by ReLU, that all heads share."""

    def __init__(self, observation_space: gymnasium.Space[Any], widths: tuple[int, ...]) -> None:
        """Create layers of these widths after the flattened observation."""
        super().__init__(observation_space, widths[-1])
        ends = [gymnasium.spaces.flatdim(observation_space), *widths]
        layers: list[torch.nn.Module] = [torch.nn.Flatten()]
        for inputs, outputs in zip(ends[:-1], ends[1:], strict=True):
            layers += [torch.nn.Linear(inputs, outputs), torch.nn.ReLU()]
        self._layers = torch.nn.Sequential(*layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features of shape (batch, last width)."""
        features: torch.Tensor = self._layers(observations)
        return features


#: A positive integer. Booleans and strings are invalid.
Count: TypeAlias = Annotated[int, Field(strict=True, ge=1)]


class TrainConfig(BaseModel):
    """The configuration of a training run.

    Attributes:
        algorithm: `dqn`, `ppo` or `a2c`.
        mode: The mode, which determines the rules and the episodes.
        network: The widths of the feature layers between the observation and the heads.
        settings: Arguments of the algorithm's class in Stable-Baselines3.
        overrides: Changes to the configuration for training. Validation and test use the mode without overrides.
        steps: The total number of steps of all environments.
        envs: The number of parallel environments.
        seed: The seed of networks, exploration and episodes.
        validate_every: The number of steps between validations. Each validation writes a checkpoint.
        threads: The number of PyTorch threads.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    algorithm: str
    mode: str
    network: Annotated[tuple[Count, ...], Field(min_length=1)]
    settings: dict[str, Any]
    overrides: dict[str, Any] = Field(default_factory=dict)
    steps: Count = 200_000
    envs: Count = 1
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    validate_every: Count = 10_000
    threads: Count = 1

    @field_validator("algorithm")
    @classmethod
    def _known_algorithm(cls, name: str) -> str:
        return _known("algorithm", name, ALGORITHMS)

    @field_validator("mode")
    @classmethod
    def _known_mode(cls, name: str) -> str:
        return _known("mode", name, ENVIRONMENTS)

    @field_validator("settings")
    @classmethod
    def _valid_settings(cls, settings: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        algorithm = info.data.get("algorithm")
        if algorithm is None:
            # The validation of `algorithm` has reported an error already.
            return settings
        return _settings_model(algorithm).model_validate(settings).model_dump(exclude_unset=True)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, seed: int | None = None) -> TrainConfig:
        """Read a YAML file.

        The key `base` names another file, relative to this file. Its mappings are merged with those of this file. A
        bare name such as `dqn-easy` is a built-in configuration.

        Args:
            path: The file.
            seed: A seed that replaces the seed in the file.

        Raises:
            InputError: If the file is not YAML, has an unknown key or invalid value, or lacks a key. The diagnostics
                list all errors.
            OSError: If a file cannot be read.
        """
        file = _logicity.ConfigFile(path, "configs/baselines")
        values = file.value()
        if not isinstance(values, dict):
            raise file.error([("invalid-value", [], "a training configuration must be a mapping", "")])
        if seed is not None:
            values["seed"] = seed
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise file.error(_faults(error, values)) from None


def _known(what: str, name: str, known: Iterable[str]) -> str:
    if name in known:
        return name
    message = f"unknown {what} `{name}`{did_you_mean(name, known)}"
    raise PydanticCustomError("unknown_name", "{message}", {"message": message})


@cache
def _settings_model(algorithm: str) -> type[BaseModel]:
    """Create the pydantic model of an algorithm's settings from the signature of its class."""
    set_elsewhere = {"policy", "env", "policy_kwargs", "seed", "tensorboard_log", "device"}
    parameters = signature(ALGORITHMS[algorithm]).parameters.values()
    hints = {each.name: _expressible(each.annotation) for each in parameters if not each.name.startswith("_")}
    fields: dict[str, Any] = {
        name: (hint, None) for name, hint in hints.items() if hint is not None and name not in set_elsewhere
    }
    config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    return create_model(f"{algorithm.upper()} settings", __config__=config, **fields)


def _expressible(hint: Any) -> Any:
    """Return the part of a type that YAML can express, or `None` if there is none, as for functions and classes."""
    if get_origin(hint) in (Union, UnionType):
        parts = tuple(part for each in get_args(hint) if (part := _expressible(each)) is not None)
        return Union[parts] if parts else None  # noqa: UP007
    if get_origin(hint) is tuple:
        # YAML has lists instead of tuples.
        return Annotated[hint, Strict(False)]
    return hint if get_origin(hint) is dict or hint in (bool, dict, float, int, str, NoneType) else None


def _faults(error: ValidationError, values: Mapping[str, Any]) -> list[tuple[str, list[str], str, str]]:
    """Return the code, path, message and help of each error."""
    by_key: dict[tuple[str, ...], list[ErrorDetails]] = {}
    for each in error.errors(include_url=False):
        # For a union, every alternative reports an error and appends its name to the path.
        by_key.setdefault(tuple(map(str, each["loc"][:2])), []).append(each)
    return [_fault(path, errors, values) for path, errors in by_key.items()]


def _fault(
    path: tuple[str, ...], errors: Sequence[ErrorDetails], values: Mapping[str, Any]
) -> tuple[str, list[str], str, str]:
    first, name = errors[0], path[-1]
    if first["type"] == "extra_forbidden":
        if len(path) == 1:
            known, message = TrainConfig.model_fields, f"unknown key `{name}`"
        else:
            # Settings are checked only for a known algorithm.
            algorithm = values["algorithm"]
            known, message = _settings_model(algorithm).model_fields, f"{algorithm.upper()} has no setting `{name}`"
        return "unknown-key", list(path), message, did_you_mean(name, known).removeprefix("; ")
    if first["type"] == "missing":
        return "missing-key", list(path), f"the key `{name}` is missing", ""
    if first["type"] == "unknown_name":
        return "invalid-value", list(path), first["msg"], ""
    expected = [each["msg"].removeprefix("Input should be ") for each in errors if each["msg"].startswith("Input ")]
    if not expected:
        return "invalid-value", list(path), f"`{'.'.join(path)}`: {first['msg']}", ""
    shown = first["input"] if isinstance(first["input"], str) else json.dumps(first["input"], default=repr)
    message = f"`{'.'.join(path)}` must be {' or '.join(dict.fromkeys(expected))}, not `{shown:.40}`"
    return "invalid-value", list(path), message, ""


@dataclass
class State:
    """The progress of a run, without the model."""

    steps: int = 0
    seconds: float = 0.0
    best: dict[str, Any] | None = None
    validations: list[dict[str, Any]] = field(default_factory=list)


class Validation(BaseCallback):
    """Validates the model at intervals, keeps the best one, and writes checkpoints."""

    def __init__(self, run: Path, config: TrainConfig, state: State) -> None:
        """Start from a state."""
        super().__init__()
        self._run, self._config, self._state = run, config, state
        self._benchmark = Benchmark(config.mode, "val")
        self._since = time.monotonic() - state.seconds

    def _on_step(self) -> bool:
        # Validate at the first step at or after each multiple, because several environments may step over it.
        if self.num_timesteps // self._config.validate_every > self._state.steps // self._config.validate_every:
            self.validate()
        return True

    def _on_training_end(self) -> None:
        if self._state.steps < self.num_timesteps:
            self.validate()

    def validate(self) -> None:
        """Validate the model and write a checkpoint."""
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
        """Write a checkpoint atomically, then remove the older ones."""
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
        (temporary / "state.json").write_text(json.dumps(asdict(self._state), indent=1, allow_nan=False) + "\n")
        temporary.rename(self._run / name)
        for folder in old:
            shutil.rmtree(folder)


def _rank(point: Mapping[str, Any]) -> tuple[float, float]:
    return point["tsr"]["value"], point["score"]["value"]


def _figures(measured: Evaluation) -> dict[str, Any]:
    measures = measured.to_dict()
    return {name: measures[name] for name in ("tsr", "dsr", "dsr_by_action", "score", "mean_return", "mean_steps")}


def _checkpoints(run: Path) -> list[Path]:
    return sorted(run.glob("checkpoint-*"))


def load_model(path: str | os.PathLike[str]) -> BaseAlgorithm:
    """Load a DQN, PPO or A2C model that Stable-Baselines3 saved.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not such a model.
    """
    try:
        with ZipFile(path) as archive:
            saved = json.loads(archive.read("data"))
    except (BadZipFile, KeyError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)} is not a Stable-Baselines3 model: {error}") from None
    # The archive does not name its algorithm, but each algorithm has a distinctive setting.
    distinctive = {"dqn": "exploration_fraction", "ppo": "clip_range", "a2c": "normalize_advantage"}
    found = [name for name, setting in distinctive.items() if setting in saved]
    if not found:
        raise ValueError(f"{os.fspath(path)} is not a model of {', '.join(ALGORITHMS)}")
    name = "ppo" if "ppo" in found else found[0]
    return ALGORITHMS[name].load(path, device="cpu")


def train(
    config: TrainConfig, run: str | os.PathLike[str], *, progress: bool = False, tensorboard: bool = True
) -> dict[str, Any]:
    """Train a model, or resume from the last checkpoint of the same configuration.

    A resumed run continues from the last validation. It restores the weights, the optimizer, the replay buffer, the
    number of steps (and so the exploration rate), and the best model. It does not restore running episodes, a partial
    rollout of PPO or A2C, or the random states. New random streams start from the seed plus the number of steps. A
    resumed run therefore differs from an uninterrupted one, but two runs interrupted at the same point are identical.

    Args:
        config: The configuration.
        run: The folder of the run, which is created if it does not exist.
        progress: Whether to show a progress bar on the terminal.
        tensorboard: Whether to write training curves.

    Returns:
        The content of `result.json`.

    Raises:
        InputError: If an override is invalid.
        OSError: If another process trains in the folder, or a file cannot be written.
        ValueError: If the folder has another run or files of a run, or the algorithm rejects the settings. Then no run
            starts.
    """
    run = Path(run)
    claimed = _is_claimed(run, config)
    torch.set_num_threads(config.threads)
    checkpoints = _checkpoints(run)
    state = State(**json.loads((checkpoints[-1] / "state.json").read_text())) if checkpoints else State()
    # The model seeds the environments.
    env = make_vec_env(config.mode, config.envs, split="train", overrides=config.overrides)
    log = str(run / "tensorboard") if tensorboard else None
    with ExitStack() as files:
        files.callback(env.close)
        if checkpoints:
            model = ALGORITHMS[config.algorithm].load(
                checkpoints[-1] / "model.zip", env=env, device="cpu", tensorboard_log=log
            )
            if isinstance(model, OffPolicyAlgorithm):
                model.load_replay_buffer(checkpoints[-1] / "replay.pkl")
            # Loading restores the initial seed, which would repeat the same episodes.
            model.set_random_seed((config.seed + state.steps) % 2**32)
        else:
            model = new_model(config, env, log)
        if not claimed:
            run.mkdir(parents=True, exist_ok=True)
            write_json(run / "config.json", config.model_dump(mode="json"))
        # Keeps other processes from the run until its end.
        output = files.enter_context(reserved(run / "result.json", record=False))
        validation = Validation(run, config, state)
        bar = [ProgressBarCallback()] if progress else []
        model.learn(
            max(0, config.steps - state.steps),
            callback=CallbackList([validation, *bar]),
            reset_num_timesteps=not checkpoints,
            tb_log_name=config.algorithm,
        )
        shutil.copyfile(_checkpoints(run)[-1] / "best.zip", run / "best.zip")
        result = _result(config, state, load_model(run / "best.zip"))
        write_json(run / "result.json", result, output=output)
    return result


def _is_claimed(run: Path, config: TrainConfig) -> bool:
    """Return whether the folder already has this run.

    Raises:
        ValueError: If the folder has another run.
    """
    stored = run / "config.json"
    if not stored.exists():
        foreign = [path.name for path in (run / "result.json", run / "best.zip", *_checkpoints(run)) if path.exists()]
        if foreign:
            raise ValueError(f"{run} has {foreign[0]}, but no run: choose another folder")
        return False
    if json.loads(stored.read_text(encoding="utf-8")) != config.model_dump(mode="json"):
        raise ValueError(f"{run} has a run of another configuration; remove it or choose another folder")
    return True


def new_model(config: TrainConfig, env: VecEnv, log: str | None = None) -> BaseAlgorithm:
    """Create an untrained model.

    Args:
        config: The configuration.
        env: The environments.
        log: The folder of the training curves.

    Raises:
        ValueError: If the algorithm rejects the settings.
    """
    policy = {
        "features_extractor_class": FeatureLayers,
        "features_extractor_kwargs": {"widths": config.network},
        "net_arch": [],
    }
    try:
        return ALGORITHMS[config.algorithm](
            "MlpPolicy",
            env,
            policy_kwargs=policy,
            seed=config.seed,
            tensorboard_log=log,
            device="cpu",
            **config.settings,
        )
    except (AssertionError, TypeError, ValueError) as error:
        raise ValueError(f"{config.algorithm.upper()} rejects the `settings`: {error}") from error


def _result(config: TrainConfig, state: State, best: BaseAlgorithm) -> dict[str, Any]:
    measured = Benchmark(config.mode, "test").evaluate(best, name=config.algorithm)
    return {
        "config": config.model_dump(mode="json"),
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
