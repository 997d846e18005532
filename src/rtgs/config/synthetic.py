"""Settings of a synthetic capture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from rtgs.base.errors import RtgsError

SceneName = Literal["chair", "drums", "hotdog", "lego", "materials", "ship", "room", "plain"]
SCENES: tuple[SceneName, ...] = get_args(SceneName)[:7]  # the eighth is too far away for any scale to show


@dataclass(frozen=True)
class SynthConfig:
    """Settings of one synthetic capture. The four `*_error*` fields change what `rig.json` says, never what is rendered."""

    scene: SceneName = "lego"
    """which of the modelled scenes; six are objects seen from a hemisphere, `room` is seen from inside, `plain` from 800 m above"""
    frames: int = 50
    """RGB–thermal pairs"""
    size: int = 800
    """width and height of the images, in pixels"""
    thermal_size: int | None = None
    """width and height of the thermal images, in pixels; None: as `size`"""
    seed: int = 0
    """of camera positions, unit, noise, gains and error directions; the scene itself never changes"""
    rig_seed: int | None = None
    """draws the rig's direction and rotation, and noise, gains and error directions in place of `seed`; None: the one fixed rig"""
    baseline_m: float = 0.20
    """distance between the two cameras, in metres"""
    sfm_per_metre: float | None = None
    """unit of the written poses; None: drawn log-uniformly from 0.05 to 20"""
    netd_c: float = 0.05
    """standard deviation of the thermal sensor's noise, in °C; 0 for none"""
    blur_px: float = 0.0
    """standard deviation of the thermal lens's Gaussian blur, in thermal pixels"""
    gain_jitter: float = 0.0
    """g: each thermal image's contrast around its mean is multiplied by a factor drawn from [1 − g, 1 + g]"""
    rig_length_error: float = 0.0
    """relative error of the written baseline length: 0.01 writes it 1 % too long"""
    rig_direction_error: float = 0.0
    """tangent of the angle by which the written baseline direction is tilted: 0.01 moves its tip by 1 % of its length"""
    rig_rotation_error_deg: float = 0.0
    """angle by which the written rig rotation is off, in degrees, about an axis drawn with the seed"""
    thermal_focal_error: float = 0.0
    """relative error of the written thermal focal length: 0.01 writes it 1 % too long"""
    supersampling: int = 2
    """n: every pixel is the mean of n × n rays"""
    thermal_clean: bool = True
    """also write each thermal image in °C without blur, gain, noise or quantisation, beside the truth"""

    def check(self) -> None:
        """Raises `RtgsError` where a field is out of its range."""
        if self.scene not in get_args(SceneName):
            raise RtgsError(f"scene: no scene named {self.scene!r}; there are {', '.join(get_args(SceneName))}")
        for name, least in (("frames", 1), ("size", 8), ("thermal_size", 8), ("supersampling", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise RtgsError(f"{name}: {value} is too small; it must be at least {least}")
        for name in ("baseline_m", "netd_c", "blur_px"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise RtgsError(f"{name}: {value} is not a finite number from 0 up")
        if self.rig_seed is not None and self.rig_seed < 0:
            raise RtgsError(f"rig_seed: {self.rig_seed} is negative")
        if not 0 <= self.gain_jitter < 1:
            raise RtgsError(f"gain_jitter: {self.gain_jitter} is outside [0, 1)")
        for name in ("rig_length_error", "thermal_focal_error"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > -1):
                raise RtgsError(f"{name}: {value} must be a finite fraction above −1")
        for name in ("rig_direction_error", "rig_rotation_error_deg"):
            if not math.isfinite(getattr(self, name)):
                raise RtgsError(f"{name}: {getattr(self, name)} is not a finite number")
        if self.sfm_per_metre is not None and not (math.isfinite(self.sfm_per_metre) and self.sfm_per_metre > 0):
            raise RtgsError(f"sfm_per_metre: {self.sfm_per_metre} is not a finite positive number")
