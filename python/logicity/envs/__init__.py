"""Environments of Safe Path Following.

`import logicity` registers them with gymnasium: `gymnasium.make("logicity/SPF-Expert-v0")` makes an `SPFEnv`, and
`gymnasium.make_vec("logicity/SPF-Expert-v0", num_envs=256)` makes an `SPFVectorEnv`. `logicity.parallel_env` makes an
`SPFParallelEnv`, in which every car is a controlled agent.

- `layout` has the positions of the numbers in an observation, and `views` maps observations to tensors and graphs.
- `wrappers` replaces the observations of an environment by such views.
- `sb3` and `torchrl` adapt environments to Stable-Baselines3 and TorchRL.

The classes need the extra `gym`, and some modules another extra. Modules are imported on first use.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import layout as layout
    from . import parallel as parallel
    from . import sb3 as sb3
    from . import single as single
    from . import torchrl as torchrl
    from . import vector as vector
    from . import views as views
    from . import wrappers as wrappers
    from .interface import EpisodeAgent, EpisodeStart, OracleRun
    from .parallel import SPFParallelEnv
    from .single import SPFEnv
    from .vector import SPFVectorEnv

_HOMES = {
    "EpisodeAgent": "interface",
    "EpisodeStart": "interface",
    "OracleRun": "interface",
    "SPFEnv": "single",
    "SPFParallelEnv": "parallel",
    "SPFVectorEnv": "vector",
}
_MODULES = ("layout", "parallel", "sb3", "single", "torchrl", "vector", "views", "wrappers")

__all__ = ["EpisodeAgent", "EpisodeStart", "OracleRun", "SPFEnv", "SPFParallelEnv", "SPFVectorEnv"]

if not TYPE_CHECKING:

    def __getattr__(name):
        """Import a public name, or a module, on first use (PEP 562)."""
        if name in _MODULES:
            return importlib.import_module(f".{name}", __name__)
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)

    def __dir__():
        """List all names, including those that are imported lazily."""
        return sorted({*globals(), *__all__, *_MODULES})
