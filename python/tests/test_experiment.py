"""Experiments: cells, their runs in processes and on Ray, tables, figures and published results."""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, needs, run_with_a_lost_worker, timeless, wait_for

from logicity import InputError
from logicity.evaluation import Interval

needs("stable_baselines3", "learn")
from logicity.cluster import _check_listening  # noqa: E402
from logicity.commands import run as command  # noqa: E402
from logicity.experiments.cells import finished, prepare, reuse, run_cell, sampled  # noqa: E402
from logicity.experiments.experiment import Selection, read_experiment  # noqa: E402
from logicity.experiments.jobs import exclusive, run_in_processes  # noqa: E402
from logicity.experiments.paper import paper_table  # noqa: E402
from logicity.experiments.registry import Loaded, load_experiment, task_named  # noqa: E402
from logicity.experiments.report import Report  # noqa: E402
from logicity.experiments.results import as_text, check_rows, leaderboard, read_results, submit  # noqa: E402
from logicity.experiments.spf import SpfExperiment, violation_rates  # noqa: E402
from logicity.experiments.statistics import pooled, pooled_shares  # noqa: E402
from logicity.experiments.tables import escaped, markdown_table  # noqa: E402
from logicity.experiments.task import Cell  # noqa: E402
from logicity.learn import LEARNERS, load_policy  # noqa: E402
from logicity.learn.config import TrainConfig  # noqa: E402
from logicity.learn.run import train  # noqa: E402
from logicity.learn.storage import policy_hash  # noqa: E402
from logicity.terminal import first_line  # noqa: E402

EXPERIMENTS = ROOT / "configs" / "experiments"
#: Two learners with two seeds each.
TINY = """
title: Tiny
paper: spf
config: "{row}.yaml"
modes: [easy]
seeds: [0, 1]
learners:
  ppo: {}
  quick-a2c: {config: a2c.yaml, paper: a2c, changes: {steps: 96}}
"""
PPO = "algorithm: ppo\nmode: easy\nsettings: {network: [8], n_steps: 16, batch_size: 32}\nenvs: 2\nsteps: 256\n"
A2C = "algorithm: a2c\nmode: easy\nsettings: {network: [8], n_steps: 16}\nenvs: 2\nsteps: 64\nvalidate_every: 32\n"


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """The file of an experiment."""
    return write(tmp_path, TINY)


def write(folder: Path, text: str) -> Path:
    (folder / "ppo.yaml").write_text(PPO + "validate_every: 64\n")
    (folder / "a2c.yaml").write_text(A2C)
    (folder / "tiny.yaml").write_text(text)
    return folder / "tiny.yaml"


def cells_of(file: Path, **selection: Any) -> tuple[Loaded, list[Cell]]:
    loaded = load_experiment(file)
    return loaded, loaded.cells(Selection(**selection))


def run_here(cells: Sequence[Cell], root: Path) -> None:
    """Run cells in this process."""
    for cell in cells:
        run_cell(prepare(cell, root))


def results_of(cells: Sequence[Cell], root: Path) -> list[Any]:
    return [timeless(finished(cell, root)) for cell in cells]


def test_the_shipped_experiments_name_existing_configurations() -> None:
    # Tests of other tasks read their files.
    files = [file for file in sorted(EXPERIMENTS.glob("*.yaml")) if "task" not in read_experiment(file)[2]]
    assert [file.stem for file in files] == [
        "communication",
        "composition",
        "egos",
        "noise",
        "observations",
        "spf",
        "town",
        "transfer",
    ]
    for file in files:
        experiment = load_experiment(file).experiment
        assert isinstance(experiment, SpfExperiment)
        # The paper has no noise, no told facts, one ego, and one map.
        ours = ("communication", "egos", "noise", "town")
        assert experiment.paper == (None if file.stem in ours else file.stem)
        if experiment.paper is not None:
            assert paper_table(experiment.paper)["source"].startswith("LogiCity (NeurIPS 2024")
        # Rows end with how they differ from their learner.
        assert {re.sub("-(tuned|4)$", "", row) for row in experiment.learners} <= set(LEARNERS)
        for quick in (False, True):
            assert {cell.row for cell in cells_of(file, quick=quick)[1]} == set(experiment.learners)
    spf = load_experiment(EXPERIMENTS / "spf.yaml").experiment
    assert set(paper_table("spf")["rows"]) <= set(spf.learners)
    assert set(spf.modes) == {"easy", "medium", "hard", "expert"}


def test_the_papers_figures_are_those_of_its_tables() -> None:
    paper_value = task_named("spf").paper_value
    assert paper_value("spf", "nlm-dqn", "", "hard") == {"tsr": 0.29, "dsr": 0.4, "score": 2.69}
    assert paper_value("spf", "popper", "", "hard") == "timed out"
    assert paper_value("observations", "dqn", "state", "easy") == {"tsr": 0.12, "dsr": 0.329, "score": 2.1}
    assert paper_value("spf", "ppo-fast", "", "easy") is None and paper_value("transfer", "mlp", "", "easy") is None
    for table in ("spf", "observations"):
        for variants in paper_table(table)["rows"].values():
            for modes in variants.values():
                for figures in modes.values():
                    assert isinstance(figures, str) or (len(figures) == 3 and max(figures[:2]) <= 1)


