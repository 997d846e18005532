"""Every format of Gaussians, opened by an independent reader: the same Gaussians, temperatures, axes and metres."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import gsply
import numpy as np
import pytest
import torch
import trimesh
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData
from pxr import Usd, UsdGeom, UsdVol
from tests.helpers.corner_run import RANGE, SFM_PER_METRE, Corner, corner

from rtgs.config import ExportConfig, ExportFormat
from rtgs.io.exports.formats import FORMATS
from rtgs.io.ply import read_background, read_thermal_ply
from rtgs.maths.quaternions import rotations_from_quats
from rtgs.maths.sh import C0, basis


class Read(NamedTuple):
    """Gaussians as another program reads them.

    Positions, sizes, quaternions `wxyz`, opacities, colours without direction, °C where the format has them.
    """

    xyz: NDArray
    sizes: NDArray
    quats: NDArray
    opacities: NDArray
    colours: NDArray
    celsius: NDArray | None


def by_gsply(path: Path) -> Read:
    data = gsply.plyread(str(path)) if path.suffix == ".ply" else gsply.read_spz(str(path))
    colours = data.sh0 * C0 + 0.5
    return Read(data.means, np.exp(data.scales), data.quats, 1 / (1 + np.exp(-data.opacities.ravel())), colours, None)


def by_plyfile(path: Path) -> Read:
    read, vertices = by_gsply(path), PlyData.read(str(path))["vertex"].data
    return read._replace(celsius=vertices["temperature"] if "temperature" in vertices.dtype.names else None)


def by_hand_glb(path: Path) -> Read:
    blob = path.read_bytes()
    length = int.from_bytes(blob[12:16], "little")
    document, body = json.loads(blob[20 : 20 + length]), blob[20 + length + 8 :]
    (primitive,) = document["meshes"][0]["primitives"]

    def column(name: str) -> NDArray:
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        values = np.frombuffer(body, "<f4", view["byteLength"] // 4, view["byteOffset"])
        return values.reshape(accessor["count"], -1)

    cloud: Any = trimesh.load(path, force="scene")
    ours = column("POSITION")
    np.testing.assert_allclose(np.asarray(next(iter(cloud.geometry.values())).vertices), ours)
    extension = "KHR_gaussian_splatting"
    assert primitive["mode"] == 0 and primitive["extensions"][extension]["kernel"] == "ellipse"
    np.testing.assert_allclose(np.linalg.norm(column(f"{extension}:ROTATION"), axis=1), 1, atol=1e-6)
    colours = 0.5 + C0 * column(f"{extension}:SH_DEGREE_0_COEF_0")
    celsius = column("_TEMPERATURE")[:, 0] if "_TEMPERATURE" in primitive["attributes"] else None
    quats = column(f"{extension}:ROTATION")[:, [3, 0, 1, 2]]
    return Read(ours, column(f"{extension}:SCALE"), quats, column(f"{extension}:OPACITY")[:, 0], colours, celsius)


def by_usd(path: Path) -> Read:
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    xyz, sizes = (np.array(a.Get()) for a in (prim.GetPositionsAttr(), prim.GetScalesAttr()))
    harmonics = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get()).reshape(len(xyz), -1, 3)
    temperature = UsdGeom.PrimvarsAPI(prim).GetPrimvar("temperature")
    celsius = np.array(temperature.Get()) if temperature else None
    quats = np.array([[q.GetReal(), *q.GetImaginary()] for q in prim.GetOrientationsAttr().Get()])
    return Read(xyz, sizes, quats, np.array(prim.GetOpacitiesAttr().Get()), 0.5 + C0 * harmonics[:, 0], celsius)


class Case(NamedTuple):
    """A format, its suffix, its reader, which upright direction each file axis shows, and its precision."""

    name: ExportFormat
    suffix: str
    read: Callable[[Path], Read]
    upright_from_file: tuple[tuple[int, int, int], ...]
    metres: float
    level: float  # of colours
    sorted: bool = False


Y_DOWN = ((1, 0, 0), (0, 0, 1), (0, -1, 0))
Y_UP = ((1, 0, 0), (0, 0, -1), (0, 1, 0))
CASES = [
    Case("ply", ".ply", by_plyfile, Y_DOWN, 2e-6, 1e-6),
    Case("compressed-ply", ".compressed.ply", by_gsply, Y_DOWN, 2e-3, 0.005, sorted=True),
    Case("spz", ".spz", by_gsply, Y_UP, 3e-6, 0.01),
    Case("glb", ".glb", by_hand_glb, Y_UP, 2e-6, 1e-6),
    Case("usd", ".usdc", by_usd, Y_UP, 2e-6, 1e-6),
]


def written(scene: Corner, name: ExportFormat, out: Path) -> list[Path]:
    chosen = FORMATS[name]
    return chosen.write(scene.subject, scene.subject.frame(chosen.axes, fixed=not chosen.program_decides), out, None)


def heading(truth: NDArray, found: NDArray) -> NDArray:
    """The turn about z from truth to file, `[3, 3]`, by Procrustes on the horizontal coordinates of all points; it never mirrors."""
    u, _, vt = np.linalg.svd((truth[:, :2] - truth[:, :2].mean(0)).T @ (found[:, :2] - found[:, :2].mean(0)))
    turn = (vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)])) @ u.T
    return np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_same_gaussians_upright_and_in_metres(case: Case, tmp_path: Path) -> None:
    scene = corner()
    paths = written(scene, case.name, tmp_path)
    assert all(path.exists() for path in paths)
    read = case.read(tmp_path / f"rgb{case.suffix}")
    frame = scene.subject.frame(FORMATS[case.name].axes)
    truth, order = scene.xyz, np.arange(len(scene.xyz))
    found = read.xyz @ np.array(case.upright_from_file, float).T
    if case.sorted:
        ours = frame.of(scene.subject.rgb.gaussians.means.double().numpy())
        order = np.linalg.norm(read.xyz[:, None] - ours[None], axis=2).argmin(axis=1)
        assert len(set(order.tolist())) == len(truth)
    expected = truth[order] @ heading(truth[order], found).T
    offset = (found - expected).mean(axis=0)
    # A flipped or mirrored axis would move the arms by tenths of metres; "up" is found from the cameras, to a thousandth.
    np.testing.assert_allclose(found, expected + offset, atol=case.metres + 2e-6)
    np.testing.assert_allclose(
        np.sort(read.sizes, axis=1), np.sort(scene.sizes[order], axis=1), rtol=0.04 if case.name == "spz" else 0.01
    )
    axes = rotations_from_quats(torch.as_tensor(np.asarray(read.quats, np.float64))).numpy()
    shape = axes @ (read.sizes[:, :, None] ** 2 * axes.transpose(0, 2, 1))
    head = heading(truth[order], found)
    there = np.einsum("ij,nj,kj->nik", head, scene.sizes[order] ** 2, head)
    upright = np.array(case.upright_from_file, float)
    largest = (scene.sizes[order] ** 2).max(axis=1)[:, None, None]
    np.testing.assert_allclose(upright @ shape @ upright.T / largest, there / largest, atol=0.1 if case.name == "spz" else 0.02)
    np.testing.assert_allclose(read.colours, scene.colours[order], atol=case.level)
    np.testing.assert_allclose(read.opacities, 1 / (1 + np.exp(-5.0)), atol=0.004)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_temperatures_are_columns_or_colours_that_can_be_turned_back(case: Case, tmp_path: Path) -> None:
    scene = corner(ExportConfig(thermal_colours="gray"))
    written(scene, case.name, tmp_path)
    read = case.read(tmp_path / f"thermal{case.suffix}")
    if case.name in ("compressed-ply", "spz"):
        assert read.celsius is None and FORMATS[case.name].cannot_hold
        lo, hi = scene.celsius.min(), scene.celsius.max()
        celsius = np.sort(lo + (hi - lo) * read.colours[:, 0])
        np.testing.assert_allclose(celsius, np.sort(scene.celsius), atol=0.22)  # SPZ: 8 bits over three times the range
    else:
        assert read.celsius is not None
        np.testing.assert_allclose(read.celsius, scene.celsius, atol=1e-5)


def test_a_palette_shows_the_temperatures_and_has_its_legend(tmp_path: Path) -> None:
    scene = corner()
    written(scene, "ply", tmp_path)
    coloured = by_gsply(tmp_path / "thermal_palette.ply").colours
    hot, cold = coloured[scene.celsius == 50.0], coloured[scene.celsius == 20.0]
    assert hot.sum(axis=1).min() > 2 * cold.sum(axis=1).max()  # inferno gets brighter
    picture = np.asarray(Image.open(tmp_path / "thermal_palette_legend.png"))
    assert picture.shape[0] == 400 and len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    ply = read_thermal_ply(tmp_path / "thermal.ply")
    assert ply.celsius_range == (RANGE.lo, RANGE.hi)


@pytest.mark.parametrize(("program", "upright_from_file"), [("spark", Y_DOWN), ("niantic", Y_UP)])
def test_spz_has_the_axes_of_the_program_that_reads_it(
    program: str, upright_from_file: tuple[tuple[int, int, int], ...], tmp_path: Path
) -> None:
    scene = corner(ExportConfig(program=program))  # type: ignore[arg-type]
    written(scene, "spz", tmp_path)
    found = by_gsply(tmp_path / "rgb.spz").xyz @ np.array(upright_from_file, float).T
    arm = found[scene.celsius == 30.0]
    assert arm[-1, 2] - arm[0, 2] == pytest.approx(0.45, abs=1e-3)  # the arm that points up


def test_the_raw_frame_is_the_run_s_own(tmp_path: Path) -> None:
    scene = corner(ExportConfig(frame="sfm"), origin=1e7)
    written(scene, "ply", tmp_path)
    vertices = PlyData.read(str(tmp_path / "rgb.ply"))["vertex"].data
    given = scene.subject.scene.given_from_world.apply(scene.subject.rgb.gaussians.means.double().numpy())
    np.testing.assert_array_equal(np.stack([vertices[n] for n in "xyz"], axis=1), given)
    assert vertices["x"].dtype == np.float64
    assert PlyData.read(str(tmp_path / "thermal_palette.ply"))["vertex"].data["x"].dtype == np.float64
    assert read_background(tmp_path / "rgb.ply") == pytest.approx((0.1, 0.2, 0.3))
    assert np.exp(vertices["scale_0"][0]) == pytest.approx(0.07 * SFM_PER_METRE, rel=1e-5)


def test_harmonics_turn_with_the_model(tmp_path: Path) -> None:
    """Light from one side stays on that side, as another reader's numbers show."""
    scene = corner()
    rgb, frame = scene.subject.rgb, scene.subject.frame("y-up")
    generator = torch.Generator().manual_seed(1)
    sh = torch.randn(len(rgb.gaussians), 16, 3, generator=generator)
    scene = replace(scene, subject=replace(scene.subject, rgb=replace(rgb, gaussians=replace(rgb.gaussians, sh=sh))))
    chosen = FORMATS["ply"]
    chosen.write(scene.subject, frame, tmp_path, None)
    data = gsply.plyread(str(tmp_path / "rgb.ply"))
    found = torch.as_tensor(np.concatenate([data.sh0[:, None], data.shN.reshape(len(sh), 15, 3)], axis=1)).double()
    direction = torch.tensor([[0.36, -0.48, 0.8]], dtype=torch.float64)
    world = direction @ torch.as_tensor(frame.from_world.rotation)
    torch.testing.assert_close(basis(direction, 3) @ found, basis(world, 3) @ sh.double(), rtol=0, atol=2e-5)
