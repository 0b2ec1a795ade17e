"""Rules learned from demonstrations and questions. Needs the extra `gym` for `demonstrations`.

`induce` finds clauses that explain the action of every demonstrated step, and can ask an oracle about scenes that no
demonstration shows. The result is a rule file, a policy, and a report about what demonstrations and answers show and
leave open.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import zip_longest
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, SupportsIndex, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _logicity
from .city import ACTIONS
from .describe import Atom, atoms_of
from .errors import checked_integer, checked_path, missing_extra
from .evaluation import load_task
from .files import check_readable, replacing
from .modes import ENVIRONMENTS, checked_mode
from .offline import Demonstrations
from .rules import Program
from .terminal import first_line
from .types import SymbolicScene

if TYPE_CHECKING:
    import gymnasium
    from minari import MinariDataset

__all__ = ["Episode", "InducedClause", "InducedRules", "induce"]

#: The most bytes of the values of a Minari dataset. `induce` copies its observations into one array.
BYTES_MAX = 2 << 30


@runtime_checkable
class Episode(Protocol):
    """A demonstrated episode of T steps: a `Trajectory`, or an episode of a Minari dataset.

    Attributes:
        observations: Numbers of shape (T, width) or (T + 1, width): the observations of the kind `groundings` before
            each step, and possibly one more after the last step.
        actions: Integers of shape (T,): 0 Slow, 1 Normal, 2 Fast, 3 Stop.
    """

    @property
    def observations(self) -> Any:
        """Return the observations."""
        ...

    @property
    def actions(self) -> Any:
        """Return the actions."""
        ...


@dataclass(frozen=True)
class InducedClause:
    """A learned clause.

    Attributes:
        action: The action.
        body: The literals of the body, without those that give precedence to other actions.
        examples: The number of steps with this action in which the body holds.
        alone: The number of these steps in which no other clause of the action holds.
        undecided: Literals that also hold in all steps that this clause alone explains. With such a literal, the clause
            fits as well. Literals that follow from the clause or from another one of them by the constraints of the
            rules are left out.
        alternatives: Pairs of a literal of the body and another literal that fits as well in its place.
        notes: Sentences about what the demonstrations leave open, as the comments of the rule file have them.
    """

    action: str
    body: tuple[str, ...]
    examples: int
    alone: int
    undecided: tuple[str, ...]
    alternatives: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Format the clause without the literals that give precedence to other actions."""
        return f"{self.action}(X) :- {', '.join(self.body)}."


