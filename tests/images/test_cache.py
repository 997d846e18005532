"""A bounded store of images: what is asked for is right, and the store never grows beyond its limit."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.images.cache import ImageCache

IMAGE_BYTES = 4 * 100


def image(i: int) -> NDArray[np.float32]:
    return np.full((10, 10), i, np.float32)


def test_an_image_is_the_one_of_its_key_whatever_had_to_go() -> None:
    cache = ImageCache(3 * IMAGE_BYTES)
    for i in np.random.default_rng(0).integers(0, 10, 200).tolist():
        np.testing.assert_array_equal(cache.get(i, partial(image, i)), image(i))
        assert cache.bytes <= cache.max_bytes


def test_the_images_used_last_are_kept() -> None:
    cache = ImageCache(2 * IMAGE_BYTES)
    a, b = cache.get("a", lambda: image(1)), cache.get("b", lambda: image(2))
    assert cache.get("a", lambda: image(1)) is a
    cache.get("c", lambda: image(3))  # "b" goes: it was used before "a"
    assert cache.get("a", lambda: image(1)) is a
    assert cache.get("b", lambda: image(2)) is not b


@pytest.mark.parametrize("max_bytes", [0, IMAGE_BYTES - 1])
def test_an_image_that_does_not_fit_is_given_and_not_kept(max_bytes: int) -> None:
    cache = ImageCache(max_bytes)
    np.testing.assert_array_equal(cache.get("a", lambda: image(1)), image(1))
    assert cache.bytes == 0


def test_a_failure_is_raised_and_leaves_nothing_behind() -> None:
    cache = ImageCache(IMAGE_BYTES)

    def broken() -> NDArray[np.float32]:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        cache.get("a", broken)
    assert cache.bytes == 0
    np.testing.assert_array_equal(cache.get("a", lambda: image(1)), image(1))


def test_threads_get_the_right_images() -> None:
    cache = ImageCache(3 * IMAGE_BYTES)
    wanted = np.random.default_rng(1).integers(0, 8, 2000).tolist()
    with ThreadPoolExecutor(8) as pool:
        found = pool.map(lambda i: float(cache.get(i, lambda: image(i)).mean()), wanted)
        assert list(found) == wanted
    assert cache.bytes <= cache.max_bytes


def test_a_cleared_store_makes_images_again() -> None:
    cache = ImageCache(2 * IMAGE_BYTES)
    before = cache.get("a", lambda: image(1))
    cache.clear()
    assert cache.bytes == 0
    again = cache.get("a", lambda: image(1))
    assert again is not before
    np.testing.assert_array_equal(again, before)
    assert cache.bytes == IMAGE_BYTES
