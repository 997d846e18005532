"""An upholstered armchair on turned legs; someone has just stood up from it."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, box, lathe, merged, patch, rod, sphere, tube
from rtgs.synthetic.model import STUDIO, Builder, Floats, Material, Model, Surface


def _wood(s: Surface) -> Floats:
    return tx.mix((0.24, 0.11, 0.05), (0.60, 0.36, 0.18), tx.wood(s.local[:, [2, 0, 1]], 0.035, 3))


def _fabric(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    ground = tx.mix((0.10, 0.30, 0.24), (0.16, 0.42, 0.33), tx.noise(s.local, 0.012, 2))
    ground = tx.mix(ground, (0.80, 0.64, 0.25), tx.stripes(uv[:, 0] + 0.02, 0.16, 0.13))
    flower = np.hypot((uv[:, 0] + 0.05) % 0.16 - 0.08, (uv[:, 1] + 0.03 * np.floor((uv[:, 0] + 0.05) / 0.16)) % 0.15 - 0.075)
    angle = np.arctan2((uv[:, 1] + 0.03 * np.floor((uv[:, 0] + 0.05) / 0.16)) % 0.15 - 0.075, (uv[:, 0] + 0.05) % 0.16 - 0.08)
    petals = (flower < 0.042 + 0.014 * np.cos(6 * angle)).astype(float)
    ground = tx.mix(ground, (0.93, 0.84, 0.55), petals)
    ground = tx.mix(ground, (0.62, 0.12, 0.14), (flower < 0.018).astype(float))
    return tx.mix(ground, (0.86, 0.80, 0.60), tx.dots(uv, 0.045, 5, 0.35, 0.08, 0.16) * (1 - petals))


def _seat_c(s: Surface) -> Floats:
    thighs = tx.bump(s.world, (-0.16, 0.05, 0.05), (0.11, 0.24, 0.2)) + tx.bump(s.world, (0.16, 0.05, 0.05), (0.11, 0.24, 0.2))
    back = tx.bump(s.world, (0, 0.38, 0.50), (0.20, 0.25, 0.22))
    hand = tx.bump(s.world, (0.30, -0.30, 0.06), (0.05, 0.06, 0.2))
    return s.base_c + 13 * np.minimum(thighs, 1) + 9 * back + 7 * hand


def _wood_c(s: Surface) -> Floats:
    floor = 9 * np.clip((-0.25 - s.world[:, 2]) / 0.75, 0, 1)  # feet on a cold floor
    hands = tx.bump(s.world, (-0.52, -0.28, 0.36), 0.11) + tx.bump(s.world, (0.52, -0.20, 0.36), 0.09)
    sun = 6 * np.clip((s.world[:, 0] + 0.2) / 0.9, 0, 1) * np.clip(s.world[:, 2], 0, 1)
    return s.base_c - floor + 10 * np.minimum(hands, 1) + sun


def _cushion(width: float, depth: float, height: float, puff: float) -> Mesh:
    """A box with rounded sides and a bulging top and bottom."""

    def surface(u: Floats, v: Floats) -> Floats:
        lon, lat = 2 * np.pi * u, np.pi * (v - 0.5)

        def power(x: Floats, e: float) -> Floats:
            return np.sign(x) * np.abs(x) ** e

        ring = power(np.cos(lat), 0.25)
        x, y = ring * power(np.cos(lon), 0.35), ring * power(np.sin(lon), 0.35)
        z = power(np.sin(lat), 0.45) * (0.5 * height + puff * (1 - 0.5 * (x * x + y * y)))
        return np.stack([0.5 * width * x, 0.5 * depth * y, z], axis=-1)

    return patch(surface, 96, 40)


def build() -> Model:
    b = Builder()
    timber = Material(_wood, _wood_c, specular=0.25, shininess=60)
    fabric = Material(_fabric, _seat_c)
    profile = [
        (0, -1.0),
        (0.035, -1.0),
        (0.045, -0.95),
        (0.03, -0.88),
        (0.03, -0.84),
        (0.055, -0.74),
        (0.055, -0.70),
        (0.035, -0.67),
        (0.045, -0.62),
        (0.062, -0.45),
        (0.062, -0.25),
        (0.05, -0.22),
        (0.05, -0.10),
        (0, -0.10),
    ]
    leg = lathe(profile, 16)
    for x in (-0.46, 0.46):
        b.add(timber, leg.moved((x, -0.44, 0)))
        b.add(timber, tube([(x, 0.44, -0.1), (x, 0.46, -0.5), (x * 1.04, 0.60, -1.0)], [0.055, 0.045, 0.03], 12))
        b.add(timber, tube([(x, 0.42, -0.15), (x, 0.47, 0.3), (x * 0.96, 0.62, 0.98)], [0.05, 0.045, 0.035], 12))
        b.add(timber, sphere(0.055, 16).moved((x * 0.96, 0.625, 1.0)))
        b.add(timber, box((0.06, 0.86, 0.12)).moved((x, 0, -0.17)))
        b.add(timber, rod((x, -0.44, -0.68), (x, 0.50, -0.68), 0.022))
        # arm rest on a turned post
        b.add(timber, tube([(x, -0.36, -0.1), (x * 1.1, -0.40, 0.1), (x * 1.1, -0.34, 0.34)], [0.032, 0.04, 0.03], 12))
        arm = [
            (x * 1.02, 0.47, 0.38),
            (x * 1.12, 0.1, 0.37),
            (x * 1.14, -0.3, 0.36),
            (x * 1.16, -0.46, 0.33),
            (x * 1.16, -0.50, 0.27),
        ]
        b.add(timber, tube(arm, [0.035, 0.045, 0.05, 0.045, 0.03], 14))
    b.add(timber, [box((0.92, 0.06, 0.12)).moved((0, y, -0.17)) for y in (-0.43, 0.43)])
    b.add(timber, rod((-0.46, 0.0, -0.68), (0.46, 0.0, -0.68), 0.022))
    b.add(timber, box((0.86, 0.84, 0.03)).moved((0, 0, -0.13)))
    b.add(fabric, _cushion(0.94, 0.88, 0.14, 0.06).moved((0, -0.02, 0.0)), base_c=23)
    # the back: a padded panel between two rails, spindles under it, a carved crest above
    lean = (-13, 0, 0)
    b.add(fabric, _cushion(0.74, 0.52, 0.07, 0.04).moved((0, 0, 0), (90, 0, 0)).moved((0, 0.50, 0.62), lean), base_c=24)
    b.add(timber, rod((-0.46, 0.46, 0.30), (0.46, 0.46, 0.30), 0.028))
    b.add(timber, [rod((x, 0.44, -0.1), (x, 0.46, 0.30), 0.013) for x in np.linspace(-0.36, 0.36, 9)])
    t = np.linspace(-1, 1, 25)
    crest = np.stack(
        [0.44 * t, 0.60 + 0.02 * np.cos(3 * t), 0.93 + 0.09 * np.cos(t * np.pi / 2) + 0.015 * np.cos(t * np.pi * 3)], 1
    )
    b.add(timber, tube(crest, 0.045 - 0.012 * np.abs(t), 14))
    studs = [sphere(0.012, 8).moved((x, -0.462, -0.135)) for x in np.linspace(-0.42, 0.42, 18)]
    b.add(Material(specular=0.8, shininess=80, reflect=0.2), merged(studs), (0.85, 0.65, 0.25), 18)
    return Model(tuple(b.parts), STUDIO, ambient_c=19, background_c=6, centre=(0, 0.09, 0.02))
