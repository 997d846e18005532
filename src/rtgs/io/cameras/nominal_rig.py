"""`rig.json` after an import: checks of a given one against the files, or a start with the files' nominal values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.common_facts import Facts
from rtgs.io.rig import RigFile, camera_to_json, radiometry_to_json
from rtgs.records.camera import Camera
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import Rig

_FOCAL_TOLERANCE = 0.05  # of a nominal field of view
_REAL2IR_TOLERANCE = 0.15  # it is made for display
_OFFSET_TOLERANCE = 0.08  # of the visible picture's width, likewise
_NEAREST_M = 0.5  # that such a camera focuses on


def check_sizes(path: Path, rig_file: RigFile, facts: Facts) -> None:
    """Refuse a rig of other image sizes.

    Raises:
        RtgsError: the sizes of `rig.json` at `path` are not those of the files.
    """
    for which, camera, size in (("rgb", rig_file.rig.rgb, facts.rgb_size), ("thermal", rig_file.rig.thermal, facts.thermal_size)):
        if (camera.width, camera.height) != size:
            raise RtgsError(
                f"{path}: {which}.width and height say {camera.width}×{camera.height}, but {facts.first} has {size[0]}×{size[1]}. "
                "Intrinsics belong to one image size."
            )


def disagreements(rig_file: RigFile, facts: Facts) -> list[str]:
    """Sentences on where a rig is far from what the files say."""
    visible = facts.visible
    checks = (
        ("thermal.fl_x", rig_file.rig.thermal.fl_x, facts.thermal_focal_px, "the field of view", _FOCAL_TOLERANCE),
        ("rgb.fl_x", rig_file.rig.rgb.fl_x, visible.focal_px, "the 35 mm equivalent", _FOCAL_TOLERANCE),
        ("rgb.fl_x", rig_file.rig.rgb.fl_x, visible.focal_hint_px, "the fusion setting Real2IR", _REAL2IR_TOLERANCE),
    )
    notes = [
        f"{field} is {given:.1f} in the rig, and {source} in {facts.first.name} suggests {nominal:.1f}. Is it the rig of this camera?"
        for field, given, nominal, source, tolerance in checks
        if nominal is not None and abs(given / nominal - 1) > tolerance
    ]
    if visible.thermal_centre_px is not None:
        path = _centre_in_rgb(rig_file.rig) - np.array(visible.thermal_centre_px)
        away = float(np.linalg.norm(path, axis=1).min())
        if away > _OFFSET_TOLERANCE * facts.rgb_size[0]:
            x, y = visible.thermal_centre_px
            notes.append(
                f"rgb_from_thermal puts the thermal image's centre {away:.0f} px or more from where OffsetX and OffsetY in "
                f"{facts.first.name} have it, ({x:+.0f}, {y:+.0f}) px from the visible picture's centre, at any distance. Is it the rig of "
                "this camera, and the right way round?"
            )
    if not isinstance(rig_file.radiometry, RelativeCounts):
        notes.append("The rig's own conversion to °C gave way to that of the files.")
    return notes


def _centre_in_rgb(rig: Rig) -> NDArray[np.float64]:
    """`[D, 2]`: where the middle of the thermal image lies in the RGB image, from its middle, in pixels, near by to far away."""
    rgb, thermal = rig.rgb, rig.thermal
    ray = np.array([(thermal.width / 2 - thermal.cx) / thermal.fl_x, (thermal.height / 2 - thermal.cy) / thermal.fl_y, 1.0])
    points = rig.rgb_from_thermal.apply(np.geomspace(_NEAREST_M, 1000.0, 60)[:, None] * ray)
    points = points[points[:, 2] > 0]
    pixels = points[:, :2] / points[:, 2:] * (rgb.fl_x, rgb.fl_y) + (rgb.cx, rgb.cy)
    return np.asarray(pixels - (rgb.width / 2, rgb.height / 2)) if len(points) else np.full((1, 2), np.inf)


def nominal_rig(facts: Facts) -> tuple[dict[str, Any], list[str]]:
    """The content of `rig.json` with nominal intrinsics where the files have them, and sentences on what it lacks."""
    missing = []
    cameras: dict[str, dict[str, Any]] = {}
    width, height = facts.rgb_size
    cameras["rgb"] = {"width": width, "height": height}
    start = facts.visible.focal_px or facts.visible.focal_hint_px
    if start is not None:  # structure from motion finds the focal length from there, and the lens
        cameras["rgb"]["fov_deg"] = math.degrees(2 * math.atan(0.5 * width / start))
    (width, height), focal = facts.thermal_size, facts.thermal_focal_px
    cameras["thermal"] = camera_to_json(Camera("PINHOLE", width, height, focal or 1.0, focal or 1.0, width / 2, height / 2))
    if focal is None:
        del cameras["thermal"]["fl_x"], cameras["thermal"]["fl_y"]
        missing.append("thermal.fl_x and thermal.fl_y, the focal length in pixels (the files don't say)")
    missing.append(
        "baseline_m, the distance between the two lenses in metres (a ruler will do; the rest of the rig is found from the capture; or "
        "rgb_from_thermal, where the pair is calibrated)"
    )
    cameras["thermal"] |= radiometry_to_json(facts.radiometry)
    return cameras, missing
