"""How much of the thermal features of a synthetic capture a model shows in held-out views; `hot_spots.py` measures with it.

Everything is judged against noise-free temperatures of the same scene at the same pixels: with the features (`with_features`) and without
them (`without`). The excess of a feature is the difference of the two.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.synthetic.features import ThermalFeature

Image = NDArray[np.float32]
FALSE_C, FALSE_PX = 3.0, 3  # a false spot: so far off the truth, in a blob of so many pixels
EDGE_PX = 5.0  # an edge's profile runs so far to both sides


@dataclass(frozen=True)
class View:
    """A held-out view: its pose, and images `[h, w]` in °C."""

    name: str
    camera: Camera
    thermal_from_world: SE3
    photograph: Image
    with_features: Image
    without: Image

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """`[..., 2]`: pixels of world points `[..., 3]`, metres."""
        return self.camera.project(self.thermal_from_world.apply(points))


@dataclass(frozen=True)
class Share:
    """What a render shows of a feature's excess: 1 is all of it. At the centre (along the middle of a line), and where half of it is."""

    kind: str
    size_px: float
    sign: int
    view: str
    centre: float
    disk: float


def shares(features: Sequence[ThermalFeature], view: View, render: Image) -> Iterator[Share]:
    """Of every feature that the view sees whole."""
    excess, shown = view.with_features - view.without, render - view.without
    for feature in features:
        if view.name not in feature.views:
            continue
        centre = np.array(feature.position_m)
        along = np.array(feature.along) * feature.length_m / 2
        middle = centre + (np.linspace(-1, 1, 41)[:, None] * along if feature.kind == "line" else 0.0)
        x, y = np.floor(np.atleast_2d(view.pixels(middle))).astype(int).T
        disk = _own_pixels(feature, view, excess)
        yield Share(
            feature.kind,
            feature.size_px,
            feature.sign,
            view.name,
            float(shown[y, x].sum() / excess[y, x].sum()),
            float(shown[disk].sum() / excess[disk].sum()),
        )


def _own_pixels(feature: ThermalFeature, view: View, excess: Image) -> NDArray[np.bool_]:
    """`[h, w]`: where at least half of the feature's largest excess in the image is."""
    u, v = np.meshgrid([-1, 0, 1], [-1, 0, 1])
    a, b = np.array(feature.along) * (feature.length_m / 2 + feature.fwhm_m), feature.across * 1.5 * feature.fwhm_m
    corners = view.pixels(np.array(feature.position_m) + u.ravel()[:, None] * a + v.ravel()[:, None] * b)
    (left, top), (right, bottom) = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
    own = np.zeros(excess.shape, bool)
    part = (slice(max(top, 0), max(bottom, 0)), slice(max(left, 0), max(right, 0)))
    strength = feature.sign * excess[part]
    own[part] = strength >= 0.5 * strength.max()
    return own


def edge_widths(features: Sequence[ThermalFeature], view: View, image: Image) -> list[float]:
    """Pixels over which the four edges of each rectangle rise from 10 to 90 %, in an image of the view."""
    found = []
    shown = (image - view.without).astype(np.float64)
    for feature in features:
        if feature.kind != "rectangle" or view.name not in feature.views:
            continue
        centre, axes = np.array(feature.position_m), (np.array(feature.along), feature.across)
        half = (feature.length_m / 2, feature.fwhm_m / 2)
        pixel_m = feature.fwhm_m / feature.size_px
        offsets = np.linspace(-EDGE_PX, EDGE_PX, 101) * pixel_m
        for across in (0, 1):
            spread = np.linspace(-0.7, 0.7, 31) * half[1 - across]
            for side in (-1, 1):
                distance = side * (half[across] - offsets)  # from outside to inside
                points = centre + distance[:, None, None] * axes[across] + spread[None, :, None] * axes[1 - across]
                pixels = view.pixels(points)
                profile = ndimage.map_coordinates(shown, [pixels[..., 1] - 0.5, pixels[..., 0] - 0.5], order=1, mode="nearest")
                width = _rise(profile.mean(axis=1))
                found.append(width * 2 * EDGE_PX / (len(offsets) - 1))
    return found


def _rise(profile: NDArray[np.float64]) -> float:
    """Steps from 10 to 90 % of the rise between the two ends of a profile."""
    n = len(profile) // 10
    low, high = profile[:n].mean(), profile[-n:].mean()
    if abs(high - low) < 1e-6:
        return float(len(profile))
    rise = np.maximum.accumulate((profile - low) / (high - low))
    return float(np.searchsorted(rise, 0.9) - np.searchsorted(rise, 0.1))


def false_spots(render: Image, truth: Image, *, within_px: int = 0) -> int:
    """Blobs where the render is far off every temperature that the truth has within some pixels.

    With 2 px, edges that are slightly misplaced do not count, and what is erased or invented does.
    """
    width = 2 * within_px + 1
    beyond = np.maximum(render - ndimage.maximum_filter(truth, width), ndimage.minimum_filter(truth, width) - render)
    labels, count = ndimage.label(beyond >= FALSE_C, structure=np.ones((3, 3)))
    return int((np.bincount(labels.ravel(), minlength=count + 1)[1:] >= FALSE_PX).sum())


def shown_of_distractors(
    places: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]],
    view: View,
    visible: Mapping[str, NDArray[np.bool_]],
    with_distractor: Image,
    without_distractor: Image,
) -> tuple[float, float]:
    """(Σ shown · excess, Σ excess²) over the surface points that training photographs had a distractor in front of.

    Args:
        places: by training frame, world points `[P, 3]` and the distractor's excess there `[P]`.
        visible: by training frame, which of them the view sees.
        with_distractor, without_distractor: renders of models that were fitted to photographs with and without it.
    """
    shown, total = 0.0, 0.0
    for name, (points, excess) in places.items():
        pixels = np.floor(view.pixels(points[visible[name]])).astype(int)
        e = excess[visible[name]]
        difference = (with_distractor - without_distractor)[pixels[:, 1], pixels[:, 0]]
        shown, total = shown + float((difference * e).sum()), total + float((e * e).sum())
    return shown, total