class InducedRules:
    """Learned rules. Calling them with a batch of observations returns actions, so they are a policy.

    Attributes:
        text: The rules as the text of a rule file, with comments about their support.
        clauses: The clauses, by action in the order of precedence.
        report: All figures, as `logicity induce --report` writes them.
    """

    def __init__(self, rules: _logicity.LearnedRules) -> None:
        """Store the rules."""
        self._rules = rules
        self.text = rules.text
        self.report: Mapping[str, Any] = rules.report()
        self.clauses = tuple(
            InducedClause(
                clause["action"],
                tuple(clause["body"]),
                clause["examples"],
                clause["alone"],
                tuple(clause["undecided"]),
                tuple((own, other) for own, other in clause["alternatives"]),
                tuple(clause["notes"]),
            )
            for clause in self.report["clauses"]
        )

    def __reduce__(self) -> tuple[type[InducedRules], tuple[_logicity.LearnedRules]]:
        """Pickle the rules without learning again."""
        return type(self), (self._rules,)

    def __repr__(self) -> str:
        """Show the numbers of clauses and examples."""
        clauses, examples = len(self.clauses), self.report["examples"]
        return (
            f"<InducedRules: {clauses} clause{'' if clauses == 1 else 's'} from {examples} "
            f"example{'' if examples == 1 else 's'}>"
        )

    def __call__(self, observations: ArrayLike) -> NDArray[np.int64]:
        """Return the actions that the rules choose.

        An entity without facts counts as absent.

        Args:
            observations: Numbers of shape (N, width), of the kind `groundings`.

        Returns:
            int64 (N,): 0 Slow, 1 Normal, 2 Fast, 3 Stop.

        Raises:
            ValueError: If the shape is wrong.
        """
        array = np.ascontiguousarray(observations, np.float32)
        if array.ndim != 2:
            raise ValueError(
                f"expected a batch of observations (N, width), not an array of shape {array.shape}: pass "
                "`batched=True` to `evaluate`"
            )
        return self._rules.decide(array)

    def policy(self) -> InducedRules:
        """Return the rules as a policy for `evaluate(..., batched=True)`."""
        return self

    def program(self) -> Program:
        """Return the rules as a program of the engine."""
        return Program(self.text, "learned.dl")

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the rule file, atomically.

        Args:
            path: The file to write.
            overwrite: Whether to replace a file that this function did not write, or that has changed since.

        Raises:
            FileExistsError: If the file must not be replaced.
            OSError: If the file cannot be written.
        """
        with (
            replacing(path, by="induce", overwrite=overwrite) as temporary,
            open(temporary, "w", encoding="utf-8") as file,
        ):
            file.write(self.text)


@dataclass(frozen=True)
class _Steps:
    """An episode that was read from a file."""

    observations: NDArray[Any]
    actions: NDArray[Any]


@dataclass
class _Source:
    """Where episodes come from.

    Attributes:
        episodes: The episodes.
        title: Words that follow "from 3 episodes" in the rule file.
        mode: The mode or the path of the configuration file, if known.
        options: The options `rules` and `overrides` of the environment, if known.
        lines: Further sentences about the source.
        atoms: The atom of each number of an observation, if known.
    """

    episodes: Iterable[Episode]
    title: str = ""
    mode: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    lines: Sequence[str] = ()
    atoms: Sequence[str] = ()


def induce(
    demonstrations: Demonstrations | MinariDataset | str | os.PathLike[str] | Iterable[Episode] = (),
    mode: str | os.PathLike[str] | None = None,
    *,
    order: Sequence[str] = ("Stop", "Slow", "Fast"),
    variables: SupportsIndex = 3,
    effort: SupportsIndex = 20_000,
    noise: float | Literal["auto"] | None = None,
    seed: SupportsIndex = 0,
    threads: SupportsIndex = 0,
    rules: str | os.PathLike[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    ask: Callable[[SymbolicScene], str] | str | os.PathLike[str] | None = None,
    questions: SupportsIndex | None = None,
    agreements: SupportsIndex | None = None,
    sweep: tuple[SupportsIndex, SupportsIndex] | None = None,
    log: str | os.PathLike[str] | None = None,
) -> InducedRules:
    """Learn rules from demonstrations, from questions to an oracle, or from both.

    The learner sees the observations and the actions, but no clause of the rules. The same arguments and the same
    answers give the same rules on any number of threads.

    Args:
        demonstrations: `Demonstrations`; a Minari dataset, its name, or its folder; a Parquet table of
            `Demonstrations.to_parquet`; or other objects with `observations` of the kind `groundings` and `actions`,
            such as a slice of `Demonstrations`.
        mode: One of `logicity.ENVIRONMENTS` or the path of a configuration file, which names the predicates
            and the default action. The default is that of the demonstrations, if they name one.
        order: The actions in the order in which the learned rules try them. The default action of the configuration
            comes last.
        variables: The largest number of variables of a clause, from 2 on.
        effort: The largest number of steps of the search for one clause. Without effect on examples with wrong actions.
        noise: The share of examples that may have a wrong action, from 0 to 0.4, or "auto" to estimate it by
            cross-validation. None means that all are right: then two examples with the same facts and different actions
            are an error.
        seed: The seed of the order in which the learner tries examples.
        threads: The number of threads, 0 for one per core.
        rules: A rule file to use instead of the configuration's, for its declarations. The default is that of the
            demonstrations, if they name one.
        overrides: Changes of the configuration, as in `gymnasium.make`. The default is that of the demonstrations.
        ask: The oracle: a function that takes a scene, as `infer` does, and returns the name of the ego's action, or
            the path of a rule file whose clauses the learner does not see. `noise` must be None.
        questions: The largest number of questions, those of an earlier run in the log included. None is 10 million.
        agreements: The questions end when the rules agree with the oracle on this many random scenes in a row. None is
            400.
        sweep: Then all scenes of at most this many facts and entities are asked, for example `(3, 2)`: a certificate.
            Facts that follow from others and facts of `.covering` predicates do not count.
        log: A file to which each question is added at once with its answer. The same call with an existing log
            continues where it stopped. A log of other questions is an error. A function is known by its name, as is
            the class of an object, so another function of the same name needs another log.

    Returns:
        The rules. `report["questions"]` describes the questions and the certificate.

    Raises:
        BaseException: Any exception of `ask`. Its attribute `rules` has the rules learned so far, as have
            `KeyboardInterrupt` and the exceptions for a faulty oracle.
        ImportError: If Minari is not installed. The extra `offline` installs it: `pip install './python[offline]'`.
        InputError: If the configuration or an option is invalid, two examples have the same facts and different
            actions, the oracle contradicts itself or an example, or no rules agree with all its answers.
        OSError: If a file cannot be read or written.
        TypeError: If an argument or an answer has a wrong type.
        ValueError: If an argument is out of range, an answer is not an action, the shapes of demonstrations do not fit,
            there are neither demonstrations nor an oracle, `demonstrations` is the name of a mode, a Minari dataset is
            damaged or too large, or the log has other questions.
    """
    limits = {
        "variables": (2, _logicity.VARIABLES_MAX),
        "effort": (1, 2**32 - 1),
        "threads": (0, _logicity.THREADS_MAX),
    }
    given = {"variables": variables, "effort": effort, "threads": threads}
    checked = {name: checked_integer(name, value, *limits[name]) for name, value in given.items()}
    checked_seed = checked_integer("seed", seed)
    if ask is None and (questions, agreements, sweep, log) != (None, None, None, None):
        raise ValueError("questions, agreements, sweep and log need an oracle: `ask`")
    bound = _checked_sweep(sweep)
    checked_order = _checked_order(order)
    if ask is not None and noise is not None:
        raise ValueError("noise: expected None, because the answers of an oracle are exact")
    if noise is not None and noise != "auto":
        message = f"noise: expected a number from 0 to {_logicity.NOISE_MAX}, auto or None, not {noise!r}"
        if not isinstance(noise, (Real, str)) or isinstance(noise, bool):
            raise TypeError(message)
        if isinstance(noise, str) or not 0 <= noise <= _logicity.NOISE_MAX:
            raise ValueError(message)
    rate = float("nan") if noise == "auto" else None if noise is None else float(noise)
    if isinstance(demonstrations, str) and demonstrations in ENVIRONMENTS and not os.path.exists(demonstrations):
        raise ValueError(
            f"demonstrations: `{demonstrations}` is a mode, not a dataset: pass "
            f'`logicity.demonstrations("{demonstrations}")`, or `mode="{demonstrations}"` with an oracle `ask`'
        )
    source = _source(demonstrations)
    mode = source.mode if mode is None else mode
    if mode is None:
        raise TypeError("mode: expected the mode or the configuration file of the demonstrations")
    name = checked_mode(mode)
    if source.mode == name:
        rules = source.options.get("rules") if rules is None else rules
        overrides = source.options.get("overrides") if overrides is None else overrides
    task = load_task(mode, rules, overrides)
    _check_atoms(source, task, name)
    width = None if ask is None else task.shape("groundings")[0]
    observations, actions, parts = _stacked(source.episodes, width)
    origin = f"{len(parts)} episodes {source.title or f'for {name}'}" if parts else f"questions about scenes of {name}"
    lines = [f"Rules learned by logicity {_logicity.__version__} from {origin}.", *source.lines]
    if rules is not None:
        lines.append(f"The configuration has the rules in {os.path.basename(checked_path('rules', rules))}.")
    asking = None
    if ask is not None:
        asking = (
            *_oracle(ask, mode, overrides),
            checked_integer("questions", 10_000_000 if questions is None else questions),
            checked_integer("agreements", 400 if agreements is None else agreements),
            bound,
            None if log is None else checked_path("log", log),
        )
    learned, fault = _logicity.induce(
        task,
        observations,
        actions,
        parts,
        lines,
        checked_order,
        checked["variables"],
        checked["effort"],
        checked_seed,
        checked["threads"],
        rate,
        asking,
    )
    induced = InducedRules(learned)
    if fault is not None:
        # Typed as `Any`: exceptions take further attributes.
        annotated: Any = fault
        annotated.rules = induced
        if hasattr(fault, "add_note"):
            fault.add_note("The rules learned before are in the attribute `rules` of this exception.")
        raise fault
    return induced


def _checked_sweep(sweep: object) -> tuple[int, int] | None:
    """Return the numbers of facts and entities of a sweep."""
    if sweep is None:
        return None
    if not isinstance(sweep, Sequence) or len(sweep) != 2:
        raise TypeError(f"sweep: expected the numbers of facts and entities, such as `(3, 2)`, not {sweep!r}")
    return checked_integer("sweep", sweep[0], 0, 1000), checked_integer("sweep", sweep[1], 1, 5)


def _checked_order(order: object) -> list[str]:
    """Return the actions of an order of precedence."""
    if isinstance(order, str) or not isinstance(order, Iterable):
        raise TypeError(f"order: expected names of actions, not {type(order).__name__}")
    names = list(order)
    for at, name in enumerate(names):
        if not isinstance(name, str):
            raise TypeError(f"order: expected names of actions, not {type(name).__name__}")
        if name in names[:at]:
            raise ValueError(f"order: `{name}` occurs twice")
    return names


def _source(demonstrations: Any) -> _Source:
    """Return the episodes of demonstrations, and what is known about them."""
    if isinstance(demonstrations, Demonstrations):
        _check_observation("groundings" if demonstrations.atoms else "state")
        return _Source(
            demonstrations,
            f"of {demonstrations.mode} ({demonstrations.split})",
            demonstrations.mode,
            demonstrations.env.kwargs,
            [f"Episodes {demonstrations.episodes_hash}."],
            _atom_texts(demonstrations.atoms),
        )
    if isinstance(demonstrations, (str, os.PathLike)):
        path = Path(demonstrations)
        if path.suffix == ".parquet" or path.is_file():
            return _parquet(path)
        return _minari(_load_minari(demonstrations))
    if hasattr(demonstrations, "iterate_episodes") and hasattr(demonstrations, "env_spec"):
        return _minari(demonstrations)
    if not isinstance(demonstrations, Iterable):
        raise TypeError(f"demonstrations: expected episodes, not {type(demonstrations).__name__}")
    return _Source(demonstrations)


def _check_observation(kind: str) -> None:
    if kind != "groundings":
        raise ValueError(f"expected observations of the kind `groundings`, not `{kind}`")


def _load_minari(name: str | os.PathLike[str]) -> MinariDataset:
    """Load a Minari dataset, given its name or its folder."""
    path = Path(name)
    folder = next((folder for folder in (path / "data", path) if (folder / "metadata.json").is_file()), None)
    if folder is None and (path.exists() or not isinstance(name, str)):
        raise FileNotFoundError(f"neither a Parquet table nor a Minari dataset: `{name}`")
    try:
        from minari import MinariDataset
        from minari.dataset.minari_storage import MinariStorage
        from minari.storage import get_dataset_path
    except ImportError as error:
        raise missing_extra("offline", error) from error

    if folder is None:
        folder = Path(get_dataset_path(os.fspath(name))) / "data"
        if not folder.exists():
            message = f"neither a file nor a dataset of Minari on this machine: `{name}`"
            raise FileNotFoundError(f"{message}; `minari download {name}` downloads a published one")
    with _reading(name):
        check_readable(folder / "metadata.json")
        described = MinariStorage.read_raw_metadata(folder)
        if not {"observation_space", "action_space"} <= described.keys():
            # Minari would make the environment to see its spaces, which calls any function that the file names.
            raise ValueError("its `metadata.json` lacks `observation_space` or `action_space`")
        storage = MinariStorage.read(folder)
        # Minari numbers the claimed episodes at once.
        if not 0 <= storage.total_episodes <= (count := _count(storage)):
            raise ValueError(f"it claims {storage.total_episodes} episodes, and has {count}")
        return MinariDataset(storage)


def _count(storage: Any) -> int:
    """Return the number of episodes that a Minari dataset stores."""
    if storage.FORMAT != "hdf5":
        return sum(folder.name.isdecimal() for folder in Path(storage.data_path).iterdir())
    import h5py

    with h5py.File(_hdf5_file(storage)) as content:
        return len(content)


def _hdf5_file(storage: Any) -> Path:
    file = Path(storage.data_path) / "main_data.hdf5"
    check_readable(file, whole=False)
    return file


def _stored_in_hdf5(storage: Any, indices: Sequence[int]) -> Iterator[_Steps]:
    """Yield episodes of a Minari dataset in an HDF5 file.

    Raises:
        OSError: If the file is damaged.
        ValueError: If its values are not numbers, lie outside of the file, or take too much memory.
    """
    import h5py

    read = 0
    with h5py.File(_hdf5_file(storage)) as content:
        for index in indices:
            arrays = []
            for name in ("observations", "actions"):
                place = f"episode_{index}/{name}"
                for part in (f"episode_{index}", place):
                    if not isinstance(content.get(part, getlink=True), h5py.HardLink):
                        raise ValueError(f"`{part}` is a link")
                values = content[place]
                if not isinstance(values, h5py.Dataset) or values.dtype.kind not in "biuf":
                    raise ValueError(f"`{place}` has no numbers")
                if values.external or values.is_virtual:
                    raise ValueError(f"`{place}` has its values in another file")
                # A dataset without stored values takes no bytes of the file, and several may be the same.
                read += values.nbytes
                _check_bytes(read)
                arrays.append(values[()])
            yield _Steps(*arrays)


def _stored_in_tables(storage: Any, indices: Sequence[int]) -> Iterator[_Steps]:
    """Yield episodes of a Minari dataset in Arrow or Parquet files.

    Raises:
        OSError: If a file is damaged.
        ValueError: If its values are not numbers, or take too much memory.
    """
    import pyarrow
    import pyarrow.parquet

    read = 0
    for index in indices:
        files = sorted((Path(storage.data_path) / str(index)).glob(f"*.{storage.FORMAT}"))
        if len(files) != 1:
            raise ValueError(f"episode {index} has {len(files)} files, not one")
        (file,) = files
        check_readable(file, whole=False)
        if storage.FORMAT == "parquet":
            parquet = pyarrow.parquet.ParquetFile(file)
            schema, rows, read_columns = parquet.schema_arrow, parquet.metadata.num_rows, parquet.read
        else:
            arrow = _uncompressed(file)
            schema, rows, read_columns = arrow.schema, arrow.num_rows, arrow.select
        observation, action = (schema.field(name).type for name in ("observations", "actions"))
        is_list = pyarrow.types.is_fixed_size_list(observation)
        number = observation.value_type if is_list else observation
        if not (pyarrow.types.is_integer(number) or pyarrow.types.is_floating(number)):
            raise ValueError(f"the observations of episode {index} have the type {observation}, not numbers")
        if not pyarrow.types.is_integer(action):
            raise ValueError(f"the actions of episode {index} have the type {action}, not integers")
        width = observation.list_size if is_list else 1
        read += rows * (width * number.bit_width + action.bit_width) // 8
        _check_bytes(read)
        columns = ["observations", "actions"]
        table = read_columns(columns)
        table.validate()
        observations, actions = (table[name].combine_chunks() for name in columns)
        values = observations.flatten() if is_list else observations
        if observations.null_count + values.null_count + actions[:-1].null_count > 0:
            raise ValueError(f"episode {index} lacks values")
        # The last observation has no action; Minari writes 0 there.
        yield _Steps(values.to_numpy(zero_copy_only=False).reshape(-1, width), actions[:-1].to_numpy())


def _check_bytes(read: int) -> None:
    if read > BYTES_MAX:
        raise ValueError(f"its values take more than {BYTES_MAX >> 20} MiB")


def _uncompressed(file: Path) -> Any:
    """Return the table in an Arrow file without compressed values and dictionaries. It takes no memory but the file's.

    Raises:
        ValueError: If the file has such values, or is damaged.
    """
    import pyarrow

    def place(metadata: bytes, table: int, number: int) -> int | None:
        """Return the place of a field in a table of FlatBuffers; `None` if the table lacks the field."""
        vtable = table - struct.unpack_from("<i", metadata, table)[0]
        position = 4 + 2 * number
        within = position < struct.unpack_from("<H", metadata, vtable)[0]
        offset = struct.unpack_from("<H", metadata, vtable + position)[0] if within else 0
        return table + offset if offset else None

    # After eight bytes, the file format is the stream format. The footer may name other places, and is not read.
    begin = 8
    with pyarrow.memory_map(str(file)) as content:
        content.seek(begin)
        for message in pyarrow.ipc.MessageReader.open_stream(content):
            if message.type == "dictionary":
                raise ValueError(f"`{file.name}` has a dictionary")
            metadata = message.metadata.to_pybytes()
            try:
                # The header is field 2 of a message, and the compression field 3 of the header of a record batch.
                header = place(metadata, struct.unpack_from("<I", metadata)[0], 2)
                if message.type == "record batch" and header is not None:
                    batch = header + struct.unpack_from("<I", metadata, header)[0]
                    if place(metadata, batch, 3) is not None:
                        raise ValueError(f"`{file.name}` is compressed")
            except struct.error:
                raise ValueError(f"`{file.name}` is damaged") from None
        content.seek(begin)
        return pyarrow.ipc.open_stream(content).read_all()


def _minari(dataset: MinariDataset) -> _Source:
    """Return the episodes of a Minari dataset. Its environment is known if Minari recorded one of this package."""
    episodes, title = _episodes(dataset), f"of {dataset.id}"
    spec: gymnasium.envs.registration.EnvSpec | None = dataset.env_spec
    if spec is None or spec.namespace != "logicity":
        return _Source(episodes, title)
    if not isinstance(spec.kwargs, Mapping):
        raise ValueError(f"cannot read the Minari dataset `{dataset.id}`: its environment has no mapping of arguments")
    _check_observation(spec.kwargs.get("observation", "groundings"))
    return _Source(episodes, title, spec.kwargs.get("config"), spec.kwargs)


def _episodes(dataset: MinariDataset) -> Iterator[_Steps]:
    """Yield the episodes of a Minari dataset.

    Reads only observations and actions: what the file says about other values may take any memory.

    Raises:
        ValueError: If its files are damaged, have values that are not numbers, or take too much memory.
    """
    with _reading(dataset.id):
        read = _stored_in_hdf5 if dataset.storage.FORMAT == "hdf5" else _stored_in_tables
        yield from read(dataset.storage, [int(index) for index in dataset.episode_indices])


@contextmanager
def _reading(name: object) -> Iterator[None]:
    """Name the Minari dataset in the exceptions of its reader.

    Raises:
        ValueError: If the files of the dataset are damaged.
    """
    try:
        yield
    except (FileNotFoundError, MemoryError):
        raise
    except Exception as error:
        reason = first_line(str(error), type(error).__name__)
        raise ValueError(f"cannot read the Minari dataset `{name}`: {reason}") from error


def _parquet(path: Path) -> _Source:
    """Read a table that `Demonstrations.to_parquet` wrote."""
    mode, split, episodes_hash, atoms, (observations, actions, episodes, _) = _logicity.read_steps(path)
    cuts = np.flatnonzero(np.diff(episodes)) + 1
    parts = zip(np.split(observations, cuts), np.split(actions, cuts), strict=True)
    return _Source(
        [_Steps(*part) for part in parts],
        f"of {mode} ({split}) in {path.name}",
        mode,
        lines=[f"Episodes {episodes_hash}."],
        atoms=atoms,
    )


def _atom_texts(atoms: Iterable[Atom]) -> list[str]:
    """Return atoms as a Parquet table names them, such as `IsCar(0)`."""
    return [f"{name}({','.join(map(str, entities))})" for name, entities in atoms]


def _check_atoms(source: _Source, task: _logicity.Task, name: str) -> None:
    """Check that the atoms of observations are those of a task."""
    if not source.atoms:
        return
    expected = _atom_texts(atoms_of(_logicity.describe(task)))
    for one, other in zip_longest(source.atoms, expected):
        if one != other:
            raise ValueError(
                f"the demonstrations of {source.mode} do not fit {name}: they have the atom {one} instead of {other}"
            )


def _oracle(
    ask: Callable[[SymbolicScene], str] | str | os.PathLike[str],
    mode: str | os.PathLike[str],
    overrides: Mapping[str, Any] | None,
) -> tuple[Any, str, str]:
    """Return the oracle, what identifies it in a log, and its name in reports."""
    if callable(ask):
        kind = ask if hasattr(ask, "__qualname__") else type(ask)
        return ask, f"function {kind.__module__}.{kind.__qualname__}", "a function"
    path = checked_path("ask", ask)
    return load_task(mode, path, overrides), "", f"the rules in {os.path.basename(path)}"


def _stacked(
    episodes: Iterable[Episode], width: int | None
) -> tuple[NDArray[np.float32], NDArray[np.int64], list[tuple[int, str]]]:
    """Return the steps of all episodes in one array, and the first step of each.

    There may be no steps if the width of observations is known.
    """
    observations: list[NDArray[np.float32]] = []
    actions: list[NDArray[np.int64]] = []
    parts: list[tuple[int, str]] = []
    count = 0
    for number, episode in enumerate(episodes):
        if not isinstance(episode, Episode):
            raise TypeError(f"expected episodes with `observations` and `actions`, not {type(episode).__name__}")
        taken = np.asarray(episode.actions)
        seen = np.asarray(episode.observations, np.float32)
        if taken.ndim != 1 or seen.ndim != 2 or len(seen) not in (len(taken), len(taken) + 1):
            raise ValueError(
                f"episode {number}: observations of shape {seen.shape} do not fit actions of shape {taken.shape}"
            )
        if not np.isfinite(seen).all():
            raise ValueError(f"episode {number}: observations that are not finite")
        if not np.issubdtype(taken.dtype, np.integer):
            raise TypeError(f"episode {number}: expected integer actions, not {taken.dtype}")
        if len(taken) and not 0 <= taken.min() <= taken.max() < len(ACTIONS):
            raise ValueError(f"episode {number}: expected actions from 0 to {len(ACTIONS) - 1}")
        parts.append((count, f"episode {number}"))
        observations.append(seen[: len(taken)])
        actions.append(taken.astype(np.int64))
        count += len(taken)
    if count == 0 and width is None:
        raise ValueError("no demonstrations: expected at least one step")
    if count == 0:
        return np.zeros((0, width or 0), np.float32), np.zeros(0, np.int64), []
    if len({array.shape[1] for array in observations}) > 1:
        raise ValueError("the observations of the episodes have different lengths")
    return np.concatenate(observations), np.concatenate(actions), parts
