"""`rtgs render`: pictures, temperatures and depth that lie pixel for pixel on top of each other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.helpers.tiny_run import recorded, state

from rtgs.base.errors import RtgsError
from rtgs.cli import main
from rtgs.images.pictures import to_picture
from rtgs.records.radiometry import ObjectParameters, PlanckCalibration, PlanckRadiometry
from rtgs.renderer import render
from rtgs.run.folder import RunFolder
from rtgs.run.views import render_views


@pytest.mark.parametrize("viewpoint", ["rgb", "thermal"])
def test_render_writes_aligned_views(run: Path, tmp_path: Path, viewpoint: str) -> None:
    names = ["frame_003", "frame_008"]
    out = tmp_path / "views"
    assert recorded(["render", str(run), "--out", str(out), "--frames", *names, "--viewpoint", viewpoint])[1] == 0
    assert sorted(p.name for p in out.iterdir()) == sorted(
        f"{n}.{k}" for n in names for k in ("rgb.png", "thermal.png", "thermal.tiff", "depth.tiff")
    )
    folder = RunFolder(run)
    scene = folder.load_scene()
    rgb, thermal, scale = folder.read_rgb(), folder.read_thermal(), folder.read_scale()
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
        expected = (view.depth / view.alpha).numpy()[seen] / scene.world_per_metre(scale.sfm_per_metre)
        np.testing.assert_allclose(read["depth.tiff"][seen], expected, rtol=1e-5)
        assert np.isnan(read["depth.tiff"][~seen]).all()


def test_render_under_another_emissivity(capture: Path, run: Path, tmp_path: Path) -> None:
    """Where rig.json has Planck constants; the images are those of the same run, taken through the camera's formula."""
    radiometry = PlanckRadiometry(
        PlanckCalibration(15848.854, 0.014533112, 1414.9, 1.0, -4405.0), ObjectParameters(emissivity=0.95)
    )
    arguments = ["render", str(run), "--frames", "frame_001", "--out"]
    folder, views = RunFolder(run), {}
    scene = folder.load_scene()
    assert recorded([*arguments, str(tmp_path / "no"), "--emissivity", "0.7"])[1] == 2  # linear counts
    scene = replace(scene, capture=replace(scene.capture, radiometry=radiometry))
    changes: dict[str, dict[str, Any]] = {"as": {}, "other": {"emissivity": 0.7, "reflected_c": -10.0}}
    for name, change in changes.items():
        render_views(folder, scene, tmp_path / name, ["frame_001"], viewpoint="thermal", **change)
        views[name] = np.asarray(Image.open(tmp_path / name / "frame_001.thermal.tiff"))
    expected = radiometry.reevaluated(views["as"], emissivity=0.7, reflected_c=-10.0)
    np.testing.assert_allclose(views["other"], expected, atol=1e-3)
    assert np.abs(views["other"] - views["as"]).mean() > 1.0
    with pytest.raises(RtgsError, match=r"emissivity is 1\.7"):
        render_views(folder, scene, tmp_path / "bad", [], viewpoint="rgb", emissivity=1.7)


def test_render_and_export_refuse(capture: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = state(run) | state(capture)
    for arguments, said in (
        (["render", str(run), "--out", str(run.parent / "x"), "--frames", "frame_099"], "frame_099"),
        (["render", str(run), "--out", str(capture / "rgb")], "inside the capture"),
        (["export", str(run), "--out", str(run)], "the run folder itself"),
        (["export", str(run), "--out", str(capture), "--frame", "sfm"], "inside the capture"),
    ):
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        assert stop.value.code == 2 and said in capsys.readouterr().err
    assert state(run) | state(capture) == before
