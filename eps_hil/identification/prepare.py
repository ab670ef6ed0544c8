"""One recording made ready: on a 1 kHz grid, spikes and gaps marked, noise measured.

Nothing is shifted in time here: delays are what is to be found.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.identification import gaps
from eps_hil.identification.filters import STEP_S, between
from eps_hil.identification.finding import Finding
from eps_hil.series import Series, usual_step_ns

Floats = npt.NDArray[np.float64]
Masks = npt.NDArray[np.bool_]

SHORTEST_S = 3.0
SLOWEST_S = 0.05
"""Between values of torque and motion: beyond it, reversals and inertia fall between them."""
LONG_S, LEAST_SHARE = 3600.0, 0.5
"""Of a recording that is longer, more than this part has to be there: the grid is as long as it."""
_FEWEST = 8
_SPIKE_SIGMA = 12.0
_USED = (
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
    "rack_position_m",
)


@dataclass(frozen=True)
class Prepared:
    """One recording as reported, every signal on the same 1 kHz stamps; arrays (n,).

    ``density`` is the one-sided noise density of each signal (its unit² per Hz); ``good`` is
    False within a gap of any signal.
    """

    name: str
    time_s: Floats
    raw: Mapping[str, Floats]
    density: Mapping[str, float]
    good: Masks
    findings: tuple[Finding, ...]
    step_s: Mapping[str, float] = field(default_factory=dict)
    """Usual time between two values of a signal that differ: one that is held is no faster."""

    def has(self, signal: str) -> bool:
        """Whether the signal was recorded."""
        return signal in self.raw

    def with_signal(self, signal: str, values: Floats) -> "Prepared":
        """The recording with other values of one signal."""
        return replace(self, raw={**self.raw, signal: values})


def prepare(name: str, series: Mapping[str, Series]) -> Prepared:
    """Put one recording on a grid; :class:`InputError` for one that nothing can be learnt from."""
    used = {key: series[key] for key in _USED if key in series}
    if "motor_torque_nm" not in used:
        raise InputError(name, "motor_torque_nm", "is missing", "record the motor torque")
    if "motor_speed_rad_s" not in used and "motor_angle_rad" not in used:
        problem = "neither motor_speed_rad_s nor motor_angle_rad"
        raise InputError(name, "", problem, "record the rotor's motion")
    check_rate(name, used)
    clean = {key: _finite(name, key, one) for key, one in used.items()}
    changes_s = {key: _change_s(t_ns, values) for key, (t_ns, values) in clean.items()}
    origin = max(int(t[0]) for t, _ in clean.values())
    end = min(int(t[-1]) for t, _ in clean.values())
    n = (end - origin) // 1_000_000 + 1
    if n * STEP_S < SHORTEST_S:
        problem = f"its signals share only {max(n, 0) * STEP_S:.1f} s"
        raise InputError(name, "", problem, f"record {SHORTEST_S:g} s or more")
    start = min(int(one.t_ns[0]) for one in used.values())
    grid = np.arange(n, dtype=np.int64) * 1_000_000
    raw, density, findings = {}, {}, []
    good = np.ones(n, dtype=np.bool_)
    for key, (t_ns, values) in clean.items():
        step = usual_step_ns(t_ns) * 1e-9
        sigma = noise_of(values)
        mended, spikes = without_spikes(values, sigma)
        if spikes:
            summary = f"{spikes} outliers (single samples far from their neighbours) left out"
            findings.append(Finding("outliers", name, key, summary))
        raw[key] = between(t_ns - origin, mended, grid)
        density[key] = max(2.0 * sigma**2 * step, 1e-18)
        findings += _shape(name, key, mended, sigma)
        for before, after in gaps.holes(t_ns):
            good &= ~((grid >= before - origin) & (grid <= after - origin))
    findings += gaps.findings(name, clean)
    time_s = np.asarray((grid + (origin - start)) * 1e-9, dtype=np.float64)
    return Prepared(name, time_s, raw, density, good, tuple(findings), changes_s)


def check_rate(name: str, series: Mapping[str, Series]) -> None:
    """:class:`InputError` for values too far apart, before any array is as long as they say.

    What makes hours of a few seconds is a time in ms, or a clock that jumped once.
    """
    for key in ("motor_torque_nm", "motor_speed_rad_s", "motor_angle_rad"):
        t_ns = series[key].t_ns if key in series else np.zeros(0, dtype=np.int64)
        step = usual_step_ns(t_ns) * 1e-9 if len(t_ns) > 1 else 0.0
        if step > SLOWEST_S:
            whole = (int(t_ns[-1]) - int(t_ns[0])) * 1e-9
            problem = (
                f"a value every {step:.3g} s, {whole:.5g} s ({whole / 3600:.3g} h) in all, where "
                f"{1 / SLOWEST_S:g} a second are needed: is the time in ms?"
            )
            raise InputError(name, key, problem, "give the time in s")
        _check_whole(name, key, t_ns, step)


def _check_whole(name: str, key: str, t_ns: npt.NDArray[np.int64], step_s: float) -> None:
    """:class:`InputError` where most of a long recording is a stretch without values."""
    whole_s, there_s = 1e-9 * float(t_ns[-1] - t_ns[0]) if len(t_ns) else 0.0, len(t_ns) * step_s
    if whole_s <= LONG_S or there_s >= LEAST_SHARE * whole_s:
        return
    k = int(np.argmax(np.diff(t_ns)))
    hole_s, after_s = 1e-9 * float(t_ns[k + 1] - t_ns[k]), 1e-9 * float(t_ns[k] - t_ns[0])
    problem = (
        f"values for {there_s:.5g} s of {whole_s:.5g} s, the longest stretch without any "
        f"{hole_s:.5g} s, after {after_s:.5g} s"
    )
    raise InputError(name, key, problem, "split the recording there, or mend its clock")


def noise_of(values: Floats) -> float:
    """Standard deviation of white noise on a smooth signal, from its third differences.

    Third differences beyond ten usual sizes are motion and count no more. 0 for a constant.
    """
    bends = np.abs(np.diff(values, n=3))
    if np.mean(bends > 0) < 0.2:
        return float(np.sqrt(np.mean(bends**2) / 20.0)) if len(bends) else 0.0
    usual = float(np.median(bends)) / 0.6745
    return float(np.sqrt(np.mean(np.minimum(bends, 10.0 * usual) ** 2) / 20.0))


def without_spikes(values: Floats, sigma: float) -> tuple[Floats, int]:
    """The signal with single wild samples (one or two in a row) bridged, and how many there were.

    A wild sample stands off the median of five by many times the noise and by more than the
    signal's own bend there (half the swing of its surroundings without it).
    """
    from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

    if len(values) < 16:
        return values, 0
    middle = median_filter(values, 5, mode="nearest")
    off = np.abs(values - middle)
    swing = maximum_filter1d(middle, 9) - minimum_filter1d(middle, 9)
    least = 1e-3 * float(np.subtract(*np.percentile(values, [95, 5])))
    usual = 1.4826 * float(np.median(off))
    wild = off > np.maximum(_SPIKE_SIGMA * max(sigma, usual), 2.0 * swing) + least
    count = int(wild.sum())
    if count == 0 or count > 0.02 * len(values):
        return values, 0
    index = np.arange(len(values))
    return np.interp(index, index[~wild], values[~wild]), count


def _finite(name: str, key: str, one: Series) -> tuple[npt.NDArray[np.int64], Floats]:
    good = np.isfinite(one.value)
    if (count := int(good.sum())) < _FEWEST:
        remedy = f"record {SHORTEST_S:g} s or more, or leave the column out"
        raise InputError(name, key, f"has only {count} value{'s' * (count != 1)}", remedy)
    return one.t_ns[good], one.value[good]


def _change_s(t_ns: npt.NDArray[np.int64], values: Floats) -> float:
    """Usual time between two values that differ, s; 0 of a constant."""
    changed = t_ns[1:][np.diff(values) != 0.0]
    return float(np.median(np.diff(changed))) * 1e-9 if len(changed) > 1 else 0.0


def _shape(name: str, key: str, values: Floats, sigma: float) -> list[Finding]:
    """Signals that do not move, or sit at their greatest value."""
    low, high = float(values.min()), float(values.max())
    if high - low <= 0:
        return [Finding("constant", name, key, f"is {high:g} all the time")]
    found = []
    for at, word in ((high, "greatest"), (low, "least")):
        flat = np.abs(values - at) <= 1e-9 * max(abs(at), 1e-9)
        runs = np.flatnonzero(np.convolve(flat, np.ones(25), mode="valid") == 25)
        if abs(at) > 0.5 * max(abs(low), abs(high)) and len(runs) and sigma < 0.02 * (high - low):
            share = float(flat.mean())
            if 0.002 < share < 0.5 and np.abs(np.diff(values)).max() > 0:
                words = f"stays at its {word} value {at:g} for {100 * share:.1f} % of the time"
                found.append(Finding("clipped", name, key, words + ": clipped?"))
    return found
