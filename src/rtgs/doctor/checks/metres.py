"""What each source of metres would give."""

from __future__ import annotations

import math

import numpy as np

from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding
from rtgs.io.metres_file import NAME, USUAL_STD, CameraDistance, PointDistance, read_metres_file
from rtgs.maths.wgs84 import enu_from_places

_UNSTATED_M = 3.0  # a phone's or a drone's GPS
_USEFUL = 0.15


def check(patient: Patient) -> list[Finding]:
    """Standard deviations of lengths by source, as far as they can be told beforehand."""
    return [*_baseline(patient), *_gps(patient), *_file(patient), *_laser(patient)]


def _baseline(patient: Patient) -> list[Finding]:
    start = patient.capture.rig.start
    if start is not None and start.baseline_m is None:
        return [Finding("metres", "note", 'no metres from the baseline: rig.json does not give its length ("baseline_m")')]
    std = patient.capture.rig.calibration_std
    said = (
        f"known to {100 * std.baseline_length:.2g} %"
        if std and std.baseline_length
        else "whose error rig.json does not state (uncertainty.baseline_length)"
    )
    text = f"metres from the baseline: {patient.capture.rig.baseline_m:.3g} m, {said}, and what the images leave open"
    return [Finding("metres", "note", text)]


def _gps(patient: Patient) -> list[Finding]:
    tags = [t.position for t in patient.tags if t.position is not None]
    refused = [t.position_refused for t in patient.tags if t.position_refused]
    found = []
    if refused:
        text = f"{len(refused)} photographs have a position that cannot be used: {refused[0]}"
        found.append(Finding("metres", "note", text))
    known = [p for p in tags if p.altitude_m is not None]
    if len(known) < 4:
        return found
    places = np.array([(p.latitude_deg, p.longitude_deg, p.altitude_m) for p in known], dtype=np.float64)
    spread = float(np.linalg.norm(enu_from_places(places, places[0]).std(axis=0)))
    stated = [p.std_m[0] for p in known if p.std_m is not None]
    std = float(np.median(stated)) if stated else _UNSTATED_M
    expected = std / max(spread, 1e-6) / math.sqrt(len(known))
    said = f"{std:.2g} m, as the files state" if stated else f"about {std:g} m (the files state no accuracy)"
    text = f"metres from {known[0].source}: {len(known)} positions over {spread:.3g} m, each good to {said}"
    text += f": lengths to about {100 * expected:.2g} %"
    if expected > _USEFUL:
        text += ", which is too little to be used"
    return [*found, Finding("metres", "note", text)]


def _file(patient: Patient) -> list[Finding]:
    file = read_metres_file(patient.capture.root)
    distances: list[CameraDistance | PointDistance] = [*file.camera_distances, *file.point_distances]
    found = []
    if distances:
        best = min((d.std_m or USUAL_STD * d.metres) / d.metres for d in distances)
        found.append(
            Finding("metres", "note", f"metres from {NAME}: {len(distances)} known distances, the best to {100 * best:.2g} %")
        )
    if file.board is not None or file.tags is not None:
        found.append(Finding("metres", "note", f"metres from {NAME}: a board or tags in the scene, usually to 0.1 to 0.5 %"))
    return found


def _laser(patient: Patient) -> list[Finding]:
    ranges = [t.laser_m for t in patient.tags if t.laser_m is not None]
    refused = sum(bool(t.laser_refused) for t in patient.tags)
    if not ranges and not refused:
        return []
    text = f"metres from the laser range finder: {len(ranges)} ranges, {refused} refused as invalid"
    if ranges:
        text += (
            f"; at {np.median(ranges):.3g} m lengths are good to about {100 * (0.2 / float(np.median(ranges)) + 0.0015):.2g} %"
        )
    return [Finding("metres", "note", text)]
