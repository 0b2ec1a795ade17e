"""Stored inputs of the perception: crops or backbone features of each box. Needs the extra `vap`.

Two kinds exist. `crops` are the pixels of each box, scaled to 48 x 48, for a small network that is trained. `resnet50`
are features of a frozen ResNet50 with a feature pyramid and ROIAlign, as in the paper: the mean and the maximum of each
of the 256 channels over the 7 x 7 cells of a box.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import checked_path, checked_threads, extra
from ..files import check_readable, file_hash, read_json, read_tensors, write_json
from .data import PICTURE_SIDE, VapDataset, count_in, reading_manifest
from .make import Drawing, make_dataset

with extra("vap"):
    import torch
    from torch import Tensor, nn
    from torch.nn.utils.fusion import fuse_conv_bn_eval

from .crops import CROP_SIDE, crop_boxes, has_bfloat16
from .keras_weights import DEVIATION, MEAN, model_hash, read_resnet50, stride_first

__all__ = ["Backbone", "Crops", "DataSpec", "Extractor", "compute_features", "extractor", "load_features", "prepared"]

Kind = Literal["crops", "resnet50"]

#: The version of the format of `features.json`.
FORMAT = 2

#: The keys of `world-00000.json`, all SHA-256: of the file of features, of the world's files and hashes in the
#: manifest, and of the extractor.
RECORD_KEYS = ("sha256", "data_hash", "extractor_hash")

#: The files of weights that torchvision downloads, in the order in which they are looked up.
WEIGHTS = ("fasterrcnn_resnet50_fpn_coco-258fb6c6.pth", "resnet50-0676ba61.pth", "resnet50-11ad3fa6.pth")


class Crops:
    """Crops of the boxes, see `crop_boxes`.

    `shape` and `dtype` are those of the features of a box. `identity` is the SHA-256 of what determines the features of
    a picture.
    """

    kind: Kind = "crops"
    shape: tuple[int, ...] = (CROP_SIDE, CROP_SIDE, 3)
    dtype: np.dtype[Any] = np.dtype(np.uint8)
    identity = hashlib.sha256(f"crops {CROP_SIDE} bilinear antialias".encode()).hexdigest()

    def __call__(self, image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> NDArray[Any]:
        """Return uint8 (N, 48, 48, 3)."""
        return crop_boxes(image, boxes)


class Backbone:
    """A frozen ResNet50 with a feature pyramid and ROIAlign. Its attributes are those of `Crops`.

    Convolutions contain their batch normalizations. If the device computes in bfloat16, they do, too, which takes a
    third of the time and changes features by about 1 %; features in float32 are another kind of features.

    Args:
        weights: A file with the weights of torchvision's ResNet50, or of its Faster R-CNN with ResNet50 and a feature
            pyramid; or `model.json` of Keras' ResNet50 as a layers model of TensorFlow.js, with its files of weights
            beside it. By default, one of torchvision's files in its cache. Weights of ResNet50 alone have no pyramid:
            its convolutions are then random, the same in every run.
        device: A device of PyTorch, such as `cpu` or `cuda`.

    Raises:
        FileNotFoundError: If there are no weights.
        ValueError: If the file has other weights, or the device does not exist.
    """

    kind: Kind = "resnet50"
    shape: tuple[int, ...] = (512,)
    dtype: np.dtype[Any] = np.dtype(np.float16)

    def __init__(self, weights: str | os.PathLike[str] | None = None, device: str = "cpu") -> None:
        """Read the weights."""
        with extra("vap"):
            from torchvision.models.detection.backbone_utils import resnet_fpn_backbone
            from torchvision.ops import MultiScaleRoIAlign
        path = weights_file(weights)
        is_keras = path.suffix == ".json"
        state = read_resnet50(path) if is_keras else _state(path)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            network = resnet_fpn_backbone(backbone_name="resnet50", weights=None)
        if is_keras:
            stride_first(network.body)
        pyramid = {name.removeprefix("backbone."): each for name, each in state.items() if name.startswith("backbone.")}
        module, values = (network, pyramid) if pyramid else (network.body, state)
        message = f"{path}: not the weights of ResNet50 or of Faster R-CNN with ResNet50"
        try:
            # Converts the names that older versions of torchvision gave to the pyramid.
            missing = module.load_state_dict(values, strict=False).missing_keys
        except RuntimeError:
            raise ValueError(f"{message}: a weight has another shape") from None
        if missing := [name for name in missing if not name.endswith("num_batches_tracked")]:
            raise ValueError(f"{message}: `{min(missing)}` is missing")
        parts = [hashlib.sha256(each.cpu().numpy().tobytes()).hexdigest() for each in network.state_dict().values()]
        _fold_normalizations(network.eval())
        try:
            self._device = torch.device(device)
            network.to(self._device, memory_format=torch.channels_last)
            self._network = network.requires_grad_(False)
        except (AssertionError, RuntimeError) as error:
            raise ValueError(f"device `{device}`: {str(error).splitlines()[0]}") from None
        self._has_bfloat16 = has_bfloat16(self._device)
        method = f"{'bfloat16' if self._has_bfloat16 else 'float32'} mean max 7{' stride first' if is_keras else ''}"
        self.identity = hashlib.sha256(json.dumps(["resnet50", method, *parts]).encode()).hexdigest()
        self._align = MultiScaleRoIAlign(["0", "1", "2", "3"], output_size=7, sampling_ratio=2)

    def __call__(self, image: NDArray[np.uint8], boxes: NDArray[np.float32]) -> NDArray[Any]:
        """Return float16 (N, 512), zeros for boxes outside the picture."""
        result = np.zeros((len(boxes), *self.shape), self.dtype)
        inside = ~np.isnan(boxes[:, 0])
        if not inside.any():
            return result
        corners = torch.from_numpy(np.concatenate([boxes[inside, :2], boxes[inside, :2] + boxes[inside, 2:]], 1))
        with torch.inference_mode():
            pixels = torch.from_numpy(image).to(self._device).permute(2, 0, 1)[None].float() / 255
            mean, deviation = (pixels.new_tensor(each)[:, None, None] for each in (MEAN, DEVIATION))
            with torch.autocast(self._device.type, torch.bfloat16, self._has_bfloat16):
                maps = self._network((pixels - mean) / deviation)
            maps = {name: each.float() for name, each in maps.items()}
            regions: Tensor = self._align(maps, [corners.to(self._device)], [image.shape[:2]])
            pooled = torch.cat([regions.mean((2, 3)), regions.amax((2, 3))], 1)
        result[inside] = pooled.half().cpu().numpy()
        return result


#: Turns the boxes, (N, 4), of a picture, (rows, columns, 3), into an array (N, *shape).
Extractor: TypeAlias = Crops | Backbone


def _fold_normalizations(network: nn.Module) -> None:
    """Replace each convolution before a frozen batch normalization by one that computes both."""
    from torchvision.ops import FrozenBatchNorm2d

    for (conv, first), (normalization, second) in pairwise(list(network.named_children())):
        if isinstance(first, nn.Conv2d) and isinstance(second, FrozenBatchNorm2d):
            setattr(network, conv, fuse_conv_bn_eval(first, second))
            setattr(network, normalization, nn.Identity())
    for child in network.children():
        _fold_normalizations(child)


def weights_file(weights: str | os.PathLike[str] | None) -> Path:
    """Return the file of the backbone's weights, by default one in torchvision's cache."""
    if weights is not None:
        return Path(checked_path("weights", weights))
    folder = Path(torch.hub.get_dir()) / "checkpoints"
    for name in WEIGHTS:
        if (folder / name).exists():
            return folder / name
    first, second, third = WEIGHTS
    raise FileNotFoundError(
        f"no weights of ResNet50 in torchvision's cache `{folder}`: name a file with `--weights` (in experiments "
        f"`weights`), or put `{first}`, `{second}` or `{third}` there"
    )


def weights_file_hash(path: Path) -> str:
    """Return the SHA-256 of a file of weights; that of a Keras model covers all its files."""
    return model_hash(path) if path.suffix == ".json" else file_hash(path)


def _state(path: Path) -> Mapping[str, Tensor]:
    state = read_tensors(path, "a file of weights")
    if not isinstance(state, Mapping) or not all(isinstance(name, str) for name in state):
        raise ValueError(f"{path} is not a file of weights: expected tensors by name")
    return state


def extractor(kind: Kind, weights: str | os.PathLike[str] | None = None, device: str = "cpu") -> Extractor:
    """Return the extractor of a kind. The other arguments are those of `Backbone`; crops ignore them."""
    return Backbone(weights, device) if kind == "resnet50" else Crops()


def compute_features(
    folder: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    *,
    kind: Kind = "crops",
    weights: str | os.PathLike[str] | None = None,
    device: str = "cpu",
    threads: int = 1,
    ray: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Compute the features of all boxes of a data set, and store them in one file per world.

    Finished worlds are kept, so an interrupted call can be resumed, and a data set can be extended. Worlds with damaged
    files are computed again. Files are the same on any number of threads and workers. Features of a backbone depend on
    the device and the version of PyTorch in their last bits.

    Args:
        folder: A data set with pictures.
        out: The folder to write, outside of the data set. By default, the name of the data set followed by `-` and the
            kind.
        kind: `"crops"` or `"resnet50"`.
        weights: As for `Backbone`.
        device: As for `Backbone`.
        threads: The number of threads, each of which works on one world. 0 means one per core.
        ray: The address of a Ray cluster whose workers compute the worlds, or `"local"`. All workers must see the
            folders and the file of weights.
        progress: A function that receives the number of finished worlds and the total.

    Returns:
        The folder with `features.json` and a file `world-00000.npy` per world: (E, *shape), the E entities of all
        samples of the world in their order. `world-00000.json` has its hashes.

    Raises:
        ConnectionError: If the Ray cluster does not answer, or loses too many workers.
        FileNotFoundError: If there are no weights.
        OSError: If a file cannot be read or written.
        ValueError: If the data set has no pictures, or one of its files has changed since it was made; if the output
            folder is in the data set, or has features of other data or of another backbone; if the kind is unknown, or
            crops are given weights or a device; or as for `Backbone`.
    """
    target = output_folder(folder, kind, out, weights, device)
    samples = VapDataset(folder, images=False)
    if not samples.has_pictures:
        raise ValueError(f"`{samples.folder}` has no pictures: make it without `--no-pictures`")
    threads = checked_threads(threads) or os.cpu_count() or 1
    extract = extractor(kind, weights, device)
    worlds = _worlds(samples)
    target.mkdir(parents=True, exist_ok=True)
    _begin(target, extract)
    left = [world for world in worlds if _unfinished(target, world, extract.identity, samples.folder)]
    done = len(worlds) - len(left)

    def advance() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, len(worlds))

    if ray is not None:
        data, out = samples.folder.resolve(), target.resolve()
        file = None if weights is None else Path(weights).resolve()

        def work(world: _World) -> None:
            torch.set_num_threads(1)
            _store(VapDataset(data), world, out, extractor(kind, file, device))

        _on_ray(ray, work, left, float(device.startswith("cuda")), advance)
        return target
    stopped = Event()
    torch_threads = torch.get_num_threads()
    # Each world has one thread. With several threads of PyTorch, features could differ in their last bits.
    torch.set_num_threads(1)
    try:
        with ThreadPoolExecutor(threads) as pool:
            jobs = [pool.submit(_store, samples, world, target, extract, stopped) for world in left]
            try:
                for job in as_completed(jobs):
                    job.result()
                    advance()
            finally:
                stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)
    finally:
        torch.set_num_threads(torch_threads)
    return target


