"""Trajectories of recorded traffic: readers of SUMO's FCD output and of CSV files, resampled to ticks.

The readers hold one sample per agent and the resampled tracks, so memory grows with ticks, not with samples.
"""

from __future__ import annotations

import csv
import gzip
import math
import os
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, Any, Literal, NoReturn, cast
from xml.etree import ElementTree

from . import _logicity
from .errors import did_you_mean

__all__ = ["Columns", "Recording", "Track", "read_columns", "read_trajectories"]

#: Seconds without a sample after which the same id is another track.
GAP = 2.0

#: The columns that a CSV file can have, with their names without a mapping.
COLUMNS = ("t", "frame", "id", "kind", "x", "y", "heading", "speed", "vx", "vy")

#: Factors from the units of a mapping to meters, meters per second and radians.
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 0.01, "ft": 0.3048, "km": 1000.0},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "ft/s": 0.3048},
    "angle": {"deg": math.pi / 180, "rad": 1.0},
}


@dataclass(frozen=True)
class Columns:
    """How to read a CSV file.

    Attributes:
        names: The names of columns in the file, by the names of `COLUMNS`.
        frame_rate: Frames per second, for files with frames instead of times.
        delimiter: The character between columns.
        kinds: The kind of agent by class in the file; `None` leaves out agents of this class.
        default_kind: The kind of agents of other classes; `None` leaves them out.
        units: The unit of `length`, `speed` and `angle`.
        zero: The direction of the angle 0: `"north"`, toward larger y, or `"east"`.
        clockwise: Whether angles grow clockwise.
    """

    names: dict[str, str] = field(default_factory=lambda: {name: name for name in COLUMNS})
    frame_rate: float | None = None
    delimiter: str = ","
    kinds: dict[str, str | None] = field(default_factory=dict)
    default_kind: str | None = "Car"
    units: dict[str, str] = field(default_factory=lambda: {"length": "m", "speed": "m/s", "angle": "deg"})
    zero: Literal["north", "east"] = "north"
    clockwise: bool = True


@dataclass
class Track:
    """The track of an agent without gaps: its state in successive ticks.

    Attributes:
        id: The id in the file.
        kind: The kind of agent, `"Car"` or `"Pedestrian"`.
        first: The tick of the first state.
        x, y: Positions in meters.
        angle: Directions of travel in radians, counterclockwise from east; NaN where the file has none.
        speed: Speeds in m/s; NaN where the file has none.
    """

    id: str
    kind: str
    first: int
    x: list[float] = field(default_factory=list)
    y: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)

    def __len__(self) -> int:
        """Return the number of ticks."""
        return len(self.x)


@dataclass(frozen=True)
class Recording:
    """The tracks of one or more files.

    Attributes:
        tracks: The tracks, in the order of their first samples.
        tick: The length of a tick in seconds. Tick k is at k times this length. SUMO writes positions after the step
            of their time; they are those at the beginning of the next one.
        samples: The number of samples read.
        left_out: The number of samples of classes that the mapping leaves out.
        assumed: By class of a table that neither the mapping nor the program knows, the number of samples; they count
            as the kind of others.
    """

    tracks: list[Track]
    tick: float
    samples: int
    left_out: int
    assumed: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Sample:
    t: float
    x: float
    y: float
    angle: float
    speed: float


