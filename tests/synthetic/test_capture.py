"""Synthetic captures: the files follow the conventions, the truth is exact, each option does what it says and no more."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3, is_rotation, look_at
from rtgs.records.camera import Camera
from rtgs.synthetic import SCENES, GroundTruth, SynthConfig, compiled_scene, render_rgb, render_thermal, write_capture
from rtgs.synthetic.capture import camera_path, sfm_per_metre_of, true_rig, written_rig
from rtgs.synthetic.meshes import box, cylinder, plate_with_hole, rod, sphere, torus
from rtgs.synthetic.model import STUDIO, Light, Material, Model, Part
from rtgs.synthetic.raycast import CompiledModel

pytest.importorskip("embreex")

SMALL = SynthConfig(scene="hotdog", frames=2, size=48, seed=3)


@pytest.fixture(scope="module", params=SCENES)
def capture(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GroundTruth]:
    out = tmp_path_factory.mktemp("capture") / request.param
    return out, write_capture(out, SynthConfig(scene=request.param, frames=4, size=64, thermal_size=56, seed=1))


def _thermal_c(folder: Path, name: str) -> NDArray[np.float64]:
    rig = json.loads((folder / "rig.json").read_text())["thermal"]
    counts = np.asarray(Image.open(folder / "thermal" / f"{name}.tiff"))
    return counts * rig["celsius_per_count"] + rig["celsius_offset"]


def _clean_c(folder: Path, name: str) -> NDArray[np.float32]:
    return np.asarray(Image.open(folder / "ground_truth" / "thermal_clean" / f"{name}.tiff"))


def _files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_files_follow_the_conventions(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    names = [f"frame_{i:03d}" for i in range(4)]
    assert sorted(p.name for p in (folder / "rgb").iterdir()) == [f"{n}.png" for n in names]
    assert sorted(p.name for p in (folder / "thermal").iterdir()) == [f"{n}.tiff" for n in names]
    assert not list(folder.rglob("*.part"))
    for name in names:
        rgb = Image.open(folder / "rgb" / f"{name}.png")
        thermal = np.asarray(Image.open(folder / "thermal" / f"{name}.tiff"))
        assert rgb.size == (64, 64) and rgb.mode == "RGB"
        assert thermal.shape == (56, 56) and thermal.dtype == np.uint16
        assert _clean_c(folder, name).dtype == np.float32
    rig = json.loads((folder / "rig.json").read_text())
    assert ("thermal_from_rgb" in rig) + ("rgb_from_thermal" in rig) == 1
    t = np.array(rig["rgb_from_thermal"])
    assert is_rotation(t[:3, :3], 1e-9) and np.linalg.norm(t[:3, 3]) == pytest.approx(0.20)
    assert abs(t[0, 3]) > 0.9 * np.linalg.norm(t[:3, 3])  # mostly sideways
    assert 1 < math.degrees(math.acos((np.trace(t[:3, :3]) - 1) / 2)) < 6
    transforms = json.loads((folder / "transforms.json").read_text())
    assert [f["file_path"] for f in transforms["frames"]] == [f"rgb/{n}.png" for n in names]
    assert all(transforms[k] == rig["rgb"][k] for k in ("fl_x", "fl_y", "cx", "cy"))
    assert (transforms["w"], transforms["h"]) == (64, 64)
    assert truth.rig.rgb.width == 64 and truth.rig.thermal.width == 56


def test_written_poses_are_the_true_ones_in_another_unit_and_axes(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    for entry in json.loads((folder / "transforms.json").read_text())["frames"]:
        name = Path(entry["file_path"]).stem
        written = np.array(entry["transform_matrix"])
        true = truth.world_from_rgb[name]
        np.testing.assert_allclose(written[:3, 3], truth.sfm_per_metre * true.translation, rtol=1e-12)
        np.testing.assert_allclose(written[:3, :3], true.rotation * [1, -1, -1], atol=1e-12)  # OpenGL: y up, z backwards
        assert written[:3, 1] @ [0, 0, 1] > 0  # the image's up is the world's


def test_thermal_pose_is_the_rgb_pose_with_the_rig(capture: tuple[Path, GroundTruth]) -> None:
    """Eq. 1: `world_from_thermal = world_from_rgb ∘ (R, s·t)`, in metres and in SfM units."""
    _, truth = capture
    s = truth.sfm_per_metre
    for name, pose in truth.world_from_rgb.items():
        thermal = truth.world_from_thermal[name]
        np.testing.assert_allclose((pose @ truth.rig.rgb_from_thermal).matrix(), thermal.matrix(), atol=1e-12)
        in_sfm = SE3(pose.rotation, s * pose.translation) @ truth.rig.rgb_from_thermal.with_baseline_scaled(s)
        np.testing.assert_allclose(in_sfm.translation, s * thermal.translation, rtol=1e-9, atol=1e-12)


def test_ground_truth_file_holds_what_is_returned(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    stored = json.loads((folder / "ground_truth.json").read_text())
    assert stored == json.loads(json.dumps(truth.to_json()))
    assert stored["sfm_per_metre"] == truth.sfm_per_metre and stored["config"]["seed"] == 1


def test_temperatures_span_20_degrees_and_are_no_copy_of_the_colours(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    low, high = truth.temperature_range_c
    assert high - low > 20
    inner_span, correlations = [], []
    for name in truth.world_from_rgb:
        clean = _clean_c(folder, name)
        seen = clean != np.float32(truth.background_c)
        assert seen.mean() > 0.05
        inner_span += [*np.percentile(clean[seen], [2, 98])]
        gray = np.asarray(
            Image.open(folder / "rgb" / f"{name}.png").convert("L").resize((56, 56), Image.Resampling.BOX), dtype=float
        )
        correlations.append(np.corrcoef(gray[seen], clean[seen])[0, 1])
    assert max(inner_span) - min(inner_span) > 15  # not one hot speck
    assert np.abs(correlations).max() < 0.6


def test_noise_is_as_asked(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    error = np.stack([_thermal_c(folder, n) - _clean_c(folder, n) for n in truth.world_from_rgb])
    assert error.std() == pytest.approx(math.hypot(truth.config.netd_c, 0.01 / math.sqrt(12)), rel=0.03)
    assert abs(error.mean()) < 0.002


@pytest.mark.parametrize("scene", [s for s in SCENES if s != "room"])
def test_objects_stay_in_both_pictures(scene: str) -> None:
    config = SynthConfig(scene=scene)  # type: ignore[arg-type]
    model, rig = compiled_scene(config.scene), true_rig(config)
    for world_from_rgb in camera_path(config, model.model.centre):
        for camera, pose in ((rig.rgb, world_from_rgb), (rig.thermal, world_from_rgb @ rig.rgb_from_thermal)):
            pixels = _project(camera, pose, model.points)
            assert pixels.min() > 0 and pixels.max() < camera.width


def test_the_plain_fills_the_picture_and_hides_the_baseline() -> None:
    config = SynthConfig(scene="plain", size=100, frames=12, rig_seed=2)
    model, rig = compiled_scene("plain"), true_rig(config)
    for pose in camera_path(config, model.model.centre):
        image = render_thermal(model, rig.thermal, pose @ rig.rgb_from_thermal, 1)
        assert image.min() > model.model.background_c + 2  # no pixel looks past it
        assert image.max() - image.min() > 10
    flow_px = rig.thermal.fl_x * config.baseline_m / 750
    assert flow_px < 0.05


def _project(camera: Camera, world_from_camera: SE3, points: NDArray[np.float64]) -> NDArray[np.float64]:
    p = world_from_camera.inverse().apply(points)
    return p[..., :2] / p[..., 2:] * [camera.fl_x, camera.fl_y] + [camera.cx, camera.cy]


def test_a_known_ball_lies_where_the_truth_projects_it() -> None:
    """Both renders against the projection formula, to a few hundredths of a pixel: any half-pixel slip would show."""
    ball = Part(sphere(0.12, 64), Material(), (0.0, 0.0, 0.0), 40.0)
    model = CompiledModel(Model((ball,), (), ambient_c=40.0, background_c=0.0))
    config = SynthConfig(size=96)
    rig = true_rig(config)
    world_from_rgb = look_at((3.1, -2.0, 1.4), (0.3, 0.2, -0.1))
    world_from_thermal = world_from_rgb @ rig.rgb_from_thermal
    dark = 1 - render_rgb(model, rig.rgb, world_from_rgb, 4).mean(axis=-1, dtype=np.float64) ** 2.2
    warm = render_thermal(model, rig.thermal, world_from_thermal, 4).astype(np.float64) / 40.0
    for weight, camera, pose in ((dark, rig.rgb, world_from_rgb), (warm, rig.thermal, world_from_thermal)):
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        centroid = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        # A ball's outline is an ellipse whose centre lies a little outside the projected centre (here under 0.03 px).
        np.testing.assert_allclose(centroid, _project(camera, pose, np.zeros(3)), atol=0.06)


def test_light_casts_shadows_and_hidden_surfaces_are_nearer_air_temperature() -> None:
    floor = Part(box((4, 4, 0.1), (0, 0, -0.05)), Material(), (0.8, 0.8, 0.8), 60.0)
    lid = Part(box((1, 1, 0.02), (0, 0, 0.3)), Material(), (0.8, 0.8, 0.8), 60.0)
    above = Light(np.array([[0.0, 0.0, 50.0]]), (1.0, 1.0, 1.0))
    model = CompiledModel(Model((floor, lid), (above,), ambient_c=20.0, occlusion_m=1.0))
    origins = np.array([[-3.0, 0, 1.2], [-3.0, 0, 1.2]])
    targets = np.array([[0.0, 0, 0], [-1.4, 0, 0]])  # under the lid; in the open
    directions = (targets - origins) / np.linalg.norm(targets - origins, axis=1, keepdims=True)
    hits = model.hits(origins, directions)
    np.testing.assert_allclose(hits.surface.world, targets, atol=1e-9)
    np.testing.assert_allclose(hits.surface.normal, [[0, 0, 1], [0, 0, 1]], atol=1e-6)
    shadow, lit = model.radiance(hits, -directions).mean(axis=1)
    assert shadow < 0.4 * lit
    hidden_c, open_c = model.temperature_c(hits)
    assert 20 + 0.6 * 40 - 1e-6 <= hidden_c < open_c - 5
    assert open_c <= 60 + 1e-6


@pytest.mark.parametrize(
    ("mesh", "inside"),
    [
        (box((0.4, 0.5, 0.6)), (0, 0, 0)),
        (sphere(0.3), (0, 0, 0)),
        (cylinder(0.2, 0.5), (0, 0, 0.25)),
        (rod((0, 0, 0), (0.3, 0.2, 0.4), 0.05), (0.15, 0.1, 0.2)),
        (torus(0.4, 0.1), (0.4, 0, 0)),
        (plate_with_hole(0.2, 0.05, 0.04), (0.08, 0, 0)),
    ],
)
def test_shapes_are_closed_and_normals_point_outwards(mesh, inside) -> None:  # type: ignore[no-untyped-def]
    """Rays from within meet a face from behind, whichever way they go; so no light leaks and occlusion looks outwards."""
    model = CompiledModel(Model((Part(mesh, Material()),), STUDIO))
    directions = np.random.default_rng(0).normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile(np.asarray(inside, dtype=float), (300, 1))
    assert len(model.hits(origins, directions).ray) == 300
    corners = mesh.points[mesh.faces]
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    solid = np.linalg.norm(n, axis=1) > 1e-10
    mean_normal = mesh.normals[mesh.faces].mean(axis=1)
    unit = n[solid] / np.linalg.norm(n[solid], axis=1, keepdims=True)
    assert (np.abs((unit * mean_normal[solid]).sum(axis=1)) > 0.8).all()
    probe = corners[solid].mean(axis=1) + 1e-4 * mean_normal[solid]
    outwards = mean_normal[solid] / np.linalg.norm(mean_normal[solid], axis=1, keepdims=True)
    behind = model.occluded(probe - 1e-2 * outwards, outwards, 0.02)
    assert behind.mean() > 0.95


def test_same_seed_same_bytes_and_another_seed_another_capture(tmp_path: Path) -> None:
    write_capture(tmp_path / "a", SMALL)
    write_capture(tmp_path / "b", SMALL)
    write_capture(tmp_path / "c", replace(SMALL, seed=4))
    a, b, c = (_files(tmp_path / x) for x in "abc")
    assert a == b
    assert all(a[k] != c[k] for k in a if k != "rig.json")


def test_units_are_drawn_log_uniformly() -> None:
    drawn = np.log([sfm_per_metre_of(replace(SMALL, seed=k)) for k in range(600)])
    low, high = math.log(0.05), math.log(20)
    assert drawn.min() >= low and drawn.max() <= high
    uniform = (np.sort(drawn) - low) / (high - low)
    assert np.abs(uniform - (np.arange(600) + 0.5) / 600).max() < 0.08  # Kolmogorov–Smirnov, far in the tail
    assert sfm_per_metre_of(replace(SMALL, sfm_per_metre=1.0)) == 1.0


def test_unit_changes_poses_only(tmp_path: Path) -> None:
    write_capture(tmp_path / "a", replace(SMALL, sfm_per_metre=1.0))
    write_capture(tmp_path / "b", replace(SMALL, sfm_per_metre=7.0))
    a, b = _files(tmp_path / "a"), _files(tmp_path / "b")
    assert {k for k in a if a[k] != b[k]} == {"transforms.json", "ground_truth.json"}


@pytest.mark.parametrize("field", ["rig_length_error", "rig_direction_error", "rig_rotation_error_deg", "thermal_focal_error"])
def test_calibration_errors_change_what_is_told_not_what_is_seen(field: str) -> None:
    config = replace(SMALL, **{field: 0.02})
    rig = true_rig(config)
    told = written_rig(config, rig)
    untouched = written_rig(SMALL, rig)
    np.testing.assert_array_equal(untouched.rgb_from_thermal.matrix(), rig.rgb_from_thermal.matrix())
    assert untouched.thermal == rig.thermal and told.rgb == rig.rgb
    t, t_told = rig.rgb_from_thermal.translation, told.rgb_from_thermal.translation
    length = np.linalg.norm(t_told) / np.linalg.norm(t)
    tilt = np.linalg.norm(np.cross(t, t_told)) / (t @ t_told)
    turned = rig.rgb_from_thermal.rotation.T @ told.rgb_from_thermal.rotation
    angle_deg = math.degrees(
        np.linalg.norm([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
    )
    assert length == pytest.approx(1.02 if field == "rig_length_error" else 1.0)
    assert tilt == pytest.approx(0.02 if field == "rig_direction_error" else 0.0, abs=1e-9)
    assert angle_deg == pytest.approx(0.02 if field == "rig_rotation_error_deg" else 0.0, abs=1e-6)
    assert told.thermal.fl_x / rig.thermal.fl_x == pytest.approx(1.02 if field == "thermal_focal_error" else 1.0)


def test_sensor_options(tmp_path: Path) -> None:
    base = replace(SMALL, netd_c=0.0)
    plain = write_capture(tmp_path / "plain", base)
    write_capture(tmp_path / "blur", replace(base, blur_px=2.0))
    gained = write_capture(tmp_path / "gain", replace(base, gain_jitter=0.2))
    write_capture(tmp_path / "bare", replace(base, thermal_clean=False))
    assert not (tmp_path / "bare" / "ground_truth").exists()
    for name in plain.world_from_rgb:
        clean, recorded = _clean_c(tmp_path / "plain", name), _thermal_c(tmp_path / "plain", name)
        assert np.abs(clean - recorded).max() <= 0.00501  # half a count
        np.testing.assert_array_equal(_clean_c(tmp_path / "blur", name), clean)
        blurred = _thermal_c(tmp_path / "blur", name)
        assert np.abs(np.diff(blurred, axis=0)).max() < 0.5 * np.abs(np.diff(recorded, axis=0)).max()
        gain = gained.gains[name]
        assert 0.8 <= gain <= 1.2 and gain != 1 and plain.gains[name] == 1
        stretched = clean.mean() + gain * (clean - clean.mean())
        np.testing.assert_allclose(_thermal_c(tmp_path / "gain", name), stretched, atol=0.006)


def test_progress_and_rewriting(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    write_capture(tmp_path / "a", replace(SMALL, frames=3, size=16), progress=lambda done, of: seen.append((done, of)))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    write_capture(tmp_path / "a", replace(SMALL, frames=1, size=16))
    assert [p.name for p in (tmp_path / "a" / "rgb").iterdir()] == ["frame_000.png"]


def test_other_peoples_files_are_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "capture"
    (mine / "rgb").mkdir(parents=True)
    (mine / "rgb" / "frame_000.png").write_bytes(b"a real capture, by chance with the same names")
    before = _files(mine)
    with pytest.raises(RtgsError, match="other than a synthetic capture"):
        write_capture(mine, SMALL)
    assert _files(mine) == before
    write_capture(tmp_path / "b", replace(SMALL, frames=1, size=16))
    (tmp_path / "b" / "notes.txt").write_text("mine")
    with pytest.raises(RtgsError, match=r"notes\.txt"):
        write_capture(tmp_path / "b", SMALL)
    with pytest.raises(RtgsError, match="is a file"):
        write_capture(tmp_path / "b" / "notes.txt", SMALL)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scene": "teapot"}, {"frames": 0}, {"size": 4}, {"thermal_size": 0}, {"supersampling": 0}, {"seed": -1},
        {"netd_c": -0.1}, {"baseline_m": math.nan}, {"blur_px": math.inf}, {"gain_jitter": 1.0}, {"rig_length_error": -1.0},
        {"thermal_focal_error": math.nan}, {"rig_direction_error": math.inf}, {"sfm_per_metre": 0.0},
    ],
)  # fmt: skip
def test_impossible_requests_name_their_field(tmp_path: Path, wrong: dict[str, object]) -> None:
    with pytest.raises(RtgsError, match=next(iter(wrong))):
        write_capture(tmp_path / "x", replace(SMALL, **wrong))  # type: ignore[arg-type]
    assert not (tmp_path / "x").exists()


def test_a_rig_without_baseline_can_be_made(tmp_path: Path) -> None:
    """The case in which no scale can be observed."""
    truth = write_capture(tmp_path / "x", replace(SMALL, baseline_m=0.0, rig_direction_error=0.01, frames=1, size=16))
    assert truth.rig.baseline_m == 0
