"""Thermal files that hold no temperature in places, or cannot be right: masked with a count said, converted or refused."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.captures import NAMES, edit_rig, refused, thermal_counts

from rtgs.io.capture import load_capture
from rtgs.io.image_files import read_counts
from rtgs.io.thermal_files import thermal_values
from rtgs.records.radiometry import CELSIUS, CENTIKELVIN, CountsToCelsius, Radiometry, RelativeCounts

HOLE = (slice(10, 13), slice(20, 22))  # six pixels


def write_thermal(root: Path, index: int, counts: NDArray[Any], suffix: str = ".tiff", **options: Any) -> Path:
    path = root / "thermal" / f"{NAMES[index]}.tiff"
    path.unlink()
    path = path.with_suffix(suffix)
    Image.fromarray(counts).save(path, **options)
    return path


def use_celsius(root: Path, per_count: float, offset: float) -> None:
    edit_rig(root, lambda d: d["thermal"].update(celsius_per_count=per_count, celsius_offset=offset))


def use_counts(root: Path) -> None:
    edit_rig(root, lambda d: [d["thermal"].pop(key) for key in ("celsius_per_count", "celsius_offset")])


@pytest.mark.parametrize(
    ("radiometry", "level", "mark", "dtype"),
    [
        (CELSIUS, 20.0, -9999.0, np.float32),
        (CELSIUS, 20.0, -3.4028235e38, np.float32),
        (CELSIUS, 20.0, 3.4028235e38, np.float32),
        (CELSIUS, 20.0, -273.15, np.float32),
        (CELSIUS, 20.0, 5000.0, np.float32),
        (CENTIKELVIN, 29315, 0, np.uint16),
        (CENTIKELVIN, 29315, -9999, np.int32),
        (None, 7000.0, -9999.0, np.float32),
        (None, 7000, -32768, np.int32),
        (None, 7000.0, -3.4028235e38, np.float32),
    ],
)
def test_pixels_without_a_temperature_are_left_out_and_counted(
    root: Path, radiometry: CountsToCelsius | None, level: float, mark: float, dtype: type
) -> None:
    if radiometry is None:
        use_counts(root)
    else:
        use_celsius(root, radiometry.celsius_per_count, radiometry.celsius_offset)
    for i in range(5):
        counts = thermal_counts(level + i, dtype)
        if i in (1, 3):
            counts[HOLE] = mark
        write_thermal(root, i, counts)
    capture = load_capture(root)
    expected = np.ones((32, 40), bool)
    expected[HOLE] = False
    np.testing.assert_array_equal(capture.thermal_mask, expected)
    values = (radiometry or RelativeCounts()).values(thermal_counts(level + 1, dtype))
    np.testing.assert_array_equal(capture.frames[1].thermal, values)  # the neighbours of the hole have one value
    (said,) = capture.warnings
    assert "12 pixels in 2 of the 5 images in thermal/ hold no temperature" in said


def test_a_lens_spreads_what_is_left_out(root: Path) -> None:
    """An undistorted pixel counts only if every pixel it is made from does."""
    edit_rig(root, lambda d: d["thermal"].update(model="SIMPLE_RADIAL", k1=-0.1))
    before = load_capture(root).thermal_mask
    counts = thermal_counts(4800)
    counts[HOLE] = 65535
    use_celsius(root, 0.1, -460.0)
    write_thermal(root, 0, counts)
    capture = load_capture(root)
    lost = before & ~capture.thermal_mask
    assert 6 < lost.sum() < 30
    assert max(frame.thermal.max() for frame in capture.frames) < 21


def test_the_tag_of_gdal_is_heeded(tmp_path: Path) -> None:
    counts = thermal_counts(30000)
    counts[HOLE] = 29000
    path = tmp_path / "a.tiff"
    Image.fromarray(counts).save(path, tiffinfo={0xA481: "29000 "})
    values, no_data = thermal_values(path, CENTIKELVIN)
    assert no_data is not None and no_data[HOLE].all() and no_data.sum() == 6
    np.testing.assert_array_equal(values, CENTIKELVIN.values(thermal_counts(30000)))


def test_a_frame_with_hardly_a_temperature_is_refused(root: Path) -> None:
    counts = thermal_counts(4800)
    counts[:10] = 0
    use_celsius(root, 0.04, -173.0)
    path = write_thermal(root, 2, counts)
    refused(root, path.name, "31% of its pixels hold no temperature", "right unit", "remove this pair")


def test_holes_that_together_leave_little_are_refused(root: Path) -> None:
    use_celsius(root, 0.04, -173.0)
    for i in range(5):
        counts = thermal_counts(4800 + i)
        counts[6 + 5 * i : 11 + 5 * i] = 0
        write_thermal(root, i, counts)
    refused(root, "thermal", "together with 4 other thermal images", "without a temperature")


def test_a_constant_frame_is_refused(root: Path) -> None:
    path = write_thermal(root, 3, np.full((32, 40), 4801, np.uint16))
    refused(root, path.name, "all its pixels have the value 20.025", "Remove this pair")


def test_a_frozen_frame_is_refused(root: Path) -> None:
    path = write_thermal(root, 3, thermal_counts(4802))
    refused(root, path.name, f"the same thermal image as {NAMES[2]}.tiff to the last bit", "RGB image has changed")


def test_a_pair_that_is_there_twice_is_not_frozen(root: Path) -> None:
    write_thermal(root, 3, thermal_counts(4802))
    rgb = [root / "rgb" / f"{NAMES[i]}.png" for i in (2, 3)]
    rgb[1].write_bytes(rgb[0].read_bytes())
    load_capture(root)


@pytest.mark.parametrize("offset", [273.15, -70.0, 150.0])
def test_a_frame_in_another_unit_is_refused(root: Path, offset: float) -> None:
    use_celsius(root, 1.0, 0.0)
    for i in range(5):
        write_thermal(root, i, thermal_counts(20.0 + i + (offset if i == 3 else 0), np.float32))
    refused(root, f"{NAMES[3]}.tiff", "its median is", "another unit")


def test_frames_that_drift_and_see_hot_things_are_accepted(root: Path) -> None:
    for i in range(5):
        counts = thermal_counts(4800 + 400 * i)  # 40 °C from first to last
        counts[12:20, 12:20] = 4800 + 6000 * i  # to 600 °C
        write_thermal(root, i, counts)
    assert load_capture(root).warnings == ()


def test_eight_bit_frames_among_others_are_refused(root: Path) -> None:
    path = write_thermal(root, 1, thermal_counts(100, np.uint8), ".png")
    refused(root, path.name, f"has 8 bits a pixel and {NAMES[0]}.tiff has more")


@pytest.mark.parametrize(("celsius", "loads"), [(True, False), (False, True)])
def test_a_jpeg_holds_no_temperatures(root: Path, celsius: bool, loads: bool) -> None:
    """Its compression changes counts. A picture of relative intensity may be one."""
    paths = [write_thermal(root, i, thermal_counts(100 + i, np.uint8), ".jpg") for i in range(5)]
    if not celsius:
        use_counts(root)
    if loads:
        load_capture(root)
    else:
        refused(root, paths[0].name, "is a JPEG", "16-bit TIFF or PNG")


def set_tag(path: Path, tag: int, value: int) -> None:
    """Change a number in the directory of a little-endian TIFF, which Pillow does not let its caller choose."""
    data = bytearray(path.read_bytes())
    start = struct.unpack_from("<I", data, 4)[0]
    (entry,) = [
        at
        for at in range(start + 2, start + 2 + 12 * struct.unpack_from("<H", data, start)[0], 12)
        if struct.unpack_from("<H", data, at)[0] == tag
    ]
    struct.pack_into("<H", data, entry + 8, value)
    path.write_bytes(data)


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw"])
def test_counts_are_the_stored_numbers_of_a_min_is_white_tiff(tmp_path: Path, compression: str) -> None:
    counts = np.arange(256, dtype=np.uint8).reshape(8, 32)
    path = tmp_path / "a.tiff"
    Image.fromarray(counts).save(path, compression=compression)
    set_tag(path, 0x0106, 0)
    np.testing.assert_array_equal(read_counts(path), counts)


def test_unsigned_counts_of_32_bits(tmp_path: Path) -> None:
    counts = np.array([[0, 2**31 - 1, 2**31, 2**32 - 1], [1, 2, 3, 4]], dtype=np.uint32)
    path = tmp_path / "a.tiff"
    Image.fromarray(counts.view(np.int32)).save(path)
    set_tag(path, 0x0153, 1)
    np.testing.assert_array_equal(read_counts(path), counts)
    Image.fromarray(counts.view(np.int32)).save(path)
    np.testing.assert_array_equal(read_counts(path), counts.view(np.int32))


@pytest.mark.parametrize("radiometry", [CELSIUS, RelativeCounts()])
def test_good_values_come_through_as_they_are(tmp_path: Path, radiometry: Radiometry) -> None:
    counts = np.random.default_rng(0).uniform(-40, 900, (32, 40)).astype(np.float32)
    path = tmp_path / "a.tiff"
    Image.fromarray(counts).save(path)
    values, no_data = thermal_values(path, radiometry)
    assert no_data is None
    np.testing.assert_array_equal(values, counts)
