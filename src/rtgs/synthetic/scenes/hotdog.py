"""Two hot dogs on a plate: nearly flat, hot and cold food side by side."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, lathe, merged, patch, sphere, tube
from rtgs.synthetic.model import STUDIO, Builder, Floats, Material, Model, Surface


def _porcelain(s: Surface) -> Floats:
    p = s.world
    r, angle = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])
    colour = tx.mix((0.92, 0.92, 0.90), (0.84, 0.85, 0.85), tx.fbm(p, 0.06, 4, 2))
    blue = (0.12, 0.25, 0.55)
    wave = np.abs(r - 0.93 - 0.035 * np.sin(24 * angle)) < 0.012
    petal = np.hypot((angle * 24 / np.pi) % 2 - 1, (r - 0.93) / 0.03) < 0.42
    rings = (np.abs(r - 1.03) < 0.010) | (np.abs(r - 0.84) < 0.008) | (np.abs(r - 0.82) < 0.003)
    colour = tx.mix(colour, blue, (wave | petal | rings).astype(float))
    spray = (r < 0.76) * tx.dots(p[:, :2], 0.09, 9, 0.55, 0.05, 0.17)
    colour = tx.mix(colour, (0.30, 0.48, 0.34), spray)
    crumbs = (r < 0.75) * tx.dots(p[:, :2], 0.028, 12, 0.30, 0.08, 0.25)
    return tx.mix(colour, (0.63, 0.43, 0.22), crumbs)


def _porcelain_c(s: Surface) -> Floats:
    r = np.hypot(s.world[:, 0], s.world[:, 1])
    heated = 0.5 + 0.5 * np.sin(s.world[:, 0] * 14 + 1.0)  # the bars of the grill it stood on
    hand = tx.bump(s.world[:, :2], (0.86, -0.42), 0.10) + tx.bump(s.world[:, :2], (0.70, -0.66), 0.08)
    return s.base_c + 9 * np.exp(-((r / 0.6) ** 2)) + 4 * heated * np.exp(-((r / 0.7) ** 4)) + 6 * hand


def _crust(s: Surface) -> Floats:
    p = s.local
    colour = tx.ramp(tx.fbm(p, 0.18, 5, 4), [(0.55, 0.30, 0.10), (0.74, 0.46, 0.18), (0.85, 0.62, 0.32)])
    crumb = tx.ramp(tx.fbm(p, 0.035, 3, 6), [(0.80, 0.66, 0.42), (0.95, 0.87, 0.68)])
    colour = tx.mix(colour, crumb, np.clip((p[:, 2] - 0.03) / 0.05, 0, 1))
    return tx.mix(colour, (0.45, 0.24, 0.08), tx.dots(p, 0.05, 8, 0.35, 0.06, 0.2))


def _crust_c(s: Surface) -> Floats:
    toasted = 0.5 + 0.5 * np.tanh(4 * np.sin(s.local[:, 0] * 21))
    return s.base_c + 6 * toasted + 9 * np.clip(s.local[:, 2] / 0.1, 0, 1)


def _sausage(s: Surface) -> Floats:
    p = s.local
    colour = tx.ramp(tx.fbm(p, 0.07, 4, 3), [(0.42, 0.10, 0.05), (0.66, 0.20, 0.10), (0.78, 0.32, 0.17)])
    grill = (np.abs(((p[:, 2] + 0.5 * p[:, 0]) / 0.13) % 1 - 0.5) < 0.10) & (p[:, 1] * 0 + np.abs(p[:, 0]) < 0.2)
    colour = tx.mix(colour, (0.14, 0.05, 0.03), grill * tx.fbm(p, 0.03, 2, 9))
    return tx.mix(colour, (0.9, 0.55, 0.3), tx.dots(p, 0.03, 5, 0.25, 0.05, 0.18))


def _sausage_c(s: Surface) -> Floats:
    along = (s.local[:, 2] - 0.75) / 0.75
    return s.base_c + 11 * np.exp(-((along / 0.55) ** 2)) + 3 * (tx.noise(s.local, 0.22, 5) - 0.5)


def _bun(length: float) -> Mesh:
    """A trough: a rounded loaf with a channel along x."""

    def surface(u: Floats, v: Floats) -> Floats:
        a = 2 * np.pi * u  # around the section
        x = (v - 0.5) * 2
        end = np.sqrt(np.clip(1 - np.abs(x) ** 3.5, 0, 1))
        y, z = 0.235 * np.cos(a), 0.135 * np.sin(a)
        z = z - 0.13 * np.exp(-((y / 0.095) ** 2)) * (np.sin(a) > 0) * np.sin(a)
        return np.stack([0.5 * length * x, end * y, end * z], axis=-1)

    return patch(surface, 64, 60)


def build() -> Model:
    b = Builder()
    plate = [
        (0, -0.10),
        (0.55, -0.10),
        (0.62, -0.08),
        (1.06, 0.055),
        (1.08, 0.07),
        (1.055, 0.078),
        (0.74, -0.022),
        (0.66, -0.045),
        (0, -0.05),
    ]
    b.add(Material(_porcelain, _porcelain_c, specular=0.35, shininess=90), lathe(plate, 96, step_m=0.05), base_c=22)
    crust, meat = Material(_crust, _crust_c), Material(_sausage, _sausage_c, specular=0.45, shininess=35)
    for side, hot in ((-1, 44.0), (1, 36.0)):
        at, turn = (0.02 * side, 0.30 * side, 0.06), (0, 0, 12 + 5 * side)
        bun = _bun(1.24).moved((0, 0, 0.02))
        b.add(crust, bun.moved(at, turn), base_c=26 if side < 0 else 24)
        t = np.linspace(-1, 1, 41)
        ends = np.sqrt(np.clip(1 - np.abs(t) ** 10, 0, 1))
        ends[[0, -1]] = 0.12
        path = np.stack([0.73 * t, 0.02 * np.sin(2 * t), 0.105 - 0.015 * np.cos(np.pi * t)], 1)
        b.add(meat, tube(path, 0.098 * ends, 24, 0.03).moved(at, turn), base_c=hot)
        k = np.linspace(-0.92, 0.92, 140)
        squiggle = np.stack([0.62 * k, 0.052 * np.sin(k * 26), 0.192 + 0.004 * np.cos(k * 26) + 0.012 * np.cos(52 * k)], 1)
        sauce = (0.90, 0.68, 0.08) if side < 0 else (0.72, 0.07, 0.05)
        b.add(Material(specular=0.6, shininess=60), tube(squiggle, 0.021, 8, 0.02).moved(at, turn), sauce, 14 if side < 0 else 12)
        rng = np.random.default_rng(5 + side)
        seeds = []
        for _ in range(60):
            a, x = rng.uniform(-0.35, 0.9), rng.uniform(-0.5, 0.5)
            flank = rng.choice((-1, 1))
            y, z = flank * 0.235 * np.cos(a * 0.8), 0.135 * np.sin(a * 0.8)
            seeds.append(sphere(0.012, 8).stretched((1.5, 1, 0.7)).moved((x, y * 0.99, z + 0.02), (0, 0, rng.uniform(0, 180))))
        b.add(Material(), merged(seeds).moved(at, turn), (0.95, 0.88, 0.66), 24)
    # salad, onion and gherkin slices beside them
    rng = np.random.default_rng(11)
    for i in range(9):
        a = rng.uniform(0, 2 * np.pi)
        c = (0.62 * np.cos(a), 0.66 * np.sin(a), 0.0)
        if abs(c[1]) < 0.5:
            c = (c[0], 0.56 * np.sign(c[1]) + 0.05 * rng.standard_normal(), 0.0)
        slice_ = lathe([(0, -0.018), (0.075, -0.018), (0.08, 0), (0.075, 0.018), (0, 0.018)], 24)
        b.add(
            _GHERKIN,
            slice_.moved((c[0], c[1], -0.015 + 0.004 * i), (rng.uniform(-6, 6), rng.uniform(-6, 6), 0)),
            base_c=8 + i % 3,
        )
    return Model(tuple(b.parts), STUDIO, ambient_c=21, background_c=5, occlusion_m=0.5)


def _gherkin(s: Surface) -> Floats:
    r, a = np.hypot(s.local[:, 0], s.local[:, 1]), np.arctan2(s.local[:, 1], s.local[:, 0])
    colour = tx.mix((0.55, 0.66, 0.25), (0.75, 0.80, 0.42), tx.fbm(s.local, 0.03, 3, 3))
    seeds = (np.abs(r - 0.035) < 0.011) & ((a * 5 / np.pi) % 1 < 0.45)
    colour = tx.mix(colour, (0.92, 0.90, 0.65), seeds.astype(float))
    return tx.mix(colour, (0.13, 0.28, 0.09), (r > 0.068).astype(float))


_GHERKIN = Material(_gherkin, specular=0.4, shininess=50)
