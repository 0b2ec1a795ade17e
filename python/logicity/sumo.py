"""Maps of cities as networks of SUMO: those of blocks in its plain XML, which `netconvert` reads."""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, TypeAlias, get_args
from xml.sax.saxutils import quoteattr

from . import _logicity
from .files import check_writable, write_text
from .placement import STEPS, Grid, Lane
from .types import Heading

__all__ = ["CYCLE", "Junctions", "export_network", "export_roads", "find_program", "netconvert_options", "network"]

#: The right of way at the intersections of a road network.
Junctions: TypeAlias = Literal["right_before_left", "priority", "allway_stop", "traffic_light"]

#: The phases of traffic lights, which all intersections share: seconds, and the lights of horizontal and of vertical
#: streets. `rules/traffic-lights.dl` has the same cycle.
CYCLE: tuple[tuple[int, str, str], ...] = (
    *((23, "g", "r"), (4, "y", "r"), (3, "r", "r")),
    *((23, "r", "g"), (4, "r", "y"), (3, "r", "r")),
)


def network(grid: Grid, junctions: Junctions, *, speed: float = 30.0, main: str | None = None) -> dict[str, str]:
    """Return the files of a road network by their endings, such as `.nod.xml`.

    Cars keep right, as in the city. The ends of lanes lie on the lines where cars of the city wait. An edge has the
    name of its lane: heading, street and block, such as `right2/0`.

    Args:
        grid: The map, with the side of a cell and the origin.
        junctions: The right of way at intersections.
        speed: The speed limit in km/h.
        main: For `"priority"`: the zone of the map whose streets have right of way.

    Raises:
        ValueError: If `junctions` is unknown, `"priority"` has no zone, or the map has no such zone.
    """
    if junctions not in get_args(Junctions):
        raise ValueError(f"junctions must be one of {', '.join(get_args(Junctions))}, not {junctions!r}")
    if junctions == "priority" and main is None:
        raise ValueError("priority needs a zone of main streets: `--main ZONE`, such as a zone of `horizontal_street`s")
    zones = {zone for lane in grid.lanes for zone in lane.zones}
    if main is not None and main not in zones:
        has = f"it has {', '.join(sorted(zones))}" if zones else "it has none with a street"
        raise ValueError(f"the map has no street in a zone `{main}`; {has}")
    files = {
        ".nod.xml": _document("nodes", _nodes(grid, junctions)),
        ".edg.xml": _document("edges", _edges(grid, speed, main)),
        ".con.xml": _document("connections", (_element("connection", _link(*way)) for way in _ways(grid))),
    }
    if junctions == "traffic_light":
        files[".tll.xml"] = _document("tlLogics", _lights(grid))
    return files


