"""COLMAP models: poses that come with a capture (`sparse/0`), and a run's `scene/` folder.

COLMAP stores `camera_from_world`; records here hold `world_from_rgb`, inverted at this border.
"""

from __future__ import annotations

import os
import signal
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from errno import EIO
from pathlib import Path

import numpy as np
import pycolmap

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_json, write_json
from rtgs.io.image_files import frame_name, in_thermal_folder
from rtgs.io.rig import absurd_intrinsics
from rtgs.maths.geometry import SE3, quat_from_rotation, rotation_from_quat
from rtgs.records.camera import DISTORTION_OF_MODEL, Camera
from rtgs.records.capture import Capture, Poses, SparsePoints
from rtgs.records.scene import Scene

RGB_CAMERA_ID, THERMAL_CAMERA_ID, RIG_ID, THERMAL_RIG_ID = 1, 2, 1, 2
_FAILURES = "failures.json"

# Importing pycolmap makes SIGTERM print a stack trace and abort. The handler from before is put back, so that it can end work cleanly.
if threading.current_thread() is threading.main_thread() and (_handler := signal.getsignal(signal.SIGTERM)) is not None:
    signal.signal(signal.SIGTERM, _handler)


@contextmanager
def quiet_colmap() -> Iterator[None]:
    """Silence COLMAP's log, errors included: whoever calls COLMAP raises them as messages of our own."""
    logging = pycolmap.logging
    before = (logging.minloglevel, logging.stderrthreshold, logging.alsologtostderr)
    logging.minloglevel, logging.stderrthreshold, logging.alsologtostderr = 3, 3, False
    try:
        yield
    finally:
        logging.minloglevel, logging.stderrthreshold, logging.alsologtostderr = before


def read_sparse(folder: Path) -> tuple[Camera, Poses]:
    """Read a COLMAP model of the RGB images, binary or text.

    Images in a folder `thermal` are passed over: the rig gives their poses.

    Returns:
        The RGB camera with its lens, and `world_from_rgb` by frame name with the points (those of finite position).

    Raises:
        RtgsError: unreadable, no registered image, several cameras, a camera model that isn't known, a pose that isn't finite.
    """
    model = _read_model(folder)
    file_names = _image_names(folder, model)
    images = [image for i, image in model.images.items() if image.has_pose and not in_thermal_folder(file_names[i])]
    if not images:
        raise RtgsError(f"{folder}: holds no registered RGB image. Remove the folder to run structure from motion instead.")
    cameras = [camera_from_colmap(folder, model.cameras[i]) for i in sorted({image.camera_id for image in images})]
    if any(camera != cameras[0] for camera in cameras):
        raise RtgsError(
            f"{folder}: the RGB images have {len(cameras)} different cameras, and one is expected. Run COLMAP with "
            "--ImageReader.single_camera 1."
        )
    world_from_rgb: dict[str, SE3] = {}
    for image in sorted(images, key=lambda image: file_names[image.image_id]):
        name = frame_name(file_names[image.image_id])
        if name in world_from_rgb:
            raise RtgsError(
                f"{folder}: two images are named {name!r:.100} (without folder and suffix). Keep one pose for each image."
            )
        rgb_from_world = se3_from_rigid3d(image.cam_from_world())
        if not (np.isfinite(rgb_from_world.rotation).all() and np.isfinite(rgb_from_world.translation).all()):
            raise RtgsError(f"{folder}: the pose of image {name} holds NaN or infinity. Remove the image from the model.")
        world_from_rgb[name] = rgb_from_world.inverse()
    return cameras[0], Poses(world_from_rgb, points_from_colmap(model))


