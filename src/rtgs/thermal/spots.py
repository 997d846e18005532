"""The hot and cold spots of a capture: found in its training photographs, and joined where they lie together on the model's surface.

The photographs decide, because a model may erase what is smaller than its Gaussians. The model says where on the surface they look, and
what it shows there itself. What a single photograph has, a reflection or a person, is no spot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rtgs.base.progress import Progress
from rtgs.config import SpotsConfig
from rtgs.models import ThermalModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.records.spots import Spot, SpotList
from rtgs.renderer import render
from rtgs.thermal.spot_regions import Region, regions_by_excess, regions_by_threshold

SOLID = 0.5  # opacity from which a pixel shows a surface
NEAR_PX = 2.0  # rays of two views to one place pass each other within so many pixels
DEPTH_SHARE = 0.04  # of the distance: error of the model's depth, on surfaces without texture
_STEEPEST = 0.2  # cosine: a region that is seen more slantingly gets the area of this slant
_BEST = 3
_PLANE_PX = 8  # pixels around a region that its plane is fitted to, as well: depth on plain surfaces is noisy

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sighting:
    """A spot as one view shows it, in the scene's world.

    Attributes:
        sign: 1 hot, −1 cold.
        eye: where the camera is. centre: of the spot, by the model's depth. normal: of the model's surface there.
        area: across the ray.
        pixel: width of a pixel at its distance. pixels: how many it has.
        extreme, mean, surroundings, modelled: temperatures, as in `Spot`.
    """

    frame: str
    sign: int
    eye: Floats
    centre: Floats
    normal: Floats
    area: float
    pixel: float
    pixels: int
    extreme: float
    mean: float
    surroundings: float
    modelled: float

    @property
    def radius(self) -> float:
        """Of a disk of that area, and at least half of `NEAR_PX`."""
        return max(float(np.sqrt(self.area / np.pi)), 0.5 * NEAR_PX * self.pixel)

    @property
    def depth_error(self) -> float:
        """How far the place may be off along the ray."""
        return DEPTH_SHARE * float(np.linalg.norm(self.centre - self.eye))


def find_spots(
    scene: Scene,
    model: ThermalModel,
    config: SpotsConfig | None = None,
    *,
    metres_per_sfm: float | None = None,
    progress: Progress | None = None,
) -> SpotList:
    """List the spots of a capture.

    A spot is found in the training photographs, without drift and pattern of the sensor, and there compared with the model's renders.
    Sightings of several views at one place of the surface are one spot. It lies where their rays meet. Places that few views show are
    left out.

    Args:
        config: what counts as a spot; None: the defaults.
        metres_per_sfm: what lengths rest on; None: the scale that the model was fitted at.
        progress: called with (views done, views in all, the frame's name).

    Raises:
        RtgsError: no training frame.
    """
    config = config or SpotsConfig()
    thresholds, criterion = _thresholds(scene, model, config)
    sightings = []
    for done, frame in enumerate(scene.train_frames):
        sightings += list(_in_view(scene, model, frame, config, thresholds))
        if progress is not None:
            progress(done + 1, len(scene.train_frames), frame.name)
    groups = [g for sign in (1, -1) for g in joined([s for s in sightings if s.sign == sign])]
    sfm_per_metre = model.sfm_per_metre if metres_per_sfm is None else 1 / metres_per_sfm
    spots = [_spot(g, scene, sfm_per_metre) for g in groups if len({s.frame for s in g}) >= config.fewest_views]
    spots.sort(key=lambda s: -abs(s.excess))
    return SpotList(tuple(spots[: config.most]), model.unit, criterion, config.reference)


def joined(sightings: Sequence[Sighting]) -> list[list[Sighting]]:
    """Sightings in groups that are of one place.

    Two of different views belong together where their rays pass each other within the larger radius, where the model's depths agree to
    their errors, and where no other of these views lies nearer. Two of one view do where they lie within the larger radius.
    """
    if not sightings:
        return []
    centres, eyes = np.stack([s.centre for s in sightings]), np.stack([s.eye for s in sightings])
    radius, depth_error = (np.array([getattr(s, name) for s in sightings]) for name in ("radius", "depth_error"))
    a, b = cKDTree(centres).query_pairs(float((radius + depth_error).max()), output_type="ndarray").T
    apart = np.linalg.norm(centres[a] - centres[b], axis=1)
    rays = (centres - eyes) / np.linalg.norm(centres - eyes, axis=1, keepdims=True)
    across = np.cross(rays[a], rays[b])
    sine = np.linalg.norm(across, axis=1)
    passing = np.abs(((eyes[b] - eyes[a]) * across).sum(1)) / np.maximum(sine, 1e-12)
    larger = np.maximum(radius[a], radius[b])
    one_view = sine < 1e-6
    one_view |= np.array([sightings[i].frame == sightings[j].frame for i, j in zip(a, b, strict=True)], dtype=bool)
    near = (apart <= larger) | (~one_view & (passing <= larger) & (apart <= np.maximum(depth_error[a], depth_error[b])))
    a, b, apart = a[near], b[near], apart[near]
    nearest: dict[tuple[int, str], float] = {}
    for i, j, distance in zip((*a, *b), (*b, *a), (*apart, *apart), strict=True):
        key = (int(i), sightings[j].frame)
        nearest[key] = min(distance, nearest.get(key, np.inf))
    mutual = [
        d <= nearest[int(i), sightings[j].frame] and d <= nearest[int(j), sightings[i].frame]
        for i, j, d in zip(a, b, apart, strict=True)
    ]
    a, b = a[mutual], b[mutual]
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(sightings), len(sightings)))
    count, labels = connected_components(graph, directed=False)
    return [[sightings[int(i)] for i in np.flatnonzero(labels == k)] for k in range(count)]


def meeting_point(group: Sequence[Sighting]) -> Floats:
    """`[3]`: where the rays to a spot meet, by least squares. A ray is known to a pixel across and to the model's depth along."""
    information, pull = np.zeros((3, 3)), np.zeros(3)
    for s in group:
        ray = (s.centre - s.eye) / np.linalg.norm(s.centre - s.eye)
        along = np.outer(ray, ray)
        weights = (np.eye(3) - along) / s.pixel**2 + along / s.depth_error**2
        information, pull = information + weights, pull + weights @ s.centre
    return np.asarray(np.linalg.solve(information, pull), dtype=np.float64)


def area_on_surface(group: Sequence[Sighting]) -> float:
    """Median over the views, on the plane that they agree about best: a single view's depth is too noisy for the slant."""
    normals = np.stack([s.normal for s in group])
    plane = np.linalg.eigh(normals.T @ normals)[1][:, 2]
    rays = np.stack([(s.centre - s.eye) / np.linalg.norm(s.centre - s.eye) for s in group])
    slants = np.maximum(np.abs(rays @ plane), _STEEPEST)
    return float(np.median(np.array([s.area for s in group]) / slants))


def _thresholds(scene: Scene, model: ThermalModel, config: SpotsConfig) -> tuple[dict[int, float] | None, str]:
    """Sign → temperature beyond which everything counts; None where the excess decides. And the criterion in words."""
    above, below, unit = config.above, config.below, model.unit
    if config.percentile is not None:
        mask = scene.capture.thermal_mask
        values = np.concatenate([f.thermal[mask][::16] for f in scene.train_frames])
        low, high = (float(v) for v in np.percentile(values, [100 - config.percentile, config.percentile]))
        above, below = high if above is None else above, low if below is None else below
    if above is None and below is None:
        return None, f"{config.excess:g} {unit} or more off the surface around"
    found = {sign: value for sign, value in ((1, above), (-1, below)) if value is not None}
    words = [f"{'above' if sign > 0 else 'below'} {value:.4g} {unit}" for sign, value in found.items()]
    return found, " or ".join(words)


def _in_view(
    scene: Scene, model: ThermalModel, frame: Frame, config: SpotsConfig, thresholds: dict[int, float] | None
) -> Iterator[Sighting]:
    camera, pose = scene.rig.thermal, scene.thermal_from_world(frame.name, model.sfm_per_metre)
    shown, valid = model.render(camera, pose), scene.capture.thermal_mask
    photograph = frame.thermal - (model.render(camera, pose, photographed_in=frame.name) - shown)  # without drift and pattern
    photograph = np.where(valid, photograph, shown).astype(np.float64)
    with torch.no_grad():
        view = render(model.gaussians, camera, pose, settings=replace(model.settings, with_depth=True))
    assert view.depth is not None
    alpha = view.alpha.numpy().astype(np.float64)
    depth = np.where((alpha >= SOLID) & valid, view.depth.numpy() / np.maximum(alpha, SOLID), np.nan)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(x - camera.cx) / camera.fl_x, (y - camera.cy) / camera.fl_y, np.ones_like(x)], axis=-1) * depth[..., None]
    world_from_thermal = pose.inverse()
    for sign in (1, -1):
        image = sign * photograph
        if thresholds is None:
            regions: Sequence[Region] = regions_by_excess(image, depth, config.excess)
        else:
            regions = list(regions_by_threshold(image, depth, sign * thresholds[sign])) if sign in thresholds else []
        for region in regions:
            measured = _measured(region, frame.name, sign, image, sign * shown.astype(np.float64), local, camera.fl_x)
            yield replace(
                measured,
                eye=world_from_thermal.translation,
                centre=world_from_thermal.apply(measured.centre),
                normal=world_from_thermal.rotation @ measured.normal,
            )


