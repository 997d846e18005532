"""The joint fit: known answers, pairs that do not belong together, and orders of points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibrate_target import SIZES, draw_pairs, draw_truth
from rtgs.base.errors import RtgsError
from rtgs.calibration.lens import View, moved, project
from rtgs.calibration.solve import Pair, solve
from rtgs.calibration.summary import rig_of
from rtgs.maths.geometry import SE3, rotation_from_axis_angle


def nobody(done: int, total: int, text: str) -> None:
    pass


def example(noise: float, pairs: int = 10) -> tuple[list[Pair], np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    rgb, thermal, rig = draw_truth(rng, distorted=True)
    return draw_pairs(rng, rgb, thermal, rig, pairs, noise), rgb, thermal, rig


def test_projection_has_the_slopes_of_central_differences() -> None:
    values, points = np.array([700, 690, 320, 240, -0.3, 0.1, 0.003, -0.002]), np.array([[0.2, -0.1, 2.0], [-0.3, 0.2, 1.5]])
    _, by_point, by_values = project(values, points)
    for step, slope, at in (
        (np.eye(3), by_point, lambda e: project(values, points + e)),
        (np.eye(8), by_values, lambda e: project(values + e, points)),
    ):
        for j, e in enumerate(1e-6 * step):
            np.testing.assert_allclose((at(e)[0] - at(-e)[0]) / 2e-6, slope[:, :, j], atol=1e-6)


@pytest.mark.thorough
def test_exact_corners_give_the_truth_in_any_order_of_the_points() -> None:
    pairs, rgb, thermal, rig = example(1e-4)
    turned = [replace(p, thermal=View(p.thermal.points[::-1], p.thermal.pixels)) if i % 2 else p for i, p in enumerate(pairs)]
    found = solve(turned, *SIZES, nobody)
    np.testing.assert_allclose(found.values, np.stack([rgb, thermal]), rtol=1e-2, atol=1e-4)
    got, truth = rig_of(found, *SIZES).rgb_from_thermal, SE3(rotation_from_axis_angle(rig[:3]), rig[3:]).inverse()
    np.testing.assert_allclose(got.matrix(), truth.matrix(), atol=1e-5)
    assert found.agree


@pytest.mark.thorough
def test_a_pair_of_two_instants_is_rejected_by_name() -> None:
    pairs, *_ = example(0.1)
    pairs[3] = replace(pairs[3], thermal=pairs[4].thermal)
    found = solve(pairs, *SIZES, nobody)
    assert list(found.rejected) == ["pair03"] and "instant" in found.rejected["pair03"]


@pytest.mark.thorough
def test_a_rig_that_is_not_rigid_is_said_and_leaves_the_intrinsics_alone() -> None:
    pairs, rgb, *_ = example(0.1, 20)
    rng = np.random.default_rng(2)
    for i, pair in enumerate(pairs):
        pixels = pair.thermal.pixels + rng.normal(0, 5, 2)
        pairs[i] = replace(pair, thermal=View(pair.thermal.points, pixels))
    found = solve(pairs, *SIZES, nobody)
    assert not found.agree and 2 < np.median(found.disagreement_px) < 20
    assert abs(found.values[0, 0] / rgb[0] - 1) < 0.005


def test_too_few_pairs_are_refused() -> None:
    pairs, *_ = example(0.1, 4)
    with pytest.raises(RtgsError, match="4 pairs are left"):
        solve(pairs, *SIZES, nobody)


def test_moved_is_the_rigid_transform() -> None:
    pose, points = np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]), np.eye(3)
    np.testing.assert_allclose(
        moved(pose, points)[0], SE3(rotation_from_axis_angle(pose[:3]), pose[3:]).apply(points), atol=1e-12
    )
