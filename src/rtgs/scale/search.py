"""The global search: every scale the images can tell apart, then down from the best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.images.filters import SOBEL
from rtgs.images.patterns import sensor_pattern
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.scale.descend import Place, descend
from rtgs.scale.noise import mean_gradients, model_error
from rtgs.scale.objective import Objective, thermal_range
from rtgs.scale.records import Counter, History

_COARSE_SIDE = 64  # pixels of the shorter side in the scan: the picture is halved while it keeps this many
_SCAN_FRAMES = 10
_REFINE_FRAMES = 16
EPSILON_FRAMES = 6
_RATIO = 0.25  # of neighbouring scales in the scan, where the flow is small
_MOST_MINIMA = 3
_AROUND = (-4.0, -2.0, 0.0, 2.0, 4.0)  # coarse pixels of flow from the answer
UNLIKELY = 3.0  # standard errors
_BLURS = (0.0, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.3, 16.0)  # pixels


@dataclass(frozen=True)
class Comparison:
    """How the search compares pictures. The defaults are the method; anything else is for an ablation.

    Attributes:
        edge: ε, in mean gradients: from which on one is an edge.
        per_edge, across: as in `NgfPyramid.of`.
        without_pattern: the sensor's pattern is taken out of the thermal images.
        covered: count only pixels that the model covers, as the thermal camera would see it from where the RGB camera is.
    """

    edge: float = 3.0
    per_edge: bool = True
    across: tuple[float, float] = SOBEL
    without_pattern: bool = True
    covered: bool = False


COMPARISON = Comparison()


@dataclass(frozen=True, eq=False)
class Pictures:
    """Thermal images in [0, 1] with the ε that suits them, from which objectives of any size are made.

    Attributes:
        frames: training frames. thermal: frame name → `[h, w]`.
        epsilon, render_epsilon: one a level; fixed numbers make every level alike.
        masks: frame name → pixels that count; None: all valid ones.
        blur_px: standard deviation of the Gaussian that renders are blurred by, to be as soft as the thermal images.
    """

    scene: Scene
    model: RgbModel
    frames: tuple[Frame, ...]
    thermal: dict[str, NDArray[np.float32]]
    level_weights: tuple[float, ...]
    epsilon: tuple[float, ...]
    render_epsilon: tuple[float, ...]
    comparison: Comparison
    masks: dict[str, NDArray[np.bool_]] | None = None
    blur_px: float = 0.0
    renders: int = 0
    objectives: dict[int, Objective] = field(init=False, default_factory=dict)

    @staticmethod
    def of(
        scene: Scene,
        model: RgbModel,
        frames: Sequence[Frame],
        level_weights: tuple[float, ...],
        epsilon: float | None,
        counter: Counter,
        comparison: Comparison = COMPARISON,
    ) -> Pictures:
        """Remove the sensor's pattern, and measure ε where none is given.

        It is three mean gradients: of the thermal images for them, of the model's errors against RGB images for the renders.
        """
        valid = scene.capture.thermal_mask
        images = [f.thermal for f in frames]
        if comparison.without_pattern:
            pattern = sensor_pattern(np.stack(images), valid)
            images = [image - pattern for image in images]
        lo, hi = thermal_range([image[valid] for image in images], 0.0)
        scaled = [np.where(valid, (image - lo) / (hi - lo), 0.0).astype(np.float32) for image in images]
        thermal = {f.name: image for f, image in zip(frames, scaled, strict=True)}
        levels = max(len(level_weights), halvings(scene) + 2)  # two at the coarsest size
        masks = {f.name: _covered(scene, model, f) for f in frames} if comparison.covered else None
        if epsilon is not None:
            given = (epsilon,) * levels
            return Pictures(scene, model, tuple(frames), thermal, level_weights, given, given, comparison, masks)
        own = mean_gradients([torch.from_numpy(image) for image in thermal.values()], valid, levels, comparison.across)
        drawn = frames[:: -(-len(frames) // EPSILON_FRAMES)]
        errors = []
        for frame in drawn:
            errors.append(model_error(scene, model, frame))
            counter("noise")
        everywhere = np.ones(errors[0].shape, dtype=bool)
        other = mean_gradients(errors, everywhere, levels, comparison.across)
        own, other = (tuple(comparison.edge * e for e in measured) for measured in (own, other))
        return Pictures(scene, model, tuple(frames), thermal, level_weights, own, other, comparison, masks, renders=len(drawn))

    def objective(self, halved: int = 0) -> Objective:
        """Eq. 7, per edge, on pictures halved so many times: the level weights at full size, two equal levels below. Made once."""
        if halved not in self.objectives:
            self.objectives[halved] = self._objective(halved)
        return self.objectives[halved]

    def renders_in_all(self) -> int:
        return self.renders + sum(objective.renders for objective in self.objectives.values())

    def _objective(self, halved: int) -> Objective:
        weights = self.level_weights if halved == 0 else (1.0, 1.0)
        levels = slice(halved, halved + len(weights))
        return Objective(
            self.scene,
            self.model.gaussians,
            self.model.background,
            self.model.settings,
            self.frames,
            level_weights=weights,
            epsilon=self.epsilon[levels],
            render_epsilon=self.render_epsilon[levels],
            per_edge=self.comparison.per_edge,
            across=self.comparison.across,
            blur_px=self.blur_px,
            reduction=2**halved,
            thermal=self.thermal,
            masks=self.masks,
        )


def _covered(scene: Scene, model: RgbModel, frame: Frame) -> NDArray[np.bool_]:
    """`[h, w]`: half opaque or more. As nearly no baseline shows it: a mask that followed s would reward leaving the scene."""
    with torch.no_grad():
        view = render(model.gaussians, scene.rig.thermal, scene.thermal_from_world(frame.name, 1e-9), settings=model.settings)
    return np.asarray(view.alpha.numpy() >= 0.5)


def halvings(scene: Scene) -> int:
    """How often the thermal picture can be halved for the scan."""
    side = min(scene.rig.thermal.width, scene.rig.thermal.height)
    return max(0, int(math.log2(side / _COARSE_SIDE))) if side >= _COARSE_SIDE else 0


def scan_thetas(limits: tuple[float, float], coarse_pixel: int) -> NDArray[np.float64]:
    """ln s over the bracket: neighbours are one coarse pixel of flow apart, or a ratio of 1.25 where the flow is small.

    Args:
        limits: `bracket`'s: half a pixel of flow at the lower end.
    """
    flows, most = [0.5], 0.5 * limits[1] / limits[0]
    while flows[-1] < most:
        flows.append(min(most, flows[-1] + min(float(coarse_pixel), _RATIO * flows[-1])))
    return np.log(np.array(flows) * 2 * limits[0])


def curves_of(
    objective: Objective, indices: Sequence[int], thetas: NDArray[np.float64], counter: Counter, text: str = "scan"
) -> NDArray[np.float64]:
    """Losses `[F, S]` of some frames."""
    curves = np.empty((len(indices), len(thetas)))
    for j, theta in enumerate(thetas):
        for i, index in enumerate(indices):
            curves[i, j] = objective.loss(index, float(theta))
            counter(f"{text}, s = {math.exp(theta):.4g}")
    return curves


def local_minima(curves: NDArray[np.float64]) -> list[int]:
    """Samples lower than their neighbours in the mean curve of `[F, S]`, ends included, best first: the best and its rivals.

    A rival is not significantly worse, or at least half as deep below the curve's median: samples hit narrow minima more or less well,
    in all frames alike.
    """
    mean = curves.mean(axis=0)
    framed = np.concatenate([[np.inf], mean, [np.inf]])
    found = sorted(np.flatnonzero((mean < framed[:-2]) & (mean <= framed[2:])).tolist(), key=lambda j: float(mean[j]))
    best, median = found[0], float(np.median(mean))
    rivals = [
        j
        for j in found[1:]
        if significance(curves[:, j] - curves[:, best]) < UNLIKELY or median - mean[j] > 0.5 * (median - mean[best])
    ]
    return [best, *rivals[:_MOST_MINIMA]]


def significance(differences: NDArray[np.float64]) -> float:
    """Mean over frames in standard errors; infinite for a single frame, or frames that differ all alike, unless by nothing."""
    mean = float(differences.mean())
    error = float(differences.std(ddof=1)) / math.sqrt(len(differences)) if len(differences) > 1 else 0.0
    if error > 0:
        return mean / error
    return math.copysign(math.inf, mean) if mean else 0.0


def softness(objective: Objective, indices: Sequence[int], theta: float, counter: Counter) -> float:
    """Standard deviation, in pixels, of the Gaussian under which a few renders agree best with the thermal images; 0 where none is clearly
    better than none. A calibration that is wrong looks soft as well."""
    chosen = indices[:: -(-len(indices) // EPSILON_FRAMES)]
    counter.plan(len(chosen))
    losses = []
    for i in chosen:
        losses.append(objective.loss_over_blur(i, theta, _BLURS))
        counter("blur")
    curves = np.array(losses)
    best = int(curves.mean(axis=0).argmin())
    return _BLURS[best] if best and significance(curves[:, 0] - curves[:, best]) >= UNLIKELY else 0.0


@dataclass(frozen=True, eq=False)
class Refined:
    """A minimum that the search ended in, or left behind.

    Attributes:
        start: ln s in the scan. place: as refined, at the finest size it came to.
        above: `[F]`, the frames' losses above those of the best, at that size.
    """

    start: float
    place: Place
    above: NDArray[np.float64]


class Search:
    """Scan at a coarse size, then Gauss–Newton from its minima through ever finer pictures.

    Args:
        ranked: indices of the pictures' frames, most informative first.
        pixel_at_one: pixels of flow (its 90th percentile) at s = 1.
    """

    def __init__(self, pictures: Pictures, ranked: Sequence[int], pixel_at_one: float, counter: Counter) -> None:
        self._pictures, self._counter, self._pixel_at_one = pictures, counter, pixel_at_one
        self.halved = halvings(pictures.scene)
        self.scanned, self._refined = sorted(ranked[:_SCAN_FRAMES]), sorted(ranked[:_REFINE_FRAMES])
        self.history = History([], [], [], [])

    def scan(self, limits: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """ln s `[S]` and losses `[F, S]` of the frames `scanned`."""
        thetas = scan_thetas(limits, 2**self.halved)
        self._counter.plan(len(thetas) * len(self.scanned) + self.refine_renders() + 6 * len(self._refined))
        return thetas, curves_of(self._pictures.objective(self.halved), self.scanned, thetas, self._counter)

    def refine_renders(self) -> int:
        """About how many pictures `refine` draws from one start."""
        return 5 * len(self._refined) * (self.halved + 1)

    def disagreeing(self, theta: float, indices: Sequence[int]) -> list[str]:
        """Frames that place their minimum elsewhere: two coarse pixels of flow or more away, and clearly.

        "Clearly" is measured by how deep the frames' curves are about the answer: a frame's own minimum lies below its loss at the
        answer by a quarter of the median frame's depth.
        """
        flow = self._pixel_at_one * math.exp(theta) / 2**self.halved  # of the answer, in coarse pixels
        steps = np.array([step for step in _AROUND if flow + step > 0])
        self._counter.plan(len(steps) * len(indices))
        curves = curves_of(
            self._pictures.objective(self.halved), indices, theta + np.log1p(steps / flow), self._counter, "frames"
        )
        here = curves[:, np.flatnonzero(steps == 0)[0]]
        depth = float(np.median(np.median(curves, axis=1) - here))
        far = (np.abs(steps[curves.argmin(axis=1)]) >= 2) & (here - curves.min(axis=1) > 0.25 * depth)
        names = [self._pictures.frames[i].name for i, apart in zip(indices, far, strict=True) if apart]
        return names if depth > 0 else []

    def refine(self, starts: Sequence[float]) -> list[Refined]:
        """Down from the scan's minima, coarse to fine; best first.

        Size by size, a place that runs into a better one is dropped, and one that is clearly worse goes no further.
        """
        behind: list[Refined] = []
        running = [(start, start) for start in starts]
        for halved in range(self.halved, -1, -1):
            places = [(start, self._descend(theta, halved)) for start, theta in running]
            places.sort(key=lambda p: p[1].loss)
            best = places[0][1]
            kept: list[Refined] = []
            for start, place in places:
                if all(abs(place.theta - other.place.theta) > self._pixel(other.place.theta, halved) for other in kept):
                    kept.append(Refined(start, place, place.losses - best.losses))
            behind += [r for r in kept[1:] if significance(r.above) >= UNLIKELY]
            kept = [kept[0], *(r for r in kept[1:] if significance(r.above) < UNLIKELY)]
            running = [(r.start, r.place.theta) for r in kept]
        return [*kept, *sorted(behind, key=lambda r: float(r.above.mean()))]

    def as_soft_as_the_lens(self, found: Refined) -> Refined:
        """Down again from a minimum, with the renders blurred as the thermal images are, as far as that makes them agree.

        A soft edge is as wide as the blur, and where in it a sharp edge lies best depends on what else is near. Beside an equally soft
        one it lies better: Table II has less than half the error at 4 px of blur.
        """
        blur_px = softness(self._pictures.objective(), self._refined, found.place.theta, self._counter)
        if blur_px == 0.0:
            return found
        self._pictures = replace(self._pictures, blur_px=blur_px, renders=self._pictures.renders_in_all())
        self._counter.plan(self.refine_renders())
        return replace(found, place=self._descend(found.place.theta, 0))

    @property
    def pictures(self) -> Pictures:
        """As they are compared now."""
        return self._pictures

    def _descend(self, theta: float, halved: int) -> Place:
        pixel = min(self._pixel(theta, halved), 0.5)
        tolerance = (0.05 if halved else 0.01) * pixel
        objective, counter, history = self._pictures.objective(halved), self._counter, self.history
        return descend(objective, self._refined, theta, pixel=pixel, tolerance=tolerance, counter=counter, history=history)

    def _pixel(self, theta: float, halved: int) -> float:
        """Change of θ that moves the picture of this size by a pixel."""
        return 2**halved / (self._pixel_at_one * math.exp(theta))
