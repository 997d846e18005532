"""Sixteen numbers in one register: functions, sums, masks, copies, and threads that draw their work."""

from __future__ import annotations

import numba as nb
import numpy as np
import pytest

from rtgs.renderer.cpu import simd
from rtgs.renderer.cpu.simd import LANES, load, store, take_next

# Compiled functions stay without annotations: Numba infers their types, and declares its intrinsics with a parameter too many.


@nb.njit
def _apply(which, x, out):  # type: ignore[no-untyped-def]
    for at in range(0, len(x), LANES):
        v = load(x, at)
        if which == 0:
            store(out, at, simd.exp2_below_one(v))
        elif which == 1:
            store(out, at, simd.exponential(v))
        elif which == 2:
            store(out, at, simd.log2(v))
        elif which == 3:
            store(out, at, simd.negative_magnitude(v))
        elif which == 4:
            store(out, at, simd.where(v > 0.0, simd.square_root(v), -v))
        elif which == 5:
            store(out, at, simd.minimum(simd.maximum(v, -1.0), 2.0))
        else:
            store(out, at, simd.floor(v) + simd.ceil(v) * 2.0 + simd.magnitude(v) / 4.0)


def _lanes(which: int, x: np.ndarray) -> np.ndarray:
    x = x.astype(np.float32)
    out = np.empty_like(x)
    _apply(which, x, out)
    return out


def test_exponentials_and_logarithm_are_good_to_float32() -> None:
    # Where the argument itself is not exact in float32, x·log₂e is rounded to 6e-8 of up to 126.
    t = np.linspace(-125.9, 0.0, 64_000)
    np.testing.assert_allclose(_lanes(0, t), np.exp2(t.astype(np.float32).astype(np.float64)), rtol=2.5e-7)
    x = np.linspace(-87.0, 87.0, 64_000)
    np.testing.assert_allclose(_lanes(1, x), np.exp(x.astype(np.float32).astype(np.float64)), rtol=1e-5)
    near = np.linspace(-8.0, 8.0, 64_000)
    np.testing.assert_allclose(_lanes(1, near), np.exp(near.astype(np.float32).astype(np.float64)), rtol=1e-6)
    a = np.exp(np.linspace(-20.0, 20.0, 64_000))
    np.testing.assert_allclose(_lanes(2, a), np.log2(a.astype(np.float32).astype(np.float64)), rtol=2e-7, atol=2e-7)
    exact = 2.0 ** np.arange(-16, 16)
    np.testing.assert_array_equal(_lanes(2, exact), np.arange(-16, 16))
    assert np.isfinite(_lanes(1, np.full(16, 1e4))).all() and (_lanes(1, np.full(16, -1e4)) < 1e-37).all()


def test_lane_functions_are_numpys() -> None:
    x = np.random.default_rng(0).normal(size=160).astype(np.float32) * 3
    np.testing.assert_array_equal(_lanes(3, x), -np.abs(x))
    np.testing.assert_array_equal(_lanes(4, x), np.where(x > 0, np.sqrt(np.abs(x)), -x))
    np.testing.assert_array_equal(_lanes(5, x), np.clip(x, -1, 2))
    np.testing.assert_allclose(_lanes(6, x), np.floor(x) + 2 * np.ceil(x) + np.abs(x) / 4, rtol=1e-6)


@nb.njit
def _reduce(x, wide):  # type: ignore[no-untyped-def]
    v = load(x, 0)
    bits = simd.mask_bits(v > 0.0)
    lowest = simd.lowest_bit(bits) if bits != 0 else -1
    a_sum, b_sum = simd.total(v), simd.total(load(wide, 0))
    return a_sum, b_sum, bits, lowest, simd.any_lane(v > 2.0), simd.total(simd.widen(v)), simd.total(simd.lane_numbers())


@pytest.mark.parametrize("seed", range(4))
def test_sums_and_masks(seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=16).astype(np.float32)
    wide = np.random.default_rng(seed + 9).normal(size=16)
    a_sum, b_sum, bits, lowest, any_above, widened, numbers = _reduce(x, wide)
    assert a_sum == pytest.approx(x.sum(), abs=1e-6) and b_sum == pytest.approx(wide.sum(), abs=1e-13)
    assert bits == sum(1 << k for k in range(16) if x[k] > 0) and lowest == np.flatnonzero(x > 0)[0]
    assert any_above == (x > 2).any() and widened == pytest.approx(x.astype(np.float64).sum(), abs=1e-13) and numbers == 120


@nb.njit
def _copy_half(to, start, array, index):  # type: ignore[no-untyped-def]
    simd.copy_half(to, start, array, index)


@pytest.mark.parametrize("kind", [np.float32, np.uint16])
def test_half_a_register_is_copied(kind: type) -> None:
    array: np.ndarray = np.arange(40).astype(kind)
    to = np.zeros_like(array)
    _copy_half(to, 3, array, 21)
    np.testing.assert_array_equal(to[3:11], array[21:29])
    assert not to[:3].any() and not to[11:].any()


@nb.njit(parallel=True)
def _drawn(threads, numbers):  # type: ignore[no-untyped-def]
    taken, found = np.zeros(1, np.int64), np.zeros((threads, numbers), np.int64)
    for thread in nb.prange(threads):
        for _ in range(numbers):
            number = take_next(taken)
            if number >= numbers:
                break
            found[thread, number] += 1
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("threads", [1, 2, 5])
def test_threads_draw_every_number_once(threads: int) -> None:
    assert (_drawn(threads, 20_000).sum(axis=0) == 1).all()
