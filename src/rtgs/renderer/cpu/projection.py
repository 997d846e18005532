"""Project Gaussians to splats, and take a splat's gradients back to Gaussian and pose.

Sixteen Gaussians are worked on at once: they are copied into planes of sixteen, so that any selection of them will do. Camera
coordinates and pixel centres are float64 (a world may lie far from its origin), the rest float32; the covariance's determinant is
summed from squares of minors, which cancels nowhere.

Letters, fixed here and in `motion`: W, t = camera_from_world; V = W·M with M = R(q)·diag(σ); U = J·V the 2×3 square root of the projected
covariance [[a, b], [b, c]] before the blur; Q = its inverse after the blur.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from rtgs.base.compiled import inlined, kernel
from rtgs.renderer.cpu.layout import (
    CHUNKS,
    COLORS,
    DX,
    DXX,
    DXY,
    DY,
    DYY,
    ETA,
    G_COLORS,
    KAPPA,
    LOG2_ALPHA_MIN,
    LOG2_OPACITY,
    ONE,
    SLANT,
    SPLAT,
    X_LOW,
    Y_LOW,
    X,
    Y,
)
from rtgs.renderer.cpu.simd import (
    LANES,
    ceil,
    exponential,
    floor,
    lanes_of,
    load,
    log2,
    magnitude,
    mask_bits,
    maximum,
    minimum,
    narrow,
    square_root,
    store,
    total,
    where,
    widen,
)
from rtgs.renderer.settings import ALPHA_MIN, COVARIANCE_BLUR_PX2, FRUSTUM_MARGIN

F = np.float32
_LOG2_E = 1.4426950408889634
# Planes of a group of sixteen Gaussians.
MEAN, QUAT, LOG_SCALE, LOGIT, OFFSET = 0, 3, 7, 10, 11
INPUTS = 13


@inlined
def slot_width(numbers):
    """Length of a row of `slot_grads` that holds so many numbers: whole quarters of a register."""
    return (numbers + 3) // 4 * 4


@inlined
def gather(lane, i, means, quats, log_scales, opacity_logits, offsets, group):
    """Copy Gaussian `i` into a lane of the group's planes."""
    for k in range(3):
        group[(MEAN + k) * LANES + lane] = means[i, k]
        group[(LOG_SCALE + k) * LANES + lane] = log_scales[i, k]
    for k in range(4):
        group[(QUAT + k) * LANES + lane] = quats[i, k]
    group[LOGIT * LANES + lane] = opacity_logits[i]
    group[OFFSET * LANES + lane] = offsets[i, 0] if len(offsets) > 0 else F(0)
    group[(OFFSET + 1) * LANES + lane] = offsets[i, 1] if len(offsets) > 0 else F(0)


@inlined
def plane(group, k):
    return load(group, k * LANES)


@inlined
def wide(group, k):
    return widen(load(group, k * LANES))


@inlined
def camera_point(group, rotation, translation):
    """The centres in camera coordinates, float64."""
    x, y, z = widen(plane(group, MEAN)), widen(plane(group, MEAN + 1)), widen(plane(group, MEAN + 2))
    return (
        x * rotation[0, 0] + y * rotation[0, 1] + z * rotation[0, 2] + translation[0],
        x * rotation[1, 0] + y * rotation[1, 1] + z * rotation[1, 2] + translation[1],
        x * rotation[2, 0] + y * rotation[2, 1] + z * rotation[2, 2] + translation[2],
    )


