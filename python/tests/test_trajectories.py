"""Readers of trajectories, and recorded traffic on the map of a city."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import pytest

from logicity.placement import Grid, Moment, Thresholds, place
from logicity.trajectories import Columns, read_columns, read_trajectories

FCD = """<?xml version="1.0"?>
<fcd-export>
    <timestep time="0.00">
        <vehicle id="a" x="0.00" y="10.00" angle="90.00" speed="2.00" type="car"/>
    </timestep>
    <timestep time="0.50">
        <vehicle id="a" x="1.00" y="10.00" angle="90.00" speed="4.00" type="car"/>
        <vehicle id="tram" x="5.00" y="5.00" angle="0.00" speed="1.00" type="rail"/>
        <person id="p" x="3.00" y="4.00" angle="180.00" speed="1.00"/>
    </timestep>
    <timestep time="1.50">
        <vehicle id="a" x="4.00" y="10.00" angle="0.00" speed="4.00" type="car"/>
    </timestep>
    <timestep time="9.00">
        <vehicle id="a" x="50.00" y="10.00" angle="0.00" speed="4.00" type="car"/>
    </timestep>
</fcd-export>
"""


def written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_fcd_output_is_resampled_to_ticks(tmp_path: Path) -> None:
    columns = Columns(kinds={"rail": None})
    recording = read_trajectories([written(tmp_path / "a.xml", FCD)], columns, tick=0.5)
    assert (recording.samples, recording.left_out, recording.tick) == (5, 1, 0.5)
    first, person, later = recording.tracks
    # The state after a step is that at the beginning of the next one.
    assert (first.id, first.kind, first.first, len(first)) == ("a", "Car", 1, 4)
    # The sample at 1.0 s is between those at 0.5 s and 1.5 s.
    assert first.x == [0.0, 1.0, 2.5, 4.0] and first.speed == [2.0, 4.0, 4.0, 4.0]
    assert first.angle == pytest.approx([0, 0, math.pi / 2, math.pi / 2])
    assert (person.id, person.kind) == ("p", "Pedestrian") and person.angle == pytest.approx([-math.pi / 2])
    # After a gap of several seconds it is another track.
    assert (later.id, later.first, len(later)) == ("a", 19, 1)


def test_compressed_files_and_parts_of_the_time(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "a.xml.gz", "wt") as file:
        file.write(FCD)
    (track,) = read_trajectories([str(tmp_path / "a.xml.gz")], tick=0.5, begin=0.6, end=2).tracks
    assert (track.id, track.first, track.x) == ("a", 4, [4.0])


def test_damaged_compressed_files_are_errors(tmp_path: Path) -> None:
    text = "t,id,x,y\n" + "".join(f"{t},a,{t},0\n" for t in range(4000))
    whole = gzip.compress(text.encode())
    for name, content in {"cut.csv.gz": whole[: len(whole) // 2], "plain.csv.gz": text.encode()}.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=rf"{name}:\d+: damaged: ") as caught:
            read_trajectories([str(tmp_path / name)])
        assert "is the file complete?" in str(caught.value)


def test_unknown_classes_are_counted(tmp_path: Path) -> None:
    text = "t,id,kind,x,y\n0,a,Car,0,0\n0,b,Spaceship,5,0\n1,b,Spaceship,6,0\n0,c,bus,9,0\n"
    columns = Columns(kinds={"bus": "Car"})
    recording = read_trajectories([written(tmp_path / "a.csv", text)], columns)
    assert recording.assumed == {"Spaceship": 2} and [track.kind for track in recording.tracks] == ["Car"] * 3


def test_a_vehicle_may_have_the_id_of_a_person(tmp_path: Path) -> None:
    attributes = 'id="0" x="{t}" y="0" angle="90" speed="1"'
    steps = (
        f'<timestep time="{t}"><vehicle {attributes.format(t=t)}/><person {attributes.format(t=t + 50)}/></timestep>'
        for t in range(3)
    )
    (tmp_path / "both.xml").write_text(f"<fcd-export>{''.join(steps)}</fcd-export>")
    one, other = read_trajectories([str(tmp_path / "both.xml")]).tracks
    assert (one.kind, other.kind) == ("Car", "Pedestrian")
    assert one.id == other.id == "0" and len(one) == len(other) == 3 and other.x[0] > one.x[-1]


MAPPING = """
columns:
  {frame: frame, id: trackId, kind: class, x: xCenter, y: yCenter, heading: heading, vx: xVelocity, vy: yVelocity}
