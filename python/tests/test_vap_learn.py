"""Models of Visual Action Prediction: perception, rules on probabilities, and reasoners."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml
from conftest import ROOT, needs, wait_for

from logicity import ACTIONS, Inference
from logicity.rules import Program
from logicity.types import Split
from logicity.vap import UNARY, Drawing, VapDataset, make_dataset

torch: Any = needs("torch", "vap")
needs("stable_baselines3", "learn")
from logicity.commands import run as command  # noqa: E402
from logicity.files import read_tensors  # noqa: E402
from logicity.torch import Semantics  # noqa: E402
from logicity.vap import crops  # noqa: E402
from logicity.vap.concepts import RELATIONS, ConceptModel, ConceptSettings, CropNetwork  # noqa: E402
from logicity.vap.crops import crop_boxes  # noqa: E402
from logicity.vap.features import DataSpec, compute_features, load_features, prepared  # noqa: E402
from logicity.vap.reasoners import make_reasoner, rule_degrees  # noqa: E402
from logicity.vap.stages import facts_of, scenes_of  # noqa: E402
from logicity.vap.training import (  # noqa: E402
    Samples,
    TrainingSettings,
    concept_loss,
    concept_measures,
    fit,
    groundings,
)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> VapDataset:
    """A world with clean pictures."""
    folder = tmp_path_factory.mktemp("vap") / "set"
    return make_dataset(folder, "hard", "test", worlds=1, drawing=Drawing(difficulty=0), threads=1)


@pytest.fixture(scope="module")
def samples(pictures: VapDataset) -> Samples:
    return Samples.load(pictures)


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


def write_keras(folder: Path, state: dict[str, torch.Tensor], epsilon: float) -> Path:
    """Write the weights of a ResNet50 of torchvision as a model of Keras: layers and names by its own rules."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    layers: list[dict[str, Any]] = []

    def add(conv: str, batch: str, keras: tuple[str, str]) -> None:
        of = {name.removeprefix(batch + "."): each.numpy() for name, each in state.items() if name.startswith(batch)}
        bias = np.linspace(-1, 1, len(of["bias"]), dtype=np.float32)
        kernel = state[f"{conv}.weight"].numpy()
        if conv == "conv1":
            # Torchvision divides by these deviations, and Keras starts from blue on a scale to 255.
            kernel = (kernel / (255 * np.array([0.229, 0.224, 0.225], np.float32))[:, None, None])[:, ::-1]
        arrays[f"{keras[0]}/kernel"], arrays[f"{keras[0]}/bias"] = kernel.transpose(2, 3, 1, 0), bias
        arrays[f"{keras[1]}/gamma"], arrays[f"{keras[1]}/beta"] = of["weight"], of["bias"]
        arrays[f"{keras[1]}/moving_mean"] = of["running_mean"] + bias
        arrays[f"{keras[1]}/moving_variance"] = of["running_var"] + np.float32(1e-5 - epsilon)
        layers.extend([{"name": keras[0], "config": {}}, {"name": keras[1], "config": {"epsilon": epsilon}}])

    add("conv1", "bn1", ("conv1", "bn_conv1"))
    for name in [name for name in state if re.fullmatch(r"layer\d\.\d\.(conv\d|downsample\.0)\.weight", name)]:
        stage, block, *part = name.split(".")[:-1]
        branch = f"{int(stage[-1]) + 1}{chr(ord('a') + int(block))}_branch"
        branch += "1" if part[0] == "downsample" else f"2{chr(ord('a') + int(part[0][-1]) - 1)}"
        batch = f"{stage}.{block}." + ("downsample.1" if part[0] == "downsample" else f"bn{part[0][-1]}")
        add(name.removesuffix(".weight"), batch, (f"res{branch}", f"bn{branch}"))
    folder.mkdir()
    content = np.concatenate([each.ravel() for each in arrays.values()]).astype("<f4")
    half = len(content) // 2
    content[:half].tofile(folder / "shard1.bin")
    content[half:].tofile(folder / "shard2.bin")
    weights = [{"name": name, "shape": each.shape, "dtype": "float32"} for name, each in arrays.items()]
    document = {
        "modelTopology": {"model_config": {"config": {"layers": layers}}},
        "weightsManifest": [{"paths": ["shard1.bin", "shard2.bin"], "weights": weights}],
    }
    path = folder / "model.json"
    path.write_text(json.dumps(document))
    return path


