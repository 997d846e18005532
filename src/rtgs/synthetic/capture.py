"""Writes a synthetic capture: where the cameras stand, what they record, and what is told about them."""

from __future__ import annotations

import math
import re
import shutil
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.config import SceneName, SynthConfig
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig
from rtgs.synthetic.raycast import CompiledModel, render_rgb, render_thermal
from rtgs.synthetic.scenes import build_scene

CELSIUS_PER_COUNT = 0.01
CELSIUS_OFFSET = -100.0
SFM_PER_METRE_RANGE = (0.05, 20.0)  # drawn log-uniformly from here unless the config names one
GROUND_TRUTH_JSON = "ground_truth.json"
_OWN_FILE = re.compile(
    r"(rgb|thermal|ground_truth/thermal_clean)/frame_\d+\.(png|tiff)|(rig|transforms|ground_truth)\.(json|part)"
)

_OBJECT_FOV_DEG, _ROOM_FOV_DEG = 40.0, 66.0
_OBJECT_DISTANCE_M = 4.0
_HEIGHT_M, _SURVEY_M = 800.0, 130.0  # above the plain, and how far the survey goes to each side
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What is true of a synthetic capture; `ground_truth.json` holds the same. No stage of the pipeline reads it.

    Attributes:
        config: what the capture was made with.
        sfm_per_metre: unit of the poses in `transforms.json`.
        rig: true cameras and true `rgb_from_thermal`, metres; `rig.json` differs by the calibration errors asked for.
        world_from_rgb, world_from_thermal: true poses by frame name, translations in metres.
        temperature_range_c: lowest and highest noise-free temperature of the scene (not the background) in any frame.
        background_c: temperature where the scene ends.
        gains: thermal contrast factor by frame name.
    """

    config: SynthConfig
    sfm_per_metre: float
    rig: Rig
    world_from_rgb: dict[str, SE3]
    world_from_thermal: dict[str, SE3]
    temperature_range_c: tuple[float, float]
    background_c: float
    gains: dict[str, float]

    def to_json(self) -> dict[str, Any]:
        return {
            "scene": self.config.scene,
            "seed": self.config.seed,
            "sfm_per_metre": self.sfm_per_metre,
            "rig": rig_json(self.rig),
            "background_c": self.background_c,
            "temperature_range_c": list(self.temperature_range_c),
            "frames": {
                name: {
                    "world_from_rgb_m": self.world_from_rgb[name].matrix().tolist(),
                    "world_from_thermal_m": self.world_from_thermal[name].matrix().tolist(),
                    "gain": self.gains[name],
                }
                for name in self.world_from_rgb
            },
            "config": asdict(self.config),
        }


def write_capture(out: Path, config: SynthConfig, *, progress: Callable[[int, int], None] | None = None) -> GroundTruth:
    """Render a scene into the capture folder `out`, with `ground_truth.json` beside the pictures.

    The images are written first and `rig.json` last, so that a folder with a rig is complete. An earlier synthetic capture at
    `out` is replaced. `progress` is called as (frames done, frames in all).

    Raises:
        RtgsError: a field of `config` is out of range, or `out` is a file or a folder that holds something else.
    """
    config.check()
    out = Path(out)
    _clear(out)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / GROUND_TRUTH_JSON, {"status": "unfinished", "config": asdict(config)})  # by this `_clear` knows its own
    model = compiled_scene(config.scene)
    rig = true_rig(config)
    names = frame_names(config)
    world_from_rgb = dict(zip(names, camera_path(config, model.model.centre), strict=True))
    world_from_thermal = {name: pose @ rig.rgb_from_thermal for name, pose in world_from_rgb.items()}
    gains = dict(zip(names, contrast_gains(config), strict=True))
    (out / "rgb").mkdir(exist_ok=True)
    (out / "thermal").mkdir(exist_ok=True)
    if config.thermal_clean:
        (out / "ground_truth" / "thermal_clean").mkdir(parents=True, exist_ok=True)
    coldest, hottest = math.inf, -math.inf
    for i, name in enumerate(names):
        rgb = render_rgb(model, rig.rgb, world_from_rgb[name], config.supersampling)
        clean = render_thermal(model, rig.thermal, world_from_thermal[name], config.supersampling)
        # Pixels at the rim are mixed with the background: only those with the scene all around count.
        inside = cv2.erode((clean != np.float32(model.model.background_c)).astype(np.uint8), np.ones((3, 3), np.uint8))
        scene = clean[inside > 0]
        if scene.size:
            coldest, hottest = min(coldest, float(scene.min())), max(hottest, float(scene.max()))
        counts = record_thermal(clean, config, gains[name], noise_rng(config, i))
        Image.fromarray((rgb * 255 + 0.5).astype(np.uint8)).save(out / "rgb" / f"{name}.png")
        Image.fromarray(counts).save(out / "thermal" / f"{name}.tiff")
        if config.thermal_clean:
            Image.fromarray(clean).save(out / "ground_truth" / "thermal_clean" / f"{name}.tiff")
        if progress is not None:
            progress(i + 1, config.frames)
    if coldest > hottest:  # nothing but rims and background
        coldest = hottest = model.model.background_c
    truth = GroundTruth(
        config,
        sfm_per_metre_of(config),
        rig,
        world_from_rgb,
        world_from_thermal,
        (coldest, hottest),
        model.model.background_c,
        gains,
    )
    write_json(out / GROUND_TRUTH_JSON, truth.to_json())
    write_json(out / "transforms.json", transforms_json(truth))
    write_json(out / "rig.json", rig_json(written_rig(config, rig)))
    return truth


@cache
def compiled_scene(name: SceneName) -> CompiledModel:
    """The ray caster's form of a scene: a second or two to make and a few megabytes, so it is kept."""
    return CompiledModel(build_scene(name))


