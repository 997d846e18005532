"""Work by threads: in order, not far ahead, and errors arrive."""

from __future__ import annotations

import threading
import time

import numba as nb
import pytest
import torch

from rtgs.base.threads import AT_ONCE, in_order, threads_at_most


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 7, 200])
def test_results_come_in_order(threads: int, count: int) -> None:
    def work(item: int) -> int:
        time.sleep(1e-4 * (item % 3))
        return item * item

    assert list(in_order(work, range(count), threads)) == [i * i for i in range(count)]


def test_more_than_one_thread_works_and_what_is_here_stays_here() -> None:
    barrier, main = threading.Barrier(2, timeout=10), threading.get_ident()

    def work(item: int) -> int:
        if item in (0, 99):  # two that wait for one another
            barrier.wait()
        return threading.get_ident()

    items = [0, *range(1, 4), 99, *range(4, 7)]
    assert main not in set(in_order(work, items, 4))
    at = list(in_order(lambda item: threading.get_ident(), range(50), 2, lambda item: item >= 40))
    assert set(at[40:]) == {main} and main not in at[:36]


def test_work_is_not_done_far_ahead() -> None:
    done: list[int] = []
    results = in_order(done.append, range(1000), 2)
    next(results)
    time.sleep(0.05)
    assert len(done) <= 2 * AT_ONCE
    results.close()


def test_an_error_arrives_and_ends_the_work() -> None:
    def work(item: int) -> int:
        if item == 20:
            raise KeyError("twenty")
        return item

    seen = []
    with pytest.raises(KeyError, match="twenty"):
        for value in in_order(work, range(1000), 3):
            seen.append(value)
    assert seen == list(range(len(seen))) and len(seen) <= 20


@pytest.mark.parametrize("most", [1, 2, 99])
def test_threads_are_given_back(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    before, count = torch.get_num_threads(), [4]  # of Numba's, of which there may be one here
    monkeypatch.setattr(nb, "get_num_threads", lambda: count[0])
    monkeypatch.setattr(nb, "set_num_threads", lambda n: count.__setitem__(0, n))
    try:
        torch.set_num_threads(3)
        with pytest.raises(ZeroDivisionError), threads_at_most(most):
            assert torch.get_num_threads() == 1 and count == [min(most, 4)]
            raise ZeroDivisionError
        assert torch.get_num_threads() == 3 and count == [4]
    finally:
        torch.set_num_threads(before)
