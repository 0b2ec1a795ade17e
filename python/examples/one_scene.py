"""Decide a scene under your own rules, with and without a bus inside the intersection. Needs numpy only.

Run it as `python python/examples/one_scene.py`. It prints:

```text
inside the intersection: ['bus']; action: Stop
inside the intersection: []; action: Slow
```
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import logicity

RULES = """\
.include "vocabulary.dl"

/// S1: wait at the entrance while a bus is inside
Stop(X) :- IsAtInter(X), IsInInter(Y), IsBus(Y).

/// L1: slow near pedestrians
Slow(X) :- Not(Stop(X)), IsPedestrian(Y), IsClose(X, Y).
"""

facts = {
    "IsCar": ["me", "bus"],
    "IsBus": ["bus"],
    "IsPedestrian": ["walker"],
    "IsAtInter": ["me"],
    "IsClose": [["me", "walker"], ["walker", "me"]],
}

with TemporaryDirectory() as folder:
    rules = Path(folder) / "rules.dl"
    rules.write_text(RULES, encoding="utf-8")
    for inside in (["bus"], []):
        scene: Any = {"entities": ["me", "bus", "walker"], "ego": "me", "facts": {**facts, "IsInInter": inside}}
        decision = logicity.infer(scene, "expert", rules=rules)["egos"]["me"]
        print(f"inside the intersection: {inside}; action: {decision['action']}")
