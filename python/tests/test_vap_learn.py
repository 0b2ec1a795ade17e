"""Models and experiments of Visual Action Prediction: perception, rules on probabilities, reasoners, and the runner."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from conftest import ROOT, needs, run_with_a_lost_worker, timeless, wait_for

from logicity import ACTIONS, Inference, InputError
from logicity.rules import Program
from logicity.types import Split
from logicity.vap import UNARY, Drawing, VapDataset, make_dataset

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
from logicity.files import read_tensors  # noqa: E402
from logicity.vap import crops  # noqa: E402
from logicity.vap.concepts import RELATIONS, ConceptModel, ConceptSettings, CropNetwork  # noqa: E402
from logicity.vap.crops import crop_boxes  # noqa: E402
from logicity.vap.features import DataSpec, compute_features, load_features, prepared  # noqa: E402
from logicity.vap.reasoners import make_reasoner  # noqa: E402
from logicity.vap.soft_rules import SoftRules  # noqa: E402
from logicity.vap.stages import VapSettings, facts_of, scenes_of  # noqa: E402
from logicity.vap.training import (  # noqa: E402
    Samples,
    TrainingSettings,
    concept_loss,
    concept_measures,
    fit,
    groundings,
)

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


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> VapDataset:
    """A world with clean pictures."""
    folder = tmp_path_factory.mktemp("vap") / "set"
    return make_dataset(folder, "hard", "test", worlds=1, drawing=Drawing(difficulty=0), threads=1)


@pytest.fixture(scope="module")
def samples(pictures: VapDataset) -> Samples:
    return Samples.load(pictures)


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


# --- pictures and features


def test_boxes_and_pictures_have_one_orientation(pictures: VapDataset) -> None:
    # What changes between two pictures of a world are agents, so it is in their boxes.
    for first, second in pairwise([pictures[10], pictures[30], pictures[60]]):
        assert first.image is not None and second.image is not None
        changed = np.abs(first.image.astype(int) - second.image.astype(int)).max(2) > 8
        shares = []
        for order in ([0, 1, 2, 3], [1, 0, 3, 2]):
            inside = np.zeros_like(changed)
            for left, top, width, height in np.concatenate([first.boxes, second.boxes])[:, order]:
                inside[int(top) : int(np.ceil(top + height)), int(left) : int(np.ceil(left + width))] = True
            shares.append(changed[inside].sum() / changed.sum())
        assert shares[0] > 0.9 and shares[1] < 0.5


def test_crops_are_what_the_boxes_contain() -> None:
    image = np.zeros((1024, 1024, 3), np.uint8)
    # Left half red, right half green, blue below.
    image[300:348, 100:124, 0] = 200
    image[300:348, 124:148, 1] = 150
    image[348:372, 100:148, 2] = 100
    boxes = np.array([[100, 300, 48, 72], [100, 300, 24, 48], [1000, 1000, 48, 48], [np.nan] * 4], np.float32)
    crops = crop_boxes(image, boxes)
    assert crops.shape == (4, 48, 48, 3)
    assert (crops[0, 5, 5].tolist(), crops[0, 5, 40].tolist(), crops[0, 44, 20].tolist()) == (
        [200, 0, 0],
        [0, 150, 0],
        [0, 0, 100],
    )
    assert (crops[1] == [200, 0, 0]).all() and not crops[2:].any()


def test_stored_crops_are_resumed_and_checked(pictures: VapDataset, tmp_path: Path) -> None:
    out = compute_features(pictures.folder, tmp_path / "crops")
    values = load_features(out, pictures)
    entities = sum(len(sample.names) for sample in map(pictures.facts, range(len(pictures))))
    assert values.shape == (entities, 48, 48, 3) and values.dtype == torch.uint8
    sample = pictures[0]
    assert sample.image is not None
    assert (values[: len(sample.names)].numpy() == crop_boxes(sample.image, sample.boxes)).all()
    begun = (out / "world-00000.npy").stat().st_mtime_ns
    assert compute_features(pictures.folder, out) == out
    assert (out / "world-00000.npy").stat().st_mtime_ns == begun, "finished worlds are not computed again"
    document = json.loads((out / "features.json").read_text())
    (out / "features.json").write_text(json.dumps({**document, "extractor_hash": "0" * 64}))
    with pytest.raises(ValueError, match="features with another `extractor_hash`"):
        compute_features(pictures.folder, out)
    (out / "features.json").write_text(json.dumps(document))
    (out / "world-00000.npy").unlink()
    with pytest.raises(ValueError, match="no features of world 0 yet, or .* later: run `logicity vap features` again"):
        load_features(out, pictures)
    (out / "features.json").write_text('{"format": 2}')
    with pytest.raises(ValueError, match=r"features\.json: expected the key `kind`"):
        load_features(out, pictures)
    (out / "features.json").write_text('{"format": 1}')
    with pytest.raises(ValueError, match=r"features\.json: expected features of the format 2: run `logicity vap feat"):
        load_features(out, pictures)
    with pytest.raises(TypeError, match="folder: expected str"):
        load_features(0, pictures)  # type: ignore[arg-type]


def test_damaged_and_exchanged_features_are_found(tmp_path: Path) -> None:
    made = make_dataset(tmp_path / "set", "easy", "test", worlds=2, drawing=Drawing(difficulty=0), threads=1)
    out = compute_features(made.folder)
    assert str(out) == f"{made.folder}-crops"
    # A folder may be a text.
    whole = load_features(str(out), made)
    first, second = out / "world-00000.npy", out / "world-00001.npy"
    content, record = second.read_bytes(), second.with_suffix(".json").read_bytes()
    # Files of another world have the same number of entities.
    for damaged in (content[:100_000], content[:10], b"", first.read_bytes()):
        second.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"world-00001\.npy` is damaged: .*: run `logicity vap features` again"):
            load_features(out, made)
        kept = first.stat().st_mtime_ns
        compute_features(made.folder)
        assert second.read_bytes() == content and first.stat().st_mtime_ns == kept
    second.with_suffix(".json").write_bytes(record[:50])
    compute_features(made.folder)
    assert second.with_suffix(".json").read_bytes() == record
    shutil.copy(first, second)
    shutil.copy(first.with_suffix(".json"), second.with_suffix(".json"))
    for work in (lambda: load_features(out, made), lambda: compute_features(made.folder)):
        with pytest.raises(
            ValueError, match=r"world-00001\.npy` has the features of another data set .* changed since"
        ):
            work()
    second.unlink()
    # More worlds are added to the data set.
    make_dataset(made.folder, "easy", "test", worlds=3, drawing=Drawing(difficulty=0), threads=1)
    more = VapDataset(made.folder)
    second.with_suffix(".json").unlink()
    with pytest.raises(ValueError, match="no features of world 1 yet, or the world was added to"):
        load_features(out, more)
    kept = first.stat().st_mtime_ns
    compute_features(made.folder)
    assert first.stat().st_mtime_ns == kept and torch.equal(load_features(out, more)[: len(whole)], whole)


def test_features_need_the_files_of_the_manifest(tmp_path: Path) -> None:
    made = make_dataset(tmp_path / "set", "easy", "test", worlds=1, drawing=Drawing(difficulty=0), threads=1)
    world = made.folder / "world-00000"
    for name in ("frame-012.png", "entities.parquet"):
        content = (world / name).read_bytes()
        (world / name).write_bytes(content + b" ")
        with pytest.raises(ValueError, match=rf"{name}` has changed since it was made: .* run `logicity vap make` ag"):
            compute_features(made.folder, tmp_path / "out")
        (world / name).write_bytes(content)
        assert not (tmp_path / "out" / "world-00000.npy").exists()


def test_features_on_ray_are_those_of_one_thread(tmp_path: Path) -> None:
    needs("ray", "ray")
    made = make_dataset(tmp_path / "set", "hard", "test", worlds=2, threads=1)
    plain = compute_features(made.folder, tmp_path / "plain")
    on_ray = compute_features(made.folder, tmp_path / "ray", ray="local")
    for name in ("features.json", *(f"world-0000{world}.{end}" for world in (0, 1) for end in ("npy", "json"))):
        assert (plain / name).read_bytes() == (on_ray / name).read_bytes()


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C needs POSIX signals")
def test_features_are_made_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make_dataset(tmp_path / "set", "easy", "test", worlds=2, drawing=Drawing(difficulty=0), threads=1)
    assert command(("vap", "features"), [str(made.folder), "-o", str(tmp_path / "whole")]) == 0
    captured = capsys.readouterr()
    assert captured.err.splitlines() == ["[1/2] worlds", "[2/2] worlds"] and f"written: {tmp_path}" in captured.out
    # Ctrl-C ends the work, and the next call finishes it.
    words = [sys.executable, "-m", "logicity", "vap", "features", str(made.folder)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: process.poll() is not None or (tmp_path / "set-crops" / "features.json").exists())
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate()
    assert (process.returncode, printed.splitlines()[-1]) == (130, "interrupted")
    monkeypatch.chdir(made.folder)
    assert command(("vap", "features"), [".", "--threads", "2"]) == 0
    for world in ("world-00000.npy", "world-00001.npy"):
        assert (tmp_path / "set-crops" / world).read_bytes() == (tmp_path / "whole" / world).read_bytes()
    make_dataset(tmp_path / "tables", "easy", "test", worlds=1, images=False, threads=1)
    for arguments, code, message in [
        (["../tables"], 1, "error: `../tables` has no pictures: make it without `--no-pictures`"),
        ([".", "-o", "crops"], 2, "error: `crops` is in the data set"),
        ([".", "-o", "."], 2, "error: `.` is in the data set"),
        ([".", "--device", "cuda"], 2, "error: crops are cut on the CPU: remove `--device`"),
        ([".", "--weights", "a"], 2, "error: crops have no weights"),
    ]:
        assert command(("vap", "features"), arguments) == code
        assert message in capsys.readouterr().err
    with pytest.raises(ValueError, match="unknown kind of features `crop`; known: crops, resnet50"):
        compute_features(made.folder, kind="crop")  # type: ignore[arg-type]


def test_pictures_of_an_interrupted_experiment_are_removed(tmp_path: Path) -> None:
    spec = DataSpec("easy", "test", "fixed", 1, 0, 2, 0, "crops")
    tables, features = prepared(spec, tmp_path, "a")
    assert features is not None and len(features) == sum(len(each.names) for each in tables)
    (stored,) = tmp_path.rglob("world-00000.npy")
    pictures = stored.parent / "pictures-00000"
    pictures.mkdir()
    assert torch.equal(features, prepared(spec, tmp_path, "a")[1]) and not pictures.exists()
    # Features that are damaged or have no record are made again.
    content = stored.read_bytes()
    stored.with_suffix(".json").unlink()
    assert torch.equal(features, prepared(spec, tmp_path, "a")[1])
    assert stored.with_suffix(".json").exists()
    stored.write_bytes(content[:-1])
    assert torch.equal(features, prepared(spec, tmp_path, "a")[1])
    stored.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert torch.equal(features, prepared(spec, tmp_path, "a")[1]) and stored.read_bytes() == content
    # Other versions have other data.
    assert len(list(tmp_path.iterdir())) == 1
    prepared(DataSpec("easy", "test", "fixed", 1, 0, 2, 0, None), tmp_path, "b")
    assert len(list(tmp_path.iterdir())) == 2


def test_the_backbone_reads_regions_where_the_boxes_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    torchvision = needs("torchvision", "vap")
    from logicity.vap.features import Backbone

    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"no weights of ResNet50 in torchvision's cache .*--weights"):
        Backbone()
    torch.manual_seed(0)
    weights = tmp_path / "resnet50.pth"
    torch.save(torchvision.models.resnet50(weights=None).state_dict(), weights)
    extract = Backbone(weights)
    assert extract.identity == Backbone(weights).identity
    image = np.zeros((256, 512, 3), np.uint8)
    image[40:80, 400:440] = 255
    # The box of the bright square, one in the same rows, one in the same columns, and none.
    boxes = np.array([[400, 40, 40, 40], [40, 40, 40, 40], [400, 200, 40, 40], [np.nan] * 4], np.float32)
    found = extract(image, boxes)
    assert found.shape == (4, 512) and found.dtype == np.float16 and not found[3].any()
    # What the square changes, it changes most in its box.
    changes = np.abs(found.astype(np.float32) - extract(np.zeros_like(image), boxes).astype(np.float32)).sum(1)
    assert changes[0] > 1.5 * changes[1:].max()
    # A processor computes in bfloat16 or in float32, and the features say in which.
    has_bfloat16 = crops.has_bfloat16(torch.device("cpu"))
    monkeypatch.setattr("logicity.vap.features.has_bfloat16", lambda device: not has_bfloat16)
    another = Backbone(weights)
    assert another.identity != extract.identity
    known, differs = found[:3].astype(np.float32), another(image, boxes)[:3] != found[:3]
    assert differs.any() and np.abs(another(image, boxes)[:3] - known).mean() < 0.03 * np.abs(known).mean()
    monkeypatch.undo()
    # The same network with separate batch normalizations, in float32.
    with torch.random.fork_rng():
        torch.manual_seed(0)
        slow = torchvision.models.detection.backbone_utils.resnet_fpn_backbone(backbone_name="resnet50", weights=None)
    slow.body.load_state_dict(torch.load(weights, weights_only=True), strict=False)
    normal = torchvision.transforms.functional.normalize(
        torch.from_numpy(image).permute(2, 0, 1) / 255, [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
    )
    corners = torch.from_numpy(np.concatenate([boxes[:3, :2], boxes[:3, :2] + boxes[:3, 2:]], 1))
    align = torchvision.ops.MultiScaleRoIAlign(["0", "1", "2", "3"], output_size=7, sampling_ratio=2)
    with torch.inference_mode():
        regions = align(slow.eval()(normal[None]), [corners], [(256, 512)])
    expected = torch.cat([regions.mean((2, 3)), regions.amax((2, 3))], 1).numpy()
    assert np.abs(found[:3] - expected).mean() < 0.03 * np.abs(expected).mean()
    detector = torchvision.models.detection.fasterrcnn_resnet50_fpn(weights=None, weights_backbone=None).state_dict()
    torch.save(detector, weights)
    extract = Backbone(weights)
    # Files of older versions of torchvision have other names in the pyramid.
    older = {re.sub(r"(inner_blocks|layer_blocks)\.(\d)\.0", r"\1.\2", name): each for name, each in detector.items()}
    assert older.keys() != detector.keys()
    torch.save(older, weights)
    assert Backbone(weights).identity == extract.identity
    small = torchvision.models.resnet18(weights=None).state_dict()
    for content, message in [
        ({"a": torch.zeros(1)}, "not the weights of ResNet50 .*: `bn1.bias` is missing"),
        (small, "not the weights of ResNet50 .*: a weight has another shape"),
        ([1], "expected tensors by name"),
    ]:
        torch.save(content, tmp_path / "other.pth")
        with pytest.raises(ValueError, match=rf"other\.pth.* {message}"):
            Backbone(tmp_path / "other.pth")
    (tmp_path / "other.pth").write_text("hello")
    with pytest.raises(ValueError, match=r"other\.pth is .*cannot read it as plain data"):
        Backbone(tmp_path / "other.pth")
    with pytest.raises(ValueError, match="device `cuda:99`"):
        Backbone(weights, "cuda:99")


# --- rules on probabilities


@pytest.mark.parametrize("mode", ["easy", "hard"])
def test_the_rules_on_true_facts_are_exact(mode: Any, tmp_path: Path) -> None:
    made = make_dataset(tmp_path / "set", mode, "train", agents="random", worlds=2, images=False, threads=1)
    samples = Samples.load(made)
    rules = SoftRules(Program.load(f"rules/vap-{mode}.dl"))
    cars = samples.facts["mask"]
    for semantics in ("product", "max-min"):
        degrees = rules.degrees(
            samples.facts["unary"].float(), samples.relations.float(), samples.facts["valid"], semantics
        )
        assert (degrees.argmax(-1)[cars] == samples.facts["actions"][cars]).all()
        assert set(degrees[cars].unique().tolist()) == {0.0, 1.0} and (degrees[cars].sum(-1) == 1).all()


def test_the_order_of_actions_is_that_of_the_configuration() -> None:
    rules = SoftRules(Program.load("rules/vap-easy.dl"))
    read = {name: yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text()) for name in ("common", "vap-easy")}
    assert list(rules.precedence) == read["vap-easy"]["actions"]["priority"]
    assert rules.default == read["common"]["actions"]["default"]


def test_the_rules_on_wrong_facts_are_those_of_inference(samples: Samples) -> None:
    rules, inference = SoftRules(Program.load("rules/vap-hard.dl")), Inference("configs/vap-hard.yaml")
    generator = torch.Generator().manual_seed(3)
    chosen = torch.arange(0, len(samples), 8)
    batch = samples.batch(chosen)
    unary = batch["unary"] ^ (torch.rand(batch["unary"].shape, generator=generator) < 0.05)
    relations = torch.cat([batch["binary"], batch["sees"][..., None]], -1)
    binary = relations ^ (torch.rand(relations.shape, generator=generator) < 0.03)
    # An agent is a car or a pedestrian; the engine rejects both.
    unary[..., UNARY.index("IsPedestrian")] = ~unary[..., UNARY.index("IsCar")]
    part = Samples({name: batch[name] for name in samples.facts})
    expected = [
        ACTIONS.index(
            inference.answer({"entities": scene["entities"], "ego": scene["ego"], "facts": scene["facts"]})["egos"][
                scene["ego"]
            ]["action"]
        )
        for scene in scenes_of(unary, binary, part)
    ]
    degrees = rules.degrees(unary.float(), binary.float(), batch["valid"], "max-min")
    assert degrees.argmax(-1)[batch["mask"]].tolist() == expected and len(set(expected)) == 4


def test_probabilities_are_carried_through_the_rules() -> None:
    rules = SoftRules(Program.load("rules/vap-easy.dl"))
    unary, binary = torch.zeros(1, 3, len(UNARY)), torch.zeros(1, 3, 3, len(RELATIONS))
    valid = torch.tensor([[True, True, True]])
    unary[0, 0, UNARY.index("IsAtInter")] = 0.9
    unary[0, 1:, UNARY.index("IsInInter")] = torch.tensor([0.5, 0.25])
    binary[0, 0, :, RELATIONS.index("Sees")] = torch.tensor([0.0, 0.8, 0.4])
    # Stop: 0.9 x 0.5 x 0.8 = 0.36 for the second entity, 0.9 x 0.25 x 0.4 = 0.09 for the third.
    stop = ACTIONS.index("Stop")
    assert rules.degrees(unary, binary, valid, "product")[0, 0, stop] == pytest.approx(1 - 0.64 * 0.91)
    assert rules.degrees(unary, binary, valid, "max-min")[0, 0, stop] == pytest.approx(0.5)
    absent = torch.tensor([[True, False, True]])
    assert rules.degrees(unary, binary, absent, "product")[0, 0, stop] == pytest.approx(0.09)


def test_max_min_answers_are_those_of_thresholded_facts() -> None:
    rules = SoftRules(Program.load("rules/vap-hard.dl"))
    generator = torch.Generator().manual_seed(0)
    unary = torch.rand(50, 6, len(UNARY), generator=generator)
    binary = torch.rand(50, 6, 6, len(RELATIONS), generator=generator) ** 3
    valid = torch.ones(50, 6, dtype=torch.bool)
    soft = rules.degrees(unary, binary, valid, "max-min").argmax(-1)
    hard = rules.degrees((unary > 0.5).float(), (binary > 0.5).float(), valid, "product").argmax(-1)
    assert (soft == hard).all() and len(soft.unique()) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Stop(X) :- IsClose(X, Y), X != Y.", "only literals of predicates can have truth degrees, not `X != Y` in"),
        ('Stop("Car_1").', "only clauses with a body have truth degrees"),
        ("Stop(X) :- IsCar(X), Not(IsClose(X, _)).", "`Not(IsClose(X, _))` has no truth degree, in"),
        ("Stop(X) :- IsClose(X, Y), Stop(Y).", "`Stop(Y)` has no truth degree"),
        ("Slow(X) :- IsBus(X), Fast(X).\nFast(X) :- Slow(X).", "`Fast(X)` has no truth degree"),
        (
            "Normal(X) :- IsBus(X).",
            "`Normal` holds if no other action does: `Normal(X) :- IsBus(X).` has no truth degree",
        ),
    ],
)
def test_clauses_without_truth_degrees_are_reported(text: str, message: str) -> None:
    program = Program(f'.include "rules/vocabulary.dl"\n{text}')
    with pytest.raises(ValueError, match=re.escape(message)):
        SoftRules(program)


def test_clauses_may_have_comments_other_negations_and_anonymous_variables() -> None:
    program = Program(
        """.include "rules/vocabulary.dl"
        Stop(X) :- // IsBus(X),
            IsCar(X), not IsBus(X), !IsOld(X), Not( Fast(X) ), IsClose(X, _), NextTo(X, _).
        """
    )
    unary, binary = torch.zeros(1, 3, len(UNARY)), torch.zeros(1, 3, 3, len(RELATIONS))
    unary[0, 0, UNARY.index("IsCar")], unary[0, 0, UNARY.index("IsBus")] = 1.0, 0.5
    binary[0, 0, 1:, RELATIONS.index("Sees")] = 1.0
    # The two anonymous variables are different entities.
    binary[0, 0, 1, RELATIONS.index("IsClose")], binary[0, 0, 2, RELATIONS.index("NextTo")] = 0.8, 0.5
    degrees = SoftRules(program).degrees(unary, binary, torch.ones(1, 3, dtype=torch.bool))
    assert degrees[0, 0].tolist() == pytest.approx([0.0, 0.8, 0.0, 0.2])


# --- models


def inputs(count: int = 5, seed: int = 0) -> tuple[Any, Any, Any]:
    generator = torch.Generator().manual_seed(seed)
    unary = torch.rand(3, count, len(UNARY), generator=generator)
    binary = torch.rand(3, count, count, len(RELATIONS), generator=generator)
    binary[:, range(count), range(count)] = 0
    return unary, binary, torch.ones(3, count, dtype=torch.bool)


@pytest.mark.parametrize("name", ["gnn", "nlm"])
def test_reasoners_do_not_depend_on_order_and_padding(name: Any) -> None:
    torch.manual_seed(0)
    reasoner = make_reasoner(name)
    unary, binary, valid = inputs()
    with torch.no_grad():
        logits = reasoner(unary, binary, valid)
        order = torch.tensor([3, 0, 4, 1, 2])
        permuted = reasoner(unary[:, order], binary[:, order][:, :, order], valid)
        assert torch.allclose(permuted, logits[:, order], atol=1e-5)
        more, wider, _ = inputs(7, 1)
        more[:, :5], wider[:, :5, :5] = unary, binary
        present = torch.arange(7).expand(3, 7) < 5
        assert torch.allclose(reasoner(more, wider, present)[:, :5], logits, atol=1e-5)
        assert logits.shape == (3, 5, len(ACTIONS)) and logits.std() > 0


def test_only_higher_priority_depends_on_priorities(samples: Samples) -> None:
    batch = samples.batch(torch.arange(4))
    other = {**batch, "h": batch["h"].clone()}
    other["h"][..., 8] = torch.rand(other["h"].shape[:2])
    at = RELATIONS.index("HigherPri")
    for priority in (False, True):
        torch.manual_seed(0)
        model = ConceptModel(ConceptSettings(perception="sides", priority=priority))
        with torch.no_grad():
            (unary, binary), (unary_2, binary_2) = model(batch), model(other)
        changed = {RELATIONS[k] for k in range(len(RELATIONS)) if not torch.equal(binary[..., k], binary_2[..., k])}
        assert changed == (set(RELATIONS) if priority else {RELATIONS[at]})
        assert torch.equal(unary, unary_2) is not priority


def test_crops_are_recognized_in_either_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.manual_seed(0)
    network = CropNetwork(4, 5).eval()
    pictures = torch.randint(0, 256, (16, 48, 48, 3), dtype=torch.uint8)
    seen: list[torch.dtype] = []
    network.layers[0].register_forward_hook(lambda layer, given, result: seen.append(result.dtype))
    found = []
    for has_bfloat16 in (False, True):
        monkeypatch.setattr("logicity.vap.concepts.has_bfloat16", lambda device, known=has_bfloat16: known)
        with torch.inference_mode():
            found.append(network(pictures))
    assert seen == [torch.float32, torch.bfloat16] and found[1].dtype == torch.float32
    assert not torch.equal(*found) and torch.allclose(*found, atol=0.02)


@pytest.mark.parametrize(
    ("perception", "spatial", "shape"),
    [("crops", "geometric", (48, 48, 3)), ("features", "plain", (512,)), ("sides", "plain", None)],
)
def test_concept_models_take_crops_features_or_sides(
    samples: Samples, perception: Any, spatial: Any, shape: tuple[int, ...] | None
) -> None:
    entities = int(samples.facts["valid"].sum())
    kinds = {"crops": torch.uint8, "features": torch.float32}
    given = {} if shape is None else {perception: torch.zeros(entities, *shape, dtype=kinds[perception])}
    part = Samples(samples.facts, given)
    model = ConceptModel(ConceptSettings(perception=perception, spatial=spatial, width=2)).eval()
    unary, binary = model(part.batch(torch.tensor([5, 2])))
    count = samples.facts["valid"].shape[1]
    assert unary.shape == (2, count, 11) and binary.shape == (2, count, count, 7)
    with pytest.raises(ValueError, match="do not fit"):
        Samples(samples.facts, {"features": torch.zeros(3, 512)})


def test_spatial_concepts_reach_a_recall_of_0_9(tmp_path: Path) -> None:
    splits: list[tuple[Split, int]] = [("train", 8), ("test", 2)]
    # The boxes of version 1 fit the icons, so their centers are the places of the agents.
    tables: Any = {"images": False, "drawing": Drawing(version=1), "threads": 1}
    made = [
        Samples.load(make_dataset(tmp_path / split, "hard", split, worlds=worlds, **tables)) for split, worlds in splits
    ]
    torch.manual_seed(0)
    model = ConceptModel(ConceptSettings(perception="sides"))
    settings = TrainingSettings(epochs=6, learning_rate=2e-3)
    history = fit(model, concept_loss(model, made[0], 0.5), len(made[0]), settings, 0, lambda: 0.0)
    assert history[-1]["loss"] < history[0]["loss"]
    recall = concept_measures(*groundings(model, made[1]), made[1])
    for name in ("IsAtInter", "IsInInter", "IsClose", "NextTo", "LeftOf", "RightOf", "HigherPri", "Sees"):
        value = recall[name]["recall"]
        assert value is not None and value > 0.9, (name, recall[name])


def test_steps_are_updates_in_equal_parts() -> None:
    data = torch.arange(10.0).reshape(5, 2)

    def train(**changes: Any) -> tuple[list[list[int]], torch.Tensor, list[float]]:
        torch.manual_seed(0)
        model, batches = torch.nn.Linear(2, 1), []

        def loss(chosen: torch.Tensor, _: torch.Generator) -> torch.Tensor:
            batches.append(chosen.tolist())
            return model(data[chosen]).square().mean()

        history = fit(model, loss, 5, TrainingSettings(batch=2, **changes), 3, lambda: 0.0)
        return batches, model.weight.detach(), [each["loss"] for each in history]

    passes, weights, losses = train(epochs=4)
    same, again, equal = train(epochs=4, steps=12)
    assert (passes, losses) == (same, equal) and torch.equal(weights, again)
    # Parts of 2, 3 and 3 updates; each begins with a new order of all samples.
    batches, _, losses = train(epochs=3, steps=8)
    assert len(batches) == 8 and len(losses) == 3
    assert [sorted(sum(batches[2 + 3 * part : 5 + 3 * part], [])) for part in range(2)] == [list(range(5))] * 2
    # A part can have several passes.
    batches, _, losses = train(epochs=1, steps=7)
    assert [sorted(sum(batches[3 * turn : 3 * turn + 3], [])) for turn in range(2)] == [list(range(5))] * 2
    assert len(batches) == 7 and len(losses) == 1
    with pytest.raises(ValueError, match="2 steps have no 3 parts"):
        TrainingSettings(epochs=3, steps=2)
    assert "steps" not in TrainingSettings().model_dump() and TrainingSettings(steps=10).model_dump()["steps"] == 10


@pytest.mark.parametrize("steps", [None, 9])
def test_training_resumes_to_the_same_weights(steps: int | None, samples: Samples, tmp_path: Path) -> None:
    settings = TrainingSettings(epochs=4, batch=32, steps=steps)

    def train(checkpoint: Path | None, stop_after: int = 99) -> tuple[Any, Any]:
        torch.manual_seed(7)
        model = ConceptModel(ConceptSettings(perception="sides"))

        def report(epoch: int) -> None:
            if epoch == stop_after:
                raise KeyboardInterrupt

        history = fit(
            model,
            concept_loss(model, samples, 0.5),
            len(samples),
            settings,
            7,
            lambda: float(model.pairs[0].weight.std()),
            checkpoint,
            report,
        )
        return model.state_dict(), [{"loss": each["loss"], "score": each["score"]} for each in history]

    whole = train(None)
    checkpoint = tmp_path / "checkpoint.pt"
    for epoch in (1, 2, 3):
        with pytest.raises(KeyboardInterrupt):
            train(checkpoint, epoch)
    resumed = train(checkpoint)
    assert resumed[1] == whole[1] and len(whole[1]) == 4
    assert all(torch.equal(resumed[0][name], value) for name, value in whole[0].items())


@pytest.mark.parametrize("part", ["network", "optimizer", "schedule", "history", "best"])
def test_a_checkpoint_of_another_training_is_refused(part: str, tmp_path: Path) -> None:
    data = torch.arange(8.0).reshape(4, 2)
    checkpoint = tmp_path / "checkpoint.pt"

    def train(width: int = 1, last: int = 2, **changes: Any) -> None:
        def report(epoch: int) -> None:
            if epoch == last:
                raise KeyboardInterrupt

        model = torch.nn.Linear(2, width)
        settings = TrainingSettings(**{"epochs": 3, "batch": 2, **changes})

        def loss(chosen: torch.Tensor, _: torch.Generator) -> torch.Tensor:
            return model(data[chosen]).square().mean()

        fit(model, loss, 4, settings, 0, lambda: 0.0, checkpoint, report)

    def interrupted(**changes: Any) -> Any:
        checkpoint.unlink(missing_ok=True)
        with pytest.raises(KeyboardInterrupt):
            train(**changes)
        return read_tensors(checkpoint, "a checkpoint")

    def refused(state: Any) -> None:
        torch.save(state, checkpoint)
        with pytest.raises(ValueError, match="not a checkpoint of this training: .*; remove it to train from the"):
            train()

    other, good = interrupted(width=3), interrupted()
    for fault in [None, {}, {"last_epoch": "x"}, [{"loss": "x"}]] + [other[part]] * (part in ("network", "best")):
        refused({**good, part: fault})
    refused({**good, "history": good["history"] * 3})
    moments = good["optimizer"]["state"][0]
    for faulty in ({**moments, "exp_avg": torch.zeros(5)}, {**moments, "step": "x"}):
        refused({**good, "optimizer": {**good["optimizer"], "state": {0: faulty}}})
    refused(interrupted(epochs=4))
    refused(interrupted(learning_rate=0.5))
    torch.save(good, checkpoint)
    train(last=99)


# --- experiments


def test_the_shipped_experiments_have_cells() -> None:
    for name, paper, rows in [
        ("vap", "vap", 9),
        ("vap-50", "vap", 8),
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


def test_facts_of_a_scene_are_those_of_the_sample(samples: Samples) -> None:
    unary, binary = samples.facts["unary"].numpy(), samples.relations.numpy()
    facts = facts_of(unary[4], binary[4], range(len(unary[4])))
    assert facts["IsCar"] == [f"e{at}" for at in np.flatnonzero(unary[4, :, UNARY.index("IsCar")])]
    pairs = [[f"e{a}", f"e{b}"] for a, b in np.argwhere(binary[4, :, :, RELATIONS.index("LeftOf")])]
    assert sorted(facts["LeftOf"]) == sorted(pairs)
    # The first entity is the viewer.
    assert facts_of(unary[4], binary[4], [2, 0])["Sees"] == [["e2", "e2"], ["e2", "e0"]]


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
