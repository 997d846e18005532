"""The sensor's pattern."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from tests.helpers.sensor_noise import sensor_stripes

from rtgs.images.patterns import sensor_pattern


def test_a_sensors_pattern_is_found_and_the_scene_left_alone() -> None:
    rng, shape = np.random.default_rng(0), (60, 80)
    pattern = sensor_stripes(rng, shape, 0.5)
    noise = rng.normal(size=(24, *shape))
    steady = np.zeros(shape)
    steady[20:40, 30:50] = 5.0  # something that stays in the same place
    for scene in (0.0 * steady, steady):
        images = (20 + scene + pattern + noise).astype(np.float32)
        found = sensor_pattern(images, np.ones(shape, bool))
        fine = lambda image: image - gaussian_filter(image, 3.0)  # noqa: E731
        assert np.corrcoef(fine(found).ravel(), fine(pattern).ravel())[0, 1] > 0.95
        if scene is not steady:
            assert np.corrcoef(found.ravel(), pattern.ravel())[0, 1] > 0.95
        assert abs(fine(found) - fine(pattern)).max() < 1.0  # of the box's edge of 5, nothing
    assert (
        abs(sensor_pattern((20 + noise).astype(np.float32), np.ones(shape, bool))).max() < 0.4
    )  # noise alone agrees with nothing
    assert not sensor_pattern(images[:7], np.ones(shape, bool)).any()  # too few frames to tell


def test_masked_pixels_of_a_pattern_are_not_looked_at() -> None:
    rng, shape = np.random.default_rng(0), (40, 50)
    images = (sensor_stripes(rng, shape, 0.5) + rng.normal(size=(12, *shape))).astype(np.float32)
    mask = np.ones(shape, bool)
    mask[:, :6] = False
    spoiled = images.copy()
    spoiled[:, ~mask] = 1e6
    np.testing.assert_allclose(sensor_pattern(images, mask), sensor_pattern(spoiled, mask), atol=0.05)
    assert not sensor_pattern(spoiled, mask)[~mask].any()
