"""The default solver: every scale that the images can tell apart, then down from the best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from rtgs.scale.bracket import information
from rtgs.scale.checks import better_than_none, disagreeing, softness
from rtgs.scale.curves import LocalCurves, Window, first_half_width, settled, widened
from rtgs.scale.descend import Place
from rtgs.scale.interval import resampled_interval
from rtgs.scale.minima import CoarseToFine, other_minima
from rtgs.scale.objective import Objective
from rtgs.scale.problem import Found, Problem
from rtgs.scale.records import History, Scan, Step
from rtgs.scale.resampling import QUANTILE_95
from rtgs.scale.scan import local_minima, losses_over, scan_thetas
from rtgs.scale.thermal_targets import EPSILON_FRAMES, Pictures, halvings
from rtgs.scale.verdict import at_an_end, no_better_than_none, outside


class _Scanned(NamedTuple):
    """θ to start from, best first; the scan, where there was one; a doubt about it; and how many pictures were rendered."""

    starts: list[float]
    scan: Scan | None
    doubt: str
    renders: int


class _Softened(NamedTuple):
    """The pictures with the blur that suits them, the best place under it, further steps and how many pictures were rendered."""

    pictures: Pictures
    place: Place
    steps: tuple[Step, ...]
    renders: int


@dataclass(frozen=True)
class GlobalSearch:
    """Scan the bracket at a coarse size, refine its minima by Gauss–Newton, and settle on the minimum of the frames' mean curve.

    Attributes:
        scan_frames, refine_frames: how many frames are scanned and refined with, the most informative ones.
        first_frames: how many frames the curves around the answer begin with; they are doubled until the interval is narrow enough.
    """

    scan_frames: int = 10
    refine_frames: int = 16
    first_frames: int = 16

    def solve(self, problem: Problem) -> Found:
        """Scan, descend from the minima of the scan, blur where the lens is soft, settle on the curves' minimum, and check it."""
        frames, bracket, progress, seed = problem.frames, problem.bracket, problem.progress, problem.config.seed
        progress.plan(EPSILON_FRAMES)
        pictures = Pictures.of(problem)
        worth = information(problem.scene, problem.model, frames)
        ranked = sorted(range(len(frames)), key=lambda i: -worth[i])
        halved = halvings(problem.scene)
        search = CoarseToFine(pictures, tuple(sorted(ranked[: self.refine_frames])), halved, bracket, progress)
        scanned = self._scan(problem, search, sorted(ranked[: self.scan_frames]))
        progress.plan(len(scanned.starts) * search.renders_each + 6 * len(frames))
        refined = search.from_starts(scanned.starts)
        softened = self._softened(problem, search, refined.minima[0].place)
        best, pictures = softened.place, softened.pictures
        doubt = scanned.doubt or outside(best.theta, bracket)

        objective = pictures.objective()
        curves, closed = self._curves(problem, objective, ranked, best, enough=bool(doubt))
        theta, used, check_renders, apart = curves.minimum(), curves.frames, 0, tuple[str, ...]()
        if not doubt:
            better = better_than_none(pictures.objective(min(1, halved)), used, theta, bracket, progress)
            check_renders += better.renders
            doubt = "" if better.clearly else no_better_than_none(theta, bracket)
        if closed and not doubt:
            disagreement = disagreeing(pictures, halved, used, theta, bracket, progress)
            check_renders += disagreement.renders
            apart = disagreement.frames
        return Found(
            theta,
            math.exp(refined.minima[0].start),
            curves,
            closed,
            History.of([*refined.steps, *softened.steps]),
            renders=pictures.renders + scanned.renders + refined.renders + softened.renders + curves.renders + check_renders,
            doubt=doubt,
            scan=scanned.scan,
            minima=other_minima(refined.minima, seed),
            disagreeing=apart,
            blur_px=pictures.blur_px,
        )

    def _scan(self, problem: Problem, search: CoarseToFine, indices: Sequence[int]) -> _Scanned:
        """Where to start: the minima of a scan, or `ScaleConfig.init` alone."""
        if problem.config.init is not None:
            return _Scanned([math.log(problem.config.init)], None, "", 0)
        thetas = scan_thetas(problem.bracket, 2**search.halved)
        problem.progress.plan(len(thetas) * len(indices) + search.renders_each + 6 * len(search.frames))
        objective = search.pictures.objective(search.halved)
        losses = losses_over(thetas, objective, indices, problem.progress, "scan")
        candidates = local_minima(losses)
        doubt = at_an_end("above", problem.bracket) if candidates[0] == len(thetas) - 1 else ""
        scan = Scan.of(thetas, losses, [problem.frames[i].name for i in indices])
        return _Scanned([float(thetas[j]) for j in candidates], scan, doubt, losses.size)

    def _softened(self, problem: Problem, search: CoarseToFine, place: Place) -> _Softened:
        """Down again from a minimum, with the renders blurred as the thermal images are, as far as that makes them agree.

        A soft edge is as wide as the blur, and where in it a sharp edge lies best depends on what else is near. An equally soft edge
        lies better there: Table II has less than half the error at 4 px of blur.
        """
        if not problem.comparison.match_blur:
            return _Softened(search.pictures, place, (), 0)
        found = softness(search.pictures.objective(), search.frames, place.theta, problem.progress)
        if found.blur_px == 0.0:
            return _Softened(search.pictures, place, (), found.renders)
        pictures = replace(search.pictures, blur_px=found.blur_px)
        problem.progress.plan(search.renders_each)
        descent = replace(search, pictures=pictures).descend(place.theta, 0)
        return _Softened(pictures, descent.place, descent.steps, found.renders + descent.renders)

    def _curves(
        self, problem: Problem, objective: Objective, ranked: Sequence[int], best: Place, *, enough: bool
    ) -> tuple[LocalCurves, bool]:
        """The frames' curves around the best place, and whether the resampled minima lie inside of them.

        Frames join, most informative first, until half the interval is narrower than `ScaleConfig.half_width`.

        Args:
            enough: the first frames will do, since the answer is none anyway.
        """
        progress, seed = problem.progress, problem.config.seed
        pixel = problem.bracket.pixel(best.theta)
        start = Window(best.theta, first_half_width(best.slopes, best.curvature, pixel), pixel)
        curves, count = LocalCurves(objective), self.first_frames
        while True:
            curves, closed = widened(curves, ranked[:count], start, seed, progress)
            if count >= len(problem.frames) or not closed or enough:
                break
            std_log, _ = resampled_interval(*curves.dense(), curves.minimum(), 0.0, seed)
            if QUANTILE_95 * std_log <= problem.config.half_width:
                break
            count *= 2
        return settled(curves, start.half_width, progress) if closed else curves, closed
