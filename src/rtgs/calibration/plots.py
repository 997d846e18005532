"""Pictures of a calibration: what each camera's corners leave, and where corners were found."""

from __future__ import annotations

import io
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from rtgs.calibration.solve import Solution
from rtgs.images.pictures import Picture, save_png, side_by_side, to_picture

Array = NDArray[np.float64]
FIRST, OTHERS = (255, 64, 48), (0, 210, 255)
_WIDTH, _MOST_ARROWS = 480, 4000
_ARROW = 0.04  # of the image's width: the length at which a usual residual is drawn


def overlay(path: Path, pictures: tuple[NDArray[np.float32], NDArray[np.float32]], pixels: tuple[Array, Array]) -> None:
    """Both pictures `[h, w]` of a pair with the corners that were found in them, the first one in red."""
    tiles = [_marked(picture, corners) for picture, corners in zip(pictures, pixels, strict=True)]
    save_png(path, side_by_side(tiles, ["RGB", "thermal"]))


def _marked(picture: NDArray[np.float32], pixels: Array) -> Picture:
    low, high = np.percentile(picture, (0.5, 99.5))
    factor = _WIDTH / picture.shape[1]
    size = (_WIDTH, max(1, round(picture.shape[0] * factor)))
    small = cv2.resize((picture - low) / max(float(high - low), 1e-12), size, interpolation=cv2.INTER_AREA)
    out = to_picture(small).copy()
    for i, (x, y) in enumerate(pixels * factor):
        centre = (round(16 * (x - 0.5)), round(16 * (y - 0.5)))  # in sixteenths of a pixel
        cv2.circle(out, centre, 16 * 4, FIRST if i == 0 else OTHERS, 1, cv2.LINE_AA, 4)
    return out


def residual_plots(
    folder: Path, solution: Solution, pixels: tuple[list[Array], list[Array]], sizes: tuple[tuple[int, int], ...]
) -> None:
    """`residuals_rgb.png` and `residuals_thermal.png`: residuals as arrows over the image, and as points around zero."""
    for which, residuals, at, size in zip(("rgb", "thermal"), solution.residuals, pixels, sizes, strict=True):
        r, p = np.concatenate(residuals), np.concatenate(at)
        typical = max(float(np.sqrt((r**2).sum(axis=1).mean())), 1e-9)
        enlarged = _ARROW * size[0] / typical
        every = -(-len(r) // _MOST_ARROWS)
        r, p = r[::every], p[::every]
        figure = Figure(figsize=(10, 4.4), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
        style = {"angles": "xy", "scale_units": "xy", "scale": 1 / enlarged, "width": 0.002, "cmap": "viridis"}
        arrows = left.quiver(p[:, 0], p[:, 1], r[:, 0], r[:, 1], np.hypot(*r.T), **style)
        figure.colorbar(arrows, ax=left, label="px", shrink=0.8)
        left.set(
            xlim=(0, size[0]),
            ylim=(size[1], 0),
            aspect="equal",
            title=f"{which}: root mean square {typical:.2f} px, arrows × {enlarged:.0f}",
        )
        right.scatter(r[:, 0], r[:, 1], s=4, alpha=0.4)
        reach = 1.05 * max(float(np.abs(r).max()), 1e-9)
        right.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xlabel="x, px", ylabel="y, px")
        right.grid(alpha=0.3)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=100)
        save_png(folder / f"residuals_{which}.png", np.asarray(Image.open(buffer, formats=("PNG",)).convert("RGB")))
