"""A folder of radiometric JPEGs → a capture on disk.

Raw counts are kept, with the camera's constants and object parameters in `rig.json`: another emissivity is an edit there, not another
import. What the files can't say (no radiometric JPEG holds the transform between its two cameras) is listed, not made up.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.io.cameras import dji
from rtgs.io.cameras.flir import FlirImage, is_flir, read_flir
from rtgs.io.image_files import list_images, read_header
from rtgs.io.rig import RigFile, camera_to_json, radiometry_to_json, read_rig, write_rig
from rtgs.records.camera import Camera
from rtgs.records.radiometry import ZERO_CELSIUS_K, CelsiusRadiometry, PlanckRadiometry, RelativeCounts
from rtgs.records.rig import Rig

Brand = Literal["flir", "dji"]
_MAKE, _MODEL, _DATE_TIME, _GPS_IFD = 271, 272, 306, 0x8825
_FOCAL_TOLERANCE = 0.05  # of a nominal field of view
_REAL2IR_TOLERANCE = 0.15  # it is made for display
_OFFSET_TOLERANCE = 0.08  # of the visible picture's width, likewise
_NEAREST_M = 0.5  # that such a camera focuses on


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


@dataclass(frozen=True, eq=False)
class _Shot:
    """One instant, in memory.

    Attributes:
        counts, radiometry: `[h, w]`, and what makes °C of it.
        visible, suffix: the visible picture's file, encoded, and its suffix.
        thermal_focal_px, rgb_focal_px: nominal, where the files say.
        rgb_focal_hint_px, centre_hint_px: from the fusion settings, rough: the latter where the thermal image's centre lies in the visible
            picture, from its centre.
    """

    name: str
    source: Path
    counts: NDArray[np.generic]
    radiometry: CelsiusRadiometry
    visible: bytes
    suffix: str
    thermal_focal_px: float | None
    rgb_focal_px: float | None
    rgb_focal_hint_px: float | None
    centre_hint_px: tuple[float, float] | None

    @property
    def rgb_size(self) -> tuple[int, int]:
        return _size(self.visible)

    @property
    def thermal_size(self) -> tuple[int, int]:
        height, width = self.counts.shape
        return width, height


@dataclass(frozen=True, eq=False)
class _Facts:
    """What is common to all frames, gathered before anything is written."""

    first: Path
    radiometry: CelsiusRadiometry
    thermal_size: tuple[int, int]
    rgb_size: tuple[int, int]
    thermal_focal_px: float | None
    rgb_focal_px: float | None
    rgb_focal_hint_px: float | None
    centre_hint_px: tuple[float, float] | None
    differing: int  # frames with another calibration or other object parameters


def import_folder(
    brand: Brand, folder: Path, out: Path, *, rgb: Path | None = None, rig: Path | None = None, progress: Progress | None = None
) -> ImportResult:
    """Write a capture from a folder of radiometric JPEGs. Every file is read and checked before the first is written.

    Frames whose calibration or object parameters differ from the first one's are stored as the signal that the first one's would have
    given at the same temperature, in float32; the others keep their 16-bit counts.

    Args:
        brand: "flir", or "dji" for R-JPEGs.
        folder: its JPEGs with thermal data are the frames; others are passed over, and listed.
        out: the capture folder; new or empty.
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
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RtgsError(f"{out}: is there already and isn't an empty folder. Give a new folder for the capture.")
    rig_file = None if rig is None else read_rig(rig)
    pictures = None if rgb is None else list_images(rgb)
    read = _reader(brand, rgb, pictures)
    files, notes = _frames(brand, folder)
    total = 2 * len(files)

    def shots(done: int) -> Iterator[_Shot]:
        for i, path in enumerate(files):
            yield read(path)
            report(done + i + 1, total, path.name)

    facts = _facts(shots(0))
    if rig_file is not None:
        _check_sizes(rig, rig_file, facts)
        notes += _disagreements(rig_file, facts)
    if facts.differing:
        notes.append(
            f"{facts.differing} of {len(files)} frames have another calibration or other object parameters than {facts.first.name}; "
            "their temperatures are kept, and their signals are stored as that one's would be."
        )
    (out / "rgb").mkdir(parents=True)
    (out / "thermal").mkdir()
    for shot in shots(len(files)):
        (out / "rgb" / f"{shot.name}{shot.suffix}").write_bytes(shot.visible)
        Image.fromarray(_stored(shot, facts.radiometry)).save(out / "thermal" / f"{shot.name}.tiff")
    if rig_file is not None:
        write_rig(out / "rig.json", rig_file.rig, facts.radiometry)
        return ImportResult(len(files), (), (*notes, *rig_file.warnings))
    rig_json, missing = _rig_without_calibration(facts)
    (out / "rig.json").write_text(json.dumps(rig_json, indent=1) + "\n", encoding="utf-8")
    return ImportResult(len(files), tuple(missing), tuple(notes))


