"""The seven scenes. Each module has one function `build() -> Model`, which always makes the same model."""

from __future__ import annotations

from importlib import import_module

from rtgs.config import SCENES, SceneName
from rtgs.synthetic.model import Model


def build_scene(name: SceneName) -> Model:
    """The model of that name, in metres. Its module is imported only now."""
    assert name in SCENES, name
    return import_module(f"rtgs.synthetic.scenes.{name}").build()
