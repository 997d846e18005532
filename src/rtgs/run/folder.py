"""A run on disk: what is where, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from PIL import Image

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.files import recover, write_whole
from rtgs.base.json_records import from_json, read_record, read_run_json, to_json, write_json
from rtgs.config import RunConfig
from rtgs.io.colmap import read_scene, write_scene
from rtgs.io.image_files import IMAGE_SUFFIXES
from rtgs.io.ply import THERMAL_PROPERTIES, read_ply, read_thermal_ply, write_ply
from rtgs.io.rig import read_json_object, without_radiometry
from rtgs.models import GaussianTemperatures, RgbModel, SensorModel, ThermalModel
from rtgs.records.capture import Capture
from rtgs.records.decision import Decision
from rtgs.records.radiometry import Atmosphere, LinearRange, PlanckCalibration, PlanckRange, ThermalRange
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.run.config_file import is_run, read_config
from rtgs.run.records import CaptureSummary
from rtgs.scale import ScaleEstimate

Stage = Literal["sfm", "rgb", "scale", "thermal", "evaluate"]
STAGES: tuple[Stage, ...] = ("sfm", "rgb", "scale", "thermal", "evaluate")

_MADE_BY: dict[Stage, tuple[str, ...]] = {
    "sfm": ("scene", "capture_summary.json"),
    "rgb": ("rgb.ply", "rgb.json"),
    "scale": ("scale.json",),
    "thermal": ("thermal.ply", "thermal.json", "thermal_naive.ply", "thermal_naive.json"),
    "evaluate": ("metrics.json",),
}
_MAY_MAKE: dict[Stage, tuple[str, ...]] = {"thermal": ("thermal_pattern.tiff", "thermal_naive_pattern.tiff")}
_KEPT = ("scene", "rgb.ply")  # until they are replaced: dear, and never read while the stage that made them does not stand


class RunFolder:
    """The files of a run, and which stages stand.

    A stage stands when `stages.json` names it with the fingerprint of everything it depends on: the capture's files, its own
    settings and those of the stages before it; and when what it made is there. The entry is written last, so a killed stage does
    not stand: it is only marked as begun.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)

    @property
    def checkpoint(self) -> Path:
        return self.path / "rgb.checkpoint"

    @property
    def renders(self) -> Path:
        return self.path / "renders"

    # Settings

    def exists(self) -> bool:
        return is_run(self.path)

    def write_config(self, capture: Path, config: RunConfig) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        if config.rgb_ply is not None:
            config = replace(config, rgb_ply=config.rgb_ply.resolve())  # the run may be resumed from elsewhere
        data = {"version": __version__, "capture": str(capture.resolve()), "settings": to_json(config)}
        self.write_json("config.json", data)

    def read_config(self) -> tuple[Path, RunConfig]:
        """The capture's folder and the settings.

        Raises:
            RtgsError: no run here, or an unreadable file.
        """
        return read_config(self.path)

    # Stages

    def standing(self) -> dict[str, dict[str, Any]]:
        """Stage → {"fingerprint", "seconds"}, or {"begun": fingerprint} where it was cut off."""
        recover(self.path / "scene")
        path = self.path / "stages.json"
        return self.read_json(path.name) if path.exists() else {}

    def stands(self, stage: Stage, fingerprint: str) -> bool:
        """Done with this fingerprint, and its files are there (a person may have removed them, to have them made again)."""
        done = self.standing().get(stage, {}).get("fingerprint") == fingerprint
        return done and all((self.path / name).exists() for name in _MADE_BY[stage])

    def begin(self, stage: Stage, fingerprint: str) -> None:
        """From here on neither this stage nor a later one stands, and what they made is gone.

        Else a report, a render or an export would put old models beside a new scale. Half of an RGB training is kept if it was of
        this very fingerprint.
        """
        entries = self.standing()
        if stage in ("sfm", "rgb") and entries.get("rgb", {}).get("begun") != fingerprint:
            self.checkpoint.unlink(missing_ok=True)
        earlier = {k: v for k, v in entries.items() if k in STAGES[: STAGES.index(stage)]}
        self.write_json("stages.json", {**earlier, stage: {"begun": fingerprint}})
        for later in STAGES[STAGES.index(stage) :]:
            for name in _MADE_BY[later] + _MAY_MAKE.get(later, ()):
                if name not in _KEPT:
                    (self.path / name).unlink(missing_ok=True)
        shutil.rmtree(self.renders, ignore_errors=True)

    def finish(self, stage: Stage, fingerprint: str, seconds: dict[str, float]) -> None:
        self.write_json("stages.json", {**self.standing(), stage: {"fingerprint": fingerprint, "seconds": seconds}})
        if stage == "rgb":
            self.checkpoint.unlink(missing_ok=True)

    def seconds(self) -> dict[str, float]:
        return {name: value for entry in self.standing().values() for name, value in entry.get("seconds", {}).items()}

    # Artefacts

    def write_scene(self, scene: Scene, sfm_per_metre: float | None) -> None:
        with write_whole(self.path / "scene") as temporary:
            write_scene(temporary, scene, sfm_per_metre)

    def read_scene(self, capture: Capture) -> Scene:
        """With the rig as refined, from the moment the scale stage has refined it: whoever reads a run's scene has the one its scale
        belongs to. A scale stage that begins again removes `scale.json`, and so starts from the rig as calibrated."""
        scene = read_scene(self.path / "scene", capture)
        return self.read_scale().refined_scene(scene) if (self.path / "scale.json").exists() else scene

    def write_summary(self, scene: Scene) -> None:
        """`capture_summary.json`, for the report."""
        self.write_json("capture_summary.json", CaptureSummary.of(scene))

    def write_rgb(self, model: RgbModel) -> None:
        write_ply(self.path / "rgb.ply", model.gaussians)
        self._write_model("rgb.json", model)

    def read_rgb(self) -> RgbModel:
        data = self.read_json("rgb.json")
        return RgbModel(read_ply(self.path / "rgb.ply"), *self._common(data), data["history"])

    def write_thermal(self, model: ThermalModel, name: str = "thermal", *, celsius: bool) -> None:
        write_thermal_ply(self.path / f"{name}.ply", model, celsius=celsius)
        sensor = model.sensor
        if sensor.pattern is not None:
            with write_whole(self.path / f"{name}_pattern.tiff") as temporary:
                Image.fromarray(sensor.pattern).save(temporary, format="TIFF")
        self._write_model(
            f"{name}.json",
            model,
            range=asdict(model.range),
            color_range=asdict(model.colors),
            sfm_per_metre=model.sfm_per_metre,
            drift=dict(sensor.drift),
            pattern=None if sensor.pattern is None else f"{name}_pattern.tiff",
            decisions=to_json(model.decisions),
        )

    def read_thermal(self, name: str = "thermal") -> ThermalModel:
        data = self.read_json(f"{name}.json")
        background, settings = self._common(data)
        if not {"color_range", "drift"} <= data.keys():
            path = self.path / f"{name}.json"
            raise RtgsError(
                f"{path}: has no color_range or no drift, so an older version wrote it. Remove it; `rtgs thermal {self.path}` fits anew."
            )
        ply = read_thermal_ply(self.path / f"{name}.ply")
        found = [ply.properties[name] for name in THERMAL_PROPERTIES if name in ply.properties]
        return ThermalModel(
            ply.gaussians,
            background,
            LinearRange(**data["range"]),
            settings,
            data["sfm_per_metre"],
            data["history"],
            _color_range(data["color_range"]),
            SensorModel(
                {frame: (gain, offset) for frame, (gain, offset) in data["drift"].items()},
                np.asarray(Image.open(self.path / data["pattern"])) if data.get("pattern") else None,
            ),
            GaussianTemperatures(*found) if len(found) == len(THERMAL_PROPERTIES) else None,
            tuple(from_json(Decision, d, f"{name}.json") for d in data.get("decisions", ())),
        )

    def write_scale(self, estimate: ScaleEstimate) -> None:
        self.write_json("scale.json", estimate)

    def read_scale(self) -> ScaleEstimate:
        return read_record(ScaleEstimate, self.path / "scale.json")

    def write_json(self, name: str, data: Any) -> None:
        """Whole or not at all."""
        write_json(self.path / name, data)

    def read_json(self, name: str) -> dict[str, Any]:
        """Raises `RtgsError` where the file is missing or no JSON."""
        return read_run_json(self.path / name)

    def _write_model(self, name: str, model: RgbModel | ThermalModel, **more: Any) -> None:
        common = {"background": model.background.tolist(), "settings": asdict(model.settings), "history": dict(model.history)}
        self.write_json(name, common | more)

    @staticmethod
    def _common(data: dict[str, Any]) -> tuple[torch.Tensor, RenderSettings]:
        return torch.tensor(data["background"], dtype=torch.float32), RenderSettings(**data["settings"])


