"""Speed, angle and rack position against each other: signs, units, swapped columns, wrapped angles.

Three readings of one motion. Where two disagree by a sign or by a unit, the one that is wrong can
be named before any torque is looked at.
"""

import numpy as np
import numpy.typing as npt

from eps_hil.errors import InputError
from eps_hil.identification import filters
from eps_hil.identification.finding import Finding
from eps_hil.identification.prepare import Prepared

Floats = npt.NDArray[np.float64]

_UNITS = ((60.0 / (2 * np.pi), "rpm"), (180.0 / np.pi, "degrees per second"))
_TURN = 2 * np.pi
_ALIKE = 0.95
_LEAST_RAD_S = 0.3
_LEAST_RAD = 0.5
_OTHERS = ("motor_torque_nm", "torque_sensor_nm", "rack_force_n")


def check_speed(one: Prepared, rate: Floats, measured: Floats) -> None:
    """:class:`InputError` that names what is wrong between speed and angle.

    ``rate``: filtered derivative of the angle, ``measured``: filtered speed; (m,), rad/s.
    """
    check_turns(one)
    _check_dead(one, rate, measured)
    if min(_rms(rate), _rms(measured)) <= 0 or _rms(rate) < _LEAST_RAD_S:
        return
    together = _alike(rate, measured)
    gain = float(rate @ measured) / float(rate @ rate)
    if together < 0.7:
        _taken_for_each_other(one)
    if together < -0.7 and 0.5 < -gain < 2.0:
        raise InputError(
            one.name,
            "motor_speed_rad_s",
            "motor_speed_rad_s and the derivative of motor_angle_rad have opposite signs",
            "turn the sign of one of them (in a mapping: scale: -1)",
        )
    if together < 0.7:
        _in_another_column(one, rate)
        problem = f"does not follow the derivative of motor_angle_rad (correlation {together:.2f})"
        raise InputError(one.name, "motor_speed_rad_s", problem, "check which columns these are")
    for factor, unit in _UNITS:
        if abs(gain / factor - 1) < 0.05:
            problem = f"is {gain:.3g} times the derivative of motor_angle_rad: in {unit}?"
            raise InputError(one.name, "motor_speed_rad_s", problem, "give it in rad/s")
    if not 0.5 < gain < 2.0:
        problem = f"is {gain:.3g} times the derivative of motor_angle_rad"
        raise InputError(one.name, "motor_speed_rad_s", problem, "check the units of both")


def varies(one: Prepared) -> bool:
    """Whether both readings of the motion change at all: a constant says nothing of its delay."""
    return all(np.ptp(one.raw[name]) > 0.0 for name in ("motor_speed_rad_s", "motor_angle_rad"))


def _check_dead(one: Prepared, rate: Floats, measured: Floats) -> None:
    """:class:`InputError` for a reading that stays where it is while the other one moves."""
    by_name = {"motor_speed_rad_s": measured, "motor_angle_rad": rate}
    for dead, moving in (tuple(by_name), tuple(reversed(by_name))):
        if np.ptp(one.raw[dead]) == 0.0 and _rms(by_name[moving]) >= _LEAST_RAD_S:
            problem = f"is {one.raw[dead][0]:g} all the time while {moving} moves"
            raise InputError(one.name, dead, problem, "record it, or leave the column out")


def check_place(one: Prepared, ratio_rad_per_m: float) -> list[Finding]:
    """Angle against rack position: :class:`InputError` for units, a finding for sign and ratio."""
    if not (one.has("motor_angle_rad") and one.has("rack_position_m")):
        return []
    angle = one.raw["motor_angle_rad"] - np.mean(one.raw["motor_angle_rad"])
    place = one.raw["rack_position_m"] - np.mean(one.raw["rack_position_m"])
    if _rms(angle) < 0.01 or _rms(place) <= 0:
        return []
    together = float(angle @ place) / (len(angle) * _rms(angle) * _rms(place))
    gain = _rms(angle) / (_rms(place) * ratio_rad_per_m)
    if abs(together) < _ALIKE or _rms(angle) / max(gain, 1.0) < _LEAST_RAD:
        return []
    for factor, signal, words, remedy in (
        (180.0 / np.pi, "motor_angle_rad", "in degrees", "give it in rad"),
        (1.0 / _TURN, "motor_angle_rad", "in revolutions", "give it in rad"),
        (1e-3, "rack_position_m", "in mm", "give it in m"),
    ):
        if abs(gain / factor - 1) < 0.1:
            problem = f"is {words}, or the model's ratio is wrong (angle / (ratio · place) "
            raise InputError(one.name, signal, problem + f"is {gain:.3g})", remedy)
    if together < 0:
        words = "turns the other way than motor_angle_rad: check its sign"
        return [Finding("sign", one.name, "rack_position_m", words)]
    if abs(gain - 1) > 0.02:
        told = gain * ratio_rad_per_m
        words = f"says a ratio of {told:.0f} rad/m, the model file {ratio_rad_per_m:g}"
        return [Finding("ratio", one.name, "rack_position_m", words)]
    return []


def check_turns(one: Prepared) -> None:
    """:class:`InputError` for an angle that starts anew every turn."""
    steps = np.abs(np.diff(one.raw["motor_angle_rad"]))
    span = float(np.ptp(one.raw["motor_angle_rad"]))
    for turn, unit in ((_TURN, "2π"), (360.0, "360")):
        # bridged by the grid, a jump may take two steps
        jumps = int((steps > 0.4 * turn).sum())
        if jumps > 2 and span < 1.1 * turn:
            problem = f"jumps by {unit} {jumps} times: it starts anew every turn"
            raise InputError(one.name, "motor_angle_rad", problem, "unwrap it")


def _taken_for_each_other(one: Prepared) -> None:
    speed, angle = one.raw["motor_speed_rad_s"], one.raw["motor_angle_rad"]
    if _alike(filters.derivative(speed), filters.smooth(angle)) > _ALIKE:
        problem = "motor_speed_rad_s looks like the angle of motor_angle_rad: they are swapped"
        raise InputError(one.name, "motor_speed_rad_s", problem, "swap the columns")


def _in_another_column(one: Prepared, rate: Floats) -> None:
    good = filters.smooth(one.good.astype(np.float64)) > 0.999
    for name in _OTHERS:
        if one.has(name) and _alike(filters.smooth(one.raw[name])[good], rate) > _ALIKE:
            problem = f"{name} looks like the speed: they are swapped"
            raise InputError(one.name, "motor_speed_rad_s", problem, "swap the columns")


def _alike(one: Floats, other: Floats) -> float:
    """Correlation about zero."""
    size = len(one) * _rms(one) * _rms(other)
    return float(one @ other) / size if size > 0 else 0.0


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