def output_folder(
    folder: str | os.PathLike[str],
    kind: Kind,
    out: str | os.PathLike[str] | None = None,
    weights: str | os.PathLike[str] | None = None,
    device: str = "cpu",
) -> Path:
    """Check that the arguments of `compute_features` are consistent, and return the folder to write."""
    if kind not in ("crops", "resnet50"):
        raise ValueError(f"unknown kind of features `{kind}`; known: crops, resnet50")
    if kind == "crops" and weights is not None:
        raise ValueError("crops have no weights: remove `--weights`, or choose `--backbone resnet50`")
    if kind == "crops" and device != "cpu":
        raise ValueError("crops are cut on the CPU: remove `--device`, or choose `--backbone resnet50`")
    data = Path(checked_path("folder", folder))
    if out is None:
        # `.` and `..` are no names.
        return Path(f"{data if data.name not in ('', '..') else data.resolve()}-{kind}")
    target = Path(checked_path("out", out))
    if target.resolve().is_relative_to(data.resolve()):
        raise ValueError(f"`{target}` is in the data set, which must have no other files: choose another folder")
    return target


def load_features(folder: str | os.PathLike[str], samples: VapDataset) -> Tensor:
    """Read the stored features of the E entities of all samples in their order, (E, *shape): uint8, or float32.

    The folder is one that `compute_features` wrote. It may have more worlds than the data set.

    Raises:
        OSError: If a file cannot be read.
        ValueError: If the features are those of other data, damaged, or not complete.
    """
    target = Path(checked_path("folder", folder))
    document = _read(target)
    worlds = _worlds(samples)
    for world in worlds:
        if reason := _unfinished(target, world, document["extractor_hash"], samples.folder):
            raise ValueError(reason)
    return _stacked(target, worlds)


