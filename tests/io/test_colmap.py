"""COLMAP models: `sparse/0` of a capture and `scene/` of a run."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from tests.helpers.captures import NAMES, POSES, RGB, edit_rig, refused, write_poses, write_sparse
from tests.helpers.file_limit import no_file_above

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.io.capture import load_capture
from rtgs.io.colmap import colmap_camera, read_scene, read_sparse, rigid3d_from_se3, write_scene
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.scene import Scene


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("pattern", ["{}.png", "images/rgb/{}.jpg", "{}"])
def test_sparse_model(root: Path, text: bool, pattern: str) -> None:
    write_sparse(root, text=text, pattern=pattern)
    capture = load_capture(root)
    assert capture.poses is not None and capture.poses.points is not None
    for name, pose in POSES.items():
        np.testing.assert_allclose(capture.poses.world_from_rgb[name].matrix(), pose.matrix(), atol=1e-12)
    np.testing.assert_allclose(capture.poses.points.xyz, [[0.1, 0.2, 0.3]])
    np.testing.assert_allclose(capture.poses.points.rgb, [[1, 0, 0.2]])
    assert capture.raw_rig.rgb == RGB


def scene_of(root: Path) -> Scene:
    write_poses(root, poses={name: POSES[name] for name in NAMES[:4]})
    capture = load_capture(root)
    assert capture.poses is not None
    rng = np.random.default_rng(1)
    points = SparsePoints(rng.normal(size=(50, 3)), (rng.integers(0, 256, (50, 3)) / 255).astype(np.float32))
    return Scene(capture, capture.poses.world_from_rgb, points, {NAMES[4]: "few features (3)"})


@pytest.mark.parametrize("sfm_per_metre", [None, 2.5])
def test_scene_folder_round_trip(root: Path, tmp_path: Path, sfm_per_metre: float | None) -> None:
    scene = scene_of(root)
    write_scene(tmp_path / "run" / "scene", scene, sfm_per_metre)
    again = read_scene(tmp_path / "run" / "scene", scene.capture)
    assert list(again.world_from_rgb) == list(scene.world_from_rgb)
    for name, pose in scene.world_from_rgb.items():
        np.testing.assert_allclose(again.world_from_rgb[name].matrix(), pose.matrix(), atol=1e-14)
    np.testing.assert_array_equal(again.points.xyz, scene.points.xyz)
    np.testing.assert_allclose(again.points.rgb, scene.points.rgb, atol=1e-6)
    assert again.failures == {NAMES[4]: "few features (3)"}
    assert read_scene(tmp_path / "run" / "scene", load_capture(root, rgb_max_side=31)).frames[0].rgb.shape == (23, 31, 3)


def test_scene_folder_is_one_rig_in_sfm_units(root: Path, tmp_path: Path) -> None:
    scene = scene_of(root)
    write_scene(tmp_path / "scene", scene, 2.5)
    model = pycolmap.Reconstruction(str(tmp_path / "scene"))
    assert (model.num_rigs(), model.num_frames(), model.num_images()) == (1, 4, 8)
    for name in NAMES[:4]:
        for folder, pose in (("rgb", scene.rgb_from_world(name)), ("thermal", scene.thermal_from_world(name, 2.5))):
            image = model.find_image_with_name(f"{folder}/{name}.png")
            np.testing.assert_allclose(image.cam_from_world().matrix(), pose.matrix()[:3], atol=1e-12)
    assert {c.model_name for c in model.cameras.values()} == {"PINHOLE"}
    np.testing.assert_allclose(model.cameras[2].params, [45, 45, 20, 16])


def test_a_thermal_camera_that_fires_late_has_poses_of_its_own(root: Path, tmp_path: Path) -> None:
    scene = scene_of(root)
    late = replace(scene, capture=replace(scene.capture, rig=replace(scene.rig, time_offset=0.25)))
    write_scene(tmp_path / "scene", late, 2.5)
    model = pycolmap.Reconstruction(str(tmp_path / "scene"))
    assert (model.num_rigs(), model.num_frames(), model.num_images()) == (2, 8, 8)
    for name in NAMES[:4]:
        for folder, pose in (("rgb", scene.rgb_from_world(name)), ("thermal", late.thermal_from_world(name, 2.5))):
            image = model.find_image_with_name(f"{folder}/{name}.png")
            np.testing.assert_allclose(image.cam_from_world().matrix(), pose.matrix()[:3], atol=1e-12)
        assert not np.allclose(
            late.thermal_from_world(name, 2.5).matrix(), scene.thermal_from_world(name, 2.5).matrix(), atol=1e-3
        )
    again = read_scene(tmp_path / "scene", scene.capture)
    assert list(again.world_from_rgb) == list(scene.world_from_rgb)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes there")
@pytest.mark.parametrize("limit", [60, 250, 1000])
def test_a_write_that_colmap_overlooks_is_found(root: Path, tmp_path: Path, limit: int) -> None:
    scene = scene_of(root)
    with (
        pytest.raises(OSError, match="File too large") as stop,
        no_file_above(limit),
        write_whole(tmp_path / "scene") as temporary,
    ):
        write_scene(temporary, scene, 2.5)
    assert stop.value.filename == str(tmp_path / "scene") and not (tmp_path / "scene").exists()


def test_scene_folder_of_another_capture_is_refused(root: Path, tmp_path: Path) -> None:
    write_scene(tmp_path / "scene", scene_of(root), None)
    (root / "transforms.json").unlink()
    edit_rig(root, lambda d: d["rgb"].update(fl_x=90.0))
    with pytest.raises(RtgsError, match="other RGB intrinsics"):
        read_scene(tmp_path / "scene", load_capture(root))
    edit_rig(root, lambda d: d["rgb"].update(fl_x=60.0))
    for folder, suffix in (("rgb", "png"), ("thermal", "tiff")):
        (root / folder / f"{NAMES[0]}.{suffix}").unlink()
    with pytest.raises(RtgsError, match=f"frame '{NAMES[0]}' is not in"):
        read_scene(tmp_path / "scene", load_capture(root))


def test_sparse_with_nan(root: Path) -> None:
    write_sparse(root, poses=POSES | {NAMES[2]: SE3(np.eye(3), np.array([0.0, np.nan, 0.0]))})
    refused(root, "sparse/0", NAMES[2], "NaN")


def test_sparse_in_text_with_nan(root: Path) -> None:
    write_sparse(root, text=True)
    for file in ("frames.txt", "images.txt"):
        path = root / "sparse" / "0" / file
        lines = path.read_text().splitlines(keepends=True)
        at = next(i for i, line in enumerate(lines) if not line.startswith("#"))
        words = lines[at].split()
        words[6] = "nan"
        lines[at] = " ".join(words) + "\n"
        path.write_text("".join(lines))
    refused(root, "sparse/0")


def test_sparse_that_is_no_model(root: Path) -> None:
    (root / "sparse" / "0").mkdir(parents=True)
    refused(root, "sparse/0: is not a COLMAP model that can be read")


@pytest.mark.parametrize("name", ["rigs", "cameras", "frames", "images", "points3D"])
@pytest.mark.parametrize("kept", [0, 4, 9, -1])
def test_sparse_that_is_truncated(root: Path, name: str, kept: int) -> None:
    write_sparse(root)
    path = root / "sparse" / "0" / f"{name}.bin"
    path.write_bytes(path.read_bytes()[:kept])
    refused(root, f"{name}.bin: is truncated")


@pytest.mark.parametrize("name", ["rigs", "frames"])
def test_sparse_that_is_truncated_anywhere(root: Path, name: str) -> None:
    """COLMAP itself goes on for ever with many of these lengths, and accepts others."""
    write_sparse(root)
    path = root / "sparse" / "0" / f"{name}.bin"
    whole = path.read_bytes()
    for kept in range(len(whole)):
        path.write_bytes(whole[:kept])
        with pytest.raises(RtgsError, match=rf"{name}\.bin: is truncated"):
            read_sparse(root / "sparse" / "0")
    path.write_bytes(whole)
    assert len(read_sparse(root / "sparse" / "0")[1].world_from_rgb) == len(POSES)


def test_a_rig_of_two_sensors_that_is_truncated(tmp_path: Path) -> None:
    """A sensor with a pose and one without have records of different length."""
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    sensors = []
    for i in range(3):
        camera = colmap_camera(Camera("PINHOLE", 64, 48, 60.0, 60.0, 32.0, 24.0), i + 1)
        model.add_camera(camera)
        sensors.append(camera.sensor_id)
    rig.add_ref_sensor(sensors[0])
    rig.add_sensor(sensors[1], rigid3d_from_se3(SE3.identity()))
    rig.add_sensor(sensors[2], None)
    model.add_rig(rig)
    frame = pycolmap.Frame(frame_id=1, rig_id=1, rig_from_world=rigid3d_from_se3(SE3.identity()))
    image = pycolmap.Image(name="a.png", camera_id=1, image_id=1)
    frame.add_data_id(image.data_id)
    model.add_frame(frame)
    image.frame_id = 1
    model.add_image(image)
    model.register_frame(1)
    model.write_binary(tmp_path)
    assert list(read_sparse(tmp_path)[1].world_from_rgb) == ["a"]
    for name in ("rigs", "frames"):
        path = tmp_path / f"{name}.bin"
        whole = path.read_bytes()
        path.write_bytes(whole[:-1])
        with pytest.raises(RtgsError, match=rf"{name}\.bin: is truncated"):
            read_sparse(tmp_path)
        path.write_bytes(whole)


@pytest.mark.parametrize("change", [{"fl_x": 1e-9}, {"fl_y": 1e9}, {"cx": 1e4}, {"cy": -1e4}])
def test_sparse_with_absurd_intrinsics(root: Path, change: dict[str, float]) -> None:
    write_sparse(root, replace(RGB, **change))  # type: ignore[arg-type]
    refused(root, "sparse/0: camera 1: ", next(iter(change)))


def test_sparse_with_an_unknown_camera_model(root: Path) -> None:
    write_sparse(root, text=True)
    (root / "sparse" / "0" / "cameras.txt").write_text("1 FULL_OPENCV 64 48 60 61 32 24 0 0 0 0 0 0 0 0\n")
    refused(root, "sparse/0", "FULL_OPENCV", "SIMPLE_RADIAL")


def test_sparse_with_several_cameras(root: Path) -> None:
    model = pycolmap.Reconstruction()
    for i, (name, pose) in enumerate(POSES.items()):
        model.add_camera_with_trivial_rig(colmap_camera(Camera("PINHOLE", 64, 48, 60.0 + i, 60.0, 32.0, 24.0), i + 1))
        image = pycolmap.Image(name=name, camera_id=i + 1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, rigid3d_from_se3(pose.inverse()))
    (root / "sparse" / "0").mkdir(parents=True)
    model.write_binary(root / "sparse" / "0")
    refused(root, "5 different cameras", "single_camera")
