"""FLIR's radiometric JPEGs: the sample files against flyr, made-up files against what was put into them, damage by name."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path

import flyr
import numpy as np
import pytest
from flyr.thermogram import FlyrThermogram
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.radiometric_files import (
    FIELD_OF_VIEW_DEG,
    GPS,
    RADIOMETRY,
    SAMPLES,
    THERMAL_SIZE,
    VISIBLE_SIZE,
    camera_exif,
    camera_record,
    counts_of,
    encoded,
    fff,
    flir_jpeg,
    flir_segments,
    fusion_record,
    image_record,
    jpeg,
    needs_samples,
    raw_record,
    records,
)

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.flir import FlirImage, is_flir, read_flir

READABLE = ("FLIR.jpg", "FLIR_AX8.jpg", "FLIR_E40.jpg", "FLIR_T640.jpg")
CHANGES = ({"emissivity": 0.6}, {"reflected_c": -15.0}, {"distance_m": 12.0}, {"window_transmission": 0.9, "window_c": 35.0})
FLYRS_NAMES = {
    "emissivity": "emissivity",
    "reflected_c": "reflected_apparent_temperature",
    "distance_m": "object_distance",
    "window_transmission": "ir_window_transmission",
    "window_c": "ir_window_temperature",
}


@cache
def flyrs(name: str) -> FlyrThermogram:
    """Read once: flyr turns 16-bit PNGs around pixel by pixel."""
    return flyr.unpack(str(SAMPLES / name))


def in_flyrs_terms(changes: dict[str, float]) -> dict[str, float]:
    return {FLYRS_NAMES[name]: value + 273.15 * name.endswith("_c") for name, value in changes.items()}


# ---------------------------------------------------------------------------------------------------- sample files


@needs_samples
@pytest.mark.parametrize("name", READABLE)
def test_temperatures_agree_with_flyr(name: str) -> None:
    image, theirs = read_flir(SAMPLES / name), flyrs(name)
    assert image.temperature_c.shape == theirs.celsius.shape
    # 0.1 °C is what is promised; the two formulas differ by a rounding of flyr's (273.17 for 273.15): 0.0006 °C at most here.
    np.testing.assert_allclose(image.temperature_c, theirs.celsius, atol=1e-3)


@needs_samples
@pytest.mark.parametrize("name", READABLE)
@pytest.mark.parametrize("changes", CHANGES, ids=lambda c: next(iter(c)))
def test_other_parameters_change_temperatures_as_flyr_has_it(name: str, changes: dict[str, float]) -> None:
    image = read_flir(SAMPLES / name)
    ours = image.radiometry.reevaluated(image.temperature_c, **changes)
    theirs = flyrs(name).adjust_metadata(**in_flyrs_terms(changes)).celsius
    assert np.abs(ours - image.temperature_c).max() > 0.02
    np.testing.assert_allclose(ours, theirs, atol=2e-3)


@needs_samples
@pytest.mark.parametrize(
    ("name", "difference_c"), [("FLIR.jpg", 0.09), ("FLIR_AX8.jpg", 0.01), ("FLIR_E40.jpg", 0.03), ("FLIR_T640.jpg", 0.15)]
)
def test_where_the_window_stands_matters_little(name: str, difference_c: float) -> None:
    """All the air on one side of the window, as in the formula of FLIR's manuals, instead of half on each: the largest change of any pixel.

    One leg of twice the half distance, with its transmission spread evenly over both legs, is that other formula here: of these
    files only the E40's has a window, and it is near the air's temperature.
    """
    image = read_flir(SAMPLES / name)
    p, atmosphere = image.radiometry.parameters, image.radiometry.calibration.atmosphere
    one_leg = replace(image.radiometry)
    whole = atmosphere.transmission(p.distance_m, p.atmospheric_c, p.relative_humidity)
    one_leg.__dict__["_leg_transmission"] = np.sqrt(whole)
    difference = np.abs(one_leg.celsius(image.counts) - image.temperature_c).max()
    assert difference == pytest.approx(difference_c, abs=0.005)


@needs_samples
def test_the_xt2_whose_directory_flyr_does_not_read() -> None:
    """Its FFF directory has two entries, and flyr 5.1 passes over the last two. flyr's formula, given our counts, is the yardstick."""
    image = read_flir(SAMPLES / "DJI_XT2.jpg")
    assert image.counts.shape == (512, 640) and image.make == "DJI" and image.visible_file is None
    p, c = image.radiometry.parameters, image.radiometry.calibration
    assert (p.emissivity, p.distance_m, p.reflected_c, p.atmospheric_c) == (1.0, 20.0, 22.0, 40.0)
    values = {
        "atmospheric_temperature": p.atmospheric_c + 273.15,
        "reflected_apparent_temperature": p.reflected_c + 273.15,
        "ir_window_temperature": p.window_c + 273.15,
        "ir_window_transmission": p.window_transmission,
        "emissivity": p.emissivity,
        "object_distance": p.distance_m,
        "relative_humidity": p.relative_humidity,
        **{f"planck_{name}": getattr(c, name) for name in ("r1", "r2", "b", "f", "o")},
        **{f"atmospheric_trans_{name}": getattr(c.atmosphere, name) for name in ("alpha1", "alpha2", "beta1", "beta2", "x")},
    }
    np.testing.assert_allclose(image.temperature_c, FlyrThermogram(image.counts, values).celsius, atol=1e-3)
    assert 34 <= image.temperature_c[254:258, 318:322].mean() < 35  # its XMP says CentralTemperature 34, in whole degrees


