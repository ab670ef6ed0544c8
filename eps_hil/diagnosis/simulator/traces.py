"""A simulator's traces made comparable: on our grid, beside their recording, as noisy as it.

Traces may have other rates and start times, and may lack what drove them: that is then lent from
the recording of the same manoeuvre (``align.py``), at the shift where the torque balance closes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.simulator.align import Match
from eps_hil.diagnosis.simulator.parameters import reduce_parameters
from eps_hil.physics.model import Model
from eps_hil.series import Series

Signals = Mapping[str, Series]

_INPUTS = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")
_STEP_NS = 1_000_000
_QUIET = 1e-4
"""Least noise of a trace, as a share of the signal's deviation: a step of its file."""
_REACH_S = 0.03
"""How far off the correlation may have placed a trace."""


def usual_noise(recordings: Mapping[str, Signals]) -> dict[str, float]:
    """Each signal's usual noise over the recordings (its own unit)."""
    found: dict[str, list[float]] = {}
    for name, one in recordings.items():
        for signal, sigma in prepare(name, one).noise.items():
            found.setdefault(signal, []).append(sigma)
    return {signal: float(np.median(sigmas)) for signal, sigmas in found.items()}


def dressed(
    name: str,
    trace: Signals,
    match: Match | None,
    recordings: Mapping[str, Signals],
    model: Model,
    noise: Mapping[str, float],
    seed: int,
) -> Prepared:
    """The trace on our grid, missing inputs taken from its recording, with the sensors' noise."""
    if "motor_speed_rad_s" not in trace and "motor_angle_rad" not in trace:
        raise ValueError(f"{name}: needs motor_speed_rad_s or motor_angle_rad")
    start = start_ns(trace)
    series = {signal: _resampled(one, start) for signal, one in trace.items() if len(one.t_ns) > 3}
    for signal in _INPUTS:
        if signal in series:
            continue
        if match is None:
            if signal == "torque_sensor_nm":
                continue
            raise ValueError(f"{name}: has no {signal}, and is like no recording to take it from")
        source = recordings[match.recording]
        if signal in source:
            late = model.delays_s.of(signal)
            origin = start_ns(source)
            shift = round((match.offset_s + late) * 1e9)
            one = source[signal]
            series[signal] = Series(one.t_ns - origin - shift, one.value)
    rng = np.random.default_rng(seed)
    first = prepare(name, series)
    noisy = {}
    for signal, one in series.items():
        least = _QUIET * float(np.nanstd(one.value))
        wanted = max(noise.get(signal, 0.0), least)
        missing = np.sqrt(max(0.0, wanted**2 - first.noise[signal] ** 2))
        noisy[signal] = Series(one.t_ns, one.value + missing * rng.standard_normal(len(one.value)))
    return prepare(name, noisy)


def lent(trace: Signals) -> list[str]:
    """What drives a model and the trace does not hold."""
    return [signal for signal in _INPUTS if signal not in trace]


def places(
    trace: Signals, match: Match | None, recordings: Mapping[str, Signals]
) -> list[Match | None]:
    """Where a trace that lacks inputs may lie: as it correlates, the same start, the same clock."""
    if match is None or not lent(trace):
        return [match]
    places: list[Match | None] = [match]
    for name, one in recordings.items():
        clock = (start_ns(trace) - start_ns(one)) * 1e-9
        offsets = {0.0, clock if abs(clock) < 0.5 * match.overlap_s else 0.0}
        places += [replace(match, recording=name, offset_s=offset) for offset in sorted(offsets)]
    return places


def start_ns(record: Signals) -> int:
    """First instant of all signals, by the record's own clock."""
    return min(int(one.t_ns[0]) for one in record.values())


def left_nm(one: Prepared, model: Model) -> float:
    """Mean size (noise deviations) of what the model leaves of the trace."""
    return float(np.mean(np.abs(one.residual(model)[0])))


def placed(problem: Problem, traces: Mapping[str, Signals]) -> Problem:
    """The same with each trace's lent inputs moved to where the torque balance closes best.

    Correlation places them to a few milliseconds where the motion itself differs; the balance
    feels tenths of one.
    """
    if not any(lent(trace) for trace in traces.values()):
        return problem
    for _ in range(2):
        model = reduce_parameters(problem, timing=False).model
        moved = [
            _best_shift(one, model, lent(trace)) if lent(trace) else one
            for one, trace in zip(problem.recordings, traces.values(), strict=True)
        ]
        problem = Problem(moved, problem.model)
    return problem


def _best_shift(one: Prepared, model: Model, lent: Sequence[str]) -> Prepared:
    """The trace with its lent columns at the shift that leaves least."""
    best, cost = one, np.inf
    for reach in (_REACH_S, _REACH_S / 10, _REACH_S / 100):
        for shift in np.linspace(-reach, reach, 11):
            raw = dict(best.raw if reach < _REACH_S else one.raw)
            for name in lent:
                if name in raw:
                    raw[name] = np.interp(one.time_s + shift, one.time_s, raw[name])
            trial = one.changed(raw=raw)
            new = left_nm(trial, model)
            if new < cost:
                cost, found = new, trial
        best = found
    return best


def _resampled(one: Series, start: int) -> Series:
    """The trace at 1 kHz from its own start; smooth between samples, as a simulator's state is."""
    from scipy.interpolate import Akima1DInterpolator

    good = np.isfinite(one.value)
    t_ns, value = one.t_ns[good] - start, one.value[good]
    grid = np.arange(-(-t_ns[0] // _STEP_NS), t_ns[-1] // _STEP_NS + 1, dtype=np.int64) * _STEP_NS
    smooth = Akima1DInterpolator(t_ns * 1e-9, value)(grid * 1e-9)
    return Series(grid, np.asarray(smooth, dtype=np.float64))
