"""Table III's rows, each on scenes whose scale is known; that rows are compared on the same pixels; that a bench goes on where it was."""

from __future__ import annotations

import csv
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.cli import main
from rtgs.config import ManualConfig, RealExperimentConfig
from rtgs.experiments import real
from rtgs.experiments.real import compare
from rtgs.experiments.real_table import Row, common_mask
from rtgs.experiments.strategies.manual import manual_scale
from rtgs.experiments.strategies.metric_depth import load_depth_model, scale_from_depth
from rtgs.experiments.strategies.metric_poses import load_mast3r, metres_between, overlapping_pairs, scale_from_pairs
from rtgs.experiments.strategies.planar import PlanarScene, homography, warp
from rtgs.maths import sh
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import CELSIUS
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.run.pipeline import RunFolder
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import History, Scan
from rtgs.synthetic import SynthConfig, write_capture

TRUTH = 0.4  # SfM units per metre
PLANE_M = 1.0
FRAMES = 11
RGB = Camera("PINHOLE", 72, 64, 70.0, 70.0, 36.3, 31.6)
THERMAL = Camera("PINHOLE", 48, 44, 52.0, 52.0, 24.4, 21.7)
RIG = Rig(RGB, THERMAL, SE3(np.eye(3), np.array([0.12, -0.03, 0.0])))


class Quiet:
    """A `Reporter` that keeps what it is told."""

    def __init__(self) -> None:
        self.titles: list[str] = []
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        self.titles.append(title)
        yield lambda done, total, text: None


def plane_model(count: int = 26) -> Gaussians:
    """An opaque textured wall across the optical axis, `PLANE_M` metres ahead; colours differ from Gaussian to Gaussian."""
    generator = torch.Generator().manual_seed(0)
    side = torch.linspace(-0.42, 0.42, count)
    y, x = torch.meshgrid(side, side, indexing="ij")
    means = torch.stack([x.ravel(), y.ravel(), torch.full((count**2,), TRUTH * PLANE_M)], dim=1)
    n = len(means)
    return Gaussians(
        means,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.log(torch.tensor([0.022, 0.022, 0.001])).repeat(n, 1),
        torch.full((n,), 3.0),
        torch.rand(n, 1, 3, generator=generator) - 0.5,
    )


def plane_scene() -> tuple[Scene, RgbModel]:
    """A camera pair that slides along the wall and rolls, and the RGB model of the wall. Temperatures are a model of the same geometry.

    Without roll a wrong scale would shift all thermal images alike along the wall, and nobody could tell.
    """
    wall = plane_model()
    settings = RenderSettings()
    x, y = wall.means[:, 0], wall.means[:, 1]
    celsius = 20 + 3 * torch.sin(17 * x) + 2 * torch.cos(23 * y + 5 * x)
    warm = replace(wall, sh=((celsius - 10) / 20 - 0.5)[:, None, None] / sh.C0)
    generator = np.random.default_rng(1)
    names = [f"f{i:02d}" for i in range(FRAMES)]
    rolls = [rotation_from_axis_angle([0, 0, angle]) for angle in generator.uniform(-0.8, 0.8, FRAMES)]
    centres = TRUTH * generator.uniform(-0.3, 0.3, (FRAMES, 3)) * [1, 1, 0]
    poses = {n: SE3(r, c) for n, r, c in zip(names, rolls, centres, strict=True)}

    def frame(name: str) -> Frame:
        world_from_thermal = poses[name] @ RIG.rgb_from_thermal.with_baseline_scaled(TRUTH)
        with torch.no_grad():
            rgb = render(wall, RGB, poses[name].inverse(), settings=settings).color.numpy()
            level = (
                render(warm, THERMAL, world_from_thermal.inverse(), settings=settings).over(torch.tensor([0.5])).numpy()[..., 0]
            )
        return Frame(name, rgb, (10 + 20 * level).astype(np.float32))

    capture = Capture(
        Path("plane"),
        RIG,
        RIG,
        tuple(frame(n) for n in names),
        np.ones((RGB.height, RGB.width), bool),
        np.ones((THERMAL.height, THERMAL.width), bool),
        CELSIUS,
        None,
    )
    points = SparsePoints(wall.means[::7].double().numpy(), np.zeros((len(wall.means[::7]), 3), np.float32))
    return Scene(capture, poses, points, {}), RgbModel(wall, torch.zeros(3), settings)


@pytest.fixture(scope="module")
def plane() -> tuple[Scene, RgbModel]:
    return plane_scene()


