"""Tests the playground in headless Chromium: edits rules, reads diagnostics, asks cars, measures frames.

`make playground` builds target/playground and runs this file as a program. Without a browser it prints what it skips
and exits with 0; with one it exits as pytest does. Tests write screenshots to the folder LOGICITY_SCREENSHOTS if it is
set.
"""

import functools
import http.server
import json
import pathlib
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest
from page_in_browser import CHROMIUM, DRIVER, PROGRAM, ROOT, photograph, premises, scrub, start, text, wait_for
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webdriver import WebDriver
from selenium.webdriver.support.ui import Select
from selenium.webdriver.support.wait import WebDriverWait

SITE = ROOT / "target/playground"
SKIPPED = (
    "SKIPPED: the tests of the playground (tests/playground_in_browser.py) need chromium and chromedriver."
    " On Debian: apt-get install chromium chromium-driver"
)
FAULT = "\nStop(X) :- IsYoung(X), NextTo(X, Y), IsBuss(Y)."
TICKS = 60

# Keeps the workers of a page for the tests.
WATCH = """window.workers = [];
    window.Worker = class extends Worker {
        constructor(...given) { super(...given); window.workers.push(this); }
    };"""


class Handler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def site() -> Iterator[str]:
    """Serve the playground as any static file server does."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=SITE))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The trace of the run that the playground shows first."""
    folder = tmp_path_factory.mktemp("run")
    options = ["--ticks", str(TICKS), "--no-pictures", "--out", folder]
    subprocess.run([PROGRAM, "run", "expert", *options], cwd=folder, check=True, capture_output=True)
    return folder / "trace.jsonl"


@pytest.fixture(scope="module")
def browser() -> Iterator[WebDriver]:
    browser = start(1500, 1000)
    browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": WATCH})
    yield browser
    browser.quit()


@pytest.fixture
def page(browser: WebDriver, site: str) -> Iterator[Callable[..., WebDriver]]:
    """Open the playground at an address. After the test, the browser may not have reported an error."""

    def open_at(address: str = "") -> WebDriver:
        browser.get("about:blank")
        browser.get(site + address)
        wait_for(browser)
        return browser

    yield open_at
    assert browser.get_log("browser") == []
    assert not browser.find_element(By.ID, "fault").is_displayed()


def until(browser: WebDriver, holds: Callable[[], object], seconds: float = 20) -> None:
    WebDriverWait(browser, seconds).until(lambda _: holds())


def tick(browser: WebDriver) -> int:
    return int(text(browser, "tick").split()[1])


def pause(browser: WebDriver) -> None:
    if browser.find_element(By.ID, "play").get_attribute("aria-label") == "pause":
        browser.find_element(By.ID, "play").click()


def write(browser: WebDriver, rules: str) -> None:
    """Replace the rules at once, as pasting does."""
    change = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(change, browser.find_element(By.ID, "text"), rules)


def rules(browser: WebDriver) -> str:
    return str(browser.find_element(By.ID, "text").get_property("value"))


def checked(browser: WebDriver, state: str = "good") -> None:
    """Wait until the rules are checked."""
    until(browser, lambda: state in (browser.find_element(By.ID, "status").get_attribute("class") or ""))


def actions(browser: WebDriver) -> dict[str, str]:
    """The actions of all agents, from the list that the page shows while no agent is chosen."""
    items = browser.execute_script("return [...document.querySelectorAll('#agent li')].map((item) => item.textContent)")
    return dict(item.split() for item in items)