def _measured(region: Region, frame: str, sign: int, image: Floats, shown: Floats, local: Floats, focal: float) -> Sighting:
    """A region of one view, in camera axes.

    Args:
        image, shown: `[H, W]`, temperatures times the sign, of the photograph and of the render.
        local: `[H, W, 3]`, the surface that each pixel shows.
    """
    own = np.zeros(image.shape, bool)
    own[region.rows, region.columns] = True
    points = local[own]
    around = local[binary_dilation(own, iterations=_PLANE_PX)]
    around = around[np.isfinite(around).all(axis=1)]
    centred = around - np.median(around, axis=0)
    normal = np.linalg.svd(centred, full_matrices=False)[2][2]
    pixel = points[:, 2] / focal
    # A pixel's solid angle shrinks towards the image's border by the cube of the cosine to the axis.
    areas = pixel**2 * points[:, 2] / np.linalg.norm(points, axis=1)
    weights = np.maximum(image[own] - region.surroundings, 1e-6) * areas
    return Sighting(
        frame,
        sign,
        np.zeros(3),
        np.asarray((weights[:, None] * points).sum(0) / weights.sum()),
        normal,
        float(areas.mean()) * region.area_px,
        float(np.median(pixel)),
        len(points),
        sign * float(image[own].max()),
        sign * float(image[own].mean()),
        sign * region.surroundings,
        sign * float(shown[binary_dilation(own)].max()),
    )


def _spot(group: Sequence[Sighting], scene: Scene, sfm_per_metre: float) -> Spot:
    """One spot from its sightings: medians, and standard errors from their scatter."""

    def median(name: str) -> float:
        return float(np.median([getattr(s, name) for s in group]))

    def error(name: str) -> float | None:
        values = np.array([getattr(s, name) for s in group])
        return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None

    best = sorted(group, key=lambda s: -s.pixels)
    x, y, z = (float(v) / sfm_per_metre for v in scene.given_from_world.apply(meeting_point(group)))
    return Spot(
        kind="hot" if group[0].sign > 0 else "cold",
        position_m=(x, y, z),
        area_m2=area_on_surface(group) / float(scene.world_per_metre(sfm_per_metre)) ** 2,
        extreme=median("extreme"),
        mean=median("mean"),
        surroundings=median("surroundings"),
        std=error("extreme"),
        views=len({s.frame for s in group}),
        best_frames=tuple(dict.fromkeys(s.frame for s in best))[:_BEST],
        modelled=median("modelled"),
        modelled_std=error("modelled"),
    )