# ---------------------------------------------------------------------------------------------------- reading


def _frames(brand: Brand, folder: Path) -> tuple[list[Path], list[str]]:
    is_frame = is_flir if brand == "flir" else dji.is_dji
    jpegs = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in (".jpg", ".jpeg") and not p.name.startswith(".")]
    frames = [p for p in jpegs if is_frame(p)]
    if not frames:
        raise RtgsError(
            f"{folder}: none of its {len(jpegs)} JPEGs holds thermal data. Copy the camera's original files; pictures that were edited "
            "or sent through a messenger have lost it."
        )
    partners = set() if brand == "flir" else {dji.visible_partner(p) for p in frames}
    others = [p.name for p in jpegs if p not in set(frames) | partners]
    if not others:
        return frames, []
    more = f" and {len(others) - 5} more" if len(others) > 5 else ""
    return frames, [f"{len(others)} JPEGs without thermal data were passed over: {', '.join(others[:5])}{more}."]


def _reader(brand: Brand, rgb: Path | None, pictures: dict[str, Path] | None) -> Callable[[Path], _Shot]:
    def picture(path: Path, name: str) -> Path | None:
        if pictures is None:
            return None
        found = pictures.get(path.stem) or pictures.get(name)
        if found is None:
            raise RtgsError(f"{rgb}: has no picture named {path.stem}, the visible one of {path}. Add it, or remove that frame.")
        return found

    def flir(path: Path) -> _Shot:
        image = read_flir(path)
        given = picture(path, path.stem)
        if given is None and image.visible_file is None:
            raise RtgsError(
                f"{path}: has no visible image in it ({image.model or 'unknown camera'}). Give the folder of visible pictures of the same "
                "names with --rgb FOLDER."
            )
        visible, suffix = _embedded(image) if given is None else _picture(given)
        hint = centre = None
        if given is None and image.fusion is not None:
            centre = float(image.fusion.offset_x), float(image.fusion.offset_y)
        if given is None and image.focal_length_px is not None and image.fusion is not None:
            ratio = image.fusion.real2ir / max(1.0, image.fusion.digital_zoom)
            hint = image.focal_length_px * _size(visible)[0] / image.counts.shape[1] / ratio
        return _checked(
            _Shot(path.stem, path, image.counts, image.radiometry, visible, suffix, image.focal_length_px, None, hint, centre)
        )

    def dji_(path: Path) -> _Shot:
        image, name = dji.read_dji(path), dji.frame_name(path)
        partner = picture(path, name) or dji.visible_partner(path)
        if partner is None:
            raise RtgsError(
                f"{path}: no visible picture of this shot is beside it ({name}_W.JPG or {name}_V.JPG). Give the folder of visible "
                "pictures of the same names with --rgb FOLDER."
            )
        rgb_focal_px = dji.focal_length_px(partner)
        return _checked(
            _Shot(name, path, image.counts, image.radiometry, *_picture(partner), image.focal_length_px, rgb_focal_px, None, None)
        )

    return flir if brand == "flir" else dji_


def _checked(shot: _Shot) -> _Shot:
    cold = np.mean(shot.radiometry.celsius(shot.counts) <= -ZERO_CELSIUS_K)
    if cold > 0:
        raise RtgsError(
            f"{shot.source}: under its own object parameters {cold:.1%} of its pixels give less than what is reflected and emitted on the "
            "way. Correct them in the camera maker's program and save the file again, or remove this frame."
        )
    return shot


