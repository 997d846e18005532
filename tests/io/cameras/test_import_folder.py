"""Folders of radiometric JPEGs become captures that load, or are refused before anything is written."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.radiometric_files import (
    FIELD_OF_VIEW_DEG,
    GPS,
    RADIOMETRY,
    SAMPLES,
    THERMAL_SIZE,
    VISIBLE_SIZE,
    camera_exif,
    camera_record,
    counts_of,
    encoded,
    fff,
    flir_jpeg,
    flir_segments,
    fusion_record,
    image_record,
    jpeg,
    needs_samples,
    raw_record,
    records,
    visible_of,
)

from rtgs.base.errors import RtgsError
from rtgs.cli import main
from rtgs.io.camera_tags import read_camera_tags
from rtgs.io.cameras.flir import read_flir
from rtgs.io.cameras.import_folder import import_folder
from rtgs.io.capture import load_capture
from rtgs.io.image_files import read_rgb
from rtgs.io.rig import read_rig, write_rig
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.radiometry import CENTIKELVIN, RelativeCounts
from rtgs.records.rig import Rig

NAMES = ("FLIR0001", "FLIR0002", "FLIR0003")
THERMAL_FOCAL_PX = THERMAL_SIZE[0] / 2 / np.tan(np.radians(FIELD_OF_VIEW_DEG / 2))
RGB_FOCAL_PX = THERMAL_FOCAL_PX * VISIBLE_SIZE[0] / THERMAL_SIZE[0] / 1.5  # Real2IR
RIG = Rig(
    Camera("PINHOLE", *VISIBLE_SIZE, RGB_FOCAL_PX, RGB_FOCAL_PX, 16.0, 12.0),
    Camera("PINHOLE", *THERMAL_SIZE, THERMAL_FOCAL_PX, THERMAL_FOCAL_PX, 8.0, 6.0),
    SE3(rotation_from_axis_angle([0.0, 0.01, 0.0]), np.array([0.03, 0.0, 0.001])),
)


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    for i, name in enumerate(NAMES):
        flir_jpeg(tmp_path / "photographs" / f"{name}.jpg", counts_of(i))
    return tmp_path / "photographs"


@pytest.mark.parametrize("suffix", [".RJPG", ".rjpg", ".RJPEG"])
def test_other_suffixes_of_radiometric_jpegs(photographs: Path, tmp_path: Path, suffix: str) -> None:
    (photographs / f"{NAMES[1]}.jpg").rename(photographs / f"{NAMES[1]}{suffix}")
    assert import_folder("flir", photographs, tmp_path / "out").frames == 3


def test_surroundings_that_are_hardly_possible_are_noted(photographs: Path, tmp_path: Path) -> None:
    """As when 298, meant in kelvin, is set in °C."""
    odd = replace(RADIOMETRY, parameters=replace(RADIOMETRY.parameters, reflected_c=298.0, emissivity=0.99))
    hot = odd.counts(np.random.default_rng(0).uniform(40, 90, THERMAL_SIZE[::-1])).round().astype(np.uint16)
    assert import_folder("flir", photographs, tmp_path / "usual").notes == ()
    flir_jpeg(photographs / f"{NAMES[2]}.jpg", hot, camera=camera_record(odd))
    notes = import_folder("flir", photographs, tmp_path / "out").notes
    assert any(
        f"reflected_c is 298 °C in 1 of 3 frames ({NAMES[2]}.jpg first). Was it meant in kelvin?" in note for note in notes
    )


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    write_rig(tmp_path / "rig.json", RIG, RelativeCounts())
    return tmp_path / "rig.json"


def refused(out: Path, call: Callable[[], object], *said: str) -> None:
    """The call fails with one message that holds each of `said`, and nothing was written."""
    with pytest.raises(RtgsError) as error:
        call()
    for part in said:
        assert part in str(error.value)
    assert "\n" not in str(error.value)
    assert not out.exists()


def decoded(file: bytes) -> NDArray[np.float32]:
    return np.asarray(Image.open(io.BytesIO(file)), np.float32) / np.float32(255)


# ---------------------------------------------------------------------------------------------------- FLIR


def test_with_a_rig_the_capture_loads(photographs: Path, rig: Path, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    result = import_folder(
        "flir", photographs, tmp_path / "out", rig=rig, progress=lambda done, total, _: seen.append((done, total))
    )
    assert (result.frames, result.missing, result.notes) == (3, (), ())
    assert seen == [(i + 1, 6) for i in range(6)]
    capture = load_capture(tmp_path / "out")
    assert [f.name for f in capture.frames] == list(NAMES)
    assert capture.radiometry.unit == "°C" and capture.warnings == ()
    for i, frame in enumerate(capture.frames):
        np.testing.assert_allclose(frame.thermal, RADIOMETRY.celsius(counts_of(i)), atol=1e-4)
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "out" / "thermal" / f"{frame.name}.tiff")), counts_of(i))
        np.testing.assert_array_equal(frame.rgb, decoded(encoded(visible_of(), "JPEG", quality=95)))
    assert capture.rig.rgb == RIG.rgb and capture.rig.thermal == RIG.thermal
    np.testing.assert_allclose(capture.rig.rgb_from_thermal.matrix(), RIG.rgb_from_thermal.matrix())


def test_round_trip_from_celsius_to_a_loaded_capture(tmp_path: Path, rig: Path) -> None:
    """°C → 16-bit counts → file → capture: a bias far under 0.05 °C, and no error above the half count of rounding."""
    truth_c = np.random.default_rng(7).uniform(-5, 80, (3, *THERMAL_SIZE[::-1]))
    for temperature_c, name in zip(truth_c, NAMES, strict=True):
        flir_jpeg(tmp_path / "in" / f"{name}.jpg", RADIOMETRY.counts(temperature_c).round().astype(np.uint16))
    import_folder("flir", tmp_path / "in", tmp_path / "out", rig=rig)
    error_c = np.stack([f.thermal for f in load_capture(tmp_path / "out").frames]) - truth_c
    half_count_c = 0.5 / np.diff(RADIOMETRY.counts(np.array([-5.0, -4.0])))  # where a degree is fewest counts
    assert np.abs(error_c).max() <= 1.01 * half_count_c
    assert abs(error_c.mean()) < 0.001


def test_visible_pictures_keep_their_pixels_and_gain_gps_and_time(photographs: Path, tmp_path: Path) -> None:
    inner = Image.Exif()
    inner[272] = "inner"
    file = encoded(visible_of(5), "JPEG", exif=inner)
    flir_jpeg(photographs / f"{NAMES[0]}.jpg", visible=image_record("<", VISIBLE_SIZE, file))
    import_folder("flir", photographs, tmp_path / "out")
    path = tmp_path / "out" / "rgb" / f"{NAMES[0]}.jpg"
    np.testing.assert_array_equal(read_rgb(path), decoded(file))
    assert path.read_bytes().count(b"Exif\0\0") == 1  # the inner one went
    exif = Image.open(path).getexif()
    assert (exif[271], exif[272], exif[306]) == ("FLIR Systems AB", "FLIR T0", "2024:05:06 07:08:09")
    tags = read_camera_tags(path)  # as the inspection report reads them
    assert (tags.camera, tags.serial, tags.lens) == ("FLIR Systems AB FLIR T0", "12345", "FOL9")
    gps = exif.get_ifd(0x8825)
    assert gps[1] == "N" and tuple(map(float, gps[2])) == GPS[2] and float(gps[6]) == GPS[6]
    assert 37386 not in exif.get_ifd(0x8769)  # the focal length in a FLIR file is the thermal lens's


def test_a_visible_png(photographs: Path, tmp_path: Path, rig: Path) -> None:
    for i, name in enumerate(NAMES):
        record = image_record("<", VISIBLE_SIZE, encoded(visible_of(i), "PNG"))
        flir_jpeg(photographs / f"{name}.jpg", counts_of(i), visible=record)
    import_folder("flir", photographs, tmp_path / "out", rig=rig)
    capture = load_capture(tmp_path / "out")
    np.testing.assert_array_equal(capture.frames[1].rgb, visible_of(1) / np.float32(255))
    assert Image.open(tmp_path / "out" / "rgb" / f"{NAMES[1]}.png").getexif().get_ifd(0x8825)[1] == "N"


def test_without_a_rig_what_is_missing_is_listed_and_filling_it_in_completes_the_capture(
    photographs: Path, tmp_path: Path
) -> None:
    result = import_folder("flir", photographs, tmp_path / "out")
    assert [m.split(" (")[0] for m in result.missing] == ["baseline_m, the distance between the two lenses in metres"]
    path = tmp_path / "out" / "rig.json"
    data = json.loads(path.read_text())
    assert data["thermal"]["fl_x"] == data["thermal"]["fl_y"] == pytest.approx(THERMAL_FOCAL_PX)
    assert load_capture(tmp_path / "out").rig.start is not None  # it is found from the capture
    path.write_text(json.dumps(data | {"rgb_from_thermal": RIG.rgb_from_thermal.matrix().tolist()}))
    capture = load_capture(tmp_path / "out")
    np.testing.assert_allclose(capture.frames[2].thermal, RADIOMETRY.celsius(counts_of(2)), atol=1e-4)
    assert capture.rgb_start is not None and capture.rgb_start.unknown == ("focal", "distortion")
    assert capture.raw_rig.rgb.fl_x == pytest.approx(RGB_FOCAL_PX)  # Real2IR's


def test_without_a_field_of_view_the_thermal_focal_length_is_missing_too(photographs: Path, tmp_path: Path) -> None:
    camera = bytearray(camera_record())
    camera[0x1B4:0x1B8] = bytes(4)
    for name in NAMES:
        flir_jpeg(photographs / f"{name}.jpg", camera=bytes(camera))
    result = import_folder("flir", photographs, tmp_path / "out")
    assert [m.split(" ")[0] for m in result.missing] == ["thermal.fl_x", "baseline_m,"]
    assert "fl_x" not in json.loads((tmp_path / "out" / "rig.json").read_text())["thermal"]


def test_emissivity_can_be_changed_in_the_capture(photographs: Path, tmp_path: Path, rig: Path) -> None:
    import_folder("flir", photographs, tmp_path / "out", rig=rig)
    before = load_capture(tmp_path / "out").frames[0].thermal
    data = json.loads((tmp_path / "out" / "rig.json").read_text())
    data["thermal"]["object"]["emissivity"] = 0.7
    (tmp_path / "out" / "rig.json").write_text(json.dumps(data))
    after = load_capture(tmp_path / "out").frames[0].thermal
    np.testing.assert_allclose(after, RADIOMETRY.reevaluated(before, emissivity=0.7), atol=1e-3)
    assert np.abs(after - before).max() > 1


def test_frames_with_other_parameters_keep_their_temperatures(photographs: Path, tmp_path: Path, rig: Path) -> None:
    other = replace(
        RADIOMETRY,
        calibration=replace(RADIOMETRY.calibration, b=1436.0, o=-3000),
        parameters=replace(RADIOMETRY.parameters, emissivity=0.75, distance_m=8.0),
    )
    flir_jpeg(photographs / f"{NAMES[1]}.jpg", counts_of(1), camera=camera_record(other))
    result = import_folder("flir", photographs, tmp_path / "out", rig=rig)
    assert any("1 of 3 frames have another calibration" in note for note in result.notes)
    frames = load_capture(tmp_path / "out").frames
    np.testing.assert_allclose(frames[1].thermal, other.celsius(counts_of(1)), atol=1e-3)
    np.testing.assert_allclose(frames[2].thermal, RADIOMETRY.celsius(counts_of(2)), atol=1e-4)
    assert Image.open(tmp_path / "out" / "thermal" / f"{NAMES[2]}.tiff").mode.startswith("I;16")


def test_a_rig_of_another_camera_is_noted(photographs: Path, tmp_path: Path) -> None:
    rig = Rig(replace(RIG.rgb, fl_x=60.0, fl_y=60.0), replace(RIG.thermal, fl_x=30.0, fl_y=30.0), RIG.rgb_from_thermal)
    write_rig(tmp_path / "rig.json", rig, CENTIKELVIN)
    notes = " ".join(import_folder("flir", photographs, tmp_path / "out", rig=tmp_path / "rig.json").notes)
    assert "thermal.fl_x is 30.0 in the rig, and the field of view in FLIR0001.jpg suggests 19.3" in notes
    assert "rgb.fl_x is 60.0 in the rig, and the fusion setting Real2IR" in notes
    assert "own conversion to °C gave way" in notes
    assert read_rig(tmp_path / "out" / "rig.json").radiometry != CENTIKELVIN


@pytest.mark.parametrize("x", [-6.0, 6.0])
def test_a_rig_that_looks_elsewhere_than_the_overlay_is_noted(photographs: Path, tmp_path: Path, x: float) -> None:
    flir_jpeg(photographs / f"{NAMES[0]}.jpg", counts_of(0), fusion=fusion_record(offset=(round(x), 0)))
    # Turned about y by φ the thermal camera looks to where x = f·tan φ; the baseline's parallax is a pixel and a half at most.
    turned = SE3(rotation_from_axis_angle([0.0, np.arctan(6.0 / RGB_FOCAL_PX), 0.0]), RIG.rgb_from_thermal.translation)
    write_rig(tmp_path / "rig.json", Rig(RIG.rgb, RIG.thermal, turned), RelativeCounts())
    notes = " ".join(import_folder("flir", photographs, tmp_path / "out", rig=tmp_path / "rig.json").notes)
    assert ("OffsetX" in notes) == (x < 0)
    if x < 0:
        assert "12 px or more" in notes and "(-6, +0) px" in notes


def test_visible_pictures_from_a_folder(photographs: Path, tmp_path: Path, rig: Path) -> None:
    (tmp_path / "visible").mkdir()
    for i, name in enumerate(NAMES):
        flir_jpeg(photographs / f"{name}.jpg", counts_of(i), visible=None)
        (tmp_path / "visible" / f"{name}.png").write_bytes(encoded(visible_of(i), "PNG"))
    out = tmp_path / "out"
    refused(out, lambda: import_folder("flir", photographs, out, rig=rig), "FLIR0001.jpg", "FLIR T0", "--rgb FOLDER")
    import_folder("flir", photographs, out, rig=rig, rgb=tmp_path / "visible")
    np.testing.assert_array_equal(load_capture(out).frames[2].rgb, visible_of(2) / np.float32(255))


def test_pictures_without_thermal_data_are_passed_over_and_listed(photographs: Path, tmp_path: Path, rig: Path) -> None:
    jpeg(photographs / "DC_0004.jpg", [])
    (photographs / "notes.txt").write_text("hello")
    result = import_folder("flir", photographs, tmp_path / "out", rig=rig)
    assert result.frames == 3 and result.notes == ("1 JPEGs without thermal data were passed over: DC_0004.jpg.",)


def test_what_is_refused_before_anything_is_written(photographs: Path, tmp_path: Path, rig: Path) -> None:
    out, last = tmp_path / "out", photographs / f"{NAMES[2]}.jpg"

    def run() -> object:
        return import_folder("flir", photographs, out, rig=rig)

    good = last.read_bytes()
    last.write_bytes(good[:1500])
    refused(out, run, "FLIR0003.jpg", "cannot be read as a JPEG")
    flir_jpeg(last, raw=raw_record(counts_of(), png=False)[:-4])
    refused(out, run, "FLIR0003.jpg", "raw thermal image is cut off")
    flir_jpeg(last, counts_of()[:10])
    refused(out, run, "FLIR0003.jpg", "thermal image is 16×10, and 16×12 in FLIR0001.jpg")
    flir_jpeg(last, visible=image_record("<", (24, 32), encoded(visible_of().transpose(1, 0, 2), "JPEG")))
    refused(out, run, "FLIR0003.jpg", "visible image is 24×32")
    flir_jpeg(last, np.zeros(THERMAL_SIZE[::-1], np.uint16))
    refused(out, run, "FLIR0003.jpg", "100.0% of its pixels")
    last.write_bytes(good)

    write_rig(rig, Rig(RIG.rgb.resized(64, 48), RIG.thermal, RIG.rgb_from_thermal), RelativeCounts())
    refused(out, run, "rig.json: rgb.width and height say 64×48", "has 32×24")
    rig.unlink()
    refused(out, run, "rig.json: no such file")
    refused(out, lambda: import_folder("flir", tmp_path / "none", out), "none: no such folder")
    (tmp_path / "empty").mkdir()
    refused(out, lambda: import_folder("flir", tmp_path / "empty", out), "none of its 0 JPEGs holds thermal data")
    flir_jpeg(photographs / f"{NAMES[2]}.jpeg")
    refused(out, lambda: import_folder("flir", photographs, out), "FLIR0003.jpg: would have the same name as FLIR0003.jpeg")


def test_an_existing_capture_is_not_touched(photographs: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(RtgsError, match="isn't an empty folder"):
        import_folder("flir", photographs, tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine.txt"]
    (tmp_path / "out" / "mine.txt").unlink()
    assert import_folder("flir", photographs, tmp_path / "out").frames == 3


@pytest.mark.parametrize("at", [4, 5, 6])
def test_an_import_that_was_stopped_can_be_repeated(photographs: Path, tmp_path: Path, at: int) -> None:
    def stop(done: int, total: int, text: str) -> None:
        if done == at:
            raise KeyboardInterrupt

    out, whole = tmp_path / "out", tmp_path / "whole"
    with pytest.raises(KeyboardInterrupt):
        import_folder("flir", photographs, out, progress=stop)
    assert not (out / "rig.json").exists()
    (out / "rgb" / f".{NAMES[2]}.jpg.1.tmp").write_bytes(b"half")  # what a killed one leaves besides
    for folder in (out, whole):
        assert import_folder("flir", photographs, folder).frames == 3
    names = [sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*")) for folder in (out, whole)]
    assert names[0] == names[1] and all((out / n).read_bytes() == (whole / n).read_bytes() for n in names[0] if "." in n)


@needs_samples
@pytest.mark.parametrize("name", ["FLIR", "FLIR_AX8", "FLIR_T640"])
def test_sample_files_become_captures(name: str, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for i in range(3):
        (tmp_path / "in" / f"{i}.jpg").write_bytes((SAMPLES / f"{name}.jpg").read_bytes())
    result = import_folder("flir", tmp_path / "in", tmp_path / "out")
    assert len(result.missing) == 1 and result.notes == ()
    path = tmp_path / "out" / "rig.json"
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"rgb_from_thermal": RIG.rgb_from_thermal.matrix().tolist()}))
    capture = load_capture(tmp_path / "out", rgb_max_side=640)
    np.testing.assert_array_equal(capture.frames[0].thermal, read_flir(SAMPLES / f"{name}.jpg").temperature_c)


# ---------------------------------------------------------------------------------------------------- DJI


def test_a_folder_of_r_jpegs(tmp_path: Path) -> None:
    """FLIR cores and converted files alike; wide pictures are taken as they are, file for file."""
    for core in (True, False):
        folder, out = tmp_path / f"in{core}", tmp_path / f"out{core}"
        for i in range(3):
            exif = camera_exif(t271="DJI", t272="ZH20T")
            thermal = folder / f"DJI_202401011200{i:02d}_000{i}_T.JPG"
            if core:
                jpeg(thermal, flir_segments(fff(records(counts_of(i), visible=None))), exif=exif)
            else:
                jpeg(thermal, [bytes(2000)], marker=0xE3, exif=exif)
                thermal.with_suffix(".tiff").write_bytes(encoded(RADIOMETRY.celsius(counts_of(i)), "TIFF"))
            wide = camera_exif()
            wide.get_ifd(0x8769)[41989] = 24
            (folder / f"DJI_202401011201{i:02d}_000{i}_W.JPG").write_bytes(encoded(visible_of(i), "JPEG", exif=wide))
            (folder / f"DJI_202401011201{i:02d}_000{i}_Z.JPG").write_bytes(encoded(visible_of(9), "JPEG"))
        result = import_folder("dji", folder, out)
        assert result.notes == (
            "3 JPEGs without thermal data were passed over: " + ", ".join(sorted(p.name for p in folder.glob("*_Z.JPG"))) + ".",
        )
        path = out / "rig.json"
        data = json.loads(path.read_text())
        focal = 0.5 * VISIBLE_SIZE[0] / np.tan(np.radians(data["rgb"]["fov_deg"]) / 2)
        assert focal == pytest.approx(24 * np.hypot(*VISIBLE_SIZE) / np.hypot(36, 24))
        assert [m.split(" ")[0] for m in result.missing] == (["baseline_m,"] if core else ["thermal.fl_x", "baseline_m,"])
        data["thermal"] |= {"fl_x": 19.0, "fl_y": 19.0}
        path.write_text(json.dumps(data | {"rgb_from_thermal": RIG.rgb_from_thermal.matrix().tolist()}))
        capture = load_capture(out)
        assert [f.name for f in capture.frames] == [f"DJI_202401011200{i:02d}_000{i}" for i in range(3)]
        for i, frame in enumerate(capture.frames):
            np.testing.assert_allclose(frame.thermal, RADIOMETRY.celsius(counts_of(i)), atol=1e-4)
            taken = (folder / f"DJI_202401011201{i:02d}_000{i}_W.JPG").read_bytes()
            assert (out / "rgb" / f"{frame.name}.jpg").read_bytes() == taken


def test_r_jpegs_that_cannot_be_read_or_paired(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    jpeg(folder / "DJI_1_0001_T.JPG", [bytes(2000)], marker=0xE3, exif=camera_exif(t271="DJI", t272="M30T"))
    refused(out, lambda: import_folder("dji", folder, out), "DJI_1_0001_T.JPG", "M30T", "Thermal SDK")
    (folder / "DJI_1_0001_T.tif").write_bytes(encoded(np.full((12, 16), 20.0, np.float32), "TIFF"))
    refused(out, lambda: import_folder("dji", folder, out), "DJI_1_0001_T.JPG", "DJI_1_0001_W.JPG", "--rgb FOLDER")
    turned = camera_exif(t274=3)
    (folder / "DJI_1_0001_W.JPG").write_bytes(encoded(visible_of(), "JPEG", exif=turned))
    refused(out, lambda: import_folder("dji", folder, out), "DJI_1_0001_W.JPG", "EXIF orientation 3")
    (tmp_path / "rgb").mkdir()
    refused(out, lambda: import_folder("dji", folder, out, rgb=tmp_path / "rgb"), "has no picture named DJI_1_0001_T")


# ---------------------------------------------------------------------------------------------------- command line


def test_the_command(photographs: Path, tmp_path: Path, rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["import", "flir", str(photographs), "--out", str(tmp_path / "a"), "--rig", str(rig)])
    said = capsys.readouterr().out
    assert f"import: 3 pairs in {tmp_path / 'a'}" in said and "fill in" not in said
    main(["import", "flir", str(photographs), "--out", str(tmp_path / "b")])
    said = capsys.readouterr().out
    assert "fill in:" in said and "  baseline_m, the distance" in said
    with pytest.raises(SystemExit) as stop:
        main(["import", "dji", str(tmp_path), "--out", str(tmp_path / "c")])
    assert stop.value.code == 2 and "holds thermal data" in capsys.readouterr().err
