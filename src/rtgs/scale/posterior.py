"""How far a joint refinement can be off, and how much the calibration's prior should count.

docs/how-it-works/scale.md, "Joint refinement", has the equations, with the letters of the code.
"""

from __future__ import annotations

import numpy as np

from rtgs.scale.interval import model_pixels
from rtgs.scale.resampling import block_length, small_sample_factor
from rtgs.scale.rig_loss import Vector

CALIBRATION_PIXELS = 0.1  # what `MODEL_PIXELS` is for the scale


def gradient_covariance(gradients: Vector) -> Vector:
    """`[K, K]`: G, the covariance of the mean of the frames' gradients `[F, K]`.

    Neighbours err alike, so products of frames up to ∛F apart count, with Bartlett's weights.
    """
    n = len(gradients)
    block = block_length(n)
    centred = gradients - gradients.mean(axis=0)
    total = centred.T @ centred
    for lag in range(1, block):
        product = centred[lag:].T @ centred[:-lag]
        total += (1 - lag / block) * (product + product.T)
    return total / n**2 * small_sample_factor(n, block) ** 2


def positive(hessian: Vector, gauss_newton: Vector) -> Vector:
    """The Hessian with its curvatures, relative to Gauss–Newton's, kept above a hundredth of their median."""
    root = np.linalg.cholesky(gauss_newton + 1e-9 * float(np.diag(gauss_newton).max()) * np.eye(len(gauss_newton)))
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ hessian @ inverse.T)
    values = np.maximum(values, 0.01 * max(float(np.median(values)), 1e-12))
    half = root @ vectors
    return (half * values) @ half.T


def true_share(hessian: Vector, gauss_newton: Vector) -> float:
    """How large the curvatures are beside Gauss–Newton's: the median over its directions, above 0.

    Where modalities disagree, Gauss–Newton overstates the curvature, by about as much in all directions. Along a direction that hardly
    moves the picture, differences of gradients show noise instead.
    """
    inverse = np.linalg.inv(
        np.linalg.cholesky(gauss_newton + 1e-9 * float(np.diag(gauss_newton).max()) * np.eye(len(gauss_newton)))
    )
    return max(float(np.median(np.linalg.eigvalsh(inverse @ hessian @ inverse.T))), 1e-6)


def covariance(hessian: Vector, g: Vector, prior: Vector, weight: float) -> Vector:
    """(H + wP)⁻¹ (G + w²P) (H + wP)⁻¹: how far the minimum of L + w/2 xᵀPx scatters about the truth."""
    inverse = np.linalg.inv(hessian + weight * prior)
    return inverse @ (g + weight**2 * prior) @ inverse


def bias(hessian: Vector, pixels: Vector, blur_px: float = 0.0) -> Vector:
    """`[K, K]`: covariance of the gradient that model errors leave, all frames alike; θ comes first.

    Edges of a render lie beside those of the photograph, displaced by fields as smooth as those of the unknowns themselves, so that x is
    off by as much as makes such a field. A tenth of it has no such form, so that unknowns with like effects do not cancel it.

    Args:
        hessian: `[K, K]`. pixels: `[K]`, how far the picture moves per unit of x. blur_px: of the thermal images.
    """
    std = np.array([model_pixels(blur_px), *[model_pixels(blur_px, CALIBRATION_PIXELS)] * (len(pixels) - 1)]) / pixels
    return bias_of(hessian, std)


def bias_of(hessian: Vector, std: Vector) -> Vector:
    """`bias` for unknowns that model errors displace by these standard deviations `[K]`."""
    alike, alone = hessian * std, 0.1 * np.diag(hessian) * std
    return np.asarray(alike @ alike.T + np.diag(alone**2))


def best_weight(hessian: Vector, g: Vector, prior: Vector) -> float:
    """The w whose `covariance` has the smallest determinant: the prior counts as much as is best against G, the gradients' covariance."""
    typical = float(np.median(np.diag(hessian)[1:]))
    weights = typical * np.logspace(-6, 4, 81)
    return float(min(weights, key=lambda w: np.linalg.slogdet(covariance(hessian, g, prior, w))[1]))
