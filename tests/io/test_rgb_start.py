"""RGB intrinsics that `rig.json` leaves out are filled in from the photographs, and only those."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.io.image_files import ImageHeader, read_header
from rtgs.io.rgb_start import DIAGONAL_35MM, completed_rgb

PATH = Path("rig.json")
FULL = {"model": "OPENCV", "width": 400, "height": 300, "fl_x": 350.0, "fl_y": 351.0, "cx": 201.0, "cy": 149.0}
LENS = {"k1": 0.1, "k2": 0.0, "p1": 0.0, "p2": 0.0}


def header(equivalent_mm: float | None = None) -> ImageHeader:
    return ImageHeader(Path("a.jpg"), (400, 300), "JPEG", "RGB", 1, equivalent_mm=equivalent_mm)


def completed(data: dict[str, Any], equivalent_mm: float | None = None) -> tuple[dict[str, Any], Any]:
    return completed_rgb(PATH, data, lambda: header(equivalent_mm))


def test_a_calibrated_camera_is_taken_as_it_is_and_no_photograph_is_read() -> None:
    def nobody() -> ImageHeader:
        raise AssertionError

    assert completed_rgb(PATH, FULL | LENS, nobody) == (FULL | LENS, None)


def test_nothing_given_is_found_from_a_guess() -> None:
    data, start = completed({})
    assert data == {
        "model": "SIMPLE_RADIAL",
        "width": 400,
        "height": 300,
        "fl_x": 480.0,
        "fl_y": 480.0,
        "cx": 200,
        "cy": 150,
        "k1": 0.0,
    }
    assert start.unknown == ("focal", "distortion") and not start.trusted


def test_exif_gives_the_start_of_the_focal_length() -> None:
    data, start = completed({}, equivalent_mm=28.0)
    assert data["fl_x"] == pytest.approx(500 * 28 / DIAGONAL_35MM) and start.trusted
    assert "EXIF" in start.source


def test_a_field_of_view_comes_before_exif() -> None:
    data, start = completed({"fov_deg": 60.0}, equivalent_mm=28.0)
    assert data["fl_x"] == data["fl_y"] == pytest.approx(200 / math.tan(math.radians(30)))
    assert "fov_deg" not in data and "field of view" in start.source


def test_a_given_focal_length_is_held_while_the_lens_is_found() -> None:
    data, start = completed(FULL)
    assert start.unknown == ("distortion",)
    assert data == FULL | dict.fromkeys(LENS, 0.0)


def test_a_given_lens_is_held_while_the_focal_length_is_found() -> None:
    data, start = completed({"model": "OPENCV", **LENS})
    assert start.unknown == ("focal",) and data["k1"] == 0.1


@pytest.mark.parametrize("value", [0, 180.0, "60", True, -5])
def test_a_wrong_field_of_view_is_refused(value: object) -> None:
    with pytest.raises(RtgsError, match=r"rgb\.fov_deg is .* horizontal field of view"):
        completed({"fov_deg": value})


def test_a_field_of_view_beside_a_focal_length_is_refused() -> None:
    with pytest.raises(RtgsError, match=r"rgb\.fov_deg and rgb\.fl_x are both given"):
        completed(FULL | LENS | {"fov_deg": 60.0})


def test_the_equivalent_is_read_from_a_file(tmp_path: Path) -> None:
    image = Image.new("RGB", (40, 30))
    exif = image.getexif()
    exif.get_ifd(0x8769)[0xA405] = 26
    image.save(tmp_path / "a.jpg", exif=exif)
    assert read_header(tmp_path / "a.jpg").equivalent_mm == 26
    image.save(tmp_path / "b.jpg")
    assert read_header(tmp_path / "b.jpg").equivalent_mm is None
