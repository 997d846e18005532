"""Which camera took a photograph, and when."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.io.camera_tags import CameraTags, read_camera_tags


def photograph(path: Path, make: str, model: str) -> Path:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0132] = make, model, "2026:05:01 10:20:30"
    exif.get_ifd(0x8769).update({0x9003: "2026:05:01 10:20:29", 0xA431: "S/N 7\x00\x01", 0xA434: "24 mm"})
    Image.new("RGB", (8, 8)).save(path, exif=exif)
    return path


@pytest.mark.parametrize(("make", "model", "camera"), [("FLIR", "T1020", "FLIR T1020"), ("Canon", "Canon R5", "Canon R5")])
def test_tags_are_read(tmp_path: Path, make: str, model: str, camera: str) -> None:
    tags = read_camera_tags(photograph(tmp_path / "a.jpg", make, model))
    assert tags == CameraTags(camera, "S/N 7", "24 mm", "2026-05-01 10:20:29")


def test_a_file_without_tags_says_nothing(tmp_path: Path) -> None:
    Image.new("I;16", (8, 8)).save(tmp_path / "a.png")
    assert read_camera_tags(tmp_path / "a.png") == CameraTags()


def test_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(RtgsError, match=r"a\.jpg"):
        read_camera_tags(tmp_path / "a.jpg")