def write_scene(path: Path, scene: Scene, sfm_per_metre: float | None) -> None:
    """Write a run's `scene/` folder: a binary COLMAP model of the undistorted cameras, in the given frame.

    RGB (the rig's reference) and thermal are one rig; each registered frame is a rig frame with images `rgb/NAME.png` and
    `thermal/NAME.png`. While the scale is unknown the thermal camera stands in the rig without a pose, and frames hold RGB alone.
    Where the rig has a time offset the two don't stand in a fixed relation: the thermal camera is a rig of its own, with frames of its
    own. `failures.json` lists the frames that weren't registered. Point colours are stored in 8 bits.

    Args:
        path: folder, made if needed.
        scene: what to write.
        sfm_per_metre: SfM units per metre, for the thermal camera's place in the rig; None when unknown.
    """
    scene = scene.as_given()
    model = pycolmap.Reconstruction()
    rgb = colmap_camera(scene.rig.rgb, RGB_CAMERA_ID)
    thermal = colmap_camera(scene.rig.thermal, THERMAL_CAMERA_ID)
    model.add_camera(rgb)
    model.add_camera(thermal)
    rig = pycolmap.Rig(rig_id=RIG_ID)
    rig.add_ref_sensor(rgb.sensor_id)
    apart = sfm_per_metre is not None and scene.rig.time_offset != 0.0
    thermal_from_rgb = None
    if sfm_per_metre is not None:
        thermal_from_rgb = rigid3d_from_se3(scene.rig.rgb_from_thermal.with_baseline_scaled(sfm_per_metre).inverse())
    if apart:
        own = pycolmap.Rig(rig_id=THERMAL_RIG_ID)
        own.add_ref_sensor(thermal.sensor_id)
        model.add_rig(own)
    else:
        rig.add_sensor(thermal.sensor_id, thermal_from_rgb)
    model.add_rig(rig)
    names = sorted(scene.world_from_rgb)
    for i, name in enumerate(names):
        rgb_image = pycolmap.Image(name=f"rgb/{name}.png", camera_id=RGB_CAMERA_ID, image_id=1 + 2 * i)
        thermal_image = pycolmap.Image(name=f"thermal/{name}.png", camera_id=THERMAL_CAMERA_ID, image_id=2 + 2 * i)
        together = [rgb_image] if apart or sfm_per_metre is None else [rgb_image, thermal_image]
        _add_frame(model, 1 + i, RIG_ID, scene.rgb_from_world(name), together)
        if apart:
            assert sfm_per_metre is not None
            thermal_from_world = scene.thermal_from_world(name, sfm_per_metre)
            _add_frame(model, 1 + len(names) + i, THERMAL_RIG_ID, thermal_from_world, [thermal_image])
    colours = np.round(np.clip(scene.points.rgb, 0, 1) * 255).astype(np.uint8)
    for xyz, colour in zip(scene.points.xyz, colours, strict=True):
        model.add_point3D(xyz, pycolmap.Track(), colour)
    path.mkdir(parents=True, exist_ok=True)
    with quiet_colmap():
        model.write_binary(path)
    _check_written(path)
    failures = {name: scene.failures[name] for name in sorted(scene.failures)}
    write_json(path / _FAILURES, failures)


def _add_frame(
    model: pycolmap.Reconstruction, frame_id: int, rig_id: int, rig_from_world: SE3, images: Sequence[pycolmap.Image]
) -> None:
    frame = pycolmap.Frame(frame_id=frame_id, rig_id=rig_id, rig_from_world=rigid3d_from_se3(rig_from_world))
    for image in images:
        frame.add_data_id(image.data_id)
    model.add_frame(frame)
    for image in images:
        image.frame_id = frame_id
        model.add_image(image)
    model.register_frame(frame_id)


def read_scene(path: Path, capture: Capture) -> Scene:
    """Read what `write_scene` wrote, so that a run goes on without structure from motion. Its world is the given frame.

    Raises:
        RtgsError: unreadable, or made from another capture (a frame or the RGB intrinsics differ).
    """
    camera, poses = read_sparse(path)
    here = capture.rig.rgb
    theirs = camera.resized(here.width, here.height)  # a run may be resumed at another image size
    if not np.allclose(theirs.matrix, here.matrix, rtol=1e-3, atol=1.0):
        raise RtgsError(f"{path}: was made with other RGB intrinsics than {capture.root} has now. Remove the folder to redo it.")
    strangers = sorted(set(poses.world_from_rgb) - {frame.name for frame in capture.frames})
    if strangers:
        raise RtgsError(
            f"{path}: frame {strangers[0]!r:.100} is not in {capture.root}. Remove the folder to redo structure from motion."
        )
    again = f"Remove the folder {path} to redo structure from motion."
    failures = read_json(path / _FAILURES, missing=again, remedy=again)
    if not isinstance(failures, dict) or not all(isinstance(why, str) for why in failures.values()):
        raise RtgsError(f"{path / _FAILURES}: does not give a reason for each frame. {again}")
    assert poses.points is not None
    return Scene(capture, poses.world_from_rgb, poses.points, failures)


