"""Stage 2: the metric scale `sfm_per_metre`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.config import ScaleConfig
from rtgs.errors import RtgsError
from rtgs.models import RgbModel
from rtgs.progress import Progress
from rtgs.scale.bracket import bracket, flow_per_unit
from rtgs.scale.objective import Objective
from rtgs.scene import Scene

Status = Literal["ok", "unobservable"]

# ln s of the curve that says how sure the answer is: dense near it, a sixth away at the ends.
_LOCAL = np.array([-0.16, -0.08, -0.04, -0.02, -0.01, -0.005, 0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16])
_RESAMPLES = 1000


@dataclass(frozen=True)
class Scan:
    """The loss over the bracket.

    Attributes:
        sfm_per_metre: `[S]`, rising. loss: `[S]`, mean over frames.
        std_error: `[S]`, standard error over frames of the loss *above the minimum's* (paired: frames differ in level, which says
            nothing about s).
        per_frame: frame name → `[S]`.
    """

    sfm_per_metre: list[float]
    loss: list[float]
    std_error: list[float]
    per_frame: dict[str, list[float]]


@dataclass(frozen=True)
class History:
    """One entry a step: the scale before it, the loss and dL/d ln s there."""

    step: list[int]
    sfm_per_metre: list[float]
    loss: list[float]
    slope: list[float]


@dataclass(frozen=True)
class ScaleEstimate:
    """What `scale.json` holds.

    Attributes:
        sfm_per_metre: SfM units per metre (the paper's s).
        std_log: standard deviation of ln s, bootstrap over frames. It holds the scatter between frames, not the calibration's error.
            None with a single frame.
        ci95: its 2.5 and 97.5 percentiles, of `sfm_per_metre`; None likewise.
        status, reason: "unobservable" when the scan's minimum lies at an end of the bracket, or the answer outside it; why, in words.
        init: where Adam started. bracket: scales the images can tell apart.
        baseline_m: |t| of the rig. frames: those used.
        local: the loss close to the answer; the bootstrap's curve.
    """

    sfm_per_metre: float
    std_log: float | None
    ci95: tuple[float, float] | None
    status: Status
    reason: str
    solver: str
    init: float
    bracket: tuple[float, float]
    baseline_m: float
    frames: list[str]
    scan: Scan | None
    local: Scan
    history: History

    @property
    def metres_per_sfm(self) -> float:
        return 1.0 / self.sfm_per_metre

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "metres_per_sfm": self.metres_per_sfm}

    @staticmethod
    def from_json(data: dict[str, Any]) -> ScaleEstimate:
        values = {k: v for k, v in data.items() if k != "metres_per_sfm"}
        values["bracket"] = tuple(data["bracket"])
        values["ci95"] = tuple(data["ci95"]) if data["ci95"] else None
        values["scan"] = Scan(**data["scan"]) if data["scan"] else None
        values["local"] = Scan(**data["local"])
        values["history"] = History(**data["history"])
        return ScaleEstimate(**values)


def estimate_scale(
    scene: Scene, model: RgbModel, config: ScaleConfig | None = None, *, progress: Progress | None = None
) -> ScaleEstimate:
    """Find `sfm_per_metre` by Adam on the paper's NGF loss (Eqs. 1–8), the RGB model frozen.

    Args:
        scene: registered pairs; only training frames are used.
        model: the RGB model, trained or imported.
        progress: called with (renders done, renders in all, text).

    Raises:
        RtgsError: nothing to compare (no training frame, no pixel covered), or an `init` that is no positive number.
    """
    config = config or ScaleConfig()
    if config.init is not None and not (config.init > 0 and math.isfinite(config.init)):
        raise RtgsError(f"scale: init is {config.init}; sfm_per_metre is a positive number.")
    if config.batch is not None and config.batch < 1:
        raise RtgsError(f"scale: batch is {config.batch}; it is a number of frames, or left out for all of them.")
    train = scene.train_frames
    if not train:
        raise RtgsError("scale: the scene has no training frame (every registered frame is held out).")
    chosen = np.unique(np.linspace(0, len(train) - 1, min(config.max_frames, len(train))).round().astype(int))
    frames = [train[i] for i in chosen]
    objective = Objective(
        scene,
        model.gaussians,
        model.background,
        model.settings,
        frames,
        level_weights=config.level_weights,
        epsilon=config.epsilon,
    )
    names = [f.name for f in frames]
    batch = len(frames) if config.batch is None else min(config.batch, len(frames))
    scan_work = config.scan_samples * len(frames) if config.init is None else 0
    counter = _Counter(scan_work + config.steps * batch + len(_LOCAL) * len(frames), progress)

    limits = bracket(flow_per_unit(scene, model.gaussians, model.settings), scene.rig.thermal.width)
    scan, reason = None, ""
    if config.init is None:
        thetas = np.linspace(math.log(limits[0]), math.log(limits[1]), config.scan_samples)
        curves = _curves(objective, thetas, counter, "scan")
        scan = _scan(thetas, curves, names)
        best = int(np.argmin(curves.mean(axis=0)))
        init = float(np.exp(thetas[best]))
        if best in (0, len(thetas) - 1):
            side = "below" if best == 0 else "above"
            reason = f"the loss is lowest at an end of the scan: the scale lies {side}"
    else:
        init = config.init

    theta, history = adam(objective, math.log(init), config, counter)
    if not reason and not limits[0] <= math.exp(theta) <= limits[1]:
        reason = f"the scale found, {math.exp(theta):.4g}, lies {'below' if math.exp(theta) < limits[0] else 'above'}"
    if reason:
        reason += (
            f" what the images can tell ({limits[0]:.4g} to {limits[1]:.4g} SfM units per metre), "
            "or the edges of the two modalities do not agree."
        )
    local_thetas = theta + _LOCAL
    local_curves = _curves(objective, local_thetas, counter, "interval")
    std_log, ci95 = bootstrap(local_thetas, local_curves, config.seed) if len(frames) > 1 else (None, None)
    return ScaleEstimate(
        sfm_per_metre=math.exp(theta),
        std_log=std_log,
        ci95=ci95,
        status="unobservable" if reason else "ok",
        reason=reason,
        solver="adam",
        init=init,
        bracket=limits,
        baseline_m=scene.rig.baseline_m,
        frames=names,
        scan=scan,
        local=_scan(local_thetas, local_curves, names),
        history=history,
    )


def adam(
    objective: Objective, theta: float, config: ScaleConfig, counter: Callable[[str], None] | None = None
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
    for step in range(config.steps):
        indices = range(n) if batch == n else torch.randperm(n, generator=generator)[:batch].tolist()
        losses, slopes = [], []
        for i in indices:
            loss, slope = objective.loss_and_slope(i, parameter.item())
            losses.append(loss)
            slopes.append(slope)
            if counter is not None:
                counter(f"s = {math.exp(parameter.item()):.5g}")
        history.step.append(step)
        history.sfm_per_metre.append(math.exp(parameter.item()))
        history.loss.append(float(np.mean(losses)))
        history.slope.append(float(np.mean(slopes)))
        parameter.grad = torch.tensor(history.slope[-1], dtype=torch.float64)
        optimizer.step()
    return parameter.item(), history


def bootstrap(thetas: NDArray[np.float64], curves: NDArray[np.float64], seed: int) -> tuple[float, tuple[float, float]]:
    """Resample frames, take each mean curve's minimum, and say how it scatters.

    Args:
        thetas: `[S]`, rising; curves: `[F, S]`.

    Returns:
        Standard deviation of ln s, and the 95 % percentile interval of s.
    """
    rng = np.random.default_rng(seed)
    picks = rng.integers(len(curves), size=(_RESAMPLES, len(curves)))
    minima = np.array([curve_minimum(thetas, curves[p].mean(axis=0)) for p in picks])
    lo, hi = np.percentile(minima, [2.5, 97.5])
    return float(minima.std()), (float(np.exp(lo)), float(np.exp(hi)))


def curve_minimum(thetas: NDArray[np.float64], curve: NDArray[np.float64]) -> float:
    """θ of the lowest sample, refined by the parabola through it and its neighbours; an end stays an end."""
    k = int(np.argmin(curve))
    if k in (0, len(curve) - 1):
        return float(thetas[k])
    a, b, _ = np.polyfit(thetas[k - 1 : k + 2] - thetas[k], curve[k - 1 : k + 2], 2)
    return (
        float(thetas[k] + np.clip(-b / (2 * a), thetas[k - 1] - thetas[k], thetas[k + 1] - thetas[k]))
        if a > 0
        else float(thetas[k])
    )


class _Counter:
    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.progress = 0, total, progress

    def __call__(self, text: str) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, self.total, text)


def _curves(objective: Objective, thetas: NDArray[np.float64], counter: _Counter, text: str) -> NDArray[np.float64]:
    """Per-frame losses `[F, S]`."""
    curves = np.empty((len(objective.frames), len(thetas)))
    for j, theta in enumerate(thetas):
        for i in range(len(objective.frames)):
            curves[i, j] = objective.loss(i, float(theta))
            counter(f"{text}, s = {math.exp(theta):.4g}")
    return curves


def _scan(thetas: NDArray[np.float64], curves: NDArray[np.float64], names: Sequence[str]) -> Scan:
    mean = curves.mean(axis=0)
    above = curves - curves[:, [int(np.argmin(mean))]]
    error = above.std(axis=0, ddof=1) / math.sqrt(len(curves)) if len(curves) > 1 else np.zeros_like(mean)
    return Scan(
        np.exp(thetas).tolist(), mean.tolist(), error.tolist(), {n: c.tolist() for n, c in zip(names, curves, strict=True)}
    )
