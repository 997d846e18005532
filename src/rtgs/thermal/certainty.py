"""A temperature for every Gaussian, how sure it is, and how many views say so."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.maths import sh
from rtgs.models import GaussianTemperatures, ThermalModel
from rtgs.records.capture import Frame
from rtgs.records.radiometry import ThermalRange
from rtgs.records.scene import Scene
from rtgs.thermal.design import Design, threads_for
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.least_squares import Problem, preconditioner, solve
from rtgs.thermal.linear import DEFAULT_FACTOR, ridge

SEEN_PX = 0.5  # a view sees a Gaussian that contributes this much to its pixels, all together
SAMPLES = 8
PROBES = 7  # random signs a view
ITERATIONS = 40  # fewer leave the spread of the prior in what is seen least: too large rather than too small


def gaussian_temperatures(scene: Scene, model: ThermalModel, *, progress: Progress | None = None) -> GaussianTemperatures:
    """What the training views say of each Gaussian.

    The temperature is the mean over the training views of what they see of it, a view counting by what the Gaussian contributes to its
    pixels: the harmonics' constant part alone would speak of directions that nobody looked from. With g the mean basis,

        temperature = gᵀ sh,    temperature_std² = σ² · gᵀ [(Wᵀ W + σ²/τ²)⁻¹] g,    σ² = Σ residual² / (pixels − degrees of freedom)

    W is the design matrix and τ the spread before anything is seen: in band 0 the standard deviation of the scene's temperatures, which
    is therefore what an unseen Gaussian has. Blocks of the inverse are estimated from samples of the posterior that are drawn by solving
    for noise in place of photographs; of their spread, what a Gaussian has beside its neighbours held fixed is known exactly and only
    the rest is sampled (Sidén et al., *Efficient covariance approximations for large sparse precision matrices*, 2018).

    Noise counts as independent from pixel to pixel: errors of geometry are not, and where they prevail this is a lower bound.

    Raises:
        RtgsError: no training frame.
    """
    frames = scene.train_frames
    if not frames:
        raise RtgsError("gaussian_temperatures: the scene has no training frame.")
    with threads_for(scene.rig.thermal.width * scene.rig.thermal.height):
        return _of_frames(scene, frames, model, progress)


def _of_frames(scene: Scene, frames: Sequence[Frame], model: ThermalModel, progress: Progress | None) -> GaussianTemperatures:
    """See `gaussian_temperatures`."""
    data = ThermalFrames.of(scene, frames, model.sfm_per_metre, model.colors)
    gaussians = model.gaussians
    design = Design(gaussians, scene.rig.thermal, data.poses, gaussians.sh_degree, model.settings)
    n, k, pixels = len(gaussians), design.coefficients, len(data) * float(data.valid.sum())
    total, done = len(data) * (ITERATIONS + 2), 0

    def each() -> None:
        nonlocal done
        done = min(done + 1, total - 1)
        if progress is not None:
            progress(done, total, "standard errors")

    signs = torch.Generator().manual_seed(0)
    coverage, views, squares = torch.zeros(n + 1), torch.zeros(n), 0.0
    seen, bounds, blocks = torch.zeros(n, k, 1), torch.zeros(n, k, k), torch.zeros(n, k, k)
    for f, frame in enumerate(frames):
        flips = 2.0 * torch.randint(0, 2, (*data.valid.shape, PROBES), generator=signs) - 1.0
        images = data.valid[..., None] * torch.cat([torch.ones_like(flips[..., :1]), flips], dim=-1)
        colors, background = design.weights(f, images)
        coverage += torch.cat([colors[:, 0], background[:1]])
        views += colors[:, 0] >= SEEN_PX
        design.add_harmonics(f, colors[:, :1].contiguous(), seen)
        design.add_blocks(f, colors[:, 0].contiguous(), bounds)
        design.add_blocks(f, (colors[:, 1:] ** 2).mean(dim=1), blocks)  # E (Σ ± w)² = Σ w²
        image = model.render(scene.rig.thermal, data.poses[f], photographed_in=frame.name)
        shown = torch.from_numpy(model.colors.normalise(image))
        squares += float((data.valid * (data.images[f] - shown) ** 2).sum())
        each()
    mean_basis = seen[..., 0] / coverage[:-1, None].clamp_min(1e-6)
    mean_basis[coverage[:-1] < 1e-6] = torch.eye(k)[0] * sh.C0
    values = torch.cat([y[data.valid > 0] for y in data.images])
    spread = max(squares / pixels / max(float(values.var()), 1e-12), 1e-4)  # σ² / τ²
    penalty = ridge(design, coverage, DEFAULT_FACTOR)
    design.harmonics(penalty)[:, 0], penalty[-1] = sh.C0**2 * spread, spread

    inverses, divisor = preconditioner(bounds, float(coverage[-1]), penalty, design)
    prior = torch.randn(design.size, SAMPLES, generator=signs) / penalty.sqrt()[:, None]
    noises = _Noises(data.valid.shape, len(data))
    weights = [data.valid] * len(data)
    ridges = penalty[:, None].expand(-1, SAMPLES)
    offsets = torch.ones(SAMPLES) if model.drift else None
    problem = Problem(design, range(len(data)), noises, weights, offsets, ridges, prior, inverses, divisor)
    x = solve(problem, prior, iterations=ITERATIONS, each=each)
    right = problem.gradient(torch.zeros_like(x), each)
    freedom = float(((right - ridges * prior) * x).sum()) / SAMPLES
    sigma = math.sqrt(squares / max(pixels - freedom, 0.1 * pixels))

    own = torch.linalg.inv(blocks + torch.diag_embed(design.harmonics(penalty)))
    given_others = design.harmonics(x) - own @ design.harmonics(right)
    variance = torch.einsum("ni,nij,nj->n", mean_basis, own, mean_basis)
    variance += torch.einsum("nk,nkc->nc", mean_basis, given_others).square().mean(dim=1)
    value = 0.5 + (mean_basis * gaussians.sh[..., 0]).sum(dim=1)
    if progress is not None:
        progress(total, total, "standard errors")
    return GaussianTemperatures(
        model.colors.expand(value.numpy()),
        _spread(model.colors, value.numpy(), sigma * variance.sqrt().numpy()),
        views.numpy(),
    )


def _spread(colors: ThermalRange, value: np.ndarray, std: np.ndarray) -> np.ndarray:
    """A small spread of a colour as one of its temperature, °C (or counts)."""
    above, below = (colors.expand(value.astype(np.float64) + by) for by in (5e-3, -5e-3))
    return (std * (above - below) / 1e-2).astype(np.float32)


class _Noises(Sequence[Tensor]):
    """`[h, w, SAMPLES]` of unit noise a frame, made anew whenever it is asked for."""

    def __init__(self, shape: Sequence[int], frames: int) -> None:
        self._shape, self._frames = (*shape, SAMPLES), frames

    def __len__(self) -> int:
        return self._frames

    def __getitem__(self, frame: int) -> Tensor:  # type: ignore[override]
        return torch.randn(self._shape, generator=torch.Generator().manual_seed(1 + range(self._frames)[frame]))

    def __iter__(self) -> Iterator[Tensor]:
        return (self[f] for f in range(len(self)))
