"""Episodes of the published program, read from its pickles without running them.

The program stores a dictionary of episodes by number. An episode has the start, goal, concepts and priority of every
agent, the number of the oracle's steps, and the grid of the city. `import_episodes` writes them as a file of episodes.
"""

from __future__ import annotations

import json
import os
import pickletools
import random
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from .errors import checked_path
from .evaluation import Benchmark, EpisodeRecord
from .files import check_readable, check_writable, write_text
from .modes import checked_mode
from .shards import run_command
from .terminal import neutral
from .types import Split

__all__ = ["Imported", "PublishedAgent", "PublishedEpisode", "import_episodes", "read_published"]

#: Longer bytes are skipped. Positions take 16; grids of cities take megabytes, which only they need.
_BYTES_MAX = 4096

#: The largest number of steps of the oracle.
_STEPS_MAX = 1000


@dataclass(frozen=True)
class PublishedAgent:
    """An agent at the start of an episode."""

    name: str
    concepts: tuple[str, ...]
    priority: int
    start: tuple[int, int]
    goal: tuple[int, int]


@dataclass(frozen=True)
class PublishedEpisode:
    """An episode of the published program.

    Attributes:
        number: The key of the episode.
        agents: The agents, in the order of the file.
        oracle_steps: The number of steps of the oracle, if the file has it.
    """

    number: int
    agents: tuple[PublishedAgent, ...]
    oracle_steps: int | None


@dataclass(frozen=True)
class Imported:
    """What `import_episodes` wrote.

    Attributes:
        episodes: The number of episodes.
        solved: The number of those that the oracle of this program solves.
        recorded: The number of those that also have the number of steps of the published oracle.
        equal: The number of those for which both oracles take the same number of steps.
    """

    episodes: int
    solved: int
    recorded: int
    equal: int

    def __str__(self) -> str:
        """Describe the numbers in a line."""
        compared = f"; as many steps as recorded in {self.equal} of {self.recorded}" if self.recorded else ""
        return f"{self.episodes} episodes, {self.solved} solved by the oracle{compared}"


def import_episodes(
    file: str | os.PathLike[str],
    mode: str | os.PathLike[str],
    split: Split,
    output: str | os.PathLike[str],
    *,
    seed: int = 0,
    overwrite: bool = False,
) -> Imported:
    """Read the episodes of the published program, and write them to a file of episodes.

    The pickle is data: nothing in it runs. The file has the run of this program's oracle on each episode that it
    solves within 1000 steps; other episodes have none, and the horizon of the configuration. Published episodes have no
    seeds, so `seed` determines the random events.

    Args:
        file: The pickle.
        mode: The mode whose agents and rules the episodes have, or a configuration file.
        split: The split of the agents.
        output: The file to write. A configuration names it under `task.episodes`.
        seed: The seed of the random events.
        overwrite: Whether to replace a file that this function did not write, or that has changed since.

    Raises:
        FileExistsError: If the file must not be replaced.
        InputError: If the episodes do not fit the mode.
        OSError: If a file cannot be read or written.
        ValueError: If the pickle is damaged, has other content, or would run code; or the mode is unknown.
    """
    name = checked_mode(mode)
    check_writable(output, by="import-episodes", overwrite=overwrite)
    episodes = read_published(file)
    # The header has the map and the agents in the order of the split.
    drawn = run_command(["episodes", "make", name, "--split", split, "--count", "1", "--output", "-"])
    header = {**json.loads(drawn.partition("\n")[0]), "seed": seed}
    lines = [_line(episode, header["agents"], seed, file) for episode in episodes]
    runs = _oracle(name, split, header, lines)
    solved = recorded = equal = 0
    for episode, line, run in zip(episodes, lines, runs, strict=True):
        if not run.success:
            continue
        solved += 1
        recorded += episode.oracle_steps is not None
        equal += run.steps == episode.oracle_steps
        line["oracle"] = {"steps": run.steps, "return": run.total, "constrained": dict(run.constrained)}
    write_text(output, _text(header, lines), by="import-episodes", overwrite=overwrite)
    return Imported(len(episodes), solved, recorded, equal)


