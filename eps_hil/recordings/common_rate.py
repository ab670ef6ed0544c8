"""Signals of any rates -> a table of one rate, without holes."""

from collections.abc import Mapping

import numpy as np

from eps_hil.recordings.table import ESTIMATES, VALID, Floats, Stamps
from eps_hil.series import Series, usual_step_ns

_NS = 1_000_000_000
_LONGEST_NS, _STEPS = 100_000_000, 3.0
"""A gap is longer than both: so long, and so many of the signal's own steps."""


MOST_ROWS = 20_000_000
"""Of a table that is made in memory: 11 signals of them are 1.8 GB, and as much to work with."""


class HoleError(ValueError):
    """A signal has no good sample somewhere between the first row and the last."""


class TooManyRowsError(ValueError):
    """More than :data:`MOST_ROWS`."""


def at_rate(
    series: Mapping[str, Series], rate_hz: float, *, gaps: str
) -> tuple[Stamps, dict[str, Floats], tuple[str, ...]]:
    """Rows each 1/``rate_hz`` s while all signals are there: stamps, columns, and notes.

    Rows stand at whole multiples of the period, from a whole second on. A value is linear between
    the signal's samples on either side (no filter); one of ``valid`` is 0 unless both are 1. Where
    those are bad or a gap apart, ``gaps`` "refuse" raises :class:`HoleError` and "mark" leaves the
    cell empty; an estimate that ``valid`` says does not hold is empty in either case.
    :class:`TooManyRowsError` before anything is made that would not fit into memory.
    """
    first = max(series, key=lambda name: int(series[name].t_ns[0]))
    last = min(series, key=lambda name: int(series[name].t_ns[-1]))
    begin_ns, end_ns = int(series[first].t_ns[0]), int(series[last].t_ns[-1])
    common_s = (end_ns - begin_ns) / _NS
    if common_s * rate_hz > MOST_ROWS:
        rows, most_hz = common_s * rate_hz, MOST_ROWS / common_s
        what = f"{rate_hz:g} Hz over {common_s:.1f} s is {rows:.3g} rows, of {MOST_ROWS} at most"
        raise TooManyRowsError(what, f"ask for {most_hz:.4g} Hz at most, or cut the recording")
    period_ns = _NS / rate_hz
    whole_ns = begin_ns // _NS * _NS  # floats hold what is left of the stamps
    k = np.arange((begin_ns - whole_ns) // period_ns, (end_ns - whole_ns) // period_ns + 2)
    t_ns = whole_ns + np.rint(k * period_ns).astype(np.int64)
    t_ns = t_ns[(t_ns >= begin_ns) & (t_ns <= end_ns)]
    if len(t_ns) < 2:
        raise HoleError(f"{first} begins when {last} has all but ended: no common stretch")
    columns = {
        name: _holding(one, t_ns) if name == VALID else linear(one, t_ns)
        for name, one in series.items()
    }
    excused = columns[VALID] == 0.0 if VALID in columns else np.zeros(len(t_ns), bool)
    notes = _cut(series, begin_ns, end_ns, first, last)
    for name, column in columns.items():
        empty = np.isnan(column) & ~(excused & (name in ESTIMATES))
        if not empty.any():
            continue
        since_s = (t_ns[int(np.argmax(empty))] - begin_ns) / _NS
        what = f"{name} has no good sample around {since_s:.3f} s after the first row"
        if gaps == "refuse":
            raise HoleError(what)
        notes += (f"{name}: {np.count_nonzero(empty)} of {len(t_ns)} cells are empty",)
    return t_ns, columns, notes


def _cut(
    series: Mapping[str, Series], begin_ns: int, end_ns: int, first: str, last: str
) -> tuple[str, ...]:
    """What of the recording the rows leave out."""
    before_s = (begin_ns - min(int(one.t_ns[0]) for one in series.values())) / _NS
    after_s = (max(int(one.t_ns[-1]) for one in series.values()) - end_ns) / _NS
    notes = []
    if before_s > 1.0:
        notes.append(f"rows begin {before_s:.1f} s after the recording, with {first}")
    if after_s > 1.0:
        notes.append(f"rows end {after_s:.1f} s before the recording, with {last}")
    return tuple(notes)


def longest_step_ns(t_ns: Stamps) -> float:
    """The longest step between a signal's samples that is no gap."""
    if len(t_ns) < 2:
        return _LONGEST_NS
    return max(_LONGEST_NS, _STEPS * usual_step_ns(t_ns))


def linear(one: Series, at_ns: Stamps) -> Floats:
    """Between a signal's neighbouring samples; NaN beside bad ones and within gaps."""
    if len(one.t_ns) < 2:
        return np.full(len(at_ns), np.nan)
    right = np.clip(np.searchsorted(one.t_ns, at_ns), 1, len(one.t_ns) - 1)
    left = right - 1
    width = one.t_ns[right] - one.t_ns[left]
    share = (at_ns - one.t_ns[left]) / width
    value = one.value[left] + share * (one.value[right] - one.value[left])
    value = np.where(share == 0.0, one.value[left], np.where(share == 1.0, one.value[right], value))
    return np.where(
        (width <= longest_step_ns(one.t_ns)) | (share == 0.0) | (share == 1.0), value, np.nan
    )


def _holding(valid: Series, at_ns: Stamps) -> Floats:
    """1 where the flags on both sides are."""
    return np.asarray(linear(valid, at_ns) == 1.0, dtype=np.float64)
