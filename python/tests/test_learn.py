from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import needs, timeless

from logicity import ENVIRONMENTS, InputError, evaluate
from logicity.__main__ import main
from logicity.envs import SPFVectorEnv
from logicity.files import reserved

needs("stable_baselines3", "learn")
import torch  # noqa: E402

from logicity.learn import LEARNERS, TrainConfig, learner_class, load_policy, train  # noqa: E402
from logicity.learn import run as training  # noqa: E402
from logicity.learn.stable_baselines import StableBaselinesPolicy  # noqa: E402
from logicity.learn.storage import policy_hash  # noqa: E402

#: A configuration without the values of its settings.
GIVEN = "algorithm: dqn\nmode: easy\nsettings: "
BASELINES = Path(__file__).parents[2] / "configs" / "baselines"
#: The keys of a learner that learns all at once.
ONE_UPDATE: dict[str, Any] = {"steps": 1, "validate_every": 1, "demonstrations": 0.1}
#: The learners that need another program.
WITH_PROGRAMS = ("popper", "maxsynth")
#: The keys of a tiny run of each learner, in easy mode.
TINY: dict[str, dict[str, Any]] = {
    "dqn": {"settings": {"network": [16, 8], "learning_starts": 100, "buffer_size": 1000, "batch_size": 16}},
    "ppo": {"settings": {"network": [16, 8], "n_steps": 16, "batch_size": 32}},
    "a2c": {"settings": {"network": [16, 8], "n_steps": 16}},
    "nlm-dqn": {"settings": {"network": [8], "depth": 2, "learning_starts": 100, "batch_size": 16, "buffer_size": 500}},
    "nlm-ppo": {"settings": {"network": [8], "depth": 2, "n_steps": 16, "batch_size": 32}},
    "mb-shooting": {
        "settings": {"members": 2, "width": 8, "sequences": 4, "horizon": 2, "random_steps": 100, "buffer_size": 500}
    },
    "dreamer": {
        "settings": {
            **{"deterministic": 12, "variables": 3, "classes": 4, "layers": 1, "width": 10, "batch_size": 6},
            **{"random_steps": 100, "train_interval": 20, "updates": 1, "imagination": 3, "buffer_size": 500},
        }
    },
    "ppo-fast": {"settings": {"network": [8], "rollout_steps": 16}},
    "mlp": {"settings": {"network": [8], "batch_size": 32}},
    "gnn": {"settings": {"network": [8], "batch_size": 32}},
    "nlm": {"settings": {"depth": 1, "outputs": 2, "batch_size": 32}},
    "transformer": {"settings": {"layers": 1, "heads": 2, "head_width": 3, "feedforward": 8, "batch_size": 32}},
    "hri": {"settings": {"restarts": 2, "depth": 1, "batch": 16}, "demonstrations": 0.1},
    "popper": {"settings": {"timeout": 5.0}, **ONE_UPDATE},
    "maxsynth": {"settings": {"timeout": 5.0}, **ONE_UPDATE},
    "foldrm": ONE_UPDATE,
    "induce": ONE_UPDATE,
    "planner": {"settings": {"horizon": 2}, "steps": 1, "validate_every": 1},
}
#: The keys of a tiny run of every learner in environments.
IN_ENVIRONMENTS = {"steps": 512, "envs": 2, "validate_every": 200, "overrides": {"task": {"reward": {"overtime": -6}}}}


def short(algorithm: str, **changes: Any) -> TrainConfig:
    common = IN_ENVIRONMENTS if learner_class(algorithm).interacts else {"steps": 4, "validate_every": 1}
    return TrainConfig(**{"algorithm": algorithm, "mode": "easy", **common, **TINY[algorithm], **changes})


def test_the_schema_is_that_of_the_class() -> None:
    """`logicity schema training` prints the schema of this class and the installed Stable-Baselines3."""
    text = json.dumps(TrainConfig.json_schema(), indent=2) + "\n"
    shipped = (BASELINES / "schema.json").read_text(encoding="utf-8")
    assert shipped == text, "write `TrainConfig.json_schema()` to configs/baselines/schema.json"
    printed = subprocess.run(
        [sys.executable, "-m", "logicity", "schema", "training"], capture_output=True, text=True, check=True
    ).stdout
    assert printed == text


def test_every_mode_of_the_paper_has_a_configuration_for_every_algorithm() -> None:
    for algorithm in ("dqn", "ppo", "a2c"):
        for mode in ("easy", "medium", "hard", "expert"):
            config = TrainConfig.load(BASELINES / f"{algorithm}-{mode}.yaml")
            assert (config.algorithm, config.mode, config.steps) == (algorithm, mode, 200_000)
    for file in BASELINES.glob("*.yaml"):
        config = TrainConfig.load(file)
        if config.algorithm in ("ppo", "nlm-ppo"):
            # Otherwise Stable-Baselines3 warns about truncated batches.
            settings: Any = config.settings
            assert settings.n_steps * config.envs % settings.batch_size == 0
    expert = TrainConfig.load(BASELINES / "ppo-expert.yaml")
    given: Any = expert.settings
    assert (given.batch_size, given.n_steps, given.network) == (64, 2048, (128, 64, 64))
    clauses = dict.fromkeys(("L1", "L2", "L3", "F1", "F2", "F3"), -3)
    assert expert.overrides == {"task": {"reward": {"overtime": -10, "clauses": clauses}}}


