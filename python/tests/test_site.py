"""The pictures that the site makes: `docs/chart.py` draws every row of results, `docs/dark.py` a dark animation."""

from __future__ import annotations

import importlib.util
import io
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import needs

needs("pydantic", "learn")

from logicity.evaluation import Interval  # noqa: E402
from logicity.experiments.results import Headline, leaderboard, read_results  # noqa: E402

ROOT = Path(__file__).parents[2]
SVG = "{http://www.w3.org/2000/svg}"


def module_of_site(name: str) -> ModuleType:
    """Load a module of the folder `docs`."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    # Data classes look their module up.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def chart() -> ModuleType:
    return module_of_site("chart")


def headlines(name: str) -> tuple[str, Mapping[str, Sequence[Headline]]]:
    """Return the measure and the rows of a file of results."""
    needs("torch", "vap")
    found = {}

    def keep(measure: str, modes: Mapping[str, Sequence[Headline]]) -> str:
        found[measure] = modes
        return ""

    leaderboard(read_results(ROOT / "results" / f"{name}.json", name), draw=keep)
    [(measure, modes)] = found.items()
    return measure, modes


def drawings(text: str) -> list[ElementTree.Element]:
    """Return the SVG elements of a chart that have a description."""
    found = [ElementTree.fromstring(svg) for svg in re.findall(r"<svg .*?</svg>", text, re.DOTALL)]
    return [svg for svg in found if svg.get("role") == "img"]


def row(name: str, value: float, paper: float | None = None) -> Headline:
    return Headline(name, Interval(value, max(value - 0.1, 0.0), min(value + 0.1, 1.0)), paper)


@pytest.mark.parametrize("name", ["communication", "transfer", "vap-continual"])
def test_every_row_of_the_results_has_a_mark(chart: ModuleType, name: str) -> None:
    measure, modes = headlines(name)
    axis = chart.AXES[name]
    text = chart.draw(measure, modes, axis)
    for mode, rows in modes.items():
        own = chart.draw(measure, {mode: rows}, axis)
        assert own.partition("<figure")[2].rstrip("`\n") in text
        titles = [title.text or "" for svg in drawings(own) for title in svg.iter(f"{SVG}title")]
        labels = [svg.get("aria-label") or "" for svg in drawings(own)]
        for line in rows:
            value = f"{line.measured.value:.2f}"
            if re.search(axis.number, line.name):
                assert any(title.startswith(f"{line.name}: {value} [") for title in titles), line
            assert any(value in label for label in labels), line
        assert all(label.count(f": {measure} by {axis.label} (") == 1 for label in labels)


def test_marks_lie_where_their_values_are(chart: ModuleType) -> None:
    axis = chart.Axis(r"\bnoise ([\d.]+)", "noise", "circumstances")
    rows = [
        row("a, noise 0, alone", 1.0),
        row("a, noise 0.2, alone", 0.25, paper=0.5),
        row("a, noise 0.05, alone", 0.75),
    ]
    [svg] = drawings(chart.draw("TSR", {"easy": rows}, axis))
    [curve] = [path for path in svg.iter(f"{SVG}path") if path.get("class") == "line s0"]
    places = [tuple(map(float, pair.split())) for pair in (curve.get("d") or "")[1:].split(" L")]
    width, height = chart.RIGHT - chart.LEFT, chart.BOTTOM - chart.TOP
    shares = [(0.0, 1.0), (0.25, 0.75), (1.0, 0.25)]
    expected = [(chart.LEFT + width * x, chart.BOTTOM - height * y) for x, y in shares]
    assert places == [pytest.approx(place, abs=0.06) for place in expected]
    [paper] = [path for path in svg.iter(f"{SVG}path") if (path.get("class") or "").startswith("paper")]
    assert f" {chart.BOTTOM - height / 2:.1f} h" in (paper.get("d") or "")
    assert svg.get("aria-label") == "alone: TSR by noise (0, 0.05, 0.2). a 1.00, 0.75, 0.25"


def test_a_common_row_begins_each_line_that_continues_its_name(chart: ModuleType) -> None:
    axis = chart.Axis(r"\bk (\d+)", "k", "circumstances")
    rows = [row("a, range 12, k 0", 0.2), row("a, range 12, k 1, distance", 0.4), row("a, range 12, k 1, random", 0.3)]
    labels = [svg.get("aria-label") for svg in drawings(chart.draw("TSR", {"easy": rows}, axis))]
    assert labels == [
        "range 12, distance: TSR by k (0, 1). a 0.20, 0.40",
        "range 12, random: TSR by k (0, 1). a 0.20, 0.30",
    ]


def test_a_row_without_a_number_is_a_level(chart: ModuleType) -> None:
    axis = chart.Axis(r"\b(\d+) %", "share", "learners", plain="from easy")
    rows = [row("gnn, 1 %", 0.2), row("gnn, 100 %", 0.9), row("gnn, from scratch", 0.8)]
    [svg] = drawings(chart.draw("wAcc", {"hard": rows}, axis))
    [level] = [path for path in svg.iter(f"{SVG}path") if (path.get("class") or "").startswith("level")]
    assert f" {chart.BOTTOM - 0.8 * (chart.BOTTOM - chart.TOP):.1f} H{chart.RIGHT}" in (level.get("d") or "")
    assert svg.get("aria-label") == "gnn: wAcc by share (1, 100). from easy 0.20, 0.90; from scratch 0.80"


def test_names_of_rows_fit_beside_the_scale(chart: ModuleType) -> None:
    rows = [row("a learner with a rather long name", 0.5), row("b", 0.1)]
    [svg] = drawings(chart.draw("TSR", {"easy": rows}))
    ends = [float(text.get("x") or 0) for text in svg.iter(f"{SVG}text") if text.get("text-anchor") == "end"]
    assert min(ends) >= chart.CHARACTER * len(rows[0].name)
    assert chart.draw("TSR", {"easy": [row(f"r{at}", 0.5) for at in range(chart.LINES_MAX + 1)]}) == ""


def test_the_dark_animation_has_a_dim_map_in_a_dark_margin() -> None:
    image = needs("PIL.Image", "vap")
    dark = module_of_site("dark")
    animation = (ROOT / "docs/images/city.gif").read_bytes()
    made = dark.darkened(animation)
    assert len(made) < 1.2 * len(animation)
    with image.open(io.BytesIO(animation)) as light, image.open(io.BytesIO(made)) as night:
        assert light.n_frames == night.n_frames and light.info["duration"] == night.info["duration"]
        for frame in (0, 1, light.n_frames - 1):
            light.seek(frame)
            night.seek(frame)
            before, after = (np.asarray(one.convert("RGB"), np.int64) for one in (light, night))
            paper = (before == before[0, 0]).all(axis=2)
            rows, columns = (np.flatnonzero((~paper).mean(axis=axis) > 0.5) for axis in (1, 0))
            inside = np.zeros(paper.shape, bool)
            inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
            for color, other in dark.MARGIN.items():
                changed = after[~inside & (before == color).all(axis=2)]
                assert len(changed) > 100 and (changed == other).all()
            # Few colors are replaced by a near one.
            off = np.abs(after - (before * dark.DIM).astype(np.int64)).max(axis=2)[inside]
            assert off.max() <= 40 and (off > 8).mean() < 0.01
    with pytest.raises(ValueError, match="paper"):
        other = io.BytesIO()
        image.new("RGB", (40, 40), "red").save(other, "GIF")
        dark.darkened(other.getvalue())
