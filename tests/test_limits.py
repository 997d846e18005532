"""Sizes that keep the code readable: lines of a file, lines of a function, parameters of a signature."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "rtgs"

FILE_LINES = 400
FUNCTION_LINES = 80
PARAMETERS = 8

# What a scene is made of is content, not logic.
CONTENT = ("synthetic/scenes/",)
# Compiled kernels of one stage stand together, since Numba inlines them into each other.
LONG_FILES = ("renderer/cpu/blend.py", "renderer/cpu/projection.py", "renderer/cpu/simd.py")
# A compiled kernel whose parts share a dozen registers each.
LONG_FUNCTIONS = ("renderer/cpu/projection.py _pull_back_group",)
# Decorators of compiled kernels, which take arrays one by one.
COMPILED = ("kernel", "inlined")


def files() -> Iterator[tuple[str, str]]:
    """Path under `src/rtgs` and text of every file that the limits are about."""
    for path in sorted(SOURCE.rglob("*.py")):
        name = path.relative_to(SOURCE).as_posix()
        if not name.startswith(CONTENT):
            yield name, path.read_text(encoding="utf-8")


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function and method, with its place."""
    for name, text in files():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{name} {node.name}", node


def is_compiled(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a decorator compiles the function: its last name says so."""
    for decorator in function.decorator_list:
        target = decorator.func if isinstance(decorator, ast.Call) else decorator
        last = target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")
        if any(word in last for word in COMPILED):
            return True
    return False


def test_files_are_short() -> None:
    lengths = {name: text.count("\n") for name, text in files()}
    long = {name: n for name, n in lengths.items() if n > FILE_LINES and name not in LONG_FILES}
    assert not long, long
    spared = [name for name in LONG_FILES if lengths.get(name, 0) <= FILE_LINES]
    assert not spared, f"no exception is needed any more for {spared}"


def test_functions_are_short() -> None:
    lengths = [(place, (node.end_lineno or 0) - node.lineno + 1) for place, node in functions()]
    long = [(place, n) for place, n in lengths if n > FUNCTION_LINES and place not in LONG_FUNCTIONS]
    assert not long, long


def test_signatures_are_short() -> None:
    long = []
    for place, node in functions():
        a = node.args
        names = [x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
        count = len(names) - (names[:1] in (["self"], ["cls"]))
        if count > PARAMETERS and not is_compiled(node):
            long.append((place, count))
    assert not long, long


def test_tests_are_short() -> None:
    tests = Path(__file__).parent
    long = {
        p.relative_to(tests).as_posix(): n
        for p in sorted(tests.rglob("*.py"))
        if (n := len(p.read_text().splitlines())) > FILE_LINES
    }
    assert not long, long
