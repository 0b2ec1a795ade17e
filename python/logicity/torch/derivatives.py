"""Backward passes that have no derivative themselves."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from ..errors import extra

with extra("learn"):
    import torch

__all__ = ["once"]


def once(backward: Callable[..., Any]) -> Callable[..., Any]:
    """Refuse second derivatives, which PyTorch would take as 0."""

    @wraps(backward)
    def checked(ctx: Any, *gradients: Any) -> Any:
        if torch.is_grad_enabled():
            raise RuntimeError("RuleLayer has no second derivatives: omit `create_graph=True`")
        return backward(ctx, *gradients)

    return checked