@inlined
def camera_square_root(group, rotation, m, v):
    """Fill M and V, `[9 · 16]` each, row by row; return 1/|q|."""
    w, x, y, z = plane(group, QUAT), plane(group, QUAT + 1), plane(group, QUAT + 2), plane(group, QUAT + 3)
    inverse = 1.0 / maximum(square_root(w * w + x * x + y * y + z * z), 1e-12)
    w, x, y, z = w * inverse, x * inverse, y * inverse, z * inverse
    s0, s1, s2 = (
        exponential(plane(group, LOG_SCALE)),
        exponential(plane(group, LOG_SCALE + 1)),
        exponential(plane(group, LOG_SCALE + 2)),
    )
    store(m, 0 * LANES, (1.0 - 2.0 * (y * y + z * z)) * s0)
    store(m, 1 * LANES, 2.0 * (x * y - w * z) * s1)
    store(m, 2 * LANES, 2.0 * (x * z + w * y) * s2)
    store(m, 3 * LANES, 2.0 * (x * y + w * z) * s0)
    store(m, 4 * LANES, (1.0 - 2.0 * (x * x + z * z)) * s1)
    store(m, 5 * LANES, 2.0 * (y * z - w * x) * s2)
    store(m, 6 * LANES, 2.0 * (x * z - w * y) * s0)
    store(m, 7 * LANES, 2.0 * (y * z + w * x) * s1)
    store(m, 8 * LANES, (1.0 - 2.0 * (x * x + y * y)) * s2)
    for i in range(3):
        for j in range(3):
            store(
                v,
                (3 * i + j) * LANES,
                plane(m, j) * rotation[i, 0] + plane(m, 3 + j) * rotation[i, 1] + plane(m, 6 + j) * rotation[i, 2],
            )
    return inverse


@inlined
def held(slope, centre, focal, size):
    """x/z or y/z held within the view plus a margin."""
    margin = FRUSTUM_MARGIN * 0.5 * size / focal
    return minimum(maximum(slope, -centre / focal - margin), (size - centre) / focal + margin)


@inlined
def image_square_root(v, jx, jy, sx, sy, u):
    """Fill U `[6 · 16]`, row by row."""
    for j in range(3):
        store(u, j * LANES, jx * (plane(v, j) - sx * plane(v, 6 + j)))
        store(u, (3 + j) * LANES, jy * (plane(v, 3 + j) - sy * plane(v, 6 + j)))


@inlined
def covariance(u):
    """a, b, c and the determinant ac − b² of U·Uᵀ, float64; the determinant as the sum of U's squared minors."""
    x0, x1, x2, y0, y1, y2 = wide(u, 0), wide(u, 1), wide(u, 2), wide(u, 3), wide(u, 4), wide(u, 5)
    n0, n1, n2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    return (
        x0 * x0 + x1 * x1 + x2 * x2,
        x0 * y0 + x1 * y1 + x2 * y2,
        y0 * y0 + y1 * y1 + y2 * y2,
        n0 * n0 + n1 * n1 + n2 * n2,
    )


@kernel()
def _project_group(group, rotation, translation, intrinsics, size, near, blur, antialiased, scratch, out, centres):
    """Fill `out`: SLANT … LOG2_OPACITY and the pixel rectangle; `centres` (x, y, low parts); z. Returns the visible lanes as bits."""
    x, y, z = camera_point(group, rotation, translation)
    deep = mask_bits(z > near)
    if deep == 0:
        return deep
    pixel_x = intrinsics[0] * x / z + intrinsics[2] + widen(plane(group, OFFSET))
    pixel_y = intrinsics[1] * y / z + intrinsics[3] + widen(plane(group, OFFSET + 1))
    px, py = narrow(pixel_x), narrow(pixel_y)
    depth = narrow(z)
    m, v, u = scratch[: 9 * LANES], scratch[9 * LANES : 18 * LANES], scratch[18 * LANES : 24 * LANES]
    camera_square_root(group, rotation, m, v)
    sx = held(narrow(x) / depth, intrinsics[2], intrinsics[0], size[0])
    sy = held(narrow(y) / depth, intrinsics[3], intrinsics[1], size[1])
    image_square_root(v, intrinsics[0] / depth, intrinsics[1] / depth, sx, sy, u)
    a, b, c, det_sharp = covariance(u)
    det = det_sharp + blur[1] * a + blur[0] * c + blur[0] * blur[1]
    a, c = a + blur[0], c + blur[1]
    slant, eta, kappa = narrow(b / c), narrow((0.5 * _LOG2_E) * c / det), narrow((0.5 * _LOG2_E) / c)
    fade = narrow(square_root(maximum(det_sharp / det, 1e-12)))
    finite = mask_bits(det < np.inf)
    wide, high = narrow(a), narrow(c)
    opacity = 1.0 / (1.0 + exponential(-plane(group, LOGIT)))
    if antialiased:
        opacity = opacity * fade
    log_opacity = log2(opacity)
    reach = maximum(log_opacity - LOG2_ALPHA_MIN, 0.0) * (2.0 / _LOG2_E)
    half_x, half_y = square_root(reach * wide), square_root(reach * high)
    # A hundredth of a pixel of slack covers float32.
    left, right = maximum(ceil(px - half_x - 0.51), 0.0), minimum(floor(px + half_x - 0.49), size[0] - 1.0)
    upper, lower = maximum(ceil(py - half_y - 0.51), 0.0), minimum(floor(py + half_y - 0.49), size[1] - 1.0)
    store(centres, 0, px)
    store(centres, LANES, py)
    store(centres, 2 * LANES, narrow(pixel_x - widen(px)))
    store(centres, 3 * LANES, narrow(pixel_y - widen(py)))
    store(out, 0, slant)
    store(out, LANES, eta)
    store(out, 2 * LANES, kappa)
    store(out, 3 * LANES, log_opacity)
    store(out, 4 * LANES, left)
    store(out, 5 * LANES, right)
    store(out, 6 * LANES, upper)
    store(out, 7 * LANES, lower)
    store(out, 8 * LANES, depth)
    finite = finite & mask_bits((half_x < np.inf) & (half_y < np.inf))
    in_view = (px + half_x > 0.5) & (px - half_x < size[0] - 0.5) & (py + half_y > 0.5) & (py - half_y < size[1] - 0.5)
    return deep & finite & mask_bits((opacity > ALPHA_MIN) & in_view & (left <= right) & (upper <= lower))


