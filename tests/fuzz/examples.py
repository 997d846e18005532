"""Valid files that the fuzz tests start from, as folders in memory."""

from __future__ import annotations

import io
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.captures import (
    NAMES,
    RADIOMETRY,
    RGB,
    RGB_FROM_THERMAL,
    THERMAL,
    thermal_counts,
    write_poses,
    write_sparse,
)
from tests.helpers.gaussian_clouds import cloud
from tests.helpers.made_up_run import estimate, evaluation
from tests.helpers.radiometric_files import SAMPLES, camera_exif, counts_of, encoded, flir_jpeg, jpeg, raw_record

from rtgs.config import RunConfig
from rtgs.io.capture import load_capture
from rtgs.io.colmap import write_scene
from rtgs.io.ply import write_ply
from rtgs.io.rig import write_rig
from rtgs.models import GaussianTemperatures, RgbModel, SensorModel, ThermalModel
from rtgs.records.capture import SparsePoints
from rtgs.records.radiometry import LinearRange
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder, StageEntry

Folder = dict[str, bytes]
"""A folder's files: path in it → content."""

TIFF_KINDS = (np.uint16, np.uint8, np.int32, np.float32)


def folder_of(write: Callable[[Path], object]) -> Folder:
    """What a function writes into an empty folder."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        write(root)
        return {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


_written: dict[Path, tuple[bytes, int]] = {}
"""Content, and time of change, of the files that `write_folder` wrote last: most files of a case are those of the case before."""


def write_folder(root: Path, files: Folder) -> None:
    """Make the folder hold these files and no others."""
    wanted = {root / name: data for name, data in files.items()}
    for path in sorted(root.rglob("*"), reverse=True) if root.exists() else ():
        if path.is_dir() and not path.is_symlink():
            if not any(path.iterdir()):
                path.rmdir()
        elif path not in wanted:
            path.unlink()
    for path, data in wanted.items():
        if path.exists() and _written.get(path) == (data, path.stat().st_mtime_ns):
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        _written[path] = data, path.stat().st_mtime_ns
    root.mkdir(parents=True, exist_ok=True)


def noise(seed: int, *shape: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def write_images(root: Path, names: tuple[str, ...] = NAMES) -> None:
    """`rgb/`, `thermal/` and `rig.json` of a capture without poses."""
    for i, name in enumerate(names):
        (root / "rgb").mkdir(parents=True, exist_ok=True)
        (root / "thermal").mkdir(parents=True, exist_ok=True)
        Image.fromarray(noise(i, 48, 64, 3)).save(root / "rgb" / f"{name}.png")
        Image.fromarray(thermal_counts(4800 + i)).save(root / "thermal" / f"{name}.tiff")
    std = CalibrationStd(baseline_length=0.01, rotation_rad=0.001)
    write_rig(root / "rig.json", Rig(RGB, THERMAL, RGB_FROM_THERMAL, std), RADIOMETRY)


@cache
def captures() -> tuple[Folder, ...]:
    """A capture without poses, with `transforms.json`, with a binary and with a text model."""

    def with_poses(write: Callable[[Path], object]) -> Folder:

        def both(root: Path) -> None:
            write_images(root)
            write(root)

        return folder_of(both)

    return (
        folder_of(write_images),
        with_poses(write_poses),
        with_poses(write_sparse),
        with_poses(lambda root: write_sparse(root, text=True)),
    )


@cache
def sparse_models() -> tuple[Folder, ...]:
    """COLMAP models: binary and text, trivial rigs and a run's scene with a rig of two cameras."""

    def scene(root: Path) -> None:
        write_images(root / "capture")
        write_poses(root / "capture")
        write_scene(root / "0", scene_of(root / "capture"), 2.5)
        shutil.rmtree(root / "capture")

    def plain(root: Path, text: bool) -> None:
        write_sparse(root, text=text)
        (root / "sparse" / "0").rename(root / "0")
        (root / "sparse").rmdir()

    return folder_of(lambda r: plain(r, False)), folder_of(lambda r: plain(r, True)), folder_of(scene)


def scene_of(capture: Path) -> Scene:
    loaded = load_capture(capture)
    assert loaded.poses is not None
    rng = np.random.default_rng(1)
    points = SparsePoints(rng.normal(size=(20, 3)), (rng.integers(0, 256, (20, 3)) / 255).astype(np.float32))
    return Scene(loaded, loaded.poses.world_from_rgb, points, {"missing": "few features (3)"})


