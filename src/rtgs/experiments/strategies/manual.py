"""Manual: the scale from one length that a person has measured."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import to_json
from rtgs.base.progress import Progress
from rtgs.config import ManualConfig
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy
from rtgs.records.camera import Camera
from rtgs.records.scene import Scene

MISS_PX = 8.0  # two picks of one point agree to so many pixels of the picture file, and another hundredth of its length
MISS_SHARE = 0.01


def manual_scale(scene: Scene, config: ManualConfig) -> float:
    """`sfm_per_metre` from a length measured in the world.

    The length lies between the RGB cameras of two frames or, with `pixels`, between two points that are seen in both.

    Raises:
        RtgsError: nothing was measured, a frame is not registered, or the picks of a point do not meet.
    """
    config.check()
    if config.frames is None or config.metres is None:
        raise RtgsError("needs a measured length: --manual.frames A B --manual.metres M")
    for name in config.frames:
        if name not in scene.world_from_rgb:
            raise RtgsError(
                f"--manual.frames: {name!r} is no registered frame; they are {', '.join(list(scene.world_from_rgb)[:3])}, …"
            )
    a, b = config.frames
    if config.pixels is None:
        ends = scene.world_from_rgb[a].translation, scene.world_from_rgb[b].translation
    else:
        x = config.pixels
        ends = tuple(triangulated(scene, {a: (x[i], x[i + 1]), b: (x[i + 4], x[i + 5])}) for i in (0, 2))  # type: ignore[assignment]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if length == 0:
        raise RtgsError("--manual: the two ends of the length are one point")
    return length * scene.given_from_world.factor / config.metres


def triangulated(scene: Scene, picks: dict[str, tuple[float, float]]) -> NDArray[np.float64]:
    """The point `[3]` that two frames show at the given pixels (of the RGB files): midway where the rays pass closest.

    Raises:
        RtgsError: a pick is outside the picture, the rays are parallel, or they miss each other.
    """
    camera = scene.capture.raw_rig.rgb
    names = list(picks)
    for name, (x, y) in picks.items():
        if not (0 <= x <= camera.width and 0 <= y <= camera.height):
            raise RtgsError(
                f"--manual.pixels: ({x:g}, {y:g}) is outside of the {camera.width} × {camera.height} picture of {name}"
            )
    poses = [scene.world_from_rgb[name] for name in names]
    directions = [pose.rotation @ ray(camera, picks[name]) for name, pose in zip(names, poses, strict=True)]
    origins = [pose.translation for pose in poses]
    # origin_a + u · a and origin_b + v · b at their closest: the difference is normal to both.
    sides = np.stack([directions[0], -directions[1]], axis=1)
    depths, *_ = np.linalg.lstsq(sides, origins[1] - origins[0], rcond=None)
    if np.linalg.norm(np.cross(*directions)) < 1e-4 or (depths <= 0).any():
        raise RtgsError(
            f"--manual.pixels: seen from {names[0]} and {names[1]} the picked point has no depth; pick one with more parallax"
        )
    near = [o + u * d for o, u, d in zip(origins, depths, directions, strict=True)]
    miss_px = float(np.linalg.norm(near[1] - near[0])) / float(depths.min()) * camera.fl_x
    if miss_px > MISS_PX + MISS_SHARE * max(camera.width, camera.height):
        raise RtgsError(
            f"--manual.pixels: the rays through {picks[names[0]]} in {names[0]} and {picks[names[1]]} in {names[1]} miss each other by "
            f"{miss_px:.0f} pixels; they do not show one point"
        )
    return (near[0] + near[1]) / 2


def ray(camera: Camera, pixel: tuple[float, float]) -> NDArray[np.float64]:
    """`[3]`, unit length, camera axes: the direction that a pixel of a picture file looks in, lens included."""
    matrix = camera.opencv_matrix
    point = np.array([[pixel]], dtype=np.float64) - 0.5  # OpenCV's pixel centres are integers
    if camera.model == "OPENCV_FISHEYE":
        x, y = cv2.fisheye.undistortPoints(point, matrix, np.array(camera.distortion))[0, 0]
    else:
        x, y = cv2.undistortPoints(point, matrix, np.array([camera.k1, camera.k2, camera.p1, camera.p2]))[0, 0]
    direction = np.array([x, y, 1.0])
    return direction / np.linalg.norm(direction)


def _place(given: Given, progress: Progress) -> Placement:
    return Placement(given.scene, manual_scale(given.scene, given.config.manual))


MANUAL = Strategy("manual", "Manual", _place, lambda given: to_json(given.config.manual))
