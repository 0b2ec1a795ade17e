"""Training curves for TensorBoard."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import extra

__all__ = ["Curves"]


class Curves:
    """Training curves for TensorBoard: means over intervals of steps. Without a folder, nothing is written.

    A learner creates its curves anew when a run resumes. The first mean is then over the steps since the resume.

    Raises:
        ImportError: If there is a folder, and TensorBoard is not installed.
    """

    #: The number of steps between two points, for `due`.
    INTERVAL = 1000

    def __init__(self, log: Path | None) -> None:
        """Store the folder."""
        self._open: Callable[..., Any] | None = None
        if log is not None:
            with extra("learn"):
                from torch.utils.tensorboard.writer import SummaryWriter
            self._open = partial(SummaryWriter, os.fspath(log))
        self._writer: Any = None
        self._sums: dict[str, tuple[float, int]] = {}
        self._written = 0

    def add(self, values: Mapping[str, float]) -> None:
        """Add values to the means of the current interval."""
        for name, value in values.items():
            total, count = self._sums.get(name, (0.0, 0))
            self._sums[name] = total + float(value), count + 1

    def due(self, steps: int) -> bool:
        """Return whether the interval has ended."""
        return steps // self.INTERVAL > self._written // self.INTERVAL

    def write(self, steps: int) -> None:
        """Write the means of the interval, and begin the next one."""
        if self._open is not None:
            if self._writer is None:
                # Points that an interrupted run wrote after its last checkpoint disappear.
                self._writer = self._open(purge_step=steps)
            for name, (total, count) in self._sums.items():
                self._writer.add_scalar(name, total / count, steps)
        self.begin(steps)

    def begin(self, steps: int) -> None:
        """Begin an interval."""
        self._sums.clear()
        self._written = steps

    def close(self) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None
