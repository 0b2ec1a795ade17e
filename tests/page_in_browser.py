"""Tests the page of a run in headless Chromium: clicks, moves the slider, reads texts and takes screenshots.

`make page` runs this file as a program. Without a browser it prints what it skips and exits with 0; with one it exits
as pytest does. Tests write screenshots to the folder LOGICITY_SCREENSHOTS if it is set. With pages as arguments, the
program instead prints their sizes and the times to their first frame and to the last of their explanations.
"""

import base64
import json
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import time
import xml.etree.ElementTree
import zlib
from collections.abc import Callable, Iterator

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.action_builder import ActionBuilder
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.select import Select
from selenium.webdriver.support.wait import WebDriverWait

ROOT = pathlib.Path(__file__).parent.parent
PROGRAM = ROOT / "target/debug/logicity"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
SKIPPED = (
    "SKIPPED: the tests of the page in a browser (tests/page_in_browser.py) need chromium and chromedriver."
    " On Debian: apt-get install chromium chromium-driver"
)

# Selenium's driver manager must not use the network.
os.environ["SE_OFFLINE"] = "true"
os.environ["SE_AVOID_STATS"] = "true"

TICKS = 300


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("page")
    page = folder / "city.html"
    options = ["--seed", "10", "--ticks", str(TICKS), "--no-pictures", "--out", folder, "--html", page]
    subprocess.run([PROGRAM, "run", "configs/expert.yaml", *options], cwd=ROOT, check=True, capture_output=True)
    assert page.stat().st_size < 600_000
    return folder


@pytest.fixture(scope="module")
def trace(folder: pathlib.Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "trace.jsonl").read_text().splitlines()]


def start(width: int, height: int) -> WebDriver:
    assert CHROMIUM and DRIVER, SKIPPED
    options = Options()
    options.binary_location = CHROMIUM
    quiet = ["no-first-run", "disable-background-networking", "disable-component-update", "disable-sync"]
    for argument in ["headless=new", "no-sandbox", "disable-gpu", f"window-size={width},{height}", *quiet]:
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(DRIVER))


@pytest.fixture(scope="module")
def browser() -> Iterator[WebDriver]:
    browser = start(1400, 1000)
    yield browser
    browser.quit()


@pytest.fixture(scope="module")
def driven(folder: pathlib.Path, trace: list[dict]) -> list[dict]:
    """Write `driven.html` for the first 40 ticks, edited as if a policy drove Car_1 and broke a rule in the last."""
    header, *ticks = json.loads(json.dumps(trace[:41]))
    agents = [agent["id"] for agent in header["agents"]]
    for tick in ticks:
        state = tick["agents"][agents.index("Car_1")]
        state["driven"] = {"observes": ["Car_1", "Car_2"], "wanted": state["action"], "broken": []}
    clause = next(number for number, clause in enumerate(header["clauses"]) if clause["doc"].startswith("S1"))
    state["driven"] |= {"wanted": "Stop", "broken": [clause]}
    state["action"] = "Fast"
    lines = [json.dumps(line) for line in [header, *ticks]]
    (folder / "driven.jsonl").write_text("\n".join(lines))
    view = [PROGRAM, "view", folder / "driven.jsonl", "-o", folder / "driven.html"]
    subprocess.run(view, cwd=ROOT, check=True, capture_output=True)
    return ticks


