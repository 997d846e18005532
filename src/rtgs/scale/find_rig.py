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
from rtgs.scale.free_rig import EVERYTHING, ROUGHLY, SHIFT, SIZE, TURN, WITHOUT_BASELINE, ZOOM, FreeRig, FreeRigLoss, Here, Vector
from rtgs.scale.interval import WIDEST, model_pixels
from rtgs.scale.model_bias import model_bias
from rtgs.scale.posterior import bias_of, covariance, gradient_covariance, true_share
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
_HESSIAN_FRAMES, _HESSIAN_PIXELS = 8, 0.5
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
    down = [with_baseline[0]]
    for halved in range(coarsest - 1, 0, -1):
        down.append(loss.descend(halved, some, down[-1].rig, EVERYTHING, down[-1].curvature))
    best = down[-1]
    fine = loss.finest_only()
    fine, here = _softened(problem, fine, _settled(fine, best.rig, EVERYTHING, best.curvature))
    rest = _Beside(
        still=_without_one(loss, coarsest, some, [h.rig for h in down], (found[0].rig, _without_baseline(best.rig, depth))),
        bias=model_bias(problem, depth, search),
        agreements=tuple(c.agreement for c in candidates),
        doubt=_rivals(loss, coarsest, with_baseline),
        contrast=_contrast(loss, coarsest, every, here.rig),
    )
    return _judged(fine, here, rest)


@dataclass(frozen=True, eq=False)
class _Still:
    """The best rig without a baseline, and the frames' losses `[F]` with one and without, at the size at which they were compared."""

    rig: FreeRig
    losses: Vector
    without: Vector

    @property
    def gain(self) -> float:
        """By how many standard errors a baseline makes the edges agree better."""
        return significance(self.without - self.losses)


@dataclass(frozen=True, eq=False)
class _Beside:
    """What is known beside the rig that was found.

    Attributes:
        still: the best rig without a baseline.
        bias: by how much the RGB model moves every rig. agreements: of the candidates.
        doubt: another place that fits as well. contrast: as in `FoundRig`.
    """

    still: _Still
    bias: FreeRig
    agreements: tuple[float, ...]
    doubt: str
    contrast: float


def _settled(loss: FreeRigLoss, rig: FreeRig, free: NDArray[np.bool_], known: Vector | None = None) -> Here:
    """Down at full size: with some of the frames, then the last of the way with all of them."""
    every = range(len(loss.pictures.frames))
    before = loss.descend(0, some_of(every, _DESCENT_FRAMES), rig, free, known, tolerance=ROUGHLY)
    return loss.descend(0, every, before.rig, free, before.curvature)


def _without_one(
    loss: FreeRigLoss, coarsest: int, indices: Sequence[int], best: Sequence[FreeRig], starts: Sequence[FreeRig]
) -> _Still:
    """The best place without a baseline, at sizes up to half of the full one, and no larger than needed to see that there is one.

    Args:
        best: rigs with a baseline, from the coarsest size on. starts: where to begin.
    """
    every = range(len(loss.pictures.frames))
    here = min((loss.descend(coarsest, indices, rig, WITHOUT_BASELINE) for rig in starts), key=lambda h: h.loss)
    halved = coarsest
    while True:
        with_one = best[coarsest - halved]
        still = _Still(here.rig, loss.losses(halved, every, with_one), loss.losses(halved, every, here.rig))
        if still.gain >= UNLIKELY or halved <= 1:
            return still
        halved -= 1
        here = loss.descend(halved, indices, here.rig, WITHOUT_BASELINE, here.curvature)


def _neighbours(loss: FreeRigLoss, halved: int, indices: Sequence[int], best: Here) -> list[Here]:
    """Minima a few pixels beside a place, from where descents start: what repeats has them, and a descent ends in the nearest."""
    steps = np.array(_BESIDE) * 2.0**halved
    losses = np.empty((len(steps), len(steps)))
    for i, down in enumerate(steps):
        for j, right in enumerate(steps):
            step = np.zeros(SIZE)
            step[0], step[1] = down, right
            losses[i, j] = loss.losses(halved, indices, best.rig.moved(step * loss.units)).mean()
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


def _rivals(loss: FreeRigLoss, halved: int, found: Sequence[Here]) -> str:
    """A doubt where another place is not clearly worse than the best, by all frames; empty where there is none."""
    every, best = range(len(loss.pictures.frames)), found[0].rig
    for other in found[1:]:
        if not _apart(best, other.rig):
            continue
        if significance(loss.losses(halved, every, other.rig) - loss.losses(halved, every, best)) < UNLIKELY:
            turn = math.degrees(float(np.linalg.norm(axis_angle_from_rotation(best.rotation.T @ other.rig.rotation))))
            return f"the edges meet as well with the thermal camera turned by another {turn:.2g}°."
    return ""


