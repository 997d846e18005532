"""The few per-channel steps of the blending kernels, written out for 1–4 channels.

LLVM keeps a splat's colours in registers and vectorises the pixel row only when the channel loop does not exist; one specialisation
a channel count is worth a factor of three. The count travels as the length of a tuple, so it is part of the compiled type.
"""

from __future__ import annotations

from numba.extending import overload

from rtgs.render.cpu.projection import COLORS

MAX_CHANNELS = 4


def colors_of(splat, channels):
    """The splat's colours as a tuple of C scalars."""
    raise NotImplementedError("compiled code only")


def add_color(color, r: int, i: int, weight, values):
    """`color[q, r, i] += weight · values[q]` for each channel q."""
    raise NotImplementedError("compiled code only")


def dot_gradient(grad, r: int, i: int, values):
    """`Σ_q grad[q, r, i] · values[q]`, plus the gradient of alpha, which is channel C of `grad`."""
    raise NotImplementedError("compiled code only")


def add_color_gradient(lanes, i: int, weight, grad, r: int, channels):
    """`lanes[q, i] += weight · grad[q, r, i]` for each channel q."""
    raise NotImplementedError("compiled code only")


@overload(colors_of, inline="always")
def _colors_of(splat, channels):
    return [
        lambda splat, channels: (splat[COLORS],),
        lambda splat, channels: (splat[COLORS], splat[COLORS + 1]),
        lambda splat, channels: (splat[COLORS], splat[COLORS + 1], splat[COLORS + 2]),
        lambda splat, channels: (splat[COLORS], splat[COLORS + 1], splat[COLORS + 2], splat[COLORS + 3]),
    ][len(channels) - 1]


@overload(add_color, inline="always")
def _add_color(color, r, i, weight, values):
    def one(color, r, i, weight, values):
        color[0, r, i] += weight * values[0]

    def two(color, r, i, weight, values):
        color[0, r, i] += weight * values[0]
        color[1, r, i] += weight * values[1]

    def three(color, r, i, weight, values):
        color[0, r, i] += weight * values[0]
        color[1, r, i] += weight * values[1]
        color[2, r, i] += weight * values[2]

    def four(color, r, i, weight, values):
        color[0, r, i] += weight * values[0]
        color[1, r, i] += weight * values[1]
        color[2, r, i] += weight * values[2]
        color[3, r, i] += weight * values[3]

    return [one, two, three, four][len(values) - 1]


@overload(dot_gradient, inline="always")
def _dot_gradient(grad, r, i, values):
    return [
        lambda grad, r, i, values: grad[0, r, i] * values[0] + grad[1, r, i],
        lambda grad, r, i, values: grad[0, r, i] * values[0] + grad[1, r, i] * values[1] + grad[2, r, i],
        lambda grad, r, i, values: (
            grad[0, r, i] * values[0] + grad[1, r, i] * values[1] + grad[2, r, i] * values[2] + grad[3, r, i]
        ),
        lambda grad, r, i, values: (
            grad[0, r, i] * values[0]
            + grad[1, r, i] * values[1]
            + grad[2, r, i] * values[2]
            + grad[3, r, i] * values[3]
            + grad[4, r, i]
        ),
    ][len(values) - 1]


@overload(add_color_gradient, inline="always")
def _add_color_gradient(lanes, i, weight, grad, r, channels):
    def one(lanes, i, weight, grad, r, channels):
        lanes[0, i] += weight * grad[0, r, i]

    def two(lanes, i, weight, grad, r, channels):
        lanes[0, i] += weight * grad[0, r, i]
        lanes[1, i] += weight * grad[1, r, i]

    def three(lanes, i, weight, grad, r, channels):
        lanes[0, i] += weight * grad[0, r, i]
        lanes[1, i] += weight * grad[1, r, i]
        lanes[2, i] += weight * grad[2, r, i]

    def four(lanes, i, weight, grad, r, channels):
        lanes[0, i] += weight * grad[0, r, i]
        lanes[1, i] += weight * grad[1, r, i]
        lanes[2, i] += weight * grad[2, r, i]
        lanes[3, i] += weight * grad[3, r, i]

    return [one, two, three, four][len(channels) - 1]
