"""What is seen from a camera: colours, temperatures and depth, from the engine's renderer."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.progress import Progress
from rtgs.maths import sh
from rtgs.maths.geometry import SE3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, render
from rtgs.viewer.contents import Contents

Floats: TypeAlias = NDArray[np.float32]
ErrorModel: TypeAlias = tuple[Gaussians, float, RenderSettings]
SOLID = 0.5  # opacity from which a pixel shows a surface
POINT_PX = 9  # side of the picture by which one ray is looked along


@dataclass(frozen=True, eq=False)
class Eye:
    """A place to look from.

    Attributes:
        camera: without a lens. world_from_camera: where it stands.
    """

    camera: Camera
    world_from_camera: SE3

    @staticmethod
    def of(width: int, height: int, fov_rad: float, world_from_camera: SE3) -> Eye:
        """A camera of a screen: square pixels, the principal point in the middle, `fov_rad` its vertical angle of view."""
        focal = 0.5 * height / math.tan(0.5 * fov_rad)
        return Eye(Camera("PINHOLE", width, height, focal, focal, width / 2, height / 2), world_from_camera)

    def resized(self, width: int, height: int) -> Eye:
        """The same view with other pixels."""
        return Eye(self.camera.resized(width, height), self.world_from_camera)

    def ray(self, x: float, y: float) -> NDArray[np.float64]:
        """`[3]`: direction in the world of the ray through `(x, y)`, in pixels, of length 1 along the optical axis."""
        c = self.camera
        return self.world_from_camera.rotation @ np.array([(x - c.cx) / c.fl_x, (y - c.cy) / c.fl_y, 1.0])

    def facing(self, x: float, y: float) -> Eye:
        """A camera of `POINT_PX` pixels at the same place that looks along the ray through `(x, y)`, with about the same pixels."""
        focal = math.sqrt(self.camera.fl_x * self.camera.fl_y)
        towards = self.ray(x, y) / np.linalg.norm(self.ray(x, y))
        side = self.world_from_camera.rotation[:, 0]
        across = side - (side @ towards) * towards
        across /= np.linalg.norm(across)
        pose = SE3(np.stack([across, np.cross(towards, across), towards], axis=1), self.world_from_camera.translation)
        middle = POINT_PX / 2
        return Eye(Camera("PINHOLE", POINT_PX, POINT_PX, focal, focal, middle, middle), pose)


@dataclass(frozen=True)
class Clip:
    """A box in the world; only Gaussians whose centres are inside are shown."""

    lo: tuple[float, float, float]
    hi: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Seen:
    """What is seen from an eye.

    Attributes:
        rgb: `[H, W, 3]` in [0, 1]. temperature: `[H, W]`, in the thermal model's unit. None where not asked for, or no model.
        depth: `[H, W]`, world units along the optical axis; NaN where there is no surface. None likewise.
    """

    eye: Eye
    rgb: Floats | None = None
    temperature: Floats | None = None
    depth: Floats | None = None


class Engine:
    """Renders the models of a run. One picture at a time: its kernels use all cores.

    Attributes:
        contents: what is shown.
    """

    def __init__(self, contents: Contents) -> None:
        self.contents = contents
        self._lock = threading.Lock()
        self._clipped: tuple[Contents, Clip, RgbModel | None, ThermalModel | None] | None = None
        self._errors_of: tuple[ThermalModel | None, ErrorModel | None] = (None, None)

    def look(
        self, eye: Eye, *, rgb: bool = False, temperature: bool = False, depth: bool = False, clip: Clip | None = None
    ) -> Seen:
        """Render what is asked for, as far as there are models."""
        with self._lock:
            colours, thermal = self._models(clip)
            pose = eye.world_from_camera.inverse()
            seen_rgb = seen_depth = seen_temperature = None
            if colours is not None and (rgb or depth):
                settings = replace(colours.settings, with_depth=depth, sh_degree=None if rgb else 0)
                picture, seen_depth = _render(colours.gaussians, colours.background, settings, eye, pose)
                seen_rgb = picture.clip(0.0, 1.0) if rgb else None
            if thermal is not None and temperature:
                seen_temperature = thermal.render(eye.camera, pose)
            if depth and seen_depth is None and thermal is not None:
                _, seen_depth = _render(thermal.gaussians, thermal.background, _depth_only(thermal.settings), eye, pose)
            return Seen(eye, seen_rgb, seen_temperature, seen_depth)

    def photographed(self, eye: Eye, frame: str) -> Floats | None:
        """`[h, w]`: the scene as the thermal camera would show it in a frame, with its drift and pattern; None without a model."""
        thermal = self.contents.thermal
        with self._lock:
            return None if thermal is None else thermal.render(eye.camera, eye.world_from_camera.inverse(), photographed_in=frame)

    def distance(self, eye: Eye, x: float, y: float) -> float:
        """World units along the ray through a pixel to the surface there, whatever is clipped; NaN where there is none."""
        model = self.contents.rgb or self.contents.thermal
        if model is None:
            return math.nan
        facing = eye.facing(x, y)
        with self._lock:
            settings = _depth_only(model.settings)
            _, depth = _render(model.gaussians, model.background, settings, facing, facing.world_from_camera.inverse())
        assert depth is not None
        return float(depth[POINT_PX // 2, POINT_PX // 2])

    def std(self, eye: Eye, x: float, y: float) -> float | None:
        """Standard error of the temperature at a pixel, in the thermal model's unit; None where the fit did not estimate any.

        Errors of Gaussians that share the pixel are taken to be the same way round: this is an upper bound of what they make together.
        """
        errors = self._errors
        if errors is None:
            return None
        gaussians, span, settings = errors
        facing = eye.facing(x, y)
        with self._lock:
            pose = facing.world_from_camera.inverse()
            picture, _ = _render(gaussians, torch.zeros(1), settings, facing, pose)
        return span * float(picture[POINT_PX // 2, POINT_PX // 2, 0])

    def busy(self, inner: Progress | None = None) -> Progress:
        """A progress for long work that holds this engine (`holding`): at each step pictures get their turn."""

        def step(done: int, total: int, text: str) -> None:
            self._lock.release()
            try:
                if inner is not None:
                    inner(done, total, text)
                time.sleep(0.005)
            finally:
                self._lock.acquire()

        return step

    @property
    def holding(self) -> threading.Lock:
        """Held while anything is rendered."""
        return self._lock

    def _models(self, clip: Clip | None) -> tuple[RgbModel | None, ThermalModel | None]:
        contents = self.contents
        if clip is None:
            return contents.rgb, contents.thermal
        kept = self._clipped
        if kept is None or kept[0] is not contents or kept[1] != clip:
            rgb = None if contents.rgb is None else replace(contents.rgb, gaussians=_inside(contents.rgb.gaussians, clip))
            thermal = contents.thermal
            if thermal is not None:
                thermal = replace(thermal, gaussians=_inside(thermal.gaussians, clip), temperatures=None)
            self._clipped = kept = (contents, clip, rgb, thermal)
        return kept[2], kept[3]

    @property
    def _errors(self) -> ErrorModel | None:
        model = self.contents.thermal
        if self._errors_of[0] is not model:
            self._errors_of = (model, _error_model(model))
        return self._errors_of[1]


def _error_model(model: ThermalModel | None) -> ErrorModel | None:
    """The thermal model with its standard errors as colours, and the error that colour 1 stands for."""
    if model is None or model.temperatures is None:
        return None
    std = torch.from_numpy(np.nan_to_num(model.temperatures.std).astype(np.float32))
    span = max(float(std.max()), 1e-9)
    colours = ((std / span - 0.5) / sh.C0)[:, None, None]
    return replace(model.gaussians, sh=colours), span, replace(model.settings, sh_degree=0)


def _depth_only(settings: RenderSettings) -> RenderSettings:
    return replace(settings, with_depth=True, sh_degree=0)


def _render(
    gaussians: Gaussians, background: Tensor, settings: RenderSettings, eye: Eye, pose: SE3
) -> tuple[Floats, Floats | None]:
    """Picture `[H, W, C]` over the background, and depth `[H, W]` where asked for."""
    with torch.no_grad():
        view = render(gaussians, eye.camera, pose, settings=settings)
        picture = view.over(background).numpy()
        if view.depth is None:
            return picture, None
        nothing = torch.full((), math.nan)
        depth = torch.where(view.alpha > SOLID, view.depth / view.alpha.clamp_min(1e-6), nothing)
    return picture, depth.numpy()


def _inside(gaussians: Gaussians, clip: Clip) -> Gaussians:
    lo, hi = (torch.tensor(corner, dtype=gaussians.means.dtype) for corner in (clip.lo, clip.hi))
    kept = ((gaussians.means >= lo) & (gaussians.means <= hi)).all(dim=1)
    return Gaussians(**{name: tensor[kept] for name, tensor in gaussians.tensors().items()})