def _text(header: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> str:
    return "".join(json.dumps(each, separators=(",", ":")) + "\n" for each in (header, *lines))


def _line(
    episode: PublishedEpisode, usual: Sequence[Mapping[str, Any]], seed: int, file: str | os.PathLike[str]
) -> dict[str, Any]:
    """Return the line of an episode, with the agents in the order of the header."""
    agents = {agent.name: agent for agent in episode.agents}
    names = [agent["id"] for agent in usual]
    if agents.keys() != set(names):
        (other, *_) = sorted(agents.keys() ^ set(names))
        what = "has no agent" if other in names else "has an additional agent"
        help = "name the mode and the split of the file with `--mode` and `--split`"
        raise ValueError(f"{os.fspath(file)}: episode {episode.number} {what} `{neutral(other)}`\nhelp: {help}")
    changes = {
        name: {"concepts": list(agents[name].concepts), "priority": agents[name].priority}
        for name, is_usual in zip(names, usual, strict=True)
        if [list(agents[name].concepts), agents[name].priority] != [is_usual["concepts"], is_usual["priority"]]
    }
    return {
        # Less than 2^53, which all readers of JSON represent exactly.
        "seed": random.Random(f"{seed} {episode.number}").getrandbits(53),
        "trips": [[*agents[name].start, *agents[name].goal] for name in names],
        "changes": changes,
        "oracle": None,
    }


def _oracle(
    mode: str, split: Split, header: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]
) -> list[EpisodeRecord]:
    """Run the oracle on episodes without a record of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episodes.jsonl"
        path.write_text(_text(header, lines), encoding="utf-8")
        overrides = {"task": {"episodes": {split: str(path)}, "horizon": _STEPS_MAX, "egos": None}}
        return list(Benchmark(mode, split, overrides=overrides).evaluate("oracle").episodes)


def read_published(file: str | os.PathLike[str]) -> list[PublishedEpisode]:
    """Return the episodes in a pickle of the published program, in the order of their numbers. Nothing in it runs.

    Raises:
        OSError: If the file cannot be read.
        ValueError: If it is damaged, has other content, or would run code.
    """
    name = checked_path("file", file)
    check_readable(name, whole=False)
    with open(name, "rb") as stream:
        try:
            content = _Machine(stream, os.fstat(stream.fileno()).st_size).run()
            episodes = [_episode(number, each) for number, each in sorted(_episodes(content))]
        except _Fault as fault:
            raise ValueError(f"{name}: {fault}") from None
    return episodes


class _Fault(Exception):
    """What is wrong with a pickle or its content."""


def _episodes(content: Any) -> Iterator[tuple[int, Any]]:
    if not isinstance(content, dict):
        raise _Fault(f"expected a dictionary of episodes, not {_shown(content)}")
    if not content:
        raise _Fault("it has no episodes")
    for key, value in content.items():
        if isinstance(key, bool) or not isinstance(key, int) or not 0 <= key < 2**31:
            raise _Fault(f"expected the number of an episode as key, not {_shown(key)}")
        yield key, value


def _episode(number: int, value: Any) -> PublishedEpisode:
    where = f"episode {number}"
    agents = _entry(value, "agents", dict, where)
    if not agents:
        raise _Fault(f"{where} has no agents")
    steps = None
    if "label_info" in value:
        label = _entry(value, "label_info", dict, where)
        steps = _whole(label["oracle_step"], f"{where}, `oracle_step`") if "oracle_step" in label else None
    return PublishedEpisode(number, tuple(_agent(where, name, each) for name, each in agents.items()), steps)


def _agent(where: str, name: Any, value: Any) -> PublishedAgent:
    if not isinstance(name, str):
        raise _Fault(f"{where}: expected the name of an agent as key, not {_shown(name)}")
    where = f"{where}, agent `{neutral(name[:100], lines=False)}`"
    concepts = _entry(value, "concepts", dict, where)
    if not all(isinstance(concept, str) for concept in concepts):
        raise _Fault(f"{where}: expected the names of concepts as keys")
    held = (
        concept
        for concept, given in concepts.items()
        if concept not in ("type", "priority")
        and _is_true(given, f"{where}, concept `{neutral(concept[:100], lines=False)}`")
    )
    return PublishedAgent(
        name,
        tuple(held),
        _whole(_entry(value, "priority", object, where), f"{where}, `priority`"),
        _cell(_entry(value, "start", object, where), f"{where}, `start`"),
        _cell(_entry(value, "goal", object, where), f"{where}, `goal`"),
    )


def _is_true(value: Any, where: str) -> bool:
    truth = _single(value)
    if not isinstance(truth, (bool, int, float)):
        raise _Fault(f"{where}: expected a truth value or a number, not {_shown(value)}")
    return bool(truth)


def _single(value: Any) -> Any:
    """Return the number in a scalar or an array of NumPy with one element, and other values as they are."""
    return value.item() if isinstance(value, (np.generic, np.ndarray)) and value.size == 1 else value


def _entry(value: Any, key: str, kind: type, where: str) -> Any:
    if not isinstance(value, dict) or key not in value:
        raise _Fault(f"{where} has no `{key}`")
    if not isinstance(value[key], kind):
        raise _Fault(f"{where}: expected a dictionary as `{key}`, not {_shown(value[key])}")
    return value[key]


def _whole(value: Any, where: str) -> int:
    number = _single(value)
    if isinstance(number, bool) or not isinstance(number, int) or not -(2**31) <= number < 2**31:
        raise _Fault(f"{where}: expected an integer, not {_shown(value)}")
    return number


def _cell(value: Any, where: str) -> tuple[int, int]:
    items = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(items, (list, tuple)) or len(items) != 2:
        raise _Fault(f"{where}: expected row and column of a cell, not {_shown(value)}")
    row, col = (_whole(each, where) for each in items)
    return row, col


def _shown(value: Any) -> str:
    """Describe a value of a pickle, which may be large or contain itself."""
    if isinstance(value, (bool, int, float, str)) and not isinstance(value, (np.generic,)):
        return (
            f"`{neutral(str(value)[:60], lines=False)}`"
            if not isinstance(value, int) or abs(value) < 2**64
            else "a number"
        )
    return {dict: "a dictionary", list: "a list", tuple: "a tuple", type(None): "None"}.get(
        type(value), f"a value of the type {type(value).__name__.removeprefix('_')}"
    )


@dataclass(frozen=True)
class _Opaque:
    """A value that episodes do not need: a tensor, its storage, or long bytes."""

    what: str


@dataclass(frozen=True)
class _Callable:
    """A function that a pickle names, and that has a meaning here."""

    name: str


class _Array:
    """An array of NumPy whose state follows. A pickle can refer to it again afterwards, and means its values."""

    values: NDArray[Any] | _Opaque | None = None


class _DType:
    """A type of NumPy whose byte order follows."""

    def __init__(self, code: str) -> None:
        self.code, self.order = code, "="


#: The functions that pickles of the published program name, with those of other versions of NumPy.
_KNOWN = {
    "numpy.core.multiarray _reconstruct": "array",
    "numpy._core.multiarray _reconstruct": "array",
    "numpy.core.multiarray scalar": "scalar",
    "numpy._core.multiarray scalar": "scalar",
    "numpy.core.numeric _frombuffer": "buffer",
    "numpy._core.numeric _frombuffer": "buffer",
    "numpy ndarray": "ndarray",
    "numpy dtype": "dtype",
    "torch._utils _rebuild_tensor_v2": "tensor",
    "torch.storage _load_from_bytes": "storage",
    "collections OrderedDict": "dict",
    "_codecs encode": "encode",
}

#: The types of numbers that arrays may have.
_NUMBERS = ("b1", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8")

_MARK = object()


class _Stream:
    """A file whose end is an error, before memory is reserved for what it claims to have."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.size = file, size

    def tell(self) -> int:
        return self.file.tell()

    def read(self, count: int) -> bytes:
        if count > self.size - self.file.tell():
            raise _Fault(f"the pickle is truncated: it ends within a value, at byte {self.size}")
        return self.file.read(count)

    def readline(self) -> bytes:
        line = self.file.readline(_BYTES_MAX)
        if not line.endswith(b"\n"):
            raise _Fault(f"the pickle is truncated or damaged at byte {self.file.tell()}")
        return line