def _image(pixels: NDArray, kind: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


@cache
def thermal_images() -> tuple[Folder, ...]:
    """Thermal files `[32, 40]` of every kind that is read."""
    found = []
    for dtype in TIFF_KINDS:
        counts = thermal_counts(100 if dtype is np.uint8 else 4800, dtype)
        for compression in ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits"):
            found.append({"image.tiff": _image(counts, "TIFF", compression=compression)})
        found.append({"image.tiff": _image(counts, "TIFF", tiffinfo={0xA481: "29000 ", 274: 6})})
    found += [{"image.png": _image(thermal_counts(level, dtype), "PNG")} for dtype, level in ((np.uint16, 4800), (np.uint8, 100))]
    return tuple(found)


@cache
def rgb_images() -> tuple[Folder, ...]:
    """Photographs `[48, 64]` of every kind that is read."""
    pixels = noise(0, 48, 64, 3)
    exif = camera_exif(_274=6)
    smooth = np.broadcast_to(np.arange(64, dtype=np.uint8)[None, :, None] * 3, (48, 64, 3)).copy()
    return (
        {"image.png": _image(pixels, "PNG")},
        {"image.png": _image(pixels[..., 0], "PNG", exif=exif)},
        {"image.png": _image(thermal_counts(4800), "PNG")},
        {"image.jpg": _image(smooth, "JPEG", quality=90, exif=exif)},
        {"image.jpg": _image(smooth, "JPEG", progressive=True, icc_profile=b"x" * 200, comment=b"hello")},
        {"image.tiff": _image(pixels, "TIFF", compression="tiff_lzw")},
        {"image.tiff": _image(pixels, "TIFF", tiffinfo={274: 6})},
        {"image.tiff": _image(smooth, "TIFF", compression="jpeg")},
    )


@cache
def plys() -> tuple[Folder, ...]:
    """Models of three channels and of one, with and without harmonics."""

    def thermal(root: Path) -> None:
        floats = {name: np.linspace(1, 2, 8).astype(np.float32) for name in ("temperature", "temperature_std", "views")}
        write_ply(root / "model.ply", cloud(8, degree=1, channels=1), celsius_range=(10.0, 50.0), properties=floats)

    def as_text(root: Path) -> None:
        from plyfile import PlyData

        write_ply(root / "model.ply", cloud(3, degree=1))
        data = PlyData.read(str(root / "model.ply"), mmap=False)
        data.text = True
        data.write(str(root / "model.ply"))

    def of_degree(degree: int) -> Folder:
        return folder_of(lambda root: write_ply(root / "model.ply", cloud(8, degree=degree)))

    models = [of_degree(degree) for degree in (0, 1, 3)]
    return (*models, folder_of(thermal), folder_of(as_text))


@cache
def flir_files() -> tuple[Folder, ...]:
    """FLIR's JPEGs: made up, and the samples where they are."""
    made = [
        folder_of(lambda root: flir_jpeg(root / "image.jpg")),
        folder_of(lambda root: flir_jpeg(root / "image.jpg", raw=raw_record(counts_of(), ">", png=False))),
        folder_of(lambda root: flir_jpeg(root / "image.jpg", visible=None, fusion=None)),
    ]
    samples = [{"image.jpg": p.read_bytes()} for p in sorted(SAMPLES.glob("FLIR*.jpg"))] if SAMPLES.is_dir() else []
    return (*made, *samples)


@cache
def dji_files() -> tuple[Folder, ...]:
    """DJI's JPEGs beside converted temperatures."""

    def closed(root: Path) -> None:
        exif = camera_exif(_271="DJI", _272="H20T")
        exif.get_ifd(0x8769).update({41989: 58})
        jpeg(root / "image.jpg", [b"\x00" * 500], marker=0xE3, exif=exif)

    temperatures = _image(np.linspace(10, 40, 40 * 32).reshape(32, 40).astype(np.float32), "TIFF")
    made = [{**folder_of(closed), "image.tiff": temperatures}]
    samples = [{"image.jpg": p.read_bytes(), "image.tiff": temperatures} for p in sorted(SAMPLES.glob("DJI*.jpg"))]
    return (*made, *samples)


def import_folders() -> tuple[Folder, ...]:
    """A folder of three FLIR files, with a rig."""
    return (folder_of(lambda root: [flir_jpeg(root / f"FLIR000{i}.jpg", counts_of(i)) for i in range(3)]),)


@cache
def runs() -> tuple[Folder, ...]:
    """A finished run `run/` beside its capture `capture/`, with every file that a run has but pictures of many views."""

    def write(root: Path) -> None:
        write_images(root / "capture")
        write_poses(root / "capture")
        scene, folder = scene_of(root / "capture"), RunFolder(root / "run")
        folder.write_config(SavedRun(root / "capture", RunConfig(), "0" * 64))
        folder.write_scene(scene, 2.4312)
        folder.write_summary(scene)
        folder.write_scale(estimate())
        folder.write_json("stages.json", {"sfm": StageEntry("a" * 16, seconds={"sfm": 1.5}), "rgb": StageEntry("b" * 16, "c")})
        evaluation().write(folder.path / "metrics.json")
        folder.write_json("hashes.json", {"rgb/a.png": {"size": 1, "mtime_ns": 2, "ctime_ns": 3, "sha256": "0" * 64}})
        settings, history = (
            RenderSettings(near_plane=0.1),
            {"step": [1.0, 2.0], "gaussians": [8.0, 8.0], "held_out_psnr": [20.0, 21.0]},
        )
        folder.write_rgb(RgbModel(cloud(8, degree=1), torch.zeros(3), settings, history), scene.given_from_world)
        span = LinearRange(10.0, 50.0)
        pattern = noise(0, THERMAL.height, THERMAL.width).astype(np.float32)
        for name in ("thermal", "thermal_naive"):
            model = ThermalModel(
                gaussians=cloud(8, degree=1, channels=1),
                background=torch.zeros(1),
                unit="°C",
                range=span,
                color_range=span,
                settings=settings,
                sfm_per_metre=2.4312,
                history={"step": [1.0], "loss": [0.5]},
                sensor=SensorModel({NAMES[0]: (1.0, 0.1), NAMES[1]: (1.01, -0.1)}, pattern),
                temperatures=GaussianTemperatures(*(np.ones(8, np.float32),) * 3),
            )
            folder.write_thermal(model, scene.given_from_world, name)
        pixels = noise(0, 24, 32, 3)
        for kind in ("rgb", "thermal", "overlay"):
            (folder.renders / kind).mkdir(parents=True)
            for what in ("reference", "render", "error", "before", "after"):
                (folder.renders / kind / f"{NAMES[0]}.{what}.png").write_bytes(encoded(pixels, "PNG"))

    return (folder_of(write),)
