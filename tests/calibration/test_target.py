"""From pictures to files: boards of both polarities, boards that are missing or cut, and a real folder."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibrate_target import BOARD, SIZES, draw_pairs, draw_truth
from rtgs.base.errors import RtgsError
from rtgs.calibration import calibrate_target
from rtgs.calibration.boards import make_board
from rtgs.calibration.checkerboard import find
from rtgs.config import BoardConfig
from rtgs.images.pictures import save_png, save_tiff
from rtgs.io.rig import read_rig
from rtgs.maths.geometry import axis_angle_from_rotation, rotation_from_axis_angle

REAL = Path(os.environ.get("RTGS_DATA", Path(__file__).parents[3] / "shared" / "data")) / "calibration_board"
needs_board = pytest.mark.skipif(
    not REAL.is_dir(), reason="the real folder calibration_board is not here (RTGS_DATA or ../shared/data)"
)


def board_picture(columns: int, rows: int, *, warm: bool, blur: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A board under a homography, `[480, 640]`, and its corners with pixel centres at integers."""
    y, x = np.mgrid[0:1920, 0:2560] / 4.0  # four samples a pixel in each direction
    picture_from_board = np.array([[52.0, -8.0, 190.0], [6.0, 47.0, 130.0], [1e-2, 2e-2, 1.0]])
    at = np.linalg.inv(picture_from_board) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    u, v = (at[:2] / at[2]).reshape(2, *x.shape)
    inside = (u > -1) & (u < columns) & (v > -1) & (v < rows)
    dark = ((np.floor(u) + np.floor(v)) % 2 == 0) & inside
    sharp = np.where(inside, np.where(dark, 20.0, 24.0), 22.0 if warm else 26.0)
    if warm:
        sharp = np.where(inside, 44.0 - sharp, sharp)
    picture = cv2.GaussianBlur(cv2.resize(sharp, (640, 480), interpolation=cv2.INTER_AREA), (0, 0), blur)
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 1, 2).astype(np.float64)
    # A sample with number 4·(i + ½) − ½ is the centre of pixel i.
    corners = cv2.perspectiveTransform(grid, picture_from_board)[:, 0] + 0.125 - 0.5
    return (picture + np.random.default_rng(0).normal(0, 0.05, picture.shape)).astype(np.float32), corners


@pytest.mark.thorough
@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_corners_of_both_polarities_are_found_to_a_fraction_of_a_pixel(warm: bool, blur: float) -> None:
    picture, truth = board_picture(6, 5, warm=warm, blur=blur)
    found = find(picture, 6, 5)
    assert not isinstance(found, str), found
    off = np.linalg.norm(found.pixels[None] - truth[:, None], axis=2).min(axis=1)
    assert np.sqrt((off**2).mean()) < 0.15


@pytest.mark.thorough
def test_a_cut_board_and_a_missing_one_have_their_reasons() -> None:
    picture, truth = board_picture(6, 5, warm=False)
    cut = find(np.ascontiguousarray(picture[:, : int(truth[4::6, 0].max() + 12)]), 6, 5)
    assert isinstance(cut, str) and "cut" in cut
    missing = find(np.random.default_rng(0).normal(20, 1, (240, 320)).astype(np.float32), 6, 5)
    assert isinstance(missing, str) and "no checkerboard" in missing


