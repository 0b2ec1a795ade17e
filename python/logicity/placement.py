"""Recorded traffic on the map of a city: the cells, headings, exits and decisions of agents in every tick."""

from __future__ import annotations

import math
import os
from bisect import bisect
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import accumulate, pairwise, product
from typing import Any, TypeAlias

from . import _logicity
from .trajectories import Recording, Track
from .types import Heading

__all__ = ["Grid", "Lane", "Moment", "Placement", "Road", "Roads", "Streets", "Thresholds", "load_map", "place"]

#: The directions of headings, in steps of rows and columns.
STEPS: dict[Heading, tuple[int, int]] = {"Left": (0, -1), "Right": (0, 1), "Up": (-1, 0), "Down": (1, 0)}

#: Headings counterclockwise from east.
_AROUND: tuple[Heading, ...] = ("Right", "Up", "Left", "Down")


@dataclass(frozen=True)
class Lane:
    """A lane of a map of blocks.

    Attributes:
        heading: The direction of travel.
        street: The number of its street, from 0.
        block: The number of the block along which it runs, from 0.
        start, end: Row and column of its first and last cell. Cars wait on the last one.
        zones: The zones that contain its middle.
        has_line: Whether cars on its last cell are at an intersection. On through roads at the edges they are not.
    """

    heading: Heading
    street: int
    block: int
    start: tuple[int, int]
    end: tuple[int, int]
    zones: tuple[str, ...]
    has_line: bool

    @property
    def entered(self) -> Heading:
        """The direction of travel at its start."""
        return self.heading

    @property
    def length(self) -> float:
        """Its length in cells."""
        return abs(self.end[0] - self.start[0]) + abs(self.end[1] - self.start[1]) + 1

    def cell(self, left: float, least: int = 0) -> tuple[int, int]:
        """Return the cell at this distance from its end, in cells, at least `least` cells before the last one."""
        rows, columns = STEPS[self.heading]
        back = min(max(math.ceil(left - 1e-9) - 1, least), int(self.length) - 1)
        return self.end[0] - rows * back, self.end[1] - columns * back

    def heading_at(self, left: float) -> Heading:
        """Return the direction of travel at this distance from its end."""
        return self.heading


@dataclass(frozen=True)
class Road:
    """A lane for cars of a road network.

    Attributes:
        cells: Its cells, from the start.
        headings: The direction of travel on each.
        shape: The points of its middle, as rows and columns.
        width: Its width in cells.
        zones: The zones that contain its middle.
        has_line: Whether cars on its last cell are at an intersection.
        along: The distances from the start along `shape` at which the next cell begins, in cells; they never decrease.
        length: The length of `shape`.
    """

    cells: tuple[tuple[int, int], ...]
    headings: tuple[Heading, ...]
    shape: tuple[tuple[float, float], ...]
    width: float
    zones: tuple[str, ...]
    has_line: bool
    along: tuple[float, ...]
    length: float

    @property
    def start(self) -> tuple[int, int]:
        """Row and column of its first cell."""
        return self.cells[0]

    @property
    def entered(self) -> Heading:
        """The direction of travel at its start."""
        return self.headings[0]

    def _at(self, left: float) -> int:
        return bisect(self.along, self.length - left)

    def cell(self, left: float, least: int = 0) -> tuple[int, int]:
        """Return the cell at this distance from its end, in cells, at least `least` cells before the last one."""
        return self.cells[max(min(self._at(left), len(self.cells) - 1 - least), 0)]

    def heading_at(self, left: float) -> Heading:
        """Return the direction of travel at this distance from its end."""
        return self.headings[self._at(left)]


