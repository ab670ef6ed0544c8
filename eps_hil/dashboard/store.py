"""The newest samples of every trace (or all of a recording), and cuts of them for a screen."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.dashboard.decimate import Float32, Float64, Int64, at_instants, least_and_greatest
from eps_hil.dashboard.traces import AT_ONE_INSTANT, KEPT, NAMES

Block = tuple[Int64, Float64]
_FIRST = 1024
_LIVE_NS = 300_000_000
"""A trace that lags so far behind the newest is not waited for."""
_BACK_NS = 1_000_000_000
"""A stamp that goes back so far is a clock that was set; all that was before it is forgotten."""
_KEPT_CUTS = 16


class Track:
    """One trace: samples with strictly increasing stamps, the last ``length_ns`` of them."""

    def __init__(self, length_ns: int | None = None) -> None:
        self._length_ns = length_ns
        self._t_ns = np.empty(_FIRST, np.int64)
        self._value = np.empty(_FIRST, np.float64)
        self._begin = self._end = 0

    @property
    def t_ns(self) -> Int64:
        """Stamps, shape (n,)."""
        return self._t_ns[self._begin : self._end]

    @property
    def value(self) -> Float64:
        """Values, shape (n,)."""
        return self._value[self._begin : self._end]

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample."""
        return int(self._t_ns[self._end - 1]) if self._end > self._begin else None

    def append(self, t_ns: Int64, value: Float64) -> None:
        """Samples in order of time; those that are not newer than what is there are left out."""
        newest = self.newest_ns
        floor = np.iinfo(np.int64).min if newest is None else newest
        rising = t_ns > np.maximum.accumulate(np.concatenate(([floor], t_ns[:-1])))
        t_ns, value = t_ns[rising], value[rising]
        if not len(t_ns):
            return
        if self._end + len(t_ns) > len(self._t_ns):
            self._make_room(len(t_ns))
        end = self._end + len(t_ns)
        self._t_ns[self._end : end], self._value[self._end : end] = t_ns, value
        self._end = end
        if self._length_ns is not None:
            self._begin += int(np.searchsorted(self.t_ns, t_ns[-1] - self._length_ns))

    def _make_room(self, more: int) -> None:
        t_ns, value = self.t_ns, self.value
        size = len(self._t_ns)
        if size < 1.5 * (len(t_ns) + more):
            size = 2 * (len(t_ns) + more)
        new_t, new_value = np.empty(size, np.int64), np.empty(size, np.float64)
        new_t[: len(t_ns)], new_value[: len(t_ns)] = t_ns, value
        self._t_ns, self._value, self._begin, self._end = new_t, new_value, 0, len(t_ns)

    def begin_with_a_value(self) -> None:
        """Forget the samples without a value that come before the first with one."""
        known = np.isfinite(self.value)
        self._begin = self._begin + int(np.argmax(known)) if known.any() else self._end

    def clear(self) -> None:
        """Forget everything."""
        self._begin = self._end = 0


@dataclass(frozen=True, slots=True)
class Cut:
    """``n`` buckets from ``begin_ns`` on, each ``bucket_ns`` long.

    ``strips``: shape (traces, 2n), least and greatest; ``instants``: shape (quantities, 2n), at a
    quarter and three quarters of each bucket. NaN where there is nothing.
    """

    begin_ns: int
    bucket_ns: int
    n: int
    strips: Float32
    instants: Float32


class Store:
    """All traces. ``length_s`` None: everything is kept (a recording)."""

    def __init__(self, length_s: float | None = None) -> None:
        length_ns = None if length_s is None else round(length_s * 1e9)
        self.tracks = {name: Track(length_ns) for name in KEPT}
        self._drawn = [self.tracks[name] for name in NAMES]
        self.epoch = 0
        """Goes up when a clock that was set back made the store begin anew."""
        self._cuts: dict[tuple[int, int, int], Cut] = {}

    def append(self, blocks: Mapping[str, Block]) -> None:
        """Samples by trace; what is not drawn may be of long ago."""
        newest = self.newest_ns
        starts = [int(t_ns[0]) for name, (t_ns, _) in blocks.items() if len(t_ns) and name in NAMES]
        if newest is not None and starts and max(starts) < newest - _BACK_NS:
            for track in self.tracks.values():
                track.clear()
            self.epoch += 1
            self._cuts.clear()
        for name, (t_ns, value) in blocks.items():
            self.tracks[name].append(t_ns, value)

    @property
    def newest_ns(self) -> int | None:
        """Of what is drawn; None where there is no sample."""
        newest = [t for track in self._drawn if (t := track.newest_ns) is not None]
        return max(newest, default=None)

    @property
    def oldest_ns(self) -> int | None:
        """Of what is drawn; None where there is no sample."""
        first = [int(track.t_ns[0]) for track in self._drawn if len(track.t_ns)]
        return min(first, default=None)

    @property
    def horizon_ns(self) -> int | None:
        """Up to where every trace that still comes is complete: estimates come later than speed."""
        newest = [t for track in self._drawn if (t := track.newest_ns) is not None]
        if not newest:
            return None
        return min(t for t in newest if t >= max(newest) - _LIVE_NS)

    def cut(self, begin_ns: int, bucket_ns: int, n: int) -> Cut:
        """``n`` buckets; pages that show the same share one."""
        key = begin_ns, bucket_ns, n
        found = self._cuts.get(key)
        if found is None:
            found = self._made(*key)
            while len(self._cuts) >= _KEPT_CUTS:
                del self._cuts[next(iter(self._cuts))]
            self._cuts[key] = found
        return found

    def _made(self, begin_ns: int, bucket_ns: int, n: int) -> Cut:
        strips = np.stack([
            least_and_greatest(track.t_ns, track.value, begin_ns, bucket_ns, n)
            for track in self._drawn
        ])  # fmt: skip
        quarters = begin_ns + bucket_ns // 4 + bucket_ns * np.arange(2 * n, dtype=np.int64) // 2
        instants = np.stack([self.at(name, quarters) for name in AT_ONE_INSTANT])
        return Cut(begin_ns, bucket_ns, n, strips, instants.astype(np.float32))

    def at(self, name: str, at_ns: npt.NDArray[np.int64]) -> Float64:
        """A trace read off at instants."""
        track = self.tracks[name]
        return at_instants(track.t_ns, track.value, at_ns)
