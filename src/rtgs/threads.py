"""Work on many items at once, by threads, for kernels that let go of Python's lock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")
AT_ONCE = 8  # items that a thread takes at the most: to hand over one costs as much as a small picture's work


def in_order(
    work: Callable[[A], B], items: Sequence[A], threads: int, is_here: Callable[[A], bool] = lambda item: False
) -> Iterator[B]:
    """`work` of each item, in their order; only a few are done before they are asked for.

    Args:
        is_here: for which items this thread does the work itself, in their turn: those whose kernels are parallel.
    """
    if threads <= 1:
        yield from map(work, items)
        return
    size = min(max(len(items) // (2 * threads), 1), AT_ONCE)
    waiting: deque[Future[list[B]] | Sequence[A]] = deque()

    def next_results() -> Sequence[B]:
        first = waiting.popleft()
        return first.result() if isinstance(first, Future) else [work(item) for item in first]

    def some(part: Sequence[A]) -> list[B]:
        return [work(item) for item in part]

    with ThreadPoolExecutor(threads) as pool:
        for start in range(0, len(items), size):
            part = items[start : start + size]
            waiting.append(part if any(map(is_here, part)) else pool.submit(some, part))
            if len(waiting) > 2 * threads:
                yield from next_results()
        while waiting:
            yield from next_results()