def _picture(path: Path) -> tuple[bytes, str]:
    header = read_header(path)
    if header.orientation != 1:
        raise RtgsError(
            f"{path}: has EXIF orientation {header.orientation}, and the thermal image isn't turned with it. Save it upright."
        )
    return path.read_bytes(), path.suffix.lower()


def _size(encoded: bytes) -> tuple[int, int]:
    with Image.open(io.BytesIO(encoded)) as image:
        return image.size


def _embedded(image: FlirImage) -> tuple[bytes, str]:
    """The embedded visible image as a file of its own, with the camera, the time and the GPS position of the file around it."""
    assert image.visible_file is not None
    exif = Image.Exif()
    time = image.captured_at.strftime("%Y:%m:%d %H:%M:%S") if image.captured_at else ""
    for tag, text in ((_MAKE, image.make), (_MODEL, image.model), (_DATE_TIME, time)):
        if text:
            exif[tag] = text
    if image.gps:
        exif.get_ifd(_GPS_IFD).update(image.gps)
    if image.visible_file.startswith(b"\xff\xd8"):
        return _with_exif(image.visible_file, exif.tobytes()), ".jpg"
    target = io.BytesIO()
    with Image.open(io.BytesIO(image.visible_file)) as picture:
        picture.save(target, "PNG", exif=exif)
    return target.getvalue(), ".png"


def _with_exif(jpeg: bytes, exif: bytes) -> bytes:
    """A JPEG with its EXIF replaced and its pixels untouched: no decoding, so nothing is lost."""
    head, rest = [b"\xff\xd8", b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif], 2
    while jpeg[rest] == 0xFF and 0xE0 <= jpeg[rest + 1] <= 0xEF:  # APP0 … APP15
        end = rest + 2 + int.from_bytes(jpeg[rest + 2 : rest + 4], "big")
        if jpeg[rest + 4 : rest + 8] != b"Exif":
            head.append(jpeg[rest:end])
        rest = end
    return b"".join(head) + jpeg[rest:]


# ---------------------------------------------------------------------------------------------------- common facts


def _facts(shots: Iterable[_Shot]) -> _Facts:
    facts: _Facts | None = None
    differing = 0
    names: dict[str, Path] = {}
    for shot in shots:
        sizes = shot.thermal_size, shot.rgb_size
        if facts is None:
            focals = shot.thermal_focal_px, shot.rgb_focal_px, shot.rgb_focal_hint_px
            facts = _Facts(shot.source, shot.radiometry, *sizes, *focals, shot.centre_hint_px, differing=0)
        for what, here, there in zip(("thermal", "visible"), sizes, (facts.thermal_size, facts.rgb_size), strict=True):
            if here != there:
                raise RtgsError(
                    f"{shot.source}: its {what} image is {here[0]}×{here[1]}, and {there[0]}×{there[1]} in {facts.first.name}. "
                    "A capture is by one pair of cameras held one way: import the others on their own."
                )
        if isinstance(shot.radiometry, PlanckRadiometry) != isinstance(facts.radiometry, PlanckRadiometry):
            raise RtgsError(f"{shot.source}: is by another kind of camera than {facts.first.name}. Import each on its own.")
        if shot.name in names:
            raise RtgsError(f"{shot.source}: would have the same name as {names[shot.name].name} in the capture. Rename one.")
        names[shot.name] = shot.source
        differing += shot.radiometry != facts.radiometry
    assert facts is not None  # the folder has frames
    return replace(facts, differing=differing)


def _stored(shot: _Shot, radiometry: CelsiusRadiometry) -> NDArray[np.generic]:
    if shot.radiometry == radiometry:
        return shot.counts
    return radiometry.counts(shot.radiometry.celsius(shot.counts)).astype(np.float32)


# ---------------------------------------------------------------------------------------------------- the rig


def _check_sizes(path: Path | None, rig_file: RigFile, facts: _Facts) -> None:
    for which, camera, size in (("rgb", rig_file.rig.rgb, facts.rgb_size), ("thermal", rig_file.rig.thermal, facts.thermal_size)):
        if (camera.width, camera.height) != size:
            raise RtgsError(
                f"{path}: {which}.width and height say {camera.width}×{camera.height}, but {facts.first} has {size[0]}×{size[1]}. "
                "Intrinsics belong to one image size."
            )