class _Machine:
    """Interprets a pickle. Functions that it names are not called: each known one has a meaning here."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.stream = _Stream(file, size)
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self) -> Any:
        """Return the value of the pickle."""
        place = 0
        try:
            for opcode, argument, at in pickletools.genops(self.stream):  # type: ignore[arg-type]
                place = self.stream.tell() if at is None else at
                if opcode.name == "STOP":
                    break
                self._step(opcode.name, argument)
            (value,) = self.stack
            return value
        except _Fault as fault:
            message = str(fault)
            raise _Fault(message if "byte" in message else f"{message}, at byte {place}") from None
        except (ValueError, IndexError, KeyError, TypeError, OverflowError, RecursionError, UnicodeError) as error:
            raise _Fault(f"it is not a pickle, or damaged, at byte {place}: {neutral(str(error))[:200]}") from None

    def _step(self, name: str, argument: Any) -> None:
        stack = self.stack
        if name in _PUSHED:
            is_long = isinstance(argument, (bytes, bytearray)) and len(argument) > _BYTES_MAX
            stack.append(_Opaque("bytes") if is_long else argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name])
        elif name in _CREATED:
            stack.append(_CREATED[name]())
        elif name in ("PROTO", "FRAME"):
            pass
        elif name == "MARK":
            stack.append(_MARK)
        elif name == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memo[argument] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            value = self.memo[argument]
            stack.append(value.values if isinstance(value, _Array) and value.values is not None else value)
        elif name == "POP":
            stack.pop()
        elif name in _TUPLES:
            count = _TUPLES[name]
            if len(stack) < count:
                raise IndexError("the stack is empty")
            stack[-count:] = [tuple(stack[-count:])]
        elif name in ("TUPLE", "LIST", "DICT", "APPENDS", "SETITEMS"):
            self._marked(name)
        elif name == "APPEND":
            value = stack.pop()
            self._top(list).append(value)
        elif name == "SETITEM":
            value, key = stack.pop(), stack.pop()
            self._top(dict)[_key(key)] = value
        elif name in ("GLOBAL", "STACK_GLOBAL"):
            if name == "STACK_GLOBAL":
                attribute, module = stack.pop(), stack.pop()
                # Other values can be too large to print: a list can contain another one often, and so on.
                if not isinstance(module, str) or not isinstance(attribute, str):
                    raise _Fault(f"it names a function by {_shown(module)} and {_shown(attribute)}, not by two strings")
                argument = f"{module} {attribute}"
            stack.append(_named(argument))
        elif name == "REDUCE":
            arguments, function = stack.pop(), stack.pop()
            if not isinstance(function, _Callable) or not isinstance(arguments, tuple):
                raise _Fault("it calls a value that is no function")
            stack.append(_call(function.name, arguments))
        elif name == "BUILD":
            state = stack.pop()
            stack[-1] = _built(stack[-1], state)
        else:
            raise _Fault(f"it has the instruction {name}, which the files of the published program do not have")

    def _top(self, kind: type) -> Any:
        if not isinstance(self.stack[-1], kind):
            raise TypeError(f"expected a {kind.__name__}")
        return self.stack[-1]

    def _marked(self, name: str) -> None:
        """Run an instruction on the values after the last mark."""
        at = len(self.stack) - 1
        while at >= 0 and self.stack[at] is not _MARK:
            at -= 1
        if at < 0:
            raise IndexError("no mark")
        values = self.stack[at + 1 :]
        del self.stack[at:]
        if name == "TUPLE":
            self.stack.append(tuple(values))
        elif name == "LIST":
            self.stack.append(values)
        elif name == "APPENDS":
            self._top(list).extend(values)
        else:
            target = {} if name == "DICT" else self._top(dict)
            if len(values) % 2:
                raise ValueError("a key without a value")
            target.update(zip(map(_key, values[::2]), values[1::2], strict=True))
            if name == "DICT":
                self.stack.append(target)


_PUSHED = {
    *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
}
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_CREATED: dict[str, Callable[[], Any]] = {"EMPTY_DICT": dict, "EMPTY_LIST": list, "EMPTY_TUPLE": tuple}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


def _key(value: Any) -> int | str:
    """Return a key of a dictionary. Hashing other values can take forever, or overflow the stack of C."""
    if not isinstance(value, (int, str)):
        raise _Fault(f"expected an integer or a string as a key of a dictionary, not {_shown(value)}")
    return value


def _named(name: str) -> _Callable:
    known = _KNOWN.get(name)
    if known is None:
        shown = neutral(".".join(name.split(" ", 1))[:100], lines=False)
        help = "the pickle would run code if Python loaded it; nothing of it ran"
        raise _Fault(f"it names `{shown}`, which the files of the published program do not need: {help}")
    return _Callable(known)


def _call(name: str, arguments: tuple[Any, ...]) -> Any:
    """Return the value of a call that a pickle has."""
    match name, arguments:
        case "array", (_Callable(name="ndarray"), *_):
            return _Array()
        case "dtype", (str(code), *_) if code in _NUMBERS:
            return _DType(code)
        case "scalar", (_DType() as dtype, bytes(data)):
            return _numbers(dtype, data, (), "C")[()]
        case "buffer", (bytes() | bytearray() as data, _DType() as dtype, shape, str(order)):
            return _numbers(dtype, data, shape, order)
        case "buffer", (_Opaque(), _DType(), _, str()):
            return _Opaque("array")
        case "tensor", _:
            return _Opaque("tensor")
        case "storage", _:
            return _Opaque("storage")
        case "dict", (() | ([],)):
            return {}
        case "encode", (str(text), "latin1"):
            return text.encode("latin1") if len(text) <= _BYTES_MAX else _Opaque("bytes")
    raise _Fault(f"it calls `{name}` with arguments that the files of the published program do not have")


def _built(value: Any, state: Any) -> Any:
    """Return a value with the state that follows it in a pickle."""
    match value, state:
        case _DType(), (int(), str(order), *_) if order in ("<", ">", "|", "="):
            value.order = order
            return value
        case _Array(), (int(), shape, _DType() as dtype, bool() | int() as fortran, bytes() | bytearray() as data):
            value.values = _numbers(dtype, data, shape, "F" if fortran else "C")
            return value.values
        case _Array(), (int(), _, _DType(), _, _Opaque()):
            value.values = _Opaque("array")
            return value.values
    raise _Fault("it gives a value a state that the files of the published program do not have")


def _numbers(dtype: _DType, data: bytes | bytearray, shape: Any, order: str) -> NDArray[Any]:
    if not isinstance(shape, tuple) or len(shape) > 4 or not all(isinstance(each, int) and each >= 0 for each in shape):
        raise _Fault("an array has an invalid shape")
    type = np.dtype(dtype.order.replace("|", "") + dtype.code)
    count = 1
    for each in shape:
        count *= each
    if count * type.itemsize != len(data) or order not in ("C", "F"):
        raise _Fault("the size of an array does not match its shape")
    values: NDArray[Any] = np.frombuffer(bytes(data), type)
    in_order = values.reshape(shape) if order == "C" else values.reshape(shape[::-1]).T
    return in_order.astype(type.newbyteorder("="))
