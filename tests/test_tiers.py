"""The package's layers are acyclic: a module imports from strictly lower tiers, or from its own package."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "rtgs"

# First component under rtgs → tier. A package (io, render, …) is one unit: what is inside may import its siblings.
TIERS: dict[str, float] = {
    **dict.fromkeys(["errors", "progress", "threads"], 0),
    **dict.fromkeys(["config"], 0.5),
    **dict.fromkeys(["geometry", "image", "sh", "optim"], 1),
    **dict.fromkeys(["camera", "gaussians", "radiometry"], 2),
    **dict.fromkeys(["scene"], 3),
    **dict.fromkeys(["io", "render", "losses", "ssim", "metrics", "densify", "synthetic", "pictures", "sensor"], 4),
    **dict.fromkeys(["models", "photometric", "ngf", "lpips"], 4.5),
    **dict.fromkeys(["sfm", "fit_rgb", "scale", "fit_thermal"], 5),
    **dict.fromkeys(["baselines", "evaluate"], 6),
    **dict.fromkeys(["pipeline"], 7.0),
    **dict.fromkeys(["report", "viewer", "benchmarks"], 7.1),
    **dict.fromkeys(["cli"], 7.2),
    **dict.fromkeys(["__main__"], 7.3),
}
# Lower tiers that a unit must do without all the same.
FORBIDDEN: dict[str, set[str]] = {"render": {"scene", "radiometry", "io"}}


def imported_units(source: str, module: str) -> set[str]:
    """First components under `rtgs` that `source` imports anywhere, inside functions too; "" is `rtgs` itself.

    `module` is its dotted name; a package's `__init__` is given as `package.__init__`.
    """
    units = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.split(".")[: -node.level], *([base] if base else [])])
            # `from rtgs import camera` imports a module, `from rtgs.camera import Camera` a name; the unit comes second in both.
            names = [f"{base}.{alias.name}" for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "rtgs":
                units.add(parts[1] if len(parts) > 1 and not parts[1].startswith("__") else "")
    return units


def violations(module: str, source: str) -> list[str]:
    unit = module.split(".")[1]
    if unit == "__init__":
        return []  # the front door may show any room
    if unit not in TIERS:
        return [f"rtgs.{unit} has no tier: list it in TIERS in tests/test_tiers.py (and in the table of the architecture docs)"]
    found = []
    for other in sorted(imported_units(source, module) - {unit, ""}):
        if other not in TIERS:
            found.append(f"{module} imports rtgs.{other}, which has no tier: list it in TIERS in tests/test_tiers.py")
        elif TIERS[other] >= TIERS[unit]:
            found.append(
                f"{module} (tier {TIERS[unit]:g}) imports rtgs.{other} (tier {TIERS[other]:g}); only lower tiers are allowed"
            )
        elif other in FORBIDDEN.get(unit, ()):
            found.append(f"{module} imports rtgs.{other}; {unit} knows nothing of it, by design")
    return found


MODULES = {".".join(("rtgs", *p.relative_to(SOURCE).with_suffix("").parts)): p for p in sorted(SOURCE.rglob("*.py"))}


@pytest.mark.parametrize("module", MODULES)
def test_module_imports_only_from_lower_tiers(module: str) -> None:
    found = violations(module, MODULES[module].read_text(encoding="utf-8"))
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("module", "source", "allowed"),
    [
        ("rtgs.camera", "from rtgs.geometry import SE3", True),
        ("rtgs.geometry", "from rtgs.camera import Camera", False),
        ("rtgs.geometry", "def f():\n    import rtgs.camera", False),
        ("rtgs.losses", "from rtgs import metrics", False),
        ("rtgs.losses", "from .metrics import psnr", False),
        ("rtgs.losses", "from . import image", True),
        ("rtgs.io.ply", "from rtgs.io.images import read", True),
        ("rtgs.io.ply", "from .images import read", True),
        ("rtgs.io.ply", "from ..sh import C0", True),
        ("rtgs.io.ply", "from ..losses import ngf", False),
        ("rtgs.io.__init__", "from .ply import read_ply", True),
        ("rtgs.render.cpu.sh", "from rtgs.render.settings import S", True),
        ("rtgs.render.cpu.sh", "from rtgs.scene import Rig", False),
        ("rtgs.render", "import rtgs.io.ply", False),
        ("rtgs.report", "from rtgs import __version__", True),
        ("rtgs.report", "from rtgs.viewer import serve", False),
        ("rtgs.scale.solve", "import numpy, torch", True),
        ("rtgs.novelty", "", False),
        ("rtgs.__init__", "from rtgs.cli import main", True),
    ],
)
def test_the_check_itself(module: str, source: str, allowed: bool) -> None:
    assert (not violations(module, source)) == allowed