@needs_samples
@pytest.mark.parametrize(
    ("name", "model", "size", "visible", "fov_deg", "real2ir"),
    [  # as ExifTool 12.57 reads them
        ("FLIR.jpg", "*", (240, 320), (480, 640), 35.4, 1.40397),
        ("FLIR_AX8.jpg", "FLIR AX8", (80, 60), (640, 480), 47.9, 1.16241),
        ("FLIR_E40.jpg", "FLIR E40", (160, 120), None, 25.0, None),
        ("FLIR_T640.jpg", "FLIR T640", (640, 480), (2592, 1944), 25.0, 3.49618),
    ],
)
def test_metadata_of_the_samples(
    name: str, model: str, size: tuple[int, int], visible: tuple[int, int] | None, fov_deg: float, real2ir: float | None
) -> None:
    image = read_flir(SAMPLES / name)
    assert image.model == model and image.counts.shape == size[::-1] and image.counts.dtype == np.uint16
    assert image.field_of_view_deg == pytest.approx(fov_deg, abs=0.05)
    assert (image.fusion and round(image.fusion.real2ir, 5)) == real2ir
    assert (None if image.visible_file is None else picture(image).size) == visible
    assert image.captured_at is not None
    assert bool(image.gps) == (name == "FLIR.jpg")  # the AX8's GPS pointer leads into other tags


@needs_samples
def test_the_t640_focal_length_is_that_of_its_lens() -> None:
    """24.5 mm (EXIF) over the T640's pixel pitch of 17 µm."""
    focal_length_px = read_flir(SAMPLES / "FLIR_T640.jpg").focal_length_px
    assert focal_length_px == pytest.approx(24.5 / 0.017, rel=0.01)


@needs_samples
@pytest.mark.parametrize("name", ["DJI_H20T.jpg", "DJI_M30T.jpg"])
def test_other_radiometric_files_are_refused_by_name(name: str) -> None:
    assert not is_flir(SAMPLES / name)
    with pytest.raises(RtgsError, match=rf"{name}: holds no FLIR thermal data"):
        read_flir(SAMPLES / name)


def picture(image: FlirImage) -> Image.Image:
    assert image.visible_file is not None
    return Image.open(io.BytesIO(image.visible_file))


# ---------------------------------------------------------------------------------------------------- made-up files


def test_what_was_put_in_comes_out(tmp_path: Path) -> None:
    counts = counts_of()
    image = read_flir(flir_jpeg(tmp_path / "a.jpg", counts))
    np.testing.assert_array_equal(image.counts, counts)
    p, c = RADIOMETRY.parameters, RADIOMETRY.calibration
    assert image.radiometry.parameters == p
    np.testing.assert_allclose([image.radiometry.calibration.r2, image.radiometry.calibration.r1], [c.r2, c.r1], rtol=1e-7)
    np.testing.assert_allclose(image.temperature_c, RADIOMETRY.celsius(counts), atol=1e-4)
    assert (image.make, image.model, image.serial, image.lens) == ("FLIR Systems AB", "FLIR T0", "12345", "FOL9")
    assert image.captured_at == datetime(2024, 5, 6, 7, 8, 9)
    assert image.gps[2] == GPS[2] and image.gps[1] == "N"
    assert image.fusion is not None and (image.fusion.real2ir, image.fusion.offset_x, image.fusion.offset_y) == (1.5, 1, -1)
    assert picture(image).size == VISIBLE_SIZE
    assert image.focal_length_px == pytest.approx(THERMAL_SIZE[0] / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG / 2)))


