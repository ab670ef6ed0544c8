"""Periodic jobs beside the estimates: whatever goes wrong in them is said, counted and survived."""

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine
from typing import Any

_PAUSE_S = 1.0


class PeriodicJobs:
    """The jobs of one run; ``failures`` counts the errors of each by its name."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._failing: set[str] = set()
        self.failures: Counter[str] = Counter()
        self._due: dict[str, Callable[[], None]] = {}

    async def every(self, what: str, period_s: float, act: Callable[[], None]) -> None:
        """``act`` every ``period_s`` until cancelled; an error is said once until it works."""
        while True:
            await asyncio.sleep(period_s)
            self._do(what, act)

    async def between(self, what: str, period_s: float, act: Callable[[], None]) -> None:
        """As :meth:`every`, but just after an answer, where no frame has to wait for it.

        Where no answer comes for a period it is done all the same.
        """
        while True:
            await asyncio.sleep(period_s)
            if what in self._due:
                self._do(what, act)
            self._due[what] = act

    def answered(self) -> None:
        """Do what waited for this moment."""
        if self._due:
            due, self._due = self._due, {}
            for what, act in due.items():
                self._do(what, act)

    def _do(self, what: str, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception as error:  # whatever it is, the estimates are worth more
            self._failed(what, error)
        else:
            self._worked(what)

    async def keep(self, what: str, job: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """A job with a loop of its own; begun again after an error."""
        while True:
            try:
                await job()
            except Exception as error:
                self._failed(what, error)
                task = asyncio.current_task()
                if task is not None and task.cancelling():
                    return  # it failed as it ended: begun again it would never end
                await asyncio.sleep(_PAUSE_S)
            else:
                return

    def _failed(self, what: str, error: Exception) -> None:
        self.failures[what] += 1
        if what not in self._failing:
            self._failing.add(what)
            told = " ".join(f"{type(error).__name__}: {error}".split())
            self._say(f"trouble    {what}: {told}; the estimates go on")

    def _worked(self, what: str) -> None:
        if what in self._failing:
            self._failing.discard(what)
            self._say(f"trouble    {what}: over, {self.failures[what]} failures so far")
