"""A capture folder: images, rig, and poses where it has them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from unicodedata import is_normalized

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.memory import Memory
from rtgs.images.cache import ImageCache
from rtgs.io.colmap import read_sparse
from rtgs.io.image_files import (
    ImageHeader,
    check_counts_mode,
    check_rgb,
    frame_name,
    list_images,
    read_header,
    read_rgb,
    reduction_for,
)
from rtgs.io.rig import read_rig
from rtgs.io.thermal_files import ThermalFile, check_formats, check_thermal_file, check_together, common_no_data, thermal_values
from rtgs.io.transforms import read_transforms
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera, Undistortion
from rtgs.records.capture import Capture, Frame, Poses
from rtgs.records.radiometry import Radiometry
from rtgs.records.rgb_camera import RgbStart
from rtgs.records.rig import Rig
from rtgs.records.world import rounding, spread

MIN_FRAMES = 3
_INTRINSICS_TOLERANCE = 0.01
_CHECK_BYTES = 16  # a pixel, while a file is checked: decoded, as counts, as values and as a copy
_ROUNDING_PX = (0.1, 3.0)  # of camera positions: from the first on it is said, from the second on refused


def load_capture(root: Path | str, *, rgb_max_side: int = 960, cache_bytes: int | None = None) -> Capture:
    """Load and check a capture folder.

    Everything that can be checked without decoding pixels is checked first; then every file is decoded once, so that a damaged one is
    found before hours of work. No image is kept: a frame makes its images when they are asked for, and those used last stay in
    memory. RGB is undistorted and then averaged down; thermal is undistorted and keeps its size. A JPEG that has twice the wanted pixels
    or more on each side is decoded at 1/2, 1/4 or 1/8 of its size, as far as twice the wanted size is left.

    Args:
        root: the folder, with `rgb/`, `thermal/`, `rig.json` and optionally poses in `sparse/0` or `transforms.json`.
        rgb_max_side: RGB images are made no longer than this many pixels; smaller ones are left as they are.
        cache_bytes: how much memory undistorted images may take; None: what `Memory.of()` gives them. A frame takes about 8 MB. An image
            that had to go is made again from its file, which takes 0.05 s for two megapixels.

    Returns:
        The capture: RGB in [0, 1], thermal in °C, or in counts where `rig.json` gives no radiometry.

    Raises:
        RtgsError: anything wrong with the folder, by file and field. A frame raises it too, where a file has gone or changed since.
    """
    root = Path(root)
    if not root.is_dir():
        raise RtgsError(f"{root}: no such folder. A capture holds rgb/, thermal/ and rig.json.")
    if rgb_max_side < 1:
        raise RtgsError(f"rgb_max_side is {rgb_max_side}; it is a number of pixels above 0.")
    rig_file = read_rig(root / "rig.json", lambda: read_header(next(iter(_paired_files(root)[0].values()))))
    warnings = list(rig_file.warnings)
    rgb_files, thermal_files = _paired_files(root)
    warnings += _other_form(rgb_files, thermal_files)
    rgb_headers = [read_header(path) for path in rgb_files.values()]
    thermal_headers = [read_header(path) for path in thermal_files.values()]
    for header in thermal_headers:
        check_counts_mode(header)
    check_formats(thermal_headers, rig_file.radiometry)
    raw_rig, rgb_start = rig_file.rig, rig_file.rgb_start
    _check_sizes(root / "rig.json", "thermal", raw_rig.thermal, thermal_headers)
    camera, poses, upright = _read_poses(root, raw_rig.rgb, rgb_headers, warnings, rgb_start)
    raw_rig = replace(raw_rig, rgb=camera)
    cache = ImageCache(Memory.of().images if cache_bytes is None else cache_bytes)
    with ThreadPoolExecutor(max_workers=_readers(rgb_headers + thermal_headers, cache.max_bytes)) as pool:
        try:
            check = partial(_checked, rig_file.radiometry)
            checked = list(pool.map(check, rgb_files.values(), thermal_files.values()))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    check_together(checked, list(rgb_files.values()), rig_file.radiometry)
    no_data = common_no_data(checked, warnings)

    def with_camera(camera: Camera) -> Capture:
        rig = replace(raw_rig, rgb=camera)
        rgb_size = _size_within(camera, rgb_max_side)
        reductions = {header.path: reduction_for(header, rgb_size) for header in rgb_headers}
        images = _Images(rig, rig_file.radiometry, rgb_size, cache, upright, reductions)
        images.leave_out(no_data)
        return Capture(
            root=root,
            raw_rig=rig,
            rig=replace(rig, rgb=camera.pinhole().resized(*rgb_size), thermal=rig.thermal.pinhole()),
            frames=tuple(
                Frame(name, partial(images.rgb, path), partial(images.thermal, thermal_files[name]), header.time_s)
                for (name, path), header in zip(rgb_files.items(), rgb_headers, strict=True)
            ),
            rgb_mask=images.rgb_mask,
            thermal_mask=images.thermal_mask,
            radiometry=rig_file.radiometry,
            poses=poses,
            warnings=tuple(warnings),
            rgb_upright=upright,
            release_images=cache.clear,
            rgb_start=rgb_start if poses is None else None,
            with_camera=with_camera,
        )

    return with_camera(camera)


def _readers(headers: list[ImageHeader], most_bytes: int) -> int:
    """How many files are checked at once: one for each core, and no more than decode into the memory that images may take."""
    largest = max(header.stored_size[0] * header.stored_size[1] for header in headers)
    return max(1, min(8, os.cpu_count() or 1, most_bytes // (_CHECK_BYTES * largest)))


def _checked(radiometry: Radiometry, rgb: Path, thermal: Path) -> ThermalFile:
    """Refuse files that could not be made images of later; what the thermal one holds."""
    check_rgb(rgb)
    return check_thermal_file(thermal, radiometry)


class _Images:
    """Makes the frames' images from their files when they are asked for.

    The cache keeps them in float32. Eight or 16 bits would take less memory but change results: an undistorted, averaged image has
    values between those levels.

    Args:
        reductions: how many times smaller each RGB file is decoded.
    """

    def __init__(
        self,
        raw_rig: Rig,
        radiometry: Radiometry,
        rgb_size: tuple[int, int],
        cache: ImageCache,
        rgb_upright: bool,
        reductions: Mapping[Path, int],
    ) -> None:
        self.rgb_size, self._rgb_upright = rgb_size, rgb_upright
        self._radiometry, self._cache, self._reductions = radiometry, cache, reductions
        self._camera = raw_rig.rgb
        self._rgb_undistortions = {n: Undistortion(raw_rig.rgb.reduced(n)) for n in set(reductions.values())}
        self._thermal_undistortion = Undistortion(raw_rig.thermal)
        masks = [_shrink(u.mask.astype(np.float32), rgb_size) > 1 - 1e-4 for u in self._rgb_undistortions.values()]
        self.rgb_mask = np.logical_and.reduce(masks)  # all of a pixel is valid
        self.thermal_mask = self._thermal_undistortion.mask

    def rgb(self, path: Path) -> NDArray[np.float32]:
        """`[H, W, 3]` of `rgb_size`, undistorted."""

        def make() -> NDArray[np.float32]:
            reduction = self._reductions[path]
            image = read_rgb(path, upright=self._rgb_upright, reduction=reduction)
            return _shrink(_undistorted(self._rgb_undistortions[reduction], path, image), self.rgb_size)

        return self._cache.get((path, self._camera), make)  # of this camera: another one undistorts otherwise

    def thermal(self, path: Path) -> NDArray[np.float32]:
        """`[h, w]` in the unit of the radiometry, undistorted."""
        return self._cache.get(
            path, lambda: _undistorted(self._thermal_undistortion, path, thermal_values(path, self._radiometry)[0])
        )

    def leave_out(self, no_data: NDArray[np.bool_] | None) -> None:
        """Take pixels `[h, w]` of the thermal files out of the thermal mask."""
        if no_data is not None:
            valid = self._thermal_undistortion.apply((~no_data).astype(np.float32))
            self.thermal_mask = self.thermal_mask & (valid > 1 - 1e-4)


def _undistorted(undistortion: Undistortion, path: Path, image: NDArray[np.float32]) -> NDArray[np.float32]:
    camera = undistortion.camera
    if image.shape[:2] != (camera.height, camera.width):
        raise RtgsError(f"{path}: has another size than when the capture was loaded. Put the file back, or start again.")
    return undistortion.apply(image)


def _paired_files(root: Path) -> tuple[dict[str, Path], dict[str, Path]]:
    rgb, thermal = list_images(root / "rgb"), list_images(root / "thermal")
    for here, there, files, partners in (("rgb", "thermal", rgb, thermal), ("thermal", "rgb", thermal, rgb)):
        alone = sorted(set(files) - set(partners))
        if alone:
            more = f" and {len(alone) - 5} more" if len(alone) > 5 else ""
            raise RtgsError(
                f"{root}: {len(alone)} of {len(files)} images in {here}/ have no partner of the same name in {there}/: "
                f"{', '.join(alone[:5])}{more}. Add the partners or remove these."
            )
    if len(rgb) < MIN_FRAMES:
        raise RtgsError(f"{root}: holds {len(rgb)} image pairs; at least {MIN_FRAMES} are needed, and a few dozen are usual.")
    return rgb, thermal


def _other_form(rgb: Mapping[str, Path], thermal: Mapping[str, Path]) -> list[str]:
    """A warning where names of a pair are written in two forms of Unicode, which look alike."""
    apart = [name for name, path in rgb.items() if not _same_form(path, thermal[name])]
    if not apart:
        return []
    return [
        f"{len(apart)} of {len(rgb)} names are written in another form of Unicode in thermal/ than in rgb/ (é as one character, or as e "
        f"with an accent), {apart[0]} first. They are taken for the same names."
    ]


def _same_form(a: Path, b: Path) -> bool:
    return is_normalized("NFC", a.stem) == is_normalized("NFC", b.stem)


def _check_sizes(path: Path, which: str, camera: Camera, headers: list[ImageHeader], *, upright: bool = True) -> None:
    for header in headers:
        width, height = header.size(upright=upright)
        if (width, height) != (camera.width, camera.height):
            turned = (" (as shown, with its orientation tag)" if upright else " (as stored)") if header.orientation != 1 else ""
            raise RtgsError(
                f"{path}: {which}.width and height say {camera.width}×{camera.height}, but {header.path} is "
                f"{width}×{height}{turned}. Intrinsics belong to one image size: correct them or the images."
            )


def _read_poses(
    root: Path, calibrated: Camera, headers: list[ImageHeader], warnings: list[str], start: RgbStart | None
) -> tuple[Camera, Poses | None, bool]:
    """The RGB camera that counts, the poses of frames that exist, and whether the images are turned upright.

    `sparse/0` wins over `transforms.json`: it has points.
    """
    sparse, transforms = root / "sparse" / "0", root / "transforms.json"
    if (root / "sparse").is_dir() and not sparse.is_dir():
        warnings.append("sparse/ has no folder 0 and was ignored; a COLMAP model is expected in sparse/0.")
    names = [frame_name(header.path.name) for header in headers]
    camera: Camera | None
    if sparse.is_dir():
        if transforms.is_file():
            warnings.append("sparse/0 and transforms.json are both present; sparse/0 is used, because it has points.")
        source = sparse
        camera, poses = read_sparse(sparse)
    elif transforms.is_file():
        source = transforms
        camera, world_from_rgb = read_transforms(transforms, headers[0].size(upright=False))
        poses = Poses(world_from_rgb, None)
    else:
        _check_sizes(root / "rig.json", "rgb", calibrated, headers)
        _say_orientation(headers, "they are turned upright, as rig.json has to describe them.", warnings)
        return calibrated, None, True
    known = {name: pose for name, pose in poses.world_from_rgb.items() if name in set(names)}
    if len(known) < MIN_FRAMES:
        raise RtgsError(
            f"{source}: gives poses for {len(known)} of the {len(names)} images in rgb/; at least {MIN_FRAMES} are needed. "
            "Image names are compared without folder and suffix. Remove the poses to run structure from motion instead."
        )
    if len(known) < len(poses.world_from_rgb):
        extra = len(poses.world_from_rgb) - len(known)
        warnings.append(f"{source.relative_to(root)}: {extra} of its poses belong to no image in rgb/ and were ignored.")
    _check_centres(source, known, calibrated.fl_x if camera is None else camera.fl_x, warnings)
    upright = _posed_upright(source.relative_to(root), camera, headers, warnings)
    _check_sizes(root / "rig.json", "rgb", calibrated, headers, upright=upright)
    if camera is None:
        if start is not None:
            raise RtgsError(
                f"{root / 'rig.json'}: rgb leaves out its {' and '.join(start.unknown)}, and {source} gives poses without intrinsics. Give "
                "all fields of rgb, or remove the poses, and structure from motion will find both."
            )
        return calibrated, Poses(known, poses.points), upright
    if (camera.width, camera.height) != (calibrated.width, calibrated.height):
        raise RtgsError(
            f"{source}: its camera is {camera.width}×{camera.height}, but the images in rgb/ are "
            f"{calibrated.width}×{calibrated.height}. Use the images that the poses were computed from."
        )
    if start is None:
        _compare(source.relative_to(root), camera, calibrated, warnings)
    return camera, Poses(known, poses.points), upright


def _posed_upright(source: Path, camera: Camera | None, headers: list[ImageHeader], warnings: list[str]) -> bool:
    """Whether the poses belong to upright images.

    Programs that find poses read the stored pixels. Where only the upright images have the size of the poses' camera, the poses
    were found from upright copies.
    """
    stored, turned = headers[0].size(upright=False), headers[0].size()
    upright = camera is not None and stored != (camera.width, camera.height) == turned
    if upright:
        said = f"the camera in {source} has the size of the upright images, so they are turned upright."
    else:
        said = f"the poses in {source} belong to the stored pixels, so these are used and not turned; rig.json has to describe them too."
    _say_orientation(headers, said, warnings)
    return upright


def _say_orientation(headers: list[ImageHeader], said: str, warnings: list[str]) -> None:
    tagged = sum(header.orientation != 1 for header in headers)
    if tagged:
        warnings.append(f"{tagged} of the {len(headers)} images in rgb/ have an orientation tag (EXIF or TIFF): {said}")


def _check_centres(source: Path, world_from_rgb: Mapping[str, SE3], focal_px: float, warnings: list[str]) -> None:
    """Positions have to differ, and by much more than the numbers that hold them are apart."""
    centres = np.stack([pose.translation for pose in world_from_rgb.values()])
    with np.errstate(over="ignore", invalid="ignore"):
        apart, rounded = spread(centres, np.median(centres, axis=0)), rounding(centres)
    if not apart < 1e30:
        raise RtgsError(f"{source}: camera positions are {apart:.3g} apart; no unit makes them so large. Export the poses again.")
    if not apart > 1e-30:
        raise RtgsError(f"{source}: all camera positions coincide, so depth cannot be seen. The camera has to move.")
    error_px = rounded / apart * focal_px
    if error_px < _ROUNDING_PX[0]:
        return
    said = (
        f"its camera positions have lost digits: they are typically {apart:.3g} apart, and so far from the origin "
        f"({np.abs(centres).max():.3g}) that rounding has moved them by up to {rounded:.2g}, about {error_px:.2g} pixels in the images. "
        "Subtract a common offset from all positions before they are rounded (or stored in float32)"
    )
    if error_px > _ROUNDING_PX[1]:
        raise RtgsError(f"{source}: {said}, or remove the poses to run structure from motion.")
    warnings.append(f"{source}: {said}.")


def _compare(source: Path, camera: Camera, calibrated: Camera, warnings: list[str]) -> None:
    """Warn when the intrinsics that came with the poses are far from `rig.json`'s."""
    sizes = {"fl_x": calibrated.fl_x, "fl_y": calibrated.fl_y, "cx": calibrated.width, "cy": calibrated.height}
    far = [n for n, size in sizes.items() if abs(getattr(camera, n) - getattr(calibrated, n)) > _INTRINSICS_TOLERANCE * size]
    if camera.has_distortion != calibrated.has_distortion:
        without, having = (source, "rig.json") if calibrated.has_distortion else ("rig.json", source)
        warnings.append(f"{having} gives the RGB camera lens distortion and {without} gives none; {source} is believed.")
    if far:
        said = ", ".join(f"{n} {getattr(camera, n):.1f} and {getattr(calibrated, n):.1f}" for n in far)
        warnings.append(f"RGB intrinsics of {source} and rig.json differ by more than 1 % ({said}); those of {source} are used.")


def _size_within(camera: Camera, max_side: int) -> tuple[int, int]:
    factor = min(1.0, max_side / max(camera.width, camera.height))
    return max(1, round(camera.width * factor)), max(1, round(camera.height * factor))


def _shrink(image: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Average down to `size` = (width, height); the same array where it already has that size."""
    return image if image.shape[1::-1] == size else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)
