"""What was wrong and is over: for whoever looks at a page that has run all night."""

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

MOST = 100
AGAIN_S = 2.0
"""What comes back sooner is the same event, counted."""
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])")


@dataclass(slots=True)
class Event:
    """The latest words for a problem, from when to when (s since the epoch; None: still).

    ``times``: how often it came within that.
    """

    text: str
    from_s: float
    to_s: float | None = None
    times: int = 1


class Events:
    """The last :data:`MOST`, the oldest first. A problem whose numbers alone move is the same."""

    def __init__(self) -> None:
        self._all: deque[Event] = deque(maxlen=MOST)
        self._newest: dict[str, Event] = {}

    def see(self, now_s: float, problems: Sequence[str]) -> None:
        """What is wrong at ``now_s``."""
        said = {_NUMBER.sub("#", text): text for text in problems}
        for kind, event in list(self._newest.items()):
            if kind in said:
                event.text = said[kind]
                if event.to_s is not None:
                    event.to_s, event.times = None, event.times + 1
            elif event.to_s is None:
                event.to_s = now_s
            elif now_s - event.to_s > AGAIN_S:
                del self._newest[kind]
        for kind, text in said.items():
            if kind not in self._newest:
                self._newest[kind] = Event(text, now_s)
                self._all.append(self._newest[kind])

    def content(self) -> list[dict[str, Any]]:
        """JSON-ready."""
        return [asdict(event) for event in self._all]
