"""The main job: from a capture folder to a metric thermal model, stage by stage, resumable."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import RunConfig
from rtgs.evaluation.held_out import evaluate
from rtgs.io.capture import load_capture
from rtgs.metrics.lpips import available
from rtgs.models import ThermalModel
from rtgs.records.capture import Capture
from rtgs.records.scene import Scene
from rtgs.rgb.train import fit_rgb, model_from_ply
from rtgs.run.folder import STAGES, RunFolder, Stage, fingerprints
from rtgs.run.summary import metric_lines
from rtgs.scale import estimate_scale
from rtgs.sfm.poses import run_sfm
from rtgs.thermal import fit_thermal, gaussian_temperatures

__all__ = ["STAGES", "Pipeline", "Reporter", "RunFolder", "Stage"]


class Reporter(Protocol):
    """Who is told what goes on."""

    def stage(self, title: str) -> AbstractContextManager[Progress]:
        """A piece of long work begins; the context ends with it."""

    def say(self, text: str) -> None:
        """One line of result."""


class Pipeline:
    """A run folder and the stages that fill it.

    Args:
        folder: the run; its `config.json` says which capture and which settings.
        reporter: gets titles, progress and one line of result a stage.

    Raises:
        RtgsError: the folder holds no run.
    """

    def __init__(self, folder: RunFolder, reporter: Reporter) -> None:
        self.folder, self.reporter = folder, reporter
        self.capture_path, self.config = folder.read_config()
        self._capture: Capture | None = None
        self._scene: Scene | None = None

    @staticmethod
    def start(capture: Path, out: Path, config: RunConfig, reporter: Reporter) -> Pipeline:
        """Open a run folder for a capture, or go on with the one that is there.

        Raises:
            RtgsError: `out` is the run of another capture, a folder of something else, or inside the capture.
        """
        folder = RunFolder(out)
        if out.resolve() == capture.resolve() or capture.resolve() in out.resolve().parents:
            raise RtgsError(f"--out {out}: lies inside the capture; results belong outside of it.")
        if folder.exists():
            theirs, _ = folder.read_config()
            if theirs != capture.resolve():
                raise RtgsError(f"--out {out}: is a run of {theirs}; choose another folder, or remove that one.")
        elif out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise RtgsError(f"--out {out}: exists and is no run folder; choose another one.")
        if not capture.is_dir():
            raise RtgsError(f"{capture}: no such folder; a capture holds rgb/, thermal/ and rig.json.")
        _check_rgb_ply(config, folder)
        folder.write_config(capture, config)
        return Pipeline(folder, reporter)

    @staticmethod
    def changed(folder: RunFolder, reporter: Reporter, **settings: Any) -> Pipeline:
        """Open a run with some fields of its `RunConfig` replaced, and written down.

        Raises:
            RtgsError: the folder holds no run, or `rgb_ply` is no RGB model.
        """
        capture, config = folder.read_config()
        config = replace(config, **settings)
        _check_rgb_ply(config, folder)
        folder.write_config(capture, config)
        return Pipeline(folder, reporter)

    @property
    def capture(self) -> Capture:
        if self._capture is None:
            self._capture = load_capture(self.capture_path, rgb_max_side=self.config.rgb_max_side)
            for warning in self._capture.warnings:
                self.reporter.say(f"warning: {warning}")
        return self._capture

    @property
    def scene(self) -> Scene:
        """As written by the sfm stage, always read from disk: a resumed run sees the very same numbers."""
        if self._scene is None:
            self._scene = self.folder.read_scene(self.capture)
        return self._scene

    def run(self, last: Stage = "evaluate", *, again: bool = False) -> None:
        """Every stage up to `last` that does not stand; with `again`, `last` itself in any case.

        Raises:
            RtgsError: the capture has gone, or a stage cannot use what it is given.
        """
        if not self.capture_path.is_dir():  # before anything of the run is given up
            raise RtgsError(f"{self.capture_path}: the capture of {self.folder.path} has gone; put it back.")
        prints = fingerprints(self.capture_path, self.config)
        work: dict[Stage, Callable[[], dict[str, float]]] = {
            "sfm": self._sfm,
            "rgb": self._rgb,
            "scale": self._scale,
            "thermal": self._thermal,
            "evaluate": self._evaluate,
        }
        for stage in STAGES[: STAGES.index(last) + 1]:
            if self.folder.stands(stage, prints[stage]) and not (again and stage == last):
                self.reporter.say(f"{stage}: done before")
                continue
            self.folder.begin(stage, prints[stage])
            self.folder.finish(stage, prints[stage], work[stage]())

    def _timed(self, title: str, work: Callable[[Progress], Any]) -> tuple[Any, float]:
        start = time.perf_counter()
        with self.reporter.stage(title) as progress:
            result = work(progress)
        return result, time.perf_counter() - start

    def _sfm(self) -> dict[str, float]:
        capture = self.capture
        scene, seconds = self._timed(
            "structure from motion",
            lambda progress: run_sfm(capture, self.config.sfm, progress=progress),
        )
        self.folder.write_scene(scene, None)
        self.folder.write_summary(scene)
        self._scene = None
        self.reporter.say(f"sfm: {len(scene.frames)} of {len(capture.frames)} frames registered, {len(scene.points):,} points")
        for name, reason in scene.failures.items():
            self.reporter.say(f"  {name}: {reason}")
        for warning in scene.capture.warnings[len(capture.warnings) :]:
            self.reporter.say(f"warning: {warning}")
        return {"sfm": seconds}

    def _rgb(self) -> dict[str, float]:
        scene, ply = self.scene, self.config.rgb_ply
        if ply is not None:
            model, seconds = self._timed("import of the RGB model", lambda _: model_from_ply(ply, scene.extent))
        else:
            model, seconds = self._timed(
                "RGB model",
                lambda progress: fit_rgb(scene, self.config.rgb, checkpoint=self.folder.checkpoint, progress=progress),
            )
        self.folder.write_rgb(model)
        held_out = model.history.get("held_out_psnr")
        self.reporter.say(
            f"rgb: {len(model.gaussians):,} Gaussians" + (f", held-out PSNR {held_out[-1]:.2f} dB" if held_out else "")
        )
        return {"rgb": seconds}

    def _scale(self) -> dict[str, float]:
        self._scene = None  # the rig as calibrated
        scene, model = self.scene, self.folder.read_rgb()
        estimate, seconds = self._timed(
            "metric scale", lambda progress: estimate_scale(scene, model, self.config.scale, progress=progress)
        )
        self.folder.write_scale(estimate)
        self.folder.write_scene(estimate.refined_scene(scene), estimate.sfm_per_metre)
        self._scene = None  # from here on with the rig as refined
        interval = f" (95 %: {estimate.ci95[0]:.5g} to {estimate.ci95[1]:.5g})" if estimate.ci95 else ""
        self.reporter.say(f"scale: {estimate.sfm_per_metre:.5g} SfM units per metre{interval}, {estimate.status}")
        if estimate.reason:
            self.reporter.say(f"warning: {estimate.reason}")
        for f in estimate.refinement.freedoms if estimate.refinement else []:
            known = "" if f.decided else ", which the images do not decide"
            self.reporter.say(f"  {f.name}: {f.mean:+.3g} ± {f.std:.2g} {f.unit} (calibration: ± {f.prior_std:.2g}){known}")
        return {"scale": seconds}

    def _thermal(self) -> dict[str, float]:
        scene, model, config = self.scene, self.folder.read_rgb(), self.config.thermal
        sfm_per_metre, celsius = self.folder.read_scale().sfm_per_metre, scene.capture.radiometry.unit == "°C"

        def fit(progress: Progress) -> ThermalModel:
            fitted = fit_thermal(scene, model, sfm_per_metre, config, progress=progress)
            return replace(fitted, temperatures=gaussian_temperatures(scene, fitted, progress=progress))

        thermal, seconds = self._timed("thermal model", fit)
        self.folder.write_thermal(thermal, celsius=celsius)
        naive, naive_seconds = self._timed(
            "control: thermal model at scale 1", lambda progress: fit_thermal(scene, model, 1.0, config, progress=progress)
        )
        self.folder.write_thermal(naive, "thermal_naive", celsius=celsius)
        self.reporter.say(f"thermal: {len(thermal.gaussians):,} Gaussians with a temperature")
        return {"thermal": seconds, "thermal_naive": naive_seconds}

    def _evaluate(self) -> dict[str, float]:
        rgb, thermal, naive = self.folder.read_rgb(), self.folder.read_thermal(), self.folder.read_thermal("thermal_naive")
        networks, notes = available(["alexnet"])
        lpips, scene, renders = networks.get("alexnet"), self.scene, self.folder.renders
        scores, seconds = self._timed(
            "held-out views",
            lambda progress: evaluate(scene, rgb, thermal, naive, lpips=lpips, renders=renders, progress=progress),
        )
        scores = replace(scores, notes=tuple(notes), timings_s={**self.folder.seconds(), "evaluate": seconds})
        scores.write(self.folder.path / "metrics.json")
        for line in metric_lines(scores):
            self.reporter.say(line)
        return {"evaluate": seconds}


def _check_rgb_ply(config: RunConfig, folder: RunFolder) -> None:
    """Refuse a model to import before any long work, and before the run is changed."""
    if config.rgb_ply is not None:
        if config.rgb_ply.resolve() == (folder.path / "rgb.ply").resolve():
            raise RtgsError(
                f"--rgb-ply {config.rgb_ply}: is the run's own model, which this run replaces; copy it elsewhere first."
            )
        model_from_ply(config.rgb_ply, 1.0)
