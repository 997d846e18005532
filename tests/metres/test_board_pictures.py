"""Metres from photographs that show AprilTags, a checkerboard or a ChArUco board: drawn, detected and measured."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from tests.helpers.metres_scenes import CAMERA, flight

from rtgs.config import MetresConfig
from rtgs.images.pictures import save_png
from rtgs.metres import find_metres
from rtgs.records.metres import MetresSource

S = 3.7  # SfM units per metre
DOTS = 40  # of a drawing, to a cell or square
SAMPLES = 3  # of a photograph, to a pixel's side

Picture = NDArray[np.float32]
Drawing = tuple[Picture, float]  # and how many metres one of its dots is wide


def tag(number: int, side_m: float) -> Drawing:
    """With a white border of two cells; its black square is `side_m` wide."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    square = cv2.aruco.generateImageMarker(dictionary, number, 8 * DOTS)
    return np.pad(square, 2 * DOTS, constant_values=255).astype(np.float32), side_m / (8 * DOTS)


def checkerboard(square_m: float) -> Drawing:
    """6×5 inner corners, with a white border."""
    row, column = np.mgrid[0 : 6 * DOTS, 0 : 7 * DOTS] // DOTS
    squares = np.where((row + column) % 2 == 0, 0.0, 255.0)
    return np.pad(squares, DOTS, constant_values=255).astype(np.float32), square_m / DOTS


def charuco(square_m: float, marker_m: float) -> Drawing:
    """6×5 inner corners, with a white border."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, 6), square_m, marker_m, dictionary)
    return np.pad(board.generateImage((7 * DOTS, 6 * DOTS)), DOTS, constant_values=255).astype(np.float32), square_m / DOTS


def metres_of(root: Path, targets: Mapping[Any, Drawing], said: dict[str, Any]) -> MetresSource:
    """What photographs of these targets give. They hang side by side in the middle of the scene, and face the fourth camera."""
    scene, _ = flight(seed=4, frames=9, radius_m=2.0, sfm_per_metre=S)
    scene, random = replace(scene, capture=replace(scene.capture, root=root)), np.random.default_rng(0)
    given = scene.as_given()
    facing = given.world_from_rgb["0003"].rotation
    size = SAMPLES * CAMERA.width, SAMPLES * CAMERA.height
    for name, pose in given.world_from_rgb.items():
        photograph = np.full(size[::-1], 120.0, dtype=np.float32)
        if (pose.rotation.T @ facing[:, 2])[2] > 0.4:
            for k, (drawing, dot_m) in enumerate(targets.values()):
                height, width = drawing.shape
                corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float64)
                middle = np.array([width / 2 + (k - (len(targets) - 1) / 2) * 1.1 * width, height / 2])
                hung = np.concatenate([(corners - middle) * dot_m * S, np.zeros((4, 1))], axis=1) @ facing.T
                seen = CAMERA.project(pose.inverse().apply(hung + given.points.xyz.mean(axis=0)))
                # Borders of dots and samples have whole numbers here; OpenCV gives whole numbers to their centres.
                dots, samples = (corners - 0.5).astype(np.float32), (SAMPLES * seen - 0.5).astype(np.float32)
                turned = cv2.getPerspectiveTransform(dots, samples)
                inside = cv2.warpPerspective(np.ones_like(drawing), turned, size, flags=cv2.INTER_NEAREST) > 0
                photograph[inside] = cv2.warpPerspective(drawing, turned, size, borderMode=cv2.BORDER_REPLICATE)[inside]
        small = cv2.GaussianBlur(
            cv2.resize(photograph, None, fx=1 / SAMPLES, fy=1 / SAMPLES, interpolation=cv2.INTER_AREA), (0, 0), 0.6
        )
        grey = (small + random.normal(0, 2, small.shape)).clip(0, 255).astype(np.uint8)
        save_png(root / "rgb" / f"{name}.png", np.repeat(grey[..., None], 3, axis=2))
    (root / "metres.json").write_text(json.dumps(said))
    metres = find_metres(scene, config=MetresConfig(sources=("board",))).metres
    assert len(metres.sources) == 1, metres.absent
    return metres.sources[0]


CASES: dict[str, tuple[Mapping[Any, Drawing], dict[str, Any]]] = {
    "tags": ({n: tag(n, 0.4) for n in (3, 17)}, {"tags": {"side_m": 0.4}}),
    "checkerboard": ({0: checkerboard(0.12)}, {"board": {"inner_corners": "6x5", "square_m": 0.12}}),
    "charuco": (
        {0: charuco(0.12, 0.09)},
        {"board": {"board": "charuco", "inner_corners": "6x5", "square_m": 0.12, "marker_m": 0.09, "dictionary": "DICT_4X4_50"}},
    ),
}


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
def test_photographs_of_a_target_give_metres(tmp_path: Path, case: str) -> None:
    found = metres_of(tmp_path, *CASES[case])
    assert found.sfm_per_metre == pytest.approx(S, rel=0.002)
    assert found.ci95[0] <= S <= found.ci95[1]
