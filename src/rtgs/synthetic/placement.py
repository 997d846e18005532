"""Where features are placed: on surfaces that many training views see whole, flat there, away from edges and from each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.config import SynthConfig
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import Split
from rtgs.synthetic.draws import rng as draws_of
from rtgs.synthetic.features import FeatureKind, ThermalFeature, Vector, area_m2
from rtgs.synthetic.raycast import CompiledModel, Hits

Floats = NDArray[np.float64]
SPOT_SIZES_PX = (8.0, 5.0, 3.0, 2.0)  # large ones first: they fit into fewer places
LINE_WIDTHS_PX = (3.0, 2.0)
LINE_LENGTHS_PX = (30.0, 20.0, 12.0)  # the longest that fits
RECTANGLES_PX = ((48.0, 32.0), (36.0, 24.0), (24.0, 16.0))  # the largest that fits
EXCESS_C = 15.0
FEWEST_VIEWS = 8  # training views that see a feature whole
_FACING = 0.35  # cosine: a view sees a surface that is turned away by less than 70°
_FLAT = 0.2  # how far a surface may leave its tangent plane, as a share of the distance from the centre
_BORDER_PX = 2.0
_CANDIDATES = 3000
_LIFT_M = 1e-3


@dataclass(frozen=True)
class Wanted:
    """A feature to be placed: sizes in thermal pixels, along and across."""

    kind: FeatureKind
    length_px: float
    width_px: float
    sign: int

    @property
    def margin_px(self) -> float:
        """How much of the surface around it has to be there and seen as well."""
        return {"spot": max(0.6 * self.width_px, 2.0), "line": 3.0, "rectangle": 6.0}[self.kind]

    def outline(self) -> Floats:
        """`[P, 2]`: points along and across, in pixels, that stand for the feature with its margin. The first is the centre."""
        if self.kind == "spot":
            angle, radius = np.arange(8) * math.pi / 4, self.width_px / 2 + self.margin_px
            ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            a, b = self.length_px / 2 + self.margin_px, self.width_px / 2 + self.margin_px
            u, v = np.meshgrid(np.linspace(-a, a, 7), np.linspace(-b, b, 5))
            ring = np.stack([u.ravel(), v.ravel()], axis=1)
        return np.concatenate([[[0.0, 0.0]], ring])


def wanted_features(names: Sequence[str], spots_each: int) -> list[list[Wanted]]:
    """What is placed for `SynthConfig.features` and `spots_each`, in order. Of a feature's alternatives, the first that fits is taken."""
    found: list[list[Wanted]] = []
    if "rectangle" in names:
        found.append([Wanted("rectangle", a, b, 1) for a, b in RECTANGLES_PX])
    if "lines" in names:
        found += [[Wanted("line", a, b, sign) for a in LINE_LENGTHS_PX] for b in LINE_WIDTHS_PX for sign in (1, -1)]
    if "spots" in names:
        found += [[Wanted("spot", 0.0, s, sign)] for s in SPOT_SIZES_PX for _ in range(spots_each) for sign in (1, -1)]
    return found


@dataclass(frozen=True, eq=False)
class Placement:
    """The scene and its thermal cameras, among which places are looked for."""

    model: CompiledModel
    camera: Camera
    world_from_thermal: dict[str, SE3]

    def candidates(self, rng: np.random.Generator) -> Hits:
        """Surface points that random pixels of the training views see, and that enough views see."""
        training = [name for name in self.world_from_thermal if name not in self._held_out]
        pixels = rng.uniform(0, 1, (_CANDIDATES, 2)) * [self.camera.width, self.camera.height]
        poses = [self.world_from_thermal[training[i]] for i in rng.integers(len(training), size=_CANDIDATES)]
        rays = (pixels - [self.camera.cx, self.camera.cy]) / [self.camera.fl_x, self.camera.fl_y]
        rays = np.concatenate([rays, np.ones((_CANDIDATES, 1))], axis=1)
        directions = np.stack([pose.rotation @ ray for pose, ray in zip(poses, rays, strict=True)])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.stack([pose.translation for pose in poses])
        surface = self.model.hits(origins, directions).surface
        seen = {name: self.sees(pose, surface.world, surface.normal) for name, pose in self.world_from_thermal.items()}
        enough = [self.enough([name for name in seen if seen[name][i]]) for i in range(len(surface.world))]
        hit = np.zeros(_CANDIDATES, bool)
        hit[self.model.hits(origins, directions).ray[enough]] = True
        return self.model.hits(origins[hit], directions[hit])

    def sees(self, pose: SE3, points: Floats, normals: Floats) -> NDArray[np.bool_]:
        """`[P]`: which points of surfaces the thermal camera sees from a pose, not too slantingly."""
        to, local = pose.translation - points, pose.inverse().apply(points)
        distance = np.linalg.norm(to, axis=1)
        to /= distance[:, None]
        seen = ((to * normals).sum(1) >= _FACING) & (local[:, 2] > 0)
        pixels = self.camera.project(np.where(seen[:, None], local, [0.0, 0.0, 1.0]))
        seen &= (pixels >= _BORDER_PX).all(1) & (pixels <= np.array([self.camera.width, self.camera.height]) - _BORDER_PX).all(1)
        left = np.flatnonzero(seen)
        if len(left):
            start = points[left] + _LIFT_M * normals[left]
            seen[left] = ~self.model.occluded(start, to[left], distance[left] - 2 * _LIFT_M)
        return seen

    def views_of(self, points: Floats, normal: Floats) -> tuple[str, ...]:
        """Frames that see all of the points `[P, 3]` of a surface."""
        normals = np.broadcast_to(normal, points.shape)
        return tuple(name for name, pose in self.world_from_thermal.items() if self.sees(pose, points, normals).all())

    def enough(self, views: Sequence[str]) -> bool:
        """Whether so many training views, and at least one that is held out, see a place."""
        held_out = sum(name in self._held_out for name in views)
        return held_out >= 1 and len(views) - held_out >= FEWEST_VIEWS

    def pixel_m(self, point: Floats, views: Sequence[str]) -> float:
        """Metres that a thermal pixel is wide at the views' median distance."""
        poses = [self.world_from_thermal[name] for name in views]
        return float(np.median([p.inverse().apply(point)[2] for p in poses])) / self.camera.fl_x

    def surface_points(self, centre: Floats, axes: Floats, offsets_m: Floats, part: int) -> Floats | None:
        """`[P, 3]`: the points of a part at offsets in the tangent plane; None where it is not flat or ends.

        Args:
            axes: `[3, 3]`, rows along, across and normal.
        """
        height = float(np.abs(offsets_m).max())
        origins = centre + offsets_m @ axes[:2] + height * axes[2]
        hits = self.model.hits(origins, np.broadcast_to(-axes[2], origins.shape))
        if len(hits.ray) < len(origins) or (hits.surface.part != part).any():
            return None
        away = np.abs((hits.surface.world - centre) @ axes[2])
        flat = away <= _FLAT * np.linalg.norm(offsets_m, axis=1) + 1e-6
        return hits.surface.world if flat.all() else None

    @cached_property
    def _held_out(self) -> frozenset[str]:
        return Split().held_out_names(list(self.world_from_thermal))