@pytest.fixture(scope="module")
def other(folder: pathlib.Path) -> list[dict]:
    """Write `pair.html`: the run beside a shorter one with other rules."""
    rules = ["--rules", "rules/hard.dl", "--seed", "10", "--ticks", "200", "--no-pictures", "--out", folder / "other"]
    subprocess.run([PROGRAM, "run", "configs/expert.yaml", *rules], cwd=ROOT, check=True, capture_output=True)
    view = [PROGRAM, "view", folder / "trace.jsonl", folder / "other/trace.jsonl", "-o", folder / "pair.html"]
    said = subprocess.run(view, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert "`other` ends with tick 199" in said and "decisions, first in tick" in said
    return [json.loads(line) for line in (folder / "other/trace.jsonl").read_text().splitlines()]


@pytest.fixture
def page(browser: WebDriver, folder: pathlib.Path) -> Iterator[Callable[..., WebDriver]]:
    """Open the page at an address. After the test, neither the browser nor the page may have reported an error."""

    def open_at(address: str = "", name: str = "city.html") -> WebDriver:
        browser.get("about:blank")
        browser.get((folder / name).as_uri() + address)
        wait_for(browser)
        return browser

    yield open_at
    assert browser.get_log("browser") == []
    assert not browser.find_element(By.ID, "fault").is_displayed()


def wait_for(browser: WebDriver) -> None:
    """Wait until the page has unpacked all its parts."""
    loaded = "return performance.getEntriesByName('loaded').length"
    WebDriverWait(browser, 20).until(lambda _: browser.execute_script(loaded))


def photograph(browser: WebDriver, name: str) -> None:
    if target := os.environ.get("LOGICITY_SCREENSHOTS"):
        browser.save_screenshot(os.path.join(target, name))


def text(browser: WebDriver, element: str) -> str:
    return browser.find_element(By.ID, element).text


def scrub(browser: WebDriver, tick: int) -> None:
    change = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(change, browser.find_element(By.ID, "scrub"), tick)


def rows(browser: WebDriver) -> list[str]:
    """The texts of the rows of the strip chart: names of agents, and of groups with a triangle in front."""
    return [row.text for row in browser.find_elements(By.CSS_SELECTOR, "#rows button")]


def click_strip(browser: WebDriver, tick: int, name: str) -> None:
    """Click a decision on the strip chart."""
    row = next(row for row in browser.find_elements(By.CSS_SELECTOR, "#rows button") if row.text == name)
    place = """arguments[0].scrollIntoView({block: "center"});
        const [row, strip] = [arguments[0], document.getElementById("strip")].map((one) => one.getBoundingClientRect());
        return [strip.left, strip.width, (row.top + row.bottom) / 2];"""
    left, width, y = browser.execute_script(place, row)
    click_at(browser, left + (tick + 0.5) / TICKS * width, y)


def click_at(browser: WebDriver, x: float, y: float) -> None:
    """Click a place of the window."""
    actions = ActionBuilder(browser)
    actions.pointer_action.move_to_location(round(x), round(y)).click()
    actions.perform()


def test_the_page_explains_three_different_actions(page: Callable[..., WebDriver], trace: list[dict]) -> None:
    browser = page()
    header, ticks = trace[0], trace[1:]
    names = [agent["id"] for agent in header["agents"]]
    asked = 0
    for wanted in ["Stop", "Fast", "Slow"]:
        tick, agent = next(
            (tick["tick"], position)
            for tick in ticks
            for position, state in enumerate(tick["agents"])
            if state["action"] == wanted and tick["tick"] > 10
        )
        click_strip(browser, tick, names[agent])
        # The chart may have fewer pixels than ticks, so the slider sets the exact tick.
        scrub(browser, tick)
        shown = text(browser, "agent")
        assert names[agent] in shown and text(browser, "action") == wanted
        proof = subprocess.run(
            [PROGRAM, "explain", "--tick", str(tick), "--agent", names[agent], "--json", trace_file(browser)],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        )
        nodes = json.loads(proof.stdout)["explanations"][0]["nodes"]
        assert nodes[0]["clause"]["doc"].splitlines()[0] in shown
        for premise in nodes[0]["premises"]:
            assert premise["literal"] in shown, premise
        assert "Why not" in shown
        photograph(browser, f"{wanted.lower()}.png")
        asked += 1
    assert asked == 3


def trace_file(browser: WebDriver) -> str:
    return browser.current_url.split("#")[0].removeprefix("file://").replace("city.html", "trace.jsonl")


def test_why_not_and_atoms_unfold_and_partners_can_be_clicked(
    page: Callable[..., WebDriver], trace: list[dict]
) -> None:
    tick, state = next(
        (tick["tick"], state)
        for tick in trace[1:]
        for state in [dict(zip([agent["id"] for agent in trace[0]["agents"]], tick["agents"], strict=True))]
        if state["Car_6"]["action"] == "Stop"
    )
    assert state["Car_6"]["derived"] == ["Stop"]
    browser = page(f"#tick={tick}&agent=Car_6")
    for summary in browser.find_elements(By.CSS_SELECTOR, "#agent > details > summary"):
        summary.click()
    WebDriverWait(browser, 5).until(lambda _: "IsCar(Car_6)" in text(browser, "agent"))
    shown = text(browser, "agent")
    assert "Not(Stop(Car_6)) fails" in shown and "Why not Normal?" in shown
    partner = browser.find_element(By.CSS_SELECTOR, "#agent .tree .agent-link")
    name = partner.text
    partner.click()
    assert text(browser, "agent").startswith(name) and f"agent={name}" in browser.current_url


def test_a_click_on_the_map_chooses_an_agent(page: Callable[..., WebDriver], trace: list[dict]) -> None:
    # An agent far from all others, and from the edges, where the map cannot center it.
    places = [state["at"] for state in trace[51]["agents"]]

    def apart(agent: int) -> bool:
        row, col = places[agent]
        others = [max(abs(row - r), abs(col - c)) for at, (r, c) in enumerate(places) if at != agent]
        return min(others) > 6 and 60 < row < 180 and 60 < col < 180

    agent = next(agent for agent in range(len(places)) if apart(agent))
    name = trace[0]["agents"][agent]["id"]
    browser = page(f"#tick=50&agent={name}")
    body = browser.find_element(By.TAG_NAME, "body")
    body.send_keys("f", *"++++++", Keys.ESCAPE)
    assert "Click an agent" in text(browser, "agent")
    ActionChains(browser).move_to_element(browser.find_element(By.ID, "map")).click().perform()
    assert text(browser, "agent").startswith(name)


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        ("#tick=300", ["no tick 300", f"0 to {TICKS - 1}"]),
        ("#tick=-1&agent=Car_1", ["no tick -1"]),
        ("#tick=5&agent=Car_99", ["no agent Car_99"]),
        ("#tick=soon&agent=me&clause=S99", ["no tick soon", "no agent me", "no clause S99"]),
    ],
)
def test_an_invalid_address_is_reported(page: Callable[..., WebDriver], address: str, expected: list[str]) -> None:
    browser = page(address)
    assert all(words in text(browser, "notice") for words in expected)
    assert text(browser, "tick") == ("tick 5" if "tick=5" in address else "tick 0")
    browser.find_element(By.TAG_NAME, "body").send_keys(Keys.ARROW_RIGHT)
    assert not browser.find_element(By.ID, "notice").is_displayed()
    browser.execute_script("location.hash = '#tick=7&agent=Car_2'")
    WebDriverWait(browser, 5).until(lambda _: text(browser, "tick") == "tick 7")
    assert not browser.find_element(By.ID, "notice").is_displayed()


def test_a_driven_car_is_marked(page: Callable[..., WebDriver], driven: list[dict]) -> None:
    browser = page(name="driven.html")
    assert "Car_1 was driven: 39 of 40 actions agreed with the rules." in text(browser, "driven")
    assert "driven" in text(browser, "legend")
    browser.find_element(By.XPATH, "//*[@id='driven']//button[contains(., 'violated S1')]").click()
    assert text(browser, "tick") == "tick 39" and text(browser, "action") == "Fast"
    assert text(browser, "wanted").startswith("Stop") and "S1" in text(browser, "judged")
    shown = text(browser, "agent")
    assert "Car_2" in shown and "Why do the rules want Stop?" in shown and "Why not Fast?" in shown
    photograph(browser, "driven.png")
    browser.find_element(By.TAG_NAME, "body").send_keys(Keys.ARROW_LEFT)
    assert text(browser, "judged") == "no clause violated"
    browser.find_element(By.TAG_NAME, "body").send_keys("n")
    assert "because" in text(browser, "agent") and not browser.find_elements(By.ID, "judged")


def test_a_run_has_no_driven_car(page: Callable[..., WebDriver]) -> None:
    browser = page("#tick=3&agent=Car_1")
    assert not browser.find_element(By.ID, "driven").is_displayed()
    assert "driven" not in text(browser, "legend") and not browser.find_elements(By.ID, "judged")


def pixels(browser: WebDriver) -> str:
    return browser.execute_script("return document.getElementById('map').toDataURL()")


