"""Casts a camera's rays on a compiled model and shades the hits: linear RGB, and temperature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3, look_at
from rtgs.records.camera import Camera
from rtgs.synthetic.model import Light, Material, Model, Surface

Floats = NDArray[np.float64]
OCCLUSION_RAYS = 96
CHUNK_RAYS = 200_000  # rays in flight: bounds memory at any image size
_LIFT_M = 1e-3  # secondary rays start this far off the surface
_WINDOW_FRAME = look_at((0, 0, 0), (-0.55, 0.35, 0.76)).rotation.T  # what glossy things mirror, off the side of the lights


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays met the model: `ray` `[H]` indices of those that did, and the surface there."""

    ray: NDArray[np.int64]
    surface: Surface
    material: NDArray[np.int64]
    openness: Floats  # [H], 1 = nothing near


class CompiledModel:
    """A model in one triangle soup, with the openness (1 − ambient occlusion) of every vertex."""

    def __init__(self, model: Model) -> None:
        """From a model's meshes.

        Raises:
            RtgsError: embreex is missing.
        """
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:  # no wheel for this platform
            raise RtgsError("synthetic captures need the package `embreex`, which is not installed for this platform") from error
        self.model = model
        self.materials: list[Material] = []
        meshes = [p.mesh for p in model.parts]
        face_counts = [len(m.faces) for m in meshes]
        offsets = np.cumsum([0] + [len(m.points) for m in meshes[:-1]])
        points = np.concatenate([m.points for m in meshes])
        normals = np.concatenate([m.normals for m in meshes])
        self.points = points
        self.faces = np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=True)])
        # normal, local position, local normal, openness: interpolated over the triangle
        self.attributes = np.concatenate(
            [
                normals,
                np.concatenate([m.local for m in meshes]),
                np.concatenate([m.local_normals for m in meshes]),
                np.ones((len(points), 1)),
            ],
            axis=1,
        ).astype(np.float32)
        self.part_of_face = np.repeat(np.arange(len(meshes)), face_counts)
        self.part_colour = np.array([p.colour for p in model.parts], dtype=np.float64)
        self.part_base_c = np.array([p.base_c for p in model.parts], dtype=np.float64)
        material_of_part = []
        for p in model.parts:
            if p.material not in self.materials:
                self.materials.append(p.material)
            material_of_part.append(self.materials.index(p.material))
        self.material_of_part = np.array(material_of_part)
        self._embree = EmbreeScene()
        TriangleMesh(self._embree, points.astype(np.float32), self.faces.astype(np.int32))
        self.attributes[:, 9] = self._openness(points, normals)

    def hits(self, origins: Floats, directions: Floats) -> Hits:
        """First hits of rays `[R, 3]`, `[R, 3]` (unit directions); normals face the ray's origin."""
        found = self._embree.run(origins.astype(np.float32), directions.astype(np.float32), output=True)
        ray = np.flatnonzero(found["primID"] >= 0)
        face = found["primID"][ray].astype(np.int64)
        v = self.faces[face]
        # The plane's intersection in float64: embree's distance is float32.
        a, b, c = self.points[v[:, 0]], self.points[v[:, 1]], self.points[v[:, 2]]
        o, d = origins[ray], directions[ray]
        ab, ac = b - a, c - a
        n = np.cross(ab, ac)
        t = ((a - o) * n).sum(1) / (d * n).sum(1)
        world = o + t[:, None] * d
        w = world - a
        nn = (n * n).sum(1)
        beta = (np.cross(w, ac) * n).sum(1) / nn
        gamma = (np.cross(ab, w) * n).sum(1) / nn
        beta, gamma = (x.astype(np.float32)[:, None] for x in (np.clip(beta, 0, 1), np.clip(gamma, 0, 1)))
        attributes = self.attributes
        value = attributes[v[:, 0]] * (1 - beta - gamma) + attributes[v[:, 1]] * beta + attributes[v[:, 2]] * gamma
        value = value.astype(np.float64)
        normal = value[:, :3] / np.maximum(np.linalg.norm(value[:, :3], axis=1, keepdims=True), 1e-9)
        normal *= np.where((normal * d).sum(1, keepdims=True) > 0, -1.0, 1.0)
        part = self.part_of_face[face]
        surface = Surface(value[:, 3:6], value[:, 6:9], world, normal, self.part_colour[part], self.part_base_c[part], part)
        return Hits(ray, surface, self.material_of_part[part], value[:, 9])

    def occluded(self, origins: Floats, directions: Floats, reach_m: Floats | float) -> NDArray[np.bool_]:
        """Whether anything lies within `reach_m` along unit directions."""
        reach = np.broadcast_to(np.asarray(reach_m, dtype=np.float32), len(origins)).copy()
        return self._embree.run(origins.astype(np.float32), directions.astype(np.float32), reach, query="OCCLUDED") == 0

    def temperature_c(self, hits: Hits) -> Floats:
        """`[H]` °C: the material's temperature, drawn towards the air's where the point is hidden."""
        own = np.empty(len(hits.ray))
        for index, selected, surface in self._by_material(hits):
            own[selected] = self.materials[index].temperature_c(surface)
        ambient = self.model.ambient_c
        return ambient + (own - ambient) * (0.6 + 0.4 * hits.openness)

    def radiance(self, hits: Hits, towards_camera: Floats) -> Floats:
        """`[H, 3]` linear RGB seen along unit vectors `towards_camera` `[H, 3]`."""
        h = len(hits.ray)
        albedo, specular, shininess, reflect = np.empty((h, 3)), np.empty(h), np.empty(h), np.empty(h)
        for index, selected, surface in self._by_material(hits):
            material = self.materials[index]
            albedo[selected] = np.clip(material.albedo(surface), 0, 1) ** 2.2
            specular[selected], shininess[selected], reflect[selected] = material.specular, material.shininess, material.reflect
        n, world = hits.surface.normal, hits.surface.world
        up = 0.5 + 0.5 * n[:, 2:3]
        ambient = np.asarray(self.model.ground) * (1 - up) + np.asarray(self.model.sky) * up
        out = albedo * ambient * (0.25 + 0.75 * hits.openness[:, None])
        for light in self.model.lights:
            diffuse, highlight = self._light(light, world, n, towards_camera, shininess)
            out += (albedo * diffuse[:, None] + (specular * highlight)[:, None]) * np.asarray(light.colour)
        mirror = np.flatnonzero(reflect > 0)
        if len(mirror):
            view, normal = towards_camera[mirror], n[mirror]
            cosine = np.clip((view * normal).sum(1), 0, 1)
            share = reflect[mirror] + (1 - reflect[mirror]) * 0.5 * (1 - cosine) ** 5
            bounced = 2 * cosine[:, None] * normal - view
            blocked = self.occluded(world[mirror] + _LIFT_M * normal, bounced, 2.0)
            out[mirror] += (share * np.where(blocked, 0.15, 1.0))[:, None] * self._surroundings(bounced)
        return out

    def _surroundings(self, direction: Floats) -> Floats:
        """Linear RGB that mirrors see: a bright sky with a window in it above a dim floor."""
        up = np.clip(0.5 + 2.5 * direction[:, 2:3], 0, 1)
        sky = np.asarray(self.model.sky) * up + 0.5 * np.asarray(self.model.ground) * (1 - up)
        x, y = direction @ _WINDOW_FRAME[0], direction @ _WINDOW_FRAME[1]
        pane = (np.abs(x) < 0.34) & (np.abs(y) < 0.26) & (np.abs(x) > 0.02) & (direction @ _WINDOW_FRAME[2] > 0)
        return 1.3 * sky + 2.2 * pane[:, None]

    def _light(self, light: Light, world: Floats, n: Floats, view: Floats, shininess: Floats) -> tuple[Floats, Floats]:
        diffuse, highlight = np.zeros(len(world)), np.zeros(len(world))
        for sample in light.samples:
            to = sample - world
            distance = np.linalg.norm(to, axis=1)
            to /= distance[:, None]
            cosine = (to * n).sum(1)
            lit = np.flatnonzero(cosine > 0)
            if not len(lit):
                continue
            start = world[lit] + _LIFT_M * n[lit]
            lit = lit[~self.occluded(start, to[lit], distance[lit] - 2 * _LIFT_M)]
            strength = np.ones(len(lit))
            if np.isfinite(light.reference_m):
                strength = np.minimum(4.0, (light.reference_m / distance[lit]) ** 2)
            diffuse[lit] += strength * cosine[lit]
            half = to[lit] + view[lit]
            half /= np.linalg.norm(half, axis=1, keepdims=True)
            highlight[lit] += strength * np.clip((half * n[lit]).sum(1), 0, 1) ** shininess[lit]
        return diffuse / len(light.samples), highlight / len(light.samples)

    def _by_material(self, hits: Hits) -> list[tuple[int, NDArray[np.int64], Surface]]:
        s = hits.surface
        order = np.argsort(hits.material, kind="stable")
        starts = np.searchsorted(hits.material[order], np.arange(len(self.materials) + 1))
        out = []
        for index in range(len(self.materials)):
            i = order[starts[index] : starts[index + 1]]
            if len(i):
                out.append(
                    (
                        index,
                        i,
                        Surface(s.local[i], s.normal_local[i], s.world[i], s.normal[i], s.colour[i], s.base_c[i], s.part[i]),
                    )
                )
        return out

    def _openness(self, points: Floats, normals: Floats) -> NDArray[np.float32]:
        """`[V]` share of a cosine-weighted fan of rays that gets `occlusion_m` away; one fan for all, so without noise."""
        # Off the surface, and off the mesh's border towards its faces: a vertex on an edge would look into the neighbour.
        centroid, count = np.zeros_like(points), np.zeros(len(points))
        middle = self.points[self.faces].mean(axis=1)
        for k in range(3):
            np.add.at(centroid, self.faces[:, k], middle)
            np.add.at(count, self.faces[:, k], 1)
        inwards = np.where(count[:, None] > 0, centroid / np.maximum(count, 1)[:, None] - points, 0)
        origins = points + 0.2 * inwards + 2 * _LIFT_M * normals
        helper = np.where(np.abs(normals[:, 2:3]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
        x = np.cross(helper, normals)
        x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-9)
        y = np.cross(normals, x)
        spot = np.arange(OCCLUSION_RAYS) + 0.5
        radius, angle = np.sqrt(spot / OCCLUSION_RAYS), spot * np.pi * (3 - np.sqrt(5))
        fan = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)], axis=1)
        free = np.zeros(len(points), dtype=np.float32)
        for a, b, c in fan:
            free += ~self.occluded(origins, a * x + b * y + c * normals, self.model.occlusion_m)
        return (free / OCCLUSION_RAYS).astype(np.float32)


