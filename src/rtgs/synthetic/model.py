"""A modelled scene: parts of one material each, lights, and what is compiled from them for the ray caster."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rtgs.synthetic.meshes import Mesh, merged

Floats = NDArray[np.float64]
Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Surface:
    """Points at which a material is evaluated.

    Attributes:
        local, normal_local: `[N, 3]`, in the coordinates that the shape was modelled in.
        world, normal: `[N, 3]`, metres.
        colour: `[N, 3]` sRGB, base_c: `[N]` °C: the colour and temperature of the part that each point lies on.
        part: `[N]` int, which part.
    """

    local: Floats
    normal_local: Floats
    world: Floats
    normal: Floats
    colour: Floats
    base_c: Floats
    part: NDArray[np.int64]


def plain(surface: Surface) -> Floats:
    """The part's own colour."""
    return surface.colour


def uniform(surface: Surface) -> Floats:
    """The part's own temperature."""
    return surface.base_c


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks and how warm it is.

    Attributes:
        albedo: sRGB `[N, 3]` of a `Surface`. temperature_c: °C `[N]` of a `Surface`, before exposure to the surroundings.
        specular, shininess: Blinn–Phong highlight. reflect: share of the surroundings mirrored at normal incidence.
    """

    albedo: Callable[[Surface], Floats] = plain
    temperature_c: Callable[[Surface], Floats] = uniform
    specular: float = 0.0
    shininess: float = 40.0
    reflect: float = 0.0


@dataclass(frozen=True, eq=False)
class Part:
    """One shape of one material."""

    mesh: Mesh
    material: Material
    colour: Colour = (0.7, 0.7, 0.7)
    base_c: float = 22.0


@dataclass(frozen=True, eq=False)
class Light:
    """An area light: point samples `[L, 3]` and what all of them together give at `reference_m` (infinity: no falloff)."""

    samples: Floats
    colour: Colour
    reference_m: float = float("inf")


@dataclass(frozen=True, eq=False)
class Model:
    """A scene in metres, z up, about the origin.

    Attributes:
        parts: all that is visible.
        lights: for the RGB camera. sky, ground: ambient light from above and below, linear RGB.
        ambient_c: air temperature: what well hidden surfaces tend to. background_c, background_rgb: where rays leave the scene.
        occlusion_m: how far away a surface can still occlude.
        centre: what cameras around an object look at.
    """

    parts: tuple[Part, ...]
    lights: tuple[Light, ...]
    sky: Colour = (0.42, 0.44, 0.48)
    ground: Colour = (0.26, 0.24, 0.22)
    ambient_c: float = 20.0
    background_c: float = 8.0
    background_rgb: Colour = (1.0, 1.0, 1.0)
    occlusion_m: float = 0.8
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass
class Builder:
    """Collects the parts of a scene."""

    parts: list[Part] = field(default_factory=list)

    def add(
        self, material: Material, meshes: Mesh | Sequence[Mesh], colour: Colour = (0.7, 0.7, 0.7), base_c: float = 22.0
    ) -> None:
        """Add a part: a shape, or several of one material, with its colour and its temperature in °C."""
        mesh = meshes if isinstance(meshes, Mesh) else merged(meshes)
        self.parts.append(Part(mesh, material, colour, base_c))


def soft_light(position: tuple[float, float, float], radius_m: float, colour: Colour, reference_m: float = float("inf")) -> Light:
    """A square of 2 × 2 samples that faces the origin: shadows have a short penumbra."""
    p = np.asarray(position, dtype=np.float64)
    z = p / np.linalg.norm(p)
    x = np.cross(z, [0.0, 0.0, 1.0] if abs(z[2]) < 0.95 else [1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    corners = [p + radius_m * (a * x + b * y) for a, b in ((-1, -0.4), (0.4, -1), (1, 0.4), (-0.4, 1))]
    return Light(np.stack(corners), colour, reference_m)


STUDIO = (soft_light((6.0, -4.5, 8.0), 0.35, (0.80, 0.76, 0.70)), soft_light((-7.0, 5.0, 4.0), 0.35, (0.20, 0.23, 0.28)))
