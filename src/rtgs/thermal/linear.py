"""The thermal fit as what it is, a linear least-squares problem: `solver = "linear"`.

Geometry, opacity and poses are frozen, so a thermal image is affine in the harmonics and the background. Nothing is added to the
colours and nothing is clamped; `as_model` states them so that `render`'s ½ and clamp change nothing. docs/thermal.md has the equations.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from rtgs.base.progress import Progress
from rtgs.config import ThermalConfig
from rtgs.images.patterns import quadratic_terms, sensor_pattern
from rtgs.maths import sh
from rtgs.models import RgbModel, ThermalModel
from rtgs.models.thermal import between
from rtgs.records.radiometry import LinearRange, ThermalRange, extended
from rtgs.records.scene import Scene
from rtgs.thermal.design import Design, threads_for
from rtgs.thermal.drift import Drift, Kind, estimate, in_gauge
from rtgs.thermal.frames import ThermalFrames, color_range, training_range
from rtgs.thermal.least_squares import Problem, preconditioner, solve
from rtgs.thermal.robust import solve_robustly

# The ridge, as pixels of evidence against which the data are weighed, per unit of a band's mean square over all directions. Band 0 is
# held to the mean of the pixels that a Gaussian covers. The other bands are held to zero in proportion to that coverage: what the
# geometry gets wrong is as large in a hundred pixels as in one, and view dependence would make up for it.
RIDGE_PX = 0.03
RIDGE_SHARE = 0.01
RIDGE_FACTORS = (0.1, 0.3, 1.0, 3.0)  # tried on validation frames
DEFAULT_FACTOR = 0.3  # until one is chosen, and where there are too few frames to try

VALIDATE_EVERY = 8  # of the training frames
SETTLED_AFTER = 2  # a validation error is settled that fell, over so many iterations, by less than a share of it:
SETTLED_LOOK, SETTLED_RIDGE = 0.02, 0.01  # by squares, where drift and pattern are looked at; by Huber's loss, for the ridge
HUBER = 0.25  # residuals count by their square up to so many root mean squares, beyond by their size
OFFSET_SHARE, GAIN_SHARE = 0.05, 0.02  # of the error on validation frames must be their own offsets', gains' for a look at drift
DRIFT_FRAMES = 3  # so many of them be there
DRIFT_GAIN, LEVEL_LOSS = 0.005, 1.25  # differences are predicted better by this share, levels no worse than by this factor
PATTERN_GAIN = 0.1  # what vignetting there is explains a third of the error or more; what geometry's faults feign, a twentieth
DRIFT_ITERATIONS = 4
ITERATIONS = 60
UNSEEN_ITERATIONS = 20  # where no frame is left to say when it is enough
USUAL_PASSES = 40
LAST_ITERATIONS = 12  # on all frames, from what most of them led to
PIXELS = 2_800_000  # of all photographs together are looked at, or one row of
MOST_ROWS = 4


class Passes:
    """Counts views drawn, for a person who waits. How many there will be is not known: `total` is what most fits need."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.text, self._progress = 0, total, "", progress

    def __call__(self) -> None:
        self.done = min(self.done + 1, self.total - 1)
        if self._progress is not None:
            self._progress(self.done, self.total, self.text)

    def finish(self) -> None:
        if self._progress is not None:
            self._progress(self.total, self.total, self.text)


