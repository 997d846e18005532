"""Image files: headers, decoding, names.

The only place that decodes a capture's images. A file may carry a tag that says how to turn its stored pixels for display (the
orientation of EXIF and of TIFF). The caller says whether the tag is applied.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import OPEN_INFO, ImageFileDirectory_v2, TiffImageFile

from rtgs.base.errors import RtgsError

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
# Pillow goes by a file's content. Left free, it would open an EPS of any name, for which it starts Ghostscript.
IMAGE_FORMATS = ("JPEG", "PNG", "TIFF")
_JPEG_MAGIC = b"\xff\xd8\xff"
MOST_JPEG_PIXELS = 500_000_000  # a JPEG is decoded at a fraction of its size, but its header alone must not ask for any memory
REDUCTIONS = (8, 4, 2)  # at which a JPEG can be decoded
SPARE = 2  # a reduced JPEG keeps this many pixels for one that is wanted, so that undistorting it loses nothing that can be seen
_ORIENTATION, _DATE_TIME, _EXIF_IFD, _DATE_TIME_ORIGINAL, _SUBSECONDS_ORIGINAL = 0x0112, 0x0132, 0x8769, 0x9003, 0x9291
_FOCAL_LENGTH_35MM = 0xA405
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_PHOTOMETRIC, _TIFF_SAMPLE_FORMAT = 0x0100, 0x0101, 0x0102, 0x0106, 0x0153
_MIN_IS_WHITE, _UNSIGNED, _SIGNED, _FLOAT, _GDAL_NODATA = 0, 1, 2, 3, 0xA481
# Pillow decodes floats of 64 bits, and does not know TIFFs of them: NumPy's and MATLAB's default numbers.
for _order, _raw in ((b"II", "F;64F"), (b"MM", "F;64BF")):
    for _photometric in (0, 1):
        OPEN_INFO[(_order, _photometric, (_FLOAT,), 1, (64,), ())] = ("F", _raw)
_COUNT_MODES = ("L", "I", "I;16", "I;16B", "I;16L", "I;16N", "F")
# What turns upright pixels back to the stored ones, by orientation.
_STORED_FROM_UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


@dataclass(frozen=True)
class ImageHeader:
    """What a file says before it is decoded.

    Attributes:
        path: the file.
        stored_size: width and height of the stored pixels.
        format, mode: Pillow's names of the file format and of the pixel format.
        orientation: the value of the tag, 1 … 8; 1 (nothing to turn) when it is absent or is another number.
        time_s: when it was taken, in seconds by the camera's clock; None when EXIF does not say. EXIF names no time zone, so only
            differences between files of one camera mean something.
        no_data: the count that marks pixels without a value, as the tag GDAL_NODATA of a TIFF gives it; None when it does not.
        bits: of one number in the file.
        equivalent_mm: the 35 mm equivalent of the focal length that EXIF states, over the picture's diagonal; None when it does not.
    """

    path: Path
    stored_size: tuple[int, int]
    format: str
    mode: str
    orientation: int
    time_s: float | None = None
    no_data: float | None = None
    bits: int = 8
    equivalent_mm: float | None = None

    def size(self, *, upright: bool = True) -> tuple[int, int]:
        """Width and height: of the picture with its orientation applied, or of the stored pixels."""
        width, height = self.stored_size
        return (height, width) if upright and self.orientation in (5, 6, 7, 8) else (width, height)


def frame_name(file_name: str) -> str:
    """A frame's name from the way a pose file names its image: no folder, no image suffix.

    Only image suffixes are dropped, so `a/10.5` and `./rgb/10.5.jpg` are both `10.5`. Names are in Unicode's composed form (NFC): some
    systems write é as one character, others as e with an accent (NFD), and a file keeps the form it was copied with.
    """
    name = PurePosixPath(file_name.replace("\\", "/")).name
    suffix = PurePosixPath(name).suffix
    return normalize("NFC", name[: -len(suffix)] if suffix.lower() in IMAGE_SUFFIXES else name)


def in_thermal_folder(file_name: str) -> bool:
    """Whether a pose file's image is thermal, by its folders: RGB poses are read, the rig gives the others."""
    folders = PurePosixPath(file_name.replace("\\", "/")).parts[:-1]
    return "thermal" in folders and "rgb" not in folders


