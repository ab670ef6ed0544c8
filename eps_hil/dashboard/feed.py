"""What one page is sent, and when: no queue, but a place in the store that all pages share.

A page says how much it has drawn. One that is slow has its next message later, and in it what came
meanwhile, never more than its window: it is given less, and nobody waits for it.
"""

from eps_hil.dashboard.store import Store
from eps_hil.dashboard.wire import Kind, to_page

IN_FLIGHT = 2
"""Messages that a page may have and not have drawn."""
_LEAST_NS, _MOST_PIXELS = 1_000_000, 4096
_LONGEST_S = 3600.0


def bucket_for(length_s: float, pixels: int) -> int:
    """Length of a bucket in ns: one a pixel, a whole number of milliseconds."""
    pixels = min(max(pixels, 50), _MOST_PIXELS)
    return max(-(-round(length_s * 1e9) // pixels // _LEAST_NS) * _LEAST_NS, _LEAST_NS)


def window_of(length_s: float) -> float:
    """What a page asked for, kept within reason."""
    return min(max(float(length_s), 0.5), _LONGEST_S)


class Feed:
    """The state of one page."""

    def __init__(self) -> None:
        self._bucket_ns = 0
        self._buckets = 0
        self._next_ns: int | None = None
        self._epoch = 0
        self._sent = self._drawn = 0

    def view(self, length_s: float, pixels: int) -> None:
        """The page shows the last ``length_s`` on so many pixels: it is sent anew."""
        length_s = window_of(length_s)
        self._bucket_ns = bucket_for(length_s, pixels)
        self._buckets = -(-round(length_s * 1e9) // self._bucket_ns)
        self._next_ns = None

    def drawn(self, number: int) -> None:
        """The page has drawn message ``number`` and those before it."""
        if self._drawn < number <= self._sent:
            self._drawn = number

    @property
    def waits(self) -> bool:
        """Whether the page has as much as it may have undrawn."""
        return self._sent - self._drawn >= IN_FLIGHT

    def next(self, store: Store) -> bytes | None:
        """The next message; None while there is nothing new, or the page has not drawn enough."""
        horizon = store.horizon_ns
        if not self._bucket_ns or horizon is None or self.waits:
            return None
        end = horizon // self._bucket_ns
        if self._epoch != store.epoch:
            self._epoch, self._next_ns = store.epoch, None
        kind = Kind.GOES_ON
        if self._next_ns is None or end - self._next_ns // self._bucket_ns > self._buckets:
            kind, first = Kind.BEGINS, end - self._buckets
        else:
            first = self._next_ns // self._bucket_ns
        if end <= first:
            return None
        self._next_ns = end * self._bucket_ns
        self._sent += 1
        cut = store.cut(first * self._bucket_ns, self._bucket_ns, end - first)
        return to_page(cut, kind, self._sent)


def answer(store: Store, begin_s: float, end_s: float, pixels: int, number: int) -> bytes | None:
    """A stretch of the past on so many pixels; None where it is empty or senseless."""
    if not 0.0 < end_s - begin_s < 1e7:
        return None
    bucket_ns = bucket_for(end_s - begin_s, pixels)
    first, end = round(begin_s * 1e9) // bucket_ns, -(-round(end_s * 1e9) // bucket_ns)
    cut = store.cut(first * bucket_ns, bucket_ns, end - first)
    return to_page(cut, Kind.ANSWERS, number)
