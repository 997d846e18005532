"""How much memory a run may take, and how it is shared out."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rtgs.base.errors import RtgsError

GIGABYTE = 10**9
_USUAL_BYTES = 4 * GIGABYTE  # with more, captures of up to a few hundred pairs are no faster
_SHARE_OF_FREE = 0.75  # the rest is left to other programs
_PROGRAM_BYTES = 900_000_000  # libraries, compiled code, models and optimisers of a usual run; benchmarks/memory.py measures it
_LEAST_BYTES = _PROGRAM_BYTES + 100_000_000  # and half a dozen images, and as much for the fit
_NO_LIMIT = 1 << 60  # what cgroups of version 1 say for "none" is larger


@dataclass(frozen=True)
class Memory:
    """A run's memory, in bytes.

    What a capture needs besides (one number a frame here and there) is small. What grows with the number of frames is images and
    weights, and these are bounded.

    Attributes:
        images: for undistorted photographs that are kept; the others are read again from their files.
        reduced: for the smaller copies of photographs that the RGB model is trained with at first.
        fit: for what the thermal fit keeps: the renderer's weights, and its photographs and residuals.
    """

    images: int
    reduced: int
    fit: int

    @staticmethod
    def of(gigabytes: float | None = None) -> Memory:
        """Share out a budget for the whole process.

        Args:
            gigabytes: in 10⁹ bytes; None: 4, or three quarters of what is free where that is less.

        Raises:
            RtgsError: it is too small for any run.
        """
        if gigabytes is None:
            return Memory.within(free_bytes())
        if gigabytes * GIGABYTE < _LEAST_BYTES:
            raise RtgsError(f"memory_gb is {gigabytes:g}; a run needs {_LEAST_BYTES / GIGABYTE:.1f} or more (--memory-gb).")
        return Memory._shared(int(gigabytes * GIGABYTE))

    @staticmethod
    def within(free: int) -> Memory:
        """The default where so many bytes are free. It is the same on all machines with enough memory, so that a run that is continued
        gives the same numbers to the last bit.

        Raises:
            RtgsError: too few for any run.
        """
        budget = min(_USUAL_BYTES, int(_SHARE_OF_FREE * free))
        if budget < _LEAST_BYTES:
            least = _LEAST_BYTES / GIGABYTE
            raise RtgsError(
                f"memory: {free / GIGABYTE:.1f} GB are free, and a run needs {least / _SHARE_OF_FREE:.1f} or more. End other programs, or "
                f"raise the limit of the container. `--memory-gb {least:.1f}` tries all the same."
            )
        return Memory._shared(budget)

    @staticmethod
    def _shared(budget: int) -> Memory:
        left = budget - _PROGRAM_BYTES
        return Memory(int(0.45 * left), int(0.15 * left), int(0.25 * left))  # what is left over is for models of many Gaussians

    @staticmethod
    def warning(gigabytes: float | None) -> str:
        """What a person should know of a budget that was asked for: it is more than is free. Empty where there is nothing to say."""
        free = free_bytes() / GIGABYTE
        if gigabytes is None or gigabytes <= free:
            return ""
        return f"--memory-gb is {gigabytes:g}, and {free:.1f} GB are free: the system may slow down, or end the run."


def release() -> None:
    """Give memory that is free within the process back to the system. The C library of Linux keeps it otherwise, in pieces."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def free_bytes(root: Path = Path("/")) -> int:
    """Memory that this process may still take: what the system has free, and what its control groups (containers) allow.

    Args:
        root: where `proc` and `sys` are.
    """
    free = [limit - used for limit, used in _control_groups(root)]
    return max(0, min([_free_in_system(root), *free]))


def _free_in_system(root: Path) -> int:
    with suppress(OSError, ValueError, IndexError):
        for line in (root / "proc" / "meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
    with suppress(AttributeError, ValueError, OSError):  # no Linux: half of what there is
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
    return _USUAL_BYTES


def _control_groups(root: Path) -> Iterator[tuple[int, int]]:
    """(limit, used) in bytes of each group that this process is in and that has a limit. Files that can be given up are not used."""
    try:
        lines = (root / "proc" / "self" / "cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, _, rest = line.partition(":")
        kinds, _, path = rest.partition(":")
        if kinds == "":
            top, limit, used, files = root / "sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"
        elif "memory" in kinds.split(","):
            top, limit, used, files = (
                root / "sys/fs/cgroup/memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
                "total_inactive_file",
            )
        else:
            continue
        own = PurePosixPath(path.lstrip("/"))
        for group in (own, *own.parents):  # a container may see its own group at the top only
            with suppress(OSError, ValueError):
                most, taken = (int((top / group / name).read_text()) for name in (limit, used))  # "max" is no number: no limit
                if most < _NO_LIMIT:
                    yield most, taken - _number(top / group / "memory.stat", files)


def _number(path: Path, name: str) -> int:
    for line in path.read_text().splitlines():
        key, _, value = line.partition(" ")
        if key == name:
            return int(value)
    return 0
