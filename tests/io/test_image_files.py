"""Image files: names, formats, orientation, and files that cannot be used."""

from __future__ import annotations

import ast
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from tests.helpers.captures import NAMES, edit_rig, refused, thermal_counts

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.image_files import MOST_JPEG_PIXELS, check_rgb, frame_name, in_thermal_folder, read_header, read_rgb, reduction_for


def test_frame_names() -> None:
    names = ["a/10.5", "./rgb/10.5.jpg", "10.5.TIFF", "rgb\\10.5.png"]
    assert {frame_name(n) for n in names} == {"10.5"}
    assert in_thermal_folder("thermal/train/1.tiff")
    assert not in_thermal_folder("/home/me/thermal/rgb/1.png")
    assert not in_thermal_folder("thermal.png")


@pytest.mark.parametrize(
    ("suffix", "dtype", "value"),
    [
        (".png", np.uint16, 4900),
        (".tiff", np.uint16, 4900),
        (".png", np.uint8, 200),
        (".tiff", np.float32, 22.5),
        (".tif", np.int32, 70000),
    ],
)
def test_thermal_formats(root: Path, suffix: str, dtype: type, value: float) -> None:
    edit_rig(root, lambda d: [d["thermal"].pop(key) for key in ("celsius_per_count", "celsius_offset")])
    for i, name in enumerate(NAMES):
        (root / "thermal" / f"{name}.tiff").unlink()
        Image.fromarray(thermal_counts(value + i, dtype)).save(root / "thermal" / f"{name}{suffix}")
    for i, frame in enumerate(load_capture(root).frames):
        np.testing.assert_array_equal(frame.thermal, thermal_counts(value + i, dtype))


def test_exif_orientation_is_applied(root: Path) -> None:
    """Files stored sideways with a tag load upright, and sizes are compared upright."""
    upright = load_capture(root)
    for name in NAMES:
        path = root / "rgb" / f"{name}.png"
        image = Image.open(path)
        exif = image.getexif()
        exif[0x0112] = 6  # shown after a quarter turn clockwise, so stored a quarter turn counter-clockwise
        image.rotate(90, expand=True).save(path, exif=exif)
        assert Image.open(path).size == (48, 64)
    np.testing.assert_array_equal(load_capture(root).frames[0].rgb, upright.frames[0].rgb)


@pytest.mark.parametrize("folder", ["rgb", "thermal"])
def test_not_an_image(root: Path, folder: str) -> None:
    path = next((root / folder).glob(f"{NAMES[3]}.*"))
    path.write_bytes(b"not an image at all")
    refused(root, path.name, "cannot be read")


@pytest.mark.parametrize("folder", ["rgb", "thermal"])
def test_an_eps_of_another_name_is_no_image(root: Path, folder: str) -> None:
    """Pillow would start Ghostscript to draw it, and that program may never end."""
    path = next((root / folder).glob(f"{NAMES[3]}.*"))
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 48\n%%EndComments\n{} loop\n")
    refused(root, path.name, "not an image that can be identified")


def test_every_image_is_opened_as_a_named_format() -> None:
    """Then no file, whatever its content, makes Pillow start an external program."""
    sources = sorted((Path(__file__).parents[2] / "src").rglob("*.py"))
    calls = [
        (path.name, node)
        for path in sources
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Image.open"
    ]
    assert calls
    for name, call in calls:
        assert any(keyword.arg == "formats" for keyword in call.keywords), f"{name}:{call.lineno}"


@pytest.mark.parametrize("folder", ["rgb", "thermal"])
def test_truncated_image(root: Path, folder: str) -> None:
    path = next((root / folder).glob(f"{NAMES[3]}.*"))
    path.write_bytes(path.read_bytes()[:-400])
    refused(root, path.name, "cannot be read")


def test_truncated_jpeg(root: Path) -> None:
    for name in NAMES:
        path = root / "rgb" / f"{name}.png"
        Image.open(path).save(path.with_suffix(".jpg"))
        path.unlink()
    last = root / "rgb" / f"{NAMES[4]}.jpg"
    last.write_bytes(last.read_bytes()[:1500])
    refused(root, last.name, "cannot be read", "truncated")


