"""Synthetic captures: the files follow the conventions, the truth is exact, each option does what it says and no more."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.helpers.synthetic_captures import SMALL, clean_c, file_bytes, thermal_c

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3, is_rotation
from rtgs.synthetic import SCENES, GroundTruth, SynthConfig, write_capture

pytest.importorskip("embreex")


@pytest.fixture(scope="module", params=SCENES)
def capture(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GroundTruth]:
    out = tmp_path_factory.mktemp("capture") / request.param
    return out, write_capture(out, SynthConfig(scene=request.param, frames=4, size=64, thermal_size=56, seed=1))


@pytest.mark.thorough
def test_files_follow_the_conventions(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    names = [f"frame_{i:03d}" for i in range(4)]
    assert sorted(p.name for p in (folder / "rgb").iterdir()) == [f"{n}.png" for n in names]
    assert sorted(p.name for p in (folder / "thermal").iterdir()) == [f"{n}.tiff" for n in names]
    assert not list(folder.rglob("*.tmp"))
    for name in names:
        rgb = Image.open(folder / "rgb" / f"{name}.png")
        thermal = np.asarray(Image.open(folder / "thermal" / f"{name}.tiff"))
        assert rgb.size == (64, 64) and rgb.mode == "RGB"
        assert thermal.shape == (56, 56) and thermal.dtype == np.uint16
        assert clean_c(folder, name).dtype == np.float32
    rig = json.loads((folder / "rig.json").read_text())
    assert ("thermal_from_rgb" in rig) + ("rgb_from_thermal" in rig) == 1
    t = np.array(rig["rgb_from_thermal"])
    assert is_rotation(t[:3, :3], 1e-9) and np.linalg.norm(t[:3, 3]) == pytest.approx(0.20)
    assert abs(t[0, 3]) > 0.9 * np.linalg.norm(t[:3, 3])  # mostly sideways
    assert 1 < math.degrees(math.acos((np.trace(t[:3, :3]) - 1) / 2)) < 6
    transforms = json.loads((folder / "transforms.json").read_text())
    assert [f["file_path"] for f in transforms["frames"]] == [f"rgb/{n}.png" for n in names]
    assert all(transforms[k] == rig["rgb"][k] for k in ("fl_x", "fl_y", "cx", "cy"))
    assert (transforms["w"], transforms["h"]) == (64, 64)
    assert truth.rig.rgb.width == 64 and truth.rig.thermal.width == 56


def test_written_poses_are_the_true_ones_in_another_unit_and_axes(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    for entry in json.loads((folder / "transforms.json").read_text())["frames"]:
        name = Path(entry["file_path"]).stem
        written = np.array(entry["transform_matrix"])
        true = truth.world_from_rgb[name]
        np.testing.assert_allclose(written[:3, 3], truth.sfm_per_metre * true.translation, rtol=1e-12)
        np.testing.assert_allclose(written[:3, :3], true.rotation * [1, -1, -1], atol=1e-12)  # OpenGL: y up, z backwards
        assert written[:3, 1] @ [0, 0, 1] > 0  # the image's up is the world's


def test_thermal_pose_is_the_rgb_pose_with_the_rig(capture: tuple[Path, GroundTruth]) -> None:
    """Eq. 1: `world_from_thermal = world_from_rgb ∘ (R, s·t)`, in metres and in SfM units."""
    _, truth = capture
    s = truth.sfm_per_metre
    for name, pose in truth.world_from_rgb.items():
        thermal = truth.world_from_thermal[name]
        np.testing.assert_allclose((pose @ truth.rig.rgb_from_thermal).matrix(), thermal.matrix(), atol=1e-12)
        in_sfm = SE3(pose.rotation, s * pose.translation) @ truth.rig.rgb_from_thermal.with_baseline_scaled(s)
        np.testing.assert_allclose(in_sfm.translation, s * thermal.translation, rtol=1e-9, atol=1e-12)


def test_ground_truth_file_holds_what_is_returned(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    stored = json.loads((folder / "ground_truth.json").read_text())
    assert stored == json.loads(json.dumps(truth.to_json()))
    assert stored["sfm_per_metre"] == truth.sfm_per_metre and stored["config"]["seed"] == 1


def test_temperatures_span_20_degrees_and_are_no_copy_of_the_colours(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    low, high = truth.temperature_range_c
    assert high - low > 20
    inner_span, correlations = [], []
    for name in truth.world_from_rgb:
        clean = clean_c(folder, name)
        seen = clean != np.float32(truth.background_c)
        assert seen.mean() > 0.05
        inner_span += [*np.percentile(clean[seen], [2, 98])]
        gray = np.asarray(
            Image.open(folder / "rgb" / f"{name}.png").convert("L").resize((56, 56), Image.Resampling.BOX), dtype=float
        )
        correlations.append(np.corrcoef(gray[seen], clean[seen])[0, 1])
    assert max(inner_span) - min(inner_span) > 15  # not one hot speck
    assert np.abs(correlations).max() < 0.6


def test_noise_is_as_asked(capture: tuple[Path, GroundTruth]) -> None:
    folder, truth = capture
    error = np.stack([thermal_c(folder, n) - clean_c(folder, n) for n in truth.world_from_rgb])
    assert error.std() == pytest.approx(math.hypot(truth.config.netd_c, 0.01 / math.sqrt(12)), rel=0.03)
    assert abs(error.mean()) < 0.002


def test_same_seed_same_bytes_and_another_seed_another_capture(tmp_path: Path) -> None:
    write_capture(tmp_path / "a", SMALL)
    write_capture(tmp_path / "b", SMALL)
    write_capture(tmp_path / "c", replace(SMALL, seed=4))
    a, b, c = (file_bytes(tmp_path / x) for x in "abc")
    assert a == b
    assert all(a[k] != c[k] for k in a if k != "rig.json")


def test_unit_changes_poses_only(tmp_path: Path) -> None:
    write_capture(tmp_path / "a", replace(SMALL, sfm_per_metre=1.0))
    write_capture(tmp_path / "b", replace(SMALL, sfm_per_metre=7.0))
    a, b = file_bytes(tmp_path / "a"), file_bytes(tmp_path / "b")
    assert {k for k in a if a[k] != b[k]} == {"transforms.json", "ground_truth.json"}


def test_progress_and_rewriting(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    write_capture(tmp_path / "a", replace(SMALL, frames=3, size=16), progress=lambda done, of: seen.append((done, of)))
    assert seen == [(1, 3), (2, 3), (3, 3)]
    write_capture(tmp_path / "a", replace(SMALL, frames=1, size=16))
    assert [p.name for p in (tmp_path / "a" / "rgb").iterdir()] == ["frame_000.png"]


def test_other_peoples_files_are_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "capture"
    (mine / "rgb").mkdir(parents=True)
    (mine / "rgb" / "frame_000.png").write_bytes(b"a real capture, by chance with the same names")
    before = file_bytes(mine)
    with pytest.raises(RtgsError, match="other than a synthetic capture"):
        write_capture(mine, SMALL)
    assert file_bytes(mine) == before
    write_capture(tmp_path / "b", replace(SMALL, frames=1, size=16))
    (tmp_path / "b" / "notes.txt").write_text("mine")
    with pytest.raises(RtgsError, match=r"notes\.txt"):
        write_capture(tmp_path / "b", SMALL)
    with pytest.raises(RtgsError, match="is a file"):
        write_capture(tmp_path / "b" / "notes.txt", SMALL)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scene": "teapot"}, {"frames": 0}, {"size": 4}, {"thermal_size": 0}, {"supersampling": 0}, {"seed": -1},
        {"netd_c": -0.1}, {"baseline_m": math.nan}, {"blur_px": math.inf}, {"gain_jitter": 1.0}, {"rig_length_error": -1.0},
        {"features": ("stripes",)}, {"thermal_focal_error": math.nan}, {"rig_direction_error": math.inf}, {"sfm_per_metre": 0.0},
    ],
)  # fmt: skip
def test_impossible_requests_name_their_field(tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises(RtgsError, match=next(iter(wrong))):
        write_capture(tmp_path / "x", replace(SMALL, **wrong))
    assert not (tmp_path / "x").exists()


@pytest.mark.thorough
def test_features_and_distractors_change_thermal_images_alone(tmp_path: Path) -> None:
    plain = SynthConfig(scene="hotdog", frames=24, size=64, thermal_size=80, supersampling=1, seed=3)
    write_capture(tmp_path / "plain", plain)
    truth = write_capture(tmp_path / "features", replace(plain, features=("spots",), distractor=True))
    a, b = file_bytes(tmp_path / "plain"), file_bytes(tmp_path / "features")
    assert all(a[k] == b[k] for k in a if not k.startswith(("thermal/", "ground_truth")))
    for name in truth.world_from_rgb:
        before, after = clean_c(tmp_path / "plain", name), clean_c(tmp_path / "features", name)
        without = "ground_truth/thermal_{}/" + name + ".tiff"
        assert b[without.format("without_features")] == a[without.format("clean")]
        excess = (after - before).astype(np.float64)
        assert np.abs(excess).max() <= 15.001 and (name not in truth.features[0].views or np.abs(excess).max() > 10)
        photographed = thermal_c(tmp_path / "features", name) - thermal_c(tmp_path / "plain", name)
        added = truth.distractors[name].excess(truth.rig.thermal) if name in truth.distractors else 0
        np.testing.assert_allclose(photographed, excess + added, atol=0.0101)  # the same noise; counts are 0.01 °C
    stored = json.loads((tmp_path / "features" / "ground_truth.json").read_text())
    assert (
        stored["features"][0]["fwhm_m"] == truth.features[0].fwhm_m and stored["distractors"].keys() == truth.distractors.keys()
    )
    assert "features" not in json.loads((tmp_path / "plain" / "ground_truth.json").read_text())
