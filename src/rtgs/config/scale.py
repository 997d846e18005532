"""Settings of the metric scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges

PAPER_EPSILON = 1e-6
PAPER_LEVEL_WEIGHTS = (1.0, 0.5, 0.25)  # w_l = 0.5^l, level 0 the finest, as printed

SolverName = Literal["global", "adam"]
REFINABLE = ("rotation", "baseline-direction", "focal", "time-offset")


@dataclass(frozen=True)
class ScaleConfig:
    """How the scale is found: by a search over all scales, or by the paper's Adam.

    Raises:
        RtgsError: a number out of its range, a solver or a refinement that does not exist.
    """

    solver: SolverName = "global"
    """"global" scans all scales that the images can tell apart and refines by Gauss–Newton, in seconds; "adam" is the paper's."""
    init: Annotated[float | None, Range(above=0)] = None
    """Start of `sfm_per_metre`; None: the minimum of a scan of the loss over all scales that the images can tell apart."""
    steps: Annotated[int, Range(1, 10**7)] = 200
    """Adam steps."""
    learning_rate: Annotated[float, Range(above=0, most=10)] = 5e-3
    """Adam's learning rate, in ln s."""
    batch: Annotated[int | None, Range(1)] = None
    """Adam: frames per step, drawn at random; None: all."""
    level_weights: Annotated[tuple[float, ...], Range(above=0)] = PAPER_LEVEL_WEIGHTS
    """Pyramid weights, finest level first; one number gives the single-scale loss."""
    epsilon: Annotated[float | None, Range(above=0)] = None
    """ε of the normalised gradient, images in [0, 1]; None: measured at each level, and the paper's 1e-6 for Adam."""
    scan_samples: Annotated[int, Range(3, 10**5)] = 64
    """Adam: log-spaced scales in the scan."""
    half_width: Annotated[float, Range(above=0)] = 0.001
    """Global: frames are added until half the 95 % interval is narrower than this, in ln s, or all are used."""
    max_frames: Annotated[int, Range(1)] = 64
    """At most so many training frames are used, evenly spaced."""
    refine: tuple[str, ...] = ()
    """What of the calibration is refined with the scale: rotation, baseline-direction, focal, time-offset. Each is held by its standard
    deviation in rig.json, or by a default (docs/how-it-works/scale.md)."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Seed of the mini-batches and of the resamples of the frames."""

    def __post_init__(self) -> None:
        check_ranges(self, "scale")
        if self.solver not in get_args(SolverName):
            raise RtgsError(f"scale.solver is {self.solver!r}; it is {' or '.join(get_args(SolverName))}.")
        names = {name for part in self.refine for name in part.split(",")} - {""}  # "a,b" is as good as "a b"
        if unknown := sorted(names - set(REFINABLE)):
            raise RtgsError(f"scale.refine names {unknown[0]!r}; there are {', '.join(REFINABLE)}.")
        object.__setattr__(self, "refine", tuple(name for name in REFINABLE if name in names))
