"""Behavior cloning: networks that imitate the actions of the oracle in the recorded demonstrations.

Four learners share the training loop: a multilayer perceptron (`mlp`), a graph neural network (`gnn`), a Neural Logic
Machine (`nlm`) and a transformer (`transformer`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field
from stable_baselines3.common.torch_layers import create_mlp
from torch import Tensor, nn

from ..city import ACTIONS
from ..envs.views import Actions, Observations
from ..errors import extra
from ..files import read_tensors
from .demonstrations import DemonstrationData, Layout, RelationalView, Sampler
from .learner import LearnedPolicy, Learner, check_shape, minimize
from .nlm import NeuralLogicMachine
from .settings import Count, LearnerSettings, LearningRate, NonNegative, Positive, Share, Training, Widths
from .storage import restore_optimizer
from .transformer import TransformerNetwork

__all__ = [
    *("ClonedPolicy", "CloningLearner", "GnnLearner", "LogicNetwork", "LogicSettings", "MlpLearner", "NlmLearner"),
    "TransformerLearner",
]

#: The version of the files of policies.
FORMAT = 1

#: The interval between two points of the training curves, in updates.
CURVE_EVERY = 50


class CloningSettings(LearnerSettings):
    """The settings that all learners of behavior cloning share."""

    learning_rate: LearningRate = 1e-4
    """The learning rate of Adam."""
    schedule: Literal["constant", "cosine"] = "constant"
    """The learning rate over the training: constant, or falling to 0 as a cosine."""
    weight_decay: NonNegative = 0.0
    """The decoupled weight decay (AdamW)."""
    batch_size: Count = 256
    """The number of steps of demonstrations in an update."""
    distinct: bool = False
    """Whether to use each pair of observation and action once."""
    balanced: bool = False
    """Whether batches contain every action equally often."""
    class_power: Share = 0.0
    """The exponent p of the weights in the loss. A step with an action that has n steps weighs (m / n) ** p, where m is
    the mean of n over the actions that occur. With p = 1 these actions have the same total weight."""
    shuffle_entities: bool = False
    """Whether to permute the entities other than the ego at random in each batch."""
    gradient_clip: Positive | None = None
    """The largest norm of the gradient, or null."""
    average: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """The decay of the moving average of the weights that policies use; 0 uses the weights themselves."""


class MlpSettings(CloningSettings):
    """The settings of `mlp`."""

    network: Widths = (128, 64)
    """The widths of the layers with ReLU."""


class GnnSettings(CloningSettings):
    """The settings of `gnn`."""

    network: Widths = (64, 64)
    """The widths of the layers with ReLU in each convolution."""
    layers: Count = 1
    """The number of convolutions."""
    reverse: bool = False
    """Whether an edge also has the features of the edge in the other direction."""
    present_only: bool = False
    """Whether to omit edges of absent entities."""
    learned_eps: bool = False
    """Whether the weight of an entity's own features is learned."""


class LogicSettings(LearnerSettings):
    """The settings of a Neural Logic Machine."""

    depth: Count = 4
    """The number of layers."""
    breadth: Annotated[int, Field(ge=2, le=4)] = 3
    """The largest arity."""
    outputs: Count = 8
    """The number of predicates that each layer invents per arity."""
    hidden: Count | None = None
    """The width of a hidden layer in each perceptron, or null."""
    exclude_self: bool = True
    """Whether quantifiers omit tuples that contain an entity twice."""
    residual: bool = False
    """Whether each layer also passes on its input predicates."""


class NlmSettings(CloningSettings, LogicSettings):
    """The settings of `nlm`."""


class TransformerSettings(CloningSettings):
    """The settings of `transformer`."""

    layers: Count = 3
    """The number of layers."""
    heads: Count = 8
    """The number of heads of the attention."""
    head_width: Count = 8
    """The number of features of a head; a token has heads * head_width."""
    feedforward: Count = 1024
    """The width of the hidden layer after the attention."""


