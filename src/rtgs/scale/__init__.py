"""Stage: the metric scale. bracket → solve → interval → verdict → optional joint refinement."""

from rtgs.scale.comparison import Comparison
from rtgs.scale.estimate import estimate_scale
from rtgs.scale.objective import Objective
from rtgs.scale.records import History, Minimum, ScaleEstimate, Scan

__all__ = ["Comparison", "History", "Minimum", "Objective", "ScaleEstimate", "Scan", "estimate_scale"]
