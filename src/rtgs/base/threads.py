"""Work on many items at once, by threads, for kernels that release the GIL."""

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
AT_ONCE = 8  # items that are handed to the threads together: to hand over one costs as much as the work on a small picture


def in_order(
    work: Callable[[A], B], items: Sequence[A], threads: int, is_here: Callable[[A], bool] = lambda item: False
) -> Generator[B]:
    """`work` of each item, in the items' order.

    Items are handed to the threads in parts of `AT_ONCE` / `threads`, at least one. No more than `threads` + 1 parts are computed before
    their results are asked for.

    Args:
        is_here: for which items the calling thread does the work itself, in their turn: those whose kernels are parallel.
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
    """Within the block, Numba has at most so many threads and PyTorch one.

    For work in which PyTorch's operations are small next to the package's kernels. More of its threads would mostly wait, and their
    number would change the last digits of sums.
    """
    before = torch.get_num_threads(), nb.get_num_threads()
    try:
        torch.set_num_threads(1)
        nb.set_num_threads(min(numba, before[1]))
        yield
    finally:
        torch.set_num_threads(before[0])
        nb.set_num_threads(before[1])
