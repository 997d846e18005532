"""What the evaluation of held-out views finds: the content of `metrics.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.base.json_records import read_record, to_json, write_json


@dataclass(frozen=True)
class Scores:
    """Scores of one render against its photograph, or the mean scores of several. A score that was not computed is None.

    Attributes:
        psnr: dB. ssim, lpips: without unit.
        mae_c: mean absolute temperature error in °C, of a radiometric capture.
        mae_counts: the same in counts, of a relative capture.
        peak_c, peak_p90_c: mean and 90th percentile of the error at the photograph's strongest small extremes (`rtgs.metrics.peaks`).
            None where the photograph has no such extreme. peak_counts, peak_p90_counts: the same in counts.
    """

    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    mae_c: float | None = None
    mae_counts: float | None = None
    peak_c: float | None = None
    peak_p90_c: float | None = None
    peak_counts: float | None = None
    peak_p90_counts: float | None = None

    def known(self) -> dict[str, float]:
        """Name → value of the scores that were computed, in the order of the fields."""
        values = {f.name: getattr(self, f.name) for f in fields(Scores)}
        return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True)
class ModelScores(Scores):
    """Mean scores of one model over the held-out frames, and those of each frame by its name."""

    per_frame: Mapping[str, Scores] = field(default_factory=dict)

    @staticmethod
    def of(per_frame: Mapping[str, Scores]) -> ModelScores:
        """From the frames' scores. The mean of a score is None where a frame lacks it, or where there is no frame.

        A frame may have no peak. Peak errors are means over the others.
        """
        return ModelScores(**mean_scores([scores.known() for scores in per_frame.values()]), per_frame=dict(per_frame))


def mean_scores(frames: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Means of the scores that every frame has, and of peak errors over the frames that have a peak."""
    names = list(dict.fromkeys(name for known in frames for name in known))
    names = [name for name in names if name.startswith("peak_") or all(name in known for known in frames)]
    return {name: float(np.mean([known[name] for known in frames if name in known])) for name in names}


@dataclass(frozen=True)
class Evaluation:
    """Scores of a run's models on held-out views.

    Attributes:
        rgb, thermal: the models'. Without held-out frames they hold no score.
        thermal_naive: the control, a thermal model fitted at `sfm_per_metre` = 1; None where it was not scored.
        temperature_range_c: the range, °C, that thermal PSNR, SSIM and LPIPS refer to; None for a relative capture.
        count_range: the same in counts; None for a radiometric capture.
        notes: sentences on scores that could not be computed.
        timings_s: stage → seconds, of the run that the models come from.
    """

    rgb: ModelScores
    thermal: ModelScores
    thermal_naive: ModelScores | None = None
    temperature_range_c: tuple[float, float] | None = None
    count_range: tuple[float, float] | None = None
    notes: Sequence[str] = ()
    timings_s: Mapping[str, float] = field(default_factory=dict)

    @property
    def models(self) -> dict[str, ModelScores]:
        """ "rgb", "thermal" and, where it was scored, "thermal_naive"."""
        found = {"rgb": self.rgb, "thermal": self.thermal, "thermal_naive": self.thermal_naive}
        return {name: scores for name, scores in found.items() if scores is not None}

    @property
    def thermal_range(self) -> tuple[float, float] | None:
        """`temperature_range_c`, or `count_range` of a relative capture."""
        return self.temperature_range_c or self.count_range

    def write(self, path: Path) -> None:
        """Write `metrics.json`, whole or not at all. Scores that are None, and empty notes and timings, are left out."""
        data = _without_none(to_json(self))
        write_json(path, {name: value for name, value in data.items() if value or name not in ("notes", "timings_s")})

    @staticmethod
    def read(path: Path) -> Evaluation:
        """Read what `write` wrote.

        Raises:
            RtgsError: the file is missing, unreadable or of another version.
        """
        return read_record(Evaluation, path)


def _without_none(data: Any) -> Any:
    if isinstance(data, dict):
        return {name: _without_none(value) for name, value in data.items() if value is not None}
    return data
