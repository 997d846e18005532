"""A temperature for every Gaussian, its standard error, and the number of views that see it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.base.memory import Memory
from rtgs.base.progress import Progress
from rtgs.base.threads import threads_at_most
from rtgs.maths import sh
from rtgs.models import GaussianTemperatures, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.radiometry import ThermalRange
from rtgs.records.scene import Scene
from rtgs.thermal.coverage import ridge
from rtgs.thermal.design import Design
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.least_squares import Problem, preconditioner, solve
from rtgs.thermal.passes import Passes
from rtgs.thermal.settings import CertaintySettings, LinearSettings


def gaussian_temperatures(
    scene: Scene,
    model: ThermalModel,
    *,
    settings: CertaintySettings | None = None,
    progress: Progress | None = None,
    memory: Memory | None = None,
) -> GaussianTemperatures:
    """Temperature, standard error and number of views of each Gaussian, from the training views.

    The temperature is the mean over the training views of what they see of the Gaussian. A view's weight is what the Gaussian
    contributes to its pixels. (The harmonics' constant part alone would include directions that no camera looked from.) With g the
    mean basis,

        temperature = gᵀ sh,    temperature_std² = σ² · gᵀ [(WᵀW + Λ)⁻¹] g,    σ² = Σ residual² / (pixels − degrees of freedom)

    W is the design matrix and Λ the inverse prior covariance, times σ². In band 0, Λ = σ²/τ² with τ the standard deviation of the
    scene's temperatures: the standard error of a Gaussian that no view sees is τ. Blocks of the inverse are estimated from samples of
    the posterior. Of a sample's variance, the part that a Gaussian has with its neighbours held fixed is computed exactly, and only
    the rest is sampled (Sidén et al., *Efficient covariance approximations for large sparse precision matrices*, 2018).

    So far noise is independent from pixel to pixel. Errors of the geometry are not, and they prevail. Therefore the standard errors are
    multiplied by one factor, so that 95 % intervals hold what the validation frames show of 95 % of the Gaussians that enough views see
    (`Check.factor`).

    Args:
        settings: None: the defaults.
        memory: what the run may take; None: the default.

    Raises:
        RtgsError: no training frame.
    """
    frames, settings = scene.train_frames, settings or CertaintySettings()
    if not frames:
        raise RtgsError("gaussian_temperatures: the scene has no training frame.")
    camera, linear = scene.rig.thermal, LinearSettings.within(memory)
    threads = linear.threads_for(camera.width * camera.height)
    with threads_at_most(threads):
        data = ThermalFrames.of(scene, frames, model.sfm_per_metre, model.color_range)
        kept, degree = linear.memory_bytes, model.gaussians.sh_degree
        design = Design(model.gaussians, camera, data.poses, degree, model.settings, threads=threads, kept_bytes=kept)
        passes = Passes(len(data) * (settings.iterations + 2), progress, "standard errors")
        generator = torch.Generator().manual_seed(0)

        validation = {frame.name for frame in scene.validation_frames}
        seen = _sum_over_views(model, camera, design, data, settings, generator, passes, validation)
        inverse_prior = _inverse_prior(design, seen, linear)
        has_offsets = bool(model.sensor.drift)
        samples = _sample_posterior(design, data, seen, inverse_prior, has_offsets, settings, generator, passes)
        mean_basis = seen.mean_basis()
        variance = _variance(design, seen, inverse_prior, samples, mean_basis)
        value = 0.5 + (mean_basis * model.gaussians.sh[..., 0]).sum(dim=1)
        passes.finish()
    sigma = math.sqrt(seen.squares / max(seen.pixels - samples.degrees_of_freedom, 0.1 * seen.pixels))
    noise_std = sigma * variance.sqrt()
    factor = seen.check.factor(value, noise_std, sigma, seen.views, settings) if settings.calibrate else 1.0
    calibrated = torch.where(seen.views > 0, factor, 1.0) * noise_std
    std = _std_in_degrees(model.color_range, value.numpy(), calibrated.numpy())
    return GaussianTemperatures(model.color_range.expand(value.numpy()), std, seen.views.numpy())


@dataclass(eq=False)
class Variance:
    """The variance of numbers that come in parts (Chan et al. 1983)."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def add(self, values: Tensor) -> None:
        """Add a part, which is not empty."""
        count, mean = len(values), float(values.double().mean())
        away = mean - self.mean
        self.squares += float((values.double() - mean).square().sum()) + away**2 * self.count * count / (self.count + count)
        self.mean += away * count / (self.count + count)
        self.count += count

    @property
    def value(self) -> float:
        """Without bias."""
        return self.squares / (self.count - 1)


@dataclass(eq=False)
class Check:
    """What the validation frames show of each Gaussian, `[N]` each.

    Attributes:
        coverage: pixels that it covers, Σ W. squares: Σ W².
        shown: Σ W · photograph, without drift and pattern of the sensor.
    """

    coverage: Tensor
    squares: Tensor
    shown: Tensor

    def factor(self, value: Tensor, std: Tensor, sigma: float, views: Tensor, settings: CertaintySettings) -> float:
        """By which standard errors have to be multiplied, from the 95 % quantile of the differences in units of their standard deviation.

        That of a difference has a part of the photograph: σ² Σ W² / (Σ W)². 1 where there is too little to compare.
        """
        known = (views >= settings.fewest_views) & (self.coverage >= settings.seen_px)
        if int(known.sum()) < settings.fewest_checked:
            return 1.0
        covered, std = self.coverage[known], std[known]
        off = (value[known] - self.shown[known] / covered).abs()
        scaled = off / (std.square() + sigma**2 * self.squares[known] / covered.square()).sqrt().clamp_min(1e-12)
        return float(np.quantile(scaled.numpy(), 0.95)) / 1.96


@dataclass(eq=False)
class _Seen:
    """Sums over the training views.

    Attributes:
        pixels: valid pixels of all views.
        noise_ratio: σ²/τ², mean square of the residuals over the variance of the temperatures.
        coverage: `[N + 1]`, pixels that each Gaussian and the background cover.
        views: `[N]`, how many views see the Gaussian.
        basis: `[N, K, 1]`, Σ basis · pixels covered.
        bounds: `[N, K, K]`, Σ (Σ W) basis ⊗ basis, for the preconditioner.
        blocks: `[N, K, K]`, Σ (Σ W²) basis ⊗ basis: the Gaussians' own blocks of WᵀW.
        squares: Σ residual².
        check: what the validation frames show.
    """

    pixels: float
    noise_ratio: float
    coverage: Tensor
    views: Tensor
    basis: Tensor
    bounds: Tensor
    blocks: Tensor
    squares: float
    check: Check

    def mean_basis(self) -> Tensor:
        """`[N, K]`: the basis in the mean direction of sight; of the constant band alone where no view sees the Gaussian."""
        covered = self.coverage[:-1]
        mean = self.basis[..., 0] / covered[:, None].clamp_min(1e-6)
        mean[covered < 1e-6] = torch.eye(mean.shape[1])[0] * sh.C0
        return mean


def _sum_over_views(
    model: ThermalModel,
    camera: Camera,
    design: Design,
    data: ThermalFrames,
    settings: CertaintySettings,
    generator: torch.Generator,
    each: Callable[[], None],
    validation: Collection[str],
) -> _Seen:
    """One pass over the training views. Σ W² is estimated from images of random signs: E (Σ ± W)² = Σ W²."""
    n, k = len(model.gaussians), design.coefficients
    values, pixels, squares = Variance(), len(data) * float(data.valid.sum()), 0.0
    coverage, views, basis = torch.zeros(n + 1), torch.zeros(n), torch.zeros(n, k, 1)
    bounds, blocks = torch.zeros(n, k, k), torch.zeros(n, k, k)
    check = Check(torch.zeros(n), torch.zeros(n), torch.zeros(n))
    for f, name in enumerate(data.names):
        signs = 2.0 * torch.randint(0, 2, (*data.valid.shape, settings.probes), generator=generator) - 1.0
        images = data.valid[..., None] * torch.cat([torch.ones_like(signs[..., :1]), signs], dim=-1)
        colors, background = design.weights(f, images)
        coverage += torch.cat([colors[:, 0], background[:1]])
        views += colors[:, 0] >= settings.seen_px
        design.add_harmonics(f, colors[:, :1].contiguous(), basis)
        design.add_blocks(f, colors[:, 0].contiguous(), bounds)
        design.add_blocks(f, (colors[:, 1:] ** 2).mean(dim=1), blocks)
        image = model.render(camera, data.poses[f], photographed_in=name)
        shown, photograph = torch.from_numpy(model.color_range.normalise(image)), data.images[f]
        values.add(photograph[data.valid > 0])
        squares += float((data.valid * (photograph - shown) ** 2).sum())
        if name in validation:
            scene = torch.from_numpy(model.color_range.normalise(model.render(camera, data.poses[f]))) + photograph - shown
            check.coverage += colors[:, 0]
            check.squares += (colors[:, 1:] ** 2).mean(dim=1)
            check.shown += design.weights(f, (data.valid * scene)[..., None])[0][:, 0]
        each()
    noise_ratio = max(squares / pixels / max(values.value, 1e-12), 1e-4)
    return _Seen(
        pixels=pixels,
        noise_ratio=noise_ratio,
        coverage=coverage,
        views=views,
        basis=basis,
        bounds=bounds,
        blocks=blocks,
        squares=squares,
        check=check,
    )


def _inverse_prior(design: Design, seen: _Seen, settings: LinearSettings) -> Tensor:
    """`[D]`, diagonal of Λ: the fit's default ridge, and σ²/τ² for band 0 and the background."""
    out = ridge(design, seen.coverage, settings.default_factor, settings)
    design.harmonics(out)[:, 0], out[-1] = sh.C0**2 * seen.noise_ratio, seen.noise_ratio
    return out


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of the posterior at σ = 1, about a mean of 0.

    Attributes:
        x: `[D, S]`, the samples.
        right: `[D, S]`, the right-hand sides that they solve: Wᵀ · noise + Λ · prior sample.
        noise: `[D, S]`, Wᵀ · noise.
    """

    x: Tensor
    right: Tensor
    noise: Tensor

    @property
    def degrees_of_freedom(self) -> float:
        """tr(WᵀW (WᵀW + Λ)⁻¹), estimated from the samples."""
        return float((self.noise * self.x).sum()) / self.x.shape[1]


def _sample_posterior(
    design: Design,
    data: ThermalFrames,
    seen: _Seen,
    inverse_prior: Tensor,
    has_offsets: bool,
    settings: CertaintySettings,
    generator: torch.Generator,
    each: Callable[[], None],
) -> _Samples:
    """Samples by solving for noise in place of photographs, about samples of the prior."""
    samples = settings.samples
    inverses, background = preconditioner(seen.bounds, float(seen.coverage[-1]), inverse_prior, design)
    prior = torch.randn(design.size, samples, generator=generator) / inverse_prior.sqrt()[:, None]
    noises = _Noises((*data.valid.shape, samples), len(data))
    ridges = inverse_prior[:, None].expand(-1, samples)
    offsets = torch.ones(samples) if has_offsets else None
    weights = [data.valid] * len(data)
    problem = Problem(
        design=design,
        frames=range(len(data)),
        images=noises,
        weights=weights,
        offsets=offsets,
        ridge=ridges,
        prior=prior,
        inverses=inverses,
        background=background,
    )
    x = solve(problem, prior, iterations=settings.iterations, each=each).x
    right = problem.gradient(torch.zeros_like(x), each)
    return _Samples(x, right, right - ridges * prior)


def _variance(design: Design, seen: _Seen, inverse_prior: Tensor, samples: _Samples, mean_basis: Tensor) -> Tensor:
    """`[N]`: gᵀ [(WᵀW + Λ)⁻¹] g = gᵀ own g + E (gᵀ (sample − own · right))².

    `own` is the variance of a Gaussian whose neighbours are held fixed: the inverse of its own block. What is left of a sample after
    own · right is the part that comes from the neighbours.
    """
    own = torch.linalg.inv(seen.blocks + torch.diag_embed(design.harmonics(inverse_prior)))
    given_others = design.harmonics(samples.x) - own @ design.harmonics(samples.right)
    variance = torch.einsum("ni,nij,nj->n", mean_basis, own, mean_basis)
    return variance + torch.einsum("nk,nkc->nc", mean_basis, given_others).square().mean(dim=1)


def _std_in_degrees(colors: ThermalRange, value: NDArray[np.floating], std: NDArray[np.floating]) -> NDArray[np.float32]:
    """A standard deviation of colours as one of temperatures, °C (or counts), by the slope at each colour."""
    above, below = (colors.expand(value.astype(np.float64) + by) for by in (5e-3, -5e-3))
    return (std * (above - below) / 1e-2).astype(np.float32)


class _Noises(Sequence[Tensor]):
    """Unit noise of `shape` for each frame. It is made anew at each access, the same each time, so that no memory holds it."""

    def __init__(self, shape: tuple[int, ...], frames: int) -> None:
        self._shape, self._frames = shape, frames

    def __len__(self) -> int:
        return self._frames

    def __getitem__(self, frame: int) -> Tensor:  # type: ignore[override]
        return torch.randn(self._shape, generator=torch.Generator().manual_seed(1 + range(self._frames)[frame]))

    def __iter__(self) -> Iterator[Tensor]:
        return (self[f] for f in range(len(self)))
