"""Learning from trajectories: of our own city, whose rules are known, and of SUMO."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import needs

import logicity
from logicity.distill import FILES, Settings, _inlined, distill
from logicity.placement import Grid, load_map
from logicity.sumo import export_network, find_program, network
from logicity.trajectories import read_trajectories

#: Right before left, but nobody waits for one that waits, so the city flows.
RIGHT_BEFORE_LEFT = """
.include "right-of-way.dl"

/// R1: give way to the right
Stop(X) :- IsAtInter(X), FromRight(Y, X), Not(TurnsRight(X)), Not(Waits(Y)).
"""

CITY = """
base: right-of-way
rules: rules.dl
map: own-map.yaml
agents: {test: {cars: [{priority: 1, count: 30}]}}
"""

OWN_MAP = """
blocks: [3, 3]
widths: {street: 11, sidewalk: 5, building: 10, inner_sidewalk: 5}
buildings: {random: {seed: 1, weights: {House: 1, Store: 1}}}
"""


def recorded(folder: Path, ticks: int) -> Path:
    """Write the positions of cars in a city with known rules as a table."""
    (folder / "rules.dl").write_text(RIGHT_BEFORE_LEFT, encoding="utf-8")
    (folder / "own.yaml").write_text(CITY, encoding="utf-8")
    (folder / "own-map.yaml").write_text(OWN_MAP, encoding="utf-8")
    city = logicity.Simulation(str(folder / "own.yaml"), seed=3)
    lines = ["t,id,kind,x,y,heading,speed"]
    # Angles grow clockwise from north, as in SUMO.
    angles = {0: 270, 1: 90, 2: 0, 3: 180}
    # A trip is a track: the next one has another route.
    trips = [0] * len(city.agents)
    for t in range(ticks):
        tick = city.tick()
        for number, ((row, column), heading) in enumerate(zip(tick.at, tick.heading, strict=True)):
            if heading >= 0 and not tick.replanned[number]:
                id = f"{city.agents[number].name}-{trips[number]}"
                lines.append(f"{t},{id},Car,{column + 0.5},{-row - 0.5},{angles[int(heading)]},0")
            trips[number] += int(tick.replanned[number])
    path = folder / "traffic.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


#: The options with which trajectories of our own city are read: a cell is a meter, and cars have no length.
OWN = ["--cell", "1", "--length", "0", "--line", "1", "--reaction", "0"]


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "logicity", *arguments], capture_output=True, text=True, check=False, env=os.environ
    )


def test_the_rules_of_our_own_city_are_recovered(tmp_path: Path) -> None:
    traffic = recorded(tmp_path, 600)
    out = tmp_path / "learned"
    done = command("distill", str(traffic), "--map", str(tmp_path / "own-map.yaml"), "-o", str(out), *OWN)
    assert done.returncode == 0, done.stderr
    report = json.loads((out / "report.json").read_text())
    assert report["test"]["line"]["moments"] > 100
    assert report["test"]["line"]["explained"] >= 0.98
    rules = [clause["rule"] for clause in report["clauses"]]
    # Y comes from the right of X if X comes from the left of Y.
    known = [f"{word}, Not(TurnsRight(X)), Not(Waits(Y))." for word in ("FromRight(Y, X)", "FromLeft(X, Y)")]
    assert any(rule.endswith(tuple(known)) for rule in rules), rules
    assert {path.name for path in out.iterdir() if path.name[0] != "."} <= set(FILES)
    # The city runs.
    city = logicity.Simulation(str(out / "city.yaml"))
    city.run(20)
    # The same bytes again, also over the own files, but never over those of others.
    texts = {path.name: path.read_bytes() for path in out.iterdir() if path.name in FILES}
    assert (
        command("distill", str(traffic), "--map", str(tmp_path / "own-map.yaml"), "-o", str(out), *OWN).returncode == 0
    )
    assert texts == {path.name: path.read_bytes() for path in out.iterdir() if path.name in FILES}
    (out / "report.md").write_text("mine")
    refused = command("distill", str(traffic), "--map", str(tmp_path / "own-map.yaml"), "-o", str(out), *OWN)
    assert refused.returncode == 2 and "report.md" in refused.stderr
    assert (out / "report.md").read_text() == "mine"


def test_wrong_moments_are_scenes_that_other_commands_accept(tmp_path: Path) -> None:
    traffic = recorded(tmp_path, 200)
    out = tmp_path / "learned"
    # Without the words of right of way, the rules must get some moments wrong.
    words = ["--use", "IsAtInter,TurnsLeft", "--noise", "0.2"]
    assert (
        command(
            "distill", str(traffic), "--map", str(tmp_path / "own-map.yaml"), "-o", str(out), *OWN, *words
        ).returncode
        == 0
    )
    report = json.loads((out / "report.json").read_text())
    assert report["wrong_count"] > 0 and report["wrong"][0]["driver"] != report["wrong"][0]["rules"]
    answers = command("infer", str(out / "wrong.jsonl"), "--config", str(out / "city.yaml"))
    assert answers.returncode == 0, answers.stderr
    scenes = [json.loads(line) for line in (out / "wrong.jsonl").read_text().splitlines()]
    for scene, answer in zip(scenes, map(json.loads, answers.stdout.splitlines()), strict=True):
        for id, action in scene["actions"].items():
            assert answer["egos"][id]["action"] != action


def test_words_are_about_agents_alone(tmp_path: Path) -> None:
    traffic = recorded(tmp_path, 60)
    for name, message in {
        "Clearance": "`Clearance` of `right-of-way-roads` has a value",
        "MustYeild": "did you mean `MustYield`?",
    }.items():
        settings = Settings(config="right-of-way-roads", map="roundabout", use=("IsAtInter", name))
        with pytest.raises(ValueError, match=re.escape(message)):
            distill(read_trajectories([str(traffic)]), load_map("roundabout"), tmp_path / "out", settings)


def test_a_recording_elsewhere_is_refused(tmp_path: Path) -> None:
    (tmp_path / "far.csv").write_text("t,id,x,y\n0,a,9000,9000\n1,a,9001,9000\n2,a,9002,9000\n")
    done = command("distill", str(tmp_path / "far.csv"), "--map", "square-5x5", "-o", str(tmp_path / "out"))
    assert done.returncode == 1 and "no moment to learn from" in done.stderr and "origin" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["distill", "no-such.csv", "-o", "out"], 2, "no-such.csv"),
        (["distill", "a.csv", "-o", "out", "--origin", "1"], 2, "expected X,Y in meters"),
        (["distill", "a.csv", "-o", "out", "--map", "a.net.xml"], 2, "`logicity map import a.net.xml -o town.yaml`"),
        (["distill", "a.csv", "-o", "out", "--slow", "0.2"], 2, "`slow` is 0.2, less than `stop`, which is 0.5"),
        (["distill", "a.csv", "-o", "out", "--tick", "1e-6"], 2, "expected a number from 0.01 to 3600"),
        (["distill", "a.csv", "-o", "out", "--test", "1"], 2, "expected a number between 0 and 1"),
        (["map", "export", "square-5x5", "-o", "town.xml"], 2, "expected a name that ends in .net.xml"),
        (["map", "export", "square-5x5", "-o", "t.net.xml", "--junctions", "priority"], 2, "--main ZONE"),
    ],
)
def test_options_are_checked(arguments: list[str], code: int, message: str) -> None:
    done = command(*arguments)
    assert (done.returncode, message in done.stderr) == (code, True), done.stderr


#: A town of 4 x 4 blocks of 27 cells.
TOWN = """
blocks: [4, 4]
widths: {street: 5, sidewalk: 1, building: 12, inner_sidewalk: 1}
buildings: {random: {seed: 1, weights: {House: 1, Store: 1}}}
zones: {main: [{horizontal_street: 2}, {horizontal_street: 3}, {horizontal_street: 4}]}
"""


def town(tmp_path: Path) -> Grid:
    (tmp_path / "town.yaml").write_text(TOWN)
    return Grid.load(tmp_path / "town.yaml", 3.0)


def test_networks_have_an_edge_per_lane_and_no_turning_back(tmp_path: Path) -> None:
    grid = town(tmp_path)
    files = network(grid, "priority", main="main")
    assert set(files) == {".nod.xml", ".edg.xml", ".con.xml"}
    assert files[".edg.xml"].count("<edge ") == len(grid.lanes) == 80
    assert files[".nod.xml"].count("<node ") == 25 and files[".nod.xml"].count('type="priority"') == 25
    assert files[".edg.xml"].count('priority="2"') == 3 * 4 * 2
    # Nine inner intersections of 12 ways, twelve at the edges of 6, four corners of 2.
    assert files[".con.xml"].count("<connection ") == 9 * 12 + 12 * 6 + 4 * 2
    lights = network(grid, "traffic_light")[".tll.xml"]
    assert lights.count("<tlLogic ") == 21 and lights.count("<phase ") == 21 * 6
    with pytest.raises(ValueError, match="it has main"):
        network(grid, "priority", main="mian")


def driven(tmp_path: Path, junctions: str, period: str) -> Path:
    """Return the trajectories of random trips that SUMO drives for 2 hours."""
    sumo = needs("sumo", "sumo")
    home = Path(sumo.__file__).parent
    environment = os.environ | {"SUMO_HOME": str(home)}
    net, trips, routes, traffic = (tmp_path / f"town.{end}" for end in ("net.xml", "trips.xml", "rou.xml", "fcd.xml"))
    main = "main" if junctions == "priority" else None
    assert export_network(town(tmp_path), net, junctions, main=main)[-1] == net  # type: ignore[arg-type]
    script = [sys.executable, str(home / "tools" / "randomTrips.py")]
    programs = {name: str(find_program(name)) for name in ("duarouter", "sumo")}
    for line in (
        [*script, "-n", net, "-o", trips, "-e", "7200", "-p", period, "--seed", "5", "--min-distance", "150"],
        [programs["duarouter"], "-n", net, "--route-files", trips, "-o", routes, "--ignore-errors", "--seed", "5"],
        [programs["sumo"], "-n", net, "-r", routes, "--fcd-output", traffic, "--seed", "5", "--end", "7200"],
    ):
        subprocess.run([str(part) for part in line], check=True, capture_output=True, env=environment, cwd=tmp_path)
    return traffic


def test_included_rules_keep_their_lines(tmp_path: Path) -> None:
    inner = "// not\u2028a rule\u0085\n.decl A(x: agent)\n"
    (tmp_path / "inner.dl").write_text(inner, encoding="utf-8")
    (tmp_path / "outer.dl").write_text('.include "right-of-way.dl"\n.include "inner.dl"\n\nA(X) :- B(X).\n')
    assert _inlined(tmp_path / "outer.dl", set()).split("\n") == [
        '.include "right-of-way.dl"',
        *inner.split("\n"),
        "",
        "A(X) :- B(X).",
        "",
    ]


#: Words for main streets, a zone of the map.
STREETS = {
    "streets.yaml": """
