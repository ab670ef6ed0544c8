"""Recordings with something false in them, and what is said of them."""

from typing import Any

import numpy as np

from eps_hil.estimation.plausibility import judge_step, limits_of
from eps_hil.estimation.settings import EstimatorSettings, PlausibilitySettings
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.stream import Trace
from eps_hil.estimation.validity import Reason
from eps_hil.estimation.watch import new_watch
from eps_hil.physics.model import Model
from eps_hil.series import Series

NAMES = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad")
SINCE, UNTIL = 9000, 9400
OFF = EstimatorSettings(plausibility=PlausibilitySettings(enabled=False))


def series_of(truth: Any) -> dict[str, Series]:
    t_ns = np.round(truth.columns["time_s"] * 1e9).astype(np.int64)
    return {name: Series(t_ns, truth.columns[name].copy()) for name in NAMES}


def told(trace: Trace, since_ms: int, until_ms: int) -> Reason:
    inside = (trace.t_ns > since_ms * 10**6) & (trace.t_ns < until_ms * 10**6)
    return Reason(int(np.bitwise_or.reduce(trace.reason[inside])))


def wrong_and_valid_ms(trace: Trace, right: Trace) -> int:
    """Longest spell in which both were valid and more than 100 N apart; less than 20 ms joins."""
    wrong = np.abs(trace.rack_force_n - right.rack_force_n) > 100.0
    at = np.flatnonzero(trace.valid & right.valid & wrong)
    spells = np.split(at, np.flatnonzero(np.diff(at) >= 20) + 1)
    return max(int(s[-1] - s[0]) + 1 if len(s) else 0 for s in spells)


def wrong_ms(trace: Trace, right: Trace) -> int:
    """For how many milliseconds an estimate is more than 100 N off, valid or not."""
    wrong = np.abs(trace.rack_force_n - right.rack_force_n) > 100.0
    return int(np.count_nonzero(wrong & right.valid))


def holed(series: dict[str, Series], at_ms: int, lost_ms: int) -> dict[str, Series]:
    """The same without the samples of all signals from ``at_ms`` on."""
    t_ns = series[NAMES[0]].t_ns
    kept = (t_ns < at_ms * 10**6) | (t_ns >= (at_ms + lost_ms) * 10**6)
    return {name: Series(t_ns[kept], one.value[kept]) for name, one in series.items()}


def around(whole: dict[str, Series], at: int, before: int, after: int) -> dict[str, Series]:
    """A copy of the samples around ``at``."""
    part = slice(at - before, at + after)
    return {n: Series(one.t_ns[part], one.value[part].copy()) for n, one in whole.items()}


def told_at(model: Model, torque: Any, speed: Any, angle: Any) -> int:
    """Step at which motion and torque (n,) are first told not to fit; -1: never."""
    limits, watch = limits_of(model, EstimatorSettings(), True), new_watch()
    for k in range(len(speed)):
        u = Inputs(torque[k], 0.0, speed[k], angle[k], 0.0, 1e-6, 1e-3, 1e-7)
        if judge_step(watch, limits, u, True, 0, True)[1]:
            return k
    return -1
