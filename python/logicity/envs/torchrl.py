"""Batched environments for TorchRL. Needs the extra `torchrl`: `pip install 'logicity[torchrl]'`."""

from __future__ import annotations

import os
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import extra

with extra("torchrl"):
    import torch
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box, Dict, MultiBinary, Space
    from gymnasium.vector import AutoresetMode
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded
    from torchrl.envs import EnvBase

from .interface import checked_options
from .vector import SPFVectorEnv

__all__ = ["SPFTorchRLEnv"]


class SPFTorchRLEnv(EnvBase):
    """Environments of Safe Path Following as a batched TorchRL environment: one call steps all of them.

    The batch size is (num_envs,). The results of each environment equal those of an `SPFEnv`: after `set_seed(s)`,
    environment i has the seed s + i. `reset` supports `_reset` masks, and `step` supports the `_step` masks of
    `rollout(break_when_all_done=True)`. A step of an environment whose episode has ended raises
    `gymnasium.error.ResetNeeded`.

    A tensordict has these entries:

    - `action`: int64 (num_envs,), 0 Slow, 1 Normal, 2 Fast or 3 Stop.
    - `observation`: float32 (num_envs, ...). Observations of the kinds `relational` and `graph` are several entries
      instead, such as `unary`, `binary` and `mask`.
    - `success`: bool (num_envs, 1), whether the car has reached the goal without violating a rule.
    - `progress`: float32 (num_envs, 1), the completed share of the route.
    - `oracle_action`, unless `oracle=False`: int64 (num_envs, 1), the action that the rules derive.
    - `violations`: bool (num_envs, clauses), the clauses that the last action violated. `clauses` names them.
    - `action_mask`, with `action_masks=True`: bool (num_envs, 4), the actions that violate no clause.
    - `reward`: float32 (num_envs, 1), and `done`, `terminated`, `truncated`: bool (num_envs, 1).

    `reset(options={"episodes": range(40)})` starts recorded episodes, see `SPFVectorEnv.reset`. After a partial reset
    this option applies only to the environments that the mask selects.

    Args:
        num_envs, config: As for `SPFVectorEnv`.
        device: The device of the tensors. The environments run on the CPU.
        arguments: Other parameters of `SPFVectorEnv`, except `autoreset_mode` and `copy`: TorchRL resets environments
            itself.

    Raises the exceptions of `SPFVectorEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: str | os.PathLike[str] = "expert",
        *,
        device: torch.device | str | None = "cpu",
        **arguments: Any,
    ) -> None:
        """Make the environments and their specs."""
        for name in ("autoreset_mode", "copy"):
            if name in arguments:
                raise TypeError(f"SPFTorchRLEnv() got an unexpected keyword argument '{name}': TorchRL resets episodes")
        # In this mode, a step of an environment whose episode has ended is possible, as `_step` masks need.
        self.envs = SPFVectorEnv(num_envs, config, autoreset_mode=AutoresetMode.NEXT_STEP, **arguments)
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        self._seeds: list[int | None] = [None] * num_envs
        self._ended = np.ones(num_envs, np.bool_)
        #: The sources of episodes before steps that a mask skips, by environment.
        self._sources: dict[int, list[int]] = {}
        self._state: dict[str, NDArray[Any]] = {}
        self.observation_spec = Composite(self._specs(), shape=self.batch_size, device=self.device)
        self.action_spec = Categorical(len(self.envs.action_names), (num_envs,), device=self.device, dtype=torch.int64)
        self.reward_spec = Unbounded((num_envs, 1), device=self.device, dtype=torch.float32)
        flag = Categorical(2, (num_envs, 1), device=self.device, dtype=torch.bool)
        flags = {name: flag.clone() for name in ("done", "terminated", "truncated")}
        self.done_spec = Composite(flags, shape=self.batch_size, device=self.device)

    @property
    def clauses(self) -> tuple[str, ...]:
        """The names of the clauses that actions can violate, such as `S1`, in the order of `violations`."""
        return self.envs.clauses

    # Two environments cannot share a city.
    __copy__ = deepcopy

    def _specs(self) -> dict[str, TensorSpec]:
        """Return the spec of each entry of an observation."""
        space, config, count = self.envs.single_observation_space, self.envs._config, self.envs.num_envs
        spaces = dict(space.spaces) if isinstance(space, Dict) else {"observation": space}
        specs = {name: _spec(each, count) for name, each in spaces.items()}
        specs["success"] = Binary(shape=(count, 1), dtype=torch.bool)
        specs["progress"] = Bounded(0.0, 1.0, (count, 1), dtype=torch.float32)
        specs["violations"] = Binary(shape=(count, len(self.clauses)), dtype=torch.bool)
        if config.oracle:
            specs["oracle_action"] = Bounded(0, len(self.envs.action_names) - 1, (count, 1), dtype=torch.int64)
        if config.action_masks:
            specs["action_mask"] = Binary(shape=(count, len(self.envs.action_names)), dtype=torch.bool)
        return specs

    def _set_seed(self, seed: int | None) -> None:
        """Store the seeds of the environments for their next resets. `None` continues their sequences of episodes."""
        self._seeds = [None if seed is None else seed + at for at in range(self.envs.num_envs)]

    def _reset(self, tensordict: TensorDictBase | None = None, **options: Any) -> TensorDictBase:
        """Start episodes in the environments that `_reset` selects, by default in all."""
        given = dict(checked_options(options.pop("options", None)))
        if options:
            raise TypeError(f"reset() got an unexpected keyword argument '{next(iter(options))}'; known: options")
        mask = self._mask(tensordict, "_reset")
        for at in np.flatnonzero(mask).tolist():
            # The episodes that skipped steps have started do not count.
            if at in self._sources:
                self.envs._core.seed(at, *self._sources.pop(at))
        seeds = [seed if chosen else None for seed, chosen in zip(self._seeds, mask, strict=True)]
        if mask.any():
            observations, infos = self.envs.reset(seed=seeds, options={**given, "reset_mask": mask})
            none = np.zeros(len(mask), np.bool_)
            self._update(observations, infos, mask, np.zeros(len(mask)), none, none)
            self._seeds = [None if chosen else seed for seed, chosen in zip(self._seeds, mask, strict=True)]
        return self._tensors(reward=False)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Run one tick in the environments that `_step` selects, by default in all."""
        actions = tensordict.get("action").detach().cpu().numpy()
        mask = self._mask(tensordict, "_step")
        if (mask & self._ended).any():
            raise ResetNeeded("an episode has ended, or none has started: call `reset`")
        if not (mask | self._ended).all():
            raise ValueError("`_step` can skip only environments whose episode has ended")
        for at in np.flatnonzero(~mask).tolist():
            self._sources.setdefault(at, self.envs._core.source(at))
        observations, rewards, terminated, truncated, infos = self.envs.step(
            np.where(mask, actions, np.zeros_like(actions))
        )
        self._update(observations, infos, mask, rewards, terminated, truncated)
        return self._tensors(reward=True)

    def _mask(self, tensordict: TensorDictBase | None, key: str) -> NDArray[np.bool_]:
        """Return the environments that an entry of a tensordict selects, by default all."""
        mask = None if tensordict is None else tensordict.get(key, None)
        if mask is None:
            return np.ones(self.envs.num_envs, np.bool_)
        return np.array(mask.reshape(self.envs.num_envs).cpu().numpy(), np.bool_)

    def _update(
        self,
        observations: Any,
        infos: dict[str, Any],
        mask: NDArray[np.bool_],
        rewards: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> None:
        """Replace the state of the selected environments."""
        count = self.envs.num_envs
        known = ("success", "progress", "violations", "oracle_action", "action_mask")
        columns = {name: infos[name] for name in known if name in infos}
        columns |= {"reward": rewards.astype(np.float32), "terminated": terminated, "truncated": truncated}
        entries = dict(observations) if isinstance(observations, dict) else {"observation": observations}
        entries |= {name: values.reshape(count, -1) for name, values in columns.items()}
        entries["done"] = entries["terminated"] | entries["truncated"]
        if mask.all() or not self._state:
            self._state = entries
        else:
            self._state = {
                name: np.where(mask.reshape(count, *[1] * (values.ndim - 1)), values, self._state[name])
                for name, values in entries.items()
            }
        self._ended = self._state["done"][:, 0]

    def _tensors(self, reward: bool) -> TensorDictBase:
        """Return a copy of the state as tensors. A change of them does not affect the environments."""
        types = {"progress": torch.float32, "action_mask": torch.bool}
        entries = {
            name: torch.tensor(values, dtype=types.get(name), device=self.device)
            for name, values in self._state.items()
            if reward or name != "reward"
        }
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)


def _spec(space: Space[Any], count: int) -> TensorSpec:
    """Return the spec of a space with a first axis for the environments."""
    shape = (count, *(space.shape or ()))
    if isinstance(space, MultiBinary):
        return Binary(shape=shape, dtype=torch.int8)
    assert isinstance(space, Box)
    low, high = (torch.from_numpy(np.broadcast_to(bound, shape).copy()) for bound in (space.low, space.high))
    return Bounded(low, high, shape=shape, dtype=low.dtype)
