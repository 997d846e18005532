"""The scale together with what the calibration has wrong: rotation, baseline direction, focal length and time offset, with priors.

docs/scale.md, "Joint refinement", has the equations; its letters are those of the code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.config import ScaleConfig
from rtgs.errors import RtgsError
from rtgs.gaussians import Gaussians
from rtgs.geometry import SE3
from rtgs.models import RgbModel
from rtgs.render import Direction
from rtgs.scale.calibration import Change, freedoms
from rtgs.scale.interval import LocalCurves, block_length, small_sample_factor
from rtgs.scale.objective import Objective
from rtgs.scale.records import Counter, Freedom, Refinement, ScaleEstimate, Scan, Status
from rtgs.scale.search import Pictures, halvings
from rtgs.scene import CalibrationStd, Frame, Rig, Scene

Vector = NDArray[np.float64]

# Where rig.json does not say. A thermal calibration with a heated board reaches 0.1° and 1 % with care; a data sheet's focal length or a
# baseline read off a drawing is worse. Free-running cameras whose nearest frames are paired differ by up to half an interval to either
# side, evenly: standard deviation 1/√12.
DEFAULT_STD = CalibrationStd(rotation_rad=math.radians(0.3), baseline_direction=0.02, thermal_focal=0.02)
TIME_OFFSET_STD = 1 / math.sqrt(12)

_DIFFERENCE = 1e-4  # of a prior's standard deviation, for the poses' derivatives
_HESSIAN_PIXELS = 0.5
_HESSIAN_FRAMES = 16
_MOST_STEPS = 6
_MOST_HESSIANS = 3
_LONGEST = 2.0  # pixels of the size compared
_TOLERANCE = 0.02
_MODEL_PIXELS = 0.1
_ROUGH_STEP = 0.6  # of a frame interval: a pose that its neighbours' middle misses by more says nothing about the time in between
_POINTS = 2000
_FEWEST = 4  # training frames
_STILL = 1e-3  # pixels per standard deviation: less does not count as motion
_DECIDED = 0.9  # of the prior's standard deviation


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
    status: Status = estimate.status
    reason = estimate.reason
    if 1.96 * std_log > widest:
        status, reason = (
            "unobservable",
            (
                f"with the calibration refined, the scale is left open by a factor of {math.exp(1.96 * std_log):.2g} to either side."
            ),
        )
    return replace(
        estimate,
        sfm_per_metre=math.exp(theta),
        std_log=std_log,
        ci95=(math.exp(theta - 1.96 * std_log), math.exp(theta + 1.96 * std_log)),
        status=status,
        reason=reason,
        frames=[f.name for f in frames],
        local=Scan.of(np.array(curves.thetas), curves.values(), [f.name for f in frames]),
        calibration_std_log=None if std is None else calibration,
        renders=estimate.renders + pictures.renders_in_all() + len(frames) * len(curves.thetas),
        refinement=refinement,
    )


@dataclass(frozen=True)
class Unknown:
    """A number that is refined beside ln s.

    Attributes:
        name, unit: for people. per_unit: of the unit, in one of the change's amount.
        change: (rig, amount) → rig. std: the prior's, in amounts.
    """

    name: str
    unit: str
    per_unit: float
    change: Change
    std: float

    def posterior(self, u: float, std: float) -> Freedom:
        """In the unit for people, from u (in standard deviations of the prior) and the amount's standard deviation."""
        mean, after, before = (value * self.per_unit for value in (u * self.std, std, self.std))
        return Freedom(self.name, self.unit, mean, after, before, bool(after <= _DECIDED * before))


