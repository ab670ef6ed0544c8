"""Datagrams that differ from one seen before in nothing but time and payload, read by comparison.

A bus carries a few messages over and over. What msgpack makes of one is the same bytes each time,
but for the eight of the time stamp and those of the payload; where all others are equal, so is
what they say, and unpacking them again takes three times as long as comparing them.
"""

from typing import NamedTuple

from eps_hil.bus.frame import Frame

_TIME_KEY, _DATA_KEY = b"\xa9timestamp\xcb", b"\xa4data\xc4"
_TIME_BYTES = 8
_MOST = 1_000
"""Messages that are remembered: more ids than any bus has in use, and a bound for a flood."""


class Kind(NamedTuple):
    """What all datagrams of one envelope say; ``wanted``: whether the port hands them on."""

    can_id: int
    extended: bool
    fd: bool
    brs: bool
    wanted: bool


class Envelopes:
    """What was seen on one port. Error frames and remote requests are never remembered."""

    def __init__(self) -> None:
        self._cuts: dict[int, tuple[int, int, int, int]] = {}
        self._kinds: dict[bytes, Kind] = {}

    def look(self, data: bytes) -> tuple[Kind, bytes] | None:
        """Kind and payload of a datagram whose envelope is known."""
        cuts = self._cuts.get(len(data))
        if cuts is None:
            return None
        a, b, c, d = cuts
        kind = self._kinds.get(data[:a] + data[b:c] + data[d:])
        return None if kind is None else (kind, data[c:d])

    def learn(self, data: bytes, frame: Frame, wanted: bool) -> None:
        """Remember the envelope of a datagram that was unpacked to ``frame``."""
        place, at = data.find(_TIME_KEY), data.find(_DATA_KEY)
        a, c = place + len(_TIME_KEY), at + len(_DATA_KEY) + 1
        b, d = a + _TIME_BYTES, c + len(frame.data)
        first = place == 1 and b <= at  # ahead of all that could look like a key
        first &= data.count(_DATA_KEY) == 1  # a payload may hold it by accident: next time
        if not first or frame.remote or frame.error or len(self._kinds) >= _MOST:
            return
        if data[c - 1] != len(frame.data) or data[c:d] != frame.data:
            return
        cuts = self._cuts.setdefault(len(data), (a, b, c, d))
        if cuts == (a, b, c, d):  # of two layouts of one length the first one has the short way
            kind = Kind(frame.can_id, frame.extended, frame.fd, frame.brs, wanted)
            self._kinds[data[:a] + data[b:c] + data[d:]] = kind
