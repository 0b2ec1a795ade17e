"""Maintain reachability while edges are inserted and retracted, and explain why a fact is gone. Needs numpy only.

Run it as `python python/examples/incremental.py`. It prints:

```text
added [(1, 2), (1, 3), (1, 4), (2, 3), (2, 4), ...]
removed [(1, 3), (1, 4), (2, 3), (2, 4)]
Not(path(1, 3)): no clause of path holds
├─ path(x, y) :- edge(x, y).  [<text>:5]
│  └─ edge(1, 3) does not hold
└─ path(x, z) :- path(x, y), edge(y, z).  [<text>:6]
   └─ nearest y = 2: edge(2, 3) does not hold

```
"""

import numpy as np

from logicity import Program, Session

program = Program("""
.decl edge(x: number, y: number)
.input edge
.decl path(x: number, y: number)
path(x, y) :- edge(x, y).
path(x, z) :- path(x, y), edge(y, z).
""")

session = Session(program)
session.insert("edge", np.array([[1, 2], [2, 3], [3, 4]]))
print("added", session.commit()["path"].added)

session.retract("edge", [(2, 3)])
print("removed", session.commit()["path"].removed)

print(session.why_not("path(1, 3)"))
