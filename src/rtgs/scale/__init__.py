"""The metric scale: objective, bracket and estimate."""

from rtgs.scale.estimate import History, Scan, ScaleConfig, ScaleEstimate, adam, estimate_scale
from rtgs.scale.objective import Objective

__all__ = ["History", "Objective", "Scan", "ScaleConfig", "ScaleEstimate", "adam", "estimate_scale"]
