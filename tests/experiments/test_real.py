"""`rtgs experiment real`: rows on a scene whose scale is known, rows that are kept, and settings that are refused."""

from __future__ import annotations

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.recorder import Recorder
from tests.helpers.wall_scene import TRUTH, estimate, wall_scene

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.cli import main
from rtgs.config import ManualConfig, RealExperimentConfig
from rtgs.experiments.real import compare
from rtgs.run.folder import RunFolder
from rtgs.synthetic import SynthConfig, write_capture

pytestmark = pytest.mark.thorough

CONFIG = RealExperimentConfig(region=(20, 10, 40, 30))


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / "table3.csv").open(encoding="utf-8") as file:
        return {line["row"]: line for line in csv.DictReader(file)}


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("experiment")
    compare(*wall_scene(), estimate(TRUTH), out, CONFIG, Recorder())
    return out


def test_on_a_plane_at_its_distance_planar_is_as_good_as_ours(experiment: Path) -> None:
    rows = table(experiment)
    ours, planar, naive = (rows[key] for key in ("ours", "planar", "naive"))
    assert float(ours["psnr"]) > 45  # the pictures are of this very model
    assert float(planar["mae_c"]) < 0.15 and float(planar["psnr"]) > 35  # two interpolations
    assert float(naive["mae_c"]) > 3 * float(planar["mae_c"])
    assert float(naive["sfm_per_metre"]) == 1 and float(ours["sfm_per_metre"]) == TRUTH and planar["sfm_per_metre"] == ""


def test_at_another_distance_it_is_not(experiment: Path, tmp_path: Path) -> None:
    compare(*wall_scene(), estimate(TRUTH), tmp_path, replace(CONFIG, plane_m=4.0), Recorder())
    assert float(table(tmp_path)["planar"]["mae_c"]) > 2 * float(table(experiment)["planar"]["mae_c"])


def test_rows_that_cannot_run_say_why(experiment: Path) -> None:
    rows, text = table(experiment), (experiment / "table3.md").read_text(encoding="utf-8")
    for key, title, said in (
        ("manual", "Manual", "--manual.frames"),
        ("mast3r", "MASt3R", "mast3r"),
        ("depth", "Metric depth", "rtgs[depth]"),
    ):
        assert rows[key]["psnr"] == "" and said in rows[key]["why_not"]
        assert f"- {title} was not run" in text
    for key in ("naive", "planar", "ours"):
        assert rows[key]["why_not"] == ""
    assert "drift `off`" in text


def test_region_is_the_mean_temperature_there(experiment: Path) -> None:
    frame = wall_scene()[0].held_out_frames[0]
    shows = float(frame.thermal[10:30, 20:40].mean())
    assert f"{shows:.2f} °C" in (experiment / "table3.md").read_text(encoding="utf-8")
    assert float(table(experiment)["ours"]["region_c"]) == pytest.approx(shows, abs=0.05)


def test_a_picture_a_held_out_frame(experiment: Path) -> None:
    for frame in wall_scene()[0].held_out_frames:
        with Image.open(experiment / "pictures" / f"{frame.name}.png") as picture:
            assert picture.width > 4 * 256 and picture.height > 2 * 256


ROWS = ["Naive", "Planar", "Ours"]  # those that run on the wall


def kept(recorder: Recorder) -> list[str]:
    """Rows that were not made again."""
    return [line.removesuffix(": done before") for line in recorder.lines if line.endswith(": done before")]


