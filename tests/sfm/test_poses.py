"""Structure from motion on a rendered room corner with a real lens: known poses, known surfaces."""

from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import Image
from tests.helpers.captures import thermal_counts

from rtgs.base.errors import RtgsError
from rtgs.config import SfmConfig
from rtgs.io.capture import load_capture
from rtgs.io.colmap import colmap_camera, rigid3d_from_se3
from rtgs.io.rig import write_rig
from rtgs.io.transforms import write_transforms
from rtgs.maths.geometry import SE3, look_at
from rtgs.records.camera import Camera
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import Rig
from rtgs.sfm.colmap_job import ColmapJob
from rtgs.sfm.poses import run_sfm

pytestmark = pytest.mark.thorough

RGB = Camera("OPENCV", 320, 240, 300.0, 303.0, 161.5, 118.0, k1=-0.08, k2=0.02, p1=0.001, p2=-0.001)
THERMAL = Camera("PINHOLE", 40, 32, 45.0, 45.0, 20.0, 16.0)
N_FRAMES = 9
NAMES = [f"{i:03d}" for i in range(N_FRAMES)]
POSES = {
    name: look_at([3.0 + 0.8 * np.cos(a), 3.0 + 0.8 * np.sin(a), 1.5 + 0.4 * np.sin(2 * a)], [0.5, 0.5, 0.6])
    for name, a in zip(NAMES, np.linspace(0, 4.5, N_FRAMES), strict=True)
}
CONFIG = SfmConfig(max_features=1000)


def texture(seed: int) -> np.ndarray:
    """`[512, 512, 3]` noise at every scale, so that SIFT finds plenty."""
    rng = np.random.default_rng(seed)
    out = np.zeros((512, 512, 3), np.float32)
    for size in (8, 16, 32, 64, 128, 256):
        out += cv2.resize(rng.normal(size=(size, size, 3)).astype(np.float32), (512, 512), interpolation=cv2.INTER_CUBIC)
    return np.clip(0.5 + 0.15 * out, 0, 1).astype(np.float32)


TEXTURES = [texture(seed) for seed in range(3)]