def _contrast(loss: FreeRigLoss, halved: int, indices: Sequence[int], rig: FreeRig) -> float:
    """By how many standard errors the edges agree better here than with the camera turned aside, to the worst of four sides."""

    def losses(step: Vector) -> Vector:
        return loss.losses(halved, indices, rig.moved(step))

    centre, pixels = losses(np.zeros(SIZE)), _ASIDE_PIXELS * 2.0**halved
    found = []
    for k in (0, 1):
        for sign in (-1, 1):
            step = np.zeros(SIZE)
            step[k] = sign * pixels * loss.units[k]
            found.append(significance(losses(step) - centre))
    return min(found)


def _softened(problem: Problem, loss: FreeRigLoss, here: Here) -> tuple[FreeRigLoss, Here]:
    """Once more at full size with renders as soft as the thermal images are, where they are softer."""
    pictures, every = loss.pictures, range(len(loss.pictures.frames))
    length = float(np.linalg.norm(here.rig.translation))
    if length == 0.0:
        return loss, here
    placed, s = _placed(loss, here.rig, 1.0)
    scene = replace(pictures.scene, capture=replace(pictures.scene.capture, rig=placed))
    soft = softness(replace(pictures, scene=scene).objective(), every, math.log(s), problem.progress)
    if soft.blur_px == 0.0:
        return loss, here
    loss = replace(loss, pictures=replace(pictures, blur_px=soft.blur_px))
    return loss, _settled(loss, here.rig, EVERYTHING, here.curvature)


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
    every = range(len(loss.pictures.frames))
    some = some_of(every, _HESSIAN_FRAMES)

    def gauss_newton(of: Here) -> Vector:
        matrix = of.gauss_newton[np.ix_(free, free)]
        return np.asarray(matrix + np.diag(_ALIKE * np.diag(matrix)))

    there = loss.evaluate(0, some, here.rig, curvature=True)
    share = true_share(loss.hessian(there, 0, some, free, _HESSIAN_PIXELS), gauss_newton(there))
    curved = share * gauss_newton(loss.evaluate(0, every, here.rig, curvature=True))
    std = np.full(int(free.sum()), model_pixels(loss.pictures.blur_px))
    scatter = gradient_covariance(here.gradients[:, free]) + bias_of(curved, std)
    return covariance(curved, scatter, np.zeros_like(curved), 0.0)


def _judged(loss: FreeRigLoss, here: Here, rest: _Beside) -> RigFromCapture:
    """Whether the baseline is decided, and how sure everything is."""
    scene = loss.pictures.scene
    start = scene.rig.start
    assert start is not None
    full = _posterior(loss, here, EVERYTHING) * np.outer(loss.units, loss.units)
    chosen = here.rig.without(rest.bias)
    length = float(np.linalg.norm(chosen.translation))
    along, shift = chosen.translation / max(length, 1e-30), full[SHIFT, SHIFT]
    std_log = math.sqrt(float(along @ shift @ along)) / max(length, 1e-30)
    apart = float(chosen.translation @ np.linalg.solve(shift, chosen.translation))
    seen = rest.still.gain >= UNLIKELY and apart > _NO_BASELINE and std_log < _HOPELESS
    unit = start.baseline_m or 1.0
    if seen:
        rig, s = _placed(loss, chosen, unit)
    else:  # both cameras in the same place: a thousandth of a pixel apart
        chosen, full = _without_seen_baseline(loss, here.rig, rest.still.rig)
        rig, s = _placed(loss, replace(chosen, translation=1e-3 * loss.units[SHIFT] * np.array([1.0, 0.0, 0.0])), unit)
    freedoms, rows = _freedoms(loss, chosen, full, seen)
    doubt = rest.doubt
    if rest.contrast < UNLIKELY:
        doubt = "no rotation within reach makes the edges agree clearly better than its neighbours do."
    found = FoundRig(
        baseline_decided=seen and QUANTILE_95 * std_log <= WIDEST,
        baseline_seen=seen,
        baseline_sfm=length * scene.given_from_world.factor if seen else None,
        baseline_std_log=std_log if seen else None,
        baseline_m=start.baseline_m,
        loss_without_baseline=float(rest.still.without.mean()),
        loss=float(rest.still.losses.mean()),
        significance=rest.still.gain,
        candidates=rest.agreements,
        contrast=rest.contrast,
    )
    return RigFromCapture(rig, s, found, freedoms, rows @ full @ rows.T, doubt, 0)


def _without_seen_baseline(loss: FreeRigLoss, with_one: FreeRig, rig: FreeRig) -> tuple[FreeRig, Vector]:
    """The rig of two cameras in the same place, and its covariance `[7, 7]`.

    There may be a baseline that is not seen. As far as rotation and focal length move when one is allowed, so far they are uncertain.

    Args:
        with_one: the best rig with a baseline. rig: where to start.
    """
    held = np.ix_(WITHOUT_BASELINE, WITHOUT_BASELINE)
    here = _settled(loss, rig, WITHOUT_BASELINE)
    full = np.zeros((SIZE, SIZE))
    full[held] = _posterior(loss, here, WITHOUT_BASELINE) * np.outer(loss.units, loss.units)[held]
    other = np.zeros(SIZE)
    other[TURN] = axis_angle_from_rotation(here.rig.rotation.T @ with_one.rotation)
    other[ZOOM] = with_one.log_zoom - here.rig.log_zoom
    return here.rig, full + np.outer(other, other)


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
