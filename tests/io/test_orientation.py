"""Orientation tags of EXIF and TIFF: which pixels a capture uses, and what it says about that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.captures import NAMES, RGB, edit_rig, edit_transforms, refused, write_poses, write_sparse

from rtgs.config import SfmConfig
from rtgs.io.capture import load_capture
from rtgs.io.image_files import read_counts, read_header, read_rgb
from rtgs.sfm.poses import run_sfm

TAG = 0x0112
# How stored pixels [H, W, …] become upright ones, by the definition of the tag: where row 0 and column 0 lie.
UPRIGHT: dict[int, Callable[[NDArray[Any]], NDArray[Any]]] = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: a[::-1].swapaxes(0, 1),
    7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
    8: lambda a: a[:, ::-1].swapaxes(0, 1),
}
PIXELS = np.arange(7 * 10).reshape(7, 10)
COUNTS: list[NDArray[Any]] = [
    PIXELS.astype(np.uint8),
    (PIXELS * 900).astype(np.uint16),
    PIXELS.astype(np.int32),
    PIXELS.astype(np.float32),
]
COLOUR = np.stack([PIXELS, PIXELS + 50, 200 - PIXELS], axis=-1).astype(np.uint8)


def tag_rgb(root: Path, orientation: int, suffix: str = ".png") -> dict[str, NDArray[np.uint8]]:
    """Give the stored RGB pixels of a capture a tag, without changing them; the pixels by frame name."""
    stored = {}
    for name in NAMES:
        path = root / "rgb" / f"{name}.png"
        with Image.open(path) as image:
            stored[name] = np.asarray(image)
        path.unlink()
        exif = Image.Exif()
        exif[TAG] = orientation
        Image.fromarray(stored[name]).save(path.with_suffix(suffix), exif=exif)
    return stored


def without_lens(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(k1=0, k2=0, p1=0, p2=0))


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_deflate"])
@pytest.mark.parametrize("orientation", UPRIGHT)
def test_tiff(tmp_path: Path, orientation: int, compression: str) -> None:
    """Size and pixels agree for every orientation, pixel format and compression."""
    for i, pixels in enumerate([*COUNTS, COLOUR]):
        path = tmp_path / f"{i}.tiff"
        Image.fromarray(pixels).save(path, compression=compression, tiffinfo={TAG: orientation})
        upright = UPRIGHT[orientation](pixels)
        header = read_header(path)
        assert header.orientation == orientation
        assert header.size() == upright.shape[1::-1]
        assert header.size(upright=False) == header.stored_size == (10, 7)
        if pixels.ndim == 2:
            np.testing.assert_array_equal(read_counts(path), upright)
        else:
            np.testing.assert_array_equal(read_rgb(path), np.float32(upright) / np.float32(255))
            np.testing.assert_array_equal(read_rgb(path, upright=False), np.float32(pixels) / np.float32(255))


@pytest.mark.parametrize("orientation", UPRIGHT)
def test_png(tmp_path: Path, orientation: int) -> None:
    exif = Image.Exif()
    exif[TAG] = orientation
    path = tmp_path / "a.png"
    Image.fromarray(COLOUR).save(path, exif=exif)
    assert read_header(path).size() == UPRIGHT[orientation](COLOUR).shape[1::-1]
    np.testing.assert_array_equal(read_rgb(path), np.float32(UPRIGHT[orientation](COLOUR)) / np.float32(255))
    np.testing.assert_array_equal(read_rgb(path, upright=False), np.float32(COLOUR) / np.float32(255))


@pytest.mark.parametrize("orientation", [3, 6])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("source", ["sparse/0", "transforms.json"])
def test_poses_belong_to_the_stored_pixels(root: Path, source: str, suffix: str, orientation: int) -> None:
    without_lens(root)
    stored = tag_rgb(root, orientation, suffix)
    (write_sparse if source == "sparse/0" else write_poses)(root, RGB.pinhole())
    capture = load_capture(root)
    assert not capture.rgb_upright
    assert capture.raw_rig.rgb == RGB.pinhole()
    for frame in capture.frames:
        np.testing.assert_array_equal(frame.rgb, np.float32(stored[frame.name]) / np.float32(255))
    (said,) = capture.warnings
    assert f"5 of the 5 images in rgb/ have an orientation tag (EXIF or TIFF): the poses in {source} belong to the stored" in said


def test_poses_without_a_size_belong_to_the_stored_pixels(root: Path) -> None:
    tag_rgb(root, 6)
    write_poses(root)

    def strip(data: dict[str, object]) -> None:
        for key in ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "camera_model"):
            del data[key]
        data["camera_angle_x"] = 0.9

    edit_transforms(root, strip)
    capture = load_capture(root)
    assert not capture.rgb_upright
    assert (capture.raw_rig.rgb.width, capture.raw_rig.rgb.height) == (64, 48)


def test_poses_of_upright_copies(root: Path) -> None:
    """The size of the camera that came with the poses says that they were found from upright copies."""
    camera = replace(RGB.pinhole(), width=48, height=64, cx=23.5, cy=32.5)
    edit_rig(root, lambda d: d["rgb"].update(width=48, height=64, cx=23.5, cy=32.5, k1=0, k2=0, p1=0, p2=0))
    stored = tag_rgb(root, 6)
    write_sparse(root, camera)
    capture = load_capture(root)
    assert capture.rgb_upright
    for frame in capture.frames:
        np.testing.assert_array_equal(frame.rgb, np.float32(UPRIGHT[6](stored[frame.name])) / np.float32(255))
    (said,) = capture.warnings
    assert "the camera in sparse/0 has the size of the upright images, so they are turned upright" in said


def test_a_rig_of_the_other_pixels_is_refused(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(width=48, height=64))
    tag_rgb(root, 6)
    write_sparse(root)
    refused(root, "rgb.width and height say 48×64", "is 64×48 (as stored)")


def test_without_poses_images_are_turned_upright(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(width=48, height=64, k1=0, k2=0, p1=0, p2=0))
    stored = tag_rgb(root, 8)
    capture = load_capture(root)
    assert capture.rgb_upright
    np.testing.assert_array_equal(capture.frames[2].rgb, np.float32(UPRIGHT[8](stored[NAMES[2]])) / np.float32(255))
    (said,) = capture.warnings
    assert "5 of the 5 images in rgb/ have an orientation tag (EXIF or TIFF): they are turned upright" in said


def test_structure_from_motion_triangulates_in_the_pixels_of_the_poses(root: Path, tmp_path: Path) -> None:
    """COLMAP reads the stored pixels of the capture's own files, and no upright copy is made."""
    tag_rgb(root, 6)
    write_poses(root)
    run_sfm(load_capture(root), SfmConfig(), work_dir=tmp_path / "work")
    assert not (tmp_path / "work" / "upright").exists()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_colmap_reads_stored_pixels(root: Path, suffix: str) -> None:
    """The law that the test above rests on."""
    tag_rgb(root, 6, suffix)
    bitmap = pycolmap.Bitmap.read(root / "rgb" / f"{NAMES[0]}{suffix}", True)
    assert bitmap is not None
    assert (bitmap.width, bitmap.height) == (64, 48)
