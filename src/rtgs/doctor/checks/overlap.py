"""Overlap and parallax of neighbouring RGB images, from matches of features in small copies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.doctor.patient import Look, Patient, some
from rtgs.doctor.records import Finding

_FEATURES = 1200
_RATIO = 0.8
_LEAST = 20  # matches of a pair that overlaps
_PIXELS = 1.5
_TURN_ALONE = 0.9  # of the matches: a homography without a moving camera explains them
_MOST_PAIRS = 20
_FEW = 12  # images of which all pairs are compared


@dataclass(frozen=True)
class _Pair:
    name: str
    matches: int
    by_turning: float


def check(patient: Patient) -> list[Finding]:
    """Neighbours that do not overlap, and a camera that turns and does not move. Poses that come along are the proof that it works."""
    if patient.capture.poses is not None:
        return [Finding("overlap", "note", "poses came with the capture, so overlap and parallax are not looked at")]
    pairs = _pairs(patient)
    apart = [pair.name for pair in pairs if pair.matches < _LEAST]
    usual = float(np.median([pair.matches for pair in pairs]))
    found = [Finding("overlap", "note", f"neighbouring RGB images share {usual:.0f} features (median of {len(pairs)} pairs)")]
    remedy = "Overlap neighbours by two thirds, and show texture: where there is none, put posters or markers."
    if len(apart) == len(pairs) and not _any_two(patient):
        found.append(Finding("overlap", "error", "no two RGB images share features, so that no pose can be found", remedy))
    elif len(apart) > len(pairs) / 3:
        text = f"{len(apart)} of {len(pairs)} neighbouring RGB images hardly overlap, {some(apart)} among them"
        found.append(Finding("overlap", "warning", text, remedy))
    turning = [pair.by_turning for pair in pairs if pair.matches >= _LEAST]
    if turning and float(np.median(turning)) > _TURN_ALONE:
        text = "the camera turns and hardly moves: a turn alone explains the matches of neighbouring RGB images"
        found.append(Finding("parallax", "warning", text, "Walk: depth is seen only from different places."))
    return found


def _pairs(patient: Patient) -> list[_Pair]:
    looks = patient.looks
    chosen = list(range(len(looks) - 1))[:: max(1, (len(looks) - 1) // _MOST_PAIRS)]
    features = {i: _features(looks[i]) for i in sorted({*chosen, *(i + 1 for i in chosen)})}
    return [_compare(patient, looks[i], looks[i + 1], features[i], features[i + 1]) for i in chosen]


def _any_two(patient: Patient) -> bool:
    """Whether two images overlap that are no neighbours: photographs may be in any order."""
    looks = patient.looks[:: max(1, len(patient.looks) // _FEW)][:_FEW]
    features = [_features(look) for look in looks]
    pairs = ((i, j) for i in range(len(looks)) for j in range(i))
    return any(_compare(patient, looks[i], looks[j], features[i], features[j]).matches >= _LEAST for i, j in pairs)


def _features(look: Look) -> Any:
    """Places and descriptions of features; None in place of descriptions where there are none."""
    detector = cv2.SIFT_create(_FEATURES)  # type: ignore[attr-defined]
    return detector.detectAndCompute((255 * np.clip(look.grey, 0, 1)).astype(np.uint8), None)


def _compare(patient: Patient, first: Look, second: Look, a: Any, b: Any) -> _Pair:
    if a[1] is None or b[1] is None or min(len(a[1]), len(b[1])) < 2:
        return _Pair(second.name, 0, 0.0)
    nearest = [m for m in cv2.BFMatcher().knnMatch(a[1], b[1], k=2) if len(m) == 2]
    kept = [m for m, other in nearest if m.distance < _RATIO * other.distance]
    if len(kept) < 8:
        return _Pair(second.name, len(kept), 0.0)
    here, there = (np.array([f[0][getattr(m, which)].pt for m in kept]) for f, which in ((a, "queryIdx"), (b, "trainIdx")))
    _, fits = cv2.findFundamentalMat(here, there, cv2.FM_RANSAC, _PIXELS, 0.999)
    inliers = fits.ravel().astype(bool) if fits is not None else np.zeros(len(kept), dtype=bool)
    if inliers.sum() < 8:
        return _Pair(second.name, int(inliers.sum()), 0.0)
    return _Pair(second.name, int(inliers.sum()), _by_turning(patient, first, here[inliers], there[inliers]))


def _by_turning(patient: Patient, look: Look, here: NDArray[np.float64], there: NDArray[np.float64]) -> float:
    """Share of the matches that one rotation of the camera explains."""
    height, width = look.grey.shape
    camera = patient.capture.rig.rgb.resized(width, height)
    rays = []
    for pixels in (here, there):
        slopes = (pixels + 0.5 - (camera.cx, camera.cy)) / (camera.fl_x, camera.fl_y)
        ray = np.column_stack([slopes, np.ones(len(slopes))])
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    close, kept = np.zeros(len(here), dtype=bool), np.ones(len(here), dtype=bool)
    for _ in range(5):
        u, _, vt = np.linalg.svd(rays[1][kept].T @ rays[0][kept])
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        off = np.linalg.norm(rays[1] - rays[0] @ rotation.T, axis=1) * camera.fl_x
        close = off < _PIXELS
        kept = off <= max(float(np.median(off)), _PIXELS)
    return float(close.mean())