def test_the_backbone_reads_the_weights_of_keras(tmp_path: Path) -> None:
    torchvision = needs("torchvision", "vap")
    from logicity.vap import keras_weights
    from logicity.vap.features import Backbone, weights_file_hash

    torch.manual_seed(0)
    network = torchvision.models.resnet50(weights=None)
    state = {name: each for name, each in network.state_dict().items() if not name.startswith("fc.")}
    path = write_keras(tmp_path / "model", state, 2e-5)
    read = keras_weights.read_resnet50(path)
    assert read.keys() == {name for name in state if not name.endswith("num_batches_tracked")}
    assert all(torch.allclose(each, state[name], atol=1e-6) for name, each in read.items())
    # The stride of a stage is in its first convolution.
    keras_weights.stride_first(network)
    for number in (2, 3, 4):
        block = network.get_submodule(f"layer{number}.0")
        assert (block.conv1.stride, block.conv2.stride) == ((2, 2), (1, 1))
    torch.save(state, tmp_path / "same.pth")
    image = np.random.default_rng(0).integers(0, 256, (128, 128, 3), np.uint8)
    boxes = np.array([[40, 40, 40, 40]], np.float32)
    mine, other = Backbone(path), Backbone(tmp_path / "same.pth")
    assert mine.identity != other.identity and not np.allclose(mine(image, boxes), other(image, boxes), rtol=0.05)
    # The hash is that of all files.
    known = weights_file_hash(path)
    shard = (tmp_path / "model" / "shard2.bin").read_bytes()
    (tmp_path / "model" / "shard2.bin").write_bytes(shard[:-4] + b"1234")
    assert weights_file_hash(path) != known
    (tmp_path / "model" / "shard2.bin").write_bytes(shard[:-4])
    with pytest.raises(ValueError, match=r"model\.json: the files of weights end before `.*`: extract the model again"):
        Backbone(path)
    document = json.loads(path.read_text())
    changes: list[tuple[Callable[[Any], object], str]] = [
        (lambda it: it["weightsManifest"][0]["weights"][0].update(dtype="uint8"), "not stored as float32"),
        (lambda it: it["weightsManifest"][0].update(paths=["../shard1.bin"]), "a file in another folder"),
        (lambda it: it["weightsManifest"][0]["weights"].pop(), "not a ResNet50 of Keras: no weight `"),
        (lambda it: it["modelTopology"]["model_config"]["config"]["layers"].pop(), "no layer `.*` with an epsilon"),
        (lambda it: it.pop("weightsManifest"), "is not a layers model of TensorFlow.js"),
    ]
    for change, message in changes:
        damaged = json.loads(json.dumps(document))
        change(damaged)
        path.write_text(json.dumps(damaged))
        (tmp_path / "model" / "shard2.bin").write_bytes(shard)
        with pytest.raises(ValueError, match=message):
            Backbone(path)


# --- rules on probabilities


@pytest.mark.parametrize("mode", ["easy", "hard"])
def test_the_rules_on_true_facts_are_exact(mode: Any, tmp_path: Path) -> None:
    made = make_dataset(tmp_path / "set", mode, "train", agents="random", worlds=2, images=False, threads=1)
    samples = Samples.load(made)
    rules, cars = Program.load(f"rules/vap-{mode}.dl"), samples.facts["mask"]
    facts = (samples.facts["unary"].float(), samples.relations.float(), samples.facts["valid"])
    for semantics in get_args(Semantics):
        degrees = rule_degrees(rules, semantics, *facts)
        assert (degrees.argmax(-1)[cars] == samples.facts["actions"][cars]).all()
        assert set(degrees[cars].unique().tolist()) == {0.0, 1.0} and (degrees[cars].sum(-1) == 1).all()