def test_a_rule_is_edited(page: Callable[..., WebDriver], tmp_path: pathlib.Path) -> None:
    browser = page()
    checked(browser)
    assert len(actions(browser)) == 18
    before = rules(browser)
    area = browser.find_element(By.ID, "text")
    area.send_keys(Keys.CONTROL, Keys.END)
    area.send_keys(Keys.NULL, FAULT)
    checked(browser, "bad")
    assert "1 error. The city keeps the last rules that worked." in text(browser, "status")
    assert rules(browser) == before + FAULT
    # The message is that of the command line.
    (tmp_path / "rules.dl").write_text(before + FAULT)
    said = subprocess.run([PROGRAM, "check", "rules.dl"], cwd=tmp_path, capture_output=True, text=True).stderr
    shown = str(browser.execute_script("return document.querySelector('#faults pre').textContent"))
    assert shown.strip() in said and "did you mean `IsBus`?" in shown
    line = len((before + FAULT).splitlines())
    assert f"rules.dl:{line}:{FAULT.index('IsBuss')}" in shown
    caret = (
        "const {scrollTop, clientHeight, scrollHeight} = arguments[0]; return scrollHeight - scrollTop - clientHeight"
    )
    assert browser.execute_script(caret, area) < 60, "the line of the caret stays in view"
    marked = browser.find_element(By.CSS_SELECTOR, "#marks .error")
    assert marked.get_property("textContent") == "IsBuss"
    # The line of the fault is marked, and the copies of the text wrap as the text does.
    lines = browser.find_elements(By.CSS_SELECTOR, "#colors .line")
    assert len(lines) == line and "error" in (lines[-1].get_attribute("class") or "")
    heights = "return ['text', 'colors', 'marks'].map((id) => document.getElementById(id).scrollHeight)"
    assert len({round(height / 10) for height in browser.execute_script(heights)}) == 1
    photograph(browser, "playground-fault.png")
    # The last good rules still run.
    now = tick(browser)
    until(browser, lambda: tick(browser) > now)
    # A click on the message leads to its place.
    browser.find_element(By.CSS_SELECTOR, "#faults button").click()
    selected = "const area = arguments[0]; return area.value.slice(area.selectionStart, area.selectionEnd)"
    assert browser.execute_script(selected, area) == "IsBuss"
    area.send_keys("IsBus")
    checked(browser)
    assert not browser.find_elements(By.CSS_SELECTOR, "#faults pre")
    assert not browser.find_elements(By.CSS_SELECTOR, "#marks .error")


def test_edited_rules_take_effect_in_the_running_city(page: Callable[..., WebDriver]) -> None:
    browser = page()
    checked(browser)
    until(browser, lambda: tick(browser) >= 5)
    pause(browser)
    now = tick(browser)
    cars = [name for name in actions(browser) if name.startswith("Car")]
    write(browser, '.include "vocabulary.dl"\nStop(X) :- IsCar(X).')
    checked(browser, "warned")
    # The tick that the page shows is decided again, under the new rules.
    assert tick(browser) == now
    assert all(actions(browser)[car] == "Stop" for car in cars)
    browser.find_element(By.ID, "reset").click()
    until(browser, lambda: tick(browser) == 0)
    assert all(actions(browser)[car] == "Stop" for car in cars)


def test_the_city_is_that_of_the_program(page: Callable[..., WebDriver], trace: pathlib.Path) -> None:
    header, *ticks = [json.loads(line) for line in trace.read_text().splitlines()]
    names = [agent["id"] for agent in header["agents"]]
    browser = page("#mode=expert&seed=0")
    pause(browser)
    scrub(browser, 0)
    for expected in ticks[:40]:
        assert tick(browser) == expected["tick"]
        wanted = dict(zip(names, [agent["action"] for agent in expected["agents"]], strict=True))
        assert actions(browser) == wanted
        browser.find_element(By.ID, "on").click()
        until(browser, lambda expected=expected: tick(browser) == expected["tick"] + 1)


def test_a_clicked_car_explains_itself(page: Callable[..., WebDriver], trace: pathlib.Path) -> None:
    header, *ticks = [json.loads(line) for line in trace.read_text().splitlines()]
    names = [agent["id"] for agent in header["agents"]]
    # A car that stops far from other agents and from the edges, where the map cannot center it.
    number, agent = next(
        (one["tick"], agent)
        for one in ticks[3:50]
        for agent, state in enumerate(one["agents"])
        if state["action"] == "Stop"
        and names[agent].startswith("Car")
        and all(40 < place < 200 for place in state["at"])
        and min(
            max(abs(state["at"][axis] - other["at"][axis]) for axis in (0, 1))
            for other in one["agents"]
            if other is not state
        )
        > 3
    )
    browser = page()
    until(browser, lambda: tick(browser) > number)
    pause(browser)
    scrub(browser, number)
    next(
        link for link in browser.find_elements(By.CSS_SELECTOR, "#agent .agent-link") if link.text == names[agent]
    ).click()
    body = browser.find_element(By.TAG_NAME, "body")
    body.send_keys("f", *"++++++++", Keys.ESCAPE)
    assert "Click an agent" in text(browser, "agent")
    ActionChains(browser).move_to_element(browser.find_element(By.ID, "map")).click().perform()
    until(browser, lambda: "Why Stop?" in text(browser, "agent") and "loading" not in text(browser, "agent"))
    shown = text(browser, "agent")
    action, literals = premises(trace, number, names[agent])
    assert shown.startswith(names[agent]) and action == text(browser, "action") == "Stop"
    assert literals and all(literal in shown for literal in literals)
    assert "Why not Normal?" in shown
    photograph(browser, "playground-why.png")


