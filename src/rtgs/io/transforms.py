"""`transforms.json`, nerfstudio's form: OpenGL camera-to-world poses and one set of intrinsics.

OpenGL's camera looks along −z with y up; it is turned to OpenCV's axes here and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.io.image_files import frame_name, in_thermal_folder
from rtgs.io.rig import camera_from_json, finite_number, read_json_object, rigid_from_json
from rtgs.maths.geometry import SE3
from rtgs.records.camera import DISTORTION_OF_MODEL, Camera

_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x", "camera_angle_y")
_OF_A_CAMERA = (*_INTRINSICS, "w", "h", "camera_model", "is_fisheye")
# Keys of nerfstudio and instant-ngp that change what a pixel means, and what to do. Zero and false switch them off.
_REFUSED = {
    "mask_path": "Masks are not supported: remove the key to use whole images, or paint over what may not be seen",
    "distortion_params": "Give the lens as k1, k2, k3, k4, p1 and p2",
    "rolling_shutter": "Rolling shutters are not supported: remove the key if the error is small",
    "fisheye_crop_radius": "Crops of the image circle are not supported: undistort the images",
    "latlong": "Panoramas are not supported",
    "equirectangular": "Panoramas are not supported",
    **dict.fromkeys(("k5", "k6", "s1", "s2", "s3", "s4"), "No camera model here has this term: calibrate with it fixed at 0"),
    **dict.fromkeys((f"ftheta_p{i}" for i in range(5)), "F-theta lenses are not supported: undistort the images"),
}
_OPENGL_FROM_OPENCV = SE3(np.diag([1.0, -1.0, -1.0]), np.zeros(3))


def read_transforms(path: Path, image_size: tuple[int, int]) -> tuple[Camera | None, dict[str, SE3]]:
    """Read RGB poses and the RGB camera.

    Args:
        path: the file.
        image_size: width and height of the RGB images, for files that give only `camera_angle_x`.

    Returns:
        The camera with its lens, or None when the file gives no intrinsics, and `world_from_rgb` by frame name (OpenCV axes, the
        file's own unit). Frames in a folder `thermal` are passed over.

    Raises:
        RtgsError: a frame without path or pose, a pose that isn't rigid and finite, two poses for one frame, several cameras, or a
            key that changes what a pixel means and is not supported.
    """
    data = read_json_object(path, missing="It holds the RGB poses.")
    frames = data.get("frames")
    if not isinstance(frames, list) or not frames:
        raise RtgsError(f"{path}: frames is missing or empty; it lists file_path and transform_matrix of each RGB image.")
    _refuse_unsupported(path, "", data)
    world_from_rgb: dict[str, SE3] = {}
    shared: dict[str, Any] = {}
    for i, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise RtgsError(f"{path}: frames[{i}].file_path is missing.")
        if in_thermal_folder(frame["file_path"]):
            continue
        name = frame_name(frame["file_path"])
        if name in world_from_rgb:
            raise RtgsError(f"{path}: frames[{i}].file_path names {name!r:.100} a second time. Keep one pose for each image.")
        if "transform_matrix" not in frame:
            raise RtgsError(f"{path}: frames[{i}].transform_matrix is missing ({name}). Remove the frame if it has no pose.")
        matrix = frame["transform_matrix"]
        if isinstance(matrix, list) and len(matrix) == 3:
            matrix = [*matrix, [0.0, 0.0, 0.0, 1.0]]
        world_from_opengl = rigid_from_json(path, f"frames[{i}].transform_matrix ({name})", matrix)
        world_from_rgb[name] = world_from_opengl @ _OPENGL_FROM_OPENCV
        _refuse_unsupported(path, f"frames[{i}].", frame)
        for key in _OF_A_CAMERA:
            if key in frame and shared.setdefault(key, frame[key]) != frame[key]:
                raise RtgsError(f"{path}: {key} differs between frames. One RGB camera with one set of intrinsics is expected.")
    for key, value in shared.items():
        if data.get(key, value) != value:
            raise RtgsError(
                f"{path}: {key} of a frame is {value!r:.100}, and {key} of the whole file is {data[key]!r:.100}. One RGB camera with one "
                "set of intrinsics is expected."
            )
    return _camera(path, {**shared, **{k: v for k, v in data.items() if k != "frames"}}, image_size), world_from_rgb


def _refuse_unsupported(path: Path, where: str, data: Mapping[str, Any]) -> None:
    for key, remedy in _REFUSED.items():
        value = data.get(key)
        if value and not (isinstance(value, list) and all(number == 0 for number in value)):
            raise RtgsError(f"{path}: {where}{key} is given, and it cannot be heeded. {remedy}.")


def write_transforms(path: Path, camera: Camera, world_from_rgb: Mapping[str, SE3], file_paths: Mapping[str, str]) -> None:
    """Write poses as nerfstudio reads them.

    Args:
        path: target.
        camera: RGB camera, with or without its lens.
        world_from_rgb: by frame name, OpenCV axes.
        file_paths: each frame's image, relative to the folder of `path`.
    """
    terms = {name: getattr(camera, name) for name in DISTORTION_OF_MODEL[camera.model]}
    head = {"camera_model": camera.model, "w": camera.width, "h": camera.height}
    head |= {"fl_x": camera.fl_x, "fl_y": camera.fl_y, "cx": camera.cx, "cy": camera.cy, **terms}
    frames = [
        {"file_path": file_paths[name], "transform_matrix": (pose @ _OPENGL_FROM_OPENCV).matrix().tolist()}
        for name, pose in sorted(world_from_rgb.items())
    ]
    write_json(path, {**head, "frames": frames})


def _camera(path: Path, data: Mapping[str, Any], image_size: tuple[int, int]) -> Camera | None:
    given = {key: finite_number(path, key, data, key) for key in _INTRINSICS if key in data}
    width = int(finite_number(path, "w", data, "w")) if "w" in data else image_size[0]
    height = int(finite_number(path, "h", data, "h")) if "h" in data else image_size[1]
    fl_x = given["fl_x"] if "fl_x" in given else _focal(path, given, "camera_angle_x", width)
    if fl_x is None:
        return None
    fl_y = given["fl_y"] if "fl_y" in given else _focal(path, given, "camera_angle_y", height)
    fl_y = fl_x if fl_y is None else fl_y
    lens = {key: value for key, value in given.items() if key[0] in "kp" and value != 0.0}
    perspective = "OPENCV" if lens else "PINHOLE"
    model = data.get("camera_model") or ("OPENCV_FISHEYE" if data.get("is_fisheye") else perspective)
    if model == "PERSPECTIVE":  # nerfstudio's own name, with OPENCV's terms
        model = perspective
    if data.get("is_fisheye") and model != "OPENCV_FISHEYE":
        raise RtgsError(f"{path}: is_fisheye is given, and camera_model is {model!r:.100}. Keep the one that is right.")
    terms = {name: given.get(name, 0.0) for name in DISTORTION_OF_MODEL.get(str(model), ())}  # the format leaves zeros out
    fields = {**lens, **terms, "model": model, "width": width, "height": height, "fl_x": fl_x, "fl_y": fl_y}
    fields |= {"cx": given.get("cx", width / 2), "cy": given.get("cy", height / 2)}
    return camera_from_json(path, "camera", fields, [])


def _focal(path: Path, given: Mapping[str, float], key: str, size: int) -> float | None:
    if key not in given:
        return None
    if not 0 < given[key] < math.pi:
        raise RtgsError(f"{path}: {key} is {given[key]:g}; it is the field of view in radians, between 0 and π.")
    return size / 2 / math.tan(given[key] / 2)
