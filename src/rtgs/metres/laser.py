"""Metres from a drone's laser range finder: the distance to what the middle of the photograph shows."""

from __future__ import annotations

import math

import numpy as np

from rtgs.config.metres import MetresSourceName
from rtgs.metres.evidence import Evidence, Source
from rtgs.records.metres import MetresSource

_ACCURACY_M, _ACCURACY = 0.2, 0.0015  # DJI states ± (0.2 m + 0.15 %)
_AIM = 0.03  # of the image's width, around the middle: where the laser points
_LEAST_POINTS = 8
_ROUNDS = 4  # of leaving out points that are of something else
_WIDEST = 0.3
_FAR = 3.5  # robust standard deviations, from which on a reading hit something else


class LaserSource:
    """Laser ranges beside the depth of the sparse points in the middle of the image."""

    name: MetresSourceName = "laser"

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        refused = [tags.laser_refused for tags in evidence.tags.values() if tags.laser_refused]
        measured = {name: tags.laser_m for name, tags in evidence.tags.items() if tags.laser_m is not None}
        if not measured:
            return f"{len(refused)} laser ranges are marked as invalid: {refused[0]}" if refused else ""
        logs, stds = [], []
        for name, metres in measured.items():
            distance = _distance_in_the_middle(evidence, name)
            if distance is not None:
                logs.append(math.log(distance[0] / metres))
                stds.append(math.hypot((_ACCURACY_M + _ACCURACY * metres) / metres, distance[1]))
        if not logs:
            return f"{len(measured)} photographs have a laser range, and no sparse points in their middle"
        ratio, std = np.array(logs), np.array(stds)
        middle = np.median(ratio)
        spread = max(1.4826 * float(np.median(np.abs(ratio - middle))), float(np.median(std)))
        kept = np.abs(ratio - middle) <= _FAR * spread
        weights = kept / std**2
        mean = float((weights * ratio).sum() / weights.sum())
        apart = float((weights * (ratio - mean) ** 2).sum()) / max(int(kept.sum()) - 1, 1)
        # What the range finder states is its accuracy, the same in all of its readings; more readings only average the scene's part.
        accuracy = float(np.median([(_ACCURACY_M + _ACCURACY * m) / m for m in measured.values()]))
        std_log = math.hypot(math.sqrt(max(1.0, apart) / float(weights.sum())), accuracy)
        if std_log > _WIDEST:
            return f"laser ranges and depths of sparse points agree only to {100 * std_log:.0f} %"
        text = f"laser ranges of {int(kept.sum())} photographs, {len(refused)} refused as invalid, beside the sparse points in their middle"
        return [MetresSource(self.name, math.exp(mean), std_log, text)]


def _distance_in_the_middle(evidence: Evidence, name: str) -> tuple[float, float] | None:
    """Distance of what the middle of a photograph shows, in SfM units, and its relative standard deviation.

    Sparse points around the middle are taken for points of a plane: then 1/z is linear in the pixel. Their median would be too far
    away where the ground is seen at a slant, since a pixel farther up holds more of it.
    """
    camera = evidence.scene.rig.rgb
    seen = evidence.poses[name].inverse().apply(evidence.points.xyz)
    seen = seen[seen[:, 2] > 0]
    middle = np.array([camera.width / 2, camera.height / 2])
    away = camera.project(seen) - middle
    near = np.abs(away).max(axis=1) < _AIM * camera.width
    if near.sum() < _LEAST_POINTS:
        return None
    inverse, plane = 1 / seen[near, 2], np.column_stack([np.ones(int(near.sum())), away[near] / camera.fl_x])
    weights = np.ones(len(inverse))
    for _ in range(_ROUNDS):
        fit = np.linalg.lstsq(plane * weights[:, None], inverse * weights, rcond=None)[0]
        off = np.abs(inverse - plane @ fit)
        spread = max(1.4826 * float(np.median(off)), 1e-12 * float(inverse.mean()))
        weights = (off < _FAR * spread).astype(np.float64)
    if not fit[0] > 0:
        return None
    ray = math.hypot(1.0, *((middle - (camera.cx, camera.cy)) / (camera.fl_x, camera.fl_y)))
    return ray / float(fit[0]), max(spread / float(fit[0]) / math.sqrt(weights.sum()), 1e-3)


SOURCE: Source = LaserSource()
