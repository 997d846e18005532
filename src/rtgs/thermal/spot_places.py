"""Where spots are: sightings of several views joined to places, where their rays meet, and the area on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

NEAR_PX = 2.0  # rays of two views to one place pass each other within so many pixels
DEPTH_SHARE = 0.04  # of the distance: error of the model's depth, on surfaces without texture
CENTRE_PX = 0.5  # how well a photograph shows the centre of a spot
AREA_ERROR = 0.1  # share: how well a view shows a spot's area across the ray
_ROUNDS = 10
NORMAL_ERROR = 0.5  # radians: how well the model shows the normal of a surface without texture

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sighting:
    """A spot as one view shows it, in the scene's world.

    Attributes:
        sign: 1 hot, −1 cold.
        eye: where the camera is. centre: of the spot, by the model's depth. normal: of the model's surface there, of unit length.
        area: across the ray.
        pixel: width of a pixel at its distance. pixels: how many it has.
        extreme, mean, surroundings, modelled: temperatures, as in `Spot`.
        lowered: by how much less than `extreme` a pixel shows, since it has the mean over its area.
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
    lowered: float

    @property
    def radius(self) -> float:
        """Of a disk of that area, and at least half of `NEAR_PX`."""
        return max(float(np.sqrt(self.area / np.pi)), 0.5 * NEAR_PX * self.pixel)

    @property
    def depth_error(self) -> float:
        """How far the place may be off along the ray."""
        return DEPTH_SHARE * self.distance

    @property
    def distance(self) -> float:
        """From the camera to the centre."""
        return float(np.linalg.norm(self.centre - self.eye))


def joined(sightings: Sequence[Sighting]) -> list[list[Sighting]]:
    """Sightings in groups that are of one place, at most one of each view, the largest groups first.

    Two belong together where their rays pass each other within the smaller radius, where the model's depths agree to their errors, and
    where no other sighting of these views lies nearer. A group begins with the sighting that has most partners. They say where the place
    is, and then the place says which sightings are of it. So groups do not grow from one thing to the next.
    """
    partners = _partners(sightings)
    free = set(range(len(sightings)))
    counts = np.array([len(p) for p in partners])  # of free partners; −1: not free
    groups = []
    while free:
        hub = int(counts.argmax())
        group = {hub} | (partners[hub] & free)
        for _ in range(_ROUNDS):
            place = meeting_point([sightings[i] for i in group])
            near = group.union(*(partners[i] for i in group)) & free
            found = _of_place(sightings, sorted(near), place, float(np.median([sightings[i].radius for i in group])))
            if found in (group, set()):
                break
            group = found
        groups.append([sightings[i] for i in sorted(group)])
        for i in group | {hub}:
            free.remove(i)
            counts[i] = -1
            counts[[j for j in partners[i] if j in free]] -= 1
    return groups


def _partners(sightings: Sequence[Sighting]) -> list[set[int]]:
    """For each sighting, those of other views that belong to it."""
    found: list[set[int]] = [set() for _ in sightings]
    if len(sightings) < 2:
        return found
    centres, eyes = np.stack([s.centre for s in sightings]), np.stack([s.eye for s in sightings])
    radius, depth_error = (np.array([getattr(s, name) for s in sightings]) for name in ("radius", "depth_error"))
    a, b = cKDTree(centres).query_pairs(float((radius + depth_error).max()), output_type="ndarray").T
    apart = np.linalg.norm(centres[a] - centres[b], axis=1)
    rays = (centres - eyes) / np.linalg.norm(centres - eyes, axis=1, keepdims=True)
    across = np.cross(rays[a], rays[b])
    sine = np.linalg.norm(across, axis=1)
    passing = np.where(sine < 1e-6, apart, np.abs(((eyes[b] - eyes[a]) * across).sum(1)) / np.maximum(sine, 1e-12))
    smaller = np.minimum(radius[a], radius[b])
    near = (apart <= smaller) | ((passing <= smaller) & (apart <= np.maximum(depth_error[a], depth_error[b])))
    near &= np.array([sightings[i].frame != sightings[j].frame for i, j in zip(a, b, strict=True)], dtype=bool)
    a, b, apart = a[near], b[near], apart[near]
    nearest: dict[tuple[int, str], float] = {}
    for i, j, distance in zip((*a, *b), (*b, *a), (*apart, *apart), strict=True):
        key = (int(i), sightings[j].frame)
        nearest[key] = min(distance, nearest.get(key, np.inf))
    for i, j, distance in zip(a.tolist(), b.tolist(), apart, strict=True):
        if distance <= min(nearest[i, sightings[j].frame], nearest[j, sightings[i].frame]):
            found[i].add(j)
            found[j].add(i)
    return found


def _of_place(sightings: Sequence[Sighting], candidates: Sequence[int], place: Floats, radius: float) -> set[int]:
    """The candidates whose rays pass a place within a radius, and their own, at its depth; of each view, the one that passes nearest."""
    best: dict[str, tuple[float, int]] = {}
    for i in candidates:
        s = sightings[i]
        ray = (s.centre - s.eye) / s.distance
        along = float((place - s.eye) @ ray)
        passing = float(np.linalg.norm(place - s.eye - along * ray))
        if passing <= min(radius, s.radius) and abs(along - s.distance) <= 2 * s.depth_error:
            best[s.frame] = min(best.get(s.frame, (np.inf, i)), (passing, i))
    return {i for _, i in best.values()}


def meeting_point(group: Sequence[Sighting]) -> Floats:
    """`[3]`: where the rays to a spot meet, by least squares. A ray is known to half a pixel across, and to the model's depth along."""
    information, pull = np.zeros((3, 3)), np.zeros(3)
    for s in group:
        ray = (s.centre - s.eye) / np.linalg.norm(s.centre - s.eye)
        along = np.outer(ray, ray)
        weights = (np.eye(3) - along) / (CENTRE_PX * s.pixel) ** 2 + along / s.depth_error**2
        information, pull = information + weights, pull + weights @ s.centre
    return np.asarray(np.linalg.solve(information, pull), dtype=np.float64)


def facing_area(group: Sequence[Sighting], place: Floats) -> Floats:
    """`[3]`: the unit normal of the surface times the spot's area, by least squares over the views.

    A view from the direction d shows area · cosine, which is normal · area · d: linear in what is sought. It is good to a tenth. Where the
    views look from one side, the rest is the normal of the model's surface, to half a radian.
    """
    rays = np.stack([place - s.eye for s in group])
    distances = np.linalg.norm(rays, axis=1)
    rays /= distances[:, None]
    areas = np.array([s.area for s in group]) * (distances / np.array([s.distance for s in group])) ** 2
    normals = np.stack([s.normal for s in group])
    plane = np.linalg.eigh(normals.T @ normals)[1][:, 2]
    typical = float(np.median(areas))
    across = (np.eye(3) - np.outer(plane, plane)) / (NORMAL_ERROR * typical)
    weights = np.ones(len(group))
    for _ in range(_ROUNDS):  # a Cauchy loss, by reweighting: a view may show only a part of the spot
        system = np.concatenate([-weights[:, None] * rays / (AREA_ERROR * typical), across])
        right = np.concatenate([weights * areas / (AREA_ERROR * typical), np.zeros(3)])
        found = np.linalg.lstsq(system, right, rcond=None)[0]
        weights = 1 / np.hypot(1, (-rays @ found - areas) / (AREA_ERROR * typical))
    return np.asarray(found, dtype=np.float64)
