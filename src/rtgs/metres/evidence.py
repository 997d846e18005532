"""What the sources of metres are given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.config import MetresConfig
from rtgs.config.metres import MetresSourceName
from rtgs.io.image_files import list_images
from rtgs.io.metres_file import MetresFile, read_metres_file
from rtgs.io.photograph_tags import PhotographTags, read_photograph_tags
from rtgs.maths.geometry import SE3
from rtgs.records.capture import SparsePoints
from rtgs.records.metres import MetresSource
from rtgs.records.scene import Scene
from rtgs.scale import ScaleEstimate

_READING_PX = 0.5  # of a camera's position, in the image of a point at the usual distance


@dataclass(frozen=True, eq=False)
class Evidence:
    """A registered capture, and what was found about it.

    Attributes:
        scene: in the given frame, in SfM units.
        config: which sources count.
        file: `metres.json`.
        estimate: the scale from the images; None where it has not been found.
    """

    scene: Scene
    config: MetresConfig = field(default_factory=MetresConfig)
    file: MetresFile = field(default_factory=MetresFile)
    estimate: ScaleEstimate | None = None

    @staticmethod
    def of(scene: Scene, config: MetresConfig, estimate: ScaleEstimate | None) -> Evidence:
        """Reads `metres.json`.

        Raises:
            RtgsError: the file is damaged, or it or the settings name a frame that the capture does not have.
        """
        file = read_metres_file(scene.capture.root)
        named = [name for d in file.camera_distances for name in d.frames]
        named += [name for d in file.point_distances for name in (*d.first, *d.second)]
        there = {frame.name for frame in scene.capture.frames}
        for where, names in (("metres.json", named), ("metres.distance", [n for d in config.distances for n in d[:2]])):
            if unknown := sorted(set(names) - there):
                raise RtgsError(f"{scene.capture.root}: {where} names the frame {unknown[0]!r:.100}, and the capture has none.")
        return Evidence(scene.as_given(), config, file, estimate)

    @cached_property
    def files(self) -> Mapping[str, Path]:
        """The RGB file of each registered frame."""
        files = list_images(self.scene.capture.root / "rgb")
        return {name: files[name] for name in self.poses if name in files}

    @cached_property
    def tags(self) -> Mapping[str, PhotographTags]:
        """The tags of the registered frames' RGB files."""
        return {name: read_photograph_tags(path) for name, path in self.files.items()}

    @property
    def poses(self) -> Mapping[str, SE3]:
        """`given_from_rgb` by frame."""
        return self.scene.world_from_rgb

    @property
    def points(self) -> SparsePoints:
        """Sparse points in the given frame."""
        return self.scene.points

    @cached_property
    def usual_depth(self) -> float | None:
        """Median depth of the sparse points in front of the cameras, in SfM units; None without points."""
        depths = []
        for pose in list(self.poses.values())[:: max(1, len(self.poses) // 10)]:
            z = pose.inverse().apply(self.points.xyz)[:, 2]
            depths.append(z[z > 0])
        together: NDArray[np.float64] = np.concatenate(depths)
        return float(np.median(together)) if len(together) else None

    @property
    def position_std(self) -> float:
        """Standard deviation of a camera's position from structure from motion, about, in SfM units."""
        return 0.0 if self.usual_depth is None else _READING_PX / self.scene.rig.rgb.fl_x * self.usual_depth


class Source(Protocol):
    """One way to know metres.

    To add one, write a module with an object of this protocol, and list it in `rtgs.metres.registry`.
    """

    @property
    def name(self) -> MetresSourceName:
        """In settings and results."""
        ...

    def find(self, evidence: Evidence) -> list[MetresSource] | str:
        """The estimates; or, in words, why there is none. Empty where nobody would expect one."""
        ...
