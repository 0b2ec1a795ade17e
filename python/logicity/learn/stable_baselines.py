"""DQN, PPO and A2C of Stable-Baselines3."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Mapping
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, cast
from zipfile import BadZipFile, ZipFile

import gymnasium
import torch
from pydantic import Field, Strict, ValidationError, ValidatorFunctionWrapHandler, WrapValidator, create_model
from pydantic_core import PydanticCustomError
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.vec_env import VecEnv

from ..city import ACTIONS
from ..envs.sb3 import make_vec_env
from ..envs.views import Actions, Observations
from ..types import ArrayKind
from . import random_state
from .learner import LearnedPolicy, Learner, Progress
from .registry import learner_class
from .settings import Count, LearnerSettings, LearningRate, NonNegative, Positive, Share, Training, Widths
from .storage import StoredPolicy, restore_optimizer

__all__ = ["A2CLearner", "DQNLearner", "PPOLearner", "algorithm_of", "from_stable_baselines", "new_model"]


class FeatureLayers(BaseFeaturesExtractor):
    """Linear layers, each followed by ReLU, that all heads share."""

    def __init__(self, observation_space: gymnasium.Space[Any], widths: tuple[int, ...]) -> None:
        """Create layers of these widths after the flattened observation."""
        super().__init__(observation_space, widths[-1])
        layers = create_mlp(gymnasium.spaces.flatdim(observation_space), -1, list(widths))
        self._layers = torch.nn.Sequential(torch.nn.Flatten(), *layers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features of shape (batch, last width)."""
        return self._layers(observations)


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


_NETWORK = "The widths of the layers between the observation and the heads."

#: The types of the settings. Stable-Baselines3 does not check most ranges.
_TYPES: dict[str, Any] = {
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
    "normalize_advantage": bool,
    "optimize_memory_usage": bool,
    "replay_buffer_kwargs": dict[str, Any],
    "rms_prop_eps": NonNegative,
    "rollout_buffer_kwargs": dict[str, Any],
    "sde_sample_freq": _NaturalOrAutomatic,
    "stats_window_size": Count,
    "target_kl": Positive,
    "target_update_interval": Count,
    "tau": Share,
    "train_freq": Annotated[
        Count | Annotated[tuple[Count, Literal["step", "episode"]], Strict(False)], WrapValidator(_valid_train_freq)
    ],
    "use_rms_prop": bool,
    "use_sde": bool,
    "verbose": _Natural,
    "vf_coef": NonNegative,
}


def settings_model(algorithm: type[BaseAlgorithm]) -> type[LearnerSettings]:
    """Create the model of an algorithm's settings. Those that are null by default can be null in a file, too."""
    given = {name: each.default for name, each in signature(algorithm).parameters.items() if name in _TYPES}
    fields: dict[str, Any] = {"network": (Widths, Field(description=_NETWORK))}
    fields |= {
        name: (_TYPES[name] | None if default is None else _TYPES[name], default) for name, default in given.items()
    }
    name, about = f"{algorithm.__name__}Settings", "Arguments of the algorithm's class."
    model: type[LearnerSettings] = create_model(name, __base__=LearnerSettings, __doc__=about, **fields)
    return model


#: The class of each algorithm in Stable-Baselines3, and a setting that only its models have.
_ALGORITHMS: dict[str, tuple[type[BaseAlgorithm], str]] = {
    "dqn": (DQN, "exploration_fraction"),
    "ppo": (PPO, "clip_range"),
    "a2c": (A2C, "normalize_advantage"),
    "nlm-dqn": (DQN, "exploration_fraction"),
    "nlm-ppo": (PPO, "clip_range"),
}

#: The most bytes of the description in a model of Stable-Baselines3, which is read before the model is loaded.
_DESCRIPTION_BYTES = 2**26


def algorithm_of(path: str | os.PathLike[str]) -> str:
    """Return the name of the algorithm whose model Stable-Baselines3 saved. The file itself does not name it.

    It reads only JSON. `from_stable_baselines` loads the model.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If the file is not a DQN, PPO or A2C model of Stable-Baselines3.
    """
    saved: dict[str, Any]
    try:
        with ZipFile(path) as archive:
            if archive.getinfo("data").file_size > _DESCRIPTION_BYTES:
                raise ValueError("its description is too large")
            saved = json.loads(archive.read("data"))
    except (BadZipFile, KeyError, RecursionError, ValueError) as error:
        raise ValueError(f"{os.fspath(path)} is not a Stable-Baselines3 model: {error}") from None
    found = [name for name, (_, distinctive) in _ALGORITHMS.items() if isinstance(saved, dict) and distinctive in saved]
    if not found:
        raise ValueError(f"{os.fspath(path)} is not a model of {', '.join(_ALGORITHMS)}")
    # PPO also has A2C's setting.
    name = next(name for name in ("dqn", "ppo", "a2c") if name in found)
    with_logic = f"nlm-{name}"
    has_logic = "LogicFeatures" in str(saved.get("policy_kwargs", {}))
    return with_logic if has_logic and with_logic in _ALGORITHMS else name