class _Resampler:
    """Samples of agents in the order of time, to tracks."""

    def __init__(self, tick: float) -> None:
        self.tick = tick
        #: The time from a sample to the state that it describes, in seconds.
        self.shift = 0.0
        self.tracks: list[Track] = []
        self.samples = self.left_out = 0
        self.assumed: Counter[str] = Counter()
        self._open: dict[tuple[str, str], tuple[_Sample, Track | None]] = {}

    def add(self, id: str, kind: str, sample: _Sample, space: str = "") -> str | None:
        """Add a sample; return why it cannot follow the one before. Ids are those of a space of names."""
        self.samples += 1
        last, track = self._open.get((space, id), (None, None))
        if last is not None and sample.t <= last.t:
            return f"`{id}` has the time {sample.t:g} s after {last.t:g} s; the times of an id must increase"
        if last is None or sample.t - last.t > max(GAP, 1.5 * self.tick) or (track is not None and track.kind != kind):
            last = track = None
        time = sample.t + self.shift
        before_time = math.nan if last is None else last.t + self.shift
        first = math.ceil(time / self.tick - 1e-9) if last is None else math.floor(before_time / self.tick + 1e-9) + 1
        for tick in range(first, math.floor(time / self.tick + 1e-9) + 1):
            if track is None:
                track = Track(id, kind, tick)
                self.tracks.append(track)
            share = 1.0 if last is None else (tick * self.tick - before_time) / (time - before_time)
            before = sample if last is None else last
            track.x.append(before.x + share * (sample.x - before.x))
            track.y.append(before.y + share * (sample.y - before.y))
            # Halfway between two directions there is none of a car: the nearer sample has it.
            track.angle.append(sample.angle if share >= 0.5 else before.angle)
            track.speed.append(before.speed + share * (sample.speed - before.speed))
        self._open[space, id] = (sample, track)
        return None


def read_columns(path: str | os.PathLike[str]) -> tuple[Columns, dict[str, Any]]:
    """Return the mapping of columns in a YAML file, and the rest of the file: the transformation to the map.

    Raises:
        InputError: If a key or a value is invalid.
        OSError: If the file cannot be read.
    """
    file = _logicity.ConfigFile(os.fspath(path), "trajectories")
    value = file.value()
    faults: list[tuple[str, list[str], str, str]] = []

    def fault(code: str, place: list[str], message: str, help: str = "") -> None:
        faults.append((code, place, message, help))

    def mapping(key: str, known: tuple[str, ...] | None) -> dict[str, Any]:
        found = value.get(key)
        if found is None:
            return {}
        if not isinstance(found, dict):
            fault("invalid-value", [key], f"`{key}` is not a mapping")
            return {}
        for name in found:
            if known is not None and name not in known:
                fault("unknown-key", [key, name], f"unknown key `{name}`{did_you_mean(name, known)}")
        return found

    def choice(place: list[str], given: Any, known: tuple[str, ...]) -> Any:
        if given not in known:
            fault("invalid-value", place, f"expected one of {', '.join(known)}")
        return given

    if not isinstance(value, dict):
        raise file.error([("invalid-value", [], "the file is not a mapping", "")])
    keys = ("columns", "frame_rate", "delimiter", "kinds", "other_kinds", "units", "heading", "place")
    for name in value:
        if name not in keys:
            fault("unknown-key", [name], f"unknown key `{name}`{did_you_mean(name, keys)}")
    names = {name: str(given) for name, given in mapping("columns", COLUMNS).items() if given is not None}
    units = dict(Columns().units)
    for name, given in mapping("units", tuple(UNITS)).items():
        if name in UNITS:
            units[name] = choice(["units", name], given, tuple(UNITS[name]))
    agents = ("Car", "Pedestrian")
    kinds: dict[str, str | None] = {}
    for name, given in mapping("kinds", None).items():
        kinds[str(name)] = None if given is None else choice(["kinds", name], given, agents)
    other = value.get("other_kinds", "Car")
    heading = mapping("heading", ("zero", "turn"))
    place = mapping("place", ("cell", "origin", "y"))
    rate, delimiter = value.get("frame_rate"), value.get("delimiter", ",")
    if rate is not None and not (isinstance(rate, (int, float)) and 0 < rate < math.inf):
        fault("invalid-value", ["frame_rate"], "expected a positive number of frames per second")
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        fault("invalid-value", ["delimiter"], "expected one character")
    if "frame" in names and rate is None:
        fault("missing-key", ["columns", "frame"], "a column of frames needs `frame_rate`, the frames per second")
    zero = choice(["heading", "zero"], heading.get("zero", "north"), ("north", "east"))
    turn = choice(["heading", "turn"], heading.get("turn", "clockwise"), ("clockwise", "counterclockwise"))
    if other is not None:
        choice(["other_kinds"], other, agents)
    origin = place.get("origin")
    if origin is not None and not (
        isinstance(origin, list) and len(origin) == 2 and all(isinstance(each, (int, float)) for each in origin)
    ):
        fault("invalid-value", ["place", "origin"], "expected [x, y], the position of the upper left corner of the map")
    if "cell" in place and not (isinstance(place["cell"], (int, float)) and place["cell"] > 0):
        fault("invalid-value", ["place", "cell"], "expected the side of a cell in meters")
    if "y" in place:
        choice(["place", "y"], place["y"], ("up", "down"))
    if faults:
        raise file.error(faults)
    columns = Columns(names or Columns().names, rate, delimiter, kinds, other, units, zero, turn == "clockwise")
    return columns, place