@dataclass(frozen=True)
class _World:
    """What a data set has of a world: the positions of its samples, and the SHA-256 of its files in the manifest."""

    number: int
    samples: range
    entities: int
    files: Mapping[str, str]

    @property
    def data_hash(self) -> str:
        return hashlib.sha256(json.dumps(self.files, sort_keys=True).encode()).hexdigest()


def _worlds(samples: VapDataset) -> list[_World]:
    worlds = []
    with reading_manifest(samples.folder / "manifest.json") as path:
        listed = {count_in(world, "world"): world for world in read_json(path)["worlds"]}
        for number, positions in samples.worlds().items():
            files = {name: str(file["sha256"]) for name, file in listed[number]["files"].items()}
            worlds.append(_World(number, positions, count_in(listed[number], "agents"), files))
    return worlds


def _unfinished(folder: Path, world: _World, identity: str, data: Path) -> str | None:
    """Return why the features of a world in a folder are missing or damaged, or `None` if they are complete.

    `identity` is that of the extractor. Raises `ValueError` if the features are those of other data.
    """
    path = _world_file(folder, world.number)
    record = _record(path)
    again = "run `logicity vap features` again with the same options, which computes only such worlds"
    if record is None or not path.exists():
        return (
            f"`{folder}` has no features of world {world.number} yet, or the world was added to `{data}` later: {again}"
        )
    if record["data_hash"] != world.data_hash or record["extractor_hash"] != identity:
        raise ValueError(
            f"`{path}` has the features of another data set or backbone, or world {world.number} of `{data}` has "
            f"changed since: run `logicity vap features {data}` with another folder"
        )
    if record["sha256"] != file_hash(path):
        return f"`{path}` is damaged: it differs from its SHA-256 in `{path.with_suffix('.json')}`: {again}"
    return None


