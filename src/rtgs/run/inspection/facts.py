"""What the user states for an inspection report, as a JSON file. What EN 13187 and IEC TS 62446-3 ask for, and no run knows."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from rtgs.base.errors import RtgsError
from rtgs.base.files import reason
from rtgs.base.json_records import read_record, write_json
from rtgs.config.ranges import Range, check_ranges


@dataclass(frozen=True)
class OrderFacts:
    """Who inspected what for whom. A text that is empty is not stated."""

    report_number: str = ""
    client: str = ""
    site: str = ""
    object: str = ""
    purpose: str = ""
    operator: str = ""
    operator_certificate: str = ""
    date: str = ""


@dataclass(frozen=True)
class CameraFacts:
    """The thermal camera, and what it was told. `emissivity` and the other numbers are compared with what the run computed with."""

    model: str = ""
    serial: str = ""
    lens: str = ""
    calibrated: str = ""
    accuracy: str = ""
    emissivity: Annotated[float | None, Range(above=0, most=1)] = None
    emissivity_source: str = ""
    reflected_c: Annotated[float | None, Range(above=-273.15)] = None
    distance_m: Annotated[float | None, Range(0)] = None


@dataclass(frozen=True)
class WeatherFacts:
    """Conditions. EN 13187 asks for temperatures, wind and pressure; IEC TS 62446-3 for irradiance, clouds and load."""

    outdoor_c: Annotated[float | None, Range(above=-273.15)] = None
    indoor_c: Annotated[float | None, Range(above=-273.15)] = None
    humidity_percent: Annotated[float | None, Range(0, 100)] = None
    wind_m_s: Annotated[float | None, Range(0)] = None
    pressure_difference_pa: Annotated[float | None, Range()] = None
    irradiance_w_m2: Annotated[float | None, Range(0)] = None
    clouds: str = ""
    precipitation: str = ""
    before: str = ""
    load: str = ""


@dataclass(frozen=True)
class SeverityClass:
    """A class of findings.

    Attributes:
        name: as it stands in the table.
        from_k: the smallest difference of temperature of the class, above 0; hot and cold spots alike.
        action: what follows from it.
    """

    name: str
    from_k: Annotated[float, Range(above=0)]
    action: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, "severity")


@dataclass(frozen=True)
class InspectionFacts:
    """The whole file.

    Attributes:
        reference: what the reference temperature of the list of spots is of, such as "air of the room".
        severity_of: which difference `severity` classifies.
        severity: the classes; without any, findings have no class.
    """

    order: OrderFacts = field(default_factory=OrderFacts)
    camera: CameraFacts = field(default_factory=CameraFacts)
    weather: WeatherFacts = field(default_factory=WeatherFacts)
    reference: str = ""
    severity_of: Literal["surroundings", "reference"] = "surroundings"
    severity: tuple[SeverityClass, ...] = ()
    remarks: str = ""

    def __post_init__(self) -> None:
        check_ranges(self.camera, "camera")
        check_ranges(self.weather, "weather")

    def class_of(self, difference: float) -> SeverityClass | None:
        """The highest class that a difference reaches; None below all of them."""
        reached = [c for c in self.severity if abs(difference) >= c.from_k]
        return max(reached, key=lambda c: c.from_k, default=None)


def read_facts(path: Path) -> InspectionFacts:
    """Raises `RtgsError`, which names file and field, where it cannot be read or a number is outside its range."""
    return read_record(
        InspectionFacts,
        path,
        missing="`rtgs report RUN --template inspection --write-facts FILE` writes an empty one.",
        remedy="Correct it; `--write-facts FILE` writes a file with all fields.",
    )


def write_empty_facts(path: Path) -> None:
    """Write a file with every field, all of them empty.

    Raises:
        RtgsError: there is a file already, or it cannot be written.
    """
    if path.exists():
        raise RtgsError(f"--write-facts {path}: the file exists, and what it holds is not overwritten. Name another one.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, InspectionFacts())
    except OSError as error:
        raise RtgsError(f"{path}: cannot be written: {reason(error)}") from error