def content(path: Path) -> Any:
    """Return what a file of a policy contains."""
    return torch.load(path, weights_only=True) if path.suffix == ".pt" else path.read_bytes()


def equal(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(equal, one, other))
    return torch.equal(one, other) if isinstance(one, torch.Tensor) else bool(one == other)


@pytest.mark.parametrize("algorithm", [name for name in LEARNERS if name not in WITH_PROGRAMS])
def test_a_short_run_leaves_all_files(algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, config = tmp_path / "run", short(algorithm)
    result = train(config, run)
    assert json.loads((run / "result.json").read_text()) == json.loads(json.dumps(result))
    assert result["config"] == config.to_dict() == json.loads((run / "config.json").read_text())
    assert TrainConfig.load(run / "config.json") == config == TrainConfig(**config.to_dict())
    assert result["unit"] == learner_class(algorithm).unit and result["cpu_seconds"] > 0
    assert result["hashes"]["episodes"]["test"] == result["test"]["episodes_hash"]
    assert result["best"] == max(
        result["validations"], key=lambda point: (point["tsr"]["value"], point["score"]["value"])
    )
    assert list((run / "tensorboard" / "validation").rglob("events*"))
    assert [path.name for path in run.glob("*checkpoint-*")] == [f"checkpoint-{result['steps']:010}"]
    (best,) = run.glob("best.*")
    assert best.suffix == learner_class(algorithm).suffix
    for path in (best, run):
        saved = load_policy(path)
        assert (saved.algorithm, saved.mode, saved.observation) == (algorithm, "easy", "groundings")
        assert isinstance(saved.policy, learner_class(algorithm).policy_class)
    measured = evaluate(saved.policy, "easy")
    assert measured.tsr.value == result["test"]["tsr"]["value"]
    assert main(["evaluate", "--policy", str(best), "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("best    easy")


@pytest.mark.parametrize("algorithm", ["dqn", "ppo", "a2c"])
def test_validations_follow_the_interval(algorithm: str, tmp_path: Path) -> None:
    steps = [point["steps"] for point in train(short(algorithm), tmp_path, tensorboard=False)["validations"]]
    assert [step // 200 for step in steps] == [1, 2, 2] and steps[-1] == 512


def test_built_in_configurations_need_no_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = sorted(BASELINES.glob("*.yaml"))
    monkeypatch.chdir(tmp_path)
    assert files
    for file in files:
        assert TrainConfig.load(f"configs/baselines/{file.name}") == TrainConfig.load(file)
    with pytest.raises(FileNotFoundError, match="baselines/none.yaml"):
        TrainConfig.load("configs/baselines/none.yaml")


def test_faults_of_the_command_are_printed_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "b1.yaml"
    config.write_text("algorithm: dqn\nmode: easy\nsettings: {network: 8}\n")
    assert main(["train", str(config)]) == 1
    assert capsys.readouterr().err.startswith("error[invalid-value]: ")
    assert main(["train", "dqn-easy", "--run", str(config)]) == 2
    assert capsys.readouterr().err.startswith(f"error: --run: `{config}` is a file, not a folder\nhelp: name a folder")


def test_messages_do_not_quote_pydantic(tmp_path: Path) -> None:
    good = "algorithm: {}\nmode: easy\nsettings: {{}}\n"
    keys = set(TrainConfig.model_fields)
    texts = [(key, good.format("dqn").replace(f"{key}:", "seed: 0 #") + f"{key}: ") for key in keys]
    for algorithm in LEARNERS:
        for setting in learner_class(algorithm).settings_class.model_fields:
            texts.append((setting, good.format(algorithm).replace("{}", f"{{{setting}: ")))
    values = ["word", "1.5", "-3", "true", "[1, [2], x]", "{a: 1}", "[]", "~"]
    refused: dict[str, int] = {}
    for key, text in texts:
        for value in values:
            (tmp_path / "config.yaml").write_text(text + value + ("}" if text.endswith(f"{{{key}: ") else ""))
            try:
                TrainConfig.load(tmp_path / "config.yaml")
            except InputError as error:
                refused[key] = refused.get(key, 0) + 1
                for words in ("Input", "should", "valid (", "pydantic", "dictionary", "string", "tuple"):
                    assert words not in "".join(fault["message"] for fault in error.diagnostics), error
                assert all(fault["labels"] for fault in error.diagnostics)
    assert refused.keys() == {key for key, _ in texts} and min(refused.values()) >= 2


def test_progress_is_logged_without_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(json.dumps(short("dqn").to_dict()))
    command = [sys.executable, "-m", "logicity", "train", str(tmp_path / "config.json"), "--run", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = done.stderr.splitlines()
    assert lines[0] == f"dqn in easy, started: 512 steps; folder {tmp_path / 'run'}"
    validations = [line for line in lines if line.startswith("validation after ")]
    assert [line.split()[2] for line in validations] == ["200", "400", "512"]
    assert all(re.search(r"steps: compliance \d\.\d\d \[.*TSR .*DSR .*Score ", line) for line in validations)
    assert done.stdout.splitlines()[0].startswith("512 environment steps in ")
    assert done.stdout.splitlines()[1].startswith("compliance on test episodes: ")


def test_the_first_line_is_logged_before_a_kill(tmp_path: Path) -> None:
    config = short("dqn").model_copy(update={"steps": 10**6, "validate_every": 10**6})
    (tmp_path / "config.json").write_text(json.dumps(config.to_dict()))
    command = [sys.executable, "-m", "logicity", "train", str(tmp_path / "config.json"), "--run", str(tmp_path / "run")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as run:
        assert run.stderr is not None
        try:
            assert run.stderr.readline().startswith("dqn in easy, started: 1,000,000 steps")
        finally:
            run.kill()


def test_progress_lines_have_speed_and_remaining_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(training._Display, "SECONDS", 0.0)
    train(short("ppo"), tmp_path, progress=True, tensorboard=False)
    lines = [line for line in capsys.readouterr().err.splitlines() if " steps/s, " in line]
    assert len(lines) == 16
    assert re.fullmatch(r"32 of 512 steps \(6%\), [\d,]+ steps/s, \d+\.\d min left", lines[0])
    assert re.fullmatch(r"512 of 512 steps \(100%\), [\d,]+ steps/s, 0\.0 min left", lines[-1])


def test_the_steps_of_a_finished_run_can_be_raised(tmp_path: Path) -> None:
    config = short("dqn")
    first = train(config, tmp_path, tensorboard=False)
    assert first["steps"] == 512
    longer = config.model_copy(update={"steps": 900})
    second = train(longer, tmp_path, tensorboard=False)
    # DQN steps in rounds of `train_freq` steps of each environment.
    assert second["steps"] == 904 and second["config"]["steps"] == 900
    assert second["validations"][:3] == first["validations"]
    assert [point["steps"] for point in second["validations"][3:]] == [600, 800, 904]
    assert json.loads((tmp_path / "config.json").read_text())["steps"] == 900
    with pytest.raises(ValueError, match="has a run of 904 steps: `steps` can be raised, not lowered to 512"):
        train(config, tmp_path, tensorboard=False)
    with pytest.raises(ValueError, match="another configuration \\(`seed` differ\\)"):
        train(longer.model_copy(update={"seed": 5}), tmp_path, tensorboard=False)


def test_a_mode_can_be_a_configuration_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "configs"
    folder.mkdir()
    (folder / "far.yaml").write_text("base: configs/easy.yaml\nview: 30\ntask: {reward: {overtime: -6}}\n")
    (tmp_path / "base.yaml").write_text("mode: configs/far.yaml\nobservation: state\n")
    (folder / "train.yaml").write_text(
        "base: ../base.yaml\nalgorithm: ppo\nsteps: 256\nenvs: 2\nvalidate_every: 200\n"
        "settings: {network: [16, 8], n_steps: 64, batch_size: 32}\n"
    )
    config = TrainConfig.load(folder / "train.yaml")
    assert config.mode == str(folder / "far.yaml") and config.observation == "state"
    (tmp_path / "built-in.yaml").write_text("base: configs/train.yaml\nmode: configs/hard.yaml\n")
    assert TrainConfig.load(tmp_path / "built-in.yaml").mode == "configs/hard.yaml"
    run = tmp_path / "run"
    result = train(config, run, tensorboard=False)
    model = load_policy(run).policy
    assert isinstance(model, StableBaselinesPolicy) and model.observation_space.shape == (20, 15)
    measured = evaluate(model, folder / "far.yaml", observation="state")
    assert measured.score.value == result["test"]["score"]["value"]
    # The command knows the kind of observation from the model.
    assert main(["evaluate", "--policy", str(run / "best.pt"), "--modes", config.mode, "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[1] == config.mode
    for name in ("train", "val", "test"):
        wrong = folder / f"no-{name}.yaml"
        wrong.write_text(f"base: configs/easy.yaml\ntask: {{episodes: {{{name}: ~}}}}\n")
        if name != "train":
            # Missing episodes are reported before training starts.
            with pytest.raises(InputError, match="logicity episodes make"):
                train(config.model_copy(update={"mode": str(wrong)}), tmp_path / name)
            assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"route_length": True}, r"shape of observations from \(85,\) to \(86,\).*name it under `mode`"),
        ({"order": "nearest"}, "order of entities from list to nearest.*name it under `mode`"),
    ],
)
def test_overrides_must_not_change_observations(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    config = short("dqn").model_copy(update={"overrides": {"task": change}})
    with pytest.raises(ValueError, match=message):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("algorithm", ["dqn", "mb-shooting", "ppo-fast"])
def test_training_episodes_can_be_demanding(algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    make = SPFVectorEnv.__init__

    def spy(self: SPFVectorEnv, *positional: Any, **named: Any) -> None:
        made.append(named["episodes"])
        make(self, *positional, **named)

    monkeypatch.setattr(SPFVectorEnv, "__init__", spy)
    result = train(short(algorithm).model_copy(update={"episodes": "drawn-demanding"}), tmp_path)
    assert made == ["drawn-demanding"] and result["config"]["episodes"] == "drawn-demanding"


class Killed(Exception):
    pass


@pytest.mark.parametrize("algorithm", [name for name in LEARNERS if name not in WITH_PROGRAMS])
def test_an_interrupted_run_equals_an_uninterrupted_one(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = short(algorithm)
    whole = train(config, tmp_path / "whole", tensorboard=False)
    progress = training._Training.progress
    calls = 0

    def kill(self: Any) -> None:
        nonlocal calls
        progress(self)
        # The run continues after the checkpoint for two more calls, whose work is lost.
        calls += bool(self._state.validations)
        if calls == 3:
            raise Killed

    run = tmp_path / "run"
    if len(whole["validations"]) > 1:
        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(training._Training, "progress", kill)
            train(config, run, tensorboard=False)
        (left,) = run.glob("checkpoint-*")
        state = json.loads((left / "state.json").read_text())
        assert 0 < state["steps"] < whole["steps"] and not (run / "result.json").exists()
        # A kill during the next checkpoint leaves an incomplete temporary folder, which is ignored.
        (run / f".checkpoint-{whole['steps']:010}").mkdir()
    torch.manual_seed(99)
    np.random.seed(99)
    resumed = train(config, run, tensorboard=False)
    assert timeless(resumed) == timeless(whole)
    for name in ("best.*", "checkpoint-*/best.*"):
        (one,), (other,) = ((tmp_path / folder).glob(name) for folder in ("whole", "run"))
        assert equal(content(one), content(other)), name
        assert policy_hash(load_policy(one).policy) == policy_hash(load_policy(other).policy)
        # Nor do times or random names enter a file.
        assert one.read_bytes() == other.read_bytes()
    for one in (tmp_path / "whole").glob("checkpoint-*/learner.pt"):
        states = [content(each) for each in (one, run / one.relative_to(tmp_path / "whole"))]
        if "counters" in states[0]:
            # Stable-Baselines3 also counts the steps of this process, and notes when episodes ended.
            for state in states:
                del state["counters"], state["episodes"]
        assert equal(*states)
    with pytest.raises(ValueError, match="another configuration \\(`seed` differ\\)"):
        train(short(algorithm, seed=1), run)
    other_seed = train(short(algorithm, seed=1), tmp_path / "other", tensorboard=False)
    assert other_seed["config"]["seed"] == 1


def test_a_killed_process_resumes(tmp_path: Path) -> None:
    config = short("dqn", validate_every=50)
    (tmp_path / "config.json").write_text(json.dumps(config.to_dict()))
    command = [sys.executable, "-m", "logicity", "train", str(tmp_path / "config.json"), "--run", str(tmp_path / "run")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as run:
        assert run.stderr is not None
        assert any(line.startswith("validation after 1") for line in run.stderr)
        run.kill()
    assert not (tmp_path / "run" / "result.json").exists()
    resumed = json.loads(json.dumps(train(config, tmp_path / "run", tensorboard=False)))
    whole = json.loads(json.dumps(train(config, tmp_path / "whole", tensorboard=False)))
    assert timeless(resumed) == timeless(whole)


def test_curves_are_sent_to_weights_and_biases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[str, Any]] = []
    stand_in = SimpleNamespace(
        log=lambda values, step: sent.append(("log", (step, set(values)))),
        summary=SimpleNamespace(update=lambda values: sent.append(("summary", set(values)))),
        finish=lambda: sent.append(("finish", None)),
    )

    def init(**arguments: Any) -> Any:
        sent.append(("init", (arguments["project"], arguments["name"], arguments["config"]["algorithm"])))
        return stand_in

    monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(init=init))
    result = train(short("a2c"), tmp_path / "run", tensorboard=False, wandb="cities")
    names = {"compliance", "tsr", "dsr", "score"}
    steps = [point["steps"] for point in result["validations"]]
    assert sent == [
        ("init", ("cities", "run", "a2c")),
        *(("log", (step, {f"validation/{name}" for name in names})) for step in steps),
        ("summary", {f"test/{name}" for name in names}),
        ("finish", None),
    ]
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ImportError, match="`wandb` needs the package wandb: pip install wandb"):
        train(short("a2c"), tmp_path / "other", wandb="cities")
    assert not (tmp_path / "other").exists()


def test_results_of_other_rules_are_not_mixed_in(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text("base: configs/easy.yaml\n")
    config = short("ppo", mode=str(tmp_path / "own.yaml"))
    run = tmp_path / "run"
    train(config, run, tensorboard=False)
    (tmp_path / "own.yaml").write_text("base: configs/easy.yaml\ntask: {reward: {overtime: -9}}\n")
    with pytest.raises(ValueError, match="has a run with another content of config; remove it"):
        train(config, run, tensorboard=False)


def test_training_starts_from_the_weights_of_a_policy(tmp_path: Path) -> None:
    first, run = short("a2c"), tmp_path / "first"
    train(first, run, tensorboard=False)
    text = "algorithm: {}\nmode: easy\nsettings: {{network: [{}]}}\nsteps: 5\nstart: first/best.pt\n"
    (tmp_path / "second.yaml").write_text(text.format("a2c", "16, 8"))
    config = TrainConfig.load(tmp_path / "second.yaml", seed=1)
    assert config.start == str((run / "best.pt").resolve())
    learner = config.learner(config)
    learner.start_from(load_policy(config.start).policy)
    assert equal(dict(content(run / "best.pt")["weights"]), dict(learner.policy().weights()))
    learner.close()
    result = train(config, tmp_path / "second", tensorboard=False)
    assert len(result["hashes"]["start"]) == 64
    for algorithm, network, message in [
        ("ppo", "16, 8", "is a policy of `a2c`, not of `ppo`"),
        ("a2c", "8, 8", r"`start`: .*best\.pt: its layers do not fit"),
    ]:
        (tmp_path / "second.yaml").write_text(text.format(algorithm, network))
        with pytest.raises(ValueError, match=message):
            train(TrainConfig.load(tmp_path / "second.yaml"), tmp_path / "third")
    (tmp_path / "second.yaml").write_text("algorithm: a2c\nmode: easy\nsettings: {network: [8]}\nstart: none.zip\n")
    with pytest.raises(InputError, match=r"cannot read `.*none\.zip`: no such file"):
        TrainConfig.load(tmp_path / "second.yaml")


def test_the_network_has_the_layers_of_the_configuration(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(short("dqn"), run, tensorboard=False)
    shapes = [tuple(values.shape) for values in content(run / "best.pt")["weights"].values()]
    assert shapes[:6] == [(16, 85), (16,), (8, 16), (8,), (4, 8), (4,)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "algorithm: dqn\nmode: easy\nobservation: pixels\nsettings: {network: [8]}",
            "`groundings`.* or `state`.*, not `pixels`",
        ),
        ("algorithm: dqn\nmode: none.yaml\nsettings: {network: [8]}", r"cannot read `.*none\.yaml`: no such file"),
        ("algorithm: [dqn]\nmode: easy\nsettings: {network: [8]}", "`algorithm` must be text"),
        ("algorithm: sarsa\nmode: easy\nsettings: {network: [8]}", "unknown learner `sarsa`; known: dqn, ppo, a2c"),
        ("algorithm: dqn\nmode: simple\nsettings: {network: [8]}", "unknown mode `simple`"),
        (
            "algorithm: dqn\nmode: easy\nsettings: {network: []}",
            "`settings.network` must be a list of 1 or more values",
        ),
        ("algorithm: dqn\nmode: easy\nsettings: {network: 8}", "`settings.network` must be a list, not `8`"),
        (
            "algorithm: dqn\nmode: easy\nsettings: {network: [8]}\nsteps: many",
            "`steps` must be an integer, not `many`",
        ),
        ("algorithm: dqn\nmode: easy\nsettings: {network: [8]}\nseed: -1", "`seed` must be at least 0, not `-1`"),
        ("algorithm: dqn\nmode: easy\nsettings: 3", "`settings` must be a mapping, not `3`"),
        ("algorithm: dqn\nmode: easy\nsettings: {network: [8]}\nepochs: 3", "unknown key `epochs`"),
        (GIVEN + "{gama: 0.9}", "`dqn` has no setting `gama`[^?]*did you mean `gamma`"),
        (GIVEN + "{gamma: x}", "`settings.gamma` must be a number, not `x`"),
        (GIVEN + "{gamma: .nan}", "`settings.gamma` must be a number, not `.nan`"),
        (GIVEN + "{batch_size: 1.5}", "`settings.batch_size` must be an integer, not `1.5`"),
        (GIVEN + "{learning_rate: true}", "`settings.learning_rate` must be a number, not `true`"),
        (GIVEN + "{seed: 3}", "`dqn` has no setting `seed`[^?]*`seed` is a key beside `settings`, not in it"),
        (GIVEN + "{network: [8]}\nnetwork: [8]", "unknown key `network`[^?]*a setting of `dqn`: write it under `sett"),
        (GIVEN + "{}", "the key `settings.network` is missing"),
        (GIVEN + "{network: [8]}\nepisodes: drown", "`episodes` must be `drawn`, `drawn-demanding` or `recorded`"),
        ("algorithm: mlp\nmode: easy\nepisodes: drawn", "`mlp` does not use the key `episodes`: it learns from demo"),
        (GIVEN + "{network: [8]}\ndemonstrations: 0.5", "`dqn` does not use the key `demonstrations`: it learns in"),
        ("algorithm: dqm\nmode: easy", "unknown learner `dqm`; did you mean `dqn`?"),
        ("algorithm: dqn", "the key `mode` is missing"),
        ("- dqn", "must be a mapping"),
        ("algorithm: [", "yaml-syntax"),
        ("base: config.yaml", "builds on itself"),
    ],
)
def test_invalid_configurations_raise(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ValueError, match=message):
        TrainConfig.load(tmp_path / "config.yaml")
    assert main(["train", str(tmp_path / "config.yaml"), "--run", str(tmp_path / "run")]) == 1
    assert "config.yaml" in capsys.readouterr().err and not (tmp_path / "run").exists()


def test_every_error_is_reported_with_its_location(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("algorithm: dqn\nmode: easy\nsettings: {network: [8, 0], gamma: x, tau: 0.5}\n")
    (tmp_path / "config.yaml").write_text(
        "base: base.yaml\nmode: hart\nsteps: 0\nepoch: 3\nsettings:\n  train_freq: [4, 5]\n"
    )
    with pytest.raises(InputError) as caught:
        TrainConfig.load(tmp_path / "config.yaml", seed=-1)
    found = {
        (fault["code"], Path(label["file"]).name, label["line"], label["column"])
        for fault in caught.value.diagnostics
        for label in fault["labels"]
    }
    assert found == {
        ("invalid-value", "config.yaml", 2, 7),
        ("invalid-value", "config.yaml", 3, 8),
        ("unknown-key", "config.yaml", 4, 1),
        ("invalid-value", "config.yaml", 6, 15),
        ("invalid-value", "base.yaml", 3, 25),
        ("invalid-value", "base.yaml", 3, 36),
        # A seed from the command line has no location in a file.
        ("invalid-value", "config.yaml", 1, 1),
    }
    assert "unknown mode `hart`, and no file has this name; did you mean `hard`?" in str(caught.value)
    assert "`settings.network.1` must be at least 1, not `0`" in str(caught.value)
    (tmp_path / "config.yaml").write_text("algorithm: dqn\nalgorithm: ppo\n")
    with pytest.raises(InputError, match="duplicate-key"):
        TrainConfig.load(tmp_path / "config.yaml")


def test_a_base_is_merged_mapping_by_mapping(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("algorithm: dqn\nmode: easy\nsettings: {network: [8], gamma: 0.9, tau: 0.5}")
    (tmp_path / "changed.yaml").write_text("base: base.yaml\nsettings: {network: [4, 2], gamma: 0.8}")
    config = TrainConfig.load(tmp_path / "changed.yaml", changes={"settings": {"tau": 0.25}, "steps": 7})
    given: Any = config.settings
    assert (given.gamma, given.tau, given.network, config.steps) == (0.8, 0.25, (4, 2), 7)


@pytest.mark.parametrize(
    ("algorithm", "setting", "message"),
    [
        ("ppo", {"batch_size": 1}, "PPO rejects the `settings`: `batch_size` must be greater than 1"),
        ("dqn", {"optimize_memory_usage": True}, "DQN rejects the `settings`: ReplayBuffer does not support"),
        ("dqn", {"buffer_size": 10**12}, "`settings.buffer_size`: 1000000000000 needs too much memory: Unable"),
        ("ppo-fast", {"rollout_steps": 10**12}, "`settings.rollout_steps`: 1000000000000 needs too much memory"),
    ],
)
def test_rejected_settings_leave_no_run(
    algorithm: str, setting: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, run = tmp_path / "config.json", tmp_path / "run"
    config = short(algorithm).to_dict()
    file.write_text(json.dumps({**config, "settings": {**config["settings"], **setting}}))
    assert main(["train", str(file), "--run", str(run)]) == 1
    errors = capsys.readouterr().err
    assert f"error[invalid-value]: {message}" in errors and f"--> {file}:" in errors and not run.exists()
    file.write_text(json.dumps(config))
    assert main(["train", str(file), "--run", str(run)]) == 0 and (run / "result.json").exists()


@pytest.mark.parametrize(
    ("algorithm", "settings", "messages"),
    [
        (
            "dqn",
            {"gamma": 5, "batch_size": 0, "buffer_size": 0, "exploration_fraction": -2, "tau": 2, "train_freq": 0},
            [
                "`settings.buffer_size` must be at least 1, not `0`",
                "`settings.batch_size` must be at least 1, not `0`",
                "`settings.tau` must be at most 1.0, not `2`",
                "`settings.gamma` must be at most 1.0, not `5`",
                "`settings.train_freq` must be an integer of at least 1, or such an integer with a unit: [4, step] or "
                "[1, episode], not `0`",
                "`settings.exploration_fraction` must be at least 0.0, not `-2`",
            ],
        ),
        ("nlm-dqn", {"target_update_interval": 0}, ["`settings.target_update_interval` must be at least 1, not `0`"]),
        ("ppo", {"clip_range": -4}, ["`settings.clip_range` must be greater than 0.0, not `-4`"]),
        ("ppo", {"clip_range_vf": 0}, ["`settings.clip_range_vf` must be greater than 0.0, not `0`"]),
        ("a2c", {"n_steps": 0}, ["`settings.n_steps` must be at least 1, not `0`"]),
        ("dqn", {"learning_rate": 1e30}, ["`settings.learning_rate` must be at most 1.0, not `1e+30`"]),
        ("mlp", {"learning_rate": 1e300}, ["`settings.learning_rate` must be at most 1.0, not `1e+300`"]),
        ("dqn", {"gradient_steps": -1, "learning_starts": 0, "train_freq": [1, "episode"]}, []),
        ("ppo", {"sde_sample_freq": -1, "target_kl": None, "gae_lambda": 1}, []),
    ],
)
def test_settings_of_stable_baselines_have_ranges(
    algorithm: str, settings: dict[str, Any], messages: list[str], tmp_path: Path
) -> None:
    file = tmp_path / "config.json"
    network = {} if algorithm == "mlp" else {"network": [8]}
    file.write_text(json.dumps({"algorithm": algorithm, "mode": "easy", "settings": {**network, **settings}}))
    if not messages:
        TrainConfig.load(file)
        return
    with pytest.raises(InputError) as caught:
        TrainConfig.load(file)
    assert [fault["message"] for fault in caught.value.diagnostics] == messages


def test_episodes_as_a_unit_need_one_environment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(
        "algorithm: dqn\nmode: easy\nsteps: 200\nenvs: 3\nsettings: {network: [8], train_freq: [1, episode]}\n"
    )
    assert main(["train", str(config), "--run", str(tmp_path / "run")]) == 1
    errors = capsys.readouterr().err
    assert "the unit `episode` needs one environment: set `envs: 1`" in errors and f"{config}:5:38" in errors


def test_episodes_that_are_never_found_are_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "config.yaml"
    task = "overrides: {task: {constrained_steps: 10000}}"
    config.write_text(f"algorithm: ppo-fast\nmode: easy\nsteps: 200\nepisodes: drawn-demanding\n{task}\n")
    assert main(["train", str(config), "--run", str(tmp_path / "run")]) == 1
    assert "error[limit-exceeded]: " in capsys.readouterr().err


def test_a_training_continues_after_its_reader_has_gone(tmp_path: Path) -> None:
    config = tmp_path / "config.json"
    config.write_text(json.dumps(short("mlp").to_dict()))
    command = [sys.executable, "-m", "logicity", "train", str(config), "--run", str(tmp_path / "run")]
    reader, writer = os.pipe()
    os.close(reader)
    ended = subprocess.run(command, stderr=writer, stdout=subprocess.DEVNULL, check=False)
    os.close(writer)
    assert ended.returncode == 0 and (tmp_path / "run" / "result.json").exists()


def test_too_many_environments_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"`envs`: 100000000 environments need more than 572\.2 GiB of memory"):
        train(short("ppo-fast", envs=10**8), tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("algorithm", "name"),
    [("dqn", name) for name in ("state.json", "learner.pt", "best.pt")]
    + [("ppo-fast", "learner.pt"), ("ppo-fast", "best.pt")],
)
def test_damaged_checkpoints_are_named(
    algorithm: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, run = tmp_path / "config.json", tmp_path / "run"
    config.write_text(json.dumps(short(algorithm).to_dict()))
    train(TrainConfig.load(config), run, tensorboard=False)
    (checkpoint,) = run.glob("checkpoint-*")
    path = checkpoint / name
    content = path.read_bytes()
    if (algorithm, name) == ("dqn", "learner.pt"):
        torch.save({"checkpoint": 2, "algorithm": "dqn"}, path)
        assert main(["train", str(config), "--run", str(run)]) == 1
        assert f"error: cannot resume from {checkpoint}: " in capsys.readouterr().err
    path.write_bytes(content[:150])
    capsys.readouterr()
    assert main(["train", str(config), "--run", str(run)]) == 1
    errors = capsys.readouterr().err
    assert errors.startswith(f"error: {path} is damaged: ") and errors.count("\n") == 1
    assert f"; remove the folder {checkpoint} to train from the beginning" in errors
    path.unlink()
    assert main(["train", str(config), "--run", str(run)]) == 1
    assert capsys.readouterr().err.startswith(f"error: {checkpoint} has no file `{name}`; remove the folder")
    (run / "config.json").write_text('{"algorithm"')
    assert main(["train", str(config), "--run", str(run)]) == 1
    # The state of the run is read before its configuration.
    fault = f"{checkpoint} has no file `{name}`" if name == "state.json" else f"{run / 'config.json'} is damaged"
    assert (errors := capsys.readouterr().err).startswith(f"error: {fault}")
    assert str(config) not in errors and (run / "result.json").exists()


def test_only_one_process_reads_a_run(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.json").write_text("incomplete")
    with reserved(run / "result.json", by=None), pytest.raises(OSError, match="this process already writes it"):
        train(short("ppo"), run)
    with pytest.raises(training.FolderError, match=r"config\.json is damaged"):
        train(short("ppo"), run)


def test_runs_that_fail_leave_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = short("popper", settings={"program": ["no-such-program"]})
    with pytest.raises(FileNotFoundError, match="Popper is not installed"):
        train(config, tmp_path / "a" / "b")
    assert not list(tmp_path.iterdir())
    cell = tmp_path / "cell"
    cell.mkdir()
    for name in ("cell.json", "start.pt", "log.txt"):
        (cell / name).touch()
    with pytest.raises(FileNotFoundError, match="Popper is not installed"):
        train(config, cell, tensorboard=False)
    assert sorted(path.name for path in cell.glob("[!.]*")) == ["cell.json", "log.txt", "start.pt"]


@pytest.mark.parametrize("entry", ["readme.md", "cells", "best.pt", "start.pt"])
def test_folders_of_other_files_are_refused(entry: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / entry).mkdir()
    assert main(["train", "ppo-easy", "--run", str(tmp_path)]) == 1
    message = f"error: {tmp_path} is not empty (`{entry}`) and has no run: choose another folder\n"
    assert capsys.readouterr().err == message
    assert [path.name for path in tmp_path.iterdir()] == [entry]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
def test_folders_that_cannot_be_created_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "ppo-easy", "--run", "/proc/x"]) == 2
    assert capsys.readouterr().err == "error: cannot create the folder `/proc/x`: no such file or directory\n"


def test_errors_of_a_run_have_a_location(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.zip").write_text("text")
    file = tmp_path / "config.yaml"
    network = "algorithm: ppo\nmode: easy\nsettings: {network: [8]}\n"
    for text, message, line, column in [
        (f"{network}start: bad.zip", "`start`: .* is not a Stable-Baselines3 model", 4, 8),
        ("algorithm: induce\nmode: easy\nsteps: 5", "`steps` must be 1 for `induce`, not `5`", 3, 8),
        (f"{network}overrides:\n  task:\n    reward: {{overtimee: 1}}", "unknown key `overtimee`", 6, 14),
        (f"{network}overrides:\n  view: 30\n  task: {{reward: {{}}, patience: x}}", "found the text `x`", 6, 32),
        (f"{network}overrides:\n  task: {{route_length: true}}", "the `overrides` change the shape", 4, 1),
    ]:
        file.write_text(text)
        assert main(["train", str(file), "--run", str(tmp_path / "run")]) == 1
        errors = capsys.readouterr().err
        assert re.match(rf"error\[[\w-]+\]: {message}|error\[[\w-]+\]: .*{message}", errors), errors
        assert f"--> {file}:{line}:{column}\n" in errors and not (tmp_path / "run").exists()


def test_a_policy_is_evaluated_only_where_it_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(short("ppo-fast"), tmp_path / "run", tensorboard=False)
    policy = str(tmp_path / "run" / "best.pt")
    assert main(["evaluate", "--policy", policy, "--modes", "easy,hard", "--split", "val"]) == 2
    errors = capsys.readouterr().err
    assert errors.startswith(f"error: the policy `{policy}` cannot act in `hard`: expected observations of shape")
    assert errors.endswith("the policy was trained in `easy`\nhelp: name `--modes easy`\n")
    assert main(["evaluate", "--policy", policy, "--observation", "state", "--split", "val"]) == 2
    message = "error: --observation: this policy takes observations of the kind `groundings`, not `state`\n"
    assert capsys.readouterr().err == f"{message}help: leave out `--observation state`\n"


@pytest.mark.parametrize(
    ("text", "number"),
    [("3e-5", 3e-5), ("3E5", 3e5), ("1e+2", 100.0), (".5e1", 5.0), ("2.e1", 20.0), ("3.0e-5", 3e-5), ("1", 1)],
)
def test_numbers_in_scientific_notation_are_floats(text: str, number: float, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(
        f"algorithm: dqn\nmode: easy\nsettings: {{network: [8], max_grad_norm: {text}}}"
    )
    given: Any = TrainConfig.load(tmp_path / "config.yaml").settings
    assert given.max_grad_norm == number


@pytest.mark.parametrize("suffix", [".zip", ".pt", ".txt"])
def test_other_files_are_not_policies(suffix: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"policy{suffix}"
    path.write_text("text")
    with pytest.raises(ValueError, match="is not a"):
        load_policy(path)
    assert main(["evaluate", "--policy", str(path), "--modes", "easy"]) == 1
    assert capsys.readouterr().err.startswith(f"error: {path} is not a")
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path / f"none{suffix}")
    with pytest.raises(FileNotFoundError, match="a folder without a file `best"):
        load_policy(tmp_path)


def test_policy_files_of_no_learner_are_refused(tmp_path: Path) -> None:
    for value, message in [
        ({"algorithm": "sarsa"}, "unknown learner `sarsa`"),
        ({"algorithm": ["dqn"]}, "names no learner"),
        ([1], "names no learner"),
    ]:
        torch.save(value, tmp_path / "policy.pt")
        with pytest.raises(ValueError, match=message):
            load_policy(tmp_path / "policy.pt")
    torch.save({"algorithm": Killed()}, tmp_path / "policy.pt")
    with pytest.raises(ValueError, match="is not a policy: PyTorch cannot read it"):
        load_policy(tmp_path / "policy.pt")
    assert set(ENVIRONMENTS) >= {"easy", "medium", "hard", "expert"}