def _world_file(folder: Path, world: int) -> Path:
    return folder / f"world-{world:05}.npy"


def _record(path: Path) -> dict[str, Any] | None:
    """Return the record of a file of features, or `None` if it is missing or damaged."""
    try:
        record = read_json(path.with_suffix(".json"))
    except (FileNotFoundError, ValueError):
        return None
    return record if isinstance(record, dict) and record.keys() == set(RECORD_KEYS) else None


def _mapped(path: Path) -> NDArray[Any]:
    """Map a file of features into memory. Raises `ValueError` if it is not a file of an array, or too short."""
    check_readable(path, whole=False)
    try:
        return np.lib.format.open_memmap(path, mode="r")
    except OSError:
        raise
    except Exception as error:
        # Depending on the bytes, numpy raises almost any exception.
        raise ValueError(f"`{path}` is not a file of features: {error}") from None


def _stacked(folder: Path, worlds: Sequence[_World]) -> Tensor:
    tensor = torch.from_numpy(np.concatenate([_mapped(_world_file(folder, world.number)) for world in worlds]))
    return tensor if tensor.dtype == torch.uint8 else tensor.float()


def _begin(target: Path, extract: Extractor) -> None:
    """Write `features.json`, or check that it describes the same features."""
    features = {"kind": extract.kind, "shape": list(extract.shape), "extractor_hash": extract.identity}
    path = target / "features.json"
    if not path.exists():
        write_json(path, {"format": FORMAT, **features}, by="vap features")
        return
    found = _read(target)
    for name, value in features.items():
        if found[name] != value:
            raise ValueError(f"`{target}` has features with another `{name}`: choose another folder")


