"""The same work for many recordings: in order, and nothing that goes wrong is swallowed."""

import os
import signal
import threading
import time

import pytest

from eps_hil.diagnosis.data.side_by_side import each


def test_results_come_in_the_order_of_what_was_given() -> None:
    def slower_first(k: int) -> int:
        time.sleep(0.002 * (10 - k))
        return 10 * k

    assert each(slower_first, range(10)) == [10 * k for k in range(10)]
    assert each(slower_first, []) == []


def test_what_goes_wrong_in_one_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        each(lambda k: 1 // k, [2, 1, 0])


def test_of_several_that_go_wrong_the_first_is_raised_and_the_rest_is_left() -> None:
    done = []

    def work(k: int) -> None:
        if k == 0:
            time.sleep(0.05)  # goes wrong after number 1 did
        if k < 2:
            raise ValueError(f"number {k}")
        time.sleep(0.01)
        done.append(k)

    with pytest.raises(ValueError, match="number 0"):
        each(work, range(200))
    assert len(done) < 20


def test_an_interrupt_ends_it_soon() -> None:
    done = []

    def work(k: int) -> None:
        if k == 3:
            signal.raise_signal(signal.SIGINT)
        time.sleep(0.005)
        done.append(k)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
    try:
        with pytest.raises(KeyboardInterrupt):
            each(work, range(2000))
    finally:
        signal.signal(signal.SIGINT, before)
    stopped = len(done)
    time.sleep(0.05)
    assert len(done) <= stopped + (os.cpu_count() or 1)
    assert stopped < 200


def test_every_core_works_and_the_calling_thread_is_one_of_them() -> None:
    cores = os.cpu_count() or 1
    together = threading.Barrier(cores)

    def work(_: int) -> int:
        together.wait(20.0)  # nobody gets past it alone
        return threading.get_ident()

    assert {threading.get_ident()} <= set(each(work, range(cores)))


def test_work_that_asks_for_more_does_it_itself() -> None:
    """The threads are taken: waiting for one of them would never end."""

    def row(i: int) -> list[int]:
        here = threading.get_ident()

        def cell(j: int) -> int:
            assert threading.get_ident() == here
            return 10 * i + j

        return each(cell, range(4))

    rows = each(row, range(6))
    assert rows == [[10 * i + j for j in range(4)] for i in range(6)]
    assert each(lambda k: k, range(3)) == [0, 1, 2]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_has_threads_of_its_own() -> None:
    assert each(abs, [-1, -2, -3]) == [1, 2, 3]
    child = os.fork()
    if child == 0:
        os._exit(0 if each(abs, [-4, -5, -6]) == [4, 5, 6] else 1)
    until = time.monotonic() + 20.0
    while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
        if time.monotonic() > until:
            os.kill(child, 9)
            os.waitpid(child, 0)
            pytest.fail("the child waits for threads that only its parent has")
        time.sleep(0.01)
    assert os.waitstatus_to_exitcode(ended[1]) == 0