def export_network(
    grid: Grid,
    out: str | os.PathLike[str],
    junctions: Junctions,
    *,
    speed: float = 30.0,
    main: str | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write a road network: `NAME.nod.xml` and others beside `out`, and with `netconvert` also `out`.

    Args:
        grid: The map, with the side of a cell and the origin.
        out: The name of the network, which ends in `.net.xml`.
        junctions: The right of way at intersections.
        speed: The speed limit in km/h.
        main: As for `network`.
        overwrite: Whether to replace files that this function did not write.

    Returns:
        The paths of the files written. The network is the last of them if `netconvert` is installed, for example by the
        extra `sumo`.

    Raises:
        OSError: If a file cannot be written, or `netconvert` fails.
        ValueError: As for `network`, or if the name is another.
    """
    name = os.fspath(out)
    if not name.endswith(".net.xml"):
        raise ValueError(f"expected a name that ends in .net.xml, not `{name}`")
    stem = name.removesuffix(".net.xml")
    files = network(grid, junctions, speed=speed, main=main)
    paths = [Path(stem + ending) for ending in files]
    for path in [*paths, Path(name)]:
        check_writable(path, by="map export", overwrite=overwrite)
    for path, text in zip(paths, files.values(), strict=True):
        write_text(path, text, by="map export", overwrite=overwrite)
    program = find_program("netconvert")
    if program is None:
        return paths
    made = Path(stem + ".unfinished.net.xml")
    try:
        command = [program, *netconvert_options(stem, files), "-o", str(made)]
        # Another program may print in another encoding.
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
        if done.returncode != 0:
            raise OSError(f"netconvert failed: {(done.stderr or done.stdout).strip()[:500]}")
        write_text(name, made.read_text(encoding="utf-8"), by="map export", overwrite=overwrite)
    finally:
        made.unlink(missing_ok=True)
    return [*paths, Path(name)]


def export_roads(map: str | os.PathLike[str], out: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write the road network of a map as a network of SUMO, which needs no `netconvert`.

    Positions are those from which the map was imported. Crossings and sidewalks are written without connections between
    them, so SUMO shows pedestrians but does not route them.

    Args:
        map: A map file or a configuration whose map is a road network.
        out: The name of the network, which ends in `.net.xml`.
        overwrite: Whether to replace a file that this function did not write.

    Raises:
        InputError: If the map is invalid.
        OSError: If a file cannot be read or written.
        ValueError: If the map is one of blocks.
    """
    text = _logicity.network_file(os.fspath(map))
    if text is None:
        raise ValueError(f"{os.fspath(map)}: the map is one of blocks; `export_network` writes it")
    write_text(out, text, by="map export", overwrite=overwrite)


def netconvert_options(stem: str, files: dict[str, str]) -> list[str]:
    """Return the options of `netconvert` for the files of a network with this name."""
    kinds = {
        ".nod.xml": "--node-files",
        ".edg.xml": "--edge-files",
        ".con.xml": "--connection-files",
        ".tll.xml": "--tllogic-files",
    }
    names = [part for ending in files for part in (kinds[ending], stem + ending)]
    # Positions in the network are those of the map.
    return [*names, "--offset.disable-normalization"]


def find_program(name: str) -> str | None:
    """Return the path of a program of SUMO: on the search path, or beside the Python that runs."""
    return shutil.which(name) or shutil.which(name, path=sysconfig.get_path("scripts"))


def _document(root: str, lines: Iterator[str]) -> str:
    return "\n".join([f"<{root}>", *(f"    {line}" for line in lines), f"</{root}>", ""])


def _element(name: str, attributes: dict[str, object]) -> str:
    return f"<{name} {' '.join(f'{key}={quoteattr(str(value))}' for key, value in attributes.items())}/>"


def _crossing(lane: Lane, of_end: bool) -> tuple[int, int]:
    """Return the numbers of the streets that meet at an end of a lane: horizontal, vertical."""
    rows, columns = STEPS[lane.heading]
    # Forward along the axis, the end is that of the street after the block.
    forward = rows + columns > 0
    along = lane.block + int(of_end == forward)
    return (lane.street, along) if rows == 0 else (along, lane.street)


def _node(crossing: tuple[int, int]) -> str:
    return f"{crossing[0]}/{crossing[1]}"


def _edge(lane: Lane) -> str:
    return f"{lane.heading.lower()}{lane.street}/{lane.block}"


def _middles(grid: Grid) -> tuple[dict[int, float], dict[int, float]]:
    """Return the middles of horizontal streets, in rows, and of vertical ones, in columns."""
    horizontal: dict[int, float] = {}
    vertical: dict[int, float] = {}
    for lane in grid.lanes:
        row, column = lane.start
        if lane.heading == "Right":
            horizontal[lane.street] = row - grid.lane_offset + 0.5
        elif lane.heading == "Up":
            vertical[lane.street] = column - grid.lane_offset + 0.5
    return horizontal, vertical


def _nodes(grid: Grid, junctions: Junctions) -> Iterator[str]:
    horizontal, vertical = _middles(grid)
    corners = {(row, column) for row in (0, grid.blocks[0]) for column in (0, grid.blocks[1])}
    for row, across in horizontal.items():
        for column, down in vertical.items():
            x, y = grid.position(across, down)
            kind = "priority" if (row, column) in corners else junctions
            yield _element("node", {"id": _node((row, column)), "x": f"{x:.2f}", "y": f"{y:.2f}", "type": kind})


def _edges(grid: Grid, speed: float, main: str | None) -> Iterator[str]:
    horizontal, vertical = _middles(grid)
    # Lanes beside the mid line have their centers on the lanes of the map.
    width = 2 * grid.lane_offset * grid.cell
    for lane in grid.lanes:
        shape = []
        for row, column in (lane.start, lane.end):
            at = (
                (horizontal[lane.street], column + 0.5)
                if lane.heading in ("Left", "Right")
                else (row + 0.5, vertical[lane.street])
            )
            x, y = grid.position(*at)
            shape.append(f"{x:.2f},{y:.2f}")
        yield _element(
            "edge",
            {
                "id": _edge(lane),
                "from": _node(_crossing(lane, False)),
                "to": _node(_crossing(lane, True)),
                "numLanes": 1,
                "speed": f"{speed / 3.6:.2f}",
                "width": f"{width:.2f}",
                "priority": 2 if main is not None and main in lane.zones else 1,
                "spreadType": "right",
                "shape": " ".join(shape),
            },
        )


def _ways(grid: Grid) -> Iterator[tuple[Lane, Lane]]:
    """Return the pairs of lanes that intersections connect. No car turns back."""
    starting: dict[tuple[int, int], list[Lane]] = {}
    for lane in grid.lanes:
        starting.setdefault(_crossing(lane, False), []).append(lane)
    for lane in grid.lanes:
        for next in starting[_crossing(lane, True)]:
            if next.heading != _opposite(lane.heading):
                yield lane, next


def _link(come: Lane, go: Lane) -> dict[str, object]:
    return {"from": _edge(come), "to": _edge(go), "fromLane": 0, "toLane": 0}


def _lights(grid: Grid) -> Iterator[str]:
    corners = {(row, column) for row in (0, grid.blocks[0]) for column in (0, grid.blocks[1])}
    ways: dict[tuple[int, int], list[tuple[Lane, Lane]]] = {}
    for come, go in _ways(grid):
        if (crossing := _crossing(come, True)) not in corners:
            ways.setdefault(crossing, []).append((come, go))
    for crossing, links in ways.items():
        # From the state that it writes for a time, SUMO moves cars one step later.
        yield f'<tlLogic id={quoteattr(_node(crossing))} type="static" programID="0" offset="1">'
        for seconds, across, down in CYCLE:
            state = ""
            for come, go in links:
                light = across if come.heading in ("Left", "Right") else down
                # Green with priority, but to the left only after oncoming cars.
                state += "G" if light == "g" and go.heading != _left(come.heading) else light
            yield f"    {_element('phase', {'duration': seconds, 'state': state})}"
        yield "</tlLogic>"
    for crossing, links in ways.items():
        for index, way in enumerate(links):
            yield _element("connection", {**_link(*way), "tl": _node(crossing), "linkIndex": index})


def _left(heading: Heading) -> Heading:
    turned: dict[Heading, Heading] = {"Up": "Left", "Left": "Down", "Down": "Right", "Right": "Up"}
    return turned[heading]


def _opposite(heading: Heading) -> Heading:
    return _left(_left(heading))
