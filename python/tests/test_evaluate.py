from __future__ import annotations

import copy
import inspect
import json
import pickle
import re
import sys
import time
from collections import Counter
from itertools import compress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import COUNTING, SLOW, Interrupt, needs
from numpy.typing import NDArray

import logicity
from logicity import (
    ACTIONS,
    ENVIRONMENTS,
    Benchmark,
    Evaluation,
    _logicity,
    demonstrations,
    evaluate,
    observation_names,
)
from logicity.__main__ import main
from logicity.describe import describe, environment_page
from logicity.files import check_writable, read_tensors, read_text, reserved, write_json
from logicity.questions import load_questions
from logicity.tasks import load_task
from logicity.types import EnvOptions


def varied(observation: NDArray[np.float32]) -> int:
    """Return an action that varies with the observation and depends on nothing else."""
    return int(observation.sum() * 7) % 4


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_the_oracle_succeeds_and_the_random_policy_scores_zero(mode: str) -> None:
    benchmark = Benchmark(mode)
    oracle, random = benchmark.evaluate("oracle"), benchmark.evaluate("random")
    assert len(oracle.episodes) == len(benchmark) == 100 and len(random.episodes) == 1000
    assert oracle.tsr.value == oracle.dsr.value == 1.0 and oracle.tsr.low < 1.0
    assert all(rate.value == 1.0 for rate in oracle.dsr_by_action.values())
    assert list(oracle.dsr_by_action) == (["Slow", "Fast", "Stop"] if mode in ("expert", "town") else ["Stop"])
    assert random.tsr.value < 0.2 and abs(random.score.value) < 1e-9
    assert oracle.score.value == pytest.approx(oracle.mean_return.value - random.mean_return.value)
    assert oracle.score.low < oracle.score.value < oracle.score.high


