"""The steps that all compositing kernels share: which splats of a batch meet a patch of 16×16 pixels, which of its rows they reach, and
their opacity there (see `blend`)."""

from __future__ import annotations

import numpy as np

from rtgs.base.compiled import inlined, kernel
from rtgs.renderer.cpu.layout import (
    BATCH,
    ETA,
    KAPPA,
    LOG2_ALPHA_MIN,
    LOG2_OPACITY,
    PATCH,
    SLANT,
    SPLAT,
    X_LOW,
    Y_LOW,
    X,
    Y,
)
from rtgs.renderer.cpu.simd import (
    LANES,
    any_lane,
    exp2_below_one,
    lane_numbers,
    lanes_of,
    load,
    mask_bits,
    maximum,
    minimum,
    square_root,
    store,
    where,
)
from rtgs.renderer.settings import ALPHA_MAX

F = np.float32
AREA = PATCH * PATCH
_SLACK_PX = 0.01  # covers the float32 rounding of a box
_LEFT, _RIGHT, _UPPER, _LOWER = range(4)  # planes of a batch's boxes


@inlined
def aligned(n):
    """`[n]` float32 on a cache line's boundary."""
    raw = np.empty(n + 16, np.float32)
    skip = (-raw.ctypes.data % 64) // 4
    return raw[skip : skip + n]


@inlined
def fill(state, at, value):
    """Set one plane of a patch to `value`."""
    for r in range(PATCH):
        store(state, at + r * PATCH, lanes_of(value))


@inlined
def fetch(source, q, top, left, state, at):
    """Channel `q` of `[H, W, C]` into a plane; zero beyond the picture."""
    fill(state, at, F(0))
    for r in range(min(PATCH, source.shape[0] - top)):
        for i in range(min(PATCH, source.shape[1] - left)):
            state[at + r * PATCH + i] = source[top + r, left + i, q]


@inlined
def place(state, at, sign, top, left, out, q):
    """A plane, times `sign`, into channel `q` of `[H, W, C]`."""
    for r in range(min(PATCH, out.shape[0] - top)):
        for i in range(min(PATCH, out.shape[1] - left)):
            out[top + r, left + i, q] = sign * state[at + r * PATCH + i]


@inlined
def place_alpha(state, at, top, left, alpha):
    """1 − transmittance of a plane into `[H, W]`."""
    for r in range(min(PATCH, alpha.shape[0] - top)):
        for i in range(min(PATCH, alpha.shape[1] - left)):
            alpha[top + r, left + i] = F(1) - abs(state[at + r * PATCH + i])


@inlined
def patches_of(side, top, left, shape):
    """Rows and columns of patches of a tile that lie in the picture."""
    return (min(side, shape[0] - top) + PATCH - 1) // PATCH, (min(side, shape[1] - left) + PATCH - 1) // PATCH


@kernel()
def load_batch(entries, first, count, splats, left, top, batch, boxes):
    """Copy `count` splats, centres from the tile's corner, and take their bounding boxes as planes `[4 · BATCH]`."""
    planes = np.empty(6 * LANES, np.float32)
    for group in range(0, count, LANES):
        for lane in range(LANES):
            s, to = SPLAT * entries[first + min(group + lane, count - 1)], SPLAT * (group + lane)
            store(batch, to, load(splats, s))
            batch[to + X] = (splats[s + X] - left) + splats[s + X_LOW]
            batch[to + Y] = (splats[s + Y] - top) + splats[s + Y_LOW]
            planes[lane], planes[LANES + lane] = batch[to + X], batch[to + Y]
            planes[2 * LANES + lane], planes[3 * LANES + lane] = splats[s + SLANT], splats[s + ETA]
            planes[4 * LANES + lane], planes[5 * LANES + lane] = splats[s + KAPPA], splats[s + LOG2_OPACITY]
        x, y, slant = load(planes, 0), load(planes, LANES), load(planes, 2 * LANES)
        eta, kappa = load(planes, 3 * LANES), load(planes, 4 * LANES)
        reach = maximum(load(planes, 5 * LANES) - F(LOG2_ALPHA_MIN), F(0))
        half_x = square_root(reach * (F(1) / eta + slant * slant / kappa)) + F(_SLACK_PX)
        half_y = square_root(reach / kappa) + F(_SLACK_PX)
        store(boxes, _LEFT * BATCH + group, x - half_x)
        store(boxes, _RIGHT * BATCH + group, x + half_x)
        store(boxes, _UPPER * BATCH + group, y - half_y)
        store(boxes, _LOWER * BATCH + group, y + half_y)


@inlined
def candidates(boxes, group, count, x, y):
    """Which of sixteen splats of the batch have a box that meets the patch at (x, y) of the tile, as bits."""
    left, right = load(boxes, _LEFT * BATCH + group), load(boxes, _RIGHT * BATCH + group)
    upper, lower = load(boxes, _UPPER * BATCH + group), load(boxes, _LOWER * BATCH + group)
    meets = (left <= x + F(PATCH - 0.5)) & (right >= x + F(0.5)) & (upper <= y + F(PATCH - 0.5)) & (lower >= y + F(0.5))
    return mask_bits(meets) & ((1 << min(LANES, count - group)) - 1)


@inlined
def rows_reached(batch, s, x, y, alive, rows):
    """Which rows of the patch the splat reaches, as bits; `rows` gets each row's middle and q there.

    `x`, `y`: the centre from the patch's corner.
    """
    dy = lane_numbers() + F(0.5) - y
    middle = x + dy * batch[s + SLANT]
    q = batch[s + LOG2_OPACITY] - dy * dy * batch[s + KAPPA]
    store(rows, 0, middle)
    store(rows, LANES, q)
    beyond = maximum(maximum(F(0.5) - middle, middle - F(PATCH - 0.5)), F(0))
    return mask_bits(q - beyond * beyond * batch[s + ETA] >= F(LOG2_ALPHA_MIN)) & alive


@inlined
def opacity(rows, r, eta):
    """α at the sixteen pixels of row `r`; zero where it is under 1/255."""
    d = lane_numbers() + F(0.5) - rows[r]
    q = rows[LANES + r] - d * d * eta
    return where(q >= F(LOG2_ALPHA_MIN), minimum(exp2_below_one(q), F(ALPHA_MAX)), F(0))


@inlined
def still_alive(state, at, alive):
    """`alive` without the rows whose pixels are all finished; `at` is the plane of transmittances."""
    for r in range(PATCH):
        if (alive >> r) & 1 and not any_lane(load(state, at + r * PATCH) > F(0)):
            alive &= ~(1 << r)
    return alive


@inlined
def time_to_look(group):
    """Finished rows are looked for after every 64 splats of the batch."""
    return group & 63 == 48