def test_zones_and_values_are_shown(browser: WebDriver, tmp_path: pathlib.Path) -> None:
    """The legend hides and shows a zone; the panel has the values of the quantities in the trace's tick."""
    page = tmp_path / "school.html"
    options = ["--ticks", "30", "--no-pictures", "--out", tmp_path, "--html", page]
    subprocess.run([PROGRAM, "run", "school-zone", *options], cwd=ROOT, check=True, capture_output=True)
    browser.get(f"{page.as_uri()}#tick=29&agent=Car_1")
    wait_for(browser)
    header, *ticks = [json.loads(line) for line in (tmp_path / "trace.jsonl").read_text().splitlines()]
    car = [agent["id"] for agent in header["agents"]].index("Car_1")
    places = [tick["agents"][car]["at"] for tick in ticks]
    waited = next((back for back, at in enumerate(reversed(places)) if at != places[-1]), len(places)) - 1
    names = browser.find_elements(By.CSS_SELECTOR, "#agent dl.facts dt")
    values = browser.find_elements(By.CSS_SELECTOR, "#agent dl.facts dd")
    facts = {name.text: value.text for name, value in zip(names, values, strict=True)}
    assert (facts["Waited"], facts["Tick"]) == (str(waited), "29")
    browser.find_element(By.CSS_SELECTOR, "[data-part=atoms] summary").click()
    atoms = f"Waited(Car_1, {waited})", "Tick(29)"
    WebDriverWait(browser, 20).until(lambda _: all(atom in text(browser, "agent") for atom in atoms))
    zone = browser.find_element(By.CSS_SELECTOR, "#legend .zone")
    shown = pixels(browser)
    assert (zone.text, zone.get_attribute("aria-pressed")) == ("school", "true")
    photograph(browser, "zones.png")
    zone.click()
    hidden = pixels(browser)
    assert zone.get_attribute("aria-pressed") == "false" and hidden != shown
    zone.click()
    assert pixels(browser) == shown


@pytest.mark.parametrize("count", [1, 5])
def test_actions_of_the_configuration_are_explained(
    page: Callable[..., WebDriver], folder: pathlib.Path, count: int
) -> None:
    """Each agent has the explanation of its own action, however many actions the configuration defines."""
    config, rules = folder / f"rest{count}.yaml", folder / f"rest{count}.dl"
    names = [f"Rest{number}" for number in range(1, count + 1)]
    defined = "".join(
        f"    {name}: {{cells: {{Car: 0, Pedestrian: 0}}, park: {at + 3}}}\n" for at, name in enumerate(names)
    )
    order = ", ".join(["Stop", *names, "Slow", "Fast", "Normal"])
    config.write_text(f"base: expert\nactions:\n  define:\n{defined}  priority: [{order}]\nrules: {rules.name}\n")
    clauses = "".join(f".decl {name}(x: agent)\n.output {name}\n" for name in names)
    clauses += "".join(f"{name}(X) :- IsOld(X), IsClose(X, Y), IsCar(Y).\n" for name in names)
    rules.write_text(f'.include "expert.dl"\n{clauses}')
    out = folder / f"rest{count}"
    options = ["--seed", "4", "--ticks", "40", "--no-pictures", "--out", out, "--html", folder / f"rest{count}.html"]
    subprocess.run([PROGRAM, "run", config, *options], cwd=ROOT, check=True, capture_output=True)
    header, *ticks = [json.loads(line) for line in (out / "trace.jsonl").read_text().splitlines()]
    taken = {state["action"] for tick in ticks for state in tick["agents"]}
    assert {names[0], "Stop", "Normal"} <= taken
    browser = page(name=f"rest{count}.html")
    for tick in (0, 17, 39):
        for agent, state in zip(header["agents"], ticks[tick]["agents"], strict=True):
            browser.execute_script("location.hash = arguments[0]", f"#tick={tick}&agent={agent['id']}")
            wanted = f"{agent['id']}\n{state['action']}"
            WebDriverWait(browser, 5).until(lambda _, wanted=wanted: text(browser, "agent").startswith(wanted))
            proof = browser.find_element(By.CSS_SELECTOR, "#agent .tree").text
            assert proof.startswith(f"{state['action']}({agent['id']})"), (tick, agent["id"], proof)


def test_the_chart_has_no_gaps(page: Callable[..., WebDriver]) -> None:
    clear = """const {width, height} = arguments[0];
        const {data} = arguments[0].getContext("2d").getImageData(0, 0, width, height);
        return data.filter((_, at) => at % 4 === 3 && data[at] < 255).length;"""
    browser = page()
    assert browser.execute_script(clear, browser.find_element(By.ID, "strip")) == 0


def test_playback_starts_and_stops(page: Callable[..., WebDriver]) -> None:
    browser = page("#tick=5")
    body = browser.find_element(By.TAG_NAME, "body")
    body.send_keys(Keys.ARROW_RIGHT)
    assert text(browser, "tick") == "tick 6"
    body.send_keys(Keys.END)
    assert text(browser, "tick") == f"tick {TICKS - 1}"
    body.send_keys(Keys.HOME, "]", "]")
    body.send_keys(Keys.SPACE)
    WebDriverWait(browser, 10).until(lambda _: int(text(browser, "tick").split()[1]) > 3)
    body.send_keys(Keys.SPACE)
    stopped = text(browser, "tick")
    time.sleep(0.3)
    assert text(browser, "tick") == stopped


def test_clauses_filter_the_chart(page: Callable[..., WebDriver], trace: list[dict]) -> None:
    browser = page()
    fired = [
        (tick["tick"], trace[0]["agents"][position]["id"])
        for tick in trace[1:]
        for position, state in enumerate(tick["agents"])
        if any(trace[0]["clauses"][clause]["doc"].startswith("F3") for clause in state["clauses"])
    ]
    row = next(row for row in browser.find_elements(By.CSS_SELECTOR, "#clauses tr") if "F3" in row.text)
    assert row.text.split()[0] == str(len(fired))
    row.find_element(By.TAG_NAME, "button").click()
    assert f"fired {len(fired)} times" in text(browser, "filter")
    for tick, agent in fired:
        browser.find_element(By.TAG_NAME, "body").send_keys(".")
        assert text(browser, "tick") == f"tick {tick}" and text(browser, "agent").startswith(agent)
    photograph(browser, "filter.png")


@pytest.fixture(scope="module")
def learned(folder: pathlib.Path, trace: list[dict]) -> dict:
    """Write `learned.html`: the run with rules learned from it. Return the report of the learner."""
    outputs = ["-o", folder / "learned.dl", "--report", folder / "report.json", "--page", folder / "learned.html"]
    command = [PROGRAM, "induce", folder / "trace.jsonl", "--config", "configs/expert.yaml", *outputs]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return json.loads((folder / "report.json").read_text())


def moments_with(action: str, trace: list[dict]) -> list[tuple[int, str]]:
    """The ticks and agents of a trace with an action, in order."""
    names = [agent["id"] for agent in trace[0]["agents"]]
    decisions = [(tick["tick"], zip(names, tick["agents"], strict=True)) for tick in trace[1:]]
    return [(tick, name) for tick, agents in decisions for name, state in agents if state["action"] == action]


