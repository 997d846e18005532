"""Stage 2: the metric scale `sfm_per_metre`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import PAPER_EPSILON, ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale.adam import adam
from rtgs.scale.bracket import bracket, flow_per_unit, information
from rtgs.scale.calibration import calibration_std_log
from rtgs.scale.interval import LocalCurves, interval, model_pixels, widened, window
from rtgs.scale.objective import Objective
from rtgs.scale.records import Counter, History, Minimum, ScaleEstimate, Scan, Status
from rtgs.scale.refine import refine
from rtgs.scale.search import (
    COMPARISON,
    EPSILON_FRAMES,
    UNLIKELY,
    Comparison,
    Pictures,
    Refined,
    Search,
    curves_of,
    local_minima,
    significance,
)
from rtgs.scale.unknowns import check_refinable

_WIDEST = 0.5  # of the interval's half-width in ln s: beyond it a number would only mislead
_FIRST_FRAMES = 16
_LIKELY = 0.025  # share of resamples from which on another minimum is not ruled out


def estimate_scale(
    scene: Scene,
    model: RgbModel,
    config: ScaleConfig | None = None,
    *,
    comparison: Comparison = COMPARISON,
    progress: Progress | None = None,
) -> ScaleEstimate:
    """Find `sfm_per_metre` from the edges that RGB and thermal images share, the RGB model frozen (Eqs. 1–8).

    Solver "global" looks everywhere and needs no start; "adam" is the paper's.

    Args:
        scene: registered pairs; only training frames are used.
        model: the RGB model, trained or imported.
        comparison: for ablations of the global search.
        progress: called with (renders done, renders in all as far as is known, text).

    Raises:
        RtgsError: nothing to compare (no training frame, no pixel covered), an `init` that is no positive number, or a refinement that
            these frames do not allow.
    """
    config = config or ScaleConfig()
    if config.init is not None and not (config.init > 0 and math.isfinite(config.init)):
        raise RtgsError(f"scale: init is {config.init}; sfm_per_metre is a positive number.")
    if config.batch is not None and config.batch < 1:
        raise RtgsError(f"scale: batch is {config.batch}; it is a number of frames, or left out for all of them.")
    train = scene.train_frames
    if not train:
        raise RtgsError("scale: the scene has no training frame (every registered frame is held out).")
    counter = Counter(progress)
    flow = flow_per_unit(scene, model.gaussians, model.settings)
    limits = bracket(flow, scene.rig.thermal.width)
    chosen = np.unique(np.linspace(0, len(train) - 1, min(config.max_frames, len(train))).round().astype(int))
    frames = [train[i] for i in chosen]
    check_refinable(scene, frames, config.refine)
    if config.solver == "adam":
        estimate = _by_adam(scene, model, config, frames, limits, counter)
    else:
        estimate = _globally(scene, model, config, comparison, frames, limits, counter)
    return refine(scene, model, config, frames, estimate, counter, widest=_WIDEST) if config.refine else estimate


def _by_adam(
    scene: Scene, model: RgbModel, config: ScaleConfig, frames: list[Frame], limits: tuple[float, float], counter: Counter
) -> ScaleEstimate:
    """The paper's objective and solver. Without a start, the minimum of a scan of the same loss over the bracket is it."""
    objective = Objective(
        scene,
        model.gaussians,
        model.background,
        model.settings,
        frames,
        level_weights=config.level_weights,
        epsilon=PAPER_EPSILON if config.epsilon is None else config.epsilon,
    )
    names = [f.name for f in frames]
    batch = len(frames) if config.batch is None else min(config.batch, len(frames))
    scan, reason, init = None, "", config.init
    counter.plan((config.scan_samples if init is None else 0) * len(frames) + config.steps * batch + 6 * len(frames))
    if init is None:
        thetas = np.linspace(math.log(limits[0]), math.log(limits[1]), config.scan_samples)
        curves = curves_of(objective, range(len(frames)), thetas, counter)
        scan = Scan.of(thetas, curves, names)
        best = int(np.argmin(curves.mean(axis=0)))
        init = float(np.exp(thetas[best]))
        if best in (0, len(thetas) - 1):
            side = "below" if best == 0 else "above"
            reason = f"the loss is lowest at an end of the scan: the scale lies {side} {_what_can_be_told(limits)}"
    theta, history = adam(objective, math.log(init), config, counter)
    reason = reason or _outside(theta, limits)
    local = LocalCurves(objective, counter)
    pixel = 2 * limits[0] / math.exp(theta)
    closed = widened(local, range(len(frames)), theta, pixel, pixel, config.seed)
    found = _Found(theta, init, scan, history, [], [], objective.renders)
    return _result(scene, config, frames, limits, objective, local, found, reason, closed)


