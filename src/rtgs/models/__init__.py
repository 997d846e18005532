"""What the fits give: Gaussian models with what it takes to render them."""

from rtgs.models.rgb import RgbModel
from rtgs.models.sensor import SensorModel
from rtgs.models.thermal import GaussianTemperatures, ThermalModel

__all__ = ["GaussianTemperatures", "RgbModel", "SensorModel", "ThermalModel"]
