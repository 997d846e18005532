"""`rtgs calibrate`: a rig from pictures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rtgs.base.events import Listener, ResultLine, WarningLine, long_work
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import BoardConfig

if TYPE_CHECKING:
    from rtgs.records.rig import Rig


def calibrate() -> None:
    """Calibrate a rig: `target FOLDER` from pictures of a board, `RUN --write rig.json` from a run that found it."""
    raise AssertionError("`main` takes the commands behind `rtgs calibrate` from a table of their own")


def target(folder: Folder, out: Path, config: Annotated[BoardConfig, Flat], listener: Hidden) -> None:
    """Calibrate both cameras and the transform between them from pairs of pictures of a board.

    Writes rig.json for captures of the same rig, calibration.json, plots of the residuals, and the corners that were found.

    Args:
        folder: with rgb/ and thermal/, the same name = the same instant; thermal images in counts or °C.
        out: folder for the results, new or of an earlier calibration.
        config: the board.
    """
    from rtgs.calibration import calibrate_target

    with long_work(listener, "calibrate", "calibrate target") as progress:
        found = calibrate_target(folder, config, out, progress)
    for rejected in found.rejected:
        listener(ResultLine(f"rejected {rejected.name}: {rejected.reason}"))
    for which, camera in (("rgb", found.rgb), ("thermal", found.thermal)):
        listener(
            ResultLine(f"{which}: {camera.model}, {len(found.pairs)} pictures, corners {camera.residual_px:.2f} px from the fit")
        )
        _table(listener, [(f"{which}.{v.name}", v.value, v.std, v.unit) for v in camera.values])
    listener(ResultLine("rgb_from_thermal:"))
    _table(listener, [(v.name, v.value, v.std, v.unit) for v in found.rig])
    listener((ResultLine if found.agreement.agree else WarningLine)(found.agreement.sentence))
    listener(
        ResultLine(f"wrote {out / 'rig.json'}; add the thermal camera's temperature fields to it, if its counts are temperatures")
    )


def from_run(run: Folder, write: Path, listener: Hidden) -> None:
    """Keep the rig that a run found, with its uncertainty, for the next capture of the same two cameras.

    `rtgs calibrate RUN --write rig.json` is the same: `from-run` may be left out.

    Args:
        run: the run folder.
        write: the rig.json to write, outside the capture.
    """
    from rtgs.run.folder import RunFolder
    from rtgs.run.found_rig import write_found_rig

    rig = write_found_rig(RunFolder(run), write)
    std = rig.calibration_std
    assert std is not None
    rows = [
        ("baseline", 1000 * rig.baseline_m, 1000 * rig.baseline_m * std.baseline_length, "mm"),
        ("rotation", _angle_deg(rig), math.degrees(std.rotation_rad), "°"),
        ("thermal focal", rig.thermal.fl_x, rig.thermal.fl_x * std.thermal_focal, "px"),
    ]
    _table(listener, rows)
    listener(ResultLine(f"wrote {write}"))


def _angle_deg(rig: Rig) -> float:
    """By how much the thermal camera is turned against the RGB camera."""
    from rtgs.maths.geometry import axis_angle_from_rotation

    x, y, z = axis_angle_from_rotation(rig.rgb_from_thermal.rotation).tolist()
    return math.degrees(math.hypot(x, y, z))


def _table(listener: Listener, rows: list[tuple[str, float, float, str]]) -> None:
    for name, value, std, unit in rows:
        decimals = 5 if not unit else 3
        listener(ResultLine(f"  {name:<14} {value:>12.{decimals}f} ± {std:.{decimals}f} {unit}".rstrip()))
