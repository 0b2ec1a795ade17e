"""PPO in one file, in the style of CleanRL: PyTorch, the vector API of gymnasium, and no framework.

Needs `pip install './python[learn]'`. Run it as `python python/examples/cleanrl_ppo.py`; `--help` lists the options.
The defaults take about a minute on one core. `tensorboard --logdir runs` shows the curves.

The algorithm is proximal policy optimization with clipped ratios (Schulman et al., 2017, arXiv:1707.06347) and
generalized advantage estimation (Schulman et al., 2016, arXiv:1506.02438).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, fields

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.distributions import Categorical
from torch.utils.tensorboard.writer import SummaryWriter

import logicity


@dataclass(frozen=True)
class Options:
    """The options of the command line."""

    mode: str = "easy"
    steps: int = 1_000_000  # of all environments together
    envs: int = 256
    rollout: int = 16  # steps of each environment between updates
    epochs: int = 2
    minibatch: int = 1024
    hidden: int = 128
    learning_rate: float = 1e-3  # falls linearly to zero
    gamma: float = 0.9
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy: float = 0.01  # weight of the entropy bonus
    value: float = 0.5  # weight of the value loss
    max_grad_norm: float = 0.5
    progress: float = 5.0  # reward for the whole route, in training only
    seed: int = 0
    log: str = "runs/cleanrl-ppo"


def options() -> Options:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description="Train PPO on Safe Path Following.")
    for field in fields(Options):
        default = field.default
        parser.add_argument(
            f"--{field.name.replace('_', '-')}", type=type(default), default=default, help=f"default: {default}"
        )
    return Options(**vars(parser.parse_args()))


class Agent(nn.Module):
    """A network for the logits of the actions, and one for the value of a state."""

    def __init__(self, width: int, hidden: int) -> None:
        """Initialize the networks. Small logits at the start make all actions about equally probable."""
        super().__init__()
        self.actor, self.critic = self._network(width, hidden, 4, 0.01), self._network(width, hidden, 1, 1.0)

    @staticmethod
    def _network(width: int, hidden: int, outputs: int, scale: float) -> nn.Sequential:
        layers = [nn.Linear(width, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, outputs)]
        for layer, gain in zip(layers, (2**0.5, 2**0.5, scale), strict=True):
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)
        return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the most probable action for each observation."""
        with torch.no_grad():
            return np.asarray(self.actor(torch.from_numpy(observations)).argmax(-1))


def advantages(
    rewards: torch.Tensor,
    values: torch.Tensor,
    following: torch.Tensor,
    ended: torch.Tensor,
    gamma: float,
    decay: float,
) -> torch.Tensor:
    """Return the generalized advantage estimates of a rollout. All tensors have shape (steps, envs).

    Args:
        rewards: The rewards of the steps.
        values: The values of the states before the steps.
        following: The values of the states after the steps, 0 where the episode terminated.
        ended: 1 where the episode terminated or was truncated, else 0.
        gamma: The discount factor.
        decay: The weight of the next step's estimate, besides `gamma`.
    """
    errors = rewards + gamma * following - values
    estimates, later = torch.zeros_like(rewards), torch.zeros_like(rewards[0])
    for step in reversed(range(len(rewards))):
        later = errors[step] + gamma * decay * (1 - ended[step]) * later
        estimates[step] = later
    return estimates


def main(given: Options) -> None:
    """Train, and measure before and after on the recorded validation episodes."""
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
    agent = Agent(shape[0], given.hidden)
    optimizer = torch.optim.Adam(agent.parameters(), lr=given.learning_rate, eps=1e-5)
    writer = SummaryWriter(given.log)
    print(f"before training: {logicity.evaluate(agent.act, given.mode, 'val', batched=True).summary()}")

    # The rollout: one row per step, one column per environment.
    size = (given.rollout, given.envs)
    observations = torch.zeros(*size, shape[0])
    actions = torch.zeros(size, dtype=torch.int64)
    log_probs, rewards, values, following, ended = (torch.zeros(size) for _ in range(5))
    current = torch.from_numpy(envs.reset(seed=given.seed)[0])
    returns, finished = np.zeros(given.envs), []
    batch = given.rollout * given.envs
    updates, start = max(1, given.steps // batch), time.process_time()
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = given.learning_rate * (1 - update / updates)

        # Collect a rollout.
        for step in range(given.rollout):
            with torch.no_grad():
                policy = Categorical(logits=agent.actor(current))
                action = policy.sample()
                observations[step], actions[step], log_probs[step] = current, action, policy.log_prob(action)
                values[step] = agent.critic(current).squeeze(-1)
                after, reward, terminated, truncated, infos = envs.step(action.numpy())
                over = terminated | truncated
                # In this autoreset mode, `after` has the first observation of the next episode where one ended.
                last = after.copy()
                for at in np.flatnonzero(over):
                    last[at] = infos["final_obs"][at]
                known = torch.from_numpy(~terminated).float()
                following[step] = agent.critic(torch.from_numpy(last)).squeeze(-1) * known
            rewards[step], ended[step] = torch.from_numpy(reward).float(), torch.from_numpy(over).float()
            current = torch.from_numpy(after)
            returns += reward
            if over.any():
                finished += list(zip(returns[over], infos["final_info"]["success"][over], strict=True))
            returns[over] = 0
        estimates = advantages(rewards, values, following, ended, given.gamma, given.gae_lambda)

        # Improve the policy and the value function.
        flat = [each.flatten(0, 1) for each in (observations, actions, log_probs, estimates, estimates + values)]
        for _ in range(given.epochs):
            for part in torch.randperm(batch).split(given.minibatch):
                seen, taken, old, advantage, target = (each[part] for each in flat)
                policy = Categorical(logits=agent.actor(seen))
                ratio = (policy.log_prob(taken) - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - given.clip, 1 + given.clip)
                policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                value_loss = 0.5 * (agent.critic(seen).squeeze(-1) - target).square().mean()
                entropy = policy.entropy().mean()
                optimizer.zero_grad()
                (policy_loss + given.value * value_loss - given.entropy * entropy).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), given.max_grad_norm)
                optimizer.step()

        # Log the last minibatch, and the episodes that ended.
        total = (update + 1) * batch
        scalars = {"policy_loss": policy_loss.item(), "value_loss": value_loss.item(), "entropy": entropy.item()}
        if finished:
            mean_return, success = np.mean(np.array(finished, float), 0)
            scalars |= {"episode/return": mean_return, "episode/success": success}
            finished = []
        scalars["steps_per_cpu_second"] = total / (time.process_time() - start)
        for name, value in scalars.items():
            writer.add_scalar(name, value, total)
    writer.close()
    envs.close()
    print(f"after {updates * batch} steps: {logicity.evaluate(agent.act, given.mode, 'val', batched=True).summary()}")


if __name__ == "__main__":
    main(options())
