"""The picture that explains the method: the edges of both modalities from the thermal camera, at a scale that is tried."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from rtgs.images.pictures import (
    BACKGROUND,
    COMMON_EDGE,
    INK,
    RENDER_EDGE,
    THERMAL_EDGE,
    Picture,
    edge_overlay,
)
from rtgs.scale import ScaleEstimate
from rtgs.viewer.engine import Engine, Eye

ESTIMATE = (64, 224, 128)
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
LEAST, MOST = 0.5, 2.0  # that a person can try, as multiples of the estimate
_INTERVAL = (40, 92, 66)
_CURVE, _TEXT_PX = (640, 280), 24  # size of the curve's picture, about twice that on the page


@dataclass(frozen=True, eq=False)
class ScaleCheck:
    """Edges at one scale.

    Attributes:
        picture: of `edge_overlay`. met: share of the thermal edges that lie on edges of the render.
    """

    picture: Picture
    met: float


def check_scale(engine: Engine, frame: str, sfm_per_metre: float) -> ScaleCheck | None:
    """The RGB model from where the thermal camera stands at this scale, under the edges of its photograph; None without models."""
    scene = engine.contents.scene
    if scene is None or engine.contents.rgb is None:
        return None
    seen = engine.look(Eye(scene.rig.thermal, scene.world_from_thermal(frame, sfm_per_metre)), rgb=True)
    assert seen.rgb is not None
    photograph = next(f for f in scene.frames if f.name == frame).thermal
    picture = edge_overlay(seen.rgb @ _LUMA, photograph, scene.capture.thermal_mask)
    common, thermal = (int((picture == colour).all(axis=2).sum()) for colour in (COMMON_EDGE, THERMAL_EDGE))
    return ScaleCheck(picture, common / max(common + thermal, 1))


def curve_picture(estimate: ScaleEstimate, tried: float) -> Picture:
    """The loss from half the estimate to its double, with the estimate, its interval and the scale that is tried."""
    width, height = _CURVE
    image = Image.new("RGB", _CURVE, BACKGROUND)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=_TEXT_PX)
    top, bottom = 2 * _TEXT_PX, height - 2 * _TEXT_PX
    scan = estimate.scan or estimate.local
    share = np.array(scan.sfm_per_metre) / estimate.sfm_per_metre
    near = (share > LEAST / 1.3) & (share < 1.3 * MOST)  # one sample beyond each end where the scan is coarse
    share, loss = share[near], np.array(scan.loss)[near]

    def x(multiple: float) -> float:
        return 12 + (multiple - LEAST) / (MOST - LEAST) * (width - 24)

    if estimate.ci95 is not None:
        a, b = (x(end / estimate.sfm_per_metre) for end in estimate.ci95)
        draw.rectangle([min(a, x(1) - 4), top, max(b, x(1) + 4), bottom], fill=_INTERVAL)
    draw.line([(x(1), top), (x(1), bottom)], fill=ESTIMATE, width=7)
    if len(share) > 1:
        low, span = loss.min(), max(float(np.ptp(loss)), 1e-9)
        draw.line([(x(s), bottom - 6 - (v - low) / span * (bottom - top - 12)) for s, v in zip(share, loss, strict=True)], INK, 3)
    at = x(float(np.clip(tried / estimate.sfm_per_metre, LEAST, MOST)))
    draw.line([(at, top), (at, bottom)], fill=THERMAL_EDGE, width=3)
    low_line, high_line = height - _TEXT_PX, _TEXT_PX
    for text, colour, place, anchor in (
        ("loss", INK, (12, high_line), "lm"),
        ("estimate, 95 % interval" if estimate.ci95 else "estimate", ESTIMATE, (0.55 * width, high_line), "mm"),
        ("tried", THERMAL_EDGE, (width - 12, high_line), "rm"),
        ("half", INK, (12, low_line), "lm"),
        ("double", INK, (width - 12, low_line), "rm"),
    ):
        draw.text(place, text, fill=colour, font=font, anchor=anchor)
    return np.asarray(image)


LEGEND = (("thermal edges", THERMAL_EDGE), ("edges of the render", RENDER_EDGE), ("where they meet", COMMON_EDGE))


def png(picture: Picture) -> bytes:
    """A picture as a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG")
    return buffer.getvalue()
