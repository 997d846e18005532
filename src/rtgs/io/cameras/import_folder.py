"""A folder of radiometric JPEGs → a capture on disk.

Raw counts are kept, with the camera's constants and object parameters in `rig.json`: another emissivity is an edit there, not another
import. What the files can't say (no radiometric JPEG holds the transform between its two cameras) is listed, not made up.
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.base.json_records import write_json
from rtgs.base.progress import Progress
from rtgs.images.pictures import save_tiff
from rtgs.io.cameras.common_facts import Facts, Pair, common_facts
from rtgs.io.cameras.nominal_rig import check_sizes, disagreements, nominal_rig
from rtgs.io.cameras.protocol import CameraFormat, VisiblePicture
from rtgs.io.cameras.registry import camera_format
from rtgs.io.image_files import IMAGE_FORMATS, frame_name, list_images, read_header
from rtgs.io.rig import read_rig, write_rig
from rtgs.records.radiometry import ZERO_CELSIUS_K, CelsiusRadiometry, PlanckRadiometry

_SUFFIXES = (".jpg", ".jpeg", ".rjpg", ".rjpeg")
_USUAL_SURROUNDINGS_C = (-80.0, 100.0)  # from a clear sky to a hot machine room

_UNFINISHED = ".import.tmp"  # is in a capture folder while an import writes to it


@dataclass(frozen=True)
class ImportResult:
    """What an import did.

    Attributes:
        frames: how many pairs were written.
        missing: fields of `rig.json` that still have to be filled in, each with what is known; empty when the capture is complete.
        notes: what a person should know.
    """

    frames: int
    missing: tuple[str, ...]
    notes: tuple[str, ...]


def import_folder(
    camera: str, folder: Path, out: Path, *, rgb: Path | None = None, rig: Path | None = None, progress: Progress | None = None
) -> ImportResult:
    """Write a capture from a folder of radiometric JPEGs. Every file is read and checked before the first is written.

    Frames whose calibration or object parameters differ from the first one's are stored as the signal that the first one's would have
    given at the same temperature, in float32; the others keep their 16-bit counts.

    Args:
        camera: the maker's name in `registry.MODULES`.
        folder: its JPEGs with thermal data are the frames; others are passed over, and listed.
        out: the capture folder; new, empty, or what an import that was stopped has left.
        rgb: a folder with visible pictures of the same stems, for cameras that neither embed them nor name them alike.
        rig: a `rig.json` of these two cameras; its radiometry, if it has any, gives way to the files'.
        progress: called with done, total and a file name.

    Raises:
        RtgsError: no frame in the folder; a frame that can't be read or has no visible picture; frames of several sizes; a rig of
            another size; an `out` that holds something.
    """
    report = progress or (lambda done, total, text: None)
    if not folder.is_dir():
        raise RtgsError(f"{folder}: no such folder of radiometric JPEGs.")
    if out.exists() and not (out.is_dir() and (not any(out.iterdir()) or (out / _UNFINISHED).is_file())):
        raise RtgsError(f"{out}: is there already and isn't an empty folder. Give a new folder for the capture.")
    rig_file = None if rig is None else read_rig(rig)
    reader = _Reader(camera_format(camera), rgb, None if rgb is None else list_images(rgb))
    files, notes = _frames(reader.format, folder)

    unusual: dict[str, list[str]] = {}

    def pairs(done: int) -> Iterator[Pair]:
        for i, path in enumerate(files):
            pair = reader.read(path)
            if done == 0:
                for parameter in _unusual_surroundings(pair.shot.radiometry):
                    unusual.setdefault(parameter, []).append(path.name)
            yield pair
            report(done + i + 1, 2 * len(files), path.name)

    facts = common_facts(pairs(0))
    notes += [
        f"{parameter} in {len(names)} of {len(files)} frames ({names[0]} first). Was it meant in kelvin? Correct it under thermal.object "
        "of the capture's rig.json if it is wrong."
        for parameter, names in unusual.items()
    ]
    if rig is not None and rig_file is not None:
        check_sizes(rig, rig_file, facts)
        notes += disagreements(rig_file, facts)
    if facts.differing:
        notes.append(
            f"{facts.differing} of {len(files)} frames have another calibration or other object parameters than {facts.first.name}; "
            "their temperatures are kept, and their signals are stored as that one's would be."
        )
    _write_images(out, pairs(len(files)), facts)
    if rig_file is not None:
        write_rig(out / "rig.json", rig_file.rig, facts.radiometry)
        result = ImportResult(len(files), (), (*notes, *rig_file.warnings))
    else:
        rig_json, missing = nominal_rig(facts)
        write_json(out / "rig.json", rig_json)
        result = ImportResult(len(files), tuple(missing), tuple(notes))
    (out / _UNFINISHED).unlink()
    return result


def _unusual_surroundings(radiometry: CelsiusRadiometry) -> list[str]:
    """Object parameters that are temperatures, and hardly those of any surroundings."""
    if not isinstance(radiometry, PlanckRadiometry):
        return []
    p = radiometry.parameters
    given = {"reflected_c": p.reflected_c, "atmospheric_c": p.atmospheric_c}
    if p.window_transmission < 1:
        given["window_c"] = p.window_c
    coldest, hottest = _USUAL_SURROUNDINGS_C
    return [f"{name} is {value:g} °C" for name, value in given.items() if not coldest <= value <= hottest]


def _frames(camera: CameraFormat, folder: Path) -> tuple[list[Path], list[str]]:
    """The folder's radiometric files in name order, and what to say of the others."""
    jpegs = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in _SUFFIXES and not p.name.startswith(".")]
    frames = [p for p in jpegs if camera.recognises(p)]
    if not frames:
        raise RtgsError(
            f"{folder}: none of its {len(jpegs)} JPEGs holds thermal data. Copy the camera's original files; pictures that were edited "
            "or sent through a messenger have lost it."
        )
    expected = {*frames, *(camera.visible_partner(p) for p in frames)}
    others = [p.name for p in jpegs if p not in expected]
    if not others:
        return frames, []
    more = f" and {len(others) - 5} more" if len(others) > 5 else ""
    return frames, [f"{len(others)} JPEGs without thermal data were passed over: {', '.join(others[:5])}{more}."]


