"""Joint refinement: the scale together with what the calibration has wrong, held by the calibration's standard deviations.

docs/how-it-works/scale.md, "Joint refinement", has the equations, with the letters of the code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale.checks import disagreeing, softness
from rtgs.scale.curves import LocalCurves
from rtgs.scale.interval import WIDEST
from rtgs.scale.newton import JointSolution, solve_jointly
from rtgs.scale.problem import Problem
from rtgs.scale.records import Refinement, ScaleEstimate
from rtgs.scale.resampling import QUANTILE_95
from rtgs.scale.rig_loss import RigLoss
from rtgs.scale.rig_motion import motions, stated_motions
from rtgs.scale.thermal_targets import Pictures, halvings
from rtgs.scale.verdict import discord_of

FEWEST = 4  # frames
_ROUGH_STEP = 0.6  # of a frame interval: a pose that its neighbours' middle misses by more says nothing about the time in between
_NODES = (-1.0, -0.5, 0.0, 0.5, 1.0)  # of the curves around the answer, in half-widths


def refine(problem: Problem, estimate: ScaleEstimate, *, widest: float = WIDEST) -> ScaleEstimate:
    """Refine a scale together with what `ScaleConfig.refine` names of the rig.

    Args:
        estimate: the scale found with the rig as it is, from which to start.
        widest: half-width of the interval in ln s from which on the scale is called unobservable.
    """
    if estimate.status == "unobservable":
        return replace(estimate, reason=f"{estimate.reason} The calibration was not refined: there is no scale to start from.")
    rig, names = problem.scene.rig, problem.config.refine
    asked = motions(rig, names)
    loss = RigLoss(problem.scene, (*asked, *stated_motions(rig, besides=names)), problem.progress)
    joint = _solve(problem, loss, math.log(estimate.sfm_per_metre), refined=len(asked))
    found, theta = joint.solution, float(joint.solution.x[0])

    # What is not refined but stated as uncertain is passed on to the scale, and so is the baseline's length.
    length = rig.calibration_std.baseline_length if rig.calibration_std else 0.0
    calibration = math.hypot(float(np.linalg.norm(found.response[0])), length)
    std_log = math.hypot(math.sqrt(found.covariance[0, 0]), calibration)
    total = found.covariance + found.response @ found.response.T
    amounts = np.array([1.0, *(m.std for m in asked)])
    total = total * np.outer(amounts, amounts)
    freedoms = [m.posterior(u, math.sqrt(v)) for m, u, v in zip(asked, found.x[1:], np.diag(total)[1:], strict=False)]
    refinement = Refinement.of(estimate.sfm_per_metre, freedoms, total, loss.rig(found.x))

    pictures, every = replace(joint.pictures, scene=refinement.apply(problem.scene)), range(len(problem.frames))
    objective = pictures.objective()
    half_width = float(np.clip(2 * std_log, 0.1 / found.pixels[0], 3 / found.pixels[0]))
    thetas = [theta + half_width * node for node in _NODES]
    curves = LocalCurves(objective).extended(problem.progress, frames=every, thetas=thetas)
    apart = disagreeing(pictures, halvings(problem.scene), every, theta, problem.bracket, problem.progress)
    refined = replace(
        estimate,
        sfm_per_metre=math.exp(theta),
        std_log=std_log,
        ci95=(math.exp(theta - QUANTILE_95 * std_log), math.exp(theta + QUANTILE_95 * std_log)),
        frames=tuple(f.name for f in problem.frames),
        local=curves.scan(),
        calibration_std_log=None if rig.calibration_std is None else calibration,
        blur_px=joint.pictures.blur_px,
        disagreeing=apart.frames,
        renders=estimate.renders + joint.renders + curves.renders + apart.renders,
        refinement=refinement,
    )
    reason = discord_of(len(apart.frames), len(problem.frames))
    if QUANTILE_95 * std_log > widest:
        factor = math.exp(QUANTILE_95 * std_log)
        reason = f"with the calibration refined, the scale is left open by a factor of {factor:.2g} to either side."
    return replace(refined, status="unobservable", reason=reason, std_log=None, ci95=None) if reason else refined


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint solution, the pictures it was found with, and how many were rendered."""

    solution: JointSolution
    pictures: Pictures
    renders: int


def _solve(problem: Problem, loss: RigLoss, theta: float, *, refined: int) -> _Joint:
    """From θ and the rig as calibrated: sharp first, then once more with renders as soft as the thermal images are.

    What was found of the blur with a wrong calibration says nothing, since misplaced edges agree better with soft ones.

    Args:
        refined: how many of the loss's motions are refined; those after them are held.
    """
    free = np.arange(loss.size) <= refined
    pictures = Pictures.of(problem)
    found = solve_jointly(loss, pictures, theta, free)
    theta = float(found.x[0])
    objective = replace(pictures, scene=loss.scene_at(found.x)).objective()
    soft = softness(objective, range(len(problem.frames)), theta, problem.progress)
    renders = pictures.renders + found.renders + soft.renders
    if soft.blur_px == 0.0:
        return _Joint(found, pictures, renders)
    pictures = replace(pictures, blur_px=soft.blur_px)
    found = solve_jointly(loss, pictures, theta, free)
    return _Joint(found, pictures, renders + found.renders)


def check_refinable(scene: Scene, frames: Sequence[Frame], names: Sequence[str]) -> None:
    """Before long work: is there enough to refine from? A time offset needs frames that follow each other.

    Raises:
        RtgsError: too few of the training frames that are to be used; or, for a time offset, too few frames with both neighbours, or
            camera positions that do not run smoothly in name order.
    """
    if names and len(frames) < FEWEST:
        raise RtgsError(
            f"scale.refine: {len(frames)} training frames are used; the calibration is refined from {FEWEST} or more. Leave it out."
        )
    if "time-offset" not in names:
        return
    rough = []
    for name in scene.world_from_rgb:
        before, after = scene.neighbours(name)
        if before is not None and after is not None:
            pose = scene.world_from_rgb[name]
            step = float(np.linalg.norm(after.translation - before.translation)) / 2
            rough.append(
                float(np.linalg.norm((before.translation + after.translation) / 2 - pose.translation) / max(step, 1e-12))
            )
    if len(rough) < 3:
        raise RtgsError(
            "scale.refine time-offset: fewer than three frames have both neighbours registered; it needs a sequence in the order of "
            "the frames' names. Leave time-offset out."
        )
    if np.median(rough) > _ROUGH_STEP:
        raise RtgsError(
            f"scale.refine time-offset: the camera does not move smoothly from frame to frame in the order of their names (a frame "
            f"lies {np.median(rough):.2g} steps away from the middle of its neighbours), so that nothing is known about the time in "
            "between. Name the files in the order of time, or leave time-offset out."
        )
