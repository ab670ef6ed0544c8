"""How a run on the event loop ends: asked to, or by the first error, wherever that comes up."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any


class Ending:
    """Set once the run shall end; keeps the first error, which :meth:`raise_failure` raises.

    To be made and used in the loop's thread. ``on_error`` is told of every error that ends a run.
    """

    def __init__(self, on_error: Callable[[BaseException], None] | None = None) -> None:
        self.failure: BaseException | None = None
        self._done = asyncio.Event()
        self._on_error = on_error

    @property
    def asked_for(self) -> bool:
        """Whether the run shall end."""
        return self._done.is_set()

    def ask(self) -> None:
        """End the run."""
        self._done.set()

    def fail(self, error: BaseException) -> None:
        """End the run with an error; of several the first is kept."""
        self.failure = self.failure or error
        if self._on_error is not None:
            self._on_error(error)
        self._done.set()

    def raise_failure(self) -> None:
        """What the run ended with, if that was an error."""
        if self.failure is not None:
            raise self.failure

    async def wait(self, timeout_s: float | None) -> None:
        """Until the run shall end, or ``timeout_s`` (None: without limit)."""
        try:
            await asyncio.wait_for(self._done.wait(), timeout_s)
        except TimeoutError:
            return

    def watch_over(self, loop: asyncio.AbstractEventLoop) -> None:
        """Exceptions in callbacks of the loop end the run, instead of being printed."""
        loop.set_exception_handler(self._on_exception)

    def task(
        self, loop: asyncio.AbstractEventLoop, job: Coroutine[Any, Any, None]
    ) -> "asyncio.Task[None]":
        """A task whose error ends the run."""
        task = loop.create_task(job)
        task.add_done_callback(self._on_task_done)
        return task

    def _on_exception(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self.fail(context.get("exception") or RuntimeError(context["message"]))

    def _on_task_done(self, task: "asyncio.Task[None]") -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self.fail(error)
