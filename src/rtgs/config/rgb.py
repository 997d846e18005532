"""Settings of the RGB model's training."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal, get_args

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges

Quality = Literal["fast", "default", "best"]
QUALITIES: tuple[Quality, ...] = get_args(Quality)
Backend = Literal["cpu", "cuda", "reference"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)


@dataclass(frozen=True)
class DensifyConfig:
    """When and how far the model grows."""

    max_gaussians: Annotated[int | None, Range(1, 10**8)] = None
    """The budget; None: one for `pixels_each` pixels of an image or one a sparse point, from 10 000 to 150 000."""
    pixels_each: Annotated[float | None, Range(above=0)] = None
    """Pixels of an image for each Gaussian of the budget; None: by the quality."""
    every: Annotated[int, Range(1)] = 100
    """Steps between two rounds."""
    start: Annotated[float, Range(0, 1)] = 0.05
    """First round, as a share of all steps."""
    stop: Annotated[float, Range(0, 1)] = 0.65
    """Last round, as a share of all steps; the rest only refines."""
    split_size: Annotated[float, Range(above=0)] = 0.01
    """A Gaussian larger than this share of the scene's extent is split, a smaller one cloned."""
    prune_opacity: Annotated[float, Range(0, below=1)] = 0.005
    """A Gaussian fainter than this is removed."""

    def __post_init__(self) -> None:
        check_ranges(self, "rgb.densify")


@dataclass(frozen=True)
class RgbConfig:
    """Training of the RGB model."""

    quality: Quality = "default"
    """"fast" gives an anchor for the scale in a minute or two, "best" what more time can still gain; fills in what is left open."""
    steps: Annotated[int | None, Range(1, 10**7)] = None
    """Optimisation steps, one image each; None: by the quality."""
    sh_degree: Annotated[int | None, Range(0, 3)] = None
    """Highest spherical-harmonics band, up to 3; None: by the quality. Bands are switched on in turn over the first half."""
    densify: DensifyConfig = field(default_factory=DensifyConfig)
    """How the model grows."""
    ssim_weight: Annotated[float, Range(0, 100)] = 0.2
    """Loss = ℓ1 + this · (1 − SSIM)."""
    coarse_to_fine: Annotated[tuple[tuple[float, int], ...], Range(0, 1, then=Range(1, 64))] = ((0.2, 4), (0.55, 2))
    """(until this share of the steps, image reduced by this factor); full size afterwards."""
    background: Literal["learned", "black", "white"] = "learned"
    """What shows where nothing is: one colour, fitted or fixed."""
    antialiased: bool = False
    """Compensate opacity for the pixel-size blur, so that the model looks alike at other resolutions."""
    exposure: bool = False
    """Fit a gain and an offset per training frame and channel (not used for held-out frames)."""
    random_points: Annotated[int, Range(1, 10**7)] = 20_000
    """How many random points to start from when the scene has no sparse points."""
    backend: Backend = "cpu"
    """What renders the model, here and in all later stages: "cpu" (Numba), "cuda" (gsplat on an NVIDIA GPU) or "reference" (PyTorch,
    slow). Tangents and the thermal solver's linear map have no GPU version and stay on the CPU."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Order of the frames, random points and splits."""

    def resolved(self) -> RgbConfig:
        """The same with the numbers of its quality where they were left open."""
        preset = _PRESETS[self.quality]
        densify = self.densify
        if densify.pixels_each is None:
            densify = replace(densify, pixels_each=preset.pixels_each)
        steps = preset.steps if self.steps is None else self.steps
        sh_degree = preset.sh_degree if self.sh_degree is None else self.sh_degree
        return replace(self, steps=steps, sh_degree=sh_degree, densify=densify)

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise RtgsError(f"rgb.quality is {self.quality!r}; it is {', '.join(QUALITIES)}.")
        if self.backend not in BACKENDS:
            raise RtgsError(f"rgb.backend is {self.backend!r}; it is {', '.join(BACKENDS[:-1])} or {BACKENDS[-1]}.")
        check_ranges(self, "rgb")


@dataclass(frozen=True)
class _Preset:
    steps: int
    sh_degree: int
    pixels_each: float


# What two cores do in a minute, in minutes, and where more steps gain little; `benchmarks/train.py` measures them.
_PRESETS: dict[Quality, _Preset] = {
    "fast": _Preset(steps=1500, sh_degree=1, pixels_each=8.0),
    "default": _Preset(steps=7000, sh_degree=2, pixels_each=4.0),
    "best": _Preset(steps=10_000, sh_degree=3, pixels_each=4.0),
}
