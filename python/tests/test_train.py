from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

from logicity import ENVIRONMENTS, InputError, evaluate
from logicity.__main__ import main

needs("stable_baselines3", "train")
from logicity import train as training  # noqa: E402
from logicity.sb3 import SPFVecEnv, make_vec_env  # noqa: E402
from logicity.train import ALGORITHMS, TrainConfig, load_model, train  # noqa: E402

#: A configuration without the values of its settings.
GIVEN = "algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: "
BASELINES = Path(__file__).parents[2] / "configs" / "baselines"
SETTINGS = {
    "dqn": {"learning_starts": 100, "buffer_size": 1000, "batch_size": 16},
    "ppo": {"n_steps": 64, "batch_size": 32},
    "a2c": {"n_steps": 16},
}


def short(algorithm: str) -> TrainConfig:
    return TrainConfig(
        algorithm=algorithm,
        mode="easy",
        network=(16, 8),
        settings=SETTINGS[algorithm],
        overrides={"task": {"reward": {"overtime": -6}}},
        steps=512,
        envs=2,
        validate_every=200,
    )


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
    for algorithm in ALGORITHMS:
        for mode in ("easy", "medium", "hard", "expert"):
            config = TrainConfig.load(BASELINES / f"{algorithm}-{mode}.yaml")
            assert (config.algorithm, config.mode, config.steps) == (algorithm, mode, 200_000)
    for file in BASELINES.glob("*.yaml"):
        config = TrainConfig.load(file)
        if config.algorithm == "ppo":
            # Otherwise Stable-Baselines3 warns about truncated batches.
            assert config.settings["n_steps"] * config.envs % config.settings["batch_size"] == 0
    expert = TrainConfig.load(BASELINES / "ppo-expert.yaml")
    assert (
        expert.settings["batch_size"] == 256 and expert.settings["n_steps"] == 256 and expert.network == (128, 64, 64)
    )
    assert expert.overrides == {"task": {"reward": {"overtime": -10}}}


