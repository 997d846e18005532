"""Files that are valid, or nearly, and unlike what most programs write: read right, or refused with the reason."""

from __future__ import annotations

import json
import struct
import unicodedata
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.captures import NAMES, POSES, edit_rig, edit_transforms, refused, write_poses, write_sparse
from tests.helpers.gaussian_clouds import cloud

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_sparse
from rtgs.io.image_files import check_counts_mode, frame_name, read_counts, read_header
from rtgs.io.ply import read_ply, write_ply


def tiff(
    path: Path, pixels: NDArray[Any], bits: int, sample_format: int, *, width: int = 0, photometric: int = 1, order: str = "<"
) -> Path:
    """An uncompressed TIFF of one strip with exactly these tags, for kinds that Pillow does not write."""
    height, data = len(pixels), pixels.tobytes()
    tags = {
        256: width or pixels.shape[1],
        257: height,
        258: bits,
        259: 1,
        262: photometric,
        273: 8,
        277: 1,
        278: height,
        279: len(data),
        339: sample_format,
    }
    entries = b"".join(
        struct.pack(order + "HHII" if tag in (273, 279) else order + "HHIHxx", tag, 4 if tag in (273, 279) else 3, 1, v)
        for tag, v in tags.items()
    )
    head = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8 + len(data))
    path.write_bytes(head + data + struct.pack(order + "H", len(tags)) + entries + bytes(4))
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(
    ("kind", "bits", "sample_format"), [("f8", 64, 3), ("f4", 32, 3), ("i2", 16, 2), ("u2", 16, 1), ("i1", 8, 2)]
)
def test_kinds_of_numbers_in_a_tiff(tmp_path: Path, kind: str, bits: int, sample_format: int, order: str) -> None:
    counts = (np.arange(12 * 10).reshape(12, 10) - 5 * (kind != "u2")).astype(order + kind)
    path = tiff(tmp_path / "a.tiff", counts, bits, sample_format, order=order)
    check_counts_mode(read_header(path))
    np.testing.assert_array_equal(read_counts(path), counts)


@pytest.mark.parametrize(
    ("kind", "bits", "sample_format", "said"),
    [
        ("f2", 16, 3, "floating-point numbers of 16 bits"),
        ("u8", 64, 1, "unsigned whole numbers of 64"),
        ("i8", 64, 2, "whole numbers of 64"),
    ],
)
def test_numbers_that_are_not_read_are_named(tmp_path: Path, kind: str, bits: int, sample_format: int, said: str) -> None:
    path = tiff(tmp_path / "a.tiff", np.ones((12, 10), kind), bits, sample_format)
    with pytest.raises(RtgsError, match=rf"a\.tiff: cannot be read \(a TIFF of .*{said}"):
        read_header(path)


@pytest.mark.parametrize("photometric", [0, 1])
@pytest.mark.parametrize("bits", [1, 2, 4])
def test_a_handful_of_levels_is_no_thermal_image(tmp_path: Path, bits: int, photometric: int) -> None:
    """Pillow would stretch the numbers to eight bits, and turn them round where the smallest is shown white."""
    rows = np.zeros((12, bits), np.uint8)
    path = tiff(tmp_path / "a.tiff", rows, bits, 1, width=8, photometric=photometric)
    with pytest.raises(RtgsError, match=f"has {bits} bits a pixel"):
        check_counts_mode(read_header(path))
    image = Image.new("1" if bits == 1 else "L", (8, 8))
    image.save(tmp_path / "a.png", bits=bits)
    with pytest.raises(RtgsError, match=f"has {bits} bits a pixel"):
        check_counts_mode(read_header(tmp_path / "a.png"))


@pytest.mark.parametrize(("tag", "type_code"), [(256, 2), (258, 5), (262, 12), (273, 7), (277, 2), (339, 5)])
def test_tags_of_another_type(tmp_path: Path, tag: int, type_code: int) -> None:
    path = tiff(tmp_path / "a.tiff", np.ones((12, 10), "<u2"), 16, 1)
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<H", tag), 8 + 240)
    struct.pack_into("<H", data, at + 2, type_code)
    path.write_bytes(data)
    with pytest.raises(RtgsError, match=r"a\.tiff: "):
        check_counts_mode(read_header(path))
        read_counts(path)
        raise RtgsError("a.tiff: is read all the same")


def test_a_link_to_itself(root: Path) -> None:
    path = root / "rgb" / f"{NAMES[2]}.png"
    path.unlink()
    path.symlink_to(path.name)
    refused(root, path.name, "symbolic links")


@pytest.mark.parametrize("form", ("NFC", "NFD"))
def test_names_in_two_forms_of_unicode_are_one_name(root: Path, form: Literal["NFC", "NFD"]) -> None:
    names = [f"Gebäude {i}" for i in range(5)]
    for i, name in enumerate(names):
        (root / "rgb" / f"{NAMES[i]}.png").rename(root / "rgb" / f"{unicodedata.normalize('NFC', name)}.png")
        (root / "thermal" / f"{NAMES[i]}.tiff").rename(root / "thermal" / f"{unicodedata.normalize(form, name)}.tiff")
    write_poses(root, poses={unicodedata.normalize("NFD", name): pose for name, pose in zip(names, POSES.values(), strict=True)})
    capture = load_capture(root)
    assert (
        [frame.name for frame in capture.frames] == names and capture.poses is not None and len(capture.poses.world_from_rgb) == 5
    )
    assert capture.frames[0].thermal.shape == (32, 40)
    said = [warning for warning in capture.warnings if "Unicode" in warning]
    assert len(said) == (form == "NFD") and ("5 of 5" in said[0] if said else True)