base: right-of-way
rules: streets.dl
predicates:
  use: [IsPedestrian, IsCar, IsAtInter, IsInInter, LeftOf, RightOf, SameInter, IsNear, Heading, Exit, Waited, OnMain]
  define:
    OnMain: {zone: main}
map: town.yaml
""",
    "streets.dl": """
.include "right-of-way.dl"
.decl OnMain(x: agent)
.input OnMain
""",
}

#: Words for the lights of `map export`.
LIGHTS = {
    "lights.yaml": """
base: right-of-way
rules: lights.dl
predicates:
  use: [IsPedestrian, IsCar, IsAtInter, IsInInter, LeftOf, RightOf, SameInter, IsNear, Heading, Exit, Waited, Tick]
  define:
    Tick: {quantity: tick}
map: town.yaml
""",
    "lights.dl": """
.include "right-of-way.dl"
.decl Tick(t: number)
.input Tick
.scope

/// The light of x is red or yellow.
.decl IsRed(x: agent)
IsRed(X) :- Heading(X, "Up"), Tick(t), t % 60 < 30.
IsRed(X) :- Heading(X, "Up"), Tick(t), t % 60 >= 53.
IsRed(X) :- Heading(X, "Down"), Tick(t), t % 60 < 30.
IsRed(X) :- Heading(X, "Down"), Tick(t), t % 60 >= 53.
IsRed(X) :- Heading(X, "Left"), Tick(t), t % 60 >= 23.
IsRed(X) :- Heading(X, "Right"), Tick(t), t % 60 >= 23.