frame_rate: 25
delimiter: ";"
kinds: {truck_bus: Car, pedestrian: Pedestrian, bicycle: ~}
units: {length: ft, speed: ft/s, angle: deg}
heading: {zero: east, turn: counterclockwise}
place: {cell: 2.5, origin: [10, -20], y: up}
"""


def test_columns_units_and_classes_follow_the_mapping(tmp_path: Path) -> None:
    columns, where = read_columns(written(tmp_path / "drone.yaml", MAPPING))
    assert where == {"cell": 2.5, "origin": [10, -20], "y": "up"}
    table = (
        "trackId;frame;class;xCenter;yCenter;heading;xVelocity;yVelocity;lane\n"
        "7;0;truck_bus;10;20;90;0;10;1\n"
        "7;25;truck_bus;10;30;90;0;10;1\n"
        "8;25;bicycle;1;1;0;1;1;1\n"
        "9;25;pedestrian;1;1;180;0;0;1\n"
    )
    recording = read_trajectories([written(tmp_path / "drone.csv", table)], columns)
    car, person = recording.tracks
    assert (car.kind, car.first, person.kind, recording.left_out) == ("Car", 0, "Pedestrian", 1)
    assert car.y == pytest.approx([20 * 0.3048, 30 * 0.3048]) and car.speed == pytest.approx([3.048, 3.048])
    assert car.angle == pytest.approx([math.pi / 2] * 2) and person.angle == pytest.approx([math.pi])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.xml", "<net/>", "the root is <net>, not <fcd-export>"),
        ("a.xml", FCD[:300], "not XML"),
        ("a.xml", FCD.replace('x="1.00"', 'x="one"'), "a.xml:7: column `x`: expected a number, found `one`"),
        ("a.xml", FCD.replace(' speed="2.00"', ""), "a.xml:4: column `speed`: a <vehicle> without it"),
        ("a.xml", FCD.replace('"0.50"', '"0.00"'), "a.xml:7: column `time`: `a` has the time 0 s after 0 s"),
        ("a.xml", "", "not XML"),
        ("a.csv", "", "the file is empty"),
        ("a.csv", "t,id,x\n", "a.csv:1: column `y`: the header has no such column; it has t, id, x"),
        ("a.csv", "id,x,y\n", "a.csv:1: column `t`: the header has no such column"),
        ("a.csv", "t,id,x,y\n0,a,1,2\n1,a,1\n", "a.csv:3: 3 values, but the header has 4 columns"),
        ("a.csv", "t,id,x,y\n0,a,1,nan\n", "a.csv:2: column `y`: expected a number, found `nan`"),
        ("a.csv", "t,id,x,y\n1,a,1,2\n0,a,1,2\n", "a.csv:3: column `t`: `a` has the time 0 s after 1 s"),
        ("a.csv", 't,id,x,y\n0,"a,1,2\n', "not CSV"),
    ],
)
def test_errors_name_file_line_and_column(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = written(tmp_path / name, text)
    with pytest.raises(ValueError) as caught:
        read_trajectories([path])
    assert message in str(caught.value) and str(caught.value).startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("columns: {frame: f}", "a column of frames needs `frame_rate`"),
        ("colums: {}", "unknown key `colums`; did you mean `columns`?"),
        ("units: {speed: knots}", "expected one of m/s, km/h, mph, ft/s"),
        ("kinds: {van: Truck}", "expected one of Car, Pedestrian"),
        ("place: {origin: 3}", "expected [x, y]"),
        ("frame_rate: 0", "expected a positive number"),
    ],
)
def test_errors_of_a_mapping_name_their_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        read_columns(written(tmp_path / "m.yaml", text))
    assert message in str(caught.value) and "m.yaml:1:" in str(caught.value)


#: Streets of 5 cells, blocks of 27 cells.
MAP = """
blocks: [2, 2]
widths: {street: 5, sidewalk: 1, building: 12, inner_sidewalk: 1}
buildings: {rows: [HSHS, HSHS, HSHS, HSHS]}
zones: {main: [{horizontal_street: 2}]}
"""


@pytest.fixture
def grid(tmp_path: Path) -> Grid:
    return Grid.load(written(tmp_path / "map.yaml", MAP), 3.0)


def test_the_lanes_of_a_map(grid: Grid) -> None:
    assert (grid.rows, grid.columns, grid.blocks, grid.lane_offset) == (69, 69, (2, 2), 1)
    assert len(grid.lanes) == 24
    lane = next(each for each in grid.lanes if (each.heading, each.street, each.block) == ("Right", 1, 0))
    assert (lane.start, lane.end, lane.zones, lane.has_line) == ((35, 5), (35, 31), ("main",), True)
    edge = next(each for each in grid.lanes if each.heading == "Right" and each.street == 0)
    assert not edge.has_line and edge.zones == ()
    row, column = grid.point(*grid.position(12.5, 7.25))
    assert (row, column) == pytest.approx((12.5, 7.25))


def driven(tmp_path: Path, grid: Grid, cells: list[tuple[float, float]]) -> list[Moment]:
    """Return the moments of a car with its front at these places, in rows and columns, one every second."""
    lines = ["t,id,x,y"]
    for t, (row, column) in enumerate(cells):
        x, y = grid.position(row, column)
        lines.append(f"{t},a,{x},{y}")
    recording = read_trajectories([written(tmp_path / "car.csv", "\n".join(lines) + "\n")])
    placed = place(recording, grid, Thresholds())
    return [moment for moments in placed.moments.values() for moment in moments]


def test_a_car_stops_at_the_line_and_turns_left(tmp_path: Path, grid: Grid) -> None:
    # It comes from the left, stands a meter before the end of its lane, and leaves up.
    along = [(35.5, column) for column in (20.0, 24.0, 28.0, 31.6, 31.6, 31.6, 33.5)]
    moments = driven(tmp_path, grid, [*along, (34.0, 35.5), (31.0, 35.5), (26.5, 35.5), (20.0, 35.5)])
    assert [moment.action for moment in moments] == ["Normal"] * 3 + ["Stop"] * 2 + ["Normal"] * 5 + [None]
    assert [moment.is_decision for moment in moments] == [False] * 3 + [True] * 3 + [False] * 5
    # On the line while it stands, and inside until its rear has left the intersection.
    assert [moment.at for moment in moments[3:6]] == [(35, 31)] * 3
    assert all(32 <= cell <= 36 for moment in moments[6:9] for cell in moment.at)
    assert moments[8].at == (32, 35) and moments[9].at == (26, 35)
    assert [moment.exit for moment in moments[:7]] == ["Up"] * 7 and moments[-1].exit is None
    assert [moment.heading for moment in moments[:6]] == ["Right"] * 6 and moments[-1].heading == "Up"
    assert [moment.waited for moment in moments[3:7]] == [0, 1, 2, 0]


def test_a_car_in_a_queue_is_not_on_the_line(tmp_path: Path, grid: Grid) -> None:
    lines = ["t,id,x,y"]
    for t in range(3):
        for id, column in (("first", 31.5), ("second", 29.2)):
            x, y = grid.position(35.5, column)
            lines.append(f"{t},{id},{x},{y}")
    recording = read_trajectories([written(tmp_path / "queue.csv", "\n".join(lines) + "\n")])
    placed = place(recording, grid)
    last = {moment.id: moment for moment in placed.moments[0]}
    # Without a movement the file shows no direction, so neither car is on a lane.
    assert [moment.heading for moment in last.values()] == [None, None]
    text = "\n".join(line + (",heading" if line.startswith("t") else ",90") for line in lines) + "\n"
    placed = place(read_trajectories([written(tmp_path / "queue.csv", text)]), grid)
    last = {moment.id: moment for moment in placed.moments[0]}
    assert (last["first"].at, last["first"].is_decision) == ((35, 31), True)
    assert (last["second"].at, last["second"].is_decision) == ((35, 29), False)


def test_agents_off_the_map_are_counted(tmp_path: Path, grid: Grid) -> None:
    text = "t,id,x,y,heading\n0,a,-50,-50,90\n1,a,-50,-50,90\n"
    placed = place(read_trajectories([written(tmp_path / "off.csv", text)]), grid)
    assert (placed.outside, placed.moments) == (2, {})
