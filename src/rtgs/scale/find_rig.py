"""A rig from the capture itself: rotation, translation and thermal focal length, without a start from a person.

1. `rotation_search`: all rotations and focal lengths within reach, without a baseline.
2. `free_rig`: down from the best of them, coarse to fine: first without a baseline, then with one.
3. Here: how sure the answer is, and whether the images tell the baseline at all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import special
from scipy.ndimage import minimum_filter

from rtgs.config import ScaleConfig
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.scale.bracket import Bracket
from rtgs.scale.checks import softness
from rtgs.scale.comparison import Comparison
from rtgs.scale.free_rig import EVERYTHING, SHIFT, SIZE, TURN, WITHOUT_BASELINE, ZOOM, FreeRig, FreeRigLoss, Here, Vector
from rtgs.scale.interval import WIDEST, model_pixels
from rtgs.scale.posterior import CALIBRATION_PIXELS, bias_of, covariance, gradient_covariance, positive
from rtgs.scale.problem import Problem, usable_frames
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import FoundRig, Freedom
from rtgs.scale.resampling import QUANTILE_95, UNLIKELY, significance
from rtgs.scale.rotation_search import rotation_candidates
from rtgs.scale.thermal_targets import EPSILON_FRAMES, Pictures, halvings, some_of

_SEARCH_FRAMES = 8
_DESCENT_FRAMES = 16
_CANDIDATES = 4
_CONTINUED = 2  # of the candidates after the descent without a baseline
_BESIDE = (-4.0, -2.5, -1.25, 0.0, 1.25, 2.5, 4.0)  # pixels of the size of the search
_HOPS = 2
_SAME_DEG, _SAME_ZOOM = 1.0, 0.02  # two candidates that have come to the same place
_HESSIAN_PIXELS = 0.5
_ASIDE_PIXELS = 8.0  # of the size of the search: there the edges must agree less
_HOPELESS = 1.0  # standard deviation of ln of the baseline's length: its direction is not told either
_NO_BASELINE = float(
    special.chdtri(3, 1 - 0.997)
)  # of a translation's squared length in standard deviations, where there is none
_ALIKE = 1e-5  # of the curvatures: over a plane, shift and turn are the same but for rounding
_CENTRE_STD = 0.01  # of the image's width: how far a principal point lies from the middle
_ROTATION_PRIOR = 1 / math.sqrt(3)  # of the reach: an even distribution


@dataclass(frozen=True, eq=False)
class RigFromCapture:
    """What was found.

    Attributes:
        rig: `start` is None; its translation has the length that `Rig.start` gives, or 1.
        sfm_per_metre: SfM units of the baseline for each metre, or for its whole length where that is not known. Without a baseline that
            is decided, a number so small that both cameras stand in the same place.
        found: for the record. freedoms, covariance: posterior of rotation, focal length and, where decided, baseline; `[1 + K, 1 + K]`
            with ln of the baseline's length first.
        doubt: why the rig cannot be believed; empty where it can.
        renders: pictures rendered.
    """

    rig: Rig
    sfm_per_metre: float
    found: FoundRig
    freedoms: tuple[Freedom, ...]
    covariance: Vector
    doubt: str
    renders: int


def find_rig(
    scene: Scene, model: RgbModel, config: ScaleConfig, comparison: Comparison, progress: RenderProgress
) -> RigFromCapture:
    """Find the rig of a scene whose rig has a `start`.

    Raises:
        RtgsError: no training frame.
    """
    frames = usable_frames(scene, config)
    problem = Problem(scene, model, frames, Bracket(math.nan, math.nan), config, comparison, progress)
    progress.plan(EPSILON_FRAMES + _SEARCH_FRAMES + 900)
    pictures = Pictures.of(problem)
    every = range(len(frames))
    search = some_of(every, _SEARCH_FRAMES)
    candidates = rotation_candidates(scene, model, [frames[i] for i in search], pictures.thermal, progress, most=_CANDIDATES)
    starts = [FreeRig(c.rotation, np.zeros(3), math.log(c.zoom)) for c in candidates]
    depth = _typical_depth(scene, model, [frames[i].name for i in search], starts[0])
    loss = FreeRigLoss.of(pictures, depth, progress)
    some, coarsest = some_of(every, _DESCENT_FRAMES), halvings(scene)

    found = _distinct([loss.descend(coarsest, search, start, WITHOUT_BASELINE) for start in starts])[:_CONTINUED]
    found = _distinct([*found, *_neighbours(loss, coarsest, search, found[0])])[:_CONTINUED]
    with_baseline = sorted((loss.descend(coarsest, some, h.rig, EVERYTHING) for h in found), key=lambda h: h.loss)
    best, without = with_baseline[0].rig, found[0].rig
    for halved in range(coarsest - 1, -1, -1):
        best = loss.descend(halved, every if halved == 0 else some, best, EVERYTHING).rig
    best, loss = _softened(problem, loss, best)
    here = loss.evaluate(0, every, best, curvature=True)
    for halved in range(coarsest, 0, -1):
        without = loss.descend(halved, some, without, WITHOUT_BASELINE).rig
    places = [loss.descend(0, every, rig, WITHOUT_BASELINE) for rig in (without, _without_baseline(best, depth))]
    still = loss.evaluate(0, every, min(places, key=lambda h: h.loss).rig, curvature=True)
    return _judged(
        loss, here, still, [c.agreement for c in candidates], _rivals(with_baseline), _contrast(loss, coarsest, some, best)
    )


def _neighbours(loss: FreeRigLoss, halved: int, indices: Sequence[int], best: Here) -> list[Here]:
    """Minima a few pixels beside a place, from where descents start: what repeats has them, and a descent ends in the nearest."""
    steps = np.array(_BESIDE) * 2.0**halved
    losses = np.empty((len(steps), len(steps)))
    for i, down in enumerate(steps):
        for j, right in enumerate(steps):
            step = np.zeros(SIZE)
            step[0], step[1] = down, right
            losses[i, j] = (
                best.loss if down == right == 0 else loss.evaluate(halved, indices, best.rig.moved(step * loss.units)).loss
            )
    lowest = np.argwhere(losses <= minimum_filter(losses, size=3, mode="nearest"))
    places = [(losses[i, j], steps[i], steps[j]) for i, j in lowest if steps[i] != 0 or steps[j] != 0]
    found = list[Here]()
    for _, down, right in sorted(places)[:_HOPS]:
        step = np.zeros(SIZE)
        step[0], step[1] = down, right
        found.append(loss.descend(halved, indices, best.rig.moved(step * loss.units), WITHOUT_BASELINE))
    return found


def _without_baseline(rig: FreeRig, depth: float) -> FreeRig:
    """The turn and the zoom by which a camera without a baseline sees things at this depth in the same place."""
    x, y, z = (rig.rotation.T @ rig.translation / depth).tolist()
    turn = rotation_from_axis_angle(np.array([-y, x, 0.0]))
    return FreeRig(rig.rotation @ turn, np.zeros(3), rig.log_zoom + z)


def _distinct(found: Sequence[Here]) -> list[Here]:
    """Best first, each place once."""
    kept = list[Here]()
    for here in sorted(found, key=lambda h: h.loss):
        if all(_apart(here.rig, other.rig) for other in kept):
            kept.append(here)
    return kept


def _apart(a: FreeRig, b: FreeRig) -> bool:
    turn = math.degrees(float(np.linalg.norm(axis_angle_from_rotation(a.rotation.T @ b.rotation))))
    return turn > _SAME_DEG or abs(a.log_zoom - b.log_zoom) > _SAME_ZOOM


def _rivals(found: Sequence[Here]) -> str:
    """A doubt where another place is not clearly worse than the best; empty where there is none."""
    for other in found[1:]:
        if _apart(found[0].rig, other.rig) and significance(other.losses - found[0].losses) < UNLIKELY:
            turn = math.degrees(float(np.linalg.norm(axis_angle_from_rotation(found[0].rig.rotation.T @ other.rig.rotation))))
            return f"the edges meet as well with the thermal camera turned by another {turn:.2g}°."
    return ""


def _contrast(loss: FreeRigLoss, halved: int, indices: Sequence[int], rig: FreeRig) -> float:
    """By how many standard errors the edges agree better here than with the camera turned aside, to the worst of four sides."""

    def losses(step: Vector) -> Vector:
        return loss.evaluate(halved, indices, rig.moved(step)).losses

    centre, pixels = losses(np.zeros(SIZE)), _ASIDE_PIXELS * 2.0**halved
    found = []
    for k in (0, 1):
        for sign in (-1, 1):
            step = np.zeros(SIZE)
            step[k] = sign * pixels * loss.units[k]
            found.append(significance(losses(step) - centre))
    return min(found)


def _softened(problem: Problem, loss: FreeRigLoss, rig: FreeRig) -> tuple[FreeRig, FreeRigLoss]:
    """Once more at full size with renders as soft as the thermal images are, where they are softer."""
    pictures, every = loss.pictures, range(len(loss.pictures.frames))
    length = float(np.linalg.norm(rig.translation))
    if length == 0.0:
        return rig, loss
    placed, s = _placed(loss, rig, 1.0)
    scene = replace(pictures.scene, capture=replace(pictures.scene.capture, rig=placed))
    soft = softness(replace(pictures, scene=scene).objective(), every, math.log(s), problem.progress)
    if soft.blur_px == 0.0:
        return rig, loss
    loss = replace(loss, pictures=replace(pictures, blur_px=soft.blur_px))
    return loss.descend(0, every, rig, EVERYTHING).rig, loss


def _placed(loss: FreeRigLoss, rig: FreeRig, baseline: float) -> tuple[Rig, float]:
    """The rig as a record, its baseline of this length, and `sfm_per_metre`."""
    scene = loss.pictures.scene
    length = float(np.linalg.norm(rig.translation))
    pose = SE3(rig.rotation, rig.translation * (baseline / length))
    s = length * scene.given_from_world.factor / baseline
    return replace(scene.rig, thermal=loss.thermal_camera(rig), rgb_from_thermal=pose, start=None), s


def _typical_depth(scene: Scene, model: RgbModel, names: Sequence[str], rig: FreeRig) -> float:
    """Harmonic mean of what the thermal camera sees, in world units: depth counts by how far it lets the picture move."""
    settings, camera = replace(model.settings, with_depth=True), scene.rig.thermal
    small = camera.resized(min(64, camera.width), max(1, round(camera.height * min(64, camera.width) / camera.width)))
    inverse = []
    for name in names:
        pose = (scene.world_from_rgb[name] @ SE3(rig.rotation, np.zeros(3))).inverse()
        with torch.no_grad():
            view = render(model.gaussians, small, pose, settings=settings)
        assert view.depth is not None
        covered = view.alpha > 0.5
        inverse.append((view.alpha[covered] / view.depth[covered].clamp_min(1e-12)).double().numpy())
    values = np.concatenate(inverse)
    return 1 / float(np.median(values)) if len(values) else 1.0


def _posterior(loss: FreeRigLoss, here: Here, free: NDArray[np.bool_]) -> Vector:
    """`[Q, Q]`: covariance of what was free, in pixels: the frames' scatter, and edges of the render beside those of the photograph."""
    frames = range(len(loss.pictures.frames))
    hessian = loss.hessian(0, some_of(frames, _DESCENT_FRAMES), here.rig, free, _HESSIAN_PIXELS)
    typical = here.gauss_newton[np.ix_(free, free)]
    typical = typical + np.diag(_ALIKE * np.diag(typical))
    curved = positive(hessian, typical)
    std = np.full(int(free.sum()), model_pixels(loss.pictures.blur_px, CALIBRATION_PIXELS))
    scatter = gradient_covariance(here.gradients[:, free]) + bias_of(curved, std)
    return covariance(curved, scatter, np.zeros_like(curved), 0.0)