def test_a_click_on_a_learned_clause_shows_the_moments_that_it_explains(
    page: Callable[..., WebDriver], trace: list[dict], learned: dict
) -> None:
    browser = page(name="learned.html")
    assert f"{learned['examples']} examples" in text(browser, "clause-box")
    for clause in learned["clauses"]:
        row = browser.find_element(By.XPATH, f"//*[@id='clauses']/tr[contains(., '{clause['label']}:')]")
        # The list shows the body and the number of moments, which equals the number of examples.
        assert f"{clause['label']}: {', '.join(clause['body'])}" in row.text
        assert int(row.text.split()[0]) == clause["examples"]
        widths = [float(part.rect["width"]) for part in row.find_elements(By.CSS_SELECTOR, ".coverage span")]
        bar = row.find_element(By.CSS_SELECTOR, ".coverage").rect["width"]
        of = next(rules["examples"] for rules in learned["actions"] if rules["action"] == clause["action"])
        assert abs(widths[0] - bar * clause["alone"] / of) < 1.5
        assert abs(sum(widths) - bar * clause["examples"] / of) < 1.5
    clause = learned["clauses"][1]
    row = browser.find_element(By.XPATH, f"//*[@id='clauses']/tr[contains(., '{clause['label']}:')]")
    row.find_element(By.TAG_NAME, "button").click()
    shown = text(browser, "filter")
    assert f"fired {clause['examples']} times" in shown and f"{clause['alone']} alone" in shown
    assert all(note in shown for note in clause["notes"])
    photograph(browser, "learned-clause.png")
    expected = moments_with(clause["action"], trace)
    found = []
    for _ in range(12):
        browser.find_element(By.TAG_NAME, "body").send_keys(".")
        tick, agent = int(text(browser, "tick").split()[1]), text(browser, "agent").splitlines()[0]
        assert (tick, agent) in expected and clause["label"] in text(browser, "agent")
        found.append((tick, agent))
    assert found == sorted(set(found), key=expected.index)
    # The first example that the clause alone explains, as the report has it.
    agent, tick = re.fullmatch(r"trace\.jsonl, (\S+) in tick (\d+)", clause["first"]).groups()
    assert (int(tick), agent) in expected and clause["first"] in shown


def test_a_click_on_a_moment_shows_the_learned_clause_that_decides(
    page: Callable[..., WebDriver], trace: list[dict], learned: dict
) -> None:
    browser = page(name="learned.html")
    for clause in learned["clauses"]:
        agent, tick = re.fullmatch(r"trace\.jsonl, (\S+) in tick (\d+)", clause["first"]).groups()
        click_strip(browser, int(tick), agent)
        scrub(browser, int(tick))
        # It alone explains this moment, and it is in the visible part of the list.
        deciding = browser.find_elements(By.CSS_SELECTOR, "#clauses tr[data-deciding]")
        assert [row.text.split()[2] for row in deciding] == [f"{clause['label']}:"]
        box, row = browser.find_element(By.ID, "clause-box").rect, deciding[0].rect
        assert box["y"] <= row["y"] and row["y"] + row["height"] <= box["y"] + box["height"] + 1
        assert text(browser, "action") == clause["action"]
        proof = browser.find_element(By.CSS_SELECTOR, "#agent > .tree")
        assert f"{clause['label']}: {', '.join(clause['body'])}" in proof.text
    photograph(browser, "learned-moment.png")
    # The clause in the proof leads to all its moments.
    proof.find_element(By.CSS_SELECTOR, "a.clause").click()
    assert f"fired {'1 of ' if clause['examples'] == 1 else ''}" in text(browser, "filter")
    assert f"clause={clause['label']}" in browser.current_url
    browser.find_element(By.TAG_NAME, "body").send_keys(Keys.ESCAPE)
    assert not browser.find_elements(By.CSS_SELECTOR, "#clauses tr[data-deciding]")


def test_a_wrong_example_is_marked(page: Callable[..., WebDriver], folder: pathlib.Path, trace: list[dict]) -> None:
    header, *ticks = json.loads(json.dumps(trace[:101]))
    agents = [agent["id"] for agent in header["agents"]]
    state = ticks[50]["agents"][agents.index("Car_1")]
    assert state["action"] == "Normal"
    state["action"] = "Fast"
    (folder / "wrong.jsonl").write_text("\n".join(json.dumps(line) for line in [header, *ticks]))
    outputs = ["-o", folder / "wrong.dl", "--page", folder / "wrong.html", "--noise", "0.001"]
    command = [PROGRAM, "induce", folder / "wrong.jsonl", "--config", "configs/expert.yaml", *outputs]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    browser = page("#tick=50&agent=Car_1", "wrong.html")
    shown = text(browser, "agent")
    assert "The example has Fast, but the learned rules choose Normal." in shown
    assert "Why do the rules want Normal?" in shown and "Why not Fast?" in shown
    browser.find_element(By.TAG_NAME, "body").send_keys(Keys.ARROW_LEFT)
    assert "The example has" not in text(browser, "agent")


def test_a_run_has_no_support(page: Callable[..., WebDriver]) -> None:
    browser = page()
    assert not browser.find_elements(By.CSS_SELECTOR, ".coverage") and "Learned from" not in text(browser, "clause-box")


def test_deadlocks_are_marked(page: Callable[..., WebDriver]) -> None:
    browser = page()
    button = browser.find_element(By.XPATH, "//*[@id='deadlocks']/button[contains(., 'deadlock since tick 5')]")
    assert all(car in button.text for car in ("Car_6", "Car_9", "Car_10"))
    button.click()
    assert text(browser, "tick") == "tick 5"


def test_the_theme_can_be_changed(page: Callable[..., WebDriver]) -> None:
    browser = page("#tick=100&agent=Car_1")
    color = "return getComputedStyle(document.body).backgroundColor"
    light = browser.execute_script(color)
    browser.find_element(By.ID, "theme").click()
    assert browser.execute_script(color) != light
    photograph(browser, "dark.png")


