"""What a camera maker's file format offers to an import: one protocol, and the records that its functions return.

To add a maker, write a module with an object `FORMAT` of this protocol, and name the module in `registry`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rtgs.records.radiometry import CelsiusRadiometry


@dataclass(frozen=True, eq=False)
class VisiblePicture:
    """The visible picture of a shot.

    Attributes:
        file, suffix: the encoded picture, and the suffix of its file name in lower case, such as ".jpg".
        focal_px: nominal focal length in its pixels, good to a few per cent; None when the files do not say.
        focal_hint_px: a rough focal length, from settings that are made for display; None when there are none.
        thermal_centre_px: from the same settings, where the thermal image's centre lies in this picture, from this picture's centre.
    """

    file: bytes
    suffix: str
    focal_px: float | None = None
    focal_hint_px: float | None = None
    thermal_centre_px: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class Shot:
    """What one radiometric file says.

    Attributes:
        counts: `[h, w]`, as the file stores them.
        radiometry: what makes °C of `counts`.
        thermal_focal_px: nominal focal length of the thermal camera in its pixels; None when the file does not say.
        visible: the picture that is embedded in the file, None when there is none.
        no_visible: what to tell a person where no visible picture is found: what was looked for.
    """

    counts: NDArray[np.generic]
    radiometry: CelsiusRadiometry
    thermal_focal_px: float | None
    visible: VisiblePicture | None
    no_visible: str


class CameraFormat(Protocol):
    """How files of one maker are recognised and read.

    Every function raises `RtgsError`, which names the file and the remedy, where a file cannot be read.
    """

    def recognises(self, path: Path) -> bool:
        """Whether a JPEG holds this maker's thermal data, without decoding its pixels."""
        ...

    def frame_name(self, path: Path) -> str:
        """The name that the frame of this file gets in the capture."""
        ...

    def read(self, path: Path) -> Shot:
        """Read and check a file that `recognises` has accepted."""
        ...

    def visible_partner(self, path: Path) -> Path | None:
        """The file beside this one that holds the visible picture of the same shot; None where there is none."""
        ...

    def visible_focal_px(self, path: Path) -> float | None:
        """Nominal focal length, in pixels, of a visible picture in a file of its own; None when the file does not say."""
        ...
