"""A whole recording through the stream estimator, in one compiled run."""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import interpreted
from eps_hil.estimation.age import run_aged
from eps_hil.estimation.lanes import Lanes, merge
from eps_hil.estimation.levels import LevelChange
from eps_hil.estimation.plain import plain
from eps_hil.estimation.settings import EstimatorSettings, problem
from eps_hil.estimation.stream import SIGNALS, Rows, StreamEstimator, Trace, ends
from eps_hil.physics.model import Model
from eps_hil.series import Arrivals, Series, usual_step_ns

SLOWEST_S = 0.2
STRETCH = 1 << 20
"""Syncs of a recording that are run through at once: 17 minutes at 1 kHz."""
Events = tuple[npt.NDArray[np.int8], npt.NDArray[np.int64], npt.NDArray[np.float64]]
"""Samples and syncs in the order of their stamps: place in SIGNALS or −1, stamp (ns), value."""


def sample_periods_s(series: Mapping[str, Series]) -> dict[str, float]:
    """Median sample period of each signal that the estimator knows."""
    return {
        name: usual_step_ns(series[name].t_ns) * 1e-9
        for name in SIGNALS
        if name in series and len(series[name].t_ns) > 1
    }


def sync_signal(series: Mapping[str, Series]) -> str:
    """The signal whose samples clock the estimator: the speed, else the angle."""
    return "motor_speed_rad_s" if "motor_speed_rad_s" in series else "motor_angle_rad"


def events(series: Mapping[str, Series]) -> Events:
    """All samples in the order of their stamps, with a sync (−1) after each sync sample.

    Returns (place in SIGNALS or −1, stamp in ns, value), each of shape (n,).
    """
    there = [series[name] for name in SIGNALS if name in series]
    many = np.array([len(series[name].t_ns) if name in series else 0 for name in SIGNALS], np.int64)
    end = np.cumsum(many)
    begin, sync = end - many, SIGNALS.index(sync_signal(series))
    begin, end = np.append(begin, begin[sync]), np.append(end, end[sync])
    n = int(np.sum(end - begin))
    signal, t_ns, value = np.empty(n, np.int8), np.empty(n, np.int64), np.empty(n)
    stamps = np.concatenate([one.t_ns for one in there])
    values = np.concatenate([one.value for one in there])
    if interpreted():
        stamps, values, begin, end = (plain(each) for each in (stamps, values, begin, end))
    merge(stamps, values, begin, end, signal, t_ns, value)
    return signal, t_ns, value


def lanes(series: Mapping[str, Series]) -> Lanes:
    """The samples as :meth:`StreamEstimator.run` takes them; not copied where they lie in a row."""
    none = Series(np.empty(0, np.int64), np.empty(0))
    there = [series.get(name, none) for name in SIGNALS]
    stamps = (*(one.t_ns for one in there), series[sync_signal(series)].t_ns)
    values = tuple(np.require(one.value, np.float64, ["C", "W"]) for one in there)
    stamps = tuple(np.require(one, np.int64, ["C", "W"]) for one in stamps)
    at, due = np.zeros(len(stamps), np.int64), np.zeros(len(stamps), np.int64)
    if interpreted():
        stamps, values = tuple(map(plain, stamps)), tuple(map(plain, values))
        at, due = plain(at), plain(due)
    return Lanes(stamps, values, at, due)


def latency_s(model: Model, settings: EstimatorSettings, periods_s: Mapping[str, float]) -> float:
    """From a sync frame back to the instant of its estimate; NaN for the smoother, that waits."""
    if settings.kind == "smoother":
        return float("nan")
    return StreamEstimator(model, settings, periods_s).latency_s


def _smoothed(
    model: Model,
    settings: EstimatorSettings,
    periods_s: Mapping[str, float],
    series: Mapping[str, Series],
) -> Trace:
    from eps_hil.estimation.bristle_smoother import smooth

    if wrong := problem(settings, live=False):
        raise ValueError(wrong)
    found = smooth(model, settings, periods_s, events(series))
    return Trace(found.t_ns, found.rack_force_n, found.friction_torque_nm, found.reason)


def spans(series: Mapping[str, Series], t_ns: int) -> bool:
    """Whether an instant lies within a recording."""
    name = sync_signal(series)
    return name in series and series[name].t_ns[0] <= t_ns <= series[name].t_ns[-1]


def check_rate(series: Mapping[str, Series]) -> None:
    """``ValueError`` for samples too far apart to estimate from: mostly a time in ms."""
    name = sync_signal(series)
    if name not in series or len(series[name].t_ns) < 2:
        return
    step_s = usual_step_ns(series[name].t_ns) * 1e-9
    if step_s > SLOWEST_S:
        raise ValueError(
            f"{name} has a value every {step_s:.3g} s, where {1 / SLOWEST_S:g} a second are "
            "needed: is the time in ms?"
        )


def estimate(
    series: Mapping[str, Series],
    model: Model,
    settings: EstimatorSettings | None = None,
    periods_s: Mapping[str, float] | None = None,
    changes: Sequence[LevelChange] = (),
    arrivals: Arrivals | None = None,
) -> Trace:
    """Rack force (N) and friction torque (Nm, at the rotor) for the signals of one recording.

    The result speaks of physical instants; instants before the first sample are left out.
    ``changes`` are adapted friction levels that were taken over while it was recorded. With
    ``arrivals`` (of a CAN log) what waited is as little valid as live.
    ``ValueError`` if motor torque, or both speed and angle, are missing.
    """
    periods = dict(periods_s) if periods_s is not None else sample_periods_s(series)
    chosen = settings or EstimatorSettings()
    if chosen.kind == "smoother":
        if changes:
            raise ValueError("the smoother knows no change of friction levels")
        trace = _smoothed(model, chosen, periods, series)
    else:
        stream = StreamEstimator(model, chosen, periods)
        aged = arrivals is not None and np.array_equal(
            series[sync_signal(series)].t_ns, arrivals.sample_ns
        )
        if arrivals is not None and aged:
            trace = run_aged(stream, lanes(series), arrivals, changes, STRETCH)
        else:  # where other samples arrived, nothing is known of the age of these
            rows, samples = Rows(), lanes(series)
            for end in ends(len(samples.t_ns[-1]), STRETCH):
                rows.add(stream.run(samples, changes, end))
                changes = ()
            trace = rows.whole()
    first = min(int(s.t_ns[0]) for name, s in series.items() if name in SIGNALS)
    there = trace.t_ns >= first
    begin = int(np.argmax(there)) if len(there) else 0
    # a view, where time does not jump
    keep = slice(begin, None) if bool(there[begin:].all()) else there
    return Trace(
        trace.t_ns[keep],
        trace.rack_force_n[keep],
        trace.friction_torque_nm[keep],
        trace.reason[keep],
    )
