"""Capture folders: what loads, and what each wrong folder says."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.captures import (
    ARCO,
    NAMES,
    POSES,
    RGB,
    RGB_FROM_THERMAL,
    THERMAL,
    edit_rig,
    needs_arco,
    refused,
    thermal_counts,
    write_poses,
    write_sparse,
)

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.image_files import read_rgb
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera


def test_a_capture_without_poses(root: Path) -> None:
    capture = load_capture(root)
    assert [f.name for f in capture.frames] == list(NAMES)
    assert capture.poses is None
    assert capture.warnings == ()
    assert capture.frames[0].rgb.shape == (48, 64, 3)
    assert capture.frames[0].rgb.dtype == capture.frames[0].thermal.dtype == np.float32
    assert capture.radiometry.unit == "°C"
    np.testing.assert_allclose(capture.frames[3].thermal, thermal_counts(4803) * 0.025 - 100, atol=1e-5)
    assert capture.raw_rig.rgb == RGB
    assert capture.rig.rgb == RGB.pinhole()
    assert capture.rig.thermal == THERMAL
    np.testing.assert_allclose(capture.rig.rgb_from_thermal.matrix(), RGB_FROM_THERMAL.matrix(), atol=1e-12)
    assert capture.rgb_mask.shape == (48, 64)
    assert capture.thermal_mask.all()


def test_without_lens_and_resizing_pixels_are_the_files(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(k1=0, k2=0, p1=0, p2=0))
    capture = load_capture(root)
    np.testing.assert_array_equal(capture.frames[1].rgb, read_rgb(root / "rgb" / f"{NAMES[1]}.png"))
    assert capture.rgb_mask.all()


def test_downscaling_averages_and_keeps_the_camera_consistent(root: Path) -> None:
    edit_rig(root, lambda d: d["rgb"].update(k1=0, k2=0, p1=0, p2=0))
    capture = load_capture(root, rgb_max_side=32)
    assert capture.frames[0].rgb.shape == (24, 32, 3)
    assert capture.rig.rgb == RGB.pinhole().resized(32, 24)
    full = read_rgb(root / "rgb" / f"{NAMES[0]}.png")
    np.testing.assert_allclose(capture.frames[0].rgb, full.reshape(24, 2, 32, 2, 3).mean(axis=(1, 3)), atol=1e-6)
    assert capture.rgb_mask.shape == (24, 32)
    assert load_capture(root, rgb_max_side=33).frames[0].rgb.shape == (25, 33, 3)


def test_images_are_the_same_however_little_memory_they_may_take(root: Path) -> None:
    """Without room for an image every access makes it anew; with a little room the frames take turns; with enough all are kept."""
    enough, little, none = (load_capture(root, rgb_max_side=40, cache_bytes=n) for n in (2**20, 20_000, 0))
    for _ in range(2):
        for frames in zip(enough.frames, little.frames, none.frames, strict=True):
            for which in ("rgb", "thermal"):
                images = [getattr(frame, which) for frame in frames]
                np.testing.assert_array_equal(images[1], images[0])
                np.testing.assert_array_equal(images[2], images[0])
    assert enough.frames[0].rgb is enough.frames[0].rgb
    assert none.frames[0].rgb is not none.frames[0].rgb


def test_threads_may_share_the_frames(root: Path) -> None:
    capture = load_capture(root, cache_bytes=20_000)
    expected = [frame.rgb.sum() + frame.thermal.sum() for frame in capture.frames]
    wanted = np.random.default_rng(0).integers(0, len(NAMES), 200).tolist()
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda i: capture.frames[i].rgb.sum() + capture.frames[i].thermal.sum(), wanted))
    assert found == [expected[i] for i in wanted]


def test_a_file_that_goes_or_changes_after_loading_is_named(root: Path) -> None:
    capture = load_capture(root)
    rgb, thermal = root / "rgb" / f"{NAMES[1]}.png", root / "thermal" / f"{NAMES[2]}.tiff"
    rgb.unlink()
    Image.fromarray(np.zeros((16, 20), np.uint16)).save(thermal)
    with pytest.raises(RtgsError, match=f"{rgb.name}: cannot be read"):
        _ = capture.frames[1].rgb
    with pytest.raises(RtgsError, match=f"{thermal.name}: has another size than when the capture was loaded"):
        _ = capture.frames[2].thermal
    assert capture.frames[1].thermal.shape == (32, 40)


def test_frames_know_when_they_were_taken(root: Path) -> None:
    for i, name in enumerate(NAMES[:3]):
        path = root / "rgb" / f"{name}.png"
        exif = Image.Exif()
        exif[0x010F] = "a maker"  # Pillow writes no directory that holds another one alone
        exif[0x8769] = {0x9003: f"2024:05:01 10:00:0{i}", 0x9291: "25"}
        Image.open(path).save(path, exif=exif)
    times = [frame.time_s for frame in load_capture(root).frames]
    assert times[0] is not None and times[3:] == [None, None]
    assert [t - times[0] for t in times[:3] if t is not None] == [0.0, 1.0, 2.0]


def test_other_files_in_the_folders_are_passed_over(root: Path) -> None:
    (root / "rgb" / "notes.txt").write_text("hello")
    (root / "rgb" / "._a.png").write_bytes(b"mac")
    assert len(load_capture(root).frames) == len(NAMES)


def test_intrinsics_that_come_with_poses_win_and_a_disagreement_warns(root: Path) -> None:
    other = Camera("OPENCV", 64, 48, 63.0, 61.0, 32.5, 23.5, k1=-0.05, k2=0.01, p1=0.001, p2=-0.002)
    write_poses(root, other)
    capture = load_capture(root)
    assert capture.raw_rig.rgb == other
    assert capture.rig.rgb == other.pinhole()
    assert any("more than 1 %" in w and "fl_x 63.0 and 60.0" in w for w in capture.warnings)


def test_a_lens_that_only_the_rig_has_warns(root: Path) -> None:
    write_poses(root, RGB.pinhole())
    capture = load_capture(root)
    assert capture.raw_rig.rgb == RGB.pinhole()
    assert any("rig.json gives the RGB camera lens distortion and transforms.json gives none" in w for w in capture.warnings)


def test_sparse_wins_over_transforms_and_says_so(root: Path) -> None:
    write_poses(root)
    write_sparse(root)
    capture = load_capture(root)
    assert capture.poses is not None and capture.poses.points is not None
    assert any("sparse/0 is used" in w for w in capture.warnings)


def test_frames_without_a_pose_are_kept(root: Path) -> None:
    write_poses(root, poses={name: POSES[name] for name in NAMES[:3]} | {"gone": SE3.identity()})
    capture = load_capture(root)
    assert len(capture.frames) == 5
    assert capture.poses is not None and sorted(capture.poses.world_from_rgb) == sorted(NAMES[:3])
    assert any("1 of its poses belong to no image" in w for w in capture.warnings)


def test_no_such_capture(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "nowhere: no such folder", "rgb/, thermal/ and rig.json")


def test_missing_image_folder(root: Path) -> None:
    shutil.rmtree(root / "thermal")
    refused(root, "thermal: no such folder")


def test_missing_partners_are_named(root: Path) -> None:
    (root / "thermal" / f"{NAMES[2]}.tiff").unlink()
    refused(root, "1 of 5 images in rgb/ have no partner", NAMES[2])


def test_at_most_five_missing_partners_are_named(root: Path) -> None:
    for i in range(7):
        shutil.copy(root / "thermal" / f"{NAMES[0]}.tiff", root / "thermal" / f"x{i}.tiff")
    refused(root, "7 of 12 images in thermal/ have no partner", "x0, x1, x2, x3, x4 and 2 more")


def test_fewer_than_three_pairs(root: Path) -> None:
    for name in NAMES[2:]:
        (root / "rgb" / f"{name}.png").unlink()
        (root / "thermal" / f"{name}.tiff").unlink()
    refused(root, "holds 2 image pairs", "at least 3")


def test_two_files_of_one_stem(root: Path) -> None:
    shutil.copy(root / "rgb" / f"{NAMES[0]}.png", root / "rgb" / f"{NAMES[0]}.tif")
    refused(root, f"{NAMES[0]}.png and {NAMES[0]}.tif share the stem")


def test_silly_max_side(root: Path) -> None:
    with pytest.raises(RtgsError, match="rgb_max_side is 0"):
        load_capture(root, rgb_max_side=0)


@needs_arco
@pytest.mark.thorough
def test_arco() -> None:
    capture = load_capture(ARCO, rgb_max_side=480)
    assert len(capture.frames) == 40
    assert capture.warnings == ()
    assert capture.radiometry.unit == "°C"
    assert capture.poses is not None and len(capture.poses.world_from_rgb) == 40
    assert capture.poses.points is not None and len(capture.poses.points) == 20997
    median_c = np.median([frame.thermal for frame in capture.frames])
    assert 5 < median_c < 30  # an unheated room
    assert capture.frames[0].rgb.shape == (270, 480, 3)
    assert 0.95 < capture.rgb_mask.mean() < 1
