"""What all frames of an import have in common, gathered before anything is written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.protocol import Shot, VisiblePicture
from rtgs.records.radiometry import CelsiusRadiometry, PlanckRadiometry


@dataclass(frozen=True, eq=False)
class Pair:
    """One frame of an import, in memory.

    Attributes:
        name: of the frame. source: the radiometric file.
        shot, visible: what the file says, and the visible picture that goes with it.
        rgb_size: width and height of `visible`.
    """

    name: str
    source: Path
    shot: Shot
    visible: VisiblePicture
    rgb_size: tuple[int, int]

    @property
    def thermal_size(self) -> tuple[int, int]:
        """Width and height."""
        height, width = self.shot.counts.shape
        return width, height


@dataclass(frozen=True, eq=False)
class Facts:
    """What is common to all frames.

    Attributes:
        first: the first radiometric file, which the other attributes are taken from.
        radiometry: of the capture.
        thermal_size, rgb_size: width and height.
        thermal_focal_px: nominal, None when the file does not say.
        visible: with what is known of the RGB camera.
        differing: how many frames have another calibration or other object parameters.
    """

    first: Path
    radiometry: CelsiusRadiometry
    thermal_size: tuple[int, int]
    rgb_size: tuple[int, int]
    thermal_focal_px: float | None
    visible: VisiblePicture
    differing: int = 0


def common_facts(pairs: Iterable[Pair]) -> Facts:
    """The facts of one pair or more.

    Raises:
        RtgsError: images of several sizes, files by several kinds of cameras, or two frames of one name.
    """
    facts: Facts | None = None
    differing = 0
    names: dict[str, Path] = {}
    for pair in pairs:
        sizes, radiometry = (pair.thermal_size, pair.rgb_size), pair.shot.radiometry
        if facts is None:
            facts = Facts(pair.source, radiometry, *sizes, pair.shot.thermal_focal_px, pair.visible)
        for what, here, there in zip(("thermal", "visible"), sizes, (facts.thermal_size, facts.rgb_size), strict=True):
            if here != there:
                raise RtgsError(
                    f"{pair.source}: its {what} image is {here[0]}×{here[1]}, and {there[0]}×{there[1]} in {facts.first.name}. "
                    "A capture is by one pair of cameras held one way: import the others on their own."
                )
        if isinstance(radiometry, PlanckRadiometry) != isinstance(facts.radiometry, PlanckRadiometry):
            raise RtgsError(f"{pair.source}: is by another kind of camera than {facts.first.name}. Import each on its own.")
        if pair.name in names:
            raise RtgsError(f"{pair.source}: would have the same name as {names[pair.name].name} in the capture. Rename one.")
        names[pair.name] = pair.source
        differing += radiometry != facts.radiometry
    assert facts is not None  # the folder has frames
    return replace(facts, differing=differing)
