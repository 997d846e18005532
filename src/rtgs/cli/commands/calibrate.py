"""`rtgs calibrate`: a rig from pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rtgs.base.events import Listener, ResultLine, WarningLine, long_work
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import BoardConfig


def calibrate() -> None:
    """Calibrate a rig: `rtgs calibrate target FOLDER ...` from pictures of a board."""
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


def _table(listener: Listener, rows: list[tuple[str, float, float, str]]) -> None:
    for name, value, std, unit in rows:
        decimals = 5 if not unit else 3
        listener(ResultLine(f"  {name:<14} {value:>12.{decimals}f} ± {std:.{decimals}f} {unit}".rstrip()))
