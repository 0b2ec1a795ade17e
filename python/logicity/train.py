"""Train DQN, PPO or A2C of Stable-Baselines3 from a configuration file. Needs the extra `train`.

Each run has a folder. `checkpoint-STEPS` holds the state to resume from: the model, the replay buffer, the best model
so far, and the validation results. `tensorboard` has the training curves. At the end, `best.zip` is the best model, and
`result.json` has its measures on the test episodes.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from .env_config import ObservationKind
from .errors import did_you_mean
from .evaluation import MEASURES, Benchmark, Evaluation
from .files import reserved, write_json
from .modes import ENVIRONMENTS, checked_mode
from .sb3 import make_vec_env

__all__ = ["ALGORITHMS", "FeatureLayers", "TrainConfig", "load_model", "new_model", "train"]

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {"dqn": DQN, "ppo": PPO, "a2c": A2C}
"""The class of each algorithm in Stable-Baselines3, keyed by its name in configurations."""


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
    """The configuration of a training run. `logicity schema training` prints the schema of its YAML files."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    algorithm: str
    """`dqn`, `ppo` or `a2c`."""
    mode: str
    """The mode, or the path of a configuration file, which determines the rules and the episodes. In a YAML file, a
    path is relative to the folder of that file."""
    observation: ObservationKind = "groundings"
    """The kind of observation, as in `gymnasium.make`."""
    network: Annotated[tuple[Count, ...], Field(min_length=1)]
    """The widths of the feature layers between the observation and the heads."""
    settings: dict[str, Any]
    """Arguments of the algorithm's class in Stable-Baselines3."""
    overrides: dict[str, Any] = Field(default_factory=dict)
    """Changes to the configuration for training. Validation and test use the mode without overrides."""
    steps: Count = 200_000
    """The total number of steps of all environments. Only `steps` may change when a run resumes."""
    envs: Count = 1
    """The number of parallel environments."""
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    """The seed of networks, exploration and episodes."""
    validate_every: Count = 10_000
    """The number of steps between validations. Each validation writes a checkpoint."""
    threads: Count = 1
    """The number of PyTorch threads."""

    @field_validator("algorithm")
    @classmethod
    def _known_algorithm(cls, name: str) -> str:
        return _known("algorithm", name, ALGORITHMS)

    @field_validator("mode")
    @classmethod
    def _known_mode(cls, name: str) -> str:
        try:
            return checked_mode(name)
        except ValueError as error:
            raise _custom(str(error)) from None

    @field_validator("settings")
    @classmethod
    def _valid_settings(cls, settings: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        algorithm = info.data.get("algorithm")
        if algorithm is None:
            # The validation of `algorithm` has reported an error already.
            return settings
        return _settings_model(algorithm).model_validate(settings).model_dump(exclude_unset=True)

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """Return the JSON Schema of YAML files. No key is required, since the file that `base` names may contain it."""
        keys = {key: _tidy(value) for key, value in cls.model_json_schema()["properties"].items()}
        keys["algorithm"] = {"enum": list(ALGORITHMS), "description": keys["algorithm"]["description"]}
        models = {name: _settings_model(name) for name in ALGORITHMS}
        definitions = {}
        for name, model in models.items():
            schema = model.model_json_schema()
            values = {key: _tidy(value) for key, value in schema["properties"].items()}
            definitions[name] = {**schema, "title": f"Settings of {name.upper()}", "properties": values}
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
                    "then": {"properties": {"settings": {"$ref": f"#/$defs/{name}"}}},
                }
                for name in ALGORITHMS
            ],
            "$defs": definitions,
        }

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
        mode = values.get("mode")
        if isinstance(mode, str) and mode not in ENVIRONMENTS:
            values["mode"] = _mode_file(file, mode, Path(file.file_of(["mode"]) or path).parent)
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise file.error(_faults(error, values)) from None


def _mode_file(file: _logicity.ConfigFile, mode: str, folder: Path) -> str:
    """Return the absolute path of a mode's configuration file, or `mode` if it names a built-in file or no file.

    As in run configurations, a path is relative to the folder of the file that contains it, or names a built-in file.

    Raises:
        InputError: If the path names no file.
    """
    at = folder / mode
    if at.exists():
        return str(at.resolve())
    if at.suffix and mode not in _BUILTIN_MODES:
        raise file.error([("missing-file", ["mode"], f"cannot read `{at}`: no such file", "")])
    return mode


#: The paths of the modes among the built-in files.
_BUILTIN_MODES = {f"configs/{name}.yaml" for name in ENVIRONMENTS}