@dataclass(frozen=True)
class _Reader:
    """Reads pairs: a radiometric file, and the visible picture from `rgb`, from beside the file, or from inside it.

    Attributes:
        format: of the radiometric files.
        rgb, pictures: the folder of visible pictures and its files by name; None where the person gave no folder.
    """

    format: CameraFormat
    rgb: Path | None
    pictures: dict[str, Path] | None

    def read(self, path: Path) -> Pair:
        """Read and check one frame.

        Raises:
            RtgsError: unreadable, without a visible picture, or with pixels that no temperature gives.
        """
        shot, name = self.format.read(path), self.format.frame_name(path)
        file = self._given(path, name) or self.format.visible_partner(path)
        visible = shot.visible if file is None else _visible_file(file, self.format.visible_focal_px(file))
        if visible is None:
            raise RtgsError(
                f"{path}: {shot.no_visible}. Give the folder of visible pictures of the same names with --rgb FOLDER."
            )
        cold = np.mean(shot.radiometry.celsius(shot.counts) <= -ZERO_CELSIUS_K)
        if cold > 0:
            raise RtgsError(
                f"{path}: under its own object parameters {cold:.1%} of its pixels give less than what is reflected and emitted on the "
                "way. Correct them in the camera maker's program and save the file again, or remove this frame."
            )
        with Image.open(io.BytesIO(visible.file), formats=IMAGE_FORMATS) as picture:
            return Pair(name, path, shot, visible, picture.size)

    def _given(self, path: Path, name: str) -> Path | None:
        if self.pictures is None:
            return None
        found = self.pictures.get(frame_name(path.stem)) or self.pictures.get(frame_name(name))
        if found is None:
            raise RtgsError(
                f"{self.rgb}: has no picture named {path.stem}, the visible one of {path}. Add it, or remove that frame."
            )
        return found


def _visible_file(path: Path, focal_px: float | None) -> VisiblePicture:
    header = read_header(path)
    if header.orientation != 1:
        raise RtgsError(
            f"{path}: has EXIF orientation {header.orientation}, and the thermal image isn't turned with it. Save it upright."
        )
    return VisiblePicture(path.read_bytes(), path.suffix.lower(), focal_px)


def _write_images(out: Path, pairs: Iterator[Pair], facts: Facts) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / _UNFINISHED).touch()
    for name in ("rgb", "thermal"):
        if (out / name).exists():  # of an import that was stopped
            shutil.rmtree(out / name)
        (out / name).mkdir()
    for pair in pairs:
        with write_whole(out / "rgb" / f"{pair.name}{pair.visible.suffix}") as temporary:
            temporary.write_bytes(pair.visible.file)
        save_tiff(out / "thermal" / f"{pair.name}.tiff", _stored(pair, facts.radiometry))


def _stored(pair: Pair, radiometry: CelsiusRadiometry) -> NDArray[np.generic]:
    """The counts, or the signal that another radiometry would have given at the same temperatures."""
    own, counts = pair.shot.radiometry, pair.shot.counts
    return counts if own == radiometry else radiometry.counts(own.celsius(counts)).astype(np.float32)