def test_traces_of_all_episodes(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "traces"
    result = evaluate(varied, "easy", "val", traces=folder)
    assert {path.name for path in folder.iterdir()} == {
        *(f"episode-{at}.jsonl" for at in range(40)),
        ".logicity.json",
    }
    for record in result.episodes:
        lines = (folder / f"episode-{record.episode}.jsonl").read_text().splitlines()
        header, *ticks = map(json.loads, lines)
        assert header["config"] == "easy" and len(ticks) == record.steps
        driven = [tick["agents"][0]["driven"] for tick in ticks]
        labels = [clause["doc"].split(":")[0] for clause in header["clauses"]]
        assert tuple(labels[at] for at in driven[-1]["broken"]) == record.violations
        assert not any(step["broken"] for step in driven[:-1])
    assert any(record.violations for record in result.episodes)
    assert evaluate(varied, "easy", "val") == result, "traces do not affect the result"
    with pytest.raises(ValueError, match="ten times"):
        evaluate("random", "easy", "val", traces=folder)
    command = ["evaluate", "--policy", "oracle", "--split", "val", "--traces", str(tmp_path), "--modes"]
    assert main([*command, "easy"]) == 0
    assert len(list((tmp_path / "easy").glob("episode-*.jsonl"))) == 40
    assert main([*command, "easy,easy"]) == 2
    assert main(["evaluate", "--policy", "random", "--split", "val", "--traces", str(tmp_path / "no")]) == 2
    assert not (tmp_path / "no").exists()
    changed = tmp_path / "changed"
    evaluate("oracle", "easy", "val", overrides={"task": {"patience": 3}}, traces=changed)
    header = json.loads((changed / "episode-0.jsonl").read_text().splitlines()[0])
    assert header["configuration"]["task"]["patience"] == 3


def uncalled(observation: NDArray[np.float32]) -> int:
    """Fail, because no test may call this policy."""
    raise AssertionError("the evaluation calls the policy")


def test_traces_do_not_overwrite_files(own_city: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = own_city.rename(own_city.with_name("config.yaml"))
    folder = own.parent
    (folder / "traces").mkdir()
    (folder / "traces" / "episode-77.jsonl").write_text("earlier")
    for overwrite in (False, True):
        with pytest.raises(FileExistsError, match=r"episode-77\.jsonl` is a trace of another episode than 0 to 4"):
            evaluate(uncalled, own, "val", traces=folder / "traces", overwrite=overwrite)
    assert [path.name for path in (folder / "traces").iterdir()] == ["episode-77.jsonl"]

    (folder / "hard").mkdir()
    foreign = folder / "hard" / "episode-0.jsonl"
    foreign.write_text("earlier")
    command = ["evaluate", "--policy", "oracle", "--split", "val", "--traces", str(folder), "--modes", "easy,hard"]
    assert main(command) == 2 and "hard/episode-0.jsonl`: the file exists" in capsys.readouterr().err
    assert not (folder / "easy").exists(), "the folder of the second mode is checked before the first mode runs"
    assert foreign.read_text() == "earlier" and main([*command, "--force"]) == 0
    assert json.loads(foreign.read_text().splitlines()[0])["trace"] == "logicity"


def test_traces_replace_earlier_traces(own_city: Path, tmp_path: Path) -> None:
    folder = tmp_path / "traces"
    evaluate(varied, own_city, "val", traces=folder)
    first = {path.name: path.read_text() for path in folder.glob("episode-*.jsonl")}
    assert len(first) == 5
    # Traces that this package wrote are replaced; those that have changed since only with `overwrite`.
    evaluate("oracle", own_city, "val", traces=folder)
    second = {name: (folder / name).read_text() for name in first}
    assert all(second[name] != first[name] for name in first)
    (folder / "episode-3.jsonl").write_text("edited")
    with pytest.raises(FileExistsError, match=r"episode-3\.jsonl`: the file exists, .*`overwrite` \(`--force`\)"):
        evaluate(uncalled, own_city, "val", traces=folder)
    assert (folder / "episode-3.jsonl").read_text() == "edited"
    evaluate(varied, own_city, "val", traces=folder, overwrite=True)
    assert {path.name: path.read_text() for path in folder.glob("episode-*.jsonl")} == first
    command = ["evaluate", "--policy", "oracle", "--modes", str(own_city), "--split", "val", "--traces", str(tmp_path)]
    for _ in range(2):
        assert main(command) == 0
    own = tmp_path / own_city.stem / "episode-0.jsonl"
    own.write_text("edited")
    assert main(command) == 2 and own.read_text() == "edited"
    assert main([*command, "--force"]) == 0 and own.read_text() == second["episode-0.jsonl"]


def test_unwritable_trace_folders_are_reported_early(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OSError, match="file"):
            evaluate(uncalled, "easy", "val", traces=folder)
    # Not even root can write to /proc/self, while root ignores the permissions of ordinary folders.
    closed = Path("/proc/self")
    if closed.exists():
        with pytest.raises(OSError, match="^cannot write `/proc/self/episode-0.jsonl`: "):
            evaluate(uncalled, "easy", "val", traces=closed)


class Model:
    """A predictor with the interface of a recurrent Stable-Baselines3 model."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], int]:
        assert deterministic and episode_start.shape == (len(observation),)
        assert episode_start.all() if state is None else not episode_start.any()
        return np.array([varied(row) for row in observation]), (state or 0) + 1


def test_all_kinds_of_policies_give_equal_results() -> None:
    benchmark = Benchmark("expert", "val")
    one = benchmark.evaluate(varied)
    batch = benchmark.evaluate(lambda rows: np.array([varied(row) for row in rows]), batched=True)
    assert one.episodes == batch.episodes == benchmark.evaluate(Model()).episodes
    assert (one.policy, benchmark.evaluate(Model()).policy) == ("function", "Model")
    assert len({record.steps for record in one.episodes}) > 3


def test_results_have_a_short_repr() -> None:
    shown = repr(evaluate("oracle", "easy", "val"))
    one = "1.00 [0.91, 1.00]"
    assert shown.startswith(f"<Evaluation of oracle in easy, val: compliance {one}, TSR {one}, DSR {one}, Score ")
    assert shown.endswith(", 40 episodes>") and len(shown) < 180


def test_an_evaluation_equals_runs_of_single_environments() -> None:
    measured = evaluate(varied, "hard", "val")
    env = gymnasium.make(ENVIRONMENTS["hard"], split="val")
    inner: Any = env.unwrapped
    for record in measured.episodes:
        observation, info = env.reset(options={"episode": record.episode})
        total, steps, ended = 0.0, 0, False
        taken: list[int] = []
        while not ended:
            taken.append(varied(observation))
            observation, reward, terminated, truncated, info = env.step(taken[-1])
            total, steps, ended = total + float(reward), steps + 1, terminated or truncated
        assert (record.steps, record.success, record.truncated) == (steps, info["success"], truncated)
        assert record.actions == {ACTIONS[action]: count for action, count in sorted(Counter(taken).items())}
        assert record.total == pytest.approx(total)
        assert record.violations == tuple(compress(inner.clauses, info["violations"]))
    assert measured.tsr.value == np.mean([record.success for record in measured.episodes])
    assert measured.mean_return.value == pytest.approx(np.mean([record.total for record in measured.episodes]))
    # These are the formulas of docs/how-to/measure-policies.md. Here the rules require only Stop.
    asked = [any(record.constrained.values()) for record in measured.episodes]
    kept = [required and not record.violations for required, record in zip(asked, measured.episodes, strict=True)]
    assert measured.dsr.value == np.mean(kept)
    assert measured.compliance.value == pytest.approx(sum(kept) / sum(asked))
    assert measured.dsr_by_action["Stop"].value == pytest.approx(sum(kept) / sum(asked))
    steps = sum(record.steps for record in measured.episodes)
    for shares, counts in [
        (measured.chosen(), [record.actions for record in measured.episodes]),
        (measured.required(), [record.constrained for record in measured.episodes]),
    ]:
        assert list(shares) == list(ACTIONS)
        for action, share in shares.items():
            assert share == pytest.approx(sum(each.get(action, 0) for each in counts) / steps)
    assert sum(measured.chosen().values()) == pytest.approx(1.0) and measured.required()["Stop"] > 0
    random = evaluate("random", "hard", "val").episodes
    zero = [np.mean([run.total for run in random if run.episode == record.episode]) for record in measured.episodes]
    gained = [record.total - float(mean) for record, mean in zip(measured.episodes, zero, strict=True)]
    assert measured.score.value == pytest.approx(np.mean(gained))


def test_evaluation_supports_overrides_and_states() -> None:
    lenient = evaluate(lambda state: 3, "easy", "val", overrides={"task": {"reward": {"overtime": -1}}})
    assert lenient.tsr.value == 0.0 and all(record.truncated for record in lenient.episodes)
    strict = evaluate(lambda state: 3, "easy", "val", observation="state")
    for one, other in zip(lenient.episodes, strict.episodes, strict=True):
        assert one.total - other.total == pytest.approx(2.0)
    shapes = set()

    def normal(rows: NDArray[np.float32]) -> NDArray[np.int64]:
        shapes.add(rows.shape)
        return np.ones(len(rows), np.int64)

    evaluate(normal, "easy", "val", observation="state", batched=True)
    assert shapes == {(40, 20, 15)}


def test_evaluation_of_a_configuration_file(own_city: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own, easy = evaluate(varied, own_city, "val"), evaluate(varied, "easy", "val")
    assert (own.mode, own.episodes) == (str(own_city), easy.episodes[:5])
    assert own.episodes_hash != easy.episodes_hash
    # The path may name a built-in file.
    assert Benchmark("configs/easy.yaml", "val").evaluate(varied).episodes == easy.episodes
    assert main(["evaluate", "--policy", "oracle", "--modes", f"easy,{own_city}", "--split", "val"]) == 0
    assert [line.split()[1] for line in capsys.readouterr().out.splitlines()] == ["mode", "easy", str(own_city)]


def test_episodes_that_do_not_fit_raise_with_a_hint(own_city: Path) -> None:
    fewer = {"agents": {"val": {"cars": [{"priority": 1, "count": 3}]}}}
    benchmark = Benchmark(own_city, "val", overrides=fewer)
    for drive in (lambda: benchmark.evaluate("oracle"), lambda: demonstrations(own_city, 2, "val", overrides=fewer)):
        with pytest.raises(logicity.InputError, match="logicity episodes make") as raised:
            drive()
        (fault,) = raised.value.diagnostics
        assert fault["code"] == "invalid-episode" and "`task.episodes`" in fault["help"][-1]
    with pytest.raises(logicity.InputError, match="logicity episodes make"):
        Benchmark(own_city, overrides={"task": {"episodes": None}})


def test_episodes_of_another_map_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    city = tmp_path / "map.yaml"
    city.write_text("base: expert\nmap: random-8x8\n")
    message = "the recorded episodes are for the map `square-5x5`, and the configuration has the map `random-8x8`"
    for load in (lambda: Benchmark(city), lambda: demonstrations(city)):
        with pytest.raises(logicity.InputError, match=message) as raised:
            load()
        (fault,) = raised.value.diagnostics
        assert fault["code"] == "invalid-episode" and "`logicity episodes make" in fault["help"][0]
    assert main(["evaluate", "--policy", "oracle", "--modes", str(city)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error[invalid-episode]: the recorded episodes are for the map"), error
    with pytest.raises(logicity.InputError, match=message):
        gymnasium.make(ENVIRONMENTS["expert"], overrides={"map": "random-8x8"}, episodes="recorded")


class EasyModel:
    """A model for the observations of easy mode."""

    observation_space = gymnasium.spaces.Box(0, 1, (85,))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        assert observation.shape[1:] == (85,)
        return np.ones(len(observation), np.int64), state


def test_a_model_needs_a_mode_that_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(path: Path, *, trust: bool) -> Any:
        file = path / "best.pt" if path.is_dir() else path
        run = file.parent.parent if file.parent.name.startswith("checkpoint-") else file.parent
        mode = "easy" if (run / "config.json").exists() else None
        return SimpleNamespace(policy=EasyModel(), path=file, mode=mode, observation=None, egos=None)

    monkeypatch.setitem(sys.modules, "logicity.learn", SimpleNamespace(load_policy=load))
    run = tmp_path / "dqn-easy-0"
    for model in (run / "best.pt", run / "checkpoint-0000000010" / "best.pt", tmp_path / "other" / "m.pt"):
        model.parent.mkdir(parents=True, exist_ok=True)
        model.touch()
    (run / "config.json").write_text('{"mode": "easy"}')
    split = ["--split", "val"]
    # A run records the mode, which is the default. The folder of a run means its best model.
    for policy in (run / "best.pt", run, run / "checkpoint-0000000010" / "best.pt"):
        assert main(["evaluate", "--policy", str(policy), *split]) == 0
        assert [line.split()[1] for line in capsys.readouterr().out.splitlines()] == ["mode", "easy"]
    assert main(["evaluate", "--policy", str(run), "--modes", "easy,expert", *split]) == 2
    trained = "error: this model was trained for `easy`: 85 numbers, and `expert` has 205 numbers"
    output = capsys.readouterr()
    assert (output.err, output.out) == (f"{trained}\nhelp: name `--modes easy`\n", "")
    assert main(["evaluate", "--policy", str(tmp_path / "other" / "m.pt"), *split]) == 2
    assert "error: this model takes 85 numbers, and `" in (error := capsys.readouterr().err)
    assert "\nhelp: name `--modes easy" in error
    assert main(["evaluate", "--policy", str(tmp_path / "other"), *split]) == 2
    assert "is a folder without a file `best.*`" in (error := capsys.readouterr().err) and "name the file" in error
    with pytest.raises(ValueError, match=r"the model takes observations of shape \(85,\), and those of `expert`"):
        evaluate(EasyModel(), "expert", "val")


def test_a_rule_file_is_a_policy_in_each_mode(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rules = tmp_path / "mine.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsAtInter(X), IsInInter(Y).\n')
    arguments = ["evaluate", "--policy", str(rules), "--split", "val"]
    assert main([*arguments, "--modes", "easy,medium"]) == 0
    for line, mode in zip(capsys.readouterr().out.splitlines()[1:], ["easy", "medium"], strict=True):
        measured = evaluate(logicity.RulePolicy(rules, mode), mode, "val")
        assert line.split()[:2] == ["mine", mode] and f"{measured.tsr}" in line
    assert main(arguments) == 1
    assert "name the modes with `--modes`" in capsys.readouterr().err
    saved = tmp_path / "run" / "best.dl"
    saved.parent.mkdir()
    saved.write_text("// logicity policy 1: induce, hard\n" + rules.read_text())
    assert main(["evaluate", "--policy", str(saved.parent), "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:2] == ["best", "hard"]


def test_built_in_rule_files_are_policies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", "--policy", "rules/easy.dl", "--modes", "easy", "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:3] == ["easy", "easy", "1.00"]
    by_name = logicity.RulePolicy("easy", "easy")
    assert by_name.text == logicity.RulePolicy("rules/easy.dl", "easy").text
    assert evaluate(by_name, "easy", "val").tsr.value == 1
    assert main(["evaluate", "--policy", "rules/none.dl", "--modes", "easy"]) == 2
    assert capsys.readouterr().err.startswith("error: cannot read `rules/none.dl`: no such file")


def test_an_error_does_not_hide_finished_results(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measure = Benchmark.evaluate

    def fail(self: Benchmark, *arguments: Any, **named: Any) -> Any:
        if self.mode == "medium":
            raise ValueError("broken")
        return measure(self, *arguments, **named)

    monkeypatch.setattr(Benchmark, "evaluate", fail)
    assert main(["evaluate", "--policy", "oracle", "--modes", "easy,medium", "--split", "val"]) == 1
    output = capsys.readouterr()
    assert output.out.splitlines()[1].split()[:2] == ["oracle", "easy"] and output.err == "error: broken\n"


def test_files_instead_of_folders_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "readme.py"
    file.touch()
    assert main(["evaluate", "--policy", "oracle", "--modes", "easy", "--traces", str(file)]) == 2
    message = f"error: --traces: `{file}` is a file, not a folder\nhelp: name a folder; it need not exist\n"
    assert capsys.readouterr().err == message
    # Other errors of the system are described without their numbers.
    assert main(["evaluate", "--policy", "oracle", "--modes", "easy", "--json", str(file / "a.json")]) == 2
    assert "Errno" not in capsys.readouterr().err


def test_episodes_without_required_actions_lower_only_dsr(tmp_path: Path) -> None:
    rules = tmp_path / "few.dl"
    rules.write_text('.include "vocabulary.dl"\nStop(X) :- IsAtInter(X), IsInInter(Y), IsAmbulance(Y).\n')
    oracle = evaluate("oracle", "easy", "val", rules=rules)
    asked = [any(record.constrained.values()) for record in oracle.episodes]
    assert oracle.dsr.value == np.mean(asked) and 0 < oracle.dsr.value < 1
    assert oracle.compliance.value == 1.0 and oracle.tsr.value > oracle.dsr.value
    assert oracle.dsr_by_action["Stop"].value == 1.0


def test_recorded_episodes_are_sampled_with_replacement_or_enumerated() -> None:
    drawn = gymnasium.make_vec(ENVIRONMENTS["easy"], num_envs=40, split="val", episodes="recorded")
    chosen = gymnasium.make_vec(ENVIRONMENTS["easy"], num_envs=40, split="val")
    some = set(drawn.reset(seed=0)[1]["seed"].tolist())
    every = set(chosen.reset(options={"episodes": range(40)})[1]["seed"].tolist())
    assert len(every) == 40 and some < every


@pytest.mark.parametrize(
    ("policy", "batched", "error"),
    [
        ("perfect", False, ValueError),
        (7, False, TypeError),
        (lambda row: 4, False, ValueError),
        (lambda row: -1, False, ValueError),
        (lambda row: 1.5, False, TypeError),
        (lambda row: float("nan"), False, TypeError),
        (lambda row: None, False, TypeError),
        (lambda row: [1, 2], False, ValueError),
        (lambda rows: 1, True, ValueError),
        (lambda rows: np.ones((len(rows), 1), np.int64), True, ValueError),
        (lambda rows: np.ones(len(rows)), True, TypeError),
    ],
)
def test_invalid_policies_raise(policy: Any, batched: bool, error: type[Exception]) -> None:
    benchmark = Benchmark("easy", "val")
    with pytest.raises(error):
        benchmark.evaluate(policy, batched=batched)
    assert benchmark.evaluate("oracle").tsr.value == 1.0


@pytest.mark.parametrize(
    ("action", "found"),
    [("Stop", "'Stop'"), (None, "None"), (1.5, "1.5"), (np.float32(1), "1.0"), (True, "True")],
)
def test_actions_of_other_types_are_named(action: Any, found: str) -> None:
    message = f"^expected integer actions, not {found}; known: 0 Slow, 1 Normal, 2 Fast, 3 Stop$"
    for batched in (False, True):
        policy = (lambda rows: [action] * len(rows)) if batched else (lambda row: action)
        with pytest.raises(TypeError, match=message):
            evaluate(policy, "easy", "val", batched=batched)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"mode": "simple"}, ValueError),
        ({"mode": "no-such.yaml"}, OSError),
        ({"mode": "configs/vap-easy.yaml"}, logicity.InputError),
        ({"mode": "easy", "split": "exam"}, ValueError),
        ({"mode": "easy", "observation": "pixels"}, ValueError),
        ({"mode": "easy", "rules": "no.dl"}, OSError),
        ({"mode": "easy", "overrides": {"task": {"horizon": 0}}}, logicity.InputError),
    ],
)
def test_invalid_benchmarks_raise(arguments: dict[str, Any], error: type[Exception]) -> None:
    with pytest.raises(error):
        Benchmark(**arguments).evaluate("oracle")


def test_an_interrupted_policy_leaves_the_benchmark_usable() -> None:
    def interrupted(observation: NDArray[np.float32]) -> int:
        raise KeyboardInterrupt

    benchmark = Benchmark("easy", "val")
    with pytest.raises(KeyboardInterrupt):
        benchmark.evaluate(interrupted)
    assert benchmark.evaluate("oracle").tsr.value == 1.0


def test_the_command_prints_a_table_and_writes_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "out.json"
    arguments = ["evaluate", "--policy", "oracle", "--modes", "easy,hard", "--split", "val", "--json", str(file)]
    assert main(arguments) == 0
    output = capsys.readouterr()
    rows = output.out.splitlines()
    assert rows[0].split() == ["policy", "mode", "compliance", "TSR", "DSR", "Score", "return", "steps"]
    assert rows[1].split()[:4] == ["oracle", "easy", "1.00", "[0.91,"] and rows[2].split()[1] == "hard"
    assert output.err == f"wrote {file}\n", "progress appears only on terminals"
    assert len(rows) == 3
    assert main([*arguments[:7], "--by-action"]) == 0
    again = capsys.readouterr().out.splitlines()
    assert again[:3] == rows and again[4].split() == ["policy", "mode", "action", "chosen", "required", "DSR"]
    assert [row.split()[2] for row in again[5:9]] == list(ACTIONS)
    # In easy mode the rules require only Stop, and the oracle chooses it whenever they do.
    stops = again[8].split()
    assert stops[3] == stops[4] and stops[5] == "1.00" and [row.split()[4] for row in again[5:8]] == ["0.000"] * 3
    written = json.loads(file.read_text())
    direct: Evaluation = evaluate("oracle", "easy", "val")
    assert written[0] == json.loads(json.dumps(direct.to_dict()))
    assert {path.name for path in tmp_path.iterdir()} == {"out.json", ".logicity.json"}
    # The compliance rate is the first measure.
    assert list(written[0])[4:8] == ["compliance", "tsr", "dsr", "dsr_by_action"]
    file.write_text("foreign")
    assert main(arguments) == 2 and "--force" in capsys.readouterr().err and file.read_text() == "foreign"
    assert main([*arguments, "--force"]) == 0 and json.loads(file.read_text()) == written


def test_a_copied_benchmark_measures_the_same() -> None:
    benchmark = Benchmark("easy", "val", overrides={"view": 30})
    measured = benchmark.evaluate(varied)
    for again in (copy.deepcopy(benchmark), pickle.loads(pickle.dumps(benchmark))):
        assert again.evaluate(varied) == measured
    assert pickle.loads(pickle.dumps(measured)) == measured


def test_progress_is_shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    evaluate("oracle", "easy", "val")
    shown = capsys.readouterr().err
    assert "easy val, oracle: 40 of 40" in shown and "easy val, random policy: 40 of 40" in shown
    assert shown.endswith("\r\x1b[K")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (
            ["evaluate", "--policy", "no-such.pt", "--modes", "easy"],
            2,
            "error: cannot read `no-such.pt`: no such file",
        ),
        (["evaluate", "--policy", "runs/best", "--modes", "easy"], 2, "error: cannot read `runs/best`: no such file"),
        (
            ["evaluate", "--policy", "foo"],
            2,
            "unknown policy `foo`: expected oracle, random, a name that `logicity policies` lists, the file",
        ),
        (["evaluate", "--policy", "oracle", "--modes", "easy", "--json", "no/such/folder.json"], 2, "error: "),
        (["evaluate", "--policy", "oracle", "--modes", "simple"], 2, "unknown mode `simple`"),
        (["evaluate", "--policy", "oracle", "--split", "exam"], 2, "invalid choice"),
        (["evaluate"], 2, "--policy"),
    ],
)
def test_invalid_commands_print_an_error(
    arguments: list[str], status: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        ended = main(arguments)
    except SystemExit as exit:  # raised by argparse
        ended = int(exit.code or 0)
    assert ended == status and message in capsys.readouterr().err


ATOM = re.compile(r"(\w+)\((\w+)(?:, (\w+))?\)")


def parts(atom: str) -> tuple[str, tuple[str, ...]]:
    match = ATOM.fullmatch(atom)
    assert match, atom
    return match[1], tuple(of for of in match.groups()[1:] if of is not None)


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_observation_names_match_the_true_atoms(mode: str) -> None:
    """The true atoms with agents for entities are, for one choice of agents a step, just what `true_atoms` has."""
    names = observation_names(mode)
    env = gymnasium.make(ENVIRONMENTS[mode], atoms=True)
    observation, info = env.reset(seed=5)
    generator, seen = np.random.default_rng(5), set()
    for _ in range(400):
        assert len(names) == len(observation)
        shown = [parts(names[at]) for at in np.flatnonzero(observation)]
        agents = {"0": "Car_1"}
        for (predicate, entities), (true, named) in zip(shown, map(parts, info["true_atoms"]), strict=True):
            assert predicate == true and len(entities) == len(named)
            assert all(agents.setdefault(entity, name) == name for entity, name in zip(entities, named, strict=True))
            seen.add(predicate)
        assert len(set(agents.values())) == len(agents), "each entity is one agent"
        observation, _, terminated, truncated, info = env.step(int(generator.integers(4)))
        if terminated or truncated:
            observation, info = env.reset()
    assert len(seen) > 6


def test_names_follow_the_configuration(own_city: Path) -> None:
    names = observation_names("easy")
    assert names == observation_names(own_city) and len(set(names)) == len(names) == 85
    assert names[6] == "IsCar(1)" and names[35 + 5 * 2 + 3] == "HigherPri(2, 3)"
    assert observation_names("easy", overrides={"task": {"route_length": True}}) == (*names, "route length")
    with pytest.raises(ValueError, match="unknown mode `esy`.*did you mean `easy`"):
        observation_names("esy")


def test_files_are_replaced_atomically(tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    write_json(file, {"a": 1}, by="test")
    with pytest.raises(ValueError):
        write_json(file, {"a": float("nan")}, by="test")
    assert json.loads(file.read_text()) == {"a": 1}
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", ".logicity.json"}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc and sparse files")
def test_files_without_an_end_are_refused_at_once(tmp_path: Path) -> None:
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(100 << 30)
    for path, message in [(Path("/proc/self/status"), "may never end"), (tmp_path / "sparse", "larger than 1024 MiB")]:
        with pytest.raises(OSError, match=message):
            read_text(path)
        with pytest.raises(OSError, match=message):
            read_tensors(path, "a policy")
    with pytest.raises(OSError, match="may never end"):
        load_questions("/proc/self/status")


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")
def test_files_of_other_programs_are_protected(tmp_path: Path) -> None:
    file, link = tmp_path / "file.json", tmp_path / "link.json"
    link.symlink_to("file.json")
    write_json(link, 1, by="test")
    file.chmod(0o640)
    write_json(link, 2, by="test")
    assert link.is_symlink() and json.loads(file.read_text()) == 2 and file.stat().st_mode & 0o777 == 0o640
    file.write_text("foreign")
    with pytest.raises(FileExistsError, match="overwrite"):
        write_json(file, 3, by="test")
    assert file.read_text() == "foreign"
    write_json(file, 3, by="test", overwrite=True)
    write_json(file, 4, by="test")
    with pytest.raises(FileExistsError, match="`test` wrote it"):
        write_json(file, 5, by="another")
    with reserved(file, by="test"), pytest.raises(OSError, match="this process already writes it"):
        write_json(file, 5, by="test")
    with pytest.raises(OSError):
        check_writable(tmp_path / "missing" / "file.json", by="test")
    assert {path.name for path in tmp_path.iterdir()} == {"file.json", "link.json", ".logicity.json"}


def test_the_command_prints_the_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["describe"]) == 0 and capsys.readouterr().out == describe()


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_the_tables_describe_groundings_observations(mode: str) -> None:
    env = gymnasium.make(ENVIRONMENTS[mode])
    assert env.observation_space.shape is not None
    row = next(line for line in describe().splitlines() if f"`{ENVIRONMENTS[mode]}`" in line)
    assert f"({env.observation_space.shape[0]},)" in row


@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_the_page_of_an_environment_describes_it(mode: str) -> None:
    page = environment_page(mode)
    sections = dict(part.split("\n", 1) for part in page.split("\n## ")[1:])
    assert list(sections) == [
        "Description",
        "Action space",
        "Observation space",
        "Observations of the kind `state`",
        "Rewards",
        "Information",
        "Starting state",
        "Episode end",
        "Arguments",
        "Version history",
    ]
    env = gymnasium.make(ENVIRONMENTS[mode], atoms=True, action_masks=True)
    inner: Any = env.unwrapped
    _, info = env.reset(seed=0)

    def column(section: str, number: int = 0) -> list[str]:
        rows = [line.strip("| ").split(" | ") for line in sections[section].splitlines() if line.startswith("| ")]
        return [row[number].strip("`") for row in rows[1:]]

    assert f"`{env.observation_space!r}`" in page and f"`{env.action_space!r}`" in page
    assert env.spec is not None and f"{env.spec.max_episode_steps} steps" in sections["Episode end"]
    assert set(column("Information")) == set(info)
    assert tuple(column("Description", 1)) == inner.clauses and all(column("Description", 4))
    parameters = inspect.signature(type(inner)).parameters.values()
    named = {each.name for each in parameters if each.kind is each.KEYWORD_ONLY} | set(EnvOptions.__annotations__)
    assert set(column("Arguments")) == named and all(column("Arguments", 2))
    assert dict(zip(column("Arguments"), column("Arguments", 1), strict=True))["split"] == "'train'"


def test_a_page_needs_a_mode() -> None:
    with pytest.raises(ValueError, match="unknown mode `exprt`; did you mean `expert`"):
        environment_page("exprt")


def _columns_of_state(mode: str) -> list[str]:
    """Return the predicates of the last columns of a `state` observation, from the table."""
    lines = describe().split("### Observations of the kind `state`")[1].splitlines()
    (row,) = [line for line in lines if re.search(rf"in (.*, )?{mode}(,.*)?: `", line)]
    names = re.findall(r"`(\w+)`", row)
    assert row.startswith(f"| 8 to {7 + len(names)} |")
    return names


@pytest.mark.parametrize("overrides", [{}, {"task": {"state_agents": 3}}])
@pytest.mark.parametrize("mode", list(ENVIRONMENTS))
def test_the_table_describes_state_observations(mode: str, overrides: dict[str, Any]) -> None:
    env = gymnasium.make(ENVIRONMENTS[mode], observation="state", atoms=True, overrides=overrides)
    names = _columns_of_state(mode)
    assert env.observation_space.shape is not None and env.observation_space.shape[1] == 8 + len(names)
    task = _logicity.describe(load_task(mode))
    headed = 0
    for seed in range(5):
        state, info = env.reset(seed=seed)
        start = env.unwrapped.episode["agents"]  # type: ignore[attr-defined]
        ego = next(agent for agent in start if agent["id"] == "Car_1")
        there = [
            agent
            for agent in start
            if agent is not ego and max(abs(agent["start"][at] - ego["start"][at]) for at in (0, 1)) <= task["view"]
        ]
        rows = [ego, *there][: len(state)]
        assert state[:, 0].tolist() == [1.0] * len(rows) + [0.0] * (len(state) - len(rows))
        assert not state[len(rows) :].any() and not state[:, 3:7].any()
        for row, agent in zip(state, rows, strict=False):
            cells = [agent["start"][at] - ego["start"][at] for at in (0, 1)]
            assert row[1:3] * task["view"] == pytest.approx(cells, abs=1e-4)
            assert row[7] * task["priority_scale"] == pytest.approx(agent["priority"], abs=1e-4)
        # The columns of the ego equal its unary atoms.
        true = {atom for atom in info["true_atoms"] if atom.endswith("(Car_1)") and "," not in atom}
        assert {f"{name}(Car_1)" for name, value in zip(names, state[0, 8:], strict=True) if value} == true
        for _ in range(4):
            before = state
            state, _, over, _, _ = env.step(1)
            if over:
                break
            if state[0, 3:7].any() and not np.array_equal(state[0], before[0]):
                headed += 1
                assert state[0, 3:7].sum() == 1
    assert headed


def test_ctrl_c_ends_an_evaluation(tmp_path: Path, ctrl_c: Interrupt) -> None:
    (tmp_path / "counting.dl").write_text(COUNTING)
    always = {name: Benchmark("easy", "val", rules=tmp_path / "counting.dl") for name in ("stop", "random")}
    ctrl_c(lambda: always["stop"].evaluate(lambda observation: 3))
    ctrl_c(lambda: always["random"].evaluate("random"))
    ctrl_c(lambda: always["random"].evaluate("random"))


def test_ctrl_c_ends_many_short_steps(tmp_path: Path, ctrl_c: Interrupt) -> None:
    (tmp_path / "slow.dl").write_text(SLOW)
    baseline = _logicity.RandomBaseline(load_task("hard", tmp_path / "slow.dl"), "test")
    begun = time.monotonic()
    ctrl_c(baseline.add)
    interrupted = time.monotonic()
    assert not baseline.report()["episodes"], "an episode is added with all its runs, or not at all"
    baseline.add()
    assert len(baseline.report()["episodes"]) == 10
    assert interrupted - begun < (time.monotonic() - interrupted) / 2


def test_a_plot_shows_how_every_episode_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs("matplotlib", "learn")
    plot, other = tmp_path / "returns.svg", tmp_path / "other.svg"
    arguments = ["evaluate", "--policy", "rules/easy.dl", "--modes", "easy,medium", "--split", "val"]
    assert main([*arguments, "--plot", str(plot), "--json", str(tmp_path / "results.json")]) == 0
    assert f"wrote {plot}" in capsys.readouterr().err
    text = plot.read_text(encoding="utf-8")
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    # A circle for each episode, and one in the legend.
    for color, ended in (("#55a868", True), ("#c44e52", False)):
        of = [
            [record for record in result["episodes"] if not record["truncated"] and record["success"] == ended]
            for result in results
        ]
        assert text.count(f"fill: {color}; stroke: {color}") == sum(len(each) + 1 for each in of)
    for title in ("easy: easy, val", "easy: medium, val"):
        assert f"<!-- {title} -->" in text
    assert main([*arguments, "--plot", str(other)]) == 0
    assert other.read_bytes() == plot.read_bytes()
    mine = tmp_path / "mine.svg"
    mine.write_text("mine")
    assert main([*arguments, "--plot", str(mine)]) == 2 and mine.read_text() == "mine"
    with pytest.raises(SystemExit) as exit:
        main([*arguments, "--plot", "returns.pdf"])
    assert exit.value.code == 2
    assert "ends in .png or .svg, not `returns.pdf`" in capsys.readouterr().err