@pytest.mark.parametrize("mode", ["RGB", "P", "RGBA"])
def test_colour_thermal(root: Path, mode: str) -> None:
    (root / "thermal" / f"{NAMES[1]}.tiff").unlink()
    path = root / "thermal" / f"{NAMES[1]}.png"
    Image.new(mode, (40, 32)).save(path)
    refused(root, path.name, "colour image", "single-channel 16-bit")


def test_thermal_with_nan(root: Path) -> None:
    counts = np.full((32, 40), 20.0, np.float32)
    counts[3, 4] = np.nan
    Image.fromarray(counts).save(root / "thermal" / f"{NAMES[1]}.tiff")
    refused(root, f"{NAMES[1]}.tiff", "NaN")


def test_swapped_folders(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(width=40, height=32))
    for name in NAMES:
        Image.fromarray(np.zeros((32, 40), np.float32)).save(root / "rgb" / f"{name}.tiff")
        (root / "rgb" / f"{name}.png").unlink()
    refused(root, f"rgb/{NAMES[0]}.tiff", "floating-point", "swapped")


@pytest.mark.parametrize(
    ("original", "subseconds", "changed", "expected"),
    [
        ("2024:05:01 10:00:00", "25", None, 0.25),
        ("2024:05:01 10:00:00", "250 ", None, 0.25),
        ("2024:05:01 10:00:07", None, "2024:05:02 11:00:00", 7.0),
        (None, None, "2024:05:01 10:01:00", 60.0),
        (None, "25", "2024:05:01 10:01:00", 60.0),  # the fraction belongs to the original time
        ("2024:05:01 10:00:00", "x", None, 0.0),
        ("0000:00:00 00:00:00", None, None, None),
        ("yesterday", None, None, None),
        (None, None, None, None),
    ],
)
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_the_time_of_an_image(
    tmp_path: Path, suffix: str, original: str | None, subseconds: str | None, changed: str | None, expected: float | None
) -> None:
    """Seconds since the same second in all cases; EXIF's time zones are not read."""
    exif = Image.Exif()
    exif[0x010F] = "a maker"  # Pillow writes no directory that holds another one alone
    exif[0x8769] = {tag: text for tag, text in ((0x9003, original), (0x9291, subseconds)) if text is not None}
    if changed is not None:
        exif[0x0132] = changed
    path = tmp_path / f"a{suffix}"
    Image.new("RGB", (8, 8)).save(path, exif=exif)
    found = read_header(path).time_s
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        start = datetime(2024, 5, 1, 10, 0, 0, tzinfo=timezone.utc).timestamp()
        assert found - start == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("mode", ["RGB", "L", "I;16"])
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tiff"])
def test_the_quick_check_accepts_what_can_be_read(tmp_path: Path, mode: str, suffix: str) -> None:
    if mode == "I;16" and suffix == ".jpg":
        pytest.skip("JPEG has no 16 bits")
    path = tmp_path / f"a{suffix}"
    Image.new(mode, (37, 5)).save(path)
    check_rgb(path)
    assert read_rgb(path).shape == (5, 37, 3)


