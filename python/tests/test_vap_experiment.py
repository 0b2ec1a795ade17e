"""Experiments of Visual Action Prediction: cells, tables and published rows."""

from __future__ import annotations

import dataclasses
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, needs, run_with_a_lost_worker, timeless, wait_for

from logicity import ACTIONS, InputError

torch: Any = needs("torch", "vap")
needs("stable_baselines3", "learn")
from logicity.commands import run as command  # noqa: E402
from logicity.experiments.cells import finished, prepare, run_cell  # noqa: E402
from logicity.experiments.experiment import Selection  # noqa: E402
from logicity.experiments.jobs import run_in_processes  # noqa: E402
from logicity.experiments.paper import paper_table  # noqa: E402
from logicity.experiments.registry import Loaded, load_experiment, task_named  # noqa: E402
from logicity.experiments.report import Report  # noqa: E402
from logicity.experiments.results import as_text, check_rows, leaderboard, read_results, submit  # noqa: E402
from logicity.experiments.task import Cell  # noqa: E402
from logicity.experiments.vap import measures_of_worlds  # noqa: E402
from logicity.vap.stages import VapSettings  # noqa: E402

EXPERIMENTS = ROOT / "configs" / "experiments"
#: Every stage, without pictures but for one row.
TINY = """
task: vap
title: Tiny
paper: vap
modes: [hard]
variants: {random: {}}
changes: {worlds: {train: 1, val: 1, test: 1}, fraction: 0.3, training: {epochs: 2}}
learners:
  rules: {changes: {concepts: {perception: sides}}}
  modular-gnn: {start: rules, changes: {stage: reasoning, concepts: {perception: sides}, training: {epochs: 3}}}
  e2e-nlm: {changes: {stage: end-to-end, reasoner: nlm, concepts: {perception: sides}}}
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    file = tmp_path / "tiny.yaml"
    file.write_text(TINY)
    return file


def cells_of(file: Path, **selection: Any) -> tuple[Loaded, list[Cell]]:
    loaded = load_experiment(file)
    return loaded, loaded.cells(Selection(**selection))


def settings_of(cell: Cell) -> VapSettings:
    assert isinstance(cell.settings, VapSettings)
    return cell.settings


def test_the_shipped_experiments_have_cells() -> None:
    for name, paper, rows in [
        ("vap", "vap", 9),
        ("vap-50", "vap", 9),
        ("vap-backbone", "vap", 6),
        ("vap-continual", "vap-continual", 5),
        ("vap-steps", "vap-continual", 5),
        ("vap-concepts", "vap-concepts", 2),
    ]:
        file = EXPERIMENTS / f"{name}.yaml"
        loaded, cells = cells_of(file)
        experiment = loaded.experiment
        assert len(experiment.learners) == rows
        assert experiment.paper == paper and paper_table(paper)["source"].startswith("LogiCity (NeurIPS 2024")
        assert len({cell.identity for cell in cells}) == len(cells)
        places = {cell.identity: at for at, cell in enumerate(cells)}
        assert all(cell.start is None or places[cell.start.identity] < places[cell.identity] for cell in cells)
        assert all(settings_of(cell).training.epochs == 1 for cell in cells_of(file, quick=True)[1])
    _, cells = cells_of(EXPERIMENTS / "vap-continual.yaml", seeds=(0,), only=[("modular-nlm",)])
    last = next(cell for cell in cells if cell.variant == "5 %")
    assert last.start is not None and (last.start.mode, last.start.row) == ("easy", "modular-nlm")
    assert last.start.start is not None and last.start.start.row == "rules"
    # Every share of the pictures has equally many updates.
    _, cells = cells_of(EXPERIMENTS / "vap-steps.yaml", seeds=(0,))
    updates = {cell.row: set[int]() for cell in cells}
    for cell in cells:
        training = settings_of(cell).training
        updates[cell.row].add(training.updates(training.epochs, 1000))
    assert all(len(each) == 1 for each in updates.values()) and len({cell.variant for cell in cells}) == 9


def test_the_papers_figures_are_those_of_its_table() -> None:
    paper_figures = task_named("vap").paper_value
    assert paper_figures("vap", "modular-nlm", "fixed", "hard") == {
        **{"Slow": 0.39, "Normal": 0.54, "Fast": 0.11, "Stop": 0.48},
        **{"aAcc": 0.45, "wAcc": 0.24},
    }
    assert paper_figures("vap", "e2e-gnn", "random", "easy") == {
        **{"Slow": 0.88, "Normal": 0.64, "Stop": 1.0, "aAcc": 0.87, "wAcc": 0.82}
    }
    assert paper_figures("vap", "rules", "fixed", "hard") is None
    concepts = paper_table("vap-concepts")["concepts"]
    assert len(concepts) == 17 and concepts["CollidingClose"] == 0.05


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TINY.replace("task: vap", "task: vpa"), "unknown task `vpa`; did you mean `vap`"),
        (TINY.replace("title: Tiny", ""), "the key `title` is missing"),
        (TINY.replace("paper:", "papr:"), "unknown key `papr`[^?]*did you mean `paper`"),
        (
            TINY.replace("start: rules", "start: rule"),
            "`rule`, but no earlier row has this name; did you mean `rules`",
        ),
        (
            TINY.replace("start: rules", "start: e2e-nlm"),
            "`modular-gnn` starts from `e2e-nlm`, but no earlier row has this name: move `modular-gnn` below it",
        ),
        (TINY.replace("start: rules", "start: modular-gnn"), "but no earlier row has this name; known: rules"),
        (TINY.replace("fraction: 0.3", "fraction: 3"), r"`fraction` must be at most 1(.|\n)*tiny\.yaml:7:58"),
        (
            TINY.replace("fraction: 0.3", "fractoin: 1"),
            r"unknown key `fractoin`(.|\n)*tiny\.yaml:7:48(.|\n)*did you mean `fraction`",
        ),
        (TINY.replace("{epochs: 2}", "{epoch: 2}"), r"unknown key `training\.epoch`(.|\n)*did you mean `epochs`"),
        (
            TINY.replace("stage: reasoning", "stage: reason"),
            r"settings of `modular-gnn`: `stage` must be `concepts`, `reasoning`(.|\n)*tiny\.yaml:10:48",
        ),
        (
            TINY.replace("fraction: 0.3", "groundings: exact"),
            r"`groundings: exact` cannot be combined with the stage `concepts`(.|\n)*tiny\.yaml:7:60",
        ),
        (
            TINY.replace("{random: {}}", "{random: {changes: {fraction: 2}}}"),
            r"error\[invalid-value\]: `fraction` must be at most 1(.|\n)*tiny\.yaml:6:41",
        ),
        (TINY + "quick: {fraction: 2}", r"`fraction` must be at most 1(.|\n)*tiny\.yaml:12:19"),
        (
            TINY.replace("stage: reasoning", "stage: reasoning, reasoner: rules"),
            "the reasoner `rules` has nothing to train: use the stage `end-to-end`",
        ),
        (TINY.replace("stage: reasoning", "stage: bound"), "the stage `bound` needs `groundings: exact`"),
        (TINY.replace("fraction: 0.3", "weights: a"), "`weights` are those of a backbone: they need"),
        (TINY.replace("{random: {}}", "{random: {start: randm}}"), "unknown variant `randm`; did you mean `random`"),
        (
            TINY.replace("{random: {}}", "{random: {start: random}}"),
            "`random` itself starts from another variant: name",
        ),
        (TINY.replace("[hard]", "[hard, hard]"), r"`hard` occurs twice(.|\n)*tiny\.yaml:5:8"),
        (TINY + "seeds: [0, 0]", r"`0` occurs twice(.|\n)*tiny\.yaml:12:8"),
        (TINY.replace("start: rules,", "start: rules, variants: [random, random],"), "`random` occurs twice"),
        (TINY.partition("learners:")[0] + "learners: {}", "`learners` must be a mapping with 1 or more keys"),
        (TINY.replace("modes: [hard]", "modes: [expert]"), "`modes.0` must be `easy` or `hard`, not `expert`"),
        (
            TINY.replace("start: rules,", "start: rules, modes: [hrd],"),
            r"unknown mode `hrd`; did you mean `hard`(.|\n)*tiny\.yaml:10:39",
        ),
        (
            TINY.replace("rules: {changes", "rules: {start: e2e-nml, changes"),
            "`e2e-nml`, but no earlier row has this name; did you mean `e2e-nlm`",
        ),
        (TINY.replace("rules: {changes", "rules: {start: rules, changes"), "no earlier row has this name\n"),
        (
            TINY.replace("variants: {random: {}}\n", "").replace("start: rules,", "start: rules, variants: [nope],"),
            "unknown variant `nope`\n",
        ),
        (TINY.replace("paper: vap", "paper: vapp"), "`paper` must be `vap`, `vap-continual` or `vap-concepts`, not"),
        (
            TINY.replace("start: rules,", "start: rules, paper: moduler-gnn,"),
            r"the paper's table has no row `moduler-gnn`; did you mean `modular-gnn`(.|\n)*tiny\.yaml:10:38",
        ),
        (
            TINY.replace("start: rules, ", ""),
            r"needs the concepts of another row: set its `start`(.|\n)*tiny\.yaml:10:16",
        ),
        (
            TINY.replace("changes: {stage: end-to-end,", "quick: {stage: induction}, changes: {stage: end-to-end,"),
            r"`e2e-nlm`: `groundings: predicted` needs the concepts of another row(.|\n)*tiny\.yaml:11:12",
        ),
    ],
)
def test_faulty_experiments_are_reported(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(text)
    with pytest.raises(InputError, match=message) as error:
        load_experiment(tmp_path / "tiny.yaml")
    assert len(error.value.diagnostics) == 1


def test_unknown_selections_are_reported(
    tiny: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tiny.parent))
    for arguments, message in [
        (["--only", "rule"], "--only: unknown learner `rule`; did you mean `rules`?"),
        (["--only", "rules,easy"], "--only: `rules` has no mode `easy`"),
        (["--only", "rules,hard,randon"], "--only: `rules` has no variant `randon`; did you mean `random`?"),
        (["--set", "training.epochs=0"], "--set: settings of `rules`: `training.epochs` must be at least 1, not `0`"),
        (
            ["--set", "stage=end-to-end", "--set", "reasoner=nlm", "--set", "training.epochs=2"],
            "have the same settings",
        ),
        (["--set", "concepts.perception=features"], "no weights of ResNet50"),
        (["--set", "stage=reasoning"], "--set: `rules`: `groundings: predicted` needs the concepts of another row"),
    ]:
        assert command(("experiment",), [str(tiny), "--run", str(tiny.parent / "run"), *arguments]) == 2
        assert message in capsys.readouterr().err


def test_a_cell_needs_the_model_that_it_starts_from(tiny: Path, tmp_path: Path) -> None:
    _, cells = cells_of(tiny, only=[("modular-gnn",)])
    alone = dataclasses.replace(cells[1], start=None)
    with pytest.raises(ValueError, match="`groundings: predicted` needs the concepts of another row: set its `start`"):
        run_cell(prepare(alone, tmp_path / "run"))


def test_a_cell_belongs_to_the_weights_of_its_backbone(tiny: Path) -> None:
    weights = tiny.parent / "weights.pth"
    changes = {"weights": str(weights), "concepts": {"perception": "features"}}
    identities = set()
    for content in ("a", "b"):
        weights.write_text(content)
        identities.add(cells_of(tiny, only=[("rules",)], changes=changes)[1][0].identity)
        weights = tiny.parent / "other.pth"
        changes["weights"] = str(weights)
    assert len(identities) == 2


def test_a_cell_runs_with_the_rules_of_its_experiment(tiny: Path, tmp_path: Path) -> None:
    _, cells = cells_of(tiny, only=[("rules",)])
    folder = prepare(cells[0], tmp_path / "run")
    document = json.loads((folder / "cell.json").read_text())
    document["spec"]["rules"] = "0" * 64
    (folder / "cell.json").write_text(json.dumps(document))
    with pytest.raises(ValueError, match="the rules changed after the experiment had begun"):
        run_cell(folder)


def test_a_variant_with_a_mode_has_one_cell(tiny: Path) -> None:
    tiny.write_text(TINY.replace("[hard]", "[easy, hard]").replace("{random: {}}", "{a: {mode: easy}, b: {}}"))
    message = r"`rules, a, easy, seed 0` and `rules, b, easy, seed 0` have the same settings(.|\n)*tiny\.yaml:\d+:"
    with pytest.raises(InputError, match=message):
        cells_of(tiny, only=[("rules",)])
    tiny.write_text(tiny.read_text().replace("b: {}", "b: {changes: {fraction: 0.5}}"))
    cells = cells_of(tiny, only=[("rules",)])[1]
    assert [(cell.mode, cell.variant) for cell in cells] == [("easy", "a"), ("easy", "b"), ("hard", "b")]


def test_rules_are_learned_from_true_concepts(tiny: Path, tmp_path: Path) -> None:
    tiny.write_text(TINY.replace("{concepts: {perception: sides}}", "{stage: induction, groundings: exact}"))
    _, cells = cells_of(tiny, only=[("rules",)])
    measured = run_cell(prepare(cells[0], tmp_path / "run"))
    assert measured["evaluations"]["threshold"] == measured["evaluations"]["product"]
    assert measured["evaluations"]["threshold"]["a_acc"] > 0.7 and not measured["concepts"]


def test_concepts_are_learned_through_the_rules(tiny: Path, tmp_path: Path) -> None:
    tiny.write_text(TINY.replace("reasoner: nlm", "reasoner: rules"))
    _, cells = cells_of(tiny, only=[("e2e-nlm",)])
    measured = run_cell(prepare(cells[0], tmp_path / "run"))
    model = torch.load(cells[0].task.model(cells[0].folder(tmp_path / "run")), weights_only=True)
    assert not model["reasoner"] and model["concepts"]
    # Rules give concepts their meaning, so these have recalls as if they were trained with labels.
    assert measured["concepts"]["IsCar"]["count"] > 0 and set(measured["evaluations"]) == {""}


def test_the_bound_lacks_classes_that_training_does_not_show(tiny: Path, tmp_path: Path) -> None:
    text = TINY.replace("{concepts: {perception: sides}}", "{stage: bound, groundings: exact}")
    tiny.write_text(text.replace("{random: {}}", "{fixed: {changes: {agents: fixed}}, random: {}}"))
    _, cells = cells_of(tiny, only=[("rules",)])
    found = {}
    for cell in cells:
        measured = run_cell(prepare(cell, tmp_path / "run"))
        absent = torch.load(cell.task.model(cell.folder(tmp_path / "run")), weights_only=True)["absent"]
        found[cell.variant] = (absent, measured["evaluations"][""])
    assert found["fixed"][0] == ["IsBus"] and found["fixed"][1]["recall"]["Fast"] < 0.8
    # A few worlds with random agents show every class.
    assert found["random"][0] == [] and set(found["random"][1]["recall"].values()) == {1.0}


def test_intervals_draw_runs_and_worlds() -> None:
    world = {"world": 0, "frames": 4, "a_acc": 2.0, "counts": [4, 4, 0, 8], "correct": [2, 4, 0, 4]}
    better = {**world, "world": 1, "a_acc": 4.0, "correct": [4, 4, 0, 8]}
    alone = measures_of_worlds([[world]])
    assert set(alone) == {"Slow", "Normal", "Stop", "aAcc", "wAcc"}
    # wAcc: (0.5 / 4 + 1 / 4 + 0.5 / 8) / (1 / 4 + 1 / 4 + 1 / 8)
    assert alone["wAcc"].value == pytest.approx(0.7) and alone["wAcc"].low == alone["wAcc"].high
    both = measures_of_worlds([[world, better], [better, better]])
    assert both["Slow"].value == pytest.approx(0.875) and both["aAcc"].value == pytest.approx(0.875)
    assert both["Slow"].low < both["Slow"].value < both["Slow"].high == 1.0


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The file and the folder of the tiny experiment, run in this process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "tiny.yaml").write_text(TINY)
    for cell in cells_of(folder / "tiny.yaml")[1]:
        run_cell(prepare(cell, folder / "run"))
    return folder / "tiny.yaml", folder / "run"


def test_the_table_includes_the_papers_figures(undisturbed: tuple[Path, Path], tmp_path: Path) -> None:
    file, root = undisturbed
    experiment, cells = cells_of(file)
    report = Report(experiment, cells, root)
    assert [(entry.row, entry.evaluation) for entry in report.entries] == [
        ("rules", "threshold"),
        ("rules", "product"),
        ("modular-gnn", ""),
        ("e2e-nlm", ""),
    ]
    assert report.complete and report.entries[2].paper == task_named("vap").paper_value(
        "vap", "modular-gnn", "random", "hard"
    )
    written = {path.name: path for path in report.write(tmp_path)}
    assert set(written) == {"table.md", "table.tex", "table.json", "bars.png", "bars.svg"}
    markdown = written["table.md"].read_text()
    assert "| the paper's | 0.26 | 0.51 | 0.19 | 0.63 | 0.48 | 0.28 |" in markdown and "| IsAtInter | " in markdown
    # One seed and one test world have no interval.
    assert re.search(r"\| modular-gnn, random \|( \d\.\d\d \|| - \|){6} 0 \|", markdown)
    assert "one seed and one test world have no interval" in " ".join(markdown.split())
    text = report.text()
    assert "modular-gnn, random" in text and "Recall of concepts" in text and "CPU time: " in text
    alone = dataclasses.replace(experiment, experiment=experiment.experiment.model_copy(update={"paper": None}))
    own = Report(alone, cells, root)
    assert "Recall of concepts" in own.text() and "paper" not in own.text() + own.markdown()
    missing = Report(experiment, cells, tmp_path / "none", {cells[1].identity: "it failed\nhere"})
    assert (
        not missing.complete and "modular-gnn, random, hard: it failed. The figures are the paper's." in missing.notes()
    )


def test_a_selection_can_name_a_variant(tmp_path: Path) -> None:
    loaded, cells = cells_of(EXPERIMENTS / "vap.yaml", only=[("induced", "hard", "random"), ("bound", "easy")])
    assert {(cell.row, cell.mode, cell.variant) for cell in cells} == {
        *(("rules", "hard", "random"), ("induced", "hard", "random")),
        *(("bound", "easy", "fixed"), ("bound", "easy", "random")),
    }
    _, all_cells = cells_of(EXPERIMENTS / "vap.yaml")
    assert {cell.identity for cell in cells} < {cell.identity for cell in all_cells}
    # Without a variant, all.
    _, both = cells_of(EXPERIMENTS / "vap.yaml", only=[("rules", "easy", "random"), ("rules", "easy", "fixed")])
    _, same = cells_of(EXPERIMENTS / "vap.yaml", only=[("rules", "easy")])
    assert [cell.identity for cell in both] == [cell.identity for cell in same]


def test_the_papers_concepts_stand_only_where_it_measured_them(undisturbed: tuple[Path, Path]) -> None:
    file, root = undisturbed
    experiment, cells = cells_of(file)
    report = Report(experiment, cells, root)
    assert "the paper's, NLM, random agents" in {cell for line in report.details("hard") for cell in line}
    assert not report.details("easy")
    results = json.loads((ROOT / "results" / "vap.json").read_text("utf-8"))
    page = leaderboard(results)
    tables = {title.partition(":")[0]: title for title in page.split("## ") if "Recall of" in title}
    assert {mode: "the paper's, NLM, random agents" in table for mode, table in tables.items()} == {
        "Easy": False,
        "Hard": True,
    }
    # The paper's recalls of the actions stand below ours.
    assert "| the paper's | 0.46 | 0.62 | 0.27 | 0.99 | 0.72 | 0.40 |" in page


def test_published_rows_are_measured_again(undisturbed: tuple[Path, Path], tmp_path: Path) -> None:
    file, root = undisturbed
    experiment, cells = cells_of(file)
    results = tmp_path / "tiny.json"
    lines = list(submit(experiment, cells, root, results))
    assert lines[-1] == f"4 rows in {results}"
    page = leaderboard(read_results(results), loaded=experiment)
    assert "[" not in page and "## Hard" in page and "| `modular-gnn`, random | " in page and "| IsAtInter | " in page
    folder = cells[0].folder(root)
    measured = finished(cells[0], root)
    assert measured is not None
    changed = deepcopy(measured)
    changed["evaluations"]["threshold"]["w_acc"] += 0.1
    (folder / "measured.json").write_text(json.dumps(changed))
    try:
        with pytest.raises(ValueError, match=r"rules, random, hard, seed 0, threshold: the model .* has wAcc"):
            list(submit(experiment, cells, root, results))
    finally:
        (folder / "measured.json").write_text(json.dumps(measured))
    # Rows of other seeds stay, but those with other settings do not.
    rows = read_results(results)["rows"]
    assert [(row["learner"], row["evaluation"]) for row in rows] == [
        *(("rules", "threshold"), ("rules", "product")),
        *(("modular-gnn", ""), ("e2e-nlm", "")),
    ]
    assert rows[0]["command"] == f"logicity experiment {file} --only rules,hard --seeds 0"
    older, other = {**rows[2], "seed": 1, "settings": {}}, {**rows[3], "seed": 1}
    rows[1]["note"] = "It counts shared facts several times."
    results.write_text(as_text({"format": 4, "experiment": "tiny", "rows": [other, older, *rows]}))
    assert list(submit(experiment, cells, root, results))[-1] == f"5 rows in {results}"
    kept = read_results(results)["rows"]
    assert kept == [*rows, other]
    assert len(results.read_text().splitlines()) == 7, "one line per row"
    # The hash is that of the weights, which a model that was trained again has.
    older = {**kept[1], "sha256_of": "file", "sha256": "0" * 64}
    results.write_text(as_text({"format": 4, "experiment": "tiny", "rows": [older]}))
    list(submit(experiment, cells, root, results, only_hashes=True))
    [again] = read_results(results)["rows"]
    assert {**again, "versions": None} == {**kept[1], "versions": None}


def test_faults_of_published_rows_are_found(undisturbed: tuple[Path, Path], tmp_path: Path) -> None:
    file, root = undisturbed
    experiment, cells = cells_of(file)
    list(submit(experiment, cells, root, tmp_path / "tiny.json"))
    right = read_results(tmp_path / "tiny.json")

    def faults(**changes: Any) -> list[str]:
        row = {**deepcopy(right["rows"][0]), **changes}
        return check_rows({**right, "rows": [row, *right["rows"][1:]]}, experiment)

    assert len(right["rows"]) == 4 and faults() == []
    first = right["rows"][0]
    (world,) = first["samples"]
    action = next(at for at, name in enumerate(ACTIONS) if name in first["measures"])
    fewer = [each - (at == action) for at, each in enumerate(world["correct"])]
    longer = {**first["settings"], "training": {**first["settings"]["training"], "epochs": 3}}
    measures = first["measures"]

    def other(name: str, value: float) -> dict[str, Any]:
        return {"measures": {**measures, name: {**measures[name], "value": value}}}

    cases: list[tuple[dict[str, Any], list[str]]] = [
        ({"hashes": {"rules": "0" * 64}}, ["other rules"]),
        ({"settings": longer}, ["other settings"]),
        ({"settings": {}}, ["other settings"]),
        ({"learner": "rule"}, ["no such learner or variant"]),
        ({"variant": "fixed"}, ["no such learner or variant"]),
        ({"paper": "e2e-nlm"}, ["another row of the paper"]),
        (other("wAcc", measures["wAcc"]["value"] + 0.01), ["another wAcc"]),
        (other("aAcc", measures["aAcc"]["value"] + 0.01), ["another aAcc"]),
        (other("Stop", 2.0), ["another Stop"]),
        (
            {"measures": {name: measures[name] for name in ("aAcc", "wAcc")}},
            [f"another {name}" for name in ACTIONS if name in measures],
        ),
        ({"samples": [{**world, "correct": fewer}]}, ["another wAcc", f"another {ACTIONS[action]}"]),
        ({"samples": [{**world, "a_acc": world["a_acc"] + 1}]}, ["another aAcc"]),
        ({"samples": [{**world, "world": 1}]}, ["other worlds"]),
        ({"samples": []}, ["other worlds"]),
        ({"samples": [{}]}, ["other keys"]),
        ({"tsr": 1}, ["other keys"]),
        ({"details": {"IsCar": 1.5}}, ["an impossible recall of IsCar"]),
    ]
    for changes, messages in cases:
        names = {**first, **changes}
        place = f"{names['learner']}, threshold, {names['variant']}, hard, seed 0"
        assert faults(**changes) == [f"{place}: {message}" for message in messages]
    assert [each.rpartition(": ")[2] for each in faults(mode="easy")] == ["no such mode", "other rules"]
    assert [each.rpartition(": ")[2] for each in faults(evaluation="product")] == ["it occurs twice"] * 2
    # Without an experiment, it is the built-in one with the name.
    wrong = check_rows({**right, "experiment": "vap"})
    assert "rules, threshold, random, hard, seed 0: other settings" in wrong
    with pytest.raises(FileNotFoundError):
        check_rows({**right, "experiment": "none"})


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_an_experiment_killed_five_times_is_complete_and_the_same(
    undisturbed: tuple[Path, Path], tmp_path: Path
) -> None:
    file, root = undisturbed
    other = tmp_path / "run"
    _, cells = cells_of(file)
    words = [sys.executable, "-m", "logicity", "experiment", str(file), "--run", str(other), "--jobs", "2"]

    def count(name: str) -> int:
        return len(list(other.rglob(name)))

    # The last one comes before the report, which takes seconds, so the process never ends by itself.
    moments: list[Callable[[], bool]] = [
        lambda: count("cell.json") > 0,
        lambda: count("checkpoint.pt") + count("measured.json") > 0,
        lambda: count("measured.json") > 0,
        lambda: count("measured.json") > 1,
        lambda: count("measured.json") + count("checkpoint.pt") > 2,
    ]
    for moment in moments:
        process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for(lambda: process.poll() is not None or moment())  # noqa: B023
        assert process.poll() is None
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for cell in cells:
        first, second = finished(cell, root), finished(cell, other)
        assert first is not None and timeless(first) == timeless(second)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_ray_runs_the_cell_of_a_lost_worker_again(undisturbed: tuple[Path, Path], tmp_path: Path) -> None:
    file, root = undisturbed
    run_with_a_lost_worker(file, tmp_path / "run")
    for cell in cells_of(file)[1]:
        first, second = finished(cell, root), finished(cell, tmp_path / "run")
        assert first is not None and second is not None and timeless(first) == timeless(second)


def test_the_quick_table_of_the_paper(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From made pictures to the table, with every row."""
    root = tmp_path / "run"
    arguments = [str(EXPERIMENTS / "vap.yaml"), "--quick", "--jobs", "2", "--run", str(root)]
    assert command(("experiment",), arguments) == 0
    output = capsys.readouterr()
    assert "[36/36] " in output.err and output.out.startswith("Visual Action Prediction\n\nEasy\nlearner ")
    table = json.loads((root / "table.json").read_text())
    assert {(entry["row"], entry["mode"]) for entry in table["entries"]} == {
        (row, mode)
        for mode in ("easy", "hard")
        for row in (
            *("rules", "no-pixels", "induced", "modular-gnn", "modular-nlm", "e2e-gnn", "e2e-nlm"),
            *("bound", "true-gnn"),
        )
    }
    assert not any(entry["missing"] for entry in table["entries"]) and (root / "bars.png").exists()
    assert not list((tmp_path / "vap-data").rglob("*.png")), "pictures are removed after use"


