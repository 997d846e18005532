"""A drum kit: five drums, three cymbals, a hi-hat and a stool, on thin stands."""

from __future__ import annotations

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, box, cylinder, lathe, merged, rod, torus
from rtgs.synthetic.model import STUDIO, Builder, Floats, Material, Model, Surface

Point = tuple[float, float, float]


def _wrap(s: Surface) -> Floats:
    uv = tx.around_z(s.local, 0.3)
    sparkle = tx.dots(s.local, 0.014, 3, 0.9, 0.15, 0.45)
    colour = tx.mix(s.colour * 0.65, np.clip(s.colour * 1.5 + 0.15, 0, 1), sparkle)
    swirl = tx.fbm(np.column_stack([uv * [1.0, 2.5], s.local[:, 2]]), 0.12, 3, 8)
    colour = tx.mix(colour, (0.95, 0.93, 0.88), ((swirl > 0.52) & (swirl < 0.60)).astype(float))
    return tx.mix(colour, (0.05, 0.05, 0.06), ((uv[:, 0] / 0.3 * 8 / np.pi) % 2 < 0.09).astype(float))


def _head(s: Surface) -> Floats:
    p = s.local
    r = np.hypot(p[:, 0], p[:, 1])
    colour = tx.mix((0.93, 0.92, 0.88), (0.70, 0.68, 0.62), tx.fbm(p, 0.05, 4, s.part[0] % 7))
    colour = tx.mix(colour, (0.45, 0.43, 0.40), tx.dots(p[:, :2], 0.03, int(s.part[0]), 0.3, 0.05, 0.16))
    band = (np.abs(p[:, 1] + 0.02) < 0.06) & (r < 0.17)
    return tx.mix(colour, (0.12, 0.12, 0.30), band * tx.print_marks(p[:, :2] + 0.02, 0.04, int(s.part[0])))


def _front(s: Surface) -> Floats:
    p = s.local
    r, angle = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])
    colour = tx.mix((0.08, 0.08, 0.10), (0.16, 0.15, 0.18), tx.fbm(p, 0.03, 3, 2))
    colour = tx.mix(colour, (0.95, 0.78, 0.20), (r < 0.33 + 0.035 * np.cos(16 * angle)) & (r > 0.255))
    colour = tx.mix(colour, (0.90, 0.88, 0.82), (r < 0.235).astype(float))
    colour = tx.mix(colour, (0.75, 0.10, 0.12), (r < 0.22) * tx.print_marks(p[:, :2] + 0.3, 0.085, 21))
    return tx.mix(colour, (0.95, 0.95, 0.95), (r > 0.36) * tx.dots(p[:, :2], 0.05, 4, 0.5))


def _bronze(s: Surface) -> Floats:
    r = np.hypot(s.local[:, 0], s.local[:, 1])
    angle = np.arctan2(s.local[:, 1], s.local[:, 0])
    groove = 0.5 + 0.5 * np.sin(r * 420 + 2 * tx.noise(s.local, 0.06, 3))
    colour = tx.mix((0.60, 0.42, 0.13), (0.93, 0.76, 0.36), 0.5 * groove + 0.5 * tx.fbm(s.local, 0.05, 3, int(s.part[0])))
    colour = tx.mix(colour, (0.25, 0.16, 0.06), tx.dots(s.local[:, :2], 0.04, 6, 0.3, 0.06, 0.2))
    label = (np.abs(angle - 1.2) < 0.5) & (r > 0.14) & (r < 0.22)
    return tx.mix(colour, (0.1, 0.07, 0.04), label * tx.print_marks(np.column_stack([angle * 0.2, r]), 0.028, 5))


def _head_c(s: Surface) -> Floats:
    p = s.local
    hit = tx.bump(p[:, :2], (0.05, -0.03), 0.07) + 0.6 * tx.bump(p[:, :2], (-0.06, 0.05), 0.05)
    return s.base_c + 9 * np.minimum(hit, 1.2)


def _shell_c(s: Surface) -> Floats:
    lamp = np.clip(s.normal @ np.array([0.5, -0.7, 0.5]), 0, 1)
    return s.base_c + 5 * lamp + 4 * (tx.noise(s.world, 0.5, 4) - 0.5)


