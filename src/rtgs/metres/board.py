"""Metres from a board, or from square tags, of known size in the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.calibration.boards import make_board
from rtgs.calibration.checkerboard import Sighting
from rtgs.config.metres import MetresSourceName, TagsConfig
from rtgs.io.image_files import read_rgb
from rtgs.metres.board_fit import TargetFit, TargetView, fit_target
from rtgs.metres.evidence import Evidence, Source
from rtgs.metres.rays import slopes_of
from rtgs.records.metres import MetresSource

_GREY = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_LEAST_STD = 1e-4  # how exactly boards are printed


class BoardSource:
    """A checkerboard, ChArUco board or grid of circles, and tags."""

    name: MetresSourceName = "board"

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        found, reasons = [], []
        for search in (_from_board, _from_tags):
            result = search(evidence)
            if isinstance(result, MetresSource):
                found.append(result)
            elif result:
                reasons.append(result)
        return found or "; ".join(reasons)


def _from_board(evidence: Evidence) -> MetresSource | str:
    config = evidence.file.board
    if config is None:
        return ""
    board, views = make_board(config), {}
    for name in evidence.files:
        seen = board.find(_grey(evidence, name), explain=False)
        if isinstance(seen, Sighting):
            views[name] = _view(evidence, name, seen.ids, seen.pixels + 0.5)
    fit = fit_target(board.points, board.orders, views, _guess(evidence))
    if isinstance(fit, str):
        return f"the board: {fit}"
    return _source("board", fit, len(views), evidence, f"{config.inner_corners} corners with squares of {config.square_m:g} m")


def _from_tags(evidence: Evidence) -> MetresSource | str:
    config = evidence.file.tags
    if config is None:
        return ""
    detector, views = _detector(config), dict[int, dict[str, TargetView]]()
    for name in evidence.files:
        grey = (255 * _grey(evidence, name)).astype(np.uint8)
        corners, ids, _ = detector.detectMarkers(grey)
        numbers: list[int] = [] if ids is None else [int(n) for n in ids.ravel()]
        for square, number in zip(corners, numbers, strict=True):
            pixels = np.asarray(square, dtype=np.float64).reshape(4, 2) + 0.5
            views.setdefault(number, {})[name] = _view(evidence, name, np.arange(4), pixels)
    half = config.side_m / 2
    points = np.array([(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)])
    fits = [fit_target(points, (np.arange(4),), seen, _guess(evidence)) for seen in views.values()]
    good = [fit for fit in fits if isinstance(fit, TargetFit)]
    if not good:
        return f"tags: {fits[0] if fits else 'no image shows one'}"
    return _source(
        "tags", _mean(good), len({n for v in views.values() for n in v}), evidence, f"{len(good)} tags of {config.side_m:g} m"
    )


def _mean(fits: Sequence[TargetFit]) -> TargetFit:
    """Of several tags; their scatter counts where it is larger than each one's standard deviation."""
    logs, weights = np.log([f.sfm_per_metre for f in fits]), np.array([f.std_log**-2.0 for f in fits])
    mean = float((weights * logs).sum() / weights.sum())
    apart = float((weights * (logs - mean) ** 2).sum() / max(len(fits) - 1, 1))
    std = math.sqrt(max(1.0, apart) / float(weights.sum()))
    images = tuple(sorted({name for f in fits for name in f.images}))
    return TargetFit(math.exp(mean), std, images, float(np.median([f.misfit for f in fits])))


def _source(name: str, fit: TargetFit, images: int, evidence: Evidence, what: str) -> MetresSource:
    misfit_px = fit.misfit * evidence.scene.capture.raw_rig.rgb.fl_x
    text = f"{what}, in {len(fit.images)} of the {images} images that show it, {misfit_px:.2g} px from where the fit has it"
    return MetresSource(name, fit.sfm_per_metre, math.hypot(fit.std_log, _LEAST_STD), text)


def _guess(evidence: Evidence) -> float:
    """SfM units per metre, roughly: things are a few metres away."""
    return evidence.usual_depth or 1.0


def _grey(evidence: Evidence, name: str) -> NDArray[np.float32]:
    return np.asarray(read_rgb(evidence.files[name], upright=evidence.scene.capture.rgb_upright) @ _GREY, dtype=np.float32)


def _view(evidence: Evidence, name: str, ids: NDArray[np.intp], pixels: NDArray[np.float64]) -> TargetView:
    return TargetView(ids, slopes_of(evidence.scene.capture.raw_rig.rgb, pixels), evidence.poses[name])


def _detector(config: TagsConfig) -> cv2.aruco.ArucoDetector:
    number = getattr(cv2.aruco, config.dictionary, None) if config.dictionary.startswith("DICT_") else None
    if number is None:
        raise RtgsError(
            f"metres.json: dictionary is {config.dictionary!r}, which OpenCV does not have; DICT_APRILTAG_36h11 is one."
        )
    parameters = cv2.aruco.DetectorParameters()
    # OpenCV's other methods place the corners inside of a tag, and make it 0.6 to 2 % too small.
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    return cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(number), parameters)


SOURCE: Source = BoardSource()
