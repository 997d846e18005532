"""Section: where the cameras stood, from above and from the side, in metres."""

from __future__ import annotations

import matplotlib.transforms
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.markers import MarkerStyle
from numpy.typing import NDArray

from rtgs.run.inspection.findings import position_of
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.pieces import card, paragraph
from rtgs.run.report.charts import INK, as_svg, plain_axes

_MOST_POINTS = 1500
_MIDDLE = (2.0, 98.0)  # percentiles of the points that are drawn: a few of them lie far off
_CAMERA, _SPOT = "#2f7ed8", "#d62f1f"
_TEXT_PT = 10


def plan_section(report: Inspection) -> str:
    """Both drawings, or why there are none."""
    words = report.words
    if report.subject is None or report.frame is None:
        return card(words, "plan", paragraph(words("plan.none", why=report.why_not), "doubt"))
    frame = report.frame
    up = "unknown" if frame.axes is None else "cameras" if frame.place is None else "place"
    cameras = len(report.subject.scene.frames)
    about = paragraph(words("plan.about", cameras=cameras, up=words.plain(f"plan.up.{up}")))
    doubt = report.run.scale.doubt if report.run.scale is not None else ""
    about += paragraph(words("plan.doubt", doubt=doubt), "doubt") if doubt else ""
    drawings = "".join(_drawing(report, vertical) for vertical in (1, 2))
    return card(words, "plan", about + f'<div class="pair">{drawings}</div>', "whole")


def _drawing(report: Inspection, vertical: int) -> str:
    """x to the right; y upwards (vertical = 1, from above) or z (2, from the side)."""
    words, subject, frame = report.words, report.subject, report.frame
    assert subject is not None and frame is not None
    axes_used, scene = [0, vertical], subject.scene
    figure = Figure(figsize=(5.4, 4.6), layout="constrained")
    axes = figure.subplots()
    plain_axes(axes)
    points = _middle(frame.of(scene.points.xyz))[:, axes_used]
    axes.plot(*points.T, linestyle="", marker=".", markersize=1.6, color=INK, alpha=0.3)
    poses = [frame.from_world.carry(scene.world_from_rgb[f.name]) for f in scene.frames]
    for pose in poses:
        _camera(axes, pose.translation[axes_used], pose.rotation[axes_used, 2])
    for number, spot in enumerate(report.spots.spots if report.spots is not None else (), start=1):
        place = np.array(position_of(report, spot))[axes_used]
        axes.plot(*place, marker="o", markersize=5, markerfacecolor="none", markeredgecolor=_SPOT)
        axes.annotate(
            str(number),
            (place[0], place[1]),
            xytext=(4, 4),
            textcoords="offset points",
            color=_SPOT,
            fontsize=_TEXT_PT,
            weight="bold",
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(True, color=INK, alpha=0.12, linewidth=0.6)
    names = ("east", "north", "up_axis") if frame.place is not None else ("x", "y", "z")
    axes.set_xlabel(words.plain(f"plan.{names[0]}"), color=INK, fontsize=_TEXT_PT)
    axes.set_ylabel(words.plain(f"plan.{names[vertical]}"), color=INK, fontsize=_TEXT_PT)
    return as_svg(figure, words.plain("plan.top" if vertical == 1 else "plan.side"))


def _camera(axes: Axes, place: NDArray[np.float64], towards: NDArray[np.float64]) -> None:
    """A slim triangle that points where the camera looks; a dot where it looks across the drawing."""
    if np.linalg.norm(towards) < 0.2:
        axes.plot(*place, marker="o", markersize=4, color=_CAMERA)
        return
    turn = (
        matplotlib.transforms.Affine2D().scale(0.55, 1.0).rotate_deg(float(np.degrees(np.arctan2(towards[1], towards[0]))) - 90)
    )
    axes.plot(*place, marker=MarkerStyle("^", transform=turn), markersize=8, color=_CAMERA, markeredgewidth=0)


def _middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(points) == 0:
        return points
    low, high = np.percentile(points, _MIDDLE, axis=0)
    inside = points[((points >= low) & (points <= high)).all(axis=1)]
    return inside[:: max(1, len(inside) // _MOST_POINTS)]
