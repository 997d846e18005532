"""Surface points, poses with photographs and orthophotos of a corner whose truth is known, opened by independent readers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pycolmap
import pytest
import rasterio
import trimesh
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData
from rasterio.warp import transform
from tests.helpers.corner_run import BASELINE_M, FLOOR_C, GIVEN_FROM_UPRIGHT, SFM_PER_METRE, Corner, corner

from rtgs.base.errors import RtgsError
from rtgs.config import ExportConfig, ExportFormat
from rtgs.io.exports.formats import FORMATS
from rtgs.io.exports.geotiff import RasterPlace, write_geotiff
from rtgs.maths.geometry import look_at
from rtgs.records.georeference import Georeference


def written(scene: Corner, name: ExportFormat, out: Path) -> list[Path]:
    chosen = FORMATS[name]
    return chosen.write(scene.subject, scene.subject.frame(chosen.axes), out, None)


def to_truth(scene: Corner, xyz: NDArray) -> NDArray:
    """Points of a file with z up, in the upright frame: the file's heading is free, and the origin is the given one."""
    frame = scene.subject.frame("z-up")
    truth_from_world = GIVEN_FROM_UPRIGHT.inverse() @ scene.subject.scene.given_from_world
    return truth_from_world.apply(frame.from_world.apply_inverse(xyz))


def points_of(path: Path) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Positions, RGB in [0, 1], °C and error, by other programs' readers."""
    if path.suffix == ".ply":
        data = PlyData.read(str(path))["vertex"].data
        cloud: Any = trimesh.load(path)
        np.testing.assert_array_equal(np.asarray(cloud.colors)[:, 0], data["red"])
        return np.asarray(cloud.vertices), np.asarray(cloud.colors)[:, :3] / 255, data["temperature"], data["temperature_std"]
    las = laspy.read(path)
    colours = np.stack([las.red, las.green, las.blue], axis=1) / 65535
    return np.asarray(las.xyz), colours, np.asarray(las["temperature"]), np.asarray(las["temperature_std"])


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["points-ply", "points-las", "points-laz"])
def test_points_lie_on_the_surface_with_their_temperatures(name: ExportFormat, tmp_path: Path) -> None:
    scene = corner(ExportConfig(spacing_m=0.04))
    (path,) = written(scene, name, tmp_path)
    # A Gaussian's depth is that of its centre, and near ones count most: the surface comes out about one of their sizes too near.
    xyz, colours, celsius, error = points_of(path)
    here = to_truth(scene, xyz)
    on_floor = (np.abs(here[:, 2] + 0.1) < 0.05) & (np.abs(here[:, :2]).max(axis=1) < 1.5) & (here[:, :2].min(axis=1) < -0.2)
    assert on_floor.sum() > 300
    assert np.quantile(np.abs(celsius[on_floor] - FLOOR_C), 0.98) < 0.2
    np.testing.assert_allclose(np.median(colours[on_floor], axis=0), (0.5, 0.5, 0.4), atol=0.02)
    np.testing.assert_allclose(error, 0.1, atol=1e-3)
    assert np.quantile(np.abs(here[:, 2] + 0.1), 0.5) < 0.04 and here[:, 2].max() < 0.7
    hot = celsius > 40
    assert hot.any() and here[hot, 0].mean() > 0.3 and np.abs(here[hot, 1]).mean() < 0.2  # the arm along x


def test_colmap_holds_both_cameras_as_a_rig_and_the_photographs(tmp_path: Path) -> None:
    scene = corner()
    (folder,) = written(scene, "colmap", tmp_path)
    model = pycolmap.Reconstruction(str(folder / "sparse" / "0"))
    assert model.num_rigs() == 1 and model.num_reg_images() == 16
    for image in model.images.values():
        picture = Image.open(folder / "images" / image.name)
        camera = model.cameras[image.camera_id]
        assert picture.size == (camera.width, camera.height)
    level = np.asarray(Image.open(folder / "images" / "rgb" / "frame_002.png"))
    assert level.shape == (96, 128, 3) and (level == 77).all()  # 0.3
    celsius = np.asarray(Image.open(folder / "celsius" / "frame_002.tiff"))
    assert celsius.dtype == np.float32 and (celsius == 17.0).all()
    (rig,) = model.rigs.values()
    (sensor_from_rig,) = rig.non_ref_sensors.values()
    assert np.linalg.norm(sensor_from_rig.translation) == pytest.approx(BASELINE_M)
    # A Gaussian of the PLY that is written beside it lies where the cameras see it.
    xyz = model.points3D[1].xyz
    image = next(i for i in model.images.values() if i.name == "rgb/frame_000.png")
    frame = scene.subject.frame("y-down")
    pose = scene.subject.scene.world_from_rgb["frame_000"]
    expected = scene.subject.scene.rig.rgb.project(pose.inverse().apply(frame.from_world.apply_inverse(xyz)))
    np.testing.assert_allclose(image.project_point(xyz), expected, atol=1e-6)


