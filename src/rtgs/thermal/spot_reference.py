"""The temperature of a region that spots are compared with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.config.spots import Reference
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.records.spots import ReferenceTemperature
from rtgs.thermal.spot_places import Floats
from rtgs.thermal.spot_regions import FLAT_SHARE
from rtgs.thermal.spot_views import STEP_PX, SpotView

SEEN_SHARE = 0.8  # of a region that a view has to see


@dataclass(eq=False)
class ReferenceRegion:
    """A region of the model's surface, and what the views show of it so far.

    Attributes:
        points: `[K, 3]` of the world. shown, photographed: a mean for each view.
    """

    name: str
    points: Floats
    shown: list[float] = field(default_factory=list)
    photographed: list[float] = field(default_factory=list)

    @staticmethod
    def of(scene: Scene, model: ThermalModel, wanted: Reference, unit_per_sfm: float) -> ReferenceRegion:
        """Lay the region on the model's surface, in the frame of the rectangle, or in the one that sees the place from nearest by.

        Raises:
            RtgsError: no such frame, a rectangle outside of the image, or no surface is seen there.
        """
        if wanted.frame is not None and wanted.box is not None:
            frame = next((f for f in scene.frames if f.name == wanted.frame), None)
            if frame is None:
                raise RtgsError(f"spots.reference: the scene has no frame {wanted.frame}. Its first is {scene.frames[0].name}.")
            left, top, right, bottom = wanted.box
            camera = scene.rig.thermal
            if right > camera.width or bottom > camera.height:
                size = f"{camera.width} × {camera.height}"
                raise RtgsError(f"spots.reference: the rectangle ends at {right}, {bottom}; thermal images have {size} pixels.")
            inside = np.zeros((camera.height, camera.width), bool)
            inside[top:bottom, left:right] = True
            return ReferenceRegion(wanted.name, _points(SpotView.of(scene, model, frame), inside))
        return ReferenceRegion(wanted.name, _points_at(scene, model, wanted, unit_per_sfm))

    def look(self, view: SpotView) -> None:
        """Add what a view shows of the region, if it sees enough of it."""
        surface = view.surface
        local = surface.thermal_from_world.apply(self.points)
        x, y = surface.camera.project(np.where(local[:, 2:] > 0, local, [0.0, 0.0, 1.0])).T
        seen = (local[:, 2] > 0) & (x >= 0) & (x < surface.camera.width) & (y >= 0) & (y < surface.camera.height)
        rows, columns = y[seen].astype(int), x[seen].astype(int)
        at, distance = (rows // STEP_PX, columns // STEP_PX), local[seen, 2]
        off = np.minimum(np.abs(surface.depth[at] - distance), np.abs(surface.rough[at] - distance))
        near = off <= FLAT_SHARE * distance
        if near.sum() >= SEEN_SHARE * len(self.points):
            for values, image in ((self.shown, view.shown), (self.photographed, view.photograph)):
                values.append(float(image[rows[near], columns[near]].mean()))

    def measured(self) -> ReferenceTemperature:
        """The median of what the model shows, and how far it is from the photographs.

        Raises:
            RtgsError: no training view sees the region.
        """
        if not self.shown:
            raise RtgsError("spots.reference: no training photograph sees the whole region. Choose another, or a smaller one.")
        off = np.array(self.shown) - self.photographed
        return ReferenceTemperature(self.name, float(np.median(self.shown)), float(np.sqrt(np.mean(off**2))), len(self.shown))


def _points_at(scene: Scene, model: ThermalModel, wanted: Reference, unit_per_sfm: float) -> Floats:
    assert wanted.place is not None and wanted.radius is not None
    place = scene.given_from_world.apply_inverse(np.array(wanted.place) / unit_per_sfm)
    radius = wanted.radius / unit_per_sfm / scene.given_from_world.factor
    camera, near = scene.rig.thermal, []
    for frame in scene.train_frames:
        local = scene.thermal_from_world(frame.name, model.sfm_per_metre).apply(place)
        if local[2] > 0:
            x, y = (float(v) for v in camera.project(local))
            if 0 <= x < camera.width and 0 <= y < camera.height:
                near.append((float(local[2]), frame.name, x, y))
    frames = {frame.name: frame for frame in scene.train_frames}
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    for depth, name, x, y in sorted(near):
        view = SpotView.of(scene, model, frames[name])
        own = view.depth[int(y), int(x)]
        if abs(own - depth) <= FLAT_SHARE * depth:
            inside = np.hypot(rows - y, columns - x) <= max(radius * camera.fl_x / depth, 0.5**0.5)
            return _points(view, inside)
    raise RtgsError(
        "spots.reference: no training photograph shows a surface at this place. Positions are in metres, as in the list."
    )


def _points(view: SpotView, inside: Floats) -> Floats:
    rows, columns = np.nonzero(inside & np.isfinite(view.depth))
    if len(rows) == 0:
        raise RtgsError(f"spots.reference: the model shows no surface there in {view.frame}.")
    return view.points(rows, columns)
