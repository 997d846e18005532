"""How an RGB model is rendered, while it is trained and ever after."""

from __future__ import annotations

from rtgs.config import Backend
from rtgs.renderer import RenderSettings, check_backend

NEAR_FRACTION = 0.01  # near plane as a share of the scene's extent, so that any SfM unit gives the same picture


def render_settings(extent: float, backend: Backend, *, antialiased: bool = False) -> RenderSettings:
    """Settings for a scene of this extent (`Scene.extent`).

    Raises:
        RtgsError: the back end cannot run on this machine.
    """
    check_backend(backend)
    return RenderSettings(backend=backend, near_plane=NEAR_FRACTION * extent, antialiased=antialiased)
