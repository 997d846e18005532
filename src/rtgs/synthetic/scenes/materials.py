"""Twelve spheres of different finish on a tiled board; how warm each is has nothing to do with how it looks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import box, lathe, sphere
from rtgs.synthetic.model import STUDIO, Builder, Floats, Material, Model, Surface


def _marble(s: Surface) -> Floats:
    vein = np.abs(tx.fbm(s.local, 0.22, 5, 4) - 0.5)
    return tx.ramp(np.clip(vein * 5, 0, 1), [(0.18, 0.20, 0.25), (0.70, 0.70, 0.72), (0.93, 0.92, 0.90)])


def _rust(s: Surface) -> Floats:
    return tx.ramp(tx.fbm(s.local, 0.12, 5, 9), [(0.22, 0.10, 0.06), (0.60, 0.28, 0.10), (0.78, 0.50, 0.25), (0.45, 0.47, 0.50)])


def _wood(s: Surface) -> Floats:
    return tx.mix((0.33, 0.17, 0.07), (0.78, 0.55, 0.31), tx.wood(s.local, 0.035, 2))


def _checks(s: Surface) -> Floats:
    lon, lat = np.arctan2(s.local[:, 1], s.local[:, 0]), np.arcsin(np.clip(s.local[:, 2] / 0.24, -1, 1))
    return tx.mix((0.90, 0.88, 0.82), (0.65, 0.10, 0.13), tx.checker(np.column_stack([lon, lat]), np.pi / 8))


def _globe(s: Surface) -> Floats:
    land = tx.fbm(s.local, 0.26, 6, 15)
    return tx.ramp(
        land,
        [(0.05, 0.15, 0.40), (0.10, 0.30, 0.60), (0.15, 0.40, 0.65), (0.30, 0.50, 0.22), (0.60, 0.55, 0.35), (0.95, 0.95, 0.95)],
    )


def _terrazzo(s: Surface) -> Floats:
    chip = tx.dots(s.local, 0.05, 3, 0.95, 0.2, 0.48)
    hue = tx.cell_noise(np.floor(s.local / 0.05).astype(np.int64), 31)
    return tx.mix(
        (0.82, 0.80, 0.76), tx.ramp(hue, [(0.15, 0.15, 0.18), (0.70, 0.30, 0.22), (0.25, 0.45, 0.48), (0.90, 0.70, 0.35)]), chip
    )


def _stripes(s: Surface) -> Floats:
    lon = np.arctan2(s.local[:, 1], s.local[:, 0]) + 4 * s.local[:, 2]
    return tx.mix((0.95, 0.80, 0.15), (0.12, 0.12, 0.14), tx.stripes(lon, np.pi / 6))


def _newsprint(s: Surface) -> Floats:
    uv = tx.around_z(s.local, 0.24)
    return tx.mix((0.90, 0.88, 0.80), (0.10, 0.10, 0.12), tx.print_marks(uv, 0.03, 3))


def _ball_c(s: Surface) -> Floats:
    seed = int(s.part[0])
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    pole = s.local @ axis / 0.24
    pattern = (pole**3, np.tanh(6 * np.sin(5 * pole)), 2 * tx.noise(s.local, 0.2, seed) - 1)[seed % 3]
    return s.base_c + 4.5 * pattern + 3 * pole


def _tile(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    on, which = tx.bricks(uv, 0.14, 0.14, 0.008, 6)
    colour = tx.ramp(which, [(0.32, 0.36, 0.40), (0.52, 0.55, 0.56), (0.75, 0.74, 0.70), (0.38, 0.46, 0.52)])
    colour = colour * (0.75 + 0.35 * tx.fbm(s.local, 0.05, 4, 5)[:, None])
    return tx.mix((0.15, 0.15, 0.16), tx.mix(colour, (0.92, 0.92, 0.88), tx.dots(uv, 0.035, 4, 0.3, 0.05, 0.2)), on)


def _board_c(s: Surface) -> Floats:
    cable = np.abs(s.world[:, 1] - 0.22 * np.sin(4 * s.world[:, 0]) - 0.1)  # a heating wire under the tiles
    return s.base_c + 9 * np.exp(-((cable / 0.06) ** 2)) + 3 * s.world[:, 0]


def build() -> Model:
    b = Builder()
    looks: list[tuple[Callable[[Surface], Floats], float, float, float]] = [
        (_marble, 0.5, 120, 0.08),
        (_rust, 0.1, 20, 0.0),
        (_checks, 0.6, 150, 0.06),
        (_wood, 0.3, 60, 0.02),
        (_globe, 0.6, 90, 0.05),
        (_terrazzo, 0.4, 100, 0.05),
        (_stripes, 0.7, 200, 0.06),
        (_newsprint, 0.0, 20, 0.0),
        (lambda s: tx.mix((0.85, 0.62, 0.25), (0.65, 0.42, 0.15), tx.fbm(s.local, 0.04, 3, 2)), 1.0, 90, 0.22),
        (lambda s: tx.mix((0.55, 0.57, 0.60), (0.35, 0.37, 0.40), tx.stripes(tx.noise(s.local, 0.09, 3), 0.13)), 1.0, 140, 0.30),
        (lambda s: tx.mix((0.10, 0.35, 0.20), (0.40, 0.70, 0.30), tx.fbm(s.local, 0.07, 4, 1)), 0.5, 60, 0.03),
        (lambda s: tx.mix((0.40, 0.12, 0.45), (0.92, 0.85, 0.90), tx.dots(s.local, 0.07, 5, 0.85)), 0.6, 100, 0.05),
    ]
    warm = [18, 41, 27, 33, 46, 22, 30, 15, 37, 25, 43, 20]
    holder = Material(lambda s: tx.mix((0.12, 0.12, 0.13), (0.30, 0.30, 0.32), tx.stripes(s.local[:, 2], 0.02)), specular=0.4)
    for k, ((albedo, specular, shininess, reflect), base_c) in enumerate(zip(looks, warm, strict=True)):
        x, y = (k % 4 - 1.5) * 0.515, (k // 4 - 1) * 0.515
        b.add(
            Material(albedo, _ball_c, specular, shininess, reflect),
            sphere(0.24, 56).moved((x, y, 0.12), (k * 25.0, 40.0 - 9 * k, k * 31.0)),
            base_c=base_c,
        )
        b.add(holder, lathe([(0.14, -0.17), (0.12, -0.10), (0.135, -0.07), (0.115, -0.06)], 32).moved((x, y, 0)), base_c=21)
    b.add(Material(_tile, _board_c, specular=0.2, shininess=50), box((2.04, 1.52, 0.07)).moved((0, 0, -0.205)), base_c=17)
    return Model(tuple(b.parts), STUDIO, ambient_c=20, background_c=6, occlusion_m=0.5, centre=(0, 0, 0.0))
