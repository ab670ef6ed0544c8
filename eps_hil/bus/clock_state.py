"""A sample clock and its messages, between compiled columns and the objects that judge frames."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.bus import instants
from eps_hil.bus.message_decoder import MessageDecoder
from eps_hil.bus.sample_clock import SLOPE_BLOCKS

Ints = npt.NDArray[np.int64]
MOST_SEEN = 16
"""Frames of a message that ``Seen`` remembers at most."""
_PLAIN = (
    "counter", "cycle", "stamp", "late_total", "late_run", "late_last", "in_time", "in_a_row",
    "again", "again_run", "again_stamp", "again_still",
)  # fmt: skip


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
        clock, line = self._clock, self._line[0]
        assert clock is not None
        line["period"], line["modulo"] = clock.period_ns, clock.counter_modulo
        for name, value in clock.line().items():
            line[name] = value
        line["lows"] = len(clock.lows)
        if clock.lows:
            self._lows[: len(clock.lows)] = clock.lows
        for place, plan in enumerate(self._plans):
            lane, at = clock.lane(plan.name), self._lanes[place]
            for name in _PLAIN:
                at[name] = getattr(lane, name)
            at["joined"], at["repeated"] = lane.joined, lane.repeated
            at["has_t"], at["t"] = lane.t is not None, lane.t or 0
            at["has_behind"], at["behind_since"] = (
                lane.behind_since is not None, lane.behind_since or 0,
            )  # fmt: skip
            if lane is clock.last:
                line["last"] = place

    def store(self) -> None:
        """From the arrays into the clock."""
        clock, line = self._clock, self._line[0]
        assert clock is not None
        lows = [(int(cycle), int(low)) for cycle, low in self._lows[: line["lows"]]]
        clock.go_on(
            {name: line[name].item() for name in clock.line()},
            lows,
            self._plans[line["last"]].name,
        )
        for place, plan in enumerate(self._plans):
            lane, at = clock.lane(plan.name), self._lanes[place]
            for name in _PLAIN:
                setattr(lane, name, int(at[name]))
            lane.joined, lane.repeated = bool(at["joined"]), bool(at["repeated"])
            lane.t = int(at["t"]) if at["has_t"] else None
            lane.behind_since = int(at["behind_since"]) if at["has_behind"] else None
