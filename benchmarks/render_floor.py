"""What a render cannot do without: arithmetic and memory traffic, counted by the rules of the reference, and how fast one core is.

The floor of a stage is the longer of its counted arithmetic at the measured peak and its counted bytes at the measured bandwidth. The
peak is that of fused multiply-adds, which blending's comparisons, exponentials and divisions are not: nothing reaches this floor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.compiled import kernel
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import reference
from rtgs.renderer.settings import ALPHA_MAX, ALPHA_MIN, COVARIANCE_BLUR_PX2, TRANSMITTANCE_MIN, RenderSettings

# float32 operations a pixel–Gaussian pair, C channels. Forward: 4 for the exponent, the square completed along the row; 13 for 2^x as
# a polynomial of degree 5; 3 comparisons; weight and transmittance 2; 2C to add the colour. Backward: the same 22 without the colour,
# 4C + 5 for the colour's gradient and what remains behind, 3 for ∂L/∂α, 6 for moments along the row.
FORWARD_FLOP = (22, 2)  # a + b·C
BACKWARD_FLOP = (36, 4)
# float32 operations and bytes a Gaussian (SH of degree 3, 3 channels; what is read and written once).
SH_FLOP, SH_BYTES = 96 + 60 + 12, 4 * (3 + 48 + 3)
SH_BACKWARD_FLOP, SH_BACKWARD_BYTES = 4 * 96 + 150, 4 * (3 + 48 + 3 + 3 + 48 + 3)
PROJECT_FLOP, PROJECT_BYTES = 250, 4 * (11 + 8 + 1)
PROJECT_BACKWARD_FLOP, PROJECT_BACKWARD_BYTES = 600, 4 * (11 + 9 + 11)
ADAM_FLOP, ADAM_BYTES = 10, 4 * 7  # a parameter: p, g, m, v read, p, m, v written
SORT_BYTES = 3 * 2 * 8  # a visible Gaussian: three passes over key and index
_WIDE = 3e-5  # float32's relative error of α, at most (2.1e-5 seen)


@dataclass(frozen=True)
class Work:
    """Counts of one view.

    Attributes:
        gaussians, visible: N and those that reach the image.
        boxes: pixels in the boxes of the splats. pairs: of those, pixel and Gaussian with α ≥ 1/255 before the pixel is finished.
        entries: splats in the lists of square tiles of `tile` pixels.
        undecided: `[H, W]` bool, pixels where a pair is so close to a cut-off that float32 may fall on either side of it.
    """

    gaussians: int
    visible: int
    boxes: int
    pairs: int
    entries: int
    pixels: int
    undecided: NDArray[np.bool_]


@kernel(checks_division=True)
def _composite(
    centres: NDArray[np.float64],
    covariances: NDArray[np.float64],
    opacities: NDArray[np.float64],
    order: NDArray[np.int64],
    tile: int,
    transmittance: NDArray[np.float64],
    undecided: NDArray[np.bool_],
) -> tuple[int, int, int, int]:
    height, width = transmittance.shape
    drawn, boxes, pairs, entries = 0, 0, 0, 0
    for i in order:
        x, y, o = centres[i, 0], centres[i, 1], opacities[i]
        a, b, c = covariances[i, 0, 0] + COVARIANCE_BLUR_PX2, covariances[i, 0, 1], covariances[i, 1, 1] + COVARIANCE_BLUR_PX2
        det = a * c - b * b
        reach = math.sqrt(2 * math.log(o / ALPHA_MIN)) + 1e-3
        left, right = (
            max(0, math.ceil(x - reach * math.sqrt(a) - 0.5)),
            min(width - 1, math.floor(x + reach * math.sqrt(a) - 0.5)),
        )
        top, bottom = (
            max(0, math.ceil(y - reach * math.sqrt(c) - 0.5)),
            min(height - 1, math.floor(y + reach * math.sqrt(c) - 0.5)),
        )
        if left > right or top > bottom:
            continue
        drawn += 1
        boxes += (right - left + 1) * (bottom - top + 1)
        entries += (right // tile - left // tile + 1) * (bottom // tile - top // tile + 1)
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                t = transmittance[v, u]
                if t == 0.0:
                    continue
                dx, dy = x - u - 0.5, y - v - 0.5
                alpha = min(ALPHA_MAX, o * math.exp(-(0.5 * (c * dx * dx + a * dy * dy) - b * dx * dy) / det))
                if abs(alpha / ALPHA_MIN - 1) < _WIDE:
                    undecided[v, u] = True
                if alpha < ALPHA_MIN:
                    continue
                pairs += 1
                after = t * (1 - alpha)
                if abs(after / TRANSMITTANCE_MIN - 1) < 1e-3:
                    undecided[v, u] = True
                transmittance[v, u] = after if after > TRANSMITTANCE_MIN else 0.0
    return drawn, boxes, pairs, entries


@torch.no_grad()
def work(model: Gaussians, camera: Camera, camera_from_world: SE3, tile: int) -> Work:
    """Composite in float64 by the reference's rules, and count. `tile`: pixels a side of the tiles that `entries` are counted in."""
    double = model.to(torch.float64)
    pose = camera_from_world.to_torch(torch.float64)
    centres, covariances, depths = reference.project(double.geometry, camera, pose)
    opacities = torch.sigmoid(double.opacity_logits)
    seen = torch.nonzero((depths > RenderSettings().near_plane) & (opacities > ALPHA_MIN))[:, 0]
    order = seen[torch.argsort(depths[seen], stable=True)]
    transmittance = np.ones((camera.height, camera.width))
    undecided = np.zeros((camera.height, camera.width), np.bool_)
    arrays = (centres.numpy(), covariances.numpy(), opacities.numpy(), order.numpy())
    drawn, boxes, pairs, entries = _composite(*arrays, tile, transmittance, undecided)
    return Work(len(model), drawn, boxes, pairs, entries, camera.width * camera.height, undecided)


