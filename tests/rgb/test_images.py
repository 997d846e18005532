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


def test_reduced_images_that_do_not_fit_into_memory_are_made_again() -> None:
    scene = synthetic()
    enough, none = TrainingImages(scene), TrainingImages(scene, most_bytes=0)
    for frame in scene.frames * 2:
        np.testing.assert_array_equal(enough.target(frame, 2).image, none.target(frame, 2).image)
    assert enough.target(scene.frames[0], 2).image.data_ptr() == enough.target(scene.frames[0], 2).image.data_ptr()