def test_the_identity_follows_from_settings_rules_episodes_and_version(
    tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from logicity.experiments import spf as module

    _, cells = cells_of(tiny)
    assert [cell.name for cell in cells][:2] == ["ppo, easy, seed 0", "ppo, easy, seed 1"]
    assert len({cell.identity for cell in cells}) == 4 and cells_of(tiny)[1][0].identity == cells[0].identity
    assert [cell.task.steps(cell) for cell in cells] == [256, 256, 96, 96]
    others = [
        cells_of(tiny, changes={"settings": {"gamma": 0.9}})[1][0],
        cells_of(tiny, quick=True)[1][0],
        cells_of(write(tiny.parent, TINY.replace("modes: [easy]", "modes: [medium]")))[1][0],
        cells_of(write(tiny.parent, TINY + "evaluations: {test: {}, agents of training: {split: train}}"))[1][0],
    ]
    assert len({cell.identity for cell in [cells[0], *others]}) == 5
    monkeypatch.setattr(module, "__version__", "0.0.0")
    assert cells_of(write(tiny.parent, TINY))[1][0].identity != cells[0].identity
    monkeypatch.undo()
    hashes = {**module._hashes("easy"), "rules": "0" * 64}
    monkeypatch.setattr(module, "_hashes", lambda mode: hashes)
    assert cells_of(tiny)[1][0].identity != cells[0].identity


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (TINY.replace("seeds", "seed"), "unknown key `seed`[^?]*did you mean `seeds`"),
        (TINY.replace("paper: a2c", "papr: a2c"), "unknown key `papr`[^?]*did you mean `paper`"),
        (TINY.replace("modes: [easy]", ""), "the key `modes` is missing"),
        (TINY.replace("[0, 1]", "[-1]"), "`seeds.0` must be at least 0, not `-1`"),
        (TINY.replace("[0, 1]", "[]"), "`seeds` must be a list of 1 or more values"),
        (TINY.replace("[easy]", "[eazy]"), "unknown mode `eazy`[^?]*did you mean `easy`"),
        (TINY.replace("paper: spf", "paper: spff"), "`paper` must be `spf`, `transfer`, `composition` or `obs"),
        (TINY + "changes: {seed: 3}", "each cell has its own seed: write the seeds under `seeds`"),
        (TINY + "variants: {a: {changes: {mode: hard}}}", "each cell has its own mode: write it under `modes`, or as"),
        (TINY.replace("ppo: {}", "ppo: {quick: {seed: 3}}"), "each cell has its own seed"),
        (TINY + "variants: {a: {start: b}}", "unknown variant `b`"),
        (TINY + "variants: {a: {}, b: {start: a}, c: {start: b}}", "`b` itself starts from another variant: name a"),
        (TINY.replace("ppo: {}", "ppo: {variants: [b]}") + "variants: {a: {}}", "unknown variant `b`"),
        (TINY.replace("ppo: {}", "ppo: {start: quick-a2c}"), "no earlier row has this name: move `ppo` below it"),
        (TINY + "evaluations: {a: {split: tset}}", "`evaluations.a.split` must be `train`, `val` or `test`, not"),
        (TINY + "evaluations: {a: {fresh: 0}}", "`evaluations.a.fresh` must be at least 1"),
        (TINY.replace("[0, 1]", "[0, 1, 0]"), r"`0` occurs twice(.|\n)*tiny\.yaml"),
        (TINY.replace("[easy]", "[easy, easy]"), "`easy` occurs twice"),
        (TINY[: TINY.index("learners")] + "learners: {}", "`learners` must be a mapping with 1 or more keys"),
        (TINY + "changes: {stepz: 3}", r"unknown key `stepz`(.|\n)*tiny\.yaml(.|\n)*did you mean `steps`"),
        (TINY + "variants: {a: {changes: {envs: 0}}}", r"`envs` must be at least 1, not `0`(.|\n)*tiny\.yaml"),
        ("[]", "an experiment must be a mapping"),
        (TINY.replace("{steps: 96}", "{step: 96}"), "unknown key `step`[^?]*did you mean `steps`"),
        (TINY.replace("{steps: 96}", "{algorithm: sarsa}"), "unknown learner `sarsa`"),
        (TINY.replace("{steps: 96}", '{steps: "96"}'), '`steps` must be an integer, not `"96"`'),
        (TINY.replace("paper: a2c", "paper: a2d"), r"table has no row `a2d`; did you mean `a2c`(.|\n)*tiny\.yaml:9:40"),
        (
            TINY.replace("paper: spf\n", "").replace("paper: a2c", "paper: pop"),
            "the paper's table has no row `pop`; did you mean `ppo`",
        ),
        (TINY.replace("ppo: {}", "ppo: {variants: [nope]}"), "unknown variant `nope`\n"),
        (
            TINY.replace('"{row}.yaml"', '"{rwo}-{mode}"'),
            r"unknown placeholder `\{rwo\}`; did you mean `\{row\}`(.|\n)*tiny\.yaml:4:9",
        ),
        (
            TINY.replace("ppo: {}", 'ppo: {config: "{rwo}.yaml"}'),
            r"unknown placeholder `\{rwo\}`(.|\n)*tiny\.yaml:8:17",
        ),
        (TINY.replace("[easy]", "[easy, no.yaml]"), r"cannot read `.*no\.yaml`: no such file(.|\n)*tiny\.yaml:5:15"),
        (
            TINY + "variants: {a: {mode: no.yaml}}",
            r"cannot read `.*no\.yaml`: no such file(.|\n)*tiny\.yaml:10:22",
        ),
        (
            TINY.replace("a2c.yaml", "induce-easy").replace("96", "1") + "variants: {a: {}, b: {start: a}}",
            r"`induce` does not use the key `start`: its training cannot start from a policy(.|\n)*tiny\.yaml:10:30",
        ),
        (TINY + "changes: {start: no.pt}", r"cannot read `no\.pt`: no such file(.|\n)*tiny\.yaml:10:18"),
        (TINY + "changes: {start: .}", r"(.|\n)*tiny\.yaml:10:18"),
        (
            TINY.replace("{steps: 96}", "{overrides: {task: {horizn: 5}}}"),
            r"unknown key `horizn` in a task(.|\n)*tiny\.yaml:9:74(.|\n)*did you mean `horizon`",
        ),
        (
            TINY.replace("{steps: 96}", "{overrides: {task: {entities: 3}}}"),
            r"`overrides` change the shape of observations(.|\n)*tiny\.yaml:9:66",
        ),
        (TINY + "changes: {overrides: {base: x}}", r"`overrides` must not contain `base`(.|\n)*tiny\.yaml:10:22"),
        (
            TINY.replace("{steps: 96}", "{algorithm: induce, settings: {noise: 0.9}}"),
            "`settings.noise` must be at most 0.4 or `auto`, not `0.9`",
        ),
        (TINY.replace("{steps: 96}", "{settings: {gama: 1}}"), "`a2c` has no setting `gama`[^?]*did you mean `gamma`"),
    ],
)
def test_faulty_experiments_are_reported(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        cells_of(write(tmp_path, text))


def test_faulty_overrides_of_a_training_are_reported_there(tmp_path: Path) -> None:
    file = write(tmp_path, TINY)
    (tmp_path / "a2c.yaml").write_text(A2C + "overrides:\n  task: {horizn: 5}\n")
    with pytest.raises(InputError, match=r"unknown key `horizn`(.|\n)*a2c\.yaml:8:10"):
        cells_of(file)


def test_unknown_selections_are_reported(
    tiny: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("experiment",)
    run = ["--run", str(tiny.parent / "run")]
    for arguments, message in [
        (["--only", "pp0"], "--only: unknown learner `pp0`; did you mean `ppo`?"),
        (["--only", "ppo,eazy"], "--only: `ppo` has no mode `eazy`; did you mean `easy`?"),
        (["--only", "ppo,easy,x"], "--only: `ppo` has no variant `x`"),
    ]:
        assert command(words, [str(tiny), *run, *arguments]) == 2
        assert message in capsys.readouterr().err
    for change, message in [
        ("seed=3", "--set: each cell has its own `seed`: use `--seeds`"),
        ("mode=hard", "--set: each cell has its own `mode`: use `--only LEARNER,MODE`"),
        ("algorithm=dqn", "--set: each cell has its own `algorithm`: write another experiment"),
        ("step=3", "--set step: unknown key `step`\nhelp: did you mean `steps`?"),
        ("settings.gama=3", "--set settings.gama: `ppo` has no setting `gama`\nhelp: did you mean `gamma`?"),
        ("start=no.pt", "--set start: cannot read `no.pt`: no such file"),
        (
            "overrides.task.horizn=5",
            "--set overrides.task.horizn: unknown key `horizn` in a task\nhelp: allowed keys: ",
        ),
        ("overrides.base=x", "--set overrides: `overrides` must not contain `base`"),
    ]:
        assert command(words, [str(tiny), *run, "--list", "--set", change]) == 2
        assert message in capsys.readouterr().err
    assert command(words, [str(tiny), *run, "--submit", str(tiny.parent / "results.json")]) == 2
    assert "--submit: none of the cells is finished" in capsys.readouterr().err
    assert not (tiny.parent / "results.json").exists()
    assert command(words, ["spff"]) == 2
    assert "spff.yaml" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command(words, [str(tiny), "--set", "steps"])
    assert "expected KEY=VALUE" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command(words, [str(tiny), "--list", "--report"])
    assert "not allowed with argument --list" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command(words, [str(tiny), "--list", "--reuse", "runs/spf"])
    assert "not allowed with argument --list" in capsys.readouterr().err
    assert command(words, [str(tiny), *run, "--reuse", str(tiny.parent)]) == 2
    assert "not the folder of an experiment" in capsys.readouterr().err
    assert command(words, ["vap", *run, "--reuse", str(tiny.parent)]) == 2
    assert "--reuse: only experiments of Safe Path Following" in capsys.readouterr().err
    assert command(words, ["vap", *run, "--wandb", "project"]) == 2
    assert "--wandb: only experiments of Safe Path Following" in capsys.readouterr().err
    monkeypatch.setattr("logicity.experiments.jobs.find_spec", lambda name: None)
    assert command(words, [str(tiny), *run, "--wandb", "project"]) == 2
    assert "--wandb: the package wandb is not installed" in capsys.readouterr().err
    assert command(words, [str(tiny), *run, "--list", "--only", "ppo", "--seeds", "5"]) == 0
    assert capsys.readouterr().out.startswith("not run   ppo, easy, seed 5  ")


def test_faults_that_appear_with_the_cells_are_reported(tmp_path: Path) -> None:
    for text, error, message in [
        (
            TINY.replace("ppo: {}", 'ppo: {config: "no-{row}.yaml"}'),
            InputError,
            r"tiny\.yaml:8:17(.|\n)*key `config` names",
        ),
        (TINY.replace("ppo: {}", "pp0: {}"), InputError, r"pp0\.yaml(.|\n)*tiny\.yaml:8:8(.|\n)*key `config` names"),
        (
            TINY.replace("ppo: {}", "a: {config: ppo.yaml}\n  b: {config: ppo.yaml}"),
            InputError,
            r"have the same settings(.|\n)*tiny\.yaml:9:",
        ),
    ]:
        with pytest.raises(error, match=message):
            cells_of(write(tmp_path, text))
    file = write(tmp_path, "task: langauge\n" + TINY)
    with pytest.raises(InputError, match="unknown task `langauge`; did you mean `language`"):
        load_experiment(file)
    with pytest.raises(InputError, match="unknown task `~`; known: spf, vap, language"):
        load_experiment(write(tmp_path, "task: ~\n" + TINY))


def test_an_empty_message_has_a_first_line() -> None:
    assert first_line("one\ntwo") == "one"
    assert first_line("") == "no message" and first_line("", "failed") == "failed"


def test_names_are_escaped_in_tables() -> None:
    assert escaped("a_b ~ 1 % \\x^2") == r"a\_b \textasciitilde{} 1 \% \textbackslash{}x\textasciicircum{}2"
    assert markdown_table([["a", "b"], ["c|d", "e"]]).splitlines()[2] == r"| c\|d | e |"


def test_the_table_shows_the_papers_figures(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment, cells = cells_of(tiny)
    root = tmp_path / "run"
    run_here(cells[:3], root)
    # A result of other settings is not one of these cells.
    run_here(cells_of(tiny, changes={"steps": 64}, only=[("quick-a2c",)], seeds=(1,))[1], root)
    report = Report(experiment, cells, root, {cells[3].identity: "it failed\nhere"})
    ppo, a2c = report.entries
    assert (ppo.seeds, ppo.missing, a2c.seeds, a2c.missing) == ((0, 1), "", (0,), "it failed (seed 1)")
    assert Report(experiment, cells, root / "empty").entries[1].missing == "not run"
    assert "the paper's" in report.text()
    alone = replace(experiment, experiment=experiment.experiment.model_copy(update={"paper": None}))
    assert "paper" not in Report(alone, cells, root).text()
    assert not report.complete and ppo.paper == {"tsr": 0.33, "dsr": 0.36, "score": 2.83}
    single = finished(cells[2], root)
    assert single is not None
    assert a2c.measures["tsr"] == Interval(**single["evaluations"]["test"]["tsr"])
    assert sum(ppo.details.values()) > 0 and list(ppo.details) == ["S1", "S2", "S7"]
    assert not list(root.glob("cells/*/checkpoint-*"))
    written = {path.name: path for path in report.write(root)}
    assert set(written) == {"table.md", "table.tex", "table.json", "bars.png", "bars.svg", "curves.png", "curves.svg"}
    assert written["bars.png"].read_bytes()[:4] == b"\x89PNG" and "<svg" in written["curves.svg"].read_text()
    markdown, latex = written["table.md"].read_text(), written["table.tex"].read_text()
    assert (
        "| the paper's | 0.33 | 0.36 | 2.83 |  |  |" in markdown and "quick-a2c, easy: it failed (seed 1)." in markdown
    )
    assert "the paper's & 0.33 & 0.36 & 2.83 &  &  \\\\" in latex and latex.count("{") == latex.count("}")
    assert json.loads(written["table.json"].read_text())["entries"][0]["seeds"] == [0, 1]
    assert command(("experiment",), [str(tiny), "--run", str(root), "--report"]) == 0
    assert "quick-a2c" in (shown := capsys.readouterr().out) and "CPU time: " in shown
    svg = written["bars.svg"].read_bytes()
    report.write(root)
    assert written["bars.svg"].read_bytes() == svg


def test_intervals_over_seeds_and_episodes_equal_a_slow_bootstrap() -> None:
    generator = np.random.default_rng(3)
    tables = [
        {"tsr": (generator.random(7) < p).astype(float), "dsr": generator.random(7), "score": generator.normal(size=7)}
        for p in (0.2, 0.5, 0.9)
    ]
    fast = pooled(tables)
    draws = np.random.default_rng(0)
    for name, interval in fast.items():
        runs = draws.multinomial(3, np.full(3, 1 / 3), 2000)
        episodes = draws.multinomial(7, np.full(7, 1 / 7), 2000)
        means = []
        for of_runs, of_episodes in zip(runs, episodes, strict=True):
            sample = [
                table[name][episode]
                for table, times in zip(tables, of_runs, strict=True)
                for _ in range(times)
                for episode, count in enumerate(of_episodes)
                for _ in range(count)
            ]
            means.append(sum(sample) / len(sample))
        assert np.allclose([interval.low, interval.high], np.percentile(means, [2.5, 97.5]))
        assert interval.value == pytest.approx(np.mean([table[name] for table in tables]))
        assert interval.low <= interval.value <= interval.high


def test_intervals_over_runs_and_their_clusters_equal_a_slow_bootstrap() -> None:
    generator = np.random.default_rng(4)
    runs = []
    for clusters, p in ((5, 0.2), (8, 0.5), (3, 0.9)):
        trials = generator.integers(0, 4, size=(clusters, 2))
        right = generator.binomial(trials, p)
        runs.append({name: np.stack([right[:, at], trials[:, at]], 1).astype(float) for at, name in enumerate("ab")})
    fast = pooled_shares(runs)
    draws = np.random.default_rng(0)
    picked = draws.integers(3, size=(3, 2000))
    times = [
        [draws.multinomial(len(run["a"]), np.full(len(run["a"]), 1 / len(run["a"])), 2000) for run in runs]
        for _ in picked
    ]
    for name, interval in fast.items():
        shares = []
        for sample in range(2000):
            drawn = [
                cluster
                for place, of_runs in enumerate(times)
                for cluster, count in zip(
                    runs[picked[place, sample]][name], of_runs[picked[place, sample]][sample], strict=True
                )
                for _ in range(count)
            ]
            right, trials = sum(each[0] for each in drawn), sum(each[1] for each in drawn)
            if trials:
                shares.append(right / trials)
        assert np.allclose([interval.low, interval.high], np.percentile(shares, [2.5, 97.5]))
        right, trials = sum(run[name].sum(0) for run in runs)
        assert interval.value == pytest.approx(right / trials)
        assert interval.low < interval.value < interval.high
    # The sets differ, so an interval over all questions alike would be too short.
    whole = Interval.of_share(
        int(sum(run["a"][:, 0].sum() for run in runs)), int(sum(run["a"][:, 1].sum() for run in runs))
    )
    assert fast["a"].high - fast["a"].low > whole.high - whole.low


def test_a_share_of_zero_has_an_interval_over_clusters() -> None:
    runs = [{"none": np.array([[0.0, 3.0]] * 20), "all": np.array([[2.0, 2.0]] * 20), "never": np.zeros((20, 2))}] * 2
    assert pooled_shares(runs) == {"none": Interval.of_share(0, 40), "all": Interval.of_share(40, 40)}


def test_a_rate_of_zero_in_all_runs_has_an_interval() -> None:
    failed = {"tsr": np.zeros(100), "dsr": np.ones(100), "score": np.full(100, 2.0)}
    measures = pooled([failed, failed], rates=("tsr", "dsr"))
    assert measures["tsr"] == Interval.of_share(0, 100) and 0.03 < measures["tsr"].high < 0.05
    assert measures["dsr"] == Interval.of_share(100, 100) and 0.95 < measures["dsr"].low < 0.97
    assert [measures["score"].low, measures["score"].high] == pytest.approx([2.0, 2.0])


def test_violation_rates_count_episodes_by_clause() -> None:
    runs: list[dict[str, Any]] = [
        {"episodes": [{"violations": ["S10"]}, {"violations": ["S2", "S10"]}]},
        {"episodes": [{"violations": []}, {"violations": ["S2"]}]},
    ]
    rates = violation_rates(runs, ["S10", "S3", "S2"])
    assert list(rates.items()) == [("S2", 0.5), ("S3", 0.0), ("S10", 0.5)]


def test_a_variant_starts_from_the_policies_of_another(tmp_path: Path) -> None:
    variants = """
learners: {a2c: {}}
variants:
  easy: {mode: transfer-easy, hidden: true}
  more: {start: easy, group: from easy, x: 10}
  scratch: {group: from scratch, x: 10}
"""
    text = TINY.partition("learners:")[0].replace("modes: [easy]", "modes: [transfer-medium]") + variants
    experiment, cells = cells_of(write(tmp_path, text), seeds=(0,))
    assert [cell.variant for cell in cells] == ["easy", "more", "scratch"]
    assert [cell.mode for cell in cells] == ["transfer-easy", "transfer-medium", "transfer-medium"]
    root = tmp_path / "run"
    with pytest.raises(FileNotFoundError):
        prepare(cells[1], root)
    with pytest.raises(ValueError, match="a2c, more, .* starts from a2c, easy, .*, which is not among the cells"):
        run_in_processes(cells[1:], root, 1, print)
    run_here(cells, root)
    started, other = finished(cells[1], root), finished(cells[2], root)
    assert started is not None and other is not None
    assert len(started["result"]["hashes"]["start"]) == 64 and "start" not in other["result"]["hashes"]
    report = Report(experiment, cells, root)
    assert [(entry.label, entry.group, entry.x) for entry in report.entries] == [
        ("a2c, more", "from easy", 10.0),
        ("a2c, scratch", "from scratch", 10.0),
    ]
    assert "lines.svg" in {path.name for path in report.write(root)}


@pytest.mark.parametrize("mode", ["easy", "own.yaml"])
def test_an_evaluation_can_use_new_episodes(mode: str, tmp_path: Path) -> None:
    """A mode can be a file beside that of the experiment."""
    (tmp_path / "own.yaml").write_text("base: configs/easy.yaml\n")
    text = TINY.replace("[easy]", f"[{mode}]")
    text += "evaluations: {agents of training: {split: train, fresh: 5, seed: 7}, agents of test: {}}\n"
    experiment, cells = cells_of(write(tmp_path, text), only=[("quick-a2c",)], seeds=(0,))
    root = tmp_path / "run"
    run_here(cells, root)
    measured = finished(cells[0], root)
    assert measured is not None
    fresh, test = (measured["evaluations"][name] for name in ("agents of training", "agents of test"))
    assert (len(fresh["episodes"]), len(fresh["random_returns"]), len(test["episodes"])) == (5, 5, 100)
    assert fresh["episodes_hash"] not in measured["result"]["hashes"]["episodes"].values()
    assert [entry.label for entry in Report(experiment, cells, root).entries] == [
        "quick-a2c, agents of training",
        "quick-a2c, agents of test",
    ]


def test_a_training_of_another_experiment_is_reused(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The result is that of training again. Other seeds, and cells that have begun, are trained."""
    selection: dict[str, Any] = {"only": [("quick-a2c",)]}
    _, known = cells_of(tiny, **selection, seeds=(0, 2))
    run_here(known, tmp_path / "known")
    with pytest.raises(FileNotFoundError, match="not the folder of an experiment"):
        reuse(known, tmp_path / "run", tmp_path)
    text = TINY + "evaluations: {new: {split: train, fresh: 5}, test: {}}\n"
    _, cells = cells_of(write(tmp_path, text), **selection, seeds=(0, 1, 2))
    run_here(cells, tmp_path / "trained")
    root = tmp_path / "run"
    prepare(cells[2], root)
    [line] = reuse(cells, root, tmp_path / "known")
    assert line.startswith("quick-a2c, easy, seed 0: the training of ")
    assert reuse(cells, root, tmp_path / "known") == []
    begun: list[int] = []

    def counted(config: TrainConfig, *arguments: Any, **options: Any) -> dict[str, Any]:
        begun.append(config.seed)
        return train(config, *arguments, **options)

    monkeypatch.setattr("logicity.experiments.spf.train", counted)
    run_here(cells, root)
    assert begun == [1, 2]
    assert results_of(cells, root) == results_of(cells, tmp_path / "trained")


def test_a_cell_runs_only_with_its_version_rules_and_episodes(tiny: Path, tmp_path: Path) -> None:
    _, cells = cells_of(tiny, only=[("quick-a2c",)], seeds=(0,))
    folder = prepare(cells[0], tmp_path / "run")
    document = json.loads((folder / "cell.json").read_text())
    faulty: list[tuple[dict[str, Any], str]] = [
        ({"version": "0.0.0"}, "the cell is of version 0.0.0 of logicity"),
        ({"hashes": {**cells[0].spec["hashes"], "rules": "0" * 64}}, "`easy` has another content of rules than"),
    ]
    for spec, message in faulty:
        (folder / "cell.json").write_text(json.dumps({**document, "spec": {**document["spec"], **spec}}))
        with pytest.raises(ValueError, match=message):
            run_cell(folder)
    assert finished(cells[0], tmp_path / "run") is None
    # A process that is lost after the last file leaves a finished cell.
    measured = {"identity": document["identity"], "result": {}, "evaluations": {}}
    (folder / "measured.json").write_text(json.dumps(measured))
    (folder / "best.pt").write_bytes(b"the policy")
    assert run_cell(folder) == measured == finished(cells[0], tmp_path / "run")


def test_one_process_at_a_time_runs_an_experiment(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(tiny), "--run", str(tmp_path / "run")]
    with exclusive(tmp_path / "run"):
        assert command(("experiment",), arguments) == 2
        assert "help: one process at a time runs an experiment in a folder; `--run`" in capsys.readouterr().err
        assert command(("experiment",), [*arguments, "--list"]) == 0
    with exclusive(tmp_path / "run"):
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_killed_experiment_gives_the_same_table(tiny: Path, tmp_path: Path) -> None:
    root = tmp_path / "run"
    # In the first run a cell has a checkpoint; in the second one a cell is finished.
    run_with_kills([str(tiny)], root, [("checkpoint-*", 1), ("measured.json", 1)])
    experiment, cells = cells_of(tiny)
    other = tmp_path / "other"
    run_here(cells, other)
    assert results_of(cells, root) == results_of(cells, other)
    Report(experiment, cells, other).write(other)
    assert table(root) == table(other)


def table(root: Path) -> Any:
    return timeless(json.loads((root / "table.json").read_text()))


def run_with_kills(arguments: Sequence[str], root: Path, kills: Sequence[tuple[str, int]]) -> None:
    """Run an experiment in a process that is killed several times, and once to its end.

    Args:
        arguments: The experiment and further arguments.
        root: The folder of the experiment.
        kills: The files in the folders of cells that the process waits for, and their number, for each kill. The
            processes of the cells must end with the process.
    """
    once = [sys.executable, "-m", "logicity", "experiment", *arguments, "--run", str(root), "--jobs", "2"]
    for pattern, count in kills:
        with subprocess.Popen(once, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            wait_for_files(root, f"cells/*/{pattern}", process, count)
            assert process.poll() is None
            process.kill()
        wait_for(lambda: not processes_with(str(root)))
    assert subprocess.run(once, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=True).stderr


def wait_for_files(root: Path, pattern: str, process: subprocess.Popen[bytes], count: int) -> None:
    wait_for(lambda: len(list(root.glob(pattern))) >= count or process.poll() is not None)


def processes_with(text: str) -> list[int]:
    """Return the processes whose command line contains a text, on Linux."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes()
        except OSError:
            continue
        if text.encode() in line and int(path.parent.name) != os.getpid():
            found.append(int(path.parent.name))
    return found


def test_the_quick_table_of_the_paper(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Runs every cell of the table twice, the second time with two kills. Takes some minutes."""
    root = tmp_path / "run"
    quick = [str(EXPERIMENTS / "spf.yaml"), "--quick"]
    given = [*quick, "--jobs", "2", "--run", str(root)]
    assert command(("experiment",), given) == 0
    output = capsys.readouterr()
    assert output.out.startswith("Safe Path Following\n\nEasy\nlearner ")
    experiment = load_experiment(EXPERIMENTS / "spf.yaml").experiment
    entries = json.loads((root / "table.json").read_text())["entries"]
    seeds = {(entry["row"], entry["mode"]): entry["seeds"] for entry in entries}
    for row, spec in experiment.learners.items():
        for mode in experiment.modes:
            # Popper may be missing.
            assert seeds[row, mode] == [0] or (spec.optional and seeds[row, mode] == []), (row, mode)
    papers = {(entry["row"], entry["mode"]): entry["paper"] for entry in entries}
    assert papers["ppo", "easy"]["tsr"] == 0.33 and papers["a2c", "expert"]["tsr"] == 0.12
    assert command(("experiment",), [*given, "--submit", "rows.json"]) == 2
    assert "remove `--quick` and `--set`" in capsys.readouterr().err
    if sys.platform == "linux":
        run_with_kills(quick, tmp_path / "killed", [("measured.json", 8), ("measured.json", 20)])
        assert table(tmp_path / "killed") == table(root)


def test_a_folder_with_other_files_is_refused(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "table.md").write_text("precious")
    words = ("experiment",)
    assert command(words, [str(tiny), "--run", str(mine)]) == 2
    assert "is not empty (`table.md`) and has no experiment" in capsys.readouterr().err
    assert (mine / "table.md").read_text() == "precious" and len(list(mine.iterdir())) == 1
    assert command(words, [str(tiny), "--report", "--run", str(tmp_path / "new")]) == 2
    assert f"--report: `{tmp_path / 'new'}` has no experiment" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    with pytest.raises(SystemExit, match="2"):
        command(words, [str(tiny), "--seeds", "4294967296"])
    assert "expected an integer from 0 to 4294967295" in capsys.readouterr().err


def test_a_cell_that_lost_its_measures_is_not_trained_again(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, cells = cells_of(tiny, only=[("quick-a2c",)], seeds=(0,))
    run_here(cells, tmp_path)
    measured = cells[0].folder(tmp_path) / "measured.json"
    before = measured.read_text()
    measured.write_text(before[:100])
    monkeypatch.delattr("logicity.experiments.spf.train")
    run_here(cells, tmp_path)
    assert measured.read_text() == before


def test_failed_cells_do_not_stop_the_others(tiny: Path, tmp_path: Path) -> None:
    text = TINY.replace("ppo: {}", "ppo: {optional: true, changes: {settings: {batch_size: 1}}}")
    experiment, cells = cells_of(write(tmp_path, text), seeds=(0,))
    said: list[str] = []
    root = tmp_path / "run"
    failed = run_in_processes(cells, root, 2, said.append)
    assert list(failed) == [cells[0].identity] and "PPO rejects the `settings`" in failed[cells[0].identity]
    assert any("ppo, easy, seed 0: not run: PPO rejects" in line for line in said)
    report = Report(experiment, cells, root, failed)
    assert "ppo, easy: PPO rejects" in (text := report.text()) and "The figures are the paper's." in text
    said.clear()
    assert run_in_processes(cells, root, 2, said.append).keys() == failed.keys()
    assert said[0] == "1 of 2 cells are finished already"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_ray_runs_the_cell_of_a_lost_worker_again(tiny: Path, tmp_path: Path) -> None:
    run_with_a_lost_worker(tiny, tmp_path / "ray")
    _, cells = cells_of(tiny)
    run_here(cells, tmp_path / "here")
    assert results_of(cells, tmp_path / "ray") == results_of(cells, tmp_path / "here")


def test_a_sample_has_what_its_cells_start_from() -> None:
    cells = load_experiment("transfer").cells(Selection())
    drawn = [sampled(cells, 3, seed) for seed in range(20)]
    for chosen in drawn:
        names = {cell.identity for cell in chosen}
        assert all(cell.start is None or cell.start.identity in names for cell in chosen)
        assert sum(not cell.hidden for cell in chosen) >= 3 and chosen == [cell for cell in cells if cell in chosen]
    assert drawn[7] == sampled(cells, 3, 7) and any(chosen != drawn[0] for chosen in drawn)
    assert sampled(cells, 10_000, 0) == cells


def test_published_rows_are_evaluated_again(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    experiment, cells = cells_of(tiny)
    root, file = tmp_path / "run", tmp_path / "results.json"
    run_here([cells[0], cells[1]], root)
    lines = list(submit(experiment, cells, root, file))
    assert lines[-1] == f"2 rows in {file}" and "quick-a2c, easy, seed 0: not finished" in lines
    results = read_results(file)
    assert [(row["learner"], row["seed"]) for row in results["rows"]] == [("ppo", 0), ("ppo", 1)]
    assert results["rows"][0]["command"] == f"logicity experiment {tiny} --only ppo,easy --seeds 0"
    assert check_rows(results, experiment) == []
    page = leaderboard(results, loaded=experiment)
    assert "## Easy" in page and "| `ppo` | " in page and "| 0, 1 | 256 |" in page
    assert "| the paper's | 0.33 | 0.36 | 2.83 |  |  |  |  |" in page
    assert "| maxsynth, the paper's | 1.00 | 1.00 | 8.51 |  |  |  |  |" in page
    assert page.count(", the paper's |") == 11, "one of twelve learners has rows"
    results["rows"][1]["hashes"]["rules"] = "0" * 64
    assert check_rows(results, experiment) == ["ppo, test, easy, seed 1: other rules"]
    # A new row replaces the old one, and keeps its note.
    first = {**results["rows"][0], "measures": None, "note": "remarkable"}
    file.write_text(as_text({**results, "rows": [first]}))
    list(submit(experiment, cells[:2], root, file))
    assert [(row["note"], row["measures"] is None) for row in read_results(file)["rows"]] == [
        ("remarkable", False),
        ("", False),
    ]
    # A policy that was trained again gives its hash to the published row.
    published = read_results(file)["rows"][0]
    assert (published["sha256_of"], published["sha256"]) == policy_hash(load_policy(cells[0].folder(root)).policy)
    times = {"cpu_seconds": 1.5, "versions": {"logicity": "0"}, "note": "old"}
    older = {**published, **times, "sha256_of": "file", "sha256": "0" * 64}
    file.write_text(as_text({**results, "rows": [older]}))
    lines = list(submit(experiment, cells[:2], root, file, only_hashes=True))
    assert f"{cells[1].name}, test: not published" in lines
    assert read_results(file)["rows"] == [{**published, "cpu_seconds": 1.5, "note": "old"}]
    # The published file needs no evaluation.
    file_hash = hashlib.sha256(load_policy(cells[0].folder(root)).path.read_bytes()).hexdigest()
    file.write_text(as_text({**results, "rows": [{**published, **times, "sha256_of": "file", "sha256": file_hash}]}))
    lines = list(submit(experiment, cells[:1], root, file, only_hashes=True))
    assert lines[0].endswith(", from the published file")
    assert read_results(file)["rows"] == [{**published, **times}]
    changes: list[tuple[dict[str, Any], str]] = [
        (
            {"measures": {**published["measures"], "tsr": {**published["measures"]["tsr"], "value": 0.123}}},
            "the published row differs in `measures`",
        ),
        ({"sha256": "0" * 64, "sha256_of": "weights"}, "the published row has the weights 0000"),
    ]
    for change, message in changes:
        file.write_text(as_text({**results, "rows": [{**older, **change}]}))
        with pytest.raises(ValueError, match=message):
            list(submit(experiment, cells[:1], root, file, only_hashes=True))
    # A comparison says what differs.
    measures = published["measures"]
    elsewhere = {**published["versions"], "processor": "Other"}
    here, shown = published["versions"]["processor"], f"{measures['tsr']['value']:.3f}"
    compared: list[tuple[dict[str, Any], str]] = [
        ({}, f"equal, weights {published['sha256'][:12]}"),
        ({"sha256_of": "file", "sha256": file_hash, "versions": {}}, f"equal, file {file_hash[:12]}"),
        (
            {"sha256": "0" * 64, "versions": elsewhere},
            f"equal figures, weights {published['sha256'][:12]} on {here}, published weights 000000000000 on Other",
        ),
        (
            {"measures": {**measures, "tsr": {**measures["tsr"], "value": 0.123}}},
            f"other measures: TSR {shown}, published 0.123; the same weights",
        ),
    ]
    for change, expected in compared:
        file.write_text(as_text({**results, "rows": [{**published, **change}]}))
        given = [str(tiny), "--only", "ppo", "--run", str(root), "--compare", str(file)]
        assert command(("experiment",), [*given, "--seeds", "0"]) == int(not expected.startswith("equal, "))
        assert capsys.readouterr().out == f"{cells[0].name}, test: {expected}\n"
    assert command(("experiment",), given) == 1
    assert f"{cells[1].name}, test: not published" in capsys.readouterr().out
    assert command(("experiment",), [*given[:-1], str(tmp_path / "none.json")]) == 2
    assert "none.json: no such file" in capsys.readouterr().err
    file.write_text(as_text({**results, "rows": [published]}))
    # Another policy than the recorded one is refused.
    other, mine = load_policy(cells[1].folder(root)).path, load_policy(cells[0].folder(root)).path
    mine.write_bytes(other.read_bytes())
    before = file.read_bytes()
    with pytest.raises(ValueError, match=r"ppo, easy, seed 0, test: the model .* has (TSR|DSR|Score) .*, not the rec"):
        list(submit(experiment, cells, root, file))
    assert file.read_bytes() == before
    (tmp_path / "own.yaml").write_text("base: configs/easy.yaml\n")
    own, of_file = cells_of(write(tmp_path, TINY.replace("[easy]", "[own.yaml]")))
    with pytest.raises(ValueError, match="published results are of built-in modes, not of"):
        list(submit(own, of_file, root, file))
    row = results["rows"][0]
    for faulty, message in [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ("{}", "expected results of the format 4"),
        (as_text({**results, "rows": [3]}), "row 0 is not a mapping"),
        (as_text({**results, "rows": [row, {"learner": "ppo"}]}), "row 1 has no `variant`"),
        (as_text({**results, "rows": [{**row, "mode": ["easy"]}]}), "row 0 has an invalid `mode`"),
        (as_text({**results, "rows": [{**row, "sha256_of": "zip"}]}), "row 0 has an invalid `sha256_of`"),
    ]:
        file.write_text(faulty)
        with pytest.raises(ValueError, match=message):
            read_results(file)
    assert "no row yet" in leaderboard(read_results(tmp_path / "none.json", "tiny"))
    with pytest.raises(ValueError, match="expected results of `transfer`, not of `spf`"):
        read_results(ROOT / "results" / "spf.json", "transfer")


@pytest.mark.parametrize("file", sorted((ROOT / "results").glob("[a-z]*.json")), ids=lambda file: file.stem)
def test_the_page_of_results_follows_from_the_published_rows(file: Path) -> None:
    """The rules, episodes and settings of the rows are those of this version, and a page is made from them."""
    if file.stem.startswith("vap"):
        needs("torchvision", "vap")
    results = read_results(file, file.stem)
    assert results["rows"] and file.read_text(encoding="utf-8") == as_text(results)
    assert check_rows(results) == []
    page = leaderboard(results)
    for row in results["rows"]:
        assert f"`{row['learner']}`" in page and row["command"].startswith(f"logicity experiment {file.stem} --only ")
        rates = [value for name, value in row["measures"].items() if name != "score"]
        assert rates and all(
            -1e-9 <= each["low"] <= each["value"] + 1e-9 <= each["high"] + 2e-9 <= 1.1 for each in rates
        )
    pages = (ROOT / "docs" / "reference").glob("leaderboard*.md")
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    assert f"<!-- generated: results-{file.stem} -->" in text


def test_an_address_where_nothing_listens_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        _check_listening(address)
        _check_listening(f"ray://{address}")
    for closed in (address, f"ray://{address}"):
        with pytest.raises(ConnectionError, match=f"no cluster at `{closed}`.*\nhelp: start a cluster"):
            _check_listening(closed)
    _check_listening("local")