def floors_ms(w: Work, flops: float, bytes_per_s: float, channels: int = 3) -> dict[str, float]:
    """Stage → milliseconds below which it cannot go on a core of so many FLOP/s and bytes a second."""
    n, image = w.gaussians, 4 * w.pixels * (channels + 1)
    counted = {
        "SH": (n * SH_FLOP, n * SH_BYTES),
        "projection": (n * PROJECT_FLOP, n * PROJECT_BYTES),
        "sort": (0, w.visible * SORT_BYTES),
        "binning": (0, w.visible * 8 + w.entries * 4),
        "blend": (w.pairs * (FORWARD_FLOP[0] + FORWARD_FLOP[1] * channels), w.visible * 4 * (8 + channels) + image),
        "blend, backward": (
            w.pairs * (BACKWARD_FLOP[0] + BACKWARD_FLOP[1] * channels),
            w.visible * 4 * (14 + 2 * channels) + 2 * image,
        ),
        "projection, backward": (n * PROJECT_BACKWARD_FLOP, n * PROJECT_BACKWARD_BYTES),
        "SH, backward": (n * SH_BACKWARD_FLOP, n * SH_BACKWARD_BYTES),
        "optimiser": (n * 59 * ADAM_FLOP, n * 59 * ADAM_BYTES),
    }
    return {stage: 1e3 * max(flop / flops, traffic / bytes_per_s) for stage, (flop, traffic) in counted.items()}


def peaks() -> tuple[float, float]:
    """FLOP/s of torch's float32 matrix product, and bytes/s (read and written) of scaling an array in place, which unlike a copy
    moves nothing else; with the threads that torch has."""
    a, b, long = torch.randn(1024, 1024), torch.randn(1024, 1024), torch.ones(1 << 26)
    return 2 * 1024**3 / _fastest_s(lambda: torch.mm(a, b)), 2 * 4 * len(long) / _fastest_s(lambda: long.mul_(1.0))


def _fastest_s(function: Callable[[], object], repeats: int = 7) -> float:
    samples = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        samples.append(time.process_time() - start)
    return min(samples)
