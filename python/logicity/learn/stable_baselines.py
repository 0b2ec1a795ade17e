"""DQN, PPO and A2C of Stable-Baselines3."""

from __future__ import annotations

import json
import os
import pickle
from inspect import signature
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias, Union, get_args, get_origin
from zipfile import BadZipFile, ZipFile

from ..errors import missing_extra

try:
    import gymnasium
    import torch
    from pydantic import Field, Strict, ValidationError, ValidatorFunctionWrapHandler, WrapValidator, create_model
    from pydantic_core import PydanticCustomError
    from stable_baselines3 import A2C, DQN, PPO
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise missing_extra("learn", error) from error

from ..sb3 import make_vec_env
from . import random_state
from .learner import (
    Actions,
    Count,
    Learner,
    LearnerSettings,
    LearningRate,
    NonNegative,
    Observations,
    Policy,
    Positive,
    Progress,
    Share,
)

if TYPE_CHECKING:
    from ..env_config import ArrayKind
    from .config import TrainConfig

__all__ = [
    "A2CLearner",
    "DQNLearner",
    "FeatureLayers",
    "PPOLearner",
    "StableBaselinesLearner",
    "StableBaselinesPolicy",
    "algorithm_of",
    "new_model",
]


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


class _SharedSettings(LearnerSettings):
    """The settings of all algorithms."""

    network: Annotated[tuple[Count, ...], Strict(False), Field(min_length=1)]
    """The widths of the layers between the observation and the heads."""


#: An integer of at least 0.
_Natural: TypeAlias = Annotated[int, Field(strict=True, ge=0)]

#: An integer of at least 0, or -1 for a value that the algorithm chooses.
_NaturalOrAutomatic: TypeAlias = Annotated[int, Field(strict=True, ge=-1)]


def _valid_train_freq(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """Describe the values of `train_freq` in one message; pydantic would describe only the type of each alternative."""
    try:
        return validate(value)
    except ValidationError:
        expected = "an integer of at least 1, or such an integer with a unit: [4, step] or [1, episode]"
        message = f"`settings.train_freq` must be {expected}, not `{json.dumps(value, default=repr):.40}`"
        raise PydanticCustomError("custom", "{message}", {"message": message}) from None


#: The types of the settings with a range. Stable-Baselines3 does not check most ranges.
_RANGES: dict[str, Any] = {
    "batch_size": Count,
    "buffer_size": Count,
    "clip_range": Positive,
    "clip_range_vf": Positive,
    "ent_coef": NonNegative,
    "exploration_final_eps": Share,
    "exploration_fraction": Share,
    "exploration_initial_eps": Share,
    "gae_lambda": Share,
    "gamma": Share,
    "gradient_steps": _NaturalOrAutomatic,
    "learning_rate": LearningRate,
    "learning_starts": _Natural,
    "max_grad_norm": Positive,
    "n_epochs": Count,
    "n_steps": Count,
    "rms_prop_eps": NonNegative,
    "sde_sample_freq": _NaturalOrAutomatic,
    "stats_window_size": Count,
    "target_kl": Positive,
    "target_update_interval": Count,
    "tau": Share,
    "train_freq": Annotated[
        Count | Annotated[tuple[Count, Literal["step", "episode"]], Strict(False)], WrapValidator(_valid_train_freq)
    ],
    "verbose": _Natural,
    "vf_coef": NonNegative,
}


def settings_model(algorithm: type[BaseAlgorithm]) -> type[LearnerSettings]:
    """Create the model of an algorithm's settings from the signature of its class, with the ranges of `_RANGES`."""
    set_elsewhere = {"policy", "env", "policy_kwargs", "seed", "tensorboard_log", "device"}
    fields: dict[str, Any] = {}
    for each in signature(algorithm).parameters.values():
        hint = _in_range(_expressible(each.annotation), _RANGES.get(each.name))
        if hint not in (None, NoneType) and each.name not in set_elsewhere and not each.name.startswith("_"):
            fields[each.name] = (hint, each.default)
    model: type[LearnerSettings] = create_model(
        f"{algorithm.__name__}Settings",
        __base__=_SharedSettings,
        __doc__="Arguments of the algorithm's class.",
        **fields,
    )
    return model


def _expressible(hint: Any) -> Any:
    """Return the part of a type that YAML can express, or `None` if there is none, as for functions and classes."""
    if get_origin(hint) in (Union, UnionType):
        parts = tuple(part for each in get_args(hint) if (part := _expressible(each)) is not None)
        return Union[parts] if parts else None  # noqa: UP007
    if get_origin(hint) is tuple:
        # YAML has lists instead of tuples.
        return Annotated[hint, Strict(False)]
    return hint if get_origin(hint) is dict or hint in (bool, dict, float, int, str, NoneType) else None


def _in_range(hint: Any, known: Any) -> Any:
    """Return the type of `_RANGES` if there is one. The setting can be null if its class says so."""
    if hint is None or known is None:
        return hint
    return known | None if NoneType in get_args(hint) else known


#: The class of each algorithm in Stable-Baselines3, and a setting that only its models have.
_ALGORITHMS: dict[str, tuple[type[BaseAlgorithm], str]] = {
    "dqn": (DQN, "exploration_fraction"),
    "ppo": (PPO, "clip_range"),
    "a2c": (A2C, "normalize_advantage"),
    "nlm-dqn": (DQN, "exploration_fraction"),
}


def algorithm_of(path: str | os.PathLike[str]) -> str:
    """Return the name of the algorithm that saved a model. The file itself does not name it.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not a DQN, PPO or A2C model of Stable-Baselines3.
    """
    saved: dict[str, Any]
    try:
        with ZipFile(path) as archive:
            saved = json.loads(archive.read("data"))
    except (BadZipFile, KeyError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)} is not a Stable-Baselines3 model: {error}") from None
    found = [name for name, (_, distinctive) in _ALGORITHMS.items() if distinctive in saved]
    if not found:
        raise ValueError(f"{os.fspath(path)} is not a model of {', '.join(_ALGORITHMS)}")
    if "dqn" in found:
        features = saved.get("policy_kwargs", {}).get("features_extractor_class", "")
        return "nlm-dqn" if "LogicFeatures" in str(features) else "dqn"
    # PPO also has A2C's setting.
    return "ppo" if "ppo" in found else found[0]


