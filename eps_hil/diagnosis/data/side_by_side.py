"""The same work for each of many recordings, on all cores: what is compiled frees the GIL."""

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import TypeVar

Taken = TypeVar("Taken")
Given = TypeVar("Given")

_mine = threading.local()


def each(work: Callable[[Taken], Given], things: Iterable[Taken]) -> list[Given]:
    """``work`` of every thing, in their order; what the first of them raises is raised.

    The calling thread works too: a pool of one thread for each core, made anew for every call and
    handed one thing at a time, gave much of its time away. Work that itself calls this does its own
    things one after the other: the cores are taken.
    """
    given = list(things)
    if getattr(_mine, "at_work", False):
        return [work(one) for one in given]
    done: dict[int, Given] = {}
    wrong: dict[int, BaseException] = {}
    numbers = iter(range(len(given)))

    def take() -> None:
        _mine.at_work = True
        try:
            for k in numbers:  # each number goes to one thread only
                if wrong:
                    return
                try:
                    done[k] = work(given[k])
                except BaseException as error:
                    wrong[k] = error
        finally:
            _mine.at_work = False

    beside = min(_cores(), len(given)) - 1
    others = [_pool().submit(take) for _ in range(beside)]
    try:
        take()
        wait(others)
    except BaseException as error:  # Ctrl-C between two things
        wrong[-1] = error
    if wrong:
        raise wrong[min(wrong)]
    return [done[k] for k in range(len(given))]


def _cores() -> int:
    return os.cpu_count() or 1


@cache
def _pool() -> ThreadPoolExecutor:
    """Threads beside the calling one, kept from call to call."""
    return ThreadPoolExecutor(max(1, _cores() - 1), "eps-hil-each")


os.register_at_fork(after_in_child=_pool.cache_clear)  # a child has none of its parent's threads
