"""Camera paths and films of them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.images.pictures import Picture
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.viewer.engine import Eye

FRAMES_PER_S = 24


def turntable(eye: Eye, centre: NDArray[np.float64], up: NDArray[np.float64], count: int) -> list[Eye]:
    """The eye once around an axis `up` through `centre`, in `count` steps; it begins where the eye is."""
    axis, pose = up / np.linalg.norm(up), eye.world_from_camera
    out = []
    for k in range(count):
        turn = rotation_from_axis_angle(2 * np.pi * k / count * axis)
        out.append(Eye(eye.camera, SE3(turn @ pose.rotation, centre + turn @ (pose.translation - centre))))
    return out


def path(views: Sequence[Eye], count: int) -> list[Eye]:
    """From view to view in `count` steps in all, slower near each; the first one's camera.

    Raises:
        RtgsError: fewer than two views.
    """
    if len(views) < 2:
        raise RtgsError("A path leads through at least two views. Keep them in the tab View.")
    out = []
    for k in range(count):
        at = k / max(count - 1, 1) * (len(views) - 1)
        i = min(int(at), len(views) - 2)
        t = at - i
        t = t * t * (3 - 2 * t)
        a, b = views[i].world_from_camera, views[i + 1].world_from_camera
        turn = rotation_from_axis_angle(t * axis_angle_from_rotation(a.rotation.T @ b.rotation))
        out.append(Eye(views[0].camera, SE3(a.rotation @ turn, (1 - t) * a.translation + t * b.translation)))
    return out


def film(eyes: Sequence[Eye], draw: Callable[[Eye], Picture], progress: Callable[[float], None]) -> bytes:
    """An MP4 file of one picture of each eye, `FRAMES_PER_S` a second.

    Raises:
        RtgsError: this machine's OpenCV cannot write MP4.
    """
    with tempfile.TemporaryDirectory(prefix="rtgs-film-") as folder:
        file = Path(folder) / "film.mp4"
        _write(file, (draw(eye) for eye in eyes), lambda done: progress(done / len(eyes)))
        return file.read_bytes()


def _write(file: Path, pictures: Iterable[Picture], progress: Callable[[int], None]) -> None:
    writer = None
    try:
        for done, picture in enumerate(pictures, start=1):
            even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]  # MPEG-4 wants whole blocks of 2 × 2
            if writer is None:
                size = (even.shape[1], even.shape[0])
                writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"mp4v"), FRAMES_PER_S, size)
                if not writer.isOpened():
                    raise RtgsError("This machine's OpenCV cannot write MP4 files.")
            writer.write(cv2.cvtColor(even, cv2.COLOR_RGB2BGR))
            progress(done)
    finally:
        if writer is not None:
            writer.release()
