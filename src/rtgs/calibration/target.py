"""A folder of pairs of pictures of a board → `rig.json` with its uncertainty, `calibration.json`, plots."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.base.json_records import write_json
from rtgs.base.progress import Progress
from rtgs.calibration.boards import Board, make_board
from rtgs.calibration.checkerboard import Sighting
from rtgs.calibration.lens import view
from rtgs.calibration.plots import overlay, residual_plots
from rtgs.calibration.record import TargetCalibration
from rtgs.calibration.solve import Pair, solve
from rtgs.calibration.summary import results, rig_of
from rtgs.config.calibration import BoardConfig
from rtgs.io.image_files import check_counts_mode, list_images, read_header, read_rgb
from rtgs.io.rig import write_rig
from rtgs.io.thermal_files import thermal_values
from rtgs.records.radiometry import RelativeCounts

_GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
Picture = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Seen:
    """A board that was found in both pictures."""

    pair: Pair
    rgb: Sighting
    thermal: Sighting


def calibrate_target(folder: Path, config: BoardConfig, out: Path, progress: Progress) -> TargetCalibration:
    """Calibrate both cameras and the transform between them from pictures of a board.

    Args:
        folder: with `rgb/` and `thermal/`, the same name = the same instant; thermal images in counts or °C.
        config: the board.
        out: a new or empty folder, or an earlier calibration, which is replaced. It gets `rig.json`, `calibration.json`,
            `residuals_rgb.png`, `residuals_thermal.png` and `corners/NAME.png`.

    Raises:
        RtgsError: an unreadable or colour thermal image, images of several sizes, too few boards, boards that no camera fits.
    """
    board = make_board(config)
    rgb, thermal = list_images(folder / "rgb"), list_images(folder / "thermal")
    rejected = dict.fromkeys(rgb.keys() - thermal.keys(), "no thermal picture has this name")
    rejected |= dict.fromkeys(thermal.keys() - rgb.keys(), "no RGB picture has this name")
    names = sorted(rgb.keys() & thermal.keys())
    if not names:
        raise RtgsError(f"{folder}: no picture in rgb/ has a partner of the same name in thermal/.")
    for name in names:
        check_counts_mode(read_header(thermal[name]))
    sizes = _size([rgb[n] for n in names]), _size([thermal[n] for n in names])
    _check_out(out)
    with write_whole(out) as new:
        new.mkdir(parents=True)
        seen: list[_Seen] = []
        for i, name in enumerate(names):
            progress(i, len(names) + 3, name)
            found = _look(board, name, rgb[name], thermal[name], new / "corners")
            if isinstance(found, str):
                rejected[name] = found
            else:
                seen.append(found)
        if not seen:
            raise RtgsError(f"{folder}: the board was found in no pair. {names[0]}: {rejected[names[0]]}.")
        solution = solve([s.pair for s in seen], *sizes, lambda done, _, text: progress(len(names) + done, len(names) + 3, text))
        used = [s for s in seen if s.pair.name in set(solution.names)]
        rig = rig_of(solution, *sizes)
        found_all = results(config, solution, rig, rejected, [(s.rgb.ids, s.thermal.ids) for s in used])
        write_rig(new / "rig.json", rig, RelativeCounts())
        write_json(new / "calibration.json", found_all)
        residual_plots(new, solution, ([s.pair.rgb.pixels for s in used], [s.pair.thermal.pixels for s in used]), sizes)
    return found_all


def _look(board: Board, name: str, rgb: Path, thermal: Path, corners: Path) -> _Seen | str:
    """Find the board in both pictures, and draw what was found; or why it cannot be used."""
    visible = (read_rgb(rgb) @ _GREY).astype(np.float32)
    hot = thermal_values(thermal, RelativeCounts())[0]
    in_rgb, in_thermal = board.find(visible), board.find(hot)
    if isinstance(in_rgb, str) or isinstance(in_thermal, str):
        return "; ".join(f"{which}: {f}" for which, f in (("rgb", in_rgb), ("thermal", in_thermal)) if isinstance(f, str))
    pair = Pair(name, view(board.points, in_rgb), view(board.points, in_thermal), board.orders if len(board.orders) > 1 else ())
    overlay(corners / f"{name}.png", (visible, hot), (pair.rgb.pixels, pair.thermal.pixels))
    return _Seen(pair, in_rgb, in_thermal)


def _size(paths: list[Path]) -> tuple[int, int]:
    """Width and height of all pictures of one camera, upright."""
    first = read_header(paths[0]).size()
    for path in paths:
        if read_header(path).size() != first:
            other = "×".join(map(str, read_header(path).size()))
            raise RtgsError(
                f"{path}: is {other} and {paths[0].name} is {first[0]}×{first[1]}. One camera has one size; remove this pair."
            )
    return first


def _check_out(out: Path) -> None:
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / "calibration.json").is_file()):
        raise RtgsError(f"{out}: holds something that is no calibration. Name a new folder with --out.")
    if not out.resolve().parent.is_dir():
        raise RtgsError(f"{out}: the folder in which it would lie does not exist.")