def _judged(
    loss: FreeRigLoss, here: Here, still: Here, agreements: Sequence[float], rival: str, contrast: float
) -> RigFromCapture:
    """Whether the baseline is decided, and how sure everything is."""
    scene = loss.pictures.scene
    start = scene.rig.start
    assert start is not None
    gain = significance(still.losses - here.losses)
    matrix = _posterior(loss, here, EVERYTHING)
    full = matrix * np.outer(loss.units, loss.units)
    length = float(np.linalg.norm(here.rig.translation))
    along = here.rig.translation / max(length, 1e-30)
    std_log = math.sqrt(float(along @ full[SHIFT, SHIFT] @ along)) / max(length, 1e-30)
    shift = full[SHIFT, SHIFT]
    apart = float(here.rig.translation @ np.linalg.solve(shift, here.rig.translation))
    there = gain >= UNLIKELY and apart > _NO_BASELINE and std_log < _HOPELESS
    decided = there and QUANTILE_95 * std_log <= WIDEST
    unit = start.baseline_m or 1.0
    if there:
        rig, s = _placed(loss, here.rig, unit)
        chosen = here
    else:  # both cameras in the same place: a thousandth of a pixel apart
        tiny = replace(still.rig, translation=1e-3 * loss.units[SHIFT] * np.array([1.0, 0.0, 0.0]))
        rig, s = _placed(loss, tiny, unit)
        chosen = still
        small = _posterior(loss, still, WITHOUT_BASELINE)
        full = np.zeros((SIZE, SIZE))
        full[np.ix_(WITHOUT_BASELINE, WITHOUT_BASELINE)] = small * np.outer(*[loss.units[WITHOUT_BASELINE]] * 2)
    freedoms, rows = _freedoms(loss, chosen.rig, full, there)
    doubt = rival
    if contrast < UNLIKELY:
        doubt = "no rotation within reach makes the edges agree clearly better than its neighbours do."
    factor = scene.given_from_world.factor
    found = FoundRig(
        baseline_decided=decided,
        baseline_seen=there,
        baseline_sfm=length * factor if there else None,
        baseline_std_log=std_log if there else None,
        baseline_m=start.baseline_m,
        loss_without_baseline=still.loss,
        loss=here.loss,
        significance=gain,
        candidates=tuple(agreements),
        contrast=contrast,
    )
    return RigFromCapture(rig, s, found, freedoms, rows @ full @ rows.T, doubt, 0)


