"""How the edges of two pictures are compared (Eqs. 5–7): the settings as one value, and what every implementation offers.

There are two implementations: `ngf.NgfPyramid` is readable and is the specification, `ngf_fused.FusedNgf` is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS
from rtgs.images.filters import SOBEL, blurred


@dataclass(frozen=True)
class EdgeLoss:
    """The settings of the normalised gradient field loss. The defaults are the paper's.

    Attributes:
        level_weights: w_l of Eq. 7, level 0 the finest. A single level gives Eq. 6.
        epsilon: ε of Eq. 5 for the fixed image (the thermal one): one number for all levels, or one a level.
        render_epsilon: ε for the render; None: the fixed image's.
        per_edge: ℓ = 1 − mean (n_A · n_B)² / rms ‖n_A‖. With an ε as large as edges are, Eq. 6 falls wherever the render has more or
            stronger edges, as it has from nearer by. Divided by the strength of the render's own edges, only agreement counts.
        across: weights (beside, in the middle) across the 3×3 derivative filter, as in `rtgs.images.filters.sobel`.
        blur_px: standard deviation of the Gaussian that renders are blurred by before they are compared, in pixels of the pictures
            compared: what the thermal lens does. 0: none.
    """

    level_weights: tuple[float, ...] = PAPER_LEVEL_WEIGHTS
    epsilon: float | tuple[float, ...] = PAPER_EPSILON
    render_epsilon: float | tuple[float, ...] | None = None
    per_edge: bool = False
    across: tuple[float, float] = SOBEL
    blur_px: float = 0.0

    @property
    def epsilons(self) -> tuple[float, ...]:
        """ε of the fixed image, one a level."""
        return self._one_a_level(self.epsilon)

    @property
    def render_epsilons(self) -> tuple[float, ...]:
        """ε of the render, one a level."""
        return self.epsilons if self.render_epsilon is None else self._one_a_level(self.render_epsilon)

    def softened(self, pictures: Tensor) -> Tensor:
        """`[K, H, W]` blurred by `blur_px`. The blur is linear, so that it is applied to derivatives of a picture in the same way."""
        return blurred(pictures, self.blur_px) if self.blur_px else pictures

    def _one_a_level(self, epsilon: float | tuple[float, ...]) -> tuple[float, ...]:
        return epsilon if isinstance(epsilon, tuple) else (epsilon,) * len(self.level_weights)


@dataclass(frozen=True)
class Products:
    """A loss and its derivatives along K tangents: `loss`, `slope` `[K]`, and the Gauss–Newton matrix 2·JᵀJ `[K, K]` (0: not wanted)."""

    loss: float
    slope: NDArray[np.float64]
    curvature: NDArray[np.float64]


class EdgeTarget(Protocol):
    """A fixed image that has been prepared, so that pictures can be compared with it. Pictures come blurred already."""

    def loss(self, picture: Tensor) -> float:
        """Eq. 7 of a picture `[H, W]`: 0 where all gradients are parallel or anti-parallel, 1 for a picture without any."""

    def products(self, picture: Tensor, tangents: Tensor, *, curvature: bool = True) -> Products:
        """Eq. 7 of a picture `[H, W]`, with its derivatives where the picture changes by each of the tangents `[K, H, W]`.

        Args:
            curvature: whether the Gauss–Newton matrix is wanted. For many tangents it is a large part of the work.
        """
