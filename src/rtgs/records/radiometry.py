"""What a thermal camera's counts mean: relative intensity, a linear scale of °C, or FLIR's signal model with its object parameters.

All three have `unit` and `suffix`, and `values`, which takes counts to that unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError

ZERO_CELSIUS_K = 273.15
Unit: TypeAlias = Literal["°C", "counts"]
Suffix: TypeAlias = Literal["c", "counts"]


@dataclass(frozen=True)
class RelativeCounts:
    """Counts that nothing turns into temperatures.

    Attributes:
        unit: of thermal images, for people.
        suffix: how names of quantities in that unit end, such as the metric `mae_counts`.
    """

    unit: ClassVar[Unit] = "counts"
    suffix: ClassVar[Suffix] = "counts"

    def values(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """The counts themselves, any shape."""
        return counts.astype(np.float32)


@dataclass(frozen=True)
class CountsToCelsius:
    """A sensor's linear scale: `temperature_c = count · celsius_per_count + celsius_offset`."""

    unit: ClassVar[Unit] = "°C"
    suffix: ClassVar[Suffix] = "c"
    celsius_per_count: float
    celsius_offset: float

    def celsius(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """°C of counts of any shape; computed in float64, since 16-bit counts times 0.01 lose digits in float32."""
        return (counts.astype(np.float64) * self.celsius_per_count + self.celsius_offset).astype(np.float32)

    def values(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """`celsius`, under the name that all radiometries share."""
        return self.celsius(counts)

    def counts(self, temperature_c: NDArray[np.floating]) -> NDArray[np.float64]:
        """The inverse, not rounded."""
        return (temperature_c.astype(np.float64) - self.celsius_offset) / self.celsius_per_count


CENTIKELVIN = CountsToCelsius(celsius_per_count=0.01, celsius_offset=-ZERO_CELSIUS_K)
CELSIUS = CountsToCelsius(celsius_per_count=1.0, celsius_offset=0.0)  # of files that hold °C


@dataclass(frozen=True)
class Atmosphere:
    """FLIR's transmission of air for a long-wave camera; the defaults are what FLIR writes into its files.

    FLIR's published formula (Minkina and Dudzik, *Infrared Thermography: Errors and Uncertainties*, 2009, ch. 2):

        τ(d) = X · exp(−√d (α₁ + β₁ √ω)) + (1 − X) · exp(−√d (α₂ + β₂ √ω))
        ω = humidity · exp(1.5587 + 0.06939 t − 2.7816e-4 t² + 6.8455e-7 t³)     g of water per m³ of air at t °C
    """

    alpha1: float = 0.006569
    alpha2: float = 0.01262
    beta1: float = -0.002276
    beta2: float = -0.00667
    x: float = 1.9

    def transmission(self, distance_m: float, temperature_c: float, relative_humidity: float) -> float:
        """τ over `distance_m` of air; `relative_humidity` is a fraction of 1."""
        t = temperature_c
        water = relative_humidity * math.exp(1.5587 + 0.06939 * t - 2.7816e-4 * t**2 + 6.8455e-7 * t**3)
        root_d, root_water = math.sqrt(distance_m), math.sqrt(water)
        return self.x * math.exp(-root_d * (self.alpha1 + self.beta1 * root_water)) + (1 - self.x) * math.exp(
            -root_d * (self.alpha2 + self.beta2 * root_water)
        )


@dataclass(frozen=True)
class PlanckCalibration:
    """What signal a black body gives, by FLIR's five constants: `U(T) = R1 / (R2 · (exp(B / T) − F)) − O`, T in kelvin.

    U is in counts and linear in the radiance of the camera's band (FLIR, *The measurement formula*; ExifTool's FLIR tags name the
    constants). `atmosphere` belongs to the same band.

    Raises:
        RtgsError: R1, R2, B or F isn't above 0, or one of the five isn't finite.
    """

    r1: float
    r2: float
    b: float
    f: float
    o: float
    atmosphere: Atmosphere = field(default_factory=Atmosphere)

    def __post_init__(self) -> None:
        for name in ("r1", "r2", "b", "f"):
            if not 0 < getattr(self, name) < math.inf:
                raise RtgsError(f"planck.{name} is {getattr(self, name):g}; a Planck constant is a finite number above 0.")
        if not math.isfinite(self.o):
            raise RtgsError(f"planck.o is {self.o:g}; a finite number of counts is expected.")

    def blackbody_signal(self, temperature_c: NDArray[np.floating] | float) -> NDArray[np.float64]:
        """U of a black body at a temperature, any shape, not rounded; −O at absolute zero."""
        kelvin = np.asarray(temperature_c, dtype=np.float64) + ZERO_CELSIUS_K
        with np.errstate(over="ignore", divide="ignore"):
            return np.asarray(self.r1 / (self.r2 * (np.exp(self.b / np.maximum(kelvin, 0.0)) - self.f)) - self.o)

    def blackbody_celsius(self, signal: NDArray[np.generic] | float) -> NDArray[np.float64]:
        """The inverse of `blackbody_signal`. A signal of −O or less is below that of any temperature and gives −273.15 °C."""
        above_zero = self.r2 * (np.asarray(signal).astype(np.float64) + self.o)
        with np.errstate(over="ignore", divide="ignore"):
            kelvin = self.b / np.log(self.r1 / np.maximum(above_zero, 0.0) + self.f)
        return np.asarray(kelvin - ZERO_CELSIUS_K)


@dataclass(frozen=True)
class ObjectParameters:
    """FLIR's object parameters: what the camera was told about the object, the air and a window in between.

    Attributes:
        emissivity: of the object, above 0 and at most 1.
        reflected_c: apparent temperature of what the object reflects.
        atmospheric_c, relative_humidity: of the air, the humidity as a fraction of 1.
        distance_m: from object to camera.
        window_c, window_transmission: of an infrared window or external optics; transmission 1 is no window.

    Raises:
        RtgsError: a value outside these limits.
    """

    emissivity: float = 1.0
    reflected_c: float = 20.0
    atmospheric_c: float = 20.0
    distance_m: float = 0.0
    relative_humidity: float = 0.5
    window_c: float = 20.0
    window_transmission: float = 1.0

    def __post_init__(self) -> None:
        for name in ("emissivity", "window_transmission"):
            if not 0 < getattr(self, name) <= 1:
                raise RtgsError(f"object.{name} is {getattr(self, name):g}; it is above 0 and at most 1.")
        if not 0 <= self.relative_humidity <= 1:
            raise RtgsError(
                f"object.relative_humidity is {self.relative_humidity:g}; it is a fraction from 0 to 1, not per cent."
            )
        if not 0 <= self.distance_m < math.inf:
            raise RtgsError(f"object.distance_m is {self.distance_m:g}; it is a number of metres, 0 or more.")
        for name in ("reflected_c", "atmospheric_c", "window_c"):
            if not -ZERO_CELSIUS_K < getattr(self, name) < math.inf:
                raise RtgsError(f"object.{name} is {getattr(self, name):g}; it is in °C, above −273.15.")


@dataclass(frozen=True)
class PlanckRadiometry:
    """A radiometric camera: sensor signal ↔ temperature of the object, by FLIR's measurement formula.

        S = ε τ₁ w τ₂ · U(T_object) + (1 − ε) τ₁ w τ₂ · U(T_reflected)
            + (1 − τ₁) w τ₂ · U(T_air) + (1 − w) τ₂ · U(T_window) + (1 − τ₂) · U(T_air)

    S is the stored count, U the `calibration`, w the window's transmission and τ₁ = τ₂ the air's over half the distance: the window
    stands midway, as in Thermimage (Tattersall, 2017) and in flyr; FLIR's manuals have one τ for the whole way. S is affine in the
    object's radiance, so signals may be averaged and composited where temperatures may not.

    Raises:
        RtgsError: air so long, hot and humid that FLIR's formula for its transmission leaves 0 … 1.
    """

    unit: ClassVar[Unit] = "°C"
    suffix: ClassVar[Suffix] = "c"
    calibration: PlanckCalibration
    parameters: ObjectParameters

    def __post_init__(self) -> None:
        if not 0 < self._leg_transmission <= 1:
            p = self.parameters
            raise RtgsError(
                f"object.distance_m {p.distance_m:g}, atmospheric_c {p.atmospheric_c:g} and relative_humidity "
                f"{p.relative_humidity:g} lie outside of where FLIR's formula for the transmission of air holds."
            )

    @cached_property
    def _leg_transmission(self) -> float:
        """τ₁ = τ₂."""
        p = self.parameters
        try:
            return self.calibration.atmosphere.transmission(p.distance_m / 2, p.atmospheric_c, p.relative_humidity)
        except OverflowError:
            return math.inf

    @cached_property
    def _gain_offset(self) -> tuple[float, float]:
        """`S = gain · U(T_object) + offset`."""
        p, u = self.parameters, self.calibration.blackbody_signal
        leg = self._leg_transmission
        window = p.window_transmission
        path = leg * window * leg
        air = ((1 - leg) * window * leg + (1 - leg)) * u(p.atmospheric_c)
        offset = (1 - p.emissivity) * path * u(p.reflected_c) + air + (1 - window) * leg * u(p.window_c)
        return p.emissivity * path, float(offset)

    def celsius(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """Temperature of the object, any shape. It is −273.15 °C where the signal is less than what the way to the object gives."""
        gain, offset = self._gain_offset
        return self.calibration.blackbody_celsius((counts.astype(np.float64) - offset) / gain).astype(np.float32)

    def values(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """`celsius`, under the name that all radiometries share."""
        return self.celsius(counts)

    def counts(self, temperature_c: NDArray[np.floating]) -> NDArray[np.float64]:
        """The inverse, not rounded."""
        gain, offset = self._gain_offset
        return gain * self.calibration.blackbody_signal(temperature_c) + offset

    def reevaluated(self, temperature_c: NDArray[np.floating], **parameters: float) -> NDArray[np.float32]:
        """What an image in °C becomes under other object parameters: back to the signal, and from there with the new ones.

        Args:
            temperature_c: any shape, computed with this object's parameters; a photograph or a render.
            parameters: fields of `ObjectParameters` to change, such as `emissivity=0.9, reflected_c=-10.0`.

        Raises:
            RtgsError: a parameter outside its limits.
        """
        return replace(self, parameters=replace(self.parameters, **parameters)).celsius(self.counts(temperature_c))


CelsiusRadiometry: TypeAlias = CountsToCelsius | PlanckRadiometry
Radiometry: TypeAlias = CelsiusRadiometry | RelativeCounts


@dataclass(frozen=True)
class LinearRange:
    """A stored linear normalisation: `lo` is 0, `hi` is 1; nothing is clipped.

    Thermal colours, and thermal PSNR and SSIM, are in these units; `lo` and `hi` are °C (or counts, for a relative capture).
    """

    lo: float
    hi: float

    @property
    def width(self) -> float:
        """`hi − lo`."""
        return self.hi - self.lo

    def normalise(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """°C (or counts) of any shape to units of the range."""
        return ((values.astype(np.float64) - self.lo) / (self.hi - self.lo)).astype(np.float32)

    def expand(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Units of the range to °C (or counts): the inverse of `normalise`."""
        return (values.astype(np.float64) * (self.hi - self.lo) + self.lo).astype(np.float32)

    @property
    def linear(self) -> LinearRange:
        """The same range in the quantity that adds up where images mix: here, the values themselves."""
        return self


@dataclass(frozen=True)
class PlanckRange:
    """A normalisation that is linear in radiance and not in °C: 0 and 1 stand for two signals of a black body.

    Radiance adds up where a pixel mixes several surfaces, and temperature does not. The sensor's own signal is affine in these units,
    with the same two numbers for all pixels (`PlanckRadiometry`), so images composited in these units are right for the sensor too.
    The functions are those of `LinearRange`, from °C and to °C.
    """

    calibration: PlanckCalibration
    lo_signal: float
    hi_signal: float

    @staticmethod
    def of(calibration: PlanckCalibration, span: LinearRange) -> PlanckRange:
        """The range whose 0 is the signal at `span.lo` °C, and whose 1 is that at `span.hi` °C."""
        lo, hi = (float(calibration.blackbody_signal(t)) for t in (span.lo, span.hi))
        return PlanckRange(calibration, lo, hi)

    @property
    def lo(self) -> float:
        """What 0 stands for, in °C; −273.15 where no temperature gives so small a signal."""
        return float(self.calibration.blackbody_celsius(self.lo_signal))

    @property
    def hi(self) -> float:
        """What 1 stands for, in °C."""
        return float(self.calibration.blackbody_celsius(self.hi_signal))

    @property
    def linear(self) -> LinearRange:
        """The same range in the signals, which add up where images mix."""
        return LinearRange(self.lo_signal, self.hi_signal)

    def normalise(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """°C of any shape to units of the range."""
        return self.linear.normalise(self.calibration.blackbody_signal(values))

    def expand(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Units of the range to °C: the inverse of `normalise`."""
        signal = values.astype(np.float64) * (self.hi_signal - self.lo_signal) + self.lo_signal
        return self.calibration.blackbody_celsius(signal).astype(np.float32)


ThermalRange: TypeAlias = LinearRange | PlanckRange


def extended(span: ThermalRange, floor: float) -> ThermalRange:
    """The range whose 0 is at `floor` of this one; its 1 stays."""
    if isinstance(span, PlanckRange):
        return replace(span, lo_signal=span.lo_signal + floor * (span.hi_signal - span.lo_signal))
    return replace(span, lo=span.lo + floor * span.width)
