"""Structure from motion on a rendered room corner with a real lens: known poses, known surfaces."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image
from tests.helpers.captures import thermal_counts
from tests.helpers.photographed_room import NAMES, POSES, RGB

from rtgs.base.errors import RtgsError
from rtgs.config import SfmConfig
from rtgs.io.capture import load_capture
from rtgs.io.colmap import colmap_camera, rigid3d_from_se3
from rtgs.io.transforms import write_transforms
from rtgs.maths.geometry import SE3
from rtgs.sfm.colmap_job import Task, do
from rtgs.sfm.poses import run_sfm

pytestmark = pytest.mark.thorough

CONFIG = SfmConfig(max_features=1000)


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
    files = {n: f"{n}.png" for n in NAMES}
    do(Task(own_room, RGB, CONFIG, tmp_path, own_room / "rgb", files, None), lambda done, total, text: None)
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