@pytest.mark.parametrize("directory_order", "<>")
@pytest.mark.parametrize("record_order", "<>")
@pytest.mark.parametrize("png", [True, False])
def test_either_byte_order_everywhere(tmp_path: Path, directory_order: str, record_order: str, png: bool) -> None:
    made = records(raw=raw_record(counts_of(3), record_order, png), camera=camera_record(order=record_order))
    image = read_flir(jpeg(tmp_path / "a.jpg", flir_segments(fff(made, directory_order))))
    np.testing.assert_array_equal(image.counts, counts_of(3))
    assert image.radiometry.parameters == RADIOMETRY.parameters


def test_air_outside_of_the_formula_names_the_file(tmp_path: Path) -> None:
    record = bytearray(camera_record())
    struct.pack_into("<f", record, 0x24, 1e6)  # the distance
    with pytest.raises(RtgsError, match=r"a\.jpg: object\.distance_m 1e\+06.*transmission of air.*Correct the object parameters"):
        read_flir(flir_jpeg(tmp_path / "a.jpg", camera=bytes(record)))


def smooth_counts() -> NDArray[np.uint16]:
    """Counts of 20 … 45 °C that change slowly, with noise of a few counts."""
    x, y = np.meshgrid(np.linspace(0, 1, THERMAL_SIZE[0]), np.linspace(0, 1, THERMAL_SIZE[1]))
    noise = np.random.default_rng(0).normal(0, 3, x.shape)
    return (RADIOMETRY.counts(20 + 15 * x + 10 * y) + noise).round().astype(np.uint16)


@pytest.mark.parametrize("swapped", [True, False])
def test_either_byte_order_within_a_png(tmp_path: Path, swapped: bool) -> None:
    """Neighbouring pixels tell it."""
    counts = smooth_counts()
    body = encoded(counts.byteswap() if swapped else counts, "PNG")
    image = read_flir(flir_jpeg(tmp_path / "a.jpg", raw=image_record("<", THERMAL_SIZE, body)))
    np.testing.assert_array_equal(image.counts, counts)


def test_a_byte_order_that_cannot_be_told_is_refused(tmp_path: Path) -> None:
    low = np.random.default_rng(0).integers(0, 256, THERMAL_SIZE[::-1]).astype(np.uint16)
    path = flir_jpeg(tmp_path / "a.jpg", low + 256 * low)  # both bytes are one
    with pytest.raises(RtgsError, match=r"a\.jpg: the byte order of its raw thermal image cannot be told"):
        read_flir(path)


def test_a_window_that_is_none_needs_no_temperature(tmp_path: Path) -> None:
    record = bytearray(camera_record())
    struct.pack_into("<ff", record, 0x30, 0.0, 1.0)
    parameters = read_flir(flir_jpeg(tmp_path / "a.jpg", camera=bytes(record))).radiometry.parameters
    assert parameters.window_transmission == 1.0
    assert parameters.window_c == parameters.atmospheric_c
    struct.pack_into("<ff", record, 0x30, 0.0, 0.9)
    with pytest.raises(RtgsError, match=r"object\.window_c is -273\.15"):
        read_flir(flir_jpeg(tmp_path / "b.jpg", camera=bytes(record)))


def test_humidity_in_per_cent(tmp_path: Path) -> None:
    image = read_flir(flir_jpeg(tmp_path / "a.jpg", camera=camera_record(per_cent=True)))
    assert image.radiometry.parameters.relative_humidity == 0.5


def test_segments_in_any_order(tmp_path: Path) -> None:
    segments = flir_segments(fff(records()), chunk=500)
    assert len(segments) > 4
    np.testing.assert_array_equal(read_flir(jpeg(tmp_path / "a.jpg", segments[::-1])).counts, counts_of())


def test_without_visible_image_fusion_and_field_of_view(tmp_path: Path) -> None:
    camera = bytearray(camera_record())
    camera[0x1B4:0x1B8] = bytes(4)
    image = read_flir(flir_jpeg(tmp_path / "a.jpg", visible=None, fusion=fusion_record(0.0), camera=bytes(camera)))
    assert image.visible_file is None and image.fusion is None
    assert image.field_of_view_deg is None and image.focal_length_px is None


