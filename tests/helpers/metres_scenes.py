"""A scene with known metres, and readings of it: positions, distances, boards."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.maths.geometry import SE3, Sim3, look_at, rotation_from_axis_angle
from rtgs.maths.wgs84 import places_from_enu
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints
from rtgs.records.radiometry import CELSIUS
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

CAMERA = Camera("PINHOLE", 400, 300, 350.0, 350.0, 200.0, 150.0)
ORIGIN = (46.067, 11.121, 194.0)
Array = NDArray[np.float64]


def flight(seed: int, frames: int, radius_m: float, sfm_per_metre: float) -> tuple[Scene, Sim3]:
    """A scene in SfM units, seen on a way around its middle, and the similarity `enu_from_given` that leads to metres."""
    random = np.random.default_rng(seed)
    turn = rotation_from_axis_angle(random.normal(size=3))
    enu_from_given = Sim3(1 / sfm_per_metre, turn, random.normal(size=3) * radius_m)
    angles = np.linspace(0, 1.7 * math.pi, frames) + random.uniform(0, 6)
    eyes = np.stack([np.cos(angles), np.sin(angles), 0.4 + 0.2 * np.sin(3 * angles)], axis=1) * radius_m
    points = random.uniform(-0.4, 0.4, (300, 3)) * radius_m
    carry = enu_from_given.inverse()
    poses = {f"{i:04d}": _carried(carry, look_at(eye, [0.0, 0.0, 0.0])) for i, eye in enumerate(eyes)}
    return scene_of(Path("capture"), poses, carry.apply(points)), enu_from_given


def _carried(given_from_enu: Sim3, enu_from_camera: SE3) -> SE3:
    return SE3(given_from_enu.rotation @ enu_from_camera.rotation, given_from_enu.apply(enu_from_camera.translation))


def scene_of(root: Path, poses: dict[str, SE3], points: Array, camera: Camera = CAMERA, baseline_m: float = 0.2) -> Scene:
    """A scene without images."""
    rig = Rig(camera, camera, SE3(np.eye(3), np.array([baseline_m, 0.0, 0.0])))
    blank = np.zeros((1, 1, 3), np.float32)
    frames = tuple(Frame(name, blank, blank[..., 0]) for name in poses)
    mask = np.ones((1, 1), dtype=bool)
    capture = Capture(root, rig, rig, frames, mask, mask, CELSIUS, None)
    return Scene(capture, poses, SparsePoints(points, np.zeros((len(points), 3), np.float32)), {}).recentred()


def centres(scene: Scene) -> Array:
    """`[N, 3]`, of the cameras in the given frame."""
    return np.stack([pose.translation for pose in scene.as_given().world_from_rgb.values()])


def places(enu: Array) -> Array:
    """Latitude, longitude and altitude of metres from `ORIGIN`."""
    return places_from_enu(enu, ORIGIN)


def write_photograph(
    path: Path, *, gps: dict[int, object] | None = None, xmp: str = "", size: tuple[int, int] = (16, 12)
) -> Path:
    """A JPEG with these tags of EXIF's GPS directory, and with this XMP."""
    image, exif = Image.new("RGB", size, (90, 120, 60)), Image.Exif()
    if gps is not None:
        exif[0x8825] = gps
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, exif=exif, xmp=xmp.encode())
    return path


def exif_gps(place: Sequence[float] | Array, error_m: float | None = None) -> dict[int, object]:
    """EXIF's GPS directory of a place, seconds with 5 decimals."""
    tags: dict[int, object] = {}
    for reference, value, name in ((1, place[0], "NS"), (3, place[1], "EW")):
        seconds = round(abs(value) * 3600, 5)
        degrees, minutes = int(seconds // 3600), int(seconds % 3600 // 60)
        tags[reference] = name[bool(value < 0)]
        tags[reference + 1] = (float(degrees), float(minutes), round(seconds - 3600 * degrees - 60 * minutes, 5))
    tags |= {5: b"\x01" if place[2] < 0 else b"\x00", 6: abs(round(place[2], 3))}
    return tags | ({} if error_m is None else {31: error_m})


def dji_xmp(place: Sequence[float] | Array | None = None, std_m: Sequence[float] | Array | None = None, **tags: object) -> str:
    """DJI's XMP: a place, the RTK's standard deviations to the east, north and up, and other tags."""
    values: dict[str, object] = dict(tags)
    if place is not None:
        values |= {
            "GpsLatitude": f"{place[0]:+.10f}",
            "GpsLongitude": f"{place[1]:+.10f}",
            "AbsoluteAltitude": f"{place[2]:+.4f}",
        }
    if std_m is not None:
        values |= {"RtkFlag": 50, "RtkStdLon": std_m[0], "RtkStdLat": std_m[1], "RtkStdHgt": std_m[2], "AltitudeType": "RtkAlt"}
    inside = "\n".join(f'   drone-dji:{name}="{value}"' for name, value in values.items())
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF><rdf:Description\n{inside}/></rdf:RDF></x:xmpmeta>'