def _tidy(schema: Any) -> Any:
    """Return a part of a schema without the titles that pydantic makes from names and without line breaks."""
    if isinstance(schema, dict):
        return {key: _tidy(value) for key, value in schema.items() if key != "title"}
    if isinstance(schema, str):
        return " ".join(schema.split())
    return [_tidy(value) for value in schema] if isinstance(schema, list) else schema


def _known(what: str, name: str, known: Iterable[str]) -> str:
    if name in known:
        return name
    raise _custom(f"unknown {what} `{name}`{did_you_mean(name, known)}")


def _custom(message: str) -> PydanticCustomError:
    return PydanticCustomError("unknown_name", "{message}", {"message": message})


@cache
def _settings_model(algorithm: str) -> type[BaseModel]:
    """Create the pydantic model of an algorithm's settings from the signature of its class."""
    set_elsewhere = {"policy", "env", "policy_kwargs", "seed", "tensorboard_log", "device"}
    parameters = signature(ALGORITHMS[algorithm]).parameters.values()
    fields: dict[str, Any] = {}
    for each in parameters:
        hint = _expressible(each.annotation)
        if hint not in (None, NoneType) and each.name not in set_elsewhere and not each.name.startswith("_"):
            # Only the schema shows the default: a setting that is not given keeps that of the class.
            fields[each.name] = (hint, each.default)
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
    expected = " or ".join(dict.fromkeys(map(_expected, errors)))
    shown = first["input"] if isinstance(first["input"], str) else json.dumps(first["input"], default=repr)
    message = f"`{'.'.join(path)}` must be {expected}, not `{shown:.40}`"
    return "invalid-value", list(path), message, ""


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


def _expected(error: ErrorDetails) -> str:
    """Describe the values that a key accepts."""
    kind, context = error["type"], error.get("ctx", {})
    if kind in _EXPECTED:
        return _EXPECTED[kind]
    if kind == "literal_error":
        return str(context["expected"]).replace("'", "`")
    if kind == "greater_than_equal":
        return f"at least {context['ge']}"
    if kind == "less_than":
        return f"less than {context['lt']}"
    if kind == "too_short":
        return f"a list of {context['min_length']} or more values"
    if kind == "too_long":
        return f"a list of at most {context['max_length']} values"
    return f"valid ({error['msg']})"


@dataclass
class State:
    """The progress of a run, without the model."""

    steps: int = 0
    seconds: float = 0.0
    best: dict[str, Any] | None = None
    validations: list[dict[str, Any]] = field(default_factory=list)


class Validation(BaseCallback):
    """Validates the model at intervals, keeps the best one, and writes checkpoints."""

    def __init__(
        self, run: Path, config: TrainConfig, state: State, benchmark: Benchmark, log: Callable[[str], None]
    ) -> None:
        """Start from a state. `log` receives a line per validation."""
        super().__init__()
        self._run, self._config, self._state = run, config, state
        self._benchmark, self._log = benchmark, log
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
        for name in MEASURES:
            self.logger.record(f"validation/{name}", point[name]["value"])
        self._log(f"validation after {self.num_timesteps:,} steps: {measured.summary()}")
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
    return {name: measures[name] for name in (*MEASURES, "dsr_by_action", "mean_return", "mean_steps")}


