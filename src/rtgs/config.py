"""Every setting of every stage in one place, and its way to JSON and back.

Nothing heavy is imported here, so that the command line can show all settings and their defaults before it loads torch.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args

from rtgs.errors import RtgsError

T = TypeVar("T")

PAPER_EPSILON = 1e-6
PAPER_LEVEL_WEIGHTS = (1.0, 0.5, 0.25)  # w_l = 0.5^l, level 0 the finest, as printed

SceneName = Literal["chair", "drums", "hotdog", "lego", "materials", "ship", "room", "plain"]
SCENES: tuple[SceneName, ...] = get_args(SceneName)[:7]  # the eighth is too far away for any scale to show

REFINABLE = ("rotation", "baseline-direction", "focal", "time-offset")

Quality = Literal["fast", "default", "best"]
QUALITIES: tuple[Quality, ...] = get_args(Quality)


@dataclass(frozen=True)
class SfmConfig:
    """Structure from motion."""

    max_features: int = 4096
    """SIFT points kept in an image, largest first."""
    max_image_side: int = 1280
    """Features are found in images no longer than this, in pixels."""
    matching: Literal["auto", "exhaustive", "sequential"] = "auto"
    """"exhaustive" compares all pairs, "sequential" neighbours in name order (videos), "auto" takes exhaustive up to 80 frames."""
    seed: int = 0
    """Of COLMAP's random choices. Two runs then differ by rounding alone, from sums in threads."""

    def __post_init__(self) -> None:
        if self.matching not in ("auto", "exhaustive", "sequential"):
            raise RtgsError(f"sfm.matching is {self.matching!r}; it is auto, exhaustive or sequential.")
        for name in ("max_features", "max_image_side"):
            if getattr(self, name) < 1:
                raise RtgsError(f"sfm.{name} is {getattr(self, name)}; it is above 0.")


@dataclass(frozen=True)
class DensifyConfig:
    """When and how far the model grows."""

    max_gaussians: int | None = None
    """The budget; None: one for `pixels_each` pixels of an image or one a sparse point, from 10 000 to 150 000."""
    pixels_each: float | None = None
    """Pixels of an image for each Gaussian of the budget; None: by the quality."""
    every: int = 100
    """Steps between two rounds."""
    start: float = 0.05
    """First round, as a share of all steps."""
    stop: float = 0.65
    """Last round, as a share of all steps; the rest only refines."""
    split_size: float = 0.01
    """A Gaussian larger than this share of the scene's extent is split, a smaller one cloned."""
    prune_opacity: float = 0.005
    """A Gaussian fainter than this is removed."""


@dataclass(frozen=True)
class RgbConfig:
    """Training of the RGB model."""

    quality: Quality = "default"
    """"fast" gives an anchor for the scale in a minute or two, "best" what more time can still gain; fills in what is left open."""
    steps: int | None = None
    """Optimisation steps, one image each; None: by the quality."""
    sh_degree: int | None = None
    """Highest spherical-harmonics band, up to 3; None: by the quality. Bands are switched on in turn over the first half."""
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    """How the model grows."""
    ssim_weight: float = 0.2
    """Loss = ℓ1 + this · (1 − SSIM)."""
    coarse_to_fine: tuple[tuple[float, int], ...] = ((0.2, 4), (0.55, 2))
    """(until this share of the steps, image reduced by this factor); full size afterwards."""
    background: Literal["learned", "black", "white"] = "learned"
    """What shows where nothing is: one colour, fitted or fixed."""
    antialiased: bool = False
    """Compensate opacity for the pixel-size blur, so that the model looks alike at other resolutions."""
    exposure: bool = False
    """Fit a gain and an offset per training frame and channel (not used for held-out frames)."""
    random_points: int = 20_000
    """How many random points to start from when the scene has no sparse points."""
    seed: int = 0
    """Order of the frames, random points and splits."""

    def resolved(self) -> RgbConfig:
        """The same with the numbers of its quality where they were left open."""
        preset = _PRESETS[self.quality]
        densify = self.densify
        if densify.pixels_each is None:
            densify = replace(densify, pixels_each=preset.pixels_each)
        steps = preset.steps if self.steps is None else self.steps
        sh_degree = preset.sh_degree if self.sh_degree is None else self.sh_degree
        return replace(self, steps=steps, sh_degree=sh_degree, densify=densify)

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise RtgsError(f"rgb.quality is {self.quality!r}; it is {', '.join(QUALITIES)}.")
        if self.steps is not None and self.steps < 1:
            raise RtgsError(f"rgb.steps is {self.steps}; it is above 0.")


