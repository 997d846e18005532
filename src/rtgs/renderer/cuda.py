"""The GPU back end: the same two functions as `reference`, through the CUDA kernels of gsplat (Ye et al. 2024), float32.

All tensors are on the GPU here; `render` moves them there.

gsplat is optional (`pip install 'rtgs[cuda]'`) and is imported at the first render. `gsplat.rasterization` is one call, but adds
nothing to the projected centres and takes spherical harmonics of three channels only; so its steps are composed here, with
`pixel_offsets` between the projection and the tiles. Its cut-offs (`settings.ALPHA_MIN`, `ALPHA_MAX`, `TRANSMITTANCE_MIN`,
`FRUSTUM_MARGIN`) are compiled in; the tests hold them against ours.
"""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Geometry
from rtgs.renderer import reference
from rtgs.renderer.settings import COVARIANCE_BLUR_PX2, RenderSettings

TILE_PX = 16  # gsplat tests no other


def device() -> torch.device:
    """The GPU.

    Raises:
        RtgsError: torch finds none.
    """
    if not torch.cuda.is_available():
        raise RtgsError(
            'render: backend "cuda" wants a GPU, and torch finds no GPU here (it takes an NVIDIA GPU and a CUDA build of torch); use '
            'backend "cpu".'
        )
    return torch.device("cuda")


def colors_from_sh(means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
    """`[N, C]`: max(0, ½ + basis(direction from the camera) · sh), `coefficients` `[N, K, C]`."""
    return reference.colors_from_sh(means.float(), coefficients.float(), camera_centre.float())


def rasterize(
    geometry: Geometry,
    colors: Tensor,
    camera: Camera,
    camera_from_world: SE3,
    settings: RenderSettings,
    pixel_offsets: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Image `[H, W, C]`, alpha `[H, W]` and visible `[N]`; see `reference.rasterize`.

    Two things differ from the reference: a Gaussian off screen is left out before `pixel_offsets` are added, so that offsets other
    than zero do not bring it in; and `visible` may name one that touches no pixel, since its box is rounded up to whole pixels.

    Raises:
        RtgsError: gsplat or its kernels are missing.
    """
    means, quats, log_scales, opacity_logits = geometry
    gsplat = _gsplat()
    width, height, device = camera.width, camera.height, means.device
    opacities = torch.sigmoid(opacity_logits.float())
    colors = colors.float()
    if len(means) == 0:  # gsplat 1.5.3 divides by the number of Gaussians; empty sums keep the gradients' path
        image = torch.zeros(height, width, colors.shape[1], device=device) + colors.sum(0)
        alpha = torch.zeros(height, width, device=device) + opacities.sum()
        return image, alpha, torch.zeros(0, dtype=torch.bool, device=device)

    rotation, translation = camera_from_world.rotation.float(), camera_from_world.translation.float()
    last_row = torch.tensor([[0.0, 0.0, 0.0, 1.0]], device=device)
    viewmat = torch.cat([torch.cat([rotation, translation[:, None]], dim=1), last_row])
    radii, centres, depths, conics, compensations = gsplat.fully_fused_projection(
        means.float(),
        None,
        quats.float(),
        log_scales.float().exp(),
        viewmat[None],
        torch.tensor(camera.matrix, dtype=torch.float32, device=device)[None],
        width,
        height,
        eps2d=COVARIANCE_BLUR_PX2,
        # gsplat keeps what lies on its near plane, the reference does not.
        near_plane=float(np.nextafter(np.float32(settings.near_plane), np.float32(np.inf))),
        far_plane=math.inf,
        packed=False,
        calc_compensations=settings.antialiased,
        camera_model="pinhole",
        opacities=opacities,  # for the extents; their gradient comes from the blending
    )
    # What is culled has radius 0 and holds unwritten memory elsewhere: nothing below may multiply by it.
    opacities = opacities[None] * compensations if settings.antialiased else opacities[None]
    if pixel_offsets is not None:
        centres = centres + pixel_offsets.float()[None]
    tiles_x, tiles_y = math.ceil(width / TILE_PX), math.ceil(height / TILE_PX)
    _, intersections, ids = gsplat.isect_tiles(centres, radii, depths, TILE_PX, tiles_x, tiles_y)
    offsets = gsplat.isect_offset_encode(intersections, 1, tiles_x, tiles_y)
    image, alpha = gsplat.rasterize_to_pixels(centres, conics, colors[None], opacities, width, height, TILE_PX, offsets, ids)
    return image[0], alpha[0, ..., 0], (radii[0] > 0).all(-1)


def _gsplat() -> ModuleType:
    """gsplat, with its kernels; its wheel on PyPI compiles them when they are first asked for."""
    try:
        import gsplat
    except ImportError as error:
        raise RtgsError('render: backend "cuda" needs gsplat: pip install \'rtgs[cuda]\', or use backend "cpu".') from error
    try:
        from gsplat.cuda._backend import _C as kernels
    except (ImportError, OSError, RuntimeError) as error:
        raise RtgsError(
            f"render: gsplat could not compile its kernels (CUDA {torch.version.cuda} for torch {torch.__version__}; nvcc has to be of "
            f'the same major version); use backend "cpu" meanwhile. {error}'
        ) from error
    if kernels is None:
        raise RtgsError(
            f"render: gsplat has no kernels: install the CUDA toolkit (nvcc) {torch.version.cuda or ''} that torch was built for, and "
            'gsplat compiles them once; or use backend "cpu".'
        )
    return gsplat
