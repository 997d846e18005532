"""What the checks look at: a loaded capture, and small copies of its pictures that are made once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.doctor.records import Finding
from rtgs.io.image_files import ImageHeader, list_images, read_counts, read_header
from rtgs.io.photograph_tags import PhotographTags, read_photograph_tags
from rtgs.records.capture import Capture, Frame

MOST = 40  # frames that are looked at, evenly spaced; headers are read of all
_GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_SIDE = 640  # of small RGB pictures

Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Look:
    """One frame: its small grey picture `[h, w]` in [0, 1], how sharp the picture is, and its thermal image and counts.

    Attributes:
        clipped, dark: shares of the RGB pixels. rest: mean brightness of those that are not clipped.
    """

    name: str
    grey: Image
    sharpness: float
    clipped: float
    dark: float
    rest: float
    thermal: Image
    counts: NDArray[np.generic]


@dataclass(frozen=True, eq=False)
class Patient:
    """A capture that has been loaded without an error."""

    capture: Capture

    @cached_property
    def rgb_files(self) -> dict[str, Path]:
        """By frame."""
        return list_images(self.capture.root / "rgb")

    @cached_property
    def thermal_files(self) -> dict[str, Path]:
        """By frame."""
        return list_images(self.capture.root / "thermal")

    @cached_property
    def rgb_headers(self) -> list[ImageHeader]:
        """Of all RGB files, in name order."""
        return [read_header(path) for path in self.rgb_files.values()]

    @cached_property
    def thermal_headers(self) -> list[ImageHeader]:
        """Of all thermal files, in name order."""
        return [read_header(path) for path in self.thermal_files.values()]

    @cached_property
    def tags(self) -> list[PhotographTags]:
        """Of all RGB files."""
        return [read_photograph_tags(path) for path in self.rgb_files.values()]

    @cached_property
    def frames(self) -> Sequence[Frame]:
        """The frames that are looked at: neighbours of each other where there are many, so that overlap can be seen."""
        frames = self.capture.frames
        step = max(1, len(frames) // MOST)
        return [f for i, f in enumerate(frames) if i % (2 * step) in (0, 1)] if step > 1 else frames

    @cached_property
    def looks(self) -> list[Look]:
        """Small copies of the frames that are looked at."""
        return [self._look(frame) for frame in self.frames]

    def _look(self, frame: Frame) -> Look:
        grey = np.asarray(frame.rgb @ _GREY, dtype=np.float32)
        factor = min(1.0, _SIDE / max(grey.shape))
        small = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else grey
        return Look(
            frame.name,
            np.asarray(small, dtype=np.float32),
            sharpness_of(grey),
            float((grey > 0.98).mean()),
            float((grey < 0.03).mean()),
            float(grey[grey <= 0.98].mean()) if (grey <= 0.98).any() else 1.0,
            frame.thermal,
            read_counts(self.thermal_files[frame.name]),
        )


def sharpness_of(grey: Image) -> float:
    """How much steeper edges are than after a blur by 3 pixels: mean squared gradients, as a ratio.

    An edge that is sharp gives 3, one with a blur of 2 pixels 1.6, one of 4 pixels 1.2. Fine texture gives more.
    """
    return _steepness(grey, 1.0) / max(_steepness(grey, 3.0), 1e-12)


def _steepness(grey: Image, blur_px: float) -> float:
    soft = cv2.GaussianBlur(grey, (0, 0), blur_px)
    return float(np.mean(cv2.Sobel(soft, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(soft, cv2.CV_32F, 0, 1) ** 2))


class Check(Protocol):
    """One check. To add one, write a module in `rtgs.doctor.checks` with a function of this form, and list it in the registry."""

    def __call__(self, patient: Patient) -> list[Finding]:
        """What there is to say; nothing where all is well."""
        ...


def some(names: Sequence[str], most: int = 4) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
