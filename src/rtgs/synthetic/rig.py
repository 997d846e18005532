"""The rig of a synthetic capture: the true one, and the one in `rig.json`, which may be wrong on purpose."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rtgs.config import SynthConfig
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig
from rtgs.synthetic.camera_path import OBJECT_DISTANCE_M
from rtgs.synthetic.draws import rig_rng

_OBJECT_FOV_DEG, _ROOM_FOV_DEG = 40.0, 66.0


def true_rig(config: SynthConfig) -> Rig:
    """Both cameras, and where the thermal one sits: to the right of the RGB camera, a little high and forward, turned inwards.

    With a `rig_seed` it sits to any side, up to 20° forward or back, and is turned inwards and by about 1.5° about each axis.
    """
    fov = _ROOM_FOV_DEG if config.scene == "room" else _OBJECT_FOV_DEG
    n, m = config.size, config.thermal_size or config.size
    f = 0.5 / math.tan(math.radians(fov) / 2)
    rgb = Camera("PINHOLE", n, n, f * n, f * n, 0.5 * n, 0.5 * n)
    # Off-centre by about a percent, as real ones are.
    thermal = Camera("PINHOLE", m, m, 0.985 * f * m, 0.985 * f * m, 0.508 * m, 0.494 * m)
    toe_in = 0.0 if config.scene in ("room", "plain") else 0.9 * config.baseline_m / OBJECT_DISTANCE_M
    if config.rig_seed is None:
        direction = np.array([0.975, -0.17, 0.14])
        turn = rotation_from_axis_angle(np.radians([-1.1, -math.degrees(toe_in) - 0.4, 1.6]))
    else:
        rng = rig_rng(config, "rig")
        side, ahead = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(-20, 20))
        direction = np.array([math.cos(ahead) * math.cos(side), math.cos(ahead) * math.sin(side), math.sin(ahead)])
        # Turned about the axis at right angles to the baseline and the view, by as much as centres the object again.
        inwards = toe_in * np.array([direction[1], -direction[0], 0.0])
        turn = rotation_from_axis_angle(inwards) @ rotation_from_axis_angle(np.radians(rng.normal(0, 1.5, 3)))
    return Rig(rgb, thermal, SE3(turn, config.baseline_m * direction / np.linalg.norm(direction)))


def written_rig(config: SynthConfig, rig: Rig) -> Rig:
    """The rig as `rig.json` tells it: the true one with the config's calibration errors."""
    rng = rig_rng(config, "calibration")
    axis, across = rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    t = rig.rgb_from_thermal.translation
    length = np.linalg.norm(t)
    if length > 0 and config.rig_direction_error != 0:
        across -= t * (across @ t) / length**2
        tilted = t + config.rig_direction_error * length * across / np.linalg.norm(across)
        t = tilted * length / np.linalg.norm(tilted)
    rotation = rotation_from_axis_angle(math.radians(config.rig_rotation_error_deg) * axis) @ rig.rgb_from_thermal.rotation
    zoom = 1 + config.thermal_focal_error
    thermal = replace(rig.thermal, fl_x=rig.thermal.fl_x * zoom, fl_y=rig.thermal.fl_y * zoom)
    return Rig(rig.rgb, thermal, SE3(rotation, (1 + config.rig_length_error) * t))
