from __future__ import annotations

import gc
import json
import math
import multiprocessing
import pickle
import random
import re
import shutil
import subprocess
import sys
import tarfile
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, SupportsIndex

import numpy as np
import pytest
from conftest import SETS, needs, picture, png
from numpy.typing import NDArray

import logicity
from logicity import ACTIONS, HEADINGS, InputError
from logicity.__main__ import main
from logicity.vap import (
    BINARY,
    PICTURE_SIDE,
    UNARY,
    VapDataset,
    VapSample,
    check_dataset,
    collate,
    make_dataset,
    measure_baselines,
    to_coco,
    to_webdataset,
    torch_dataset,
    vap_metrics,
)
from logicity.vap.baselines import rule_actions


@pytest.fixture(scope="session")
def hard(sets: Path) -> VapDataset:
    return VapDataset(sets / "hard", images=False)


@pytest.fixture(scope="session")
def drawn(sets: Path) -> VapDataset:
    return VapDataset(sets / "random", images=False)


@pytest.fixture
def own(sets: Path, tmp_path: Path) -> Path:
    """A copy of a data set that the test may damage."""
    return Path(shutil.copytree(sets / "hard", tmp_path / "own"))


def test_samples_are_by_world_and_tick(hard: VapDataset, drawn: VapDataset) -> None:
    assert (hard.mode, hard.agents, hard.split) == ("hard", "fixed", "test")
    assert (drawn.mode, drawn.agents, drawn.split) == ("easy", "random", "val")
    assert repr(hard) == "<VapDataset hard, fixed agents, test: 178 samples>"
    for samples, worlds in ((hard, 2), (drawn, 3)):
        wanted = [(world, tick) for world in range(worlds) for tick in range(11, 100)]
        assert [(sample.world, sample.tick) for sample in samples] == wanted and len(samples) == len(wanted)
    assert len({len(sample.names) for sample in drawn}) > 1, "the tests need worlds of different sizes"
    assert (hard[-1].world, hard[-1].tick) == (1, 99)
    for index in (178, -179):
        with pytest.raises(IndexError, match=f"no sample {index}: the data set has 178 samples"):
            hard[index]


def test_arrays_have_their_shapes_and_types(drawn: VapDataset) -> None:
    for sample in drawn:
        count = len(sample.names)
        shapes = {
            "boxes": ((count, 4), np.float32),
            "visible": ((count,), np.float32),
            "h": ((count, 9), np.float32),
            "unary": ((count, 11), np.bool_),
            "binary": ((count, count, 6), np.bool_),
            "sees": ((count, count), np.bool_),
            "actions": ((count,), np.int64),
            "mask": ((count,), np.bool_),
        }
        for name, (shape, dtype) in shapes.items():
            array = getattr(sample, name)
            assert array.shape == shape and array.dtype == dtype and array.flags.c_contiguous and array.flags.owndata
        assert len(sample.concepts) == count and sample.image is None
        assert [name.startswith("Car") for name in sample.names] == sample.mask.tolist()
        assert ((sample.actions >= 0) == sample.mask).all() and sample.actions.max() < 4
        assert sample.sees.diagonal().all() and not sample.binary.diagonal().any()


def test_arrays_of_samples_are_copies(hard: VapDataset) -> None:
    before = hard[5]
    for name in ("boxes", "visible", "h", "unary", "binary", "sees", "actions", "mask"):
        getattr(hard[5], name)[:] = 1
    assert alike(before, hard[5])