def list_images(folder: Path) -> dict[str, Path]:
    """Image files of a folder by frame name, in name order; hidden files and other suffixes are passed over.

    Raises:
        RtgsError: the folder is missing, two files share a stem, or a name is not UTF-8.
    """
    if not folder.is_dir():
        raise RtgsError(f"{folder}: no such folder. A capture holds rgb/, thermal/ and rig.json.")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in IMAGE_SUFFIXES or path.name.startswith("."):
            continue
        name = frame_name(path.name)
        if any("\ud800" <= c <= "\udfff" for c in path.name):  # how Python keeps bytes that are not UTF-8
            raise RtgsError(f"{folder}: a file is named {path.name!a}, which is not UTF-8 text. Rename it.")
        if name in files:
            raise RtgsError(
                f"{folder}: {files[name].name} and {path.name} share the stem {name!r}, and a stem names one instant. Remove one."
            )
        files[name] = path
    return dict(sorted(files.items()))


def read_header(path: Path) -> ImageHeader:
    """Read size, mode and orientation without decoding pixels.

    Raises:
        RtgsError: the file isn't a readable image.
    """
    with opened(path) as image:
        bits = _bits(image)  # before EXIF is asked for: Pillow decodes a PNG for it, and then forgets
        exif = image.getexif()
        time_s, equivalent_mm, no_data = _time_s(exif), _equivalent_mm(exif), _no_data(image)
        kind = image.format or "", image.mode, _orientation(image)
        return ImageHeader(path, _stored_size(image), *kind, time_s, no_data, bits, equivalent_mm)


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """The image, before its pixels are decoded.

    Raises:
        RtgsError: the file is no image that is read, is too large, or is damaged.

    Pillow gets an open file and not a path: from a path it maps an uncompressed TIFF into memory, and it then uses the upright size
    for pixels that are stored sideways.
    """
    try:
        with path.open("rb") as file, _image_in(file) as image:
            if isinstance(image, JpegImageFile) and image.width * image.height > MOST_JPEG_PIXELS:
                raise _too_large(path, MOST_JPEG_PIXELS)
            yield image
    except Image.DecompressionBombError as error:
        raise _too_large(
            path, 2 * (Image.MAX_IMAGE_PIXELS or 0), "; or save them as JPEG, which is decoded at a fraction of its size"
        ) from error
    except RtgsError:
        raise
    except Exception as error:  # besides its own errors, Pillow raises whatever its arithmetic with a damaged tag does
        raise _unreadable(path, error) from error


def _image_in(file: BinaryIO) -> Image.Image:
    """JPEGs are opened without `Image.open`, which refuses large ones. They need no memory before they are decoded."""
    magic = file.read(len(_JPEG_MAGIC))
    file.seek(0)
    return JpegImageFile(file) if magic == _JPEG_MAGIC else Image.open(file, formats=IMAGE_FORMATS)


def _too_large(path: Path, most: int, otherwise: str = "") -> RtgsError:
    return RtgsError(
        f"{path}: has more than {most / 1e6:.0f} megapixels. Reduce all photographs of this camera, and its values in rig.json with "
        f"them{otherwise}."
    )


def _stored_size(image: Image.Image) -> tuple[int, int]:
    """Width and height in the file. Pillow's own size is upright for TIFF, and as stored for the other formats."""
    if not isinstance(image, TiffImageFile):
        return image.size
    return int(image.tag_v2[_TIFF_WIDTH]), int(image.tag_v2[_TIFF_HEIGHT])  # the tags may be of any type


def _bits(image: Image.Image) -> int:
    if isinstance(image, TiffImageFile):
        return min(image.tag_v2.get(_TIFF_BITS, (1,)))
    if isinstance(image, PngImageFile) and image.tile:
        return {"1": 1, "L;2": 2, "L;4": 4}.get(str(image.tile[0][3]), 8)
    return 8


def _no_data(image: Image.Image) -> float | None:
    text = image.tag_v2.get(_GDAL_NODATA) if isinstance(image, TiffImageFile) else None
    try:
        return float(text.strip(" \0")) if isinstance(text, str) else None
    except ValueError:
        return None


