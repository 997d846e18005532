"""What is known about one pixel of a view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.viewer.engine import Engine, Eye

SAME_PLACE = (
    0.04  # of the distance: two views see one place where their depths agree to this; depth on plain surfaces errs as much
)


@dataclass(frozen=True)
class PhotographReading:
    """What a thermal photograph shows at a place.

    Attributes:
        frame: its name. value: in the capture's unit, as photographed. steady: without the drift and the pattern of the sensor, as far
            as the thermal model knows them. pixels_per_unit: how large it shows the place.
    """

    frame: str
    value: float
    steady: float
    pixels_per_unit: float


@dataclass(frozen=True, eq=False)
class Reading:
    """What is known about a pixel.

    Attributes:
        world: `[3]`, the place in the world. position: `[3]`, likewise in metres (SfM units where none are known), in the given frame.
        depth: along the optical axis, in the same unit.
        temperature: of the model there, over whatever lies in front; None without a thermal model.
        std: its standard error; None where the fit did not estimate any.
        photographs: of the thermal photographs that see the place, those that show it largest first.
        colour: `[3]` in [0, 1]; None without an RGB model.
    """

    world: NDArray[np.float64]
    position: NDArray[np.float64]
    depth: float
    temperature: float | None
    std: float | None
    photographs: tuple[PhotographReading, ...]
    colour: NDArray[np.float32] | None

    @property
    def views(self) -> int:
        """How many thermal photographs see the place."""
        return len(self.photographs)

    @property
    def photographed(self) -> float | None:
        """Median of what the photographs show, without drift and pattern."""
        return float(np.median([p.steady for p in self.photographs])) if self.photographs else None


def probe(engine: Engine, eye: Eye, x: float, y: float) -> Reading | None:
    """Look at one pixel.

    Args:
        x, y: in pixels of `eye.camera`; pixel `(i, j)` has its centre at `(i + 0.5, j + 0.5)`.

    Returns:
        None where the model shows no surface.
    """
    contents, camera = engine.contents, eye.camera
    i, j = (min(max(int(v), 0), n - 1) for v, n in ((x, camera.width), (y, camera.height)))
    seen = engine.look(eye, rgb=True, temperature=True, depth=True)
    if seen.depth is None or not math.isfinite(depth := float(seen.depth[j, i])):
        return None
    world = eye.world_from_camera.translation + depth * eye.ray(i + 0.5, j + 0.5)
    return Reading(
        world=world,
        position=contents.position(world),
        depth=depth / contents.world_per_unit,
        temperature=None if seen.temperature is None else float(seen.temperature[j, i]),
        std=engine.std(eye, i + 0.5, j + 0.5),
        photographs=photographs_of(engine, world),
        colour=None if seen.rgb is None else seen.rgb[j, i],
    )


def photographs_of(engine: Engine, world: NDArray[np.float64]) -> tuple[PhotographReading, ...]:
    """What the thermal photographs show at a place `[3]` of the world, those that see it; empty where there is no scale yet."""
    contents = engine.contents
    if contents.scene is None or contents.scale is None:
        return ()
    found = [_reading(engine, contents.scene, name, world) for name in contents.scene.world_from_rgb]
    return tuple(sorted((p for p in found if p is not None), key=lambda p: -p.pixels_per_unit))


def _reading(engine: Engine, scene: Scene, name: str, world: NDArray[np.float64]) -> PhotographReading | None:
    """What one photograph shows, or None where it does not see the place."""
    scale = engine.contents.scale
    assert scale is not None
    camera, pose = scene.rig.thermal, scene.world_from_thermal(name, scale.sfm_per_metre)
    place = pose.inverse().apply(world)
    if not place[2] > 0:
        return None
    x, y = camera.project(place)
    inside = 0.5 <= x <= camera.width - 0.5 and 0.5 <= y <= camera.height - 0.5
    if not inside or not scene.capture.thermal_mask[int(y), int(x)]:
        return None
    distance = float(np.linalg.norm(place))
    if not abs(engine.distance(Eye(camera, pose), x, y) - distance) < SAME_PLACE * distance:
        return None
    frame = next(f for f in scene.frames if f.name == name)
    value = cv2.getRectSubPix(frame.thermal, (1, 1), (float(x) - 0.5, float(y) - 0.5))[0, 0]
    return PhotographReading(
        name, float(value), _steady(engine.contents.thermal, name, value, x, y), float(camera.fl_x / place[2])
    )


def _steady(thermal: ThermalModel | None, frame: str, value: float, x: float, y: float) -> float:
    """A photographed value without the sensor's drift and pattern: the inverse of `SensorModel.shown` at a pixel."""
    if thermal is None:
        return float(value)
    span, (gain, offset) = thermal.color_range.linear, thermal.drift_of(frame)
    signal = span.expand(thermal.color_range.normalise(np.array([value])))
    pattern = thermal.sensor.pattern
    fixed = 0.0 if pattern is None else float(pattern[int(y), int(x)])
    return float(thermal.color_range.expand(span.normalise((signal - fixed - offset) / gain))[0])
