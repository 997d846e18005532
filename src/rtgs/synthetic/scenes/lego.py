"""A bulldozer built from toy bricks: studs, holes, repeated small parts."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, box, cylinder, lathe, merged, patch, plate_with_hole, rod
from rtgs.synthetic.model import STUDIO, Builder, Colour, Floats, Material, Model, Surface

UNIT = 0.1  # stud spacing
BRICK = 0.12  # brick height
PLATE = 0.04

YELLOW, BLACK, GREY, DARK, RED, TAN = (
    (0.93, 0.69, 0.08),
    (0.10, 0.10, 0.11),
    (0.62, 0.64, 0.66),
    (0.32, 0.33, 0.35),
    (0.75, 0.10, 0.08),
    (0.80, 0.70, 0.48),
)


def _plastic(s: Surface) -> Floats:
    """Moulded colour, worn and dusty, with a maker's mark on every stud."""
    worn = tx.fbm(s.world, 0.07, 4, 3)
    colour = s.colour * (0.78 + 0.34 * worn)[:, None]
    scratch = tx.noise(s.world * np.array([1.0, 9.0, 5.0]), 0.05, 8)
    colour = tx.mix(colour, np.clip(s.colour * 1.25 + 0.12, 0, 1), (scratch > 0.80).astype(float))
    return tx.mix(colour, s.colour * 0.45, tx.dots(s.world, 0.035, 4, 0.25, 0.05, 0.18))


