"""The front door: cheap to import, and every name it promises is behind it."""

from __future__ import annotations

import ast
import doctest
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import rtgs

README = Path(__file__).parents[1] / "README.md"
HEAVY = ("torch", "numpy", "numba", "pycolmap", "cv2", "trimesh", "matplotlib", "tyro")


def test_import_is_cheap() -> None:
    code = f"import rtgs, sys; print([m for m in {HEAVY!r} if m in sys.modules], rtgs.__version__)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == f"[] {rtgs.__version__}"


@pytest.mark.parametrize("name", rtgs.__all__)
def test_every_name_resolves(name: str) -> None:
    value = getattr(rtgs, name)
    assert value.__name__ == name and value.__module__.startswith("rtgs.")
    assert value.__doc__, f"rtgs.{name} has no documentation"


@pytest.mark.thorough
def test_functions_are_reached_whatever_was_imported_first() -> None:
    names = [n for n in rtgs.__all__ if n.islower()]
    code = (
        "import rtgs, rtgs.cli, rtgs.evaluation, rtgs.renderer, rtgs.rgb.train, rtgs.thermal\n"
        f"print([n for n in {names!r} if not callable(getattr(rtgs, n))])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_lists_agree() -> None:
    """`__all__`, the table of lazy imports and what type checkers see."""
    tree = ast.parse(Path(str(rtgs.__file__)).read_text(encoding="utf-8"))
    (checking,) = (
        n for n in tree.body if isinstance(n, ast.If) and isinstance(n.test, ast.Name) and n.test.id == "TYPE_CHECKING"
    )
    seen = {(n.module, a.name) for n in checking.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert seen == {(f"rtgs.{module}", name) for module, names in rtgs._WHERE.items() for name in names}
    assert sorted(rtgs.__all__) == sorted(name for _, name in seen)
    assert len(set(rtgs.__all__)) == len(rtgs.__all__)


def test_an_unknown_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'splat'"):
        _ = rtgs.splat


def examples() -> list[str]:
    readme = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    docstring = "".join(e.source for e in doctest.DocTestParser().get_examples(rtgs.__doc__ or ""))
    assert readme and docstring
    return [*readme, docstring]


@pytest.mark.parametrize("code", examples())
def test_examples_name_what_exists(code: str) -> None:
    tree = ast.parse(code)
    calls = 0
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rtgs":
            assert callable(getattr(rtgs, node.attr)), node.attr
            calls += 1
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rtgs"):
            for alias in node.names:
                pkgutil.resolve_name(f"{node.module}:{alias.name}")  # fails where the module or the name does not exist
    assert calls >= 5
