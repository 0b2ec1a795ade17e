"""Measure how the difficulty of pictures affects the recognition of concepts.

For each difficulty, two classifiers learn the class of an agent (its concepts, or its type if it has none) on worlds of
the training split. The first sees the width and height of its box and its heading. The second is a small convolutional
network that sees the box of the picture, scaled to 48 x 48 pixels. The table shows their recall on worlds of the test
split, averaged over the classes, and the recall of guessing, 1 / the number of classes.

    python python/benches/vap_difficulty.py /tmp/vap-difficulty
    python python/benches/vap_difficulty.py /tmp/vap-difficulty --difficulties 100 --train-worlds 30

The folder keeps the data sets, so a second run starts at once. The network needs PyTorch.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from logicity.vap import VapDataset, make_dataset

#: The side of a crop, in pixels.
SIDE = 48


@dataclass(frozen=True)
class Agents:
    """Agents of some frames.

    Attributes:
        classes: The class of each agent.
        boxes: float32 (N, 6): width and height of the box in pixels divided by 100, and the one-hot heading.
        crops: uint8 (N, 3, 48, 48), or empty if pictures are not read.
    """

    classes: list[str]
    boxes: NDArray[np.float32]
    crops: NDArray[np.uint8]


def read(folder: Path, every: int, pictures: bool) -> Agents:
    """Read the agents of every `every`-th frame."""
    samples = VapDataset(folder, images=pictures)
    classes: list[str] = []
    boxes, crops = [], []
    for index in range(0, len(samples), every):
        sample = samples[index]
        image = None if sample.image is None else torch.from_numpy(sample.image).permute(2, 0, 1).float()
        for agent, (left, top, width, height) in enumerate(sample.boxes):
            if np.isnan(left):
                continue
            classes.append(sample.concepts[agent] or sample.names[agent].split("_")[0])
            boxes.append([width / 100, height / 100, *sample.h[agent, 4:8]])
            if image is not None:
                rows, cols = slice(int(top), int(top + height)), slice(int(left), int(left + width))
                crop = nn.functional.interpolate(
                    image[None, :, rows, cols], size=(SIDE, SIDE), mode="bilinear", antialias=True
                )
                crops.append(crop[0].round().clamp(0, 255).byte().numpy())
    empty = np.empty((0, 3, SIDE, SIDE), np.uint8)
    return Agents(classes, np.array(boxes, np.float32), np.stack(crops) if crops else empty)


def network(count: int) -> nn.Module:
    """Return a network of six convolutions."""
    layers: list[nn.Module] = []
    channels = 3
    for wide, pool in ((16, True), (32, False), (32, True), (64, False), (64, True), (96, True)):
        layers += [nn.Conv2d(channels, wide, 3, padding=1), nn.BatchNorm2d(wide), nn.ReLU()]
        layers += [nn.MaxPool2d(2)] if pool else []
        channels = wide
    return nn.Sequential(*layers, nn.Flatten(), nn.Dropout(0.3), nn.Linear(channels * 3 * 3, count))


def perceptron(count: int) -> nn.Module:
    """Return a network for boxes and headings."""
    return nn.Sequential(nn.Linear(6, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, count))


def as_input(values: NDArray[np.uint8] | NDArray[np.float32]) -> Tensor:
    """Return a batch for a network."""
    tensor = torch.from_numpy(values)
    return tensor if tensor.dtype == torch.float32 else tensor.float() / 127.5 - 1


def recalls(
    model: nn.Module,
    train: tuple[NDArray[np.uint8] | NDArray[np.float32], NDArray[np.int64]],
    test: tuple[NDArray[np.uint8] | NDArray[np.float32], NDArray[np.int64]],
    epochs: int,
    seed: int,
) -> NDArray[np.float64]:
    """Train a network with classes of equal weight. Return the recall of each class on the test agents."""
    inputs, labels = train
    count = int(labels.max()) + 1
    weight = torch.from_numpy(1 / np.maximum(np.bincount(labels, minlength=count), 1)).float()
    loss_of = nn.CrossEntropyLoss(weight=weight / weight.mean(), label_smoothing=0.05)
    steps = epochs * (-(-len(labels) // 128))
    optimizer = torch.optim.AdamW(model.parameters(), lr=3e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=steps)
    random = np.random.default_rng(seed)
    targets = torch.from_numpy(labels)
    model.train()
    for _ in range(epochs):
        order = random.permutation(len(labels))
        for batch in np.array_split(order, -(-len(order) // 128)):
            loss = loss_of(model(as_input(inputs[batch])), targets[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    model.eval()
    with torch.no_grad():
        parts = [model(as_input(part)).argmax(1).numpy() for part in np.array_split(test[0], -(-len(test[0]) // 512))]
    found = np.concatenate(parts)
    return np.array([(found[test[1] == label] == label).mean() for label in range(count)])


def main() -> None:
    """Print one line per difficulty."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder for the data sets")
    parser.add_argument("--difficulties", type=int, nargs="+", default=[0, 25, 50, 75, 100])
    parser.add_argument("--drawing-version", type=int, choices=(1, 2), default=2)
    parser.add_argument("--mode", choices=("easy", "hard"), default="easy")
    parser.add_argument("--train-worlds", type=int, default=30)
    parser.add_argument("--test-worlds", type=int, default=10)
    parser.add_argument("--every", type=int, default=3, help="use every n-th frame")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-pictures", action="store_true", help="measure boxes only")
    parser.add_argument("--json", action="store_true", help="print one JSON object per difficulty")
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    pictures = not options.no_pictures
    for difficulty in options.difficulties:
        begin = time.perf_counter()
        parts = {}
        for split, worlds in (("train", options.train_worlds), ("test", options.test_worlds)):
            name = f"{options.mode}-{options.drawing_version}-{difficulty:03}-{split}{'' if pictures else '-tables'}"
            folder = options.folder / name
            if not (folder / "manifest.json").exists():
                make_dataset(
                    folder,
                    options.mode,
                    split,
                    agents="random",
                    worlds=worlds,
                    seed=options.seed,
                    images=pictures,
                    difficulty=difficulty,
                    drawing_version=options.drawing_version,
                )
            parts[split] = read(folder, options.every, pictures)
        names = sorted(set(parts["train"].classes))
        label = {name: number for number, name in enumerate(names)}
        labels = {split: np.array([label[name] for name in part.classes]) for split, part in parts.items()}
        rows = {}
        boxes = [(parts[split].boxes, labels[split]) for split in ("train", "test")]
        rows["boxes"] = recalls(perceptron(len(names)), boxes[0], boxes[1], 4 * options.epochs, options.seed)
        if pictures:
            crops = [(parts[split].crops, labels[split]) for split in ("train", "test")]
            rows["pixels"] = recalls(network(len(names)), crops[0], crops[1], options.epochs, options.seed)
        seconds = time.perf_counter() - begin
        if options.json:
            by_class = {row: dict(zip(names, values.round(3).tolist(), strict=True)) for row, values in rows.items()}
            counts = {split: len(part.classes) for split, part in parts.items()}
            means = {row: round(float(values.mean()), 3) for row, values in rows.items()}
            print(
                json.dumps({"difficulty": difficulty, "mean": means, "recall": by_class, "agents": counts}), flush=True
            )
            continue
        print(f"difficulty {difficulty}, guessing {1 / len(names):.3f}, {seconds:.0f} s", flush=True)
        for row, values in rows.items():
            each = ", ".join(f"{name} {value:.2f}" for name, value in zip(names, values, strict=True))
            print(f"  {row:<6} {values.mean():.3f}  {each}", flush=True)


if __name__ == "__main__":
    main()