def _hazard(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    colour = tx.mix(YELLOW, BLACK, tx.stripes(uv[:, 0] + uv[:, 1], 0.16))
    return colour * (0.7 + 0.4 * tx.fbm(s.world, 0.05, 4, 6))[:, None]


def _sticker(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    colour = tx.mix((0.93, 0.92, 0.88), (0.10, 0.12, 0.35), tx.print_marks(uv + 0.5, 0.045, 13))
    return tx.mix(colour, RED, (np.abs(uv[:, 1]) < 0.008).astype(float))


def _ground(s: Surface) -> Floats:
    colour = tx.ramp(tx.fbm(s.world, 0.3, 5, 2), [(0.42, 0.32, 0.20), (0.62, 0.50, 0.33), (0.74, 0.64, 0.46)])
    return tx.mix(colour, (0.28, 0.24, 0.20), tx.dots(s.world[:, :2], 0.05, 5, 0.5, 0.08, 0.3))


def _body_c(s: Surface) -> Floats:
    """Warm round the engine, colder towards the ends; the sun has stood on one side."""
    engine = tx.bump(s.world, (0.12, 0.0, 0.05), (0.30, 0.22, 0.22))
    spots = tx.bump(s.world, (0.2, 0.26, 0.0), 0.07) + tx.bump(s.world, (0.0, -0.26, 0.03), 0.06)
    return s.base_c + 16 * engine + 9 * spots + 3 * np.clip(s.normal @ np.array([0.3, -0.8, 0.5]), 0, 1)


def _track_c(s: Surface) -> Floats:
    return s.base_c + 8 * np.exp(-(((s.world[:, 2] + 0.50) / 0.07) ** 2)) + 3 * np.sin(4 * s.world[:, 0])


def _ground_c(s: Surface) -> Floats:
    rut = np.exp(-(((np.abs(s.world[:, 1]) - 0.42) / 0.10) ** 2)) * np.clip(
        0.4 - s.world[:, 0], 0, 1
    )  # warm trail behind the tracks
    return s.base_c + 6 * rut + 4 * (tx.noise(s.world, 0.6, 7) - 0.5)


def _hot(s: Surface) -> Floats:
    return s.base_c + 10 * np.clip(s.local[:, 2] / 0.4, 0, 1)


def _brick(nx: int, ny: int, height: float = BRICK, studs: bool = True) -> Mesh:
    """Lower corner at the origin; a hairline gap to its neighbours."""
    gap = 0.004
    parts = [box((nx * UNIT - gap, ny * UNIT - gap, height - gap)).moved((nx * UNIT / 2, ny * UNIT / 2, height / 2))]
    if studs:
        stud = lathe([(0.03, 0), (0.03, 0.022), (0, 0.022)], 12)
        parts += [stud.moved(((i + 0.5) * UNIT, (j + 0.5) * UNIT, height - gap)) for i in range(nx) for j in range(ny)]
    return merged(parts)


def build() -> Model:
    b = Builder()
    plastic = Material(_plastic, _body_c, specular=0.35, shininess=70)
    rubber = Material(_plastic, _track_c, specular=0.1)
    hazard, sticker = Material(_hazard, _body_c, specular=0.3, shininess=60), Material(_sticker, _body_c, specular=0.2)

    def brick(
        at: tuple[float, float, float],
        nx: int,
        ny: int,
        colour: Colour,
        height: float = BRICK,
        studs: bool = True,
        base_c: float = 22,
    ) -> None:
        b.add(plastic, _brick(nx, ny, height, studs).moved(at), colour, base_c)

    # base plate with studs, as a piece of ground
    b.add(Material(_ground, _ground_c), _brick(19, 14, PLATE).moved((-0.95, -0.70, -0.80)), base_c=15)
    # tracks: links round two wheels a side
    for side in (-1, 1):
        y = 0.43 * side
        r, half, z = 0.20, 0.52, -0.53
        length = 4 * half + 2 * np.pi * r
        links = []
        for k in range(36):
            d = k / 36 * length
            if d < 2 * half:
                x, h, a = -half + d, r, 0.0
            elif d < 2 * half + np.pi * r:
                a = (d - 2 * half) / r
                x, h = half + r * np.sin(a), r * np.cos(a)
            elif d < 4 * half + np.pi * r:
                x, h, a = half - (d - 2 * half - np.pi * r), -r, np.pi
            else:
                a = np.pi + (d - 4 * half - np.pi * r) / r
                x, h = -half + r * np.sin(a), r * np.cos(a)
            link = merged([box((0.068, 0.26, 0.035)), box((0.02, 0.26, 0.03), (0, 0, 0.03))])
            links.append(link.moved((0, 0, 0), (0, np.degrees(a), 0)).moved((x, y, z + h)))
        b.add(rubber, links, BLACK, 25)
        for x in (-half, half):
            wheel = [lathe([(0.05, -0.09), (0.165, -0.09), (0.165, 0.09), (0.05, 0.09), (0.05, -0.09)], 28)]
            wheel += [
                cylinder(0.022, 0.2, 10).moved((0.11 * np.cos(t), 0.11 * np.sin(t), -0.1)) for t in np.arange(6) * np.pi / 3
            ]
            b.add(plastic, merged(wheel).moved((x, y, z), (90, 0, 0)), GREY if x < 0 else YELLOW, 24)
        for x in (-0.26, 0.0, 0.26):
            b.add(
                plastic,
                lathe([(0, -0.08), (0.085, -0.08), (0.085, 0.08), (0, 0.08)], 20).moved((x, y, z - 0.07), (90, 0, 0)),
                DARK,
                24,
            )
        b.add(plastic, box((1.0, 0.06, 0.07)).moved((0, 0.43 * side - 0.13 * side, z + 0.02)), DARK, 23)
    # chassis
    brick((-0.6, -0.3, -0.52), 12, 6, DARK, PLATE, False)
    brick((-0.6, -0.3, -0.48), 6, 6, DARK)
    brick((0.0, -0.3, -0.48), 6, 6, DARK)
    for row in range(2):
        for k in range(3):
            brick((-0.6 + 0.4 * k, -0.3, -0.36 + row * BRICK), 4, 3, YELLOW)
            brick((-0.6 + 0.4 * k, 0.0, -0.36 + row * BRICK), 4, 3, YELLOW if (k + row) % 2 else (0.88, 0.62, 0.06))
    # bonnet with grille and exhaust
    brick((0.0, -0.2, -0.12), 3, 4, YELLOW)
    brick((0.3, -0.2, -0.12), 3, 4, YELLOW)
    brick((0.0, -0.2, 0.0), 6, 2, YELLOW)
    brick((0.0, 0.0, 0.0), 6, 2, YELLOW)
    brick((0.0, -0.2, 0.12), 4, 4, GREY, PLATE)
    b.add(plastic, [box((0.02, 0.36, 0.018)).moved((0.605, 0, z)) for z in np.linspace(-0.10, 0.10, 7)], BLACK, 34)
    exhaust = Material(_plastic, _hot, specular=0.3)
    for y in (-0.1, 0.1):
        b.add(
            exhaust,
            lathe(
                [
                    (0, 0),
                    (0.05, 0),
                    (0.05, 0.05),
                    (0.032, 0.06),
                    (0.032, 0.34),
                    (0.045, 0.35),
                    (0.045, 0.42),
                    (0.03, 0.42),
                    (0.03, 0.3),
                ],
                18,
            ).moved((0.42, y, 0.12)),
            DARK,
            44,
        )
    # sides: stickers and technic beams with holes
    for side in (-1, 1):
        b.add(sticker, box((0.44, 0.012, 0.16)).moved((0.28, 0.206 * side, -0.0)), base_c=24)
        beam = [plate_with_hole(UNIT, 0.028, 0.09).moved((k * UNIT, 0, 0)) for k in range(9)]
        b.add(plastic, merged(beam).moved((-0.22, 0.355 * side, -0.29), (90, 0, 0)), RED, 22)
        arm = [plate_with_hole(UNIT, 0.030, 0.08).moved((k * UNIT, 0, 0)) for k in range(9)]
        b.add(plastic, merged(arm).moved((0, 0, 0), (90, 0, 0)).moved((0.16, 0.60 * side, -0.44), (0, 8, 0)), YELLOW, 20)
        b.add(plastic, rod((0.1, 0.60 * side, -0.44), (0.1, 0.30 * side, -0.44), 0.03, 12), GREY, 21)
        b.add(plastic, tube_ram(side), GREY, 30)
    # cab: posts, seat, roof
    for x in (-0.55, -0.05):
        for y in (-0.25, 0.25):
            b.add(plastic, box((0.06, 0.06, 0.54)).moved((x, y, 0.15)), YELLOW, 21)
    brick((-0.6, -0.3, 0.42), 6, 6, YELLOW, PLATE)
    brick((-0.5, -0.2, 0.46), 4, 4, (0.88, 0.62, 0.06), PLATE)
    b.add(
        Material(specular=0.6),
        lathe([(0, 0), (0.04, 0), (0.045, 0.06), (0.02, 0.09), (0, 0.095)], 16).moved((-0.3, 0.0, 0.52)),
        (0.95, 0.45, 0.05),
        33,
    )
    brick((-0.42, -0.1, -0.12), 2, 2, RED)
    b.add(plastic, box((0.05, 0.22, 0.26)).moved((-0.44, 0, 0.10), (0, -8, 0)), RED, 31)
    brick((-0.6, -0.3, -0.12), 1, 6, YELLOW, 2 * BRICK, False)
    b.add(plastic, rod((-0.08, 0, -0.1), (-0.16, 0, 0.1), 0.014), DARK, 22)
    b.add(plastic, lathe([(0.05, 0), (0.065, 0), (0.065, 0.02), (0.05, 0.02)], 20).moved((-0.16, 0, 0.1), (0, -22, 0)), BLACK, 27)
    # ripper at the back
    for y in (-0.2, 0.0, 0.2):
        b.add(
            plastic,
            merged(
                [box((0.2, 0.05, 0.06)).moved((-0.70, y, -0.34)), box((0.05, 0.05, 0.30)).moved((-0.80, y, -0.46), (0, 14, 0))]
            ),
            GREY,
            17,
        )

    # blade: a curved wall of grooved slats, hazard stripes on its top
    def blade(u: Floats, v: Floats) -> Floats:
        bend = np.pi * 0.42 * (v - 0.5)
        return np.stack([0.28 - 0.42 * np.cos(bend) + 0.008 * np.cos(v * 60), (u - 0.5) * 1.36, 0.42 * np.sin(bend) / 0.62], -1)

    b.add(
        plastic,
        merged(
            [
                patch(blade, 36, 40).moved((1.0, 0, -0.44)),
                patch(lambda u, v: blade(1 - u, v) - np.array([0.03, 0, 0]), 36, 40).moved((1.0, 0, -0.44)),
            ]
        ),
        YELLOW,
        16,
    )
    b.add(hazard, box((0.06, 1.36, 0.10)).moved((0.97, 0, -0.03)), base_c=16)
    b.add(plastic, box((0.05, 1.38, 0.05)).moved((1.0, 0, -0.74)), GREY, 14)
    return Model(tuple(b.parts), STUDIO, ambient_c=17, background_c=5, occlusion_m=0.5, centre=(0, 0, -0.25))


def tube_ram(side: int) -> Mesh:
    """Hydraulic ram from bonnet to blade."""
    return merged(
        [
            rod((0.45, 0.34 * side, -0.10), (0.70, 0.34 * side, -0.22), 0.035, 12),
            rod((0.70, 0.34 * side, -0.22), (0.92, 0.34 * side, -0.32), 0.018, 10),
        ]
    )
