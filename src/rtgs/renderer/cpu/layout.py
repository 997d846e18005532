"""What the kernels agree on: patches and tiles, and the columns of a splat, of its gradient and of its tangents."""

from __future__ import annotations

import math

from rtgs.renderer.settings import ALPHA_MIN

PATCH = 16  # pixels a side of what is composited at once: its row is one register of lanes
BATCH = 512  # splats of a tile that are composited together
CHUNKS = (
    64  # Gaussians are worked on, and their pose gradients summed, in so many fixed parts: the same for any number of threads
)

# A splat is one cache line. With covariance [[a, b], [b, c]] in px² and (dx, dy) = pixel − centre, its opacity at a pixel is 2^q,
#   q = LOG2_OPACITY − KAPPA·dy² − ETA·(dx − SLANT·dy)²,   SLANT = b/c,  KAPPA = log₂e/(2c),  ETA = log₂e·c/(2(ac − b²)):
# the square is completed along the row, so that a row needs two numbers and a pixel two products. The centre is X + X_LOW,
# Y + Y_LOW: float32 alone would round it to 3e-5 px, which decides on which side of 1/255 a pixel falls.
X, Y, X_LOW, Y_LOW, SLANT, ETA, KAPPA, LOG2_OPACITY, COLORS = range(9)
SPLAT = 16
MAX_CHANNELS = SPLAT - COLORS
LOG2_ALPHA_MIN = math.log2(ALPHA_MIN)

# Reverse mode gives moments Σ E·(1, dx, dy, dx², dx·dy, dy²) with E = ∂L/∂ln α, then the colours' gradients. Forward mode takes
# the same row as coefficients: ∂ln α = row · (1, dx, dy, dx², dx·dy, dy²), then the colours' tangents.
ONE, DX, DY, DXX, DXY, DYY, G_COLORS = range(7)
MAX_DIRECTIONS = 8


def tile_side(width: int, height: int) -> int:
    """Pixels a side of a tile, the unit of sorting and of parallel work: 64, or less where that would make too few of them."""
    for side in (64, 32):
        if -(-width // side) * -(-height // side) >= 48:
            return side
    return PATCH
