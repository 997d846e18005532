"""Photographs as the training loss takes them."""

from __future__ import annotations

import numpy as np
from tests.helpers.ball_scene import synthetic
from tests.helpers.scene_record import altered

from rtgs.rgb.images import TrainingImages


def test_reduced_images_are_means_of_blocks() -> None:
    scene = synthetic()
    images = TrainingImages(scene)
    for frame, factor in ((scene.frames[1], 4), (scene.frames[2], 2), (scene.frames[1], 2), (scene.frames[1], 1)):
        side = 40 // factor
        target = images.target(frame, factor)
        expected = frame.rgb.reshape(side, factor, side, factor, 3).mean((1, 3))
        np.testing.assert_allclose(target.image, expected, atol=1e-6)
        assert target.pixels is None and target.windows is None  # all count


def test_a_reduced_pixel_counts_where_all_of_it_is_valid() -> None:
    mask = np.ones((40, 40), bool)
    mask[:, 31:], mask[3, 2] = False, False
    target = TrainingImages(altered(synthetic(), rgb_mask=mask)).target(synthetic().frames[1], 2)
    assert target.pixels is not None and target.windows is not None
    np.testing.assert_array_equal(target.pixels, mask.reshape(20, 2, 20, 2).all((1, 3)))
    centres = np.argwhere(target.windows.numpy())
    assert len(centres)
    for row, column in centres:
        assert target.pixels[row - 5 : row + 6, column - 5 : column + 6].all() and min(row, column) >= 5