def _color_range(data: dict[str, Any]) -> ThermalRange:
    if "calibration" not in data:
        return LinearRange(**data)
    constants = dict(data["calibration"])
    calibration = PlanckCalibration(**constants | {"atmosphere": Atmosphere(**constants["atmosphere"])})
    return PlanckRange(calibration, data["lo_signal"], data["hi_signal"])


def write_thermal_ply(path: Path, model: ThermalModel, *, celsius: bool, factor: float = 1.0) -> None:
    """With lengths × `factor`; counts are no temperature and are not written as one."""
    found = model.temperatures
    known = (found.temperature, found.std, found.views) if found is not None and celsius else ()
    write_ply(
        path,
        model.gaussians.scaled(factor) if factor != 1.0 else model.gaussians,
        celsius_range=(model.colors.lo, model.colors.hi) if celsius else None,
        properties=dict(zip(THERMAL_PROPERTIES, known, strict=False)),
    )


def refuse_own_folders(folder: RunFolder, scene: Scene, out: Path) -> None:
    """Keep exports from overwriting what they are made from: the run's PLYs and scene, the capture's poses.

    Raises:
        RtgsError: `out` is the run folder, or the capture or inside of it.
    """
    here, capture = out.resolve(), scene.capture.root.resolve()
    if here == folder.path.resolve() or here == capture or capture in here.parents:
        whose = "is the run folder itself" if here == folder.path.resolve() else "lies inside the capture"
        raise RtgsError(f"--out {out}: {whose}, and files there would be overwritten; choose another folder.")