def test_failures_of_cells_are_reported(tiny: Path, tmp_path: Path) -> None:
    tiny.write_text(
        TINY.replace("start: rules, changes: {stage: reasoning", "start: rules, changes: {stage: end-to-end")
    )
    _, cells = cells_of(tiny, only=[("modular-gnn",)])
    said: list[str] = []
    failed = run_in_processes(cells, tmp_path / "run", 1, said.append)
    assert failed == {
        cells[1].identity: "the model to start from has no part `reasoner`: start from a row that trains it"
    }
    tiny.write_text(
        TINY.replace("stage: reasoning, concepts: {perception: sides", "stage: reasoning, concepts: {width: 2")
    )
    _, cells = cells_of(tiny, only=[("modular-gnn",)])
    with pytest.raises(ValueError, match="the part `concepts` of the model to start from has another architecture"):
        run_cell(prepare(cells[1], tmp_path / "run"))


@pytest.mark.parametrize("method", ["unrolled", "implicit"])
def test_bilevel_training_lowers_the_loss_of_the_fitted_reasoner(tiny: Path, tmp_path: Path, method: str) -> None:
    changes = (
        f"stage: bilevel, reasoner: gnn, bilevel: {{method: {method}}}, training: {{epochs: 12, learning_rate: 0.003}}"
    )
    tiny.write_text(TINY.replace("stage: end-to-end, reasoner: nlm", changes).replace("fraction: 0.3, ", ""))
    _, cells = cells_of(tiny, only=[("e2e-nlm",)])
    settings = settings_of(cells[0])
    assert settings.bilevel is not None and settings.bilevel.method == method and settings.bilevel.inner_steps == 5
    measured = run_cell(prepare(cells[0], tmp_path / "run"))
    losses = [epoch["loss"] for epoch in measured["result"]["history"]]
    assert losses[-1] < 0.95 * losses[0], losses
    model = torch.load(cells[0].task.model(cells[0].folder(tmp_path / "run")), weights_only=True)
    assert model["reasoner"] and model["concepts"] and set(measured["evaluations"]) == {""}
    # The same seed gives the same weights.
    again = run_cell(prepare(cells[0], tmp_path / "again"))
    assert again["result"]["model_sha256"] == measured["result"]["model_sha256"]


def test_only_bilevel_training_has_its_settings() -> None:
    assert "bilevel" not in VapSettings().model_dump()
    assert (
        VapSettings(stage="bilevel").model_dump()
        == VapSettings.model_validate({"stage": "bilevel", "bilevel": {}}).model_dump()
    )
    with pytest.raises(ValueError, match="hyperparameters of the stage `bilevel`"):
        VapSettings.model_validate({"stage": "end-to-end", "bilevel": {}})
    with pytest.raises(ValueError, match="cannot be combined with the stage `bilevel`"):
        VapSettings.model_validate({"stage": "bilevel", "groundings": "exact"})
    with pytest.raises(ValueError, match="has nothing to train"):
        VapSettings.model_validate({"stage": "bilevel", "reasoner": "rules"})
