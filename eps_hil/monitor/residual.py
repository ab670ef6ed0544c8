"""Rig against model over a sliding window: the estimate's error, and the torque balance.

The error is the published estimate minus the load cell at the same physical instant. The torque
balance needs no estimate: motor and torsion-bar torque, less load, inertia and the model's
friction, by the code that the diagnosis uses (:mod:`eps_hil.diagnosis.data.prepare`).
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import sliding
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.estimation.score import score
from eps_hil.estimation.stream import SIGNALS, Trace
from eps_hil.physics.model import Model
from eps_hil.series import Series

_NEEDED = ("motor_torque_nm", "rack_force_n")
_MOTION = ("motor_speed_rad_s", "motor_angle_rad")
_GAP_NS = 50_000_000
_LEAST_BALANCE_S = 2.5
_LEAST_SAMPLES = 25
"""Thinned to 125 Hz: a fifth of a second of sliding."""


Number = float | None
Four = tuple[Number, Number, Number, Number]
Three = tuple[Number, Number, Number]
_NO_ERROR: Four = (None, None, None, None)


@dataclass(frozen=True, slots=True)
class Residual:
    """None: no figure. Estimate minus load cell in N at the rack; torque balance in Nm.

    ``balance_floor_nm`` is what sensor noise alone leaves in the balance; ``why_not`` says why
    figures are missing.
    """

    error_n: float | None = None
    rms_moving_n: float | None = None
    rms_resting_n: float | None = None
    bias_moving_n: float | None = None
    balance_nm: float | None = None
    balance_floor_nm: float | None = None
    balance_n: float | None = None
    """``balance_nm`` at the rack."""
    why_not: str = ""

    def by_name(self) -> dict[str, float | None]:
        """The figures that alarms watch, in N at the rack."""
        return {
            "moving": self.rms_moving_n,
            "at rest": self.rms_resting_n,
            "torque balance": self.balance_n,
        }


class Window:
    """The samples and estimates of the last ``length_s``; one jump of their clock empties it."""

    def __init__(self, model: Model, length_s: float) -> None:
        self._model, self._length_ns = model, round(length_s * 1e9)
        self._samples: dict[str, deque[tuple[int, float]]] = {name: deque() for name in SIGNALS}
        self._estimates: deque[tuple[int, float, float, int]] = deque()
        self.balance: tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]] | None = None
        """That of the last figures as :func:`balance_of` has it; None where there was none."""

    def take(self, name: str, t_ns: int, value: float) -> None:
        """A sample of a signal that the model speaks of; others are ignored."""
        kept = self._samples.get(name)
        if kept is None:
            return
        if kept and (t_ns <= kept[-1][0] or t_ns - kept[-1][0] > self._length_ns):
            if abs(t_ns - kept[-1][0]) < _GAP_NS:
                return  # a repeated instant
            self.clear()
        kept.append((t_ns, value))
        while t_ns - kept[0][0] > self._length_ns:
            kept.popleft()

    def estimate(self, t_ns: int, force_n: float, friction_nm: float, reason: int) -> None:
        """A published estimate; ``t_ns``: the physical instant that it speaks of."""
        kept = self._estimates
        if kept and t_ns <= kept[-1][0]:
            if kept[-1][0] - t_ns < _GAP_NS:
                return
            kept.clear()
        kept.append((t_ns, force_n, friction_nm, reason))
        while t_ns - kept[0][0] > self._length_ns:
            kept.popleft()

    def clear(self) -> None:
        """Forget everything."""
        for kept in self._samples.values():
            kept.clear()
        self._estimates.clear()

    def residual(self, now_ns: int) -> Residual:
        """All figures there can be of what came in the window before ``now_ns``."""
        begin = now_ns - self._length_ns
        series = {}
        for name, kept in self._samples.items():
            recent = [(t, v) for t, v in kept if t >= begin and math.isfinite(v)]
            if len(recent) > 2:
                stamps, values = zip(*recent, strict=True)
                series[name] = Series(np.array(stamps, np.int64), np.array(values, np.float64))
        if "rack_force_n" not in series:
            return Residual(why_not="no load cell (rack_force_n)")
        if not any(name in series for name in _MOTION):
            return Residual(why_not="no motor speed or angle")
        error, why_not = self._error(series, begin)
        balance, why_no_balance = self._balance(series, now_ns)
        return Residual(
            *error, *balance, why_not="; ".join(filter(None, (why_not, why_no_balance)))
        )

    def _error(self, series: Mapping[str, Series], begin: int) -> tuple[Four, str]:
        rows = [each for each in self._estimates if each[0] >= begin]
        if not rows:
            return _NO_ERROR, "no estimate on the bus"
        t_ns, force, friction, reason = (np.array(column) for column in zip(*rows, strict=True))
        trace = Trace(t_ns.astype(np.int64), force, friction, reason.astype(np.int64))
        found = score(trace, series, self._model)
        if found is None or not found.rows:
            return _NO_ERROR, "no valid estimate beside the load cell"
        return (
            self._newest_error(trace, series["rack_force_n"]),
            _some(found.rmse_moving_n), _some(found.rmse_resting_n), _some(found.bias_moving_n),
        ), ""  # fmt: skip

    def _newest_error(self, trace: Trace, cell: Series) -> float | None:
        late = round(self._model.delays_s.of("rack_force_n") * 1e9)
        there = np.flatnonzero(trace.valid & (trace.t_ns + late <= cell.t_ns[-1]))
        if not len(there):
            return None
        k = int(there[-1])
        at = np.interp(float(trace.t_ns[k] + late - cell.t_ns[0]),
                       (cell.t_ns - cell.t_ns[0]).astype(float), cell.value)  # fmt: skip
        return float(trace.rack_force_n[k] - at)

    def _balance(self, series: Mapping[str, Series], now_ns: int) -> tuple[Three, str]:
        none: Three = (None, None, None)
        self.balance = None
        if missing := [name for name in _NEEDED if name not in series]:
            return none, f"no torque balance without {', '.join(missing)}"
        end = min(int(one.t_ns[-1]) for one in series.values())
        begin = max(_whole_since(one, end) for one in series.values())
        if now_ns - end > self._length_ns or (end - begin) * 1e-9 < _LEAST_BALANCE_S:
            return none, f"no torque balance from less than {_LEAST_BALANCE_S:g} s without gaps"
        cut = {name: _since(one, begin) for name, one in series.items()}
        prepared = prepare("window", cut)
        self.balance = balance_of(prepared, cut, self._model)
        left_n = self.balance[1]
        moving = np.isfinite(left_n)
        if int(moving.sum()) < _LEAST_SAMPLES:
            return none, "no torque balance while the rotor does not slide"
        rms_n = float(np.sqrt(np.mean(left_n[moving] ** 2)))
        ratio = self._model.rack_to_rotor_ratio_rad_per_m
        return (rms_n / ratio, prepared.floor_nm(self._model), rms_n), ""


def balance_of(
    prepared: Prepared, series: Mapping[str, Series], model: Model
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """Physical instants by the stamps' clock, and the residual there as force at the rack (n,).

    NaN where the rotor does not slide. ``prepared`` was made of ``series``.
    """
    start = min(int(one.t_ns[0]) for one in series.values())
    left = prepared.residual(model)[0] * model.rack_to_rotor_ratio_rad_per_m
    at_ns = start + np.rint(prepared.thin_time_s * 1e9).astype(np.int64)
    return at_ns, np.where(sliding(prepared, model), left, np.nan)


def warm_up(model: Model) -> None:
    """Run all compiled code once, on a made-up motion."""
    window = Window(model, 3.0)
    for k in range(3_000):
        for place, name in enumerate(SIGNALS):
            window.take(name, k * 1_000_000, 5.0 * math.sin(0.01 * k + place))
        window.estimate(k * 1_000_000, 0.0, 0.0, 0)
    window.residual(3_000_000_000)


def _whole_since(one: Series, end: int) -> int:
    """From where on there is no gap up to the end; the end itself for what came later."""
    stamps = one.t_ns[one.t_ns <= end]
    if not len(stamps):
        return end
    gaps = np.flatnonzero(np.diff(stamps) > _GAP_NS)
    return int(stamps[gaps[-1] + 1] if len(gaps) else stamps[0])


def _since(one: Series, begin: int) -> Series:
    keep = one.t_ns >= begin
    return Series(one.t_ns[keep], one.value[keep])


def _some(value: float) -> float | None:
    return None if math.isnan(value) else value
