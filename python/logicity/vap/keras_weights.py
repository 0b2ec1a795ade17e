"""Read the ResNet50 of Keras from a layers model of TensorFlow.js, with the names and the scale of torchvision.

Such a model is a file `model.json`, which names the files beside it that contain the weights. The network of Keras
differs from that of torchvision in four ways:

- Its channels are blue, green and red, in the range 0 to 255 minus their means, and are not divided by a standard
  deviation.
- Its convolutions have biases. A bias moves into the mean of the normalization that follows.
- Its normalizations add another epsilon to the variances. The difference moves into the variances.
- The stride of a stage lies in its first convolution (1 x 1), as in the network of He et al. (2016), while
  torchvision's lies in the second (3 x 3).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..errors import extra
from ..files import check_readable, file_hash, read_json

with extra("vap"):
    import torch
    from torch import Tensor, nn

__all__ = ["model_hash", "read_resnet50", "stride_first"]

#: The numbers of blocks in the stages of ResNet50.
BLOCKS: Final = (3, 4, 6, 3)

#: The epsilon of torchvision's normalizations.
EPSILON: Final = 1e-5

#: The mean and the standard deviation of the channels of ImageNet in the range 0 to 1, with which torchvision's
#: networks are trained.
MEAN: Final = (0.485, 0.456, 0.406)
DEVIATION: Final = (0.229, 0.224, 0.225)


def model_hash(path: Path) -> str:
    """Return the SHA-256 of the hashes of `model.json` and of the files that it names."""
    files = [path, *_shards(path, _document(path))]
    return hashlib.sha256("\n".join(map(file_hash, files)).encode()).hexdigest()


def read_resnet50(path: Path) -> dict[str, Tensor]:
    """Return the weights of a ResNet50, without its classifier, by their names in torchvision.

    The input is what torchvision expects: red, green and blue on a scale to 1, minus the means and divided by the
    standard deviations of ImageNet.

    Raises:
        OSError: If a file cannot be read.
        ValueError: If the file is not a ResNet50 of Keras.
    """
    document = _document(path)
    weights = _Weights(path, document)
    state: dict[str, NDArray[Any]] = {}
    for layer, normalization, conv, batch in _layers():
        kernel, bias = weights.take(f"{layer}/kernel", 4), weights.take(f"{layer}/bias", 1)
        state[f"{conv}.weight"] = kernel.transpose(3, 2, 0, 1)
        state[f"{batch}.weight"] = weights.take(f"{normalization}/gamma", 1)
        state[f"{batch}.bias"] = weights.take(f"{normalization}/beta", 1)
        state[f"{batch}.running_mean"] = weights.take(f"{normalization}/moving_mean", 1) - bias
        variance = weights.take(f"{normalization}/moving_variance", 1)
        state[f"{batch}.running_var"] = variance + (weights.epsilon(normalization) - EPSILON)
    scale = 255 * np.array(DEVIATION)
    state["conv1.weight"] = state["conv1.weight"][:, ::-1] * scale[:, None, None]
    return {name: torch.from_numpy(np.ascontiguousarray(each, np.float32)) for name, each in state.items()}


def stride_first(network: nn.Module) -> None:
    """Move the stride of each stage of a ResNet50 of torchvision from the second convolution to the first."""
    for number in (2, 3, 4):
        block: Any = network.get_submodule(f"layer{number}.0")
        block.conv1.stride, block.conv2.stride = block.conv2.stride, block.conv1.stride


def _layers() -> Iterator[tuple[str, str, str, str]]:
    """Yield the names of each convolution and its normalization: those of Keras, then those of torchvision."""
    yield "conv1", "bn_conv1", "conv1", "bn1"
    for stage, blocks in enumerate(BLOCKS, 1):
        for block in range(blocks):
            keras, torch_name = f"{stage + 1}{'abcdef'[block]}_branch", f"layer{stage}.{block}"
            if block == 0:
                yield f"res{keras}1", f"bn{keras}1", f"{torch_name}.downsample.0", f"{torch_name}.downsample.1"
            for number, letter in enumerate("abc", 1):
                names = f"{torch_name}.conv{number}", f"{torch_name}.bn{number}"
                yield f"res{keras}2{letter}", f"bn{keras}2{letter}", *names


class _Weights:
    """The weights of a model by their names, and the settings of its layers."""

    def __init__(self, path: Path, document: Mapping[str, Any]) -> None:
        """Read the files of weights."""
        self._path = path
        layers = document["modelTopology"]["model_config"]["config"]["layers"]
        self._layers = {layer["name"]: layer["config"] for layer in layers}
        self._values: dict[str, NDArray[np.float32]] = {}
        for group in document["weightsManifest"]:
            content = np.concatenate([np.fromfile(file, "<f4") for file in _group(path, group)])
            end = 0
            for weight in group["weights"]:
                name, shape = weight["name"], tuple(weight["shape"])
                if weight["dtype"] != "float32" or "quantization" in weight:
                    raise ValueError(f"{path}: `{name}` is not stored as float32: use a model that is not quantized")
                begin, end = end, end + int(np.prod(shape))
                if end > len(content):
                    raise ValueError(f"{path}: the files of weights end before `{name}`: extract the model again")
                self._values[name] = content[begin:end].reshape(shape)

    def take(self, name: str, dimensions: int) -> NDArray[np.float64]:
        value = self._values.get(name)
        if value is None or value.ndim != dimensions:
            raise ValueError(f"{self._path}: not a ResNet50 of Keras: no weight `{name}` of {dimensions} dimensions")
        return value.astype(np.float64)

    def epsilon(self, layer: str) -> float:
        try:
            return float(self._layers[layer]["epsilon"])
        except (KeyError, TypeError, ValueError):
            raise ValueError(f"{self._path}: not a ResNet50 of Keras: no layer `{layer}` with an epsilon") from None


def _document(path: Path) -> Mapping[str, Any]:
    """Read `model.json`. Raise `ValueError` if it is not a layers model."""
    check_readable(path)
    try:
        document: Mapping[str, Any] = read_json(path)
        layers = document["modelTopology"]["model_config"]["config"]["layers"]
        named = all(isinstance(layer["name"], str) and isinstance(layer["config"], dict) for layer in layers)
        groups = document["weightsManifest"]
        weights = [weight for group in groups for weight in group["weights"]]
        known = all({"name", "shape", "dtype"} <= weight.keys() for weight in weights)
        paths = [each for group in groups for each in group["paths"]]
        plain = all(isinstance(each, str) and Path(each).name == each for each in paths)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is not a layers model of TensorFlow.js: {error!r}") from None
    if not (named and known and plain):
        what = "a layer without a name, a weight without a shape, or a file in another folder"
        raise ValueError(f"{path} is not a layers model of TensorFlow.js: it has {what}")
    return document


def _shards(path: Path, document: Mapping[str, Any]) -> list[Path]:
    return [file for group in document["weightsManifest"] for file in _group(path, group)]


def _group(path: Path, group: Mapping[str, Any]) -> list[Path]:
    return [path.parent / name for name in group["paths"]]
