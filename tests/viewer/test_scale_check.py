"""The edges of both modalities meet at the right scale and part at a wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tests.helpers.viewed_wall import NAMES, TRUTH, estimate

from rtgs.images.pictures import THERMAL_EDGE
from rtgs.viewer.contents import Contents
from rtgs.viewer.engine import Engine
from rtgs.viewer.scale_check import check_scale, curve_picture, png


def test_edges_part_at_a_wrong_scale(contents: Contents) -> None:
    """Photographs are given the texture of the RGB model, so that both have the same edges."""
    assert contents.scene is not None and contents.rgb is not None
    scene, rgb, frames = contents.scene, contents.rgb, []
    for frame in scene.frames:
        gray = rgb.render(scene.rig.thermal, scene.thermal_from_world(frame.name, TRUTH)) @ [0.299, 0.587, 0.114]
        frames.append(frame.with_thermal(gray.astype(np.float32)))
    textured = replace(contents, scene=replace(scene, capture=replace(scene.capture, frames=tuple(frames))))
    right, wrong = (check_scale(Engine(textured), NAMES[1], factor * TRUTH) for factor in (1.0, 1.6))
    assert right is not None and wrong is not None
    assert right.met > 0.9 and wrong.met < right.met - 0.15
    assert right.picture.shape == (scene.rig.thermal.height, scene.rig.thermal.width, 3)


def test_without_an_rgb_model_there_is_nothing_to_check(contents: Contents) -> None:
    assert check_scale(Engine(replace(contents, rgb=None)), NAMES[0], TRUTH) is None


def test_the_curve_marks_the_scale_that_is_tried() -> None:
    def marked(tried: float) -> float:
        picture = curve_picture(estimate(), tried)
        return float(np.flatnonzero((picture[len(picture) // 2] == THERMAL_EDGE).all(axis=1)).mean())

    assert marked(0.3) < marked(0.4) < marked(0.7)
    assert png(curve_picture(estimate(), 0.4)).startswith(b"\x89PNG")