def _disagreements(rig_file: RigFile, facts: _Facts) -> list[str]:
    """Where the rig is far from what the files say."""
    checks = (
        ("thermal.fl_x", rig_file.rig.thermal.fl_x, facts.thermal_focal_px, "the field of view", _FOCAL_TOLERANCE),
        ("rgb.fl_x", rig_file.rig.rgb.fl_x, facts.rgb_focal_px, "the 35 mm equivalent", _FOCAL_TOLERANCE),
        ("rgb.fl_x", rig_file.rig.rgb.fl_x, facts.rgb_focal_hint_px, "the fusion setting Real2IR", _REAL2IR_TOLERANCE),
    )
    notes = [
        f"{field} is {given:.1f} in the rig, and {source} in {facts.first.name} suggests {nominal:.1f}. Is it the rig of this camera?"
        for field, given, nominal, source, tolerance in checks
        if nominal is not None and abs(given / nominal - 1) > tolerance
    ]
    if facts.centre_hint_px is not None:
        path = _centre_in_rgb(rig_file.rig) - np.array(facts.centre_hint_px)
        away = float(np.linalg.norm(path, axis=1).min())
        if away > _OFFSET_TOLERANCE * facts.rgb_size[0]:
            x, y = facts.centre_hint_px
            notes.append(
                f"rgb_from_thermal puts the thermal image's centre {away:.0f} px or more from where OffsetX and OffsetY in "
                f"{facts.first.name} have it, ({x:+.0f}, {y:+.0f}) px from the visible picture's centre, at any distance. Is it the rig of "
                "this camera, and the right way round?"
            )
    if not isinstance(rig_file.radiometry, RelativeCounts):
        notes.append("The rig's own conversion to °C gave way to that of the files.")
    return notes


def _centre_in_rgb(rig: Rig) -> NDArray[np.float64]:
    """`[D, 2]`: where the middle of the thermal image lies in the RGB image, from its middle, in pixels, near by to far away."""
    rgb, thermal = rig.rgb, rig.thermal
    ray = np.array([(thermal.width / 2 - thermal.cx) / thermal.fl_x, (thermal.height / 2 - thermal.cy) / thermal.fl_y, 1.0])
    points = rig.rgb_from_thermal.apply(np.geomspace(_NEAREST_M, 1000.0, 60)[:, None] * ray)
    points = points[points[:, 2] > 0]
    pixels = points[:, :2] / points[:, 2:] * (rgb.fl_x, rgb.fl_y) + (rgb.cx, rgb.cy)
    return np.asarray(pixels - (rgb.width / 2, rgb.height / 2)) if len(points) else np.full((1, 2), np.inf)


def _rig_without_calibration(facts: _Facts) -> tuple[dict[str, Any], list[str]]:
    """`rig.json` with nominal intrinsics where there are any, and what it lacks."""
    missing = []
    cameras: dict[str, dict[str, Any]] = {}
    for which, (width, height), focal in (
        ("rgb", facts.rgb_size, facts.rgb_focal_px),
        ("thermal", facts.thermal_size, facts.thermal_focal_px),
    ):
        camera = camera_to_json(Camera("PINHOLE", width, height, focal or 1.0, focal or 1.0, width / 2, height / 2))
        if focal is None:
            del camera["fl_x"], camera["fl_y"]
            hint = facts.rgb_focal_hint_px if which == "rgb" else None
            known = f"the fusion setting Real2IR suggests about {hint:.0f}, roughly" if hint else "the files don't say"
            missing.append(f"{which}.fl_x and {which}.fl_y, the focal length in pixels ({known})")
        cameras[which] = camera
    missing.append(
        "rgb_from_thermal (or thermal_from_rgb), 4×4, translation in metres (no radiometric JPEG holds it: calibrate the pair, or "
        "measure the distance between the lenses)"
    )
    cameras["thermal"] |= radiometry_to_json(facts.radiometry)
    return cameras, missing
