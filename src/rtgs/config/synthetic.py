"""Settings of a synthetic capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges

SceneName = Literal["chair", "drums", "hotdog", "lego", "materials", "ship", "room", "plain"]
SCENES: tuple[SceneName, ...] = get_args(SceneName)[:7]  # the eighth is too far away for any scale to show
FEATURES = ("spots", "lines", "rectangle")


@dataclass(frozen=True)
class SynthConfig:
    """Settings of one synthetic capture. The four `*_error*` fields change what `rig.json` says, never what is rendered."""

    scene: SceneName = "lego"
    """which of the modelled scenes; six are objects seen from a hemisphere, `room` is seen from inside, `plain` from 800 m above"""
    frames: Annotated[int, Range(1, 10**5)] = 50
    """RGB–thermal pairs"""
    size: Annotated[int, Range(8, 10**5)] = 800
    """width and height of the images, in pixels"""
    thermal_size: Annotated[int | None, Range(8, 10**5)] = None
    """width and height of the thermal images, in pixels; None: as `size`"""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """of camera positions, unit, noise, gains and error directions; the scene itself never changes"""
    rig_seed: Annotated[int | None, Range(0, 2**31 - 1)] = None
    """draws the rig's direction and rotation, and noise, gains and error directions in place of `seed`; None: the one fixed rig"""
    baseline_m: Annotated[float, Range(0)] = 0.20
    """distance between the two cameras, in metres"""
    sfm_per_metre: Annotated[float | None, Range(above=0)] = None
    """unit of the written poses; None: drawn log-uniformly from 0.05 to 20"""
    netd_c: Annotated[float, Range(0)] = 0.05
    """standard deviation of the thermal sensor's noise, in °C; 0 for none"""
    blur_px: Annotated[float, Range(0, 1000)] = 0.0
    """standard deviation of the thermal lens's Gaussian blur, in thermal pixels"""
    gain_jitter: Annotated[float, Range(0, below=1)] = 0.0
    """g: each thermal image's contrast around its mean is multiplied by a factor drawn from [1 − g, 1 + g]"""
    rig_length_error: Annotated[float, Range(above=-1)] = 0.0
    """relative error of the written baseline length: 0.01 writes it 1 % too long"""
    rig_direction_error: Annotated[float, Range()] = 0.0
    """tangent of the angle by which the written baseline direction is tilted: 0.01 moves its tip by 1 % of its length"""
    rig_rotation_error_deg: Annotated[float, Range()] = 0.0
    """angle by which the written rig rotation is off, in degrees, about an axis drawn with the seed"""
    thermal_focal_error: Annotated[float, Range(above=-1)] = 0.0
    """relative error of the written thermal focal length: 0.01 writes it 1 % too long"""
    supersampling: Annotated[int, Range(1, 64)] = 2
    """n: every pixel is the mean of n × n rays"""
    thermal_clean: bool = True
    """also write each thermal image in °C without blur, gain, noise or quantisation, beside the truth"""
    features: tuple[str, ...] = ()
    """what surfaces have in the thermal images alone: spots, lines, rectangle, hot and cold; none by default"""
    spots_each: Annotated[int, Range(1, 1000)] = 3
    """`features` with spots: so many of each of four sizes, hot and as many cold; fewer where the scene has no place for more"""
    distractor: bool = False
    """in one training frame of ten, a warm thing stands in the thermal image that is no part of the scene"""

    def __post_init__(self) -> None:
        check_ranges(self)
        names = {name for part in self.features for name in part.split(",")} - {""}  # "a,b" is as good as "a b"
        if unknown := sorted(names - set(FEATURES)):
            raise RtgsError(f"features: {unknown[0]!r} is none; there are {', '.join(FEATURES)}")
        object.__setattr__(self, "features", tuple(name for name in FEATURES if name in names))
        if self.scene not in get_args(SceneName):
            raise RtgsError(f"scene: no scene named {self.scene!r}; there are {', '.join(get_args(SceneName))}")