def fingerprints(capture: Path, config: RunConfig) -> dict[Stage, str]:
    """What each stage depends on, as a hash chained from stage to stage.

    The capture counts by the names, sizes and times of the files that `load_capture` reads, and of no others: what a file browser
    leaves there must not undo hours of training. `rig.json` counts by what it says, and its radiometry from the scale on: another
    emissivity changes no pose and no RGB model.
    """
    folders = [capture / "sparse" / "0"] + [capture / name for name in ("rgb", "thermal")]
    files = [p for folder in folders if folder.is_dir() for p in folder.iterdir() if not p.name.startswith(".")]
    files = [p for p in files if p.parent == folders[0] or p.suffix.lower() in IMAGE_SUFFIXES]
    files = sorted(p for p in (*files, capture / "transforms.json") if p.is_file())
    listing = [(str(p.relative_to(capture)), p.stat().st_size, p.stat().st_mtime_ns) for p in files]
    cameras, radiometry = without_radiometry(read_json_object(capture / "rig.json", missing="It holds both cameras."))
    ply = config.rgb_ply
    own: dict[Stage, Any] = {
        "sfm": [listing, cameras, config.rgb_max_side, to_json(config.sfm)],
        "rgb": [to_json(config.rgb), [str(ply), ply.stat().st_mtime_ns] if ply and ply.exists() else str(ply)],
        "scale": [radiometry, to_json(config.scale)],
        "thermal": to_json(config.thermal),
        "evaluate": None,
    }
    chain, result = "", {}
    for stage in STAGES:
        chain = hashlib.sha256((chain + json.dumps(own[stage])).encode()).hexdigest()[:16]
        result[stage] = chain
    return result
