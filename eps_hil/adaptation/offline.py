"""Reversal adaptation over recordings: signals of any rate, put to 1 kHz physical instants."""

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalState
from eps_hil.physics.model import Model
from eps_hil.series import Series

_STEP_NS = 1_000_000
_STALE_NS = 20_000_000
_SLOPE = 10  # samples to either side for a speed that comes from the angle

Floats = npt.NDArray[np.float64]
Progress = Callable[[float], None]


def adapt(
    series: Mapping[str, Series],
    model: Model,
    adaptation: ReversalAdaptation,
    on_progress: Progress | None = None,
) -> list[ReversalState]:
    """Feed one recording to ``adaptation``; its states after each stretch, in order.

    Several recordings may follow one another, in the order in which they were made. ``ValueError``
    if motor torque, or both speed and angle, are missing. A torsion-bar torque that is not in
    the recording counts as zero, so what the driver holds is taken for rack force.
    """
    if "motor_torque_nm" not in series:
        raise ValueError("the adaptation needs motor_torque_nm")
    if not {"motor_speed_rad_s", "motor_angle_rad"} & set(series):
        raise ValueError("the adaptation needs motor_speed_rad_s or motor_angle_rad")
    used = [series[name] for name in ("motor_torque_nm", "motor_speed_rad_s") if name in series]
    first, last = max(s.t_ns[0] for s in used), min(s.t_ns[-1] for s in used)
    at = np.arange(first, last, _STEP_NS, dtype=np.int64)
    sensor: Floats | float = 0.0  # absent; where it is lost the stretch begins anew
    if "torque_sensor_nm" in series:
        sensor = _at(series, "torque_sensor_nm", at, model)
    torque = _at(series, "motor_torque_nm", at, model) + model.sensor_to_rotor * sensor
    angle = _at(series, "motor_angle_rad", at, model)
    speed = _at(series, "motor_speed_rad_s", at, model)
    if "motor_speed_rad_s" not in series:
        speed = np.full(len(at), np.nan)
        speed[_SLOPE:-_SLOPE] = (angle[2 * _SLOPE :] - angle[: -2 * _SLOPE]) / (2e-3 * _SLOPE)
    force = _at(series, "rack_force_n", at, model)
    columns = np.column_stack([torque, speed, angle, force]).tolist()
    states = []
    for k, (t_ns, row) in enumerate(zip(at.tolist(), columns, strict=True)):
        state = adaptation.take(t_ns, *row)
        if state is not None:
            states.append(state)
            if on_progress is not None:
                on_progress(k / len(columns))
    return states


def _at(series: Mapping[str, Series], name: str, at: npt.NDArray[np.int64], model: Model) -> Floats:
    """A signal at physical instants (n,); NaN where it is missing, bad or has a hole."""
    if name not in series:
        return np.full(len(at), np.nan)
    one = series[name]
    wanted = at + round(model.delays_s.of(name) * 1e9)
    origin = one.t_ns[0]
    values = np.interp(wanted - origin, one.t_ns - origin, one.value, left=np.nan, right=np.nan)
    period = float(np.median(np.diff(one.t_ns))) if len(one.t_ns) > 1 else 0.0
    after = np.clip(np.searchsorted(one.t_ns, wanted), 1, len(one.t_ns) - 1)
    hole = one.t_ns[after] - one.t_ns[after - 1] > max(_STALE_NS, 3 * period)
    return np.asarray(np.where(hole, np.nan, values))
