"""Stage: the metric scale: objective, bracket, solvers, interval."""

from rtgs.scale.estimate import estimate_scale
from rtgs.scale.objective import Objective
from rtgs.scale.records import History, Minimum, ScaleEstimate, Scan
from rtgs.scale.search import Comparison

__all__ = ["Comparison", "History", "Minimum", "Objective", "ScaleEstimate", "Scan", "estimate_scale"]
