"""The viewer in a real browser: what a person does, and what the page then shows."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from tests.helpers.chromium import Chromium, chromium, needs_chromium, wait_for
from tests.helpers.viewed_wall import CI95, NAMES, STD_C, TRUTH, truth_c
from tests.helpers.viewer_visit import Visit
from tests.helpers.wall_scene import PLANE_M

from rtgs.base.json_records import write_json
from rtgs.maths import sh
from rtgs.records.gaussians import Gaussians
from rtgs.records.spots import Spot, SpotList
from rtgs.run.folder import RunFolder
from rtgs.viewer.picture import ISOTHERM
from rtgs.viewer.start import Viewer

pytestmark = [needs_chromium, pytest.mark.thorough]

SPOT_M = (0.2, 0.1, PLANE_M)

CLIP_BOX = "[...document.querySelectorAll('div')].filter(e => e.innerText.trim() === 'Clip box' && e.offsetParent).pop()"


def slider_of(label: str) -> str:
    """The track of the slider with two ends that belongs to a label."""
    return (
        f"(() => {{ let e = [...document.querySelectorAll('label')].find(e => e.innerText.trim() === {label!r} && e.offsetParent);"
        " while (e && !e.querySelector('.multi-slider')) e = e.parentElement; return e && e.querySelector('.multi-slider'); })()"
    )


@pytest.fixture(scope="module")
def browser() -> Iterator[Chromium]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def viewer(wall_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewer]:
    spots = tmp_path_factory.mktemp("spots") / "spots.json"
    spot = Spot("hot", SPOT_M, 1e-3, 31.0, 29.0, 25.0, 0.1, 5, 5, NAMES[:2], 30.5, 0.2)
    write_json(spots, SpotList((spot,), "°C", "made up"))
    found = Viewer(wall_run, port=0, spots=spots)
    yield found
    found.stop()


@pytest.fixture(scope="module")
def visit(browser: Chromium, viewer: Viewer) -> Visit:
    return Visit(browser, viewer)


def numbers(text: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?\d+\.?\d*", text)]


def test_the_page_shows_the_model_at_once(visit: Visit) -> None:
    wait_for(lambda: visit.picture().std() > 3, "the picture is not blank")


def test_modalities_are_switched(visit: Visit) -> None:
    rgb = visit.picture().astype(float)
    visit.tab.choose("Show", "Temperature")
    wait_for(lambda: np.abs(visit.picture().astype(float) - rgb).mean() > 20, "the picture changes")
    legend = wait_for(lambda: visit.tab.html_of(".rtgs-legend"), "there is a legend")
    assert "°C" in legend and {20.0, 30.0} <= set(numbers(legend))
    visit.tab.choose("Unit", "°F")
    wait_for(lambda: "°F" in visit.tab.html_of(".rtgs-legend"), "the legend is in °F")
    assert min(numbers(visit.tab.html_of(".rtgs-legend"))) >= 68
    visit.tab.choose("Unit", "°C")
    wait_for(lambda: "°C" in visit.tab.html_of(".rtgs-legend"), "the legend is in °C")


def test_an_isotherm_paints_its_band(visit: Visit) -> None:
    visit.look_from((0.0, 0.0, 0.0))

    def green() -> float:
        return float((np.abs(visit.picture().astype(int) - ISOTHERM).max(axis=2) < 40).mean())

    assert green() < 0.01
    visit.tab.tick("Isotherm")
    visit.tab.fill("From", "25")
    visit.tab.fill("To", "60")
    wait_for(lambda: 0.25 < green() < 0.75, "half of the picture is green")  # the wall is 25 °C in the middle
    visit.tab.tick("Isotherm")
    wait_for(lambda: green() < 0.01, "the band has gone")


def test_a_click_reads_temperature_and_place(visit: Visit) -> None:
    visit.look_from((0.1, 0.05, 0.1))
    visit.tab.open_tab("Measure")
    place = (0.15, 0.08, PLANE_M)
    visit.click_at(place)
    text = visit.tab.html_of(".rtgs-reading")
    rows = dict(line.split("\t", 1) for line in text.splitlines() if "\t" in line)
    celsius, std = numbers(rows["Model"])[:2]
    truth = float(truth_c(np.array(place)))
    assert celsius == pytest.approx(truth, abs=0.3) and std == pytest.approx(STD_C, rel=0.1)
    assert numbers(rows["Photographs"])[0] == pytest.approx(truth, abs=0.3)
    np.testing.assert_allclose(numbers(rows["Position"])[:3], place, atol=0.01 * PLANE_M)
    assert numbers(rows["Depth"])[0] == pytest.approx(PLANE_M - 0.1, rel=0.01)
    assert numbers(rows["Seen by"])[0] >= 2


def test_a_known_length_is_measured(visit: Visit) -> None:
    visit.tab.choose("Tool", "distance")
    visit.click_at((-0.1, -0.05, PLANE_M))
    visit.click_at((0.2, 0.1, PLANE_M))
    text = wait_for(lambda: visit.tab.html_of(".rtgs-measured"), "there is a length")
    value, _, low, high = numbers(text.replace("\t", " "))[:4]
    truth = float(np.hypot(0.3, 0.15))
    assert value == pytest.approx(truth, rel=0.01)
    assert low == pytest.approx(value * TRUTH / CI95[1], rel=0.005) and high == pytest.approx(value * TRUTH / CI95[0], rel=0.005)
    visit.tab.press_button("Remove all points")
    wait_for(lambda: not visit.tab.html_of(".rtgs-measured") or "more points" in visit.tab.text(), "the points have gone")


def test_a_jump_leads_to_a_spot(visit: Visit) -> None:
    visit.tab.open_tab("Spots")
    assert "31.0 °C" in visit.tab.html_of(".rtgs-spots")
    visit.tab.press_button("Jump to the spot")

    def ahead() -> bool:
        eye = visit.session.eye()
        place = eye.world_from_camera.inverse().apply(visit.session.contents.world(np.array(SPOT_M)))
        return bool(np.hypot(place[0], place[1]) < 0.02 * place[2])

    wait_for(ahead, "the camera looks at the spot")


def test_a_photograph_is_jumped_to_and_swiped(visit: Visit) -> None:
    visit.tab.open_tab("Photos")
    visit.tab.choose("Frame", NAMES[3])
    visit.tab.press_button("Jump to its camera")
    scene = visit.session.contents.scene
    assert scene is not None
    target = scene.world_from_thermal(NAMES[3], TRUTH).translation
    wait_for(lambda: np.allclose(visit.session.eye().world_from_camera.translation, target, atol=1e-3), "the camera is there")
    visit.tab.press_button("Compare with the model")
    wait_for(lambda: f"{NAMES[3]}, thermal" in visit.tab.text(), "the photograph is shown")
    visit.at_rest()
    line = (visit.picture() > 235).all(axis=2).mean(axis=0)
    wait_for(
        lambda: (visit.picture() > 235).all(axis=2).mean(axis=0).max() > 0.5, f"there is a line between both; {line.max():.2f}"
    )


def test_edges_part_at_a_wrong_scale(visit: Visit) -> None:
    visit.tab.open_tab("Scale")
    visit.tab.press_button("Show the edges")
    pattern = re.compile(r"(\d+) % of the thermal edges")
    wait_for(lambda: pattern.search(visit.tab.text()), "the edges are shown")
    visit.at_rest()
    before = visit.picture().astype(float)
    thumb = visit.tab.place_of("[...document.querySelectorAll('[role=slider]')].find(e => e.offsetParent)")
    assert thumb is not None
    x, y = thumb[0] + thumb[2] / 2, thumb[1] + thumb[3] / 2
    visit.tab.drag((x, y), (x + 60, y))
    wait_for(lambda: "outside of the interval" in visit.tab.html_of(".rtgs-tried"), "another scale is tried")
    wait_for(lambda: np.abs(visit.picture().astype(float) - before).mean() > 1, "the picture follows")
    tried = numbers(visit.tab.html_of(".rtgs-tried"))[0]
    assert 1.2 * TRUTH < tried <= 2.01 * TRUTH
    visit.tab.press_button("Back to the estimate")
    wait_for(lambda: "inside the interval" in visit.tab.html_of(".rtgs-tried"), "the estimate is shown")


def test_a_picture_is_saved(visit: Visit, browser: Chromium) -> None:
    visit.tab.choose("Show", "Temperature")
    visit.tab.open_tab("Save")
    visit.tab.press_button("Save the picture")
    file = browser.folder / "run-temperature.png"
    wait_for(file.exists, "the file is there")
    picture = cv2.imread(str(file))
    assert picture is not None
    eye = visit.session.eye().camera
    assert picture.shape[0] == eye.height and picture.shape[1] > eye.width  # with the colour bar
    assert picture[:, : eye.width].std() > 10


def test_cameras_stand_in_the_picture_with_their_photographs(visit: Visit) -> None:
    visit.tab.choose("Show", "Temperature")  # which is unlike the photographs
    visit.look_from((0.0, 0.0, -0.8))
    bare = visit.model().astype(float)
    visit.tab.open_tab("Photos")

    def differs(from_this: np.ndarray) -> float:
        return float((np.abs(visit.picture().astype(float) - from_this).max(axis=2) > 30).mean())

    def blue() -> float:  # of the lines of the RGB cameras
        red, _, blue = np.moveaxis(visit.picture().astype(int), 2, 0)
        return float((blue - red > 60).mean())

    without = blue()
    visit.tab.tick("Photographs")
    visit.tab.tick("RGB")
    wait_for(lambda: blue() > without + 5e-3, "the cameras are there")
    lines = differs(bare)
    assert lines < 0.2
    visit.tab.tick("Photographs")
    wait_for(lambda: differs(bare) > 2 * lines, "the cameras hold their photographs")
    visit.tab.tick("RGB")
    wait_for(lambda: differs(bare) < 1e-3, "the cameras have gone")


def test_a_clip_box_hides_what_is_outside(visit: Visit) -> None:
    visit.look_from((0.0, 0.0, 0.0))
    visit.tab.open_tab("View")
    visit.tab.press(CLIP_BOX, "the folder of the clip box")
    whole = visit.model().astype(float)

    def changed() -> np.ndarray:
        """Of the columns of the picture, which have changed."""
        share: np.ndarray = (np.abs(visit.picture().astype(float) - whole).max(axis=2) > 20).mean(axis=0)
        return share > 0.5

    visit.tab.tick("Clip")
    wait_for(lambda: visit.session.wish.clip, "the box clips")
    visit.model()
    assert changed().mean() < 0.01  # the widest box cuts nothing
    slider = visit.tab.place_of(slider_of("x, %"))
    assert slider is not None
    left, top, width, height = slider
    visit.tab.drag((left + 1, top + height / 2), (left + width / 2, top + height / 2))
    wait_for(lambda: 0.3 < changed().mean() < 0.7, "half of the wall is hidden")
    columns = np.flatnonzero(changed())
    assert columns[-1] - columns[0] < 1.1 * len(columns)  # one side of it
    visit.tab.tick("Clip")
    wait_for(lambda: changed().mean() < 0.01, "the wall is whole again")


def test_a_turntable_is_filmed(visit: Visit, browser: Chromium) -> None:
    visit.tab.choose("Show", "RGB")
    visit.look_from((0.0, 0.0, 0.0))
    visit.tab.open_tab("Save")
    visit.tab.fill("Seconds", "1")
    visit.tab.press_button("Save a turntable")
    file = browser.folder / "run-turntable.mp4"
    wait_for(file.exists, "the film is there")
    film = cv2.VideoCapture(str(file))
    pictures = [picture for found, picture in (film.read() for _ in range(100)) if found]
    assert len(pictures) == 24
    assert pictures[0].std() > 3  # of the wall
    assert np.abs(pictures[6].astype(float) - pictures[0]).mean() > 3  # it turns


def test_nothing_is_asked_of_others_and_the_console_is_silent(visit: Visit, viewer: Viewer) -> None:
    """After all that the tests above have done with the page."""
    assert visit.tab.errors == []
    asked = [url for url in visit.tab.requests if not url.startswith(("data:", "blob:", viewer.url))]
    assert asked == []
    assert "share" not in visit.tab.text().lower()
    viewer.server._thread_executor.submit(viewer.server.request_share_url).result()
    assert viewer.server._share_tunnel is None


def test_three_at_once_and_one_goes(browser: Chromium, viewer: Viewer, visit: Visit) -> None:
    others = [Visit(browser, viewer) for _ in range(2)]
    assert len(viewer.hub.sessions) == 3
    others[0].tab.open_tab("Spots")
    with viewer.hub.engine.holding:  # the search has begun and cannot go on
        others[0].tab.press_button("Find spots")
        wait_for(
            lambda: others[0].tab.js("[...document.querySelectorAll('button')].some(b => b.disabled && b.offsetParent)"),
            "it has begun",
        )
        others[0].tab.call("Page.close")
        wait_for(lambda: len(viewer.hub.sessions) == 2, "the one has gone")
    for stays in (visit, others[1]):
        stays.tab.choose("Show", "RGB")
        wait_for(lambda stays=stays: stays.session.wish.mode == "RGB", "RGB is chosen")  # type: ignore[misc]
        stays.at_rest()
        assert stays.session.wish.mode == "RGB" and stays.picture().std() > 3


def test_a_run_that_goes_on(browser: Chromium, run: Path, tmp_path: Path) -> None:
    """A page follows: first there is only the RGB model, then a damaged thermal model, then a whole one."""
    kept = tmp_path / "kept"
    kept.mkdir()
    for name in ("thermal.json", "thermal.ply"):
        shutil.move(run / name, kept / name)
    viewer = Viewer(run, port=0)
    try:
        visit = Visit(browser, viewer)
        assert "There is no thermal model yet" in visit.tab.text()
        (run / "thermal.json").write_bytes((kept / "thermal.json").read_bytes())
        (run / "thermal.ply").write_bytes((kept / "thermal.ply").read_bytes()[:500])
        wait_for(lambda: "thermal.ply" in visit.tab.text(), "the damage is said")
        (run / "thermal.ply").write_bytes((kept / "thermal.ply").read_bytes())
        wait_for(lambda: "thermal.ply" not in visit.tab.text() and viewer.hub.engine.contents.thermal, "the model is there")
        visit.tab.choose("Show", "Temperature")
        wait_for(lambda: visit.tab.html_of(".rtgs-legend"), "temperatures are shown")
        assert visit.tab.errors == []
    finally:
        viewer.stop()


def test_a_training_that_goes_on_is_followed(browser: Chromium, run: Path) -> None:
    """Without a model at first; then with what the training has so far, and with what it has later."""
    wall = RunFolder(run).read_rgb().gaussians
    for name in ("rgb.json", "rgb.ply", "thermal.json", "thermal.ply"):
        (run / name).unlink()
    viewer = Viewer(run, port=0)
    try:
        visit = Visit(browser, viewer)
        assert "There is no RGB model yet" in visit.tab.text()
        write_snapshot(run, wall, 0.05)
        wait_for(lambda: "this is how far it has come" in visit.tab.text(), "a snapshot is shown")
        wait_for(lambda: visit.session.settled and visit.picture().mean() < 60, "it is dark")
        write_snapshot(run, wall, 0.9)
        wait_for(lambda: visit.session.settled and visit.picture().mean() > 150, "it has become bright")
        assert visit.tab.errors == []
    finally:
        viewer.stop()


def write_snapshot(run: Path, wall: Gaussians, brightness: float) -> None:
    """The state of a training whose model is a wall of one gray."""
    gray = replace(wall, sh=torch.full_like(wall.sh, (brightness - 0.5) / sh.C0))
    state = {"gaussians": {"parameters": gray.tensors()}, "frames": {"parameters": {"background": torch.zeros(3)}}}
    torch.save(state, run / "snapshot")
    (run / "snapshot").replace(RunFolder(run).checkpoint)
