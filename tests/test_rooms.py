"""The plan of the house: which room may import which, and that every module can be reached by its name."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "rtgs"

# From the ground up: a room imports only from rooms before it in this list, and from itself.
ROOMS = [
    "base",
    "config",
    "maths",
    "images",
    "records",
    "losses",
    "metrics",
    "renderer",
    "models",
    "io",
    "calibration",
    "synthetic",
    "sfm",
    "rgb",
    "scale",
    "metres",
    "thermal",
    "evaluation",
    "doctor",
    "run",
    "experiments",
    "viewer",
    "cli",
]

# Only the renderer itself imports these.
BACK_ENDS = tuple(f"rtgs.renderer.{name}" for name in ("cpu", "cuda", "reference"))


def imported_modules(source: str, module: str) -> set[str]:
    """Dotted names under `rtgs` that `source` imports anywhere, inside functions too.

    `module` is its dotted name; a package's `__init__` is given as `package.__init__`.
    """
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.split(".")[: -node.level], *([base] if base else [])])
            # `from rtgs import io` imports a room, `from rtgs.io import ply` a module of it: the room comes second in both.
            names = [f"{base}.{alias.name}" for alias in node.names]
        found |= {name for name in names if name.split(".")[0] == "rtgs"}
    return found


def violations(module: str, source: str) -> list[str]:
    """What a module must not import, in words."""
    room, found = module.split(".")[1], []
    if room in ("__init__", "__main__"):
        return []  # the front door may show any room
    if room not in ROOMS:
        return [f"rtgs.{room} is no room: list it in tests/test_rooms.py and in docs/architecture.md"]
    for name in sorted(imported_modules(source, module)):
        other = name.split(".")[1] if "." in name else ""
        if other.startswith("__") or other in ("", room):
            continue
        if other not in ROOMS:
            found.append(f"{module} imports {name}, which is in no room")
        elif ROOMS.index(other) > ROOMS.index(room):
            found.append(f"{module} imports {name}, but {room} comes before {other} in the list of rooms")
        elif room != "renderer" and name.startswith(BACK_ENDS):
            found.append(f"{module} imports {name}: nobody outside the renderer knows its back ends")
    return found


def modules() -> dict[str, Path]:
    """Dotted name → file, `__init__` included."""
    return {".".join(("rtgs", *p.relative_to(SOURCE).with_suffix("").parts)): p for p in sorted(SOURCE.rglob("*.py"))}


@pytest.mark.thorough
@pytest.mark.parametrize("module", modules())
def test_a_room_imports_only_from_rooms_below_it(module: str) -> None:
    found = violations(module, modules()[module].read_text(encoding="utf-8"))
    assert not found, "\n".join(found)


def test_the_list_names_rooms_that_exist_and_no_file_stands_outside_of_them() -> None:
    there = {p.name for p in SOURCE.iterdir() if p.is_dir() and p.name != "__pycache__"}
    assert there == set(ROOMS)
    assert {p.name for p in SOURCE.glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.thorough
def test_every_import_of_a_module_gives_that_module() -> None:
    """No function hides the module of its own name: `import rtgs.X as m` is a module for every X, whatever was imported before."""
    names = [name.removesuffix(".__init__") for name in modules() if not name.endswith("__main__")]
    program = "\n".join(
        [
            "import sys, types",
            f"names = {names!r}",
            "for name in names: __import__(name)",
            "for name in names:",
            "    value = sys.modules['rtgs']",
            "    for part in name.split('.')[1:]: value = getattr(value, part)",
            "    assert isinstance(value, types.ModuleType) and value.__name__ == name, name",
            "print(len(names))",
        ]
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == str(len(names)), done.stderr


@pytest.mark.parametrize(
    ("module", "source", "allowed"),
    [
        ("rtgs.records.camera", "from rtgs.maths.geometry import SE3", True),
        ("rtgs.maths.geometry", "from rtgs.records.camera import Camera", False),
        ("rtgs.maths.geometry", "def f():\n    import rtgs.records.camera", False),
        ("rtgs.losses.ngf", "from rtgs import metrics", False),
        ("rtgs.losses.ngf", "from ..metrics import basic", False),
        ("rtgs.losses.ngf", "from .. import images", True),
        ("rtgs.io.ply", "from rtgs.io.image_files import read_rgb", True),
        ("rtgs.io.ply", "from .image_files import read_rgb", True),
        ("rtgs.io.__init__", "from .ply import read_ply", True),
        ("rtgs.renderer.view", "from rtgs.renderer.cpu import draw", True),
        ("rtgs.thermal.design", "from rtgs.renderer.cpu.weights import Weights", False),
        ("rtgs.thermal.design", "from rtgs.renderer import cpu", False),
        ("rtgs.rgb.densify", "from rtgs.renderer.reference import project", False),
        ("rtgs.rgb.train", "from rtgs.renderer import cuda", False),
        ("rtgs.run.report", "from rtgs import __version__", True),
        ("rtgs.run.report", "from rtgs.experiments import tables", False),
        ("rtgs.scale.solve", "import numpy, torch", True),
        ("rtgs.novelty.x", "", False),
        ("rtgs.__init__", "from rtgs.cli import main", True),
    ],
)
def test_the_check_itself(module: str, source: str, allowed: bool) -> None:
    assert (not violations(module, source)) == allowed
