"""Work on many items at once, by threads, for kernels that let go of Python's lock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import numba as nb
import torch

A = TypeVar("A")
B = TypeVar("B")
AT_ONCE = 8  # items that are handed over together, of all threads: to hand over one costs as much as a small picture's work


def in_order(
    work: Callable[[A], B], items: Sequence[A], threads: int, is_here: Callable[[A], bool] = lambda item: False
) -> Generator[B]:
    """`work` of each item, in their order; no more than two a thread, or `AT_ONCE` and a half, are done before they are asked for.

    Args:
        is_here: for which items this thread does the work itself, in their turn: those whose kernels are parallel.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    size = max(min(AT_ONCE, len(items)) // threads, 1)
    waiting: deque[Future[list[B]] | Sequence[A]] = deque()

    def some(part: Sequence[A]) -> list[B]:
        return [work(item) for item in part]

    def next_results() -> list[B]:
        first = waiting.popleft()
        return first.result() if isinstance(first, Future) else some(first)

    pool = ThreadPoolExecutor(threads)
    try:
        for start in range(0, len(items), size):
            part = items[start : start + size]
            waiting.append(part if any(map(is_here, part)) else pool.submit(some, part))
            if len(waiting) > threads:
                yield from next_results()
        while waiting:
            yield from next_results()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def threads_at_most(numba: int) -> Iterator[None]:
    """So many of Numba's, and of PyTorch's the calling one alone: where PyTorch's operations are small next to kernels of our own, its
    other threads mostly wait, and how many there are would change last digits of sums."""
    before = torch.get_num_threads(), nb.get_num_threads()
    try:
        torch.set_num_threads(1)
        nb.set_num_threads(min(numba, before[1]))
        yield
    finally:
        torch.set_num_threads(before[0])
        nb.set_num_threads(before[1])
