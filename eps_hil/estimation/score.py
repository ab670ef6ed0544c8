"""How far an estimate is from the rig's load cell, overall, moving and at rest."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.stream import Trace
from eps_hil.growing import blocks
from eps_hil.physics.model import Model
from eps_hil.series import Series

MOVING_RAD_S = 1.0
"""Above this rotor speed the rotor counts as moving: 0.4 mm/s at the rack of the reference rig."""


@dataclass(frozen=True, slots=True)
class Score:
    """Errors in newtons at the rack over the valid rows; NaN where there are no such rows."""

    rmse_overall_n: float
    rmse_moving_n: float
    bias_moving_n: float
    rms_force_n: float
    rows: int
    rmse_resting_n: float


VARIANTS: Mapping[str, Mapping[str, bool]] = {
    "2Q-fa": {},
    "no exten": {"dead_zone": False, "limiter": False},
    "w/o FC": {"friction_compensation": False, "dead_zone": False, "limiter": False},
}
"""The paper's variants of figs 11 and 12, by their names there, as changes of the settings."""

SECOND: Mapping[str, Literal["bristle_filter", "smoother"]] = {
    "bristle filter": "bristle_filter",
    "smoother": "smoother",
}
"""The estimators beside the paper's (docs/theory-second-estimator.md), by their kind."""


def variant(settings: EstimatorSettings, name: str) -> EstimatorSettings:
    """The settings with the blocks switched off that variant ``name`` does without.

    Names of :data:`VARIANTS` are the paper's estimator, those of :data:`SECOND` the others.
    """
    if name in SECOND:
        return replace(settings, kind=SECOND[name])
    return replace(settings, kind="observer", **VARIANTS[name])  # type: ignore[arg-type]


def score(trace: Trace, series: Mapping[str, Series], model: Model) -> Score | None:
    """Compare with ``rack_force_n`` of the recording; None where it has none, or where the
    force is an input of the estimator and not estimated.

    The load cell and the speed that tells movement are read at the estimate's own instants, their
    reporting delays taken out.
    """
    if "rack_force_n" not in series:
        return None
    overall, moving, resting, load = _Errors(), _Errors(), _Errors(), _Errors()
    for at in blocks(len(trace.t_ns)):
        t_ns = trace.t_ns[at]
        keep = (trace.reason[at] == 0) & _inside(t_ns, series["rack_force_n"])
        if not keep.any():
            continue
        t_ns, estimate = t_ns[keep], trace.rack_force_n[at][keep]
        if np.isnan(estimate).any():
            return None
        force = _at(t_ns, series["rack_force_n"], model.delays_s.of("rack_force_n"))
        error = estimate - force
        moves = np.abs(_speed(t_ns, series, model)) > MOVING_RAD_S
        for kept, values in (
            (overall, error), (moving, error[moves]), (resting, error[~moves]), (load, force)
        ):  # fmt: skip
            kept.add(values)
    return Score(overall.rms, moving.rms, moving.mean, load.rms, overall.rows, resting.rms)


class _Errors:
    """Sums of numbers that come block by block."""

    def __init__(self) -> None:
        self.rows, self._sum, self._squares = 0, 0.0, 0.0

    def add(self, values: npt.NDArray[np.float64]) -> None:
        self.rows += len(values)
        self._sum += float(np.sum(values))
        self._squares += float(np.sum(values**2))

    @property
    def mean(self) -> float:
        return self._sum / self.rows if self.rows else math.nan

    @property
    def rms(self) -> float:
        return math.sqrt(self._squares / self.rows) if self.rows else math.nan


def _speed(
    t_ns: npt.NDArray[np.int64], series: Mapping[str, Series], model: Model
) -> npt.NDArray[np.float64]:
    """Rotor speed (rad/s) smoothed over 20 ms, so that noise at rest is no movement."""
    if "motor_speed_rad_s" in series:
        delay = model.delays_s.of("motor_speed_rad_s")
        speed = series["motor_speed_rad_s"]
        around = [_at(t_ns + k * 2_000_000, speed, delay) for k in range(-5, 6)]
        return np.asarray(np.mean(around, axis=0))
    delay = model.delays_s.of("motor_angle_rad")
    after, before = (
        _at(t_ns + shift, series["motor_angle_rad"], delay) for shift in (10_000_000, -10_000_000)
    )
    return np.asarray((after - before) / 20e-3)


def _inside(t_ns: npt.NDArray[np.int64], one: Series) -> npt.NDArray[np.bool_]:
    return np.asarray((t_ns >= one.t_ns[0]) & (t_ns <= one.t_ns[-1]))


def _at(t_ns: npt.NDArray[np.int64], one: Series, delay_s: float) -> npt.NDArray[np.float64]:
    """Read between the good samples, at instants that lie near each other (n,)."""
    delay_ns = round(delay_s * 1e9)
    begin = int(np.searchsorted(one.t_ns, t_ns.min() + delay_ns, "right")) - 1
    end = int(np.searchsorted(one.t_ns, t_ns.max() + delay_ns)) + 1
    while begin > 0 and not math.isfinite(one.value[begin]):
        begin -= 1
    while end < len(one.t_ns) and not math.isfinite(one.value[end - 1]):
        end += 1
    around = slice(max(begin, 0), end)
    good = np.isfinite(one.value[around])
    stamps = one.t_ns[around][good] - delay_ns
    origin = stamps[0]  # differences are small enough for floats, stamps since 1970 are not
    return np.asarray(np.interp(t_ns - origin, stamps - origin, one.value[around][good]))