def colmap_camera(camera: Camera, camera_id: int) -> pycolmap.Camera:
    """COLMAP's record of a camera, calibrated (its focal length is a prior to trust)."""
    focal = [camera.fl_x] if camera.model.startswith("SIMPLE") else [camera.fl_x, camera.fl_y]
    if camera.model == "RADIAL":  # one focal length too, despite its name
        focal = [camera.fl_x]
    params = [*focal, camera.cx, camera.cy, *camera.distortion]
    return pycolmap.Camera(
        camera_id=camera_id,
        model=camera.model,
        width=camera.width,
        height=camera.height,
        params=params,
        has_prior_focal_length=True,
    )


def points_from_colmap(model: pycolmap.Reconstruction) -> SparsePoints:
    """The model's points in order of their ids, those of finite position."""
    points = [model.points3D[i] for i in sorted(model.points3D)]
    xyz = np.array([p.xyz for p in points], dtype=np.float64).reshape(-1, 3)
    rgb = np.array([p.color for p in points], dtype=np.float32).reshape(-1, 3) / np.float32(255)
    finite = np.isfinite(xyz).all(axis=1)
    return SparsePoints(xyz[finite], rgb[finite])


def se3_from_rigid3d(rigid: pycolmap.Rigid3d) -> SE3:
    """COLMAP's record of a rigid transform `a_from_b` as ours."""
    x, y, z, w = rigid.rotation.quat  # COLMAP's Python side has the scalar last
    return SE3(rotation_from_quat([w, x, y, z]), np.array(rigid.translation, dtype=np.float64))


def rigid3d_from_se3(transform: SE3) -> pycolmap.Rigid3d:
    """A rigid transform `a_from_b` as COLMAP's record."""
    w, x, y, z = quat_from_rotation(transform.rotation)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), np.asarray(transform.translation, dtype=np.float64))


def _read_model(folder: Path) -> pycolmap.Reconstruction:
    _check_binary_lengths(folder)
    try:
        with quiet_colmap():
            return pycolmap.Reconstruction(str(folder))
    except (ValueError, RuntimeError, OSError, IndexError, MemoryError) as error:
        cause = str(error).split("] ", 1)[-1].strip()
        raise RtgsError(f"{folder}: is not a COLMAP model that can be read ({cause}). Export it again or remove it.") from error


def _image_names(folder: Path, model: pycolmap.Reconstruction) -> dict[int, str]:
    """Names of the images by id. COLMAP itself takes a name in a text model to end at its first space."""
    try:
        names = {i: image.name for i, image in model.images.items()}
        text = folder / "images.txt"
        if (folder / "images.bin").is_file() or not text.is_file():
            return names
        lines = text.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise RtgsError(
            f"{folder}: names an image with bytes that are not UTF-8. Rename the image and export the model again."
        ) from error
    is_image = True  # and the line after an image holds its points, perhaps none
    for line in lines:
        words = line.strip().split(maxsplit=9)
        if not is_image:
            is_image = True
        elif words and not words[0].startswith("#"):
            is_image = False
            if len(words) == 10 and words[0].isdecimal() and int(words[0]) in names:
                names[int(words[0])] = words[9]
    return names


def _check_written(folder: Path) -> None:
    """COLMAP overlooks writes that fail.

    Raises:
        OSError: a file of the model is not whole, for the reason that writing on gives.
    """
    for name, walk in _WALKS.items():
        path = folder / f"{name}.bin"
        if not _is_complete(path.read_bytes(), walk):
            with path.open("ab") as file:
                file.write(bytes(1 << 20))
                file.flush()
                os.fsync(file.fileno())
            raise OSError(EIO, os.strerror(EIO))


def _is_complete(data: bytes, walk: Callable[[bytes, int], int]) -> bool:
    try:
        return walk(data, struct.unpack_from("<Q", data)[0]) <= len(data)
    except (struct.error, ValueError, OverflowError):
        return False