def _cymbal_c(s: Surface) -> Floats:
    r = np.hypot(s.local[:, 0], s.local[:, 1])
    tip = np.clip((r - 0.05) / 0.3, 0, 1) ** 2
    return s.base_c + 6 * tip * (0.5 + 0.5 * np.cos(np.arctan2(s.local[:, 1], s.local[:, 0]) - 2.0))


def _stool_c(s: Surface) -> Floats:
    return s.base_c + 14 * np.minimum(tx.bump(s.local[:, :2], (-0.07, 0), 0.07) + tx.bump(s.local[:, :2], (0.07, 0), 0.07), 1)


def _stand_c(s: Surface) -> Floats:
    return s.base_c - 4 * np.clip(-s.world[:, 2], 0, 1)


def _cymbal(radius: float) -> Mesh:
    r = np.linspace(0.012, radius, 14)
    z = 0.05 * np.exp(-((r / (0.24 * radius)) ** 2)) - 0.05 * (r / radius) ** 2
    bottom = np.stack([r, z - 0.004], 1)[1:]
    top = np.stack([r, z + 0.004], 1)[::-1]
    return merged([lathe(bottom, 48, smooth=True), lathe(top, 48, smooth=True)])


def build() -> Model:
    b = Builder()
    chrome = Material(temperature_c=_stand_c, specular=0.9, shininess=120, reflect=0.25)
    wrap, head = Material(_wrap, _shell_c, specular=0.3, shininess=60), Material(_head, _head_c)
    front = Material(_front, _head_c)
    bronze = Material(_bronze, _cymbal_c, specular=0.6, shininess=50, reflect=0.08)
    steel = (0.62, 0.63, 0.66)

    def drum(radius: float, height: float, at: Point, turn: Point, base_c: float, lugs: int, face: Material = head) -> None:
        shell = lathe([(radius, 0), (radius, height)], 48)
        b.add(wrap, shell.moved(at, turn), (0.72, 0.08, 0.10), base_c)
        top = lathe([(radius, height - 0.01), (0, height - 0.01)], 48)
        b.add(face, top.moved(at, turn), base_c=base_c + 3)
        b.add(head, lathe([(0, 0.01), (radius, 0.01)], 48).moved(at, turn), base_c=base_c)
        b.add(
            chrome,
            [torus(radius + 0.004, 0.014, 48, 8).moved((0, 0, z)).moved(at, turn) for z in (0.005, height - 0.005)],
            steel,
            18,
        )
        hardware = []
        for a in np.arange(lugs) * 2 * np.pi / lugs:
            x, y = (radius + 0.018) * np.cos(a), (radius + 0.018) * np.sin(a)
            hardware.append(rod((x, y, 0), (x, y, height), 0.006, 6))
            hardware += [cylinder(0.016, 0.05, 8).moved((x, y, z)) for z in (0.25 * height, 0.75 * height - 0.05)]
        b.add(chrome, merged(hardware).moved(at, turn), steel, 18)

    def tripod(x: float, y: float, top: float, foot: float = 0.2) -> None:
        z0 = -0.80
        rods = [rod((x, y, z0 + 0.05), (x, y, top), 0.013, 8), rod((x, y, z0 + 0.1), (x, y, 0.5 * (z0 + top)), 0.02, 8)]
        for a in (0.4, 2.5, 4.6):
            end = (x + foot * np.cos(a), y + foot * np.sin(a), z0)
            rods += [
                rod((x, y, z0 + 0.26), end, 0.010, 8),
                rod((x, y, z0 + 0.07), np.array(end) * 0.5 + np.array([x, y, z0 + 0.26]) * 0.5, 0.006, 6),
            ]
        b.add(chrome, rods, steel, 20)

    # kit faces −y; the bass drum lies on its side
    drum(0.42, 0.42, (0, 0.0, -0.38), (90, 0, 0), 21, 10, front)
    drum(0.22, 0.24, (-0.27, -0.08, 0.20), (18, 8, 0), 24, 6)
    drum(0.24, 0.26, (0.27, -0.08, 0.19), (18, -8, 0), 23, 6)
    drum(0.29, 0.42, (0.70, 0.36, -0.56), (0, 0, 0), 20, 8)
    drum(0.25, 0.17, (-0.55, 0.44, -0.22), (8, 6, 0), 27, 8)
    b.add(chrome, [rod((0.06 * k, -0.18, 0.0), (0.22 * k, -0.06, 0.26), 0.015, 8) for k in (-1, 1)], steel, 20)
    b.add(chrome, [rod((k * 0.38, -0.3, -0.5), (k * 0.55, -0.42, -0.8), 0.012, 8) for k in (-1, 1)], steel, 20)
    b.add(
        chrome,
        [
            rod(
                (0.70 + 0.31 * np.cos(a), 0.36 + 0.31 * np.sin(a), -0.35),
                (0.70 + 0.31 * np.cos(a), 0.36 + 0.31 * np.sin(a), -0.8),
                0.011,
                8,
            )
            for a in (0.5, 2.6, 4.7)
        ],
        steel,
        20,
    )
    tripod(-0.55, 0.44, -0.22, 0.22)
    for x, y, z, radius, turn in (
        (-0.70, -0.08, 0.50, 0.29, (14, 16, 0)),
        (0.62, -0.10, 0.56, 0.31, (12, -18, 0)),
        (0.86, 0.44, 0.42, 0.24, (0, -20, 0)),
    ):
        tripod(x, y, z + 0.06, 0.22)
        b.add(bronze, _cymbal(radius).moved((x, y, z), turn), base_c=16)
        b.add(Material(), cylinder(0.03, 0.03, 12).moved((x, y, z + 0.04)), (0.1, 0.1, 0.1), 19)
    tripod(-0.92, 0.34, 0.20)
    b.add(
        bronze,
        [_cymbal(0.21).moved((-0.92, 0.34, 0.06)), _cymbal(0.21).moved((0, 0, 0), (180, 0, 0)).moved((-0.92, 0.34, 0.0))],
        base_c=17,
    )
    # stool
    leather = Material(
        lambda s: tx.mix(
            (0.07, 0.07, 0.08), (0.24, 0.22, 0.22), tx.fbm(s.local, 0.03, 4, 6) * (1 - tx.stripes(s.local[:, 0], 0.08, 0.08))
        ),
        _stool_c,
        0.2,
    )
    b.add(
        leather,
        lathe([(0, -0.06), (0.2, -0.06), (0.215, -0.03), (0.215, 0.02), (0.19, 0.05), (0, 0.055)], 36).moved((0.02, 0.80, -0.28)),
        base_c=24,
    )
    tripod(0.02, 0.80, -0.3, 0.22)
    # a rug under the kit
    rug = Material(
        _rug, lambda s: s.base_c + 7 * tx.bump(s.world[:, :2], (0.02, 0.62), (0.16, 0.1)) + 3 * (tx.noise(s.world, 0.45, 2) - 0.5)
    )
    b.add(rug, lathe([(0, -0.01), (1.1, -0.01), (1.1, 0.01), (0, 0.01)], 96).moved((0.02, 0.22, -0.815)), base_c=16)
    b.add(
        Material(temperature_c=lambda s: s.base_c + 8 * tx.bump(s.world, (0.03, 0.3, -0.75), 0.1)),
        box((0.09, 0.28, 0.02)).moved((0.03, 0.3, -0.74), (-14, 0, 0)),
        (0.25, 0.25, 0.28),
        20,
    )
    return Model(tuple(b.parts), STUDIO, ambient_c=18, background_c=7, centre=(0.02, 0.22, -0.18))


def _rug(s: Surface) -> Floats:
    x, y = s.local[:, 0], s.local[:, 1]
    edge = np.hypot(x, y) / 1.1
    colour = tx.mix((0.38, 0.10, 0.12), (0.50, 0.16, 0.14), tx.noise(s.local, 0.015, 3))
    diamond = (np.abs((x / 0.24) % 1 - 0.5) + np.abs((y / 0.24) % 1 - 0.5)) % 0.34 < 0.12
    colour = tx.mix(colour, (0.83, 0.70, 0.45), diamond * (edge < 0.84))
    colour = tx.mix(colour, (0.12, 0.16, 0.33), ((edge > 0.86) & (edge < 0.95)).astype(float))
    return tx.mix(colour, (0.9, 0.85, 0.7), (edge > 0.87) * (edge < 0.94) * tx.dots(s.local[:, :2], 0.06, 4, 0.8))
