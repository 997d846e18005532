"""What leaves a run: lengths, poses, PLYs and depth, against the truth of a capture whose scale is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
import pytest
import torch
import trimesh
from PIL import Image

from rtgs.cli import main
from rtgs.config import RunConfig
from rtgs.io.capture import load_capture
from rtgs.io.exports.frames import AXES_FROM_Z_UP, Axes, file_frame
from rtgs.io.ply import read_ply, read_thermal_ply
from rtgs.maths.geometry import quat_from_rotation
from rtgs.maths.sh import C0
from rtgs.models import GaussianTemperatures, RgbModel, ThermalModel
from rtgs.records.capture import SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import LinearRange
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder
from rtgs.scale import History, ScaleEstimate, Scan
from rtgs.synthetic import SynthConfig, write_capture
from rtgs.synthetic.capture import GroundTruth

SFM_PER_METRE = 2.5
BASELINE_M = 0.23
WALL_M = 3.0  # in front of the first camera
WALL_C = 40.0
RANGE = LinearRange(10.0, 50.0)


class Run(NamedTuple):
    folder: RunFolder
    scene: Scene
    truth: GroundTruth
    exported: dict[str, Path]  # by --frame


def wall(scene: Scene) -> Gaussians:
    """Opaque and thin, across the first camera's view, in SfM units."""
    side = np.linspace(-1.9, 1.9, 31)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    points = SFM_PER_METRE * np.stack([x, y, np.full_like(x, WALL_M)], axis=1)
    pose = scene.world_from_rgb[scene.frames[0].name]
    n = len(points)
    return Gaussians(
        torch.as_tensor(pose.apply(points), dtype=torch.float32),
        torch.as_tensor(quat_from_rotation(pose.rotation), dtype=torch.float32).repeat(n, 1),
        torch.log(SFM_PER_METRE * torch.tensor([0.09, 0.09, 0.002])).repeat(n, 1),
        torch.full((n,), 4.0),
        torch.linspace(-0.3, 0.3, n * 12).reshape(n, 4, 3) / 4,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run folder filled by hand: true scale, a wall for a model. Exported twice by the command line."""
    root = tmp_path_factory.mktemp("export")
    config = SynthConfig(
        frames=8, size=40, supersampling=1, sfm_per_metre=SFM_PER_METRE, baseline_m=BASELINE_M, thermal_clean=False, seed=5
    )
    truth = write_capture(root / "capture", config)
    capture = load_capture(root / "capture")
    assert capture.poses is not None
    points = SparsePoints(np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]]), np.array([[1, 0, 0], [0, 0, 1]], np.float32))
    scene = Scene(capture, capture.poses.world_from_rgb, points, {})
    folder = RunFolder(root / "run")
    folder.write_config(SavedRun(root / "capture", RunConfig()))
    folder.write_scene(scene, SFM_PER_METRE)
    folder.write_scale(
        ScaleEstimate(
            SFM_PER_METRE, 0.01, (2.4, 2.6), "ok", "", "adam", 2.0, (0.1, 30.0), BASELINE_M, ("frame_001",), None,
            Scan((2.5,), (0.1,), (0.0,), {"frame_001": (0.1,)}), History(),
        )
    )  # fmt: skip
    settings = RenderSettings(near_plane=0.1)
    gaussians = wall(scene)
    level = float(RANGE.normalise(np.array(WALL_C)))
    folder.write_rgb(RgbModel(gaussians, torch.zeros(3), settings), scene.given_from_world)
    warm = replace(gaussians, sh=torch.full((len(gaussians), 1, 1), (level - 0.5) / C0))
    known = GaussianTemperatures(*(np.linspace(a, a + 1, len(warm)).astype(np.float32) for a in (WALL_C, 0.1, 5.0)))
    thermal = ThermalModel(
        gaussians=warm,
        background=torch.tensor([level]),
        unit="°C",
        range=RANGE,
        color_range=RANGE,
        settings=settings,
        sfm_per_metre=SFM_PER_METRE,
        temperatures=known,
    )
    folder.write_thermal(thermal, scene.given_from_world)
    exported = {frame: root / frame for frame in ("sfm", "metric")}
    for frame, out in exported.items():
        main(["export", str(folder.path), "--out", str(out), "--frame", frame, "--format", "ply", "colmap", "nerfstudio"])
    return Run(folder, scene, truth, exported)


def length_unit(frame: str) -> float:
    """How many of the export's units a metre is."""
    return 1.0 if frame == "metric" else SFM_PER_METRE


def turn(run: Run, frame: str, axes: Axes) -> np.ndarray:
    """`[3, 3]`: from the truth's axes to the export's. The truth has z up, and its cameras nearly tell so."""
    if frame == "sfm":
        return np.eye(3)
    rotation = file_frame(run.scene, 1 / SFM_PER_METRE, "metric", axes).from_world.rotation
    np.testing.assert_allclose(rotation, AXES_FROM_Z_UP[axes], atol=0.02)
    return rotation


@pytest.mark.parametrize("frame", ["sfm", "metric"])
def test_transforms_have_the_true_distances(run: Run, frame: str) -> None:
    data = json.loads((run.exported[frame] / "nerfstudio" / "transforms.json").read_text())
    turned = turn(run, frame, "z-up")
    found = {Path(f["file_path"]).stem: np.array(f["transform_matrix"]) for f in data["frames"]}
    assert list(found) == sorted(run.truth.world_from_rgb)
    for name, pose in run.truth.world_from_rgb.items():
        np.testing.assert_allclose(found[name][:3, 3], length_unit(frame) * turned @ pose.translation, rtol=1e-9, atol=1e-9)
        # OpenGL: the camera looks along −z with y up.
        np.testing.assert_allclose(found[name][:3, :3], turned @ pose.rotation * [1, -1, -1], atol=1e-9)
    assert data["camera_model"] == "PINHOLE" and data["w"] == 40 and data["cx"] == 20


@pytest.mark.parametrize("frame", ["sfm", "metric"])
def test_colmap_scene_is_the_true_rig(run: Run, frame: str) -> None:
    model, unit = pycolmap.Reconstruction(run.exported[frame] / "colmap" / "sparse" / "0"), length_unit(frame)
    turned = turn(run, frame, "y-down")
    images = {image.name: image for image in model.images.values()}
    assert len(images) == 2 * len(run.truth.world_from_rgb)
    for name in run.truth.world_from_rgb:
        rgb, thermal = (images[f"{kind}/{name}.png"].projection_center() for kind in ("rgb", "thermal"))
        np.testing.assert_allclose(rgb, unit * turned @ run.truth.world_from_rgb[name].translation, atol=1e-9)
        np.testing.assert_allclose(thermal, unit * turned @ run.truth.world_from_thermal[name].translation, atol=1e-9)
        assert np.linalg.norm(thermal - rgb) == pytest.approx(unit * BASELINE_M)
        axes = images[f"thermal/{name}.png"].cam_from_world().inverse().rotation.matrix()
        np.testing.assert_allclose(axes, turned @ run.truth.world_from_thermal[name].rotation, atol=1e-9)
    (rig,) = model.rigs.values()
    (sensor_from_rig,) = rig.non_ref_sensors.values()
    assert np.linalg.norm(sensor_from_rig.translation) == pytest.approx(unit * BASELINE_M)
    xyz = np.array([model.points3D[i].xyz for i in sorted(model.points3D)])
    np.testing.assert_allclose(xyz, run.scene.points.xyz @ turned.T * unit / SFM_PER_METRE, atol=1e-9)


@pytest.mark.parametrize("name", ["rgb", "thermal"])
def test_only_lengths_of_a_model_change(run: Run, name: str) -> None:
    original = run.folder.read_rgb().gaussians if name == "rgb" else run.folder.read_thermal().gaussians
    same, scaled = (read_ply(run.exported[frame] / f"{name}.ply") for frame in ("sfm", "metric"))
    turned = turn(run, "metric", "y-down")
    for field, tensor in original.tensors().items():
        assert torch.equal(same.tensors()[field], tensor), field
        if field == "opacity_logits":
            assert torch.equal(scaled.tensors()[field], tensor), field
    expected = original.means.numpy() @ turned.T / SFM_PER_METRE
    np.testing.assert_allclose(scaled.means.numpy(), expected, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(scaled.log_scales, original.log_scales - math.log(SFM_PER_METRE))
    if name == "thermal":
        ply = read_thermal_ply(run.exported["metric"] / "thermal.ply")
        assert ply.celsius_range == (RANGE.lo, RANGE.hi)
        stored = run.folder.read_thermal().temperatures
        assert stored is not None and stored.std[0] == np.float32(0.1)
        for a, b in zip(ply.properties.values(), (stored.temperature, stored.std, stored.views), strict=True):
            np.testing.assert_array_equal(a, b)


def test_another_reader_opens_the_model(run: Run) -> None:
    original = run.folder.read_rgb().gaussians
    path = run.exported["metric"] / "rgb.ply"
    cloud = trimesh.load(path)
    assert isinstance(cloud, trimesh.PointCloud) and len(cloud.vertices) == len(original)
    np.testing.assert_allclose(
        cloud.vertices, original.means.numpy() @ turn(run, "metric", "y-down").T / SFM_PER_METRE, atol=2e-6
    )

    # And by hand, as a viewer's few lines do: a text header, then packed float32.
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"] and f"element vertex {len(original)}" in lines
    names = [line.split()[2] for line in lines if line.startswith("property float")]
    assert names == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9)), "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    table = np.frombuffer(body, "<f4").reshape(len(original), len(names))
    np.testing.assert_allclose(np.exp(table[0, names.index("scale_2")]), 0.002, rtol=1e-4)  # metres


