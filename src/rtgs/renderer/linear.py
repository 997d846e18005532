"""The picture as a linear map of the colours: with geometry, opacity and pose frozen, `image = W·colors + (1 − α)·background`.

`LinearRender` is W and its transpose for one view. Colours are taken as they are: no spherical harmonics, no ½ added, no clamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.maths.planes import products
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import cpu, reference
from rtgs.renderer.cpu.arguments import Model, View
from rtgs.renderer.cpu.splats import Splats
from rtgs.renderer.cpu.weights import Survey, Weights
from rtgs.renderer.settings import RenderSettings
from rtgs.renderer.view import check, on_the_cpu


class LinearRender:
    """The linear map from colours to one view's picture, and its transpose.

    The view's splats and their lists are kept. The weights themselves, fifty or more a pixel, are computed again at each use, because
    a few dozen views of them fill a laptop's memory; `keep_weights` keeps them (docs/results/renderer-speed.md).

    Args:
        gaussians: geometry and opacity count.
        channels: the largest C of the colours that will be given; checked here rather than in the middle of long work.
        settings: near plane, anti-aliasing and back end count; "cuda" has no linear map, and "cpu" takes its place.
        every: only rows `every // 2 :: every` of the picture are drawn, H of them. (For Gaussians well outside the view, where the
            projection holds the slope, the bound is half a row off.)

    Raises:
        RtgsError: the camera has a lens; more channels than the back end composites at once; the model is on a GPU; no row is
            left.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        camera_from_world: SE3,
        *,
        channels: int = 1,
        settings: RenderSettings | None = None,
        every: int = 1,
    ) -> None:
        settings = on_the_cpu(settings or RenderSettings())
        check(gaussians, camera, RenderSettings(near_plane=settings.near_plane))
        if every // 2 >= camera.height:
            raise RtgsError(f"render: one row in {every} of a picture of {camera.height} leaves none; choose a smaller `every`.")
        self.channels, self.shape = channels, (camera.rows(every).height, camera.width)
        self.gaussians = len(gaussians)
        self._backend: _Cpu | _Reference = (_Cpu if settings.backend == "cpu" else _Reference)(
            gaussians, camera, camera_from_world, channels, settings, every
        )

    @property
    def visible(self) -> NDArray[np.int32]:
        """Indices of the Gaussians whose colours count."""
        return self._backend.visible

    @property
    def alpha(self) -> Tensor:
        """`[H, W]`."""
        return self._backend.alpha

    def image(self, colors: Tensor, background: Tensor | None = None) -> Tensor:
        """`[H, W, C]`: W·colors of `[N, C]`, plus (1 − α)·background of `[C]`."""
        if len(colors) != self.gaussians:
            raise ValueError(f"LinearRender.image: colours of {len(colors)} Gaussians, not {self.gaussians}.")
        if background is None:
            background = colors.new_zeros(colors.shape[1])
        return self._backend.image(colors.detach(), background.detach().expand(colors.shape[1]))

    def adjoint(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Wᵀ·image `[N, C]` of `[H, W, C]`, and the background's part Σ (1 − α)·image `[C]`."""
        if image.shape[:2] != self.shape:
            raise ValueError(f"LinearRender.adjoint: a picture of {tuple(image.shape[:2])} rows and columns, not {self.shape}.")
        return self._backend.adjoint(image.detach())

    def keep_weights(self, within: int) -> None:
        """Keep the weights, rounded to multiples of 1/65535, if they take no more than `within` bytes.

        Each use then takes 0.14 to 0.2 of the processor's time. It runs on one thread, so that several views can be used at once.
        "cpu" only; for "reference" nothing changes.
        """
        self._backend.keep_weights(within)

    @property
    def is_concurrent(self) -> bool:
        """Whether several threads may use it at once, with other views: where weights are kept, each use runs on one thread."""
        return self._backend.is_concurrent

    @property
    def nbytes(self) -> int:
        """How many bytes it keeps in memory."""
        return self._backend.nbytes


class LinearViews(Sequence[LinearRender]):
    """`LinearRender` of many views. As many are kept as fit into a budget; the others are made anew at each use.

    Args:
        camera_from_world: one pose a view.
        budget_bytes: for all kept views together.
        keep_weights: use what the lists of all views leave of the budget for weights (see `LinearRender.keep_weights`).
    """

    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        camera_from_world: Sequence[SE3],
        *,
        settings: RenderSettings | None = None,
        budget_bytes: int = 2 << 30,
        keep_weights: bool = False,
        every: int = 1,
    ) -> None:
        self._make = lambda pose: LinearRender(gaussians, camera, pose, settings=settings, every=every)
        self._poses = list(camera_from_world)
        self._kept: dict[int, LinearRender] = {}
        self._left, self._keep_weights = budget_bytes, keep_weights

    def __len__(self) -> int:
        return len(self._poses)

    def __getitem__(self, index: int) -> LinearRender:  # type: ignore[override]
        index = range(len(self))[index]
        if index not in self._kept:
            view = self._make(self._poses[index])
            if view.nbytes > self._left:
                return view
            if self._keep_weights:
                waiting = len(self) - len(self._kept) - 1  # lists bring more for their bytes than weights do
                view.keep_weights(self._left - waiting * view.nbytes)
            self._kept[index] = view
            self._left -= view.nbytes
        return self._kept[index]

    def release(self) -> None:
        """Give the memory of kept views back. They are made anew at their next use."""
        self._left += sum(view.nbytes for view in self._kept.values())
        self._kept.clear()

    def is_concurrent(self, index: int) -> bool:
        """Whether `views[index]` is kept and several threads may use it (see `LinearRender.is_concurrent`)."""
        return index in self._kept and self._kept[index].is_concurrent