def _orientation(image: Image.Image) -> int:
    tag = image.getexif().get(_ORIENTATION)
    return tag if isinstance(tag, int) and tag in _STORED_FROM_UPRIGHT else 1


def _time_s(exif: Image.Exif) -> float | None:
    """`DateTimeOriginal` with its fraction of a second, or `DateTime`."""
    try:
        original = exif.get_ifd(_EXIF_IFD)
        text = str(original.get(_DATE_TIME_ORIGINAL) or exif.get(_DATE_TIME) or "").strip(" \0")
        subseconds = str(original.get(_SUBSECONDS_ORIGINAL) or "").strip(" \0") if _DATE_TIME_ORIGINAL in original else ""
        whole = datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=timezone.utc).timestamp()
        return whole + (float(f"0.{subseconds}") if subseconds.isdecimal() else 0.0)
    except (OSError, SyntaxError, ValueError, TypeError, struct.error):  # a damaged entry: the image is good without it
        return None


def _equivalent_mm(exif: Image.Exif) -> float | None:
    try:
        value = float(exif.get_ifd(_EXIF_IFD).get(_FOCAL_LENGTH_35MM) or 0)
    except (
        OSError,
        SyntaxError,
        ValueError,
        TypeError,
        ZeroDivisionError,
        struct.error,
    ):  # damaged: the image is good without it
        return None
    return value if 0 < value < 1e5 else None


