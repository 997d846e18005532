"""A lived-in room, 5 × 4 × 2.7 m, seen from inside; a hot pipe runs unseen behind the plaster."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from rtgs.synthetic import textures as tx
from rtgs.synthetic.meshes import Mesh, box, cylinder, lathe, merged, patch, quad, rod, sphere, torus, tube
from rtgs.synthetic.model import Builder, Floats, Light, Material, Model, Surface

X, Y, Z = 2.5, 2.0, 2.7  # half length, half width, height; the floor is z = 0
STEP = 0.12


def _wallpaper(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    colour = tx.mix((0.66, 0.70, 0.60), (0.75, 0.78, 0.68), tx.fbm(s.local, 0.10, 4, 1))
    colour = tx.mix(colour, (0.56, 0.60, 0.52), tx.stripes(uv[:, 0], 0.30, 0.5))
    cell = np.stack([np.floor(uv[:, 0] / 0.15), np.floor(uv[:, 1] / 0.18)], 1)
    p = uv - (cell + 0.5) * [0.15, 0.18]
    r, a = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0]) + 6 * tx.cell_noise(cell.astype(np.int64), 3)
    colour = tx.mix(colour, (0.40, 0.26, 0.30), (r < 0.034 + 0.016 * np.cos(5 * a)).astype(float))
    colour = tx.mix(colour, (0.88, 0.80, 0.50), (r < 0.014).astype(float))
    specks = tx.dots(uv, 0.055, 9, 0.45, 0.05, 0.16)
    return tx.mix(colour, (0.33, 0.42, 0.33), specks)


def _brickwork(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    on, which = tx.bricks(uv, 0.24, 0.08, 0.012, 4)
    colour = tx.ramp(which, [(0.42, 0.20, 0.14), (0.58, 0.30, 0.20), (0.68, 0.42, 0.30), (0.50, 0.33, 0.28)])
    colour = colour * (0.72 + 0.45 * tx.fbm(s.local, 0.05, 4, 8)[:, None])
    return tx.mix((0.72, 0.70, 0.66), colour, on)


def _parquet(s: Surface) -> Floats:
    p = s.local
    tile = np.floor(p[:, :2] / 0.4)
    across = (tile.sum(axis=1) % 2).astype(bool)
    u, v = np.where(across, p[:, 1], p[:, 0]), np.where(across, p[:, 0], p[:, 1])
    strip = np.floor(v / 0.1)
    tone = tx.cell_noise(np.stack([tile[:, 0], tile[:, 1], strip], 1).astype(np.int64), 6)
    grain = tx.noise(np.stack([0.08 * u, v, tone], 1), 0.008, 3)
    colour = tx.ramp(0.6 * tone + 0.4 * grain, [(0.40, 0.23, 0.11), (0.60, 0.39, 0.20), (0.74, 0.53, 0.30)])
    gap = ((v / 0.1) % 1 < 0.04) | ((u / 0.4) % 1 < 0.01)
    return tx.mix(colour, (0.18, 0.10, 0.05), gap.astype(float))


def _ceiling(s: Surface) -> Floats:
    panel = (((s.local[:, :2] / 0.6) % 1) < 0.025).any(axis=1)
    colour = tx.mix((0.88, 0.87, 0.84), (0.74, 0.73, 0.70), tx.fbm(s.local, 0.07, 4, 2))
    colour = tx.mix(colour, (0.50, 0.49, 0.47), tx.dots(s.local[:, :2], 0.06, 3, 0.6, 0.05, 0.15))
    return tx.mix(colour, (0.35, 0.34, 0.33), panel.astype(float))


def _timber(s: Surface) -> Floats:
    return tx.mix(s.colour * 0.45, np.clip(s.colour * 1.2, 0, 1), tx.wood(s.local, 0.045, 3))


_PRINTS = (
    [(0.10, 0.16, 0.30), (0.22, 0.36, 0.52), (0.55, 0.66, 0.68), (0.90, 0.84, 0.68), (0.82, 0.52, 0.25), (0.45, 0.20, 0.14)],
    [(0.13, 0.20, 0.12), (0.28, 0.42, 0.20), (0.60, 0.64, 0.34), (0.88, 0.82, 0.58), (0.70, 0.78, 0.84), (0.40, 0.55, 0.70)],
    [(0.20, 0.10, 0.14), (0.52, 0.14, 0.16), (0.82, 0.38, 0.20), (0.94, 0.74, 0.38), (0.92, 0.90, 0.82), (0.30, 0.32, 0.40)],
)


def _poster(s: Surface) -> Floats:
    """A different print on every poster."""
    seed = int(s.part[0])
    uv = tx.face_uv(s.local, s.normal_local)
    field = tx.fbm(s.local, 0.25, 5, seed % 29)
    base = np.array(_PRINTS[seed % len(_PRINTS)])
    hues = np.clip(base + np.random.default_rng(seed).normal(0, 0.04, base.shape), 0.03, 0.97)
    colour = tx.ramp(np.floor(field * 9) / 9, hues)
    colour = tx.mix(colour, hues[-1], tx.dots(uv, 0.12, seed, 0.3, 0.05, 0.2))
    margin = uv[:, 1] < -0.22
    colour = tx.mix(colour, (0.93, 0.92, 0.88), margin.astype(float))
    return tx.mix(colour, (0.08, 0.08, 0.10), margin * tx.print_marks(uv, 0.035, seed))


def _books(s: Surface) -> Floats:
    tone = np.random.default_rng(int(s.part[0])).random(3) * 0.7 + 0.15
    uv = s.local[:, [2, 0]]
    return tx.mix(
        tx.mix(tone, tone * 0.6, tx.fbm(s.local, 0.03, 3, 2)),
        (0.95, 0.88, 0.6),
        (np.abs(s.local[:, 0]) < 0.012) * tx.print_marks(uv, 0.022, int(s.part[0])),
    )


def _rug(s: Surface) -> Floats:
    x, y = s.local[:, 0], s.local[:, 1]
    r = np.hypot(x / 1.05, y / 0.75)
    colour = tx.mix((0.14, 0.20, 0.38), (0.22, 0.30, 0.50), tx.noise(s.local, 0.02, 5))
    colour = tx.mix(colour, (0.80, 0.62, 0.36), ((r * 7) % 1 < 0.22).astype(float))
    return tx.mix(colour, (0.72, 0.22, 0.18), tx.checker(s.local[:, :2], 0.09) * (r < 0.85) * ((r * 7) % 2 > 1.22))


def _view(s: Surface) -> Floats:
    """Beyond the window: sky, a hill, houses."""
    y, z = s.local[:, 1], s.local[:, 2]
    colour = tx.ramp(np.clip(0.5 + z, 0, 1), [(0.85, 0.90, 0.95), (0.55, 0.75, 0.95)])
    hill = z < -0.10 + 0.12 * np.sin(4 * y) + 0.05 * np.sin(13 * y)
    colour = tx.mix(colour, tx.ramp(tx.fbm(s.local, 0.08, 4, 5), [(0.16, 0.32, 0.14), (0.42, 0.55, 0.25)]), hill.astype(float))
    house = (z < -0.22) & ((y / 0.22) % 1 < 0.6) & (z > -0.40)
    colour = tx.mix(colour, (0.78, 0.55, 0.42), house.astype(float))
    return tx.mix(colour, (0.25, 0.22, 0.25), house * tx.checker(s.local[:, 1:], 0.045))


def _cloth(s: Surface) -> Floats:
    uv = tx.face_uv(s.local, s.normal_local)
    colour = tx.mix(s.colour, s.colour * 0.7, tx.stripes(uv[:, 0], 0.10))
    colour = tx.mix(colour, s.colour * 0.7, 0.6 * tx.stripes(uv[:, 1], 0.10))
    return tx.mix(
        colour,
        np.clip(s.colour * 1.5 + 0.2, 0, 1),
        np.maximum(tx.stripes(uv[:, 0], 0.20, 0.06), tx.stripes(uv[:, 1], 0.20, 0.06)),
    )


def _wall_c(s: Surface) -> Floats:
    """Cool at the floor and in the corners; a heating pipe behind the plaster, studs, damp, a hand print."""
    x, y, z = s.world.T
    t = s.base_c + 2.0 * z / Z
    corner = np.exp(-np.maximum(0, np.minimum(z, Z - z)) / 0.18)
    t -= 2.5 * corner
    back = y > Y - 0.02
    route = [(-2.5, 0.45), (-1.1, 0.45), (-1.1, 1.75), (0.7, 1.75), (0.7, 0.35), (2.5, 0.35)]
    distance = np.full(len(x), 9.0)
    for (ax, az), (bx, bz) in pairwise(route):
        k = np.clip(((x - ax) * (bx - ax) + (z - az) * (bz - az)) / ((bx - ax) ** 2 + (bz - az) ** 2), 0, 1)
        distance = np.minimum(distance, np.hypot(x - ax - k * (bx - ax), z - az - k * (bz - az)))
    t += back * 13 * np.exp(-distance / 0.07)
    studs = np.exp(-(((((x + 0.1) / 0.6) % 1 - 0.5) * 0.6 / 0.03) ** 2))
    t -= (y < -Y + 0.02) * 2.2 * studs
    t -= (x < -X + 0.02) * 6 * tx.bump(s.world, (-X, -1.3, 0.1), (1, 0.45, 0.35))
    hand = tx.bump(s.world, (X, 1.30, 1.20), (1, 0.05, 0.06)) + sum(
        tx.bump(s.world, (X, 1.25 + 0.035 * k, 1.30), (1, 0.011, 0.045)) for k in range(4)
    )
    return t + (x > X - 0.02) * 7 * np.minimum(hand, 1)


def _floor_c(s: Surface) -> Floats:
    x, y = s.world[:, 0], s.world[:, 1]
    loop = np.exp(-(((((y + 0.25 * np.sin(2 * x)) / 0.5) % 1 - 0.5) * 0.5 / 0.07) ** 2)) * (x > -0.4)  # floor heating
    sun = ((np.abs(x + 1.3 - 0.4 * y) < 0.4) & (y > -0.9) & (y < 0.5)).astype(float)
    return s.base_c + 6 * loop + 4 * sun


def _lamp_c(s: Surface) -> Floats:
    return s.base_c + 25 * tx.bump(s.local, (0, 0, 0.0), 0.14)


def _radiator_c(s: Surface) -> Floats:
    return s.base_c + 14 * np.clip(s.local[:, 2] / 0.6 + 0.5, 0, 1) - 6 * np.clip(s.world[:, 1] / 0.6, 0, 1)


def _window_c(s: Surface) -> Floats:
    return s.base_c + 3 * np.clip(s.local[:, 2] + 0.5, 0, 1)


def _inward(corner: tuple[float, float, float], u: tuple[float, float, float], v: tuple[float, float, float]) -> Mesh:
    return quad(corner, u, v, STEP)


def _leaf(length: float) -> Mesh:
    def surface(u: Floats, v: Floats) -> Floats:
        return np.stack([0.09 * (2 * u - 1) * np.sin(np.pi * np.clip(v, 0.02, 0.98)) ** 0.8, 0.10 * v * v, length * v], -1)

    return patch(surface, 6, 10)


def build() -> Model:
    b = Builder()
    paper, brick = Material(_wallpaper, _wall_c), Material(_brickwork, _wall_c)
    b.add(
        Material(_parquet, _floor_c, specular=0.12, shininess=40), _inward((-X, -Y, 0), (2 * X, 0, 0), (0, 2 * Y, 0)), base_c=18
    )
    b.add(
        Material(_ceiling, lambda s: s.base_c + 3 * tx.bump(s.world, (0.2, 0, Z), 0.5)),
        _inward((-X, -Y, Z), (0, 2 * Y, 0), (2 * X, 0, 0)),
        base_c=22,
    )
    b.add(paper, _inward((-X, Y, 0), (2 * X, 0, 0), (0, 0, Z)), base_c=19)
    b.add(paper, _inward((-X, -Y, 0), (0, 0, Z), (2 * X, 0, 0)), base_c=18)
    b.add(brick, _inward((X, -Y, 0), (0, 0, Z), (0, 2 * Y, 0)), base_c=17)
    # window wall (x = −X): four pieces round the opening
    y0, y1, z0, z1 = -0.8, 0.8, 0.95, 2.2
    for a, c, d, e in ((-Y, Y, 0.0, z0), (-Y, Y, z1, Z), (-Y, y0, z0, z1), (y1, Y, z0, z1)):
        b.add(paper, _inward((-X, a, d), (0, c - a, 0), (0, 0, e - d)), base_c=17)
    b.add(
        Material(_view, _window_c), quad((0, -0.85, -0.7), (0, 1.7, 0), (0, 0, 1.4), STEP).moved((-X - 0.12, 0, 1.575)), base_c=6
    )
    white = Material(lambda s: tx.mix((0.90, 0.90, 0.88), (0.74, 0.74, 0.72), tx.fbm(s.world, 0.08, 4, 3)), specular=0.2)
    frame = [box((0.14, 0.07, z1 - z0), (-X - 0.03, y, 1.575)) for y in (y0, 0.0, y1)] + [
        box((0.14, 1.65, 0.07), (-X - 0.03, 0, z)) for z in (z0, 1.75, z1)
    ]
    b.add(white, frame, base_c=13)
    b.add(white, box((0.30, 1.9, 0.04), (-X + 0.10, 0, z0 - 0.05)), base_c=18)
    # curtains
    for side in (-1, 1):
        hang = patch(lambda u, v: np.stack([0.05 * np.sin(u * 26), 0.36 * (u - 0.5), 2.1 * (v - 0.5)], -1), 60, 20)
        b.add(
            Material(_cloth, lambda s: s.base_c + 3 * s.local[:, 2]),
            hang.moved((-X + 0.14, side * 1.08, 1.32)),
            (0.62, 0.22, 0.20),
            18,
        )
    b.add(Material(specular=0.5), rod((-X + 0.12, -1.4, 2.4), (-X + 0.12, 1.4, 2.4), 0.018), (0.7, 0.55, 0.2), 20)
    # radiator and its pipes
    ribs = [box((0.09, 0.055, 0.60)).moved((-X + 0.11, y, 0.45)) for y in np.arange(-0.6, 0.61, 0.085)]
    b.add(Material(white.albedo, _radiator_c, 0.2), merged(ribs), base_c=36)
    b.add(
        Material(specular=0.6, reflect=0.1),
        [
            tube([(-X + 0.1, 0.65, 0.2), (-X + 0.1, 0.9, 0.2), (-X + 0.1, 0.9, 0.0)], 0.016),
            rod((-X + 0.06, 1.75, 0), (-X + 0.06, 1.75, Z), 0.022),
        ],
        (0.72, 0.42, 0.28),
        48,
    )
    # door with handle and panels (x = X)
    oak = Material(_timber, specular=0.15)
    b.add(oak, box((0.05, 0.9, 2.05)).moved((X - 0.02, -1.2, 1.025)), (0.58, 0.38, 0.22), 16)
    b.add(
        oak,
        [box((0.03, 0.32, h)).moved((X - 0.05, -1.2 + dy, z)) for dy in (-0.2, 0.2) for z, h in ((0.5, 0.7), (1.45, 0.9))],
        (0.48, 0.30, 0.16),
        17,
    )
    b.add(
        oak,
        [box((0.09, 0.08, 2.12), (X - 0.03, y, 1.06)) for y in (-1.69, -0.71)] + [box((0.09, 1.06, 0.08), (X - 0.03, -1.2, 2.1))],
        (0.70, 0.52, 0.34),
        19,
    )
    b.add(
        Material(specular=0.9, reflect=0.2),
        [sphere(0.03, 14).moved((X - 0.10, -0.84, 1.0)), rod((X - 0.1, -0.84, 1.0), (X - 0.03, -0.84, 1.0), 0.012)],
        (0.85, 0.68, 0.3),
        29,
    )
    # table with things on it, two chairs
    b.add(oak, box((1.3, 0.8, 0.05)).moved((0.35, 0.25, 0.74)), (0.72, 0.48, 0.27), 20)
    b.add(
        oak,
        [box((0.06, 0.06, 0.72)).moved((0.35 + dx, 0.25 + dy, 0.36)) for dx in (-0.58, 0.58) for dy in (-0.34, 0.34)],
        (0.60, 0.38, 0.20),
        19,
    )
    b.add(
        Material(specular=0.5, shininess=80),
        lathe([(0, 0), (0.05, 0), (0.055, 0.12), (0.048, 0.12), (0.045, 0.01), (0, 0.01)], 24).moved((0.15, 0.35, 0.766)),
        (0.80, 0.20, 0.15),
        52,
    )
    b.add(
        Material(_cloth, lambda s: s.base_c + 16 * tx.bump(s.local[:, :2], (0.1, 0.02), 0.09)),
        box((0.36, 0.25, 0.02)).moved((0.62, 0.15, 0.775), (0, 0, 20)),
        (0.30, 0.32, 0.38),
        25,
    )
    b.add(
        Material(_poster, lambda s: s.base_c + 8 * tx.bump(s.local, (0.05, 0, 0), 0.07)),
        box((0.36, 0.015, 0.24)).moved((0.58, 0.28, 0.90), (0, 0, 20)),
        base_c=27,
    )
    b.add(
        Material(lambda s: tx.mix((0.9, 0.75, 0.1), (0.85, 0.3, 0.1), tx.fbm(s.local, 0.05, 4, 2)), specular=0.2),
        [
            sphere(0.05, 18).moved((-0.05 + dx, 0.12 + dy, 0.85 + dz))
            for dx, dy, dz in ((0, 0, 0), (0.09, 0.02, 0), (0.04, 0.08, 0), (0.04, 0.03, 0.07))
        ],
        base_c=12,
    )
    b.add(
        Material(
            lambda s: tx.mix(
                (0.85, 0.88, 0.9), (0.2, 0.35, 0.6), tx.stripes(np.arctan2(s.local[:, 1], s.local[:, 0]), np.pi / 9)
            ),
            specular=0.4,
        ),
        lathe([(0, 0), (0.07, 0), (0.17, 0.09), (0.16, 0.09), (0.06, 0.015), (0, 0.015)], 36).moved((0, 0.15, 0.766)),
        base_c=19,
    )
    for cx, cy, turn in ((0.1, -0.45, 180.0), (0.75, 0.98, 10.0)):
        seat = Material(_cloth, lambda s: s.base_c + 9 * tx.bump(s.local[:, :2], (0, 0), 0.13))
        legs = [rod((dx, dy, 0), (dx, dy, 0.45 if dy < 0 else 0.95), 0.02) for dx in (-0.2, 0.2) for dy in (-0.2, 0.2)]
        slats = [box((0.38, 0.02, 0.07)).moved((0, 0.2, z)) for z in (0.6, 0.74, 0.88)]
        b.add(oak, merged(legs + slats).moved((cx, cy, 0), (0, 0, turn)), (0.45, 0.25, 0.13), 20)
        b.add(seat, box((0.44, 0.44, 0.05)).moved((cx, cy, 0.46), (0, 0, turn)), (0.20, 0.42, 0.40), 22)
    b.add(
        Material(_rug, lambda s: s.base_c + 2 * tx.noise(s.world, 0.4, 3)),
        box((2.1, 1.5, 0.015)).moved((0.35, 0.1, 0.01)),
        base_c=20,
    )
    # shelf with books (y = Y wall)
    b.add(
        oak,
        [box((1.2, 0.26, 0.035)).moved((-1.55, Y - 0.13, z)) for z in (0.95, 1.35, 1.75)]
        + [box((0.035, 0.26, 0.85)).moved((-1.55 + dx, Y - 0.13, 1.35)) for dx in (-0.6, 0.6)],
        (0.55, 0.36, 0.2),
        20,
    )
    rng = np.random.default_rng(4)
    for z in (0.97, 1.37):
        x = -2.10
        while x < -1.05:
            w, h = rng.uniform(0.025, 0.06), rng.uniform(0.2, 0.32)
            b.add(Material(_books), box((w, 0.17, h)).moved((x + w / 2, Y - 0.12, z + h / 2)), base_c=20 + rng.uniform(-1, 2))
            x += w + 0.003
    b.add(
        Material(
            lambda s: tx.mix((0.1, 0.1, 0.12), (0.5, 0.5, 0.55), tx.dots(s.local[:, [0, 2]], 0.012, 2, 1.0, 0.3, 0.4)),
            lambda s: s.base_c + 12 * tx.bump(s.local, (0.06, 0, 0), 0.07),
        ),
        box((0.34, 0.18, 0.2)).moved((-1.6, Y - 0.13, 1.87)),
        base_c=26,
    )
    # posters; half of them have no warmth of their own
    poster = Material(_poster, lambda s: s.base_c + 0 * s.world[:, 0])
    for k, (at, size, turn) in enumerate(
        (
            ((0.2, Y - 0.012, 1.55), (0.75, 0.02, 0.95), 0),
            ((1.35, Y - 0.012, 1.45), (0.6, 0.02, 0.8), 0),
            ((-1.4, -Y + 0.012, 1.5), (0.8, 0.02, 0.9), 0),
            ((0.0, -Y + 0.012, 1.6), (0.9, 0.02, 0.7), 0),
            ((1.3, -Y + 0.012, 1.5), (0.6, 0.02, 0.85), 0),
        )
    ):
        b.add(poster, box(size).moved(at, (0, 0, turn)), base_c=19.5 + 0.4 * k)
    b.add(Material(_poster), box((0.02, 1.1, 0.8)).moved((X - 0.012, 0.45, 1.75)), base_c=17.5)
    # sideboard with a television (y = −Y), plant, ceiling lamp
    b.add(oak, box((1.5, 0.4, 0.6)).moved((-0.2, -Y + 0.2, 0.3)), (0.62, 0.42, 0.25), 19)
    b.add(oak, [box((0.46, 0.02, 0.5)).moved((-0.2 + dx, -Y + 0.41, 0.3)) for dx in (-0.49, 0.0, 0.49)], (0.72, 0.52, 0.33), 19)
    b.add(
        Material(
            _poster,
            lambda s: s.base_c + 9 * np.clip(s.local[:, 2] / 0.5 + 0.5, 0, 1) + 6 * tx.bump(s.local, (0.3, 0, 0.1), 0.12),
            specular=0.2,
        ),
        box((1.0, 0.04, 0.56)).moved((-0.2, -Y + 0.2, 0.95)),
        base_c=25,
    )
    b.add(
        Material(lambda s: tx.mix((0.55, 0.28, 0.18), (0.72, 0.42, 0.28), tx.fbm(s.local, 0.06, 4, 2))),
        lathe([(0, 0), (0.15, 0), (0.2, 0.35), (0.17, 0.35), (0.16, 0.3), (0, 0.3)], 28).moved((1.75, 1.4, 0)),
        base_c=17,
    )
    leaves = []
    for k in range(26):
        a, tilt, length = 2.4 * k, 25 + 45 * rng.random(), 0.35 + 0.3 * rng.random()
        leaves.append(_leaf(length).moved((0, 0, 0), (-tilt, 0, 0)).moved((1.75, 1.4, 0.32 + 0.012 * k), (0, 0, np.degrees(a))))
    b.add(
        Material(
            lambda s: tx.mix(
                (0.10, 0.30, 0.10), (0.42, 0.62, 0.25), np.maximum(tx.fbm(s.local, 0.05, 3, 6), (np.abs(s.local[:, 0]) < 0.006))
            )
        ),
        leaves,
        base_c=15,
    )
    b.add(Material(specular=0.2), rod((0.2, 0, Z), (0.2, 0, Z - 0.35), 0.008), (0.1, 0.1, 0.1), 22)
    shade = lathe([(0.22, -0.14), (0.10, 0.06), (0.09, 0.06), (0.21, -0.14)], 36)
    b.add(Material(_cloth, _lamp_c), shade.moved((0.2, 0, Z - 0.42)), (0.85, 0.62, 0.30), 30)
    b.add(Material(), [sphere(0.05, 18).moved((0.2, 0, Z - 0.47))], (1.0, 1.0, 0.95), 62)
    b.add(Material(specular=0.3), torus(0.16, 0.02, 36).moved((X - 0.03, 1.55, 2.1), (0, 90, 0)), (0.15, 0.15, 0.18), 20)
    b.add(Material(_clock), cylinder(0.16, 0.02, 36).moved((X - 0.01, 1.55, 2.1), (0, -90, 0)), base_c=20)
    bulbs = np.array([(0.2 + dx, dy, Z - 0.60) for dx, dy in ((-0.12, -0.05), (0.05, -0.12), (0.12, 0.05), (-0.05, 0.12))])
    panes = np.array([(-X + 0.05, y, z) for y, z in ((-0.5, 1.3), (0.5, 1.4), (-0.4, 1.9), (0.45, 2.0))])
    lights = (Light(bulbs, (0.50, 0.46, 0.38), 1.6), Light(panes, (0.36, 0.40, 0.46), 2.2))
    return Model(
        tuple(b.parts), lights, sky=(0.30, 0.30, 0.31), ground=(0.28, 0.26, 0.24), ambient_c=20, background_c=10, occlusion_m=0.6
    )


def _clock(s: Surface) -> Floats:
    r, a = np.hypot(s.local[:, 0], s.local[:, 1]), np.arctan2(s.local[:, 1], s.local[:, 0])
    ticks = (r > 0.115) & (r < 0.14) & (((a * 6 / np.pi) + 0.1) % 1 < 0.2)
    hands = ((np.abs(s.local[:, 0]) < 0.007) & (s.local[:, 1] > 0) & (r < 0.11)) | (
        (np.abs(s.local[:, 1]) < 0.009) & (s.local[:, 0] > 0) & (r < 0.07)
    )
    return tx.mix((0.94, 0.93, 0.88), (0.08, 0.08, 0.1), (ticks | hands).astype(float))
