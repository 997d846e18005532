"""The frame of exported files: unit, which way is up, and where the origin is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rtgs.config import ExportFrame, Program
from rtgs.maths.geometry import Sim3, rotation_from_axis_angle
from rtgs.records.georeference import Georeference
from rtgs.records.metres import LengthUnit
from rtgs.records.scene import Scene
from rtgs.records.world import is_far

Axes: TypeAlias = Literal["z-up", "y-up", "y-down"]

AXES_FROM_Z_UP: dict[Axes, NDArray[np.float64]] = {
    "z-up": np.eye(3),
    "y-up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "y-down": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
"""Turn the frame with z up into each habit. x stays; "y-up" and "y-down" differ by half a turn about x."""

AXES_OF: dict[Program, Axes] = {
    "supersplat": "y-down",
    "spark": "y-down",
    "niantic": "y-up",
    "cloudcompare": "z-up",
    "blender": "z-up",
}
"""What a program takes a file of Gaussians or points to have. Those with "y-down" turn it themselves when they load it."""

_LEAST_SPREAD = 0.1  # sine of the angle about which the cameras' right axes have to differ


@dataclass(frozen=True, eq=False)
class FileFrame:
    """The frame of a file.

    Attributes:
        from_world: leads from the scene's world to the file. It does not turn for `--frame sfm`.
        axes: which way is up; None where the frame is that of the poses.
        per_metre: units of the file per metre; None where nothing tells metres.
        unit: "m", or "SfM units".
        origin: `[3]`, where the file's origin is in the given frame, SfM units; not zero where the given origin is too far away.
        place: where the file's origin is on the Earth; then x, y and z of "z-up" are metres east, north and up. None: not known.
    """

    from_world: Sim3
    axes: Axes | None
    per_metre: float | None
    unit: LengthUnit
    origin: NDArray[np.float64]
    place: Georeference | None = None

    def of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points `[..., 3]` of the world, in the file."""
        return self.from_world.apply(points)


@dataclass(frozen=True, eq=False)
class Upright:
    """The rotation from the given frame to one with z up, and how "up" is known."""

    rotation: NDArray[np.float64]
    known_by: str


def upright(scene: Scene) -> Upright | None:
    """Which way is up, from how the cameras were held.

    A camera that is held level, or is only tilted up and down, has its right axis horizontal. So "up" is the direction across all right
    axes. None where they hardly differ: then the direction is not known.
    """
    poses = list(scene.as_given().world_from_rgb.values())
    rights = np.stack([pose.rotation[:, 0] for pose in poses])
    _, sizes, axes = np.linalg.svd(rights, full_matrices=False)
    if len(poses) < 2 or sizes[1] < _LEAST_SPREAD * sizes[0]:
        return None
    up = axes[2] if len(axes) > 2 else np.cross(axes[0], axes[1])
    of_images, of_views = (np.mean([sign * pose.rotation[:, i] for pose in poses], axis=0) for sign, i in ((-1, 1), (-1, 2)))
    # Cameras that look straight down have no "up" in their images in common; then up is where they look from.
    clearer = max(of_images @ up, of_views @ up, key=abs)
    return Upright(_shortest_turn(up * np.sign(clearer), np.array([0.0, 0.0, 1.0])), "from how the cameras were held")


def file_frame(
    scene: Scene, metres_per_sfm: float | None, frame: ExportFrame, axes: Axes, place: Georeference | None = None
) -> FileFrame:
    """The frame for a file whose program wants `axes`; in metres it is that of the georeference, where there is one.

    Where nothing tells metres (`metres_per_sfm` is None), the unit is that of SfM.
    """
    given, per_metre = scene.given_from_world, None if metres_per_sfm is None else 1.0 / metres_per_sfm
    if frame == "sfm":
        return FileFrame(given, None, per_metre, "SfM units", np.zeros(3))
    if place is not None:
        enu_from_given = Sim3(place.metres_per_sfm, np.array(place.rotation), np.array(place.translation_m))
        from_world = Sim3(1.0, AXES_FROM_Z_UP[axes], np.zeros(3)) @ enu_from_given @ given
        return FileFrame(from_world, axes, 1.0, "m", np.zeros(3), place)
    up = upright(scene)
    turn = AXES_FROM_Z_UP[axes] @ up.rotation if up is not None else np.eye(3)
    origin = given.translation if is_far(given) else np.zeros(3)
    local = Sim3(given.factor, given.rotation, given.translation - origin)
    axes_or_none = axes if up is not None else None
    if metres_per_sfm is None:
        return FileFrame(Sim3(1.0, turn, np.zeros(3)) @ local, axes_or_none, None, "SfM units", origin)
    return FileFrame(Sim3(metres_per_sfm, turn, np.zeros(3)) @ local, axes_or_none, 1.0, "m", origin)


def _shortest_turn(start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation that takes one unit vector to another, about the axis across both."""
    axis, cosine = np.cross(start, end), float(start @ end)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return rotation_from_axis_angle(axis / sine * np.arctan2(sine, cosine))
