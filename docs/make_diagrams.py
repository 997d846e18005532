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
    d = Diagram(470, 620, "The five stages of a run, and the file that each leaves")
    rows = [
        ("Photographs and rig.json", "RGB and thermal images, one pair for each instant"),
        ("1  Structure from motion → scene/", "RGB camera poses and points, in an unknown unit"),
        ("2  RGB model → rgb.ply", "3D Gaussians with colours"),
        ("3  Metric scale → scale.json", "SfM units per metre, interval, status"),
        ("4  Thermal model → thermal.ply", "the same Gaussians with temperatures"),
        ("5  Evaluation → report.html", "scores on held-out views, pictures"),
    ]
    for i, (title, what) in enumerate(rows):
        y = 40 + i * 106
        d.box(235, y, 440, 66, [], ACCENT if i else GOOD)
        d.text(235, y - 13, [title], bold=True)
        d.text(235, y + 13, [what], size=14)
        if i:
            d.arrow([(235, y - 106 + 33), (235, y - 35)])
    d.write("pipeline")


def rig() -> None:
    """Eq. 1: where the thermal camera stands for two scales."""
    d = Diagram(480, 300, "The thermal camera moves along the baseline as the scale grows, and near edges move most")
    d.parts.append('<path d="M99,240 H122 M206,240 H232 M316,240 H340" stroke="currentColor" stroke-dasharray="4 3"/>')
    d.box(56, 240, 86, 40, ["RGB"], ACCENT, bold=True)
    for x, label, colour in ((164, "s small", FAIR), (274, "s large", POOR)):
        d.box(x, 240, 84, 40, [label], colour)
        for to_x, to_y in ((150, 140), (370, 40)):
            d.parts.append(f'<line x1="{x}" y1="220" x2="{to_x}" y2="{to_y}" stroke="{colour}" stroke-width="1.5"/>')
    d.parts.append('<circle cx="150" cy="136" r="8" fill="currentColor"/><circle cx="370" cy="36" r="8" fill="currentColor"/>')
    d.text(136, 132, ["near edge"], anchor="end")
    d.text(388, 36, ["far edge"], anchor="start")
    d.text(12, 40, ["The direction to the near edge", "changes much with s,", "to the far edge hardly."], anchor="start", size=14)
    d.text(235, 284, ["thermal camera at baseline direction × s × metres"], size=14)
    d.write("rig")


def scale_verdict() -> None:
    """From the search to the status."""
    d = Diagram(474, 965, "Flow chart: how the scale's status is decided")
    x, w, answer = 155, 290, 398
    d.box(x, 40, w, 56, ["Bracket: image motion between", "½ pixel and half the image"])
    d.box(x, 132, w, 56, ["Coarse scan of the bracket,", "all likely minima kept"])
    d.box(x, 224, w, 56, ["Gauss–Newton from each", "minimum, coarse to fine"])
    d.arrow([(x, 68), (x, 102)])
    d.arrow([(x, 160), (x, 194)])
    d.arrow([(x, 252), (x, 286)])
    questions = [
        ["Lowest loss at the upper", "end of the scan?"],
        ["Answer outside the bracket?"],
        ["No better than no baseline", "(3 standard errors)?"],
        ["Loss flat, or half interval", "above 0.5 in ln s?"],
        ["Over a third of the frames", "place the scale elsewhere?"],
        ["Another minimum better in", "over 2.5 % of resamples?"],
    ]
    for i, lines in enumerate(questions):
        y = 318 + i * 100
        d.question(x, y, w, 62, lines)
        if i < 4:
            d.arrow([(x + w / 2, y), (answer, y), (answer, 691)], "yes", (x + w / 2 + 20, y - 12))
        else:
            d.arrow([(x + w / 2, y), (answer - 72, y)], "yes", (x + w / 2 + 12, y - 14))
        d.arrow([(x, y + 31), (x, y + 67 if i < 5 else 901)], "no", (x - 16, y + 48))
    d.box(answer, 718, 140, 50, ["unobservable"], POOR, bold=True)
    d.box(answer, 818, 140, 50, ["ambiguous"], FAIR, bold=True)
    d.box(x, 928, 140, 50, ["ok"], GOOD, bold=True)
    d.write("scale_verdict")


def thermal_decisions() -> None:
    """The order of the thermal fit's decisions."""
    d = Diagram(480, 1390, "Flow chart: the decisions of the thermal fit, in order")
    x, w = 160, 300
    d.parts.append('<g transform="translate(0 100)">')  # the other rows stand below this one
    d.box(x, -55, w, 56, ["Rows: all, or one in two to four", "where there are many pixels"], FAIR)
    d.arrow([(x, -27), (x, 15)])
    d.box(x, 45, w, 56, ["Leave every 8th training frame", "out: the validation frames"])
    d.arrow([(x, 73), (x, 107)])
    d.box(x, 137, w, 56, ["Least squares on the other frames,", "with and without offsets"])
    steps = [
        (["1  Drift: do offsets predict", "validation frames better?"], ["offsets of", "frames join the fit"]),
        (["2  Pattern: is something in the", "same place of every photograph?"], ["pattern", "subtracted"]),
        (["3  Gains: does the contrast", "differ from frame to frame?"], ["gains and offsets", "join the fit"]),
    ]
    right = x + w / 2
    for i, (question, answer) in enumerate(steps):
        y = 245 + i * 150
        d.arrow([(x, 165 if i == 0 else y - 150 + 92), (x, y - 35)])
        d.question(x, y, w, 66, question)
        d.arrow([(right, y), (right + 85, y), (right + 85, y + 36)], "yes", (right + 30, y - 12))
        d.box(right + 88, y + 65, 150, 54, answer, GOOD)
        d.parts.append(f'<line x1="{x}" y1="{y + 33}" x2="{x}" y2="{y + 92}" stroke="currentColor" stroke-width="1.5"/>')
        d.arrow([(right + 13, y + 72), (x + 2, y + 72)])
        d.text(x - 16, y + 50, ["no"], size=14)
    d.arrow([(x, 637), (x, 679)])
    d.box(x, 712, w, 62, ["4  Ridge: four strengths, Huber", "loss, early stopping"], FAIR)
    d.arrow([(x, 743), (x, 787)])
    d.box(x, 818, w, 60, ["Split Gaussians where several", "photographs agree on what is missing"], FAIR)
    d.arrow([(x, 848), (x, 882)])
    y = 917
    d.question(x, y, w, 70, ["5  Geometry: do the halves predict", "validation frames better there?"])
    d.arrow([(right, y), (right + 85, y), (right + 85, y + 36)], "yes", (right + 30, y - 12))
    d.box(right + 88, y + 65, 150, 54, ["the halves", "are kept"], GOOD)
    d.arrow([(x, y + 35), (x, 1009)])
    d.arrow([(right + 13, y + 72), (x + 2, y + 72)])
    d.text(x - 16, y + 50, ["no"], size=14)
    d.box(x, 1040, w, 60, ["Final fit on all training frames,", "Huber loss, few iterations"])
    d.arrow([(x, 1070), (x, 1114)])
    d.box(x, 1145, w, 60, ["Gauge: median gain 1,", "median offset 0"])
    d.arrow([(x, 1175), (x, 1219)])
    d.box(x, 1250, w, 60, ["thermal.ply, thermal.json", "with the decisions"], GOOD, bold=True)
    d.parts.append("</g>")
    d.write("thermal_decisions")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for draw in (pipeline, rig, scale_verdict, thermal_decisions):
        draw()