def _read(folder: Path) -> dict[str, Any]:
    path = folder / "features.json"
    try:
        document = read_json(path)
    except ValueError as error:
        raise ValueError(f"{path}: not JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ValueError(
            f"{path}: expected features of the format {FORMAT}: run `logicity vap features` with another folder"
        )
    for name in ("kind", "shape", "extractor_hash"):
        if name not in document:
            raise ValueError(f"{path}: expected the key `{name}`")
    return document


def _store(samples: VapDataset, world: _World, target: Path, extract: Extractor, stopped: Event | None = None) -> None:
    """Compute and write the features of a world. Nothing is written after `stopped` is set."""
    picture = np.empty((PICTURE_SIDE, PICTURE_SIDE, 3), np.uint8)
    parts: list[NDArray[Any]] = []
    # The table has the boxes.
    _check_source(samples.folder / f"world-{world.number:05}" / "entities.parquet", world)
    for index in world.samples:
        if stopped is not None and stopped.is_set():
            return
        path = samples.picture_path(index)
        _check_source(path, world)
        samples.read_picture(index, picture)
        parts.append(extract(picture, samples.facts(index).boxes))
    file = _world_file(target, world.number)
    temporary = target / f".{file.stem}-{os.getpid()}.npy"
    np.save(temporary, np.concatenate(parts))
    record = {"sha256": file_hash(temporary), "data_hash": world.data_hash, "extractor_hash": extract.identity}
    temporary.replace(file)
    # The record comes last: features without one are not finished.
    temporary = temporary.with_suffix(".json")
    temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8", newline="\n")
    temporary.replace(file.with_suffix(".json"))


def _check_source(path: Path, world: _World) -> None:
    if world.files.get(path.name) != file_hash(path):
        raise ValueError(
            f"`{path}` has changed since it was made: remove the folder of the world and run `logicity vap make` again"
        )


def _on_ray(
    address: str, work: Callable[[_World], None], worlds: Sequence[_World], gpus: float, advance: Callable[[], None]
) -> None:
    """Compute worlds on Ray, each with a number of GPUs. If a worker is lost, its world is computed again."""
    from ..cluster import RETRIES, connect

    ray = connect(address)
    try:
        task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=RETRIES)(work)
        running = [task.remote(world) for world in worlds]
        while running:
            ready, running = ray.wait(running, num_returns=1)
            ray.get(ready)
            advance()
    except ray.exceptions.RayTaskError as error:
        raise error.cause or error from None
    except ray.exceptions.RayError as error:
        raise ConnectionError(f"--ray: {error}") from error
    finally:
        ray.shutdown()


