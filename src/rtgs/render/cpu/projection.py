"""Project Gaussians to splats, and take a splat's gradients back to Gaussian and pose. One loop iteration is one Gaussian.

Arithmetic is float64 inside an iteration (it is scalar code, so this costs nothing) and float32 in memory.

Letters, fixed here: W, t = camera_from_world; V = W·M with M = R(q)·diag(σ); U = J·V the 2×3 square root of the projected
covariance; (A, B, C) = the conic, i.e. the inverse covariance [[A, B], [B, C]].
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from rtgs.render.settings import ALPHA_MIN, COVARIANCE_BLUR_PX2, FRUSTUM_MARGIN

TILE = 16
CHUNKS = 64  # pose gradients are summed per chunk, then over chunks: the same sum for any number of threads
# Columns of a splat row; the colours follow.
X, Y, CONIC_A, CONIC_B, CONIC_C, OPACITY, REACH, HALF_HEIGHT, COLORS = range(9)
# Columns of a splat's gradient row; the colours follow.
G_X, G_Y, G_A, G_B, G_C, G_OPACITY, G_COLORS = range(7)
_LOG_CUTOFF = math.log(1.0 / ALPHA_MIN)


@nb.njit(inline="always")
def _camera_square_root(q, log_scale, rotation, m, v):
    """Fill M = R(q)·diag(exp log_scale) and V = W·M; return 1/|q|."""
    inv = 1.0 / max(math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), 1e-12)
    w, x, y, z = q[0] * inv, q[1] * inv, q[2] * inv, q[3] * inv
    s0, s1, s2 = math.exp(log_scale[0]), math.exp(log_scale[1]), math.exp(log_scale[2])
    m[0, 0] = (1 - 2 * (y * y + z * z)) * s0
    m[0, 1] = 2 * (x * y - w * z) * s1
    m[0, 2] = 2 * (x * z + w * y) * s2
    m[1, 0] = 2 * (x * y + w * z) * s0
    m[1, 1] = (1 - 2 * (x * x + z * z)) * s1
    m[1, 2] = 2 * (y * z - w * x) * s2
    m[2, 0] = 2 * (x * z - w * y) * s0
    m[2, 1] = 2 * (y * z + w * x) * s1
    m[2, 2] = (1 - 2 * (x * x + y * y)) * s2
    for i in range(3):
        for j in range(3):
            v[i, j] = rotation[i, 0] * m[0, j] + rotation[i, 1] * m[1, j] + rotation[i, 2] * m[2, j]
    return inv


@nb.njit(inline="always")
def _clamped_slopes(x, y, z, intrinsics, size):
    """x/z and y/z, held within the view plus a margin, and whether each was held."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * size[0] / fx, FRUSTUM_MARGIN * 0.5 * size[1] / fy
    slope_x, slope_y = x / z, y / z
    held_x = min(max(slope_x, -cx / fx - margin_x), (size[0] - cx) / fx + margin_x)
    held_y = min(max(slope_y, -cy / fy - margin_y), (size[1] - cy) / fy + margin_y)
    return held_x, held_y, held_x != slope_x, held_y != slope_y


@nb.njit(inline="always")
def tile_span(s, row, width, height):
    """First and one past the last tile of tile row `row` that the splat's ellipse touches at a pixel centre."""
    a, b, c = float(s[CONIC_A]), float(s[CONIC_B]), float(s[CONIC_C])
    t2, det = 2.0 * s[REACH], a * c - b * b
    half_h, half_w = math.sqrt(t2 * a / det), math.sqrt(t2 * c / det)
    lo = max(row * TILE + 0.5 - s[Y], -half_h)
    hi = min(min(row * TILE + TILE, height) - 0.5 - s[Y], half_h)
    if lo > hi:
        return 0, 0
    # The rightmost point of the ellipse is at height −b/c·half_w; within the band the edge is nearest to it.
    at = min(max(-b / c * half_w, lo), hi)
    right = (-b * at + math.sqrt(max(a * t2 - det * at * at, 0.0))) / a
    at = min(max(b / c * half_w, lo), hi)
    left = (-b * at - math.sqrt(max(a * t2 - det * at * at, 0.0))) / a
    # A hundredth of a pixel of slack covers float32 rounding of the centre.
    first = max(math.ceil(s[X] + left - 0.51), 0.0)
    last = min(math.floor(s[X] + right - 0.49), width - 1.0)
    if first > last:
        return 0, 0
    return int(first) // TILE, int(last) // TILE + 1


