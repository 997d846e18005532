"""What one photograph shows of spots, and of the model's surface that they lie on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, median_filter

from rtgs.maths.geometry import SE3
from rtgs.models import ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.thermal.spot_places import Sighting
from rtgs.thermal.spot_regions import FLAT_SHARE, Region, highest

SOLID = 0.1  # opacity from which a pixel shows a surface: models have thin places
STEP_PX, MEDIAN = 4, 9  # a surface is the median depth over 9 × 9 of every 4th pixel: on plain surfaces depth has dents of 7 %
PLANE_PX = 24  # pixels around a region that the normal of its surface is taken from
STEEPEST = 0.35  # cosine: a view that looks along a surface need not show what is on it
_MARGIN_PX = 6.0  # nor need one that has it at the border of its image
_ROUNDS = 10

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """The model's surface in one view.

    Attributes:
        depth: `[h, w]`, of every 4th pixel, smoothed; infinite where nothing is. rough: before smoothing; things in front that are
            smaller than what is smoothed over are only there.
    """

    camera: Camera
    thermal_from_world: SE3
    depth: Floats
    rough: Floats

    def sees(self, place: Floats, normal: Floats) -> bool:
        """Whether the view shows a place `[3]` of the world, in its image, not hidden, and not too slantingly."""
        local = self.thermal_from_world.apply(place)
        ray = self.thermal_from_world.rotation.T @ local
        if local[2] <= 0 or -ray @ normal < STEEPEST * np.linalg.norm(ray):
            return False
        x, y = self.camera.project(local)
        if not (_MARGIN_PX <= x < self.camera.width - _MARGIN_PX and _MARGIN_PX <= y < self.camera.height - _MARGIN_PX):
            return False
        at = int(y) // STEP_PX, int(x) // STEP_PX
        return bool(min(abs(self.depth[at] - local[2]), abs(self.rough[at] - local[2])) <= FLAT_SHARE * local[2])

    def depth_of(self, rows: NDArray[np.int64], columns: NDArray[np.int64], rendered: Floats) -> Floats:
        """`[K]`: depth of a region's pixels: the smooth surface, or what was rendered where that is another surface.

        Args:
            rendered: `[K]`, the depth as rendered.
        """
        smooth, own = self.depth[rows // STEP_PX, columns // STEP_PX], float(np.median(rendered))
        return np.where(np.abs(smooth - own) <= FLAT_SHARE * own, smooth, own)

    def points(self) -> Floats:
        """`[h, w, 3]` in camera axes."""
        y, x = np.mgrid[: self.depth.shape[0], : self.depth.shape[1]] * STEP_PX + 0.5
        return rays(self.camera, x, y) * self.depth[..., None]

    def normal(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Floats:
        """`[3]`, unit, in camera axes and towards the camera: of the plane that most of the surface around some pixels lies on."""
        top, left = (max(int(v.min()) - PLANE_PX, 0) // STEP_PX for v in (rows, columns))
        around = self.points()[top : (rows.max() + PLANE_PX) // STEP_PX + 1, left : (columns.max() + PLANE_PX) // STEP_PX + 1]
        points = around[np.isfinite(around).all(axis=-1)]
        weights, towards = np.ones(len(points)), -np.median(points, axis=0)
        normal = towards / np.linalg.norm(towards)
        for _ in range(_ROUNDS if len(points) > 3 else 0):  # a Cauchy loss, by reweighting
            centred = points - (weights[:, None] * points).sum(0) / weights.sum()
            normal = np.linalg.svd(centred * np.sqrt(weights)[:, None], full_matrices=False)[2][2]
            off = np.abs(centred @ normal)
            weights = 1 / (1 + (off / max(float(np.median(off)), 1e-12)) ** 2)
        return np.asarray(normal if normal @ towards > 0 else -normal)


@dataclass(frozen=True, eq=False)
class SpotView:
    """One training view.

    Attributes:
        photograph: `[H, W]` without drift and pattern of the sensor. shown: the model's render.
        depth: `[H, W]`, as rendered; NaN where nothing is.
    """

    frame: str
    photograph: Floats
    shown: Floats
    depth: Floats
    surface: Surface

    @staticmethod
    def of(scene: Scene, model: ThermalModel, frame: Frame) -> SpotView:
        """Renders the model."""
        camera, pose = scene.rig.thermal, scene.thermal_from_world(frame.name, model.sfm_per_metre)
        shown, valid = model.render(camera, pose), scene.capture.thermal_mask
        photograph = frame.thermal - (model.render(camera, pose, photographed_in=frame.name) - shown)
        with torch.no_grad():
            view = render(model.gaussians, camera, pose, settings=replace(model.settings, with_depth=True))
        assert view.depth is not None
        alpha = view.alpha.numpy().astype(np.float64)
        depth = np.where((alpha >= SOLID) & valid, view.depth.numpy() / np.maximum(alpha, SOLID), np.nan)
        coarse = depth[::STEP_PX, ::STEP_PX]
        rough = np.where(np.isfinite(coarse), coarse, np.inf)
        return SpotView(
            frame.name,
            np.where(valid, photograph, shown).astype(np.float64),
            shown.astype(np.float64),
            depth,
            Surface(camera, pose, median_filter(rough, MEDIAN), rough),
        )

    def sightings(self, sign: int, regions: Sequence[Region]) -> Iterator[Sighting]:
        """The regions of the photograph times the sign, on the surface."""
        camera, image = self.surface.camera, sign * self.photograph
        world_from_thermal = self.surface.thermal_from_world.inverse()
        for region in regions:
            rows, columns = region.rows, region.columns
            points = self._local_points(rows, columns)
            pixel = points[:, 2] / camera.fl_x
            # A pixel's solid angle shrinks towards the image's border by the cube of the cosine to the axis.
            areas = pixel**2 * points[:, 2] / np.linalg.norm(points, axis=1)
            weights = np.maximum(image[rows, columns] - region.surroundings, 1e-6) * areas
            own = np.zeros(image.shape, bool)
            own[rows, columns] = True
            near = np.nonzero(binary_dilation(own))
            yield Sighting(
                frame=self.frame,
                sign=sign,
                eye=world_from_thermal.translation,
                centre=world_from_thermal.apply((weights[:, None] * points).sum(0) / weights.sum()),
                normal=world_from_thermal.rotation @ self.surface.normal(rows, columns),
                area=float(areas.mean()) * region.area_px,
                pixel=float(np.median(pixel)),
                pixels=len(points),
                extreme=sign * region.extreme,
                mean=sign * float(image[rows, columns].mean()),
                surroundings=sign * region.surroundings,
                modelled=sign * highest(sign * self.shown, near[0], near[1], region.surroundings),
                lowered=abs(region.extreme - float(image[rows, columns].max())),
            )

    def points(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Floats:
        """`[K, 3]` of the world: the surface at some pixels of one thing."""
        return self.surface.thermal_from_world.inverse().apply(self._local_points(rows, columns))

    def _local_points(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Floats:
        """The same in camera axes."""
        depth = self.surface.depth_of(rows, columns, self.depth[rows, columns])
        return rays(self.surface.camera, columns + 0.5, rows + 0.5) * depth[:, None]


def rays(camera: Camera, x: NDArray[np.floating], y: NDArray[np.floating]) -> Floats:
    """`[..., 3]`: directions through pixel positions, of depth 1."""
    return np.stack([(x - camera.cx) / camera.fl_x, (y - camera.cy) / camera.fl_y, np.ones_like(x, dtype=np.float64)], axis=-1)