@dataclass(frozen=True)
class _Preset:
    steps: int
    sh_degree: int
    pixels_each: float


# What two cores do in a minute, in minutes, and where more steps gain little; `benchmarks/train.py` measures them.
_PRESETS: dict[Quality, _Preset] = {
    "fast": _Preset(steps=1500, sh_degree=1, pixels_each=8.0),
    "default": _Preset(steps=7000, sh_degree=2, pixels_each=4.0),
    "best": _Preset(steps=10_000, sh_degree=3, pixels_each=4.0),
}


@dataclass(frozen=True)
class ScaleConfig:
    """How the scale is found: by a search over all scales, or by the paper's Adam."""

    solver: Literal["global", "adam"] = "global"
    """"global" scans all scales the images can tell apart and refines by Gauss–Newton, in seconds; "adam" is the paper's."""
    init: float | None = None
    """Start of `sfm_per_metre`; None: the minimum of a scan of the loss over all scales the images can tell apart."""
    steps: int = 200
    """Adam steps."""
    learning_rate: float = 5e-3
    """Adam's learning rate, in ln s."""
    batch: int | None = None
    """Adam: frames per step, drawn at random; None: all."""
    level_weights: tuple[float, ...] = PAPER_LEVEL_WEIGHTS
    """Pyramid weights, finest level first; one number gives the single-scale loss."""
    epsilon: float | None = None
    """ε of the normalised gradient, images in [0, 1]; None: measured at each level (docs/scale.md), and the paper's 1e-6 for Adam."""
    scan_samples: int = 64
    """Adam: log-spaced scales in the scan."""
    half_width: float = 0.001
    """Global: frames are added until half the 95 % interval is narrower than this, in ln s, or all are used."""
    max_frames: int = 64
    """Of more training frames than this, as many evenly spaced ones are used."""
    refine: tuple[str, ...] = ()
    """What of the calibration is refined with the scale: rotation, baseline-direction, focal, time-offset; each is held by its standard
    deviation in rig.json, or a default (docs/scale.md)."""
    seed: int = 0
    """Order of mini-batches, and the bootstrap."""

    def __post_init__(self) -> None:
        if self.solver not in ("global", "adam"):
            raise RtgsError(f"scale.solver is {self.solver!r}; it is global or adam.")
        names = {name for part in self.refine for name in part.split(",")} - {""}  # "a,b" is as good as "a b"
        if unknown := sorted(names - set(REFINABLE)):
            raise RtgsError(f"scale.refine names {unknown[0]!r}; there are {', '.join(REFINABLE)}.")
        object.__setattr__(self, "refine", tuple(name for name in REFINABLE if name in names))


