"""Metres, and a place on the Earth, from the positions in the photographs' tags."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.config.metres import MetresSourceName
from rtgs.maths.geometry import Sim3
from rtgs.maths.wgs84 import enu_from_places
from rtgs.metres.evidence import Evidence, Source
from rtgs.metres.similarity import LEAST, SimilarityFit, fit_similarity
from rtgs.records.georeference import AltitudeKind, Georeference
from rtgs.records.metres import MetresSource

WIDEST = 0.15
"""Standard deviation of ln s from which on positions do not count: noise as large as the way of the cameras makes the way longer."""

_UNSTATED_STD = (1.0, 1.0, 2.0)  # ratios to the east, north and up
_LINE = 0.05  # cameras whose width is a smaller share of their spread stand on a line, and any turn about it fits
_ALTITUDES: dict[AltitudeKind, str] = {
    "ellipsoid": "altitudes are above the ellipsoid",
    "sea level": "altitudes are above sea level, as the files say, and may be off by tens of metres alike",
    "unknown": "nothing says what altitudes are measured from, and they may be off by tens of metres alike",
}


@dataclass(frozen=True, eq=False)
class GpsFit:
    """Positions of the photographs and the similarity to them.

    Attributes:
        origin: `[3]`, latitude and longitude in degrees, altitude in metres.
        altitude: what altitudes are measured from.
        source: which tags.
        stated: whether all files state their accuracy.
        fit: metres east, north and up of the origin, from the given frame.
        centres: `[N, 3]`, the cameras in the given frame. positions: `[N, 3]`, what the tags say, in metres.
    """

    origin: NDArray[np.float64]
    altitude: AltitudeKind
    source: str
    stated: bool
    fit: SimilarityFit
    centres: NDArray[np.float64]
    positions: NDArray[np.float64]


def fit_gps(evidence: Evidence) -> GpsFit | str:
    """The similarity from the given frame to the Earth; or why there is none, empty where the photographs have no positions."""
    tags = {name: tags.position for name, tags in evidence.tags.items() if tags.position is not None}
    refused = [tags.position_refused for tags in evidence.tags.values() if tags.position_refused]
    if not tags:
        return f"{len(refused)} photographs have a position that is marked as invalid: {refused[0]}" if refused else ""
    known = {name: p for name, p in tags.items() if p.altitude_m is not None}
    if len(known) < LEAST:
        return f"{len(known)} photographs have a position with an altitude, and {LEAST} are needed"
    places = np.array([(p.latitude_deg, p.longitude_deg, p.altitude_m) for p in known.values()], dtype=np.float64)
    around = enu_from_places(places, places[0])
    origin = places[np.linalg.norm(around - np.median(around, axis=0), axis=1).argmin()]
    positions = enu_from_places(places, origin)
    stated = all(p.std_m is not None for p in known.values())
    std = np.array([p.std_m if stated and p.std_m is not None else _UNSTATED_STD for p in known.values()], dtype=np.float64)
    centres = np.stack([evidence.poses[name].translation for name in known])
    if float(np.ptp(positions, axis=0).max()) == 0.0:
        return "all positions are the same; the receiver stood still, or the tags were copied"
    fit = fit_similarity(centres, positions, std, stated=stated)
    if fit is None:
        return f"the {len(known)} positions do not agree with the cameras' way: fewer than half lie on one similarity"
    first = next(iter(known.values()))
    return GpsFit(origin, first.altitude, first.source, stated, fit, centres, positions)


class GpsSource:
    """Positions of the photographs."""

    name: MetresSourceName = "gps"

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        found = fit_gps(evidence)
        if isinstance(found, str):
            return found
        fit = found.fit
        if fit.std_log > WIDEST:
            return (
                f"the cameras are spread over {fit.spread:.2g} m, and the positions are off by {fit.noise[0]:.2g} m: too much to measure "
                "a length by"
            )
        left_out = int((~fit.inliers).sum())
        text = (
            f"{found.source} of {len(fit.inliers)} photographs, {left_out} of them left out as wrong; off by {fit.noise[0]:.2g} m "
            f"horizontally and {fit.noise[1]:.2g} m vertically, over cameras {fit.spread:.3g} m apart; the files state "
            f"{'their' if found.stated else 'no'} accuracy; {_ALTITUDES[found.altitude]}, which changes no length"
        )
        return [MetresSource(self.name, 1 / fit.to_from.factor, fit.std_log, text)]


def georeference(evidence: Evidence, sfm_per_metre: float) -> Georeference | str:
    """Where the scene is, at the scale that its metres have; or why that is not known."""
    found = fit_gps(evidence)
    if isinstance(found, str):
        return found
    fit = found.fit
    if fit.width < _LINE * fit.spread or fit.width < max(fit.noise):
        return "the cameras stand on a line, as far as their positions tell, so that the scene may be turned about it"
    middle = found.centres[fit.inliers].mean(axis=0)
    place = fit.to_from.apply(middle)
    enu_from_given = Sim3(1 / sfm_per_metre, fit.to_from.rotation, place - fit.to_from.rotation @ middle / sfm_per_metre)
    rows = [(float(x), float(y), float(z)) for x, y, z in enu_from_given.rotation]
    east, north, up = enu_from_given.translation.tolist()
    std_east, std_north, std_up = fit.std_place.tolist()
    latitude, longitude, altitude = found.origin.tolist()
    return Georeference(
        latitude_deg=latitude,
        longitude_deg=longitude,
        altitude_m=altitude,
        altitude=found.altitude,
        metres_per_sfm=enu_from_given.factor,
        rotation=(rows[0], rows[1], rows[2]),
        translation_m=(east, north, up),
        std_m=(std_east, std_north, std_up),
    )


SOURCE: Source = GpsSource()