def test_the_city_moves_smoothly(page: Callable[..., WebDriver]) -> None:
    browser = page()
    checked(browser)
    count = """const [seconds, done] = arguments;
        let frames = 0, begin;
        const next = (time) => {
            begin ??= time;
            if (time - begin >= 1000 * seconds) return done(frames / (time - begin) * 1000);
            frames += 1;
            requestAnimationFrame(next);
        };
        requestAnimationFrame(next);"""
    before = tick(browser)
    browser.set_script_timeout(60)
    rate = browser.execute_async_script(count, 5)
    ticks = tick(browser) - before
    print(f"{len(actions(browser))} agents: {rate:.0f} frames per second, {ticks} ticks in 5 s")
    assert len(actions(browser)) == 18 and rate >= 10 and ticks >= 5


def test_a_link_keeps_the_rules(page: Callable[..., WebDriver]) -> None:
    browser = page("#mode=hard&seed=18446744073709551615")
    assert browser.find_element(By.ID, "seed").get_property("value") == "18446744073709551615"
    checked(browser)
    mine = '.include "vocabulary.dl"\n/// Stop — für alle 🚗.\nStop(X) :- IsCar(X), CollidingClose(X, Y).'
    write(browser, mine)
    checked(browser)
    until(browser, lambda: "rules=" in browser.current_url)
    link = browser.current_url
    page(link.split("/")[-1])
    assert rules(browser) == mine and Select(browser.find_element(By.ID, "mode")).first_selected_option.text == "hard"
    damaged = re.sub(r"rules=.{4}", "rules=", link.split("/")[-1]).replace("mode=hard", "mode=none")
    page(damaged)
    assert "no mode none" in text(browser, "notice") and "rules in the link are damaged" in text(browser, "notice")
    page("#seed=-1")
    assert "no seed -1" in text(browser, "notice")


def test_a_mode_replaces_the_rules_and_brings_them_back(page: Callable[..., WebDriver]) -> None:
    browser = page()
    checked(browser)
    mine = rules(browser) + "\n// mine"
    write(browser, mine)
    checked(browser)
    Select(browser.find_element(By.ID, "mode")).select_by_value("easy")
    until(browser, lambda: "Loaded the rules of easy" in text(browser, "notice"))
    assert "mode=easy" in browser.current_url and "IsTiro" not in rules(browser)
    browser.find_element(By.CSS_SELECTOR, "#notice button").click()
    until(browser, lambda: rules(browser) == mine)
    until(browser, lambda: "mode=expert" in browser.current_url)
    seed = browser.find_element(By.ID, "seed")
    seed.clear()
    seed.send_keys("many", Keys.TAB)
    until(browser, lambda: "not a seed" in text(browser, "notice") or seed.get_property("value") == "0")


def test_every_mode_is_that_of_the_program(page: Callable[..., WebDriver], tmp_path: pathlib.Path) -> None:
    """The rules of a mode are merged into one text, and decide as the files do."""
    browser = page()
    modes = [option.text for option in Select(browser.find_element(By.ID, "mode")).options]
    assert len(modes) == 9
    for mode in modes:
        options = ["--seed", "2", "--ticks", "8", "--no-pictures", "--out", tmp_path / mode]
        subprocess.run([PROGRAM, "run", mode, *options], cwd=tmp_path, check=True, capture_output=True)
        header, *ticks = [json.loads(line) for line in (tmp_path / mode / "trace.jsonl").read_text().splitlines()]
        page(f"#mode={mode}&seed=2")
        assert "bad" not in (browser.find_element(By.ID, "status").get_attribute("class") or "")
        until(browser, lambda: tick(browser) > 7)
        pause(browser)
        for expected in ticks:
            scrub(browser, expected["tick"])
            names = [agent["id"] for agent in header["agents"]]
            wanted = [agent["action"] for agent in expected["agents"]]
            assert actions(browser) == dict(zip(names, wanted, strict=True)), f"{mode}, tick {expected['tick']}"


HOSTILE = {
    "counting": ".decl n(x: number)\nn(0).\nn(x + 1) :- n(x), x < 1000000000.\n"
    "Stop(X) :- IsCar(X), n(y), y > 999999999.",
    "product": ".decl all(a: agent, b: agent, c: agent, d: agent, e: agent, f: agent, g: agent)\n"
    "all(A, B, C, D, E, F, G) :- "
    + ", ".join(f"IsCar({name})" for name in "ABCDEFG")
    + ".\nStop(X) :- all(X, _, _, _, _, _, _).",
    "text": "Stop(X) :- " + "(" * 5000,
    "empty": "",
    "control": '\0\x01"\n/*',
}


