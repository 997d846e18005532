"""The picture that explains the method: the edges of both modalities from the thermal camera, at a scale that is tried."""

from __future__ import annotations

import io
import math
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
_CURVE = (420, 160)  # width and height of the curve's picture


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
    """The loss over the scale, with the estimate, its interval and the scale that is tried."""
    width, height = _CURVE
    image = Image.new("RGB", _CURVE, BACKGROUND)
    draw = ImageDraw.Draw(image)
    scan = estimate.scan or estimate.local
    s = np.array(scan.sfm_per_metre or (estimate.sfm_per_metre,))
    loss = np.array(scan.loss or (0.0,))
    theta = np.log(np.concatenate([s, [tried, *(estimate.ci95 or ())]]))
    lo, hi = theta.min() - 0.05, theta.max() + 0.05
    low, high = loss.min(), max(loss.max(), loss.min() + 1e-9)

    def x(scale: float) -> float:
        return 8 + (math.log(scale) - lo) / (hi - lo) * (width - 16)

    def y(value: float) -> float:
        return float(height - 26 - (value - low) / (high - low) * (height - 40))

    if estimate.ci95 is not None:
        a, b = (x(end) for end in estimate.ci95)
        draw.rectangle(
            [min(a, x(estimate.sfm_per_metre) - 2), 6, max(b, x(estimate.sfm_per_metre) + 2), height - 20], fill=(52, 72, 66)
        )
    draw.line([(x(a), y(b)) for a, b in zip(s, loss, strict=True)], fill=INK, width=2)
    draw.line([(x(estimate.sfm_per_metre), 6), (x(estimate.sfm_per_metre), height - 20)], fill=ESTIMATE, width=2)
    draw.line([(x(tried), 6), (x(tried), height - 20)], fill=THERMAL_EDGE, width=2)
    font = ImageFont.load_default(size=14)
    draw.text((8, height - 19), "loss over the scale", fill=INK, font=font)
    for text, colour, at in (("estimate, interval", ESTIMATE, 0.44), ("tried", THERMAL_EDGE, 0.86)):
        draw.text((width * at, height - 19), text, fill=colour, font=font)
    return np.asarray(image)


LEGEND = (("thermal edges", THERMAL_EDGE), ("edges of the render", RENDER_EDGE), ("where they meet", COMMON_EDGE))


def png(picture: Picture) -> bytes:
    """A picture as a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG")
    return buffer.getvalue()
