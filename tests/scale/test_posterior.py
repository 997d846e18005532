"""What the covariance of a joint refinement says."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.scale.posterior import covariance, gradient_covariance, true_share


def test_the_covariance_is_that_of_repeated_experiments() -> None:
    rng = np.random.default_rng(0)
    root, h = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    hessian, g, prior, weight = h @ h.T + np.eye(3), root @ root.T, np.diag([0.0, 1.0, 1.0]), 0.7
    expected = covariance(hessian, g, prior, weight)
    truth = rng.normal(size=(100_000, 3)) * [0, 1, 1]  # drawn from the prior; the first has none, and its place does not matter
    slope = rng.normal(size=(100_000, 3)) @ root.T  # of the loss at the truth
    # The minimum of the loss, quadratic about the truth, and the prior's term.
    found = np.linalg.solve(hessian + weight * prior, (truth @ hessian - slope).T).T
    np.testing.assert_allclose(np.cov((found - truth).T), expected, rtol=0.05, atol=0.02 * np.abs(expected).max())


def test_noise_of_the_mean_gradient() -> None:
    rng = np.random.default_rng(1)
    alone = [gradient_covariance(rng.normal(size=(500, 2)) * [1.0, 3.0]) * 500 for _ in range(40)]
    np.testing.assert_allclose(np.mean(alone, axis=0), np.diag([1.0, 9.0]), atol=0.4)
    runs = [gradient_covariance(np.repeat(rng.normal(size=(250, 2)), 2, axis=0)) * 250 for _ in range(40)]  # neighbours err alike
    np.testing.assert_allclose(np.mean(runs, axis=0), np.eye(2), atol=0.15)
    assert (np.linalg.eigvalsh(gradient_covariance(rng.normal(size=(5, 8)))) > -1e-12).all()  # fewer frames than unknowns


def test_what_gauss_newton_overstates_is_found_beside_noise_along_a_weak_direction() -> None:
    rng = np.random.default_rng(0)
    turn, _ = np.linalg.qr(rng.normal(size=(7, 7)))
    gauss_newton = (turn * [1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 1e-3]) @ turn.T
    assert true_share(0.03 * gauss_newton, gauss_newton) == pytest.approx(0.03, rel=1e-4)
    noise = -0.01 * np.outer(turn[:, -1], turn[:, -1])  # makes it fall along that direction
    assert true_share(0.03 * gauss_newton + noise, gauss_newton) == pytest.approx(0.03, rel=1e-4)
