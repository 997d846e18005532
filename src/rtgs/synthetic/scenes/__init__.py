"""The scenes. Each module has one function `build() -> Model`, which always makes the same model."""

from __future__ import annotations

from importlib import import_module

from rtgs.config import SceneName
from rtgs.synthetic.model import Model


def build_scene(name: SceneName) -> Model:
    """The model of that name, in metres. Its module is imported only now."""
    return import_module(f"rtgs.synthetic.scenes.{name}").build()
