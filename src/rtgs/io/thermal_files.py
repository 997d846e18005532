"""Thermal files: counts to values, pixels that hold no temperature, and frames that cannot be right."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.io.image_files import ImageHeader, read_counts, read_header
from rtgs.records.radiometry import ZERO_CELSIUS_K, PlanckRadiometry, Radiometry, RelativeCounts

COLDEST_C, HOTTEST_C = -100.0, 3000.0  # what a thermal camera can measure, with a margin
_MARKS = (-9999.0, -32768.0)  # what programs write where they have no value
_HUGE = 1e30  # and the largest numbers of float32
_MAX_NO_DATA = 0.2  # more pixels than this without a temperature: the file or its unit is wrong
_FAR = 10.0  # a frame's level may lie this many ranges of a usual frame outside of that range
_LEAST_RANGE_C, _LEAST_RANGE_OF_LEVEL = 5.0, 0.05  # a scene of one temperature has hardly any range


@dataclass(frozen=True, eq=False)
class ThermalFile:
    """What the check of one file found.

    Attributes:
        path: the file.
        digest: of its counts; two files of one digest hold the same image.
        low, level, high: the 1, 50 and 99 percentile of its values, in the radiometry's unit.
        no_data: `[h, w]` bool, pixels that hold no temperature; None where there are none.
    """

    path: Path
    digest: bytes
    low: float
    level: float
    high: float
    no_data: NDArray[np.bool_] | None


def thermal_values(path: Path, radiometry: Radiometry) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """The values of a thermal file, upright.

    A pixel holds no temperature where its count is marked so (−9999, −32768, the largest float32 of either sign, or the number in the
    tag GDAL_NODATA), or where it is below −100 °C or above 3000 °C. It gets the value of the nearest pixel that has one, so that
    filters may cross it.

    Returns:
        `[h, w]` in the radiometry's unit, and which pixels hold no temperature; None instead where all hold one.

    Raises:
        RtgsError: the file cannot be read; a fifth of its pixels or more hold no temperature; the signal is below what the object
            parameters allow.
    """
    return _values(path, read_counts(path), radiometry)


def check_thermal_file(path: Path, radiometry: Radiometry) -> ThermalFile:
    """Read a thermal file once, to check it and to compare it with the others.

    Raises:
        RtgsError: as `thermal_values`, or all its pixels have one value.
    """
    counts = read_counts(path)
    values, no_data = _values(path, counts, radiometry)
    if values.min() == values.max():
        raise RtgsError(
            f"{path}: all its pixels have the value {values.flat[0]:g}, as when the shutter is closed. Remove this pair."
        )
    low, level, high = (float(x) for x in np.percentile(values, (1, 50, 99)))
    return ThermalFile(path, hashlib.sha256(counts.tobytes()).digest(), low, level, high, no_data)


def check_formats(headers: Sequence[ImageHeader], radiometry: Radiometry) -> None:
    """Refuse formats that cannot hold the counts that `radiometry` needs.

    Raises:
        RtgsError: a JPEG where counts mean °C; 8-bit files among others.
    """
    for header in headers:
        if header.format in ("JPEG", "MPO") and not isinstance(radiometry, RelativeCounts):
            raise RtgsError(
                f"{header.path}: is a JPEG, whose compression changes counts, and rig.json gives counts a temperature. Export the "
                "radiometric data as single-channel 16-bit TIFF or PNG; rtgs import reads radiometric JPEGs."
            )
    eight = [header.path for header in headers if header.mode == "L"]
    if eight and len(eight) < len(headers):
        deeper = next(header.path for header in headers if header.mode != "L")
        raise RtgsError(
            f"{_named(eight)}: {'has' if len(eight) == 1 else 'have'} 8 bits a pixel and {deeper.name} has more. One scale of counts is "
            "expected. Export all thermal images in one format, or remove these pairs."
        )


def check_together(files: Sequence[ThermalFile], rgb: Sequence[Path], radiometry: Radiometry) -> None:
    """Refuse frames that cannot be right beside the others.

    Args:
        files: the checked thermal files.
        rgb: the RGB file of each.
        radiometry: the unit of their values.

    Raises:
        RtgsError: a frozen frame, which repeats another one's image while the RGB image has changed; a frame whose level is far from
            all others'.
    """
    first: dict[bytes, int] = {}
    frozen = []
    for i, file in enumerate(files):
        before = first.setdefault(file.digest, i)
        if before != i and rgb[before].read_bytes() != rgb[i].read_bytes():
            frozen.append((file.path, files[before].path))
    if frozen:
        raise RtgsError(
            f"{_named([path for path, _ in frozen])}: the same thermal image as {frozen[0][1].name} to the last bit, and the RGB image "
            "has changed. The thermal camera stood still. Remove these pairs."
        )
    low, high = (float(np.median([getattr(file, end) for file in files])) for end in ("low", "high"))
    least = _LEAST_RANGE_OF_LEVEL * max(abs(low), abs(high)) if isinstance(radiometry, RelativeCounts) else _LEAST_RANGE_C
    margin = _FAR * max(high - low, least)
    for file in files:
        if not low - margin <= file.level <= high + margin:
            raise RtgsError(
                f"{file.path}: its median is {file.level:.1f} {radiometry.unit}, and a usual frame of this capture lies between {low:.1f} "
                f"and {high:.1f}. Is it in another unit? Export it again, or remove this pair."
            )


def common_no_data(files: Sequence[ThermalFile], warnings: list[str]) -> NDArray[np.bool_] | None:
    """`[h, w]` bool, the pixels that hold no temperature in at least one frame, with a warning that counts them; None without any.

    Raises:
        RtgsError: these are a fifth of the image or more.
    """
    holes = {file.path: file.no_data for file in files if file.no_data is not None}
    if not holes:
        return None
    union = np.logical_or.reduce(list(holes.values()))
    if union.mean() >= _MAX_NO_DATA:
        worst = max(holes, key=lambda path: holes[path].sum())
        raise RtgsError(
            f"{worst}: together with {len(holes) - 1} other thermal images it leaves {union.mean():.0%} of the pixels without a "
            "temperature in some frame. Remove the pairs with the most such pixels."
        )
    warnings.append(
        f"{sum(int(hole.sum()) for hole in holes.values())} pixels in {len(holes)} of the {len(files)} images in thermal/ hold no "
        f"temperature (no-data marks, or below {COLDEST_C:g} °C or above {HOTTEST_C:g} °C). These places, {union.mean():.2%} of the "
        "image, are left out in all frames."
    )
    return union


def _values(
    path: Path, counts: NDArray[np.generic], radiometry: Radiometry
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    no_data = _marked(path, counts)
    values = radiometry.values(counts)
    if isinstance(radiometry, PlanckRadiometry):
        cold = (values <= -ZERO_CELSIUS_K) & ~no_data
        if cold.any():
            raise RtgsError(
                f"{path}: under thermal.planck and thermal.object of rig.json, {np.mean(cold):.1%} of its pixels give less than what is "
                "reflected and emitted on the way. Is object.emissivity too low, or object.reflected_c too high?"
            )
    if not isinstance(radiometry, RelativeCounts):
        no_data |= ~((values >= COLDEST_C) & (values <= HOTTEST_C))
    if not no_data.any():
        return values, None
    if no_data.mean() >= _MAX_NO_DATA:
        raise RtgsError(
            f"{path}: {no_data.mean():.0%} of its pixels hold no temperature (no-data marks, or below {COLDEST_C:g} °C or above "
            f"{HOTTEST_C:g} °C). Does rig.json give the right unit? Export the file again, or remove this pair."
        )
    return _filled(values, no_data), no_data


def _marked(path: Path, counts: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Counts that say themselves that they are none."""
    marked = np.zeros(counts.shape, dtype=bool)
    if counts.dtype.kind in "if":
        marked |= np.isin(counts, _MARKS)
    if counts.dtype.kind == "f":
        marked |= np.abs(counts.astype(np.float64)) >= _HUGE
    mark = read_header(path).no_data
    return marked if mark is None else marked | (counts.astype(np.float64) == mark)


def _filled(values: NDArray[np.float32], no_data: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The values with the nearest valid one wherever there is none."""
    _, labels = cv2.distanceTransformWithLabels(no_data.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    nearest = np.empty(int(labels.max()) + 1, dtype=np.float32)
    nearest[labels[~no_data]] = values[~no_data]
    return np.where(no_data, nearest[labels], values)


def _named(paths: Sequence[Path]) -> str:
    more = f" and {len(paths) - 5} more" if len(paths) > 5 else ""
    return ", ".join([str(paths[0]), *(path.name for path in paths[1:5])]) + more
