"""A city of cars and pedestrians governed by Datalog rules, for neuro-symbolic research.

What to reach for:

- the faults of a rule text: `check`;
- what the rules decide in a scene: `infer`, or `Inference` for many scenes;
- a city that runs: `Simulation`;
- Datalog without a city: `Program` and `Session`;
- a car to drive: `gymnasium.make("logicity/SPF-Expert-v0")`, see `logicity.envs`; every car: `parallel_env`;
- what the numbers of its observations stand for: `observation_names`;
- how well a policy drives: `evaluate`, or `Benchmark` for many; what the oracle does, as data: `demonstrations`;
- a language model to question about cars: `logicity.questions`;
- pictures of cities, what is true in them and what cars do next: `logicity.vap`.

`logicity.sb3`, `train`, `parallel` and `icons` need extras; they are imported when they are first asked for.

Faulty input raises `InputError`, which has every fault with its place; input that is too large its subclass
`LimitError`.
"""

import importlib
from typing import TYPE_CHECKING

from . import vap
from ._logicity import __version__
from .city import ACTIONS, HEADINGS, REASONS, AgentInfo, Decision, Inference, Simulation, Tick, infer
from .describe import observation_names
from .errors import InputError, LimitError
from .evaluation import Benchmark, EpisodeRecord, Evaluation, Interval, Policy, evaluate
from .modes import ENVIRONMENTS, MODES, parallel_env
from .offline import Demonstrations, Trajectory, demonstrations
from .rules import Change, Column, Explanation, Program, Relation, Rows, Session, check
from .types import (
    Action,
    Agent,
    Answer,
    Clause,
    ClauseWork,
    Diagnostic,
    EgoAnswer,
    Executor,
    Heading,
    Label,
    Scene,
    Split,
    StratumWork,
    SymbolicScene,
)

if TYPE_CHECKING:
    from . import icons as icons
    from . import parallel as parallel
    from . import sb3 as sb3
    from . import train as train
else:

    def __getattr__(name):
        """Import what needs an extra when it is first asked for."""
        if name in ("icons", "parallel", "sb3", "train"):
            return importlib.import_module(f".{name}", __name__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "ACTIONS",
    "ENVIRONMENTS",
    "HEADINGS",
    "MODES",
    "REASONS",
    "Action",
    "Agent",
    "AgentInfo",
    "Answer",
    "Benchmark",
    "Change",
    "Clause",
    "ClauseWork",
    "Column",
    "Decision",
    "Demonstrations",
    "Diagnostic",
    "EgoAnswer",
    "EpisodeRecord",
    "Evaluation",
    "Executor",
    "Explanation",
    "Heading",
    "Inference",
    "InputError",
    "Interval",
    "Label",
    "LimitError",
    "Policy",
    "Program",
    "Relation",
    "Rows",
    "Scene",
    "Session",
    "Simulation",
    "Split",
    "StratumWork",
    "SymbolicScene",
    "Tick",
    "Trajectory",
    "__version__",
    "check",
    "demonstrations",
    "evaluate",
    "infer",
    "observation_names",
    "parallel_env",
    "vap",
]