@pytest.mark.parametrize("algorithm", list(ALGORITHMS))
def test_a_short_run_leaves_all_files(algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    assert capsys.readouterr().err == ""
    result = train(short(algorithm), run)
    assert json.loads((run / "result.json").read_text()) == json.loads(json.dumps(result))
    steps = [point["steps"] for point in result["validations"]]
    assert [step // 200 for step in steps] == [1, 2, 2] and steps[-1] == 512
    assert result["best"] == max(
        result["validations"], key=lambda point: (point["tsr"]["value"], point["score"]["value"])
    )
    assert list((run / "tensorboard").rglob("events*"))
    assert [path.name for path in run.glob("*checkpoint-*")] == ["checkpoint-0000000512"]
    model = load_model(run / "best.zip")
    assert type(model) is ALGORITHMS[algorithm]
    measured = evaluate(model, "easy")
    assert measured.tsr.value == result["test"]["tsr"]["value"]
    assert measured.episodes_hash == result["test"]["episodes_hash"]
    assert main(["evaluate", "--policy", str(run / "best.zip"), "--modes", "easy", "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("best")


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
    config.write_text("algorithm: dqn\nmode: easy\nnetwork: 8\nsettings: {}\n")
    assert main(["train", str(config)]) == 1
    assert capsys.readouterr().err.startswith("error[invalid-value]: ")
    assert main(["train", "dqn-easy", "--run", str(config)]) == 2
    assert capsys.readouterr().err.startswith(f"error: --run: `{config}` is a file, not a folder\nhelp: name a folder")


def test_messages_do_not_quote_pydantic(tmp_path: Path) -> None:
    keys = {"algorithm", "mode", "observation", "network", "settings", "overrides", "steps", "envs", "seed"}
    assert keys < set(TrainConfig.model_fields)
    good = "algorithm: {}\nmode: easy\nnetwork: [8]\nsettings: {{}}\n"
    texts = [(key, good.format("dqn").replace(f"{key}:", "seed: 0 #") + f"{key}: ") for key in keys]
    for algorithm in ALGORITHMS:
        for setting in training._settings_model(algorithm).model_fields:
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
    (tmp_path / "config.json").write_text(json.dumps(short("dqn").model_dump()))
    command = [sys.executable, "-m", "logicity", "train", str(tmp_path / "config.json"), "--run", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = done.stderr.splitlines()
    assert lines[0] == f"dqn in easy, started: 512 steps; folder {tmp_path / 'run'}"
    validations = [line for line in lines if line.startswith("validation after ")]
    assert [line.split()[2] for line in validations] == ["200", "400", "512"]
    assert all(re.search(r"steps: compliance \d\.\d\d \[.*TSR .*DSR .*Score ", line) for line in validations)
    assert done.stdout.splitlines()[0].startswith("512 steps in ")
    assert done.stdout.splitlines()[1].startswith("compliance on test episodes: ")


def test_the_first_line_is_logged_before_a_kill(tmp_path: Path) -> None:
    config = short("dqn").model_copy(update={"steps": 10**6, "validate_every": 10**6})
    (tmp_path / "config.json").write_text(json.dumps(config.model_dump()))
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
    monkeypatch.setattr(training.ProgressLines, "SECONDS", 0.0)
    train(short("ppo"), tmp_path, progress=True, tensorboard=False)
    lines = [line for line in capsys.readouterr().err.splitlines() if " steps/s, " in line]
    assert len(lines) == 256
    assert re.fullmatch(r"2 of 512 steps \(0%\), [\d,]+ steps/s, \d+\.\d min left", lines[0])
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
    (tmp_path / "base.yaml").write_text("mode: configs/far.yaml\nobservation: state\nnetwork: [16, 8]\n")
    (folder / "train.yaml").write_text(
        "base: ../base.yaml\nalgorithm: ppo\nsteps: 256\nenvs: 2\nvalidate_every: 200\n"
        "settings: {n_steps: 64, batch_size: 32}\n"
    )
    config = TrainConfig.load(folder / "train.yaml")
    assert config.mode == str(folder / "far.yaml") and config.observation == "state"
    (tmp_path / "built-in.yaml").write_text("base: configs/train.yaml\nmode: configs/hard.yaml\n")
    assert TrainConfig.load(tmp_path / "built-in.yaml").mode == "configs/hard.yaml"
    run = tmp_path / "run"
    result = train(config, run, tensorboard=False)
    model = load_model(run / "best.zip")
    assert model.observation_space.shape == (20, 15)
    measured = evaluate(model, folder / "far.yaml", observation="state")
    assert measured.score.value == result["test"]["score"]["value"]
    # The command knows the kind of observation from the model.
    assert main(["evaluate", "--policy", str(run / "best.zip"), "--modes", config.mode, "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[1] == config.mode
    for name in ("train", "val", "test"):
        wrong = folder / f"no-{name}.yaml"
        wrong.write_text(f"base: configs/easy.yaml\ntask: {{episodes: {{{name}: ~}}}}\n")
        if name != "train":
            # Missing episodes are reported before training starts.
            with pytest.raises(InputError, match="logicity episodes make"):
                train(config.model_copy(update={"mode": str(wrong)}), tmp_path / name)
            assert not (tmp_path / name).exists()


def test_overrides_must_not_change_observations(tmp_path: Path) -> None:
    config = short("dqn").model_copy(update={"overrides": {"task": {"route_length": True}}})
    with pytest.raises(ValueError, match=r"shape of observations from \(85,\) to \(86,\).*name it under `mode`"):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


class Killed(Exception):
    pass


@pytest.mark.parametrize("algorithm", ["dqn", "ppo"])
def test_a_killed_run_resumes(algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint = training.Validation._checkpoint

    def kill(self: Any) -> None:
        checkpoint(self)
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(training.Validation, "_checkpoint", kill)
        with pytest.raises(Killed):
            train(short(algorithm), tmp_path)
    (left,) = tmp_path.glob("checkpoint-*")
    state = json.loads((left / "state.json").read_text())
    assert 200 <= state["steps"] < 400 and not (tmp_path / "result.json").exists()
    # A kill during the next checkpoint leaves an incomplete temporary folder, which is ignored.
    (tmp_path / ".checkpoint-0000000400").mkdir()
    seeds: list[set[int]] = []
    reset = SPFVecEnv.reset

    def note(self: Any) -> Any:
        observations = reset(self)
        seeds.append({info["seed"] for info in self.reset_infos})
        return observations

    monkeypatch.setattr(SPFVecEnv, "reset", note)
    loaded: list[int] = []
    if algorithm == "dqn":
        dqn: Any = ALGORITHMS["dqn"]
        load = dqn.load_replay_buffer

        def watch(self: Any, *arguments: Any, **more: Any) -> None:
            load(self, *arguments, **more)
            loaded.append(self.replay_buffer.size() * self.n_envs)

        monkeypatch.setattr(dqn, "load_replay_buffer", watch)
    result = train(short(algorithm), tmp_path)
    assert result["validations"][0] == state["validations"][0] and 512 <= result["steps"] < 640
    # At validation, the replay buffer does not have the last step yet.
    assert loaded == ([state["steps"] - 2] if algorithm == "dqn" else [])
    with pytest.raises(ValueError, match="another configuration"):
        train(short(algorithm).model_copy(update={"seed": 1}), tmp_path)
    # The resumed run starts with other episodes than an uninterrupted one.
    train(short(algorithm), tmp_path / "whole")
    resumed, whole = seeds
    assert len(resumed | whole) == 4
    make_vec_env("easy", 2, state["steps"]).reset()
    assert seeds[2] == resumed


def test_the_same_seed_gives_the_same_model(tmp_path: Path) -> None:
    def weights(seed: int, name: str) -> Any:
        train(short("dqn").model_copy(update={"seed": seed}), tmp_path / name, tensorboard=False)
        (checkpoint,) = (tmp_path / name).glob("checkpoint-*")
        parameters = load_model(checkpoint / "model.zip").policy.state_dict()
        return np.concatenate([values.numpy().ravel() for values in parameters.values()])

    one, same, other = weights(3, "one"), weights(3, "same"), weights(4, "other")
    assert (one == same).all() and (one != other).any()


def test_the_network_has_the_layers_of_the_configuration(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(short("dqn"), run, tensorboard=False)
    shapes = [tuple(values.shape) for values in load_model(run / "best.zip").policy.state_dict().values()]
    assert shapes[:6] == [(16, 85), (16,), (8, 16), (8,), (4, 8), (4,)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "algorithm: dqn\nmode: easy\nnetwork: [8]\nobservation: pixels\nsettings: {}",
            "`groundings` or `state`, not `pixels`",
        ),
        ("algorithm: dqn\nmode: none.yaml\nnetwork: [8]\nsettings: {}", r"cannot read `.*none\.yaml`: no such file"),
        ("algorithm: [dqn]\nmode: easy\nnetwork: [8]\nsettings: {}", "`algorithm` must be text"),
        ("algorithm: sarsa\nmode: easy\nnetwork: [8]\nsettings: {}", "unknown algorithm `sarsa`"),
        ("algorithm: dqn\nmode: simple\nnetwork: [8]\nsettings: {}", "unknown mode `simple`"),
        ("algorithm: dqn\nmode: easy\nnetwork: []\nsettings: {}", "`network` must be a list of 1 or more values"),
        ("algorithm: dqn\nmode: easy\nnetwork: 8\nsettings: {}", "`network` must be a list, not `8`"),
        (
            "algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: {}\nsteps: many",
            "`steps` must be an integer, not `many`",
        ),
        ("algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: {}\nseed: -1", "`seed` must be at least 0, not `-1`"),
        ("algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: 3", "`settings` must be a mapping, not `3`"),
        ("algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: {}\nepochs: 3", "unknown key `epochs`"),
        (GIVEN + "{gama: 0.9}", "DQN has no setting `gama`[^?]*did you mean `gamma`"),
        (GIVEN + "{gamma: x}", "`settings.gamma` must be a number, not `x`"),
        (GIVEN + "{gamma: .nan}", "`settings.gamma` must be a number, not `.nan`"),
        (GIVEN + "{batch_size: 1.5}", "`settings.batch_size` must be an integer, not `1.5`"),
        (GIVEN + "{learning_rate: true}", "`settings.learning_rate` must be a number, not `true`"),
        (GIVEN + "{seed: 3}", "DQN has no setting `seed`"),
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
    (tmp_path / "base.yaml").write_text("algorithm: dqn\nmode: easy\nnetwork: [8, 0]\nsettings: {gamma: x, tau: 0.5}\n")
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
        ("invalid-value", "base.yaml", 3, 14),
        ("invalid-value", "base.yaml", 4, 19),
        # A seed from the command line has no location in a file.
        ("invalid-value", "config.yaml", 1, 1),
    }
    assert "unknown mode `hart`, and no file has this name; did you mean `hard`?" in str(caught.value)
    assert "`network.1` must be at least 1, not `0`" in str(caught.value)
    (tmp_path / "config.yaml").write_text("algorithm: dqn\nalgorithm: ppo\n")
    with pytest.raises(InputError, match="duplicate-key"):
        TrainConfig.load(tmp_path / "config.yaml")


def test_a_base_is_merged_mapping_by_mapping(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: {gamma: 0.9, tau: 0.5}")
    (tmp_path / "changed.yaml").write_text("base: base.yaml\nnetwork: [4, 2]\nsettings: {gamma: 0.8}")
    config = TrainConfig.load(tmp_path / "changed.yaml")
    assert config.settings == {"gamma": 0.8, "tau": 0.5} and config.network == (4, 2)


@pytest.mark.parametrize(
    ("algorithm", "setting", "message"),
    [
        ("ppo", {"batch_size": 1}, "PPO rejects the `settings`: `batch_size` must be greater than 1"),
        ("dqn", {"learning_rate": -1.0}, "DQN rejects the `settings`: Invalid learning rate: -1.0"),
    ],
)
def test_rejected_settings_leave_no_run(
    algorithm: str, setting: dict[str, Any], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, run = tmp_path / "config.json", tmp_path / "run"
    config = short(algorithm).model_dump()
    file.write_text(json.dumps({**config, "settings": {**config["settings"], **setting}}))
    assert main(["train", str(file), "--run", str(run)]) == 1
    assert capsys.readouterr().err.startswith(f"error: {file}: {message}") and not run.exists()
    file.write_text(json.dumps(config))
    assert main(["train", str(file), "--run", str(run)]) == 0 and (run / "result.json").exists()


@pytest.mark.parametrize(
    ("text", "number"),
    [("3e-5", 3e-5), ("3E5", 3e5), ("-1e+2", -100.0), (".5e1", 5.0), ("2.e1", 20.0), ("3.0e-5", 3e-5), ("1", 1)],
)
def test_numbers_in_scientific_notation_are_floats(text: str, number: float, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(
        f"algorithm: dqn\nmode: easy\nnetwork: [8]\nsettings: {{learning_rate: {text}}}"
    )
    assert TrainConfig.load(tmp_path / "config.yaml").settings["learning_rate"] == number


def test_other_files_are_not_models(tmp_path: Path) -> None:
    (tmp_path / "text.zip").write_text("no archive")
    with pytest.raises(ValueError, match="is not a"):
        load_model(tmp_path / "text.zip")
    with pytest.raises(OSError):
        load_model(tmp_path / "none.zip")
    assert set(ENVIRONMENTS) >= {"easy", "medium", "hard", "expert"}
