"""The sizes of tiles."""

from __future__ import annotations

from rtgs.renderer.cpu import layout


def test_small_pictures_have_enough_tiles_to_share() -> None:
    assert [layout.tile_side(*size) for size in ((1920, 1080), (400, 400), (320, 256), (160, 120), (1, 1))] == [
        64,
        64,
        32,
        16,
        16,
    ]
