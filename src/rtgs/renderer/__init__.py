"""Draw a Gaussian model.

| function or class      | gives                                                                          |
|------------------------|--------------------------------------------------------------------------------|
| `render`               | a picture; autograd takes its gradient to the model and the pose (reverse mode) |
| `render_with_tangents` | a picture and its derivatives along a few motions of the camera (forward mode) |
| `LinearRender`         | the linear map from colours to a picture, and its transpose                    |

`RenderSettings.backend` chooses who computes: "reference" (PyTorch, the specification), "cpu" (Numba) or "cuda" (gsplat). Nobody
outside this folder imports a back end.
"""

from __future__ import annotations

from rtgs.renderer.linear import LinearRender, LinearViews
from rtgs.renderer.settings import Render, RenderSettings
from rtgs.renderer.tangents import Direction, Tangents, render_with_tangents
from rtgs.renderer.view import check_backend, render

__all__ = [
    "Direction",
    "LinearRender",
    "LinearViews",
    "Render",
    "RenderSettings",
    "Tangents",
    "check_backend",
    "render",
    "render_with_tangents",
]
