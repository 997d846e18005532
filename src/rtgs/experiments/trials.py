"""Scenes and trials. A scene has one RGB model. A trial is a scene with a rig, its noise and a start."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.json_records import read_record, write_json
from rtgs.config import RgbConfig, SfmConfig, SynthConfig
from rtgs.experiments.variants import Variant
from rtgs.io.capture import load_capture
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.rgb.train import fit_rgb
from rtgs.run.folder import RunFolder
from rtgs.sfm.poses import run_sfm
from rtgs.synthetic import compiled_scene, render_thermal, write_capture
from rtgs.synthetic.camera_path import camera_path
from rtgs.synthetic.capture import frame_names
from rtgs.synthetic.draws import sfm_per_metre_of
from rtgs.synthetic.rig import true_rig, written_rig
from rtgs.synthetic.sensor import RADIOMETRY, contrast_gains, noise_rng, record_thermal

_START = (0.5, 2.0)  # range of start / truth


def prepare(folder: Path, config: SynthConfig, rgb: RgbConfig) -> None:
    """Render a scene's photographs, triangulate points and train its RGB model, unless an earlier call did."""
    done = folder / "scene.json"
    if done.exists():
        return
    run = RunFolder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_capture(folder / "capture", config)
    scene = run_sfm(load_capture(folder / "capture"), SfmConfig())
    run.write_scene(scene, None)
    model = fit_rgb(scene, rgb)
    run.write_rgb(model, scene.given_from_world)
    scores = model.history["held_out_psnr"]
    write_json(done, SceneFacts(scores[-1], len(model.gaussians), len(scene.points)))


@dataclass(frozen=True)
class SceneFacts:
    """What is known of a prepared scene: held-out PSNR of its RGB model in dB, and how many Gaussians and SfM points it has."""

    psnr_db: float
    gaussians: int
    points: int

    @staticmethod
    def read(folder: Path) -> SceneFacts:
        """From what `prepare` left in the folder."""
        return read_record(SceneFacts, folder / "scene.json")


@dataclass(frozen=True, eq=False)
class Trial:
    """A scene with its RGB model, seen by the rig of one seed.

    Attributes:
        config: settings of its capture, without the changes of a row.
        truth: the true `sfm_per_metre`. start: where descents begin.
    """

    base: Scene
    model: RgbModel
    config: SynthConfig
    truth: float
    start: float

    @staticmethod
    def read(folder: Path, config: SynthConfig, seed: int) -> Trial:
        """From what `prepare` left in the folder."""
        run = RunFolder(folder)
        base = run.read_scene(load_capture(folder / "capture"))
        drawn = np.random.default_rng([seed, zlib.crc32(f"{config.scene}/start".encode())]).uniform(*_START)
        truth = sfm_per_metre_of(config)
        return Trial(base, run.read_rgb(), replace(config, rig_seed=seed), truth, truth * float(drawn))

    def temperatures(self, thermal_size: int | None) -> list[NDArray[np.float32]]:
        """°C in every frame's true thermal view, without blur, noise or gain."""
        config = replace(self.config, thermal_size=thermal_size)
        model, rig = compiled_scene(config.scene), true_rig(config)
        poses = camera_path(config, model.model.centre)
        return [render_thermal(model, rig.thermal, pose @ rig.rgb_from_thermal, config.supersampling) for pose in poses]

    def scene(self, variant: Variant, clean: list[NDArray[np.float32]]) -> Scene:
        """The scene of a row: the images that its sensor records, and the rig as its calibration says.

        Args:
            clean: °C in every frame, from `temperatures`.
        """
        config, capture = variant.applied_to(self.config), self.base.capture
        rig = written_rig(config, true_rig(config))
        frames = []
        for i, (gain, name) in enumerate(zip(contrast_gains(config), frame_names(config), strict=True)):
            counts = record_thermal(clean[i], config, float(gain), noise_rng(config, i))
            image = RADIOMETRY.celsius(counts)
            if variant.inverted:
                image = -image
            frames.append(capture.frames[i].with_thermal(image))
            assert capture.frames[i].name == name
        mask = np.ones((rig.thermal.height, rig.thermal.width), bool)
        rig = replace(rig, rgb=capture.rig.rgb)
        return replace(self.base, capture=replace(capture, raw_rig=rig, rig=rig, frames=tuple(frames), thermal_mask=mask))