def unknowns(rig: Rig, names: Sequence[str]) -> list[Unknown]:
    """What `ScaleConfig.refine` names, with standard deviations from the rig, or the defaults where it states none (or zero)."""
    given = rig.calibration_std or CalibrationStd()
    spread = {k: getattr(given, k) or getattr(DEFAULT_STD, k) for k in ("rotation_rad", "baseline_direction", "thermal_focal")}
    ways, degrees = freedoms(rig, CalibrationStd(**spread)), math.degrees(1.0)
    table = [("rotation", f"rotation about {axis}", "°", degrees, way) for axis, way in zip("xyz", ways[:3], strict=True)]
    table += [("baseline-direction", f"baseline direction, {i}", "%", 100.0, w) for i, w in zip("ab", ways[3:5], strict=True)]
    table += [("focal", "thermal focal length", "%", 100.0, ways[5])]
    table += [("time-offset", "time offset", "frame intervals", 1.0, (_later, TIME_OFFSET_STD))]
    return [Unknown(name, unit, per, change, std) for key, name, unit, per, (change, std) in table if key in names]


def stated(rig: Rig, besides: Sequence[str]) -> list[Unknown]:
    """What the rig says is uncertain and is not refined: held, and its uncertainty passed on to the scale."""
    std = rig.calibration_std or CalibrationStd()
    fields = {"rotation": std.rotation_rad, "baseline-direction": std.baseline_direction, "focal": std.thermal_focal}
    return unknowns(rig, [name for name, value in fields.items() if value > 0 and name not in besides])


def _later(rig: Rig, amount: float) -> Rig:
    return replace(rig, time_offset=rig.time_offset + amount)