class StableBaselinesPolicy(Policy):
    """A model of Stable-Baselines3.

    Attributes:
        model: The model.
    """

    def __init__(self, model: BaseAlgorithm) -> None:
        """Store the model."""
        self.model = model

    @property
    def observation_space(self) -> gymnasium.Space[Any]:
        """The space of the observations."""
        space: gymnasium.Space[Any] = self.model.observation_space
        return space

    def predict(
        self,
        observation: Observations,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Actions, Any]:
        """Call `predict` of the model."""
        actions, state = self.model.predict(observation, state, episode_start, deterministic)
        return actions, state

    def save(self, path: Path) -> None:
        """Write the model without the state of its training environments."""
        training = ("_last_obs", "_last_original_obs", "_last_episode_starts", "ep_info_buffer", "ep_success_buffer")
        self.model.save(path, exclude=[*training, "start_time", "tensorboard_log"])

    @classmethod
    def load(cls, path: Path) -> StableBaselinesPolicy:
        """Load a DQN, PPO or A2C model that Stable-Baselines3 saved.

        Raises:
            OSError: If the file cannot be read.
            ValueError: If the file is not such a model.
        """
        algorithm, _ = _ALGORITHMS[algorithm_of(path)]
        return cls(algorithm.load(path, device="cpu"))


class _BetweenRollouts(BaseCallback):
    """Reports progress before each rollout, when the rollout buffer is empty and all updates are done."""

    def __init__(self, progress: Progress) -> None:
        super().__init__()
        self._progress = progress

    def _on_rollout_start(self) -> None:
        self._progress()

    def _on_step(self) -> bool:
        return True