def test_an_experiment_goes_on_where_it_was_stopped(experiment: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        compare(*wall_scene(), estimate(TRUTH), tmp_path, CONFIG, Recorder(stop_in="planar"))
    assert [p.name for p in (tmp_path / "rows").iterdir()] == ["naive.npz"]  # whole rows only, and nothing half written
    goes_on = Recorder()
    compare(*wall_scene(), estimate(TRUTH), tmp_path, CONFIG, goes_on)
    assert kept(goes_on) == ["Naive"]
    assert table(tmp_path) == table(experiment)


def test_a_row_is_made_again_when_its_inputs_change(experiment: Path, tmp_path: Path) -> None:
    shutil.copytree(experiment / "rows", tmp_path / "rows")
    smoother = replace(CONFIG, thermal=replace(CONFIG.thermal, sh_degree=0))
    for scale, config, expected in (
        (TRUTH, CONFIG, ROWS),
        (0.5, CONFIG, ["Naive", "Planar"]),
        (0.5, replace(CONFIG, plane_m=1.1), ["Naive", "Ours"]),
        (0.5, smoother, []),  # another thermal fit changes every row
    ):
        recorder = Recorder()
        compare(*wall_scene(), estimate(scale), tmp_path, config, recorder)
        assert kept(recorder) == expected
        assert [title for title in recorder.titles if title in ROWS] == [title for title in ROWS if title not in expected]


def test_the_page_says_how_it_was_made(experiment: Path) -> None:
    text = (experiment / "table3.md").read_text(encoding="utf-8")
    assert text.startswith("# Table III")
    assert "| command | `rtgs experiment real CAPTURE --out DIR --region 20 10 40 30` |" in text
    assert f"| version | {__version__} |" in text and str(experiment) not in text


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (RealExperimentConfig(region=(0, 0, 500, 10)), "within 48 × 44"),
        (RealExperimentConfig(region=(5, 5, 9, 9), region_frame="nope"), "no frame 'nope'"),
        (RealExperimentConfig(region=(5, 5, 9, 9), region_frame="f01"), "no held-out frame"),
        (RealExperimentConfig(manual=ManualConfig(("f01", "who"), 1.0)), "no frame 'who'"),
        (RealExperimentConfig(depth_model=Path("/nowhere")), "--depth-model"),
    ],
)
def test_bad_settings_are_refused_before_any_work(tmp_path: Path, config: RealExperimentConfig, said: str) -> None:
    recorder = Recorder()
    with pytest.raises(RtgsError, match=said):
        compare(*wall_scene(), estimate(TRUTH), tmp_path, config, recorder)
    assert recorder.titles == [] and not list(tmp_path.iterdir())


def test_a_distance_that_is_none_cannot_be_asked_for() -> None:
    with pytest.raises(RtgsError, match="plane_m"):
        RealExperimentConfig(plane_m=0.0)


def test_of_a_capture_by_one_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A capture is run to OUT/run; a run that is there keeps its settings; the table has the run's scale beside the measured one."""
    monkeypatch.setenv("RTGS_LPIPS_WEIGHTS", str(tmp_path))
    capture, out = tmp_path / "capture", tmp_path / "out"
    truth = write_capture(capture, SynthConfig(scene="lego", frames=10, size=48, supersampling=1, seed=3, thermal_clean=False))
    main(["sfm", str(capture), "--out", str(out / "run")])
    main(["rgb", str(out / "run"), "--steps", "40", "--random-points", "250", "--densify.max-gaussians", "400"])
    main(["scale", str(out / "run"), "--solver", "adam", "--steps", "5", "--scan-samples", "25"])
    standing = (out / "run" / "stages.json").read_bytes()
    ends = [truth.world_from_rgb[name].translation for name in ("frame_001", "frame_003")]
    metres = float(np.linalg.norm(ends[0] - ends[1]))
    measured = ["--manual.frames", "frame_001", "frame_003", "--manual.metres", f"{metres}"]
    main(["experiment", "real", str(capture), "--out", str(out), *measured])
    assert (out / "run" / "stages.json").read_bytes() == standing
    rows = table(out)
    assert float(rows["manual"]["sfm_per_metre"]) == pytest.approx(truth.sfm_per_metre, rel=1e-5)
    assert float(rows["ours"]["sfm_per_metre"]) == pytest.approx(RunFolder(out / "run").read_scale().sfm_per_metre, rel=1e-5)
    assert "lpips" not in rows["ours"] and "LPIPS: no weights of alexnet" in (out / "table3.md").read_text(encoding="utf-8")
