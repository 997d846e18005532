"""Stage: the thermal model. coverage → drift → pattern → gains → ridge → geometry → fit on all frames."""

from rtgs.thermal.certainty import gaussian_temperatures
from rtgs.thermal.frames import training_range
from rtgs.thermal.spots import find_spots
from rtgs.thermal.stage import fit_thermal

__all__ = ["find_spots", "fit_thermal", "gaussian_temperatures", "training_range"]