def estimate(sfm_per_metre: float) -> ScaleEstimate:
    local, history = Scan([], [], [], {}), History([], [], [], [])
    return ScaleEstimate(
        sfm_per_metre, 0.01, (0.39, 0.41), "ok", "", "global", 1.0, (0.1, 1.0), RIG.baseline_m, [], None, local, history
    )


def table(out: Path) -> dict[str, dict[str, str]]:
    with (out / "table3.csv").open(encoding="utf-8") as file:
        return {line["row"]: line for line in csv.DictReader(file)}


# Planar


def test_homography_takes_the_plane_from_one_picture_to_the_other() -> None:
    rig = replace(RIG, rgb_from_thermal=SE3(rotation_from_axis_angle([0.02, -0.05, 0.03]), np.array([0.1, 0.04, -0.06])))
    plane_m = 2.5
    points = np.array([[0.3, -0.2, plane_m], [-0.6, 0.5, plane_m], [0.0, 0.0, plane_m], [0.4, 0.6, plane_m]])

    def pixels(camera: Camera, p: NDArray) -> NDArray:
        return np.stack([camera.fl_x * p[:, 0] / p[:, 2] + camera.cx, camera.fl_y * p[:, 1] / p[:, 2] + camera.cy], axis=1)

    seen = np.concatenate([pixels(rig.thermal, points), np.ones((4, 1))], axis=1) @ homography(rig, plane_m).T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], pixels(rig.rgb, rig.rgb_from_thermal.apply(points)), atol=1e-9)


def test_homography_by_hand() -> None:
    """Focal length 100, a baseline of 0.2 m to the right and a plane 4 m ahead: 100 · 0.2 / 4 = 5 pixels."""
    camera = Camera("PINHOLE", 64, 48, 100.0, 100.0, 32.0, 24.0)
    there = homography(Rig(camera, camera, SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))), 4.0)
    np.testing.assert_allclose(there, [[1, 0, 5], [0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_warp_by_whole_pixels_moves_pixels_and_tells_what_is_missing() -> None:
    image = np.random.default_rng(0).normal(size=(6, 8)).astype(np.float32)
    valid = np.ones((6, 8), bool)
    valid[2, 5] = False
    moved, inside = warp(image, valid, np.array([[1.0, 0, 2], [0, 1, -1], [0, 0, 1]]), (6, 8))  # reads at (x + 2, y − 1)
    expected = np.zeros((6, 8), bool)
    expected[1:, :6] = valid[:-1, 2:]
    np.testing.assert_array_equal(inside, expected)
    np.testing.assert_allclose(moved[inside], image[:-1, 2:][expected[1:, :6]], atol=1e-6)


def test_warp_there_and_back() -> None:
    y, x = np.mgrid[: THERMAL.height, : THERMAL.width]
    image = (20 + np.sin(x / 6) + np.cos(y / 5)).astype(np.float32)
    there = homography(replace(RIG, rgb_from_thermal=SE3(rotation_from_axis_angle([0, 0, 0.05]), np.array([0.05, 0, 0.02]))), 2.0)
    size = RGB.height, RGB.width
    rgb, valid = warp(image, np.ones(image.shape, bool), np.linalg.inv(there), size)
    back, inside = warp(rgb, valid, there, image.shape)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(back[inside], image[inside], atol=0.02)  # twice bilinear


def test_a_plane_that_leaves_the_view_is_refused(plane: tuple[Scene, RgbModel]) -> None:
    with pytest.raises(RtgsError, match=r"0\.05 m.*of the thermal image"):
        PlanarScene.of(plane[0], 0.05)


# Manual


def test_manual_scale_from_two_cameras(plane: tuple[Scene, RgbModel]) -> None:
    scene, _ = plane
    metres = float(np.linalg.norm(scene.world_from_rgb["f01"].translation - scene.world_from_rgb["f06"].translation)) / TRUTH
    assert manual_scale(scene, ManualConfig(("f01", "f06"), metres)) == pytest.approx(TRUTH, rel=1e-9)


@pytest.mark.parametrize("model", ["OPENCV", "OPENCV_FISHEYE"])
def test_manual_scale_from_points_in_files_with_a_lens(plane: tuple[Scene, RgbModel], model: str) -> None:
    """The picks are pixels of the files: four times as large as the pictures of the scene, and not yet undistorted."""
    import cv2

    scene, _ = plane
    file = replace(RGB.resized(4 * RGB.width, 4 * RGB.height), model=model, k1=0.08, k2=-0.03, p1=0.002 * (model == "OPENCV"))
    scene = replace(scene, capture=replace(scene.capture, raw_rig=replace(RIG, rgb=file)))
    between_m = sum(scene.world_from_rgb[name].translation for name in ("f01", "f06")) / (2 * TRUTH)
    ends_m = between_m + np.array([[-0.16, 0.1, PLANE_M], [0.15, -0.1, 1.3 * PLANE_M]])
    k_cv = file.matrix
    k_cv[:2, 2] -= 0.5
    picks: list[float] = []
    for name in ("f01", "f06"):
        points = scene.rgb_from_world(name).apply(TRUTH * ends_m)[:, None]
        if model == "OPENCV":
            seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), k_cv, np.array([file.k1, file.k2, file.p1, file.p2]))
        else:
            seen, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), k_cv, np.array(file.distortion))
        picks += (seen.reshape(2, 2) + 0.5).ravel().tolist()
    metres = float(np.linalg.norm(ends_m[1] - ends_m[0]))
    config = ManualConfig(("f01", "f06"), metres, tuple(picks))  # type: ignore[arg-type]
    assert manual_scale(scene, config) == pytest.approx(TRUTH, rel=1e-4)
    picks[5] -= 60  # y of the first point in the second frame
    with pytest.raises(RtgsError, match="miss each other"):
        manual_scale(scene, replace(config, pixels=tuple(picks)))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (ManualConfig(("f01", "f02")), "--manual.metres"),
        (ManualConfig(("f01", "f01"), 1.0), "named twice"),
        (ManualConfig(("f01", "f02"), -1.0), "positive"),
        (ManualConfig(pixels=(1, 2, 3, 4, 5, 6, 7, 8)), "needs both"),
    ],
)
def test_half_a_length_is_refused(config: ManualConfig, said: str) -> None:
    with pytest.raises(RtgsError, match=said):
        config.check()