def test_the_proof_is_in_view_on_a_phone(folder: pathlib.Path, other: list[dict], learned: dict) -> None:
    browser = start(500, 1000)
    try:
        metrics = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        for name in ("city.html", "pair.html", "learned.html"):
            browser.get((folder / name).as_uri() + "#tick=190&agent=Car_6")
            wait_for(browser)
            wide, room = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
            assert wide <= room == 390, "the page needs no horizontal scrolling"
            inside = """const box = arguments[0].getBoundingClientRect();
                return box.top >= 0 && box.left >= 0 && box.right <= innerWidth && box.bottom <= innerHeight"""
            steps = browser.find_elements(By.CSS_SELECTOR, "#agent > .tree li")
            assert len(steps) > 2 and all(browser.execute_script(inside, step) for step in steps)
            assert browser.execute_script("return document.elementFromPoint(200, 200).id").startswith("map")
            photograph(browser, f"phone-{name}.png")
            # The timeline and the clauses are one tap away.
            browser.find_element(By.CSS_SELECTOR, "#tabs [data-tab=time]").click()
            assert browser.find_element(By.ID, "strip").is_displayed()
            assert not browser.find_element(By.ID, "agent").is_displayed()
            browser.find_element(By.CSS_SELECTOR, "#tabs [data-tab=rules]").click()
            assert browser.find_element(By.ID, "clauses").is_displayed()
    finally:
        browser.quit()


def premises(trace: pathlib.Path, tick: int, agent: str) -> tuple[str, list[str]]:
    """The action of an agent and the premises of its proof, as the engine has them."""
    command = [PROGRAM, "explain", "--tick", str(tick), "--agent", agent, "--json", trace]
    answer = json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True).stdout)
    return answer["action"], [premise["literal"] for premise in answer["explanations"][0]["nodes"][0]["premises"]]


@pytest.fixture(scope="module")
def facts(folder: pathlib.Path) -> pathlib.Path:
    """Write `facts.html` and `facts-pair.html`: runs whose proofs rest on a fact in the rule file."""
    rules = folder / "facts.dl"
    rules.write_text(
        '.include "vocabulary.dl"\n.decl Vip(x: agent)\n/// Car_2 is a VIP\nVip("Car_2").\n/// T2\n'
        "Stop(X) :- IsAtInter(X), IsInInter(Y), Vip(Y).\nStop(X) :- CollidingClose(X, Y).\n"
        '/// F: it is parked\nStop("Car_5").\n'
    )
    options = ["--rules", rules, "--ticks", "100", "--no-pictures", "--out", folder / "facts"]
    page = ["--html", folder / "facts.html"]
    subprocess.run([PROGRAM, "run", "configs/expert.yaml", *options, *page], cwd=ROOT, check=True, capture_output=True)
    trace = folder / "facts/trace.jsonl"
    view = [PROGRAM, "view", trace, trace, "-o", folder / "facts-pair.html"]
    subprocess.run(view, cwd=ROOT, check=True, capture_output=True)
    return trace


@pytest.mark.parametrize("name", ["facts.html", "facts-pair.html"])
def test_a_proof_may_rest_on_a_fact_in_the_rules(
    page: Callable[..., WebDriver], facts: pathlib.Path, name: str
) -> None:
    header, *ticks = [json.loads(line) for line in facts.read_text().splitlines()]
    clause = next(number for number, clause in enumerate(header["clauses"]) if clause["doc"] == "T2")
    tick, agent = next(
        (tick["tick"], number)
        for tick in ticks
        for number, state in enumerate(tick["agents"])
        if clause in state["clauses"]
    )
    browser = page(f"#tick={tick}&agent={header['agents'][agent]['id']}", name)
    for panel in ["agent"] if name == "facts.html" else ["agent", "agent-b"]:
        shown = text(browser, panel)
        assert re.search(r"Vip\(Car_2\) by Car_2 is a VIP +\[facts\.dl:4\]", shown), shown
        assert "True atoms" in shown
    # A fact about an action is a cause, too.
    browser = page("#tick=3&agent=Car_5", name)
    shown = text(browser, "agent")
    assert "because\nF: it is parked" in shown and "no clause fired" not in shown.lower(), shown


def test_two_runs_are_compared(
    page: Callable[..., WebDriver], folder: pathlib.Path, trace: list[dict], other: list[dict]
) -> None:
    names = [agent["id"] for agent in trace[0]["agents"]]
    differ = {
        left["tick"]: [
            name
            for name, a, b in zip(names, left["agents"], right["agents"], strict=True)
            if a["action"] != b["action"]
        ]
        for left, right in zip(trace[1:], other[1:], strict=False)
    }
    ticks = [tick for tick, agents in differ.items() if agents]
    browser = page("#tick=150", "pair.html")
    total = sum(map(len, differ.values()))
    assert text(browser, "differing").startswith(f"{total} of {200 * len(names)} decisions differ")
    assert browser.find_element(By.ID, "scrub").get_attribute("max") == "199"
    # The first divergence, with both proofs as the engine has them.
    browser.find_element(By.ID, "diverge").click()
    for tick, key in zip(ticks[:3], ["d", "d", None], strict=True):
        assert text(browser, "tick") == f"tick {tick}"
        agent = text(browser, "agent").splitlines()[1]
        assert agent in differ[tick]
        photograph(browser, f"pair-{tick}.png")
        for suffix, file in (("", "trace.jsonl"), ("-b", "other/trace.jsonl")):
            action, literals = premises(folder / file, tick, agent)
            assert text(browser, f"action{suffix}") == action
            shown = text(browser, f"agent{suffix}")
            assert f"Why {action}?" in shown and all(literal in shown for literal in literals)
        assert text(browser, "action") != text(browser, "action-b")
        if key:
            browser.find_element(By.TAG_NAME, "body").send_keys(key)
    # The axis marks exactly the ticks that differ.
    marked = """const canvas = document.getElementById("marks"), count = arguments[0];
        const {data} = canvas.getContext("2d").getImageData(0, canvas.height - 1, canvas.width, 1);
        return Array.from({length: count}, (_, tick) => {
            const at = 4 * Math.floor((tick + 0.5) * canvas.width / count);
            return data[at] > data[at + 1] + 100;
        });"""
    strong = [tick for tick, is_marked in enumerate(browser.execute_script(marked, 200)) if is_marked]
    apart = {
        left["tick"]
        for left, right in zip(trace[1:], other[1:], strict=False)
        if any(a["at"] != b["at"] for a, b in zip(left["agents"], right["agents"], strict=True))
    }
    assert set(ticks) <= set(strong) <= set(ticks) | apart
    browser.find_element(By.CSS_SELECTOR, "#tabs [data-tab=rules]").click()
    assert "expert.dl" in text(browser, "clauses-title") and "hard.dl" in text(browser, "clauses-title-b")
    browser.find_element(By.CSS_SELECTOR, "#clauses-b tr[data-decides] button").click()
    assert "run=2" in browser.current_url and browser.find_element(By.ID, "filter-b").is_displayed()
    assert not browser.find_element(By.ID, "filter").is_displayed()