def test_nerfstudio_names_photographs_that_are_there(tmp_path: Path) -> None:
    scene = corner()
    (folder,) = written(scene, "nerfstudio", tmp_path)
    both = [json.loads((folder / name).read_text()) for name in ("transforms.json", "transforms_thermal.json")]
    for data in both:
        for frame in data["frames"]:
            assert Image.open(folder / frame["file_path"]).size == (data["w"], data["h"])
    rgb, thermal = (np.array([f["transform_matrix"] for f in data["frames"]]) for data in both)
    np.testing.assert_allclose(np.linalg.norm(rgb[:, :3, 3] - thermal[:, :3, 3], axis=1), BASELINE_M)
    truth = look_at((3.0, 0.0, 2.0), (0.3, 0.2, 0.1))
    np.testing.assert_allclose(to_truth(scene, rgb[0, :3, 3]), truth.translation, atol=1e-9)


def test_an_orthophoto_has_degrees_in_their_places(tmp_path: Path) -> None:
    scene = corner(ExportConfig(pixel_m=0.05))
    written(scene, "orthophoto", tmp_path)
    with rasterio.open(tmp_path / "orthophoto" / "temperature.tif") as raster:
        values, nodata = raster.read(1), raster.nodata
        assert raster.dtypes == ("float32",) and nodata is not None and np.isnan(nodata)
        assert raster.res == (0.05, 0.05)

        def at(truth: tuple[float, float, float]) -> float:
            frame, here = scene.subject.frame("z-up"), GIVEN_FROM_UPRIGHT.apply(np.array(truth))
            x, y, _ = frame.of(scene.subject.scene.given_from_world.apply_inverse(here))
            row, column = raster.index(x, y)
            return float(values[row, column])

        assert at((1.2, 0.0, 0.0)) == pytest.approx(50.0, abs=3.0)
        assert at((0.0, 0.8, 0.0)) == pytest.approx(40.0, abs=3.0)
        assert at((-1.0, -1.0, 0.0)) == pytest.approx(FLOOR_C, abs=0.5)
        assert at((-0.8, 0.0, 0.0)) == pytest.approx(FLOOR_C, abs=0.5)  # where a mirrored picture would have the arm
    with rasterio.open(tmp_path / "orthophoto" / "rgb.tif") as raster:
        assert raster.count == 4 and raster.dtypes[0] == "uint8"


def test_an_orthophoto_of_a_chosen_plane(tmp_path: Path) -> None:
    scene = corner(ExportConfig(pixel_m=0.05))
    frame = scene.subject.frame("z-up")
    towards = (
        frame.from_world.rotation
        @ scene.subject.scene.given_from_world.rotation.T
        @ GIVEN_FROM_UPRIGHT.rotation
        @ [0.0, -1.0, 0.0]
    )
    normal = (float(towards[0]), float(towards[1]), float(towards[2]))
    chosen = replace(scene, subject=replace(scene.subject, settings=ExportConfig(pixel_m=0.05, normal=normal)))
    written(chosen, "orthophoto", tmp_path)
    with rasterio.open(tmp_path / "orthophoto" / "temperature.tif") as raster:
        values = raster.read(1)
    rows, columns = np.nonzero(values > 45)
    middle = values.shape[1] / 2
    assert len(rows) and columns.mean() > middle  # seen from −y, the arm along x points to the right
    up = np.nonzero((values > 27) & (values < 33))[0]
    assert up.min() < rows.min()  # and the arm along z to the top


def test_without_an_up_the_plane_has_to_be_named(tmp_path: Path) -> None:
    scene = corner(ExportConfig(frame="sfm"))
    with pytest.raises(RtgsError, match="--normal"):
        written(scene, "orthophoto", tmp_path)


