"""The samples of a recording, signal by signal, through the stream in the order of their stamps."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import kernel
from eps_hil.estimation.setup import Constants, Physics
from eps_hil.estimation.stream_steps import BATCH_ROWS, Memory, advance, push
from eps_hil.estimation.stream_timing import Timing

_NEVER = (1 << 63) - 1

Int64 = npt.NDArray[np.int64]
Float64 = npt.NDArray[np.float64]


class Lanes(NamedTuple):
    """A recording's samples: stamps (ns) and values of each of SIGNALS, empty where there are none.

    The stamps of the syncs come last. ``at``: which is next of each lane, which a run moves on;
    ``due``: room for its stamp.
    """

    t_ns: tuple[Int64, ...]
    value: tuple[Float64, ...]
    at: Int64
    due: Int64


@kernel(inline="always")
def _stamp(t_ns: Int64, k: int) -> int:
    """The stamp of sample ``k`` (ns), or one that never comes."""
    return t_ns[k] if k < len(t_ns) else _NEVER


@kernel
def run(
    m: Memory,
    timing: Timing,
    c: Constants,
    x: Physics,
    t_ns: tuple[Int64, ...],
    value: tuple[Float64, ...],
    at: Int64,
    due: Int64,
    until: int,
    out_t: Int64,
    out: Float64,
    out_reason: Int64,
) -> int:
    """The samples of a recording in the order of their stamps, to sync ``until`` or a full ``out``.

    Lane by lane, those of SIGNALS and then the syncs: stamps, values, which is next (moved on), and
    room for its stamp. Of equal stamps the earlier lane comes first. Returns the rows written.
    """
    last, rows = len(at) - 1, 0
    for i in range(last + 1):
        due[i] = _stamp(t_ns[i], at[i])
    while at[last] < until and rows + BATCH_ROWS <= len(out_t):
        earliest = due[last]
        for i in range(last):
            earliest = min(earliest, due[i])
        back = False  # a lane whose stamps go back goes first
        for i in range(last):
            while due[i] == earliest:
                push(m, timing, i, earliest, value[i][at[i]])
                at[i] += 1
                due[i] = _stamp(t_ns[i], at[i])
            back = due[i] < earliest
            if back:
                break
        if back or due[last] != earliest:
            continue
        n = advance(m, timing, c, x, earliest)
        at[last] += 1
        due[last] = _stamp(t_ns[last], at[last])
        for j in range(n):
            out_t[rows + j], out_reason[rows + j] = m.t_ns[j], m.reason[j]
            out[rows + j, 0], out[rows + j, 1] = m.estimate[j, 0], m.estimate[j, 1]
        rows += n
    return rows


@kernel
def merge(
    t_ns: Int64,
    value: Float64,
    at: Int64,
    ends: Int64,
    signal: npt.NDArray[np.int8],
    out_t: Int64,
    out: Float64,
) -> None:
    """Samples lane by lane, from ``at`` (moved on) to ``ends``, in the order of their stamps.

    Of equal stamps the earlier lane comes first; the last lane are sync stamps (signal −1).
    """
    lanes, last, k = len(at), len(at) - 1, 0
    while k < len(signal):
        earliest = _NEVER
        for i in range(lanes):
            if at[i] < ends[i]:
                earliest = min(earliest, t_ns[at[i]])
        back = False  # a lane whose stamps go back goes first
        for i in range(lanes):
            while at[i] < ends[i] and not back:
                t = t_ns[at[i]]
                if t != earliest:
                    back = t < earliest
                    break
                signal[k], out_t[k] = (-1, t) if i == last else (i, t)
                out[k] = 0.0 if i == last else value[at[i]]
                at[i] += 1
                k += 1
            if back:
                break
