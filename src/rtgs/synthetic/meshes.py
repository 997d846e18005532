"""Triangle meshes from parametric patches: boxes, lathed bodies, tubes, sheets.

Lengths are metres, z is up. A mesh keeps the coordinates it was modelled in (`local`) when it is moved, so that textures
stick to it. Large faces are divided, because occlusion is computed per vertex.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtgs.maths.geometry import rotation_from_axis_angle

Floats = NDArray[np.float64]
STEP_M = 0.05  # longest edge on flat faces


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with smooth normals.

    Attributes:
        points, normals: `[V, 3]`, in the world (or in the parent shape, before it is moved).
        local, local_normals: `[V, 3]`, the same in the coordinates that the shape was modelled in.
        faces: `[F, 3]` int, vertex indices.
    """

    points: Floats
    normals: Floats
    faces: NDArray[np.int64]
    local: Floats
    local_normals: Floats

    def moved(self, translation: ArrayLike = (0, 0, 0), axis_angle_deg: ArrayLike = (0, 0, 0)) -> Mesh:
        """Turned by a rotation vector in degrees, then shifted; textures move along."""
        r = rotation_from_axis_angle(np.radians(np.asarray(axis_angle_deg, dtype=np.float64)))
        return replace(self, points=self.points @ r.T + np.asarray(translation, dtype=np.float64), normals=self.normals @ r.T)

    def stretched(self, factors: ArrayLike) -> Mesh:
        """Scaled by x, y, z factors, local coordinates included."""
        f = np.broadcast_to(np.asarray(factors, dtype=np.float64), 3)
        normals, local_normals = _unit(self.normals / f), _unit(self.local_normals / f)
        return replace(self, points=self.points * f, normals=normals, local=self.local * f, local_normals=local_normals)

    def baked(self) -> Mesh:
        """The same mesh with the present coordinates as its local ones: several shapes then share one texture space."""
        return replace(self, local=self.points, local_normals=self.normals)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles in one mesh; each keeps its local coordinates."""
    offsets = np.cumsum([0] + [len(m.points) for m in meshes[:-1]])
    return Mesh(
        np.concatenate([m.points for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=True)]),
        np.concatenate([m.local for m in meshes]),
        np.concatenate([m.local_normals for m in meshes]),
    )


def patch(surface: Callable[[Floats, Floats], Floats], nu: int, nv: int) -> Mesh:
    """`surface(u, v) -> [..., 3]` sampled on (nu + 1) × (nv + 1) points of [0, 1]²; the normal is ∂u × ∂v."""
    u, v = np.meshgrid(np.linspace(0, 1, nu + 1), np.linspace(0, 1, nv + 1), indexing="ij")
    points = surface(u, v).reshape(-1, 3)
    e = 1e-4
    uc, vc = np.clip(u, 20 * e, 1 - 20 * e), np.clip(v, 20 * e, 1 - 20 * e)  # poles have no tangent; beside them there is one
    du, dv = surface(uc + e, vc) - surface(uc - e, vc), surface(uc, vc + e) - surface(uc, vc - e)
    normals = _unit(np.cross(du, dv).reshape(-1, 3))
    index = np.arange(points.shape[0]).reshape(nu + 1, nv + 1)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(points, normals, faces, points, normals)


def quad(corner: ArrayLike, edge_u: ArrayLike, edge_v: ArrayLike, step_m: float = STEP_M) -> Mesh:
    """A flat parallelogram that faces `edge_u × edge_v`."""
    c, eu, ev = (np.asarray(x, dtype=np.float64) for x in (corner, edge_u, edge_v))
    nu, nv = (max(1, int(np.ceil(np.linalg.norm(x) / step_m))) for x in (eu, ev))
    return patch(lambda u, v: c + u[..., None] * eu + v[..., None] * ev, nu, nv)


def box(size: ArrayLike, centre: ArrayLike = (0, 0, 0), step_m: float = STEP_M) -> Mesh:
    """An axis-aligned box; local coordinates are about its centre."""
    s = np.broadcast_to(np.asarray(size, dtype=np.float64), 3)
    x, y, z = np.diag(s)
    h = s / 2
    sides = [
        quad(-h, y, x, step_m),
        quad(h - x - y, x, y, step_m),
        quad(-h, x, z, step_m),
        quad(h - x - z, z, x, step_m),
        quad(-h, z, y, step_m),
        quad(h - y - z, y, z, step_m),
    ]
    return merged(sides).moved(centre)


def lathe(profile: ArrayLike, segments: int = 32, smooth: bool = False, step_m: float = 2 * STEP_M) -> Mesh:
    """A body of revolution about z.

    `profile` `[K, 2]` lists (radius, z); walked upwards on the outside, normals point outwards. Its corners stay sharp
    unless `smooth`.
    """
    rz = np.asarray(profile, dtype=np.float64)

    def ring(u: Floats, radius: Floats, z: Floats) -> Floats:
        return np.stack([radius * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * u), z], axis=-1)

    if smooth:
        t = np.linspace(0, 1, len(rz))
        return patch(lambda u, v: ring(u, np.interp(v, t, rz[:, 0]), np.interp(v, t, rz[:, 1])), segments, len(rz) - 1)
    parts = []
    for a, b in pairwise(rz):

        def frustum(u: Floats, v: Floats, a: Floats = a, b: Floats = b) -> Floats:
            return ring(u, a[0] + v * (b[0] - a[0]), a[1] + v * (b[1] - a[1]))

        parts.append(patch(frustum, segments, max(1, int(np.ceil(np.hypot(*(b - a)) / step_m)))))
    return merged(parts)


def cylinder(radius: float, height: float, segments: int = 24) -> Mesh:
    """A closed cylinder about the z axis, from z = 0 to `height`."""
    return lathe([(0, 0), (radius, 0), (radius, height), (0, height)], segments)


def sphere(radius: float, segments: int = 40) -> Mesh:
    """A sphere about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)

    def surface(u: Floats, v: Floats) -> Floats:
        lat, lon = np.interp(v, np.linspace(0, 1, len(angle)), angle), 2 * np.pi * u
        return radius * np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)

    return patch(surface, segments, segments // 2)


def torus(ring_radius: float, tube_radius: float, segments: int = 40, around: int = 10) -> Mesh:
    """A ring about the z axis, centred on the origin."""

    def surface(u: Floats, v: Floats) -> Floats:
        a, b = 2 * np.pi * u, 2 * np.pi * v
        r = ring_radius + tube_radius * np.cos(b)
        return np.stack([r * np.cos(a), r * np.sin(a), tube_radius * np.sin(b)], axis=-1)

    return patch(surface, segments, around)


def tube(path: ArrayLike, radius: float | ArrayLike, segments: int = 10, step_m: float = 2 * STEP_M) -> Mesh:
    """A round rod along the polyline `path` `[K, 3]`, closed at the ends; `radius` is one number or one a point of the path.

    Local coordinates: x, y across the rod, z the distance along it.
    """
    p = np.asarray(path, dtype=np.float64)
    r = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(p))
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    fine = np.unique(np.concatenate([at, np.linspace(0, at[-1], max(2, int(np.ceil(at[-1] / step_m)) + 1))]))
    centres = np.stack([np.interp(fine, at, p[:, k]) for k in range(3)], axis=1)
    radii = np.interp(fine, at, r)
    tangent = _unit(np.gradient(centres, fine, axis=0))
    side = np.empty_like(tangent)
    side[0] = _unit(np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))]))
    for i in range(1, len(fine)):  # carry the frame along without twist
        side[i] = _unit(side[i - 1] - tangent[i] * (side[i - 1] @ tangent[i]))
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    across = np.cos(angle)[:, None, None] * side + np.sin(angle)[:, None, None] * np.cross(tangent, side)  # [A, K, 3]
    local_across = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)[:, None].repeat(len(fine), axis=1)
    points = centres + radii[:, None] * across
    local = radii[:, None] * local_across
    local[..., 2] = fine
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    body = Mesh(points.reshape(-1, 3), across.reshape(-1, 3), faces, local.reshape(-1, 3), local_across.reshape(-1, 3))
    return merged([body, *(_cap(points[:, k], centres[k], sign * tangent[k], fine[k]) for k, sign in ((0, -1.0), (-1, 1.0)))])


