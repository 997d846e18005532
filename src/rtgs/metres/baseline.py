"""Metres from the length of the rig's baseline, by the edges that RGB and thermal images share."""

from __future__ import annotations

from rtgs.config.metres import MetresSourceName
from rtgs.metres.evidence import Evidence, Source
from rtgs.records.metres import MetresSource

_LEAST_STD = 1e-9  # a source without any doubt would make others worthless


class BaselineSource:
    """The scale that the images show, given the baseline's length."""

    name: MetresSourceName = "baseline"

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        estimate, rig = evidence.estimate, evidence.scene.rig
        if estimate is None:
            return ""
        if estimate.status != "ok":
            if estimate.calibration is not None:
                return estimate.reason.rstrip(".")
            return f"the images do not show the scale: {estimate.reason}"
        assert estimate.baseline_m is not None  # without a length the status is another one
        if estimate.std_log is None:
            return "a single frame gives no standard deviation"
        length_std = rig.calibration_std.baseline_length if rig.calibration_std else 0.0
        said = (
            f"known to {100 * length_std:.2g} %"
            if length_std
            else "taken as exact, since rig.json states no uncertainty.baseline_length"
        )
        text = (
            f"edges of {len(estimate.frames)} thermal images, and the length of the baseline, {estimate.baseline_m:.4g} m, {said}"
        )
        return [MetresSource(self.name, estimate.sfm_per_metre, max(estimate.std_log, _LEAST_STD), text)]


SOURCE: Source = BaselineSource()
