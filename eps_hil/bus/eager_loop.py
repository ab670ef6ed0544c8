"""An event loop that hands the bus its turn as soon as the kernel says that frames are there.

asyncio puts a handle of each ready socket into a queue, and calls it from there in a context of
its own: as long again as reading a frame. The bus's callback is called by the selector itself.
"""

import asyncio
import selectors
from collections.abc import Callable
from typing import Any


class _EagerSelector(selectors.DefaultSelector):
    """Calls those of ``eager`` itself; everything else is asyncio's."""

    def __init__(self) -> None:
        super().__init__()
        self.eager: dict[int, Callable[[], None]] = {}

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(timeout)
        eager = self.eager
        if not eager or not found:
            return found
        if len(found) == 1 and found[0][0].fd in eager:  # as almost always
            eager[found[0][0].fd]()
            return []
        others = []
        for key, events in found:
            call = eager.get(key.fd)
            if call is None:
                others.append((key, events))
            else:
                call()
        return others


class EagerLoop(asyncio.SelectorEventLoop):
    """asyncio's loop with :meth:`add_eager_reader` beside ``add_reader``."""

    def __init__(self) -> None:
        self._eager = _EagerSelector()
        super().__init__(self._eager)

    def add_eager_reader(self, fd: int, call: Callable[[], None]) -> None:
        """``call`` whenever ``fd`` is readable; what it raises goes to the exception handler."""

        def guarded() -> None:
            try:
                call()
            except (SystemExit, KeyboardInterrupt):
                raise
            except BaseException as error:
                context: dict[str, Any] = {"message": f"Exception in {call!r}", "exception": error}
                self.call_exception_handler(context)

        self._eager.register(fd, selectors.EVENT_READ)
        self._eager.eager[fd] = guarded

    def remove_eager_reader(self, fd: int) -> None:
        """No more calls; unknown to it is no error."""
        if self._eager.eager.pop(fd, None) is not None:
            self._eager.unregister(fd)
