"""Baseline predictors of actions: the majority action, a graph network on the facts, and the rules."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..city import ACTIONS, Inference
from ..errors import checked_integer
from ..evaluation import Progress
from ..types import SymbolicScene
from .data import VapDataset, symbolic_facts
from .metrics import VapMetrics, vap_metrics

__all__ = ["BaselineResult", "baseline_table", "measure_baselines", "rule_actions"]


@dataclass(frozen=True)
class BaselineResult:
    """The measures of a predictor. `name` is `"majority"`, `"network"` or `"rules"`."""

    name: str
    mode: str
    metrics: VapMetrics

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary for JSON."""
        return asdict(self)


def measure_baselines(
    train: str | os.PathLike[str], test: str | os.PathLike[str], seed: int = 0, epochs: int = 30
) -> list[BaselineResult]:
    """Measure three predictors on a data set. They do not use pictures.

    - `majority` predicts the most frequent action of `train`.
    - `network` is a graph network (`GraphReasoner`, 64 features), trained on the facts of `train`.
    - `rules` predicts the action that the rules derive from the facts, which is always correct in a valid data set.

    The tensors of both data sets are in memory at once. Each sample is padded to the number N of entities in the
    largest sample, and takes 35 N² + 121 N + 16 bytes.

    Args:
        train: The folder of the data set to train on.
        test: The folder of the data set to measure on, of the same mode.
        seed: The seed of the network's weights and of the sample order.
        epochs: The number of epochs, at least 1.

    Returns:
        The results of `majority`, `network` and `rules`.

    Raises:
        ImportError: If PyTorch is not installed. The extra `vap` installs it: `pip install 'logicity[vap]'`.
        OSError: If a file cannot be read.
        ValueError: As for `VapDataset`, or if a data set has no cars, the modes differ, the seed is out of range, or
            the number of epochs is below 1.
    """
    seed, epochs = checked_integer("seed", seed), checked_integer("epochs", epochs, 1)
    # Import PyTorch before reading the data sets, to fail early if it is missing.
    from .training import train_on_facts

    train_set, test_set = VapDataset(train, images=False), VapDataset(test, images=False)
    if train_set.mode != test_set.mode:
        raise ValueError(
            f"the modes differ: `{train_set.folder}` is {train_set.mode}, `{test_set.folder}` is {test_set.mode}"
        )
    train_labels, labels = _labels(train_set), _labels(test_set)
    frames = np.repeat(np.arange(len(test_set)), [int(sample.mask.sum()) for sample in test_set])
    majority = np.bincount(train_labels, minlength=len(ACTIONS)).argmax()
    with Progress("epoch", epochs) as progress:
        learned = train_on_facts(train_set, test_set, seed, epochs, progress.update)
    predictions = {"majority": np.full_like(labels, majority), "network": learned, "rules": rule_actions(test_set)}
    measured = {name: vap_metrics(labels, predicted, frames) for name, predicted in predictions.items()}
    return [BaselineResult(name, test_set.mode, metrics) for name, metrics in measured.items()]


def _labels(samples: VapDataset) -> NDArray[np.int64]:
    """Return the labels of all cars in all samples. Raises `ValueError` if there are none."""
    labels = [sample.actions[sample.mask] for sample in samples]
    if not any(map(len, labels)):
        raise ValueError(f"`{samples.folder}` has no cars")
    return np.concatenate(labels)


def rule_actions(samples: VapDataset) -> NDArray[np.int64]:
    """Return the action that the rules derive from the facts for each car in all samples."""
    inference = Inference(f"configs/vap-{samples.mode}.yaml")
    derived: list[int] = []
    with Progress("sample", len(samples)) as progress:
        for done, sample in enumerate(samples, 1):
            facts = symbolic_facts(sample.names, sample.unary, sample.binary, sample.sees)
            for car in np.flatnonzero(sample.mask):
                ego = sample.names[car]
                scene: SymbolicScene = {"entities": list(sample.names), "ego": ego, "facts": facts}
                derived.append(ACTIONS.index(inference.answer(scene)["egos"][ego]["action"]))
            progress.update(done)
    return np.array(derived, np.int64)


def baseline_table(results: Sequence[BaselineResult]) -> str:
    """Format a Markdown table, with a dash for actions that do not occur."""
    head = ["mode", "predictor", *(f"recall {action}" for action in ACTIONS), "aAcc", "wAcc"]
    rows = [
        [
            result.mode,
            result.name,
            *(f"{recall[action]:.3f}" if action in recall else "—" for action in ACTIONS),
            f"{result.metrics.a_acc:.3f}",
            f"{result.metrics.w_acc:.3f}",
        ]
        for result in results
        for recall in [result.metrics.recall]
    ]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])
