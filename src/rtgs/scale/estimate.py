"""Stage: the metric scale `sfm_per_metre`."""

from __future__ import annotations

import math
from dataclasses import replace

from rtgs.base.progress import Progress
from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale.comparison import COMPARISON, Comparison
from rtgs.scale.interval import find_interval
from rtgs.scale.problem import Problem
from rtgs.scale.records import ScaleEstimate
from rtgs.scale.refine import check_refinable, refine
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
        scene: registered pairs; only training frames are used.
        model: the RGB model, trained or imported.
        comparison: for ablations of the global search.
        progress: called with (pictures rendered, pictures in all as far as is known, text).

    Raises:
        RtgsError: nothing to compare (no training frame, no pixel covered), or a refinement that these frames do not allow.
    """
    config = config or ScaleConfig()
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