def slanted(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A drawing of a board `[h, w]` as a camera sees it, `[480, 640]`, and the homography; both with pixel centres at integers."""
    h, w = flat.shape
    corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]], np.float32)
    scale = min(560 / w, 400 / h)
    ends = 40 + scale * np.array([w, h]) * np.array([[0, 0], [1, 0.07], [0.94, 0.97], [0.04, 0.92]])
    picture_from_flat = cv2.getPerspectiveTransform(corners, ends.astype(np.float32))
    drawn = flat.astype(np.float32)
    seen = cv2.warpPerspective(drawn, picture_from_flat, (640, 480), flags=cv2.INTER_AREA, borderValue=255.0)
    return cv2.GaussianBlur(seen, (0, 0), 0.8), picture_from_flat


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("hidden", [False, True])
def test_a_charuco_board_is_found_also_where_a_part_is_hidden(inverted: bool, hidden: bool) -> None:
    config, side = BoardConfig("6x5", 0.1, "charuco", marker_m=0.07), 80
    drawn = cv2.aruco.CharucoBoard((7, 6), 0.1, 0.07, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    picture, picture_from_flat = slanted(drawn.generateImage((7 * side, 6 * side)))
    if hidden:
        picture[:, :200] = 128.0
    found = make_board(config).find(255 - picture if inverted else picture)
    assert not isinstance(found, str), found
    assert 15 <= len(found.ids) < 30 if hidden else len(found.ids) == 30
    inner = (make_board(config).points[found.ids, :2] / 0.1 + 1) * side - 0.5
    truth = cv2.perspectiveTransform(inner[:, None], picture_from_flat)[:, 0]
    assert np.linalg.norm(found.pixels - truth, axis=1).max() < 1.0
    missing = make_board(config).find(np.full((240, 320), 20, np.float32))
    assert isinstance(missing, str) and "0 corners" in missing


@pytest.mark.parametrize("inverted", [False, True])
def test_a_grid_of_circles_is_found(inverted: bool) -> None:
    board = make_board(BoardConfig("4x11", 0.05, "circles"))
    flat, places = np.full((720, 520), 255, np.uint8), board.points[:, :2] / 0.05 * 55 + 80
    for x, y in places:
        cv2.circle(flat, (round(16 * x), round(16 * y)), 16 * 20, 0, -1, cv2.LINE_AA, 4)
    picture, picture_from_flat = slanted(flat)
    found = board.find(255 - picture if inverted else picture)
    assert not isinstance(found, str), found
    truth = cv2.perspectiveTransform(places[:, None], picture_from_flat)[:, 0]
    assert np.linalg.norm(found.pixels - truth[found.ids], axis=1).max() < 1.0
    missing = board.find(np.full((240, 320), 20, np.float32))
    assert isinstance(missing, str) and "no grid of 4×11 circles" in missing


@pytest.mark.parametrize(
    ("kind", "size", "count"),
    [("checkerboard", "6x5", 2), ("checkerboard", "6x6", 4), ("circles", "4x11", 1), ("charuco", "6x5", 1)],
)
def test_orders_that_cannot_be_told_apart(kind: str, size: str, count: int) -> None:
    board = make_board(BoardConfig(size, 0.1, kind, marker_m=0.07))  # type: ignore[arg-type]
    assert len(board.orders) == count
    assert all(sorted(order) == list(range(len(board.points))) for order in board.orders)


@pytest.mark.parametrize(
    ("settings", "said"),
    [(("6", 0.1), "6x5"), (("6x2", 0.1), "from 3"), (("6x5", 0.0), "square_m"), (("6x5", 0.1, "charuco"), "marker_m")],
)
def test_settings_that_describe_no_board(settings: tuple, said: str) -> None:
    with pytest.raises(RtgsError, match=said):
        BoardConfig(*settings)


def test_a_colour_picture_in_place_of_temperatures_is_refused(tmp_path: Path) -> None:
    for which in ("rgb", "thermal"):
        (tmp_path / which).mkdir()
        cv2.imwrite(str(tmp_path / which / "a.png"), np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(RtgsError, match=r"a\.png: is a colour image"):
        calibrate_target(tmp_path, BoardConfig("6x5", 0.1), tmp_path / "out", lambda *_: None)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_not_replaced(tmp_path: Path) -> None:
    for which in ("rgb", "thermal"):
        (tmp_path / which).mkdir()
        save_tiff(tmp_path / which / "a.tiff", np.zeros((48, 64), np.uint8))
    with pytest.raises(RtgsError, match="no calibration"):
        calibrate_target(tmp_path, BoardConfig("6x5", 0.1), tmp_path, lambda *_: None)


def straight(lens: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """`[n, 2]`, where a pinhole camera with the same matrix has what this lens (`[8]`) has at `pixels`."""
    matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    enough = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    points = pixels.reshape(-1, 1, 2).astype(np.float64)
    return cv2.undistortPoints(points, matrix, lens[4:], None, None, matrix, enough)[:, 0]


def drawn_pairs(
    seed: int, n: int, distorted: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Values of both cameras and of the rig; and for n pairs the homographies from squares of the board to pixels of pinhole cameras.

    Every board is seen whole, its border included.
    """
    rng = np.random.default_rng(seed)
    rgb, thermal, rig = draw_truth(rng, distorted=distorted)
    outline = np.array([[[-1.5, -1.5]], [[9.5, -1.5]], [[9.5, 6.5]], [[-1.5, 6.5]]])
    squares = make_board(BOARD).points[:, :2] / BOARD.square_m
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    while len(pairs) < n:
        pair = draw_pairs(rng, rgb, thermal, rig, 1, noise=0.0)[0]
        seen = zip((rgb, thermal), (pair.rgb, pair.thermal), strict=True)
        both = [cv2.findHomography(squares, straight(lens, view.pixels))[0] for lens, view in seen]
        ends = [cv2.perspectiveTransform(outline, h)[:, 0] for h in both]
        if all((e > 0).all() and (e < np.array(s)).all() for e, s in zip(ends, SIZES, strict=True)):
            pairs.append((both[0], both[1]))
    return rgb, thermal, rig, pairs


def seen_by(lens: np.ndarray, pinhole_from_squares: np.ndarray, size: tuple[int, int], dark: float, bright: float) -> np.ndarray:
    """The board of 9×6 inner corners with a bright border, `[height, width]`, with a little blur and noise."""
    side = 40
    row, column = np.mgrid[0 : 9 * side, 0 : 12 * side] // side
    flat = np.where((row + column) % 2 == 1, dark, bright).astype(np.float32)
    flat[:side] = flat[-side:] = flat[:, :side] = flat[:, -side:] = bright
    # From squares to the drawing, whose dots have their centres at integers, as the pixels have.
    flat_from_squares = np.array([[side, 0, 2 * side - 0.5], [0, side, 2 * side - 0.5], [0, 0, 1]])
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    places = straight(lens, np.stack([x, y], axis=-1))
    dots = cv2.perspectiveTransform(places[:, None], flat_from_squares @ np.linalg.inv(pinhole_from_squares))
    at = dots.reshape(size[1], size[0], 2).astype(np.float32)
    seen = cv2.remap(flat, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=bright)
    noise = np.random.default_rng(0).normal(0, 0.01 * (bright - dark), seen.shape)
    return cv2.GaussianBlur(seen, (0, 0), 0.8) + noise


@pytest.mark.thorough
@pytest.mark.parametrize(("seed", "distorted"), [(3, False), (5, True)])
def test_a_folder_gives_the_rig_and_names_what_it_left_out(tmp_path: Path, seed: int, distorted: bool) -> None:
    rgb, thermal, rig_values, pairs = drawn_pairs(seed, 12, distorted)
    names = ["cut", "missing", *(f"good{i}" for i in range(10))]
    for name, both in zip(names, pairs, strict=True):
        visible = seen_by(rgb, both[0], SIZES[0], 30, 220)
        hot = np.full(SIZES[1][::-1], 30000.0) if name == "missing" else seen_by(thermal, both[1], SIZES[1], 29000, 30000)
        if name == "cut":
            visible[:, round(float(cv2.perspectiveTransform(np.array([[[7.5, 3.0]]]), both[0])[0, 0, 0])) :] = 220
        save_png(tmp_path / "rgb" / f"{name}.png", np.repeat(visible.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2))
        save_tiff(tmp_path / "thermal" / f"{name}.tiff", hot.astype(np.uint16))
    save_tiff(tmp_path / "thermal" / "alone.tiff", hot.astype(np.uint16))
    found = calibrate_target(tmp_path, BOARD, tmp_path / "out", lambda *_: None)
    rejected = {r.name: r.reason for r in found.rejected}
    assert sorted(rejected) == ["alone", "cut", "missing"]
    assert "no RGB picture" in rejected["alone"]
    assert rejected["cut"].startswith("rgb: ") and "cut" in rejected["cut"] and "thermal" not in rejected["cut"]
    assert rejected["missing"].startswith("thermal: no checkerboard")
    assert sorted(p.name for p in found.pairs) == names[2:] and found.agreement.agree
    rig = read_rig(tmp_path / "out" / "rig.json").rig
    turn = rig.rgb_from_thermal.rotation.T @ rotation_from_axis_angle(-rig_values[:3])
    assert abs(rig.rgb.fl_x / rgb[0] - 1) < 0.003 and abs(rig.thermal.fl_x / thermal[0] - 1) < 0.003
    assert np.degrees(np.linalg.norm(axis_angle_from_rotation(turn))) < 0.05
    assert abs(rig.baseline_m / np.linalg.norm(rig_values[3:]) - 1) < 0.005
    assert abs(rig.thermal.k1 - thermal[4]) < 0.01


@needs_board
@pytest.mark.thorough
def test_a_real_pair_of_cameras_that_is_not_rigid(tmp_path: Path) -> None:
    found = calibrate_target(REAL, BoardConfig("6x5", 0.1), tmp_path / "out", lambda *_: None)
    assert len(found.pairs) >= 45
    thermal = {v.name: v.value for v in found.thermal.values}
    assert abs(thermal["fl_x"] / 657 - 1) < 0.01 and abs(thermal["k1"] + 0.37) < 0.03
    assert not found.agreement.agree and 2 < found.agreement.disagreement_px < 10 and "do not agree" in found.agreement.sentence
    rig = read_rig(tmp_path / "out" / "rig.json").rig
    assert rig.calibration_std is not None and rig.calibration_std.baseline_length > 0.1
    assert json.loads((tmp_path / "out" / "calibration.json").read_text())["agreement"]["agree"] is False
    assert (tmp_path / "out" / "residuals_thermal.png").is_file() and len(
        list((tmp_path / "out" / "corners").glob("*.png"))
    ) >= 45
