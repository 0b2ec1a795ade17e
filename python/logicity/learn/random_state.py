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
    """Return the states of the generators, which can be pickled."""
    return {"python": random.getstate(), "numpy": np.random.get_state(), "torch": torch.get_rng_state()}


def put(state: dict[str, Any]) -> None:
    """Set the states that `get` returned."""
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])


@contextmanager
def keep() -> Iterator[None]:
    """Restore the states at the end of a block."""
    state = get()
    try:
        yield
    finally:
        put(state)
