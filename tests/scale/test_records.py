"""Records of the scale."""

from __future__ import annotations

import numpy as np

from rtgs.scale.records import Scan


def test_standard_error_is_paired() -> None:
    thetas = np.array([0.0, 0.1, 0.2])
    shape, level = np.array([0.5, 0.1, 0.3]), np.array([[0.0], [3.0], [-2.0], [7.0]])
    scan = Scan.of(thetas, shape + level, ["a", "b", "c", "d"])
    # Frames differ in level alone, which says nothing about s.
    np.testing.assert_allclose(scan.std_error, 0.0, atol=1e-12)
    np.testing.assert_allclose(scan.loss, shape + 2.0)
    np.testing.assert_allclose(scan.sfm_per_metre, np.exp(thetas))
    curves = shape + np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(Scan.of(thetas, curves, list("abcd")).std_error, [0, 0, np.sqrt(4 / 3) / 2])
