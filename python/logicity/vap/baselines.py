"""What simple predictors of actions reach: the most frequent action, a small network on the facts, and the rules."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..city import ACTIONS, Inference
from ..evaluation import Progress
from ..types import SymbolicScene
from .data import BINARY, UNARY, VapDataset, VapSample
from .metrics import VapMetrics, vap_metrics

__all__ = ["BaselineResult", "baseline_table", "measure_baselines", "rule_actions"]


@dataclass(frozen=True)
class BaselineResult:
    """How good a predictor is. `name` is `"majority"`, `"network"` or `"rules"`."""

    name: str
    mode: str
    metrics: VapMetrics

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as they are written to JSON."""
        return asdict(self)


def measure_baselines(
    train: str | os.PathLike[str], test: str | os.PathLike[str], seed: int = 0, epochs: int = 30
) -> list[BaselineResult]:
    """Measure three predictors on a data set; pictures are not needed.

    - `majority` says of every car what the rules want of most cars of `train`;
    - `network` learns on `train`, from what is true, two rounds of messages between entities that see each other;
    - `rules` is what the rules derive from what is true, and right always.

    The tensors of both data sets are in memory at once, and while a set is read, its samples beside them: padded to
    the N entities of its largest sample, one takes 7 N² + 73 N + 16 bytes.

    Args:
        train: the folder of the data set to learn on.
        test: that of the data set to measure on, of the same mode.
        seed: of the network's weights and the order of samples.
        epochs: how often the network sees every sample.

    Raises:
        ImportError: PyTorch is not installed; the extra `vap` has it: `pip install './python[vap]'`.
        OSError: a file cannot be read.
        ValueError: as `VapDataset`, no cars in a data set, data sets of different modes, or a negative number of
            epochs.
    """
    # Told at once if it is missing.
    from .network import train_network

    known, asked = VapDataset(train, images=False), VapDataset(test, images=False)
    if known.mode != asked.mode:
        raise ValueError(f"`{known.folder}` is of {known.mode} mode, `{asked.folder}` of {asked.mode} mode")
    if epochs < 0:
        raise ValueError(f"{epochs} epochs")
    train_labels, labels = _labels(known), _labels(asked)
    frames = np.repeat(np.arange(len(asked)), [int(sample.mask.sum()) for sample in asked])
    majority = np.bincount(train_labels, minlength=len(ACTIONS)).argmax()
    with Progress("epoch", epochs) as progress:
        learned = train_network(known, asked, seed, epochs, progress.tell)
    predictions = {"majority": np.full_like(labels, majority), "network": learned, "rules": rule_actions(asked)}
    return [
        BaselineResult(name, asked.mode, vap_metrics(labels, predicted, frames))
        for name, predicted in predictions.items()
    ]


def _labels(samples: VapDataset) -> NDArray[np.int64]:
    """What the rules want of the cars of all samples, one after the other; there is a car."""
    labels = [sample.actions[sample.mask] for sample in samples]
    if not any(map(len, labels)):
        raise ValueError(f"`{samples.folder}` has no cars")
    return np.concatenate(labels)


def rule_actions(samples: VapDataset) -> NDArray[np.int64]:
    """What the rules derive from what is true."""
    inference = Inference(f"configs/vap-{samples.mode}.yaml")
    derived: list[int] = []
    with Progress("sample", len(samples)) as progress:
        for done, sample in enumerate(samples, 1):
            facts = _facts(sample)
            for car in np.flatnonzero(sample.mask):
                ego = sample.names[car]
                scene: SymbolicScene = {"entities": list(sample.names), "ego": ego, "facts": facts}
                derived.append(ACTIONS.index(inference.answer(scene)["egos"][ego]["action"]))
            progress.tell(done)
    return np.array(derived, np.int64)


def _facts(sample: VapSample) -> dict[str, list[Any]]:
    """What is true of a sample, as scenes have it."""
    names = sample.names
    facts: dict[str, list[Any]] = {
        predicate: [names[entity] for entity in np.flatnonzero(holds)]
        for predicate, holds in zip(UNARY, sample.unary.T, strict=True)
    }
    matrices = [*np.moveaxis(sample.binary, -1, 0), sample.sees]
    for predicate, holds in zip((*BINARY, "Sees"), matrices, strict=True):
        facts[predicate] = [[names[first], names[second]] for first, second in np.argwhere(holds)]
    return facts


def baseline_table(results: Sequence[BaselineResult]) -> str:
    """A table in Markdown; a dash for actions that do not occur."""
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
