"""PLY round trips, the INRIA layout, foreign files and broken ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from numpy.lib.recfunctions import append_fields, drop_fields
from plyfile import PlyData, PlyElement
from tests.helpers.gaussian_clouds import cloud

from rtgs.base.errors import RtgsError
from rtgs.io.ply import THERMAL_PROPERTIES, read_background, read_ply, read_thermal_ply, write_ply
from rtgs.maths.geometry import Sim3, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.records.gaussians import Gaussians


def model(degree: int, channels: int, n: int = 7) -> Gaussians:
    g = torch.Generator().manual_seed(degree)
    return Gaussians(
        means=torch.randn(n, 3, generator=g),
        quats=torch.randn(n, 4, generator=g),
        log_scales=torch.randn(n, 3, generator=g) - 3,
        opacity_logits=torch.randn(n, generator=g),
        sh=torch.randn(n, (degree + 1) ** 2, channels, generator=g),
    )


def assert_same(a: Gaussians, b: Gaussians) -> None:
    for name, tensor in a.tensors().items():
        assert tensor.dtype == b.tensors()[name].dtype
        assert torch.equal(tensor, b.tensors()[name]), name


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip_is_exact(tmp_path: Path, degree: int, channels: int) -> None:
    original = model(degree, channels)
    write_ply(tmp_path / "model.ply", original)
    assert_same(original, read_ply(tmp_path / "model.ply"))
    assert [p.name for p in tmp_path.iterdir()] == ["model.ply"]  # the temporary file is gone


def test_layout_is_inrias(tmp_path: Path) -> None:
    original = model(1, 3, n=2)
    write_ply(tmp_path / "model.ply", original)
    ply = PlyData.read(str(tmp_path / "model.ply"))
    assert not ply.text and ply.byte_order == "<"
    vertex = ply["vertex"].data
    assert vertex.dtype.names == (
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(9)), "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    )
    assert all(vertex.dtype[name] == np.dtype("<f4") for name in vertex.dtype.names)
    # f_rest is channel-major: three coefficients of red, then of green, then of blue.
    for channel in range(3):
        for coefficient in range(3):
            np.testing.assert_array_equal(
                vertex[f"f_rest_{3 * channel + coefficient}"], original.sh[:, 1 + coefficient, channel].numpy()
            )


def test_thermal_model_looks_gray_and_carries_its_temperature(tmp_path: Path) -> None:
    original = model(2, 1)
    dc = torch.tensor([0.0, 0.5 / C0, -0.5 / C0, -10.0, 1.0, 2.0, -1.0])
    original.sh[:, 0, 0] = dc
    write_ply(tmp_path / "thermal.ply", original, celsius_range=(10.1, 30.3))
    vertex = PlyData.read(str(tmp_path / "thermal.ply"))["vertex"]
    for i in range(8):
        np.testing.assert_array_equal(vertex[f"f_rest_{i}"], vertex[f"f_rest_{8 + i}"])
        np.testing.assert_array_equal(vertex[f"f_rest_{i}"], vertex[f"f_rest_{16 + i}"])
    np.testing.assert_array_equal(vertex["f_dc_0"], vertex["f_dc_2"])
    # DC 0 is mid-range; ±½/C0 are the ends; a colour below black is clamped at the cold end, as the renderer does.
    np.testing.assert_allclose(vertex["temperature"][:4], [20.2, 30.3, 10.1, 10.1], atol=1e-5)
    back = read_thermal_ply(tmp_path / "thermal.ply")
    assert back.celsius_range == (10.1, 30.3)
    assert_same(original, back.gaussians)


def test_another_reader_finds_the_thermal_properties(tmp_path: Path) -> None:
    """trimesh keeps what it does not know, as CloudCompare does; `read_ply` and viewers pass over it."""
    original, given = model(1, 1), {}
    for i, name in enumerate(THERMAL_PROPERTIES):
        given[name] = np.linspace(i, i + 1, len(original)).astype(np.float32)
    write_ply(tmp_path / "thermal.ply", original, celsius_range=(10.0, 30.0), properties=given)
    cloud = trimesh.load(tmp_path / "thermal.ply")
    stored = cloud.metadata["_ply_raw"]["vertex"]["data"]
    vertex = PlyData.read(str(tmp_path / "thermal.ply"))["vertex"].data
    assert vertex.dtype.names[-3:] == ("temperature", "temperature_std", "views")  # behind all that viewers look for
    for name, values in given.items():
        np.testing.assert_array_equal(np.ravel(stored[name]), values)
        np.testing.assert_array_equal(vertex[name], values)
    assert_same(original, read_ply(tmp_path / "thermal.ply"))
    back = read_thermal_ply(tmp_path / "thermal.ply").properties
    assert list(back) == list(given) and all(np.array_equal(back[k], given[k]) for k in given)


def test_other_properties_are_refused(tmp_path: Path) -> None:
    values = np.zeros(7, np.float32)
    with pytest.raises(ValueError, match="temperature_std"):
        write_ply(tmp_path / "a.ply", model(0, 1), properties={"opacity": values})
    with pytest.raises(ValueError, match="thermal model"):
        write_ply(tmp_path / "a.ply", model(0, 3), properties={"views": values})
    with pytest.raises(RtgsError, match="views holds NaN"):
        write_ply(tmp_path / "a.ply", model(0, 1), properties={"views": values * np.nan})
    assert not list(tmp_path.iterdir())


def test_relative_thermal_model_has_no_temperature(tmp_path: Path) -> None:
    write_ply(tmp_path / "thermal.ply", model(0, 1))
    assert "temperature" not in PlyData.read(str(tmp_path / "thermal.ply"))["vertex"].data.dtype.names
    assert read_thermal_ply(tmp_path / "thermal.ply").celsius_range is None


def test_hand_written_ascii_file_of_another_tool(tmp_path: Path) -> None:
    # No normals, an unknown property and an unknown element, doubles, its own order, CRLF-free ASCII.
    header = """ply
