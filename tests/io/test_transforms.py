"""`transforms.json`: axes, intrinsics, and what each wrong file is answered with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.helpers.captures import NAMES, POSES, RGB, edit_transforms, refused, write_poses

from rtgs.io.capture import load_capture
from rtgs.io.transforms import read_transforms


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


def test_poses_without_intrinsics_use_the_rig(root: Path) -> None:
    write_poses(root)
    edit_transforms(root, lambda d: [d.pop(k) for k in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")])
    assert load_capture(root).raw_rig.rgb == RGB


def test_thermal_frames_in_transforms_are_passed_over(root: Path) -> None:
    write_poses(root)
    thermal = {"file_path": f"thermal/{NAMES[0]}.tiff", "transform_matrix": np.eye(4).tolist()}
    edit_transforms(root, lambda d: d["frames"].insert(0, thermal))
    poses = load_capture(root).poses
    assert poses is not None
    np.testing.assert_allclose(poses.world_from_rgb[NAMES[0]].matrix(), POSES[NAMES[0]].matrix(), atol=1e-12)


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
    (lambda d: d["frames"][2].update(fl_x=70.0), ["fl_x of a frame is 70.0, and fl_x of the whole file is 60.0"]),
    (lambda d: d["frames"][1].update(mask_path="masks/1.png"), ["frames[1].mask_path is given", "Masks are not supported"]),
    (lambda d: d.update(distortion_params=[0.1, 0, 0, 0, 0, 0]), ["distortion_params is given", "k1, k2"]),
    (lambda d: d.update(rolling_shutter=[0, 0, 0.1, 0]), ["rolling_shutter is given"]),
    (lambda d: d.update(k5=0.1), ["k5 is given"]),
    (lambda d: d.update(is_fisheye=True), ["is_fisheye is given, and camera_model is 'OPENCV'"]),
    (lambda d: d.update(fl_x=1e-9), ["camera.fl_x is 1e-09 pixels", "times the longer side"]),
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


@pytest.mark.parametrize(
    ("origin", "single", "verdict"),
    [(1e7, False, ""), (3e3, True, ""), (1e5, True, "warned"), (1e7, True, "refused"), (1e15, False, "refused")],
)
def test_positions_that_lost_digits_far_from_the_origin(root: Path, origin: float, single: bool, verdict: str) -> None:
    """The cameras are a quarter of a unit apart. In double precision 1e7 costs nothing yet; in single precision, all of it."""
    write_poses(root)

    def move(data: dict[str, Any]) -> None:
        for frame in data["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] = float(np.float32(row[3] + origin) if single else row[3] + origin)

    edit_transforms(root, move)
    if verdict == "refused":
        refused(root, "transforms.json: its camera positions", "Subtract a common offset", "remove the poses")
        return
    said = [w for w in load_capture(root).warnings if "camera positions have lost digits" in w]
    assert len(said) == (verdict == "warned")


def test_is_fisheye_names_the_lens(root: Path) -> None:
    """As instant-ngp has it: four terms of an equidistant lens, and no camera_model."""
    write_poses(root)

    def change(data: dict[str, Any]) -> None:
        for key in ("camera_model", "p1", "p2"):
            del data[key]
        data.update(
            is_fisheye=True, k1=0.01, k2=0.002, k3=0.0, k4=0.0, mask_path="", rolling_shutter=[0, 0, 0, 0], equirectangular=False
        )

    edit_transforms(root, change)
    camera = load_capture(root).raw_rig.rgb
    assert camera.model == "OPENCV_FISHEYE"
    assert camera.distortion == (0.01, 0.002, 0.0, 0.0)


@pytest.mark.parametrize(("change", "said"), WRONG_TRANSFORMS, ids=[said[0][:40] for _, said in WRONG_TRANSFORMS])
def test_wrong_transforms(root: Path, change: Callable[[dict[str, Any]], Any], said: list[str]) -> None:
    write_poses(root)
    edit_transforms(root, change)
    refused(root, "transforms.json: ", *said)
