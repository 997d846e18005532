"""The scale together with what the calibration has wrong: rotation, baseline direction, focal length and time offset, with priors.

docs/how-it-works/scale.md, "Joint refinement", has the equations; its letters are those of the code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale.interval import LocalCurves, block_length, model_pixels, small_sample_factor
from rtgs.scale.joint import Joint, Point, Vector
from rtgs.scale.objective import Objective
from rtgs.scale.records import Counter, Refinement, ScaleEstimate, Scan
from rtgs.scale.search import Pictures, halvings, softness
from rtgs.scale.unknowns import stated, unknowns

_HESSIAN_PIXELS = 0.5
_HESSIAN_FRAMES = 16
_MOST_STEPS = 6
_MOST_HESSIANS = 3
_LONGEST = 2.0  # pixels of the size compared
_TOLERANCE = 0.02
_CALIBRATION_PIXELS = 0.1  # what `MODEL_PIXELS` is for the scale


def refine(
    scene: Scene,
    model: RgbModel,
    config: ScaleConfig,
    frames: Sequence[Frame],
    estimate: ScaleEstimate,
    counter: Counter,
    *,
    widest: float,
) -> ScaleEstimate:
    """Refine a scale together with what `config.refine` names of the rig.

    Args:
        frames: training frames. estimate: the scale found with the rig as it is, from which to start.
        widest: half-width of the interval in ln s from which on the scale is called unobservable.
    """
    if estimate.status == "unobservable":
        return replace(estimate, reason=f"{estimate.reason} The calibration was not refined: there is no scale to start from.")
    std, start = scene.rig.calibration_std, math.log(estimate.sfm_per_metre)
    asked, held = unknowns(scene.rig, config.refine), stated(scene.rig, config.refine)
    joint = Joint(scene, [*asked, *held], counter)
    free = np.arange(joint.size) <= len(asked)
    pictures = Pictures.of(scene, model, frames, config.level_weights, config.epsilon, counter)
    found = solve(joint, pictures, start, free)
    # What was found with a wrong calibration says nothing: misplaced edges agree better with soft ones.
    refined = replace(pictures, scene=joint.scene_at(found.x)).objective()
    blur_px = softness(refined, range(len(frames)), float(found.x[0]), counter)
    if blur_px:
        pictures = replace(pictures, blur_px=blur_px, renders=pictures.renders_in_all())
        found = solve(joint, pictures, float(found.x[0]), free)

    theta, rig = float(found.x[0]), joint.rig(found.x)
    calibration = math.hypot(float(np.linalg.norm(found.response[0])), std.baseline_length if std else 0.0)
    std_log = math.hypot(math.sqrt(found.covariance[0, 0]), calibration)
    total = found.covariance + found.response @ found.response.T
    amounts = np.array([1.0, *(u.std for u in asked)])
    total = total * np.outer(amounts, amounts)
    freedoms = [u.posterior(x, math.sqrt(v)) for u, x, v in zip(asked, found.x[1:], np.diag(total)[1:], strict=False)]
    refinement = Refinement.of(estimate.sfm_per_metre, freedoms, total, rig)

    curves = LocalCurves(replace(pictures, scene=refinement.apply(scene)).objective(), counter)
    width = float(np.clip(2 * std_log, 0.1 / found.pixels[0], 3 / found.pixels[0]))
    curves.extend(range(len(frames)), [theta + width * node for node in (-1.0, -0.5, 0.0, 0.5, 1.0)])
    estimate = replace(
        estimate,
        std_log=std_log,
        ci95=(math.exp(theta - 1.96 * std_log), math.exp(theta + 1.96 * std_log)),
        refinement=refinement,
    )
    if 1.96 * std_log > widest:
        left_open = (
            f"with the calibration refined, the scale is left open by a factor of {math.exp(1.96 * std_log):.2g} to either side."
        )
        estimate = replace(estimate, status="unobservable", reason=left_open, std_log=None, ci95=None)
    return replace(
        estimate,
        sfm_per_metre=math.exp(theta),
        frames=[f.name for f in frames],
        local=Scan.of(np.array(curves.thetas), curves.values(), [f.name for f in frames]),
        calibration_std_log=None if std is None else calibration,
        blur_px=blur_px,
        renders=estimate.renders + refined.renders + pictures.renders_in_all() + len(frames) * len(curves.thetas),
    )


def noise(gradients: Vector) -> Vector:
    """`[K, K]`: G, the covariance of the frames' mean gradient `[F, K]`. Neighbours err alike: Bartlett weights over runs of ∛F frames."""
    n = len(gradients)
    block = block_length(n)
    centred = gradients - gradients.mean(axis=0)
    total = centred.T @ centred
    for lag in range(1, block):
        product = centred[lag:].T @ centred[:-lag]
        total += (1 - lag / block) * (product + product.T)
    return total / n**2 * small_sample_factor(n, block) ** 2


def positive(hessian: Vector, gauss_newton: Vector) -> Vector:
    """The Hessian with its curvatures, relative to Gauss–Newton's, kept above a hundredth of their median."""
    root = np.linalg.cholesky(gauss_newton + 1e-9 * float(np.diag(gauss_newton).max()) * np.eye(len(gauss_newton)))
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ hessian @ inverse.T)
    values = np.maximum(values, 0.01 * max(float(np.median(values)), 1e-12))
    half = root @ vectors
    return (half * values) @ half.T