def jpeg(path: Path, width: int, height: int) -> Path:
    """A photograph-like JPEG: smooth, with fine detail of low contrast."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    rng = np.random.default_rng(width)
    grey = 128 + 60 * np.sin(x / 37) * np.cos(y / 23) + rng.normal(0, 6, (height, width))
    Image.fromarray(np.stack([grey, 0.8 * grey, 255 - grey], axis=2).clip(0, 255).astype(np.uint8)).save(path, quality=92)
    return path


@pytest.mark.parametrize(
    ("stored", "wanted", "expected"),
    [
        ((4000, 3000), (960, 720), 2),  # a quarter would leave 1000, less than twice 960
        ((8000, 6000), (960, 720), 4),
        ((16320, 12240), (960, 720), 8),
        ((1920, 1080), (960, 540), 1),  # not a single DCT step less than what is asked for
        ((4002, 3002), (960, 720), 2),
        ((4001, 3001), (960, 720), 1),  # would not be divided exactly, nor would the focal lengths
        ((3000, 4000), (720, 960), 2),
        ((3000, 4000), (960, 720), 2),  # shown after a quarter turn
    ],
)
def test_how_far_a_jpeg_is_reduced(tmp_path: Path, stored: tuple[int, int], wanted: tuple[int, int], expected: int) -> None:
    header = replace(read_header(jpeg(tmp_path / "a.jpg", 16, 8)), stored_size=stored)
    assert reduction_for(header, wanted) == expected
    if stored[0] < 16000:  # larger ones are refused, since a PNG is always decoded whole
        assert reduction_for(replace(header, format="PNG"), wanted) == 1


def test_a_jpeg_read_smaller_is_the_same_picture(tmp_path: Path) -> None:
    """Decoded at half its size it differs from the whole one, averaged down, by less than the compression does."""
    path = jpeg(tmp_path / "a.jpg", 320, 240)
    whole = cv2.resize(read_rgb(path), (80, 60), interpolation=cv2.INTER_AREA)
    half = cv2.resize(read_rgb(path, reduction=2), (80, 60), interpolation=cv2.INTER_AREA)
    assert read_rgb(path, reduction=2).shape == (120, 160, 3)
    assert -10 * np.log10(np.mean((whole - half) ** 2)) > 40
    shifted = np.roll(whole, 1, axis=1)  # a pixel off would be seen
    assert -10 * np.log10(np.mean((shifted - half) ** 2)) < 35


@pytest.mark.parametrize("orientation", [1, 6])
def test_large_photographs_make_the_images_of_the_whole_ones(root: Path, orientation: int) -> None:
    """Lens, camera and mask are those of the reduced picture."""
    for name in NAMES:
        (root / "rgb" / f"{name}.png").unlink()
        path = jpeg(root / "rgb" / f"{name}.jpg", 640, 480)
        if orientation != 1:
            exif = Image.Exif()
            exif[0x0112] = orientation
            Image.open(path).rotate(90, expand=True).save(path, exif=exif, quality=95)
    edit_rig(root, lambda d: d["rgb"].update(width=640, height=480, fl_x=600.0, fl_y=610.0, cx=325.0, cy=235.0))
    small, whole = load_capture(root, rgb_max_side=80), load_capture(root, rgb_max_side=640)
    assert small.rig.rgb == whole.rig.rgb.resized(80, 60) and small.frames[0].rgb.shape == (60, 80, 3)
    expected = cv2.resize(whole.frames[0].rgb, (80, 60), interpolation=cv2.INTER_AREA)
    inside = small.rgb_mask & (cv2.resize(whole.rgb_mask.astype(np.float32), (80, 60), interpolation=cv2.INTER_AREA) > 0.999)
    assert inside.mean() > 0.8
    assert -10 * np.log10(np.mean((small.frames[0].rgb - expected)[inside] ** 2)) > 38


@pytest.mark.thorough
def test_a_jpeg_above_pillows_limit_is_read(tmp_path: Path) -> None:
    """200 megapixels, decoded at an eighth."""
    path = tmp_path / "a.jpg"
    Image.new("L", (16000, 12512), 77).save(path)
    header = read_header(path)
    assert reduction_for(header, (960, 751)) == 8
    assert read_rgb(path, reduction=8).shape == (1564, 2000, 3)
    with pytest.raises(RtgsError, match=r"a\.jpg: has more than 179 megapixels"):
        reduction_for(header, (16000, 12512))


def test_a_header_that_asks_for_gigapixels_is_refused(tmp_path: Path) -> None:
    path = jpeg(tmp_path / "a.jpg", 16, 8)
    data = path.read_bytes()
    at = data.index(b"\xff\xc0") + 5
    path.write_bytes(data[:at] + (60000).to_bytes(2, "big") * 2 + data[at + 4 :])
    with pytest.raises(RtgsError, match=f"a.jpg: has more than {MOST_JPEG_PIXELS / 1e6:.0f} megapixels"):
        read_header(path)
