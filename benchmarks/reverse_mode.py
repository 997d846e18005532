"""The slope of the scale's loss through autograd: what forward mode is compared with, by `scale_speed.py` and by the tests."""

from __future__ import annotations

import torch

from rtgs.scale import Objective


def loss_and_slope_in_reverse(objective: Objective, index: int, theta: float) -> tuple[float, float]:
    """Eq. 7 for one frame and its derivative by θ = ln s, through autograd, the renderer and the pose."""
    t = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
    picture = objective.gray(index, t)
    loss = objective.readable_target(index).to(picture.dtype)(picture)
    if not loss.requires_grad:
        return loss.item(), 0.0
    loss.backward()
    return loss.item(), t.grad.item() if t.grad is not None else 0.0