def test_equal_runs_agree(page: Callable[..., WebDriver], folder: pathlib.Path) -> None:
    trace = folder / "trace.jsonl"
    shutil.copy(trace, folder / "again.jsonl")
    view = [PROGRAM, "view", trace, folder / "again.jsonl", "--ticks", "20", "-o", folder / "equal.html"]
    said = subprocess.run(view, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert "the runs agree in all 360 decisions" in said
    browser = page(name="equal.html")
    assert "agree in all 360 decisions" in text(browser, "differing")
    assert not browser.find_element(By.ID, "marks").is_displayed()


def test_figures_are_saved(page: Callable[..., WebDriver], tmp_path: pathlib.Path, other: list[dict]) -> None:
    for name in ("city.html", "pair.html"):
        browser = page("#tick=100&agent=Car_6", name)
        folder = tmp_path / name
        folder.mkdir()
        where = {"behavior": "allow", "downloadPath": str(folder)}
        browser.execute_cdp_cmd("Browser.setDownloadBehavior", where)
        for number in range(4):
            browser.find_element(By.ID, "save").click()
            browser.find_elements(By.CSS_SELECTOR, "#formats button")[number].click()
            wait_for_files(browser, folder, number + 1)
        assert sorted(finished(folder)) == [
            "expert-tick-100-Car_6.png",
            "expert-tick-100-Car_6.svg",
            "expert-timeline.png",
            "expert-timeline.svg",
        ]
        for file in folder.glob("*.svg"):
            figure = xml.etree.ElementTree.parse(file).getroot()
            assert figure.tag.endswith("}svg")
            words = {element.text for element in figure.iter() if element.tag.endswith("}text")}
            assert {"Slow", "Normal", "Fast", "Stop"} <= words
            assert "Car_6 tiro" in words if "tick" in file.name else {"Car_6", "Pedestrian_8", "100"} <= words
            links = [value for element in figure.iter() for key, value in element.items() if key.endswith("href")]
            assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)
            assert bool(links) == ("tick" in file.name)
        for file in folder.glob("*.png"):
            content = file.read_bytes()
            assert content.startswith(b"\x89PNG") and len(content) > 20_000


def wait_for_files(browser: WebDriver, folder: pathlib.Path, count: int) -> None:
    WebDriverWait(browser, 10).until(lambda _: len(finished(folder)) == count)


def finished(folder: pathlib.Path) -> list[str]:
    return [file.name for file in folder.iterdir() if not file.name.endswith(".crdownload")]


def test_the_link_leads_to_the_same_decision(page: Callable[..., WebDriver]) -> None:
    browser = page("#tick=40")
    browser.execute_script(
        "Object.defineProperty(navigator, 'clipboard', {value: {writeText: async (text) => { window.copied = text; }}})"
    )
    browser.find_element(By.XPATH, "//*[@id='rows']/button[.='Car_9']").click()
    browser.find_element(By.ID, "copy").click()
    link = browser.execute_script("return window.copied")
    assert link.endswith("#tick=40&agent=Car_9") and "Copied the link" in text(browser, "notice")
    browser.get("about:blank")
    browser.get(link)
    wait_for(browser)
    assert text(browser, "tick") == "tick 40" and text(browser, "agent").startswith("Car_9")


def test_an_embedded_page_is_the_map_with_its_controls(page: Callable[..., WebDriver]) -> None:
    browser = page("?embed#tick=30&agent=Car_1")
    for hidden in ("title", "agent", "strip", "clauses", "save", "copy"):
        assert not browser.find_element(By.ID, hidden).is_displayed(), hidden
    for shown in ("map", "play", "scrub", "tick", "whole"):
        assert browser.find_element(By.ID, shown).is_displayed(), shown
    canvas = browser.find_element(By.ID, "map")
    assert canvas.size["width"] == browser.execute_script("return innerWidth")
    browser.find_element(By.ID, "play").click()
    WebDriverWait(browser, 10).until(lambda _: text(browser, "tick") != "tick 30")
    browser.find_element(By.ID, "play").click()
    link = browser.find_element(By.ID, "open").get_attribute("href")
    assert "?" not in link and "agent=Car_1" in link
    photograph(browser, "embed.png")


def test_a_bar_shows_the_loading_after_the_first_frame(page: Callable[..., WebDriver]) -> None:
    watch = """document.addEventListener("readystatechange", () => {
        const bar = document.getElementById("loading");
        if (!bar || window.progress) return;
        window.progress = [];
        new MutationObserver(() => window.progress.push([bar.value, bar.hidden]))
            .observe(bar, {attributes: true, attributeFilter: ["value", "hidden"]});
    });"""
    browser = page()
    script = browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": watch})
    try:
        page()
        *steps, (last, hidden) = browser.execute_script("return window.progress")
        values = [value for value, _ in steps]
        assert len(values) >= 4 and values == sorted(values) and values[0] < values[-1]
        assert last == 1 and hidden and not any(is_hidden for _, is_hidden in steps)
        first, loaded = browser.execute_script(
            "return ['first-frame', 'loaded'].map((name) => performance.getEntriesByName(name)[0].startTime)"
        )
        assert first < loaded
    finally:
        browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)


def test_a_foreign_script_does_not_run(folder: pathlib.Path, browser: WebDriver) -> None:
    hostile = """<script>window.foreign = 1</script><img src="x" onerror="window.foreign = 2">
<script src="data:text/javascript,window.foreign = 3"></script><style>body { color: rgb(1, 2, 3) }</style>"""
    html = (folder / "city.html").read_text()
    (folder / "hostile.html").write_text(html.replace("<header>", f"{hostile}<header>", 1))
    browser.get((folder / "hostile.html").as_uri())
    wait_for(browser)
    assert browser.execute_script("return window.foreign") is None
    assert browser.execute_script("return getComputedStyle(document.body).color") != "rgb(1, 2, 3)"
    refused = [entry["message"] for entry in browser.get_log("browser")]
    assert len(refused) >= 5 and all("Content Security Policy" in message for message in refused)


def test_the_page_names_no_path(tmp_path: pathlib.Path) -> None:
    html = tmp_path / "page.html"
    paths = ["--rules", ROOT / "rules/expert.dl", "--out", tmp_path, "--html", html]
    command = [PROGRAM, "run", ROOT / "configs/expert.yaml", "--ticks", "3", "--no-pictures", *paths]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    file = html.read_text()
    parts = re.findall(r'<script class="data"[^>]*>([^<]*)<', file)
    assert len(parts) >= 3
    for content in [file, *(zlib.decompress(base64.b64decode(part)).decode() for part in parts)]:
        assert str(ROOT) not in content and str(tmp_path) not in content