def rod(start: ArrayLike, end: ArrayLike, radius: float, segments: int = 10) -> Mesh:
    """A straight `tube`."""
    return tube(np.stack([np.asarray(start), np.asarray(end)]), radius, segments)


def plate_with_hole(size: float, radius: float, thickness: float, segments: int = 24) -> Mesh:
    """A square plate about z = 0 with a round hole through its middle."""
    h, t = size / 2, thickness / 2

    def edge(u: Floats) -> Floats:
        c, s = np.cos(2 * np.pi * u), np.sin(2 * np.pi * u)
        return h / np.maximum(np.abs(c), np.abs(s))

    def flat(z: float, up: bool) -> Mesh:
        def surface(u: Floats, v: Floats) -> Floats:
            w = v if up else 1 - v
            r = edge(u) + w * (radius - edge(u))
            # ∂u × ∂v points down when the radius grows with v
            return np.stack([r * np.cos(2 * np.pi * u), r * np.sin(2 * np.pi * u), np.full_like(r, z)], axis=-1)

        return patch(surface, segments, 2)

    bore = patch(
        lambda u, v: np.stack([radius * np.cos(2 * np.pi * u), radius * np.sin(2 * np.pi * u), t - 2 * t * v], axis=-1),
        segments,
        1,
    )
    rim = patch(
        lambda u, v: np.stack([edge(u) * np.cos(2 * np.pi * u), edge(u) * np.sin(2 * np.pi * u), -t + 2 * t * v], axis=-1),
        segments,
        1,
    )
    return merged([flat(t, True), flat(-t, False), bore, rim])


def _cap(ring: Floats, centre: Floats, normal: Floats, along: float) -> Mesh:
    n = len(ring)
    points = np.concatenate([ring, centre[None]])
    faces = np.stack([np.arange(n - 1), np.arange(1, n), np.full(n - 1, n)], axis=1)
    angle = np.linspace(0, 2 * np.pi, n)
    radius = np.linalg.norm(ring[0] - centre)
    local = np.concatenate(
        [np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, along)], 1), [[0.0, 0.0, along]]]
    )
    local_normal = np.array([0.0, 0.0, -1.0 if along == 0 else 1.0])
    return Mesh(points, np.tile(normal, (n + 1, 1)), faces, local, np.tile(local_normal, (n + 1, 1)))


def _unit(vectors: Floats) -> Floats:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
