"""The shapes that scenes are made of."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.synthetic.meshes import Mesh, box, cylinder, plate_with_hole, rod, sphere, torus
from rtgs.synthetic.model import STUDIO, Material, Model, Part
from rtgs.synthetic.raycast import CompiledModel

pytest.importorskip("embreex")


@pytest.mark.parametrize(
    ("mesh", "inside"),
    [
        (box((0.4, 0.5, 0.6)), (0, 0, 0)),
        (sphere(0.3), (0, 0, 0)),
        (cylinder(0.2, 0.5), (0, 0, 0.25)),
        (rod((0, 0, 0), (0.3, 0.2, 0.4), 0.05), (0.15, 0.1, 0.2)),
        (torus(0.4, 0.1), (0.4, 0, 0)),
        (plate_with_hole(0.2, 0.05, 0.04), (0.08, 0, 0)),
    ],
)
def test_shapes_are_closed_and_normals_point_outwards(mesh: Mesh, inside: tuple[float, float, float]) -> None:
    """Rays from within meet a face from behind, whichever way they go; so no light leaks and occlusion looks outwards."""
    model = CompiledModel(Model((Part(mesh, Material()),), STUDIO))
    directions = np.random.default_rng(0).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile(np.asarray(inside, dtype=float), (300, 1))
    assert len(model.hits(origins, directions).ray) == 300
    corners = mesh.points[mesh.faces]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.linalg.norm(n, axis=1) > 1e-10
    mean_normal = mesh.normals[mesh.faces].mean(axis=1)
    unit = n[solid] / np.linalg.norm(n[solid], axis=1, keepdims=True)
    assert (np.abs((unit * mean_normal[solid]).sum(axis=1)) > 0.8).all()
    probe = corners[solid].mean(axis=1) + 1e-4 * mean_normal[solid]
    outwards = mean_normal[solid] / np.linalg.norm(mean_normal[solid], axis=1, keepdims=True)
    behind = model.occluded(probe - 1e-2 * outwards, outwards, 0.02)
    assert behind.mean() > 0.95
