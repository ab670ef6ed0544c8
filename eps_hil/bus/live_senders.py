"""Whether somebody else is talking: two senders of one id ruin both.

A receiver cannot tell the two apart, and a rig that gets torque and position from two sources at
once moves by neither.
"""

import time
from collections.abc import Callable, Collection, Iterable
from typing import Protocol

from eps_hil.bus.frame import Frame
from eps_hil.errors import BusError

LISTEN_S = 0.3
"""For how long it is listened before the first frame, where nothing else is asked for."""
_LISTEN_ON_S = 1.0
_LOOK_NS = 20_000_000

Key = tuple[int, bool]
"""(id, whether it has 29 bits)."""


class Hears(Protocol):
    """What is needed of a port."""

    @property
    def name(self) -> str:
        """What it is called in an error."""

    def recv(self, timeout_s: float) -> list[Frame]:
        """All pending frames, waiting up to ``timeout_s``."""


class LiveSenders:
    """Hears who else is on the bus and ends what would talk over somebody.

    A port does not deliver what it sends itself, so whatever arrives is somebody else's. ``ours``:
    what is to be sent; ``remedy``: what else can be done about ids, in an error.
    """

    def __init__(
        self, port: Hears, ours: Collection[Key], remedy: Callable[[str], str] | None = None
    ) -> None:
        self._port, self._remedy = port, remedy
        self._ours = set(ours)
        self._heard: set[Key] = set()
        self._next_ns = 0

    def listen(self, listen_s: float) -> None:
        """Before the first frame, also to what came since the port was opened;
        :class:`BusError` names the ids that are taken."""
        until_s = time.monotonic() + max(listen_s, 0.0)
        while True:
            left_s = until_s - time.monotonic()
            frames = self._port.recv(max(left_s, 0.0))
            self._hear(frames)
            if left_s <= 0.0 and (not frames or left_s < -_LISTEN_ON_S):
                break
        self._refuse(self._heard & self._ours, "are sent by somebody else already")

    def look(self) -> None:
        """While playing: whoever began to send meanwhile; at most every 20 ms a look."""
        now_ns = time.monotonic_ns()
        if now_ns >= self._next_ns:
            self._next_ns = now_ns + _LOOK_NS
            self.hear(self._port.recv(0.0))

    def hear(self, frames: Iterable[Frame]) -> None:
        """Frames that came in while sending; :class:`BusError` names the ids that are taken."""
        self._hear(frames)
        self._refuse(self._heard & self._ours, "are now sent by somebody else too")

    def sending(self, frame: Frame) -> None:
        """Asked before each frame: an id that the first frames of the log did not have."""
        key = (frame.can_id, frame.extended)
        if key not in self._ours:
            self._ours.add(key)
            self._refuse(self._heard & {key}, "are sent by somebody else")

    def _hear(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            if not (frame.own or frame.error or frame.remote):
                self._heard.add((frame.can_id, frame.extended))

    def _refuse(self, taken: Collection[Key], words: str) -> None:
        if taken:
            ids = ",".join(f"0x{can_id:X}" for can_id, _ in sorted(taken))
            other = "" if self._remedy is None else f", or {self._remedy(ids)}"
            raise BusError(
                f"{self._port.name}: the ids {ids} {words}; nothing is talked over: "
                f"end that sender{other}"
            )
