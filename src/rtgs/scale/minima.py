"""From the scan's minima down to the full size, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.scale.bracket import Bracket
from rtgs.scale.descend import Descent, Place, descend
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import Minimum, Step
from rtgs.scale.resampling import RESAMPLES, UNLIKELY, significance
from rtgs.scale.thermal_targets import Pictures


@dataclass(frozen=True, eq=False)
class Refined:
    """A minimum that the search ended in, or left behind.

    Attributes:
        start: θ in the scan. place: as refined, at the finest size it came to.
        above: `[F]`, the frames' losses above those of the best, at that size.
    """

    start: float
    place: Place
    above: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Minima:
    """What came of several starts: the minima, best first; all steps in their order; and how many pictures were rendered."""

    minima: tuple[Refined, ...]
    steps: tuple[Step, ...]
    renders: int


@dataclass(frozen=True, eq=False)
class CoarseToFine:
    """Descents through ever finer pictures.

    Attributes:
        frames: indices of the pictures' frames whose mean loss is minimised.
        halved: how often pictures are halved at the coarsest size.
    """

    pictures: Pictures
    frames: tuple[int, ...]
    halved: int
    bracket: Bracket
    progress: RenderProgress

    @property
    def renders_each(self) -> int:
        """About how many pictures are rendered from one start, for the progress bar."""
        return 5 * len(self.frames) * (self.halved + 1)

    def from_starts(self, starts: Sequence[float]) -> Minima:
        """Down from each θ.

        Size by size, a place that has run into a better one is dropped, and one that is clearly worse goes no further.
        """
        behind: list[Refined] = []
        kept: list[Refined] = []
        steps: list[Step] = []
        renders = 0
        running = [(start, start) for start in starts]
        for halved in range(self.halved, -1, -1):
            descents = [(start, self.descend(theta, halved)) for start, theta in running]
            steps += [step for _, descent in descents for step in descent.steps]
            renders += sum(descent.renders for _, descent in descents)
            kept, worse = self._sorted_out([(start, descent.place) for start, descent in descents], halved)
            behind += worse
            running = [(r.start, r.place.theta) for r in kept]
        minima = (*kept, *sorted(behind, key=lambda r: float(r.above.mean())))
        return Minima(minima, tuple(steps), renders)

    def descend(self, theta: float, halved: int) -> Descent:
        """Down from θ at one size."""
        pixel = min(self._pixel(theta, halved), 0.5)
        tolerance = (0.05 if halved else 0.01) * pixel
        objective = self.pictures.objective(halved)
        return descend(objective, self.frames, theta, pixel=pixel, tolerance=tolerance, progress=self.progress)

    def _sorted_out(self, places: Sequence[tuple[float, Place]], halved: int) -> tuple[list[Refined], list[Refined]]:
        """Starts and places, into those to go on with, best first, and those clearly worse. Two within a pixel are one."""
        places = sorted(places, key=lambda p: p[1].loss)
        best = places[0][1]
        apart: list[Refined] = []
        for start, place in places:
            if all(abs(place.theta - other.place.theta) > self._pixel(other.place.theta, halved) for other in apart):
                apart.append(Refined(start, place, place.losses - best.losses))
        worse = [r for r in apart[1:] if significance(r.above) >= UNLIKELY]
        return [apart[0], *(r for r in apart[1:] if significance(r.above) < UNLIKELY)], worse

    def _pixel(self, theta: float, halved: int) -> float:
        """Change of θ that moves the picture of this size by a pixel."""
        return 2**halved / self.bracket.flow_px(theta)


def other_minima(minima: Sequence[Refined], seed: int) -> tuple[Minimum, ...]:
    """The minima that are not the best, as they are reported: in how many resamples of the frames each is better than the best."""
    rng, found = np.random.default_rng(seed), list[Minimum]()
    for other in minima[1:]:
        picks = rng.integers(len(other.above), size=(RESAMPLES, len(other.above)))
        chance = float((other.above[picks].mean(axis=1) < 0).mean())
        found.append(Minimum(math.exp(other.place.theta), float(other.above.mean()), chance))
    return tuple(found)
