"""The design matrix of the thermal fit: what the unknowns look like in each photograph, and the transpose.

    image_f = W_f · (basis_f ∘ sh) + (1 − α_f) · background

The unknowns are N · K harmonics and the background, one column `[D, C]` a problem. C problems (under different ridges) go side by side,
since the weights W, which are most of the work, are theirs in common.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager, closing
from typing import TypeVar

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.threads import in_order, threads_at_most
from rtgs.maths import sh
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import LinearViews, RenderSettings
from rtgs.thermal import harmonics

T = TypeVar("T")

VIEWS_BYTES = 2 << 30
SMALL_PICTURE = 1 << 16  # pixels: with fewer, threads spend what they gain on waiting for each other


def threads_for(pixels: int) -> AbstractContextManager[None]:
    """For work on pictures of so many pixels: Numba's threads, or one."""
    return threads_at_most(1 if pixels < SMALL_PICTURE else nb.get_num_threads())


class Design:
    """The linear map from unknowns to photographs; geometry, opacity and poses are frozen.

    Args:
        gaussians: colours are not looked at.
        poses: camera_from_world, one a frame.
        degree: highest band of the harmonics.
        every: see `LinearRender`. kept_bytes: for weights or splats of views; the others are projected again at each use.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        poses: Sequence[SE3],
        degree: int,
        settings: RenderSettings,
        *,
        every: int = 1,
        kept_bytes: int = VIEWS_BYTES,
    ) -> None:
        self.gaussians, self.coefficients = len(gaussians), sh.coefficients(degree)
        self.size = self.gaussians * self.coefficients + 1
        self._means = np.ascontiguousarray(gaussians.means.detach().numpy(), dtype=np.float32)
        self._centres = [(-p.rotation.T @ p.translation).astype(np.float32) for p in poses]
        self._visible: dict[int, NDArray[np.int32]] = {}  # by frame; views may not be kept
        self._views = LinearViews(
            gaussians, camera, poses, settings=settings, budget_bytes=kept_bytes, keep_weights=True, every=every
        )

    def __len__(self) -> int:
        """How many frames."""
        return len(self._centres)

    def each(self, work: Callable[[int], T], frames: Sequence[int]) -> Generator[T]:
        """`work` of each frame, in order; by Numba's number of threads (see `threads_for`) where the frames' weights are kept, so of what
        it shares with others `work` writes what is the frame's alone. PyTorch would split large pictures among threads of its own: NumPy
        and Numba do not."""
        return in_order(work, frames, nb.get_num_threads(), lambda frame: not self._views.is_concurrent(frame))

    def harmonics(self, x: Tensor) -> Tensor:
        """The view `[N, K, …]` of unknowns `[D, …]`; the background is their last row."""
        return x[:-1].view(self.gaussians, self.coefficients, *x.shape[1:])

    def image(self, frame: int, x: Tensor) -> Tensor:
        """`[h, w, C]`."""
        view, colors = self._views[frame], np.empty((self.gaussians, x.shape[1]), np.float32)
        harmonics.colors_of(self._means, self._centres[frame], view.visible, self.harmonics(x).numpy(), colors)
        return view.image(torch.from_numpy(colors), x[-1])

    def add_transpose(
        self, image_of: Callable[[int], Tensor], frames: Sequence[int], out: Tensor, each: Callable[[], None] = lambda: None
    ) -> None:
        """out `[D, C]` += Σ transpose · image `[h, w, C]`; `image_of` is called as `each` of this class says, `each` after each frame."""
        with closing(self.each(lambda f: self.weights(f, image_of(f)), frames)) as parts:
            for frame, (colors, background) in zip(frames, parts, strict=True):
                self.add_harmonics(frame, colors, self.harmonics(out))
                out[-1] += background
                each()

    def weights(self, frame: int, image: Tensor) -> tuple[Tensor, Tensor]:
        """Wᵀ·image `[N, C]` and the background's part `[C]`, without harmonics."""
        view = self._views[frame]
        self._visible[frame] = view.visible
        return view.adjoint(image)

    def add_harmonics(self, frame: int, colors: Tensor, out: Tensor) -> None:
        """out `[N, K, C]` += basis ⊗ colors `[N, C]`, of the frame's `weights`."""
        harmonics.add_transpose(self._means, self._centres[frame], self._visible[frame], colors.numpy(), out.numpy())

    def add_blocks(self, frame: int, weights: Tensor, out: Tensor) -> None:
        """out `[N, K, K]` += weights `[N]` · basis ⊗ basis."""
        harmonics.add_blocks(self._means, self._centres[frame], weights.numpy(), out.numpy())