class StableBaselinesPolicy(StoredPolicy):
    """The policy of a model of Stable-Baselines3. One from a file has no environments and no optimizer."""

    algorithms = tuple(_ALGORITHMS)

    def __init__(self, model: BaseAlgorithm, algorithm: str, config: Mapping[str, Any] | None = None) -> None:
        """Store the model, and what `save` needs besides: `None` for a model that another program trained."""
        self.model, self.algorithm = model, algorithm
        self._config = config

    @property
    def observation_space(self) -> gymnasium.Space[Any]:
        """The space of the observations."""
        space: gymnasium.Space[Any] = self.model.observation_space
        return space

    def predict(
        self, observation: Observations, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Actions, Any]:
        """Call `predict` of the model."""
        actions, state = self.model.predict(observation, state, episode_start, deterministic)
        return actions, state

    def config(self) -> dict[str, Any]:
        """Return the settings of the network. Raise `ValueError` if another program trained the model."""
        if self._config is None:
            raise ValueError("a model of another program may have parts that are not data: use `model.save`")
        space = cast(gymnasium.spaces.Box, self.observation_space)
        config = {key: self._config[key] for key in ("mode", "settings", "features", "observation")}
        return {**config, "space": [torch.from_numpy(space.low), torch.from_numpy(space.high)]}

    def weights(self) -> Mapping[str, Any]:
        """Return the weights of the networks."""
        return dict(self.model.policy.state_dict())

    @classmethod
    def build(cls, config: dict[str, Any], weights: dict[str, Any]) -> StableBaselinesPolicy:
        """Create the policy of a file."""
        learner = learner_class(config["algorithm"])
        assert issubclass(learner, StableBaselinesLearner)
        settings = learner.settings_class.model_validate(config["settings"]).model_dump()
        low, high = (bound.numpy() for bound in config["space"])
        policy = learner.policy_arguments(settings, config["features"])
        model = _ALGORITHMS[config["algorithm"]][0](
            "MlpPolicy", None, policy_kwargs=policy, device="cpu", _init_setup_model=False, **settings
        )
        model.observation_space = gymnasium.spaces.Box(low, high, dtype=low.dtype.type)
        model.action_space = gymnasium.spaces.Discrete(len(ACTIONS))
        model.n_envs = 1
        # As `_setup_model` does, but without buffers, and without seeding the global generators.
        model._setup_lr_schedule()
        with torch.random.fork_rng(devices=[]):
            model.policy = model.policy_class(
                model.observation_space, model.action_space, model.lr_schedule, **model.policy_kwargs
            )
        model.policy.load_state_dict(weights)
        return cls(model, config["algorithm"], config)