def read_trajectories(
    paths: list[str], columns: Columns | None = None, *, tick: float = 1.0, begin: float = 0.0, end: float = math.inf
) -> Recording:
    """Read files of SUMO's FCD output (`.xml`, also `.xml.gz`) or CSV, and resample them to ticks.

    The ids of several files are those of different agents if they overlap in time.

    Args:
        paths: The files.
        columns: How to read CSV files and which kinds of agents classes are; by default, the columns have the names of
            `COLUMNS`.
        tick: The length of a tick in seconds.
        begin: Samples before this time, in seconds, are left out.
        end: Samples after this time, in seconds, are left out.

    Raises:
        OSError: If a file cannot be read.
        ValueError: If a file is invalid; the message names file, line and column.
    """
    chosen = columns or Columns()
    tracks: list[Track] = []
    samples = left_out = 0
    assumed: Counter[str] = Counter()
    for path in paths:
        to = _Resampler(tick)
        read = _read_fcd if path.removesuffix(".gz").endswith(".xml") else _read_csv
        read(path, chosen, to, begin, end)
        tracks += to.tracks
        samples, left_out = samples + to.samples, left_out + to.left_out
        assumed.update(to.assumed)
    return Recording(tracks, tick, samples, left_out, dict(assumed))


#: What reading a compressed file raises if it is damaged.
_DAMAGED = (EOFError, gzip.BadGzipFile, zlib.error)


def _open(path: str) -> IO[bytes]:
    _logicity.check_readable(path, False)
    return cast("IO[bytes]", gzip.open(path, "rb")) if path.endswith(".gz") else open(path, "rb")


def _fail(path: str, line: int | None, column: str | None, message: str, help: str = "") -> NoReturn:
    """Raise the error of a place in a file. `column` is the name of a column or an attribute."""
    place = path if line is None else f"{path}:{line}"
    where = "" if column is None else f"column `{column}`: "
    raise ValueError(f"{place}: {where}{message}" + (f"\nhelp: {help}" if help else ""))


def _kind(columns: Columns, found: str, default: str | None) -> str | None:
    return columns.kinds[found] if found in columns.kinds else default


