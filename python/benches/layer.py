"""Measure rules as a layer: `python python/benches/layer.py [RULES] [--scenes N] [--seconds S]`.

Each figure is the scenes per second of a forward and backward pass over random degrees of 12 entities: per CPU second
on one core, and on a GPU if there is one, in larger batches. Building the inputs does not count. For `exact` and
`top-k`, which the engine computes on the CPU, ten facts of a scene are uncertain and the others are certain; after the
first pass, the diagrams of `exact` are known.
"""

from __future__ import annotations

import argparse
import time
from typing import get_args

import torch
from torch import Tensor

from logicity.torch import RuleLayer, Semantics

#: The number of entities of a scene.
ENTITIES = 12

#: The number of uncertain facts of a scene where not all are, and of scenes in a batch there.
UNCERTAIN, FEW = 10, 256

#: The number of scenes in a batch by device, unless the caller chooses it.
SCENES = {"cpu": 4096, "cuda": 1 << 18}


def with_doubts(unary: Tensor, binary: Tensor) -> tuple[Tensor, Tensor]:
    """Return facts of which `UNCERTAIN` of each scene keep their probability; a fifth of the others hold."""
    flat = torch.cat([unary.flatten(1), binary.flatten(1)], 1)
    certain = (flat < 0.2).to(flat)
    places = torch.rand(flat.shape, generator=torch.Generator().manual_seed(1)).topk(UNCERTAIN).indices
    certain.scatter_(1, places, flat.gather(1, places).clamp(0.05, 0.95))
    first, second = certain.split([unary[0].numel(), binary[0].numel()], 1)
    return first.reshape(unary.shape), second.reshape(binary.shape)


def speed(layer: RuleLayer, scenes: int, egos: list[int] | None, seconds: float, device: str) -> float:
    """Return the scenes per second of a forward and backward pass, on the CPU per CPU second."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    generator = torch.Generator().manual_seed(0)
    layer = layer.to(device)
    unary = torch.rand(scenes, ENTITIES, len(layer.unary), generator=generator)
    binary = torch.rand(scenes, ENTITIES, ENTITIES, len(layer.binary), generator=generator)
    if layer.semantics in ("exact", "top-k"):
        unary, binary = with_doubts(unary, binary)
    unary, binary = unary.to(device).requires_grad_(), binary.to(device).requires_grad_()
    mask = torch.ones(scenes, ENTITIES, device=device)

    def step() -> None:
        unary.grad = binary.grad = None
        layer(unary, binary, mask, egos).sum().backward()
        if device != "cpu":
            torch.cuda.synchronize()

    step()
    passes, begun = 0, clock()
    while clock() - begun < seconds:
        step()
        passes += 1
    return scenes * passes / (clock() - begun)


def main() -> None:
    """Print a line for each semantics."""
    parser = argparse.ArgumentParser(description="Measure rules as a layer.")
    parser.add_argument("rules", nargs="?", default="rules/expert.dl")
    parser.add_argument("--scenes", type=int, help="scenes in a batch; default: 4096, on a GPU 262144")
    parser.add_argument("--seconds", type=float, default=3.0, help="duration of each measurement")
    given = parser.parse_args()
    torch.set_num_threads(1)
    if torch.cuda.is_available():
        print(f"cuda: {torch.cuda.get_device_name()}")
    for device in ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]:
        for semantics in get_args(Semantics):
            layer = RuleLayer(given.rules, semantics)
            by_engine = semantics in ("exact", "top-k")
            if by_engine and device != "cpu":
                continue
            scenes = given.scenes or SCENES[device]
            scenes = min(scenes, FEW) if by_engine else scenes
            one, all_ = (speed(layer, scenes, egos, given.seconds, device) for egos in ([0], None))
            found = f"{one:,.0f} scenes per second for one ego, {all_:,.0f} for all entities"
            print(f"{device} {semantics}, {scenes} scenes at once: {found}")


if __name__ == "__main__":
    main()
