"""Drawing a Gaussian model: `render` (reverse mode), `render_with_tangents` (forward mode), `LinearRender` (colours as a linear map)."""

from __future__ import annotations

from rtgs.renderer.linear import LinearRender, LinearViews
from rtgs.renderer.settings import Backend, Render, RenderSettings
from rtgs.renderer.tangents import Direction, Tangents, render_with_tangents
from rtgs.renderer.view import render

__all__ = [
    "Backend",
    "Direction",
    "LinearRender",
    "LinearViews",
    "Render",
    "RenderSettings",
    "Tangents",
    "render",
    "render_with_tangents",
]
