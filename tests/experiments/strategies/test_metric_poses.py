"""MASt3R: pairs with known lengths give the true scale, and the package is asked as it wants to be."""

from __future__ import annotations

import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.helpers.wall_scene import RGB, TRUTH, wall_scene

from rtgs.base.errors import RtgsError
from rtgs.experiments.strategies.metric_poses import load_mast3r, metres_between, overlapping_pairs, scale_from_pairs
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame


def test_lengths_in_metres_give_the_scale() -> None:
    scene, _ = wall_scene()
    pairs = overlapping_pairs(scene)
    assert pairs
    assert not {n for pair in pairs for n in pair} & {f.name for f in scene.held_out_frames}

    def predict(a: Frame, b: Frame, camera: Camera) -> float | None:
        if (a.name, b.name) == pairs[0]:
            return None
        length = np.linalg.norm(scene.world_from_rgb[a.name].translation - scene.world_from_rgb[b.name].translation) / TRUTH
        return float(length) * (3 if (a.name, b.name) == pairs[1] else 1)

    assert scale_from_pairs(scene, predict) == pytest.approx(TRUTH, rel=1e-9)
    assert scale_from_pairs(scene.recentred(), predict) == pytest.approx(TRUTH, rel=1e-9)
    with pytest.raises(RtgsError, match="none of"):
        scale_from_pairs(scene, lambda a, b, camera: None)


def test_frames_that_look_elsewhere_are_no_pair() -> None:
    scene, _ = wall_scene()
    turned = {
        n: SE3(rotation_from_axis_angle([0, 0.55 * i, 0]), p.translation) for i, (n, p) in enumerate(scene.world_from_rgb.items())
    }
    assert overlapping_pairs(replace(scene, world_from_rgb=turned)) == []


def test_metres_between_two_cameras_from_pointmaps() -> None:
    """Points on a bumpy wall, seen by the second camera, in the first one's axes; the less confident half is wrong."""
    camera = Camera("PINHOLE", 64, 48, 60.0, 62.0, 31.0, 25.0)
    a_from_b = SE3(rotation_from_axis_angle([0.1, -0.2, 0.05]), np.array([0.3, -0.1, 0.2]))
    points, confidence = pointmap(camera, a_from_b)
    points[confidence < 1.5] = 9.0
    length = float(np.linalg.norm(a_from_b.translation))
    found = metres_between(points, confidence, camera)
    assert found == pytest.approx(length, rel=1e-3)
    assert metres_between(points[:8, :8], confidence[:8, :8], replace(camera, width=8, height=8)) is None


def pointmap(camera: Camera, a_from_b: SE3) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    y, x = np.mgrid[: camera.height, : camera.width]
    depth = 2 + 0.5 * np.sin(x / 5) * np.cos(y / 4)
    in_b = np.stack([(x + 0.5 - camera.cx) / camera.fl_x * depth, (y + 0.5 - camera.cy) / camera.fl_y * depth, depth], axis=-1)
    confidence = np.where((x + y) % 2, 2.0, 1.0)
    return a_from_b.apply(in_b).astype(np.float32), confidence.astype(np.float32)


def test_mast3r_is_asked_as_its_package_wants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of the same shape whose network knows the truth: the picture's size, its camera and the pose have to fit together."""
    scene, _ = wall_scene()
    weights = tmp_path / "weights.pth"
    weights.write_bytes(b"")
    b_pose, a_pose = (scene.world_from_rgb[n] for n in ("f05", "f02"))
    a_from_b = a_pose.inverse() @ b_pose
    in_metres = SE3(a_from_b.rotation, a_from_b.translation / TRUTH)
    asked: list[Any] = []

    class Model:
        @staticmethod
        def from_pretrained(path: str) -> Model:
            assert path == str(weights)
            return Model()

        def to(self, device: str) -> Model:
            return self

        def eval(self) -> Model:
            return self

    def inference(pairs: Any, model: Model, device: str, batch_size: int, verbose: bool) -> Any:
        (first, second) = pairs[0]
        asked.extend([first, second])
        h, w = second["true_shape"][0]
        assert second["img"].shape == (1, 3, h, w) and max(h, w) == 512 and h % 16 == 0 and w % 16 == 0
        assert first["img"].min() >= -1 and first["img"].max() <= 1
        scale = 512 / RGB.width
        height = round(RGB.height * scale)
        camera = Camera("PINHOLE", w, h, RGB.fl_x * scale, RGB.fl_y * height / RGB.height, RGB.cx * scale, 0.0)
        camera = replace(camera, cy=RGB.cy * height / RGB.height - (height - h) // 2)
        points, confidence = pointmap(camera, in_metres)
        return {"pred2": {"pts3d_in_other_view": torch.from_numpy(points)[None], "conf": torch.from_numpy(confidence)[None]}}

    modules = {name: types.ModuleType(name) for name in ("mast3r", "mast3r.model", "dust3r", "dust3r.inference")}
    vars(modules["mast3r.model"])["AsymmetricMASt3R"] = Model
    vars(modules["dust3r.inference"])["inference"] = inference
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    frames = {f.name: f for f in scene.frames}
    metres = load_mast3r(weights)(frames["f02"], frames["f05"], scene.rig.rgb)
    assert len(asked) == 2
    assert metres == pytest.approx(np.linalg.norm(in_metres.translation), rel=1e-3)


def test_without_mast3r_the_reason_names_package_and_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mast3r", None)
    (tmp_path / "w.pth").write_bytes(b"")
    with pytest.raises(RtgsError, match=r"mast3r.*PYTHONPATH.*--mast3r-weights"):
        load_mast3r(tmp_path / "w.pth")
