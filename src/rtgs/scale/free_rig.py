"""The loss as a function of a rig of which nothing is held: rotation, translation and focal length.

Seven unknowns: a turn about the thermal camera's three axes, the translation in world units, and ln of the focal length. Each is counted
in steps that move the picture by about a pixel. The translation may be zero, where ln s has no meaning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.renderer import Direction
from rtgs.scale.progress import RenderProgress
from rtgs.scale.thermal_targets import Pictures

Vector = NDArray[np.float64]

TURN, SHIFT, ZOOM = slice(0, 3), slice(3, 6), 6
SIZE = 7
WITHOUT_BASELINE = np.array([True, True, True, False, False, False, True])
EVERYTHING = np.ones(SIZE, dtype=bool)

_RIM = 0.35  # of the width: how far from the middle a roll and a zoom are counted
_MOST_STEPS = 25
_MOST_CUTS = 5
_LONGEST = 2.0  # pixels of the size compared
_FIRST = 0.5  # pixels: how long the first step is, since Gauss–Newton overstates the curvature
_TOLERANCE = 0.03  # pixels of the size compared
ROUGHLY = 0.1  # likewise, where another descent goes on from there
_DAMPED = 0.2  # Powell's damping of BFGS


@dataclass(frozen=True, eq=False)
class FreeRig:
    """A rig on the way.

    Attributes:
        rotation: `[3, 3]`, of `rgb_from_thermal`. translation: `[3]`, of the same, in world units. log_zoom: ln of focal length over the
            one it started from.
    """

    rotation: Vector
    translation: Vector
    log_zoom: float

    def moved(self, step: Vector) -> FreeRig:
        """After a step `[7]` in radians, world units and ln."""
        turn = rotation_from_axis_angle(step[TURN])
        return FreeRig(self.rotation @ turn, self.translation + step[SHIFT], self.log_zoom + float(step[ZOOM]))

    def without(self, motion: FreeRig) -> FreeRig:
        """The rig of which this one is the same with the thermal camera moved so in its own axes."""
        rotation = self.rotation @ motion.rotation.T
        return FreeRig(rotation, self.translation - rotation @ motion.translation, self.log_zoom - motion.log_zoom)

    @property
    def rgb_from_thermal(self) -> SE3:
        """The transform, translation in world units."""
        return SE3(self.rotation, self.translation)


@dataclass(frozen=True, eq=False)
class Here:
    """What the frames say at one rig.

    Attributes:
        losses: `[F]`. gradients: `[F, 7]`, of each frame, by the unknowns in pixels.
        gauss_newton: `[7, 7]`, mean over frames; zeros where it was not asked for.
        curvature: `[Q, Q]`, of the mean loss among what a descent has moved, as it has come to know it; None without a descent.
    """

    rig: FreeRig
    losses: Vector
    gradients: Vector
    gauss_newton: Vector
    curvature: Vector | None = None

    @property
    def loss(self) -> float:
        return float(self.losses.mean())

    @property
    def gradient(self) -> Vector:
        return np.asarray(self.gradients.mean(axis=0))


@dataclass(frozen=True, eq=False)
class FreeRigLoss:
    """The loss of pictures over all rigs.

    Attributes:
        pictures: thermal images; the poses of their scene's RGB cameras count, its rig does not.
        camera: the thermal camera that `log_zoom` counts from.
        units: `[7]`: radians, world units and ln that move the picture by about a pixel.
    """

    pictures: Pictures
    camera: Camera
    units: Vector
    progress: RenderProgress

    @staticmethod
    def of(pictures: Pictures, depth: float, progress: RenderProgress) -> FreeRigLoss:
        """With units for things at this depth, in world units."""
        camera = pictures.scene.rig.thermal
        pixel, rim = 1 / camera.fl_x, 1 / (_RIM * camera.width)
        units = np.array([pixel, pixel, rim, depth * pixel, depth * pixel, depth * rim, rim])
        return FreeRigLoss(pictures, camera, units, progress)

    def finest_only(self) -> FreeRigLoss:
        """With pictures of full size compared by their finest level alone (Eq. 6), and not per edge.

        Soft edges are pulled aside by their neighbours, which differ between the modalities: at coarser levels more than at the finest.
        """
        pictures = self.pictures
        return replace(
            self, pictures=replace(pictures, level_weights=(1.0,), comparison=replace(pictures.comparison, per_edge=False))
        )

    def thermal_camera(self, rig: FreeRig) -> Camera:
        """As zoomed."""
        zoom = math.exp(rig.log_zoom)
        return replace(self.camera, fl_x=self.camera.fl_x * zoom, fl_y=self.camera.fl_y * zoom)

    def directions(self, rig: FreeRig) -> list[Direction]:
        """How the thermal camera changes with each unknown, a pixel at a time."""
        camera, back = self.thermal_camera(rig), -rig.rotation.T
        turns = [Direction(rotation_rad=_triple(-self.units[k] * np.eye(3)[k])) for k in range(3)]
        shifts = [Direction(translation=_triple(self.units[3 + k] * back[:, k])) for k in range(3)]
        return [*turns, *shifts, Direction(fl_x=camera.fl_x * self.units[ZOOM], fl_y=camera.fl_y * self.units[ZOOM])]

    def evaluate(self, halved: int, indices: Sequence[int], rig: FreeRig, *, curvature: bool = False) -> Here:
        """Losses and derivatives of frames, at pictures halved so many times."""
        objective, camera, directions = self.pictures.objective(halved), self.thermal_camera(rig), self.directions(rig)
        found = []
        for i in indices:
            found.append(objective.products(i, camera, self._pose(i, rig), directions, curvature=curvature))
            self.progress("rig")
        gauss_newton = np.mean([p.curvature for p in found], axis=0) if curvature else np.zeros((SIZE, SIZE))
        return Here(rig, np.array([p.loss for p in found]), np.array([p.slope for p in found]), gauss_newton)

    def losses(self, halved: int, indices: Sequence[int], rig: FreeRig) -> Vector:
        """`[F]`: losses of frames alone, in a third of the time of `evaluate`."""
        objective, camera, found = self.pictures.objective(halved), self.thermal_camera(rig), []
        for i in indices:
            found.append(objective.loss_seen_by(i, camera, self._pose(i, rig)))
            self.progress("rig")
        return np.array(found)

    def _pose(self, index: int, rig: FreeRig) -> SE3:
        """`camera_from_world` of a frame's thermal camera."""
        return (self.pictures.scene.world_from_rgb[self.pictures.frames[index].name] @ rig.rgb_from_thermal).inverse()

    def descend(
        self,
        halved: int,
        indices: Sequence[int],
        rig: FreeRig,
        free: NDArray[np.bool_],
        known: Vector | None = None,
        *,
        tolerance: float = _TOLERANCE,
    ) -> Here:
        """Down the mean loss by BFGS, beginning with the Gauss–Newton matrix.

        That matrix overstates the curvature, a hundredfold on a noisy sensor. The first step is therefore half a pixel long, and the
        change of the slopes along it scales the whole matrix; later ones change it as BFGS does, damped.

        Args:
            free: `[7]`, which unknowns move.
            known: `[Q, Q]`, the curvature that another descent has come to, in place of the Gauss–Newton matrix. Its scale may be wrong.
            tolerance: a step that is shorter ends the descent; pixels of the size compared.
        """
        pixel, first = 2.0**halved, True
        here = self.evaluate(halved, indices, rig, curvature=known is None)
        if known is None:
            curvature = here.gauss_newton[np.ix_(free, free)]
            curvature = curvature + np.diag(1e-3 * np.diag(curvature) + 1e-9 * max(float(np.diag(curvature).max()), 1e-12))
        else:
            curvature = known
        for _ in range(_MOST_STEPS):
            slope = here.gradient[free]
            if not slope.any():
                break
            step: Vector = np.asarray(-np.linalg.solve(curvature, slope), np.float64)
            if first and known is None and (stretch := _FIRST * pixel / float(np.abs(step).max())) > 1:
                step, curvature = stretch * step, curvature / stretch
            longest = (_FIRST if first else _LONGEST) * pixel
            step *= min(1.0, longest / float(np.abs(step).max()))
            for _cut in range(_MOST_CUTS):
                there = self.evaluate(halved, indices, rig.moved(self._full(step, free)))
                curvature = _updated(curvature, step, there.gradient[free] - slope, rescale=first)
                first = False
                if there.loss < here.loss:
                    break
                step = 0.35 * step
            if there.loss >= here.loss:
                break
            here, rig = there, there.rig
            if float(np.abs(step).max()) < max(tolerance, ROUGHLY if halved else 0.0) * pixel:
                break
        return replace(here, curvature=curvature)

    def hessian(self, here: Here, halved: int, indices: Sequence[int], free: NDArray[np.bool_], pixels: float) -> Vector:
        """`[Q, Q]`: of the mean loss among what is free, by differences of the gradient over so many pixels.

        Args:
            here: what these frames say at the place.
        """
        rows = []
        for k in np.flatnonzero(free):
            there = self.evaluate(halved, indices, here.rig.moved(pixels * np.eye(SIZE)[k] * self.units))
            rows.append((there.gradient - here.gradient)[free] / pixels)
        matrix = np.array(rows)
        return np.asarray((matrix + matrix.T) / 2)

    def _full(self, step: Vector, free: NDArray[np.bool_]) -> Vector:
        full = np.zeros(SIZE)
        full[free] = step
        return full * self.units


def _updated(matrix: Vector, step: Vector, change: Vector, *, rescale: bool) -> Vector:
    """The curvature after a step along which the slope has changed so: BFGS, damped so that it stays positive."""
    along = float(step @ change)
    if rescale and along > 0:
        matrix = matrix * float(np.clip(along / (step @ matrix @ step), 0.02, 50.0))
    moved = matrix @ step
    expected = float(step @ moved)
    share = 1.0 if along >= _DAMPED * expected else (1 - _DAMPED) * expected / (expected - along)
    change = share * change + (1 - share) * moved
    return np.asarray(matrix - np.outer(moved, moved) / expected + np.outer(change, change) / float(step @ change))


def _triple(values: Vector) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
