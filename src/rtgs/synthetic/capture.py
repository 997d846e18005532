"""Writes a synthetic capture: the images, `rig.json` and poses as a user would have them, and the truth beside them."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.files import check_folder
from rtgs.base.json_records import to_json, write_json
from rtgs.config import SceneName, SynthConfig
from rtgs.images.pictures import save_png, save_tiff
from rtgs.io.rig import rig_to_json, write_rig
from rtgs.io.transforms import write_transforms
from rtgs.maths.geometry import SE3
from rtgs.records.rig import Rig
from rtgs.synthetic.camera_path import camera_path
from rtgs.synthetic.distractor import Distractor, draw_distractors
from rtgs.synthetic.draws import sfm_per_metre_of
from rtgs.synthetic.features import ThermalFeature, render_excess
from rtgs.synthetic.placement import place_features
from rtgs.synthetic.raycast import CompiledModel, render_rgb, render_thermal
from rtgs.synthetic.rig import true_rig, written_rig
from rtgs.synthetic.scenes import build_scene
from rtgs.synthetic.sensor import RADIOMETRY, contrast_gains, noise_rng, record_thermal

GROUND_TRUTH_JSON = "ground_truth.json"
CLEAN, WITHOUT_FEATURES = "ground_truth/thermal_clean", "ground_truth/thermal_without_features"
_OWN_FILE = re.compile(
    rf"((rgb|thermal|{CLEAN}|{WITHOUT_FEATURES})/)?\.?(frame_\d+\.(png|tiff)|(rig|transforms|ground_truth)\.json)(\.\d+\.tmp)?"
)


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
        features: what surfaces have in the thermal images alone.
        distractors: what stands in a thermal image and is no part of the scene, by frame name.
    """

    config: SynthConfig
    sfm_per_metre: float
    rig: Rig
    world_from_rgb: dict[str, SE3]
    world_from_thermal: dict[str, SE3]
    temperature_range_c: tuple[float, float]
    background_c: float
    gains: dict[str, float]
    features: tuple[ThermalFeature, ...] = ()
    distractors: Mapping[str, Distractor] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """The content of `ground_truth.json`."""
        shown_by_thermal_alone = {"features": to_json(self.features), "distractors": to_json(self.distractors)}
        return {
            "scene": self.config.scene,
            "seed": self.config.seed,
            "sfm_per_metre": self.sfm_per_metre,
            "rig": rig_to_json(self.rig, RADIOMETRY),
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
            **{name: value for name, value in shown_by_thermal_alone.items() if value},
            "config": asdict(self.config),
        }


def write_capture(out: Path, config: SynthConfig, *, progress: Callable[[int, int], None] | None = None) -> GroundTruth:
    """Render a scene into the capture folder `out`, with `ground_truth.json` beside the pictures.

    The images are written first and `rig.json` last, so that a folder with a rig is complete. An earlier synthetic capture at
    `out` is replaced. `progress` is called as (frames done, frames in all).

    Raises:
        RtgsError: `out` is a file or a folder that holds something else, or too few frames see a place for the features asked for.
    """
    out = Path(out)
    _check_free(out)
    model, truth = compiled_scene(config.scene), draw_truth(config)
    rig, names, world_from_rgb = truth.rig, list(truth.world_from_rgb), truth.world_from_rgb
    _clear(out)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / GROUND_TRUTH_JSON, {"status": "unfinished", "config": asdict(config)})  # by this `_clear` knows its own
    truth = replace(truth, temperature_range_c=_write_images(out, truth, model, progress))
    write_json(out / GROUND_TRUTH_JSON, truth.to_json())
    world_from_rgb_sfm = {n: SE3(p.rotation, truth.sfm_per_metre * p.translation) for n, p in world_from_rgb.items()}
    write_transforms(out / "transforms.json", rig.rgb, world_from_rgb_sfm, {n: f"rgb/{n}.png" for n in names})
    write_rig(out / "rig.json", written_rig(config, rig), RADIOMETRY)
    return truth