def reduction_for(header: ImageHeader, size: tuple[int, int]) -> int:
    """How many times smaller a photograph is decoded where an image of `size` = (width, height) will be made of it: 8, 4, 2 or 1.

    Only JPEGs can be decoded smaller, in a fraction of the time and memory. Both sides keep `SPARE` times the wanted pixels, and are
    divided exactly, so that intrinsics are too.

    Args:
        size: in the orientation that the image will have, or a quarter turn from it.

    Raises:
        RtgsError: more than 179 megapixels would be decoded.
    """
    sides, wanted, most = sorted(header.stored_size), sorted(size), 2 * (Image.MAX_IMAGE_PIXELS or 0)
    fitting = [
        factor
        for factor in (*REDUCTIONS, 1)
        if all(side % factor == 0 and side // factor >= SPARE * want for side, want in zip(sides, wanted, strict=True))
    ]
    reduction = fitting[0] if fitting and header.format == "JPEG" else 1
    if sides[0] * sides[1] > most * reduction**2:
        raise _too_large(header.path, most, f", so that both sides can be divided by {REDUCTIONS[0]}")
    return reduction


def read_rgb(path: Path, *, upright: bool = True, reduction: int = 1) -> NDArray[np.float32]:
    """Decode a colour image: `[H, W, 3]` float32 in [0, 1]; grey images get three equal channels.

    Args:
        path: the file.
        upright: whether the file's orientation is applied; otherwise the pixels are as stored.
        reduction: how many times smaller a JPEG is decoded (see `reduction_for`).

    Raises:
        RtgsError: the file is unreadable or truncated.
    """
    image = _decode(path, upright=upright, reduction=reduction)
    _check_rgb_mode(path, image.mode)
    if image.mode.startswith("I"):  # 16-bit grey, under the several names Pillow has for it
        grey = np.asarray(image, dtype=np.float32) / 65535.0
        return np.repeat(grey[..., None], 3, axis=2)
    values = np.asarray(image.convert("RGB"), dtype=np.float32)
    values /= 255.0
    return values


def check_rgb(path: Path) -> None:
    """Refuse what `read_rgb` would refuse, in a fraction of its time and memory.

    The whole file is read, so a truncated one is found. A JPEG is decoded at an eighth of its size.

    Raises:
        RtgsError: as `read_rgb`.
    """
    with opened(path) as image:
        _draft(image, 8)
        image.load()
        mode = image.mode
    _check_rgb_mode(path, mode)


def _draft(image: Image.Image, reduction: int) -> None:
    """Have a JPEG decoded so many times smaller. Nothing happens for other formats."""
    if reduction > 1:
        image.draft(None, (max(1, image.width // reduction), max(1, image.height // reduction)))


def _check_rgb_mode(path: Path, mode: str) -> None:
    if mode == "F":
        raise RtgsError(
            f"{path}: is a floating-point image, where RGB in 8 or 16 bits is expected. Are rgb/ and thermal/ swapped?"
        )


def read_counts(path: Path) -> NDArray[np.generic]:
    """Decode a thermal image upright: `[h, w]`, as stored (8 or 16 bit, 32-bit integer or float).

    The numbers in the file are the counts, also where a TIFF says that its smallest number is shown white.

    Raises:
        RtgsError: unreadable or truncated, in colour, or not finite.
    """
    check_counts_mode(read_header(path))
    counts = _stored_numbers(path, np.asarray(_decode(path)))
    if not np.isfinite(counts).all():
        raise RtgsError(f"{path}: holds NaN or infinite pixels. Export the thermal image again, or remove this pair.")
    return counts


def _stored_numbers(path: Path, counts: NDArray[Any]) -> NDArray[Any]:
    """What the file holds, where Pillow's pixels are something else."""
    with opened(path) as image:
        if not isinstance(image, TiffImageFile):
            return counts
        bits, photometric = image.tag_v2.get(_TIFF_BITS), image.tag_v2.get(_TIFF_PHOTOMETRIC)
        sample_format = image.tag_v2.get(_TIFF_SAMPLE_FORMAT, (_UNSIGNED,))
        unsigned, signed = sample_format == (_UNSIGNED,), sample_format == (_SIGNED,)
    if image.mode == "L" and bits == (8,) and photometric == _MIN_IS_WHITE:
        return 255 - counts  # Pillow inverts these, and no deeper ones
    if image.mode == "L" and signed:
        return counts.view(np.int8)
    if image.mode == "I" and unsigned:
        return counts.view(np.uint32)  # Pillow has no unsigned 32-bit pixels: large ones come out negative
    return counts


def check_counts_mode(header: ImageHeader) -> None:
    """Refuse a thermal image in colour, or in black and white.

    Raises:
        RtgsError: the pixel format isn't one number a pixel, or the numbers have fewer than eight bits.
    """
    if header.bits < 8:  # Pillow would stretch them to eight, and counts mean something
        raise RtgsError(
            f"{header.path}: has {header.bits} bits a pixel, so it shows no more than {2**header.bits} temperatures. Export the "
            "radiometric data as single-channel 16-bit TIFF or PNG."
        )
    if header.mode not in _COUNT_MODES:
        raise RtgsError(
            f"{header.path}: is a colour image ({header.mode}), a picture of temperatures that cannot be turned back into them. "
            "Export the radiometric data as single-channel 16-bit TIFF or PNG."
        )


def write_upright(path: Path, target: Path) -> None:
    """Write a copy with the file's orientation applied to the pixels (lossless where `target` is PNG)."""
    _decode(path).save(target)


def _decode(path: Path, *, upright: bool = True, reduction: int = 1) -> Image.Image:
    with opened(path) as image:
        back = _STORED_FROM_UPRIGHT.get(_orientation(image))
        _draft(image, reduction)
        image.load()
        if upright or back is None:
            return ImageOps.exif_transpose(image)
        # Pillow has turned the pixels of a TIFF already while loading them.
        return image.transpose(back) if isinstance(image, TiffImageFile) else image.copy()


def _unreadable(path: Path, error: Exception) -> RtgsError:
    # Pillow's own message often repeats the path; it is cut to one line that names the cause.
    unknown = isinstance(error, SyntaxError) or "cannot identify" in str(error)
    cause = _unidentified(path) if unknown else (str(error) or type(error).__name__)[:200]
    return RtgsError(f"{path}: cannot be read ({cause}). Copy or export the file again, or remove this pair.")


def _unidentified(path: Path) -> str:
    """Why Pillow does not know what a file is: it may be a TIFF of numbers that it has no pixels for."""
    with suppress(Exception), path.open("rb") as file:
        tags = ImageFileDirectory_v2(file.read(8))
        file.seek(tags.next)
        tags.load(file)
        bits, form = tags[_TIFF_BITS][0], tags.get(_TIFF_SAMPLE_FORMAT, (_UNSIGNED,))[0]
        kind = {_UNSIGNED: "unsigned whole", _SIGNED: "whole", _FLOAT: "floating-point"}[form]
        return f"a TIFF of {kind} numbers of {bits} bits; 16-bit whole and 32-bit floating-point numbers are read"
    return "not an image that can be identified"