def _globally(
    scene: Scene,
    model: RgbModel,
    config: ScaleConfig,
    comparison: Comparison,
    frames: list[Frame],
    limits: tuple[float, float],
    counter: Counter,
) -> ScaleEstimate:
    """Scan, refine what it found, and draw the curves around the best; frames join until the interval is narrow enough."""
    start = math.log(limits[0] if config.init is None else config.init)
    counter.plan(EPSILON_FRAMES)
    pictures = Pictures.of(scene, model, frames, config.level_weights, config.epsilon, counter, comparison)
    worth = information(scene, model.gaussians, model.settings, frames)
    ranked = sorted(range(len(frames)), key=lambda i: -worth[i])
    search = Search(pictures, ranked, 0.5 / limits[0], counter)
    scan, doubt, starts = None, "", [start]
    if config.init is None:
        thetas, curves = search.scan(limits)
        scan = Scan.of(thetas, curves, [frames[i].name for i in search.scanned])
        candidates = local_minima(curves)
        if candidates[0] == len(thetas) - 1:
            doubt = f"the loss is lowest at an end of the scan: the scale lies above {_what_can_be_told(limits)}"
        starts = [float(thetas[j]) for j in candidates]
    counter.plan(len(starts) * search.refine_renders() + 6 * len(frames))
    minima = search.refine(starts)
    minima[0] = search.as_soft_as_the_lens(minima[0])
    pictures, best = search.pictures, minima[0].place
    doubt = doubt or _outside(best.theta, limits)

    objective = pictures.objective()
    local = LocalCurves(objective, counter)
    pixel = 2 * limits[0] / math.exp(best.theta)
    half_width, count = window(best.slopes, best.curvature, pixel), _FIRST_FRAMES
    while True:
        closed = widened(local, ranked[:count], best.theta, half_width, pixel, config.seed)
        if count >= len(frames) or not closed or doubt:
            break
        if 1.96 * interval(*local.dense(), local.minimum(), 0.0, config.seed)[0] <= config.half_width:
            break
        count *= 2
    theta = local.settled(half_width) if closed else local.minimum()
    used = [frames[i] for i in local.frames]
    doubt = doubt or _no_better_than_none(pictures.objective(min(1, search.halved)), local.frames, theta, limits, counter)
    disagreeing = [] if doubt or not closed else search.disagreeing(theta, local.frames)
    renders = pictures.renders_in_all()
    rivals = _rivals(minima, config.seed)
    found = _Found(theta, math.exp(minima[0].start), scan, search.history, rivals, disagreeing, renders, pictures.blur_px)
    return _result(scene, config, used, limits, objective, local, found, doubt, closed)


@dataclass(frozen=True)
class _Found:
    """What a solver came to, and how."""

    theta: float
    init: float
    scan: Scan | None
    history: History
    rivals: list[Minimum]
    disagreeing: list[str]
    renders: int
    blur_px: float = 0.0


