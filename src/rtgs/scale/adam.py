"""The paper's solver."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import torch

from rtgs.config import ScaleConfig
from rtgs.scale.records import History


class Descendable(Protocol):
    """Per-frame losses with their slopes by θ."""

    @property
    def frames(self) -> Sequence[Any]: ...

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]: ...


def adam(
    objective: Descendable, theta: float, config: ScaleConfig, counter: Callable[[str], None] | None = None
) -> tuple[float, History]:
    """The paper's solver: Adam on θ = ln s (Eq. 8), over all frames or a random mini-batch a step.

    Returns:
        θ after the last step, and the history.
    """
    parameter = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([parameter], lr=config.learning_rate)
    generator = torch.Generator().manual_seed(config.seed)
    n = len(objective.frames)
    batch = n if config.batch is None else min(config.batch, n)
    history = History([], [], [], [])
    for _ in range(config.steps):
        indices = range(n) if batch == n else torch.randperm(n, generator=generator)[:batch].tolist()
        losses, slopes = [], []
        for i in indices:
            loss, slope = objective.loss_and_slope(i, parameter.item())
            losses.append(loss)
            slopes.append(slope)
            if counter is not None:
                counter(f"s = {math.exp(parameter.item()):.5g}")
        history.add(parameter.item(), float(np.mean(losses)), float(np.mean(slopes)))
        parameter.grad = torch.tensor(history.slope[-1], dtype=torch.float64)
        optimizer.step()
    return parameter.item(), history