def sampling(frames: int, valid: Tensor) -> int:
    """Of how many rows of each photograph one is looked at. The others say little that is new: what they see is in other photographs,
    at other rows."""
    every = min(max(round(frames * valid.numel() / PIXELS), 1), MOST_ROWS)
    return every if bool(valid[every // 2 :: every].any()) else 1


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the Gaussians see of the photographs, before anything is solved.

    Attributes:
        coverage: `[N + 1]`, pixels: Σ of the weights of each Gaussian and of the background.
        prior: `[D]`: for each band 0 the harmonic of the mean of the pixels that the Gaussian covers, likewise the background; else 0.
        blocks: `[N, K, K]`, see `preconditioner`.
    """

    coverage: Tensor
    prior: Tensor
    blocks: Tensor


def gather(design: Design, data: ThermalFrames, each: Callable[[], None] = lambda: None) -> Evidence:
    """One pass over all frames."""
    n, k = design.gaussians, design.coefficients
    level = sum(float((data.valid * i).sum()) for i in data.images) / (len(data) * float(data.valid.sum()))
    sums, blocks = torch.zeros(n + 1, 2), torch.zeros(n, k, k)
    for f in range(len(data)):
        colors, background = design.weights(f, torch.stack([data.valid * (data.images[f] - level), data.valid], dim=-1))
        sums += torch.cat([colors, background[None]])
        design.add_blocks(f, colors[:, 1].contiguous(), blocks)
        each()
    means = level + sums[:, 0] / (sums[:, 1] + RIDGE_PX)  # hardly seen: the scene's mean
    prior = torch.zeros(design.size)
    design.harmonics(prior)[:, 0] = means[:n] / sh.C0
    prior[-1] = means[n]
    return Evidence(sums[:, 1], prior, blocks)


def ridge(design: Design, coverage: Tensor, factor: float) -> Tensor:
    """`[D]`: the ridge at `factor` times its usual strength."""
    out = torch.full((design.size,), RIDGE_PX * factor)
    bands = design.harmonics(out)
    bands[:, 1:] += RIDGE_SHARE * factor * coverage[:-1, None]
    bands *= sh.C0**2
    return out


@dataclass(frozen=True, eq=False)
class Fit:
    """What does not change while a capture is fitted."""

    design: Design
    data: ThermalFrames
    evidence: Evidence
    median: float
    each: Callable[[], None]

    @staticmethod
    def of(design: Design, data: ThermalFrames, median: float, each: Callable[[], None] = lambda: None) -> Fit:
        return Fit(design, data, gather(design, data, each), median, each)

    @property
    def everywhere(self) -> list[Tensor]:
        """The weights of all frames before any is doubted: 1 where valid."""
        return [self.data.valid] * len(self.data)

    def problem(
        self,
        factors: Sequence[float],
        frames: Sequence[int],
        *,
        drift: tuple[Kind, Drift] | None = None,
        offsets: Tensor | None = None,
        surface: Tensor | None = None,
        surfaces: Tensor | None = None,
    ) -> Problem:
        """Ridges side by side, all frames weighed alike. Gains count as known, offsets as unknown; `offsets`: in which problems
        there are any, without drift. `surface`, `surfaces`: see `Problem`."""
        weights = self.everywhere
        photographs = [y[..., None] for y in self.data.images]
        if drift is not None and drift[0] == "gain-offset":
            gains = drift[1].gain
            photographs = [self.median + (y - self.median) / gains[f] for f, y in enumerate(photographs)]
            weights = [w * gains[f] ** 2 for f, w in enumerate(weights)]
        ridges = torch.stack([ridge(self.design, self.evidence.coverage, f) for f in factors], dim=1)
        inverses, background = preconditioner(
            self.evidence.blocks, float(self.evidence.coverage[-1]), ridges.log().mean(dim=1).exp(), self.design
        )
        prior = self.evidence.prior[:, None].expand(-1, len(factors))
        if drift is not None and drift[0] != "off":
            offsets = torch.ones(len(factors))
        return Problem(self.design, frames, photographs, weights, offsets, ridges, prior, inverses, background, surface, surfaces)

    def images(self, x: Tensor) -> list[Tensor]:
        """`[h, w, C]` a frame, of unknowns `[D, C]`."""
        out = []
        for image in self.design.each(lambda f: self.design.image(f, x), range(len(self.data))):
            out.append(image)
            self.each()
        return out

    def errors(self, kind: Kind, frames: Sequence[int], images: Sequence[Tensor], surface: Tensor | None = None) -> Tensor:
        """`[F]`: Σ |photograph − what the frame shows of the image|, with the gain and offset that suit it best.

        Args:
            surface: what suits all these frames best of it is taken out besides.
        """
        valid, photographs = self.data.valid, [self.data.images[f] for f in frames]
        if kind != "off":
            drift = estimate(kind, self.median, images, photographs, [valid] * len(frames))
            images = [drift.of(f, image) for f, image in enumerate(images)]
        left = torch.stack([y - image for y, image in zip(photographs, images, strict=True)])
        if surface is not None:
            terms = surface.flatten(0, 1)
            weighted = (valid.flatten()[:, None] * terms).T
            amounts = torch.linalg.pinv(weighted @ terms, hermitian=True) @ (weighted @ left.mean(0).flatten())
            left = left - (terms @ amounts).view_as(valid)
        return (valid * left.abs()).sum((1, 2))

    def drift(self, kind: Kind, images: Sequence[Tensor], weights: Sequence[Tensor]) -> tuple[Drift, list[Tensor]]:
        """The frames' gains and offsets at given images, and what is left of the photographs `[h, w]`."""
        drift = estimate(kind, self.median, images, self.data.images, weights)
        return drift, [y - drift.of(f, images[f]) for f, y in enumerate(self.data.images)]

    def pattern(self, left: Sequence[Tensor]) -> Tensor:
        """`[h, w]`: the sensor's, of what is left of photographs."""
        return torch.from_numpy(sensor_pattern(torch.stack(list(left)).numpy(), self.data.valid.numpy() > 0))

    def surface(self) -> Tensor:
        """`[h, w, 5]`: vignetting is a combination of these; each with mean 0 over the valid pixels."""
        terms = torch.from_numpy(quadratic_terms(tuple(self.data.valid.shape))[1:]).float()
        terms = terms - (terms * self.data.valid).sum((1, 2), keepdim=True) / self.data.valid.sum()
        return (terms * (self.data.valid > 0)).permute(1, 2, 0).contiguous()

    def without(self, pattern: Tensor) -> Fit:
        """The same with the sensor's pattern taken out of the photographs."""
        return replace(self, data=replace(self.data, images=tuple(y - pattern for y in self.data.images)))

    def gauged(self, kind: Kind, images: Sequence[Tensor]) -> tuple[Kind, Drift]:
        """For `problem`."""
        return kind, in_gauge(self.drift(kind, images, self.everywhere)[0])[0]


def fit_linear(
    scene: Scene, rgb_model: RgbModel, sfm_per_metre: float, config: ThermalConfig, progress: Progress | None
) -> ThermalModel:
    """See `fit_thermal`."""
    span = color_range(scene)
    whole = ThermalFrames.of(scene, scene.train_frames, sfm_per_metre, span)
    every = sampling(len(whole), whole.valid)
    with threads_for(whole.valid.numel() // every):
        return _fit(scene, rgb_model, sfm_per_metre, config, progress, span, whole, every)


def _fit(
    scene: Scene,
    rgb_model: RgbModel,
    sfm_per_metre: float,
    config: ThermalConfig,
    progress: Progress | None,
    span: ThermalRange,
    whole: ThermalFrames,
    every: int,
) -> ThermalModel:
    """`whole`: of which one row in `every` is looked at."""
    data = whole.rows(every)
    median = float(torch.cat([i[data.valid > 0] for i in data.images]).median())
    passes = Passes(len(data) * USUAL_PASSES, progress)

    design = partial(Design, rgb_model.gaussians.detach(), scene.rig.thermal, data.poses, config.sh_degree, rgb_model.settings)
    fit = Fit.of(design(every=every), data, median, passes)
    validation = list(range(VALIDATE_EVERY // 2, len(data), VALIDATE_EVERY))
    judge = Judge(fit, validation, fit.surface() if len(validation) >= DRIFT_FRAMES else None)
    seen = look(judge, config.drift)
    kind, found = seen.kind, seen.found

    def pattern(frames: Sequence[int] = range(len(data))) -> Tensor:
        left = fit.drift(kind, found.images, fit.everywhere)[1]
        return fit.pattern([left[f] for f in frames])

    patterned = has_pattern(judge, seen)
    judge = replace(judge, fit=fit.without(pattern(judge.rest)) if patterned else fit, surface=None)
    if seen.looks_drifting:
        kind, found = choose_gains(judge, kind, found)
    if kind == "gain-offset":
        found = further(judge, kind, found)
    factor, found = choose_ridge(judge, kind, found)
    if patterned:  # of all frames, and of images that no longer have a part in it
        judge = replace(judge, fit=fit.without(pattern()))
    found, drift, history = finish(judge.fit, factor, kind, found, LAST_ITERATIONS, passes)
    x = found.x
    if patterned and every > 1:
        fit = replace(fit, design=design(kept_bytes=0), data=whole)  # looked at once
        found = Solved.of(fit, x)[0]
    drawn = pattern().numpy() * np.float32(span.linear.width) if patterned else None
    drift, gain, offset = in_gauge(drift)
    x = moved(fit.design, x, gain, median * (1.0 - gain) + offset)
    passes.finish()
    model = replace(as_model(x, fit.design, rgb_model, training_range(scene), span, sfm_per_metre, history), pattern=drawn)
    return model if kind == "off" else replace(model, drift=drift.by_frame(data.names, span))


@dataclass(frozen=True, eq=False)
class Solved:
    """Unknowns `[D, 1]`, and what they look like in all frames, `[h, w]` each."""

    x: Tensor
    images: Sequence[Tensor]

    @staticmethod
    def of(fit: Fit, x: Tensor, shown: Mapping[int, Tensor] | None = None) -> list[Solved]:
        """Of C problems side by side, `[D, C]`; `shown` `[h, w, C]`: where it is known already."""
        images = fit.images(x) if shown is None else [shown[f] for f in range(len(fit.data))]
        return [Solved(x[:, c : c + 1].clone(), [i[..., c] for i in images]) for c in range(x.shape[1])]


@dataclass(frozen=True, eq=False)
class Judge:
    """What validation frames say of drift, of the sensor's pattern and of ridges.

    A frame's own offset and gain are unknown where the frame was not fitted, so models are compared by *differences* within validation
    frames: by the mean absolute error after the best offset, or gain and offset, has been taken out for both alike. And levels, with the
    drift that neighbours let expect, must not suffer by more than a quarter: where offsets go with the camera's path, harmonics predict
    them, and who wants temperatures as the camera would show them is served better so.
    """

    fit: Fit
    validation: Sequence[int]
    surface: Tensor | None = None

    @property
    def rest(self) -> list[int]:
        return [f for f in range(len(self.fit.data)) if f not in self.validation]

    def errors(self, kind: Kind, images: Mapping[int, Tensor] | Sequence[Tensor]) -> Tensor:
        """Of the validation frames; `images` has these or all frames."""
        return self.fit.errors(kind, self.validation, [images[f] for f in self.validation], self.surface)

    def is_worth_a_look(self, images: Sequence[Tensor], kind: Kind, share: float) -> bool:
        """Whether so much of the error that `kind` leaves goes with gains and offsets of the validation frames' own."""
        if len(self.validation) < DRIFT_FRAMES:
            return False
        return float(self.errors("gain-offset", images).sum()) <= (1.0 - share) * float(self.errors(kind, images).sum())

    def level(self, kind: Kind, images: Sequence[Tensor]) -> float:
        """Error of the validation frames with the drift that the other frames let expect."""
        fit = self.fit
        drift, gain, offset = in_gauge(fit.drift(kind, images, fit.everywhere)[0].only(self.rest))
        away = torch.stack([drift.gain - 1.0, drift.offset], dim=1).double().numpy()
        shown = {}
        for f in self.validation:
            own_gain, own_offset = between(away, away[:, 1], bisect(self.rest, f))
            scene = gain * (images[f] - fit.median) + offset
            shown[f] = fit.median + float(own_offset) + (1.0 + float(own_gain)) * scene
        return float(self.errors("off", shown).sum())

    def is_better(self, kind: Kind, before: Sequence[Tensor], after: Sequence[Tensor]) -> bool:
        return clearly_less(self.errors(kind, after), self.errors(kind, before), DRIFT_GAIN)


def clearly_less(errors: Tensor, before: Tensor, by: float) -> bool:
    """Of the validation frames `[F]`: by this share and a standard error in the mean; and by it in most, not for the sake of one."""
    gain = before - errors
    certain = float(gain.std()) / len(gain) ** 0.5
    share = (gain / before.clamp_min(1e-12)).quantile(0.5)
    return float(gain.mean()) > max(by * float(before.mean()), certain) and float(share) > by


class Watch:
    """For `settled` of a solver: whether iterations do little for the error of the validation frames, which its problems leave out, in
    any of them that may yet win: what is ahead now need not be where it ends. Not so those that would stay behind the best if they fell
    by as much again.

    Args:
        kinds: of drift, one a problem. share: of an error; to fall by less, over `SETTLED_AFTER` iterations, is to be settled.

    Attributes:
        errors: `[C]`.
    """

    def __init__(self, judge: Judge, kinds: Sequence[Kind], share: float) -> None:
        self.errors = torch.zeros(len(kinds))
        self._judge, self._kinds, self._share = judge, kinds, share
        self._before = [torch.full((len(kinds),), math.inf)] * SETTLED_AFTER

    def __call__(self, x: Tensor) -> bool:
        fit = self._judge.fit
        images = list(fit.design.each(lambda f: fit.design.image(f, x), self._judge.validation))
        for c, kind in enumerate(self._kinds):
            shown = {f: image[..., c] for f, image in zip(self._judge.validation, images, strict=True)}
            self.errors[c] = self._judge.errors(kind, shown).sum()
        self._before.append(self.errors.clone())
        fall = self._before[-1 - SETTLED_AFTER] - self.errors
        is_behind = self.errors - fall > self.errors.min()
        return bool((is_behind | (fall < self._share * (self.errors + fall))).all())


@dataclass(frozen=True, eq=False)
class Look:
    """What validation frames say of offsets.

    Attributes:
        kind: of drift, as far as it is decided: gains come later.
        found: what goes with it, fitted to the other frames.
        looks_drifting: whether gains are to be looked into.
        with_surface, without: two solutions that differ by the common surface alone.
    """

    kind: Kind
    found: Solved
    looks_drifting: bool
    with_surface: Solved
    without: Solved


def look(judge: Judge, drift: Literal["auto"] | Kind) -> Look:
    """Three problems side by side: each frame with an offset of its own, and nothing known of the sensor's pattern but that it is nearly
    a common surface; the same without that surface, by which the pattern is judged; and without offsets, by which these are.

    Args:
        drift: what to say of it, if not "auto".
    """
    fit, start = judge.fit, judge.fit.evidence.prior[:, None]
    if not judge.validation:
        problem = fit.problem((DEFAULT_FACTOR,), judge.rest)
        only = Solved.of(fit, solve(problem, start, iterations=UNSEEN_ITERATIONS, each=fit.each))[0]
        return Look("off" if drift == "auto" else drift, only, False, only, only)
    offsets, surfaces = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 1.0])
    problem = fit.problem((DEFAULT_FACTOR,) * 3, judge.rest, offsets=offsets, surface=judge.surface, surfaces=surfaces)
    watch = Watch(judge, ["offset", "offset", "off"], SETTLED_LOOK)
    x = solve(problem, start.expand(-1, 3), iterations=ITERATIONS, settled=watch, each=fit.each)
    usual, bare, steady = Solved.of(fit, x)
    looks_drifting = drift == "auto" and judge.is_worth_a_look(steady.images, "off", OFFSET_SHARE)
    found = Look("offset", usual, looks_drifting, usual, bare)
    if drift in ("offset", "gain-offset"):
        return replace(found, kind=drift)
    if looks_drifting and judge.is_better("offset", steady.images, usual.images):
        allowed = LEVEL_LOSS * float(judge.errors("off", steady.images).sum())
        if judge.level("offset", usual.images) <= allowed:
            return found
    return replace(found, kind="off", found=steady)


def robustly(
    judge: Judge, factors: Sequence[float], kind: Kind, start: Solved, iterations: int, watch: Watch | None = None
) -> list[Solved]:
    """Under several ridges, by Huber's loss, with the gains that suit the images of `start`."""
    fit, rest = judge.fit, judge.rest
    problem = fit.problem(factors, rest, drift=fit.gauged(kind, start.images))
    shown = [start.images[f][..., None] for f in rest]
    settled = watch or (lambda x: False)
    solution = solve_robustly(problem, start.x, huber=HUBER, iterations=iterations, shown=shown, settled=settled, each=fit.each)
    known = {f: solution.shown(f) for f in rest} | {f: fit.design.image(f, solution.x) for f in judge.validation}
    return Solved.of(fit, solution.x, known)


def choose_ridge(judge: Judge, kind: Kind, start: Solved) -> tuple[float, Solved]:
    """The factor with the smallest error, and what it leads to; with the sensor's pattern out."""
    if not judge.validation:
        return DEFAULT_FACTOR, start
    watch = Watch(judge, [kind] * len(RIDGE_FACTORS), SETTLED_RIDGE)
    solved = robustly(judge, RIDGE_FACTORS, kind, start, ITERATIONS, watch)
    chosen = int(watch.errors.argmin())
    return RIDGE_FACTORS[chosen], Solved(solved[chosen].x, [i.clone() for i in solved[chosen].images])  # the others may go


def further(judge: Judge, kind: Kind, start: Solved) -> Solved:
    """A few iterations."""
    return robustly(judge, (DEFAULT_FACTOR,), kind, start, DRIFT_ITERATIONS)[0]


def choose_gains(judge: Judge, kind: Kind, start: Solved) -> tuple[Kind, Solved]:
    """Whether frames have a gain besides, the sensor's pattern taken out: vignetting that is left in looks like one."""
    if not judge.is_worth_a_look(start.images, kind, GAIN_SHARE):
        return kind, start
    before, after = further(judge, kind, start), further(judge, "gain-offset", start)
    if not judge.is_better("gain-offset", before.images, after.images):
        return kind, start
    if judge.level("gain-offset", after.images) > LEVEL_LOSS * judge.level(kind, before.images):
        return kind, start
    return "gain-offset", after


def has_pattern(judge: Judge, seen: Look) -> bool:
    """Whether the sensor adds something to every photograph: photographs that it was not taken from are predicted better with it.

    It is sought in what a model of the scene leaves, in which the scene itself is small; and judged against a model that may explain
    the surface itself: a wall that stays at the top of all pictures is no vignetting.
    """
    fit = judge.fit
    if len(judge.validation) < DRIFT_FRAMES:
        return False
    left = fit.drift("offset", seen.with_surface.images, fit.everywhere)[1]
    clean = replace(judge, fit=fit.without(fit.pattern([left[f] for f in judge.rest])), surface=None)
    errors = clean.errors("gain-offset", seen.with_surface.images)
    return clearly_less(errors, replace(judge, surface=None).errors("gain-offset", seen.without.images), PATTERN_GAIN)


def finish(
    fit: Fit, factor: float, kind: Kind, start: Solved, iterations: int, passes: Passes
) -> tuple[Solved, Drift, dict[str, list[float]]]:
    """By Huber's loss on all frames; gains alternate with the colours.

    Iterations are few on purpose: what conjugate gradients find late is what fits the noise.

    Returns:
        With drift before the gauge is fixed, and the history.
    """
    valid = fit.data.valid
    history: dict[str, list[float]] = {"step": [], "loss": []}

    def note(step: int, left: Sequence[Tensor]) -> None:
        rms = math.sqrt(sum(float((valid * r**2).sum()) for r in left) / (len(left) * float(valid.sum())))
        history["step"].append(step)
        history["loss"].append(rms)
        passes.text = f"residual {rms:.4f}"

    found, weights = start, fit.everywhere
    turn = DRIFT_ITERATIONS if kind == "gain-offset" else iterations
    for done in range(0, iterations, turn):
        drift, left = fit.drift(kind, found.images, weights)
        note(done, left)
        problem = fit.problem((factor,), range(len(fit.data)), drift=(kind, in_gauge(drift)[0]))
        shown = [i[..., None] for i in found.images]
        solution = solve_robustly(
            problem, found.x, huber=HUBER, iterations=min(turn, iterations - done), shown=shown, each=passes
        )
        found = Solved(solution.x, [solution.shown(f)[..., 0] for f in range(len(fit.data))])
        weights = [solution.weights(f)[..., 0] for f in range(len(fit.data))]
    drift, left = fit.drift(kind, found.images, weights)
    note(iterations, left)
    return found, drift, history


def moved(design: Design, x: Tensor, gain: float, offset: float) -> Tensor:
    """The unknowns whose images are `gain · image + offset`."""
    x = gain * x
    design.harmonics(x)[:, 0] += offset / sh.C0
    x[-1] += offset
    return x


def as_model(
    x: Tensor,
    design: Design,
    rgb_model: RgbModel,
    scores: LinearRange,
    span: ThermalRange,
    sfm_per_metre: float,
    history: Mapping[str, list[float]],
) -> ThermalModel:
    """The unknowns, in units of `span`, as colours that `render` shows without ever clamping; `scores` becomes the model's `range`.

    Colour 0 is put at or below the lowest value that any Gaussian has in any direction: with band norms |sh_l|, a colour lies within
    Σ_{l ≥ 1} √((2l + 1) / 4π) · |sh_l| of its constant part.
    """
    harmonics, background = design.harmonics(x)[..., 0], float(x[-1, 0])
    lowest = sh.C0 * harmonics[:, 0]
    for l in range(1, math.isqrt(design.coefficients)):
        lowest = lowest - math.sqrt((2 * l + 1) / (4 * math.pi)) * harmonics[:, l * l : (l + 1) ** 2].norm(dim=1)
    floor = min(float(lowest.min()), background)
    floor = floor - 1e-3 if floor < 0 else 0.0  # a thousandth of the range further, for the last digits of float32
    colors = harmonics / (1.0 - floor)
    colors[:, 0] += (-floor / (1.0 - floor) - 0.5) / sh.C0
    return ThermalModel(
        replace(rgb_model.gaussians.detach(), sh=colors[..., None].contiguous()),
        torch.tensor([(background - floor) / (1.0 - floor)]),
        scores,
        rgb_model.settings,
        float(sfm_per_metre),
        history,
        extended(span, floor),
    )
