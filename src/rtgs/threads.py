"""Work on many items at once, by threads, for kernels that let go of Python's lock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def in_order(
    work: Callable[[A], B], items: Iterable[A], threads: int, is_here: Callable[[A], bool] = lambda item: False
) -> Iterator[B]:
    """`work` of each item, in their order; what is not yet asked for is at most a few items ahead.

    Args:
        is_here: for which items this thread does the work itself, in their turn: those whose kernels are parallel.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    waiting: deque[Future[B] | A] = deque()

    def next_result() -> B:
        first = waiting.popleft()
        return first.result() if isinstance(first, Future) else work(first)

    with ThreadPoolExecutor(threads) as pool:
        for item in items:
            waiting.append(item if is_here(item) else pool.submit(work, item))
            if len(waiting) > 2 * threads:
                yield next_result()
        while waiting:
            yield next_result()
