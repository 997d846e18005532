"""Calibration of a rig from pairs of pictures of a board."""

from rtgs.calibration.target import calibrate_target

__all__ = ["calibrate_target"]