def covariance(hessian: Vector, g: Vector, prior: Vector, weight: float) -> Vector:
    """(H + wP)⁻¹ (G + w²P) (H + wP)⁻¹: how far the minimum of L + w/2 xᵀPx scatters about the truth."""
    inverse = np.linalg.inv(hessian + weight * prior)
    return inverse @ (g + weight**2 * prior) @ inverse


def bias(hessian: Vector, pixels: Vector, blur_px: float = 0.0) -> Vector:
    """`[K, K]`: covariance of the gradient that model errors leave, all frames alike; θ comes first.

    Edges of a render lie beside those of the photograph, in fields as smooth as those of the unknowns themselves: x is off by as much as
    makes such a field. A tenth of it has no such form, so that what the unknowns do alike does not cancel it.
    """
    std = np.array([model_pixels(blur_px), *[model_pixels(blur_px, _CALIBRATION_PIXELS)] * (len(pixels) - 1)]) / pixels
    alike, alone = hessian * std, 0.1 * np.diag(hessian) * std
    return np.asarray(alike @ alike.T + np.diag(alone**2))


def best_weight(hessian: Vector, gradient_covariance: Vector, prior: Vector) -> float:
    """The w whose `covariance` has the smallest determinant: the prior counts as much as is best against this noise."""
    typical = float(np.median(np.diag(hessian)[1:]))
    weights = typical * np.logspace(-6, 4, 81)
    return float(min(weights, key=lambda w: np.linalg.slogdet(covariance(hessian, gradient_covariance, prior, w))[1]))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the joint descent ended.

    Attributes:
        x: `[K]`. covariance: `[F, F]` of what was free. response: `[F, Q]`, its derivative by what was held.
        pixels: `[K]`, how far the picture moves per unit of x.
    """

    x: Vector
    covariance: Vector
    response: Vector
    pixels: Vector


def solve(joint: Joint, pictures: Pictures, theta: float, free: NDArray[np.bool_]) -> Solution:
    """Descend L + w/2 |u|² by Newton's steps from (θ, 0), coarse to fine.

    Args:
        free: `[K]`, which of x move; the others are held at the calibration's value.
    """
    x = np.zeros(joint.size)
    x[0] = theta
    every = range(len(pictures.frames))
    few = every[:: -(-len(every) // _HESSIAN_FRAMES)]
    prior = joint.prior[np.ix_(free, free)]
    pixels = joint.pixels(x, pictures.model.gaussians)
    coarsest = _coarsest(pictures.scene, pixels, free)
    joint.counter.plan(4 * (coarsest + 1) * joint.size * len(few) + 6 * len(every))
    for halved in range(coarsest, -1, -1):
        objective, coarse_pixel = pictures.objective(halved), 2.0**halved
        indices = few if halved else every
        here = joint.evaluate(objective, indices, x)
        for _ in range(_MOST_HESSIANS):
            began = x
            hessian = joint.hessian(objective, few, x, np.minimum(_HESSIAN_PIXELS * coarse_pixel / pixels, 1.0))
            curved = positive(hessian[np.ix_(free, free)], here.gauss_newton[np.ix_(free, free)])
            scatter = noise(here.gradients[:, free]) + bias(curved, pixels[free], pictures.blur_px)
            weight = best_weight(curved, scatter, prior)
            here = _descend(joint, objective, indices, here, curved + weight * prior, weight, free, pixels / coarse_pixel)
            x = here.x
            if np.abs((x - began) * pixels).max() < _HESSIAN_PIXELS * coarse_pixel:
                break
    response = np.asarray(-np.linalg.solve(curved + weight * prior, hessian[np.ix_(free, ~free)]), dtype=np.float64)
    return Solution(x, covariance(curved, scatter, prior, weight), response, pixels)


def _descend(
    joint: Joint,
    objective: Objective,
    indices: Sequence[int],
    here: Point,
    curvature: Vector,
    weight: float,
    free: NDArray[np.bool_],
    pixels: Vector,
) -> Point:
    """Newton's steps with one matrix, taken where they lower L + w/2 |u|²."""

    def merit(point: Point) -> float:
        return float(point.losses.mean()) + weight / 2 * float(point.x[1:] @ point.x[1:])

    for _ in range(_MOST_STEPS):
        slope = here.gradient + weight * joint.prior @ here.x
        step = np.zeros(joint.size)
        step[free] = -np.linalg.solve(curvature, slope[free])
        step *= min(1.0, _LONGEST / max(float(np.abs(step * pixels).max()), 1e-12))
        there = joint.evaluate(objective, indices, here.x + step)
        while merit(there) >= merit(here) and np.abs(step * pixels).max() > _TOLERANCE:
            step = step / 3
            there = joint.evaluate(objective, indices, here.x + step)
        if merit(there) >= merit(here):
            break
        here = there
        if np.abs(step * pixels).max() <= _TOLERANCE:
            break
    return here


def _coarsest(scene: Scene, pixels: Vector, free: NDArray[np.bool_]) -> int:
    """How often the picture is halved at first: until two standard deviations of the priors together move it by two pixels or less."""
    reach = 2 * float(np.linalg.norm(pixels[1:][free[1:]]))
    return min(halvings(scene), max(0, math.ceil(math.log2(max(reach, 1.0) / 2))))