# Priors


def test_depths_in_metres_give_the_scale(plane: tuple[Scene, RgbModel]) -> None:
    """A predictor that knows: 1 m to the wall, nothing at the left edge, and one frame all wrong."""
    scene, model = plane
    frames = {id(f.rgb): f.name for f in scene.frames}

    def predict(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
        metres = np.full(rgb.shape[:2], PLANE_M, np.float32)
        metres[:, :5] = np.nan
        return metres * (7 if frames[id(rgb)] == "f03" else 1)

    assert scale_from_depth(scene, model, predict) == pytest.approx(TRUTH, rel=2e-3)
    with pytest.raises(RtgsError, match="no positive depth"):
        scale_from_depth(scene, model, lambda rgb: np.zeros(rgb.shape[:2], np.float32))


def test_lengths_in_metres_give_the_scale(plane: tuple[Scene, RgbModel]) -> None:
    scene, _ = plane
    pairs = overlapping_pairs(scene)
    assert pairs
    assert not {n for pair in pairs for n in pair} & {f.name for f in scene.held_out_frames}

    def predict(a: Frame, b: Frame, camera: Camera) -> float | None:
        if (a.name, b.name) == pairs[0]:
            return None
        length = np.linalg.norm(scene.world_from_rgb[a.name].translation - scene.world_from_rgb[b.name].translation) / TRUTH
        return float(length) * (3 if (a.name, b.name) == pairs[1] else 1)

    assert scale_from_pairs(scene, predict) == pytest.approx(TRUTH, rel=1e-9)
    with pytest.raises(RtgsError, match="none of"):
        scale_from_pairs(scene, lambda a, b, camera: None)


def test_frames_that_look_elsewhere_are_no_pair(plane: tuple[Scene, RgbModel]) -> None:
    scene, _ = plane
    turned = {
        n: SE3(rotation_from_axis_angle([0, 0.55 * i, 0]), p.translation) for i, (n, p) in enumerate(scene.world_from_rgb.items())
    }
    assert overlapping_pairs(replace(scene, world_from_rgb=turned)) == []


def test_metres_between_two_cameras_from_pointmaps() -> None:
    """Points on a bumpy wall, seen by the second camera, in the first one's axes; the less confident half is wrong."""
    camera = Camera("PINHOLE", 64, 48, 60.0, 62.0, 31.0, 25.0)
    a_from_b = SE3(rotation_from_axis_angle([0.1, -0.2, 0.05]), np.array([0.3, -0.1, 0.2]))
    points, confidence = pointmap(camera, a_from_b)
    points[confidence < 1.5] = 9.0
    length = float(np.linalg.norm(a_from_b.translation))
    found = metres_between(points, confidence, camera)
    assert found == pytest.approx(length, rel=1e-3)
    assert metres_between(points[:8, :8], confidence[:8, :8], replace(camera, width=8, height=8)) is None


def pointmap(camera: Camera, a_from_b: SE3) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    y, x = np.mgrid[: camera.height, : camera.width]
    depth = 2 + 0.5 * np.sin(x / 5) * np.cos(y / 4)
    in_b = np.stack([(x + 0.5 - camera.cx) / camera.fl_x * depth, (y + 0.5 - camera.cy) / camera.fl_y * depth, depth], axis=-1)
    confidence = np.where((x + y) % 2, 2.0, 1.0)
    return a_from_b.apply(in_b).astype(np.float32), confidence.astype(np.float32)


def test_mast3r_is_asked_as_its_package_wants(
    plane: tuple[Scene, RgbModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A package of the same shape whose network knows the truth: the picture's size, its camera and the pose have to fit together."""
    scene, _ = plane
    weights = tmp_path / "weights.pth"
    weights.write_bytes(b"")
    b_pose, a_pose = (scene.world_from_rgb[n] for n in ("f05", "f02"))
    a_from_b = a_pose.inverse() @ b_pose
    in_metres = SE3(a_from_b.rotation, a_from_b.translation / TRUTH)
    asked: list[Any] = []

    class Model:
        @staticmethod
        def from_pretrained(path: str) -> Model:
            assert path == str(weights)
            return Model()

        def to(self, device: str) -> Model:
            return self

        def eval(self) -> Model:
            return self

    def inference(pairs: Any, model: Model, device: str, batch_size: int, verbose: bool) -> Any:
        (first, second) = pairs[0]
        asked.extend([first, second])
        h, w = second["true_shape"][0]
        assert second["img"].shape == (1, 3, h, w) and max(h, w) == 512 and h % 16 == 0 and w % 16 == 0
        assert first["img"].min() >= -1 and first["img"].max() <= 1
        scale = 512 / RGB.width
        height = round(RGB.height * scale)
        camera = Camera("PINHOLE", w, h, RGB.fl_x * scale, RGB.fl_y * height / RGB.height, RGB.cx * scale, 0.0)
        camera = replace(camera, cy=RGB.cy * height / RGB.height - (height - h) // 2)
        points, confidence = pointmap(camera, in_metres)
        return {"pred2": {"pts3d_in_other_view": torch.from_numpy(points)[None], "conf": torch.from_numpy(confidence)[None]}}

    modules = {name: types.ModuleType(name) for name in ("mast3r", "mast3r.model", "dust3r", "dust3r.inference")}
    vars(modules["mast3r.model"])["AsymmetricMASt3R"] = Model
    vars(modules["dust3r.inference"])["inference"] = inference
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    frames = {f.name: f for f in scene.frames}
    metres = load_mast3r(weights)(frames["f02"], frames["f05"], scene.rig.rgb)
    assert len(asked) == 2
    assert metres == pytest.approx(np.linalg.norm(in_metres.translation), rel=1e-3)


def test_without_mast3r_the_reason_names_package_and_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mast3r", None)
    (tmp_path / "w.pth").write_bytes(b"")
    with pytest.raises(RtgsError, match=r"mast3r.*PYTHONPATH.*--mast3r-weights"):
        load_mast3r(tmp_path / "w.pth")


def test_without_transformers_the_reason_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(RtgsError, match=r"rtgs\[depth\].*--depth-model"):
        load_depth_model(tmp_path)


@pytest.mark.parametrize("kind", ["metric", "relative", "zoedepth"])
def test_a_depth_model_of_transformers_is_read_from_a_folder(plane: tuple[Scene, RgbModel], tmp_path: Path, kind: str) -> None:
    """Tiny and of random weights: its metres mean nothing, but they are positive, of the picture's size, and give a finite scale."""
    transformers = pytest.importorskip("transformers", reason="needs rtgs[depth]")
    with pytest.raises(RtgsError, match=r"config\.json"):
        load_depth_model(tmp_path)
    torch.manual_seed(0)
    tiny = {"hidden_size": 16, "num_hidden_layers": 4, "num_attention_heads": 2, "reshape_hidden_states": False}
    neck = {"neck_hidden_sizes": [8, 8, 8, 8], "fusion_hidden_size": 8}
    if kind == "zoedepth":
        from transformers.models.zoedepth import ZoeDepthImageProcessor

        stages = [f"stage{i}" for i in range(1, 5)]
        backbone = transformers.BeitConfig(**tiny, intermediate_size=16, image_size=32, patch_size=16, out_features=stages)
        bins = [{"n_bins": 8, "min_depth": 0.001, "max_depth": 10.0, "name": "indoor"}]
        heads = {"bottleneck_features": 8, "num_relative_features": 8, "bin_embedding_dim": 8, "num_attractors": [4, 2, 2, 1]}
        config = transformers.ZoeDepthConfig(backbone_config=backbone, **neck, **heads, bin_configurations=bins)
        transformers.ZoeDepthForDepthEstimation(config).save_pretrained(tmp_path)
        ZoeDepthImageProcessor(size={"height": 32, "width": 32}).save_pretrained(tmp_path)
    else:
        from transformers.models.dpt import DPTImageProcessor

        backbone = transformers.Dinov2Config(**tiny, image_size=28, patch_size=14, out_indices=[1, 2, 3, 4], apply_layernorm=True)
        heads = {"reassemble_hidden_size": 16, "head_hidden_size": 8, "depth_estimation_type": kind, "max_depth": 20}
        config = transformers.DepthAnythingConfig(backbone_config=backbone, **neck, **heads)
        transformers.DepthAnythingForDepthEstimation(config).save_pretrained(tmp_path)
        DPTImageProcessor(size={"height": 28, "width": 28}, keep_aspect_ratio=True, ensure_multiple_of=14).save_pretrained(
            tmp_path
        )
    if kind == "relative":
        with pytest.raises(RtgsError, match="relative depth"):
            load_depth_model(tmp_path)
        return
    predict = load_depth_model(tmp_path)
    scene, model = plane
    metres = predict(scene.frames[0].rgb)
    assert metres.shape == (RGB.height, RGB.width) and (metres > 0).all() and (metres < 20).all()
    assert np.isfinite(scale_from_depth(scene, model, predict))


# The table


@pytest.fixture(scope="module")
def bench(plane: tuple[Scene, RgbModel], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench")
    compare(*plane, estimate(TRUTH), out, CONFIG, Quiet())
    return out


CONFIG = RealExperimentConfig(region=(20, 10, 40, 30))


def test_on_a_plane_at_its_distance_planar_is_as_good_as_ours(bench: Path) -> None:
    rows = table(bench)
    ours, planar, naive = (rows[key] for key in ("ours", "planar", "naive"))
    assert float(ours["psnr_db"]) > 45  # the pictures are of this very model
    assert float(planar["mae_c"]) < 0.15 and float(planar["psnr_db"]) > 35  # two interpolations
    assert float(naive["mae_c"]) > 3 * float(planar["mae_c"])
    assert float(naive["sfm_per_metre"]) == 1 and float(ours["sfm_per_metre"]) == TRUTH and planar["sfm_per_metre"] == ""


def test_at_another_distance_it_is_not(plane: tuple[Scene, RgbModel], bench: Path, tmp_path: Path) -> None:
    compare(*plane, estimate(TRUTH), tmp_path, replace(CONFIG, plane_m=4.0), Quiet())
    assert float(table(tmp_path)["planar"]["mae_c"]) > 2 * float(table(bench)["planar"]["mae_c"])


def test_rows_that_cannot_run_say_why(bench: Path) -> None:
    rows, text = table(bench), (bench / "table3.md").read_text(encoding="utf-8")
    for key, title, said in (
        ("manual", "Manual", "--manual.frames"),
        ("mast3r", "MASt3R", "mast3r"),
        ("depth", "Metric depth", "rtgs[depth]"),
    ):
        assert rows[key]["psnr_db"] == "" and said in rows[key]["why_not"]
        assert f"- {title} was not run" in text
    for key in ("naive", "planar", "ours"):
        assert rows[key]["why_not"] == ""
    assert "drift `off`" in text


def test_region_is_the_mean_temperature_there(plane: tuple[Scene, RgbModel], bench: Path) -> None:
    frame = plane[0].held_out_frames[0]
    shows = float(frame.thermal[10:30, 20:40].mean())
    assert f"{shows:.2f} °C" in (bench / "table3.md").read_text(encoding="utf-8")
    assert float(table(bench)["ours"]["region_c"]) == pytest.approx(shows, abs=0.05)


def test_every_row_is_scored_on_the_pixels_of_all(plane: tuple[Scene, RgbModel], bench: Path) -> None:
    scene, _ = plane
    planar = PlanarScene.of(scene, PLANE_M)
    assert 0.5 < planar.thermal_valid.mean() < 1
    holes = {f.name: np.where(planar.thermal_valid, f.thermal, np.nan) for f in scene.held_out_frames}
    whole = {f.name: f.thermal for f in scene.held_out_frames}
    rows = [Row("ours", "Ours", 1.0, whole), Row("planar", "Planar", None, holes), Row("manual", "Manual", None, {}, why="no")]
    np.testing.assert_array_equal(common_mask(scene, rows), planar.thermal_valid)
    assert f"{planar.thermal_valid.mean():.1%} of the thermal image" in (bench / "table3.md").read_text(encoding="utf-8")
    # An error where Planar has no pixel does not count for Ours either.
    spoilt = {n: np.where(planar.thermal_valid, image, 99.0).astype(np.float32) for n, image in whole.items()}
    scored = real.score(scene, [Row("ours", "Ours", 1.0, spoilt), rows[1]], RealExperimentConfig(), lambda *_: None)
    assert scored.means["ours"]["mae_c"] == 0


def test_a_picture_a_held_out_frame(plane: tuple[Scene, RgbModel], bench: Path) -> None:
    from PIL import Image

    for frame in plane[0].held_out_frames:
        with Image.open(bench / "pictures" / f"{frame.name}.png") as picture:
            assert picture.width > 4 * 256 and picture.height > 2 * 256


def test_a_bench_goes_on_where_it_was_stopped(
    plane: tuple[Scene, RgbModel], bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fits = []
    fit = real.fit_thermal

    def counted(*args: Any, **kwargs: Any) -> Any:
        fits.append(args[2])
        if len(fits) == 2:
            raise KeyboardInterrupt
        return fit(*args, **kwargs)

    monkeypatch.setattr(real, "fit_thermal", counted)
    with pytest.raises(KeyboardInterrupt):
        compare(*plane, estimate(TRUTH), tmp_path, CONFIG, Quiet())
    assert [p.name for p in (tmp_path / "rows").iterdir()] == ["naive.npz"]  # whole rows only, and nothing half written
    reporter = Quiet()
    compare(*plane, estimate(TRUTH), tmp_path, CONFIG, reporter)
    assert len(fits) == 4 and "Naive: done before" in reporter.lines
    assert table(tmp_path) == table(bench)
    compare(*plane, estimate(0.5), tmp_path, CONFIG, Quiet())
    assert fits[4:] == [0.5]  # another scale is another row, and only that
    compare(*plane, estimate(0.5), tmp_path, replace(CONFIG, thermal=replace(CONFIG.thermal, sh_degree=0)), Quiet())
    assert len(fits) == 8


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (RealExperimentConfig(region=(0, 0, 500, 10)), "within 48 × 44"),
        (RealExperimentConfig(region=(5, 5, 9, 9), region_frame="nope"), "no frame 'nope'"),
        (RealExperimentConfig(region=(5, 5, 9, 9), region_frame="f01"), "no held-out frame"),
        (RealExperimentConfig(manual=ManualConfig(("f01", "who"), 1.0)), "no frame 'who'"),
        (RealExperimentConfig(depth_model=Path("/nowhere")), "--depth-model"),
        (RealExperimentConfig(plane_m=0.0), "--plane-m"),
    ],
)
def test_bad_settings_are_refused_before_any_fit(
    plane: tuple[Scene, RgbModel], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, config: RealExperimentConfig, said: str
) -> None:
    monkeypatch.setattr(real, "fit_thermal", lambda *a, **k: pytest.fail("a fit has begun"))
    with pytest.raises(RtgsError, match=said):
        compare(*plane, estimate(TRUTH), tmp_path, config, Quiet())


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
    main(
        [
            "experiment",
            "real",
            str(capture),
            "--out",
            str(out),
            "--manual.frames",
            "frame_001",
            "frame_003",
            "--manual.metres",
            f"{metres}",
        ]
    )
    assert (out / "run" / "stages.json").read_bytes() == standing
    rows = table(out)
    assert float(rows["manual"]["sfm_per_metre"]) == pytest.approx(truth.sfm_per_metre, rel=1e-5)
    assert float(rows["ours"]["sfm_per_metre"]) == pytest.approx(RunFolder(out / "run").read_scale().sfm_per_metre, rel=1e-5)
    assert "lpips_alex" not in rows["ours"] and "No LPIPS" in (out / "table3.md").read_text(encoding="utf-8")
