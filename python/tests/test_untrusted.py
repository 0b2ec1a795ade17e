"""Files of others: nothing in them runs as code, unless the caller trusts a model of Stable-Baselines3."""

from __future__ import annotations

import ast
import json
import os
import pickle
import shutil
import signal
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import needs

import logicity
from logicity import UntrustedError
from logicity.__main__ import main
from logicity.files import read_tensors

needs("stable_baselines3", "learn")
import torch  # noqa: E402
from stable_baselines3 import A2C  # noqa: E402

from logicity.envs.sb3 import make_vec_env  # noqa: E402
from logicity.experiments import jobs  # noqa: E402
from logicity.experiments.cells import prepare, reuse, run_cell  # noqa: E402
from logicity.experiments.experiment import Selection  # noqa: E402
from logicity.experiments.registry import load_experiment  # noqa: E402
from logicity.experiments.results import read_results  # noqa: E402
from logicity.learn import TrainConfig, load_policy, train  # noqa: E402
from logicity.learn.run import FolderError  # noqa: E402
from logicity.learn.storage import policy_hash, weights_hash  # noqa: E402

TINY: dict[str, Any] = {
    **{"algorithm": "a2c", "mode": "easy", "settings": {"network": [8], "n_steps": 16}},
    **{"steps": 64, "envs": 2, "validate_every": 32},
}


