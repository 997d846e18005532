"""Scene records in memory, and changes of their images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import NO_POINTS, Capture, Frame, SparsePoints
from rtgs.records.radiometry import Radiometry, RelativeCounts
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

Images = Mapping[str, NDArray[np.float32]]


def everywhere(camera: Camera) -> NDArray[np.bool_]:
    """`[h, w]`: every pixel is valid."""
    return np.ones((camera.height, camera.width), bool)


def scene_of(
    rig: Rig,
    poses: Sequence[SE3] | Mapping[str, SE3],
    *,
    rgb: Sequence[NDArray[np.float32]] | None = None,
    thermal: Sequence[NDArray[np.float32]] | None = None,
    points: SparsePoints = NO_POINTS,
    radiometry: Radiometry | None = None,
) -> Scene:
    """A scene whose every frame has a pose and whose every pixel is valid.

    Args:
        poses: world_from_rgb by frame; a sequence stands for frames 000, 001, …
        rgb, thermal: an image for each frame, in their order; None: black, or zeros.
        radiometry: None: relative counts.
    """
    named = poses if isinstance(poses, Mapping) else {f"{i:03d}": pose for i, pose in enumerate(poses)}
    rgb = [np.zeros((rig.rgb.height, rig.rgb.width, 3), np.float32)] * len(named) if rgb is None else rgb
    thermal = [np.zeros((rig.thermal.height, rig.thermal.width), np.float32)] * len(named) if thermal is None else thermal
    capture = Capture(
        root=Path(),
        raw_rig=rig,
        rig=rig,
        frames=tuple(Frame(name, a, b) for name, a, b in zip(named, rgb, thermal, strict=True)),
        rgb_mask=everywhere(rig.rgb),
        thermal_mask=everywhere(rig.thermal),
        radiometry=RelativeCounts() if radiometry is None else radiometry,
        poses=None,
    )
    return Scene(capture, dict(named), points, {})


def altered(
    scene: Scene,
    *,
    rgb: Images | None = None,
    thermal: Images | None = None,
    rgb_mask: NDArray[np.bool_] | None = None,
    thermal_mask: NDArray[np.bool_] | None = None,
    radiometry: Radiometry | None = None,
) -> Scene:
    """The same scene with some frames' images replaced, and with other masks or another radiometry where they are given."""
    rgb, thermal, old = rgb or {}, thermal or {}, scene.capture
    frames = tuple(replace(f, rgb=rgb.get(f.name, f.rgb), thermal=thermal.get(f.name, f.thermal)) for f in old.frames)
    changes = {"rgb_mask": rgb_mask, "thermal_mask": thermal_mask, "radiometry": radiometry}
    given = {name: value for name, value in changes.items() if value is not None}
    return replace(scene, capture=replace(old, frames=frames, **given))  # type: ignore[arg-type]