def test_a_geotiff_knows_its_place_on_the_earth(tmp_path: Path) -> None:
    place = RasterPlace(-10.0, 20.0, 0.5, "metres east and north", latitude_deg=60.19, longitude_deg=24.83)
    write_geotiff(tmp_path / "a.tif", np.arange(12, dtype=np.float32).reshape(3, 4), place)
    with rasterio.open(tmp_path / "a.tif") as raster:
        assert raster.xy(0, 0) == (-9.75, 19.75) and raster.read(1)[2, 3] == 11
        longitude, latitude = transform(raster.crs, "EPSG:4326", [0.0], [100.0])
    assert longitude[0] == pytest.approx(24.83, abs=1e-9)
    assert latitude[0] == pytest.approx(60.19 + 100 / 111_412, abs=2e-6)
    assert SFM_PER_METRE == 2.5


def test_where_the_place_is_known_files_are_east_north_and_up_of_it(tmp_path: Path) -> None:
    rotation = GIVEN_FROM_UPRIGHT.rotation.T
    rows = tuple(tuple(float(v) for v in row) for row in rotation)
    shift = tuple((-rotation @ GIVEN_FROM_UPRIGHT.translation / SFM_PER_METRE).tolist())
    place = Georeference(60.19, 24.83, 50.0, "ellipsoid", 1 / SFM_PER_METRE, rows, shift, (0.1, 0.1, 0.2))  # type: ignore[arg-type]
    scene = corner(ExportConfig(spacing_m=0.05, pixel_m=0.05))
    scene = replace(scene, subject=replace(scene.subject, place=place))
    written(scene, "points-laz", tmp_path)
    las = laspy.read(tmp_path / "points.laz")
    hot = las["temperature"] > 40
    assert np.asarray(las.x)[hot].mean() > 0.3 and abs(np.asarray(las.y)[hot]).mean() < 0.2  # the arm to the east
    assert np.median(las.z) == pytest.approx(49.9, abs=0.06)  # altitudes
    (vlr,) = las.header.vlrs.get("WktCoordinateSystemVlr")
    assert "60.19" in vlr.string and las.header.global_encoding.wkt
    written(scene, "orthophoto", tmp_path)
    with rasterio.open(tmp_path / "orthophoto" / "temperature.tif") as raster:
        (longitude,), (latitude,) = transform(raster.crs, "EPSG:4326", [1.2], [0.0])
        row, column = raster.index(1.2, 0.0)
        assert raster.read(1)[row, column] == pytest.approx(50.0, abs=3.0)
    assert latitude == pytest.approx(60.19, abs=1e-8) and longitude == pytest.approx(24.83 + 1.2 / 55_400, abs=2e-7)


def test_thermal_cameras_stand_where_the_images_say_whatever_metres_rest_on(tmp_path: Path) -> None:
    scene = corner()
    scene = replace(scene, subject=replace(scene.subject, metres_per_sfm=0.5))  # another source says that all is 25 % larger
    (folder,) = written(scene, "colmap", tmp_path)
    (rig,) = pycolmap.Reconstruction(str(folder / "sparse" / "0")).rigs.values()
    (sensor_from_rig,) = rig.non_ref_sensors.values()
    assert np.linalg.norm(sensor_from_rig.translation) == pytest.approx(1.25 * BASELINE_M)


def test_the_largest_upright_plane_is_seen_from_its_front(tmp_path: Path) -> None:
    """The corner's floor, stood up: what was up points south, and east stays east."""
    stood_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]) @ GIVEN_FROM_UPRIGHT.rotation.T
    rows = tuple(tuple(float(v) for v in row) for row in stood_up)
    place = Georeference(0.0, 0.0, 0.0, "unknown", 1 / SFM_PER_METRE, rows, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))  # type: ignore[arg-type]
    scene = corner(ExportConfig(pixel_m=0.05, plane="facade"))
    written(replace(scene, subject=replace(scene.subject, place=place)), "orthophoto", tmp_path)
    with rasterio.open(tmp_path / "orthophoto" / "temperature.tif") as raster:
        values = raster.read(1)
    assert 3.4 < values.shape[0] * 0.05 < 4.2 and 3.4 < values.shape[1] * 0.05 < 4.2  # the floor's 3.6 m
    middle = np.array(values.shape) / 2
    hot, warm = np.argwhere(values > 47), np.argwhere((values > 38) & (values < 42))
    assert (hot.mean(axis=0) - middle)[1] > 5  # the arm along x, to the right
    assert (warm.mean(axis=0) - middle)[0] < -5  # the arm along y, now upwards
    assert np.nanmedian(values) == pytest.approx(FLOOR_C, abs=0.3)
