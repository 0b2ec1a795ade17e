"""Trajectories of the oracle for offline learning. Needs the extra `gym`.

`demonstrations` runs the oracle on the recorded episodes of a split. The result holds numpy arrays, and converts to a
Minari dataset, to a Parquet table, and to files for Popper, an inductive logic programming system.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, overload

import numpy as np
from numpy.typing import NDArray

from . import _logicity
from .city import ACTIONS
from .envs.config import checked_kind
from .envs.layout import atoms_of
from .errors import as_integer, checked_path, extra
from .evaluation import episodes_that_fit
from .files import reserved
from .modes import ENVIRONMENTS, checked_mode
from .tasks import load_task
from .types import ArrayKind, Atom, ViewKind

if TYPE_CHECKING:
    import gymnasium
    from minari import MinariDataset

__all__ = ["Demonstrations", "Trajectory", "demonstrations"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode of T steps.

    Attributes:
        episode: The number of the episode in the recorded set, from 0.
        seed: The seed of the episode.
        observations: float32 (T + 1, ...): the observations before each step and after the last one.
        actions: int64 (T,): 0 Slow, 1 Normal, 2 Fast, 3 Stop.
        rewards: float64 (T,).
        terminations: bool (T,): false except possibly at the last step.
        truncations: bool (T,): false except possibly at the last step.
        infos: The numeric keys of `info`, one array of shape (T + 1,) per key.
    """

    episode: int
    seed: int
    observations: NDArray[np.float32]
    actions: NDArray[np.int64]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.actions)


