"""A rig that a run found, kept for the next capture."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tests.helpers.made_up_run import estimate, make_run
from tests.helpers.scale_scenes import RIG, spiral
from tests.helpers.tiny_run import recorded
from tests.helpers.unknown_rig import unknown

from rtgs.base.errors import RtgsError
from rtgs.io.rig import read_rig, write_rig
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.metres.combine import combine
from rtgs.records.camera import Camera
from rtgs.records.metres import MetresSource
from rtgs.records.radiometry import CELSIUS
from rtgs.run.folder import RunFolder
from rtgs.run.found_rig import refuse_undecided, rig_of, uncertainty_of, zoomed
from rtgs.scale import ScaleEstimate, estimate_scale
from rtgs.scale.records import FoundRig, Freedom, Refinement

FOUND = FoundRig(True, True, 0.5, 0.02, 0.2, 0.9, 0.8, 9.0, (0.8, 0.1), 9.0)
POSE = SE3(rotation_from_axis_angle(np.array([0.02, -0.05, 0.01])), np.array([0.19, -0.05, 0.03]))
ALONG = POSE.translation / np.linalg.norm(POSE.translation)
FREEDOMS = (
    *(Freedom(f"rotation about {name}", "°", 1.0, std, 8.7, True) for name, std in (("x", 0.05), ("y", 0.2), ("z", 0.1))),
    Freedom("thermal focal length", "%", 3.0, 0.4, 8.7, True),
    *(
        Freedom(f"baseline's share {name}", "%", 100 * share, 2.0, 100.0, True)
        for name, share in zip(("to the right", "downwards", "forwards"), ALONG, strict=True)
    ),
)
REFINEMENT = Refinement.of(1.0, FREEDOMS, np.diag([1.0, *(f.std**2 for f in FREEDOMS)]), replace(RIG, rgb_from_thermal=POSE))


def found(of: ScaleEstimate | None = None, refinement: Refinement = REFINEMENT) -> ScaleEstimate:
    return replace(of or estimate(), status="ok", calibration=FOUND, refinement=refinement)


def changed(**fields: Any) -> ScaleEstimate:
    return replace(found(), **fields)


def open_freedom(index: int) -> ScaleEstimate:
    freedoms = tuple(replace(f, decided=f.decided and i != index) for i, f in enumerate(FREEDOMS))
    return changed(refinement=replace(REFINEMENT, freedoms=freedoms))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (estimate, "not found from the capture"),
        (lambda: open_freedom(1), "do not decide: rotation about y"),
        (lambda: open_freedom(3), "do not decide: thermal focal length"),
        (lambda: changed(calibration=replace(FOUND, baseline_decided=False)), "do not decide: length of the baseline"),
        (lambda: changed(status="unobservable", ci95=None, reason="two places fit"), "in doubt: two places fit"),
        (lambda: changed(status="unobservable", baseline_m=None, reason="no length"), "baseline_m"),
    ],
)
def test_what_is_not_decided_is_not_written(make: Callable[[], ScaleEstimate], said: str, tmp_path: Path) -> None:
    refuse_undecided(tmp_path, found())
    with pytest.raises(RtgsError, match=said):
        refuse_undecided(tmp_path, make())


def test_the_uncertainty_is_that_of_the_least_certain_direction() -> None:
    std = uncertainty_of(REFINEMENT, 0.01)
    assert std.baseline_length == 0.01 and std.thermal_focal == pytest.approx(0.004)
    assert std.rotation_rad == pytest.approx(math.radians(0.2)) and std.baseline_direction == pytest.approx(0.02)
    # What is open along the baseline belongs to its length alone.
    spread = np.diag([f.std / 100 for f in FREEDOMS[4:]]) ** 2 + 0.3**2 * np.outer(ALONG, ALONG)
    deviations = np.sqrt(np.diag(spread))
    freedoms = (*FREEDOMS[:4], *(replace(f, std=100 * float(s)) for f, s in zip(FREEDOMS[4:], deviations, strict=True)))
    correlation = np.eye(8)
    correlation[5:, 5:] = spread / np.outer(deviations, deviations)
    wide = replace(REFINEMENT, freedoms=freedoms, correlation=tuple(tuple(row) for row in correlation.tolist()))
    assert uncertainty_of(wide, 0.01).baseline_direction == pytest.approx(0.02, rel=1e-6)


def test_a_lens_follows_its_focal_length() -> None:
    """Images are undistorted with the focal length that the search starts from: what is written has to bend as that did."""
    before = Camera("OPENCV", 64, 48, 80.0, 80.0, 33.0, 23.0, k1=-0.3, k2=0.1, p1=0.002, p2=-0.001)
    after = zoomed(before, 1.1, 1.1)
    rays = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 2))

    def pixels(camera: Camera, slopes: np.ndarray) -> np.ndarray:
        points = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
        lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2])
        return cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.opencv_matrix, lens)[0]

    np.testing.assert_allclose(pixels(after, rays), pixels(before, 1.1 * rays), atol=1e-9)
    with pytest.raises(RtgsError, match="fisheye"):
        zoomed(Camera("OPENCV_FISHEYE", 64, 48, 80.0, 80.0, 32.0, 24.0), 1.1, 1.1)


def test_the_length_is_that_of_other_metres_where_rig_json_gives_none(tmp_path: Path) -> None:
    scene, _ = spiral(1, RIG, 1.0)
    pose = SE3(POSE.rotation, ALONG)
    refinement = replace(REFINEMENT, rgb_from_thermal=tuple(tuple(row) for row in pose.matrix().tolist()))
    of = replace(found(refinement=refinement), sfm_per_metre=0.5, std_log=0.03, baseline_m=None, status="unobservable")
    of = replace(of, metres=combine([MetresSource("gps", 2.0, 0.04, "RTK")]))
    refuse_undecided(tmp_path, of)
    rig = rig_of(of, scene.capture)
    assert rig.baseline_m == pytest.approx(0.25) and rig.calibration_std is not None
    assert rig.calibration_std.baseline_length == pytest.approx(0.05)


@pytest.mark.thorough
def test_a_rig_that_was_found_is_read_again_as_it_was(tmp_path: Path) -> None:
    scene, model = spiral(1, RIG, 1.0)
    start = unknown(scene, turned=(5.0, -6.0, 4.0), baseline_m=RIG.baseline_m)
    start = replace(start, capture=replace(start.capture, raw_rig=start.capture.rig))
    of = estimate_scale(start, model)
    refuse_undecided(tmp_path, of)
    write_rig(tmp_path / "rig.json", rig_of(of, start.capture), CELSIUS)
    again, there = read_rig(tmp_path / "rig.json").rig, of.refined_scene(start).rig
    assert again.start is None and again.rgb == there.rgb and again.thermal.fl_x == pytest.approx(there.thermal.fl_x, rel=1e-12)
    np.testing.assert_allclose(again.rgb_from_thermal.matrix(), there.rgb_from_thermal.matrix(), atol=1e-12)
    std = again.calibration_std
    assert std is not None and 0 < std.rotation_rad < math.radians(2) and 0 < std.thermal_focal < 0.05
    assert 0 < std.baseline_direction < 1


@pytest.mark.thorough
def test_the_command_writes_it_outside_of_the_capture(run: Path, capture: Path, tmp_path: Path) -> None:
    folder, out = RunFolder(run), tmp_path / "kept" / "rig.json"
    raw = folder.load_capture().raw_rig
    focal = 1.02 * raw.thermal.fl_x
    folder.write_scale(found(folder.read_scale(), replace(REFINEMENT, fl_x=focal, fl_y=focal)))
    recorder, code = recorded(["calibrate", str(run), "--write", str(out)])
    assert code == 0 and any("baseline" in line for line in recorder.lines)
    file = read_rig(out)
    assert not file.warnings and file.rig.thermal.fl_x == pytest.approx(focal) and file.rig.rgb == raw.rgb
    np.testing.assert_allclose(file.rig.rgb_from_thermal.matrix(), POSE.matrix(), atol=1e-12)
    assert file.radiometry == folder.load_capture().radiometry
    before = (capture / "rig.json").read_bytes()
    assert recorded(["calibrate", str(run), "--write", str(capture / "rig.json")])[1] == 2
    assert (capture / "rig.json").read_bytes() == before


def test_a_run_of_a_calibrated_rig_has_nothing_to_keep(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert recorded(["calibrate", str(run), "--write", str(tmp_path / "rig.json")])[1] == 2
    assert recorded(["calibrate", "from-run", str(run), "--write", str(tmp_path / "rig.json")])[1] == 2
    assert not (tmp_path / "rig.json").exists()
