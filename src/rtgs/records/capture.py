"""A capture in memory: its frames, rig, masks, and the poses that came with it.

`rtgs.io.capture` reads it from a folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.radiometry import Radiometry
from rtgs.records.rgb_camera import FoundRgbCamera, RgbStart
from rtgs.records.rig import Rig

Image: TypeAlias = NDArray[np.float32]
ImageSource: TypeAlias = Image | Callable[[], Image]


class LazyImage:
    """A field of `Frame`: it takes an image, or a function that loads one, and it gives the image."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    @overload
    def __get__(self, frame: None, owner: type) -> Image: ...
    @overload
    def __get__(self, frame: Frame, owner: type) -> Image: ...
    def __get__(self, frame: Frame | None, owner: type) -> Image:
        if frame is None:
            raise AttributeError(self._name)  # so the field has no default
        source = frame.__dict__[self._name]
        return source() if callable(source) else source

    def __set__(self, frame: Frame, source: ImageSource) -> None:
        frame.__dict__[self._name] = source


@dataclass(frozen=True, eq=False, repr=False)  # to print a frame must not load its images
class Frame:
    """One instant: a synchronised, undistorted pair.

    Both images are given as arrays, or as functions that load them. A function is called at every access: it decides what it keeps
    in memory. Such a frame can be used from several threads if its functions can.

    Attributes:
        name: common stem of both files.
        rgb: `[H, W, 3]` float32 in [0, 1].
        thermal: `[h, w]` float32, in the unit that `Capture.radiometry` names: °C, or counts.
        time_s: when the RGB image was taken, in seconds by the camera's clock; only differences mean something. None when unknown.
    """

    name: str
    rgb: LazyImage = LazyImage()
    thermal: LazyImage = LazyImage()
    time_s: float | None = None

    def with_thermal(self, thermal: ImageSource) -> Frame:
        """The same frame with another thermal image. Unlike `dataclasses.replace` it does not load the RGB image."""
        frame = copy(self)
        object.__setattr__(frame, "thermal", thermal)
        return frame


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """SfM points in the world frame: `xyz` `[P, 3]` float64, `rgb` `[P, 3]` float32 in [0, 1]."""

    xyz: NDArray[np.float64]
    rgb: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.xyz)


NO_POINTS = SparsePoints(np.zeros((0, 3)), np.zeros((0, 3), np.float32))


@dataclass(frozen=True, eq=False)
class Poses:
    """RGB poses that came with a capture: `world_from_rgb` by frame name, and the points, where the source has them."""

    world_from_rgb: Mapping[str, SE3]
    points: SparsePoints | None


@dataclass(frozen=True, eq=False)
class Capture:
    """A capture folder, checked. Its images are undistorted.

    Attributes:
        root: the folder.
        raw_rig: the cameras as calibrated, with their lenses, at the files' resolution: structure from motion reads the files.
        rig: the pinhole cameras of the images in `frames`.
        frames: in name order; all of them, registered or not.
        rgb_mask, thermal_mask: `[H, W]`, `[h, w]` bool, pixels that undistortion could fill and that hold a value in every frame.
        radiometry: how the files' counts became the values of `Frame.thermal`, and the unit of those.
        poses: what `transforms.json` or `sparse/0` says, or None: then SfM has to run.
        warnings: sentences for a person, on things that do not stop a run.
        rgb_upright: whether the orientation tags of the RGB files are applied; False where poses belong to the stored pixels.
        release_images: gives the memory of images back that the frames keep. They are loaded again when they are asked for.
        rgb_start: what of the RGB camera `rig.json` leaves out; None where nothing. `raw_rig.rgb` is then only where its search starts.
        found_rgb: what structure from motion found of it; the images are undistorted by this camera.
        with_camera: gives the same capture with another RGB camera for its files; None for captures that were not read from files.
    """

    root: Path
    raw_rig: Rig
    rig: Rig
    frames: tuple[Frame, ...]
    rgb_mask: NDArray[np.bool_]
    thermal_mask: NDArray[np.bool_]
    radiometry: Radiometry
    poses: Poses | None
    warnings: tuple[str, ...] = ()
    rgb_upright: bool = True
    release_images: Callable[[], None] = lambda: None
    rgb_start: RgbStart | None = None
    found_rgb: FoundRgbCamera | None = None
    with_camera: Callable[[Camera], Capture] | None = None

    def with_found_rgb(self, found: FoundRgbCamera) -> Capture:
        """The capture with the RGB camera that was found, and its images undistorted by it."""
        assert self.with_camera is not None
        return replace(self.with_camera(found.camera), found_rgb=found, warnings=self.warnings)


@dataclass(frozen=True)
class Split:
    """Which frames no fit may see, and which of the others choose settings.

    Attributes:
        held_out: the names of the frames that only the evaluation sees; or n, for frames 0, n, 2n, … of the capture in name order,
            registered or not.
        validation: the names of the training frames that choose settings; or n, for frames n // 2, n // 2 + n, … of the training
            frames in name order.

    Raises:
        RtgsError: an n below 2, which would leave no frame for the fit.
    """

    held_out: int | frozenset[str] = 8
    validation: int | frozenset[str] = 8

    def __post_init__(self) -> None:
        for name in ("held_out", "validation"):
            value = getattr(self, name)
            if isinstance(value, int) and value < 2:
                raise RtgsError(f"split.{name} is {value}; one frame in so many is taken, so it is at least 2.")

    def held_out_names(self, names: Sequence[str]) -> frozenset[str]:
        """Which frames are held out, from the names of all frames of a capture, in order."""
        return frozenset(names[:: self.held_out]) if isinstance(self.held_out, int) else self.held_out

    def validation_names(self, training: Sequence[str]) -> frozenset[str]:
        """Which frames choose settings, from the names of the training frames, in order."""
        every = self.validation
        return frozenset(training[every // 2 :: every]) if isinstance(every, int) else every