.scope Sees
""",
}

#: By right of way: the least share of held-out moments at lines of free intersections that the rules explain, and words
#: of the rules.
EXPECTED = {
    "right_before_left": (0.97, ["FromRight(Y, X)", "Not(TurnsRight(X))", "Oncoming", "TurnsLeft(X)"]),
    "priority": (0.97, ["FromLeft(Y, X)", "FromRight(Y, X)", "Not(OnMain(X))"]),
    "allway_stop": (0.97, ["WaitsLonger(", "Not(Waits("]),
    "traffic_light": (0.97, ["IsRed(X)"]),
}


@pytest.mark.parametrize("junctions", ["right_before_left", "priority", "allway_stop", "traffic_light"])
def test_rules_of_traffic_that_sumo_drives(tmp_path: Path, junctions: str) -> None:
    traffic = driven(tmp_path, junctions, "4")
    config = {"priority": STREETS, "traffic_light": LIGHTS}.get(junctions)
    arguments = ["distill", str(traffic), "--map", str(tmp_path / "town.yaml"), "--cell", "3"]
    if config is not None:
        for name, text in config.items():
            (tmp_path / name).write_text(text)
        arguments += ["--config", str(tmp_path / next(iter(config)))]
    if junctions == "traffic_light":
        # Cars that wait at red lights make many moments.
        arguments += ["--end", "1200"]
    done = command(*arguments, "-o", str(tmp_path / "city"))
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "city" / "report.json").read_text())
    least, words = EXPECTED[junctions]
    free = report["test"]["free"]
    assert free["moments"] > 500 and free["explained"] >= least, free
    rules = " ".join(clause["rule"] for clause in report["clauses"])
    assert all(word in rules for word in words), rules


@pytest.mark.parametrize(
    ("junctions", "words"),
    [
        ("right_before_left", ["MustYield(X, Y)"]),
        ("priority", ["MustYield(X, Y)"]),
        ("allway_stop", ["Not(Waits(X))", "StaysInTheWay(Y, X)", "WaitsLonger("]),
        ("traffic_light", ["SeesRed(X)"]),
    ],
)
def test_rules_of_towns_that_netgenerate_makes(tmp_path: Path, junctions: str, words: list[str]) -> None:
    """The commands of docs/tutorials/town.md."""
    sumo = needs("sumo", "sumo")
    home = Path(sumo.__file__).parent
    programs = {name: str(find_program(name)) for name in ("netgenerate", "duarouter", "sumo")}
    script = [sys.executable, str(home / "tools" / "randomTrips.py")]
    grid = ["--grid", "--grid.number", "4", "--grid.length", "120", "--default-junction-type", junctions]
    for line in (
        [programs["netgenerate"], *grid, "--no-turnarounds", "-o", "town.net.xml"],
        [*script, "-n", "town.net.xml", "-o", "trips.xml", "-e", "3600", "-p", "3"],
        [
            programs["duarouter"],
            "-n",
            "town.net.xml",
            "--route-files",
            "trips.xml",
            "-o",
            "routes.xml",
            "--ignore-errors",
        ],
        [programs["sumo"], "-n", "town.net.xml", "-r", "routes.xml", "--fcd-output", "traffic.xml", "--end", "3600"],
    ):
        environment = os.environ | {"SUMO_HOME": str(home)}
        subprocess.run(line, check=True, capture_output=True, env=environment, cwd=tmp_path)
    town, out = str(tmp_path / "town.yaml"), tmp_path / "rules"
    for arguments in (
        ["map", "import", str(tmp_path / "town.net.xml"), "-o", town],
        ["distill", str(tmp_path / "traffic.xml"), "--map", town, "-o", str(out)],
    ):
        done = command(*arguments)
        assert done.returncode == 0, done.stderr
    report = json.loads((out / "report.json").read_text())
    line, free = report["test"]["line"], report["test"]["free"]
    assert line["moments"] > 1300 and line["explained"] >= 0.97, line
    assert free["moments"] > 1000 and free["explained"] >= 0.97, free
    rules = " ".join(clause["rule"] for clause in report["clauses"])
    assert all(word in rules for word in words), rules


ROADS_CITY = """
base: right-of-way-roads
rules: rules.dl
map: roads.yaml
agents: {test: {cars: [{priority: 1, count: 20}]}}
"""


def test_rules_of_a_city_on_an_imported_network_are_recovered(tmp_path: Path) -> None:
    """An imported network, a run on it, its trajectories, and the rules of the run from these."""
    net = Path(__file__).parents[2] / "tests" / "fixtures" / "networks" / "grid-right.net.xml"
    roads = tmp_path / "roads.yaml"
    (tmp_path / "own.yaml").write_text(ROADS_CITY, encoding="utf-8")
    (tmp_path / "rules.dl").write_text(RIGHT_BEFORE_LEFT, encoding="utf-8")
    run, traffic, out = tmp_path / "run", tmp_path / "traffic.xml", tmp_path / "learned"
    for arguments in (
        ["map", "import", str(net), "-o", str(roads)],
        ["run", str(tmp_path / "own.yaml"), "--ticks", "400", "--seed", "2", "--no-pictures", "--out", str(run)],
        ["fcd", str(run / "trace.jsonl"), "-o", str(traffic)],
        ["distill", str(traffic), "--map", str(roads), "-o", str(out), *OWN[2:]],
    ):
        done = command(*arguments)
        assert done.returncode == 0, done.stderr
    report = json.loads((out / "report.json").read_text())
    assert report["recording"]["off_map"] == 0
    assert report["test"]["line"]["moments"] > 100
    # Where a trip ends, the recording does not tell where the car would have turned.
    assert report["test"]["line"]["explained"] >= 0.85, done.stdout
    rules = [clause["rule"] for clause in report["clauses"]]
    assert "Stop(X) :- IsAtInter(X), FromRight(Y, X), Not(TurnsRight(X)), Not(Waits(Y))." in rules, rules
    logicity.Simulation(str(out / "city.yaml")).run(20)
    # The exported network is that of the file, so SUMO shows the run on it.
    back = tmp_path / "back.net.xml"
    assert command("map", "export", str(roads), "-o", str(back)).returncode == 0
    again = tmp_path / "again.yaml"
    assert command("map", "import", str(back), "-o", str(again)).returncode == 0
    assert again.read_text().splitlines()[1:] == roads.read_text().splitlines()[1:]
    refused = command("distill", str(traffic), "--map", str(roads), "--cell", "2", "-o", str(tmp_path / "x"))
    assert refused.returncode == 2 and "a road network states its cells, origin and direction of y" in refused.stderr
    refused = command("map", "export", str(roads), "--speed", "50", "-o", str(tmp_path / "x.net.xml"))
    assert refused.returncode == 2 and "omit the option" in refused.stderr