@pytest.mark.parametrize("viewpoint", ["rgb", "thermal"])
def test_rendered_depth_is_in_metres_along_the_axis(run: Run, tmp_path: Path, viewpoint: str) -> None:
    name = run.scene.frames[0].name
    main(["render", str(run.folder.path), "--out", str(tmp_path), "--frames", name, "--viewpoint", viewpoint])
    depth, temperature = (np.asarray(Image.open(tmp_path / f"{name}.{kind}.tiff")) for kind in ("depth", "thermal"))
    if viewpoint == "rgb":
        expected = np.full(depth.shape, WALL_M)
    else:  # where the pixel's ray meets the plane z = WALL_M of the RGB camera
        camera, rig = run.scene.rig.thermal, run.truth.rig.rgb_from_thermal
        x, y = np.meshgrid(
            (np.arange(camera.width) + 0.5 - camera.cx) / camera.fl_x, (np.arange(camera.height) + 0.5 - camera.cy) / camera.fl_y
        )
        expected = (WALL_M - rig.translation[2]) / (np.stack([x, y, np.ones_like(x)], axis=-1) @ rig.rotation[2])
    assert np.isfinite(depth).all() and np.abs(depth / expected - 1).max() < 0.01
    np.testing.assert_allclose(temperature, WALL_C, atol=1e-3)


def test_a_scale_that_was_not_observed_is_said(run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    estimate = run.folder.read_scale()
    try:
        run.folder.write_scale(replace(estimate, status="unobservable", reason="nothing to see"))
        main(["export", str(run.folder.path), "--out", str(tmp_path / "a")])
        assert "nothing to see" in capsys.readouterr().out
        main(["export", str(run.folder.path), "--out", str(tmp_path / "b"), "--frame", "sfm"])
        assert "warning" not in capsys.readouterr().out
    finally:
        run.folder.write_scale(estimate)