class StableBaselinesLearner(Learner):
    """An algorithm of Stable-Baselines3, with the layers `FeatureLayers` between the observation and its heads."""

    unit: ClassVar[Literal["environment steps", "updates"]] = "environment steps"
    interacts: ClassVar[bool] = True
    observations: ClassVar[tuple[ArrayKind, ...]] = ("groundings", "state")
    suffix: ClassVar[str] = ".zip"
    policy_class: ClassVar[type[Policy]] = StableBaselinesPolicy
    starts: ClassVar[bool] = True

    def __init__(self, config: TrainConfig, log: Path | None = None) -> None:
        """Create the environments and the model.

        Raises:
            ValueError: If the algorithm rejects the settings, or the model of `start` does not fit.
        """
        super().__init__(config, log)
        env = make_vec_env(config.mode, config.envs, **config.env_options())
        try:
            # The model seeds the environments.
            self._model = new_model(config, env, None if log is None else str(log))
            if config.start is not None:
                self._start_from(Path(config.start))
        except BaseException:
            env.close()
            raise

    @classmethod
    def policy_arguments(cls, config: TrainConfig, settings: dict[str, Any]) -> dict[str, Any]:
        """Return the argument `policy_kwargs` of the algorithm's class.

        Args:
            config: The configuration.
            settings: Its settings. The method removes those that are not arguments of the algorithm's class.
        """
        return {
            "features_extractor_class": FeatureLayers,
            "features_extractor_kwargs": {"widths": settings.pop("network")},
            "net_arch": [],
        }

    def _start_from(self, path: Path) -> None:
        name = algorithm_of(path)
        if name != self.config.algorithm:
            raise ValueError(f"`start`: {path} is a policy of `{name}`, not of `{self.config.algorithm}`")
        weights = StableBaselinesPolicy.load(path).model.policy.state_dict()
        own = self._model.policy.state_dict()
        for key in own:
            if key not in weights or weights[key].shape != own[key].shape:
                raise ValueError(f"`start`: the layers of {path} do not fit the observations and `settings.network`")
        self._model.policy.load_state_dict(weights)

    @property
    def steps(self) -> int:
        """The number of steps of all environments."""
        return int(self._model.num_timesteps)

    def fit(self, steps: int, progress: Progress) -> None:
        """Train until at least `steps` steps. Schedules such as DQN's exploration rate end at `steps`."""
        if self.steps < steps:
            self._model.learn(
                steps - self.steps,
                callback=_BetweenRollouts(progress),
                reset_num_timesteps=self.steps == 0,
                tb_log_name=self.config.algorithm,
            )

    def policy(self) -> StableBaselinesPolicy:
        """Return the model in training."""
        return StableBaselinesPolicy(self._model)

    def save(self, folder: Path) -> None:
        """Write the model, its replay buffer, its environments, and all random states."""
        self._model.save(folder / "model.zip")
        if isinstance(self._model, OffPolicyAlgorithm):
            self._model.save_replay_buffer(folder / "replay.pkl")
        state = {
            "environments": self._model.env,
            "random": random_state.get(),
            "actions": self._model.action_space.np_random.bit_generator.state,
        }
        (folder / "state.pkl").write_bytes(pickle.dumps(state))

    def restore(self, folder: Path) -> None:
        """Restore what `save` wrote. Only load checkpoints that you trust: they are pickles."""
        state = pickle.loads((folder / "state.pkl").read_bytes())
        self.close()
        log = None if self.log is None else str(self.log)
        algorithm, _ = _ALGORITHMS[self.config.algorithm]
        # `load` would seed environments that it receives.
        self._model = algorithm.load(folder / "model.zip", device="cpu", tensorboard_log=log, force_reset=False)
        self._model.set_env(state["environments"], force_reset=False)
        if isinstance(self._model, OffPolicyAlgorithm):
            with (folder / "replay.pkl").open("rb") as file:
                self._model.load_replay_buffer(file)
        self._model.action_space.np_random.bit_generator.state = state["actions"]
        random_state.put(state["random"])

    def close(self) -> None:
        """Close the environments, which a model lacks if `restore` failed."""
        if self._model.env is not None:
            self._model.env.close()


def new_model(config: TrainConfig, env: VecEnv, log: str | None = None) -> BaseAlgorithm:
    """Create an untrained model.

    Args:
        config: The configuration.
        env: The environments.
        log: The folder of the training curves.

    Raises:
        ValueError: If the algorithm rejects the settings.
    """
    settings = config.settings.model_dump()
    frequency = settings.get("train_freq")
    if isinstance(frequency, tuple) and frequency[1] == "episode" and config.envs > 1:
        raise ValueError("`settings.train_freq`: the unit `episode` needs one environment: set `envs: 1`")
    learner = config.learner
    assert issubclass(learner, StableBaselinesLearner)
    policy = learner.policy_arguments(config, settings)
    algorithm, _ = _ALGORITHMS[config.algorithm]
    try:
        return algorithm(
            "MlpPolicy", env, policy_kwargs=policy, seed=config.seed, tensorboard_log=log, device="cpu", **settings
        )
    except (AssertionError, TypeError, ValueError) as error:
        raise ValueError(f"{algorithm.__name__} rejects the `settings`: {error}") from error


class DQNLearner(StableBaselinesLearner):
    """Deep Q-learning."""

    settings_class = settings_model(DQN)


class PPOLearner(StableBaselinesLearner):
    """Proximal policy optimization."""

    settings_class = settings_model(PPO)


class A2CLearner(StableBaselinesLearner):
    """Advantage actor-critic."""

    settings_class = settings_model(A2C)
