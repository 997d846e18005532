"""What a backward pass leaves at a tensor."""

from __future__ import annotations

from torch import Tensor


def gradient_of(leaf: Tensor) -> Tensor:
    """The gradient that was left at `leaf`; fails where there is none."""
    assert leaf.grad is not None, "no gradient has reached this tensor"
    return leaf.grad
