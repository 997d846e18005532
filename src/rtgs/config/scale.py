"""Settings of the metric scale."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from rtgs.base.errors import RtgsError

PAPER_EPSILON = 1e-6
PAPER_LEVEL_WEIGHTS = (1.0, 0.5, 0.25)  # w_l = 0.5^l, level 0 the finest, as printed

SolverName = Literal["global", "adam"]
REFINABLE = ("rotation", "baseline-direction", "focal", "time-offset")


@dataclass(frozen=True)
class ScaleConfig:
    """How the scale is found: by a search over all scales, or by the paper's Adam.

    Raises:
        RtgsError: a start or a batch that is no positive number, a solver or a refinement that does not exist.
    """

    solver: SolverName = "global"
    """"global" scans all scales that the images can tell apart and refines by Gauss–Newton, in seconds; "adam" is the paper's."""
    init: float | None = None
    """Start of `sfm_per_metre`; None: the minimum of a scan of the loss over all scales that the images can tell apart."""
    steps: int = 200
    """Adam steps."""
    learning_rate: float = 5e-3
    """Adam's learning rate, in ln s."""
    batch: int | None = None
    """Adam: frames per step, drawn at random; None: all."""
    level_weights: tuple[float, ...] = PAPER_LEVEL_WEIGHTS
    """Pyramid weights, finest level first; one number gives the single-scale loss."""
    epsilon: float | None = None
    """ε of the normalised gradient, images in [0, 1]; None: measured at each level, and the paper's 1e-6 for Adam."""
    scan_samples: int = 64
    """Adam: log-spaced scales in the scan."""
    half_width: float = 0.001
    """Global: frames are added until half the 95 % interval is narrower than this, in ln s, or all are used."""
    max_frames: int = 64
    """At most so many training frames are used, evenly spaced."""
    refine: tuple[str, ...] = ()
    """What of the calibration is refined with the scale: rotation, baseline-direction, focal, time-offset. Each is held by its standard
    deviation in rig.json, or by a default (docs/how-it-works/scale.md)."""
    seed: int = 0
    """Seed of the mini-batches and of the resamples of the frames."""

    def __post_init__(self) -> None:
        if self.init is not None and not (self.init > 0 and math.isfinite(self.init)):
            raise RtgsError(f"scale: init is {self.init}; sfm_per_metre is a positive number.")
        if self.batch is not None and self.batch < 1:
            raise RtgsError(f"scale: batch is {self.batch}; it is a number of frames, or left out for all of them.")
        if self.solver not in get_args(SolverName):
            raise RtgsError(f"scale.solver is {self.solver!r}; it is {' or '.join(get_args(SolverName))}.")
        names = {name for part in self.refine for name in part.split(",")} - {""}  # "a,b" is as good as "a b"
        if unknown := sorted(names - set(REFINABLE)):
            raise RtgsError(f"scale.refine names {unknown[0]!r}; there are {', '.join(REFINABLE)}.")
        object.__setattr__(self, "refine", tuple(name for name in REFINABLE if name in names))