@kernel(parallel=True)
def project(model, offsets, colors, view, side, near, blur, antialiased, splats, depths, boxes, tiles):
    """Project a model.

    Args:
        offsets: `[N, 2]`, added to the pixel centres; or `[0, 2]`.
        colors: `[N, C]`.
        side: of a tile, pixels.
        near: Gaussians whose centre is not deeper than this are not visible.
        blur: `[2]`, px², added to the covariance along x and y; with `antialiased` opacity makes up for it.
        splats, depths, boxes: outputs `[N · 16]` (see `layout`), `[N]` and `[N, 4]` (see `Boxes`), filled where visible.
        tiles: output `[N]`, the number of tiles in the box; 0 where not visible.
    """
    means, quats, log_scales, opacity_logits = model
    rotation, translation, intrinsics, size = view
    n = len(means)
    for chunk in nb.prange(CHUNKS):
        group, scratch = np.zeros(INPUTS * LANES, np.float32), np.empty(24 * LANES, np.float32)
        out, centres = np.empty(9 * LANES, np.float32), np.empty(4 * LANES, np.float32)
        stop = (chunk + 1) * n // CHUNKS
        for first in range(chunk * n // CHUNKS, stop, LANES):
            count = min(LANES, stop - first)
            for lane in range(count):
                gather(lane, first + lane, means, quats, log_scales, opacity_logits, offsets, group)
            bits = _project_group(group, rotation, translation, intrinsics, size, near, blur, antialiased, scratch, out, centres)
            for lane in range(count):
                i = first + lane
                if not (bits >> lane) & 1:
                    tiles[i] = 0
                    continue
                s = i * SPLAT
                splats[s + X], splats[s + Y] = centres[lane], centres[LANES + lane]
                splats[s + X_LOW], splats[s + Y_LOW] = centres[2 * LANES + lane], centres[3 * LANES + lane]
                splats[s + SLANT], splats[s + ETA] = out[lane], out[LANES + lane]
                splats[s + KAPPA], splats[s + LOG2_OPACITY] = out[2 * LANES + lane], out[3 * LANES + lane]
                for c in range(colors.shape[1]):
                    splats[s + COLORS + c] = colors[i, c]
                column, row = int(out[4 * LANES + lane]) // side, int(out[6 * LANES + lane]) // side
                columns = int(out[5 * LANES + lane]) // side + 1 - column
                rows = int(out[7 * LANES + lane]) // side + 1 - row
                boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = column, row, columns, rows
                depths[i] = out[8 * LANES + lane]
                tiles[i] = columns * rows


@inlined
def _sum_over_tiles(i, box, pair_starts, places, used, slot_starts, tiles_x, slot_grads, width):
    """The sum of a Gaussian's slots, a row of `width` numbers each (lanes beyond it are noise), and how many there were.

    Entries that their tile did not need read slot 0, which is zero: that costs less than a branch, which would be mispredicted often.
    """
    sums, found = lanes_of(F(0)), 0
    tile, column, columns = box[i, 1] * tiles_x + box[i, 0], 0, box[i, 2]
    for j in range(pair_starts[i], pair_starts[i + 1]):
        needed = places[j] < used[tile]
        slot = slot_starts[tile] + places[j] if needed else 0
        found += 1 if needed else 0
        sums = sums + load(slot_grads, slot * width)
        column += 1
        tile += tiles_x - columns + 1 if column == columns else 1
        column = 0 if column == columns else column
    return sums, found


@kernel()
def _pull_back_group(group, moments, rotation, translation, intrinsics, size, antialiased, scratch, out, pose):
    """Gradients of sixteen Gaussians from their moments.

    Args:
        moments: `[6 · 16]`. out: `[13 · 16]`, in the order of the inputs. pose: `[12 · 16]` float64, (W, t) row by row, added to.
    """
    wide_x, wide_y, wide_z = camera_point(group, rotation, translation)
    x, y, z = narrow(wide_x), narrow(wide_y), narrow(wide_z)
    m, v, u = scratch[: 9 * LANES], scratch[9 * LANES : 18 * LANES], scratch[18 * LANES : 24 * LANES]
    inverse_norm = camera_square_root(group, rotation, m, v)
    slope_x, slope_y = x / z, y / z
    sx, sy = held(slope_x, intrinsics[2], intrinsics[0], size[0]), held(slope_y, intrinsics[3], intrinsics[1], size[1])
    jx, jy = intrinsics[0] / z, intrinsics[1] / z
    image_square_root(v, jx, jy, sx, sy, u)

    # Q·M·Q·U cancels as (length / width)² of what is drawn, twice: float64.
    a, b, c, det_sharp = covariance(u)
    det = det_sharp + COVARIANCE_BLUR_PX2 * (a + c) + COVARIANCE_BLUR_PX2 * COVARIANCE_BLUR_PX2
    inverse = 1.0 / det
    q00, q01, q11 = (c + COVARIANCE_BLUR_PX2) * inverse, -b * inverse, (a + COVARIANCE_BLUR_PX2) * inverse
    one, mx, my = wide(moments, ONE), wide(moments, DX), wide(moments, DY)
    mxx, mxy, myy = wide(moments, DXX), wide(moments, DXY), wide(moments, DYY)
    gx, gy = narrow(q00 * mx + q01 * my), narrow(q01 * mx + q11 * my)
    # ∂L/∂covariance = ½·Q·M·Q, symmetric: (h00, h01, h11).
    p00, p01, p10, p11 = q00 * mxx + q01 * mxy, q00 * mxy + q01 * myy, q01 * mxx + q11 * mxy, q01 * mxy + q11 * myy
    h00, h01, h11 = 0.5 * (p00 * q00 + p01 * q01), 0.5 * (p00 * q01 + p01 * q11), 0.5 * (p10 * q01 + p11 * q11)
    if antialiased:
        # d ln fade = ½·(tr Σ₀⁻¹dΣ − tr Q·dΣ), while the fade is above its floor.
        k = where(det_sharp > 1e-12 * det, 0.5 * one, 0.0)
        sharp = 1.0 / maximum(det_sharp, 1e-300)
        h00 = h00 + k * (c * sharp - q00)
        h01 = h01 + k * (-b * sharp - q01)
        h11 = h11 + k * (a * sharp - q11)
    store(out, LOGIT * LANES, narrow(one) / (1.0 + exponential(plane(group, LOGIT))))
    store(out, OFFSET * LANES, gx)
    store(out, (OFFSET + 1) * LANES, gy)

    # covariance = U·Uᵀ, U = J·V; J = [[jx, 0, −jx·sx], [0, jy, −jy·sy]]. V gives way to its gradient.
    dj00, dj02, dj11, dj12 = 0.0 * x, 0.0 * x, 0.0 * x, 0.0 * x
    for j in range(3):
        ux, uy = wide(u, j), wide(u, 3 + j)
        dux, duy = narrow(2.0 * (h00 * ux + h01 * uy)), narrow(2.0 * (h01 * ux + h11 * uy))
        dj00 = dj00 + dux * plane(v, j)
        dj02 = dj02 + dux * plane(v, 6 + j)
        dj11 = dj11 + duy * plane(v, 3 + j)
        dj12 = dj12 + duy * plane(v, 6 + j)
        store(v, j * LANES, jx * dux)
        store(v, (3 + j) * LANES, jy * duy)
        store(v, (6 + j) * LANES, -(jx * sx * dux + jy * sy * duy))
    free_x, free_y = magnitude(sx - slope_x) <= 0.0, magnitude(sy - slope_y) <= 0.0
    dx = jx * gx - where(free_x, jx * dj02 / z, 0.0)
    dy = jy * gy - where(free_y, jy * dj12 / z, 0.0)
    dz = -(jx * x * gx + jy * y * gy + jx * dj00 + jy * dj11) / z
    dz = dz + (where(free_x, 2.0 * jx * sx, jx * sx) * dj02 + where(free_y, 2.0 * jy * sy, jy * sy) * dj12) / z
    for k in range(3):
        store(out, (MEAN + k) * LANES, dx * rotation[0, k] + dy * rotation[1, k] + dz * rotation[2, k])

    for r in range(3):
        d = dx if r == 0 else (dy if r == 1 else dz)
        for k in range(3):
            towards = d * plane(group, MEAN + k)
            for j in range(3):
                towards = towards + plane(v, 3 * r + j) * plane(m, 3 * k + j)
            at = (3 * r + k) * LANES
            store(pose, at, load(pose, at) + widen(towards))
        at = (9 + r) * LANES
        store(pose, at, load(pose, at) + widen(d))

    # ∂M = Wᵀ·∂V, then M = R(q)·diag(σ); V's place holds ∂R.
    for j in range(3):
        sigma = exponential(plane(group, LOG_SCALE + j))
        v0, v1, v2 = plane(v, j), plane(v, 3 + j), plane(v, 6 + j)
        along = 0.0 * x
        for k in range(3):
            dm = v0 * rotation[0, k] + v1 * rotation[1, k] + v2 * rotation[2, k]
            along = along + dm * plane(m, 3 * k + j)
            store(v, (3 * k + j) * LANES, dm * sigma)
        store(out, (LOG_SCALE + j) * LANES, along)
    w, qx, qy, qz = (
        plane(group, QUAT) * inverse_norm,
        plane(group, QUAT + 1) * inverse_norm,
        plane(group, QUAT + 2) * inverse_norm,
        plane(group, QUAT + 3) * inverse_norm,
    )
    r00, r01, r02, r10, r11 = plane(v, 0), plane(v, 1), plane(v, 2), plane(v, 3), plane(v, 4)
    r12, r20, r21, r22 = plane(v, 5), plane(v, 6), plane(v, 7), plane(v, 8)
    dw = 2.0 * (qz * (r10 - r01) + qy * (r02 - r20) + qx * (r21 - r12))
    dqx = 2.0 * (qy * (r01 + r10) + qz * (r02 + r20) + w * (r21 - r12) - 2.0 * qx * (r11 + r22))
    dqy = 2.0 * (qx * (r01 + r10) + qz * (r12 + r21) + w * (r02 - r20) - 2.0 * qy * (r00 + r22))
    dqz = 2.0 * (qx * (r02 + r20) + qy * (r12 + r21) + w * (r10 - r01) - 2.0 * qz * (r00 + r11))
    radial = dw * w + dqx * qx + dqy * qy + dqz * qz
    store(out, QUAT * LANES, (dw - radial * w) * inverse_norm)
    store(out, (QUAT + 1) * LANES, (dqx - radial * qx) * inverse_norm)
    store(out, (QUAT + 2) * LANES, (dqy - radial * qy) * inverse_norm)
    store(out, (QUAT + 3) * LANES, (dqz - radial * qz) * inverse_norm)


@inlined
def _scatter(lane, i, out, g_means, g_quats, g_log_scales, g_opacity_logits, g_offsets):
    """Copy a lane of the gradients to Gaussian `i`."""
    for k in range(3):
        g_means[i, k] = out[(MEAN + k) * LANES + lane]
        g_log_scales[i, k] = out[(LOG_SCALE + k) * LANES + lane]
    for k in range(4):
        g_quats[i, k] = out[(QUAT + k) * LANES + lane]
    g_opacity_logits[i] = out[LOGIT * LANES + lane]
    if len(g_offsets) > 0:
        g_offsets[i, 0] = out[OFFSET * LANES + lane]
        g_offsets[i, 1] = out[(OFFSET + 1) * LANES + lane]


@kernel(parallel=True)
def project_backward(model, view, side, antialiased, boxes, slots, g_model, g_offsets, g_colors, g_pose):
    """Sum each splat's gradient over its tiles and pull it back.

    Args:
        slots: in rows of `slot_width(6 + C)` (see `blend_backward`).
        g_model, g_offsets, g_colors: outputs, zero on entry; `g_offsets` is `[N, 2]` or `[0, 2]`.
        g_pose: output `[CHUNKS, 12]`, (W, t) row by row.
    """
    means, quats, log_scales, opacity_logits = model
    rotation, translation, intrinsics, size = view
    box, pair_starts, places = boxes
    used, slot_starts, slot_grads = slots
    g_means, g_quats, g_log_scales, g_opacity_logits = g_model
    n, channels, width = len(means), g_colors.shape[1], slot_width(G_COLORS + g_colors.shape[1])
    tiles_x = (int(size[0]) + side - 1) // side
    nothing = np.empty((0, 2), np.float32)
    for chunk in nb.prange(CHUNKS):
        group, scratch = np.zeros(INPUTS * LANES, np.float32), np.empty(24 * LANES, np.float32)
        moments, out = np.zeros(G_COLORS * LANES, np.float32), np.empty(INPUTS * LANES, np.float32)
        pose, row = np.zeros(12 * LANES, np.float64), np.empty(LANES, np.float32)
        chosen = np.empty(LANES, np.int64)
        count, stop = 0, (chunk + 1) * n // CHUNKS
        for i in range(chunk * n // CHUNKS, stop):
            found = 0
            if pair_starts[i] < pair_starts[i + 1]:
                sums, found = _sum_over_tiles(i, box, pair_starts, places, used, slot_starts, tiles_x, slot_grads, width)
            if found > 0:
                store(row, 0, sums)
                for c in range(channels):
                    g_colors[i, c] = row[G_COLORS + c]
                gather(count, i, means, quats, log_scales, opacity_logits, nothing, group)
                for k in range(G_COLORS):
                    moments[k * LANES + count] = row[k]
                chosen[count] = i
                count += 1
            if count == LANES or (i == stop - 1 and count > 0):
                for lane in range(count, LANES):  # a lane that stands for nothing repeats the last and adds nothing
                    gather(lane, chosen[count - 1], means, quats, log_scales, opacity_logits, nothing, group)
                    for k in range(G_COLORS):
                        moments[k * LANES + lane] = F(0)
                _pull_back_group(group, moments, rotation, translation, intrinsics, size, antialiased, scratch, out, pose)
                for lane in range(count):
                    _scatter(lane, chosen[lane], out, g_means, g_quats, g_log_scales, g_opacity_logits, g_offsets)
                count = 0
        for k in range(12):
            g_pose[chunk, k] = total(load(pose, k * LANES))


@kernel(parallel=True)
def gather_colors(boxes, slots, tiles_x, g_colors):
    """Sum each splat's colour gradients over its tiles: slots have rows of `slot_width(C)`, `g_colors` `[N, C]` is overwritten."""
    box, pair_starts, places = boxes
    used, slot_starts, slot_grads = slots
    n, width = len(g_colors), slot_width(g_colors.shape[1])
    for chunk in nb.prange(CHUNKS):
        row = np.empty(LANES, np.float32)
        for i in range(chunk * n // CHUNKS, (chunk + 1) * n // CHUNKS):
            store(row, 0, lanes_of(F(0)))
            if pair_starts[i] < pair_starts[i + 1]:
                sums, _ = _sum_over_tiles(i, box, pair_starts, places, used, slot_starts, tiles_x, slot_grads, width)
                store(row, 0, sums)
            for c in range(g_colors.shape[1]):
                g_colors[i, c] = row[c]