def alike(one: VapSample, other: VapSample) -> bool:
    """Return whether two samples are equal."""
    values = [(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__]
    return all(np.array_equal(a, b, equal_nan=np.asarray(a).dtype == np.float32) for a, b in values)


def test_columns_of_predicates_match_their_names(hard: VapDataset) -> None:
    concepts = ["ambulance", "bus", "police", "tiro", "reckless", "old", "young"]
    for sample in hard:
        of = dict(zip(UNARY, sample.unary.T, strict=True))
        assert (of["IsCar"] == sample.mask).all() and (of["IsPedestrian"] != sample.mask).all()
        for concept in concepts:
            carried = [concept in carries.split("+") for carries in sample.concepts]
            assert of[f"Is{concept.capitalize()}"].tolist() == carried
        between = dict(zip(BINARY, np.moveaxis(sample.binary, -1, 0), strict=True))
        priorities = sample.h[:, 8]
        assert (between["HigherPri"] == (priorities[:, None] < priorities)).all()
        assert not (between["LeftOf"] & between["RightOf"]).any() and not (between["IsClose"] & between["NextTo"]).any()
    assert all(np.any([sample.unary[:, column].any() for sample in hard]) for column in range(len(UNARY)))
    assert all(np.any([sample.binary[..., column].any() for sample in hard]) for column in range(len(BINARY)))


@pytest.mark.parametrize("name", SETS)
def test_the_rules_derive_every_label(name: str, sets: Path) -> None:
    samples = VapDataset(sets / name, images=False)
    labels = np.concatenate([sample.actions[sample.mask] for sample in samples])
    assert (rule_actions(samples) == labels).all()


def test_samples_equal_the_tables(sets: Path) -> None:
    parquet = needs("pyarrow.parquet", "offline")
    samples = iter(VapDataset(sets / "random", images=False))
    for world in range(3):
        folder = sets / "random" / f"world-{world:05}"
        rows = parquet.read_table(folder / "entities.parquet").to_pylist()
        pairs = defaultdict(list)
        for row in parquet.read_table(folder / "pairs.parquet").to_pylist():
            pairs[row["tick"]].append(row)
        for tick in range(11, 100):
            sample = next(samples)
            entities = [row for row in rows if row["tick"] == tick]
            largest = max(row["priority"] for row in entities)
            assert sample.names == tuple(row["name"] for row in entities)
            assert sample.concepts == tuple(row["concepts"] for row in entities)
            for at, row in enumerate(entities):
                box = [row[side] for side in ("x", "y", "width", "height")]
                heading = [0.0] * 4
                if row["heading"] is not None:
                    heading[row["heading"]] = 1.0
                if box[0] is None:
                    assert np.isnan(sample.boxes[at]).all() and np.isnan(sample.visible[at])
                    box = [0] * 4
                else:
                    assert sample.boxes[at].tolist() == box and sample.visible[at] == np.float32(row["visible"])
                wanted = [*(side / 1024 for side in box), *heading, row["priority"] / largest]
                assert sample.h[at].tolist() == pytest.approx(wanted)
                assert sample.actions[at] == (-1 if row["label"] is None else row["label"])
                assert sample.unary[at].tolist() == [row[name] for name in UNARY]
            for row in pairs[tick]:
                pair = (row["first"], row["second"])
                assert sample.binary[pair].tolist() == [row[name] for name in BINARY]
                assert sample.sees[pair] == row["Sees"]
    assert HEADINGS == ("Left", "Right", "Up", "Down")


def test_node_vectors_are_normalized(hard: VapDataset, drawn: VapDataset) -> None:
    for sample in (*hard, *drawn):
        assert (sample.h >= 0).all() and (sample.h <= 1).all() and (sample.h[:, 2:4] > 0).all()
        assert (sample.h[:, 4:8].sum(1) <= 1).all() and sample.h[:, 8].max() == 1
        assert (sample.h[:, :4] * PICTURE_SIDE == sample.boxes).all()


def test_entities_outside_the_picture_have_no_box(own: Path, tmp_path: Path) -> None:
    pyarrow = needs("pyarrow", "offline")
    parquet = needs("pyarrow.parquet", "offline")
    path = own / "world-00000" / "entities.parquet"
    table = parquet.read_table(path)
    outside = np.arange(table.num_rows) % 5 == 2
    for name in ("x", "y", "width", "height", "visible"):
        kind = pyarrow.float32() if name == "visible" else pyarrow.int32()
        column = pyarrow.array(table[name].to_numpy(), mask=outside, type=kind)
        table = table.set_column(table.schema.get_field_index(name), table.schema.field(name), column)
    parquet.write_table(table, path)
    samples = VapDataset(own, images=False)
    for index, gone in enumerate(np.split(outside, 89)):
        sample = samples[index]
        assert np.isnan(sample.boxes[gone]).all() and not np.isnan(sample.boxes[~gone]).any()
        assert np.isnan(sample.visible[gone]).all() and not np.isnan(sample.visible[~gone]).any()
        assert (sample.h[gone, :4] == 0).all() and (sample.h[~gone, 2:4] > 0).all()
    to_coco(own, tmp_path / "boxes.json", images=False)
    coco = check_coco(tmp_path / "boxes.json", samples)
    assert len(coco["annotations"]) == 2 * 89 * 14 - outside.sum()


def test_masks_show_the_entities(tmp_path: Path) -> None:
    folder = tmp_path / "masked"
    samples = make_dataset(folder, "hard", "test", worlds=1, images=False, masks=True)
    assert samples.has_masks and not samples.has_pictures
    check_dataset(folder)
    partly = 0
    for index in range(0, len(samples), 8):
        sample, mask = samples[index], samples.entity_mask(index)
        assert mask.shape == (PICTURE_SIDE, PICTURE_SIDE) and mask.dtype == np.uint8
        assert set(np.unique(mask)) - {0} == {at + 1 for at in np.flatnonzero(np.nan_to_num(sample.visible) > 0)}
        for at in np.flatnonzero(np.nan_to_num(sample.visible) > 0).tolist():
            rows, columns = np.nonzero(mask == at + 1)
            x, y, width, height = sample.boxes[at].tolist()
            assert x <= columns.min() and columns.max() < x + width and y <= rows.min() and rows.max() < y + height
            partly += sample.visible[at] < 1
    assert partly > 0
    # COCO has the pixels as run lengths in columns.
    to_coco(folder, tmp_path / "masks.json", images=False)
    coco = json.loads((tmp_path / "masks.json").read_text())
    mask = samples.entity_mask(40)
    numbers = {name: at + 1 for at, name in enumerate(samples[40].names)}
    of_sample = [each for each in coco["annotations"] if each["image_id"] == 40]
    assert of_sample
    for annotation in of_sample:
        counts = annotation["segmentation"]["counts"]
        pixels = np.repeat(np.arange(len(counts)) % 2, counts).reshape(PICTURE_SIDE, PICTURE_SIDE).T
        assert np.array_equal(pixels == 1, mask == numbers[annotation["name"]])
        assert annotation["segmentation"]["size"] == [PICTURE_SIDE, PICTURE_SIDE]
        assert annotation["area"] == int(pixels.sum()) and all(count > 0 for count in counts[1:])
    (folder / "world-00000" / "mask-011.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match="not a valid PNG"):
        samples.entity_mask(0)


def test_a_data_set_without_masks_says_so(hard: VapDataset) -> None:
    assert not hard.has_masks
    with pytest.raises(ValueError, match="has no masks: make it with masks=True"):
        hard.entity_mask(0)


def image_of(sample: VapSample) -> NDArray[np.uint8]:
    assert sample.image is not None
    return sample.image


def test_samples_have_their_pictures(shown: Path) -> None:
    samples = VapDataset(shown)
    for index in (0, 1, 90, -1):
        sample = samples[index]
        wanted = picture(sample.world, sample.tick)
        assert np.array_equal(image_of(sample), wanted)
    noise = np.random.default_rng(0).integers(0, 256, (PICTURE_SIDE, PICTURE_SIDE, 3), np.uint8)
    path = samples.picture_path(3)
    before = path.read_bytes()
    path.write_bytes(png(noise))
    assert np.array_equal(image_of(samples[3]), noise)
    path.write_bytes(before)


def test_read_picture_checks_the_output_array(shown: Path) -> None:
    samples = VapDataset(shown)
    for shape in [(PICTURE_SIDE, PICTURE_SIDE), (3, PICTURE_SIDE, PICTURE_SIDE), (3, 3, 3), (3, PICTURE_SIDE, 3)]:
        with pytest.raises(ValueError, match="shape"):
            samples.read_picture(0, np.empty(shape, np.uint8))
    with pytest.raises(ValueError, match="contiguous"):
        samples.read_picture(0, np.empty((PICTURE_SIDE, 2 * PICTURE_SIDE, 3), np.uint8)[:, ::2])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda whole: b"", "not a valid PNG"),
        (lambda whole: whole[: len(whole) // 2], "not a valid PNG"),
        (lambda whole: whole[:-6], "not a valid PNG"),
        (lambda whole: whole[:200] + bytes([whole[200] ^ 1]) + whole[201:], "not a valid PNG"),
        (lambda whole: png(picture(0, 11), rows=1000), "not a valid PNG"),
        (lambda whole: png(picture(0, 11)[:512]), "1024 x 512 pixels instead of 1024 x 1024"),
        (lambda whole: png(picture(0, 11), interlaced=1), "not a valid PNG"),
    ],
)
def test_invalid_pictures_raise(damage: Callable[[bytes], bytes], message: str, shown: Path) -> None:
    samples = VapDataset(shown)
    path = samples.picture_path(5)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    with pytest.raises(InputError, match=message) as error:
        samples[5]
    assert path.name in str(error.value) and error.value.diagnostics[0]["code"] == "invalid-data-set"
    path.unlink()
    with pytest.raises(FileNotFoundError, match=path.name):
        samples[5]
    path.write_bytes(whole)


def test_invalid_data_sets_raise(own: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="`logicity vap make` makes one"):
        VapDataset(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="has no pictures"):
        VapDataset(own)
    manifest = (own / "manifest.json").read_text()
    for text, message in [
        (
            manifest.replace('"version": 4', '"version": 2'),
            "version 2; this package reads versions 3 and 4; make the data set again with",
        ),
        (manifest.replace('"logicity vap"', '"photographs"'), "a data set `photographs`"),
        (manifest.replace('"logicity vap"', '"\\u001b[31m"'), re.escape("a data set `\\u001b[31m`")),
        (manifest.replace('"world": 0', '"world": 1e999'), "not a manifest .*: `world` is not an integer"),
        (manifest.replace('"world": 0', '"world": 9223372036854775808123'), "`world` is not an integer"),
        (manifest.replace('"frames": 89', '"frames": -5'), "`frames` is not an integer from 0"),
        (manifest.replace('"frames": 89', '"frames": true'), "`frames` is not an integer from 0"),
        ("[" * 10**6, "not a manifest .*: it is nested too deeply"),
        ("{", "not a manifest"),
        ("[]", "not a manifest"),
        (manifest.replace('"split"', '"half"'), "not a manifest"),
        (manifest.replace('"world"', '"town"'), "not a manifest"),
    ]:
        assert text != manifest
        (own / "manifest.json").write_text(text)
        with pytest.raises(ValueError, match=message):
            VapDataset(own, images=False)
    (own / "manifest.json").write_text(manifest.replace('"frames": 89', '"frames": 88'))
    with pytest.raises(ValueError, match="has 89 frames, the manifest lists 88"):
        VapDataset(own, images=False)[0]


def test_invalid_tables_raise(own: Path) -> None:
    samples = VapDataset(own, images=False, cached_worlds=0)
    entities, pairs = (own / "world-00001" / name for name in ("entities.parquet", "pairs.parquet"))
    whole = entities.read_bytes()
    for damaged, message in [
        (whole[: len(whole) // 2], "not a table of frames"),
        (pairs.read_bytes(), "there is no column `agent`"),
        ((own / "world-00000" / "entities.parquet").read_bytes(), "do not form one sample"),
        (whole.replace(b"IsInInter", b"IsInOuter"), "there is no column `IsInInter`"),
        (whole.replace(b"\x03\0\0\0Car", b"\x03\0\0\0Bar"), "cars, and only cars, have labels: Car_1 is a Bar"),
    ]:
        assert damaged != whole
        entities.write_bytes(damaged)
        assert alike(samples[0], samples[0]), "the other world is intact"
        with pytest.raises(InputError, match=message) as error:
            samples[100]
        assert "world-00001" in str(error.value) and error.value.diagnostics[0]["code"] == "invalid-data-set"
    entities.unlink()
    with pytest.raises(FileNotFoundError, match=entities.name):
        samples[100]


def test_data_sets_can_be_pickled(hard: VapDataset, shown: Path) -> None:
    assert alike(pickle.loads(pickle.dumps(hard))[120], hard[120])
    again = pickle.loads(pickle.dumps(VapDataset(shown)))
    assert again[7].image is not None and len(pickle.dumps(again)) < 1000


def test_the_seed_determines_the_order(drawn: VapDataset) -> None:
    def order(**options: Any) -> list[tuple[int, int]]:
        return [(sample.world, sample.tick) for sample in drawn.iterate(**options)]

    plain = [(sample.world, sample.tick) for sample in drawn]
    assert order(shuffle=False) == plain
    assert order(seed=3) == order(seed=3) != order(seed=4)
    assert order(seed=3) != plain and sorted(order(seed=3)) == plain
    for shuffle in (True, False):
        shards = [order(seed=3, shuffle=shuffle, shard=(part, 4)) for part in range(4)]
        assert sorted(sum(shards, [])) == plain and {len(shard) for shard in shards} == {66, 67}
        assert [shards[place % 4][place // 4] for place in range(len(plain))] == order(seed=3, shuffle=shuffle)
    with pytest.raises(ValueError, match="seed: expected 0 to .*, not -1"):
        drawn.iterate(seed=-1)
    for shard in [(0, 0), (1, 1), (-1, 2)]:
        with pytest.raises(ValueError, match="with 0 <= i < n"):
            drawn.iterate(shard=shard)
    for wrong in (3, (0.5, 2), (1,), "ab"):
        with pytest.raises(TypeError, match="^shard: expected a pair of integers, not "):
            drawn.iterate(shard=wrong)  # type: ignore[arg-type]
    for cached, error in [(-1, ValueError), (2**63, ValueError), (1.5, TypeError)]:
        with pytest.raises(error, match="^cached_worlds: expected "):
            VapDataset(drawn.folder, images=False, cached_worlds=cached)  # type: ignore[arg-type]


def slow_metrics(
    labels: list[int], predictions: list[int], frames: list[int]
) -> tuple[Mapping[str, float], float, float]:
    """Return the recalls, aAcc and wAcc, computed directly from their definitions."""
    cars = list(zip(labels, predictions, frames, strict=True))
    recall: dict[str, float] = {}
    above, below = 0.0, 0.0
    for action, name in enumerate(ACTIONS):
        of_it = [predicted for wanted, predicted, _ in cars if wanted == action]
        if of_it:
            recall[name] = of_it.count(action) / len(of_it)
            above += recall[name] / len(of_it)
            below += 1 / len(of_it)
    accuracies = []
    for frame in set(frames):
        right = [wanted == predicted for wanted, predicted, of in cars if of == frame]
        accuracies.append(sum(right) / len(right))
    return recall, sum(accuracies) / len(accuracies), above / below


def test_metrics_match_their_definition() -> None:
    dice = random.Random(0)
    seen: set[int] = set()
    for _ in range(300):
        count, actions = dice.randint(1, 60), dice.randint(1, 4)
        labels, predictions = ([dice.randrange(actions) for _ in range(count)] for _ in range(2))
        frames = [dice.choice([-7, 0, 3, 10**12]) for _ in range(count)]
        found = vap_metrics(labels, np.array(predictions, np.int8), frames)
        recall, a_acc, w_acc = slow_metrics(labels, predictions, frames)
        assert found.recall == pytest.approx(recall) and list(found.recall) == list(recall)
        assert [found.a_acc, found.w_acc] == pytest.approx([a_acc, w_acc])
        assert found.counts == {name: labels.count(ACTIONS.index(name)) for name in recall}
        seen.add(len(recall))
    assert seen == {1, 2, 3, 4}


def test_metrics_of_a_hand_computed_case() -> None:
    # Two frames, with one car and with three cars. One label is Slow, and three are Stop.
    found = vap_metrics([0, 3, 3, 3], [0, 3, 1, 1], [1, 2, 2, 2])
    assert found.recall == {"Slow": 1.0, "Stop": pytest.approx(1 / 3)}
    assert found.a_acc == pytest.approx((1 + 1 / 3) / 2)
    assert found.w_acc == pytest.approx((1 / 1 + (1 / 3) / 3) / (1 + 1 / 3))
    assert json.dumps(found.to_dict())


@pytest.mark.parametrize(
    ("labels", "predictions", "frames", "error", "message"),
    [
        ([], [], [], ValueError, "at least one car"),
        ([0], [0, 1], [0], ValueError, "1 labels, 2 predictions and 1 frames"),
        ([0], [0], [0, 0], ValueError, "2 frames"),
        ([-1], [0], [0], ValueError, "expected labels from 0 to 3, not -1; omit pedestrians"),
        ([0, 1], [0, 4], [0, 0], ValueError, "expected predictions from 0 to 3, not 4"),
        ([[0]], [0], [0], ValueError, r"expected labels of shape \(M,\), not \(1, 1\)"),
        ([0.0], [0], [0], TypeError, "expected integer labels, not float64"),
        ([0], [True], [0], TypeError, "expected integer predictions, not bool"),
        ([0], [0], ["a"], TypeError, "expected integer frames"),
    ],
)
def test_invalid_predictions_raise(
    labels: Any, predictions: Any, frames: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        vap_metrics(labels, predictions, frames)


def test_shards_hold_every_sample(shown: Path, tmp_path: Path) -> None:
    samples = VapDataset(shown)
    paths = to_webdataset(shown, tmp_path / "shards", 100)
    assert [path.name for path in paths] == [f"shard-{number:06}.tar" for number in range(3)]
    index = 0
    for path in paths:
        with tarfile.open(path) as tar:
            members = tar.getmembers()
            assert len(members) == 3 * min(100, len(samples) - index)
            for json_member, npz_member, png_member in zip(*[iter(members)] * 3, strict=True):
                sample = samples.facts(index)
                key = f"world-{sample.world:05}-frame-{sample.tick:03}"
                names = [member.name for member in (json_member, npz_member, png_member)]
                assert names == [f"{key}.json", f"{key}.npz", f"{key}.png"]
                text, arrays, image = (tar.extractfile(member) for member in (json_member, npz_member, png_member))
                assert text is not None and arrays is not None and image is not None
                record = json.load(text)
                assert (record["world"], record["tick"]) == (sample.world, sample.tick)
                assert (record["names"], record["concepts"]) == (list(sample.names), list(sample.concepts))
                assert (record["mode"], record["split"]) == ("easy", "val")
                assert (record["unary"], record["binary"]) == (list(UNARY), list(BINARY))
                with np.load(arrays) as held:
                    assert sorted(held) == ["actions", "binary", "boxes", "h", "mask", "sees", "unary", "visible"]
                    for name in held:
                        assert np.array_equal(held[name], getattr(sample, name), equal_nan=name in ("boxes", "visible"))
                assert image.read() == samples.picture_path(index).read_bytes()
                index += 1
    assert index == len(samples)
    again = to_webdataset(shown, tmp_path / "again", 100)
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in paths]
    with pytest.raises(FileExistsError):
        to_webdataset(shown, tmp_path / "again")
    with pytest.raises(ValueError, match=r"^shard_size: expected 1 to 2\*\*64 - 1, not 0$"):
        to_webdataset(shown, tmp_path / "none", 0)
    samples.picture_path(200).rename(tmp_path / "aside.png")
    with pytest.raises(FileNotFoundError):
        to_webdataset(shown, tmp_path / "partly")
    (tmp_path / "aside.png").rename(samples.picture_path(200))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again", "shards"]


# `webdataset` does not close the last file. The test runs the garbage collector to trigger the warning here.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_webdataset_reads_the_shards(shown: Path, tmp_path: Path) -> None:
    webdataset = needs("webdataset", "test-all")
    paths = to_webdataset(shown, tmp_path / "shards", 100)
    samples = VapDataset(shown)
    read = webdataset.WebDataset([str(path) for path in paths], shardshuffle=False).decode("rgb8")
    count = 0
    for index, found in enumerate(read):
        sample = samples[index]
        assert found["json"]["tick"] == sample.tick and (found["png"] == sample.image).all()
        assert (found["npz"]["binary"] == sample.binary).all()
        count += 1
    assert count == len(samples)
    del read
    gc.collect()


def check_coco(path: Path, samples: VapDataset) -> dict[str, Any]:
    """Check a file against the format of COCO and the samples."""
    coco: dict[str, Any] = json.loads(path.read_text())
    assert [picture["id"] for picture in coco["images"]] == list(range(len(samples)))
    ids = [annotation["id"] for annotation in coco["annotations"]]
    assert ids == list(range(1, len(ids) + 1))
    categories = {category["id"]: category for category in coco["categories"]}
    assert list(categories) == list(range(1, len(categories) + 1))
    by_picture: dict[int, list[dict[str, Any]]] = {picture["id"]: [] for picture in coco["images"]}
    for annotation in coco["annotations"]:
        by_picture[annotation["image_id"]].append(annotation)
    for index, sample in enumerate(samples):
        place = coco["images"][index]
        assert samples.folder / place["file_name"] == samples.picture_path(index)
        assert (place["width"], place["height"]) == (PICTURE_SIDE, PICTURE_SIDE)
        inside = [at for at in range(len(sample.names)) if not math.isnan(sample.boxes[at, 0])]
        assert [annotation["name"] for annotation in by_picture[index]] == [sample.names[at] for at in inside]
        for at, annotation in zip(inside, by_picture[index], strict=True):
            x, y, width, height = annotation["bbox"]
            assert [x, y, width, height] == sample.boxes[at].tolist() and annotation["area"] == width * height
            assert x >= 0 and y >= 0 and x + width <= 1024 and y + height <= 1024 and annotation["iscrowd"] == 0
            category = categories[annotation["category_id"]]
            kind = "Car" if sample.mask[at] else "Pedestrian"
            assert (category["name"], category["supercategory"]) == (sample.concepts[at] or kind.lower(), kind)
            assert annotation["visible"] == sample.visible[at]
            assert annotation.get("action") == (ACTIONS[sample.actions[at]] if sample.mask[at] else None)
    return coco


def test_boxes_have_the_format_of_coco(shown: Path, sets: Path, tmp_path: Path) -> None:
    out = tmp_path / "boxes.json"
    to_coco(shown, out)
    check_coco(out, VapDataset(shown))
    to_coco(sets / "hard", out, images=False)
    coco = check_coco(out, VapDataset(sets / "hard", images=False))
    names = ["car", "ambulance", "bus", "police", "tiro", "reckless", "pedestrian", "old", "young"]
    assert [category["name"] for category in coco["categories"]] == names
    assert coco["info"] == {"description": "LogiCity, Visual Action Prediction, hard, test", "pictures": False}
    to_coco(shown, out, images=False)
    assert json.loads(out.read_text())["info"]["pictures"] is True, (
        "the data set has pictures, whether they are read or not"
    )
    assert {path.name for path in tmp_path.iterdir()} == {"boxes.json", ".logicity.json"}
    with pytest.raises(ValueError, match="--no-pictures"):
        to_coco(sets / "hard", tmp_path / "other.json")
    with pytest.raises(OSError):
        to_coco(shown, tmp_path / "no" / "such.json")


def test_combined_concepts_are_categories(own: Path, tmp_path: Path) -> None:
    # Both names have nine characters, so the replacement keeps the layout of the file.
    for path in own.glob("world-*/entities.parquet"):
        path.write_bytes(path.read_bytes().replace(b"ambulance", b"bus+tiros"))
    to_coco(own, tmp_path / "boxes.json", images=False)
    coco = check_coco(tmp_path / "boxes.json", VapDataset(own, images=False))
    assert coco["categories"][9:] == [{"id": 10, "name": "bus+tiros", "supercategory": "Car"}]


def test_pycocotools_reads_the_boxes(shown: Path, tmp_path: Path) -> None:
    coco = needs("pycocotools.coco", "test-all")
    evaluation = needs("pycocotools.cocoeval", "test-all")
    to_coco(shown, tmp_path / "boxes.json")
    truth = coco.COCO(tmp_path / "boxes.json")
    wanted = truth.loadAnns(truth.getAnnIds())
    keys = ("image_id", "category_id", "bbox")
    found = truth.loadRes([{**{key: one[key] for key in keys}, "score": 0.9} for one in wanted])
    measured = evaluation.COCOeval(truth, found, "bbox")
    measured.evaluate()
    measured.accumulate()
    measured.summarize()
    assert measured.stats[0] == pytest.approx(1)


def test_the_commands_convert(shown: Path, sets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shards, boxes = tmp_path / "shards", tmp_path / "boxes.json"
    assert main(["vap", "webdataset", str(shown), str(shards), "--shard-size", "150"]) == 0
    assert capsys.readouterr().out == f"2 files in {shards}\n"
    assert main(["vap", "webdataset", str(shown), str(shards)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert main(["vap", "coco", str(sets / "hard"), str(boxes)]) == 1
    assert "has no pictures" in capsys.readouterr().err
    assert main(["vap", "coco", str(sets / "hard"), str(boxes), "--no-pictures"]) == 0 and boxes.is_file()
    assert main(["vap", "webdataset", str(sets / "hard"), str(tmp_path / "facts"), "--no-pictures"]) == 0
    helps = {}
    for command in ("webdataset", "coco"):
        capsys.readouterr()
        with pytest.raises(SystemExit):
            main(["vap", command, "--help"])
        helps[command] = " ".join(capsys.readouterr().out.split())
    assert "omit pictures" in helps["webdataset"] and "omit" not in helps["coco"]
    assert "the output still has `file_name`s" in helps["coco"]


def needs_torch() -> Any:
    """Return PyTorch, or skip the test if it is not installed."""
    return needs("torch", "vap")


#: Calls functions in a process without PyTorch, and prints their errors.
WITHOUT_TORCH = """
import sys

sys.modules["torch"] = None
from logicity.vap import collate, measure_baselines, torch_dataset

folder = sys.argv[1]
for call in (
    lambda: torch_dataset(folder, images=False),
    lambda: collate([]),
    lambda: measure_baselines(folder, folder),
):
    try:
        call()
    except ImportError as error:
        print(error)
"""


def test_without_torch_the_error_names_the_extra(hard: VapDataset) -> None:
    words = [sys.executable, "-c", WITHOUT_TORCH, str(hard.folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 3 and all(
        each.endswith("; install the extra `vap`: pip install 'logicity[vap]'") for each in lines
    )


def test_tensors_equal_the_arrays(shown: Path) -> None:
    torch = needs_torch()
    samples, tensors = VapDataset(shown), torch_dataset(shown)
    assert isinstance(tensors, torch.utils.data.Dataset) and len(tensors) == len(samples)
    for index in (0, 100, -1):
        sample, found = samples[index], tensors[index]
        for name in ("boxes", "visible", "h", "unary", "binary", "sees", "actions", "mask"):
            assert torch.equal(found[name].nan_to_num(-5), torch.from_numpy(getattr(sample, name)).nan_to_num(-5))
        assert np.array_equal(found["image"].permute(1, 2, 0).numpy(), image_of(sample))
        assert {name: found[name] for name in ("world", "tick", "names", "concepts")} == {
            name: getattr(sample, name) for name in ("world", "tick", "names", "concepts")
        }
    assert "image" not in torch_dataset(shown, images=False)[0]


def test_batches_are_padded(drawn: VapDataset) -> None:
    torch = needs_torch()
    tensors = torch_dataset(drawn.folder, images=False)
    chosen = [tensors[index] for index in (0, 100, 200)]
    batch = collate(chosen)
    most = max(len(sample["names"]) for sample in chosen)
    fillers = {
        "boxes": math.nan,
        "visible": math.nan,
        "h": 0,
        "unary": 0,
        "binary": 0,
        "sees": 0,
        "actions": -1,
        "mask": 0,
    }
    for row, sample in enumerate(chosen):
        count = len(sample["names"])
        assert batch["valid"][row].tolist() == [True] * count + [False] * (most - count)
        for name, filler in fillers.items():
            square = name in ("binary", "sees")
            assert batch[name].dtype == sample[name].dtype
            for first in range(most):
                for second in range(most if square else 1):
                    at = (first, second) if square else (first,)
                    inside = max(at) < count
                    wanted = (
                        sample[name][at] if inside else torch.full_like(sample[name][0], filler)[0 if square else ...]
                    )
                    assert np.array_equal(
                        batch[name][(row, *at)].numpy(), wanted.numpy(), equal_nan=name in ("boxes", "visible")
                    )
    assert batch["names"] == [sample["names"] for sample in chosen] and batch["tick"].tolist() == [11, 22, 33]
    assert "image" not in batch
    assert sum(value.nbytes for value in batch.values() if torch.is_tensor(value)) == 3 * (7 * most**2 + 77 * most + 16)
    with pytest.raises(ValueError, match="at least one sample"):
        collate([])


def test_collate_stacks_pictures_without_a_copy_if_possible(shown: Path) -> None:
    torch = needs_torch()
    tensors = torch_dataset(shown)
    whole = tensors.__getitems__([3, 150, 4])
    alone = tensors.__getitems__([7])
    changes: list[Callable[[Any], Any]] = [
        lambda image: image,
        lambda image: image[:, :512],
        lambda image: image[:, :, :100],
        lambda image: image[:2],
        lambda image: image[:, ::2, ::3],
        lambda image: image[:, 9:, 5:],
        lambda image: image.transpose(1, 2),
        lambda image: image.permute(1, 2, 0),
        lambda image: image.flip(2),
        lambda image: image.view(torch.int8),
        lambda image: image.float(),
        lambda image: image.contiguous(),
    ]
    for change in changes:
        for samples in (whole, alone, whole[:2], whole[1:], whole[::-1], [*whole, *alone], alone * 3):
            images = [change(sample["image"]) for sample in samples]
            found = collate([{**sample, "image": image} for sample, image in zip(samples, images, strict=True)])
            wanted = torch.stack(images)
            assert found["image"].dtype == wanted.dtype and torch.equal(found["image"], wanted)
    mixed = [{**whole[0]}, {**whole[1], "image": whole[1]["image"].transpose(1, 2)}, {**whole[2]}]
    assert torch.equal(collate(mixed)["image"], torch.stack([sample["image"] for sample in mixed]))
    for samples in (whole, alone):
        assert collate(samples)["image"].data_ptr() == samples[0]["image"].data_ptr(), "collated without a copy"


@pytest.mark.parametrize("method", sorted({"fork", "spawn"} & set(multiprocessing.get_all_start_methods())))
def test_workers_give_the_same_batches(method: str, shown: Path) -> None:
    torch = needs_torch()
    tensors = torch_dataset(shown)
    chosen = torch.utils.data.Subset(tensors, [3, 150, 4, 260, 5, 10])

    def read(**options: Any) -> list[dict[str, Any]]:
        return list(torch.utils.data.DataLoader(chosen, 2, collate_fn=collate, **options))

    for found, wanted in zip(read(num_workers=2, multiprocessing_context=method), read(), strict=True):
        assert list(found) == list(wanted)
        for name, value in wanted.items():
            same = torch.equal(found[name].nan_to_num(-5), value.nan_to_num(-5)) if hasattr(value, "shape") else None
            assert found[name] == value if same is None else same
        assert wanted["image"].shape == (2, 3, PICTURE_SIDE, PICTURE_SIDE)


def test_threads_give_the_same_pictures(shown: Path) -> None:
    needs_torch()
    alone, together = torch_dataset(shown), torch_dataset(shown, threads=3)
    chosen = [3, 150, 4, 260, 5, 10]
    batches = [collate(tensors.__getitems__(chosen))["image"] for tensors in (alone, together)]
    assert (batches[0] == batches[1]).all() and batches[0].shape == (6, 3, PICTURE_SIDE, PICTURE_SIDE)
    for image, index in zip(batches[1], chosen, strict=True):
        assert np.array_equal(image.permute(1, 2, 0).numpy(), image_of(VapDataset(shown)[index]))
    path = VapDataset(shown).picture_path(260)
    before = path.read_bytes()
    path.write_bytes(before[:1000])
    with pytest.raises(InputError, match="not a valid PNG"):
        together.__getitems__(chosen)
    path.write_bytes(before)
    with pytest.raises(ValueError, match="not 0"):
        torch_dataset(shown, threads=0)


def test_baselines_are_measured(sets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_torch()
    folder, figures = str(sets / "hard"), tmp_path / "figures.json"
    command = ["vap", "baselines", "--train", folder, "--test", folder, "--epochs", "8", "--json", str(figures)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    results = json.loads(figures.read_text())
    majority, network, rules = (result["metrics"] for result in results)
    assert [result["name"] for result in results] == ["majority", "network", "rules"]
    assert majority["recall"] == {"Slow": 0, "Normal": 0, "Fast": 0, "Stop": 0} | {
        max(majority["counts"], key=majority["counts"].get): 1
    }
    assert set(rules["recall"].values()) == {1} and rules["a_acc"] == rules["w_acc"] == 1
    assert majority["a_acc"] + 0.2 < network["a_acc"] < 1
    assert "| hard | rules | 1.000 | 1.000 | 1.000 | 1.000 | 1.000 | 1.000 |" in printed.splitlines()
    assert len(printed.splitlines()) == 5
    assert main(command) == 0 and capsys.readouterr().out == printed and json.loads(figures.read_text()) == results
    assert main([*command, "--seed", "1"]) == 0 and capsys.readouterr().out != printed


def test_underivable_labels_are_reported(own: Path, sets: Path, capsys: pytest.CaptureFixture[str]) -> None:
    needs_torch()
    manifest = own / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"mode": "hard"', '"mode": "easy"'))
    folder = str(own)
    assert main(["vap", "baselines", "--train", folder, "--test", folder, "--epochs", "1"]) == 1
    assert "labels that the rules do not derive" in capsys.readouterr().err
    assert main(["vap", "baselines", "--train", folder, "--test", str(sets / "hard")]) == 1
    assert "the modes differ" in capsys.readouterr().err


class FewCars(VapDataset):
    """A data set in which only some samples have cars. The cars of the other samples become pedestrians."""

    def __init__(self, folder: Path, with_cars: range) -> None:
        super().__init__(folder, images=False)
        self._with_cars = with_cars

    def facts(self, index: SupportsIndex) -> VapSample:
        sample = super().facts(index)
        if int(index) in self._with_cars:
            return sample
        return replace(sample, actions=np.full_like(sample.actions, -1), mask=np.zeros_like(sample.mask))


def test_samples_without_cars_do_not_affect_training(hard: VapDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    needs_torch()
    from logicity.vap.training import train_on_facts

    def predictions(with_cars: range, epochs: int) -> list[int]:
        learned = train_on_facts(FewCars(hard.folder, with_cars), hard, 0, epochs, lambda done: None)
        return list(map(int, learned))

    # With only two samples with cars, some of three batches of 64 samples would have none.
    assert len(set(predictions(range(2), 20))) > 1
    assert predictions(range(2), 20) != predictions(range(2), 1)

    for train, test in [(0, 2), (2, 0)]:
        with_cars = iter([range(train), range(test)])
        monkeypatch.setattr(
            "logicity.vap.baselines.VapDataset", lambda folder, images, given=with_cars: FewCars(folder, next(given))
        )
        with pytest.raises(ValueError, match="hard` has no cars"):
            measure_baselines(hard.folder, hard.folder)


def test_vap_is_an_attribute_of_the_package() -> None:
    assert logicity.vap.VapDataset is VapDataset and set(logicity.vap.__all__) <= set(dir(logicity.vap))