class LogicNetwork(nn.Module):
    """A Neural Logic Machine (NLM) over an observation. It returns the predicates of the ego in the last layer.

    It evaluates equal observations of a batch once, and those with at most two entities without triples of entities.
    `width` is the number of predicates in the result.
    """

    def __init__(self, layout: Layout, **options: Any) -> None:
        """Create the NLM with the options of `NeuralLogicMachine`, without `inputs` and `returned`.

        The route length, if the task observes it, is a predicate without arguments.
        """
        super().__init__()
        self.view = RelationalView(layout)
        inputs = [int(layout.route_length is not None), len(layout.unary), len(layout.binary)]
        self.machine = NeuralLogicMachine(inputs, returned=(1,), **options)
        self.width = self.machine.counts[1]

    def forward(self, observations: Tensor) -> Tensor:
        """Return truth values, (batch, width), of observations of shape (batch, width of the observation)."""
        if len(observations) == 1:
            return self.padded(observations)
        distinct, inverse = torch.unique(observations, dim=0, return_inverse=True)
        unary, binary, mask = self.view(distinct)
        lengths = self.view.route_length(distinct)
        # Entities after the last present one influence no result.
        few = ~mask[:, 2:].any(1)
        order, parts = [], []
        for rows, count in ((few, 2), (~few, mask.shape[1])):
            if rows.any():
                length = None if lengths is None else lengths[rows]
                groups = [length, unary[rows, :count], binary[rows, :count, :count]]
                order.append(rows.nonzero()[:, 0])
                parts.append(self.machine(groups, mask[rows, :count])[1][:, 0])
        place = torch.cat(order).argsort()[inverse]
        return torch.cat(parts).index_select(0, place)

    def padded(self, observations: Tensor) -> Tensor:
        """Return the result of `forward`, from an NLM over all entities of the padded observations."""
        unary, binary, mask = self.view(observations)
        return self.machine([self.view.route_length(observations), unary, binary], mask)[1][:, 0]


class ClonedPolicy(LearnedPolicy):
    """Takes the actions with the largest scores of a network, or draws actions with the softmax of the scores."""

    def __init__(
        self, algorithm: str, mode: str, settings: CloningSettings, layout: Layout, network: nn.Module
    ) -> None:
        """Store the name of the learner, the mode of the training and the network with what it was made from."""
        self.algorithm, self.mode, self.settings = algorithm, mode, settings
        self.layout, self.network = layout, network

    def _decide(self, observation: Observations, deterministic: bool) -> Actions:
        check_shape(observation, self.layout.width, self.mode)
        with torch.no_grad():
            scores = self.network(torch.from_numpy(np.ascontiguousarray(observation, np.float32)))
            actions = scores.argmax(1) if deterministic else torch.multinomial(scores.softmax(1), 1)[:, 0]
        return np.asarray(actions)

    def save(self, path: Path) -> None:
        """Write the policy to a file of `torch.save` with plain data."""
        content = {
            "format": FORMAT,
            "algorithm": self.algorithm,
            "mode": self.mode,
            "observation": "groundings",
            "settings": self.settings.model_dump(mode="json"),
            "atoms": [[name, list(entities)] for name, entities in self.layout.atoms()],
            "route_length": self.layout.route_length is not None,
            "weights": self.network.state_dict(),
        }
        torch.save(content, path)

    def weights(self) -> Mapping[str, Any]:
        """Return the weights of the network."""
        return dict(self.network.state_dict())

    @classmethod
    def load(cls, path: Path) -> ClonedPolicy:
        """Read a policy that `save` wrote."""
        what = "policy of behavior cloning"
        saved = read_tensors(path, f"a {what}")
        version = saved.get("format") if isinstance(saved, dict) else None
        if version != FORMAT:
            raise ValueError(f"{path} is not a {what} of format {FORMAT}, but of format {version!r}")
        algorithm = str(saved.get("algorithm"))
        learner = _LEARNERS.get(algorithm)
        if learner is None:
            raise ValueError(f"{path} is not a {what}, but of `{algorithm}`")
        try:
            settings = learner.settings_class.model_validate(saved["settings"])
            atoms = [(str(name), tuple(map(int, entities))) for name, entities in saved["atoms"]]
            layout = Layout.of_atoms(atoms, bool(saved["route_length"]))
            network = learner.new_network(layout, settings)
            network.load_state_dict(saved["weights"])
            mode = str(saved["mode"])
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is a damaged policy of `{algorithm}`: {error}") from error
        return cls(algorithm, mode, settings, layout, network.eval())


