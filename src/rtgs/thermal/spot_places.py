"""Where spots are: sightings of several views joined to places, where their rays meet, and the area on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

NEAR_PX = 2.0  # rays of two views to one place pass each other within so many pixels
DEPTH_SHARE = 0.04  # of the distance: error of the model's depth, on surfaces without texture
CENTRE_PX = 0.5  # how well a photograph shows the centre of a spot
AREA_ERROR = 0.1  # share: how well a view shows a spot's area across the ray
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
    across = (np.eye(3) - np.outer(plane, plane)) / (NORMAL_ERROR * areas.mean())
    system = np.concatenate([-rays / (AREA_ERROR * areas[:, None]), across])
    found = np.linalg.lstsq(system, np.concatenate([np.full(len(group), 1 / AREA_ERROR), np.zeros(3)]), rcond=None)[0]
    return np.asarray(found, dtype=np.float64)
