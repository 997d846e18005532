"""Metres from known distances: between cameras, or between points picked in the images."""

from __future__ import annotations

import math

import numpy as np

from rtgs.config.metres import MetresSourceName
from rtgs.io.metres_file import USUAL_STD, CameraDistance, PointDistance
from rtgs.metres.evidence import Evidence, Source
from rtgs.metres.rays import meeting_point, slopes_of
from rtgs.records.metres import MetresSource

_WIDEST = 0.3  # standard deviation of ln s from which on a distance says nothing


class DistanceSource:
    """Every known distance is an estimate of its own, so that a wrong one is seen."""

    name: MetresSourceName = "distance"

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        given = (CameraDistance((a, b), metres) for a, b, metres in evidence.config.distances)
        distances: list[CameraDistance | PointDistance] = [
            *evidence.file.camera_distances,
            *given,
            *evidence.file.point_distances,
        ]
        found, reasons = [], []
        for number, distance in enumerate(distances, start=1):
            name = self.name if len(distances) == 1 else f"{self.name} {number}"
            if isinstance(distance, CameraDistance):
                result = _between_cameras(evidence, name, distance)
            else:
                result = _between_points(evidence, name, distance)
            if isinstance(result, MetresSource):
                found.append(result)
            else:
                reasons.append(f"{name}: {result}")
        return found or "; ".join(reasons)


def _between_cameras(evidence: Evidence, name: str, distance: CameraDistance) -> MetresSource | str:
    missing = [frame for frame in distance.frames if frame not in evidence.poses]
    if missing:
        return f"frame {missing[0]} has no pose"
    a, b = (evidence.poses[frame].translation for frame in distance.frames)
    length = float(np.linalg.norm(a - b))
    text = f"{distance.metres:g} m between the RGB cameras of frames {distance.frames[0]} and {distance.frames[1]}"
    return _source(name, length, math.sqrt(2) * evidence.position_std, distance, text)


def _between_points(evidence: Evidence, name: str, distance: PointDistance) -> MetresSource | str:
    camera, ends = evidence.scene.capture.raw_rig.rgb, []
    for picked in (distance.first, distance.second):
        missing = [frame for frame in picked if frame not in evidence.poses]
        if missing:
            return f"frame {missing[0]} has no pose"
        slopes = slopes_of(camera, np.array(list(picked.values())))
        end = meeting_point([evidence.poses[frame] for frame in picked], slopes, distance.pick_px / camera.fl_x)
        if end is None:
            return f"the rays through the pixels in {' and '.join(picked)} do not meet in front of the cameras"
        ends.append(end)
    (a, covariance_a), (b, covariance_b) = ends
    length = float(np.linalg.norm(a - b))
    along = (b - a) / max(length, 1e-300)
    std = math.sqrt(float(along @ (covariance_a + covariance_b) @ along))
    frames = sorted({*distance.first, *distance.second})
    text = f"{distance.metres:g} m between two points picked in {len(frames)} images, {', '.join(frames[:4])}"
    return _source(name, length, std, distance, text)


def _source(
    name: str, length: float, length_std: float, distance: CameraDistance | PointDistance, text: str
) -> MetresSource | str:
    if not length > 0:
        return "both ends coincide"
    std_m = USUAL_STD * distance.metres if distance.std_m is None else distance.std_m
    std_log = math.hypot(std_m / distance.metres, length_std / length)
    if std_log > _WIDEST:
        return f"{text}: the images place its ends only to {100 * length_std / length:.0f} % of the distance"
    return MetresSource(name, length / distance.metres, std_log, f"{text}, known to {1000 * std_m:.2g} mm")


SOURCE: Source = DistanceSource()
