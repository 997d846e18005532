"""All sources of metres of a capture, together."""

from __future__ import annotations

from dataclasses import dataclass, replace

from rtgs.base.progress import Progress
from rtgs.config import MetresConfig
from rtgs.metres.combine import combine
from rtgs.metres.evidence import Evidence
from rtgs.metres.gps import georeference
from rtgs.metres.registry import SOURCES
from rtgs.records.georeference import Georeference
from rtgs.records.metres import Metres, MetresSource
from rtgs.records.scene import Scene
from rtgs.scale import ScaleEstimate


@dataclass(frozen=True)
class Found:
    """What the metres rest on, and the place on the Earth; None where the photographs do not tell it."""

    metres: Metres
    georeference: Georeference | None


def find_metres(
    scene: Scene,
    estimate: ScaleEstimate | None = None,
    config: MetresConfig | None = None,
    *,
    progress: Progress | None = None,
) -> Found:
    """Ask every source, and combine what they say.

    Args:
        scene: registered frames; its capture's files are read again.
        estimate: the scale from the images, a source where the length of the baseline is known; None: without it.
        config: which sources count.
        progress: called with (sources asked, sources in all, name).

    Raises:
        RtgsError: `metres.json` is damaged, or names a frame that the capture does not have; an image file cannot be read.
    """
    evidence = Evidence.of(scene, config or MetresConfig(), estimate)
    sources: list[MetresSource] = []
    absent: dict[str, str] = {}
    for done, source in enumerate(SOURCES):
        if progress is not None:
            progress(done, len(SOURCES), source.name)
        if source.name not in evidence.config.sources:
            continue
        found = source.find(evidence)
        if isinstance(found, list):
            sources += found
        elif found:
            absent[source.name] = found
    if progress is not None:
        progress(len(SOURCES), len(SOURCES), "metres")
    metres = combine(sources, absent)
    if "gps" not in evidence.config.sources or metres.sfm_per_metre is None:
        return Found(metres, None)
    place = georeference(evidence, metres.sfm_per_metre)
    if isinstance(place, Georeference):
        return Found(metres, place)
    reasons = {"georeference": place} if place and "gps" not in absent else {}
    return Found(replace(metres, absent={**absent, **reasons}), None)