def _result(
    scene: Scene,
    config: ScaleConfig,
    frames: list[Frame],
    limits: tuple[float, float],
    objective: Objective,
    local: LocalCurves,
    found: _Found,
    doubt: str,
    closed: bool,
) -> ScaleEstimate:
    """Interval and verdict."""
    grid, curves = local.dense()
    std_log, ci95, reason, std = None, None, doubt, scene.rig.calibration_std
    calibration = None if std is None else calibration_std_log(objective, scene.rig, found.theta, std, local.frames)
    if len(frames) > 1:
        model = min(model_pixels(found.blur_px) * 2 * limits[0] / math.exp(found.theta), 2 * _WIDEST)
        std_log, ci95 = interval(grid, curves, found.theta, math.hypot(model, calibration or 0.0), config.seed)
        if not reason and not closed:
            reason = (
                f"the loss is flat: between {math.exp(grid[0]):.4g} and {math.exp(grid[-1]):.4g} SfM units per metre, no scale stands "
                "out in all resamples of the frames."
            )
        if not reason and 1.96 * std_log > _WIDEST:
            reason = f"the frames leave the scale open by a factor of {math.exp(1.96 * std_log):.2g} to either side."
    status: Status = "unobservable" if reason else "ok"
    if reason and config.solver == "global":
        std_log, ci95 = None, None  # where the images do not decide, a scatter about some place would look like knowledge
    likely = [m for m in found.rivals if m.chance > _LIKELY]
    if not reason and likely:
        status = "ambiguous"
        others = " and ".join(f"{m.sfm_per_metre:.4g}" for m in likely)
        reason = f"the edges meet as well at {others} SfM units per metre; frames with nearer things would tell which is right."
    return ScaleEstimate(
        sfm_per_metre=math.exp(found.theta),
        std_log=std_log,
        ci95=ci95,
        status=status,
        reason=reason,
        solver=config.solver,
        init=found.init,
        bracket=limits,
        baseline_m=scene.rig.baseline_m,
        frames=[f.name for f in frames],
        scan=found.scan,
        local=Scan.of(np.array(local.thetas), local.values(), [f.name for f in frames]),
        history=found.history,
        minima=found.rivals,
        disagreeing=found.disagreeing,
        calibration_std_log=calibration,
        renders=found.renders,
        blur_px=found.blur_px,
    )


def _outside(theta: float, limits: tuple[float, float]) -> str:
    """Why a scale outside of the bracket is none."""
    s = math.exp(theta)
    if limits[0] <= s <= limits[1]:
        return ""
    return f"the scale found, {s:.4g}, lies {'below' if s < limits[0] else 'above'} {_what_can_be_told(limits)}"


def _no_better_than_none(
    objective: Objective, indices: Sequence[int], theta: float, limits: tuple[float, float], counter: Counter
) -> str:
    """Why a scale is none that the images fit hardly better than no baseline at all, which is half a pixel of flow."""
    counter.plan(2 * len(indices))
    gains = []
    for i in indices:
        gains.append(objective.loss(i, math.log(limits[0])) - objective.loss(i, theta))
        counter("no baseline")
    if significance(np.array(gains)) >= UNLIKELY:
        return ""
    return (
        f"the images fit no baseline at all as well as {math.exp(theta):.4g}: if there is a scale, it may lie below "
        f"{_what_can_be_told(limits)}"
    )


def _what_can_be_told(limits: tuple[float, float]) -> str:
    return (
        f"what the images can tell ({limits[0]:.4g} to {limits[1]:.4g} SfM units per metre), "
        "or the edges of the two modalities do not agree."
    )


def _rivals(minima: Sequence[Refined], seed: int) -> list[Minimum]:
    """The minima that are not the best."""
    rng, rivals = np.random.default_rng(seed), list[Minimum]()
    for other in minima[1:]:
        picks = rng.integers(len(other.above), size=(1000, len(other.above)))
        chance = float((other.above[picks].mean(axis=1) < 0).mean())
        rivals.append(Minimum(math.exp(other.place.theta), float(other.above.mean()), chance))
    return rivals
