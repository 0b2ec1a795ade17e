"""Environments of Safe Path Following.

`import logicity` registers them with gymnasium: `gymnasium.make("logicity/SPF-Expert-v0")` makes an `SPFEnv`, and
`gymnasium.make_vec("logicity/SPF-Expert-v0", num_envs=256)` makes an `SPFVectorEnv`. `logicity.parallel_env` makes an
`SPFParallelEnv`, in which several cars are controlled agents, and `SPFParallelVectorEnv` steps many of these.

- `layout` has the positions of the numbers in an observation, and `views` maps observations to tensors and graphs.
- `wrappers` replaces the observations of an environment by such views.
- `sb3` and `torchrl` adapt environments to Stable-Baselines3 and TorchRL.

The classes need the extra `gym`, and some modules another extra. Modules are imported on first use.
"""

from typing import TYPE_CHECKING

from ..lazily import exports

if TYPE_CHECKING:
    from ..types import EpisodeAgent, EpisodeStart, OracleRun
    from . import layout as layout
    from . import parallel as parallel
    from . import parallel_vector as parallel_vector
    from . import sb3 as sb3
    from . import single as single
    from . import torchrl as torchrl
    from . import vector as vector
    from . import views as views
    from . import wrappers as wrappers
    from .parallel import SPFParallelEnv
    from .parallel_vector import SPFParallelVectorEnv
    from .single import SPFEnv
    from .vector import SPFVectorEnv

_HOMES = {
    "EpisodeAgent": ".types",
    "EpisodeStart": ".types",
    "OracleRun": ".types",
    "SPFEnv": "single",
    "SPFParallelEnv": "parallel",
    "SPFParallelVectorEnv": "parallel_vector",
    "SPFVectorEnv": "vector",
}
_MODULES = ("layout", "parallel", "parallel_vector", "sb3", "single", "torchrl", "vector", "views", "wrappers")

__all__ = [
    "EpisodeAgent",
    "EpisodeStart",
    "OracleRun",
    "SPFEnv",
    "SPFParallelEnv",
    "SPFParallelVectorEnv",
    "SPFVectorEnv",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = exports(globals(), _HOMES, _MODULES)
