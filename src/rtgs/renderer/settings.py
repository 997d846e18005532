"""Settings of a render, its result, and the constants that every back end obeys."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from rtgs.config import Backend

# The compositing rules of 3DGS as gsplat states them. They are discontinuities: derivatives hold on either side of them.
ALPHA_MIN = 1.0 / 255.0  # a Gaussian fainter than this at a pixel does not count there
ALPHA_MAX = 0.999  # nothing is fully opaque, so that the backward pass can divide by 1 − α
TRANSMITTANCE_MIN = 1e-4  # a pixel that lets through less than this is finished
COVARIANCE_BLUR_PX2 = 0.3  # added to the projected covariance: at least half a pixel wide
FRUSTUM_MARGIN = 0.3  # the affine projection is linearised no further out than this share of tan(½ field of view)


@dataclass(frozen=True)
class CutOffs:
    """Where compositing leaves something out. Only the reference can be given others; at zero its picture is differentiable everywhere.

    Attributes:
        alpha: a Gaussian fainter than this at a pixel does not count there.
        transmittance: a pixel that would let through less than this is finished.
    """

    alpha: float = ALPHA_MIN
    transmittance: float = TRANSMITTANCE_MIN


@dataclass(frozen=True)
class RenderSettings:
    """How to render.

    Attributes:
        backend: "cpu" (Numba, float32), "cuda" (gsplat, float32, on an NVIDIA GPU) or "reference" (PyTorch, any dtype, slow).
        near_plane: Gaussians whose centre is not deeper than this are left out; world units.
        antialiased: scale opacity by the area that the blur added (Mip-Splatting's 2D filter), so that a model looks alike at
            every resolution.
        with_depth: also composite the expected depth.
        channel_weights: C numbers: composite this one weighted sum of the colours instead of C channels (grayscale).
        sh_degree: use only the bands up to this one; None: all.
    """

    backend: Backend = "cpu"
    near_plane: float = 0.01
    antialiased: bool = False
    with_depth: bool = False
    channel_weights: tuple[float, ...] | None = None
    sh_degree: int | None = None


@dataclass(frozen=True, eq=False)
class Render:
    """A rendered view, over a black background.

    Attributes:
        color: `[H, W, C]`, premultiplied: Σ wᵢ cᵢ.
        alpha: `[H, W]`, Σ wᵢ.
        depth: `[H, W]`, Σ wᵢ zᵢ in world units, or None when not asked for. Divide by alpha for the mean depth of what is seen.
        visible: `[N]` bool, Gaussians that reach the image.
    """

    color: Tensor
    alpha: Tensor
    depth: Tensor | None
    visible: Tensor

    def over(self, background: Tensor) -> Tensor:
        """`[H, W, C]`: composited over a constant background `[C]`."""
        return self.color + (1.0 - self.alpha)[..., None] * background
