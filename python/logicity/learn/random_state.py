"""The global random generators of Python, numpy and PyTorch."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

__all__ = ["get", "keep", "put"]


def get() -> dict[str, Any]:
    """Return the states of the generators as plain data."""
    name, keys, *rest = np.random.get_state(legacy=True)
    numpy = (name, torch.from_numpy(np.asarray(keys, np.int64)), *rest)
    return {"python": random.getstate(), "numpy": numpy, "torch": torch.get_rng_state()}


def put(state: dict[str, Any]) -> None:
    """Set the states that `get` returned."""
    random.setstate(state["python"])
    name, keys, *rest = state["numpy"]
    np.random.set_state((name, keys.numpy().astype(np.uint32), *rest))
    torch.set_rng_state(state["torch"])


@contextmanager
def keep() -> Iterator[None]:
    """Restore the states at the end of a block."""
    state = get()
    try:
        yield
    finally:
        put(state)
