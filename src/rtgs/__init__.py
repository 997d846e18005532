"""Metric-scale RGB–thermal Gaussian splatting."""

__version__ = "0.1.0"
