"""The report of a fabricated run: everything said, nothing fetched, missing parts named."""

from __future__ import annotations

import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.images import pictures
from rtgs.run.report import MOST_FRAMES, MOST_OVERLAYS, write_report

HELD_OUT = [f"frame_{i:04d}" for i in range(0, 72, 8)]
SFM_PER_METRE = 2.4312


def scene(shift_px: float = 0.0, height: int = 192, width: int = 240) -> np.ndarray:
    """A gray picture `[H, W]` in [0, 1] with a box and a disc."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    image = 0.35 + 0.1 * np.sin(x / 60) + 0.05 * np.cos(y / 25)
    image[(np.abs(x - 75 - shift_px) < 30) & (np.abs(y - 105) < 45)] = 0.8
    image[np.hypot(x - 165 - shift_px, y - 83) < 34] = 0.12
    return image


def json_files() -> dict[str, dict[str, Any]]:
    s = np.geomspace(0.3, 20.0, 40)
    curve = 0.93 - 0.2 * np.exp(-((np.log(s / SFM_PER_METRE) / 0.25) ** 2))
    rng = np.random.default_rng(0)
    per_frame = {n: (curve + 0.02 * rng.standard_normal(40)).tolist() for n in HELD_OUT}
    step = np.arange(60)
    path = SFM_PER_METRE * np.exp(0.5 * np.exp(-step / 12) * np.cos(step / 6))
    frame = {"psnr": 31.2, "ssim": 0.93, "mae_c": 0.61}
    return {
        "config": {
            "version": "0.1.0",
            "capture": "captures/<Boiler & pipes>",
            "settings": {"sfm": {"matcher": "exhaustive"}, "rgb": {"steps": 7000, "max_gaussians": 60000}, "seed": None},
        },
        "capture_summary": {
            "frames": 72,
            "registered": 70,
            "failures": {"frame_0013": "too few matches", "frame_0014": "blurred <motion>"},
            "warnings": ["rig.json and the poses disagree by 1.4 % about fl_x; the poses' is used"],
            "thermal_unit": "celsius",
            "rgb_size": [960, 540],
            "thermal_size": [640, 512],
            "baseline_m": 0.2,
        },
        "scale": {
            "sfm_per_metre": SFM_PER_METRE,
            "metres_per_sfm": 1 / SFM_PER_METRE,
            "std_log": 0.0061,
            "ci95": [2.402, 2.461],
            "status": "ok",
            "reason": "",
            "solver": "gauss_newton",
            "init": 1.0,
            "bracket": [0.3, 20.0],
            "baseline_m": 0.2,
            "frames": HELD_OUT,
            "scan": {
                "sfm_per_metre": s.tolist(),
                "loss": curve.tolist(),
                "std_error": (0.004 + 0 * s).tolist(),
                "per_frame": per_frame,
            },
            "history": {"step": step.tolist(), "sfm_per_metre": path.tolist(), "loss": (0.9 - 0.003 * step).tolist()},
        },
        "metrics": {
            "rgb": {"psnr": 27.312, "ssim": 0.881, "per_frame": {n: {"psnr": 27.3, "ssim": 0.88} for n in HELD_OUT}},
            "thermal": {"psnr": 31.84, "ssim": 0.941, "mae_c": 0.58, "per_frame": dict.fromkeys(HELD_OUT, frame)},
            "thermal_naive": {"psnr": 29.44, "ssim": 0.922, "mae_c": 0.97, "per_frame": dict.fromkeys(HELD_OUT, frame)},
            "timings_s": {"sfm": 64.0, "rgb": 812.4, "scale": 41.2, "thermal": 18.8, "thermal_naive": 18.1, "evaluate": 9.3},
            "temperature_range_c": [18.0, 41.5],
        },
    }


def fabricate(run: Path, *, renders: bool = True) -> Path:
    run.mkdir()
    for name, content in json_files().items():
        (run / f"{name}.json").write_text(json.dumps(content))
    if not renders:
        return run
    rng = np.random.default_rng(1)
    for i, name in enumerate(HELD_OUT):
        thermal = 20 + 20 * (1 - scene(i)) + 0.1 * rng.standard_normal(scene().shape)
        render, naive = 20 + 20 * (1 - scene(i + 0.5)), 20 + 20 * (1 - scene(i + 6))
        rgb = np.stack([scene(i), scene(i) ** 1.2, scene(i) ** 0.8], axis=2)
        folder = run / "renders"
        pictures.save_png(folder / "overlay" / f"{name}.before.png", pictures.edge_overlay(scene(i + 7), thermal))
        pictures.save_png(folder / "overlay" / f"{name}.after.png", pictures.edge_overlay(scene(i), thermal))
        pictures.save_png(folder / "rgb" / f"{name}.reference.png", pictures.to_picture(rgb))
        pictures.save_png(folder / "rgb" / f"{name}.render.png", pictures.to_picture(rgb**1.05))
        pictures.save_png(folder / "rgb" / f"{name}.error.png", pictures.error_map(rgb**1.05, rgb, 0.1))
        pictures.save_png(folder / "thermal" / f"{name}.reference.png", pictures.palette(thermal, 18, 41.5))
        for model, temperature in (("thermal", render), ("thermal_naive", naive)):
            pictures.save_png(folder / model / f"{name}.render.png", pictures.palette(temperature, 18, 41.5))
            pictures.save_png(folder / model / f"{name}.error.png", pictures.error_map(temperature, thermal, 3.0, "°C"))
    return run


class Page(HTMLParser):
    """Text, headings, links and balance of a page."""

    VOID = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.images: list[str] = []
        self.words: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.feed(source)
        assert not self.open, f"unclosed: {self.open}"
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(values["src"] or "")
        if values.get("id"):
            self.ids.append(values["id"] or "")
        self.links += [v for k, v in attrs if v and k in ("src", "href", "xlink:href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.words.append(data)
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


def page_of(run: Path) -> Page:
    path = write_report(run)
    assert path == run / "report.html"
    return Page(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return page_of(fabricate(tmp_path_factory.mktemp("report") / "run"))


def test_verdict_says_what_matters_in_words(whole: Page) -> None:
    for words in ("2.431 SfM units", "2.402 to 2.461", "baseline of 20 cm", "Scale found", "31.8 dB", "2.4 dB better", "0.58 °C"):
        assert words in whole.text, words
    assert "Do not rely" not in whole.text


def test_sections_stand_in_order(whole: Page) -> None:
    assert whole.headings == [
        *("What was run", "Scale", "Do the edges meet?", "Held-out RGB views", "Held-out thermal views", "Metrics", "Time taken"),
        "Warnings",
    ]
    assert "rgb.max_gaussians" in whole.text and "60000" in whole.text
    assert "chosen: 2.431" in whole.text and "95 % interval" in whole.text  # the curve's legend is text
    assert "frame_0014" in whole.text and "blurred <motion>" in whole.text  # escaped: it came back as text, not as a tag
    assert "+2.40" in whole.text and "−0.39" in whole.text  # what the scale brought: dB, °C
    assert "16 min 04 s" in whole.text


def test_nothing_is_fetched(whole: Page) -> None:
    assert whole.images
    assert all(link.startswith(("data:image/", "#")) for link in whole.links), whole.links
    assert len(whole.ids) == len(set(whole.ids))  # two curves on one page must not share clip paths


def test_frames_are_few_and_evenly_chosen(whole: Page) -> None:
    # Before and after; three RGB and five thermal pictures a frame.
    assert len(whole.images) == MOST_OVERLAYS * 2 + MOST_FRAMES * (3 + 5)
    assert HELD_OUT[0] in whole.text and HELD_OUT[-1] in whole.text
    assert HELD_OUT[1] not in whole.text


@pytest.mark.parametrize("status", ["ambiguous", "unobservable"])
def test_a_scale_in_doubt_is_said_first(tmp_path: Path, status: str) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    scale = json_files()["scale"] | {"status": status, "reason": "flow is under half a pixel", "ci95": None, "std_log": None}
    (run / "scale.json").write_text(json.dumps(scale))
    page = page_of(run)
    assert "Do not rely on this number: flow is under half a pixel." in page.text and "Scale found" not in page.text


@pytest.mark.parametrize("name", ["config", "capture_summary", "scale", "metrics"])
def test_a_missing_part_is_named_with_its_command(tmp_path: Path, name: str) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    (run / f"{name}.json").unlink()
    page = page_of(run)
    assert f"no {name}.json yet" in page.text and "To make it: rtgs run" in page.text
    assert not page.images


def test_an_empty_run_has_a_report(tmp_path: Path) -> None:
    page = page_of(tmp_path)
    assert "no scale so far" in page.text
    assert page.text.count("To make it:") >= 5
    assert "nan" not in page.text.lower().split() and "None" not in page.text


def test_relative_thermal_counts_are_not_called_degrees(tmp_path: Path) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    files = json_files()
    (run / "capture_summary.json").write_text(json.dumps(files["capture_summary"] | {"thermal_unit": "relative"}))
    files["metrics"]["thermal"]["mae_c"] = files["metrics"]["thermal_naive"]["mae_c"] = None
    (run / "metrics.json").write_text(json.dumps(files["metrics"]))
    page = page_of(run)
    assert "no radiometric calibration" in page.text and "°C" not in page.text


def test_a_loss_is_not_sold_as_a_gain(tmp_path: Path) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    metrics = json_files()["metrics"]
    metrics["thermal"]["psnr"] = 28.44
    (run / "metrics.json").write_text(json.dumps(metrics))
    assert "1.0 dB worse" in page_of(run).text


def test_why_a_score_is_missing(tmp_path: Path) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    assert "LPIPS (AlexNet)" not in page_of(run).text
    metrics = json_files()["metrics"] | {"notes": ["LPIPS: no <weights>."]}
    (run / "metrics.json").write_text(json.dumps(metrics))
    text = page_of(run).text
    assert "LPIPS: no <weights>. Then rtgs eval" in text
    metrics["thermal"]["lpips"] = 0.3456
    (run / "metrics.json").write_text(json.dumps(metrics))
    assert "0.346" in page_of(run).text and "LPIPS (AlexNet)" in page_of(run).text


def test_what_cannot_be_read_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="no such run folder"):
        write_report(tmp_path / "absent")
    run = fabricate(tmp_path / "run", renders=False)
    (run / "scale.json").write_text('{"sfm_per_metre": 2.')
    with pytest.raises(RtgsError, match=r"scale\.json"):
        write_report(run)
    (run / "scale.json").write_text("[1, 2]")
    with pytest.raises(RtgsError, match=r"scale\.json: a JSON object"):
        write_report(run)
    assert not (run / "report.html").exists()


def test_a_search_shows_its_minima_its_frames_and_the_curve_beside_the_answer(tmp_path: Path) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    s = [SFM_PER_METRE * f for f in (0.98, 0.99, 1.0, 1.01, 1.02)]
    curves = {n: [0.9 + k * 0.01, 0.88, 0.87, 0.88, 0.9] for k, n in enumerate(HELD_OUT)}
    local = {"sfm_per_metre": s, "loss": [0.9, 0.88, 0.87, 0.88, 0.9], "std_error": [0.0] * 5, "per_frame": curves}
    minima = [{"sfm_per_metre": 7.125, "loss_above": 0.01, "chance": 0.12}]
    scale = json_files()["scale"] | {
        "solver": "global",
        "minima": minima,
        "disagreeing": ["frame_<9>"],
        "local": local,
        "blur_px": 2.8,
    }
    (run / "scale.json").write_text(json.dumps(scale))
    text = write_report(run).read_text()
    assert "other minimum: 7.125" in text and "7.125 (better in 12 % of resamples)" in text
    assert "frame_&lt;9&gt;" in text and "single frames" in text
    assert "Blur of the thermal lens" in text and "2.8 px" in text
    assert "scan and Gauss-Newton" in text and "Refinement by" not in text


def test_what_was_refined_stands_in_a_table(tmp_path: Path) -> None:
    run = fabricate(tmp_path / "run", renders=False)
    freedoms = [
        {"name": "thermal <focal>", "unit": "%", "mean": -1.25, "std": 0.3, "prior_std": 2.0, "decided": True},
        {"name": "time offset", "unit": "frame intervals", "mean": 0.01, "std": 0.28, "prior_std": 0.2887, "decided": False},
    ]
    scale = json_files()["scale"] | {"refinement": {"before": 1.2345, "freedoms": freedoms}}
    (run / "scale.json").write_text(json.dumps(scale))
    page = page_of(run)
    assert "thermal <focal> 0 ± 2 % −1.250 ± 0.300 % yes" in page.text  # escaped, and its cells in order
    assert "time offset 0 ± 0.289 frame intervals +0.010 ± 0.280 frame intervals no, as calibrated" in page.text
    assert "Without this the scale would be 1.2345" in page.text