def render(pose: SE3) -> np.ndarray:
    """`[H, W, 3]` uint8: the planes x = 0, y = 0 and z = 0 as the camera, lens included, sees them from the positive octant."""
    fine = 2  # samples a pixel and axis, against aliasing
    camera = colmap_camera(RGB.resized(RGB.width * fine, RGB.height * fine), 1)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = np.concatenate([camera.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=1)), np.ones((x.size, 1))], axis=1)
    directions = rays @ pose.rotation.T
    with np.errstate(divide="ignore"):
        t = -pose.translation / directions
    t[t <= 0] = np.inf
    plane = t.argmin(axis=1)
    hit = pose.translation + directions * t.min(axis=1, keepdims=True)
    image = np.zeros((*x.shape, 3), np.float32)
    for k in range(3):
        u, v = (np.delete(hit, k, axis=1) * 100 % 511).astype(np.float32).T.reshape(2, *x.shape)
        image[(plane == k).reshape(x.shape)] = cv2.remap(TEXTURES[k], u, v, cv2.INTER_LINEAR)[(plane == k).reshape(x.shape)]
    small = cv2.resize(image, (RGB.width, RGB.height), interpolation=cv2.INTER_AREA)
    return np.round(small * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture, photographs alone."""
    root = tmp_path_factory.mktemp("room")
    (root / "rgb").mkdir()
    (root / "thermal").mkdir()
    for i, (name, pose) in enumerate(POSES.items()):
        Image.fromarray(render(pose)).save(root / "rgb" / f"{name}.png")
        Image.fromarray(thermal_counts(3000 + i)).save(root / "thermal" / f"{name}.png")
    write_rig(root / "rig.json", Rig(RGB, THERMAL, SE3(np.eye(3), np.array([0.05, 0.0, 0.0]))), RelativeCounts())
    return root


@pytest.fixture
def own_room(room: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(room, tmp_path / "room"))


def listing(root: Path) -> list[str]:
    return sorted(str(path.relative_to(root)) for path in root.rglob("*"))


def check_poses(world_from_rgb: dict[str, SE3], position_error: float = 0.02) -> None:
    """Poses equal the true ones up to a similarity; positions lie within a circle of radius 0.8."""
    names = sorted(world_from_rgb)
    found = np.array([world_from_rgb[name].translation for name in names])
    true = np.array([POSES[name].translation for name in names])
    true_from_found = pycolmap.estimate_sim3d(found, true)
    assert true_from_found is not None
    moved = true_from_found.scale * found @ true_from_found.rotation.matrix().T + true_from_found.translation
    assert np.linalg.norm(moved - true, axis=1).max() < position_error
    for name in names:
        turn = POSES[name].rotation.T @ true_from_found.rotation.matrix() @ world_from_rgb[name].rotation
        assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.5


def test_poses_from_photographs_and_a_blank_image_is_named(own_room: Path) -> None:
    Image.fromarray(np.full((240, 320, 3), 90, np.uint8)).save(own_room / "rgb" / "999.png")
    Image.fromarray(thermal_counts(2990)).save(own_room / "thermal" / "999.png")
    before = listing(own_room)
    stages: dict[str, list[tuple[int, int]]] = {}
    scene = run_sfm(
        load_capture(own_room), CONFIG, progress=lambda done, total, stage: stages.setdefault(stage, []).append((done, total))
    )
    assert list(scene.world_from_rgb) == NAMES
    assert scene.failures == {"999": "few features (0)"}
    check_poses(dict(scene.world_from_rgb))
    assert len(scene.points) > 300
    assert np.ptp(scene.points.rgb, axis=0).min() > 0.3  # colours were read
    assert list(stages) == ["features", "matching", "mapping"]
    for steps in stages.values():
        assert steps[0][0] == 0
        assert steps[-1][0] == steps[-1][1]
        assert steps == sorted(steps)
    assert listing(own_room) == before  # nothing was written into the capture


def test_points_from_given_poses(own_room: Path, tmp_path: Path) -> None:
    posed = {name: POSES[name] for name in NAMES[:-1]}
    write_transforms(own_room / "transforms.json", RGB, posed, {name: f"rgb/{name}.png" for name in posed})
    scene = run_sfm(load_capture(own_room), CONFIG, work_dir=tmp_path / "work")
    assert np.linalg.norm(np.median([p.translation for p in scene.world_from_rgb.values()], axis=0)) < 1e-12
    scene = scene.as_given()
    for name in posed:
        np.testing.assert_allclose(scene.world_from_rgb[name].matrix(), POSES[name].matrix(), atol=1e-12)
    assert scene.failures == {NAMES[-1]: "no pose came with the capture"}
    assert (tmp_path / "work" / "database.db").is_file()
    xyz = scene.points.xyz
    assert len(xyz) > 300
    to_surface = np.abs(xyz).min(axis=1)  # distance to the nearest of the three planes
    assert np.median(to_surface) < 0.01
    assert np.percentile(to_surface, 95) < 0.05
    assert xyz.min() > -0.1


def test_the_same_points_from_poses_far_from_the_origin(own_room: Path, tmp_path: Path) -> None:
    """In the given frame COLMAP finds other points, or none: it computes with the positions' last digits."""
    found = []
    for origin in (0.0, 1e7):
        moved = {n: SE3(POSES[n].rotation, POSES[n].translation + origin * np.array([1.0, -0.6, 0.02])) for n in NAMES}
        write_transforms(own_room / "transforms.json", RGB, moved, {n: f"rgb/{n}.png" for n in NAMES})
        scene = run_sfm(load_capture(own_room), CONFIG, work_dir=tmp_path / f"{origin:g}")
        np.testing.assert_allclose(scene.as_given().world_from_rgb[NAMES[0]].translation, moved[NAMES[0]].translation, atol=4e-9)
        found.append(scene.points)
    np.testing.assert_allclose(found[0].xyz, found[1].xyz, rtol=0, atol=1e-12)  # COLMAP's threads add up in any order
    np.testing.assert_array_equal(found[0].rgb, found[1].rgb)


def test_images_have_their_numbers_in_the_order_of_their_names(own_room: Path, tmp_path: Path) -> None:
    """What COLMAP finds depends on the numbers, and it would give them as its threads get done."""
    job = ColmapJob(
        load_capture(own_room), CONFIG, tmp_path, lambda done, total, text: None, own_room / "rgb", {n: f"{n}.png" for n in NAMES}
    )
    job.find_features()
    with closing(pycolmap.Database.open(tmp_path / "database.db")) as database:
        assert [i.name for i in sorted(database.read_all_images(), key=lambda i: i.image_id)] == [f"{n}.png" for n in NAMES]
        assert all(database.num_keypoints_for_image(k) > 0 for k in range(1, len(NAMES) + 1))


def test_poses_with_points_are_taken_as_they_are(own_room: Path) -> None:
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(colmap_camera(RGB, 1))
    for i, name in enumerate(NAMES[:4]):
        image = pycolmap.Image(name=f"{name}.png", camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, rigid3d_from_se3(POSES[name].inverse()))
    model.add_point3D(np.ones(3), pycolmap.Track(), np.zeros(3, np.uint8))
    (own_room / "sparse" / "0").mkdir(parents=True)
    model.write_binary(own_room / "sparse" / "0")
    called: list[str] = []
    scene = run_sfm(load_capture(own_room), progress=lambda done, total, stage: called.append(stage))
    assert called == []
    assert len(scene.points) == 1
    assert list(scene.failures) == NAMES[4:]


def test_sideways_files_with_an_exif_tag(own_room: Path) -> None:
    for name in NAMES:
        path = own_room / "rgb" / f"{name}.png"
        image = Image.open(path)
        exif = image.getexif()
        exif[0x0112] = 6
        image.rotate(90, expand=True).save(path, exif=exif)
    scene = run_sfm(load_capture(own_room), CONFIG)
    assert list(scene.world_from_rgb) == NAMES
    check_poses(dict(scene.world_from_rgb))


def test_sequential_matching(room: Path) -> None:
    scene = run_sfm(load_capture(room), SfmConfig(max_features=1000, matching="sequential"))
    assert list(scene.world_from_rgb) == NAMES


def test_no_overlap_is_refused_with_advice(own_room: Path) -> None:
    for i, name in enumerate(NAMES):
        noise = np.random.default_rng(i).integers(0, 255, (30, 40, 3), dtype=np.uint8)
        Image.fromarray(noise).resize((320, 240), Image.Resampling.BICUBIC).save(own_room / "rgb" / f"{name}.png")
    with pytest.raises(RtgsError, match=r"register 0 of 9 frames \(000: no match with enough inliers; .*overlap by two thirds"):
        run_sfm(load_capture(own_room), CONFIG)


def test_no_points_from_given_poses_is_a_warning(own_room: Path) -> None:
    for name in NAMES:
        Image.new("RGB", (320, 240), (90, 90, 90)).save(own_room / "rgb" / f"{name}.png")
    write_transforms(own_room / "transforms.json", RGB, POSES, {name: f"rgb/{name}.png" for name in NAMES})
    scene = run_sfm(load_capture(own_room), CONFIG)
    assert len(scene.points) == 0
    assert scene.points.xyz.shape == (0, 3)
    assert any("No point could be triangulated" in warning for warning in scene.capture.warnings)


def test_a_stop_from_the_progress_callback_ends_the_work(room: Path) -> None:
    def stop(done: int, total: int, stage: str) -> None:
        if stage == "matching":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sfm(load_capture(room), CONFIG, progress=stop)


def test_wrong_settings() -> None:
    with pytest.raises(RtgsError, match=r"sfm.matching is 'all'"):
        SfmConfig(matching="all")  # type: ignore[arg-type]
    with pytest.raises(RtgsError, match=r"sfm.max_features is 0"):
        SfmConfig(max_features=0)
