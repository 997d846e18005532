"""Orthophotos: the model seen along parallel rays, from above or square to an upright plane, in °C and in colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.images.pictures import palette, save_png, to_picture, with_colour_bar
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.geotiff import RasterPlace, write_geotiff
from rtgs.io.exports.subject import Subject
from rtgs.io.exports.surface import SurfacePoints, pixel_size, surface_points
from rtgs.maths.geometry import SE3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import render

_AWAY = 2000.0  # distance of the camera in half diagonals of the picture: rays are parallel to 1/2000
_COVERED = 0.5
_SIDE, _MOST_SIDE = 2000, 20_000  # pixels of the longer side: unasked, and at most
_TRIALS = 500  # planes through three points
_IN_FRONT = 0.1  # of a facade's width: what stands further out hides it and is left out


@dataclass(frozen=True, eq=False)
class Sheet:
    """The plane of an orthophoto, in the frame with z up, metres.

    Attributes:
        right, up, normal: unit vectors; the normal points to the viewer.
        low, high: `[2]`, limits along right and up.
        level: of the plane along the normal; None: everything is shown.
    """

    right: NDArray[np.float64]
    up: NDArray[np.float64]
    normal: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    level: float | None = None


def write_orthophoto(folder: Path, subject: Subject, frame: FileFrame) -> list[Path]:
    """Write `temperature.tif` (float32, NaN where nothing is seen), `rgb.tif` and `temperature.png`.

    Raises:
        RtgsError: "up" is not known and no normal is given, no upright plane is found, or the picture is too large.
    """
    settings = subject.settings
    if frame.axes is None and settings.normal is None:
        raise RtgsError(
            "orthophoto: which way is up is not known (--frame sfm, or cameras that hardly turn). Give --normal X Y Z."
        )
    if settings.pixel_m is not None and frame.per_metre is None:
        raise RtgsError("--pixel-m is a length in metres, and nothing tells metres. Leave it out.")
    coarse = pixel_size(subject)
    points = surface_points(subject, 4 * coarse)
    sheet = _sheet(subject, frame, points, 4 * coarse * frame.from_world.factor)
    size = sheet.high - sheet.low
    pixel = settings.pixel_m or max(coarse * frame.from_world.factor, float(size.max()) / _SIDE)
    width, height = (int(n) for n in np.maximum(1, np.ceil(size / pixel)))
    if max(width, height) > _MOST_SIDE:
        raise RtgsError(f"--pixel-m {pixel:g}: the orthophoto would have {width} × {height} pixels; choose larger ones.")
    rgb, thermal = _in_front(subject, frame, sheet)
    camera, pose = _far_camera(sheet, frame, width, height, pixel)
    with torch.no_grad():
        view = render(rgb.gaussians, camera, pose, settings=rgb.settings)
    covered = view.alpha.numpy() >= _COVERED
    temperature = np.where(covered, thermal.render(camera, pose), np.nan).astype(np.float32)
    picture = to_picture(view.over(rgb.background).numpy())
    picture = np.concatenate([picture, (255 * covered[..., None]).astype(np.uint8)], axis=2)
    place = RasterPlace(
        float(sheet.low[0]), float(sheet.low[1] + height * pixel), pixel, "local metres" if frame.unit == "m" else frame.unit
    )
    if frame.place is not None and sheet.normal[2] > 0.9999:
        latitude, longitude = frame.place.latitude_deg, frame.place.longitude_deg
        place = replace(place, frame="metres east and north", latitude_deg=latitude, longitude_deg=longitude)
    folder.mkdir(parents=True, exist_ok=True)
    span = thermal.range
    write_geotiff(folder / "temperature.tif", temperature, place)
    write_geotiff(folder / "rgb.tif", picture, place)
    shown = with_colour_bar(palette(temperature, span.lo, span.hi), span.lo, span.hi, thermal.unit)
    save_png(folder / "temperature.png", shown)
    return [folder / name for name in ("temperature.tif", "rgb.tif", "temperature.png")]


def _far_camera(sheet: Sheet, frame: FileFrame, width: int, height: int, pixel: float) -> tuple[Camera, SE3]:
    """A camera so far away that its rays are parallel, and its `camera_from_world`."""
    away = _AWAY * float(np.hypot(width, height)) * pixel / 2
    middle = sheet.low + np.array([width, height]) * pixel / 2
    level = sheet.level if sheet.level is not None else 0.0
    eye = middle[0] * sheet.right + middle[1] * sheet.up + (level + away) * sheet.normal
    axes = np.stack([sheet.right, -sheet.up, -sheet.normal], axis=1)  # file_from_camera
    world_from_camera = frame.from_world.carry_inverse(SE3(axes, eye))
    focal = away / pixel
    return Camera("PINHOLE", width, height, focal, focal, width / 2, height / 2), world_from_camera.inverse()


def _sheet(subject: Subject, frame: FileFrame, points: SurfacePoints, tolerance: float) -> Sheet:
    xyz = frame.of(points.xyz)
    settings = subject.settings
    if settings.normal is not None:
        normal = np.array(settings.normal)
        if not np.linalg.norm(normal) > 0:
            raise RtgsError("--normal 0 0 0 is no direction.")
        return _around(xyz, normal / np.linalg.norm(normal), None)
    if settings.plane == "top":
        return _around(xyz, np.array([0.0, 0.0, 1.0]), None)
    normal, level = _largest_upright_plane(xyz, tolerance)
    eyes = frame.of(np.stack([pose.translation for pose in subject.scene.world_from_rgb.values()]))
    if np.median(eyes @ normal) < level:
        normal, level = -normal, -level
    return _around(xyz[np.abs(xyz @ normal - level) < tolerance], normal, level)


def _around(xyz: NDArray[np.float64], normal: NDArray[np.float64], level: float | None) -> Sheet:
    """The sheet that holds nearly all points. Its "up" is z, or y where one looks along z."""
    vertical = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    up = vertical - normal * (vertical @ normal)
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    flat = np.stack([xyz @ right, xyz @ up], axis=1)
    low, high = np.percentile(flat, (0.2, 99.8), axis=0)
    margin = 0.01 * (high - low)
    return Sheet(right, up, normal, low - margin, high + margin, level)


def _largest_upright_plane(xyz: NDArray[np.float64], tolerance: float) -> tuple[NDArray[np.float64], float]:
    """Normal (horizontal) and level of the upright plane with most points: a vertical line through two of them, tried at random."""
    rng = np.random.default_rng(0)
    best: tuple[int, NDArray[np.float64], float] = (0, np.zeros(3), 0.0)
    for a, b in rng.integers(len(xyz), size=(_TRIALS, 2)):
        along = xyz[b, :2] - xyz[a, :2]
        length = float(np.hypot(*along))
        if length < 4 * tolerance:
            continue
        normal = np.array([along[1], -along[0], 0.0]) / length
        level = float(xyz[a] @ normal)
        count = int(np.count_nonzero(np.abs(xyz @ normal - level) < tolerance))
        if count > best[0]:
            best = (count, normal, level)
    if best[0] < 3:
        raise RtgsError("--plane facade: no upright plane was found. Give --normal X Y Z.")
    return best[1], best[2]


def _in_front(subject: Subject, frame: FileFrame, sheet: Sheet) -> tuple[RgbModel, ThermalModel]:
    """The models without what stands in front of a facade."""
    if sheet.level is None:
        return subject.rgb, subject.thermal
    limit = sheet.level + _IN_FRONT * float(sheet.high[0] - sheet.low[0])

    def kept(gaussians: Gaussians) -> Gaussians:
        near = torch.as_tensor(frame.of(gaussians.means.double().numpy()) @ sheet.normal < limit)
        return Gaussians(**{name: tensor[near] for name, tensor in gaussians.tensors().items()})

    return (
        replace(subject.rgb, gaussians=kept(subject.rgb.gaussians)),
        replace(subject.thermal, gaussians=kept(subject.thermal.gaussians)),
    )
