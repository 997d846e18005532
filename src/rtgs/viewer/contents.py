"""What a run has to show so far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_record
from rtgs.maths.geometry import Sim3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.metres import LengthUnit
from rtgs.records.scene import Scene
from rtgs.records.spots import SpotList
from rtgs.renderer import RenderSettings
from rtgs.run.folder import RunFolder
from rtgs.scale import ScaleEstimate

T = TypeVar("T")
Mark = tuple[tuple[str, int, int], ...]

PARTS = {
    "scene": ("config.json", "scene/world.json", "scene/images.bin", "scale.json"),
    "rgb": ("rgb.json", "rgb.ply", "rgb.checkpoint", "scene/world.json"),
    "thermal": ("thermal.json", "thermal.ply", "scene/world.json"),
    "scale": ("scale.json",),
}
"""The files of a run that each part is read from."""


@dataclass(frozen=True, eq=False)
class Contents:
    """What a run has to show.

    Attributes:
        run: the run folder.
        scene, rgb, thermal, scale, spots: None where there is none yet, or none that can be read.
        growing: the RGB model is that of a training that goes on.
        given_from_world: from the world of the models to the frame that SfM or the capture's poses gave.
        messages: what is missing and why, for people.
        marks: part → name, time and size of its files when they were read.
    """

    run: Path
    scene: Scene | None = None
    rgb: RgbModel | None = None
    thermal: ThermalModel | None = None
    scale: ScaleEstimate | None = None
    spots: SpotList | None = None
    growing: bool = False
    given_from_world: Sim3 = field(default_factory=Sim3.identity)
    messages: dict[str, str] = field(default_factory=dict)
    marks: dict[str, Mark] = field(default_factory=dict)

    @property
    def metric(self) -> bool:
        """Whether lengths are known in metres."""
        return self.length_unit == "m"

    @property
    def length_unit(self) -> LengthUnit:
        """Of positions and lengths."""
        return "SfM units" if self.scale is None else self.scale.length_unit

    @property
    def sfm_per_unit(self) -> float:
        """SfM units per metre, or 1 where nothing tells metres."""
        return 1.0 if self.scale is None else 1.0 / self.scale.unit_per_sfm

    @property
    def world_per_unit(self) -> float:
        """World units per metre, or per SfM unit where nothing tells metres."""
        return self.sfm_per_unit / self.given_from_world.factor

    def position(self, world: NDArray[np.float64]) -> NDArray[np.float64]:
        """`[..., 3]` in the given frame, in metres or SfM units, of positions in the world; as `Spot.position_m`."""
        return self.given_from_world.apply(world) / self.sfm_per_unit

    def world(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of `position`."""
        return self.given_from_world.apply_inverse(position * self.sfm_per_unit)

    @cached_property
    def up(self) -> NDArray[np.float64]:
        """`[3]`: unit vector upwards in the world: what the cameras had above them, on average."""
        if self.scene is None:
            return np.array([0.0, 0.0, 1.0])
        mean = -np.mean([pose.rotation[:, 1] for pose in self.scene.world_from_rgb.values()], axis=0)
        length = float(np.linalg.norm(mean))
        return mean / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])

    @cached_property
    def box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner `[3]` of the middle 98 % of the model in the world, axis by axis."""
        points = np.zeros((0, 3))
        if self.rgb is not None or self.thermal is not None:
            model = self.rgb or self.thermal
            assert model is not None
            points = model.gaussians.means.numpy().astype(np.float64)
        elif self.scene is not None:
            points = self.scene.points.xyz
        if not len(points):
            return np.full(3, -1.0), np.full(3, 1.0)
        lo, hi = np.percentile(points, [1, 99], axis=0)
        return lo, np.maximum(hi, lo + 1e-6)


def read_contents(run: Path, spots: Path | None = None, before: Contents | None = None) -> Contents:
    """Read what a run has. Never raises for something that is missing, half written or damaged: `Contents.messages` says it.

    Args:
        spots: a `spots.json` to show; None: the run's own, where it has one.
        before: what an earlier call gave. Parts whose files are the same are taken over.
    """
    folder, before = RunFolder(run), before or Contents(run)
    marks = {part: _mark(run, names) for part, names in PARTS.items()}
    if spots is None and (own := run / "spots" / "spots.json").is_file():
        spots = own
    marks["spots"] = _mark(Path(), [str(spots)] if spots else []) + marks["scale"] + marks["thermal"]
    messages: dict[str, str] = {}

    def part(name: str, read: Callable[[], Any]) -> Any:
        if before.marks.get(name) == marks[name]:
            if name in before.messages:
                messages[name] = before.messages[name]
            return getattr(before, name)
        value, message = attempt(read)
        if message:
            messages[name] = message
        return value

    scale = part("scale", lambda: _existing(run / "scale.json", "The scale is not known yet.", folder.read_scale))
    rgb = part("rgb", lambda: _rgb(folder))
    thermal = part("thermal", lambda: _existing(run / "thermal.json", "There is no thermal model yet.", folder.read_thermal))
    scene = part("scene", lambda: _existing(run / "scene", "The cameras' poses are not known yet.", folder.load_scene))
    found = part("spots", lambda: None if spots is None else _spots(spots, run, scale, thermal))
    given, message = attempt(lambda: folder.given_from_world)
    if message:
        messages.setdefault("scene", message)
    growing = rgb is not None and not (run / "rgb.json").exists()
    if growing:
        messages["rgb"] = "The RGB model is being trained: this is how far it has come."
    return Contents(
        run=run,
        scene=scene,
        rgb=rgb,
        thermal=thermal,
        scale=scale,
        spots=found,
        growing=growing,
        given_from_world=given or Sim3.identity(),
        messages=messages,
        marks=marks,
    )


def attempt(read: Callable[[], T]) -> tuple[T | None, str]:
    """What `read` gives, or why it cannot be had, in words."""
    try:
        return read(), ""
    except RtgsError as error:
        return None, str(error)
    except OSError as error:  # a file that goes while it is read
        return None, f"{error.filename or 'a file'}: {error.strerror or error}"


def _existing(path: Path, otherwise: str, read: Callable[[], T]) -> T:
    if not path.exists():
        raise RtgsError(otherwise)
    return read()


def _spots(path: Path, run: Path, scale: ScaleEstimate | None, thermal: ThermalModel | None) -> SpotList:
    """A list that fits the run: made before metres or degrees were known, it would mark other places and temperatures."""
    found = read_record(SpotList, path)
    length = "SfM units" if scale is None else scale.length_unit
    for what, theirs, ours in (("lengths", found.length_unit, length), ("temperatures", found.unit, thermal and thermal.unit)):
        if ours is not None and theirs != ours:
            raise RtgsError(
                f"{path}: its {what} are in {theirs}, those of the run in {ours}. "
                f"Make the list again: rtgs spots {run} --out {path.parent}"
            )
    return found


def _rgb(folder: RunFolder) -> RgbModel:
    if (folder.path / "rgb.json").exists():
        return folder.read_rgb()
    if not folder.checkpoint.exists():
        raise RtgsError("There is no RGB model yet.")
    return _snapshot(folder.checkpoint)


def _snapshot(path: Path) -> RgbModel:
    """The model of a training that goes on."""
    try:
        state = torch.load(path, weights_only=True)
        gaussians = Gaussians(**{name: tensor.detach() for name, tensor in state["gaussians"]["parameters"].items()})
        background = state["frames"]["parameters"]["background"].detach().clamp(0, 1)
    except Exception as error:  # torch raises half a dozen kinds for a damaged file
        raise RtgsError(f"{path}: the training's state cannot be read ({type(error).__name__}).") from error
    return RgbModel(gaussians, background, RenderSettings())


def _mark(run: Path, names: Any) -> Mark:
    found = []
    for name in names:
        try:
            stat = (run / name).stat()
            found.append((str(name), stat.st_mtime_ns, stat.st_size))
        except OSError:
            found.append((str(name), -1, -1))
    return tuple(found)


def with_spots(contents: Contents, spots: SpotList) -> Contents:
    """The same contents with a list of spots."""
    return replace(contents, spots=spots)
