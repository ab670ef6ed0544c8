"""How sure the age of an estimate is: what waited, and instants that moved against the stamps.

Asked by the service's core frame by frame, and of a whole log afterwards.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.lanes import Lanes
from eps_hil.estimation.levels import LevelChange
from eps_hil.estimation.stream import Estimate, Rows, StreamEstimator, Trace, ends
from eps_hil.estimation.validity import Reason
from eps_hil.growing import Growing, blocks
from eps_hil.series import Arrivals

AGE_LIMIT_S = 0.02
"""By how much an estimate may be older than its look-back and be called valid."""
AGE_DOUBT_N = 50.0
"""By how much the force may change in the time by which frames wait, or the clock was set."""
_LATE_NS = 1_500_000  # a move of the line, or a lateness, that counts
_WINDOW_NS = 5_000_000  # frames that waited catch up within one to two of these
_RATE_MEMORY = 400  # sync frames after which nothing is left of a rate
_STALE = int(Reason.STALE)

Ints = npt.NDArray[np.int64]


class Estimator(Protocol):
    """What is needed of :class:`~eps_hil.estimation.stream.StreamEstimator`."""

    def force_of_shift_n(self, shift_ns: int) -> float:
        """By how much the force is off (N) once instants moved."""


def aged(estimate: Estimate, age_ns: int, look_back_ns: int, limit_ns: int) -> Estimate:
    """The estimate, not valid where its age cannot be its look-back.

    Older by more than the limit: it waited. Younger by as much: the clock was set meanwhile, and
    what the age is nobody knows.
    """
    if abs(age_ns - look_back_ns) <= limit_ns:
        return estimate
    return estimate._replace(valid=False, reason=estimate.reason | Reason.STALE)


class AgeDoubt:
    """Whether the force may have changed by too much in the time that nobody is sure of.

    Where the line of the samples' instants moves against the stamps, the clock was set or the
    sender paused: the estimate's age is wrong by as much, until what was sampled before is out of
    the ``look_back_ns``. Frames that only waited catch up, and move no line. While none has for
    5 to 10 ms, by their counters alone, the sender may have paused as well: the least lateness of
    that time is in doubt, long before the line moves (which bursts may put off).
    """

    def __init__(self, look_back_ns: int) -> None:
        self._look_back_ns = look_back_ns
        self._late_ns, self._moved_ns, self._until_ns = 0, 0, 0
        self._window, self._lowest = -1, (0, 0, 0)
        self._t_ns, self._force_n, self._rate = 0, 0.0, 0.0

    def stale(self, estimate: Estimate, receive_ns: int, sample_ns: int) -> bool:
        """For each new estimate: whether its instant is too uncertain. N per ns inside."""
        since = estimate.t_ns - self._t_ns
        if since > 0:
            rate = abs(estimate.rack_force_n - self._force_n) / since
            self._rate = max(rate, 0.9 * self._rate) if since < 10 * _LATE_NS else 0.0
            self._t_ns, self._force_n = estimate.t_ns, estimate.rack_force_n
        elif since < 0:
            self._t_ns, self._rate = 0, 0.0
        late = receive_ns - sample_ns
        moved = self._late_ns - late
        self._late_ns = late
        if moved > _LATE_NS:
            self._moved_ns, self._until_ns = moved, receive_ns + self._look_back_ns
        if not 0 <= self._until_ns - receive_ns <= self._look_back_ns:
            self._moved_ns = 0
        return (self._moved_ns + self._waited(receive_ns, late)) * self._rate > AGE_DOUBT_N

    def _waited(self, receive_ns: int, late: int) -> int:
        """By how much all frames of the window and of the two before it were late at least."""
        window = receive_ns // _WINDOW_NS
        a, b, c = self._lowest
        if window != self._window:
            self._window, self._lowest = window, (b, c, late)
        elif late < c:
            self._lowest = a, b, late
        lowest = min(self._lowest)
        return lowest if lowest > _LATE_NS else 0


class ShiftDoubt:
    """Whether the force is off because the line of the samples' instants moved a moment ago.

    Until what was sampled before is out of the look-back, and out of the filters.
    """

    def __init__(self, look_back_ns: int, estimator: Estimator, moved_ns: int) -> None:
        self._until_ns, self._since_ns, self._shift = 0, 0, 0.0
        self._look_back_ns, self._estimator = look_back_ns, estimator
        self._moved_ns = moved_ns

    def stale(self, moved_ns: int, receive_ns: int) -> bool:
        """For each sync frame; ``moved_ns`` as of the decoder."""
        if moved_ns != self._moved_ns:
            since, self._since_ns = receive_ns - self._since_ns, receive_ns
            kept = 0.0 if not 0 <= since < self._look_back_ns else 1.0 - since / self._look_back_ns
            self._shift = kept * self._shift + moved_ns - self._moved_ns
            self._moved_ns = moved_ns
            if self._estimator.force_of_shift_n(round(self._shift)) > AGE_DOUBT_N:
                self._until_ns = receive_ns + 2 * self._look_back_ns
        return 0 < self._until_ns - receive_ns <= 2 * self._look_back_ns


def run_aged(
    stream: StreamEstimator,
    lanes: Lanes,
    arrivals: Arrivals,
    changes: Sequence[LevelChange],
    stretch: int,
) -> Trace:
    """As ``stream.run``, each estimate judged by the arrival of its sync frame, as live.

    The syncs are those that arrived; so many of them (``stretch``) are run through at once.
    """
    receive, sample, moved = arrivals
    look_back = round(stream.latency_s * 1e9)
    half = stream.timing.step_ns // 2
    shift = ShiftDoubt(look_back, stream, 0)
    stale = np.zeros(len(sample), bool)
    rows, newest, first = Rows(), Growing(np.int64), 0
    for end in ends(len(sample), stretch):
        mine = slice(first, end)
        cuts = np.flatnonzero(np.diff(moved[mine], prepend=moved[first - 1] if first else 0))
        made, begun = Rows(), len(rows)
        for cut in (first + cuts).tolist():
            made.add(stream.run(lanes, changes, cut + 1))
            changes = ()
            for k in range(cut, len(sample)):
                if k > cut and moved[k] != moved[k - 1]:
                    break
                stale[k] = shift.stale(int(moved[k]), int(receive[k]))
                if not stale[k]:
                    break
        made.add(stream.run(lanes, changes, end))
        changes = ()
        part = made.whole()
        rows.add(part)
        # the sync frame of each row, and the newest row of each sync frame
        count = end - first
        of = np.searchsorted(sample[mine], part.t_ns + look_back - half)
        last = np.searchsorted(of, np.arange(count), "right") - 1
        newest.add(np.maximum(last + begun, 0))
        if len(of):
            there = (last >= 0) & (of[np.maximum(last, 0)] == np.arange(count))
            age = receive[mine] - part.t_ns[np.maximum(last, 0)]
            stale[mine] |= there & (np.abs(age - look_back) > round(AGE_LIMIT_S * 1e9))
        first = end
    trace = rows.whole()
    _look_back_doubt(stale, trace, newest.whole(), arrivals, look_back)
    for at in blocks(len(trace.t_ns)):
        of = np.searchsorted(sample, trace.t_ns[at] + look_back - half)
        trace.reason[at][stale[np.minimum(of, len(sample) - 1)]] |= _STALE
    return trace


def _look_back_doubt(
    stale: npt.NDArray[np.bool_], trace: Trace, newest: Ints, arrivals: Arrivals, look_back_ns: int
) -> None:
    """Ask :class:`AgeDoubt` around the moves of the line that count, and where frames are late."""
    receive_ns, sample_ns = arrivals.receive_ns, arrivals.sample_ns
    earlier: list[int] = []
    for at in blocks(len(receive_ns) - 1):
        pair = slice(at.start, at.stop + 1)
        late = receive_ns[pair] - sample_ns[pair]
        stay = (late[:-1] > _LATE_NS) & (late[1:] > _LATE_NS)
        earlier += (at.start + np.flatnonzero((-np.diff(late) > _LATE_NS) | stay)).tolist()
    i = 0
    while i < len(earlier):
        last = earlier[i]
        doubt = AgeDoubt(look_back_ns)
        for j in range(max(last - _RATE_MEMORY, 0), len(receive_ns)):
            receive, row = int(receive_ns[j]), int(newest[j])
            told = Estimate(
                int(trace.t_ns[row]), float(trace.rack_force_n[row]), 0.0, False, Reason.FINE
            )
            stale[j] |= doubt.stale(told, receive, int(sample_ns[j]))
            while i < len(earlier) and earlier[i] < j:
                last, i = earlier[i], i + 1
            if j > last + 1 and receive - int(receive_ns[last + 1]) > look_back_ns:
                break