def render_rgb(model: CompiledModel, camera: Camera, world_from_camera: SE3, supersampling: int = 2) -> NDArray[np.float32]:
    """`[H, W, 3]` float32 sRGB in [0, 1], averaged in linear light. The camera is a pinhole; the world is in metres."""
    background = np.asarray(model.model.background_rgb, dtype=np.float64) ** 2.2

    def shade(origins: Floats, directions: Floats) -> Floats:
        out = np.tile(background, (len(origins), 1))
        hits = model.hits(origins, directions)
        if len(hits.ray):
            out[hits.ray] = model.radiance(hits, -directions[hits.ray])
        return np.clip(out, 0, 1)

    return (_render(camera, world_from_camera, supersampling, shade, 3) ** (1 / 2.2)).astype(np.float32)


def render_thermal(model: CompiledModel, camera: Camera, world_from_camera: SE3, supersampling: int = 2) -> NDArray[np.float32]:
    """`[H, W]` float32 °C."""
    return render_values(model, camera, world_from_camera, supersampling, model.temperature_c, model.model.background_c)


def render_values(
    model: CompiledModel,
    camera: Camera,
    world_from_camera: SE3,
    supersampling: int,
    value: Callable[[Hits], Floats],
    background: float,
) -> NDArray[np.float32]:
    """`[H, W]` float32: the mean over a pixel's rays of a value `[H]` of their hits, or of the background's."""

    def shade(origins: Floats, directions: Floats) -> Floats:
        out = np.full((len(origins), 1), background, dtype=np.float64)  # an integer would round every value
        hits = model.hits(origins, directions)
        if len(hits.ray):
            out[hits.ray, 0] = value(hits)
        return out

    return _render(camera, world_from_camera, supersampling, shade, 1)[..., 0].astype(np.float32)


_Shade = Callable[[Floats, Floats], Floats]
"""(origins `[R, 3]`, directions `[R, 3]`) of rays → `[R, C]`."""


def _render(camera: Camera, world_from_camera: SE3, n: int, shade: _Shade, channels: int) -> Floats:
    """Mean over n × n rays a pixel, a band of rows at a time."""
    w, h = camera.width, camera.height
    x = ((np.arange(w * n) + 0.5) / n - camera.cx) / camera.fl_x  # the ray through pixel i's centre is at i + 0.5
    out = np.empty((h, w, channels))
    rows = max(1, CHUNK_RAYS // (w * n * n))
    for top in range(0, h, rows):
        bottom = min(h, top + rows)
        y = ((np.arange(top * n, bottom * n) + 0.5) / n - camera.cy) / camera.fl_y
        directions = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.ones((len(y), len(x)))], axis=-1).reshape(-1, 3)
        directions = directions @ world_from_camera.rotation.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = np.broadcast_to(world_from_camera.translation, directions.shape)
        value = shade(origins, directions)
        out[top:bottom] = value.reshape(bottom - top, n, w, n, channels).mean(axis=(1, 3))
    return out