class CloningLearner(Learner):
    """Minimizes the cross entropy between the scores of a network and the actions of the oracle."""

    settings_class: ClassVar[type[CloningSettings]]
    unit = "updates"
    interacts = False
    policy_class = ClonedPolicy
    starts = True
    steps = 0
    _settings: CloningSettings

    def __init__(self, config: Training, log: Path | None = None) -> None:
        """Read the demonstrations and create the network."""
        super().__init__(config, log)
        data = DemonstrationData.load(config.mode, config.demonstrations)
        self._data = data.distinct() if self._settings.distinct else data
        self._weights = self._data.class_weights(self._settings.class_power)
        self._sampler = Sampler(self._data, self._settings.batch_size, config.seed, self._settings.balanced)
        self._shuffler = torch.Generator().manual_seed(config.seed)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self._network = self.new_network(data.layout, self._settings)
            self._average = self.new_network(data.layout, self._settings) if self._settings.average else self._network
        self._average.load_state_dict(self._network.state_dict())
        self._optimizer = torch.optim.AdamW(
            self._network.parameters(), self._settings.learning_rate, weight_decay=self._settings.weight_decay
        )

    @staticmethod
    @abstractmethod
    def new_network(layout: Layout, settings: Any) -> nn.Module:
        """Create an untrained network from observations to scores of the actions."""

    def start_from(self, policy: LearnedPolicy) -> None:
        """Copy the weights of a policy."""
        assert isinstance(policy, ClonedPolicy)
        if policy.layout.atoms() != self._data.layout.atoms():
            raise ValueError(f"it is for other observations than those of `{self.config.mode}`")
        try:
            self._network.load_state_dict(policy.network.state_dict())
        except RuntimeError:
            raise ValueError("its network has other sizes than those in `settings`") from None
        self._average.load_state_dict(self._network.state_dict())

    def _step(self, steps: int) -> None:
        """Run an update. The schedule `cosine` ends at `steps`."""
        loss, accuracy = self._update(self.steps / steps)
        self.steps += 1
        if self.steps % CURVE_EVERY == 0:
            self._curves.add({"train/loss": loss, "train/accuracy": accuracy})
            self._curves.write(self.steps)

    def _update(self, done: float) -> tuple[float, float]:
        """Run one update after a share `done` of the training, and return the loss and the accuracy of the batch."""
        settings = self._settings
        if settings.schedule == "cosine":
            for group in self._optimizer.param_groups:
                group["lr"] = settings.learning_rate * 0.5 * (1.0 + math.cos(math.pi * done))
        chosen = self._sampler.next()
        observations, actions = self._data.observations[chosen], self._data.actions[chosen]
        if settings.shuffle_entities:
            observations = shuffled(observations, self._data.layout, self._shuffler)
        scores = self._network(observations)
        loss = nn.functional.cross_entropy(scores, actions, self._weights)
        minimize(loss, self._optimizer, settings.gradient_clip)
        if settings.average:
            with torch.no_grad():
                for mean, weight in zip(self._average.parameters(), self._network.parameters(), strict=True):
                    mean.lerp_(weight, 1 - settings.average)
        return float(loss.detach()), float((scores.detach().argmax(1) == actions).float().mean())

    def policy(self) -> ClonedPolicy:
        """Return the network, or the average of its weights."""
        config = self.config
        return ClonedPolicy(config.algorithm, config.mode, self._settings, self._data.layout, self._average)

    def state(self) -> dict[str, Any]:
        """Return the weights, the optimizer and the random states."""
        return {
            "steps": self.steps,
            "network": self._network.state_dict(),
            "average": self._average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "sampler": self._sampler.state_dict(),
            "shuffler": self._shuffler.get_state(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned."""
        try:
            self._network.load_state_dict(state["network"])
            self._average.load_state_dict(state["average"])
            restore_optimizer(self._optimizer, state["optimizer"])
            self._sampler.load_state_dict(state["sampler"])
            self._shuffler.set_state(state["shuffler"])
            self.steps = int(state["steps"])
        except (KeyError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(f"the checkpoint does not fit the configuration: {error}") from error


class MlpLearner(CloningLearner):
    """Behavior cloning of a multilayer perceptron over the whole observation."""

    settings_class = MlpSettings

    @staticmethod
    def new_network(layout: Layout, settings: MlpSettings) -> nn.Module:
        """Create linear layers with ReLU between them."""
        return nn.Sequential(*create_mlp(layout.width, len(ACTIONS), list(settings.network)))


class GnnLearner(CloningLearner):
    """Behavior cloning of a graph neural network."""

    settings_class = GnnSettings

    @staticmethod
    def new_network(layout: Layout, settings: GnnSettings) -> nn.Module:
        """Create convolutions and a linear layer on the ego."""
        with extra("learn"):
            from .gnn import GraphNetwork

        options = settings.model_dump(include={"layers", "reverse", "present_only", "learned_eps"})
        return GraphNetwork(layout, len(ACTIONS), settings.network, **options)


class NlmLearner(CloningLearner):
    """Behavior cloning of a Neural Logic Machine."""

    settings_class = NlmSettings

    @staticmethod
    def new_network(layout: Layout, settings: NlmSettings) -> nn.Module:
        """Create an NLM, and a linear layer on the predicates of the ego."""
        logic = LogicNetwork(layout, **settings.model_dump(include=set(LogicSettings.model_fields)))
        return nn.Sequential(logic, nn.Linear(logic.width, len(ACTIONS)))


class TransformerLearner(CloningLearner):
    """Behavior cloning of a transformer over the entities."""

    settings_class = TransformerSettings

    @staticmethod
    def new_network(layout: Layout, settings: TransformerSettings) -> nn.Module:
        """Create the layers of attention, and a linear layer on the ego."""
        options = settings.model_dump(include={"layers", "heads", "head_width", "feedforward"})
        return TransformerNetwork(layout, len(ACTIONS), **options)


_LEARNERS: dict[str, type[CloningLearner]] = {
    "mlp": MlpLearner,
    "gnn": GnnLearner,
    "nlm": NlmLearner,
    "transformer": TransformerLearner,
}


def shuffled(observations: Tensor, layout: Layout, generator: torch.Generator) -> Tensor:
    """Permute the present entities other than the ego, at random in each of the observations, (batch, width)."""
    batch, count = len(observations), layout.entities
    present = observations.abs() @ torch.from_numpy(layout.occurrences()) > 0
    # Absent entities stay behind all others, and the ego stays first.
    keys = torch.rand(batch, count, generator=generator) + torch.where(present, 0.0, 1.0 + torch.arange(count))
    keys[:, 0] = -1.0
    order = keys.argsort(1)
    unary_at, binary_at = torch.from_numpy(layout.unary_at), torch.from_numpy(layout.binary_at)
    source = torch.arange(layout.width).repeat(batch, 1)
    source[:, unary_at.flatten()] = unary_at[order].flatten(1)
    source[:, binary_at.flatten()] = binary_at[order[:, :, None], order[:, None, :]].flatten(1)
    return observations.gather(1, source)
