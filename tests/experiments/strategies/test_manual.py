"""Manual: a measured length gives the scale, through the lens of the files."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.helpers.wall_scene import PLANE_M, RGB, RIG, TRUTH, wall_scene

from rtgs.base.errors import RtgsError
from rtgs.config import ManualConfig
from rtgs.experiments.strategies.manual import manual_scale


def test_manual_scale_from_two_cameras() -> None:
    scene, _ = wall_scene()
    metres = float(np.linalg.norm(scene.world_from_rgb["f01"].translation - scene.world_from_rgb["f06"].translation)) / TRUTH
    for same in (scene, scene.recentred()):
        assert manual_scale(same, ManualConfig(("f01", "f06"), metres)) == pytest.approx(TRUTH, rel=1e-9)


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_manual_scale_from_points_in_files_with_a_lens(model: str) -> None:
    """The picks are pixels of the files: four times as large as the pictures of the scene, and not yet undistorted."""
    scene, _ = wall_scene()
    file = replace(RGB.resized(4 * RGB.width, 4 * RGB.height), model=model, k1=0.08, k2=-0.03, p1=0.002 * (model == "OPENCV"))
    scene = replace(scene, capture=replace(scene.capture, raw_rig=replace(RIG, rgb=file)))
    between_m = sum(scene.world_from_rgb[name].translation for name in ("f01", "f06")) / (2 * TRUTH)
    ends_m = between_m + np.array([[-0.16, 0.1, PLANE_M], [0.15, -0.1, 1.3 * PLANE_M]])
    k_cv = file.matrix
    k_cv[:2, 2] -= 0.5
    picks: list[float] = []
    for name in ("f01", "f06"):
        points = scene.rgb_from_world(name).apply(TRUTH * ends_m)[:, None]
        if model == "OPENCV":
            seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k_cv, np.array([file.k1, file.k2, file.p1, file.p2]))
        else:
            seen, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), k_cv, np.array(file.distortion))
        picks += (seen.reshape(2, 2) + 0.5).ravel().tolist()
    metres = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    config = ManualConfig(("f01", "f06"), metres, tuple(picks))  # type: ignore[arg-type]
    assert manual_scale(scene, config) == pytest.approx(TRUTH, rel=1e-4)
    picks[5] -= 60  # y of the first point in the second frame
    with pytest.raises(RtgsError, match="miss each other"):
        manual_scale(scene, replace(config, pixels=tuple(picks)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (ManualConfig(("f01", "f02")), "--manual.metres"),
        (ManualConfig(("f01", "f01"), 1.0), "named twice"),
        (ManualConfig(pixels=(1, 2, 3, 4, 5, 6, 7, 8)), "needs both"),
    ],
)
def test_half_a_length_is_refused(config: ManualConfig, said: str) -> None:
    with pytest.raises(RtgsError, match=said):
        config.check()
