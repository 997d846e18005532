"""Stage: the metric scale `sfm_per_metre`."""

from __future__ import annotations

import math
from dataclasses import replace

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.rig import RigStart
from rtgs.records.scene import Scene
from rtgs.scale.comparison import COMPARISON, Comparison
from rtgs.scale.find_rig import RigFromCapture, find_rig
from rtgs.scale.interval import WIDEST, find_interval
from rtgs.scale.problem import Problem, usable_frames
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import Refinement, ScaleEstimate
from rtgs.scale.refine import FEWEST, check_refinable, refine
from rtgs.scale.resampling import QUANTILE_95
from rtgs.scale.solvers import SOLVERS
from rtgs.scale.verdict import verdict_of


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
        scene: registered pairs; only training frames are used. Where its rig has a `start`, the rig is found first, and is in the
            estimate's `refinement` and `calibration`.
        model: the RGB model, trained or imported.
        comparison: for ablations of the global search.
        progress: called with (pictures rendered, pictures in all as far as is known, text).

    Raises:
        RtgsError: nothing to compare (no training frame, no pixel covered), or a refinement that these frames do not allow.
    """
    config = config or ScaleConfig()
    if scene.rig.start is not None:
        return _with_rig(scene, model, config, comparison, progress)
    problem = Problem.of(scene, model, config, comparison, progress)  # with the bracket
    check_refinable(scene, problem.frames, config.refine)
    found = SOLVERS[config.solver].solve(problem)
    interval = find_interval(problem, found)
    verdict = verdict_of(found, interval, refined_later=bool(config.refine))
    if verdict.status == "unobservable" and not found.keeps_interval:
        # Where the images do not decide, a scatter about some place would look like knowledge.
        interval = replace(interval, std_log=None, ci95=None)
    local = found.curves.scan()
    estimate = ScaleEstimate(
        sfm_per_metre=math.exp(found.theta),
        std_log=interval.std_log,
        ci95=interval.ci95,
        status=verdict.status,
        reason=verdict.reason,
        solver=config.solver,
        init=found.init,
        bracket=problem.bracket,
        baseline_m=scene.rig.baseline_m,
        frames=tuple(local.per_frame),
        scan=found.scan,
        local=local,
        history=found.history,
        minima=found.minima,
        disagreeing=found.disagreeing,
        calibration_std_log=interval.calibration_std_log,
        renders=found.renders + interval.misfit.renders,
        blur_px=found.blur_px,
        misfit_px=interval.misfit.px,
    )
    return refine(problem, estimate) if config.refine else estimate


def _with_rig(
    scene: Scene, model: RgbModel, config: ScaleConfig, comparison: Comparison, progress: Progress | None
) -> ScaleEstimate:
    """Find the rig, then the scale with it: its checks are the same. The interval is that of the rig's baseline, all else unknown too.

    Raises:
        RtgsError: too few training frames, or something to refine is named.
    """
    start = scene.rig.start
    assert start is not None
    if config.refine:
        raise RtgsError(
            f"scale.refine names {', '.join(config.refine)}, and rig.json gives no calibration: all of the rig is found. Leave it out."
        )
    if len(usable_frames(scene, config)) < FEWEST:
        raise RtgsError(
            f"scale: rig.json gives no transform, and fewer than {FEWEST} training frames are there to find it from. Add frames, or "
            "calibrate."
        )
    found = find_rig(scene, model, config, comparison, RenderProgress(progress))
    capture = replace(scene.capture, rig=found.rig)
    estimate = estimate_scale(replace(scene, capture=capture), model, config, comparison=comparison, progress=progress)
    refinement = Refinement.of(estimate.sfm_per_metre, found.freedoms, found.covariance, found.rig)
    estimate = replace(estimate, refinement=refinement, calibration=found.found)
    return _weighed(estimate, found, start)


def _weighed(estimate: ScaleEstimate, found: RigFromCapture, start: RigStart) -> ScaleEstimate:
    """The estimate with what finding the rig says about it."""
    decided = found.found.baseline_decided
    estimate = replace(estimate, baseline_m=start.baseline_m)
    if not found.found.baseline_seen:
        estimate = replace(estimate, sfm_per_metre=found.sfm_per_metre)
    std_log = None if estimate.std_log is None else math.hypot(estimate.std_log, found.found.baseline_std_log or 0.0)
    doubt = found.doubt or ("" if estimate.status == "ok" or not decided else estimate.reason)
    if not doubt and not found.found.baseline_seen:
        doubt = (
            "rotation and focal length of the thermal camera are found, but not the baseline: the edges meet as well with both cameras in "
            "the same place. Frames with nearer things would tell it."
        )
    if not doubt and (std_log is None or QUANTILE_95 * std_log > WIDEST):
        spread = math.exp(min(QUANTILE_95 * max(std_log or 0.0, found.found.baseline_std_log or 0.0), 10.0))
        doubt = f"with the rig unknown, the baseline's length is left open by a factor of {spread:.2g} to either side."
    if doubt:
        return replace(estimate, status="unobservable", reason=doubt, std_log=None, ci95=None)
    assert std_log is not None
    ends = (math.exp(sign * QUANTILE_95 * std_log) * estimate.sfm_per_metre for sign in (-1, 1))
    estimate = replace(estimate, std_log=std_log, ci95=(next(ends), next(ends)))
    if start.baseline_m is None:
        reason = (
            f"the rig is found, and its baseline is {estimate.sfm_per_metre:.4g} SfM units long. rig.json does not say how long that is "
            'in metres ("baseline_m").'
        )
        return replace(estimate, status="unobservable", reason=reason)
    return estimate