format ascii 1.0
comment made by hand
element vertex 2
property double opacity
property double rot_0
property double rot_1
property double rot_2
property double rot_3
property float x
property float y
property float z
property uchar segment
property double scale_0
property double scale_1
property double scale_2
property float f_dc_2
property float f_dc_1
property float f_dc_0
element camera 1
property float focal
end_header
"""
    (tmp_path / "hand.ply").write_text(
        header + "0.5 1 0 0 0 1 2 3 9 -1 -2 -3 0.3 0.2 0.1\n-2 0.5 0.5 0.5 0.5 4 5 6 8 -4 -5 -6 0.6 0.5 0.4\n100\n"
    )
    got = read_ply(tmp_path / "hand.ply")
    expected = Gaussians(
        means=torch.tensor([[1.0, 2, 3], [4, 5, 6]]),
        quats=torch.tensor([[1.0, 0, 0, 0], [0.5, 0.5, 0.5, 0.5]]),
        log_scales=torch.tensor([[-1.0, -2, -3], [-4, -5, -6]]),
        opacity_logits=torch.tensor([0.5, -2.0]),
        sh=torch.tensor([[[0.1, 0.2, 0.3]], [[0.4, 0.5, 0.6]]]),
    )
    assert_same(expected, got)


def test_big_endian_and_shuffled_properties(tmp_path: Path) -> None:
    original = model(1, 3)
    write_ply(tmp_path / "model.ply", original)
    vertex = PlyData.read(str(tmp_path / "model.ply"))["vertex"].data
    shuffled = np.empty(len(vertex), dtype=[(n, ">f8") for n in reversed(vertex.dtype.names)])
    for name in vertex.dtype.names:
        shuffled[name] = vertex[name]
    PlyData([PlyElement.describe(shuffled, "vertex")], byte_order=">").write(str(tmp_path / "foreign.ply"))
    assert_same(original, read_ply(tmp_path / "foreign.ply"))


@pytest.mark.parametrize("field", ["y", "f_dc_1", "opacity", "scale_2", "rot_3"])
@pytest.mark.parametrize("damage", ["missing", "NaN"])
def test_error_names_file_and_field(tmp_path: Path, field: str, damage: str) -> None:
    write_ply(tmp_path / "model.ply", model(1, 3))
    vertex = np.array(PlyData.read(str(tmp_path / "model.ply"))["vertex"].data)
    if damage == "missing":
        vertex = drop_fields(vertex, field)
    else:
        vertex[field][2] = np.nan
    PlyData([PlyElement.describe(vertex, "vertex")]).write(str(tmp_path / "bad.ply"))
    with pytest.raises(RtgsError, match=rf"bad\.ply: field '{field}' is {damage}"):
        read_ply(tmp_path / "bad.ply")


def test_a_filter_that_changes_the_model_is_refused(tmp_path: Path) -> None:
    """Mip-Splatting draws its Gaussians larger and fainter than its PLY says on its own."""
    path = tmp_path / "model.ply"
    write_ply(path, model(1, 3))
    data = PlyData.read(str(path))["vertex"].data
    more = append_fields(data, "filter_3D", np.full(len(data), 0.1, np.float32), usemask=False)
    PlyData([PlyElement.describe(more, "vertex")]).write(str(path))
    with pytest.raises(RtgsError, match=r"model\.ply: has the property filter_3D of Mip-Splatting"):
        read_ply(path)


def test_wrong_number_of_harmonics(tmp_path: Path) -> None:
    write_ply(tmp_path / "model.ply", model(1, 3))
    vertex = PlyData.read(str(tmp_path / "model.ply"))["vertex"].data
    fewer = drop_fields(vertex, "f_rest_8")
    PlyData([PlyElement.describe(fewer, "vertex")]).write(str(tmp_path / "bad.ply"))
    with pytest.raises(RtgsError, match="8 f_rest fields"):
        read_ply(tmp_path / "bad.ply")


def test_files_that_are_no_model(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"absent\.ply"):
        read_ply(tmp_path / "absent.ply")
    (tmp_path / "picture.ply").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    with pytest.raises(RtgsError, match=r"picture\.ply: not a whole PLY"):
        read_ply(tmp_path / "picture.ply")
    (tmp_path / "empty.ply").write_bytes(b"")
    with pytest.raises(RtgsError, match=r"empty\.ply: not a whole PLY"):
        read_ply(tmp_path / "empty.ply")
    write_ply(tmp_path / "model.ply", model(3, 3))
    whole = (tmp_path / "model.ply").read_bytes()
    (tmp_path / "short.ply").write_bytes(whole[:-5])
    with pytest.raises(RtgsError, match=r"short\.ply: not a whole PLY"):
        read_ply(tmp_path / "short.ply")
    none = PlyElement.describe(np.zeros(3, dtype=[("x", "f4")]), "face")
    PlyData([none]).write(str(tmp_path / "mesh.ply"))
    with pytest.raises(RtgsError, match="without 'vertex'"):
        read_ply(tmp_path / "mesh.ply")
    with pytest.raises(RtgsError, match="not a thermal model"):
        read_thermal_ply(tmp_path / "model.ply")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    write_ply(tmp_path / "model.ply", model(0, 3))
    before = (tmp_path / "model.ply").read_bytes()
    broken = model(0, 3)
    broken.log_scales[1, 1] = float("nan")
    with pytest.raises(RtgsError, match="log_scales"):
        write_ply(tmp_path / "model.ply", broken)
    assert (tmp_path / "model.ply").read_bytes() == before
    with pytest.raises(RtgsError, match="cannot be written"):
        write_ply(tmp_path / "no" / "model.ply", model(0, 3))
    with pytest.raises(ValueError, match="thermal"):
        write_ply(tmp_path / "model.ply", model(0, 3), celsius_range=(0, 1))


def test_the_background_of_an_rgb_model_is_kept(tmp_path: Path) -> None:
    color = tuple(torch.tensor([1.0, 0.123456789, 0.0]).tolist())
    write_ply(tmp_path / "with.ply", cloud(3, 0, 3), background=color)
    write_ply(tmp_path / "without.ply", cloud(3, 0, 3))
    assert read_background(tmp_path / "with.ply") == color and read_background(tmp_path / "without.ply") is None


@pytest.mark.parametrize("numbers", ["0.5 0.5", "0.5 0.5 red", "0.5 0.5 2", "nan 0 0"])
def test_a_damaged_background_is_refused(tmp_path: Path, numbers: str) -> None:
    write_ply(tmp_path / "model.ply", cloud(3, 0, 3), background=(0.5, 0.5, 0.5))
    data = (tmp_path / "model.ply").read_bytes().replace(b"background 0.5 0.5 0.5", f"background {numbers}".encode())
    (tmp_path / "model.ply").write_bytes(data)
    with pytest.raises(RtgsError, match=r"model\.ply: unreadable comment 'rtgs background"):
        read_background(tmp_path / "model.ply")


FRAMES = {"near": Sim3(3.0, np.eye(3), np.array([20.0, -4.0, 0.1])), "far": Sim3(3.0, np.eye(3), np.array([1e7, -6e6, 200.0]))}


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("frame", FRAMES)
def test_a_file_holds_the_given_frame(tmp_path: Path, frame: str, channels: int) -> None:
    original, given_from_world = model(1, channels), FRAMES[frame]
    write_ply(tmp_path / "model.ply", original, given_from_world=given_from_world)
    data = PlyData.read(tmp_path / "model.ply")["vertex"].data
    expected = given_from_world.apply(original.means.double().numpy())
    found = np.stack([data[name] for name in "xyz"], axis=1)
    assert found.dtype == (np.float64 if frame == "far" else np.float32)  # floats are half a metre apart at 1e7
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6 if frame == "near" else 2e-9)
    np.testing.assert_allclose(data["scale_0"], original.log_scales[:, 0] + np.log(3.0), atol=1e-6)
    assert {data.dtype[name].str for name in data.dtype.names if name not in "xyz"} == {"<f4"}

    back = read_ply(tmp_path / "model.ply", given_from_world)
    torch.testing.assert_close(back.means, original.means, rtol=0, atol=1e-6)
    torch.testing.assert_close(back.log_scales, original.log_scales, rtol=0, atol=1e-6)
    for name in ("quats", "opacity_logits", "sh"):
        assert torch.equal(back.tensors()[name], original.tensors()[name])


def test_doubles_of_another_program_are_read_in_full(tmp_path: Path) -> None:
    original = model(0, 3)
    write_ply(tmp_path / "model.ply", original)
    data = PlyData.read(tmp_path / "model.ply")["vertex"].data
    wide = np.empty(len(data), [(n, "<f8" if n in "xyz" else "<f4") for n in data.dtype.names])
    for n in data.dtype.names:
        wide[n] = data[n]
    wide["x"] += 4.5e6
    PlyData([PlyElement.describe(wide, "vertex")]).write(tmp_path / "utm.ply")
    back = read_ply(tmp_path / "utm.ply", Sim3(2.0, np.eye(3), np.array([4.5e6, 0.0, 0.0])))
    torch.testing.assert_close(back.means, original.means / 2, rtol=0, atol=1e-7)


def test_a_frame_that_turns_is_refused(tmp_path: Path) -> None:
    turned = Sim3(1.0, rotation_from_axis_angle([0.1, 0.0, 0.0]), np.zeros(3))
    with pytest.raises(ValueError, match="turns"):
        write_ply(tmp_path / "model.ply", model(0, 3), given_from_world=turned)
    with pytest.raises(ValueError, match="turns"):
        write_ply(tmp_path / "model.ply", model(0, 3))
        read_ply(tmp_path / "model.ply", turned)