def _read_fcd(path: str, columns: Columns, to: _Resampler, begin: float, end: float) -> None:
    """Read FCD output: `<timestep time=".."><vehicle id=".." x=".." y=".." angle=".." speed=".." type=".."/>`."""
    lines = _LineCounter()
    # SUMO writes the state after each step.
    to.shift = min(_fcd_step(path), to.tick)
    try:
        with _open(path) as file:
            root: ElementTree.Element | None = None
            time: float | None = None
            for event, element in ElementTree.iterparse(_Counted(file, lines), ("start", "end")):
                if root is None:
                    root = element
                    if element.tag != "fcd-export":
                        help = "`sumo --fcd-output FILE` writes such files; name a table `.csv`"
                        _fail(path, None, None, f"the root is <{element.tag}>, not <fcd-export>", help)
                elif event == "start" and element.tag == "timestep":
                    time = _attribute(path, lines, element, "time")
                elif event == "end" and element.tag in ("vehicle", "person"):
                    if time is None:
                        _fail(path, lines.line, None, f"a <{element.tag}> outside of a <timestep>")
                    if begin <= time <= end:
                        _add_fcd(path, columns, to, lines, time, element)
                elif event == "end" and element.tag == "timestep":
                    # The root would keep every time step.
                    root.clear()
            if root is None:
                _fail(path, None, None, "the file is empty")
    except ElementTree.ParseError as error:
        line, _ = error.position
        _fail(path, line, None, f"not XML: {error.msg if hasattr(error, 'msg') else error}", "is the file complete?")
    except (*_DAMAGED, UnicodeDecodeError) as error:
        _fail(path, None, None, f"damaged: {error}", "is the file complete?")


def _fcd_step(path: str) -> float:
    """Return the time between the first two steps of FCD output; infinite where there are none."""
    times: list[float] = []
    # Reading the file as a whole reports what is wrong.
    with (
        suppress(ElementTree.ParseError, *_DAMAGED, UnicodeDecodeError, ValueError),
        _open(path) as file,
    ):
        for _, element in ElementTree.iterparse(file, ("start",)):
            if element.tag == "timestep":
                times.append(float(element.get("time", "")))
            if len(times) == 2:
                step = times[1] - times[0]
                return step if step > 0 else math.inf
    return math.inf


def _add_fcd(
    path: str, columns: Columns, to: _Resampler, lines: _LineCounter, time: float, element: ElementTree.Element
) -> None:
    id = element.get("id")
    if id is None:
        _fail(path, lines.line, "id", f"a <{element.tag}> without it")
    default = "Pedestrian" if element.tag == "person" else columns.default_kind
    kind = _kind(columns, element.get("type", ""), default)
    if kind is None:
        to.left_out += 1
        return
    x, y, speed = (_attribute(path, lines, element, name) for name in ("x", "y", "speed"))
    # SUMO's angles grow clockwise from north.
    angle = math.radians(90 - _attribute(path, lines, element, "angle"))
    # A vehicle and a person may have the same id.
    fault = to.add(id, kind, _Sample(time, x, y, angle, speed), element.tag)
    if fault is not None:
        _fail(path, lines.line, "time", fault)


def _attribute(path: str, lines: _LineCounter, element: ElementTree.Element, name: str) -> float:
    found = element.get(name)
    if found is None:
        help = "write it: `--fcd-output.attributes id,x,y,angle,speed,type`"
        _fail(path, lines.line, name, f"a <{element.tag}> without it", help)
    with suppress(ValueError):
        number = float(found)
        if math.isfinite(number):
            return number
    _fail(path, lines.line, name, f"expected a number, found `{found[:40]}`")


class _LineCounter:
    """The number of the line that the parser has read to."""

    line = 1


class _Counted:
    """A file that is read line by line, so that the number of lines read is that of the element that was parsed."""

    def __init__(self, file: IO[bytes], lines: _LineCounter) -> None:
        self._file, self._lines, self._begun = file, lines, False

    def read(self, size: int = -1) -> bytes:
        line = self._file.readline(1 << 16)
        # The first line is line 1.
        if self._begun and line:
            self._lines.line += 1
        self._begun = self._begun or line.endswith(b"\n")
        return line