def test_the_precedence_of_actions_is_that_of_the_configuration() -> None:
    read = yaml.safe_load((ROOT / "configs" / "vap-easy.yaml").read_text())
    assert list(ACTIONS) == read["actions"]["priority"]


def test_the_rules_on_wrong_facts_are_those_of_inference(samples: Samples) -> None:
    rules, inference = Program.load("rules/vap-hard.dl"), Inference("configs/vap-hard.yaml")
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
    degrees = rule_degrees(rules, "godel", unary.float(), binary.float(), batch["valid"])
    assert degrees.argmax(-1)[batch["mask"]].tolist() == expected and len(set(expected)) == 4


def test_probabilities_are_carried_through_the_rules() -> None:
    rules = Program.load("rules/vap-easy.dl")
    unary, binary = torch.zeros(1, 3, len(UNARY)), torch.zeros(1, 3, 3, len(RELATIONS))
    valid = torch.tensor([[True, True, True]])
    unary[0, 0, UNARY.index("IsAtInter")] = 0.9
    unary[0, 1:, UNARY.index("IsInInter")] = torch.tensor([0.5, 0.25])
    binary[0, 0, :, RELATIONS.index("Sees")] = torch.tensor([0.0, 0.8, 0.4])
    # Stop: 0.9 x 0.5 x 0.8 = 0.36 for the second entity, 0.9 x 0.25 x 0.4 = 0.09 for the third.
    stop = ACTIONS.index("Stop")
    assert rule_degrees(rules, "product", unary, binary, valid)[0, 0, stop] == pytest.approx(1 - 0.64 * 0.91)
    assert rule_degrees(rules, "godel", unary, binary, valid)[0, 0, stop] == pytest.approx(0.5)
    absent = torch.tensor([[True, False, True]])
    assert rule_degrees(rules, "product", unary, binary, absent)[0, 0, stop] == pytest.approx(0.09)


def test_godel_answers_are_those_of_thresholded_facts() -> None:
    rules = Program.load("rules/vap-hard.dl")
    generator = torch.Generator().manual_seed(0)
    unary = torch.rand(50, 6, len(UNARY), generator=generator)
    binary = torch.rand(50, 6, 6, len(RELATIONS), generator=generator) ** 3
    valid = torch.ones(50, 6, dtype=torch.bool)
    soft = rule_degrees(rules, "godel", unary, binary, valid).argmax(-1)
    hard = rule_degrees(rules, "product", (unary > 0.5).float(), (binary > 0.5).float(), valid).argmax(-1)
    assert (soft == hard).all() and len(soft.unique()) == 4


# --- models


def inputs(count: int = 5, seed: int = 0) -> tuple[Any, Any, Any]:
    generator = torch.Generator().manual_seed(seed)
    unary = torch.rand(3, count, len(UNARY), generator=generator)
    binary = torch.rand(3, count, count, len(RELATIONS), generator=generator)
    binary[:, range(count), range(count)] = 0
    return unary, binary, torch.ones(3, count, dtype=torch.bool)


@pytest.mark.parametrize("name", ["gnn", "nlm", "rules"])
def test_reasoners_do_not_depend_on_order_and_padding(name: Any) -> None:
    torch.manual_seed(0)
    reasoner = make_reasoner(name, Program.load("rules/vap-hard.dl"))
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


def test_facts_of_a_scene_are_those_of_the_sample(samples: Samples) -> None:
    unary, binary = samples.facts["unary"].numpy(), samples.relations.numpy()
    facts = facts_of(unary[4], binary[4], range(len(unary[4])))
    assert facts["IsCar"] == [f"e{at}" for at in np.flatnonzero(unary[4, :, UNARY.index("IsCar")])]
    pairs = [[f"e{a}", f"e{b}"] for a, b in np.argwhere(binary[4, :, :, RELATIONS.index("LeftOf")])]
    assert sorted(facts["LeftOf"]) == sorted(pairs)
    # The first entity is the viewer.
    assert facts_of(unary[4], binary[4], [2, 0])["Sees"] == [["e2", "e2"], ["e2", "e0"]]
