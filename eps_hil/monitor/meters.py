"""Rates and ages by the stamps of frames: no clock of its own."""

import math
from collections import deque

_BUCKET_NS = 50_000_000
_BUCKETS = 20


class RateMeter:
    """How much came per second, over the last second before an instant."""

    def __init__(self) -> None:
        self._buckets: deque[list[float]] = deque(maxlen=_BUCKETS + 2)
        self._first_ns: int | None = None

    def add(self, t_ns: int, amount: float = 1.0) -> None:
        """Something came at ``t_ns``."""
        index = t_ns // _BUCKET_NS
        if self._first_ns is None:
            self._first_ns = t_ns
        elif self._buckets and index < self._buckets[-1][0] - _BUCKETS:  # the clock was set back
            self._first_ns = t_ns
            self._buckets.clear()
        if self._buckets and self._buckets[-1][0] == index:
            self._buckets[-1][1] += amount
        else:
            self._buckets.append([index, amount])

    def per_s(self, now_ns: int) -> float:
        """Over whole buckets that have ended; NaN before the first one has."""
        last = now_ns // _BUCKET_NS  # not ended yet
        if self._first_ns is None:
            return 0.0
        first = max(last - _BUCKETS, self._first_ns // _BUCKET_NS + 1)
        if last <= first:
            return float("nan")
        came = sum(amount for index, amount in self._buckets if first <= index < last)
        return came / ((last - first) * _BUCKET_NS * 1e-9)


class SignalTrack:
    """One mapped signal: its newest value and stamp, rate, and how many samples were no good."""

    def __init__(self, period_s: float | None) -> None:
        self.period_s = period_s
        self.value = float("nan")
        self.t_ns: int | None = None
        self.bad = 0
        self._rate = RateMeter()

    def take(self, t_ns: int, value: float) -> None:
        """A sample; NaN is one that the frame's checks refused."""
        self.value, self.t_ns = value, t_ns
        self.bad += math.isnan(value)
        self._rate.add(t_ns)

    def rate_hz(self, now_ns: int) -> float:
        """Samples in the last second."""
        return self._rate.per_s(now_ns)

    def age_s(self, now_ns: int) -> float:
        """Since the newest sample's instant; infinite without one."""
        return float("inf") if self.t_ns is None else (now_ns - self.t_ns) * 1e-9

    def verdict(self, now_ns: int) -> str:
        """``fine``, or what is wrong with it, in two words."""
        if self.t_ns is None:
            return "never seen"
        period = self.period_s or 0.1
        if self.age_s(now_ns) > max(5 * period, 0.1):
            return "silent"
        if math.isnan(self.value):
            return "bad sample"
        rate = self.rate_hz(now_ns)
        if self.period_s is None or math.isnan(rate):
            return "fine"
        if rate * period < 0.9:
            return "too slow"
        return "too fast" if rate * period > 1.1 else "fine"