def test_the_rows_and_ticks_of_the_chart_are_named(page: Callable[..., WebDriver], trace: list[dict]) -> None:
    browser = page()
    kinds = {"Car": [], "Pedestrian": []}
    for agent in trace[0]["agents"]:
        kinds[agent["type"]].append(agent["id"])
    expected = [row for kind, agents in kinds.items() for row in [f"▾ {kind} ({len(agents)})", *agents]]
    assert rows(browser) == expected
    strip = browser.find_element(By.ID, "strip").rect
    for place, row in enumerate(browser.find_elements(By.CSS_SELECTOR, "#rows button")):
        middle = row.rect["y"] + row.rect["height"] / 2 - strip["y"]
        assert int(middle / strip["height"] * len(expected)) == place
    for label in browser.find_elements(By.CSS_SELECTOR, "#axis span:not(.start, .end)"):
        wanted = strip["x"] + (int(label.text) + 0.5) / TICKS * strip["width"]
        assert abs(label.rect["x"] + label.rect["width"] / 2 - wanted) < 2


@pytest.fixture(scope="module")
def sixty(folder: pathlib.Path) -> list[dict]:
    """Write `sixty.html`: a run of 60 agents. Return its trace."""
    config = folder / "sixty.yaml"
    config.write_text(
        "base: expert\nregion: 373\nagents:\n  test:\n    cars:\n      - {priority: 1, count: 20, concepts: [bus]}\n"
        "      - {priority: 2, count: 20, concepts: [tiro]}\n    pedestrians: [{count: 20}]\n"
    )
    options = ["--ticks", "60", "--no-pictures", "--out", folder / "sixty", "--html", folder / "sixty.html"]
    subprocess.run([PROGRAM, "run", config, *options], cwd=ROOT, check=True, capture_output=True)
    return [json.loads(line) for line in (folder / "sixty/trace.jsonl").read_text().splitlines()]


SHOWN = "return arguments[0].getBoundingClientRect().toJSON()"


def box_of(browser: WebDriver, element: str) -> dict[str, float]:
    return browser.execute_script(SHOWN, browser.find_element(By.ID, element))


