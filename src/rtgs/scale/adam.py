"""The paper's solver: Adam on θ = ln s (Eq. 8)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch

from rtgs.config import PAPER_EPSILON, ScaleConfig
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.scale.curves import LocalCurves, Window, widened
from rtgs.scale.objective import Objective
from rtgs.scale.problem import Found, Problem
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import History, Scan, Step
from rtgs.scale.scan import losses_over
from rtgs.scale.verdict import at_an_end, outside


class Descendable(Protocol):
    """Per-frame losses with their slopes by θ."""

    @property
    def frames(self) -> Sequence[Any]: ...

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]: ...


@dataclass(frozen=True)
class AdamPath:
    """Where Adam went: θ after the last step, its steps, and how many losses with their slopes that took."""

    theta: float
    history: History
    evaluations: int


def descend_by_adam(
    objective: Descendable, theta: float, config: ScaleConfig, progress: RenderProgress | None = None
) -> AdamPath:
    """`ScaleConfig.steps` steps of Adam from θ, each over all frames or a random mini-batch (`ScaleConfig.batch`).

    Args:
        progress: counts one picture for every evaluation.
    """
    parameter = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([parameter], lr=config.learning_rate)
    generator = torch.Generator().manual_seed(config.seed)
    n = len(objective.frames)
    batch = n if config.batch is None else min(config.batch, n)
    steps: list[Step] = []
    for _ in range(config.steps):
        at, found = parameter.item(), []
        for i in range(n) if batch == n else torch.randperm(n, generator=generator)[:batch].tolist():
            found.append(objective.loss_and_slope(i, at))
            if progress is not None:
                progress(f"s = {math.exp(at):.5g}")
        loss, slope = (float(np.mean(values)) for values in zip(*found, strict=True))
        steps.append(Step(at, loss, slope))
        parameter.grad = torch.tensor(slope, dtype=torch.float64)
        optimizer.step()
    return AdamPath(parameter.item(), History.of(steps), batch * len(steps))


@dataclass(frozen=True)
class Adam:
    """The paper's objective and solver. Without a start it begins at the minimum of a scan of the same loss over the bracket."""

    def solve(self, problem: Problem) -> Found:
        """Scan where there is no start, take the steps, and draw the curves of all frames around the last one."""
        config, bracket, frames, progress = problem.config, problem.bracket, problem.frames, problem.progress
        epsilon = PAPER_EPSILON if config.epsilon is None else config.epsilon
        objective = Objective(problem.scene, problem.model, frames, EdgeLoss(config.level_weights, epsilon))
        every = range(len(frames))
        batch = len(frames) if config.batch is None else min(config.batch, len(frames))
        scanned = config.scan_samples if config.init is None else 0
        progress.plan(scanned * len(frames) + config.steps * batch + 6 * len(frames))
        scan, doubt, init = None, "", config.init
        if init is None:
            thetas = np.linspace(math.log(bracket.lower), math.log(bracket.upper), config.scan_samples)
            losses = losses_over(thetas, objective, every, progress, "scan")
            scan = Scan.of(thetas, losses, [f.name for f in frames])
            best = int(np.argmin(losses.mean(axis=0)))
            init = float(np.exp(thetas[best]))
            if best in (0, len(thetas) - 1):
                doubt = at_an_end("below" if best == 0 else "above", bracket)
        path = descend_by_adam(objective, math.log(init), config, progress)
        pixel = bracket.pixel(path.theta)
        curves, closed = widened(LocalCurves(objective), every, Window(path.theta, pixel, pixel), config.seed, progress)
        return Found(
            path.theta,
            init,
            curves,
            closed,
            path.history,
            renders=scanned * len(frames) + path.evaluations + curves.renders,
            doubt=doubt or outside(path.theta, bracket),
            scan=scan,
            keeps_interval=True,
        )
