"""Capture folders: what loads, and what each wrong input says."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.colmap import colmap_camera, quiet_colmap, read_scene, rigid3d_from_se3, write_scene
from rtgs.io.image_files import frame_name, in_thermal_folder, read_rgb
from rtgs.io.rig import read_rig, write_rig
from rtgs.io.transforms import read_transforms, write_transforms
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.radiometry import (
    CENTIKELVIN,
    Atmosphere,
    CountsToCelsius,
    ObjectParameters,
    PlanckCalibration,
    PlanckRadiometry,
    RelativeCounts,
)
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene

RGB = Camera("OPENCV", 64, 48, 60.0, 61.0, 32.5, 23.5, k1=-0.05, k2=0.01, p1=0.001, p2=-0.002)
THERMAL = Camera("PINHOLE", 40, 32, 45.0, 45.0, 20.0, 16.0)
RGB_FROM_THERMAL = SE3(rotation_from_axis_angle([0.01, -0.03, 0.02]), np.array([0.05, -0.002, 0.01]))
RADIOMETRY = CountsToCelsius(0.025, -100.0)
PLANCK = PlanckRadiometry(
    PlanckCalibration(15848.85, 0.014533, 1414.9, 1.0, -4405, Atmosphere(alpha1=0.0066)),
    ObjectParameters(0.95, 22.0, 18.0, 2.0, 0.4, 20.0, 0.98),
)
NAMES = tuple(f"10-5{i}.{i}" for i in range(5))  # a dot in a stem is not a suffix
POSES = {name: look_at([np.cos(i / 5), np.sin(i / 5), 0.1 * i], [0.0, 0.0, 0.0]) for i, name in enumerate(NAMES)}
ARCO = Path(os.environ.get("RTGS_DATA", Path(__file__).parents[3] / "shared" / "data")) / "arco"
needs_arco = pytest.mark.skipif(not ARCO.is_dir(), reason="the real capture arco is not here (RTGS_DATA or ../shared/data)")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A small, correct capture without poses."""
    root = tmp_path / "capture"
    (root / "rgb").mkdir(parents=True)
    (root / "thermal").mkdir()
    rng = np.random.default_rng(0)
    for i, name in enumerate(NAMES):
        Image.fromarray(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)).save(root / "rgb" / f"{name}.png")
        Image.fromarray(np.full((32, 40), 4800 + i, dtype=np.uint16)).save(root / "thermal" / f"{name}.tiff")
    write_rig(root / "rig.json", Rig(RGB, THERMAL, RGB_FROM_THERMAL), RADIOMETRY)
    return root


