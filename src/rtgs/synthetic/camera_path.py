"""Where the cameras of a synthetic capture stand."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rtgs.config import SynthConfig
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.synthetic.draws import rng as draws_of

OBJECT_DISTANCE_M = 4.0
_HEIGHT_M, _SURVEY_M = 800.0, 130.0  # above the plain, and how far the survey goes to each side


def camera_path(config: SynthConfig, centre: tuple[float, float, float]) -> list[SE3]:
    """`world_from_rgb` of every frame, in metres; objects are seen from around `centre`."""
    rng = draws_of(config, "path")
    if config.scene == "room":
        return _inside(config.frames, rng)
    return _above(config.frames, rng) if config.scene == "plain" else _around(config.frames, rng, np.array(centre))


def _around(count: int, rng: np.random.Generator, centre: NDArray[np.float64]) -> list[SE3]:
    """A golden-angle spiral up the hemisphere, elevation 10° to 75°: views are spread evenly over its area."""
    low, high = math.sin(math.radians(10)), math.sin(math.radians(75))
    phase = rng.uniform(0, 2 * math.pi)
    poses = []
    for i in range(count):
        azimuth = phase + i * math.pi * (3 - math.sqrt(5)) + rng.normal(0, 0.06)
        height = low + (high - low) * np.clip((i + 0.5) / count + rng.normal(0, 0.01), 0, 1)
        level = math.sqrt(1 - height**2)
        distance = OBJECT_DISTANCE_M * (1 + rng.uniform(-0.03, 0.05))
        eye = distance * np.array([level * math.cos(azimuth), level * math.sin(azimuth), height])
        pose = look_at(centre + eye, centre + rng.uniform(-0.04, 0.04, 3))
        roll = rotation_from_axis_angle([0, 0, math.radians(rng.normal(0, 2))])  # as a hand does
        poses.append(SE3(pose.rotation @ roll, centre + eye))
    return poses


def _inside(count: int, rng: np.random.Generator) -> list[SE3]:
    """Two rounds through the room: first looking outwards at the near walls, then across to the far ones."""
    poses = []
    for i in range(count):
        turn = 2 * math.pi * (2 * i / count)
        across = 2 * i >= count
        a = turn + (math.pi / count if across else 0)
        eye = np.array([1.15 * math.cos(a), 0.75 * math.sin(a), 1.35]) + rng.normal(0, [0.08, 0.08, 0.12])
        look = a + (math.pi + 0.35 if across else 0.55)
        if not across:
            eye[:2] *= 0.8
            eye[:2] -= 0.55 * np.array([math.cos(look), math.sin(look)])
        pitch = math.radians(-8 + 14 * math.sin(3 * a + 0.5) + rng.normal(0, 2))
        ahead = np.array([math.cos(look) * math.cos(pitch), math.sin(look) * math.cos(pitch), math.sin(pitch)])
        pose = look_at(eye, eye + ahead)
        poses.append(SE3(pose.rotation @ rotation_from_axis_angle([0, 0, math.radians(rng.normal(0, 2))]), eye))
    return poses


def _above(count: int, rng: np.random.Generator) -> list[SE3]:
    """A survey in lines, looking down within a few degrees."""
    rows = max(1, round(math.sqrt(count)))
    poses = []
    for i in range(count):
        row, along = i % rows, (i // rows + 0.5) / math.ceil(count / rows)
        eye = np.array([2 * along - 1, 2 * (row + 0.5) / rows - 1, 0.0]) * _SURVEY_M
        eye += [*rng.normal(0, 6, 2), _HEIGHT_M * (1 + rng.normal(0, 0.04))]
        pose = look_at(eye, [*(eye[:2] + rng.normal(0, 40, 2)), 0.0], up=(0, 1, 0))
        poses.append(SE3(pose.rotation @ rotation_from_axis_angle([0, 0, math.radians(rng.normal(0, 8))]), eye))
    return poses
