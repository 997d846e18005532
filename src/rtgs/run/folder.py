"""A run on disk: its files, and which stages are complete."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, WarningLine, nobody
from rtgs.base.files import check_folder, remove, write_whole
from rtgs.base.json_records import from_json, read_json, read_record, write_json
from rtgs.base.memory import Memory
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_scene, write_scene
from rtgs.maths.geometry import Sim3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.capture import Capture
from rtgs.records.georeference import Georeference
from rtgs.records.scene import Scene
from rtgs.run import model_files
from rtgs.run.config_file import SavedRun, is_run, read_config, write_config
from rtgs.run.records import CaptureSummary, WorldFile
from rtgs.run.stages import Stage
from rtgs.run.swap import MAKING, replace_results
from rtgs.scale import ScaleEstimate


@dataclass(frozen=True)
class StageEntry:
    """A stage in `stages.json`.

    Attributes:
        fingerprint: hash of everything that the results in the folder depend on; "" where there are none.
        begun: the fingerprint of work that has begun and not ended; "" where there is none.
        seconds: piece of work → how long it took.
    """

    fingerprint: str = ""
    begun: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)


class RunFolder:
    """The files of a run. Reading needs no lock; whoever writes holds `rtgs.run.lock.locked`.

    A stage is complete once it is listed in `stages.json` with the fingerprint of everything it depends on (the capture's content, its
    own settings and those of the stages before it), and while what it made is there. Results and entry are put in place together, so a
    stage that was killed is only listed as begun, and the results of an earlier call are as they were.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)

    @property
    def checkpoint(self) -> Path:
        """State of an RGB training that goes on."""
        return self.path / "rgb.checkpoint"

    @property
    def renders(self) -> Path:
        """Pictures of the held-out views."""
        return self.path / "renders"

    # Settings and capture

    def exists(self) -> bool:
        """Whether a run has been started here."""
        return is_run(self.path)

    def write_config(self, saved: SavedRun) -> None:
        """Write `config.json`."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_config(self.path, saved)

    def read_config(self) -> SavedRun:
        """Which capture and which settings.

        Raises:
            RtgsError: no run here, or an unreadable file.
        """
        return read_config(self.path)

    def load_capture(self, listener: Listener = nobody, saved: SavedRun | None = None) -> Capture:
        """The run's capture. Its warnings go to the listener.

        Args:
            saved: which capture and which settings; None: those of `config.json`.

        Raises:
            RtgsError: no run here, or a capture that has gone or cannot be read.
        """
        saved = self.read_config() if saved is None else saved
        self.check_capture(saved)
        config = saved.config
        memory = Memory.of(config.memory_gb)
        capture = load_capture(saved.capture, rgb_max_side=config.rgb_max_side, cache_bytes=memory.images)
        for warning in (*capture.warnings, *filter(None, [Memory.warning(config.memory_gb)])):
            listener(WarningLine(warning))
        return capture

    def load_scene(self, listener: Listener = nobody) -> Scene:
        """The run's scene, with the images of its capture.

        Raises:
            RtgsError: no run here, no scene in it yet, or a capture that has gone or cannot be read.
        """
        return self.read_scene(self.load_capture(listener))

    def check_capture(self, saved: SavedRun) -> None:
        """Raises `RtgsError` where the capture has gone."""
        if not saved.capture.is_dir():
            raise RtgsError(
                f"{saved.capture}: the capture of {self.path} has gone. Put it back, or say where it is now: "
                f"`rtgs run CAPTURE --out {self.path}`."
            )

    # Stages

    def entries(self) -> dict[str, StageEntry]:
        """What `stages.json` holds, by stage.

        Raises:
            RtgsError: the file is damaged.
        """
        path = self.path / "stages.json"
        if not path.exists():
            return {}
        data = read_json(path)
        if not isinstance(data, dict):
            raise RtgsError(f"{path}: holds no stages; remove it and run again.")
        try:
            return {name: from_json(StageEntry, entry, str(path)) for name, entry in data.items()}
        except RtgsError as error:
            raise RtgsError(f"{error} Remove it and run again.") from None

    def is_complete(self, stage: Stage, fingerprint: str) -> bool:
        """Done with this fingerprint, and its files are there (a person may have removed them, to have them made again)."""
        done = self.entries().get(stage.name, StageEntry()).fingerprint == fingerprint
        return done and all((self.path / name).exists() for name in stage.makes)

    def begin(self, stages: Sequence[Stage], fingerprint: str) -> None:
        """Begin the first of these stages. What it and the later ones have made stays until the new results are whole.

        Half-done work is removed, unless it is the first stage's and has this very fingerprint.
        """
        entries, first = self.entries(), stages[0]
        entry = entries.get(first.name, StageEntry())
        self._write_entries({**entries, first.name: replace(entry, begun=fingerprint)})
        for stage in stages:
            for name in stage.half_done if stage is not first or entry.begun != fingerprint else ():
                remove(self.path / name)

    def withdraw(self, stage: Stage) -> None:
        """Give up work that the stage has begun: what it made before counts as before. Does nothing where no work has begun."""
        entries = self.entries()
        entry = entries.get(stage.name, StageEntry())
        if not entry.begun:
            return
        self._write_entries({**entries, stage.name: replace(entry, begun="")})
        for name in stage.half_done:
            remove(self.path / name)

    def finish(self, stages: Sequence[Stage], fingerprint: str, seconds: Mapping[str, float]) -> None:
        """Put the new results of the first of these stages in place, and list the stage as complete.

        What the later stages have made is removed. Otherwise a report, a render or an export would put old models beside a new scale.
        """
        stage, names = stages[0], {stage.name for stage in stages}
        earlier = {name: entry for name, entry in self.entries().items() if name not in names}
        new = RunFolder(self.path / MAKING)
        new._write_entries({**earlier, stage.name: StageEntry(fingerprint, seconds=seconds)})
        replace_results(self.path, [name for stage in stages for name in (*stage.makes, *stage.may_make)])
        for name in stage.half_done:
            remove(self.path / name)

    def seconds(self) -> dict[str, float]:
        """How long each piece of work of the complete stages took."""
        return {name: value for entry in self.entries().values() for name, value in entry.seconds.items()}

    def _write_entries(self, entries: Mapping[str, StageEntry]) -> None:
        write_json(self.path / "stages.json", entries)

    # Results

    @property
    def given_from_world(self) -> Sim3:
        """`Scene.given_from_world` of the run's scene. The identity for a run of a version that had no world of its own.

        Raises:
            RtgsError: `scene/world.json` is damaged.
        """
        path = self.path / "scene" / "world.json"
        return read_record(WorldFile, path).given_from_world if path.exists() else Sim3.identity()

    def write_scene(self, scene: Scene, sfm_per_metre: float | None) -> None:
        """Write `scene/`: a COLMAP model in the given frame, and `world.json`, which world the models were made in."""
        with write_whole(self.path / "scene") as temporary:
            write_scene(temporary, scene, sfm_per_metre)
            write_json(temporary / "world.json", WorldFile.of(scene.given_from_world))

    def read_scene(self, capture: Capture, *, refined: bool = True) -> Scene:
        """The scene, in its world; with the rig as refined, once the scale stage has refined it.

        Whoever reads a run's scene so has the rig that its scale belongs to.

        Args:
            refined: False for the rig as calibrated in any case.
        """
        if capture.rgb_start is not None and capture.found_rgb is None:
            capture = self._with_found_rgb(capture)
        scene = read_scene(self.path / "scene", capture).in_world_of(self.given_from_world)
        return self.read_scale().refined_scene(scene) if refined and (self.path / "scale.json").exists() else scene

    def _with_found_rgb(self, capture: Capture) -> Capture:
        """The capture with the RGB camera that the sfm stage found."""
        path = self.path / "capture_summary.json"
        found = CaptureSummary.read(path).rgb_camera
        if found is None:
            raise RtgsError(f"{path}: does not hold the RGB camera that structure from motion found. Remove it and run again.")
        return capture.with_found_rgb(found)

    def write_summary(self, scene: Scene) -> None:
        """`capture_summary.json`, for the report."""
        self.write_json("capture_summary.json", CaptureSummary.of(scene))

    def write_rgb(self, model: RgbModel, given_from_world: Sim3) -> None:
        """Write `rgb.ply` and `rgb.json`, in the given frame (`Scene.given_from_world`)."""
        model_files.write_rgb(self.path, model, given_from_world)

    def read_rgb(self) -> RgbModel:
        """The RGB model, in the world of the run's scene.

        Raises:
            RtgsError: a file is missing or damaged.
        """
        return model_files.read_rgb(self.path, self.given_from_world)

    def write_thermal(self, model: ThermalModel, given_from_world: Sim3, name: str = "thermal") -> None:
        """Write a thermal model in the given frame: `thermal`, or `thermal_naive`, the control at scale 1."""
        model_files.write_thermal(self.path, model, name, given_from_world)

    def read_thermal(self, name: str = "thermal") -> ThermalModel:
        """A thermal model, or the control, in the world of the run's scene.

        Raises:
            RtgsError: a file is missing or damaged.
        """
        return model_files.read_thermal(self.path, name, self.given_from_world)

    def write_scale(self, estimate: ScaleEstimate) -> None:
        """Write `scale.json`."""
        self.write_json("scale.json", estimate)

    def read_scale(self) -> ScaleEstimate:
        """The scale.

        Raises:
            RtgsError: `scale.json` is missing or damaged.
        """
        return read_record(ScaleEstimate, self.path / "scale.json")

    def write_georeference(self, place: Georeference) -> None:
        """Write `georeference.json`."""
        self.write_json("georeference.json", place)

    def read_georeference(self) -> Georeference | None:
        """Where on the Earth the scene is; None where the photographs do not tell it.

        Raises:
            RtgsError: `georeference.json` is damaged.
        """
        path = self.path / "georeference.json"
        return read_record(Georeference, path) if path.exists() else None

    def write_json(self, name: str, data: Any) -> None:
        """Write a JSON file, whole or not at all."""
        write_json(self.path / name, data)

    def read_json(self, name: str) -> dict[str, Any]:
        """Raises `RtgsError` where the file is missing or no JSON."""
        return read_json(self.path / name)


def refuse_own_folders(folder: RunFolder, scene: Scene, out: Path) -> None:
    """Keep exports from overwriting what they are made from: the run's PLYs and scene, the capture's poses.

    Raises:
        RtgsError: `out` is the run folder, or the capture or inside of it; or it lies below a file.
    """
    check_folder(out.parent)
    here, capture = out.resolve(), scene.capture.root.resolve()
    if here == folder.path.resolve() or here == capture or capture in here.parents:
        whose = "is the run folder itself" if here == folder.path.resolve() else "lies inside the capture"
        raise RtgsError(f"--out {out}: {whose}, and files there would be overwritten; choose another folder.")
