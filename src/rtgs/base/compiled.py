"""How Numba compiles the package's kernels: one decorator, and the reason for each of its options.

    @kernel("fast", parallel=True)
    def add(a, b, out): ...

Every kernel is kept in Numba's cache, so that only the first run after a change compiles it. **The cache looks at the kernel's own file
alone**: after an edit of this file, or of a function or constant that a kernel takes from another file, call `make clean-kernels`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numba as nb

from rtgs.base.errors import RtgsError

Function = TypeVar("Function", bound=Callable[..., Any])

Arithmetic = Literal["exact", "fused", "ordered", "fast", "fastest"]

# What LLVM may do to floating-point arithmetic.
_FASTMATH: dict[Arithmetic, bool | set[str]] = {
    # As written. Kernels that work on `simd.Lanes` say themselves what may be fused.
    "exact": False,
    # a·b + c may be rounded once instead of twice.
    "fused": {"contract"},
    # The same, and −0 counts as 0. Sums keep their order: the Sobel filters of a flat picture are exactly zero.
    "ordered": {"nsz", "contract"},
    # Sums in any order, which turns them into vectors, and approximate division and functions. NaN and infinity are kept: a NaN in a
    # training step has to stay visible.
    "fast": {"nsz", "arcp", "contract", "reassoc", "afn"},
    # The same, and the compiler may assume that there is no NaN and no infinity. For numbers that were checked before.
    "fastest": True,
}


def kernel(
    arithmetic: Arithmetic = "exact", *, parallel: bool = False, concurrent: bool = False, checks_division: bool = False
) -> Callable[[Function], Function]:
    """Compile a kernel, and keep its machine code in Numba's cache.

    Args:
        arithmetic: what may happen to sums and products, from "exact" to "fastest".
        parallel: iterations of `prange` are shared by Numba's threads.
        concurrent: Python's lock is let go, so that several Python threads can each run the kernel on work of their own.
        checks_division: division by zero raises ZeroDivisionError, as in Python. Otherwise it gives infinity or NaN, as in NumPy. The
            check is a branch, and keeps a loop that divides from becoming a vector.

    Raises:
        RtgsError: there is no folder to keep compiled code in.
    """
    compiled: Any = nb.njit(
        cache=True,
        parallel=parallel,
        nogil=concurrent,
        fastmath=_FASTMATH[arithmetic],
        error_model="python" if checks_division else "numpy",
    )

    def compile_kernel(function: Function) -> Function:
        try:
            return cast("Function", compiled(function))
        except RuntimeError as error:
            if "no locator" not in str(error):
                raise
            folder = Path(function.__code__.co_filename).parent
            raise RtgsError(
                f"{folder}: cannot be written, nor can the cache folder of this user, and compiled code has to be kept somewhere. "
                "Set NUMBA_CACHE_DIR to a folder that can be written."
            ) from error

    return compile_kernel


def inlined(function: Function) -> Function:
    """For steps of kernels: their code is copied to where they are called, and takes over the caller's options.

    Numba does so before it infers types. A constant argument then stays a constant, and lanes stay in registers.
    """
    compiled: Any = nb.njit(inline="always")(function)
    return cast("Function", compiled)
