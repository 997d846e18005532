"""Take a run's results elsewhere: the formats that were asked for, in metres with gravity along an axis, or in the frame of the poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, ResultLine, WarningLine, long_work, nobody
from rtgs.base.files import check_folder
from rtgs.base.json_records import write_json
from rtgs.config import ExportConfig
from rtgs.io.exports.formats import FORMATS
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.subject import Subject
from rtgs.records.georeference import Georeference
from rtgs.records.scene import Scene
from rtgs.records.world import is_far
from rtgs.run.folder import RunFolder, refuse_own_folders


def export(folder: RunFolder, scene: Scene, out: Path, settings: ExportConfig, listener: Listener = nobody) -> list[Path]:
    """Write the run in every format that the settings name. The listener is told what is written, and what a format cannot hold.

    Returns:
        What was written.

    Raises:
        RtgsError: `out` is the run or lies in the capture, a stage is missing, nothing tells the metres that are asked for, or a format
            needs a library that is not there.
    """
    refuse_own_folders(folder, scene, out)
    check_folder(out)
    formats = {name: FORMATS[name] for name in settings.formats}
    for name, chosen in formats.items():
        chosen.check()
        if settings.frame == "sfm" and is_far(scene.given_from_world) and not chosen.any_origin:
            raise RtgsError(
                f"--format {name} --frame sfm: the origin is too far away for the numbers of this format. Use --frame metric, "
                "which moves the origin."
            )
    scale = folder.read_scale()
    if settings.frame == "metric" and scale.no_metres:
        raise RtgsError(f"{folder.path}: {scale.no_metres} Or export in SfM units: --frame sfm.")
    subject = subject_of(folder, scene, settings)
    out.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for name, chosen in formats.items():
        frame = subject.frame(chosen.axes, fixed=not chosen.program_decides)
        with long_work(listener, name, f"export {name}") as progress:
            paths = chosen.write(subject, frame, out, progress)
        for path in (path for path in paths if path not in written):  # formats share a legend
            listener(ResultLine(f"wrote {path}"))
            written.append(path)
        listener(ResultLine(f"  {name}: {_frame_in_words(frame)}"))
        if chosen.cannot_hold:
            listener(ResultLine(f"  {name} cannot hold {chosen.cannot_hold}"))
    if settings.frame == "metric":
        _warn(subject, listener)
        if scale.doubt:
            listener(WarningLine(f"these lengths may not be metres: {scale.doubt}"))
    if subject.place is not None:
        path = out / "georeference.json"
        write_json(path, subject.place if settings.frame == "sfm" else _of_enu(subject.place))
        listener(
            ResultLine(f"wrote {path}" + (", which leads from z-up files to the Earth" if settings.frame == "metric" else ""))
        )
        written.append(path)
    return written


def subject_of(folder: RunFolder, scene: Scene, settings: ExportConfig) -> Subject:
    """What of a run is exported.

    Raises:
        RtgsError: a stage is missing.
    """
    scale = folder.read_scale()
    rgb, thermal, place = folder.read_rgb(), folder.read_thermal(), folder.read_georeference()
    return Subject(scene, rgb, thermal, scale.metres_per_sfm, scale.sfm_per_metre, settings, place)


def _of_enu(place: Georeference) -> Georeference:
    """The georeference of files whose x, y and z are metres east, north and up already."""
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return replace(place, metres_per_sfm=1.0, rotation=axes, translation_m=(0.0, 0.0, 0.0))


def _frame_in_words(frame: FileFrame) -> str:
    words = f"{frame.unit}, " + (frame.axes if frame.axes is not None else "turned as the poses are")
    if frame.place is not None:
        words += f", about {frame.place.latitude_deg:.7f} {frame.place.longitude_deg:.7f}"
    if frame.origin.any():
        words += ", origin at {:.3f} {:.3f} {:.3f} of the poses' frame".format(*frame.origin)
    return words


def _warn(subject: Subject, listener: Listener) -> None:
    if subject.frame("z-up", fixed=True).axes is None:
        listener(WarningLine("which way is up is not known: the cameras hardly turn. Files are turned as the poses are."))
