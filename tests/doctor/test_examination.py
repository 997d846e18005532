"""The doctor: nothing to say of a capture that is right, and the right thing of each that has one fault."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from tests.helpers import broken_captures as made
from tests.helpers.captures import ARCO, edit_rig, needs_arco

from rtgs.cli import main
from rtgs.doctor import examine
from rtgs.io.capture import load_capture
from rtgs.maths.geometry import rotation_from_axis_angle

Fault = Callable[[Path], object]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made.write_good(tmp_path_factory.mktemp("doctor") / "good")


def copied(good: Path, root: Path) -> Path:
    return Path(shutil.copytree(good, root / "capture"))


def each_rgb(change: Callable[[made.Array, int], made.Array], frames: range = range(made.FRAMES), **tags: int) -> Fault:
    def fault(root: Path) -> None:
        for i in frames:
            path = root / "rgb" / f"{i:03d}.jpg"
            made.write_rgb(path, change(made.read(path) / 255, i), time_s=4 * i, **tags)

    return fault


def each_thermal(change: Callable[[made.Array, int], made.Array]) -> Fault:
    def fault(root: Path) -> None:
        for i in range(made.FRAMES):
            path = root / "thermal" / f"{i:03d}.tiff"
            made.write_counts(path, change(made.read(path), i))

    return fault


def blurred(picture: made.Array, i: int) -> made.Array:
    return cv2.GaussianBlur(picture, (0, 0), 4.0).astype(np.float64)


def without_partner(root: Path) -> None:
    (root / "thermal" / "005.tiff").unlink()


def other_size(root: Path) -> None:
    made.write_counts(root / "thermal" / "005.tiff", np.full((100, 160), 11000.0) + np.arange(160))


def pause(root: Path) -> None:
    for i in range(7, made.FRAMES):
        path = root / "rgb" / f"{i:03d}.jpg"
        made.write_rgb(path, made.read(path) / 255, time_s=4 * i + 1800)


def frozen(root: Path) -> None:
    shutil.copy(root / "thermal" / "004.tiff", root / "thermal" / "005.tiff")


def nearly_frozen(root: Path) -> None:
    counts = made.read(root / "thermal" / "004.tiff") + np.random.default_rng(0).integers(-2, 3, (120, 160))
    made.write_counts(root / "thermal" / "005.tiff", counts)


def stretched(root: Path) -> None:
    for path in (root / "thermal").iterdir():
        counts = made.read(path)
        grey = (255 * (counts - counts.min()) / np.ptp(counts)).astype(np.uint8)
        cv2.imwrite(str(path), grey)


def half_empty(root: Path) -> None:
    for i in range(made.FRAMES):
        path = root / "thermal" / f"{i:03d}.tiff"
        counts = made.read(path).astype(np.float32)
        counts[:70] = -9999
        Image.fromarray(counts).save(path)


def looks_away(root: Path) -> None:
    turned = np.eye(4)
    turned[:3, :3] = rotation_from_axis_angle([0.0, np.pi / 2, 0.0])
    turned[0, 3] = made.BASELINE_M
    edit_rig(root, lambda rig: rig.update(rgb_from_thermal=turned.tolist()))


def other_way(poses: Callable[[int], made.SE3]) -> Fault:
    def fault(root: Path) -> None:
        shutil.rmtree(root)
        made.write_good(root, poses=poses)

    return fault


FAULTS: dict[str, tuple[Fault, str, str, str]] = {
    "no partner": (without_partner, "unusable", "loading", "no partner"),
    "size": (other_size, "unusable", "loading", "005.tiff"),
    "pause": (pause, "doubtful", "times", "pauses"),
    "orientation": (each_rgb(lambda x, i: x, range(4, 6), orientation=3), "doubtful", "orientation", "004"),
    "soft": (each_rgb(blurred), "doubtful", "sharpness", "soft"),
    "one soft": (each_rgb(blurred, range(5, 6)), "doubtful", "sharpness", "005"),
    "overexposed": (each_rgb(lambda x, i: 2.6 * x), "doubtful", "exposure", "overexposed"),
    "dark": (each_rgb(lambda x, i: 0.03 * x), "unusable", "exposure", "too dark"),
    "changing": (each_rgb(lambda x, i: x * (0.4 if i % 2 else 1.1)), "doubtful", "exposure", "changes"),
    "no contrast": (
        each_thermal(lambda x, i: 11800 + 4 * np.random.default_rng(i).normal(size=x.shape)),
        "doubtful",
        "thermal contrast",
        "little to see",
    ),
    "saturated": (each_thermal(lambda x, i: np.minimum(x, 12000)), "doubtful", "saturation", "end of the range"),
    "no data": (half_empty, "unusable", "loading", "no"),
    "frozen": (frozen, "unusable", "loading", "stood still"),
    "shutter": (nearly_frozen, "doubtful", "shutter", "005"),
    "jump": (each_thermal(lambda x, i: x + (600 if i >= 8 else 0)), "doubtful", "shutter", "jumps at 008"),
    "palette": (stretched, "doubtful", "palette", "stretched"),
    "looks away": (looks_away, "unusable", "calibration", "0 %"),
    "turns": (other_way(made.turn), "doubtful", "parallax", "turns"),
    "no overlap": (other_way(made.far_apart), "unusable", "overlap", "no two RGB"),
}


def test_nothing_is_wrong_with_a_capture_that_is_right(good: Path) -> None:
    diagnosis = examine(good)
    assert diagnosis.verdict == "good", diagnosis.findings


def test_the_flow_of_the_baseline_is_seen_before_any_model(good: Path) -> None:
    said = next(f.text for f in examine(good).findings if f.check == "flow" and "most of what is seen" in f.text)
    flow = float(said.split("about ")[1].split(" px")[0])
    assert abs(flow - made.FLOW_PX) <= 1.5


@pytest.mark.thorough
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_named(good: Path, tmp_path: Path, fault: str) -> None:
    root = copied(good, tmp_path)
    break_it, verdict, check, said = FAULTS[fault]
    break_it(root)
    diagnosis = examine(root)
    loud = [f for f in diagnosis.findings if f.level != "note"]
    assert diagnosis.verdict == verdict, diagnosis.findings
    assert any(f.check == check and said in f.text and f.remedy for f in loud), loud


def test_a_loaded_capture_is_not_loaded_again_and_its_warnings_are_not_repeated(good: Path, tmp_path: Path) -> None:
    root = copied(good, tmp_path)
    edit_rig(root, lambda rig: rig.update(colour="red"))
    assert [f.check for f in examine(root).of("warning")] == ["loading"]
    assert examine(load_capture(root)).of("warning") == ()


@pytest.mark.parametrize(("break_it", "code"), [(None, 0), (pause, 3), (without_partner, 2)])
def test_the_command_says_it_by_its_exit_code_and_as_json(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], break_it: Fault | None, code: int
) -> None:
    root = copied(good, tmp_path)
    if break_it is not None:
        break_it(root)
    try:
        main(["doctor", str(root), "--json"])
        found = 0
    except SystemExit as stop:
        found = int(stop.code or 0)
    assert found == code
    said = json.loads(capsys.readouterr().out)
    assert said["verdict"] == {0: "good", 3: "doubtful", 2: "unusable"}[code] and said["findings"]


@needs_arco
@pytest.mark.thorough
def test_arco_can_be_used_and_the_jump_of_its_thermal_camera_is_seen() -> None:
    """At 11-13-16-681 the level of the thermal images falls by 5.5 °C."""
    diagnosis = examine(ARCO)
    assert diagnosis.verdict == "doubtful" and not diagnosis.of("error")
    assert [f.check for f in diagnosis.of("warning")] == ["shutter"]
    assert "11-13-16-681" in diagnosis.of("warning")[0].text