def _read_csv(path: str, columns: Columns, to: _Resampler, begin: float, end: float) -> None:
    lengths, speeds = UNITS["length"][columns.units["length"]], UNITS["speed"][columns.units["speed"]]
    angles = UNITS["angle"][columns.units["angle"]]
    with _open(path) as file:
        reader = csv.reader(_decoded(path, file), delimiter=columns.delimiter, strict=True)
        try:
            header = next(reader, None)
            if header is None:
                _fail(path, None, None, "the file is empty")
            places = _places(path, columns, [name.strip().lstrip("\ufeff") for name in header])
            for row in reader:
                if not row:
                    continue
                if len(row) != len(header):
                    _fail(path, reader.line_num, None, f"{len(row)} values, but the header has {len(header)} columns")
                texts = {name: row[place].strip() for name, place in places.items()}
                id, kind = texts["id"], _kind(columns, texts.get("kind", ""), _own_kind(columns, texts))
                if kind is None:
                    to.left_out += 1
                    continue
                found = texts.get("kind", "")
                if found not in ("", "Car", "Pedestrian", *columns.kinds):
                    to.assumed[found] += 1

                def number(name: str, texts: dict[str, str] = texts, line: int = reader.line_num) -> float:
                    with suppress(ValueError):
                        value = float(texts[name])
                        if math.isfinite(value):
                            return value
                    _fail(path, line, columns.names[name], f"expected a number, found `{texts[name][:40]}`")

                t = number("frame") / (columns.frame_rate or 1.0) if "frame" in texts else number("t")
                if not begin <= t <= end:
                    continue
                angle = speed = math.nan
                if "vx" in texts and "vy" in texts:
                    vx, vy = number("vx") * speeds, number("vy") * speeds
                    speed = math.hypot(vx, vy)
                    angle = math.atan2(vy, vx) if speed > 0.1 else math.nan
                if "speed" in texts:
                    speed = abs(number("speed")) * speeds
                if "heading" in texts:
                    turned = number("heading") * angles * (-1 if columns.clockwise else 1)
                    angle = turned + (math.pi / 2 if columns.zero == "north" else 0.0)
                sample = _Sample(t, number("x") * lengths, number("y") * lengths, angle, speed)
                fault = to.add(id, kind, sample)
                if fault is not None:
                    _fail(path, reader.line_num, columns.names["frame" if "frame" in texts else "t"], fault)
        except csv.Error as error:
            _fail(path, reader.line_num, None, f"not CSV: {error}")
        except _DAMAGED as error:
            _fail(path, reader.line_num, None, f"damaged: {error}", "is the file complete?")


def _own_kind(columns: Columns, texts: dict[str, str]) -> str | None:
    """Return the kind of a class that the mapping does not name: its own name if it is one."""
    found = texts.get("kind", "")
    return found if found in ("Car", "Pedestrian") else columns.default_kind


def _decoded(path: str, file: IO[bytes]) -> Iterator[str]:
    for number, line in enumerate(file, 1):
        try:
            yield line.decode("utf-8")
        except UnicodeDecodeError:
            _fail(path, number, None, "not UTF-8")


def _places(path: str, columns: Columns, header: list[str]) -> dict[str, int]:
    """Return the positions of the known columns in a header."""
    places: dict[str, int] = {}
    for name, given in columns.names.items():
        if given in header:
            places[name] = header.index(given)
        elif columns.names != Columns().names:
            _fail(path, 1, given, f"the header has no such column{did_you_mean(given, header)}")
    for needed in ("id", "x", "y"):
        if needed not in places:
            help = "name the columns in a YAML file: `--columns FILE`"
            _fail(path, 1, needed, f"the header has no such column; it has {', '.join(header)[:200]}", help)
    if "t" not in places and "frame" not in places:
        help = "name it in a YAML file, `columns: {t: NAME}`, or `columns: {frame: NAME}` with `frame_rate`"
        _fail(path, 1, "t", f"the header has no such column; it has {', '.join(header)[:200]}", help)
    if "frame" in places and columns.frame_rate is None:
        places.pop("frame")
        if "t" not in places:
            _fail(path, 1, "frame", "a file with frames needs `frame_rate` in the file of `--columns`")
    return places