def edit_rig(root: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    data = json.loads((root / "rig.json").read_text())
    change(data)
    (root / "rig.json").write_text(json.dumps(data))


def write_poses(root: Path, camera: Camera = RGB, poses: dict[str, SE3] = POSES) -> None:
    write_transforms(root / "transforms.json", camera, poses, {name: f"./rgb/{name}.png" for name in poses})


def edit_transforms(root: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    data = json.loads((root / "transforms.json").read_text())
    change(data)
    (root / "transforms.json").write_text(json.dumps(data))


def write_sparse(
    root: Path, camera: Camera = RGB, poses: dict[str, SE3] = POSES, *, text: bool = False, pattern: str = "{}.png"
) -> None:
    """A model as COLMAP itself would leave it: one camera, one image a frame."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(colmap_camera(camera, 1))
    for i, (name, pose) in enumerate(poses.items()):
        image = pycolmap.Image(name=pattern.format(name), camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, rigid3d_from_se3(pose.inverse()))
    model.add_point3D(np.array([0.1, 0.2, 0.3]), pycolmap.Track(), np.array([255, 0, 51], dtype=np.uint8))
    folder = root / "sparse" / "0"
    folder.mkdir(parents=True)
    with quiet_colmap():
        (model.write_text if text else model.write_binary)(folder)


def refused(root: Path, *said: str) -> None:
    """Loading fails with one message that holds each of `said`."""
    with pytest.raises(RtgsError) as error:
        load_capture(root)
    for part in said:
        assert part in str(error.value)
    assert "\n" not in str(error.value)


# ---------------------------------------------------------------------------------------------------- what loads


def test_a_capture_without_poses(root: Path) -> None:
    capture = load_capture(root)
    assert [f.name for f in capture.frames] == list(NAMES)
    assert capture.poses is None
    assert capture.warnings == ()
    assert capture.frames[0].rgb.shape == (48, 64, 3)
    assert capture.frames[0].rgb.dtype == capture.frames[0].thermal.dtype == np.float32
    assert capture.radiometry.unit == "°C"
    np.testing.assert_allclose(capture.frames[3].thermal, 4803 * 0.025 - 100, atol=1e-5)
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


def test_either_direction_of_the_rig_transform(root: Path) -> None:
    def invert(data: dict[str, Any]) -> None:
        data["thermal_from_rgb"] = np.linalg.inv(np.array(data.pop("rgb_from_thermal"))).tolist()

    edit_rig(root, invert)
    np.testing.assert_allclose(load_capture(root).rig.rgb_from_thermal.matrix(), RGB_FROM_THERMAL.matrix(), atol=1e-12)


def test_a_printed_rotation_is_made_orthonormal(root: Path) -> None:
    edit_rig(root, lambda d: d.update(rgb_from_thermal=np.round(RGB_FROM_THERMAL.matrix(), 4).tolist()))
    rotation = load_capture(root).rig.rgb_from_thermal.rotation
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-14)


def test_centikelvin(root: Path) -> None:
    def use_unit(data: dict[str, Any]) -> None:
        del data["thermal"]["celsius_per_count"], data["thermal"]["celsius_offset"]
        data["thermal"]["unit"] = "centikelvin"

    edit_rig(root, use_unit)
    for name in NAMES:
        Image.fromarray(np.full((32, 40), 29815, dtype=np.uint16)).save(root / "thermal" / f"{name}.tiff")
    np.testing.assert_allclose(load_capture(root).frames[0].thermal, 25.0, atol=1e-5)


def use_planck(root: Path, change: Callable[[dict[str, Any]], Any] = lambda thermal: None) -> None:
    """Thermal files of 30.00, 30.01, … °C as a camera with Planck constants stores them, and the rig that says so."""
    write_rig(root / "rig.json", Rig(RGB, THERMAL, RGB_FROM_THERMAL), PLANCK)
    for i, name in enumerate(NAMES):
        signal = PLANCK.counts(np.full((32, 40), 30.0 + 0.01 * i)).astype(np.float32)
        Image.fromarray(signal).save(root / "thermal" / f"{name}.tiff")
    edit_rig(root, lambda d: change(d["thermal"]))


def test_planck_constants_and_object_parameters(root: Path) -> None:
    use_planck(root)
    assert read_rig(root / "rig.json").radiometry == PLANCK
    capture = load_capture(root)
    assert capture.radiometry.unit == "°C" and capture.warnings == ()
    assert capture.frames[2].thermal.dtype == np.float32
    np.testing.assert_allclose(capture.frames[2].thermal, 30.02, atol=2e-4)  # the float32 signal of the file: 0.001 counts


def test_another_emissivity_in_the_rig_file_changes_temperatures_as_the_formula_says(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emissivity=0.7, reflected_c=-20.0))
    expected = PLANCK.reevaluated(np.array([30.0]), emissivity=0.7, reflected_c=-20.0)
    assert expected > 40
    np.testing.assert_allclose(load_capture(root).frames[0].thermal, expected[0], atol=5e-4)


def test_atmosphere_defaults_to_flirs(root: Path) -> None:
    use_planck(root, lambda thermal: [thermal["planck"].pop(k) for k in ("alpha1", "alpha2", "beta1", "beta2", "x")])
    radiometry = read_rig(root / "rig.json").radiometry
    assert isinstance(radiometry, PlanckRadiometry) and radiometry.calibration.atmosphere == Atmosphere()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.pop("object"), "thermal.object is missing; it holds emissivity, reflected_c"),
        (lambda t: t.pop("planck"), "thermal.object needs thermal.planck"),
        (lambda t: t.update(planck=3), "thermal.planck is not an object {…}"),
        (lambda t: t["planck"].pop("r2"), "thermal.planck.r2 is missing"),
        (lambda t: t["planck"].update(b=0), "thermal.planck.b is 0; a Planck constant is a finite number above 0"),
        (lambda t: t["object"].update(emissivity=95), "thermal.object.emissivity is 95; it is above 0 and at most 1"),
        (lambda t: t["object"].update(emissivity="0.95"), "thermal.object.emissivity is '0.95'; a finite number is expected"),
        (lambda t: t["object"].update(relative_humidity=50), "not per cent"),
        (lambda t: t.update(unit="centikelvin"), "thermal.planck and thermal.unit are both given"),
        (lambda t: t.update(celsius_offset=0), "thermal.planck and thermal.celsius_offset are both given"),
    ],
)
def test_wrong_planck_blocks_are_refused(root: Path, change: Callable[[dict[str, Any]], Any], said: str) -> None:
    use_planck(root, change)
    refused(root, "rig.json", said)


def test_parameters_that_leave_no_temperature_are_refused(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emissivity=0.01, reflected_c=80.0))
    refused(root, f"{NAMES[0]}.tiff", "100.0% of its pixels", "Is object.emissivity too low")


def test_unknown_planck_fields_warn(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emisivity=0.9))
    assert any("thermal.object.emisivity is not a known field" in w for w in load_capture(root).warnings)


def test_without_radiometry_counts_are_relative(root: Path) -> None:
    edit_rig(root, lambda d: (d["thermal"].pop("celsius_per_count"), d["thermal"].pop("celsius_offset")))
    capture = load_capture(root)
    assert capture.radiometry == RelativeCounts() and capture.radiometry.unit == "counts"
    np.testing.assert_array_equal(capture.frames[2].thermal, 4802)


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
    edit_rig(root, lambda d: d["thermal"].update(celsius_per_count=1, celsius_offset=0))
    for name in NAMES:
        (root / "thermal" / f"{name}.tiff").unlink()
        Image.fromarray(np.full((32, 40), value, dtype=dtype)).save(root / "thermal" / f"{name}{suffix}")
    np.testing.assert_array_equal(load_capture(root).frames[0].thermal, value)


def test_radiometry_inverts() -> None:
    counts = np.arange(65536)
    np.testing.assert_allclose(CENTIKELVIN.counts(CENTIKELVIN.celsius(counts)), counts, atol=2e-3)


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


def test_rig_file_round_trip(root: Path) -> None:
    rig_file = read_rig(root / "rig.json")
    assert (rig_file.rig.rgb, rig_file.rig.thermal, rig_file.radiometry) == (RGB, THERMAL, RADIOMETRY)
    np.testing.assert_allclose(rig_file.rig.baseline_m, np.linalg.norm(RGB_FROM_THERMAL.translation))


def test_how_well_the_rig_is_calibrated_comes_through(root: Path, tmp_path: Path) -> None:
    assert load_capture(root).rig.calibration_std is None
    edit_rig(root, lambda d: d.update(uncertainty={"rotation_deg": 0.1, "baseline_length": 0.01, "scale": 3}))
    capture = load_capture(root)
    expected = CalibrationStd(baseline_length=0.01, rotation_rad=np.radians(0.1))
    assert capture.rig.calibration_std == capture.raw_rig.calibration_std == expected
    assert any("uncertainty.scale is not a known field" in w for w in capture.warnings)
    write_rig(tmp_path / "rig.json", capture.raw_rig, RelativeCounts())
    again = read_rig(tmp_path / "rig.json").rig.calibration_std
    assert again is not None and again.rotation_rad == pytest.approx(expected.rotation_rad, rel=1e-12)


@pytest.mark.parametrize("value", [-0.1, "much", None])
def test_an_uncertainty_that_is_none(root: Path, value: Any) -> None:
    edit_rig(root, lambda d: d.update(uncertainty={"rotation_deg": value}))
    with pytest.raises(RtgsError, match=r"rig.json.*uncertainty\.rotation_deg"):
        load_capture(root)
    edit_rig(root, lambda d: d.update(uncertainty=0.1))
    with pytest.raises(RtgsError, match="uncertainty is not an object"):
        load_capture(root)


def test_suspicious_rig_fields_warn(root: Path) -> None:
    edit_rig(root, lambda d: d["thermal"].update(celcius=1))
    edit_rig(root, lambda d: d["rgb_from_thermal"][0].__setitem__(3, 50.0))
    warnings = " ".join(load_capture(root).warnings)
    assert "thermal.celcius is not a known field" in warnings
    assert "millimetres" in warnings


def test_other_files_in_the_folders_are_passed_over(root: Path) -> None:
    (root / "rgb" / "notes.txt").write_text("hello")
    (root / "rgb" / "._a.png").write_bytes(b"mac")
    assert len(load_capture(root).frames) == len(NAMES)


# ---------------------------------------------------------------------------------------------------- poses


def test_transforms_are_turned_to_opencv(root: Path) -> None:
    """A nerfstudio camera at (0, 0, 5) with identity rotation looks down −z at the origin."""
    pose = np.eye(4)
    pose[2, 3] = 5
    path = root / "transforms.json"
    path.write_text(json.dumps({"camera_angle_x": 0.8, "frames": [{"file_path": "./rgb/a", "transform_matrix": pose.tolist()}]}))
    camera, world_from_rgb = read_transforms(path, (64, 48))
    np.testing.assert_allclose(world_from_rgb["a"].inverse().apply(np.zeros(3)), [0, 0, 5], atol=1e-12)
    np.testing.assert_allclose(world_from_rgb["a"].inverse().apply(np.array([0.0, 1.0, 0.0])), [0, -1, 5], atol=1e-12)  # y up
    assert camera is not None
    np.testing.assert_allclose(camera.fl_x, 32 / np.tan(0.4))
    assert (camera.model, camera.fl_y, camera.cx, camera.cy) == ("PINHOLE", camera.fl_x, 32, 24)


def test_transforms_round_trip_through_a_capture(root: Path) -> None:
    write_poses(root)
    capture = load_capture(root)
    assert capture.poses is not None and capture.poses.points is None
    assert capture.raw_rig.rgb == RGB
    for name, pose in POSES.items():
        np.testing.assert_allclose(capture.poses.world_from_rgb[name].matrix(), pose.matrix(), atol=1e-12)


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


def test_poses_without_intrinsics_use_the_rig(root: Path) -> None:
    write_poses(root)
    edit_transforms(root, lambda d: [d.pop(k) for k in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")])
    assert load_capture(root).raw_rig.rgb == RGB


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


def test_thermal_frames_in_transforms_are_passed_over(root: Path) -> None:
    write_poses(root)
    thermal = {"file_path": f"thermal/{NAMES[0]}.tiff", "transform_matrix": np.eye(4).tolist()}
    edit_transforms(root, lambda d: d["frames"].insert(0, thermal))
    poses = load_capture(root).poses
    assert poses is not None
    np.testing.assert_allclose(poses.world_from_rgb[NAMES[0]].matrix(), POSES[NAMES[0]].matrix(), atol=1e-12)


def test_frame_names() -> None:
    names = ["a/10.5", "./rgb/10.5.jpg", "10.5.TIFF", "rgb\\10.5.png"]
    assert {frame_name(n) for n in names} == {"10.5"}
    assert in_thermal_folder("thermal/train/1.tiff")
    assert not in_thermal_folder("/home/me/thermal/rgb/1.png")
    assert not in_thermal_folder("thermal.png")


# ---------------------------------------------------------------------------------------------------- the run's scene folder


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


# ---------------------------------------------------------------------------------------------------- wrong input


def test_no_such_capture(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "nowhere: no such folder", "rgb/, thermal/ and rig.json")


def test_missing_rig(root: Path) -> None:
    (root / "rig.json").unlink()
    refused(root, "rig.json: no such file", "both cameras")


def test_rig_is_not_json(root: Path) -> None:
    (root / "rig.json").write_text("{rgb: 1}")
    refused(root, "rig.json: is not valid JSON", "line 1")
    (root / "rig.json").write_text("[1, 2]")
    refused(root, "holds list where a JSON object")


WRONG_RIGS: list[tuple[Callable[[dict[str, Any]], Any], list[str]]] = [
    (lambda d: d.pop("thermal"), ["rig.json: thermal is missing"]),
    (lambda d: d.update(rgb=3), ["rig.json: rgb is not an object"]),
    (lambda d: d["rgb"].pop("model"), ["rgb.model is missing", "OPENCV_FISHEYE"]),
    (
        lambda d: d["rgb"].update(model="KANNALA"),
        ["rgb.model is 'KANNALA'", "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV"],
    ),
    (lambda d: d["rgb"].pop("fl_x"), ["rig.json: rgb.fl_x is missing"]),
    (lambda d: d["rgb"].pop("k2"), ["rgb.k2 is missing", "write 0"]),
    (lambda d: d["thermal"].update(k1=0.1), ["thermal.k1 is given, but PINHOLE has no such term", "OPENCV"]),
    (lambda d: d["rgb"].update(cx="32"), ["rgb.cx is '32'", "finite number"]),
    (lambda d: d["rgb"].update(cx=float("nan")), ["rgb.cx is nan"]),
    (lambda d: d["thermal"].update(fl_y=-45), ["thermal.fl_y is -45", "above 0"]),
    (lambda d: d["thermal"].update(fl_x=0), ["thermal.fl_x is 0"]),
    (lambda d: d["thermal"].update(model="SIMPLE_PINHOLE", fl_x=46), ["thermal.fl_x and fl_y differ", "Use PINHOLE"]),
    (lambda d: d["rgb"].update(width=64.5), ["rgb.width is 64.5", "whole number"]),
    (lambda d: d["rgb"].update(width=128, height=96), ["rgb.width and height say 128×96", "rgb/10-50.0.png is 64×48"]),
    (lambda d: d["thermal"].update(width=32, height=40), ["thermal.width and height say 32×40", "10-50.0.tiff is 40×32"]),
    (lambda d: d.update(thermal_from_rgb=np.eye(4).tolist()), ["exactly one of", "both are given"]),
    (lambda d: d.pop("rgb_from_thermal"), ["exactly one of", "neither is given"]),
    (lambda d: d.update(rgb_from_thermal=np.eye(3).tolist()), ["rgb_from_thermal is not a 4×4 matrix"]),
    (lambda d: d.update(rgb_from_thermal=[[1, 2], [3]]), ["rgb_from_thermal is not a 4×4 matrix"]),
    (lambda d: d["rgb_from_thermal"][0].__setitem__(3, float("inf")), ["rgb_from_thermal holds NaN or infinity"]),
    (
        lambda d: d.update(rgb_from_thermal=np.array(d["rgb_from_thermal"]).T.tolist()),
        ["bottom row of rgb_from_thermal", "transposed"],
    ),
    (lambda d: d["rgb_from_thermal"][0].__setitem__(0, -1.0), ["rgb_from_thermal is no rotation", "determinant"]),
    (lambda d: d.update(rgb_from_thermal=np.eye(4).tolist()), ["translation of rgb_from_thermal is zero", "baseline in metres"]),
    (lambda d: d["thermal"].update(unit="centikelvin"), ["thermal.unit and thermal.celsius_per_count are both given"]),
    (lambda d: d["thermal"].pop("celsius_per_count"), ["thermal.celsius_per_count is missing"]),
    (lambda d: d["thermal"].pop("celsius_offset"), ["thermal.celsius_offset is missing"]),
    (lambda d: d["thermal"].update(celsius_per_count=0), ["celsius_per_count is 0", "above 0"]),
    (
        lambda d: (d["thermal"].pop("celsius_per_count"), d["thermal"].pop("celsius_offset"), d["thermal"].update(unit="kelvin")),
        ["thermal.unit is 'kelvin'", "centikelvin"],
    ),
]


@pytest.mark.parametrize(("change", "said"), WRONG_RIGS, ids=[said[0][:40] for _, said in WRONG_RIGS])
def test_wrong_rig(root: Path, change: Callable[[dict[str, Any]], Any], said: list[str]) -> None:
    edit_rig(root, change)
    refused(root, "rig.json: ", *said)


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


@pytest.mark.parametrize("folder", ["rgb", "thermal"])
def test_not_an_image(root: Path, folder: str) -> None:
    path = next((root / folder).glob(f"{NAMES[3]}.*"))
    path.write_bytes(b"not an image at all")
    refused(root, path.name, "cannot be read")


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


def test_silly_max_side(root: Path) -> None:
    with pytest.raises(RtgsError, match="rgb_max_side is 0"):
        load_capture(root, rgb_max_side=0)


WRONG_TRANSFORMS: list[tuple[Callable[[dict[str, Any]], Any], list[str]]] = [
    (lambda d: d.pop("frames"), ["frames is missing or empty"]),
    (lambda d: d["frames"][1].pop("file_path"), ["frames[1].file_path is missing"]),
    (lambda d: d["frames"][1].pop("transform_matrix"), ["frames[1].transform_matrix is missing", NAMES[1]]),
    (
        lambda d: d["frames"][2]["transform_matrix"][0].__setitem__(3, float("nan")),
        [f"frames[2].transform_matrix ({NAMES[2]})", "NaN"],
    ),
    (lambda d: d["frames"][2]["transform_matrix"][3].__setitem__(0, 1.0), ["bottom row of frames[2].transform_matrix"]),
    (lambda d: d["frames"][2]["transform_matrix"][0].__setitem__(0, 9.0), ["frames[2].transform_matrix", "no rotation"]),
    (lambda d: d["frames"][2].update(transform_matrix="pose"), ["frames[2].transform_matrix", "not a 4×4"]),
    (lambda d: d["frames"].append(dict(d["frames"][0])), ["a second time", NAMES[0]]),
    (lambda d: d["frames"][2].update(fl_x=70.0) or d["frames"][1].update(fl_x=71.0), ["fl_x differs between frames"]),
    (lambda d: d.update(camera_model="EQUIRECTANGULAR"), ["camera.model is 'EQUIRECTANGULAR'", "PINHOLE"]),
    (lambda d: d.update(fl_x=-1.0), ["camera.fl_x is -1"]),
    (lambda d: (d.pop("fl_x"), d.update(camera_angle_x=4.0)), ["camera_angle_x is 4", "radians"]),
    (lambda d: d.update(w=128, h=96), ["its camera is 128×96", "64×48"]),
    (lambda d: d.update(frames=d["frames"][:2]), ["poses for 2 of the 5 images", "at least 3"]),
    (
        lambda d: [f.update(file_path=f["file_path"].replace("10-", "image")) for f in d["frames"]],
        ["poses for 0 of the 5 images"],
    ),
    (
        lambda d: [f.update(transform_matrix=d["frames"][0]["transform_matrix"]) for f in d["frames"]],
        ["camera positions coincide"],
    ),
]


@pytest.mark.parametrize(("change", "said"), WRONG_TRANSFORMS, ids=[said[0][:40] for _, said in WRONG_TRANSFORMS])
def test_wrong_transforms(root: Path, change: Callable[[dict[str, Any]], Any], said: list[str]) -> None:
    write_poses(root)
    edit_transforms(root, change)
    refused(root, "transforms.json: ", *said)


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


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("kept", [0, 4, 9, -1])
def test_sparse_that_is_truncated(root: Path, name: str, kept: int) -> None:
    write_sparse(root)
    path = root / "sparse" / "0" / f"{name}.bin"
    path.write_bytes(path.read_bytes()[:kept])
    refused(root, f"{name}.bin: is truncated")


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


# ---------------------------------------------------------------------------------------------------- a real capture


@needs_arco
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