def check_refinable(scene: Scene, names: Sequence[str]) -> None:
    """Before long work: is there enough to refine from? A time offset needs frames that follow each other.

    Raises:
        RtgsError: too few training frames; or, for a time offset, too few frames with both neighbours, or camera positions that do not
            run smoothly in name order.
    """
    if names and len(scene.train_frames) < _FEWEST:
        raise RtgsError(
            f"scale.refine: {len(scene.train_frames)} training frames; the calibration is refined from {_FEWEST} or more. Leave it out."
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


@dataclass(frozen=True, eq=False)
class Point:
    """What the frames say at one place x = (θ, u).

    Attributes:
        losses: `[F]`. gradients: `[F, K]`, of each frame. gauss_newton: `[K, K]`, mean over frames.
    """

    x: Vector
    losses: Vector
    gradients: Vector
    gauss_newton: Vector

    @property
    def gradient(self) -> Vector:
        return self.gradients.mean(axis=0)


class Joint:
    """L(θ, u) of a scene's frames: u are the unknowns' amounts in standard deviations of their priors."""

    def __init__(self, scene: Scene, found: Sequence[Unknown], counter: Counter) -> None:
        self.scene, self.unknowns, self.counter = scene, tuple(found), counter
        self.size = 1 + len(found)
        self.prior = np.diag([0.0, *np.ones(len(found))])  # P: precision; nothing is known about θ

    def rig(self, x: Vector) -> Rig:
        rig = self.scene.rig
        for unknown, u in zip(self.unknowns, x[1:], strict=True):
            rig = unknown.change(rig, float(u) * unknown.std)
        return rig

    def scene_at(self, x: Vector) -> Scene:
        return replace(self.scene, capture=replace(self.scene.capture, rig=self.rig(x)))

    def evaluate(self, objective: Objective, indices: Sequence[int], x: Vector) -> Point:
        """One picture with its tangents a frame."""
        here, s = self.scene_at(x), math.exp(x[0])
        ends = [[self.scene_at(x + sign * _DIFFERENCE * e) for sign in (-1, 1)] for e in np.eye(self.size)]
        scales = [[math.exp(x[0] + sign * _DIFFERENCE * e[0]) for sign in (-1, 1)] for e in np.eye(self.size)]
        found = []
        for i in indices:
            name = objective.frames[i].name
            pose = here.thermal_from_world(name, s)
            ways = [_way(pair, at, name, pose) for pair, at in zip(ends, scales, strict=True)]
            found.append(objective.products_from(i, here.rig.thermal, pose, ways))
            self.counter(f"joint refinement, s = {s:.5g}")
        return Point(
            x,
            np.array([p.loss for p in found]),
            np.array([p.slope for p in found]),
            np.mean([p.curvature for p in found], axis=0),
        )

    def pixels(self, x: Vector, gaussians: Gaussians) -> Vector:
        """`[K]`: how far the picture moves per unit of each of x, in thermal pixels (90th percentile over the model's points)."""
        names = [f.name for f in self.scene.train_frames]
        names = names[:: -(-len(names) // 6)]
        means = gaussians.means.detach().to(torch.float64).cpu().numpy()
        points = means[np.random.default_rng(0).permutation(len(means))[:_POINTS]]
        moved: list[list[Vector]] = [[] for _ in range(self.size)]
        for name in names:
            before = _project(self.scene_at(x), name, x[0], points)
            seen = np.isfinite(before).all(axis=1)
            for k, e in enumerate(np.eye(self.size)):
                there = x + _DIFFERENCE * e
                moved[k].append((_project(self.scene_at(there), name, there[0], points) - before)[seen] / _DIFFERENCE)
        found = [float(np.nanpercentile(np.linalg.norm(np.concatenate(m), axis=1), 90)) for m in moved]
        return np.maximum(np.nan_to_num(found), _STILL)

    def hessian(self, objective: Objective, indices: Sequence[int], x: Vector, steps: Vector) -> Vector:
        """`[K, K]`: of the mean loss, by central differences of its gradient."""
        rows = []
        for e, h in zip(np.eye(self.size), steps, strict=True):
            after, before = (self.evaluate(objective, indices, x + sign * h * e).gradient for sign in (1, -1))
            rows.append((after - before) / (2 * h))
        matrix = np.array(rows)
        return (matrix + matrix.T) / 2


def _way(ends: Sequence[Scene], scales: Sequence[float], name: str, pose: SE3) -> Direction:
    before, after = (scene.thermal_from_world(name, s) for scene, s in zip(ends, scales, strict=True))
    derivative = SE3(
        (after.rotation - before.rotation) / (2 * _DIFFERENCE), (after.translation - before.translation) / (2 * _DIFFERENCE)
    )
    lens = {k: (getattr(ends[1].rig.thermal, k) - getattr(ends[0].rig.thermal, k)) / (2 * _DIFFERENCE) for k in ("fl_x", "fl_y")}
    return replace(Direction.between(derivative, pose), **lens)


def _project(scene: Scene, name: str, theta: float, points: Vector) -> Vector:
    """`[P, 2]` pixels; NaN outside of the picture."""
    camera = scene.rig.thermal
    x, y, z = scene.thermal_from_world(name, math.exp(theta)).apply(points).T
    with np.errstate(all="ignore"):
        uv = np.stack([camera.fl_x * x / z + camera.cx, camera.fl_y * y / z + camera.cy], axis=1)
    inside = (z > 0) & (np.abs(uv - [camera.width / 2, camera.height / 2]) < [camera.width / 2, camera.height / 2]).all(axis=1)
    return np.where(inside[:, None], uv, np.nan)


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


def bias(hessian: Vector, pixels: Vector) -> Vector:
    """`[K, K]`: covariance of the gradient that model errors leave, all frames alike.

    Edges of a render lie beside those of the photograph by some tenth of a pixel, in fields as smooth as those of the unknowns
    themselves: x is off by as much as makes such a field. A tenth of it has no such form, so that what the unknowns do alike does not
    cancel it.
    """
    alike = hessian / pixels
    alone = 0.1 * np.diag(hessian) / pixels
    return _MODEL_PIXELS**2 * (alike @ alike.T + np.diag(alone**2))


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
            scatter = noise(here.gradients[:, free]) + bias(curved, pixels[free])
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
        step *= min(1.0, _LONGEST / float(np.abs(step * pixels).max()))
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
