"""A city of cars and pedestrians governed by Datalog rules, for neuro-symbolic research.

Where to start:

- `check` returns the errors and warnings of rules.
- `infer` applies the rules to one scene; `Inference` applies them to many.
- `Simulation` runs a city. `predicate` makes a base predicate of a Python function.
- `Program` and `Session` evaluate any Datalog program.
- `gymnasium.make("logicity/SPF-Expert-v0")` makes an environment with one controlled car, see `logicity.envs.single`.
  `parallel_env` makes an environment that controls every car. `shield` lets rules judge the actions.
- `observation_names` names the numbers of an observation.
- `evaluate` measures one policy, `Benchmark` several. `demonstrations` returns trajectories of the oracle, and
  `induce` learns rules from them.
- `RulePolicy` makes a policy of a rule file. `shipped_policies` lists the trained policies of this package.
- `logicity.questions` sends multiple-choice questions to a language model and grades the replies.
- `logicity.vap` makes and reads data sets of Visual Action Prediction.

The core needs only numpy. Environments and `demonstrations` need the extra `gym`. `logicity.learn`, `logicity.icons`
and some modules of `logicity.envs` each need another extra. Modules are imported on first use.

Invalid input raises `InputError`, which lists every error with its location. The subclass `LimitError` means that a
limit was exceeded. The subclass `UnsupportedError` means that the dense executor cannot evaluate the rules. Ctrl-C
raises `KeyboardInterrupt`.
"""

from typing import TYPE_CHECKING

from ._logicity import __version__
from .envs.registration import register_with_gymnasium
from .lazily import exports

if TYPE_CHECKING:
    from . import envs as envs
    from . import icons as icons
    from . import learn as learn
    from . import questions as questions
    from . import torch as torch
    from . import vap as vap
    from .city import ACTIONS, HEADINGS, REASONS, AgentInfo, Decision, Inference, Simulation, Tick, infer
    from .describe import observation_names
    from .envs.registration import parallel_env
    from .envs.shield import shield
    from .errors import InputError, LimitError, PredicateError, UnsupportedError, UntrustedError
    from .evaluation import Benchmark, EpisodeRecord, Evaluation, Interval, Policy, evaluate
    from .induction import InducedClause, InducedRules, Oracle, induce
    from .modes import ENVIRONMENTS, MODES
    from .offline import Demonstrations, Trajectory, demonstrations
    from .packed import ShippedPolicy, shipped_policies
    from .predicates import KINDS, CityState, PythonPredicate, predicate
    from .rule_policy import RulePolicy
    from .rules import Change, Column, Explanation, Marginals, Predicate, Program, Rows, Session, check
    from .types import (
        Action,
        Agent,
        Answer,
        Clause,
        Diagnostic,
        EgoAnswer,
        EgoMarginals,
        Estimate,
        Executor,
        Heading,
        Label,
        Limits,
        MarginalAnswer,
        RuleStats,
        Scene,
        Split,
        StratumStats,
        SymbolicScene,
    )

#: The public names by the module that defines them.
_NAMES = {
    "city": ["ACTIONS", "HEADINGS", "REASONS", "AgentInfo", "Decision", "Inference", "Simulation", "Tick", "infer"],
    "describe": ["observation_names"],
    "errors": ["InputError", "LimitError", "PredicateError", "UnsupportedError", "UntrustedError"],
    "evaluation": ["Benchmark", "EpisodeRecord", "Evaluation", "Interval", "Policy", "evaluate"],
    "induction": ["InducedClause", "InducedRules", "Oracle", "induce"],
    "envs.registration": ["parallel_env"],
    "envs.shield": ["shield"],
    "modes": ["ENVIRONMENTS", "MODES"],
    "offline": ["Demonstrations", "Trajectory", "demonstrations"],
    "packed": ["ShippedPolicy", "shipped_policies"],
    "predicates": ["KINDS", "CityState", "PythonPredicate", "predicate"],
    "rule_policy": ["RulePolicy"],
    "rules": ["Change", "Column", "Explanation", "Marginals", "Predicate", "Program", "Rows", "Session", "check"],
    "types": [
        "Action",
        "Agent",
        "Answer",
        "Clause",
        "Diagnostic",
        "EgoAnswer",
        "EgoMarginals",
        "Estimate",
        "Executor",
        "Heading",
        "Label",
        "Limits",
        "MarginalAnswer",
        "RuleStats",
        "Scene",
        "Split",
        "StratumStats",
        "SymbolicScene",
    ],
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
_MODULES = ("envs", "icons", "learn", "questions", "release", "torch", "vap")

__all__ = [
    "ACTIONS",
    "Action",
    "Agent",
    "AgentInfo",
    "Answer",
    "Benchmark",
    "Change",
    "CityState",
    "Clause",
    "Column",
    "Decision",
    "Demonstrations",
    "Diagnostic",
    "ENVIRONMENTS",
    "EgoAnswer",
    "EgoMarginals",
    "EpisodeRecord",
    "Estimate",
    "Evaluation",
    "Executor",
    "Explanation",
    "HEADINGS",
    "Heading",
    "InducedClause",
    "InducedRules",
    "Inference",
    "InputError",
    "Interval",
    "KINDS",
    "Label",
    "LimitError",
    "Limits",
    "MODES",
    "MarginalAnswer",
    "Marginals",
    "Oracle",
    "Policy",
    "Predicate",
    "PredicateError",
    "Program",
    "PythonPredicate",
    "REASONS",
    "Rows",
    "RulePolicy",
    "RuleStats",
    "Scene",
    "Session",
    "ShippedPolicy",
    "Simulation",
    "Split",
    "StratumStats",
    "SymbolicScene",
    "Tick",
    "Trajectory",
    "UnsupportedError",
    "UntrustedError",
    "__version__",
    "check",
    "demonstrations",
    "evaluate",
    "induce",
    "infer",
    "observation_names",
    "parallel_env",
    "predicate",
    "shield",
    "shipped_policies",
]

register_with_gymnasium()

if not TYPE_CHECKING:
    __getattr__, __dir__ = exports(globals(), _HOMES, _MODULES)