class ProgressLines(BaseCallback):
    """Logs the number of steps, the speed and the remaining time at intervals, for logs without a terminal."""

    #: The interval between two lines.
    SECONDS = 10.0

    def __init__(self, steps: int, log: Callable[[str], None]) -> None:
        """Store the total number of steps, and the function that receives the lines."""
        super().__init__()
        self._steps, self._log = steps, log

    def _on_training_start(self) -> None:
        self._begun = self._shown = time.monotonic()
        self._done_before = self.num_timesteps

    def _on_step(self) -> bool:
        now = time.monotonic()
        if now - self._shown >= self.SECONDS:
            self._shown = now
            speed = (self.num_timesteps - self._done_before) / (now - self._begun)
            left = max(0, self._steps - self.num_timesteps) / speed / 60
            share = min(1.0, self.num_timesteps / self._steps)
            done = f"{self.num_timesteps:,} of {self._steps:,} steps ({share:.0%})"
            self._log(f"{done}, {speed:,.0f} steps/s, {left:.1f} min left")
        return True


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
    config: TrainConfig,
    run: str | os.PathLike[str],
    *,
    progress: bool = False,
    tensorboard: bool = True,
) -> dict[str, Any]:
    """Train a model, or resume from the last checkpoint of the same configuration.

    A resumed run continues from the last validation. It restores the weights, the optimizer, the replay buffer, the
    number of steps (and so the exploration rate), and the best model. It does not restore running episodes, a partial
    rollout of PPO or A2C, or the random states. New random streams start from the seed plus the number of steps. A
    resumed run therefore differs from an uninterrupted one, but two runs interrupted at the same point are identical.

    If `steps` is larger than that of a finished run, training continues. Schedules that depend on the total number of
    steps, such as DQN's exploration rate, then follow the new total.

    Args:
        config: The configuration.
        run: The folder of the run, which is created if it does not exist.
        progress: Whether to show the progress on standard error: as a bar if it is a terminal, and otherwise as lines,
            at the start, every 10 seconds and after each validation.
        tensorboard: Whether to write training curves.

    Returns:
        The content of `result.json`.

    Raises:
        InputError: If the configuration of the mode or an override is invalid, or no episodes are recorded.
        OSError: If another process trains in the folder, or a file cannot be written.
        ValueError: If the folder has another run or files of a run, the overrides change the shape of observations, or
            the algorithm rejects the settings. Then no run starts.
    """
    run = Path(run)
    checkpoints = _checkpoints(run)
    state = State(**json.loads((checkpoints[-1] / "state.json").read_text())) if checkpoints else State()
    _check_claim(run, config, state)
    torch.set_num_threads(config.threads)
    # Load the test episodes now, so that an error in them does not surface after hours of training.
    val, test = (Benchmark(config.mode, split, observation=config.observation) for split in ("val", "test"))
    # The model seeds the environments.
    env = make_vec_env(
        config.mode, config.envs, split="train", overrides=config.overrides, observation=config.observation
    )
    log = str(run / "tensorboard") if tensorboard else None
    as_bar = progress and sys.stderr.isatty()
    say = _print_line if progress and not as_bar else _print_nothing
    with ExitStack() as files:
        files.callback(env.close)
        if env.observation_space.shape != val.observation_shape:
            raise ValueError(
                f"the `overrides` change the shape of observations from {val.observation_shape} to "
                f"{env.observation_space.shape}, but validation and test use the mode without overrides: write a "
                "configuration file with these changes, and name it under `mode`"
            )
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
        run.mkdir(parents=True, exist_ok=True)
        # Keeps other processes from the run until its end.
        output = files.enter_context(reserved(run / "result.json", record=False))
        write_json(run / "config.json", config.model_dump(mode="json"))
        begun = f"resumed after {state.steps:,} of" if checkpoints else "started:"
        say(f"{config.algorithm} in {config.mode}, {begun} {config.steps:,} steps; folder {run}")
        callbacks: list[BaseCallback] = [Validation(run, config, state, val, say)]
        if progress:
            callbacks.append(ProgressBarCallback() if as_bar else ProgressLines(config.steps, say))
        model.learn(
            max(0, config.steps - state.steps),
            callback=CallbackList(callbacks),
            reset_num_timesteps=not checkpoints,
            tb_log_name=config.algorithm,
        )
        shutil.copyfile(_checkpoints(run)[-1] / "best.zip", run / "best.zip")
        result = _result(config, state, test.evaluate(load_model(run / "best.zip"), name=config.algorithm))
        write_json(run / "result.json", result, output=output)
    return result


def _print_line(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _print_nothing(line: str) -> None:
    pass


def _check_claim(run: Path, config: TrainConfig, state: State) -> None:
    """Check that the folder has no run, or a run of this configuration with at most as many steps.

    Raises:
        ValueError: If the folder has another run.
    """
    stored = run / "config.json"
    if not stored.exists():
        foreign = [path.name for path in (run / "result.json", run / "best.zip", *_checkpoints(run)) if path.exists()]
        if foreign:
            raise ValueError(f"{run} has {foreign[0]}, but no run: choose another folder")
        return
    old, new = json.loads(stored.read_text(encoding="utf-8")), config.model_dump(mode="json")
    changed = [name for name in new if name != "steps" and new[name] != old.get(name)]
    if changed:
        raise ValueError(
            f"{run} has a run of another configuration ({', '.join(f'`{name}`' for name in changed)} differ); "
            "remove it or choose another folder"
        )
    if new["steps"] < old["steps"] and new["steps"] < state.steps:
        raise ValueError(
            f"{run} has a run of {state.steps} steps: `steps` can be raised, not lowered to {new['steps']}"
        )


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


def _result(config: TrainConfig, state: State, measured: Evaluation) -> dict[str, Any]:
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