def test_two_files_of_one_name_in_two_forms(root: Path) -> None:
    for form in ("NFC", "NFD"):
        (root / "rgb" / f"{unicodedata.normalize(form, 'é')}.png").write_bytes((root / "rgb" / f"{NAMES[0]}.png").read_bytes())
    refused(root, "rgb", "share the stem 'é'")
    assert frame_name(unicodedata.normalize("NFD", "é.png")) == "é"


@pytest.mark.parametrize("text", [False, True])
def test_names_with_spaces_in_a_colmap_model(root: Path, text: bool) -> None:
    poses = {f"DJI  00{i} (copy) ü": pose for i, pose in enumerate(POSES.values())}
    write_sparse(root, poses=poses, text=text, pattern="day 1/{}.JPG")
    found = read_sparse(root / "sparse" / "0")[1].world_from_rgb
    assert list(found) == list(poses)
    for name, pose in poses.items():
        np.testing.assert_allclose(found[name].matrix(), pose.matrix(), atol=1e-12)


@pytest.mark.parametrize("text", [False, True])
def test_ids_of_points_from_two_to_the_63_on(root: Path, text: bool) -> None:
    write_sparse(root, text=text)
    path = root / "sparse" / "0" / ("points3D.txt" if text else "points3D.bin")
    data = path.read_bytes()
    new = data.replace(b"\n1 ", b"\n9223372036854775813 ") if text else data[:8] + struct.pack("<Q", 2**63 + 5) + data[16:]
    assert new != data
    path.write_bytes(new)
    points = read_sparse(root / "sparse" / "0")[1].points
    assert points is not None
    np.testing.assert_allclose(points.xyz, [[0.1, 0.2, 0.3]])


def test_names_of_a_colmap_model_that_are_no_text(root: Path) -> None:
    write_sparse(root)
    path = root / "sparse" / "0" / "images.bin"
    path.write_bytes(path.read_bytes().replace(NAMES[1].encode(), b"\xff" + NAMES[1].encode()[1:]))
    refused(root, "sparse/0", "not UTF-8")


def test_a_count_of_2e18_in_a_colmap_model(root: Path) -> None:
    write_sparse(root)
    path = root / "sparse" / "0" / "images.bin"
    data = bytearray(path.read_bytes())
    struct.pack_into("<Q", data, 8 + 64 + len(NAMES[0]) + 5, 2 * 10**18)
    path.write_bytes(data)
    refused(root, "images.bin: is truncated")


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_ply_that_announces_two_thousand_million_gaussians(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, cloud(4, degree=0))
    header, _, body = path.read_bytes().partition(b"end_header\n")
    header = header.replace(b"vertex 4\n", b"vertex 2000000000\n").replace(b"binary_little_endian", kind.encode())
    path.write_bytes(header + b"end_header\n" + body)
    with pytest.raises(RtgsError, match=r"a\.ply: not a whole PLY file \(its header announces 34,000,000,000 numbers"):
        read_ply(path)


@pytest.mark.parametrize(("name", "value"), [("k1", 1e300), ("p2", -1e200), ("k2", 1e9)])
def test_a_lens_that_no_camera_has(root: Path, name: str, value: float) -> None:
    edit_rig(root, lambda data: data["rgb"].update({name: value}))
    refused(root, f"rgb.{name} is {value:g}", "Calibrate again")


@pytest.mark.parametrize("value", [{}, [], ["PINHOLE"], 7, True])
def test_a_camera_model_that_is_no_name(root: Path, value: Any) -> None:
    write_poses(root)
    edit_transforms(root, lambda data: data.update(camera_model=value or {"": value}))
    refused(root, "transforms.json: camera.model is")
    edit_rig(root, lambda data: data["rgb"].update(model=value))
    refused(root, "rig.json: rgb.model is")


@pytest.mark.parametrize("file", ["rig.json", "transforms.json"])
@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 900 + "1" + "}" * 900, '{"rgb": "\\ud800"}', '{"a": ' + "9" * 9000 + "x}"]
)
def test_json_that_is_odd_as_a_whole(root: Path, file: str, text: str) -> None:
    (root / "transforms.json").write_text("{}")
    (root / file).write_text(text)
    refused(root, f"{file}: is not valid JSON")


def test_numbers_of_400_digits(root: Path) -> None:
    write_poses(root)
    for digits in ("9" * 400, "-" + "9" * 5000):
        text = json.dumps(json.loads((root / "rig.json").read_text()))
        (root / "rig.json").write_text(text.replace('"fl_x": 60.0', f'"fl_x": {digits}'))
        refused(root, "rig.json: rgb.fl_x is", "inf; a finite number is expected")
        (root / "rig.json").write_text(text)
    edit_transforms(root, lambda data: data["frames"][1]["transform_matrix"][0].__setitem__(3, 10**400))
    refused(root, "transforms.json: frames[1].transform_matrix", "NaN or infinity")
