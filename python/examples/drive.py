"""Drive a car through an episode, then measure a policy on the recorded episodes. Needs the extra `gym`.

Run it as `python python/examples/drive.py`. It prints:

```text
oracle: 96 steps, return -0.09, success True
always Normal: compliance 0.00 [0.00, 0.09], TSR 0.00 [0.00, 0.09], DSR 0.00 [0.00, 0.09], Score -2.08 [-3.18, -0.97]
oracle: compliance 1.00 [0.91, 1.00], TSR 1.00 [0.91, 1.00], DSR 1.00 [0.91, 1.00], Score 7.65 [6.58, 8.71]
```
"""

from typing import Any

import gymnasium

import logicity

# Drive: `info["oracle_action"]` is the action that the rules want.
env = gymnasium.make(logicity.ENVIRONMENTS["easy"], split="val")
observation, info = env.reset(options={"episode": 0})
total, ended = 0.0, False
while not ended:
    observation, reward, terminated, truncated, info = env.step(info["oracle_action"])
    total += float(reward)
    ended = terminated or truncated
print(f"oracle: {info['steps']} steps, return {total:.2f}, success {info['success']}")

# Measure: a policy is a function from an observation to an action.
normal = logicity.ACTIONS.index("Normal")
policies: dict[str, Any] = {"always Normal": lambda observation: normal, "oracle": "oracle"}
for name, policy in policies.items():
    print(f"{name}: {logicity.evaluate(policy, 'easy', split='val').summary()}")