def draw_truth(config: SynthConfig) -> GroundTruth:
    """What is true of a capture before any picture is taken: `temperature_range_c` is empty, from infinity to minus infinity.

    Raises:
        RtgsError: too few frames see a place for the features asked for.
    """
    model, rig, names = compiled_scene(config.scene), true_rig(config), frame_names(config)
    world_from_rgb = dict(zip(names, camera_path(config, model.model.centre), strict=True))
    world_from_thermal = {name: pose @ rig.rgb_from_thermal for name, pose in world_from_rgb.items()}
    return GroundTruth(
        config=config,
        sfm_per_metre=sfm_per_metre_of(config),
        rig=rig,
        world_from_rgb=world_from_rgb,
        world_from_thermal=world_from_thermal,
        temperature_range_c=(math.inf, -math.inf),
        background_c=model.model.background_c,
        gains=dict(zip(names, contrast_gains(config), strict=True)),
        features=place_features(config, model, rig.thermal, world_from_thermal),
        distractors=draw_distractors(config, rig.thermal, names) if config.distractor else {},
    )


def _write_images(
    out: Path, truth: GroundTruth, model: CompiledModel, progress: Callable[[int, int], None] | None
) -> tuple[float, float]:
    """The images of all frames. Returns the lowest and the highest noise-free temperature of the scene."""
    config, background_c = truth.config, truth.background_c
    truths = [CLEAN, *([WITHOUT_FEATURES] if truth.features else [])] if config.thermal_clean else []
    for folder in ("rgb", "thermal", *truths):
        (out / folder).mkdir(parents=True, exist_ok=True)
    coldest, hottest = math.inf, -math.inf
    for i, name in enumerate(truth.world_from_rgb):
        rgb = render_rgb(model, truth.rig.rgb, truth.world_from_rgb[name], config.supersampling)
        plain = clean = render_thermal(model, truth.rig.thermal, truth.world_from_thermal[name], config.supersampling)
        if truth.features:
            pose = truth.world_from_thermal[name]
            clean = plain + render_excess(model, truth.features, truth.rig.thermal, pose, config.supersampling)
        # Pixels at the rim are mixed with the background: only those with the scene all around count.
        inside = cv2.erode((clean != np.float32(background_c)).astype(np.uint8), np.ones((3, 3), np.uint8))
        scene = clean[inside > 0]
        if scene.size:
            coldest, hottest = min(coldest, float(scene.min())), max(hottest, float(scene.max()))
        seen = clean + truth.distractors[name].excess(truth.rig.thermal) if name in truth.distractors else clean
        counts = record_thermal(seen, config, truth.gains[name], noise_rng(config, i))
        save_png(out / "rgb" / f"{name}.png", (rgb * 255 + 0.5).astype(np.uint8))
        save_tiff(out / "thermal" / f"{name}.tiff", counts)
        for folder, image in zip(truths, (clean, plain), strict=False):
            save_tiff(out / folder / f"{name}.tiff", image)
        if progress is not None:
            progress(i + 1, config.frames)
    return (coldest, hottest) if coldest <= hottest else (background_c, background_c)  # nothing but rims and background


@cache
def compiled_scene(name: SceneName) -> CompiledModel:
    """The ray caster's form of a scene: a second or two to make and a few megabytes, so it is kept."""
    return CompiledModel(build_scene(name))


def frame_names(config: SynthConfig) -> list[str]:
    """`frame_000`, `frame_001`, …"""
    return [f"frame_{i:0{max(3, len(str(config.frames - 1)))}d}" for i in range(config.frames)]


def _check_free(out: Path) -> None:
    """There is nothing at `out`, an empty folder, or what an earlier call wrote and nothing else.

    Raises:
        RtgsError: there is something else.
    """
    if out.is_dir():
        files = [p for p in out.rglob("*") if not p.is_dir()]
        marked = (out / GROUND_TRUTH_JSON).is_file()
        foreign = sorted(str(p.relative_to(out)) for p in files if not _OWN_FILE.fullmatch(p.relative_to(out).as_posix()))
        if files and (not marked or foreign):
            found = foreign[0] if foreign else f"no {GROUND_TRUTH_JSON}"
            raise RtgsError(f"{out}: holds something other than a synthetic capture ({found}); name a new or empty folder")
    else:
        check_folder(out)


def _clear(out: Path) -> None:
    """Remove an earlier capture."""
    if not any(not p.is_dir() for p in out.rglob("*")):
        return
    (out / "rig.json").unlink(missing_ok=True)  # first: from here on it is no capture
    for entry in out.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        else:
            entry.unlink()