class _Cpu:
    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        camera_from_world: SE3,
        channels: int,
        settings: RenderSettings,
        every: int,
    ) -> None:
        cpu.check_channels(channels)
        nothing, black = np.empty((0, 2), np.float32), np.zeros((len(gaussians), channels), np.float32)
        model, view = Model.of(gaussians.geometry), View.of(camera.rows(every), camera_from_world)
        splats = Splats.of(model, nothing, black, view, settings.near_plane, settings.antialiased, every)
        self._map: Splats | Weights = splats
        self._shown: tuple[NDArray[np.float32], NDArray[np.int64]] | None = None  # alpha, and what `Splats.adjoint` needs
        self.visible = np.flatnonzero(splats.tiles).astype(np.int32)

    @property
    def alpha(self) -> Tensor:
        return torch.from_numpy(self._alpha_and_used()[0])

    def _alpha_and_used(self) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        if self._shown is None:  # most often the first picture has brought them along
            assert isinstance(self._map, Splats)
            survey = Survey.of(self._map)
            self._shown = survey.alpha, survey.used
        return self._shown

    def image(self, colors: Tensor, background: Tensor) -> Tensor:
        numbers, behind = (np.ascontiguousarray(t.numpy(), dtype=np.float32) for t in (colors, background))
        if isinstance(self._map, Weights):
            return torch.from_numpy(self._map.image(numbers, behind))
        splats = replace(self._map, channels=colors.shape[1])
        splats.set_colors(numbers)
        picture = splats.blend()
        self._shown = picture.alpha, picture.used
        return torch.from_numpy(picture.image).addcmul_(1.0 - self.alpha[..., None], torch.from_numpy(behind))

    def adjoint(self, image: Tensor) -> tuple[Tensor, Tensor]:
        if isinstance(self._map, Weights):
            colors, background = self._map.adjoint(image.numpy())
            return torch.from_numpy(colors), torch.from_numpy(background)
        numbers = np.ascontiguousarray(image.numpy(), dtype=np.float32)
        alpha, used = self._alpha_and_used()
        planes = np.ascontiguousarray(numbers.reshape(-1, numbers.shape[2]).T)
        background = products(1.0 - alpha.reshape(1, -1), planes)[0]
        return torch.from_numpy(self._map.adjoint(numbers, used)), torch.from_numpy(background)

    def keep_weights(self, within: int) -> None:
        if isinstance(self._map, Weights):
            return
        survey = Survey.of(self._map)
        self._shown = survey.alpha, survey.used
        if survey.nbytes + survey.alpha.nbytes <= within:
            self._map = Weights.of(self._map, survey)
            self.visible = self._map.seen

    @property
    def is_concurrent(self) -> bool:
        return isinstance(self._map, Weights)

    @property
    def nbytes(self) -> int:
        height, width = self._map.shape
        return self._map.nbytes + 4 * height * width + (self.visible.nbytes if isinstance(self._map, Splats) else 0)


class _Reference:
    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        camera_from_world: SE3,
        channels: int,
        settings: RenderSettings,
        every: int,
    ) -> None:
        frozen = gaussians.detach()
        pose = camera_from_world.to_torch(frozen.means.dtype)
        self._colors = torch.zeros(len(frozen), channels, dtype=frozen.means.dtype)

        def draw(colors: Tensor) -> tuple[Tensor, Tensor]:
            color, alpha, _ = reference.rasterize(frozen.geometry, colors, camera, pose, settings)
            return color[every // 2 :: every], alpha[every // 2 :: every]

        self._draw = draw
        self.alpha = draw(self._colors)[1]
        self.visible = np.arange(len(frozen), dtype=np.int32)

    def image(self, colors: Tensor, background: Tensor) -> Tensor:
        return self._draw(colors)[0] + (1.0 - self.alpha)[..., None] * background

    def adjoint(self, image: Tensor) -> tuple[Tensor, Tensor]:
        background = torch.einsum("hw,hwc->c", 1.0 - self.alpha, image.to(self.alpha.dtype))
        colors = self._colors[:, :1].repeat(1, image.shape[2]).requires_grad_()
        with torch.enable_grad():
            picture = self._draw(colors)[0]
        if not picture.requires_grad:
            return torch.zeros_like(colors), background
        return torch.autograd.grad(picture, colors, image)[0], background

    is_concurrent = False
    nbytes = 0

    def keep_weights(self, within: int) -> None:
        pass
