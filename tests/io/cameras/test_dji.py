"""DJI's R-JPEGs: a FLIR core is read, the others through a converted TIFF or not at all, and pictures find their partners."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.radiometric_files import (
    RADIOMETRY,
    SAMPLES,
    camera_exif,
    camera_record,
    counts_of,
    encoded,
    fff,
    flir_segments,
    jpeg,
    needs_samples,
    records,
)

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.dji import focal_length_px, frame_name, is_dji, read_dji, visible_partner
from rtgs.io.cameras.flir import read_flir


def closed_jpeg(path: Path) -> Path:
    """As an H20T writes it: counts in APP3, no constants."""
    return jpeg(path, [bytes(2000)], marker=0xE3, exif=camera_exif(t271="DJI", t272="ZH20T"))


@needs_samples
def test_the_xt2_is_read_as_flir() -> None:
    path = SAMPLES / "DJI_XT2.jpg"
    image = read_dji(path)
    np.testing.assert_array_equal(image.temperature_c, read_flir(path).temperature_c)
    assert image.focal_length_px is None  # 19 mm, but neither a pixel pitch nor a 35 mm equivalent


@needs_samples
@pytest.mark.parametrize(("name", "model"), [("DJI_H20T.jpg", "ZH20T"), ("DJI_M30T.jpg", "M30T")])
def test_closed_data_is_refused_with_the_way_out(name: str, model: str) -> None:
    assert is_dji(SAMPLES / name)
    with pytest.raises(RtgsError) as error:
        read_dji(SAMPLES / name)
    for part in (name, f"DJI {model}", "DJI's Thermal SDK", "floating-point TIFF in °C", name.replace(".jpg", ".tiff")):
        assert part in str(error.value)


@needs_samples
@pytest.mark.parametrize(("name", "dfov_deg"), [("DJI_H20T.jpg", 40.6), ("DJI_M30T.jpg", 61.0)])
def test_nominal_focal_lengths_are_near_djis_data_sheet(name: str, dfov_deg: float) -> None:
    from_sheet = np.hypot(640, 512) / 2 / np.tan(np.radians(dfov_deg / 2))
    assert focal_length_px(SAMPLES / name) == pytest.approx(from_sheet, rel=0.1)


def test_a_flir_core(tmp_path: Path) -> None:
    path = jpeg(tmp_path / "a.jpg", flir_segments(fff(records(visible=None))), exif=camera_exif(t271="DJI", t272="FLIR"))
    assert is_dji(path)
    np.testing.assert_allclose(read_dji(path).temperature_c, RADIOMETRY.celsius(counts_of()), atol=1e-4)


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".TIFF"])
def test_a_converted_file_beside_it_is_read(tmp_path: Path, suffix: str) -> None:
    path = closed_jpeg(tmp_path / "DJI_0001_T.JPG")
    temperature_c = np.linspace(-20, 90, 12 * 16, dtype=np.float32).reshape(12, 16)
    (tmp_path / f"DJI_0001_T{suffix}").write_bytes(encoded(temperature_c, "TIFF"))
    image = read_dji(path)
    np.testing.assert_array_equal(image.temperature_c, temperature_c)
    assert image.model == "ZH20T"


def test_converted_files_without_a_unit_or_without_sense_are_refused(tmp_path: Path) -> None:
    path = closed_jpeg(tmp_path / "a_T.jpg")
    (tmp_path / "a_T.tiff").write_bytes(encoded(np.full((12, 16), 29315, np.uint16), "TIFF"))
    with pytest.raises(RtgsError, match=r"a_T\.tiff: holds whole numbers.*celsius_per_count"):
        read_dji(path)
    (tmp_path / "a_T.tiff").write_bytes(encoded(np.full((12, 16), -9999, np.float32), "TIFF"))
    with pytest.raises(RtgsError, match=r"a_T\.tiff: its lowest value is -9999"):
        read_dji(path)
    (tmp_path / "a_T.tiff").write_bytes(encoded(np.full((12, 16), np.nan, np.float32), "TIFF"))
    with pytest.raises(RtgsError, match=r"a_T\.tiff: holds NaN"):
        read_dji(path)


def test_other_files_are_no_r_jpegs(tmp_path: Path) -> None:
    plain = jpeg(tmp_path / "plain.jpg", [], exif=camera_exif(t271="DJI", t272="ZH20T"))
    other_make = jpeg(tmp_path / "other.jpg", [bytes(2000)], marker=0xE3)
    for path in (plain, other_make):
        assert not is_dji(path)
        with pytest.raises(RtgsError, match=rf"{path.name}: is no radiometric JPEG by DJI"):
            read_dji(path)
    (tmp_path / "cut.jpg").write_bytes(closed_jpeg(tmp_path / "b.jpg").read_bytes()[:700])
    with pytest.raises(RtgsError, match=r"cut\.jpg: cannot be read as a JPEG"):
        read_dji(tmp_path / "cut.jpg")


@pytest.mark.parametrize(
    ("thermal", "others", "partner"),
    [
        ("DJI_20240101120000_0001_T.JPG", ["DJI_20240101120000_0001_W.JPG", "DJI_20240101120000_0001_Z.JPG"], 0),
        (
            "DJI_20240101120000_0001_T.JPG",
            ["DJI_20240101120001_0001_W.JPG", "DJI_20240101120001_0002_W.JPG"],
            0,
        ),  # a second later
        ("DJI_20240101120000_0001_T.JPG", ["DJI_20240101120000_0001_V.JPG"], 0),
        ("DJI_20240101120000_0001_T.JPG", ["DJI_20240101120000_0001_V.JPG", "DJI_20240101120000_0001_W.JPG"], 1),
        ("DJI_1_0001_T.JPG", ["DJI_2_0001_W.JPG", "DJI_1_0001_W.JPG"], 1),
        ("dji_1_0001_t.jpg", ["dji_1_0001_w.jpg"], 0),
        ("DJI_1_0001_T.JPG", ["DJI_1_0011_W.JPG", "DJI_1_0001_Z.JPG", "DJI_1_0001_W.MP4"], None),
        ("DJI_0001.jpg", ["DJI_0001_W.JPG"], None),
    ],
)
def test_the_visible_partner(tmp_path: Path, thermal: str, others: list[str], partner: int | None) -> None:
    for name in (thermal, *others):
        (tmp_path / name).touch()
    assert visible_partner(tmp_path / thermal) == (None if partner is None else tmp_path / others[partner])


def test_two_partners_of_one_number_are_refused(tmp_path: Path) -> None:
    for name in ("DJI_1_0001_T.JPG", "DJI_2_0001_W.JPG", "DJI_3_0001_W.JPG"):
        (tmp_path / name).touch()
    with pytest.raises(RtgsError, match=r"DJI_2_0001_W\.JPG, DJI_3_0001_W\.JPG carry the same number"):
        visible_partner(tmp_path / "DJI_1_0001_T.JPG")


def test_frame_names() -> None:
    assert frame_name(Path("a/DJI_1_0001_T.JPG")) == "DJI_1_0001"
    assert frame_name(Path("DJI_0001.jpg")) == "DJI_0001"


def test_the_focal_length_belongs_to_the_counts_and_not_to_the_picture(tmp_path: Path) -> None:
    """The picture of a thermal JPEG may be enlarged."""
    exif = camera_exif(t271="DJI", t272="M30T")
    exif.get_ifd(0x8769)[41989] = 40
    path = jpeg(tmp_path / "a_T.JPG", [b"counts"], marker=0xE3, exif=exif)  # its picture is 32×24
    Image.fromarray(np.linspace(0, 30, 12 * 16, dtype=np.float32).reshape(12, 16)).save(tmp_path / "a_T.tiff")
    assert read_dji(path).focal_length_px == pytest.approx(40 * np.hypot(16, 12) / np.hypot(36, 24))
    core = jpeg(tmp_path / "b.jpg", flir_segments(fff(records(visible=None, camera=_without_fov()))), exif=exif)
    assert read_dji(core).focal_length_px == pytest.approx(40 * np.hypot(16, 12) / np.hypot(36, 24))


def _without_fov() -> bytes:
    record = bytearray(camera_record())
    record[0x1B4:0x1B8] = bytes(4)
    return bytes(record)


def test_focal_length_from_the_35_mm_equivalent(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = 50
    path = jpeg(tmp_path / "a.jpg", [], exif=exif)
    assert focal_length_px(path) == pytest.approx(50 * np.hypot(32, 24) / np.hypot(36, 24))
    assert focal_length_px(jpeg(tmp_path / "b.jpg", [])) is None