def _check_binary_lengths(folder: Path) -> None:
    """Refuse truncated binary files: COLMAP takes what it reads past the end for a count and works on it for minutes."""
    for name, walk in _WALKS.items():
        path = folder / f"{name}.bin"
        if not path.is_file():
            continue  # a text model, or none: COLMAP says which file it misses
        if not _is_complete(path.read_bytes(), walk):
            raise RtgsError(f"{path}: is truncated. Copy or export the model again, or remove the folder.")


def _walk_cameras(data: bytes, count: int) -> int:
    """Offset after the last record: id, model, width, height (24 bytes), parameters of 8 bytes."""
    n_params = (3, 4, 4, 5, 8, 8)  # by COLMAP's number of the six known models; others are refused later, by name
    at = 8
    for _ in range(count):
        model = struct.unpack_from("<i", data, at + 4)[0]
        at += 24 + 8 * (n_params[model] if 0 <= model < len(n_params) else 3)
    return at


def _walk_images(data: bytes, count: int) -> int:
    """Offset after the last record: id, quaternion, translation, camera, name ending in 0, count, points of 24 bytes."""
    at = 8
    for _ in range(count):
        at = data.index(b"\0", at + 64) + 1
        at += 8 + 24 * struct.unpack_from("<Q", data, at)[0]
    return at


def _walk_points(data: bytes, count: int) -> int:
    """Offset after the last record: id, position, colour, error (43 bytes), count, track elements of 8 bytes."""
    at = 8
    for _ in range(count):
        at += 51 + 8 * struct.unpack_from("<Q", data, at + 43)[0]
    return at


def _walk_rigs(data: bytes, count: int) -> int:
    """Offset after the last record: id, number of sensors, the reference sensor (8 bytes), the others.

    Each other sensor has 8 bytes, whether its pose is known (a byte), and the pose of 56 bytes if it is.
    """
    at = 8
    for _ in range(count):
        n_sensors = struct.unpack_from("<I", data, at + 4)[0]
        at += 8 + (8 if n_sensors > 0 else 0)
        for _ in range(n_sensors - 1):
            at += 9 + (56 if struct.unpack_from("<B", data, at + 8)[0] else 0)
    return at


def _walk_frames(data: bytes, count: int) -> int:
    """Offset after the last record: id, rig, pose (64 bytes), count, images of 16 bytes."""
    at = 8
    for _ in range(count):
        at += 68 + 16 * struct.unpack_from("<I", data, at + 64)[0]
    return at


_WALKS = {
    "rigs": _walk_rigs,
    "cameras": _walk_cameras,
    "frames": _walk_frames,
    "images": _walk_images,
    "points3D": _walk_points,
}


def camera_from_colmap(folder: Path, camera: pycolmap.Camera) -> Camera:
    """A camera of a COLMAP model; `folder` begins the messages.

    Raises:
        RtgsError: a model that is not known, or values that no camera has.
    """
    model = camera.model_name
    if model not in DISTORTION_OF_MODEL:
        raise RtgsError(f"{folder}: camera model {model} is not known. It is one of {', '.join(DISTORTION_OF_MODEL)}.")
    params = [float(p) for p in camera.params]
    if not np.isfinite(params).all():
        raise RtgsError(f"{folder}: the intrinsics of camera {camera.camera_id} hold NaN or infinity. Export the model again.")
    n_focal = len(camera.focal_length_idxs())
    cx, cy = params[n_focal : n_focal + 2]
    lens = dict(zip(DISTORTION_OF_MODEL[model], params[n_focal + 2 :], strict=True))
    fl_x, fl_y = params[0], params[n_focal - 1]
    if min(fl_x, fl_y) <= 0:
        raise RtgsError(f"{folder}: camera {camera.camera_id} has focal length {min(fl_x, fl_y):g}; it is above 0 pixels.")
    found = Camera(model, camera.width, camera.height, fl_x, fl_y, cx, cy, **lens)
    wrong = absurd_intrinsics(found)
    if wrong:
        raise RtgsError(f"{folder}: camera {camera.camera_id}: {wrong}")
    return found
