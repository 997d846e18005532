"""The camera makers whose files can be imported."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from rtgs.base.errors import RtgsError

if TYPE_CHECKING:  # the command line shows the names without waiting for NumPy
    from rtgs.io.cameras.protocol import CameraFormat

# Name in `rtgs import NAME` → module with the object FORMAT. A module is imported when its format is used.
MODULES = {
    "flir": "rtgs.io.cameras.flir",
    "dji": "rtgs.io.cameras.dji",
}


def camera_format(name: str) -> CameraFormat:
    """The format of a maker.

    Raises:
        RtgsError: no maker of that name.
    """
    if name not in MODULES:
        raise RtgsError(f"import: {name!r} is no known maker of cameras; there are {', '.join(MODULES)}.")
    found: CameraFormat = import_module(MODULES[name]).FORMAT
    return found
