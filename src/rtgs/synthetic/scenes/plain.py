"""Fields and lanes of a plain, from 800 m above: as far away as makes a rig's baseline invisible."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import quad
from rtgs.synthetic.model import Builder, Floats, Material, Model, Surface, soft_light

HALF_SIDE_M = 640.0
_FIELD_M = 70.0
_LANE_M = 9.0


def _field(s: Surface) -> tuple[Floats, Floats]:
    """A random number for each field, and 1 on lanes between them; borders are bent."""
    p = s.world[:, :2] + 22 * np.stack([tx.noise(s.world, 160, 3), tx.noise(s.world, 160, 4)], axis=1)
    cell = np.floor(p / _FIELD_M).astype(np.int64)
    lane = (np.abs(p - np.round(p / _FIELD_M) * _FIELD_M).min(axis=1) < 0.5 * _LANE_M).astype(np.float64)
    return tx.cell_noise(cell, 5), lane


def _ground(s: Surface) -> Floats:
    field, lane = _field(s)
    crops = tx.ramp(field, [(0.20, 0.34, 0.12), (0.62, 0.58, 0.25), (0.36, 0.25, 0.15), (0.45, 0.55, 0.20), (0.75, 0.68, 0.42)])
    rows = 0.85 + 0.15 * tx.stripes(s.world[:, 0] * np.cos(6 * field) + s.world[:, 1] * np.sin(6 * field), 7.0)
    shade = 0.8 + 0.4 * tx.fbm(s.world, 40, 4, 6)
    return tx.mix(np.clip(crops * (rows * shade)[:, None], 0, 1), (0.62, 0.60, 0.57), lane)


def _ground_c(s: Surface) -> Floats:
    field, lane = _field(s)
    own = 14 + 16 * ((field * 7.3) % 1.0) + 3 * tx.fbm(s.world, 30, 3, 8)
    return own * (1 - lane) + 33 * lane


def build() -> Model:
    b = Builder()
    h = HALF_SIDE_M
    b.add(Material(_ground, _ground_c), quad((-h, -h, 0), (2 * h, 0, 0), (0, 2 * h, 0), step_m=40.0))
    sun = soft_light((30_000.0, -20_000.0, 60_000.0), 100.0, (0.9, 0.86, 0.8))
    return Model(tuple(b.parts), (sun,), ambient_c=18, background_c=6)