@dataclass(frozen=True)
class DataSpec:
    """The arguments of `make_dataset` for a data set that an experiment makes, with those of `extractor`.

    The kind of features is `None` for tables only.
    """

    mode: Literal["easy", "hard"]
    split: Literal["train", "val", "test"]
    agents: Literal["fixed", "random"]
    worlds: int
    difficulty: int
    drawing_version: Literal[1, 2]
    seed: int
    kind: Kind | None
    weights: str | None = None

    @property
    def world_key(self) -> str:
        """What determines a world, as the beginning of names of folders."""
        # The boxes in the tables depend on the drawing, too.
        drawing = f"difficulty{self.difficulty}-drawing{self.drawing_version}"
        return f"{self.mode}-{self.agents}-{self.split}-seed{self.seed}-{drawing}"


def prepared(spec: DataSpec, root: Path, version: str) -> tuple[VapDataset, Tensor | None]:
    """Make the tables and features of a data set if they do not exist, and read them. No kind means no features.

    Pictures are made and removed world by world, as a set needs about 80 MB per world. Processes that need the same
    data wait for the one that makes it. Damaged files of features are made again. In the folder `root` for data sets,
    each version has its own folder. It is what determines the data, besides the arguments.
    """
    folder = root / hashlib.sha256(version.encode()).hexdigest()[:8]
    tables = folder / f"{spec.world_key}-{spec.worlds}"
    with _alone(folder / f"{tables.name}.lock"):
        samples = _made(tables, spec, 0, spec.worlds, images=False)
    if spec.kind is None:
        return samples, None
    extract = extractor(spec.kind, spec.weights)
    features = folder / f"{spec.world_key}-{extract.kind}-{extract.identity[:8]}"
    features.mkdir(exist_ok=True)
    worlds = _worlds(samples)
    for world in worlds:
        pictures = features / f"pictures-{world.number:05}"
        # Pictures beside their features are those of an interrupted process.
        if _readable(features, world, extract) and not pictures.exists():
            continue
        with _alone(folder / f"{features.name}.lock"):
            if not _readable(features, world, extract):
                made = _made(pictures, spec, world.number, 1, images=True)
                _store(made, _worlds(made)[0], features, extract)
            shutil.rmtree(pictures, ignore_errors=True)
    return samples, _stacked(features, worlds)


def _readable(folder: Path, world: _World, extract: Extractor) -> bool:
    """Return whether the features of a world have the right shape, type and checksum."""
    path = _world_file(folder, world.number)
    try:
        values = _mapped(path)
        whole = (record := _record(path)) is not None and record["sha256"] == file_hash(path)
    except (FileNotFoundError, ValueError):
        return False
    return whole and values.shape == (world.entities, *extract.shape) and values.dtype == extract.dtype


def _made(folder: Path, spec: DataSpec, first: int, worlds: int, *, images: bool) -> VapDataset:
    try:
        return make_dataset(
            folder,
            spec.mode,
            spec.split,
            agents=spec.agents,
            first_world=first,
            worlds=worlds,
            seed=spec.seed,
            images=images,
            drawing=Drawing(spec.difficulty, spec.drawing_version),
            threads=1,
        )
    except (FileExistsError, ValueError) as error:
        # The caller of an experiment cannot choose the folder.
        message = f"the data set `{folder}` is damaged: remove the folder, and run the experiment again"
        raise ValueError(f"{message}: {error}") from None


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold a lock file. Waits while another process holds it; a process that ends releases its locks."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "ab") as file:
        if sys.platform == "win32":
            import msvcrt

            file.seek(0)
            while True:
                # Each attempt waits ten seconds, then raises.
                with suppress(OSError):
                    msvcrt.locking(file.fileno(), msvcrt.LK_LOCK, 1)
                    break
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield
