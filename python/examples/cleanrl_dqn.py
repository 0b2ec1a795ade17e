"""Double DQN in one file, in the style of CleanRL: PyTorch, the vector API of gymnasium, and no framework.

Needs `pip install './python[learn]'`. Run it as `python python/examples/cleanrl_dqn.py`; `--help` lists the options.
The defaults take about a minute on one core. `tensorboard --logdir runs` shows the curves.

The algorithm is Q-learning with a replay buffer and a target network (Mnih et al., 2015, doi:10.1038/nature14236). The
network that learns selects the next action, and the target network values it (van Hasselt et al., 2016,
arXiv:1509.06461).
"""

from __future__ import annotations

import argparse
import copy
import time
from dataclasses import dataclass, fields
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.utils.tensorboard.writer import SummaryWriter

import logicity


@dataclass(frozen=True)
class Options:
    """The options of the command line."""

    mode: str = "easy"
    steps: int = 300_000  # of all environments together
    envs: int = 64
    buffer: int = 100_000  # steps
    learning_starts: int = 5_000  # steps with random actions
    updates: int = 2  # minibatches after each step of the environments
    minibatch: int = 256
    hidden: int = 128
    learning_rate: float = 1e-3
    gamma: float = 0.9
    target_every: int = 200  # minibatches between copies to the target network
    exploration: float = 0.3  # share of the steps in which the rate of random actions falls from 1
    exploration_end: float = 0.02  # that rate after them
    max_grad_norm: float = 10.0
    progress: float = 5.0  # reward for the whole route, in training only
    seed: int = 0
    log: str = "runs/cleanrl-dqn"


def options() -> Options:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Train DQN on Safe Path Following.")
    for field in fields(Options):
        default = field.default
        parser.add_argument(
            f"--{field.name.replace('_', '-')}", type=type(default), default=default, help=f"default: {default}"
        )
    return Options(**vars(parser.parse_args()))


class QNetwork(nn.Module):
    """Maps observations to the values of the four actions."""

    def __init__(self, width: int, hidden: int) -> None:
        """Initialize the layers."""
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 4)
        )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the values, of shape (batch, 4)."""
        values: torch.Tensor = self.layers(observations)
        return values

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the action with the largest value for each observation."""
        with torch.no_grad():
            return np.asarray(self(torch.from_numpy(observations)).argmax(-1))


class ReplayBuffer:
    """The last steps of all environments, which replace the oldest ones."""

    def __init__(self, size: int, width: int) -> None:
        """Allocate the arrays."""
        self.size, self.count, self.at = size, 0, 0
        self.arrays: tuple[NDArray[Any], ...] = (
            np.zeros((size, width), np.float32),
            np.zeros(size, np.int64),
            np.zeros(size, np.float32),
            np.zeros((size, width), np.float32),
            np.zeros(size, np.float32),
        )

    def add(self, *columns: NDArray[np.generic]) -> None:
        """Add a step of each environment: observation, action, reward, next observation, and whether it is terminal."""
        rows = (self.at + np.arange(len(columns[0]))) % self.size
        for array, column in zip(self.arrays, columns, strict=True):
            array[rows] = column
        self.at = (self.at + len(rows)) % self.size
        self.count = min(self.count + len(rows), self.size)

    def sample(self, count: int, random: np.random.Generator) -> list[torch.Tensor]:
        """Return random steps, with replacement."""
        rows = random.integers(self.count, size=count)
        return [torch.from_numpy(array[rows]) for array in self.arrays]


def main(given: Options) -> None:
    """Train, and measure before and after on the recorded validation episodes."""
    random = np.random.default_rng(given.seed)
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(
        logicity.ENVIRONMENTS[given.mode],
        num_envs=given.envs,
        autoreset_mode="SameStep",
        overrides={"task": {"reward": {"progress": given.progress}}},
    )
    shape = envs.single_observation_space.shape
    assert shape is not None
    network = QNetwork(shape[0], given.hidden)
    target = copy.deepcopy(network)
    optimizer = torch.optim.Adam(network.parameters(), lr=given.learning_rate)
    buffer = ReplayBuffer(given.buffer, shape[0])
    writer = SummaryWriter(given.log)
    print(f"before training: {logicity.evaluate(network.act, given.mode, 'val', batched=True).summary()}")

    current, _ = envs.reset(seed=given.seed)
    returns, finished, updates, loss = np.zeros(given.envs), [], 0, torch.zeros(())
    rounds, start = max(1, given.steps // given.envs), time.process_time()
    for step in range(1, rounds + 1):
        # Take a step in every environment. The rate of random actions falls linearly.
        rate = max(given.exploration_end, 1 - (1 - given.exploration_end) * step / (given.exploration * rounds))
        explores = random.random(given.envs) < (1 if step * given.envs < given.learning_starts else rate)
        actions = np.where(explores, random.integers(4, size=given.envs), network.act(current))
        after, rewards, terminated, truncated, infos = envs.step(actions)
        over = terminated | truncated
        # In this autoreset mode, `after` has the first observation of the next episode where one ended.
        last = after.copy()
        for at in np.flatnonzero(over):
            last[at] = infos["final_obs"][at]
        buffer.add(current, actions, rewards, last, terminated)
        current = after
        returns += rewards
        if over.any():
            finished += list(zip(returns[over], infos["final_info"]["success"][over], strict=True))
        returns[over] = 0

        # Learn from random steps of the buffer.
        for _ in range(given.updates if step * given.envs >= given.learning_starts else 0):
            seen, taken, reward, following, terminal = buffer.sample(given.minibatch, random)
            with torch.no_grad():
                best = network(following).argmax(-1, keepdim=True)
                value = target(following).gather(-1, best).squeeze(-1)
                goal = reward + given.gamma * (1 - terminal) * value
            loss = nn.functional.smooth_l1_loss(network(seen).gather(-1, taken[:, None]).squeeze(-1), goal)
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), given.max_grad_norm)
            optimizer.step()
            updates += 1
            if updates % given.target_every == 0:
                target.load_state_dict(network.state_dict())

        # Log the last minibatch, and the episodes that ended.
        if step % 100 == 0:
            total = step * given.envs
            scalars = {"loss": loss.item(), "exploration": rate}
            if finished:
                mean_return, success = np.mean(np.array(finished, float), 0)
                scalars |= {"episode/return": mean_return, "episode/success": success}
                finished = []
            scalars["steps_per_cpu_second"] = total / (time.process_time() - start)
            for name, number in scalars.items():
                writer.add_scalar(name, number, total)
    writer.close()
    envs.close()
    done = rounds * given.envs
    print(f"after {done} steps: {logicity.evaluate(network.act, given.mode, 'val', batched=True).summary()}")


if __name__ == "__main__":
    main(options())
