"""A run at another origin and in another unit: the same results, given back in the frame of the poses."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from plyfile import PlyData
from tests.helpers.tiny_run import HELD_OUT, TINY, complete_stages, recorded, strict_json

import world_frame
from rtgs.cli import main
from rtgs.io.ply import read_ply
from rtgs.run.folder import RunFolder

pytestmark = pytest.mark.thorough

CASES = {"far": (1e7, 1.0), "small": (0.0, 1e-4), "large": (0.0, 1e4), "far and large": (1e7, 1e4), "far and small": (1e6, 1e-2)}


@pytest.fixture(scope="module", params=CASES)
def moved(request: pytest.FixtureRequest, capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float, float]:
    """A whole run of the moved capture, its origin and its unit."""
    root, (origin, unit) = tmp_path_factory.mktemp("moved"), CASES[request.param]
    world_frame.move_capture(capture, root / "capture", origin, unit)
    _, code = recorded(["run", str(root / "capture"), "--out", str(root / "run"), *TINY])
    assert code == 0
    return root / "run", origin, unit


def xyz(ply: Path) -> np.ndarray:
    data = PlyData.read(ply)["vertex"].data
    return np.stack([data[name] for name in "xyz"], axis=1)


def test_the_same_scores_and_the_same_scale_in_its_unit(finished: Path, moved: tuple[Path, float, float]) -> None:
    run, _, unit = moved
    expected, found = (strict_json(folder / "metrics.json") for folder in (finished, run))
    for kind in ("rgb", "thermal"):
        for name in ("psnr", "ssim") + (("mae_c",) if kind == "thermal" else ()):
            assert found[kind][name] == pytest.approx(expected[kind][name], rel=5e-4), (kind, name)
    scale, first = RunFolder(run).read_scale(), RunFolder(finished).read_scale()
    assert scale.sfm_per_metre == pytest.approx(unit * first.sfm_per_metre, rel=1e-4)
    assert scale.bracket == pytest.approx([unit * s for s in first.bracket], rel=1e-4)
    assert scale.status == first.status
    # To three digits: this run does not decide the scale (the deviation is as large as it), and a flat loss magnifies rounding.
    assert scale.std_log == pytest.approx(first.std_log, rel=5e-3)


def test_what_a_user_sees_is_in_the_frame_of_the_poses(finished: Path, moved: tuple[Path, float, float]) -> None:
    run, origin, unit = moved
    shift, step = origin * world_frame.DIRECTION, np.spacing(max(origin, 10.0 * unit))
    formats = ["ply", "colmap", "nerfstudio"]
    main(["export", str(run), "--out", str(run.parent / "export"), "--frame", "sfm", "--format", *formats])
    given = world_frame.given_positions(run.parent / "capture")
    # COLMAP stores a quaternion: a rotation's last digits, times the distance from the origin, move the camera a little.
    for folder in (run / "scene", run.parent / "export" / "colmap" / "sparse" / "0"):
        found = world_frame.positions_of_model(folder)
        assert max(np.abs(found[n] - given[n]).max() for n in given) < 40 * step
    written = world_frame.positions_of_transforms(run.parent / "export" / "nerfstudio" / "transforms.json")
    assert max(np.abs(written[n] - given[n]).max() for n in given) < 15 * step
    for name in ("rgb", "thermal"):
        here = xyz(run / f"{name}.ply")
        assert here.dtype == (np.float64 if origin else np.float32)
        np.testing.assert_array_equal(here, xyz(run.parent / "export" / f"{name}.ply"))
        expected = unit * xyz(finished / f"{name}.ply").astype(np.float64) + shift
        np.testing.assert_allclose(here, expected, rtol=0, atol=3e-5 * unit + step)
    near = [json.loads((folder / "rgb.json").read_text())["settings"]["near_plane"] for folder in (finished, run)]
    assert near[1] == pytest.approx(unit * near[0], rel=1e-6)


def test_depth_and_metres_are_those_of_the_scene(finished: Path, moved: tuple[Path, float, float], tmp_path: Path) -> None:
    run, _, _ = moved
    for folder, out in ((finished, tmp_path / "a"), (run, tmp_path / "b")):
        main(["render", str(folder), "--out", str(out), "--frames", HELD_OUT[0]])
        main(["export", str(folder), "--out", str(out / "metres")])
    a, b = (np.asarray(Image.open(tmp_path / side / f"{HELD_OUT[0]}.depth.tiff")) for side in "ab")
    np.testing.assert_allclose(b, a, rtol=2e-3)
    metres, moved_metres = (xyz(tmp_path / side / "metres" / "rgb.ply").astype(np.float64) for side in "ab")
    # In metres the origin is the given one, or amid the cameras where the given one is far away.
    a, b = (cloud - np.median(cloud, axis=0) for cloud in (metres, moved_metres))
    np.testing.assert_allclose(b, a, atol=2e-4 * np.abs(a).max())


def test_an_imported_model_comes_in_through_the_same_world(moved: tuple[Path, float, float], tmp_path: Path) -> None:
    run = moved[0]
    shutil.copy(run / "rgb.ply", tmp_path / "theirs.ply")
    out = tmp_path / "run"
    _, code = recorded(["run", str(run.parent / "capture"), "--out", str(out), "--rgb-ply", str(tmp_path / "theirs.ply"), *TINY])
    assert code == 0
    mine, theirs = RunFolder(run).read_rgb().gaussians, RunFolder(out).read_rgb().gaussians
    torch.testing.assert_close(theirs.means, mine.means, rtol=1e-6, atol=2e-6)
    torch.testing.assert_close(theirs.log_scales, mine.log_scales, rtol=0, atol=2e-6)


def test_a_run_of_an_earlier_version_goes_on_in_the_given_frame(run: Path) -> None:
    """Such a run has no world of its own; its models are as they were."""
    (run / "scene" / "world.json").unlink()
    folder = RunFolder(run)
    assert folder.given_from_world.factor == 1.0
    assert torch.equal(folder.read_rgb().gaussians.means, read_ply(run / "rgb.ply").means)
    assert complete_stages(run) == ["sfm", "rgb", "scale", "thermal", "spots", "evaluate"]
    before = strict_json(run / "metrics.json")
    main(["eval", str(run)])
    for kind in ("rgb", "thermal"):
        assert strict_json(run / "metrics.json")[kind]["psnr"] == pytest.approx(before[kind]["psnr"], rel=1e-4)


def test_a_scene_of_an_earlier_version_far_from_the_origin_is_told(moved: tuple[Path, float, float], tmp_path: Path) -> None:
    run, origin, _ = moved
    old = Path(shutil.copytree(run, tmp_path / "run"))
    (old / "scene" / "world.json").unlink()
    recorder, code = recorded(["rgb", str(old), "--steps", "10"])
    assert code == 0
    assert any("Remove the folder scene/" in line for line in recorder.lines) == bool(origin)
    if origin:
        shutil.rmtree(old / "scene")
        recorder, code = recorded(["rgb", str(old)])
        assert code == 0 and not any("scene/" in line for line in recorder.lines)
        assert RunFolder(old).given_from_world.factor < 1e6