@dataclass(eq=False, repr=False)
class Demonstrations(Sequence[Trajectory]):
    """Trajectories of the oracle.

    Attributes:
        mode: The mode, or the path of the configuration file.
        split: The split of the episodes.
        episodes_hash: SHA-256 of the set of episodes.
        atoms: The atom of each number of an observation; for a value of a quantity, the name of its column with the
            entities, such as `("Waited", (0,))`. Empty if the observations are of the kind `state`.
        quantities: The names of the columns of quantities in `atoms`, such as `Waited` or `Heading=Up`.
        asked: The actions that the rules can require.
        env: The gymnasium spec of the environment.
    """

    mode: str
    split: str
    episodes_hash: str
    atoms: tuple[Atom, ...]
    quantities: tuple[str, ...]
    asked: tuple[str, ...]
    env: gymnasium.envs.registration.EnvSpec
    trajectories: tuple[Trajectory, ...]

    def __repr__(self) -> str:
        """Show the mode, the split, and the numbers of trajectories and steps."""
        steps = sum(len(trajectory) for trajectory in self)
        return f"<Demonstrations of {self.mode}, {self.split}: {len(self)} trajectories, {steps} steps>"

    def __len__(self) -> int:
        """Return the number of trajectories."""
        return len(self.trajectories)

    @overload
    def __getitem__(self, index: int) -> Trajectory: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Trajectory]: ...

    def __getitem__(self, index: int | slice) -> Trajectory | Sequence[Trajectory]:
        """Return one trajectory, or a slice of them."""
        return self.trajectories[index]

    def to_minari(self, dataset_id: str | None = None, **metadata: Any) -> MinariDataset:
        """Create a Minari dataset, whose `recover_environment()` makes the environment again.

        Minari, which the extra `offline` installs, stores datasets in the folder that the environment variable
        `MINARI_DATASETS_PATH` names, by default `~/.minari/datasets`.

        Args:
            dataset_id: The name of the dataset. The default is `logicity/spf-MODE/oracle-v0`. For a configuration file,
                MODE is the file name without its suffix.
            metadata: Other arguments of `minari.create_dataset_from_buffers`, such as `author`, `author_email` and
                `code_permalink`. Minari warns if these three are missing.

        Raises:
            ValueError: If the dataset already exists, or the environment has `predicates`.
        """
        if self.env.kwargs.get("predicates"):
            raise ValueError("a Minari dataset cannot store the functions of `predicates`: use `to_parquet`")
        with extra("offline"):
            import minari
            from minari.data_collector import EpisodeBuffer

        buffers = [
            EpisodeBuffer(
                id=number,
                seed=trajectory.seed,
                observations=list(trajectory.observations),
                actions=list(trajectory.actions),
                rewards=trajectory.rewards.tolist(),
                terminations=trajectory.terminations.tolist(),
                truncations=trajectory.truncations.tolist(),
                infos={name: list(values) for name, values in trajectory.infos.items()},
            )
            for number, trajectory in enumerate(self)
        ]
        return minari.create_dataset_from_buffers(
            dataset_id or f"logicity/spf-{Path(self.mode).stem}/oracle-v0",
            buffer=buffers,
            env=self.env,
            **{
                "eval_env": ENVIRONMENTS.get(self.mode, self.env),
                "algorithm_name": "oracle",
                "description": f"The oracle in {self.mode} mode; recorded episodes {self.episodes_hash}.",
                "requirements": ["logicity"],
                **metadata,
            },
        )

    def to_popper(
        self,
        folder: str | os.PathLike[str],
        *,
        distinct: bool = False,
        negated: bool = True,
        max_vars: int | None = None,
        overwrite: bool = False,
    ) -> list[Path]:
        """Write files for Popper, an inductive logic programming system, and return the folders of the actions.

        Every action that the rules can require gets a folder with `bk.pl`, `exs.pl` and `bias.pl`. The name of the
        folder is the action in lower case. Each step is one example, which is positive if the oracle took the action,
        and negative otherwise.

        In step 7, the constant `s7_e0` is the ego, and `s7_e1` to `s7_e4` are the other entities in its view. A
        predicate such as `IsAtInter` becomes `is_at_inter`. The facts `sees(s7_e0, s7_e1)` list the entities of a
        step. A learned rule needs them for entities that no other literal connects to the ego.

        Args:
            folder: The folder to write, which is created if it does not exist.
            distinct: Whether to write steps with the same observation and action only once. The rules that are
                consistent with all examples stay the same, but the weights of examples in noisy learning change.
            negated: Whether each false observed atom becomes a fact such as `not_is_at_inter`. Popper does not learn
                negated literals otherwise. These predicates double those of a task, and Popper's search grows much
                faster than their number.
            max_vars: The maximum number of variables of a rule, at least 1, for the declaration `max_vars`. Popper has
                6 without it.
            overwrite: Whether to replace files that this function did not write, or that have changed since.

        Raises:
            FileExistsError: If a file must not be replaced.
            OSError: If a file cannot be written.
            ValueError: If the observations are not of the kind `groundings` or contain quantities, or `max_vars` is
                less than 1.
        """
        if max_vars is not None and as_integer("max_vars", max_vars) < 1:
            raise ValueError(f"`max_vars`: expected at least 1, not {max_vars}")
        if not self.atoms:
            raise ValueError('Popper needs atoms: make the demonstrations with `observation="groundings"`')
        if self.quantities:
            raise ValueError(f"Popper's files have truth values only, but the observations have `{self.quantities[0]}`")
        path = Path(checked_path("folder", folder))
        examples = list(self.examples(distinct=distinct))
        facts = [line for step, (seen, _) in enumerate(examples) for line in self._facts(step, seen, negated)]
        arities = {name: len(entities) for name, entities in self.atoms}
        names = popper_names(arities).items()
        predicates = {"sees": 2} | {name: arity for name, (is_not, _, arity) in names if negated or not is_not}
        # Without this declaration, Prolog raises an error for a query of a predicate without facts.
        facts += [f":- dynamic {name}/{arity}." for name, arity in predicates.items()]
        written = []
        for number, action in enumerate(ACTIONS):
            if action not in self.asked:
                continue
            head = _snake(action)
            signs = ("pos" if done == number else "neg" for _, done in examples)
            bias = [f"head_pred({head},1).", *(f"body_pred({name},{arity})." for name, arity in predicates.items())]
            bias += [f"max_vars({max_vars})."] * (max_vars is not None)
            files = {
                "bk.pl": facts,
                "exs.pl": [f"{sign}({head}(s{step}_e0))." for step, sign in enumerate(signs)],
                "bias.pl": bias,
            }
            written.append(_write_folder(path / head, files, overwrite))
        return written

    def examples(self, *, distinct: bool = False) -> Iterator[tuple[NDArray[np.float32], int]]:
        """Yield the observation and the action of every step, or, with `distinct`, each different pair once."""
        seen = set()
        for trajectory in self:
            for observation, action in zip(trajectory.observations[:-1], trajectory.actions, strict=True):
                key = (observation.tobytes(), int(action))
                if distinct and key in seen:
                    continue
                seen.add(key)
                yield observation, int(action)

    def _facts(self, step: int, observation: NDArray[np.float32], negated: bool) -> Iterator[str]:
        """Yield the true and, if `negated`, the false atoms over the ego and every entity with a true atom."""
        true = observation[: len(self.atoms)] > 0.5
        present = {0}.union(*(entities for (_, entities), holds in zip(self.atoms, true, strict=True) if holds))
        yield from (f"sees(s{step}_e0,s{step}_e{entity})." for entity in sorted(present))
        for (name, entities), holds in zip(self.atoms, true, strict=True):
            if present.issuperset(entities) and (holds or negated):
                arguments = ",".join(f"s{step}_e{entity}" for entity in entities)
                yield f"{'' if holds else 'not_'}{_snake(name)}({arguments})."

    def to_parquet(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write a Parquet table with one row per step, atomically. Needs the extra `offline`.

        The columns are `episode` (int32), `step` (int32), `observation` (fixed-size list of float32), `action` (int8),
        `reward` (float64), `terminated` (bool), `truncated` (bool), and the numeric keys of `info`. The schema metadata
        has `mode`, `split`, `episodes_hash`, `actions` and `atoms`, which is empty for observations of the kind
        `state`.

        Raises:
            FileExistsError: If this function did not write the file, or it has changed since, without `overwrite`.
            OSError: If the file cannot be written.
        """
        with extra("offline"):
            import pyarrow
            import pyarrow.parquet

        lengths = [len(trajectory) for trajectory in self]
        observations = np.concatenate([t.observations[:-1].reshape(len(t), -1) for t in self])
        columns: dict[str, Any] = {
            "episode": np.repeat(np.array([t.episode for t in self], np.int32), lengths),
            "step": np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
            "observation": pyarrow.FixedSizeListArray.from_arrays(
                pyarrow.array(observations.reshape(-1)), observations.shape[1]
            ),
            "action": np.concatenate([t.actions for t in self]).astype(np.int8),
            "reward": np.concatenate([t.rewards for t in self]),
            "terminated": np.concatenate([t.terminations for t in self]),
            "truncated": np.concatenate([t.truncations for t in self]),
        }
        columns |= {name: np.concatenate([t.infos[name][:-1] for t in self]) for name in self[0].infos}
        metadata = {
            "mode": self.mode,
            "split": self.split,
            "episodes_hash": self.episodes_hash,
            "actions": ",".join(ACTIONS),
            "atoms": ";".join(f"{name}({','.join(map(str, entities))})" for name, entities in self.atoms),
        }
        table = pyarrow.table(columns).replace_schema_metadata(metadata)
        with reserved(path, by="to_parquet", overwrite=overwrite) as output:
            pyarrow.parquet.write_table(table, output.temporary)
            output.finish()


def popper_names(arities: Mapping[str, int]) -> dict[str, tuple[bool, str, int]]:
    """Return the predicates of Popper's files: whether it is the negation of a predicate, that predicate, its arity."""
    signs = ((False, ""), (True, "not_"))
    return {
        f"{sign}{_snake(name)}": (negated, name, arity) for name, arity in arities.items() for negated, sign in signs
    }


def _snake(name: str) -> str:
    """Convert a name to snake case: `IsAtInter` to `is_at_inter`."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def _write_folder(folder: Path, files: Mapping[str, Sequence[str]], overwrite: bool) -> Path:
    """Write files to a folder. If one of them cannot be written, none changes."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        outputs = [stack.enter_context(reserved(folder / name, by="to_popper", overwrite=overwrite)) for name in files]
        for output, lines in zip(outputs, files.values(), strict=True):
            Path(output.temporary).write_text(
                "".join(f"{line}\n" for line in sorted(lines)), encoding="utf-8", newline="\n"
            )
        for output in outputs:
            output.finish()
    return folder


def demonstrations(
    mode: str | os.PathLike[str],
    n: int | None = None,
    split: str = "train",
    *,
    observation: ArrayKind = "groundings",
    **options: Any,
) -> Demonstrations:
    """Run the oracle on the first n recorded episodes of a split.

    Args:
        mode: As for `Benchmark`.
        n: The number of episodes, by default all. The modes have 40 episodes for `"val"`, and 100 for each other split.
        split: `"train"`, `"val"` or `"test"`.
        observation: `"groundings"` or `"state"`, as in `gymnasium.make`. `logicity.envs.views.Views` maps `groundings`
            to the other kinds.
        options: Other options of `gymnasium.make`, such as `overrides` and `predicates`.

    Raises:
        InputError, OSError: As for `Benchmark`, or if the episodes do not fit the agents.
        ValueError: As for `Benchmark`, or if `n` exceeds the number of recorded episodes.
    """
    name = checked_mode(mode)
    if observation in get_args(ViewKind):
        raise ValueError(
            f"demonstrations have observations of the kind `groundings` or `state`, not `{observation}`: use "
            "`groundings`, and map them with `logicity.envs.views.Views`"
        )
    checked_kind(observation)
    task = load_task(mode, options.get("rules"), options.get("overrides"))
    if _logicity.layout(task)["egos"] is not None:
        # Here the oracle drives only the first car.
        overrides = dict(options.get("overrides") or {})
        options["overrides"] = {**overrides, "task": {**(overrides.get("task") or {}), "egos": None}}
        task = load_task(mode, options.get("rules"), options["overrides"])
    count = task.recorded(split)
    wanted = count if n is None else as_integer("n", n)
    if not 1 <= wanted <= count:
        raise ValueError(f"expected 1 to {count} demonstrations, the number recorded for {name}, {split}, not {wanted}")
    with extra("gym"):
        import gymnasium

    if name not in ENVIRONMENTS:
        # The spec must not depend on the working directory.
        options["config"] = str(Path(name).resolve()) if Path(name).exists() else name
    made = ENVIRONMENTS.get(name, "logicity/SPF-Expert-v0")
    env: gymnasium.Env[Any, Any] = gymnasium.make(made, split=split, observation=observation, **options)
    # With a limit in the spec, `gymnasium.make` would add a `TimeLimit`, which may be less than that of an episode.
    spec = copy(env.spec)
    assert spec is not None
    spec.max_episode_steps = None
    with closing(env), episodes_that_fit():
        trajectories = tuple(_run_oracle(env, episode) for episode in range(wanted))
    description = _logicity.describe(task)
    atoms = tuple(atoms_of(description)) if observation == "groundings" else ()
    asked = {constraint["action"] for constraint in description["constraints"]}
    named = tuple(action for action in ACTIONS if action in asked)
    quantities = tuple(column["predicate"] for column in description["columns"] if "quantity" in column and atoms)
    hashed = description["splits"][split]["hash"]
    return Demonstrations(name, split, hashed, atoms, quantities, named, spec, trajectories)


def _run_oracle(env: gymnasium.Env[Any, Any], episode: int) -> Trajectory:
    observation, info = env.reset(options={"episode": episode})
    observations, infos = [observation], [info]
    outcomes: list[list[Any]] = []
    while not (outcomes and (outcomes[-1][1] or outcomes[-1][2])):
        observation, *outcome, info = env.step(int(info["oracle_action"]))
        observations.append(observation)
        infos.append(info)
        outcomes.append(outcome)
    rewards, terminations, truncations = zip(*outcomes, strict=True)
    keys = ("oracle_action", "progress", "success", "steps")
    return Trajectory(
        episode=episode,
        seed=int(infos[0]["seed"]) % 2**64,
        observations=np.stack(observations),
        actions=np.array([info["oracle_action"] for info in infos[:-1]], np.int64),
        rewards=np.array(rewards, np.float64),
        terminations=np.array(terminations, np.bool_),
        truncations=np.array(truncations, np.bool_),
        infos={name: np.array([info[name] for info in infos]) for name in keys},
    )
