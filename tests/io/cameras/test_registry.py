"""The makers that can be imported, and what each of them accepts."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from tests.helpers.radiometric_files import flir_jpeg

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.import_folder import import_folder
from rtgs.io.cameras.protocol import CameraFormat
from rtgs.io.cameras.registry import MODULES, camera_format


@pytest.mark.parametrize("name", MODULES)
def test_each_maker_has_the_functions_of_a_format(name: str) -> None:
    functions = [function for function in vars(CameraFormat) if not function.startswith("_")]
    assert "read" in functions
    assert all(callable(getattr(camera_format(name), function)) for function in functions)


@pytest.mark.parametrize("name", ["flir", "dji"])
def test_a_radiometric_file_is_recognised_and_a_plain_picture_is_not(name: str, tmp_path: Path) -> None:
    """FLIR's thermal data is in the files of both makers: DJI builds cameras around FLIR cores."""
    Image.new("RGB", (8, 6)).save(tmp_path / "plain.jpg")
    flir_jpeg(tmp_path / "radiometric.jpg")
    found = camera_format(name)
    assert found.recognises(tmp_path / "radiometric.jpg")
    assert not found.recognises(tmp_path / "plain.jpg")
    shot = found.read(tmp_path / "radiometric.jpg")
    assert shot.counts.ndim == 2 and shot.radiometry.unit == "°C"
    assert (shot.visible is None) == (name == "dji")  # DJI's visible picture is a file of its own
    assert found.frame_name(tmp_path / "radiometric.jpg") == "radiometric"


def test_an_unknown_maker_is_refused_and_the_known_ones_are_named(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="'kodak' is no known maker of cameras; there are flir, dji"):
        import_folder("kodak", tmp_path, tmp_path / "out")
