"""The design matrix of the thermal fit: images of the unknowns, and the transpose.

    image_f = W_f · (basis_f ∘ sh) + (1 − α_f) · background

W_f are the renderer's compositing weights (pixels × Gaussians), basis_f the harmonics' basis in the directions from the camera. The
unknowns are N · K harmonics and the background, D in all. They come as C columns `[D, C]`, which share the weights W.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.threads import in_order
from rtgs.maths import sh
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import LinearViews, RenderSettings
from rtgs.thermal import harmonics

T = TypeVar("T")


class Design:
    """The linear map from unknowns to photographs; geometry, opacity and poses are frozen.

    Args:
        gaussians: colours are not used.
        poses: camera_from_world of each frame.
        degree: highest band of the harmonics.
        every: only one row in so many of each image (see `LinearRender`).
        kept_bytes: memory for the weights or splats of views; what does not fit is projected again at each use.
        threads: frames that are worked on at once.
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
        kept_bytes: int = 2 << 30,
        threads: int = 1,
    ) -> None:
        self.gaussians, self.coefficients = len(gaussians), sh.coefficients(degree)
        self.size = self.gaussians * self.coefficients + 1
        self._means = np.ascontiguousarray(gaussians.means.detach().numpy(), dtype=np.float32)
        self._centres = [(-p.rotation.T @ p.translation).astype(np.float32) for p in poses]
        self._visible: dict[int, NDArray[np.int32]] = {}  # by frame; views may not be kept
        self._threads = threads
        self._views = LinearViews(
            gaussians, camera, poses, settings=settings, budget_bytes=kept_bytes, keep_weights=True, every=every
        )

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._centres)

    def each(self, work: Callable[[int], T], frames: Sequence[int]) -> Generator[T]:
        """`work(frame)` for each frame, in order.

        Several threads call `work` where the frames' weights are kept, so it must write nothing that frames share. It should use NumPy
        and Numba: PyTorch would split large images among threads of its own.
        """
        return in_order(work, frames, self._threads, lambda frame: not self._views.is_concurrent(frame))

    def release(self) -> None:
        """Give the memory of weights back, before another design needs it. What is used again is computed again."""
        self._views.release()

    def harmonics(self, x: Tensor) -> Tensor:
        """`[N, K, …]`: the harmonics among the unknowns `[D, …]`, as a view. The last row of the unknowns is the background."""
        return x[:-1].view(self.gaussians, self.coefficients, *x.shape[1:])

    def image(self, frame: int, x: Tensor) -> Tensor:
        """`[h, w, C]`: design · x of unknowns `[D, C]` in a frame."""
        view, colors = self._views[frame], np.empty((self.gaussians, x.shape[1]), np.float32)
        harmonics.colors_of(self._means, self._centres[frame], view.visible, self.harmonics(x).numpy(), colors)
        return view.image(torch.from_numpy(colors), x[-1])

    def add_transpose(
        self, image_of: Callable[[int], Tensor], frames: Sequence[int], out: Tensor, each: Callable[[], None] = lambda: None
    ) -> None:
        """out `[D, C]` += Σ_f designᵀ · image `[h, w, C]`.

        Args:
            image_of: gives a frame's image; several threads may call it (see `Design.each`).
            each: called after each frame.
        """
        with closing(self.each(lambda f: self.weights(f, image_of(f)), frames)) as parts:
            for frame, (colors, background) in zip(frames, parts, strict=True):
                self.add_harmonics(frame, colors, self.harmonics(out))
                out[-1] += background
                each()

    def weights(self, frame: int, image: Tensor) -> tuple[Tensor, Tensor]:
        """Wᵀ · image `[N, C]` and Σ (1 − α) · image `[C]`: the transpose before harmonics."""
        view = self._views[frame]
        self._visible[frame] = view.visible
        return view.adjoint(image)

    def add_harmonics(self, frame: int, colors: Tensor, out: Tensor) -> None:
        """out `[N, K, C]` += basis ⊗ colors `[N, C]`; the frame's `weights` must have been called before."""
        harmonics.add_transpose(self._means, self._centres[frame], self._visible[frame], colors.numpy(), out.numpy())

    def add_blocks(self, frame: int, weights: Tensor, out: Tensor) -> None:
        """out `[N, K, K]` += weights `[N]` · basis ⊗ basis."""
        harmonics.add_blocks(self._means, self._centres[frame], weights.numpy(), out.numpy())