def from_stable_baselines(path: str | os.PathLike[str]) -> StableBaselinesPolicy:
    """Load a model that `algorithm_of` accepts. This can run any code in the file."""
    algorithm = algorithm_of(path)
    return StableBaselinesPolicy(_ALGORITHMS[algorithm][0].load(path, device="cpu"), algorithm)


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

    unit: ClassVar = "environment steps"
    interacts = True
    observations: ClassVar[tuple[ArrayKind, ...]] = ("groundings", "state")
    policy_class = StableBaselinesPolicy
    starts = True

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Create the environments and the model."""
        super().__init__(config, log)
        self._features = self.features(config)
        env = make_vec_env(config.mode, config.envs, **config.env_options())
        try:
            # The model seeds the environments.
            self._model = new_model(config, env, None if log is None else str(log))
        except BaseException:
            env.close()
            raise

    @classmethod
    def features(cls, config: Training) -> dict[str, Any]:
        """Return what the network needs to know about the mode besides the settings, as plain data."""
        return {}

    @classmethod
    def policy_arguments(cls, settings: dict[str, Any], features: dict[str, Any]) -> dict[str, Any]:
        """Return the argument `policy_kwargs` of the algorithm's class, with settings that this method removes."""
        widths = {"widths": settings.pop("network")}
        return {"features_extractor_class": FeatureLayers, "features_extractor_kwargs": widths, "net_arch": []}

    def start_from(self, policy: LearnedPolicy) -> None:
        """Copy the weights of a policy."""
        assert isinstance(policy, StableBaselinesPolicy)
        weights, own = policy.weights(), self._model.policy.state_dict()
        for key in own:
            if key not in weights or weights[key].shape != own[key].shape:
                raise ValueError("its layers do not fit the observations and `settings.network`")
        self._model.policy.load_state_dict(weights)

    @property
    def steps(self) -> int:
        """The number of steps of all environments."""
        return int(self._model.num_timesteps)

    def fit(self, steps: int, progress: Progress) -> None:
        """Train until at least `steps` steps. Schedules such as DQN's exploration rate end at `steps`."""
        if self.steps < steps:
            options = {"reset_num_timesteps": self.steps == 0, "tb_log_name": self.config.algorithm}
            self._model.learn(steps - self.steps, callback=_BetweenRollouts(progress), **options)

    def policy(self) -> StableBaselinesPolicy:
        """Return the policy of the model in training."""
        config = self.config
        settings = config.settings.model_dump(mode="json")
        about = {"mode": config.mode, "observation": config.observation, "settings": settings}
        return StableBaselinesPolicy(self._model, config.algorithm, {**about, "features": self._features})

    def state(self) -> dict[str, Any]:
        """Return the weights, the optimizer, the replay buffer, the environments, and all random states."""
        model, monitor = self._model, self._model.env
        state: dict[str, Any] = {
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "counters": {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)},
            "observations": torch.from_numpy(model._last_obs),
            "starts": torch.from_numpy(model._last_episode_starts),
            "episodes": list(map(_episode_of, model.ep_info_buffer or ())),
            "successes": [bool(success) for success in model.ep_success_buffer or ()],
            "environments": {
                "environments": monitor.venv.envs.state(),
                "returns": torch.from_numpy(monitor.episode_returns),
                "lengths": torch.from_numpy(monitor.episode_lengths),
                "episodes": monitor.episode_count,
            },
            "actions": model.action_space.np_random.bit_generator.state,
            "random": random_state.get(),
        }
        if isinstance(model, OffPolicyAlgorithm):
            state["replay"] = _replay_of(model.replay_buffer)
        return state

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        model, monitor = self._model, self._model.env
        model.policy.load_state_dict(state["policy"])
        restore_optimizer(model.policy.optimizer, state["optimizer"])
        for name in _COUNTERS:
            if hasattr(model, name):
                setattr(model, name, type(getattr(model, name))(state["counters"][name]))
        model._last_obs, model._last_episode_starts = state["observations"].numpy(), state["starts"].numpy()
        model.ep_info_buffer = deque(map(_episode_of, state["episodes"]), maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(state["successes"], maxlen=model._stats_window_size)
        saved = state["environments"]
        monitor.venv.envs.restore(saved["environments"])
        monitor.episode_returns, monitor.episode_lengths = saved["returns"].numpy(), saved["lengths"].numpy()
        monitor.episode_count = saved["episodes"]
        if isinstance(model, OffPolicyAlgorithm):
            _restore_replay(model.replay_buffer, state["replay"])
        model.action_space.np_random.bit_generator.state = state["actions"]
        random_state.put(state["random"])

    def close(self) -> None:
        """Close the environments."""
        if self._model.env is not None:
            self._model.env.close()
        super().close()


#: The numbers of a model that change in training. Only DQN has the last two.
_COUNTERS = (
    *("num_timesteps", "_total_timesteps", "_num_timesteps_at_start", "_episode_num", "_n_updates"),
    *("_current_progress_remaining", "exploration_rate", "_n_calls"),
)


def _episode_of(record: Mapping[str, Any]) -> dict[str, float]:
    """Return what `VecMonitor` records of an episode as numbers: its return, its length, and when it ended."""
    return {name: float(record[name]) for name in ("r", "l", "t")}


#: The arrays of a replay buffer. A buffer with `optimize_memory_usage` has no `next_observations`.
_REPLAY = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def _replay_of(buffer: ReplayBuffer) -> dict[str, Any]:
    """Return the stored transitions as tensors, and where the next one goes."""
    # With `optimize_memory_usage`, the row at `pos` has the last observation.
    count = buffer.buffer_size if buffer.full else min(buffer.pos + 1, buffer.buffer_size)
    arrays = {name: getattr(buffer, name) for name in _REPLAY if hasattr(buffer, name)}
    tensors = {name: torch.from_numpy(array[:count]) for name, array in arrays.items()}
    return {"pos": buffer.pos, "full": buffer.full, **tensors}


def _restore_replay(buffer: ReplayBuffer, state: Mapping[str, Any]) -> None:
    """Restore what `_replay_of` returned."""
    for name in _REPLAY:
        if hasattr(buffer, name):
            array, saved = getattr(buffer, name), state[name].numpy()
            if saved.shape[1:] != array.shape[1:] or saved.dtype != array.dtype or len(saved) > len(array):
                raise ValueError(f"`{name}` of the replay buffer has the shape {saved.shape}, not {array.shape}")
            array[: len(saved)] = saved
    if not 0 <= state["pos"] < buffer.buffer_size:
        raise ValueError(f"the replay buffer has no place {state['pos']}")
    buffer.pos, buffer.full = state["pos"], bool(state["full"])


def new_model(config: Training, env: VecEnv, log: str | None = None) -> BaseAlgorithm:
    """Create an untrained model, with training curves in `log`. Raise `ValueError` if it rejects the settings."""
    settings = config.settings.model_dump()
    frequency = settings.get("train_freq")
    if isinstance(frequency, tuple) and frequency[1] == "episode" and config.envs > 1:
        raise ValueError("`settings.train_freq`: the unit `episode` needs one environment: set `envs: 1`")
    learner = learner_class(config.algorithm)
    assert issubclass(learner, StableBaselinesLearner)
    policy = learner.policy_arguments(settings, learner.features(config))
    algorithm, _ = _ALGORITHMS[config.algorithm]
    options = {"policy_kwargs": policy, "seed": config.seed, "tensorboard_log": log, "device": "cpu"}
    try:
        return algorithm("MlpPolicy", env, **options, **settings)
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