@dataclass(frozen=True)
class _Plane:
    """The plane of a recording.

    Attributes:
        name: The name of the map.
        rows, columns: The numbers of rows and columns of cells.
        cell: The side of a cell in meters.
        origin: The position of the upper left corner of the map in meters.
        y_up: Whether y grows toward the top of the map, as on road maps, or toward its bottom, as in pictures.
    """

    name: str
    rows: int
    columns: int
    cell: float
    origin: tuple[float, float]
    y_up: bool

    def position(self, row: float, column: float) -> tuple[float, float]:
        """Return the position in meters of a point on the map; a cell has its number as its first edge."""
        down = row * self.cell
        return self.origin[0] + column * self.cell, self.origin[1] + (-down if self.y_up else down)

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Return the row and the column of a position in meters: the converse of `position`."""
        down = (self.origin[1] - y) if self.y_up else (y - self.origin[1])
        return down / self.cell, (x - self.origin[0]) / self.cell

    def cell_of(self, row: float, column: float) -> tuple[int, int] | None:
        """Return the cell of a point; `None` off the map."""
        cell = (math.floor(row), math.floor(column))
        return cell if 0 <= cell[0] < self.rows and 0 <= cell[1] < self.columns else None


@dataclass(frozen=True)
class Grid(_Plane):
    """A map of blocks in the plane of a recording.

    Attributes:
        blocks: The numbers of rows and columns of blocks.
        lane_offset: The number of cells from a lane to the mid line of its street.
        lanes: All lanes.
    """

    blocks: tuple[int, int]
    lane_offset: int
    lanes: tuple[Lane, ...]
    _across: dict[Heading, dict[int, list[int]]] = field(repr=False, compare=False)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        cell: float,
        origin: tuple[float, float] = (0.0, 0.0),
        y_up: bool = True,
    ) -> Grid:
        """Return the map in a map file or a configuration. A bare name is a built-in one, first of all a map.

        Raises:
            InputError: If the file is invalid.
            OSError: If it cannot be read.
            ValueError: If the map is a road network.
        """
        name, (rows, columns), blocks, offset, lanes = _logicity.lanes(_map_file(path))
        last = {"Left": blocks[0], "Right": blocks[0], "Up": blocks[1], "Down": blocks[1]}

        def made(lane: tuple[Heading, int, int, tuple[int, int], tuple[int, int], list[str]]) -> Lane:
            heading, street, block, start, end, zones = lane
            return Lane(heading, street, block, start, end, tuple(zones), 0 < street < last[heading])

        all_lanes = tuple(map(made, lanes))
        across: dict[Heading, dict[int, list[int]]] = {heading: {} for heading in STEPS}
        for number, lane in enumerate(all_lanes):
            row, column = lane.start
            key = row if lane.heading in ("Left", "Right") else column
            across[lane.heading].setdefault(key, []).append(number)
        shape = (blocks[0], blocks[1])
        return cls(name, rows, columns, cell, origin, y_up, shape, offset, all_lanes, across)

    def find(self, angle: float, row: float, column: float) -> tuple[int, float] | None:
        """Return the lane at a point in a direction, and the distance to its end in cells; `None` if there is none.

        Args:
            angle: The direction in radians counterclockwise from the right of the map.
            row: The row of the point, in cells.
            column: Its column.
        """
        heading = _heading(angle)
        is_flat = heading in ("Left", "Right")
        across, along = (row, column) if is_flat else (column, row)
        axis = 1 if is_flat else 0
        width = self.lane_offset + 0.5
        for center, lanes in self._across[heading].items():
            if abs(across - (center + 0.5)) > width:
                continue
            for number in lanes:
                lane = self.lanes[number]
                low, high = sorted((lane.start[axis], lane.end[axis]))
                if low <= along <= high + 1:
                    forward = heading in ("Right", "Down")
                    return number, (high + 1 - along) if forward else (along - low)
        return None

    def before(self, lane: int, rear: tuple[float, float]) -> tuple[int, int]:
        """Return the cell of a car whose front is on a lane and whose rear is in the intersection behind it."""
        chosen = self.lanes[lane]
        rows, columns = STEPS[chosen.heading]
        last = (chosen.start[0] - rows, chosen.start[1] - columns)
        at = self.cell_of(*rear)
        if at is None or (at[0] - last[0]) * rows + (at[1] - last[1]) * columns > 0:
            return last
        return at

    def beyond(self, lane: int, front: tuple[float, float]) -> tuple[int, int]:
        """Return the cell of a car whose front is in the intersection ahead and whose rear is on a lane."""
        chosen = self.lanes[lane]
        rows, columns = STEPS[chosen.heading]
        return chosen.end[0] + rows, chosen.end[1] + columns

    def inside(self, rear: tuple[float, float]) -> tuple[int, int] | None:
        """Return the cell of a car on no lane; `None` off the map."""
        return self.cell_of(*rear)


#: The side of the squares in which `Roads` looks for lanes, in cells.
_SQUARE = 16
#: The greatest difference between the directions of a car and of its lane.
_ALIGNED = math.radians(60)
#: The cells beside a lane where a car still drives on it.
_BESIDE = 0.5
#: The cells by which the position of a car at the end of its lane may lie beyond it.
_ROUNDED = 0.05
#: What the coordinates of positions are rounded to, in meters.
_CENTIMETER = 0.01
#: The greatest distance of a car in an intersection from the cells of a connection, in cells.
_FROM_LINK = 4


@dataclass(frozen=True)
class Roads(_Plane):
    """A road network in the plane of a recording. Its file states the sides of cells and the origin.

    Attributes:
        lanes: All lanes for cars.
        links: The connections: two lanes, and the cells between them.
    """

    lanes: tuple[Road, ...]
    links: tuple[tuple[int, int, tuple[tuple[int, int], ...]], ...]
    #: By square: lanes with the number of a segment.
    _segments: dict[tuple[int, int], list[tuple[int, int]]] = field(repr=False, compare=False)
    #: The distances of the points of each lane from its start.
    _reached: tuple[tuple[float, ...], ...] = field(repr=False, compare=False)
    #: The nearest cell of a connection of each cell near one.
    _linked: dict[tuple[int, int], tuple[int, int]] = field(repr=False, compare=False)
    #: The cells of the connections that enter each lane, and the first ones of those that leave it.
    _entering: dict[int, list[tuple[int, int]]] = field(repr=False, compare=False)
    _leaving: dict[int, list[tuple[int, int]]] = field(repr=False, compare=False)

    @classmethod
    def load(cls, path: str | os.PathLike[str], info: Any) -> Roads:
        """Return a road network as `_logicity.roads` describes it."""
        name, (rows, columns), cell, origin, lanes, links = info
        roads, reached = [], []
        segments: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for number, (cells, points, width, has_line, zones) in enumerate(lanes):
            shape = tuple((y, x) for x, y in points)
            at = list(accumulate((math.dist(one, other) for one, other in pairwise(shape)), initial=0.0))
            along, most = [], 0.0
            for (row, column), _ in cells:
                most = max(most, _projected(shape, at, row + 0.5, column + 0.5)[1])
                along.append(most)
            headings = tuple(heading for _, heading in cells)
            places = tuple(place for place, _ in cells)
            edges = tuple((one + other) / 2 for one, other in pairwise(along))
            roads.append(Road(places, headings, shape, width, tuple(zones), has_line, edges, at[-1]))
            reached.append(tuple(at))
            reach = width / 2 + _BESIDE
            for segment, (one, other) in enumerate(pairwise(shape)):
                spans = [
                    range(
                        math.floor((min(a, b) - reach) / _SQUARE),
                        math.floor((max(a, b) + reach) / _SQUARE) + 1,
                    )
                    for a, b in zip(one, other, strict=True)
                ]
                for square in product(*spans):
                    segments.setdefault((square[0], square[1]), []).append((number, segment))
        ways = tuple((one, other, tuple(cells)) for one, other, cells in links)
        linked: dict[tuple[int, int], tuple[int, int]] = {}
        entering: dict[int, list[tuple[int, int]]] = {}
        leaving: dict[int, list[tuple[int, int]]] = {}
        for one, other, cells in ways:
            entering.setdefault(other, []).extend(cells)
            leaving.setdefault(one, []).extend(cells[:1])
            for row, column in cells:
                for rows_, columns_ in product(range(-_FROM_LINK, _FROM_LINK + 1), repeat=2):
                    near = (row + rows_, column + columns_)
                    known = linked.get(near)
                    if known is None or math.dist(near, (row, column)) < math.dist(near, known):
                        linked[near] = (row, column)
        plane = (name, rows, columns, cell, (origin[0], origin[1]), True)
        return cls(*plane, tuple(roads), ways, segments, tuple(reached), linked, entering, leaving)

    def find(self, angle: float, row: float, column: float) -> tuple[int, float] | None:
        """Return what `Grid.find` does: the nearest of several lanes."""
        best: tuple[float, int, float] | None = None
        square = (math.floor(row / _SQUARE), math.floor(column / _SQUARE))
        for number, segment in self._segments.get(square, ()):
            lane = self.lanes[number]
            one, other = lane.shape[segment], lane.shape[segment + 1]
            # Rows grow downward.
            turn = math.atan2(one[0] - other[0], other[1] - one[1]) - angle
            if abs(math.remainder(turn, 2 * math.pi)) > _ALIGNED:
                continue
            along, away = _foot(one, other, row, column)
            length = math.dist(one, other)
            # Beyond its ends, there is no lane; positions are rounded.
            is_before = segment == 0 and along < -_ROUNDED
            if is_before or (segment == len(lane.shape) - 2 and along > length + _ROUNDED):
                continue
            if away <= lane.width / 2 + _BESIDE and (best is None or away < best[0]):
                at = self._reached[number][segment] + min(max(along, 0.0), length)
                best = (away, number, lane.length - at)
        return None if best is None else (best[1], best[2])

    def before(self, lane: int, rear: tuple[float, float]) -> tuple[int, int]:
        """Return the cell of a car whose front is on a lane and whose rear is in the intersection behind it."""
        cells = self._entering.get(lane, ())
        return min(cells, key=lambda cell: math.dist(_middle(cell), rear), default=self.lanes[lane].start)

    def beyond(self, lane: int, front: tuple[float, float]) -> tuple[int, int]:
        """Return the cell of a car whose front is in the intersection ahead and whose rear is on a lane."""
        cells = self._leaving.get(lane, ())
        return min(cells, key=lambda cell: math.dist(_middle(cell), front), default=self.lanes[lane].cells[-1])

    def inside(self, rear: tuple[float, float]) -> tuple[int, int] | None:
        """Return the cell of a car on no lane: the nearest one of a connection, if one is near; `None` off the map."""
        at = self.cell_of(*rear)
        return at if at is None else self._linked.get(at, at)


Streets: TypeAlias = Grid | Roads
"""A map in the plane of a recording."""


def load_map(
    path: str | os.PathLike[str],
    cell: float | None = None,
    origin: tuple[float, float] | None = None,
    y_up: bool | None = None,
) -> Streets:
    """Return the map in a map file or a configuration. A bare name is a built-in one, first of all a map.

    Args:
        path: The file.
        cell: The side of a cell in meters, 1 by default; only for a map of blocks, since road networks state it.
        origin: The position of the upper left corner in meters, 0, 0 by default; only for a map of blocks.
        y_up: Whether y grows toward the top of the map; only for a map of blocks.

    Raises:
        InputError: If the file is invalid.
        OSError: If it cannot be read.
        ValueError: If `cell`, `origin` or `y_up` is given for a road network, or the file is one of SUMO.
    """
    if os.fspath(path).endswith((".net.xml", ".osm")):
        help = f"make a map of it: `logicity map import {os.fspath(path)} -o town.yaml`"
        raise ValueError(f"{os.fspath(path)}: a road network is no map\nhelp: {help}")
    info = _logicity.roads(_map_file(path))
    if info is None:
        return Grid.load(path, 1.0 if cell is None else cell, origin or (0.0, 0.0), y_up is not False)
    if cell is not None or origin is not None or y_up is not None:
        what = "a road network states its cells, origin and direction of y; omit `cell`, `origin` and `y`"
        raise ValueError(f"{os.fspath(path)}: {what}")
    return Roads.load(path, info)


def _map_file(path: str | os.PathLike[str]) -> str:
    file = os.fspath(path)
    if not os.path.exists(file) and os.path.basename(file) == file and "." not in file:
        with suppress(FileNotFoundError):
            _logicity.read_file(map_file := f"configs/maps/{file}.yaml")
            return map_file
    return file


def _middle(cell: tuple[int, int]) -> tuple[float, float]:
    return cell[0] + 0.5, cell[1] + 0.5


def _projected(
    shape: Sequence[tuple[float, float]], at: Sequence[float], row: float, column: float
) -> tuple[float, float]:
    """Return the distance of a point from a line, and the distance of its foot from the start of the line."""
    best = (math.inf, 0.0)
    for (one, other), start in zip(pairwise(shape), at, strict=False):
        along, away = _foot(one, other, row, column)
        best = min(best, (away, start + min(max(along, 0.0), math.dist(one, other))))
    return best


def _foot(one: tuple[float, float], other: tuple[float, float], row: float, column: float) -> tuple[float, float]:
    """Return how far along a segment a point lies, also beyond its ends, and its distance from the segment."""
    length = math.dist(one, other) or 1.0
    rows, columns = (other[0] - one[0]) / length, (other[1] - one[1]) / length
    along = (row - one[0]) * rows + (column - one[1]) * columns
    inside = min(max(along, 0.0), length)
    return along, math.dist((one[0] + inside * rows, one[1] + inside * columns), (row, column))


@dataclass(frozen=True)
class Thresholds:
    """The rates from which actions follow, and what belongs to a line.

    Attributes:
        stop: An agent whose mean speed during a tick is less, in m/s, takes the action Stop.
        halt: One whose mean speed is at most this, in m/s, has halted: it waits until it no longer stops. 0.1 is that
            of SUMO, whose drivers count so who has waited longer at an all-way stop.
        slow: A moving one whose mean speed is less takes Slow; `None` for no such action.
        fast: One whose mean speed is greater takes Fast; `None` for no such action.
        line: A car whose front stands at most this many meters before the end of its lane, with no other before it,
            is on the line. A standing one farther back is in a queue.
        length: The length of a car in meters. It is in an intersection until its rear has left it.
        front: Whether positions are those of fronts, as SUMO writes them; otherwise they are those of centers.
    """

    stop: float = 0.5
    halt: float = 0.1
    slow: float | None = None
    fast: float | None = None
    line: float = 6.0
    length: float = 5.0
    front: bool = True

    def __post_init__(self) -> None:
        """Check the order of the rates.

        Raises:
            ValueError: If a rate is less than one that must be smaller, such as `slow` than `stop`.
        """
        rates = {"halt": self.halt, "stop": self.stop, "slow": self.slow, "fast": self.fast}
        given = [(name, rate) for name, rate in rates.items() if rate is not None]
        for (one, lower), (other, upper) in pairwise(given):
            if lower > upper:
                raise ValueError(f"`{other}` is {upper:g}, less than `{one}`, which is {lower:g}")

    def action(self, speed: float) -> str:
        """Return the action of a mean speed in m/s."""
        if speed < self.stop:
            return "Stop"
        if self.slow is not None and speed < self.slow:
            return "Slow"
        return "Fast" if self.fast is not None and speed > self.fast else "Normal"


@dataclass
class Moment:
    """An agent in a tick.

    Attributes:
        id: The name in scenes.
        kind: `"Car"` or `"Pedestrian"`.
        at: Row and column of its cell.
        heading: The direction of travel along an axis; `None` for an agent that has not moved.
        exit: The direction in which it leaves its next intersection in the recording; `None` if it does not.
        waited: Ticks since it stood still.
        moved: The cells that it moved in the last tick.
        action: The action in this tick; `None` if the recording does not show it.
        is_decision: Whether it decides at the line of an intersection: it stands there, starts, or drives across.
    """

    id: str
    kind: str
    at: tuple[int, int]
    heading: Heading | None
    exit: Heading | None
    waited: int
    moved: int
    action: str | None
    is_decision: bool = False


@dataclass
class Placement:
    """Recorded traffic on a map.

    Attributes:
        moments: For each tick with agents, its number and the agents on the map.
        outside: The number of states of agents off the map, which are left out.
        off_lane: The number of states of cars neither on a lane nor in an intersection.
    """

    moments: dict[int, list[Moment]] = field(default_factory=dict)
    outside: int = 0
    off_lane: int = 0


@dataclass(slots=True)
class _State:
    """A state of a car along its lane."""

    lane: int | None
    heading: Heading | None
    #: The distance in meters to the end of the lane.
    left: float
    speed: float
    #: The cell, if it is on the map.
    cell: tuple[int, int] | None
    #: The lane that its front has entered while its rear is still in the intersection behind.
    entering: int | None = None


def place(recording: Recording, grid: Streets, thresholds: Thresholds | None = None) -> Placement:
    """Place the tracks of a recording on a map.

    A car on a street drives on the lane of its direction, wherever it is across. It is on the line of an intersection
    if it stands there as the first of its lane, or drives across in this tick.
    """
    chosen = thresholds or Thresholds()
    found = Placement()
    states: list[list[_State]] = [_states(track, grid, recording.tick, chosen) for track in recording.tracks]
    # The car nearest to the line, by tick and lane.
    first: dict[tuple[int, int], float] = {}
    for track, along in zip(recording.tracks, states, strict=True):
        for tick, state in enumerate(along, track.first):
            if track.kind == "Car" and state.lane is not None:
                key = (tick, state.lane)
                first[key] = min(first.get(key, math.inf), state.left)
    names = _names(recording.tracks)
    for track, name, along in zip(recording.tracks, names, states, strict=True):
        _moments(track, name, along, grid, chosen, first, recording.tick, found)
    found.moments = dict(sorted(found.moments.items()))
    return found


def _heading(angle: float) -> Heading:
    return _AROUND[round(angle / (math.pi / 2)) % 4]


def _states(track: Track, grid: Streets, tick: float, thresholds: Thresholds) -> list[_State]:
    is_car = track.kind == "Car"
    ahead = 0.0 if thresholds.front or not is_car else thresholds.length / 2
    states: list[_State] = []
    heading: Heading | None = None
    direction = 0.0
    for at in range(len(track)):
        x, y = track.x[at], track.y[at]
        angle, speed = track.angle[at], track.speed[at]
        one, other = (at, at + 1) if at + 1 < len(track) else (max(at - 1, 0), at)
        dx, dy = track.x[other] - track.x[one], track.y[other] - track.y[one]
        moved = math.hypot(dx, dy) / tick
        if math.isnan(angle) and moved > 0.3:
            angle = math.atan2(dy, dx)
        if not math.isnan(angle):
            heading, direction = _heading(angle if grid.y_up else -angle), angle
        front = grid.point(x + ahead * math.cos(direction), y + ahead * math.sin(direction))
        state = _State(None, heading, 0.0, moved if math.isnan(speed) else speed, grid.cell_of(*front))
        if is_car and heading is not None:
            behind = ahead - thresholds.length
            rear = grid.point(x + behind * math.cos(direction), y + behind * math.sin(direction))
            _find_lane(state, grid, direction if grid.y_up else -direction, front, rear, thresholds.length)
        states.append(state)
    return states


def _find_lane(
    state: _State,
    grid: Streets,
    angle: float,
    front: tuple[float, float],
    rear: tuple[float, float],
    length: float,
) -> None:
    """Find the lane of a car, or its cell in an intersection, which follows its rear."""
    found = grid.find(angle, *front)
    if found is not None:
        lane = grid.lanes[found[0]]
        # The rear of a car may never be on a lane that is shorter than it.
        if (lane.length - found[1]) * grid.cell >= min(length, lane.length * grid.cell / 2):
            state.lane, state.left = found[0], found[1] * grid.cell
            state.heading = lane.heading_at(found[1])
            return
        # The rear is still behind the lane.
        state.entering = found[0]
        state.cell = grid.before(found[0], rear)
        return
    behind = grid.find(angle, *rear)
    if behind is not None:
        # The rear has not entered the intersection yet.
        state.cell = grid.beyond(behind[0], front)
    else:
        state.cell = grid.inside(rear) or state.cell


def _names(tracks: list[Track]) -> list[str]:
    """Return the names of tracks in scenes: their ids, with a number where an id comes again."""
    taken: dict[str, int] = {}
    names = []
    for track in tracks:
        id = track.id or "unnamed"
        count = taken[id] = taken.get(id, 0) + 1
        names.append(id if count == 1 else f"{id}#{count}")
    return names


def _exits(along: list[_State], grid: Streets) -> list[Heading | None]:
    """Return for each state the heading of the next lane that is not the present one."""
    exits: list[Heading | None] = []
    lane: int | None = None
    ahead: Heading | None = None
    # From the last state back: `lane` is the lane of the nearest later state on one, `ahead` the exit before it.
    for state in reversed(along):
        entered = state.lane if state.entering is None else state.entering
        if entered is not None and entered != lane:
            if lane is not None:
                ahead = grid.lanes[lane].entered
            lane = entered
        exits.append(ahead if state.lane is not None else None if lane is None else grid.lanes[lane].entered)
    exits.reverse()
    return exits


def _moments(
    track: Track,
    name: str,
    along: list[_State],
    grid: Streets,
    thresholds: Thresholds,
    first: dict[tuple[int, int], float],
    tick_length: float,
    found: Placement,
) -> None:
    exits = _exits(along, grid)
    waited, moved, before = 0, 0, None
    has_started = False
    for at, state in enumerate(along):
        tick = track.first + at
        cell = state.cell
        speed = None
        if at + 1 < len(along):
            dx, dy = track.x[at + 1] - track.x[at], track.y[at + 1] - track.y[at]
            speed = math.hypot(dx, dy) / tick_length
        is_decision = False
        lane = None if state.lane is None else grid.lanes[state.lane]
        if lane is None or before is None or before.lane != state.lane:
            has_started = False
        if lane is not None and cell is not None:
            cell, is_decision, has_started = _on_lane(
                lane,
                state,
                along[at + 1] if at + 1 < len(along) else None,
                grid,
                thresholds,
                first[tick, state.lane] == state.left if state.lane is not None else False,
                speed,
                has_started,
            )
        if before is not None:
            driven = math.hypot(track.x[at] - track.x[at - 1], track.y[at] - track.y[at - 1])
            moved = round(driven / grid.cell)
            # Drivers of SUMO brake to just below its threshold, and positions are rounded.
            halts = driven <= thresholds.halt * tick_length + _CENTIMETER / 2
            waits_on = waited > 0 and driven < thresholds.stop * tick_length
            waited = waited + 1 if halts or waits_on else 0
        if cell is None:
            found.outside += 1
        else:
            action = None if speed is None else thresholds.action(speed)
            moment = Moment(
                name,
                track.kind,
                cell,
                state.heading,
                exits[at],
                waited,
                moved,
                action,
                is_decision and action is not None,
            )
            found.moments.setdefault(tick, []).append(moment)
        before = state


def _on_lane(
    lane: Lane | Road,
    state: _State,
    following: _State | None,
    grid: Streets,
    thresholds: Thresholds,
    is_first: bool,
    speed: float | None,
    has_started: bool,
) -> tuple[tuple[int, int], bool, bool]:
    """Return the cell of a car on a lane, whether it decides at the line, and whether it has started from there."""
    left = state.left / grid.cell
    if not lane.has_line:
        return lane.cell(left), False, False
    crosses = following is not None and following.lane != state.lane
    stands = speed is not None and speed < thresholds.stop
    near = is_first and state.left <= thresholds.line
    if has_started:
        # It has decided, and is about to enter.
        return lane.cell(0), False, True
    if stands and near:
        return lane.cell(0), True, False
    if near and not crosses and state.speed < thresholds.stop:
        # It stood, and starts.
        return lane.cell(0), True, True
    if crosses and is_first:
        return lane.cell(0), True, False
    # Only cars on the line are on its last cell.
    return lane.cell(left, least=1), False, False
