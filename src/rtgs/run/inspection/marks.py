"""Section: the 3D model with numbered marks at the findings, from a few places where photographs were taken."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from rtgs.images.pictures import Picture, palette, to_picture
from rtgs.io.exports.subject import Subject
from rtgs.records.camera import Camera
from rtgs.records.spots import Spot
from rtgs.renderer import render
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.pieces import card, embedded, paragraph

MOST_VIEWS = 8
_TRIED = 4  # cameras that are rendered for each picture
_WIDTH_PX = 640
_HIDDEN = 0.05  # a place this share of its distance behind the surface is hidden
_COVERED = 0.5  # opacity from which a pixel shows a surface

Places = Mapping[int, tuple[float, float]]
_Box = tuple[float, float, float, float]  # left, top, right, bottom


@dataclass(frozen=True, eq=False)
class MarkedView:
    """Renders from an RGB camera.

    Attributes:
        name: the photograph that was taken from there. camera: of the pictures.
        places: pixel of each finding that is seen, by its number.
    """

    name: str
    camera: Camera
    places: Places


def marks_section(report: Inspection) -> str:
    """The pictures; "" where there is no finding."""
    words, subject = report.words, report.subject
    if report.spots is None or not report.spots.spots:
        return ""
    if subject is None:
        return card(words, "marks", paragraph(words("marks.none", why=report.why_not), "doubt"))
    views = marked_views(subject, report.spots.spots)
    lo, hi = subject.thermal.range.lo, subject.thermal.range.hi
    shown = ""
    for view in views:
        pose = subject.scene.rgb_from_world(view.name)
        temperature = subject.thermal.render(view.camera, pose)
        pictures = (to_picture(subject.rgb.render(view.camera, pose)), palette(temperature, lo, hi))
        ends = {"lo": f"{lo:.1f}", "hi": f"{hi:.1f}", "unit": subject.thermal.unit}
        about = words("marks.about", name=Path(view.name).name, **ends)
        pair = "".join(_with_marks(p, view.places) for p in pictures)
        shown += f'<figure><div class="pair">{pair}</div><figcaption>{about}</figcaption></figure>'
    seen = {number for view in views for number in view.places}
    unseen = [str(n) for n in range(1, len(report.spots.spots) + 1) if n not in seen]
    note = paragraph(words("marks.unseen", numbers=", ".join(unseen))) if unseen else ""
    return card(words, "marks", shown + note)


def marked_views(subject: Subject, spots: Sequence[Spot], most: int = MOST_VIEWS) -> list[MarkedView]:
    """A few cameras. Each shows the first spot that no earlier one shows, and as many others as possible."""
    given = np.array([spot.position_m for spot in spots]) / subject.unit_per_sfm
    points = subject.scene.given_from_world.apply_inverse(given)
    camera = subject.scene.rig.rgb
    if camera.width > _WIDTH_PX:
        camera = camera.resized(_WIDTH_PX, round(camera.height * _WIDTH_PX / camera.width))
    within = {frame.name: _in_picture(subject, camera, frame.name, points) for frame in subject.scene.frames}
    left, seen = set(range(1, len(spots) + 1)), dict[str, Places]()
    views: list[MarkedView] = []
    while left and len(views) < most:
        first = min(left)
        may_see = [name for name, places in within.items() if first in places]
        names = sorted(may_see, key=lambda name: -len(left & set(within[name])))[:_TRIED]
        names += [name for name in spots[first - 1].best_frames if name in may_see and name not in names]
        for name in names:
            if name not in seen:
                shown = {n for n in within[name] if name in spots[n - 1].best_frames}  # the list says so
                seen[name] = _not_hidden(subject, camera, name, points, within[name], shown)
        showing = [name for name in names if first in seen[name]]
        if showing:
            best = max(showing, key=lambda name: len(left & set(seen[name])))
            views.append(MarkedView(best, camera, seen[best]))
            left -= set(seen[best])
        left.discard(first)
    return views


def _in_picture(subject: Subject, camera: Camera, name: str, points: NDArray[np.float64]) -> Places:
    local = subject.scene.rgb_from_world(name).apply(points)
    found = {}
    for number, point in enumerate(local, start=1):
        if point[2] > 0:
            x, y = camera.project(point).tolist()
            if 0 <= x < camera.width and 0 <= y < camera.height:
                found[number] = (x, y)
    return found


def _not_hidden(
    subject: Subject, camera: Camera, name: str, points: NDArray[np.float64], places: Places, shown: Collection[int]
) -> Places:
    """Those of the places that lie on what the model shows there, and those that are known to be shown."""
    pose, rgb = subject.scene.rgb_from_world(name), subject.rgb
    with torch.no_grad():
        view = render(rgb.gaussians, camera, pose, settings=replace(rgb.settings, with_depth=True))
    assert view.depth is not None
    alpha, depth = view.alpha.numpy(), view.depth.numpy()
    found = {}
    for number, (x, y) in places.items():
        at = int(y), int(x)
        distance = float(pose.apply(points[number - 1])[2])
        if number in shown or (alpha[at] > _COVERED and distance < (1 + _HIDDEN) * float(depth[at] / alpha[at])):
            found[number] = (x, y)
    return found


def _with_marks(picture: Picture, places: Places) -> str:
    """An SVG with the picture in it: numbers stay sharp on paper."""
    height, width = picture.shape[:2]
    data, _ = embedded(Image.fromarray(picture), width)
    ring, text = 0.014 * width, 0.036 * width
    marks, taken = "", list[_Box]()
    for number, (x, y) in places.items():
        box = _free_place((x, y), (0.62 * text * len(str(number)), text), 1.3 * ring, (width, height), taken)
        taken.append(box)
        marks += (
            f'<g class="mark"><circle cx="{x:.1f}" cy="{y:.1f}" r="{ring:.1f}"/>'
            f'<text x="{box[0]:.1f}" y="{box[1] + 0.82 * text:.1f}" font-size="{text:.0f}">{number}</text></g>'
        )
    image = f'<image href="{data}" width="{width}" height="{height}"/>'
    return f'<svg class="marks" viewBox="0 0 {width} {height}" role="img">{image}{marks}</svg>'


def _free_place(
    mark: tuple[float, float], size: tuple[float, float], gap: float, picture: tuple[int, int], taken: Sequence[_Box]
) -> _Box:
    """Where a number stands beside its mark: at the first corner that is in the picture and hides no other number."""
    (x, y), (w, h) = mark, size
    corners = [(a, b) for far in (0.0, h) for b in (y - gap - h - far, y + gap + far) for a in (x + gap, x - gap - w)]
    boxes = [(a, b, a + w, b + h) for a, b in corners]
    inside = [q for q in boxes if q[0] >= 0 and q[1] >= 0 and q[2] <= picture[0] and q[3] <= picture[1]] or boxes
    return min(inside, key=lambda q: sum(_overlap(q, other) for other in taken))


def _overlap(a: _Box, b: _Box) -> float:
    """Common area of two boxes."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)
