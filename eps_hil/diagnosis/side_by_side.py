"""The same work for each of many recordings, on all cores: what is compiled frees the GIL."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Taken = TypeVar("Taken")
Given = TypeVar("Given")


def each(work: Callable[[Taken], Given], things: Iterable[Taken]) -> list[Given]:
    """``work`` of every thing, in their order; what one raises is raised."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, things))