def damaged_raw(change: Callable[[bytes], bytes]) -> dict[str, bytes | None]:
    return {"raw": change(raw_record(counts_of(), png=False))}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"raw": None}, "has no raw thermal image"),
        ({"camera": None}, "has no calibration"),
        (damaged_raw(lambda raw: raw[:-1]), "raw thermal image is cut off"),
        (damaged_raw(lambda raw: b"\x07\x07" + raw[2:]), "raw thermal image in its FLIR data is damaged"),
        (damaged_raw(lambda raw: raw[:2] + bytes(4) + raw[6:]), "raw thermal image is cut off"),
        ({"raw": raw_record(counts_of())[:-40]}, "raw thermal image is damaged"),
        ({"raw": image_record("<", (17, 12), encoded(counts_of(), "PNG"))}, "is 16×12 where 17×12 is announced"),
        ({"raw": image_record("<", THERMAL_SIZE, b"\xff\xd8\xff\xf7")}, "JPEG-compressed"),
        ({"camera": camera_record()[:0x300]}, "calibration in its FLIR data is cut off"),
        ({"camera": b"\2\0" + bytes(0x400)}, "planck.r1 is 0"),
        ({"visible": image_record("<", VISIBLE_SIZE, b"\xff\xd8\xff\xd9")}, "embedded visible image is damaged"),
        ({"fusion": b"\0\0"}, "fusion settings in its FLIR data are cut off"),
    ],
)
def test_damage_is_refused_by_file_and_part(tmp_path: Path, changes: dict[str, bytes | None], said: str) -> None:
    with pytest.raises(RtgsError) as error:
        read_flir(flir_jpeg(tmp_path / "broken.jpg", None, **changes))
    assert "broken.jpg" in str(error.value) and said in str(error.value) and "\n" not in str(error.value)


def test_impossible_parameters_name_the_file(tmp_path: Path) -> None:
    record = bytearray(camera_record())
    record[0x20:0x24] = np.float32(1.5).tobytes()
    with pytest.raises(RtgsError, match=r"a\.jpg: object\.emissivity is 1\.5"):
        read_flir(flir_jpeg(tmp_path / "a.jpg", camera=bytes(record)))


def test_a_missing_segment_is_counted(tmp_path: Path) -> None:
    segments = flir_segments(fff(records()), chunk=500)
    del segments[2]
    with pytest.raises(RtgsError, match=rf"has {len(segments)} of the {len(segments) + 1} segments"):
        read_flir(jpeg(tmp_path / "a.jpg", segments))


@pytest.mark.parametrize("change", [lambda d: b"XXX" + d[3:], lambda d: d[:0x14] + bytes(4) + d[0x18:], lambda d: d[:90]])
def test_a_damaged_directory(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    with pytest.raises(RtgsError, match="directory of its FLIR data is damaged"):
        read_flir(jpeg(tmp_path / "a.jpg", flir_segments(change(fff(records())))))


def test_a_record_beyond_the_end(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"record 0x.* is cut off"):
        read_flir(jpeg(tmp_path / "a.jpg", flir_segments(fff(records())[:-10])))


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.7])
def test_a_file_cut_off_anywhere_in_its_data(tmp_path: Path, share: float) -> None:
    data = flir_jpeg(tmp_path / "whole.jpg", raw=raw_record(counts_of(), png=False)).read_bytes()
    cut = tmp_path / "cut.jpg"
    cut.write_bytes(data[: int(share * len(data))])
    for read in (read_flir, is_flir):
        with pytest.raises(RtgsError, match=r"cut\.jpg: cannot be read as a JPEG"):
            read(cut)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"none\.jpg: no such file"):
        read_flir(tmp_path / "none.jpg")
    (tmp_path / "text.jpg").write_text("not a picture")
    with pytest.raises(RtgsError, match=r"text\.jpg: cannot be read as a JPEG"):
        read_flir(tmp_path / "text.jpg")
    plain = jpeg(tmp_path / "plain.jpg", [])
    assert not is_flir(plain)
    with pytest.raises(RtgsError, match=r"plain\.jpg: holds no FLIR thermal data"):
        read_flir(plain)


def test_a_turned_file_is_refused(tmp_path: Path) -> None:
    path = jpeg(tmp_path / "a.jpg", flir_segments(fff(records())), exif=camera_exif(t274=6))
    with pytest.raises(RtgsError, match="EXIF orientation 6"):
        read_flir(path)


def test_another_calibration_gives_another_temperature(tmp_path: Path) -> None:
    """The camera's constants matter, not defaults of ours."""
    other = replace(RADIOMETRY, calibration=replace(RADIOMETRY.calibration, b=1440.0))
    images = [read_flir(flir_jpeg(tmp_path / f"{i}.jpg", camera=camera_record(r))) for i, r in enumerate((RADIOMETRY, other))]
    assert np.abs(images[0].temperature_c - images[1].temperature_c).min() > 1
