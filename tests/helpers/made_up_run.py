"""A made-up run folder with everything that the report reads, and a reader of the page that comes of it."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from tests.helpers.inspection_pages import write_spots

from rtgs.base.json_records import write_json
from rtgs.config import DensifyConfig, RgbConfig, RunConfig
from rtgs.evaluation.records import Evaluation, ModelScores, Scores
from rtgs.images import pictures
from rtgs.run.folder import RunFolder
from rtgs.run.records import CaptureSummary
from rtgs.run.report import write_report
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import History, Scan

HELD_OUT = [f"frame_{i:04d}" for i in range(0, 72, 8)]
SFM_PER_METRE = 2.4312


def scene(shift_px: float = 0.0, height: int = 192, width: int = 240) -> np.ndarray:
    """A gray picture `[H, W]` in [0, 1] with a box and a disc."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    image = 0.35 + 0.1 * np.sin(x / 60) + 0.05 * np.cos(y / 25)
    image[(np.abs(x - 75 - shift_px) < 30) & (np.abs(y - 105) < 45)] = 0.8
    image[np.hypot(x - 165 - shift_px, y - 83) < 34] = 0.12
    return image


def config() -> dict[str, object]:
    settings = RunConfig(rgb=RgbConfig(steps=7000, densify=DensifyConfig(max_gaussians=60000)))
    return {"version": "0.1.0", "capture": "captures/<Boiler & pipes>", "settings": settings}


def summary() -> CaptureSummary:
    return CaptureSummary(
        frames=72,
        registered=70,
        failures={"frame_0013": "too few matches", "frame_0014": "blurred <motion>"},
        warnings=("rig.json and the poses disagree by 1.4 % about fl_x; the poses' is used",),
        unit="°C",
        rgb_size=(960, 540),
        thermal_size=(640, 512),
        baseline_m=0.2,
    )


def numbers(values: np.ndarray) -> tuple[float, ...]:
    return tuple(values.tolist())


def estimate() -> ScaleEstimate:
    """By a solver that keeps its steps, from a scan with one minimum."""
    s = np.geomspace(0.3, 20.0, 40)
    curve = 0.93 - 0.2 * np.exp(-((np.log(s / SFM_PER_METRE) / 0.25) ** 2))
    rng = np.random.default_rng(0)
    per_frame = {n: numbers(curve + 0.02 * rng.standard_normal(40)) for n in HELD_OUT}
    step = np.arange(60)
    path = SFM_PER_METRE * np.exp(0.5 * np.exp(-step / 12) * np.cos(step / 6))
    return ScaleEstimate(
        sfm_per_metre=SFM_PER_METRE,
        std_log=0.0061,
        ci95=(2.402, 2.461),
        status="ok",
        reason="",
        solver="adam",
        init=1.0,
        bracket=(0.3, 20.0),
        baseline_m=0.2,
        frames=tuple(HELD_OUT),
        scan=Scan(numbers(s), numbers(curve), numbers(0.004 + 0 * s), per_frame),
        local=Scan((), (), (), {}),
        history=History(tuple(range(60)), numbers(path), numbers(0.9 - 0.003 * step), numbers(0.1 - 0.001 * step)),
    )


def evaluation() -> Evaluation:
    """Means that differ from those of its frames: the report must not compute any."""
    frames = dict.fromkeys(HELD_OUT, Scores(psnr=31.2, ssim=0.93, mae_c=0.61))
    return Evaluation(
        rgb=ModelScores(psnr=27.312, ssim=0.881, per_frame=dict.fromkeys(HELD_OUT, Scores(psnr=27.3, ssim=0.88))),
        thermal=ModelScores(psnr=31.84, ssim=0.941, mae_c=0.58, per_frame=frames),
        thermal_naive=ModelScores(psnr=29.44, ssim=0.922, mae_c=0.97, per_frame=frames),
        temperature_range_c=(18.0, 41.5),
        timings_s={
            "sfm": 64.0,
            "rgb": 812.4,
            "scale": 41.2,
            "thermal": 18.8,
            "thermal_naive": 18.1,
            "spots": 2.0,
            "evaluate": 9.3,
        },
    )


def make_run(run: Path, *, renders: bool = False) -> Path:
    """A run folder with every record, and with pictures where asked for."""
    run.mkdir()
    write_json(run / "config.json", config())
    write_json(run / "capture_summary.json", summary())
    RunFolder(run).write_scale(estimate())
    evaluation().write(run / "metrics.json")
    if renders:
        _draw(run / "renders")
        write_spots(run / "spots")
    return run


def _draw(folder: Path) -> None:
    rng = np.random.default_rng(1)
    for i, name in enumerate(HELD_OUT):
        thermal = 20 + 20 * (1 - scene(i)) + 0.1 * rng.standard_normal(scene().shape)
        render, naive = 20 + 20 * (1 - scene(i + 0.5)), 20 + 20 * (1 - scene(i + 6))
        rgb = np.stack([scene(i), scene(i) ** 1.2, scene(i) ** 0.8], axis=2)
        pictures.save_png(folder / "overlay" / f"{name}.before.png", pictures.edge_overlay(scene(i + 7), thermal))
        pictures.save_png(folder / "overlay" / f"{name}.after.png", pictures.edge_overlay(scene(i), thermal))
        pictures.save_png(folder / "rgb" / f"{name}.reference.png", pictures.to_picture(rgb))
        pictures.save_png(folder / "rgb" / f"{name}.render.png", pictures.to_picture(rgb**1.05))
        pictures.save_png(folder / "rgb" / f"{name}.error.png", pictures.error_map(rgb**1.05, rgb, 0.1))
        pictures.save_png(folder / "thermal" / f"{name}.reference.png", pictures.palette(thermal, 18, 41.5))
        for model, temperature in (("thermal", render), ("thermal_naive", naive)):
            pictures.save_png(folder / model / f"{name}.render.png", pictures.palette(temperature, 18, 41.5))
            pictures.save_png(folder / model / f"{name}.error.png", pictures.error_map(temperature, thermal, 3.0, "°C"))


class Page(HTMLParser):
    """Text, headings, links and balance of a page."""

    VOID = frozenset({"meta", "img", "br", "wbr", "link", "input"})

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source = source
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
