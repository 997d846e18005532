"""A scene: which frames are for what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints, Split
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

CAMERA = Camera("PINHOLE", 4, 3, 4.0, 4.0, 2.0, 1.5)
NAMES = [f"{i:02d}" for i in range(20)]


def scene_of(registered: list[str]) -> Scene:
    rig = Rig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
    frames = tuple(Frame(name, np.zeros((3, 4, 3), np.float32), np.zeros((3, 4), np.float32)) for name in NAMES)
    mask = np.ones((3, 4), bool)
    capture = Capture(Path(), rig, rig, frames, mask, mask, RelativeCounts(), None)
    poses = {name: SE3(np.eye(3), np.array([float(name), 0.0, 0.0])) for name in registered}
    return Scene(capture, poses, SparsePoints(np.zeros((0, 3)), np.zeros((0, 3), np.float32)), {})


def names(frames: tuple[Frame, ...]) -> list[str]:
    return [frame.name for frame in frames]


def test_every_registered_frame_is_for_training_or_for_evaluation() -> None:
    scene = scene_of(NAMES)
    assert names(scene.held_out_frames) == ["00", "08", "16"]
    assert sorted(names(scene.train_frames) + names(scene.held_out_frames)) == NAMES
    assert set(names(scene.validation_frames)) <= set(names(scene.train_frames))
    assert names(scene.validation_frames) == [names(scene.train_frames)[i] for i in (4, 12)]


def test_a_frame_that_was_not_registered_moves_no_other_frame_to_the_held_out_ones() -> None:
    scene = scene_of([name for name in NAMES if name not in ("00", "03")])
    assert names(scene.held_out_frames) == ["08", "16"]
    assert "03" not in names(scene.train_frames)


def test_a_scene_with_its_own_split() -> None:
    scene = replace(scene_of(NAMES), split=Split(held_out=frozenset({"19"}), validation=frozenset({"01"})))
    assert names(scene.held_out_frames) == ["19"]
    assert names(scene.validation_frames) == ["01"]
    assert len(scene.train_frames) == 19
