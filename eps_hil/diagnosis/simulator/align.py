"""Two records of the same manoeuvre with clocks of their own: which belong together, how far apart.

Somebody's simulator writes its traces from zero, at its own rate; a recording starts when the
logger does. The offset is where the signals that both hold correlate best, all signals with the
same weight, refined below a sample by a parabola through the peak.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.physics.model import Model
from eps_hil.series import Series

Floats = npt.NDArray[np.floating[Any]]
Signals = Mapping[str, Series]

COMPARED = (
    "rack_force_n",
    "torque_sensor_nm",
    "motor_torque_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_position_m",
    "steering_wheel_angle_rad",
)
LEAST_CORRELATION = 0.5
"""Below this two records are not of the same manoeuvre."""
_COARSE_S, _FINE_S = 0.01, 0.5e-3
_LEAST_OVERLAP_S = 1.0
_LEAST_OVERLAP = 0.5
"""Least overlap as a share of the shorter record: a manoeuvre is recorded as a whole."""
_COARSE_BEST, _BEST = 1.01, 1.0 + 1e-5
_ORDER_BONUS = 0.01
"""Between equal matches the one that keeps the order of the files is preferred."""


@dataclass(frozen=True)
class Match:
    """A trace's place in a recording: time there = time in the trace + ``offset_s``.

    Both times count from the record's own first stamp and are physical instants (the delays of
    the model file taken off the recording). ``signals`` are those that were compared.
    """

    recording: str
    offset_s: float
    correlation: float
    overlap_s: float
    signals: tuple[str, ...]


def pair(
    traces: Mapping[str, Signals], recordings: Mapping[str, Signals], model: Model
) -> dict[str, Match | None]:
    """The recording that each trace belongs to; None where none is alike.

    Every recording is given away once before any is given away twice.
    """
    from scipy.optimize import linear_sum_assignment

    names, places = list(traces), list(recordings)
    found = [[match(traces[a], b, recordings[b], model) for b in places] for a in names]
    value = np.array(
        [
            [
                (one.correlation if one else 0.0) + _ORDER_BONUS * (i == j)
                for j, one in enumerate(row)
            ]
            for i, row in enumerate(found)
        ]
    )
    rows, columns = linear_sum_assignment(-value)
    chosen = {int(i): int(j) for i, j in zip(rows, columns, strict=True)}
    result: dict[str, Match | None] = {}
    for i, name in enumerate(names):
        best = found[i][chosen.get(i, int(np.argmax(value[i])))]
        result[name] = best if best and best.correlation >= LEAST_CORRELATION else None
    return result


def match(trace: Signals, name: str, recording: Signals, model: Model) -> Match | None:
    """Where ``trace`` fits best on ``recording``; None if they share no moving signal."""
    shared = [s for s in COMPARED if s in trace and s in recording]
    pairs = []
    for signal in shared:
        late = model.delays_s.of(signal)
        a = _seconds(trace, trace[signal], 0.0)
        b = _seconds(recording, recording[signal], late)
        if np.std(a[1]) > 0 and np.std(b[1]) > 0:
            pairs.append((signal, a, b))
    if not pairs:
        return None
    lags, score = _correlations([(a, b) for _, a, b in pairs], _COARSE_S)
    if not len(lags):
        return None
    coarse = float(lags[int(np.argmax(score))])
    near = coarse + np.arange(-40, 41) * _FINE_S
    curves = [(a, b) for _, a, b in pairs]
    # inputs of the manoeuvre are the same in both, motion is not
    fine = np.array([-float(np.mean(np.log(_BEST - _each(curves, lag)[0]))) for lag in near])
    offset = _peak(near, fine)
    each, overlap = _each(curves, offset)
    correlation = float(np.mean(each))
    return Match(name, offset, correlation, overlap, tuple(signal for signal, _, _ in pairs))


Curve = tuple[Floats, Floats]


def _seconds(record: Signals, one: Series, late_s: float) -> Curve:
    start = min(int(s.t_ns[0]) for s in record.values())
    good = np.isfinite(one.value)
    return (one.t_ns[good] - start) * 1e-9 - late_s, one.value[good]


def _correlations(pairs: Sequence[tuple[Curve, Curve]], step: float) -> tuple[Floats, Floats]:
    """(lags in s, score: likeness and overlap) on a grid of ``step``."""
    from scipy.signal import correlate

    total: Floats | None = None
    weight: Floats | None = None
    lags: Floats = np.zeros(0)
    a_end = max(float(a[0][-1]) for a, _ in pairs)
    b_end = max(float(b[0][-1]) for _, b in pairs)
    ta, tb = np.arange(0.0, a_end, step), np.arange(0.0, b_end, step)
    if min(len(ta), len(tb)) * step < _LEAST_OVERLAP_S:
        return np.zeros(0), np.zeros(0)
    for a, b in pairs:
        x, mask_x = _on(a, ta)
        y, mask_y = _on(b, tb)
        cross = correlate(y, x, method="fft")
        energy_x = correlate(mask_y, x**2, method="fft")
        energy_y = correlate(y**2, mask_x, method="fft")
        both = correlate(mask_y, mask_x, method="fft")
        one = cross / np.sqrt(np.maximum(energy_x * energy_y, 1e-12 * len(ta) ** 2))
        one = -np.log(_COARSE_BEST - np.clip(one, -1.0, 1.0))  # what agrees best counts most
        total = one if total is None else total + one
        weight = both if weight is None else np.minimum(weight, both)
        lags = (np.arange(len(cross)) - (len(x) - 1)) * step
    assert total is not None
    assert weight is not None
    share = np.clip(weight / min(len(ta), len(tb)), 1e-6, 1.0)
    enough = (share >= _LEAST_OVERLAP) & (weight * step >= _LEAST_OVERLAP_S)
    return lags, np.where(enough, total / len(pairs) + np.log(share), -np.inf)


def _on(curve: Curve, t: Floats) -> tuple[Floats, Floats]:
    """The curve about its mean, in units of its deviation, on a grid; and where it has values."""
    inside = (t >= curve[0][0]) & (t <= curve[0][-1])
    values = np.interp(t, *curve)
    values = (values - np.mean(values[inside])) / max(float(np.std(values[inside])), 1e-300)
    return np.where(inside, values, 0.0), inside.astype(np.float64)


def _each(pairs: Sequence[tuple[Curve, Curve]], lag: float) -> tuple[Floats, float]:
    """(correlation of each signal, overlap in s) at one lag."""
    found: Floats = np.full(len(pairs), -1.0)
    overlap = np.inf
    for k, (a, b) in enumerate(pairs):
        low, high = max(a[0][0] + lag, b[0][0]), min(a[0][-1] + lag, b[0][-1])
        overlap = min(overlap, high - low)
        if high - low < _LEAST_OVERLAP_S:
            continue
        t = np.arange(low, high, 2e-3)
        x, y = np.interp(t - lag, *a), np.interp(t, *b)
        x, y = x - np.mean(x), y - np.mean(y)
        size = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
        found[k] = float(x @ y) / size if size > 0 else 0.0
    return found, max(0.0, float(overlap))


def _peak(lags: Floats, score: Floats) -> float:
    """The parabola's top through the best point and its neighbours three steps away."""
    k, reach = int(np.argmax(score)), 3
    if not reach <= k < len(lags) - reach:
        return float(lags[k])
    left, top, right = score[k - reach], score[k], score[k + reach]
    bend = left - 2 * top + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float(lags[k] + shift * reach * (lags[1] - lags[0]))