def sfm_per_metre_of(config: SynthConfig) -> float:
    """The config's own, or one drawn log-uniformly with its seed."""
    if config.sfm_per_metre is not None:
        return config.sfm_per_metre
    low, high = np.log(SFM_PER_METRE_RANGE)
    return float(np.exp(_rng(config, "unit").uniform(low, high)))


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
    toe_in = 0.0 if config.scene in ("room", "plain") else 0.9 * config.baseline_m / _OBJECT_DISTANCE_M
    if config.rig_seed is None:
        direction = np.array([0.975, -0.17, 0.14])
        turn = rotation_from_axis_angle(np.radians([-1.1, -math.degrees(toe_in) - 0.4, 1.6]))
    else:
        rng = _rig_rng(config, "rig")
        side, ahead = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(-20, 20))
        direction = np.array([math.cos(ahead) * math.cos(side), math.cos(ahead) * math.sin(side), math.sin(ahead)])
        # Turned about the axis at right angles to the baseline and the view, by as much as centres the object again.
        inwards = toe_in * np.array([direction[1], -direction[0], 0.0])
        turn = rotation_from_axis_angle(inwards) @ rotation_from_axis_angle(np.radians(rng.normal(0, 1.5, 3)))
    return Rig(rgb, thermal, SE3(turn, config.baseline_m * direction / np.linalg.norm(direction)))


def written_rig(config: SynthConfig, rig: Rig) -> Rig:
    """The rig as `rig.json` tells it: the true one with the config's calibration errors."""
    rng = _rig_rng(config, "calibration")
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


def camera_path(config: SynthConfig, centre: tuple[float, float, float]) -> list[SE3]:
    """`world_from_rgb` of every frame, in metres; objects are seen from around `centre`."""
    rng = _rng(config, "path")
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
        distance = _OBJECT_DISTANCE_M * (1 + rng.uniform(-0.03, 0.05))
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


def record_thermal(
    clean_c: NDArray[np.float32], config: SynthConfig, gain: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """`[H, W]` °C to 16-bit counts: lens blur, sensor noise, gain about the image's mean, rounding."""
    image: NDArray[Any] = clean_c.astype(np.float64)
    if config.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REPLICATE)
    image = image + config.netd_c * rng.standard_normal(image.shape)
    image = image.mean() + gain * (image - image.mean())
    return np.clip(np.rint((image - CELSIUS_OFFSET) / CELSIUS_PER_COUNT), 0, 65535).astype(np.uint16)


def rig_json(rig: Rig) -> dict[str, Any]:
    """`rig.json` of the conventions."""

    def camera(c: Camera) -> dict[str, Any]:
        keys = ("model", "width", "height", "fl_x", "fl_y", "cx", "cy")
        return {k: getattr(c, k) for k in keys}

    return {
        "rgb": camera(rig.rgb),
        "thermal": camera(rig.thermal) | {"celsius_per_count": CELSIUS_PER_COUNT, "celsius_offset": CELSIUS_OFFSET},
        "rgb_from_thermal": rig.rgb_from_thermal.matrix().tolist(),
    }


def transforms_json(truth: GroundTruth) -> dict[str, Any]:
    """`transforms.json`, nerfstudio's form: OpenGL camera-to-world, camera centres in SfM units."""
    c = truth.rig.rgb
    frames = []
    for name, pose in truth.world_from_rgb.items():
        matrix = SE3(pose.rotation, truth.sfm_per_metre * pose.translation).matrix() @ _OPENGL_FROM_OPENCV
        frames.append({"file_path": f"rgb/{name}.png", "transform_matrix": matrix.tolist()})
    intrinsics = {"w": c.width, "h": c.height, "fl_x": c.fl_x, "fl_y": c.fl_y, "cx": c.cx, "cy": c.cy}
    return {"camera_model": "PINHOLE", **intrinsics, "frames": frames}


def frame_names(config: SynthConfig) -> list[str]:
    return [f"frame_{i:0{max(3, len(str(config.frames - 1)))}d}" for i in range(config.frames)]


def contrast_gains(config: SynthConfig) -> NDArray[np.float64]:
    """`[frames]`: what each thermal image's contrast about its mean is multiplied by."""
    return 1 + config.gain_jitter * _rig_rng(config, "gain").uniform(-1, 1, config.frames)


def noise_rng(config: SynthConfig, frame: int) -> np.random.Generator:
    """Of one thermal image's noise."""
    return _rig_rng(config, "noise", frame)


def _rig_rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """A stream of what the rig's own seed draws, where there is one: RGB images and poses stay the same."""
    if config.rig_seed is None:
        return _rng(config, purpose, index)
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index, config.rig_seed])


def _rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """Its own stream for each purpose: switching one option on leaves the others' draws alone."""
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index])


def _clear(out: Path) -> None:
    """Make room at `out`: nothing there, an empty folder, or what an earlier call wrote and nothing else."""
    if out.is_dir():
        files = [p for p in out.rglob("*") if not p.is_dir()]
        if not files:
            return
        marked = (out / GROUND_TRUTH_JSON).is_file()
        foreign = sorted(str(p.relative_to(out)) for p in files if not _OWN_FILE.fullmatch(p.relative_to(out).as_posix()))
        if not marked or foreign:
            found = foreign[0] if foreign else f"no {GROUND_TRUTH_JSON}"
            raise RtgsError(f"{out}: holds something other than a synthetic capture ({found}); name a new or empty folder")
        (out / "rig.json").unlink(missing_ok=True)  # first: from here on it is no capture
        for entry in out.iterdir():
            if entry.is_dir():
                shutil.rmtree(entry)
            else:
                entry.unlink()
    elif out.exists():
        raise RtgsError(f"{out}: is a file; name a folder for the capture")
