"""Train a small agent, measure it, and replay an episode. Needs `pip install './python[learn]'`.

Run it as `python python/examples/train_and_show.py [STEPS]`. The default of 20000 steps takes about a minute.
"""

# %% Imports; `import logicity` registers the environments.
import sys
from itertools import compress
from typing import Any

import gymnasium
from stable_baselines3 import DQN

import logicity
from logicity.envs.sb3 import make_vec_env

STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000

# %% Train on new episodes. Observations show everything that a rule forbids now, so a small gamma is enough.
model = DQN(
    "MlpPolicy",
    make_vec_env("easy", n_envs=4, seed=0),
    learning_rate=5e-4,
    batch_size=128,
    buffer_size=50_000,
    learning_starts=1_000,
    train_freq=1,
    target_update_interval=1_000,
    exploration_fraction=0.5,
    exploration_final_eps=0.02,
    gamma=0.5,
    policy_kwargs={"net_arch": [128, 64]},
    seed=0,
    device="cpu",
)
model.learn(STEPS)

# %% Measure the agent, the oracle and the random policy on the recorded test episodes.
benchmark = logicity.Benchmark("easy")
policies: dict[str, Any] = {"dqn": model, "oracle": "oracle", "random": "random"}
for name, policy in policies.items():
    measured = benchmark.evaluate(policy, name=name)
    print(f"{name:7} {measured.summary()}")

# %% Replay an episode, and explain the oracle's action where the agent takes another action.
env = gymnasium.make(logicity.ENVIRONMENTS["easy"], split="test", render_mode="rgb_array")
observation, info = env.reset(options={"episode": 0})
city: Any = env.unwrapped
ended = False
while not ended:
    action, _ = model.predict(observation, deterministic=True)
    if action != info["oracle_action"]:
        print(f"step {info['steps']}: action {action}; {city.explain().splitlines()[0]}")
    observation, reward, terminated, truncated, info = env.step(action)
    ended = terminated or truncated
violations = ", ".join(compress(city.clauses, info["violations"])) or "none"
print(f"{info['steps']} steps, {info['progress']:.0%} of the route, violations: {violations}")
picture: Any = env.render()
print(f"shape of the last picture: {picture.shape}")
