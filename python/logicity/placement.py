"""Recorded traffic on the map of a city: the cells, headings, exits and decisions of agents in every tick."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from dataclasses import dataclass, field

from . import _logicity
from .trajectories import Recording, Track
from .types import Heading

__all__ = ["Grid", "Lane", "Moment", "Placement", "Thresholds", "place"]

#: The directions of headings, in steps of rows and columns.
STEPS: dict[Heading, tuple[int, int]] = {"Left": (0, -1), "Right": (0, 1), "Up": (-1, 0), "Down": (1, 0)}

#: Headings counterclockwise from east.
_AROUND: tuple[Heading, ...] = ("Right", "Up", "Left", "Down")


@dataclass(frozen=True)
class Lane:
    """A lane of a map.

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


@dataclass(frozen=True)
class Grid:
    """A map of a city in the plane of a recording.

    Attributes:
        name: The name of the map.
        rows, columns: The numbers of rows and columns of cells.
        blocks: The numbers of rows and columns of blocks.
        lane_offset: The number of cells from a lane to the mid line of its street.
        lanes: All lanes.
        cell: The side of a cell in meters.
        origin: The position of the upper left corner of the map in meters.
        y_up: Whether y grows toward the top of the map, as on road maps, or toward its bottom, as in pictures.
    """

    name: str
    rows: int
    columns: int
    blocks: tuple[int, int]
    lane_offset: int
    lanes: tuple[Lane, ...]
    cell: float
    origin: tuple[float, float] = (0.0, 0.0)
    y_up: bool = True

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
        """
        file = os.fspath(path)
        if not os.path.exists(file) and os.path.basename(file) == file and "." not in file:
            with suppress(FileNotFoundError):
                _logicity.read_file(map_file := f"configs/maps/{file}.yaml")
                file = map_file
        name, (rows, columns), blocks, offset, lanes = _logicity.lanes(file)
        last = {"Left": blocks[0], "Right": blocks[0], "Up": blocks[1], "Down": blocks[1]}

        def made(lane: tuple[Heading, int, int, tuple[int, int], tuple[int, int], list[str]]) -> Lane:
            heading, street, block, start, end, zones = lane
            return Lane(heading, street, block, start, end, tuple(zones), 0 < street < last[heading])

        return cls(name, rows, columns, (blocks[0], blocks[1]), offset, tuple(map(made, lanes)), cell, origin, y_up)

    def position(self, row: float, column: float) -> tuple[float, float]:
        """Return the position in meters of a point on the map; a cell has its number as its first edge."""
        down = row * self.cell
        return self.origin[0] + column * self.cell, self.origin[1] + (-down if self.y_up else down)

    def point(self, x: float, y: float) -> tuple[float, float]:
        """Return the row and the column of a position in meters: the converse of `position`."""
        down = (self.origin[1] - y) if self.y_up else (y - self.origin[1])
        return down / self.cell, (x - self.origin[0]) / self.cell


@dataclass(frozen=True)
class Thresholds:
    """The rates from which actions follow, and what belongs to a line.

    Attributes:
        stop: An agent whose mean speed during a tick is less, in m/s, takes the action Stop.
        slow: A moving one whose mean speed is less takes Slow; `None` for no such action.
        fast: One whose mean speed is greater takes Fast; `None` for no such action.
        line: A car whose front stands at most this many meters before the end of its lane, with no other before it,
            is on the line. A standing one farther back is in a queue.
        length: The length of a car in meters. It is in an intersection until its rear has left it.
        front: Whether positions are those of fronts, as SUMO writes them; otherwise they are those of centers.
    """

    stop: float = 0.5
    slow: float | None = None
    fast: float | None = None
    line: float = 6.0
    length: float = 5.0
    front: bool = True

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


def place(recording: Recording, grid: Grid, thresholds: Thresholds | None = None) -> Placement:
    """Place the tracks of a recording on a map.

    A car on a street drives on the lane of its direction, wherever it is across. It is on the line of an intersection
    if it stands there as the first of its lane, or drives across in this tick.
    """
    chosen = thresholds or Thresholds()
    found = Placement()
    index = _LaneIndex(grid)
    states: list[list[_State]] = [_states(track, grid, index, recording.tick, chosen) for track in recording.tracks]
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


class _LaneIndex:
    """The lanes by heading and street."""

    def __init__(self, grid: Grid) -> None:
        self.across: dict[Heading, dict[int, list[int]]] = {heading: {} for heading in STEPS}
        for number, lane in enumerate(grid.lanes):
            row, column = lane.start
            key = row if lane.heading in ("Left", "Right") else column
            self.across[lane.heading].setdefault(key, []).append(number)

    def find(self, grid: Grid, heading: Heading, row: float, column: float) -> tuple[int, float] | None:
        """Return the lane of a heading at a point, and the distance to its end in cells."""
        is_flat = heading in ("Left", "Right")
        across, along = (row, column) if is_flat else (column, row)
        axis = 1 if is_flat else 0
        width = grid.lane_offset + 0.5
        for center, lanes in self.across[heading].items():
            if abs(across - (center + 0.5)) > width:
                continue
            for number in lanes:
                lane = grid.lanes[number]
                low, high = sorted((lane.start[axis], lane.end[axis]))
                if low <= along <= high + 1:
                    forward = heading in ("Right", "Down")
                    return number, (high + 1 - along) if forward else (along - low)
        return None


def _heading(angle: float) -> Heading:
    return _AROUND[round(angle / (math.pi / 2)) % 4]


def _states(track: Track, grid: Grid, index: _LaneIndex, tick: float, thresholds: Thresholds) -> list[_State]:
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
        state = _State(None, heading, 0.0, moved if math.isnan(speed) else speed, _cell(grid, *front))
        if is_car and heading is not None:
            behind = ahead - thresholds.length
            rear = grid.point(x + behind * math.cos(direction), y + behind * math.sin(direction))
            _find_lane(state, grid, index, front, rear, thresholds.length)
        states.append(state)
    return states


def _find_lane(
    state: _State,
    grid: Grid,
    index: _LaneIndex,
    front: tuple[float, float],
    rear: tuple[float, float],
    length: float,
) -> None:
    """Find the lane of a car, or its cell in an intersection, which follows its rear."""
    assert state.heading is not None
    rows, columns = STEPS[state.heading]
    found = index.find(grid, state.heading, *front)
    if found is not None:
        lane = grid.lanes[found[0]]
        cells = abs(lane.end[0] - lane.start[0]) + abs(lane.end[1] - lane.start[1]) + 1
        if cells * grid.cell - found[1] * grid.cell >= length:
            state.lane, state.left = found[0], found[1] * grid.cell
            return
        # The rear is still behind the lane.
        state.entering = found[0]
        last = (lane.start[0] - rows, lane.start[1] - columns)
        at = _cell(grid, *rear)
        if at is None or (at[0] - last[0]) * rows + (at[1] - last[1]) * columns > 0:
            at = last
        state.cell = at
        return
    behind = index.find(grid, state.heading, *rear)
    if behind is not None:
        # The rear has not entered the intersection yet.
        end = grid.lanes[behind[0]].end
        state.cell = (end[0] + rows, end[1] + columns)
    else:
        state.cell = _cell(grid, *rear) or state.cell


def _cell(grid: Grid, row: float, column: float) -> tuple[int, int] | None:
    cell = (math.floor(row), math.floor(column))
    return cell if 0 <= cell[0] < grid.rows and 0 <= cell[1] < grid.columns else None


def _names(tracks: list[Track]) -> list[str]:
    """Return the names of tracks in scenes: their ids, with a number where an id comes again."""
    taken: dict[str, int] = {}
    names = []
    for track in tracks:
        id = track.id or "unnamed"
        count = taken[id] = taken.get(id, 0) + 1
        names.append(id if count == 1 else f"{id}#{count}")
    return names


def _exits(along: list[_State], grid: Grid) -> list[Heading | None]:
    """Return for each state the heading of the next lane that is not the present one."""
    exits: list[Heading | None] = []
    lane: int | None = None
    ahead: Heading | None = None
    # From the last state back: `lane` is the lane of the nearest later state on one, `ahead` the exit before it.
    for state in reversed(along):
        entered = state.lane if state.entering is None else state.entering
        if entered is not None and entered != lane:
            if lane is not None:
                ahead = grid.lanes[lane].heading
            lane = entered
        exits.append(ahead if state.lane is not None else None if lane is None else grid.lanes[lane].heading)
    exits.reverse()
    return exits


def _moments(
    track: Track,
    name: str,
    along: list[_State],
    grid: Grid,
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
            moved = round(math.hypot(track.x[at] - track.x[at - 1], track.y[at] - track.y[at - 1]) / grid.cell)
            stood = math.hypot(track.x[at] - track.x[at - 1], track.y[at] - track.y[at - 1]) / tick_length
            waited = waited + 1 if stood < thresholds.stop else 0
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
    lane: Lane,
    state: _State,
    following: _State | None,
    grid: Grid,
    thresholds: Thresholds,
    is_first: bool,
    speed: float | None,
    has_started: bool,
) -> tuple[tuple[int, int], bool, bool]:
    """Return the cell of a car on a lane, whether it decides at the line, and whether it has started from there."""
    rows, columns = STEPS[lane.heading]
    length = abs(lane.end[0] - lane.start[0]) + abs(lane.end[1] - lane.start[1])

    def cell(back: int) -> tuple[int, int]:
        back = min(max(back, -1), length)
        return lane.end[0] - rows * back, lane.end[1] - columns * back

    back = math.ceil(state.left / grid.cell - 1e-9) - 1
    if not lane.has_line:
        return cell(back), False, False
    crosses = following is not None and following.lane != state.lane
    stands = speed is not None and speed < thresholds.stop
    near = is_first and state.left <= thresholds.line
    if has_started:
        # It has decided, and is about to enter.
        return cell(0), False, True
    if stands and near:
        return cell(0), True, False
    if near and not crosses and state.speed < thresholds.stop:
        # It stood, and starts.
        return cell(0), True, True
    if crosses and is_first:
        return cell(0), True, False
    return cell(max(back, 1)), False, False
