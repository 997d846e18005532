"""The metric scale: objective, bracket and estimate."""

from rtgs.scale.estimate import History, ScaleConfig, ScaleEstimate, Scan, adam, estimate_scale
from rtgs.scale.objective import Objective

__all__ = ["History", "Objective", "ScaleConfig", "ScaleEstimate", "Scan", "adam", "estimate_scale"]
