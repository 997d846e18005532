"""The metric scale: objective, bracket and estimate."""

from rtgs.config import ScaleConfig
from rtgs.scale.estimate import History, ScaleEstimate, Scan, adam, estimate_scale
from rtgs.scale.objective import Objective

__all__ = ["History", "Objective", "ScaleConfig", "ScaleEstimate", "Scan", "adam", "estimate_scale"]