@pytest.mark.parametrize("name", HOSTILE)
def test_costly_and_broken_rules_do_not_stop_the_page(page: Callable[..., WebDriver], name: str) -> None:
    browser = page()
    checked(browser)
    write(browser, f'.include "vocabulary.dl"\n{HOSTILE[name]}')
    frames = """window.frames_seen = 0;
        const next = () => { window.frames_seen += 1; requestAnimationFrame(next) };
        next()"""
    browser.execute_script(frames)
    until(browser, lambda: browser.find_element(By.ID, "status").get_attribute("class"), 60)
    said = text(browser, "faults").splitlines()
    print(f"{name}: {text(browser, 'status')} {said[0] if said else ''}")
    assert text(browser, "notice") == ""
    if name == "counting":
        assert "limit-exceeded" in said[0]
    assert browser.execute_script("return window.frames_seen") > 5
    now = tick(browser)
    until(browser, lambda: tick(browser) > now)
    write(browser, '.include "vocabulary.dl"\nStop(X) :- CollidingClose(X, Y).')
    checked(browser)


def test_a_defect_of_the_engine_is_reported(page: Callable[..., WebDriver]) -> None:
    browser = page()
    checked(browser)
    until(browser, lambda: tick(browser) > 20)
    # The next message of the engine is a panic.
    browser.execute_script(
        """const [worker] = window.workers, heard = worker.onmessage;
        worker.onmessage = ({data: {id}}) => heard({data: {id, fault: "panicked at a test"}});"""
    )
    until(browser, lambda: "The engine stopped: panicked at a test" in text(browser, "notice"))
    until(browser, lambda: 0 < tick(browser) < 20)


def test_a_library_that_cannot_be_loaded_is_reported_once() -> None:
    requests: list[str] = []

    class Missing(Handler):
        def do_GET(self) -> None:
            requests.append(self.path)
            if self.path.startswith("/logicity_playground"):
                self.send_error(404)
            else:
                super().do_GET()

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Missing, directory=SITE))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = start(1500, 1000)
    try:
        browser.get(f"http://127.0.0.1:{server.server_port}/")
        until(browser, browser.find_element(By.ID, "fault").is_displayed)
        assert "the library cannot be loaded; reload the page" in text(browser, "fault")
        # The worker of the city and that of the checks request it. One that restarts would do so again.
        time.sleep(1)
        assert requests.count("/logicity_playground.js") == 2
    finally:
        browser.quit()
        server.shutdown()


def test_a_phone_needs_no_horizontal_scrolling(site: str) -> None:
    browser = start(390, 844)
    try:
        for dark in (False, True):
            browser.execute_cdp_cmd(
                "Emulation.setDeviceMetricsOverride",
                {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True},
            )
            scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
            browser.get("about:blank")
            browser.get(site)
            wait_for(browser)
            checked(browser)
            wide, room = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
            assert wide <= room == 390
            assert browser.find_element(By.ID, "text").is_displayed()
            photograph(browser, f"playground-phone-{'dark' if dark else 'light'}.png")
            browser.find_element(By.CSS_SELECTOR, "#tabs [data-tab=why]").click()
            pause(browser)
            browser.find_element(By.CSS_SELECTOR, "#agent .agent-link").click()
            until(browser, lambda: "Why" in text(browser, "agent"))
            assert not browser.find_element(By.ID, "text").is_displayed()
            wide, room = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
            assert wide <= room
            photograph(browser, f"playground-phone-why-{'dark' if dark else 'light'}.png")
        assert browser.get_log("browser") == []
    finally:
        browser.quit()


def test_the_theme_can_be_changed(page: Callable[..., WebDriver]) -> None:
    browser = page()
    checked(browser)
    color = "return getComputedStyle(document.body).backgroundColor"
    light = browser.execute_script(color)
    photograph(browser, "playground-light.png")
    browser.find_element(By.ID, "theme").click()
    assert browser.execute_script(color) != light
    photograph(browser, "playground-dark.png")


if __name__ == "__main__":
    if not (CHROMIUM and DRIVER):
        print(SKIPPED)
        sys.exit(0)
    # `-s` shows the measured rate.
    sys.exit(pytest.main(["-q", "-s", "-p", "no:cacheprovider", *sys.argv[1:], __file__]))
