"""A two-masted ship on a disc of water: thin rigging, sheets of sail, a moving surface frozen."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, box, cylinder, lathe, patch, rod, sphere, tube
from rtgs.synthetic.model import STUDIO, Builder, Floats, Material, Model, Surface

WATER = -0.42


def _waves(x: Floats, y: Floats) -> Floats:
    z = (
        0.020 * np.sin(7 * x + 3 * y)
        + 0.014 * np.sin(-5 * x + 9 * y + 1)
        + 0.009 * np.sin(15 * x + 11 * y)
        + 0.007 * np.sin(21 * x - 17 * y)
    )
    return z * np.clip(4 * (1.06 - np.hypot(x, y)), 0, 1)


def _water(s: Surface) -> Floats:
    p = s.world
    deep = tx.ramp(
        tx.fbm(p * [1, 1, 0.2], 0.16, 5, 3), [(0.02, 0.10, 0.16), (0.04, 0.22, 0.30), (0.10, 0.36, 0.42), (0.30, 0.55, 0.58)]
    )
    foam = tx.fbm(p * [1, 1.6, 0.2], 0.10, 5, 11)
    hull = np.clip(1 - (np.hypot(p[:, 0] / 0.95, p[:, 1] / 0.34) - 0.9) * 5, 0, 1)
    crest = np.clip((p[:, 2] - WATER) / 0.05, 0, 1)
    return tx.mix(deep, (0.90, 0.95, 0.95), ((foam + 0.25 * hull + 0.18 * crest) > 0.78).astype(float))


def _water_c(s: Surface) -> Floats:
    x, y = s.world[:, 0], s.world[:, 1]
    plume = np.exp(-(((y - 0.12 * np.sin(5 * x)) / (0.10 + 0.12 * np.clip(-x, 0, 1))) ** 2)) * np.clip(-x - 0.35, 0, 0.5)
    outlet = tx.bump(s.world[:, :2], (0.15, -0.38), (0.16, 0.10))
    return s.base_c + 14 * plume + 9 * outlet + 1.6 * tx.noise(s.world, 0.35, 4) + 1.5 * x


def _planks(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    on, which = tx.bricks(uv, 0.36, 0.042, 0.005, 5)
    grain = tx.noise(s.local * np.array([0.15, 1.0, 1.0]), 0.010, 4)
    colour = tx.ramp(0.55 * which + 0.45 * grain, [(0.22, 0.11, 0.05), (0.45, 0.26, 0.12), (0.60, 0.39, 0.20)])
    nails = tx.dots(uv, 0.042, 6, 0.35, 0.06, 0.12)
    return tx.mix((0.07, 0.04, 0.03), tx.mix(colour, (0.10, 0.08, 0.07), nails), on)


def _hull(s: Surface) -> Floats:
    colour = _planks(s)
    z = s.local[:, 2]
    colour = tx.mix(colour, (0.83, 0.70, 0.25), (np.abs(z - 0.16) < 0.012).astype(float))
    ports = (np.abs(z - 0.09) < 0.030) & (((s.local[:, 0] + 0.06) / 0.14) % 1 < 0.36) & (np.abs(s.local[:, 0]) < 0.55)
    colour = tx.mix(colour, (0.72, 0.12, 0.10), ports.astype(float))
    return tx.mix(colour, (0.12, 0.20, 0.18), (z < -0.06 + 0.02 * tx.noise(s.local, 0.05, 7)) * 0.8)


def _hull_c(s: Surface) -> Floats:
    wet = 1 / (1 + np.exp((s.world[:, 2] - WATER - 0.07) / 0.02))
    stove = tx.bump(s.world, (0.15, -0.28, -0.27), (0.13, 0.12, 0.09)) + 0.8 * tx.bump(
        s.world, (-0.5, 0.2, -0.2), (0.10, 0.15, 0.08)
    )
    ribs = 0.5 + 0.5 * np.cos(s.local[:, 0] * 2 * np.pi / 0.17)
    return s.base_c - 8 * wet + 17 * stove + 2.5 * ribs


def _deck_c(s: Surface) -> Floats:
    hold = tx.bump(s.world, (0.1, 0, -0.2), (0.16, 0.12, 0.2))
    return s.base_c + 7 * hold + 5 * tx.bump(s.world, (-0.62, 0.0, -0.05), (0.1, 0.07, 0.2))


def _canvas(s: Surface) -> Floats:
    p = s.local
    colour = tx.mix((0.72, 0.66, 0.52), (0.93, 0.89, 0.78), tx.fbm(p, 0.09, 5, 8))
    colour = tx.mix(
        colour, (0.50, 0.43, 0.32), np.maximum(tx.stripes(p[:, 1], 0.11, 0.06), 0.7 * tx.stripes(p[:, 2], 0.15, 0.05))
    )
    patches = tx.dots(p[:, 1:], 0.12, 3, 0.13, 0.12, 0.3)
    return tx.mix(colour, (0.60, 0.30, 0.22), patches)


def _canvas_c(s: Surface) -> Floats:
    sun = np.abs(s.normal @ np.array([0.4, -0.6, 0.5]))
    return s.base_c + 6 * sun + 4 * np.tanh(5 * (tx.noise(s.world, 0.28, 3) - 0.5))


def _hull_section(v: Floats) -> tuple[Floats, Floats, Floats]:
    """Along the keel, v in [0, 1] from stern to bow: (x, half width, sheer height)."""
    x = -0.80 + 1.60 * v
    width = 0.255 * (1 - np.clip((v - 0.45) / 0.55, 0, 1) ** 2.4) ** 0.9 * (0.72 + 0.28 * np.clip(v / 0.3, 0, 1))
    sheer = 0.20 + 0.16 * np.clip((0.30 - v) / 0.30, 0, 1) ** 0.5 + 0.12 * np.clip((v - 0.6) / 0.4, 0, 1) ** 2
    return x, width, sheer


def _shell() -> Mesh:
    def outside(u: Floats, v: Floats) -> Floats:
        x, width, sheer = _hull_section(v)
        a = (u - 0.5) * 2  # −1 starboard gunwale, 0 keel, 1 port gunwale
        depth = np.abs(a)
        keel = -0.22 + 0.10 * np.clip((v - 0.7) / 0.3, 0, 1) ** 2
        return np.stack(
            [x + 0.10 * depth * np.clip(v - 0.8, 0, 1) * 4, np.sign(a) * width * depth**0.45, keel + (sheer - keel) * depth**1.6],
            -1,
        )

    return patch(lambda u, v: outside(1 - u, v), 48, 60)


def _sail(half_width: float, drop: float) -> Mesh:
    def surface(u: Floats, v: Floats) -> Floats:
        belly = 0.11 * np.sin(np.pi * v) ** 0.8 * (1 - 0.5 * (2 * u - 1) ** 2)
        return np.stack([belly, (2 * u - 1) * half_width * (0.83 + 0.10 * v), -drop * (1 - v)], -1)

    return patch(surface, 24, 16)


def build() -> Model:
    b = Builder()
    water = patch(
        lambda u, v: np.stack(
            [
                v * 1.08 * np.cos(2 * np.pi * u),
                v * 1.08 * np.sin(2 * np.pi * u),
                WATER + _waves(v * 1.08 * np.cos(2 * np.pi * u), v * 1.08 * np.sin(2 * np.pi * u)),
            ],
            -1,
        ),
        160,
        60,
    )
    flipped = Mesh(water.points, water.normals * np.sign(water.normals[:, 2:3]), water.faces, water.local, water.local_normals)
    b.add(Material(_water, _water_c, specular=0.8, shininess=120, reflect=0.05), flipped, base_c=10)
    bowl = Material(
        lambda s: tx.mix(
            (0.20, 0.11, 0.05),
            (0.50, 0.32, 0.16),
            tx.bricks(tx.around_z(s.local, 1.1), 0.3, 0.09, 0.006, 3)[0] * (0.4 + 0.6 * tx.fbm(s.local, 0.05, 4, 2)),
        ),
        lambda s: s.base_c + 3 * np.sin(3 * np.arctan2(s.world[:, 1], s.world[:, 0])),
    )
    b.add(bowl, lathe([(0, -0.66), (1.02, -0.66), (1.13, -0.40), (1.13, -0.38), (1.08, -0.38), (1.075, -0.46)], 96), base_c=19)
    lift = (0.0, 0.0, -0.33)
    hull, deck = Material(_hull, _hull_c, 0.1), Material(_planks, _deck_c, 0.05)
    timber = Material(lambda s: tx.mix((0.28, 0.15, 0.07), (0.55, 0.36, 0.19), tx.wood(s.local[:, [2, 0, 1]], 0.02, 4)))
    b.add(hull, _shell().moved(lift), base_c=21)

    def planking(v0: float, v1: float, z: float) -> Mesh:
        def surface(u: Floats, v: Floats) -> Floats:
            w = v0 + v * (v1 - v0)
            x, width, _ = _hull_section(w)
            return np.stack([x, (0.5 - u) * 1.96 * width, np.full_like(x, z)], -1)

        return patch(lambda u, v: surface(1 - u, 1 - v), 14, 36).moved(lift)

    b.add(deck, planking(0.0, 0.26, 0.28), base_c=23)
    b.add(deck, planking(0.26, 0.985, 0.13), base_c=22)
    b.add(deck, box((0.01, 0.46, 0.15)).moved((-0.385, 0, lift[2] + 0.205)), base_c=24)
    b.add(
        Material(_windows, lambda s: s.base_c + 12 * tx.bump(s.local, (0, -0.08, 0), 0.08)),
        box((0.012, 0.30, 0.40)).moved((-0.80, 0, lift[2] + 0.12)),
        base_c=23,
    )
    v = np.linspace(0, 0.995, 40)
    x, width, sheer = _hull_section(v)
    for side in (-1, 1):
        rail = np.stack([x + 0.10 * np.clip(v - 0.8, 0, 1) * 4, side * width, sheer + 0.005], 1)
        b.add(timber, tube(rail + np.array(lift), 0.013, 8), base_c=22)
    # masts, yards and sails
    for mx, height in ((-0.30, 1.0), (0.28, 1.12)):
        b.add(timber, tube([(mx, 0, -0.3), (mx, 0, 0.35), (mx, 0, height - 0.12)], [0.030, 0.024, 0.010], 12), base_c=20)
        b.add(timber, cylinder(0.055, 0.05, 16).moved((mx, 0, 0.42)), base_c=24)
        for z, w, drop in ((0.30, 0.47, 0.34), (0.72, 0.34, 0.30)):
            top = z + (0.06 if mx > 0 else 0)
            b.add(
                timber,
                tube([(mx + 0.03, -w, top), (mx + 0.03, 0, top), (mx + 0.03, w, top)], [0.008, 0.016, 0.008], 8),
                base_c=20,
            )
            b.add(Material(_canvas, _canvas_c), _sail(w, drop).moved((mx + 0.04, 0, top - 0.015)), base_c=20 + 6 * (z > 0.5))
        # shrouds with ratlines
        for side in (-1, 1):
            feet = [(mx + dx, side * 0.25, -0.12) for dx in (-0.14, -0.05, 0.04)]
            head = (mx, side * 0.02, 0.45)
            b.add(timber, [rod(f, head, 0.005, 6) for f in feet], (0.2, 0.15, 0.1), 17)
            steps = []
            for k in np.linspace(0.06, 0.85, 9):
                p, q = (np.array(f) * (1 - k) + np.array(head) * k for f in (feet[0], feet[-1]))
                steps.append(rod(p, q, 0.0035, 6))
            b.add(timber, steps, (0.2, 0.15, 0.1), 17)
    # bowsprit, jib, stays, lanterns, flag
    b.add(timber, tube([(0.66, 0, -0.02), (1.02, 0, 0.16)], [0.022, 0.010], 10), base_c=19)
    b.add(
        timber,
        [
            rod((1.0, 0, 0.15), (0.28, 0, 0.98), 0.004, 6),
            rod((0.28, 0, 0.70), (-0.30, 0, 0.86), 0.004, 6),
            rod((-0.30, 0, 0.86), (-0.78, 0, 0.04), 0.004, 6),
        ],
        base_c=18,
    )
    jib = patch(
        lambda u, v: np.stack(
            [
                0.98 - 0.66 * u * (1 - 0.45 * v) - 0.0 * v - 0.36 * v * (1 - u) * 0.98,
                0.06 * np.sin(np.pi * u) * (1 - v),
                0.15 + 0.62 * v + 0.10 * u * (1 - v),
            ],
            -1,
        ),
        20,
        16,
    )
    b.add(Material(_canvas, _canvas_c), jib.baked(), base_c=22)
    lantern = Material(specular=0.5)
    for at in ((-0.82, -0.14, 0.10), (-0.82, 0.14, 0.10)):
        b.add(lantern, [sphere(0.032, 16).moved(at), rod((at[0], at[1], -0.05), at, 0.007, 6)], (0.95, 0.75, 0.30), 46)
    b.add(
        Material(lambda s: tx.mix((0.80, 0.12, 0.12), (0.95, 0.93, 0.90), tx.stripes(s.local[:, 2], 0.045))),
        patch(lambda u, v: np.stack([-0.22 * u, 0.02 * np.sin(9 * u), 0.12 * v], -1), 16, 6).moved((0.28, 0, 0.88)),
        base_c=18,
    )
    # deck load: hatch, barrels, a boat's worth of crates
    b.add(Material(_planks, _deck_c), box((0.20, 0.16, 0.04)).moved((0.06, 0, -0.18)), base_c=27)
    cask = lathe([(0, 0), (0.032, 0), (0.042, 0.045), (0.032, 0.09), (0, 0.09)], 16)
    b.add(
        timber,
        [cask.moved((px, py, -0.20)) for px, py in ((0.48, 0.08), (0.50, -0.06), (-0.14, 0.14), (-0.16, -0.13))],
        base_c=15,
    )
    return Model(tuple(b.parts), STUDIO, ambient_c=17, background_c=4, occlusion_m=0.5, centre=(0, 0, -0.06))


def _windows(s: Surface) -> Floats:
    uv = s.local[:, 1:]
    frame = np.maximum(tx.stripes(uv[:, 0], 0.075, 0.28), tx.stripes(uv[:, 1], 0.10, 0.25))
    return tx.mix((0.95, 0.80, 0.45), (0.35, 0.20, 0.09), frame)
