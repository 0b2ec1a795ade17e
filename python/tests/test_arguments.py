"""Arguments of wrong types: every function names the argument and the type that it expects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, needs

import logicity
from logicity import questions
from logicity.offline import demonstrations
from logicity.vap import Drawing, VapDataset, check_dataset, make_dataset, measure_baselines, to_coco, to_webdataset


def write_trace(path: Any) -> None:
    env = logicity.envs.SPFEnv("easy")
    env.reset(seed=0)
    env.step(1)
    env.write_trace(path)


#: Functions of one path, each with the name of its argument.
PATHS: list[tuple[str, Callable[[Any], object]]] = [
    ("path", write_trace),
    ("path", logicity.Program.load),
    ("path", questions.load_questions),
    ("path", questions.load_answers),
    ("path", lambda path: demonstrations("easy", 1).to_parquet(path)),
    ("folder", lambda path: demonstrations("easy", 1).to_popper(path)),
    ("config", logicity.Simulation),
    ("config", logicity.Inference),
    ("config", logicity.envs.SPFEnv),
    ("rules", lambda path: logicity.Simulation(rules=path)),
    ("rules", lambda path: logicity.evaluate("oracle", "easy", rules=path)),
    ("mode", lambda path: logicity.evaluate("oracle", path)),
    ("mode", logicity.observation_names),
    ("traces", lambda path: logicity.evaluate("oracle", "easy", "val", traces=path)),
    ("trace", lambda path: logicity.Simulation("easy", count_firings=True).run(1, trace=path)),
    ("folder", lambda path: make_dataset(path, "easy", "test", worlds=1, images=False)),
    ("pack", lambda path: make_dataset("unused", "easy", "test", worlds=1, images=False, drawing=Drawing(pack=path))),
    ("folder", check_dataset),
    ("folder", VapDataset),
    ("folder", lambda path: to_coco(path, "unused")),
    ("out", lambda path: to_coco("unused", path)),
    ("folder", lambda path: to_webdataset(path, "unused")),
    ("out_dir", lambda path: to_webdataset("unused", path)),
]


@pytest.mark.parametrize("wrong", [b"file", 3, ["file"]], ids=["bytes", "int", "list"])
@pytest.mark.parametrize(("name", "function"), PATHS)
def test_paths(
    name: str, function: Callable[[Any], object], wrong: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "path" and function is PATHS[4][1]:
        needs("pyarrow", "offline")
    monkeypatch.chdir(tmp_path)
    message = rf"^{name}: expected str or os\.PathLike\[str\], not {type(wrong).__name__}$"
    with pytest.raises(TypeError, match=message):
        function(wrong)
    assert not list(tmp_path.iterdir())


def test_numbers() -> None:
    samples = ROOT / "unused"
    cases: list[tuple[Callable[[], object], type[Exception], str]] = [
        (lambda: demonstrations("easy", -1), ValueError, "^expected 1 to 100 demonstrations, .*, not -1$"),
        (lambda: demonstrations("easy", "x"), TypeError, "^n: expected an integer, not str$"),  # type: ignore[arg-type]
        (lambda: measure_baselines(samples, samples, epochs=0), ValueError, r"^epochs: expected 1 to .*, not 0$"),
        (lambda: measure_baselines(samples, samples, -1), ValueError, r"^seed: expected 0 to 2\*\*64 - 1, not -1$"),
        (lambda: check_dataset(samples, threads=1025), ValueError, "^threads: expected 0 to 1024, not 1025$"),
    ]
    for function, error, message in cases:
        with pytest.raises(error, match=message):
            function()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": None}, "split: expected str, not NoneType"),
        ({"oracle": "x"}, "oracle: expected bool, not str"),
        ({"action_masks": 1}, "action_masks: expected bool, not int"),
    ],
)
def test_options_of_environments(options: dict[str, Any], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        logicity.envs.SPFEnv("easy", **options)
    with pytest.raises(TypeError, match=message):
        logicity.envs.SPFVectorEnv(2, "easy", **options)


def test_overrides() -> None:
    with pytest.raises(TypeError, match="^overrides: expected a mapping, not int$"):
        logicity.envs.SPFEnv("easy", overrides=3)  # type: ignore[arg-type]