def place_features(
    config: SynthConfig, model: CompiledModel, camera: Camera, world_from_thermal: dict[str, SE3]
) -> tuple[ThermalFeature, ...]:
    """The features that a configuration asks for, where its seed puts them.

    Every feature is seen whole by at least 8 training views and one that is held out. Its size follows from the views' median distance.

    Args:
        world_from_thermal: true poses by frame name, metres.

    Raises:
        RtgsError: the scene has no place for a kind of feature: too few frames see one.
    """
    rng, placement = draws_of(config, "features"), Placement(model, camera, world_from_thermal)
    found: list[ThermalFeature] = []
    if not config.features or len(world_from_thermal) < 2:
        hits = None
    else:
        hits = placement.candidates(rng)
    for alternatives in wanted_features(config.features, config.spots_each):
        for wanted in alternatives:
            turn = rng.uniform(0, 2 * math.pi)
            feature = None if hits is None else next(_fitting(placement, hits, wanted, turn, found), None)
            if feature is not None:
                found.append(feature)
                break
    for name in config.features:
        if not any(feature.kind == name.rstrip("s") for feature in found):
            raise RtgsError(
                f"features: no place for {name} that {FEWEST_VIEWS} training views and a held-out view see whole; "
                "ask for more frames or a larger size."
            )
    return tuple(found)


def _fitting(
    placement: Placement, hits: Hits, wanted: Wanted, turn: float, others: Sequence[ThermalFeature]
) -> Iterator[ThermalFeature]:
    """The feature at each place that suits it, in the order of the candidates."""
    surface, outline = hits.surface, wanted.outline()
    for i in range(len(hits.ray)):
        centre, normal, part = surface.world[i], surface.normal[i], int(surface.part[i])
        nearest = min((np.linalg.norm(centre - np.array(o.position_m)) - _reach(o) for o in others), default=math.inf)
        if nearest <= 0:
            continue
        views = placement.views_of(centre[None], normal)
        if not placement.enough(views):
            continue
        pixel = placement.pixel_m(centre, views)
        if nearest <= _apart(wanted.length_px * pixel, wanted.width_px * pixel):
            continue
        axes = _axes(normal, turn if wanted.kind != "rectangle" else 0.0)
        points = placement.surface_points(centre, axes, pixel * outline, part)
        if points is None:
            continue
        views = placement.views_of(points, normal)
        if placement.enough(views):
            yield _feature(placement, hits, i, wanted, axes, pixel, views)


def _feature(
    placement: Placement, hits: Hits, at: int, wanted: Wanted, axes: Floats, pixel_m: float, views: tuple[str, ...]
) -> ThermalFeature:
    centre = hits.surface.world[at]
    around = float(placement.model.temperature_c(hits)[at])
    excess, width, length = wanted.sign * EXCESS_C, wanted.width_px * pixel_m, (wanted.length_px or wanted.width_px) * pixel_m
    return ThermalFeature(
        kind=wanted.kind,
        position_m=_vector(centre),
        normal=_vector(axes[2]),
        along=_vector(axes[0]),
        part=int(hits.surface.part[at]),
        size_px=wanted.width_px,
        fwhm_m=width,
        length_m=length,
        area_m2=area_m2(wanted.kind, width, length),
        excess_c=excess,
        sign=wanted.sign,
        surroundings_c=around,
        peak_c=around + excess,
        views=views,
    )


def _apart(length_m: float, width_m: float) -> float:
    """Half of a feature with the free space around it."""
    return 0.5 * math.hypot(length_m, width_m) + 1.5 * width_m


def _reach(feature: ThermalFeature) -> float:
    return _apart(feature.length_m, feature.fwhm_m)


def _axes(normal: Floats, turn: float) -> Floats:
    """`[3, 3]`, rows along, across and normal. Without a turn, along is horizontal."""
    level = np.cross([0.0, 0.0, 1.0] if abs(normal[2]) < 0.95 else [0.0, 1.0, 0.0], normal)
    level /= np.linalg.norm(level)
    along = math.cos(turn) * level + math.sin(turn) * np.cross(normal, level)
    return np.stack([along, np.cross(normal, along), normal])


def _vector(value: Floats) -> Vector:
    return (float(value[0]), float(value[1]), float(value[2]))
