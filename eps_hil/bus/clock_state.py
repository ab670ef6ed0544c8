"""A sample clock and its messages, between compiled columns and the objects that judge frames."""

from collections.abc import Sequence
from operator import attrgetter

import numpy as np
import numpy.typing as npt

from eps_hil.bus import instants
from eps_hil.bus.message_decoder import MessageDecoder
from eps_hil.bus.sample_clock import SLOPE_BLOCKS

Ints = npt.NDArray[np.int64]
MOST_SEEN = 16
"""Frames of a message that ``Seen`` remembers at most."""
_PLAIN = instants.PLAIN
_PLAIN_OF = attrgetter(*_PLAIN)
_LINE_NAMES = instants.LINE.names or ()


class ClockState:
    """Messages of one clock, or one message without any; their decoders have seen nothing yet."""

    def __init__(self, plans: Sequence[MessageDecoder]) -> None:
        n = len(plans)
        self._plans = plans
        self._clock = plans[0].clock
        self._lanes = np.zeros(n, instants.LANE)
        self._lanes["counter"] = -1
        self._modulo = np.array([p.check.modulo if p.check else 0 for p in plans], np.int64)
        seen = [plan.seen for plan in plans]
        self._ring = instants.Ring(
            np.full((n, MOST_SEEN), -1, np.int64),
            np.zeros((n, MOST_SEEN), np.int64),
            np.zeros((n, MOST_SEEN), np.int64),
            np.array([0 if one is None else one.size for one in seen], np.int64),
            np.array([0 if one is None else one.recent_ns for one in seen], np.int64),
        )
        self._ring.row[:] = np.arange(n * MOST_SEEN).reshape(n, MOST_SEEN)
        self._width = np.array([plan.length for plan in plans], np.int64)
        self._payloads = np.zeros((n * MOST_SEEN, self.widest), np.uint8)
        self._line = np.zeros(1, instants.LINE)
        self._lows = np.zeros((SLOPE_BLOCKS, 2), np.int64)

    @property
    def widest(self) -> int:
        """Bytes of its longest message."""
        return int(self._width.max())

    def run(
        self, rows: instants.Rows, data: npt.NDArray[np.uint8], number: Ints
    ) -> npt.NDArray[np.bool_]:
        """Fill ``rows.state``, ``rows.t_ns``, ``rows.lost``; where the clock was found anew, (n,).

        ``data[number[k]]`` is the payload of row k, (m, widest). Rows of another call go on from
        where these end.
        """
        data = np.concatenate((self._payloads, data))
        restarted = self._run(rows, data, number + len(self._payloads))
        self._payloads = data[self._ring.row.ravel()]
        self._ring.row[:] = np.arange(len(self._payloads)).reshape(self._ring.row.shape)
        return restarted

    def _run(
        self, rows: instants.Rows, data: npt.NDArray[np.uint8], number: Ints
    ) -> npt.NDArray[np.bool_]:
        restarted = np.zeros(len(rows.stamp), bool)
        width = self._width
        if self._clock is None:
            instants.by_stamp(rows, self._lanes, self._ring, self._modulo, data, number, width)
            return restarted
        self.load()
        k = 0
        while k < len(rows.stamp):
            k = instants.by_counter(
                rows, self._lanes, self._line, self._lows, self._ring, data, number, width, k
            )
            if k < 0:
                break
            restarted[k] = self._judged(rows, k)
            k += 1
        self.store()
        return restarted

    def _judged(self, rows: instants.Rows, k: int) -> bool:
        """Row ``k`` by the clock itself; whether it was found anew."""
        clock = self._clock
        assert clock is not None
        self.store()
        plan = self._plans[rows.lane[k]]
        at = clock.instant(int(rows.stamp[k]), int(rows.counter[k]), plan.name)
        self.load()
        if at is None:
            rows.state[k], rows.moved[k] = instants.REPEATED, clock.moved_ns
            return False
        rows.state[k] = instants.GOOD if at.trusted else instants.UNTRUSTED
        rows.t_ns[k], rows.lost[k] = at.t_ns, at.lost
        rows.moved[k] = clock.moved_ns
        return at.restarted

    def load(self) -> None:
        """From the clock into the arrays."""
        clock = self._clock
        assert clock is not None
        line = clock.line() | {
            "period": clock.period_ns, "modulo": clock.counter_modulo, "lows": len(clock.lows),
            "last": int(self._line["last"][0]),
        }  # fmt: skip
        if clock.lows:
            self._lows[: len(clock.lows)] = clock.lows
        for place, plan in enumerate(self._plans):
            lane = clock.lane(plan.name)
            t, behind = lane.t, lane.behind_since
            self._lanes[place] = (
                *_PLAIN_OF(lane), lane.joined, lane.repeated, t is not None, t or 0,
                behind is not None, behind or 0, *self._lanes[place].item()[-2:],
            )  # fmt: skip
            if lane is clock.last:
                line["last"] = place
        self._line[0] = tuple(map(line.__getitem__, _LINE_NAMES))

    def store(self) -> None:
        """From the arrays into the clock."""
        clock = self._clock
        assert clock is not None
        line = dict(zip(_LINE_NAMES, self._line[0].item(), strict=True))
        lows = list(map(tuple, self._lows[: line["lows"]].tolist()))
        clock.go_on(line, lows, self._plans[line["last"]].name)
        for plan, values in zip(self._plans, self._lanes.tolist(), strict=True):
            lane = clock.lane(plan.name)
            for name, value in zip(_PLAIN, values, strict=False):
                setattr(lane, name, value)
            joined, repeated, has_t, t, has_behind, behind = values[len(_PLAIN) : -2]
            lane.joined, lane.repeated = bool(joined), bool(repeated)
            lane.t = t if has_t else None
            lane.behind_since = behind if has_behind else None