@pytest.mark.parametrize("width", [757, 1400])
def test_the_map_has_room_beside_many_agents(folder: pathlib.Path, sixty: list[dict], width: int) -> None:
    browser = start(width, 757)
    try:
        metrics = {"width": width, "height": 757, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        browser.get((folder / "sixty.html").as_uri())
        wait_for(browser)
        photograph(browser, f"sixty-{width}.png")
        before = box_of(browser, "stages")["height"]
        assert before > (255 if width == 757 else 330)
        # Keys on the bar move it, and do nothing else.
        bar = browser.find_element(By.ID, "split-below")
        share = int(bar.get_attribute("aria-valuenow"))
        bar.send_keys(*[Keys.ARROW_DOWN] * 4)
        larger = box_of(browser, "stages")["height"]
        assert larger - before > 0.07 * 650 and text(browser, "tick") == "tick 0"
        assert int(bar.get_attribute("aria-valuenow")) - share in range(7, 10)
        bar.send_keys(Keys.HOME)
        assert bar.get_attribute("aria-valuenow") == bar.get_attribute("aria-valuemin") == "25"
        bar.send_keys(Keys.END)
        assert bar.get_attribute("aria-valuenow") == bar.get_attribute("aria-valuemax") == "85"
        # The pointer moves it as far as it goes.
        ActionChains(browser).drag_and_drop_by_offset(bar, 0, -200).perform()
        moved = box_of(browser, "split-below")["y"]
        wide = box_of(browser, "side")["width"]
        if width > 820:
            ActionChains(browser).drag_and_drop_by_offset(browser.find_element(By.ID, "split-side"), -100, 0).perform()
            assert abs(box_of(browser, "side")["width"] - wide - 100) < 3
            wide = box_of(browser, "side")["width"]
        # The browser remembers both.
        browser.refresh()
        wait_for(browser)
        assert abs(box_of(browser, "split-below")["y"] - moved) < 2
        assert abs(box_of(browser, "side")["width"] - wide) < 2
        for bar in browser.find_elements(By.CSS_SELECTOR, ".split"):
            if bar.is_displayed():
                bar.send_keys(Keys.ENTER)
        assert abs(box_of(browser, "stages")["height"] - before) < 2
        assert browser.get_log("browser") == []
    finally:
        browser.quit()


def test_agents_are_found_by_name_kind_and_action(page: Callable[..., WebDriver], sixty: list[dict]) -> None:
    header, tick = sixty[0], sixty[41]
    states = dict(zip([agent["id"] for agent in header["agents"]], tick["agents"], strict=True))
    browser = page("#tick=40", "sixty.html")
    body, field = browser.find_element(By.TAG_NAME, "body"), browser.find_element(By.ID, "find-name")
    body.send_keys("/")
    assert browser.switch_to.active_element == field
    field.send_keys("bus")
    assert text(browser, "found") == "20 of 60 agents"
    assert rows(browser) == [
        "▾ Car (20/40)",
        *(agent["id"] for agent in header["agents"] if "bus" in agent["concepts"]),
    ]
    assert "20 of 60 agents match the filter" in text(browser, "agent")
    photograph(browser, "found.png")
    # Keys in the field are text.
    assert text(browser, "tick") == "tick 40"
    field.send_keys(Keys.ESCAPE)
    assert len(rows(browser)) == 62 and text(browser, "found") == ""
    Select(browser.find_element(By.ID, "find-kind")).select_by_visible_text("Pedestrian (20)")
    assert rows(browser)[0] == "▾ Pedestrian (20)" and len(rows(browser)) == 21
    Select(browser.find_element(By.ID, "find-kind")).select_by_index(0)
    # Cars stand before pedestrians.
    stopped = sorted((name for name, state in states.items() if state["action"] == "Stop"), key=lambda name: name[0])
    Select(browser.find_element(By.ID, "find-action")).select_by_visible_text("Stop")
    assert [row for row in rows(browser) if "(" not in row] == stopped
    links = [link.text for link in browser.find_elements(By.CSS_SELECTOR, "#agent .agents .agent-link")]
    assert links == stopped
    # The keys for the next agent pass those that do not match.
    browser.execute_script("document.activeElement.blur()")
    for name in [*stopped[:3]]:
        body.send_keys("n")
        assert text(browser, "agent").startswith(name)
    body.send_keys("p")
    assert text(browser, "agent").startswith(stopped[1])
    shown = pixels(browser)
    browser.find_element(By.ID, "find-all").click()
    assert len(rows(browser)) == 62 and pixels(browser) != shown
    # The strip has no row that the names do not have.
    strip, names = box_of(browser, "strip"), box_of(browser, "rows")
    assert strip["height"] == names["height"]


def test_a_group_can_be_closed(page: Callable[..., WebDriver], sixty: list[dict]) -> None:
    browser = page("#tick=5", "sixty.html")
    group = browser.find_element(By.CSS_SELECTOR, "#rows .group")
    assert group.get_attribute("aria-expanded") == "true"
    group.click()
    group = browser.find_element(By.CSS_SELECTOR, "#rows .group")
    assert group.get_attribute("aria-expanded") == "false" and group.text == "▸ Car (40)"
    assert len(rows(browser)) == 22
    # The row of the group has the shares of the actions: in this tick, from the top, in the order of the legend.
    actions = ["Slow", "Normal", "Fast", "Stop"]
    cars = [
        state["action"]
        for agent, state in zip(sixty[0]["agents"], sixty[6]["agents"], strict=True)
        if agent["type"] == "Car"
    ]
    colors = {"Slow": "#a06a00", "Normal": "#0b7f5b", "Fast": "#2f6fb0", "Stop": "#c8401a"}
    column = """const strip = document.getElementById("strip"), x = Math.floor(5.5 / 60 * strip.width);
        const {data} = strip.getContext("2d").getImageData(x, 0, 1, 13);
        return Array.from({length: 13}, (_, y) => "#" + [0, 1, 2].map((at) =>
            data[4 * y + at].toString(16).padStart(2, "0")).join(""));"""
    found = browser.execute_script(column)
    expected = [color for action in actions for color in [colors[action]] * round(13 * cars.count(action) / 40)]
    assert found[0] == expected[0] and found[-1] == expected[-1]
    for action in actions:
        assert abs(found.count(colors[action]) - 13 * cars.count(action) / 40) <= 1.5
    photograph(browser, "closed.png")
    group.click()
    assert len(rows(browser)) == 62


def test_targets_are_large_enough_for_fingers(folder: pathlib.Path, sixty: list[dict], other: list[dict]) -> None:
    browser = start(500, 1000)
    targets = """const found = [];
        for (const one of document.querySelectorAll("a, button, input, select, summary, [role=separator], canvas")) {
            const {width, height} = one.getBoundingClientRect();
            if (!one.checkVisibility() || !width || one.closest("[popover]")) continue;
            const name = one.id || one.className || one.textContent;
            if (width < 24 || height < 24) found.push(`${name}: ${width} x ${height}`);
        }
        return found;"""
    try:
        metrics = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        for name in ("sixty.html", "pair.html"):
            for address in ("#tick=30", "#tick=30&agent=Car_2"):
                browser.get("about:blank")
                browser.get((folder / name).as_uri() + address)
                wait_for(browser)
                for tab in ("why", "time", "rules"):
                    browser.find_element(By.CSS_SELECTOR, f"#tabs [data-tab={tab}]").click()
                    assert browser.execute_script(targets) == [], (name, address, tab)
                    photograph(browser, f"phone-{tab}-{name}.png")
    finally:
        browser.quit()


def test_a_long_name_leaves_room_for_the_titles(page: Callable[..., WebDriver], folder: pathlib.Path) -> None:
    name = "Waits" + "x" * 250
    rules = folder / "long.dl"
    rules.write_text(
        f'.include "vocabulary.dl"\n.decl {name}(x: agent)\n/// L1: it waits\n'
        f"{name}(X) :- IsAtInter(X), IsInInter(Y).\n"
        f"/// S1: stop\nStop(X) :- {name}(X).\nStop(X) :- CollidingClose(X, Y).\n"
    )
    options = ["--rules", rules, "--ticks", "20", "--no-pictures", "--out", folder / "long"]
    command = [PROGRAM, "run", "expert", *options, "--html", folder / "long.html"]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    browser = page("#tick=3&agent=Car_2", "long.html")
    box = browser.find_element(By.ID, "clause-box").rect["width"]
    cells = browser.find_elements(By.CSS_SELECTOR, "#clauses tr:nth-child(2) td")
    assert cells[1].get_attribute("title") == name and cells[2].text == "L1: it waits"
    assert cells[1].rect["width"] < 0.4 * box and cells[2].rect["width"] > 0.4 * box
    assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
    photograph(browser, "long.png")


def test_the_map_opens_on_the_agents(
    page: Callable[..., WebDriver], tmp_path: pathlib.Path, folder: pathlib.Path
) -> None:
    config = folder / "corner.yaml"
    config.write_text("base: easy\nregion: 100\nagents: {test: {cars: [{priority: 1, count: 3}]}}\n")
    options = ["--ticks", "3", "--no-pictures", "--out", tmp_path, "--html", folder / "corner.html"]
    subprocess.run([PROGRAM, "run", config, *options], cwd=ROOT, check=True, capture_output=True)
    browser = page(name="corner.html")
    button = browser.find_element(By.ID, "whole")
    first = pixels(browser)
    assert button.get_attribute("aria-label") == "show the whole map"
    photograph(browser, "corner.png")
    button.click()
    whole = pixels(browser)
    assert whole != first and button.get_attribute("aria-label") == "show all agents"
    button.click()
    assert pixels(browser) == first
    browser.find_element(By.ID, "closer").click()
    assert button.get_attribute("aria-label") == "show all agents"
    button.click()
    assert pixels(browser) == first


def measure(pages: list[str]) -> None:
    """Print the size of each page, and the median times of five visits, from navigation on."""
    browser = start(1400, 1000)
    try:
        for name in pages:
            file = pathlib.Path(name).resolve()
            visits = []
            for _ in range(5):
                browser.get("about:blank")
                browser.get(file.as_uri())
                wait_for(browser)
                marks = (
                    "return ['first-frame', 'loaded'].map((name) => performance.getEntriesByName(name)[0].startTime)"
                )
                visits.append(browser.execute_script(marks))
            first, loaded = (statistics.median(times) / 1000 for times in zip(*visits, strict=True))
            size = file.stat().st_size / 1e6
            print(f"{name}: {size:.1f} MB, first frame after {first:.2f} s, all explanations after {loaded:.2f} s")
    finally:
        browser.quit()


if __name__ == "__main__":
    if not (CHROMIUM and DRIVER):
        print(SKIPPED)
        sys.exit(0)
    if sys.argv[1:]:
        measure(sys.argv[1:])
        sys.exit(0)
    sys.exit(pytest.main(["-q", __file__]))