def _freedoms(loss: FreeRigLoss, rig: FreeRig, full: Vector, there: bool) -> tuple[tuple[Freedom, ...], Vector]:
    """The posterior for people, and `[1 + K, 7]`: what ln of the baseline and each freedom are of the unknowns, to first order."""
    scene = loss.pictures.scene
    start, begun = scene.rig.start, scene.rig.rgb_from_thermal.rotation
    assert start is not None
    rows = [np.zeros(SIZE)]
    length = float(np.linalg.norm(rig.translation))
    if there:
        rows[0][SHIFT] = rig.translation / length**2
    turn = np.degrees(axis_angle_from_rotation(begun.T @ rig.rotation))
    # A principal point that is off the middle looks like a turn.
    hidden = 0.0 if start.centre_known else math.degrees(_CENTRE_STD * loss.camera.width / loss.camera.fl_x)
    freedoms = list[Freedom]()
    for k, name in enumerate("xyz"):
        rows.append(math.degrees(1.0) * np.eye(SIZE)[TURN][k])
        std = math.hypot(math.sqrt(full[k, k]) * math.degrees(1.0), hidden if name != "z" else 0.0)
        prior = start.reach_deg * _ROTATION_PRIOR
        freedoms.append(Freedom(f"rotation about {name}", "°", float(turn[k]), std, prior, std < prior))
    rows.append(100.0 * np.eye(SIZE)[ZOOM])
    std, prior = 100.0 * math.sqrt(full[ZOOM, ZOOM]), 100.0 * start.focal_reach * _ROTATION_PRIOR
    freedoms.append(Freedom("thermal focal length", "%", 100.0 * math.expm1(rig.log_zoom), std, prior, std < prior))
    if there:
        for k, name in enumerate(("to the right", "downwards", "forwards")):
            rows.append(100.0 * np.eye(SIZE)[SHIFT][k] / length)
            share, std = 100.0 * float(rig.translation[k]) / length, 100.0 * math.sqrt(full[3 + k, 3 + k]) / length
            freedoms.append(Freedom(f"baseline's share {name}", "%", share, std, 100.0, True))
    return tuple(freedoms), np.array(rows)
