"""Scores with known answers, and the pictures beside them."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.helpers.scene_record import altered, scene_of

from rtgs.evaluation.held_out import evaluate
from rtgs.evaluation.records import ModelScores
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.metrics.basic import psnr, ssim_index
from rtgs.metrics.lpips import SMALLEST_PX, Lpips
from rtgs.models import RgbModel, SensorModel, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CELSIUS, LinearRange, RelativeCounts
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.run.summary import metric_lines

RIG = Rig(
    Camera("PINHOLE", 40, 32, 42.0, 42.0, 20.0, 16.0),
    Camera("PINHOLE", 36, 30, 40.0, 41.0, 17.5, 15.3),
    SE3(rotation_from_axis_angle([0.02, -0.03, 0.04]), np.array([0.25, -0.07, 0.03])),
)
SFM_PER_METRE = 0.6
HELD_OUT = ["000", "008"]


@lru_cache(maxsize=1)
def perfect() -> tuple[Scene, RgbModel, ThermalModel]:
    """A scene whose images are what its models render; frames 0 and 8 are held out."""
    g = torch.Generator().manual_seed(2)
    n = 120
    ball = Gaussians(
        0.6 * torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1) * SFM_PER_METRE,
        torch.randn(n, 4, generator=g),
        math.log(0.12 * SFM_PER_METRE) + 0.2 * torch.randn(n, 3, generator=g),
        torch.full((n,), 2.0),
        (torch.rand(n, 1, 3, generator=g) * 0.5 - 0.35) / C0,
    )
    settings = RenderSettings(near_plane=0.05)
    rgb = RgbModel(ball, torch.tensor([0.2, 0.4, 0.3]), settings)
    hot = replace(ball, sh=(torch.rand(n, 1, 1, generator=g) - 0.5) / C0)
    span = LinearRange(10.0, 40.0)
    thermal = ThermalModel(
        gaussians=hot,
        background=torch.tensor([0.2]),
        unit="°C",
        range=span,
        color_range=span,
        settings=settings,
        sfm_per_metre=SFM_PER_METRE,
    )
    poses = []
    for k in range(10):
        eye = SFM_PER_METRE * np.array([2.4 * math.cos(0.7 * k), 2.4 * math.sin(0.7 * k), 0.8 * math.sin(1.9 * k)])
        poses.append(look_at(eye, [0, 0, 0]))
    baseline = RIG.rgb_from_thermal.with_baseline_scaled(SFM_PER_METRE)
    scene = scene_of(
        RIG,
        poses,
        rgb=[rgb.render(RIG.rgb, pose.inverse()) for pose in poses],
        thermal=[thermal.render(RIG.thermal, (pose @ baseline).inverse()) for pose in poses],
        radiometry=CELSIUS,
    )
    return scene, rgb, thermal


def test_a_perfect_model_scores_perfectly() -> None:
    scene, rgb, thermal = perfect()
    scores = evaluate(scene, rgb, thermal, thermal)
    assert scores.rgb.known()["psnr"] > 100 and scores.rgb.known()["ssim"] == pytest.approx(1.0)
    for model in ("thermal", "thermal_naive"):
        known = scores.models[model].known()
        assert known["psnr"] > 100 and known["ssim"] == pytest.approx(1.0)
        assert known["mae_c"] == pytest.approx(0.0, abs=1e-5)
    assert scores.temperature_range_c == (10.0, 40.0) and scores.count_range is None
    assert list(scores.rgb.per_frame) == list(scores.thermal.per_frame) == HELD_OUT


def test_known_errors() -> None:
    """RGB off by 0.1 is 20 dB; 3 °C of a range of 30 °C likewise, and is a mean error of 3 °C."""
    scene, rgb, thermal = perfect()
    off = {n: scene.capture.frames[int(n)].rgb + np.float32(0.1) for n in HELD_OUT}
    warm = {n: scene.capture.frames[int(n)].thermal + np.float32(3.0) for n in HELD_OUT}
    scores = evaluate(altered(scene, rgb=off, thermal=warm), rgb, thermal)
    assert scores.rgb.known()["psnr"] == pytest.approx(20.0, abs=1e-3)
    assert scores.thermal.known()["psnr"] == pytest.approx(20.0, abs=1e-3)
    assert scores.thermal.known()["mae_c"] == pytest.approx(3.0, abs=1e-4)
    assert scores.thermal.known()["ssim"] < 1 and scores.rgb.known()["ssim"] < 1
    assert scores.thermal_naive is None and set(scores.models) == {"rgb", "thermal"}


def test_lpips_is_of_the_same_pictures() -> None:
    """RGB as shown, temperatures as gray in the fixed range; an image that is too small for the network has none."""
    scene, rgb, thermal = perfect()
    assert min(RIG.rgb.height, RIG.rgb.width) >= SMALLEST_PX > RIG.thermal.height
    lpips = Lpips.load()
    scores = evaluate(scene, rgb, thermal, lpips=lpips)
    assert scores.rgb.known()["lpips"] == pytest.approx(0.0, abs=1e-6) and scores.thermal.lpips is None
    off = {n: scene.capture.frames[int(n)].rgb[:, ::-1] for n in HELD_OUT}
    mirrored = evaluate(altered(scene, rgb=off), rgb, thermal, lpips=lpips).rgb.per_frame["008"].lpips
    view = rgb.render(RIG.rgb, scene.rgb_from_world("008"))
    assert mirrored == pytest.approx(lpips(view, off["008"])) and lpips(view, off["008"]) > 0.01
    larger = replace(RIG, thermal=Camera("PINHOLE", 36, 33, 40.0, 41.0, 17.5, 15.3))
    photographs = {n: np.full((33, 36), 20.0, np.float32) for n in HELD_OUT}
    capture = replace(scene.capture, rig=larger, thermal_mask=np.ones((33, 36), bool))
    found = evaluate(altered(replace(scene, capture=capture), thermal=photographs), rgb, thermal, lpips=lpips).thermal
    shown = thermal.render(larger.thermal, scene.thermal_from_world("000", SFM_PER_METRE))
    assert found.per_frame["000"].lpips == pytest.approx(lpips((shown - 10) / 30, np.full((33, 36), 1 / 3)), rel=1e-4)


def test_the_mean_is_of_the_frames() -> None:
    scene, rgb, thermal = perfect()
    warm = {n: scene.capture.frames[int(n)].thermal + np.float32(by) for n, by in (("000", 3.0), ("008", -0.3))}
    scores = evaluate(altered(scene, thermal=warm), rgb, thermal).thermal
    assert scores.per_frame["000"].psnr == pytest.approx(20.0, abs=1e-2)
    assert scores.per_frame["008"].psnr == pytest.approx(40.0, abs=1e-1)
    assert scores.psnr == pytest.approx(30.0, abs=1e-1) and scores.mae_c == pytest.approx(1.65, abs=1e-3)
    for metric in ("psnr", "ssim", "mae_c"):
        assert scores.known()[metric] == pytest.approx(np.mean([s.known()[metric] for s in scores.per_frame.values()]))


def test_training_frames_have_no_say() -> None:
    scene, rgb, thermal = perfect()
    others = [f for f in scene.frames if f.name not in HELD_OUT]
    ruined = altered(scene, rgb={f.name: 0 * f.rgb for f in others}, thermal={f.name: 0 * f.thermal for f in others})
    assert evaluate(ruined, rgb, thermal) == evaluate(scene, rgb, thermal)


def test_masks_are_respected() -> None:
    scene, rgb, thermal = perfect()
    rgb_mask, thermal_mask = scene.capture.rgb_mask.copy(), scene.capture.thermal_mask.copy()
    rgb_mask[:, :6], thermal_mask[24:] = False, False
    junk = altered(
        scene,
        rgb={f.name: np.where(rgb_mask[..., None], f.rgb, np.float32(1.0)) for f in scene.frames},
        thermal={f.name: np.where(thermal_mask, f.thermal, np.float32(900.0)) for f in scene.frames},
    )
    spoilt = evaluate(junk, rgb, thermal)
    assert spoilt.rgb.known()["psnr"] < 30 and spoilt.thermal.known()["mae_c"] > 10
    masked = replace(junk, capture=replace(junk.capture, rgb_mask=rgb_mask, thermal_mask=thermal_mask))
    scores = evaluate(masked, rgb, thermal)
    assert scores.rgb.known()["psnr"] > 100 and scores.rgb.known()["ssim"] == pytest.approx(1.0)
    assert scores.thermal.known()["psnr"] > 100 and scores.thermal.known()["ssim"] == pytest.approx(1.0)
    assert scores.thermal.known()["mae_c"] == pytest.approx(0.0, abs=1e-5)


def test_each_model_is_seen_from_its_own_poses() -> None:
    """The control is rendered where it was fitted, at scale 1, in the same range; nothing is fitted to the view."""
    scene, rgb, thermal = perfect()
    naive = replace(thermal, sfm_per_metre=1.0)
    scores = evaluate(scene, rgb, thermal, naive)
    for name in HELD_OUT:
        view = naive.render(RIG.thermal, scene.thermal_from_world(name, 1.0))
        a, b = ((image - 10.0) / 30.0 for image in (view, scene.capture.frames[int(name)].thermal))
        found = scores.models["thermal_naive"].per_frame[name]
        assert found.psnr == pytest.approx(psnr(a, b), abs=1e-3) and found.ssim == pytest.approx(ssim_index(a, b), abs=1e-4)
    assert scores.models["thermal_naive"].known()["psnr"] < 40 < scores.thermal.known()["psnr"]


def test_a_relative_capture_has_counts() -> None:
    scene, rgb, thermal = perfect()
    scene = replace(scene, capture=replace(scene.capture, radiometry=RelativeCounts()))
    scores = evaluate(scene, rgb, replace(thermal, unit="counts"))
    assert scores.temperature_range_c is None and scores.count_range == (10.0, 40.0)
    assert set(scores.thermal.known()) == {"psnr", "ssim", "mae_counts", "peak_counts", "peak_p90_counts"}
    assert any("counts" in line for line in metric_lines(scores)) and not any("°C" in line for line in metric_lines(scores))


def test_without_held_out_frames(tmp_path: Path) -> None:
    """A capture always holds some out, but they may have failed to register."""
    scene, rgb, thermal = perfect()
    scene = replace(scene, world_from_rgb={k: v for k, v in scene.world_from_rgb.items() if k not in HELD_OUT})
    scores = evaluate(scene, rgb, thermal, thermal, renders=tmp_path)
    assert list(scores.models.values()) == 3 * [ModelScores()]
    assert not list(tmp_path.iterdir()) and metric_lines(scores) == []


def test_pictures_are_written(tmp_path: Path) -> None:
    scene, rgb, thermal = perfect()
    mask = scene.capture.thermal_mask.copy()
    mask[:, -5:] = False
    scene = replace(scene, capture=replace(scene.capture, thermal_mask=mask))
    told: list[tuple[int, int, str]] = []
    evaluate(scene, rgb, thermal, replace(thermal, sfm_per_metre=1.0), renders=tmp_path, progress=lambda *a: told.append(a))
    assert told == [(1, 2, "000"), (2, 2, "008")]
    expected = {
        f"{k}/{n}.{w}.png"
        for k in ("rgb", "thermal", "thermal_naive")
        for n in HELD_OUT
        for w in ("reference", "render", "error")
    }
    expected |= {f"overlay/{n}.{w}.png" for n in HELD_OUT for w in ("before", "after")}
    assert {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()} == expected
    for name in expected:
        with Image.open(tmp_path / name) as picture:
            pixels = np.asarray(picture.convert("RGB"))
        camera = RIG.rgb if name.startswith("rgb/") else RIG.thermal
        assert pixels.shape[0] == camera.height, name
        if not name.endswith("error.png"):  # error maps have a colour bar at their side
            assert pixels.shape[1] == camera.width, name
    reference, render = (np.asarray(Image.open(tmp_path / "rgb" / f"000.{kind}.png")) for kind in ("reference", "render"))
    np.testing.assert_array_equal(reference, render)  # the model is perfect
    reference, render = (np.asarray(Image.open(tmp_path / "thermal" / f"008.{kind}.png")) for kind in ("reference", "render"))
    np.testing.assert_array_equal(reference[mask], render[mask])
    assert len(np.unique(reference[~mask], axis=0)) == 1  # gray where the sensor saw nothing
    before, after = (np.asarray(Image.open(tmp_path / "overlay" / f"000.{when}.png")) for when in ("before", "after"))
    assert not np.array_equal(before, after)


def test_before_a_rig_was_found_the_edges_are_those_of_where_its_search_began(tmp_path: Path) -> None:
    scene, rgb, thermal = perfect()

    def overlays(turned_deg: float, right: float) -> list[bytes]:
        pose = SE3(rotation_from_axis_angle(np.radians([0.0, turned_deg, 0.0])), np.array([right, 0.0, 0.0]))
        rig = replace(scene.rig, rgb_from_thermal=pose)
        start = replace(scene, capture=replace(scene.capture, rig=rig))
        evaluate(scene, rgb, thermal, renders=tmp_path, start=start)
        return [(tmp_path / "overlay" / f"000.{when}.png").read_bytes() for when in ("before", "after")]

    first, farther, turned = overlays(0.0, 1.0), overlays(0.0, 3.0), overlays(4.0, 1.0)
    assert first == farther  # no baseline was known
    assert first[0] != turned[0] and first[1] == turned[1]


def test_a_held_out_photograph_is_compared_with_the_drift_of_its_neighbours() -> None:
    scene, rgb, thermal = perfect()
    offsets = {frame.name: 0.5 * k for k, frame in enumerate(scene.capture.frames)}  # °C, a sensor that warms up
    frames = tuple(replace(f, thermal=f.thermal + np.float32(offsets[f.name])) for f in scene.capture.frames)
    warming = replace(scene, capture=replace(scene.capture, frames=frames))
    drift = {name: (1.0, offset) for name, offset in offsets.items() if name not in HELD_OUT}
    known, unknown = (evaluate(warming, rgb, m).thermal.per_frame for m in (replace(thermal, sensor=SensorModel(drift)), thermal))
    expected = replace(thermal, sensor=SensorModel(drift)).drift_of("008")[1]
    assert 2.0 < expected < 4.0 and unknown["008"].mae_c == pytest.approx(4.0, abs=1e-3)
    assert known["008"].mae_c == pytest.approx(4.0 - expected, abs=1e-3)
