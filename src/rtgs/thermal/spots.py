"""The hot and cold spots of a capture: found in its training photographs, and joined where they lie together on the model's surface.

The photographs decide, because a model may erase what is smaller than its Gaussians. The model says where on the surface they look, and
what it shows there itself. What a single photograph has, a reflection or a person, is no spot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtgs.base.progress import Progress
from rtgs.config import SpotsConfig
from rtgs.config.spots import parse_reference
from rtgs.models import ThermalModel
from rtgs.records.metres import LengthUnit
from rtgs.records.scene import Scene
from rtgs.records.spots import ReferenceTemperature, Spot, SpotList
from rtgs.thermal.spot_places import Floats, Sighting, facing_area, joined, meeting_point
from rtgs.thermal.spot_reference import ReferenceRegion
from rtgs.thermal.spot_regions import Region, regions_by_excess, regions_by_threshold
from rtgs.thermal.spot_views import SpotView

SHOWN_SHARE = 0.5  # of the views that see a place show what is there: fewer see a reflection, or something through a gap
STEADY_SHARE = 0.1  # of the excess: a surface has the same temperature from everywhere, reflections and edges of things have not
LOWERED_SHARE = 0.125  # of what a pixel's mean takes from a peak: standard error of adding it again, for lenses blur as well
MEDIAN_ERROR = 1.25  # standard error of a median in units of a mean's
_BEST = 3


def find_spots(
    scene: Scene,
    model: ThermalModel,
    config: SpotsConfig | None = None,
    *,
    unit_per_sfm: float | None = None,
    length_unit: LengthUnit = "m",
    progress: Progress | None = None,
) -> SpotList:
    """List the spots of a capture.

    A spot is found in the training photographs, without drift and pattern of the sensor, and there compared with the model's renders.
    Sightings of several views at one place of the surface are one spot. It lies where their rays meet. Places that few views show are
    left out.

    Args:
        config: what counts as a spot; None: the defaults.
        unit_per_sfm: what lengths are multiplied by; None: the scale that the model was fitted at, in metres.
        length_unit: what they are in then.
        progress: called with (views done, views in all, the frame's name).

    Raises:
        RtgsError: no training frame, or a reference that no photograph sees.
    """
    config = config or SpotsConfig()
    thresholds, criterion = _thresholds(scene, model, config)
    sfm_per_metre = model.sfm_per_metre if unit_per_sfm is None else 1 / unit_per_sfm
    wanted = None if config.reference is None else parse_reference(config.reference)
    measures = wanted is not None and wanted.temperature is None
    region = ReferenceRegion.of(scene, model, wanted, 1 / sfm_per_metre) if wanted is not None and measures else None
    sightings, surfaces = [], []
    for done, frame in enumerate(scene.train_frames):
        view = SpotView.of(scene, model, frame)
        surfaces.append(view.surface)
        if region is not None:
            region.look(view)
        for sign in (1, -1):
            sightings += list(view.sightings(sign, _regions(view, sign, config.excess, thresholds)))
        if progress is not None:
            progress(done + 1, len(scene.train_frames), frame.name)
    spots = []
    for group in (g for sign in (1, -1) for g in joined([s for s in sightings if s.sign == sign])):
        views = len({s.frame for s in group})
        if views < config.fewest_views:
            continue
        place = meeting_point(group)
        facing = facing_area(group, place)
        normal = facing / np.linalg.norm(facing)
        seen_by = max(sum(surface.sees(place, normal) for surface in surfaces), views)
        if thresholds is not None or (views >= SHOWN_SHARE * seen_by and _steady(group)):
            spots.append(_spot(group, place, facing, seen_by, scene, sfm_per_metre))
    spots.sort(key=lambda s: -abs(s.excess))
    reference = None if region is None else region.measured()
    if wanted is not None and wanted.temperature is not None:
        reference = ReferenceTemperature(wanted.name, wanted.temperature)
    return SpotList(tuple(spots[: config.most]), model.unit, criterion, reference, length_unit)


def _steady(group: Sequence[Sighting]) -> bool:
    """Whether temperature or excess is the same in most views: one varies with the drift, the other where the surroundings do.

    The scatter is 1.48 times the median absolute deviation, which one view's reflection does not change.
    """
    extremes = np.array([s.extreme for s in group])
    excess = extremes - [s.surroundings for s in group]
    scatter = min(float(np.median(np.abs(values - np.median(values)))) for values in (extremes, excess))
    return 1.4826 * scatter <= STEADY_SHARE * abs(float(np.median(excess)))


def _regions(view: SpotView, sign: int, excess: float, thresholds: dict[int, float] | None) -> Sequence[Region]:
    image = sign * view.photograph
    if thresholds is None:
        return regions_by_excess(image, view.depth, excess)
    return list(regions_by_threshold(image, view.depth, sign * thresholds[sign])) if sign in thresholds else []


def _thresholds(scene: Scene, model: ThermalModel, config: SpotsConfig) -> tuple[dict[int, float] | None, str]:
    """Sign → temperature beyond which everything counts; None where the excess decides. And the criterion in words."""
    above, below, unit = config.above, config.below, model.unit
    if config.percentile is not None:
        mask = scene.capture.thermal_mask
        values = np.concatenate([f.thermal[mask][::16] for f in scene.train_frames])
        low, high = (float(v) for v in np.percentile(values, [100 - config.percentile, config.percentile]))
        above, below = high if above is None else above, low if below is None else below
    if above is None and below is None:
        return None, f"{config.excess:g} {unit} or more warmer or colder than the surface around"
    found = {sign: value for sign, value in ((1, above), (-1, below)) if value is not None}
    words = [f"{'above' if sign > 0 else 'below'} {value:.4g} {unit}" for sign, value in found.items()]
    return found, " or ".join(words)


def _spot(group: Sequence[Sighting], place: Floats, facing: Floats, seen_by: int, scene: Scene, sfm_per_metre: float) -> Spot:
    """One spot from its sightings: medians. Standard errors are those of the medians, from the scatter, and of resolving the peak."""

    def median(name: str) -> float:
        return float(np.median([getattr(s, name) for s in group]))

    def error(name: str) -> float | None:
        values = np.array([getattr(s, name) for s in group])
        scatter = MEDIAN_ERROR * float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else None
        return None if scatter is None else float(np.hypot(scatter, LOWERED_SHARE * median("lowered")))

    best = sorted(group, key=lambda s: -s.pixels)
    x, y, z = (float(v) / sfm_per_metre for v in scene.given_from_world.apply(place))
    return Spot(
        kind="hot" if group[0].sign > 0 else "cold",
        position_m=(x, y, z),
        area_m2=float(np.linalg.norm(facing)) / float(scene.world_per_metre(sfm_per_metre)) ** 2,
        extreme=median("extreme"),
        mean=median("mean"),
        surroundings=median("surroundings"),
        std=error("extreme"),
        views=len({s.frame for s in group}),
        seen_by=seen_by,
        best_frames=tuple(dict.fromkeys(s.frame for s in best))[:_BEST],
        modelled=median("modelled"),
        modelled_std=error("modelled"),
    )