@nb.njit(inline="always")
def tile_rows(s, height):
    """First and one past the last tile row of the splat's bounding box."""
    first = max(math.ceil(s[Y] - s[HALF_HEIGHT] - 0.51), 0.0)
    last = min(math.floor(s[Y] + s[HALF_HEIGHT] - 0.49), height - 1.0)
    if first > last:
        return 0, 0
    return int(first) // TILE, int(last) // TILE + 1


@nb.njit(parallel=True, cache=True, error_model="numpy")
def project(
    means,
    quats,
    log_scales,
    opacity_logits,
    offsets,
    rotation,
    translation,
    intrinsics,
    size,
    near,
    antialiased,
    splats,
    depths,
    tiles,
):
    """Fill `splats` `[N, 8]`, `depths` `[N]` and `tiles` `[N]` (tiles touched; 0 = not visible)."""
    for chunk in nb.prange(CHUNKS):
        m, v = np.empty((3, 3)), np.empty((3, 3))
        for i in range(chunk * len(means) // CHUNKS, (chunk + 1) * len(means) // CHUNKS):
            tiles[i] = 0
            mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
            z = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz + translation[2]
            if not z > near:
                continue
            x = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz + translation[0]
            y = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz + translation[1]
            opacity = 1.0 / (1.0 + math.exp(-opacity_logits[i]))
            if not opacity > ALPHA_MIN:
                continue
            _camera_square_root(quats[i], log_scales[i], rotation, m, v)
            sx, sy, _, _ = _clamped_slopes(x, y, z, intrinsics, size)
            jx, jy = intrinsics[0] / z, intrinsics[1] / z
            a = b = c = 0.0
            for j in range(3):
                ux, uy = jx * (v[0, j] - sx * v[2, j]), jy * (v[1, j] - sy * v[2, j])
                a += ux * ux
                b += ux * uy
                c += uy * uy
            det_sharp = a * c - b * b
            a += COVARIANCE_BLUR_PX2
            c += COVARIANCE_BLUR_PX2
            det = a * c - b * b
            if antialiased:
                opacity *= math.sqrt(max(det_sharp / det, 1e-12))
                if not opacity > ALPHA_MIN:
                    continue
            if not det < np.inf:
                continue
            s = splats[i]
            s[X] = intrinsics[0] * x / z + intrinsics[2] + offsets[i, 0]
            s[Y] = intrinsics[1] * y / z + intrinsics[3] + offsets[i, 1]
            s[CONIC_A] = c / det
            s[CONIC_B] = -b / det
            s[CONIC_C] = a / det
            s[OPACITY] = opacity
            s[REACH] = math.log(opacity) + _LOG_CUTOFF
            s[HALF_HEIGHT] = math.sqrt(2.0 * s[REACH] * c)
            # The conic of a needle loses its determinant to float32; what is left out here could not be drawn either.
            if not float(s[CONIC_A]) * float(s[CONIC_C]) > float(s[CONIC_B]) * float(s[CONIC_B]):
                continue
            depths[i] = z
            first, last = tile_rows(s, size[1])
            count = 0
            for row in range(first, last):
                left, right = tile_span(s, row, size[0], size[1])
                count += right - left
            tiles[i] = count


@nb.njit(parallel=True, cache=True, error_model="numpy")
def project_backward(
    means,
    quats,
    log_scales,
    opacity_logits,
    rotation,
    translation,
    intrinsics,
    size,
    antialiased,
    order,
    starts,
    slots,
    slot_grads,
    g_means,
    g_quats,
    g_log_scales,
    g_opacity_logits,
    g_offsets,
    g_colors,
    g_pose,
):
    """Sum each splat's gradient over its tiles and pull it back.

    Args:
        order: `[V]`, rank → Gaussian; `starts` `[V + 1]` into `slots`, which index `slot_grads` `[S, 6 + C]`.
        g_*: outputs, zero on entry; `g_pose` `[CHUNKS, 12]` is (W, t) row by row.
    """
    channels = slot_grads.shape[1] - G_COLORS
    for chunk in nb.prange(CHUNKS):
        m, v, dv = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
        g = np.empty(slot_grads.shape[1])
        for rank in range(chunk * len(order) // CHUNKS, (chunk + 1) * len(order) // CHUNKS):
            g[:] = 0.0
            for j in range(starts[rank], starts[rank + 1]):
                row = slot_grads[slots[j]]
                for k in range(len(g)):
                    g[k] += row[k]
            i = order[rank]
            for k in range(channels):
                g_colors[i, k] = g[G_COLORS + k]
            g_offsets[i, 0] = g[G_X]
            g_offsets[i, 1] = g[G_Y]

            mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
            x = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz + translation[0]
            y = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz + translation[1]
            z = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz + translation[2]
            q, log_scale = quats[i], log_scales[i]
            inv_norm = _camera_square_root(q, log_scale, rotation, m, v)
            sx, sy, held_x, held_y = _clamped_slopes(x, y, z, intrinsics, size)
            fx, fy = intrinsics[0], intrinsics[1]
            jx, jy = fx / z, fy / z
            a = b = c = 0.0
            for j in range(3):
                ux, uy = jx * (v[0, j] - sx * v[2, j]), jy * (v[1, j] - sy * v[2, j])
                a += ux * ux
                b += ux * uy
                c += uy * uy
            det_sharp = a * c - b * b
            a_sharp, c_sharp = a, c
            a += COVARIANCE_BLUR_PX2
            c += COVARIANCE_BLUR_PX2
            det = a * c - b * b
            conic_a, conic_b, conic_c = c / det, -b / det, a / det

            # dL/dΣ = −Q·G·Q with Q the conic and G its gradient, both symmetric: (h00, h01, h11).
            ga, gb, gc = g[G_A], 0.5 * g[G_B], g[G_C]
            p00, p01 = conic_a * ga + conic_b * gb, conic_a * gb + conic_b * gc
            p10, p11 = conic_b * ga + conic_c * gb, conic_b * gb + conic_c * gc
            h00 = -(p00 * conic_a + p01 * conic_b)
            h01 = -(p00 * conic_b + p01 * conic_c)
            h11 = -(p10 * conic_b + p11 * conic_c)

            opacity = 1.0 / (1.0 + math.exp(-opacity_logits[i]))
            g_opacity = g[G_OPACITY]
            if antialiased:
                ratio = det_sharp / det
                factor = math.sqrt(max(ratio, 1e-12))
                if ratio > 1e-12:
                    # d ln factor = ½·(tr Σ₀⁻¹dΣ − tr Σ⁻¹dΣ)
                    k = 0.5 * g_opacity * opacity * factor
                    h00 += k * (c_sharp / det_sharp - conic_a)
                    h01 += k * (-b / det_sharp - conic_b)
                    h11 += k * (a_sharp / det_sharp - conic_c)
                g_opacity *= factor
            g_opacity_logits[i] = g_opacity * opacity * (1.0 - opacity)

            # Σ = U·Uᵀ, U = J·V; J = [[jx, 0, −jx·sx], [0, jy, −jy·sy]].
            dj00 = dj02 = dj11 = dj12 = 0.0
            for j in range(3):
                ux, uy = jx * (v[0, j] - sx * v[2, j]), jy * (v[1, j] - sy * v[2, j])
                dux, duy = 2.0 * (h00 * ux + h01 * uy), 2.0 * (h01 * ux + h11 * uy)
                dj00 += dux * v[0, j]
                dj02 += dux * v[2, j]
                dj11 += duy * v[1, j]
                dj12 += duy * v[2, j]
                dv[0, j] = jx * dux
                dv[1, j] = jy * duy
                dv[2, j] = -jx * sx * dux - jy * sy * duy
            dx, dy = jx * g[G_X], jy * g[G_Y]
            dz = -(jx * x * g[G_X] + jy * y * g[G_Y]) / z
            dz += -(jx * dj00 + jy * dj11) / z
            if held_x:
                dz += jx * sx / z * dj02
            else:
                dx += -jx / z * dj02
                dz += 2.0 * jx * sx / z * dj02
            if held_y:
                dz += jy * sy / z * dj12
            else:
                dy += -jy / z * dj12
                dz += 2.0 * jy * sy / z * dj12

            g_means[i, 0] = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
            g_means[i, 1] = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
            g_means[i, 2] = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
            pose = g_pose[chunk]
            for r in range(3):
                d = dx if r == 0 else (dy if r == 1 else dz)
                pose[3 * r] += d * mx + dv[r, 0] * m[0, 0] + dv[r, 1] * m[0, 1] + dv[r, 2] * m[0, 2]
                pose[3 * r + 1] += d * my + dv[r, 0] * m[1, 0] + dv[r, 1] * m[1, 1] + dv[r, 2] * m[1, 2]
                pose[3 * r + 2] += d * mz + dv[r, 0] * m[2, 0] + dv[r, 1] * m[2, 1] + dv[r, 2] * m[2, 2]
                pose[9 + r] += d

            # dM = Wᵀ·dV, then M = R(q)·diag(σ); v is free to hold dR.
            for j in range(3):
                sigma = math.exp(log_scale[j])
                along = 0.0
                for k in range(3):
                    dm = rotation[0, k] * dv[0, j] + rotation[1, k] * dv[1, j] + rotation[2, k] * dv[2, j]
                    along += dm * m[k, j]
                    v[k, j] = dm * sigma
                g_log_scales[i, j] = along
            w, qx, qy, qz = q[0] * inv_norm, q[1] * inv_norm, q[2] * inv_norm, q[3] * inv_norm
            dw = 2 * (qz * (v[1, 0] - v[0, 1]) + qy * (v[0, 2] - v[2, 0]) + qx * (v[2, 1] - v[1, 2]))
            dqx = 2 * (
                qy * (v[0, 1] + v[1, 0]) + qz * (v[0, 2] + v[2, 0]) + w * (v[2, 1] - v[1, 2]) - 2 * qx * (v[1, 1] + v[2, 2])
            )
            dqy = 2 * (
                qx * (v[0, 1] + v[1, 0]) + qz * (v[1, 2] + v[2, 1]) + w * (v[0, 2] - v[2, 0]) - 2 * qy * (v[0, 0] + v[2, 2])
            )
            dqz = 2 * (
                qx * (v[0, 2] + v[2, 0]) + qy * (v[1, 2] + v[2, 1]) + w * (v[1, 0] - v[0, 1]) - 2 * qz * (v[0, 0] + v[1, 1])
            )
            radial = dw * w + dqx * qx + dqy * qy + dqz * qz
            g_quats[i, 0] = (dw - radial * w) * inv_norm
            g_quats[i, 1] = (dqx - radial * qx) * inv_norm
            g_quats[i, 2] = (dqy - radial * qy) * inv_norm
            g_quats[i, 3] = (dqz - radial * qz) * inv_norm


@nb.njit(parallel=True, cache=True)
def gather_colors(order, starts, slots, slot_grads, g_colors):
    """The colour columns of `project_backward` alone."""
    for chunk in nb.prange(CHUNKS):
        for rank in range(chunk * len(order) // CHUNKS, (chunk + 1) * len(order) // CHUNKS):
            for k in range(g_colors.shape[1]):
                total = 0.0
                for j in range(starts[rank], starts[rank + 1]):
                    total += slot_grads[slots[j], G_COLORS + k]
                g_colors[order[rank], k] = total
