"""Draw the diagrams of the documents: `python docs/make_diagrams.py` writes docs/images/*.svg.

Lines and text take the colour of the page's text (`currentColor`), so a diagram reads on a light page and on a dark one.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

IMAGES = Path(__file__).parent / "images"
ACCENT, GOOD, FAIR, POOR = "#2f7ed8", "#2a9d57", "#c98a14", "#d0473c"
LINE_PX, FONT_PX = 19, 15


class Diagram:
    """Boxes, questions and arrows on a canvas of `width` × `height`; text is centred, one line an entry."""

    def __init__(self, width: int, height: int, label: str) -> None:
        self.width, self.height, self.label = width, height, label
        self.parts: list[str] = []

    def text(
        self, x: float, y: float, lines: Sequence[str], *, anchor: str = "middle", size: int = FONT_PX, bold: bool = False
    ) -> None:
        first = y - (len(lines) - 1) * LINE_PX / 2
        weight = ' font-weight="600"' if bold else ""
        for i, line in enumerate(lines):
            self.parts.append(
                f'<text x="{x:g}" y="{first + i * LINE_PX:g}" text-anchor="{anchor}" dominant-baseline="central" font-size="{size}"'
                f'{weight} fill="currentColor">{html.escape(line)}</text>'
            )

    def box(self, x: float, y: float, w: float, h: float, lines: Sequence[str], colour: str = ACCENT, bold: bool = False) -> None:
        """Centred at (x, y)."""
        self.parts.append(
            f'<rect x="{x - w / 2:g}" y="{y - h / 2:g}" width="{w:g}" height="{h:g}" rx="8" fill="{colour}" fill-opacity="0.13" '
            f'stroke="{colour}" stroke-width="1.5"/>'
        )
        self.text(x, y, lines, bold=bold)

    def question(self, x: float, y: float, w: float, h: float, lines: Sequence[str]) -> None:
        """A decision: a hexagon centred at (x, y)."""
        cut = 18
        points = [
            (-w / 2 + cut, -h / 2),
            (w / 2 - cut, -h / 2),
            (w / 2, 0),
            (w / 2 - cut, h / 2),
            (-w / 2 + cut, h / 2),
            (-w / 2, 0),
        ]
        drawn = " ".join(f"{x + dx:g},{y + dy:g}" for dx, dy in points)
        self.parts.append(f'<polygon points="{drawn}" fill="none" stroke="currentColor" stroke-width="1.5"/>')
        self.text(x, y, lines)

    def arrow(self, points: Sequence[tuple[float, float]], label: str = "", at: tuple[float, float] | None = None) -> None:
        drawn = " ".join(f"{x:g},{y:g}" for x, y in points)
        self.parts.append(
            f'<polyline points="{drawn}" fill="none" stroke="currentColor" stroke-width="1.5" marker-end="url(#{self._head})"/>'
        )
        if label:
            x, y = at or points[0]
            self.text(x, y, [label], size=14)

    @property
    def _head(self) -> str:
        return "head-" + "".join(c for c in self.label.lower() if c.isalnum())[:24]

    def write(self, name: str) -> None:
        head = (
            f'<marker id="{self._head}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto-start-reverse">'
            '<path d="M0,1 L9,5 L0,9 z" fill="currentColor"/></marker>'
        )
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" role="img" '
            f'aria-label="{html.escape(self.label, quote=True)}" font-family="system-ui, sans-serif">',
            f"<defs>{head}</defs>",
            *self.parts,
            "</svg>",
        ]
        (IMAGES / f"{name}.svg").write_text("\n".join(lines) + "\n", encoding="utf-8")


def pipeline() -> None:
    """What goes from stage to stage."""
    d = Diagram(760, 560, "The five stages of a run, and the file that each leaves")
    rows = [
        ("Photographs and rig.json", "capture/", "RGB and thermal images, one pair an instant"),
        ("1  Structure from motion", "scene/", "RGB camera poses and points, in an unknown unit"),
        ("2  RGB model", "rgb.ply", "3D Gaussians with colours"),
        ("3  Metric scale", "scale.json", "SfM units per metre, interval, status"),
        ("4  Thermal model", "thermal.ply", "the same Gaussians with temperatures"),
        ("5  Evaluation", "report.html", "scores on held-out views, pictures"),
    ]
    for i, (title, file, what) in enumerate(rows):
        y = 45 + i * 94
        d.box(190, y, 330, 50, [title], ACCENT if i else GOOD, bold=True)
        d.text(375, y - (10 if what else 0), [file], anchor="start", bold=True)
        if what:
            d.text(375, y + 11, [what], anchor="start", size=14)
        if i:
            d.arrow([(190, y - 94 + 25), (190, y - 27)])
    d.write("pipeline")


def rig() -> None:
    """Eq. 1: where the thermal camera stands for two scales."""
    d = Diagram(640, 300, "The thermal camera moves along the baseline as the scale grows, and near edges move most")
    d.parts.append('<path d="M168,250 H188 M272,250 H288 M372,250 H392" stroke="currentColor" stroke-dasharray="4 3"/>')
    d.box(120, 250, 96, 40, ["RGB"], ACCENT, bold=True)
    for x, label, colour in ((230, "s small", FAIR), (330, "s large", POOR)):
        d.box(x, 250, 84, 40, [label], colour)
    for x, colour in ((230, FAIR), (330, POOR)):
        for target in ((200, 130), (420, 40)):
            d.parts.append(
                f'<line x1="{x}" y1="230" x2="{target[0]}" y2="{target[1]}" stroke="{colour}" stroke-width="1.5" stroke-opacity="0.8"/>'
            )
    d.parts.append('<circle cx="200" cy="126" r="8" fill="currentColor"/><circle cx="420" cy="36" r="8" fill="currentColor"/>')
    d.text(186, 122, ["near edge"], anchor="end")
    d.text(438, 36, ["far edge"], anchor="start")
    d.text(400, 238, ["thermal camera at", "baseline direction × s × metres"], anchor="start", size=14)
    d.text(
        400, 150, ["The direction to the near edge", "changes much with s,", "to the far edge hardly."], anchor="start", size=14
    )
    d.write("rig")


def scale_verdict() -> None:
    """From the search to the status."""
    d = Diagram(584, 865, "Flow chart: how the scale's status is decided")
    d.box(200, 40, 330, 56, ["Bracket: image motion between", "½ pixel and half the image"])
    d.box(200, 132, 330, 56, ["Coarse scan of the bracket,", "all likely minima kept"])
    d.box(200, 224, 330, 56, ["Gauss–Newton from each minimum,", "coarse to fine"])
    d.arrow([(200, 68), (200, 102)])
    d.arrow([(200, 160), (200, 194)])
    questions = [
        ["Lowest loss at the upper", "end of the scan?"],
        ["Answer outside the bracket?"],
        ["No better than no baseline", "(3 standard errors)?"],
        ["Loss flat, or half interval", "above 0.5 in ln s?"],
    ]
    d.arrow([(200, 252), (200, 286)])
    for i, lines in enumerate(questions):
        y = 318 + i * 100
        d.question(200, y, 330, 62, lines)
        if y < 618:
            d.arrow([(365, y), (490, y), (490, 591)], "yes", (385, y - 12))
        else:
            d.arrow([(365, y), (404, y)], "yes", (384, y - 13))
        d.arrow([(200, y + 31), (200, y + 67)], "no", (184, y + 46))
    d.box(490, 618, 168, 50, ["unobservable"], POOR, bold=True)
    d.question(200, 718, 330, 62, ["Another minimum better in", "over 2.5 % of resamples?"])
    d.arrow([(365, 718), (404, 718)], "yes", (384, 705))
    d.box(490, 718, 168, 50, ["ambiguous"], FAIR, bold=True)
    d.arrow([(200, 749), (200, 801)], "no", (184, 770))
    d.box(200, 828, 168, 50, ["ok"], GOOD, bold=True)
    d.write("scale_verdict")


def thermal_decisions() -> None:
    """The order of the thermal fit's decisions."""
    d = Diagram(600, 1080, "Flow chart: the decisions of the thermal fit, in order")
    x, w = 215, 370
    d.box(x, 45, w, 56, ["Leave every 8th training frame out:", "the validation frames"])
    d.arrow([(x, 73), (x, 107)])
    d.box(x, 137, w, 56, ["Least squares on the other frames,", "with and without offsets for each frame"])
    steps = [
        (["1  Drift: do offsets predict", "validation frames better?"], ["offsets of frames", "join the fit"]),
        (["2  Pattern: is something in the same", "place of every photograph?"], ["pattern subtracted", "from photographs"]),
        (["3  Gains: does the contrast", "differ from frame to frame?"], ["gains of frames", "join the fit"]),
    ]
    for i, (question, answer) in enumerate(steps):
        y = 245 + i * 150
        d.arrow([(x, 165 if i == 0 else y - 150 + 92), (x, y - 35)])
        d.question(x, y, w, 66, question)
        d.arrow([(x + w / 2, y), (x + w / 2 + 45, y), (x + w / 2 + 45, y + 36)], "yes", (x + w / 2 + 22, y - 12))
        d.box(x + w / 2 + 95, y + 65, 180, 54, answer, GOOD)
        d.arrow([(x + w / 2 + 5, y + 75), (x, y + 75), (x, y + 92)])
        d.parts.append(f'<line x1="{x}" y1="{y + 33}" x2="{x}" y2="{y + 92}" stroke="currentColor" stroke-width="1.5"/>')
        d.text(x - 16, y + 52, ["no"], size=14)
    d.arrow([(x, 637), (x, 679)])
    d.box(x, 712, w, 62, ["4  Ridge: four strengths solved together,", "Huber loss, early stopping by validation error"], FAIR)
    d.arrow([(x, 743), (x, 787)])
    d.box(x, 818, w, 60, ["Final fit on all training frames,", "Huber loss, few iterations"])
    d.arrow([(x, 848), (x, 892)])
    d.box(x, 923, w, 60, ["Gauge: median gain 1,", "no change at the scene's median"])
    d.arrow([(x, 953), (x, 997)])
    d.box(x, 1028, w, 60, ["thermal.ply, thermal.json", "decisions with their numbers"], GOOD, bold=True)
    d.write("thermal_decisions")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for draw in (pipeline, rig, scale_verdict, thermal_decisions):
        draw()
