"""The numbers of the linear thermal fit and of the standard errors, each with its unit, its reason and how it was chosen.

"Chosen on validation frames" means: by the error on every 8th training frame, left out of the fit, of the seven synthetic scenes and
the ARCO capture. No number was chosen on held-out frames. `benchmarks/thermal_rules.py` measures what each rule is worth.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba as nb

from rtgs.base.memory import Memory


@dataclass(frozen=True)
class FollowSettings:
    """Numbers of the finer geometry (`ThermalConfig.geometry = "follow"`)."""

    times: float = 3.0
    """At most so many times the RGB model's Gaussians. On synthetic scenes, twice as many more lower the error of views that are held out
    by a further 5 %, at half as much time again."""
    finest_px: float = 0.5
    """Gaussians whose deviation is less than this in the photographs that see them are not split: a pixel shows no less."""
    detail: float = 10.0
    """Weight of the residuals that photographs agree about against the number of pixels covered, where these residuals are of mean size.
    With less, small spots get less of the room; with more, the error everywhere falls less."""
    most_harm: float = 0.02
    """Share by which the mean error on validation frames may rise, if it falls where photographs agree that something is missing. Spots are
    few pixels, and a mean over all hardly sees them."""
    seen_px: float = 0.5
    """Gaussians that contribute less than this to all photographs together are not split."""
    neighbours: int = 8
    """Views that are compared with each, those that see most of the same surface. Twice as many bring nothing."""
    fewest_views: int = 2
    """Other views that must see a place before they can agree about it."""
    clear: float = 2.0
    """They agree where the median of their residuals is this many standard errors from zero."""
    depth_share: float = 0.03
    """Two views see the same place where their depths differ by less than this share. Depths of a trained model are good to a hundredth or
    two."""
    steps: int = 200
    """Steps of Adam on the geometry (`ThermalConfig.geometry = "refine"`), one photograph each. Half as many gain half as much on a
    synthetic room."""


@dataclass(frozen=True)
class LinearSettings:
    """Numbers of the linear thermal fit (`ThermalConfig.solver = "linear"`)."""

    # The ridge.
    ridge_px: float = 0.03
    """Strength of the ridge on every band, in pixels: how many pixels of a photograph weigh as much as the prior. So small that it
    decides only for Gaussians that hardly any pixel sees. Chosen on validation frames."""
    ridge_share: float = 0.01
    """Additional ridge on the direction-dependent bands, as a share of the pixels that a Gaussian covers. Errors of the geometry do not
    average out over pixels, and view dependence would explain them. Chosen on validation frames."""
    ridge_factors: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
    """Factors on both ridges that are tried on validation frames, about a factor of three apart."""
    default_factor: float = 0.3
    """The factor until one is chosen, and where there are too few frames to choose. It is the one chosen most often (20 of 36 times in the
    study of the rules)."""

    # Validation frames.
    fewest_frames: int = 3
    """Validation frames that are needed to decide about drift and the sensor's pattern: with fewer there is no standard error."""

    # Iterations.
    iterations: int = 60
    """Most iterations of a solver while validation frames can stop it. A bound for safety: early stopping takes 2 to 6 on the captures of
    the study, and up to 40 where the geometry is exact."""
    unvalidated_iterations: int = 20
    """Iterations where no validation frame can stop the solver: more than early stopping takes, for few photographs cost little."""
    last_iterations: int = 12
    """Iterations on all training frames, from the solution without validation frames. Chosen on validation frames."""
    gain_iterations: int = 4
    """Iterations after which models with and without gains are compared, and after which gains are estimated anew. Gains settle faster
    than colours."""
    stop_share_first: float = 0.02
    """The first solve stops when no iteration lowers a validation error by this share any more. It only has to be good enough to compare
    models. Chosen on validation frames."""
    stop_share_ridge: float = 0.01
    """The same while the ridge is chosen. Its solution is kept, so it goes on for longer. Chosen on validation frames."""

    # The robust loss.
    huber: float = 0.25
    """Bound of Huber's loss, in root mean squares of the residuals at the start: residuals count by their square below and by their size
    beyond. Errors of the geometry are large in few pixels. Chosen on validation frames."""

    # Drift and the sensor's pattern.
    drift_share: float = 0.02
    """Offsets (gains) are considered only if offsets and gains of the validation frames' own would explain this share of their error.
    Where the geometry is nearly exact, a model with more unknowns is better by tiny amounts that are clear all the same."""
    drift_gain: float = 0.005
    """Share by which offsets (or gains) must lower the error within validation frames, besides being more than a standard error and in
    most frames. The smallest difference that is worth an unknown more for each frame; chosen on validation frames."""
    gain_limits: tuple[float, float] = (0.5, 2.0)
    """Limits of a frame's gain. No useful automatic gain control goes beyond; a frame without contrast could have any gain."""
    pattern_gain: float = 0.1
    """The same share for the sensor's pattern. Real vignetting explains a fifth of the error or more. Errors of the geometry that stay in
    the same place of all photographs look like a pattern that explains a twentieth."""

    # The geometry.
    follow: FollowSettings = field(default_factory=FollowSettings)
    """How it follows the thermal images."""

    # Work.
    pixels: int = 2_800_000
    """Pixels that are fitted, of all photographs together. With more, one row in two, three or four is used: the rows between see
    nothing that other photographs do not see."""
    most_rows: int = 4
    """At most one row in so many is used, so that Gaussians a few pixels large do not fall between rows."""
    usual_passes: int = 40
    """Passes over all frames that most fits need; only for the progress display."""
    memory_bytes: int = 3 << 29
    """Memory for what the fit keeps."""
    images_share: float = 0.75
    """Share of it that photographs and residuals may take; the renderer's weights have the rest."""
    bytes_per_pixel: int = 64
    """What the fit keeps for each pixel that is fitted, of all photographs together: sixteen images, at most. Where that share of the
    memory holds fewer, more rows are passed over than `most_rows` says."""
    kept_bytes: int | None = None
    """Memory for the renderer's weights, in bytes; None: what photographs and residuals leave. Weights of views that do not fit are
    computed again at each use."""
    small_image_px: int = 1 << 16
    """Images with fewer pixels are worked on by one thread: several would spend what they gain on waiting for each other."""
    threads: int | None = None
    """Frames that are worked on at once; None: Numba's number of threads, or one for small images."""

    @staticmethod
    def within(memory: Memory | None) -> LinearSettings:
        """The defaults within a run's memory; None: the default memory."""
        return LinearSettings(memory_bytes=(memory or Memory.of()).fit)

    def weights_bytes(self, pixels: int) -> int:
        """Memory for the renderer's weights where so many pixels are fitted, of all photographs together."""
        return max(self.memory_bytes - self.bytes_per_pixel * pixels, 0) if self.kept_bytes is None else self.kept_bytes

    def threads_for(self, pixels: int) -> int:
        """How many threads work on images of so many pixels."""
        if self.threads is not None:
            return self.threads
        return 1 if pixels < self.small_image_px else nb.get_num_threads()


@dataclass(frozen=True)
class CertaintySettings:
    """Numbers of the Gaussians' temperatures and standard errors (`gaussian_temperatures`)."""

    seen_px: float = 0.5
    """A view sees a Gaussian that contributes this much to its pixels, all together. Half a pixel stands out of the noise."""
    calibrate: bool = True
    """Multiply standard errors by one factor, from validation frames. Without it they hold the noise alone."""
    fewest_views: int = 3
    """Standard errors are calibrated on Gaussians that so many views see: with fewer there is no depth."""
    fewest_checked: int = 40
    """Such Gaussians that the calibration needs. The 95 % quantile of 40 is the third largest."""
    samples: int = 8
    """Samples of the posterior. The standard error of a standard error is then a quarter, of the part that is sampled."""
    probes: int = 7
    """Images of random signs for each view. With the image of ones they make eight, one vector register."""
    iterations: int = 40
    """Iterations of the solver. Fewer leave the spread of the prior in what is seen least: too large rather than too small."""