@dataclass(frozen=True)
class ThermalConfig:
    """Fit of the thermal spherical harmonics."""

    solver: Literal["linear", "adam"] = "linear"
    """Least squares by conjugate gradients; or the paper's Adam, to which alone the settings after `sh_degree` matter."""
    drift: Literal["auto", "off", "offset", "gain-offset"] = "auto"
    """What each frame has of its own (linear solver): "auto" decides on training frames that are left out of the fit."""
    sh_degree: int = 1
    """Highest band: emission depends on the direction only weakly."""
    steps: int = 1000
    """Optimisation steps; one image each."""
    learning_rate: float = 1e-2
    """Adam's rate of the constant band, falling tenfold; higher bands take a twentieth of it."""
    ssim_weight: float = 0.0
    """Loss = ℓ1 + this · (1 − SSIM)."""
    initial_noise: float = 0.0
    """Standard deviation of the initial coefficients; zero starts at the middle of the range."""
    seed: int = 0
    """Order of the frames and the initial noise."""


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run, stage by stage."""

    rgb_max_side: int = 960
    """RGB images are reduced to this many pixels on their longer side."""
    rgb_ply: Path | None = None
    """A trained 3DGS model in the same world frame, to use instead of training one."""
    sfm: SfmConfig = field(default_factory=SfmConfig)
    """Structure from motion, where the capture has no poses or no points."""
    rgb: RgbConfig = field(default_factory=RgbConfig)
    """The RGB model."""
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    """The metric scale."""
    thermal: ThermalConfig = field(default_factory=ThermalConfig)
    """The thermal model."""


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


BenchTable = Literal["1", "2", "beyond", "ablation"]
BENCH_TABLES: tuple[BenchTable, ...] = get_args(BenchTable)


@dataclass(frozen=True)
class BenchSyntheticConfig:
    """Settings of `rtgs bench synthetic`."""

    table: Literal["1", "2", "beyond", "ablation", "all"] = "1"
    """"1": the paper's Table I, six scenes × five seeds; "2": its Table II, what goes wrong with images and calibration; "beyond": fewer
    frames, more noise, inverted contrast, low resolution, a scene that does not show its scale; "ablation": the search's defaults beside
    other values"""
    size: int = 400
    """width and height of all images, in pixels"""
    frames: int = 50
    """pairs a scene; every eighth is held out and not seen by any method"""
    scenes: tuple[SceneName, ...] = SCENES[:6]
    """which scenes"""
    seeds: int = 5
    """trials a scene: each draws the start, the rig's direction and rotation, and the thermal noise"""
    rgb: RgbConfig = field(default_factory=lambda: RgbConfig(quality="fast"))
    """training of the RGB models, one a scene"""
    workers: int | None = None
    """processes; None: one a core"""

    @property
    def tables(self) -> tuple[BenchTable, ...]:
        """Which."""
        return BENCH_TABLES if self.table == "all" else (self.table,)

    def check(self) -> None:
        """Raises `RtgsError` where a field is out of its range."""
        for name, least in (("size", 32), ("frames", 8), ("seeds", 1), ("workers", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise RtgsError(f"{name}: {value} is too small; it must be at least {least}")
        if not self.scenes:
            raise RtgsError(f"scenes: none is named; there are {', '.join(SCENES)}")
        if len(set(self.scenes)) < len(self.scenes):
            raise RtgsError("scenes: one is named twice")


@dataclass(frozen=True)
class ManualConfig:
    """A length that a person has measured."""

    frames: tuple[str, str] | None = None
    """two frames A and B: their RGB cameras are `metres` apart"""
    metres: float | None = None
    """the length"""
    pixels: tuple[float, float, float, float, float, float, float, float] | None = None
    """not the cameras but two points P and Q are `metres` apart: x and y of P, then of Q, in the RGB file of A; the same in B's"""

    def check(self) -> None:
        """Raises `RtgsError` where half of it is missing, or a length is none."""
        if (self.frames is None) != (self.metres is None) or (self.pixels is not None and self.frames is None):
            raise RtgsError("--manual: a length needs --manual.frames A B and --manual.metres M, and --manual.pixels needs both.")
        if self.frames is not None and self.frames[0] == self.frames[1]:
            raise RtgsError(f"--manual.frames: {self.frames[0]} is named twice; a length needs two frames.")
        if self.metres is not None and not (math.isfinite(self.metres) and self.metres > 0):
            raise RtgsError(f"--manual.metres is {self.metres}; it is a positive number.")


@dataclass(frozen=True)
class BenchRealConfig:
    """Settings of `rtgs bench real`."""

    manual: ManualConfig = field(default_factory=ManualConfig)
    """row "Manual": the scale from a measured length"""
    mast3r_weights: Path | None = None
    """row "MASt3R": file of its weights; its package has to be on PYTHONPATH"""
    depth_model: Path | None = None
    """row "Metric depth": folder of a model for transformers"""
    plane_m: float = 1.0
    """row "Planar": distance of its plane from the thermal camera, in the unit of the rig's baseline"""
    region: tuple[int, int, int, int] | None = None
    """left, top, right and bottom in thermal pixels: its mean temperature is shown beside the thermal image's"""
    region_frame: str | None = None
    """held-out frame of the region; None: the first"""
    thermal: ThermalConfig = ThermalConfig(drift="off")
    """the thermal fit of every row, without drift: "auto" decides row by row, and what a frame has of its own can hide a wrong scale"""

    def check(self) -> None:
        """Raises `RtgsError` where a field is out of its range or a file is missing."""
        self.manual.check()
        if not (math.isfinite(self.plane_m) and self.plane_m > 0):
            raise RtgsError(f"--plane-m is {self.plane_m}; it is a positive number.")
        if self.region is None and self.region_frame is not None:
            raise RtgsError("--region-frame: says where a --region is, and there is none.")
        for name, path in (("--mast3r-weights", self.mast3r_weights), ("--depth-model", self.depth_model)):
            if path is not None and not path.exists():
                raise RtgsError(f"{name} {path}: no such file or folder.")


def to_json(config: Any) -> Any:
    """Nested dataclasses, paths and tuples as what JSON has."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        return {f.name: to_json(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, tuple | list):
        return [to_json(v) for v in config]
    return str(config) if isinstance(config, Path) else config


def from_json(cls: type[T], data: Any, where: str) -> T:
    """The inverse of `to_json`; settings that the file does not name keep their defaults.

    Args:
        where: the file, for messages.

    Raises:
        RtgsError: a setting this version does not know, or a value of another type.
    """
    hints = typing.get_type_hints(cls)
    if not isinstance(data, dict):
        raise RtgsError(f"{where}: {cls.__name__} is {data!r}; an object of settings is expected.")
    unknown = set(data) - set(hints)
    if unknown:
        raise RtgsError(f"{where}: unknown setting {sorted(unknown)[0]!r} of {cls.__name__}; it was written by another version.")
    values = {}
    for name, value in data.items():
        try:
            values[name] = _value(hints[name], value, where)
        except (TypeError, ValueError):
            raise RtgsError(f"{where}: setting {name!r} of {cls.__name__} is {value!r}, which it cannot be.") from None
    return cls(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (Union, types.UnionType):
        return None if value is None else _value(next(a for a in arguments if a is not type(None)), value, where)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_json(hint, value, where)
    if origin is tuple:
        inner = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_value(a, v, where) for a, v in zip(inner, value, strict=True))
    if hint is float and type(value) is int:
        return float(value)
    if (value not in arguments) if origin is Literal else (type(value) is not (str if hint is Path else hint)):
        raise TypeError
    return Path(value) if hint is Path else value


def is_run(path: Path) -> bool:
    """Whether the folder holds a run."""
    return (path / "config.json").exists()


def read_config(run: Path) -> tuple[Path, RunConfig]:
    """The capture's folder and the settings of a run.

    Raises:
        RtgsError: no run here, or an unreadable file.
    """
    if not is_run(run):
        raise RtgsError(f"{run}: not a run folder (no config.json). Start one with `rtgs run CAPTURE --out {run}`.")
    path = run / "config.json"
    data = read_run_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("capture"), str) or "settings" not in data:
        raise RtgsError(f"{path}: not written by rtgs (no capture or settings in it); choose another folder for the run.")
    return Path(data["capture"]), from_json(RunConfig, data["settings"], str(path))


def read_run_json(path: Path) -> Any:
    """A JSON file of a run folder.

    Raises:
        RtgsError: it is missing, or no JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RtgsError(f"{path}: missing; `rtgs run` on this folder makes it.") from None
    except ValueError as error:
        raise RtgsError(f"{path}: unreadable ({error}); remove it and run again.") from error
