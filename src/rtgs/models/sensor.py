"""What a thermal sensor makes of the scene: the drift of each photograph, and the pattern that all photographs share.

photograph_f = gain_f · image_f + offset_f + pattern
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Drift and pattern of a thermal camera, as found in a capture. The default is a perfect sensor.

    All values are in °C (or counts), or in a black body's signal where the thermal colours are linear in that signal.

    Attributes:
        drift: gain and offset of each training frame, by name; empty where no drift was fitted.
        pattern: `[h, w]`, what the sensor adds to every photograph; None where no pattern was found.
    """

    drift: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pattern: NDArray[np.float32] | None = None

    def drift_of(self, frame: str, level: float) -> tuple[float, float]:
        """Gain and offset of a frame.

        A training frame has its own. For any other frame they are predicted from the training frames before and after it in the
        order of names (`predicted_drift`).

        Args:
            level: a typical value of the scene, at which drifts are compared.
        """
        if frame in self.drift or not self.drift:
            return self.drift.get(frame, (1.0, 0.0))
        names = sorted(self.drift)
        away = np.array([self.drift[name] for name in names]) - (1.0, 0.0)
        gain, offset = predicted_drift(away, away @ (level, 1.0), bisect(names, frame))
        return 1.0 + float(gain), float(offset)

    def changes(self, frame: str, level: float) -> bool:
        """Whether a photograph of this frame differs from the image of the scene at all."""
        return self.pattern is not None or self.drift_of(frame, level) != (1.0, 0.0)

    def shown(self, image: NDArray[np.floating], frame: str, level: float) -> NDArray[np.float64]:
        """`[h, w]`: the photograph that the sensor makes of an image `[h, w]` of the scene in a frame.

        Raises:
            RtgsError: the pattern is of another size than the image.
        """
        gain, offset = self.drift_of(frame, level)
        photograph = gain * image.astype(np.float64) + offset
        if self.pattern is None:
            return photograph
        if self.pattern.shape != photograph.shape:
            (height, width), (rows, columns) = self.pattern.shape, photograph.shape
            raise RtgsError(
                f"the thermal model's pattern has {width}×{height} pixels, and its camera {columns}×{rows}. It belongs to another camera: "
                "remove thermal.json of the run, and run again."
            )
        return np.asarray(photograph + self.pattern)


def predicted_drift(drift: NDArray[np.float64], levels: NDArray[np.float64], at: int) -> NDArray[np.float64]:
    """Expected drift of a frame that was not fitted: the mean of its two neighbours' drifts times how far neighbours agree at all.

    Neighbours agree as far as their levels are correlated from frame to frame. The correlation is close to 1 for a sensor that drifts
    slowly, and close to 0 for offsets that are independent.

    Args:
        drift: `[F, K]`, deviations from no drift, in the order of the frames.
        levels: `[F]`, what the drift adds to a typical value of the scene.
        at: how many of the F frames come before the frame.

    Returns:
        `[K]`.
    """
    away = levels - levels.mean()
    correlation = float(away[1:] @ away[:-1]) / max(float(away @ away), 1e-30)
    return np.asarray(max(0.0, correlation) * drift[max(at - 1, 0) : at + 1].mean(axis=0))