class Canary:
    """An object whose unpickling creates a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.path,)


@pytest.fixture
def canary(tmp_path: Path) -> Canary:
    return Canary(tmp_path / "executed")


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    train(TrainConfig(**TINY), folder, tensorboard=False)
    return folder


def copied(run: Path, target: Path) -> Path:
    """Copy a run, and return its checkpoint."""
    target.mkdir()
    (checkpoint,) = run.glob("checkpoint-*")
    (target / checkpoint.name).mkdir()
    for path in [run / "config.json", *checkpoint.iterdir()]:
        (target / path.relative_to(run)).write_bytes(path.read_bytes())
    return target / checkpoint.name


def model_of_others(path: Path, canary: Canary | None = None) -> Path:
    """Write a model of Stable-Baselines3, with a canary among its pickles."""
    model = A2C("MlpPolicy", make_vec_env("easy", 2), n_steps=4, policy_kwargs={"net_arch": [8]}, device="cpu")
    if canary is not None:
        model.canary = canary
    model.save(path)
    return path


def pickled(canary: Canary) -> bytes:
    return pickle.dumps({"algorithm": "a2c", "checkpoint": 2, "format": 1, "state": canary})


@pytest.mark.parametrize("name", ["best.pt", "learner.pt", "state.pkl", "replay.pkl", "model.zip"])
@pytest.mark.parametrize("kind", ["torch", "pickle", "damaged"])
def test_no_file_of_a_run_is_unpickled(name: str, kind: str, run: Path, tmp_path: Path, canary: Canary) -> None:
    checkpoint = copied(run, tmp_path / "run")
    path = checkpoint / name
    if kind == "torch":
        torch.save({"algorithm": "a2c", "checkpoint": 2, "format": 1, "state": canary}, path)
    else:
        path.write_bytes(pickled(canary)[: None if kind == "pickle" else -3])
    with pytest.raises(FolderError) as caught:
        train(TrainConfig(**TINY), tmp_path / "run", tensorboard=False)
    assert not canary.path.exists()
    message = str(caught.value)
    assert str(path) in message and f"remove the folder {checkpoint} to train from the beginning" in message
    if path.suffix != ".pt":
        assert f"{path} is a pickle of an earlier version, which could run any code" in message
    elif kind == "torch":
        assert "or have Python objects, which could run any code when they are loaded" in message


@pytest.mark.parametrize("suffix", [".pt", ".zip"])
def test_policies_of_others_are_not_unpickled(
    suffix: str, tmp_path: Path, canary: Canary, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"model{suffix}"
    if suffix == ".zip":
        model_of_others(path, canary)
    else:
        torch.save({"algorithm": "mlp", "weights": canary}, path)
    (tmp_path / "config.yaml").write_text(
        f"algorithm: a2c\nmode: easy\nsettings: {{network: [8]}}\nsteps: 8\nstart: model{suffix}\n"
    )
    (tmp_path / "tiny.yaml").write_text("title: Tiny\nconfig: config.yaml\nlearners: {a2c: {}}\nmodes: [easy]\n")
    code = 2 if suffix == ".zip" else 1
    for command in (
        ["evaluate", "--policy", str(path), "--modes", "easy", "--split", "val"],
        ["train", str(tmp_path / "config.yaml"), "--run", str(tmp_path / "run")],
    ):
        assert main(command) == code
        said = capsys.readouterr().err
        assert "can run any code in it; if you trust its origin, pass `--trust`" in said or suffix == ".pt", said
    assert main(["experiment", str(tmp_path / "tiny.yaml"), "--run", str(tmp_path / "runs"), "--jobs", "1"]) == 1
    assert "`start`: " in (said := capsys.readouterr().err) and ("`--trust`" in said or suffix == ".pt")
    with pytest.raises(UntrustedError if suffix == ".zip" else ValueError):
        load_policy(path)
    assert not canary.path.exists()


#: Faults in the state of a learner that PyTorch does not find when it loads it.
FAULTS: dict[str, Callable[[dict[str, Any]], None]] = {
    "setting": lambda state: state["optimizer"]["param_groups"][0].update(alpha="x"),
    "no tensor": lambda state: state["optimizer"]["state"][0].update(square_avg=None),
    "shape": lambda state: state["optimizer"]["state"][0].update(square_avg=torch.zeros(3)),
    "negative": lambda state: state["optimizer"]["state"][0].update(step=-1),
    "counter": lambda state: state["counters"].update(_n_updates=[]),
    "episode": lambda state: state.update(episodes=[torch.zeros(3)]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_in_a_checkpoint_are_found_when_it_is_loaded(fault: str, run: Path, tmp_path: Path) -> None:
    checkpoint = copied(run, tmp_path / "run")
    state = read_tensors(checkpoint / "learner.pt", "a checkpoint")
    FAULTS[fault](state)
    torch.save(state, checkpoint / "learner.pt")
    with pytest.raises(FolderError, match=f"cannot resume from {checkpoint}: .*; remove the folder"):
        train(TrainConfig(**{**TINY, "steps": 128}), tmp_path / "run", tensorboard=False)


@contextmanager
def soon() -> Iterator[None]:
    """Raise in a block that takes longer than 20 seconds, such as one that waits for the writer of a pipe."""

    def end(*_: object) -> None:
        raise AssertionError("it waits")

    previous = signal.signal(signal.SIGALRM, end)
    signal.alarm(20)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, previous)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
def test_no_pipe_in_a_folder_of_others_is_waited_for(run: Path, tmp_path: Path) -> None:
    def with_pipe(name: str) -> Path:
        """Return a copy of the run with a pipe in place of a file."""
        folder = tmp_path / name.replace("/", "-")
        shutil.copytree(run, folder)
        (path,) = folder.glob(name)
        path.unlink()
        os.mkfifo(path)
        return folder

    with soon():
        # The configuration only adds the mode.
        assert load_policy(with_pipe("config.json")).mode == "easy"
        for name in ("config.json", "checkpoint-*/state.json", "checkpoint-*/learner.pt", "checkpoint-*/best.pt"):
            folder = tmp_path / name.replace("/", "-")
            with pytest.raises((OSError, FolderError), match="it is a pipe"):
                train(TrainConfig(**TINY), folder if folder.exists() else with_pipe(name), tensorboard=False)
        os.mkfifo(tmp_path / "results.json")
        with pytest.raises(OSError, match="it is a pipe"):
            read_results(tmp_path / "results.json")


@pytest.mark.skipif(sys.platform == "win32", reason="links of POSIX")
def test_no_device_in_an_experiment_of_others_is_copied(run: Path, tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text("title: Tiny\nconfig: config.json\nlearners: {a2c: {}}\nmodes: [easy]\n")
    (tmp_path / "config.json").write_text(json.dumps(TINY))
    cells = load_experiment(tmp_path / "tiny.yaml").cells(Selection())
    folder = prepare(cells[0], tmp_path / "other")
    identity = json.loads((folder / "cell.json").read_text())["identity"]
    (folder / "measured.json").write_text(json.dumps({"identity": identity}))
    shutil.copyfile(run / "best.pt", folder / "best.pt")
    (folder / "notes").symlink_to("/dev/zero")
    with soon(), pytest.raises(OSError, match="it is a device"):
        reuse(cells, tmp_path / "run", tmp_path / "other")


def test_trusted_models_of_stable_baselines_are_loaded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = model_of_others(tmp_path / "model.zip")
    saved = load_policy(path, trust=True)
    assert saved.algorithm == "a2c"
    assert main(["evaluate", "--trust", "--policy", str(path), "--modes", "easy", "--split", "val"]) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("model ")
    with pytest.raises(ValueError, match=r"use `model\.save`"):
        saved.policy.save(tmp_path / "policy.pt")
    # Its layers are not those of our learner.
    config = TrainConfig(**{**TINY, "start": str(path)})
    with pytest.raises(UntrustedError, match="`start`: .*trust=True"):
        train(config, tmp_path / "run", tensorboard=False)
    with pytest.raises(ValueError, match="its layers do not fit"):
        train(config, tmp_path / "run", tensorboard=False, trust=True)


def test_workers_get_the_trust_of_the_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trusted: list[bool] = []

    def spy(*arguments: Any, trust: bool, **options: Any) -> dict[str, Any]:
        trusted.append(trust)
        raise ValueError("stop")

    monkeypatch.setattr("logicity.experiments.spf.train", spy)
    (tmp_path / "tiny.yaml").write_text("title: Tiny\nconfig: config.json\nlearners: {a2c: {}}\nmodes: [easy]\n")
    (tmp_path / "config.json").write_text(json.dumps(TINY))

    folder = prepare(load_experiment(tmp_path / "tiny.yaml").cells(Selection())[0], tmp_path / "run")
    for trust in (False, True):
        with pytest.raises(ValueError, match="stop"):
            run_cell(folder, trust=trust)
        monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
        with pytest.raises(ValueError, match="stop"):
            jobs._in_worker("cell", {"cell.json": (folder / "cell.json").read_bytes()}, None, trust, {})
    assert trusted == [False, False, True, True]
    command: list[list[str]] = []
    monkeypatch.setattr("logicity.experiments.jobs.subprocess.Popen", lambda words, **options: command.append(words))
    for trust in (False, True):
        jobs._start(folder, None, None, trust, {})  # type: ignore[arg-type]
    assert ["--trust" in words for words in command] == [False, True]


def test_a_policy_is_the_same_after_loading(run: Path, tmp_path: Path) -> None:
    policy: Any = load_policy(run).policy
    # PyTorch writes the name of the file, too.
    again = tmp_path / "best.pt"
    policy.save(again)
    assert again.read_bytes() == (run / "best.pt").read_bytes()
    observations = (np.random.default_rng(0).random((50, 85)) < 0.2).astype(np.float32)
    # Stable-Baselines3 itself reads what `model.save` writes.
    policy.model.save(tmp_path / "model.zip")
    theirs = A2C.load(tmp_path / "model.zip", device="cpu")
    np.testing.assert_array_equal(policy.predict(observations)[0], theirs.predict(observations, deterministic=True)[0])
    kind, first = policy_hash(policy)
    assert (kind, first) == ("weights", policy_hash(load_policy(tmp_path / "model.zip", trust=True).policy)[1])


def test_a_hash_is_that_of_the_weights_alone(tmp_path: Path) -> None:
    weights = {"a": torch.arange(6.0).view(2, 3), "b": {"c": torch.zeros(2, dtype=torch.int64)}, "rules": "p(X)."}
    known = weights_hash(weights)
    assert known == weights_hash(dict(reversed(weights.items())))
    for name, value in [("a", weights["a"].view(3, 2)), ("a", weights["a"].double()), ("rules", "q(X).")]:
        assert weights_hash({**weights, name: value}) != known


@pytest.mark.parametrize("content", [b"", b"text", pickle.dumps([1, 2])])
def test_files_without_tensors_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "model.pt"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"model\.pt is not a model: PyTorch cannot read it as plain data"):
        read_tensors(path, "a model")


def test_compressed_tensors_are_refused(tmp_path: Path) -> None:
    """A compressed file could need any amount of memory."""
    torch.save({"zeros": torch.zeros(10**6)}, tmp_path / "plain.pt")
    with zipfile.ZipFile(tmp_path / "plain.pt") as plain, zipfile.ZipFile(tmp_path / "small.pt", "w") as small:
        for entry in plain.infolist():
            small.writestr(entry.filename, plain.read(entry), zipfile.ZIP_DEFLATED)
    assert (tmp_path / "small.pt").stat().st_size < 10**5
    assert read_tensors(tmp_path / "plain.pt", "a model")["zeros"].sum() == 0
    with pytest.raises(ValueError, match="PyTorch cannot read it as plain data"):
        read_tensors(tmp_path / "small.pt", "a model")


@pytest.mark.parametrize("name", ["../outside.txt", "/outside.txt", "a/../../outside.txt"])
def test_workers_cannot_write_elsewhere(name: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "archive.zip", "w") as archive:
        archive.writestr("inside.txt", "text")
        archive.writestr(name, "text")
    folder = tmp_path / "cell"
    folder.mkdir()
    with pytest.raises(ValueError, match="outside of the folder of its cell"):
        jobs._unpack((tmp_path / "archive.zip").read_bytes(), folder)
    assert not list(folder.iterdir()) and not (tmp_path / "outside.txt").exists()


def test_models_of_pictures_are_data(tmp_path: Path, canary: Canary) -> None:
    from logicity.vap.features import _mapped, _state
    from logicity.vap.stages import VapWork

    path = tmp_path / "start.pt"
    torch.save({"concepts": canary}, path)
    work: Any = VapWork("easy", 0, None, tmp_path, tmp_path, None)  # type: ignore[arg-type]
    for read in (work.started, lambda: _state(path)):
        with pytest.raises(ValueError, match="could run any code when they are loaded"):
            read()
    np.save(tmp_path / "features.npy", np.array([canary], object), allow_pickle=True)
    with pytest.raises(ValueError, match="is not a file of features"):
        _mapped(tmp_path / "features.npy")
    assert not canary.path.exists()


#: Functions that run code from their argument, and the only place that may call each.
FORBIDDEN = {
    "eval": (),
    "exec": (),
    "compile": (),
    # The module that a pickle of a predicate names, as pickle itself imports.
    "__import__": ("predicates.py",),
    "pickle.load": (),
    "pickle.loads": (),
    "numpy.load": (),
    "np.load": (),
    "yaml.load": (),
    "joblib.load": (),
    "torch.load": ("files.py",),
    "importlib.import_module": (*("experiments/registry.py", "lazily.py", "learn/registry.py"),),
}


def test_the_package_calls_no_function_that_runs_code() -> None:
    """`import_module` gets names of modules of this package only."""
    root = Path(logicity.__file__).parent
    found = []
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            if called in FORBIDDEN and name not in FORBIDDEN[called]:
                found.append(f"{name}:{node.lineno}: {called}")
            for keyword in node.keywords:
                value = ast.unparse(keyword.value)
                if (keyword.arg, value) in {("weights_only", "False"), ("allow_pickle", "True"), ("shell", "True")}:
                    found.append(f"{name}:{node.lineno}: {keyword.arg}={value}")
            if called == "torch.load" and "weights_only=True" not in ast.unparse(node):
                found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
    assert not found, found
