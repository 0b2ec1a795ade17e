"""Train PPO with TorchRL in easy mode, and measure it. Needs `pip install './python[torchrl]'`.

Run it as `python python/examples/torchrl_ppo.py [STEPS]`. The default of 600000 steps takes about a minute on one core.
"""

# %% Imports, and settings.
import sys

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.modules import ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import logicity
from logicity.envs.torchrl import SPFTorchRLEnv

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 600_000
ENVS, ROLLOUT, EPOCHS, MINIBATCH, GAMMA, RATE = 256, 16, 2, 1024, 0.9, 1e-3

torch.manual_seed(0)
torch.set_num_threads(1)

# %% Batched environments. The reward for progress gives a signal in every step; measures never have it.
env = SPFTorchRLEnv(ENVS, "easy", overrides={"task": {"reward": {"progress": 5}}}, oracle=False)
env.set_seed(0)
width = env.observation_spec["observation"].shape[-1]


def network(outputs: int) -> nn.Module:
    """Return a network with two hidden layers."""
    return nn.Sequential(nn.Linear(width, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, outputs))


# %% The actor, the critic, and what PPO needs.
logits = network(4)
actor = ProbabilisticActor(
    TensorDictModule(logits, ["observation"], ["logits"]),
    ["logits"],
    spec=env.action_spec,
    distribution_class=torch.distributions.Categorical,
    return_log_prob=True,
)
critic = ValueOperator(network(1), in_keys=["observation"])
advantages = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic, average_gae=True)
loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=0.01, critic_coeff=0.5)
optimizer = torch.optim.Adam(loss.parameters(), lr=RATE)


def act(observations: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the most probable action for each observation."""
    with torch.no_grad():
        return np.asarray(logits(torch.from_numpy(observations)).argmax(-1))


# %% Train, and measure before and after on the recorded validation episodes.
print(f"before training: {logicity.evaluate(act, 'easy', 'val', batched=True).summary()}")
frames = ENVS * ROLLOUT
collector = Collector(
    env,
    actor,
    frames_per_batch=frames,
    total_frames=max(1, STEPS // frames) * frames,
    auto_register_policy_transforms=False,
)
for batch in collector:
    for _ in range(EPOCHS):
        with torch.no_grad():
            advantages(batch)
        steps = batch.reshape(-1)
        for part in torch.randperm(len(steps)).split(MINIBATCH):
            losses = loss(steps[part])
            optimizer.zero_grad()
            sum(losses[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimizer.step()
print(f"after training: {logicity.evaluate(act, 'easy', 'val', batched=True).summary()}")
